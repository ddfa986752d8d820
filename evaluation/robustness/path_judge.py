"""An independent look at planned motions, every millisecond: limits, torques, and how near the arm comes to things.

Distances are MuJoCo's, between the shapes of `arm_model` and what stands there: another engine than the planner's, and
other code. T samples at 1 kHz.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco as mujoco_module
import numpy as np
from scipy.interpolate import CubicHermiteSpline

from anther.core import Array, Box
from anther.robot import ArmModel, JointTrajectory
from anther.robot.arm.model import CAMERA, FLANGE, GRIPPER
from anther.robot.arm.motions import torques
from anther.robot.arm.sawyer import SAWYER
from anther.sim import arm_model

mujoco: Any = mujoco_module  # its names come from C++ at run time; type checkers do not see them

PERIOD = 1e-3
"""s between samples."""
SIGHT = 0.05
"""m, distances beyond this are not measured."""
ROBOT, SCENERY = 1, 2
SELF = "itself"
_BODIES = {GRIPPER: (FLANGE, "left_finger", "right_finger"), CAMERA: (FLANGE,)}


@dataclass(frozen=True, slots=True)
class PathVerdict:
    """What a motion needs and how near it comes.

    Attributes:
        seconds: it lasts [s].
        room: smallest distance of any joint from its range's ends [rad].
        velocity, acceleration, effort: largest shares of the joints' limits.
        clearance: smallest distance of the arm, gripper or camera to each named thing and to `SELF` [m]; negative where
            they meet, `SIGHT` where they are farther apart than that.
    """

    seconds: float
    room: float
    velocity: float
    acceleration: float
    effort: float
    clearance: dict[str, float] = field(default_factory=dict)


class Surroundings:
    """An arm among boxes and upright cylinders.

    Args:
        boxes: by name.
        cylinders: by name; each the upright cylinder inscribed in a box of square base.
        arm: its description.
    """

    def __init__(self, boxes: dict[str, Box], cylinders: dict[str, Box], arm: ArmModel = SAWYER) -> None:
        self.arm = arm
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        kinds = ((mujoco.mjtGeom.mjGEOM_BOX, boxes), (mujoco.mjtGeom.mjGEOM_CYLINDER, cylinders))
        for kind, things in kinds:
            for name, box in things.items():
                half = (box.upper - box.lower) / 2
                size = half if kind == mujoco.mjtGeom.mjGEOM_BOX else [half[0], half[2], 0]
                spec.worldbody.add_geom(
                    name=name, type=kind, pos=(box.lower + box.upper) / 2, size=size, contype=SCENERY, conaffinity=ROBOT
                )
        arm_model.add_arm(spec, arm, contype=ROBOT, conaffinity=ROBOT | SCENERY)
        for pair in arm.neighbours:
            first, second = (_BODIES.get(link, (link,)) for link in pair)
            for a, b in ((a, b) for a in first for b in second if a != b):
                spec.add_exclude(bodyname1=a, bodyname2=b)
        for geom in spec.geoms:
            geom.margin = SIGHT
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._arm = [self._model.joint(name).qposadr[0] for name in arm.joints]
        for side in ("left", "right"):
            self._data.qpos[self._model.joint(f"{side}_finger").qposadr[0]] = arm.tool.stroke / 2
        self._names = [*boxes, *cylinders]

    def clearance(self, q: Array) -> dict[str, float]:
        """Return the distance to each thing, and to `SELF`, at joints (J,) [m], `SIGHT` at most."""
        m, d = self._model, self._data
        d.qpos[self._arm] = q
        mujoco.mj_kinematics(m, d)
        mujoco.mj_comPos(m, d)
        mujoco.mj_collision(m, d)
        out = dict.fromkeys([*self._names, SELF], SIGHT)
        for i in range(d.ncon):
            names = {m.geom(int(g)).name for g in d.contact[i].geom} & set(self._names)
            thing = names.pop() if names else SELF
            out[thing] = min(out[thing], float(d.contact[i].dist))
        return out


def judge_path(motions: Sequence[JointTrajectory], surroundings: Surroundings, every: int = 1) -> PathVerdict:
    """Judge motions that follow each other, at 1 kHz.

    Args:
        motions: cubic between their samples, as an arm follows them.
        surroundings: what they must not touch.
        every: distances are measured at every so many of the samples only.
    """
    arm, parts = surroundings.arm, [_sampled(motion) for motion in motions]
    q, v, a = (np.concatenate([part[i] for part in parts]) for i in range(3))
    seen = [surroundings.clearance(row) for row in np.concatenate([part[0][::every] for part in parts])]
    return PathVerdict(
        seconds=sum(motion.duration for motion in motions),
        room=float(np.minimum(q - arm.lower, arm.upper - q).min()),
        velocity=float(np.abs(v / arm.velocity).max()),
        acceleration=float(np.abs(a / arm.acceleration).max()),
        effort=float(np.abs(torques(arm, q, v, a) / arm.effort).max()),
        clearance={name: min(s[name] for s in seen) for name in seen[0]},
    )


def _sampled(motion: JointTrajectory) -> tuple[Array, Array, Array]:
    """Return joints, rates and their differences at 1 kHz, each (T, J)."""
    curve = CubicHermiteSpline(motion.times, motion.positions, motion.velocities)
    t = np.append(np.arange(0, motion.duration, PERIOD), motion.duration)
    v = curve(t, 1)
    return curve(t), v, np.gradient(v, t, axis=0)
