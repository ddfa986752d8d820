"""What trials did, as tables: successes beside the paper's, its rule, times, failures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from rich.box import MARKDOWN
from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

from evaluation.trials.grasping_table import MEASURES, PAPER, PAPER_SECONDS, PHASES, Row, lost

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


def say(parts: Iterable[RenderableType]) -> None:
    """Print lines and tables as they are: what stands in brackets is a unit, not a style."""
    console = Console(markup=False, highlight=False, emoji=False)
    for part in parts:
        console.print(part)


def table_of(heads: Sequence[str], lines: Iterable[Sequence[object]]) -> Table:
    """Return a table that prints as Markdown."""
    table = Table(box=MARKDOWN)
    for head in heads:
        table.add_column(Text(head))
    for line in lines:
        table.add_row(*(Text(str(cell).replace("\n", " ")) for cell in line))
    return table


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
    return [said, table_of((*heads, *(words for words, _ in EFFECTS.values())), lines)]


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
    return [said, table_of(heads, lines)]


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
    return ["Time of a trial, medians.", table_of(("phase", "the paper [s]", *names.values()), lines)]


def failures(rows: Sequence[Row]) -> list[RenderableType]:
    """Return every trial of Anther's that failed."""
    lines = [(trial(row), row["ours"]["failure"], row["ours"]["message"]) for row in rows if lost(row["ours"])]
    if not lines:
        return ["No trial failed."]
    return ["Trials that failed.", table_of(("trial", "kind", "what happened"), lines)]


def trial(row: Row) -> str:
    """Return which trial a row is of, in words."""
    return f"{row['species']} {row['seed']} from {row['viewpoint']}°, {row['arm']}, {row['preset']}"
