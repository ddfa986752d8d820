"""The simulated arm goes on without a stop, and the simulated camera shows meanwhile what it has recorded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from fake_robot import LIMITS
from straight_plant import straight_plant

from anther.core.errors import StageFailure
from anther.core.geometry import ComplexArray
from anther.robot.arm.sawyer import SAWYER
from anther.robot.arm.shaking import swing_trajectory
from anther.robot.devices import LEAD, ArmRecord, ArmSample, Camera, DeviceError, JointTrajectory
from anther.robot.imu import measure_motion
from anther.robot.imu_testing import IMU_CHECKS, ImuRig
from anther.robot.safety import GuardedArm
from anther.robot.swing import Swing
from anther.sim.cell import Cell
from anther.sim.robot import SimArm, robot_of
from anther.sim.truth import NOMINAL, Truth

FIRST = Swing.first([4.0, 7.0], [0.002, 0.001], 0.8, 0.3)
SECOND = FIRST.then([0.004, 0.0], 0.7, 0.3)
LAST = SECOND.then(0.0, 0.3, 0.3)
ALONG = np.array([0.0, 1.0, 0.0])


@pytest.fixture
def cell() -> Cell:
    return Cell(straight_plant())


def motion(piece: Swing) -> JointTrajectory:
    return swing_trajectory(SAWYER, SAWYER.neutral, ALONG, [piece], 0.005)


def swung(cell: Cell, note: Callable[[float], None] = lambda _: None) -> ArmRecord:
    """Swing in three pieces; `note` is told the cell's time whenever the arm asks what follows."""
    rest = iter([motion(SECOND), motion(LAST)])

    def more() -> JointTrajectory | None:
        note(cell.time)
        return next(rest, None)

    return GuardedArm(SimArm(cell), LIMITS).follow(motion(FIRST), None, more)


def test_it_asks_for_what_follows_a_little_before_the_end_of_each_motion(cell: Cell) -> None:
    asked, start = list[float](), cell.time
    swung(cell, asked.append)
    ends = np.cumsum([piece.seconds for piece in (FIRST, SECOND, LAST)])
    assert np.array(asked) - start == pytest.approx(ends - LEAD, abs=0.011)


def test_joined_motions_are_one(cell: Cell) -> None:
    record = swung(cell)
    dt = np.diff(record.times)
    assert dt == pytest.approx(dt[0], rel=1e-6)
    seconds = FIRST.seconds + SECOND.seconds + LAST.seconds
    assert np.ptp(record.times) == pytest.approx(seconds + 0.1, abs=0.003)
    passed = record.times - record.times[0] + dt[0]
    y = SAWYER.forward(record.commanded)[:, 1, 3] - SAWYER.forward(SAWYER.neutral)[1, 3]
    for piece in (FIRST, SECOND, LAST):
        own = (passed >= piece.begin) & (passed <= piece.begin + piece.seconds)
        assert y[own] == pytest.approx(piece.motion(passed[own] - piece.begin)[0], abs=3e-6)
    for joints, most in ((record.commanded, 0.05), (record.measured, 0.05)):
        rates = np.diff(joints, axis=0) / dt[0]
        jumps = np.abs(np.diff(rates, axis=0)).max(axis=1)
        assert jumps.max() < most, "no jump in speed"
        seams = np.searchsorted(passed, [FIRST.seconds, SECOND.begin + SECOND.seconds])
        usual = np.median(jumps)
        assert max(jumps[s - 3 : s + 3].max() for s in seams) < 10 * usual + 1e-3
    assert np.abs(record.measured - record.commanded).max() < 0.01
    assert record.measured[-1] == pytest.approx(SAWYER.neutral, abs=2e-3)


def test_a_motion_that_nothing_follows_is_as_it_was(cell: Cell) -> None:
    whole = swing_trajectory(SAWYER, SAWYER.neutral, ALONG, [Swing.first([4.0], [0.0], 0.6, 0.3)], 0.005)
    plain = SimArm(cell).follow(whole)
    asked = SimArm(Cell(straight_plant())).follow(whole, None, lambda: None)
    assert np.ptp(plain.times) == pytest.approx(np.ptp(asked.times), abs=0.003)
    assert np.abs(plain.measured[-1] - asked.measured[-1]).max() < 1e-4


def test_a_motion_that_does_not_join_stops_the_arm_where_it_is(cell: Cell) -> None:
    arm = GuardedArm(SimArm(cell), LIMITS)
    with pytest.raises(StageFailure, match="jump in speed"):
        arm.follow(motion(FIRST), None, lambda: motion(FIRST))
    stopped = cell.joints
    SimArm(cell).hold()
    assert cell.joints == pytest.approx(stopped, abs=2e-3)


@pytest.mark.parametrize("piece", [FIRST, SECOND, LAST], ids=["first", "second", "last"])
def test_ctrl_c_in_any_motion_holds(cell: Cell, piece: Swing) -> None:
    rest, start = iter([motion(SECOND), motion(LAST)]), cell.time

    def watch(sample: ArmSample) -> None:
        if sample.time - start > piece.begin + 0.5 * piece.seconds:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        SimArm(cell).follow(motion(FIRST), watch, lambda: next(rest, None))
    assert cell.time - start < piece.begin + 0.5 * piece.seconds + 0.2
    stopped = cell.joints
    SimArm(cell).hold()
    assert cell.joints == pytest.approx(stopped, abs=2e-3)


# The camera.


def side_camera(cell: Cell) -> Camera:
    camera = robot_of(cell).side_camera
    assert camera is not None
    return camera


def pass_time(cell: Cell, seconds: float) -> None:
    SimArm(cell).follow(JointTrajectory.standstill(cell.joints, seconds))


def test_frames_since_then_and_no_others_are_shown_in_order(cell: Cell) -> None:
    camera, start = side_camera(cell), cell.time
    camera.start(30.0)
    pass_time(cell, 0.3)
    since = start + 0.21
    frames = camera.recorded(since)
    times = np.array([f.time for f in frames])
    assert np.all(np.diff(times) > 0)
    assert times.min() >= since - 0.002
    assert times.max() <= cell.time
    assert len(frames) == pytest.approx((cell.time - since) * 30, abs=1.01)
    pass_time(cell, 0.1)
    later = camera.recorded(cell.time - 0.1)
    assert min(f.time for f in later) >= cell.time - 0.102
    assert max(f.time for f in later) > times.max()


def test_a_frame_that_was_shown_is_not_taken_again_and_the_end_returns_what_was_shown(cell: Cell) -> None:
    camera, start = side_camera(cell), cell.time
    camera.start(20.0)
    pass_time(cell, 0.2)
    first = camera.recorded(start + 0.1)
    again = camera.recorded(start + 0.1)
    assert all(a is b for a, b in zip(first, again, strict=True))
    pass_time(cell, 0.2)
    second = camera.recorded(cell.time - 0.12)
    film = camera.stop()
    assert {id(f) for f in film} == {id(f) for f in [*first, *second]}
    assert np.all(np.diff([f.time for f in film]) > 0)
    assert camera.stop() == []


def test_a_camera_that_shows_nothing_says_so(cell: Cell) -> None:
    camera = side_camera(cell)
    with pytest.raises(DeviceError, match="start it first"):
        camera.recorded(cell.time)
    camera.start(20.0)
    pass_time(cell, 0.1)
    with pytest.raises(DeviceError, match="no frame since"):
        camera.recorded(cell.time + 0.01)
    assert len(camera.stop()) >= 2, "one that was never looked at is rendered at its end"
    camera.start(20.0)
    pass_time(cell, 0.1)
    camera.recorded(cell.time - 0.1)
    camera.stop()
    camera.start(20.0)
    begun = cell.time
    pass_time(cell, 0.1)
    assert min(f.time for f in camera.stop()) >= begun - 0.002, "nothing is left of the one before"


# The inertial sensor.


def moved_and_told(truth: Truth) -> tuple[ComplexArray, ComplexArray]:
    """Return the phasors of the grip in a swing, by the log, and by the sensor in the wrist camera [m]."""
    cell, long = Cell(straight_plant(), truth=truth), Swing.first([4.0, 7.0], [0.002, 0.001], 1.6, 0.3)
    robot, pose, start = robot_of(cell, seed=5), cell.flange_pose(), cell.time
    assert robot.imu is not None
    assert robot.T_flange_imu is not None
    rest = iter([motion(long.then(0.0, 0.3, 0.3))])
    robot.imu.start()
    SimArm(cell).follow(motion(long), None, lambda: next(rest, None))
    span, point = (start + 0.5, start + 1.5), (pose @ cell.arm.tool.T_flange_grasp)[:3, 3]
    told, late = robot.imu.recorded(start), truth.clock_offset
    clock = (span[0] + late, span[1] + late)
    found, std = measure_motion(told, clock, pose @ robot.T_flange_imu, point, long.frequencies)
    assert std.max() < 1e-4
    found *= np.exp(2j * np.pi * long.frequencies * late)[:, None]
    log = cell.log()
    rows = (log.times >= span[0]) & (log.times <= span[1])
    angle = 2 * np.pi * log.times[rows, None] * long.frequencies
    basis = np.column_stack([np.sin(angle), np.cos(angle), np.ones(rows.sum()), log.times[rows] - span[0]])
    path = (cell.flange_pose(log.qpos[rows]) @ cell.arm.tool.T_flange_grasp)[:, :3, 3]
    parts = np.linalg.lstsq(basis, path, rcond=None)[0]
    return parts[:2] + 1j * parts[2:4], found


@pytest.mark.parametrize(
    ("truth", "error"),
    [
        (replace(NOMINAL, imu_noise=0.0), 0.03),
        (replace(NOMINAL, imu_noise=0.0, joint_stiffness=8.0, servo_bandwidth=6.0), 0.03),
        (replace(NOMINAL, imu_scale=0.92, imu_noise=0.0), 0.12),
        (replace(NOMINAL, clock_offset=0.02), 0.1),
    ],
    ids=["stiff", "soft joints", "scale", "late"],
)
def test_the_inertial_sensor_tells_what_the_grip_does(truth: Truth, error: float) -> None:
    moved, told = moved_and_told(truth)
    off = np.linalg.norm(told - moved) / np.linalg.norm(moved)
    assert off < error
    assert (off > 0.07) == (truth.imu_scale != 1.0), "a sensor that errs does"


def test_the_inertial_sensor_reads_nothing_before_it_is_started(cell: Cell) -> None:
    imu = robot_of(cell).imu
    assert imu is not None
    with pytest.raises(DeviceError, match="start it first"):
        imu.recorded(0.0)


@pytest.mark.parametrize("check", IMU_CHECKS, ids=lambda check: check.__name__)
def test_the_inertial_sensor_passes_the_kit(cell: Cell, check: Callable[[ImuRig], None]) -> None:
    robot = robot_of(cell)

    def stand(seconds: float) -> None:
        robot.arm.follow(JointTrajectory.standstill(cell.joints, seconds))

    check(ImuRig(lambda: robot.imu, lambda: cell.time, stand, rate=250.0))  # type: ignore[arg-type, return-value]
