"""Where an arm can take the camera next: the first of some flange poses that a straight joint line leads to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from anther.core.errors import StageFailure
from anther.core.geometry import Array, Box, transform_points
from anther.robot.arm import _kinematics
from anther.robot.arm.model import ArmModel
from anther.robot.arm.planner import Params, Planner
from anther.robot.devices import JointTrajectory, SafetyLimits
from anther.robot.safety import check_trajectory


def board_planner(
    T_base_board: Array, centre: Array, boxes: Sequence[Box], space: Box, motion: Params, arm: ArmModel
) -> Planner:
    """Return a planner for whom the board is solid.

    Args:
        T_base_board: (4, 4).
        centre: (3,) of the board [m]; it reaches as far on its other side.
        boxes: solid boxes, such as the bench.
        space: where the flange may be.
        motion: how the arm moves.
        arm: its description.
    """
    margin, depth = 0.03, 0.02  # [m], about the board: its plate, and what is not yet known of the camera's place
    grain = 0.006  # between the points [m]: less than a cube of the octree that they go into (`collision.VOXEL`)
    sides = [np.arange(-margin, 2 * c + margin, grain) for c in centre[:2]]
    grid = np.stack(np.meshgrid(*sides, np.arange(-depth, depth, grain), indexing="ij"), axis=-1)
    plate = transform_points(T_base_board, grid.reshape(-1, 3))
    return Planner(np.zeros((0, 3)), plate, boxes, space=space, params=motion, arm=arm)


def find_first_reachable(
    planner: Planner, limits: SafetyLimits, here: Array, T_base_flange: Array
) -> tuple[int, JointTrajectory] | None:
    """Return the number of the first of (C, 4, 4) poses that the arm can go to, and the motion; None if there is none.

    Only straight lines of the joints count, from joints `here` (J,): whoever stands beside the arm can foresee them.
    They touch nothing the planner knows, and pass all that the guard will ask of them.
    """
    batch = 24  # poses whose joints are sought together
    for begin in range(0, len(T_base_flange), batch):
        poses = T_base_flange[begin : begin + batch]
        solved = _kinematics.inverse_many(planner.arm, poses, near=here, seeds=8)
        for number, branches in enumerate(solved):
            for there in branches[:2]:  # the nearest
                motion = straight_way(planner, limits, here, there)
                if motion is not None:
                    return begin + number, motion
    return None


def straight_way(planner: Planner, limits: SafetyLimits, here: Array, there: Array) -> JointTrajectory | None:
    """Return the motion along the straight line between joints (J,), if it is free and within the limits."""
    line = np.linspace(here, there, 20)
    inside = planner.space is None or planner.space.contains(planner.arm.forward(line)[:, :3, 3]).all()
    folds = np.abs(there - here).max() > 2.2  # [rad]: nobody expects an arm to fold over between two views
    if not inside or folds or not planner.world.path_free(line[[0, -1]]):
        return None
    try:
        motion = planner.move(here, there)
        check_trajectory(motion, here, limits)
    except StageFailure:
        return None
    return motion
