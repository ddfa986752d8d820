"""The paper's way, for comparison: each view is registered by ICP to the map of all views before it."""

from __future__ import annotations

import numpy as np
import small_gicp

from anther.cloud.matching import THREADS, Estimate, Sample
from anther.geometry import Array, transform_points

NEIGHBOURS = 12
TIGHT = {"rotation_epsilon": 1e-5, "translation_epsilon": 1e-6}
"""small_gicp's own tolerances, 0.1 deg and 1 mm, stop too early (facts: perception)."""


def chain(sample: Sample, given: Array, method: str, distance: float) -> Array:
    """Return poses (V, 4, 4), each found by aligning its view with the views before it.

    Args:
        sample: the points.
        given: (V, 4, 4) where each alignment starts; the first view keeps its pose.
        method: "ICP", "PLANE_ICP" or "GICP".
        distance: greatest distance of a match [m].
    """
    poses = given.copy()
    for view in np.unique(sample.view)[1:]:
        before = sample.view < view
        placed, _ = sample.only(before).world(Estimate(poses))
        poses[view] = align(placed, sample.points[sample.view == view], poses[view], method, distance)
    return poses


def align(target: Array, source_cam: Array, T_world_cam: Array, method: str, distance: float) -> Array:
    """Return T_world_cam (4, 4) under which source_cam (M, 3) lies on target (N, 3), starting from the one given."""
    fixed, moving = (
        small_gicp.PointCloud(np.ascontiguousarray(p)) for p in (target, transform_points(T_world_cam, source_cam))
    )
    for cloud in (fixed, moving):
        small_gicp.estimate_normals_covariances(cloud, num_neighbors=NEIGHBOURS, num_threads=THREADS)
    result = small_gicp.align(
        fixed, moving, small_gicp.KdTree(fixed, num_threads=THREADS), registration_type=method,
        max_correspondence_distance=distance, num_threads=THREADS, max_iterations=60, **TIGHT,
    )  # fmt: skip
    return np.asarray(result.T_target_source) @ T_world_cam
