"""A watched shake is raised where the flowers move most, as far as the limits go as they are known, and ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fake_robot import FakeCamera
from made_foresight import ALONG, AXES, FLOWERS, POINTS, TONES, World, lines_across, made_foresight, made_plan

from anther.core.errors import InputError
from anther.pollination import escalation
from anther.pollination.decision import Answer as Answers
from anther.pollination.decision import believed, worth
from anther.pollination.escalation import Escalation, Foresight, Params
from anther.pollination.escalation import _foresight as foresight_module
from anther.pollination.escalation._knowledge import (
    Answer,
    Observation,
    extrapolate_growth,
    predict,
    sum_answers,
    update_answer,
    update_directions,
)
from anther.pollination.escalation._option import WORDS, limits_of
from anther.pollination.response.points import Swings, likeness
from anther.pollination.shake import Params as Limits
from anther.pollination.shake.observables import semi_major
from anther.robot.devices import ImuReadings

HEEDLESS = Limits(price=0.01)
"""As if it hardly mattered what is lost."""
SIGHTED, BLIND = np.ones(FLOWERS + POINTS, bool), np.zeros(FLOWERS + POINTS, bool)
FREE = replace(made_plan(reach=(0.2, 0.2, 0.2)), press=1000.0)
"""A plan whose actuator and pads end nothing."""
Shaken = Callable[..., Escalation]


@pytest.fixture
def shaken(monkeypatch: pytest.MonkeyPatch) -> Shaken:
    """Shake a world with a camera that sees as it says and an arm that reads so, by members trusted to 2 %."""
    monkeypatch.setattr(foresight_module, "MISFIT", 0.02)
    for module in ("decision", "escalation._option"):
        monkeypatch.setattr(f"anther.pollination.{module}.GUSTS", float(TONES.max()))  # leaves count at every tone
    monkeypatch.setattr(escalation, "sight", lambda *_: SimpleNamespace(shown=SIGHTED))

    def run(world: World, raised: float = escalation.RAISED) -> Escalation:
        monkeypatch.setattr(escalation, "RAISED", raised)
        monkeypatch.setattr(escalation, "swings", world.swings)
        return world.shaken(world.escalation())

    return run


SEEN = Swings(
    np.ones((FLOWERS + POINTS, 1, 3), complex),
    np.full((FLOWERS + POINTS, 3), 0.1),
    np.tile(np.eye(3), (FLOWERS + POINTS, 1, 1)),
)


def most(world: World, tone: int) -> tuple[float, float, float]:
    """Return what a tone is worth, by the truth: amplitude [m] at which it is most, the flowers' median, its worth."""
    hertz, reach = float(TONES[tone]), float(world.plan.tones.reach[tone, 0])
    sizes, limits = reach * np.geomspace(1e-3, 1, 2000), world.limits
    truth = world.foresight.answer(world.answer(tone)[None], hertz)
    held, seen = limits.held(world.plan.press), np.ones(FLOWERS, bool)
    net = worth(truth, sizes, hertz, held, limits.price, seen).net
    best = int(net.argmax())
    return float(sizes[best]), float(sizes[best] * np.median(world.flowers(tone))), float(net[best])


def single(watched: Escalation) -> list[Any]:
    """Return the steps of one tone."""
    return [step for step in watched.steps if len(step.frequencies) == 1]


@pytest.mark.parametrize("best", [0, 1, 2])
def test_the_tone_is_taken_that_is_worth_most_and_raised_to_where_it_is(shaken: Shaken, best: int) -> None:
    gains = [4.0 if tone == best else 0.7 for tone in range(3)] / (TONES / TONES[0]) ** 2
    foresight = made_foresight(2, gains=gains)
    world = World(foresight, foresight.vectors[3], plan=FREE, params=Params(most_seconds=30))
    # the plant bears the same at every tone, so what the flowers do there decides
    allowed = [most(world, tone) for tone in range(3)]
    expected = int(np.argmax([net for *_, net in allowed]))
    assert escalation.BETTER * sorted(net for *_, net in allowed)[-2] < allowed[expected][2]
    watched = shaken(world, raised=3.0)
    last = watched.steps[-1]
    assert last.frequencies == pytest.approx([TONES[expected]])
    assert last.amplitudes[0] == pytest.approx(allowed[expected][0], rel=0.15)
    assert last.median == pytest.approx(allowed[expected][1], rel=0.15)


def test_what_the_camera_sees_overrules_what_the_model_promises(shaken: Shaken) -> None:
    believed = made_foresight(2, gains=(2.0, 0.6, 0.1), unsure=0.8)
    truth = believed.vectors[0].copy()
    truth[0, :, : FLOWERS + POINTS] *= 0.1
    truth[2, :, : FLOWERS + POINTS] *= 10
    world = World(believed, truth, plan=FREE)
    assert shaken(world).steps[-1].frequencies == pytest.approx([TONES[2]])
    promised = World(believed, believed.vectors[0], plan=FREE)
    assert shaken(promised).steps[-1].frequencies != pytest.approx([TONES[2]])


@pytest.mark.parametrize("along", range(8))
def test_the_line_is_taken_along_which_the_flowers_move_most(shaken: Shaken, along: int) -> None:
    """What two lines showed tells of all others: flowers that follow the pads along one line alone are shaken so."""
    believed, lines = made_foresight(2, unsure=0.8), lines_across(8)
    truth = believed.vectors[3].copy()
    flowers = truth[:, 0, :FLOWERS].copy()
    for axis, share in enumerate(lines[along]):
        truth[:, axis, :FLOWERS] = share * flowers
    world = World(believed, truth, plan=made_plan(reach=(0.02,) * 3, lines=8), limits=HEEDLESS)
    world.plan = replace(world.plan, press=1000.0)
    world.params = Params(most_seconds=30)
    watched = shaken(world, raised=3.0)
    check_pieces(world, watched)
    assert len(watched.steps[0].frequencies) == len(watched.steps[1].frequencies) == len(TONES)
    assert watched.steps[0].direction == pytest.approx(lines[0])
    assert watched.steps[1].direction == pytest.approx(lines[4])
    assert abs(lines[along] @ watched.steps[-1].direction) > np.cos(np.radians(23))
    assert watched.executed_plan(watched.steps).direction == pytest.approx(watched.steps[-1].direction)


@pytest.mark.parametrize("planned", [0.002, 0.3])
def test_a_second_probe_is_gentler_by_what_the_first_passed_a_limit(shaken: Shaken, planned: float) -> None:
    believed = made_foresight(2)
    world = World(believed, believed.vectors[3], plan=made_plan((planned,) * 3, reach=(2.0,) * 3, lines=8))
    world.plan = replace(world.plan, press=1000.0)
    first, second, *_ = shaken(world).steps
    passed = max(first.loads.values())
    assert (passed > 1) == (planned > 0.002)
    assert second.amplitudes == pytest.approx(np.array(first.amplitudes) / max(passed, 1.0))


def held_seconds(world: World) -> float:
    """Return how long the shake was what it was in the end [s]."""
    *_, begins = (piece for piece in world.pieces if piece.changes and not piece.stops)
    return float(world.pieces[-1].begin - begins.begin - begins.ramp)


@pytest.mark.parametrize("price", [1.0, 10.0])
def test_it_ends_where_more_would_cost_more_than_it_adds(shaken: Shaken, price: float) -> None:
    for seed in range(5):
        foresight = made_foresight(seed)
        world = World(foresight, foresight.vectors[4], plan=FREE, params=Params(most_seconds=30))
        world.limits = Limits(price=price)
        watched = shaken(world, raised=3.0)
        last = watched.steps[-1]
        tone = int(np.abs(TONES - last.frequencies[0]).argmin())
        assert last.amplitudes[0] == pytest.approx(most(world, tone)[0], rel=0.15)
        assert held_seconds(world) >= escalation.HOLD
        assert any("more would cost more than it adds" in step.decided for step in watched.steps[-2:])


@pytest.mark.parametrize("share", [0.25, 1.0, 3.0])
def test_a_flower_moves_away_no_further_than_the_members_say_nor_beside_what_was_seen(share: float) -> None:
    foresight = made_foresight(1)
    members, own = foresight.of(0, ALONG), foresight.where["flowers"]
    said = np.sqrt(np.mean(np.abs(members[:, own]) ** 2, axis=0))
    shown = np.asarray(share * np.column_stack([said[:, :2], np.full(FLOWERS, np.nan)]), dtype=np.complex128)
    axes, std = np.repeat(np.eye(3)[None], FLOWERS, axis=0), np.tile([1e-6, 1e-6, np.nan], (FLOWERS, 1))
    told = predict(foresight, float(TONES[0]), Answer(members, shown, std, axes), 0.0)
    assert told.seen.all()
    assert np.abs(told.phasors[:, 2]) == pytest.approx(min(share, 1.0) * said[:, 2])
    assert told.phasors[:, :2] == pytest.approx(shown[:, :2])


def test_a_swing_counts_as_what_it_grows_to_and_as_it_is_where_it_dies_out() -> None:
    rate = 2 * np.pi * 17.0 * 0.03
    seen = Swings(np.full((2, 1, 3), 1.0 - 2.0j), np.full((2, 3), 0.1), np.tile(np.eye(3), (2, 1, 1)))
    for share, times in ((0.0, 1.0), (0.5, 1.5), (-0.5, 1.0), (9.0, 3.0)):
        found = extrapolate_growth(seen._replace(growing=share * rate), 17.0)
        assert found.phasors == pytest.approx(times * seen.phasors)
        assert found.std == pytest.approx(times * seen.std)


def test_the_slowest_frame_rate_that_tells_all_tones_apart_is_taken(
    shaken: Shaken, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Escalation, "least_look", 0.2)
    for seed in range(10):
        foresight = made_foresight(seed)
        tones = TONES * np.random.default_rng(seed).uniform(0.5, 3)
        plan = replace(FREE, tones=replace(FREE.tones, frequencies=tones))
        world = World(foresight._replace(frequencies=tones), foresight.vectors[1], plan=plan)
        watched = shaken(world)
        rates = FakeCamera.rates
        rate = watched.frame_rate(rates)
        looks = [(step.end - step.begin, np.array(step.frequencies)) for step in watched.steps]
        best = [likeness(max(rates), *look) for look in looks]
        assert all(likeness(rate, *look) <= 1.6 * b for look, b in zip(looks, best, strict=True))
        assert watched.frame_rate((*rates, 0.1 * rate)) == rate


@pytest.mark.parametrize("lines", [1, pytest.param(8, marks=[pytest.mark.slow, pytest.mark.long])])
def test_whatever_the_plant_every_rule_holds(shaken: Shaken, lines: int) -> None:
    for seed in range(20 if lines == 1 else 15):
        rng = np.random.default_rng(seed)
        unsure, gains = float(rng.uniform(0.1, 0.8)), rng.uniform(0.2, 3, 3).tolist()
        foresight = made_foresight(seed, unsure=unsure, gains=gains)
        plan = made_plan(rng.uniform(0.0005, 0.004, 3).tolist(), rng.uniform(0.004, 0.02, 3).tolist(), lines)
        world = World(foresight, foresight.vectors[seed % 32], plan=plan, late=float(rng.uniform(0, 0.03)))
        raised = float(rng.uniform(1.1, 2))
        world.limits = Limits(price=float(rng.uniform(0.5, 20)))
        watched = shaken(world, raised)
        check_pieces(world, watched)
        for step in single(watched):
            tone = int(np.abs(TONES - step.frequencies[0]).argmin())
            assert lines > 1 or step.amplitudes[0] <= 1.25 * most(world, tone)[0], "no further than is worth its cost"
        assert len(watched.steps) == len(world.pieces) - 1
        for step, following in zip(watched.steps, watched.steps[1:], strict=False):
            assert step.begin < step.end < following.begin


def check_pieces(world: World, watched: Escalation) -> None:
    """Check what holds of every shake: it stops, it keeps its reach and its time, and rises slowly."""
    pieces, params, tones = world.pieces, world.params, world.plan.tones
    assert [piece.stops for piece in pieces] == [False] * (len(pieces) - 1) + [True]
    assert pieces[-1].begin + pieces[-1].seconds <= params.most_seconds + 1e-9
    for piece in pieces:
        assert np.all(piece.amplitudes <= tones.reach.ravel() + 1e-12)
        for line in watched.directions:
            assert piece.only(line.active).reach <= 1.0001 * line.reach
        changing = (piece.amplitudes > 0) | (piece.before > 0)
        assert piece.ramp >= 0.5 / piece.frequencies[changing].min() - 1e-9, "half a period of the slowest"
    for piece in pieces[len(tones.probed) :]:
        assert (piece.amplitudes > 0).sum() <= 1
        (tone,) = np.flatnonzero(piece.amplitudes) if not piece.stops else [0]
        before = piece.before[tone]
        start = tones.amplitudes.flat[tone] if np.count_nonzero(piece.before) != 1 or before == 0 else 0.0
        assert piece.amplitudes[tone] <= escalation.RAISED * max(before, start) + 1e-12


@pytest.mark.parametrize("lines", [1, 8])
def test_with_nothing_in_sight_the_plan_alone_is_carried_out(shaken: Shaken, lines: int) -> None:
    foresight = made_foresight(1)
    world = World(foresight, foresight.vectors[4], shown=[BLIND], plan=made_plan(lines=lines))
    watched = shaken(world)
    probe, alone, end = world.pieces
    assert alone.amplitudes == pytest.approx([world.plan.amplitude, *[0] * (3 * lines - 1)])
    assert alone.seconds - alone.ramp >= world.plan.duration
    assert end.stops
    assert np.all(probe.amplitudes < world.plan.tones.amplitudes.ravel())
    assert "Nothing is in sight" in watched.steps[0].decided
    assert all(np.isnan(step.flowers).all() for step in watched.steps)
    check_pieces(world, watched)


@pytest.mark.parametrize("look", [1, 2, 3])
def test_a_shake_that_is_lost_from_sight_ends(shaken: Shaken, look: int) -> None:
    foresight = made_foresight(1)
    world = World(foresight, foresight.vectors[4], plan=made_plan((0.0005,) * 3), shown=[*[SIGHTED] * look, BLIND])
    watched = shaken(world)
    assert len(world.pieces) == look + 2
    assert world.pieces[-1].stops
    assert f"Only 0 of {FLOWERS + POINTS} points are still followed" in watched.steps[-1].decided


@pytest.mark.parametrize(("lines", "look"), [(1, 1), (1, 3), (2, 1)], ids=["first step", "later", "second probe"])
@pytest.mark.parametrize("fewer", [False, True])
def test_only_a_shake_of_which_less_than_half_is_followed_is_lost(
    shaken: Shaken, lines: int, look: int, fewer: bool
) -> None:
    half = np.arange(FLOWERS + POINTS) < (FLOWERS + POINTS + 1) // 2 - fewer
    foresight = made_foresight(1)
    plan = made_plan((0.0005,) * 3, lines=lines)
    world = World(foresight, foresight.vectors[4], plan=plan, shown=[*[SIGHTED] * look, half])
    steps = shaken(world).steps
    assert any("points are still followed" in step.decided for step in steps) == fewer
    assert (len(world.pieces) == look + 2) == fewer, "it ends with the look that shows so few"


def losing(count: int, look: int, *, found: bool = False) -> list[Any]:
    """Return what a camera follows that loses so many flowers at a look, and finds them again at the next or never."""
    few = SIGHTED.copy()
    few[:count] = False
    return [*[SIGHTED] * look, few, *([SIGHTED] if found else [])]


def raised_slowly(shown: Any, **given: Any) -> World:
    """Return a plant that is planned to be shaken by a tenth of what it bears."""
    foresight = made_foresight(1)
    params = Params(most_seconds=30)
    return World(foresight, foresight.vectors[4], plan=made_plan((0.0005,) * 3), shown=shown, params=params, **given)


@pytest.mark.parametrize(
    ("shown", "noise", "measured"),
    [(SIGHTED, 1e-6, True), (SIGHTED, 4e-4, False), (np.arange(FLOWERS + POINTS) >= FLOWERS, 1e-6, False)],
    ids=["measured", "followed", "hidden"],
)
def test_a_turn_begins_at_what_is_planned(shaken: Shaken, shown: Any, noise: float, measured: bool) -> None:
    world = raised_slowly([shown], noise=noise)
    first = single(shaken(world))[0]
    assert first.amplitudes == pytest.approx([0.0005])
    assert np.isfinite(first.flowers).any() == measured


def test_no_turn_begins_beyond_what_is_worth_most(shaken: Shaken) -> None:
    foresight = made_foresight(1)
    world = World(foresight, foresight.vectors[4], plan=made_plan((0.02,) * 3, (0.2,) * 3))
    first = single(shaken(world))[0]
    tone = int(np.abs(TONES - first.frequencies[0]).argmin())
    assert first.amplitudes[0] == pytest.approx(most(world, tone)[0], rel=0.3)
    assert first.amplitudes[0] < 0.02


def test_a_step_is_twice_the_one_before_until_more_is_worth_nothing(shaken: Shaken) -> None:
    steps = single(shaken(raised_slowly([SIGHTED])))
    sizes = np.array([step.amplitudes[0] for step in steps])
    last = int(sizes.argmax())
    assert last >= 3
    assert sizes[:last] == pytest.approx(0.0005 * 2.0 ** np.arange(last))
    assert 1 < sizes[last] / sizes[last - 1] <= 2


@pytest.mark.parametrize("count", [1, FLOWERS - 1])
@pytest.mark.parametrize("look", [1, 3])
def test_a_shake_that_loses_some_flowers_is_raised_by_what_is_known_of_them(
    shaken: Shaken, count: int, look: int
) -> None:
    world = raised_slowly(losing(count, look))
    steps, held = single(shaken(world)), shaken(raised_slowly([SIGHTED])).steps[-1].amplitudes[0]
    assert all("in sight" not in step.decided for step in steps)
    for step in steps[look - 1 :]:
        assert np.isnan(step.flowers).tolist() == [f < count for f in range(FLOWERS)]
    assert steps[-1].amplitudes[0] == pytest.approx(held, rel=0.3)


@pytest.mark.parametrize("look", [1, 2, 3])
def test_a_shake_that_loses_all_flowers_goes_back_to_where_they_were_seen(shaken: Shaken, look: int) -> None:
    """Or to what is planned: stem and leaves in sight, and what is believed of flowers, raise nothing."""
    watched = shaken(raised_slowly(losing(FLOWERS, look)))
    steps, at = single(watched), look - 1
    sure = steps[at - 1].amplitudes[0] if at else 0.0005
    assert steps[at].amplitudes[0] > 1.5 * sure or not at
    assert "Watched again" in steps[at].decided
    for step in steps[at + 1 :]:
        assert step.amplitudes[0] == pytest.approx(sure)
        assert step.frequencies == steps[at].frequencies
    assert escalation.OUT_OF_SIGHT in steps[-2].decided


def test_flowers_that_are_found_again_end_nothing(shaken: Shaken) -> None:
    held = shaken(raised_slowly([SIGHTED])).steps[-1].amplitudes
    watched = shaken(raised_slowly(losing(FLOWERS, 3, found=True)))
    assert escalation.OUT_OF_SIGHT in watched.steps[3].decided
    assert watched.steps[-1].amplitudes == pytest.approx(held, rel=0.05)


@pytest.mark.parametrize("why", ["", escalation.OUT_OF_SIGHT, escalation.UNPROVEN])
def test_only_a_look_that_proves_something_turns_to_a_shake_that_promises_more(shaken: Shaken, why: str) -> None:
    foresight = made_foresight(0)
    world = World(foresight, foresight.vectors[0], params=Params(most_seconds=60))
    watched = shaken(world)
    here = int(np.abs(TONES - watched.steps[-1].frequencies[0]).argmin())
    there = (here + 1) % len(TONES)
    watched._options[there].allowed = watched._options[there].allowed._replace(net=1e3)
    watched._proofs[-1] = why != escalation.UNPROVEN
    if why == escalation.OUT_OF_SIGHT:
        watched._options[here].prediction = watched._options[here].prediction._replace(
            detectable=np.full(FLOWERS, np.nan)
        )
    sure, watched._proven_amplitude = watched._proven_amplitude, 1e-5
    follows = watched._decide(here)
    assert np.flatnonzero(follows.amplitudes).tolist() == [here if why else there]
    assert (
        (why in follows.words)
        if why
        else watched._proven_amplitude == pytest.approx(world.plan.tones.amplitudes[there, 0])
    )
    assert sure > 1e-5
    assert not why or watched._proven_amplitude == 1e-5, "nor is this amplitude proven"


def test_every_look_draws_errors_of_its_own(shaken: Shaken, monkeypatch: pytest.MonkeyPatch) -> None:
    numbers = []

    def spied(foresight: Any, look: Any, *rest: Any) -> Any:
        numbers.append(look.number)
        return update_answer(foresight, look, *rest)

    monkeypatch.setattr(escalation, "update_answer", spied)
    watched = shaken(raised_slowly([SIGHTED]))
    assert np.unique(numbers).tolist() == list(range(len(watched.steps)))
    foresight = made_foresight(1)
    at = Observation(np.array([0]), ALONG, np.ones(1, complex), ALONG[None, None] + 0j, SEEN)
    first, again, second = (update_answer(foresight, at._replace(number=n), 0, 0.0).members for n in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.allclose(first, second)


def test_what_moves_no_flower_that_is_seen_is_not_raised_beyond_what_the_model_allows(shaken: Shaken) -> None:
    """Stem and leaves in sight narrow the model; but pedicels follow flowers, and none of them is measured."""
    foresight, stalks = made_foresight(1), SIGHTED.copy()
    stalks[:FLOWERS] = False
    hidden, seen = (
        World(foresight, foresight.vectors[4], plan=made_plan((0.0005,) * 3), shown=[shown])
        for shown in (stalks, SIGHTED)
    )
    watched = shaken(hidden)
    shaken(seen)
    for piece in hidden.pieces[1:]:
        assert np.all(piece.amplitudes <= hidden.plan.tones.amplitudes.ravel() + 1e-12)
    assert max(p.amplitudes.max() for p in seen.pieces) > 1.4 * 0.0005
    assert escalation.OUT_OF_SIGHT in watched.steps[-2].decided


def test_a_shake_at_which_flowers_in_sight_do_not_seem_to_move_is_raised(shaken: Shaken) -> None:
    """What is too small to be measured is small."""
    foresight = made_foresight(1)
    noisy, sharp = (
        World(
            foresight, foresight.vectors[4], plan=made_plan((0.0005,) * 3), noise=noise, params=Params(most_seconds=30)
        )
        for noise in (4e-4, 1e-6)
    )
    steps, held = single(shaken(noisy)), shaken(sharp).steps[-1].amplitudes[0]
    assert np.isnan(steps[0].flowers).all()
    assert steps[1].amplitudes[0] == pytest.approx(escalation.RAISED * steps[0].amplitudes[0])
    assert 0.5 * held < steps[-1].amplitudes[0] <= 1.05 * held


@pytest.mark.parametrize("seconds", [10.0, 11.0, 14.0])
def test_the_time_ends_a_shake_that_could_be_raised_further(
    shaken: Shaken, monkeypatch: pytest.MonkeyPatch, seconds: float
) -> None:
    foresight = made_foresight(1)
    monkeypatch.setattr(Escalation, "least_look", 0.4)
    monkeypatch.setattr(escalation, "HOLD", 0.6)
    params = Params(most_seconds=seconds)
    world = World(foresight, foresight.vectors[4], plan=replace(FREE, tones=made_plan((1e-4,) * 3).tones))
    world.params, world.limits = params, HEEDLESS
    watched = shaken(world, raised=1.06)
    assert any("time" in step.decided for step in watched.steps[-2:])
    check_pieces(world, watched)
    assert world.pieces[-1].begin + world.pieces[-1].seconds > seconds - 2.6


@pytest.mark.parametrize("seed", range(2))
def test_turning_from_tone_to_tone_ends_in_time(shaken: Shaken, seed: int) -> None:
    """Each tone shows much in the probe and little when it is alone, so that the next one is tried."""
    foresight = made_foresight(seed)

    class Fading(World):
        def swings(self, _: Any, frames: Any, tones: Any, expected: Any = None) -> Any:
            found = super().swings(_, frames, tones, expected)
            return found if len(tones) > 1 else found._replace(phasors=0.05 * found.phasors)

    for seconds in np.arange(10.0, 13.0, 0.25):
        world = Fading(foresight, foresight.vectors[4], params=Params(most_seconds=float(seconds)))
        check_pieces(world, shaken(world))


def test_a_shake_that_the_actuator_ends_keeps_its_reach_while_it_turns_to_a_tone(shaken: Shaken) -> None:
    foresight = made_foresight(1)
    plan = made_plan((0.004, 0.004, 0.004), (0.004, 0.004, 0.004))
    world = World(foresight, foresight.vectors[4], plan=plan, limits=HEEDLESS)
    watched = shaken(world)
    check_pieces(world, watched)
    assert watched.steps[-1].amplitudes == pytest.approx([0.004])


@pytest.mark.parametrize("kind", WORDS)
def test_a_weak_organ_of_each_kind_ends_the_shake(shaken: Shaken, kind: str) -> None:
    foresight = made_foresight(1)
    vectors, rows = foresight.vectors.copy(), np.arange(foresight.vectors.shape[3])
    loads = ~np.isin(rows, rows[: FLOWERS + POINTS])
    vectors[..., loads, :] *= 0.05
    if kind != "joint_strain":  # a pedicel is bent by its flower
        vectors[..., foresight.where[kind], :] *= 400
    weak = foresight._replace(vectors=vectors)
    world = World(weak, vectors[4], plan=replace(FREE, press=8.0), params=Params(most_seconds=30))
    world.limits = Limits(price=30.0)
    watched = shaken(world)
    last = watched.steps[-1]
    assert last.binds == WORDS[kind]
    assert f"first by {WORDS[kind]}" in watched.steps[-2].decided
    assert last.amplitudes[0] < 0.5 * FREE.tones.reach.min()


@pytest.mark.parametrize("best", [0, 1, 2])
def test_a_slow_tone_is_left_as_slowly_as_it_is_begun(
    shaken: Shaken, monkeypatch: pytest.MonkeyPatch, best: int
) -> None:
    monkeypatch.setattr(Escalation, "least_ramp", 0.01)
    gains = [4.0 if tone == best else 0.7 for tone in range(3)] / (TONES / TONES[0]) ** 2
    foresight = made_foresight(2, gains=gains)
    world = World(foresight, foresight.vectors[3], plan=FREE)
    check_pieces(world, shaken(world))


@pytest.mark.parametrize("springs", [-1.5, 1.0])
def test_what_the_camera_sees_tells_what_an_arm_on_springs_does(shaken: Shaken, springs: float) -> None:
    """Its motors read what they are told. Looks that prove nothing teach nothing of it."""
    foresight = made_foresight(1, unsure=0.2)
    world = World(foresight, foresight.vectors[0], soft=0.3, springs=springs)
    watched = shaken(world)
    assert watched.joints is not None
    assert watched.joints.stiffness[0] == pytest.approx(springs, abs=0.4)
    tone = int(np.flatnonzero(watched.steps[-1].frequencies[0] == TONES)[0])
    direction = np.array(watched.steps[-1].direction)
    felt = watched.steps[-1].amplitudes[0] * world.flowers(tone, direction)
    assert watched.steps[-1].flowers == pytest.approx(felt, rel=0.1)


def test_looks_that_prove_nothing_teach_nothing_of_joints(shaken: Shaken) -> None:
    """A picture that stands still is not explained by an arm that hardly moves: loads stay as they were believed."""
    foresight = made_foresight(1, unsure=0.2)
    still = World(foresight, 0 * foresight.vectors[0], soft=0.6)
    blind, rigid = shaken(still), shaken(World(foresight, 0 * foresight.vectors[0]))
    assert blind.joints is None
    for kind, load in blind.steps[0].loads.items():
        assert load == pytest.approx(rigid.steps[0].loads[kind], rel=0.5)


def test_the_plan_as_carried_out_is_the_last_step(shaken: Shaken) -> None:
    foresight = made_foresight(1)
    world = World(foresight, foresight.vectors[4])
    watched = shaken(world)
    done, last = watched.executed_plan(watched.steps), watched.steps[-1]
    assert (done.frequency, done.amplitude) == (last.frequencies[0], last.amplitudes[0])
    assert done.duration == pytest.approx(last.end - last.begin)
    tone = int(np.flatnonzero(done.frequency == TONES)[0])
    omega2 = (2 * np.pi * done.frequency) ** 2
    logs, spread = believed("flowers", omega2 * semi_major(foresight.of(tone, ALONG)[:, :FLOWERS]), done.frequency)
    middle, doubt = np.log(done.amplitude) + logs.mean(axis=0), np.sqrt(logs.var(axis=0) + spread**2)
    assert np.log(done.predicted_acceleration) == pytest.approx(middle)
    assert np.log(done.predicted_acceleration_interval) == pytest.approx(
        middle[:, None] + 1.645 * doubt[:, None] * [-1, 1]
    )
    assert done.predicted_acceleration == pytest.approx(omega2 * done.predicted_amplitude)
    assert done.predicted_acceleration_interval == pytest.approx(omega2 * done.predicted_amplitude_interval)
    assert last.decided in done.reason
    assert watched.executed_plan(()) is world.plan


@pytest.mark.parametrize("springs", [-1.5, 1.0])
def test_what_was_predicted_of_a_shake_is_of_how_the_grip_moved(shaken: Shaken, springs: float) -> None:
    """An arm on soft springs moves the plant more or less than it was told, and that was known of it beforehand."""
    foresight = made_foresight(1, unsure=0.2)
    world = World(foresight, foresight.vectors[0], soft=0.3, springs=springs)
    watched = shaken(world)
    done = watched.executed_plan(watched.steps)
    tone = int(np.flatnonzero(done.frequency == TONES)[0])
    per_metre = semi_major(foresight.of(tone, done.direction)[:, :FLOWERS]) * (2 * np.pi * done.frequency) ** 2
    rigid = done.amplitude * np.exp(np.log(per_metre).mean(axis=0))
    moved = np.median(world.flowers(tone, done.direction)) / np.median(per_metre[0])
    assert np.median(done.predicted_acceleration / rigid) == pytest.approx(moved, rel=0.15)
    assert abs(np.log(moved)) > 0.15


@pytest.mark.parametrize("seconds", [1.0, 100.0, float("nan")])
def test_bad_params_are_refused(seconds: float) -> None:
    with pytest.raises(InputError, match="most_seconds"):
        Params(most_seconds=seconds)


@pytest.mark.parametrize("all_flowers", [True, False])
def test_a_shake_turns_back_to_what_was_worth_more_not_to_what_moved_the_median_more(
    shaken: Shaken, all_flowers: bool
) -> None:
    """Another tone moved all flowers more, or four of six of them, and the others not at all."""
    believed = made_foresight(0)
    watched = shaken(World(believed, believed.vectors[0], limits=HEEDLESS))
    last, now = watched.steps[-1], watched.steps[-1].amplitudes[0]
    here = int(np.abs(TONES - last.frequencies[0]).argmin())
    there = (here + 1) % len(TONES)
    felt = np.full((2, FLOWERS), 15.0)
    felt[1] = 20.0 if all_flowers else [20.0] * 4 + [0.1] * 2
    for n, flowers in zip((here, there), felt / now, strict=True):
        option, still = watched._options[n], Answers(*(0 * part for part in watched._options[n].prediction.answer))
        answer = still._replace(flowers=np.tile(flowers, (len(still.flowers), 1)))
        option.prediction = option.prediction._replace(flowers=flowers, answer=answer)
        option.allowed, option.raised_to = option.allowed._replace(amplitude=now), now
    watched._repeated, watched._same_since = True, np.inf  # no time at this amplitude yet
    held = watched._raise(here, now, "")
    assert np.flatnonzero(held.amplitudes).tolist() == [there if all_flowers else here]
    assert held.amplitudes.max() == pytest.approx(now)
    assert ("was worth more" in held.words) == all_flowers


def test_a_shake_is_gone_back_to_no_further_than_its_last_look_allows(shaken: Shaken) -> None:
    believed = made_foresight(0)
    watched = shaken(World(believed, believed.vectors[0], limits=HEEDLESS))
    tone = int(np.abs(TONES - watched.steps[-1].frequencies[0]).argmin())
    tried = watched._options[tone].tolerated
    assert tried == pytest.approx(max(s.amplitudes[0] for s in single(watched)))
    told = watched._options[tone].prediction
    watched._options[tone].update(told._replace(answer=Answers(*(100 * part for part in told.answer))))
    assert watched._options[tone].tolerated == watched._options[tone].allowed.amplitude < 0.5 * tried


OWN = np.arange(FLOWERS + POINTS)[:, None, None] < FLOWERS
ANY_PHASE = np.exp(2j * np.pi * np.random.default_rng(5).random((FLOWERS + POINTS, 1, 1)))
LIES = {
    "a picture that stands still": 0.0,
    "flowers that stand still": np.where(OWN, 0.0, 1.0),
    "flowers that nearly stand still": np.where(OWN, 0.15, 1.0),
    "all but flowers stand still": np.where(OWN, 1.0, 0.0),
    "a tenth of the motion": 0.1,
}


class Lying(World):
    """A world whose camera shows `share` of what it sees from a look on."""

    share: Any = 1.0
    since = 0

    def swings(self, _: Any, frames: Any, tones: Any, expected: Any = None) -> Any:
        found = super().swings(_, frames, tones, expected)
        return found._replace(phasors=self.share * found.phasors) if self.looks > self.since else found


def lied_to(shaken: Shaken, lie: str, since: int, *, soft: float = 1.0, seed: int = 1) -> tuple[Lying, Escalation]:
    """Shake a plant that is so much softer than believed while the camera lies from a look on."""
    foresight = made_foresight(seed)
    world = Lying(foresight, soft * foresight.vectors[4], plan=made_plan((0.0025,) * 3, (0.03,) * 3), noise=3e-5)
    world.share, world.since = LIES.get(lie, 1.0), since
    return world, shaken(world)


@pytest.mark.parametrize("soft", [1.0, 3.0])
@pytest.mark.parametrize("lie", LIES)
def test_what_a_camera_shows_that_does_not_see_the_plant_raises_nothing(
    shaken: Shaken, monkeypatch: pytest.MonkeyPatch, lie: str, soft: float
) -> None:
    """What cannot be observed is done as the model allows."""
    monkeypatch.setattr(foresight_module, "MISFIT", 0.2)
    for seed in range(3):
        world, watched = lied_to(shaken, lie, 0, soft=soft, seed=seed)
        planned = world.plan.tones.amplitudes.max()
        assert max(step.amplitudes[0] for step in single(watched)) <= planned * 1.0001
        assert watched.steps[-1].amplitudes[0] == pytest.approx(planned), "nor does it shake less than planned"
        assert "does not move as the gripper does" in watched.steps[-2].decided
        check_pieces(world, watched)


def test_a_probe_that_proves_nothing_teaches_nothing(shaken: Shaken, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was not looked at alone since is believed as before any look, with the errors of that."""
    monkeypatch.setattr(foresight_module, "MISFIT", 0.2)
    watched, seeing = (lied_to(shaken, lie, 0)[1] for lie in ("a picture that stands still", "none"))
    observed = {int(np.abs(TONES - step.frequencies[0]).argmin()) for step in single(watched)}
    for n, (blind, sighted) in enumerate(zip(watched._options, seeing._options, strict=True)):
        assert sighted.prediction.measured is not None
        if n not in observed:
            assert blind.prediction.measured is None
            assert np.all(np.isnan(blind.prediction.detectable))
            assert (
                np.log(blind.prediction.answer.flowers).std(axis=0).mean()
                > 1.2 * np.log(sighted.prediction.answer.flowers).std(axis=0).mean()
            )


@pytest.mark.parametrize(
    ("proven", "more", "left"), [(False, 1.2, False), (False, 1.3, True), (True, 1.2, True), (True, 0.9, False)]
)
def test_where_no_probe_shows_the_plant_the_plan_is_left_for_much_more_alone(
    shaken: Shaken, monkeypatch: pytest.MonkeyPatch, proven: bool, more: float, left: bool
) -> None:
    foresight = made_foresight(0)
    watched = shaken(World(foresight, foresight.vectors[0]))
    last = len(watched._frequencies) - 1
    monkeypatch.setattr(
        watched, "_make_option", lambda n, _: SimpleNamespace(predicted_worth={0: 1.0, last: more}.get(n, 0.5))
    )
    monkeypatch.setattr(watched, "_switch_to", lambda shake: shake)
    watched._proofs = [proven, False]
    assert watched._after_probe(0.5) == (last if left else 0)


def test_motion_as_large_as_that_of_the_plant_but_not_its_own_harms_nothing(
    shaken: Shaken, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(foresight_module, "MISFIT", 0.2)
    for seed in range(3):
        foresight = made_foresight(seed)
        world = Lying(foresight, foresight.vectors[4], plan=made_plan((0.004,) * 3, (0.03,) * 3), noise=3e-5)
        world.share = ANY_PHASE
        for step in single(shaken(world)):
            tone = int(np.abs(TONES - step.frequencies[0]).argmin())
            borne = limits_of(world.limits, world.plan.press, step.frequencies[0])
            assert all(step.amplitudes[0] * load < borne[kind] for kind, load in world.loads(tone).items())


@pytest.mark.parametrize("lie", ["a picture that stands still", "flowers that stand still"])
@pytest.mark.parametrize("since", [2, 3, 4])
def test_a_camera_that_goes_blind_on_the_way_takes_the_shake_back_to_what_it_saw(
    shaken: Shaken, monkeypatch: pytest.MonkeyPatch, lie: str, since: int
) -> None:
    monkeypatch.setattr(foresight_module, "MISFIT", 0.2)
    world, watched = lied_to(shaken, lie, since, soft=3.0)
    _, healthy = lied_to(shaken, "none", 0, soft=3.0)
    steps, planned = watched.steps, world.plan.tones.amplitudes.max()
    assert [s.amplitudes for s in steps[: since + 1]] == [s.amplitudes for s in healthy.steps[: since + 1]]
    seen = max(step.amplitudes[0] for step in steps[1:since])
    assert steps[-1].amplitudes[0] <= max(seen, planned) * 1.0001
    check_pieces(world, watched)


class Behind(World):
    """A world whose camera shows the look before, where that was at as many tones."""

    last: Any = None

    def swings(self, _: Any, frames: Any, tones: Any, expected: Any = None) -> Any:
        before, self.last = self.last, super().swings(_, frames, tones, expected)
        return before if before and before.phasors.shape == self.last.phasors.shape else self.last


@pytest.mark.parametrize(("seed", "member"), [(0, 3), (6, 9), (12, 15), (33, 16)])
def test_a_camera_that_shows_the_look_before_raises_a_soft_plant_no_further_than_one_that_sees(
    shaken: Shaken, monkeypatch: pytest.MonkeyPatch, seed: int, member: int
) -> None:
    monkeypatch.setattr(foresight_module, "MISFIT", 0.2)
    foresight, plan = made_foresight(seed), made_plan((0.0005,) * 3, (0.03,) * 3)
    behind, seeing = (
        [step.amplitudes[0] for step in single(shaken(kind(foresight, 3 * foresight.vectors[member], plan=plan)))]
        for kind in (Behind, World)
    )
    assert max(behind) <= max(seeing)
    assert behind[-1] <= seeing[-1]
    turns = np.diff(np.sign(np.diff([a for a, b in zip(behind, behind[1:], strict=False) if a != b])))
    assert np.count_nonzero(turns) <= 2, "it does not swing between amplitudes until time ends"


def test_a_flower_that_vanishes_while_it_is_raised_counts_as_it_was_measured_however_long(shaken: Shaken) -> None:
    believed = made_foresight(0)
    watched = shaken(World(believed, believed.vectors[0], limits=HEEDLESS))
    option = watched._options[int(np.abs(TONES - watched.steps[-1].frequencies[0]).argmin())]
    far, told = 1e5, option.prediction
    flowers = told.answer.flowers.copy()
    flowers[:, 0] = far
    option.update(
        told._replace(seen=told.seen | (np.arange(FLOWERS) == 0), answer=told.answer._replace(flowers=flowers))
    )
    missed = told._replace(seen=told.seen & (np.arange(FLOWERS) > 0))
    for _ in range(3):
        option.update(missed)
        assert np.all(option.prediction.answer.flowers[:, 0] >= far)
        assert np.array_equal(option.prediction.answer.flowers[:, 1:], told.answer.flowers[:, 1:])


def test_a_camera_that_sees_again_raises_the_shake_as_if_it_had_seen_the_probe(shaken: Shaken) -> None:
    class Waking(Lying):
        def swings(self, _: Any, frames: Any, tones: Any, expected: Any = None) -> Any:
            self.share = 0.0 if self.looks < 1 else 1.0
            return super().swings(_, frames, tones, expected)

    foresight, plan = made_foresight(1), made_plan((0.0005,) * 3)
    waking, awake = (kind(foresight, foresight.vectors[4], plan=plan, late=0.02) for kind in (Waking, Lying))
    for world in (waking, awake):
        world.params = Params(most_seconds=30)
    last = [shaken(world).steps[-1] for world in (waking, awake)]
    assert last[0].median == pytest.approx(last[1].median, rel=0.2)
    first = max(p.amplitudes.max() for p in waking.pieces[1:2])
    assert first <= plan.tones.amplitudes.max()


def test_a_shake_that_is_planned_too_far_is_taken_back_even_by_what_proves_nothing(shaken: Shaken) -> None:
    """All swings far, at any phase: not the plant that is believed, but nothing to go on with."""
    foresight = made_foresight(1)
    world = Lying(foresight, foresight.vectors[4], plan=made_plan((0.02,) * 3, (0.03,) * 3))
    world.share = 5 * ANY_PHASE
    steps = single(shaken(world))
    assert steps[-1].amplitudes[0] < 0.5 * world.plan.tones.amplitudes.max()


class Stiffer(World):
    """A plant that does a share of what it did in the probe, at one tone, once that is shaken alone."""

    stiff: int = 0
    share = 0.03

    def swings(self, _: Any, frames: Any, tones: Any, expected: Any = None) -> Any:
        found = super().swings(_, frames, tones, expected)
        alone = len(tones) == 1 and tones[0] == TONES[self.stiff]
        return found._replace(phasors=self.share * found.phasors) if alone else found


def test_a_shake_seen_twice_to_move_nothing_is_carried_out_as_planned(
    shaken: Shaken, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It proves nothing, and so teaches nothing: neither that this shake is worth little, nor that another is more."""
    monkeypatch.setattr(foresight_module, "MISFIT", 0.2)
    foresight = made_foresight(1)
    world, usual = (
        kind(foresight, foresight.vectors[4], plan=made_plan((0.004,) * 3, (0.03,) * 3), noise=3e-5)
        for kind in (Stiffer, World)
    )
    world.params = Params(most_seconds=30)
    world.stiff = int(np.abs(TONES - single(shaken(usual))[0].frequencies[0]).argmin())
    watched = shaken(world)
    steps = single(watched)
    assert {int(np.abs(TONES - step.frequencies[0]).argmin()) for step in steps} == {world.stiff}
    assert len(steps) == 2, "watched, and watched again, which is long enough"
    assert held_seconds(world) >= escalation.HOLD
    assert steps[-1].amplitudes[0] == pytest.approx(0.004, rel=1e-3)
    assert steps[-1].decided.endswith("Held long enough.")
    check_pieces(world, watched)


def test_what_is_seen_along_one_direction_is_believed_of_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foresight_module, "MISFIT", 0.02)
    foresight, lines = made_foresight(3), lines_across(8)
    own, parts = slice(0, FLOWERS + POINTS), np.array([1.0, 1.0]) / np.sqrt(2)
    truth = Foresight(TONES, foresight.vectors[5:6], *foresight[2:])
    nothing = np.full((FLOWERS, 3), np.nan)
    along = [
        Answer(foresight.of(0, line), nothing + 0j, nothing, AXES[:FLOWERS], observed=False) for line in lines[[0, 4]]
    ]
    moved = np.einsum("px,pxa->pa", truth.of(0, lines[2])[0, own], AXES)
    seen = Swings(moved[:, None], np.full((FLOWERS + POINTS, 3), 1e-3), AXES)
    at = Observation(np.array([0]), lines[2], np.ones(1, complex), lines[2][None, None] + 0j, seen)
    before = predict(foresight, TONES[0], sum_answers(along, parts), 0.0)
    before = before._replace(detectable=np.full(FLOWERS, np.inf))
    found = update_directions(foresight, at, 0.0, along, parts, before)
    for line, prior, posterior in zip(lines[[0, 4]], along, found, strict=True):
        off = [np.linalg.norm(one.members.mean(axis=0) - truth.of(0, line)[0]) for one in (prior, posterior)]
        assert off[1] < 0.2 * off[0]
        assert posterior.members.std(axis=0).mean() < prior.members.std(axis=0).mean()
        assert not posterior.observed
    blind = at._replace(swings=seen._replace(std=np.full_like(seen.std, np.nan)))
    for prior, same in zip(along, update_directions(foresight, blind, 0.0, along, parts, before), strict=True):
        assert np.allclose(prior.members, same.members)


@pytest.mark.parametrize("lie", ["none", "a picture that stands still"])
def test_other_directions_learn_from_the_newest_observation_that_shows_the_plant(
    shaken: Shaken, monkeypatch: pytest.MonkeyPatch, lie: str
) -> None:
    """From no other, and each time from what the probes taught: what is wrong in one look is wrong in the next too."""
    used, taught, real = list[Observation](), list[list[Answer]](), escalation.update_directions

    def spied(foresight: Any, seen: Observation, delay: float, along: list[Answer], *rest: Any) -> Any:
        used.append(seen)
        taught.append(along)
        return real(foresight, seen, delay, along, *rest)

    monkeypatch.setattr(escalation, "update_directions", spied)
    believed = made_foresight(2, unsure=0.8)
    world = Lying(believed, believed.vectors[3], plan=made_plan((0.002,) * 3, (0.02,) * 3, lines=8), noise=3e-5)
    world.plan, world.share, world.since = replace(world.plan, press=1000.0), LIES.get(lie, 1.0), 4
    watched = shaken(world)
    assert len(used) >= 2
    proven = {seen.number for seen, shown in zip(watched._observations, watched._proofs, strict=True) if shown}
    assert {seen.number for seen in used} <= proven
    assert lie != "none" or len(proven) == len(watched.steps)
    probes = [id(answer) for answers in watched._probe_answers for answer in answers]
    shakes = [tuple(seen.direction) + tuple(seen.frequency_indices) for seen in used]
    for along, shake in zip(taught, shakes, strict=True):
        assert all(id(answer) in probes for answer in along) or shake != shakes[0]


def moved_by_sensor(watched: Escalation) -> list[bool]:
    """Return of each look whether a sensor on the hand told what the gripper did."""
    return [look.measured for look in watched._observations]


@pytest.mark.parametrize("springs", [-2.0, 1.5])
@pytest.mark.parametrize("late", [0.0, 0.02])
def test_a_sensor_on_the_hand_tells_what_the_gripper_does_where_no_look_proves_anything(
    shaken: Shaken, springs: float, late: float
) -> None:
    """Joints that are hardly known, a camera that sees nothing move: what is predicted is of the grip's true motion."""
    foresight = made_foresight(1, unsure=0.2)

    def delayed(told: ImuReadings) -> ImuReadings:
        return replace(told, times=told.times + late)

    world = World(foresight, foresight.vectors[0], soft=0.5, springs=springs, imu=delayed)
    still = replace(world, truth=0 * foresight.vectors[0], imu=delayed)
    blind, told = shaken(replace(still, imu=None)), shaken(still)
    assert all(moved_by_sensor(told))
    assert not any(told._proofs)
    assert told.joints is not None
    assert told.joints.stiffness[0] == pytest.approx(springs, abs=0.35)
    known = shaken(World(foresight, 0 * foresight.vectors[0], arm=np.exp(-world.soft * springs) * np.eye(3)))
    for kind, load in told.steps[0].loads.items():
        assert load == pytest.approx(known.steps[0].loads[kind], rel=0.05), kind
        assert abs(np.log(blind.steps[0].loads[kind] / known.steps[0].loads[kind])) > 0.1, kind


UNBELIEVABLE: dict[str, Callable[[ImuReadings], ImuReadings]] = {
    "silent": lambda told: ImuReadings(told.times[:0], told.acceleration[:0], told.rate[:0]),
    "on another machine": lambda told: replace(
        told, acceleration=told.acceleration.mean(axis=0) + 1e-3 * (told.acceleration - told.acceleration.mean(axis=0))
    ),
    "turned about the vertical": lambda told: replace(
        told, acceleration=told.acceleration @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    ),
    "upside down": lambda told: replace(told, acceleration=-told.acceleration),
}


@pytest.mark.parametrize("fault", UNBELIEVABLE)
def test_a_sensor_that_cannot_be_right_changes_nothing_and_is_named_once(shaken: Shaken, fault: str) -> None:
    foresight = made_foresight(1, unsure=0.2)
    plain = World(foresight, foresight.vectors[0], soft=0.3, springs=0.5)
    without, faulty = shaken(plain), shaken(replace(plain, imu=UNBELIEVABLE[fault], pieces=[]))
    assert not any(moved_by_sensor(faulty))
    assert [step.amplitudes for step in faulty.steps] == [step.amplitudes for step in without.steps]
    assert [step.loads for step in faulty.steps] == [step.loads for step in without.steps]
    said = [step.decided for step in faulty.steps if "inertial sensor" in step.decided]
    assert len(said) == 1
    assert "believed, not measured" in said[0]


def test_a_sensor_that_falls_silent_is_believed_until_then(shaken: Shaken) -> None:
    foresight, looks = made_foresight(1, unsure=0.2), [0]

    def cut(told: ImuReadings) -> ImuReadings:
        looks[0] += 1
        return told if looks[0] < 2 else UNBELIEVABLE["silent"](told)

    watched = shaken(World(foresight, foresight.vectors[0], soft=0.6, springs=-1.5, imu=cut))
    assert moved_by_sensor(watched)[:2] == [True, False]
    assert watched.joints is not None
    assert watched.joints.stiffness[0] == pytest.approx(-1.5, abs=0.4)
