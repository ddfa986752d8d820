"""Work along a greenhouse row: map it, begin a shift, visit its stems one after another; the same again goes on."""

from __future__ import annotations

import sys
import time
from collections import Counter
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

from anther.cli.args.row import Args
from anther.cli.output import kept_log
from anther.cli.row_visit import visit_stem
from anther.cli.simulated_house import SimulatedHouse, drawn_rows, grow_house
from anther.core.checks import check_range
from anther.core.errors import bad_input
from anther.history import (
    Order,
    Report,
    Robot,
    Shift,
    StemResult,
    begin_shift,
    find_unfinished_shift,
    hide_password,
    read_shift,
    record_house,
    run_shift,
)
from anther.robot.cells.rows import read_rows


def run(args: Args) -> int:
    """Run the shift and say how it went.

    Returns:
        0 if every stem was visited or left with its reason, 1 if not.
    """
    if args.simulate is None:
        do = "Add --simulate tomato, or pepper; docs/row.md says what drives a cart."
        raise bad_input("robot", given="none", allowed="a simulated one: no real row was worked yet", do=do)
    check_range("seed", args.seed, 0, 10**6)
    check_range("robots", args.robots, 1, 100)
    if args.many:
        return _run_many(args)
    found = _run_house(args)
    states = _say(found)
    print(f"on pages: anther history serve {hide_password(args.history)}")
    return int(states["visited"] + states["left"] < len(found))


def _run_house(args: Args, *, quiet: bool = False) -> list[StemResult]:
    """Map a house, begin a shift or go on with one, and return what became of every stem.

    What each visit is at is shown meanwhile, unless it is `quiet`.
    """
    house = _grow(args)
    record_house(house.built(), args.history, passes=list(house.passes(datetime.now(UTC))))
    number = find_unfinished_shift(house.name, args.history)
    how = "begins" if number is None else "goes on"
    number = number or begin_shift(_next_shift(args, house.name), args.history)
    stems = read_shift(number, args.history)
    due = sum(stem.state in ("waiting", "working") for stem in stems)
    print(f"house '{house.name}': {len(stems)} stems, {due} to visit; shift {number} {how}", flush=True)
    work = _Work(house, args, len(stems) - due, len(stems), quiet=quiet)
    return run_shift(number, work, args.history, simulated=True)


def _grow(args: Args) -> SimulatedHouse:
    assert args.simulate is not None
    if args.file is not None:
        rows, name = list(read_rows(args.file)), args.file.stem
    else:
        rows = drawn_rows(args.simulate, args.plants, args.rows)
        name = f"{args.rows} x {args.plants}"
    name = args.house or f"simulated {args.simulate} {args.seed}, {name}"
    return grow_house(name, args.simulate, args.seed, rows, placed=args.file is not None)


def _next_shift(args: Args, house: str) -> Shift:
    """Return a shift that begins now, in a house where it is ten in the morning now."""
    now = datetime.now(UTC).replace(microsecond=0)
    begin = now.astimezone(timezone(timedelta(hours=10) - timedelta(hours=now.hour, minutes=now.minute)))
    robots = tuple(Robot(f"simulated {k + 1}") for k in range(args.robots))
    return Shift(house, begin, begin + timedelta(hours=6), robots)


class _Work:
    """Visits stems of a simulated house, and tells of each as it ends."""

    def __init__(self, house: SimulatedHouse, args: Args, done: int, stems: int, *, quiet: bool) -> None:
        self._house, self._args, self._done, self._stems, self._quiet = house, args, done, stems, quiet

    def __call__(self, order: Order) -> Report:
        side, began = self._house.sides[order.row, order.side], time.monotonic()
        assert side is not None
        which = f"{self._done + 1:4} of {self._stems}  row {order.row} {order.side}, hook {order.hook + 1}"
        if not self._quiet:
            print(f"{which} ...", file=sys.stderr, flush=True)
        name = f"{order.shift}-{order.row}-{order.side}-{order.hook + 1}-{order.begin:%H%M%S}"
        folder = Path(self._args.out) / name.replace("/", "-")
        report = visit_stem(side.asking(order.hook), order, self._args.history, folder, quiet=self._quiet)
        self._done += 1
        took, computed = (report.ended - order.begin).total_seconds(), time.monotonic() - began
        print(f"{which}: {report.visit.result_words}, {took:.1f} s (simulated in {computed:.0f} s)", flush=True)
        return report


def _say(found: list[StemResult]) -> Counter[str]:
    """Say what became of every stem; return how many are in which state."""
    states = Counter(stem.state for stem in found)
    results = Counter(stem.reason for stem in found if stem.state == "visited")
    told = "; ".join(f"{count} {reason}" for reason, count in results.most_common())
    told = f" ({told})" if told else ""
    print(f"{len(found)} stems: {states['visited']} visited{told}, {states['left']} left")
    for stem in found:
        if stem.state != "visited":
            print(f"  row {stem.row} {stem.side}, hook {stem.hook + 1}: {stem.reason or stem.state}")
    return states


def _run_many(args: Args) -> int:
    """Run many houses on Dask, and say how it went."""
    from anther.history import sweep

    asked = {name: getattr(args, name) for name in ("simulate", "plants", "rows", "robots")}
    asked["file"] = None if args.file is None else str(args.file.absolute())
    table = [{**asked, "seed": args.seed + k} for k in range(int(check_range("many", args.many, 1, 10**6)))]
    jobs = sweep.run(run_one, table, args.out, name="row")
    done = [job.result for job in jobs if job.state == "done" and job.result]
    counts = {name: sum(result[name] for result in done) for name in ("stems", "visited", "left", "pollinated")}
    told = ", ".join(f"{count} {name}" for name, count in counts.items())
    print(f"{len(done)} of {len(jobs)} houses: {told}")
    for job in jobs:
        if job.state != "done":
            print(f"seed {job.row['seed']}: {job.state}: {job.reason or 'not begun'}")
    print(f"{sweep.export(args.out, jobs)}: a line a house")
    return int(len(done) < len(jobs))


def run_one(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Run a house of a table into a folder, with a history of its own; return how many stems came to what."""
    file = None if row["file"] is None else Path(row["file"])
    here = {"history": str(folder / "history.sqlite"), "out": str(folder)}
    with kept_log(folder):
        found = _run_house(Args(**{**row, **here, "file": file}), quiet=True)
    states = Counter(stem.state for stem in found)
    counts = {state: states[state] for state in ("visited", "left")}
    return {"stems": len(found), "pollinated": sum(stem.reason == "pollinated" for stem in found), **counts}
