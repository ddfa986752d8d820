"""Refinement: a plant's material after shakes that were measured. F flowers, M members of an ensemble, K shakes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anther.checks import check_array, check_range
from anther.elastic_rod import Array, unit_direction
from anther.errors import StageFailure, bad_input
from anther.identification._observed import Errors, Misses, ObservedShake, log_amplitude, misses, told
from anther.plant import LEARNED, Material, PlantModel
from anther.shake.observables import semi_major
from anther.shake.pads import PADS, PADS_LEARNED, Pads, grip_rows, pad_nodes
from anther.shake.params import FLOWER_SPREAD, LOAD_ERROR
from anther.shake.search import Version, deviates, drawn_version, flower_motion, gains

CLOCK_ERROR = 0.02
"""Standard deviation of the camera's clock against the gripper's [s]; frames are stamped on arrival, up to a frame
late at 30 Hz. It is learned with the plant."""


@dataclass(frozen=True, slots=True)
class Params:
    """How measured responses refine a material.

    Attributes:
        members: drawn from the present belief.
        steps: in which the measurements are told to the members, each time with errors so much larger that all steps
            together tell them once.
        branch_spread: standard deviation of ln of a branch's stiffness about the stem's: scanned radii of branches are
            off by 15 %, stiffness goes with the fourth power (docs/reports/vibration_accuracy.md).
        model_error: standard deviation of ln(true over modelled amplitude) of a flower, beside what the draws explain
            [-]; measured by us on simulated plants that were scanned.
        phase_error: the same of the phase [rad].
        grip_error: standard deviation of ln of the modelled force in the grip, and of the modelled motion of the stem
            beside the pads relative to itself [-]; a guess, below that of flowers since no branch lies between.
        likeness: correlation of these errors between flowers of one branch [-], measured by us likewise.
        seed: of the draws.
    """

    members: int = 128
    steps: int = 4
    branch_spread: float = 0.5
    model_error: float = 0.3
    phase_error: float = 0.3
    grip_error: float = 0.25
    likeness: float = 0.5
    seed: int = 1

    def __post_init__(self) -> None:
        check_range("members", self.members, 8, 100_000)
        check_range("steps", self.steps, 1, 100)
        check_range("branch_spread", self.branch_spread, 0, 3)
        check_range("model_error", self.model_error, 0.01, 10)
        check_range("phase_error", self.phase_error, 0.01, 100)
        check_range("grip_error", self.grip_error, 0.01, 10)
        check_range("likeness", self.likeness, 0, 1)


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """What measured responses taught.

    Attributes:
        material: the belief afterwards; its stiffness and damping have moved and their spreads shrunk.
        pads: the same of the gripper's pads.
        predicted_amplitude: (K, F) what the ensemble would now predict for the same shakes [m].
        notes: what the user should know.
        members: (M,) plants and pads that agree with what was measured, as far as is known.
    """

    material: Material
    pads: Pads
    predicted_amplitude: Array
    notes: tuple[str, ...]
    members: Sequence[Version] = field(repr=False)

    @property
    def weights(self) -> Array:
        """(M,) of the members, sum 1: all count alike."""
        return np.full(len(self.members), 1 / len(self.members))

    def amplitude_at(self, points: Array, direction: Array, frequencies: Array) -> Array:
        """Return (G, Q, F) flower amplitudes per metre of other shakes: the geometric mean over the members.

        A member's own amplitude near a resonance is that of its own stiffness; the mean of a belief's members, and not
        what the mean material does, is what is believed of the amplitude.

        Args:
            points: (G, 3) where the stem is held, world [m].
            direction: (3,) unit vector of the shake.
            frequencies: (Q,) [Hz].
        """
        grips = self.grips(points)
        logs = [log_amplitude(flower_motion(member, grips, direction, frequencies)) for member in self.members]
        return np.swapaxes(np.exp(np.mean(logs, axis=0)), 0, 1)

    def grips(self, points: Array) -> list[NDArray[Any]]:
        """Return the rod nodes between the pads at each of (G, 3) points."""
        plant, pads = self.members[0]
        return pad_nodes(plant, grip_rows(plant, points), pads.width)


def refine(
    plant: PlantModel, observed: Sequence[ObservedShake], params: Params = Params(), *, pads: Pads = PADS
) -> Refinement:
    """Update what is believed of a plant's material, and of the pads that hold it, from measured responses.

    An ensemble is drawn from the present belief (`shake.search.scenarios`: E, damping, EI/GJ, pedicels, radius,
    gain; the pads' two stiffnesses; and each branch's own stiffness), each member's flowers' motion in every shake
    follows from linear theory times the nonlinear correction of the plan. The members are then moved towards what was
    measured by an ensemble smoother with multiple data assimilation (Emerick and Reynolds 2013, "Ensemble smoother with
    multiple data assimilation", Computers & Geosciences 55): `steps` Kalman updates of all drawn numbers, the gains
    from the members' own covariances, the measurements perturbed for each member and their variances times `steps`.
    What is told is ln amplitude and phase of every flower that was seen, the force in the grip, and the stem's motion
    beside the pads, which tell how far these give. The camera's clock is drawn besides. Flowers of one branch err alike
    (`likeness`). What all members miss by far has its error enlarged, as a Student-t likelihood with 4 degrees of
    freedom would, so that a flower mistaken for another does not decide alone.
    Of what `plant.LEARNED` names, the new material is moved and narrowed as the members were, and the pads likewise;
    `Refinement.amplitude_at` predicts with the members themselves.

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
    drawn = deviates(plant, params.members, params.seed)
    rng = np.random.default_rng([params.seed, 1])
    first, z = _standing(believed, np.concatenate([drawn, rng.normal(size=(len(drawn), 1))], axis=1), params)
    members, errors = first, Errors(params.model_error, params.phase_error, params.grip_error)
    for _ in range(params.steps if useful else 0):
        wrong = misses(plant, told(believed, members, useful), useful, CLOCK_ERROR * z[:, -1], errors)
        members, z = _standing(believed, z + _update(z, wrong, params, rng), params)
    before, after = ([m.plant.material for m in ms] for ms in (first, members))
    held_before, held_after = ([m.pads for m in ms] for ms in (first, members))
    amplitude = [np.exp(log_amplitude(said.flowers).mean(axis=0)) for said in told(believed, members, observed)]
    return Refinement(
        plant.material.changed(**_moved(plant.material, before, after, LEARNED)) if useful else plant.material,
        replace(pads, **_moved(pads, held_before, held_after, PADS_LEARNED)) if useful else pads,
        np.array(amplitude).reshape(len(observed), flowers),
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
    error *= params.steps * np.outer(larger, larger)
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


NINETY = 1.645
"""Standard deviations on either side that hold 90 % of a normal distribution."""

SAME_PLACE, SAME_WAY, SAME_PITCH = 0.008, np.radians(5.0), 0.01
"""A grip is the same within half the pads' width [m], a direction within this angle [rad], a frequency within this
share: the response is another one at other grips and within 40 % of frequency (measured on simulated plants)."""

NOT_LINEAR = 0.05
"""Standard deviation of ln of how far a flower's gain changes when the shake grows: drag, wind, large bending."""


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """What a shake should do to the flowers.

    Attributes:
        amplitude: (F,) semi-major axis of each flower's swing [m].
        interval: (F, 2) that holds it in 90 % of cases [m].
        measured: (F,) bool: this flower's motion was measured in the same shake, of whatever size.
    """

    amplitude: Array
    interval: Array
    measured: NDArray[np.bool_]


def expect(
    learned: Refinement,
    observed: Sequence[ObservedShake],
    point: ArrayLike,
    direction: ArrayLike,
    frequency: float,
    amplitude: float,
) -> Expected:
    """Return what a shake should do to the flowers.

    A flower that was measured while the plant was held at the same place and shaken along the same direction at the
    same frequency answers in proportion. Of the others the members of the ensemble speak.

    Args:
        learned: from `refine`.
        observed: the shakes it learned from.
        point: (3,) where the stem is to be held, world [m].
        direction: (3,) of the shake.
        frequency: [Hz].
        amplitude: of the gripper [m].
    """
    point, direction = check_array("grip point", point, (3,)), unit_direction(direction)
    low, middle, high = amplitude * flowers_at(learned, point[None], direction, np.array([frequency]))[0, 0].T
    known = np.zeros(len(middle), dtype=bool)
    for one in observed:
        if not _same(one, point, direction, frequency):
            continue
        moved = one.felt.moved if np.isfinite(one.felt.moved) else one.shake.amplitude
        seen = one.seen & (one.amplitude > 0)
        middle = np.where(seen, amplitude / moved * one.amplitude, middle)
        error = np.hypot(one.uncertainty / np.where(seen, one.amplitude, 1.0), NOT_LINEAR)
        low, high = (
            np.where(seen, middle * np.exp(side * NINETY * error), bound) for side, bound in ((-1, low), (1, high))
        )
        known |= seen
    return Expected(middle, np.stack([low, high], axis=1), known)


def flowers_at(learned: Refinement, points: Array, direction: Array, frequencies: Array) -> Array:
    """Return (G, Q, F, 3) the 5 %, 50 % and 95 % quantile of the flowers' amplitudes per metre of gripper motion.

    The spread of the members, and by how far one flower differs from its plant whatever the material.

    Args:
        learned: from `refine`.
        points: (G, 3) where the stem is held, world [m].
        direction: (3,) unit vector of the shake.
        frequencies: (Q,) [Hz].
    """
    grips = learned.grips(points)
    logs = np.array([_log(semi_major(flower_motion(m, grips, direction, frequencies))) for m in learned.members])
    return np.moveaxis(_quantiles(logs, FLOWER_SPREAD), 1, 0)


def loads_at(learned: Refinement, points: Array, direction: Array, frequencies: Array) -> dict[str, Array]:
    """Return, by kind, (G, Q, 3) the 5 %, 50 % and 95 % quantile of a plant's largest loads per metre of motion.

    Kinds are those of `shake.params.LOAD_ERROR`; arguments as of `flowers_at`.
    """
    grips = learned.grips(points)
    ways = np.broadcast_to(direction, (len(grips), 1, 3))
    answer = gains(learned.members, grips, np.ascontiguousarray(ways), frequencies)
    return {
        kind: median * np.moveaxis(_quantiles(_log(getattr(answer, kind)[..., 0]), spread), 1, 0)
        for kind, (median, spread) in LOAD_ERROR.items()
    }


def _same(one: ObservedShake, point: Array, direction: Array, frequency: float) -> bool:
    shake = one.shake
    near = np.linalg.norm(shake.grasp.point - point) <= SAME_PLACE
    along = abs(float(shake.direction @ direction)) >= np.cos(SAME_WAY)
    return bool(near and along and abs(np.log(shake.frequency / frequency)) <= SAME_PITCH) and not one.useless


def _log(values: Array) -> Array:
    return np.log(np.maximum(values, 1e-12))


def _quantiles(logs: Array, spread: float) -> Array:
    """Return (..., 3) quantiles of values with these logarithms (M, ...), of which each errs by `spread` besides."""
    mean, deviation = logs.mean(axis=0), np.sqrt(logs.var(axis=0) + spread**2)
    return np.exp(mean[..., None] + NINETY * deviation[..., None] * np.array([-1.0, 0.0, 1.0]))
