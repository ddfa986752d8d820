"""The Rethink Sawyer, and the tool that is planned with on every arm: Rethink's gripper with a D455 beside it.

Source of every number unless a line says otherwise: Rethink Robotics' sawyer_base.urdf.xacro v5.3.0 (joints,
transforms, inertials, limits), sawyer_simulator's acceleration_limits.yaml, MuJoCo Menagerie's rethink_robotics_sawyer
(collision capsules) and intera_common's electric gripper URDF; facts: sawyer 1-4, 7. The URDF writes pi with few
digits; here it is exact, which changes positions by less than 0.3 micrometres.

Frames: base = world, z up, origin at the arm's mount (the floor is at z = -0.913 m). Link frames turn about their own
+z. Flange = the SDK's `right_hand`: the gripper approaches along its +z and its fingers close along its +-y.
"""

from __future__ import annotations

from math import pi

import numpy as np
from scipy.spatial.transform import Rotation

from anther.core.geometry import transform
from anther.robot.arm.model import CAMERA, GRIPPER, ArmModel, Capsule, Link, Solid, Tool

TOOL = Tool(
    # Rethink electric parallel gripper, standard narrow fingers, soft tips (facts: sawyer 3)
    mass=0.47,
    com=(0.0028, -0.0004, 0.0343),
    stroke=0.041667,
    finger=0.05992,  # 0.0018 + 0.0176 + 0.04552 - 0.005
    tip=0.13562,  # the SDK's
    pad=(0.016, 0.007, 0.037),
    thickness=0.008,  # our estimate, the URDF's fingers are meshes
    speed=0.15,  # the slowest the SDK accepts
    # our estimate from the gripper's mesh extents; no primitive is published for it
    body=Solid("gripper_body", (0, 0, 0.03), (0.032, 0.055, 0.03)),
    # Intel RealSense D455, 124 x 29 x 26 mm, 0.12 kg with bracket. The bracket is our choice: the camera sits 9 cm
    # beside the flange axis along +x with its long side along y and looks parallel to the approach axis. The nearest
    # edge of the fingers is then 38 degrees off the optical axis, outside the 29 degree half field of view. The image
    # is upright when the flange's +x points up.
    camera_mass=0.12,
    T_flange_cam=transform(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), [0.09, 0, 0.03]),
    camera=(
        Solid("camera", (0.09, 0, 0.017), (0.0145, 0.062, 0.013)),
        Solid("bracket", (0.0575, 0, 0.003), (0.0325, 0.02, 0.003)),
    ),
)

_LINKS = (
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

SAWYER = ArmModel(
    name="sawyer",
    joints=tuple(f"right_j{i}" for i in range(7)),
    lower=np.array([-3.0503, -3.8095, -3.0426, -3.0439, -2.9761, -2.9761, -4.7124]),
    upper=np.array([3.0503, 2.2736, 3.0426, 3.0439, 2.9761, 2.9761, 4.7124]),
    velocity=np.array([1.74, 1.328, 1.957, 1.957, 3.485, 3.485, 4.545]),
    acceleration=np.array([10.0, 8.0, 10.0, 10.0, 12.0, 12.0, 12.0]),  # SDK maximum
    effort=np.array([80.0, 80.0, 40.0, 40.0, 9.0, 9.0, 9.0]),
    # None is published: Menagerie has 1 everywhere, with which the wrist's 9 N m could not reach the SDK's own 12
    # rad/s^2, so the small joints have less. Our estimate.
    rotor_inertia=np.array([1.0, 1.0, 0.5, 0.5, 0.1, 0.1, 0.1]),
    # Rethink's figures for Baxter, whose drives are of the same kind; remembered, none was found for Sawyer. With them,
    # its first mode lies at 3 Hz; an arm that is sold to carry 4 kg to 0.1 mm has it at some 8-24 Hz, which is a factor
    # of 6-60.
    stiffness=np.array([843.0, 843.0, 843.0, 843.0, 250.0, 250.0, 250.0]),
    links=_LINKS,
    T_last_flange=transform(Rotation.from_rotvec([0, 0, pi / 2]).as_matrix(), [0, 0, 0.0245]),
    tool=TOOL,
    neutral=np.array([0.0, -1.18, 0.0, 2.18, 0.0, 0.57, 3.3161]),  # the last is pi + the 10 degree mount twist
    ready=np.array([0.0, -1.57, 0.0, 2.57, 0.0, 0.57, 3.3161]),  # neutral drawn back from the plant, our choice
    # Driven to while masks, cloud and plan are computed, and near the joints of most grasps of eight development
    # captures: the way to the best took 1.1 s in the median, by a straight line of the joints in four of eight, instead
    # of 1.8 s from the last view. The gripper's tip is 0.44 m from the plant's axis.
    waiting=np.array([0.972, -0.046, 0.307, 1.759, -2.142, 1.903, 1.694]),
    # Links so near each other in the chain that they cannot collide, or that always overlap by their shapes
    # (facts: sawyer 1e and 7, after sawyer_moveit's SRDF).
    neighbours=(
        *((f"right_l{i}", f"right_l{i + 1}") for i in range(6)),
        *((f"right_l{i}", f"right_l{i + 2}") for i in range(5)),
        ("base", "right_l0"),
        ("base", "right_l1"),
        ("base", "head"),
        ("head", "right_l0"),
        ("head", "right_l1"),
        ("head", "right_l2"),
        ("right_l0", "right_l3"),
        ("right_l1", "right_l4"),
        *((f"right_l{i}", tool) for i in (3, 4, 5, 6) for tool in (GRIPPER, CAMERA)),
        (GRIPPER, CAMERA),
    ),
    shoulder=np.array([0.0, 0.0, 0.317]),
    reach=1.13,  # facts: sawyer 2
    floor=-0.913,
    # what never moves against the base (pedestal 60.9 kg)
    base_capsules=(Capsule((0, 0, 0.0), (0, 0, 0.16), 0.08), Capsule((-0.02, 0, -0.42), (-0.02, 0, -0.18), 0.18)),
    base_solids=(
        Solid("controller_box", (-0.325, 0, -0.38), (0.11, 0.2, 0.265)),
        Solid("pedestal_feet", (-0.1225, 0, -0.758), (0.385, 0.35, 0.155)),
    ),
    # The head rides on right_l0 with head_pan = 0. Its face shapes overlap right_l2 at neutral (facts: sawyer 1e), so
    # that pair is never checked.
    riders=(
        (
            0,
            Link(
                "head",
                (0.0, 0.0, 0.2965),
                (0.0, 0.0, 0.0),
                1.5795,
                (0.0053207, -2.6549e-05, 0.1021),
                (0.011833, 0.0082709, 0.0049661, -4.4669e-06, 4.9425e-05, 4.2124e-07),
                (Capsule((-0.005, 0, 0.02), (-0.005, 0, 0.205), 0.04),),
                (Solid("screen", (0.025, 0, 0.1), (0.01, 0.13, 0.08)),),
            ),
        ),
    ),
    wrist=Capsule((0, 0, -0.1345), (0, 0, -0.0525), _LINKS[5].capsules[1].radius),  # right_l5's round end
)
