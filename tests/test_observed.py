"""Condensed branches say what the whole says; a simulation that begins in the steady state stays there."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sample_plants import branched

from anther.elastic_rod import GRAVITY, Drive, simulate
from anther.elastic_rod.linear import dense, linearise
from anther.elastic_rod.moments import strain_changes
from anther.elastic_rod.observed import observed_response
from anther.elastic_rod.response import held_unknowns, steady_motion
from anther.plant import TOMATO, PlantModel, build_plant
from anther.vibration.observables import observables, semi_major
from anther.vibration.search import pad_nodes
from anther.vibration.verification import steadily_shaken

WAY = np.array([0.8, 0.6, 0.0])


@pytest.fixture(scope="module")
def plant() -> PlantModel:
    skeleton, stem, flowers = branched()
    return build_plant(skeleton, stem, flowers, None, TOMATO)


def drive_of(plant: PlantModel, amplitude: float, frequency: float) -> Drive:
    node, also = (int(n) for n in pad_nodes(plant, np.array([12]))[0])
    return Drive(node, WAY, amplitude, frequency, 0, (also,))


def test_what_is_observed_is_what_the_whole_response_says(plant: PlantModel) -> None:
    seen, frequencies = observables(plant), np.array([1.5, 7.0, 20.0])
    grips = pad_nodes(plant, np.array([5, 12, len(plant.stem_nodes) - 1]))
    found = observed_response(plant.rods, plant.clamp, grips, seen.operator, frequencies, loss_factor=0.1)
    motion, force = whole_response(plant, grips, frequencies, 0.1)
    expected = np.einsum("ku,qgau->qgka", seen.operator.toarray(), motion).reshape(3, 3, -1, 3, 3)
    np.testing.assert_allclose(found.vectors, expected, atol=1e-9 * np.abs(expected).max(axis=(0, 1, 3, 4)).max())
    np.testing.assert_allclose(found.force, np.swapaxes(force, 2, 3), rtol=1e-8, atol=1e-8)


def whole_response(plant: PlantModel, grips: Any, frequencies: Any, loss: float) -> tuple[Any, Any]:
    """Return (Q, G, 3, 4N) all unknowns and (Q, G, 3, 3) the force per metre along each axis, from dense matrices."""
    system = linearise(plant.rods, plant.clamp, GRAVITY, loss)
    K, L, M = (dense(system.model, blocks) for blocks in (system.stiffness, system.loss, system.mass))
    free = system.free.ravel()
    motion = np.zeros((len(frequencies), len(grips), 3, len(free)), complex)
    force = np.zeros((len(frequencies), len(grips), 3, 3), complex)
    for q, f in enumerate(frequencies):
        Z = K + 1j * L - (2 * np.pi * f) ** 2 * M
        for g, pad in enumerate(grips):
            held = held_unknowns(plant.rods, pad)
            rest = np.setdiff1d(np.flatnonzero(free), held)
            for axis in range(3):
                x = np.zeros(len(free), complex)
                x[4 * pad + axis] = 1
                x[rest] = np.linalg.solve(Z[np.ix_(rest, rest)], -(Z @ x)[rest])
                motion[q, g, axis], pull = x, Z @ x
                force[q, g, axis] = pull.reshape(-1, 4)[pad, :3].sum(axis=0)
    return motion, force


def test_a_small_shake_that_begins_in_the_steady_state_stays_in_it(plant: PlantModel) -> None:
    """The midpoint rule's own steady state is that of the warped frequency, exactly."""
    steps, f = 24, 6.0
    drive, dt = drive_of(plant, 1e-6, f), np.tan(np.pi / 24) / (np.pi * f)
    rods = plant.rods_at(f)
    motion = steady_motion(rods, plant.clamp, drive)
    assert motion[list(drive.nodes), :3] == pytest.approx(np.tile(1e-6 * WAY, (2, 1)), abs=1e-15)
    path = simulate(
        rods, plant.clamp, replace(drive, frequency=1 / (steps * dt)), 5 * steps * dt, dt, start="scanned",
        tolerance=1e-11, moving=(motion.imag, 2 * np.pi * f * motion.real),
    )  # fmt: skip
    flowers = path.positions[:, plant.flower_nodes] - plant.rods.nodes[plant.flower_nodes]
    phase = np.exp(2j * np.pi * np.arange(len(path.times)) / steps)
    expected = (phase[:, None, None] * motion[plant.flower_nodes, :3]).imag
    assert np.abs(flowers - expected).max() < 2e-3 * np.abs(expected).max()


def test_the_short_check_agrees_with_a_long_and_fine_simulation(plant: PlantModel) -> None:
    drive = drive_of(plant, 3e-3, 4.0)
    found = steadily_shaken(plant, drive)
    rods, period = plant.rods_at(4.0), 0.25
    path = simulate(rods, plant.clamp, replace(drive, ramp=2.5), 5.0, period / 80, start="scanned", tolerance=1e-6)
    swings: Any = path.positions[-80:, plant.flower_nodes]
    turn: Any = np.exp(-2j * np.pi * np.arange(80) / 80)
    amplitude = semi_major(np.tensordot(turn, swings, axes=1).astype(np.complex128) / 40)
    assert found.amplitude == pytest.approx(amplitude, rel=0.02)
    seen, late = observables(plant), slice(-80, None)
    bent = strain_changes(plant.rods, path.positions[late], path.directors[late]).reshape(80, -1)
    vectors = (seen.bending @ bent.T).T.reshape(80, -1, 3)[:, seen.stem_strain - seen.strains[0]]
    strain = np.linalg.norm(vectors, axis=2).max()
    assert found.peaks["stem bending strain [-]"] == pytest.approx(strain, rel=0.03)
