"""The nonlinear solver's steady state of a shake, which checks the linear theory of plans. F flowers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from anther.core.geometry import Array
from anther.plant import PlantModel
from anther.plant.limits import PEAKS
from anther.pollination.shake.observables import Observables, observables, semi_major
from anther.rods import RIGID, Drive, Rocking, Springs, Trajectory, simulate, steady_motion, strain_changes

STEPS, PERIODS = 24, 3
"""Steps a period of the simulation, and periods, of which the last counts."""
TOLERANCE = 1e-5
"""Accepted residual force [N], a hundredth of a flower's weight; 1e-9 changes no result by 1e-5 of itself."""


class Shaken(NamedTuple):
    """What the nonlinear solver says.

    Attributes:
        amplitude: (F,) of each flower, the semi-major axis in steady shaking [m].
        peaks: largest value of each limited quantity over the time, by the limits' names.
    """

    amplitude: Array
    peaks: dict[str, float]


def steadily_shaken(plant: PlantModel, drive: Drive, springs: Springs = RIGID) -> Shaken:
    """Return what the plant does in steady sinusoidal shaking.

    The simulation begins in the steady state of linear theory, so that only what is not linear has to settle. Its last
    period counts: three harmonics and what still drifts are fitted to it. The midpoint rule at step h does at a
    frequency f what the rods do at tan(pi f h) / (pi h) (the bilinear transform); h is such that this is the drive's
    frequency, and 24 steps a period are enough. Against 24 periods of 120 steps, begun slowly, amplitudes and peaks of
    seven development plants agree within 2.2 %.
    """
    dt = float(np.tan(np.pi / STEPS) / (np.pi * drive.frequency))
    omega, rods = 2 * np.pi * drive.frequency, plant.rods_at(drive.frequency)
    linear = steady_motion(rods, plant.clamp, drive, springs=springs)
    rocking = Rocking(drive.node, drive.also, linear.pads[:3], linear.pads[3:], 1 / (STEPS * dt))
    path = simulate(
        rods,
        plant.clamp,
        rocking,
        PERIODS * STEPS * dt,
        dt,
        start="scanned",
        tolerance=TOLERANCE,
        moving=(linear.motion.imag, omega * linear.motion.real),
    )
    seen = observables(plant)
    turned = rocking.rotation(path.times) + linear.pads[3:].imag
    vectors = _vectors(plant, seen, path, drive.node, turned)[-STEPS - 1 :]
    angle, order = 2 * np.pi * (np.arange(STEPS + 1) / STEPS - 0.5), np.array([1, 2, 3])
    phase = order * angle[:, None]
    basis = np.concatenate([np.ones((STEPS + 1, 1)), angle[:, None], np.cos(phase), np.sin(phase)], axis=1)
    parts = np.linalg.lstsq(basis, vectors.reshape(STEPS + 1, -1), rcond=None)[0].reshape(-1, *vectors.shape[1:])
    jolts = np.tensordot(basis[:, 2:] * -np.tile((order * omega) ** 2, 2), parts[2:], axes=1)
    amplitude = semi_major(parts[2] - 1j * parts[5])[seen.flowers]
    return Shaken(amplitude, _peaks(seen, vectors, jolts))


def _vectors(plant: PlantModel, seen: Observables, path: Trajectory, held: int, turned: Array) -> Array:
    """Return (T, K, 3) the observed vectors over time; what flowers do relative to the pads has the material's gain.

    The pads have the place of the node `held`, and the rotation vectors `turned` (T, 3) from rest. Strains are those of
    the simulated state itself, frames and all, with the moments of the linear theory's measure.
    """
    moved = np.zeros((*path.positions.shape[:2], 4))
    moved[..., :3] = path.positions - plant.rods.nodes
    strains = strain_changes(plant.rods, path.positions, path.directors, plant.clamp.planted)
    vectors, bent = (
        (operator @ of.reshape(len(of), -1).T).T.reshape(len(of), -1, 3)
        for operator, of in ((seen.operator, moved), (seen.bending, strains))
    )
    vectors[:, seen.strains] = bent
    lever = plant.rods.nodes[plant.flower_nodes] - plant.rods.nodes[held]
    carried = moved[:, held, None, :3] + np.cross(turned[:, None], lever)
    vectors[:, seen.flowers] = carried + plant.material.response_gain * (vectors[:, seen.flowers] - carried)
    return vectors


def _peaks(seen: Observables, vectors: Array, jolts: Array) -> dict[str, float]:
    """Return the largest values over the time, of strains and, from second derivatives, of the load of leaf bases."""
    peaks = {}
    for kind, name in PEAKS.items():
        moved = jolts if kind == "leaf_load" else vectors
        peaks[name] = float(np.linalg.norm(moved[:, getattr(seen, kind)], axis=2).max(initial=0.0))
    return peaks
