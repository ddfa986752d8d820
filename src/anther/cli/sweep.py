"""Run many trials or reconstructions from a table, on all cores or on a cluster; go on where an earlier start ended."""

from __future__ import annotations

import shlex
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import fields, is_dataclass, replace
from functools import cache
from io import StringIO
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

import tyro

from anther.cli import reconstruct as reconstruct_command
from anther.cli import trial as trial_command
from anther.cli.args import reconstruct as reconstruct_args
from anther.cli.args import trial as trial_args
from anther.cli.args.shared import tuned
from anther.cli.args.sweep import Args
from anther.cli.output import kept_log
from anther.core.errors import InputError, StageFailure, bad_input
from anther.plant.visit import Visit
from anther.show.results import SUMMARY, read_run

Kind = Literal["trial", "reconstruct"]
_SET_BY_SWEEP = ("out", "history", "restart_from", "overwrite")


def run(args: Args) -> int:
    """Sweep, write results.parquet and say how it went.

    Returns:
        0 if every line ended, 1 if some were set aside or still wait.
    """
    from anther.history import sweep

    if args.table is None:
        jobs = sweep.read(args.out, history=args.history)
    else:
        jobs = sweep.run(
            {"trial": trial, "reconstruct": reconstruct}[args.kind],
            typed(args.kind, sweep.read_table(args.table)),
            args.out,
            name=args.kind,
            history=args.history,
            workers=args.workers,
            scheduler=args.scheduler,
            tries=args.tries,
            deaths=args.deaths,
            again=args.again,
        )
    file = sweep.export(args.out, jobs)
    states = [job.state for job in jobs]
    print(f"{states.count('done')} done, {states.count('poison')} set aside, {states.count('waiting')} waiting")
    for job in jobs:
        if job.state == "poison":
            given = ", ".join(f"{name} {value}" for name, value in job.row.items())
            print(f"set aside after {job.tries} tries: {given} ({job.key}): {job.reason}")
    print(f"{file}: read it with  duckdb -c \"SELECT * FROM '{file}'\"")
    return 0 if all(state == "done" for state in states) else 1


def trial(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Run `anther trial` into the folder, with a history of its own, and return the numbers and texts of trial.json.

    A trial that fails is a result as well: exit_code, failure and success say how it ended.
    """
    args = _arguments(tuned(trial_args.Args)(out=folder, history=str(folder / "history.sqlite")), row)
    with kept_log(folder):
        code = trial_command.run(args)
    summary = Visit.load(folder / SUMMARY).flat()
    return {"exit_code": code} | {k: v for k, v in summary.items() if not isinstance(v, dict | list)}


def reconstruct(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Run `anther reconstruct` into the folder and return what was found, or why nothing was.

    The capture may be an address (s3://...).
    """
    capture = str(row["capture"])
    with tempfile.TemporaryDirectory(prefix="anther-capture-") as fetched:
        if "://" in capture:
            from fsspec.core import url_to_fs

            files, root = url_to_fs(capture)
            files.get(f"{root.rstrip('/')}/", fetched, recursive=True)
            row = {**row, "capture": fetched}
        try:
            with kept_log(folder):
                reconstruct_command.run(_arguments(tuned(reconstruct_args.Args)(capture=Path(), out=folder), row))
        except StageFailure as failure:
            return {"failure": failure.kind, "message": str(failure)}
    return {"failure": None} | _found(folder)


def _found(folder: Path) -> dict[str, Any]:
    """Return a reconstruction in numbers."""
    found: Any = read_run(folder)  # a reconstruction that ended has all of these
    best = found.grasps[0]
    return {
        "points": len(found.cloud.points),
        "skeleton_nodes": len(found.skeleton.nodes),
        "stem_length_m": found.stem.arc_length[-1],
        "stem_confidence": found.stem.confidence,
        "flowers": len(found.flowers.positions),
        "grasp_arc_length_m": best.arc_length,
        "grasp_confidence": best.confidence,
        "notes": "; ".join(found.notes()),
    }


def typed(kind: Kind, rows: Sequence[Mapping[str, str]]) -> list[dict[str, Any]]:
    """Return a table's rows with every cell as its option takes it; paths become absolute."""
    args = tuned({"trial": trial_args.Args, "reconstruct": reconstruct_args.Args}[kind])
    for name in dict.fromkeys(name for row in rows for name in row):
        if _hint(args, name) is None or name in _SET_BY_SWEEP:
            options = [f.name for f in fields(args) if f.name not in (*_SET_BY_SWEEP, "params")]
            allowed = f"{', '.join(options)}, params.STAGE.NAME"
            do = f"`anther {kind} --help` lists them; the sweep itself sets {', '.join(_SET_BY_SWEEP)}."
            raise bad_input(f"column '{name}'", given=f"no option of {kind}", allowed=allowed, do=do)
    if kind == "reconstruct" and not all("capture" in row for row in rows):
        raise bad_input("table", given="a row without capture", allowed="a capture in each", do="Add the column.")
    return [
        {name: _value(args, name, text, number) for name, text in row.items()} for number, row in enumerate(rows, 1)
    ]


def _value(args: type, name: str, text: str, number: int) -> Any:
    hint = _hint(args, name)
    if hint is Path:
        return text if "://" in text else str(Path(text).absolute())
    try:
        return _parse_value(hint, text)
    except InputError as error:
        raise InputError(f"row {number}, column '{name}': {error}") from None


@cache
def _parse_value(hint: Any, text: str) -> Any:
    """Return a cell as the command line would read it."""
    several = tuple in [get_origin(h) for h in (hint, *get_args(hint))]
    said = StringIO()
    try:
        with redirect_stderr(said), redirect_stdout(said):
            return tyro.cli(hint, args=shlex.split(text) if several else [text])
    except SystemExit:
        allowed = " | ".join(getattr(h, "__name__", str(h)) for h in get_args(hint) or (hint,))
        raise bad_input("value", given=f"'{text}'", allowed=allowed, do="Correct the cell.") from None


def _hint(args: type, name: str) -> Any:
    """Return the type of an option, which may lie in the parameters of a stage (a.b.c); None if there is none."""
    hint: Any = args
    for part in name.split("."):
        hint = get_type_hints(hint).get(part) if is_dataclass(hint) else None
    return None if is_dataclass(hint) else hint


def _arguments(args: Any, row: Mapping[str, Any]) -> Any:
    """Return a command's arguments with what a row gives."""
    for name, given in row.items():
        is_path = _hint(type(args), name) is Path
        value = tuple(given) if isinstance(given, list) else Path(given) if is_path else given
        args = _replace_at(args, name.split("."), value)
    return args


def _replace_at(what: Any, path: Sequence[str], value: Any) -> Any:
    inner = value if len(path) == 1 else _replace_at(getattr(what, path[0]), path[1:], value)
    return replace(what, **{path[0]: inner})
