"""Imported skeletons: read, rooted, and their main stems."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from anther.core.checks import check_range
from anther.core.choices import Axis, Crop, Units
from anther.core.errors import bad_input
from anther.core.geometry import TO_Z_UP, Array
from anther.perception.formats.skeleton_file import assume_radii
from anther.perception.formats.skeletons import SkeletonFile, read_skeleton
from anther.perception.skeleton import Params, Skeleton, nearest_node
from anther.perception.stem import LOW, Stem, find_stem
from anther.perception.stem import Params as StemParams

Place = tuple[float, float, float]
ROOTLESS = (".txt", ".ply")
"""Files that do not name the root."""


def read_source(
    path: Path,
    *,
    units: Units | None = None,
    up: Axis | None = None,
    radius: float | None = None,
    least: float = 0.0,
    root: str | None = None,
    crop: Crop = "tomato",
) -> tuple[SkeletonFile, Skeleton]:
    """Return a skeleton file (.npz, .swc, .txt, .ply, .graphml or .mtg), rooted, and the skeleton in it.

    Args:
        path: the file.
        units: of its lengths; None: those that it states, else metres.
        up: axis that points up in the file; None: z.
        least: no node's radius is less [m].
        radius: of every node [m]; None: those in the file, else the crop's stem at its base, thinner with what a node
            carries (`assume_radii`).
        root: the stem's base, see `node_named`; None: the file's own root, or where the way up begins to rise.
            What lies flat there is then a scrap of soil, and left out.

    Raises:
        InputError: a bad file, radius or node.
    """
    source = upright(read_skeleton(path, units), up)
    if radius is not None:
        check_range("radius", radius, 1e-4, 0.2, "m")
    if root is not None:
        source = source.rooted_at(node_named("--root", root, source))
    elif path.suffix.lower() in ROOTLESS:
        source = source.rooted_at().without_scraps()
    bare = radius is None and source.radius is None
    # m: tomato 4 to 6 mm, remembered, no source found; pepper 5 and 7 mm at harvest (facts: pollination 2)
    at_base = {"tomato": 5e-3, "pepper": 6e-3}
    return source, source.skeleton(assume_radii(source, at_base[crop]) if bare else radius, least)


def upright(source: SkeletonFile, up: Axis | None) -> SkeletonFile:
    """Return a skeleton whose axis `up` points up as one with z up; None: it is z."""
    return source if up is None else replace(source, nodes=source.nodes[:, TO_Z_UP[up]])


def node_named(option: str, text: str, source: SkeletonFile) -> int:
    """Return the node that an option such as "--root" names: by its number in the file, or as the nearest to x,y,z [m].

    Raises:
        InputError: neither, no such node, or a place off the plant.
    """
    if "," in text:
        return int(source.numbers[nearest_node(option, place(option, text), source.nodes)])
    if not text.strip().isdecimal():
        allowed = "a node's number in the file, or x,y,z in metres"
        raise bad_input(option, given=text, allowed=allowed, do=f"Write {option}=12 or {option}=0.01,0.02,0.")
    return int(source.numbers[source.node(int(text))])


def main_stem(skeleton: Skeleton, tip: int | None = None, flowers_at: Array | None = None) -> Stem:
    """Return the main stem of an imported skeleton.

    It ends at the node `tip`, if known; None: where it is found to end or, if that leaves it a stub, at the
    plant's top, with a note.

    Raises:
        StageFailure: there is none.
    """
    nodes = skeleton.nodes

    def ended(at: int) -> Stem:
        x, y, z = nodes[at].tolist()
        return find_stem(skeleton, StemParams(tip=(x, y, z)), flowers_at=flowers_at)

    if tip is not None:
        return ended(tip)
    found, top = find_stem(skeleton, flowers_at=flowers_at), int(nodes[:, 2].argmax())
    rise, height = np.ptp(nodes[found.node_ids, 2]), nodes[top, 2] - nodes[0, 2]
    if rise >= LOW * height:
        return found
    stem, stub = ended(top), f"only {1e3 * rise:.0f} of {1e3 * height:.0f} mm look like a main stem"
    note = f"main stem: {stub}; the way to the top is taken for it. --stem-tip names its end, --root its base."
    return replace(stem, notes=(*stem.notes, note))


def place(option: str, text: str) -> Place:
    """Return the place [m] that an option such as "--root" names as x,y,z.

    Raises:
        InputError: no three numbers.
    """
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        allowed = "x,y,z in metres, as `anther view` prints it on a click"
        raise bad_input(option, given=text, allowed=allowed, do=f"Write {option}=0.01,0.02,0.") from None
    return x, y, z


def with_known_places(
    root: str | None, tip: str | None, params: Params, stem: StemParams, plant: int | None = None
) -> tuple[Params, StemParams]:
    """Return the parameters with the places that --root and --stem-tip name, and --plant's number, where given."""
    params = params if root is None else replace(params, root=place("--root", root))
    params = params if plant is None else replace(params, plant=plant)
    return params, stem if tip is None else replace(stem, tip=place("--stem-tip", tip))
