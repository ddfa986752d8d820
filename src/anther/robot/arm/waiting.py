"""Where an arm waits before a stem while others look at it: drawn back from the leaves, and soon at most grasps."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from anther.core.checks import check_array
from anther.core.errors import StageFailure
from anther.core.geometry import Array, Box, look_at, transform
from anther.robot.arm import _kinematics
from anther.robot.arm._collision import CollisionWorld
from anther.robot.arm._tours import least_times
from anther.robot.arm.model import ArmModel

_NOTHING = np.zeros((0, 3))


def waiting_joints(
    arm: ArmModel, stem: ArrayLike, toward: ArrayLike, boxes: Sequence[Box] = (), *, before: float, back: float
) -> Array:
    """Return joints (J,) [rad] with the tool drawn back from a stem, from which grasps of it are soonest begun.

    Soonest on the average over places and over 40 degrees to either side, each joint at its limits and nothing in the
    way but that both ends are free. The gripper points at the stem.

    Args:
        arm: its description.
        stem: (P, 3) places of an upright stem that may be grasped, in the arm's frame [m].
        toward: (3,) unit, level, from the path towards the row of stems.
        boxes: solid boxes, of which the arm keeps clear.
        before: from the tool's tip to the stem where the straight way to a grasp begins [m].
        back: how much farther the tip is drawn back where the arm waits [m].

    Raises:
        StageFailure: "unreachable" when no such joints are free, or no grasp can be begun.
    """
    places, ahead = check_array("places of the stem", stem, (None, 3)), check_array("way to the row", toward, (3,))
    world = CollisionWorld(arm, _NOTHING, _NOTHING, boxes)

    def free(drawn: float) -> list[Array]:
        poses = _poses(places, ahead, arm.tool.tip + before)
        poses[:, :3, 3] -= drawn * ahead
        solved = _kinematics.inverse_many(arm, poses, seeds=12)
        return [q[np.array([world.free(row) for row in q], dtype=bool)] for q in solved]

    starts, homes = ([q for q in free(drawn) if len(q)] for drawn in (0.0, back))
    if not starts or not homes:
        raise StageFailure("unreachable", "the arm cannot wait before this stem. Move its base, or widen its space.")
    waits = np.concatenate(homes)
    seconds = np.mean([least_times(arm, waits, q).min(axis=1) for q in starts], axis=0)
    return np.asarray(waits[np.argmin(seconds)])


def _poses(places: Array, ahead: Array, distance: float) -> Array:
    """Return flange poses (N, 4, 4) that far from each place [m], level, from several sides, both ways up."""
    turns = np.deg2rad([-40, -20, 0, 20, 40])
    quarter = [transform([[0, -s, 0], [s, 0, 0], [0, 0, 1]], np.zeros(3)) for s in (1.0, -1.0)]  # +x up or down
    poses = []
    for place, turn, roll in product(places, turns, quarter):
        eye = place - distance * (np.cos(turn) * ahead + np.sin(turn) * np.array([-ahead[1], ahead[0], 0.0]))
        poses.append(look_at(eye, place) @ roll)
    return np.array(poses)
