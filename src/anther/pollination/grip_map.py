"""How a plant's flowers answer small shakes of every grip and frequency (linear response); which of them are allowed.

F flowers, G grips, Q frequencies, N rod nodes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core.geometry import Array
from anther.plant.source import SourcePlant, held_nodes
from anther.pollination.shake._actuators import Actuator, arm_shaker
from anther.pollination.shake.choice import MOST_SPEED
from anther.pollination.shake.observables import semi_major
from anther.pollination.shake.params import Params
from anther.robot.arm.sawyer import SAWYER
from anther.robot.arm.shaking import amplitude_limit
from anther.rods import natural_frequencies, response_map

ARM = arm_shaker()
MODES = 4
COLUMNS = (
    "grip_node", "grip_distance_m", "grip_z_m", "frequency_hz", "direction_x", "direction_y", "direction_z",
    "grip_amplitude_m", "amplitude_ratio_mean", "acceleration_mean_m_s2", "acceleration_least_m_s2",
    "acceleration_most_m_s2", "allowed",
)  # fmt: skip
"""Of `GripMap.rows`; mean, least and most are over the flowers."""


@dataclass(frozen=True, slots=True, eq=False)
class GripMap:
    """Steady motion of F flowers when the plant is shaken at one of G grips with one of Q frequencies.

    Attributes:
        frequencies: (Q,) [Hz].
        grips: (G,) nodes, by their distance from the root.
        distance: (G,) that distance along the plant [m].
        amplitude: (Q,) grip amplitude [m].
        direction: (Q, G, 3) shake direction.
        ratio: (Q, G, F) flower amplitude (semi-major axis of its path) over grip amplitude [-].
        resonances: (G, K) lowest natural frequencies while the grip is held [Hz].
        allowed: (Q, G) whether no limit is passed that `plan_shake` keeps of machine and flowers; what stem and leaves
            bear is not asked.
    """

    frequencies: Array
    grips: NDArray[Any]
    distance: Array
    amplitude: Array
    direction: Array
    ratio: Array
    resonances: Array
    allowed: NDArray[np.bool_]

    @property
    def acceleration(self) -> Array:
        """(Q, G, F) peak acceleration of each flower [m/s^2]."""
        return self.ratio * (self.amplitude * (2 * np.pi * self.frequencies) ** 2)[:, None, None]

    @property
    def best(self) -> tuple[int, int] | None:
        """(q, g) of the largest mean acceleration that is allowed; None if nothing is."""
        mean = np.where(self.allowed, self.acceleration.mean(axis=-1), -1.0)
        q, g = np.unravel_index(int(np.argmax(mean)), mean.shape)
        return (int(q), int(g)) if self.allowed[q, g] else None

    def rows(self, plant: SourcePlant) -> Iterable[list[str]]:
        """Yield the cells of `COLUMNS`, grip by grip."""
        acceleration = self.acceleration
        for g, grip in enumerate(self.grips):
            for q, frequency in enumerate(self.frequencies):
                there, ratio = acceleration[q, g], self.ratio[q, g]
                row = [self.distance[g], plant.rods.nodes[grip, 2], frequency, *self.direction[q, g]]
                row += [self.amplitude[q], ratio.mean(), there.mean(), there.min(), there.max()]
                numbers = (f"{value:.6g}" for value in row)
                yield [str(plant.numbers[grip]), *numbers, str(int(self.allowed[q, g]))]


def map_grips(
    plant: SourcePlant,
    grips: Sequence[int],
    flowers: NDArray[Any],
    frequencies: Array,
    amplitude: Array,
    *,
    directions: Array | None = None,
    pads: float = 0.0,
    actuator: Actuator = ARM,
) -> GripMap:
    """Return how the flowers of a plant at rest answer at every grip and frequency.

    Tissue is hysteretic: one damping ratio for all.

    Args:
        plant: the plant.
        grips: (G,) nodes.
        flowers: (F,) nodes.
        frequencies: (Q,) [Hz].
        amplitude: (Q,) of the grip [m].
        directions: (D, 3) unit vectors, of which each cell takes the best; None: 12 over half a turn.
        pads: length of stem between the pads [m].
        actuator: whose band is allowed.
    """
    held = [held_nodes(plant, int(grip), pads) for grip in grips]
    moves = np.zeros((len(frequencies), len(grips), 3, len(flowers), 3), np.complex128)
    sizes, loss = np.array([len(nodes) for nodes in held]), 2 * plant.damping_ratio
    for size in np.unique(sizes):
        same = np.flatnonzero(sizes == size)
        rows = np.array([held[g] for g in same])
        moves[:, same] = response_map(
            plant.rods, plant.clamp, rows, np.eye(3), frequencies, observe=flowers, loss_factor=loss
        )
    if directions is None:
        turns = np.pi * np.arange(12) / 12  # horizontal directions that are tried for the best one [rad]
        directions = np.column_stack([np.cos(turns), np.sin(turns), 0 * turns])
    ratio, direction = _best_direction(moves, directions)
    resonances = []
    for nodes in held:
        clamp = replace(plant.clamp, nodes=np.concatenate([plant.clamp.nodes, nodes]))
        resonances.append(natural_frequencies(plant.rods, clamp, MODES).frequencies)
    mean = ratio.mean(axis=-1) * (amplitude * (2 * np.pi * frequencies) ** 2)[:, None]
    useful = 200.0  # m/s2 of the flowers on average; more does not help
    allowed = (mean <= useful) & _machine_allows(frequencies, amplitude, actuator)[:, None]
    distance = plant.distances()[np.asarray(grips)]
    values = (distance, amplitude, direction, ratio, np.array(resonances), allowed)
    return GripMap(frequencies, np.asarray(grips), *values)


def _machine_allows(frequencies: Array, amplitude: Array, actuator: Actuator) -> NDArray[np.bool_]:
    slack = 1 + 1e-9
    band = (frequencies * slack >= actuator.lowest) & (frequencies <= actuator.highest * slack)
    speed = 2 * np.pi * frequencies * amplitude <= MOST_SPEED * slack
    return band & speed & (amplitude <= Params().most_amplitude * slack)


def _best_direction(moves: Any, ways: Array) -> tuple[Array, Array]:
    """Return the flowers' amplitude ratios (Q, G, F) in the direction of largest mean, and that direction (Q, G, 3)."""
    ratio = np.full(moves.shape[:2] + moves.shape[3:4], -1.0)
    direction = np.zeros((*moves.shape[:2], 3))
    for way in ways:
        there = semi_major(np.einsum("qgdfi,d->qgfi", moves, way))
        better = there.mean(axis=-1) > ratio.mean(axis=-1)
        ratio[better], direction[better] = there[better], way
    return ratio, direction


def neutral_amplitude(frequencies: Array) -> Array:
    """Return the amplitude (Q,) [m] a Sawyer manages, neutral, away from its base; at most what the planner gives."""
    limit = amplitude_limit(SAWYER, SAWYER.neutral, (1.0, 0.0, 0.0), frequencies)
    return np.minimum(limit, Params().most_amplitude)


def natural_modes(plant: SourcePlant) -> tuple[Array, Array]:
    """Return the lowest natural frequencies (K,) [Hz] of the plant that nobody holds, and their damping ratios.

    Weight lowers a mode's stiffness and not its damping: near buckling, ratios are larger than the tissue's own.
    """
    hertz, _, drag = natural_frequencies(plant.rods, plant.clamp, MODES)
    at_1_hz = natural_frequencies(plant.damped(1.0), plant.clamp, MODES).damping_ratios
    return hertz, drag + (at_1_hz - drag) / hertz
