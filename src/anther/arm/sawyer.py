"""The Rethink Sawyer: constants and kinematics.

Source of every number unless a line says otherwise: Rethink Robotics' sawyer_base.urdf.xacro v5.3.0 (joints,
transforms, inertials, limits), sawyer_simulator's acceleration_limits.yaml, MuJoCo Menagerie's rethink_robotics_sawyer
(collision capsules) and intera_common's electric gripper URDF; facts: sawyer 1-4, 7. The URDF writes pi with few
digits; here it is exact, which changes positions by less than 0.3 micrometres.

Frames: base = world, z up, origin at the arm's mount (the floor is at z = -0.913 m). Link frames turn about their own
+z. Flange = the SDK's `right_hand`: the gripper approaches along its +z and its fingers close along its +-y.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from anther.geometry import Array, transform
from anther.grasp.clearance import Gripper

JOINTS = tuple(f"right_j{i}" for i in range(7))
LOWER = np.array([-3.0503, -3.8095, -3.0426, -3.0439, -2.9761, -2.9761, -4.7124])  # rad
UPPER = np.array([3.0503, 2.2736, 3.0426, 3.0439, 2.9761, 2.9761, 4.7124])  # rad
VELOCITY = np.array([1.74, 1.328, 1.957, 1.957, 3.485, 3.485, 4.545])  # rad/s
ACCELERATION = np.array([10.0, 8.0, 10.0, 10.0, 12.0, 12.0, 12.0])  # rad/s^2, SDK maximum
EFFORT = np.array([80.0, 80.0, 40.0, 40.0, 9.0, 9.0, 9.0])  # N m
ROTOR_INERTIA = np.array([1.0, 1.0, 0.5, 0.5, 0.1, 0.1, 0.1])
"""Rotor inertia seen at the joint [kg m^2]. None is published: Menagerie has 1 everywhere, with which the wrist's 9 N m
could not reach the SDK's own 12 rad/s^2, so the small joints have less. Our estimate."""
NEUTRAL = np.array([0.0, -1.18, 0.0, 2.18, 0.0, 0.57, 3.3161])  # rad; the last is pi + the 10 degree mount twist
READY = np.array([0.0, -1.57, 0.0, 2.57, 0.0, 0.57, 3.3161])  # rad; neutral drawn back from the plant, our choice
FLOOR_Z = -0.913  # m


@dataclass(frozen=True, slots=True)
class Capsule:
    """A cylinder with round ends: axis from `start` to `end` (3,) [m] in its link's frame, `radius` [m]."""

    start: tuple[float, float, float]
    end: tuple[float, float, float]
    radius: float


@dataclass(frozen=True, slots=True)
class Solid:
    """A box aligned with its frame: `center` and `half` extents (3,) [m]."""

    name: str
    center: tuple[float, float, float]
    half: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Link:
    """A moving link.

    Attributes:
        name: as in the URDF; link i turns about its +z by joint i.
        xyz, rpy: joint frame in the parent link's frame at zero angle [m], [rad], R = Rz(y) Ry(p) Rx(r).
        mass: [kg].
        com: centre of mass in the link frame [m].
        inertia: ixx, iyy, izz, ixy, ixz, iyz about the centre of mass [kg m^2].
        capsules: collision shape in the link frame.
    """

    name: str
    xyz: tuple[float, float, float]
    rpy: tuple[float, float, float]
    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float]
    capsules: tuple[Capsule, ...]


LINKS = (
    Link(
        "right_l0",
        (0, 0, 0.08),
        (0, 0, 0),
        5.3213,
        (0.024366, 0.010969, 0.14363),
        (0.053314, 0.057902, 0.023659, 0.0047093, 0.011734, 0.0080179),
        (Capsule((0, 0, -0.005), (0, 0, 0.25), 0.07),),
    ),
    Link(
        "right_l1",
        (0.081, 0.05, 0.237),
        (-pi / 2, pi / 2, 0),
        4.505,
        (-0.0030849, -0.026811, 0.092521),
        (0.022398, 0.014613, 0.017295, -0.00023986, -0.00029362, -0.0060875),
        (Capsule((0, 0, -0.06), (0, 0, 0.13), 0.068),),
    ),
    Link(
        "right_l2",
        (0, -0.14, 0.1425),
        (pi / 2, 0, 0),
        1.745,
        (-0.00016044, -0.014967, 0.13582),
        (0.025506, 0.0253, 0.0034179, 4.4101e-06, 1.4955e-05, -0.0033204),
        (Capsule((0, 0, -0.15), (0, 0, 0.26), 0.055),),
    ),
    Link(
        "right_l3",
        (0, -0.042, 0.26),
        (-pi / 2, 0, 0),
        2.5097,
        (-0.0048135, -0.0281, -0.084154),
        (0.01016, 0.0065685, 0.0069078, -9.7452e-06, 0.00026624, 0.0030316),
        (Capsule((0, 0, -0.115), (0, 0, 0.03), 0.055),),
    ),
    Link(
        "right_l4",
        (0, -0.125, -0.1265),
        (pi / 2, 0, 0),
        1.1136,
        (-0.0018844, 0.0069001, 0.1341),
        (0.013557, 0.013555, 0.0013658, 1.8109e-05, 0.00013523, 0.0010561),
        (Capsule((0, 0, -0.13), (0, 0, 0.27), 0.045),),
    ),
    Link(
        "right_l5",
        (0, 0.031, 0.275),
        (-pi / 2, 0, 0),
        1.5625,
        (0.0061133, -0.023697, 0.076416),
        (0.0047328, 0.0029676, 0.0031762, 0.00011526, 4.6269e-05, -0.0011557),
        (Capsule((0, 0, -0.02), (0, 0, 0.1), 0.045), Capsule((0, 0, 0.105), (0, -0.082, 0.105), 0.045)),
    ),
    Link(
        "right_l6",
        (0, -0.11, 0.1053),
        (-pi / 2, -pi / 18, pi),
        0.3292,
        (-8.0726e-06, 0.0085838, -0.0049566),
        (0.00031105, 0.00021549, 0.00035976, 1.4771e-06, -3.7074e-07, -8.4533e-06),
        (Capsule((0, 0, -0.01), (0, 0, 0.01), 0.045),),
    ),
)

# What never moves against the base (pedestal 60.9 kg), and the head, which rides on right_l0 with head_pan = 0.
# The head's face shapes overlap right_l2 at neutral (facts: sawyer 1e), so that pair is never checked.
BASE_CAPSULES = (Capsule((0, 0, 0.0), (0, 0, 0.16), 0.08), Capsule((-0.02, 0, -0.42), (-0.02, 0, -0.18), 0.18))
BASE_SOLIDS = (
    Solid("controller_box", (-0.325, 0, -0.38), (0.11, 0.2, 0.265)),
    Solid("pedestal_feet", (-0.1225, 0, -0.758), (0.385, 0.35, 0.155)),
)
HEAD_XYZ = (0.0, 0.0, 0.2965)  # head frame in right_l0 [m]
HEAD_MASS = 1.5795  # kg
HEAD_COM = (0.0053207, -2.6549e-05, 0.1021)  # m
HEAD_INERTIA = (0.011833, 0.0082709, 0.0049661, -4.4669e-06, 4.9425e-05, 4.2124e-07)  # kg m^2
HEAD_CAPSULES = (Capsule((-0.005, 0, 0.02), (-0.005, 0, 0.205), 0.04),)
HEAD_SOLIDS = (Solid("screen", (0.025, 0, 0.1), (0.01, 0.13, 0.08)),)

T_L6_FLANGE = transform(Rotation.from_rotvec([0, 0, pi / 2]).as_matrix(), [0, 0, 0.0245])

# Gripper: Rethink electric parallel gripper, standard narrow fingers, soft tips (facts: sawyer 3). In the flange frame.
GRIPPER_MASS = 0.47  # kg, the whole end effector
GRIPPER_COM = (0.0028, -0.0004, 0.0343)  # m
STROKE = Gripper().stroke  # m, largest opening between the pads
FINGER_Z = 0.05992  # m, where the fingers leave the body: 0.0018 + 0.0176 + 0.04552 - 0.005
TIP_Z = 0.13562  # m, the SDK's tip
PAD = (0.016, 0.007, 0.037)  # m: width along x, thickness along y, length along z, ending at the tip
FINGER_THICKNESS = 0.008  # m along y behind the pad; our estimate, the URDF's fingers are meshes
FINGER_SPEED = 0.15  # m/s, the slowest the SDK accepts
# The body's outline is our estimate from the gripper's mesh extents; no primitive is published for it.
GRIPPER_BODY = Solid("gripper_body", (0, 0, 0.03), (0.032, 0.055, 0.03))
T_FLANGE_GRASP = transform(np.eye(3), [0, 0, TIP_Z - PAD[2] / 2])  # centre between the pads

# Wrist camera: Intel RealSense D455, 124 x 29 x 26 mm, 0.12 kg with bracket. The bracket is our choice: the camera sits
# 9 cm beside the flange axis along +x with its long side along y and looks parallel to the approach axis. The nearest
# edge of the fingers is then 38 degrees off the optical axis, outside the 29 degree half field of view. The image is
# upright when the flange's +x points up.
CAMERA_MASS = 0.12  # kg
T_FLANGE_CAM = transform(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), [0.09, 0, 0.03])
CAMERA_SOLIDS = (
    Solid("camera", (0.09, 0, 0.017), (0.0145, 0.062, 0.013)),
    Solid("bracket", (0.0575, 0, 0.003), (0.0325, 0.02, 0.003)),
)


def finger_solids(opening: float) -> tuple[Solid, ...]:
    """Return the two fingers, each a box of finger and pad together, in the flange frame.

    Args:
        opening: distance between the pads' faces [m].
    """
    half = (PAD[1] + FINGER_THICKNESS) / 2
    y, z, half_z = opening / 2 + half, (FINGER_Z + TIP_Z) / 2, (TIP_Z - FINGER_Z) / 2
    return tuple(
        Solid(f"{side}_finger", (0, sign * y, z), (PAD[0] / 2, half, half_z))
        for side, sign in (("left", 1), ("right", -1))
    )


def link_poses(q: ArrayLike) -> Array:
    """Return the (..., 8, 4, 4) base-frame poses of right_l0..right_l6 and the flange for joints (..., 7) [rad]."""
    q = np.asarray(q, dtype=np.float64)
    local = LOCAL * np.ones((*q.shape, 1, 1))
    c, s = np.cos(q)[..., None], np.sin(q)[..., None]
    local[..., :, 0] = LOCAL[..., :, 0] * c + LOCAL[..., :, 1] * s
    local[..., :, 1] = LOCAL[..., :, 1] * c - LOCAL[..., :, 0] * s
    poses = np.empty((*q.shape[:-1], 8, 4, 4))
    poses[..., 0, :, :] = local[..., 0, :, :]
    for i in range(1, 7):
        poses[..., i, :, :] = poses[..., i - 1, :, :] @ local[..., i, :, :]
    poses[..., 7, :, :] = poses[..., 6, :, :] @ T_L6_FLANGE
    return poses


def forward(q: ArrayLike) -> Array:
    """Return T_world_flange (..., 4, 4) for joints (..., 7) [rad]."""
    return link_poses(q)[..., 7, :, :]


def jacobian(q: ArrayLike) -> Array:
    """Return the (..., 6, 7) Jacobian of the flange: linear [m/rad] above angular [rad/rad], both in the base frame."""
    return jacobian_of(link_poses(q))


def jacobian_of(poses: Array) -> Array:
    """Return the (..., 6, 7) flange Jacobian from the (..., 8, 4, 4) result of `link_poses`."""
    axes = poses[..., :7, :3, 2]
    arms = poses[..., 7:, :3, 3] - poses[..., :7, :3, 3]
    x, y, z = np.moveaxis(axes, -1, 0)
    a, b, c = np.moveaxis(arms, -1, 0)
    return np.stack([y * c - z * b, z * a - x * c, x * b - y * a, x, y, z], axis=-2)  # numpy's cross is slow


def _local_transforms() -> Array:
    return np.stack([transform(Rotation.from_euler("xyz", link.rpy).as_matrix(), link.xyz) for link in LINKS])


LOCAL = _local_transforms()
"""(7, 4, 4) pose of right_l0..right_l6 in the link before, at joint angle 0."""
