"""Waveforms, dose, actuators, slip and the nonlinear check: each is what physics or the arm makes of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sample_plants import branched, grasps_on, stem_along, straight_stem

from anther.arm import sawyer, shaking
from anther.elastic_rod import Clamp, Rods
from anther.elastic_rod.grip import Springs
from anther.elastic_rod.response import driven_response, frequency_response
from anther.elastic_rod.simulation import simulate
from anther.errors import InputError, StageFailure
from anther.flowers import Flowers
from anther.grasp import Grasp
from anther.plant import TOMATO, PlantModel, build_plant
from anther.pressing import PRESSING, Pressing
from anther.vibration import (
    PADS,
    PRESETS,
    SINE,
    WAVEFORMS,
    ArmShaker,
    Pads,
    Params,
    PlantLimits,
    ShakePlan,
    VibratingGripper,
    Waveform,
    plan_shake,
    with_preset,
)
from anther.vibration.choice import PRESS, _worth, plant_limits
from anther.vibration.limits import sawyer_limit
from anther.vibration.observables import semi_major
from anther.vibration.pads import friction_force, grip_rows, pad_nodes
from anther.vibration.params import FLOWER_SPREAD
from anther.vibration.search import Version, gains, scenarios
from anther.vibration.verification import Shake, shaken, verified
from anther.vibration.waveforms import mix

QUICK = Params(frequencies=12, directions=4, heights=0, draws=3)
SWEEP, BURST = Waveform("sweep", ratio=1.6), Waveform("burst", cycles=8)


@pytest.fixture(scope="module")
def plant() -> PlantModel:
    skeleton, stem, flowers = branched()
    return build_plant(skeleton, stem, flowers, None, TOMATO)


@pytest.fixture(scope="module")
def grasps() -> list[Grasp]:
    skeleton, stem, _ = branched()
    return grasps_on(skeleton, stem, [8, 14])


@given(st.sampled_from(WAVEFORMS), st.floats(1, 30), st.floats(2.5, 5))
def test_a_waveform_begins_and_ends_at_rest_and_its_rate_is_its_derivative(
    waveform: Waveform, frequency: float, duration: float
) -> None:
    t = np.linspace(0, duration, 40001)
    d, rate = waveform.motion(t, 1e-3, frequency, duration)
    assert np.abs(d).max() <= 1e-3 * (1 + 1e-9)
    assert np.abs([d[0], d[-1], rate[0], rate[-1]]).max() < 1e-9
    middle = 0.5 * (t[1:] + t[:-1])
    largest = 2 * np.pi * frequency * waveform.ratio * 1e-3
    seen = np.diff(d) / np.diff(t)
    np.testing.assert_allclose(seen, waveform.motion(middle, 1e-3, frequency, duration)[1], atol=2e-3 * largest)


@given(st.sampled_from(WAVEFORMS), st.integers(0, 39))
def test_the_pieces_of_a_shake_are_all_of_it(waveform: Waveform, q: int) -> None:
    f = np.geomspace(1, 35, 40)
    pieces = mix(waveform, f, q, 3.0)
    if pieces is None:
        assert waveform.kind == "burst" or f[q] * waveform.ratio > 35
        return
    assert pieces.seconds.sum() == pytest.approx(3.0)
    assert pieces.weights.sum(axis=1) == pytest.approx(1.0)
    assert pieces.of(np.ones((40, 2))).max() == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("make", [lambda: Waveform("chirp"), lambda: Waveform("sweep"), lambda: Waveform("burst")])  # type: ignore[arg-type]
def test_impossible_waveforms_are_refused(make: object) -> None:
    with pytest.raises(InputError):
        make()  # type: ignore[operator]


def test_a_sweeps_flowers_do_what_the_time_shares_say(plant: PlantModel) -> None:
    """Within 15 % while it crosses resonances slowly enough, see `mix`; both with the damping of the simulated rods."""
    frequencies, way = np.linspace(6, 9.6, 60), np.array([1.0, 0.2, 0.0]) / np.hypot(1, 0.2)
    node, also = (int(n) for n in plant.stem_nodes[[14, 15]])
    rods = plant.rods_at(6 * np.sqrt(SWEEP.ratio))
    response = driven_response(
        rods, plant.clamp, [[node, also]], way[None], frequencies, observe=plant.flower_nodes
    ).motion[:, 0, 0]
    pieces = mix(SWEEP, frequencies, 0, 6.0)
    assert pieces is not None
    linear = 1e-4 * pieces.of(semi_major(response)).max(axis=0)
    done = shaken(plant, Shake(node, (also,), way, 1e-4, 6.0, 6.0, SWEEP))
    assert done.amplitude == pytest.approx(linear, rel=0.15)


def test_a_sweep_on_springs_does_what_linear_theory_says_of_them(plant: PlantModel) -> None:
    way, held = np.array([1.0, 0.0, 0.0]), tuple(int(n) for n in plant.stem_nodes[[14, 15]])
    shake = Shake(held[0], held[1:], way, 1e-4, 6.0, 4.0, SWEEP)
    rigid, stiff = shaken(plant, shake), shaken(plant, shake, Springs(1e9, 1e6))
    assert stiff.amplitude == pytest.approx(rigid.amplitude, rel=0.01)
    frequencies, soft = np.linspace(6, 9.6, 60), Springs(5e3, 0.1)
    rods = plant.rods_at(6 * np.sqrt(SWEEP.ratio))
    motion = driven_response(
        rods, plant.clamp, [held], way[None], frequencies, observe=plant.flower_nodes, springs=soft
    ).motion[:, 0, 0]
    pieces = mix(SWEEP, frequencies, 0, 4.0)
    assert pieces is not None
    done = shaken(plant, shake, soft)
    assert done.amplitude == pytest.approx(1e-4 * pieces.of(semi_major(motion)).max(axis=0), rel=0.15)
    assert np.abs(np.log(done.amplitude / rigid.amplitude)).max() > 0.2


def test_a_burst_has_the_energy_that_its_spectrum_says(plant: PlantModel) -> None:
    frequencies, way = np.linspace(2, 20, 200), np.array([1.0, 0.0, 0.0])
    node, q = int(plant.stem_nodes[14]), 60
    f = float(frequencies[q])
    rods = plant.rods_at(f)
    response = frequency_response(rods, plant.clamp, node, way, frequencies)[:, plant.flower_nodes]
    pieces = mix(BURST, frequencies, q, 1.0)
    assert pieces is not None
    gain2 = np.tensordot(pieces.weights[0], np.sum(np.abs(response) ** 2, axis=-1), axes=1)
    once = BURST.cycles / f
    shake = Shake(node, (), way, 1e-4, f, once, BURST)
    path = simulate(rods, plant.clamp, shake, once + 1.5, 1e-3, start="scanned", tolerance=1e-9)
    moved = path.positions[:, plant.flower_nodes] - path.positions[0, plant.flower_nodes]
    drive = shake.displacement(path.times)
    assert np.sum(moved**2, axis=(0, 2)) / np.sum(drive**2) == pytest.approx(gain2, rel=0.1)


def test_a_shake_for_all_flowers_ranks_above_one_for_a_few(plant: PlantModel) -> None:
    """One metre moves three of four flowers alike, or half of them tenfold: the first is worth more."""
    response = np.array([[1.0, 1.0, 1.0, 0.0], [10.0, 10.0, 0.0, 0.0]])[None, None, :, None]  # (M, Q, G, D, F)
    pieces, size = mix(SINE, np.array([5.0]), 0, 3.0), np.ones((2, 1))
    assert pieces is not None
    even, uneven = _worth(pieces, response, response, size, Params())[:, 0]
    assert even > uneven
    mean = _worth(pieces, response, response, size, Params(objective="amplitude"))[:, 0]
    assert mean[0] < mean[1]
    assert _worth(pieces, response, response, 2 * size, Params())[0, 0] == pytest.approx(2 * even)


def test_the_grips_force_is_that_of_a_cantilever() -> None:
    skeleton = straight_stem(count=161, radius=(3e-3, 3e-3))
    rods = Rods(skeleton.nodes, skeleton.parent, 3e-3, 1e8, 1000.0)
    node = 120
    force = driven_response(
        rods, Clamp.root(rods), [node], np.eye(3)[:1], [1e-3], observe=[node], gravity=(0, 0, 0)
    ).force[0, 0, 0]
    free = skeleton.nodes[node, 2] - skeleton.nodes[1, 2]
    assert force[0].real == pytest.approx(3 * 1e8 * np.pi * 3e-3**4 / 4 / free**3, rel=0.03)
    assert np.abs(force[1:]).max() < 1e-6 * abs(force[0])


def test_comparing_more_waveforms_never_does_worse_and_each_can_be_planned(
    plant: PlantModel, grasps: list[Grasp], tmp_path: Path
) -> None:
    sine = plan_shake(plant, grasps, params=QUICK)
    every = plan_shake(plant, grasps, params=replace(QUICK, waveforms=WAVEFORMS))
    assert every.score >= sine.score
    for waveform in (Waveform("sweep", ratio=1.5), Waveform("burst", cycles=10)):
        plan = plan_shake(plant, grasps, params=replace(QUICK, waveforms=(waveform,), least_amplitude=1e-5))
        assert plan.waveform == waveform
        assert str(waveform) in plan.reason
        assert plan.score <= every.score or waveform not in WAVEFORMS
        assert max(share for *_, share in plan.limits) <= 1 + 1e-9
        plan.save(tmp_path / "plan.json")
        assert ShakePlan.load(tmp_path / "plan.json").waveform == waveform


@pytest.mark.parametrize("waveform", [SINE, SWEEP, BURST], ids=str)
def test_the_arm_does_the_motion_that_was_planned(waveform: Waveform) -> None:
    way = np.array([0.6, 0.8, 0.0])
    shake = {"amplitude": 1e-3, "frequency": 5.0, "duration": 3.0}
    motion = shaking.shake_trajectory(sawyer.NEUTRAL, way, **shake, waveform=waveform)
    flange = sawyer.forward(motion.positions)
    away = flange[:, :3, 3] - flange[0, :3, 3]
    planned = waveform.motion(motion.times, **shake)[0]
    assert away == pytest.approx(planned[:, None] * way, abs=2e-6)
    assert np.abs(motion.velocities / sawyer.VELOCITY).max() <= 1
    with pytest.raises(StageFailure, match="joint limits"):
        shaking.shake_trajectory(sawyer.NEUTRAL, way, amplitude=1e-2, frequency=20.0, duration=3.0, waveform=waveform)


def test_a_shake_that_the_nonlinear_solver_finds_too_strong_is_made_smaller(plant: PlantModel) -> None:
    node, also = (int(n) for n in plant.stem_nodes[[14, 15]])
    shake = Shake(node, (also,), np.array([1.0, 0, 0]), 2e-3, 6.0, 3.0, SINE)
    limits = plant_limits(Params())
    peaks = shaken(plant, shake).peaks
    tight = {name: 0.5 * peaks[name] if name.startswith("stem") else 1e9 for name in limits}
    smaller, done, notes = verified(plant, shake, tight)
    assert smaller.amplitude == pytest.approx(0.5 * shake.amplitude, rel=0.1)
    assert all(done.peaks[name] <= limit for name, limit in tight.items())
    assert "stem bending strain" in notes[0]
    same, _, quiet = verified(plant, shake, dict.fromkeys(limits, 1e9))
    assert same.amplitude == shake.amplitude
    assert quiet == ()


def test_a_vibrating_gripper_is_asked_the_same_questions(plant: PlantModel, grasps: list[Grasp]) -> None:
    gripper = VibratingGripper()
    f = np.array([5.0, 10.0, 20.0, 40.0, 60.0])
    assert gripper.amplitude(grasps[0], np.array([1.0, 0, 0]), f) == pytest.approx(
        [0, 1.5e-3, 1.5e-3, 50 / (80 * np.pi) ** 2, 0]
    )
    plan = plan_shake(plant, grasps, gripper, QUICK)
    assert 10 <= plan.frequency <= 40
    assert plan.limits[0][0].startswith("vibrating gripper amplitude")
    assert max(share for *_, share in plan.limits) <= 1 + 1e-9
    with pytest.raises(InputError, match="10 to 40 Hz, the band of the vibrating gripper"):
        plan_shake(plant, grasps, gripper, replace(QUICK, lowest=1, highest=5))


def test_a_slippery_grip_is_shaken_less(plant: PlantModel, grasps: list[Grasp]) -> None:
    plan = plan_shake(plant, grasps, params=replace(QUICK, pad_friction=2e-4, least_amplitude=1e-6))
    used = {name: share for name, *_, share in plan.limits}
    assert used[PRESS] == pytest.approx(1.0)
    assert "against slip" in plan.reason
    assert plan.press == pytest.approx(PRESSING.holding)


def test_the_pads_press_as_the_shake_needs_and_it_is_made_smaller_where_they_may_not(
    plant: PlantModel, grasps: list[Grasp]
) -> None:
    params = replace(QUICK, least_press=1e-6, least_amplitude=1e-6)
    free = plan_shake(plant, grasps, params=params)
    assert free.press == pytest.approx({name: value for name, value, *_ in free.limits}[PRESS])
    assert plan_shake(plant, grasps, params=replace(params, least_press=8.0)).press == 8.0
    weak = Pressing(holding=max(free.press / 3, 0.1))
    held = plan_shake(plant, grasps[:1], params=replace(params, lowest=1.5, highest=1.5), pressing=weak)
    again = plan_shake(plant, grasps[:1], params=replace(params, lowest=1.5, highest=1.5))
    assert held.press <= weak.holding < again.press
    assert held.amplitude < again.amplitude


def test_a_thin_stem_is_pressed_less_and_none_beyond_what_it_bears() -> None:
    hard, presses = Pressing(pad_modulus=5e7), []
    for radius in ((4e-3, 2.5e-3), (3e-3, 2e-3)):
        skeleton, stem, flowers = branched(radius=radius)
        plant = build_plant(skeleton, stem, flowers, None, TOMATO)
        plan = plan_shake(plant, grasps_on(skeleton, stem, [8]), params=QUICK, pressing=hard)
        presses.append(plan.press)
        assert hard.stress(plan.press, 2 * skeleton.radius[8]) < hard.stem_stress
    assert presses[1] < presses[0] < QUICK.least_press


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


def strain_of_pedicels(version: Version, plan: ShakePlan) -> float:
    """Return the largest strain of a pedicel when a plant is shaken as planned, by linear theory."""
    held = pad_nodes(version.plant, grip_rows(version.plant, plan.grasp.point[None]))
    response = gains([version], held, plan.direction[None, None], np.array([plan.frequency]))
    return plan.amplitude * float(response.joint_strain.max())


def test_a_smaller_risk_and_tighter_limits_make_a_gentler_shake(plant: PlantModel, grasps: list[Grasp]) -> None:
    strong = ArmShaker(lambda g, d, f: 9 * sawyer_limit(g, d, f))

    def used(params: Params) -> float:
        plan = plan_shake(plant, grasps, strong, replace(params, lowest=6, highest=6, least_amplitude=1e-6))
        return plan.amplitude

    by_risk = [used(replace(QUICK, risk=risk)) for risk in (0.001, 0.02, 0.3)]
    by_preset = [used(replace(QUICK, plant=PRESETS[name])) for name in ("gentle", "default", "bold")]
    assert np.all(np.diff(by_risk) > 0)
    assert np.all(np.diff(by_preset) > 0)


def test_the_papers_shake_is_twelve_millimetres_whatever_the_limits(plant: PlantModel, grasps: list[Grasp]) -> None:
    tight = replace(QUICK, plant=PlantLimits(stem_strain=1e-5, pedicel_strain=1e-5, leaf_load=1e-3), pad_friction=1e-3)
    plan = plan_shake(plant, grasps, params=with_preset("paper", tight))
    assert (plan.amplitude, plan.frequency, plan.press) == pytest.approx((0.012, 1.9, PRESSING.holding))
    assert "No limit of the plant is kept and slip is not prevented" in plan.reason
    shares = {name: share for name, _, _, share in plan.limits}
    for name in (PRESS, *list(plant_limits(tight))[:2]):
        assert shares[name] > 1, "what is passed is told"
    weak = ArmShaker(lambda g, d, f: np.full(len(f), 5e-3))
    held_back = plan_shake(plant, grasps, weak, with_preset("paper", QUICK))
    assert held_back.amplitude == pytest.approx(QUICK.arm_share * 5e-3), "the machine's own limits stay"


def test_few_plants_that_are_not_what_is_believed_pass_a_limit(plant: PlantModel, grasps: list[Grasp]) -> None:
    """Whatever their stiffness: the plan was made for another, and its risk is 2 %."""
    believed, strains = TOMATO.changed(youngs_spread=0.4), []
    for stiffer in np.geomspace(0.6, 4.0, 12):
        stale = plant.with_material(replace(believed, youngs=float(stiffer) * plant.material.youngs))
        strains.append(strain_of_pedicels(Version(plant), plan_shake(stale, grasps, params=QUICK)))
    assert np.mean(np.array(strains) > QUICK.plant.pedicel_strain) <= 1 / 12


def test_of_plants_drawn_with_their_own_branches_few_pass_the_limit(plant: PlantModel, grasps: list[Grasp]) -> None:
    plan = plan_shake(plant, grasps, params=QUICK)
    drawn = scenarios(plant, 60, seed=3, branch_spread=0.5)
    strains = np.array([strain_of_pedicels(one, plan) for one in drawn])
    assert len(drawn) > 50
    assert np.mean(strains > QUICK.plant.pedicel_strain) <= 0.02


def test_what_no_solver_lets_pass_is_refused_with_the_reason(plant: PlantModel, grasps: list[Grasp]) -> None:
    with pytest.raises(StageFailure, match=r"the largest is .* mm at .* Hz\. The limit that binds is leaf-base") as no:
        plan_shake(plant, grasps, params=replace(QUICK, plant=PlantLimits(leaf_load=1e-3)))
    assert no.value.kind == "limits_exceeded"


def test_flowers_that_grow_from_the_stem_itself_are_planned_for() -> None:
    skeleton = straight_stem()
    stem = stem_along(skeleton, 24)
    top = skeleton.nodes[-1] + [0.01, 0, 0.01]
    plant = build_plant(skeleton, stem, Flowers(top[None], np.array([24])), None, TOMATO)
    strong = ArmShaker(lambda g, d, f: 2 * sawyer_limit(g, d, f))
    plan = plan_shake(plant, grasps_on(skeleton, stem, [10]), strong, QUICK)
    assert np.all(plan.predicted_amplitude > 0)


@pytest.mark.parametrize("objective", ["acceleration", "amplitude"])
def test_without_scenarios_the_plant_as_believed_decides(
    plant: PlantModel, grasps: list[Grasp], objective: Literal["acceleration", "amplitude"]
) -> None:
    plan = plan_shake(plant, grasps, params=replace(QUICK, draws=0, objective=objective))
    low, high = plan.predicted_amplitude_interval.T
    only = np.exp(1.645 * FLOWER_SPREAD)  # what one flower differs from its plant
    assert low * only == pytest.approx(plan.predicted_amplitude)
    assert high / only == pytest.approx(plan.predicted_amplitude)
    acceleration, amplitude = plan.predicted_acceleration, plan.predicted_amplitude
    worth = {"acceleration": np.quantile(acceleration, 0.25), "amplitude": amplitude.mean()}[objective]
    assert plan.score == pytest.approx(worth, rel=0.02)
