"""A cell file with another pose of the wrist camera: that line changes, every other byte stays."""

from __future__ import annotations

import json
import os
import re
import shutil
import tomllib
from collections.abc import Mapping
from pathlib import Path

from anther.core.errors import InputError, bad_input
from anther.core.files import replacing
from anther.robot.cells import read_cell
from anther.robot.cells._reading import Keys

TABLE, NEW, OLD = "wrist_camera", "calibration", "T_flange_cam"


def point_to_calibration(path: Path | str, calibration: Path | str) -> Path:
    """Let a cell file take its wrist camera's pose from a `calibration.json`; return where the old file is kept.

    The line `T_flange_cam = [...]` or `calibration = "..."` of [wrist_camera] becomes `calibration = "..."`, seen from
    the cell file. Comments stay, also those of the line. The file changes at once or not at all.

    Raises:
        InputError: the file is not a cell file, cannot be written, or has the pose where it cannot be told from the
            rest; it is then unchanged.
    """
    file = Path(path).resolve()  # a link stays a link
    before = read_cell(file)
    where = Path(os.path.relpath(Path(calibration).resolve(), file.parent)).as_posix()
    text = file.read_bytes().decode()
    mark = text[: text.startswith("\ufeff")]
    after = _replace(text[len(mark) :], before.source.lines, where)
    if after is None:
        raise bad_input(
            str(file),
            given="a pose of the wrist camera that is not on lines of its own",
            allowed=f"{OLD} = [...] or {NEW} = ... below [{TABLE}]",
            do=f"The file is unchanged. Write there: {NEW} = {json.dumps(where, ensure_ascii=False)}",
        )
    kept = _free_name(file)
    shutil.copy2(file, kept)
    with replacing(file) as temporary:
        temporary.write_bytes((mark + after).encode())
        try:
            read_cell(temporary)
        except InputError as error:
            raise InputError(f"{file}: unchanged, for with the new pose it would be wrong: {error}") from error
    return kept


def _replace(text: str, lines: Mapping[Keys, int], where: str) -> str | None:
    """Return the text with the new line, or None where no change of whole lines does just that.

    Where the value ends is tried out: the text must say the same as before, but for the pose.
    """
    rows = text.splitlines(keepends=True)
    wanted = tomllib.loads(text)
    wanted[TABLE] = {key: value for key, value in wanted[TABLE].items() if key not in (NEW, OLD)} | {NEW: where}
    first = next((lines[TABLE, key] - 1 for key in (NEW, OLD) if (TABLE, key) in lines), None)
    if first is None:
        return None
    for end in range(first + 1, len(rows) + 1):
        old = "".join(rows[first:end])
        ending = re.search(r"\r?\n?\Z", old)
        line = f"{_indent(old)}{NEW} = {json.dumps(where, ensure_ascii=False)}{_comments(old)}"
        changed = "".join([*rows[:first], line + (ending[0] if ending else ""), *rows[end:]])
        try:
            if tomllib.loads(changed) == wanted:
                return changed
        except tomllib.TOMLDecodeError:
            pass
    return None


def _indent(text: str) -> str:
    return text[: len(text) - len(text.lstrip())]


def _comments(text: str) -> str:
    """Return the comments of the lines, each with what stands before it, in one line: a # in quotes is none."""
    bare = [re.sub(r'"[^"\n]*"|\'[^\'\n]*\'', lambda quoted: "_" * len(quoted[0]), row) for row in text.splitlines()]
    found = [(row, hidden.index("#")) for row, hidden in zip(text.splitlines(), bare, strict=True) if "#" in hidden]
    if not found:
        return ""
    row, at = found[0]
    space = row[len(row[:at].rstrip()) : at] or " "
    return space + " ".join(row[at:].rstrip() for row, at in found)


def _free_name(file: Path) -> Path:
    """Return the first name for a kept file that is not taken: my_cell.toml.old1, .old2, ..."""
    number = 1
    while (kept := file.with_name(f"{file.name}.old{number}")).exists():
        number += 1
    return kept
