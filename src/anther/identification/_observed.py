"""Observed: what one shake did to a plant and to the gripper, as `refine` takes it. F flowers, S points of the stem.

By how much each member of an ensemble misses what was measured of a shake. M members, F flowers, D data.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.checks import check_array
from anther.errors import InputError, bad_input
from anther.execution import Trial
from anther.geometry import Array
from anther.oscillation import fit_swing
from anther.plant import PlantModel
from anther.response import Response, StemMotion
from anther.shake import ShakePlan
from anther.shake.observables import ComplexArray, branch_of, semi_major
from anther.shake.pads import grip_rows, pad_nodes
from anther.shake.params import FAST
from anther.shake.search import Phasors, Version, answer, flower_motion


def _unknown() -> Array:
    return np.array(np.nan)


@dataclass(frozen=True, slots=True)
class Felt:
    """What the arm did and felt in a shake. What was not measured is NaN.

    Attributes:
        moved: amplitude of the gripper along the shake [m]; NaN: as planned.
        began: the gripper moves as sin(2 pi f (t - began)), on the robot's clock [s].
        force: of the grip at the shake's frequency [N]: sqrt |F . F| of its phasor F, without conjugation, which is its
            amplitude where it does not go round. An arm that tells the size of a force alone tells this.
        force_std: its standard deviation [N].
        force_phase: by which the force is ahead of the gripper's motion [rad], up to half a turn: arg(F . F) / 2.
    """

    moved: float = float("nan")
    began: float = float("nan")
    force: float = float("nan")
    force_std: float = float("nan")
    force_phase: float = float("nan")


NOTHING_FELT = Felt()


@dataclass(frozen=True, slots=True, eq=False)
class ObservedShake:
    """What one shake did. What was not measured is NaN, and so is what is not given.

    Attributes:
        shake: what was done.
        amplitude: (F,) of the flowers [m].
        uncertainty: (F,) standard errors [m]; read only where `amplitude` is finite.
        at_most: (F,) bounds of flowers that moved too little to be measured [m].
        phase: (F,) by which a flower's motion along `axis` is ahead of the grip's along the shake [rad].
        phase_std: (F,) its standard deviation [rad].
        axis: (F, 3) unit vectors, world.
        felt: what the arm did and felt.
        beside: what the stem did beside the pads; its phasors are relative to the gripper's sine.
    """

    shake: ShakePlan
    amplitude: Array
    uncertainty: Array
    at_most: Array = field(default_factory=_unknown)
    phase: Array = field(default_factory=_unknown)
    phase_std: Array = field(default_factory=_unknown)
    axis: Array = field(default_factory=_unknown)
    felt: Felt = NOTHING_FELT
    beside: StemMotion = field(default_factory=lambda: StemMotion.of([]))

    def __post_init__(self) -> None:
        count = np.size(self.amplitude)
        for name in ("amplitude", "uncertainty", "at_most", "phase", "phase_std", "axis"):
            shape = (count, 3) if name == "axis" else (count,)
            given = getattr(self, name)
            values = np.broadcast_to(given, shape) if np.ndim(given) == 0 else given
            values = check_array(name, values, shape, finite=False)
            object.__setattr__(self, name, values)
        seen, faint = self.seen, self.faint
        wrong = np.any(~(self.uncertainty[seen] > 0)) or np.any(self.amplitude[seen] < 0)
        if wrong or np.any(~(self.at_most[faint] > 0)):
            given = "a negative amplitude, or an uncertainty or bound <= 0"
            raise bad_input("response", given=given, allowed="> 0 m", do="Check.")

    @classmethod
    def of(cls, shake: ShakePlan, response: Response, felt: Felt = NOTHING_FELT) -> ObservedShake:
        """Return what camera and arm measured of a shake.

        Args:
            shake: what was done.
            response: what was seen.
            felt: what the arm did and felt. Where it is not known when the motion began, phases and the stem beside the
                pads are left out.
        """
        measured = response.amplitude, response.amplitude_std, response.at_most
        if not np.isfinite(felt.began):
            return cls(shake, *measured, felt=felt)
        ahead = response.phase + 2 * np.pi * shake.frequency * felt.began
        turned, stem = np.exp(2j * np.pi * shake.frequency * felt.began), response.stem
        beside = replace(stem, motion=stem.motion * turned)
        return cls(shake, *measured, ahead, response.phase_std, response.direction, felt, beside)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(F,) bool: the amplitude was measured."""
        return np.isfinite(self.amplitude)

    @property
    def faint(self) -> NDArray[np.bool_]:
        """(F,) bool: the flower was followed, and moved too little to be measured."""
        return np.isfinite(self.at_most) & ~self.seen

    @property
    def useless(self) -> str:
        """Why it teaches nothing; empty when it does."""
        if not np.any(self.seen | self.faint) and not np.isfinite(self.felt.force) and not len(self.beside.points):
            return "no flower's motion was measurable"
        return ""


STEADY = (0.3, 0.9)
"""Share of a shake between which it is steady: it has begun and its free vibrations have faded, and it goes on."""

LEAST = 16
"""Readings without which nothing is said."""

SIGNIFICANCE = 3.0
"""A force below so many standard deviations is not told."""


def feel(trial: Trial, shake: ShakePlan, forward: Callable[[Array], Array]) -> Felt:
    """Return what the arm did and felt; nothing above `FAST`, where its links do not go as its motors, which it reads
    (`escalation._knowledge.ARM_ERROR`), and where a motor in the gripper shakes.

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
    if len(times) < LEAST or shake.frequency > FAST:
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


ON_STEM = -1
"""Of data that no branch has."""


@dataclass(frozen=True, slots=True)
class Errors:
    """Standard deviations of what the model gets wrong of one datum: `refinement.Params` says what they mean."""

    amplitude: float
    phase: float
    grip: float


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
    """Return what the members say of every shake; the plan's flowers are reproduced for what it was made with.

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
        shake, moved = one.shake, one.felt.moved if np.isfinite(one.felt.moved) else one.shake.amplitude
        planned = flower_motion(Version(plant, shake.pads), grip, shake.direction, frequencies[k : k + 1])[0, 0]
        gain = shake.predicted_amplitude / shake.amplitude / np.maximum(semi_major(planned), 1e-12)
        out.append(Predicted(moved * gain[:, None] * flowers[:, k], moved * parts[k][:, k], moved * force[:, k]))
    return out


def _nearest(nodes: Array, points: Array) -> NDArray[Any]:
    return np.linalg.norm(nodes - points[:, None], axis=2).argmin(axis=1)


def misses(
    plant: PlantModel, said: Sequence[Predicted], observed: Sequence[ObservedShake], late: Array, errors: Errors
) -> Misses:
    """Return what members get wrong of all shakes.

    Args:
        plant: whose flowers they are.
        said: by the members, of each shake.
        observed: the shakes.
        late: (M,) by which the camera's clock is late on the gripper's [s].
        errors: of the model.
    """
    branch = branch_of(plant)[plant.flower_nodes]
    parts = list[Misses]()
    for one, told_of in zip(observed, said, strict=True):
        turned = np.exp(-2j * np.pi * one.shake.frequency * late)[:, None]
        for part in (*_of_flowers(told_of, one, turned, branch, errors), *_of_the_grip(told_of, one, turned, errors)):
            parts.append(part._replace(kind=np.full(len(part.own), len(parts))))
    if not parts:
        return _part(np.zeros((len(late), 0)), 0.0, 0.0)
    return Misses(*(np.concatenate(column, axis=-1) for column in zip(*parts, strict=True)))


def _part(miss: Array, model: float, own: Any, branch: Any = ON_STEM, *, bound: bool = False) -> Misses:
    count = miss.shape[1]
    own, branch = np.broadcast_to(own, count), np.broadcast_to(branch, count)
    return Misses(miss, np.full(count, bound), np.full(count, model), own, np.zeros(count, int), branch)


def _of_flowers(
    said: Predicted, one: ObservedShake, turned: ComplexArray, branch: NDArray[Any], errors: Errors
) -> tuple[Misses, ...]:
    """Return what is wrong with the flowers' amplitudes, bounds and phases."""
    predicted, seen, faint = log_amplitude(said.flowers), one.seen, one.faint
    certain = np.maximum(one.amplitude, one.uncertainty)[seen]
    timed = np.isfinite(one.phase) & np.isfinite(one.phase_std)
    along = turned * np.einsum("mfi,fi->mf", said.flowers[:, timed], one.axis[timed])
    ahead = np.angle(along * np.exp(-1j * one.phase[timed]))
    return (
        _part(np.log(certain) - predicted[:, seen], errors.amplitude, one.uncertainty[seen] / certain, branch[seen]),
        _part(np.log(one.at_most[faint]) - predicted[:, faint], errors.amplitude, 0.0, branch[faint], bound=True),
        _part(-ahead, errors.phase, one.phase_std[timed], branch[timed]),
    )


def _of_the_grip(said: Predicted, one: ObservedShake, turned: ComplexArray, errors: Errors) -> list[Misses]:
    """Return what is wrong with the grip's force and with the stem's motion beside the pads."""
    felt, beside, parts = one.felt, one.beside, list[Misses]()
    if np.isfinite(felt.force):
        square = np.sum(said.force**2, axis=1, keepdims=True)
        larger = np.log(felt.force) - 0.5 * np.log(np.maximum(np.abs(square), 1e-18))
        ahead = 0.5 * np.angle(square * np.exp(-2j * felt.force_phase))
        parts += [_part(miss, errors.grip, felt.force_std / felt.force) for miss in (larger, -ahead)]
    if len(beside.points):
        along = turned * np.einsum("msi,si->ms", said.stem, beside.axis)
        size = np.maximum(np.abs(beside.motion), 1e-12)
        wrong = (beside.motion - along) * np.exp(-1j * np.angle(beside.motion)) / size
        parts += [_part(miss, errors.grip, beside.std / size) for miss in (wrong.real, wrong.imag)]
    return parts


def log_amplitude(motion: ComplexArray) -> Array:
    """Return ln of the semi-major axes of motion (..., 3)."""
    return np.log(np.maximum(semi_major(motion), 1e-12))
