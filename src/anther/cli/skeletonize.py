"""Point cloud of a plant -> one rooted tree, main stem, grasp, and a picture."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from anther.cli.args.skeletonize import Args
from anther.cli.output import room_for
from anther.core.errors import StageFailure
from anther.core.files import json_text
from anther.core.usage import process_seconds
from anther.perception.cloud import Cloud
from anther.perception.flowers import flower_centres
from anther.perception.formats.clouds import read_cloud
from anther.perception.formats.skeletons import write_skeleton
from anther.perception.skeleton import Params, Skeleton, skeletonize
from anther.perception.stem import Params as StemParams
from anther.perception.stem import Stem, find_stem
from anther.perception.supports import find_supports, notes_beside
from anther.plant.imported import with_known_places
from anther.pollination.grasp import Grasp, plan_grasps, save_grasps
from anther.pollination.grasp import Params as GraspParams
from anther.show.pictures import save_figure

WRITTEN = ("skeleton.npz", "skeleton.swc", "stem.npz", "grasp.json", "overview.png")
GRASP = ("point", "tangent", "approach", "arc_length", "stem_diameter", "clearance", "reason")
"""Numbers of the grasp that are told."""


def run(args: Args) -> None:
    """Read, skeletonise, find stem and grasp, write and print them."""
    out = room_for(args, WRITTEN)
    cloud = find_supports(read_cloud(args.cloud, args.units, args.up, plant=args.plant))
    params, known = with_known_places(args.root, args.stem_tip, args.params or Params(), args.stem or StemParams())
    skeleton = skeletonize(cloud, params)
    stem = find_stem(skeleton, known, flowers_at=flower_centres(cloud))
    grasps, notes = best_grasps(stem, skeleton, cloud, args.grasp)
    if out is not None:
        from anther.show.pictures.plant import draw_plant  # Matplotlib takes a second

        skeleton.save(out / WRITTEN[0])
        write_skeleton(out / WRITTEN[1], skeleton, stem.organ_names())
        stem.save(out / WRITTEN[2])
        save_grasps(out / WRITTEN[3], grasps)  # all, best first
        save_figure(draw_plant(cloud, skeleton, stem, grasps[0]), out / WRITTEN[4])
    notes = (*notes_beside(cloud, skeleton, stem), *notes)
    result = summary(cloud, skeleton, stem, grasps[0], notes) | {"seconds": process_seconds(), "out": out}
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
