"""The driver of Franka arms in motion; behind pylibfranka's objects a fake holds it to the FR3's limits.

What every streamed arm keeps is checked in test_conformance.py."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import numpy as np
import pytest
from fake_franka import (
    ACCELERATION,
    JERK,
    LOST,
    PATIENCE,
    READY,
    FakeFranka,
    RobotMode,
    connected,
    far,
    model,
)
from slow_clock import SLOWER

from anther.core.errors import InputError
from anther.robot.devices import Arm, ArmSample, DeviceError, JointTrajectory, Watch
from anther.robot.drivers._franka_loop import CYCLE, Loop, Path
from anther.robot.drivers.franka import Franka

pytestmark = pytest.mark.flaky(reruns=3, only_rerun=[r"the newest joints are \d+ ms old", "nobody looked at the arm"])
STANDS = 0.6 / (Path.brakes * ACCELERATION) + Path.smooth * CYCLE + 0.015
"""An arm at 0.6 rad/s stands so long after whoever moves it is gone [s]."""


@pytest.fixture
def fr3() -> Iterator[FakeFranka]:
    with closing(FakeFranka()) as fake:
        yield fake


@pytest.fixture
def arm(fr3: FakeFranka) -> Iterator[Franka]:
    with closing(connected(fr3)) as driver:
        yield driver
        fr3.mute = fr3.dead = False


def begun(start: np.ndarray, speed: float = 0.5, seconds: float = 0.4) -> JointTrajectory:
    """Return a motion from `start` that ends at a speed of all joints [rad/s]."""
    t = np.linspace(0, seconds, 60)[:, None]
    rate = speed * np.ones(7)
    return JointTrajectory(t[:, 0], start + rate * t**2 / (2 * seconds), rate * t / seconds)


def jumping(start: np.ndarray, acceleration: float) -> JointTrajectory:
    """Return 0.4 s of a swing of the last joint whose acceleration jumps between + and - `acceleration` [rad/s^2]."""
    k = np.arange(400)
    v = np.r_[0, np.cumsum(acceleration * CYCLE * np.where((k < 100) | (k >= 300), 1.0, -1.0))]
    q = np.r_[0, np.cumsum((v[1:] + v[:-1]) / 2 * CYCLE)]
    last = np.eye(7)[6]
    return JointTrajectory(CYCLE * np.arange(401), start + q[:, None] * last, v[:, None] * last)


def when(fr3: FakeFranka, watch_for: float, do: Watch) -> Watch:
    """Return a watcher that does something once, when a joint is so far from the begin [rad]."""
    done = list[bool]()

    def watch(sample: ArmSample) -> None:
        if np.abs(sample.measured - READY).max() > watch_for and not done:
            done.append(True)
            do(sample)

    return watch


def jerks(aims: np.ndarray) -> tuple[float, float]:
    """Return the greatest acceleration and jerk of joints (T, 7), one row a cycle."""
    a = np.diff(aims, 2, axis=0) / CYCLE**2
    return float(np.abs(a).max()), float(np.abs(np.diff(a, axis=0)).max() / CYCLE)


def test_it_goes_where_it_is_told_and_says_so(arm: Franka, fr3: FakeFranka) -> None:
    conforms: Arm = arm
    start, seen = conforms.joints(), list[ArmSample]()
    assert start == pytest.approx(np.array(READY) - fr3.sag)
    record = arm.follow(far(arm, 0.05), seen.append)
    assert record.commanded[-1] == pytest.approx(start + 0.05, abs=1e-6)
    assert arm.joints() == pytest.approx(start + 0.05, abs=2e-3)
    assert np.all(np.diff(record.times) > 0)
    assert len(seen) == len(record.times) > 50 * (record.times[-1] - record.times[0])
    assert abs(record.times[-1] - fr3.now) < 1.0  # on this machine's clock, though the robot's is another
    assert max(np.abs(s.measured - s.commanded).max() for s in seen) == pytest.approx(fr3.sag)
    assert seen[-1].force == pytest.approx(1.0)
    assert fr3.mode is RobotMode.Idle
    arm.hold()
    assert arm.follow(far(arm, -0.05)).times[0] >= record.times[-1]


def test_what_comes_too_late_ends_in_a_braked_hold(arm: Franka, fr3: FakeFranka) -> None:
    begin = begun(arm.joints(), 0.6)
    with pytest.raises(DeviceError, match="next motion comes too late"):
        arm.follow(begin, None, lambda: fr3.sleep(0.6))
    assert fr3.stopped_after(fr3.now) == 0.0
    assert fr3.mode is RobotMode.Idle  # its own braking, no reflex
    fastest, way = begin.positions[-1], 0.6**2 / (2 * Path.brakes * ACCELERATION)
    assert np.abs(fr3.aim - fastest).max() == pytest.approx(way, rel=0.2)
    acceleration, jerk = jerks(np.array([aim for _, aim in fr3.log]))
    assert acceleration < ACCELERATION
    assert jerk < 0.6 * JERK


def test_a_shake_whose_acceleration_jumps_keeps_the_jerk_limit(arm: Franka, fr3: FakeFranka) -> None:
    path = jumping(arm.joints(), 9.0)
    assert jerks(path.positions)[1] > JERK  # told as it is, the robot would stop
    record = arm.follow(path)
    assert record.commanded[-1] == pytest.approx(path.positions[-1], abs=1e-6)
    acceleration, jerk = jerks(np.array([aim for _, aim in fr3.log]))
    assert 8.0 < acceleration < ACCELERATION
    assert jerk < 0.6 * JERK


def test_commands_begin_at_the_robots_own_and_keep_its_time() -> None:
    """Without threads: what is commanded in each cycle."""
    start, aim = np.zeros(7), np.full(7, 0.02)
    motion = JointTrajectory.standstill(start, 1.0)
    path, other = (Path(aim, motion, np.full(7, 10.0), False) for _ in range(2))
    assert path.step(0) == pytest.approx(aim)
    rows = np.array([path.step(1) for _ in range(1200)])
    assert np.abs(rows[round(Path.fades / CYCLE) + Path.smooth :]).max() < 1e-12
    assert jerks(rows)[0] < 1.0
    assert path.over
    told = [other.step(3) for _ in range(400)]  # a robot that lost commands tells how many cycles went by
    assert np.array(told) == pytest.approx(rows[2::3])


def test_a_path_that_brakes_takes_nothing_more() -> None:
    first = begun(np.zeros(7), 0.5)
    path = Path(np.zeros(7), first, np.full(7, 10.0), True)
    path.step(300)
    assert path.asks()
    assert not path.asks()
    path.brake("enough")
    path.join(first)
    path.brake("something else")
    rows = np.array([path.step(1) for _ in range(300)])
    assert path.over
    assert path.why == "enough"
    assert np.abs(np.diff(rows, axis=0))[-100:].max() == 0


def test_a_moments_delay_at_rest_is_waited_for(arm: Franka, fr3: FakeFranka) -> None:
    fr3.lag = 0.2
    fr3.sleep(0.05)
    with ThreadPoolExecutor(1) as pool:
        waits = pool.submit(arm.joints)
        fr3.sleep(0.1)
        assert not waits.done()
        fr3.lag = 0.0
        assert waits.result() == pytest.approx(np.array(READY) - fr3.sag)
    arm.follow(far(arm, 0.02))


def test_it_stops_when_the_robot_is_heard_no_more(arm: Franka, fr3: FakeFranka) -> None:
    since = list[float]()

    def cut(sample: ArmSample) -> None:
        since.append(fr3.now)
        fr3.mute = True

    path = far(arm, 0.4)
    with pytest.raises(DeviceError, match="ms old"):
        arm.follow(path, when(fr3, 0.1, cut))
    assert fr3.stopped_after(since[0]) < LOST * CYCLE + 2.0 / ACCELERATION  # by the robot itself
    with pytest.raises(DeviceError, match=r"the robot|ms old"):
        arm.follow(path)


def test_models_of_other_joints_are_refused(fr3: FakeFranka) -> None:
    with pytest.raises(InputError, match="got 6 joints; allowed: 7"):
        connected(fr3, names=[f"j{i}" for i in range(6)])


def test_a_motion_that_begins_elsewhere_is_refused(arm: Franka, fr3: FakeFranka) -> None:
    q = arm.joints()
    for start, message in ((q + 0.1, "rad from where the arm is; allowed: 0.05"), (q[:6], "6 joints; allowed: 7")):
        with pytest.raises(DeviceError, match=message):
            arm.follow(JointTrajectory.standstill(start, 0.1))
    assert fr3.calls == []


REASONS = [
    (RobotMode.UserStopped, "", "user stop is pressed"),
    (RobotMode.Reflex, "joint_reflex", r"stopped by itself \(joint_reflex\): .*anther cell enable"),
    (RobotMode.Guiding, "", "somebody guides it by hand"),
    (RobotMode.Other, "", "joints are locked, or Desk has it"),
]


@pytest.mark.parametrize(("mode", "error", "message"), REASONS)
def test_the_robots_own_reasons_end_a_motion_and_refuse_the_next(
    arm: Franka, fr3: FakeFranka, mode: RobotMode, error: str, message: str
) -> None:
    with pytest.raises(DeviceError, match=message):
        arm.follow(far(arm, 0.4), when(fr3, 0.1, lambda sample: fr3.reflex(error, mode)))
    assert fr3.stopped_after(fr3.now) < 0.3
    with pytest.raises(DeviceError, match=message):
        arm.follow(far(arm, 0.01))
    assert fr3.calls == ["start"]
    assert any(line.startswith("cannot move: ") for line in arm.describe())


def test_a_person_enables_it_after_a_reflex(arm: Franka, fr3: FakeFranka) -> None:
    fr3.stand("joint_reflex", RobotMode.Reflex)
    with pytest.raises(DeviceError):
        arm.follow(far(arm, 0.02))
    arm.hold()
    assert fr3.calls == []  # nothing is released without a person
    fr3.recovered = False
    with pytest.raises(DeviceError, match="manual recovery required"):
        arm.enable()
    fr3.recovered, before = True, fr3.aim.copy()
    arm.enable()
    assert fr3.aim == pytest.approx(before)
    assert "ready to move" in arm.describe()
    arm.follow(far(arm, 0.02))


@pytest.mark.parametrize(("mode", "message"), [(RobotMode.UserStopped, "release it"), (RobotMode.Other, "unlock them")])
def test_what_only_a_person_can_release_is_told(arm: Franka, fr3: FakeFranka, mode: RobotMode, message: str) -> None:
    fr3.stand("", mode)
    with pytest.raises(DeviceError, match=message):
        arm.enable()
    assert fr3.calls == []
    fr3.stand("", RobotMode.Idle)
    arm.enable()
    assert fr3.calls == []


def test_readings_that_nobody_looks_at_end_the_motion(arm: Franka, fr3: FakeFranka) -> None:
    since = list[float]()

    def hang(sample: ArmSample) -> None:
        since.append(fr3.now)
        fr3.sleep(Loop.unseen + 0.35)

    with pytest.raises(DeviceError, match=r"nobody looked at the arm's readings|ms old"):
        arm.follow(far(arm), when(fr3, 0.1, hang))
    assert fr3.stopped_after(since[0]) < Loop.unseen + 0.02 + 2.0 / (Path.brakes * ACCELERATION)
    assert fr3.mode is RobotMode.Idle


def in_full_motion(arm: Franka, fr3: FakeFranka) -> threading.Thread:
    """Begin a motion, and return once it goes at 0.5 rad/s or more."""

    def follow() -> None:
        with pytest.raises(DeviceError):
            arm.follow(begun(arm.joints(), 0.6, 0.6), None, lambda: fr3.sleep(2.0))

    thread = threading.Thread(target=follow)
    thread.start()
    while np.abs(fr3.v).max() < 0.5:
        time.sleep(1e-3)
    return thread


def test_a_driver_that_is_gone_leaves_an_arm_that_its_loop_brakes(arm: Franka, fr3: FakeFranka) -> None:
    """kill -9 closes the pipe."""
    thread = in_full_motion(arm, fr3)
    arm._pipe.close()
    since = fr3.now
    assert fr3.stopped_after(since) < min(STANDS, 0.1)
    thread.join()
    assert fr3.mode is RobotMode.Idle


def test_a_loop_that_is_gone_leaves_an_arm_that_the_robot_brakes(arm: Franka, fr3: FakeFranka) -> None:
    thread = in_full_motion(arm, fr3)
    fr3.dead, since = True, fr3.now
    assert fr3.stopped_after(since) < LOST * CYCLE + 0.65 / ACCELERATION + 0.01
    assert fr3.mode is RobotMode.Reflex
    fr3.dead = False
    thread.join()
    with pytest.raises(DeviceError, match="communication_constraints_violation"):
        arm.follow(far(arm, 0.01))


def test_the_fake_keeps_the_slow_clock_of_its_model() -> None:
    assert SLOWER * CYCLE < PATIENCE
    assert model().acceleration == pytest.approx(ACCELERATION)
