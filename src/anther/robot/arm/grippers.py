"""Grippers by their measures, and the wrist camera's outline by where it sits: an arm's tool from a cell file.

In the flange frame, z along the approach: a coupling of length `offset`, the palm, then the fingers, which close along
+-y. A gripper whose pads swing on an arc is described as it holds a thin stem.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from scipy.spatial.transform import Rotation

from anther.core.checks import check_range
from anther.core.geometry import Array, inverse
from anther.core.records import Range, Record
from anther.robot.arm.model import Solid, Tool
from anther.robot.arm.sawyer import TOOL


@dataclass(frozen=True, slots=True)
class GripperSize(Record):
    """What a person measures on a parallel gripper. The bounds are wide: they catch millimetres and slips.

    Attributes:
        opening: largest between the pads [m].
        palm: box around the gripper without fingers: along x, along y (the closing direction), along z [m].
        finger_length: from the palm to the fingertips [m].
        finger_width: of finger and pad along x [m].
        finger_thickness: of a finger behind its pad, along y [m].
        pad_length: along z, ending at the fingertip [m].
        pad_thickness: along y [m].
        mass: without camera and bracket [kg].
        offset: from the flange to the palm: coupling, force sensor [m].
        speed: of the pads towards each other [m/s].
    """

    opening: Annotated[float, Range(0.01, 0.3, "m")]
    palm: tuple[float, float, float]
    finger_length: Annotated[float, Range(0.02, 0.3, "m")]
    finger_width: Annotated[float, Range(0.004, 0.1, "m")]
    finger_thickness: Annotated[float, Range(0.001, 0.1, "m")]
    pad_length: Annotated[float, Range(0.01, 0.3, "m")]
    pad_thickness: Annotated[float, Range(0.0005, 0.05, "m")]
    mass: Annotated[float, Range(0.1, 10, "kg")]
    offset: Annotated[float, Range(0, 0.3, "m")] = 0.0
    speed: Annotated[float, Range(0.005, 1, "m/s")] = TOOL.speed

    def _check(self) -> None:
        for side, axis in zip(self.palm, "xyz", strict=True):
            check_range(f"palm along {axis}", side, 0.01, 0.4, "m")
        check_range("pad_length", self.pad_length, 0.0, self.finger_length, "m: no longer than the finger")

    def on(self, tool: Tool) -> Tool:
        """Return a tool with this gripper in the place of another's; the camera stays."""
        x, y, _ = self.palm
        begin = self.offset + self.palm[2]
        body = Solid("gripper_body", (0.0, 0.0, begin / 2), (x / 2, y / 2, begin / 2))
        return replace(
            tool,
            mass=self.mass,
            com=(0.0, 0.0, self.offset + self.palm[2] / 2),
            stroke=self.opening,
            finger=begin,
            tip=begin + self.finger_length,
            pad=(self.finger_width, self.pad_thickness, self.pad_length),
            thickness=self.finger_thickness,
            speed=self.speed,
            body=body,
        )


PRESETS = {
    # TOOL's numbers
    "rethink": GripperSize(
        opening=TOOL.stroke,
        palm=(0.064, 0.11, 0.06),
        finger_length=TOOL.tip - 0.06,
        finger_width=TOOL.pad[0],
        finger_thickness=TOOL.thickness,
        pad_length=TOOL.pad[2],
        pad_thickness=TOOL.pad[1],
        mass=TOOL.mass,
    ),
    # MuJoCo Menagerie's robotiq_2f85: the spring link, 66.6 mm long, brings the tips from 160 mm (open) to 187 mm (pads
    # 10 mm apart) before the flange. The palm holds the open linkage: our estimate. Mass: the manual's, remembered.
    "robotiq-2f-85": GripperSize(
        opening=0.085,
        palm=(0.075, 0.149, 0.095),
        finger_length=0.092,
        finger_width=0.022,
        finger_thickness=0.012,
        pad_length=0.0375,
        pad_thickness=0.008,
        mass=0.925,
    ),
    # MuJoCo Menagerie's franka_emika_panda/hand.xml; the palm's width and height are franka_description's, remembered.
    "franka-hand": GripperSize(
        opening=0.08,
        palm=(0.063, 0.204, 0.066),
        finger_length=0.0462,
        finger_width=0.017,
        finger_thickness=0.013,
        pad_length=0.017,
        pad_thickness=0.008,
        mass=0.76,
        speed=0.05,
    ),
}
"""Grippers by name, with the source of their measures."""


def with_camera(tool: Tool, T_flange_cam: Array, outline: tuple[float, float, float] | None = None) -> Tool:
    """Return the tool with its camera at the pose of a hand-eye calibration.

    Args:
        tool: the gripper, with some camera.
        T_flange_cam: (4, 4) of the camera's optical frame, which is in the middle of the camera's front.
        outline: of its body: width, height, depth [m]; None is a D455's.
    """
    gap = inverse(tool.T_flange_cam) @ T_flange_cam
    shift, turn = np.linalg.norm(gap[:3, 3]), Rotation.from_matrix(gap[:3, :3]).magnitude()
    if outline is None and shift <= 0.005 and turn <= np.radians(3):  # alike: the tool keeps its outline
        return tool if np.allclose(gap, np.eye(4), atol=1e-6) else replace(tool, T_flange_cam=T_flange_cam)
    width, height, depth = (0.124, 0.029, 0.026) if outline is None else outline
    centre = T_flange_cam[:3, 3] - depth / 2 * T_flange_cam[:3, 2]
    half = np.abs(T_flange_cam[:3, :3]) @ np.array([width, height, depth]) / 2  # of the box along the flange's axes
    lower, upper = np.minimum(centre[:2], 0.0) - 0.02, np.maximum(centre[:2], 0.0) + 0.02
    thin = 0.003  # half the thickness of the bracket, as of `TOOL`, like its half width above [m]
    plate = _solid("bracket", np.append((lower + upper) / 2, thin), np.append((upper - lower) / 2, thin))
    camera = _solid("camera", centre, half)
    return replace(tool, T_flange_cam=T_flange_cam, camera=(camera, plate))


def _solid(name: str, centre: Array, half: Array) -> Solid:
    places: Any = [tuple(place.tolist()) for place in (centre, half)]
    return Solid(name, *places)
