"""A Universal Robots arm in a cell: which arm it is, enabling it, its cell file; and the real ur_rtde's methods."""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import pytest
from fake_ur import READY, FakeControl, FakeDashboard, FakeReceive, FakeUR, connected, far
from slow_clock import AGAIN_IF_HELD_UP, clock, sleep

from anther.core.errors import InputError, MissingExtra
from anther.robot.cells import read_cell
from anther.robot.devices import DeviceError
from anther.robot.drivers.ur_controller import open_controller
from anther.robot.drivers.ur_rtde import UniversalRobot
from anther.robot.safety import GuardedArm

HERE = Path(__file__).parents[1] / "support"
NO_UR_RTDE = "no ur_rtde; run: pip install 'ur-rtde>=1.6'"
pytestmark = AGAIN_IF_HELD_UP


@pytest.fixture
def ur() -> Iterator[FakeUR]:
    with closing(FakeUR(clock=clock, sleep=sleep)) as fake:
        yield fake


@pytest.fixture
def arm(ur: FakeUR) -> Iterator[UniversalRobot]:
    with closing(connected(ur)) as driver:
        yield driver


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
    ur.pauses = ur.protective = ur.unlockable = True
    sleep(0.05)
    assert ur.program is not None
    ur.calls.clear()
    arm.enable()
    assert ur.calls.index("stop") < ur.calls.index("unlockProtectiveStop")
    arm.follow(far(arm, 0.02))


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
    with closing(connected(ur, model="ur5")) as arm:
        assert f"{rate} a second" in " ".join(arm.describe())
        assert "ready to move" in arm.describe()  # a CB3 has no local and remote control
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
        assert any("cannot move: its motors are not on (power off)" in line for line in arm.describe())
    assert ur.programs == 0


CELL = (HERE / "cells" / "sawyer.toml").read_text()
ARM = 'driver = "ur"\nhost = "ur.local"\nmodel = "ur5e"'


def cell_file(folder: Path, *lines: str) -> Path:
    words = re.sub(r'driver = "sawyer-ros1"\nmaster = "MASTER"\nmode = "trajectory"', "\n".join((ARM, *lines)), CELL)
    (folder / "cell.toml").write_text(words.replace("speed_ratio = 0.3", "speed_ratio = 1.0"))
    return folder / "cell.toml"


@pytest.fixture
def library(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """ur_rtde's three modules, with a fake in them; the hosts that were asked for."""
    hosts = list[str]()
    with closing(FakeUR(rate=200)) as ur:

        def offer(module: str, name: str, make: Callable[[], object]) -> None:
            offered = {name: lambda host: hosts.append(host) or make()}
            monkeypatch.setitem(sys.modules, module, SimpleNamespace(**offered))

        offer("rtde_control", "RTDEControlInterface", ur.start)
        offer("rtde_receive", "RTDEReceiveInterface", lambda: FakeReceive(ur))
        offer("dashboard_client", "DashboardClient", lambda: FakeDashboard(ur))
        yield hosts


def test_a_cell_file_names_it(tmp_path: Path, library: list[str]) -> None:
    cell = read_cell(cell_file(tmp_path, "rate = 250", "gain = 300"))
    with closing(cell.connect(cell.arm)) as arm:
        assert arm.joints() == pytest.approx(READY)
        assert any("250 a second" in line and "gain 300" in line for line in arm.describe())
    assert library == ["ur.local"] * 3


def test_two_arms_have_two_owners(tmp_path: Path) -> None:
    first = read_cell(cell_file(tmp_path)).owner_name
    (tmp_path / "cell.toml").write_text((tmp_path / "cell.toml").read_text().replace("ur.local", "ur2.local"))
    assert read_cell(tmp_path / "cell.toml").owner_name != first


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
def test_bad_values_in_the_cell_file_are_told(tmp_path: Path, library: list[str], line: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        (cell := read_cell(cell_file(tmp_path, line))).connect(cell.arm)
    assert library == []


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
def test_the_driver_calls_what_the_real_library_has(module: str, name: str, fake: type) -> None:
    """The fake has all that the driver calls. The library's docstrings begin with the signature:
    name(self: ..., arg0: list[float], a: float = 10.0) -> bool."""
    real = getattr(pytest.importorskip(module, reason=NO_UR_RTDE), name)
    for method, mine in vars(fake).items():
        if method.startswith("_") or not inspect.isfunction(mine):
            continue
        theirs = getattr(real, method).__doc__.splitlines()[0]
        assert theirs.startswith(f"{method}(self: ")
        told = [argument.partition(":") for argument in theirs.partition("(")[2].partition(")")[0].split(", ")[1:]]
        wanted = list(inspect.signature(mine).parameters.values())[1:]
        assert len(told) == len(wanted), theirs
        for (key, _, rest), parameter in zip(told, wanted, strict=True):
            assert key == parameter.name or re.fullmatch(r"arg\d", key), theirs
            assert ("=" in rest) == (parameter.default is not parameter.empty), theirs


def test_an_absent_controller_is_told_by_the_real_library() -> None:
    pytest.importorskip("rtde_receive", reason=NO_UR_RTDE)

    with pytest.raises(DeviceError, match=r"no Universal Robots controller answers at 127.0.0.1"):
        open_controller("127.0.0.1")
