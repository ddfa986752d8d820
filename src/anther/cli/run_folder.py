"""What every command that fills a run folder does before and after: refuse to mix runs, note parameters, report."""

from __future__ import annotations

import dataclasses
import json
import platform
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from anther.cli.doctor import installed_version
from anther.core.errors import AntherError, bad_input, missing_extra
from anther.core.files import existing, made_folder, read_object, write_json
from anther.core.runs import FILES, PROGRESS, Run
from anther.history import add_missing, hide_password, record_trial
from anther.plant.visit import Visit
from anther.robot.devices import Tap, no_tap
from anther.show.results import ARM, EXECUTED, FILM, PARAMS, SUMMARY, TIMING, RunResults, read_run

if TYPE_CHECKING:
    from anther.pollination.pipeline import Done
    from anther.sim.judge import Verdict
    from anther.sim.simulated_cell import SimulatedCell

LOG, EARLIER = "log.mcap", "log_before.mcap"
"""The log, and that of the process which a run was gone on from."""


class TrialLog:
    """Listens to a run where it is `wanted`; `tap` listens to a cell's machines. Use as a context manager."""

    def __init__(self, run: Run, *, wanted: bool) -> None:
        self.tap: Tap = no_tap
        self._log, self._lacks = None, None
        if not wanted:
            return
        try:
            from anther.show.log import Log
        except ImportError as error:
            lacks = missing_extra(error)
            if lacks is None:
                raise
            self._lacks = str(lacks)
            return
        place = run.folder / LOG
        with suppress(OSError):  # the log itself says what is wrong with the folder
            if place.exists():
                place.replace(run.folder / EARLIER)
        self._log = Log(place)
        self.tap, run.told = self._log.tap, self._log.told

    def __enter__(self) -> TrialLog:
        return self

    def __exit__(self, *reason: object) -> None:
        if self._log is not None:
            self._log.close()

    def close(self, failure: object, verdict: Any) -> dict[str, Any]:
        """End the log with how the trial ended; warn if anything lacks; return what trial.json keeps of it."""
        if self._log is None:
            if self._lacks is not None:
                print(f"anther trial: no {LOG}: {self._lacks}", file=sys.stderr)
            return {"log_messages": 0, "log_dropped": 0, "log_error": self._lacks}
        if failure is not None or verdict is not None:
            self._log.told("verdict", str(failure) if verdict is None else verdict.reason or "success")
        kept = self._log.close()
        if kept.error is not None:
            lost = f"{kept.dropped} of {kept.messages + kept.dropped} messages are missing"
            print(f"anther trial: {LOG}: {kept.error}; {lost}. The trial was not held up.", file=sys.stderr)
        return {"log_messages": kept.messages, "log_dropped": kept.dropped, "log_error": kept.error}


OTHERS = (PARAMS, TIMING, ARM, PROGRESS, EXECUTED, SUMMARY, FILM, LOG, EARLIER)
WRITTEN = {*OTHERS, *FILES.values(), FILES["cloud"].replace(".ply", ".npz")}
"""What a run writes into its folder; a cloud's other arrays lie beside its .ply."""
LIBRARIES = ("numpy", "scipy", "numba", "mujoco", "pin", "coal", "roboplan", "embreex", "small_gicp", "scikit-image")


@contextmanager
def open_run(folder: Path, args: Any, same: tuple[str, ...]) -> Iterator[Run]:
    """Open a run folder, note parameters and versions in it, and note the time per stage at the end.

    Args:
        folder: of the run.
        args: of the command; kept. Its `restart_from` is as in `Run`; `overwrite` removes what an earlier run wrote
            there, and nothing else.
        same: names of arguments that a run which is gone on with must have had alike.

    Raises:
        InputError: the folder holds an earlier run (and neither overwrite nor a restart was asked for), another run
            than the one to go on with, or something that is not a run.
    """
    if args.restart_from is not None:
        _check_same(folder, args, same)
    else:
        _make_room(folder, overwrite=args.overwrite)
    run = Run(folder, restart_from=args.restart_from)
    note_parameters(run, args)
    with run:
        try:
            yield run
        finally:
            note_times(run)


def note_parameters(run: Run, args: Any) -> None:
    """Keep what a run was asked for in its folder: the fields of `args`, a dataclass, with versions and time."""
    write_json(run.folder / PARAMS, parameters(args))


def note_times(run: Run) -> None:
    """Keep in a run's folder what its stages took."""
    names = ("seconds", "cpu_seconds", "peak_mb", "attempts")
    write_json(run.folder / TIMING, {name: getattr(run, name) for name in names})


def parameters(args: Any) -> dict[str, Any]:
    """Return a command's arguments with the versions and the time, for 00_params.json."""
    return {
        **dataclasses.asdict(args),
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "anther": version("anther"),
        "python": platform.python_version(),
        "libraries": {name: installed_version(name) for name in LIBRARIES},
    }


def _check_same(folder: Path, args: Any, names: tuple[str, ...]) -> None:
    if not (folder / PARAMS).is_file():
        return
    was = read_object(folder / PARAMS)
    now = json.loads(json.dumps({name: getattr(args, name) for name in names}, default=str))
    other = [f"{name} {was[name]} instead of {now[name]}" for name in names if name in was and was[name] != now[name]]
    if other:
        given, do = f"{folder}, a run with {', '.join(other)}", "Ask for what that run was, or choose another folder."
        raise bad_input("restart-from", given=given, allowed="a run of the same plant, seen alike", do=do)


def _make_room(folder: Path, *, overwrite: bool) -> None:
    if not any(made_folder(folder).iterdir()):
        return
    allowed = "a new or empty folder"
    if not (folder / PARAMS).is_file():
        given = f"{folder}, which holds other files"
        raise bad_input("run folder", given=given, allowed=allowed, do="Choose another.")
    if not overwrite:
        do = "Choose another, or add --overwrite or --restart-from STAGE."
        raise bad_input("run folder", given=f"{folder}, which holds {_what_run(folder)}", allowed=allowed, do=do)
    others = sorted({path.name for path in folder.iterdir()} - WRITTEN)
    if others:
        given = f"{folder}, which holds a run and besides it {', '.join(others[:5])}"
        allowed = "a folder with nothing but a run: only what a run wrote is removed"
        raise bad_input("overwrite", given=given, allowed=allowed, do="Move the other files, or choose another folder.")
    for name in WRITTEN:
        path = folder / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def _what_run(folder: Path) -> str:
    """Say whether the run there was finished."""
    if not (folder / PROGRESS).is_file():
        return "a run"
    last = read_object(folder / PROGRESS)
    if last.get("failure") is None and (folder / FILES["report"]).is_file():
        return "a finished run"
    return f"a run that ended in the stage {last.get('stage')}: {last.get('message')}"


def finish(run: Run) -> RunResults:
    """Write the report of a run and return its results as read back from the folder."""
    from anther.show.report import write_report  # Matplotlib takes a second

    results = read_run(run.folder)
    write_report(run.path("report"), results)
    return results


def judge_done(cell: SimulatedCell, done: Done) -> Verdict:
    """Return what the simulator knows of a trial that was carried out."""
    from anther.sim.judge import judge

    times, steady = done.trial.shake_times, done.trial.steady
    return judge(cell.world, (times[0], times[-1]) if len(times) else None, done.shake.frequency, steady)


def remember(visit: Visit, folder: Path, history: str) -> str | None:
    """Keep the visit in the run folder, then in the history; return None, or why the history did not take it.

    The trial is done by then, so that a history out of reach ends nothing: the message says how to add it later.
    """
    visit.save(folder / SUMMARY)
    try:
        record_trial(visit, history)
    except AntherError as error:
        how = f"anther history {hide_password(history)} --add {folder}"
        return f"the trial is not in the history yet. {error} It is kept in {folder / SUMMARY}; add it with: {how}"
    return None


def add_run(folder: Path, history: str) -> int | None:
    """Add a run's trial to the history; None if it is there already.

    Raises:
        InputError: no run with a trial, or the history cannot be written.
    """
    if not (existing(folder) / SUMMARY).exists():
        do = "A run that ended before its verdict has none; go on with --restart-from where-it-stopped."
        allowed = "a run folder of `anther trial`"
        raise bad_input(str(folder), given=f"a folder without {SUMMARY}", allowed=allowed, do=do)
    return add_missing(Visit.load(folder / SUMMARY), history)
