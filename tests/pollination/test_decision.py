"""What a shake is worth: pollen that it frees less what it costs, of any plant, by one rule."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from anther.core.geometry import Array
from anther.plant.limits import (
    DOSE_MEASURES,
    GUSTS,
    HALF_DOSE,
    STALK_SPREAD,
    TOLERANCE,
    Believed,
    stalk_strain,
)
from anther.pollination import decision
from anther.pollination.decision import (
    COSTS,
    ERRORS,
    OBSERVED_ERRORS,
    PRICES,
    Answer,
    Worth,
    believed,
    expected,
    worth,
)
from anther.pollination.escalation._knowledge import Prediction
from anther.pollination.escalation._option import ACTUATOR, WORDS, Option

SIZES = np.geomspace(1e-6, 1.0, 1500)
BANDS = (6.0, 17.0, 28.0, 70.0)  # Hz
HELD, SLOW = 8.0, 0.9 * GUSTS
ORGANS = {"base_strain": "base", "stem_strain": "stem", "leaf_load": "leaf"}
BORNE = {"grip_force": Believed(1.0, 0.25)} | {k: TOLERANCE[organ] for k, organ in ORGANS.items()}
UNIT = {kind: believed.median / 0.05 for kind, believed in BORNE.items()} | {"grip_force": HELD / 0.05}
"""By kind what reaches the median of what is borne at 50 mm."""
UNITY = np.ones(1)
LOOKS = [None, np.ones(2, dtype=bool), np.array([True, False])]


def made(flowers: Any = (2e3, 4e3), **loads: Any) -> Answer:
    """Return an answer of members (M,), each with the flowers; a load that is not given is none."""
    given = {kind: np.atleast_1d(np.asarray(value, dtype=float)) for kind, value in loads.items()}
    members = max([1, *(len(value) for value in given.values())])
    felt = np.broadcast_to(np.asarray(flowers, dtype=float), (members, len(np.atleast_1d(flowers))))
    parts = {kind: np.broadcast_to(given.get(kind, np.zeros(1)), members) for kind in COSTS}
    return Answer(felt, parts["base_strain"], parts["stem_strain"], parts["leaf_load"], parts["grip_force"])


def whole(share: float = 1.0) -> Answer:
    """Return an answer in which everything is loaded."""
    return made(**{kind: share * value for kind, value in UNIT.items()})


def found(answer: Answer, sizes: Array = SIZES, hertz: float = SLOW, price: float = 3.0, seen: Any = None) -> Worth:
    return worth(answer, sizes, hertz, HELD, price, seen)


def best(answer: Answer, **how: Any) -> float:
    """Return the amplitude that is worth most; it must not be the largest of all."""
    at = int(found(answer, **how).net.argmax())
    assert at < len(SIZES) - 1
    return float(SIZES[at])


def test_what_does_not_move_is_worth_nothing_and_costs_nothing() -> None:
    still = found(whole(), np.zeros(1))
    for part in (still.gain, still.lost, still.net, *still.bent.values()):
        assert part == pytest.approx([0.0], abs=1e-9)


@pytest.mark.parametrize("hertz", [2.0, 9.0, 30.0])
@pytest.mark.parametrize("seen", LOOKS)
def test_gain_and_losses_are_shares_that_rise_with_the_amplitude(hertz: float, seen: Any) -> None:
    told = found(whole(), hertz=hertz, seen=seen)
    leafless = {kind: share for kind, share in told.bent.items() if kind != "leaf_load" or hertz <= GUSTS}
    for share in (told.gain, told.lost, *leafless.values()):
        assert np.all(np.diff(share) >= 0)
        assert 0 <= share[0] < 0.01
        assert 0.9 < share[-1] <= 1
    assert np.all(told.net <= told.gain)
    assert told.net == pytest.approx(
        (1 - told.bent["grip_force"]) * told.gain
        - 3.0 * (told.lost + sum(COSTS[kind] * told.bent[kind] for kind in COSTS))
    )


def test_the_dearer_a_flower_the_gentler_the_shake() -> None:
    sizes = [best(whole(), price=price) for price in (100.0, PRICES["gentle"], PRICES["default"], PRICES["bold"], 0.1)]
    assert np.all(np.diff(sizes) > 0)
    worths = [found(whole(), price=PRICES[name]).net.max() for name in ("gentle", "default", "bold")]
    assert np.all(np.diff(worths) > 0), "nor is what is worth less ever worth more"


@pytest.mark.parametrize("kind", UNIT)
def test_each_load_binds_alone_and_the_earlier_the_larger_it_is(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(COSTS, kind, max(COSTS[kind], 1.0))
    sizes = [best(made(5e2, **{kind: times * UNIT[kind]}), price=5.0) for times in (0.0, 1.0, 2.0, 4.0)]
    assert np.all(np.diff(sizes) < 0)


def test_what_costs_nothing_has_no_end_and_a_flower_bears_no_more_than_its_pedicel() -> None:
    assert int(found(made(2e4), price=0.0).net.argmax()) == len(SIZES) - 1
    median = TOLERANCE["pedicel"].median / stalk_strain(SLOW) / float(expected("flowers", np.array([2e4]), SLOW))
    assert found(made(2e4), np.array([median])).lost == pytest.approx([0.5])


def test_of_two_flowers_that_feel_the_same_the_faster_is_bent_less() -> None:
    slow, middle, fast = (float(stalk_strain(hertz)) for hertz in (3.0, 17.0, 68.0))
    assert slow == middle == pytest.approx(2 * fast)


def test_a_leaf_and_a_slip_cost_less_than_one_of_six_flowers_and_a_stem_more_than_all() -> None:
    assert max(COSTS["base_strain"], COSTS["leaf_load"], COSTS["grip_force"]) < 1 / 6 < 1 < COSTS["stem_strain"]


def test_one_flower_that_swings_further_lowers_the_amplitude_but_less_than_if_all_did() -> None:
    gentle, one, all_of_them = (best(made(each)) for each in ((2e3, 2e3), (2e3, 2e4), (2e4, 2e4)))
    assert all_of_them < one < gentle


def test_leaves_count_up_to_the_pace_of_gusts_and_not_above() -> None:
    leafy, bare = made(leaf_load=UNIT["leaf_load"]), made()
    slow, fast = (found(leafy, hertz=hertz) for hertz in (GUSTS, 1.001 * GUSTS))
    assert slow.net[-1] < found(bare, hertz=GUSTS).net[-1]
    assert fast.net == pytest.approx(found(bare, hertz=1.001 * GUSTS).net)
    twice = Answer(*(np.stack([part, part], axis=1) for part in leafy))
    both = worth(twice, np.tile(SIZES[:, None], 2), np.array([GUSTS, 1.001 * GUSTS]), HELD, 3.0)
    assert both.net == pytest.approx(np.column_stack([slow.net, fast.net])), "each by its own frequency"


def widened(table: Mapping[str, Any], kind: str, times: float) -> dict[str, Any]:
    """Return a table of errors in which one kind's are so much wider."""
    *middle, spread = table[kind]
    return {**table, kind: (*middle, tuple(times * s for s in spread))}


@pytest.mark.parametrize(
    ("table", "kind", "seen"),
    [*(("ERRORS", kind, None) for kind in ERRORS), *(("OBSERVED_ERRORS", kind, LOOKS[2]) for kind in ERRORS)],
)
def test_the_less_is_known_of_a_load_the_gentler_the_shake(
    table: str, kind: str, seen: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(decision, "COSTS", dict.fromkeys(COSTS, 1.0))  # dear enough to stop short of the median
    answer = made((2e3, 2e3)) if kind == "flowers" else made((2e2, 2e2), **{kind: UNIT[kind]})
    known = best(answer, seen=seen)
    monkeypatch.setattr(decision, table, widened(getattr(decision, table), kind, 2.0))
    assert best(answer, seen=seen) < known


def test_a_flower_that_was_not_measured_counts_with_the_errors_of_those() -> None:
    """Half of what both measured and both other flowers would be; the plant's other loads are those of a look."""
    alike = whole()._replace(flowers=np.full((1, 2), 3e3))
    half, seen, unseen = (found(alike, seen=np.array(look, dtype=bool)) for look in ([1, 0], [1, 1], [0, 0]))
    assert half.gain == pytest.approx((seen.gain + unseen.gain) / 2)
    assert half.lost == pytest.approx((seen.lost + unseen.lost) / 2)
    assert not np.allclose(seen.lost, unseen.lost)
    for kind in COSTS:
        assert half.bent[kind] == pytest.approx(unseen.bent[kind])


def test_a_flower_that_was_measured_is_known_best() -> None:
    for hertz in np.geomspace(2.0, BANDS[-1], 20):
        spreads = [float(believed("flowers", UNITY, hertz, measured)[1]) for measured in (True, False, None)]
        assert spreads[0] < 1.15 * min(spreads[1:])


@pytest.mark.parametrize("hertz", [3.0, 10.0, 28.0])
@pytest.mark.parametrize("seen", LOOKS)
def test_the_closed_form_is_the_mean_over_members_errors_and_what_is_borne(hertz: float, seen: Any) -> None:
    """Losses are exact; the dose-response is nearly a probit."""
    rng, count, size = np.random.default_rng(0), 100_000, 0.01
    answer = whole()._replace(flowers=np.array([[2e3, 4e2], [5e2, 1e4], [3e3, 3e3]]))
    members = {kind: np.array([0.3, 1.0, 4.0]) * UNIT[kind] for kind in COSTS}
    answer = answer._replace(**members)
    told, pick, shape = found(answer, np.array([size]), hertz, seen=seen), rng.integers(3, size=count), (count, 2)

    def true(values: Array, kind: str, look: bool | None) -> Array:
        logs, spread = believed(kind, values, hertz, look)
        return size * np.exp(logs[pick] + rng.normal(0.0, spread, (count, *values.shape[1:])))

    looks = [None, None] if seen is None else [bool(one) for one in seen]
    felt = np.column_stack([true(answer.flowers[:, f], "flowers", looks[f]) for f in (0, 1)])
    half = HALF_DOSE.median * np.exp(HALF_DOSE.spread * rng.normal(size=shape))
    for measure, (power, _) in DOSE_MEASURES.items():
        dose = felt * (hertz / 10.0) ** power
        assert told.freed[measure] == pytest.approx(np.mean(dose**1.5 / (dose**1.5 + half**1.5)), abs=0.02)
        assert told.by(measure) - told.net == pytest.approx(
            (1 - told.bent["grip_force"]) * (told.freed[measure] - told.gain)
        )
    assert told.gain == pytest.approx(sum(share * told.freed[measure] for measure, (_, share) in DOSE_MEASURES.items()))
    borne = {k: b.median * np.exp(b.spread * rng.normal(size=shape)) for k, b in BORNE.items()}
    stalks = felt * stalk_strain(hertz) * np.exp(STALK_SPREAD * rng.normal(size=shape))
    pedicel = TOLERANCE["pedicel"].median * np.exp(TOLERANCE["pedicel"].spread * rng.normal(size=shape))
    assert told.lost == pytest.approx(np.mean(stalks > pedicel), abs=0.01)
    for kind in COSTS:
        load = true(getattr(answer, kind), kind, None if seen is None else True) / (HELD if kind == "grip_force" else 1)
        share = 0.0 if kind == "leaf_load" and hertz > GUSTS else np.mean(load > borne[kind][:, 0])
        assert told.bent[kind] == pytest.approx(share, abs=0.01)


@pytest.mark.parametrize("seen", [None, True, False])
@pytest.mark.parametrize("kind", ERRORS)
def test_no_error_jumps_from_one_frequency_to_the_next(kind: str, seen: bool | None) -> None:
    hertz = np.geomspace(0.5, 200.0, 5000)
    known = {"flowers": OBSERVED_ERRORS["measured_flowers"]} if seen else {}
    table = ERRORS if seen is None else {**OBSERVED_ERRORS, **known}
    for values in (0.1, 10.0):
        middle, spread = believed(kind, values * (2 * np.pi * hertz[None]) ** 2, hertz, seen)
        assert middle.shape == (1, len(hertz))
        assert np.abs(np.diff(middle[0] - 2 * np.log(hertz))).max() < 0.02
        assert np.abs(np.diff(spread)).max() < 0.01
        assert min(table[kind][2]) - 1e-12 <= spread.min() <= spread.max() <= max(table[kind][2]) + 1e-12


@pytest.mark.parametrize("seen", [None, False])
@pytest.mark.parametrize("kind", sorted(set(ERRORS) - {"grip_force"}))
def test_what_is_believed_is_regressed_on_the_truth(kind: str, seen: bool | None) -> None:
    """ln(true / omega^2) is the intercept plus the slope times ln(modelled / omega^2) in the middle of each band."""
    for band, hertz in enumerate(BANDS):
        intercept, slope, spread = (row[band] for row in (ERRORS if seen is None else OBSERVED_ERRORS)[kind])
        omega2 = (2 * np.pi * hertz) ** 2
        for modelled in (0.02, 1.0, 7.0):
            logs, doubt = believed(kind, np.array([modelled * omega2]), hertz, seen)
            assert logs[0] - np.log(omega2) == pytest.approx(intercept + slope * np.log(modelled))
            assert float(doubt) == pytest.approx(spread)


def test_a_flower_that_was_measured_is_taken_as_measured_and_one_that_was_not_is_regressed() -> None:
    """Of many flowers the one that a model says to move most moves less than it says."""
    for hertz in BANDS[:3]:
        once, thrice = (np.array([times * (2 * np.pi * hertz) ** 2]) for times in (1.0, 3.0))
        ratios = [
            float(expected("flowers", thrice, hertz, look) / expected("flowers", once, hertz, look))
            for look in (True, None)
        ]
        assert ratios[0] == pytest.approx(3.0)
        assert 1.0 < ratios[1] < 3.0


@pytest.mark.parametrize("times", [0.1, 3.0])
def test_a_plant_that_answers_more_is_shaken_less(times: float) -> None:
    scaled = Answer(*(times * part for part in whole()))
    assert 1 < (best(whole()) / best(scaled)) ** np.sign(np.log(times)) < max(times, 1 / times) ** 1.1


def test_an_actuator_that_does_twice_what_it_is_told_is_told_half_and_one_that_is_unsure_less() -> None:
    """All loads err together with it, and the flowers too."""

    def net(amplitude: Array, mean: float, spread: float) -> Array:
        return worth(whole(), amplitude, SLOW, HELD, 3.0, delivered=(mean, spread)).net

    assert net(SIZES / 2, np.log(2), 0.0) == pytest.approx(found(whole()).net)
    sure, unsure = (float(SIZES[int(net(SIZES, 0.0, spread).argmax())]) for spread in (0.0, 1.0))
    assert unsure < sure


def test_what_is_added_by_a_plan_and_by_one_shake_is_the_same() -> None:
    """Shakes are weighed one by one, whatever the shape they are asked in."""
    grid = Answer(*(np.stack([part, 3 * part], axis=1) for part in whole()))
    together = worth(grid, np.tile(SIZES[:, None], 2), SLOW, HELD, 3.0).net
    for k, times in enumerate((1, 3)):
        assert together[:, k] == pytest.approx(found(Answer(*(times * part for part in whole()))).net)


def watched(answer: Answer, *, reach: float = 1.0, price: float = 3.0) -> Option:
    """Return a way to shake of which all flowers were seen and members say so."""
    count = answer.flowers.shape[-1]
    flowers, looked = np.exp(np.log(answer.flowers).mean(axis=0)), np.ones(count, dtype=bool)
    told = Prediction(flowers, looked, flowers, {}, answer, np.zeros((count, 3), dtype=complex))
    return Option(SLOW, HELD, price, 1e-3, reach, told)


def test_a_watched_shake_goes_as_far_as_it_is_worth_most_and_says_what_ends_it() -> None:
    option = watched(whole())
    here = best(whole(), seen=np.ones(2, dtype=bool))
    assert option.allowed.amplitude == pytest.approx(here, rel=0.15)
    assert option.predicted_worth == pytest.approx(found(whole(), seen=np.ones(2, dtype=bool)).net.max(), rel=0.02)
    for kind in UNIT:
        ends = watched(made((2e2, 2e2), **{kind: UNIT[kind]})).allowed.binds
        assert ends.endswith(f"first by {WORDS[kind]}")
    assert watched(made((2e3, 2e3))).allowed.binds.endswith(f"first by {WORDS['joint_strain']}")
    assert watched(whole(), reach=0.3 * here).allowed.binds == ACTUATOR
    assert watched(whole(), reach=0.3 * here).allowed.amplitude == pytest.approx(0.3 * here)


@pytest.mark.parametrize("kind", UNIT)
def test_a_watched_shake_goes_further_the_more_its_members_agree(kind: str) -> None:
    """About the same median."""
    exact, rough = (
        watched(made((2e2, 2e2), **{kind: UNIT[kind] * np.exp(apart * np.linspace(-1, 1, 9))}), price=30.0)
        for apart in (0.0, 1.5)
    )
    assert exact.allowed.amplitude > 1.05 * rough.allowed.amplitude
    assert exact.predicted_worth > rough.predicted_worth
