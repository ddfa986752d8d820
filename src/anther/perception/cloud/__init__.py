"""Cloud: one coloured, labelled point cloud of the plant in the world frame. N points, M obstacle points.

Masked depth is freed of flying pixels, the views are registered jointly (`_registration.py`), fused in voxels, checked
against what other views see, and reduced to the plant (`_fusion.py`). What is not plant becomes coarse obstacles.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anther.core.checks import check_array
from anther.core.errors import StageFailure
from anther.core.files import understood
from anther.core.geometry import Array, Box, Intrinsics, transform_points
from anther.core.records import UNSAVED, Range, Record, Shape, Stored, decode, read_tree
from anther.perception.capture import Capture, View, in_threads, viewed_box
from anther.perception.cloud import _registration
from anther.perception.cloud._fusion import (
    GAP,
    SurfacePoints,
    agreeing_points,
    attached_points,
    fuse_voxels,
    occupied_cells,
    surface_pixels,
)
from anther.perception.cloud._seen_again import find_again
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
from anther.perception.masks import BACKGROUND, LEAST_PIXELS, Masks, observed

__all__ = ["Cloud", "Params", "Support", "Surface", "fuse", "likely_cause", "moved_since", "surface"]

Progress = Callable[[int, int], None]
"""Called with the number of steps done and of all."""
SUPPORT = 3
"""Label of a support's points in a PLY file, beside the masks' `PLANT` and `FLOWER`."""


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
class Support(Record):
    """A string, wire, stake or pole beside the plant: a rod that is not plant (`supports.find_supports`).

    It is geometry, an obstacle; what holds rods in mechanics is `anther.rods.Support`.

    Attributes:
        kind: what it is, by how thick it is; a thin one by whether it is upright.
        axis: (K, 3) along its middle, from end to end [m].
        radius: [m].
        points: (N, 3) of its surface [m].
    """

    CALLED = "support"
    kind: Literal["string", "wire", "stake", "pole"]
    axis: Annotated[Array, Shape("K", 3), Range(unit="m")]
    radius: Annotated[float, Range(0, 1, "m")]
    points: Annotated[Array, Shape("N", 3), Range(unit="m")]

    @property
    def soft(self) -> bool:
        """Whether it may be held together with a stem: a string."""
        return self.kind == "string"

    @property
    def name(self) -> str:
        """What it is and how thick, for people."""
        return f"a {self.kind} of {2e3 * self.radius:.0f} mm"

    def balls(self, apart: float) -> Array:
        """Return (B, 4) centres and radii of balls that fill it, at most so far apart [m]."""
        length = np.append(0, np.cumsum(np.linalg.norm(np.diff(self.axis, axis=0), axis=1)))
        at = np.linspace(0, length[-1], int(np.ceil(length[-1] / apart)) + 1)
        centres = [np.interp(at, length, column) for column in self.axis.T]
        return np.column_stack([*centres, np.full(len(at), self.radius)])

    def scaled(self, factor: float) -> Support:
        """Return it so many times as large, about the world's origin."""
        return Support(self.kind, factor * self.axis, factor * self.radius, factor * self.points)

    def moved(self, T: Array) -> Support:
        """Return it moved by T (4, 4)."""
        return Support(self.kind, transform_points(T, self.axis), self.radius, transform_points(T, self.points))


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
        supports: strings, stakes, poles, whose points are not among `points` (`supports.find_supports`).
        loose: (L, 3) of plants' surface that is seen connected to no plant [m]: mostly leaves before it.
    """

    KIND, SCHEMA = "cloud", 5
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
    supports: tuple[Support, ...] = ()
    loose: Annotated[Array, Shape("L", 3), Range(unit="m")] = field(default_factory=lambda: np.zeros((0, 3)))

    def _check(self) -> None:
        if self.labels is None:
            labels = np.ones(len(self.points), dtype=np.uint8)
            labels.flags.writeable = False
            object.__setattr__(self, "labels", labels)

    @property
    def rigid(self) -> Array:
        """(M, 3) points of what the arm must never touch [m]: obstacles, and supports but strings."""
        return np.concatenate([self.obstacles, *(s.points for s in self.supports if not s.soft)])

    @property
    def yielding(self) -> Array:
        """(N, 3) points of what gives way [m]: plants, what is loose, and strings."""
        return np.concatenate([self.points, self.loose, *(s.points for s in self.supports if s.soft)])

    def moved(self, T: Array) -> Cloud:
        """Return all of it moved by T (4, 4)."""
        return replace(
            self,
            points=transform_points(T, self.points),
            normals=None if self.normals is None else self.normals @ T[:3, :3].T,
            obstacles=transform_points(T, self.obstacles),
            T_world_cam=None if self.T_world_cam is None else T @ self.T_world_cam,
            supports=tuple(support.moved(T) for support in self.supports),
            loose=transform_points(T, self.loose),
        )

    def save(self, path: Path | str) -> None:
        """Write all points as binary PLY (labels as a vertex property) and the rest as .npz of the same name."""
        path, more = Path(path), sum(len(s.points) for s in self.supports)
        all_points = np.concatenate([self.points, *(s.points for s in self.supports)])

        def filled(values: NDArray[Any] | None, value: float) -> NDArray[Any] | None:
            if values is None:
                return None
            return np.concatenate([values, np.full((more, *values.shape[1:]), value, dtype=values.dtype)])

        labels = filled(self.labels, SUPPORT)
        write_ply(path, all_points, normals=filled(self.normals, 0), colors=filled(self.colors, 128), labels=labels)
        Stored.save(self, path.with_suffix(".npz"))

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Read what `save` wrote. A PLY without its .npz is read as well: no poses or notes then, and supports are
        obstacles.

        Raises:
            InputError: a file is missing, truncated or holds something else.
        """
        path = Path(path)
        points = {name: value for name, value in read_ply(path).items() if name not in ("unused", "comments")}
        support = np.zeros(0, np.int64) if points["labels"] is None else np.flatnonzero(points["labels"] == SUPPORT)
        aside = points["points"][support]
        own: dict[str, Any] = {
            name: None if values is None else np.delete(values, support, axis=0) for name, values in points.items()
        }
        rest = path.with_suffix(".npz")
        with understood(rest):
            if rest.exists():
                return decode(own | read_tree(rest, cls.KIND, cls.SCHEMA), cls)
            return cls(**own, obstacles=aside)


def fuse(
    capture: Capture,
    masks: Masks,
    workspace: Box | None = None,
    params: Params | None = None,
    progress: Progress | None = None,
    surfaces: Sequence[Surface] = (),
) -> Cloud:
    """Return one cloud of the plant from all views.

    Args:
        capture: the views.
        masks: of the same views.
        workspace: where the plant may be, world frame [m]; None means `capture.viewed_box`.
        params: see `Params`.
        progress: called after each of five steps.
        surfaces: that each view shows in this workspace, where they were found as it came; none: they are found now.

    Raises:
        StageFailure: `no_plant_found` when masks or depth leave too few points.
        InputError: masks and capture differ in shape.
    """
    params = params or Params()
    box = workspace or viewed_box(capture)
    obstacle_voxel = 0.01  # m
    box.cells(obstacle_voxel, 1e8)  # of 28 bytes each
    labels = check_array("mask labels", masks.labels, capture.depth.shape, dtype="uint8")
    report = _steps(progress, 5)
    pixels = plant_pixels(capture, labels, box, surfaces)
    _require(sum(len(p.points) for p in pixels), "pixels with depth within the masks, within the workspace")
    report()
    notes = _unseen_views(pixels)
    with ThreadPoolExecutor(1) as beside:
        of_views = beside.submit(_notes_of_views, capture, labels)
        poses, found = _registered(pixels, capture.T_world_cam, params)
        notes += of_views.result()
        report()
        fused = fuse_voxels(pixels, poses, box, params.voxel)
        _require(len(fused.points), "points within the workspace")
        used = np.ones(capture.views, dtype=bool) if found is None else found.used
        seen = [capture.depth[v] for v in np.flatnonzero(used)]
        fused = fused.only(agreeing_points(fused.points, seen, capture.intrinsics, poses[used]))
        report()
        refuse_ground(fused.points, box)
        rest = beside.submit(_background, capture, labels, poses, box, np.flatnonzero(used))
        doubts = beside.submit(find_disagreement, capture, [p.points for p in pixels], poses, used)
        kept = attached_points(fused.points)
        notes += warn_of_cloud(fused.points, kept, box) + warn_of_coverage(fused.points[kept].mean(axis=0), poses[used])
        loose, fused = fused.points[~kept], fused.only(kept)
        _require(len(fused.points), "connected points")
        report()
        obstacles = occupied_cells(*rest.result(), fused.points, obstacle_voxel)
        warnings, through = doubts.result()
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
        loose=loose,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """What one view shows of surfaces in and near the workspace, plant or not. N pixels.

    Attributes:
        pixels: (N,) int32 where in the image, counted along the rows; flying pixels are left out.
        normals: (N, 3) float32 unit, towards the camera.
    """

    pixels: NDArray[np.int32]
    normals: NDArray[np.float32]


def surface(view: View, workspace: Box) -> Surface:
    """Return the surfaces that a view shows: what `fuse` can know of it before it knows the others.

    Pixels farther outside the workspace than a wrong pose is searched for are left out.
    """
    near = np.zeros(view.depth.shape, dtype=bool)
    near.ravel()[observed(view._replace(rgb=None), _wide(workspace)).pixels] = True
    return _surface(view, near)


def moved_since(cloud: Cloud, stem: Array, view: View, workspace: Box) -> Array:
    """Return T_now_then (4, 4), which moves a plant seen on a cart's way to where a view from where it stands has it.

    Args:
        cloud: of the views that were taken on the way.
        stem: (K, 3) along the plant's main stem there [m].
        view: taken where the cart stands, its pose known.
        workspace: where the plant may be, world [m].

    Raises:
        StageFailure: "no_plant_found": the view does not show what was seen.
    """
    points = transform_points(view.T_world_cam, view.intrinsics.points(view.depth, surface(view, workspace).pixels))
    assert cloud.T_world_cam is not None, "it was seen by a camera"
    way = cloud.T_world_cam[-1, :3, 3] - cloud.T_world_cam[0, :3, 3]
    seen = np.concatenate([cloud.points, cloud.loose, *(support.points for support in cloud.supports)])
    own = 0.12  # m from the stem: what is farther may be a neighbour's, and each plant sways by itself
    near = np.isfinite(KDTree(stem).query(seen, distance_upper_bound=own)[0])
    return find_again(seen[near], way, points[workspace.contains(points)])


def _surface(view: View, mask: NDArray[np.bool_]) -> Surface:
    keep, normals = surface_pixels(view.depth, mask, view.intrinsics)
    return Surface(np.flatnonzero(keep).astype(np.int32), normals)


def _wide(workspace: Box) -> Box:
    return Box(workspace.lower - SEARCH, workspace.upper + SEARCH)


def plant_pixels(
    capture: Capture, labels: NDArray[Any], box: Box, surfaces: Sequence[Surface] = ()
) -> list[SurfacePoints]:
    """Return every view's plant pixels as points of its camera frame, flying pixels left out.

    Args:
        capture: the views.
        labels: (V, H, W) of the masks.
        box: the workspace [m]; pixels farther outside than a wrong pose is searched for are left out.
        surfaces: see `fuse`.
    """

    wide = _wide(box)

    def of_view(number: int) -> SurfacePoints:
        view, own = capture.view(number), labels[number].ravel()
        shown = surfaces[number] if surfaces else _surface(view, labels[number] != BACKGROUND)
        plant = np.flatnonzero(own[shown.pixels] != BACKGROUND)
        pixels = shown.pixels[plant]
        colors = np.zeros((len(pixels), 3), np.uint8) if view.rgb is None else view.rgb.reshape(-1, 3)[pixels]
        points = view.intrinsics.points(view.depth, pixels)
        near = wide.contains(transform_points(view.T_world_cam, points))
        return SurfacePoints(points, shown.normals[plant], own[pixels], colors).only(near)

    return in_threads(of_view, range(capture.views))


def _registered(
    pixels: list[SurfacePoints], given: Array, params: Params
) -> tuple[Array, _registration.Registration | None]:
    """Return the poses and the registration; free the pixels, in place, of the sensor's bias (none of views to leave
    out). So no pixel is in memory twice."""
    if params.registration is None:
        return given, None
    found = _registration.register([p.points for p in pixels], given, params.registration)

    def correct(view: int) -> None:
        own = pixels[view]
        pixels[view] = own.unbiased(found.reach) if found.used[view] else own.only(np.array([], dtype=int))

    in_threads(correct, range(len(pixels)))
    return found.T_world_cam, found


def _notes_of_views(capture: Capture, labels: NDArray[Any]) -> tuple[str, ...]:
    covered = describe_depth(capture.depth, labels != BACKGROUND, capture.intrinsics.fx, only_poor=True)
    return (*warn_of_views(capture.depth, labels), *filter(None, [covered]))


def _background(
    capture: Capture, labels: NDArray[Any], poses: Array, box: Box, used: NDArray[Any]
) -> tuple[Array, NDArray[Any]]:
    """Return coarse points (N, 3) [m] of what is not plant within the box, and the view (N,) that each is of."""
    k, step = capture.intrinsics, max(1, round(capture.intrinsics.fx / 160))
    rows = np.s_[::step, ::step]
    height, width = capture.depth[0][rows].shape
    coarse = Intrinsics(width, height, k.fx / step, k.fy / step, k.cx / step, k.cy / step)

    def background(view: int) -> Array:
        depth = capture.depth[view][rows]
        world = transform_points(poses[view], coarse.back_project(depth, labels[view][rows] == BACKGROUND))
        return world[box.contains(world)]

    points = in_threads(background, used.tolist())
    return np.concatenate(points), np.repeat(used, [len(p) for p in points])


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
