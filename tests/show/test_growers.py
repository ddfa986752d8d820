"""The growers' page computes what the function does, and what it says of today is what was measured."""

from __future__ import annotations

import math
import re
from dataclasses import asdict, fields
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from anther.core.errors import InputError
from anther.core.records import fields_of
from anther.show.fleet import Fleet, House, fleet_for
from evaluation.house.costs import ways

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "for_growers.md").read_text()
INPUTS = {
    name: (float(low), float(high), float(value))
    for name, low, high, value in re.findall(r'<input name="(\w+)"[^>]*min="(\S+)" max="(\S+)" value="(\S+)"', PAGE)
}
LIMITS = {f.name: (f.range.least, f.range.most) for f in fields_of(House) if f.range is not None}
FORMULAS = dict(re.findall(r'<output name="(\w+)" data-formula="([^"]+)"', PAGE))


def on_the_page(house: House) -> dict[str, float]:
    """What the page's formulas say, read as Python: they hold + - * / and Math.ceil alone."""
    known = dict(asdict(house))
    for name, formula in FORMULAS.items():
        assert re.fullmatch(r"(Math\.ceil|[\w\s+*/().-])+", formula)
        known[name] = eval(formula.replace("Math.ceil", "math.ceil"), {"math": math}, known)
    return {name: known[name] for name in FORMULAS}


def houses() -> st.SearchStrategy[House]:
    ranges = {name: st.floats(max(low, 1e-3), high) for name, (low, high) in LIMITS.items()}
    return st.builds(House, **ranges)


@given(houses())
def test_the_page_computes_what_the_function_does(house):
    assert on_the_page(house) == pytest.approx(asdict(fleet_for(house)), rel=1e-9)


def test_the_page_begins_with_the_same_house_and_limits():
    assert {name: value for name, (*_, value) in INPUTS.items()} == asdict(House())
    assert {name: (low, high) for name, (low, high, _) in INPUTS.items()} == LIMITS
    assert set(FORMULAS) == {field.name for field in fields(Fleet)}


def test_what_stands_there_before_any_script_runs_is_the_answer_of_today():
    today = asdict(fleet_for(House()))
    for name, digits, text in re.findall(r'<output name="(\w+)"[^>]*data-digits="(\d)"[^>]*>([\d.\u202f]+)', PAGE):
        assert float(text.replace("\u202f", "")) == pytest.approx(today.pop(name), abs=0.51 * 10.0 ** -int(digits))
    assert not today
    (way,) = (way for way in ways(DOCS / "results")[0] if way.name == "10 views, watched")
    assert House().seconds == round(way.seconds, 1)
    assert f"**Today's honest answer is {fleet_for(House()).robots} robots for two hectares:**" in PAGE


def test_twice_as_quick_needs_half_and_more_work_never_less():
    assert fleet_for(House()).robots == 46
    assert fleet_for(House(seconds=13.8)).robots == 23
    assert fleet_for(House(seconds=1.2)).robots == 2
    assert fleet_for(House(move=5.0)).robots > 46
    assert fleet_for(House(days=4.0)).robots == 23
    assert fleet_for(House(years=16.0)).cost_per_visit < fleet_for(House()).cost_per_visit


def test_a_house_without_hours_is_refused():
    with pytest.raises(InputError, match="hours"):
        House(hours=0.0)
