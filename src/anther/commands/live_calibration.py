"""Calibrate the wrist camera of a cell: the arm, or a person, takes it around a board until its place is known."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from anther.arm.board_views import board_planner, first_reached
from anther.arm.planner import Planner
from anther.calibration import BoardViews, HandEye, parse_board, read_intrinsics, why_unseen
from anther.calibration.live import (
    ENOUGH,
    MOST,
    RESULT,
    Taken,
    candidates,
    is_steady,
    lacks,
    least_alike,
    taken_before,
)  # fmt: skip
from anther.cells import CellFile, read_cell
from anther.cells.rewriting import point_to_calibration
from anther.commands.hardware_cell import CALM, arm_and_camera, motion_params
from anther.devices import Arm, Camera, DeviceError, JointTrajectory
from anther.errors import AntherError, InputError, StageFailure
from anther.geometry import Array, inverse, transform_points

SLOW = 0.2
"""Share of the arm's speeds at most, whatever the cell allows: somebody stands beside it."""
STILL = 0.005
"""Joints that differ by more before and after a picture moved meanwhile [rad]."""
KNOWN = float(np.deg2rad(1)), 0.01
"""Standard errors of the camera's place from which on the arm goes far around the board [rad], [m]."""
TRUSTED = 7
"""After so many views it does so in any case: all small turns have been made."""
MISSED = 4
"""So often the board may not be seen where it was expected, one time after the other."""


@dataclass(frozen=True, slots=True)
class Asking:
    """How a person is asked.

    Attributes:
        yes: nobody is: every motion may begin.
        said: "all", once that was answered.
    """

    yes: bool
    said: list[str] = field(default_factory=list)

    def may(self, question: str) -> bool:
        """Return whether a person types yes; all: to this and every later question."""
        if self.yes or self.said:
            return True
        answer = self.answer(f"{question} Type yes, or all: ")
        if answer == "all":
            self.said.append(answer)
        return answer in ("yes", "all")

    def answer(self, question: str) -> str:
        """Return what a person types; "done" where nobody is there."""
        try:
            return input(question).strip().lower()
        except EOFError:
            return "done"


@dataclass(frozen=True, slots=True, eq=False)
class Eye:
    """A camera that an arm carries.

    Attributes:
        file: of the cell.
        arm, camera: behind the guard.
    """

    file: CellFile
    arm: Arm
    camera: Camera

    def look(self) -> tuple[NDArray[Any], Array]:
        """Return a grey image (H, W) uint8 and the joints (J,) [rad] that it was taken from.

        Raises:
            DeviceError: the arm moved meanwhile, or what arm and camera raise.
        """
        before, image = self.arm.joints(), cv2.cvtColor(self.camera.read().rgb, cv2.COLOR_RGB2GRAY)
        after = self.arm.joints()
        if (moved := float(np.abs(after - before).max())) > STILL:
            raise DeviceError(
                f"the arm moved by {moved:.3f} rad while the picture was taken; allowed: {STILL:g}. Hold it still."
            )
        return image, (before + after) / 2

    def go(self, motion: JointTrajectory) -> None:
        """Move, and stand until the arm has calmed down."""
        self.arm.follow(motion)
        self.arm.follow(JointTrajectory.standstill(motion.positions[-1], CALM))

    def planner(self, T_base_board: Array, centre: Array) -> Planner:
        """Return a planner of slow motions around a board; see `board_planner`.

        Raises:
            StageFailure: the arm stands where it cannot begin to plan.
        """
        boxes, motion = [place.box for place in self.file.keep_out], motion_params(self.ratio)
        planner = board_planner(T_base_board, centre, boxes, self.file.arm_space, motion, self.file.model)
        if not planner.world.free(self.arm.joints()):
            where = "the arm stands too near to itself, the board or a keep-out box"
            raise StageFailure("collision", f"{where} to plan from there. Jog it away, or move the board.")
        return planner

    @property
    def ratio(self) -> float:
        """Share of the arm's speeds."""
        return min(self.file.limits.speed_ratio, SLOW)


def live(
    cell: Path,
    board: str,
    *,
    out: Path | None = None,
    intrinsics: Path | None = None,
    by_hand: bool = False,
    yes: bool = False,
) -> int:
    """Take views, tell what they give, write the result into the cell file; return 0, or 1 where they lack something.

    Args:
        cell: the cell file.
        board: as `parse_board` reads it.
        out: folder of the views; one that was begun is gone on with. None: a new one beside the cell file.
        intrinsics: of the camera, instead of its own.
        by_hand: a person moves the arm.
        yes: nobody is asked before a motion.

    Raises:
        AntherError: a bad file or option, no board, or a machine that refuses. Views that were taken are kept.
    """
    file, ask = read_cell(cell), Asking(yes)
    parse_board(board)
    folder = out or cell.parent / f"{cell.stem}_calibration_{time.strftime('%Y%m%d_%H%M%S')}"
    begun = taken_before(folder, board)
    with arm_and_camera(file) as (arm, camera):
        lens = (camera.intrinsics, np.zeros(5)) if intrinsics is None else read_intrinsics(intrinsics)
        taken, eye = begun or Taken(folder, board, *lens), Eye(file, arm, camera)
        _check_size(taken, camera)
        try:
            first_look(eye, taken, ask)
            found = gather(eye, taken, ask, by_hand=by_hand)
        except BaseException:
            with suppress(AntherError):  # what went wrong first is what is reported
                arm.hold()
            if len(taken):
                print(
                    f"{len(taken)} views are kept in {folder}. To go on with them: the same command with --out {folder}"
                )
            raise
    return _concluded(cell, taken, found, ask)


def first_look(eye: Eye, taken: Taken, ask: Asking) -> None:
    """Take the first view from where the arm stands; while the board is not seen a person is told why, and helps.

    Raises:
        InputError: it is not seen, and nobody helps.
    """
    while True:
        image, joints = eye.look()
        view = taken.see(image)
        if view is not None:
            return _keep(eye, taken, image, view, joints)
        why = f"the board is not seen from where the arm stands. {why_unseen(image, parse_board(taken.board))}"
        if ask.yes:
            raise InputError(why)
        print(why)
        if ask.answer("Bring it into view, or the arm to it; then press Enter (done: give up): ") == "done":
            raise InputError(why)


def gather(eye: Eye, taken: Taken, ask: Asking, *, by_hand: bool = False) -> HandEye | None:
    """Take views until they are enough and the error of a left-out view is steady; return what they give.

    It ends also when a person says so, when no further view can be reached, and after `MOST`.

    Raises:
        StageFailure: the arm refuses, or the board is not seen where it was expected.
    """
    found = taken.solved()
    history, missed, in_a_row = [found], list[Array](), 0
    _tell(taken, found)
    while len(taken) < MOST:
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
            print(f"the board is not seen. {why_unseen(image, parse_board(taken.board))}")
            if in_a_row >= MISSED and not by_hand:
                do = "Correct its T_flange_cam in the cell file roughly, give the board more room, or use --by-hand."
                raise StageFailure("device_fault", f"{MISSED} views did not show the board where it should be. {do}")
            continue
        in_a_row = 0
        _keep(eye, taken, image, view, joints)
        found = taken.solved()
        history.append(found)
        _tell(taken, found)
    return found


def proposed(
    eye: Eye, taken: Taken, found: HandEye | None, missed: list[Array]
) -> tuple[Array, JointTrajectory] | None:
    """Return T_board_cam (4, 4) of the next view and the motion to it; None where none is within reach."""
    T_flange_cam, T_base_board, known = _believed(eye.file, taken, found)
    options = _ranked(taken, missed, known=known)
    centre = parse_board(taken.board).centre
    planner, limits = eye.planner(T_base_board, centre), eye.file.safety_limits()
    reached = first_reached(planner, limits, eye.arm.joints(), T_base_board @ options @ inverse(T_flange_cam))
    return None if reached is None else (options[reached[0]], reached[1])


def _believed(file: CellFile, taken: Taken, found: HandEye | None) -> tuple[Array, Array, bool]:
    """Return T_flange_cam, T_base_board and whether they are known well enough for large motions."""
    sure = found is not None and found.rotation_error < KNOWN[0] and found.translation_error < KNOWN[1]
    if found is not None and (sure or len(taken) >= TRUSTED):
        return found.T_flange_cam, found.T_base_board, True
    return file.T_flange_cam, taken.flange[-1] @ file.T_flange_cam @ taken.T_cam_board[-1], False


def _ranked(taken: Taken, missed: list[Array], *, known: bool) -> Array:
    """Return T_board_cam (C, 4, 4) of possible views, the one least like those before first."""
    centre, before = parse_board(taken.board).centre, inverse(taken.T_cam_board)
    options = candidates(before[0], centre, taken.intrinsics, known=known)
    before = np.concatenate([before, np.array(missed).reshape(-1, 4, 4)])
    return options[least_alike(options, before, centre, taken.intrinsics)]


def _by_arm(eye: Eye, taken: Taken, found: HandEye | None, missed: list[Array], ask: Asking) -> Array | None:
    """Let the arm go to the next view; return T_board_cam there as expected, or None where that is all."""
    offer = proposed(eye, taken, found, missed)
    if offer is None:
        print("no further view can be reached in straight lines within the limits")
        return None
    expected, motion = offer
    words = _way_in_words(taken, expected)
    if not ask.may(f"view {len(taken) + 1}: {words}. Move there in {motion.duration:.1f} s?"):
        return None
    eye.go(motion)
    return expected


def _by_hand(eye: Eye, taken: Taken, found: HandEye | None, missed: list[Array], ask: Asking) -> Array | None:
    """Ask a person to move the arm; return T_board_cam as asked for, or None where that is all."""
    expected = _ranked(taken, missed, known=True)[0]
    words = _way_in_words(taken, expected)
    if (
        ask.answer(f"view {len(taken) + 1}: {words}. Move the arm about there, let go, press Enter (done: end): ")
        == "done"
    ):
        return None
    return expected


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


def _keep(eye: Eye, taken: Taken, image: NDArray[Any], view: BoardViews, joints: Array) -> None:
    taken.add(image, view, joints, eye.file.model.forward(joints))


def _tell(taken: Taken, found: HandEye | None) -> None:
    """Print what the last view showed, how far all of them cover, and what they give."""
    last, turned = taken.views[-1], np.rad2deg(taken.turned())
    seen = f"{len(last.corners.pixels[0])} corners to {last.reprojection[0]:.2f} px"
    cover = f"covers {taken.covered():.0%}, turned by {turned[0]:.0f} and across by {turned[1]:.0f} deg"
    print(f"{len(taken):2} of about {ENOUGH}: {seen} | {cover} | {_known(found)}")


def _known(found: HandEye | None) -> str:
    if found is None:
        return "nothing known yet"
    error, left_out = found.methods[-1], ""
    if np.isfinite(error.left_out_pixel):
        left_out = f"a view left out errs by {error.left_out_pixel:.2f} px, "
        left_out += f"{np.rad2deg(error.left_out_rotation):.2f} deg, {1e3 * error.left_out_translation:.1f} mm; "
    camera = f"camera known to {np.rad2deg(found.rotation_error):.2f} deg, {1e3 * found.translation_error:.1f} mm"
    return f"{left_out}{camera}{'' if found.used[-1] else '; THIS VIEW DISAGREES with the others'}"


def _check_size(taken: Taken, camera: Camera) -> None:
    given = taken.intrinsics
    size = camera.intrinsics.width, camera.intrinsics.height
    if (given.width, given.height) != size:
        raise InputError(
            f"intrinsics: got {given.width} x {given.height} px; allowed: {size[0]} x {size[1]} px, as the camera's "
            f"images. Give those of this resolution."
        )


def _concluded(cell: Path, taken: Taken, found: HandEye | None, ask: Asking) -> int:
    """Write the result; into the cell file too, where nothing lacks and nobody objects. Return the exit code."""
    from anther.files import replacing
    from anther.pictures.calibration import draw_calibration

    missing = lacks(taken, found)
    if found is not None:
        with replacing(taken.folder / "calibration.png") as temporary:
            draw_calibration(found, taken.all_views(), taken.flange).savefig(temporary, dpi=110)
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
