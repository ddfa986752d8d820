"""The cell of a cell file, simulated: what it says is taken, what it lacks is said, and no machine is looked for."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from made_arm import CELL

from anther.cli.main import main
from anther.core.choices import ArmName
from anther.core.errors import InputError, StageFailure
from anther.core.geometry import Intrinsics
from anther.robot.arm.saved import SavedArm
from anther.robot.cells import CellFile
from anther.robot.devices import JointTrajectory
from anther.show.results import ARM, RunResults, read_run
from anther.show.run_scene import arm_of
from anther.show.viewer._motion import motion_of
from anther.sim.cell_file import foot_of, notes, read_simulated, simulate, wrist_lens
from anther.sim.simulated_cell import PRESETS, SimulatedCell

COMPLETE = (Path(__file__).parents[1] / "support" / "cells" / "sawyer.toml").read_text()
SHAPE = """
[gripper.shape]
opening = 0.06
palm = [0.07, 0.10, 0.08]
finger_length = 0.08
finger_width = 0.02
finger_thickness = 0.01
pad_length = 0.04
pad_thickness = 0.006
mass = 0.6
"""
FEW = replace(PRESETS["fast"], count=4)


def cell(folder: Path, text: str) -> CellFile:
    (folder / "mine.toml").write_text(text)
    return read_simulated(folder / "mine.toml")


@pytest.mark.parametrize("name", get_args(ArmName))
def test_an_arms_name_is_enough(tmp_path: Path, name: ArmName) -> None:
    """All else is supposed, around a plant within reach; every table that is supposed is named in a line."""
    file = cell(tmp_path, f'[arm]\nmodel = "{name}"\n')
    said = "\n".join(notes(file)).replace(" ", "_")
    assert set(file.supposed) >= {"gripper", "wrist_camera", "side_camera", "workspace", "keep_out", "limits"}
    assert all(table in said for table in file.supposed)
    foot, middle = foot_of(file.model, file.simulation, file.region), (file.region.lower + file.region.upper) / 2
    assert file.workspace.contains(foot)
    assert np.linalg.norm(middle - file.model.shoulder) < file.model.reach


def test_of_a_complete_file_nothing_of_its_places_is_supposed(tmp_path: Path) -> None:
    file = cell(tmp_path, COMPLETE.replace('port = "GRIPPER"', 'port = "GRIPPER"\nforce = 20.0' + SHAPE))
    assert file.supposed == ()
    assert [note.partition(":")[0] for note in notes(file)] == [
        "no machine is contacted", "arm", "wrist camera", "side camera",
    ], "the arm's model and both lenses are not in the file"  # fmt: skip


def test_no_driver_is_imported_and_none_can_be_connected_to(tmp_path: Path) -> None:
    (tmp_path / "not_to_import.py").write_text("raise SystemExit('a driver was imported')")
    arm = '[arm]\ndriver = "not_to_import:Arm"\nhost = "192.0.2.1"\nmodel = "ur5e"\n'
    text = arm + '[gripper]\ndriver = "robotiq-2f"\nport = "x"\n[shaker]\ndriver = "voice-coil"\nport = "y"'
    before = set(sys.modules)
    file = cell(tmp_path, text)
    assert not {"not_to_import", "rtde_control", "pymodbus", "pyrealsense2", "rclpy"} & (set(sys.modules) - before)
    for part in (file.arm, file.gripper, file.wrist_camera, file.side_camera, file.shaker):
        assert part is not None
        with pytest.raises(InputError, match="no machine to connect to"):
            file.connect(part)


def test_keys_of_known_drivers_are_checked_all_the_same(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"gripper.modle: got an unknown key 'modle'.*Did you mean model"):
        cell(tmp_path, '[arm]\nmodel = "ur5e"\n[gripper]\ndriver = "robotiq-2f"\nport = "x"\nmodle = "2f-85"')
    with pytest.raises(InputError, match=r'arm.driver: got "uur"'):
        cell(tmp_path, '[arm]\ndriver = "uur"\nmodel = "ur5e"')


@pytest.mark.parametrize(
    ("text", "foot"),
    [
        ("[simulation]\nfoot = [0.1, -0.6, -0.2]", (0.1, -0.6, -0.2)),
        ("[region]\nlower = [0.4, 0.0, -0.3]\nupper = [0.8, 0.4, 0.4]", (0.6, 0.2, -0.3)),
    ],
)
def test_the_plant_stands_where_the_file_says_and_the_rest_around_it(
    tmp_path: Path, text: str, foot: tuple[float, ...]
) -> None:
    file = cell(tmp_path, f'[arm]\nmodel = "ur5e"\n{text}')
    assert foot_of(file.model, file.simulation, file.region) == pytest.approx(foot)
    assert file.workspace.contains(np.array(foot))
    assert file.T_world_side_camera is not None
    gaze = file.T_world_side_camera[:3, 2]
    ahead = np.add(foot, [0, 0, 0.45]) - file.T_world_side_camera[:3, 3]
    assert gaze @ ahead / np.linalg.norm(ahead) > 0.95, "the side camera looks at the plant"
    assert abs(gaze[:2] @ foot[:2]) / np.linalg.norm(foot[:2]) < 0.2, "across the arm's approach"


LENSES: list[tuple[str, Intrinsics]] = [
    ("", Intrinsics(1280, 720, 640, 640, 639.5, 359.5)),
    ('[wrist_camera]\ndriver = "realsense"', Intrinsics(848, 480, 424, 424, 423.5, 239.5)),
    ('[wrist_camera]\ndriver = "realsense"\nwidth = 640\nheight = 360', Intrinsics(640, 360, 320, 320, 319.5, 179.5)),
    ("[simulation]\nwrist_intrinsics = [640, 480, 600, 601, 320, 240]", Intrinsics(640, 480, 600, 601, 320, 240)),
    (
        '[wrist_camera]\ndriver = "uvc"\nsource = "0"\nwidth = 64\nheight = 48\nfx = 60\nfy = 61\ncx = 32\ncy = 24',
        Intrinsics(64, 48, 60, 61, 32, 24),
    ),
]


@pytest.mark.parametrize(("text", "lens"), LENSES)
def test_a_cameras_lens_is_the_files_its_drivers_or_a_d455s(tmp_path: Path, text: str, lens: Intrinsics) -> None:
    assert wrist_lens(cell(tmp_path, f'[arm]\nmodel = "ur5e"\n{text}')) == lens


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[simulation]\nfoot = [620, 0, -450]", r"simulation: foot: got 620 m"),
        ("[simulation]\nfeet = [0.6, 0, -0.4]", r"simulation.feet: got an unknown key 'feet'"),
        ("[simulation]\nside_intrinsics = [640, 480, 0.6, 0.6, 320, 240]", r"focal length fx: got 0.6 px"),
        ("[workspace]\nlower = [320, -400, -480]\nupper = [1120, 400, 520]", r"workspace: farthest coordinate"),
        ('[gripper]\ndriver = "robotiq-2f"\nport = "x"\nforce = 90', r"gripper.force: got 90; .*20 N, the grip_force"),
    ],
)
def test_what_cannot_be_simulated_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        list(notes(cell(tmp_path, f'[arm]\nmodel = "ur5e"\n{text}')))


@pytest.fixture(scope="module")
def mine(tmp_path_factory: pytest.TempPathFactory) -> tuple[CellFile, SimulatedCell]:
    text = f'[arm]\nmodel = "ur5e"\n[gripper]{SHAPE}[wrist_camera]\nT_flange_cam = [0.0, 0.10, 0.04, 0, 0, 0, 1]\n'
    text += "[[keep_out]]\nlower = [0.3, -0.6, -0.9]\nupper = [1, 0.6, -0.66]\n[limits]\nspeed_ratio = 0.5\n"
    text += "[simulation]\nfoot = [0.64, -0.04, -0.45]\nside_camera = false\n"
    file = cell(tmp_path_factory.mktemp("mine"), text)
    return file, simulate(file, "pepper", 0, 0.0, FEW)


def test_the_simulated_machines_are_those_of_the_file(mine: tuple[CellFile, SimulatedCell]) -> None:
    file, simulated = mine
    robot, world = simulated.robot_side.robot, simulated.world
    assert robot.gripper.stroke == 0.06
    assert robot.gripper.state().opening == pytest.approx(0.06, abs=1e-3)
    assert robot.side_camera is None
    assert world.model.geom("gripper_body").size == pytest.approx([0.035, 0.05, 0.04])
    assert world.model.geom("left_pad").size == pytest.approx([0.01, 0.003, 0.02])
    assert world.model.geom("bench_0").size == pytest.approx([0.35, 0.6, 0.12])
    assert simulated.plant.pot.centre == pytest.approx([0.64, -0.04, -0.45])
    T_world_cam = file.model.forward(simulated.views.joints) @ file.T_flange_cam
    assert simulated.views.T_world_cam == pytest.approx(T_world_cam)
    assert simulated.robot_side.limits.joint_speed == pytest.approx(0.5 * file.model.velocity)


def test_the_same_guard_stands_before_the_simulated_arm(mine: tuple[CellFile, SimulatedCell]) -> None:
    arm = mine[1].robot_side.robot.arm
    here = arm.joints()
    still = np.zeros((2, len(here)))
    with pytest.raises(StageFailure, match=r"speed of joint \d: got .* of its limit"):
        arm.follow(JointTrajectory(np.array([0.0, 0.1]), np.stack([here, here + 0.4]), still))
    assert arm.joints() == pytest.approx(here, abs=1e-3), "it did not move"


def test_an_arm_of_ones_own_is_simulated_by_its_urdf() -> None:
    file = read_simulated(CELL)
    simulated = simulate(file, "tomato", 1, 0.0, FEW)
    assert simulated.world.arm.name == "my_arm"
    assert len(simulated.views.joints) >= 3
    assert simulated.plant.pot.centre == pytest.approx([0.55, 0.0, 0.10]), "below the region's middle"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--simulate"], "simulate: got no cell file"),
        (["--cell", "CELL", "--simulate", "--arm", "ur5e"], "got ur5e and a cell file"),
        (["--cell", "CELL", "--simulate", "--distance", "0.7"], "foot under [simulation]"),
        (["--cell", "CELL", "--simulate", "--params.grasp.gripper.stroke", "0.05"], "under [gripper.shape]"),
    ],
)
def test_options_that_the_file_answers_are_refused(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    told = [str(CELL) if word == "CELL" else word for word in words]
    assert main(["trial", *told, "--out", str(tmp_path / "run")]) == 2
    assert message in capfd.readouterr().err


def test_the_viewer_shows_the_arm_that_the_run_kept(tmp_path: Path) -> None:
    file = cell(tmp_path, f'[arm]\nmodel = "ur5e"\n[gripper]{SHAPE}')
    SavedArm(file.model, file.keep_out).save(tmp_path / ARM)
    shown = arm_of(RunResults(tmp_path, {"cell": str(tmp_path / "gone.toml"), "arm": "ur5e"}))
    assert shown.tool.solids(0.01) == file.model.tool.solids(0.01)


@pytest.mark.slow
@pytest.mark.long
def test_a_trial_of_a_cell_file_end_to_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = f'[arm]\ndriver = "ur"\nhost = "192.0.2.1"\nmodel = "ur5e"\n[gripper]{SHAPE}[limits]\nspeed_ratio = 1.0'
    cell(tmp_path, text)
    words = ["--cell", str(tmp_path / "mine.toml"), "--simulate", "--plant", "pepper", "--preset", "fast", "--no-watch"]
    out = tmp_path / "run"
    assert main(["trial", *words, "--out", str(out), "--history", str(tmp_path / "h.sqlite")]) in (0, 1)
    assert "no machine is contacted" in capsys.readouterr().out
    results = read_run(out)
    assert results.visit is not None
    assert results.visit.simulated_as[0].startswith("no machine")
    motion = motion_of(results)
    assert motion is not None
    assert (motion.arm.name, motion.arm.tool.stroke) == ("ur5e", 0.06)
