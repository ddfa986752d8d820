"""Is every stem of a shift accounted for, whatever fails? A simulated shift with injected faults and kills.

    python -m evaluation.house.shift --stems 1000 --kills 20

Robots visit the stems of a house of several rows. What becomes of a visit and how long it takes are those of a whole
visit that was carried out in a simulated row, drawn from all that were (docs/results/long/done/rows.jsonl).
Injected: visits that fail, robots that stop for good, one after another; people in rows; humid air about noon; and
programs that are killed with SIGKILL at any moment and started again. At the end every stem must be visited or left
with its reason, no visit be lost, and none be recorded twice. Robots a hectare follow from the stems a robot did.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from datetime import datetime, timedelta, timezone
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from anther.history import (
    Block,
    Climate,
    House,
    Order,
    Report,
    Robot,
    Row,
    Shift,
    Side,
    Work,
    begin_shift,
    count_trials,
    read_shift,
    read_trials,
    record_house,
    run_shift,
)
from anther.plant import Visit
from anther.sim import STEM_TO_STEM
from evaluation.harness import finish, options
from evaluation.tables import measured
from evaluation.trials.rows import cycle

BEGIN = datetime(2026, 6, 1, 8, tzinfo=timezone(timedelta(hours=2)))
PITCH = 0.36
"""Stems on one side of a row: 3.5 a square metre, rows 1.6 m apart (facts: rows, D) [m]."""
STEMS_HA = 35_000
WAITED = 400.0
"""A longer way from stem to stem is a wait or a charge: entering a row takes up to 180 s [s]."""
DONE = Path("docs/results/long/done/rows.jsonl")


class Worked(NamedTuple):
    """A visit that was carried out: its seconds, whether it held and harmed nothing, whether flowers moved, why not."""

    seconds: float
    held: bool
    moved: bool
    failure: str | None


def worked(path: Path = DONE) -> list[Worked]:
    """Return the visits of a campaign in rows; one that crashed or did nothing is none."""
    rows = [json.loads(line)["row"] for line in path.read_text().splitlines()]
    return [
        Worked(seconds, bool(row["held_unharmed"]), bool(row["flowers_moved"]), row["failure"])
        for row in rows
        if np.isfinite(seconds := visit_seconds(row))
    ]


def visit_seconds(row: dict[str, Any]) -> float:
    """Return how long a visit took: its parts, or where it did not shake, what the arm did [s]."""
    whole = cycle(row)
    if np.isfinite(whole):
        return whole
    return float(row.get("simulated_execution_seconds") or np.nan)


def built_house(stems: int, rows: int) -> House:
    """Return a house with so many stems."""
    half = [-(-stems // (2 * rows))] * (2 * rows)
    half[-1] -= sum(half) - stems
    sides = [Side({"p0": 0.0}, tuple(PITCH * (k + 1) for k in range(n))) for n in half]
    return House("house", "tomato", tuple(Row(f"{k}", sides[2 * k], sides[2 * k + 1]) for k in range(rows)))


def asked_shift(robots: int) -> Shift:
    """Return a day with people in two rows and humid air about noon."""

    def at(hours: float) -> datetime:
        return BEGIN + timedelta(hours=hours - 8)

    return Shift(
        "house", BEGIN, at(18), tuple(Robot(f"robot {k}", battery=9_000.0) for k in range(robots)),
        blocks=(Block("0", at(10), at(12)), Block("1", at(13), at(18), "spraying")),
        climate=(Climate(at(8), 21, 75), Climate(at(12), 24, 85), Climate(at(12.5), 25, 70)),
    )  # fmt: skip


def drawn_work(visits: Sequence[Worked], seed: int, stops: float, slow: float = 0.0) -> Work:
    """Return what draws the outcome of an order from a seed, its plant and its time, as the same order is given again.

    Args:
        visits: that it draws from.
        seed: of everything.
        stops: probability that the robot stops for good at a stem.
        slow: real time that a visit takes [s], so that a kill can hit it.
    """

    def work(order: Order) -> Report:
        key = [seed, int(order.begin.timestamp()), *order.plant.encode(), *order.robot.encode()]
        rng = np.random.default_rng(key)
        time.sleep(slow)
        drawn = visits[int(rng.integers(len(visits)))]
        to_stem = rng.uniform(60, 180) if order.enters else STEM_TO_STEM
        ended = order.begin + timedelta(seconds=drawn.seconds + to_stem)
        common = {"species": order.species, "plant": order.plant, "robot": order.robot, "time": order.begin}
        if rng.uniform() < stops:
            return Report(Visit(held_unharmed=False, failure="device_fault", **common), ended, "a motor's fault")
        told = {"held_unharmed": drawn.held, "flowers_moved": drawn.moved, "failure": drawn.failure}
        return Report(Visit(**told, **common), ended)

    return work


def run_killed(number: int, where: Path, seed: int, stops: float, kills: int) -> int:
    """Run a shift by a program that is killed so many times; return how many kills hit it."""
    words = [sys.executable, "-m", "evaluation.house.shift", "--run", f"{number}", "--history", f"{where}"]
    words += ["--seed", f"{seed}", "--stops", f"{stops}"]
    rng, hit = np.random.default_rng(seed), 0
    while True:
        done = count_trials(where)
        with subprocess.Popen(words) as process:
            if hit == kills:
                if process.wait() != 0:
                    raise RuntimeError("the last run ended with an error")
                return hit
            while count_trials(where) < done + 1 and process.poll() is None:
                time.sleep(0.2)
            time.sleep(rng.uniform(0, 0.3))
            if process.poll() is not None:
                return hit
            os.kill(process.pid, signal.SIGKILL)
            hit += 1


def seconds_per_stem(where: Path) -> float:
    """Return the mean time from a robot's visit to its next, but for those after which it waited or charged [s]."""
    times: dict[str, list[datetime]] = {}
    for visit in read_trials(where):
        times.setdefault(visit.robot, []).append(visit.time)
    gaps = [(b - a).total_seconds() for of in times.values() for a, b in pairwise(sorted(of))]
    return float(np.mean([gap for gap in gaps if gap < WAITED]))


def robots_per_ha(shift: Shift, seconds: float) -> float:
    """Return how many robots visit a hectare every `days` days, with time to charge."""
    robot, hours = Robot("any"), shift.hours[1] - shift.hours[0]
    return STEMS_HA / shift.days * seconds * (1 + robot.charge / robot.battery) / (hours * 3600)


def main() -> None:
    """Run the shift, check its books, write metrics."""
    own = {
        "--stems": (1000, "of the house"), "--robots": (3, "of the shift"), "--kills": (20, "of its program"),
        "--stops": (0.001, "probability that a robot stops for good at a stem"),
        "--run": (int, "only run this shift"), "--history": (Path, "where it is"),
    }  # fmt: skip
    args = options(__doc__, quick="120 stems, 2 kills", seed=(0, "of outcomes, times and kills"), own=own)
    drawn_from = worked()
    if args.run:
        run_shift(args.run, drawn_work(drawn_from, args.seed, args.stops, slow=0.002), args.history, simulated=True)
        return
    stems, kills = (120, 2) if args.quick else (args.stems, args.kills)
    with tempfile.TemporaryDirectory() as folder:
        where = Path(folder) / "history.sqlite"
        record_house(built_house(stems, 4), where)
        shift = asked_shift(args.robots)
        number = begin_shift(shift, where)
        hit = run_killed(number, where, args.seed, args.stops, kills)
        found, visits, gap = read_shift(number, where), count_trials(where), seconds_per_stem(where)
    by = {state: [s for s in found if s.state == state] for state in ("visited", "left", "waiting", "working")}
    numbers = [s.visit for s in found if s.visit is not None]
    reasons = {s.reason for s in by["left"]}
    metrics = {
        "stems": len(found), "visited": len(by["visited"]), "left": len(by["left"]),
        "unaccounted": len(by["waiting"]) + len(by["working"]) + sum(s.reason is None for s in found),
        "kills": hit, "visits": visits, "doubled": len(numbers) - len(set(numbers)),
        "lost": sum(s.visit is None for s in by["visited"]),
        "trials": len(drawn_from), "at_a_stem_s": float(np.mean([visit.seconds for visit in drawn_from])),
        "seconds_per_stem": gap,
        "robots_per_ha": robots_per_ha(shift, gap),
    }  # fmt: skip
    words = {
        "stems": "stems of the house", "visited": "visited", "left": "left, each with its reason",
        "unaccounted": "unaccounted for", "kills": "kills of the program", "visits": "visits recorded",
        "doubled": "doubled", "lost": "lost", "trials": "visits carried out in rows, which were drawn from",
        "at_a_stem_s": "at a stem, mean of these (s)",
        "seconds_per_stem": "from stem to stem, entering rows included (s)",
        "robots_per_ha": "robots a hectare, by these times and charging",
    }  # fmt: skip
    finish(args, metrics, measured(metrics, words), "Left because: " + "; ".join(sorted(map(str, reasons))) + ".")


if __name__ == "__main__":
    main()
