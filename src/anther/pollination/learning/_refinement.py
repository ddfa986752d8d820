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
from anther.core.geometry import Array, ComplexArray
from anther.core.records import Range, Record, Share, Spread
from anther.plant.model import LEARNED, Material, PlantModel
from anther.pollination.learning._observed import ObservedShake
from anther.pollination.shake.observables import branch_of, semi_major
from anther.pollination.shake.pads import PADS, PADS_LEARNED, Pads, grip_rows, pad_nodes
from anther.pollination.shake.search import Phasors, Version, answer, draw_deviates, draw_version


@dataclass(frozen=True, slots=True)
class Params(Record):
    """How measured responses refine a material.

    Attributes:
        members: drawn from the present belief.
        branch_spread: standard deviation of ln of a branch's stiffness about the stem's: scanned radii of branches are
            off by 15 %, stiffness goes with the fourth power (docs/reports/prediction.md).
        model_error: standard deviation of ln(true over modelled amplitude) of a flower that the draws do
            not explain [-]; measured on scanned simulated plants.
        phase_error: the same of the phase [rad].
        grip_error: standard deviation of ln of the modelled force in the grip, and relative error of the modelled
            stem motion near the grasp [-]; a guess, below that of flowers since no branch lies between.
        likeness: correlation of these errors between flowers of one branch [-], measured likewise.
    """

    members: Annotated[int, Range(8, 100_000)] = 128
    branch_spread: Spread = 0.5
    model_error: Annotated[float, Range(0.01, 10)] = 0.3
    phase_error: Annotated[float, Range(0.01, 100)] = 0.3
    grip_error: Annotated[float, Range(0.01, 10)] = 0.25
    likeness: Share = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """Posterior of a plant's material after measured shakes.

    Attributes:
        material: posterior values and spreads.
        pads: posterior of the gripper's pads.
        notes: for the user.
        members: (M,) posterior ensemble of plants and pads.
    """

    material: Material
    pads: Pads
    notes: tuple[str, ...]
    members: Sequence[Version] = field(repr=False)


def refine(
    plant: PlantModel,
    observed: Sequence[ObservedShake],
    params: Params = Params(),
    *,
    pads: Pads = PADS,
    clock_error: float = 0.02,
) -> Refinement:
    """Update the belief about a plant's material and the pads that hold it from measured responses.

    An ensemble is drawn from the prior (`shake.search.scenarios`: E, damping, EI/GJ, pedicels, radius, gain; the pads'
    two stiffnesses; and each branch's own stiffness); linear theory predicts each member's motion in every shake. The
    members are then updated by an ensemble smoother with multiple data assimilation (Emerick and Reynolds 2013,
    "Ensemble smoother with multiple data assimilation", Computers & Geosciences 55): four Kalman updates of all
    drawn numbers, the gains from the members' own covariances, the measurements perturbed for each member and their
    variances times four.
    The data are ln amplitude and phase of every measured flower, the grip's force, and the stem's motion near the
    grasp, which determines the pads' compliance. The camera's delay is drawn as well. Errors of flowers on one branch
    are correlated (`likeness`). The error of an outlier is enlarged as by a Student-t likelihood with 4 degrees of
    freedom. The mean and spread of every parameter in `plant.LEARNED` change as those of the members do, and the
    pads' likewise; the members themselves predict.

    A tracked flower below the detection limit is left-censored: it counts against members that move it more than
    `at_most`. Without it the gain would be biased upwards.

    Limits: one amplitude near a resonance fits two stiffnesses, one on either side; a phase, or a second frequency,
    separates them.

    Args:
        plant: the model the shakes were planned with.
        observed: shakes of this plant; with none, the members are drawn from the prior.
        params: of the ensemble.
        pads: their prior.
        clock_error: standard deviation of the camera's clock against the gripper's [s]; frames are stamped on arrival,
            up to a frame late at 30 Hz.

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
    seed = 1
    drawn = draw_deviates(plant, params.members, seed)
    rng = np.random.default_rng([seed, 1])
    first, z = _build_standing_members(
        believed, np.concatenate([drawn, rng.normal(size=(len(drawn), 1))], axis=1), params
    )
    members, steps = first, 4 if useful else 0
    for _ in range(steps):
        delay = clock_error * z[:, -1]
        wrong = collect_misfits(plant, predict_members(believed, members, useful), useful, delay, params)
        members, z = _build_standing_members(believed, z + _update(z, wrong, params, rng, steps), params)
    before, after = ([m.plant.material for m in ms] for ms in (first, members))
    held_before, held_after = ([m.pads for m in ms] for ms in (first, members))
    return Refinement(
        plant.material.changed(**_update_belief(plant.material, before, after, LEARNED)) if useful else plant.material,
        replace(pads, **_update_belief(pads, held_before, held_after, PADS_LEARNED)) if useful else pads,
        tuple(f"refinement: {one.useless}; the shake teaches nothing." for one in observed if one.useless),
        members,
    )


def _build_standing_members(believed: Version, z: Array, params: Params) -> tuple[list[Version], Array]:
    """Return the stable members at deviates z (M, 9 + B), and their deviates, with E as raised for stability."""
    versions = [draw_version(*believed, one[:-1], params.branch_spread) for one in z]
    members, z = [v for v in versions if v is not None], z[[v is not None for v in versions]]
    if len(members) < 2:
        raise StageFailure("no_convergence", "refinement: the plant model falls over whatever its stiffness.")
    matter = believed.plant.material
    if matter.youngs_spread > 0:
        stiff = np.array([m.plant.material.scanned_youngs for m in members])
        z[:, 0] = np.log(stiff / matter.scanned_youngs) / matter.youngs_spread
    return members, z


def _update(z: Array, wrong: Misfits, params: Params, rng: np.random.Generator, steps: int) -> Array:
    """Return the change (M, P) of the members' deviates z (M, P) by one Kalman update of so many."""
    off = np.where(wrong.bound, np.minimum(wrong.miss, 0.0), wrong.miss)
    alike = (wrong.kind[:, None] == wrong.kind) & (wrong.branch[:, None] == wrong.branch)
    error = params.likeness * np.where(alike, np.outer(wrong.model, wrong.model), 0.0)
    np.fill_diagonal(error, wrong.model**2 + wrong.own**2)
    usual = off.mean(axis=0) ** 2 / (np.diag(error) + off.var(axis=0))
    larger = np.sqrt(np.maximum((4 + usual) / 5, 1.0))  # weight of a Student-t with 4 degrees of freedom, inverted
    error *= steps * np.outer(larger, larger)
    noise = rng.normal(size=off.shape) @ np.linalg.cholesky(error + 1e-12 * np.eye(len(error))).T
    prediction, drawn = wrong.miss.mean(axis=0) - wrong.miss, z - z.mean(axis=0)
    gain = np.linalg.solve(prediction.T @ prediction + (len(z) - 1) * error, prediction.T @ drawn)
    return (off + noise - noise.mean(axis=0)) @ gain


def _update_belief(
    before: Any, drawn: Sequence[Any], now: Sequence[Any], learned: Mapping[str, str]
) -> dict[str, float]:
    """Return the posterior values and spreads by name; `learned` names both.

    Unstable draws are stiffened, so the members' mean E lies above the prior. The change of the members is applied to
    the prior, so that a shake without information leaves it unchanged.
    """
    moved: dict[str, float] = {}
    for name, spread in learned.items():
        first, last = (np.log([getattr(m, name) for m in members]) for members in (drawn, now))
        narrowed = last.std() / max(float(first.std()), 1e-12)
        moved[name] = float(getattr(before, name) * np.exp(last.mean() - first.mean()))
        moved[spread] = float(getattr(before, spread) * min(narrowed, 1.0))
    return moved


class Misfits(NamedTuple):
    """Differences between D data and the members' predictions.

    Attributes:
        miss: (M, D) measured minus predicted: of ln amplitude, of phase [rad], or relative.
        bound: (D,) bool: the measurement is an upper bound, so that only a negative difference counts.
        model: (D,) standard deviation of the model error, correlated where `kind` and `branch` are equal.
        own: (D,) of the measurement itself.
        kind: (D,) amplitudes, phases, ... of one shake have the same number.
        branch: (D,) of the plant; -1 on the main stem.
    """

    miss: Array
    bound: NDArray[np.bool_]
    model: Array
    own: Array
    kind: NDArray[Any]
    branch: NDArray[Any]


class Predicted(NamedTuple):
    """The members' prediction of one shake, as phasors: flowers (M, F, 3) [m], stem (M, S, 3) [m], force (M, 3) [N]."""

    flowers: ComplexArray
    stem: ComplexArray
    force: ComplexArray


def predict_members(
    believed: Version, members: Sequence[Version], observed: Sequence[ObservedShake]
) -> list[Predicted]:
    """Predict every shake with every member; shakes in one hold are computed together.

    Args:
        believed: prior of plant and pads.
        members: M of them.
        observed: the shakes.
    """
    holds = dict[tuple[float, ...], list[int]]()
    for k, one in enumerate(observed):
        holds.setdefault((*one.shake.grasp.point, *one.shake.direction), []).append(k)
    out = dict[int, Predicted]()
    for which in holds.values():
        out |= zip(which, _predict_one_hold(believed, members, [observed[k] for k in which]), strict=True)
    return [out[k] for k in range(len(observed))]


def _predict_one_hold(
    believed: Version, members: Sequence[Version], observed: Sequence[ObservedShake]
) -> list[Predicted]:
    (plant, pads), place = believed, observed[0].shake
    grip = pad_nodes(plant, grip_rows(plant, place.grasp.point[None]), pads.width)
    near_grasp = [plant.stem_nodes[_nearest(plant.rods.nodes[plant.stem_nodes], one.stem.points)] for one in observed]
    frequencies, starts = np.array([one.shake.frequency for one in observed]), np.cumsum([len(b) for b in near_grasp])
    answers = [answer(member, grip, place.direction, frequencies, np.concatenate(near_grasp)) for member in members]
    flowers, stem, force = (np.array([a[k][:, 0] for a in answers]) for k in range(len(Phasors._fields)))
    parts = np.split(stem, starts[:-1], axis=2)
    out = list[Predicted]()
    for k, one in enumerate(observed):
        moved = one.grip.amplitude if np.isfinite(one.grip.amplitude) else one.shake.amplitude
        out.append(Predicted(moved * flowers[:, k], moved * parts[k][:, k], moved * force[:, k]))
    return out


def _nearest(nodes: Array, points: Array) -> NDArray[Any]:
    return np.linalg.norm(nodes - points[:, None], axis=2).argmin(axis=1)


def collect_misfits(
    plant: PlantModel, predictions: Sequence[Predicted], observed: Sequence[ObservedShake], delay: Array, params: Params
) -> Misfits:
    """Return the differences between measurements and predictions of all shakes.

    Args:
        plant: whose flowers they are.
        predictions: of the members, one for each shake.
        observed: the shakes.
        delay: (M,) of the camera's clock against the gripper's [s].
        params: of the refinement.
    """
    branch = branch_of(plant)[plant.flower_nodes]
    parts = list[Misfits]()
    for one, prediction in zip(observed, predictions, strict=True):
        turned = np.exp(-2j * np.pi * one.shake.frequency * delay)[:, None]
        for part in (
            *_flower_misfits(prediction, one, turned, branch, params),
            *_grip_misfits(prediction, one, turned, params),
        ):
            parts.append(part._replace(kind=np.full(len(part.own), len(parts))))
    if not parts:
        return _make_misfits(np.zeros((len(delay), 0)), 0.0, 0.0)
    return Misfits(*(np.concatenate(column, axis=-1) for column in zip(*parts, strict=True)))


def _make_misfits(miss: Array, model: float, own: Any, branch: Any = -1, *, bound: bool = False) -> Misfits:
    count = miss.shape[1]
    own, branch = np.broadcast_to(own, count), np.broadcast_to(branch, count)
    return Misfits(miss, np.full(count, bound), np.full(count, model), own, np.zeros(count, int), branch)


def _flower_misfits(
    prediction: Predicted, one: ObservedShake, turned: ComplexArray, branch: NDArray[Any], params: Params
) -> tuple[Misfits, ...]:
    """Return the differences of the flowers' amplitudes, bounds and phases."""
    predicted, seen, faint = log_amplitude(prediction.flowers), one.seen, one.faint
    certain = np.maximum(one.amplitude, one.uncertainty)[seen]
    timed = np.isfinite(one.phase) & np.isfinite(one.phase_std)
    along = turned * np.einsum("mfi,fi->mf", prediction.flowers[:, timed], one.axis[timed])
    ahead = np.angle(along * np.exp(-1j * one.phase[timed]))
    return (
        _make_misfits(
            np.log(certain) - predicted[:, seen], params.model_error, one.uncertainty[seen] / certain, branch[seen]
        ),
        _make_misfits(
            np.log(one.at_most[faint]) - predicted[:, faint], params.model_error, 0.0, branch[faint], bound=True
        ),
        _make_misfits(-ahead, params.phase_error, one.phase_std[timed], branch[timed]),
    )


def _grip_misfits(prediction: Predicted, one: ObservedShake, turned: ComplexArray, params: Params) -> list[Misfits]:
    """Return the differences of the grip's force and of the stem's motion near the grasp."""
    grip, near_grasp, parts = one.grip, one.stem, list[Misfits]()
    if np.isfinite(grip.force):
        square = np.sum(prediction.force**2, axis=1, keepdims=True)
        larger = np.log(grip.force) - 0.5 * np.log(np.maximum(np.abs(square), 1e-18))
        ahead = 0.5 * np.angle(square * np.exp(-2j * grip.force_phase))
        parts += [_make_misfits(miss, params.grip_error, grip.force_std / grip.force) for miss in (larger, -ahead)]
    if len(near_grasp.points):
        along = turned * np.einsum("msi,si->ms", prediction.stem, near_grasp.axis)
        size = np.maximum(np.abs(near_grasp.motion), 1e-12)
        wrong = (near_grasp.motion - along) * np.exp(-1j * np.angle(near_grasp.motion)) / size
        parts += [_make_misfits(miss, params.grip_error, near_grasp.std / size) for miss in (wrong.real, wrong.imag)]
    return parts


def log_amplitude(motion: ComplexArray) -> Array:
    """Return ln of the semi-major axes of motion (..., 3)."""
    return np.log(np.maximum(semi_major(motion), 1e-12))
