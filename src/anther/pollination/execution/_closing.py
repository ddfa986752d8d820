"""How the pads close on a stem, and whether they still hold it."""

from __future__ import annotations

from anther.core.errors import StageFailure
from anther.pollination.grasp import Grasp
from anther.robot.devices import Gripper, GripperState
from anther.robot.safety import IDLE, check_let_go

STEP = 0.0005
"""Closing goes on in such steps [m] until it presses as the plan asks."""
THINNEST = 0.002
"""The pads are not sent nearer to each other [m]."""


def close(gripper: Gripper, grasp: Grasp, press: float) -> GripperState:
    """Close to the measured diameter and on in steps until the pads press with a force [N]; verify the grip.

    Depth sensors see thin stems too thick (facts: perception), but none by more than 4.5 mm, or by half where that is
    more: what they have not met by then is nothing. A stem that was measured too thin is pressed hard at once: the pads
    let go a little and close again from where they met it.

    Raises:
        StageFailure: nothing_grasped; branch_or_leaf_grasped when it is much too thick; limits_exceeded when the pads
            cannot press so hard.
        DeviceError: the force does not fit the way of the pads.
    """
    loose = 0.0005  # m around the stem: where a force cannot be set (facts: sawyer 3), position is the gentleness
    # m: two pixels at either edge, 1.1 mm each on a D455 at 0.7 m; the most in 130 simulated visits was 4.6 mm of 12.3
    too_thick = max(0.0045, grasp.stem_diameter / 2)
    expected, thinnest = max(grasp.stem_diameter + loose, THINNEST), max(grasp.stem_diameter - too_thick, THINNEST)
    state = _press(gripper, expected, press, thinnest)
    thickest = 0.012  # m: what is wider than the measured diameter by this is not the stem
    if expected + STEP < state.opening < expected + thickest:
        state = _press(gripper, state.opening + STEP, press, thinnest)
    if state.is_gripping and THINNEST - STEP < state.opening <= grasp.stem_diameter + thickest:
        if _is_enough(state.force, press):
            return state
        given = f"the pads press with {state.force:.1f} N; the plan asks for {press:.1f} N"
        raise StageFailure("limits_exceeded", f"{given}, or the stem slips. Try the next grasp, or a gentler shake.")
    thick = state.is_gripping and state.opening > expected
    kind, what = ("branch_or_leaf_grasped", "something thick") if thick else ("nothing_grasped", "nothing")
    found = f"the pads stand {1e3 * state.opening:.1f} mm apart with {state.force:.1f} N, not {1e3 * expected:.1f} mm"
    raise StageFailure(kind, f"the gripper holds {what}: {found}. Try the next grasp.")


def lost_grip(before: GripperState, after: GripperState) -> str:
    """Return how the gripper felt that it lost what it held before; empty if it still holds it."""
    if not (after.is_gripping and after.force > IDLE):
        return "the pads hold nothing any more"
    nearer = before.opening - after.opening
    slid = 0.00075  # m: two counts of a Robotiq (0.38 mm each)
    return f"the pads came {1e3 * nearer:.1f} mm nearer: what they held slipped out" if nearer > slid else ""


def _is_enough(force: float, press: float) -> bool:
    """Return whether the pads press as asked [N]: a gripper at its holding force reads a little less."""
    return force >= 0.95 * press


def _press(gripper: Gripper, width: float, press: float, thinnest: float) -> GripperState:
    """Close to a width [m], and on in steps until the pads press, if they meet anything thicker than `thinnest` [m].

    Pads that press hard but stand where they were sent, held off by nothing, or pressed as hard a step before, have the
    gripper's word for it alone: they let go by a step, and the force must fall.
    """

    def enough(state: GripperState) -> bool:
        return state.is_gripping and _is_enough(state.force, press)

    before, state = 0.0, gripper.move(width)
    while not enough(state) and width - STEP > THINNEST - 1e-9 and (state.opening > thinnest or state.is_gripping):
        width -= STEP
        before, state = state.force, gripper.move(width)
    held_off = 0.00015  # m short of where the pads were sent: less than half a count of a Robotiq
    if enough(state) and (state.opening < width + held_off or _is_enough(before, press)):
        check_let_go(state, gripper.move(width + STEP))
        state = gripper.move(width)
    return state
