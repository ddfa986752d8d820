"""The rod engine against theory, peers and itself: one table, and figures, in docs/reports/rod_validation.md.

Writes docs/reports/rod_validation.md and docs/pictures/rod_validation_*.png (into --docs). Rows whose limit is a dash
only inform. Stored references of the peer solver are read from --data; where it is missing, their rows are left out.

Keys of the --json file: <case>_error and <case>_limit for every row (fractions, degrees or metres, as the table says),
rows, rows_failed.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from rich.console import Console
from rich.progress import track
from rich.table import Table
from rod_cases.ends import end_cases
from rod_cases.figures import draw_convergence, draw_energy
from rod_cases.motion import energy_cases, order_cases, violent_cases
from rod_cases.objectivity import objectivity_cases
from rod_cases.page import page
from rod_cases.peer_references import planar_cases, reference_cases
from rod_cases.statics import static_cases
from rod_cases.table import Findings, Row, metrics
from rod_cases.vibrations import decay_cases, frequency_cases, response_cases

from anther.files import write_json, write_text

DATA = Path(os.environ.get("ANTHER_DATA", Path(__file__).parents[2] / "shared" / "data"))
Case = Callable[[bool], Findings]


def cases(data: Path) -> Iterator[Case]:
    """Yield the groups of cases, those of the peer references only where their folder is there."""
    yield static_cases
    yield end_cases
    yield frequency_cases
    yield decay_cases
    yield energy_cases
    yield order_cases
    references = data / "rod_reference"
    if references.is_dir():
        yield lambda quick: reference_cases(references, quick)
        yield lambda quick: planar_cases(references, quick)
    yield response_cases
    yield violent_cases
    yield objectivity_cases


def main() -> None:
    """Run, print the table, write the page, its figures and --json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA, help="folder of rod_reference/")
    parser.add_argument("--docs", type=Path, default=Path("docs"), help="folder of the page; with --quick, not written")
    parser.add_argument("--json", type=Path, help="write the metrics here")
    parser.add_argument("--quick", action="store_true", help="shorter runs and coarser steps, in two minutes")
    args = parser.parse_args()
    console = Console()
    begin = time.perf_counter()
    if not (args.data / "rod_reference").is_dir():
        console.print(f"no rod_reference in {args.data}: the rows of the peer are left out")
    found = [case(args.quick) for case in track(list(cases(args.data)), "rod validation", console=console)]
    rows = [row for findings in found for row in findings.rows]
    _print(console, rows)
    if not args.quick:
        _write(args.docs, found, rows, time.perf_counter() - begin)
    if args.json:
        write_json(args.json, metrics(rows))


def _print(console: Console, rows: list[Row]) -> None:
    table = Table("case", "error", "limit", "")
    for row in rows:
        verdict = "" if row.limit is None else "FAILED" if row.failed else "met"
        table.add_row(row.case, row.printed(row.error), row.printed(row.limit), verdict)
    console.print(table)
    for row in rows:
        if row.failed:
            console.print(f"{row.case}: {row.detail}", highlight=False)
    console.print(f"{sum(row.failed for row in rows)} of {sum(row.limit is not None for row in rows)} rows failed")


def _write(docs: Path, found: list[Findings], rows: list[Row], seconds: float) -> None:
    pictures = docs / "pictures"
    pictures.mkdir(parents=True, exist_ok=True)
    draw_convergence(found, pictures / "rod_validation_convergence.png")
    draw_energy(found, pictures / "rod_validation_energy.png")
    write_text(docs / "reports" / "rod_validation.md", page(rows, seconds))


if __name__ == "__main__":
    main()
