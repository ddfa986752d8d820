"""A small part of evaluation/robustness/fuzz.py: spoilt inputs end in one message, never in a traceback."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from anther.cli.main import COMMANDS
from evaluation.robustness import (
    fuzz,  # pyright: ignore[reportMissingImports]
    fuzz_inputs,  # pyright: ignore[reportMissingImports]
)

FIRST, COUNT = 1000, 120
PARTS = 6


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fuzz")
    fuzz_inputs.write_inputs(folder)
    return folder


@pytest.fixture(autouse=True)
def _here(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """`examine` goes to other folders; a visit ends before its first view."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(fuzz.simulated_cell, "build", fuzz.no_cell)
    monkeypatch.setattr(fuzz.row_visit, "build_row", fuzz.no_cell)
    monkeypatch.setattr(fuzz, "PATIENCE", 120)  # other tests run beside this one
    monkeypatch.setattr(fuzz, "MEMORY", float("inf"))  # of this process, in which other tests ran as well


def test_every_command_is_tried() -> None:
    assert {line.split()[0] for line in fuzz_inputs.COMMAND_LINES} == set(COMMANDS) - fuzz_inputs.NOT_TRIED


@pytest.mark.parametrize("part", range(PARTS))
def test_nothing_breaks(base: Path, part: int) -> None:
    size = COUNT // PARTS
    found = [fuzz.examine(n, base) for n in range(FIRST + part * size, FIRST + (part + 1) * size)]
    assert not [outcome for outcome in found if outcome.broke]


def test_a_traceback_a_hang_and_a_wrong_answer_are_seen(
    base: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What the counts rest on: each kind of failure, once provoked, is counted."""

    def breaks(_: list[str]) -> int:
        raise ZeroDivisionError

    def sleeps(_: list[str]) -> int:
        while True:
            os.getpid()

    def forgets(_: list[str]) -> int:
        Path(".left.npz").touch()
        return 0

    monkeypatch.setattr(fuzz, "PATIENCE", 1)
    for does, broke in (
        (breaks, "tracebacks"),
        (sleeps, "hangs"),
        (lambda _: 3, "tracebacks"),
        (forgets, "half_written"),
    ):
        monkeypatch.setattr(fuzz, "anther", does)
        assert fuzz.examine(FIRST + 1, base).broke == broke
    refused = next(n for n, known in enumerate(fuzz_inputs.KNOWN) if known.refused)
    monkeypatch.setattr(fuzz, "anther", lambda _: 0)
    assert fuzz.examine(10 * refused, base).broke == "silent_wrong"


def test_a_log_is_gone_on_with(tmp_path: Path) -> None:
    log = tmp_path / "log.jsonl"
    assert fuzz.first_undone(log, 5) == 5
    log.write_text(
        '{"number": 7, "broke": "hangs", "code": null}\n{"number": 8, "broke": "", "code": 2}\n{"number": 9, "bro'
    )
    assert fuzz.first_undone(log, 5) == 9
    assert fuzz.metrics(fuzz.outcomes(log)) == {
        "inputs": 2, "half_written": 0, "hangs": 1, "over_memory": 0, "silent_wrong": 0, "tracebacks": 0,
        "refused": 1, "done": 0,
    }  # fmt: skip
