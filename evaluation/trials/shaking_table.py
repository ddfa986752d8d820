"""What `shaking.py` makes of its trials: effect, harm, time, by way of shaking; with 95 % intervals. P plants."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.console import RenderableType

from anther.plant.limits import MOVED
from evaluation.statistics import bootstrap, interval, median
from evaluation.tables import markdown

Row = dict[str, Any]

ACCELERATION = "true_flower_acceleration_median_ms2"


def of(rows: Sequence[Row], way: str, species: str | None = None) -> list[Row]:
    """Return the rows of a way, of one species or of both."""
    return [row for row in rows if row["way"] == way and species in (None, row["species"])]


def felt(rows: Sequence[Row]) -> np.ndarray:
    """Return (P,) the median flower's peak acceleration of each plant [m/s2]; 0 where it was not shaken."""
    return np.array([row.get(ACCELERATION) or 0.0 for row in rows])


def harmed(row: Row) -> bool:
    """Whether the plant bore more than it bears."""
    return bool(row.get("harmed"))


def within(rows: Sequence[Row], share: float) -> float:
    """Return the share of flowers in sight whose last measured acceleration is within `share` of the true one."""
    miss = [
        abs(measured / row["true_flower_acceleration_peak_ms2"][k] - 1)
        for row in rows
        if row.get("flowers") and row.get("true_flower_acceleration_peak_ms2")
        for measured, k in zip(row["flowers"]["measured"], row["flowers"]["of"], strict=True)
        if measured is not None and np.isfinite(measured)
    ]
    return float(np.mean(np.array(miss) <= share)) if miss else float("nan")


def flowers_lost(rows: Sequence[Row]) -> float:
    """Return the share of all flowers that hang on pedicels bent further than their plant's bear."""
    flowers = sum(len(row.get("true_flower_acceleration_peak_ms2") or ()) for row in rows)
    return sum(row.get("flowers_lost") or 0 for row in rows) / max(flowers, 1)


def metrics(rows: Sequence[Row]) -> dict[str, float]:
    """Return the table's numbers; `past_limit_<way>`: plants past a true limit."""
    table: dict[str, float] = {"plants": float(len({(row["species"], row["seed"]) for row in rows}))}
    for way in dict.fromkeys(row["way"] for row in rows):
        name = {"escalated": "arm"}.get(way, way)
        mine = of(rows, way)
        for species in ("tomato", "pepper"):
            values = felt(of(rows, way, species))
            low, high = bootstrap(values)
            table |= {f"{name}_{species}_ms2": float(np.median(values)) if len(values) else float("nan")}
            table |= {f"{name}_{species}_low": low, f"{name}_{species}_high": high}
        values = felt(mine)
        table[f"{name}_ms2"] = float(np.median(values))
        table[f"share_above_5_{name}"] = float(np.mean(values >= MOVED))
        table[f"past_limit_{name}"] = float(sum(map(harmed, mine)))
        table[f"flowers_lost_{name}"] = flowers_lost(mine)
        table[f"held_{name}"] = float(np.mean([bool(row.get("held")) for row in mine]))
        table[f"harm_probability_{name}"] = float(np.mean([row.get("harm_probability") or 0.0 for row in mine]))
        table[f"shaking_s_{name}"] = float(np.median([row.get("shaking_s") or 0.0 for row in mine]))
    if "share_above_5_arm" in table:
        table["share_above_5"], table["shaking_s"] = table["share_above_5_arm"], table["shaking_s_arm"]
        table["measured_within_15"] = within(of(rows, "escalated"), 0.15)
        table["over_paper"] = over_paper(rows)
    return table


def over_paper(rows: Sequence[Row]) -> float:
    """Return how many times the paper's flower acceleration a watched shake gives at equal stem strain (median)."""
    both = {(row["species"], row["seed"]): row for row in of(rows, "paper") if row.get("held")}
    ratios = [
        (row[ACCELERATION] / row["true_stem_strain"]) / (other[ACCELERATION] / other["true_stem_strain"])
        for row in of(rows, "escalated")
        if row.get("held") and (other := both.get((row["species"], row["seed"]))) and other[ACCELERATION]
    ]
    return float(np.median(ratios)) if ratios else float("nan")


def report(rows: Sequence[Row]) -> list[RenderableType]:
    """Return what the ways did to flowers and to plants, and what went wrong."""
    ways = {way: of(rows, way) for way in dict.fromkeys(row["way"] for row in rows)}
    heads = (
        "way", "plants", "median flower [m/s²] (95 % interval)", "tomatoes", "peppers", "plants at 5 m/s²",
        "flowers at 5 m/s²", "pollen freed (5 to 95 %)", "shaking [s]",
    )  # fmt: skip
    flowers = markdown(heads, [(way, str(len(mine)), *map(_known, _flowers(mine))) for way, mine in ways.items()])
    heads = (
        "way", "stem held", "stem, branches [%]", "pedicels [%]", "other stalks [%]", "leaf bases [g]", "slip [mm]",
        "flowers lost", "plants harmed (95 % interval)", "probability of harm",
    )  # fmt: skip
    plants = markdown(heads, [(way, *map(_known, _plants(mine))) for way, mine in ways.items()])
    lost = [row for row in rows if not row.get("held") or harmed(row)]
    lines = [(r["way"], f"{r['species']} {r['seed']}", r.get("message")) for r in lost]
    wrong = markdown(("way", "plant", "what happened"), lines) if lines else "No trial failed."
    parts = [
        "What the flowers felt, by MuJoCo.",
        flowers,
        "What the plants bore: the largest bending strains, and the acceleration at leaf bases below 5 Hz.",
        plants,
    ]
    return [*parts, *_compared(rows), "Trials that did not hold the stem or went past what the plant bears.", wrong]


def _compared(rows: Sequence[Row]) -> list[str]:
    """Return what a watched shake gives beside the paper's, and how well it is measured."""
    ratio, right, said = over_paper(rows), within(of(rows, "escalated"), 0.15), []
    if np.isfinite(ratio):
        said.append(
            f"At equal strain of the stem a watched shake moves flowers {ratio:.1f} times as much as the paper's."
        )
    if np.isfinite(right):
        said.append(f"The camera's last measurement is within 15 % of the true peak for {right:.0%} of the flowers.")
    return said


def _known(cell: str) -> str:
    """Return a cell, or a dash where no plant was shaken."""
    return "–" if "nan" in cell else cell


def _middle(rows: Sequence[Row], key: str, factor: float = 1.0) -> float:
    return factor * median(row.get(key) for row in rows)


def _flowers(rows: Sequence[Row]) -> list[str]:
    values, (low, high) = felt(rows), bootstrap(felt(rows))
    crops = [felt([row for row in rows if row["species"] == species]) for species in ("tomato", "pepper")]
    pollen = [_middle(rows, f"pollen_freed_{which}", 100) for which in ("median", "low", "high")]
    return [
        f"{np.median(values):.1f} ({low:.1f} to {high:.1f})",
        *(f"{np.median(some):.1f}" if len(some) else "" for some in crops),
        str(int(np.sum(values >= MOVED))),
        f"{_middle(rows, 'share_above_5_ms2', 100):.0f} %",
        f"{pollen[0]:.0f} % ({pollen[1]:.0f} to {pollen[2]:.0f})",
        f"{_middle(rows, 'shaking_s'):.1f}",
    ]


def _plants(rows: Sequence[Row]) -> list[str]:
    past = sum(map(harmed, rows))
    few, many = interval(past, len(rows))
    return [
        str(sum(bool(row.get("held")) for row in rows)),
        *(f"{_middle(rows, f'true_{kind}_strain', 100):.2f}" for kind in ("stem", "pedicel", "base")),
        f"{_middle(rows, 'true_leaf_acceleration_ms2', 1 / 9.81):.2f}",
        f"{_middle(rows, 'true_slip_m', 1000):.2f}",
        f"{flowers_lost(rows):.1%}",
        f"{past} ({100 * few:.0f} to {100 * many:.0f} %)",
        f"{100 * float(np.mean([row.get('harm_probability') or 0.0 for row in rows])):.1f} %",
    ]
