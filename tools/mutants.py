"""Small wrong changes, one at a time, and which of them the tests catch.

    python tools/mutants.py --count 25                 # of each area, chosen by --seed
    python tools/mutants.py --area safety --count 60 --json mutants.json

A mutant turns one comparison, sum, product, and/or, minimum/maximum or negation into its opposite. The tests of its
area are run on a copy of the sources; a mutant that they pass with has survived. A survivor is either a rule that no
test states, or a change that nobody could notice: read them.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
AREAS = {
    "safety": (
        ["safety.py", "motion_limits.py", "watchdog.py", "motor_guard.py", "pressing.py"],
        ["test_safety.py", "test_devices.py", "test_motor.py", "test_pressing.py"],
    ),
    "execution": (
        ["execution", "early_reach.py", "swing.py"],
        ["test_execution.py", "test_early_reach.py", "test_swing.py", "test_watched_execution.py", "test_steps.py"],
    ),
    "grasp": (["grasp"], ["test_grasp.py", "test_confidence.py"]),
    "shake": (
        ["vibration", "escalation"],
        ["test_vibration.py", "test_shake_choice.py", "test_escalation.py", "test_foresight.py", "test_pads.py"],
    ),
    "response": (
        ["response", "flower_tracking.py", "oscillation.py"],
        ["test_response.py", "test_points.py", "test_beside.py"],
    ),
    "history": (["store", "fruit_set.py"], ["test_store.py", "test_beliefs.py", "test_fruit_set.py"]),
}
"""Area -> its sources under src/anther, and the tests that state its rules."""
COMPARED = {ast.Lt: ast.Gt, ast.Gt: ast.Lt, ast.LtE: ast.Gt, ast.GtE: ast.Lt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
CALCULATED = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
CALLED = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "any": "all", "all": "any"}
TIMEOUT = 600
"""Of the tests of one mutant [s]; one that hangs is caught."""


class Mutant(NamedTuple):
    """One wrong change: of which file, on which line, from what to what, and the file's text with it."""

    file: Path
    line: int
    before: str
    after: str
    text: str


def mutant(file: Path, number: int) -> Mutant:
    """Return a file with its changeable place of that number changed."""
    tree = ast.parse(file.read_text())
    node = changeable(tree)[number]
    before = ast.unparse(node)
    _change(node)
    return Mutant(file, getattr(node, "lineno", 0), before, ast.unparse(node), ast.unparse(tree))


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


def survives(tried: Mutant, copy: Path, tests: list[Path]) -> bool:
    """Return whether the tests pass with a mutant, in a copy of the sources."""
    place = copy / tried.file.relative_to(ROOT / "src")
    kept = place.read_bytes()
    place.write_text(tried.text)
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *map(str, tests)]
    env = os.environ | {"PYTHONPATH": str(copy), "OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, timeout=TIMEOUT, check=False)
        return done.returncode == 0
    except subprocess.TimeoutExpired:
        return False
    finally:
        place.write_bytes(kept)


def main() -> None:
    """Try mutants of each area and print the survivors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--area", choices=AREAS, nargs="*", default=list(AREAS))
    parser.add_argument("--count", type=int, default=25, help="mutants of each area")
    parser.add_argument("--seed", type=int, default=0, help="of the choice")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "src"
        shutil.copytree(ROOT / "src", copy)
        for area in args.area:
            sources, tests = AREAS[area]
            places = [ROOT / "src" / "anther" / name for name in sources]
            files = [file for place in places for file in (sorted(place.rglob("*.py")) if place.is_dir() else [place])]
            every = [(file, k) for file in files for k in range(len(changeable(ast.parse(file.read_text()))))]
            for file, k in random.Random(f"{args.seed} {area}").sample(every, min(args.count, len(every))):
                tried = mutant(file, k)
                lived = survives(tried, copy, [ROOT / "tests" / name for name in tests])
                where = f"{file.relative_to(ROOT)}:{tried.line}"
                rows.append({"area": area, "where": where, "from": tried.before, "to": tried.after, "survived": lived})
                print(f"{'SURVIVED' if lived else 'caught  '} {where}: {tried.before}  ->  {tried.after}", flush=True)
    for area in args.area:
        mine = [row for row in rows if row["area"] == area]
        caught = sum(not row["survived"] for row in mine)
        print(f"{area}: {caught} of {len(mine)} caught")
    caught = sum(not row["survived"] for row in rows)
    print(f"all: {caught} of {len(rows)} caught, {100 * caught / max(len(rows), 1):.0f} %")
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
