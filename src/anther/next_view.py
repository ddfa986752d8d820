"""Next view: how much unseen space around the stem each reachable view is expected to show.

What the views so far saw is kept as voxels. A voxel is seen by a view if the view's depth there reaches it; what lies
behind a surface stays unseen. For every candidate view, rays from the unseen voxels around the stem hypothesis to the
camera say how likely the view gets to see them. Volume by ray casting in an occupancy grid, restricted to a region of
interest: Burusa et al. 2024 (attention-driven next-best-view, arXiv 2206.10274; semantic, arXiv 2306.09801).
Dimensions: V views, C candidates, K points of the hypothesis, N voxels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from anther.capture import Capture
from anther.checks import check_array, check_range, check_transform
from anther.geometry import Array, Intrinsics, inverse

HIT, MISS = 0.85, -0.4
"""Log-odds that a voxel is occupied, added by a reading in it and by one behind it (Hornung et al. 2013, OctoMap)."""


@dataclass(frozen=True, slots=True)
class Params:
    """What counts as unseen, and what hides it.

    Attributes:
        voxel: edge of a voxel [m]; above the pose error of the arm (3.6 mm RMS, facts: perception).
        reach: the space of interest ends this far from the stem hypothesis [m]: petioles' bases and trusses.
        surroundings: leaves up to this far from the hypothesis can hide it [m].
        enough: a voxel counts in full until one view has seen it, and no more when so many have; flowers need three
            (`masks.Params.petal_views`).
        opacity: probability that an unseen voxel stops a ray: an estimate of how much of a canopy is filled.
    """

    voxel: float = 0.006
    reach: float = 0.08
    surroundings: float = 0.2
    enough: int = 3
    opacity: float = 0.05

    def __post_init__(self) -> None:
        check_range("next view voxel", self.voxel, 0.001, 0.05, "m")
        check_range("reach around the stem", self.reach, self.voxel, 1, "m")
        check_range("surroundings", self.surroundings, self.reach, 2, "m")
        check_range("enough views of a voxel", self.enough, 1, 100)
        check_range("opacity", self.opacity, 0, 1)


def expected_new_volume(
    capture: Capture, hypothesis: ArrayLike, T_world_cam: ArrayLike, params: Params | None = None
) -> Array:
    """Return how much unseen volume around the stem each candidate view is expected to show (C,) [m3].

    A voxel that n < `enough` views have seen counts 1 - n / enough, times the probability that nothing hides it.

    Args:
        capture: the views so far, with the poses as best known.
        hypothesis: (K, 3) points of the stem as far as it is known, world frame [m].
        T_world_cam: (C, 4, 4) poses of the candidates; the camera is that of the capture.
        params: see `Params`.

    Raises:
        InputError: no hypothesis, or something not finite or of the wrong shape.
    """
    params = params or Params()
    stem = check_array("stem hypothesis", hypothesis, (None, 3))
    check_range("points of the stem hypothesis", len(stem), 1, 1_000_000)
    candidates = check_transform("candidate T_world_cam", np.asarray(T_world_cam).reshape(-1, 4, 4))
    lower = stem.min(axis=0) - params.surroundings
    shape = np.ceil((stem.max(axis=0) + params.surroundings - lower) / params.voxel).astype(np.int64)
    views, solidity = _looked(capture, lower, shape, params.voxel)
    stops = np.where(solidity > 0, 1.0, np.where(views == 0, params.opacity, 0.0)).astype(np.float32)
    cells = _around(stem, lower, shape, params)
    worth = np.maximum(1 - views[tuple(cells.T)] / params.enough, 0)
    cells, worth = np.ascontiguousarray(cells[worth > 0]), worth[worth > 0]
    k = _pinhole(capture.intrinsics)
    shares = [_shown(cells, worth, stops, lower, params.voxel, k=k, T=T, eye=eye) for T, eye in _cameras(candidates)]
    return np.array(shares) * params.voxel**3


def _looked(capture: Capture, lower: Array, shape: NDArray[Any], voxel: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return per voxel how many views have seen it, and the log-odds that it is occupied; both (X, Y, Z)."""
    views, solidity = np.zeros(shape, dtype=np.uint8), np.zeros(shape, dtype=np.float32)
    k = _pinhole(capture.intrinsics)
    for depth, (T, _) in zip(capture.depth, _cameras(capture.T_world_cam), strict=True):
        _look(depth, k, T, lower, voxel, views, solidity)
    return views, solidity


def _around(stem: Array, lower: Array, shape: NDArray[Any], params: Params) -> NDArray[Any]:
    """Return the voxels (N, 3) within reach of the hypothesis."""
    cells = np.argwhere(np.ones(shape, dtype=bool))
    away, _ = KDTree(stem).query(lower + (cells + 0.5) * params.voxel, distance_upper_bound=params.reach)
    return cells[np.isfinite(away)]


def _pinhole(camera: Intrinsics) -> Array:
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height])


def _cameras(T_world_cam: Array) -> list[tuple[Array, Array]]:
    """Return each view's T_cam_world and camera centre."""
    return [(np.ascontiguousarray(inverse(T)), np.ascontiguousarray(T[:3, 3])) for T in T_world_cam]


@numba.njit(nogil=True, cache=True)
def _pixel(p, k, T):
    """Return the pixel and the depth of a point; depth 0 when it is not in the image."""
    z = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
    if z <= 0:
        return 0, 0, 0.0
    u = int(np.round(k[0] * (T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]) / z + k[2]))
    v = int(np.round(k[1] * (T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]) / z + k[3]))
    return (u, v, z) if 0 <= u < k[4] and 0 <= v < k[5] else (0, 0, 0.0)


@numba.njit(nogil=True, cache=True)
def _look(depth, k, T, lower, voxel, views, solidity):
    p = np.empty(3)
    for i in range(views.shape[0]):
        for j in range(views.shape[1]):
            for m in range(views.shape[2]):
                p[0], p[1], p[2] = (
                    lower[0] + (i + 0.5) * voxel,
                    lower[1] + (j + 0.5) * voxel,
                    lower[2] + (m + 0.5) * voxel,
                )
                u, v, z = _pixel(p, k, T)
                if z == 0 or depth[v, u] == 0 or depth[v, u] < z - voxel / 2:
                    continue
                views[i, j, m] += 1
                solidity[i, j, m] += HIT if depth[v, u] < z + voxel / 2 else MISS


@numba.njit(nogil=True, cache=True)
def _shown(cells, worth, stops, lower, voxel, k, T, eye):
    """Return the worth of the voxels times the probability that no voxel on the way to the camera stops the ray."""
    total, p, step = 0.0, np.empty(3), np.empty(3)
    for n in range(len(cells)):
        for c in range(3):
            p[c] = lower[c] + (cells[n, c] + 0.5) * voxel
            step[c] = eye[c] - p[c]
        if _pixel(p, k, T)[2] == 0:
            continue
        step /= np.sqrt((step * step).sum())
        at, through = cells[n] + 0.5 + step, 1.0
        while (
            through > 0.01
            and np.all(at >= 0)
            and at[0] < stops.shape[0]
            and at[1] < stops.shape[1]
            and at[2] < stops.shape[2]
        ):
            through *= 1 - stops[int(at[0]), int(at[1]), int(at[2])]
            at += step
        total += worth[n] * through
    return total
