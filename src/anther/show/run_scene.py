"""The layers of all that a run holds, and its arm."""

from __future__ import annotations

from typing import get_args

import numpy as np

from anther.core.choices import ArmName
from anther.core.errors import AntherError
from anther.robot.arm.arms import find_arm, simulated_arm
from anther.robot.arm.model import ArmModel
from anther.robot.arm.saved import SavedArm
from anther.robot.cells import read_cell
from anther.show import scene, style
from anther.show.results import ARM, RunResults
from anther.show.scene import Layer


def layers_of(results: RunResults) -> list[Layer]:
    """Return the layers of all that a run holds; its arm stands as it grasped."""
    shake, grasp, tree = results.shaken, results.grasp, results.skeleton
    arm = None if grasp is None else arm_of(results)
    opening = grasp.opening if grasp is not None else 0.0
    if results.trial is not None and len(results.trial.gripper):
        opening = float(results.trial.gripper[0, 0])
    found = [] if results.cloud is None else scene.cloud(results.cloud)
    if results.capture is not None:
        found.append(scene.views(results.capture))
    if tree is not None:
        found += scene.organs(tree, results.stem)
    if results.flowers is not None:
        found.append(scene.flowers(results.flowers))
    if grasp is not None:
        found.append(scene.grasps("grasp", [grasp]))
        if others := [g for g in results.grasps if not np.allclose(g.T_world_flange, grasp.T_world_flange)]:
            found.append(scene.grasps("other grasps", others, style.ROBOT_COLOR))
    if arm is not None and grasp is not None:
        found.append(scene.gripper(arm.tool, grasp, opening))
        if grasp.joints is not None:
            found.append(scene.arm_at(arm, grasp.joints, shown=results.trial is not None))
    if shake is not None:
        found.append(scene.shaking(shake))
    if (results.folder / ARM).exists() and (boxes := SavedArm.load(results.folder / ARM).keep_out):
        found.append(scene.keep_out(boxes))
    return found


def arm_of(results: RunResults) -> ArmModel | None:
    """Return the run's arm: as it was kept, by its name, or from the run's cell file; None if that is gone."""
    try:
        if (results.folder / ARM).exists():
            return SavedArm.load(results.folder / ARM).arm
        if results.simulated:
            return simulated_arm(results.arm)
        return (
            find_arm(results.arm) if results.arm in get_args(ArmName) else read_cell(str(results.params["cell"])).model
        )
    except AntherError:
        return None
