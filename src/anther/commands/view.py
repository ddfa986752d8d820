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
    port: int = 8080
    """TCP port of the live viewer."""


def run(args: Args) -> None:
    """Read the run and show it."""
    from anther import viewer
    from anther.checks import check_range
    from anther.results import read_run

    check_range("port", args.port, 1, 65535)
    results = read_run(args.run)
    if args.html is None:
        viewer.serve(results, args.port)
    else:
        viewer.write_html(args.html, results)
        print(f"scene: {args.html}")
