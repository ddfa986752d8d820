"""A run's skeleton, or a skeleton file -> PLY, SWC, GraphML, MTG, glTF, text or npz, for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from anther.core.errors import bad_input
from anther.core.files import existing
from anther.core.runs import FILES, kept
from anther.perception.formats.skeletons import WRITES, Units, read_skeleton, write_skeleton
from anther.perception.skeleton import Skeleton
from anther.perception.stem import Stem, find_stem


@dataclass(frozen=True)
class Args:
    """Attributes: what to export and where to."""

    source: Annotated[Path, tyro.conf.Positional]
    """Run folder, or a skeleton file (.npz .swc .ply .graphml .mtg .txt)."""
    out: Path
    """File to write; its suffix chooses the format: .ply .swc .graphml .mtg .glb .txt .npz."""
    units: Units | None = None
    """Of a skeleton file: of its lengths; by default what it states, else metres if that makes a plant."""
    radius: float | None = None
    """Radius of every node [m], for a file that has none (.txt), or instead of the file's."""
    find_stem: bool = False
    """Tell organs apart anew (without flowers, so no truss), instead of taking the source's labels."""


def run(args: Args) -> None:
    """Read, write, and say what was written."""
    if args.out.suffix.lower() not in WRITES:
        raise bad_input("out", given=str(args.out), allowed=" ".join(WRITES), do="Choose one of these suffixes.")
    skeleton, labels, notes = labelled_skeleton(args.source, args.radius, args.units, new_stem=args.find_stem)
    write_skeleton(args.out, skeleton, labels)
    apart = "organs not told apart (--find-stem does it)"
    organs = apart if labels is None else f"{labels.count('stem')} stem nodes"
    print("\n".join([f"{args.out}: {len(skeleton.nodes)} nodes; {organs}", *(f"note: {note}" for note in notes)]))


def labelled_skeleton(
    source: Path, radius: float | None, units: Units | None = None, *, new_stem: bool
) -> tuple[Skeleton, list[str] | None, tuple[str, ...]]:
    """Return (skeleton, organ name a node, or None where nothing tells, notes) of a run folder or skeleton file.

    `radius` [m] replaces a file's radii; a new stem is found instead of taking the labels that are there.
    """
    labels: list[str] | None = None
    notes: tuple[str, ...] = ()
    if not existing(source).is_dir():
        file = read_skeleton(source, units)
        notes = file.notes
        skeleton, labels = file.skeleton(radius), None if file.labels is None else list(file.labels)
    else:
        skeleton = Skeleton.load(kept(source, "skeleton"))
        if not new_stem and (source / FILES["stem"]).exists():
            labels = Stem.load(source / FILES["stem"]).organ_names()
    return skeleton, find_stem(skeleton).organ_names() if new_stem else labels, notes
