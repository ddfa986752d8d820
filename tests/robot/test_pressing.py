"""How hard pads press, what a stem bears of it, and what friction bears then."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anther.core.errors import InputError
from anther.pollination.shake.pads import friction_force
from anther.robot.pressing import PRESSING, Pressing

RADIUS, WIDTH = 4e-3, 16e-3


def test_the_pressure_is_hertzs() -> None:
    by_hand = np.sqrt(8 * 1e6 / 0.75 / (np.pi * 0.016 * 0.0025))
    assert PRESSING.stress(8.0, 0.005) == pytest.approx(by_hand)


@given(st.floats(1e-3, 0.02), st.floats(1.1, 3), st.floats(1e5, 1e9))
def test_a_thinner_stem_and_a_harder_pad_are_pressed_less_and_none_is_crushed(
    diameter: float, factor: float, modulus: float
) -> None:
    pads = Pressing(pad_modulus=modulus, holding=100.0)
    most = pads.most(diameter)
    assert pads.most(diameter * factor) >= most >= Pressing(pad_modulus=modulus * factor, holding=100.0).most(diameter)
    assert pads.stress(most, diameter) < pads.stem_stress
    assert Pressing(pad_modulus=modulus).most(diameter) <= PRESSING.holding


@given(st.floats(1e-3, 0.02))
def test_a_gripper_is_asked_for_the_share_of_what_a_stem_bears(diameter: float) -> None:
    hard = Pressing(pad_modulus=1e8, holding=100.0)  # so hard that it is the stem that decides
    assert hard.stress(hard.most(diameter) / 0.7, diameter) == pytest.approx(hard.stem_stress)


def test_hard_pads_are_not_asked_to_hold_a_thin_stem_as_a_thick_one() -> None:
    hard = Pressing(pad_modulus=2e7)
    assert hard.most(0.004) < hard.most(0.008) < PRESSING.most(0.004)


@pytest.mark.parametrize("wrong", [{"holding": 0.0}, {"stem_stress": 1e9}, {"pad_width": 1.0}, {"pad_modulus": np.inf}])
def test_what_nobody_could_mean_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong)).split("_")[0]):
        Pressing(**wrong)


@given(st.floats(-0.999, 0.999), st.floats(0.1, 20), st.floats(0.2, 1.2))
def test_a_line_that_slides_across_itself_and_turns_slides_when_this_says(c: float, press: float, mu: float) -> None:
    """Friction summed up along the line by hand, of two pads."""
    x = (np.arange(20000) + 0.5) / 20000 * WIDTH - WIDTH / 2
    pull = 2 * mu * press / len(x) * np.sign(x - c * WIDTH / 2)
    force, pivot = np.array(abs(pull.sum())), np.array(abs((x * pull).sum()))
    zero = np.array(0.0)
    assert friction_force(force, pivot, zero, radius=RADIUS, width=WIDTH) == pytest.approx(2 * mu * press, rel=1e-3)


@given(st.floats(0, np.pi), st.floats(-1.5, 1.5))
def test_a_line_that_slides_any_other_way_needs_no_more_than_this_asks_for(way: float, c: float) -> None:
    """The line's middle moves in a direction `way`, and the line turns about it."""
    x = (np.arange(20000) + 0.5) / 20000 * WIDTH - WIDTH / 2
    moves = np.stack([np.full(len(x), c * WIDTH * np.cos(way)), c * WIDTH * np.sin(way) + x])
    pull = moves / np.maximum(np.linalg.norm(moves, axis=0), 1e-12) / len(x)
    force, pivot = np.array(np.linalg.norm(pull.sum(axis=1))), np.array(abs((x * pull[1]).sum()))
    assert friction_force(force, pivot, np.array(0.0), radius=RADIUS, width=WIDTH) >= 1 - 1e-3


@given(st.floats(1e-6, 50), st.floats(1e-6, 0.2), st.floats(1e-6, 0.2), st.floats(1.01, 3))
def test_more_force_more_moment_and_a_shorter_lever_ask_for_more(f: float, t: float, m: float, more: float) -> None:
    def asked(f: float, t: float, m: float, radius: float = RADIUS, width: float = WIDTH) -> float:
        return float(friction_force(np.array(f), np.array(t), np.array(m), radius=radius, width=width))

    e = asked(f, t, m)
    assert e == pytest.approx(asked(more * f, more * t, more * m) / more)
    assert e >= max(f, 4 * t / WIDTH, m / RADIUS) * (1 - 1e-9)
    for harder in (
        asked(more * f, t, m),
        asked(f, more * t, m),
        asked(f, t, more * m),
        asked(f, t, m, RADIUS / more),
        asked(f, t, m, width=WIDTH / more),
    ):
        assert harder >= e * (1 - 1e-9)
    assert asked(f, 0, 0) == pytest.approx(f)
    assert asked(0, t, 0) == pytest.approx(4 * t / WIDTH)
