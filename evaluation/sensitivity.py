"""Which numeric constants matter: each is moved by a half up and down, and what its stage decides is compared.

    python -m evaluation.sensitivity --count                    # constants of each room, and nothing else
    python -m evaluation.sensitivity --room perception --jobs 2
    python -m evaluation.sensitivity --room perception --only skeleton.support

A constant is multiplied by 1.5 and by 2/3 in a process of its own, before Anther is imported, so that copies, default
values, derived constants and compiled functions follow. Whole numbers change by one at least. `evaluation/decisions`
holds each room's suite. What is done is kept in --out; after a change of the source, delete it.

Keys of the --json file: constants, and constants_ROOM; of the rooms asked for ROOM_tried, ROOM_decide (constants that
change a decision), and MODULE.NAME: the share of cases in which a decision changes, the larger of both ways.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from rich.console import RenderableType

from anther.core.files import write_text
from evaluation.constants import Constant, constants
from evaluation.decisions import SUITES, changed, suite
from evaluation.harness import DATA, ONE_THREAD, Row, finish, options, progress, run_cases
from evaluation.tables import markdown, percent

FACTORS = (1.5, 1 / 1.5)
LONGEST = 600
"""A suite that takes longer hangs [s]: that is a decision too."""


def one_constant(row: Row, folder: Path) -> Row:
    """Return which decisions change, and in which cases, for each factor; how many cases there are."""
    inputs = Path(row["inputs"])
    before = json.loads(_known(inputs, row["module"]).read_text())
    found: Row = {}
    for factor in FACTORS:
        after = decisions(row["room"], inputs, row["module"], row["name"], factor)
        found[f"{factor:.2f}"] = {"failed": after} if isinstance(after, str) else changed(before, after)
        found["cases"] = len(before)
    return found


def _known(inputs: Path, module: str) -> Path:
    """Return the file of what a suite decides with the source as it is, from the stage on that holds a module."""
    return inputs / f"{'.'.join(module.split('.')[1:3])}.json"


def decisions(room: str, inputs: Path, module: str, name: str, factor: float) -> Any:
    """Return what a suite decides with a constant moved, in a process of its own; a text where it fails."""
    words = [sys.executable, "-m", "evaluation.decisions", room, str(inputs), module, name, str(factor)]
    try:
        done = subprocess.run(
            words, capture_output=True, text=True, timeout=LONGEST, check=False, env=os.environ | ONE_THREAD
        )
    except subprocess.TimeoutExpired:
        return f"more than {LONGEST} s"
    return json.loads(done.stdout) if done.returncode == 0 else done.stderr.strip().splitlines()[-1]


def prepared(room: str, out: Path, data: Path, chosen: Sequence[Constant], quick: bool) -> Path:
    """Return the folder with a suite's inputs and what it decides with the source as it is, made where missing."""
    inputs = (out / f"inputs_{room}").absolute()
    if not inputs.exists():
        new = inputs.with_name(f"{inputs.name}.part")
        new.mkdir(parents=True, exist_ok=True)
        suite(room).prepare(new, data, quick)
        new.rename(inputs)
    stages = {_known(inputs, constant.module): constant.module for constant in chosen}
    for path, module in progress(sorted(stages.items()), f"{room} as it is"):
        if not path.exists():
            write_text(path, json.dumps(suite(room).decide(inputs, module)))
    return inputs


def differing(row: Row) -> dict[str, dict[str, list[str]]]:
    """Return factor -> decision -> cases, of one constant."""
    return {f"{factor:.2f}": row.get(f"{factor:.2f}", {}) for factor in FACTORS}


def worst(row: Row) -> float:
    """Return the share of cases in which a decision changes, the larger of both factors; 1 where the suite failed."""
    if "lost" in row or any("failed" in found for found in differing(row).values()):
        return 1.0
    cases = [{case for some in found.values() for case in some} for found in differing(row).values()]
    return max(len(some) for some in cases) / max(row["cases"], 1)


def report(rows: Sequence[Row], values: dict[tuple[str, str], str]) -> Iterator[RenderableType]:
    """Yield, room by room, what each constant decides, those first that decide nothing."""
    for room in dict.fromkeys(row["room"] for row in rows):
        mine = sorted((row for row in rows if row["room"] == room), key=worst)
        lines = []
        for row in mine:
            place = row["module"].removeprefix(f"anther.{room}").removeprefix(".") or "__init__"
            value = values[row["module"], row["name"]]
            lines.append(
                (f"{place} {row['name']}", value[:40], percent(worst(row)), *map(_words, differing(row).values()))
            )
        yield f"{room}: {len(mine)} constants, {sum(worst(row) == 0 for row in mine)} of which change no decision."
        yield markdown(("constant", "value", "cases", "times 1.5", "divided by 1.5"), lines)


def _words(found: dict[str, Any]) -> str:
    if "failed" in found:
        return f"fails: {str(found['failed'])[:60]}"
    return ", ".join(f"{name} {len(cases)}" for name, cases in sorted(found.items(), key=lambda some: -len(some[1])))


def counted(every: Sequence[Constant]) -> dict[str, int]:
    """Return how many constants there are, in all and in each room."""
    rooms = Counter(constant.room for constant in every)
    return {"constants": len(every)} | {f"constants_{room}": rooms[room] for room in sorted(rooms)}


def _asked(constant: Constant, words: Sequence[str]) -> bool:
    return not words or any(word in f"{constant.module}.{constant.name}" for word in words)


def count_table(every: Sequence[Constant]) -> RenderableType:
    """Return the constants of each room, and the assignments that bind them: one may bind several."""
    rooms = {room: [c for c in every if c.room == room] for room in sorted({c.room for c in every})}
    lines = [
        (room, len(mine), len({(c.module, c.line) for c in mine})) for room, mine in {**rooms, "all": every}.items()
    ]
    return markdown(("room", "constants", "assignments"), lines)


def main() -> None:
    """Count the constants; unless that is all, move each and tell what changes."""
    own = {
        "--count": (False, "count them, and do nothing else"),
        "--room": (SUITES, "rooms whose constants are moved", SUITES),
        "--only": ((), "constants whose module or name holds one of these"),
    }
    args = options(
        __doc__,
        quick="two plants, and every 32nd scan",
        jobs="constants",
        out="runs/sensitivity",
        data="clouds",
        own=own,
    )
    every = constants()
    numbers: dict[str, Any] = counted(every)
    if args.count:
        finish(args, numbers, count_table(every))
        return
    cases = []
    for room in args.room:
        mine = [constant for constant in every if constant.room == room]
        chosen = [constant for constant in mine if _asked(constant, args.only)]
        inputs = prepared(room, args.out, args.data or DATA, chosen, args.quick)
        cases += [{"room": room, "module": c.module, "name": c.name, "inputs": str(inputs)} for c in chosen]
    rows = run_cases(one_constant, cases, args.out / "constants", args.jobs, lambda why: {"lost": why})
    for room in args.room:
        mine = [row for row in rows if row["room"] == room]
        numbers |= {f"{room}_tried": len(mine), f"{room}_decide": sum(worst(row) > 0 for row in mine)}
    numbers |= {f"{row['module'].removeprefix('anther.')}.{row['name']}": worst(row) for row in rows}
    finish(args, numbers, *report(rows, {(c.module, c.name): c.value for c in every}))


if __name__ == "__main__":
    main()
