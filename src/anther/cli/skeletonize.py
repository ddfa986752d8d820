"""Point cloud of a plant -> one rooted tree, main stem, grasp, and a picture."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from anther.core.errors import StageFailure
from anther.core.files import json_text
from anther.perception.cloud import Cloud
from anther.perception.flowers import flower_centres
from anther.perception.formats.clouds import Axis, Units, read_cloud
from anther.perception.formats.skeletons import write_skeleton
from anther.perception.skeleton import Params, Skeleton, skeletonize
from anther.perception.stem import Params as StemParams
from anther.perception.stem import Stem, find_stem
from anther.plant.imported import known_better
from anther.pollination.grasp import Grasp, plan_grasps, save_grasps
from anther.pollination.grasp import Params as GraspParams
from anther.show.pictures import save_figure

GRASP = ("point", "tangent", "approach", "arc_length", "stem_diameter", "clearance", "reason")
"""Numbers of the grasp that are told."""


@dataclass(frozen=True)
class Args:
    """Attributes: the cloud, what its numbers mean, and where the results go."""

    cloud: Annotated[Path, tyro.conf.Positional]
    """Point cloud: .ply, .pcd, .las, .laz, .e57, .xyz, .txt, .csv, .asc, .pts or .npz."""
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
        from anther.show.pictures.plant import draw_plant  # Matplotlib takes a second

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
