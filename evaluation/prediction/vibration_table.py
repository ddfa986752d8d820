"""What vibration.py says of its plants: correlation, error and bias of every model. R shakes, F flowers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from anther.core import Array
from evaluation.harness import Row
from evaluation.prediction.vibration_plant import HEIGHTS, MIDDLE
from evaluation.statistics import correlation
from evaluation.tables import by_part

MODELS = ("paper", "paper as scripted", "prior", "probe")
CAUSES = ("prior", "probe", "probe, every flower seen", "probe, mean", "true material", "true plant")
BANDS = {"paper": (0.0, 2.0), "fast": (2.0, 20.0), "flowers": (20.0, 100.0)}
"""[Hz]: the authors' shakes; the arm's; where flowers resonate on their pedicels."""
ENDS = {"paper": "", "fast": "_fast", "flowers": "_flowers"}
"""How the keys of a band end."""


class Score(NamedTuple):
    """How well a model says what one plant does in one band.

    Attributes:
        amplitude_r: Pearson's r over flowers, frequencies and shaking amplitudes, held at one place.
        location_r: over frequencies and the five heights, means of the flowers.
        error: mean of |predicted / true - 1| over flowers and shakes.
        median: of the same.
        bias: mean of predicted / true - 1.
    """

    amplitude_r: float
    location_r: float
    error: float
    median: float
    bias: float


class Shakes(NamedTuple):
    """The shakes of one plant in one band: height (R,), frequency (R,) [Hz], and the whole row's rows of them (R,)."""

    height: Array
    frequency: Array
    rows: NDArray[Any]


def shakes_in(row: Row, band: str) -> Shakes:
    """Return the shakes in a band."""
    low, high = BANDS[band]
    height, f = (np.array([shake[name] for shake in row["shakes"]]) for name in ("height", "frequency_hz"))
    chosen = np.flatnonzero((f >= low) & (f < high))
    return Shakes(height[chosen], f[chosen], chosen)


def score(row: Row, model: str, band: str) -> Score | None:
    """Return how well a model did on one plant; None where it has no prediction or no flower was seen."""
    shakes = shakes_in(row, band)
    if model not in row["predicted_m"] or not row["flowers"]["matched"] or not len(shakes.rows):
        return None
    true, said = np.array(row["true_m"])[shakes.rows], np.array(row["predicted_m"][model])[shakes.rows]
    ratio = said / true - 1
    held = shakes.height == HEIGHTS[MIDDLE]
    at_heights = [location(row, f) for f in np.unique(shakes.frequency)]
    by_location = [
        (np.array(row["true_m"])[k].mean(1), np.array(row["predicted_m"][model])[k].mean(1)) for k in at_heights
    ]
    every = [np.concatenate(parts) for parts in zip(*by_location, strict=True)]
    return Score(
        correlation(true[held].ravel(), said[held].ravel()),
        correlation(*every),
        float(np.abs(ratio).mean()),
        float(np.median(np.abs(ratio))),
        float(ratio.mean()),
    )


def location(row: Row, frequency: float) -> NDArray[Any]:
    """Return the rows of the five heights at one frequency, all with the same shaking amplitude."""
    shakes = row["shakes"]
    here = [k for k, shake in enumerate(shakes) if shake["frequency_hz"] == frequency]
    size = next(shakes[k]["amplitude_m"] for k in here if shakes[k]["height"] != HEIGHTS[MIDDLE])
    same = [k for k in here if shakes[k]["amplitude_m"] == size]
    return np.array(sorted(same, key=lambda k: shakes[k]["height"]))


def metrics(rows: Sequence[Row]) -> dict[str, float]:
    """Return flat means over the plants: of the paper's band under the plain names, of the others with the band's."""
    out: dict[str, float] = {"plants": len(rows), "flowers": sum(row["flowers"]["matched"] for row in rows)} | checks(
        rows
    )
    for band in BANDS:
        for model in dict.fromkeys(MODELS + CAUSES):
            scores = [s for row in rows if (s := score(row, model, band))]
            if scores:
                out |= _named(scores, model, band)
    out["paper_buckles"] = sum(row["paper_soft"] > 1 for row in rows)
    return out


def checks(rows: Sequence[Row]) -> dict[str, float]:
    """Return how steady and how linear the shakes that were stepped are, and how far the rods are from linear."""
    stepped, rods = [], []
    for row in rows:
        true, small = np.array(row["true_m"]), np.array(row["linear_m"])
        stepped += [np.abs(small[k] / true[k] - 1) for k, u in enumerate(row["unsteadiness"]) if u > 0]
        said = row["predicted_m"].get("probe, mean", ())
        rods += [np.abs(np.array(said[int(k)]) / np.array(v, dtype=float) - 1) for k, v in row["nonlinear_m"].items()]
    out: dict[str, float] = {}
    for name, parts in (("linear_truth", stepped), ("linear_rods", rods)):
        values = np.concatenate([np.zeros(0), *parts])
        values = values[np.isfinite(values)]
        if len(values):
            out |= {f"{name}_median": float(np.median(values)), f"{name}_p90": float(np.quantile(values, 0.9))}
    shaky = [u for row in rows for u in row["unsteadiness"] if u > 0]
    if shaky:
        straight = np.concatenate([_straightness(row) for row in rows])
        out |= {"unsteadiness_median": float(np.median(shaky)), "linearity_r_least": float(straight.min())}
    return out


def _straightness(row: Row) -> Array:
    """Return Pearson's r between shaking and true amplitude of each flower at each frequency that was stepped."""
    held = {
        f: [] for f, u in zip((s["frequency_hz"] for s in row["shakes"]), row["unsteadiness"], strict=True) if u > 0
    }
    for k, shake in enumerate(row["shakes"]):
        if shake["frequency_hz"] in held and shake["height"] == HEIGHTS[MIDDLE]:
            held[shake["frequency_hz"]].append(k)
    size, true = np.array([shake["amplitude_m"] for shake in row["shakes"]]), np.array(row["true_m"])
    return np.array([correlation(size[k], swing) for k in held.values() for swing in true[k].T])


def _word(model: str) -> str:
    """Return what the keys call a model."""
    word = model.replace(", ", "_").replace(" ", "_")
    return {"paper": "paper_model", "paper_as_scripted": "paper_scripts"}.get(word, word)


def _named(scores: Sequence[Score], model: str, band: str) -> dict[str, float]:
    name = f"{_word(model)}{ENDS[band]}"
    r, location_r, error, median, bias = np.array(scores).T
    return {
        f"r_{name}": float(r.mean()),
        f"r_least_{name}": float(r.min()),
        f"r_location_{name}": float(location_r.mean()),
        f"r_location_least_{name}": float(location_r.min()),
        f"error_{name}": float(error.mean()),
        f"error_median_{name}": float(median.mean()),
        f"bias_{name}": float(bias.mean()),
        f"reversed_trends_{name}": int(np.sum(location_r < 0)),
    }


WORDS = {
    "paper": "(a) the paper's model",
    "paper as scripted": "(a) as its scripts have it",
    "prior": "(b) Anther, crop prior",
    "probe": "(c) Anther, one probe shake",
    "probe, every flower seen": "(c) with every flower measured to 0.3 mm",
    "probe, mean": "(c) one model of the mean material",
    "true material": "scan, true material",
    "true plant": "true geometry and material",
}
HERTZ = {"paper": "0.7–1.9 Hz", "fast": "3–10 Hz", "flowers": "30 Hz"}


def report(found: dict[str, float]) -> list[str | Table]:
    """Return tables, each after a line that says what it shows."""
    of_models = {f"{_word(model)}{ENDS[band]}": f"{WORDS[model]}, {HERTZ[band]}" for band in BANDS for model in MODELS}
    numbers = {
        "r over amplitude": "r_*:.2f (r_least_*:.2f)",
        "r over location": "r_location_*:.2f (r_location_least_*:.2f)",
        "error": "error_*:.0% (error_median_*:.0%)",
        "bias": "bias_*:+.0%",
        "location reversed, plants": "reversed_trends_*:.0f",
    }
    errors = {HERTZ[band]: f"error_*{end}:.0% (error_median_*{end}:.0%)" for band, end in ENDS.items()}
    return [
        f"{found['plants']:.0f} plants, {found['flowers']:.0f} flowers. Means over plants; in parentheses the worst "
        "plant's r, and the median error over shakes and flowers. The paper published, of a real tomato and a real "
        "pepper: r over amplitude above 0.96, over location about 0.92 and −0.85, error 45 to 50 %, bias −45 %.",
        by_part(found, "model", of_models, numbers),
        "Where the error comes from, mean (median):",
        by_part(found, "model", {_word(model): WORDS[model] for model in CAUSES}, errors),
    ]
