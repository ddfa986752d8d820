"""The dose-response that counts of fruit set teach: it finds what made them, and says what it does not know."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import expit

from anther.core.errors import InputError
from anther.history import Outcome
from anther.history.fruit_set import NAMES, PRIORS, Count, _quantiles, counts_of, fit, pollen_dose, worth
from anther.plant import ShakeRecord, Visit
from anther.show.pictures.estimates import draw_fruit_set

DAY = datetime(2026, 5, 1, 10, tzinfo=UTC)


def drawn(rng: np.random.Generator, p0: float, gain: float, half: float, likeness: float, plants: int) -> list[Count]:
    """Counts of 12 flowers a plant, every fourth a control, the others shaken twice by anything up to a buzz."""
    counts = []
    for k in range(plants):
        shakes = () if k % 4 == 0 else tuple(np.exp(rng.uniform(0, 5.5)) * rng.uniform(0.5, 1.5, 5) for _ in range(2))
        kept = np.prod([1 - np.mean(a**2 / (a**2 + half**2)) for a in shakes])
        p = p0 + (1 - p0) * gain * (1 - kept)
        size = 1 / likeness - 1
        counts.append(Count(12, int(rng.binomial(12, rng.beta(p * size, (1 - p) * size))), shakes))
    return counts


@given(st.floats(-5, 5), st.integers(2, 100))
def test_quantiles_of_what_is_symmetric_are_symmetric(middle: float, half: int) -> None:
    values = middle + np.arange(-half, half + 1)[::-1]
    median, low, high = _quantiles(values, np.full(len(values), 1 / len(values)))
    assert median == pytest.approx(middle)
    assert middle - low == pytest.approx(high - middle)
    assert high == pytest.approx(min(middle + 0.45 * len(values), values.max()))


def test_without_counts_it_is_the_prior_and_says_so() -> None:
    for species, prior in PRIORS.items():
        nothing = fit([], prior)
        for name, transform in zip(NAMES[:4], (expit, expit, np.exp, expit), strict=True):
            mean, deviation = getattr(prior, name)
            wanted = transform(mean + np.array([0, -1.645, 1.645]) * deviation)
            assert nothing.interval(name) == pytest.approx(wanted, rel=0.04), (species, name)
            assert nothing.learned(name) < 0.03
        assert "prior" in nothing.caveats()[0]
        assert "No count" in nothing.caveats()[0]


@given(st.lists(st.floats(0, 1e4), min_size=2, max_size=8), st.floats(1.0, 2.0))
def test_the_dose_rises_and_saturates(accelerations: list[float], exponent: float) -> None:
    dose = pollen_dose(np.sort(accelerations), 20.0, exponent)
    assert np.all((dose >= 0) & (dose <= 1))
    assert np.all(np.diff(dose) >= 0)
    assert pollen_dose(20.0, 20.0, exponent) == 0.5


def test_what_a_shake_is_worth_is_a_range_over_the_flowers() -> None:
    belief, felt = fit([]), np.array([2.0, 5.0, 40.0])
    median, low, high = belief.added(felt)
    assert low < median < high
    assert high > 4 * low  # half a dose lies between 5 and 80
    one_by_one = [belief.added(a) for a in felt]
    assert min(m for m, _, _ in one_by_one) < median < max(m for m, _, _ in one_by_one)
    said = worth(np.append(felt, np.nan), "tomato")
    assert said.startswith("Of 4 flowers")
    assert f"{4 * median:.1f} ({4 * low:.1f} to {4 * high:.1f})" in said
    assert worth(np.array([np.nan]), "tomato") == ""


def test_many_counts_find_what_made_them() -> None:
    truth = {"unshaken": 0.45, "gain": 0.7, "half_dose": 25.0, "likeness": 0.06}
    learned = fit(drawn(np.random.default_rng(5), *truth.values(), plants=120))
    for name, value in truth.items():
        _, low, high = learned.interval(name)
        assert low < value < high, name
        assert learned.learned(name) > 0.5, name
    assert learned.interval("half_dose")[2] / learned.interval("half_dose")[1] < 3  # of 16 before
    assert learned.caveats() == ()
    chances = [learned.probability(a)[0] for a in (0, 5, 25, 100, 300)]
    assert chances == sorted(chances)
    assert learned.probability(25)[0] == pytest.approx(0.45 + 0.55 * 0.7 * 0.5, abs=0.05)
    assert learned.added(0) == (0, 0, 0)
    assert learned.added(25)[1] < 0.55 * 0.7 * 0.5 < learned.added(25)[2]


@pytest.mark.slow
@pytest.mark.long
def test_intervals_hold_as_often_as_they_say() -> None:
    """Truths drawn from the prior, 16 plants each: nine in ten of the 90 % intervals hold."""
    rng, inside = np.random.default_rng(2), np.zeros(3)
    prior = PRIORS["tomato"]
    for _ in range(30):
        z = {name: rng.normal(*getattr(prior, name)) for name in NAMES[:4]}
        truth = [expit(z["unshaken"]), expit(z["gain"]), np.exp(z["half_dose"]), expit(z["likeness"])]
        learned = fit(drawn(rng, *truth, plants=16), prior)
        intervals = [learned.interval(name) for name in NAMES[:3]]
        inside += [low <= t <= high for t, (_, low, high) in zip(truth, intervals, strict=False)]
    assert (inside >= 23).all(), inside  # 30 at 90 %: fewer than 23 in one of 40, a column
    assert inside.sum() <= 89


@pytest.mark.slow
def test_the_grid_is_fine_enough() -> None:
    counts = drawn(np.random.default_rng(1), 0.4, 0.8, 20.0, 0.1, plants=40)
    coarse = fit(counts)
    fine = fit(counts, shape=(25, 25, 34, 19))
    for name in NAMES:
        (m, low, high), (m2, low2, high2) = coarse.interval(name), fine.interval(name)
        assert np.abs([m - m2, low - low2, high - high2]).max() < 0.06 * (high2 - low2), name


def test_flowers_of_one_plant_are_not_many_plants() -> None:
    one = fit([Count(200, 150)]).interval("unshaken")
    many = fit([Count(10, 7), Count(10, 8)] * 10).interval("unshaken")
    assert one[2] - one[1] > 1.5 * (many[2] - many[1])


def test_what_is_not_known_is_said() -> None:
    weak = [Count(20, 9, (np.full(4, 5.0),)) for _ in range(10)]
    said = " ".join(fit(weak).caveats())
    assert "no shake" in said
    assert "extrapolated" in said
    assert "half dose" in said
    with_controls = " ".join(fit([*weak, Count(20, 8), Count(20, 10)]).caveats())
    assert "no shake" not in with_controls
    assert "extrapolated" in with_controls


def visit(number: int, days: float, **more: object) -> Visit:
    made = Visit("tomato", "a", True, shake=ShakeRecord(10.0, 1e-3), time=DAY + timedelta(days=days), id=number)
    return replace(made, **more)  # type: ignore[arg-type]


def test_a_visit_on_the_day_of_a_count_is_before_it_and_not_before_the_next() -> None:
    felt = {"measured_acceleration": (30.0,)}
    days = [date(2026, 5, 4), date(2026, 5, 8)]
    counts, _ = counts_of([visit(1, 3, **felt)], [Outcome("tomato", "a", 10, 4, day) for day in days])
    assert [len(count.shakes) for count in counts] == [1, 0]


def test_counts_meet_their_visits() -> None:
    nan = float("nan")
    trials = [
        visit(1, 0, predicted_acceleration=(10.0, 20.0), measured_acceleration=(nan, 30.0)),
        visit(2, 3, predicted_amplitude=(1e-3,)),
        visit(3, 9, measured_acceleration=(40.0,)),
        visit(4, 9, shake=None, held_unharmed=False, failure="nothing_grasped"),
    ]
    outcomes = [
        Outcome("tomato", "a", 10, 4, date(2026, 5, 8)),
        Outcome("tomato", "a", 10, 5, date(2026, 5, 20)),
        Outcome("tomato", "a", 3, 3, date(2026, 5, 20), visit=2),
        Outcome("tomato", "control", 8, 2, date(2026, 5, 20)),
    ]
    counts, left_out = counts_of(trials, outcomes)
    assert left_out == []
    assert [[list(a) for a in c.shakes] for c in counts] == [
        [[10.0, 30.0], pytest.approx([1e-3 * (20 * np.pi) ** 2])],
        [[40.0]],
        [pytest.approx([1e-3 * (20 * np.pi) ** 2])],
        [],
    ]
    unknown = visit(5, 10, held_unharmed=False, failure="slipped", predicted_acceleration=(9.0,))
    counts, left_out = counts_of([*trials, unknown], outcomes)
    assert [c.fruit for c in counts] == [4, 3, 2]
    assert "1 of 4" in left_out[0]


@settings(max_examples=8)
@given(st.lists(st.tuples(st.integers(1, 500), st.floats(0, 1), st.floats(0, 1e5)), min_size=1, max_size=4))
def test_any_counts_give_ordered_intervals(rows: list[tuple[int, float, float]]) -> None:
    learned = fit([Count(n, int(share * n), (np.array([a]),)) for n, share, a in rows])
    for name in NAMES:
        median, low, high = learned.interval(name)
        assert low < median < high
    for a in (0.0, 30.0, 1e4):
        median, low, high = learned.probability(a)
        assert 0 <= low <= median <= high <= 1


@pytest.mark.parametrize(
    ("flowers", "fruit", "shake"), [(0, 0, 1.0), (3, 4, 1.0), (3, -1, 1.0), (3, 1, -1.0), (3, 1, float("nan"))]
)
def test_bad_counts_are_refused(flowers: int, fruit: int, shake: float) -> None:
    with pytest.raises(InputError):
        Count(flowers, fruit, (np.array([shake]),))


def test_the_picture_is_drawn(tmp_path: Path) -> None:
    counts = drawn(np.random.default_rng(1), 0.4, 0.8, 20.0, 0.1, plants=12)
    figure = draw_fruit_set(fit(counts), fit([]), "tomato")
    figure.savefig(tmp_path / "f.png")
    (axes,) = figure.axes
    assert len(axes.collections) == 2 + 12  # two bands, a dot a count
    assert [t.get_text() for t in axes.get_legend().get_texts()] == ["before any count", "believed now"]  # type: ignore[union-attr]
