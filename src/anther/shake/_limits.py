"""What an arm bounds a shake by."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from anther.elastic_rod import Array
from anther.grasp import Grasp

ArmLimit = Callable[[Grasp, Array, Array], Array]
"""(grasp, unit direction (3,), frequencies (Q,) [Hz]) -> largest flange amplitude (Q,) [m]."""

_HERTZ = np.array([1, 2, 3, 5, 8, 10, 15, 20, 30.0])
_LATERAL = np.array([180, 45, 20, 7.2, 2.8, 1.8, 0.80, 0.45, 0.20]) * 1e-3
_APPROACH = np.array([111, 28, 12, 4.4, 1.7, 1.1, 0.49, 0.28, 0.12]) * 1e-3
_VERTICAL = np.array([122, 30, 13.5, 4.9, 1.9, 1.2, 0.54, 0.30, 0.14]) * 1e-3


def sawyer_limit(grasp: Grasp, direction: Array, frequencies: Array) -> Array:
    """Return the amplitude (Q,) [m] that a Sawyer manages at the paper's grasp, whatever the grasp's joints are.

    facts: sawyer section 6, SDK limits, orientation held, median of 106 joint solutions at (0.72, 0, -0.05);
    interpolated on a double logarithmic scale, 1/f^2 beyond 30 Hz. The three axes (approach, vertical, lateral) share
    the joints' acceleration, so the amplitudes combine as 1 / sum(|d_k| / A_k), which never promises too much.
    """
    f = np.asarray(frequencies, dtype=float)
    vertical = np.array([0.0, 0.0, 1.0]) - grasp.approach[2] * grasp.approach
    size = float(np.linalg.norm(vertical))
    vertical = vertical / size if size > 1e-6 else np.zeros(3)
    lateral = np.cross(vertical, grasp.approach) if size > 1e-6 else np.zeros(3)
    shares = [abs(float(direction @ axis)) for axis in (grasp.approach, vertical, lateral)]
    if size <= 1e-6:  # straight down: the two remaining axes are alike
        shares[2] = float(np.linalg.norm(direction - (direction @ grasp.approach) * grasp.approach))
    tables = (_APPROACH, _VERTICAL, _LATERAL)
    needed = np.sum([share / _amplitude(table, f) for share, table in zip(shares, tables, strict=True)], axis=0)
    return 1 / np.maximum(needed, 1e-9)


def _amplitude(table: Array, frequencies: Array) -> Array:
    inside = np.exp(np.interp(np.log(frequencies), np.log(_HERTZ), np.log(table)))
    return inside * np.minimum(1, (_HERTZ[-1] / frequencies) ** 2)
