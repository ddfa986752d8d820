"""Open a run in the 3-D viewer, or write it to one HTML file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Args:
    """Attributes: what to view and how."""

    run: Annotated[Path, tyro.conf.Positional]
    """Run folder, e.g. runs/demo."""
    html: Path | None = None
    """Write the scene to this HTML file instead of opening a viewer."""
    exaggeration: float = 5.0
    """By how much motions are shown larger [-]; in the live viewer a slider."""
    port: int = 8080
    """TCP port of the live viewer."""


def run(args: Args) -> None:
    """Read the run and show it."""
    from anther import viewer
    from anther.checks import check_range
    from anther.results import read_run

    check_range("port", args.port, 1, 65535)
    check_range("exaggeration", args.exaggeration, 0, 1000)
    results = read_run(args.run)
    if args.html is None:
        viewer.serve(results, args.port, exaggeration=args.exaggeration)
    else:
        viewer.write_html(args.html, results, exaggeration=args.exaggeration)
        print(f"scene: {args.html}")
