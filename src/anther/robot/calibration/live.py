"""Calibrating with the robot: views taken one after the other, and from where to look at the board next.

Each view is on disk before the next, and all are solved as far as they go. The folder is one that `anther calibrate
--images` takes: grey images, `poses.csv`, `intrinsics.json`. `views.json` has what a later check of the camera needs
beside `calibration.json`: the board, and of each view the arm's joints and where the board was seen.

Errors go with 1 / turn and with 1 / sin of the angle between rotation axes, and grow with the camera's distance (Tsai
and Lenz 1989, section VI): candidates for the next view are near, tilted to all sides and rolled, and it is the one
least like those that were taken. V views, J joints, C candidates.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import qmc

from anther.core.checks import check_array
from anther.core.errors import InputError, bad_input
from anther.core.files import made_folder, read_object, replacing, understood, write_json, write_text
from anther.core.geometry import (
    Array,
    Intrinsics,
    inverse,
    look_at,
    pose7,
    transform,
    transform_from_pose7,
    transform_points,
)  # fmt: skip
from anther.core.opencv import cv2
from anther.robot.calibration import LOOSE, HandEye, calibrate
from anther.robot.calibration._inputs import COLUMNS, Board, parse_board
from anther.robot.calibration._intrinsics import read_intrinsics
from anther.robot.calibration._views import (
    BoardCorners,
    BoardViews,
    board_views,
    find_corners,
    flange_motions,
    image_coverage,
    motion_warnings,
    undistort,
)  # fmt: skip

KIND, SCHEMA = "calibration-views", 1
_POSES = ("T_base_flange", "T_cam_board")
VIEWS, POSES, INTRINSICS, RESULT = "views.json", "poses.csv", "intrinsics.json", "calibration.json"


@dataclass(eq=False)
class Taken:
    """Views of a board so far.

    Attributes:
        folder: where they are kept.
        board: as the command line writes it, see `parse_board`.
        intrinsics: of the camera.
        distortion: of its lens, in OpenCV's order, in the images.
        joints: V arrays (J,) [rad].
        T_base_flange: V arrays (4, 4).
        views: V views, each of one image.
        names: of the V images.
        enough, most: views: fewer are never enough, and more are not asked for (docs/calibration.md: 15 to 20).
        covered: share of the image that corners should cover [-].
    """

    enough: ClassVar[int] = 10
    most: ClassVar[int] = 24
    covered: ClassVar[float] = 0.4
    folder: Path
    board: str
    intrinsics: Intrinsics
    distortion: Array
    joints: list[Array] = field(default_factory=list)
    T_base_flange: list[Array] = field(default_factory=list)
    views: list[BoardViews] = field(default_factory=list)
    names: list[str] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.names)

    @property
    def flange(self) -> Array:
        """(V, 4, 4) T_base_flange."""
        return np.stack(self.T_base_flange)

    @property
    def T_cam_board(self) -> Array:
        """(V, 4, 4)."""
        return np.concatenate([view.T_cam_board for view in self.views])

    def see(self, image: NDArray[Any]) -> BoardViews | None:
        """Return the one view of the board in a grey image (H, W) uint8; None where it is not seen.

        Raises:
            InputError: what is seen is another board.
        """
        return find_board(image, parse_board(self.board), self.intrinsics, self.distortion)

    def add(self, image: NDArray[Any], view: BoardViews, joints: Array, T_base_flange: Array) -> None:
        """Keep a view, on disk too.

        Args:
            image: (H, W) grey uint8.
            view: of it, from `see`.
            joints: (J,) [rad].
            T_base_flange: (4, 4).

        Raises:
            InputError: the folder cannot be written.
        """
        name = f"view_{len(self) + 1:02}.png"
        made_folder(self.folder)
        with replacing(self.folder / name) as temporary:
            cv2.imwrite(str(temporary), image)
        self.take(view, joints, T_base_flange, name)
        self._write()

    def take(self, view: BoardViews, joints: Array, T_base_flange: Array, name: str = "") -> None:
        """Take a view without writing it; the arguments are as in `add`."""
        self.names.append(name or str(len(self)))
        self.joints.append(np.asarray(joints, dtype=np.float64))
        self.T_base_flange.append(T_base_flange)
        self.views.append(view)

    def all_views(self) -> BoardViews:
        """Return the views as one."""
        points, pixels = (tuple(getattr(v.corners, name)[0] for v in self.views) for name in ("points", "pixels"))
        corners = BoardCorners(np.arange(len(self)), points, pixels)
        return BoardViews(corners, self.T_cam_board, np.concatenate([v.reprojection for v in self.views]))

    def solve(self) -> HandEye | None:
        """Return the hand-eye transform, or None while the views do not determine it."""
        if len(self) < 3:
            return None
        try:
            return calibrate(
                self.flange,
                self.all_views(),
                self.intrinsics,
                images=tuple(self.names),
                distortion=self.distortion,
            )
        except InputError:
            return None

    def coverage(self) -> float:
        """Return the share of the image that corners cover, see `image_coverage`."""
        return image_coverage(np.concatenate([v.corners.pixels[0] for v in self.views]), self.intrinsics)

    def largest_turns(self) -> tuple[float, float]:
        """Return the flange's largest turn between views, and the largest across its axis [rad]."""
        if len(self) < 2:
            return 0.0, 0.0
        motions = flange_motions(self.flange)
        return motions.largest, motions.second

    def _write(self) -> None:
        write_json(self.folder / INTRINSICS, asdict(self.intrinsics) | {"distortion": self.distortion})
        rows = [
            ",".join([name, *(f"{x:.9f}" for x in pose7(T))])
            for name, T in zip(self.names, self.T_base_flange, strict=True)
        ]
        write_text(self.folder / POSES, "\n".join([",".join(COLUMNS), *rows]) + "\n")
        views = {
            name: {"joints": q, "T_base_flange": pose7(T), "T_cam_board": pose7(view.T_cam_board[0])}
            for name, q, T, view in zip(self.names, self.joints, self.T_base_flange, self.views, strict=True)
        }
        write_json(self.folder / VIEWS, {"kind": KIND, "schema": SCHEMA, "board": self.board, "views": views})


def find_board(image: NDArray[Any], board: Board, intrinsics: Intrinsics, distortion: Array) -> BoardViews | None:
    """Return the board in a grey image (H, W) uint8; None where too few of its corners are seen, see `find_corners`.

    Raises:
        InputError: what is seen is another board.
    """
    try:
        corners = find_corners([image], board)
    except InputError:
        return None
    view = board_views(undistort(corners, intrinsics, distortion), intrinsics)
    if view.reprojection[0] > 3:
        raise bad_input(
            "board",
            given=f"corners that miss those of a flat {board} by {view.reprojection[0]:.1f} px",
            allowed="<= 3 px",
            do="Is --board what was printed, is it flat, and are the camera's intrinsics its own?",
        )
    return view


@dataclass(frozen=True, slots=True, eq=False)
class CameraReference:
    """What a check of the camera compares with.

    Attributes:
        found: the calibration.
        board: as the command line writes it.
        joints: (V, J) of its views that took part [rad].
        T_base_flange: (V, 4, 4) of them.
        T_cam_board: (V, 4, 4) where the board was seen.
    """

    found: HandEye
    board: str
    joints: Array
    T_base_flange: Array
    T_cam_board: Array


def read_camera_reference(folder: Path | str) -> CameraReference:
    """Read what a live calibration left in its folder.

    Raises:
        InputError: a file is missing, or holds something else.
    """
    found, (board, rows) = HandEye.load(Path(folder) / RESULT), _read_views(Path(folder))
    used = [name for name, kept in zip(found.images, found.used, strict=True) if kept]
    with understood(Path(folder) / VIEWS, "the views of the calibration beside it", "Calibrate again."):
        flange, cam = (np.stack([transform_from_pose7(rows[n][key]) for n in used]) for key in _POSES)
        joints = check_array("joints", [rows[n]["joints"] for n in used], (len(used), None))
        return CameraReference(found, board, joints, flange, cam)


def read_earlier_views(folder: Path, board: str) -> Taken | None:
    """Return the views of a calibration that was interrupted; None where there are none in the folder.

    Raises:
        InputError: the folder holds a finished calibration, views of another board, or damaged files.
    """
    if not (folder / VIEWS).exists():
        return None
    if (folder / RESULT).exists():
        raise bad_input(str(folder), given="a finished calibration", allowed="a new folder", do="Leave out --out.")
    was, rows = _read_views(folder)
    if was != board:
        raise bad_input("board", given=board, allowed=f"{was}, as in {folder}", do="Give the same, or another --out.")
    intrinsics, distortion = read_intrinsics(folder / INTRINSICS)
    taken = Taken(folder, board, intrinsics, distortion)
    with understood(folder / VIEWS, "the views of a calibration", "Begin anew in another folder."):
        for name, row in rows.items():
            image = cv2.imread(str(folder / name), cv2.IMREAD_GRAYSCALE)
            view = None if image is None else taken.see(image)
            if view is None:
                raise bad_input(str(folder / name), given="no image of the board", allowed="one", do="Begin anew.")
            joints = check_array("joints", row["joints"], (None,))
            taken.take(view, joints, transform_from_pose7(row["T_base_flange"]), name)
    return taken


def _read_views(folder: Path) -> tuple[str, dict[str, Any]]:
    path = folder / VIEWS
    stored = read_object(path)
    if (stored.get("kind"), stored.get("schema")) != (KIND, SCHEMA):
        allowed = f"views written by anther calibrate --live, schema {SCHEMA}"
        raise bad_input(str(path), given="something else", allowed=allowed, do="Calibrate again.")
    with understood(path, "a whole file", "Calibrate again."):
        parse_board(stored["board"])
        return str(stored["board"]), dict(stored["views"])


def is_steady(history: list[HandEye | None]) -> bool:
    """Return whether the last views changed the error of a left-out view by no more than a fifth.

    Args:
        history: what was found after each view.
    """
    last = history[-4:]
    errors = np.array([np.nan if found is None else found.methods[-1].left_out_pixel for found in last])
    few = len(last) < 4 or not np.isfinite(errors).all()
    return not few and float(errors.max() / errors.min() - 1) <= 0.2


def lacks(taken: Taken, found: HandEye | None) -> list[str]:
    """Return what the views lack for a good result, one sentence each; nothing when they are enough."""
    if found is None:
        return [f"{len(taken)} views, which do not determine where the camera is: take {taken.enough} or more, tilted"]
    notes = list(motion_warnings(taken.flange[found.used]))
    out = int((~found.used).sum())
    if out > len(taken) / 3:
        notes.append(f"{out} of {len(taken)} views disagree with the others: has the board or the camera moved?")
    if found.translation_error > LOOSE:
        open_by = 1e3 * found.translation_error
        notes.append(f"the views leave the camera's place open by {open_by:.1f} mm: take more, tilted more")
    if (covered := taken.coverage()) < taken.covered:
        notes.append(f"the corners cover {covered:.0%} of the image: show the board in its corners too")
    return notes


MARGIN = 0.04
"""Share of the image: the frame that the board keeps out of, where lenses are worst [-]."""


def candidates(T_board_cam_first: Array, centre: Array, intrinsics: Intrinsics, *, known: bool) -> Array:
    """Return T_board_cam (C, 4, 4) of cameras that see the whole board.

    Args:
        T_board_cam_first: (4, 4) of the first view; upright is as it was there.
        centre: (3,) of the board [m]; the board reaches as far on its other side.
        intrinsics: of the camera.
        known: whether the camera's place on the flange is known well enough for large motions. If not: small turns of
            the first view about the board.
    """
    if not known:
        turns = Rotation.from_rotvec(np.deg2rad(12) * np.concatenate([np.eye(3), -np.eye(3)])).as_matrix()
        about = np.stack([transform(R, centre - R @ centre) for R in turns])
        return about @ T_board_cam_first
    side = np.sign(T_board_cam_first[2, 3]) or -1.0
    fills = np.linalg.norm(centre) * 2 * intrinsics.fx / (0.8 * min(intrinsics.width, intrinsics.height))
    near = max(0.25, fills)  # [m]; the board fills at most 0.8 of the image's lesser side
    draws = qmc.Halton(6, scramble=False).random(257)[1:]
    poses = np.stack([_pose(draw, T_board_cam_first, centre, side, float(near), intrinsics) for draw in draws])
    return poses[sees_board(poses, centre, intrinsics)]


def sees_board(T_board_cam: Array, centre: Array, intrinsics: Intrinsics) -> NDArray[np.bool_]:
    """Return (C,) whether each of (C, 4, 4) cameras sees all of the board, within the image's `MARGIN`."""
    size = np.array([intrinsics.width, intrinsics.height])
    corners = centre + centre * np.array([[-1, -1, 0], [-1, 1, 0], [1, -1, 0], [1, 1, 0]])
    pixels = np.stack([intrinsics.project(transform_points(inverse(T), corners)) for T in T_board_cam])
    inside = (pixels > MARGIN * size) & (pixels < (1 - MARGIN) * size)  # NaN, behind the camera, is not inside
    return np.asarray(inside.all(axis=(1, 2)))


def differences(T_board_cam: Array, others: Array, centre: Array, intrinsics: Intrinsics) -> Array:
    """Return (C, V) how unlike the views from (C, 4, 4) and (V, 4, 4) are [-].

    Views count as equally far apart that differ by 30 degrees, by a quarter of the width in the place of the board in
    the image, or by 0.3 in the logarithm of its distance: a choice.
    """
    turn = Rotation.from_matrix(
        np.einsum("cji,vjk->cvik", T_board_cam[:, :3, :3], others[:, :3, :3]).reshape(-1, 3, 3)
    ).magnitude()
    (place, far), (place_other, far_other) = (_place(T, centre, intrinsics) for T in (T_board_cam, others))
    shift = np.linalg.norm(place[:, None] - place_other[None], axis=2)
    nearer = far[:, None] - far_other[None]
    return np.sqrt((turn.reshape(shift.shape) / np.deg2rad(30)) ** 2 + (shift / 0.25) ** 2 + (nearer / 0.3) ** 2)


def least_alike(T_board_cam: Array, taken: Array, centre: Array, intrinsics: Intrinsics) -> NDArray[np.intp]:
    """Return the numbers (C,) of the candidates (C, 4, 4), first the one least like all of the (V, 4, 4) taken."""
    nearest = differences(T_board_cam, taken, centre, intrinsics).min(axis=1)
    return np.argsort(-nearest, kind="stable")


def spread(T_board_cam: Array, count: int, first: int, centre: Array, intrinsics: Intrinsics) -> list[int]:
    """Return up to `count` of the views (V, 4, 4), `first` and then always the one least like those before."""
    chosen = [first]
    while len(chosen) < min(count, len(T_board_cam)):
        chosen.append(int(least_alike(T_board_cam, T_board_cam[chosen], centre, intrinsics)[0]))
    return chosen


def _pose(draw: Array, first: Array, centre: Array, side: float, near: float, intrinsics: Intrinsics) -> Array:
    """Return T_board_cam (4, 4) of six numbers from 0 to 1."""
    most = np.deg2rad(60)  # about the optical axis from the first view; docs/calibration.md: 20 to 40 deg between views
    tilt, azimuth, roll = draw[:3] * [np.deg2rad(40), 2 * np.pi, 2 * most] - [0, 0, most]
    ray = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), side * np.cos(tilt)])
    distance = near * 1.7 ** draw[3]
    size = np.array([intrinsics.width, intrinsics.height])
    reach = intrinsics.fx * np.linalg.norm(centre[:2]) / distance
    room = np.maximum(size * (0.5 - MARGIN) - reach, 0)  # that the board has around it in the image [px]
    right, down = np.arctan2((2 * draw[4:] - 1) * room, intrinsics.fx)
    pose = look_at(centre + distance * ray, centre, up=-first[:3, 1])
    turns = Rotation.from_euler("z", roll) * Rotation.from_euler("xy", [down, -right])
    return pose @ transform(turns.as_matrix(), np.zeros(3))


def _place(T_board_cam: Array, centre: Array, intrinsics: Intrinsics) -> tuple[Array, Array]:
    """Return where (V, 4, 4) cameras see the board's centre (V, 2) [of the width], and log its distance (V,)."""
    seen = np.stack([transform_points(inverse(T), centre[None])[0] for T in T_board_cam])
    depth = np.maximum(np.abs(seen[:, 2]), 1e-3)
    return seen[:, :2] / depth[:, None] * intrinsics.fx / intrinsics.width, np.log(np.linalg.norm(seen, axis=1))
