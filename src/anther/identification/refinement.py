"""Refinement: a plant's material after shakes that were measured. F flowers, M members of an ensemble, K shakes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import t as student

from anther.checks import check_range
from anther.elastic_rod.rods import Array
from anther.errors import bad_input
from anther.identification.observed import Observed
from anther.plant import LEARNED, Material, PlantModel
from anther.vibration.observables import ComplexArray, branch_of, semi_major
from anther.vibration.pads import PADS, PADS_LEARNED, Pads, grip_rows, pad_nodes
from anther.vibration.search import Answer, Version, answer, flower_motion, scenarios

COUNTS = 1e-3
"""A member with less than this share of the largest weight is left out of predictions."""


@dataclass(frozen=True, slots=True)
class Params:
    """How measured responses refine a material.

    Attributes:
        members: drawn from the present belief.
        branch_spread: standard deviation of ln of a branch's stiffness about the stem's: scanned radii of branches are
            off by 15 %, stiffness goes with the fourth power (docs/vibration_accuracy.md).
        model_error: standard deviation of ln(true over modelled amplitude) of a flower, beside what the draws explain
            [-]; measured by us on simulated plants that were scanned.
        phase_error: the same of the phase [rad].
        grip_error: standard deviation of ln of the modelled force in the grip, and of the modelled motion of the stem
            beside the pads relative to itself [-]; a guess, below that of flowers since no branch lies between.
        likeness: correlation of these errors between flowers of one branch [-], measured by us likewise.
        least_members: the evidence is weakened until at least this many members count.
        seed: of the draws.
    """

    members: int = 128
    branch_spread: float = 0.5
    model_error: float = 0.5
    phase_error: float = 1.0
    grip_error: float = 0.25
    likeness: float = 0.5
    least_members: float = 16.0
    seed: int = 1

    def __post_init__(self) -> None:
        check_range("members", self.members, 8, 100_000)
        check_range("branch_spread", self.branch_spread, 0, 3)
        check_range("model_error", self.model_error, 0.01, 10)
        check_range("phase_error", self.phase_error, 0.01, 100)
        check_range("grip_error", self.grip_error, 0.01, 10)
        check_range("likeness", self.likeness, 0, 1)
        check_range("least_members", self.least_members, 1, self.members)


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """What measured responses taught.

    Attributes:
        material: the belief afterwards; its stiffness and damping have moved and their spreads shrunk.
        pads: the same of the gripper's pads.
        predicted_amplitude: (K, F) what the ensemble would now predict for the same shakes [m].
        effective_members: members that count, 1 / sum of squared weights.
        evidence: power to which the likelihood was raised, 1 = full weight.
        notes: what the user should know.
        members: (M,) plants and pads that were drawn.
        weights: (M,) of the members, sum 1.
    """

    material: Material
    pads: Pads
    predicted_amplitude: Array
    effective_members: float
    evidence: float
    notes: tuple[str, ...]
    members: Sequence[Version] = field(repr=False)
    weights: Array = field(repr=False)

    def amplitude_at(self, points: Array, direction: Array, frequencies: Array) -> Array:
        """Return (G, Q, F) flower amplitudes per metre of other shakes: the weighted geometric mean over the members.

        A member's own amplitude near a resonance is that of its own stiffness; the mean of a belief's members, and not
        what the mean material does, is what is believed of the amplitude.

        Args:
            points: (G, 3) where the stem is held, world [m].
            direction: (3,) unit vector of the shake.
            frequencies: (Q,) [Hz].
        """
        members, share, grips = self.counting(points)
        logs = [_log_amplitude(flower_motion(member, grips, direction, frequencies)) for member in members]
        return np.swapaxes(np.exp(np.tensordot(share, np.array(logs), axes=1)), 0, 1)

    def counting(self, points: Array) -> tuple[list[Version], Array, list[NDArray[Any]]]:
        """Return the members that count, their weights, and the rod nodes between the pads at each of (G, 3) points."""
        counts = self.weights >= COUNTS * self.weights.max()
        plant, pads = self.members[0]
        members = [member for member, used in zip(self.members, counts, strict=True) if used]
        share = self.weights[counts] / self.weights[counts].sum()
        return members, share, pad_nodes(plant, grip_rows(plant, points), pads.width)


def refine(
    plant: PlantModel, observed: Sequence[Observed], params: Params = Params(), *, pads: Pads = PADS
) -> Refinement:
    """Update what is believed of a plant's material, and of the pads that hold it, from measured responses.

    An ensemble is drawn from the present belief (`vibration.search.scenarios`: E, damping, EI/GJ, pedicels, radius,
    gain; the pads' two stiffnesses; and each branch's own stiffness), each member's flowers' motion in every shake
    follows from linear theory times the nonlinear correction of the plan, and the members are weighted by a Student-t
    likelihood (4 degrees of freedom, so that a flower mistaken for another does not decide alone) of ln amplitude and
    of phase. Flowers of one branch err alike, so n of them count as n / (1 + (n - 1) `likeness`) (the variance of a
    mean of equally correlated values). Where too few members would count, the likelihood is raised to a power below 1.
    Of what `plant.LEARNED` names, the new material is moved and narrowed as the weights move and narrow the members,
    and the pads likewise; `Refinement.amplitude_at` predicts with the members themselves.

    The force in the grip and the stem's motion beside the pads tell how far these give (`grip_error`).

    A flower that was followed but moved too little to be measured is left-censored: it counts with the probability of
    moving less than `at_most`. Were it left out, only lively flowers would teach, and the gain would come out too high.

    Limits: one amplitude near a resonance fits two stiffnesses, one on either side; a phase, or a second frequency,
    tells them apart. The pedicels' and branches' own stiffness is averaged over, not kept.

    Args:
        plant: the model the shakes were planned with.
        observed: shakes of this plant; with none, the members stand for the belief as it is.
        params: of the ensemble.
        pads: what is believed of them so far.

    Raises:
        InputError: wrong number of flowers.
    """
    flowers = len(plant.flower_nodes)
    for one in observed:
        if len(one.amplitude) != flowers:
            given = f"{len(one.amplitude)} flowers"
            raise bad_input("response", given=given, allowed=f"the plant's {flowers}", do="Use its own response.")
    members = scenarios(plant, params.members, params.seed, pads=pads, branch_spread=params.branch_spread)
    told = [_told(members, one) for one in observed]
    by_flower, by_grip = np.zeros((len(members), flowers)), np.zeros(len(members))
    for one, said in zip(observed, told, strict=True):
        by_flower += 0 if one.useless else _log_likelihood(said.flowers, one, params)
        by_grip += 0 if one.useless else _log_likelihood_of_the_grip(said, one, params)
    whole = by_flower @ _counts(plant, observed, params.likeness) + by_grip
    weights, evidence = _weights(whole, params.least_members)
    useful = any(not one.useless for one in observed)
    notes = tuple(f"refinement: {one.useless}; the shake teaches nothing." for one in observed if one.useless)
    amplitude = [np.exp(weights @ _log_amplitude(said.flowers)) for said in told]
    return Refinement(
        _moments(plant.material, [m.plant.material for m in members], weights) if useful else plant.material,
        replace(pads, **_moved(pads, [m.pads for m in members], PADS_LEARNED, weights)) if useful else pads,
        np.array(amplitude).reshape(len(observed), flowers),
        float(1 / np.sum(weights**2)),
        evidence if useful else 0.0,
        notes,
        members,
        weights,
    )


class _Told(NamedTuple):
    """What the members say of one shake, as phasors: flowers (M, F, 3) [m], stem (M, S, 3) [m], force (M, 3) [N]."""

    flowers: ComplexArray
    stem: ComplexArray
    force: ComplexArray


def _told(members: Sequence[Version], one: Observed) -> _Told:
    """Return what the members say; the plan's flowers are reproduced for the plant and the pads it was made with.

    Member 0 is the plant as believed; the pads may be believed otherwise since.
    """
    shake, (plant, pads) = one.shake, members[0]
    grip = pad_nodes(plant, grip_rows(plant, shake.grasp.point[None]), pads.width)
    beside = plant.stem_nodes[_nearest(plant.rods.nodes[plant.stem_nodes], one.beside.points)]
    frequency = np.array([shake.frequency])
    answers = [answer(member, grip, shake.direction, frequency, beside) for member in members]
    flowers, stem, force = (np.array([a[k][0, 0] for a in answers], np.complex128) for k in range(len(Answer._fields)))
    planned = flowers[0]
    if shake.pads != pads:
        planned = flower_motion(Version(plant, shake.pads), grip, shake.direction, frequency)[0, 0]
    linear = np.maximum(semi_major(planned), 1e-12)
    moved = one.felt.moved if np.isfinite(one.felt.moved) else shake.amplitude
    corrected = flowers * (shake.predicted_amplitude * moved / shake.amplitude / linear)[:, None]
    return _Told(corrected, moved * stem, moved * force)


def _nearest(nodes: Array, points: Array) -> NDArray[Any]:
    return np.linalg.norm(nodes - points[:, None], axis=2).argmin(axis=1)


def _log_likelihood_of_the_grip(told: _Told, one: Observed, params: Params) -> Array:
    """Return (M,) log-likelihoods of the grip's force and of the stem's motion beside the pads, up to a constant."""
    felt, beside = one.felt, one.beside
    out = np.zeros(len(told.force))
    if np.isfinite(felt.force):
        square = np.sum(told.force**2, axis=1)
        error = np.hypot(params.grip_error, felt.force_std / felt.force)
        out += _student((np.log(felt.force) - 0.5 * np.log(np.maximum(np.abs(square), 1e-18))) / error)
        out += _student(0.5 * np.angle(square * np.exp(-2j * felt.force_phase)) / error)
    if len(beside.points):
        along = np.einsum("msi,si->ms", told.stem, beside.axis)
        miss = (along - beside.motion) / np.hypot(beside.std, params.grip_error * np.abs(beside.motion))
        alike = 1 + (len(beside.points) - 1) * params.likeness
        out += (_student(miss.real) + _student(miss.imag)).sum(axis=1) / alike
    return out


def _log_amplitude(motion: ComplexArray) -> Array:
    return np.log(np.maximum(semi_major(motion), 1e-12))


def _log_likelihood(motion: ComplexArray, one: Observed, params: Params) -> Array:
    """Return (M, F) log-likelihoods of each flower's amplitude, bound and phase, up to a constant."""
    predicted, out = _log_amplitude(motion), np.zeros(motion.shape[:2])
    certain = np.maximum(one.amplitude, one.uncertainty)[one.seen]
    error = one.uncertainty[one.seen] / certain
    out[:, one.seen] = _student((np.log(certain) - predicted[:, one.seen]) / np.hypot(params.model_error, error))
    room = np.log(one.at_most[one.faint]) - predicted[:, one.faint]
    out[:, one.faint] = student.logcdf(room / params.model_error, 4)
    timed = np.isfinite(one.phase) & np.isfinite(one.phase_std)
    ahead = np.angle(np.einsum("mfi,fi->mf", motion[:, timed], one.axis[timed]) * np.exp(-1j * one.phase[timed]))
    out[:, timed] += _student(ahead / np.hypot(params.phase_error, one.phase_std[timed]))
    return out


def _student(miss: Array) -> Array:
    """Return the log-density at `miss` standard errors, Student-t with 4 degrees of freedom, up to a constant."""
    return -2.5 * np.log1p(miss**2 / 4)


def _counts(plant: PlantModel, observed: Sequence[Observed], likeness: float) -> Array:
    """Return (F,) the share of a flower's evidence that is its own and not the other flowers' of its branch."""
    branch = branch_of(plant)[plant.flower_nodes]
    used = np.any([one.seen | one.faint for one in observed] or [branch >= 0], axis=0)
    alike = np.array([np.sum(used & (branch == b)) if b >= 0 else 1 for b in branch])
    return 1 / (1 + np.maximum(alike - 1, 0) * likeness)


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
    """Return the material moved and narrowed by what the weights do to the members' logarithms.

    Draws that would not stand are stiffened, so the members' own mean E lies above the belief, by 0.27 in ln on eight
    plants (measured). What counts is the difference from it: a shake that tells nothing leaves the belief as it is.
    """
    return before.changed(**_moved(before, members, LEARNED, weights))


def _moved(before: Any, members: Sequence[Any], learned: Mapping[str, str], weights: Array) -> dict[str, float]:
    """Return by name the values and spreads that the weights of the members leave; `learned` names both."""
    moved: dict[str, float] = {}
    for name, spread in learned.items():
        logs = np.log([getattr(m, name) for m in members])
        mean, drawn = float(weights @ logs), float(logs.mean())
        narrowed = np.sqrt(weights @ (logs - mean) ** 2) / max(float(logs.std()), 1e-12)
        moved[name] = float(getattr(before, name) * np.exp(mean - drawn))
        moved[spread] = float(getattr(before, spread) * min(narrowed, 1.0))
    return moved
