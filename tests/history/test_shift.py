"""Shifts: every stem is visited or has its reason, in its order, within the rules, after stops and kills."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from anther.core.errors import InputError, MissingExtra
from anther.history import (
    Block,
    Climate,
    House,
    Order,
    Report,
    Robot,
    Row,
    Shift,
    Side,
    begin_shift,
    count_trials,
    read_shift,
    read_stems,
    record_house,
    record_trial,
    run_shift,
    stop_robot,
)
from anther.history._shift_plan import CHARGE, Leg, RobotNow, assign_legs
from anther.history._tables import StemRow
from anther.plant import Visit

pytest.importorskip("ortools", reason="OR-Tools is not installed: pip install 'anther[row]'")
EIGHT = datetime(2026, 6, 1, 8, tzinfo=UTC)
KILLS = int(os.environ.get("ANTHER_KILLS", "8"))
ROOT = Path(__file__).parents[2]


def at(hours: float) -> datetime:
    return EIGHT + timedelta(hours=hours - 8)


def shift(**more: Any) -> Shift:
    asked = {"house": "h", "begin": EIGHT, "end": at(18), "robots": (Robot("a"), Robot("b"))}
    return Shift(**{**asked, **more})


def planted(where: str, rows: int = 2, stems: int = 4) -> None:
    side = Side({}, tuple(0.4 * (k + 1) for k in range(stems)))
    record_house(House("h", "tomato", tuple(Row(str(k), side, side) for k in range(rows))), where)


def visit(order: Order, **more: Any) -> Visit:
    good = {"held_unharmed": True, "flowers_moved": True, "robot": order.robot, "time": order.begin}
    return Visit(order.species, order.plant, **{**good, **more})


class Robots:
    """Robots that do what they are told, and what they were told."""

    def __init__(self, seconds: float = 12.0, stops: dict[str, int] | None = None, failure: str | None = None) -> None:
        self.orders: list[Order] = []
        self.seconds, self.stops, self.failure = seconds, stops or {}, failure

    def __call__(self, order: Order) -> Report:
        self.orders.append(order)
        ended = order.begin + timedelta(seconds=self.seconds + (120 if order.enters else 0))
        count = sum(o.robot == order.robot for o in self.orders)
        if self.stops.get(order.robot) == count:
            return Report(visit(order, held_unharmed=False, failure="device_fault"), ended, "its arm is stuck")
        if self.failure:
            return Report(visit(order, held_unharmed=False, failure=self.failure), ended)
        return Report(visit(order), ended)

    def of(self, robot: str) -> list[Order]:
        return [order for order in self.orders if order.robot == robot]


def ran(where: str, asked: Shift, robots: Robots) -> list[Any]:
    return run_shift(begin_shift(asked, where), robots, where, simulated=True)


def test_every_stem_is_visited_once_in_along_the_left_and_out_along_the_right(where: str) -> None:
    planted(where)
    robots = Robots()
    found = ran(where, shift(), robots)
    assert {(s.state, s.reason) for s in found} == {("visited", "pollinated")}
    assert len({s.visit for s in found}) == len(found) == 16 == count_trials(where)
    for row in "01":
        orders = [o for o in robots.orders if o.row == row]
        assert [(o.side, o.hook) for o in orders] == [("left", k) for k in range(4)] + [
            ("right", 3 - k) for k in range(4)
        ]
        assert [o.enters for o in orders] == [True] + [False] * 7
        assert len({o.robot for o in orders}) == 1, "one robot in a row"
    assert {o.robot for o in robots.orders} == {"a", "b"}, "two rows, two robots"
    assert min(o.begin for o in robots.orders) >= at(10)
    assert all(s.last_dose is not None for s in read_stems("h", where))


def test_only_what_is_due_is_visited_and_the_rest_says_why_not(where: str) -> None:
    planted(where, rows=1)
    stems = read_stems("h", where)
    for stem, hours in ((stems[0], -16), (stems[1], -48), (stems[2], -16)):
        record_trial(Visit("tomato", stem.plant, True, flowers_moved=True, time=at(8 + hours)), where)
    record_trial(Visit("tomato", stems[3].plant, True, flowers_moved=False, time=at(-8)), where)
    from anther.history._database import open_writer  # noqa: PLC0415

    with open_writer(where) as session:
        session.get_one(StemRow, stems[2].number).certainty = 0.6
        session.get_one(StemRow, stems[4].number).open_flowers = 0
    found = {s.plant: s for s in ran(where, shift(), Robots())}
    assert found[stems[0].plant].reason == "dosed on 2026-05-31"
    assert found[stems[4].plant].reason == "no open flower"
    assert {found[s.plant].state for s in (stems[0], stems[4])} == {"left"}
    assert {found[s.plant].state for s in (stems[1], stems[2], stems[3])} == {"visited"}, "due, unsure, never moved"


def test_no_robot_is_in_a_row_with_people_or_in_bad_air(where: str) -> None:
    planted(where)
    air = (Climate(at(8), 22, 70), Climate(at(10.05), 22, 85), Climate(at(11), 22, 70), Climate(at(14), 33, 60))
    asked = shift(blocks=(Block("0", at(9), at(13)),), climate=air)
    robots = Robots()
    found = ran(where, asked, robots)
    assert {s.state for s in found} == {"visited"}
    for order in robots.orders:
        end = order.begin + timedelta(seconds=12)
        assert end <= at(10.05) or at(11) <= order.begin < end <= at(14)
        assert order.row == "1" or order.begin >= at(13)


def test_what_can_never_be_reached_says_what_closed_it(where: str) -> None:
    planted(where)
    asked = shift(blocks=(Block("0", at(8), at(18), "spraying"),))
    found = ran(where, asked, Robots())
    assert {s.reason for s in found if s.row == "0"} == {"spraying"}
    assert {s.state for s in found if s.row == "1"} == {"visited"}
    planted(other := f"{where}" if "://" in where else f"{where}2")
    late = ran(other, shift(house="h", days=1, begin=at(15.9), end=at(16.5)), Robots(seconds=60))
    assert {s.reason for s in late if s.state == "left"} <= {"not reached by 16:30", "dosed on 2026-06-01"}
    assert not [s for s in late if s.state in ("waiting", "working")]


def test_a_robot_charges_before_it_is_empty(where: str) -> None:
    planted(where, rows=1, stems=30)
    robots = Robots()
    found = ran(where, shift(robots=(Robot("a", battery=600.0, charge=300.0),)), robots)
    assert {s.state for s in found} == {"visited"}
    begins = [o.begin for o in robots.orders]
    pauses = [k for k, (a, b) in enumerate(zip(begins, begins[1:], strict=False)) if (b - a).total_seconds() > 200]
    assert pauses, "60 stems of 12 s on 600 s"
    for first, last in zip([0, *(k + 1 for k in pauses)], [*pauses, len(begins) - 1], strict=True):
        assert (begins[last] - begins[first]).total_seconds() + 12 <= 600 - 120


def test_others_take_over_what_a_robot_leaves_and_its_row_waits_until_it_is_out(where: str) -> None:
    planted(where)
    robots = Robots(stops={"a": 3})
    found = ran(where, shift(), robots)
    assert {s.state for s in found} == {"visited"}
    stuck = robots.of("a")[-1]
    assert [o.robot for o in robots.orders if o.plant == stuck.plant] == ["a", "b"]
    later = [o.begin for o in robots.of("b") if o.row == stuck.row]
    assert min(later) >= stuck.begin + timedelta(minutes=30)


def test_without_robots_every_stem_says_so(where: str) -> None:
    planted(where)
    found = ran(where, shift(), Robots(stops={"a": 2, "b": 1}))
    assert sum(s.state == "visited" for s in found) == 1
    left = [s.reason for s in found if s.state == "left"]
    assert len(left) == 15
    assert all("its arm is stuck" in str(reason) for reason in left)


def test_a_failed_visit_is_a_visit_with_its_reason(where: str) -> None:
    planted(where, rows=1, stems=2)
    found = ran(where, shift(), Robots(failure="no_grasp_found"))
    assert {(s.state, s.reason) for s in found} == {("visited", "failed: no grasp found")}
    again = ran(where, shift(), Robots(failure="interrupted"))
    assert {(s.state, s.reason) for s in again} == {("left", "interrupted 2 times")}


def test_a_robot_that_is_given_up_from_outside_gives_its_stem_back(where: str) -> None:
    planted(where, rows=1, stems=2)
    number = begin_shift(shift(), where)

    class Gone(Exception):
        pass

    def dies(order: Order) -> Report:
        raise Gone(order.robot)

    with pytest.raises(Gone) as gone:
        run_shift(number, dies, where, simulated=True)
    assert [s.state for s in read_shift(number, where)].count("working") == 1
    known = at(11)  # long after it was heard of for the last time
    stop_robot(number, str(gone.value), "stands still", where, time=known)
    assert [s.state for s in read_shift(number, where)].count("waiting") == 4
    other, robots = {"a": "b", "b": "a"}[str(gone.value)], Robots()
    assert {s.state for s in run_shift(number, robots, where, robots=[other], simulated=True)} == {"visited"}
    assert min(order.begin for order in robots.orders) >= known + timedelta(minutes=30), "it stands in the row"


def test_bad_input_is_refused(where: str) -> None:
    planted(where)
    wrong = {
        "house 'south'": {"house": "south"},
        "row '7'": {"blocks": (Block("7", at(9), at(10)),)},
    }
    for message, more in wrong.items():
        with pytest.raises(InputError, match=message):
            begin_shift(shift(**more), where)
    broken = {
        "one day": {"end": at(40)},
        "each name once": {"robots": (Robot("a"), Robot("a"))},
        "battery of robot a": {"robots": (Robot("a", battery=100.0),)},
        "readings out of order": {"climate": (Climate(at(9), 20, 60), Climate(at(8), 20, 60))},
    }
    for message, more in broken.items():
        with pytest.raises(InputError, match=message):
            shift(**more)
    number = begin_shift(shift(), where)
    with pytest.raises(InputError, match="allowed: a, b"):
        run_shift(number, Robots(), where, robots=["c"])
    with pytest.raises(InputError, match="number of a shift"):
        read_shift(number + 1, where)
    with pytest.raises(InputError, match="plant that was ordered"):
        run_shift(number, lambda o: Report(visit(replace_plant(o)), o.begin), where, simulated=True)


def replace_plant(order: Order) -> Order:
    return order._replace(plant="another")


def test_a_shift_is_a_file(tmp_path: Path) -> None:
    asked = shift(blocks=(Block("0", at(9), at(13)),), climate=(Climate(at(8), 22, 70),))
    asked.save(tmp_path / "shift.json")
    assert Shift.load(tmp_path / "shift.json") == asked
    assert replace(asked, days=3) != asked


def test_a_plan_keeps_to_windows_batteries_and_one_robot_a_row() -> None:
    legs = [Leg(k, str(k // 2), 10, 1000, ((3000, 9000),) if k < 2 else ((0, 9000),)) for k in range(6)]
    robots = [RobotNow("a", 0, 1500, 4000, 600, (), None), RobotNow("b", 0, 4000, 4000, 600, ("1",), None)]
    steps = assign_legs(legs, robots, 1)
    assert sorted(n for of in steps.values() for n in of if n != CHARGE) == list(range(6))
    assert set(steps["b"]) <= {2, 3}
    assert CHARGE in steps["a"], "1500 s of battery last for one leg"
    assert steps["a"].index(CHARGE) <= 1
    shut = assign_legs([Leg(0, "0", 10, 1000, ((0, 900),))], robots, 1)
    assert shut == {"a": [], "b": []}


def test_a_plan_leaves_ctrl_c_to_those_who_hold_the_arm() -> None:
    code = """if True:
        import os, signal
        from anther.history._shift_plan import Leg, RobotNow, assign_legs
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background processes would ignore Ctrl-C
        assign_legs([Leg(0, "0", 10, 100, ((0, 900),))], [RobotNow("a", 0, 1500, 4000, 600, (), None)], 1)
        try:
            os.kill(os.getpid(), signal.SIGINT)
        except KeyboardInterrupt:
            print("held")
    """
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert ran.stdout == "held\n", ran.returncode


def test_without_or_tools_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ortools.sat.python", None)
    with pytest.raises(MissingExtra, match=r"anther\[row\]"):
        assign_legs([], [], 1)


@pytest.mark.slow
def test_after_kills_nothing_is_lost_or_doubled(tmp_path: Path) -> None:
    """A program that runs the shift is killed at any moment and started again."""
    where = str(tmp_path / "history.sqlite")
    planted(where, rows=2, stems=30)
    number = begin_shift(shift(), where)
    code = f"""if True:
        import sys, time
        sys.path[:0] = [r"{ROOT / "tests" / "history"}"]
        from anther.history import run_shift
        from test_shift import Robots
        class Slow(Robots):
            def __call__(self, order):
                time.sleep(0.005)
                return super().__call__(order)
        run_shift({number}, Slow(), r"{where}", simulated=True)
    """
    kills = 0
    while kills < KILLS:
        done = count_trials(where)
        with subprocess.Popen([sys.executable, "-c", code], cwd=ROOT) as process:
            while count_trials(where) <= done and process.poll() is None:
                time.sleep(0.01)
            time.sleep(0.007 * (kills % 5))
            assert process.poll() is None, "it ended before it was killed often enough"
            os.kill(process.pid, signal.SIGKILL)
        kills += 1
    found = run_shift(number, Robots(), where, simulated=True)
    assert {s.state for s in found} <= {"visited", "left"}
    assert {s.reason for s in found if s.state == "left"} <= {"interrupted 2 times"}
    visits = [s.visit for s in found if s.state == "visited"]
    assert len(set(visits)) == len(visits) == count_trials(where)
