"""The driver of Universal Robots arms in motion, with a fake controller behind ur_rtde's three objects.

What every streamed arm keeps is checked in test_conformance.py."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from multiprocessing.managers import BaseManager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_ur import READY, FakeDashboard, FakeReceive, FakeUR, connected, far
from slow_clock import AGAIN_IF_HELD_UP, HELD_UP, clock, sleep
from streamed_motions import halfway

from anther.robot.devices import Arm, ArmSample, DeviceError, JointTrajectory
from anther.robot.drivers.ur_rtde import UniversalRobot

HERE = Path(__file__).parents[1] / "support"
STANDS = 1 / UniversalRobot.watchdog + 0.6 / 5.0 + 0.05
"""An arm at 0.6 rad/s stands so long after the last command [s]: the watchdog, the fake's braking, and some slack."""
pytestmark = AGAIN_IF_HELD_UP


@pytest.fixture
def ur() -> Iterator[FakeUR]:
    with closing(FakeUR(clock=clock, sleep=sleep)) as fake:
        yield fake


@pytest.fixture
def arm(ur: FakeUR) -> Iterator[UniversalRobot]:
    with closing(connected(ur)) as driver:
        yield driver
        ur.dead = False


def begun(arm: Arm, speed: float = 0.5, seconds: float = 0.5) -> JointTrajectory:
    """Return a motion that ends at a speed of all joints [rad/s]."""
    t = np.linspace(0, seconds, 60)[:, None]
    rate = speed * np.ones(6)
    return JointTrajectory(t[:, 0], arm.joints() + rate * t**2 / (2 * seconds), rate * t / seconds)


def test_every_motion_has_its_own_program_and_watchdog_and_none_is_left_armed(arm: UniversalRobot, ur: FakeUR) -> None:
    """UR's script manual: a watchdog ends with its program only."""
    assert ur.heard == []
    assert arm.joints() == pytest.approx(READY, abs=1e-9)
    for n in (1, 2):
        waiting = ur.program
        assert waiting is not None
        assert waiting.watchdog == 0
        ur.calls.clear()
        record = arm.follow(far(arm, 0.02 * n))
        assert abs(record.times[-1] - clock()) < 1.0  # on this machine's clock, though the controller's is another
        said = [
            name for name in ur.calls if name in ("setWatchdog", "kickWatchdog", "servoJ", "servoStop", "stopScript")
        ]
        assert said[0] == "setWatchdog"
        assert said[1:-2] == ["kickWatchdog", "servoJ"] * (len(said[1:-2]) // 2)
        assert said[-2:] == ["servoStop", "stopScript"]
        assert waiting.watchdog == UniversalRobot.watchdog
        assert ur.program is not waiting
    sleep(3 / UniversalRobot.watchdog)
    assert not ur.protective


def test_the_driver_brakes_within_the_arms_acceleration(arm: UniversalRobot, ur: FakeUR) -> None:
    begin = begun(arm, 0.6)
    with pytest.raises(DeviceError):
        arm.follow(begin, None, lambda: sleep(0.6))
    t, q = np.array([when for when, _ in ur.heard]), np.array([target for _, target in ur.heard])
    end = np.argmax(t > t[0] + begin.duration)
    way = np.abs(q[-1] - q[end]).max()
    assert way == pytest.approx(0.6**2 / (2 * 5.0), rel=0.5)  # of the 5 rad/s^2 that the model gives
    coarse = np.arange(t[end], t[-1], 0.03)
    rate = np.diff(np.interp(coarse, t, q[:, 0])) / 0.03
    assert (-np.diff(rate) / 0.03).max() < 1.5 * 5.0
    assert rate[-1] == pytest.approx(0.0, abs=1e-3)


def test_a_controller_that_says_nothing_is_not_connected_to(ur: FakeUR, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("anther.robot.drivers.ur_controller.Controller.wait.__defaults__", (0.3,))
    ur.mute = True
    with pytest.raises(DeviceError, match="is not heard"):
        connected(ur)


def test_joints_of_another_count_are_refused(ur: FakeUR) -> None:
    with pytest.raises(DeviceError, match="the robot has 6; allowed: 7"):
        connected(ur, names=[f"j{i}" for i in range(7)], model="sawyer")


def test_a_motion_that_begins_elsewhere_is_refused(arm: UniversalRobot, ur: FakeUR) -> None:
    q = arm.joints()
    for start in (q + 0.1, np.append(q, 0.0)):
        with pytest.raises(DeviceError, match="rad from where the arm is"):
            arm.follow(JointTrajectory.standstill(start, 0.1))
    assert ur.heard == []


REASONS = [
    ({"pressed": True}, "emergency stop is pressed"),
    ({"protective": True}, "made a protective stop: .*anther cell enable"),
    ({"protective": True, "pauses": True}, "made a protective stop"),
    ({"safeguard": True}, "safety system says safeguard stop"),
    ({"mode": 5}, r"motors are not on \(idle\): anther cell enable"),
    ({"slider": 0.5}, "speed slider stands at 50%"),
    ({"scaling": 0.4}, "goes at 40% of the speed"),
    ({"paused": True}, "paused on the pendant"),
    ({"program": None}, "program on it was stopped"),
    ({"connected": False}, "connection is lost"),
]


@pytest.mark.parametrize(("change", "message"), REASONS)
def test_the_robots_own_reasons_end_a_motion_and_refuse_the_next(
    arm: UniversalRobot, ur: FakeUR, change: dict[str, Any], message: str
) -> None:
    path, since = far(arm, 0.4), list[float]()

    def do() -> None:
        since.append(clock())
        vars(ur).update(change)

    halfway(path, do)
    with pytest.raises(DeviceError, match=message):
        arm.follow(path)
    assert ur.stopped_after(since[0]) < 0.4
    commands = len(ur.heard)
    if "paused" in change or "protective" in change:
        assert ur.program is None  # stopped: it does not go on when the stop is released, or somebody presses play
    message = "program on it was stopped" if "paused" in change else message
    with pytest.raises(DeviceError, match=message):
        arm.follow(far(arm, 0.01))
    assert len(ur.heard) == commands


def test_it_does_not_move_in_local_control(arm: UniversalRobot, ur: FakeUR) -> None:
    path, ur.remote = far(arm), False
    with pytest.raises(DeviceError, match="not in remote control: switch it"):
        arm.follow(path)
    assert ur.heard == []
    assert any("not in remote control" in line for line in arm.describe())


@pytest.mark.parametrize("how", ["held up", "hangs"])
def test_commands_that_come_too_late_end_the_motion(arm: UniversalRobot, ur: FakeUR, how: str) -> None:
    seen = list[float]()

    def watch(sample: ArmSample) -> None:
        if np.abs(sample.measured - READY).max() > 0.1 and not seen:
            seen.append(clock())
            sleep(0.034 if how == "held up" else 0.2)

    with pytest.raises(DeviceError, match=r"a command came .* ms after"):
        arm.follow(far(arm), watch)
    assert ur.stopped_after(seen[0]) < STANDS + 0.1
    assert ur.protective == (how == "hangs"), HELD_UP  # the driver brakes; where it cannot, the watchdog does


def test_an_arm_whose_driver_hangs_stands_soon(arm: UniversalRobot, ur: FakeUR) -> None:
    path = far(arm, 0.8)

    def follow() -> None:
        with suppress(DeviceError):
            arm.follow(path)

    moving = threading.Thread(target=follow)
    moving.start()
    while np.abs(ur.v).max() < 0.5:
        time.sleep(0.005)
    ur.dead, since, speed = True, clock(), np.abs(ur.v).max()
    after = ur.stopped_after(since)
    ur.dead = False
    moving.join()
    assert after < 1 / UniversalRobot.watchdog + 1.2 * speed / 5.0 + 0.05
    assert ur.protective


MOVES = """
import sys; sys.path[:0] = [{here!r}]
from multiprocessing.managers import BaseManager
from slow_clock import clock, sleep
from small_planner import SmallPlanner
from anther.robot.arm.arms import find_arm
from anther.robot.drivers.ur_controller import Controller
from anther.robot.drivers.ur_rtde import UniversalRobot
for name in ("receive", "dashboard", "program"):
    BaseManager.register(name)
far = BaseManager(("127.0.0.1", int(sys.argv[1])), b"ur")
far.connect()
make = lambda: Controller(far.receive(), far.dashboard(), far.program, clock=clock)
ur5e = find_arm("ur5e")
arm = UniversalRobot(make, names=ur5e.joints, acceleration=ur5e.acceleration, rate=100, clock=clock, sleep=sleep)
print("ready", flush=True)
arm.follow(SmallPlanner(ur5e).move(arm.joints(), arm.joints() + 0.8))
"""


@pytest.mark.slow
def test_a_driver_that_is_killed_leaves_an_arm_at_rest(ur: FakeUR) -> None:
    """kill -9 in full motion."""

    class Served(BaseManager):
        pass

    Served.register("receive", lambda: FakeReceive(ur))
    Served.register("dashboard", lambda: FakeDashboard(ur))
    Served.register("program", ur.start)
    server: Any = Served(("127.0.0.1", 0), b"ur").get_server()
    threading.Thread(target=server.serve_forever, daemon=True).start()
    words = [sys.executable, "-c", MOVES.format(here=str(HERE)), str(server.address[1])]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as driver:
        assert driver.stdout is not None
        assert driver.stdout.readline() == "ready\n"
        while np.abs(ur.v).max() < 0.4:
            assert driver.poll() is None
            time.sleep(0.005)
        driver.kill()
        killed, speed = clock(), np.abs(ur.v).max()
    assert ur.stopped_after(killed) < 1 / UniversalRobot.watchdog + 1.2 * speed / 5.0 + 0.05
    assert ur.protective
