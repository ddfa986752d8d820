"""The arithmetic of a hectare: it follows from the runs it reads, and from nothing that is not said."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from anther.history import Robot
from evaluation.house.costs import DAYS, HOURS, Way, costs_of, ways
from evaluation.house.shift import STEMS_HA

RUNS = {
    "long/grasping": {f"{part}_{views}_s": 2.0 for part in ("capture", "compute", "reach", "shake", "retreat")
                      for views in ("30_views", "fast")},
    "long/shaking": {"robot_s_arm": 9.0, "robot_s_plan": 5.0},
    "shift": {"seconds_per_stem": 30.0, "at_a_stem_s": 27.0},
    "rows": {"cycle_s": 25.0},
}  # fmt: skip


@pytest.fixture
def results(tmp_path: Path) -> Path:
    for name, metrics in RUNS.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / f"{name}.json").write_text(json.dumps({"metrics": metrics}))
    return tmp_path


def test_a_visit_is_the_sum_of_its_timed_parts(results: Path) -> None:
    found, driving = ways(results)
    assert {way.name: way.seconds for way in found if way.timed} == {
        "30 views, watched": 14.0, "10 views, watched": 14.0, "10 views, plan alone": 10.0,
        "6 views in a row, watched": 25.0,
    }  # fmt: skip
    assert driving == pytest.approx(3.0)
    assert [way.seconds for way in found if not way.timed] == [12.0, 8.0], "nobody timed these"


def test_robots_work_every_visit_within_the_hours_and_charge() -> None:
    costs = costs_of(1.0, Way("any", 6, 12.0, False), 3.0, 1000.0)
    robot = Robot("any")
    visits = STEMS_HA / DAYS
    assert costs["robot_hours_a_day"] == pytest.approx(visits * 15 / 3600)
    hours = visits * 15 / 3600 * (1 + robot.charge / robot.battery)
    assert costs["robots"] == math.ceil(hours / HOURS)
    assert costs["history_gb_a_year"] == pytest.approx(visits * 287 * 1000 / 1e9)
    ten = costs_of(10.0, Way("any", 6, 12.0, False), 3.0, 1000.0)
    assert ten["kwh_a_day"] == pytest.approx(10 * costs["kwh_a_day"])
    assert 10 * (costs["robots"] - 1) < ten["robots"] <= 10 * costs["robots"]
