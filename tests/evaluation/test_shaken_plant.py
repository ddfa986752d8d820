"""The plant that is held and shaken without an arm, against beam theory and its own linear equations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from grown_plants import grown
from hypothesis import given, settings
from hypothesis import strategies as st
from straight_plant import BASE, chain, plant_of, straight_plant

from anther.core.geometry import transform_each
from anther.pollination.shake.observables import semi_major
from anther.sim import plant_mechanics
from anther.sim.truth import Truth
from evaluation.judge.finer_plant import divided
from evaluation.prediction.shaken_plant import Params, ShakenPlant

SIDEWAYS, UP = np.eye(3)[1], np.eye(3)[2]
MIDDLE = BASE + 0.25 * UP


def test_a_slow_shake_carries_along_all_that_stands_above_the_grip() -> None:
    shaken = ShakenPlant(straight_plant(), MIDDLE, SIDEWAYS)
    motion = shaken.linear([0.01])[0, 0]
    assert np.abs(motion) == pytest.approx([0, 1, 0], abs=1e-4)


def test_the_stem_above_the_grip_resonates_as_a_cantilever_does() -> None:
    length, radius, youngs, density = 0.5, 0.004, 1e9, 1000.0
    stem = chain(BASE + np.linspace(0, length, 26)[:, None] * UP, radius, youngs=youngs)
    plant = plant_of(stem, damping_ratio=0.03, flower=24)
    shaken = ShakenPlant(plant, BASE + 0.2 * UP, SIDEWAYS)
    free = length - (shaken.point[2] - BASE[2])
    theory = 1.8751**2 / (2 * np.pi) * np.sqrt(youngs * radius**2 / 4 / (density * free**4))
    tried = theory * np.linspace(0.9, 1.1, 401)
    size = semi_major(shaken.linear(tried))[:, 0]
    assert tried[np.argmax(size)] == pytest.approx(theory, rel=0.01)  # its weight makes it softer by 0.5 %


@pytest.mark.parametrize(("amplitude", "frequency"), [(2e-3, 1.5), (1e-3, 5.0)])
def test_small_shakes_are_steady_and_as_linear_theory_says(amplitude: float, frequency: float) -> None:
    shaken = ShakenPlant(straight_plant(), MIDDLE, SIDEWAYS)
    found = shaken.steady(amplitude, frequency)
    assert found.grip_amplitude == pytest.approx(amplitude, rel=1e-4)
    assert found.unsteadiness < 0.005
    assert found.amplitude == pytest.approx(amplitude * semi_major(shaken.linear([frequency])[0]), rel=0.005)


def test_poses_put_the_flower_where_it_was_measured() -> None:
    shaken = ShakenPlant(straight_plant(), MIDDLE, SIDEWAYS)
    found = shaken.steady(2e-3, 3.0)
    k = int(shaken.plant.flower_segment[0])
    T = shaken.segment_poses(found.qpos[7])[k]
    assert (T @ np.r_[shaken.plant.flower_position[0], 1])[:3] == pytest.approx(found.flowers[7, 0], abs=1e-9)
    assert np.ptp(found.flowers[:, 0, 1]) > 1e-3


def flower_paths(shaken: ShakenPlant, qpos: Any) -> Any:
    """Return (T, F, 3) where the flowers are in these configurations."""
    k = shaken.plant.flower_segment
    T = np.array([shaken.segment_poses(q)[k] for q in qpos])
    return transform_each(T, shaken.plant.flower_position)


@pytest.mark.parametrize("pads", [np.inf, 2e3])
def test_the_linear_swing_is_where_a_small_steady_shake_is_at_the_same_time(pads: float) -> None:
    amplitude, frequency = 2e-3, 1.5
    truth = Truth(pad_stiffness=pads, pad_rotation=1e-3 * pads)
    shaken = ShakenPlant(straight_plant(), MIDDLE, SIDEWAYS, truth=truth)
    found = shaken.steady(amplitude, frequency)
    swung = flower_paths(shaken, shaken.swing(amplitude, frequency, found.times))
    assert swung == pytest.approx(found.flowers, abs=0.01 * found.amplitude.max())
    turns = np.exp(2j * np.pi * frequency * found.times)[:, None, None]
    linear = amplitude * (turns * shaken.linear([frequency], amplitude)[0]).imag
    assert swung - shaken.plant.flower_position == pytest.approx(linear, abs=5e-3 * found.amplitude.max())


FINELY = Params(plant=plant_mechanics.Params(piece=0.005, twist_every=1, stiffest=1e5))


@pytest.mark.parametrize(("pads", "theory"), [((np.inf, np.inf), 12.0), ((1e9, 1e-6), 3.0), ((200.0, 1e9), 12.0)])
def test_a_slow_pull_feels_the_stem_below_the_grip_and_the_pads_in_series(
    pads: tuple[float, float], theory: float
) -> None:
    """12 EI / h^3 where the grip keeps the stem's direction, 3 EI / h^3 where it may turn; both carry little weight."""
    youngs, radius = 4e9, 0.004
    stem = chain(BASE + np.linspace(0, 0.3, 16)[:, None] * UP, radius, youngs=youngs)
    truth = Truth(pad_stiffness=pads[0], pad_rotation=pads[1])
    shaken = ShakenPlant(plant_of(stem, flower=14), BASE + 0.2 * UP, SIDEWAYS, FINELY, truth)
    below = theory * youngs * np.pi / 4 * radius**4 / (shaken.point[2] - BASE[2]) ** 3
    expected = 1 / (1 / below + 1 / pads[0])
    assert shaken.force(0.01) == pytest.approx(np.array([0, expected, 0]), rel=0.02, abs=1e-3 * expected)


def test_a_fast_shake_of_a_stiff_stem_also_pushes_its_mass() -> None:
    """All that stands above the grip, and 13/35 of a beam between two ends that keep their direction."""
    radius, length = 0.01, 0.4
    stem = chain(BASE + np.linspace(0, length, 21)[:, None] * UP, radius, youngs=1e10)
    shaken = ShakenPlant(plant_of(stem, flower=19), BASE + 0.2 * UP, SIDEWAYS, FINELY)
    slow, fast = (shaken.force(f)[1].real for f in (0.1, 2.0))
    mass, below = (slow - fast) / (2 * np.pi) ** 2 / (2.0**2 - 0.1**2), shaken.point[2] - BASE[2]
    assert mass == pytest.approx(1000 * np.pi * radius**2 * (length - below + 13 / 35 * below), rel=0.02)


def test_the_nearest_piece_of_the_stem_is_held_and_never_the_lowest() -> None:
    plant = straight_plant()
    high, low = (ShakenPlant(plant, BASE + z * UP, SIDEWAYS).point for z in (0.4, -0.1))
    assert abs(high[2] - BASE[2] - 0.4) < 0.016
    assert low[2] == pytest.approx(BASE[2] + 1.5 * 0.025)


def test_a_slow_shake_turns_no_crooked_stem_about_itself() -> None:
    plant = grown("pepper", 11)
    shaken = ShakenPlant(plant, plant.stem_centreline()[0][1], SIDEWAYS)
    assert semi_major(shaken.linear([0.01])[0]) == pytest.approx(1, abs=1e-3)


def test_a_resonance_is_as_wide_as_the_plants_damping_ratio_asks() -> None:
    """At half the power a resonance is 2 zeta f wide, also far from the plant's first frequency, 1.3 Hz."""
    stem = chain(BASE + np.linspace(0, 0.5, 26)[:, None] * UP, 0.004, youngs=1e8)
    shaken = ShakenPlant(plant_of(stem, damping_ratio=0.03, flower=24), BASE + 0.2 * UP, SIDEWAYS)
    for low, high in ((3.0, 5.0), (18.0, 30.0)):
        tried = np.linspace(low, high, 401)
        size = semi_major(shaken.linear(tried))[:, 0]
        wide = np.ptp(tried[size > size.max() / np.sqrt(2)])
        assert wide == pytest.approx(2 * 0.03 * tried[np.argmax(size)], rel=0.1)


@given(st.floats(0.004, 0.2))
@settings(max_examples=10)
def test_a_divided_plant_is_the_same_plant_in_shorter_segments(longest: float) -> None:
    plant = grown("pepper", 11)
    finer, part = divided(plant, longest)
    assert finer.length.max() <= longest + 1e-9
    assert finer.length.sum() == pytest.approx(plant.length.sum(), rel=1e-9)
    assert finer.mass.sum() == pytest.approx(plant.mass.sum(), rel=1e-9)
    assert finer.lump_mass[part] == pytest.approx(plant.lump_mass)
    assert finer.lump_mass.sum() == pytest.approx(plant.lump_mass.sum(), rel=1e-9)
    assert np.array_equal(finer.organ[part], plant.organ)
    assert np.abs(finer.start[1:] - finer.end[finer.parent[1:]]).max() < 1e-12
    assert np.array_equal(finer.vertex_segment >= 0, plant.vertex_segment >= 0)


def test_frequencies_have_converged() -> None:
    """Half as long pieces, one of each twisting, change no low frequency by a per cent; every second twisting does."""
    plant = grown("tomato", 31)
    place = plant.stem_centreline()[0][4]

    def lowest(**cut: Any) -> Any:
        params = Params(plant=plant_mechanics.Params(**cut))
        return ShakenPlant(plant, place, SIDEWAYS, params).mechanics.frequencies[:8]

    usual, exact = ShakenPlant(plant, place, SIDEWAYS).mechanics.frequencies[:8], lowest(piece=0.0125, twist_every=1)
    assert usual == pytest.approx(exact, rel=0.01)
    assert lowest(piece=0.03, twist_every=2) != pytest.approx(exact, rel=0.02)
