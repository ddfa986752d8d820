"""What an arm's own record tells of a shake: how the gripper truly moved, and the force in the grip."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from anther.core.geometry import Array, ComplexArray
from anther.pollination.escalation import JointBelief
from anther.pollination.escalation._knowledge import STIFFNESS_DEVIATES
from anther.pollination.execution import Trial
from anther.pollination.learning import measure_grip

F, START = 6.0, 41.3
PLAN: Any = SimpleNamespace(
    direction=np.array([0.6, 0.8, 0.0]),
    amplitude=2e-3,
    frequency=F,
)


def grip(motors: ComplexArray, frequencies: Array, deviates: Array) -> ComplexArray:
    """An arm whose first joints are its grip's place; the stiffer, the less it overshoots, and the less it is late."""
    assert len(motors) == len(frequencies)
    stiffer = deviates.reshape(len(deviates), -1).mean(axis=1)[:, None, None]
    return np.asarray(np.exp(-(0.5 + 0.2j) * (stiffer - 1.0)) * motors[None, :, :3])


def known(deviate: float) -> JointBelief:
    """What is believed when the joints' stiffness is known."""
    return JointBelief(grip, -0.5 * ((STIFFNESS_DEVIATES - deviate) / 0.01) ** 2)


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
    found = measure_grip(trial(force, np.array([0.0, constant, 0.2])), PLAN, known(1.0))
    assert found.amplitude == pytest.approx(1.5e-3, rel=0.03)
    assert np.sin(2 * np.pi * F * (START + 0.01 - found.start)) == pytest.approx(0, abs=0.03)
    assert found.force == pytest.approx(abs(np.sum(force**2)) ** 0.5, rel=1e-3)
    assert np.sin(found.force_phase - 0.7) == pytest.approx(0, abs=0.04)  # up to half a turn


def test_a_force_that_goes_round_tells_what_is_left_of_it_and_noise_its_error() -> None:
    force = np.array([0.5, 0.3j, 0.0])
    found = measure_grip(trial(force, np.zeros(3), noise=0.02), PLAN, known(1.0))
    assert found.force == pytest.approx(0.4, abs=4 * found.force_std)
    assert 1e-4 < found.force_std < 0.02


def test_what_is_not_known_is_not_told() -> None:
    weak = measure_grip(trial(np.array([1e-3, 0, 0]), np.array([1.0, 0, 0]), noise=0.05), PLAN, known(1.0))
    assert np.isnan([weak.force, weak.force_std, weak.force_phase]).all()
    assert weak.amplitude > 1e-3
    done = trial(np.array([0.4, 0, 0]), np.zeros(3))
    deaf = measure_grip(replace(done, felt=done.felt * [1, np.nan]), PLAN, known(1.0))
    assert np.isnan(deaf.force)
    short = replace(done, shake_times=done.shake_times[:9], measured=done.measured[:9], commanded=done.commanded[:9])
    assert np.isnan(measure_grip(short, PLAN, known(1.0)).amplitude)
    assert np.isfinite(measure_grip(done, PLAN, known(1.0)).amplitude)


def test_of_a_phase_that_joints_leave_open_nothing_is_told_but_the_amplitude() -> None:
    def late(motors: ComplexArray, _: Array, deviates: Array) -> ComplexArray:
        return np.asarray(np.exp(1j * deviates.mean(axis=1))[:, None, None] * motors[None, :, :3])

    found = measure_grip(trial(np.array([0.4, 0, 0]), np.zeros(3)), PLAN, JointBelief(late))
    assert found.amplitude == pytest.approx(1.5e-3, rel=1e-3)
    assert np.isnan([found.start, found.force, found.force_phase]).all()


@pytest.mark.parametrize("deviate", [-1.0, 0.0, 2.0])
def test_the_grip_moves_as_stiff_joints_let_it(deviate: float) -> None:
    found = measure_grip(trial(np.zeros(3), np.zeros(3)), PLAN, known(deviate))
    assert found.amplitude == pytest.approx(1.5e-3 * np.exp(-0.5 * (deviate - 1)), rel=0.05)
    behind = np.exp(2j * np.pi * F * (found.start - START - 0.01))
    assert np.angle(behind) == pytest.approx(0.2 * (deviate - 1), abs=0.03)
