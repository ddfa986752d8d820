"""How viser wants a pose."""

from __future__ import annotations

from typing import Any

from scipy.spatial.transform import Rotation

from anther.geometry import Array


def placed(T: Array) -> tuple[Any, Any]:
    """Return position (3,) and quaternion w, x, y, z of a transform (4, 4)."""
    return T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)
