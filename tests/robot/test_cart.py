"""An arm on a cart: never do both move; what a cart does wrong is one message, and nothing moved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fake_cart import FakeCart
from fake_robot import LIMITS, FakeArm, FakeGripper

from anther.core.errors import InputError, StageFailure
from anther.core.geometry import Array
from anther.robot.arm.sawyer import SAWYER
from anther.robot.cart_testing import CART_CHECKS, CartRig
from anther.robot.cells.hardware import guarded_arm
from anther.robot.devices import CartLimits, DeviceError, JointTrajectory, Robot
from anther.robot.safety import GuardedArm, GuardedCart, guard

STOWED = SAWYER.neutral
CART = CartLimits(np.array([0.0, 0.0]), np.array([100.0, 2.0]), STOWED, stale_after=0.05)
FURTHER = np.array([11.0, 1.5])


def carried() -> tuple[Robot, FakeCart, FakeArm, FakeGripper]:
    cart, arm, gripper = FakeCart(), FakeArm(), FakeGripper(0.008)
    bare: Any = SimpleNamespace()
    robot = Robot(arm, gripper, wrist_camera=bare, cart=cart)
    robot = replace(guard(replace(robot, wrist_camera=None), LIMITS, CART))  # type: ignore[arg-type]
    return robot, cart, arm, gripper


def short_way(start: Array = STOWED) -> JointTrajectory:
    times = np.linspace(0, 1, 101)
    shape = times**3 * (10 - 15 * times + 6 * times**2)
    rate = 30 * times**2 * (1 - times) ** 2
    way = np.full(len(start), 0.02)
    return JointTrajectory(times, start + shape[:, None] * way, rate[:, None] * way)


@pytest.mark.parametrize("check", CART_CHECKS, ids=lambda check: check.__name__)
def test_the_fake_passes_the_kit(check: Callable[[CartRig], None]) -> None:
    cart = FakeCart()
    fail = partial(setattr, cart, "fault")
    rig = CartRig(
        connect=lambda: cart,
        sleep=lambda _: None,
        way=np.array([0.5, 0.2]),
        interrupt=lambda: fail("interrupt"),
        silence=lambda: fail("silent"),
        block=lambda: fail("blocked"),
    )
    check(rig)


class Sloppy(FakeCart):
    """Says that it moves when it stands, and takes any place."""

    def move(self, place: Array) -> Any:
        self.place = np.nan_to_num(place)
        self.is_moving = True
        return self.state()


def test_the_kit_finds_a_cart_that_takes_any_place_and_does_not_come_to_rest() -> None:
    rig = CartRig(connect=Sloppy, sleep=lambda _: None, way=np.array([0.5, 0.2]))
    for check in CART_CHECKS[:3:2]:
        with pytest.raises(AssertionError):
            check(rig)


def test_cart_and_arm_move_by_turns() -> None:
    robot, cart, arm, _ = carried()
    assert robot.cart is not None
    assert robot.cart.move(FURTHER).place == pytest.approx(FURTHER)
    robot.arm.follow(short_way())
    assert arm.done == 1
    assert len(cart.moves) == 1


@pytest.mark.parametrize(
    ("strike", "message"),
    [
        (lambda cart: setattr(cart, "fault", "silent"), "does not answer"),
        (lambda cart: setattr(cart, "fault", "old"), "again; allowed: a new one every 0.05 s"),
        (lambda cart: setattr(cart, "is_moving", True), "moves although nobody sent it"),
        (lambda cart: cart.steps.extend([0.0, 0.01]), "moved by itself by 10.0 mm"),
        (lambda cart: setattr(cart, "place", np.array([np.nan, 1.0])), "does not tell where it is"),
        (lambda cart: setattr(cart, "place", np.array([1.0])), "does not tell where it is"),
    ],
)
@pytest.mark.parametrize("who", ["arm", "cart"])
def test_a_cart_that_fails_before_a_motion_is_one_message_and_nothing_moves(
    who: str, strike: Callable[[FakeCart], None], message: str
) -> None:
    robot, cart, arm, _ = carried()
    assert robot.cart is not None
    robot.arm.follow(short_way())
    robot.arm.follow(short_way(arm.joints()))  # 0.04 rad from stowed
    strike(cart)
    with pytest.raises(DeviceError, match=message) as caught:
        robot.arm.follow(short_way(arm.joints())) if who == "arm" else robot.cart.move(FURTHER)
    assert "\n" not in str(caught.value)
    assert arm.done == 2
    assert cart.moves == []


@pytest.mark.parametrize(
    ("strike", "message"),
    [
        (lambda cart: setattr(cart, "fault", "silent"), "does not answer"),
        (lambda cart: setattr(cart, "fault", "old"), "again"),
        (lambda cart: setattr(cart, "is_moving", True), "moves although nobody sent it"),
        (lambda cart: cart.steps.extend([0.001] * 5), "moved by itself by 4.0 mm"),
    ],
)
def test_a_cart_that_fails_while_the_arm_moves_stops_the_arm(strike: Callable[[FakeCart], None], message: str) -> None:
    robot, cart, arm, _ = carried()
    seen: list[float] = []

    def watch(sample: Any) -> None:
        seen.append(sample.time)
        if len(seen) == 50:
            strike(cart)

    with pytest.raises(DeviceError, match=message):
        robot.arm.follow(short_way(), watch)
    assert 50 <= len(seen) < 60, "within 0.1 s"
    assert arm.done == 0
    assert arm.held > 0


def test_after_a_cart_moved_by_itself_nothing_is_moved_again() -> None:
    robot, cart, arm, _ = carried()
    robot.arm.follow(short_way())
    cart.steps.extend([0.0, 0.01])
    for _ in range(2):
        with pytest.raises(DeviceError, match=r"moved by itself.*start anew"):
            robot.arm.follow(short_way(arm.joints()))
    assert robot.cart is not None
    with pytest.raises(DeviceError, match="moved by itself"):
        robot.cart.move(FURTHER)
    assert cart.moves == []


@pytest.mark.parametrize("fault", ["blocked", "short", "interrupt"])
def test_a_cart_that_does_not_arrive_is_stopped(fault: str) -> None:
    robot, cart, _, _ = carried()
    assert robot.cart is not None
    cart.fault = fault
    with pytest.raises(KeyboardInterrupt if fault == "interrupt" else DeviceError):
        robot.cart.move(FURTHER)
    assert cart.stops == 1


@pytest.mark.parametrize("place", [[-0.1, 1.0], [11.0, 2.1], [np.nan, 1.0], [11.0]])
def test_the_cart_is_not_sent_beyond_its_ends(place: list[float]) -> None:
    robot, cart, _, _ = carried()
    assert robot.cart is not None
    with pytest.raises(StageFailure, match=r"cart.*allowed"):
        robot.cart.move(np.array(place))
    assert cart.moves == []


def test_the_cart_stays_while_the_arm_is_out_or_holds_something() -> None:
    robot, cart, arm, gripper = carried()
    assert robot.cart is not None
    gripper.move(0.005)
    with pytest.raises(StageFailure, match="holds something"):
        robot.cart.move(FURTHER)
    gripper.move(gripper.stroke)
    arm.now = STOWED + 0.2
    with pytest.raises(StageFailure, match="Stow it first"):
        robot.cart.move(FURTHER)
    assert cart.moves == []


def test_whoever_moves_shuts_the_other_out() -> None:
    robot, cart, _, _ = carried()
    assert robot.cart is not None
    refused: list[str] = []

    def watch(_: Any) -> None:
        if not refused:
            with pytest.raises(DeviceError) as caught:
                robot.cart.move(FURTHER)  # type: ignore[union-attr]
            refused.append(str(caught.value))

    robot.arm.follow(short_way(), watch)
    assert refused == ["the cart may not move while the arm does. Wait until it stands."]
    assert cart.moves == []


def test_a_cart_without_limits_is_refused() -> None:
    robot = Robot(FakeArm(), FakeGripper(), None, cart=FakeCart())  # type: ignore[arg-type]
    with pytest.raises(InputError, match="CartLimits"):
        guard(robot, LIMITS)


def test_an_arm_that_is_connected_alone_asks_the_cart_of_its_cell_too() -> None:
    """As `anther cell jog` and `anther calibrate` do."""
    cart, arm, kept = FakeCart(), FakeArm(), list[Any]()
    file: Any = SimpleNamespace(
        cart="rails", connect=lambda part, arm: cart, safety_limits=lambda: LIMITS, cart_limits=lambda: CART
    )
    alone = guarded_arm(file, arm, lambda machine: kept.append(machine) or machine)
    alone.follow(short_way())
    assert kept == [cart]
    cart.is_moving = True
    with pytest.raises(DeviceError, match="moves although nobody sent it"):
        alone.follow(short_way(arm.joints()))
    assert arm.done == 1
    file.cart = None
    assert isinstance(guarded_arm(file, arm, kept.append), GuardedArm)


def test_a_cart_stays_where_no_gripper_tells_that_it_holds_nothing() -> None:
    with pytest.raises(StageFailure, match="no gripper"):
        GuardedCart(FakeCart(), CART, FakeArm()).move(FURTHER)
