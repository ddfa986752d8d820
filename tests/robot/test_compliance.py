"""What an arm on springs does with its grip: rigid where it is slow or stiff, and as MuJoCo has it between."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from scipy.linalg import eigh

from anther.core.choices import ArmName
from anther.robot.arm import compliance
from anther.robot.arm.arms import find_arm
from anther.robot.arm.compliance import Drives, delivered, draw_drives, grip_motion
from anther.robot.arm.motions import inertia
from anther.robot.arm.sawyer import SAWYER
from anther.robot.cell import JOINT_SCATTER
from anther.sim import NOMINAL
from evaluation.trials.arm_readings import TONES, swings

ALONG = np.array([0.6, 0.8, 0.0])
NEAR_PLANT = SAWYER.waiting


def moved(hertz: float, deviate: float) -> np.ndarray:
    """Return (3,) what a swing of all motors alike does to the grip."""
    motors = np.full((1, SAWYER.count), 1e-3 + 0j)
    return grip_motion(SAWYER, NEAR_PLANT, motors, np.array([hertz]), np.array([deviate]))[0, 0]


def test_a_slow_swing_and_stiff_springs_leave_an_arm_rigid() -> None:
    rigid = moved(10.0, 20.0)
    held = SAWYER.tool.T_flange_grasp[:3, 3]
    ends = [SAWYER.forward(NEAR_PLANT + turn) for turn in (-1e-6, 1e-6)]
    there = (ends[1] - ends[0]) @ np.append(held, 1) / 2e-6
    assert rigid == pytest.approx(1e-3 * there[:3], rel=1e-3)
    assert moved(0.1, 0.0) == pytest.approx(rigid, rel=1e-3)
    assert np.linalg.norm(moved(10.0, 0.0) - rigid) > 0.3 * np.linalg.norm(rigid)


def test_springs_of_a_tenth_of_the_stiffness_have_modes_a_root_of_ten_lower() -> None:
    """The arm swings furthest at the lowest mode of its links on their springs."""
    mass, tenth = inertia(SAWYER, NEAR_PLANT), np.log(0.1) / compliance.STIFFNESS_SPREAD
    for deviate in (0.0, tenth):
        stiffness = compliance.STIFFNESS * np.exp(compliance.STIFFNESS_SPREAD * deviate) * SAWYER.stiffness
        mode = float(np.sqrt(eigh(np.diag(stiffness), mass, eigvals_only=True)[0]) / (2 * np.pi))
        tones = mode * np.linspace(0.5, 1.3, 81)
        sizes = [np.linalg.norm(moved(tone, deviate)) for tone in tones]
        assert tones[int(np.argmax(sizes))] == pytest.approx(mode, rel=0.03)
    assert np.all(np.linalg.eigvalsh(mass) > 0)


@pytest.mark.parametrize("name", get_args(ArmName))
def test_every_arm_delivers_all_of_a_slow_shake_and_little_of_a_fast_one(name: str) -> None:
    arm = find_arm(name)
    mean, spread = delivered(arm, np.asarray(arm.waiting), np.eye(3)[:2], np.array([0.3, 400.0]))
    assert mean.shape == spread.shape == (2, 2)
    assert mean[0] == pytest.approx(0.0, abs=0.05)
    assert np.all(mean[1] < -1.0)
    assert np.all(spread[0] < 0.05)


def test_drawn_drives_are_as_likely_as_is_believed() -> None:
    drives = draw_drives(7, 64)
    logs, fast = np.log(drives.stiffness / compliance.STIFFNESS), np.log(drives.bandwidth / compliance.BANDWIDTH)
    common, scatter = logs.mean(axis=1), JOINT_SCATTER * compliance.STIFFNESS_SPREAD
    assert common.std() == pytest.approx(np.hypot(compliance.STIFFNESS_SPREAD, scatter / np.sqrt(7)), rel=0.1)
    assert (logs - common[:, None]).std() == pytest.approx(scatter, rel=0.15)
    assert fast.std() == pytest.approx(compliance.BANDWIDTH_SPREAD, rel=0.05)
    assert abs(np.corrcoef(common, fast)[0, 1]) < 0.3
    assert drives.feedforward.std(axis=0) == pytest.approx(np.full(7, compliance.FEEDFORWARD_ERROR), rel=0.05)


@pytest.mark.parametrize("scatter", [0.0, 0.3])
def test_mujocos_arm_does_what_the_equations_say(monkeypatch: pytest.MonkeyPatch, scatter: float) -> None:
    """With its true springs, servos and torques; as stiff as it reads, it would be far off above 8 Hz."""
    truth = replace(NOMINAL, joint_stiffness=10.0, servo_bandwidth=7.0, joint_scatter=scatter)
    motors, grip = swings(truth, np.asarray(NEAR_PLANT), ALONG, seed=3)
    stiffness = 10.0 * np.exp(scatter * np.random.default_rng([3, 9]).normal(size=7))
    true = np.log(stiffness / compliance.STIFFNESS) / compliance.STIFFNESS_SPREAD
    known, rigid = grip_motion(SAWYER, NEAR_PLANT, motors, TONES, np.stack([true, np.full(7, 20.0)]))
    slow = TONES < 15
    off = [np.linalg.norm(said - grip, axis=1) / np.linalg.norm(grip, axis=1) for said in (known, rigid)]
    assert off[0][slow].max() < 0.15, "the springs are damped by their inertia elsewhere"
    assert off[1][(TONES > 8) & slow].min() > 0.3
    monkeypatch.setattr(
        compliance, "draw_drives", lambda count: Drives(stiffness[None], np.array([7.0]), np.ones((1, count)))
    )
    mean, spread = delivered(SAWYER, NEAR_PLANT, ALONG[None], TONES)
    assert np.log(np.abs(grip @ ALONG))[slow] == pytest.approx(mean[slow, 0], abs=0.15)
    assert spread == pytest.approx(0.0)
