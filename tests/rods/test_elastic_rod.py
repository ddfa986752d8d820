"""The elastic rod engine: energy and its derivatives, invariances, analytic beams, peer references, bad input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_rods import NO_GRAVITY, cantilever, random_tree

from anther.core.errors import InputError, StageFailure
from anther.rods import (
    Clamp,
    Rods,
    equilibrium,
    least_stiffness,
    natural_frequencies,
    stands,
    with_gravity_equilibrium,
)
from anther.rods._assembly import assemble, elastic_energy, move_frames, new_blocks, new_lanes
from anther.rods._linear import dense
from anther.rods._model import Frames, build_model, with_natural
from anther.rods._tree_solver import constrain, factor, solve


def disturbed(rods: Rods, seed: int = 0, size: float = 2e-3):
    """Model, positions and frames of the rods bent and twisted at random."""
    rng = np.random.default_rng(seed)
    model, frames = build_model(rods, NO_GRAVITY)
    x = rods.nodes + size * rng.normal(size=rods.nodes.shape)
    return model, x, moved(model, rods.nodes, frames, x, 0.3 * rng.normal(size=len(x)))


def moved(model, x_old, frames, x, turn) -> Frames:
    new = Frames(np.zeros_like(frames.m1), frames.twist.copy())
    move_frames(model, x_old, frames.m1, x, turn, new.m1, new_lanes())
    return new


def energy_after(model, x, frames, step) -> float:
    step = step.reshape(-1, 4)
    there = x + step[:, :3]
    new = moved(model, x, frames, there, step[:, 3])
    return elastic_energy(model, there, new)


def assembled(model, x, frames):
    blocks = new_blocks(len(x))
    assemble(model, x, x, frames, np.zeros((len(x), 4)), 0.0, blocks)
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
    hessian = dense(model, assembled(model, x, frames))
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
@settings(max_examples=20)
def test_tree_elimination_solves_the_assembled_system(seed, n):
    rods = random_tree(seed, n)
    model, frames = build_model(rods, NO_GRAVITY, planted=True)
    free = Clamp.root(rods).free(rods)
    blocks = assembled(model, rods.nodes, frames)
    constrain(model.near, model.far, free, blocks)
    matrix = dense(model, blocks)
    wanted = np.random.default_rng(seed).normal(size=4 * n)
    right = (matrix @ wanted).reshape(n, 4)
    assert factor(model.order, model.near, model.far, blocks) == 0
    solve(model.order, model.near, model.far, blocks, right)
    np.testing.assert_allclose(right.ravel(), wanted, atol=1e-6)


@given(st.integers(0, 10_000))
@settings(max_examples=15)
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
        turn[1:] = 2 * along * np.tan(0.1)  # turn = 2 tan(angle / 2)
        now = moved(model, x, now, turned, turn)
        x = turned
    assert elastic_energy(model, x, now) < 1e-12 * elastic_energy(*disturbed(rods))


def test_rods_that_cannot_twist_are_the_limit_of_stiff_ones():
    ends = []
    for ratio in (1.0, 0.3, 0.1, 0.0):
        rods = random_tree(6, 14, bend_over_twist=ratio, lumped_mass=2e-3, youngs=1e9)
        ends.append(equilibrium(rods, Clamp.root(rods)))
    gaps = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    assert gaps[0] > 1e-5
    np.testing.assert_allclose(
        np.divide(gaps[:-1], gaps[1:]), [0.99 / 0.29, 0.29 / 0.09], rtol=0.05
    )  # 0 counts as 0.01


def test_a_soft_joint_is_a_hinge_with_a_spring():
    soft, force = 2.0, 1e-3
    tip = np.zeros(41)
    tip[-1] = force / 9.81
    bare = cantilever(40, density=1e-3, lumped_mass=tip, youngs=2e9)
    at_joint = np.zeros(41)
    at_joint[20] = soft
    jointed = replace(bare, joint_compliance=at_joint)
    drops = [equilibrium(rods, Clamp.root(rods))[-1, 2] for rods in (bare, jointed)]
    lever = bare.nodes[-1, 0] - bare.nodes[19, 0]
    assert drops[0] - drops[1] == pytest.approx(force * lever * soft * lever, rel=2e-3)


def test_forks_and_kinks_converge_with_the_second_order():
    tips = []
    for refinement in (1, 2, 4, 32):
        rods = refined_fork(refinement)
        tips.append(equilibrium(rods, Clamp.root(rods))[-1])
    errors = [np.linalg.norm(tip - tips[-1]) for tip in tips[:-1]]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.3)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2, abs=0.3)


@pytest.mark.parametrize("bend_over_twist", [1.5, 12.0])
def test_out_of_plane_bending_at_a_fork_converges_with_the_second_order(bend_over_twist):
    first = 1.87510407**2 * 2e-3 / 2 * np.sqrt(1e8 / 1050) / (2 * np.pi * 0.2**2)
    errors = []
    for arm in (10, 20, 40):
        ways = np.array([[-1, 0, 1], [1, 0, 1]]) / np.sqrt(2)
        nodes = [np.array([0, 0, -0.1]), np.zeros(3)]
        nodes += [0.2 * k / arm * way for way in ways for k in range(1, arm + 1)]
        parent = np.array([-1, 0, 1, *range(2, arm + 1), 1, *range(arm + 2, 2 * arm + 1)])
        rods = Rods(np.array(nodes), parent, 2e-3, 1e8, 1050.0, bend_over_twist=bend_over_twist)
        rods = replace(rods, youngs=np.where(np.arange(len(nodes)) == 1, 1e14, 1e8))
        found = natural_frequencies(rods, Clamp([0, 1]), 4, gravity=NO_GRAVITY).frequencies
        errors.append(np.abs(found / first - 1).max())
    assert errors[0] < 0.01
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.3)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2, abs=0.3)


def refined_fork(refinement: int) -> Rods:
    """A stem that forks at a right angle into two arms, each of which has a kink; the first edge is always alike."""
    corners, joins = np.array([[0, 0, 0], [0, 0, 1], [0, 0, 9], [4, 0, 9], [4, 3, 9], [-4, 0, 9], [-4, 0, 5]]), {}
    nodes, parent = [corners[0], corners[1]], [-1, 0]
    joins = {1: 1}
    for a, b in ((1, 2), (2, 3), (3, 4), (2, 5), (5, 6)):
        at = joins[a]
        for share in np.arange(1, 2 * refinement + 1) / (2 * refinement):
            nodes.append(corners[a] + share * (corners[b] - corners[a]))
            parent.append(at)
            at = len(nodes) - 1
        joins[b] = at
    mass = np.zeros(len(nodes))
    mass[[joins[4], joins[6]]] = 2e-4
    return Rods(0.02 * np.array(nodes), np.array(parent), 2e-3, 3e8, 1e-3, lumped_mass=mass)


def test_no_mode_is_missed_and_inertia_of_lumps_counts():
    rods = cantilever(100)
    modes = natural_frequencies(rods, Clamp.root(rods), 7, gravity=NO_GRAVITY)
    np.testing.assert_allclose(modes.frequencies[:6:2], modes.frequencies[1:6:2], rtol=1e-9)
    everything = natural_frequencies(cantilever(4), Clamp.root(cantilever(4)), 5, gravity=NO_GRAVITY)
    assert np.all(np.diff(everything.frequencies) >= 0)
    mass, inertia, length, EI = 0.05, 2e-5, 0.3, 2e9 * np.pi * 3e-3**4 / 4
    tip = np.zeros(91)
    tip[-1] = 1
    heavy = cantilever(90, youngs=2e9, density=1e-3, lumped_mass=mass * tip, lumped_inertia=inertia * tip)
    found = natural_frequencies(heavy, Clamp.root(heavy), 5, gravity=NO_GRAVITY).frequencies
    stiff = EI / length**3 * np.array([[12, -6 * length], [-6 * length, 4 * length**2]])
    squares = np.sort(np.linalg.eigvals(np.linalg.solve(np.diag([mass, inertia]), stiff)).real)
    assert found[0] == pytest.approx(np.sqrt(squares[0]) / 2 / np.pi, rel=2e-3)
    assert found[2] == pytest.approx(np.sqrt(EI / 1.5 / inertia / length) / 2 / np.pi, rel=0.02)  # twist
    assert found[3] == pytest.approx(np.sqrt(squares[1]) / 2 / np.pi, rel=0.015)


def test_damping_ratios_are_told():
    rods = cantilever(30, viscous_time=2e-3, mass_damping=1.5)
    modes = natural_frequencies(rods, Clamp.root(rods), 4, gravity=NO_GRAVITY)
    omega = 2 * np.pi * modes.frequencies
    np.testing.assert_allclose(modes.damping_ratios, 2e-3 * omega / 2 + 1.5 / (2 * omega), rtol=2e-3)


def test_static_cantilever_is_euler_bernoulli():
    rods = cantilever(60, youngs=2e9)
    tip = equilibrium(rods, Clamp.root(rods))[-1]
    area, inertia = np.pi * 3e-3**2, np.pi * 3e-3**4 / 4
    assert tip[2] == pytest.approx(-1100 * area * 9.81 * 0.3**4 / (8 * 2e9 * inertia), rel=1e-3)


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
    rods = cantilever(60, axis=2, length=0.5)
    critical = 1100 * 9.81 * 0.5**3 / (7.8373 * 3e-3**2 / 4)
    factor = least_stiffness(rods, Clamp.root(rods))
    assert factor is not None
    assert factor * 2e8 == pytest.approx(critical, rel=0.02)
    assert not stands(replace(rods, youngs=0.9 * critical), Clamp.root(rods))
    assert least_stiffness(rods, Clamp([0])) is None
    soft = least_stiffness(replace(rods, youngs=2e4), Clamp.root(rods))  # the least of the search would be none of rods
    assert soft == pytest.approx(critical / 2e4, rel=0.02)
    stiff = least_stiffness(replace(rods, youngs=1e14), Clamp.root(rods), between=(1e-7, 1e4))  # and the most too much
    assert stiff == pytest.approx(critical / 1e14, rel=0.02)


@pytest.mark.parametrize(("youngs", "standing"), [(0.97, False), (1.03, True)])
def test_a_column_buckles_at_greenhills_height(youngs, standing):
    length, radius = 0.5, 3e-3
    critical = 1100 * 9.81 * length**3 / (7.8373 * radius**2 / 4)  # E where g rho A L^3 = 7.8373 E I
    rods = cantilever(100, axis=2, length=length, youngs=youngs * critical)
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


@pytest.mark.parametrize("planted", [False, True])
def test_a_model_that_is_written_into_leaves_the_next_as_it_was(planted):
    """What is built of rods is kept, for the next model of them and of the same with another natural shape."""
    rods = with_gravity_equilibrium(random_tree(3), Clamp.root(random_tree(3)))
    both = rods, with_natural(rods, replace(rods.natural, twist=rods.natural.twist + 0.1))

    def values():
        return [value for each in both for part in build_model(each, NO_GRAVITY, planted) for value in part]

    before = values()
    for value in values():
        value[...] = 7
    for was, now in zip(before, values(), strict=True):
        np.testing.assert_array_equal(was, now)
