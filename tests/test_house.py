"""The house rules that a reader relies on: which module may import which, and how long a file may get."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "anther"
MODULES = sorted(SOURCE.rglob("*.py"))

BASE = {"errors", "checks", "files", "geometry", "__init__"}
ORDER = [
    "capture", "calibration", "masks", "cloud", "skeleton", "stem", "next_view", "flowers", "grasp", "elastic_rod",
    "plant", "pressing", "vibration", "swing", "devices", "motion_limits", "watchdog", "motor_guard", "safety",
    "oscillation", "execution",
    "early_reach", "flower_tracking", "response", "escalation", "identification", "pipeline",
]  # fmt: skip
STAGES = set(ORDER)
OUTSIDE = {"sim", "drivers", "commands", "cli", "arm"}


def imported(path: Path) -> set[str]:
    """First-level names under `anther` that a file imports."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "anther":
            parts = node.module.split(".")
            names |= {parts[1]} if len(parts) > 1 else {alias.name for alias in node.names}
        elif isinstance(node, ast.Import):
            names |= {a.name.split(".")[1] for a in node.names if a.name.startswith("anther.")}
    return names - {"__version__"}


def room(path: Path) -> str:
    """The first-level module or package a file belongs to."""
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_stages_import_only_earlier_stages(path: Path) -> None:
    here, names = room(path), imported(path) - BASE
    if here in BASE:
        assert not names - BASE, f"{path.name} is a foundation and imports {names}"
    elif here == "elastic_rod":
        assert names <= {"elastic_rod"}, f"the rod engine knows nothing of {names}"
    elif here in STAGES:
        assert not names & OUTSIDE, f"stage {here} imports {names & OUTSIDE}"
        later = {n for n in names & STAGES if ORDER.index(n) > ORDER.index(here)}
        assert not later, f"stage {here} imports later stages {later}"


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_files_and_functions_stay_short(path: Path) -> None:
    text = path.read_text()
    assert text.count("\n") <= 400, f"{path.name} has {text.count(chr(10))} lines"
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            doc = node.body[0] if ast.get_docstring(node) is not None else None
            lines = node.end_lineno - node.lineno + 1 - (doc.end_lineno - doc.lineno + 1 if doc else 0)  # type: ignore[operator]
            assert lines <= 60, f"{path.name}:{node.lineno} {node.name} has {lines} lines"


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_ground_truth_stays_in_the_simulator(path: Path) -> None:
    if room(path) not in {"sim", "commands"}:
        assert "sim" not in imported(path), f"{path.name} must not see the simulator's truth"


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_modules_say_what_they_are(path: Path) -> None:
    assert path.read_text().strip() == "" or ast.get_docstring(ast.parse(path.read_text())), f"{path} has no docstring"
