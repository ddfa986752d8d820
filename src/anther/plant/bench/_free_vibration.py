"""Frequency and damping ratio of a plucked stem from its decaying motion (P22). T time samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from anther.core.checks import check_array
from anther.core.errors import bad_input
from anther.core.geometry import Array


@dataclass(frozen=True, slots=True)
class FreeVibration:
    """A decaying oscillation.

    Attributes:
        frequency: damped natural frequency [Hz].
        damping_ratio: share of critical damping [-].
        frequency_error, damping_error: standard errors; infinite where the quantity was not measured.
        explained: share of the variance that the fit accounts for while it decays to a tenth, or for five periods if
            that is longer [-].
    """

    frequency: float
    damping_ratio: float
    frequency_error: float
    damping_error: float
    explained: float = 1.0

    @property
    def natural_frequency(self) -> float:
        """Frequency without damping [Hz], f / sqrt(1 - zeta^2): the one that follows from stiffness and mass."""
        return self.frequency / float(np.sqrt(1 - self.damping_ratio**2))


def fit_free_vibration(times: ArrayLike, displacement: ArrayLike) -> FreeVibration:
    """Fit offset + exp(-z w t) (a cos w_d t + b sin w_d t), w_d = w sqrt(1 - z^2), to a plucked stem's motion.

    Least squares from the strongest line of the spectrum. The standard errors are those of the fit with white
    residuals; where the residuals are stronger around the mode's frequency than elsewhere (0.5 f to 1.5 f, in power),
    the errors grow by the root of that ratio, because only noise near the frequency can pass for the mode.

    Args:
        times: (T,) increasing [s]; at least two periods.
        displacement: (T,) along one axis [m].

    Raises:
        InputError: fewer than 16 samples, times not increasing, or no oscillation.
    """
    t = check_array("times", times, (None,))
    x = check_array("displacement", displacement, (len(t),))
    if len(t) < 16 or np.any(np.diff(t) <= 0):
        raise bad_input("times", given=f"{len(t)} samples", allowed="16 or more, increasing", do="Record longer.")
    scale = float(np.std(x))
    if scale == 0:
        raise bad_input("displacement", given="no motion", allowed="an oscillation", do="Pluck the stem.")
    start = _strongest_line(t, x)

    def residual(p: Array) -> Array:
        basis = _decaying_basis(t, p)
        return basis @ np.linalg.lstsq(basis, x / scale, rcond=None)[0] - x / scale

    bounds = ([0.2 * start, -0.2], [5 * start, 0.95])
    trials = [least_squares(residual, [start, z], bounds=bounds) for z in (0.01, 0.05, 0.2)]
    fit = min(trials, key=lambda trial: trial.cost)
    errors = _standard_errors(fit, t, x / scale)
    frequency, ratio = (float(value) for value in fit.x)
    decay = max(ratio, 1e-9) / np.sqrt(1 - ratio**2) * 2 * np.pi * frequency
    loud = t - t[0] <= max(np.log(10) / decay, 5 / frequency)
    swing = (x / scale)[loud]
    left = float(np.sum(fit.fun[loud] ** 2) / max(np.sum((swing - swing.mean()) ** 2), 1e-300))
    return FreeVibration(frequency, ratio, float(errors[0]), float(errors[1]), 1 - left)


def fitted_motion(fit: FreeVibration, times: ArrayLike, displacement: ArrayLike, at: ArrayLike | None = None) -> Array:
    """Return the fitted motion [m] at the times of the measured one (T,) [s], or at other times (n,) of that record."""
    t, x = np.asarray(times, dtype=np.float64), np.asarray(displacement, dtype=np.float64)
    p = np.array([fit.frequency, fit.damping_ratio])
    weights = np.linalg.lstsq(_decaying_basis(t, p), x, rcond=None)[0]
    wanted = t if at is None else np.asarray(at, dtype=np.float64)
    return _decaying_basis(wanted, p, t[0]) @ weights


def mean_vibration(fits: Sequence[FreeVibration]) -> FreeVibration:
    """Return the inverse-variance mean of several plucks of one stem.

    Its errors are the larger of the fits' own errors and the scatter between the plucks (the fits' error
    times the Birge ratio: Birge, Phys. Rev. 40, 207, 1932). `explained` is the least of the plucks.
    """
    if len(fits) == 1:
        return fits[0]
    frequency, frequency_error = _weighted_mean([(f.frequency, f.frequency_error) for f in fits])
    ratio, damping_error = _weighted_mean([(f.damping_ratio, f.damping_error) for f in fits])
    return FreeVibration(frequency, ratio, frequency_error, damping_error, min(f.explained for f in fits))


def _weighted_mean(values: list[tuple[float, float]]) -> tuple[float, float]:
    value, error = np.array(values).T
    weight = 1 / np.maximum(error, 1e-12) ** 2
    mean = float(weight @ value / weight.sum())
    birge = float(np.sqrt(weight @ (value - mean) ** 2 / max(len(value) - 1, 1)))
    return mean, max(1.0, birge) / float(np.sqrt(weight.sum()))


def _decaying_basis(t: Array, p: Array, start: float | None = None) -> Array:
    """Return (T, 3): the two quadratures of a mode with p = (damped frequency [Hz], damping ratio), and 1."""
    w_d, z = 2 * np.pi * p[0], p[1]
    decay = np.exp(-z / np.sqrt(1 - z * z) * w_d * (t - (t[0] if start is None else start)))
    return np.stack([decay * np.cos(w_d * t), decay * np.sin(w_d * t), np.ones_like(t)], axis=1)


def _standard_errors(fit: Any, t: Array, x: Array) -> Array:
    """Return the standard errors of frequency and damping ratio from the Jacobian of the full five-parameter model."""
    basis = _decaying_basis(t, fit.x)
    weights = np.linalg.lstsq(basis, x, rcond=None)[0]
    slopes = []
    for k, step in enumerate((1e-6 * fit.x[0], 1e-6)):
        moved = fit.x.copy()
        moved[k] += step
        slopes.append((_decaying_basis(t, moved) - basis) @ weights / step)
    J = np.column_stack([*slopes, basis])
    variance = float(np.sum(fit.fun**2)) / max(len(t) - 5, 1)
    variance *= max(1.0, _colour(t, fit.fun, float(fit.x[0])))
    return np.sqrt(np.diag(np.linalg.pinv(J.T @ J))[:2] * variance)


def _colour(t: Array, residual: Array, frequency: float) -> float:
    """Return the mean power of the residual between 0.5 f and 1.5 f over its mean power at all frequencies."""
    even = np.linspace(t[0], t[-1], len(t))
    power = np.abs(np.fft.rfft(np.interp(even, t, residual)))[1:] ** 2
    lines = np.fft.rfftfreq(len(t), even[1] - even[0])[1:]
    near = (lines > 0.5 * frequency) & (lines < 1.5 * frequency)
    total = float(power.mean())
    return float(power[near].mean()) / total if near.any() and total > 0 else 1.0


def _strongest_line(t: Array, x: Array) -> float:
    """Return the frequency [Hz] of the strongest line of the spectrum, refined by zero padding."""
    even = np.linspace(t[0], t[-1], len(t))
    y = np.interp(even, t, x)
    y = (y - y.mean()) * np.hanning(2 * len(y))[len(y) :]  # full weight at the start, where the motion is
    spectrum = np.abs(np.fft.rfft(y, 8 * len(y)))
    lines = np.fft.rfftfreq(8 * len(y), even[1] - even[0])
    return float(lines[1 + int(np.argmax(spectrum[1:]))])
