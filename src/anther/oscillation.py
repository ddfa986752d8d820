"""How large and how fast something swings: a sinusoid fitted to a sampled path. T samples.

The fit x(t) = slow(t) + a cos(2 pi f t) + b sin(2 pi f t) is linear least squares at a known frequency (lock-in), with
slow(t) a Legendre series that wriggles up to half the frequency: it takes up the free sway of a plant that was just
touched. The fit needs no even sampling, and no sampling above twice the frequency: a shake of known frequency can be
measured with a slower camera as long as f is not close to a multiple of rate/2, where cosine and sine cannot be told
apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from anther.checks import check_array, check_range
from anther.errors import bad_input
from anther.geometry import Array


@dataclass(frozen=True, slots=True, eq=False)
class Swing:
    """A sinusoidal motion in space: an ellipse.

    Attributes:
        amplitude: the ellipse's semi-major axis [m].
        amplitude_std: its standard deviation, from the residual along that axis [m].
        axis_std: (3,) standard deviation of the amplitude along x, y and z, from the residual along each [m].
        direction: (3,) unit vector along that axis, its largest component positive.
        frequency: [Hz].
        residual: root mean square distance of the samples from the fit, per axis [m].
        coefficients: (2 + slow terms, 3) of the fit: a, b, then the Legendre series.
        span: (start, end) of the samples [s], the series' interval.
    """

    amplitude: float
    amplitude_std: float
    axis_std: Array
    direction: Array
    frequency: float
    residual: float
    coefficients: Array
    span: tuple[float, float]

    @property
    def phase(self) -> float:
        """Phase p of the swing along `direction` [rad]: sin(2 pi f t + p), t on the clock of the samples."""
        a, b = self.coefficients[:2] @ self.direction
        return float(np.mod(np.pi / 2 - np.arctan2(b, a) - 2 * np.pi * self.frequency * self.span[0], 2 * np.pi))

    def at(self, times: Array) -> Array:
        """Return the fitted path (T, 3) [m] at `times` (T,) [s]."""
        return _basis(times, self.span, self.frequency, len(self.coefficients) - 2) @ self.coefficients


def fit_swing(times: Array, path: Array, frequency: float) -> Swing:
    """Fit a swing of known frequency.

    Args:
        times: (T,) [s].
        path: (T, 3) [m]; rows with NaN are left out.
        frequency: [Hz].

    Raises:
        InputError: fewer than 8 samples, or samples that cannot tell cosine from sine at this frequency.
    """
    times, path = check_array("times", times, (None,)), check_array("path", path, (len(times), 3), finite=False)
    check_range("frequency", frequency, 1e-3, 1e4, "Hz")
    seen = np.isfinite(path).all(axis=1)
    if seen.sum() < 8:
        raise bad_input("swing", given=f"{seen.sum()} samples", allowed="8 or more", do="Record longer.")
    t, x = times[seen], path[seen]
    basis = swing_basis(t, frequency)
    # normal equations: a decomposition of the basis would wake BLAS threads, which cost more than the work
    gram = np.einsum("ti,tj->ij", basis, basis)
    # how much larger the variance of a and b is than with evenly spread phases
    loss = np.inf if np.linalg.cond(gram) > 1e10 else len(t) / 2 * np.diag(np.linalg.inv(gram))[:2].max()
    if loss > 100:
        raise bad_input(
            "swing",
            given=f"{len(t)} samples over {np.ptp(t):.2f} s",
            allowed=f"samples that tell the phase at {frequency:g} Hz",
            do="Choose a frame rate that is not twice the frequency divided by a whole number, or record longer.",
        )
    coefficients: Array = np.linalg.solve(gram, np.einsum("ti,tk->ik", basis, x)).astype(np.float64)
    misses = np.sum((x - basis @ coefficients) ** 2, axis=0) / max(len(t) - basis.shape[1], 1)
    axis_std = np.sqrt(misses * np.diag(np.linalg.inv(gram))[:2].max())
    _, size, axes = np.linalg.svd(coefficients[:2])
    return Swing(
        amplitude=float(size[0]),
        amplitude_std=float(np.linalg.norm(axes[0] * axis_std)),
        axis_std=axis_std,
        direction=axes[0] * np.sign(axes[0][np.argmax(np.abs(axes[0]))]),
        frequency=float(frequency),
        residual=float(np.sqrt(misses.mean())),
        coefficients=coefficients,
        span=(float(t[0]), float(t[-1])),
    )


def swing_basis(times: Array, frequency: float) -> Array:
    """Return (T, 2 + slow terms) what `fit_swing` fits to samples at `times` (T,): cosine, sine, Legendre series."""
    return _basis(times, (float(times[0]), float(times[-1])), frequency, _slow_terms(times, frequency))


def find_frequency(times: Array, path: Array, hint: float, *, width: float = 0.1) -> float:
    """Return the frequency [Hz] within `hint` x (1 +- width) whose swing fits a path (T, 3) over times (T,) best."""
    seen = np.isfinite(path).all(axis=1)
    t, x = times[seen], path[seen]
    span, slow = (float(t[0]), float(t[-1])), _slow_terms(t, hint)

    def misfit(f: float) -> float:
        basis = _basis(t, span, f, slow)
        along = np.einsum("ti,tk->ik", basis, x)
        return -float(np.sum(along * np.linalg.solve(np.einsum("ti,tj->ij", basis, basis), along)))

    # the misfit's valley is about 1 / (record length) wide
    step = min(0.25 / max(float(np.ptp(t)), 1e-3), width * hint / 2)
    grid = np.arange(hint * (1 - width), hint * (1 + width) + step, step)
    best = grid[int(np.argmin([misfit(f) for f in grid]))]
    found: Any = minimize_scalar(misfit, bounds=(best - step, best + step), method="bounded")
    return float(found.x)


def alias(frequency: float, rate: float) -> float:
    """Return the frequency [Hz], between 0 and rate/2, at which `frequency` [Hz] shows up at a sampling `rate` [Hz]."""
    return abs(frequency - rate * round(frequency / rate))


def choose_rate(frequency: float, rates: Sequence[float]) -> float:
    """Return the camera rate [Hz] to record a shake of `frequency` [Hz] with.

    At f = rate/2 or a multiple a sampled sinusoid's phase and amplitude are lost. The slowest rate of eight or more
    frames a period is taken; if there is none, the one whose aliased frequency lies nearest to rate/4, in the middle.
    """
    ample = [r for r in rates if r >= 8 * frequency]
    return min(ample) if ample else min(rates, key=lambda r: abs(alias(frequency, r) / r - 0.25))


def _slow_terms(t: Array, frequency: float) -> int:
    """How many Legendre polynomials have fewer zeros over the record than half the frequency that shows up."""
    shown = alias(frequency, 1 / float(np.median(np.diff(t))))
    return 2 + int(min(np.ptp(t) * shown, len(t) / 4))


def _basis(t: Array, span: tuple[float, float], frequency: float, slow: int) -> Array:
    phase = 2 * np.pi * frequency * (t - span[0])
    along = 2 * (t - span[0]) / max(span[1] - span[0], 1e-9) - 1
    slow_part: Array = np.polynomial.legendre.legvander(along, slow - 1).astype(np.float64)
    return np.column_stack([np.cos(phase), np.sin(phase), slow_part])
