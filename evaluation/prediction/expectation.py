"""What another shake should do to a plant that was learned: what was measured, where it was; else what members say.

G grips, Q frequencies, F flowers, M members of an ensemble.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anther.core.checks import check_array
from anther.core.geometry import Array
from anther.plant.limits import STALK_SPREAD, stalk_strain
from anther.pollination import ObservedShake, Refinement
from anther.pollination.decision import COSTS, believed
from anther.pollination.shake.observables import semi_major
from anther.pollination.shake.pads import grip_rows, pad_nodes
from anther.pollination.shake.search import answer, gains
from anther.rods import unit_direction

NINETY = 1.645
"""Standard deviations on either side that hold 90 % of a normal distribution."""

SAME_PLACE, SAME_WAY, SAME_PITCH = 0.008, np.radians(5.0), 0.01
"""A grip is the same within half the pads' width [m], a direction within this angle [rad], a frequency within this
share: the response is another one at other grips and within 40 % of frequency (measured on simulated plants)."""

FLOWER_SPREAD = 0.65
"""Standard deviation of ln(true over modelled amplitude) of a flower about its plant's mean, whatever the material
(docs/reports/response.md)."""

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
        moved = one.grip.amplitude if np.isfinite(one.grip.amplitude) else one.shake.amplitude
        seen = one.seen & (one.amplitude > 0)
        middle = np.where(seen, amplitude / moved * one.amplitude, middle)
        unsure = np.hypot(one.uncertainty / np.where(seen, one.amplitude, 1.0), NOT_LINEAR)
        low, high = (
            np.where(seen, middle * np.exp(side * NINETY * unsure), bound) for side, bound in ((-1, low), (1, high))
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
    return np.moveaxis(_quantiles(_flower_logs(learned, points, direction, frequencies), FLOWER_SPREAD), 1, 0)


def _flower_logs(learned: Refinement, points: Array, direction: Array, frequencies: Array) -> Array:
    """Return (M, Q, G, F) the logarithm of every member's flower amplitudes per metre."""
    held = grips(learned, points)
    return np.array([_log(semi_major(answer(m, held, direction, frequencies).flowers)) for m in learned.members])


def loads_at(learned: Refinement, points: Array, direction: Array, frequencies: Array) -> dict[str, Array]:
    """Return, by kind, (G, Q, 3) the 5 %, 50 % and 95 % quantile of a plant's largest loads per metre of motion.

    Kinds are those of `anther.plant.limits.PEAKS` and "grip_force"; arguments as of `flowers_at`.
    """
    held = grips(learned, points)
    ways = np.broadcast_to(direction, (len(held), 1, 3))
    moved = gains(learned.members, held, np.ascontiguousarray(ways), frequencies).answer(frequencies)
    loads = {kind: getattr(moved, kind) for kind in COSTS}
    loads["joint_strain"] = moved.flowers.max(axis=-1)
    found = {}
    for kind, values in loads.items():
        pedicels = kind == "joint_strain"
        logs, spread = believed("flowers" if pedicels else kind, values[..., 0], frequencies[:, None])
        logs, spread = (
            (logs + np.log(stalk_strain(frequencies))[:, None], np.hypot(spread, STALK_SPREAD))
            if pedicels
            else (logs, spread)
        )
        found[kind] = np.moveaxis(_quantiles(logs, spread), 1, 0)
    return found


def _same(one: ObservedShake, point: Array, direction: Array, frequency: float) -> bool:
    shake = one.shake
    near = np.linalg.norm(shake.grasp.point - point) <= SAME_PLACE
    along = abs(float(shake.direction @ direction)) >= np.cos(SAME_WAY)
    return bool(near and along and abs(np.log(shake.frequency / frequency)) <= SAME_PITCH) and not one.useless


def _log(values: Array) -> Array:
    return np.log(np.maximum(values, 1e-12))


def _quantiles(logs: Array, spread: float | Array) -> Array:
    """Return (..., 3) quantiles of values with these logarithms (M, ...), of which each errs by `spread` besides."""
    mean, deviation = logs.mean(axis=0), np.sqrt(logs.var(axis=0) + spread**2)
    return np.exp(mean[..., None] + NINETY * deviation[..., None] * np.array([-1.0, 0.0, 1.0]))


def amplitude_at(learned: Refinement, points: Array, direction: Array, frequencies: Array) -> Array:
    """Return (G, Q, F) flower amplitudes per metre of other shakes: the geometric mean over the members.

    A member's own amplitude near a resonance is that of its own stiffness; the mean of a belief's members, and not
    what the mean material does, is what is believed of the amplitude.

    Args:
        learned: from `refine`.
        points: (G, 3) where the stem is held, world [m].
        direction: (3,) unit vector of the shake.
        frequencies: (Q,) [Hz].
    """
    logs = _flower_logs(learned, points, direction, frequencies)
    return np.swapaxes(np.exp(np.mean(logs, axis=0)), 0, 1)


def grips(learned: Refinement, points: Array) -> list[NDArray[Any]]:
    """Return the rod nodes between the pads at each of (G, 3) points."""
    plant, pads = learned.members[0]
    return pad_nodes(plant, grip_rows(plant, points), pads.width)
