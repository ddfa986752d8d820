"""The paper's way, for comparison: each view is registered by ICP to the map of all views before it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import small_gicp

from anther.cloud.matching import THREADS, Estimate, Sample
from anther.geometry import Array

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
        source = sample.points[sample.view == view]
        poses[view] = align(Target.of(placed), source, poses[view], method, distance)
    return poses


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """Points with normals and covariances, and their search tree."""

    cloud: small_gicp.PointCloud
    tree: small_gicp.KdTree

    @classmethod
    def of(cls, points: Array) -> Target:
        """Prepare world points (N, 3) [m]."""
        cloud = _with_covariances(points)
        return cls(cloud, small_gicp.KdTree(cloud, num_threads=THREADS))


def align(target: Target, source_cam: Array, T_world_cam: Array, method: str, distance: float) -> Array:
    """Return T_world_cam (4, 4) under which source_cam (M, 3) lies on the target, starting from the one given."""
    result = small_gicp.align(
        target.cloud, _with_covariances(source_cam), target.tree, T_world_cam, registration_type=method,
        max_correspondence_distance=distance, num_threads=THREADS, max_iterations=60, **TIGHT,
    )  # fmt: skip
    return np.asarray(result.T_target_source)


def _with_covariances(points: Array) -> small_gicp.PointCloud:
    cloud = small_gicp.PointCloud(np.ascontiguousarray(points))
    small_gicp.estimate_normals_covariances(cloud, num_neighbors=NEIGHBOURS, num_threads=THREADS)
    return cloud
