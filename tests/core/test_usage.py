"""What a run notes of time and memory, and what it says without a terminal."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from anther.core.runs import Run
from anther.core.usage import process_seconds


def busy(seconds: float) -> None:
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


def test_a_stage_that_waits_uses_no_processor_and_one_that_fills_memory_says_how_much(tmp_path: Path) -> None:
    with Run(tmp_path, quiet=True) as run:
        run.timed("fill", lambda _: np.ones(200 * 2**17).sum())  # 200 MB
        run.timed("wait", lambda _: time.sleep(0.3))
        run.timed("work", lambda _: busy(0.3))
    assert run.seconds["wait"] >= 0.3
    assert run.cpu_seconds["wait"] < 0.2
    assert run.cpu_seconds["work"] > 0.28
    if run.peak_mb:
        assert run.peak_mb["fill"] > run.peak_mb["wait"] + 150


def test_what_is_done_again_takes_the_time_of_both_and_says_why(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with Run(tmp_path) as run:
        for why in ("the grasp is left: nothing between the pads", None):
            run.timed("execution", lambda _: time.sleep(0.2))
            if why:
                run.note_attempt(why)
    assert run.seconds["execution"] >= 0.4
    assert run.attempts == ["the grasp is left: nothing between the pads"]
    assert capsys.readouterr().err.splitlines()[1] == run.attempts[0]


def test_without_a_terminal_each_stage_prints_a_line_when_it_ends(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with Run(tmp_path) as run:
        run.timed("masks", lambda _: None)
        assert capsys.readouterr().err == "masks: 0.0 s\n"
        run.timed("cloud", lambda _: None)
        assert capsys.readouterr().err == "cloud: 0.0 s\n"
    assert capsys.readouterr().err == ""


def test_the_process_is_timed_from_its_start() -> None:
    code = "import time; time.sleep(0.5); from anther.core.usage import process_seconds; print(process_seconds())"
    before = time.monotonic()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 0.5 <= float(done.stdout) <= time.monotonic() - before + 0.05
    assert process_seconds() > 0.1
