"""Grippers by their measures, the camera's outline by its calibration, and the file that a run keeps an arm in."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from anther.core.choices import ArmName
from anther.core.errors import InputError
from anther.core.geometry import Box, transform, transform_points
from anther.robot.arm.arms import find_arm
from anther.robot.arm.gripper_shape import GripperShape
from anther.robot.arm.grippers import PRESETS, GripperSize, with_camera
from anther.robot.arm.model import outline
from anther.robot.arm.saved import SavedArm
from anther.robot.arm.sawyer import SAWYER, TOOL
from anther.robot.cells import read_cell
from anther.robot.cells.hardware import _check_stroke

EXAMPLE = (Path(__file__).parents[1] / "support" / "cells" / "sawyer.toml").read_text()
MINE = {
    "opening": 0.06,
    "palm": [0.07, 0.10, 0.08],
    "offset": 0.01,
    "finger_length": 0.07,
    "finger_width": 0.02,
    "finger_thickness": 0.01,
    "pad_length": 0.04,
    "pad_thickness": 0.006,
    "mass": 0.6,
}
Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Write the example with a gripper of these measures, and other words replaced."""

    def written(shape: dict[str, Any] | str, *changes: tuple[str, str]) -> Path:
        told = json.dumps(shape) if isinstance(shape, str) else None
        rows = f"shape = {told}" if told else "\n".join(
            ["[gripper.shape]", *(f"{key} = {json.dumps(value)}" for key, value in shape.items())]  # type: ignore[union-attr]
        )  # fmt: skip
        text = EXAMPLE.replace('port = "GRIPPER"', f'port = "GRIPPER"\n{rows}')
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "cell.toml").write_text(text)
        return tmp_path / "cell.toml"

    return written


def test_the_measures_of_a_gripper_are_the_arms_tool(write: Write) -> None:
    tool = read_cell(write(MINE)).model.tool
    assert (tool.stroke, tool.mass, tool.thickness) == (0.06, 0.6, 0.01)
    assert tool.finger == pytest.approx(0.01 + 0.08)
    assert tool.tip == pytest.approx(0.01 + 0.08 + 0.07)
    assert tool.pad == (0.02, 0.006, 0.04)
    assert np.array(tool.body.center) + tool.body.half == pytest.approx([0.035, 0.05, 0.09])
    assert tool.camera == TOOL.camera


@pytest.mark.parametrize("size", [GripperSize(**MINE), *PRESETS.values()], ids=["mine", *PRESETS])
def test_grasps_see_the_boxes_that_the_arm_is_planned_with(size: GripperSize) -> None:
    tool = size.on(TOOL)
    shape = GripperShape.of(tool)
    solids = (tool.body, *tool.camera, *tool.fingers(tool.stroke))
    arm = [np.concatenate([np.subtract(s.center, s.half), np.add(s.center, s.half)]) for s in solids]
    wrist = (-0.045, -0.045, -0.05, 0.045, 0.045, 0.0)  # Sawyer's, which is no part of the tool
    seen = [row for row in shape.boxes(0.0) if not np.array_equal(row, wrist)]
    assert np.array(sorted(map(tuple, seen))) == pytest.approx(np.array(sorted(map(tuple, arm))), abs=1e-9)
    assert shape.depth == pytest.approx(tool.T_flange_grasp[2, 3])


def test_the_usual_gripper_is_the_tools() -> None:
    assert GripperShape() == GripperShape.of(TOOL)
    rethink = PRESETS["rethink"].on(TOOL)
    assert (rethink.tip, rethink.stroke, rethink.pad) == (pytest.approx(TOOL.tip), TOOL.stroke, TOOL.pad)
    assert rethink.finger == pytest.approx(TOOL.finger, abs=1e-4)


def test_a_preset_may_be_changed_in_part(write: Write) -> None:
    assert read_cell(write("franka-hand")).model.tool.stroke == 0.08
    tool = read_cell(write({"preset": "franka-hand", "finger_length": 0.1})).model.tool
    assert (tool.stroke, tool.tip) == (0.08, pytest.approx(0.166))


WRONG = [
    ({"opening": 60}, r"line 1\d: gripper.shape: opening: got 60 m; allowed: 0.01 <= opening <= 0.3 m"),
    ({"palm": [70, 100, 80]}, r"gripper.shape: palm along x: got 70 m"),
    ({"palm": 0.07}, r"line 1\d: gripper.shape.palm: got 0.07; allowed: 3 numbers"),
    ({"pad_length": 0.08}, r"pad_length: got 0.08 m.*no longer than the finger"),
    ({"mass": 0}, r"mass: got 0 kg"),
    ({"finger_lenght": 0.07}, r"unknown key 'finger_lenght'.*Did you mean finger_length"),
    ({"preset": "schunk"}, r"gripper.shape: got 'schunk'; allowed: rethink, robotiq-2f-85, franka-hand, or a table"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "message"), WRONG)
def test_a_gripper_that_cannot_be_is_refused_with_its_line(write: Write, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_cell(write(MINE | changes))


def test_every_measure_without_a_preset_is_asked_for(write: Write) -> None:
    for key in set(MINE) - {"offset"}:
        with pytest.raises(InputError, match=rf"gripper.shape: got no '{key}'"):
            read_cell(write({name: value for name, value in MINE.items() if name != key}))


def test_what_was_measured_on_the_flange_is_held_against_that_gripper(write: Write) -> None:
    measured = ("[limits]", "[tool]\ntip = 0.161\n[limits]")
    assert read_cell(write(MINE, measured)).tool.tip == 0.161
    with pytest.raises(InputError, match=r"tool: tip: got 0.161 m; allowed: 0.130"):
        read_cell(write("rethink", measured))


def test_a_gripper_that_opens_less_than_planned_is_refused(write: Write) -> None:
    file = read_cell(write(MINE))
    _check_stroke(file, SimpleNamespace(stroke=0.0595))  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"got 0.0600 m; allowed: at most 0.0500 m"):
        _check_stroke(file, SimpleNamespace(stroke=0.05))  # type: ignore[arg-type]


@pytest.mark.parametrize("turn", [[0, 0, 0], [0.4, 0, 0], [0, 0.5, 0.3]])
def test_a_cameras_outline_holds_the_camera_where_it_is_calibrated(turn: list[float]) -> None:
    T = transform(Rotation.from_rotvec(turn).as_matrix() @ TOOL.T_flange_cam[:3, :3], [0.02, -0.11, 0.05])
    tool, (w, h, d) = with_camera(TOOL, T, (0.05, 0.04, 0.02)), (0.05, 0.04, 0.02)
    corners = np.array([(x, y, z) for x in (-w / 2, w / 2) for y in (-h / 2, h / 2) for z in (-d, 0)])
    body = tool.camera[0]
    assert np.all(np.abs(transform_points(T, corners) - body.center) <= np.array(body.half) + 1e-9)
    assert np.array_equal(tool.T_flange_cam, T)
    assert tool.body == TOOL.body


def test_a_camera_about_where_the_tool_has_it_keeps_its_outline() -> None:
    assert with_camera(TOOL, TOOL.T_flange_cam) is TOOL
    near = transform(np.eye(3), [0.002, 0, 0]) @ TOOL.T_flange_cam
    assert with_camera(TOOL, near).camera == TOOL.camera
    d455 = with_camera(TOOL, TOOL.T_flange_cam, (0.124, 0.029, 0.026)).camera
    assert np.array(d455[0].center) == pytest.approx(TOOL.camera[0].center)
    assert np.array(d455[0].half) == pytest.approx(TOOL.camera[0].half)


@pytest.mark.parametrize("name", get_args(ArmName))
def test_another_tool_leaves_the_arm_as_it_was(name: ArmName) -> None:
    arm = find_arm(name)
    other = arm.with_tool(PRESETS["robotiq-2f-85"].on(arm.tool))
    assert np.array_equal(other.forward(arm.ready), arm.forward(arm.ready))
    assert (other.reach, other.tool.stroke) == (arm.reach, 0.085)
    assert set(arm.neighbours) <= set(other.neighbours)
    added = set(other.neighbours) - set(arm.neighbours)
    assert all({"gripper", "camera"} & set(pair) for pair in added), "links are checked against each other as before"
    assert outline(other, arm.ready).shape != outline(arm, arm.ready).shape
    assert arm.with_tool(arm.tool) is arm


@pytest.mark.parametrize("name", get_args(ArmName))
def test_a_kept_arm_is_read_as_it_was(tmp_path: Path, name: ArmName) -> None:
    arm = find_arm(name)
    SavedArm(arm, (Box(np.zeros(3), np.ones(3)),)).save(tmp_path / "arm.json")
    read = SavedArm.load(tmp_path / "arm.json")
    before, after = asdict(arm), asdict(read.arm)
    for key, value in before.items():
        np.testing.assert_equal(after[key], value)
    assert [tuple(box.upper) for box in read.keep_out] == [(1.0, 1.0, 1.0)]


def test_a_kept_arm_of_another_version_is_refused(tmp_path: Path) -> None:
    SavedArm(SAWYER).save(tmp_path / "arm.json")
    told = json.loads((tmp_path / "arm.json").read_text())
    for wrong in (told | {"schema": 99}, {key: told[key] for key in ("kind", "schema", "keep_out")}):
        (tmp_path / "arm.json").write_text(json.dumps(wrong))
        with pytest.raises(InputError):
            SavedArm.load(tmp_path / "arm.json")
