"""An arm in a process of its own: it is an arm like any other, and it outlives neither a hang nor a kill in motion."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from multiprocessing import Pipe
from pathlib import Path

import numpy as np
import pytest
from fake_robot import LIMITS
from fake_ros_master import FakeMaster
from fake_sawyer import FakeSawyer
from slow_arms import SlowArm, slow_sawyer
from slow_clock import AGAIN_IF_HELD_UP, clock, sleep
from small_planner import SmallPlanner

from anther.core.errors import StageFailure
from anther.robot.arm.sawyer import SAWYER
from anther.robot.devices import Arm, ArmSample, DeviceError, JointTrajectory
from anther.robot.drivers import apart
from anther.robot.drivers.apart import ArmApart

HERE = Path(__file__).parents[1] / "support"
pytestmark = AGAIN_IF_HELD_UP


@pytest.fixture(scope="module")
def arm() -> Iterator[ArmApart]:
    """One for all tests: a process takes seconds to begin. Each test leaves it able to move."""
    with closing(ArmApart(SlowArm, {}, LIMITS)) as apart:
        yield apart


def test_it_is_an_arm(arm: ArmApart) -> None:
    conforms: Arm = arm
    start, seen = conforms.joints(), list[ArmSample]()
    record = conforms.follow(SmallPlanner().move(start, start - 0.1), seen.append)
    assert len(seen) == len(record.times)
    assert conforms.joints() == pytest.approx(start - 0.1)
    conforms.hold()
    assert arm.call("shout", "hello") == "HELLO"
    assert "shout" in arm.has


def test_motions_join_though_this_process_thinks_without_letting_go(arm: ArmApart) -> None:
    start = arm.joints()
    motions = iter([SmallPlanner().move(start - 0.1, start - 0.2), None])

    def more() -> JointTrajectory | None:
        sum(range(3_000_000))
        return next(motions)

    arm.follow(SmallPlanner().move(start, start - 0.1), None, more)
    assert arm.joints() == pytest.approx(start - 0.2)


@pytest.mark.parametrize("error", [StageFailure("collision", "ouch"), KeyboardInterrupt()])
def test_it_stops_where_its_watcher_raises(arm: ArmApart, error: BaseException) -> None:
    start = arm.joints()

    def watch(sample: ArmSample) -> None:
        if np.abs(sample.measured - start).max() > 0.1:
            raise error

    with pytest.raises(type(error)):
        arm.follow(SmallPlanner().move(start, start - 0.5), watch)
    assert 0.1 < np.abs(arm.joints() - start).max() < 0.45
    arm.hold()


def test_the_guard_is_there_too(arm: ArmApart) -> None:
    start = arm.joints()
    path = SmallPlanner().move(start, start - 0.1)
    with pytest.raises(StageFailure, match="of its limit"):
        arm.follow(replace(path, times=path.times / 20, velocities=path.velocities * 20))
    assert arm.joints() == pytest.approx(start)


def test_readings_that_come_late_were_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(apart._Server, "_patience", 0.2)
    ours, theirs = Pipe()
    server, sample = apart._Server(theirs, os.getppid()), ArmSample(0.0, np.zeros(7), np.zeros(7), 0.0)
    for _ in range(2):
        server._watch(sample)
        ours.send(("seen", 0.0))
        time.sleep(0.3)
    server._watch(sample)
    server._watch(sample)
    time.sleep(0.3)
    with pytest.raises(DeviceError, match="nobody looked"):
        server._watch(sample)


def test_a_watcher_that_hangs_ends_the_motion(arm: ArmApart) -> None:
    start, hangs = arm.joints(), iter([3.0])  # the motion lasts 1.8 s at least
    with pytest.raises(DeviceError, match="nobody looked"):
        arm.follow(SmallPlanner().move(start, start - 1.0), lambda _: time.sleep(next(hangs, 0.0)))


def test_what_cannot_be_connected_is_told() -> None:
    with pytest.raises(DeviceError, match="no ROS master answers"):
        ArmApart(slow_sawyer, {"master": "http://127.0.0.1:1"}, LIMITS)


class Cold(DeviceError):
    """An error of a driver's own, which a process cannot make from its words alone."""

    def __init__(self, code: int, what: str) -> None:
        super().__init__(f"{what} ({code})")


def freezing() -> None:
    raise Cold(7, "the arm is too cold")


def test_an_error_of_a_driver_s_own_kind_is_told_in_its_words() -> None:
    with pytest.raises(DeviceError, match=r"^the arm is too cold \(7\)$"):
        ArmApart(freezing, {}, LIMITS)


def test_a_process_that_is_killed_is_told() -> None:
    with closing(ArmApart(SlowArm, {}, LIMITS)) as arm:
        start = arm.joints()
        threading.Timer(0.2, arm._process.kill).start()
        with pytest.raises(DeviceError, match="own process is gone"):
            arm.follow(SmallPlanner().move(start, start - 0.5))


MOVES = """
import os, sys, time; sys.path[:0] = [{here!r}]
from fake_robot import LIMITS
from small_planner import SmallPlanner
from slow_arms import slow_sawyer
from anther.robot.drivers import apart
from anther.robot.drivers.apart import ArmApart
if __name__ == "__main__":
    arm = ArmApart(slow_sawyer, {{"master": sys.argv[1]}}, LIMITS)
    if "a child" in sys.argv and os.fork() == 0:  # it keeps the pipe open
        time.sleep(4.0)
        os._exit(0)
    print("ready", flush=True)
    arm.follow(SmallPlanner().move(arm.joints(), arm.joints() - 0.5))
"""


@pytest.mark.flaky(reruns=3)  # a machine that is busy brakes late
@pytest.mark.parametrize("left", ["nobody", "a child"])
def test_who_is_killed_leaves_an_arm_at_rest_within_100_ms(tmp_path: Path, left: str) -> None:
    """kill -9 of the process that commands: the arm's own brakes it, before the arm's timeout need act.

    So it does where a child of that process is left and holds the pipe's other end.
    """
    master = FakeMaster()
    (tmp_path / "moves.py").write_text(MOVES.format(here=str(HERE)))
    words = [sys.executable, str(tmp_path / "moves.py"), master.uri, left]
    with (
        closing(FakeSawyer(master.uri, joints=SAWYER.neutral, clock=clock, sleep=sleep)) as robot,
        subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process,
    ):
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        while np.abs(robot.v).max() < 0.4:
            assert process.poll() is None, "what commands ended by itself"
            time.sleep(0.01)
        process.kill()
        killed = clock()
        sleep(0.4)
        times, speed = robot.speed()
        assert speed[-10:].max() < 1e-3
        assert times[speed > 1e-3].max() - killed <= 0.1
    master.stop()
