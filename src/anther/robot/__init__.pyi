"""The public names of the room, and where they stand; `__init__.py` finds them when they are asked for."""

from .arm.arms import find_arm
from .arm.model import ArmModel
from .arm.planner import Planner
from .arm.urdf import from_urdf
from .arm.views import plan_views
from .calibration import CharucoBoard, HandEye, calibrate, estimate_intrinsics
from .cell import Cell
from .cells import read_cell
from .cells.hardware import connect_cell
from .devices import (
    LEAD,
    Arm,
    ArmRecord,
    ArmSample,
    Camera,
    Cart,
    CartLimits,
    CartState,
    DeviceError,
    Frame,
    Gripper,
    GripperState,
    JointTrajectory,
    Robot,
    SafetyLimits,
)
from .safety import GuardedArm, guard
from .swing import Swing

__all__ = [
    "LEAD",
    "Arm",
    "ArmModel",
    "ArmRecord",
    "ArmSample",
    "Camera",
    "Cart",
    "CartLimits",
    "CartState",
    "Cell",
    "CharucoBoard",
    "DeviceError",
    "Frame",
    "Gripper",
    "GripperState",
    "GuardedArm",
    "HandEye",
    "JointTrajectory",
    "Planner",
    "Robot",
    "SafetyLimits",
    "Swing",
    "calibrate",
    "connect_cell",
    "estimate_intrinsics",
    "find_arm",
    "from_urdf",
    "guard",
    "plan_views",
    "read_cell",
]
