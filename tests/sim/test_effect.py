"""What harms a plant, how probably, what frees its pollen, and how the three parts of a verdict make a success."""

from __future__ import annotations

from dataclasses import fields, replace
from html import escape
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from straight_plant import BASE, chain, plant_of

from anther.core.errors import StageFailure
from anther.core.geometry import Array
from anther.history import read_trials, record_trial
from anther.plant import GraspRecord, Visit
from anther.plant.limits import LOADED
from anther.pollination.response import Response
from anther.show.report import write_report
from anther.show.results import RunResults
from anther.show.summary import _truth, _verdict, summarise
from anther.sim.judge import Harm, Verdict, net_fruit, pollen_freed
from anther.sim.pieces import Params, cut, of_flower_stalks
from anther.sim.plant import Organ
from anther.sim.truth import DOSE_EXPONENT, DOSE_MEASURES, HALF_DOSE, TOLERANCE, tolerances

GENTLE = {"stem": 0.005, "pedicel": 0.001, "base": 0.001, "leaf": 1.0}
BREEZE = (4.0, 6.0, 12.0)
BEGUN = Visit("tomato", "1", held_unharmed=False)
FINISHED: Any = SimpleNamespace(trial=SimpleNamespace(failure=None, stop_reason="finished"))


def verdict_of(held: bool = True, felt: tuple[float, ...] = BREEZE, **loads: float) -> Verdict:
    """The verdict on a trial that went well but for what is given; this plant bears what half of all plants do."""
    harm = Harm(GENTLE | loads, {kind: bears.median for kind, bears in TOLERANCE.items()})
    failure = "slipped" if not held else "damaged" if harm.passed else None
    flowers: list[Array] = [np.array(felt)] * 2
    return Verdict(held, failure, "so it was", "stem", 0.2, 1e-4, 0.0, harm, *flowers, 0.5)  # type: ignore[arg-type]


def told(verdict: Verdict | None, failure: StageFailure | None = None) -> Visit:
    """A visit of which only the verdict is known."""
    values = _verdict(None if verdict is None else FINISHED, verdict, failure)
    grasp = None if verdict is None else GraspRecord(organ=verdict.organ_grasped)
    return replace(BEGUN, **values, truth=_truth(verdict), grasp=grasp)


@pytest.mark.parametrize("kind", TOLERANCE)
def test_harm_is_as_probable_as_plants_that_bear_less(kind: str) -> None:
    bears = TOLERANCE[kind]
    assert bears.share_below([0, bears.low, bears.median, bears.high]) == pytest.approx([0, 0.05, 0.5, 0.95], abs=1e-3)
    rest = dict.fromkeys(TOLERANCE, 0.0)
    probabilities = [Harm(rest | {kind: load}, {}).probability for load in bears.median * np.geomspace(0.2, 5, 20)]
    assert np.all(np.diff(probabilities) > 0)
    assert Harm(rest | {kind: bears.median}, {}).probability == pytest.approx(0.5)
    drawn = np.array([tolerances("pepper", seed)[kind] for seed in range(400)])
    assert np.mean(drawn < bears.median) == pytest.approx(0.5, abs=0.08)
    assert np.mean(drawn < bears.low) == pytest.approx(0.05, abs=0.04)


def test_every_kind_of_load_adds_to_the_probability_of_harm() -> None:
    medians = {kind: bears.median for kind, bears in TOLERANCE.items()}
    assert Harm(medians, medians).probability == pytest.approx(1 - 0.5**4)


def test_each_plant_bears_something_else_and_none_what_the_planner_believes() -> None:
    believed = {value for one in LOADED.values() for value in (one.low, one.median)}
    drawn = [tolerances(species, seed) for species in ("tomato", "pepper") for seed in range(100)]
    values = [limit for plant in drawn for limit in plant.values()]
    assert len(set(values)) == 200 * 4
    assert not believed & {*values, *(bears.median for bears in TOLERANCE.values())}
    assert tolerances("tomato", 3) == tolerances("tomato", 3)


def test_a_load_is_harm_where_it_passes_what_the_plant_bears() -> None:
    limits = dict.fromkeys(TOLERANCE, 0.01)
    assert Harm(limits, limits).passed == ()
    harm = Harm(limits | {"pedicel": 0.0101, "leaf": np.nan}, limits)
    assert harm.passed == ("pedicel", "leaf"), "what could not be reckoned is not taken for harmless"
    assert "pedicels: 1.01%, this plant bears 1.00%" in harm.words


@pytest.mark.parametrize(("flowers", "lost", "harmed"), [(6, 1, False), (6, 2, True), (12, 2, False), (12, 3, True)])
def test_a_plant_that_loses_more_than_a_sixth_of_its_flowers_is_harmed(flowers: int, lost: int, harmed: bool) -> None:
    limits = dict.fromkeys(TOLERANCE, 0.01)
    bent = np.where(np.arange(flowers) < lost, 0.02, 0.005)
    harm = Harm(dict.fromkeys(TOLERANCE, 0.0) | {"pedicel": 0.02}, limits, bent)
    assert harm.flowers_lost == lost
    assert harm.passed == (("pedicel",) if harmed else ())


@pytest.mark.parametrize(
    ("peduncles", "lost"), [((0.0, 0.0, 0.0), 1), ((0.0, 0.02, 0.0), 1), ((0.02, 0.02, 0.0), 2), ((), 1)]
)
def test_flowers_are_lost_with_their_pedicel_or_their_peduncle(peduncles: tuple[float, ...], lost: int) -> None:
    harm = Harm({}, dict.fromkeys(TOLERANCE, 0.01), np.array([0.005, 0.02, 0.005]), np.array(peduncles))
    assert harm.flowers_lost == lost


MIDDLE = 12.0  # Hz, where every measure of motion frees the same
WHOLE: dict[str, Any] = {"lost": 0.0, "bent": {"stem": False, "base": False, "leaf": False}}
MIXED = np.array([3.0, 12.0, 60.0])


def test_a_shake_is_worth_the_pollen_freed_whatever_the_dose() -> None:
    rng = np.random.default_rng(0)
    half, power = (np.array([one.draw(rng) for _ in range(20000)])[:, None] for one in (HALF_DOSE, DOSE_EXPONENT))
    freed = (MIXED**power / (MIXED**power + half**power)).mean()
    assert net_fruit(MIXED, MIDDLE, **WHOLE) == pytest.approx(freed, abs=0.005)
    assert net_fruit(np.append(MIXED, np.nan), 5.0, **WHOLE) == pytest.approx(0.75 * freed, abs=0.005)
    assert net_fruit(np.zeros(0), 5.0, **WHOLE) == 0


@pytest.mark.parametrize("hertz", [3.0, MIDDLE, 40.0])
def test_measures_of_motion_agree_at_the_middle_and_part_beyond_it(hertz: float) -> None:
    by = {name: float(net_fruit(MIXED, hertz, **WHOLE, measure=name)) for name in DOSE_MEASURES}
    order = np.sign([by["jerk"] - by["acceleration"], by["acceleration"] - by["velocity"]])
    assert order.tolist() == [np.sign(hertz - MIDDLE)] * 2
    mean = sum(by[name] * measure.probability for name, measure in DOSE_MEASURES.items())
    assert net_fruit(MIXED, hertz, **WHOLE, measure=None) == pytest.approx(mean)
    assert sum(measure.probability for measure in DOSE_MEASURES.values()) == pytest.approx(1)
    slower = net_fruit(MIXED * hertz / MIDDLE, MIDDLE, **WHOLE)
    assert by["jerk"] == pytest.approx(slower), "as much jerk at the middle"


@pytest.mark.parametrize(
    ("change", "cost"),
    [
        ({"lost": 1 / 3}, 1 / 3),
        ({"bent": WHOLE["bent"] | {"stem": True}, "lost": 1 / 3}, 1.0),
        ({"bent": WHOLE["bent"] | {"base": True}}, 0.05),
        ({"bent": WHOLE["bent"] | {"leaf": True}}, 0.05),
    ],
)
def test_what_is_lost_or_stays_bent_costs(change: dict[str, Any], cost: float) -> None:
    whole = net_fruit(MIXED, 8.0, **WHOLE)
    assert net_fruit(MIXED, 8.0, **WHOLE | change) == pytest.approx(whole - cost)
    assert net_fruit(MIXED, 8.0, **WHOLE | change, slipped=True) == pytest.approx(-cost - 0.1)


def test_a_flowers_stalks_are_its_pedicel_and_what_carries_it_up_to_the_stem() -> None:
    up = np.linspace(0, 0.3, 7)[:, None] * [0, 0, 1.0]
    stem = chain(BASE + up, 0.004)
    peduncle = chain(
        stem["end"][3] + np.linspace(0, 0.06, 4)[:, None] * [1.0, 0, 0], 0.0015, organ=Organ.PEDUNCLE, joins=3, first=6
    )
    pedicel = chain(
        peduncle["end"][-1] + np.linspace(0, 0.015, 2)[:, None] * [0, 0, -1.0],
        0.0005,
        organ=Organ.PEDICEL,
        joins=8,
        first=9,
    )
    plant = plant_of(stem, peduncle, pedicel, flower=9)
    pieces = cut(plant, Params())
    organ = plant.organ[pieces.first]
    strain = np.arange(1.0, 1 + len(organ))
    own, carrier = of_flower_stalks(plant, pieces, np.stack([strain, 2 * strain]))
    assert own[:, 0].tolist() == [strain[organ == Organ.PEDICEL].max(), 2 * strain[organ == Organ.PEDICEL].max()]
    assert carrier[:, 0].tolist() == [strain[organ == Organ.PEDUNCLE].max(), 2 * strain[organ == Organ.PEDUNCLE].max()]


def test_pollen_freed_spans_what_is_not_known_of_the_dose() -> None:
    low, middle, high = pollen_freed(np.full(3, HALF_DOSE.median))
    assert middle == pytest.approx(0.5, abs=0.01)
    # at its 5 % and 95 % quantile the half dose is four times as far, which is worth 1/5 to 1/17 by the exponent
    assert 1 / 17 < low < 1 / 5
    assert 1 - high == pytest.approx(low, abs=0.01)
    assert pollen_freed(np.zeros(2)) == (0, 0, 0)
    assert np.isnan(pollen_freed(np.array([np.nan]))).all()
    more = [pollen_freed(np.array([a, 3.0])) for a in (1.0, 5.0, 30.0, 200.0)]
    assert np.all(np.diff(more, axis=0) > 0)


@pytest.mark.parametrize(
    ("verdict", "parts"),
    [
        (verdict_of(), (True, True, True)),
        (verdict_of(held=False), (False, True, True)),
        (verdict_of(pedicel=0.02), (True, False, True)),
        (verdict_of(leaf=40.0), (True, False, True)),
        (verdict_of(felt=(1.0, 4.9, 60.0)), (True, True, False)),
        (verdict_of(felt=()), (True, True, False)),
    ],
)
def test_success_is_all_three_parts_and_each_can_fail_alone(verdict: Verdict, parts: tuple[bool, ...]) -> None:
    visit = told(verdict)
    assert (verdict.held, verdict.unharmed, verdict.flowers_moved) == parts
    assert (visit.held, visit.unharmed, visit.flowers_moved) == parts
    assert visit.held_unharmed == (parts[0] and parts[1])
    assert visit.success == verdict.success == all(parts)
    assert (visit.failure is None) == (verdict.held and verdict.unharmed)


def test_trial_json_says_what_the_flowers_felt() -> None:
    summary = told(verdict_of(felt=(1.0, 4.0, 6.0, 12.0, np.nan))).flat()
    felt = (summary["true_flower_acceleration_median_ms2"], summary["true_flower_acceleration_least_ms2"])
    assert (*felt, summary["share_above_5_ms2"], summary["share_above_10_ms2"]) == (5.0, 1.0, 0.5, 0.25)
    assert summary["flowers_moved"], "half of them felt as much or more"
    assert summary["true_pedicel_strain"] == GENTLE["pedicel"]
    assert summary["borne_pedicel_strain"] == TOLERANCE["pedicel"].median


@pytest.mark.parametrize(
    ("visit", "kept"),
    [
        (told(verdict_of()), (True, None)),
        (told(verdict_of(felt=(0.1,))), (True, None)),
        (told(verdict_of(base=0.1)), (False, "damaged")),
        (told(verdict_of(held=False)), (False, "slipped")),
        (told(None, StageFailure("no_stem_found", "none")), (False, "no_stem_found")),
    ],
)
def test_the_history_keeps_the_result_that_the_report_shows(
    visit: Visit, kept: tuple[bool, str | None], tmp_path
) -> None:
    record_trial(visit, tmp_path / "history.sqlite")
    (record,) = read_trials(tmp_path / "history.sqlite")
    assert (record.held_unharmed, record.failure) == kept
    visit.save(tmp_path / "trial.json")
    results = RunResults(folder=tmp_path, visit=Visit.load(tmp_path / "trial.json"))
    assert (record.result, record.result_words) == (results.result, results.headline)
    assert (record.result == "pollinated") == visit.success


@pytest.mark.parametrize(
    ("visit", "said", "headline"),
    [
        (told(verdict_of()), ["yes", "no", "yes"], "pollinated"),
        (told(verdict_of(felt=(2.7,))), ["yes", "no", "hardly"], "held, flowers hardly moved"),
        (told(verdict_of(pedicel=0.05)), ["yes", "yes: pedicel", "yes"], "failed: damaged"),
        (told(verdict_of(held=False)), ["no", "no", "yes"], "failed: slipped"),
        (
            summarise(BEGUN, None, None, None, StageFailure("no_stem_found", "two trees")),
            ["no", "not known", "not known"],
            "failed: no stem found",
        ),
    ],
)
def test_the_report_begins_with_the_three_answers(visit: Visit, said: list[str], headline: str, tmp_path) -> None:
    results = RunResults(folder=tmp_path, visit=visit)
    assert [answer.said for answer in results.answers()] == said
    assert results.headline == headline
    write_report(tmp_path / "report.html", results)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    first = page[page.index("<section") : page.index("</section>")]
    places = [first.index(f"{answer.question}</span><b class=") for answer in results.answers()]
    assert places == sorted(places)
    assert all(f">{escape(answer.said)}</b><span>{escape(answer.why)}</span>" in first for answer in results.answers())
    assert visit.message
    assert visit.message in first
    assert ("simulated" in first) == (visit.unharmed is not None), "whose truth it is"


def response_of(after: tuple[float, ...], at_most: tuple[float, ...]) -> Response:
    """What a camera measured after a shake: acceleration [m/s2], or the amplitude [m] that a flower stayed below."""
    count = len(after)
    numbers = {f.name: np.full(count, np.nan) for f in fields(Response) if f.name not in ("notes", "stem")}
    numbers |= {"times": np.zeros(1), "tracks": np.zeros((1, count, 3)), "direction": np.zeros((count, 3))}
    numbers |= {"acceleration_peak": np.array(after), "at_most": np.array(at_most)}
    return Response(**numbers | {"visible": np.isfinite(after)})  # type: ignore[arg-type]


def test_a_flower_counts_as_measured_after_the_shake_or_else_in_its_last_step() -> None:
    response = response_of((np.nan, 3.0, np.nan, np.nan), (np.nan, np.nan, 1e-4, np.nan))
    last: Any = [SimpleNamespace(flowers=flowers) for flowers in ((9.0,) * 4, (8.0, 7.0, 6.0, np.nan))]
    assert response.flower_acceleration(last) == pytest.approx([8.0, 3.0, 6.0, np.nan], nan_ok=True)
    assert response.flower_acceleration() == pytest.approx([np.nan, 3.0, 0.0, np.nan], nan_ok=True)


UNSEEN = (np.nan, np.nan, np.nan)


@pytest.mark.parametrize(
    ("after", "step", "at_most", "moved"),
    [
        ((4.0, 6.0, 12.0), None, UNSEEN, (True, 6.0, 3)),
        ((1.0, 2.0, 12.0), None, UNSEEN, (False, 2.0, 3)),
        ((np.nan, 2.0, np.nan), (9.0, 9.0, 9.0), UNSEEN, (True, 9.0, 3)),
        ((12.0, np.nan, np.nan), None, (np.nan, 1e-4, 1e-4), (False, 0.0, 3)),
        (UNSEEN, None, UNSEEN, (None, None, 0)),
    ],
    ids=["moved", "hardly", "seen during the shake", "too little to tell", "nothing seen"],
)
def test_of_a_real_plant_the_side_camera_tells_whether_flowers_moved(after, step, at_most, moved, tmp_path) -> None:
    gripped = np.array([[0.004, 20.0, 1.0], [0.004, 20.0, 1.0]])
    steps = [] if step is None else [SimpleNamespace(flowers=step)]
    trial = SimpleNamespace(finished=True, failure=None, stop_reason="finished", gripper=gripped, steps=steps)
    parts = _verdict(cast(Any, SimpleNamespace(trial=trial, response=response_of(after, at_most))), None, None)
    visit = replace(BEGUN, **parts)
    assert (visit.flowers_moved, visit.felt_flower_acceleration_median, visit.felt_flowers) == moved
    assert visit.success == (moved[0] is not False), "it was held, and whether it was harmed nobody knows"
    said = {True: "yes", False: "hardly", None: "not known"}[moved[0]]
    results = RunResults(folder=tmp_path, visit=visit)
    assert [answer.said for answer in results.answers()] == ["yes", "not known", said]
    words = {True: "pollinated", False: "held, flowers hardly moved", None: "held, flowers not measured"}
    assert results.headline == words[moved[0]]
    assert not any("simulated" in answer.why for answer in results.answers())


@pytest.mark.parametrize(
    ("openings", "gripping", "held"),
    [((5.7, 5.3), (1, 1), True), ((5.7, 4.5), (1, 1), False), ((5.7, 5.7), (1, 0), False), ((5.7, 6.5), (1, 1), True)],
    ids=["a count nearer", "slipped out", "says so itself", "wider"],
)
def test_of_a_real_plant_pads_that_close_further_lost_the_stem(openings, gripping, held) -> None:
    gripper = np.array([(1e-3 * opening, 20.0, grips) for opening, grips in zip(openings, gripping, strict=True)])
    trial = SimpleNamespace(finished=True, failure=None, stop_reason="finished", gripper=gripper, steps=[])
    visit = replace(BEGUN, **_verdict(cast(Any, SimpleNamespace(trial=trial, response=None)), None, None))
    assert (visit.held, visit.success) == (held, held)
    assert visit.failure == (None if held else "slipped")


def test_a_visit_of_which_only_the_result_is_known_has_no_answers(tmp_path) -> None:
    known = RunResults(folder=tmp_path, visit=replace(BEGUN, failure="slipped", message="6 mm"))
    assert (known.answers(), known.headline) == ((), "failed: slipped")
