"""Viewpoints around a plant that the arm can reach, in an order that keeps the motion short. V views, C choices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anther.arm import kinematics, sawyer
from anther.arm.planner import Params as MotionParams
from anther.arm.planner import Planner
from anther.checks import check_array, check_range, check_transform
from anther.devices import JointTrajectory
from anther.errors import StageFailure
from anther.geometry import Array, Box, inverse, look_at

FAST = MotionParams(velocity_share=0.85, acceleration_share=0.7)
COLUMN = 30.0  # degrees of azimuth walked through together
DETOUR = 2.0  # s that a motion is taken to last longer when the straight joint line is not free: measured, 1 to 4 s
ROUNDS = 6  # of looking for an order without such motions


@dataclass(frozen=True, slots=True)
class Params:
    """Where views are sought.

    Attributes:
        count: how many views.
        distances: of the camera from the plant's axis, in order of preference [m]; the D455 sees nothing nearer than
            0.48 m at 1280 x 720.
        elevations: of the camera above its target [degrees].
        azimuth_step: of the viewpoints tried [degrees].
        widest: greatest azimuth, to either side of the arm [degrees].
        height_shares: at which share of the region's height each elevation aims.
        dwell: standing still for one image [s].
    """

    count: int = 30
    distances: tuple[float, ...] = (0.65, 0.58, 0.52)
    elevations: tuple[float, ...] = (-5.0, 15.0, 35.0, 55.0)
    azimuth_step: float = 7.5
    widest: float = 180.0
    height_shares: tuple[float, ...] = (0.4, 0.65, 0.45, 0.6)
    dwell: float = 0.2

    def __post_init__(self) -> None:
        check_range("views", self.count, 1, 500)
        check_range("azimuth step", self.azimuth_step, 1, 90, "degrees")
        check_range("widest azimuth", self.widest, 0, 180, "degrees")
        check_range("nearest view", min(self.distances), 0.2, 2, "m")


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """The views in the order they are taken.

    Attributes:
        joints: (V, 7) [rad].
        T_world_cam: (V, 4, 4) camera poses by kinematics and hand-eye calibration, as far as the planner knows them.
        motions: V motions; the first starts at the start joints.
        azimuth: (V,) of the camera around the plant's vertical axis [degrees]; 0 is the side of the arm,
            positive turns counterclockwise seen from above.
        elevation: (V,) of the camera above its target [degrees].
        dwell: standing still for one image [s].
    """

    joints: Array
    T_world_cam: Array
    motions: tuple[JointTrajectory, ...]
    azimuth: Array
    elevation: Array
    dwell: float

    def __post_init__(self) -> None:
        n = len(self.joints)
        object.__setattr__(self, "joints", check_array("view joints", self.joints, (n, 7)))
        object.__setattr__(self, "T_world_cam", check_transform("T_world_cam", self.T_world_cam, n))


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoints:
    """Views that the arm can reach, to choose from.

    Attributes:
        branches: V arrays (C, 7) of free joints [rad] that hold the camera there, upright or upside down.
        azimuth, elevation: (V,) as in `Views` [degrees].
        T_flange_cam: (4, 4) hand-eye calibration.
    """

    branches: tuple[Array, ...]
    azimuth: Array
    elevation: Array
    T_flange_cam: Array

    @property
    def T_world_cam(self) -> Array:
        """(V, 4, 4) camera poses, each by its first branch."""
        return sawyer.forward(np.array([choices[0] for choices in self.branches])) @ self.T_flange_cam

    def spread(self, count: int) -> list[int]:
        """Return up to `count` of the views, each the farthest in direction from those before it."""
        return _spread(_unit_rays(np.stack([self.azimuth, self.elevation], axis=1)), count)


def plan_views(
    region: Box,
    boxes: Sequence[Box] = (),
    params: Params = Params(),
    *,
    start: ArrayLike = sawyer.READY,
    T_flange_cam: ArrayLike = sawyer.T_FLANGE_CAM,
    motion: MotionParams | None = None,
) -> Views:
    """Return reachable, collision-free views all around the side of the plant that the arm can reach.

    Viewpoints on a grid of azimuth and elevation look at the region's axis, upright or upside down; those with a free
    IK branch are kept and thinned out to `count` that are farthest apart. Order and branches are then chosen together
    for short motion, and the motions planned around the region, which nothing enters.

    Args:
        region: where the plant may stand, from soil to top; kept free as an upright elliptic cylinder.
        boxes: solid boxes, such as bench and pot.
        params: see `Params`.
        start: (7,) joints the arm comes from.
        T_flange_cam: (4, 4) hand-eye calibration.
        motion: how the arm moves; None takes sawyer_moveit's "fast" (facts: sawyer 1), as nothing is near.

    Raises:
        StageFailure: "unreachable" when fewer than three views can be reached, "collision" when the arm starts within
            the region or an obstacle.
    """
    planner = _planner(region, boxes, start, motion)
    viewpoints = _reachable(region, planner, params, check_transform("T_flange_cam", T_flange_cam))
    return _visit(viewpoints, viewpoints.spread(params.count), planner, np.asarray(start, dtype=np.float64), params)


def reachable_views(
    region: Box,
    boxes: Sequence[Box] = (),
    params: Params = Params(),
    *,
    start: ArrayLike = sawyer.READY,
    T_flange_cam: ArrayLike = sawyer.T_FLANGE_CAM,
) -> Viewpoints:
    """Return all views that `plan_views` chooses from; the arguments and what is raised are the same."""
    planner = _planner(region, boxes, start, None)
    return _reachable(region, planner, params, check_transform("T_flange_cam", T_flange_cam))


def visit_views(
    viewpoints: Viewpoints,
    chosen: Sequence[int],
    region: Box,
    boxes: Sequence[Box] = (),
    params: Params = Params(),
    *,
    start: ArrayLike = sawyer.READY,
    motion: MotionParams | None = None,
    in_order: bool = False,
) -> Views:
    """Return the chosen of the viewpoints with branches, and unless `in_order` in an order, that keep the motion short.

    The other arguments and what is raised are as in `plan_views`.
    """
    planner = _planner(region, boxes, start, motion)
    return _visit(viewpoints, list(chosen), planner, np.asarray(start, dtype=np.float64), params, in_order=in_order)


def capture_time(views: Views) -> float:
    """Return the time [s] of all motions and the stops for the images."""
    return sum(m.duration for m in views.motions) + views.dwell * len(views.joints)


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


def _planner(region: Box, boxes: Sequence[Box], start: ArrayLike, motion: MotionParams | None) -> Planner:
    """Return a planner that keeps out of the region; the arm must start outside."""
    begin = check_array("start joints", start, (7,))
    planner = Planner(cylinder_points(region), np.zeros((0, 3)), boxes, params=motion or FAST)
    if not planner.world.free(begin):
        raise StageFailure("collision", f"the start joints {begin.round(2)} are not free. Start from sawyer.READY.")
    return planner


def _visit(
    viewpoints: Viewpoints,
    chosen: list[int],
    planner: Planner,
    start: Array,
    params: Params,
    *,
    in_order: bool = False,
) -> Views:
    azimuth, elevation = viewpoints.azimuth, viewpoints.elevation
    choices = [viewpoints.branches[i] for i in chosen]
    tours = _tours(planner, start, choices, None if in_order else (azimuth[chosen], elevation[chosen]))
    ways = [_motions(planner, start, [(chosen[i], q) for i, q in tour]) for tour in tours]
    kept, motions = min(ways, key=lambda way: (-len(way[0]), sum(m.duration for m in way[1])))
    at = [i for i, _ in kept]
    joints = np.array([q for _, q in kept])
    T_world_cam = sawyer.forward(joints) @ viewpoints.T_flange_cam
    return Views(joints, T_world_cam, tuple(motions), azimuth[at], elevation[at], params.dwell)


def _reachable(region: Box, planner: Planner, params: Params, hand_eye: Array) -> Viewpoints:
    """Return the reachable views; each direction takes the first distance of the list at which it can be reached."""
    steps = np.arange(-180, 180, params.azimuth_step)
    steps = steps[np.abs(steps) <= params.widest]
    grid = [(a, e, share) for e, share in zip(params.elevations, params.height_shares, strict=True) for a in steps]
    found: dict[int, Array] = {}
    for distance in params.distances:
        open_ = [i for i in range(len(grid)) if i not in found]
        poses = [_camera_pose(region, *grid[i], distance) @ roll for i in open_ for roll in _ROLLS]
        solved = kinematics.inverse_many(np.array(poses) @ inverse(hand_eye), seeds=12)
        for k, i in enumerate(open_):
            choices = np.concatenate(solved[len(_ROLLS) * k : len(_ROLLS) * (k + 1)])
            free = choices[[planner.world.free(q) for q in choices]] if len(choices) else choices
            if len(free):
                found[i] = free
    if len(found) < 3:
        raise StageFailure("unreachable", f"only {len(found)} views of {region} can be reached. Move the plant or arm.")
    order = sorted(found)
    azimuth, elevation = np.array([grid[i][:2] for i in order]).T
    return Viewpoints(tuple(found[i] for i in order), azimuth, elevation, hand_eye)


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


def _spread(rays: Array, count: int) -> list[int]:
    """Return up to `count` indices of rays (V, 3), each the farthest from those before it."""
    chosen = [int(np.argmax(rays[:, 0]))]
    distance = np.linalg.norm(rays - rays[chosen[0]], axis=1)
    while len(chosen) < min(count, len(rays)):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(rays - rays[chosen[-1]], axis=1))
    return chosen


class _Times:
    """Least times [s] between joints, and what is known of straight joint lines that are not free."""

    def __init__(self) -> None:
        self.blocked: list[Array] = []

    def __call__(self, a: Array, b: Array) -> Array:
        """Return (A, B) times from rest to rest, each joint at its limits; `DETOUR` more where a line is blocked."""
        far = np.abs(a[:, None] - b[None])
        v, acc = sawyer.VELOCITY, sawyer.ACCELERATION
        times = np.where(far > v**2 / acc, far / v + v / acc, 2 * np.sqrt(far / acc)).max(axis=2)
        for line in self.blocked:
            for p, q in (line, line[::-1]):
                rows = (a == p).all(axis=1)
                if rows.any():
                    times[np.ix_(rows, (b == q).all(axis=1))] += DETOUR
        return times

    def along(self, start: Array, picks: list[Array]) -> float:
        """Return the time [s] from `start` through all."""
        stops = np.array([start, *picks])
        return float(np.diagonal(self(stops[:-1], stops[1:])).sum())


def _tours(
    planner: Planner, start: Array, choices: list[Array], directions: tuple[Array, Array] | None
) -> list[list[tuple[int, Array]]]:
    """Return tours of (view, joints): the shortest if all straight joint lines were free, and one along free lines.

    Lines are checked only when a tour uses them, and the tour is found again with what that taught (Bohlin and Kavraki
    2000, lazy collision checking).

    Args:
        planner: knows what is free.
        start: (7,) joints the arm comes from.
        choices: per view the joints (C, 7) to choose from.
        directions: azimuth and elevation (V,) of the views [degrees]; None keeps the order.
    """
    times, tours, checked = _Times(), [], set[bytes]()
    for _ in range(ROUNDS):
        tours.append(
            list(enumerate(_best_branches(start, choices, times)))
            if directions is None
            else _short_tour(start, choices, *directions, times)
        )
        stops = [start, *(q for _, q in tours[-1])]
        lines = [line for line in np.stack([stops[:-1], stops[1:]], axis=1) if line.tobytes() not in checked]
        checked |= {line.tobytes() for line in lines}
        blocked = [line for line in lines if not planner.world.path_free(line)]
        if not blocked:
            break
        times.blocked += blocked
    free = min(tours, key=lambda tour: times.along(start, [q for _, q in tour]))
    return [tours[0]] if free is tours[0] else [tours[0], free]


def _short_tour(
    start: Array, choices: list[Array], azimuth: Array, elevation: Array, times: _Times
) -> list[tuple[int, Array]]:
    """Return (view, joints) in an order and with branches that keep the motion short.

    From columns of azimuth walked up and down, either way round, the branches are chosen for the order (shortest path
    through the layers) and the order is improved for the branches by reversing pieces (2-opt), in turn. The better
    result counts.
    """
    column = np.round(azimuth / COLUMN).astype(int)
    serpentine = [int(i) for i in np.lexsort((elevation * (-1.0) ** column, column))]
    tours = [_improved(start, choices, order, times) for order in (serpentine, serpentine[::-1])]
    return min(tours, key=lambda tour: times.along(start, [q for _, q in tour]))


def _improved(start: Array, choices: list[Array], order: list[int], times: _Times) -> list[tuple[int, Array]]:
    picks = _best_branches(start, [choices[v] for v in order], times)
    for _ in range(4):
        stops = np.array([start, *picks])
        shorter = [order[i - 1] for i in _two_opt(times(stops, stops))[1:]]
        if shorter == order:
            break
        order, picks = shorter, _best_branches(start, [choices[v] for v in shorter], times)
    return list(zip(order, picks, strict=True))


def _two_opt(cost: Array) -> NDArray[Any]:
    """Return an order (V,) of an open tour that starts at 0 and that no reversal of a piece makes shorter."""
    n = len(cost)
    order, improved = np.arange(n), True
    while improved:
        improved = False
        for i in range(1, n - 1):
            for j in range(i + 1, n):
                before, first, last = order[i - 1], order[i], order[j]
                gain = cost[before, first] - cost[before, last]
                if j + 1 < n:
                    gain += cost[last, order[j + 1]] - cost[first, order[j + 1]]
                if gain > 1e-9:
                    order[i : j + 1] = order[i : j + 1][::-1]
                    improved = True
    return order


def _best_branches(start: Array, layers: list[Array], times: _Times) -> list[Array]:
    """Return the joints of each layer (C, 7) on the shortest way from `start` through all."""
    total, came = np.zeros(1), []
    previous = start[None]
    for layer in layers:
        reach = total[:, None] + times(previous, layer)
        came.append(reach.argmin(axis=0))
        total, previous = reach.min(axis=0), layer
    pick, joints = int(total.argmin()), []
    for layer, back in zip(reversed(layers), reversed(came), strict=True):
        joints.append(layer[pick])
        pick = int(back[pick])
    return joints[::-1]


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
