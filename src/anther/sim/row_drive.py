"""A cart with cameras at its side that drives along a row: what they take on its way, and what is true of it.

Cameras lie on their side, so that heads and strings are in view from a narrow path: they stand as far from the plants
as the path allows, at the height of their flowers. The one of the map looks up to the wire as far as the flowers stay
in view; the one of the visits looks level, since stems are held below their flowers. The cart's frame is x towards the
plants, y along the rails, z up from the floor, x = y = 0 where it stands. V frames.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anther.core.checks import check_range
from anther.core.geometry import Array, Intrinsics, look_at, transform
from anther.core.opencv import cv2
from anther.sim.capture import CameraErrors, camera_errors, noisy_rgb, perturbed_hand_eye, pose_errors
from anther.sim.render import Scene, d455
from anther.sim.row import Row, row_scene
from anther.sim.truth import NOMINAL, Truth

BEYOND = 0.4
"""From where a drive begins to the first hook, and from the last one to its end [m]."""
SLIP = 0.01
"""Of the cart's odometry: standard deviation after a metre [m]; it grows with the root of the way. A guess, which
`Truth.pose_error` multiplies."""
SCALE = 0.005
"""Of the cart's odometry: standard deviation of its scale, a guess."""
ROCK = CameraErrors(pose_rotation=float(np.radians(0.1)), pose_translation=0.001)
"""How far a cart turns and shifts at each frame: 1 mm of play over half a metre between its wheels, a guess."""
RATE = 5.0
"""Frames a second: a tenth of a metre apart at 0.5 m/s."""


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """A drive along a row.

    Attributes:
        row: as it is.
        intrinsics: of the camera.
        T_cart_cam: (4, 4) as it was calibrated.
        odometry: (V,) what it reads at each frame [m].
        place: (V,) where the cart truly is along the row [m].
        T_world_cam: (V, 4, 4) where the camera truly is.
        blur: how far the line of strings moves through the image while the shutter is open [px].
        errors: of the camera.
        seed: of its noise.
    """

    row: Row
    intrinsics: Intrinsics
    T_cart_cam: Array
    odometry: Array
    place: Array
    T_world_cam: Array
    blur: float
    errors: CameraErrors
    seed: tuple[int, ...]

    def frames(self, scene: Scene | None = None) -> Iterator[tuple[float, NDArray[np.uint8]]]:
        """Yield what the odometry reads [m], and the image (H, W, 3), at each frame; two are rendered at a time."""
        scene, streams = scene or row_scene(self.row), np.random.default_rng(self.seed).spawn(len(self.place))
        half = int(np.ceil(self.blur / 2))
        kernel = np.clip(self.blur / 2 + 0.5 - np.abs(np.arange(-half, half + 1)), 0, 1)[:, None]

        def take(k: int) -> NDArray[np.uint8]:
            rgb = scene.render(self.intrinsics, self.T_world_cam[k]).rgb
            rgb = cv2.filter2D(rgb, -1, kernel / kernel.sum()) if self.blur else rgb
            return noisy_rgb(rgb, streams[k], self.errors)

        with ThreadPoolExecutor(2) as pool:
            yield from zip(self.odometry.tolist(), pool.map(take, range(len(self.place))), strict=True)


def side_camera(row: Row, tilt: float = 0.0) -> Array:
    """Return T_cart_cam (4, 4) of the camera that looks from the cart at the near line of a row, up by a tilt [rad]."""
    eye = _eye(row)
    on_its_side = transform([[0, -1, 0], [1, 0, 0], [0, 0, 1]], np.zeros(3))
    ahead = np.array([np.cos(tilt), 0, np.sin(tilt)])
    return look_at(eye, eye + ahead) @ on_its_side


def _eye(row: Row) -> Array:
    flowers = np.vstack([plant.flower_position for plant in row.plants[: row.near]])
    return np.array([0.05 - row.measures.corridor / 2, 0.0, np.median(flowers[:, 2]) - row.origin[2]])


def _up_to_the_wire(row: Row, intrinsics: Intrinsics) -> float:
    """Return by how much the camera of the map is tilted [rad]: from below the flowers to the tags of the posts."""
    eye, m = _eye(row), row.measures
    away = m.near - eye[0]
    low, high = np.arctan2(-0.3, away), np.arctan2(m.wire + 0.3 - eye[2], away)
    return float(min((low + high) / 2, low + np.arctan(intrinsics.width / 2 / intrinsics.fx)))


def drive_past(
    row: Row, seed: int, *, speed: float = 0.4, truth: Truth = NOMINAL, intrinsics: Intrinsics | None = None
) -> Drive:
    """Return a drive past the near line of a row.

    Odometry has a wrong scale (0.5 %, a guess) and drifts; the cart rocks.

    Args:
        row: where it stands.
        seed: of all errors.
        speed: of the cart [m/s].
        truth: about the camera.
        intrinsics: of the camera; None is a D455 at 848 x 480.
    """
    check_range("speed of the cart", speed, 0.05, 2.0, "m/s")
    rng, camera, errors = np.random.default_rng([seed, 17]), intrinsics or d455(848, 480), camera_errors(truth)
    hooks = np.array([twine.hook for plant in row.plants[: row.near] for twine in plant.twines])[:, 1]
    place = np.arange(hooks.min() - BEYOND, hooks.max() + BEYOND + speed / RATE, speed / RATE)
    odometry = _odometry(place, rng, truth)
    T_cart_cam = side_camera(row, _up_to_the_wire(row, camera))
    carts = _carts(row.origin * [1, 0, 1], place)
    away = row.measures.near - T_cart_cam[0, 3]
    blur = truth.exposure_time * speed * camera.fy / away
    true = carts @ pose_errors(len(place), camera_errors(truth, ROCK), rng) @ T_cart_cam
    believed = perturbed_hand_eye(T_cart_cam, rng, factor=truth.hand_eye_error)
    return Drive(row, camera, believed, odometry, place, true, blur, errors, (seed, 18))


VIEWS = 6
"""On the way to a plant: 3 to 6 are what a visit has time for."""
WIDEST = 0.48
"""How far along the rails from the plant the first and the last view are, of the camera's distance from the plant's
line: the camera then still has the plant in view (its half field of view across is 29 degrees)."""
LEAD = 0.4
"""By how much farther ahead of the arm than it sees the camera of the visits is [m]: about from stem to stem, so that a
stem's views are all taken when the cart stands before the one that is visited earlier."""
STEM_TO_STEM = 2.0
"""What a cart takes from one stem to the next [s]: 0.4 m at 0.3 m/s until it stands (a guess)."""
BETWEEN_VIEWS = 0.5
"""While the cart drives [s]: as long as it takes for 0.15 m."""


def look_ahead(row: Row, rng: np.random.Generator, truth: Truth = NOMINAL) -> tuple[Array, Array]:
    """Return T_world_cam (V, 4, 4) of the views on the way to the plant asked for, as believed and as they truly are.

    The camera of `side_camera` is ahead of the arm: the last view is taken `LEAD` before the cart stands. Where the
    cart was at each, odometry says, backwards from where it stands. Rocking counts against the cart that stands.

    Args:
        row: in the frame of the arm (`row_cell.before_arm`).
        rng: of the errors of odometry, rocking and calibration.
        truth: of these.
    """
    T_cart_cam = side_camera(row)
    ahead = WIDEST * (row.measures.near - T_cart_cam[0, 3])
    before = np.linspace(-2 * ahead, 0, VIEWS) - LEAD  # of where it stands in the end
    read = _odometry(np.append(before, 0.0), rng, truth)
    rocked = pose_errors(VIEWS, camera_errors(truth, ROCK), rng)
    calibrated = perturbed_hand_eye(T_cart_cam, rng, factor=truth.hand_eye_error)
    stands = row.origin * [1, 0, 1] + [0, ahead + LEAD, 0]
    return _carts(stands, read[:-1] - read[-1]) @ calibrated, _carts(stands, before) @ rocked @ T_cart_cam


def _odometry(place: Array, rng: np.random.Generator, truth: Truth) -> Array:
    """Return what odometry reads (V,) at places (V,) along the rails, 0 at the first [m]."""
    slip = SLIP * truth.pose_error
    drift = np.append(0.0, np.cumsum(rng.normal(0, slip * np.sqrt(np.diff(place)))))
    return np.asarray((place - place[0]) * (1 + rng.normal(0, SCALE)) + drift)


def _carts(stands: Array, along: Array) -> Array:
    """Return T_world_cart (V, 4, 4) of a cart that is `along` (V,) the rails from where it stands (3,) [m]."""
    carts = np.tile(np.eye(4), (len(along), 1, 1))
    carts[:, :3, 3] = stands + np.outer(along, [0, 1, 0])
    return carts
