"""What another shake should do: what was measured where it was measured, and what the ensemble says elsewhere."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from sample_plants import branched

from anther.core.geometry import Array
from anther.plant.limits import PEAKS, STALK_SPREAD, stalk_strain
from anther.plant.model import TOMATO, PlantModel, build_plant
from anther.pollination import decision
from anther.pollination.learning import GripMeasurement, ObservedShake, Params, Refinement, refine
from anther.pollination.shake import PADS, Pads, ShakePlan
from anther.pollination.shake.observables import semi_major
from anther.pollination.shake.pads import grip_rows, pad_nodes
from anther.pollination.shake.search import Version, answer, gains
from evaluation.prediction.expectation import FLOWER_SPREAD, expect, flowers_at, loads_at

HELD, WAY, PITCH, SIZE = 8, np.array([0.8, 0.6, 0.0]), 4.0, 2e-3
MEASURED, ERROR = np.array([3e-3, 5e-3, 1e-3]), 0.1
UP, FIRM = np.eye(3)[2], Pads(stiffness=1e9, turning=1e6, stiffness_spread=0.0, turning_spread=0.0)
NINETY = 1.645


@pytest.fixture(scope="module")
def plant() -> PlantModel:
    skeleton, stem, flowers = branched()
    return build_plant(skeleton, stem, flowers, None, replace(TOMATO, youngs=2e8))


@pytest.fixture(scope="module")
def learned(plant: PlantModel) -> Refinement:
    """A belief before any shake: what is measured then counts by itself, not by what it taught."""
    return refine(plant, [], Params(members=16))


@pytest.fixture(scope="module")
def sure(plant: PlantModel) -> Refinement:
    """A belief without doubt, so that only the stated spreads are left."""
    certain = dict.fromkeys(("youngs_spread", "damping_spread", "twist_spread", "radius_spread", "response_spread"), 0)
    known = replace(plant, material=replace(plant.material, **certain), pedicel_spread=0.0)
    return refine(known, [], Params(members=8, branch_spread=0), pads=FIRM)


@pytest.fixture(scope="module")
def point(plant: PlantModel) -> Array:
    return plant.rods.nodes[plant.stem_nodes[HELD]]


def seen(point: Array, amplitude: Any = MEASURED, error: Any = ERROR, **more: Any) -> ObservedShake:
    """A shake of the gripper by `SIZE` in which the flowers moved so far; `error` is relative."""
    facts = {"direction": WAY, "amplitude": SIZE, "frequency": PITCH, "pads": PADS}
    shake = cast(ShakePlan, SimpleNamespace(grasp=SimpleNamespace(point=point), predicted_amplitude=amplitude, **facts))
    return ObservedShake(shake, np.array(amplitude), error * np.array(amplitude), **more)


def median(learned: Refinement, point: Array, way: Array, pitch: float) -> Array:
    return flowers_at(learned, point[None], way, np.array([pitch]))[0, 0, :, 1]


def turned(degrees: float) -> Array:
    """The shake's direction, turned about the vertical."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ WAY


@pytest.mark.parametrize(("raised", "moved"), [(1.0, np.nan), (1.5, np.nan), (1.5, 1.2 * SIZE)])
def test_a_measured_flower_answers_in_proportion_to_how_far_the_gripper_moved(
    learned: Refinement, point: Array, raised: float, moved: float
) -> None:
    told = expect(learned, [seen(point, grip=GripMeasurement(amplitude=moved))], point, WAY, PITCH, raised * SIZE)
    assert told.measured.all()
    assert told.amplitude == pytest.approx(raised * SIZE / np.nan_to_num(moved, nan=SIZE) * MEASURED)


@pytest.mark.parametrize(
    ("up", "way", "pitch"),
    [(0.007, WAY, PITCH), (0, 3 * turned(4.5), PITCH), (0, -WAY, PITCH), (0, WAY, 1.009 * PITCH)],
)
def test_a_shake_at_nearly_the_same_place_way_and_pitch_is_the_same(
    learned: Refinement, point: Array, up: float, way: Array, pitch: float
) -> None:
    told = expect(learned, [seen(point)], point + up * UP, way, pitch, SIZE)
    assert told.measured.all()
    assert told.amplitude == pytest.approx(MEASURED)


@pytest.mark.parametrize(
    ("up", "way", "pitch"),
    [(0.009, WAY, PITCH), (0, turned(5.5), PITCH), (0, WAY, 1.011 * PITCH), (0, WAY, PITCH / 1.011)],
)
def test_of_another_shake_the_ensemble_speaks(
    learned: Refinement, point: Array, up: float, way: Array, pitch: float
) -> None:
    told = expect(learned, [seen(point)], point + up * UP, way, pitch, 1.5 * SIZE)
    assert not told.measured.any()
    assert told.amplitude == pytest.approx(1.5 * SIZE * median(learned, point + up * UP, way, pitch))


def test_faint_lost_and_still_flowers_are_not_measured(learned: Refinement, point: Array) -> None:
    nan = np.nan
    faint = seen(point, [nan, nan, MEASURED[2]], at_most=np.array([1e-4, nan, nan]))
    still = ObservedShake(faint.shake, np.array([0.0, nan, nan]), np.array([1e-5, nan, nan]))
    told, model = expect(learned, [faint, still], point, WAY, PITCH, SIZE), median(learned, point, WAY, PITCH)
    assert told.measured.tolist() == [False, False, True]
    assert told.amplitude == pytest.approx([*SIZE * model[:2], MEASURED[2]])
    assert np.isfinite(told.interval).all()


def test_flowers_of_two_shakes_are_taken_together(learned: Refinement, point: Array) -> None:
    one, other = seen(point, [MEASURED[0], np.nan, np.nan]), seen(point, [np.nan, MEASURED[1], np.nan])
    told = expect(learned, [one, other], point, WAY, PITCH, SIZE)
    assert told.measured.tolist() == [True, True, False]
    assert told.amplitude[:2] == pytest.approx(MEASURED[:2])


def test_intervals_hold_the_middle_and_widen_with_the_measurements_error(learned: Refinement, point: Array) -> None:
    widths = []
    for error in (1e-6, 0.1, 0.3):
        told = expect(learned, [seen(point, error=error)], point, WAY, PITCH, SIZE)
        low, high = told.interval.T
        assert np.all((low < told.amplitude) & (told.amplitude < high))
        widths.append(np.log(high / low).max())
    assert widths[0] < 2 * NINETY * 0.1  # a precise measurement still is no promise of a larger shake
    assert widths[0] > 0.05
    assert widths[2] == pytest.approx(2 * NINETY * np.hypot(0.3, widths[0] / 2 / NINETY))
    assert widths[0] < widths[1] < widths[2] < 2 * NINETY * FLOWER_SPREAD


def test_where_nothing_was_measured_the_interval_has_the_members_spread_and_the_flowers_own(
    plant: PlantModel, learned: Refinement, sure: Refinement, point: Array
) -> None:
    own, doubtful = (expect(belief, [], point, WAY, PITCH, SIZE) for belief in (sure, learned))
    for told in (own, doubtful):
        low, high = told.interval.T
        assert told.amplitude == pytest.approx(np.sqrt(low * high))
    assert np.log(own.interval[:, 1] / own.interval[:, 0]) == pytest.approx(np.full(3, 2 * NINETY * FLOWER_SPREAD))
    assert np.all(np.log(doubtful.interval[:, 1] / doubtful.interval[:, 0]) > 2 * NINETY * FLOWER_SPREAD)
    pads = pad_nodes(plant, grip_rows(plant, point[None]))
    alone = semi_major(answer(Version(plant, FIRM), pads, WAY, np.array([PITCH])).flowers[0, 0])
    assert own.amplitude == pytest.approx(SIZE * alone, rel=1e-4)


def test_expected_loads_are_the_plants_own_and_as_uncertain_as_each_kind_is(
    plant: PlantModel, sure: Refinement, point: Array
) -> None:
    pitches = np.array([2.0, PITCH])
    told = loads_at(sure, point[None], WAY, pitches)
    assert set(told) == {*PEAKS, "grip_force"}
    own = gains([Version(plant, FIRM)], pad_nodes(plant, grip_rows(plant, point[None])), WAY[None, None], pitches)
    loads = own._asdict() | {"joint_strain": own.answer(pitches).flowers.max(axis=-1)}
    for kind, found in told.items():
        logs, spread = decision.believed(kind.replace("joint_strain", "flowers"), loads[kind][..., 0], pitches[:, None])
        pedicels = kind == "joint_strain"
        spread = np.hypot(spread, STALK_SPREAD) if pedicels else spread
        low, middle, high = np.moveaxis(found, -1, 0)
        once = stalk_strain(pitches) if pedicels else 1.0
        assert middle == pytest.approx(once * np.exp(logs[0]).T, rel=1e-4)
        assert np.log(high / low) == pytest.approx(2 * NINETY * spread.T)


def test_slowly_shaken_branches_are_loaded_by_their_inertia_and_the_stem_by_how_far_it_is_bent(
    sure: Refinement, point: Array
) -> None:
    """Firm pads carry what stands above them along without turning it: its strain grows with frequency squared."""
    slow = loads_at(sure, point[None], WAY, np.array([0.05, 0.1]))
    ratio = {kind: slow[kind][0, 1] / slow[kind][0, 0] for kind in ("base_strain", "stem_strain")}
    assert ratio["base_strain"] == pytest.approx(np.full(3, 4.0), rel=0.02)
    slope = decision.ERRORS["stem_strain"][1][0]  # of what is believed on what is modelled, in units of inertia
    assert ratio["stem_strain"] == pytest.approx(np.full(3, 4.0 ** (1 - slope)), rel=0.02)
