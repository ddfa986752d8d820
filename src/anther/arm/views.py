"""Viewpoints around a plant that the arm can reach, in an order that keeps the motion short. V views, C choices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from anther.arm import _kinematics, sharpness
from anther.arm._tours import shortest_tour
from anther.arm.model import ArmModel
from anther.arm.planner import SEARCH_STEP, Planner
from anther.arm.planner import Params as MotionParams
from anther.arm.sawyer import SAWYER
from anther.checks import check_array, check_range, check_transform
from anther.devices import JointTrajectory
from anther.errors import StageFailure
from anther.geometry import Array, Box, inverse, look_at

FAST = MotionParams(velocity_share=0.95, acceleration_share=0.85)
SEEN = 0.08  # m between the points of the region whose motion in the image is looked at
SEEDS, MORE_SEEDS = 12, 48  # of the inverse kinematics: to see whether a view can be reached, and to choose a way there
ELEVATIONS = (-5.0, 15.0, 35.0, 55.0)
"""Of the camera above its target [degrees]."""
HEIGHT_SHARES = (0.4, 0.65, 0.45, 0.6)
"""At which share of the region's height each elevation aims."""


@dataclass(frozen=True, slots=True)
class Params:
    """Where views are sought.

    Attributes:
        count: how many views.
        distances: of the camera from the plant's axis, in order of preference [m]; the D455 sees nothing nearer than
            0.48 m at 1280 x 720.
        azimuth_step: of the viewpoints tried [degrees].
        widest: greatest azimuth, to either side of the arm [degrees].
        first: azimuth and elevation near which the spread of directions begins [degrees]; None is the arm's side. It
            decides how evenly few views lie, and how short their tour can be.
        dwell: standing still for each image [s], for a camera that is asked for a frame when the arm has come to rest;
            None is as long as a camera that runs freely needs for a sharp one, see `sharpness`.
        camera: for how long that is.
    """

    count: int = 30
    distances: tuple[float, ...] = (0.65, 0.58, 0.52)
    azimuth_step: float = 7.5
    widest: float = 180.0
    first: tuple[float, float] | None = None
    dwell: float | None = None
    camera: sharpness.Params = field(default_factory=sharpness.Params)

    def __post_init__(self) -> None:
        check_range("views", self.count, 1, 500)
        check_range("azimuth step", self.azimuth_step, 1, 90, "degrees")
        check_range("widest azimuth", self.widest, 0, 180, "degrees")
        check_range("nearest view", min(self.distances), 0.2, 2, "m")


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """The views in the order they are taken.

    Attributes:
        joints: (V, J) [rad].
        T_world_cam: (V, 4, 4) camera poses by kinematics and hand-eye calibration, as far as the planner knows them.
        motions: V motions; the first starts at the start joints.
        azimuth: (V,) of the camera around the plant's vertical axis [degrees]; 0 is the side of the arm,
            positive turns counterclockwise seen from above.
        elevation: (V,) of the camera above its target [degrees].
        dwell: (V,) standing still for each image [s].
    """

    joints: Array
    T_world_cam: Array
    motions: tuple[JointTrajectory, ...]
    azimuth: Array
    elevation: Array
    dwell: Array

    def __post_init__(self) -> None:
        n = len(self.joints)
        object.__setattr__(self, "joints", check_array("view joints", self.joints, (n, None)))
        object.__setattr__(self, "dwell", check_array("dwell", self.dwell, (n,)))
        object.__setattr__(self, "T_world_cam", check_transform("T_world_cam", self.T_world_cam, n))


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoints:
    """Views that the arm can reach, to choose from.

    Attributes:
        branches: V arrays (C, J) of free joints [rad] that hold the camera there, upright or upside down.
        azimuth, elevation: (V,) as in `Views` [degrees].
        T_flange_cam: (4, 4) hand-eye calibration.
        arm: that reaches them.
    """

    branches: tuple[Array, ...]
    azimuth: Array
    elevation: Array
    T_flange_cam: Array
    arm: ArmModel

    @property
    def T_world_cam(self) -> Array:
        """(V, 4, 4) camera poses, each by its first branch."""
        return self.arm.forward(np.array([choices[0] for choices in self.branches])) @ self.T_flange_cam

    def spread(self, count: int, first: tuple[float, float] | None = None) -> list[int]:
        """Return up to `count` of the views, each the farthest in direction from those before; see `Params.first`."""
        rays = _unit_rays(np.stack([self.azimuth, self.elevation], axis=1))
        return _spread(rays, count, np.array([1.0, 0, 0]) if first is None else _unit_rays(np.array([first]))[0])


def plan_views(
    region: Box,
    boxes: Sequence[Box] = (),
    params: Params = Params(),
    *,
    start: ArrayLike | None = None,
    T_flange_cam: ArrayLike | None = None,
    motion: MotionParams | None = None,
    arm: ArmModel = SAWYER,
) -> Views:
    """Return reachable, collision-free views all around the side of the plant that the arm can reach.

    Viewpoints on a grid of azimuth and elevation look at the region's axis, upright or upside down; those with a free
    IK branch are kept and thinned out to `count` that are farthest apart. Order and branches are then chosen together
    for short motion, and the motions planned around the region, which nothing enters.

    Args:
        region: where the plant may stand, from soil to top; kept free as an upright elliptic cylinder.
        boxes: solid boxes, such as bench and pot.
        params: see `Params`.
        start: (J,) joints the arm comes from; None is where it is ready.
        T_flange_cam: (4, 4) hand-eye calibration; None is where the tool's camera is meant to be.
        motion: how the arm moves; None takes sawyer_moveit's "fast" (facts: sawyer 1), as nothing is near.
        arm: its description.

    Raises:
        StageFailure: "unreachable" when fewer than three views can be reached, "collision" when the arm starts within
            the region or an obstacle.
    """
    planner, begin = _planner(arm, region, boxes, start, motion)
    viewpoints = _reachable(region, planner, params, _hand_eye(arm, T_flange_cam))
    return _visit(viewpoints, viewpoints.spread(params.count, params.first), planner, begin, params, region)


def reachable_views(
    region: Box,
    boxes: Sequence[Box] = (),
    params: Params = Params(),
    *,
    start: ArrayLike | None = None,
    T_flange_cam: ArrayLike | None = None,
    arm: ArmModel = SAWYER,
) -> Viewpoints:
    """Return all views that `plan_views` chooses from; the arguments and what is raised are the same."""
    planner = _planner(arm, region, boxes, start, None)[0]
    return _reachable(region, planner, params, _hand_eye(arm, T_flange_cam))


def visit_views(
    viewpoints: Viewpoints,
    chosen: Sequence[int],
    region: Box,
    boxes: Sequence[Box] = (),
    params: Params = Params(),
    *,
    start: ArrayLike | None = None,
    motion: MotionParams | None = None,
) -> Views:
    """Return the chosen of the viewpoints with branches and in an order that keep the motion short.

    The other arguments and what is raised are as in `plan_views`.
    """
    planner, begin = _planner(viewpoints.arm, region, boxes, start, motion)
    return _visit(viewpoints, list(chosen), planner, begin, params, region)


def capture_time(views: Views) -> float:
    """Return the time [s] of all motions and the stops for the images."""
    return sum(m.duration for m in views.motions) + float(views.dwell.sum())


def cylinder_points(region: Box, spacing: float = 0.015) -> Array:
    """Return points (N, 3), at most `spacing` [m] apart, on the elliptic cylinder inscribed upright in a box."""
    center, half = (region.lower + region.upper) / 2, (region.upper - region.lower) / 2
    turn = np.arange(0, 2 * np.pi, spacing / half[:2].max())
    wall = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    heights = np.append(np.arange(region.lower[2], region.upper[2], spacing), region.upper[2])
    shares = np.arange(spacing, half[:2].max(), spacing) / half[:2].max()
    layers = [np.column_stack([center[:2] + wall * half[:2], np.full(len(wall), z)]) for z in heights]
    top = [np.column_stack([center[:2] + s * wall * half[:2], np.full(len(wall), region.upper[2])]) for s in shares]
    return np.concatenate(layers + top)


def _planner(
    arm: ArmModel, region: Box, boxes: Sequence[Box], start: ArrayLike | None, motion: MotionParams | None
) -> tuple[Planner, Array]:
    """Return a planner that keeps out of the region, and the start joints (J,); the arm must start outside."""
    begin = check_array("start joints", arm.ready if start is None else start, (arm.count,))
    planner = Planner(cylinder_points(region), np.zeros((0, 3)), boxes, params=motion or FAST, arm=arm)
    if not planner.world.free(begin):
        raise StageFailure(
            "collision", f"the start joints {begin.round(2)} are not free. Start from the arm's `ready`."
        )
    return planner, begin


def _hand_eye(arm: ArmModel, T_flange_cam: ArrayLike | None) -> Array:
    return check_transform("T_flange_cam", arm.tool.T_flange_cam if T_flange_cam is None else T_flange_cam)


def _visit(
    viewpoints: Viewpoints,
    chosen: list[int],
    planner: Planner,
    start: Array,
    params: Params,
    region: Box,
) -> Views:
    azimuth, elevation = viewpoints.azimuth, viewpoints.elevation
    more = _free_branches(viewpoints.T_world_cam[chosen], planner, viewpoints.T_flange_cam, MORE_SEEDS)
    choices = [q if len(q) else viewpoints.branches[i] for i, q in zip(chosen, more, strict=True)]
    tour = shortest_tour(planner.arm, lambda line: planner.world.path_free(line, SEARCH_STEP), start, choices)
    kept, motions = _motions(planner, start, [(chosen[i], q) for i, q in tour])
    at = [i for i, _ in kept]
    joints = np.array([q for _, q in kept])
    T_world_cam = planner.arm.forward(joints) @ viewpoints.T_flange_cam
    dwell = np.full(len(kept), params.dwell, dtype=float)
    if params.dwell is None:
        seen = cylinder_points(region, SEEN)
        dwell = sharpness.standing_times(planner.arm, motions, viewpoints.T_flange_cam, seen, params.camera)
    return Views(joints, T_world_cam, tuple(motions), azimuth[at], elevation[at], dwell)


def _reachable(region: Box, planner: Planner, params: Params, hand_eye: Array) -> Viewpoints:
    """Return the reachable views; each direction takes the first distance of the list at which it can be reached."""
    steps = np.arange(-180, 180, params.azimuth_step)
    steps = steps[np.abs(steps) <= params.widest]
    grid = [(a, e, share) for e, share in zip(ELEVATIONS, HEIGHT_SHARES, strict=True) for a in steps]
    found: dict[int, Array] = {}
    for distance in params.distances:
        open_ = [i for i in range(len(grid)) if i not in found]
        poses = np.array([_camera_pose(region, *grid[i], distance) for i in open_])
        for i, free in zip(open_, _free_branches(poses, planner, hand_eye, SEEDS), strict=True):
            if len(free):
                found[i] = free
    if len(found) < 3:
        raise StageFailure("unreachable", f"only {len(found)} views of {region} can be reached. Move the plant or arm.")
    order = sorted(found)
    azimuth, elevation = np.array([grid[i][:2] for i in order]).T
    return Viewpoints(tuple(found[i] for i in order), azimuth, elevation, hand_eye, planner.arm)


def _free_branches(T_world_cam: Array, planner: Planner, hand_eye: Array, seeds: int) -> list[Array]:
    """Return for each of (V, 4, 4) camera poses the free joints (C, J) that hold it, upright or upside down."""
    poses = [T @ roll @ inverse(hand_eye) for T in T_world_cam for roll in _ROLLS]
    solved = _kinematics.inverse_many(planner.arm, np.array(poses).reshape(-1, 4, 4), seeds=seeds)
    both = [np.concatenate(solved[k : k + len(_ROLLS)]) for k in range(0, len(solved), len(_ROLLS))]
    return [choices[[planner.world.free(q) for q in choices]] if len(choices) else choices for choices in both]


_ROLLS = (np.eye(4), np.diag([-1.0, -1.0, 1.0, 1.0]))


def _camera_pose(region: Box, azimuth: float, elevation: float, height_share: float, distance: float) -> Array:
    target = (region.lower + region.upper) / 2
    target[2] = region.lower[2] + height_share * (region.upper[2] - region.lower[2])
    away = _unit_rays(np.array([[azimuth, elevation]]))[0]
    toward_arm = np.arctan2(-target[1], -target[0])
    c, s = np.cos(toward_arm), np.sin(toward_arm)
    return look_at(
        target + distance * np.array([c * away[0] - s * away[1], s * away[0] + c * away[1], away[2]]), target
    )


def _unit_rays(directions: Array) -> Array:
    azimuth, elevation = np.deg2rad(directions).T
    return np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=1
    )


def _spread(rays: Array, count: int, first: Array) -> list[int]:
    """Return up to `count` indices of rays (V, 3): the nearest to `first` (3,), each next the farthest from those."""
    chosen = [int(np.argmax(rays @ first))]
    distance = np.linalg.norm(rays - rays[chosen[0]], axis=1)
    while len(chosen) < min(count, len(rays)):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(rays - rays[chosen[-1]], axis=1))
    return chosen


def _motions(
    planner: Planner, start: Array, rows: list[tuple[int, Array]]
) -> tuple[list[tuple[int, Array]], list[JointTrajectory]]:
    """Return the views the arm gets to, and its motions; a view without a path is left out."""
    kept, motions, here = [], [], start
    for row in rows:
        try:
            motions.append(planner.move(here, row[1]))
        except StageFailure:
            continue
        kept.append(row)
        here = row[1]
    return kept, motions
