"""Point cloud of a plant -> one rooted tree, main stem, grasp, and a picture."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro

from anther.checks import check_range
from anther.cloud import Cloud
from anther.errors import StageFailure, bad_input
from anther.files import json_text
from anther.flowers import flower_centres
from anther.formats.clouds import Axis, Units, read_cloud
from anther.formats.skeleton_file import supposed_radius
from anther.formats.skeletons import SkeletonFile, read_skeleton, write_skeleton
from anther.geometry import Array
from anther.grasp import Grasp, plan_grasps, save_grasps
from anther.grasp import Params as GraspParams
from anther.pictures import save_figure
from anther.skeleton import Params, Skeleton, nearest_node, skeletonize
from anther.stem import LOW, Stem, find_stem
from anther.stem import Params as StemParams

if TYPE_CHECKING:
    from anther.shake import Crop

Place = tuple[float, float, float]

STEM = {"tomato": 5e-3, "pepper": 6e-3}
"""Radius of a main stem at its base [m]: tomato 4 to 6 mm, remembered, no source found; pepper 5 and 7 mm at harvest
(facts: pollination 2)."""
GRASP = ("point", "tangent", "approach", "arc_length", "stem_diameter", "clearance", "reason")
"""Numbers of the grasp that are told."""
ROOTLESS = (".txt", ".ply")
"""Files that say nothing of where the plant stands."""


def read_source(
    path: Path,
    *,
    units: Units | None = None,
    radius: float | None = None,
    least: float = 0.0,
    root: str | None = None,
    crop: Crop = "tomato",
) -> tuple[SkeletonFile, Skeleton]:
    """Return a skeleton file (.npz, .swc, .txt, .ply, .graphml or .mtg), rooted, and the skeleton in it.

    Args:
        path: the file.
        units: of its lengths; None: those that it states, else metres.
        least: no node's radius is less [m].
        radius: of every node [m]; None: those in the file, else the crop's stem at its base, thinner with what a node
            carries (`supposed_radius`).
        root: where the plant stands, see `node_named`; None: the file's own root, or where the way up begins to rise.
            What lies flat there is then a scrap of soil, and left out.

    Raises:
        InputError: a bad file, radius or node.
    """
    source = read_skeleton(path, units)
    if radius is not None:
        check_range("radius", radius, 1e-4, 0.2, "m")
    if root is not None:
        source = source.rooted_at(node_named("--root", root, source))
    elif path.suffix.lower() in ROOTLESS:
        source = source.rooted_at().without_scraps()
    bare = radius is None and source.radius is None
    return source, source.skeleton(supposed_radius(source, STEM[crop]) if bare else radius, least)


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
    """Return the main stem of a skeleton that somebody else made.

    It ends at the node `tip`, by who knows better; None: where it is found to end or, if that leaves it a stub, at the
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


def known_better(root: str | None, tip: str | None, params: Params, stem: StemParams) -> tuple[Params, StemParams]:
    """Return the parameters with the places that --root and --stem-tip name, where they are given."""
    params = params if root is None else replace(params, root=place("--root", root))
    return params, stem if tip is None else replace(stem, tip=place("--stem-tip", tip))


@dataclass(frozen=True)
class Args:
    """Attributes: the cloud, what its numbers mean, and where the results go."""

    cloud: Annotated[Path, tyro.conf.Positional]
    """Point cloud: .ply, .pcd, .xyz, .txt, .csv, .asc or .npz."""
    units: Units | None = None
    """Units of the file; by default what the file states, else metres."""
    up: Axis | None = None
    """Axis that points up in the file; by default what the file states, else z."""
    plant: int | None = None
    """Which plant of an .npz that holds several, from 0 on."""
    root: str | None = None
    """Where the stem leaves the soil, if you know better: x,y,z [m], as `anther view` prints it on a click."""
    stem_tip: str | None = None
    """Where the main stem ends, if you know better: x,y,z [m]."""
    out: Path | None = None
    """Folder for skeleton.npz, skeleton.swc, grasp.json and overview.png."""
    json: bool = False
    """Print the result as JSON."""
    params: Params = field(default_factory=Params)
    """How the cloud becomes a skeleton."""
    stem: StemParams = field(default_factory=StemParams)
    """How the main stem is found."""
    grasp: GraspParams = field(default_factory=GraspParams)
    """Gripper and grasp."""


def run(args: Args) -> None:
    """Read, skeletonise, find stem and grasp, write and print them."""
    cloud = read_cloud(args.cloud, args.units, args.up, plant=args.plant)
    begin = time.perf_counter()
    params, known = known_better(args.root, args.stem_tip, args.params, args.stem)
    skeleton = skeletonize(cloud, params)
    stem = find_stem(skeleton, known, flowers_at=flower_centres(cloud))
    grasps, notes = best_grasps(stem, skeleton, cloud, args.grasp)
    seconds = time.perf_counter() - begin
    if args.out is not None:
        from anther.pictures.plant import draw_plant  # Matplotlib takes a second

        skeleton.save(args.out / "skeleton.npz")
        write_skeleton(args.out / "skeleton.swc", skeleton, stem.organ_names())
        save_grasps(args.out / "grasp.json", grasps)  # all, best first
        save_figure(draw_plant(cloud, skeleton, stem, grasps[0]), args.out / "overview.png")
    result = summary(cloud, skeleton, stem, grasps[0], notes) | {"seconds": seconds, "out": args.out}
    print(json_text(result).rstrip() if args.json else _text(result))


def best_grasps(
    stem: Stem, skeleton: Skeleton, cloud: Cloud, params: GraspParams | None = None
) -> tuple[list[Grasp], tuple[str, ...]]:
    """Return (grasps, notes): those of our gripper, or of one scaled to the plant where ours does not fit.

    A tree's trunk is too thick for a gripper made for tomato stems; where to take it is still worth knowing.
    """
    params = params or GraspParams()
    try:
        return plan_grasps(stem, skeleton, cloud, params), ()
    except StageFailure as failure:
        if failure.kind != "no_grasp_found":
            raise
        grasps = plan_grasps(stem, skeleton, cloud, replace(params, fit_gripper=False))
        return grasps, (f"the gripper does not fit this plant ({failure})",)


def summary(cloud: Cloud, skeleton: Skeleton, stem: Stem, grasp: Grasp, notes: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return what was found, in words and numbers [m]; the grasp's pose is x, y, z, qx, qy, qz, qw of the flange."""
    return {
        "points": len(cloud.points),
        "nodes": len(skeleton.nodes),
        "tips": int((skeleton.children_count == 0).sum()),
        "root": skeleton.nodes[0],
        "stem_length": float(stem.arc_length[-1]),
        "stem_diameter_at_grasp": grasp.stem_diameter,
        "attachments": len(stem.attachments),
        "grasp": {"pose": grasp.pose7} | {name: getattr(grasp, name) for name in GRASP},
        "notes": [*cloud.notes, *skeleton.notes, *stem.notes, *notes],
    }


def _text(result: dict[str, Any]) -> str:
    grasp = result["grasp"]
    lines = [
        f"{result['points']:,} points -> {result['nodes']} nodes, {result['tips']} tips, one tree",
        f"main stem {result['stem_length']:.4f} m with {result['attachments']} attachments",
        f"grasp at {grasp['arc_length']:.4f} m, stem {grasp['stem_diameter'] * 1e3:.1f} mm thick: {grasp['reason']}",
        *(f"note: {note}" for note in result["notes"]),
        f"{result['seconds']:.1f} s" + (f"; results in {result['out']}" if result["out"] else ""),
    ]
    return "\n".join(lines)
