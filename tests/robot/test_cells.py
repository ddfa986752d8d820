"""Cell files: what they say, how they are wrong, who owns the arm; and the command that checks, enables and jogs."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fake_robotiq import FakeRobotiq
from fake_ros_master import FakeMaster
from fake_sawyer import FakeSawyer
from made_arm import CELL
from scipy.spatial.transform import Rotation

from anther.cli.cell import _describe_imu
from anther.cli.main import main
from anther.core.errors import AntherError, InputError
from anther.core.geometry import transform
from anther.robot.arm.arms import find_arm
from anther.robot.arm.sawyer import SAWYER, TOOL
from anther.robot.cells import CellFile, _parts, read_cell
from anther.robot.cells.hardware import place_of_imu
from anther.robot.devices import ImuReadings
from anther.robot.drivers import sawyer_ros1

EXAMPLE = (Path(__file__).parents[1] / "support" / "cells" / "sawyer.toml").read_text()
PAGE = Path(__file__).parents[2] / "docs" / "cell_file.md"

Write = Callable[..., Path]
Machines = tuple[Path, FakeSawyer, FakeRobotiq]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Write the example with some of its words replaced."""

    def written(*changes: tuple[str, str]) -> Path:
        text = EXAMPLE
        for old, new in changes:
            assert old in text
            text = text.replace(old, new, 1)
        (tmp_path / "cell.toml").write_text(text)
        return tmp_path / "cell.toml"

    return written


def test_a_cell_file_says_what_stands_where_and_what_it_may(write: Write) -> None:
    cell = read_cell(write())
    assert isinstance(cell, CellFile)
    assert (cell.arm.driver, cell.gripper.driver) == ("sawyer-ros1", "robotiq-2f")
    assert cell.T_flange_cam == pytest.approx(TOOL.T_flange_cam, abs=1e-6)
    assert cell.shaker is None
    limits = cell.safety_limits()
    assert limits.joint_speed == pytest.approx(0.3 * SAWYER.velocity)
    assert limits.flange_speed == pytest.approx(0.45)
    assert limits.contact_force == 20.0
    assert [place.upper[2] for place in cell.keep_out] == [-0.48]
    assert limits.keep_out[0].upper[2] == -0.48


def test_a_cell_file_may_name_another_arm(write: Write) -> None:
    cell = read_cell(write(('mode = "trajectory"', 'mode = "trajectory"\nmodel = "ur5e"')))
    assert cell.model is find_arm("ur5e")
    assert cell.safety_limits().joint_speed == pytest.approx(0.3 * cell.model.velocity)
    assert cell.safety_limits().outline(np.zeros((2, 6))).shape[0] == 2


def test_the_manuals_example_is_a_cell_file(tmp_path: Path) -> None:
    found = re.search(r"```toml\n(.+?)```", PAGE.read_text(), re.DOTALL)
    assert found is not None
    (tmp_path / "cell.toml").write_text(found[1])
    (tmp_path / "my_cameras.py").write_text("from fake_robot import FakeCamera as Wrist, FakeCamera as Side")
    (tmp_path / "my_carts.py").write_text("from fake_cart import FakeCart as Cart")
    cell = read_cell(tmp_path / "cell.toml")
    assert cell.limits.speed_ratio == 0.1
    assert cell.shaker is not None
    assert cell.cart is not None
    assert cell.imu is not None
    assert cell.imu.driver == "realsense"


WRONG = [
    ("mode = ", "moed = ", r"line 5: arm.moed: got an unknown key .moed.; allowed: .*Did you mean mode"),
    (
        '"trajectory"',
        '"trajectory"\nmodel = "robby"',
        r"line 6: arm.model: arm: got 'robby'; allowed: sawyer, ur5e, fr3",
    ),
    ('"trajectory"', '"torque"', r'line 5: arm.mode: got "torque"; allowed: "position", "trajectory"'),
    ("speed_ratio = 0.3", 'speed_ratio = "slow"', r'line 37: limits.speed_ratio: got "slow"; allowed: a number'),
    ('"trajectory"', '"trajectory"\nrate = nan', r"line 6: arm.rate: got nan; allowed: a number"),
    ('"trajectory"', '"trajectory"\nrate = -inf', r"line 6: arm.rate: got -inf; allowed: a number"),
    ("speed_ratio = 0.3", "speed_ratio = 3", r"line 36: limits: speed_ratio: got 3; allowed: 0.01 <="),
    ("contact_force = 20", "contact_force = 1e9", r"line 36: limits: contact_force: got 1e\+09 N"),
    ("[gripper]", "[griper]", r"line 7: griper: got an unknown key .griper."),
    ('[gripper]\ndriver = "robotiq-2f"\nport = "GRIPPER"\n', "", r"got no \[gripper\]"),
    ('port = "GRIPPER"', "", r"line 7: gripper: got no 'port'; allowed: port = text in quotes"),
    ('"robotiq-2f"', '"schunk"', r'line 8: gripper.driver: got "schunk"; allowed: "rethink", "robotiq-2f"'),
    ('driver = "robotiq-2f"', "", r"line 7: gripper: got no driver"),
    ("fake_robot:FakeCamera", "fake_robot:NoCamera", r"line 12: wrist_camera.driver: got .*that Python finds"),
    ("T_flange_cam", "hand_eye", r"line 11: wrist_camera: got no calibration and no T_flange_cam"),
    ("[0.09, 0.0, 0.03,", "[0.09, 0.0,", r"line 13: wrist_camera.T_flange_cam: .*allowed: 7 numbers"),
    ("0.70710678, 0.70710678]", "0.0, 0.0]", r"line 13: wrist_camera.T_flange_cam: "),
    ("T_world_cam", "T_cam", r"line 15: side_camera: got no 'T_world_cam'"),
    ("lower = [0.32", "lower = [9.32", r"line 19: workspace: box: .*lower < upper"),
    ("lower = [0.42", "lower = [9.42", r"keep_out.0: box: .*lower < upper"),
    ("upper = [1.22, 0.55, -0.48]", 'upper = [1.22, 0.55, "a"]', r"line 34: keep_out.0.upper: .*3 numbers"),
    ("[limits]", "[tool]\ntip = 0.2\n[limits]", r"tool: tip: got 0.2 m"),
    ("[arm]", "[arm", r"no TOML: .*at line 2"),
]


@pytest.mark.parametrize(("old", "new", "message"), WRONG)
def test_what_is_wrong_in_it_is_told_with_its_line(write: Write, old: str, new: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_cell(write((old, new)))


def test_an_own_driver_is_told_only_what_it_takes(write: Write) -> None:
    with pytest.raises(InputError, match=r"wrist_camera.serial: got an unknown key 'serial'"):
        read_cell(write(('FakeCamera"\nT_flange', 'FakeCamera"\nserial = "1"\nT_flange')))


def test_an_arm_that_anther_never_saw_is_a_urdf_and_a_driver_of_under_sixty_lines(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """`test_devices.py` puts that driver through the checks of `anther.robot.testing`."""
    cell = read_cell(CELL)
    assert (cell.model.name, cell.model.count, cell.model.floor) == ("my_arm", 6, -0.9)
    assert cell.safety_limits().joint_acceleration == pytest.approx(0.1 * np.full(6, 8.0))
    assert len(CELL.with_name("my_arm.py").read_text().splitlines()) < 60
    assert main(["cell", "check", str(CELL)]) == 0
    assert "nothing was moved" in capsys.readouterr().out
    monkeypatch.setattr("builtins.input", lambda _: "yes")
    assert main(["cell", "jog", str(CELL), "--joint", "5", "--by", "2"]) == 0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('tip = "hand"', 'tip = "nose"', "line 6: arm.model: .*tip: got 'nose'; allowed: a link that hangs on 'foot'"),
        ('base = "foot"\n', "", "arm.model: got no 'base'"),
        ("[8.0, 8.0, ", "[8.0, ", "my_arm's acceleration"),
        ("ready = [0.0,", "ready = [", "my_arm's"),
        ("my_arm.urdf", "none.urdf", "none.urdf"),
        ("my_arm.urdf", "my_arm.py", "my_arm.py: got no XML"),
    ],
)
def test_what_is_wrong_with_an_arms_own_description_is_told(tmp_path: Path, old: str, new: str, message: str) -> None:
    file = Path(shutil.copytree(CELL.parent, tmp_path / "own")) / CELL.name
    told = file.read_text()
    assert old in told
    file.write_text(told.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read_cell(file)


@pytest.fixture
def machines(write: Write, monkeypatch: pytest.MonkeyPatch) -> Iterator[Machines]:
    """A cell file, and its fakes. Milliseconds are tested elsewhere: here this machine may be busy."""
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr(sawyer_ros1, "STALE", 1.0)
    monkeypatch.setattr(sawyer_ros1.Sawyer, "_longest_silence", 1.0)
    master = FakeMaster()
    with closing(FakeSawyer(master.uri)) as arm, closing(FakeRobotiq()) as gripper:
        yield write(("MASTER", master.uri), ("GRIPPER", f"tcp://127.0.0.1:{gripper.port}")), arm, gripper
    master.stop()


def test_check_shows_what_each_part_sees_and_moves_nothing(
    machines: Machines, capsys: pytest.CaptureFixture[str]
) -> None:
    file, arm, gripper = machines
    gripper.active = True
    assert main(["cell", "check", str(file)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    for words in (
        "readings a second",
        "ready to move",
        "holds nothing",
        "8 x 6 px",
        "speed ratio 0.3",
        "nothing was moved",
    ):
        assert words in said
    assert arm.heard == []
    assert gripper.writes == []


def test_check_says_what_is_missing_and_how_to_get_it(machines: Machines, capsys: pytest.CaptureFixture[str]) -> None:
    file, arm, _ = machines
    arm.enabled = False
    assert main(["cell", "check", str(file)]) == 1
    said = re.sub(r"[\s│]+", " ", capsys.readouterr().out)
    assert "not enabled: anther cell enable" in said
    assert "MISSING: gripper: it is not activated. Then: anther cell enable." in said
    assert "1 missing; nothing was moved" in said


def test_check_without_a_robot(
    write: Write, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    file = write(("MASTER", "http://127.0.0.1:1"), ("GRIPPER", "tcp://127.0.0.1:1"))
    assert main(["cell", "check", str(file)]) == 1
    said = re.sub(r"[\s│]+", " ", capsys.readouterr().out)
    assert "no ROS master answers" in said
    assert "gripper: nothing answers" in said


def test_enable_and_jog_ask_first(
    machines: Machines, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file, arm, gripper = machines
    arm.enabled, answers = False, iter(["no", "no", "yes", "yes", "no", "yes"])
    monkeypatch.setattr("builtins.input", lambda _: next(answers))
    assert main(["cell", "enable", str(file)]) == 0
    assert not arm.enabled
    assert gripper.writes == []
    assert main(["cell", "enable", str(file)]) == 0
    assert arm.enabled
    assert "counts = [3, 228]" in capsys.readouterr().out
    begin = arm.q.copy()
    assert main(["cell", "jog", str(file), "--joint", "5", "--by", "3"]) == 1
    assert arm.q == pytest.approx(begin)
    assert main(["cell", "jog", str(file), "--joint", "5", "--by", "3"]) == 0
    assert arm.q - begin == pytest.approx(np.deg2rad(3) * np.eye(7)[5], abs=1e-3)
    assert "joint 5 went 3.0" in capsys.readouterr().out


def test_a_jog_stays_within_the_limits(machines: Machines, capsys: pytest.CaptureFixture[str]) -> None:
    file, arm, _ = machines
    assert main(["cell", "jog", str(file), "--by", "30"]) == 2
    assert main(["cell", "jog", str(file), "--joint", "7"]) == 2
    arm.q = np.append(arm.q[:6], SAWYER.upper[6] - 0.03)
    assert main(["cell", "jog", str(file), "--joint", "6", "--by", "5"]) == 2
    assert "Traceback" not in capsys.readouterr().err
    assert arm.heard == []


def test_cameras_by_name_say_what_is_missing(tmp_path: Path) -> None:
    lens = {"width": 64, "height": 48, "fx": 60.0, "fy": 60.0, "cx": 31.5, "cy": 23.5}
    with pytest.raises(AntherError, match=r"uvc|camera|source"):
        _parts.CAMERAS["uvc"](str(tmp_path / "none.mp4"), **lens)
    with pytest.raises(AntherError, match=r"(?i)realsense"):
        _parts.CAMERAS["realsense"]("000000000000")


def with_imu(write: Write, table: str) -> CellFile:
    return read_cell(write(("[limits]", f"[imu]\n{table}\n[limits]")))


def test_where_an_inertial_sensor_is_the_file_says_or_the_camera_it_is_in(write: Write) -> None:
    place = "[0.0, 0.01, 0.03, 0.0, 0.0, 0.0, 1.0]"
    told = with_imu(write, f'driver = "ros2"\ntopic = "/hand"\nT_flange_imu = {place}')
    assert told.imu is not None
    assert told.imu.table == {"topic": "/hand"}
    T_cam_imu = transform(np.eye(3), [-0.0055, 0.0051, 0.0117])
    inside, elsewhere = SimpleNamespace(T_cam_imu=T_cam_imu), SimpleNamespace(T_cam_imu=None)
    for sensor in (inside, elsewhere):
        assert place_of_imu(told, sensor)[:3, 3] == pytest.approx([0.0, 0.01, 0.03])  # type: ignore[arg-type]
    untold = with_imu(write, 'driver = "realsense"')
    assert place_of_imu(untold, inside) == pytest.approx(untold.T_flange_cam @ T_cam_imu)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"imu: got no T_flange_imu; allowed: .*7 numbers"):
        place_of_imu(untold, elsewhere)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('driver = "bosch"', r'imu.driver: got "bosch"; allowed: "realsense", "ros2"'),
        ('driver = "ros2"\nT_flange_imu = [0.0]', r"imu.T_flange_imu: .*7 numbers"),
        ('driver = "realsense"\ntopic = "/imu"', r"imu.topic: got an unknown key"),
        ("", "imu: got no driver"),
    ],
)
def test_an_inertial_sensor_that_cannot_be_is_told_with_its_line(write: Write, table: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        with_imu(write, table)


def test_a_check_of_an_inertial_sensor_tells_its_rate_and_how_gravity_lies(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("time.sleep", lambda _: None)
    file = with_imu(write, 'driver = "ros2"\nT_flange_imu = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]')
    up = file.model.forward(SAWYER.neutral)[:3, :3].T @ Rotation.from_euler("x", 0.1).as_matrix() @ [0, 0, 9.7]
    readings = ImuReadings(np.arange(250) / 250, np.tile(up, (250, 1)), np.zeros((250, 3)))
    nothing = SimpleNamespace(start=lambda: None, stop=lambda: None, T_cam_imu=None)
    sensor = SimpleNamespace(**vars(nothing), recorded=lambda _: readings)
    arm = SimpleNamespace(joints=lambda: SAWYER.neutral)
    rate, gravity = _describe_imu(sensor, file, arm)  # type: ignore[arg-type]
    assert rate == "250 readings a second; 9.70 m/s2, at rest 9.81"
    assert gravity == "gravity 5.7 degrees from where the arm's joints have it"
    assert len(_describe_imu(sensor, file, None)) == 1  # type: ignore[arg-type]
    empty = ImuReadings(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)))
    silent = SimpleNamespace(**vars(nothing), recorded=lambda _: empty)
    assert _describe_imu(silent, file, None) == ["reads NOTHING in 1 s"]  # type: ignore[arg-type]
