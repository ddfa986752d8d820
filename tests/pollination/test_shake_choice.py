"""Dose, actuators and slip: each is what physics or the arm makes of it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from sample_plants import branched, grasps_on, stem_along, straight_stem

from anther.core.errors import InputError, StageFailure
from anther.core.geometry import Array
from anther.perception.flowers import Flowers
from anther.plant.belief import EarlierShake
from anther.plant.limits import DOSE_MEASURES, GUSTS, LOADED, PEAKS, stalk_strain
from anther.plant.model import TOMATO, PlantModel, build_plant
from anther.pollination import decision, shake
from anther.pollination.decision import PRICES, believed, expected, worth
from anther.pollination.escalation._option import limits_of
from anther.pollination.grasp import Grasp
from anther.pollination.shake import (
    PADS,
    VIBRATING_GRIPPER,
    Pads,
    Params,
    any_arm,
    arm_shaker,
    plan_shake,
    sawyer_limit,
    with_preset,
)
from anther.pollination.shake._actuators import Actuator
from anther.pollination.shake.choice import (
    APART,
    DIRECTIONS,
    PRESS,
    Bound,
    Grips,
    Search,
    _directions,
    find_candidates,
    match_earlier,
    predicted_at,
    search,
)
from anther.pollination.shake.pads import friction_force, grip_rows, pad_nodes
from anther.pollination.shake.search import Gains, Version, draw_material, gains, scenarios
from anther.robot.pressing import PRESSING, Pressing
from anther.rods import Clamp, Rods, observed_response
from anther.rods._response import displacements

QUICK, ALL = Params(frequencies=12), Params()
LOADS = (*PEAKS, "grip_force")
ARM = arm_shaker()
NO_ANSWER: Any = None
EXACT = np.zeros((2, 1, 1, 1))
"""What an actuator delivers that does as it is told."""


def any_doubt(hertz: float) -> float:
    """Return the spread of ln of what an arm delivers of which nothing is known."""
    return float(any_arm(NO_ANSWER, np.eye(3)[:1], np.array([hertz]))[1][0, 0])


@pytest.fixture(scope="module")
def plant() -> PlantModel:
    skeleton, stem, flowers = branched()
    return build_plant(skeleton, stem, flowers, None, TOMATO)


@pytest.fixture(scope="module")
def grasps() -> list[Grasp]:
    skeleton, stem, _ = branched()
    return grasps_on(skeleton, stem, [8, 14])


def weighed(
    grasps: list[Grasp],
    flower: Array,
    reach: float,
    params: Params = ALL,
    machine: Actuator = ARM,
    **loads: Array,
) -> tuple[Search, Gains]:
    """Return the search of shakes at 2 Hz that move flowers (M, G, F) so far, and what they do to the plant.

    Loads that are not given are none, see `Gains`.
    """
    shape = (len(flower), 1, flower.shape[1], 1)
    given = {kind: np.full(shape, 1e-9) for kind in LOADS}
    given |= {kind: np.reshape(values, shape) for kind, values in loads.items()}
    response = Gains(flower[:, None, :, None], **given)
    count = flower.shape[1]
    grips = Grips(
        [], np.zeros(count), np.zeros(count, int), np.tile(np.eye(3)[:1], (count, 1, 1)), np.full((count, 1), 10.0)
    )
    machine = replace(machine, amplitude=lambda g, d, f: np.full(len(f), reach))
    found = search(response, grips, (grasps * count)[:count], np.array([2.0]), machine, params)
    return found, response


def test_a_shake_for_all_flowers_ranks_above_one_for_a_few(grasps: list[Grasp]) -> None:
    """One metre moves three of four flowers alike, or one of them a hundredfold: the first is worth more."""
    flower = 6 * np.array([[[1.0, 1.0, 1.0, 0.0], [100.0, 0.0, 0.0, 0.0]]])
    even, uneven = weighed(grasps, flower, 0.02)[0].score[0, :, 0]
    assert even > uneven > 0


def test_every_shake_is_as_large_as_it_is_worth_most(grasps: list[Grasp]) -> None:
    """Neither a larger nor a smaller one is worth more, and its score is what it is worth by the rule of all shakes."""
    rng, reach, count = np.random.default_rng(0), 0.02, 12
    flower = rng.uniform(1, 40, (4, count, 3))
    spread = np.exp(rng.normal(0, 0.3, (4, 1, 1)))
    loads = {
        "stem_strain": spread[..., 0] * rng.uniform(0.2, 3, (1, count)),
        "base_strain": spread[..., 0] * rng.uniform(0.2, 3, (1, count)),
        "leaf_load": spread[..., 0] * rng.uniform(100, 1000, (1, count)),
        "grip_force": spread[..., 0] * rng.uniform(30, 300, (1, count)),
    }
    found, response = weighed(grasps, flower, reach, **loads)
    amplitude, hertz = found.amplitude, np.full((1, 1, 1), 2.0)

    def net(size: Array) -> Array:
        held = Params().held(1.0) * found.grips.press
        delivered = 0.0, any_doubt(2.0)
        return worth(response.answer(found.frequencies), size[None], hertz, held, ALL.price, delivered=delivered).net[0]

    assert np.all(found.score > 0)
    assert net(amplitude) == pytest.approx(found.score)
    assert np.unique(amplitude.round(6)).size > 2, "some are ended by what they cost"
    step = (reach / found.least) ** (1 / 13)  # of 14 amplitudes
    for other in (np.maximum(amplitude / step, found.least), np.minimum(amplitude * step, reach)):
        assert np.all(net(other) <= found.score * (1 + 1e-9))
    finest = np.max([net(np.full_like(amplitude, size)) for size in np.geomspace(found.least, reach, 300)], axis=0)
    assert np.all(finest - found.score < 0.01), "between those that are weighed less than 1 % of the pollen is lost"


def test_a_shake_is_chosen_for_the_measure_of_motion_that_is_believed(
    plant: PlantModel, grasps: list[Grasp], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Velocity asks for slow and far shakes, jerk for fast ones; what a plan is best for is not regretted."""
    plans = {}
    for sure in DOSE_MEASURES:
        certain = {m: (power, float(m == sure)) for m, (power, _) in DOSE_MEASURES.items()}
        monkeypatch.setattr(decision, "DOSE_MEASURES", certain)
        plans[sure] = plan_shake(plant, grasps, params=QUICK)
        regret = dict(plans[sure].regret)
        assert regret[sure] == pytest.approx(0.0, abs=1e-9)
        assert min(regret.values()) >= -1e-9
        assert [f"If {m} alone" in plans[sure].reason for m in regret] == [r > 0.05 for r in regret.values()]
    assert plans["velocity"].frequency < plans["jerk"].frequency
    assert dict(plans["velocity"].regret)["jerk"] > 0


def test_a_shake_that_costs_more_than_it_adds_is_none(grasps: list[Grasp]) -> None:
    """A branch that is bent before its flower feels anything; what the rods say of a pedicel is not weighed."""
    soft, still = np.full((1, 1, 1), 1e3), np.ones((1, 1, 1))
    assert weighed(grasps, still, 0.01, base_strain=soft)[0].score.max() == -1
    assert weighed(grasps, still, 0.01)[0].score.max() > 0
    assert weighed(grasps, still, 0.01, joint_strain=soft)[0].score == pytest.approx(
        weighed(grasps, still, 0.01)[0].score
    )
    heedless = weighed(grasps, still, 0.01, Params(keeps_limits=False), base_strain=soft)[0]
    assert heedless.amplitude == pytest.approx(0.01), "as large as the machine allows where nothing is weighed"


def test_the_bound_of_pedicels_is_that_of_the_flower_that_is_expected_to_feel_most(grasps: list[Grasp]) -> None:
    """Of each member the flower that feels most, whatever the rods say of its pedicel."""
    flower, hertz = np.array([[[1.0, 4.0]], [[9.0, 1.0]]]), 2.0
    found, _ = weighed(grasps, flower, 0.02, joint_strain=np.array([0.7, 0.2]))
    one = found.bounds[PEAKS["joint_strain"]]
    felt = float(expected("flowers", (2 * np.pi * hertz) ** 2 * np.array([4.0, 9.0]), hertz))
    assert one.value.item() == pytest.approx(stalk_strain(hertz) * felt)
    assert one.limit.item() == LOADED["joint_strain"].low


@pytest.mark.parametrize("kind", LOADS)
def test_bounds_count_what_the_actuator_delivers(grasps: list[Grasp], kind: str) -> None:
    """Of the plant and of slip; what the machine manages is in what it is told."""
    exact, twice = (_bounds_of(grasps, mean) for mean in (0.0, np.log(2)))
    name = PRESS if kind == "grip_force" else PEAKS[kind]
    assert twice[name].value == pytest.approx(2 * exact[name].value)
    for machine in list(exact)[:3]:
        assert twice[machine].value == pytest.approx(exact[machine].value)


def _bounds_of(grasps: list[Grasp], mean: float) -> dict[str, Bound]:
    machine = replace(
        arm_shaker(), delivers=lambda _, d, f: (np.full((len(f), len(d)), mean), np.zeros((len(f), len(d))))
    )
    return weighed(grasps, np.ones((2, 1, 1)), 0.01, machine=machine, **dict.fromkeys(LOADS, np.ones((2, 1))))[0].bounds


def test_the_grips_force_is_that_of_a_cantilever() -> None:
    skeleton = straight_stem(count=161, radius=(3e-3, 3e-3))
    rods = Rods(skeleton.nodes, skeleton.parent, 3e-3, 1e8, 1000.0)
    node = 120
    held, seen = np.array([node]), displacements(np.array([node]), len(rods.nodes))
    found = observed_response(rods, Clamp.root(rods), [held], seen, np.array([1e-3]), gravity=(0, 0, 0))
    force = found.force[0, 0, :, 0]
    free = skeleton.nodes[node, 2] - skeleton.nodes[1, 2]
    assert force[0].real == pytest.approx(3 * 1e8 * np.pi * 3e-3**4 / 4 / free**3, rel=0.03)
    assert np.abs(force[1:]).max() < 1e-6 * abs(force[0])


def test_a_vibrating_gripper_is_asked_the_same_questions(plant: PlantModel, grasps: list[Grasp]) -> None:
    gripper = VIBRATING_GRIPPER
    f = np.array([10.0, 20.0, 40.0])
    assert gripper.amplitude(grasps[0], np.array([1.0, 0, 0]), f) == pytest.approx(
        0.97 * np.array([1.5e-3, 1.5e-3, 50 / (80 * np.pi) ** 2])
    )
    plan = plan_shake(plant, grasps, gripper, QUICK)
    assert 10 <= plan.frequency <= 40
    assert plan.limits[0][0].startswith("vibrating gripper amplitude")
    assert max(share for *_, share in plan.limits) <= 1 + 1e-9
    with pytest.raises(InputError, match=r"got 1 to 5 Hz.* 10 to 40 Hz, the band of the vibrating gripper"):
        plan_shake(plant, grasps, gripper, replace(QUICK, lowest=1, highest=5))


def test_a_slippery_grip_is_shaken_less(plant: PlantModel, grasps: list[Grasp]) -> None:
    held, slippery = (
        plan_shake(plant, grasps, params=replace(QUICK, lowest=6, highest=6, pad_friction=f, least_amplitude=1e-6))
        for f in (0.5, 2e-3)
    )
    assert slippery.amplitude < 0.5 * held.amplitude
    assert slippery.score < held.score
    assert slippery.press <= PRESSING.holding


@pytest.mark.parametrize("lean", [0.0, 0.6, -0.6])
def test_lines_cross_the_stem_above_those_of_the_compass(lean: float) -> None:
    nodes = np.outer(np.arange(8), [0.02 * np.sin(lean), 0.0, 0.02 * np.cos(lean)])
    plant = SimpleNamespace(rods=SimpleNamespace(nodes=nodes, parent=np.arange(8) - 1))
    (lines,) = _directions(cast(Any, plant), np.array([4]))
    compass = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    assert np.linalg.norm(lines, axis=1) == pytest.approx(np.ones(DIRECTIONS))
    assert lines @ [np.sin(lean), 0, np.cos(lean)] == pytest.approx(np.zeros(DIRECTIONS), abs=1e-9)
    flat = np.stack([np.cos(compass), np.sin(compass)], axis=1)
    assert np.all(np.sum(lines[:, :2] * flat, axis=1) > 0.5)


def test_along_a_lying_stem_the_line_stays_level() -> None:
    nodes = np.outer(np.arange(8), [0.02, 0.0, 0.001])
    plant = SimpleNamespace(rods=SimpleNamespace(nodes=nodes, parent=np.arange(8) - 1))
    (lines,) = _directions(cast(Any, plant), np.array([4]))
    assert lines[:: DIRECTIONS // 2] == pytest.approx(np.eye(3)[:2], abs=1e-9)


def test_two_pads_hold_and_the_more_the_better_they_grip() -> None:
    assert Params(pad_friction=0.4).held(10.0) == pytest.approx(2 * 0.4 * 10)
    assert limits_of(Params(pad_friction=0.4), 10.0, 5.0)["grip_force"] == pytest.approx(8.0)


def test_the_pads_press_as_hard_as_they_may_and_the_shake_is_smaller_where_that_is_less(
    plant: PlantModel, grasps: list[Grasp]
) -> None:
    params = replace(QUICK, lowest=1.5, highest=1.5, least_amplitude=1e-6)
    weak, hard = Pressing(holding=0.1), PRESSING
    held, free = (plan_shake(plant, grasps[:1], params=params, pressing=one) for one in (weak, hard))
    assert (held.press, free.press) == (weak.holding, hard.holding)
    assert held.amplitude < free.amplitude
    assert held.score < free.score


def test_the_table_of_limits_compares_the_force_that_is_expected_with_that_of_the_pads(
    plant: PlantModel, grasps: list[Grasp]
) -> None:
    """Twice the friction needs half the force, whatever the pads press with."""
    params = replace(QUICK, lowest=6, highest=6, most_amplitude=1e-3)
    plans = [
        plan_shake(plant, grasps[:1], params=replace(params, pad_friction=times * params.pad_friction))
        for times in (1, 2)
    ]
    needed = []
    for plan in plans:
        rows = {name: (value, limit) for name, value, limit, _ in plan.limits}
        value, limit = rows[PRESS]
        assert limit == plan.press == PRESSING.holding
        needed.append(value / plan.amplitude)
    assert needed[0] == pytest.approx(2 * needed[1])
    held = pad_nodes(plant, grip_rows(plant, plans[0].grasp.point[None]))
    modelled = gains(scenarios(plant, shake.DRAWS), held, plans[0].direction[None, None], np.array([6.0])).grip_force
    force = expected("grip_force", modelled.ravel(), 6.0)
    assert needed[0] == pytest.approx(float(force) / params.held(1.0))


def test_a_thin_stem_is_pressed_less_and_none_beyond_what_it_bears() -> None:
    hard, presses = Pressing(pad_modulus=5e7), []
    for radius in ((4e-3, 2.5e-3), (3e-3, 2e-3)):
        skeleton, stem, flowers = branched(radius=radius)
        plant = build_plant(skeleton, stem, flowers, None, TOMATO)
        plan = plan_shake(plant, grasps_on(skeleton, stem, [8]), params=QUICK, pressing=hard)
        presses.append(plan.press)
        assert plan.press == pytest.approx(hard.most(2 * skeleton.radius[8]), rel=0.02)
        assert hard.stress(plan.press, 2 * skeleton.radius[8]) < hard.stem_stress
    assert presses[1] < presses[0] < hard.holding


def test_narrow_pads_must_press_harder_against_what_turns_the_stem(plant: PlantModel) -> None:
    held, way = pad_nodes(plant, np.array([14])), np.array([[[1.0, 0, 0]]])
    wide, narrow = (
        gains([Version(plant, replace(PADS, width=width))], held, way, np.array([2.0, 6.0])) for width in (0.016, 0.008)
    )
    assert np.all(narrow.grip_force > 1.2 * wide.grip_force)


def test_a_grip_bears_the_stiffness_of_a_bare_stem_and_the_moment_of_its_bending() -> None:
    """Slowly, a cantilever that is moved without turning pulls with 12 EI/L^3 and turns with 6 EI/L^2 per metre."""
    skeleton = straight_stem(count=161, radius=(3e-3, 3e-3))
    stem = stem_along(skeleton, 160)
    plant = build_plant(skeleton, stem, Flowers(skeleton.nodes[-1:], np.array([160])), None, TOMATO)
    firm = Pads(stiffness=1e11, turning=1e8, stiffness_spread=0, turning_spread=0)
    held = [np.array([80, 81])]
    answer = gains([Version(plant, firm)], held, np.array([[[1.0, 0, 0]]]), np.array([0.05]))
    rods = plant.rods
    stiff = float(np.asarray(rods.youngs)[80]) * np.pi * 3e-3**4 / 4
    free = float(rods.nodes[80, 2] - rods.nodes[1, 2])
    expected = friction_force(12 * stiff / free**3, 6 * stiff / free**2, 0.0, radius=3e-3, width=firm.width)  # type: ignore[arg-type]
    assert float(answer.grip_force.squeeze()) == pytest.approx(float(expected), rel=0.1)


def test_a_dearer_flower_makes_a_gentler_shake(plant: PlantModel, grasps: list[Grasp]) -> None:
    strong = arm_shaker(lambda g, d, f: 9 * sawyer_limit(g, d, f))
    plans = [
        plan_shake(plant, grasps, strong, with_preset(name, replace(QUICK, lowest=6, highest=6, least_amplitude=3e-4)))
        for name in ("gentle", "default", "bold")
    ]
    assert [with_preset(name).price for name in PRICES] == list(PRICES.values())
    assert plans[0].amplitude < plans[1].amplitude < plans[2].amplitude


def test_the_papers_shake_is_twelve_millimetres_whatever_the_limits(plant: PlantModel, grasps: list[Grasp]) -> None:
    costly = replace(QUICK, price=1e3, pad_friction=1e-3)
    plan = plan_shake(plant, grasps, params=with_preset("paper", costly))
    assert (plan.amplitude, plan.frequency, plan.press) == pytest.approx((0.012, 1.9, PRESSING.holding))
    assert "No limit of the plant is kept and slip is not prevented" in plan.reason
    shares = {name: share for name, _, _, share in plan.limits}
    assert shares[PRESS] > 1, "what is passed is told"
    weak = arm_shaker(lambda g, d, f: np.full(len(f), 5e-3))
    held_back = plan_shake(plant, grasps, weak, with_preset("paper", QUICK))
    assert held_back.amplitude == pytest.approx(5e-3), "the machine's own limits stay"


@pytest.mark.parametrize("most", [1, 3, 9])
def test_tones_are_those_that_are_worth_most_each_apart_from_the_others(most: int) -> None:
    hertz = np.array([1.0, *np.geomspace(2.0, 20, 40)])
    felt = np.exp(-(np.log(hertz / 9) ** 2))  # most at 9 Hz
    size = 1e-3 * np.linspace(0.2, 4, len(hertz))
    amplitude = np.tile(size[:, None, None], (1, 1, 2))
    own = SimpleNamespace(value=1e-2, limit=np.ones((len(hertz), 1, 2)))
    score = np.tile(felt[:, None, None], (1, 1, 2)) * [0.5, 1.0]  # of two lines the better one counts
    found = SimpleNamespace(frequencies=hertz, bounds={"arm": own}, amplitude=amplitude, least=1e-4, score=score)
    found.grips, first = SimpleNamespace(directions=np.eye(3)[None, :2]), 30
    given = cast(Any, (found, (first, 0, 1)))
    tones = find_candidates(*given, most, None)
    assert tones.frequencies[0] == hertz[first], "the plan's own comes first"
    assert len(tones.frequencies) <= most
    assert np.all(np.abs(np.diff(np.log(np.sort(tones.frequencies)))) >= np.log(APART) - 1e-9)
    assert tones.frequencies.min() >= 2.0
    if most > 1:
        apart = np.abs(np.log(hertz / hertz[first])) >= np.log(APART)
        assert tones.frequencies[1] == hertz[int(np.argmax(np.where(apart, felt, 0)))]
    assert tones.directions == pytest.approx(np.eye(3)[[1, 0]]), "and the plan's line"


@pytest.mark.parametrize("tightest", ["motor", "grip amplitude", "grip speed"])
def test_a_tone_reaches_as_far_as_the_machine_allows_in_every_way_and_the_plant_has_no_part(tightest: str) -> None:
    hertz = np.array([3.0, 9.0])
    machine = {name: Bound(*np.ones((2, 2, 1, 1))) for name in ("motor", "grip amplitude", "grip speed")}
    assert len(machine) == 3
    machine[tightest] = Bound(100 * hertz[:, None, None], np.ones((1, 1)))
    plant = {"stem strain": Bound(np.full((2, 1, 1), 1e9), np.ones((1, 1)))}
    grips = Grips([], np.zeros(1), np.zeros(1, dtype=int), np.array([[[1.0, 0, 0]]]), np.ones((1, 1)))
    found = Search(
        grips,
        np.ones((4, 2, 1, 1, 3)),
        NO_ANSWER,
        hertz,
        np.full((2, 1, 1), 1e-3),
        np.ones((2, 1, 1)),
        {},
        {**machine, **plant},
        EXACT,
        1e-4,
    )
    tones = find_candidates(found, (0, 0, 0), 2, None)
    assert tones.reach[:, 0] == pytest.approx(0.01 / tones.frequencies)


def test_an_earlier_shake_is_done_again_only_where_the_same_pads_would_hold() -> None:
    """Up to 20 mm along the stem (docs/escalation.md), nowhere else, and with no other frequency."""
    arc, hertz = np.array([0.15, 0.179, 0.181, 0.2, 0.219, 0.221, 0.3]), np.array([5.0, 9.0])
    grips = Grips([], arc, np.arange(7), np.tile(np.eye(3)[:2], (7, 1, 1)), np.ones((7, 1)))
    shape = (2, 7, 2)
    found = Search(
        grips, np.ones((1, *shape, 1)), NO_ANSWER, hertz, np.ones(shape), np.ones(shape), {}, {}, EXACT, 1e-4
    )
    again = match_earlier(found, EarlierShake(0.2, np.array([0, -1.0, 0]), 9.1, 1e-3))
    assert again is not None
    assert np.argwhere(again.score >= 0).tolist() == [[1, g, 1] for g in (2, 3, 4)]
    for height, frequency in ((0.25, 9.1), (0.2, 7.0)):
        assert match_earlier(found, EarlierShake(height, np.array([0, -1.0, 0]), frequency, 1e-3)) is None


@pytest.mark.parametrize("hertz", [2.0, GUSTS, 9.0])
def test_the_table_of_limits_says_what_is_expected_beside_what_nineteen_of_twenty_bear(
    plant: PlantModel, grasps: list[Grasp], hertz: float
) -> None:
    """Of leaves' load only up to the pace of gusts."""
    plan = plan_shake(plant, grasps, params=replace(QUICK, lowest=hertz, highest=hertz, least_amplitude=1e-6))
    rows = {name: (value, limit) for name, value, limit, _ in plan.limits}
    kept = [kind for kind in PEAKS if kind != "leaf_load" or hertz <= GUSTS]
    assert {kind for kind in PEAKS if PEAKS[kind] in rows} == set(kept)
    held = pad_nodes(plant, grip_rows(plant, plan.grasp.point[None]))
    modelled = gains(scenarios(plant, shake.DRAWS), held, plan.direction[None, None], np.array([plan.frequency]))
    felt = (2 * np.pi * plan.frequency) ** 2 * modelled.flower.max(axis=-1)
    loads = modelled._asdict() | {"joint_strain": felt}
    for kind in kept:
        value, limit = rows[PEAKS[kind]]
        assert limit == LOADED[kind].low < LOADED[kind].median
        middle = expected(kind.replace("joint_strain", "flowers"), loads[kind].ravel(), plan.frequency)
        middle *= stalk_strain(plan.frequency) if kind == "joint_strain" else 1.0
        reached = plan.amplitude * float(middle)
        assert value == pytest.approx(reached, rel=1e-3)


def test_what_is_worth_nothing_is_refused_with_the_reason(plant: PlantModel, grasps: list[Grasp]) -> None:
    with pytest.raises(StageFailure, match=r"is worth its cost .* the nearest is .* mm at .* Hz\. The closest") as no:
        plan_shake(plant, grasps, params=replace(QUICK, price=1e4, least_amplitude=8e-3, lowest=2, highest=3))
    assert no.value.kind == "limits_exceeded"


@pytest.mark.parametrize(
    ("deviate", "name", "spread"),
    [(0, "youngs", "youngs_spread"), (1, "damping_ratio", "damping_spread"), (2, "bend_over_twist", "twist_spread"),
     (4, "radius_scale", "radius_spread"), (5, "response_gain", "response_spread")],
)  # fmt: skip
def test_what_is_drawn_a_deviation_higher_is_larger_by_its_spread(deviate: int, name: str, spread: str) -> None:
    higher, believed = draw_material(TOMATO, np.eye(6)[deviate], 1e3), draw_material(TOMATO, np.zeros(6), 1e3)
    assert getattr(higher, name) == pytest.approx(getattr(believed, name) * np.exp(getattr(TOMATO, spread)))
    assert getattr(TOMATO, spread) > 0


def test_flowers_that_grow_from_the_stem_itself_are_planned_for() -> None:
    skeleton = straight_stem()
    stem = stem_along(skeleton, 24)
    top = skeleton.nodes[-1] + [0.01, 0, 0.01]
    plant = build_plant(skeleton, stem, Flowers(top[None], np.array([24])), None, TOMATO)
    strong = arm_shaker(lambda g, d, f: 2 * sawyer_limit(g, d, f))
    plan = plan_shake(plant, grasps_on(skeleton, stem, [10]), strong, QUICK)
    assert np.all(plan.predicted_amplitude > 0)


def test_without_scenarios_the_interval_is_of_what_model_and_actuator_are_off(
    plant: PlantModel, grasps: list[Grasp], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shake, "DRAWS", 0)
    plan = plan_shake(plant, grasps, params=QUICK)
    _, doubt = believed("flowers", np.ones(1), plan.frequency)
    only = np.exp(1.645 * np.hypot(doubt, any_doubt(plan.frequency)))
    low, high = plan.predicted_amplitude_interval.T
    assert low * only == pytest.approx(plan.predicted_amplitude)
    assert high / only == pytest.approx(plan.predicted_amplitude)


def test_what_is_predicted_of_flowers_is_the_median_that_is_expected() -> None:
    """Of members, their error, and what the actuator delivers."""
    hertz, size, gain = 5.0, np.full((1, 1, 1), 4e-3), np.array([[0.5, 0.75], [0.9, 0.2], [2.0, 0.75]])
    delivered = np.full((1, 1, 1), 0.3), np.full((1, 1, 1), 0.4)
    nothing: Any = None
    found = Search(
        nothing, gain[:, None, None, None], NO_ANSWER, np.array([hertz]), size, size, {}, {}, delivered, 1e-4
    )
    middle, spread = predicted_at(found, (0, 0, 0))
    omega2 = (2 * np.pi * hertz) ** 2
    logs, doubt = believed("flowers", omega2 * gain, hertz)
    assert middle == pytest.approx(size.item() * np.exp(logs.mean(axis=0) + 0.3) / omega2)
    wide = np.sqrt(logs.var(axis=0) + doubt**2 + 0.4**2)
    assert np.log(spread) == pytest.approx(1.645 * wide[:, None] * [-1, 1])
