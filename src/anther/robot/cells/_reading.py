"""TOML held against what takes it, a dataclass or a function: unknown and missing keys, wrong types, with lines."""

from __future__ import annotations

import inspect
import math
import re
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from anther.core.errors import InputError, bad_input
from anther.core.files import read_lines
from anther.core.geometry import Box

T = TypeVar("T")
Point = tuple[float, float, float]
Pose = tuple[float, float, float, float, float, float, float]
"""x y z [m], qx qy qz qw."""
Keys = tuple[str, ...]
_NAMES = {
    str: "text in quotes", bool: "true or false", int: "a whole number", float: "a number", dict: "a table",
    Path: "a path in quotes", Box: "a table with lower and upper",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class TomlFile:
    """A TOML file that was read: what it holds, and (name, ..., key) -> line, from 1; of lists of tables the place is a
    name too, from 0."""

    path: Path
    table: dict[str, Any]
    lines: Mapping[Keys, int] = field(default_factory=dict)

    def error(self, keys: Keys, *, given: object, allowed: str, do: str) -> InputError:
        """Return an error that names file, line and key."""
        return bad_input(self.where(keys), given=given, allowed=allowed, do=do)

    @contextmanager
    def locate_errors(self, keys: Keys) -> Iterator[None]:
        """Put file, line and key before what is wrong with a value."""
        try:
            yield
        except InputError as error:
            raise InputError(f"{self.where(keys)}: {error}") from error

    def where(self, keys: Keys) -> str:
        """Return file, line and key in words; the line of the table where the key has none of its own."""
        line = next((self.lines[keys[:n]] for n in range(len(keys), 0, -1) if keys[:n] in self.lines), None)
        place = str(self.path) if line is None else f"{self.path}, line {line}"
        return f"{place}: {'.'.join(keys)}" if keys else place


def read_toml(path: Path | str) -> TomlFile:
    """Read a TOML file."""
    rows = read_lines(path)
    try:
        return TomlFile(Path(path), tomllib.loads("\n".join(rows)), _lines(rows))
    except tomllib.TOMLDecodeError as error:
        raise bad_input(str(path), given=f"no TOML: {error}", allowed="a TOML file", do="See toml.io.") from error


def build(source: TomlFile, keys: Keys, table: Any, target: Callable[..., T], **given: Any) -> T:
    """Return what a dataclass or function makes of a table, its keys being the arguments' names, and of what else is
    `given`. The annotations say what is allowed; an error has file, line and key."""
    arguments = fit_arguments(source, keys, table, target, given)
    with source.locate_errors(keys):
        return target(**arguments, **given)


def fit_arguments(
    source: TomlFile, keys: Keys, table: Any, target: Callable[..., Any], given: Collection[str] = ()
) -> dict[str, Any]:
    """Return the arguments that `build` calls its target with."""
    if not isinstance(table, dict):
        raise source.error(keys, given=_shown(table), allowed="a table", do=f"Write [{'.'.join(keys)}] above its keys.")
    wanted = {name: p for name, p in inspect.signature(target).parameters.items() if name not in given}
    open_ended = any(p.kind is p.VAR_KEYWORD for p in wanted.values())
    hints = get_type_hints(target)
    for key in table:
        if key not in wanted and not open_ended:
            near = get_close_matches(key, wanted, 1)
            do = f"Did you mean {near[0]}?" if near else "Remove it."
            raise source.error(
                (*keys, key), given=f"an unknown key '{key}'", allowed=", ".join(wanted) or "no further keys", do=do
            )
    for name, parameter in wanted.items():
        if name not in table and parameter.default is parameter.empty and parameter.kind is not parameter.VAR_KEYWORD:
            kind = _name(hints.get(name, Any))
            raise source.error(keys, given=f"no '{name}'", allowed=f"{name} = {kind}", do="Add it: docs/cell_file.md.")
    return {key: convert(source, (*keys, key), value, hints.get(key, Any)) for key, value in table.items()}


def box(lower: Point, upper: Point) -> Box:
    """Return a box from its corners [m]."""
    return Box(np.array(lower), np.array(upper))


def convert(source: TomlFile, keys: Keys, value: Any, hint: Any) -> Any:
    """Return a value as an annotation wants it: a path beside the file, a number as float, a list as tuple."""
    if get_origin(hint) is UnionType or NoneType in get_args(hint):
        hint = next(kind for kind in get_args(hint) if kind is not NoneType)
    if hint is Path and isinstance(value, str):
        return source.path.parent / value
    if hint is Box:
        return build(source, keys, value, box)
    if get_origin(hint) is Literal and value in get_args(hint):
        return value
    if get_origin(hint) is tuple:
        kinds = get_args(hint)
        if isinstance(value, list) and len(value) == len(kinds) and all(map(_fits, value, kinds)):
            return tuple(kind(x) for kind, x in zip(kinds, value, strict=True))
    elif get_origin(hint) is list:
        if isinstance(value, list) and all(_fits(x, get_args(hint)[0]) for x in value):
            return value
    elif _fits(value, hint):
        return hint(value) if hint is float else value
    raise source.error(keys, given=_shown(value), allowed=_name(hint), do="Correct it.")


def _fits(value: Any, kind: Any) -> bool:
    if kind is Any:
        return True
    if kind is float:
        return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if not isinstance(kind, type):
        return False
    return isinstance(value, kind) and isinstance(value, bool) == (kind is bool)


def _name(hint: Any) -> str:
    if get_origin(hint) is Literal:
        return ", ".join(f'"{choice}"' for choice in get_args(hint))
    if get_origin(hint) is tuple:
        return f"{len(get_args(hint))} numbers: [" + ", ".join(["0.0"] * len(get_args(hint))) + "]"
    if get_origin(hint) is UnionType:
        return " or ".join(_name(kind) for kind in get_args(hint) if kind is not NoneType)
    if get_origin(hint) is list:
        return f"[..., ...] of {_name(get_args(hint)[0])}"
    return _NAMES.get(hint, "a value")


def _shown(value: Any) -> str:
    return f'"{value}"'[:80] if isinstance(value, str) else str(value)[:80]


def _lines(rows: list[str]) -> dict[Keys, int]:
    """Return the line of every table and key. What stands in strings or lists over several lines may be taken for one
    too: then an error names the wrong line, no more."""
    found, here, counts = dict[Keys, int](), Keys(), dict[Keys, int]()
    for number, row in enumerate(rows, start=1):
        many, one = re.match(r"\s*\[\[(.+?)\]\]", row), re.match(r"\s*\[([^\[].*?)\]\s*(#.*)?$", row)
        key = re.match(r"\s*([\w\"'.-]+)\s*=", row)
        if many:
            name = _parts(many[1])
            counts[name] = counts.get(name, -1) + 1
            here = (*name, str(counts[name]))
        elif one:
            here = _parts(one[1])
            for name in (name for name in counts if name == here[: len(name)]):  # of a list's last table so far
                here = (*name, str(counts[name]), *here[len(name) :])
        elif key:
            found.setdefault((*here, *_parts(key[1])), number)
            continue
        else:
            continue
        for n in range(1, len(here) + 1):
            found.setdefault(here[:n], number)
    return found


def _parts(name: str) -> Keys:
    return tuple(part.strip().strip("\"'") for part in name.split("."))
