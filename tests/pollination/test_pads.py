"""The gripper's pads: which nodes they hold, and that shakes tell how far they give."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from dense_grip import dense_answer
from sample_plants import branched

from anther.core.errors import InputError
from anther.plant.model import TOMATO, PlantModel, build_plant
from anther.pollination.learning import GripMeasurement, ObservedShake, Params, Refinement, refine
from anther.pollination.response import StemMotion
from anther.pollination.shake import PADS, Pads, ShakePlan
from anther.pollination.shake.observables import semi_major
from anther.pollination.shake.pads import grip_rows, pad_nodes
from anther.rods import Springs
from evaluation.prediction.expectation import amplitude_at

WAY, HELD, OTHER, SIZE = np.array([0.8, 0.6, 0.0]), 10, 16, 2e-3
FIRM = Pads(stiffness=1e9, turning=1e6, stiffness_spread=0.0, turning_spread=0.0)
QUICK = Params(members=96, branch_spread=0.05, model_error=0.1, phase_error=0.15, grip_error=0.1)


@pytest.fixture(scope="module")
def plant() -> PlantModel:
    skeleton, stem, flowers = branched()
    sure = dict.fromkeys(("damping_spread", "twist_spread", "radius_spread", "response_spread"), 0.03)
    material = replace(TOMATO, youngs=2e8, youngs_spread=0.3, **sure)
    return build_plant(skeleton, stem, flowers, None, material)


def dense_motion(plant: PlantModel, row: int, pads: Pads, frequency: float) -> Any:
    """Return (N, 3) what the plant truly does per metre of the gripper."""
    pad = [int(n) for n in pad_nodes(plant, np.array([row]))[0]]
    loss = 2 * plant.material.damping_ratio
    return dense_answer(plant.rods, pad, Springs(pads.stiffness, pads.turning), frequency, WAY[None], loss)[0, :, :3]


def seen(plant: PlantModel, truth: Pads, frequency: float, believed: Pads, *, beside: bool = False) -> ObservedShake:
    """Return what a good camera would see of a shake of truly soft pads."""
    point = plant.rods.nodes[plant.stem_nodes[HELD]]
    motion = SIZE * dense_motion(plant, HELD, truth, frequency)
    flowers = motion[plant.flower_nodes]
    facts = {"direction": WAY, "amplitude": SIZE, "frequency": frequency, "pads": believed}
    shake = cast(ShakePlan, SimpleNamespace(grasp=SimpleNamespace(point=point), **facts))
    size, ways = semi_major(flowers), np.tile(WAY, (len(flowers), 1))
    told: dict = {"phase": np.angle(flowers @ WAY), "phase_std": np.full(len(size), 0.05), "axis": ways}
    if beside:
        near = plant.stem_nodes[[HELD - 2, HELD + 2, HELD + 3]]
        places = plant.rods.nodes[near]
        told["stem"] = StemMotion(places, np.tile(WAY, (3, 1)), motion[near] @ WAY, np.full(3, 5e-5))
    return ObservedShake(shake, size, 0.03 * size, **told)


def miss(plant: PlantModel, truth: Pads, belief: Refinement, frequencies: list[float]) -> float:
    """Return the mean error of ln amplitude at another grip."""
    points = plant.rods.nodes[plant.stem_nodes[[OTHER]]]
    told = amplitude_at(belief, points, WAY, np.array(frequencies))[0]
    true = [semi_major(dense_motion(plant, OTHER, truth, f)[plant.flower_nodes]) for f in frequencies]
    return float(np.abs(np.log(told / true)).mean())


@pytest.mark.slow
def test_shakes_of_soft_pads_teach_how_they_turn_and_better_predictions(plant: PlantModel) -> None:
    """Truth from dense matrices. A fit that takes the pads to be firm puts their give into the plant."""
    truth, probes = replace(PADS, turning=0.15), (3.0, 6.0, 10.0)
    soft, firm = (refine(plant, [seen(plant, truth, f, p) for f in probes], QUICK, pads=p) for p in (PADS, FIRM))
    assert 1 / 1.6 < soft.pads.turning / truth.turning < 1.6
    assert soft.pads.turning_spread < 0.7 * PADS.turning_spread
    frequencies = [2.0, 4.0, 8.0, 12.0]
    assert miss(plant, truth, soft, frequencies) < 0.5 * miss(plant, truth, firm, frequencies)
    assert abs(np.log(soft.material.youngs / plant.material.youngs)) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(("source", "turning_within"), [("stem", 1.6), ("force", 2.0)])
def test_the_grips_force_or_the_stem_beside_it_tell_both_stiffnesses(
    plant: PlantModel, source: str, turning_within: float
) -> None:
    """Of turning, which the prior has half of, the force tells little: the prior moves to the right side."""
    believed, truth = Pads(stiffness=300, turning=0.05), Pads(stiffness=120, turning=0.1)
    plant, sharp = (
        replace(plant, material=replace(plant.material, youngs_spread=0.05)),
        replace(QUICK, members=256, grip_error=0.05),
    )
    blind, told = list[ObservedShake](), list[ObservedShake]()
    for f in (1.0, 4.0, 9.0):
        whole = seen(plant, truth, f, believed, beside=source == "stem")
        nothing = np.full(3, np.nan)
        only = ObservedShake(whole.shake, nothing, nothing, stem=whole.stem)
        if source == "force":
            held = plant.stem_nodes[HELD]
            force = SIZE * truth.stiffness * (WAY - dense_motion(plant, HELD, truth, f)[held])
            square = force @ force
            felt = GripMeasurement(SIZE, 0.0, float(abs(square) ** 0.5), 0.01, float(np.angle(square) / 2))
            only = replace(only, grip=felt)
        told.append(only)
        blind.append(ObservedShake(whole.shake, nothing, nothing))
    found = refine(plant, told, sharp, pads=believed).pads
    assert refine(plant, blind, sharp, pads=believed).pads == believed
    assert 1 / 1.5 < found.stiffness / truth.stiffness < 1.5
    assert found.stiffness_spread < 0.7 * believed.stiffness_spread
    assert 1 / turning_within < found.turning / truth.turning < turning_within
    assert found.turning_spread < believed.turning_spread


def test_pads_hold_all_nodes_between_them_and_at_least_an_edge(plant: PlantModel) -> None:
    rows, step = np.array([8, 2, len(plant.stem_nodes) - 1]), plant.arc_length[1]
    wide, narrow = pad_nodes(plant, rows, 4.1 * step), pad_nodes(plant, rows, 0.5 * step)
    assert [plant.stem_nodes[r] for r in rows] == [w[0] for w in wide]
    assert [sorted(np.flatnonzero(np.isin(plant.stem_nodes, w))) for w in wide] == [
        [6, 7, 8, 9, 10], [1, 2, 3, 4], [22, 23, 24],
    ]  # fmt: skip
    assert [len(n) for n in narrow] == [2, 2, 2]
    assert grip_rows(plant, plant.rods.nodes[plant.stem_nodes[[8, 0]]]).tolist() == [8, 1]


def test_drawn_pads_have_the_spreads_that_are_believed() -> None:
    pads = Pads(stiffness_spread=0.5, turning_spread=1.0)
    drawn = pads.drawn((1.0, -1.0))
    assert np.log(drawn.stiffness / pads.stiffness) == pytest.approx(0.5)
    assert np.log(drawn.turning / pads.turning) == pytest.approx(-1.0)
    with pytest.raises(InputError, match="pads' turning"):
        Pads(turning=0.0)
