"""The elastic rod engine: energy and its derivatives, invariances, analytic beams, peer references, bad input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_rods import NO_GRAVITY, cantilever, random_tree

from anther.elastic_rod import (
    Clamp,
    Rods,
    equilibrium,
    least_stiffness,
    natural_frequencies,
    stands,
    with_gravity_equilibrium,
)
from anther.elastic_rod.assembly import assemble, elastic_energy, move_frames, new_blocks
from anther.elastic_rod.model import Frames, build_model
from anther.elastic_rod.response import sparse_matrix
from anther.elastic_rod.tree_solver import constrain, factor, solve
from anther.errors import InputError, StageFailure


def disturbed(rods: Rods, seed: int = 0, size: float = 2e-3):
    """Model, positions and frames of the rods bent and twisted at random."""
    rng = np.random.default_rng(seed)
    model, frames = build_model(rods, NO_GRAVITY)
    x = rods.nodes + size * rng.normal(size=rods.nodes.shape)
    return model, x, moved(model, rods.nodes, frames, x, 0.3 * rng.normal(size=len(x)))


def moved(model, x_old, frames, x, turn) -> Frames:
    new = Frames(np.zeros_like(frames.m1), np.zeros_like(frames.twist))
    move_frames(model, x_old, frames.m1, frames.twist, x, turn, new.m1, new.twist)
    return new


def energy_after(model, x, frames, step) -> float:
    step = step.reshape(-1, 4)
    there = x + step[:, :3]
    new = moved(model, x, frames, there, step[:, 3])
    return elastic_energy(model, there, new.m1, new.twist)


def assembled(model, x, frames):
    blocks = new_blocks(len(x))
    assemble(model, x, frames, np.zeros((len(x), 4)), 0.0, blocks)
    return blocks


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_gradient_is_the_slope_of_the_energy(seed):
    model, x, frames = disturbed(random_tree(seed))
    gradient = assembled(model, x, frames).gradient.ravel()
    h = 1e-7 * np.tile([1, 1, 1, 100], len(x))
    slopes = [
        (energy_after(model, x, frames, h * unit) - energy_after(model, x, frames, -h * unit)) / (2 * h[i])
        for i, unit in enumerate(np.eye(4 * len(x)))
    ]
    np.testing.assert_allclose(gradient[4:], slopes[4:], atol=1e-7 * np.abs(gradient).max())


def test_hessian_is_the_curvature_of_the_energy():
    model, x, frames = disturbed(random_tree(3, n=7))
    hessian = sparse_matrix(model, assembled(model, x, frames)).toarray()
    rng = np.random.default_rng(5)
    scale = np.tile([1e-5, 1e-5, 1e-5, 1e-3], len(x))
    centre = energy_after(model, x, frames, np.zeros(4 * len(x)))
    for _ in range(40):
        step = scale * rng.normal(size=4 * len(x)) * (rng.random(4 * len(x)) < 0.4)
        both = [energy_after(model, x, frames, k * step) for k in (-2, -1, 1, 2)]
        measured = (16 * (both[1] + both[2]) - (both[0] + both[3]) - 30 * centre) / 12
        assert step @ hessian @ step == pytest.approx(measured, rel=2e-6)
    np.testing.assert_array_equal(hessian, hessian.T)


@given(st.integers(0, 10_000), st.integers(5, 30))
@settings(max_examples=20, deadline=None)
def test_tree_elimination_solves_the_assembled_system(seed, n):
    rods = random_tree(seed, n)
    model, frames = build_model(rods, NO_GRAVITY)
    free = Clamp.root(rods).free(rods)
    blocks = assembled(model, rods.nodes, frames)
    constrain(model, free, blocks)
    matrix = sparse_matrix(model, blocks).toarray()
    wanted = np.random.default_rng(seed).normal(size=4 * n)
    right = (matrix @ wanted).reshape(n, 4)
    assert factor(model, blocks) == 0
    solve(model, blocks, right)
    np.testing.assert_allclose(right.ravel(), wanted, atol=1e-6)


@given(st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_a_rigid_rotation_stores_no_energy(seed):
    rods = random_tree(seed % 50)
    model, frames = build_model(rods, NO_GRAVITY)
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    x, now = rods.nodes, frames
    for _ in range(12):  # a large rotation in parts, frames carried along
        turned = x + np.cross(axis, x) * np.sin(0.2) + (1 - np.cos(0.2)) * np.cross(axis, np.cross(axis, x))
        edges = (x - x[rods.parent])[1:]
        edges /= np.linalg.norm(edges, axis=1, keepdims=True)
        turn = np.zeros(len(x))
        along = edges @ axis  # spin that parallel transport leaves out
        turn[1:] = 2 * np.arctan2(along * np.sin(0.1), np.cos(0.1))
        now = moved(model, x, now, turned, turn)
        x = turned
    bent = elastic_energy(*disturbed(rods)[:2], *disturbed(rods)[2])
    assert elastic_energy(model, x, now.m1, now.twist) < 1e-12 * bent


def test_static_cantilever_is_euler_bernoulli():
    rods = cantilever(60, youngs=2e9)
    tip = equilibrium(rods, Clamp.root(rods))[-1]
    free_length = 0.3 - 0.3 / 60 / 2  # a clamped edge holds the slope in its middle
    area, inertia = np.pi * 3e-3**2, np.pi * 3e-3**4 / 4
    assert tip[2] == pytest.approx(-1100 * area * 9.81 * free_length**4 / (8 * 2e9 * inertia), rel=1e-3)


def test_an_l_shaped_rod_bends_and_twists():
    a, b, k = 0.2, 0.1, 60
    nodes = np.zeros((2 * k + 1, 3))
    nodes[: k + 1, 0] = np.linspace(0, a, k + 1)
    nodes[k + 1 :, 0], nodes[k + 1 :, 1] = a, np.linspace(0, b, k + 1)[1:]
    weight = np.zeros(2 * k + 1)
    weight[-1] = 1e-4
    rods = Rods(nodes, np.arange(2 * k + 1) - 1, 3e-3, 2e9, 1e-3, bend_over_twist=12.0, lumped_mass=weight)
    drop = equilibrium(rods, Clamp.root(rods))[-1, 2]
    EI = 2e9 * np.pi * 3e-3**4 / 4
    a -= a / k / 2
    expected = -1e-4 * 9.81 * ((a**3 + b**3) / (3 * EI) + a * b**2 / (EI / 12.0))
    assert drop == pytest.approx(expected, rel=0.01)


def test_a_pin_cannot_hold_a_plant():
    rods = cantilever(10)
    with pytest.raises(StageFailure, match="pin"):
        with_gravity_equilibrium(rods, Clamp([0]))


def test_buckling_is_an_error_not_a_result():
    rods = cantilever(40, axis=2, length=1.2, youngs=2.16e7)  # Greenhill: at most 0.4 m
    hanging = with_gravity_equilibrium(rods, Clamp.root(rods))
    with pytest.raises(StageFailure, match="buckle"):
        natural_frequencies(hanging, Clamp.root(hanging), 1)


def test_least_stiffness_is_greenhills():
    rods = cantilever(60, axis=2, length=0.5 * 120 / 119)
    critical = 1100 * 9.81 * 0.5**3 / (7.8373 * 3e-3**2 / 4)
    factor = least_stiffness(rods, Clamp.root(rods))
    assert factor is not None
    assert factor * 2e8 == pytest.approx(critical, rel=0.02)
    assert not stands(replace(rods, youngs=0.9 * critical), Clamp.root(rods))
    assert least_stiffness(rods, Clamp([0])) is None


@pytest.mark.parametrize(("youngs", "standing"), [(0.97, False), (1.03, True)])
def test_a_column_buckles_at_greenhills_height(youngs, standing):
    length, radius = 0.5, 3e-3
    critical = 1100 * 9.81 * length**3 / (7.8373 * radius**2 / 4)  # E where g rho A L^3 = 7.8373 E I
    rods = cantilever(100, axis=2, length=length * 200 / 199, youngs=youngs * critical)
    if standing:
        assert natural_frequencies(rods, Clamp.root(rods), 1)[0][0] > 0
    else:
        with pytest.raises(StageFailure):
            natural_frequencies(rods, Clamp.root(rods), 1)


@given(
    st.sampled_from(["edge_radius", "youngs", "density", "bend_over_twist", "lumped_mass", "viscous_time"]),
    st.one_of(st.floats(max_value=-1e-9), st.just(np.nan), st.just(np.inf)),
)
def test_impossible_material_is_refused(name, value):
    with pytest.raises(InputError, match=name):
        cantilever(5, **{name: value})


@pytest.mark.parametrize("parent", [[-1, 0, 2], [0, 0, 1], [-1, 0, 5], [-1, -1, 0]])
def test_what_is_not_a_tree_is_refused(parent):
    with pytest.raises(InputError, match="parent"):
        Rods(np.eye(3), parent, 1e-3, 1e8, 1e3)
