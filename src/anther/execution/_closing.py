"""Closing the gripper on the stem."""

from __future__ import annotations

from anther.devices import Gripper, GripperState
from anther.errors import StageFailure
from anther.grasp import Grasp

LOOSE = 0.0005
"""Closing begins at the measured stem diameter and this [m]: where a gripper's force cannot be set (facts: sawyer 3),
its position is the gentleness."""
STEP = 0.0005
"""Closing goes on in such steps [m] until it presses as the plan asks."""
THINNEST = 0.002
"""The pads do not close farther [m]."""
THICKEST = 0.012
"""What is wider than the measured diameter by this [m] is not the stem."""
ENOUGH = 0.95
"""Share of the force asked for with which the pads press enough: a gripper at its holding force reads a little less."""

SLID = 0.00075
"""Pads that have come nearer by this [m] lost what they held, whatever the gripper says of it: in nineteen trials
through a Robotiq's protocol it was one of its counts (0.38 mm) or none, in the one that lost the stem 1.1 mm, twice."""
BESIDE = 0.002
"""The pads meet a petiole beside the stem where it is expected to reach so far beyond it (`Grasp.squeezed`) [m], or
nobody knows."""
SETTLE = 0.6
"""Leaves that the gripper touched calm down for so long before the shake [s]."""
CALM = 2.0
"""A petiole that the pads meet swings for so long [s]."""


def close(gripper: Gripper, grasp: Grasp, press: float) -> GripperState:
    """Close to the measured diameter and on in steps until the pads press with a force [N]; verify the grip.

    Depth sensors see thin stems too thick (facts: perception). One that was measured too thin is pressed hard at once:
    the pads let go a little and close again from where they met it.

    Raises:
        StageFailure: nothing_grasped; branch_or_leaf_grasped when it is much too thick; limits_exceeded when the pads
            cannot press so hard.
    """
    expected = max(grasp.stem_diameter + LOOSE, THINNEST)
    state = _press(gripper, expected, press)
    if expected + STEP < state.opening < expected + THICKEST:
        state = _press(gripper, state.opening + STEP, press)
    if state.is_gripping and state.opening <= grasp.stem_diameter + THICKEST:
        if state.force >= ENOUGH * press:
            return state
        given = f"the pads press with {state.force:.1f} N; the plan asks for {press:.1f} N"
        raise StageFailure("limits_exceeded", f"{given}, or the stem slips. Try the next grasp, or a gentler shake.")
    kind, what = ("branch_or_leaf_grasped", "something thick") if state.is_gripping else ("nothing_grasped", "nothing")
    found = f"the pads stand {1e3 * state.opening:.1f} mm apart with {state.force:.1f} N, not {1e3 * expected:.1f} mm"
    raise StageFailure(kind, f"the gripper holds {what}: {found}. Try the next grasp.")


def lost_grip(before: GripperState, after: GripperState) -> str:
    """Return how the gripper felt that it lost what it held before; empty if it still holds it."""
    if not after.is_gripping:
        return "the pads hold nothing any more"
    nearer = before.opening - after.opening
    return f"the pads came {1e3 * nearer:.1f} mm nearer: what they held slipped out" if nearer > SLID else ""


def wait_after(grasp: Grasp) -> float:
    """Return how long what the gripper touched swings after closing [s]: a petiole between the pads for longer."""
    free = grasp.squeezed is not None and grasp.squeezed < BESIDE
    return SETTLE if free else CALM


def _press(gripper: Gripper, width: float, press: float) -> GripperState:
    """Close to a width [m], and on in steps until the pads press."""
    state = gripper.move(width)
    while (not state.is_gripping or state.force < ENOUGH * press) and width - STEP > THINNEST - 1e-9:
        width -= STEP
        state = gripper.move(width)
    return state
