"""What many plants say of the predictions, and which assumption would ruin them. Rows are those of `wide_plant.py`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from rich.console import RenderableType
from rich.table import Table

from anther.core import Array
from evaluation.harness import CROPS, Row
from evaluation.prediction.wide_plant import HELD, KINDS, SLOW, TONES
from evaluation.statistics import mean
from evaluation.tables import by_part

BAND = {"": slice(None, len(SLOW)), "_fast": slice(len(SLOW), None)}
"""Frequencies of the paper (0.7-1.9 Hz), and those at which an arm moves flowers (3-8 Hz)."""


def metrics(rows: Sequence[Row]) -> dict[str, float]:
    """Return what these plants, all under one kind of truth, say.

    Keys: error_held_seen, median error at the held grip and a tone of the probe of flowers that the camera measured,
    when the shake is raised; error_held_hidden, of those it did not; error_other_<crop>, median error at other grips
    at the paper's frequencies after the probe, _fast at 3-8 Hz; error_before_<crop>, the same before the probe, all
    grips; coverage_<what>, share of the truth inside the stated 90 % interval: held, amplitude (after the probe, all
    grips and frequencies), before, and the strains; coverage_90, the mean over held, amplitude and the strains, of
    which acceleration has the same as amplitude, being it times a known number; bias_ and spread_<strain>, of
    ln(true over expected).
    """
    whole = [row for row in rows if "lost" not in row and len(row["true"][0][0])]
    out = {"plants": float(len(whole)), "plants_lost": float(sum("lost" in row for row in rows))}
    if not whole:
        return out
    out["measured_share"] = mean(np.mean(tone["measured"]) for row in whole for tone in row["held"])
    for name, measured in (("seen", True), ("hidden", False)):
        out[f"error_held_{name}"] = _median(
            _error(tone["said"], tone["true"])[np.array(tone["measured"]) == measured]
            for row in whole
            for tone in row["held"]
        )
    for crop in ("tomato", "pepper"):
        mine = [row for row in whole if row["species"] == crop]
        for band, where in BAND.items():
            out[f"error_other_{crop}{band}"] = _median(
                np.delete(_error(_middle(row["after"]), row["true"]), HELD, axis=0)[:, where] for row in mine
            )
            out[f"error_before_{crop}{band}"] = _median(
                _error(_middle(row["before"]), row["true"])[:, where] for row in mine
            )
    within: dict[str, Callable[[Row], Any]] = {
        "before": lambda row: _inside(row["before"], row["true"]),
        "amplitude": lambda row: _inside(row["after"], row["true"]),
    }
    for kind in KINDS:
        within[kind] = lambda row, kind=kind: _inside(row["loads after"][kind], row["loads"][kind])
    for name, inside in within.items():
        out[f"coverage_{name}"] = mean(np.concatenate([inside(row).ravel() for row in whole]))
    held = [
        _inside(h["interval"], h["true"])[np.array(h["measured"], dtype=bool)] for row in whole for h in row["held"]
    ]
    out["coverage_held"] = mean(np.concatenate(held)) if held else np.nan
    out["coverage_90"] = mean(out[f"coverage_{name}"] for name in ("held", "amplitude", *KINDS))
    for kind in KINDS:
        logs = np.concatenate([_log(row["loads"][kind], _middle(row["loads after"][kind])) for row in whole])
        out |= {f"bias_{kind}": float(np.median(logs)), f"spread_{kind}": float(np.std(logs))}
    logs = np.concatenate([_log(row["true"], _middle(row["after"])) for row in whole])
    return out | {"bias_amplitude": float(np.median(logs)), "spread_amplitude": float(np.std(logs))}


WHERE = {
    "held_seen": "held grip, flowers that the camera measured, 1.5 times the measured shake",
    "held_hidden": "held grip, flowers that it did not measure",
    "other_{}": "two other grips, 0.7 to 1.9 Hz",
    "other_{}_fast": "two other grips, 4 and 7 Hz",
    "before_{}": "all grips, nothing measured, 0.7 to 1.9 Hz",
    "before_{}_fast": "all grips, nothing measured, 4 and 7 Hz",
}
QUANTITIES = {
    "held": "flowers at the held grip",
    "amplitude": "flowers at all grips",
    "stem_strain": "strain of the stem",
    "joint_strain": "strain of pedicels",
    "base_strain": "strain where branches and leaves leave the stem",
}


def told(table: dict[str, float]) -> list[RenderableType]:
    """Return errors and intervals of predictions with everything drawn."""
    errors = {
        where.format(crop): words + (f", {crop}" if "{}" in where else "")
        for where, words in WHERE.items()
        for crop in (CROPS if "{}" in where else CROPS[:1])
    }
    over = {f"over_{key}": float(np.exp(table[f"bias_{key}"])) for key in QUANTITIES if f"bias_{key}" in table}
    intervals = {
        "truths inside their 90 % interval": "coverage_*:.1%",
        "true over expected, median": "over_*:.2f",
        "spread of its ln": "spread_*:.2f",
    }
    plants, lost = table["plants"], table["plants_lost"]
    said = f"Plants predicted: {plants:.0f}, without an answer: {lost:.0f}; probed at {tones()}."
    if not plants:
        return [said]
    return [
        f"{said} Median error of a flower's amplitude.",
        by_part(table, "which flowers", errors, {"error": "error_*:.1%"}),
        "The intervals.",
        by_part(table | over, "what is predicted", QUANTITIES, intervals),
    ]


def ranking(by_truth: dict[str, dict[str, float]], names: Mapping[str, str]) -> Table:
    """Return some metrics by truth: nominal, everything drawn, then each group alone, the worst first."""
    first = [name for name in ("nominal", "wide") if name in by_truth]
    worst = next(iter(names))
    rest = sorted(set(by_truth) - set(first), key=lambda name: -by_truth[name].get(worst, 0.0))
    flat = {
        f"{key}__{truth.replace(' ', '_')}": value
        for truth, metrics in by_truth.items()
        for key, value in metrics.items()
    }
    titles = {"nominal": "nothing", "wide": "**everything**"}
    truths = {name.replace(" ", "_"): titles.get(name, name) for name in (*first, *rest)}
    return by_part(flat, "only this is not nominal", truths, {words: f"{key}__*:.3g" for key, words in names.items()})


def tones() -> str:
    """Return the tones of the probe in words."""
    return ", ".join(f"{tone:g}" for tone in TONES) + " Hz"


def _middle(quantiles: Any) -> Array:
    return np.asarray(quantiles, dtype=float)[..., 1]


def _error(said: Any, true: Any) -> Array:
    return np.abs(np.asarray(said, dtype=float) / np.asarray(true, dtype=float) - 1)


def _inside(interval: Any, true: Any) -> Any:
    low, high = np.asarray(interval, dtype=float)[..., 0], np.asarray(interval, dtype=float)[..., -1]
    return (np.asarray(true) >= low) & (np.asarray(true) <= high)


def _log(true: Any, said: Any) -> Array:
    return np.log(np.asarray(true, dtype=float) / np.asarray(said, dtype=float)).ravel()


def _median(parts: Iterable[Array]) -> float:
    found = [part.ravel() for part in parts]
    whole = np.concatenate(found) if found else np.zeros(0)
    return float(np.median(whole)) if len(whole) else np.nan
