"""Supports and tension: springs of any direction, preloads, strings, floors, against closed forms and themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_rods import NO_GRAVITY, cantilever, random_tree

from anther.core.errors import InputError
from anther.rods import (
    Clamp,
    FunctionDrive,
    Loads,
    Rods,
    Support,
    base_response,
    equilibrium,
    frequency_response,
    joints,
    natural_frequencies,
    simulate,
    stands,
    with_gravity_equilibrium,
)
from anther.rods._assembly import assemble, elastic_energy, move_frames, new_blocks, new_lanes
from anther.rods._linear import dense
from anther.rods._model import build_model

L, EI, LINE = 0.3, 2e8 * np.pi * 3e-4**4 / 4, 1100 * np.pi * 3e-4**2
ACROSS, UP = np.array([0, 1, 1]), (0, 0, 1)
RIGID = 1e6


def slender(edges: int, *supports: Support, **changes) -> Rods:
    return cantilever(edges, edge_radius=3e-4, supports=supports, **changes)


def spring(node: int, move: float = 0.0, turn: float = 0.0) -> Support:
    """Stiffness over EI / L^3 and EI / L, across the beam."""
    return Support(node, move * EI / L**3 * ACROSS, turn * EI / L * ACROSS)


def tones(rods: Rods, clamp: Clamp, count: int, gravity=NO_GRAVITY) -> np.ndarray:
    return natural_frequencies(rods, clamp, 2 * count, gravity=gravity).frequencies[::2]


def sag(rods: Rods, clamp: Clamp, node: int, force: float) -> float:
    moved = equilibrium(rods, clamp, gravity=NO_GRAVITY, loads=Loads.at(rods, node, force=(0, 0, force)))
    return float((moved - rods.nodes)[node, 2])


@pytest.mark.parametrize(
    ("supports", "planted", "roots"),
    [
        ([spring(80, RIGID)], False, np.pi * np.arange(1, 4)),
        ([spring(80, RIGID)], True, [3.926602, 7.068583, 10.210176]),  # tan b = tanh b
        ([spring(80, 0, RIGID)], True, [2.365020, 5.497804, 8.639380]),  # tan b = -tanh b
        ([spring(80, RIGID, RIGID)], True, [4.730041, 7.853205, 10.995608]),  # cos b cosh b = 1
        ([spring(80, 5)], True, [2.366778]),  # b^3 (1 + cos cosh) = 5 (cos sinh - sin cosh)
        ([spring(40, RIGID), spring(80, RIGID)], False, [2 * np.pi, 7.853205]),  # two spans: pinned, or half fixed
    ],
)
def test_supported_beams_swing_as_blevins_says(supports, planted, roots):
    rods = slender(80, *supports)
    found = tones(rods, Clamp.root(rods) if planted else Clamp(np.array([0])), len(roots))
    np.testing.assert_allclose(found, np.square(roots) * np.sqrt(EI / LINE) / (2 * np.pi * L**2), rtol=1.5e-3)


@pytest.mark.parametrize("turn", [0.1, 3.0, 100.0, RIGID])
@pytest.mark.parametrize("at", [0.5, 1.0])
def test_a_rotation_spring_of_any_stiffness_is_of_second_order(turn, at):
    flexibility = np.array([[at**3 / 3, at**2 / 2], [at**2 / 2, at]])  # of the node, under force and moment there
    slope = np.array([[0, 0], [0, turn]])
    there = np.linalg.solve(np.eye(2) + flexibility @ slope, flexibility @ [1, 1 - at])
    exact, rest, errors = there[0] + there[1] * (1 - at) + (1 - at) ** 3 / 3, 1e-3 * EI / L**2, []
    for edges in (8, 16):
        rods = slender(edges, spring(round(at * edges), 0, turn))
        errors.append(sag(rods, Clamp.root(rods), edges, rest) / (1e-3 * L) / exact - 1)
    assert abs(errors[1]) < 0.02
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)


def test_a_rotation_spring_holds_the_end_of_a_twisted_stem():
    turn = 2 * EI / L
    rods = slender(80, Support(80, rotation=turn, direction=(1, 0, 0)))
    run = simulate(rods, Clamp.root(rods), None, 1e-3, 1e-3, gravity=NO_GRAVITY,
                   loads=Loads.at(rods, 80, torque=(0.2 * EI / 1.5 / L, 0, 0)))  # fmt: skip
    twisted = np.arccos(run.directors[0, 1] @ run.directors[0, 80])
    assert twisted == pytest.approx(0.2 / (1 + 1.5 * turn * L / EI), rel=0.01)
    assert sag(rods, Clamp.root(rods), 80, 1e-3 * EI / L**2) == pytest.approx(1e-3 * L / 3, rel=1e-3)


@pytest.mark.parametrize("arms", [1, 2])
def test_a_kink_and_a_fork_turn_as_their_node_does(arms):
    errors = []
    for edges in (8, 16):
        stem = np.linspace(0, L, edges + 1)[:, None] * [1, 0, 0]
        arm = np.arange(1, edges + 1)[:, None] / edges * L / 2
        nodes = np.concatenate([stem, *([L, 0, 0] + arm * [0.8, side, 0] for side in (0.6, -0.6)[:arms])])
        parent = np.arange(len(nodes)) - 1
        parent[edges + 1 :: edges] = edges
        rods = Rods(nodes, parent, 3e-4, 2e8, 1100.0, supports=(Support(edges, 1e3, RIGID),))
        load = Loads.at(rods, 2 * edges, force=(0, 0, 1e-4 * EI / L**2))
        moved = (equilibrium(rods, Clamp.root(rods), gravity=NO_GRAVITY, loads=load) - rods.nodes)[2 * edges, 2]
        errors.append(moved / (1e-4 * L / 24) - 1)  # a cantilever of half the length
    assert abs(errors[1]) < 5e-3
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)


@pytest.mark.parametrize("make", [
    lambda k, d: Support(40, k, direction=d),
    lambda k, d: Support(40, k * np.outer(d, d) / (d @ d)),
    lambda k, d: replace(Support(3, k, direction=-3 * d), node=40),
])  # fmt: skip
def test_a_spring_acts_along_its_direction_only(make):
    way, k = np.array([0, 0.6, 0.8]), 40 * EI / L**3
    rods, size = slender(40, make(k, way)), 1e-4 * EI / L**2
    for force, stiffness in ((way, 3 * EI / L**3 + k), (np.array([0, 0.8, -0.6]), 3 * EI / L**3)):
        load = Loads.at(rods, 40, force=size * force)
        moved = (equilibrium(rods, Clamp.root(rods), gravity=NO_GRAVITY, loads=load) - rods.nodes)[40]
        np.testing.assert_allclose(moved, size / stiffness * force, rtol=2e-3, atol=1e-4 * size / stiffness)


def test_force_and_hessian_of_supports_are_those_of_their_energy():
    rng = np.random.default_rng(0)
    tensors = [a @ a.T for a in rng.normal(size=(14, 3, 3))]
    supports = [Support(j, 50 * tensors[j], 0.02 * tensors[7 + j] * (j > 0)) for j in range(7)]
    rods = random_tree(3, n=7)
    low = Support.floor(rods.nodes, 80.0, height=float(np.median(rods.nodes[:, 2])))
    rods = replace(rods, supports=(*supports, *low))
    model, rest = build_model(rods, NO_GRAVITY)

    def moved(x, frames, step):
        new = frames._replace(m1=np.zeros_like(frames.m1), twist=frames.twist.copy())
        move_frames(model, x, frames.m1, x + step[:, :3], step[:, 3], new.m1, new_lanes())
        return x + step[:, :3], new

    x, frames = moved(rods.nodes, rest, rng.normal(size=(7, 4)) * [2e-3, 2e-3, 2e-3, 0.2])
    blocks = new_blocks(7)
    assemble(model, x, x, frames, np.zeros((7, 4)), 0.0, blocks)
    hessian = dense(model, blocks)
    np.testing.assert_allclose(hessian, hessian.T, atol=1e-9 * np.abs(hessian).max())
    for _ in range(6):
        way = rng.normal(size=(7, 4)) * [1e-5, 1e-5, 1e-5, 1e-3]
        way[0, 3] = 0
        energy = [elastic_energy(model, *moved(x, frames, k * way)) for k in (-2, -1, 0, 1, 2)]
        slope = (8 * (energy[3] - energy[1]) - (energy[4] - energy[0])) / 12
        assert np.sum(blocks.gradient * way) == pytest.approx(slope, rel=1e-6)
        bend = (16 * (energy[1] + energy[3]) - (energy[0] + energy[4]) - 30 * energy[2]) / 12
        assert way.ravel() @ hessian @ way.ravel() == pytest.approx(bend, rel=1e-4)


def test_the_scanned_shape_is_at_rest_with_its_supports_which_bear_what_they_state_or_their_share():
    stated = Support(12, 5.0, force=(0.0, 0.01, 0.02))
    rods = replace(random_tree(5, n=14), supports=(Support(9, (0, 0, 1e4)), stated, Support(7, 1.0, 0.5)))
    clamp = Clamp.root(rods)
    held = with_gravity_equilibrium(rods, clamp)
    np.testing.assert_allclose(equilibrium(held, clamp), rods.nodes, atol=1e-9)
    assert stands(rods, clamp)
    np.testing.assert_array_equal(held.support_forces[1], stated.force)
    assert 0 < held.support_forces[0, 2] < rods.node_mass.sum() * 9.81
    heavier = with_gravity_equilibrium(replace(held, density=2 * np.asarray(held.density)), clamp)
    assert heavier.support_forces[0, 2] > held.support_forces[0, 2] > 0
    free = simulate(held, clamp, None, 0.02, 1e-3, start="scanned")
    np.testing.assert_allclose(free.positions[-1], rods.nodes, atol=1e-8)


def test_a_beam_on_a_rigid_prop_shares_its_weight_as_the_textbook_says():
    rods = slender(60, spring(60, RIGID))
    held = with_gravity_equilibrium(rods, Clamp.root(rods))
    assert held.support_forces[0, 2] == pytest.approx(3 / 8 * LINE * L * 9.81, rel=2e-3)  # less what its end node has


def test_a_pull_through_a_support_rings_and_stiffens_as_a_string():
    n, tension = np.array([1, 2, 3]), 30 * EI / L**2
    rods = slender(80, spring(80, RIGID), Support(80, force=(tension, 0, 0)))
    clamp = Clamp(np.array([0]))
    pulled = with_gravity_equilibrium(rods, clamp, NO_GRAVITY)
    exact = n / (2 * L) * np.sqrt(tension / LINE * (1 + n**2 * np.pi**2 * EI / (tension * L**2)))
    np.testing.assert_allclose(tones(pulled, clamp, 3), exact, rtol=1e-3)


def test_a_string_swings_as_a_pendulum_and_stretches_along_itself():
    rods = cantilever(1, axis=2, supports=(Support.string(1, (0, 0, 0.5), 4.0, 200.0),))
    tensor = np.asarray(rods.supports[0].translation)
    np.testing.assert_allclose(tensor, np.diag([8.0, 8.0, 400.0]))
    np.testing.assert_allclose(rods.supports[0].force, [0, 0, 4.0])


def lying(edges: int = 60) -> tuple[Rods, float]:
    weight = 30 * EI / L**3
    rods = slender(edges)
    return replace(rods, supports=Support.floor(rods.nodes, RIGID * EI / L**3)), weight


def test_a_beam_is_lifted_off_the_floor_as_far_as_its_weight_lets_it():
    rods, weight = lying()
    scale, lift = 1e-3, 0.3 * weight * L
    moved = equilibrium(rods, Clamp.root(rods), gravity=(0, 0, -scale * weight / LINE),
                        loads=Loads.at(rods, 60, force=(0, 0, scale * lift)))  # fmt: skip
    assert moved[-1, 2] == pytest.approx(scale * 2 * lift**4 / (3 * weight**3 * EI), rel=2e-3)
    assert np.all(moved[:, 2] > -1e-7)
    open_at = moved[:, 2] > 1e-9
    assert rods.nodes[open_at, 0].min() / L == pytest.approx(0.4, abs=0.04)


def test_a_floor_bears_what_lies_on_it_and_holds_only_what_it_bears():
    rods, weight = lying()
    clamp, gravity = Clamp.root(rods), (0, 0, -weight / LINE)
    rest = with_gravity_equilibrium(rods, clamp, gravity)
    borne = rest.support_forces[:, 2]
    assert borne.min() == 0
    assert borne.sum() == pytest.approx(weight * L, rel=0.02)
    sideways = natural_frequencies(rest, clamp, 2, gravity=gravity).frequencies
    assert sideways[1] / sideways[0] == pytest.approx(6.267, rel=5e-3)  # of a cantilever: nothing moves up or down
    lifted = Loads.at(rest, 60, force=(0, 0, 0.3 * weight * L))
    upward = natural_frequencies(rest, clamp, 2, gravity=gravity, loads=lifted).frequencies
    assert upward[1] < 0.9 * sideways[1]


def test_a_stem_that_falls_on_the_floor_keeps_its_energy_and_stays_above():
    rods = cantilever(8, viscous_time=0.0)
    rods = replace(rods, supports=Support.floor(rods.nodes, 500.0, height=-2e-3))
    run = simulate(rods, Clamp.root(rods), None, 0.2, 5e-4, start="scanned")
    away = run.positions[:, -1, 2]
    assert away.min() < -2e-3
    assert away.min() > -4e-3
    swing = 1100 * np.pi * 9e-6 * L * 9.81 * 2e-3
    assert np.abs(run.energy - run.energy[0]).max() < 0.02 * swing


def test_planning_sees_supports_as_stepping_does():
    rods = replace(cantilever(10, axis=2), viscous_time=4e-3,
                   supports=(Support(10, (30.0, 0, 0), (0, 0.05, 0), force=(0, 0, 0.5)),))  # fmt: skip
    clamp, hertz, size = Clamp.root(rods), 9.0, 1e-5
    rods = with_gravity_equilibrium(rods, clamp)

    def shaken(linear, **how):
        run = simulate(rods, clamp, duration=2.5, dt=1 / hertz / 100, tolerance=1e-11, **how)
        late = slice(-200, None)
        found = 2j * np.mean(np.exp(-2j * np.pi * hertz * run.times[late]) * run.positions[late, -1, 0]) / size
        assert abs(found - linear) < 0.01 * abs(linear)

    def move(t):
        return np.outer((1 - np.exp(-4 * t)) * size * np.sin(2 * np.pi * hertz * t), [1, 0, 0])

    at_grip = frequency_response(rods, clamp, 4, (1, 0, 0), [hertz])[0, -1, 0]
    shaken(at_grip, drive=FunctionDrive(4, move))
    shaken(base_response(rods, clamp, (1, 0, 0), [hertz])[0, -1, 0], drive=None, base=FunctionDrive(0, move))
    bare = replace(rods, supports=(), natural=None)
    assert abs(frequency_response(bare, clamp, 4, (1, 0, 0), [hertz])[0, -1, 0] / at_grip - 1) > 0.1


def test_moments_at_a_held_node_are_those_of_the_stem():
    rods = slender(20, Support(10, rotation=RIGID))
    np.testing.assert_array_equal(joints(rods, True).moments, joints(slender(20), True).moments)


@pytest.mark.parametrize(
    ("wrong", "what"),
    [
        ({"node": 5, "translation": 1.0}, "support node: got 5; allowed: 0 to 4"),
        ({"node": -1, "translation": 1.0}, "support node"),
        ({"node": 0, "rotation": 1.0}, "Clamp.root"),
        ({"node": 1, "translation": -1.0}, "got -1 N/m; allowed: symmetric, 0 to"),
        ({"node": 1, "rotation": -1.0, "direction": UP}, "got -1 N m/rad"),
        ({"node": 1, "translation": 1e12}, "support translation"),
        ({"node": 1, "translation": np.nan}, "NaN"),
        ({"node": 1, "rotation": np.inf}, "infinite"),
        ({"node": 1, "translation": (1.0, 2.0)}, "shape"),
        ({"node": 1, "translation": [[1, 2, 0], [0, 1, 0], [0, 0, 1]]}, "symmetric"),
        ({"node": 1, "translation": (1, 1, 0), "direction": UP}, "one number"),
        ({"node": 1, "translation": 1.0, "direction": (0, 0, 0)}, "support direction.*length above 0"),
        ({"node": 1, "translation": 1.0, "one_sided": True}, "no direction"),
        ({"node": 1, "one_sided": True, "direction": UP}, "no translation stiffness"),
        ({"node": 1, "translation": 1, "one_sided": True, "direction": UP, "force": (0, 0, -1)}, "a push"),
        ({"node": 1, "translation": 1.0, "gap": 0.1}, "one-sided"),
    ],
)
def test_a_support_that_cannot_be_is_refused_in_one_message(wrong, what):
    with pytest.raises(InputError, match=what):
        cantilever(4, supports=(Support(**wrong),))


def test_a_natural_shape_found_with_other_supports_is_refused():
    rods = slender(8, spring(8, 5.0))
    held = with_gravity_equilibrium(rods, Clamp.root(rods))
    with pytest.raises(InputError, match="1 supports; allowed: 9 nodes, 2 supports"):
        replace(held, supports=(spring(8, 5.0), spring(4, 5.0)))
