"""Make the samples that ship with the package, from simulated plants, boards and stems. A few minutes.

PYTHONPATH=tests/support python tools/make_samples.py src/anther/cli/sample_data

The boards, bags and stem tests are those of the tests (made_board, made_bags, made_stem).
"""

import json
import shutil
import sys
import tempfile
from dataclasses import asdict, replace
from pathlib import Path

import cv2
import made_board
import numpy as np
from made_bags import START, BagMaker
from made_stem import Truth, nonlinear_trace, write_csv, write_files

from anther.core import Array, Intrinsics
from anther.core.files import read_json, write_json
from anther.core.geometry import pose7
from anther.perception import Capture, Cloud, find_stem, flower_centres, fuse, masks, skeletonize, write_skeleton
from anther.perception.cloud.ply import write_ply
from anther.robot import CharucoBoard
from anther.sim import capture_from_poses, grow_tomato, orbit_poses
from anther.sim.render import d455

SEED, VIEWS, MIDDLE = 0, 6, (0.72, 0.0, 0.0)
BOARD_CAMERA = Intrinsics(640, 480, 500.0, 500.0, 319.5, 239.5)
BOARD_IMAGES = 12
THIN = 0.004
"""Edge of the voxels of the sample cloud [m]: small, and still a plant."""


def main(out: str) -> None:
    """Make all samples anew in a folder."""
    folder = Path(out)
    for name in ("capture", "board", "stem", "turntable"):
        shutil.rmtree(folder / name, ignore_errors=True)
        (folder / name).mkdir(parents=True)
    capture = write_capture(folder / "capture")
    cloud = fuse(capture, masks.segment(capture))
    write_cloud(folder / "plant.ply", cloud)
    skeleton = skeletonize(cloud)
    stem = find_stem(skeleton, flowers_at=flower_centres(cloud))
    write_skeleton(folder / "skeleton.swc", skeleton, stem.organ_names())
    half = halved(capture)
    write_bag(folder / "views.mcap", half)
    write_turntable(folder / "turntable", half)
    write_board(folder / "board")
    write_stem(folder / "stem")
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    print(f"{folder}: {size / 1e6:.2f} MB; {len(skeleton.nodes)} nodes, main stem {stem.arc_length[-1]:.3f} m")


def write_capture(folder: Path) -> Capture:
    """Write six views of a tomato, as a D455 gives them: colour as JPEG, depth in millimetres."""
    poses = orbit_poses(VIEWS, MIDDLE, distance=0.65, azimuths=(60, 300))
    rng = np.random.default_rng(SEED)
    capture, _ = capture_from_poses(grow_tomato(SEED), poses, rng=rng, intrinsics=d455(640, 360))
    capture = replace(capture, depth=np.round(capture.depth, 3))
    with tempfile.TemporaryDirectory() as wide:
        capture.save(Path(wide) / "capture")
        meta = read_json(Path(wide) / "capture" / "transforms.json")
    for part in ("rgb", "depth"):
        (folder / part).mkdir()
    for i, frame in enumerate(meta["frames"]):
        frame["file_path"] = f"rgb/{i:04d}.jpg"
        cv2.imwrite(str(folder / frame["file_path"]), capture.rgb[i][..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])
        write_depth(folder / frame["depth_file_path"], capture.depth[i])
    write_json(folder / "transforms.json", meta | {"depth_unit_scale_factor": 0.001})
    return Capture.load(folder)


def write_depth(path: Path, depth: Array) -> None:
    """Write depth [m] as a small 16-bit PNG in millimetres."""
    cv2.imwrite(str(path), np.round(1e3 * depth).astype(np.uint16), [cv2.IMWRITE_PNG_COMPRESSION, 9])


def halved(capture: Capture) -> Capture:
    """Return every other view at half the size: depth of every other pixel, colour averaged."""
    camera = capture.intrinsics
    w, h = camera.width // 2, camera.height // 2
    small = Intrinsics(w, h, camera.fx / 2, camera.fy / 2, camera.cx / 2, camera.cy / 2)
    rgb = np.stack([image[::2, ::2] for image in capture.rgb[::2]])
    return Capture(capture.depth[::2, ::2, ::2], small, capture.T_world_cam[::2], rgb)


def write_cloud(path: Path, cloud: Cloud) -> None:
    """Write a thinned cloud with colours, as another program would."""
    _, first = np.unique(np.floor(cloud.points / THIN).astype(int), axis=0, return_index=True)
    write_ply(path, np.round(cloud.points[first], 5), colors=cloud.colors[first])


def write_bag(path: Path, capture: Capture) -> None:
    """Write the views as a ROS 2 recorder does in MCAP: aligned depth, colour, and the camera's pose."""
    maker, camera = BagMaker(ros1=False), "/camera/color"
    maker.camera_info(f"{camera}/camera_info", capture.intrinsics)
    for i, (depth, rgb, T) in enumerate(zip(capture.depth, capture.rgb, capture.T_world_cam, strict=True)):
        time = START + 0.1 * i
        depth_mm = np.round(1e3 * depth).astype(np.uint16)
        maker.image("/camera/aligned_depth_to_color/image_raw", time, depth_mm, "16UC1")
        jpeg = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()
        maker.compressed(f"{camera}/image_raw/compressed", time, jpeg)
        maker.pose("/arm/camera_pose", time, T)
    maker.write(path)


def write_turntable(folder: Path, capture: Capture) -> None:
    """Write depth frames of a turntable, in millimetres."""
    frames = []
    for i, (depth, T) in enumerate(zip(capture.depth, capture.T_world_cam, strict=True)):
        write_depth(folder / f"{i:02d}.png", depth)
        in_mm = T.copy()
        in_mm[:3, 3] *= 1e3
        frames.append({"file": f"{i:02d}.png", "T_world_cam": in_mm})
    write_json(folder / "poses.json", {"intrinsics": asdict(capture.intrinsics), "depth_scale_mm": 1, "frames": frames})


def write_board(folder: Path) -> None:
    """Write pictures of a board, the flange's pose at each, and the camera's intrinsics."""
    flange, seen = made_board.poses(BOARD_IMAGES, np.random.default_rng(SEED))
    rows = ["image,x,y,z,qx,qy,qz,qw"]
    for i, (T_flange, T_board) in enumerate(zip(flange, seen, strict=True)):
        name = f"view_{i + 1:02d}.png"
        cv2.imwrite(str(folder / name), made_board.render(CharucoBoard(), T_board, BOARD_CAMERA))
        rows.append(",".join([name, *(f"{x:.6f}" for x in pose7(T_flange))]))
    (folder / "poses.csv").write_text("\n".join(rows) + "\n")
    (folder / "camera.json").write_text(json.dumps(asdict(BOARD_CAMERA), indent=1) + "\n")


def write_stem(folder: Path) -> None:
    """Write what a careful person measures of one stem: samples, profile, leaves, two plucks, deflections."""
    truth = Truth()
    times, tip = nonlinear_trace(truth)
    write_files(folder, truth, (times, tip), SEED)
    rng = np.random.default_rng(SEED)
    for name in ("pluck1.csv", "pluck2.csv"):
        write_csv(folder / name, time_s=times, displacement_mm=1e3 * tip + 0.1 * rng.normal(size=len(tip)))
    (folder / "pluck.csv").unlink()
    for path in folder.glob("*.csv"):
        path.write_text(path.read_text().replace("# made for a test", "# a simulated stem of 90 MPa and 1080 kg/m3"))


if __name__ == "__main__":
    main(*sys.argv[1:])
