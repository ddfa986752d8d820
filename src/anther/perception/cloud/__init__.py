"""Cloud: one coloured, labelled point cloud of the plant in the world frame. N points, M obstacle points.

Masked depth is freed of flying pixels, the views are registered jointly (`_registration.py`), fused in voxels, checked
against what other views see, and reduced to the plant (`_fusion.py`). What is not plant becomes coarse obstacles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray

from anther.core.checks import check_array
from anther.core.errors import StageFailure
from anther.core.files import understood
from anther.core.geometry import Array, Box, Intrinsics, transform_points
from anther.core.records import UNSAVED, Range, Record, Shape, Stored, decode, read_tree
from anther.perception.capture import Capture, in_threads, viewed_box
from anther.perception.cloud import _registration
from anther.perception.cloud._fusion import (
    GAP,
    SurfacePoints,
    agreeing_points,
    attached_points,
    fuse_voxels,
    occupied_cells,
    pixel_normals,
    supported_pixels,
)
from anther.perception.cloud._warnings import (
    find_disagreement,
    likely_cause,
    refuse_ground,
    warn_of_cloud,
    warn_of_coverage,
    warn_of_views,
)
from anther.perception.cloud._wrong_views import SEARCH
from anther.perception.cloud.ply import read_ply, write_ply
from anther.perception.coverage import describe_depth
from anther.perception.masks import BACKGROUND, LEAST_PIXELS, Masks

__all__ = ["Cloud", "Params", "fuse", "likely_cause"]

Progress = Callable[[int, int], None]
"""Called with the number of steps done and of all."""
OBSTACLE_VOXEL = 0.01
"""Spacing of the obstacle points [m]."""


@dataclass(frozen=True, slots=True)
class Params(Record):
    """How the views become one cloud.

    Attributes:
        voxel: spacing of the cloud [m].
        registration: see `registration.Params`; None keeps the arm's own poses.
    """

    CALLED = "cloud"
    voxel: Annotated[float, Range(0.0002, GAP, "m")] = 0.0015
    registration: _registration.Params | None = field(default_factory=_registration.Params)


@dataclass(frozen=True, slots=True, eq=False)
class Cloud(Stored):
    """The plant as points in the world frame (z up), and what else the arm must not touch.

    Attributes:
        points: (N, 3) plant points [m].
        normals: (N, 3) unit normals, or None.
        colors: (N, 3) uint8, or None.
        labels: (N,) uint8: `masks.PLANT` or `masks.FLOWER`.
        obstacles: (M, 3) coarse points [m] of pot, soil and bench.
        T_world_cam: (V, 4, 4) camera poses after registration, or None for an imported cloud.
        notes: what the stage wants the user to know (warnings, registration declined, ...).
        view_agreement: (V,) share of each view's points that lie on a surface other views see, 0..1, after
            registration; NaN where too little is seen; None without registration.
        view_used: (V,) bool, false for views left out because the others contradict their pose; None if imported.
        footprint: median width of a pixel at the plant [m]; None if imported.
        seen_through: share of what views judge of each other's points that they see through, 0..1, where that is more
            than right captures have (`_warnings.find_disagreement`); else 0.
    """

    KIND, SCHEMA = "cloud", 3
    points: Annotated[Array, Shape("N", 3), Range(unit="m"), UNSAVED]
    normals: Annotated[Array, Shape("N", 3), UNSAVED] | None = None
    colors: Annotated[NDArray[np.uint8], Shape("N", 3), UNSAVED] | None = None
    labels: Annotated[NDArray[np.uint8], Shape("N"), UNSAVED] | None = None
    obstacles: Annotated[Array, Shape("M", 3), Range(unit="m")] = field(default_factory=lambda: np.zeros((0, 3)))
    T_world_cam: Annotated[Array, Shape("V", 4, 4, rigid=True), Range(unit="m")] | None = None
    notes: tuple[str, ...] = ()
    view_agreement: Annotated[Array, Shape(None, missing=True)] | None = None
    view_used: Annotated[NDArray[np.bool_], Shape(None)] | None = None
    footprint: Annotated[float, Range(unit="m")] | None = None
    seen_through: float = 0.0

    def _check(self) -> None:
        if self.labels is None:
            labels = np.ones(len(self.points), dtype=np.uint8)
            labels.flags.writeable = False
            object.__setattr__(self, "labels", labels)

    def save(self, path: Path | str) -> None:
        """Write the points as binary PLY (labels as a vertex property) and the rest as .npz of the same name."""
        path = Path(path)
        write_ply(path, self.points, normals=self.normals, colors=self.colors, labels=self.labels)
        Stored.save(self, path.with_suffix(".npz"))

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Read what `save` wrote. A PLY without its .npz is read as well: no obstacles, poses or notes then.

        Raises:
            InputError: a file is missing, truncated or holds something else.
        """
        path = Path(path)
        points = {name: value for name, value in read_ply(path).items() if name not in ("unused", "comments")}
        rest = path.with_suffix(".npz")
        with understood(rest):
            return decode(points | read_tree(rest, cls.KIND, cls.SCHEMA), cls) if rest.exists() else cls(**points)


def fuse(
    capture: Capture,
    masks: Masks,
    workspace: Box | None = None,
    params: Params | None = None,
    progress: Progress | None = None,
) -> Cloud:
    """Return one cloud of the plant from all views.

    Args:
        capture: the views.
        masks: of the same views.
        workspace: where the plant may be, world frame [m]; None means `capture.viewed_box`.
        params: see `Params`.
        progress: called after each of five steps.

    Raises:
        StageFailure: `no_plant_found` when masks or depth leave too few points.
        InputError: masks and capture differ in shape.
    """
    params = params or Params()
    box = workspace or viewed_box(capture)
    box.cells(OBSTACLE_VOXEL, 1e8)  # of 28 bytes each
    labels = check_array("mask labels", masks.labels, capture.depth.shape, dtype="uint8")
    report = _steps(progress, 5)
    pixels = plant_pixels(capture, labels, box)
    _require(sum(len(p.points) for p in pixels), "pixels with depth within the masks, within the workspace")
    report()
    covered = describe_depth(capture.depth, labels != BACKGROUND, capture.intrinsics.fx, only_poor=True)
    notes = (*_unseen_views(pixels), *warn_of_views(capture.depth, labels), *filter(None, [covered]))
    poses, pixels, found = _registered(pixels, capture.T_world_cam, params)
    report()
    fused = fuse_voxels(pixels, poses, box, params.voxel)
    _require(len(fused.points), "points within the workspace")
    used = np.ones(capture.views, dtype=bool) if found is None else found.used
    seen = [capture.depth[v] for v in np.flatnonzero(used)]
    warnings, through = find_disagreement(capture, [p.points for p in pixels], poses, used)
    fused = fused.only(agreeing_points(fused.points, seen, capture.intrinsics, poses[used]))
    report()
    refuse_ground(fused.points, box)
    kept = attached_points(fused.points)
    notes += warn_of_cloud(fused.points, kept, box) + warn_of_coverage(fused.points[kept].mean(axis=0), poses[used])
    fused = fused.only(kept)
    _require(len(fused.points), "connected points")
    report()
    obstacles = _background_cells(
        capture, labels, poses, box, plant=fused.points, voxel=OBSTACLE_VOXEL, used=np.flatnonzero(used)
    )
    report()
    return Cloud(
        fused.points,
        fused.normals,
        fused.colors if capture.rgb is not None else None,
        fused.labels,
        obstacles,
        poses,
        (*warnings, *(found.notes if found else ()), *notes),
        view_agreement=None if found is None else found.agreement,
        view_used=used,
        footprint=float(np.median(np.concatenate([p.points[:, 2] for p in pixels]))) / capture.intrinsics.fx,
        seen_through=through,
    )


def plant_pixels(capture: Capture, labels: NDArray[Any], box: Box) -> list[SurfacePoints]:
    """Return every view's plant pixels as points of its camera frame, flying pixels left out.

    Args:
        capture: the views.
        labels: (V, H, W) of the masks.
        box: the workspace [m]; pixels farther outside than a wrong pose is searched for are left out.
    """
    wide = Box(box.lower - SEARCH, box.upper + SEARCH)

    def of_view(view: int) -> SurfacePoints:
        depth = capture.depth[view]
        keep = supported_pixels(depth, labels[view] != BACKGROUND)
        rows = np.flatnonzero(keep)
        colors = np.zeros((len(rows), 3), np.uint8) if capture.rgb is None else capture.rgb[view].reshape(-1, 3)[rows]
        points = capture.intrinsics.back_project(depth, keep)
        normals = pixel_normals(depth, keep, capture.intrinsics)
        near = wide.contains(transform_points(capture.T_world_cam[view], points))
        return SurfacePoints(points, normals, labels[view].ravel()[rows], colors).only(near)

    return in_threads(of_view, range(capture.views))


def _registered(
    pixels: list[SurfacePoints], given: Array, params: Params
) -> tuple[Array, list[SurfacePoints], _registration.Registration | None]:
    """Return the poses, the pixels freed of the sensor's bias (none of views to leave out), and the registration."""
    if params.registration is None:
        return given, pixels, None
    found = _registration.register([p.points for p in pixels], given, params.registration)

    def corrected(view: int) -> SurfacePoints:
        return pixels[view].unbiased(found.reach) if found.used[view] else pixels[view].only(np.array([], dtype=int))

    return found.T_world_cam, in_threads(corrected, range(len(pixels))), found


def _background_cells(
    capture: Capture, labels: NDArray[Any], poses: Array, box: Box, *, plant: Array, voxel: float, used: NDArray[Any]
) -> Array:
    """Return coarse points of surfaces that are not plant: cells with many background pixels, seen in several views."""
    k, step = capture.intrinsics, max(1, round(capture.intrinsics.fx / 160))
    rows = np.s_[::step, ::step]
    height, width = capture.depth[0][rows].shape
    coarse = Intrinsics(width, height, k.fx / step, k.fy / step, k.cx / step, k.cy / step)

    def background(view: int) -> Array:
        depth = capture.depth[view][rows]
        world = transform_points(poses[view], coarse.back_project(depth, labels[view][rows] == BACKGROUND))
        return world[box.contains(world)]

    points = in_threads(background, used.tolist())
    views = np.repeat(used, [len(p) for p in points])
    return occupied_cells(np.concatenate(points), views, plant, voxel)


def _require(count: int, what: str) -> None:
    if count < LEAST_PIXELS:
        raise StageFailure(
            "no_plant_found",
            f"cloud: {count} {what}; at least {LEAST_PIXELS} are needed. Check the masks, the depth images "
            "and the workspace.",
        )


def _unseen_views(pixels: list[SurfacePoints]) -> tuple[str, ...]:
    empty = [str(v) for v, p in enumerate(pixels) if len(p.points) == 0]
    return (f"views without any plant pixel: {', '.join(empty)}",) if empty else ()


def _steps(progress: Progress | None, count: int) -> Callable[[], None]:
    done = iter(range(1, count + 1))
    return lambda: progress(next(done), count) if progress else None
