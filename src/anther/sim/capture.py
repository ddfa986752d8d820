"""Taking RGB-D views of a simulated plant: what the planner gets, and apart from it what was true.

The camera is never quite where the robot believes: the arm errs at every pose, and the hand-eye transform is not exact.
V views, H x W pixels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from anther.capture import Capture
from anther.checks import check_array, check_range, check_transform
from anther.geometry import Array, Intrinsics, look_at, small_transform
from anther.sim._depth_noise import DepthNoise, noisy_depth
from anther.sim.plant import SimPlant
from anther.sim.render import Scene, d455
from anther.sim.truth import Truth

Progress = Callable[[int, int], None]
"""Called with the number of views done and the number of all."""
Sight = SimPlant | Scene | Callable[[int], Scene]
"""What is looked at: a plant, its scene, or the scene as each view finds it."""


@dataclass(frozen=True, slots=True)
class CameraErrors:
    """How far camera and robot are from ideal. All are standard deviations, per axis where there are axes.

    Attributes:
        pose_rotation: of the arm at each view [rad] (facts: perception, 0.2 deg per axis).
        pose_translation: of the arm at each view [m] (facts: perception, 1.5 mm per axis).
        depth: the depth sensor.
        exposure: gain of each view [-]; an estimate.
        white_balance: gain of each colour of each view [-]; an estimate.
        read_noise: of each pixel [grey levels]; an estimate.
        shot_noise: variance of a pixel per grey level [grey levels]; an estimate.
        blur: of the lens [px]; an estimate.
    """

    pose_rotation: float = float(np.radians(0.2))
    pose_translation: float = 0.0015
    depth: DepthNoise = field(default_factory=DepthNoise)
    exposure: float = 0.05
    white_balance: float = 0.015
    read_noise: float = 1.5
    shot_noise: float = 0.03
    blur: float = 0.6

    def __post_init__(self) -> None:
        check_range("pose rotation error", self.pose_rotation, 0.0, 0.1, "rad")
        check_range("pose translation error", self.pose_translation, 0.0, 0.05, "m")


def camera_errors(truth: Truth) -> CameraErrors:
    """Return the errors of camera and arm that are true of a trial."""
    usual = CameraErrors()
    return replace(
        usual,
        pose_rotation=truth.pose_error * usual.pose_rotation,
        pose_translation=truth.pose_error * usual.pose_translation,
        exposure=truth.exposure_spread,
    )


@dataclass(frozen=True, slots=True, eq=False)
class CaptureTruth:
    """What the planner must not see; only judges may.

    Attributes:
        T_world_cam: (V, 4, 4) where the camera really was.
        depth: (V, H, W) float32 exact z-depth [m], 0 = no surface.
        organ: (V, H, W) uint8, the `Organ` each pixel sees; NOTHING = none.
    """

    T_world_cam: Array
    depth: NDArray[Any]
    organ: NDArray[Any]

    def __post_init__(self) -> None:
        views = len(self.depth)
        object.__setattr__(self, "T_world_cam", check_transform("true T_world_cam", self.T_world_cam, views))
        object.__setattr__(self, "depth", check_array("true depth", self.depth, (views, None, None), dtype="float32"))
        object.__setattr__(self, "organ", check_array("true organ", self.organ, self.depth.shape, dtype="uint8"))


def capture_views(
    plant: Sight,
    joints: ArrayLike,
    forward: Callable[[Array], Array],
    T_flange_cam_true: ArrayLike,
    T_flange_cam_believed: ArrayLike,
    *,
    rng: np.random.Generator,
    intrinsics: Intrinsics | None = None,
    errors: CameraErrors | None = None,
    progress: Progress | None = None,
) -> tuple[Capture, CaptureTruth]:
    """Return the capture of a camera carried by an arm, and the truth about it.

    A view is truly taken at forward(q) . error . T_flange_cam_true, the error turning and shifting the flange about
    itself; the capture says forward(q) . T_flange_cam_believed.

    Args:
        plant: what is looked at.
        joints: (V, J) arm joint angles [rad].
        forward: joint angles (J,) -> T_world_flange (4, 4).
        T_flange_cam_true: where the camera is on the flange.
        T_flange_cam_believed: what calibration says, see `perturbed_hand_eye`.
        rng: source of all errors; the same state gives the same capture.
        intrinsics: of the camera; None is a D455 at 1280 x 720.
        errors: sizes of the errors.
        progress: called after each view.
    """
    errors = errors or CameraErrors()
    joints = check_array("joints", joints, (None, None))
    T_true = check_transform("T_flange_cam_true", T_flange_cam_true)
    T_believed = check_transform("T_flange_cam_believed", T_flange_cam_believed)
    flange = np.stack([forward(q) for q in joints])
    true = flange @ _pose_errors(len(joints), errors, rng) @ T_true
    capture, truth = _capture(
        plant, true, flange @ T_believed, rng=rng, intrinsics=intrinsics, errors=errors, progress=progress
    )
    return replace(capture, joints=joints), truth


def capture_from_poses(
    plant: Sight,
    T_world_cam: ArrayLike,
    *,
    rng: np.random.Generator,
    intrinsics: Intrinsics | None = None,
    errors: CameraErrors | None = None,
    progress: Progress | None = None,
) -> tuple[Capture, CaptureTruth]:
    """Return the capture of a camera believed at T_world_cam (V, 4, 4), without an arm; see `capture_views`."""
    errors = errors or CameraErrors()
    believed = check_transform("T_world_cam", np.asarray(T_world_cam).reshape(-1, 4, 4))
    true = believed @ _pose_errors(len(believed), errors, rng)
    return _capture(plant, true, believed, rng=rng, intrinsics=intrinsics, errors=errors, progress=progress)


def perturbed_hand_eye(
    T_flange_cam: ArrayLike,
    rng: np.random.Generator,
    *,
    rotation: float = float(np.radians(0.2)),
    translation: float = 0.001,
    factor: float = 1.0,
) -> Array:
    """Return a hand-eye transform off by `factor` times `rotation` [rad] and `translation` [m], about random axes.

    The sizes are those of a fair calibration (facts: perception, hand-eye table: 0.15 deg, 1.2 mm).
    """
    turn, shift = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    error = small_transform(factor * rotation * turn, factor * translation * shift)
    return check_transform("T_flange_cam", T_flange_cam) @ error


def orbit_poses(
    count: int,
    target: ArrayLike,
    distance: float = 0.6,
    azimuths: tuple[float, float] = (90.0, 270.0),
    elevations: Sequence[float] = (-5.0, 15.0, 35.0),
) -> Array:
    """Return T_world_cam (count, 4, 4) of cameras on rings about a target, all looking at it.

    Args:
        count: number of views, dealt out over the rings.
        target: (3,) [m].
        distance: from the target [m].
        azimuths: first and last angle about z of the camera as seen from the target [deg]; 180 faces the arm's base.
        elevations: one ring each [deg], below 90.
    """
    target = check_array("orbit target", target, (3,))
    check_range("number of views", count, 1, 1000)
    azimuth = np.radians(np.linspace(*azimuths, count) if count > 1 else [np.mean(azimuths)])
    rise = np.radians(np.resize(elevations, count))
    toward = np.stack([np.cos(rise) * np.cos(azimuth), np.cos(rise) * np.sin(azimuth), np.sin(rise)], axis=1)
    return np.stack([look_at(target + distance * d, target) for d in toward])


def noisy_rgb(rgb: NDArray[Any], rng: np.random.Generator, errors: CameraErrors | None = None) -> NDArray[np.uint8]:
    """Return what the colour sensor makes of an ideal image (H, W, 3) uint8."""
    errors = errors or CameraErrors()
    gain = (1 + errors.exposure * rng.normal()) * (1 + errors.white_balance * rng.normal(size=3))
    image = cv2.GaussianBlur(rgb, (0, 0), errors.blur) if errors.blur > 0 else rgb
    level = image.astype(np.float32) * np.clip(gain, 0.3, 1.7).astype(np.float32)
    sigma = np.sqrt(np.float32(errors.read_noise**2) + np.float32(errors.shot_noise) * level)
    level += sigma * rng.standard_normal(rgb.shape, dtype=np.float32)
    return np.clip(level + 0.5, 0, 255).astype(np.uint8)


def _pose_errors(count: int, errors: CameraErrors, rng: np.random.Generator) -> Array:
    turn, shift = rng.normal(size=(2, count, 3))
    parts = zip(errors.pose_rotation * turn, errors.pose_translation * shift, strict=True)
    return np.stack([small_transform(a, b) for a, b in parts])


def _capture(
    plant: Sight,
    true: Array,
    believed: Array,
    *,
    rng: np.random.Generator,
    intrinsics: Intrinsics | None,
    errors: CameraErrors,
    progress: Progress | None,
) -> tuple[Capture, CaptureTruth]:
    """Render all views on two threads, each view with a random stream of its own: the order does not matter."""
    still = Scene.of_plant(plant) if isinstance(plant, SimPlant) else plant
    intrinsics = intrinsics or d455()
    count, size = len(true), (intrinsics.height, intrinsics.width)
    rgb, organ = np.empty((count, *size, 3), np.uint8), np.empty((count, *size), np.uint8)
    depth, exact = np.empty((count, *size), np.float32), np.empty((count, *size), np.float32)
    streams = rng.spawn(count)

    def take(view: int) -> None:
        scene = still if isinstance(still, Scene) else still(view)
        image = scene.render(intrinsics, true[view])
        rgb[view], organ[view], exact[view] = noisy_rgb(image.rgb, streams[view], errors), image.organ, image.depth
        depth[view] = noisy_depth(image.depth, intrinsics, streams[view], errors.depth)

    with ThreadPoolExecutor(2) as pool:
        for done, _ in enumerate(pool.map(take, range(count)), start=1):
            if progress:
                progress(done, count)
    return Capture(depth, intrinsics, believed, rgb), CaptureTruth(true, exact, organ)
