"""What a user brings: a board, and the flange's poses by image name (CSV or JSON).

Of a board: what was printed, how the command line writes it, and where its corners are in an image.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from anther.core.checks import check_range
from anther.core.errors import InputError, bad_input
from anther.core.files import existing, number, read_json, read_rows
from anther.core.geometry import Array, transform_from_pose7
from anther.core.opencv import cv2
from anther.core.records import Range, Record

SPECS = (
    "charuco:7x5:30mm:22mm[:DICT_4X4_50] (squares, square, marker, dictionary) or chessboard:9x6:25mm (inner corners)"
)


@dataclass(frozen=True, slots=True)
class CharucoBoard(Record):
    """A ChArUco board: a chessboard whose white squares hold ArUco markers, so that a part of it is enough.

    Attributes:
        columns, rows: number of squares.
        square, marker: edge lengths [m], marker < square.
        dictionary: name of the ArUco dictionary.
        legacy: whether it was generated with OpenCV before 4.6 (a board with an even number of rows then starts with
            a white square; opencv/opencv_contrib, `CharucoBoard.setLegacyPattern`).
    """

    CALLED = "board"
    columns: Annotated[int, Range(3, 50)] = 7
    rows: Annotated[int, Range(3, 50)] = 5
    square: Annotated[float, Range(0.002, 1, "m")] = 0.030
    marker: float = 0.022
    dictionary: str = "DICT_4X4_50"
    legacy: bool = False
    _printed: Any = field(default=None, init=False, repr=False, compare=False)

    def _check(self) -> None:
        check_range("board marker", self.marker, 0.001, self.square * 0.99, "m")
        if not (self.dictionary.startswith("DICT_") and hasattr(cv2.aruco, self.dictionary)):
            raise bad_input(
                "board dictionary",
                given=self.dictionary,
                allowed="an OpenCV name such as DICT_4X4_50",
                do="Correct it.",
            )
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        markers = self.columns * self.rows // 2
        if markers > len(dictionary.bytesList):
            raise bad_input(
                "board dictionary",
                given=f"{self.dictionary} with {len(dictionary.bytesList)} markers",
                allowed=f"one with the {markers} markers of {self.columns} x {self.rows} squares",
                do="Name the dictionary the board was printed with.",
            )
        printed = cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, dictionary)
        printed.setLegacyPattern(self.legacy)
        object.__setattr__(self, "_printed", printed)

    def __str__(self) -> str:
        sizes = f"{self.square * 1e3:g} mm squares, {self.marker * 1e3:g} mm markers"
        return f"ChArUco board of {self.columns} x {self.rows} squares, {sizes}, {self.dictionary}"

    @property
    def centre(self) -> Array:
        """The (3,) middle of the board in its own frame [m]."""
        return np.array([self.columns * self.square / 2, self.rows * self.square / 2, 0])

    def find(self, image: NDArray[Any]) -> tuple[Array, Array]:
        """Return (n, 3) corners in the board frame [m] and (n, 2) where they are in the image [px]; n may be 0."""
        corners, ids, _, _ = cv2.aruco.CharucoDetector(self._printed).detectBoard(np.ascontiguousarray(image))
        if ids is None or len(ids) == 0:
            return np.empty((0, 3)), np.empty((0, 2))
        known, seen = self._printed.matchImagePoints(corners, ids)
        return np.asarray(known, dtype=np.float64).reshape(-1, 3), np.asarray(seen, dtype=np.float64).reshape(-1, 2)


@dataclass(frozen=True, slots=True)
class Chessboard(Record):
    """A plain chessboard; a view counts only where all inner corners are seen.

    Attributes:
        columns, rows: number of inner corners, as OpenCV counts them; one even and one odd, or else nobody can tell
            the board from itself turned by half a turn.
        square: edge length [m].
    """

    CALLED = "board"
    columns: Annotated[int, Range(3, 50)] = 9
    rows: Annotated[int, Range(3, 50)] = 6
    square: Annotated[float, Range(0.002, 1, "m")] = 0.025

    def _check(self) -> None:
        if (self.columns - self.rows) % 2 == 0:
            raise bad_input(
                "chessboard",
                given=f"{self.columns} x {self.rows} inner corners, which look the same upside down",
                allowed="one even and one odd number of inner corners, as 9x6",
                do="Cover a row of squares, or print another board.",
            )

    def __str__(self) -> str:
        return f"chessboard of {self.columns} x {self.rows} inner corners, {self.square * 1e3:g} mm squares"

    @property
    def centre(self) -> Array:
        """The (3,) middle of the board in its own frame [m]; the origin is an inner corner."""
        return np.array([(self.columns - 1) * self.square / 2, (self.rows - 1) * self.square / 2, 0])

    def find(self, image: NDArray[Any]) -> tuple[Array, Array]:
        """Return (n, 3) corners in the board frame [m] and (n, 2) where they are in the image [px]; n may be 0."""
        grey = np.ascontiguousarray(image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
        row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
        for flags in (cv2.CALIB_CB_ACCURACY, cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE):
            found, corners = cv2.findChessboardCornersSB(grey, (self.columns, self.rows), flags=flags)
            seen = np.asarray(corners, dtype=np.float64).reshape(-1, 2) if found else np.empty((0, 2))
            if found and self._alternates(grey, seen):
                return self.square * np.stack([column, row, np.zeros(len(row))], axis=1), seen
        return np.empty((0, 3)), np.empty((0, 2))

    def _alternates(self, grey: NDArray[Any], seen: Array) -> bool:
        """Return whether the squares between the corners are dark and light in turn.

        OpenCV at times finds a board of 6x5 corners as 5x6, with a line of corners in the white margin.
        """
        grid = seen.reshape(self.rows, self.columns, 2)
        middle = (grid[1:, 1:] + grid[1:, :-1] + grid[:-1, 1:] + grid[:-1, :-1]) / 4
        u, v = np.moveaxis(middle.astype(np.float32), 2, 0)
        light = cv2.remap(cv2.blur(grey, (3, 3)), u, v, cv2.INTER_LINEAR).astype(np.float64)
        sign = 1.0 - 2 * (np.indices(light.shape).sum(axis=0) % 2)
        steps = np.concatenate([(np.diff(light, axis=k) * np.delete(sign, 0, axis=k)).ravel() for k in (0, 1)])
        return bool(np.all(steps > 0) or np.all(steps < 0))


Board = CharucoBoard | Chessboard


DICTIONARIES = ("DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_ARUCO_ORIGINAL")
LEAST_CORNERS = 8
"""Corners that a view needs, and that tell one board from another."""


def explain_missing_board(image: NDArray[Any], board: Board) -> str:
    """Return what a grey image (H, W) uint8 without the board shows instead, in a sentence."""
    grey = float(image.mean())
    if not 20 <= grey <= 235:
        return f"The image is {'dark' if grey < 20 else 'overexposed'} (mean grey {grey:.0f} of 255): mind the light."
    if isinstance(board, CharucoBoard):
        markers = _markers(image, board.dictionary)
        if markers >= 2:
            alike = {text: len(other.find(image)[0]) for text, other in _alike(board).items()}
            text, count = max(alike.items(), key=lambda other: other[1])
            if count > max(len(board.find(image)[0]), LEAST_CORNERS):
                return f"{markers} of its markers are seen, but they are another board's: {text}"
            do = "Show more of it, nearer; is it printed as --board says (squares, dictionary, :legacy)?"
            return f"{markers} of its markers are seen, but too few corners between them. {do}"
        others = {name: _markers(image, name) for name in DICTIONARIES if name[:8] != board.dictionary[:8]}
        name, count = max(others.items(), key=lambda other: other[1])
        if count >= 4:
            kind = name.removesuffix("_1000")
            return f"It shows {count} markers of {kind}: append the board's own dictionary to --board."
    return "Nothing of it is found: bring it into view, 0.3 to 0.6 m in front of the camera, all of it, in focus."


def _alike(board: CharucoBoard) -> dict[str, CharucoBoard]:
    """Return boards that this one is easily taken for, by what to do."""
    pattern = (
        "take :legacy off --board."
        if board.legacy
        else (
            "it was printed with OpenCV before 4.6: append :legacy to --board, behind its dictionary "
            f"({board.dictionary})."
        )
    )
    turned = replace(board, columns=board.rows, rows=board.columns)
    sizes = f"give --board {board.rows}x{board.columns} squares, not {board.columns}x{board.rows}"
    return {
        pattern: replace(board, legacy=not board.legacy),
        f"{sizes}.": turned,
        f"{sizes}, and {'no ' if board.legacy else ''}:legacy.": replace(turned, legacy=not board.legacy),
    }


def _markers(image: NDArray[Any], name: str) -> int:
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)))
    return len(detector.detectMarkers(np.ascontiguousarray(image))[0])


def parse_board(text: str) -> Board:
    """Return the board that `text` describes: "charuco:7x5:30mm:22mm" or "chessboard:9x6:25mm".

    Sizes carry their unit (mm, cm, m). A ChArUco board may name its dictionary, by default DICT_4X4_50, and then
    ":legacy" (see `CharucoBoard`).

    Raises:
        InputError: the text is not understood, or there is no such board.
    """
    kind, *parts = text.strip().split(":")
    charuco = kind.lower() == "charuco" and 3 <= len(parts) <= 5
    if not charuco and not (kind.lower() == "chessboard" and len(parts) == 2):
        raise bad_input("board", given=f"'{text}'", allowed=SPECS, do="Correct --board.")
    counts = re.fullmatch(r"(\d{1,4})[xX×](\d{1,4})", parts[0].strip())
    if counts is None:
        raise bad_input("board", given=f"'{parts[0]}' in '{text}'", allowed="COLUMNSxROWS, as 7x5", do="Correct it.")
    columns, rows = int(counts[1]), int(counts[2])
    if not charuco:
        return Chessboard(columns, rows, _length(parts[1], text))
    if len(parts) == 5 and parts[4].lower() != "legacy":
        raise InputError(f"board: got '{parts[4]}' at the end of '{text}'; allowed: {SPECS}, then :legacy.")
    sizes = _length(parts[1], text), _length(parts[2], text)
    return CharucoBoard(columns, rows, *sizes, *(name.upper() for name in parts[3:4]), legacy=len(parts) == 5)


def _length(word: str, text: str) -> float:
    match = re.fullmatch(r"(\d+(?:\.\d+)?|\.\d+) ?(mm|cm|m)", word.strip())
    if match is None:
        raise bad_input("board", given=f"'{word}' in '{text}'", allowed="a length with its unit, as 30mm", do="Add it.")
    units = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}  # [m]
    return float(match[1]) * units[match[2]]


COLUMNS = ("image", "x", "y", "z", "qx", "qy", "qz", "qw")


def read_poses(path: Path | str) -> dict[str, Array]:
    """Return T_base_flange (4, 4) by image name.

    CSV: a first line `image,x,y,z,qx,qy,qz,qw` in any order, then one line per image; `#` starts a comment, and commas,
    semicolons or tabs separate. JSON: `{"image.png": [x, y, z, qx, qy, qz, qw], ...}`. Metres, base frame, `qw` last.

    Raises:
        InputError: the file is missing or unusable; the message names the line.
    """
    path = existing(path)
    rows = _json_rows(path) if path.suffix.lower() == ".json" else _csv_rows(path)
    poses: dict[str, Array] = {}
    for where, name, numbers in rows:
        if name in poses:
            raise bad_input(where, given=f"image '{name}' again", allowed="each image once", do="Remove one.")
        try:
            pose = [float(number) for number in numbers]
            T = transform_from_pose7(pose)
        except (TypeError, ValueError) as error:
            reason = error if isinstance(error, InputError) else f"{numbers} is not 7 numbers"
            raise InputError(f"{where}: {reason}") from error
        if max(map(abs, pose[:3])) > 10:
            raise bad_input(
                where, given=f"a flange at {pose[:3]}", allowed="within 10 m", do="Give positions in metres."
            )
        poses[name] = T
    if not poses:
        raise bad_input(str(path), given="no poses", allowed="a line per image", do=f"Columns: {', '.join(COLUMNS)}.")
    return poses


def _json_rows(path: Path) -> list[tuple[str, str, Any]]:
    stored = read_json(path)
    if not isinstance(stored, dict) or not all(isinstance(numbers, list) for numbers in stored.values()):
        raise bad_input(
            str(path),
            given=f"JSON that is a {type(stored).__name__} of something else",
            allowed='{"image.png": [x, y, z, qx, qy, qz, qw], ...}',
            do="See docs/calibration.md.",
        )
    return [(f"{path}, '{name}'", name, numbers) for name, numbers in stored.items()]


def _csv_rows(path: Path) -> list[tuple[str, str, Any]]:
    table = read_rows(path)
    if not table:
        return []
    names, rows = [word.lower() for word in table[0].cells], []
    if sorted(names) != sorted(COLUMNS):
        raise bad_input(
            f"{path}, line {table[0].line}",
            given=f"columns {', '.join(names)}",
            allowed=", ".join(COLUMNS),
            do="Name each column once, in any order.",
        )
    for line, words in table[1:]:
        where = f"{path}, line {line}"
        if len(words) != len(names):
            raise bad_input(where, given=f"{len(words)} entries", allowed=str(len(names)), do="Complete the line.")
        entry = dict(zip(names, words, strict=True))
        cells = [(entry[name], number(entry[name])) for name in COLUMNS[1:]]
        rows.append((where, entry["image"], [cell if value is None else value for cell, value in cells]))
    return rows
