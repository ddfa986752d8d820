"""What is believed of a plant before a trial: its own last belief, what its crop taught, or the facts."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anther.errors import InputError
from anther.history import (
    GraspRecord,
    ShakeRecord,
    TrialRecord,
    crop_prior,
    earlier_shake,
    facts_prior,
    hierarchical_normal,
    record_trial,
    starting_material,
)
from anther.history._records import material_of
from anther.plant import PEPPER, TOMATO, Material


def trial(plant: str, before: Material, after: Material, *, hours: float = 0, species: str = "tomato") -> TrialRecord:
    begin = datetime(2026, 5, 1, tzinfo=UTC) + timedelta(hours=hours)
    return TrialRecord(species, plant, True, measured_amplitude=(1e-3,), believed=before, material=after, time=begin)


def told(before: Material, log_youngs: float, error: float) -> Material:
    """What `before` becomes when a trial says that ln E is `log_youngs`, give or take `error` (Bayes, normal)."""
    precision = 1 / before.youngs_spread**2 + 1 / error**2
    mean = (np.log(before.youngs) / before.youngs_spread**2 + log_youngs / error**2) / precision
    return replace(before, youngs=float(np.exp(mean)), youngs_spread=precision**-0.5)


def test_which_belief_is_used_and_said(tmp_path: Path) -> None:
    where = tmp_path / "h.sqlite"
    nothing = starting_material("tomato", "a", where)
    assert (nothing.source, nothing.material) == ("facts", TOMATO)
    assert starting_material("pepper", "a", where).material == PEPPER
    assert "nothing is known" in starting_material("cucumber", "a", where).reason
    first, second = told(TOMATO, np.log(2e8), 0.3), Material(youngs=2.2e8, youngs_spread=0.2)
    record_trial(trial("a", TOMATO, first), where)
    record_trial(trial("a", first, second, hours=1), where)
    own = starting_material("tomato", "a", where)
    assert (own.source, own.material) == ("plant", second)
    assert "2 trials" in own.reason
    crop = starting_material("tomato", "b", where)
    assert (crop.source, crop.plants) == ("crop", 1)
    assert TOMATO.youngs < crop.material.youngs < second.youngs
    assert starting_material("pepper", "a", where).source == "facts"


def test_failed_and_unmeasured_trials_teach_nothing(tmp_path: Path) -> None:
    where = tmp_path / "h.sqlite"
    taught = trial("a", TOMATO, Material(youngs=3e8, youngs_spread=0.1))
    record_trial(replace(taught, success=False, failure="branch_or_leaf_grasped"), where)
    record_trial(replace(taught, measured_amplitude=(float("nan"),), material=TOMATO), where)
    assert starting_material("tomato", "a", where).source == "facts"
    assert starting_material("tomato", "b", where).source == "facts"


def test_the_last_shake_that_was_held_and_seen_is_remembered(tmp_path: Path) -> None:
    where = tmp_path / "h.sqlite"
    assert earlier_shake("tomato", "a", where) is None
    way, grasp = (0.0, 1.0, 0.0), GraspRecord(arc_length=0.3)
    sine = ShakeRecord(5.0, 2e-3, 3.0, "sine", way)
    first = replace(trial("a", TOMATO, TOMATO), grasp=grasp, shake=sine)
    record_trial(first, where)
    later = [
        replace(first, success=False, failure="slipped", shake=replace(sine, amplitude=9e-3)),
        replace(first, measured_amplitude=(float("nan"),), shake=replace(sine, amplitude=8e-3)),
        replace(first, shake=None),
        replace(first, plant="b", shake=replace(sine, amplitude=7e-3)),
    ]
    for hours, record in enumerate(later, 1):
        record_trial(replace(record, time=first.time + timedelta(hours=hours)), where)
    found = earlier_shake("tomato", "a", where)
    assert found is not None
    assert (found.arc_length, found.frequency, found.amplitude) == (0.3, 5.0, 2e-3)
    assert found.direction == pytest.approx(way)
    record_trial(replace(first, shake=replace(sine, frequency=7.0), time=first.time + timedelta(hours=9)), where)
    newest = earlier_shake("tomato", "a", where)
    assert newest is not None
    assert newest.frequency == 7.0


def test_flowers_that_only_moved_too_little_teach_as_well(tmp_path: Path) -> None:
    where = tmp_path / "h.sqlite"
    after = TOMATO.changed(response_gain=0.6, response_spread=0.2)
    record_trial(replace(trial("a", TOMATO, after), measured_amplitude=(float("nan"),)), where)
    assert starting_material("tomato", "a", where).source == "plant"
    assert starting_material("tomato", "b", where).material.response_gain < 1


def test_no_plants_give_the_facts_and_many_give_the_crop() -> None:
    assert crop_prior([], TOMATO) == TOMATO
    assert hierarchical_normal(np.zeros(0), np.zeros(0), 18.0, 0.66) == (18.0, 0.66)
    rng = np.random.default_rng(3)
    truth = rng.normal(np.log(2.5e8), 0.25, 60)
    trials = [trial(f"{k}", TOMATO, told(TOMATO, y + rng.normal(0, 0.3), 0.3)) for k, y in enumerate(truth)]
    learned = crop_prior(trials, TOMATO)
    assert np.log(learned.youngs) == pytest.approx(np.log(2.5e8), abs=3 * 0.4 / np.sqrt(60))
    assert learned.youngs_spread == pytest.approx(0.25, abs=0.1)  # of the plants, not of the measurements (0.4 both)
    untouched = ("density", "damping_ratio", "bend_over_twist", "twist_spread")
    assert [getattr(learned, n) for n in untouched] == pytest.approx([getattr(TOMATO, n) for n in untouched])


def test_the_prior_is_not_counted_once_a_plant() -> None:
    """Plants that all say the same from weak evidence move the crop to it, wherever their own belief stayed."""
    trials = [trial(f"{k}", TOMATO, told(TOMATO, np.log(4e8), 1.0)) for k in range(100)]
    assert max(t.material.youngs for t in trials if t.material) < 1.6e8
    assert crop_prior(trials, TOMATO).youngs == pytest.approx(4e8, rel=0.1)


def test_two_trials_of_a_plant_are_one_plant() -> None:
    """Whether it learned in one trial or in two that say as much together."""
    half = told(TOMATO, np.log(3e8), 0.2 * np.sqrt(2))
    twice = [trial("a", TOMATO, half), trial("a", half, told(half, np.log(3e8), 0.2 * np.sqrt(2)))]
    once = [trial("a", TOMATO, told(TOMATO, np.log(3e8), 0.2))]
    assert crop_prior(twice, TOMATO).youngs == pytest.approx(crop_prior(once, TOMATO).youngs, rel=1e-6)


def test_what_is_predicted_covers_the_next_plant() -> None:
    """Crops and plants drawn from the prior: 90 % intervals hold 90 % of the next plants (calibration)."""
    rng, centre, spread, inside = np.random.default_rng(0), 18.0, 0.66, 0
    for _ in range(400):
        tau2 = 0.5 * spread**2 * 2 / rng.chisquare(4)
        plants = rng.normal(rng.normal(centre, spread * np.sqrt(0.5)), np.sqrt(tau2), 7)
        error = rng.uniform(0.1, 0.6, 6)
        mean, deviation = hierarchical_normal(rng.normal(plants[:6], error), error, centre, spread)
        inside += abs(plants[6] - mean) < 1.645 * deviation
    assert 0.86 < inside / 400 < 0.94


@given(st.lists(st.tuples(st.floats(10, 25), st.floats(0.02, 3)), max_size=8), st.floats(0.05, 1))
def test_always_between_facts_and_plants(plants: list[tuple[float, float]], spread: float) -> None:
    y, error = np.array([p[0] for p in plants]), np.array([p[1] for p in plants])
    mean, deviation = hierarchical_normal(y, error, 18.0, spread)
    assert min([18.0, *y]) - 1e-9 <= mean <= max([18.0, *y]) + 1e-9
    assert np.isfinite(deviation)
    assert deviation > 0


def test_a_crop_teaches_its_gain_and_its_radius() -> None:
    rng = np.random.default_rng(5)
    trials = []
    for k in range(30):
        gain, scale = np.exp(rng.normal(np.log(0.5), 0.2)), np.exp(rng.normal(np.log(1.05), 0.01))
        after = TOMATO.changed(response_gain=float(gain), response_spread=0.15)
        trials.append(trial(f"{k}", TOMATO, after.changed(radius_scale=float(scale), radius_spread=0.02)))
    learned = crop_prior(trials, TOMATO)
    assert learned.response_gain == pytest.approx(0.5, rel=0.2)
    assert learned.response_spread < 0.4
    assert learned.radius_scale == pytest.approx(1.05, abs=0.02)
    assert learned.scanned_youngs == pytest.approx(TOMATO.youngs)


def test_a_plant_keeps_its_stiffness_and_begins_with_the_crops_gain(tmp_path: Path) -> None:
    where = tmp_path / "h.sqlite"
    low = told(TOMATO, np.log(3e8), 0.2).changed(response_gain=0.3, response_spread=0.3)
    record_trial(trial("a", TOMATO, low), where)
    for k in range(6):
        other = TOMATO.changed(response_gain=1.0, response_spread=0.3)
        record_trial(trial(f"{k}", TOMATO, other, hours=k + 1), where)
    own, crop = (starting_material("tomato", plant, where).material for plant in ("a", "new"))
    assert own.youngs == pytest.approx(low.youngs)
    assert own.response_gain == crop.response_gain > 0.6


def test_histories_from_before_radius_and_gain_teach_neither(tmp_path: Path) -> None:
    old = material_of({"youngs": 2e8, "youngs_spread": 0.2})
    assert old is not None
    assert (old.radius_scale, old.response_gain) == (1.0, 1.0)
    before = material_of({"youngs": 1e8, "youngs_spread": 0.66})
    assert before is not None
    record_trial(trial("a", before, old), tmp_path / "h.sqlite")
    crop = starting_material("tomato", "b", tmp_path / "h.sqlite").material
    assert (crop.response_gain, crop.response_spread) == (TOMATO.response_gain, TOMATO.response_spread)
    assert crop.youngs > TOMATO.youngs


def test_bad_errors_are_refused() -> None:
    for error in ([0.1], [0.1, 0.0], [0.1, float("nan")]):
        with pytest.raises(InputError):
            hierarchical_normal(np.array([1.0, 2.0]), np.array(error), 0.0, 1.0)


def test_a_belief_that_did_not_sharpen_says_nothing() -> None:
    same = [trial(f"{k}", TOMATO, replace(TOMATO, youngs=3e8)) for k in range(9)]
    assert crop_prior(same, TOMATO) == TOMATO
    assert facts_prior("pepper") == PEPPER
