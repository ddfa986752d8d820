"""A cell whose wrist camera looks at a board: drivers for a cell file, whose truth stands in a JSON file.

The arm goes where it is told and reads its joints with noise; the camera draws the board from where the arm truly is,
by the true place of the camera on the flange, with a lens that bends and pixels that are noisy.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from fake_robot import FakeArm, FakeGripper
from made_board import BOARD_CENTRE, T_BASE_BOARD, render

from anther.core.geometry import Array, Intrinsics, inverse, look_at, pose7, small_transform, transform_from_pose7
from anther.robot.arm import _kinematics
from anther.robot.arm.sawyer import SAWYER, TOOL
from anther.robot.calibration import CharucoBoard
from anther.robot.devices import DeviceError, Frame

CAMERA = Intrinsics(640, 480, 460.0, 460.0, 319.5, 239.5)
BOARD = "charuco:7x5:30mm:22mm"
TRUE_FLANGE_CAM = TOOL.T_flange_cam @ small_transform([0.05, -0.06, 0.04], [0.012, -0.010, 0.008])
"""The cell file says `TOOL.T_flange_cam`, as a person measures it: 5 degrees and 17 mm from this."""
EYE = BOARD_CENTRE[:3] + np.array([-0.15, 0.02, 0.38])
MODEST = 2e-4
"""Noise of a joint's reading [rad]: 0.2 mm at 1 m. A guess."""


@dataclass
class Truth:
    """What the cell is; lengths [m], angles [rad], noise of a pixel's grey [of 255]."""

    T_flange_cam: list[float] = field(default_factory=lambda: pose7(TRUE_FLANGE_CAM).tolist())
    T_base_board: list[float] = field(default_factory=lambda: pose7(T_BASE_BOARD).tolist())
    joints: list[float] = field(default_factory=list)
    joint_noise: float = MODEST
    grey_noise: float = 4.0
    distortion: list[float] = field(default_factory=lambda: [0.0] * 5)
    board: bool = True
    dictionary: str = "DICT_4X4_50"
    seed: int = 0
    refuses_after: int = 10_000
    interrupted_after: int = 10_000

    def write(self, path: Path) -> None:
        path.write_text(json.dumps(self.__dict__))


def read_truth(path: str) -> Truth:
    return Truth(**json.loads(Path(path).read_text()))


def start_joints(T_flange_cam: Array = TRUE_FLANGE_CAM, eye: Array = EYE) -> Array:
    """Joints from which the camera sees the board."""
    T = look_at(eye, BOARD_CENTRE[:3], up=(-1.0, 0.0, 0.3)) @ inverse(T_flange_cam)
    return _kinematics.inverse(SAWYER, T)[0]


class BoardArm(FakeArm):
    """See the module; `world` is the file with the truth."""

    def __init__(self, world: str) -> None:
        self.truth = read_truth(world)
        self.rng = np.random.default_rng([self.truth.seed, 1])
        super().__init__(np.array(self.truth.joints or start_joints()), fault=self._refuse)
        self.passed: list[Array] = []

    def _refuse(self, done: int) -> None:
        if done >= self.truth.refuses_after:
            raise DeviceError("its cuff is held")

    def joints(self) -> Array:
        return self.now + self.truth.joint_noise * self.rng.normal(size=len(self.now))

    def true_joints(self) -> Array:
        return self.now.copy()

    def put(self, joints: Array) -> None:
        """As a person does who moves the arm by hand."""
        self.now = np.array(joints)

    def follow(self, trajectory: Any, watch: Any = None, more: Any = None) -> Any:
        if self.done >= self.truth.interrupted_after:
            raise KeyboardInterrupt
        self.passed.append(trajectory.positions)
        return super().follow(trajectory, watch, more)


class BoardCamera:
    """See the module."""

    intrinsics = CAMERA
    rates = (30.0,)

    def __init__(self, world: str, arm: Any) -> None:
        self.truth, self.arm, self.reads = read_truth(world), arm, 0
        self.rng = np.random.default_rng([self.truth.seed, 2])

    def read(self) -> Frame:
        self.reads += 1
        q = self.arm.call("true_joints") if hasattr(self.arm, "call") else self.arm.true_joints()
        X, Z = transform_from_pose7(self.truth.T_flange_cam), transform_from_pose7(self.truth.T_base_board)
        image = np.full((CAMERA.height, CAMERA.width), 128.0)
        if self.truth.board:
            printed = CharucoBoard(dictionary=self.truth.dictionary)
            image = bent(printed, inverse(SAWYER.forward(q) @ X) @ Z, np.array(self.truth.distortion))
        image = image + self.truth.grey_noise * self.rng.normal(size=image.shape)
        rgb = np.repeat(np.clip(image, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)
        return Frame(float(self.reads), rgb, np.zeros(image.shape, np.float32))


def bent(board: CharucoBoard, T_cam_board: Array, distortion: Array) -> Array:
    """The image of a camera whose lens bends."""
    if not np.any(distortion):
        return render(board, T_cam_board, CAMERA).astype(np.float64)
    around = 80
    wide = replace(
        CAMERA,
        width=CAMERA.width + 2 * around,
        height=CAMERA.height + 2 * around,
        cx=CAMERA.cx + around,
        cy=CAMERA.cy + around,
    )
    straight = render(board, T_cam_board, wide)
    u, v = np.meshgrid(np.arange(CAMERA.width, dtype=np.float64), np.arange(CAMERA.height, dtype=np.float64))
    pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
    at = cv2.undistortPoints(pixels, CAMERA.matrix, distortion, P=wide.matrix).reshape(*u.shape, 2).astype(np.float32)
    return cv2.remap(straight, at[..., 0], at[..., 1], cv2.INTER_LINEAR).astype(np.float64)


class BoardGripper(FakeGripper):
    """Never asked."""
