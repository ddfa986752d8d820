"""Identification: the authors' number, free vibrations, density, and a material refined from a measured response."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sample_plants import branched, grasps_on

from anther.core.errors import InputError
from anther.plant.bench import density_from_samples, fit_free_vibration
from anther.plant.model import TOMATO, PlantModel, build_plant
from anther.pollination.learning import ObservedShake, Params, Refinement, refine
from anther.pollination.learning._refinement import predict_members
from anther.pollination.shake import Params as ShakeParams
from anther.pollination.shake import ShakePlan, plan_shake
from anther.pollination.shake.observables import branch_of, semi_major
from anther.pollination.shake.pads import PADS, Pads, grip_rows, pad_nodes
from anther.pollination.shake.search import Version, answer, draw_deviates, draw_version, gains
from evaluation.prediction.expectation import amplitude_at


def test_density_of_samples() -> None:
    rng = np.random.default_rng(0)
    radius, length = rng.uniform(2e-3, 5e-3, 40), rng.uniform(0.02, 0.05, 40)
    truth = rng.normal(1050, 30, 40)
    found = density_from_samples(truth * np.pi * radius**2 * length, radius, length)
    assert found.mean == pytest.approx(truth.mean())
    assert found.sd == pytest.approx(truth.std(ddof=1))
    assert found.standard_error == pytest.approx(found.sd / np.sqrt(40))
    assert np.isnan(density_from_samples([1e-3], [3e-3], [0.03]).sd)
    for bad in (([], [], []), ([1e-3], [3e-3, 1e-3], [0.03]), ([1e-3], [-3e-3], [0.03])):
        with pytest.raises(InputError):
            density_from_samples(*bad)


@settings(max_examples=15)
@given(st.floats(0.7, 8.0), st.floats(0.005, 0.15), st.floats(0, 6), st.integers(0, 1000))
def test_free_vibration_is_found_within_its_errors(f: float, z: float, phase: float, seed: int) -> None:
    t = np.arange(0, 6, 0.02)
    rng = np.random.default_rng(seed)
    x = 0.01 * np.exp(-z / np.sqrt(1 - z * z) * 2 * np.pi * f * t) * np.cos(2 * np.pi * f * t + phase) + 0.3
    found = fit_free_vibration(t, x + rng.normal(0, 2e-4, len(t)))
    assert abs(found.frequency - f) < 6 * found.frequency_error
    assert abs(found.damping_ratio - z) < 6 * found.damping_error
    assert found.frequency_error < 0.05 * f
    assert found.damping_error < 0.3 * z + 0.002


def test_standard_errors_are_the_scatter_of_repeated_fits() -> None:
    t = np.arange(0, 5, 0.02)
    rng = np.random.default_rng(3)
    clean = np.exp(-0.05 * 2 * np.pi * 1.4 * t) * np.cos(2 * np.pi * 1.4 * t)
    fits = [fit_free_vibration(t, clean + rng.normal(0, 0.03, len(t))) for _ in range(40)]
    for value, error in (("frequency", "frequency_error"), ("damping_ratio", "damping_error")):
        scatter = np.std([getattr(fit, value) for fit in fits])
        assert np.mean([getattr(fit, error) for fit in fits]) == pytest.approx(scatter, rel=0.4)


def test_no_oscillation_is_refused() -> None:
    t = np.arange(20) * 0.1
    for times, x in ((t, np.ones(20)), (t[:5], t[:5]), (t[::-1], t), (t, np.full(20, np.nan))):
        with pytest.raises(InputError):
            fit_free_vibration(times, x)


FIRM = Pads(stiffness=1e11, turning=1e8, stiffness_spread=0.0, turning_spread=0.0)


@pytest.fixture(scope="module")
def plant() -> PlantModel:
    skeleton, stem, flowers = branched()
    return build_plant(skeleton, stem, flowers, None, replace(TOMATO, youngs=2e8))


@pytest.fixture(scope="module")
def plan(plant: PlantModel) -> ShakePlan:
    skeleton, stem, _ = branched()
    return plan_shake(
        plant,
        grasps_on(skeleton, stem, [8]),
        params=ShakeParams(frequencies=8, lowest=3, highest=5),
    )


def amplitude_of(truth: PlantModel, plant: PlantModel, plan: ShakePlan) -> np.ndarray:
    """What another plant would do in that shake."""
    pads = pad_nodes(plant, grip_rows(plant, plan.grasp.point[None]))
    response = gains(
        [Version(plant), Version(truth)], pads, plan.direction[None, None], np.array([plan.frequency])
    ).flower[:, 0, 0, 0]
    return plan.predicted_amplitude * response[1] / response[0]


def predicted(plant: PlantModel, after: Refinement, plan: ShakePlan) -> np.ndarray:
    """What the members now say of the flowers' amplitudes in a shake."""
    nothing = np.full(len(plan.predicted_amplitude), np.nan)
    said = predict_members(Version(plant, plan.pads), after.members, [ObservedShake(plan, nothing, nothing)])[0]
    return np.exp(np.log(semi_major(said.flowers)).mean(axis=0))


@pytest.mark.parametrize("factor", [0.7, *(pytest.param(f, marks=pytest.mark.slow) for f in (1.0, 1.6))])
def test_a_measured_response_improves_prediction_and_belief(plant: PlantModel, plan: ShakePlan, factor: float) -> None:
    truth = plant.with_material(replace(plant.material, youngs=factor * plant.material.youngs))
    measured = amplitude_of(truth, plant, plan)
    params = Params(members=64, model_error=0.05)
    after = refine(plant, [ObservedShake(plan, measured, np.full(len(measured), 1e-4 * measured.max()))], params)
    before = np.abs(np.log(plan.predicted_amplitude / measured)).mean()
    assert np.abs(np.log(predicted(plant, after, plan) / measured)).mean() < before + 0.05
    assert after.material.youngs_spread < 0.8 * plant.material.youngs_spread
    assert abs(np.log(after.material.youngs / truth.material.youngs)) < 2 * after.material.youngs_spread + 0.05


def test_an_unmeasurable_response_teaches_nothing(plant: PlantModel, plan: ShakePlan) -> None:
    after = refine(plant, [ObservedShake(plan, np.full(3, np.nan), np.full(3, np.nan))])
    assert after.material == plant.material
    assert "no flower" in after.notes[0]


@pytest.mark.parametrize("above_least", [pytest.param(3.0, marks=pytest.mark.slow), 1.2])
def test_a_vague_measurement_leaves_the_belief_as_it_was(
    plant: PlantModel, plan: ShakePlan, above_least: float
) -> None:
    """Also of a plant that barely stands, whose softer draws are stiffened."""
    stands = plant.with_material(replace(plant.material, youngs=above_least * plant.least_youngs))
    vague = [ObservedShake(plan, plan.predicted_amplitude, 10 * plan.predicted_amplitude)]
    after = refine(stands, vague, Params(members=64, model_error=10), pads=FIRM)
    assert after.material.youngs == pytest.approx(stands.material.youngs, rel=0.02)
    assert after.material.youngs_spread == pytest.approx(stands.material.youngs_spread, rel=0.05)


def test_one_flower_mistaken_for_another_does_not_decide_alone(plant: PlantModel, plan: ShakePlan) -> None:
    fair = plan.predicted_amplitude.copy()
    wrong = fair.copy()
    wrong[0] *= 30
    error = 0.05 * fair
    few = Params(members=48)
    one, two = (refine(plant, [ObservedShake(plan, m, error)], few).material.youngs for m in (fair, wrong))
    assert abs(np.log(one / two)) < plant.material.youngs_spread


@pytest.fixture(scope="module")
def known(plant: PlantModel) -> PlantModel:
    """A plant of known material, whose model may be off."""
    spreads = {"youngs_spread": 0.05, "damping_spread": 0.05, "twist_spread": 0.05, "response_spread": 0.6}
    return plant.with_material(replace(plant.material, **spreads))


STIFF_BRANCHES = Params(members=256, branch_spread=0.05, model_error=0.1)
"""With so many members that the draws do not decide."""


@pytest.mark.slow
@pytest.mark.long
def test_what_all_flowers_do_alike_is_the_models_gain(known: PlantModel, plan: ShakePlan) -> None:
    half = amplitude_of(known.with_material(replace(known.material, response_gain=0.5)), known, plan)
    after = refine(known, [ObservedShake(plan, half, 0.02 * half)], STIFF_BRANCHES).material
    assert after.response_gain < 0.8
    assert after.response_spread < 0.8 * known.material.response_spread
    again = refine(known.with_material(after), [ObservedShake(plan, half, 0.02 * half)], STIFF_BRANCHES).material
    assert again.response_spread <= after.response_spread


@pytest.mark.slow
@pytest.mark.long
def test_flowers_that_moved_too_little_to_be_measured_lower_the_gain(known: PlantModel, plan: ShakePlan) -> None:
    nothing = np.full(len(plan.predicted_amplitude), np.nan)
    low = refine(known, [ObservedShake(plan, nothing, nothing, 0.3 * plan.predicted_amplitude)], STIFF_BRANCHES)
    high = refine(known, [ObservedShake(plan, nothing, nothing, 30 * plan.predicted_amplitude)], STIFF_BRANCHES)
    assert low.material.response_gain < 0.8
    assert predicted(known, low, plan).mean() < plan.predicted_amplitude.mean()
    assert high.material.response_gain == pytest.approx(known.material.response_gain, rel=0.1)
    with pytest.raises(InputError):
        ObservedShake(plan, nothing, nothing, 0 * plan.predicted_amplitude)


def swing(truth: PlantModel, plan: ShakePlan, frequency: float) -> tuple[ShakePlan, np.ndarray]:
    """A shake of the plan's grasp and size at another frequency, and the phasors (F, 3) of what a plant does in it."""
    pads = pad_nodes(truth, grip_rows(truth, plan.grasp.point[None]))
    motion = plan.amplitude * answer(Version(truth), pads, plan.direction, np.array([frequency])).flowers[0, 0]
    return replace(plan, frequency=frequency, predicted_amplitude=semi_major(motion)), motion


def test_a_phase_tells_on_which_side_of_a_resonance_the_shake_is(plant: PlantModel, plan: ShakePlan) -> None:
    frequencies = np.linspace(2, 40, 200)
    pads = pad_nodes(plant, grip_rows(plant, plan.grasp.point[None]))
    size = semi_major(answer(Version(plant), pads, plan.direction, frequencies).flowers[:, 0]).mean(axis=1)
    shake, motion = swing(plant, plan, 1.15 * float(frequencies[size.argmax()]))
    expected, error = shake.predicted_amplitude, 0.05 * shake.predicted_amplitude
    along = np.tile(plan.direction, (len(expected), 1))
    phase, std = np.angle(motion @ plan.direction), np.full(len(expected), 0.05)
    params = Params(members=64, branch_spread=0.05, phase_error=0.3)
    alone = refine(plant, [ObservedShake(shake, expected, error)], params)
    timed = refine(plant, [ObservedShake(shake, expected, error, phase=phase, phase_std=std, axis=along)], params)
    assert timed.material.youngs_spread < alone.material.youngs_spread
    assert abs(np.log(timed.material.youngs / plant.material.youngs)) < 2 * timed.material.youngs_spread


def test_a_phase_of_a_whole_turn_more_is_the_same_phase(plant: PlantModel, plan: ShakePlan) -> None:
    size, along = plan.predicted_amplitude, np.tile(plan.direction, (3, 1))
    one, other = (
        refine(
            plant,
            [ObservedShake(plan, size, 0.05 * size, phase=np.full(3, at), phase_std=np.full(3, 0.05), axis=along)],
            Params(members=8),
        ).material.youngs
        for at in (0.4, 0.4 + 2 * np.pi)
    )
    assert one == pytest.approx(other)


def test_two_shakes_teach_more_than_either(plant: PlantModel, plan: ShakePlan) -> None:
    truth = plant.with_material(replace(plant.material, youngs=1.6 * plant.material.youngs))
    seen = []
    for frequency in (3.0, 8.0):
        shake, motion = swing(truth, plan, frequency)
        believed = swing(plant, plan, frequency)[0]
        seen.append(ObservedShake(believed, semi_major(motion), 0.02 * shake.predicted_amplitude))
    params = Params(members=48, branch_spread=0.05, model_error=0.2)
    both, *single = (refine(plant, some, params).material for some in (seen, seen[:1], seen[1:]))
    assert both.youngs_spread < min(one.youngs_spread for one in single)
    assert abs(np.log(both.youngs / truth.material.youngs)) < 2 * both.youngs_spread + 0.05


def test_a_branch_that_is_softer_than_the_others_is_learned_and_no_other_one(
    known: PlantModel, plan: ShakePlan
) -> None:
    branch = branch_of(known)
    own = int(branch[known.flower_nodes].max())
    z = np.zeros(draw_deviates(known, 1).shape[1])
    z[8 + own] = -1.4
    truth = draw_version(known, PADS, z, 0.5)
    assert truth is not None
    seen = list[ObservedShake]()
    for frequency in (3.0, 6.0, 9.0):
        (shake, _), (_, motion) = swing(known, plan, frequency), swing(truth.plant, plan, frequency)
        seen.append(ObservedShake(shake, semi_major(motion), 0.02 * semi_major(motion)))
    after = refine(known, seen, Params(members=64, model_error=0.05, likeness=0.0))
    first = refine(known, [], Params(members=64))

    def softer(versions: Sequence[Version], of: int) -> float:
        node = int(known.branch_bases[of])
        stem = int(known.rods.parent[node])
        ratios = [np.log(v.plant.rods.youngs[node] / v.plant.rods.youngs[stem]) for v in versions]
        return float(np.mean(ratios))

    others = np.setdiff1d(np.arange(len(known.branch_bases)), branch[known.flower_nodes])
    moved = softer(after.members, own) - softer(first.members, own)
    assert -1.2 < moved < -0.35
    assert all(abs(softer(after.members, b) - softer(first.members, b)) < 0.5 * abs(moved) for b in others)


@pytest.mark.slow
@pytest.mark.long
def test_a_late_camera_is_not_taken_for_a_softer_plant(plant: PlantModel, plan: ShakePlan) -> None:
    late, seen = 0.03, list[ObservedShake]()
    along = np.tile(plan.direction, (len(plant.flower_nodes), 1))
    for frequency in (3.0, 8.0):
        shake, motion = swing(plant, plan, frequency)
        phase = np.angle(motion @ plan.direction) - 2 * np.pi * frequency * late
        error = 0.05 * shake.predicted_amplitude
        seen.append(
            ObservedShake(shake, shake.predicted_amplitude, error, phase=phase, phase_std=0 * phase + 0.05, axis=along)
        )
    params = Params(branch_spread=0.05, model_error=0.1, phase_error=0.1)
    earlier = np.array([one.shake.predicted_amplitude for one in seen])

    def missed(clock_error: float) -> float:
        after = refine(plant, seen, params, clock_error=clock_error)
        again = np.array([predicted(plant, after, one.shake) for one in seen])
        return float(np.abs(np.log(again / earlier)).mean())

    knowing, trusting = missed(0.02), missed(0.0)
    assert knowing < 0.1
    assert knowing < 0.7 * trusting


def test_the_members_of_a_belief_predict_other_shakes(plant: PlantModel, plan: ShakePlan) -> None:
    unshaken = refine(plant, [], Params(members=16))
    assert unshaken.material == plant.material
    points, frequencies = plant.rods.nodes[plant.stem_nodes[[6, 8]]], np.array([0.01, 4.0])
    assert amplitude_at(unshaken, points, plan.direction, frequencies).shape == (2, 2, 3)
    sure = dict.fromkeys(("youngs_spread", "damping_spread", "twist_spread", "radius_spread", "response_spread"), 0.0)
    known = replace(plant, material=replace(plant.material, **sure), pedicel_spread=0.0)
    sure_pads = replace(PADS, stiffness_spread=0.0, turning_spread=0.0)
    alike = refine(known, [], Params(members=8, branch_spread=0), pads=sure_pads)
    pads = pad_nodes(plant, grip_rows(plant, points))
    own = semi_major(answer(Version(plant), pads, plan.direction, frequencies).flowers)
    assert np.allclose(amplitude_at(alike, points, plan.direction, frequencies), np.swapaxes(own, 0, 1), rtol=1e-4)


def test_a_gain_does_nothing_where_the_flowers_move_as_the_grip_does(plant: PlantModel, plan: ShakePlan) -> None:
    pads, frequencies = pad_nodes(plant, np.array([8])), np.array([0.01, 4.0])
    half = replace(plant, material=replace(plant.material, response_gain=0.5))
    firm = [Version(p, FIRM) for p in (plant, half)]
    one, other = (answer(version, pads, plan.direction, frequencies).flowers[:, 0] for version in firm)
    assert np.allclose(other - plan.direction, 0.5 * (one - plan.direction), atol=1e-6)
    sizes = [gains([v], pads, plan.direction[None, None], frequencies).flower[0, :, 0, 0] for v in firm]
    assert np.allclose(sizes[1], semi_major(other))
    assert abs(np.log(sizes[1][1] / sizes[0][1])).max() > 3 * abs(np.log(sizes[1][0] / sizes[0][0])).max()


def test_pads_that_turn_carry_a_slowly_shaken_plant_along_as_one_body(plant: PlantModel, plan: ShakePlan) -> None:
    held, slow = pad_nodes(plant, np.array([8])), np.array([0.01, 4.0])
    half = replace(plant, material=replace(plant.material, response_gain=0.5))
    one, other = (answer(Version(p), held, plan.direction, slow).flowers[:, 0] for p in (plant, half))
    assert abs(one[0]).max() > 1.5  # turned by the stem below the grip, which resists
    assert np.allclose(other[0], one[0], rtol=0.03, atol=0.03)  # its own weight bends what is turned
    assert not np.allclose(other[1], one[1], rtol=0.1)


def test_motion_hardly_tells_the_radius_from_the_stiffness(plant: PlantModel, plan: ShakePlan) -> None:
    measured = amplitude_of(plant.with_material(replace(plant.material, youngs=3e8)), plant, plan)
    params = Params(members=64, model_error=0.05)
    after = refine(plant, [ObservedShake(plan, measured, 0.02 * measured)], params).material
    assert after.youngs_spread < 0.8 * plant.material.youngs_spread
    assert after.radius_spread > 0.6 * plant.material.radius_spread
    assert after.radius_scale == pytest.approx(1.0, abs=0.05)


def test_another_radius_at_the_same_stiffness_changes_mass_alone(plant: PlantModel) -> None:
    thick = plant.with_material(plant.material.changed(radius_scale=1.1))
    assert thick.material.scanned_youngs == pytest.approx(plant.material.scanned_youngs)
    stem = plant.stem_nodes[1:]
    ratio = [np.asarray(p.rods.youngs)[stem] * np.asarray(p.rods.edge_radius)[stem] ** 4 for p in (thick, plant)]
    assert ratio[0] == pytest.approx(ratio[1])
    assert np.asarray(thick.rods.edge_radius)[stem] == pytest.approx(1.1 * np.asarray(plant.rods.edge_radius)[stem])
    pedicels = [np.asarray(p.rods.edge_radius)[plant.is_pedicel] for p in (thick, plant)]
    assert np.array_equal(pedicels[0], pedicels[1])


def test_bad_measurements_are_refused(plant: PlantModel, plan: ShakePlan) -> None:
    good = plan.predicted_amplitude
    for measured, error in ((good[:2], good[:2]), (good, 0 * good), (-good, good), (good, np.full(3, np.nan))):
        with pytest.raises(InputError):
            refine(plant, [ObservedShake(plan, measured, error)])
