"""A load of the plant as that of a breeze."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sample_plants import branched, grasps_on
from scipy.stats import norm

from anther.core.errors import InputError
from anther.plant.limits import BREEZE, LOADED, PEAKS, TOLERANCE, WIND, Believed, Crop, breeze, like_breeze
from anther.plant.model import TOMATO, build_plant
from anther.pollination.shake import Params, plan_shake

CROPS: tuple[Crop, Crop] = ("tomato", "pepper")
ROWS = [(name, crop) for name in BREEZE for crop in CROPS]


@pytest.mark.parametrize(("name", "crop"), ROWS)
def test_the_table_gives_its_own_winds_and_grows_with_the_load(name: str, crop: Crop) -> None:
    loads = BREEZE[name][crop]
    assert [breeze(name, load, crop) for load in loads] == pytest.approx(WIND)
    assert np.all(np.diff([breeze(name, load, crop) or 0 for load in np.geomspace(loads[0], loads[-1], 30)]) > 0)


@given(st.sampled_from(ROWS), st.floats(1e-6, 1e4), st.floats(1e-6, 1e4))
def test_a_larger_load_is_no_smaller_wind(row: tuple[str, Crop], one: float, other: float) -> None:
    name, crop = row
    winds = [breeze(name, load, crop) for load in sorted((one, other))]
    assert WIND[0] - 1e-9 <= winds[0] <= winds[1] <= WIND[-1] + 1e-9  # type: ignore[operator]


def test_a_pepper_needs_more_wind_than_a_tomato() -> None:
    for name in BREEZE:
        assert np.all(BREEZE[name]["pepper"] < BREEZE[name]["tomato"])


def test_what_was_not_computed_is_left_empty() -> None:
    assert breeze(PEAKS["stem_strain"], 0.01, "tomato") is None
    assert breeze(PEAKS["base_strain"], 0.01, "tomato") is None
    assert like_breeze(PEAKS["stem_strain"], 0.01, "tomato") == ""
    assert like_breeze(PEAKS["joint_strain"], 0.01, None) == ""


def test_words_say_where_the_table_ends() -> None:
    assert like_breeze(PEAKS["joint_strain"], 1e-4, "tomato") == "2 m/s or less"
    assert like_breeze(PEAKS["joint_strain"], 0.5, "tomato") == "6 m/s or more"
    assert like_breeze(PEAKS["joint_strain"], BREEZE[PEAKS["joint_strain"]]["pepper"][1], "pepper") == "4.0 m/s"
    with pytest.raises(InputError, match="pedicel"):
        breeze(PEAKS["joint_strain"], -1.0, "tomato")


def test_the_names_are_those_of_a_plans_limits() -> None:
    skeleton, stem, flowers = branched()
    few = Params(frequencies=2, lowest=3, highest=4.9)
    plan = plan_shake(build_plant(skeleton, stem, flowers, None, TOMATO), grasps_on(skeleton, stem, [8]), params=few)
    assert set(BREEZE) <= {name for name, *_ in plan.limits}


@given(st.floats(1e-3, 10.0), st.floats(1.1, 30.0))
def test_a_belief_between_two_values_has_a_twentieth_on_either_side(low: float, times: float) -> None:
    belief = Believed.between(low, low * times)
    middle, spread = np.log(belief.median), belief.spread
    assert norm.cdf(np.log([low, belief.median, low * times]), middle, spread) == pytest.approx(
        [0.05, 0.5, 0.95], abs=1e-4
    )
    assert belief.low == pytest.approx(low)


def test_every_load_that_a_plant_limits_has_what_bears_it() -> None:
    organs = {"stem_strain": "stem", "joint_strain": "pedicel", "base_strain": "base", "leaf_load": "leaf"}
    assert {kind: TOLERANCE[organ] for kind, organ in organs.items()} == LOADED
    assert set(LOADED) == set(PEAKS)
