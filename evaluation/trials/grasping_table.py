"""What `grasping.py` makes of its trials: shares with their intervals, the paired comparison, times. T trials."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from rich.console import RenderableType

from evaluation.statistics import interval, mcnemar
from evaluation.tables import markdown

Row = dict[str, Any]

PAPER = {"tomato": (6, 8), "pepper": (31, 32), "": (37, 40)}
"""Grasps that succeeded, and trials, as the paper reports them (R4)."""
PAPER_SECONDS = {"capture": 45.0, "compute": 30.0, "shake": 15.0}
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


PLANNING = {
    "plan_{}_p50_s": "planning the grasps, with the arm's reach (part of compute)",
    "plan_{}_p95_s": "the same, 95th percentile",
    "plan_cpu_{}_p95_s": "the same, processor time",
}
EFFECTS = {
    "harm_probability_mean": ("probability of harm", "{:.1%}"),
    "moved_share": ("flowers moved (5 m/s²)", "{:.1%}"),
    "flower_acceleration_median_ms2": ("median flower [m/s²]", "{:.1f}"),
    "flower_acceleration_least_ms2": ("least flower [m/s²]", "{:.1f}"),
    "pollen_freed_median": ("pollen freed", "{:.1%}"),
}
"""Keys of `grasping_table.effects`, with the head of their column and how they are written."""
GROUPS = {"40": "ten plants, 30 views", "400": "further plants, 30 views", "fast": "ten plants, `fast`"}


def report(rows: Sequence[Row], table: dict[str, float]) -> list[RenderableType]:
    """Return the successes beside the paper's, the comparison with its rule, the times, and every failure."""
    return [*successes(table), *comparison(rows, table), *times(table), *failures(rows)]


def successes(table: dict[str, float]) -> list[RenderableType]:
    """Return the table of successes."""
    lines = []
    for group, words in GROUPS.items():
        for species in ("tomato", "pepper", ""):
            name = f"{species}_success_{group}".lstrip("_")
            if name not in table:
                continue
            won, trials = PAPER[species]
            low, high = table[f"{name}_low"], table[f"{name}_high"]
            held = table[name.replace("success", "stem_held")]
            theirs = "" if group == "400" else f"{won}/{trials} = {won / trials:.1%}"
            ours = f"{table[name + '_won']:.0f}/{table[name + '_trials']:.0f} = {table[name]:.1%}"
            lines.append((words, species or "both", theirs, ours, f"{low:.1%} to {high:.1%}", f"{held:.1%}"))
            lines[-1] += effect_cells({key: table.get(name.replace("success", key)) for key in EFFECTS})
    heads = ("trials", "species", "the paper, held", "held and unharmed", "95 % interval", "main stem held")
    said = "What became of the trials; of flowers and pollen the medians over trials."
    return [said, markdown((*heads, *(words for words, _ in EFFECTS.values())), lines)]


def effect_cells(values: Mapping[str, float | None], keys: Iterable[str] = EFFECTS) -> tuple[str, ...]:
    """Return the cells below the words of `EFFECTS`, "" for what is not known."""
    known = {key: values.get(key) for key in keys}
    return tuple("" if value is None else EFFECTS[key][1].format(value) for key, value in known.items())


def comparison(rows: Sequence[Row], table: dict[str, float]) -> list[RenderableType]:
    """Return the paired comparison with the paper's rule."""
    lines = []
    for group, words in GROUPS.items():
        for measure, meaning in MEASURES.items():
            theirs = table.get(f"paper_rule_{measure}_{group}")
            if theirs is not None:
                only = [f"{table[f'{measure}_only_{who}_{group}']:.0f}" for who in ("ours", "paper_rule")]
                p = f"{table[f'{measure}_mcnemar_p_{group}']:.1g}"
                ours = f"{table[f'{measure}_{group}']:.1%}"
                lines.append((words, meaning, ours, f"{theirs:.1%}", *only, p))
    if not lines:
        return []
    kinds = Counter(row["paper"]["failure"] for row in rows if lost(row["paper"]))
    why = ", ".join(f"{kind} {count}" for kind, count in kinds.most_common())
    heads = ("trials", "measure", "Anther", "the paper's rule", "only Anther", "only the rule", "McNemar's p")
    said = f"The paper's rule from the same views, trial by trial. How it failed: {why or 'not once'}."
    return [said, markdown(heads, lines)]


def times(table: dict[str, float]) -> list[RenderableType]:
    """Return the table of times."""
    names = {"30_views": "30 views [s]", "fast": "`fast` [s]"}
    names = {name: words for name, words in names.items() if f"cycle_{name}_s" in table}
    if not names:
        return []
    lines = []
    for phase in (*PHASES, "cycle"):
        theirs = PAPER_SECONDS.get(phase, sum(PAPER_SECONDS.values()) if phase == "cycle" else None)
        ours = [f"{table[f'{phase}_{name}_s']:.1f}" for name in names]
        lines.append((phase, "" if theirs is None else f"{theirs:.0f}", *ours))
    for measure, words in PLANNING.items():
        ours = [table.get(measure.format(name)) for name in names]
        lines.append((words, "", *("" if value is None else f"{value:.2f}" for value in ours)))
    return ["Time of a trial, medians.", markdown(("phase", "the paper [s]", *names.values()), lines)]


def failures(rows: Sequence[Row]) -> list[RenderableType]:
    """Return every trial of Anther's that failed."""
    lines = [(trial(row), row["ours"]["failure"], row["ours"]["message"]) for row in rows if lost(row["ours"])]
    if not lines:
        return ["No trial failed."]
    return ["Trials that failed.", markdown(("trial", "kind", "what happened"), lines)]


def trial(row: Row) -> str:
    """Return which trial a row is of, in words."""
    return f"{row['species']} {row['seed']} from {row['viewpoint']}°, {row['arm']}, {row['preset']}"
