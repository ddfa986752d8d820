"""Images of a board and the flange's poses -> where the camera sits on the flange or stands beside the robot, and how
far that can be trusted.

With --live the arm of a cell takes the images; with --check it looks whether the camera has moved since.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from anther.cli.args.shared import Output
from anther.core.choices import HandEyeMethod


@dataclass(frozen=True)
class Args(Output):
    """Attributes: images, poses, board; or live or check, and cell. docs/calibration.md has the file formats and how to
    take the images."""

    images: Path | None = None
    """Folder with the images of the board, one per flange pose."""
    poses: Path | None = None
    """Flange poses T_base_flange, CSV (image, x, y, z, qx, qy, qz, qw) or JSON {image: [7 numbers]}; metres."""
    board: str | None = None
    """charuco:7x5:30mm:22mm (squares, their edge, the markers'; then perhaps :DICT_4X4_50), or chessboard:9x6:25mm
    (inner corners)."""
    intrinsics: Path | None = None
    """JSON with width, height, fx, fy, cx, cy, perhaps k1 k2 p1 p2 k3 k4 k5 k6; or a transforms.json or
    calibration.json. By default intrinsics.json in the images' folder; with --live the camera's own."""
    estimate_intrinsics: bool = False
    """Estimate the intrinsics from the same images."""
    eye_to_hand: bool = False
    """The camera stands beside the robot and the board is on the flange: find T_base_cam."""
    out: Path | None = None
    """Folder for calibration.json and calibration.png, by default this one. With --live for the views too, by default a
    new one beside the cell file; one that was begun is gone on with."""
    cell: Path | None = None
    """A real robot's cell file (docs/cell_file.md)."""
    live: bool = False
    """Take the images with the cell's arm and wrist camera, and write the result into the cell file. Asks first."""
    check: bool = False
    """Look whether the wrist camera has moved since --live: exit code 1 if so. Asks first."""
    by_hand: bool = False
    """With --live: a person moves the arm."""
    yes: bool = False
    """Move without being asked."""
    method: HandEyeMethod = "tsai"
    """Closed-form solver of the first estimate. The result is refined from there, and compared with all of them."""
