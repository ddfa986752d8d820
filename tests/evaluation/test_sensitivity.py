"""The sensitivity run: constants are found and moved as meant, and a changed decision is noticed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from anther.perception.flowers import PEDICEL
from evaluation import sensitivity
from evaluation.constants import Constant, compiled, constants, scaled, with_moved
from evaluation.decisions import changed

SOURCE = """
from math import pi
A, B = range(2)
WIDE: float = 0.5
PAIR, OTHER = 3, "text"
HALF = WIDE / 2
def wide(x=WIDE):
    return x + WIDE
"""


@pytest.mark.parametrize(
    ("value", "up", "down"),
    [
        (4.0, 6.0, 4 / 1.5),
        (-2.0, -3.0, -2 / 1.5),
        (0.9, 1 - 0.1 / 1.5, 0.6),  # a share stays one
        (10, 15, 7),
        (1, 2, 0),  # a count of one moves too
        (True, True, True),
        ("text", "text", "text"),
        ((2, 4.0), (3, 6.0), (1, 4 / 1.5)),
        ({"m": 1.0}, {"m": 1.5}, {"m": 1 / 1.5}),
    ],
)
def test_a_value_is_moved_within_its_meaning(value: object, up: object, down: object) -> None:
    assert scaled(value, 1.5) == pytest.approx(up) if not isinstance(value, str) else scaled(value, 1.5) == up
    assert scaled(value, 1 / 1.5) == pytest.approx(down) if not isinstance(value, str) else True


def test_floats_of_an_array_move_and_labels_do_not() -> None:
    assert scaled(np.ones(2), 1.5).tolist() == [1.5, 1.5]
    assert scaled(np.ones(2, dtype=np.uint8), 1.5).tolist() == [1, 1]


def test_names_with_numbers_count_and_labels_do_not(tmp_path: Path) -> None:
    module = tmp_path / "anther" / "room" / "part.py"
    module.parent.mkdir(parents=True)
    module.write_text(SOURCE)
    assert [c[:3] for c in constants(tmp_path)] == [
        ("anther.room.part", "WIDE", "0.5"),
        ("anther.room.part", "PAIR", "3"),
        ("anther.room.part", "HALF", "WIDE / 2"),
    ]
    assert sensitivity.counted(constants(tmp_path)) == {"constants": 3, "constants_room": 3}


def test_what_is_derived_from_a_constant_moves_with_it() -> None:
    module: dict[str, object] = {}
    exec(compile(with_moved(SOURCE, "WIDE", 1.5), "part.py", "exec"), module)
    assert (module["WIDE"], module["HALF"], module["PAIR"]) == (0.75, 0.375, 3)
    assert module["wide"]() == 1.5  # type: ignore[operator]


def test_a_copy_in_another_module_moves_with_the_constant() -> None:
    words = (
        "from evaluation.constants import Constant, arrange\n"
        "arrange(Constant('anther.perception.stem._organs', 'PEDICEL'), 2.0)\n"
        "from anther.perception import flowers\n"
        "print(flowers.PEDICEL)"
    )
    done = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=True)
    assert float(done.stdout) == pytest.approx(2 * PEDICEL)


def test_kernels_that_hold_a_constant_are_compiled_anew() -> None:
    assert compiled(Constant("anther.perception.cloud._fusion", "SEEN_THROUGH"))
    assert not compiled(Constant("anther.perception.flowers", "APART"))


STRAIGHT = [[0.0, 0.0, 0.01 * k] for k in range(20)]


@pytest.mark.parametrize(
    ("after", "differs"),
    [
        ({"line": STRAIGHT, "within": 0.005}, False),
        ({"line": [[0.001, 0, z] for _, _, z in STRAIGHT], "within": 0.005}, False),
        ({"line": STRAIGHT[:15], "within": 0.005}, True),
        ({"line": [[0.01, 0, z] for _, _, z in STRAIGHT], "within": 0.005}, True),
    ],
)
def test_a_line_that_ends_or_lies_elsewhere_is_another(after: dict[str, object], differs: bool) -> None:
    before = {"case": {"stem": {"line": STRAIGHT, "within": 0.005}}}
    assert changed(before, {"case": {"stem": after}}) == ({"stem": ["case"]} if differs else {})


def test_places_of_a_tree_are_not_joined_in_their_order() -> None:
    tree = [[0.0, 0.0, 0.1 * k] for k in range(10)] + [[1.0, 0.0, 0.5]]
    before = {"case": {"skeleton": {"places": tree, "within": 0.06}}}
    assert not changed(before, {"case": {"skeleton": {"places": [[x, y, z + 0.05] for x, y, z in tree]}}})
    elsewhere = [*tree[:-1], [0.5, 0.0, 0.7]]  # on the way from the last node of the stem to the branch
    assert changed(before, {"case": {"skeleton": {"places": elsewhere}}})


def test_decisions_of_every_kind_are_compared() -> None:
    before = {
        "one": {
            "flowers": {"points": [[0, 0, 0], [0, 0, 1]], "within": 0.1},
            "mass": {"ratio": 10.0, "within": 0.05},
            "recall": {"share": 0.9, "within": 0.02},
            "notes": {"words": "2 views are blind"},
        }
    }
    same = {
        "flowers": {"points": [[0, 0, 1], [0, 0, 0.05]]},
        "mass": {"ratio": 10.4},
        "recall": {"share": 0.89},
        "notes": {"words": "3 views are blind"},
    }
    other = {
        "flowers": {"points": [[0, 0, 0]]},
        "mass": {"ratio": 11.0},
        "recall": {"share": 0.8},
        "notes": {"words": "no plant"},
    }
    assert not changed(before, {"one": same})
    assert changed(before, {"one": other}) == {name: ["one"] for name in other}
    assert changed(before, {"one": {"failure": {"words": "no plant"}}}) == {"result": ["one"]}


def test_a_suite_that_fails_counts_as_a_changed_decision() -> None:
    quiet = {"cases": 4, "1.50": {}, "0.67": {}}
    assert sensitivity.worst(quiet) == 0
    assert sensitivity.worst(quiet | {"0.67": {"main stem": ["a"], "grasp": ["a", "b"]}}) == 0.5
    assert sensitivity.worst(quiet | {"1.50": {"failed": "ZeroDivisionError"}}) == 1
