"""What is believed of a shake once a camera has seen a small one: exact sight tells, no sight and noise do not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from made_foresight import ALONG, AXES, FLOWERS, KINDS, POINTS, TONES, World, lines_across, made_foresight
from sample_plants import branched

from anther.core.geometry import Intrinsics, look_at
from anther.plant.limits import stalk_strain
from anther.plant.model import TOMATO, build_plant
from anther.pollination import decision
from anther.pollination.decision import OBSERVED_ERRORS, expected
from anther.pollination.escalation import _foresight as foresight_module
from anther.pollination.escalation._foresight import (
    Foresight,
    misfit,
    moves_or_stands,
    repeats_motion,
    update_members,
    watch_points,
)
from anther.pollination.escalation._knowledge import (
    DELAYS,
    DEPTH_BAND,
    STIFFNESS_DEVIATES,
    JointBelief,
    Observation,
    Prediction,
    fit_motors,
    log_likelihood,
    predict,
    sum_answers,
    update_answer,
)
from anther.pollination.escalation._option import Option
from anther.pollination.shake.observables import semi_major
from anther.robot.devices import ArmSample
from anther.robot.swing import Swing

ROWS = np.arange(FLOWERS + POINTS)


def evidence(*given: Any) -> float:
    """Return ln of how much likelier it is that a plant moves as predicted than that it stands still."""
    moves, stands = moves_or_stands(*given)
    return float(moves - stands)


def off(foresight: Foresight, vectors: np.ndarray, truth: np.ndarray) -> float:
    """Return the error of all vectors, over what is not known of them beforehand."""
    return float(np.linalg.norm(vectors - truth) / np.linalg.norm(of(foresight).mean(axis=0) - truth))


def of(foresight: Foresight) -> np.ndarray:
    """Return what the members say of a shake along `ALONG` at the second tone."""
    return foresight.of(1, ALONG)


def seen(truth: np.ndarray, rows: np.ndarray = ROWS) -> np.ndarray:
    return np.einsum("px,pxa->pa", truth[rows], AXES[rows])


def deviation(each: np.ndarray) -> np.ndarray:
    """Return that of points whose depth is not read."""
    return np.column_stack([each, each, np.full(len(each), np.nan)])


@pytest.mark.parametrize("member", [1, 7, 20, 31])
def test_what_was_seen_exactly_of_a_member_tells_which_it_is(member: int, monkeypatch: pytest.MonkeyPatch) -> None:
    foresight = made_foresight(3)
    truth = of(foresight)[member]
    std = deviation(np.full(len(ROWS), 1e-9))
    roughly = update_members(of(foresight), seen(truth), std, AXES).mean(axis=0)
    assert off(foresight, roughly, truth) < 0.35
    monkeypatch.setattr(foresight_module, "MISFIT", 1e-4)
    exactly = update_members(of(foresight), seen(truth), std, AXES)
    assert off(foresight, exactly.mean(axis=0), truth) < 1e-2
    for kind in KINDS:
        (load,) = foresight.load(kind, truth[None])
        assert foresight.load(kind, exactly) == pytest.approx(load, rel=0.02), "all members come to agree"


def test_the_more_is_seen_the_more_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foresight_module, "MISFIT", 1e-4)
    foresight = made_foresight(3)
    errors = np.zeros(4)
    for member in range(1, 32):
        truth = of(foresight)[member]
        for i, count in enumerate((0, 1, 5, 26)):
            some = ROWS[:count]
            std = deviation(np.full(count, 0.3))
            found = update_members(of(foresight), seen(truth, some), std, AXES[:count])
            errors[i] += off(foresight, found.mean(axis=0), truth) ** 2
    assert np.all(np.diff(errors) < 0)
    assert errors[-1] < 0.1 * errors[0]


def test_with_nothing_seen_the_members_are_as_they_were() -> None:
    foresight = made_foresight(3)
    nothing = update_members(of(foresight), np.zeros((0, 3), complex), np.zeros((0, 3)), AXES[:0])
    assert np.array_equal(nothing, of(foresight))


def test_what_is_all_noise_changes_nothing() -> None:
    foresight = made_foresight(3)
    truth = of(foresight)[9]
    unsure = update_members(of(foresight), seen(truth), deviation(np.full(len(ROWS), 1e4)), AXES)
    assert np.allclose(unsure, of(foresight), rtol=1e-2, atol=1e-2)


def test_what_is_left_unknown_is_as_wide_as_the_error_of_what_is_believed() -> None:
    """Over all members as truth, the errors of a load are as large as the narrowed members' spread says."""
    foresight, std = made_foresight(3), deviation(np.full(5, 0.2))
    rng, errors, spreads = np.random.default_rng(2), [], []
    for member in range(1, 32):
        truth = of(foresight)[member]
        for _ in range(4):
            noise = 0.2 * (rng.normal(size=(5, 3)) + 1j * rng.normal(size=(5, 3)))
            found = update_members(of(foresight), seen(truth, ROWS[:5]) + noise, std, AXES[:5])
            loads = foresight.load("stem_strain", found)
            errors.append(loads.mean() - foresight.load("stem_strain", truth[None])[0])
            spreads.append(loads.std())
    prior = foresight.load("stem_strain", of(foresight)).std()
    assert 0.5 < np.sqrt(np.mean(np.square(errors)) / np.mean(np.square(spreads))) < 1.5
    assert np.mean(spreads) < 0.6 * prior


OBSERVED = 2.0 - 1.0j


@pytest.fixture(params=[1500])
def toy(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Callable[[float], tuple[Any, ...]]:
    """Two points that move along x alone: of either part the deviations are 1 and 2, the correlation is 0.8. The first
    is seen. The members, however many, have exactly these moments."""
    monkeypatch.setattr(foresight_module, "MISFIT", 0.0)
    rng, members = np.random.default_rng(1), np.zeros((request.param, 2, 3), complex)
    drawn = rng.normal(size=(request.param, 2)) + 1j * rng.normal(size=(request.param, 2))
    drawn -= drawn.mean(axis=0)
    drawn = drawn @ np.linalg.inv(np.linalg.cholesky(np.cov(drawn.T))).T
    members[:, :, 0] = np.sqrt(2) * drawn @ np.linalg.cholesky(PRIOR).T

    def seen_of(std: float, value: complex = OBSERVED) -> tuple[Any, ...]:
        return members, np.array([[value, 0, 0]]), np.array([[std, np.nan, np.nan]]), np.eye(3)[None]

    return seen_of


PRIOR = np.array([[1.0, 1.6], [1.6, 4.0]])
"""Covariance of either part."""


@pytest.mark.parametrize("std", [0.3, 1.0, 3.0])
def test_the_update_is_exact_where_all_is_gaussian_and_members_are_many(
    toy: Callable[..., tuple[Any, ...]], std: float
) -> None:
    """`std` is of either part, real and imaginary: with a deviation of 1 beforehand half of what is seen counts."""
    gain = PRIOR[:, 0] / (PRIOR[0, 0] + std**2)
    left = PRIOR - np.outer(gain, PRIOR[0])
    found = update_members(*toy(std))[..., 0]
    assert found.mean(axis=0) == pytest.approx(gain * OBSERVED), "what is drawn adds nothing in the mean"
    for part in (found.real, found.imag):
        assert part.std(axis=0) == pytest.approx(np.sqrt(np.diag(left)), rel=0.06)
        assert np.cov(part.T) == pytest.approx(left, rel=0.12)


@pytest.mark.parametrize("toy", [50], indirect=True)
@pytest.mark.parametrize("std", [0.3, 1.0, 3.0])
def test_the_misfit_is_the_exact_likelihood_where_all_is_gaussian(
    toy: Callable[..., tuple[Any, ...]], std: float
) -> None:
    def expected(value: complex, std: float) -> float:
        variance = 2 * (PRIOR[0, 0] + std**2)
        return abs(value) ** 2 / variance + np.log(variance)

    for value in (3.0, 2.0j, OBSERVED):
        more = misfit(*toy(std, value)) - misfit(*toy(std, 0.0))
        assert more == pytest.approx(expected(value, std) - expected(0.0, std))
        assert misfit(*toy(std, value)) == pytest.approx(expected(value, std)), "wide errors are no free explanation"


@pytest.mark.parametrize("toy", [600], indirect=True)
def test_errors_that_are_drawn_of_two_looks_have_nothing_in_common(toy: Callable[..., tuple[Any, ...]]) -> None:
    members, *given = toy(1.0)
    exact = members[:, 0, 0] + 0.5 * (OBSERVED - members[:, 0, 0])
    first, again, second = (update_members(members, *given, number)[:, 0, 0] - exact for number in (1, 1, 2))
    assert np.array_equal(first, again)
    for drawn in (first, second):
        assert np.sqrt(np.mean(np.abs(drawn) ** 2)) == pytest.approx(0.5 * np.sqrt(2), rel=0.05)
    assert abs(np.vdot(first, second)) < 0.1 * np.linalg.norm(first) * np.linalg.norm(second)


def test_a_point_that_is_less_sure_counts_for_less(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foresight_module, "MISFIT", 1e-3)
    foresight, errors = made_foresight(3), np.zeros(2)
    alike, doubted = np.full(len(ROWS), 0.05), np.full(len(ROWS), 0.05)
    doubted[0] = 10.0
    for member in range(1, 32):
        truth = of(foresight)[member]
        wrong = seen(truth)
        wrong[0] += 3.0  # the first flower is another one
        found = [update_members(of(foresight), wrong, deviation(std), AXES).mean(axis=0) for std in (alike, doubted)]
        errors += [off(foresight, one, truth) ** 2 for one in found]
    assert errors[1] < 0.5 * errors[0]


def test_members_that_explain_what_was_seen_fit_better_than_others() -> None:
    foresight, other = made_foresight(3), made_foresight(4)
    std = deviation(np.full(len(ROWS), 0.01))
    fits = [float(misfit(of(foresight), seen(of(f)[9]), std, AXES)[0]) for f in (foresight, other)]
    assert fits[0] < fits[1]


def test_the_misfit_is_that_of_gaussian_noise_and_the_members_own_spread(monkeypatch: pytest.MonkeyPatch) -> None:
    """-ln likelihood by the covariance of what is seen, written out."""
    monkeypatch.setattr(foresight_module, "MISFIT", 0.0)
    members, std = of(made_foresight(3)), deviation(np.full(len(ROWS), 0.05))
    motion, used = seen(of(made_foresight(4))[9]), np.isfinite(std)
    said = np.stack([seen(member)[used] for member in members])
    off = said - said.mean(axis=0)
    covariance = 2 * np.diag(std[used] ** 2) + off.T @ off.conj() / (len(members) - 1)
    miss = motion[used] - said.mean(axis=0)
    expected = (miss.conj() @ np.linalg.solve(covariance, miss)).real + np.linalg.slogdet(covariance)[1]
    assert misfit(members, motion, std, AXES) == pytest.approx([expected])


def test_what_moves_as_the_members_say_is_evidence_and_what_stands_still_or_moves_otherwise_is_none() -> None:
    for seed in range(5):
        members, std = of(made_foresight(seed)), deviation(np.full(len(ROWS), 0.01))
        motion = seen(members[9])
        turned = motion * np.exp(2j * np.pi * np.random.default_rng(seed).random((len(ROWS), 1)))
        assert evidence(members, motion, std, AXES) > 20
        assert evidence(members, 3 * motion, std, AXES) > 20, "a plant may be softer than believed"
        for lie in (0 * motion, 0.1 * motion, turned):
            assert evidence(members, lie, std, AXES) < -20


@pytest.mark.parametrize("raised", [1.5, 2.0, 9.0])
def test_a_look_that_shows_the_motion_before_a_raise_is_told_from_one_that_shows_the_raise(
    raised: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(foresight_module, "MISFIT", 0.2)
    rng = np.random.default_rng(2)
    for noise, told in ((1e-5, True), (1e-2, False)):
        std = deviation(np.full(len(ROWS), noise))
        motion = 1e-3 * seen(of(made_foresight(3))[4])

        def shown(times: float, spread: float = 0.1, *, std: np.ndarray = std, motion: np.ndarray = motion) -> Any:
            """Each point is followed a bit wrongly, and with the noise of the tracker."""
            error = rng.normal(size=(2, *motion.shape))
            return times * motion * (1 + spread * error[0]) + np.nan_to_num(std) * (error[1] + 1j * error[0]), std

        before = shown(1.0)
        assert not repeats_motion(shown(raised), before, raised, 0.0)
        assert repeats_motion(shown(1.0), before, raised, 0.0) == told
        assert not repeats_motion(shown(1.0), before, raised, np.log(raised)), "it may be that it still grows"
        assert not repeats_motion(shown(1.0), before, 1.05, 0.0), "too small a raise tells nothing"
        assert not repeats_motion(shown(1.0), before, 1 / raised, 0.0), "nor does what was taken back"


def test_what_is_lost_in_noise_is_no_evidence() -> None:
    members = of(made_foresight(3))
    motion, hidden = seen(members[9]), np.full((len(ROWS), 3), np.nan)
    assert evidence(members, motion, hidden, AXES) == 0
    assert abs(evidence(members, motion, deviation(np.full(len(ROWS), 100.0)), AXES)) < 0.1


def look(world: World, *, tones: tuple[int, ...] = (0, 1, 2), direction: np.ndarray = ALONG) -> Observation:
    """Return what is seen of a shake of 1 mm at some tones."""
    sizes = np.isin(np.arange(len(TONES)), tones) * 1e-3
    world.pieces = [Swing.first(TONES, sizes, 2.0, 0.5)]
    active = np.array(tones)
    commanded = np.asarray(1e-3 * np.exp(-2j * np.pi * TONES[active] * world.begin), dtype=np.complex128)
    gripper = np.asarray(commanded[:, None] * (world.arm @ direction), dtype=np.complex128)
    world.directions = np.repeat(direction[None], len(TONES), axis=0)
    seen = world.swings(None, [None], TONES[active])  # type: ignore[list-item]
    return Observation(active, direction, commanded, gripper[None], seen)


def told(foresight: Foresight, at: Observation, i: int, late: float) -> Prediction:
    """Return what is known of one tone of a look."""
    return predict(foresight, float(TONES[at.frequency_indices[i]]), update_answer(foresight, at, i, late), late)


@pytest.mark.parametrize("late", [0.0, 0.01, 0.03])
def test_a_late_clock_is_found(late: float) -> None:
    foresight = made_foresight(3, unsure=0.3)
    for member in (0, 5, 11):
        world = World(foresight, foresight.vectors[member], late=late)
        at = look(world)
        (found,) = log_likelihood(foresight, at, at.gripper, DELAYS)
        assert DELAYS[found.argmax()] == pytest.approx(late, abs=0.005)


@pytest.fixture
def trusted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let members be trusted, and loads as they are narrowed."""
    monkeypatch.setattr(foresight_module, "MISFIT", 1e-3)
    sure = ((0.0,) * 4, (1.0,) * 4, (1e-9,) * 4)
    monkeypatch.setattr(decision, "OBSERVED_ERRORS", dict.fromkeys(OBSERVED_ERRORS, sure))


@pytest.mark.usefixtures("trusted")
def test_a_late_clock_that_is_known_changes_nothing_else() -> None:
    foresight = made_foresight(3)
    for late in (0.0, 0.02):
        world = World(foresight, foresight.vectors[5], late=late)
        at = look(world)
        for i in range(3):
            one = told(foresight, at, i, late)
            for kind, load in world.loads(i).items():
                assert one.loads[kind] == pytest.approx(load, rel=0.05)


@pytest.mark.usefixtures("trusted")
def test_what_was_seen_along_two_lines_tells_of_every_other() -> None:
    foresight = made_foresight(3)
    for member in (5, 9):
        world = World(foresight, foresight.vectors[member])
        axes = [update_answer(foresight, look(world, direction=axis), 1, 0.0) for axis in lines_across(2)]
        for direction in lines_across(5):
            answer = sum_answers(axes, lines_across(2) @ direction)
            one = predict(foresight, float(TONES[1]), answer, 0.0)
            assert one.flowers == pytest.approx(world.flowers(1, direction), rel=0.05)
            for kind, load in world.loads(1, direction).items():
                assert one.loads[kind] == pytest.approx(load, rel=0.05)


def test_what_was_not_seen_along_one_line_is_not_seen_along_a_sum() -> None:
    foresight, hidden = made_foresight(3), np.ones(FLOWERS + POINTS, bool)
    hidden[2] = False
    clear, partly = (
        World(foresight, foresight.vectors[5], shown=[s]) for s in (np.ones(FLOWERS + POINTS, bool), hidden)
    )
    axes = [
        update_answer(foresight, look(w, direction=a), 1, 0.0)
        for w, a in zip((clear, partly), lines_across(2), strict=True)
    ]
    seen = [
        predict(foresight, 4.0, sum_answers(axes, parts), 0.0).seen[2]
        for parts in np.array([[1, 0], [0, 1], [0.6, 0.8]])
    ]
    assert seen == [True, False, False]


@pytest.mark.usefixtures("trusted")
def test_flowers_that_are_seen_are_measured_and_others_believed() -> None:
    foresight = made_foresight(3)
    shown = np.ones(FLOWERS + POINTS, bool)
    shown[[1, 4]] = False
    world = World(foresight, foresight.vectors[5], shown=[shown])
    one = told(foresight, look(world), 1, 0.0)
    assert one.seen.tolist() == shown[:FLOWERS].tolist()
    assert one.flowers == pytest.approx(world.flowers(1), rel=0.05)


def test_a_flower_that_moves_less_than_the_camera_can_tell_is_not_measured() -> None:
    foresight = made_foresight(3)
    world = World(foresight, foresight.vectors[5], noise=3e-3)
    one = told(foresight, look(world), 1, 0.0)
    assert not one.seen.any()
    expected = (2 * np.pi * TONES[1]) ** 2 * semi_major(of(foresight)[:, :FLOWERS].mean(axis=0))
    assert np.abs(np.log(one.flowers / expected)).max() < 1.0


def test_one_flower_that_swings_unlike_all_others_is_taken_for_something_else() -> None:
    foresight = made_foresight(3, unsure=0.1)
    at = look(World(foresight, foresight.vectors[5]))
    before = told(foresight, at, 1, 0.0)
    for times, measured in ((8.0, True), (20.0, False)):
        phasors = at.swings.phasors.copy()
        phasors[2] *= times
        after = told(foresight, at._replace(swings=at.swings._replace(phasors=phasors)), 1, 0.0)
        assert after.seen.tolist() == [measured or k != 2 for k in range(FLOWERS)]
    for kind in decision.COSTS:
        assert after.loads[kind] == pytest.approx(before.loads[kind], rel=0.1), (
            "nothing is concluded from what is mistaken"
        )
    assert after.flowers[2] == pytest.approx(before.flowers[2], rel=0.2)
    all_of_them = at.swings._replace(phasors=20 * at.swings.phasors)
    assert told(foresight, at._replace(swings=all_of_them), 1, 0.0).seen.all(), "a plant may answer unlike its model"


def test_what_a_decision_is_told_is_what_was_measured_and_else_what_the_narrowed_members_say() -> None:
    """Of a flower that is seen what it does, whatever members say; each member's own loads."""
    foresight = made_foresight(3)
    shown = np.ones(FLOWERS + POINTS, bool)
    shown[2] = False
    world = World(foresight, foresight.vectors[5], shown=[shown])
    at = look(world)
    one = update_answer(foresight, at, 1, 0.0)
    said = told(foresight, at, 1, 0.0)
    omega2, own = (2 * np.pi * TONES[1]) ** 2, foresight.where["flowers"]
    assert said.answer.flowers[:, 2] == pytest.approx(omega2 * semi_major(one.members[:, own])[:, 2])
    others = np.arange(FLOWERS) != 2
    assert np.all(said.answer.flowers[:, others] == said.answer.flowers[0, others])
    assert said.answer.flowers[0, others] == pytest.approx(world.flowers(1)[others], rel=0.1)
    for kind in decision.COSTS:
        assert getattr(said.answer, kind) == pytest.approx(foresight.load(kind, one.members))


def test_what_is_expected_is_the_median_with_the_errors_of_what_was_measured_and_what_was_not() -> None:
    """Pedicels bend by what the flower that feels most is expected to feel, whatever the rods say of them."""
    foresight, tone = made_foresight(3), float(TONES[1])
    shown = np.ones(FLOWERS + POINTS, bool)
    shown[2] = False
    one = told(foresight, look(World(foresight, foresight.vectors[5], shown=[shown])), 1, 0.0)
    assert one.seen.tolist() == shown[:FLOWERS].tolist()
    for f, measured in enumerate(one.seen.tolist()):
        assert one.flowers[f] == pytest.approx(expected("flowers", one.answer.flowers[:, f], tone, measured))
    assert one.flowers[2] != pytest.approx(expected("flowers", one.answer.flowers[:, 2], tone, measured=True))
    for kind in decision.COSTS:
        assert one.loads[kind] == pytest.approx(expected(kind, getattr(one.answer, kind), tone, measured=False))
    assert one.loads["joint_strain"] == pytest.approx(stalk_strain(tone) * one.flowers.max())


def test_a_flower_that_is_followed_but_not_measured_moves_no_more_than_would_have_been_measured() -> None:
    """Members say that it swings far; of one that is not followed they alone speak."""
    foresight = made_foresight(3)
    truth, shown = foresight.vectors[5].copy(), np.ones(FLOWERS + POINTS, bool)
    truth[..., 2, :] = 0.0
    lost = shown.copy()
    lost[2] = False
    still, hidden = (
        told(foresight, look(World(foresight, truth, shown=[s], noise=1e-4)), 1, 0.0) for s in (shown, lost)
    )
    assert not still.seen[2]
    assert not hidden.seen[2]
    assert np.isnan(hidden.detectable[2])
    assert still.answer.flowers[:, 2].max() <= still.detectable[2] * (1 + 1e-9)
    assert hidden.answer.flowers[:, 2].min() > still.detectable[2]
    assert still.flowers[2] < 0.5 * hidden.flowers[2]
    threshold = foresight_module.SIGNIFICANCE * np.sqrt(2) * 1e-4 / 1e-3 * (2 * np.pi * TONES[1]) ** 2
    assert still.detectable[2] == pytest.approx(threshold, rel=0.5), "three deviations of what was seen across and down"


@pytest.mark.parametrize(("share", "believed"), [(0.0, True), (0.03, True), (0.4, False), (1.0, False)])
def test_a_flower_that_stands_still_while_all_else_moves_is_taken_for_what_is_behind_it(
    share: float, believed: bool
) -> None:
    """A neighbour's flower, or a bright place: what is known of this one are the members alone."""
    foresight = made_foresight(3)
    truth, shown = foresight.vectors[5].copy(), np.ones(FLOWERS + POINTS, bool)
    truth[..., 2, :] *= share
    lost = shown.copy()
    lost[2] = False
    worlds = [World(foresight, truth, shown=[s], noise=1e-5) for s in (shown, lost)]
    seen, hidden = (told(foresight, look(world), 1, 0.0) for world in worlds)
    assert seen.seen[2] == (not believed)
    assert np.isnan(seen.detectable[2]) == believed
    if believed:
        assert seen.answer.flowers == pytest.approx(hidden.answer.flowers, rel=0.2)
    else:
        assert seen.answer.flowers[0, 2] == pytest.approx(worlds[0].flowers(1)[2], rel=0.1)


def test_a_flower_that_only_the_look_before_measured_goes_on_counting_as_much_but_as_not_measured() -> None:
    foresight, sighted = made_foresight(3), np.ones(FLOWERS + POINTS, bool)
    lost = sighted.copy()
    lost[2] = False
    first, second = (
        told(foresight, look(World(foresight, foresight.vectors[5], shown=[s])), 1, 0.0) for s in (sighted, lost)
    )
    option = Option(float(TONES[1]), 8.0, 3.0, 1e-3, 0.02, first)
    before = option.allowed
    option.update(second)
    most = np.fmax(first.answer.flowers[:, 2], second.answer.flowers[:, 2])
    assert option.prediction.answer.flowers[:, 2] == pytest.approx(most)
    assert not np.allclose(second.answer.flowers[:, 2], first.answer.flowers[:, 2], rtol=0.05)
    assert option.prediction.seen.tolist() == lost[:FLOWERS].tolist()
    others = np.arange(FLOWERS) != 2
    assert option.prediction.answer.flowers[:, others] == pytest.approx(second.answer.flowers[:, others])
    assert option.allowed != before, "what it may do is weighed anew"
    third = second._replace(answer=second.answer._replace(flowers=1.1 * second.answer.flowers))
    option.update(third)
    kept = np.fmax(first.answer.flowers[:, 2], third.answer.flowers[:, 2])
    assert option.prediction.answer.flowers[:, 2] == pytest.approx(kept), "however long it is not seen"


def test_the_more_is_in_sight_the_less_members_differ() -> None:
    foresight, sights = made_foresight(3), (np.zeros(FLOWERS + POINTS, bool), np.ones(FLOWERS + POINTS, bool))
    blind, sighted = (
        told(foresight, look(World(foresight, foresight.vectors[5], shown=[shown])), 1, 0.0).answer for shown in sights
    )
    for kind in decision.COSTS:
        assert np.log(getattr(sighted, kind)).std() < 0.7 * np.log(getattr(blind, kind)).std()


def test_depth_tells_of_fast_tones_only_swings_that_it_cannot_feign() -> None:
    foresight = made_foresight(3)
    at = look(World(foresight, foresight.vectors[5], depth=True))
    far = np.abs(at.swings.phasors[:FLOWERS, 1, 2]) >= 1e-3
    assert 0 < far.sum() < FLOWERS
    for factor, told_by_depth in ((1.0, True), (DEPTH_BAND / TONES[1], True), (1.01 * DEPTH_BAND / TONES[1], far)):
        quick = foresight._replace(frequencies=factor * TONES)
        assert np.all(np.isfinite(update_answer(quick, at, 1, 0.0).std[:, 2]) == told_by_depth)


@pytest.mark.usefixtures("trusted")
def test_all_counts_per_metre_that_was_commanded() -> None:
    foresight = made_foresight(3)
    world = World(foresight, foresight.vectors[5])
    at = look(world)
    once: Prediction = told(foresight, at, 1, 0.0)
    halved = at.swings._replace(phasors=0.5 * at.swings.phasors)
    weak = at._replace(gripper=0.5 * at.gripper, swings=halved)
    half = told(foresight, weak, 1, 0.0)
    for kind in KINDS:
        assert half.loads[kind] == pytest.approx(0.5 * once.loads[kind], rel=0.01)
    assert half.flowers == pytest.approx(0.5 * once.flowers, rel=0.01)


def test_the_motors_own_swings_are_read() -> None:
    sizes = np.array([1e-3, 2e-3, 0.5e-3]) * np.exp(1j * np.array([0.3, -1.0, 2.0]))
    along, middle = np.array([0.6, 0.8, 0.0, 0.1]), np.array([0.7, 0.1, 0.2, -1.0])
    times = 40 + np.arange(0, 1.5, 0.01)
    swing = np.imag(np.exp(2j * np.pi * times[:, None] * TONES) @ sizes) + 1e-4 * (times - 40)
    samples = [ArmSample(t, 0 * middle, middle + s * along) for t, s in zip(times, swing, strict=True)]
    assert np.allclose(fit_motors(samples, TONES), sizes[:, None] * along, atol=1e-6)


@pytest.mark.usefixtures("trusted")
def test_loads_are_of_what_the_gripper_does_not_of_what_it_is_told() -> None:
    """An arm that is soft goes aside: what its plant bears and does comes from there, along sums of lines too."""
    foresight = made_foresight(3)
    world = World(foresight, foresight.vectors[5], arm=np.array([[0.1, 0.4, 0.0], [0.3, 0.2, 0.0], [-0.5, 0.3, 1.0]]))
    answers = [update_answer(foresight, look(world, direction=line), 1, 0.0) for line in lines_across(2)]
    for direction in lines_across(4):
        one = predict(foresight, float(TONES[1]), sum_answers(answers, lines_across(2) @ direction), 0.0)
        assert one.flowers == pytest.approx(world.flowers(1, direction), rel=0.05)
        for kind, load in world.loads(1, direction).items():
            assert one.loads[kind] == pytest.approx(load, rel=0.05)


@pytest.mark.usefixtures("trusted")
def test_depth_that_is_read_tells_what_cannot_be_seen_across() -> None:
    foresight = made_foresight(3)
    other = foresight.vectors[9].copy()  # no member moves so
    other[..., :FLOWERS, :] += 3 * np.einsum("ka,fx->kafx", other[..., 0, 0], AXES[:FLOWERS, :, 2])
    worlds = [World(foresight, other, depth=depth) for depth in (True, False)]
    deep, flat = (np.log(told(foresight, look(w), 1, 0.0).flowers / w.flowers(1)) for w in worlds)
    assert np.abs(deep).max() < 0.01
    assert np.abs(flat).max() > 0.1


def test_the_points_that_are_watched_lie_far_from_each_other_first_on_the_stem_and_on_no_stalk() -> None:
    """Each is the one farthest from all before it."""
    skeleton, stem, flowers = branched()
    plant = build_plant(skeleton, stem, flowers, None, TOMATO)
    chosen, places = watch_points(plant, most=9), plant.rods.nodes
    assert len(chosen) == len(np.unique(chosen)) == 9
    assert not plant.is_pedicel[chosen].any()
    assert not np.isin(chosen, plant.flower_nodes).any()
    others = np.setdiff1d(np.flatnonzero(~plant.is_pedicel), [*plant.flower_nodes, plant.stem_nodes[0]])
    for n in range(1, 9):
        free = np.intersect1d(others, plant.stem_nodes) if n < 3 else others
        gap = np.linalg.norm(places[free, None] - places[chosen[:n]], axis=2).min(axis=1)
        assert np.linalg.norm(places[chosen[n]] - places[chosen[:n]], axis=1).min() == pytest.approx(gap.max())


def test_what_leaves_the_stem_at_its_foot_is_not_watched() -> None:
    """A second stem from the same foot hangs on a string of its own."""
    skeleton, stem, flowers = branched()
    plant = build_plant(skeleton, stem, flowers, None, TOMATO)
    bases = [node for node in np.unique(plant.rods.parent[1:]) if node in plant.stem_nodes[1:]]
    limb = next(
        j for j in range(1, len(plant.rods.nodes)) if j not in plant.stem_nodes and plant.rods.parent[j] in bases
    )
    parent = plant.rods.parent.copy()
    parent[limb] = plant.stem_nodes[0]
    moved = replace(plant, rods=replace(plant.rods, parent=parent))
    beyond = {limb}
    for j in range(limb + 1, len(parent)):
        beyond |= {j} if parent[j] in beyond else set()
    assert beyond & set(watch_points(plant, most=400).tolist())
    assert not beyond & set(watch_points(moved, most=400).tolist())


def test_points_are_watched_where_the_camera_sees_them() -> None:
    """A camera that sees the upper half is shown nodes of the upper half, and none behind a wall; of few, any are."""
    skeleton, stem, flowers = branched()
    plant = build_plant(skeleton, stem, flowers, None, TOMATO)
    places = plant.rods.nodes
    middle = places.mean(axis=0)
    pose, lens = look_at(middle - [0.5, 0, 0], middle), Intrinsics(200, 200, 200.0, 200.0, 99.5, 199.5)
    chosen = watch_points(plant, most=30, camera=(lens, pose))
    assert len(chosen) > 12
    assert places[chosen, 2].min() > middle[2] - 0.01
    aside, up = np.meshgrid(np.arange(0.004, 0.5, 0.001), np.arange(-0.5, 0.5, 0.001))
    wall = middle + np.column_stack([np.full(aside.size, -0.3), aside.ravel(), up.ravel()])
    seen = watch_points(plant, most=30, camera=(lens, pose), surface=wall)
    assert places[chosen, 1].max() > middle[1] + 0.01 > places[seen, 1].max()
    everything = watch_points(plant, most=30, camera=(lens, look_at(middle - [0.5, 0, 0], middle - [1.0, 0, 0])))
    assert np.array_equal(everything, watch_points(plant, most=30))


def springy(motors: np.ndarray, tones: np.ndarray, deviates: np.ndarray) -> np.ndarray:
    """An arm of three straight joints on springs, whose mode is at 12 Hz as believed."""
    stiffer = deviates.reshape(len(deviates), -1).mean(axis=1)[:, None, None]
    mode = 12.0 * np.exp(0.35 * stiffer)
    return np.asarray(motors[None, :, :3] / (1 - (tones[:, None] / mode) ** 2 + 0.1j))


@pytest.mark.parametrize("deviate", [-1.5, 0.0, 1.0])
def test_what_is_seen_tells_how_stiff_the_joints_are(deviate: float) -> None:
    """And how late the clock is. A plant of which little is known tells less than one that is known."""
    found = []
    for unsure in (0.1, 0.3):
        foresight = made_foresight(3, unsure=unsure)
        at = look(World(foresight, foresight.vectors[5], late=0.02))
        motors = np.asarray(at.commanded[:, None] * ALONG)
        (moved,) = springy(motors, TONES, np.array([deviate])) @ ALONG / at.commanded
        seen = at._replace(swings=at.swings._replace(phasors=at.swings.phasors * moved[:, None]))
        arm = JointBelief(springy)
        fit = arm.log_posterior[:, None] + log_likelihood(
            foresight, seen, springy(motors, TONES, STIFFNESS_DEVIATES), DELAYS
        )
        best, late = np.unravel_index(fit.argmax(), fit.shape)
        assert STIFFNESS_DEVIATES[best] == pytest.approx(deviate, abs=0.3)
        assert DELAYS[late] == pytest.approx(0.02, abs=0.003)
        found.append(np.ptp(arm._replace(log_posterior=fit[:, late]).sample(motors, TONES, 32)[:, 1, 0].real))
    before = np.ptp(JointBelief(springy).sample(motors, TONES, 32)[:, 1, 0].real)
    assert max(found) < before


def test_drawn_joints_are_as_likely_as_is_believed() -> None:
    def deviates(arm: JointBelief) -> np.ndarray:
        told = lambda motors, tones, z: np.asarray(z[:, None] + 0j * motors)  # noqa: E731
        return arm._replace(grip=told).sample(np.zeros((1, 3), complex), TONES[:1], 400)[:, 0].real

    before = deviates(JointBelief(springy))
    assert [before.mean(), before.std()] == pytest.approx([0.0, np.hypot(1.0, 0.4)], abs=0.06)
    sure = deviates(JointBelief(springy, np.where(np.arange(len(STIFFNESS_DEVIATES)) == 4, 0.0, -50.0)))
    assert [sure.mean(), sure.std()] == pytest.approx([STIFFNESS_DEVIATES[4], np.hypot(0.3, 0.4)], abs=0.06)
    assert np.ptp(sure, axis=1).min() > 0, "joints are not all alike"


@pytest.mark.parametrize(("times", "counts"), [(3.0, True), (5.0, False)])
def test_a_flower_that_jumps_from_one_look_to_the_next_is_another(times: float, counts: bool) -> None:
    foresight = made_foresight(3)
    at = look(World(foresight, foresight.vectors[5]))
    once = told(foresight, at, 1, 0.0)
    calm = np.where(np.arange(FLOWERS) == 2, 1 / times, 1.0) * once.detectable
    again = update_answer(foresight, at, 1, 0.0, once._replace(detectable=calm))
    assert np.isfinite(again.flowers[:, 0]).tolist() == [counts or f != 2 for f in range(FLOWERS)]
    lost = once._replace(detectable=np.full(FLOWERS, np.nan))
    assert np.isfinite(update_answer(foresight, at, 1, 0.0, lost).flowers[:, 0]).all(), (
        "of what was not followed nothing is known"
    )
