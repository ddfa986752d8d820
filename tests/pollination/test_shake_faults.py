"""What can go wrong between planning a shake and learning from it: each fault has its message and a safe outcome."""

from __future__ import annotations

import errno
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sample_plants import branched, grasps_on
from test_beliefs import trial

from anther.cli.run_folder import SUMMARY, remember
from anther.core.errors import InputError, StageFailure
from anther.core.files import replacing, write_json
from anther.history import starting_material
from anther.plant.model import TOMATO, Material, build_plant
from anther.plant.model import Params as PlantParams
from anther.pollination.learning import ObservedShake, refine
from anther.pollination.pipeline import Params, Seen, model_plant
from anther.pollination.shake import Params as ShakeParams
from anther.pollination.shake import plan_shake

QUICK = ShakeParams(frequencies=6, lowest=3, highest=6)


def test_a_plant_without_visible_flowers_is_shaken_for_supposed_ones_and_says_so() -> None:
    skeleton, stem, flowers = branched()
    none = replace(flowers, positions=np.zeros((0, 3)), attachment=np.zeros(0, dtype=int))
    seen = Seen(None, None, skeleton, stem, none)  # type: ignore[arg-type]
    model = model_plant(seen, TOMATO, Params())
    assert len(model.flower_nodes)
    assert "assumed" in model.notes[0]
    assert any("assumed" in note for note in plan_shake(model, grasps_on(skeleton, stem, [8]), params=QUICK).notes)


def test_a_flower_on_no_branch_is_refused() -> None:
    skeleton, stem, flowers = branched()
    lost = replace(flowers, attachment=np.full(len(flowers.positions), len(skeleton.nodes)))
    with pytest.raises(InputError, match="flower attachment"):
        build_plant(skeleton, stem, lost, None, TOMATO)


def test_a_plant_that_buckles_is_stiffened_with_a_note_or_refused_before_anything_moves() -> None:
    skeleton, stem, flowers = branched()
    soft = Material(youngs=1e6)
    assert any("buckle" in note for note in build_plant(skeleton, stem, flowers, None, soft).notes)
    with pytest.raises(StageFailure, match="buckles") as told:
        build_plant(skeleton, stem, flowers, None, soft, params=PlantParams(stiffen=False))
    assert told.value.kind == "no_convergence"


def test_where_no_shake_is_worth_its_cost_the_closest_limit_is_named() -> None:
    skeleton, stem, flowers = branched()
    plant = build_plant(skeleton, stem, flowers, None, replace(TOMATO, youngs=2e8))
    with pytest.raises(StageFailure, match=r"no shake of .* is worth its cost.* The closest limit is") as told:
        plan_shake(plant, grasps_on(skeleton, stem, [8]), params=replace(QUICK, price=1e4, pad_friction=1e-6))
    assert told.value.kind == "limits_exceeded"


def test_a_response_that_cannot_be_measured_leaves_the_belief_and_the_history_as_they_were(tmp_path: Path) -> None:
    skeleton, stem, flowers = branched()
    plant = build_plant(skeleton, stem, flowers, None, replace(TOMATO, youngs=2e8))
    plan = plan_shake(plant, grasps_on(skeleton, stem, [8]), params=QUICK)
    nothing = np.full(len(plan.predicted_amplitude), np.nan)
    learned = refine(plant, [ObservedShake(plan, nothing, nothing, nothing)])
    assert learned.material == plant.material
    assert "no flower's motion was measurable" in learned.notes[0]
    unmeasured = replace(trial("a", plant.material, learned.material), measured_amplitude=tuple(nothing))
    assert remember(unmeasured, tmp_path, str(tmp_path / "h.sqlite")) is None
    assert starting_material("tomato", "a", tmp_path / "h.sqlite").source == "facts"


def test_a_locked_history_keeps_the_trial_in_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    where, record = tmp_path / "h.sqlite", trial("a", TOMATO, TOMATO)
    assert remember(record, tmp_path / "first", str(where)) is None
    monkeypatch.setattr("anther.history._database.PATIENCE", 0.2)
    other = sqlite3.connect(where)
    other.execute("BEGIN IMMEDIATE")
    told = remember(replace(record, plant="b"), tmp_path / "second", str(where))
    other.close()
    assert told is not None
    assert "locked" in told
    assert (tmp_path / "second" / SUMMARY).exists()


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT, errno.EROFS])
def test_a_full_disk_changes_nothing_and_is_said(tmp_path: Path, code: int) -> None:
    path = tmp_path / "result.json"
    write_json(path, {"old": 1})
    before = path.read_text()
    with pytest.raises(InputError, match="free some space"):
        _write_half(path, OSError(code, "No space left on device"))
    assert path.read_text() == before
    assert [p.name for p in tmp_path.iterdir()] == ["result.json"]


def _write_half(path: Path, error: OSError) -> None:
    with replacing(path) as temporary:
        temporary.write_text("half")
        raise error
