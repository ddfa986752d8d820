"""Views that the others contradict: how to see it, and how to find where they belong. V views, N points."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import small_gicp
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anther.cloud.matching import THREADS, Estimate, Sample, replaced
from anther.cloud.sequential import Target, align
from anther.geometry import Array

NEAR = 0.02
"""A point is judged if other views see anything within this distance [m]."""

ON_SURFACE = 0.002
"""A point agrees if it lies within this of another view's surface [m]; two thirds of the kinematic error."""

ALIKE = float(np.cos(np.deg2rad(40)))
"""Least cosine between the normals of the same surface; a leaf's two sides count as one here."""

LEAST_JUDGED = 50
"""Fewer points than this cannot tell whether a view agrees."""

THINNED = 4
"""One point in so many is judged, against the same share of the others'."""

STEP = 0.01
"""Spacing of the places tried for a lost view [m]: the alignment that follows finds its way from half of that."""


def agreement(sample: Sample, at: Estimate, views: Iterable[int]) -> Array:
    """Return for each of `views` the share of its points that lie on a surface other views see, of those near any.

    0 where a view has points enough but hardly any near what others see; NaN where it has too few to tell.
    """
    sample = sample.only(np.arange(len(sample.view)) % THINNED == 0)
    points, normals = sample.world(at)
    with ThreadPoolExecutor(THREADS) as pool:
        return np.array(list(pool.map(lambda v: _agreement(points, normals, sample.view == v), views)))


def placed_anew(sample: Sample, at: Estimate, view: int, search: float) -> Array:
    """Return the pose (4, 4) near the view's present one that fits the other views best.

    All shifts up to `search` [m] along each axis are scored by how close the points come to the other views'; the best
    are refined by point-to-plane ICP, and the one that agrees best is returned.
    """
    points, _ = sample.world(at)
    own = sample.view == view
    others = points[~own]
    target, unbiased, tried = Target.of(others), sample.unbiased(at.reach)[own], []
    for shift in _best_shifts(points[own], target.tree, search, most=3):
        pose = at.poses[view].copy()
        pose[:3, 3] += shift
        for distance in (2 * STEP, STEP / 2):
            pose = align(target, unbiased, pose, "PLANE_ICP", distance)
        tried.append((np.nan_to_num(agreement(sample, replaced(at, view, pose), [view])[0]), pose))
    return max(tried, key=lambda found: found[0])[1]


def _agreement(points: Array, normals: Array, own: NDArray[np.bool_]) -> float:
    if own.all() or not own.any():
        return np.nan
    distance, near = KDTree(points[~own]).query(points[own], 6, distance_upper_bound=NEAR)
    judged, near = distance[:, 0] < NEAR, np.minimum(near, (~own).sum() - 1)
    if judged.sum() < LEAST_JUDGED:
        return 0.0 if own.sum() >= 2 * LEAST_JUDGED else np.nan
    n = normals[~own][near]
    apart = np.abs(np.einsum("nki,nki->nk", n, points[own][:, None] - points[~own][near]))
    alike = np.abs(np.einsum("nki,ni->nk", n, normals[own])) > ALIKE
    agrees = (alike & (apart < ON_SURFACE) & (distance < NEAR)).any(axis=1)
    return float(agrees[judged].mean())


def _best_shifts(source: Array, target: small_gicp.KdTree, search: float, most: int) -> Array:
    """Return the shifts (most, 3) [m] that bring the source points closest to the target's."""
    few = source[:: max(1, len(source) // 100)]
    steps = np.arange(-search, search + STEP / 2, STEP)
    shifts = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    _, squared = target.batch_knn_search((few + shifts[:, None]).reshape(-1, 3), 1, num_threads=THREADS)
    score = np.exp(-squared.reshape(len(shifts), -1) / (STEP / 2) ** 2).mean(axis=1)
    return shifts[np.argsort(-score)[:most]]
