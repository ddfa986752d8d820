"""The house rules that a reader relies on: which module may import which, and how long a file may get."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "anther"
MODULES = sorted(SOURCE.rglob("*.py"))

BASE = {"errors", "checks", "files", "geometry", "images", "libraries", "style", "transforms", "__init__"}
ORDER = [
    "runs", "capture", "masks", "cloud", "skeleton", "stem", "flowers", "elastic_rod", "formats", "plant",
    "pressing", "swing", "devices", "safety", "oscillation", "calibration", "arm", "robot", "grasp", "shake",
    "execution",
    "response", "escalation", "identification", "pipeline",
]  # fmt: skip
STAGES = set(ORDER)
AROUND = [
    "history",
    "fruit_set",
    "results",
    "pictures",
    "report",
    "traits",
    "log",
    "drivers",
    "cells",
    "viewer",
    "sim",
    "samples",
    "sweep",
    "serve",
    "commands",
    "cli",
]
"""The rooms about the stages, in this order as well."""


def modules_imported(path: Path) -> set[str]:
    """Whole names of what a file imports: `anther.room.module`, or of a name in it."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return names


def imported(path: Path) -> set[str]:
    """First-level names under `anther` that a file imports."""
    names = (name.split(".") for name in modules_imported(path))
    return {parts[1] for parts in names if parts[0] == "anther" and len(parts) > 1} - {"__version__"}


def room(path: Path) -> str:
    """The first-level module or package a file belongs to."""
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


def is_module(path: Path) -> bool:
    return path.is_dir() or path.with_suffix(".py").is_file()


def complaints(rule: Callable[[Path], Iterator[str]]) -> list[str]:
    """What a rule finds in all files."""
    return [f"{path.relative_to(SOURCE)}: {said}" for path in MODULES for said in rule(path)]


def test_every_room_imports_only_earlier_ones() -> None:
    whole = [*ORDER, *AROUND]
    assert {room(path) for path in MODULES} == BASE | set(whole), "a room is missing in ORDER or AROUND, or gone"

    def rule(path: Path) -> Iterator[str]:
        here, names = room(path), imported(path) - BASE
        if here in BASE and names:
            yield f"a foundation, imports {names}"
        elif here == "elastic_rod" and names - {"elastic_rod"}:
            yield f"the rod engine knows nothing of {names}"
        elif here in whole:
            later = {name for name in names if whole.index(name) > whole.index(here)}
            if later:
                yield f"imports later rooms: {later}"

    assert not complaints(rule)


def test_what_is_private_to_a_package_stays_in_it() -> None:
    def rule(path: Path) -> Iterator[str]:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("anther."):
                names = [*node.module.split("."), *(alias.name for alias in node.names)]
                private = [name for name in names if name.startswith("_")]
                if private and names[1] != room(path):
                    yield f"imports {private} of {names[1]}"

    assert not complaints(rule)


def test_packages_say_what_is_public() -> None:
    """By `__all__`; a module that only its own package uses is private, but for those that docs/ give to users."""
    told = "".join(page.read_text() for page in (ROOT / "docs").glob("*.md"))
    used = {path: modules_imported(path) for path in MODULES}

    def rule(path: Path) -> Iterator[str]:
        here = path.relative_to(SOURCE).with_suffix("").parts
        if len(here) < 2 or here[0] in {"commands", "drivers"} or "migrations" in here:
            return  # each command and driver is one that users name
        module = ".".join(("anther", *here))
        if here[-1] == "__init__":
            defines = any(isinstance(node, ast.FunctionDef | ast.ClassDef) for node in ast.parse(path.read_text()).body)
            if defines and "__all__" not in path.read_text():
                yield "does not say what is public"
        elif not here[-1].startswith("_") and module not in told:
            elsewhere = (names for other, names in used.items() if room(other) != here[0])
            if all(module not in names for names in elsewhere):
                yield "only its own package uses it: its name begins with _"

    assert not complaints(rule)


def test_files_and_functions_stay_short() -> None:
    def rule(path: Path) -> Iterator[str]:
        text = path.read_text()
        if text.count("\n") > 600:
            yield f"{text.count(chr(10))} lines"
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                doc = node.body[0] if ast.get_docstring(node) is not None else None
                lines = node.end_lineno - node.lineno + 1 - (doc.end_lineno - doc.lineno + 1 if doc else 0)  # type: ignore[operator]
                if lines > 60:
                    yield f"{node.name} has {lines} lines"

    assert not complaints(rule)


def test_ground_truth_stays_in_the_simulator() -> None:
    def rule(path: Path) -> Iterator[str]:
        if room(path) not in {"sim", "commands"} and "sim" in imported(path):
            yield "must not see the simulator's truth"

    assert not complaints(rule)


def test_modules_say_what_they_are() -> None:
    def rule(path: Path) -> Iterator[str]:
        text = path.read_text()
        if text.strip() and not ast.get_docstring(ast.parse(text)):
            yield "no docstring"

    assert not complaints(rule)


def test_what_scripts_import_of_anther_is_there() -> None:
    """Experiments are run rarely, and the type checker reads `src` alone."""
    missing = [
        f"{path.relative_to(ROOT)}: {node.module}.{alias.name}"
        for where in ("experiments", "benchmarks", "examples", "tools")
        for path in sorted((ROOT / where).rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "anther"
        for alias in node.names
        if not hasattr(import_module(node.module), alias.name)
        and not is_module(SOURCE.parent / node.module.replace(".", "/") / alias.name)
    ]
    assert not missing
