"""MuJoCo's cell served as machines, spoken to through their own protocols by Anther's drivers."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_ros_master import NO_ROSCORE, debian_roscore, has_roscore
from made_realsense import sdk
from served_cell import Plant, Served
from served_franka import NO_SERVER, has_server
from slow_clock import AGAIN_IF_HELD_UP
from small_planner import SmallPlanner

from anther.core.choices import ArmName
from anther.robot.cells import CellFile, read_cell
from anther.robot.cells.hardware import connect_cell
from anther.robot.devices import JointTrajectory, Robot

pytestmark = [AGAIN_IF_HELD_UP, pytest.mark.slow]
sys.path.append(str(Path(__file__).parents[1] / "support" / "cells"))


@contextmanager
def asked(arm: ArmName) -> Iterator[str]:
    """Give the address that an arm is asked for at; skip where what it needs is not installed."""
    if arm == "sawyer":
        if not has_roscore():
            pytest.skip(NO_ROSCORE)
        with debian_roscore() as master:
            yield master
    else:
        pytest.importorskip("pylibfranka", reason="no pylibfranka; run: pip install 'anther[franka]'")
        if not has_server():
            pytest.skip(NO_SERVER)
        yield f"127.0.1.{1 + os.getpid() % 250}"  # libfranka's port is always the same


@pytest.fixture(scope="module", params=["sawyer", pytest.param("fr3", marks=pytest.mark.long)])
def machines(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[Served, CellFile, Robot]]:
    sdk()
    over, arm = threading.Event(), request.param
    with (
        asked(arm) as address,
        closing(Served(Plant("tomato", 0, "nominal", arm), tmp_path_factory.mktemp("cell"), address, 0.2)) as served,
    ):

        def go_on() -> None:
            while not over.is_set():
                served.go_on()

        thread = threading.Thread(target=go_on, daemon=True)
        thread.start()
        file = read_cell(served.file)
        with connect_cell(file) as robot:
            yield served, file, robot
        over.set()
        thread.join()


def test_the_arm_goes_where_it_is_told(machines: tuple[Served, CellFile, Robot]) -> None:
    served, file, robot = machines
    begin = robot.arm.joints()
    record = robot.arm.follow(SmallPlanner(served.place.arm).move(begin, begin + 0.1))
    assert np.abs(served.place.joints - begin - 0.1).max() < 0.005
    lag = np.abs(record.commanded - record.measured).max()
    assert lag < file.safety_limits().tracking
    share = np.abs(served.place.log().torques).max(axis=0) / served.place.arm.effort
    assert share.max() < 0.6  # 0.5 is the motion's own: what the served controller makes of commands is no burden


def test_a_shake_goes_as_far_as_it_is_told(machines: tuple[Served, CellFile, Robot]) -> None:
    served, _, robot = machines
    t, omega, size, joint = np.arange(0, 1.5, 0.004), 2 * np.pi * 12.0, 1e-3, 5
    share = np.clip(np.minimum(t, t[-1] - t) / 0.3, 0, 1)
    share = share**2 * (3 - 2 * share)
    swing = np.outer(share * size * np.sin(omega * t), np.eye(7)[joint])
    begin = robot.arm.joints()
    before = served.place.time
    robot.arm.follow(JointTrajectory(t, begin + swing, np.gradient(swing, t, axis=0)))
    log = served.place.log()
    middle = (log.times > before + 0.5) & (log.times < before + 1.1)
    went = np.ptp(log.joints[middle, joint]) / 2
    assert went == pytest.approx(size, rel=0.1)


def test_the_pads_stand_as_far_apart_as_is_read(machines: tuple[Served, CellFile, Robot]) -> None:
    served, _, robot = machines
    for opening in (0.02, 0.0, 0.04):
        state = robot.gripper.move(opening)
        assert state.opening == pytest.approx(served.place.opening, abs=4e-4)  # a count is 0.38 mm
        assert state.opening == pytest.approx(opening, abs=1e-3)
        assert not state.is_gripping


def test_the_cameras_see_the_plant_where_it_is(machines: tuple[Served, CellFile, Robot]) -> None:
    served, file, robot = machines
    assert robot.side_camera is not None
    camera, T_world_cam = robot.side_camera.intrinsics, file.T_world_side_camera
    frame: Any = robot.side_camera.read()
    # the file counts from the arm's base, which stands on a mount
    mount = np.array([0, 0, file.model.shoulder[2] - served.place.arm.shoulder[2]])
    flowers = served.place.plant.flower_position + mount
    inside = np.linalg.inv(T_world_cam) @ np.column_stack([flowers, np.ones(len(flowers))]).T
    u, v = camera.fx * inside[0] / inside[2] + camera.cx, camera.fy * inside[1] / inside[2] + camera.cy
    seen = (u > 5) & (u < camera.width - 6) & (v > 5) & (v < camera.height - 6)
    assert seen.any()
    near = [
        np.abs(frame.depth[int(y) - 5 : int(y) + 6, int(x) - 5 : int(x) + 6] - z).min()
        for x, y, z in zip(u[seen], v[seen], inside[2][seen], strict=True)
    ]
    assert np.median(near) < 0.02


def test_a_recording_is_as_fast_as_the_camera_says(machines: tuple[Served, CellFile, Robot]) -> None:
    served, _, robot = machines
    assert robot.side_camera is not None
    rate = max(robot.side_camera.rates)
    robot.side_camera.start(rate)
    until = served.place.time + 0.5
    while served.place.time < until:
        time.sleep(0.05)
    times = [frame.time for frame in robot.side_camera.stop()]
    assert np.median(np.diff(times)) == pytest.approx(1 / rate, rel=0.2)
    assert rate == 30
