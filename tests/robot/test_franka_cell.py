"""A Franka arm in a cell: its cell file, connecting to it, and the real pylibfranka's names and arguments."""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import fake_franka
import pytest
from fake_franka import READY, FakeFranka, RealtimeConfig, connected, far, library, model

from anther.core.errors import InputError, MissingExtra
from anther.robot.cells import _parts, read_cell
from anther.robot.devices import DeviceError
from anther.robot.drivers._franka_loop import connect
from anther.robot.drivers.franka import MODES, Franka, open_franka
from anther.robot.safety import GuardedArm

HERE = Path(__file__).parents[1] / "support"
NO_LIBRARY = "no pylibfranka; run: pip install 'anther[franka]'"
CELL = (HERE / "cells" / "sawyer.toml").read_text()
ARM = 'driver = "franka"\nhost = "fr3.local"\nmodel = "fr3"'


@pytest.fixture
def fr3() -> Iterator[FakeFranka]:
    with closing(FakeFranka()) as fake:
        yield fake


def cell_file(folder: Path, *lines: str) -> Path:
    words = re.sub(r'driver = "sawyer-ros1"\nmaster = "MASTER"\nmode = "trajectory"', "\n".join((ARM, *lines)), CELL)
    (folder / "cell.toml").write_text(words.replace("speed_ratio = 0.3", "speed_ratio = 1.0"))
    return folder / "cell.toml"


def test_a_cell_file_names_it(tmp_path: Path, fr3: FakeFranka, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = dict[str, Any]()

    def opened(host: str, **given: Any) -> Franka:
        asked.update(given, host=host)
        return connected(fr3, names=given["names"])

    monkeypatch.setattr(_parts, "open_franka", opened)
    cell = read_cell(cell_file(tmp_path, "realtime = false"))
    with closing(cell.connect(cell.arm)) as arm:
        assert arm.joints() == pytest.approx(READY, abs=2e-3)
    assert asked["host"] == "fr3.local"
    assert not asked["realtime"]
    assert asked["acceleration"] == pytest.approx(model().acceleration)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('realtime = "no"', r'line 6: arm.realtime: got "no"'),
        ("rate = 500", r"arm.rate: got an unknown key 'rate'"),
    ],
)
def test_bad_values_in_the_cell_file_are_told(tmp_path: Path, line: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        (cell := read_cell(cell_file(tmp_path, line))).connect(cell.arm)


def test_without_the_library_the_command_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pylibfranka", None)
    cell = read_cell(cell_file(tmp_path))
    with pytest.raises(MissingExtra, match=r"pip install 'anther\[franka\]'"):
        cell.connect(cell.arm)


def test_behind_the_guard_it_is_an_arm(fr3: FakeFranka, tmp_path: Path) -> None:
    with closing(connected(fr3)) as arm:
        guarded = GuardedArm(arm, read_cell(cell_file(tmp_path)).safety_limits())
        with pytest.raises(Exception, match=r"workspace|range|limits"):
            guarded.follow(far(arm, 3.0))
        assert fr3.calls == []


def test_what_keeps_it_from_connecting_is_told() -> None:
    class Refuses:
        def __init__(self, host: str, config: RealtimeConfig) -> None:
            if config is RealtimeConfig.kEnforce:
                raise fake_franka.RealtimeException("libfranka: Running kernel does not have realtime capabilities.")
            raise fake_franka.NetworkException("libfranka: Connection to FCI refused.")

    sdk = SimpleNamespace(**{**vars(library(None)), "Robot": Refuses})  # type: ignore[arg-type]
    robot, why = connect(sdk, "fr3.local", True)
    assert robot is None
    assert "realtime = false" in why
    robot, why = connect(sdk, "fr3.local", False)
    assert robot is None
    assert re.search("no Franka arm answers at fr3.local: Connection to FCI refused.*activated in Desk", why)


def test_an_absent_robot_is_told_by_the_real_library() -> None:
    pytest.importorskip("pylibfranka", reason=NO_LIBRARY)
    with pytest.raises(DeviceError, match=r"no Franka arm answers at 127.0.0.77|kernel"):
        open_franka("127.0.0.77", names=model().joints, acceleration=model().acceleration, realtime=False)


def arguments(doc: str) -> list[tuple[str, bool]]:
    """Return the names after self, and whether they have a default, of "name(self: X, a: int = 3) -> None"."""
    inside = doc.partition("(")[2].rpartition(") ->")[0]
    return [(name, "=" in rest) for name, rest in re.findall(r"(?:, )(\w+): ((?:[^,\[\]]|\[.*?\])*)", inside)]


@pytest.mark.parametrize("name", ["Robot", "ActiveControlBase", "JointPositions"])
def test_the_driver_calls_what_the_real_library_has(name: str) -> None:
    """The fake has all that the driver calls. The library's docstrings begin with the signature."""
    real = getattr(pytest.importorskip("pylibfranka", reason=NO_LIBRARY), name)
    for method, mine in vars(getattr(fake_franka, name)).items():
        if not inspect.isfunction(mine) or (method.startswith("_") and method != "__init__"):
            continue
        if method == "__init__" and name == "ActiveControlBase":
            continue  # the robot makes it
        doc = getattr(real, method).__doc__
        if "Overloaded" in doc:
            assert "franka::JointPositions" in doc
            continue
        wanted = [
            (p.name, p.default is not inspect.Parameter.empty)
            for p in list(inspect.signature(mine).parameters.values())
        ][1:]
        told = arguments(doc)
        assert len(told) == len(wanted), doc
        for (theirs, optional), (ours, may) in zip(told, wanted, strict=True):
            assert theirs == ours or re.fullmatch(r"arg\d", theirs), doc
            assert optional == may, doc


def test_modes_errors_and_states_are_those_of_the_real_library() -> None:
    sdk = pytest.importorskip("pylibfranka", reason=NO_LIBRARY)
    members = {name for name in dir(sdk.RobotMode) if not name.startswith("_")} - {"name", "value"}
    assert members == set(MODES) == set(fake_franka.RobotMode.__members__)
    assert {name for name in dir(fake_franka.Errors) if not name.startswith("_")} <= set(dir(sdk.Errors))
    told = re.findall(r"(\w+)=", inspect.getsource(FakeFranka.state))
    assert set(told) <= set(dir(sdk.RobotState))
    for name in ("FrankaException", "RealtimeException", "RealtimeConfig", "ControllerMode"):
        assert hasattr(sdk, name)
    assert issubclass(sdk.ControlException, RuntimeError)
    assert issubclass(sdk.NetworkException, RuntimeError)
    command = sdk.JointPositions([0.0] * 7)
    command.motion_finished = True
