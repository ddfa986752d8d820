"""Do the flange's motions determine the hand-eye transform? What the user should change where they hardly do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from anther.errors import bad_input
from anther.geometry import Array

FEW_VIEWS = 10
SMALL_TURN = float(np.deg2rad(20))
"""Largest turn below which errors grow: they go with 1 / turn (Tsai and Lenz 1989, section VI) [rad]."""
SMALL_SECOND_TURN = float(np.deg2rad(15))


@dataclass(frozen=True, slots=True, eq=False)
class Motions:
    """How the flange turned between views.

    Attributes:
        turns: (V (V-1) / 2, 3) rotation vectors from each view to each other, in the flange frame [rad].
        largest: the largest angle [rad].
        second: the largest turn about an axis across the main one [rad], at most 1.
    """

    turns: Array
    largest: float
    second: float


def flange_motions(T_base_flange: Array) -> Motions:
    """Return how the flange turned between (V, 4, 4) poses."""
    later, earlier = np.tril_indices(len(T_base_flange), -1)
    R = T_base_flange[:, :3, :3]
    turns = Rotation.from_matrix(np.swapaxes(R[later], 1, 2) @ R[earlier]).as_rotvec()
    angles = np.linalg.norm(turns, axis=1)
    bounded = turns / np.maximum(1.0, angles)[:, None]
    axis = np.linalg.svd(bounded, full_matrices=False)[2][0]
    second = np.linalg.norm(bounded - np.outer(bounded @ axis, axis), axis=1)
    return Motions(turns, float(angles.max()), float(second.max()))


def check_motions(T_base_flange: Array, least_turn: float) -> None:
    """Refuse motions about one axis only: they leave the camera's position along that axis open (Tsai, Lenz 1989).

    Args:
        T_base_flange: (V, 4, 4).
        least_turn: the flange must turn about two different axes by at least this [rad].

    Raises:
        InputError: fewer than three views, or turns about one axis only.
    """
    count = len(T_base_flange)
    if count < 3:
        raise bad_input(
            "hand-eye calibration", given=f"{count} usable views", allowed="3 or more", do="Take 15 to 20 views."
        )
    second = flange_motions(T_base_flange).second
    if second < least_turn:
        raise bad_input(
            "hand-eye calibration",
            given=f"degenerate motions, that turn about one axis only ({np.rad2deg(second):.1f} deg about any other)",
            allowed=f"turns of {np.rad2deg(least_turn):.0f} deg or more about two axes",
            do="Tilt the camera about several axes, 20 to 40 deg between views.",
        )


def motion_warnings(T_base_flange: Array) -> tuple[str, ...]:
    """Return what is poor about the motions between (V, 4, 4) flange poses, one sentence each."""
    motions, notes = flange_motions(T_base_flange), []
    if len(T_base_flange) < FEW_VIEWS:
        notes.append(f"only {len(T_base_flange)} views: take 15 to 20, errors go with 1 / sqrt(views)")
    if motions.largest < SMALL_TURN:
        notes.append(
            f"too little rotation: at most {np.rad2deg(motions.largest):.0f} deg between views, errors go with "
            f"1 / rotation; tilt the camera by 20 to 40 deg"
        )
    elif motions.second < SMALL_SECOND_TURN:
        notes.append(
            f"rotation axes nearly parallel: at most {np.rad2deg(motions.second):.0f} deg about any axis across the "
            f"main one, along which the camera's place is poorly known; turn about two axes"
        )
    return tuple(notes)
