"""A cart and what it carries: never do both move. Whoever moves has the interlock, and watches that the cart stands.

Before a motion of the arm, and at every reading on its way, the cart must answer with a new reading, say that it
stands, and stand where it was. Otherwise nothing is commanded, or what moves is stopped.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np

from anther.core.checks import check_array
from anther.core.errors import InputError, StageFailure
from anther.core.geometry import Array
from anther.robot.devices import (
    Arm,
    ArmRecord,
    ArmSample,
    Cart,
    CartLimits,
    CartState,
    DeviceError,
    Gripper,
    JointTrajectory,
    More,
    MoreSwing,
    Motor,
    Watch,
)
from anther.robot.swing import Swing


class GuardedCart:
    """A cart that moves only while the arm on it is stowed and still. It is itself a `Cart`.

    Once it moved by itself, or its readings were old, it and the arm are not moved again through this guard.

    Args:
        cart: the machine.
        limits: what no command and no reading may exceed.
        arm, gripper: what it carries; without a gripper, that tells whether it holds something, the cart stays.
    """

    def __init__(self, cart: Cart, limits: CartLimits, arm: Arm, gripper: Gripper | None = None) -> None:
        self._cart, self._limits, self._arm, self._gripper = cart, limits, arm, gripper
        self._lock, self._mover = threading.Lock(), ""
        self._stands: Array | None = None
        self._last, self._heard = -np.inf, 0.0  # time of the newest reading, and on the arm's clock when it came [s]
        self._lost = ""

    def state(self) -> CartState:
        """Return the newest reading.

        Raises:
            DeviceError: there is none, it is not finite, or has not as many axes as the limits.
        """
        try:
            state = self._cart.state()
            check_array("cart place", state.place, self._limits.lower.shape)
        except InputError as error:
            raise DeviceError(f"{error} The cart does not tell where it is.") from error
        if not np.isfinite(state.time):
            raise DeviceError(f"cart: got a reading at {state.time} s; allowed: a finite time. Check its clock.")
        return state

    def move(self, place: Array) -> CartState:
        """Go to a place (A,) [m] and stand there; return the state then.

        Raises:
            StageFailure: limits_exceeded: beyond the rails' or the lift's ends, the arm is not stowed, or the gripper
                holds something. Nothing was commanded.
            DeviceError: the cart refused, stopped, does not stand where it was sent, or does not tell where it is. It
                was stopped.
        """
        limits = self._limits
        try:
            to = np.array(check_array("cart place", place, limits.lower.shape))
        except InputError as error:
            raise StageFailure("limits_exceeded", str(error)) from error
        if np.any((to < limits.lower) | (to > limits.upper)):
            allowed = f"{limits.lower} .. {limits.upper} m"
            raise StageFailure("limits_exceeded", f"cart: got {to} m; allowed: {allowed}. Stay between its ends.")
        with self.moving("the cart"):
            self.check_still()
            self._check_stowed()
            self._stands = None
            try:
                self._cart.move(to)
                state = self._newer()
                off = float(np.abs(state.place - to).max())
                if state.is_moving or not off <= limits.tolerance:
                    where = "still moves" if state.is_moving else f"stands {1e3 * off:.1f} mm from where it was sent"
                    raise DeviceError(
                        f"the cart {where}; allowed: <= {1e3 * limits.tolerance:g} mm, at rest. Look why."
                    )
            except BaseException:
                self.stop()
                raise
            self._stands = state.place
            return state

    def stop(self) -> None:
        """Stop the cart; what keeps it from stopping is not raised, so that what went wrong before is not hidden."""
        with suppress(Exception):
            self._cart.stop()

    @contextmanager
    def moving(self, name: str) -> Iterator[None]:
        """Have the interlock for the block; `name` is what moves.

        Raises:
            DeviceError: something else moves.
        """
        if not self._lock.acquire(blocking=False):
            raise DeviceError(f"{name} may not move while {self._mover} does. Wait until it stands.")
        self._mover = name
        try:
            yield
        finally:
            self._lock.release()

    def check_still(self) -> None:
        """Check that the cart tells where it is now, and stands where it last stood.

        Raises:
            DeviceError: it does not.
        """
        if self._lost:
            raise DeviceError(self._lost)
        self._check_stands(self._newer())

    def watch(self, sample: ArmSample) -> None:
        """Check, while the arm moves, that the cart stands: at every reading of the arm, without waiting.

        Raises:
            DeviceError: it does not, or tells nothing new for too long.
        """
        state = self.state()
        if state.time > self._last:
            self._last, self._heard = state.time, sample.time
        elif sample.time - self._heard > self._limits.stale_after:
            self._distrust(self._old(state))
        self._check_stands(state)

    def begin(self, now: float) -> None:
        """Begin to watch at a time on the arm's clock [s]."""
        self._heard = now

    def _newer(self) -> CartState:
        """Return a reading that is newer than the last one; wait for it for `stale_after`, twice over."""
        first = self.state()
        until = time.monotonic() + 2 * self._limits.stale_after
        while (state := self.state()).time <= max(first.time, self._last):
            if time.monotonic() > until:
                self._distrust(self._old(state))
            time.sleep(0.002)
        self._last = state.time
        return state

    def _old(self, state: CartState) -> str:
        return f"cart: got the reading of {state.time:.3f} s again; allowed: a new one every "

    def _distrust(self, why: str) -> None:
        self._lost = why if why.endswith(".") else f"{why}{self._limits.stale_after:g} s. Check it, then start anew."
        raise DeviceError(self._lost)

    def _check_stands(self, state: CartState) -> None:
        if state.is_moving:
            self._distrust("the cart moves although nobody sent it. Stop it by hand, then start anew.")
        if self._stands is None:
            self._stands = state.place
        off = float(np.abs(state.place - self._stands).max())
        if off > self._limits.tolerance:
            allowed = f"allowed: <= {1e3 * self._limits.tolerance:g} mm"
            self._distrust(f"the cart moved by itself by {1e3 * off:.1f} mm; {allowed}. Brake it, then start anew.")

    def _check_stowed(self) -> None:
        off = float(np.abs(self._arm.joints() - self._limits.stowed).max())
        if not off <= self._limits.stowed_tolerance:
            allowed = f"allowed: <= {self._limits.stowed_tolerance:g}"
            raise StageFailure("limits_exceeded", f"the arm is {off:.3g} rad from stowed; {allowed}. Stow it first.")
        if self._gripper is None:
            raise StageFailure("limits_exceeded", "no gripper tells that it holds nothing: the cart stays. Connect it.")
        if self._gripper.state().is_gripping:
            raise StageFailure("limits_exceeded", "the gripper holds something. Open it before the cart moves.")


class CarriedArm:
    """An arm on a cart: it moves only while the cart stands. It is itself an `Arm`."""

    def __init__(self, arm: Arm, cart: GuardedCart) -> None:
        self._arm, self._cart = arm, cart

    def joints(self) -> Array:
        """Return the measured joint angles (J,) [rad]."""
        return self._arm.joints()

    def follow(self, trajectory: JointTrajectory, watch: Watch | None = None, more: More | None = None) -> ArmRecord:
        """Follow a trajectory while the cart stands; see `GuardedArm.follow`.

        Raises:
            DeviceError: the cart moves, or does not tell that it stands; nothing was commanded, or the arm was stopped.
        """
        with self._cart.moving("the arm"):
            self._cart.check_still()
            return self._arm.follow(trajectory, carried_watch(self._cart, watch), more)

    def hold(self) -> None:
        """Stop and hold the present position."""
        self._arm.hold()


class CarriedMotor:
    """A motor in the gripper of an arm on a cart: it moves only while the cart stands. It is itself a `Motor`."""

    def __init__(self, motor: Motor, cart: GuardedCart) -> None:
        self._motor, self._cart = motor, cart

    def swing(self, first: Swing, watch: Watch | None = None, more: MoreSwing | None = None) -> ArmRecord:
        """Swing while the cart stands; see `GuardedMotor.swing`."""
        with self._cart.moving("the motor"):
            self._cart.check_still()
            return self._motor.swing(first, carried_watch(self._cart, watch), more)

    def stop(self) -> None:
        """Stop the motor."""
        self._motor.stop()

    def amplitude(self) -> float:
        """Return what the motor's own sensor reads [m]."""
        return self._motor.amplitude()


def carried_watch(cart: GuardedCart, watch: Watch | None) -> Watch:
    """Return a watcher that looks at the cart first."""
    begun: list[bool] = []

    def look(sample: ArmSample) -> None:
        if not begun:
            begun.append(True)
            cart.begin(sample.time)
        cart.watch(sample)
        if watch:
            watch(sample)

    return look
