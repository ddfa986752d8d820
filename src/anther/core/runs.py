"""A run folder that reads as the pipeline: every stage leaves its result in a numbered file, and is timed."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from anther.core.errors import FailureKind, InputError, StageFailure, bad_input
from anther.core.files import made_folder, read_object, write_json
from anther.core.usage import cpu_seconds, mark_memory, peak_memory

FILES = {
    "capture": "01_capture",
    "masks": "02_masks.npz",
    "cloud": "03_cloud.ply",
    "skeleton": "04_skeleton.npz",
    "stem": "05_stem.npz",
    "flowers": "06_flowers.npz",
    "grasp": "07_grasps.json",
    "plant model": "08_plant_model.npz",
    "shake plan": "08_shake_plan.json",
    "execution": "09_trial.npz",
    "response": "09_response.npz",
    "report": "10_report.html",
}
"""Stage -> file in the run folder, in the order the stages run."""

PROGRESS = "progress.json"
"""The stage a run is in. It is written before the stage begins, so that it is true also of a process that was killed:
{stage, failure, message}, failure null once the stage is done."""

WHERE_IT_STOPPED = "where-it-stopped"
"""Restart from the stage in which the earlier process ended."""

Advance = Callable[[int, int], None]
"""Progress of one stage: (steps done, steps in all)."""


Result = TypeVar("Result")


class Run:
    """One run folder, its progress bars and the time each stage took.

    Use as a context manager; bars are drawn while it is open, unless it is `quiet`; without a
    terminal each stage prints a line when it ends. With `restart_from`, a stage or
    "where-it-stopped", results of earlier stages are read from the folder instead of computed.

    Attributes:
        seconds: stage -> time it took, all tries together [s]; stages that were read back are absent.
        cpu_seconds: stage -> processor time, of ended children too [s].
        peak_mb: stage -> the most memory the process held during it [MB]; absent where nothing tells.
        attempts: what was tried before something else, and why it was not that, a line each.
        told: hears of every stage's name and result as it arises, and of what else there is to tell; never waits and
            raises nothing (`anther.show.log`).

    Raises:
        InputError: unknown stage to restart from, or no earlier run in the folder to go on with.
    """

    def __init__(self, folder: Path, *, restart_from: str | None = None, quiet: bool = False) -> None:
        if restart_from == WHERE_IT_STOPPED:
            restart_from = stage_under_way(Path(folder))
        if restart_from is not None and restart_from not in FILES:
            allowed = ", ".join((*FILES, WHERE_IT_STOPPED))
            raise bad_input("restart-from", given=f"'{restart_from}'", allowed=allowed, do="Name one of these stages.")
        self.folder = made_folder(folder)
        self.seconds: dict[str, float] = {}
        self.cpu_seconds: dict[str, float] = {}
        self.peak_mb: dict[str, float] = {}
        self.attempts: list[str] = []
        self.told: Callable[[str, Any], None] = lambda name, value: None
        self._restart_from = restart_from
        columns = (TextColumn("{task.description:<12}"), BarColumn(), TimeElapsedColumn())
        console = Console(stderr=True)
        self._lines = not (quiet or console.is_terminal)
        self._bars = Progress(*columns, console=console, disable=quiet or self._lines)

    def __enter__(self) -> Run:
        if self._restart_from is None:
            self._note(next(iter(FILES)), "interrupted", "the process ended before the first stage")
        self._bars.__enter__()
        return self

    def __exit__(self, *reason: object) -> None:
        self._bars.stop()

    def path(self, stage: str) -> Path:
        """Return the file or folder that keeps a stage's result."""
        return self.folder / FILES[stage]

    def stage(
        self,
        name: str,
        load: Callable[[Path], Result],
        compute: Callable[[Advance], Result],
        save: Callable[[Any, Path], None] = lambda result, path: result.save(path),
    ) -> Result:
        """Compute a stage of `FILES` and keep its result, or read it back when the run restarts from a later stage."""
        order = list(FILES)
        if self._restart_from is not None and order.index(name) < order.index(self._restart_from):
            result = load(self.path(name))
            self.told(name, result)
            return result
        self._restart_from = None  # once one stage is new, so is all that follows, also what is tried again
        self._note(name, "interrupted", f"the process ended during the {name}; go on with --restart-from '{name}'")
        try:
            result = self.timed(name, compute)
        except StageFailure as failure:
            self._note(name, failure.kind, str(failure))
            self.told("failure", f"{name}: {failure}")
            raise
        self.keep(name, result, save)
        self._note(name, None, "done")
        return result

    def keep(
        self, name: str, result: Any, save: Callable[[Any, Path], None] = lambda result, path: result.save(path)
    ) -> None:
        """Keep a stage's result: also in place of one that was computed, where more is known since."""
        self.told(name, result)
        save(result, self.path(name))

    def timed(self, name: str, compute: Callable[[Advance], Result]) -> Result:
        """Compute something and note what it took: under a progress bar or, without a terminal, with a line."""
        bar = self._bars.add_task(name, total=None)
        start, cpu = time.perf_counter(), cpu_seconds()
        mark_memory()
        value = compute(lambda done, total: self._bars.update(bar, completed=done, total=total))
        took = time.perf_counter() - start
        self.seconds[name] = self.seconds.get(name, 0.0) + took
        self.cpu_seconds[name] = self.cpu_seconds.get(name, 0.0) + cpu_seconds() - cpu
        if (peak := peak_memory()) is not None:
            self.peak_mb[name] = max(peak, self.peak_mb.get(name, 0.0))
        self._say(f"{name}: {took:.1f} s")
        self._bars.update(bar, completed=1, total=1)
        return value

    def note_attempt(self, why: str) -> None:
        """Keep and tell what was tried, and why something else is tried next."""
        self.attempts.append(why)
        if not self._bars.disable:
            self._bars.console.print(why, highlight=False, markup=False)
        self._say(why)

    def _say(self, line: str) -> None:
        if self._lines:
            print(line, file=sys.stderr, flush=True)

    def _note(self, stage: str, failure: FailureKind | None, message: str) -> None:
        write_json(self.folder / PROGRESS, {"stage": stage, "failure": failure, "message": message})


def stage_under_way(folder: Path) -> str:
    """Return the stage that a run was in last: the one in which its process ended, if it was interrupted.

    Raises:
        InputError: the folder holds no run that could be gone on with.
    """
    try:
        return str(read_object(folder / PROGRESS)["stage"])
    except (InputError, KeyError) as error:
        given = f"'{WHERE_IT_STOPPED}' in {folder}, which does not say where it stopped"
        allowed = f"a run folder with {PROGRESS}"
        raise bad_input("restart-from", given=given, allowed=allowed, do="Name a stage.") from error


def kept(folder: Path, stage: str) -> Path:
    """Return the file in which a run folder keeps a stage's result.

    Raises:
        InputError: there is none.
    """
    if not (folder / FILES[stage]).exists():
        do = "`anther reconstruct` goes as far as the grasp, `anther trial` through all stages."
        allowed = f"a run folder with {FILES[stage]}, or a skeleton file"
        raise bad_input(str(folder), given=f"a folder without {FILES[stage]}", allowed=allowed, do=do)
    return folder / FILES[stage]
