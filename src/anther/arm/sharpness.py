"""How long a picture taken by a moving arm is sharp, and so how long the arm must stand still for it.

The camera takes its frames when it likes. While the arm brakes for a view and leaves it again there is a span in which
whatever frame is taken shows the plant sharp and the arm's readings tell where it was taken: if that span is as long as
a frame period and an exposure, one whole exposure lies within it and the arm need not stand still at all.
T samples, P points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from anther.arm.model import ArmModel
from anther.checks import check_range
from anther.devices import JointTrajectory
from anther.geometry import Array, inverse

STEP = 1e-3  # s between the instants looked at
WIDE = (
    1.1  # |x / z| and |y / z| of a point beyond this are outside a D455's colour image (90 x 65 deg: facts, sawyer 4)
)
SOON = 1e-4  # s in which a point's motion in the image is taken
JITTER = 0.001
"""By which the camera's and the arm's clock may differ [s]. Our assumption, for one computer."""
SHIFT = 2e-4
"""How far the camera may move within that [m]; a fifth of an image's usual pose error."""


@dataclass(frozen=True, slots=True)
class Params:
    """Camera and clocks.

    Attributes:
        frame_rate: of the camera, which runs freely [Hz] (D455 at 1280 x 720; facts: sawyer 4).
        exposure: of a frame [s]. Our assumption: daylight in a greenhouse, or a lamp beside the camera.
        focal: length [px] (D455 at 1280 x 720; facts: perception).
        blur: how far any point of the plant's region may move in the image within an exposure [px]; half a pixel is
            less than the lens blurs.
    """

    frame_rate: float = 30.0
    exposure: float = 0.005
    focal: float = 640.0
    blur: float = 0.5

    def __post_init__(self) -> None:
        check_range("frame rate", self.frame_rate, 1, 1000, "Hz")
        check_range("exposure", self.exposure, 1e-5, 0.5, "s")
        check_range("blur", self.blur, 0.01, 10, "px")

    @property
    def span(self) -> float:
        """How long pictures must be sharp so that a frame can be had for certain [s]."""
        return 1 / self.frame_rate + self.exposure


def image_speed(arm: ArmModel, q: Array, rates: Array, T_flange_cam: Array, points: Array, focal: float) -> Array:
    """Return (T,) how fast the fastest of the points (P, 3) within the image moves in it [px/s].

    Args:
        arm: its description.
        q, rates: joints and their rates (T, J) [rad, s].
        T_flange_cam: (4, 4) hand-eye calibration.
        points: world [m].
        focal: [px].
    """

    def seen(joints: Array) -> Array:
        T_cam_world = inverse(arm.forward(joints) @ T_flange_cam)
        p = np.einsum("tij,pj->tpi", T_cam_world[:, :3, :3], points) + T_cam_world[:, None, :3, 3]
        ahead = p[..., 2:] > 0.05
        return np.where(ahead, p[..., :2] / np.where(ahead, p[..., 2:], 1), np.nan)

    now = seen(q)
    speed = focal * np.linalg.norm(seen(q + SOON * rates) - now, axis=2) / SOON
    return np.where(np.abs(now).max(axis=2) <= WIDE, speed, 0).max(axis=1)


def is_sharp(
    arm: ArmModel, q: Array, rates: Array, T_flange_cam: Array, points: Array, params: Params
) -> NDArray[np.bool_]:
    """Return (T,) whether a frame then is neither blurred nor taken at a place not known; see `image_speed`."""
    here, soon = (arm.forward(joints) @ T_flange_cam for joints in (q, q + SOON * rates))
    travel = np.linalg.norm(soon[:, :3, 3] - here[:, :3, 3], axis=1) / SOON * JITTER
    blur = image_speed(arm, q, rates, T_flange_cam, points, params.focal) * params.exposure
    return (blur <= params.blur) & (travel <= SHIFT)


def standing_times(
    arm: ArmModel, motions: Sequence[JointTrajectory], T_flange_cam: Array, points: Array, params: Params
) -> Array:
    """Return (V,) how long the arm must stand still after each of V motions [s], each to a view from the view before.

    After the last nothing follows: the arm waits for its frame.
    """
    leaving = np.array([_sharp_time(arm, motion, T_flange_cam, points, params) for motion in motions[1:]])
    braking = braking_times(arm, motions, T_flange_cam, points, params)
    return np.maximum(params.span - braking - np.append(leaving, 0), 0)


def braking_times(
    arm: ArmModel, motions: Sequence[JointTrajectory], T_flange_cam: Array, points: Array, params: Params
) -> Array:
    """Return (V,) how long before its end each motion is slow enough for a sharp picture [s], `Params.span` at most."""
    return np.array([_sharp_time(arm, motion.backwards(), T_flange_cam, points, params) for motion in motions])


def _sharp_time(arm: ArmModel, motion: JointTrajectory, T_flange_cam: Array, points: Array, params: Params) -> float:
    """Return how long pictures stay sharp from the beginning of a motion [s]."""
    curve = CubicHermiteSpline(motion.times, motion.positions, motion.velocities)
    t = np.arange(0, min(params.span, motion.duration), STEP)
    sharp = is_sharp(arm, curve(t), curve(t, 1), T_flange_cam, points, params)
    return STEP * float(np.logical_and.accumulate(sharp)[1:].sum())
