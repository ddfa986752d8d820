"""The motor in the gripper as MuJoCo has it: a carriage between hand and fingers, on flexures, driven by a voice coil.

It slides along the closing axis. So the pads push the stem by their shape, one after the other, and what is asked is
what the stem does; along the two other axes only friction would carry it, of which the grip has 10 N.
It is a design of ours, not a product: its numbers are guesses of what one of that size has.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco as mujoco_module
import numpy as np

mujoco: Any = mujoco_module  # its names come from C++ at run time; type checkers do not see them

SPRING = 2e3
"""Of the flexures that centre it [N/m]: alone with the fingers it swings at 16 Hz."""
BANDWIDTH = 100.0
"""Of its position servo [Hz]."""
STOP = 2e-3
"""Either way, where it strikes [m]."""
KINDS = ("position", "velocity", "force")
"""Of its actuators, in order."""


@dataclass(frozen=True, slots=True)
class Params:
    """The motor.

    Attributes:
        mass: of coil, slide and the fingers' drive, which ride on it [kg]; the fingers come besides.
        damping: of flexures and slide [N s/m]: 5 % of critical.
        force: of the coil at most [N].
    """

    mass: float = 0.12
    damping: float = 2.0
    force: float = 25.0

    def servo(self, fingers: float) -> tuple[float, float]:
        """Return gains in place [N/m] and speed [N s/m], critically damped, with two `fingers` [kg each] on it."""
        mass, omega = self.mass + 2 * fingers, 2 * np.pi * BANDWIDTH
        return mass * omega**2 - SPRING, 2 * mass * omega - self.damping

    def load(self, fingers: float, place: Any, speed: Any, acceleration: Any) -> Any:
        """Return the force that a motion asks of the coil [N] with nothing between two `fingers` [kg each]."""
        return (self.mass + 2 * fingers) * acceleration + self.damping * speed + SPRING * place


def add_carriage(flange: Any, params: Params) -> Any:
    """Put the carriage on the flange and return it: the fingers are to be put on it. Its joint is `motor` [m]."""
    body = flange.add_body(name="carriage", gravcomp=1)
    body.explicitinertial, body.mass, body.ipos = True, params.mass, [0, 0, 0.05]
    body.inertia = params.mass / 12 * np.array([0.03**2 + 0.02**2, 0.03**2 + 0.02**2, 2 * 0.03**2])  # 30 x 30 x 20 mm
    joint = body.add_joint(name="motor", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 1, 0])
    joint.range, joint.limited = [-STOP, STOP], 1
    joint.stiffness, joint.damping = [SPRING, 0, 0], [params.damping, 0, 0]
    joint.actgravcomp, joint.actfrclimited, joint.actfrcrange = 1, 1, [-params.force, params.force]
    return body


def add_coil(spec: Any, params: Params, fingers: float) -> None:
    """Add the voice coil: a servo in place and in speed, and a force on top, all three limited together."""
    kp, kv = params.servo(fingers)
    for kind, gain in zip(KINDS, (kp, kv, 1.0), strict=True):
        actuator = spec.add_actuator(name=f"motor_{kind}", target="motor", trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.gainprm[0] = gain
        if kind != "force":
            actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            actuator.biasprm[1 if kind == "position" else 2] = -gain
