"""The driver of Franka arms through libfranka's own protocol: pylibfranka to franka-sim's server, on a slower clock."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from served_controller import references
from served_franka import NO_SERVER, Controller, has_server
from slow_clock import AGAIN_IF_HELD_UP
from small_planner import SmallPlanner

from anther.robot.arm.arms import find_arm
from anther.robot.devices import ArmSample, DeviceError
from anther.robot.drivers.franka import Franka

HERE = Path(__file__).parents[1] / "support"
sys.path.append(str(HERE / "cells"))
pytest.importorskip("pylibfranka", reason="no pylibfranka; run: pip install 'anther[franka]'")
if not has_server():
    pytest.skip(NO_SERVER, allow_module_level=True)
pytestmark = AGAIN_IF_HELD_UP
HOST = f"127.0.2.{1 + os.getpid() % 250}"  # libfranka's port is always the same


class Server:
    """A process that serves a Franka, and where it was: rows of the wall's time, the arm's time [s], seven joints."""

    def __init__(self, folder: Path) -> None:
        self.world, self._log = folder / "world", folder / "log"

    def connected(self) -> Franka:
        """Return the arm as the driver of a served cell has it."""
        from served import franka  # noqa: PLC0415  # found on the path above

        return franka(HOST, world=str(self.world), arm_model=find_arm("fr3"))

    def rows(self) -> np.ndarray:
        lines = self._log.read_text().splitlines()[:-1]
        return np.array([line.split() for line in lines[-1500:]], dtype=float)

    def speed(self) -> float:
        """Return how fast the fastest joint is now [rad/s]."""
        return float(np.median(_speeds(self.rows()[-6:])))

    def stood_after(self, since: float) -> float:
        """Return how long after `since` [s] the arm went faster than 0.05 rad/s last, by the arm's time [s]."""
        time.sleep(2.0)
        rows = self.rows()
        moves = _speeds(rows) > 0.05
        assert not moves[-50:].any()
        return float(rows[1:, 1][moves].max() - np.interp(since, rows[:, 0], rows[:, 1]))


def _speeds(rows: np.ndarray) -> np.ndarray:
    """Return the greatest speed of any joint between rows [rad/s], by the arm's time."""
    return np.abs(np.diff(rows[:, 2:], axis=0)).max(axis=1) / np.diff(rows[:, 1])


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    words = [sys.executable, str(HERE / "franka_sim_server.py"), str(tmp_path), HOST]
    with (tmp_path / "said").open("w") as said, subprocess.Popen(words, stdout=said, stderr=said) as process:
        until, log = time.monotonic() + 60.0, tmp_path / "log"
        while not log.exists() or len(log.read_text().splitlines()) < 100:
            if process.poll() is not None or time.monotonic() > until:
                process.kill()
                pytest.fail(f"the server does not begin: {(tmp_path / 'said').read_text()[-2000:]}")
            time.sleep(0.1)
        yield Server(tmp_path)
        process.kill()


@pytest.mark.slow
def test_it_moves_within_the_limits_that_the_simulator_enforces(server: Server) -> None:
    with closing(server.connected()) as arm:
        assert "ready to move" in arm.describe()
        for way in (0.1, -0.1):
            path = SmallPlanner(find_arm("fr3")).move(arm.joints(), arm.joints() + way)
            record = arm.follow(path)
            assert record.commanded[-1] == pytest.approx(path.positions[-1], abs=1e-6)
            assert arm.joints() == pytest.approx(path.positions[-1], abs=5e-3)
            assert len(record.times) > 0.1 * 1000 * path.duration
        began = list[float]()

        def enough(sample: ArmSample) -> None:
            began.append(sample.time)
            if sample.time > began[0] + 0.2:
                raise DeviceError("enough")

        with pytest.raises(DeviceError, match="enough"):
            arm.follow(SmallPlanner(find_arm("fr3")).move(arm.joints(), arm.joints() + 0.2), enough)
        assert "ready to move" in arm.describe()


MOVES = f"""
import sys; sys.path[:0] = [{str(HERE)!r}, {str(HERE / "cells")!r}]
from served import franka
from small_planner import SmallPlanner
from anther.robot.arm.arms import find_arm
fr3 = find_arm("fr3")
arm = franka(sys.argv[1], world=sys.argv[2], arm_model=fr3)
path = SmallPlanner(fr3).move(arm.joints(), arm.joints() + 0.17)
print("ready", flush=True)
arm.follow(path)
"""


@pytest.mark.slow
@pytest.mark.parametrize("who", ["driver", "loop"])
def test_an_arm_stands_after_kill_9(server: Server, who: str) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", MOVES, HOST, str(server.world)], stdout=subprocess.PIPE, text=True
    ) as driver:
        assert driver.stdout is not None
        assert driver.stdout.readline() == "ready\n"
        loop = int(Path(f"/proc/{driver.pid}/task/{driver.pid}/children").read_text().split()[0])
        while (speed := server.speed()) < 0.4:
            assert driver.poll() is None
            time.sleep(0.002)
        os.kill(driver.pid if who == "driver" else loop, signal.SIGKILL)
        if who == "driver":
            driver.wait()  # a busy machine takes a while to end a process
        killed = time.monotonic()
    after = server.stood_after(killed)
    print(f"{who} killed at {speed:.2f} rad/s: the arm stood after {1e3 * after:.0f} ms")
    assert after < 0.12  # a little more than from 0.6 rad/s: it may have been faster


@pytest.mark.parametrize("late", [0.0, 0.006, 0.018])
def test_the_served_arm_goes_as_told_however_late_it_hears(late: float) -> None:
    """Commands wait for up to 18 ms, which the robot allows: the arm is never further behind than at its best."""
    world, rng = SimpleNamespace(time=100.0, timestep=0.001, arm=find_arm("fr3")), np.random.default_rng(0)
    arm, heard, until = Controller(world, np.zeros(7)), 0, 0.0
    for cycle in range(6000):
        if world.time >= until:
            for told in range(heard, cycle + 1):
                arm.command(told, np.full(7, _to_and_fro(told)))
            heard, until = cycle + 1, world.time + rng.uniform(0, late)
        references(arm, world, 1)
        world.time += 0.001
        assert np.abs(arm.q - _to_and_fro(cycle + 1)).max() < 0.0115  # 8 ms at 1.3 rad/s


def _to_and_fro(cycle: int) -> float:
    return 0.5 * (1 - np.cos(2 * np.pi * cycle / 2400))
