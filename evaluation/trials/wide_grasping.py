"""Grasping under the wide truth: whole trials, and what each assumption of the nominal one is worth to them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.console import RenderableType

from evaluation.harness import Row, by_turns
from evaluation.statistics import interval
from evaluation.tables import by_part
from evaluation.trials.grasping import VIEWPOINTS
from evaluation.trials.grasping_table import effects, told_effects
from evaluation.trials.grasping_trial import Case

FIRST = 8000
"""Plants from this seed on are in no other table."""
GROUPS = ("stiffness", "wind", "pads", "arm", "camera poses", "leaf mass", "pot", "drag")
"""What can matter to a grasp; tried one at a time."""


def cases(trials: int, seed: int, preset: str, truth: str) -> list[Case]:
    """Return so many trials: plants of both species by turns, each from four sides."""
    plants = by_turns(-(-trials // len(VIEWPOINTS)), FIRST + seed)
    return [Case(*plant, side, preset, truth) for plant in plants for side in VIEWPOINTS][:trials]


def metrics(rows: Sequence[Row]) -> dict[str, float]:
    """Return what some trials did: share held and unharmed with its 95 % interval, held, and `effects`."""
    ours = [row["ours"] for row in rows]
    won = [bool(one["success"]) for one in ours]
    low, high = interval(sum(won), len(won))
    held = float(np.mean([bool(one.get("held")) for one in ours]))
    return {"success": float(np.mean(won)), "success_low": low, "success_high": high, "held": held} | effects(ours)


def told(metrics: dict[str, float], rows: Sequence[Row]) -> list[RenderableType]:
    """Return the table of the trials with everything drawn."""
    numbers = {
        "held and unharmed": "success:.1%",
        "95 % interval": "success_low:.1% to success_high:.1%",
        "held": "held:.1%",
    }
    said = "Whole trials with everything drawn; of flowers and pollen the medians over trials."
    return [said, by_part(metrics, "trials", {"": str(len(rows))}, numbers | told_effects("{}"))]
