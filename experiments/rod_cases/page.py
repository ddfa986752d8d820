"""The text of docs/reports/rod_validation.md."""

from __future__ import annotations

from collections.abc import Sequence

from rod_cases.table import Row

HEAD = """# Rod validation

Made by `python experiments/rod_validation.py` ({seconds:.0f} s); do not edit. {failed} of {count} rows fail.
An error in % is relative to the quantity named; rows without a limit inform.

A clamped edge holds the slope in its middle: a beam of n nodes, h apart, bends over L = (n - 1) h - h/2, its free
length. All beams here have free length 0.3 m, whatever n; planted ones bend over their whole length.

| | case | compared | error | limit | measured |
|---|---|---|---|---|---|
"""

FIGURES = """
![errors over node distance and time step](../pictures/rod_validation_convergence.png)

![energy of undamped runs](../pictures/rod_validation_energy.png)
"""


def page(rows: Sequence[Row], seconds: float) -> str:
    """Return the whole page."""
    head = HEAD.format(
        seconds=seconds, failed=sum(row.failed for row in rows), count=sum(row.limit is not None for row in rows)
    )
    return head + "".join(_line(row) for row in rows) + FIGURES


def _line(row: Row) -> str:
    verdict = "" if row.limit is None else "**fails**" if row.failed else "✓"
    cells = [verdict, f"`{row.case}`", row.what, row.printed(row.error), row.printed(row.limit), row.detail]
    return "| " + " | ".join(cells) + " |\n"
