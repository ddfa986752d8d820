"""The rod engine against theory, peers and itself: three tables.

    python -m evaluation.record docs/reports/rod_validation.md

Rows whose limit is a dash only inform. Stored references of the peer solver are read from --data; where it is missing,
their rows are left out.

Keys of the --json file: <case>_error and <case>_limit for every row (fractions, degrees or metres, as the table says),
rows, rows_failed.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from rich.console import RenderableType

from evaluation.harness import DATA, finish, options, progress
from evaluation.rods.ends import end_cases
from evaluation.rods.motion import energy_cases, order_cases, violent_cases
from evaluation.rods.objectivity import objectivity_cases
from evaluation.rods.own import own_cases
from evaluation.rods.peer_references import planar_cases, reference_cases
from evaluation.rods.statics import static_cases
from evaluation.rods.supports import support_cases
from evaluation.rods.table import Case, Row, metrics
from evaluation.rods.vibrations import decay_cases, frequency_cases, response_cases
from evaluation.tables import markdown

THEORY, PEERS = "Against theory.", "Against other solvers, and against itself."
ORDERS = "How the error shrinks with the step: the slope of its logarithm must be the order of the scheme within 0.1."


def cases(data: Path) -> Iterator[tuple[str, Case]]:
    """Yield (against what, cases) of each group, those of the peer references only where their folder is there."""
    statics = static_cases, end_cases, own_cases, support_cases
    for case in (*statics, frequency_cases, decay_cases, energy_cases, order_cases):
        yield THEORY, case
    references = data / "rod_reference"
    if references.is_dir():
        yield PEERS, lambda quick: reference_cases(references, quick)
        yield PEERS, lambda quick: planar_cases(references, quick)
    for case in (response_cases, violent_cases, objectivity_cases):
        yield PEERS, case


def report(rows: list[tuple[str, Row]]) -> Iterator[RenderableType]:
    """Yield a table for each kind of comparison, and what failed."""
    for group in (THEORY, ORDERS, PEERS):
        last = ("measured",) if group == ORDERS else ()
        lines = []
        for row in (row for of, row in rows if of == group):
            verdict = "" if row.limit is None else "FAILED" if row.failed else "met"
            detail = (row.detail,) if last else ()
            lines.append((row.case, row.what, row.printed(row.error), row.printed(row.limit), *detail, verdict))
        yield group
        yield markdown(("row", "compared", "error", "limit", *last, "verdict"), lines)
    yield from (f"{row.case}: {row.detail}" for _, row in rows if row.failed)
    limited = [row for _, row in rows if row.limit is not None]
    yield f"{sum(row.failed for row in limited)} of {len(limited)} rows with a limit failed."


def main() -> None:
    """Run, print the tables, write --json."""
    own = {"--data": (DATA, "folder of rod_reference/")}
    args = options(__doc__, quick="shorter runs and coarser steps", own=own)
    missing = not (args.data / "rod_reference").is_dir()
    asked = progress(list(cases(args.data)), "rod validation")
    rows = [(ORDERS if row.is_order else group, row) for group, case in asked for row in case(args.quick)]
    parts = [f"No rod_reference in {args.data}: the rows of the peer are left out."] if missing else []
    finish(args, metrics([row for _, row in rows]), *parts, *report(rows))


if __name__ == "__main__":
    main()
