"""A string that holds a stem up: it pulls in the model, and how hard is as unsure as it is believed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sample_plants import branched, stem_along, straight_stem

from anther.core.errors import StageFailure
from anther.perception.cloud import Cloud, Support
from anther.plant.model import TOMATO, Params, build_plant
from anther.plant.string import TENSION, HeldString, topmost_hold
from anther.pollination.shake.search import draw_deviates, scenarios
from anther.rods import natural_frequencies

HOOK = (0.7, 0.02, 1.4)
HUNG = Params(string=HeldString.of("tomato", HOOK))


def test_a_string_pulls_the_top_of_a_stem_along_it_wherever_the_map_has_its_hook() -> None:
    plant = build_plant(*branched(), params=HUNG)
    (pull,) = plant.rods.support_forces
    assert plant.rods.supports[0].node == plant.stem_nodes[-1]
    np.testing.assert_allclose(pull, [0, 0, TENSION["tomato"].median], atol=1e-9)


def test_a_stem_that_would_fall_hangs_on_its_string() -> None:
    """The string stretches the second, which needs no stiffer tissue than is believed."""
    soft = replace(TOMATO, youngs=1e7)
    with pytest.raises(StageFailure, match="buckles"):
        build_plant(*branched(), material=soft, params=Params(stiffen=False))
    hung = build_plant(*branched(), material=soft, params=replace(HUNG, stiffen=False))
    assert hung.material.youngs == soft.youngs
    assert natural_frequencies(hung.rods, hung.clamp, 1).frequencies[0] > 1


def test_the_tension_is_drawn_as_it_is_believed_and_nothing_else_changes() -> None:
    alone, hung = build_plant(*branched()), build_plant(*branched(), params=HUNG)
    first, with_string = (draw_deviates(plant, 40) for plant in (alone, hung))
    np.testing.assert_array_equal(first[:, :8], with_string[:, :8])
    assert with_string.shape[1] == first.shape[1] + 1
    pulls = [np.linalg.norm(v.plant.rods.support_forces[0]) for v in scenarios(hung, 40)]
    assert pulls[0] == pytest.approx(TENSION["tomato"].median)
    assert np.std(np.log(pulls[1:])) == pytest.approx(TENSION["tomato"].spread, rel=0.3)
    assert TENSION["tomato"].median == pytest.approx(np.median(pulls[1:]), rel=0.08)


def test_the_wiggles_of_a_scan_do_not_bend_what_hangs_straight() -> None:
    skeleton, stem, flowers = branched()
    scanned = np.array(skeleton.nodes)
    scanned[:25, 1] += 0.003 * np.sin(np.arange(25))
    scanned[0, 1] = 0.0
    wavy = replace(skeleton, nodes=scanned)
    hung = build_plant(wavy, stem, flowers, params=HUNG)
    line = hung.rods.nodes[stem.node_ids]
    assert np.linalg.matrix_rank(line - line[0], tol=1e-9) == 1
    assert hung.material.youngs == TOMATO.youngs, "it need not be stiffer"
    limb, foot = hung.rods.nodes[30] - hung.rods.nodes[10], wavy.nodes[30] - wavy.nodes[10]
    np.testing.assert_allclose(limb, foot, atol=1e-12)


def test_a_stem_that_turns_back_near_its_foot_is_straight_in_its_order() -> None:
    """A scan went about a leaf there; its nodes above stay where they are along the stem."""
    skeleton, stem, flowers = branched()
    scanned = np.array(skeleton.nodes)
    scanned[1:4] += [[0.01, 0.0, 0.02], [0.02, 0.0, 0.01], [0.01, 0.0, -0.03]]
    turned = replace(skeleton, nodes=scanned)
    assert np.any(np.diff(scanned[stem.node_ids, 2]) < 0)
    hung = build_plant(turned, stem, flowers, params=HUNG)
    stem_nodes = hung.rods.nodes[stem.node_ids]
    steps = np.diff(stem_nodes[:, 2])
    assert steps.min() > 5e-4
    np.testing.assert_allclose(stem_nodes[[0, -1]], scanned[stem.node_ids[[0, -1]]], atol=1e-9)
    np.testing.assert_allclose(stem_nodes[8:, 2], scanned[stem.node_ids[8:], 2], atol=1e-9)


def line(height: float, aside: float, kind: str = "string") -> Support:
    """A support that runs beside the straight stem from `height` [m] up."""
    axis = np.array([[0.7 + aside, 0.0, height], [0.7 + aside, 0.0, 1.0]])
    return Support(kind, axis, 0.001, axis)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("supports", "height"),
    [
        ((), 0.4),  # none is seen: its top
        ((line(0.0, 0.005),), 0.4),
        ((line(0.0, 0.05),), 0.4),  # another plant's
        ((line(0.0, 0.005, "stake"),), 0.4),  # pulls nothing
        ((replace(line(0.0, 0.005), axis=np.array([[0.705, 0, 0], [0.705, 0, 0.2], [0.8, 0, 0.4]])),), 0.2),
    ],
)
def test_a_string_holds_up_to_where_it_leaves_the_stem(supports: tuple[Support, ...], height: float) -> None:
    skeleton = straight_stem()
    cloud = Cloud(skeleton.nodes, supports=supports)
    held = topmost_hold(skeleton.nodes, skeleton.radius, cloud)
    assert skeleton.nodes[stem_along(skeleton, 24).node_ids[held], 2] == pytest.approx(height, abs=0.03)
