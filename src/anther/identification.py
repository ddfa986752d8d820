"""Identification: stiffness, density and damping from measurements, and a plant's material refined after a trial (P22).

F flowers, M members of an ensemble, T time samples.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq, least_squares

from anther.checks import check_array, check_range
from anther.elastic_rod.rods import Array
from anther.errors import bad_input
from anther.plant import Material, PlantModel
from anther.vibration import ShakePlan
from anther.vibration.search import gains, grip_rows, pad_nodes, scenarios


@dataclass(frozen=True, slots=True)
class Params:
    """How a measured response refines a material.

    Attributes:
        members: drawn from the present belief.
        model_error: standard deviation of the model's relative error, whatever the material [-]. The best published
            models of shaken plants err by some tens of per cent (facts: pollination 4).
        least_members: the evidence is weakened until at least this many members count.
        seed: of the draws.
    """

    members: int = 128
    model_error: float = 0.3
    least_members: float = 8.0
    seed: int = 1

    def __post_init__(self) -> None:
        check_range("members", self.members, 8, 100_000)
        check_range("model_error", self.model_error, 0.01, 10)
        check_range("least_members", self.least_members, 1, self.members)


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """What one measured response taught.

    Attributes:
        material: the belief afterwards; its stiffness and damping have moved and their spreads shrunk.
        predicted_amplitude: (F,) what the ensemble would now predict for the same shake [m].
        effective_members: members that count, 1 / sum of squared weights.
        evidence: power to which the likelihood was raised, 1 = full weight.
        notes: what the user should know.
    """

    material: Material
    predicted_amplitude: Array
    effective_members: float
    evidence: float
    notes: tuple[str, ...] = ()


def refine(
    plant: PlantModel,
    shake: ShakePlan,
    measured: ArrayLike,
    uncertainty: ArrayLike,
    params: Params = Params(),
) -> Refinement:
    """Update what is believed of a plant's material from one measured response.

    An ensemble is drawn from the present belief (`vibration.search.scenarios`: E, damping, EI/GJ, pedicels), each
    member's flower amplitudes for this shake follow from linear theory times the nonlinear correction of the plan, and
    the members are weighted by a Student-t likelihood (4 degrees of freedom, so that a flower mistaken for another does
    not decide alone) of the measured amplitudes. Where too few members would count, the likelihood is raised to a power
    below 1. The new material has the weighted mean and spread of ln E, ln damping and ln EI/GJ.

    Limits: one amplitude near a resonance fits two stiffnesses, one on either side; the result then lies between them
    with a spread that says so. The pedicels' stiffness is averaged over, not learned.

    Args:
        plant: the model the shake was planned with.
        shake: what was done.
        measured: (F,) flower amplitudes [m]; NaN where not measurable.
        uncertainty: (F,) their standard errors [m]; read only where `measured` is finite.
        params: of the ensemble.

    Raises:
        InputError: wrong number of flowers, or an uncertainty that is not > 0.
    """
    count = len(plant.flower_nodes)
    amplitude = check_array("measured amplitude", measured, (count,), finite=False)
    error = check_array("amplitude uncertainty", uncertainty, (count,), finite=False)
    seen = np.isfinite(amplitude)
    if np.any(~(error[seen] > 0)) or np.any(amplitude[seen] < 0):
        raise bad_input("response", given="a negative amplitude or an uncertainty <= 0", allowed="> 0 m", do="Check.")
    if not seen.any():
        note = "refinement: no flower's motion was measurable; the material stays as it was."
        return Refinement(plant.material, shake.predicted_amplitude, float(params.members), 0.0, (note,))
    members = scenarios(plant, params.members, params.seed)
    predicted = _ensemble_amplitude(members, shake)
    likelihood = _log_likelihood(predicted[:, seen], amplitude[seen], error[seen], params.model_error)
    weights, evidence = _weights(likelihood, params.least_members)
    return Refinement(
        _moments(plant.material, [m.material for m in members], weights),
        weights @ predicted,
        float(1 / np.sum(weights**2)),
        evidence,
    )


def _ensemble_amplitude(members: list[PlantModel], shake: ShakePlan) -> Array:
    """Return (M, F) flower amplitudes [m]; member 0 is the plant as believed, for which the plan is reproduced."""
    plant = members[0]
    grip = pad_nodes(plant, grip_rows(plant, shake.grasp.point[None]))
    response = gains(members, grip, shake.direction[None, None], np.array([shake.frequency]))
    linear = shake.amplitude * response.flower[:, 0, 0, 0]
    return linear * shake.predicted_amplitude / np.maximum(linear[0], 1e-12)


def _log_likelihood(predicted: Array, measured: Array, error: Array, model_error: float) -> Array:
    """Return (M,) log-likelihoods, Student-t with 4 degrees of freedom, up to a constant."""
    scale = np.hypot(error, model_error * predicted)
    miss = (measured - predicted) / scale
    return np.sum(-np.log(scale) - 2.5 * np.log1p(miss**2 / 4), axis=1)


def _weights(log_likelihood: Array, least: float) -> tuple[Array, float]:
    """Return normalised weights (M,) and the largest power <= 1 for which at least `least` members count."""

    def at(power: float) -> Array:
        weights = np.exp(power * (log_likelihood - log_likelihood.max()))
        return weights / weights.sum()

    def spare(power: float) -> float:
        return float(1 / np.sum(at(power) ** 2)) - min(least, 0.99 * len(log_likelihood))

    if spare(1.0) >= 0:
        return at(1.0), 1.0
    power: Any = brentq(spare, 0.0, 1.0, xtol=1e-6)
    return at(power), float(power)


def _moments(before: Material, members: list[Material], weights: Array) -> Material:
    """Return the material with the weighted mean and standard deviation of the logarithms."""
    moved: dict[str, float] = {}
    for name, spread in (
        ("youngs", "youngs_spread"),
        ("damping_ratio", "damping_spread"),
        ("bend_over_twist", "twist_spread"),
    ):
        logs = np.log([getattr(m, name) for m in members])
        mean = float(weights @ logs)
        moved[name] = float(np.exp(mean))
        moved[spread] = float(min(np.sqrt(weights @ (logs - mean) ** 2), getattr(before, spread)))
    return replace(before, **moved)


def youngs_from_frequency(
    length: float, radius: float, frequency: float, density: float, *, tip_mass: float = 0.0
) -> float:
    """Return Young's modulus [Pa] of a uniform round cantilever from its first natural frequency.

    Solves the Euler-Bernoulli frequency equation with a mass M at the tip,
    1 + cos b cosh b + (M / rho A L) b (cos b sinh b - sin b cosh b) = 0, and E = w^2 rho A L^4 / (b^4 I).
    Gravity is left out. The authors' stem (0.292 m, 3 mm, 1.38 Hz, 1100 kg/m3; P22) gives 21.6 MPa bare and 71, 120,
    218 MPa with leaves that weigh on the tip like 5, 10, 20 g (facts: pollination 0).

    Args:
        length: free length L [m].
        radius: [m].
        frequency: of the first bending mode [Hz].
        density: [kg/m3].
        tip_mass: leaves and flowers as an equal mass at the tip [kg].
    """
    check_range("length", length, 1e-3, 20, "m")
    check_range("radius", radius, 1e-5, 0.5, "m")
    check_range("frequency", frequency, 1e-3, 1e4, "Hz")
    check_range("density", density, 10, 5000, "kg/m3")
    check_range("tip_mass", tip_mass, 0, 100, "kg")
    line_mass = density * np.pi * radius**2
    share = tip_mass / (line_mass * length)

    def equation(b: float) -> float:
        loaded = share * b * (np.cos(b) * np.sinh(b) - np.sin(b) * np.cosh(b))
        return float(1 + np.cos(b) * np.cosh(b) + loaded)

    b: Any = brentq(equation, 1e-3, 1.9, xtol=1e-12)
    second_moment = np.pi * radius**4 / 4
    return float((2 * np.pi * frequency) ** 2 * line_mass * length**4 / (b**4 * second_moment))


@dataclass(frozen=True, slots=True)
class Density:
    """Density of stem samples [kg/m3]: mean, standard deviation between samples, standard error of the mean.

    The two last are NaN for a single sample.
    """

    mean: float
    sd: float
    standard_error: float


def density_from_samples(mass: ArrayLike, radius: ArrayLike, length: ArrayLike) -> Density:
    """Return the density of round stem pieces (P22).

    Args:
        mass: (n,) [kg].
        radius: (n,) [m].
        length: (n,) [m].

    Raises:
        InputError: no samples, different counts, or a value <= 0.
    """
    m = check_array("sample mass", mass, (None,))
    r = check_array("sample radius", radius, (len(m),))
    h = check_array("sample length", length, (len(m),))
    if not len(m) or min(m.min(), r.min(), h.min()) <= 0:
        raise bad_input("stem samples", given=f"{len(m)} samples", allowed="one or more, values > 0", do="Check units.")
    each = m / (np.pi * r**2 * h)
    sd = float(np.std(each, ddof=1)) if len(each) > 1 else float("nan")
    return Density(float(each.mean()), sd, sd / float(np.sqrt(len(each))))


@dataclass(frozen=True, slots=True)
class FreeVibration:
    """A decaying oscillation.

    Attributes:
        frequency: damped natural frequency [Hz].
        damping_ratio: share of critical damping [-].
        frequency_error, damping_error: standard errors.
    """

    frequency: float
    damping_ratio: float
    frequency_error: float
    damping_error: float


def fit_free_vibration(times: ArrayLike, displacement: ArrayLike) -> FreeVibration:
    """Fit offset + exp(-z w t) (a cos w_d t + b sin w_d t), w_d = w sqrt(1 - z^2), to a plucked stem's motion.

    Least squares from the strongest line of the spectrum; the standard errors are those of the fit if the residuals
    are white.

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
    spread = _standard_errors(fit, t, x / scale)
    frequency, ratio = fit.x
    return FreeVibration(float(frequency), float(ratio), float(spread[0]), float(spread[1]))


def _decaying_basis(t: Array, p: Array) -> Array:
    """Return (T, 3): the two quadratures of a mode with p = (damped frequency [Hz], damping ratio), and 1."""
    w_d, z = 2 * np.pi * p[0], p[1]
    decay = np.exp(-z / np.sqrt(1 - z * z) * w_d * (t - t[0]))
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
    return np.sqrt(np.diag(np.linalg.pinv(J.T @ J))[:2] * variance)


def _strongest_line(t: Array, x: Array) -> float:
    """Return the frequency [Hz] of the strongest line of the spectrum, refined by zero padding."""
    even = np.linspace(t[0], t[-1], len(t))
    y = np.interp(even, t, x)
    y = (y - y.mean()) * np.hanning(2 * len(y))[len(y) :]  # full weight at the start, where the motion is
    spectrum = np.abs(np.fft.rfft(y, 8 * len(y)))
    lines = np.fft.rfftfreq(8 * len(y), even[1] - even[0])
    return float(lines[1 + int(np.argmax(spectrum[1:]))])
