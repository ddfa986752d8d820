"""What `evaluation/robustness/protocol_faults.py` calls safe: it sees what is wrong, its faults cover every phase."""

from __future__ import annotations

import json
import re
import sys
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_foresight import made_plan

from anther.core.geometry import Array
from anther.robot.arm.sawyer import SAWYER
from evaluation.robustness import protocol_faults
from evaluation.robustness.protocol_faults import (
    EXPECTED,
    FIRST,
    GOES_ON,
    PHASES,
    Case,
    draw,
    held_up,
    no_effect,
    stop_time,
    unsafe,
)

RESULTS = Path(__file__).parents[2] / "docs" / "results" / "long"
STEM = SAWYER.neutral
RATE = 100.0


def plan() -> Any:
    made = made_plan()
    return replace(made, grasp=replace(made.grasp, T_world_flange=SAWYER.forward(STEM)))


def machines(joints: Array, opening: float = 0.04) -> Any:
    times = np.arange(len(joints)) / RATE
    return SimpleNamespace(log=lambda: (times, joints), opening=opening)


def to_the_stem(back: float = 0.0, last: float = 1.0) -> Array:
    """From elsewhere to the stem in 2 s, to `back` [rad] from it in 1 s, and `last` [s] of rest."""
    ways = [np.linspace(0.3, 0.0, 200), np.linspace(0.0, back, 100), np.full(round(last * RATE), back)]
    return STEM + np.concatenate(ways)[:, None] * np.ones(7)


def jumping_back() -> Array:
    """To the stem, and when it has stood there for a while, 15 mrad back at once."""
    joints = to_the_stem(back=0.2)
    return np.vstack([joints, joints[-100:] - 0.015])


CASE = Case(0, "joints silent", "shake", 0.5)
STRUCK = 1.0  # s


def test_an_arm_that_stands_before_the_plant_with_open_pads_is_safe() -> None:
    for kind in ("joints silent", "paused"):
        assert unsafe(machines(to_the_stem(back=0.2)), plan(), replace(CASE, kind=kind), 2.5) == ""


@pytest.mark.parametrize(
    ("joints", "opening", "case", "why"),
    [
        (to_the_stem(last=0.0)[:150], 0.04, CASE, "arm moves"),
        (to_the_stem(), 0.008, CASE, "not open"),
        (to_the_stem(back=0.2), 0.008, CASE, "torn, not open"),
        (to_the_stem(), 0.04, replace(CASE, kind="the master dies"), "not back"),
        (np.vstack([to_the_stem()[:200], to_the_stem()[:200]]), 0.04, CASE, "joint speed"),
        (to_the_stem() + np.eye(7)[0] * 4.0, 0.04, CASE, "joint range"),
        (jumping_back(), 0.04, replace(CASE, kind="paused"), "jumped"),
        (jumping_back(), 0.04, replace(CASE, kind="stale with noise"), "jumped"),
    ],
)
def test_what_is_not_safe_is_seen(joints: Array, opening: float, case: Case, why: str) -> None:
    assert why in unsafe(machines(joints, opening), plan(), case, STRUCK)


def test_pads_that_nothing_could_open_are_safe_while_the_arm_is_where_it_took_the_stem() -> None:
    held = machines(to_the_stem(), 0.008)
    for kind in ("kill -9", "gripper silent"):
        assert unsafe(held, plan(), replace(CASE, kind=kind), STRUCK) == ""
        torn = machines(to_the_stem(back=0.2), 0.008)
        assert unsafe(torn, plan(), replace(CASE, kind=kind), STRUCK) == "torn"


def test_what_a_node_told_before_it_died_says_nothing_of_the_end() -> None:
    """It may still have told a little while it was struck."""
    dead = machines(to_the_stem()[:150])
    for died in (1.49, 1.46):
        assert unsafe(dead, plan(), replace(CASE, kind="the robot's node dies"), died) == ""


def test_a_command_that_comes_late_is_no_speed() -> None:
    fast = STEM + (to_the_stem(back=0.1) - STEM) * 7.0  # 1.05 rad/s, of the 1.33 that the slowest joint may
    assert "joint speed" not in unsafe(machines(np.delete(fast, 100, axis=0)), plan(), CASE, STRUCK)


def test_the_time_to_rest_is_that_of_the_motion_that_was_struck() -> None:
    joints = to_the_stem(back=0.2)
    later = np.vstack([joints, joints[:250]])
    assert stop_time(machines(later), at=1.5) == pytest.approx(3.0 - 1.5, abs=0.03)
    assert stop_time(machines(joints[:250]), at=1.5) == float("inf")


def test_every_kind_strikes_in_every_phase() -> None:
    cases = [draw(number, 0) for number in range(len(FIRST) * len(PHASES))]
    assert {(case.kind, case.phase) for case in cases} == {(kind, phase) for kind in FIRST for phase in PHASES}
    for kind in EXPECTED:
        some = [draw(number, 0, kind) for number in range(len(PHASES))]
        assert {case.kind for case in some} == {kind}
        assert {case.phase for case in some} == set(PHASES)
    assert draw(7, 0) == draw(7, 0) != draw(7, 1)


def test_the_published_campaign_is_drawn_today_as_it_was() -> None:
    """A kind that is added changes no case that is drawn by number alone."""
    published = json.loads((RESULTS / "protocol_faults.json").read_text())["metrics"]
    drawn = Counter(draw(number, 1).kind for number in range(1000))
    assert set(drawn) == set(FIRST) <= set(EXPECTED)
    for kind, count in drawn.items():
        assert published[re.sub(r"[^a-z0-9]+", "_", kind.lower()).strip("_") + "_faults"] == count


def test_a_campaign_counts_all_that_its_folder_holds_each_case_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kinds that are added later join it."""
    struck = list[Case]()

    def strikes(case: Case, base: Path, folder: Path) -> dict[str, Any]:
        folder.mkdir(parents=True)
        struck.append(case)
        good = {"unsafe": "", "record": "", "continued": "", "stop_s": None, "held_up": False}
        return good | ({"unsafe": "torn"} if case.kind == "pushed" and case.number == 1 else {})

    monkeypatch.setattr(protocol_faults, "prepare", lambda _: None)
    monkeypatch.setattr(protocol_faults, "struck", strikes)
    monkeypatch.setattr(protocol_faults, "ProcessPoolExecutor", lambda *_, **__: ThreadPoolExecutor(1))

    def metrics(*words: str) -> Any:
        told = tmp_path / "told.json"
        monkeypatch.setattr(sys, "argv", ["protocol_faults.py", "--out", str(tmp_path), "--json", str(told), *words])
        protocol_faults.main()
        return json.loads(told.read_text())

    first = metrics("--faults", "30")
    assert (first["faults"], first["safe_ends"], first["pushed_faults"]) == (30, 30, 1)
    assert len(struck) == 30
    both = metrics("--kinds", "pushed", "arm force stuck", "--each", "3")
    assert (both["faults"], both["safe_ends"], both["pushed_faults"], both["arm_force_stuck_faults"]) == (36, 35, 4, 3)
    assert metrics("--kinds", "arm force stuck", "--each", "2") == both
    assert len(struck) == 36
    assert metrics("--kinds", "arm force stuck", "--each", "4")["arm_force_stuck_faults"] == 4
    assert len(struck) == 37


def test_a_trial_may_finish_only_where_what_failed_is_needed_no_more() -> None:
    for kind in EXPECTED:
        for phase in PHASES:
            allowed = no_effect(Case(0, kind, phase, 0.5))
            if kind in GOES_ON or phase == "retreat":
                assert allowed
            elif kind in ("stop button", "kill -9", "joints silent", "side camera unplugged"):
                assert not allowed


@pytest.mark.parametrize(
    ("kind", "began", "before", "after", "again"),
    [
        ("pushed", True, "joints are 51 ms old", "", True),
        ("joints silent", True, "joints are 51 ms old", "", False),
        ("joints silent", False, "joints are 51 ms old", "", True),
        ("joints silent", True, "joints are 51 ms old", "joints are 51 ms old", True),
        ("pushed", True, "contact force 60 N", "", False),
        ("Ctrl-C", True, "Let nothing else run", "", True),
        ("paused", True, "Let nothing else run", "", False),
        ("paused", True, "", "Let nothing else run", True),
    ],
)
def test_a_case_begins_again_where_joints_came_late_by_themselves(
    kind: str, began: bool, before: str, after: str, again: bool
) -> None:
    assert held_up(replace(CASE, kind=kind), began, before, after) == again
