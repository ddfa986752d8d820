"""The devices of the simulated cell: they satisfy `anther.robot.devices` and advance the cell's time when commanded."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import repeat

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

from anther.core.checks import check_range
from anther.core.geometry import Array, Intrinsics, inverse, look_at, transform, transform_points
from anther.core.opencv import cv2
from anther.plant.limits import GRAVITY
from anther.robot.devices import (
    LEAD,
    ArmRecord,
    ArmSample,
    DeviceError,
    Frame,
    GripperState,
    ImuReadings,
    JointTrajectory,
    More,
    Robot,
    Watch,
)
from anther.sim._motor import CYCLE, SimMotor, sensed_force
from anther.sim.capture import CameraErrors, sensed
from anther.sim.cell import Cell, CellLog
from anther.sim.render import Scene, Still, d455

SIDE = Intrinsics(480, 480, 424.0, 424.0, 239.5, 239.5)
"""Of the side camera: the middle 480 x 480 pixels of a D455's 848 x 480: 0.62 x 0.62 m at 0.55 m, quick to render."""


class SimArm:
    """The arm. `follow` advances the cell; the gripper keeps its command meanwhile."""

    def __init__(self, cell: Cell) -> None:
        self.cell = cell

    def joints(self) -> Array:
        """Return the measured joint angles (J,) [rad]."""
        return self.cell.joints

    def follow(self, trajectory: JointTrajectory, watch: Watch | None = None, more: More | None = None) -> ArmRecord:
        """Follow a trajectory, cubic between its samples; return when it has ended and settled for 0.1 s.

        A plant that is held is stepped `Cell.fine` times as finely.
        """
        parts = self.cell.fine if self.cell.held else 1
        dt, start, told, ends = self.cell.params.timestep, self.cell.time, more is None, trajectory.duration
        q, v = _references(trajectory, 0.0, dt, last=told)
        measured = np.empty((0, self.cell.arm.count))
        try:
            with self.cell.finer(parts):
                while len(measured) < len(q):
                    if not told and dt * len(measured) >= ends - LEAD:
                        assert more is not None
                        following = more()
                        told = following is None
                        trajectory = JointTrajectory.standstill(q[-1], dt) if following is None else following
                        goes_on = _references(trajectory, ends, dt, last=told)
                        q, v = np.concatenate([q, goes_on[0]]), np.concatenate([v, goes_on[1]])
                        ends += trajectory.duration
                    rows = slice(len(measured), len(measured) + round(CYCLE / dt))
                    ahead = np.concatenate([v[1:], v[-1:]])[rows]
                    a = (ahead - v[rows]) / dt
                    openings = np.full(len(q[rows]), self.cell.grip_command)
                    steps = (np.repeat(values, parts, axis=0) for values in (q[rows], v[rows], openings, a))
                    measured = np.concatenate([measured, self.cell.run(*steps)[parts - 1 :: parts]])
                    if watch:
                        force = float(np.linalg.norm(sensed_force(self.cell)))
                        watch(ArmSample(self.cell.time, q[rows][-1], measured[-1], force))
        except BaseException:
            self.hold()
            raise
        return ArmRecord(start + dt * np.arange(1.0, len(q) + 1), q, measured)

    def hold(self) -> None:
        """Stop and hold the present position for 0.1 s."""
        q = np.tile(self.cell.joints, (round(0.1 / self.cell.params.timestep), 1))
        self.cell.run(q, np.zeros_like(q), np.full(len(q), self.cell.grip_command))


def _references(trajectory: JointTrajectory, begin: float, dt: float, *, last: bool) -> tuple[Array, Array]:
    """Return joints and rates (N, J) of a trajectory that begins at `begin` [s], at the multiples of dt after that.

    The last one is held for another 0.1 s.
    """
    curve = CubicHermiteSpline(trajectory.times, trajectory.positions, trajectory.velocities)
    ends = begin + trajectory.duration
    steps = np.arange(round(begin / dt) + 1.0, round((ends + 0.1 * last) / dt) + 1)
    t = np.clip(dt * steps - begin, 0, trajectory.duration)
    q, v = curve(t), curve(t, 1)
    if last:
        v[t >= trajectory.duration] = 0
    return q, v


class SimGripper:
    """The electric gripper: closes at 0.15 m/s, the slowest its SDK accepts, up to its holding force."""

    def __init__(self, cell: Cell) -> None:
        self.cell, self.stroke = cell, cell.arm.tool.stroke

    def move(self, opening: float) -> GripperState:
        """Move the pads to `opening` [m] apart, or until they meet resistance; return the state then.

        Raises:
            InputError: beyond the stroke.
        """
        check_range("gripper opening", opening, 0, self.stroke, "m")
        dt, start = self.cell.params.timestep, self.cell.grip_command
        ramp = abs(opening - start) / self.cell.arm.tool.speed
        settling = 0.3 if ramp > 0.01 else 0.1 if ramp > dt else 0.02  # a short way is soon settled, and no way at once
        command = np.interp(np.arange(1, round((ramp + settling) / dt) + 1) * dt, [0, ramp + 1e-9], [start, opening])
        q = np.tile(self.cell.arm_command, (len(command), 1))
        self.cell.run(q, np.zeros_like(q), command)
        return self.state()

    def state(self) -> GripperState:
        """Return the present state; something is held when the pads press with > 1 N short of their command."""
        opening, force = self.cell.opening, self.cell.grip_force
        return GripperState(opening, force, force > 1.0 and self.cell.held)


class SimCamera:
    """An RGB-D camera in the cell. Frames of a recording are rendered, from the log, when it is stopped."""

    rates = (15.0, 30.0, 60.0, 90.0)
    """Of a D455 at 848 x 480 px [1/s]."""

    def __init__(
        self,
        cell: Cell,
        scene: Scene,
        intrinsics: Intrinsics,
        pose: Callable[[], Array],
        errors: CameraErrors | None,
        *,
        seed: int = 0,
        late: float = 0.0,
        exposure: float = 0.0,
    ) -> None:
        """Build the camera.

        Args:
            cell: what it looks at.
            scene: of the plant at rest.
            intrinsics: of every frame.
            pose: gives T_world_cam (4, 4) at present.
            errors: of the sensor; None is an ideal one.
            seed: of those errors.
            late: by which its frames' times are late on the cell's clock [s].
            exposure: of each frame of a recording [s]; what moves visibly in it is blurred.
        """
        self.cell, self.scene, self.pose, self.errors = cell, scene, pose, errors
        self.intrinsics, self._late, self._exposure = intrinsics, late, exposure
        self._rng = np.random.default_rng(seed)
        self._recording: tuple[float, float] | None = None
        self._shown: dict[int, Frame] = {}
        self._still: tuple[Array, Still] | None = None

    def read(self) -> Frame:
        """Return one frame taken now."""
        vertices = self._vertices(None)
        return self._frame(self.cell.time, vertices, None, self._rng, self._still_of(vertices))

    def start(self, rate: float) -> None:
        """Begin to record at `rate` frames per second."""
        self._recording, self._shown = (self.cell.time, rate), {}

    def recorded(self, since: float) -> list[Frame]:
        """Return the frames of the recording under way that were taken from `since` on [s].

        Raises:
            DeviceError: there are none.
        """
        if self._recording is None:
            raise DeviceError("the camera records nothing: start it first.")
        start, rate = self._recording
        rows = [i for i in range(int((self.cell.time - start) * rate) + 1) if start + i / rate >= since]
        new = [i for i in rows if i not in self._shown]
        self._shown |= dict(zip(new, self._frames_at(start + np.array(new) / rate), strict=True))
        frames = [self._shown[i] for i in rows]
        if not frames:
            raise DeviceError(f"the camera has taken no frame since {since:.2f} s.")
        return frames

    def stop(self) -> list[Frame]:
        """End the recording and return its frames: those that were asked for on the way, else those of its middle."""
        if self._recording is None:
            return []
        (start, rate), self._recording = self._recording, None
        if self._shown:
            return [self._shown[i] for i in sorted(self._shown)]
        wanted = np.arange(start, self.cell.time, 1 / rate)
        surplus = max(len(wanted) - 60, 0)  # rendering takes time
        return self._frames_at(wanted[surplus // 2 : len(wanted) - (surplus + 1) // 2])

    def _frames_at(self, wanted: Array) -> list[Frame]:
        """Return the frames of times (N,), each of the log sample nearest to when it was exposed.

        A frame that is late was exposed before its time says: the first ones before the recording began.
        """
        if not len(wanted):
            return []
        log = self.cell.log()
        exposed = wanted - self._late
        after = np.clip(np.searchsorted(log.times, exposed), 1, len(log.times) - 1)
        samples = after - (exposed - log.times[after - 1] < log.times[after] - exposed)
        shapes = [self._vertices(log.qpos[i]) for i in samples]
        ways = [self._way(log, int(i)) for i in samples]
        still = self._still_of(shapes[0])
        rngs = self._rng.spawn(len(samples))
        with ThreadPoolExecutor(2) as pool:
            return list(pool.map(self._frame, log.times[samples].tolist(), shapes, ways, rngs, repeat(still)))

    def _still_of(self, shape: Array) -> Still:
        """Return the still from where the camera is; if there is none yet, of the plant in this shape (Nv, 3)."""
        pose = self.pose()
        if self._still is None or not np.array_equal(self._still[0], pose):
            self._still = (pose, self.scene.moved(shape).still(self.intrinsics, pose))
        return self._still[1]

    def _pixels(self, way: Array, vertices: Array) -> Array:
        """Return how long ways (Nv, 3) [m] of vertices (Nv, 3) are in the image (Nv,) [px]."""
        T = self.pose()
        depth = np.maximum((vertices - T[:3, 3]) @ T[:3, 2], 0.1)
        return np.asarray(self.intrinsics.fx * np.linalg.norm(way, axis=1) / depth)

    def _blurred(self, way: Array, vertices: Array) -> NDArray[np.bool_]:
        """Return (H, W) where what moves visibly in an exposure may be, by ways (Nv, 3) of vertices (Nv, 3) [m]."""
        moved = self._pixels(way, vertices)
        fast = transform_points(inverse(self.pose()), vertices[moved > 1.0])  # px
        column, row = np.rint(self.intrinsics.project(fast[fast[:, 2] > 0])).astype(int).T
        mask = np.zeros((self.intrinsics.height, self.intrinsics.width), dtype=np.uint8)
        inside = (row >= 0) & (row < mask.shape[0]) & (column >= 0) & (column < mask.shape[1])
        mask[row[inside], column[inside]] = 1
        reach = round(6 + float(moved.max()))
        return np.asarray(cv2.dilate(mask, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0)

    def _vertices(self, qpos: Array | None) -> Array:
        return self.cell.plant.posed_vertices(self.cell.segment_poses(qpos))

    def _way(self, log: CellLog, sample: int) -> Array | None:
        """Return by how much the plant's vertices (Nv, 3) move in an exposure [m]; None: nothing that is seen."""
        if self._exposure == 0:
            return None
        before, after = max(sample - 1, 0), min(sample + 1, len(log.times) - 1)
        here = self._vertices(log.qpos[after])
        way = (here - self._vertices(log.qpos[before])) * self._exposure / (log.times[after] - log.times[before])
        return way if self._pixels(way, here).max() > 1.0 else None  # px

    def _frame(self, time: float, vertices: Array, way: Array | None, rng: np.random.Generator, still: Still) -> Frame:
        pose, eye, here = self.pose(), self.intrinsics, self.scene.moved(vertices)
        moments = [here] * 3
        if way is not None:
            moments[0], moments[2] = (self.scene.moved(vertices + share * way) for share in (-0.33, 0.33))  # exposures
        changing, fine = still.changing(eye, pose, [m.shape for m in (moments if way is not None else [here])])
        image = here.render(eye, pose, still.image, changing)
        if way is not None:
            fine |= changing & self._blurred(way, vertices)
        # place in each pixel [px]: by one ray alone, what moves by half a pixel seems to jump
        shots = [
            moment.render(replace(eye, cx=eye.cx - across, cy=eye.cy - down), pose, image, fine).rgb
            for moment, across, down in zip(moments, (-0.25, 0.25, -0.1), (-0.25, 0.0, 0.25), strict=True)
        ]
        rgb = np.rint(np.mean(shots, axis=0)).astype(np.uint8)
        if self.errors is None:
            return Frame(time + self._late, rgb, image.depth)
        return sensed(replace(image, rgb=rgb), time + self._late, eye, rng, self.errors)


class SimImu:
    """An accelerometer and a gyroscope in the wrist camera, as the truth has them.

    Its clock is as late as the side camera's: both are read by one computer.

    Args:
        cell: whose hand it rides on.
        seed: of its noise, and of the way in which it is turned.
    """

    rate = 250.0
    """Of the accelerometer of a D435i or D455, the fastest [1/s] (librealsense: doc/d435i.md)."""

    def __init__(self, cell: Cell, seed: int = 0) -> None:
        self.cell, self._rng = cell, np.random.default_rng(seed)
        self.T_cam_imu = transform(np.eye(3), [-0.0055, 0.0051, 0.0117])  # of a D435i (librealsense: doc/d435i.md)
        way = self._rng.normal(size=3)
        turned = Rotation.from_rotvec(cell.truth.imu_tilt * way / np.linalg.norm(way)).as_matrix()
        self._T_flange_imu = cell.arm.tool.T_flange_cam @ self.T_cam_imu @ transform(turned, np.zeros(3))
        self._since: float | None = None

    def start(self) -> None:
        """Begin to record."""
        self._since = self.cell.time

    def recorded(self, since: float) -> ImuReadings:
        """Return what was read from `since` on [s].

        Raises:
            DeviceError: nothing is recorded.
        """
        if self._since is None:
            raise DeviceError("the inertial sensor records nothing: start it first.")
        log, late = self.cell.log(), self.cell.truth.clock_offset
        begin = max(since - late, self._since)
        wanted = np.arange(begin, min(self.cell.time - late, log.times[-2]), 1 / self.rate)
        rows = np.unique(np.clip(np.searchsorted(log.times, wanted), 1, len(log.times) - 2))
        if not len(rows):
            return ImuReadings.none()
        poses = self.cell.flange_pose(log.qpos[rows[:, None] + [-1, 0, 1]]) @ self._T_flange_imu
        step = np.diff(log.times[rows[:, None] + [-1, 0, 1]]).mean(axis=1)[:, None]
        place, R = poses[..., :3, 3], poses[..., :3, :3]
        force = (place[:, 0] - 2 * place[:, 1] + place[:, 2]) / step**2 + [0.0, 0.0, GRAVITY]
        force = np.einsum("nij,ni->nj", R[:, 1], force)
        turned = Rotation.from_matrix(np.swapaxes(R[:, 0], 1, 2) @ R[:, 2]).as_rotvec() / (2 * step)
        noise, scale = self.cell.truth.imu_noise * self._rng.normal(size=(2, *force.shape)), self.cell.truth.imu_scale
        return ImuReadings(log.times[rows] + late, scale * force + noise[0], scale * turned + 0.01 * noise[1])

    def stop(self) -> None:
        """End the recording."""
        self._since = None


def side_pose(cell: Cell, distance: float = 0.55) -> Array:
    """Return T_world_cam of the side camera: level with the flowers, at their side, square to the arm's approach.

    Args:
        cell: with the plant.
        distance: from the plant's axis [m].
    """
    plant = cell.plant
    heights = plant.flower_position[:, 2] if len(plant.flower_position) else plant.end[:, 2]
    target = np.array([*plant.pot.centre[:2], float(np.median(heights))])
    return look_at(target + np.array([0.05, -distance, 0.08]), target)


def robot_of(
    cell: Cell,
    *,
    errors: CameraErrors | None = None,
    T_world_side_camera: Array | None = None,
    seed: int = 0,
    scene: Scene | None = None,
    wrist_lens: Intrinsics | None = None,
    side_lens: Intrinsics | None = SIDE,
    has_imu: bool = True,
) -> Robot:
    """Return the devices of a cell: arm, gripper, both cameras, the wrist camera's inertial sensor, and the motor if
    there is one.

    Args:
        cell: the world.
        errors: of both cameras' sensors; None is ideal cameras.
        T_world_side_camera: where the side camera stands; None takes `side_pose`.
        seed: of the errors.
        scene: of the plant at rest, if it has been built already.
        wrist_lens: None is a D455's 1280 x 720.
        side_lens: None: there is no side camera.
        has_imu: whether the wrist camera has an inertial sensor.
    """
    scene = scene or Scene.of_plant(cell.plant)
    T_side = side_pose(cell) if T_world_side_camera is None else T_world_side_camera
    lens, hand_eye = wrist_lens or d455(), cell.arm.tool.T_flange_cam
    wrist = SimCamera(cell, scene, lens, lambda: cell.flange_pose() @ hand_eye, errors, seed=seed)
    motor = SimMotor(cell) if cell.params.coil_force else None
    imu = SimImu(cell, seed + 2) if has_imu else None
    T_flange_imu = None if imu is None else hand_eye @ imu.T_cam_imu
    if side_lens is None:
        return Robot(SimArm(cell), SimGripper(cell), wrist, motor=motor, imu=imu, T_flange_imu=T_flange_imu)
    side = SimCamera(
        cell,
        scene,
        side_lens,
        lambda: T_side,
        errors,
        seed=seed + 1,
        late=cell.truth.clock_offset,
        exposure=cell.truth.exposure_time,
    )
    return Robot(SimArm(cell), SimGripper(cell), wrist, side, T_side, motor, imu=imu, T_flange_imu=T_flange_imu)
