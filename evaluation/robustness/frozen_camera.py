"""Does a watched shake harm the plant when what the camera shows is not so?

    python -m evaluation.robustness.frozen_camera --plants 40 --jobs 2

The real `Escalation` shakes made-up plants of which it is known what any shake does
(tests/support/made_foresight.py). What it is told of each look is falsified from some look on: a picture that stands
still, a tracker that sits on what stands still, times that are late, another plant. Beside each lie stands the healthy
camera. How stiff the arm's joints are is not known; they are as is believed. A plant is one of those that are
believed, or SOFT times softer than it: then a shake that is raised because nothing seems to move breaks it.

A lie harms a plant where the largest true load of any step passes what nineteen of twenty organs bear, and is larger
than with the healthy camera: what that raises it to is worth its cost (docs/shake.md).
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from rich.table import Table

sys.path.append(str(Path(__file__).parents[2] / "tests" / "support"))
from made_foresight import FLOWERS, POINTS, TONES, World, made_foresight, made_plan

from anther.core.geometry import ComplexArray
from anther.pollination import escalation
from anther.pollination.response.points import Swings
from evaluation.harness import finish, in_processes, options
from evaluation.tables import markdown

NOISE = 3e-5  # m, of what is seen
SPRINGS = 0.15  # ln of how much more an arm's grip does at 6 Hz whose joints are a standard deviation softer
PLANNED, REACH = 0.002, 0.03  # m, at every tone: what the model allows, and what the actuator can do
FIRST_MEMBER, DRAWN = 3, 20  # the truth is one of so many members of the belief
OWN = np.arange(FLOWERS + POINTS) < FLOWERS

Lie = Callable[[list[Swings], np.ndarray], ComplexArray]
"""What is told: all true looks so far, the last one too, and its tones (K,) [Hz] -> phasors (F + P, K, 3)."""


def scaled(share: float, rows: np.ndarray = OWN | True) -> Lie:
    """Return the lie that some of the points move by a share of what they do."""
    return lambda looks, _: np.where(rows[:, None, None], share, 1.0) * looks[-1].phasors


def late(looks: list[Swings], tones: np.ndarray) -> ComplexArray:
    """Return what was seen with times that are 1 s late."""
    return looks[-1].phasors * np.exp(-2j * np.pi * tones)[:, None]


def before(looks: list[Swings], _: np.ndarray) -> ComplexArray:
    """Return what the look before showed, if it was one at as many tones."""
    last, now = looks[-2].phasors, looks[-1].phasors
    return last if last.shape == now.shape else now


def other(looks: list[Swings], _: np.ndarray) -> ComplexArray:
    """Return motion as large at any phase: of another plant."""
    seen = looks[-1].phasors
    return np.abs(seen) * np.exp(2j * np.pi * np.random.default_rng(len(looks)).random(seen.shape))


TRUE = scaled(1.0)
LIES: dict[str, tuple[Lie, tuple[int, ...]]] = {
    "healthy": (TRUE, (0,)),
    "the picture stands still": (scaled(0.0), (0, 1, 2, 3, 4)),
    "flowers stand still": (scaled(0.0, OWN), (0, 2)),
    "flowers move by 0.15": (scaled(0.15, OWN), (0,)),
    "all but flowers stand still": (scaled(0.0, ~OWN), (0,)),
    "all moves by a tenth": (scaled(0.1), (0,)),
    "1 s late": (late, (0,)),
    "the look before": (before, (1,)),
    "another plant": (other, (0,)),
    "all moves by half": (scaled(0.5), (0,)),
}
"""What the camera shows, and from which look on."""
MORE = 1.13
"""Amplitudes are weighed in steps of 12 % (`escalation._option.Option`): a shake further by one is as far."""
HEALTHY, UNNOTICED = "healthy", "all moves by half"
"""Half of what a plant does that is three times softer is what one would do that is half again as soft as believed."""


@dataclass
class Lying(World):
    """A world whose camera lies from a look on."""

    lie: Lie = TRUE
    since: int = 0
    seen: list[Swings] = field(default_factory=list)

    def swings(self, _: Any, frames: Any, tones: np.ndarray, expected: Any = None) -> Swings:
        """Return what is told of the present piece."""
        self.seen.append(super().swings(_, frames, tones, expected))
        told = self.lie(self.seen, tones) if len(self.seen) > self.since else self.seen[-1].phasors
        return self.seen[-1]._replace(phasors=told)


class Case(NamedTuple):
    """A plant, how much softer it is than believed, and what is shown from which look on."""

    seed: int
    softer: float
    lie: str
    since: int


class Outcome(NamedTuple):
    """The largest true share of a limit, the last amplitude [m], and the flowers' largest median [m/s2]."""

    share: float
    amplitude: float
    flowers: float


def shaken(case: Case) -> Outcome:
    """Shake a plant while the camera lies."""
    foresight = made_foresight(case.seed)
    truth = case.softer * foresight.vectors[FIRST_MEMBER + case.seed % DRAWN]
    plan = made_plan((PLANNED,) * len(TONES), (REACH,) * len(TONES))
    world = Lying(foresight, truth, noise=NOISE, plan=plan, lie=LIES[case.lie][0], since=case.since, soft=SPRINGS)
    sighted = SimpleNamespace(shown=OWN | True)
    with (
        patch.object(escalation, "swings", world.swings),
        patch.object(escalation, "sight", lambda *_: sighted),
    ):
        steps = world.shaken(world.escalation()).steps
    share = flowers = 0.0
    for step in steps:
        if len(step.frequencies) > 1:
            continue
        tone, along = int(np.abs(TONES - step.frequencies[0]).argmin()), np.array(step.direction)
        limits = escalation.limits_of(world.limits, plan.press, step.frequencies[0])
        loads = world.loads(tone, along)
        share = max(share, *(step.amplitudes[0] * loads[kind] / limit for kind, limit in limits.items()))
        flowers = max(flowers, step.amplitudes[0] * float(np.median(world.flowers(tone, along))))
    return Outcome(share, steps[-1].amplitudes[0], flowers)


def report(cases: list[Case], outcomes: list[Outcome], soft: float) -> tuple[Table, dict[str, float]]:
    """Return a table, a row for each lie and look, and the metrics."""
    heads = [f"{name}, {what}" for what in ("as believed", f"{soft:g} times softer") for name in COLUMNS]
    table = markdown(["shown", "from look", *heads])
    for lie, since in [(lie, look) for lie, (_, looks) in LIES.items() for look in looks]:
        cells = []
        for softer in (1.0, soft):
            pick = [o for c, o in zip(cases, outcomes, strict=True) if c[1:] == (softer, lie, since)]
            shares, amplitudes, flowers = np.array(pick).T
            passed = f"{np.sum(shares > 1):.0f} of {len(pick)}"
            cells += [passed, f"{shares.max():.2f}", f"{1e3 * np.median(amplitudes):.1f}", f"{np.median(flowers):.0f}"]
        table.add_row(lie, str(since + 1), *cells)

    honest = {(c.seed, c.softer): o.share for c, o in zip(cases, outcomes, strict=True) if c.lie == HEALTHY}

    def those(softer: float, *lies: str) -> np.ndarray:
        return np.array([o for c, o in zip(cases, outcomes, strict=True) if c.softer == softer and c.lie in lies])

    def harmed(softer: float, *lies: str) -> float:
        some = [(c, o) for c, o in zip(cases, outcomes, strict=True) if c.softer == softer and c.lie in lies]
        return float(sum(o.share > max(1.0, MORE * honest[c.seed, softer]) for c, o in some))

    lies = [lie for lie in LIES if lie not in (HEALTHY, UNNOTICED)]
    metrics: dict[str, float] = {"runs": len(cases), "plants": len({case.seed for case in cases})}
    for prefix, softer in (("", 1.0), ("soft_", soft)):
        metrics[f"{prefix}passed_limit"] = harmed(softer, *lies)
        metrics[f"{prefix}half_passed_limit"] = harmed(softer, UNNOTICED)
        metrics[f"{prefix}healthy_passed_limit"] = float(np.sum(those(softer, HEALTHY)[:, 0] > 1))
        metrics[f"{prefix}largest_share"] = float(those(softer, *lies)[:, 0].max())
        metrics[f"{prefix}healthy_flowers_m_s2"] = float(np.median(those(softer, HEALTHY)[:, 2]))
    return table, metrics


COLUMNS = ("passed a limit", "largest share", "last amplitude (mm)", "flowers felt (m/s²)")


def main() -> None:
    """Shake all plants under every lie, print a table, write --json."""
    own = {"--plants": (40, "made up"), "--soft": (3.0, "how much softer than believed the soft plants are")}
    args = options(__doc__, quick="three plants", seed=(0, "of the first plant"), jobs="shakes", own=own)
    seeds = range(args.seed, args.seed + (3 if args.quick else args.plants))
    looks = [(lie, look) for lie, (_, looks) in LIES.items() for look in looks]
    cases = [Case(seed, softer, *look) for seed, softer, look in product(seeds, (1.0, args.soft), looks)]
    table, metrics = report(cases, in_processes(shaken, cases, args.jobs, "shakes"), args.soft)
    finish(args, metrics, table)


if __name__ == "__main__":
    main()
