"""Views of a board taken one after the other: each is on disk before the next, and solved as far as they go.

The folder is one that `anther calibrate --images` takes: grey images, `poses.csv`, `intrinsics.json`. `views.json` has
what a later check of the camera needs beside `calibration.json`: the board, and of each view the arm's joints and where
the board was seen. V views, J joints.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from anther.calibration import LOOSE, HandEye, calibrate
from anther.calibration._boards import Board, parse_board
from anther.calibration._pose_file import COLUMNS, read_intrinsics
from anther.calibration._views import (
    BoardCorners,
    BoardViews,
    board_views,
    find_corners,
    flange_motions,
    image_coverage,
    motion_warnings,
    undistorted,
)
from anther.checks import check_array
from anther.errors import InputError, bad_input
from anther.files import made_folder, read_object, replacing, understood, write_json, write_text
from anther.geometry import (
    Array,
    Intrinsics,
    pose7,
    transform_from_pose7,
)

KIND, SCHEMA = "calibration-views", 1
_POSES = ("T_base_flange", "T_cam_board")
VIEWS, POSES, INTRINSICS, RESULT = "views.json", "poses.csv", "intrinsics.json", "calibration.json"
LEAST_CORNERS = 8
UNLIKE = 3.0
"""Corners that miss a flat board by more than this are of another board, or one that is bent [px]."""
ENOUGH, MOST = 10, 24
"""Views: fewer are never enough, and more are not asked for (docs/calibration.md: 15 to 20)."""
SETTLED_VIEWS, SETTLED = 3, 0.2
"""The error of a left-out view is steady when the last so many views changed it by no more than this share."""
COVERED = 0.4
"""Share of the image that corners should cover [-]."""


@dataclass(eq=False)
class Taken:
    """Views of a board so far.

    Attributes:
        folder: where they are kept.
        board: as the command line writes it, see `parse_board`.
        intrinsics: of the camera.
        distortion: (5,) of its lens, in the images.
        joints: V arrays (J,) [rad].
        T_base_flange: V arrays (4, 4).
        views: V views, each of one image.
        names: of the V images.
    """

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
        return seen(image, parse_board(self.board), self.intrinsics, self.distortion)

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

    def solved(self) -> HandEye | None:
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

    def covered(self) -> float:
        """Return the share of the image that corners cover, see `image_coverage`."""
        return image_coverage(np.concatenate([v.corners.pixels[0] for v in self.views]), self.intrinsics)

    def turned(self) -> tuple[float, float]:
        """Return the flange's largest turn between views, and the largest across its axis [rad]."""
        if len(self) < 2:
            return 0.0, 0.0
        motions = flange_motions(self.flange)
        return motions.largest, motions.second

    def _write(self) -> None:
        lens = dict(zip(("k1", "k2", "p1", "p2", "k3"), map(float, self.distortion), strict=True))
        write_json(self.folder / INTRINSICS, asdict(self.intrinsics) | lens)
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


def seen(image: NDArray[Any], board: Board, intrinsics: Intrinsics, distortion: Array) -> BoardViews | None:
    """Return the board in a grey image (H, W) uint8; None where fewer than `LEAST_CORNERS` of its corners are seen.

    Raises:
        InputError: what is seen is another board.
    """
    try:
        corners = find_corners([image], board, LEAST_CORNERS)
    except InputError:
        return None
    view = board_views(undistorted(corners, intrinsics, distortion), intrinsics)
    if view.reprojection[0] > UNLIKE:
        raise bad_input(
            "board",
            given=f"corners that miss those of a flat {board} by {view.reprojection[0]:.1f} px",
            allowed=f"<= {UNLIKE:g} px",
            do="Is --board what was printed, is it flat, and are the camera's intrinsics its own?",
        )
    return view


@dataclass(frozen=True, slots=True, eq=False)
class Record:
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


def read_record(folder: Path | str) -> Record:
    """Read what a live calibration left in its folder.

    Raises:
        InputError: a file is missing, or holds something else.
    """
    found, (board, rows) = HandEye.load(Path(folder) / RESULT), _read_views(Path(folder))
    used = [name for name, kept in zip(found.images, found.used, strict=True) if kept]
    with understood(Path(folder) / VIEWS, "the views of the calibration beside it", "Calibrate again."):
        flange, cam = (np.stack([transform_from_pose7(rows[n][key]) for n in used]) for key in _POSES)
        joints = check_array("joints", [rows[n]["joints"] for n in used], (len(used), None))
        return Record(found, board, joints, flange, cam)


def taken_before(folder: Path, board: str) -> Taken | None:
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
    """Return whether the last views changed the error of a left-out view by no more than `SETTLED`.

    Args:
        history: what was found after each view.
    """
    last = history[-SETTLED_VIEWS - 1 :]
    errors = np.array([np.nan if found is None else found.methods[-1].left_out_pixel for found in last])
    few = len(last) <= SETTLED_VIEWS or not np.isfinite(errors).all()
    return not few and float(errors.max() / errors.min() - 1) <= SETTLED


def lacks(taken: Taken, found: HandEye | None) -> list[str]:
    """Return what the views lack for a good result, one sentence each; nothing when they are enough."""
    if found is None:
        return [f"{len(taken)} views, which do not determine where the camera is: take {ENOUGH} or more, tilted"]
    notes = list(motion_warnings(taken.flange[found.used]))
    out = int((~found.used).sum())
    if out > len(taken) / 3:
        notes.append(f"{out} of {len(taken)} views disagree with the others: has the board or the camera moved?")
    if found.translation_error > LOOSE:
        open_by = 1e3 * found.translation_error
        notes.append(f"the views leave the camera's place open by {open_by:.1f} mm: take more, tilted more")
    if (covered := taken.covered()) < COVERED:
        notes.append(f"the corners cover {covered:.0%} of the image: show the board in its corners too")
    return notes
