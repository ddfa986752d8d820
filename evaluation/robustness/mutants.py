"""Small wrong changes, one at a time, and which of them the tests catch.

    python -m evaluation.robustness.mutants --count 26                 # of each area, chosen by --seed
    python -m evaluation.robustness.mutants --area safety --count 60

A mutant turns one comparison, sum, product, and/or, minimum/maximum or negation into its opposite. The tests that
enter its function are run on a copy of the sources; a mutant that they pass with has survived. A survivor is either a
rule that no test states, or a change that nobody could notice: read them. What was tried is kept in `build/mutants`, so
that a stopped run goes on; `--again` tries the survivors once more.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import pytest

from evaluation.harness import finish, options
from evaluation.tables import markdown

ROOT = Path(__file__).parents[2]
KEPT = ROOT / "build" / "mutants"
COPY = KEPT / "src"
AREAS = {
    "safety": (
        ["robot/safety", "robot/pressing.py"],
        ["test_safety.py", "test_devices.py", "test_chain.py", "test_motor.py", "test_pressing.py"],
    ),
    "execution": (
        ["pollination/execution", "robot/swing.py"],
        [
            "test_execution.py", "test_early_reach.py", "test_swing.py", "test_watched_execution.py", "test_steps.py",
            "test_faults.py",
        ],
    ),
    "grasp": (["pollination/grasp"], ["test_grasp.py", "test_confidence.py"]),
    "shake": (
        ["pollination/shake", "pollination/escalation"],
        [
            "test_shake_choice.py", "test_plan_shake.py", "test_escalation.py", "test_foresight.py", "test_pads.py",
            "test_breeze.py", "test_expectation.py", "test_overtones.py", "test_pressing.py",
        ],
    ),
    "response": (
        ["pollination/response", "core/oscillation.py"],
        [
            "test_oscillation.py", "test_petals.py", "test_flower_depth.py", "test_following.py", "test_response.py",
            "test_points.py", "test_near_grasp.py", "test_overtones.py",
        ],
    ),
    "history": (
        ["history"],
        [
            "test_history.py", "test_history_command.py", "test_beliefs.py", "test_fleet.py", "test_fruit_set.py",
            "test_serve.py",
        ],
    ),
}  # fmt: skip
"""Area -> its sources under src/anther, and the tests that state its rules."""
COMPARED = {ast.Lt: ast.Gt, ast.Gt: ast.Lt, ast.LtE: ast.Gt, ast.GtE: ast.Lt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
CALCULATED = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
CALLED = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "any": "all", "all": "any"}
SLOWER = 10
"""A mutant whose tests take so many times as long, and two minutes, hangs: it is caught."""


class Mutant(NamedTuple):
    """One wrong change: where, from what to what, the file's text with it, and the functions about it, innermost first.

    The key is the same as long as the function about it is.
    """

    file: str
    line: int
    before: str
    after: str
    text: str
    inside: list[str]
    compiled: bool
    key: str


def mutants(area: str, seed: int) -> Iterator[Mutant]:
    """All mutants of an area in an order that the seed draws and that changes elsewhere in the sources do not alter."""
    places = []
    for name in AREAS[area][0]:
        place = COPY / "anther" / name
        for file in sorted(place.rglob("*.py")) if place.is_dir() else [place]:
            seen: dict[str, int] = defaultdict(int)
            for k, node in enumerate(changeable(ast.parse(file.read_text()))):
                said = ast.unparse(node)
                seen[said] += 1
                drawn = hashlib.sha256(f"{seed} {file.name} {said} {seen[said]}".encode()).hexdigest()
                places.append((drawn, file, k))
    yield from (mutant(file, k) for _, file, k in sorted(places))


def mutant(file: Path, number: int) -> Mutant:
    """Return a file with its changeable place of that number changed."""
    tree = ast.parse(file.read_text())
    node = changeable(tree)[number]
    before, line = ast.unparse(node), getattr(node, "lineno", 0)
    about = [f for f in ast.walk(tree) if isinstance(f, ast.FunctionDef) and f.lineno <= line <= (f.end_lineno or 0)]
    about.reverse()
    name = str(file.relative_to(COPY))
    inside = [f"{name}:{min([f.lineno, *(d.lineno for d in f.decorator_list)])}" for f in about]
    compiled = any("njit" in ast.unparse(d) or "compiled" in ast.unparse(d) for f in about for d in f.decorator_list)
    _change(node)
    key = hashlib.sha256(ast.unparse(about[0] if about else tree).encode()).hexdigest()[:12]
    return Mutant(name, line, before, ast.unparse(node), ast.unparse(tree), inside, compiled, key)


def changeable(tree: ast.AST) -> list[ast.AST]:
    """Return the places that a mutant may change."""
    return [node for node in ast.walk(tree) if _changeable(node)]


def _changeable(node: ast.AST) -> bool:
    match node:
        case ast.Compare(ops=[op]):
            return type(op) in COMPARED
        case ast.BinOp(op=op, left=left):
            return type(op) in CALCULATED and not (isinstance(left, ast.Constant) and isinstance(left.value, str))
        case ast.BoolOp() | ast.UnaryOp(op=ast.USub() | ast.Not()):
            return not isinstance(getattr(node, "operand", None), ast.Constant)
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)):
            return name in CALLED
    return False


def _change(node: ast.AST) -> None:
    match node:
        case ast.Compare(ops=[op]):
            node.ops = [COMPARED[type(op)]()]
        case ast.BinOp(op=op):
            node.op = CALCULATED[type(op)]()
        case ast.BoolOp(op=op):
            node.op = ast.Or() if isinstance(op, ast.And) else ast.And()
        case ast.UnaryOp(op=ast.Not()):
            node.operand = ast.UnaryOp(ast.Not(), node.operand)
        case ast.UnaryOp():
            node.op = ast.UAdd()
        case ast.Call(func=ast.Name() as name):
            name.id = CALLED[name.id]
        case ast.Call(func=ast.Attribute() as name):
            name.attr = CALLED[name.attr]


class Entered:
    """A pytest plugin: which functions of the copy each test enters, in any thread, and how long it takes [s]."""

    def __init__(self) -> None:
        self.functions: dict[str, set[str]] = {}
        self.seconds: dict[str, float] = defaultdict(float)

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Watch the calls while a test and its fixtures run."""
        entered: set[tuple[str, int]] = set()

        def watch(frame: FrameType, event: str, arg: Any) -> None:
            entered.add((frame.f_code.co_filename, frame.f_code.co_firstlineno))

        sys.settrace(watch)
        threading.settrace(watch)
        yield
        sys.settrace(None)
        threading.settrace(None)  # type: ignore[arg-type]
        here = f"{COPY}/"
        self.functions[item.nodeid] = {f"{f.removeprefix(here)}:{n}" for f, n in entered if f.startswith(here)}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep how long a test takes."""
        self.seconds[report.nodeid] += report.duration


def coverage(area: str) -> dict[str, list[Any]]:
    """Return test -> [the functions it enters, its seconds], kept for the same tests and sources."""
    tests = [path for name in AREAS[area][1] for path in (ROOT / "tests").rglob(name)]
    every = [*sorted((COPY / "anther").rglob("*.py")), *sorted((ROOT / "tests").rglob("*.py"))]
    state = hashlib.sha256(b"".join(path.read_bytes() for path in every)).hexdigest()[:16]
    kept = KEPT / f"{area}_{state}.json"
    if not kept.exists():
        code = f"import sys, evaluation.robustness.mutants as m; m.watch({[str(t) for t in tests]}, {str(kept)!r})"
        subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=_environment(), check=True)
    return json.loads(kept.read_text())


def watch(tests: list[str], kept: str) -> None:
    """Run tests and write what each enters."""
    plugin = Entered()
    if pytest.main(["-q", "-m", "", "-p", "no:cacheprovider", *tests], plugins=[plugin]) != 0:
        sys.exit("the tests fail without any mutant")
    found = {test: [sorted(names), plugin.seconds[test]] for test, names in plugin.functions.items()}
    Path(kept).write_text(json.dumps(found))


def tests_of(tried: Mutant, covered: dict[str, list[Any]]) -> list[str]:
    """Return the tests that enter a mutant's function, those of the quickest file first.

    Outside of any function these are all tests; of a compiled one, which no trace sees, those that enter its file.
    """
    every = {name for names, _ in covered.values() for name in names}
    inside = next((f for f in tried.inside if f in every), f"{tried.file}:" if tried.compiled else "")
    if tried.inside and not inside:
        return []
    file = not inside or inside.endswith(":")
    enters = {n for n in every if n == inside or (file and n.startswith(inside))}
    chosen = [test for test, (names, _) in covered.items() if not enters.isdisjoint(names)]
    spent: dict[str, float] = defaultdict(float)
    for test in chosen:
        spent[test.split("::")[0]] += covered[test][1]
    return sorted(chosen, key=lambda test: spent[test.split("::")[0]])


def survives(tried: Mutant, tests: list[str], seconds: float) -> bool:
    """Return whether the tests pass with a mutant, in the copy of the sources."""
    if not tests:
        return True
    place = COPY / tried.file
    place.write_text(tried.text)
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-m", "", "-p", "no:cacheprovider", *tests]
    try:
        return not subprocess.run(
            command, cwd=ROOT, env=_environment(), capture_output=True, timeout=SLOWER * seconds + 120, check=False
        ).returncode
    except subprocess.TimeoutExpired:
        return False
    finally:
        shutil.copy2(ROOT / "src" / tried.file, place)


def _environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": f"{COPY}:{ROOT}", "OMP_NUM_THREADS": "1"}


def tried_in(area: str, count: int, seed: int, again: bool, rows: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """Try mutants of an area that were not tried yet; return the rows of all of them."""
    covered = coverage(area)
    mine = []
    for tried, _ in zip(mutants(area, seed), range(count), strict=False):
        if tried.key not in rows or (again and rows[tried.key]["survived"]):
            tests = tests_of(tried, covered)
            lived = survives(tried, tests, sum(covered[test][1] for test in tests))
            where = f"{tried.file}:{tried.line}"
            rows[tried.key] = {"where": where, "from": tried.before, "to": tried.after, "survived": lived}
            (KEPT / "tried.json").write_text(json.dumps(rows, indent=1) + "\n")
            said = f"{'SURVIVED' if lived else 'caught  '} {where}: {tried.before}  ->  {tried.after}"
            print(f"{said}  ({len(tests)} tests)", flush=True)
        mine.append(rows[tried.key])
    return mine


def main() -> None:
    """Try mutants of each area and print the survivors."""
    own = {
        "--area": (tuple(AREAS), "of the sources", tuple(AREAS)),
        "--count": (26, "mutants of each area"),
        "--again": (False, "try what survived before once more"),
    }
    args = options(__doc__, quick="three mutants of each area", seed=(0, "of the choice"), own=own)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it, some tests may not
    shutil.copytree(ROOT / "src", COPY, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))
    kept = KEPT / "tried.json"
    rows = json.loads(kept.read_text()) if kept.exists() else {}
    count = 3 if args.quick else args.count
    found = {area: tried_in(area, count, args.seed, args.again, rows) for area in args.area}
    found["all"] = [row for mine in found.values() for row in mine]
    caught = {area: sum(not row["survived"] for row in mine) for area, mine in found.items()}
    lines = [
        (area, len(mine), f"{caught[area]} ({100 * caught[area] / max(len(mine), 1):.0f} %)")
        for area, mine in found.items()
    ]
    lived = [f"- `{r['where']}`: `{r['from']}` -> `{r['to']}`" for r in found["all"] if r["survived"]]
    metrics = {f"{area}_tried": len(mine) for area, mine in found.items()}
    metrics |= {f"{area}_caught": count for area, count in caught.items()}
    finish(args, metrics, markdown(("area", "tried", "caught"), lines), *lived)


if __name__ == "__main__":
    main()
