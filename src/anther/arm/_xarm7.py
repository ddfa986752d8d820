"""The UFACTORY xArm7, with the tool that is planned with on every arm.

Source of joints, transforms, inertials and ranges: the MuJoCo model of the wheel robosuite 1.5.2, after UFACTORY's own
xarm_ros; no wheel has its URDF. Capsules are fitted to that model's meshes. Speed and acceleration: UFACTORY's
specification (180 degrees/s, 1145 degrees/s^2 at most), effort: xarm_ros; all three remembered.

Frames: base = world, z up, origin at the arm's mount. Flange = link7: the tool approaches along its +z.
"""

from __future__ import annotations

from math import pi

import numpy as np

from anther.arm.model import ArmModel, Capsule, Link
from anther.arm.sawyer import FLOOR_Z, TOOL
from anther.arm.urdf import ROTOR, SPRING, completed

WIDEST = pi
"""Joints that turn further than this either way are kept within it, so that none has two turns [rad]."""
LOWER = np.array([-WIDEST, -2.059, -WIDEST, -0.19198, -WIDEST, -1.69297, -WIDEST])  # rad
UPPER = np.array([WIDEST, 2.0944, WIDEST, 3.927, WIDEST, 3.14159, WIDEST])  # rad
EFFORT = np.array([50.0, 50.0, 30.0, 30.0, 30.0, 20.0, 20.0])  # N m
ACCELERATION = 10.0
"""Half of what the specification calls the most [rad/s^2]."""
READY = np.array([0.158, -0.267, 0.817, 0.61, -1.919, 1.022, -0.635])  # rad, flange at (0.25, 0.3) m, level

LINKS = (
    Link(
        "link1",
        (0, 0, 0.267),
        (0, 0, 0),
        2.382,
        (-0.0002, 0.02905, -0.01233),
        (0.0056905, 0.0049566, 0.00331666, -1.579e-05, 5.125e-06, -0.000873381),
        (Capsule((0, 0.018, -0.0764), (0, 0.018, 0.0076), 0.075),),
    ),
    Link(
        "link2",
        (0, 0, 0),
        (-pi / 2, 0, 0),
        1.869,
        (0.00022, -0.12856, 0.01735),
        (0.0095989, 0.00382472, 0.00756567, 1.54104e-06, 5.56003e-06, -0.00317156),
        (Capsule((0, -0.133, 0), (0, -0.133, 0.062), 0.073), Capsule((0, -0.0827, 0.087), (0, 0, 0.087), 0.05)),
    ),
    Link(
        "link3",
        (0, -0.293, 0),
        (pi / 2, 0, 0),
        1.6383,
        (0.0466, -0.02463, -0.00768),
        (0.00310955, 0.00264483, 0.0026624, 0.000308371, -0.000584528, 0.000338895),
        (
            Capsule((-0.0084, 0.0012, -0.0624), (0.0096, 0.0037, -0.0644), 0.059),
            Capsule((0.0457, 0.0274, 0), (0.0176, 0.029, -0.0105), 0.048),
            Capsule((0.0523, -0.0621, 0), (0.0523, 0.0127, 0), 0.043),
        ),
    ),
    Link(
        "link4",
        (0.0525, 0, 0),
        (pi / 2, 0, 0),
        1.7269,
        (0.07047, -0.11575, 0.012),
        (0.005889, 0.00359703, 0.00543245, 0.00137112, 0.00088143, -0.00176215),
        (
            Capsule((0.0557, -0.0582, 0.0828), (-0.0012, 0, 0.0759), 0.045),
            Capsule((0.084, -0.108, 0.0622), (0.0778, -0.112, 0), 0.071),
        ),
    ),
    Link(
        "link5",
        (0.0775, -0.3425, 0),
        (pi / 2, 0, 0),
        1.3203,
        (-0.00032, 0.01604, -0.026),
        (0.00534665, 0.0049779, 0.0013624, 1.51168e-05, -3.68981e-07, -0.00022132),
        (
            Capsule((0.0004, -0.0007, -0.151), (-0.0006, 0.0634, -0.119), 0.049),
            Capsule((-0.0025, 0.0502, -0.0574), (-0.0003, 0.0375, 0.0013), 0.051),
        ),
    ),
    Link(
        "link6",
        (0, 0, 0),
        (pi / 2, 0, 0),
        1.325,
        (0.06469, 0.03278, 0.02141),
        (0.0014745, 0.0019037, 0.0023652, -0.000487998, 0.000295301, 0.00014749),
        (Capsule((0.0769, 0.0176, -0.0007), (0.0044, 0.0141, 0.0315), 0.064),),
    ),
    Link(
        "link7",
        (0.076, 0.097, 0),
        (-pi / 2, 0, 0),
        0.17,
        (0, -0.00677, -0.01098),
        (9.3e-05, 5.87e-05, 0.000132, 0, 0, -3.60004e-06),
        (Capsule((0, -0.0125, -0.014), (0, 0.0006, -0.014), 0.04),),
    ),
)


def described() -> ArmModel:
    """Return the arm; shoulder, reach and neighbours follow from its links."""
    return completed(
        ArmModel(
            name="xarm7",
            joints=tuple(f"joint{i}" for i in range(1, 8)),
            lower=LOWER,
            upper=UPPER,
            velocity=np.full(7, pi),
            acceleration=np.full(7, ACCELERATION),
            effort=EFFORT,
            rotor_inertia=ROTOR * EFFORT,
            stiffness=SPRING * EFFORT,
            links=LINKS,
            T_last_flange=np.eye(4),
            tool=TOOL,
            neutral=READY,
            ready=READY,
            waiting=READY,
            neighbours=(),
            shoulder=np.zeros(3),
            reach=np.inf,
            floor=FLOOR_Z,
            base_capsules=(Capsule((-0.0126, 0.0005, 0.0717), (0.0005, 0.0005, 0.0717), 0.096),),
        )
    )
