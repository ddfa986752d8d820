"""What a truth changes in what the cameras of the simulated cell give."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from straight_plant import BASE, straight_plant, with_blade

from anther.cli import trial
from anther.cli.args.trial import Args
from anther.core.geometry import Intrinsics, inverse, look_at, transform_points
from anther.pollination import Params
from anther.robot.arm.sawyer import SAWYER
from anther.robot.devices import Frame
from anther.sim import simulated_cell
from anther.sim.capture import CameraErrors, camera_errors, noisy_rgb
from anther.sim.cell import Cell
from anther.sim.render import Scene
from anther.sim.robot import SimCamera, robot_of
from anther.sim.truth import NOMINAL, Truth, draw

CAMERA = Intrinsics(200, 160, 600.0, 600.0, 99.5, 79.5)
LEAF = np.add(BASE, [0.0, 0.05, 0.45])
PLANT = with_blade(straight_plant(), LEAF, [0.0, 1.0, 0.1], segment=17)
POSE = look_at(LEAF - [0.0, 0.5, 0.0], LEAF)


def filmed(*, bent: float = 0.04, late: float = 0.0, exposure: float = 0.0) -> tuple[Cell, list[Frame]]:
    """Film a leaf that swings, after its stem was bent by so many radians at two hinges."""
    cell = Cell(PLANT)
    camera = SimCamera(cell, Scene.of_plant(PLANT), CAMERA, lambda: POSE, errors=None, late=late, exposure=exposure)
    cell.data.qpos[cell.model.jnt_qposadr[cell.mechanics.joints[:2]]] += bent
    idle = np.tile(cell.arm_command, (200, 1)), np.zeros((200, 7)), np.full(200, cell.grip_command)
    cell.run(*idle)
    camera.start(30.0)
    cell.run(*idle)
    return cell, camera.stop()


def test_frames_of_a_late_clock_show_what_was_before_their_time() -> None:
    late = 0.028
    cell, frames = filmed(late=late)
    log = cell.log()
    assert [f.time for f in frames] == pytest.approx([f.time for f in filmed()[1]], abs=0.002)
    seen, then, now = [], [], []
    for frame in frames:
        points = CAMERA.back_project(frame.depth, (frame.depth > 0.3) & (frame.depth < 0.6))
        seen.append(transform_points(POSE, points).mean(axis=0))
        for out, time in ((then, frame.time - late), (now, frame.time)):
            sample = int(np.argmin(np.abs(log.times - time)))
            out.append((cell.segment_poses(log.qpos[sample])[17] @ [*LEAF, 1])[:3])
    np.testing.assert_allclose(seen, then, atol=0.0012)  # a pixel is 0.8 mm wide
    assert np.abs(np.subtract(seen, now)).max() > 0.003


def test_a_long_exposure_blurs_what_moves_and_leaves_depth_alone() -> None:
    sharp = filmed()[1]
    changed, contrast = [], []
    for exposure in (0.004, 0.012, 0.02):
        frames = filmed(exposure=exposure)[1]
        np.testing.assert_array_equal([f.depth for f in frames], [f.depth for f in sharp])
        changed.append(sum(np.any(a.rgb != b.rgb, axis=2).sum() for a, b in zip(sharp, frames, strict=True)))
        contrast.append(np.abs(np.diff(np.array([f.rgb for f in frames], dtype=int), axis=2)).sum())
    assert changed[2] > 1.5 * changed[0] > 0
    assert contrast == sorted(contrast, reverse=True)


def test_a_still_plant_is_not_blurred() -> None:
    for a, b in zip(filmed(bent=0.0)[1], filmed(bent=0.0, exposure=0.012)[1], strict=True):
        np.testing.assert_array_equal(a.rgb, b.rgb)


def test_the_side_camera_of_a_cell_has_its_truth_s_clock() -> None:
    late = replace(NOMINAL, clock_offset=0.02)
    robots = [robot_of(Cell(PLANT, truth=truth)) for truth in (NOMINAL, late)]
    sides, wrists = [r.side_camera for r in robots], [r.wrist_camera for r in robots]
    times = [camera.read().time for camera in sides if camera is not None]
    assert times == pytest.approx([0.0, 0.02])
    assert [camera.read().time for camera in wrists] == [0.0, 0.0]


def test_nominal_camera_errors_are_the_usual_ones_and_the_truth_scales_those_of_the_poses() -> None:
    usual, wide = camera_errors(NOMINAL), camera_errors(replace(NOMINAL, pose_error=3.0, exposure_spread=0.2))
    assert usual == CameraErrors()
    assert wide.pose_rotation == pytest.approx(3 * usual.pose_rotation)
    assert wide.pose_translation == pytest.approx(3 * usual.pose_translation)
    assert wide == replace(wide, depth=usual.depth, read_noise=usual.read_noise, exposure=0.2)


def test_gains_spread_as_widely_as_the_truth_says() -> None:
    errors = CameraErrors(exposure=0.2, white_balance=0, read_noise=0, shot_noise=0, blur=0)
    rng, grey = np.random.default_rng(0), np.full((2, 2, 3), 100, np.uint8)
    gains = [noisy_rgb(grey, rng, errors).mean() / 100 for _ in range(600)]
    assert np.std(gains) == pytest.approx(0.2, rel=0.1)


@pytest.mark.parametrize("factor", [0.0, 1.0, 2.5])
def test_the_hand_eye_error_of_a_photograph_scales_with_the_truth(factor: float) -> None:
    truth = replace(NOMINAL, pose_error=0.0, hand_eye_error=factor)
    capture, true = simulated_cell.photograph(Scene.of_plant(PLANT), SAWYER.ready[None], 3, truth=truth)
    error = inverse(capture.T_world_cam[0]) @ true.T_world_cam[0]
    assert np.degrees(Rotation.from_matrix(error[:3, :3]).magnitude()) == pytest.approx(0.2 * factor, abs=1e-6)
    assert np.linalg.norm(error[:3, 3]) == pytest.approx(0.001 * factor, abs=1e-9)


def test_a_trial_of_the_wide_truth_draws_it_from_the_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    built: list[Truth] = []

    def build(*_: Any, truth: Truth, **__: Any) -> None:
        built.append(truth)

    monkeypatch.setattr(simulated_cell, "build", build)
    for seed, truth in ((4, "nominal"), (4, "wide"), (5, "wide")):
        trial._build(Args(seed=seed, truth=truth, params=Params()))
    assert built == [NOMINAL, draw(4), draw(5)]
