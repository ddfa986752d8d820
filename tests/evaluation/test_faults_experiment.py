"""What `evaluation/robustness/faults.py` stands on: a shake in pieces, faults drawn by number."""

from __future__ import annotations

import json
import re
import sys
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_foresight import made_plan

from anther.pollination.execution import WatchedShake
from evaluation.robustness import faults
from evaluation.robustness.fault_machines import Pieces


def test_its_pieces_are_a_watched_shake_that_comes_to_rest() -> None:
    plan = made_plan()
    watched = Pieces(plan)
    assert {name for name in (*dir(WatchedShake), *WatchedShake.__annotations__) if name[0] != "_"} <= set(dir(watched))
    assert watched.frame_rate((15.0, 30.0, 60.0, 90.0)) > 2 * plan.tones.frequencies.max()
    watched_from: Any = None
    piece = watched.begin(watched_from)
    sample: Any = SimpleNamespace(time=0.0)
    sizes = [piece.amplitudes]
    while sizes[-1].any():
        piece = watched.next_piece(piece, [], [sample])
        sizes.append(piece.amplitudes)
    assert len(watched.steps) == len(sizes) - 1 == 3
    assert all(np.abs(size).max() <= watched.directions[0].reach for size in sizes)


RESULTS = Path(__file__).parents[2] / "docs" / "results" / "long"


def test_the_published_campaign_is_drawn_today_as_it_was() -> None:
    """A kind that is added changes no case that is drawn by number alone."""
    published = json.loads((RESULTS / "faults.json").read_text())["metrics"]
    cases = [faults.draw(number, 1) for number in range(1000)]
    drawn = Counter(case.fault.kind + (" (views)" if case.views else "") for case in cases)
    assert {case.fault.kind for case in cases} == {*faults.FIRST, "kill -9"}
    for kind, count in drawn.items():
        assert published[re.sub(r"[^a-z0-9]", "_", kind).strip("_") + "_faults"] == count


@pytest.mark.parametrize("kind", faults.STRUCK)
def test_a_chosen_kind_strikes_wherever_it_can(kind: Any) -> None:
    cases = [faults.draw(number, 0, kind) for number in range(40)]
    assert {case.fault.kind for case in cases} == {kind}
    assert {case.fault.at for case in cases} == set(faults.STRIKES.get(kind, faults.MOTIONS))


def struck_by(row: dict[str, Any], _: Path) -> dict[str, Any]:
    """Stand for a case."""
    return {"unsafe": "torn" if row.get("kind") == "pushed" else "", "record": "", "continued": "", "force": 0.0}


def test_a_campaign_counts_all_that_its_folder_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kinds that are added later join it, and a fault is counted as what it was, not as what it would be now."""
    monkeypatch.setattr(faults, "prepare", lambda _: None)
    monkeypatch.setattr(faults, "one", struck_by)

    def metrics(*words: str) -> Any:
        told = tmp_path / "told.json"
        monkeypatch.setattr(sys, "argv", ["faults.py", "--out", str(tmp_path), "--json", str(told), *words])
        faults.main()
        return json.loads(told.read_text())

    drawn = Counter(faults.draw(number, 0).fault.kind for number in range(8))
    assert metrics("--faults", "8")["faults"] == 8
    both = metrics("--kinds", "pushed", "arm force lost", "--each", "3")
    assert (both["faults"], both["safe_ends"], both["arm_force_lost_faults"]) == (14, 11, 3)
    assert both["pushed_faults"] == 3 + drawn["pushed"]
    assert metrics("--kinds", "arm force lost", "--each", "2") == both
