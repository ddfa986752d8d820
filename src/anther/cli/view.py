"""Open a run or a skeleton in the 3-D viewer, write it to one HTML file, or show a trial in Foxglove as it goes on."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from anther.cli.run_folder import LOG
from anther.core.checks import check_range
from anther.core.errors import StageFailure, bad_input
from anther.perception.formats.skeletons import Units
from anther.plant.imported import main_stem, read_source
from anther.show.results import RunResults, read_run


@dataclass(frozen=True)
class Args:
    """Attributes: what to view and how."""

    run: Annotated[Path, tyro.conf.Positional]
    """Run folder, e.g. runs/demo; or a skeleton file."""
    units: Units | None = None
    """Of a skeleton file: of its lengths; by default what it states, else metres if that makes a plant."""
    html: Path | None = None
    """Write the scene to this HTML file instead of opening a viewer."""
    exaggeration: float = 5.0
    """By how much motions are shown larger [-]; in the live viewer a slider."""
    live: bool = False
    """Show a trial that is under way, or is about to begin, to Foxglove's app on this machine (docs/log.md)."""
    port: int | None = None
    """TCP port of the viewer, by default 8080; of --live 8765."""


def run(args: Args) -> None:
    """Read the run and show it."""
    check_range("port", 1 if args.port is None else args.port, 1, 65535)
    if args.live:
        _show(args)
        return
    from anther.show import viewer  # needs the extra `view`

    check_range("exaggeration", args.exaggeration, 0, 1000)
    results = skeleton_results(args.run, args.units) if args.run.is_file() else read_run(args.run)
    if args.html is None:
        viewer.serve(results, args.port or 8080, exaggeration=args.exaggeration)
    else:
        viewer.write_html(args.html, results, exaggeration=args.exaggeration)
        print(f"scene: {args.html}")


def skeleton_results(path: Path, units: Units | None = None) -> RunResults:
    """Return what can be shown of an imported skeleton: its lines and, if one is found, its main stem."""
    source, skeleton = read_source(path, units=units)
    stem = None
    with suppress(StageFailure):
        stem = main_stem(skeleton)
    return RunResults(path, {"capture": str(path)}, skeleton=skeleton, stem=stem, numbers=source.numbers)


def _show(args: Args) -> None:
    """Serve the trial's log until Ctrl-C."""
    from anther.show.log.live import PORT, show  # needs the extra `log`

    path = args.run / LOG
    if args.html is not None:
        raise bad_input("html", given="with --live", allowed="one of them", do="Leave one out.")

    def ready(port: int) -> None:
        how = f"Open ws://localhost:{port} in Foxglove or Lichtblick (Open connection)"
        print(f"{how}. So may any page that a browser here has open. Ctrl-C ends this, not the trial.")
        if not path.exists():
            print(f"waiting for {path} ...")

    show(path, args.port or PORT, ready=ready)
