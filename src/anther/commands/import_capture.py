"""COLMAP workspaces, RealSense and ROS bags, MCAP files, fused PLY -> a capture folder, or a cloud (.ply)."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from anther.errors import bad_input
from anther.files import existing
from anther.formats.bags import BagOptions

if TYPE_CHECKING:
    from anther.capture import Capture


@dataclass(frozen=True)
class Args:
    """Attributes: what to import, where to, and what the source does not tell."""

    source: Annotated[Path, tyro.conf.Positional]
    """COLMAP workspace or model folder, fused .ply, .bag, .mcap, .db3, or ROS 2 bag folder."""
    out: Annotated[Path, tyro.conf.Positional]
    """Capture folder to write; a .ply for clouds (fused .ply, or a COLMAP model without depth maps)."""
    scale: float | None = None
    """COLMAP and .ply: metres per model unit."""
    up: str | None = None
    """COLMAP and .ply: direction that points up in the model: x, y, z, or (with =) --up=-y, --up=0.1,-0.9,0.3."""
    bag: Annotated[BagOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=BagOptions)
    """Bags: topics, poses, tolerance."""


def run(args: Args) -> None:
    """Import, write, and say what was written.

    Raises:
        MissingExtra: a bag, and rosbags or mcap is not installed.
        InputError: the source is of no known kind, lacks something, or cannot be read.
    """
    source = existing(args.source)
    if is_bag(source):
        _write_bag(args)
    elif source.suffix.lower() == ".ply" or (source.is_dir() and args.out.suffix.lower() == ".ply"):
        _write_cloud(args)
    elif source.is_dir():
        from anther.formats.colmap import read_colmap_capture

        _write_capture(args.out, read_colmap_capture(source, args.scale, args.up))
    else:
        raise bad_input(
            str(source),
            given=f"a '{source.suffix}' file",
            allowed="a COLMAP folder, .ply, .bag, .mcap, .db3, or a ROS 2 bag folder",
            do="Kinect turntables: `anther convert-kinect`. Other clouds: `anther skeletonize` reads them.",
        )


def is_bag(source: Path) -> bool:
    """Return whether a path is a bag by its suffix, or a folder with a ROS 2 bag's metadata.yaml."""
    return source.suffix.lower() in {".bag", ".mcap", ".db3"} or (source / "metadata.yaml").is_file()


def _write_bag(args: Args) -> None:
    from anther.formats.bags import read_bag

    views = read_bag(args.source, args.bag)
    _write_capture(args.out, views.capture)
    for note in views.notes:
        print(f"note: {note}")


def _write_cloud(args: Args) -> None:
    from anther.formats.colmap import read_colmap_cloud

    if args.out.suffix.lower() != ".ply":
        raise bad_input("out", given=str(args.out), allowed="a .ply file", do="A cloud has no views: name a .ply.")
    cloud: Any = read_colmap_cloud(args.source, args.scale, args.up)
    cloud.save(args.out)
    print(f"{args.out}: {len(cloud.points):,} points")
    for note in cloud.notes:
        print(f"note: {note}")


def _write_capture(out: Path, capture: Capture) -> None:
    capture.save(out)
    camera = capture.intrinsics
    print(f"{out}: {capture.views} views of {camera.width} x {camera.height} px")
