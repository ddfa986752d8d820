"""The Sawyer and its gripper as MuJoCo bodies with servos. Numbers of the robot come from `anther.arm.sawyer`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco as mujoco_module
import numpy as np
from scipy.spatial.transform import Rotation

from anther.arm import sawyer
from anther.geometry import Array

mujoco: Any = mujoco_module  # its names come from C++ at run time; type checkers do not see them

FINGER_MASS = 0.04  # kg, our estimate
FINGER_ARMATURE = 0.3  # kg, drive inertia seen at a finger, our estimate
PAD_FRICTION = 1.0  # silicone on a stem, our estimate; the brief of the cell


@dataclass(frozen=True, slots=True)
class Params:
    """The servos.

    Attributes:
        bandwidth: natural frequency of each critically damped joint servo [Hz]. Published simulation gains (kp 800,
            about 4 Hz) are too soft to shake with (facts: sawyer 2).
        grip_force: what the gripper holds with at most, both fingers alike [N]: about 30 % of 35 N (facts: sawyer 3).
        grip_stiffness: of the gripper's position servo [N/m].
        pad_softness: time constant of pad contact [s].
    """

    bandwidth: float = 10.0
    grip_force: float = 10.0
    grip_stiffness: float = 40e3
    pad_softness: float = 0.004


def add_arm(spec: Any, params: Params, *, contype: int, conaffinity: int) -> None:
    """Add base, links `right_l0`.., flange, gripper, wrist camera and their actuators to a world.

    Actuators, in order: 7 positions, 7 velocities, 7 torques (feed-forward), 1 half opening of the gripper.
    Joints: `right_j0`.., `left_finger`, `right_finger` (each the half opening [m]).
    """
    bits = {"contype": contype, "conaffinity": conaffinity}
    base = spec.worldbody.add_body(name="base")
    _capsules(base, "base", sawyer.BASE_CAPSULES, bits)
    _solids(base, sawyer.BASE_SOLIDS, bits)
    body = base
    for i, link in enumerate(sawyer.LINKS):
        body = _add_link(body, i, link, bits)
        if i == 0:
            head = body.add_body(name="head", pos=sawyer.HEAD_XYZ, gravcomp=1)
            _inertial(head, sawyer.HEAD_MASS, sawyer.HEAD_COM, sawyer.HEAD_INERTIA)
            _capsules(head, "head", sawyer.HEAD_CAPSULES, bits)
            _solids(head, sawyer.HEAD_SOLIDS, bits)
    _add_gripper(spec, body, params, bits)
    for kind in ("position", "velocity", "torque"):
        for name in sawyer.JOINTS:
            actuator = spec.add_actuator(name=f"{kind}_{name}", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            actuator.gainprm[0] = 1.0
    grip = spec.add_actuator(name="grip", target="left_finger", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    # one motor drives both fingers through the coupling, so it carries twice a finger's force
    grip.set_to_position(kp=2 * params.grip_stiffness, kv=2 * 0.005 * params.grip_stiffness)
    grip.forcelimited, grip.forcerange = 1, [-2 * params.grip_force, 2 * params.grip_force]


def tune_servos(model: Any, params: Params) -> None:
    """Set the joint servos' gains from the inertia at neutral: kp = J w^2, kv = 2 J w (critically damped)."""
    data = mujoco.MjData(model)
    joints = [model.joint(name) for name in sawyer.JOINTS]
    for joint, q in zip(joints, sawyer.NEUTRAL, strict=True):
        data.qpos[joint.qposadr[0]] = q
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    omega = 2 * np.pi * params.bandwidth
    for i, joint in enumerate(joints):
        inertia = mass[joint.dofadr[0], joint.dofadr[0]]
        kp, kv = inertia * omega**2, 2 * inertia * omega
        for actuator, slot, gain in ((i, 1, kp), (7 + i, 2, kv)):
            model.actuator_gainprm[actuator, 0] = gain
            model.actuator_biastype[actuator] = mujoco.mjtBias.mjBIAS_AFFINE
            model.actuator_biasprm[actuator, slot] = -gain


def _add_link(parent: Any, i: int, link: sawyer.Link, bits: dict[str, int]) -> Any:
    body = parent.add_body(name=link.name, pos=link.xyz, quat=_quaternion(link.rpy), gravcomp=1)
    _inertial(body, link.mass, link.com, link.inertia)
    joint = body.add_joint(name=sawyer.JOINTS[i], type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
    joint.range = [sawyer.LOWER[i], sawyer.UPPER[i]]
    joint.limited = 1
    joint.armature = sawyer.ROTOR_INERTIA[i]
    joint.actgravcomp = 1  # the motors carry the arm's weight too: it counts against their efforts
    joint.actfrclimited, joint.actfrcrange = 1, [-sawyer.EFFORT[i], sawyer.EFFORT[i]]
    _capsules(body, link.name, link.capsules, bits)
    return body


def _add_gripper(spec: Any, wrist: Any, params: Params, bits: dict[str, int]) -> None:
    T = sawyer.T_L6_FLANGE
    quat = Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)
    flange = wrist.add_body(name="flange", pos=T[:3, 3], quat=quat, gravcomp=1)
    body = sawyer.GRIPPER_MASS - 2 * FINGER_MASS
    weight = np.array([body, sawyer.CAMERA_MASS])
    centre = weight @ np.array([sawyer.GRIPPER_COM, sawyer.CAMERA_SOLIDS[0].center]) / weight.sum()
    _inertial(flange, weight.sum(), centre, (4e-4, 1.2e-3, 1.1e-3, 0, 0, 0))
    _solids(flange, (sawyer.GRIPPER_BODY, *sawyer.CAMERA_SOLIDS), bits)
    pad_z = sawyer.TIP_Z - sawyer.PAD[2] / 2
    half_z = (sawyer.TIP_Z - sawyer.FINGER_Z) / 2
    for side, sign in (("left", 1), ("right", -1)):
        finger = flange.add_body(name=f"{side}_finger", gravcomp=1)
        _inertial(finger, FINGER_MASS, (0, 0.01 * sign, pad_z), (2e-5, 2e-5, 4e-6, 0, 0, 0))
        joint = finger.add_joint(name=f"{side}_finger", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, sign, 0])
        joint.range, joint.limited, joint.armature = [0, sawyer.STROKE / 2], 1, FINGER_ARMATURE
        back = sawyer.PAD[1] + sawyer.FINGER_THICKNESS / 2
        stick = sawyer.Solid(
            f"{side}_stick",
            (0, sign * back, sawyer.FINGER_Z + half_z),
            (sawyer.PAD[0] / 2, sawyer.FINGER_THICKNESS / 2, half_z),
        )
        _solids(finger, (stick,), bits)
        pad = _box(finger, f"{side}_pad", (0, sign * sawyer.PAD[1] / 2, pad_z), np.array(sawyer.PAD) / 2, bits)
        pad.condim, pad.priority, pad.friction = 4, 1, [PAD_FRICTION, 0.003, 0.0001]
        pad.solref, pad.solimp = [params.pad_softness, 1.0], [0.95, 0.99, 0.001, 0.5, 2]
    coupling = spec.add_equality(
        name="fingers", type=mujoco.mjtEq.mjEQ_JOINT, name1="left_finger", name2="right_finger"
    )
    coupling.data[:2] = [0, 1]
    coupling.solref = [0.004, 1.0]


def _capsules(body: Any, name: str, capsules: tuple[sawyer.Capsule, ...], bits: dict[str, int]) -> None:
    for i, capsule in enumerate(capsules):
        body.add_geom(
            name=f"{name}_{i}",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=[*capsule.start, *capsule.end],
            size=[capsule.radius, 0, 0],
            mass=0,
            **bits,
        )


def _solids(body: Any, solids: tuple[sawyer.Solid, ...], bits: dict[str, int]) -> None:
    for solid in solids:
        _box(body, solid.name, solid.center, solid.half, bits)


def _box(body: Any, name: str, center: Any, half: Array | tuple[float, float, float], bits: dict[str, int]) -> Any:
    return body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_BOX, pos=center, size=half, mass=0, **bits)


def _inertial(body: Any, mass: float, com: Any, inertia: Any) -> None:
    body.explicitinertial = True
    body.mass, body.ipos, body.fullinertia = mass, com, inertia


def _quaternion(rpy: tuple[float, float, float]) -> Array:
    return Rotation.from_euler("xyz", rpy).as_quat(scalar_first=True)
