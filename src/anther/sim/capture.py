"""Taking RGB-D views of a simulated plant: what the planner gets, and apart from it what was true.

The camera is never quite where the robot believes: the arm errs at every pose, and the hand-eye transform is not exact.
A D455 measures disparity d = f B / z [px], so its noise, quantisation, range, fat stems, lost twigs and ragged edges
are modelled there. Sources, facts: perception, "Depth sensors": sigma_z = z^2 s / (f B), s about 0.08 px (librealsense
#3904); Z_min = f B / 126 (realsense-ros #2367); thin stems look fat because of the matching window; correlated noise,
1/32 px quantisation, flying and dropped edge pixels, loss of thin structures. The sizes of the edge effects are
estimates.
V views, H x W pixels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anther.core.checks import check_array, check_range, check_transform
from anther.core.geometry import Array, Intrinsics, look_at, small_transform, unit_vectors
from anther.core.opencv import cv2
from anther.core.records import Range, Record
from anther.perception.capture import Capture, Keep, View, no_keep
from anther.robot.devices import Frame
from anther.sim.plant import SimPlant
from anther.sim.render import Image, Scene, d455
from anther.sim.truth import Truth

Progress = Callable[[int, int], None]
"""Called with the number of views done and the number of all."""
Sight = SimPlant | Scene | Callable[[int], Scene]
"""What is looked at: a plant, its scene, or the scene as each view finds it."""


@dataclass(frozen=True, slots=True)
class DepthNoise(Record):
    """Parameters of the depth sensor; the defaults are a D455.

    Attributes:
        subpixel: standard deviation of the disparity error, s [px]; 0.08 typical, 0.032 at best.
        quantum: disparity step [px].
        max_range: readings beyond are dropped [m].
        fattening: how far the matching window lets a nearer surface spread over a farther one [px]: 1 to this.
        thin: structures narrower than this are lost [px]; up to twice this they are lost in patches.
        edge_dropped: share of edge pixels without a reading.
        edge_flying: share of edge pixels that float between the two surfaces.
        stereo_shadow: whether surfaces that only one imager sees are dropped, as is what lies left of its view.
    """

    CALLED = "depth noise"
    subpixel: Annotated[float, Range(0, 2, "px")] = 0.08
    quantum: float = 1 / 32
    max_range: float = 6.0
    fattening: Annotated[int, Range(0, 15, "px")] = 2
    thin: Annotated[int, Range(0, 15, "px")] = 3
    edge_dropped: float = 0.35
    edge_flying: float = 0.1
    stereo_shadow: bool = True

    def _check(self) -> None:
        check_range("depth noise edge_dropped + edge_flying", self.edge_dropped + self.edge_flying, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class CameraErrors(Record):
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

    CALLED = "camera's"
    pose_rotation: Annotated[float, Range(0, 0.1, "rad")] = float(np.radians(0.2))
    pose_translation: Annotated[float, Range(0, 0.05, "m")] = 0.0015
    depth: DepthNoise = field(default_factory=DepthNoise)
    exposure: float = 0.05
    white_balance: float = 0.015
    read_noise: float = 1.5
    shot_noise: float = 0.03
    blur: float = 0.6


def camera_errors(truth: Truth, usual: CameraErrors | None = None) -> CameraErrors:
    """Return the errors of camera and arm that are true of a trial; None: an arm's."""
    usual = usual or CameraErrors()
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


def in_poses(plant: SimPlant, scene: Scene, poses: Sequence[Array] | Array) -> Sight:
    """Return what each view finds of a plant whose segments are at poses (V, K, 4, 4) in the world by then."""
    return lambda view: scene.moved(plant.posed_vertices(poses[view]))


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
    keep: Keep = no_keep,
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
        keep: hears of each view.
    """
    errors = errors or CameraErrors()
    joints = check_array("joints", joints, (None, None))
    T_true = check_transform("T_flange_cam_true", T_flange_cam_true)
    T_believed = check_transform("T_flange_cam_believed", T_flange_cam_believed)
    flange = np.stack([forward(q) for q in joints])
    true = flange @ pose_errors(len(joints), errors, rng) @ T_true
    how: dict[str, Any] = {"rng": rng, "intrinsics": intrinsics, "errors": errors, "progress": progress, "keep": keep}
    capture, truth = capture_from_poses(plant, flange @ T_believed, T_world_cam_true=true, **how)
    return replace(capture, joints=joints), truth


def capture_from_poses(
    plant: Sight,
    T_world_cam: ArrayLike,
    *,
    rng: np.random.Generator,
    intrinsics: Intrinsics | None = None,
    errors: CameraErrors | None = None,
    progress: Progress | None = None,
    keep: Keep = no_keep,
    T_world_cam_true: ArrayLike | None = None,
) -> tuple[Capture, CaptureTruth]:
    """Return the capture of a camera believed at T_world_cam (V, 4, 4), and the truth about it; see `capture_views`.

    Where it truly is, is drawn as for an arm, unless it is given. Views are rendered on two threads, each with a random
    stream of its own: the order does not matter.
    """
    errors, intrinsics = errors or CameraErrors(), intrinsics or d455()
    believed = check_transform("T_world_cam", np.asarray(T_world_cam).reshape(-1, 4, 4))
    drawn = believed @ pose_errors(len(believed), errors, rng) if T_world_cam_true is None else T_world_cam_true
    true = check_transform("T_world_cam_true", drawn, len(believed))
    still = Scene.of_plant(plant) if isinstance(plant, SimPlant) else plant
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
            keep(View(depth[done - 1], rgb[done - 1], intrinsics, believed[done - 1]))
            if progress:
                progress(done, count)
    return Capture(depth, intrinsics, believed, rgb), CaptureTruth(true, exact, organ)


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
    return np.stack([look_at(target + distance * toward, target) for toward in unit_vectors(azimuth, rise)])


def noisy_rgb(rgb: NDArray[Any], rng: np.random.Generator, errors: CameraErrors | None = None) -> NDArray[np.uint8]:
    """Return what the colour sensor makes of an ideal image (H, W, 3) uint8."""
    errors = errors or CameraErrors()
    gain = (1 + errors.exposure * rng.normal()) * (1 + errors.white_balance * rng.normal(size=3))
    image = cv2.GaussianBlur(rgb, (0, 0), errors.blur) if errors.blur > 0 else rgb
    level = image.astype(np.float32) * np.clip(gain, 0.3, 1.7).astype(np.float32)
    sigma = np.sqrt(np.float32(errors.read_noise**2) + np.float32(errors.shot_noise) * level)
    level += sigma * rng.standard_normal(rgb.shape, dtype=np.float32)
    return np.clip(level + 0.5, 0, 255).astype(np.uint8)


def sensed(image: Image, time: float, eye: Intrinsics, rng: np.random.Generator, errors: CameraErrors) -> Frame:
    """Return the frame of `time` [s] that the sensors make of an ideal image."""
    depth = noisy_depth(image.depth, eye, rng, errors.depth)
    return Frame(time, noisy_rgb(image.rgb, rng, errors), depth)


def noisy_depth(
    depth: NDArray[Any], intrinsics: Intrinsics, rng: np.random.Generator, params: DepthNoise | None = None
) -> NDArray[np.float32]:
    """Return what the sensor reads (H, W) [m], 0 = no reading.

    Args:
        depth: (H, W) exact z-depth [m], 0 = no surface.
        intrinsics: of the image.
        rng: source of the noise; the same state gives the same reading.
        params: of the sensor; None is a D455.
    """
    params = params or DepthNoise()
    exact = check_array("exact depth", depth, (intrinsics.height, intrinsics.width), dtype=np.float32)
    baseline = 0.095  # between a D455's two imagers [m]
    focal = np.float32(intrinsics.fx * baseline)
    far = 1000.0  # stands for "no surface" while filtering [m]
    z = np.where(exact > 0, exact, np.float32(far))
    patches = _field(exact.shape, 4.0, rng)
    z = _fattened(_without_twigs(z, patches, params), patches, params)
    disparity = focal / z
    seen = z < params.max_range
    if params.stereo_shadow:
        seen &= ~_shadowed(disparity)
    disparity, dropped = _ragged_edges(disparity, rng, params)
    # standard deviation of the Gaussian that correlates the disparity's error between neighbours [px]
    correlation = 1.5
    disparity += np.float32(params.subpixel) * _field(exact.shape, correlation, rng)
    if params.quantum > 0:
        disparity = np.round(disparity / np.float32(params.quantum)) * np.float32(params.quantum)
    most = 126.0  # largest disparity searched [px]; sets the minimum range
    seen &= ~dropped & (disparity >= focal / params.max_range) & (disparity <= most)
    return np.where(seen, focal / np.maximum(disparity, np.float32(1e-3)), np.float32(0))


def _field(shape: tuple[int, ...], correlation: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """A random field of mean 0, standard deviation 1 and Gaussian correlation [px]."""
    white = rng.standard_normal(shape, dtype=np.float32)
    size = 2 * int(np.ceil(3 * correlation)) + 1
    kernel = cv2.getGaussianKernel(size, correlation)
    smooth = cv2.sepFilter2D(white, -1, kernel, kernel)
    return (smooth / np.float32((kernel**2).sum())).astype(np.float32)


def _ellipse(size: int) -> NDArray[Any]:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))


def _without_twigs(z: NDArray[Any], patches: NDArray[Any], params: DepthNoise) -> NDArray[Any]:
    """Replace near structures narrower than `thin` by what is behind them; those up to twice as wide in patches."""
    if params.thin < 2:
        return z
    narrow = cv2.morphologyEx(z, cv2.MORPH_CLOSE, _ellipse(params.thin))
    wider = cv2.morphologyEx(z, cv2.MORPH_CLOSE, _ellipse(2 * params.thin - 1))
    return np.where(patches > 1.0, wider, narrow)


def _fattened(z: NDArray[Any], patches: NDArray[Any], params: DepthNoise) -> NDArray[Any]:
    """Let nearer surfaces spread by 1 to `fattening` px, patch by patch."""
    if params.fattening < 1:
        return z
    little = cv2.erode(z, _ellipse(3))
    much = cv2.erode(z, _ellipse(2 * params.fattening + 1))
    return np.where(patches > 0, little, much)


def _ragged_edges(
    disparity: NDArray[Any], rng: np.random.Generator, params: DepthNoise
) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Return the disparity with flying pixels at its edges, and (H, W) which edge pixels have no reading."""
    window = np.ones((3, 3), np.uint8)
    near, far = cv2.dilate(disparity, window), cv2.erode(disparity, window)
    edge_step = 2.0  # px of disparity that make an edge
    edge = near - far > edge_step
    chance = rng.random(disparity.shape, dtype=np.float32)
    flying = edge & (chance < params.edge_flying)
    between = far + (near - far) * rng.random(disparity.shape, dtype=np.float32)
    dropped = edge & (chance >= params.edge_flying) & (chance < params.edge_flying + params.edge_dropped)
    return np.where(flying, between, disparity), dropped


def _shadowed(disparity: NDArray[Any]) -> NDArray[np.bool_]:
    """Return (H, W) whether the second imager, on the right, sees another surface there or is not pointed there."""
    height, width = disparity.shape
    x = (np.arange(width) - disparity + 0.5).astype(np.int64)
    inside = x >= 0
    at = np.where(inside, x, 0) + width * np.arange(height)[:, None]
    nearest = np.zeros(height * width, disparity.dtype)
    np.maximum.at(nearest, at[inside], disparity[inside])
    return ~inside | (nearest[at] > disparity + np.float64(1.5))


def pose_errors(count: int, errors: CameraErrors, rng: np.random.Generator) -> Array:
    """Return (count, 4, 4) how far what carries the camera is turned and shifted from where it is believed."""
    turn, shift = rng.normal(size=(2, count, 3))
    parts = zip(errors.pose_rotation * turn, errors.pose_translation * shift, strict=True)
    return np.stack([small_transform(a, b) for a, b in parts])
