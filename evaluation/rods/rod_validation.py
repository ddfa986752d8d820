"""The rod engine against theory, peers and itself: three tables, and figures.

    python -m evaluation.record docs/reports/rod_validation.md

Rows whose limit is a dash only inform. Stored references of the peer solver are read from --data; where it is missing,
their rows are left out.

Keys of the --json file: <case>_error and <case>_limit for every row (fractions, degrees or metres, as the table says),
rows, rows_failed.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator
from pathlib import Path

from rich.box import MARKDOWN
from rich.console import Console
from rich.progress import track
from rich.table import Table

from anther.core.files import write_json
from evaluation.rods.ends import end_cases
from evaluation.rods.figures import draw_convergence, draw_energy
from evaluation.rods.motion import energy_cases, order_cases, violent_cases
from evaluation.rods.objectivity import objectivity_cases
from evaluation.rods.own import own_cases
from evaluation.rods.peer_references import planar_cases, reference_cases
from evaluation.rods.statics import static_cases
from evaluation.rods.table import Findings, Row, metrics
from evaluation.rods.vibrations import decay_cases, frequency_cases, response_cases

DATA = Path(os.environ.get("ANTHER_DATA", Path(__file__).parents[3] / "shared" / "data"))
Case = Callable[[bool], Findings]


THEORY, PEERS = "Against theory.", "Against other solvers, and against itself."
ORDERS = "How the error shrinks with the step: the slope of its logarithm must be the order of the scheme within 0.1."


def cases(data: Path) -> Iterator[tuple[str, Case]]:
    """Yield (against what, cases) of each group, those of the peer references only where their folder is there."""
    for case in (static_cases, end_cases, own_cases, frequency_cases, decay_cases, energy_cases, order_cases):
        yield THEORY, case
    references = data / "rod_reference"
    if references.is_dir():
        yield PEERS, lambda quick: reference_cases(references, quick)
        yield PEERS, lambda quick: planar_cases(references, quick)
    for case in (response_cases, violent_cases, objectivity_cases):
        yield PEERS, case


def main() -> None:
    """Run, print the tables, write the figures and --json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA, help="folder of rod_reference/")
    parser.add_argument("--figures", type=Path, help="draw errors and energies into this folder")
    parser.add_argument("--json", type=Path, help="write the metrics here")
    parser.add_argument("--quick", action="store_true", help="shorter runs and coarser steps")
    args = parser.parse_args()
    console = Console()
    if not (args.data / "rod_reference").is_dir():
        console.print(f"No rod_reference in {args.data}: the rows of the peer are left out.")
    todo = track(list(cases(args.data)), "rod validation", console=console)
    found = [(group, case(args.quick)) for group, case in todo]
    _print(console, [(ORDERS if row.is_order else group, row) for group, findings in found for row in findings.rows])
    findings = [findings for _, findings in found]
    if args.figures:
        args.figures.mkdir(parents=True, exist_ok=True)
        draw_convergence(findings, args.figures / "rod_validation_convergence.png")
        draw_energy(findings, args.figures / "rod_validation_energy.png")
    if args.json:
        write_json(args.json, metrics([row for group in findings for row in group.rows]))


def _print(console: Console, rows: list[tuple[str, Row]]) -> None:
    for group in (THEORY, ORDERS, PEERS):
        last = ("measured",) if group == ORDERS else ()
        table = Table("row", "compared", "error", "limit", *last, "verdict", box=MARKDOWN)
        for row in (row for of, row in rows if of == group):
            verdict = "" if row.limit is None else "FAILED" if row.failed else "met"
            measured = (row.detail,) if last else ()
            table.add_row(row.case, row.what, row.printed(row.error), row.printed(row.limit), *measured, verdict)
        console.print(group, table)
    for _, row in rows:
        if row.failed:
            console.print(f"{row.case}: {row.detail}", highlight=False)
    limited = [row for _, row in rows if row.limit is not None]
    console.print(f"{sum(row.failed for row in limited)} of {len(limited)} rows with a limit failed.")


if __name__ == "__main__":
    main()
