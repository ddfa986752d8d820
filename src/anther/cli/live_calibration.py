"""The wrist camera of a cell: the arm, or a person, takes it around a board until its place on the flange is known.

Each morning a few views of the same board tell whether it has moved since.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core.errors import AntherError, InputError, StageFailure, bad_input
from anther.core.geometry import Array, inverse, transform_points
from anther.core.opencv import cv2
from anther.robot.arm.board_views import board_planner, find_first_reachable
from anther.robot.arm.planner import Planner
from anther.robot.calibration import (
    HandEye,
    Moved,
    check_size,
    explain_missing_board,
    find_movement,
    parse_board,
    read_intrinsics,
)
from anther.robot.calibration.live import (
    INTRINSICS,
    RESULT,
    CameraReference,
    Taken,
    candidates,
    is_steady,
    lacks,
    least_alike,
    read_camera_reference,
    read_earlier_views,
    spread,
)  # fmt: skip
from anther.robot.cells import CellFile, own_cell, read_cell
from anther.robot.cells.hardware import guarded_arm, motion_params, move_and_stand
from anther.robot.cells.rewriting import point_to_calibration
from anther.robot.devices import Arm, Camera, DeviceError, JointTrajectory
from anther.robot.safety import GuardedCamera
from anther.show.pictures import save_figure
from anther.show.pictures.estimates import draw_calibration

CHECKED = 4
"""Views that a check takes; three must show the board, to tell camera from board."""


@dataclass(slots=True)
class Asking:
    """How a person is asked; `yes`: nobody is, every motion may begin."""

    yes: bool

    def may(self, question: str) -> bool:
        """Return whether a person types yes; all: to this and every later question."""
        if self.yes:
            return True
        answer = self.answer(f"{question} Type yes, or all: ")
        self.yes = answer == "all"
        return answer in ("yes", "all")

    def answer(self, question: str) -> str:
        """Return what a person types; "done" where nobody is there."""
        try:
            return input(question).strip().lower()
        except EOFError:
            return "done"


@dataclass(frozen=True, slots=True, eq=False)
class Eye:
    """A camera that an arm carries, both behind the guard, and the file of their cell."""

    file: CellFile
    arm: Arm
    camera: Camera

    def look(self) -> tuple[NDArray[Any], Array]:
        """Return a grey image (H, W) uint8 and the joints (J,) [rad] of an arm that stands, but for 5 mrad."""
        still = 0.005  # rad
        before, image = self.arm.joints(), cv2.cvtColor(self.camera.read().rgb, cv2.COLOR_RGB2GRAY)
        after = self.arm.joints()
        if (moved := float(np.abs(after - before).max())) > still:
            went = f"the arm moved by {moved:.3f} rad while the picture was taken"
            raise DeviceError(f"{went}; allowed: {still:g}. Hold it still.")
        return image, (before + after) / 2

    def go(self, motion: JointTrajectory) -> None:
        """Move, and stand until the arm has calmed down."""
        move_and_stand(self.arm, motion)

    def planner(self, T_base_board: Array, centre: Array) -> Planner:
        """Return a planner of slow motions around a board; see `board_planner`."""
        motion = motion_params(
            min(self.file.limits.speed_ratio, 0.2)
        )  # whatever the cell allows: somebody stands there
        boxes = list(self.file.keep_out)
        planner = board_planner(T_base_board, centre, boxes, self.file.arm_space, motion, self.file.model)
        if not planner.world.free(self.arm.joints()):
            where = "the arm stands too near to itself, the board or a keep-out box"
            raise StageFailure("collision", f"{where} to plan from there. Jog it away, or move the board.")
        return planner


@contextmanager
def _eye(file: CellFile) -> Iterator[Eye]:
    """Own the cell's arm and connect it, in its own process, and the wrist camera, both behind the guard."""
    with own_cell(file) as keep:
        arm = keep(file.arm_apart())
        camera = keep(file.connect(file.wrist_camera, arm=arm))
        yield Eye(file, guarded_arm(file, arm, keep), GuardedCamera(camera))


def live(
    cell: Path, board: str, *, out: Path | None, intrinsics: Path | None, by_hand: bool = False, yes: bool = False
) -> int:
    """Take views, tell what they give, write the result into the cell file; return 0, or 1 where they lack something.

    The options are those of `anther calibrate`.
    """
    file, ask = read_cell(cell), Asking(yes)
    parse_board(board)
    folder = out or cell.parent / f"{cell.stem}_calibration_{time.strftime('%Y%m%d_%H%M%S')}"
    begun = read_earlier_views(folder, board)
    with _eye(file) as eye:
        camera = eye.camera.intrinsics
        lens = (camera, np.zeros(5)) if intrinsics is None else read_intrinsics(intrinsics)
        taken = begun or Taken(folder, board, *lens)
        check_size(taken.intrinsics, (camera.width, camera.height), "the camera's images")
        try:
            first_look(eye, taken, ask)
            found = gather(eye, taken, ask, by_hand=by_hand)
        except BaseException:
            with suppress(AntherError):  # what went wrong first is what is reported
                eye.arm.hold()
            if len(taken):
                more = f"To go on with them: the same command with --out {folder}"
                print(f"{len(taken)} views are kept in {folder}. {more}")
            raise
    return _conclude(cell, taken, found, ask)


def first_look(eye: Eye, taken: Taken, ask: Asking) -> None:
    """Take the first view from where the arm stands; while the board is not seen a person is told why, and helps."""
    while True:
        image, joints = eye.look()
        view = taken.see(image)
        if view is not None:
            return taken.add(image, view, joints, eye.file.model.forward(joints))
        why = (
            f"the board is not seen from where the arm stands. {explain_missing_board(image, parse_board(taken.board))}"
        )
        if ask.yes:
            raise InputError(why)
        print(why)
        if ask.answer("Bring it into view, or the arm to it; then press Enter (done: give up): ") == "done":
            raise InputError(why)


def gather(eye: Eye, taken: Taken, ask: Asking, *, by_hand: bool = False) -> HandEye | None:
    """Take views until they are enough and the error of a left-out view is steady; return what they give.

    It ends also when a person says so, when no further view can be reached, and after `Taken.most`.
    """
    found = taken.solve()
    history, missed, in_a_row = [found], list[Array](), 0
    _tell(taken, found)
    while len(taken) < taken.most:
        if not lacks(taken, found) and is_steady(history):
            print("the error of a left-out view is steady: enough")
            break
        expected = (_by_hand if by_hand else _by_arm)(eye, taken, found, missed, ask)
        if expected is None:
            break
        image, joints = eye.look()
        view = taken.see(image)
        if view is None:
            missed.append(expected)
            in_a_row += 1
            print(f"the board is not seen. {explain_missing_board(image, parse_board(taken.board))}")
            if in_a_row >= 4 and not by_hand:
                do = "Correct its T_flange_cam in the cell file roughly, give the board more room, or use --by-hand."
                raise StageFailure("device_fault", f"{in_a_row} views did not show the board where it should be. {do}")
            continue
        in_a_row = 0
        taken.add(image, view, joints, eye.file.model.forward(joints))
        found = taken.solve()
        history.append(found)
        _tell(taken, found)
    return found


def _by_arm(eye: Eye, taken: Taken, found: HandEye | None, missed: list[Array], ask: Asking) -> Array | None:
    """Let the arm go to the next view; return T_board_cam (4, 4) there as expected, or None where that is all.

    The arm makes large motions only once the camera's place is known to 1 degree and 1 cm (standard errors), or after
    seven views: then all small turns have been made.
    """
    sure = found is not None and found.rotation_error < np.deg2rad(1) and found.translation_error < 0.01
    known = found is not None and (sure or len(taken) >= 7)
    T_flange_cam = found.T_flange_cam if found is not None and known else eye.file.T_flange_cam
    seen_at = taken.flange[-1] @ T_flange_cam @ taken.T_cam_board[-1]
    T_base_board = found.T_base_board if found is not None and known else seen_at
    options = _rank_places(taken, missed, known=known)
    planner, limits = eye.planner(T_base_board, parse_board(taken.board).centre), eye.file.safety_limits()
    reached = find_first_reachable(planner, limits, eye.arm.joints(), T_base_board @ options @ inverse(T_flange_cam))
    if reached is None:
        print("no further view can be reached in straight lines within the limits")
        return None
    expected, motion = options[reached[0]], reached[1]
    words = _way_in_words(taken, expected)
    if not ask.may(f"view {len(taken) + 1}: {words}. Move there in {motion.duration:.1f} s?"):
        return None
    eye.go(motion)
    return expected


def _rank_places(taken: Taken, missed: list[Array], *, known: bool) -> Array:
    """Return T_board_cam (C, 4, 4) of possible views, the one least like those before first."""
    centre, before = parse_board(taken.board).centre, inverse(taken.T_cam_board)
    options = candidates(before[0], centre, taken.intrinsics, known=known)
    before = np.concatenate([before, np.array(missed).reshape(-1, 4, 4)])
    return options[least_alike(options, before, centre, taken.intrinsics)]


def _by_hand(eye: Eye, taken: Taken, found: HandEye | None, missed: list[Array], ask: Asking) -> Array | None:
    """Ask a person to move the arm; return T_board_cam as asked for, or None where that is all."""
    expected = _rank_places(taken, missed, known=True)[0]
    do = "Move the arm about there, let go, press Enter (done: end): "
    answer = ask.answer(f"view {len(taken) + 1}: {_way_in_words(taken, expected)}. {do}")
    return None if answer == "done" else expected


def _way_in_words(taken: Taken, T_board_cam: Array) -> str:
    """Return how the camera gets from the last view to another (4, 4), as one sees it in the image."""
    T_last_next = taken.T_cam_board[-1] @ T_board_cam
    x, y, z = 100 * T_last_next[:3, 3]
    ways = ((x, "right", "left"), (y, "down", "up"), (z, "nearer", "back"))
    parts = [f"{abs(way):.0f} cm {more if way > 0 else less}" for way, more, less in ways if abs(way) >= 1]
    roll = np.rad2deg(np.arctan2(T_last_next[1, 0], T_last_next[0, 0]))
    if abs(roll) >= 5:
        parts.append(f"rolled by {abs(roll):.0f} deg {'clockwise' if roll > 0 else 'anticlockwise'}")
    centre = parse_board(taken.board).centre
    u, v = taken.intrinsics.project(transform_points(inverse(T_board_cam), centre[None]))[0]
    place = f"{u / taken.intrinsics.width:.0%} from the left and {v / taken.intrinsics.height:.0%} from the top"
    return f"camera {', '.join(parts) or 'where it is'}, with the board's middle {place} of the image"


def _tell(taken: Taken, found: HandEye | None) -> None:
    """Print what the last view showed, how far all of them cover, and what they give."""
    last, turned, known = taken.views[-1], np.rad2deg(taken.largest_turns()), "nothing known yet"
    seen = f"{len(last.corners.pixels[0])} corners to {last.reprojection[0]:.2f} px"
    cover = f"covers {taken.coverage():.0%}, turned by {turned[0]:.0f} and across by {turned[1]:.0f} deg"
    if found is not None:
        turn, shift = np.rad2deg(found.rotation_error), 1e3 * found.translation_error
        known = f"camera known to {turn:.2f} deg, {shift:.1f} mm"
        error = found.methods[-1]
        if np.isfinite(error.left_out_pixel):
            turn, shift = np.rad2deg(error.left_out_rotation), 1e3 * error.left_out_translation
            left_out = f"{error.left_out_pixel:.2f} px, {turn:.2f} deg, {shift:.1f} mm"
            known = f"a view left out errs by {left_out}; {known}"
        known += "" if found.used[-1] else "; THIS VIEW DISAGREES with the others"
    print(f"{len(taken):2} of about {taken.enough}: {seen} | {cover} | {known}")


def _conclude(cell: Path, taken: Taken, found: HandEye | None, ask: Asking) -> int:
    """Write the result; into the cell file too, where nothing lacks and nobody objects. Return the exit code."""
    missing = lacks(taken, found)
    if found is not None:
        save_figure(draw_calibration(found, taken.all_views(), taken.flange), taken.folder / "calibration.png")
    for note in missing:
        print(f"lacking: {note}")
    if found is None or missing:
        print(f"the cell file is unchanged. To take more views: the same command with --out {taken.folder}")
        return 1
    found.save(taken.folder / RESULT)
    print(f"written: {taken.folder / RESULT}, calibration.png")
    if not ask.may(f"Write it into {cell}?"):
        print(f'the cell file is unchanged. Its line would be: calibration = "{taken.folder / RESULT}"')
        return 0
    kept = point_to_calibration(cell, taken.folder / RESULT)
    print(f"written: {cell}; as it was: {kept}. Leave the board where it is, and each morning:")
    print(f"anther calibrate --check --cell {cell}")
    return 0


def check(cell: Path, *, yes: bool = False) -> int:
    """Go to some of the calibration's views and tell whether the camera has moved.

    Returns:
        0 if nothing has, 1 if anything has, 2 where a person said no.
    """
    file, begin = read_cell(cell), time.monotonic()
    folder = _calibration_of(file)
    reference = read_camera_reference(folder)
    intrinsics, distortion = read_intrinsics(folder / INTRINSICS)
    today = Taken(folder, reference.board, intrinsics, distortion)
    with _eye(file) as eye:
        places = _look_again(eye, reference, today, Asking(yes))
    if places is None:
        return 2
    print(f"{len(places)} views in {time.monotonic() - begin:.0f} s")
    anew = f"Calibrate again: anther calibrate --live --cell {cell} --board {reference.board}"
    if len(places) < CHECKED - 1:
        print(
            f"{CHECKED - len(places)} of {CHECKED} views do not show the board: does it stand where it stood, in light?"
        )
        print(f"If so, the camera has moved far. {anew}")
        return 1
    then = reference.T_base_flange[places], reference.T_cam_board[places]
    centre = parse_board(reference.board).centre
    moved = find_movement(reference.found, then, today.flange, today.all_views(), intrinsics, centre)
    print(_in_words(moved))
    if moved.verdict != "still":
        print(anew)
    return int(moved.verdict != "still")


def _look_again(eye: Eye, reference: CameraReference, today: Taken, ask: Asking) -> list[int] | None:
    """Take `today`'s views from places of the calibration; return which show the board, None if not allowed to."""
    centre, here = parse_board(reference.board).centre, eye.arm.joints()
    nearest = int(np.abs(reference.joints - here).max(axis=1).argmin())
    chosen = spread(inverse(reference.T_cam_board), CHECKED, nearest, centre, today.intrinsics)
    planner, motions = eye.planner(reference.found.T_base_board, centre), list[JointTrajectory]()
    for there in reference.joints[chosen]:
        near = np.abs(there - here).max() < 0.01  # rad
        motions.append(JointTrajectory.standstill(here, 0.01) if near else planner.move(here, there))
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


def _in_words(moved: Moved) -> str:
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


def _calibration_of(file: CellFile) -> Path:
    """Return where the calibration is that the cell file names."""
    named = file.source.table["wrist_camera"].get("calibration")
    if named is None:
        given = "a T_flange_cam, which tells nothing to compare with"
        allowed = "calibration = ..., as anther calibrate --live writes it"
        where = file.source.where(("wrist_camera",))
        raise bad_input(where, given=given, allowed=allowed, do="Calibrate once with --live.")
    return (file.source.path.parent / named).parent
