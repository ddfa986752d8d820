"""Do the views agree, and if not, what is the likely cause? V views, H x W pixels, N points.

Wrong intrinsics or poses put a view's points where other views see through. How much of that there is tells right
captures from wrong ones; which change would make the views agree tells what is wrong with them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.capture import Capture
from anther.cloud._fusion import balances
from anther.geometry import Array, Intrinsics, inverse, transform_points

MOST_SEEN_THROUGH = 0.12
"""Share of what other views judge of a view's points that they see through, after registration, above which views
disagree. Measured: right captures 0.03 to 0.065 (simulated tomato and pepper, also with three times the arm's errors; a
real sorghum), focal lengths 20 % off 0.20 to 0.56 (docs/reports/confidence.md); this is the geometric middle of 0.065
and 0.20.
"""
ENOUGH = 200
"""Fewer judgements than this say nothing."""
JUDGED = 600
"""At most so many points of a view are judged."""
GREY = 8
"""Images whose channels differ by no more than this [grey levels] in 99 of 100 pixels have no colour."""
FOCAL = (0.5, 0.667, 0.75, 0.8, 0.9, 1.111, 1.25, 1.333, 1.5, 2.0)
"""Focal lengths that are tried, over the given one: a tenth to a third off, or of images of half or twice the size."""
LEAST_GAIN = 0.1
"""A change is the cause if it makes so much more of what the views could judge agree [-], and twice as much."""
OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def seen_through(
    points_cam: Sequence[Array], poses: Array, depth: NDArray[Any], intrinsics: Intrinsics
) -> tuple[float, int]:
    """Return the share of judgements by which other views see through a view's points, and how many there are.

    A view judges a point of another if it sees something there: at the point's depth, or at least `SEEN_THROUGH` [m]
    behind it in all pixels around (`fusion.agreeing_points`).

    Args:
        points_cam: per view (N_v, 3) points in its camera frame [m].
        poses: (V, 4, 4) T_world_cam.
        depth: (V, H, W) [m].
        intrinsics: of all views.
    """
    supports = contradictions = 0
    for view, points in enumerate(points_cam):
        few = points[:: max(1, len(points) // JUDGED)]
        world = transform_points(poses[view], few)
        for other in range(len(poses)):
            if other != view and len(few):
                judged = balances(world, depth[other], intrinsics, poses[other])
                supports, contradictions = supports + int((judged > 0).sum()), contradictions + int((judged < 0).sum())
    count = supports + contradictions
    return (contradictions / count if count else 0.0), count


def disagreement(
    capture: Capture, points_cam: Sequence[Array], poses: Array, used: NDArray[np.bool_]
) -> tuple[tuple[str, ...], float]:
    """Return what to tell the user of views that disagree, and the share of `seen_through`; nothing and 0 else.

    Args:
        capture: the views.
        points_cam: per view (N_v, 3) the plant's points in its camera frame [m].
        poses: (V, 4, 4) after registration.
        used: (V,) which views take part.
    """
    views = np.flatnonzero(used).tolist()
    if len(views) < 2:
        return (), 0.0
    points = [points_cam[v] for v in views]
    share, count = seen_through(points, poses[views], capture.depth[views], capture.intrinsics)
    if count >= ENOUGH and share <= MOST_SEEN_THROUGH:
        return (), 0.0
    cause = likely_cause(capture, points_cam if count >= ENOUGH else None)
    if count < ENOUGH:
        return ((f"the views hardly see the same of the plant: none confirms another. {cause}",) if cause else ()), 0.0
    return (
        f"the views disagree: where one sees the plant, others see through it in {share:.0%} of all cases; at most "
        f"{MOST_SEEN_THROUGH:.0%} where intrinsics and poses are right. "
        f"{cause or 'Check the intrinsics, and that every image has its own pose.'}",
    ), share


def likely_cause(capture: Capture, points_cam: Sequence[Array] | None = None) -> str:
    """Return what is probably wrong with a capture, as a sentence for the user, or nothing where nothing stands out.

    The views are compared as given, with other focal lengths, with the camera's axes of the other convention (OpenCV: y
    down, z forward; OpenGL: y up, z backward), and with each pose inverted.

    Args:
        capture: the views, with the poses as given.
        points_cam: per view (N_v, 3) what is compared, in its camera frame [m]; None: all that the views see.
    """
    if capture.rgb is not None and _is_grey(capture.rgb):
        return (
            "The images are grey: plants are found by their colour. Give colour images, or leave file_path out of "
            "every frame, and shape alone is used."
        )
    points = _all_points(capture) if points_cam is None else points_cam
    given = _agreement(capture, points)
    tried = [(_agreement(changed, scaled), words) for changed, scaled, words in _changes(capture, points)]
    best, words = max(tried, key=lambda found: found[0])
    return words if best > max(2 * given, given + LEAST_GAIN) else ""


def _is_grey(rgb: NDArray[Any]) -> bool:
    spread = np.ptp(rgb[:, ::4, ::4], axis=-1)
    return bool((spread <= GREY).mean() > 0.99)


def _changes(capture: Capture, points: Sequence[Array]) -> Iterator[tuple[Capture, Sequence[Array], str]]:
    """Yield captures and points as they would be without a common mistake, and what to tell the user of it."""
    T, flip, k = capture.T_world_cam, OPENGL_TO_OPENCV, capture.intrinsics
    yield (
        replace(capture, T_world_cam=T @ flip),
        points,
        "They would agree if the cameras' axes were of the other convention: transform_matrix wants OpenGL's (y up, z "
        "backward), were OpenCV's (y down, z forward) written? Then negate its second and third column.",
    )
    for poses in (inverse(T), inverse(T @ flip), inverse(T @ flip) @ flip):
        yield (
            replace(capture, T_world_cam=poses),
            points,
            "They would agree if every pose were inverted: transform_matrix maps from the camera to the world.",
        )
    for share in FOCAL:
        yield (
            replace(capture, intrinsics=replace(k, fx=k.fx * share, fy=k.fy * share)),
            [p / [share, share, 1.0] for p in points],
            f"They would agree better with a focal length near {k.fx * share:.0f} px instead of {k.fx:.0f} px: are the "
            "intrinsics those of this camera, and of this size of its images?",
        )


def _all_points(capture: Capture) -> list[Array]:
    step = max(1, round((capture.depth[0].size / JUDGED) ** 0.5))
    coarse = np.zeros(capture.depth[0].shape, dtype=bool)
    coarse[step // 2 :: step, step // 2 :: step] = True
    return [capture.intrinsics.back_project(view, coarse & (view > 0)) for view in capture.depth]


def _agreement(capture: Capture, points: Sequence[Array]) -> float:
    """Return how many judgements support, less those that contradict, as a share of all that there could be."""
    share, count = seen_through(points, capture.T_world_cam, capture.depth, capture.intrinsics)
    could = (capture.views - 1) * sum(len(p[:: max(1, len(p) // JUDGED)]) for p in points)
    return count * (1 - 2 * share) / max(1, could)
