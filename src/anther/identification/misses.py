"""By how much each member of an ensemble misses what was measured of a shake. M members, F flowers, D data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.elastic_rod.rods import Array
from anther.identification.observed import Observed
from anther.plant import PlantModel
from anther.vibration.observables import ComplexArray, branch_of, semi_major
from anther.vibration.pads import grip_rows, pad_nodes
from anther.vibration.search import Answer, Version, answer, flower_motion

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


class Told(NamedTuple):
    """What the members say of one shake, as phasors: flowers (M, F, 3) [m], stem (M, S, 3) [m], force (M, 3) [N]."""

    flowers: ComplexArray
    stem: ComplexArray
    force: ComplexArray


def told(believed: Version, members: Sequence[Version], observed: Sequence[Observed]) -> list[Told]:
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
    out = dict[int, Told]()
    for which in holds.values():
        out |= zip(which, _of_one_hold(believed, members, [observed[k] for k in which]), strict=True)
    return [out[k] for k in range(len(observed))]


def _of_one_hold(believed: Version, members: Sequence[Version], observed: Sequence[Observed]) -> list[Told]:
    (plant, pads), place = believed, observed[0].shake
    grip = pad_nodes(plant, grip_rows(plant, place.grasp.point[None]), pads.width)
    beside = [plant.stem_nodes[_nearest(plant.rods.nodes[plant.stem_nodes], one.beside.points)] for one in observed]
    frequencies, starts = np.array([one.shake.frequency for one in observed]), np.cumsum([len(b) for b in beside])
    answers = [answer(member, grip, place.direction, frequencies, np.concatenate(beside)) for member in members]
    flowers, stem, force = (np.array([a[k][:, 0] for a in answers]) for k in range(len(Answer._fields)))
    parts = np.split(stem, starts[:-1], axis=2)
    out = list[Told]()
    for k, one in enumerate(observed):
        shake, moved = one.shake, one.felt.moved if np.isfinite(one.felt.moved) else one.shake.amplitude
        planned = flower_motion(Version(plant, shake.pads), grip, shake.direction, frequencies[k : k + 1])[0, 0]
        gain = shake.predicted_amplitude / shake.amplitude / np.maximum(semi_major(planned), 1e-12)
        out.append(Told(moved * gain[:, None] * flowers[:, k], moved * parts[k][:, k], moved * force[:, k]))
    return out


def _nearest(nodes: Array, points: Array) -> NDArray[Any]:
    return np.linalg.norm(nodes - points[:, None], axis=2).argmin(axis=1)


def misses(
    plant: PlantModel, said: Sequence[Told], observed: Sequence[Observed], late: Array, errors: Errors
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
    said: Told, one: Observed, turned: ComplexArray, branch: NDArray[Any], errors: Errors
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


def _of_the_grip(said: Told, one: Observed, turned: ComplexArray, errors: Errors) -> list[Misses]:
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
