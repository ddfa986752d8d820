"""Viewpoints around a plant that the arm can reach, in an order that keeps the motion short. V views, C choices.

The camera takes its frames when it likes. While the arm brakes for a view and leaves it again there is a span in which
whatever frame is taken shows the plant sharp and the arm's readings tell where it was taken: if that span is as long as
a frame period and an exposure, one whole exposure lies within it and the arm need not stand still at all.
T samples, P points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicHermiteSpline

from anther.core.checks import check_array, check_range, check_transform
from anther.core.errors import StageFailure
from anther.core.geometry import Array, Box, inverse, look_at, unit_vectors
from anther.core.records import Range, Record, Shape
from anther.robot.arm import _kinematics
from anther.robot.arm._tours import shortest_tour
from anther.robot.arm.model import ArmModel
from anther.robot.arm.planner import Params as MotionParams
from anther.robot.arm.planner import Planner
from anther.robot.arm.sawyer import SAWYER
from anther.robot.devices import JointTrajectory

FAST = MotionParams(velocity_share=0.95, acceleration_share=0.85)
SOON = 1e-4  # s in which a point's motion in the image is taken


@dataclass(frozen=True, slots=True)
class Params(Record):
    """Where views are sought, and the camera that takes them.

    Attributes:
        count: how many views.
        distances: of the camera from the plant's axis, in order of preference [m]; the D455 sees nothing nearer than
            0.48 m at 1280 x 720.
        azimuth_step: of the viewpoints tried [degrees].
        widest: greatest azimuth, to either side of the arm [degrees].
        first: azimuth and elevation near which the spread of directions begins [degrees]; None is the arm's side. It
            decides how evenly few views lie, and how short their tour can be.
        dwell: standing still for each image [s], for a camera that is asked for a frame when the arm has come to rest;
            None is as long as a camera that runs freely needs for a sharp one.
        frame_rate: of the camera, which runs freely [Hz] (D455 at 1280 x 720; facts: sawyer 4).
        exposure: of a frame [s]. Our assumption: daylight in a greenhouse, or a lamp beside the camera.
        focal: length [px] (D455 at 1280 x 720; facts: perception).
    """

    CALLED = "views'"
    count: Annotated[int, Range(1, 500)] = 30
    distances: tuple[float, ...] = (0.65, 0.58, 0.52)
    azimuth_step: Annotated[float, Range(1, 90, "degrees")] = 7.5
    widest: Annotated[float, Range(0, 180, "degrees")] = 180.0
    first: tuple[float, float] | None = None
    dwell: float | None = None
    frame_rate: Annotated[float, Range(1, 1000, "Hz")] = 30.0
    exposure: Annotated[float, Range(1e-5, 0.5, "s")] = 0.005
    focal: float = 640.0

    def _check(self) -> None:
        check_range("nearest view", min(self.distances), 0.2, 2, "m")

    @property
    def span(self) -> float:
        """How long pictures must be sharp so that a frame can be had for certain [s]."""
        return 1 / self.frame_rate + self.exposure


@dataclass(frozen=True, slots=True, eq=False)
class Views(Record):
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

    CALLED = "view"
    joints: Annotated[Array, Shape("V", "J"), Range(unit="rad")]
    T_world_cam: Annotated[Array, Shape("V", 4, 4, rigid=True)]
    motions: tuple[JointTrajectory, ...]
    azimuth: Annotated[Array, Shape("V"), Range(unit="degrees")]
    elevation: Annotated[Array, Shape("V"), Range(unit="degrees")]
    dwell: Annotated[Array, Shape("V"), Range(unit="s")]


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoints:
    """Views that the arm can reach, to choose from.

    Attributes:
        branches: V arrays (C, J) of free joints [rad] that hold the camera there, upright or upside down.
        azimuth, elevation: (V,) as in `Views` [degrees].
        T_flange_cam: (4, 4) hand-eye calibration.
        region, planner, start, params: as in `plan_views`.
    """

    branches: tuple[Array, ...]
    azimuth: Array
    elevation: Array
    T_flange_cam: Array
    region: Box
    planner: Planner
    start: Array
    params: Params

    @property
    def T_world_cam(self) -> Array:
        """(V, 4, 4) camera poses, each by its first branch."""
        return self.planner.arm.forward(np.array([choices[0] for choices in self.branches])) @ self.T_flange_cam

    def spread(self, count: int, first: tuple[float, float] | None = None) -> list[int]:
        """Return up to `count` of the views, each the farthest in direction from those before; see `Params.first`."""
        rays = _unit_rays(np.stack([self.azimuth, self.elevation], axis=1))
        return _spread(rays, count, np.array([1.0, 0, 0]) if first is None else _unit_rays(np.array([first]))[0])

    def visit(self, chosen: Sequence[int]) -> Views:
        """Return the chosen views with branches and in an order that keep the motion short."""
        planner, arm = self.planner, self.planner.arm
        more = _free_branches(self.T_world_cam[list(chosen)], planner, self.T_flange_cam, seeds=48)
        choices = [q if len(q) else self.branches[i] for i, q in zip(chosen, more, strict=True)]
        tour = shortest_tour(arm, lambda line: planner.world.path_free(line, planner.search_step), self.start, choices)
        kept, motions = _motions(planner, self.start, [(chosen[i], q) for i, q in tour])
        at, joints = [i for i, _ in kept], np.array([q for _, q in kept])
        dwell = np.full(len(kept), self.params.dwell, dtype=float)
        if self.params.dwell is None:
            points = cylinder_points(self.region, 0.08)  # [m] between those whose motion in the image is looked at
            dwell = standing_times(arm, motions, self.T_flange_cam, points, self.params)
        T_world_cam = arm.forward(joints) @ self.T_flange_cam
        return Views(joints, T_world_cam, tuple(motions), self.azimuth[at], self.elevation[at], dwell)


def plan_views(
    region: Box,
    boxes: Sequence[Box] = (),
    params: Params = Params(),
    *,
    start: ArrayLike | None = None,
    T_flange_cam: ArrayLike | None = None,
    motion: MotionParams = FAST,
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
        motion: how the arm moves; by default sawyer_moveit's "fast" (facts: sawyer 1), as nothing is near.
        arm: its description.

    Raises:
        StageFailure: "unreachable" when fewer than three views can be reached, "collision" when the arm starts within
            the region or an obstacle.
    """
    points = reachable_views(region, boxes, params, start=start, T_flange_cam=T_flange_cam, motion=motion, arm=arm)
    return points.visit(points.spread(params.count, params.first))


def reachable_views(
    region: Box,
    boxes: Sequence[Box] = (),
    params: Params = Params(),
    *,
    start: ArrayLike | None = None,
    T_flange_cam: ArrayLike | None = None,
    motion: MotionParams = FAST,
    arm: ArmModel = SAWYER,
) -> Viewpoints:
    """Return all views that `plan_views` chooses from, each at the first distance at which it can be reached.

    The arguments and what is raised are the same.
    """
    begin = check_array("start joints", arm.ready if start is None else start, (arm.count,))
    planner = Planner(cylinder_points(region), np.zeros((0, 3)), boxes, params=motion, arm=arm)
    if not planner.world.free(begin):
        where = f"the start joints {begin.round(2)} are not free"
        raise StageFailure("collision", f"{where}. Start from the arm's `ready`.")
    hand_eye = check_transform("T_flange_cam", arm.tool.T_flange_cam if T_flange_cam is None else T_flange_cam)
    steps = np.arange(-180, 180, params.azimuth_step)
    steps = steps[np.abs(steps) <= params.widest]
    # elevations above the target [degrees], each with the share of the region's height at which it aims
    aims = (-5.0, 0.4), (15.0, 0.65), (35.0, 0.45), (55.0, 0.6)
    grid = [(a, e, share) for e, share in aims for a in steps]
    found: dict[int, Array] = {}
    for distance in params.distances:
        open_ = [i for i in range(len(grid)) if i not in found]
        poses = np.array([_camera_pose(region, *grid[i], distance) for i in open_])
        for i, free in zip(open_, _free_branches(poses, planner, hand_eye, seeds=12), strict=True):
            if len(free):
                found[i] = free
    if len(found) < 3:
        raise StageFailure("unreachable", f"only {len(found)} views of {region} can be reached. Move the plant or arm.")
    order = sorted(found)
    azimuth, elevation = np.array([grid[i][:2] for i in order]).T
    return Viewpoints(tuple(found[i] for i in order), azimuth, elevation, hand_eye, region, planner, begin, params)


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


def image_speed(arm: ArmModel, q: Array, rates: Array, T_flange_cam: Array, points: Array, focal: float) -> Array:
    """Return (T,) how fast the fastest of the points (P, 3) within the image moves in it [px/s].

    Args:
        arm: its description.
        q, rates: joints and their rates (T, J) [rad, s].
        T_flange_cam: (4, 4) hand-eye calibration.
        points: world [m].
        focal: [px].
    """

    def project(joints: Array) -> Array:
        T_cam_world = inverse(arm.forward(joints) @ T_flange_cam)
        p = np.einsum("tij,pj->tpi", T_cam_world[:, :3, :3], points) + T_cam_world[:, None, :3, 3]
        ahead = p[..., 2:] > 0.05
        return np.where(ahead, p[..., :2] / np.where(ahead, p[..., 2:], 1), np.nan)

    now = project(q)
    speed = focal * np.linalg.norm(project(q + SOON * rates) - now, axis=2) / SOON
    inside = np.abs(now).max(axis=2) <= 1.1  # |x / z| and |y / z| of a D455's image (90 x 65 deg: facts, sawyer 4)
    return np.where(inside, speed, 0).max(axis=1)


def is_sharp(
    arm: ArmModel, q: Array, rates: Array, T_flange_cam: Array, points: Array, params: Params
) -> NDArray[np.bool_]:
    """Return (T,) whether a frame then is neither blurred nor taken at a place not known; see `image_speed`."""
    here, soon = (arm.forward(joints) @ T_flange_cam for joints in (q, q + SOON * rates))
    jitter = 0.001  # by which the clocks of camera and arm may differ [s]: our assumption, for one computer
    travel = np.linalg.norm(soon[:, :3, 3] - here[:, :3, 3], axis=1) / SOON * jitter
    blur = image_speed(arm, q, rates, T_flange_cam, points, params.focal) * params.exposure
    return (blur <= 0.5) & (travel <= 2e-4)  # [px] less than a lens blurs; [m] a fifth of an image's usual pose error


def standing_times(
    arm: ArmModel, motions: Sequence[JointTrajectory], T_flange_cam: Array, points: Array, params: Params
) -> Array:
    """Return (V,) how long the arm must stand still after each of V motions [s], each to a view from the view before.

    After the last nothing follows: the arm waits for its frame.
    """

    def sharp(motion: JointTrajectory) -> float:  # how long pictures stay so from the beginning of a motion [s]
        curve = CubicHermiteSpline(motion.times, motion.positions, motion.velocities)
        step = 1e-3
        t = np.arange(0, min(params.span, motion.duration), step)
        good = is_sharp(arm, curve(t), curve(t, 1), T_flange_cam, points, params)
        return step * float(np.logical_and.accumulate(good)[1:].sum())

    braking, leaving = [sharp(motion.backwards()) for motion in motions], [*map(sharp, motions[1:]), 0.0]
    return np.maximum(params.span - np.array(braking) - np.array(leaving), 0)


def _free_branches(T_world_cam: Array, planner: Planner, hand_eye: Array, seeds: int) -> list[Array]:
    """Return for each of (V, 4, 4) camera poses the free joints (C, J) that hold it, upright or upside down."""
    rolls = (np.eye(4), np.diag([-1.0, -1.0, 1.0, 1.0]))
    poses = [T @ roll @ inverse(hand_eye) for T in T_world_cam for roll in rolls]
    solved = _kinematics.inverse_many(planner.arm, np.array(poses).reshape(-1, 4, 4), seeds=seeds)
    both = [np.concatenate(solved[k : k + len(rolls)]) for k in range(0, len(solved), len(rolls))]
    return [choices[[planner.world.free(q) for q in choices]] if len(choices) else choices for choices in both]


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
    return unit_vectors(*np.deg2rad(directions).T)


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
