"""A camera's intrinsics and lens, as a file of Anther, OpenCV, ROS, nerfstudio or librealsense states them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from anther.core.errors import bad_input
from anther.core.files import read_object
from anther.core.geometry import Array, Intrinsics
from anther.perception.transforms import LENS_KEYS, LENS_MODELS, PIXEL_CENTRE, is_bent

_NAMES = {
    "width": ("width", "w", "image_width"), "height": ("height", "h", "image_height"), "fx": ("fx", "fl_x"),
    "fy": ("fy", "fl_y"), "cx": ("cx", "ppx"), "cy": ("cy", "ppy"),
}  # fmt: skip
"""Name -> how Anther, nerfstudio, OpenCV, ROS or librealsense call it."""
_MATRICES = ("camera_matrix", "K", "k", "intrinsic_matrix")
_LISTS = ("distortion", "distortion_coefficients", "dist_coeffs", "dist", "D", "d", "coeffs")
_DISTORTION = (
    "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y",
)  # fmt: skip
LENS_SIZES = (5, 8, 12, 14)
"""How many of these numbers a lens has in OpenCV."""


def read_intrinsics(path: Path | str) -> tuple[Intrinsics, Array]:
    """Return intrinsics, and the lens's distortion in OpenCV's order: k1, k2, p1, p2, k3, perhaps k4, k5, k6 and more.

    The JSON file holds width, height, fx, fy, cx, cy (or a 3 x 3 `camera_matrix`, or `K`), and perhaps k1 ... k6 (or
    them as a list `distortion`, `D`, `coeffs`); or it is a `transforms.json` (docs/capture.md), whose pixel centres lie
    at half-integers, or an earlier `calibration.json`.

    Raises:
        InputError: the file is missing, or an entry is missing or unusable; a lens that OpenCV's polynomials do not
            describe.
    """
    stored = read_object(path)
    inner = stored.get("intrinsics")
    if isinstance(inner, dict):
        stored = {name: stored[name] for name in _LISTS if name in stored} | inner
    if not any(names[0] in stored for names in _NAMES.values()) and isinstance(stored.get("frames"), list):
        stored |= _of_frames(path, stored["frames"])
    shift = PIXEL_CENTRE if "fl_x" in stored else 0.0
    matrix = _list(path, stored, _MATRICES)
    if matrix is not None and len(matrix) == 9:
        stored |= {"fx": matrix[0], "fy": matrix[4], "cx": matrix[2], "cy": matrix[5]}
    found = {name: next((stored[n] for n in names if n in stored), None) for name, names in _NAMES.items()}
    values = {name: _number(path, value, name) for name, value in found.items()}
    width, height = int(values.pop("width")), int(values.pop("height"))
    values |= {"cx": values["cx"] - shift, "cy": values["cy"] - shift}
    return Intrinsics(width, height, **values), _distortion(path, stored, nerfstudio=bool(shift))


def _of_frames(path: Path | str, frames: list[Any]) -> dict[str, Any]:
    """Return the intrinsics of the frames of a transforms.json if they are all alike."""
    stated = [{n: f[n] for names in _NAMES.values() for n in names if n in f} for f in frames if isinstance(f, dict)]
    if any(one != stated[0] for one in stated):
        allowed, do = "one camera", "Give those of the images of the board in a file of their own."
        raise bad_input(str(path), given="other intrinsics in each frame", allowed=allowed, do=do)
    return frames[0] if stated else {}


def _distortion(path: Path | str, stored: dict[str, Any], *, nerfstudio: bool) -> Array:
    """Return the lens in OpenCV's order, 5, 8, 12 or 14 numbers; refuse what is of another kind."""
    models = {n: str(stored[n]) for n in ("camera_model", "distortion_model", "lens_model", "model") if stored.get(n)}
    strange = {
        n: m for n, m in models.items() if m.lower().removeprefix("distortion.").replace("_", " ") not in LENS_MODELS
    }
    listed = _list(path, stored, _LISTS)
    single = {name: _number(path, stored.get(name, 0.0), name) for name in _DISTORTION}
    bent = list(single.values()) if listed is None else listed
    if listed is not None and any(single.values()) and [*listed, *[0.0] * 14][:14] != [*single.values()]:
        given, do = "a list of distortion and other k1, k2, ... beside it", "Leave one of them out."
        raise bad_input(str(path), given=given, allowed="the lens once", do=do)
    others = [
        n
        for n, value in stored.items()
        if n not in (*_DISTORTION, *_LISTS) and LENS_KEYS.fullmatch(n) and is_bent(n, value)
    ]
    if nerfstudio and bent[5:6] != [] and bent[5] and not any(bent[6:8]):
        others.append("k4 (nerfstudio's is another polynomial's)")
    if strange or others or len(bent) > 14:
        given = ", ".join([f"{n} '{m[:40]}'" for n, m in strange.items()] + others) or f"{len(bent)} numbers of a lens"
        do = "Calibrate the lens with OpenCV's model, or undistort the images and leave the lens out."
        raise bad_input(str(path), given=given, allowed=f"OpenCV's polynomials ({', '.join(_DISTORTION)})", do=do)
    used = max((i for i, k in enumerate(bent, 1) if k), default=0)
    return np.array([*bent, *[0.0] * 14][: next(size for size in LENS_SIZES if size >= used)])


def _list(path: Path | str, stored: dict[str, Any], names: tuple[str, ...]) -> list[float] | None:
    """Return the numbers of the first of the named entries that is a list, one of lists, or an object with `data`."""
    for name in names:
        value = stored.get(name)
        value = value.get("data") if isinstance(value, dict) else value
        if isinstance(value, list):
            flat = [n for part in value for n in (part if isinstance(part, list) else [part])]
            return [_number(path, n, name) for n in flat]
    return None


def check_size(given: Intrinsics, size: tuple[int, int], whose: str) -> None:
    """Check that intrinsics are of images of `size` (width, height) [px]."""
    if (given.width, given.height) != size:
        own, allowed = f"{given.width} x {given.height} px", f"{size[0]} x {size[1]} px, as {whose}"
        raise bad_input("intrinsics", given=own, allowed=allowed, do="Give those of this resolution.")


def _number(path: Path | str, value: Any, name: str) -> float:
    number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if not number:
        raise bad_input(
            f"{path} '{name}'",
            given="nothing" if value is None else repr(value),
            allowed=f"a number; the file holds {', '.join(_NAMES)}",
            do="Add it.",
        )
    return float(value)
