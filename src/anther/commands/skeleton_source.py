"""A skeleton file that a command begins with: where the plant stands, how thick it is, and what people know better."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from anther.checks import check_range
from anther.errors import bad_input
from anther.formats.skeleton_file import supposed_radius
from anther.formats.skeletons import SkeletonFile, read_skeleton
from anther.skeleton import Skeleton

if TYPE_CHECKING:  # it takes half of the time that `skeletonize` takes to begin
    from anther.vibration import Crop

Place = tuple[float, float, float]

STEM = {"tomato": 5e-3, "pepper": 6e-3}
"""Radius of a main stem at its base [m]: tomato 4 to 6 mm, remembered, no source found; pepper 5 and 7 mm at harvest
(facts: pollination 2)."""
ROOTLESS = (".txt", ".ply")
"""Files that say nothing of where the plant stands."""


def read_source(
    path: Path, *, radius: float | None = None, root: int | None = None, crop: Crop = "tomato"
) -> tuple[SkeletonFile, Skeleton]:
    """Return a skeleton file, rooted, and the skeleton in it.

    Args:
        path: .npz, .swc, .txt, .ply, .graphml or .mtg.
        radius: of every node [m]; None: those in the file, else the crop's stem at its base, thinner with what a node
            carries (`supposed_radius`).
        root: the node at which the plant stands, numbered as in the file; None: the file's own root, or where the way
            up begins to rise.
        crop: whose stem.

    Raises:
        InputError: a bad file, radius or node.
    """
    source = read_skeleton(path)
    if radius is not None:
        check_range("radius", radius, 1e-4, 0.2, "m")
    if root is not None or path.suffix.lower() in ROOTLESS:
        source = source.rooted_at(root)
    bare = radius is None and source.radius is None
    return source, source.skeleton(supposed_radius(source, STEM[crop]) if bare else radius)


def place(option: str, text: str | None) -> Place | None:
    """Return the place [m] that an option such as "--root" names as x,y,z; None for None.

    Raises:
        InputError: no three numbers.
    """
    if text is None:
        return None
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise bad_input(
            option,
            given=text,
            allowed="x,y,z in metres, as `anther view` prints it on a click",
            do=f"Write {option}=0.01,0.02,0.",
        ) from None
    return x, y, z
