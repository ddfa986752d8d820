"""Views of Kinect, COLMAP, RealSense, ROS, MCAP, Record3D, Azure Kinect -> a capture folder; fused PLY -> a cloud."""

from __future__ import annotations

from anther.cli.args.import_ import Args
from anther.cli.output import free
from anther.core.errors import bad_input
from anther.core.files import existing
from anther.perception.formats.bags import BagOptions, read_bag
from anther.perception.formats.colmap import read_colmap_capture, read_colmap_cloud, without_depth
from anther.perception.formats.kinect import read_kinect


def run(args: Args) -> None:
    """Import, write, and say what was written."""
    source, up, scale = existing(args.source), args.up, args.scale
    kind, to_cloud = source.suffix.lower(), args.out.suffix.lower() == ".ply"
    notes: tuple[str, ...] = ()
    free(args.out, overwrite=args.overwrite)
    if (source / "poses.json").is_file():
        capture = read_kinect(source)
    elif kind in {".bag", ".mcap", ".db3"} or (source / "metadata.yaml").is_file():  # which a ROS 2 bag's folder has
        views = read_bag(source, args.bag or BagOptions())
        capture, notes = views.capture, views.notes
    elif kind == ".r3d":
        from anther.perception.formats.record3d import read_record3d

        capture, notes = read_record3d(source, (args.bag or BagOptions()).views)
    elif kind == ".mkv":
        from anther.perception.formats.azure_kinect import read_azure_kinect

        views = read_azure_kinect(source, args.bag or BagOptions())
        capture, notes = views.capture, views.notes
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
        allowed = (
            "a folder of Kinect frames, a COLMAP folder, .ply, .bag, .mcap, .db3, .r3d, .mkv, or a ROS 2 bag folder"
        )
        do = "Other clouds: `anther skeletonize` reads them."
        raise bad_input(str(source), given=f"a '{source.suffix}' file", allowed=allowed, do=do)
    capture.save(args.out)
    camera, only = capture.intrinsics, ", depth only" if capture.rgb is None else ""
    return _say(f"{args.out}: {capture.views} views of {camera.width} x {camera.height} px{only}", notes)


def _say(what: str, notes: tuple[str, ...]) -> None:
    print("\n".join([what, *(f"note: {note}" for note in notes)]))
