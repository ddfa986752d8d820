"""Warnings: blind views, a plant cut off or left out, masks that hold the ground, and views that disagree.

Wrong intrinsics or poses put a view's points where other views see through. Its share separates right captures
from wrong ones; the change that would make the views agree names the cause.
Every check returns a sentence for the user, or nothing. V views, H x W pixels, N points.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core.errors import InputError, StageFailure
from anther.core.geometry import Array, Box, Intrinsics, inverse, transform_points
from anther.perception.capture import OPENGL_TO_OPENCV, Capture, in_threads
from anther.perception.cloud._fusion import balances


def warn_of_views(depth: NDArray[Any], labels: NDArray[Any]) -> tuple[str, ...]:
    """Return which views are blind or blocked, by number, of depth (V, H, W) [m] and the masks' labels (V, H, W).

    A blind view has less than 0.3 of the median view's readings; in a blocked one something at less than 0.4 of the
    plant's distance covers 0.15 of the image.
    """
    thin, nearest, farthest = depth[:, ::4, ::4].copy(), 0.05, 10.0  # a D405 measures from 0.09 m (facts: perception)
    usable = (thin > nearest) & (thin < farthest)
    seen = usable.mean(axis=(1, 2))
    plant = thin[usable & (labels[:, ::4, ::4] > 0)]
    close = 0.4 * float(np.median(plant)) if len(plant) else 0.0
    near = ((thin > 0) & (thin < close)).mean(axis=(1, 2))
    blind = [
        f"view {v}: the depth image is blind ({seen[v]:.0%} of it reads {nearest:g} to {farthest:g} m)"
        for v in np.flatnonzero(seen < 0.3 * np.median(seen))
    ]
    blocked = [
        f"view {v}: something nearer than {close:.2f} m covers {near[v]:.0%} of the image"
        for v in np.flatnonzero(near > 0.15)
    ]
    return (*blind, *blocked)


def warn_of_coverage(centre: Array, T_world_cam: Array) -> tuple[str, ...]:
    """Return whether the cameras (V, 4, 4) are fewer than 4, or see the plant's centre (3,) [m] from one side only."""
    if len(T_world_cam) < 4:
        return (f"only {len(T_world_cam)} views show the plant: how deep its organs are is half guessed",)
    away = T_world_cam[:, :2, 3] - centre[:2]
    azimuth = np.sort(np.degrees(np.arctan2(away[:, 1], away[:, 0])))
    arc = 360 - float(np.diff(azimuth, append=azimuth[0] + 360).max())
    if arc >= 100:  # a guess
        return ()
    return (
        f"the views see the plant from one side only, over {arc:.0f} degrees: how deep its organs are is half guessed",
    )


def refuse_ground(points: Array, box: Box) -> None:
    """Refuse points (N, 3) [m] most of which are bench or soil.

    Raises:
        StageFailure: `no_plant_found`, when a level layer of 10 mm holds a quarter of the points and spreads over a
            fifth of the workspace.
    """
    slab = 0.01
    level = np.floor((points[:, 2] - box.lower[2]) / slab).astype(np.int64)
    fullest = int(np.argmax(np.bincount(level)))
    within = points[level == fullest]
    cells = np.unique(np.floor(within[:, :2] / slab), axis=0)
    area = len(cells) * slab**2 / float(np.prod((box.upper - box.lower)[:2]))
    if len(within) >= 0.25 * len(points) and area >= 0.2:
        raise StageFailure(
            "no_plant_found",
            f"cloud: {len(within) / len(points):.0%} of what the masks call plant is one level surface over {area:.0%} "
            f"of the workspace, at z = {within[:, 2].mean():.3f} m: bench or soil. Are the masks inverted?",
        )


def warn_of_cloud(points: Array, kept: NDArray[np.bool_], box: Box) -> tuple[str, ...]:
    """Return whether the workspace cuts the plant, the `kept` of all points (N, 3) [m], and whether a second object is
    in it."""
    return (*_cut(points[kept], box), *_left_out(points, kept))


def _cut(plant: Array, box: Box) -> tuple[str, ...]:
    """Return a note where 0.5 % of the plant's points lie within 4 mm of a face of the workspace."""
    faces = np.stack([plant - box.lower, box.upper - plant])
    at_edge = (faces < 0.004).mean(axis=1)
    side, axis = np.unravel_index(int(np.argmax(at_edge)), at_edge.shape)
    if at_edge.max() < 0.005:
        return ()
    limit = (box.lower, box.upper)[side][axis]
    return (
        f"{at_edge.max():.1%} of the plant's points lie at the workspace's edge {'xyz'[axis]} = {limit:.2f} m: "
        "the plant is cut off there; move it or enlarge the workspace",
    )


def _left_out(points: Array, kept: NDArray[np.bool_]) -> tuple[str, ...]:
    """Return a note where 3 % of the points, over 80 mm, are left out."""
    rest = points[~kept]
    if len(rest) < 0.03 * len(points):
        return ()
    centre = np.median(rest, axis=0)
    size = float(np.linalg.norm(np.subtract(*np.quantile(rest, [0.9, 0.1], axis=0))))
    if size < 0.08:
        return ()
    return (
        f"{len(rest) / len(points):.0%} of the points are loosely connected to the plant and were left out, around "
        f"x, y, z = {centre[0]:.2f}, {centre[1]:.2f}, {centre[2]:.2f} m: a second plant?",
    )


JUDGED = 600
"""At most so many points of a view are judged: more take time."""


def seen_through(
    points_cam: Sequence[Array], poses: Array, depth: Sequence[NDArray[Any]] | NDArray[Any], intrinsics: Intrinsics
) -> tuple[float, int]:
    """Return the share of judgements by which other views see through a view's points, and how many there are.

    A view judges a point of another if it sees something there: at the point's depth, or at least `SEEN_THROUGH` [m]
    behind it in all pixels around (`_fusion.balances`). Points of a view (N_v, 3) are in its camera frame [m].
    """
    few = [points[:: max(1, len(points) // JUDGED)] for points in points_cam]
    world = np.concatenate([transform_points(T, points) for T, points in zip(poses, few, strict=True)])
    view = np.repeat(np.arange(len(few)), [len(points) for points in few])

    def judgements(other: int) -> NDArray[np.int64]:
        judged = balances(world[view != other], depth[other], intrinsics, poses[other])
        return np.array([(judged < 0).sum(), (judged != 0).sum()])

    contradictions, count = sum(in_threads(judgements, range(len(poses))), np.zeros(2, dtype=np.int64)).tolist()
    return (contradictions / count if count else 0.0), count


def find_disagreement(
    capture: Capture, points_cam: Sequence[Array], poses: Array, used: NDArray[np.bool_]
) -> tuple[tuple[str, ...], float]:
    """Return notes on views that disagree, and the share of `seen_through`; nothing and 0 where they agree.

    Points of a view (N_v, 3) are in its camera frame [m]; the poses (V, 4, 4) are those after registration.
    """
    views = np.flatnonzero(used).tolist()
    if len(views) < 2:
        return (), 0.0
    points = [points_cam[v] for v in views]
    depth = [capture.depth[v] for v in views]  # no copy
    share, count = seen_through(points, poses[views], depth, capture.intrinsics)
    enough = count >= 200  # judgements; fewer are no evidence
    most = 0.12  # between right captures 0.065, with focal lengths 20 % off 0.20 (docs/reports/confidence.md)
    if enough and share <= most:
        return (), 0.0
    cause = likely_cause(capture, points_cam if enough else None)
    if not enough:
        return ((f"the views hardly see the same of the plant: none confirms another. {cause}",) if cause else ()), 0.0
    return (
        f"the views disagree: where one sees the plant, others see through it in {share:.0%} of all cases; at most "
        f"{most:.0%} where intrinsics and poses are right. "
        f"{cause or 'Check the intrinsics, and that every image has its own pose.'}",
    ), share


def likely_cause(capture: Capture, points_cam: Sequence[Array] | None = None) -> str:
    """Return what is probably wrong with a capture, as a sentence for the user; "" where no cause is clear.

    The views are compared as given, with other focal lengths, with depth in other steps, with the camera's axes of the
    other convention (OpenCV: y down, z forward; OpenGL: y up, z backward), and with each pose inverted. The cause is
    what makes twice as many judgements agree, and a tenth more of all that there could be.

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
    return words if best > max(2 * given, given + 0.1) else ""


def _is_grey(rgb: NDArray[Any]) -> bool:
    """Return whether the channels differ by no more than noise, 8 grey levels, in 99 of 100 pixels."""
    spread = np.ptp(rgb[:, ::4, ::4], axis=-1)
    return bool((spread <= 8).mean() > 0.99)


def _changes(capture: Capture, points: Sequence[Array]) -> Iterator[tuple[Capture, Sequence[Array], str]]:
    """Yield captures and points as they would be without a common mistake, and a note on it."""
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
    for times in (0.1, 0.25, 4.0, 10.0):  # steps of 0.1 or 0.25 mm taken for 1 mm, or the other way round
        try:
            scaled = replace(capture, depth=capture.depth * np.float32(times))
        except InputError:  # no plausible depth
            continue
        yield (
            scaled,
            [p * times for p in points],
            f"They would agree if depth were {times:g} times what it is: is depth_unit_scale_factor in transforms.json "
            "right? It gives metres per step of the depth image, by default 0.001.",
        )
    for share in (0.5, 2 / 3, 0.75, 0.8, 0.9, 1 / 0.9, 1.25, 4 / 3, 1.5, 2.0):  # 2: of images of half the size
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
