"""Open a run or a skeleton in the 3-D viewer, write it for other programs (HTML, PLY, SWC, GraphML, MTG, glTF), or show
a trial in Foxglove as it goes on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from anther.cli.args.shared import Given, Overwrite, Source


@dataclass(frozen=True)
class Args(Overwrite, Source):
    """Attributes: what to view, how, or where to write it."""

    source: Given
    """Run folder, e.g. runs/demo; or a skeleton file (.npz .swc .ply .graphml .mtg .txt)."""
    to: Path | None = None
    """Write a file instead of opening a viewer: the scene as .html, or the skeleton as .ply .swc .graphml .mtg .glb
    .txt .npz."""
    radius: float | None = None
    """Radius of every node [m], for a file that has none (.txt), or instead of the file's."""
    find_stem: bool = False
    """Tell organs apart anew (without flowers, so no truss), instead of taking the source's labels."""
    exaggeration: float = 5.0
    """By how much motions are shown larger [-]; in the live viewer a slider."""
    live: bool = False
    """Show a trial that is under way, or is about to begin, to Foxglove's app on this machine (docs/log.md)."""
    port: int | None = None
    """TCP port of the viewer, by default 8080; of --live 8765."""
