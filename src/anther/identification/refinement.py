"""Refinement: a plant's material after one measured shake. F flowers, M members of an ensemble."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.stats import t as student

from anther.checks import check_array, check_range
from anther.elastic_rod.rods import Array
from anther.errors import bad_input
from anther.plant import LEARNED, Material, PlantModel
from anther.vibration import ShakePlan
from anther.vibration.params import FLOWER_SPREAD
from anther.vibration.search import gains, grip_rows, pad_nodes, scenarios


@dataclass(frozen=True, slots=True)
class Params:
    """How a measured response refines a material.

    Attributes:
        members: drawn from the present belief.
        model_error: standard deviation of ln(true over modelled amplitude) of a flower, beside what material and gain
            explain [-]; `vibration.params.FLOWER_SPREAD`.
        least_members: the evidence is weakened until at least this many members count.
        seed: of the draws.
    """

    members: int = 128
    model_error: float = FLOWER_SPREAD
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
    *,
    at_most: ArrayLike | None = None,
) -> Refinement:
    """Update what is believed of a plant's material from one measured response.

    An ensemble is drawn from the present belief (`vibration.search.scenarios`: E, damping, EI/GJ, pedicels, radius,
    gain), each member's flower amplitudes for this shake follow from linear theory times the nonlinear correction of
    the plan, and the members are weighted by a Student-t likelihood (4 degrees of freedom, so that a flower mistaken
    for another does not decide alone) of the logarithms of the measured amplitudes. Where too few members would count,
    the likelihood is raised to a power below 1. The new material has the weighted means and spreads of the logarithms
    of what `plant.LEARNED` names.

    A flower that was followed but moved too little to be measured is left-censored: it counts with the probability of
    moving less than `at_most`. Were it left out, only lively flowers would teach, and the gain would come out too high.

    Limits: one amplitude near a resonance fits two stiffnesses, one on either side; the result then lies between them
    with a spread that says so. The pedicels' stiffness is averaged over, not learned.

    Args:
        plant: the model the shake was planned with.
        shake: what was done.
        measured: (F,) flower amplitudes [m]; NaN where not measurable.
        uncertainty: (F,) their standard errors [m]; read only where `measured` is finite.
        params: of the ensemble.
        at_most: (F,) bounds of flowers that moved too little to be measured [m]; NaN elsewhere. None: no such flowers.

    Raises:
        InputError: wrong number of flowers, or an uncertainty that is not > 0.
    """
    count = len(plant.flower_nodes)
    amplitude = check_array("measured amplitude", measured, (count,), finite=False)
    error = check_array("amplitude uncertainty", uncertainty, (count,), finite=False)
    bound = check_array("at_most", np.full(count, np.nan) if at_most is None else at_most, (count,), finite=False)
    seen, faint = np.isfinite(amplitude), np.isfinite(bound) & ~np.isfinite(amplitude)
    if np.any(~(error[seen] > 0)) or np.any(amplitude[seen] < 0) or np.any(~(bound[faint] > 0)):
        given = "a negative amplitude, or an uncertainty or bound <= 0"
        raise bad_input("response", given=given, allowed="> 0 m", do="Check.")
    if not (seen | faint).any() or shake.waveform.kind != "sine":
        unseen = not (seen | faint).any()
        why = "no flower's motion was measurable" if unseen else f"a {shake.waveform} has no one frequency"
        note = f"refinement: {why}; the material stays as it was."
        return Refinement(plant.material, shake.predicted_amplitude, float(params.members), 0.0, (note,))
    members = scenarios(plant, params.members, params.seed)
    predicted = _ensemble_amplitude(members, shake)
    likelihood = _log_likelihood(predicted[:, seen], amplitude[seen], error[seen], params.model_error)
    likelihood += student.logcdf(np.log(bound[faint] / predicted[:, faint]) / params.model_error, 4).sum(axis=1)
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
    answer = np.array([member.material.response_gain for member in members])
    linear = shake.amplitude * answer[:, None] * response.flower[:, 0, 0, 0]
    return np.maximum(linear * shake.predicted_amplitude / np.maximum(linear[0], 1e-12), 1e-12)


def _log_likelihood(predicted: Array, measured: Array, error: Array, model_error: float) -> Array:
    """Return (M,) log-likelihoods of ln measured, Student-t with 4 degrees of freedom, up to a constant."""
    certain = np.maximum(measured, error)
    miss = np.log(certain / predicted) / np.hypot(model_error, error / certain)
    return np.sum(-2.5 * np.log1p(miss**2 / 4), axis=1)


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
    for name, spread in LEARNED.items():
        logs = np.log([getattr(m, name) for m in members])
        mean = float(weights @ logs)
        moved[name] = float(np.exp(mean))
        moved[spread] = float(min(np.sqrt(weights @ (logs - mean) ** 2), getattr(before, spread)))
    return before.changed(**moved)
