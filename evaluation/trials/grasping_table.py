"""What `grasping.py` makes of its trials: shares with their intervals, the paired comparison, times. T trials."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from rich.console import RenderableType

from evaluation.harness import Row
from evaluation.statistics import interval, mcnemar
from evaluation.tables import by_number, by_part, markdown

CROPS = {
    "tomato_": "tomato (the paper held 6/8 = 75.0 %)",
    "pepper_": "pepper (the paper held 31/32 = 96.9 %)",
    "": "both (the paper held 37/40 = 92.5 %)",
}
"""What the metrics of a crop begin with, and the paper's grasps (R4)."""
PAPER_SECONDS = {"capture_paper_s": 45.0, "compute_paper_s": 30.0, "shake_paper_s": 15.0, "cycle_paper_s": 90.0}
MEASURES = {
    "success": "held and unharmed",
    "stem_held": "main stem held",
    "axis_held": "main stem held, or a pepper's branch above the first fork",
}
"""Keys and what they mean. The judge says so. The last may be what the paper called a pepper's main stem."""
PHASES = ("capture", "compute", "reach", "shake", "retreat")


def as_counted(summary: Row) -> Row:
    """Return a trial's summary with `success` as the paper's grasps are counted: held and unharmed.

    `all_three` is what `anther trial` calls success: the flowers moved as well. Earlier summaries have no such parts.
    """
    if "held" not in summary:
        return summary
    return summary | {"success": bool(summary["held"] and summary["unharmed"]), "all_three": summary["success"]}


def effects(performed: Sequence[Row]) -> dict[str, float]:
    """Return what some trials did to their plants, by the simulator's truth; nothing of trials that were not asked.

    Keys: moved_share and all_three_share, of all trials; harm_probability_mean, of those that were judged;
    flower_acceleration_median_ms2 and _least_ms2 and pollen_freed_median, the medians of what a trial's flowers felt
    and freed, of those that shook.
    """
    asked = [one for one in performed if "flowers_moved" in one or one["failure"] == "crashed"]
    if not asked:
        return {}
    table = {"moved_share": float(np.mean([bool(one.get("flowers_moved")) for one in asked]))}
    table["all_three_share"] = float(np.mean([bool(one.get("all_three")) for one in asked]))
    harm = [one["harm_probability"] for one in asked if one.get("harm_probability") is not None]
    table |= {"harm_probability_mean": float(np.mean(harm))} if harm else {}
    felt = {
        f"flower_acceleration_{which}_ms2": f"true_flower_acceleration_{which}_ms2" for which in ("median", "least")
    }
    for name, key in (felt | {"pollen_freed_median": "pollen_freed_median"}).items():
        values = [one[key] for one in asked if one.get(key) is not None]
        table |= {name: float(np.median(values))} if values else {}
    return table


def shaken(row: Row) -> bool:
    """Whether the trial got as far as the shake."""
    return "shake_s" in row["ours"]


def seconds(row: Row) -> dict[str, float]:
    """Return the time of each phase [s]: compute by this machine's clock, the others by the robot's.

    Of the reach only what comes after the computing counts: the arm is on its way to the first grasp meanwhile.
    """
    phases = {"capture": row["capture_s"], "compute": row["compute_s"]}
    phases |= {name: row["ours"][f"{name}_s"] for name in ("reach", "shake", "retreat")}
    return phases | {"reach": phases["reach"] - row.get("overlap_s", 0.0)}


def metrics(rows: Sequence[Row]) -> dict[str, float]:
    """Return the flat table; `_40`: the paper's ten plants, `_400`: further ones, `_fast`: the ten by that preset."""
    full = [row for row in rows if row["preset"] == "full"]
    parts = {
        "40": [row for row in full if row["seed"] < 1000],
        "400": [row for row in full if row["seed"] >= 1000],
        "fast": [row for row in rows if row["preset"] == "fast"],
    }
    table: dict[str, float] = {}
    for name, members in parts.items():
        if members:
            table |= of_part(name, members)
    for name, part in (("30_views", "40"), ("fast", "fast")):  # further plants are tried several at a time
        table |= cycle(name, parts[part]) | planning(name, parts[part])
    return table


def of_part(name: str, rows: Sequence[Row]) -> dict[str, float]:
    """Return successes, failures and the comparison with the paper's rule of one group of trials."""
    table: dict[str, float] = {f"trials_{name}": len(rows)}
    for species in ("", "tomato", "pepper"):
        some = [row for row in rows if row["species"].startswith(species)]
        if not some:
            continue
        prefix = f"{species}_".lstrip("_")
        won = sum(row["ours"]["success"] for row in some)
        table |= {f"{prefix}success_{name}_won": won, f"{prefix}success_{name}_trials": len(some)}
        table[f"{prefix}success_{name}"] = won / len(some)
        table[f"{prefix}success_{name}_low"], table[f"{prefix}success_{name}_high"] = interval(won, len(some))
        for measure in list(MEASURES)[1:]:
            table[f"{prefix}{measure}_{name}"] = float(np.mean([row["ours"].get(measure, False) for row in some]))
        table |= {f"{prefix}{key}_{name}": value for key, value in effects([row["ours"] for row in some]).items()}
        pairs = [row for row in some if row["paper"] is not None]
        if pairs:
            table |= compared(prefix, name, pairs)
    for kind, count in Counter(row["ours"]["failure"] for row in rows if not row["ours"]["success"]).items():
        table[f"failed_{name}_{kind}"] = count
    for kind, count in Counter(row["paper"]["failure"] for row in rows if lost(row["paper"])).items():
        table[f"paper_rule_failed_{name}_{kind}"] = count
    plants = {(row["species"], row["seed"]) for row in rows}
    bad = {(row["species"], row["seed"]) for row in rows if not row["ours"]["success"]}
    return table | {f"plants_{name}": len(plants), f"plants_all_{name}": len(plants - bad)}


def lost(performed: Row | None) -> bool:
    """Whether something was tried and did not succeed."""
    return performed is not None and not performed["success"]


def compared(prefix: str, name: str, pairs: Sequence[Row]) -> dict[str, float]:
    """Return how the paper's rule did from the same captures, and McNemar's test, by either measure of success."""
    table: dict[str, float] = {}
    for measure in MEASURES:
        ours, theirs = ([bool(row[who].get(measure)) for row in pairs] for who in ("ours", "paper"))
        only, other, p = mcnemar(ours, theirs)
        table[f"{prefix}paper_rule_{measure}_{name}"] = float(np.mean(theirs))
        table |= {f"{prefix}{measure}_only_ours_{name}": only, f"{prefix}{measure}_only_paper_rule_{name}": other}
        table[f"{prefix}{measure}_mcnemar_p_{name}"] = p
    return table


def planning(preset: str, rows: Sequence[Row]) -> dict[str, float]:
    """Return how long the grasp stage took with the arm's reach [s]; the first trial of a process is left out."""
    warm = [row for row in rows if not row["first"] and row.get("plan_s") is not None]
    if not warm:
        return {}
    table = {}
    for name in ("plan", "plan_cpu"):
        values = [row[f"{name}_s"] for row in warm]
        for p in (50, 95):
            table[f"{name}_{preset}_p{p}_s"] = float(np.quantile(values, p / 100))
    return table


def cycle(name: str, rows: Sequence[Row]) -> dict[str, float]:
    """Return the median time of each phase and of their sum without the retreat [s], over warm trials that shook."""
    times = [seconds(row) for row in rows if not row["first"] and shaken(row)]
    if not times:
        return {}
    phases = {phase: np.array([t[phase] for t in times]) for phase in PHASES}
    total = np.sum([phases[phase] for phase in PHASES[:-1]], axis=0)
    table = {f"{phase}_{name}_s": float(np.median(values)) for phase, values in phases.items()}
    return table | {f"cycle_{name}_s": float(np.median(total)), f"cycle_{name}_p95_s": float(np.quantile(total, 0.95))}


EFFECTS = {
    "harm_probability_mean": ("probability of harm", ".1%"),
    "moved_share": ("flowers moved (5 m/s²)", ".1%"),
    "flower_acceleration_median_ms2": ("median flower [m/s²]", ".1f"),
    "flower_acceleration_least_ms2": ("least flower [m/s²]", ".1f"),
    "pollen_freed_median": ("pollen freed", ".1%"),
}
"""Keys of `effects`, with the head of their column and how they are written."""
GROUPS = {"40": "ten plants, 30 views", "400": "further plants, 30 views", "fast": "ten plants, `fast`"}


def told_effects(name: str) -> dict[str, str]:
    """Return the numbers of a table (`tables.by_part`) for `effects`; a name's pattern has {} for the key."""
    return {words: f"{name.format(key)}:{form}" for key, (words, form) in EFFECTS.items()}


def report(rows: Sequence[Row], table: dict[str, float]) -> list[RenderableType]:
    """Return the successes beside the paper's, the comparison with its rule, the times, and every failure."""
    return [*successes(table), *comparison(rows, table), *times(table), *failures(rows)]


def successes(table: dict[str, float]) -> list[RenderableType]:
    """Return a table of successes of each group."""
    parts: list[RenderableType] = ["What became of the trials; of flowers and pollen the medians over trials."]
    for group, words in GROUPS.items():
        numbers = {
            "held and unharmed": f"*success_{group}_won:.0f/*success_{group}_trials:.0f = *success_{group}:.1%",
            "95 % interval": f"*success_{group}_low:.1% to *success_{group}_high:.1%",
            "main stem held": f"*stem_held_{group}:.1%",
        }
        if f"success_{group}" in table:
            parts.append(by_part(table, words, CROPS, numbers | told_effects(f"*{{}}_{group}")))
    return parts


def comparison(rows: Sequence[Row], table: dict[str, float]) -> list[RenderableType]:
    """Return the paired comparison with the paper's rule, of each group."""
    kinds = Counter(row["paper"]["failure"] for row in rows if lost(row["paper"]))
    why = ", ".join(f"{kind} {count}" for kind, count in kinds.most_common())
    parts: list[RenderableType] = []
    for group, words in GROUPS.items():
        numbers = {
            "Anther": f"*_{group}:.1%",
            "the paper's rule": f"paper_rule_*_{group}:.1%",
            "only Anther": f"*_only_ours_{group}:.0f",
            "only the rule": f"*_only_paper_rule_{group}:.0f",
            "McNemar's p": f"*_mcnemar_p_{group}:.1g",
        }
        if f"paper_rule_success_{group}" in table:
            parts.append(by_part(table, words, MEASURES, numbers))
    said = f"The paper's rule from the same views, trial by trial. How it failed: {why or 'not once'}."
    return [said, *parts] if parts else []


def times(table: dict[str, float]) -> list[RenderableType]:
    """Return the table of times."""
    if not any(f"cycle_{name}_s" in table for name in ("30_views", "fast")):
        return []
    names = {"paper": "the paper [s]", "30_views": "30 views [s]", "fast": "`fast` [s]"}
    numbers = {phase: f"{phase}_*_s:.1f" for phase in (*PHASES, "cycle")}
    numbers |= {
        "planning the grasps, with the arm's reach (part of compute)": "plan_*_p50_s:.2f",
        "the same, 95th percentile": "plan_*_p95_s:.2f",
        "the same, processor time": "plan_cpu_*_p95_s:.2f",
    }
    return ["Time of a trial, medians.", by_number(table | PAPER_SECONDS, "phase", names, numbers)]


def failures(rows: Sequence[Row]) -> list[RenderableType]:
    """Return every trial of Anther's that failed."""
    lines = [(trial(row), row["ours"]["failure"], row["ours"]["message"]) for row in rows if lost(row["ours"])]
    if not lines:
        return ["No trial failed."]
    return ["Trials that failed.", markdown(("trial", "kind", "what happened"), lines)]


def trial(row: Row) -> str:
    """Return which trial a row is of, in words."""
    return f"{row['species']} {row['seed']} from {row['viewpoint']}°, {row['arm']}, {row['preset']}"
