"""How large and how fast something swings: a sinusoid fitted to a sampled path. T samples.

The fit x(t) = slow(t) + a cos(2 pi f t) + b sin(2 pi f t) is linear least squares at a known frequency (lock-in), with
slow(t) a Legendre series that wriggles up to half the frequency: it takes up the free sway of a plant that was just
touched. What swings far is no sine: overtones, sines of 2, 3, ... times the frequency, may be fitted beside it. The fit
needs no even sampling, and no sampling above twice the frequency: a shake of known frequency can be measured with a
slower camera as long as f is not close to a multiple of rate/2, where cosine and sine cannot be told apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from anther.core.checks import check_array, check_range
from anther.core.errors import bad_input
from anther.core.geometry import Array

MUCH_ALIKE = 3.0
"""Overtones are fitted where no variance is more than so many times what it is with evenly spread phases."""


@dataclass(frozen=True, slots=True, eq=False)
class Oscillation:
    """A sinusoidal motion in space: an ellipse.

    Attributes:
        amplitude: the ellipse's semi-major axis [m].
        amplitude_std: its standard deviation, from the residual along that axis [m].
        axis_std: (D,) standard deviation of the amplitude along each axis of the path, from the residual along it [m].
        direction: (D,) unit vector along that axis, its largest component positive.
        frequency: [Hz].
        coefficients: (2 + 2 H + slow terms, D) of the fit: a, b, those of the overtones, then the Legendre series.
        span: (start, end) of the samples [s], the series' interval.
        overtones: H, how many were fitted.
    """

    amplitude: float
    amplitude_std: float
    axis_std: Array
    direction: Array
    frequency: float
    coefficients: Array
    span: tuple[float, float]
    overtones: int = 0

    def acceleration(self, least: float = 0.0, axes: int = 3) -> float:
        """Return its largest in a period [m/s2].

        Args:
            least: overtones of less do not count [m].
            axes: nor do they along others than the first so many.
        """
        omega2 = (2 * np.pi * self.frequency) ** 2
        waves = self.coefficients[: 2 + 2 * self.overtones].reshape(1 + self.overtones, 2, -1)
        phasors = np.asarray(np.array([1j, 1]) @ waves, dtype=np.complex128)
        over = phasors[1:]
        over[:, axes:] = 0
        over[np.linalg.norm(over, axis=1) < least] = 0
        return float(omega2 * (peak(phasors) if over.any() else self.amplitude))

    @property
    def phase(self) -> float:
        """Phase p of the swing along `direction` [rad]: sin(2 pi f t + p), t on the clock of the samples."""
        a, b = self.coefficients[:2] @ self.direction
        return float(np.mod(np.pi / 2 - np.arctan2(b, a) - 2 * np.pi * self.frequency * self.span[0], 2 * np.pi))

    def at(self, times: Array) -> Array:
        """Return the fitted path (T, D) [m] at `times` (T,) [s]."""
        slow = len(self.coefficients) - 2 - 2 * self.overtones
        return _basis(times, self.span, self.frequency, slow, self.overtones) @ self.coefficients


def fit_swing(times: Array, path: Array, frequency: float, overtones: int = 0) -> Oscillation:
    """Fit a swing of known frequency.

    Args:
        times: (T,) [s].
        path: (T, D) [m], D axes; rows with NaN are left out.
        frequency: [Hz].
        overtones: so many are fitted beside it, or as many fewer as the samples tell from it.

    Raises:
        InputError: fewer than 8 samples, or samples that cannot tell cosine from sine at this frequency.
    """
    times, path = check_array("times", times, (None,)), check_array("path", path, (len(times), None), finite=False)
    check_range("frequency", frequency, 1e-3, 1e4, "Hz")
    seen = np.isfinite(path).all(axis=1)
    if seen.sum() < 8:
        raise bad_input("swing", given=f"{seen.sum()} samples", allowed="8 or more", do="Record longer.")
    t, x = times[seen], path[seen]
    count = overtones
    basis, gram, inverse_gram, loss = _normal(t, frequency, count)
    while count and (loss > MUCH_ALIKE or len(t) <= 2 * len(gram)):
        count -= 1
        basis, gram, inverse_gram, loss = _normal(t, frequency, count)
    if loss > 100:
        raise bad_input(
            "swing",
            given=f"{len(t)} samples over {np.ptp(t):.2f} s",
            allowed=f"samples that tell the phase at {frequency:g} Hz",
            do="Choose a frame rate that is not twice the frequency divided by a whole number, or record longer.",
        )
    coefficients: Array = np.linalg.solve(gram, np.einsum("ti,tk->ik", basis, x)).astype(np.float64)
    misses = np.sum((x - basis @ coefficients) ** 2, axis=0) / (len(t) - basis.shape[1])
    axis_std = np.sqrt(misses * np.diag(inverse_gram)[:2].max())
    _, size, axes = np.linalg.svd(coefficients[:2])
    axis = axes[0]
    return Oscillation(
        amplitude=float(size[0]),
        amplitude_std=float(np.linalg.norm(axis * axis_std)),
        axis_std=axis_std,
        direction=axis if axis[np.argmax(np.abs(axis))] > 0 else -axis,
        frequency=float(frequency),
        coefficients=coefficients,
        span=(float(t[0]), float(t[-1])),
        overtones=count,
    )


def peak(phasors: NDArray[np.complex128]) -> Array:
    """Return the largest acceleration in a period of tones (..., 1 + H, 3), one and its overtones, over omega^2."""
    order, phase = np.arange(1, phasors.shape[-2] + 1), np.linspace(0, 2 * np.pi, 64, endpoint=False)
    path = np.einsum("k,tk,...kx->t...x", order**2, np.exp(1j * phase[:, None] * order), phasors).imag
    return np.asarray(np.linalg.norm(path, axis=-1).max(axis=0))


def _normal(t: Array, frequency: float, overtones: int) -> tuple[Array, Array, Array, float]:
    """Return the basis, its normal matrix and the inverse, and how much larger a wave's variance is than it need be."""
    basis = swing_basis(t, frequency, overtones)
    # normal equations: a decomposition of the basis would wake BLAS threads, which cost more than the work
    gram = np.einsum("ti,tj->ij", basis, basis)
    inverse_gram = np.full_like(gram, np.inf) if np.linalg.cond(gram) > 1e10 else np.linalg.inv(gram)
    # beside evenly spread phases
    loss = len(t) / 2 * float(np.diag(inverse_gram)[: 2 + 2 * overtones].max())
    return basis, gram, inverse_gram, loss


def swing_basis(times: Array, frequency: float, overtones: int = 0) -> Array:
    """Return (T, 2 + 2 H + slow terms) what `fit_swing` fits to samples at `times` (T,)."""
    return _basis(times, (float(times[0]), float(times[-1])), frequency, _slow_terms(times, frequency), overtones)


def find_frequency(times: Array, path: Array, hint: float) -> float:
    """Return the frequency [Hz] within a tenth of `hint` whose swing fits a path (T, D) over times (T,) best."""
    seen = np.isfinite(path).all(axis=1)
    t, x = times[seen], path[seen]
    span, slow = (float(t[0]), float(t[-1])), _slow_terms(t, hint)

    def misfit(f: float) -> float:
        basis = _basis(t, span, f, slow)
        along = np.einsum("ti,tk->ik", basis, x)
        return -float(np.sum(along * np.linalg.solve(np.einsum("ti,tj->ij", basis, basis), along)))

    # the misfit's valley is about 1 / (record length) wide
    width = 0.1  # a frequency is looked for within this share of where it should be
    step = min(0.25 / float(np.ptp(t)), width * hint / 2)
    grid = np.arange(hint * (1 - width), hint * (1 + width), step)
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


def _basis(t: Array, span: tuple[float, float], frequency: float, slow: int, overtones: int = 0) -> Array:
    """Return cosine and sine of the frequency and its overtones, one after the other, and the Legendre series."""
    phase = 2 * np.pi * frequency * (t - span[0])[:, None] * np.arange(1, overtones + 2)
    along = 2 * (t - span[0]) / (span[1] - span[0]) - 1
    slow_part: Array = np.polynomial.legendre.legvander(along, slow - 1).astype(np.float64)
    waves = np.stack([np.cos(phase), np.sin(phase)], axis=2).reshape(len(t), -1)
    return np.column_stack([waves, slow_part])
