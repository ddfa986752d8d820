"""The driver of Universal Robots arms: a fake controller behind ur_rtde's three objects, and the real ones' methods."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from multiprocessing.managers import BaseManager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fake_ur import READY, FakeControl, FakeDashboard, FakeReceive, FakeUR
from slow_clock import AGAIN_IF_HELD_UP, SLOWER, clock, sleep
from small_planner import SmallPlanner

from anther.arm.arms import named
from anther.cells import parts, read_cell
from anther.devices import Arm, ArmSample, DeviceError, JointTrajectory
from anther.drivers.ur_controller import Controller
from anther.drivers.ur_rtde import SILENCE, WATCHDOG, UniversalRobot
from anther.errors import InputError, MissingExtra
from anther.safety import GuardedArm

HERE = Path(__file__).parent
MODEL = named("ur5e")
NO_UR_RTDE = "no ur_rtde; run: pip install 'ur-rtde>=1.6'"
STANDS = 1 / WATCHDOG + 0.6 / 5.0 + 0.05
"""An arm at 0.6 rad/s stands so long after the last command [s]: the watchdog, the fake's braking, and some slack."""
pytestmark = AGAIN_IF_HELD_UP


@pytest.fixture
def ur() -> Iterator[FakeUR]:
    with closing(FakeUR(clock=clock, sleep=sleep)) as fake:
        yield fake


@pytest.fixture
def arm(ur: FakeUR) -> Iterator[UniversalRobot]:
    with closing(connected(ur)) as driver:
        yield driver
        ur.dead = False


def connected(ur: FakeUR, **options: Any) -> UniversalRobot:
    given: dict[str, Any] = {"names": MODEL.joints, "acceleration": MODEL.acceleration, "model": "ur5e", **options}
    make = lambda: Controller(FakeReceive(ur), FakeDashboard(ur), ur.start, clock=clock)  # noqa: E731
    return UniversalRobot(make, clock=clock, sleep=sleep, **given)


def far(arm: Arm, way: float = 0.3) -> JointTrajectory:
    return SmallPlanner(MODEL).move(arm.joints(), arm.joints() + way)


def begun(arm: Arm, speed: float = 0.5, seconds: float = 0.5) -> JointTrajectory:
    """Return a motion that ends at a speed of all joints [rad/s]."""
    t = np.linspace(0, seconds, 60)[:, None]
    rate = speed * np.ones(6)
    return JointTrajectory(t[:, 0], arm.joints() + rate * t**2 / (2 * seconds), rate * t / seconds)


def stopped_after(ur: FakeUR, since: float) -> float:
    """Return how long after `since` [s] the arm moved last [s]."""
    sleep(0.3)
    times, speed = ur.speed()
    assert speed[-10:].max() < 1e-3
    return max(float(times[speed > 5e-3].max(initial=0.0)) - since, 0.0)


def halfway(path: JointTrajectory, do: Callable[[], Any]) -> None:
    threading.Timer(SLOWER * path.duration / 2, do).start()


def test_it_goes_where_it_is_told_and_says_so(arm: UniversalRobot, ur: FakeUR) -> None:
    conforms: Arm = arm
    start, seen = conforms.joints(), list[ArmSample]()
    assert start == pytest.approx(READY, abs=1e-9)
    record = arm.follow(far(arm, 0.05), seen.append)
    assert record.commanded[-1] == pytest.approx(start + 0.05, abs=1e-6)
    assert arm.joints() == pytest.approx(start + 0.05, abs=2e-3)
    assert np.all(np.diff(record.times) > 0)
    assert len(seen) == len(record.times) > 50 * (record.times[-1] - record.times[0])
    assert abs(record.times[-1] - clock()) < 1.0  # on this machine's clock, though the controller's is another
    assert max(np.abs(s.measured - s.commanded).max() for s in seen) < 0.02
    assert seen[-1].force == pytest.approx(1.0)
    assert arm.follow(far(arm, -0.05)).times[0] >= record.times[-1]


def test_every_motion_has_its_own_program_and_watchdog_and_none_is_left_armed(arm: UniversalRobot, ur: FakeUR) -> None:
    """UR's script manual: a watchdog ends with its program only."""
    assert ur.heard == []
    for n in (1, 2):
        waiting = ur.program
        assert waiting is not None
        assert waiting.watchdog == 0
        ur.calls.clear()
        arm.follow(far(arm, 0.02 * n))
        said = [
            name for name in ur.calls if name in ("setWatchdog", "kickWatchdog", "servoJ", "servoStop", "stopScript")
        ]
        assert said[0] == "setWatchdog"
        assert said[1:-2] == ["kickWatchdog", "servoJ"] * (len(said[1:-2]) // 2)
        assert said[-2:] == ["servoStop", "stopScript"]
        assert waiting.watchdog == WATCHDOG
        assert ur.program is not waiting
    sleep(3 / WATCHDOG)
    assert not ur.protective


def test_motions_join_without_a_stop_while_the_next_is_thought_about(arm: UniversalRobot, ur: FakeUR) -> None:
    begin = begun(arm, 0.3, 0.6)
    t = np.linspace(0, 0.6, 60)[:, None]
    middle = JointTrajectory(t[:, 0], begin.positions[-1] + 0.3 * t, np.full((60, 6), 0.3))
    end = JointTrajectory(t[:, 0], middle.positions[-1] + 0.3 * t - 0.25 * t**2, np.tile(0.3 - 0.5 * t, (1, 6)))
    left = iter([middle, end, None])

    def more() -> JointTrajectory | None:
        sleep(0.1)
        return next(left)

    record = arm.follow(begin, None, more)
    assert record.commanded[-1] == pytest.approx(end.positions[-1], abs=1e-6)
    times, speed = ur.speed()
    moving = times[speed > 0.01]
    inside = (times > moving[0] + 0.4) & (times < moving[-1] - 0.5)
    assert speed[inside].min() > 0.05
    assert np.diff([when for when, _ in ur.heard]).max() < SILENCE


def test_what_comes_too_late_ends_in_a_braked_hold(arm: UniversalRobot, ur: FakeUR) -> None:
    begin = begun(arm)
    with pytest.raises(DeviceError, match="next motion comes too late"):
        arm.follow(begin, None, lambda: sleep(0.6))
    assert stopped_after(ur, clock()) < 0.05
    assert not ur.protective
    assert np.abs(ur.q - begin.positions[-1]).max() < 0.1


def test_the_driver_brakes_within_the_arms_acceleration(arm: UniversalRobot, ur: FakeUR) -> None:
    begin = begun(arm, 0.6)
    with pytest.raises(DeviceError):
        arm.follow(begin, None, lambda: sleep(0.6))
    t, q = np.array([when for when, _ in ur.heard]), np.array([target for _, target in ur.heard])
    end = np.argmax(t > t[0] + begin.duration)
    way = np.abs(q[-1] - q[end]).max()
    assert way == pytest.approx(0.6**2 / (2 * 5.0), rel=0.5)  # of the 5 rad/s^2 that the model gives
    coarse = np.arange(t[end], t[-1], 0.03)
    rate = np.diff(np.interp(coarse, t, q[:, 0])) / 0.03
    assert (-np.diff(rate) / 0.03).max() < 1.5 * 5.0
    assert rate[-1] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("error", [DeviceError("enough"), KeyboardInterrupt()])
def test_it_stops_where_its_watcher_raises_and_goes_on_after(
    arm: UniversalRobot, ur: FakeUR, error: BaseException
) -> None:
    start = arm.joints()

    def watch(sample: ArmSample) -> None:
        if np.abs(sample.measured - start).max() > 0.1:
            raise error

    with pytest.raises(type(error)):
        arm.follow(far(arm), watch)
    there = arm.joints()
    assert np.abs(there - start).max() == pytest.approx(0.1, abs=0.08)
    arm.hold()
    sleep(0.1)
    assert arm.joints() == pytest.approx(there, abs=2e-3)
    arm.follow(far(arm, -0.05))


def test_joints_that_are_stale_are_not_moved(arm: UniversalRobot, ur: FakeUR) -> None:
    path, ur.mute = far(arm), True
    sleep(0.2)
    with pytest.raises(DeviceError, match="ms old; allowed: 50 ms"):
        arm.follow(path)
    assert ur.heard == []


@pytest.mark.parametrize("how", ["mute", "lag"])
def test_it_stops_when_its_joints_become_stale(arm: UniversalRobot, ur: FakeUR, how: str) -> None:
    since = list[float]()

    def break_it() -> None:
        since.append(clock())
        setattr(ur, how, True if how == "mute" else 0.2)

    path = far(arm, 0.4)
    halfway(path, break_it)
    with pytest.raises(DeviceError, match="ms old"):
        arm.follow(path)
    assert stopped_after(ur, since[0]) < 0.05 + 0.3  # to notice, and to brake from full speed


def test_a_clock_that_jumps_is_not_believed(arm: UniversalRobot, ur: FakeUR) -> None:
    ur.ahead -= 1.0
    sleep(0.2)
    with pytest.raises(DeviceError, match="old"):
        arm.joints()


def test_a_controller_that_says_nothing_is_not_connected_to(ur: FakeUR, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("anther.drivers.ur_controller.Controller.wait.__defaults__", (0.3,))
    ur.mute = True
    with pytest.raises(DeviceError, match="is not heard"):
        connected(ur)


def test_joints_of_another_count_or_no_numbers_are_refused(arm: UniversalRobot, ur: FakeUR) -> None:
    with pytest.raises(DeviceError, match="the robot has 6; allowed: 7"):
        connected(ur, names=[f"j{i}" for i in range(7)], model="sawyer")
    path, ur.offset = far(arm), np.full(6, np.nan)
    sleep(0.1)
    with pytest.raises(DeviceError, match="nan"):
        arm.follow(path)
    assert ur.heard == []


def test_a_motion_that_begins_elsewhere_is_refused(arm: UniversalRobot, ur: FakeUR) -> None:
    q = arm.joints()
    for start in (q + 0.1, np.append(q, 0.0)):
        with pytest.raises(DeviceError, match="rad from where the arm is"):
            arm.follow(JointTrajectory.standstill(start, 0.1))
    assert ur.heard == []


REASONS = [
    ({"pressed": True}, "emergency stop is pressed"),
    ({"protective": True}, "made a protective stop: .*anther cell enable"),
    ({"safeguard": True}, "safety system says safeguard stop"),
    ({"mode": 5}, r"motors are not on \(idle\): anther cell enable"),
    ({"slider": 0.5}, "speed slider stands at 50%"),
    ({"scaling": 0.4}, "goes at 40% of the speed"),
    ({"paused": True}, "paused on the pendant"),
    ({"program": None}, "program on it was stopped"),
    ({"connected": False}, "connection is lost"),
]


@pytest.mark.parametrize(("change", "message"), REASONS)
def test_the_robots_own_reasons_end_a_motion_and_refuse_the_next(
    arm: UniversalRobot, ur: FakeUR, change: dict[str, Any], message: str
) -> None:
    path, since = far(arm, 0.4), list[float]()

    def do() -> None:
        since.append(clock())
        vars(ur).update(change)

    halfway(path, do)
    with pytest.raises(DeviceError, match=message):
        arm.follow(path)
    assert stopped_after(ur, since[0]) < 0.4
    commands = len(ur.heard)
    if "paused" in change:
        assert ur.program is None  # stopped, so that it does not go on when somebody presses play
        message = "program on it was stopped"
    with pytest.raises(DeviceError, match=message):
        arm.follow(far(arm, 0.01))
    assert len(ur.heard) == commands


def test_it_does_not_move_in_local_control(arm: UniversalRobot, ur: FakeUR) -> None:
    path, ur.remote = far(arm), False
    with pytest.raises(DeviceError, match="not in remote control: switch it"):
        arm.follow(path)
    assert ur.heard == []
    assert any("not in remote control" in line for line in arm.seen())


@pytest.mark.parametrize("how", ["held up", "hangs"])
def test_commands_that_come_too_late_end_the_motion(arm: UniversalRobot, ur: FakeUR, how: str) -> None:
    seen = list[float]()

    def watch(sample: ArmSample) -> None:
        if np.abs(sample.measured - READY).max() > 0.1 and not seen:
            seen.append(clock())
            sleep(0.04 if how == "held up" else 0.2)

    with pytest.raises(DeviceError, match=r"a command came .* ms after"):
        arm.follow(far(arm), watch)
    assert stopped_after(ur, seen[0]) < STANDS + 0.1
    assert ur.protective == (how == "hangs")  # the driver brakes; where it cannot, the watchdog does


def test_an_arm_whose_driver_hangs_stands_soon(arm: UniversalRobot, ur: FakeUR) -> None:
    path = far(arm, 0.8)

    def follow() -> None:
        with suppress(DeviceError):
            arm.follow(path)

    moving = threading.Thread(target=follow)
    moving.start()
    while np.abs(ur.v).max() < 0.5:
        time.sleep(0.005)
    ur.dead, since, speed = True, clock(), np.abs(ur.v).max()
    after = stopped_after(ur, since)
    ur.dead = False
    moving.join()
    assert after < 1 / WATCHDOG + 1.2 * speed / 5.0 + 0.05
    assert ur.protective


MOVES = """
import sys; sys.path[:0] = [{here!r}]
from multiprocessing.managers import BaseManager
from slow_clock import clock, sleep
from small_planner import SmallPlanner
from anther.arm.arms import named
from anther.drivers.ur_controller import Controller
from anther.drivers.ur_rtde import UniversalRobot
for name in ("receive", "dashboard", "program"):
    BaseManager.register(name)
far = BaseManager(("127.0.0.1", int(sys.argv[1])), b"ur")
far.connect()
make = lambda: Controller(far.receive(), far.dashboard(), far.program, clock=clock)
ur5e = named("ur5e")
arm = UniversalRobot(make, names=ur5e.joints, acceleration=ur5e.acceleration, rate=100, clock=clock, sleep=sleep)
print("ready", flush=True)
arm.follow(SmallPlanner(ur5e).move(arm.joints(), arm.joints() + 0.8))
"""


def test_a_driver_that_is_killed_leaves_an_arm_at_rest(ur: FakeUR) -> None:
    """kill -9 in full motion."""

    class Served(BaseManager):
        pass

    Served.register("receive", lambda: FakeReceive(ur))
    Served.register("dashboard", lambda: FakeDashboard(ur))
    Served.register("program", ur.start)
    server = Served(("127.0.0.1", 0), b"ur").get_server()
    threading.Thread(target=server.serve_forever, daemon=True).start()
    words = [sys.executable, "-c", MOVES.format(here=str(HERE)), str(server.address[1])]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as driver:
        assert driver.stdout is not None
        assert driver.stdout.readline() == "ready\n"
        while np.abs(ur.v).max() < 0.4:
            assert driver.poll() is None
            time.sleep(0.005)
        driver.kill()
        killed, speed = clock(), np.abs(ur.v).max()
    assert stopped_after(ur, killed) < 1 / WATCHDOG + 1.2 * speed / 5.0 + 0.05
    assert ur.protective


def test_a_person_enables_it_after_a_protective_stop(arm: UniversalRobot, ur: FakeUR) -> None:
    ur.protective = True
    with pytest.raises(DeviceError, match="until 5s after"):
        arm.enable()
    ur.unlockable = True
    before = ur.q.copy()
    arm.enable()
    assert not ur.protective
    assert ur.q == pytest.approx(before)
    arm.follow(far(arm, 0.02))


def test_a_person_enables_it_after_an_emergency_stop(arm: UniversalRobot, ur: FakeUR) -> None:
    ur.pressed = True
    sleep(0.05)
    with pytest.raises(DeviceError, match="turn it until it comes out"):
        arm.enable()
    ur.pressed, before = False, ur.q.copy()
    ur.calls.clear()
    arm.enable()
    assert [name for name in ur.calls if name in ("powerOn", "brakeRelease")] == ["powerOn", "brakeRelease"]
    assert ur.q == pytest.approx(before)
    arm.follow(far(arm, 0.02))
    arm.disable()
    assert ur.mode == 3
    with pytest.raises(DeviceError, match="motors are not on"):
        arm.follow(far(arm, 0.02))


def test_enable_stops_a_program_that_was_held_up_before_it_releases_anything(arm: UniversalRobot, ur: FakeUR) -> None:
    other = ur.start()
    ur.paused = ur.protective = ur.unlockable = True
    ur._over = True  # the fake's own thread would end it
    sleep(0.05)
    ur.program = other
    ur.calls.clear()
    ur._over = False
    with suppress(DeviceError):
        arm.enable()
    assert ur.calls.index("stop") < ur.calls.index("unlockProtectiveStop")


def test_nothing_is_released_without_a_person(arm: UniversalRobot, ur: FakeUR) -> None:
    ur.protective = ur.unlockable = True
    sleep(0.05)
    ur.calls.clear()
    with pytest.raises(DeviceError):
        arm.follow(far(arm, 0.02))
    arm.hold()
    arm.close()
    assert not {"unlockProtectiveStop", "powerOn", "brakeRelease"} & set(ur.calls)


@pytest.mark.parametrize(("version", "rate"), [("5.11.1.108318", 500), ("3.15.8.106339", 125)])
def test_the_controller_gives_the_rate(ur: FakeUR, version: str, rate: int) -> None:
    ur.version, ur.remote = version, version[0] == "5"
    if rate == 125:
        ur.start = lambda: setattr(ur, "program", FakeControl(ur)) or ur.program  # type: ignore[method-assign]
    with closing(connected(ur, model="ur5")) as arm:
        assert f"{rate} a second" in " ".join(arm.seen())
    if rate == 125:
        with pytest.raises(DeviceError, match=r"rate: got 500 .* allowed: <= 125"):
            connected(ur, model="ur5", rate=500)
        with pytest.raises(DeviceError, match="not the arm that the model describes"):
            connected(ur, model="ur5e")


def test_another_arm_is_refused(ur: FakeUR) -> None:
    ur.model = "UR10"
    with pytest.raises(DeviceError, match="says UR10, PolyScope 5; the cell's model is ur5e"):
        connected(ur)
    assert ur.programs == 0


def test_an_arm_that_is_off_is_connected_to_and_told_about(ur: FakeUR) -> None:
    ur.mode = 3
    with closing(connected(ur)) as arm:
        assert arm.joints() == pytest.approx(READY)
        assert any("cannot move: its motors are not on (power off)" in line for line in arm.seen())
    assert ur.programs == 0


CELL = (HERE / "cells" / "sawyer.toml").read_text()
ARM = 'driver = "ur"\nhost = "ur.local"\nmodel = "ur5e"'


def cell_file(folder: Path, *lines: str) -> Path:
    words = re.sub(r'driver = "sawyer-ros1"\nmaster = "MASTER"\nmode = "trajectory"', "\n".join((ARM, *lines)), CELL)
    (folder / "cell.toml").write_text(words.replace("speed_ratio = 0.3", "speed_ratio = 1.0"))
    return folder / "cell.toml"


@pytest.fixture
def library(ur: FakeUR, monkeypatch: pytest.MonkeyPatch) -> FakeUR:
    """ur_rtde's three modules, with the fake in them."""
    monkeypatch.setattr("slow_clock.SLOWER", 1.0)
    monkeypatch.setitem(sys.modules, "rtde_control", SimpleNamespace(RTDEControlInterface=lambda host: ur.start()))
    monkeypatch.setitem(sys.modules, "rtde_receive", SimpleNamespace(RTDEReceiveInterface=lambda host: FakeReceive(ur)))
    monkeypatch.setitem(
        sys.modules, "dashboard_client", SimpleNamespace(DashboardClient=lambda host: FakeDashboard(ur))
    )
    return ur


def test_a_cell_file_names_it(tmp_path: Path, library: FakeUR) -> None:
    cell = read_cell(cell_file(tmp_path, "rate = 250", "gain = 300"))
    assert cell.owner_name == "ur ur.local"
    with closing(cell.connect(cell.arm)) as arm:
        assert any("250 a second" in line and "gain 300" in line for line in arm.seen())
    options = read_cell(cell_file(tmp_path)).arm
    assert parts.takes(options.make, "arm_model")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("rate = 1000", r"rate: got 1000 commands a second; allowed: 100 <="),
        ("lookahead = 0.5", r"lookahead: got 0.5 s; allowed: 0.03 <= .* <= 0.2"),
        ("gain = 50", r"gain: got 50"),
        ("gian = 500", r"arm.gian: got an unknown key 'gian'.*Did you mean gain"),
        ('rate = "fast"', r'line 6: arm.rate: got "fast"; allowed: a number'),
    ],
)
def test_bad_values_in_the_cell_file_are_told(tmp_path: Path, ur: FakeUR, line: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        (cell := read_cell(cell_file(tmp_path, line))).connect(cell.arm)
    assert ur.calls == []


def test_without_the_library_the_command_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rtde_control", None)
    cell = read_cell(cell_file(tmp_path))
    with pytest.raises(MissingExtra, match=r"pip install 'anther\[ur\]'"):
        cell.connect(cell.arm)


def test_behind_the_guard_it_is_an_arm(arm: UniversalRobot, ur: FakeUR, tmp_path: Path) -> None:
    guarded = GuardedArm(arm, read_cell(cell_file(tmp_path)).safety_limits())
    record = guarded.follow(far(arm, 0.05))
    assert guarded.joints() == pytest.approx(record.commanded[-1], abs=5e-3)
    ur.force = 30.0
    with pytest.raises(Exception, match="contact force"):
        guarded.follow(far(arm, -0.05))


REAL = [
    ("rtde_control", "RTDEControlInterface", FakeControl),
    ("rtde_receive", "RTDEReceiveInterface", FakeReceive),
    ("dashboard_client", "DashboardClient", FakeDashboard),
]


@pytest.mark.parametrize(("module", "name", "fake"), REAL)
def test_the_fake_has_only_methods_of_the_real_library(module: str, name: str, fake: type) -> None:
    """Its docstrings begin with the signature: name(self: ..., arg0: list[float], a: float = 10.0) -> bool."""
    real = getattr(pytest.importorskip(module, reason=NO_UR_RTDE), name)
    for method, mine in vars(fake).items():
        if method.startswith("_") or not inspect.isfunction(mine):
            continue
        theirs = getattr(real, method).__doc__.splitlines()[0]
        assert theirs.startswith(f"{method}(self")
        arguments = re.findall(r"(\w+): [^,()]*(=)?", re.sub(r"\[[^]]*\]", "", theirs.partition("self")[2]))
        wanted = [(key, p.default is not p.empty) for key, p in inspect.signature(mine).parameters.items()][1:]
        told = [(key, bool(default)) for key, default in arguments if key not in ("", "self")]
        told = [
            (mine_key if key.startswith("arg") else key, d)
            for (key, d), (mine_key, _) in zip(told, wanted, strict=True)
        ]
        assert told == wanted, theirs


def test_an_absent_controller_is_told_by_the_real_library() -> None:
    pytest.importorskip("rtde_receive", reason=NO_UR_RTDE)
    from anther.drivers.ur_controller import open_controller  # noqa: PLC0415

    with pytest.raises(DeviceError, match=r"no Universal Robots controller answers at 127.0.0.1"):
        open_controller("127.0.0.1")
