"""The cart driver for ROS 2's cmd_vel and odometry: against a fake cart in a time of its own, and through rclpy."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fake_robot import LIMITS, FakeArm, FakeGripper
from fake_ros2_cart import BRAKE, TIMEOUT, FakeCartNode, FakeRails, RosCartNode
from test_cart import short_way
from test_cart_file import CELL, cell_file

from anther.cli.cell import check
from anther.core.errors import InputError
from anther.robot.arm.sawyer import SAWYER
from anther.robot.cart_testing import CART_CHECKS, CartRig
from anther.robot.cells import _parts, read_cell
from anther.robot.devices import Cart, CartLimits, DeviceError, Robot
from anther.robot.drivers import ros2
from anther.robot.drivers._rails import Odometry
from anther.robot.drivers.ros2_cart import LATE, VelocityCart
from anther.robot.safety import guard

ENDS = CartLimits(np.array([0.0]), np.array([60.0]), SAWYER.neutral)
SPEED, ACCELERATION = 0.3, 0.2
INSTALL = "no rclpy: pip install 'anther[ros2]', or source ROS 2"
needs_ros = pytest.mark.skipif(find_spec("rclpy") is None or find_spec("nav_msgs") is None, reason=INSTALL)

HELD_UP = pytest.mark.flaky(
    reruns=3, only_rerun=[r"a command came \d+ ms", r"\d+ ms old", r"no odometry for \d+ ms", "again"]
)
"""A driver stops when the machine holds it up, as it must: the test is made again then, and for nothing else."""


class Wire:
    """A fake cart, the node of its driver, and the driver once it is asked for."""

    def __init__(self, place: float = 2.0) -> None:
        self.node = FakeCartNode()
        self.rails = FakeRails(self.node.tell, place)
        self.node.deliver = self.rails.hear

    def connect(self, limits: CartLimits = ENDS, **options: Any) -> VelocityCart:
        times = {"clock": self.rails.clock, "sleep": self.rails.sleep}
        return VelocityCart(self.node, limits, **times | options)  # type: ignore[arg-type]

    @property
    def speeds(self) -> list[float]:
        return [v for _, v in self.rails.heard]


@pytest.fixture
def wire() -> Wire:
    return Wire()


def at(place: float) -> np.ndarray:
    return np.array([place])


@pytest.mark.parametrize("check", CART_CHECKS, ids=lambda check: check.__name__)
def test_it_passes_the_kit(check: Callable[[CartRig], None], wire: Wire) -> None:
    def silence() -> None:
        wire.rails.mute = True
        wire.rails.sleep(0.3)

    rig = CartRig(
        connect=wire.connect,
        sleep=wire.rails.sleep,
        way=np.array([0.5]),
        interrupt=lambda: setattr(wire.node, "interrupt", 30),
        silence=silence,
        block=lambda: setattr(wire.rails, "stuck", True),
    )
    check(rig)


@pytest.mark.parametrize("axis", ["x", "-x", "y"])
@pytest.mark.parametrize("stamped", [True, False])
@pytest.mark.parametrize(("begin", "to"), [(2.0, 2.5), (2.0, 1.2), (2.0, 2.01), (58.0, 60.0)])
def test_it_goes_where_it_is_sent_within_its_limits(axis: Any, stamped: bool, begin: float, to: float) -> None:
    wire = Wire(-begin if axis == "-x" else begin)
    cart: Cart = wire.connect(axis=axis, stamped=stamped)
    state = cart.move(at(to))
    times, speeds = np.array(wire.rails.heard).T
    assert state.place == pytest.approx(at(to), abs=0.003)
    assert not state.is_moving
    assert abs(wire.rails.place) == pytest.approx(to, abs=0.003)
    assert abs(wire.rails.v) < 1e-3
    assert np.abs(speeds).max() <= SPEED + 1e-9
    faster = np.diff(np.abs(np.r_[0.0, speeds]))
    assert faster.max() <= ACCELERATION * 0.05 + 1e-9
    assert -faster.min() <= 0.03 + 1e-9  # the last creeping step, to zero
    assert np.diff(times).max() <= 0.05 + 1e-6
    beyond = (np.array(wire.rails.log)[:, 1] * np.sign(wire.rails.place) - to) * np.sign(to - begin)
    assert beyond.max() < 0.003


@pytest.mark.parametrize(
    ("options", "world"),
    [
        ({"speed": 1.0, "acceleration": 0.5}, {"delay": 0.1, "lag": 0.1}),
        ({}, {"delay": 0.1, "lag": 0.1}),
        ({}, {"delay": 0.15, "lag": 0.15}),  # it coasts beyond its place, and comes back slower
        ({}, {"every": 0.1}),
        ({}, {"scale": 0.9}),
        ({"rate": 50.0}, {}),
        ({"speed": 0.05, "acceleration": 0.05}, {}),
    ],
)
def test_it_arrives_with_slow_drives_and_odometry_that_is_late(
    wire: Wire, options: dict[str, float], world: dict[str, float]
) -> None:
    for name, value in world.items():
        setattr(wire.rails, name, value)
    cart = wire.connect(**options)
    for to in (3.0, 2.99, 2.0):
        assert cart.move(at(to)).place == pytest.approx(at(to), abs=0.003)
        assert wire.rails.place == pytest.approx(to, abs=0.003)


def test_connecting_and_asking_sends_nothing(wire: Wire) -> None:
    cart = wire.connect(zero=0.5)
    assert cart.state().place == pytest.approx(at(1.5))
    assert any("at most 0.3 m/s" in line for line in cart.describe())
    assert wire.rails.heard == []


FAULTS: dict[str, tuple[dict[str, Any], str]] = {
    "silent": ({"mute": True}, r"no odometry for 2\d\d ms; allowed: 200 ms\. Is it on"),
    "stamps stand still": ({"old": True}, r"its odometry comes, but is 2\d\d ms old by its stamps; allowed: 200 ms"),
    "clock went back": ({"ahead": -1.0}, r"is \d+ ms old by its stamps"),
    "frozen": ({"frozen": True}, r"it went \+0\.\d+ m where \+0\.\d+ m were sent.*does not follow"),
    "blocked": ({"stuck": True}, r"does not follow: look what is in its way.*start anew"),
    "swapped": ({"sign": -1.0}, r"wrong (way|side).*sign of its drive or of its odometry|does not follow"),
    "too fast": ({"scale": 2.0}, r"where nobody sent it: end what else commands it"),
    "rolls": (
        {"drift": 0.4},
        r"where nobody sent it.*It moves at \+0\.4\d* m/s after 2\.5 s of zero.*Press its",
    ),
    "jump": ({"offset": 0.3}, r"its odometry jumped by 0\.3\d\d m.*allowed: 0\.04\d m"),
    "no number": ({"offset": np.nan}, r"its odometry reports nan m.*finite numbers"),
}


@pytest.mark.parametrize("when", [0.0, 3.0], ids=["begin", "way"])
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_on_the_way_stops_it_with_one_message(wire: Wire, fault: str, when: float) -> None:
    world, message = FAULTS[fault]
    cart = wire.connect()
    begin = wire.rails.now
    wire.rails.fail(when + 0.1, **world)
    with pytest.raises(DeviceError, match=message) as caught:
        cart.move(at(7.0))
    assert "\n" not in str(caught.value)
    last = max(t for t, v in wire.rails.heard if v)
    assert last - begin - when < 1.2, "noticed within about a second"
    gone = np.array([row[1:] for row in wire.rails.log if row[0] > begin + when + 0.1])
    assert wire.speeds[-5:] == [0.0] * 5
    if fault != "rolls":
        assert np.ptp(gone[:, 0]) < 0.6
        assert abs(wire.rails.v) < 1e-9
    if fault in ("silent", "stamps stand still", "clock went back"):
        assert "Press its stop" in str(caught.value)


def test_a_swapped_sign_is_noticed_within_centimetres(wire: Wire) -> None:
    cart, wire.rails.sign = wire.connect(), -1.0
    with pytest.raises(DeviceError, match="wrong"):
        cart.move(at(7.0))
    assert 2.0 - wire.rails.place < 0.05


@pytest.mark.parametrize("fault", ["blocked", "swapped", "frozen"])
def test_a_cart_that_went_otherwise_than_sent_is_not_sent_again(wire: Wire, fault: str) -> None:
    cart = wire.connect()
    for name, value in FAULTS[fault][0].items():
        setattr(wire.rails, name, value)
    with pytest.raises(DeviceError):
        cart.move(at(7.0))
    count = len(wire.rails.heard)
    with pytest.raises(DeviceError, match="then start anew"):
        cart.move(at(7.0))
    assert len(wire.rails.heard) == count


def test_a_cart_that_brakes_late_is_told(wire: Wire) -> None:
    wire.rails.delay, wire.rails.lag = 0.15, 0.15
    with pytest.raises(DeviceError, match=r"mm beyond its place; allowed: 16 mm\. It brakes later than it is told"):
        wire.connect(speed=1.0, acceleration=0.5).move(at(6.0))


def test_a_cart_that_does_not_arrive_is_told(wire: Wire) -> None:
    """Creeping is too slow for what stands still to be noticed at once."""
    cart = wire.connect(replace(ENDS, tolerance=0.001))
    wire.rails.scale = 0.0
    with pytest.raises(DeviceError, match=r"3\.0 mm from its place after 8 s; allowed: 8 s"):
        cart.move(at(2.003))


@pytest.mark.parametrize("before", [0.04, 0.01, 0.004])
def test_odometry_that_freezes_just_before_the_place_is_noticed(wire: Wire, before: float) -> None:
    cart = wire.connect()

    def freeze() -> None:
        wire.rails.frozen = wire.rails.place > 5.0 - before
        if not wire.rails.frozen:
            wire.rails.after(0.01, freeze)

    wire.rails.after(0.01, freeze)
    with pytest.raises(DeviceError, match=r"does not follow|mm from its place after \d+ s"):
        cart.move(at(5.0))
    assert wire.rails.place < 5.0 + 0.04


@pytest.mark.parametrize("late", [0.3, 2.0])
def test_a_process_that_was_paused_stops_it_and_says_so(wire: Wire, late: float) -> None:
    """The driver sleeps longer than it wanted, while the cart goes on."""
    held = wire.rails.now + 3.0

    def sleep(seconds: float) -> None:
        nonlocal held
        pause, held = (late, np.inf) if wire.rails.now > held else (0.0, held)
        wire.rails.sleep(seconds + pause)

    cart = wire.connect(sleep=sleep)
    with pytest.raises(DeviceError, match=rf"a command came {10 * late:.0f}\d+ ms after.*allowed: 150 ms"):
        cart.move(at(7.0))
    after = [v for t, v in wire.rails.heard if t > 103.0 + late]
    assert set(after[1:]) == {0.0}
    assert abs(wire.rails.v) < 1e-9
    assert not cart.state().is_moving
    assert cart.move(at(7.0)).place == pytest.approx(at(7.0), abs=0.003)


def test_ctrl_c_stops_it_soon(wire: Wire) -> None:
    cart, wire.node.interrupt = wire.connect(), 60
    with pytest.raises(KeyboardInterrupt):
        cart.move(at(7.0))
    moving = [t for t, v in wire.rails.heard if v]
    stood = max(t for t, _, v in wire.rails.log if abs(v) > 1e-3)
    assert stood - moving[-1] < SPEED / BRAKE + wire.rails.lag + 0.1


def test_a_cart_that_does_not_stop_is_told_even_after_ctrl_c(wire: Wire) -> None:
    cart, wire.node.interrupt = wire.connect(), 60
    wire.rails.fail(2.0, deaf=True)
    with pytest.raises(
        DeviceError, match=r"cart: interrupted\. It moves at \+0\.3\d* m/s after 2\.5 s of zero.*Press its stop"
    ):
        cart.move(at(20.0))
    with pytest.raises(DeviceError, match=r"cart: It moves at \+0\.3"):
        cart.stop()
    with pytest.raises(DeviceError, match="although nobody sent it"):
        cart.move(at(20.0))


def test_stop_says_where_nothing_tells_that_it_stands(wire: Wire) -> None:
    cart = wire.connect()
    cart.stop()
    assert set(wire.speeds) == {0.0}
    assert len(wire.speeds) >= 6
    wire.rails.mute = True
    with pytest.raises(DeviceError, match=r"not known to stand.*Press its stop"):
        cart.stop()


@pytest.mark.parametrize(
    ("strike", "message"),
    [
        (lambda wire: wire.rails.fail(0.0, drift=0.05), r"it moves \(\+0\.05\d* m/s\) although nobody sent it"),
        (lambda wire: setattr(wire.node, "listeners", 0), "nobody listens to /cmd_vel"),
        (lambda wire: setattr(wire.rails, "mute", True), "no odometry for"),
    ],
)
def test_where_it_may_not_move_nothing_is_sent(wire: Wire, strike: Callable[[Wire], None], message: str) -> None:
    cart = wire.connect()
    strike(wire)
    wire.rails.sleep(1.0)
    with pytest.raises(DeviceError, match=message):
        cart.move(at(3.0))
    assert wire.rails.heard == []


@pytest.mark.parametrize(
    ("strike", "message"),
    [
        (lambda wire: setattr(wire.rails, "mute", True), "reports no odometry on /odom in 5 s. Is it on"),
        (lambda wire: setattr(wire.rails, "old", True), "whose stamps stand still"),
        (lambda wire: setattr(wire.rails, "offset", np.nan), "reports no odometry.*nan m"),
        (lambda wire: setattr(wire.node, "listeners", 0), "nobody who listens to /cmd_vel"),
    ],
)
def test_a_cart_that_is_not_heard_is_not_connected_to(wire: Wire, strike: Callable[[Wire], None], message: str) -> None:
    strike(wire)
    with pytest.raises(DeviceError, match=message):
        wire.connect()


def test_a_cart_beyond_its_ends_is_not_sent() -> None:
    """As of one whose odometry begins anew where it is switched on."""
    wire = Wire(-0.2)
    with pytest.raises(DeviceError, match=r"it stands at -0\.200 m; allowed: 0 \.\. 60 m.*find its zero"):
        wire.connect().move(at(3.0))
    assert wire.rails.heard == []


@pytest.mark.parametrize("options", [{"speed": 3.0}, {"acceleration": 0.0}, {"rate": 5.0}, {"speed": np.nan}])
def test_limits_that_no_cart_has_are_refused(wire: Wire, options: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(options))):
        wire.connect(**options)


def test_a_lift_is_refused(wire: Wire) -> None:
    with pytest.raises(InputError, match=r"cart: got 2 axes; allowed: travel alone.*Remove lift"):
        wire.connect(CartLimits(np.zeros(2), np.ones(2), SAWYER.neutral))


def test_the_drive_stops_by_itself_when_the_driver_is_gone(wire: Wire) -> None:
    """As after kill -9: no zero is sent. The way is what docs/arm_drivers.md says."""
    cart = wire.connect()
    wire.rails.fail(3.0, lag=0.0)
    wire.rails.after(3.0, lambda: setattr(wire.node, "cut", True))
    with pytest.raises(DeviceError):
        cart.move(at(20.0))
    cut = wire.rails.heard[-1][0]
    way = wire.rails.place - next(place for t, place, _ in wire.rails.log if t > cut)
    assert abs(wire.rails.v) < 1e-9
    assert way < SPEED * TIMEOUT + SPEED**2 / (2 * BRAKE) + 0.02


class WallArm(FakeArm):
    """It takes its time."""

    def follow(self, trajectory: Any, watch: Any = None, more: Any = None) -> Any:
        def look(sample: Any) -> None:
            time.sleep(0.005)
            watch(sample)

        return super().follow(trajectory, look, more)


@pytest.fixture
def carried() -> Iterator[tuple[Robot, FakeRails, FakeArm]]:
    """An arm on this cart behind the guard, in the wall's time."""
    wire = Wire()
    end = wire.rails.run()
    try:
        cart = VelocityCart(wire.node, ENDS, speed=0.5, acceleration=0.5)  # type: ignore[arg-type]
        arm, bare = WallArm(), SimpleNamespace()
        robot = Robot(arm, FakeGripper(0.008), wrist_camera=bare, cart=cart)  # type: ignore[arg-type]
        yield guard(replace(robot, wrist_camera=None), LIMITS, ENDS), wire.rails, arm  # type: ignore[arg-type]
    finally:
        end()


@HELD_UP
def test_the_arm_is_refused_while_it_moves_and_moves_when_it_stands(
    carried: tuple[Robot, FakeRails, FakeArm],
) -> None:
    robot, rails, arm = carried
    assert robot.cart is not None
    cart, said = robot.cart, list[Any]()
    thread = threading.Thread(target=lambda: said.append(cart.move(at(2.2))))
    thread.start()
    while rails.v < 0.05:
        time.sleep(0.005)
    with pytest.raises(DeviceError, match="the arm may not move while the cart does"):
        robot.arm.follow(short_way())
    assert arm.done == 0
    thread.join()
    assert said[0].place == pytest.approx(at(2.2), abs=0.003)
    robot.arm.follow(short_way())
    assert arm.done == 1
    rails.drift = 0.05
    time.sleep(0.6)
    with pytest.raises(DeviceError, match=r"moves although nobody sent it|moved by itself"):
        robot.arm.follow(short_way(arm.joints()))
    assert arm.done == 1


@HELD_UP
def test_a_stop_from_another_thread_ends_the_motion() -> None:
    wire, said = Wire(), list[str]()
    end = wire.rails.run()
    try:
        cart = VelocityCart(wire.node, ENDS, speed=0.5, acceleration=0.5)  # type: ignore[arg-type]

        def go() -> None:
            with pytest.raises(DeviceError, match="it was stopped on its way, as asked") as caught:
                cart.move(at(10.0))
            said.append(str(caught.value))

        thread = threading.Thread(target=go)
        thread.start()
        while wire.rails.v < 0.2:
            time.sleep(0.005)
        with pytest.raises(DeviceError, match="moved already"):
            cart.move(at(3.0))
        cart.stop()
        assert abs(wire.rails.v) < 1e-9
        thread.join()
        assert said
    finally:
        end()


ROS_CART = CELL.partition("[cart]")[0] + '[cart]\ndriver = "ros2"\ntravel = [0.0, 60.0]\ncorridor = 0.8\n'


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ('axis = "z"', r'line 23: cart.axis: got "z"; allowed: "x", "-x", "y", "-y"'),
        ("stamped = 1", r"line 23: cart.stamped: got 1; allowed: true or false"),
        ("sped = 0.2", r"cart.sped: got an unknown key 'sped'.*Did you mean speed"),
        ("cart_limits = 3", r"unknown key 'cart_limits'"),
    ],
)
def test_a_cell_files_wrong_words_are_told(tmp_path: Path, keys: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_cell(cell_file(tmp_path, f"{ROS_CART}{keys}\n"))


def test_a_cell_file_gives_it_its_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wire: Wire) -> None:
    monkeypatch.setattr(_parts, "Ros2Node", lambda name: wire.node)
    monkeypatch.setattr(_parts, "VelocityCart", lambda node, limits, **keys: wire.connect(limits, **keys))
    cell = read_cell(cell_file(tmp_path, ROS_CART + 'speed = 0.5\naxis = "x"\n'))
    assert cell.cart is not None
    cart = cell.connect(cell.cart)
    with pytest.raises(InputError, match=r"cart place: got 60\.1 m; allowed: 0 \.\. 60 m"):
        cart.move(at(60.1))
    cart.move(at(6.0))
    assert 0.45 < max(wire.speeds) <= 0.5
    lifts = read_cell(cell_file(tmp_path, ROS_CART + "lift = [0.0, 1.0]\n"))
    assert lifts.cart is not None
    with pytest.raises(InputError, match=r"line 19.*cart: got 2 axes.*Remove lift"):
        lifts.connect(lifts.cart)
    assert wire.node.closed


def test_the_manuals_example_is_read_and_has_every_key(tmp_path: Path) -> None:
    page = (
        (Path(__file__).parents[2] / "docs" / "arm_drivers.md").read_text().split("## A cart on rails under ROS 2")[1]
    )
    cell = read_cell(cell_file(tmp_path, CELL.partition("[cart]")[0] + page.split("```toml")[1].split("```")[0]))
    assert cell.cart is not None
    assert cell.cart.table == _parts.usual(_parts.ros2_cart)


def test_cell_check_shows_it_and_moves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], wire: Wire
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr(_parts, "Ros2Node", lambda name: wire.node)
    monkeypatch.setattr(_parts, "VelocityCart", lambda node, limits, **keys: wire.connect(limits, **keys))
    cell = read_cell(cell_file(tmp_path, ROS_CART.replace("sawyer.local", "127.0.0.1:1/")))
    cell = replace(
        cell, gripper=replace(cell.gripper, make=_missing), wrist_camera=replace(cell.wrist_camera, make=_missing)
    )
    check(replace(cell, arm=replace(cell.arm, make=_missing)))
    said = re.sub(r"[\s│]+", " ", capsys.readouterr().out)
    assert re.search(r"cart ros2 stands at 2.000 m between its ends 0 .. 60 m \d\d odometry messages a second", said)
    assert "commands: 20 a second to /cmd_vel as TwistStamped, at most 0.3 m/s" in said
    assert wire.rails.heard == []
    wire.rails.mute = True
    wire.rails.sleep(0.1)
    check(replace(cell, arm=replace(cell.arm, make=_missing)))
    assert "MISSING: the cart reports no odometry on /odom" in re.sub(r"[\s│]+", " ", capsys.readouterr().out)


def _missing(**keys: Any) -> Any:
    raise DeviceError("not here.")


@pytest.fixture
def real(monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeRails]:
    """A fake cart at the other end of ROS 2."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(os.getpid() % 100))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with closing(RosCartNode()) as node:
        rails = FakeRails(node.tell)
        node.deliver = rails.hear
        end = rails.run()
        yield rails
        end()


@needs_ros
@HELD_UP
def test_it_goes_where_it_is_sent_through_ros_2(real: FakeRails) -> None:
    with closing(VelocityCart(ros2.Node("anther_cart"), ENDS, speed=0.5, acceleration=0.5)) as cart:
        assert cart.move(at(2.3)).place == pytest.approx(at(2.3), abs=0.003)
        assert real.place == pytest.approx(2.3, abs=0.003)
        real.fail(1.0, mute=True)
        with pytest.raises(DeviceError, match=r"no odometry for 2\d\d ms"):
            cart.move(at(5.0))
    assert real.heard[-1][1] == 0.0
    assert abs(real.v) < 1e-9


MOVES = """
import sys; sys.path[:0] = {paths!r}
from test_ros2_cart import ENDS, VelocityCart, at, ros2
cart = VelocityCart(ros2.Node("anther_cart"), ENDS)
print("ready", flush=True)
cart.move(at(20.0))
"""


@needs_ros
@HELD_UP
@pytest.mark.parametrize("how", [signal.SIGSTOP, signal.SIGKILL, signal.SIGINT])
def test_a_process_that_is_paused_killed_or_interrupted_leaves_a_cart_that_stands(real: FakeRails, how: int) -> None:
    here = Path(__file__).parents[1]
    program = MOVES.format(paths=[str(here / "support"), str(here / "robot")])
    with subprocess.Popen([sys.executable, "-c", program], stdout=-1, stderr=-1, text=True) as driver:
        assert driver.stdout is not None
        assert driver.stderr is not None
        assert driver.stdout.readline() == "ready\n"
        while real.v < 0.25:
            time.sleep(0.01)
        driver.send_signal(how)
        if how == signal.SIGSTOP:
            time.sleep(1.0)
            assert abs(real.v) < 1e-9, "by its own time-out"
            driver.send_signal(signal.SIGCONT)
        said = driver.stderr.read()
    assert {signal.SIGSTOP: "a command came", signal.SIGINT: "KeyboardInterrupt"}.get(how, "") in said
    time.sleep(1.5)
    assert abs(real.v) < 1e-9
    assert LATE < TIMEOUT


@pytest.mark.parametrize(("rocking", "stands"), [(0.0002, True), (0.002, False)])
def test_a_cart_that_is_rocked_a_little_by_its_arm_stands(rocking: float, stands: bool) -> None:
    """At 10 Hz 0.2 mm are 13 mm/s, and go nowhere."""
    odometry, stamp, name = Odometry("x", 0.0, 0.5, lambda: 100.0 + stamp), 0.0, SimpleNamespace
    for stamp in np.arange(0.0, 1.0, 0.02).tolist():
        phase = 2 * np.pi * 10 * stamp
        place, speed = 2.0 + rocking * np.sin(phase), rocking * 2 * np.pi * 10 * np.cos(phase)
        pose, twist = name(pose=name(position=name(x=place))), name(twist=name(linear=name(x=speed)))
        header = name(stamp=name(sec=0, nanosec=round(1e9 * stamp)))
        odometry.receive(name(header=header, pose=pose, twist=twist))
    assert odometry.stands(0.003) == stands
