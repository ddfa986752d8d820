"""What can go wrong between planning a shake and learning from it: each fault has its message and a safe outcome."""

from __future__ import annotations

import errno
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sample_plants import branched, grasps_on

from anther.core.errors import InputError, StageFailure
from anther.core.files import replacing, write_json
from anther.plant.model import TOMATO, build_plant
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


def test_where_no_shake_is_worth_its_cost_the_closest_limit_is_named() -> None:
    skeleton, stem, flowers = branched()
    plant = build_plant(skeleton, stem, flowers, None, replace(TOMATO, youngs=2e8))
    with pytest.raises(StageFailure, match=r"no shake of .* is worth its cost.* The closest limit is") as told:
        plan_shake(plant, grasps_on(skeleton, stem, [8]), params=replace(QUICK, price=1e4, pad_friction=1e-6))
    assert told.value.kind == "limits_exceeded"


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
