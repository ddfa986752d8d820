"""A made-up arm with a camera that looks at a board: poses, the corners it sees, the images it takes."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from anther.core.geometry import Array, Intrinsics, inverse, look_at, small_transform, transform_points
from anther.robot.calibration import Board, BoardCorners, BoardViews, CharucoBoard, board_views

T_FLANGE_CAM = small_transform([0.1, -0.2, 1.5], [0.03, -0.06, 0.05])
T_BASE_BOARD = small_transform([3.1, 0.02, 0.01], [0.7, 0.1, -0.2])  # it lies face up: OpenCV's board z points down
BOARD_CENTRE = T_BASE_BOARD @ [0.105, 0.075, 0, 1]
CAMERA = Intrinsics(1280, 720, 640.0, 640.0, 639.5, 359.5)
CORNERS = 0.03 * np.array([[column, row, 0] for row in range(1, 5) for column in range(1, 7)])  # of CharucoBoard()


def poses(count: int, rng: np.random.Generator, roll: float = 1.0) -> tuple[Array, Array]:
    """Flange poses that look at the board from above, and what the camera then sees of it."""
    flange = []
    for _ in range(count):
        eye = BOARD_CENTRE[:3] + np.array([*rng.uniform(-0.2, 0.2, 2), rng.uniform(0.35, 0.5)])
        aim = BOARD_CENTRE[:3] + np.array([*rng.uniform(-0.04, 0.04, 2), 0])
        turn = small_transform([0, 0, roll * rng.uniform(-1, 1)], [0, 0, 0])
        flange.append(look_at(eye, aim, up=(0.1, 1, 0)) @ turn @ inverse(T_FLANGE_CAM))
    flange = np.stack(flange)
    return flange, seen_from(flange)


def seen_from(flange: Array) -> Array:
    """T_cam_board from these flange poses."""
    return inverse(flange @ T_FLANGE_CAM) @ T_BASE_BOARD


def jitter(T: Array, rng: np.random.Generator, degrees: float, shift: float) -> Array:
    return np.stack(
        [M @ small_transform(np.deg2rad(degrees) * rng.normal(size=3), shift * rng.normal(size=3)) for M in T]
    )


def corners_of(T_cam_board: Array, rng: np.random.Generator, noise: float) -> BoardCorners:
    """The corners that fall into the image, each coordinate off by `noise` [px]."""
    points, pixels = [], []
    for T in T_cam_board:
        exact = CAMERA.project(transform_points(T, CORNERS))
        inside = np.all((exact > 0) & (exact < [CAMERA.width - 1, CAMERA.height - 1]), axis=1)
        points.append(CORNERS[inside])
        pixels.append((exact + noise * rng.normal(size=exact.shape))[inside])
    return BoardCorners(np.arange(len(points)), tuple(points), tuple(pixels))


def views_of(T_cam_board: Array, rng: np.random.Generator, noise: float = 0.2) -> BoardViews:
    return board_views(corners_of(T_cam_board, rng, noise), CAMERA)


def errors(found: Array, true: Array = T_FLANGE_CAM) -> tuple[float, float]:
    """Rotation [deg] and translation [mm] error."""
    gap = inverse(true) @ found
    return float(np.rad2deg(Rotation.from_matrix(gap[:3, :3]).magnitude())), float(1e3 * np.linalg.norm(gap[:3, 3]))


def page(board: Board, square: int) -> tuple[Array, Array]:
    """The printed page, and where its pixels lie on the board [m], as a (3, 3) matrix."""
    if isinstance(board, CharucoBoard):
        printed, origin = board._printed.generateImage((board.columns * square, board.rows * square)), 0
    else:
        tiles = np.indices((board.rows + 1, board.columns + 1)).sum(axis=0) % 2
        printed = 255 * np.kron(tiles, np.ones((square, square))).astype(np.uint8)
        printed, origin = np.pad(printed, square, constant_values=255), 2 * square
    scale = board.square / square
    offset = scale * (0.5 - origin)  # pixel centres
    return printed, np.array([[scale, 0, offset], [0, scale, offset], [0, 0, 1]])


def render(board: Board, T_cam_board: Array, camera: Intrinsics = CAMERA, square: int = 80) -> Array:
    """The image a pinhole camera has of the printed board on a grey table."""
    printed, to_board = page(board, square)
    homography = (
        camera.matrix @ np.column_stack([T_cam_board[:3, 0], T_cam_board[:3, 1], T_cam_board[:3, 3]]) @ to_board
    )
    # Drawn four times as large and averaged, so that edges have grey levels.
    grow = np.array([[4, 0, 1.5], [0, 4, 1.5], [0, 0, 1.0]])
    size = (4 * camera.width, 4 * camera.height)
    large = cv2.warpPerspective(printed, grow @ homography, size, borderMode=cv2.BORDER_CONSTANT, borderValue=128)
    return cv2.resize(large, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
