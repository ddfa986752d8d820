"""What a structure-from-motion model lacks and the user must tell: its scale and its up direction."""

from __future__ import annotations

import re

import numpy as np
from scipy.spatial.transform import Rotation

from anther.checks import check_range
from anther.errors import bad_input
from anther.geometry import Array

_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_ALLOWED = "x, y, z, -x, -y, -z, or three numbers such as 0.1,-0.9,0.3"


def scale_and_up(path: object, scale: float | None, up: str | None) -> tuple[float, Array]:
    """Return (scale [m per model unit], R_world_model (3, 3)) of what the user told.

    The rotation is the shortest that turns `up` to +z.

    Args:
        path: the file, for the message.
        scale: metres per model unit.
        up: the direction that points up in the model: an axis, e.g. "-y", or a vector "0.1,-0.9,0.3".

    Raises:
        InputError: one of them is missing, or is no positive number or no direction.
    """
    missing = " and ".join(name for name, value in (("scale", scale), ("up", up)) if value is None)
    if scale is None or up is None:
        raise bad_input(
            str(path),
            given=f"no {missing}",
            allowed=f"--scale (metres per model unit) and --up= ({_ALLOWED})",
            do="A structure-from-motion model has neither: measure a known length in it (real metres / model length), "
            "and look which way the plant grows (before any alignment it is often about -y).",
        )
    check_range("scale", scale, 1e-6, 1e6, "m per unit")
    direction = _direction(up)
    rotation = Rotation.align_vectors([[0.0, 0.0, 1.0]], [direction])[0]
    return scale, rotation.as_matrix()


def _direction(up: str) -> Array:
    found = re.fullmatch(r"([+-]?)([xyz])", up.strip().lower())
    if found:
        return np.array(_AXES[found[2]]) * (-1.0 if found[1] == "-" else 1.0)
    try:
        vector = np.array([float(word) for word in up.replace(",", " ").split()])
    except ValueError:
        vector = np.zeros(0)
    if vector.shape != (3,) or not np.isfinite(vector).all() or np.linalg.norm(vector) < 1e-9:
        raise bad_input("up", given=f"'{up}'", allowed=_ALLOWED, do="Name the direction in which the plant grows.")
    return vector / np.linalg.norm(vector)
