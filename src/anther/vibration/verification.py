"""The chosen shake in the nonlinear solver: what every flower does, and whether a limit of the plant is passed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from anther.elastic_rod.motion import Drive, Straight
from anther.elastic_rod.rods import Array
from anther.elastic_rod.simulation import Trajectory, simulate
from anther.plant import PlantModel
from anther.vibration.observables import observables, semi_major
from anther.vibration.waveforms import Waveform

TRIES = 3
"""How often a shake that passes a limit is made smaller and simulated again."""


class Shaken(NamedTuple):
    """What the nonlinear solver says.

    Attributes:
        amplitude: (F,) of each flower, the semi-major axis in steady shaking, or the largest excursion [m].
        acceleration: (F,) peak [m/s2].
        peaks: largest value of each limited quantity over the time, by the limits' names.
    """

    amplitude: Array
    acceleration: Array
    peaks: dict[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class Shake(Straight):
    """The planned motion of the grip, as the arm will do it.

    Attributes:
        node, also: the nodes between the pads.
        direction: (3,) unit.
        amplitude, frequency, duration: [m], [Hz], [s].
        waveform: its shape.
    """

    node: int
    also: tuple[int, ...]
    direction: Array
    amplitude: float
    frequency: float
    duration: float
    waveform: Waveform

    def displacement(self, times: ArrayLike) -> Array:
        """Return (T, 3) displacements [m] at (T,) times [s]."""
        along = self.waveform.motion(times, self.amplitude, self.frequency, self.duration)[0]
        return along[..., None] * self.direction


def verified(
    plant: PlantModel, shake: Shake, limits: Mapping[str, float], least: float = 0.0
) -> tuple[Shake, Shaken, tuple[str, ...]]:
    """Return the shake, made smaller where the nonlinear solver says a limit is passed, what it does, and notes.

    Args:
        plant: as believed.
        shake: chosen by linear theory.
        limits: largest value allowed of each of `PEAKS`.
        least: a shake that must be smaller than this is of no use and not simulated any more [m].

    Raises:
        StageFailure: "no_convergence".
    """
    asked, binding = shake.amplitude, ""
    for _ in range(TRIES):
        done = shaken(plant, shake)
        name, worst = max(((n, done.peaks[n] / limit) for n, limit in limits.items()), key=lambda row: row[1])
        if worst <= 1:
            break
        binding, shake = name, replace(shake, amplitude=0.98 * shake.amplitude / worst)
        if shake.amplitude < least:
            break
    else:
        done = shaken(plant, shake)
    if not binding:
        return shake, done, ()
    less = f"{1e3 * asked:.2g} to {1e3 * shake.amplitude:.2g} mm"
    return shake, done, (f"shake: made smaller, from {less}, because the nonlinear solver passes a limit ({binding}).",)


def shaken(plant: PlantModel, shake: Shake) -> Shaken:
    """Return what the plant does. A sine is simulated until it is steady, other waveforms as a whole."""
    if shake.waveform.kind == "sine":
        return steadily_shaken(
            plant, Drive(shake.node, shake.direction, shake.amplitude, shake.frequency, 0, shake.also)
        )
    highest = shake.frequency * shake.waveform.ratio
    dt = min(1 / (30 * highest), 0.004)
    rods = plant.rods_at(np.sqrt(shake.frequency * highest))
    path = simulate(rods, plant.clamp, shake, shake.duration, dt, start="scanned", tolerance=1e-7)
    moved = path.positions[:, plant.flower_nodes] - path.positions[0, plant.flower_nodes]
    swing = np.linalg.norm(moved, axis=-1).max(axis=0)
    jolt = np.linalg.norm(np.diff(moved, 2, axis=0), axis=-1).max(axis=0) / dt**2
    return Shaken(swing, jolt, _peaks(plant, path))


def steadily_shaken(plant: PlantModel, drive: Drive) -> Shaken:
    """Return what the plant does in steady sinusoidal shaking.

    The shake grows slowly, so that few transients arise, and the last quarter of the simulated time is fitted by sine
    and cosine at the drive's frequency (least squares); the amplitude is the semi-major axis of that path. 30 steps a
    period, and at most 4 ms, keep the midpoint rule's phase error small.
    """
    dt = min(1 / (30 * drive.frequency), 0.004)
    time = float(np.clip(20 / drive.frequency, 1.5, 8.0))
    slow = replace(drive, ramp=0.4 * time)
    path = simulate(plant.rods_at(drive.frequency), plant.clamp, slow, time, dt, start="scanned", tolerance=1e-7)
    late = path.times >= time - max(np.floor(time / 4 * drive.frequency), 1) / drive.frequency
    t, x = path.times[late], path.positions[late][:, plant.flower_nodes]
    angle = 2 * np.pi * drive.frequency * t
    basis = np.stack([np.cos(angle), -np.sin(angle), np.ones_like(t), t - t.mean()], axis=1)
    parts = np.linalg.lstsq(basis, x.reshape(len(t), -1), rcond=None)[0].reshape(4, -1, 3)
    amplitude = semi_major(parts[0] + 1j * parts[1])
    return Shaken(amplitude, (2 * np.pi * drive.frequency) ** 2 * amplitude, _peaks(plant, path))


PEAKS = ("stem bending strain [-]", "pedicel bending strain [-]", "branch-base strain [-]", "leaf-base load [m/s2]")
"""The limits of the plant that the nonlinear solver is asked about."""


def _peaks(plant: PlantModel, path: Trajectory) -> dict[str, float]:
    """Return the largest values over the time, of strains and (from second differences) of the load of leaf bases."""
    seen = observables(plant)
    moved = (path.positions - path.positions[0]).reshape(len(path.times), -1)
    vectors = (seen.operator @ moved.T).reshape(-1, 3, len(path.times))
    twice = np.diff(vectors, 2, axis=2) / (path.times[1] - path.times[0]) ** 2
    kinds = (vectors[seen.stem_strain], vectors[seen.joint_strain], twice[seen.base_strain], twice[seen.leaf_load])
    return {n: float(np.linalg.norm(v, axis=1).max(initial=0.0)) for n, v in zip(PEAKS, kinds, strict=True)}
