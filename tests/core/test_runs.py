"""A run keeps each stage's result, times it, and can restart from any stage."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from anther.core.errors import InputError, StageFailure
from anther.core.files import read_json
from anther.core.runs import Run


class Note:
    """A result with a text."""

    def __init__(self, text: str) -> None:
        self.text = text

    def save(self, path: Path) -> None:
        path.write_text(self.text)

    @classmethod
    def load(cls, path: Path) -> Note:
        return cls(path.read_text())


def work(folder: Path, word: str, **options) -> tuple[str, str, dict[str, float]]:
    with Run(folder, quiet=True, **options) as run:
        first = run.stage("masks", Note.load, lambda _: Note(f"{word} masks"))
        second = run.stage("skeleton", Note.load, lambda _: Note(f"{first.text}, {word} skeleton"))
    return first.text, second.text, run.seconds


def test_results_are_kept_and_timed(tmp_path) -> None:
    _, text, seconds = work(tmp_path, "new")
    assert text == "new masks, new skeleton"
    assert (tmp_path / "02_masks.npz").read_text() == "new masks"
    assert set(seconds) == {"masks", "skeleton"}
    assert all(s >= 0 for s in seconds.values())


def test_restart_reads_the_stages_before(tmp_path) -> None:
    work(tmp_path, "old")
    first, second, seconds = work(tmp_path, "new", restart_from="skeleton")
    assert (first, second) == ("old masks", "old masks, new skeleton")
    assert set(seconds) == {"skeleton"}


def test_what_is_tried_again_is_computed_again(tmp_path) -> None:
    work(tmp_path, "old")
    with Run(tmp_path, quiet=True, restart_from="skeleton") as run:
        tries = [run.stage(name, Note.load, lambda _: Note("new")).text for name in ("masks", "skeleton", "masks")]
    assert tries == ["old masks", "new", "new"]


def test_unknown_stage_is_refused(tmp_path) -> None:
    with pytest.raises(InputError, match="got 'skelton'; allowed: capture, masks"):
        Run(tmp_path, restart_from="skelton")


def test_a_run_says_where_it_is(tmp_path) -> None:
    def fail(_) -> Note:
        assert read_json(tmp_path / "progress.json")["failure"] == "interrupted"  # true if the process were killed now
        raise StageFailure("no_stem_found", "nothing upright")

    with Run(tmp_path, quiet=True) as run:
        run.stage("masks", Note.load, lambda _: Note("masks"))
        assert read_json(tmp_path / "progress.json") == {"stage": "masks", "failure": None, "message": "done"}
        with pytest.raises(StageFailure):
            run.stage("stem", Note.load, fail)
    assert read_json(tmp_path / "progress.json") == {
        "stage": "stem",
        "failure": "no_stem_found",
        "message": "nothing upright",
    }


KILLED = """
import os, signal, sys
from pathlib import Path
from anther.core.runs import Run
from test_runs import Note
with Run(Path(sys.argv[1]), quiet=True) as run:
    run.stage("masks", Note.load, lambda _: Note("old masks"))
    run.stage("skeleton", Note.load, lambda _: os.kill(os.getpid(), signal.SIGKILL))
"""


def test_a_killed_run_is_gone_on_with(tmp_path) -> None:
    killed = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], cwd=Path(__file__).parent, check=False)
    assert killed.returncode == -signal.SIGKILL
    assert read_json(tmp_path / "progress.json")["failure"] == "interrupted"
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []
    first, second, seconds = work(tmp_path, "new", restart_from="where-it-stopped")
    assert (first, second) == ("old masks", "old masks, new skeleton")
    assert set(seconds) == {"skeleton"}


@pytest.mark.parametrize("content", [None, "{", "[]", "{}"])
def test_nothing_to_go_on_with_is_refused(tmp_path, content: str | None) -> None:
    if content is not None:
        (tmp_path / "progress.json").write_text(content)
    with pytest.raises(InputError, match="does not say where it stopped"):
        Run(tmp_path, restart_from="where-it-stopped")
