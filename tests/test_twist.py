"""The twist experiment: its plants weigh what they should, and its measure finds twist where there is some."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "experiments"))

from made_rods import cantilever
from twist import BANDS, NO_TWIST, RATIOS, Answer, answer, metrics, page, quantile
from twist_plants import GRIP_SHARES, SOFTEST, Plant, real_plants, simulated_plant

from anther.elastic_rod import Clamp, Rods, stands
from anther.sim.pepper import grow_pepper
from anther.sim.tomato import grow_tomato


@pytest.mark.parametrize("grow", [grow_tomato, grow_pepper])
def test_a_simulated_plant_keeps_its_mass_place_and_flowers(grow):
    truth = grow(1)
    plant = simulated_plant(truth)
    rods = plant.rods
    assert rods.node_mass.sum() == pytest.approx(truth.mass.sum() + truth.lump_mass.sum(), rel=1e-3)
    whole = np.concatenate([truth.mass, truth.lump_mass])
    middles = np.concatenate([(truth.start + truth.end) / 2, truth.lump_centre])
    centre = rods.node_mass @ rods.nodes / rods.node_mass.sum()
    np.testing.assert_allclose(centre, whole @ middles / whole.sum(), atol=1e-3)
    np.testing.assert_array_equal(rods.nodes[plant.flowers], truth.end[truth.flower_segment])
    assert len(plant.grips) == len(GRIP_SHARES)
    assert np.all(np.diff(rods.nodes[plant.grips, 2]) > 0)
    assert stands(rods, Clamp.root(rods))
    np.testing.assert_array_equal(rods.bend_over_twist, SOFTEST)


def test_the_papers_plants_stand(data: Path):
    plants = real_plants(data / "skeletons")
    assert [p.name for p in plants] == ["tomato2", "pepper0"]
    assert all(stands(p.rods, Clamp.root(p.rods)) for p in plants)
    assert [len(p.rods.nodes) for p in plants] == [90, 175]


def bracket(arm: float) -> Plant:
    """A stem along z with a flower on a side arm along y: shaking along x twists the stem."""
    stem = cantilever(20, axis=2, length=0.3, youngs=2e9, bend_over_twist=SOFTEST)
    nodes = np.vstack([stem.nodes, [0, arm, 0.3]])
    rods = Rods(nodes, np.append(stem.parent, 20), 3e-3, 2e9, 1100.0, SOFTEST, lumped_mass=np.r_[np.zeros(21), 5e-3])
    return Plant("bracket", rods, np.array([8]), np.array([21]), 0.05, 2e9)


def test_an_arm_needs_twist_and_a_stem_does_not():
    with_arm, without = answer(bracket(0.08)), answer(bracket(1e-4))
    for ratio in RATIOS:
        assert quantile([without], ratio, "5 Hz", 0.9) < 0.01
        assert quantile([with_arm], ratio, "5 Hz", 0.9) > 0.02
    assert quantile([with_arm], RATIOS[1], "5 Hz", 0.9) > quantile([with_arm], RATIOS[0], "5 Hz", 0.9)


def test_each_plant_has_the_same_weight():
    plant = bracket(0.05)
    key = [("5 Hz", ratio) for ratio in RATIOS]
    few, many = np.array([2.0]), np.full(1000, 1.0)
    answers = [Answer(plant, dict.fromkeys(key, np.ones_like(v)) | {("5 Hz", NO_TWIST): v}) for v in (few, many)]
    assert quantile(answers, RATIOS[0], "5 Hz", 0.9) == pytest.approx(1.0, abs=0.01)
    assert quantile(answers, RATIOS[0], "5 Hz", 0.2) == pytest.approx(0.0, abs=0.01)


def test_the_page_and_the_metrics_tell_the_same():
    answers = [answer(bracket(0.08))]
    numbers = metrics(answers, {"case": 0.01})
    assert numbers["simulated_difference"] == 0.01
    assert numbers["change_median_12_around_5hz"] == quantile(answers, 12.0, "around 5 Hz", 0.5)
    assert {"change_p90_1p5_0p7_1p9hz", "real_change_median_12_30hz"} <= set(numbers)
    text = page(answers, {})
    assert all(f"| {band} |" in text for band in BANDS)
    assert f"{100 * numbers['change_median_12_10hz']:.0f} %" in text
