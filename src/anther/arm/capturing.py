"""Taking views with a robot that does not stop for them: one motion, a frame at each view. V views, T samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anther.arm import sharpness, timing
from anther.arm.model import ArmModel
from anther.arm.sawyer import SAWYER
from anther.arm.views import Views
from anther.capture import Capture
from anther.devices import ArmRecord, ArmSample, Frame, JointTrajectory, Robot
from anther.errors import StageFailure
from anther.geometry import Array

FEWEST = 3
"""Fewer sharp views than this are no capture."""


def through_views(views: Views) -> tuple[JointTrajectory, Array]:
    """Return one motion through all views, standing still where `Views.dwell` says so, and when it arrives at each.

    Returns:
        The motion, and (V,) times [s].
    """
    parts, arrivals, now = list[JointTrajectory](), [], 0.0
    for motion, dwell in zip(views.motions, views.dwell, strict=True):
        arrivals.append(now + motion.duration)
        parts.append(motion)
        if dwell > 0:
            parts.append(JointTrajectory.standstill(motion.positions[-1], float(dwell)))
        now = arrivals[-1] + float(dwell)
    return timing.joined(parts), np.array(arrivals)


def take_views(
    robot: Robot,
    views: Views,
    T_flange_cam: Array,
    points: Array,
    params: sharpness.Params,
    arm: ArmModel = SAWYER,
) -> Capture:
    """Drive through the views and return their pictures, each at the pose that the arm read when it was taken.

    A frame is asked for as soon as the arm, braking, is slow enough for one; the camera, running freely, delivers the
    next. Each frame's time stamp gives its joints, between two of the arm's readings. A frame that turns out blurred,
    or taken too fast for its pose to be known, is left out.

    Args:
        robot: its arm stands where the views' first motion begins; its wrist camera takes the pictures.
        views: from `plan_views`.
        T_flange_cam: (4, 4) hand-eye calibration.
        points: (P, 3) where the plant may be, world [m], see `views.cylinder_points`.
        params: camera and clocks, those that the views were planned with.
        arm: the robot's.

    Raises:
        StageFailure: "device_fault" when fewer than `FEWEST` frames are sharp, or what arm and camera raise.
    """
    motion, arrivals = through_views(views)
    asking = arrivals - sharpness.braking_times(arm, views.motions, T_flange_cam, points, params)
    samples, frames, camera = list[ArmSample](), list[Frame](), robot.wrist_camera

    def watch(sample: ArmSample) -> None:
        samples.append(sample)
        if len(frames) < len(asking) and sample.time - samples[0].time >= asking[len(frames)]:
            frames.append(camera.read())

    record = robot.arm.follow(motion, watch)
    frames += [camera.read()] if len(frames) == len(asking) - 1 else []  # the arm stands at the last view
    joints, sharp = _where(arm, frames, record, T_flange_cam, points, params=params)
    if sharp.sum() < FEWEST:
        given = f"{sharp.sum()} of {len(asking)} pictures are sharp; needed: {FEWEST}"
        raise StageFailure("device_fault", f"{given}. Look at the exposure and at the clocks of camera and arm.")
    kept = [frame for frame, good in zip(frames, sharp, strict=True) if good]
    return Capture(
        np.stack([frame.depth for frame in kept]),
        camera.intrinsics,
        arm.forward(joints[sharp]) @ T_flange_cam,
        np.stack([frame.rgb for frame in kept]),
        joints[sharp],
    )


def _where(
    arm: ArmModel,
    frames: list[Frame],
    record: ArmRecord,
    T_flange_cam: Array,
    points: Array,
    *,
    params: sharpness.Params,
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the joints (V, J) at which frames were taken, and which of them (V,) are sharp."""
    at = np.array([frame.time for frame in frames])
    rates = np.gradient(record.measured, record.times, axis=0)
    joints, rates = (np.array([np.interp(at, record.times, q) for q in rows.T]).T for rows in (record.measured, rates))
    return joints, sharpness.is_sharp(arm, joints, rates, T_flange_cam, points, params)
