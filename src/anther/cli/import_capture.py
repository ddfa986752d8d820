"""COLMAP workspaces, RealSense and ROS bags, MCAP, Record3D, fused PLY -> a capture folder, or a cloud (.ply)."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from anther.core.errors import bad_input
from anther.core.files import existing
from anther.perception.formats.bags import BagOptions, read_bag
from anther.perception.formats.colmap import read_colmap_capture, read_colmap_cloud, without_depth


@dataclass(frozen=True)
class Args:
    """Attributes: what to import, where to, and what the source does not tell."""

    source: Annotated[Path, tyro.conf.Positional]
    """COLMAP workspace or model folder, fused .ply, .bag, .mcap, .db3, ROS 2 bag folder, or Record3D's .r3d."""
    out: Annotated[Path, tyro.conf.Positional]
    """Capture folder to write; a .ply for clouds (fused .ply, or a COLMAP model without depth maps)."""
    scale: float | None = None
    """COLMAP and .ply: metres per model unit."""
    up: str | None = None
    """COLMAP and .ply: direction that points up in the model: x, y, z, or (with =) --up=-y, --up=0.1,-0.9,0.3."""
    bag: Annotated[BagOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=BagOptions)
    """Bags and .r3d: how many views. Bags: topics, poses, tolerance."""


def run(args: Args) -> None:
    """Import, write, and say what was written."""
    source, up, scale = existing(args.source), args.up, args.scale
    kind, to_cloud = source.suffix.lower(), args.out.suffix.lower() == ".ply"
    notes: tuple[str, ...] = ()
    if kind in {".bag", ".mcap", ".db3"} or (source / "metadata.yaml").is_file():  # which a ROS 2 bag's folder has
        views = read_bag(source, args.bag)
        capture, notes = views.capture, views.notes
    elif kind == ".r3d":
        from anther.perception.formats.record3d import read_record3d

        capture, notes = read_record3d(source, args.bag.views)
    elif kind == ".ply" or (source.is_dir() and to_cloud):
        if not to_cloud:
            do = "A cloud has no views: name a .ply."
            raise bad_input("out", given=str(args.out), allowed="a .ply file", do=do)
        cloud = read_colmap_cloud(source, scale, up)
        cloud.save(args.out)
        return _say(f"{args.out}: {len(cloud.points):,} points", cloud.notes)
    elif source.is_dir():
        capture, left_out = read_colmap_capture(source, scale, up), without_depth(source)
        notes = (f"left out for want of a depth map: {', '.join(left_out)}",) if left_out else ()
    else:
        allowed = "a COLMAP folder, .ply, .bag, .mcap, .db3, .r3d, or a ROS 2 bag folder"
        do = "Kinect turntables: `anther convert-kinect`. Other clouds: `anther skeletonize` reads them."
        if kind == ".mkv":
            do = (
                "Export an Azure Kinect's views with Open3D, which lays depth over colour: python "
                f"examples/python/reconstruction_system/sensors/azure_kinect_mkv_reader.py --input {source.name} "
                "--output FRAMES, and write their poses into FRAMES/transforms.json (docs/capture.md)."
            )
        raise bad_input(str(source), given=f"a '{source.suffix}' file", allowed=allowed, do=do)
    capture.save(args.out)
    camera = capture.intrinsics
    return _say(f"{args.out}: {capture.views} views of {camera.width} x {camera.height} px", notes)


def _say(what: str, notes: tuple[str, ...]) -> None:
    print("\n".join([what, *(f"note: {note}" for note in notes)]))
