"""Are stems recognised after a week and after two, and is "unsure" as unsure as it says? Simulated rows, drawn wide.

    python -m evaluation.house.row_map --sides 40

Each side is passed and mapped, passed again after a week, and after two: by a map that saw the week between, and by one
that did not. A stem is right if the map finds it more probable than anything else, and sure with `anther.history.SURE`.
The rows are drawn by other rules than the map supposes (`evaluation.house.simulated_house`). A side is then passed as
if it were another row.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from anther.core import InputError
from anther.history import SURE, House, Row, Side, record_house, record_pass
from evaluation.harness import finish, options, progress
from evaluation.house.simulated_house import SimulatedSide
from evaluation.statistics import reliability
from evaluation.tables import markdown, percent


class Judged(NamedTuple):
    """One hook of a pass: which week, whether its stem was mapped, whether what is claimed is right, and how surely."""

    week: str
    known: bool
    right: bool
    probability: float


def judged_side(rng: np.random.Generator, where: Path) -> Iterator[Judged]:
    """Yield what a map says of every hook of a side after one and two weeks."""
    side = SimulatedSide(rng)
    rows = tuple(Row(name, Side(side.posts), None) for name in ("weekly", "later"))
    record_house(House("house", "tomato", rows), where)
    labels: dict[str, dict[str, int]] = {"weekly": {}, "later": {}}
    for week in range(3):
        seen, who = side.passed("house", "weekly")
        for row in ("weekly", "later") if week != 1 else ("weekly",):
            again = replace(seen, row=row)
            known, name = set(labels[row].values()), "week1" if week == 1 else f"week2_{row}"
            try:
                found = record_pass(again, where)
            except InputError:  # the map takes the row for another one: no stem is named
                yield from (Judged(name, bool(truth in known), False, 0.0) for truth in who)
                continue
            for plant, new, p, truth in zip(found.plants, found.new, found.probability, who, strict=True):
                right = truth not in known if new else labels[row].get(plant) == truth
                if week:
                    yield Judged(name, bool(truth in known), right, p)
            labels[row] |= {label: int(t) for label, new, t in zip(found.plants, found.new, who, strict=True) if new}
        side.grow()


def refused(rng: np.random.Generator, where: Path) -> bool:
    """Whether a pass along another row of the same posts is refused."""
    sides = SimulatedSide(rng, (20, 21)), SimulatedSide(rng, (20, 21))
    posts = sides[1].posts | sides[0].posts
    record_house(House("other", "tomato", (Row("1", Side(posts), None),)), where)
    record_pass(sides[0].passed("other", "1")[0], where)
    sides[1].grow()
    try:
        record_pass(sides[1].passed("other", "1")[0], where)
    except InputError:
        return True
    return False


def metrics_of(rows: list[Judged]) -> dict[str, float]:
    """Return the shares recognised, confused and unsure, and how well probabilities are calibrated."""
    found: dict[str, float] = {}
    for week, key in (("week1", "week1"), ("week2_later", "week2"), ("week2_weekly", "week2_weekly")):
        of = [row for row in rows if row.week == week]
        stems = [row for row in of if row.known]
        found[f"hooks_{key}"] = len(of)
        found[f"same_stem_{key}"] = float(np.mean([r.right for r in stems]))
        found[f"sure_{key}"] = float(np.mean([r.right and r.probability >= SURE for r in stems]))
        found[f"wrong_and_sure_{key}"] = float(np.mean([not r.right and r.probability >= SURE for r in of]))
        found[f"unsure_{key}"] = float(np.mean([r.probability < SURE for r in of]))
    found["hooks_refused"] = sum(row.probability == 0 for row in rows)
    rows = [row for row in rows if row.probability > 0]
    unsure = [row for row in rows if row.probability < SURE]
    claimed, right = (np.array([getattr(r, name) for r in rows]) for name in ("probability", "right"))
    found["unsure_hooks"] = len(unsure)
    found["unsure_claimed"] = float(np.mean([row.probability for row in unsure]))
    found["unsure_right"] = float(np.mean([row.right for row in unsure]))
    found["sure_claimed"] = float(claimed[claimed >= SURE].mean())
    found["sure_right"] = float(right[claimed >= SURE].mean())
    return found


def main() -> None:
    """Draw sides, judge their maps, print tables, write metrics."""
    own = {"--sides": (40, "of rows, drawn"), "--others": (10, "passes along another row")}
    args = options(__doc__, quick="6 sides, 2 others", seed=(0, "of sides"), own=own)
    sides, others = (6, 2) if args.quick else (args.sides, args.others)
    rows: list[Judged] = []
    with tempfile.TemporaryDirectory() as folder:
        for k in progress(range(sides), "sides"):
            rows += judged_side(np.random.default_rng([args.seed, k]), Path(folder) / f"{k}.sqlite")
        where = [Path(folder) / f"other {k}.sqlite" for k in range(others)]
        shut = [refused(np.random.default_rng([args.seed, 1000 + k]), path) for k, path in enumerate(where)]
    metrics = {"sides": sides, **metrics_of(rows), "others": others, "others_refused": sum(shut)}
    words = {"week1": "one week", "week2": "two weeks, none seen between", "week2_weekly": "two weeks, passed weekly"}
    shares = ("same_stem", "sure", "unsure", "wrong_and_sure")
    lines = [
        (words[key], f"{metrics[f'hooks_{key}']:,}", *(percent(metrics[f"{share}_{key}"], 2) for share in shares))
        for key in words
    ]
    table = np.atleast_2d(reliability(*(np.array([getattr(r, n) for r in rows]) for n in ("probability", "right"))))
    bins = [(f"{claimed:.2f}", f"{right:.2f}", f"{count:.0f}") for claimed, right, count in table if count]
    finish(
        args,
        metrics,
        markdown(("after", "hooks", "stem right", "right and sure", "unsure", "wrong and sure"), lines),
        markdown(("claimed", "right", "hooks"), bins),
        f"Passes along another row that were refused: {sum(shut)} of {others}.",
    )


if __name__ == "__main__":
    main()
