"""What every command that fills a run folder does before and after: refuse to mix runs, note parameters, report."""

from __future__ import annotations

import dataclasses
import json
import platform
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from anther.commands.trial_log import EARLIER, LOG
from anther.commands.visit_record import FILE as VISIT
from anther.errors import bad_input
from anther.files import made_folder, read_object, write_json
from anther.results import EXECUTED, FILM, SUMMARY
from anther.runs import FILES, PROGRESS, Run

if TYPE_CHECKING:
    from anther.results import RunResults

PARAMS, TIMING = "00_params.json", "timing.json"
WRITTEN = {
    PARAMS,
    TIMING,
    PROGRESS,
    EXECUTED,
    SUMMARY,
    VISIT,
    FILM,
    LOG,
    EARLIER,
    *FILES.values(),
    FILES["cloud"].replace(".ply", ".npz"),
}
"""What a run writes into its folder; a cloud's other arrays lie beside its .ply."""
LIBRARIES = ("numpy", "scipy", "numba", "mujoco", "pin", "coal", "roboplan", "embreex", "small_gicp", "scikit-image")


@contextmanager
def open_run(
    folder: Path, args: Any, *, restart_from: str | None, overwrite: bool, same: tuple[str, ...]
) -> Iterator[Run]:
    """Open a run folder, note parameters and versions in it, and note the time per stage at the end.

    Args:
        folder: of the run.
        args: of the command; kept.
        restart_from: see `Run`.
        overwrite: remove what an earlier run wrote there, and nothing else.
        same: names of arguments that a run which is gone on with must have had alike.

    Raises:
        InputError: the folder holds an earlier run (and neither overwrite nor a restart was asked for), another run
            than the one to go on with, or something that is not a run.
    """
    if restart_from is not None:
        _check_same(folder, args, same)
    else:
        _make_room(folder, overwrite=overwrite)
    run = Run(folder, restart_from=restart_from)
    write_json(folder / PARAMS, parameters(args))
    with run:
        try:
            yield run
        finally:
            write_json(folder / TIMING, run.seconds)


def parameters(args: Any) -> dict[str, Any]:
    """Return a command's arguments with the versions and the time, for 00_params.json."""
    return {
        **dataclasses.asdict(args),
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "anther": version("anther"),
        "python": platform.python_version(),
        "libraries": {name: _version(name) for name in LIBRARIES},
    }


def _version(library: str) -> str | None:
    """Return a library's version; None where the extra that brings it is not installed."""
    try:
        return version(library)
    except PackageNotFoundError:
        return None


def _check_same(folder: Path, args: Any, names: tuple[str, ...]) -> None:
    if not (folder / PARAMS).is_file():
        return
    was = read_object(folder / PARAMS)
    now = json.loads(json.dumps({name: getattr(args, name) for name in names}, default=str))
    other = [f"{name} {was[name]} instead of {now[name]}" for name in names if name in was and was[name] != now[name]]
    if other:
        raise bad_input(
            "restart-from",
            given=f"{folder}, a run with {', '.join(other)}",
            allowed="a run of the same plant, seen alike",
            do="Ask for what that run was, or choose another folder.",
        )


def _make_room(folder: Path, *, overwrite: bool) -> None:
    if not any(made_folder(folder).iterdir()):
        return
    if not (folder / PARAMS).is_file():
        raise bad_input(
            "run folder",
            given=f"{folder}, which holds other files",
            allowed="a new or empty folder",
            do="Choose another.",
        )
    if not overwrite:
        raise bad_input(
            "run folder",
            given=f"{folder}, which holds {_what_run(folder)}",
            allowed="a new or empty folder",
            do="Choose another, or add --overwrite or --restart-from STAGE.",
        )
    others = sorted({path.name for path in folder.iterdir()} - WRITTEN)
    if others:
        raise bad_input(
            "overwrite",
            given=f"{folder}, which holds a run and besides it {', '.join(others[:5])}",
            allowed="a folder with nothing but a run: only what a run wrote is removed",
            do="Move the other files, or choose another folder.",
        )
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
    from anther.report import write_report
    from anther.results import read_run

    results = read_run(run.folder)
    write_report(run.path("report"), results)
    return results
