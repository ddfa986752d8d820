"""The numeric constants of the source: found, counted, and moved.

A constant is a name that a module binds, at its first level, to a value with a number in it; labels counted by `range`
are none. A moved constant is multiplied where the module binds it, so that what is derived from it, copies made by
`from module import NAME`, default values and compiled functions follow. This module imports nothing of Anther: the
move must be arranged before Anther is imported.
"""

from __future__ import annotations

import ast
import os
import re
import sys
import tempfile
from collections.abc import Iterator
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import CodeType
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[1] / "src"


class Constant(NamedTuple):
    """A numeric constant: its module, its name, its value as the source has it, and the line that binds it."""

    module: str
    name: str
    value: str = ""
    line: int = 0

    @property
    def room(self) -> str:
        """The first level of `anther` that holds it."""
        return self.module.split(".")[1]


def constants(root: Path = ROOT) -> list[Constant]:
    """Return all constants of the package `anther` below a folder."""
    found = []
    for path in sorted((root / "anther").rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        found += [Constant(module_name(path, root), *bound) for bound in _bound(ast.parse(text), text)]
    return found


def module_name(path: Path, root: Path = ROOT) -> str:
    """Return the name under which a source file is imported."""
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _bound(tree: ast.Module, text: str) -> Iterator[tuple[str, str, int]]:
    """Yield name, value as the source has it, and line of each constant."""
    for statement in tree.body:
        for target, value in _pairs(statement):
            if _has_number(value):
                yield target, " ".join((ast.get_source_segment(text, value) or "").split()), statement.lineno


def _pairs(statement: ast.stmt) -> Iterator[tuple[str, ast.expr]]:
    """Yield the names that a statement binds, each with its value."""
    if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name) and statement.value:
        yield statement.target.id, statement.value
    if not isinstance(statement, ast.Assign):
        return
    for target in statement.targets:
        if isinstance(target, ast.Name):
            yield target.id, statement.value
        elif isinstance(target, ast.Tuple):
            several = isinstance(statement.value, ast.Tuple) and len(statement.value.elts) == len(target.elts)
            values = statement.value.elts if several and isinstance(statement.value, ast.Tuple) else None
            for k, name in enumerate(target.elts):
                if isinstance(name, ast.Name):
                    yield name.id, values[k] if values else statement.value


def _has_number(value: ast.expr) -> bool:
    if isinstance(value, ast.Call) and isinstance(value.func, ast.Name) and value.func.id == "range":
        return False
    numbers = (node.value for node in ast.walk(value) if isinstance(node, ast.Constant))
    return any(isinstance(number, int | float) and not isinstance(number, bool) for number in numbers)


def scaled(value: Any, factor: float) -> Any:
    """Return a value with its numbers multiplied by a factor above 0.

    Whole numbers are rounded and change by one at least. A share above 2/3 would leave 0..1: there what is missing to 1
    is divided. Text, records and whatever else has no numbers of its own stay.
    """
    if isinstance(value, tuple | list):
        return type(value)(scaled(part, factor) for part in value)
    if isinstance(value, dict):
        return {key: scaled(part, factor) for key, part in value.items()}
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value * factor if getattr(getattr(value, "dtype", None), "kind", "") == "f" else value
    if isinstance(value, int):
        moved = round(value * factor)
        return moved if moved != value or factor == 1 else value + (1 if factor > 1 else -1)
    beyond = 2 / 3 < value < 1 and value * factor > 1
    return 1 - (1 - value) / factor if beyond else value * factor


class _Loader(SourceFileLoader):
    """Loads a module with one of its constants multiplied."""

    moved: tuple[str, float] = ("", 1.0)

    def get_code(self, fullname: str) -> CodeType:  # never from a .pyc file
        path = self.get_filename(fullname)
        return compile(with_moved(self.get_data(path).decode(), *self.moved), path, "exec")


def with_moved(text: str, name: str, factor: float) -> ast.Module:
    """Return a module's syntax tree in which a constant is multiplied right after it was bound."""
    tree = ast.parse(text)
    body: list[ast.stmt] = []
    for statement in tree.body:
        body.append(statement)
        if name in dict(_pairs(statement)):
            line = f"{name} = __import__('evaluation.constants').constants.scaled({name}, {factor!r})"
            move = ast.parse(line).body[0]
            for node in ast.walk(move):
                ast.copy_location(node, statement)
            body.append(move)
    tree.body = body
    return ast.fix_missing_locations(tree)


class Move(MetaPathFinder):
    """Imports one module with a constant multiplied; to be put first into `sys.meta_path` before Anther is imported."""

    def __init__(self, constant: Constant, factor: float) -> None:
        self.constant, self.factor = constant, factor

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> ModuleSpec | None:
        """Return how the module of the constant is loaded; None for all others."""
        if fullname != self.constant.module:
            return None
        spec = PathFinder.find_spec(fullname, path)
        if spec is not None and spec.origin is not None:
            loader = _Loader(fullname, spec.origin)
            loader.moved = (self.constant.name, self.factor)
            spec.loader = loader
        return spec


def arrange(constant: Constant, factor: float) -> None:
    """Have this process import Anther with a constant moved; functions that hold it compiled are compiled anew.

    Raises:
        RuntimeError: the module of the constant is imported already.
    """
    if constant.module in sys.modules:
        raise RuntimeError(f"{constant.module} is imported already: a constant is moved before that.")
    sys.meta_path.insert(0, Move(constant, factor))
    if compiled(constant):
        os.environ["NUMBA_CACHE_DIR"] = tempfile.mkdtemp()


_COMPILES = {"njit", "compiled", "inner", "inlined", "merged"}
"""Decorators of functions that numba compiles."""


def compiled(constant: Constant) -> bool:
    """Return whether a function that numba compiles, and keeps on disk, uses a constant or what is derived from it."""
    own = ROOT.joinpath(*constant.module.split("."))
    for path in sorted((ROOT / "anther").rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if not _COMPILES & set(re.findall(r"\w+", text)) or constant.name not in text:
            continue
        tree, names = ast.parse(text), {constant.name}
        if path not in (own.with_suffix(".py"), own / "__init__.py") and not _imports(tree, constant):
            continue
        for statement in tree.body:
            names |= {name for name, value in _pairs(statement) if names & _names(value)}
        for node in tree.body:
            decorated = set().union(*map(_names, node.decorator_list)) if isinstance(node, ast.FunctionDef) else set()
            if _COMPILES & decorated and names & _names(node):
                return True
    return False


def _imports(tree: ast.Module, constant: Constant) -> bool:
    return any(
        isinstance(node, ast.ImportFrom)
        and node.module == constant.module
        and constant.name in {alias.name for alias in node.names}
        for node in tree.body
    )


def _names(tree: ast.AST) -> set[str]:
    """Return the names in a tree, of `a.b` both."""
    names = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    return names | {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
