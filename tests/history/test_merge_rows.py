"""Maps and shifts go from one history into another: the later pass holds, a visited stem is so, once is enough."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("ortools", reason="OR-Tools is not installed: pip install 'anther[row]'")
from test_row_map import Stems, house
from test_shift import Robots, planted, shift

from anther.core.errors import InputError
from anther.history import (
    House,
    Order,
    Report,
    begin_shift,
    count_trials,
    merge,
    read_shift,
    read_stems,
    record_house,
    record_pass,
    run_shift,
)


@pytest.fixture
def fleet(tmp_path: Path) -> str:
    return str(tmp_path / "fleet.sqlite")


@pytest.fixture
def robot(tmp_path: Path) -> str:
    return str(tmp_path / "robot.sqlite")


def map_of(where: str) -> list[Any]:
    return [replace(stem, number=0) for stem in read_stems("north", where)]


def test_what_a_robot_did_of_a_shift_while_it_was_offline_is_known_to_the_fleet(fleet: str, robot: str) -> None:
    planted(fleet, rows=1, stems=2)
    number = begin_shift(shift(), fleet)
    planted(robot, rows=2)  # so that stems and shifts have other numbers there
    begin_shift(shift(days=3), robot)
    merge(fleet, robot)
    own, robots = 2, Robots()

    def stops(order: Order) -> Report:
        if len(robots.orders) == 3:
            raise KeyboardInterrupt
        return robots(order)

    with pytest.raises(KeyboardInterrupt):
        run_shift(own, stops, robot, simulated=True)
    done = merge(robot, fleet)
    assert done.new >= 3
    assert merge(robot, fleet).new == 0
    assert [s.plant for s in read_shift(number, fleet) if s.state == "visited"] == sorted(
        o.plant for o in robots.orders
    )
    assert {s.state for s in read_shift(number, fleet)} == {"visited", "waiting"}
    rest = Robots()
    found = run_shift(number, rest, fleet, simulated=True)
    assert {s.state for s in found} == {"visited"}
    assert {o.plant for o in rest.orders}.isdisjoint(o.plant for o in robots.orders)
    assert len({s.visit for s in found}) == len(found) == 4 == count_trials(fleet)


def test_a_map_goes_over_whole_and_the_later_pass_holds(fleet: str, robot: str) -> None:
    stems = Stems()
    record_house(house(), fleet)
    record_pass(stems.seen(0), fleet)
    merge(fleet, robot)
    assert map_of(robot) == map_of(fleet)
    stems.at += 0.2
    record_pass(stems.seen(1, skip=(5,)), robot)
    assert map_of(robot) != map_of(fleet)
    assert merge(fleet, robot).new == 0, "the older one tells nothing"
    merge(robot, fleet)
    assert map_of(robot) == map_of(fleet)
    assert merge(robot, fleet).new == 0
    stems.at += 0.2
    record_pass(stems.seen(2), fleet)  # and it can be gone on with
    assert len(map_of(fleet)) >= len(map_of(robot))


def test_stems_that_only_the_older_map_has_leave_it(fleet: str, robot: str) -> None:
    stems = Stems()
    for where in (fleet, robot):
        record_house(house(), where)
    record_pass(stems.seen(0), fleet)
    late = stems.seen(1)
    record_pass(late, robot)
    few = replace(
        late, time=late.time + timedelta(days=3), position=late.position[:3], appearance=late.appearance[:3],
        appearance_std=late.appearance_std[:3], open_flowers=late.open_flowers[:3], fruit=late.fruit[:3],
    )  # fmt: skip
    other = str(Path(robot).with_name("third.sqlite"))
    record_house(house(), other)
    record_pass(few, other)
    merge(other, robot)
    assert len(map_of(robot)) == 3
    assert [stem.position for stem in map_of(robot)] == [stem.position for stem in map_of(other)]


def test_another_crop_is_refused(fleet: str, robot: str) -> None:
    record_house(house(), fleet)
    record_house(House("north", "pepper", house().rows), robot)
    with pytest.raises(InputError, match="Is it another house"):
        merge(robot, fleet)
