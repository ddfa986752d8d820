"""What `anther sweep` can run: other commands, whose options are the columns of its table."""

from __future__ import annotations

import shlex
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import fields, is_dataclass, replace
from functools import cache
from io import StringIO
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

from anther.commands import reconstruct as reconstruct_command
from anther.commands import trial as trial_command
from anther.errors import InputError, StageFailure, bad_input
from anther.files import read_object

LOG = "log.txt"
_ARGS = {"trial": trial_command.Args, "reconstruct": reconstruct_command.Args}
_SET_BY_SWEEP = ("out", "history", "restart_from", "overwrite")


def trial(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Run `anther trial` into the folder, with a history of its own, and return the numbers and texts of trial.json.

    A trial that fails is a result as well: exit_code, failure and success say how it ended.
    """
    args = replace(_arguments(trial_command.Args, row), out=folder, history=str(folder / "history.sqlite"))
    with _kept_log(folder):
        code = trial_command.run(args)
    summary = read_object(folder / "trial.json")
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
            with _kept_log(folder):
                reconstruct_command.run(replace(_arguments(reconstruct_command.Args, row), out=folder))
        except StageFailure as failure:
            return {"failure": failure.kind, "message": str(failure)}
    return {"failure": None} | _found(folder)


def _found(folder: Path) -> dict[str, Any]:
    """Return a reconstruction in numbers."""
    from anther.results import read_run

    found = read_run(folder)
    assert found.cloud is not None
    assert found.skeleton is not None
    assert found.stem is not None
    assert found.flowers is not None
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


def typed(kind: str, rows: Sequence[Mapping[str, str]]) -> list[dict[str, Any]]:
    """Return a table's rows with every cell as its option takes it; paths become absolute.

    Raises:
        InputError: a column that is no option, a value that an option does not take, or no capture.
    """
    args = _ARGS[kind]
    columns = dict.fromkeys(name for row in rows for name in row)
    for name in columns:
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
        return _parsed(hint, text)
    except InputError as error:
        raise InputError(f"row {number}, column '{name}': {error}") from None


@cache
def _parsed(hint: Any, text: str) -> Any:
    """Return a cell as the command line would read it."""
    import tyro

    words = (
        shlex.split(text) if get_origin(hint) is tuple or tuple in [get_origin(h) for h in get_args(hint)] else [text]
    )
    said = StringIO()
    try:
        with redirect_stderr(said), redirect_stdout(said):
            return tyro.cli(hint, args=words)
    except SystemExit:
        allowed = " | ".join(getattr(h, "__name__", str(h)) for h in get_args(hint) or (hint,))
        raise bad_input("value", given=f"'{text}'", allowed=allowed, do="Correct the cell.") from None


def _hint(args: type, name: str) -> Any:
    """Return the type of an option, which may lie in the parameters of a stage (a.b.c); None if there is none."""
    hint: Any = args
    for part in name.split("."):
        hint = get_type_hints(hint).get(part) if is_dataclass(hint) else None
    return None if is_dataclass(hint) else hint


def _arguments(args: type, row: Mapping[str, Any]) -> Any:
    """Return a command's arguments from a row."""
    made = args(**{"capture": Path()} if "capture" in row else {})
    for name, given in row.items():
        value = tuple(given) if isinstance(given, list) else Path(given) if _hint(args, name) is Path else given
        made = _changed(made, name.split("."), value)
    return made


def _changed(what: Any, path: Sequence[str], value: Any) -> Any:
    inner = value if len(path) == 1 else _changed(getattr(what, path[0]), path[1:], value)
    return replace(what, **{path[0]: inner})


@contextmanager
def _kept_log(folder: Path) -> Iterator[None]:
    """Keep what a command says in a file: many speak at once."""
    said = StringIO()
    try:
        with redirect_stdout(said), redirect_stderr(said):
            yield
    finally:
        (folder / LOG).write_text(said.getvalue(), encoding="utf-8")
