"""The morning's check: has the wrist camera moved since it was calibrated? A few views of the board."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from anther.calibration import Moved, camera_moved, parse_board, read_intrinsics
from anther.calibration.live import INTRINSICS, Record, Taken, read_record, spread
from anther.cells import CellFile, read_cell
from anther.commands.hardware_cell import arm_and_camera
from anther.commands.live_calibration import Asking, Eye
from anther.devices import JointTrajectory
from anther.errors import bad_input
from anther.geometry import inverse

VIEWS, LEAST = 4, 3
"""Views that are taken, and that must show the board: three tell camera from board."""
THERE = 0.01
"""An arm within this of a place stays where it is [rad]."""


def check(cell: Path, *, yes: bool = False) -> int:
    """Go to some of the calibration's views, tell whether the camera has moved; return 0, or 1 if anything has.

    Args:
        cell: the cell file.
        yes: nobody is asked before the motions.

    Raises:
        AntherError: a bad file, no calibration to compare with, or a machine that refuses.
    """
    file, begin = read_cell(cell), time.monotonic()
    folder = _folder(file)
    record = read_record(folder)
    intrinsics, distortion = read_intrinsics(folder / INTRINSICS)
    today = Taken(folder, record.board, intrinsics, distortion)
    with arm_and_camera(file) as (arm, camera):
        places = look_again(Eye(file, arm, camera), record, today, Asking(yes))
    if places is None:
        return 2
    print(f"{len(places)} views in {time.monotonic() - begin:.0f} s")
    anew = f"Calibrate again: anther calibrate --live --cell {cell} --board {record.board}"
    if len(places) < LEAST:
        print(f"{VIEWS - len(places)} of {VIEWS} views do not show the board: does it stand where it stood, in light?")
        print(f"If so, the camera has moved far. {anew}")
        return 1
    then = record.T_base_flange[places], record.T_cam_board[places]
    centre = parse_board(record.board).centre
    moved = camera_moved(record.found, then, today.flange, today.all_views(), intrinsics, centre)
    print(in_words(moved))
    if moved.verdict != "still":
        print(anew)
    return int(moved.verdict != "still")


def look_again(eye: Eye, record: Record, today: Taken, ask: Asking) -> list[int] | None:
    """Take `today`'s views from places of the calibration; return which of them show the board, None if not allowed to.

    Raises:
        StageFailure: a place cannot be reached, or the arm refuses.
    """
    centre, here = parse_board(record.board).centre, eye.arm.joints()
    nearest = int(np.abs(record.joints - here).max(axis=1).argmin())
    chosen = spread(inverse(record.T_cam_board), VIEWS, nearest, centre, today.intrinsics)
    planner, motions = eye.planner(record.found.T_base_board, centre), list[JointTrajectory]()
    for there in record.joints[chosen]:
        near = np.abs(there - here).max() < THERE
        motions.append(JointTrajectory.standstill(here, THERE) if near else planner.move(here, there))
        here = motions[-1].positions[-1]
    seconds = sum(motion.duration for motion in motions)
    if not ask.may(f"Go to {len(chosen)} views in {seconds:.0f} s?"):
        return None
    seen = []
    for number, motion in zip(chosen, motions, strict=True):
        eye.go(motion)
        image, joints = eye.look()
        view = today.see(image)
        if view is not None:
            today.take(view, joints, eye.file.model.forward(joints))
            seen.append(number)
    return seen


def in_words(moved: Moved) -> str:
    """Return what a check found, in a sentence or two."""
    known = f"known to {1e3 * moved.translation_error:.1f} mm, {np.rad2deg(moved.rotation_error):.2f} deg"
    camera = f"{1e3 * moved.translation:.1f} mm, {np.rad2deg(moved.rotation):.2f} deg ({known})"
    board = f"{1e3 * moved.board_translation:.1f} mm, {np.rad2deg(moved.board_rotation):.2f} deg"
    match moved.verdict:
        case "still":
            return f"the camera has not moved: within {camera}"
        case "camera":
            return f"THE CAMERA HAS MOVED by {camera}"
        case "board":
            return f"THE BOARD HAS MOVED by {board}; the camera seems to be where it was"
        case "camera or board":
            return f"THE CAMERA HAS MOVED by {camera}, or the board by {board}: these views do not tell which"
        case "more":
            return f"MORE THAN ONE THING HAS MOVED: camera (by {camera}), board, or the arm's zero"


def _folder(file: CellFile) -> Path:
    """Return where the calibration is that the cell file names."""
    named = file.source.table["wrist_camera"].get("calibration")
    if named is None:
        raise bad_input(
            file.source.where(("wrist_camera",)),
            given="a T_flange_cam, which tells nothing to compare with",
            allowed="calibration = ..., as anther calibrate --live writes it",
            do="Calibrate once with --live.",
        )
    return (file.source.path.parent / named).parent
