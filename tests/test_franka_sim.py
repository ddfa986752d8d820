"""The driver of Franka arms through libfranka's own protocol: pylibfranka here, franka-sim in its own environment.

franka-sim pins older libraries, so it is told where its Python is: ANTHER_FRANKA_SIM=/path/to/venv/bin/python.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from small_planner import SmallPlanner

from anther.arm.arms import named
from anther.devices import DeviceError
from anther.drivers.franka import open_franka

HERE = Path(__file__).parent
PYTHON = os.environ.get("ANTHER_FRANKA_SIM", "")
NO_SIM = (
    "no franka-sim; run: python -m venv SIM && SIM/bin/pip install franka-sim==1.1.7, "
    "and set ANTHER_FRANKA_SIM=SIM/bin/python"
)
pytest.importorskip("pylibfranka", reason="no pylibfranka; run: pip install 'anther[franka]'")
if not PYTHON:
    pytest.skip(NO_SIM, allow_module_level=True)
pytestmark = [
    pytest.mark.xdist_group("franka-sim"),  # libfranka's port is always 1337
    pytest.mark.flaky(reruns=2, only_rerun=["communication_constraints_violation", "ms old", "nobody looked"]),
]
FR3 = named("fr3")
BEGINS = 120.0  # s


class Log:
    """Where the arm was, as the server wrote it down: rows of time, the simulator's time [s], mode, seven joints."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def rows(self) -> np.ndarray:
        lines = self._path.read_text().splitlines()[:-1]
        rows = np.array([line.split() for line in lines[-1500:]], dtype=float)
        return rows[np.r_[True, np.diff(rows[:, 1]) > 0]]

    def speeds(self) -> np.ndarray:
        """Return the greatest speed of any joint between the rows [rad/s], by the simulator's time."""
        rows = self.rows()
        return np.abs(np.diff(rows[:, 3:], axis=0)).max(axis=1) / np.diff(rows[:, 1])

    def stood_after(self, since: float) -> float:
        """Return how long after `since` [s] the arm went faster than 0.05 rad/s last, by the simulator's time [s]."""
        time.sleep(1.0)
        rows, moves = self.rows(), self.speeds() > 0.05
        assert not moves[-50:].any()
        return float(rows[1:, 1][moves].max() - np.interp(since, rows[:, 0], rows[:, 1]))


@pytest.fixture
def sim(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Log]:
    monkeypatch.setattr("anther.drivers._readings.DRIFT", 1.0)  # the simulator's clock is slower than the wall's
    words = [PYTHON, str(HERE / "franka_sim_server.py"), str(tmp_path)]
    outside = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    with (tmp_path / "said").open("w") as said:
        server = subprocess.Popen(words, stdout=said, stderr=said, env=outside)
    until, log = time.monotonic() + BEGINS, tmp_path / "log"
    while not (log.exists() and "ready for new client" in (tmp_path / "said").read_text()):
        if server.poll() is not None or time.monotonic() > until:
            server.kill()
            pytest.fail(f"franka-sim does not begin: {(tmp_path / 'said').read_text()[-2000:]}")
        time.sleep(0.1)
    while len(log.read_text().splitlines()) < 100:
        time.sleep(0.1)
    yield Log(log)
    server.send_signal(signal.SIGKILL)
    server.wait()


def test_it_moves_within_the_limits_that_the_simulator_enforces(sim: Log) -> None:
    with closing(open_franka("127.0.0.1", names=FR3.joints, acceleration=FR3.acceleration, realtime=False)) as arm:
        assert "ready to move" in arm.seen()
        for way in (0.1, -0.1):
            path = SmallPlanner(FR3).move(arm.joints(), arm.joints() + way)
            record = arm.follow(path)
            assert record.commanded[-1] == pytest.approx(path.positions[-1], abs=1e-6)
            assert arm.joints() == pytest.approx(path.positions[-1], abs=5e-3)
            assert len(record.times) > 0.1 * 1000 * path.duration
        with pytest.raises(DeviceError, match="enough"):
            arm.follow(SmallPlanner(FR3).move(arm.joints(), arm.joints() + 0.2), lambda sample: enough(sample.time))
        assert "ready to move" in arm.seen()


def enough(when: float) -> None:
    enough.first = getattr(enough, "first", when)  # type: ignore[attr-defined]
    if when > enough.first + 0.2:  # type: ignore[attr-defined]
        raise DeviceError("enough")


MOVES = f"""
import sys; sys.path[:0] = [{str(HERE)!r}]
import anther.drivers._readings
anther.drivers._readings.DRIFT = 1.0
from small_planner import SmallPlanner
from anther.arm.arms import named
from anther.drivers.franka import open_franka
fr3 = named("fr3")
arm = open_franka("127.0.0.1", names=fr3.joints, acceleration=fr3.acceleration, realtime=False)
path = SmallPlanner(fr3).move(arm.joints(), arm.joints() + 0.17)
print("ready", flush=True)
arm.follow(path)
"""


@pytest.mark.parametrize("who", ["driver", "loop"])
def test_an_arm_stands_after_kill_9(sim: Log, who: str) -> None:
    with subprocess.Popen([sys.executable, "-c", MOVES], stdout=subprocess.PIPE, text=True) as driver:
        assert driver.stdout is not None
        assert driver.stdout.readline() == "ready\n"
        loop = int(Path(f"/proc/{driver.pid}/task/{driver.pid}/children").read_text().split()[0])
        while (speed := float(np.median(sim.speeds()[-5:]))) < 0.4:
            assert driver.poll() is None
            time.sleep(0.002)
        os.kill(driver.pid if who == "driver" else loop, signal.SIGKILL)
        if who == "driver":
            driver.wait()  # a busy machine takes a while to end a process
        killed = time.monotonic()
    after = sim.stood_after(killed)
    print(f"{who} killed at {speed:.2f} rad/s: the arm stood after {1e3 * after:.0f} ms")
    assert after < 0.12  # a little more than from 0.6 rad/s: it may have been faster
