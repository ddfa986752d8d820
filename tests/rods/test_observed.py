"""Condensed branches say what the whole says; a simulation that begins in the steady state stays there."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from dense_grip import dense_answer
from sample_plants import branched

from anther.plant.model import TOMATO, PlantModel, build_plant
from anther.pollination.shake.observables import observables, semi_major
from anther.pollination.shake.pads import pad_nodes
from anther.rods import (
    RIGID,
    Drive,
    Rocking,
    Springs,
    _response,
    observed_response,
    simulate,
    steady_motion,
    strain_changes,
)
from anther.rods._response import displacements
from evaluation.prediction.steady import steadily_shaken

WAY = np.array([0.8, 0.6, 0.0])
SOFT = Springs(5e3, 0.3)


@pytest.fixture(scope="module")
def plant() -> PlantModel:
    skeleton, stem, flowers = branched()
    return build_plant(skeleton, stem, flowers, None, TOMATO)


def drive_of(plant: PlantModel, amplitude: float, frequency: float) -> Drive:
    node, *also = (int(n) for n in pad_nodes(plant, np.array([12]))[0])
    return Drive(node, WAY, amplitude, frequency, 0, tuple(also))


@pytest.mark.parametrize("springs", [Springs(1e6, 1e3), SOFT])
def test_what_is_observed_is_what_the_whole_response_says(plant: PlantModel, springs: Springs) -> None:
    seen, frequencies = observables(plant), np.array([1.5, 7.0, 20.0])
    grips = pad_nodes(plant, np.array([5, 12, len(plant.stem_nodes) - 1]), width=0.034)
    assert [len(grip) for grip in grips] == [3, 3, 2]
    found = observed_response(
        plant.rods, plant.clamp, grips, seen.operator, frequencies, loss_factor=0.1, springs=springs
    )
    expected = np.empty_like(found.vectors)
    for q, f in enumerate(frequencies):
        for g, grip in enumerate(grips):
            motion = dense_answer(plant.rods, grip.tolist(), springs, f, np.eye(3), 0.1).reshape(3, -1)
            expected[q, g] = (seen.operator @ motion.T).reshape(-1, 3, 3)
    np.testing.assert_allclose(found.vectors, expected, atol=1e-7 * np.abs(expected).max(axis=(0, 1, 3, 4)).max())
    one = displacements(np.array([1]), len(plant.rods.nodes))
    alone = observed_response(plant.rods, plant.clamp, grips, one, frequencies, loss_factor=0.1, springs=springs)
    np.testing.assert_allclose(found.force, alone.force, rtol=1e-8, atol=1e-8)


def test_loads_that_are_solved_in_portions_give_the_same(plant: PlantModel, monkeypatch: pytest.MonkeyPatch) -> None:
    grips, seen = pad_nodes(plant, np.array([5, 12]), width=0.034), observables(plant).operator
    whole = observed_response(plant.rods, plant.clamp, grips, seen, np.array([1.5, 7.0]))
    monkeypatch.setattr(_response, "COLUMNS", 5)
    portions = observed_response(plant.rods, plant.clamp, grips, seen, np.array([1.5, 7.0]))
    for one, other in zip(whole, portions, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


def test_frequencies_that_are_solved_side_by_side_give_what_each_gives_alone(plant: PlantModel) -> None:
    grips, seen, hertz = pad_nodes(plant, np.array([5, 12]), width=0.034), observables(plant).operator, np.arange(1, 20)
    together = observed_response(plant.rods, plant.clamp, grips, seen, hertz.astype(float), loss_factor=0.1)
    for q in (0, 7, 8, 18):
        alone = observed_response(plant.rods, plant.clamp, grips, seen, hertz[q : q + 1].astype(float), loss_factor=0.1)
        for one, other in zip(together, alone, strict=True):
            np.testing.assert_allclose(one[q], other[0], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("springs", [RIGID, SOFT])
def test_a_small_shake_that_begins_in_the_steady_state_stays_in_it(plant: PlantModel, springs: Springs) -> None:
    """The midpoint rule's own steady state is that of the warped frequency, exactly."""
    steps, f = 24, 6.0
    drive, dt = drive_of(plant, 1e-6, f), np.tan(np.pi / 24) / (np.pi * f)
    rods = plant.rods_at(f)
    motion, pads = steady_motion(rods, plant.clamp, drive, springs=springs)
    rigid = np.allclose(motion[list(drive.nodes), :3], 1e-6 * WAY, rtol=0, atol=1e-15)
    assert rigid == (springs == RIGID)
    swung = Rocking(drive.node, drive.also, pads[:3], pads[3:], 1 / (steps * dt))
    path = simulate(
        rods, plant.clamp, swung, 5 * steps * dt, dt, start="scanned",
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


def test_a_flower_that_hardly_moves_beside_the_pads_is_carried_and_turned_with_them(plant: PlantModel) -> None:
    stiff = plant.with_material(replace(plant.material, response_gain=1e-3))
    drive = drive_of(stiff, 1e-4, 6.0)
    pads = steady_motion(stiff.rods_at(6.0), stiff.clamp, drive, springs=SOFT).pads
    lever = stiff.rods.nodes[stiff.flower_nodes] - stiff.rods.nodes[drive.node]
    carried = semi_major(pads[:3] + np.cross(pads[3:], lever))
    assert steadily_shaken(stiff, drive, SOFT).amplitude == pytest.approx(carried, rel=0.02)
    assert semi_major(np.cross(pads[3:], lever)).max() > 0.2 * carried.max()
