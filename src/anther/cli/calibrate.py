"""Images of a board and the flange's poses -> where the camera sits on the flange or stands beside the robot, and how
far that can be trusted.

With --live the arm of a cell takes the images; with --check it looks whether the camera has moved since.
"""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from anther.cli.args.calibrate import Args
from anther.cli.output import free
from anther.core.errors import InputError, bad_input
from anther.core.geometry import Array, Intrinsics, inverse
from anther.robot.calibration import HandEye

SUFFIXES = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp"}


def run(args: Args) -> int:
    """Find the corners, calibrate, print and write the result; or do so live, or check. Return the exit code."""
    _check_options(args)
    if args.cell is None:
        _from_files(args)
        return 0
    from anther.cli.live_calibration import check, live

    if args.check:
        return check(args.cell, yes=args.yes)
    board = _require(args, "board")
    return live(args.cell, board, out=args.out, intrinsics=args.intrinsics, by_hand=args.by_hand, yes=args.yes)


NEEDED = {"images": ("images", "poses", "board"), "live": ("cell", "board"), "check": ("cell",)}
WAYS = {
    "images": (
        *NEEDED["images"],
        "intrinsics",
        "estimate_intrinsics",
        "eye_to_hand",
        "out",
        "overwrite",
        "json",
        "method",
    ),
    "live": (*NEEDED["live"], "live", "intrinsics", "out", "by_hand", "yes"),
    "check": (*NEEDED["check"], "check", "yes"),
}
"""Which options go together, and which of them must be given."""


def _check_options(args: Args) -> None:
    """Refuse options that do not go together, and those that are missing."""
    if args.live and args.check:
        raise InputError("options: give --live or --check, not both.")
    way = "live" if args.live else "check" if args.check else "images"
    plain = Args()
    for name in (f.name for f in fields(Args) if f.name not in WAYS[way]):
        if getattr(args, name) != getattr(plain, name):
            allowed = "with " + " or ".join(f"--{other}" for other, names in WAYS.items() if name in names)
            raise bad_input(_option(name), given=f"it with --{way}", allowed=allowed, do="Leave one of them out.")
    for name in NEEDED[way]:
        _require(args, name)


def _require(args: Args, name: str) -> Any:
    if getattr(args, name) is None:
        raise InputError(f"options: {_option(name)} is missing. See: anther calibrate --help")
    return getattr(args, name)


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _from_files(args: Args) -> None:
    """Calibrate from images and poses in files."""
    from anther.robot import calibration
    from anther.show.pictures import save_figure
    from anther.show.pictures.estimates import draw_calibration

    folder, out = _require(args, "images"), args.out or Path()
    free(*(out / name for name in ("calibration.json", "calibration.png")), overwrite=args.overwrite)
    board, poses = calibration.parse_board(_require(args, "board")), calibration.read_poses(_require(args, "poses"))
    given = _given_intrinsics(args, folder)
    names, notes = _names(folder, poses)
    corners, size = _find(folder, names, board)
    intrinsics, distortion = given or calibration.estimate_intrinsics(corners, *size)
    calibration.check_size(intrinsics, size, "the images")
    views = calibration.board_views(calibration.undistort(corners, intrinsics, distortion), intrinsics)
    seen = tuple(names[number] for number in views.images)
    notes += [f"no board found in {', '.join(n for n in names if n not in seen)}"] if len(seen) < len(names) else []
    flange = np.stack([poses[name] for name in seen])
    solve = calibration.calibrate_eye_to_hand if args.eye_to_hand else calibration.calibrate
    result = solve(
        flange,
        views,
        intrinsics,
        method=args.method,
        free_intrinsics=args.estimate_intrinsics,
        images=seen,
        distortion=distortion,
    )
    found = result.exchanged if isinstance(result, calibration.EyeToHand) else result
    notes += [*found.notes, *_camera_notes(args, views, intrinsics, distortion)]
    result.save(out / "calibration.json")
    moving = inverse(flange) if args.eye_to_hand else flange
    save_figure(draw_calibration(found, views, moving), out / "calibration.png")
    if args.json:
        print(json.dumps(json.loads((out / "calibration.json").read_text()) | {"notes": notes}, indent=2))
    else:
        _print(found, notes, out, args)


def _given_intrinsics(args: Args, folder: Path) -> tuple[Intrinsics, Array] | None:
    """Return None where they are to be estimated."""
    from anther.robot.calibration import read_intrinsics

    if args.estimate_intrinsics:
        if args.intrinsics is not None:
            raise InputError("intrinsics: give --intrinsics or --estimate-intrinsics, not both.")
        return None
    beside = folder / "intrinsics.json"
    if args.intrinsics is None and not beside.exists():
        allowed = "--intrinsics FILE, or --estimate-intrinsics"
        raise bad_input("intrinsics", given=f"none, and no {beside}", allowed=allowed, do="Prefer the camera's own.")
    return read_intrinsics(args.intrinsics or beside)


def _names(folder: Path, poses: dict[str, Array]) -> tuple[list[str], list[str]]:
    """Return the images that have poses, and notes."""
    from anther.core.files import existing, named_file

    if not existing(folder).is_dir():
        raise bad_input(f"{folder}", given="a file", allowed="a folder of images", do="Give the folder.")
    there = {path.name for path in folder.iterdir() if path.suffix.lower() in SUFFIXES}
    meant = {name: named_file(folder, name) for name in poses}
    missing = sorted(name for name, path in meant.items() if not path.is_file())
    if missing:
        given = f"poses for {', '.join(missing[:5])}{' ...' if len(missing) > 5 else ''}, which {folder} lacks"
        do = "Copy them there, or correct the names."
        raise bad_input("images", given=given, allowed="an image for each pose, by file name", do=do)
    spare = sorted(there - {path.name for path in meant.values()})
    return sorted(poses), [f"no pose for {', '.join(spare)}: not used"] if spare else []


def _find(folder: Path, names: list[str], board: Any) -> tuple[Any, tuple[int, int]]:
    """Return the corners and the images' size, read one at a time."""
    from rich.console import Console
    from rich.progress import track

    from anther.core.files import named_file
    from anther.core.opencv import cv2
    from anther.perception.images import read_image
    from anther.robot.calibration import find_corners

    sizes: dict[tuple[int, int], str] = {}

    def read(name: str) -> Any:
        image = read_image(named_file(folder, name), cv2.IMREAD_GRAYSCALE)
        sizes.setdefault((image.shape[1], image.shape[0]), name)
        if len(sizes) > 1:
            text = ", ".join(f"{w} x {h} ({first})" for (w, h), first in sizes.items())
            raise bad_input("images", given=f"sizes {text}", allowed="one size", do="Keep one camera's images.")
        return image

    console = Console(stderr=True)
    shown = track(names, "corners", console=console, transient=True, disable=not console.is_terminal)
    return find_corners((read(name) for name in shown), board), next(iter(sizes))


def _camera_notes(args: Args, views: Any, intrinsics: Intrinsics, distortion: Array) -> list[str]:
    from anther.robot.calibration import image_coverage, largest_distortion
    from anther.robot.calibration.live import Taken

    notes, bend = [], largest_distortion(intrinsics, distortion)
    covered = image_coverage(np.concatenate(views.corners.pixels), intrinsics)
    if bend > 0.3:
        notes.append(f"the lens bends the image's border by {bend:.1f} px: undistort images before anther reconstruct")
    if args.estimate_intrinsics and covered < Taken.covered:
        notes.append(f"the corners cover {covered:.0%} of the image: move the board into its corners too")
    return notes


def _print(found: HandEye, notes: list[str], out: Path, args: Args) -> None:
    from rich.console import Console

    from anther.core.geometry import pose7

    console, camera = Console(highlight=False, markup=False), found.intrinsics
    console.print(_view_table(found))
    console.print(_method_table(found))
    pose = " ".join(f"{number:.6f}" for number in pose7(found.T_flange_cam))
    own = f"{np.rad2deg(found.rotation_error):.3f} deg, {1e3 * found.translation_error:.2f} mm"
    arm = f"{np.rad2deg(found.arm_rotation_error):.2f} deg, {1e3 * found.arm_translation_error:.1f} mm per axis"
    lens = f"{camera.width} x {camera.height} px, f {camera.fx:.2f} {camera.fy:.2f}, c {camera.cx:.2f} {camera.cy:.2f}"
    bend = " ".join(f"{k:.4g}" for k in found.distortion)
    for line in (
        f"{'T_base_cam' if args.eye_to_hand else 'T_flange_cam'}  {pose}   (x y z [m] qx qy qz qw)",
        f"standard error, worst direction: {own}",
        f"corners found to {found.pixel_noise:.2f} px; the arm's poses err by {arm}",
        f"camera ({'estimated' if args.estimate_intrinsics else 'given'}): {lens}, distortion {bend}",
        *(f"warning: {note}" for note in notes),
        f"written: {out / 'calibration.json'}, {out / 'calibration.png'}",
    ):
        console.print(line, soft_wrap=True)


def _view_table(found: HandEye) -> Any:
    from rich.table import Table

    table = Table(title="views: how far the board is from where it is expected")
    table.add_column("image", overflow="fold")
    for name in ("px", "deg", "mm", "px, left out", "deg", "mm", ""):
        table.add_column(name, justify="right")
    for i, name in enumerate(found.images):
        own = found.pixel_residuals[i], found.rotation_residuals[i], found.translation_residuals[i]
        cells = (name, *_cells(own), *_cells(found.left_out_errors[i]))
        table.add_row(*cells, "" if found.used[i] else "outlier", style="" if found.used[i] else "red")
    return table


def _method_table(found: HandEye) -> Any:
    from rich.table import Table

    table = Table(title="methods: apart from the result, and RMS error of a view left out")
    for name in ("method", "apart deg", "mm", "RMS px", "px, left out", "deg", "mm"):
        table.add_column(name, justify="left" if name == "method" else "right")
    for row in found.methods:
        name = row.name if row.name != "result" else "refined" if "refine" in found.method else "chosen"
        apart = f"{np.rad2deg(row.rotation_apart):.3f}", f"{1e3 * row.translation_apart:.2f}"
        left_out = row.left_out_pixel, row.left_out_rotation, row.left_out_translation
        table.add_row(name, *apart, f"{row.pixel_rms:.2f}", *_cells(left_out))
    return table


def _cells(errors: Any) -> tuple[str, ...]:
    """Return an error in px, rad, m as text in px, deg, mm."""
    pixel, turn, shift = (float(number) for number in errors)
    return ("-",) * 3 if np.isnan(pixel) else (f"{pixel:.2f}", f"{np.rad2deg(turn):.3f}", f"{1e3 * shift:.2f}")
