"""What a gripper tells of its force must fit the way of its pads: one model for every gripper.

Pads that touch nothing press with nothing. From where they touch, the force rises as they close, by the stiffness of
what is between them, until the motor gives no more and the pads stay where they are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from anther.robot.devices import DeviceError, GripperState

IDLE = 1.0
"""What a gripper may read with nothing between its pads, either way [N]: its sensor's noise and friction. A guess."""
SOFTEST = 500.0
"""The least stiffness between the pads of what is held [N/m]. A guess; simulated stems have 6000."""
DO = "Check the gripper's force signal before it closes on a plant."


def check_readable(state: GripperState) -> GripperState:
    """Return the reading, of which both numbers must be told.

    Raises:
        DeviceError: one is missing, or no number.
    """
    if not (np.isfinite(state.opening) and np.isfinite(state.force)):
        raise DeviceError(
            f"the gripper reads {state.opening} m and {state.force} N; allowed: numbers. A missing signal is not 0: "
            "check its connection."
        )
    return state


def check_idle(state: GripperState) -> None:
    """Check a reading of open pads: with nothing between them they press with nothing, and nothing is held.

    Raises:
        DeviceError: they tell otherwise.
    """
    check_readable(state)
    if abs(state.force) > IDLE or state.is_gripping:
        holds = " and something held" if state.is_gripping else ""
        given = f"gripper force: got {state.force:.1f} N{holds} with the pads {1e3 * state.opening:.1f} mm open"
        raise DeviceError(f"{given}; allowed: {IDLE:g} N. {DO}")


def check_closing(closing: Sequence[GripperState], sent: float) -> None:
    """Check what was read after each step of a closing.

    Args:
        closing: the readings; the last step's is the last.
        sent: opening to which the pads were sent in the last step [m].

    Raises:
        DeviceError: a pull; a firm force and yet nothing held, twice; or pads that are said to press on something and
            were sent nearer by 1.5 mm, and either came nearer while the force did not change, or did not and yet
            press with nothing.
    """
    last = closing[-1]
    given = f"gripper force: got {last.force:.1f} N with the pads {1e3 * last.opening:.1f} mm apart"
    if last.force < -IDLE:
        raise DeviceError(f"{given}; allowed: >= 0, pads do not pull. {DO}")
    # half of what a Sawyer's gripper gives [N]
    if len(closing) > 1 and all(s.force > 5 and not s.is_gripping for s in closing[-2:]):
        raise DeviceError(f"{given}, and yet the gripper says that it holds nothing. {DO}")
    # m of the pads' way over which a force must change: three steps of a closing, which may fall short of it
    several = 1.5e-3 - 1e-5
    if last.is_gripping and last.force < IDLE and last.opening - sent >= several:
        raise DeviceError(f"{given}, held off by something {1e3 * (last.opening - sent):.1f} mm before the goal. {DO}")
    pressing = list[GripperState]()
    for state in reversed(closing):
        if not touches(state):
            return
        pressing.append(state)
        way = state.opening - last.opening
        if way >= several:
            break
    else:
        return
    # Least stiffness before the gripper says that it holds something [N/m]: one pad meets a stem off the middle,
    # which bends away. A guess; a simulated pepper has 60 to 200.
    bending = 20.0
    change, least = float(np.ptp([s.force for s in pressing])), way * (SOFTEST if last.is_gripping else bending)
    if change < least:
        raise DeviceError(
            f"{given}: it changed by {change:.1f} N while the pads came {1e3 * way:.1f} mm nearer; allowed: at least "
            f"{least:.1f} N. {DO}"
        )


def check_let_go(held: GripperState, freed: GripperState) -> None:
    """Check that the force fell as the pads let go a little.

    Raises:
        DeviceError: it did not.
    """
    way, fell = freed.opening - held.opening, held.force - freed.force
    if fell < SOFTEST * way:
        raise DeviceError(
            f"gripper force: got {freed.force:.1f} N after {held.force:.1f} N, although the pads let go by "
            f"{1e3 * way:.1f} mm; allowed: {SOFTEST * way:.1f} N less, or more. {DO}"
        )


def touches(state: GripperState) -> bool:
    """Return whether the gripper says that its pads touch something."""
    return state.is_gripping or abs(state.force) > IDLE
