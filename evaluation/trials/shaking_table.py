"""What `shaking.py` makes of its trials: effect, harm, worth, time, by way of shaking; with 95 % intervals. P plants.

Keys of the worth of shakes (`anther.sim.judge.net_fruit`), of each way: net_fruit_<way>, its mean over plants;
net_fruit_<way>_<measure> by another measure of motion that frees pollen, "drawn" for the mean over all;
oracle_share_<way>, net fruit over the oracle's on the same plants (a ratio of sums); regret_<way>_<measure>, by how
much less it is; regret_<way>, the largest of them; bent_<way>, plants with a stem, fork or base that stays bent;
robot_s_<way>, what the robot's views, approach, shake and retreat take; flowers_probably_lost_<way>, the share of the
flowers that are lost on average over what plants may bear. joints_error, how far off the true stiffness of the arm's
joints is from what a watched shake finds, in standard deviations of what is believed before (median); joints_outside,
how often it is outside of what is then believed of nine in ten.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.console import RenderableType

from anther.core import Array
from anther.plant.limits import MOVED
from anther.sim.judge import net_fruit
from anther.sim.truth import TOLERANCE
from evaluation.harness import Row
from evaluation.statistics import bootstrap, interval, median
from evaluation.tables import by_part, markdown
from evaluation.trials.oracle import ACCELERATIONS, ACTUATORS, MEASURES

ACCELERATION = "true_flower_acceleration_median_ms2"
ROBOT_SECONDS = ("simulated_capture_seconds", "simulated_execution_seconds")
"""Of a visit, without the thought between [s]."""
STALKS = {"pedicel": "true_pedicel_strains", "base": "true_peduncle_strains"}
"""Kind of stalk that a flower hangs on -> the key of each flower's bending strain."""
NAMES = {"escalated": "arm"}
"""What the keys call a way."""
MEDIANS = {
    "flowers_above_5": "share_above_5_ms2",
    "stem_strain": "true_stem_strain",
    "pedicel_strain": "true_pedicel_strain",
    "base_strain": "true_base_strain",
    "leaf_ms2": "true_leaf_acceleration_ms2",
}
POLLEN = {"": "pollen_freed_median", "_low": "pollen_freed_low", "_high": "pollen_freed_high"}
"""Beginning or end of a key -> what of a row it is the median of."""
MAIN = "acceleration"
"""The measure of motion by which worth is told, where no other is named."""


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
        abs(measured / row[ACCELERATIONS][k] - 1)
        for row in rows
        if row.get("flowers") and row.get(ACCELERATIONS)
        for measured, k in zip(row["flowers"]["measured"], row["flowers"]["of"], strict=True)
        if measured is not None and np.isfinite(measured)
    ]
    return float(np.mean(np.array(miss) <= share)) if miss else float("nan")


def flowers_lost(rows: Sequence[Row]) -> float:
    """Return the share of all flowers that hang on stalks bent further than their plant's bear."""
    flowers = sum(len(row.get(ACCELERATIONS) or ()) for row in rows)
    return sum(row.get("flowers_lost") or 0 for row in rows) / max(flowers, 1)


def probably_lost(rows: Sequence[Row]) -> float:
    """Return the share of all flowers that such shakes lose on average over what plants bear.

    What one plant bears of a kind is one draw, so that the flowers that were lost say little: one weak plant of 28 that
    loses six is as many as all others.
    """
    shares = [
        1 - np.prod([1 - TOLERANCE[kind].share_below(row[key]) for kind, key in STALKS.items()], axis=0)
        for row in rows
        if all(row.get(key) for key in STALKS.values())
    ]
    return float(np.mean(np.concatenate(shares))) if shares else float("nan")


def bent(row: Row, *kinds: str) -> bool:
    """Whether an organ of one of these kinds of load stays bent."""
    return any(kind in str(row.get("harmed") or "").split(", ") for kind in kinds)


def net(row: Row, measure: str = MAIN) -> float:
    """Return what a shake was truly worth, by a measure of `MEASURES`; 0 of a plant that was not shaken.

    Of an oracle the most that one is worth by that measure.
    """
    if "best" in row:
        return float(row["best"][measure])
    felt = np.array(row.get(ACCELERATIONS) or (), dtype=float)
    if not len(felt):
        return 0.0
    organs = {kind: bent(row, kind) for kind in ("stem", "base", "leaf")}
    lost, slipped = (row.get("flowers_lost") or 0) / len(felt), row.get("failure") == "slipped"
    return float(net_fruit(felt, row["shake_frequency_hz"], lost, organs, slipped, MEASURES[measure]))


def beside_oracle(rows: Sequence[Row], way: str, measure: str = MAIN) -> Array:
    """Return (P, 2) the net fruit of a way and of the oracle with the same machine, on plants that have both."""
    best = {(row["species"], row["seed"]): row for row in of(rows, "oracle_motor" if way == "motor" else "oracle")}
    mine = [row for row in of(rows, way) if (row["species"], row["seed"]) in best and way not in ACTUATORS]
    pairs = [(net(row, measure), net(best[row["species"], row["seed"]], measure)) for row in mine]
    return np.array(pairs).reshape(-1, 2)


def share(pairs: Array, axis: int = 0) -> Array:
    """Return the first over the second of the sums of pairs (..., 2) along an axis."""
    mine, best = np.moveaxis(pairs.sum(axis=axis), -1, 0)
    return np.divide(mine, best, out=np.full_like(mine, np.nan), where=best > 0)


def worth(rows: Sequence[Row], way: str, name: str) -> dict[str, float]:
    """Return the numbers of what the shakes of a way were worth, under its name."""
    mine = of(rows, way)
    values = np.array([net(row) for row in mine])
    low, high = bootstrap(values, np.mean)
    table = {f"net_fruit_{name}": float(values.mean()), f"net_fruit_{name}_low": low, f"net_fruit_{name}_high": high}
    table |= {f"net_fruit_{name}_{m}": float(np.mean([net(row, m) for row in mine])) for m in MEASURES if m != MAIN}
    table[f"bent_{name}"] = float(sum(bent(row, "stem", "base") for row in mine))
    if len(pairs := beside_oracle(rows, way)):
        low, high = bootstrap(pairs, share)
        table |= {f"oracle_share_{name}": float(share(pairs))}
        table |= {f"oracle_share_{name}_low": low, f"oracle_share_{name}_high": high}
        regrets = {m: float(np.diff(beside_oracle(rows, way, m)).mean()) for m in MEASURES}
        table |= {f"regret_{name}_{measure}": regret for measure, regret in regrets.items()}
        table[f"regret_{name}"] = max(regrets.values())
    return table


def metrics(rows: Sequence[Row]) -> dict[str, float]:
    """Return the table's numbers; `past_limit_<way>`: plants past a true limit; medians over plants."""
    table: dict[str, float] = {"plants": float(len({(row["species"], row["seed"]) for row in rows}))}
    for way in dict.fromkeys(row["way"] for row in rows):
        name = NAMES.get(way, way)
        mine = of(rows, way)
        for species in ("tomato", "pepper"):
            values = felt(of(rows, way, species))
            low, high = bootstrap(values)
            table |= {f"{name}_{species}_ms2": float(np.median(values)) if len(values) else float("nan")}
            table |= {f"{name}_{species}_low": low, f"{name}_{species}_high": high}
        values, past = felt(mine), sum(map(harmed, mine))
        table[f"{name}_ms2"], (table[f"{name}_low"], table[f"{name}_high"]) = (
            float(np.median(values)),
            bootstrap(values),
        )
        table[f"share_above_5_{name}"] = float(np.mean(values >= MOVED))
        table |= {f"plants_{name}": float(len(mine)), f"past_limit_{name}": float(past)}
        table[f"past_share_{name}_low"], table[f"past_share_{name}_high"] = interval(past, len(mine))
        table |= {f"{key}_{name}": median(row.get(what) for row in mine) for key, what in MEDIANS.items()}
        table[f"slip_mm_{name}"] = 1000 * median(row.get("true_slip_m") for row in mine)
        table |= {f"pollen_freed_{name}{end}": median(row.get(what) for row in mine) for end, what in POLLEN.items()}
        table[f"flowers_lost_{name}"] = flowers_lost(mine)
        table[f"flowers_probably_lost_{name}"] = probably_lost(mine)
        table |= worth(rows, way, name)
        table[f"held_{name}"] = float(np.mean([bool(row.get("held")) for row in mine]))
        table[f"harm_probability_{name}"] = float(np.mean([row.get("harm_probability") or 0.0 for row in mine]))
        table[f"shaking_s_{name}"] = float(np.median([row.get("shaking_s") or 0.0 for row in mine]))
        table[f"robot_s_{name}"] = median(sum(row.get(part) or np.nan for part in ROBOT_SECONDS) for row in mine)
    if "share_above_5_arm" in table:
        whole = ("share_above_5", "shaking_s", "flowers_lost", "oracle_share")
        table |= {key: table[f"{key}_arm"] for key in whole if f"{key}_arm" in table}
        table["measured_within_15"] = within(of(rows, "escalated"), 0.15)
        if found := [(*row["joints_found"], row["joints_true"]) for row in rows if row.get("joints_found")]:
            mean, spread, true = np.array(found).T
            table["joints_error"] = float(np.median(np.abs(mean - true)))
            table["joints_outside"] = float(np.mean(np.abs(mean - true) > 1.645 * spread))
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


def report(rows: Sequence[Row], found: dict[str, float]) -> list[RenderableType]:
    """Return what the ways did to flowers and to plants, and what went wrong."""
    ways = {NAMES.get(way, way): way for way in dict.fromkeys(row["way"] for row in rows)}
    lost = [row for row in rows if "best" not in row and (not row.get("held") or harmed(row))]
    lines = [(r["way"], f"{r['species']} {r['seed']}", r.get("message")) for r in lost]
    wrong = markdown(("way", "plant", "what happened"), lines) if lines else "No trial failed."
    parts = [
        "What the flowers felt, by MuJoCo.",
        by_part(found, "way", ways, FLOWERS),
        "What the plants bore: the largest bending strains, and the acceleration at leaf bases below 5 Hz.",
        by_part(found, "way", ways, PLANTS),
        "What the shakes were worth, by the judge: pollen freed less flowers lost and organs bent, as a share of all "
        "flowers of a plant. An oracle knows the plant; it has a best shake for each measure of motion that may free "
        "pollen.",
        by_part(found, "way", ways, FRUIT),
    ]
    return [*parts, *_compared(rows), "Trials that did not hold the stem or went past what the plant bears.", wrong]


FLOWERS = {
    "plants": "plants_*:.0f",
    "median flower [m/s²] (95 % interval)": "*_ms2:.1f (*_low:.1f to *_high:.1f)",
    "tomatoes": "*_tomato_ms2:.1f",
    "peppers": "*_pepper_ms2:.1f",
    "plants at 5 m/s²": "share_above_5_*:.0%",
    "flowers at 5 m/s²": "flowers_above_5_*:.0%",
    "pollen freed (5 to 95 %)": "pollen_freed_*:.0% (pollen_freed_*_low:.0% to pollen_freed_*_high:.0%)",
    "shaking [s]": "shaking_s_*:.1f",
}
PLANTS = {
    "stem held": "held_*:.0%",
    "stem, branches": "stem_strain_*:.2%",
    "pedicels": "pedicel_strain_*:.2%",
    "other stalks": "base_strain_*:.2%",
    "leaf bases [m/s²]": "leaf_ms2_*:.1f",
    "slip [mm]": "slip_mm_*:.2f",
    "flowers lost": "flowers_lost_*:.1%",
    "plants harmed (95 % interval)": "past_limit_*:.0f (past_share_*_low:.0% to past_share_*_high:.0%)",
    "probability of harm": "harm_probability_*:.1%",
}
FRUIT = {
    "net fruit (95 % interval)": "net_fruit_*:.2f (net_fruit_*_low:.2f to net_fruit_*_high:.2f)",
    **{f"by {name}": f"net_fruit_*_{name}:.2f" for name in MEASURES if name != MAIN},
    "of the oracle's (95 % interval)": "oracle_share_*:.0% (oracle_share_*_low:.0% to oracle_share_*_high:.0%)",
    f"short of the oracle's by {', '.join(MEASURES)}": ", ".join(f"regret_*_{name}:.2f" for name in MEASURES),
    "plants with stem, fork or base bent": "bent_*:.0f",
}
"""What is told of each way: heads, and numbers of `metrics`."""


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
