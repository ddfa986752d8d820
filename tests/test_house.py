"""The ten rooms in order, the doors, and how long a file may get."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "anther"
MODULES = sorted(SOURCE.rglob("*.py"))
OUTSIDE = [path for where in ("evaluation", "examples", "tools") for path in sorted((ROOT / where).rglob("*.py"))]

ROOMS = ["core", "rods", "perception", "plant", "robot", "pollination", "sim", "history", "show", "cli"]
"""Each imports only those before it."""
APART = {"sim": {"pollination"}, "history": {"pollination"}}
"""What a room must not import though it comes before: what judges a trial, or remembers it, knows nothing of
how it was planned. That pollination never imports sim says the order."""
BEHIND = {
    "evaluation/perception/colour_images.py",
    "evaluation/perception/fit_confidence.py",
    "evaluation/perception/fit_course.py",
    "evaluation/perception/fit_feet.py",
    "evaluation/perception/hand_eye.py",
    "evaluation/perception/registration.py",
    "evaluation/prediction/belief.py",
    "evaluation/rods/objectivity.py",
    "evaluation/speed/count_operations.py",
    "evaluation/trials/arm_readings.py",
}
"""Files of `evaluation` that reach behind a door, for what no user needs."""


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
    """Rooms that a file imports."""
    names = (name.split(".") for name in modules_imported(path))
    return {parts[1] for parts in names if parts[0] == "anther" and len(parts) > 1} & set(ROOMS)


def private(path: Path, room: str = "") -> set[str]:
    """Names with an underscore of rooms other than `room` that a file imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("anther"):
            for alias in node.names:
                names = [*node.module.split("."), alias.name]
                if names[1] != room and any(n.startswith("_") and not n.startswith("__") for n in names):
                    found.add(".".join(names))
    return found


def room(path: Path) -> str:
    """The room a file stands in; "" for the package's own."""
    return path.relative_to(SOURCE).parts[0] if path.parent != SOURCE else ""


def is_module(path: Path) -> bool:
    return path.is_dir() or path.with_suffix(".py").is_file()


def complaints(rule: Callable[[Path], Iterator[str]]) -> list[str]:
    """What a rule finds in all files."""
    return [f"{path.relative_to(SOURCE)}: {said}" for path in MODULES for said in rule(path)]


def test_the_first_level_is_the_ten_rooms() -> None:
    first = {path.name for path in SOURCE.iterdir() if path.name != "__pycache__"}
    assert first == {*ROOMS, "__init__.py", "py.typed"}


def test_every_room_imports_only_earlier_ones() -> None:
    def rule(path: Path) -> Iterator[str]:
        here = room(path)
        allowed = set(ROOMS[: ROOMS.index(here) + 1]) - APART.get(here, set()) if here else {"core"}
        if later := imported(path) - allowed:
            yield f"must not import {later}"

    assert not complaints(rule)


def test_what_is_private_to_a_room_stays_in_it() -> None:
    assert not complaints(lambda path: iter(sorted(private(path, room(path)))))


def test_what_stands_outside_takes_what_is_public() -> None:
    reach = {str(path.relative_to(ROOT)) for path in OUTSIDE if private(path)}
    assert reach == BEHIND


def test_a_module_that_its_own_folder_alone_uses_is_private() -> None:
    """But for those that docs/ or a door give to users, and one a command or driver."""
    told = "".join(page.read_text() for page in [*(ROOT / "docs").glob("*.md"), *SOURCE.glob("*/__init__.pyi")])
    used = {path: modules_imported(path) for path in [*MODULES, *OUTSIDE]}

    def rule(path: Path) -> Iterator[str]:
        *folder, last = path.relative_to(SOURCE).with_suffix("").parts
        if len(folder) < 2 or last.startswith("_") or "migrations" in folder or folder[-1] == "drivers":
            return
        module = ".".join(("anther", *folder, last))
        if module not in told and f".{'.'.join((*folder[1:], last))} import" not in told:
            elsewhere = (names for other, names in used.items() if path.parent not in other.parents)
            if all(module not in names for names in elsewhere):
                yield "only its own folder uses it: its name begins with _"

    assert not complaints(rule)


def test_packages_say_what_is_public() -> None:
    def rule(path: Path) -> Iterator[str]:
        body = ast.parse(path.read_text()).body
        if path.name == "__init__.py" and path.parent != SOURCE and "migrations" not in path.parts:
            defines = any(isinstance(node, ast.FunctionDef | ast.ClassDef) for node in body)
            if defines and "__all__" not in path.read_text():
                yield "does not say what is public"

    assert not complaints(rule)


@pytest.mark.parametrize("name", [name for name in ROOMS if name != "cli"])
def test_a_door_gives_what_its_stub_names(name: str) -> None:
    door = import_module(f"anther.{name}")
    stub = ast.parse((SOURCE / name / "__init__.pyi").read_text())
    names = {alias.name for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert names == set(door.__all__)
    stated = next(node.value for node in stub.body if isinstance(node, ast.Assign))
    assert names == set(ast.literal_eval(stated))
    assert all(hasattr(door, public) for public in names)


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


def test_modules_say_what_they_are() -> None:
    def rule(path: Path) -> Iterator[str]:
        text = path.read_text()
        if text.strip() and not ast.get_docstring(ast.parse(text)):
            yield "no docstring"

    assert not complaints(rule)


def test_what_scripts_import_of_anther_is_there() -> None:
    """They are run rarely, and the type checker reads `src` alone."""
    missing = [
        f"{path.relative_to(ROOT)}: {node.module}.{alias.name}"
        for path in OUTSIDE
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in {"anther", "evaluation"}
        for alias in node.names
        if not hasattr(import_module(node.module), alias.name)
        and not is_module(
            (SOURCE.parent if node.module.startswith("anther") else ROOT) / node.module.replace(".", "/") / alias.name
        )
    ]
    assert not missing
