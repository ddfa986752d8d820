"""Rigid transforms, the pinhole camera, and lines through points.

`T_a_b` is a 4x4 matrix that maps coordinates in frame b to frame a. World is the arm's base, z up.
A camera frame is OpenCV's optical frame: x right, y down, z forward. A "7-number pose" is
x, y, z [m], qx, qy, qz, qw. Dimensions: V views, N points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from anther.core.checks import check_array, check_range, check_transform
from anther.core.choices import Axis
from anther.core.errors import bad_input

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
TO_Z_UP: dict[Axis, list[int]] = {"x": [1, 2, 0], "y": [2, 0, 1], "z": [0, 1, 2]}
"""Axis that is up -> in which order a file's axes are x, y, z with z up."""


def pose7(T_a_b: ArrayLike) -> Array:
    """Return the 7-number pose (x, y, z [m], qx, qy, qz, qw) of a (4, 4) transform, qw >= 0."""
    T = check_transform("pose", T_a_b)
    quaternion = Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True)
    return np.concatenate([T[:3, 3], quaternion])


def transform_from_pose7(pose: ArrayLike) -> Array:
    """Return the (4, 4) transform of a 7-number pose (x, y, z [m], qx, qy, qz, qw).

    Raises:
        InputError: wrong shape, not finite, or a quaternion whose norm is not within 1e-3 of 1.
    """
    numbers = check_array("7-number pose", pose, (7,))
    norm = float(np.linalg.norm(numbers[3:]))
    if abs(norm - 1) > 1e-3:
        raise bad_input("7-number pose", given=f"quaternion norm {norm:g}", allowed="1", do="Order is x y z w.")
    return transform(Rotation.from_quat(numbers[3:]).as_matrix(), numbers[:3])


def transform(rotation: ArrayLike, translation: ArrayLike) -> Array:
    """Return the (..., 4, 4) transforms of (..., 3, 3) rotations and (..., 3) translations [m]."""
    rotation = np.asarray(rotation)
    T = np.zeros((*rotation.shape[:-2], 4, 4))
    T[..., :3, :3] = rotation
    T[..., :3, 3] = translation
    T[..., 3, 3] = 1
    return T


def inverse(T_a_b: ArrayLike) -> Array:
    """Return T_b_a of one (4, 4) or several (..., 4, 4) rigid transforms."""
    T = np.asarray(T_a_b, dtype=np.float64)
    out = np.zeros_like(T)
    R_t = np.swapaxes(T[..., :3, :3], -1, -2)
    out[..., :3, :3] = R_t
    out[..., :3, 3] = -(R_t @ T[..., :3, 3:])[..., 0]
    out[..., 3, 3] = 1
    return out


def transform_points(T_a_b: ArrayLike, points_b: ArrayLike) -> Array:
    """Return (N, 3) points given in frame b as coordinates in frame a."""
    T = np.asarray(T_a_b, dtype=np.float64)
    return np.asarray(points_b, dtype=np.float64) @ T[:3, :3].T + T[:3, 3]


def transform_each(T_a_b: Array, points_b: Array) -> Array:
    """Return (..., N, 3) the points (N, 3) of frame b in frame a, each by its own of the transforms (..., N, 4, 4)."""
    return np.einsum("...nij,nj->...ni", T_a_b[..., :3, :3], points_b) + T_a_b[..., :3, 3]


def small_transform(rotation_vector: ArrayLike, translation: ArrayLike) -> Array:
    """Return the transforms of rotation vectors [rad] and translations [m]: (4, 4) of (3,), (N, 4, 4) of (N, 3)."""
    return transform(Rotation.from_rotvec(np.asarray(rotation_vector)).as_matrix(), translation)


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> Array:
    """Return T_world_cam of a camera at `eye` (3,) [m] whose optical axis points at `target` (3,) [m].

    Raises:
        InputError: eye and target coincide, or the view direction is parallel to `up`.
    """
    eye, target = np.asarray(eye, dtype=np.float64), np.asarray(target, dtype=np.float64)
    forward = target - eye
    right = np.cross(forward, np.asarray(up, dtype=np.float64))
    if np.linalg.norm(forward) < 1e-9 or np.linalg.norm(right) < 1e-9 * np.linalg.norm(forward):
        raise bad_input(
            "look_at", given=f"eye {eye}, target {target}", allowed="distinct points, not along up", do="Move the eye."
        )
    forward /= np.linalg.norm(forward)
    right /= np.linalg.norm(right)
    return transform(np.stack([right, np.cross(forward, right), forward], axis=1), eye)


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A pinhole camera without distortion; pixel centres have integer coordinates.

    Attributes:
        width, height: image size [px].
        fx, fy: focal lengths [px].
        cx, cy: principal point [px].
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        check_range("image width", self.width, 1, 20_000, "px")
        check_range("image height", self.height, 1, 20_000, "px")
        check_range("focal length fx", self.fx, 1, 1e6, "px")
        check_range("focal length fy", self.fy, 1, 1e6, "px")
        check_range("principal point cx", self.cx, -self.width, 2 * self.width, "px")
        check_range("principal point cy", self.cy, -self.height, 2 * self.height, "px")

    @property
    def matrix(self) -> Array:
        """The (3, 3) camera matrix."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    @property
    def pinhole(self) -> Array:
        """(4,) fx, fy, cx, cy [px]."""
        return np.array([self.fx, self.fy, self.cx, self.cy], dtype=np.float64)

    def rays(self) -> Array:
        """Return (H, W, 3) camera-frame directions with z = 1: depth times ray is the point."""
        u, v = np.meshgrid(np.arange(self.width, dtype=np.float64), np.arange(self.height, dtype=np.float64))
        return np.stack([(u - self.cx) / self.fx, (v - self.cy) / self.fy, np.ones_like(u)], axis=-1)

    def project(self, points_cam: ArrayLike) -> Array:
        """Return (N, 2) pixel coordinates of (N, 3) camera-frame points; NaN where z <= 0."""
        p = np.asarray(points_cam, dtype=np.float64)
        z = np.where(p[:, 2] > 0, p[:, 2], np.nan)
        return np.stack([self.fx * p[:, 0] / z + self.cx, self.fy * p[:, 1] / z + self.cy], axis=1)

    def back_project(self, depth: NDArray[Any], mask: NDArray[np.bool_] | None = None) -> Array:
        """Return camera-frame points (N, 3) [m] of the pixels with depth > 0 (and in `mask`), row by row.

        Args:
            depth: (H, W) z-depth [m]; 0 means no reading.
            mask: (H, W) pixels to use; None means all.
        """
        return self.points(depth, np.flatnonzero(depth > 0 if mask is None else (depth > 0) & mask))

    def points(self, depth: NDArray[Any], pixels: NDArray[np.integer]) -> Array:
        """Return camera-frame points (N, 3) [m] of pixels (N,) with depth, counted along the rows of `depth` (H, W)."""
        v, u = np.divmod(pixels, depth.shape[1])
        z = depth.ravel()[pixels].astype(np.float64)
        return np.stack([(u - self.cx) / self.fx * z, (v - self.cy) / self.fy * z, z], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """An axis-aligned box in the world frame: where the plant may stand, where the arm may go.

    Attributes:
        lower, upper: (3,) opposite corners [m], lower < upper.
    """

    lower: Array
    upper: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "lower", check_array("box lower corner", self.lower, (3,)))
        object.__setattr__(self, "upper", check_array("box upper corner", self.upper, (3,)))
        if np.any(self.lower >= self.upper):
            raise bad_input(
                "box", given=f"{self.lower} .. {self.upper}", allowed="lower < upper", do="Swap the corners."
            )

    def cells(self, edge: float, most: float) -> NDArray[np.int64]:
        """Return how many cubes of `edge` [m] cover the box along each axis (3,).

        Raises:
            InputError: more than `most` in all.
        """
        counts = np.maximum(1, np.ceil((self.upper - self.lower) / edge))
        if not np.prod(counts) <= most:
            raise bad_input(
                "workspace",
                given=" x ".join(f"{size:.3g}" for size in self.upper - self.lower) + " m",
                allowed=f"at most {most:.2g} cells of {1e3 * edge:g} mm in it",
                do="Without --workspace it lies where the cameras look: do their poses differ, and are they in metres? "
                "With one view, or one that sees far beyond the plant, give --workspace.",
            )
        return counts.astype(np.int64)

    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Return (N,) whether each of (N, 3) points lies within."""
        p, inside = np.asarray(points), np.True_
        for axis in range(3):  # over an axis of three numpy's own `all` takes several times as long
            inside = inside & (p[..., axis] >= self.lower[axis]) & (p[..., axis] <= self.upper[axis])
        return np.asarray(inside)


def occupied_cells(points: Array, edge: float) -> NDArray[np.int64]:
    """Return floor(point / edge) of points (N, 3), N >= 1: the cubes (M, 3) that hold any, each once, sorted."""
    cells = np.floor(points / edge).astype(np.int64)
    lower = cells.min(axis=0)
    size = cells.max(axis=0) - lower + 1
    held = np.unique(np.ravel_multi_index(tuple((cells - lower).T), size))  # many times quicker than by rows
    return np.stack(np.unravel_index(held, size), axis=1) + lower


def unit_vectors(azimuth: Array | float, elevation: Array) -> Array:
    """Return (..., 3) the directions at angles about z from x, and above the horizon [rad]."""
    level = np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1)


def arc_length(line: Array) -> Array:
    """Return (N,) how far each point of a line (N, k) is from the first, along the line."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))


def interpolate(at: ArrayLike, known: ArrayLike, rows: Array) -> Array:
    """Return (..., k) the rows (N, k) at places (...) between those (N,) that are known; beyond these the last one."""
    x, places = np.asarray(at, dtype=np.float64), np.asarray(known, dtype=np.float64)
    return np.stack([np.interp(x, places, column) for column in rows.T], axis=-1)
