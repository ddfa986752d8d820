"""What every command that fills a run folder does before and after: refuse to mix runs, note parameters, report."""

from __future__ import annotations

import dataclasses
import platform
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from anther.errors import bad_input
from anther.files import write_json
from anther.runs import Run

if TYPE_CHECKING:
    from anther.results import RunResults

PARAMS, TIMING = "00_params.json", "timing.json"
LIBRARIES = ("numpy", "scipy", "numba", "mujoco", "pin", "coal", "roboplan", "embreex", "small_gicp", "scikit-image")


@contextmanager
def open_run(folder: Path, args: Any, *, restart_from: str | None, overwrite: bool) -> Iterator[Run]:
    """Open a run folder, note parameters and versions in it, and note the time per stage at the end.

    Raises:
        InputError: the folder holds an earlier run (and neither overwrite nor a restart was asked for), or
            something that is not a run.
    """
    _make_room(folder, restart_from=restart_from, overwrite=overwrite)
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
        "libraries": {name: version(name) for name in LIBRARIES},
    }


def _make_room(folder: Path, *, restart_from: str | None, overwrite: bool) -> None:
    if restart_from is not None or not folder.exists() or not any(folder.iterdir()):
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
            given=f"{folder}, which holds a finished run",
            allowed="a new or empty folder",
            do="Choose another, or add --overwrite or --restart-from STAGE.",
        )
    shutil.rmtree(folder)


def finish(run: Run) -> RunResults:
    """Write the report of a run and return its results as read back from the folder."""
    from anther.report import write_report
    from anther.results import read_run

    results = read_run(run.folder)
    write_report(run.path("report"), results)
    return results
