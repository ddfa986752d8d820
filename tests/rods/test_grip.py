"""A grip that gives: pads on springs hold a piece of the rods as one body."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dense_grip import dense_answer
from made_rods import cantilever, random_tree

from anther.core.errors import InputError
from anther.rods import Clamp, Springs, equilibrium, observed_response
from anther.rods._response import displacements, rigid_motion

HERTZ = np.array([2.0, 11.0, 30.0])
WAYS = np.array([[0.0, 1.0, 0.0], [0.6, 0.0, 0.8]])


@pytest.mark.parametrize("springs", [Springs(5e3, 0.3), Springs(50, 1e-3), Springs(1e9, 1e6)])
def test_the_answer_is_that_of_one_matrix_with_the_springs_in_it(springs: Springs) -> None:
    rods = random_tree(5, n=16, youngs=3e7, lumped_mass=2e-4, viscous_time=3e-3)
    below = int(rods.parent[9])
    pad = [9, below, int(rods.parent[below])]
    still = equilibrium(rods, Clamp.root(rods))
    lever = still[below] - still[9]
    grips, everything = [np.array([12]), np.array(pad)], displacements(np.arange(16), 16)
    found = observed_response(rods, Clamp.root(rods), grips, everything, HERTZ, springs=springs)
    for q, hertz in enumerate(HERTZ):
        expected = dense_answer(rods, pad, springs, float(hertz), WAYS)
        motion, force = np.moveaxis(found.vectors[q, 1] @ WAYS.T, 2, 0), (found.force[q, 1] @ WAYS.T).T
        np.testing.assert_allclose(motion, expected[:, :, :3], atol=1e-6 * np.abs(expected).max())
        given_way = WAYS - expected[:, pad[0], :3]
        np.testing.assert_allclose(force, springs.translation * given_way, rtol=1e-4, atol=1e-6)
        turned = -(found.moment[q, 1] @ WAYS.T).T / springs.rotation
        swung = expected[:, below, :3] - expected[:, 9, :3]
        np.testing.assert_allclose(np.cross(turned, lever), swung, atol=1e-5 * np.abs(expected).max())
        spun = turned @ (-lever / np.linalg.norm(lever))  # the held edge turns about itself with the pads
        np.testing.assert_allclose(spun, expected[:, 9, 3], atol=1e-5 * np.abs(expected).max())


def test_stiff_springs_are_the_rigid_grip_and_those_that_let_it_turn_are_a_pin() -> None:
    rods = cantilever(20, youngs=5e7, viscous_time=3e-3)
    clamp = Clamp.root(rods)

    def held(pad: list[int], springs: Springs) -> Any:
        everything = displacements(np.arange(21), 21)
        found = observed_response(rods, clamp, [np.array(pad)], everything, HERTZ, springs=springs)
        return np.moveaxis(found.vectors[:, 0] @ WAYS.T, 3, 1)

    rigid, stiff = held([10, 11, 9], Springs()), held([10, 11, 9], Springs(1e12, 1e12))
    np.testing.assert_allclose(stiff, rigid, atol=1e-6)
    for node in (9, 10, 11):
        np.testing.assert_allclose(rigid[:, :, node], np.tile(WAYS, (3, 1, 1)), atol=1e-9)
    pin, loose, edge = held([10], Springs()), held([10, 11], Springs(rotation=1e-7)), held([10, 11], Springs())
    np.testing.assert_allclose(loose, pin, atol=1e-3 * np.abs(pin).max())
    assert not np.allclose(edge[0], pin[0], atol=0.2 * np.abs(pin[0]).max())


def test_a_slow_pull_stretches_stem_and_pads_in_series() -> None:
    rods, k = cantilever(40), 30.0
    held = observed_response(
        rods, Clamp.root(rods), [np.array([40, 39])], displacements(np.array([40]), 41), np.array([1e-3]),
        gravity=(0, 0, 0), springs=Springs(k, 1e-9),
    )  # fmt: skip
    stem = 3 * 2e8 * np.pi * 3e-3**4 / 4 / 0.3**3
    assert held.force[0, 0, 2, 2].real == pytest.approx(1 / (1 / stem + 1 / k), rel=0.02)
    assert abs(held.moment[0, 0, :, 2]).max() < 1e-6
    assert held.pads[0, 0, 2, 2].real == pytest.approx(k / (stem + k), rel=0.02)
    assert held.pads[0, 0, 4, 2].real == pytest.approx(-1.5 / 0.3 * k / (stem + k), rel=0.05)  # a cantilever's tip


def test_a_body_that_turns_about_its_first_node_turns_its_edges() -> None:
    rods = cantilever(6)
    body = rigid_motion(rods.parent, rods.nodes, np.array([3, 4]))
    moved = body @ [0, 0, 0, 0.2, 0, 0.1]  # about the rod, and about z
    np.testing.assert_allclose(moved, [0, 0, 0, 0, 0.1 * 0.05, 0, 0.2], atol=1e-12)


def test_springs_without_stiffness_are_refused() -> None:
    for name in ("translation", "rotation"):
        with pytest.raises(InputError, match=name):
            Springs(**{name: 0.0})
