"""What the arm did and felt in a shake, from a trial's record. T readings of the joints, R of the force."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from anther.errors import InputError
from anther.execution import Trial
from anther.geometry import Array
from anther.identification.observed import NOTHING_FELT, Felt
from anther.oscillation import fit_swing
from anther.vibration import ShakePlan

STEADY = (0.3, 0.9)
"""Share of a shake between which it is steady: it has begun and its free vibrations have faded, and it goes on."""

LEAST = 16
"""Readings without which nothing is said."""

SIGNIFICANCE = 3.0
"""A force below so many standard deviations is not told."""


def feel(trial: Trial, shake: ShakePlan, forward: Callable[[Array], Array]) -> Felt:
    """Return what the arm did and felt.

    The gripper's motion follows from the measured joints. Of the force an arm tells the size alone, in which the stem's
    constant pull is mixed. But of its square, |F0 + Im(F exp(i w t))|^2, only the motion's force F has a part at twice
    the frequency, -Re(F . F exp(2 i w t)) / 2: from it F . F follows, whatever F0.

    Args:
        trial: that has shaken.
        shake: what it was to do.
        forward: joints (T, J) [rad] -> flange poses (T, 4, 4) in the world.
    """
    moving = _steady(trial.shake_times, trial)
    times, joints = trial.shake_times[moving], trial.measured[moving]
    if len(times) < LEAST:
        return NOTHING_FELT
    try:
        swing = fit_swing(times, shake.grasp.carried(forward)(joints), shake.frequency)
    except InputError:
        return NOTHING_FELT
    omega = 2 * np.pi * shake.frequency
    cosine, sine = swing.coefficients[:2] @ shake.direction
    motion = (sine + 1j * cosine) * np.exp(-1j * omega * swing.span[0])
    moved, began = float(abs(motion)), float(-np.angle(motion) / omega)
    return Felt(moved, began, *_force(trial, omega, began))


def _steady(times: Array, trial: Trial) -> slice:
    begin, end = trial.steady
    shares = (0.0, 1.0) if trial.steps else STEADY
    return slice(*np.searchsorted(times, [begin + share * (end - begin) for share in shares]))


def _force(trial: Trial, omega: float, began: float) -> tuple[float, float, float]:
    """Return the force at the shake's frequency [N], its standard deviation, and by what it is ahead [rad]."""
    nothing = float("nan"), float("nan"), float("nan")
    rows = trial.felt[_steady(trial.felt[:, 0], trial)]
    if len(rows) < LEAST or not np.isfinite(rows).all():
        return nothing
    times, square = rows[:, 0] - began, rows[:, 1] ** 2
    angle, drift = omega * times, (times - times.mean()) / np.ptp(times)
    basis = np.column_stack([np.ones_like(times), drift, *(f(k * angle) for k in (1, 2) for f in (np.cos, np.sin))])
    gram = basis.T @ basis
    if np.linalg.cond(gram) > 1e4:  # a reading so often a period that its harmonics look alike
        return nothing
    parts = np.linalg.solve(gram, basis.T @ square)
    noise = np.sqrt(np.sum((square - basis @ parts) ** 2) / (len(times) - len(parts)) * np.linalg.inv(gram)[4, 4])
    twice = complex(-2 * parts[4], 2 * parts[5])  # F . F
    if abs(twice) <= SIGNIFICANCE * 2 * noise:
        return nothing
    size = float(np.sqrt(abs(twice)))
    return size, float(noise / size), float(np.angle(twice) / 2)
