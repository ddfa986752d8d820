"""Where a plant that was seen on the way is, once the cart stands before it. N points."""

from __future__ import annotations

import numpy as np
import small_gicp
from scipy.spatial.transform import Rotation

from anther.core.errors import StageFailure
from anther.core.geometry import Array, inverse, transform_points
from anther.perception.cloud._fusion import voxel_means
from anther.perception.cloud._wrong_views import (
    THREADS,
    best_shifts,
    grid,
    normals_at,
    refined,
    share_on_surfaces,
    with_normals,
)

SEARCH_ALONG, SEARCH_ACROSS = 0.06, 0.03
"""How far a plant may be from where it was seen, along the camera's way and across it [m]: three times what is believed
of odometry and calibration; guesses."""
STEP = 0.01
"""Between the places that are tried [m]: ICP finds its way from half of that."""


def find_again(points: Array, way: Array, shown: Array) -> Array:
    """Return T_now_then (4, 4), which moves what was seen to where it is now.

    Args:
        points: (N, 3) of surface that was seen, world [m].
        way: (3,) along which odometry errs, any length but 0.
        shown: (M, 3) of surface that is seen now, world [m].

    Raises:
        StageFailure: "no_plant_found": what is shown lies nowhere near on what was seen.
    """
    voxel, most, few = 0.004, 2000, 100  # m; more points move the result by less than the plant sways
    target, source = voxel_means(points, voxel), voxel_means(shown, voxel)
    if len(source) < few:
        raise _not_there(f"{len(source)} points of surface are seen from here, {few} are needed")
    source = source[np.random.default_rng(0).permutation(len(source))[:most]]
    turn = Rotation.align_vectors(way[None], [[1.0, 0.0, 0.0]])[0]
    shifts = turn.apply(grid([SEARCH_ALONG, SEARCH_ACROSS, SEARCH_ACROSS], STEP))
    surface, moving = with_normals(target), with_normals(source)
    tree = small_gicp.KdTree(surface, num_threads=THREADS)
    T_then_now = np.eye(4)
    T_then_now[:3, 3] = best_shifts(source, tree, shifts, STEP, most=1)[0]
    T_then_now = refined(surface, moving, tree, T_then_now, STEP)
    _check(target, source, T_then_now)
    return inverse(T_then_now)


def _check(target: Array, source: Array, T_then_now: Array) -> None:
    """Raise where the source (M, 3) does not lie on the target (N, 3), or lies there only far from where it was."""
    back = transform_points(T_then_now, source)
    normals = np.concatenate([normals_at(points, points) for points in (target, source)])
    normals[len(target) :] = normals[len(target) :] @ T_then_now[:3, :3].T
    own = np.arange(len(normals)) >= len(target)
    agrees = float(np.nan_to_num(share_on_surfaces(np.concatenate([target, back]), normals, own)))
    middle, least = target.mean(axis=0), 0.5  # .57 to .81 in 48 rows
    away = float(np.linalg.norm(middle - transform_points(inverse(T_then_now), middle[None])[0]))
    if agrees < least or away > SEARCH_ALONG + SEARCH_ACROSS:
        raise _not_there(
            f"{agrees:.0%} of what is seen from here lies on it, {1e3 * away:.0f} mm away; at least {least:.0%} within "
            f"{1e3 * (SEARCH_ALONG + SEARCH_ACROSS):.0f} mm are expected"
        )


def _not_there(why: str) -> StageFailure:
    advice = "Drive by again, or check the side camera and its calibration."
    return StageFailure("no_plant_found", f"the plant is not where it was seen on the way: {why}. {advice}")
