"""Checks for whoever writes a driver of a cart, as `anther.robot.testing` has for arms. Never run them on metal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from anther.core.errors import AntherError
from anther.core.geometry import Array
from anther.robot.devices import Cart, DeviceError
from anther.robot.testing import _connect, _need, _raises, _require

__all__ = ["CART_CHECKS", "CartRig"]


@dataclass(frozen=True, slots=True, eq=False)
class CartRig:
    """A driver of a cart, and the stand-in for the machine.

    Attributes:
        connect: returns the connected driver of a cart that stands and can go either way by `way`.
        sleep: [s].
        way: (A,) of each axis [m].
        interrupt: sees to it that the next move is stopped on its way by KeyboardInterrupt.
        silence: the machine answers nothing any more.
        block: something stands in the way of the next move.
        tolerance: of a place [m].
    """

    connect: Callable[[], Cart]
    sleep: Callable[[float], Any]
    way: Array
    interrupt: Callable[[], Any] | None = None
    silence: Callable[[], Any] | None = None
    block: Callable[[], Any] | None = None
    tolerance: float = 2e-3


def check_travel(rig: CartRig) -> None:
    """A cart goes where it is sent, axis by axis, says so, and stands; connecting and stopping move nothing."""
    with _connect(rig.connect) as cart:
        start = cart.state().place.copy()
        cart.stop()
        np.testing.assert_allclose(cart.state().place, start, atol=rig.tolerance, err_msg="place after stop")
        for axis in range(len(rig.way)):
            to = start + rig.way * (np.arange(len(rig.way)) <= axis)
            state = cart.move(to)
            np.testing.assert_allclose(state.place, to, atol=rig.tolerance, err_msg="place after move")
            _require(not state.is_moving, "a cart that arrived is said to move")
        cart.move(start)


def check_cart_readings(rig: CartRig) -> None:
    """Readings have times that go forward, and finite places."""
    with _connect(rig.connect) as cart:
        states = []
        for _ in range(5):
            states.append(cart.state())
            rig.sleep(0.1)
        _require(bool(np.all(np.diff([s.time for s in states]) > 0)), "the times of readings do not increase")
        _require(all(np.isfinite(s.place).all() and len(s.place) == len(rig.way) for s in states), "place: no numbers")


def check_impossible_place(rig: CartRig) -> None:
    """A place that cannot be is refused, and the cart stays."""
    with _connect(rig.connect) as cart:
        start = cart.state().place
        for place in (np.full(len(rig.way), 1e4), np.full(len(rig.way), np.nan)):
            with _raises(AntherError, f"move to {place} m"):
                cart.move(place)
        np.testing.assert_allclose(cart.state().place, start, atol=rig.tolerance, err_msg="place after a refusal")


def check_interrupted_travel(rig: CartRig) -> None:
    """Ctrl-C stops the cart on its way, and it can go on."""
    interrupt = _need(rig.interrupt, "interrupt")
    with _connect(rig.connect) as cart:
        start = cart.state().place
        interrupt()
        with _raises(KeyboardInterrupt, "move, where it is interrupted"):
            cart.move(start + rig.way)
        rig.sleep(0.2)
        there = cart.state()
        _require(not there.is_moving, "the cart moves on after Ctrl-C")
        rig.sleep(0.2)
        np.testing.assert_allclose(cart.state().place, there.place, atol=rig.tolerance, err_msg="place after Ctrl-C")
        cart.move(start)


def check_blocked_cart(rig: CartRig) -> None:
    """A cart that does not get there is a DeviceError, and stands."""
    block = _need(rig.block, "block")
    with _connect(rig.connect) as cart:
        block()
        with _raises(DeviceError, "move, where something stands in the way"):
            cart.move(cart.state().place + rig.way)
        _require(not cart.state().is_moving, "the cart goes on although it does not get there")


def check_silent_cart(rig: CartRig) -> None:
    """A cart that answers no more is a DeviceError, asked or sent."""
    silence = _need(rig.silence, "silence")
    with _connect(rig.connect) as cart:
        start = cart.state().place
        silence()
        for what, ask in (("state", cart.state), ("move", lambda: cart.move(start + rig.way))):
            with _raises(DeviceError, f"{what}, where the machine answers no more"):
                ask()


CART_CHECKS = (
    check_travel,
    check_cart_readings,
    check_impossible_place,
    check_interrupted_travel,
    check_blocked_cart,
    check_silent_cart,
)
"""What every cart keeps."""
