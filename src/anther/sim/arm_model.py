"""An arm and its gripper as MuJoCo bodies with servos. Numbers of the robot come from its description.

The motor in the gripper is a carriage between hand and fingers, on flexures, driven by a voice coil. It slides along
the closing axis. So the pads push the stem by their shape, one after the other, and what is asked is what the stem
does; along the two other axes only friction would carry it, of which the grip has 10 N. It is a design of ours, not a
product: its numbers are guesses of what one of that size has.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import mujoco as mujoco_module
import numpy as np
from scipy.spatial.transform import Rotation

from anther.core.geometry import Array
from anther.robot.arm.model import BASE, FLANGE, ArmModel, Capsule, Solid
from anther.sim.truth import NOMINAL, Truth

mujoco: Any = mujoco_module  # its names come from C++ at run time; type checkers do not see them

FINGER_MASS = 0.04  # kg, our estimate
PAD_WAYS = ("x", "z", "turn")  # in which a pad gives way on its finger, see `add_arm`
GRIP_FORCE = 10.0
"""Of the gripper, usually at most [N]: about 30 % of 35 N (facts: sawyer 3)."""


class Coil(NamedTuple):
    """The voice coil that moves the fingers, and what it moves.

    Attributes:
        force: at most [N].
        carriage: coil, slide and the fingers' drive, which ride on it [kg]; the fingers come besides.
        spring: of the flexures that centre it [N/m]: alone with the fingers it swings at 16 Hz.
        damping: of flexures and slide [N s/m]: 5 % of critical.
        stop: either way, where it strikes [m].
    """

    force: float = 25.0
    carriage: float = 0.12
    spring: float = 2e3
    damping: float = 2.0
    stop: float = 2e-3


COIL = Coil()


def flex_name(joint: str) -> str:
    """Return the name of the hinge by which a joint's link runs ahead of its motor."""
    return f"{joint}_flex"


def add_arm(
    spec: Any,
    arm: ArmModel,
    truth: Truth = NOMINAL,
    *,
    grip_force: float = GRIP_FORCE,
    coil_force: float = 0.0,
    contype: int,
    conaffinity: int,
) -> None:
    """Add base, links, riders, flange, gripper, wrist camera and their actuators to a world.

    Actuators, in order: J positions, J velocities, J torques (feed-forward), 1 half opening of the gripper; with a
    motor its place, speed and force.
    Joints: those of the arm, `left_finger`, `right_finger` (each the half opening [m]). Where the truth has them, also
    those of `flex_name` [rad], and of each pad on its finger, in the flange's frame, `left_pad_x`, `left_pad_z` [m] and
    `left_pad_turn` about y [rad]. With a motor also
    `motor` [m], along the flange's y.

    Args:
        spec: the world.
        arm: its description.
        truth: of its joints, servos and pads.
        grip_force: what the gripper holds with at most, both fingers alike [N].
        coil_force: of the motor that shakes the fingers, at most [N]; 0: there is none.
        contype, conaffinity: MuJoCo's collision bits.
    """
    bits = {"contype": contype, "conaffinity": conaffinity}
    base = spec.worldbody.add_body(name=BASE)
    _capsules(base, BASE, arm.base_capsules, bits)
    _solids(base, arm.base_solids, bits)
    body = base
    for i in range(arm.count):
        body = _add_link(body, arm, i, truth, bits)
    _add_gripper(spec, body, arm, coil_force, truth, bits)
    for kind in ("position", "velocity", "torque"):
        for name in arm.joints:
            actuator = spec.add_actuator(name=f"{kind}_{name}", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            actuator.gainprm[0] = 1.0
    grip = spec.add_actuator(name="grip", target="left_finger", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    # one motor drives both fingers through the coupling, so it carries twice a finger's force
    grip.set_to_position(kp=2 * 40e3, kv=2 * 0.005 * 40e3)  # N/m, N s/m
    grip.forcelimited, grip.forcerange = 1, [-2 * grip_force, 2 * grip_force]
    if coil_force:
        _add_coil(spec)


def add_grips(spec: Any, segments: Iterable[str]) -> None:
    """Let the pads hold these capsules by a friction that does not drift.

    MuJoCo's friction is a damping of the speed between two bodies, and its constraints leave out how their Jacobian
    changes with time. At 40 Hz the mean of what is left out, over the damping, made a stem wander out of pads that held
    it with ten times its pull, by 2 mm/s, in steps of 0.1 ms as well. So friction damps with its own time, not with the
    pads' softness.

    Args:
        spec: the world, with plant and arm.
        segments: names of their geoms.
    """
    pads = [spec.geom(f"{side}_pad") for side in ("left", "right")]
    hold = 5e-4  # s in which friction stops what slides; MuJoCo takes twice the step where that is longer
    for segment in segments:
        for pad in pads:
            slide, twist, roll = pad.friction
            pair = spec.add_pair(geomname1=segment, geomname2=pad.name, condim=pad.condim)
            pair.friction = [slide, slide, twist, roll, roll]
            pair.solref, pair.solimp, pair.solreffriction = pad.solref[:2], pad.solimp, [hold, 1.0]


def tune_servos(model: Any, arm: ArmModel, truth: Truth) -> None:
    """Set the joint servos' gains from the inertia at neutral: kp = J w^2, kv = 2 J w (critically damped).

    Published simulation gains (kp 800, about 4 Hz) are too soft to shake with (facts: sawyer 2). The joints' springs,
    which the servos do not know, are damped by the inertia of their links at neutral.
    """
    data = mujoco.MjData(model)
    joints = [model.joint(name) for name in arm.joints]
    for joint, q in zip(joints, arm.neutral, strict=True):
        data.qpos[joint.qposadr[0]] = q
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    omega = 2 * np.pi * truth.servo_bandwidth
    for i, joint in enumerate(joints):
        inertia = mass[joint.dofadr[0], joint.dofadr[0]]
        kp, kv = inertia * omega**2, 2 * inertia * omega
        for actuator, slot, gain in ((i, 1, kp), (arm.count + i, 2, kv)):
            model.actuator_gainprm[actuator, 0] = gain
            model.actuator_biastype[actuator] = mujoco.mjtBias.mjBIAS_AFFINE
            model.actuator_biasprm[actuator, slot] = -gain
        if np.isfinite(truth.joint_stiffness):
            flex = model.joint(flex_name(arm.joints[i])).dofadr[0]
            stiffness = truth.joint_stiffness * arm.stiffness[i]
            model.dof_damping[flex] = 2 * 0.05 * np.sqrt(stiffness * mass[flex, flex])  # a guess


def _add_link(parent: Any, arm: ArmModel, i: int, truth: Truth, bits: dict[str, int]) -> Any:
    link, stiffness = arm.links[i], truth.joint_stiffness * arm.stiffness[i]
    body = parent.add_body(name=link.name, pos=link.xyz, quat=_quaternion(link.rpy), gravcomp=1)
    _inertial(body, link.mass, link.com, link.inertia)
    joint = body.add_joint(name=arm.joints[i], type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
    joint.range = [arm.lower[i], arm.upper[i]]
    joint.limited = 1
    joint.armature = arm.rotor_inertia[i]
    joint.actgravcomp = 1  # the motors carry the arm's weight too: it counts against their efforts
    joint.actfrclimited, joint.actfrcrange = 1, [-arm.effort[i], arm.effort[i]]
    if np.isfinite(stiffness):
        flex = body.add_joint(name=flex_name(arm.joints[i]), type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
        flex.stiffness, flex.armature = [stiffness, 0, 0], _least_inertia(stiffness)
    _capsules(body, link.name, link.capsules, bits)
    for rider in (rider for on, rider in arm.riders if on == i):
        riding = body.add_body(name=rider.name, pos=rider.xyz, gravcomp=1)
        _inertial(riding, rider.mass, rider.com, rider.inertia)
        _capsules(riding, rider.name, rider.capsules, bits)
        _solids(riding, rider.solids, bits)
    return body


def _add_gripper(spec: Any, wrist: Any, arm: ArmModel, coil_force: float, truth: Truth, bits: dict[str, int]) -> None:
    T, tool = arm.T_last_flange, arm.tool
    quat = Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)
    flange = wrist.add_body(name=FLANGE, pos=T[:3, 3], quat=quat, gravcomp=1)
    body = tool.mass - 2 * FINGER_MASS
    weight = np.array([body, tool.camera_mass])
    centre = weight @ np.array([tool.com, tool.camera[0].center]) / weight.sum()
    _inertial(flange, weight.sum(), centre, (4e-4, 1.2e-3, 1.1e-3, 0, 0, 0))
    _solids(flange, (tool.body, *tool.camera), bits)
    pad_z = tool.tip - tool.pad[2] / 2
    half_z = (tool.tip - tool.finger) / 2
    holder = _add_carriage(flange, coil_force) if coil_force else flange
    for side, sign, wear in (("left", 1, truth.pad_wear), ("right", -1, 0.0)):
        finger = holder.add_body(name=f"{side}_finger", gravcomp=1)
        _inertial(finger, FINGER_MASS, (0, 0.01 * sign, pad_z), (2e-5, 2e-5, 4e-6, 0, 0, 0))
        joint = finger.add_joint(name=f"{side}_finger", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, sign, 0])
        joint.range, joint.limited, joint.armature = [0, tool.stroke / 2], 1, 0.3  # kg: our estimate
        back = tool.pad[1] + tool.thickness / 2
        stick = Solid(
            f"{side}_stick",
            (0, sign * back, tool.finger + half_z),
            (tool.pad[0] / 2, tool.thickness / 2, half_z),
        )
        _solids(finger, (stick,), bits)
        backing, centre = _pad_holder(finger, side, np.array([0, sign * tool.pad[1] / 2, pad_z]), tool.pad, truth)
        pad = _box(backing, f"{side}_pad", centre, np.array(tool.pad) / 2, bits)
        pad.condim, pad.priority, pad.friction = 4, 1, [truth.pad_friction * (1 - wear), 0.003, 0.0001]
        pad.solref, pad.solimp = [0.004, 1.0], [0.95, 0.99, 0.001, 0.5, 2]
    coupling = spec.add_equality(
        name="fingers", type=mujoco.mjtEq.mjEQ_JOINT, name1="left_finger", name2="right_finger"
    )
    coupling.data[:2] = [0, 1]
    coupling.solref = [0.004, 1.0]


def _pad_holder(
    finger: Any, side: str, centre: Array, size: tuple[float, float, float], truth: Truth, mass: float = 0.004
) -> tuple[Any, Array]:
    """Return the body that carries a pad, and the pad's centre (3,) in it [m]: a finger, or its own on springs.

    Along the closing axis the pad is fixed: there the contact itself is soft. It weighs `mass` [kg], as 16 x 7 x 37 mm
    of silicone do, which lose a third of their strain energy in a swing at 10 Hz: a guess.
    """
    springs = [
        (name, kind, axis, stiffness / 2)  # two pads side by side
        for name, (kind, axis, stiffness) in zip(
            PAD_WAYS,
            (
                (mujoco.mjtJoint.mjJNT_SLIDE, [1, 0, 0], truth.pad_stiffness),
                (mujoco.mjtJoint.mjJNT_SLIDE, [0, 0, 1], truth.pad_stiffness),
                (mujoco.mjtJoint.mjJNT_HINGE, [0, 1, 0], truth.pad_rotation),
            ),
            strict=True,
        )
        if np.isfinite(stiffness)
    ]
    if not springs:
        return finger, centre
    finger.mass -= mass
    pad = finger.add_body(name=f"{side}_pad", pos=centre, gravcomp=1)
    x, y, z = np.square(size)
    _inertial(pad, mass, (0, 0, 0), (*(mass / 12 * np.array([y + z, x + z, x + y])), 0, 0, 0))
    ratio, frequency = 0.15, 10.0
    for name, kind, axis, stiffness in springs:
        joint = pad.add_joint(name=f"{side}_pad_{name}", type=kind, axis=axis)
        joint.stiffness, joint.armature = [stiffness, 0, 0], _least_inertia(stiffness)
        joint.damping = [2 * ratio * stiffness / (2 * np.pi * frequency), 0, 0]
    return pad, np.zeros(3)


def _add_carriage(flange: Any, force: float) -> Any:
    """Put the motor's carriage, 30 x 30 x 20 mm, on the flange and return it. Its joint is `motor` [m]."""
    body = flange.add_body(name="carriage", gravcomp=1)
    body.explicitinertial, body.mass, body.ipos = True, COIL.carriage, [0, 0, 0.05]
    body.inertia = COIL.carriage / 12 * np.array([0.03**2 + 0.02**2, 0.03**2 + 0.02**2, 2 * 0.03**2])
    joint = body.add_joint(name="motor", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 1, 0])
    joint.range, joint.limited = [-COIL.stop, COIL.stop], 1
    joint.stiffness, joint.damping = [COIL.spring, 0, 0], [COIL.damping, 0, 0]
    joint.actgravcomp, joint.actfrclimited, joint.actfrcrange = 1, 1, [-force, force]
    return body


def _add_coil(spec: Any) -> None:
    """Add the voice coil: a critically damped servo in place and in speed, and a force on top, limited together."""
    mass, omega = COIL.carriage + 2 * FINGER_MASS, 2 * np.pi * 100.0  # Hz
    gains = {"position": mass * omega**2 - COIL.spring, "velocity": 2 * mass * omega - COIL.damping, "force": 1.0}
    for kind, gain in gains.items():
        actuator = spec.add_actuator(name=f"motor_{kind}", target="motor", trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.gainprm[0] = gain
        if kind != "force":
            actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            actuator.biasprm[1 if kind == "position" else 2] = -gain


def motor_load(place: Any, speed: Any, acceleration: Any) -> Any:
    """Return the force that a motion asks of the coil [N] with nothing between the fingers."""
    return (COIL.carriage + 2 * FINGER_MASS) * acceleration + COIL.damping * speed + COIL.spring * place


def _least_inertia(stiffness: float) -> float:
    """Return the rotor inertia [kg or kg m^2] with which a spring alone swings at 150 Hz, which steps still follow."""
    return stiffness / (2 * np.pi * 150.0) ** 2


def _capsules(body: Any, name: str, capsules: tuple[Capsule, ...], bits: dict[str, int]) -> None:
    for i, capsule in enumerate(capsules):
        body.add_geom(
            name=f"{name}_{i}",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=[*capsule.start, *capsule.end],
            size=[capsule.radius, 0, 0],
            mass=0,
            **bits,
        )


def _solids(body: Any, solids: tuple[Solid, ...], bits: dict[str, int]) -> None:
    for solid in solids:
        _box(body, solid.name, solid.center, solid.half, bits)


def _box(body: Any, name: str, center: Any, half: Array | tuple[float, float, float], bits: dict[str, int]) -> Any:
    return body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_BOX, pos=center, size=half, mass=0, **bits)


def _inertial(body: Any, mass: float, com: Any, inertia: Any) -> None:
    body.explicitinertial = True
    body.mass, body.ipos, body.fullinertia = mass, com, inertia


def _quaternion(rpy: tuple[float, float, float]) -> Array:
    return Rotation.from_euler("xyz", rpy).as_quat(scalar_first=True)
