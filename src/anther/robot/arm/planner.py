"""Planner: what an arm can reach among obstacles, and how it moves there. B branches, N points, Q frequencies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from roboplan.core import JointConfiguration, JointPath, PathShortcutter, PathShortcuttingOptions
from roboplan.rrt import RRT, RRTOptions

from anther.core.checks import check_array, check_transform
from anther.core.errors import StageFailure
from anther.core.geometry import Array, Box, ComplexArray, transform, transform_points
from anther.core.records import Range, Record
from anther.robot.arm import _kinematics, compliance, motions, shaking
from anther.robot.arm._collision import GROUP, VOXEL, CollisionWorld, cube_centres
from anther.robot.arm._tours import DETOUR, least_times
from anther.robot.arm.model import ArmModel, outline, touches
from anther.robot.arm.sawyer import SAWYER
from anther.robot.devices import JointTrajectory
from anther.robot.swing import Swing

SHAKE_CAP = 0.02  # m, beyond which the local limit means little

Place = tuple[Array, JointTrajectory | None]
"""Free joints (J,), and the way back to them from such as are not."""


@dataclass(frozen=True, slots=True)
class Params(Record):
    """How the arm moves.

    Attributes:
        velocity_share, acceleration_share: of the joints' limits in free motion; the defaults are about sawyer_moveit's
            "medium" (facts: sawyer 1).
        flange_speed: of the flange in free motion at most [m/s]; just within `devices.SafetyLimits`.
        approach_speed: of the flange along straight lines [m/s].
        home: (J,) joints from which grasps must be reachable [rad]; None is where the arm is ready.
    """

    velocity_share: Annotated[float, Range(0.01, 1)] = 0.5
    acceleration_share: Annotated[float, Range(0.01, 1)] = 0.35
    flange_speed: float = 1.45
    approach_speed: Annotated[float, Range(0.001, 0.5, "m/s")] = 0.05
    home: tuple[float, ...] | None = None


class Planner:
    """Plans for one arrangement of obstacles.

    Args:
        plant: (N, 3) plant points, world [m]. The arm never touches them; gripper and camera may on straight lines.
            Leaves among which it stands at home have given way already: they do not hold it there.
        obstacles: (M, 3) points of pot, soil and bench [m]. Nothing ever touches them.
        boxes: solid boxes, such as the bench; the floor is always there.
        space: box that the flange does not leave in free motion; None is no limit.
        params: see `Params`.
        arm: its description.
    """

    search_step = 0.02
    """Between collision checks while searching [rad]; the result is checked more finely."""
    _line_step = 0.003
    """Spacing of the poses along a straight line [m]."""
    _search_time = 2.0
    """For a path around obstacles, of each of several seeds [s]."""
    _blends = (0.3, 0.05)
    """How far a corner may be rounded [rad], in order of preference."""

    def __init__(
        self,
        plant: ArrayLike,
        obstacles: ArrayLike,
        boxes: Sequence[Box] = (),
        *,
        space: Box | None = None,
        params: Params = Params(),
        arm: ArmModel = SAWYER,
    ) -> None:
        self.params, self.space, self.arm = params, space, arm
        home = arm.ready if params.home is None else params.home
        self.home = check_array("home joints", home, (arm.count,))
        points = check_array("plant points", plant, (None, 3)), check_array("obstacle points", obstacles, (None, 3))
        self._around = (*points, boxes)
        self._known = list[Array]()  # ways from home, found when it was asked what is in reach
        self._quickest = list[Array]()  # ways that `move` has made as quick as it can
        cubes = cube_centres(points[0])
        # half of it reaches from a cube's centre to what the cube holds; the rest is room to move
        diagonal = np.sqrt(3) * VOXEL
        self.plant = cubes[~touches(arm, self.home, cubes, arm.margin + diagonal)]
        self.world = CollisionWorld(arm, self.plant, points[1], boxes)

    def moved(self, T: Array) -> Planner:
        """Return a planner among the same points moved by T (4, 4), which tries the ways that this one knows first."""
        plant, obstacles, boxes = self._around
        points = transform_points(T, plant), transform_points(T, obstacles)
        other = Planner(*points, boxes, space=self.space, params=self.params, arm=self.arm)
        other._known, other._quickest = list(self._known), list(self._quickest)
        return other

    def reach(self, T_world_pregrasp: Array, T_world_grasp: Array) -> Array | None:
        """Return joints (J,) at the grasp if it, the pre-grasp and the straight way between are free, else None.

        On that way gripper and camera may touch the plant (grasp planning has judged that), the arm may not. Of several
        branches that can shake hard, in their worst direction, the one soonest reached is returned, if a path from
        home to its pre-grasp is found quickly. Satisfies `grasp.Reach`.
        """
        grasp, pregrasp = check_transform("grasp", T_world_grasp), check_transform("pre-grasp", T_world_pregrasp)
        if self._wrist_in_plant(grasp, float(np.linalg.norm(pregrasp[:3, 3] - grasp[:3, 3]))):
            return None
        branches = _kinematics.inverse(self.arm, grasp)
        if not len(branches):
            return None
        poses = _kinematics.poses_between(grasp, pregrasp, 0.01)
        ways = sorted(self._ways_in(branches, poses), key=lambda way: self._delay(way[-1]))
        free = (way for way in ways if self._brushing_free(way))
        return next((way[0] for way in islice(free, 2) if self._is_soon_reached(way[-1])), None)  # a path takes long

    def move(self, q_from: ArrayLike, q_to: ArrayLike) -> JointTrajectory:
        """Return a free motion between two joint vectors (J,).

        The straight joint line if it is free, else RRT-Connect, shortcut, checked again finely, timed by TOPP-RA. Where
        gripper or camera touch the plant at an end, the arm first draws back along the approach axis, or enters by it:
        no farther than it must, but as far as it can where no path leads on from there.

        Raises:
            StageFailure: "collision" (an end is not free) or "unreachable" (no path found).
        """
        ends = (
            check_array("start joints", q_from, (self.arm.count,)),
            check_array("goal joints", q_to, (self.arm.count,)),
        )
        try:
            return self._join_places(*map(self._back_out, ends))
        except StageFailure as failure:
            if failure.kind != "unreachable" or all(map(self.world.free, ends)):
                raise
            return self._join_places(*(self._back_out(q, far=True) for q in ends))

    def prepare(self, q_grasp: ArrayLike, T_world_pregrasp: ArrayLike) -> None:
        """Seek the quickest way from home to before a grasp at joints (J,): `move` takes it, also where it is `moved`.

        Where there is none nothing is raised: `move` says it.
        """
        with suppress(StageFailure):
            self.move(self.home, self.line(q_grasp, T_world_pregrasp).positions[-1])

    def line(self, q_from: ArrayLike, T_world_to: ArrayLike, speed: float | None = None) -> JointTrajectory:
        """Return a slow straight motion of the flange to a pose; gripper and camera may touch the plant.

        Args:
            q_from: start [rad].
            T_world_to: (4, 4) flange pose at the end.
            speed: of the flange [m/s]; None takes `Params.approach_speed`.

        Raises:
            StageFailure: "unreachable" (the arm cannot follow the line) or "collision".
        """
        q = check_array("start joints", q_from, (self.arm.count,))
        target = check_transform("flange pose", T_world_to)
        here = self.arm.forward(q)
        path = _kinematics.follow(self.arm, q[None], _kinematics.poses_between(here, target, self._line_step))[0]
        if not np.isfinite(path).all():
            raise StageFailure("unreachable", f"the arm cannot follow a straight line to {target[:3, 3].round(3)} m.")
        with self.world.touching_plant():
            if not self.world.path_free(path):
                raise StageFailure("collision", f"the straight line to {target[:3, 3].round(3)} m is not free.")
        length = np.linalg.norm(target[:3, 3] - here[:3, 3]) + 0.1 * _kinematics.angle(here, target)
        motion = motions.along_line(self.arm, path, max(float(length), 1e-4), speed or self.params.approach_speed)
        return motions.check_effort(self.arm, motions.limit_speed(self.arm, motion))

    def shake_limit(self, q: ArrayLike, direction: ArrayLike, frequencies: ArrayLike) -> Array:
        """Return the amplitudes (Q,) [m] that `swing` can do at joints (J,): see `shake_limit`, and what is free."""
        here, way = check_array("joints", q, (self.arm.count,)), shaking.unit(direction)
        rate = np.linalg.pinv(self.arm.jacobian(here))[:, :3] @ way
        rooms = np.geomspace(SHAKE_CAP, SHAKE_CAP / 64, num=7)  # m, tried for being free
        room = next((size for size in rooms if self._may_swing(here, here + np.outer([-size, size], rate))), 0.0)
        return np.minimum(shake_limit(self.arm, here, way, frequencies), room)

    def delivered(self, q: ArrayLike, directions: Array, frequencies: Array) -> tuple[Array, Array]:
        """See `compliance.delivered`."""
        return compliance.delivered(self.arm, check_array("joints", q, (self.arm.count,)), directions, frequencies)

    def grip_motion(self, q: ArrayLike, motors: ComplexArray, frequencies: Array, deviates: Array) -> ComplexArray:
        """See `compliance.grip_motion`."""
        here = check_array("joints", q, (self.arm.count,))
        return compliance.grip_motion(self.arm, here, motors, frequencies, deviates)

    def swing(self, q: ArrayLike, direction: ArrayLike, pieces: Sequence[Swing], reach: float) -> JointTrajectory:
        """Return joined pieces of a flange shake about joints (J,); see `shaking.swing_trajectory`.

        Raises:
            InputError: a number out of range.
            StageFailure: "limits_exceeded", "unreachable" or "collision".
        """
        q = check_array("joints", q, (self.arm.count,))
        shake = shaking.swing_trajectory(self.arm, q, direction, pieces, reach)
        along = (away := shake.positions - q) @ away[np.linalg.norm(away, axis=1).argmax()]
        if not self._may_swing(q, shake.positions[[along.argmin(), along.argmax()]]):
            size = 1e3 * max(piece.reach for piece in pieces)
            raise StageFailure("collision", f"a shake of {size:.1f} mm hits something. Shake less.")
        return motions.check_effort(self.arm, shake)

    def _wrist_in_plant(self, T_world_flange: Array, length: float) -> bool:
        """Return whether plant is where `ArmModel.wrist` is at the end of a straight way of `length` [m].

        That settles most of the poses that are out of reach, in a twentieth of the time.
        """
        if self.arm.wrist is None:
            return False
        begin, end, radius = self.arm.wrist.start[2], self.arm.wrist.end[2], self.arm.wrist.radius + self.arm.margin
        across, along = np.split((self.plant - T_world_flange[:3, 3]) @ T_world_flange[:3, :3], [2], axis=1)
        beyond = along[:, 0] - np.clip(along[:, 0], begin - length, end)
        return bool(np.any(np.sum(across**2, axis=1) + beyond**2 < radius**2))

    def _ways_in(self, branches: Array, poses: Array) -> list[Array]:
        """Return the joint ways (N, J) from the grasp back through poses (N, 4, 4) that are free there.

        Only those of the branches that shake hardest and are near home.
        """
        with self.world.touching_plant():
            free = branches[[self.world.free(q) for q in branches]]
            hurry = 0.4  # share of the amplitude that a second less on the way is worth; an estimate
            worth = _shake_rank(self.arm, free) * np.exp(-hurry * least_times(self.arm, free, self.home[None])[:, 0])
            ranked = free[np.argsort(-worth, kind="stable")]
            followed = _kinematics.follow(self.arm, ranked[:5], poses)
            return [way for way in followed if _steady(self.arm, way) and all(map(self.world.free, way))]

    def _brushing_free(self, way: Array) -> bool:
        """Return whether joints (N, J) and the ways between them are free where gripper and camera touch the plant."""
        with self.world.touching_plant():
            return self.world.path_free(way)

    def _may_swing(self, q: Array, swing: Array) -> bool:
        """Return whether joints (N, J) about the resting q (J,) are free, where gripper and camera touch the plant.

        A swing that moves no part of the arm by more than half of `ArmModel.margin` needs no more than that q is free:
        asked for the whole margin, an arm that rests at its edge could not shake at all.
        """
        moved = np.linalg.norm((outline(self.arm, swing) - outline(self.arm, q))[..., :3], axis=-1).max()
        with self.world.touching_plant():
            return self.world.free(q) if moved <= self.arm.margin / 2 else self.world.path_free(swing)

    def _delay(self, q: Array) -> float:
        """Return about how long the way from home to joints (J,) takes [s]."""
        line = np.array([self.home, q])
        return least_times(self.arm, line[:1], line[1:])[0, 0] + (
            0.0 if self.world.path_free(line, self.search_step) else DETOUR
        )

    def _is_soon_reached(self, q: Array) -> bool:
        """Return whether a path from home to q, or to where q can be backed out to, is found quickly."""
        if not self.world.free(self.home):
            return True
        try:
            goal = self._back_out(q)[0]
        except StageFailure:
            return False
        way = self._known_way(self.home, goal, self._known)
        if way is None:
            few = 3  # where more seeds are needed the way is long
            soon = 0.1  # s: nearly all that are found in 0.2 are found by then
            found = next(self._inner_paths(self.home, goal, soon, self.search_step, few), None)
            if found is None:
                return False
            way = np.array(found[1].positions)
        self._known.append(way)
        return True

    def _known_way(self, start: Array, goal: Array, known: Sequence[Array]) -> Array | None:
        """Return a way (N, J) between joints near the ends of one that is known, if it is free; else None."""
        near_start, near_end = 0.02, 0.2  # rad: as an arm rests, and as a plant is elsewhere than it was seen

        def joins(way: Array) -> bool:
            return bool(np.abs(way[0] - start).max() <= near_start and np.abs(way[-1] - goal).max() < near_end)

        ways = (np.concatenate([start[None], way[1:-1], goal[None]]) for way in reversed(known) if joins(way))
        return next((way for way in ways if self._is_free(way, _dense(way), self.search_step)), None)

    def _join_places(self, start: Place, goal: Place) -> JointTrajectory:
        (begin, leave), (end, enter) = start, goal
        parts = [] if leave is None else [leave]
        if np.abs(end - begin).max() > 1e-9 or (leave is None and enter is None):
            parts.append(self._free_motion(begin, end))
        motion = motions.join(parts if enter is None else [*parts, enter.backwards()])
        return motions.check_effort(self.arm, motions.limit_speed(self.arm, motion))

    def _free_motion(self, start: Array, goal: Array) -> JointTrajectory:
        """Return the straight joint line if it is free, else the quickest way around that was found."""
        p, line = self.params, np.stack([start, goal])
        motion = motions.straight(self.arm, start, goal, p.velocity_share, p.acceleration_share, p.flange_speed)
        return motions.limit_effort(
            self.arm,
            motion if self._is_free(line, motion.positions, self.world.free_step) else self._find_detour(start, goal),
        )

    def _find_detour(self, start: Array, goal: Array) -> JointTrajectory:
        """Return the quickest of several ways found by RRT-Connect that is free, its waypoints shifted to save time.

        Where none is found, or a finer check finds none of them free, it is asked again in smaller steps. One that was
        found before is taken as it is.
        """
        known = self._known_way(start, goal, self._quickest)
        timed = None if known is None else self._time_path(known, self.search_step)
        if timed and self.world.path_free(timed[0].positions[::4]):
            return timed[0]
        for step in self.search_step * np.array([1, 1 / 2, 1 / 4]):
            for motion, path in sorted(self._ways(start, goal, step), key=lambda way: way[0].duration):
                if self.world.path_free(motion.positions[::4]):
                    self._quickest.append(path)
                    return motion
        given = f"no free path found to joints {goal.round(2)}, in 3 searches"
        raise StageFailure("unreachable", f"{given}. Move the plant, or take another grasp or view.")

    def _ways(self, start: Array, goal: Array, step: float) -> list[tuple[JointTrajectory, Array]]:
        """Return motions by the ways found, and the waypoints (N, J) of each; free as far as steps [rad] tell."""
        enough = 3  # of which the quickest is improved
        tried = ((self._time_path(path, step) for path in paths) for paths in self._detours(start, goal, step))
        ways = list(islice((way for some in tried if (way := next(filter(None, some), None))), enough))
        rng = np.random.default_rng(0)
        for left in np.linspace(0.4, 0, 20, endpoint=False) if ways else ():  # [rad] of shift
            quickest, path = min(ways, key=lambda way: way[0].duration)
            shifts = left * self.arm.velocity / self.arm.velocity.mean() * rng.normal(size=path[1:-1].shape)
            moved = np.concatenate([path[:1], np.clip(path[1:-1] + shifts, self.arm.lower, self.arm.upper), path[-1:]])
            better = self._time_path(moved, step, self._blends[:1], quickest.duration)
            ways += [better] if better else []
        return ways

    def _time_path(
        self, path: Array, step: float, blends: Sequence[float] = _blends, within: float = np.inf
    ) -> tuple[JointTrajectory, Array] | None:
        """Return a motion by way of joints (N, J), and them, if it lasts less than `within` [s]; else None.

        It is free as far as steps [rad] tell.
        """
        p = self.params
        if (np.abs(np.diff(path, axis=0)).sum(axis=0) / self.arm.velocity).max() >= within * p.velocity_share:
            return None
        for blend in blends:
            try:
                rounded = motions.fastest(
                    self.arm, self.world.scene, path, p.velocity_share, p.acceleration_share, blend
                )
            except RuntimeError:  # TOPP-RA's linear programs fail on some paths
                continue
            kept = motions.limit_share(self.arm, rounded) <= 1.05 * max(p.velocity_share, p.acceleration_share)
            motion = motions.slow_down(self.arm, rounded, p.flange_speed)
            if kept and motion.duration < within and self._is_free(motion.positions[::4], motion.positions, step):
                return motion, path
        motion = motions.stopping(self.arm, path, p.velocity_share, p.acceleration_share, p.flange_speed)
        return (motion, path) if motion.duration < within and self._is_free(path, motion.positions, step) else None

    def _is_free(self, path: Array, passed: Array, step: float) -> bool:
        """Return whether the flange stays within its space at joints (T, J) passed, and the path (N, J) is free."""
        return self._inside(passed) and self.world.path_free(path, step)

    def _inside(self, passed: Array) -> bool:
        return self.space is None or bool(self.space.contains(self.arm.forward(passed)[:, :3, 3]).all())

    def _detours(self, start: Array, goal: Array, step: float) -> Iterator[tuple[Array, Array]]:
        """Yield waypoints (N, J) of what RRT-Connect finds, shortened and as found, of a few seeds."""
        known = self._known_way(start, goal, self._known)
        if known is not None:
            yield self._shortcut(known, step, 0), known
        few, wanted = (24, 4) if known is None else (3, 2)  # seeds, and ways of them
        for seed, found in islice(self._inner_paths(start, goal, self._search_time, step, few), wanted):
            way = np.array(found.positions)
            yield self._shortcut(way, step, seed), way

    def _shortcut(self, way: Array, step: float, seed: int) -> Array:
        """Return waypoints (N, J) with shorter ways between some of them, free as far as steps [rad] tell."""
        path = JointPath()
        path.joint_names, path.positions = list(self.arm.joints), list(way)
        cut = PathShortcuttingOptions(group_name=GROUP, max_step_size=step, max_iters=100, seed=seed)
        return np.array(PathShortcutter(self.world.scene, cut).shortcut(path).positions)

    def _inner_paths(
        self, start: Array, goal: Array, seconds: float, step: float, seeds: int
    ) -> Iterator[tuple[int, JointPath]]:
        """Yield seeds and what they find within the flange's space, of which the search itself knows nothing."""
        for seed in range(seeds):
            found = self._search(start, goal, seconds, step, seed)
            if found is None:
                return
            if self._inside(_dense(np.array(found.positions))):
                yield seed, found

    def _search(self, start: Array, goal: Array, seconds: float, step: float, seed: int) -> JointPath | None:
        """Return a path by RRT-Connect, checked at `step` [rad] only, or None."""
        names = list(self.arm.joints)
        options = RRTOptions(
            group_name=GROUP,
            rrt_connect=True,
            max_nodes=20_000,
            collision_check_step_size=step,
            max_planning_time=seconds,
        )
        rrt = RRT(self.world.scene, options)
        rrt.setRngSeed(seed)
        try:
            return rrt.plan(JointConfiguration(names, start), JointConfiguration(names, goal))
        except RuntimeError:
            return None

    def _back_out(self, q: Array, *, far: bool = False) -> Place:
        """Return free joints straight back along the approach axis and the way there; None if q is free.

        `far`: the farthest, since the nearest may be a pocket among leaves.
        """
        if self.world.free(q):
            return q, None
        here, free = self.arm.forward(q), list[int]()
        behind = here @ transform(np.eye(3), [0, 0, -0.3])  # [m]: out of leaves
        poses = _kinematics.poses_between(here, behind, self._line_step)
        path = _kinematics.follow(self.arm, q[None], poses)[0]
        for i, joints in enumerate(path):
            with self.world.touching_plant():
                if (free and not far) or not (np.isfinite(joints).all() and self.world.free(joints)):
                    break
            free += [i] * (i >= 8 and self.world.free(joints))
        if not free:
            at = here[:3, 3].round(3)
            raise StageFailure("collision", f"the flange at {at} m is not free, nor straight behind it.")
        way = path[: free[-1] + 1]
        return way[-1], motions.along_line(self.arm, way, free[-1] * self._line_step, self.params.approach_speed)


def _dense(path: Array) -> Array:
    """Return joints (T, J) along the straight ways between waypoints (N, J)."""
    between = np.linspace(0, 1, 16, endpoint=False)[None, :, None]
    ways = path[:-1, None] + between * np.diff(path, axis=0)[:, None]
    return np.concatenate([ways.reshape(-1, path.shape[1]), path[-1:]])


def shake_limit(arm: ArmModel, q: ArrayLike, direction: ArrayLike, frequencies: ArrayLike) -> Array:
    """Return the amplitudes (Q,) [m] that `Planner.swing` can do at joints (J,): 0.85 of the local limits.

    The limits are the joints' velocities, accelerations and torques.
    """
    q = check_array("joints", q, (arm.count,))
    quick = shaking.amplitude_limit(arm, q, direction, frequencies)
    strong = motions.shake_amplitude(arm, q, shaking.joint_rates(arm, q, direction, frequencies), frequencies)
    share = 0.85  # of the local limit; the rest covers ramps and the bend of the joint path
    return np.minimum(share * np.minimum(quick, strong), SHAKE_CAP)


def _shake_rank(arm: ArmModel, branches: Array) -> Array:
    """Return (B,) the amplitude at 10 Hz in the worst of the three world directions [m]."""
    return np.min([shaking.amplitude_limit(arm, branches, axis, [10.0])[:, 0] for axis in np.eye(3)], axis=0)


def _steady(arm: ArmModel, way: Array) -> bool:
    """Return whether a way in was followed to its end without nearing a joint limit or a singular pose.

    Near either the way back, or the same way in other steps, might not be found again.
    """
    inside = np.all((way > arm.lower + 0.01) & (way < arm.upper - 0.01))
    return bool(inside and np.abs(np.diff(way, axis=0)).max() < 0.1)  # [rad] between two poses
