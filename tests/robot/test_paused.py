"""A driver whose process is stopped in full motion: it sends an arm that stands nowhere."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import test_sawyer_ros1
from fake_ros_master import FakeMaster
from fake_sawyer import FakeSawyer
from slow_clock import AGAIN_IF_HELD_UP, SLOWER, clock, sleep

pytestmark = AGAIN_IF_HELD_UP


def test_a_process_that_was_stopped_sends_an_arm_that_stands_nowhere() -> None:
    """SIGSTOP in full motion, and SIGCONT when the robot has stopped by itself."""
    master = FakeMaster()
    program = test_sawyer_ros1.MOVES.format(here=str(Path(__file__).parents[1] / "support"))
    with (
        closing(FakeSawyer(master.uri, clock=clock, sleep=sleep)) as robot,
        subprocess.Popen([sys.executable, "-c", program, master.uri], stdout=-1, stderr=-1, text=True) as driver,
    ):
        assert driver.stdout is not None
        assert driver.stderr is not None
        assert driver.stdout.readline() == "ready\n"
        while np.abs(robot.v).max() < 0.4:
            assert driver.poll() is None, f"it ended before it moved: {driver.stderr.read()}"
            time.sleep(0.01)
        os.kill(driver.pid, signal.SIGSTOP)
        time.sleep(SLOWER * 0.3)  # as `anther.robot.testing.check_pause` does
        before, stood = len(robot.commands), robot.q.copy()
        os.kill(driver.pid, signal.SIGCONT)
        said = driver.stderr.read()
    assert "DeviceError" in said or "Late" in said
    assert np.abs(robot.q - stood).max() < 1e-3
    for _, _, joints, rate in robot.commands[before:]:
        assert joints == pytest.approx(stood, abs=1e-3)
        assert not rate.any()
    master.stop()
