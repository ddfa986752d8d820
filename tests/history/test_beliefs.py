"""What is believed of a plant before a trial: its own last belief, or the facts."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from anther.history import earlier_shake, record_trial, starting_material
from anther.history._records import material_of
from anther.plant import GraspRecord, ShakeRecord, Visit
from anther.plant.model import PEPPER, TOMATO, Material


def trial(plant: str, before: Material, after: Material, *, hours: float = 0, species: str = "tomato") -> Visit:
    begin = datetime(2026, 5, 1, tzinfo=UTC) + timedelta(hours=hours)
    return Visit(species, plant, True, measured_amplitude=(1e-3,), believed=before, material=after, time=begin)


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
    for species, plant in (("tomato", "b"), ("pepper", "a")):
        assert starting_material(species, plant, where).source == "facts", "another plant's stiffness is its own"


def test_failed_and_unmeasured_trials_teach_nothing(tmp_path: Path) -> None:
    where = tmp_path / "h.sqlite"
    taught = trial("a", TOMATO, Material(youngs=3e8, youngs_spread=0.1))
    record_trial(replace(taught, held_unharmed=False, failure="branch_or_leaf_grasped"), where)
    record_trial(replace(taught, measured_amplitude=(float("nan"),), material=TOMATO), where)
    record_trial(replace(taught, material=None), where)
    assert [replace(taught, material=known).taught for known in (None, taught.material)] == [False, True]
    assert starting_material("tomato", "a", where).source == "facts"


def test_the_last_shake_that_held_and_was_seen_to_move_flowers_is_remembered(tmp_path: Path) -> None:
    where = tmp_path / "h.sqlite"
    assert earlier_shake("tomato", "a", where) is None
    way, grasp = (0.0, 1.0, 0.0), GraspRecord(arc_length=0.3)
    sine = ShakeRecord(5.0, 2e-3, 3.0, "sine", way)
    at_the_last_look = {"measured_amplitude": (float("nan"),), "measured_acceleration": (17.0,)}
    first = replace(trial("a", TOMATO, TOMATO), grasp=grasp, shake=sine, **at_the_last_look)
    record_trial(first, where)
    later = [
        replace(first, held_unharmed=False, failure="slipped", shake=replace(sine, amplitude=9e-3)),
        replace(first, measured_acceleration=(float("nan"),), shake=replace(sine, amplitude=8e-3)),
        replace(first, measured_acceleration=(0.0,), shake=replace(sine, amplitude=6e-3)),
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


def test_a_plant_keeps_its_stiffness_and_not_its_gain(tmp_path: Path) -> None:
    where = tmp_path / "h.sqlite"
    low = told(TOMATO, np.log(3e8), 0.2).changed(response_gain=0.3, response_spread=0.1)
    record_trial(trial("a", TOMATO, low), where)
    own = starting_material("tomato", "a", where).material
    assert own.youngs == pytest.approx(low.youngs)
    assert (own.response_gain, own.response_spread) == (TOMATO.response_gain, TOMATO.response_spread)


def test_histories_from_before_radius_and_gain_teach_neither(tmp_path: Path) -> None:
    old = material_of({"youngs": 2e8, "youngs_spread": 0.2})
    assert old is not None
    assert (old.radius_scale, old.response_gain) == (1.0, 1.0)
    before = material_of({"youngs": 1e8, "youngs_spread": 0.66})
    assert before is not None
    record_trial(trial("a", before, old), tmp_path / "h.sqlite")
    own = starting_material("tomato", "a", tmp_path / "h.sqlite").material
    assert (own.response_gain, own.response_spread) == (TOMATO.response_gain, TOMATO.response_spread)
    assert own.youngs == 2e8
