"""Numbers that no arm can have are refused with the file, the place in it, what is allowed and what to do."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from made_arm import CELL, six

from anther.cli.main import main
from anther.core.errors import InputError
from anther.core.geometry import transform
from anther.robot.arm.plausible import LARGEST_SPEED, check_joint
from anther.robot.cells import read_cell


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A copy of the example's cell."""
    return Path(shutil.copytree(CELL.parent, tmp_path / "own"))


def changed(file: Path, *changes: tuple[str, str]) -> None:
    text = file.read_text()
    for old, new in changes:
        assert re.search(old, text), old
        text = re.sub(old, new, text)
    file.write_text(text)


LIMITS = r'lower="-2.5" upper="2.5" velocity="2"'
URDF = {
    "degrees": (
        LIMITS,
        'lower="-143" upper="143" velocity="115"',
        r"joint j0: range: got -143 .. 143 rad; allowed: -13",
    ),
    "speed in degrees": (LIMITS, 'lower="-2.5" upper="2.5" velocity="115"', r"joint j0: velocity: got 115 rad/s; .*30"),
    "no limit": (LIMITS, 'lower="-2.5" upper="2.5" velocity="1e9"', r"joint j0: velocity: got 1e\+09 rad/s"),
    "zeros": (
        r'velocity="2" effort="\d+"',
        'velocity="0" effort="0"',
        "joint j0: velocity: got 0 rad/s; .*Write <limit",
    ),
    "small ranges in degrees": (LIMITS, 'lower="-18" upper="18" velocity="2"', r"joint j0: range: got -18 .. 18 rad"),
    "a decimal comma": (LIMITS, 'lower="-2,5" upper="2.5" velocity="2"', "joint j0: got lower '-2,5'; .*Write <limit"),
    "a negative speed": (LIMITS, 'lower="-2.5" upper="2.5" velocity="-2"', "joint j0: got velocity '-2'"),
    "without limits": (r'<limit lower=.* effort="36" />', "", "joint j3: got no limit; .*Write <limit"),
    "no direction": (r'<axis xyz="0 0 1" />', '<axis xyz="0 0 0" />', "joint j0: got axis 0 0 0"),
    "an angle in degrees": (
        r'<origin xyz="0 0 0.15" />\n    <axis',
        '<origin rpy="0 0 90" />\n    <axis',
        "rpy 0 0 90",
    ),
    "a follower": (r'effort="28" />', 'effort="28" /><mimic joint="j1" />', "joint j4: got a joint that mimics"),
    "grams": (r'<mass value="2.0" />', '<mass value="2000" />', "link l0: got 2000 kg in 0.00028 m3"),
    "a negative mass": (r'<mass value="2.0" />', '<mass value="-2" />', "got mass -2 kg"),
    "no shape that is known": (r'<sphere radius="0.04" />', '<capsule radius="0.04" length="1" />', "<capsule>"),
    "no torque": (r'effort="28"', 'effort="0"', "joint j4: effort: got 0 N m; allowed: > 0"),
    "no range": (LIMITS, 'lower="2.5" upper="-2.5" velocity="2"', r"joint j0: range: got 2.5 .. -2.5 rad"),
    "millimetres": (r'xyz="0 0 0\.', 'xyz="0 0 300.', r"reach: got .* m; allowed: 0.1 <= my_arm's reach <= 5 m"),
}


@pytest.mark.parametrize("name", URDF)
def test_a_urdf_in_other_units_is_refused_with_file_joint_and_number(folder: Path, name: str) -> None:
    old, new, message = URDF[name]
    changed(folder / "my_arm.urdf", (old, new))
    with pytest.raises(InputError, match=rf"my_cell.toml, line 6: arm.model: .*my_arm.urdf: .*{message}"):
        read_cell(folder / "my_cell.toml")


def test_a_joint_that_turns_on_and_on_must_say_how_fast(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    changed(
        folder / "my_arm.urdf",
        (r'(?s)<joint name="j5" type="revolute">(.*?)<limit [^>]*>', r'<joint name="j5" type="continuous">\1'),
    )
    assert main(["cell", "check", str(folder / "my_cell.toml")]) == 2
    said = capsys.readouterr().err
    assert re.search(r"joint j5: velocity: got inf rad/s; .*<limit lower= upper= velocity= effort=>", said)
    assert len(said.splitlines()) == 1


@pytest.mark.parametrize("limits", ['lower="-1e9" upper="1e9" velocity="2"', 'velocity="2"'])
def test_a_joint_that_turns_on_and_on_is_kept_to_one_turn(folder: Path, limits: str) -> None:
    changed(folder / "my_arm.urdf", (LIMITS, limits))
    arm = read_cell(folder / "my_cell.toml").model
    assert arm.upper - arm.lower == pytest.approx(np.full(6, 2 * np.pi))


def with_mesh(folder: Path, name: str, scale: str = "") -> None:
    """Let the second link's shape be a mesh."""
    tag = f'<geometry><mesh filename="{name}" {scale}/></geometry>'
    shape = r'(?s)(<link name="l1">.*?<collision>.*?)<geometry>.*?</geometry>'
    changed(folder / "my_arm.urdf", (shape, lambda found: found[1] + tag))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("l1.dae", "mesh: got l1.dae; allowed: .stl, .*Export it as STL in metres"),
        ("l1.foo", "mesh: got l1.foo; allowed: .stl"),
        ("package://my_arm_description/l1.stl", 'packages = "...", the folder in which my_arm_description lies'),
        ("none.stl", "mesh: got none.stl; allowed: a file that exists"),
    ],
)
def test_a_mesh_that_cannot_be_read_is_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], name: str, message: str
) -> None:
    with_mesh(folder, name)
    (folder / "l1.dae").write_text("<COLLADA/>")
    (folder / "l1.foo").write_text("")
    assert main(["cell", "check", str(folder / "my_cell.toml")]) == 2
    said = capsys.readouterr().err
    assert re.search(message, said)
    assert len(said.splitlines()) == 1


@pytest.mark.parametrize("name", ["meshes\\\\l1.stl", "meshes/L1.STL", "./meshes/l1.stl"])
def test_a_mesh_is_found_by_the_paths_of_windows(folder: Path, name: str) -> None:
    (folder / "meshes").mkdir()
    trimesh.creation.box((0.06, 0.06, 0.3)).export(folder / "meshes/l1.stl")
    with_mesh(folder, name)
    assert read_cell(folder / "my_cell.toml").model.links[1].capsules[0].radius == pytest.approx(0.0424, abs=1e-3)


@pytest.mark.parametrize("scale", ["0 0 0", "1 1 nan"])
def test_a_mesh_without_size_is_refused(folder: Path, scale: str) -> None:
    trimesh.creation.box((0.06, 0.06, 0.3)).export(folder / "l1.stl")
    with_mesh(folder, "l1.stl", f'scale="{scale}"')
    with pytest.raises(InputError, match=f"mesh scale: got {scale}"):
        read_cell(folder / "my_cell.toml")
    (folder / "l1.stl").write_bytes(b"")
    changed(folder / "my_arm.urdf", (f'scale="{scale}"', ""))
    with pytest.raises(InputError, match=r"l1.stl: got unreadable"):
        read_cell(folder / "my_cell.toml")


def test_soft_limits_are_kept(folder: Path) -> None:
    soft = '<safety_controller soft_lower_limit="-1.5" soft_upper_limit="1" k_velocity="9" />'
    changed(folder / "my_arm.urdf", ('effort="60" />', f'effort="60" />{soft}'))
    arm = read_cell(folder / "my_cell.toml").model
    assert (arm.lower[0], arm.upper[0]) == (-1.5, 1.0)


XACRO = ("<robot name", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name')
TURN = ('<link name="foot">', '<xacro:property name="turn" value="2.5" /><link name="foot">')


@pytest.mark.parametrize("value", ["${turn}", "${radians(143.2394487827058)}", "${2*turn/2}"])
def test_xacro_is_run_where_it_is_installed(folder: Path, value: str) -> None:
    changed(folder / "my_arm.urdf", XACRO, TURN, (LIMITS, f'lower="-2.5" upper="{value}" velocity="2"'))
    np.testing.assert_allclose(read_cell(folder / "my_cell.toml").model.upper, six().upper)


def test_xacro_that_is_missing_or_fails_is_told_how_to_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = (folder / "my_arm.urdf").read_text()
    changed(folder / "my_arm.urdf", XACRO, (LIMITS, 'lower="${what}" upper="${1+}" velocity="2"'))
    with pytest.raises(InputError, match=r"xacro refuses .*Run xacro first.*: xacro my_arm.urdf > my_arm_plain"):
        read_cell(folder / "my_cell.toml")
    (folder / "my_arm.urdf").write_text(whole)
    changed(folder / "my_arm.urdf", XACRO, TURN)
    monkeypatch.setattr(shutil, "which", lambda *_, **__: None)
    with pytest.raises(InputError, match=r"Run xacro first.*pip install 'anther\[cell\]'"):
        read_cell(folder / "my_cell.toml")


def test_a_mesh_in_millimetres_is_doubted_and_read_with_its_scale(folder: Path) -> None:
    trimesh.creation.box((60.0, 60.0, 300.0)).export(folder / "l1.stl")
    whole = (folder / "my_arm.urdf").read_text()
    with_mesh(folder, "l1.stl")
    with pytest.raises(InputError, match=r'my_arm.urdf: .*link l1: got shapes up to \d+ m .*scale="0.001 0.001 0.001"'):
        read_cell(folder / "my_cell.toml")
    (folder / "my_arm.urdf").write_text(whole)
    with_mesh(folder, "l1.stl", 'scale="0.001 0.001 0.001"')
    link = read_cell(folder / "my_cell.toml").model.links[1]
    assert max(np.linalg.norm(np.subtract(c.end, c.start)) + 2 * c.radius for c in link.capsules) < 0.4


def test_a_mesh_in_a_package_is_found_with_the_key(folder: Path) -> None:
    (folder / "my_arm_description").mkdir()
    trimesh.creation.box((0.06, 0.06, 0.3)).export(folder / "my_arm_description" / "l1.stl")
    with_mesh(folder, "package://my_arm_description/l1.stl")
    changed(folder / "my_cell.toml", ('base = "foot"', 'base = "foot"\npackages = "."'))
    assert read_cell(folder / "my_cell.toml").model.links[1].capsules


CELLS = {
    "floor far up": ("floor = -0.9", "floor = 50.0", "arm.model: .*floor, over its shoulder: got 49.85 m"),
    "acceleration": (r"\[8.0", "[458.0", "joint j0: acceleration: got 458 rad/s.2; allowed: > 0"),
    "hand-eye in mm": (r"\[0.09,", "[90.0,", "wrist_camera: distance of the camera"),
    "workspace in mm": (r"lower = \[0.25, -0.30", "lower = [-250.0, -0.30", "workspace: farthest coordinate: got 250"),
    "plant behind": (r"\[0.25, -0.30, 0.0\]\nupper = \[0.75", "[-3, -0.30, 0.0]\nupper = [-2", "workspace: distance"),
    "region elsewhere": (r"\[0.40, -0.20, 0.10\]\nupper = \[0.70", "[1.4, -0.2, 0.1]\nupper = [1.7", "region: got"),
    "arm space in mm": (r"upper = \[0.8, 0.8, 1.2\]", "upper = [800, 800, 1200]", "arm_space: farthest coordinate"),
    "arm space elsewhere": (r"\[-0.8, -0.8, 0.0\]", "[0.5, -0.8, 0.0]", "arm_space: got a box with"),
    "arm space beside": (
        r"lower = \[-0.8, -0.8, 0.0\]\nupper = \[0.8", "lower = [-0.8, -0.8, 0.0]\nupper = [0.1", "arm_space: got",
    ),
    "keep-out in mm": (r"lower = \[0.30, -0.50", "lower = [-300, -500", "keep_out.0: farthest coordinate: got 500 m"),
    "keep-out of all": (r"\[0.30, -0.50, -0.90\]\nupper = .*", "[-2, -2, -2]\nupper = [2, 2, 2]", "keep_out.0: got"),
}  # fmt: skip


@pytest.mark.parametrize("name", CELLS)
def test_a_cell_in_other_units_is_refused_with_its_line(folder: Path, name: str) -> None:
    old, new, message = CELLS[name]
    changed(folder / "my_cell.toml", (old, new))
    with pytest.raises(InputError, match=f"my_cell.toml, line .*{message}"):
        read_cell(folder / "my_cell.toml")


def test_a_keep_out_leaves_some_of_the_plant_free_though_the_arm_waits_elsewhere(folder: Path) -> None:
    changed(folder / "my_arm.urdf", (LIMITS, 'lower="-3.1" upper="3.1" velocity="2"'))
    changed(
        folder / "my_cell.toml",
        (r"ready = .0.0", "ready = [3.0"),
        (r"\[0.30, -0.50, -0.90\]\nupper = .*", "[0.24, -0.6, -0.1]\nupper = [2.0, 0.6, 0.7]"),
    )
    read_cell(folder / "my_cell.toml")
    changed(folder / "my_cell.toml", (r"0\.6, 0\.7", "0.6, 0.9"))
    with pytest.raises(InputError, match=r"keep_out.0: got .* allowed: a box that leaves some of the workspace free"):
        read_cell(folder / "my_cell.toml")


def test_a_calibration_in_millimetres_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = SimpleNamespace(T_flange_cam=transform(np.eye(3), [90.0, 0.0, 30.0]))
    monkeypatch.setattr("anther.robot.cells.HandEye.load", lambda _: found)
    changed(folder / "my_cell.toml", (r"T_flange_cam = .*", 'calibration = "calibration.json"'))
    with pytest.raises(InputError, match=r"wrist_camera: distance of the camera from the flange: got 94\.8"):
        read_cell(folder / "my_cell.toml")


def test_a_side_camera_stands_near_the_arm(folder: Path) -> None:
    text = (folder / "my_cell.toml").read_text()
    side = '[side_camera]\ndriver = "my_tools:MyCamera"\nT_world_cam = [740.0, -0.5, 0.2, 0.0, 0.0, 0.0, 1.0]\n'
    (folder / "my_cell.toml").write_text(text + side)
    with pytest.raises(InputError, match=r"side_camera.T_world_cam: distance of the camera from the base: got 740"):
        read_cell(folder / "my_cell.toml")


@given(
    lower=st.floats(-13.0, -0.1),
    upper=st.floats(0.1, 13.0),
    speed=st.floats(1e-3, LARGEST_SPEED),
    effort=st.floats(1e-3, 1e5),
)
def test_joints_within_what_arms_have_pass_and_in_degrees_none_does(
    lower: float, upper: float, speed: float, effort: float
) -> None:
    check_joint("j", lower, upper, speed, effort)
    if upper - lower > 1.0:  # 57 degrees
        with pytest.raises(InputError, match="j: range"):
            check_joint("j", *np.degrees([lower, upper]), speed, effort)
    for bad in ((-np.inf, upper, speed, effort), (lower, upper, -speed, effort), (lower, upper, speed, np.nan)):
        with pytest.raises(InputError):
            check_joint("j", *bad)


def test_an_arm_that_is_written_in_python_is_held_to_the_same() -> None:
    for name, value in (("velocity", 115.0), ("acceleration", 1e9), ("effort", 0.0), ("upper", 143.0)):
        with pytest.raises(InputError, match=rf"my_arm's joint j\d: (range|{name})"):
            replace(six(), **{name: np.full(6, value)})
