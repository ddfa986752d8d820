"""The result of `grasping.py` in Markdown: for the console, and for the docs page between its two marks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from grasping_table import MEASURES, PAPER, PAPER_SECONDS, PHASES, Row, lost
from rich.table import Table

from anther.files import write_text

BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"
PLANNING = {
    "plan_{}_p50_s": "planning the grasps, with the arm's reach (part of compute)",
    "plan_{}_p95_s": "the same, 95th percentile",
    "plan_cpu_{}_p95_s": "the same, processor time",
}
EFFECTS = {
    "harm_probability_mean": ("harm, mean probability", "{:.1%}"),
    "moved_share": ("flowers moved", "{:.1%}"),
    "flower_acceleration_median_ms2": ("their median [m/s²]", "{:.1f}"),
    "flower_acceleration_least_ms2": ("their least [m/s²]", "{:.1f}"),
    "pollen_freed_median": ("pollen freed", "{:.1%}"),
    "all_three_share": ("held, unharmed, moved", "{:.1%}"),
}
"""Keys of `grasping_table.effects`, with the head of their column and how they are written."""
GROUPS = {"40": "ten plants, 30 views", "400": "further plants, 30 views", "fast": "ten plants, `fast`"}


def report(rows: Sequence[Row], table: dict[str, float]) -> str:
    """Return the successes beside the paper's, the comparison with its rule, the times, and every failure."""
    parts = [successes(table), comparison(rows, table), times(table), failures(rows)]
    return "\n\n".join(part for part in parts if part)


def insert(path: Path, text: str) -> None:
    """Put a text between the marks of a page."""
    page = path.read_text(encoding="utf-8")
    before, rest = page.split(BEGIN)
    write_text(path, f"{before}{BEGIN}\n\n{text}\n\n{END}{rest.split(END)[1]}")


def successes(table: dict[str, float]) -> str:
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
    heads = ("trials", "species", "the paper", "Anther, held and unharmed", "95 % interval", "main stem held")
    return rows_of((*heads, *(words for words, _ in EFFECTS.values())), lines)


def effect_cells(values: Mapping[str, float | None], keys: Iterable[str] = EFFECTS) -> tuple[str, ...]:
    """Return the cells below the words of `EFFECTS`, "" for what is not known."""
    known = {key: values.get(key) for key in keys}
    return tuple("" if value is None else EFFECTS[key][1].format(value) for key, value in known.items())


def comparison(rows: Sequence[Row], table: dict[str, float]) -> str:
    """Return the paired comparison with the paper's rule."""
    lines = []
    for group, words in GROUPS.items():
        for measure in MEASURES:
            theirs = table.get(f"paper_rule_{measure}_{group}")
            if theirs is not None:
                only = [f"{table[f'{measure}_only_{who}_{group}']:.0f}" for who in ("ours", "paper_rule")]
                p = f"{table[f'{measure}_mcnemar_p_{group}']:.1g}"
                ours = f"{table[f'{measure}_{group}']:.1%}"
                lines.append((words, measure.replace("_", " "), ours, f"{theirs:.1%}", *only, p))
    if not lines:
        return ""
    kinds = Counter(row["paper"]["failure"] for row in rows if lost(row["paper"]))
    why = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common())
    heads = ("trials", "measure", "Anther", "the paper's rule", "only Anther", "only the rule", "McNemar p")
    return rows_of(heads, lines) + f"\n\nHow the paper's rule failed: {why or 'not once'}."


def times(table: dict[str, float]) -> str:
    """Return the table of times."""
    lines = []
    for phase in (*PHASES, "cycle"):
        ours = [table.get(f"{phase}_{name}_s") for name in ("30_views", "fast")]
        theirs = PAPER_SECONDS.get(phase, sum(PAPER_SECONDS.values()) if phase == "cycle" else None)
        lines.append((phase, *("" if value is None else f"{value:.1f}" for value in (theirs, *ours))))
    for measure, words in PLANNING.items():
        ours = [table.get(measure.format(name)) for name in ("30_views", "fast")]
        lines.append((words, "", *("" if value is None else f"{value:.2f}" for value in ours)))
    return rows_of(("median [s]", "the paper", "30 views", "`fast`"), lines)


def failures(rows: Sequence[Row]) -> str:
    """Return every trial of Anther's that failed."""
    lines = []
    for row in rows:
        if lost(row["ours"]):
            plant = f"{row['species']} {row['seed']} at {row['viewpoint']}°, {row['preset']}"
            lines.append((plant, row["ours"]["failure"], row["ours"]["message"]))
    return rows_of(("failed trial", "kind", "what happened"), lines) if lines else ""


def markdown(table: Table) -> str:
    """Return a console's table in Markdown."""
    heads = [str(column.header) for column in table.columns]
    return rows_of(heads, zip(*(column.cells for column in table.columns), strict=True))


def rows_of(heads: Sequence[str], lines: Iterable[Sequence[object]]) -> str:
    """Return a Markdown table."""
    cells = [heads, ["---"] * len(heads), *lines]
    return "\n".join("| " + " | ".join(str(cell).replace("\n", " ") for cell in line) + " |" for line in cells)
