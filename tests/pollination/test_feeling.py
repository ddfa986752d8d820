"""What an arm's own record tells of a shake: how the gripper truly moved, and the force in the grip."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fake_robot import horizontal_grasp

from anther.core.geometry import Array
from anther.pollination.execution import Trial
from anther.pollination.learning import measure_grip
from anther.pollination.shake.params import FAST

F, START = 6.0, 41.3
GRIP = np.array([0.02, 0.0, 0.1])
"""Where the stem is held, in the flange's frame."""
PLAN: Any = SimpleNamespace(
    direction=np.array([0.6, 0.8, 0.0]),
    amplitude=2e-3,
    frequency=F,
    grasp=replace(horizontal_grasp(GRIP, np.zeros(7)), T_world_flange=np.eye(4)),
)


def forward(joints: Array) -> Array:
    """An arm whose first joints are its flange's place, the fourth its turn about x."""
    poses = np.tile(np.eye(4), (len(joints), 1, 1))
    poses[:, :3, 3] = joints[:, :3]
    c, s = np.cos(joints[:, 3]), np.sin(joints[:, 3])
    poses[:, 1, 1], poses[:, 1, 2], poses[:, 2, 1], poses[:, 2, 2] = c, -s, s, c
    return poses


def trial(force: Any, constant: Any, *, size: float = 1.5e-3, late: float = 0.01, noise: float = 0.0) -> Trial:
    """A shake of 3 s that begins 0.2 s after the motion, smaller and later than commanded; force is ahead of it."""
    times = START + np.arange(0, 3.2, 1e-3)
    grip = np.where(times > START + 0.2, np.sin(2 * np.pi * F * (times - START - late)), 0.0)
    measured = np.zeros((len(times), 7))
    measured[:, :3] = size * grip[:, None] * PLAN.direction
    when = times[::10]
    turning = np.exp(2j * np.pi * F * (when - START - late))
    felt = np.linalg.norm(constant + np.imag(turning[:, None] * np.asarray(force)), axis=1)
    felt = felt + noise * np.random.default_rng(3).normal(size=len(felt))
    none: Any = np.zeros((0, 3))
    return Trial(
        ("shake",), np.array([[times[0], times[-1]]]), times, 0 * measured, measured, none, np.zeros(0), "finished",
        felt=np.column_stack([when, felt]),
    )  # fmt: skip


@pytest.mark.parametrize("constant", [0.0, 0.05, 3.0])
def test_the_force_of_the_motion_is_told_whatever_pulls_constantly(constant: float) -> None:
    force = 0.4 * np.exp(0.7j) * np.array([0.6, 0.8, 0.1])
    found = measure_grip(trial(force, np.array([0.0, constant, 0.2])), PLAN, forward)
    assert found.amplitude == pytest.approx(1.5e-3, rel=1e-3)
    assert np.sin(2 * np.pi * F * (START + 0.01 - found.start)) == pytest.approx(0, abs=1e-6)
    assert found.force == pytest.approx(abs(np.sum(force**2)) ** 0.5, rel=1e-3)
    assert np.sin(found.force_phase - 0.7) == pytest.approx(0, abs=1e-2)  # up to half a turn


def test_a_force_that_goes_round_tells_what_is_left_of_it_and_noise_its_error() -> None:
    force = np.array([0.5, 0.3j, 0.0])
    found = measure_grip(trial(force, np.zeros(3), noise=0.02), PLAN, forward)
    assert found.force == pytest.approx(0.4, abs=4 * found.force_std)
    assert 1e-4 < found.force_std < 0.02


def test_what_is_not_known_is_not_told() -> None:
    weak = measure_grip(trial(np.array([1e-3, 0, 0]), np.array([1.0, 0, 0]), noise=0.05), PLAN, forward)
    assert np.isnan([weak.force, weak.force_std, weak.force_phase]).all()
    assert weak.amplitude > 1e-3
    done = trial(np.array([0.4, 0, 0]), np.zeros(3))
    deaf = measure_grip(replace(done, felt=done.felt * [1, np.nan]), PLAN, forward)
    assert np.isnan(deaf.force)
    short = replace(done, shake_times=done.shake_times[:9], measured=done.measured[:9], commanded=done.commanded[:9])
    assert np.isnan(measure_grip(short, PLAN, forward).amplitude)
    assert np.isfinite(measure_grip(done, PLAN, forward).amplitude)
    fast = SimpleNamespace(**vars(PLAN) | {"frequency": FAST + 0.1})
    assert np.isnan(measure_grip(done, fast, forward).amplitude), (
        "an arm reads its motors, not its links, nor a motor in the gripper"
    )


def test_the_grip_moves_as_the_flange_and_turns_with_it() -> None:
    done = trial(np.zeros(3), np.zeros(3))
    turned = done.measured.copy()
    turned[:, 3] = 0.01 * np.sin(2 * np.pi * F * (done.shake_times - START - 0.01))
    found = measure_grip(replace(done, measured=turned), PLAN, forward)
    assert found.amplitude == pytest.approx(1.5e-3 - 0.01 * GRIP[2] * PLAN.direction[1], rel=2e-3)
