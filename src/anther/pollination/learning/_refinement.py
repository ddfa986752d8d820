"""Refinement: a plant's material after shakes that were measured.

F flowers, S points of the stem, M members of an ensemble, D data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.core.errors import StageFailure, bad_input
from anther.core.records import Range, Record, Share, Spread
from anther.plant.model import LEARNED, Material, PlantModel
from anther.pollination.learning._observed import ObservedShake
from anther.pollination.shake.observables import ComplexArray, branch_of, semi_major
from anther.pollination.shake.pads import PADS, PADS_LEARNED, Pads, grip_rows, pad_nodes
from anther.pollination.shake.search import Phasors, Version, answer, deviates, drawn_version
from anther.rods import Array

CLOCK_ERROR = 0.02
"""Standard deviation of the camera's clock against the gripper's [s]; frames are stamped on arrival, up to a frame
late at 30 Hz. It is learned with the plant."""
STEPS, SEED = 4, 1
"""In how many steps the measurements are told to the members, each time with errors so much larger that all steps
together tell them once; and of the draws."""


@dataclass(frozen=True, slots=True)
class Params(Record):
    """How measured responses refine a material.

    Attributes:
        members: drawn from the present belief.
        branch_spread: standard deviation of ln of a branch's stiffness about the stem's: scanned radii of branches are
            off by 15 %, stiffness goes with the fourth power (docs/reports/prediction.md).
        model_error: standard deviation of ln(true over modelled amplitude) of a flower, beside what the draws explain
            [-]; measured by us on simulated plants that were scanned.
        phase_error: the same of the phase [rad].
        grip_error: standard deviation of ln of the modelled force in the grip, and of the modelled motion of the stem
            beside the pads relative to itself [-]; a guess, below that of flowers since no branch lies between.
        likeness: correlation of these errors between flowers of one branch [-], measured by us likewise.
    """

    members: Annotated[int, Range(8, 100_000)] = 128
    branch_spread: Spread = 0.5
    model_error: Annotated[float, Range(0.01, 10)] = 0.3
    phase_error: Annotated[float, Range(0.01, 100)] = 0.3
    grip_error: Annotated[float, Range(0.01, 10)] = 0.25
    likeness: Share = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """What measured responses taught.

    Attributes:
        material: the belief afterwards; its stiffness and damping have moved and their spreads shrunk.
        pads: the same of the gripper's pads.
        notes: what the user should know.
        members: (M,) plants and pads that agree with what was measured, as far as is known.
    """

    material: Material
    pads: Pads
    notes: tuple[str, ...]
    members: Sequence[Version] = field(repr=False)


def refine(
    plant: PlantModel, observed: Sequence[ObservedShake], params: Params = Params(), *, pads: Pads = PADS
) -> Refinement:
    """Update what is believed of a plant's material, and of the pads that hold it, from measured responses.

    An ensemble is drawn from the present belief (`shake.search.scenarios`: E, damping, EI/GJ, pedicels, radius,
    gain; the pads' two stiffnesses; and each branch's own stiffness), each member's flowers' motion in every shake
    follows from linear theory. The members are then moved towards what was measured by an ensemble smoother with
    multiple data assimilation (Emerick and Reynolds 2013, "Ensemble smoother with
    multiple data assimilation", Computers & Geosciences 55): `STEPS` Kalman updates of all drawn numbers, the gains
    from the members' own covariances, the measurements perturbed for each member and their variances times `STEPS`.
    What is told is ln amplitude and phase of every flower that was seen, the force in the grip, and the stem's motion
    beside the pads, which tell how far these give. The camera's clock is drawn besides. Flowers of one branch err alike
    (`likeness`). What all members miss by far has its error enlarged, as a Student-t likelihood with 4 degrees of
    freedom would, so that a flower mistaken for another does not decide alone.
    Of what `plant.LEARNED` names, the new material is moved and narrowed as the members were, and the pads
    likewise; the members themselves predict.

    A flower that was followed but moved too little to be measured is left-censored: it counts with a member that moves
    it more than `at_most`. Were it left out, only lively flowers would teach, and the gain would come out too high.

    Limits: one amplitude near a resonance fits two stiffnesses, one on either side; a phase, or a second frequency,
    tells them apart.

    Args:
        plant: the model the shakes were planned with.
        observed: shakes of this plant; with none, the members stand for the belief as it is.
        params: of the ensemble.
        pads: what is believed of them so far.

    Raises:
        InputError: wrong number of flowers.
        StageFailure: "no_convergence": no member stands.
    """
    flowers = len(plant.flower_nodes)
    for one in observed:
        if len(one.amplitude) != flowers:
            given = f"{len(one.amplitude)} flowers"
            raise bad_input("response", given=given, allowed=f"the plant's {flowers}", do="Use its own response.")
    believed, useful = Version(plant, pads), [one for one in observed if not one.useless]
    drawn = deviates(plant, params.members, SEED)
    rng = np.random.default_rng([SEED, 1])
    first, z = _standing(believed, np.concatenate([drawn, rng.normal(size=(len(drawn), 1))], axis=1), params)
    members = first
    for _ in range(STEPS if useful else 0):
        wrong = misses(plant, told(believed, members, useful), useful, CLOCK_ERROR * z[:, -1], params)
        members, z = _standing(believed, z + _update(z, wrong, params, rng), params)
    before, after = ([m.plant.material for m in ms] for ms in (first, members))
    held_before, held_after = ([m.pads for m in ms] for ms in (first, members))
    return Refinement(
        plant.material.changed(**_moved(plant.material, before, after, LEARNED)) if useful else plant.material,
        replace(pads, **_moved(pads, held_before, held_after, PADS_LEARNED)) if useful else pads,
        tuple(f"refinement: {one.useless}; the shake teaches nothing." for one in observed if one.useless),
        members,
    )


def _standing(believed: Version, z: Array, params: Params) -> tuple[list[Version], Array]:
    """Return the members at deviates z (M, 9 + B) that stand, and their deviates, of E as it had to be for that."""
    versions = [drawn_version(*believed, one[:-1], params.branch_spread) for one in z]
    members, z = [v for v in versions if v is not None], z[[v is not None for v in versions]]
    if len(members) < 2:
        raise StageFailure("no_convergence", "refinement: the plant model falls over whatever its stiffness.")
    matter = believed.plant.material
    if matter.youngs_spread > 0:
        stiff = np.array([m.plant.material.scanned_youngs for m in members])
        z[:, 0] = np.log(stiff / matter.scanned_youngs) / matter.youngs_spread
    return members, z


def _update(z: Array, wrong: Misses, params: Params, rng: np.random.Generator) -> Array:
    """Return (M, P) by how much one of the Kalman updates moves the members' deviates z (M, P)."""
    off = np.where(wrong.bound, np.minimum(wrong.miss, 0.0), wrong.miss)
    alike = (wrong.kind[:, None] == wrong.kind) & (wrong.branch[:, None] == wrong.branch)
    error = params.likeness * np.where(alike, np.outer(wrong.model, wrong.model), 0.0)
    np.fill_diagonal(error, wrong.model**2 + wrong.own**2)
    usual = off.mean(axis=0) ** 2 / (np.diag(error) + off.var(axis=0))
    larger = np.sqrt(np.maximum((4 + usual) / 5, 1.0))  # weight of a Student-t with 4 degrees of freedom, inverted
    error *= STEPS * np.outer(larger, larger)
    noise = rng.normal(size=off.shape) @ np.linalg.cholesky(error + 1e-12 * np.eye(len(error))).T
    said, drawn = wrong.miss.mean(axis=0) - wrong.miss, z - z.mean(axis=0)
    gain = np.linalg.solve(said.T @ said + (len(z) - 1) * error, said.T @ drawn)
    return (off + noise - noise.mean(axis=0)) @ gain


def _moved(before: Any, drawn: Sequence[Any], now: Sequence[Any], learned: Mapping[str, str]) -> dict[str, float]:
    """Return by name the values and spreads that members `now` have; `learned` names both.

    Draws that would not stand are stiffened, so the members' own mean E lies above the belief, by 0.27 in ln on eight
    plants (measured). What counts is the difference from it: a shake that tells nothing leaves the belief as it is.
    """
    moved: dict[str, float] = {}
    for name, spread in learned.items():
        first, last = (np.log([getattr(m, name) for m in members]) for members in (drawn, now))
        narrowed = last.std() / max(float(first.std()), 1e-12)
        moved[name] = float(getattr(before, name) * np.exp(last.mean() - first.mean()))
        moved[spread] = float(getattr(before, spread) * min(narrowed, 1.0))
    return moved


ON_STEM = -1
"""Of data that no branch has."""


class Misses(NamedTuple):
    """What members get wrong of D data.

    Attributes:
        miss: (M, D) measured minus predicted: of ln amplitude, of phase [rad], or relative.
        bound: (D,) bool: the measurement is an upper bound, so that only a negative miss is one.
        model: (D,) standard deviation of what the model gets wrong, alike where `kind` and `branch` are the same.
        own: (D,) of the measurement itself.
        kind: (D,) amplitudes, phases, ... of one shake have the same number.
        branch: (D,) of the plant, or `ON_STEM`.
    """

    miss: Array
    bound: NDArray[np.bool_]
    model: Array
    own: Array
    kind: NDArray[Any]
    branch: NDArray[Any]


class Predicted(NamedTuple):
    """What the members say of one shake, as phasors: flowers (M, F, 3) [m], stem (M, S, 3) [m], force (M, 3) [N]."""

    flowers: ComplexArray
    stem: ComplexArray
    force: ComplexArray


def told(believed: Version, members: Sequence[Version], observed: Sequence[ObservedShake]) -> list[Predicted]:
    """Return what the members say of every shake.

    Shakes in one hold are answered together, which costs little more than one of them.

    Args:
        believed: the plant of the plans; the pads may be believed otherwise since.
        members: M of them.
        observed: the shakes.
    """
    holds = dict[tuple[float, ...], list[int]]()
    for k, one in enumerate(observed):
        holds.setdefault((*one.shake.grasp.point, *one.shake.direction), []).append(k)
    out = dict[int, Predicted]()
    for which in holds.values():
        out |= zip(which, _of_one_hold(believed, members, [observed[k] for k in which]), strict=True)
    return [out[k] for k in range(len(observed))]


def _of_one_hold(believed: Version, members: Sequence[Version], observed: Sequence[ObservedShake]) -> list[Predicted]:
    (plant, pads), place = believed, observed[0].shake
    grip = pad_nodes(plant, grip_rows(plant, place.grasp.point[None]), pads.width)
    beside = [plant.stem_nodes[_nearest(plant.rods.nodes[plant.stem_nodes], one.beside.points)] for one in observed]
    frequencies, starts = np.array([one.shake.frequency for one in observed]), np.cumsum([len(b) for b in beside])
    answers = [answer(member, grip, place.direction, frequencies, np.concatenate(beside)) for member in members]
    flowers, stem, force = (np.array([a[k][:, 0] for a in answers]) for k in range(len(Phasors._fields)))
    parts = np.split(stem, starts[:-1], axis=2)
    out = list[Predicted]()
    for k, one in enumerate(observed):
        moved = one.felt.moved if np.isfinite(one.felt.moved) else one.shake.amplitude
        out.append(Predicted(moved * flowers[:, k], moved * parts[k][:, k], moved * force[:, k]))
    return out


def _nearest(nodes: Array, points: Array) -> NDArray[Any]:
    return np.linalg.norm(nodes - points[:, None], axis=2).argmin(axis=1)


def misses(
    plant: PlantModel, said: Sequence[Predicted], observed: Sequence[ObservedShake], late: Array, params: Params
) -> Misses:
    """Return what members get wrong of all shakes.

    Args:
        plant: whose flowers they are.
        said: by the members, of each shake.
        observed: the shakes.
        late: (M,) by which the camera's clock is late on the gripper's [s].
        params: of the refinement.
    """
    branch = branch_of(plant)[plant.flower_nodes]
    parts = list[Misses]()
    for one, told_of in zip(observed, said, strict=True):
        turned = np.exp(-2j * np.pi * one.shake.frequency * late)[:, None]
        for part in (*_of_flowers(told_of, one, turned, branch, params), *_of_the_grip(told_of, one, turned, params)):
            parts.append(part._replace(kind=np.full(len(part.own), len(parts))))
    if not parts:
        return _part(np.zeros((len(late), 0)), 0.0, 0.0)
    return Misses(*(np.concatenate(column, axis=-1) for column in zip(*parts, strict=True)))


def _part(miss: Array, model: float, own: Any, branch: Any = ON_STEM, *, bound: bool = False) -> Misses:
    count = miss.shape[1]
    own, branch = np.broadcast_to(own, count), np.broadcast_to(branch, count)
    return Misses(miss, np.full(count, bound), np.full(count, model), own, np.zeros(count, int), branch)


def _of_flowers(
    said: Predicted, one: ObservedShake, turned: ComplexArray, branch: NDArray[Any], params: Params
) -> tuple[Misses, ...]:
    """Return what is wrong with the flowers' amplitudes, bounds and phases."""
    predicted, seen, faint = log_amplitude(said.flowers), one.seen, one.faint
    certain = np.maximum(one.amplitude, one.uncertainty)[seen]
    timed = np.isfinite(one.phase) & np.isfinite(one.phase_std)
    along = turned * np.einsum("mfi,fi->mf", said.flowers[:, timed], one.axis[timed])
    ahead = np.angle(along * np.exp(-1j * one.phase[timed]))
    return (
        _part(np.log(certain) - predicted[:, seen], params.model_error, one.uncertainty[seen] / certain, branch[seen]),
        _part(np.log(one.at_most[faint]) - predicted[:, faint], params.model_error, 0.0, branch[faint], bound=True),
        _part(-ahead, params.phase_error, one.phase_std[timed], branch[timed]),
    )


def _of_the_grip(said: Predicted, one: ObservedShake, turned: ComplexArray, params: Params) -> list[Misses]:
    """Return what is wrong with the grip's force and with the stem's motion beside the pads."""
    felt, beside, parts = one.felt, one.beside, list[Misses]()
    if np.isfinite(felt.force):
        square = np.sum(said.force**2, axis=1, keepdims=True)
        larger = np.log(felt.force) - 0.5 * np.log(np.maximum(np.abs(square), 1e-18))
        ahead = 0.5 * np.angle(square * np.exp(-2j * felt.force_phase))
        parts += [_part(miss, params.grip_error, felt.force_std / felt.force) for miss in (larger, -ahead)]
    if len(beside.points):
        along = turned * np.einsum("msi,si->ms", said.stem, beside.axis)
        size = np.maximum(np.abs(beside.motion), 1e-12)
        wrong = (beside.motion - along) * np.exp(-1j * np.angle(beside.motion)) / size
        parts += [_part(miss, params.grip_error, beside.std / size) for miss in (wrong.real, wrong.imag)]
    return parts


def log_amplitude(motion: ComplexArray) -> Array:
    """Return ln of the semi-major axes of motion (..., 3)."""
    return np.log(np.maximum(semi_major(motion), 1e-12))
