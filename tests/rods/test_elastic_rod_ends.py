"""The ends of rods: planted in soil, with lumps, forking from the root; many nodes in line; energy that is free."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_rods import NO_GRAVITY, cantilever, random_tree

from anther.core.errors import InputError, StageFailure
from anther.rods import (
    Clamp,
    Rods,
    base_response,
    equilibrium,
    frequency_response,
    natural_frequencies,
    simulate,
    with_gravity_equilibrium,
)
from anther.rods._assembly import assemble, assemble_edges, new_blocks
from anther.rods._equilibrium import by_edges, sum_along
from anther.rods._linear import dense
from anther.rods._model import build_model
from anther.rods._simulation import _refuse_free_energy


def planted_order(frequencies) -> float:
    """Slope of the error of frequencies(edges) against those of the finest of four meshes with edges halved."""
    found = [np.asarray(frequencies(edges)) for edges in (10, 20, 40, 320)]
    errors = [np.abs(f / found[-1] - 1).max() for f in found[:-1]]
    return float(np.log2(errors[0] / errors[-1]) / 2)


def lowest(rods: Rods, count: int) -> np.ndarray:
    return natural_frequencies(rods, Clamp.root(rods), count, gravity=NO_GRAVITY).frequencies


def test_a_planted_stem_bends_from_its_root_on():
    speed = np.sqrt(2e8 * 3e-3**2 / 4 / 1100)
    analytic = 1.87510407**2 * speed / (2 * np.pi * 0.3**2)
    assert lowest(cantilever(20), 2) == pytest.approx(analytic, rel=2e-3)
    assert planted_order(lambda edges: lowest(cantilever(edges), 4)) == pytest.approx(2, abs=0.2)


def test_soil_that_gives_is_the_joint_of_the_first_edge():
    rods = cantilever(30, youngs=2e12, density=1e-3, lumped_mass=1e-3 * (np.arange(31) == 30))
    give = 0.5 * (np.arange(31) == 1)
    drop = equilibrium(replace(rods, joint_compliance=give), Clamp.root(rods))[-1, 2]
    bend = 0.3**3 / (3 * 2e12 * np.pi * 3e-3**4 / 4)
    assert drop == pytest.approx(-1e-3 * 9.81 * (0.5 * 0.3**2 + bend), rel=1e-4)


def test_planted_rods_hang_where_they_were_scanned():
    rods = random_tree(4, 20, lumped_mass=1e-4)
    hanging = with_gravity_equilibrium(rods, Clamp.root(rods))
    np.testing.assert_allclose(equilibrium(hanging, Clamp.root(rods)), rods.nodes, atol=1e-9)
    assert np.abs(equilibrium(rods, Clamp.root(rods)) - rods.nodes).max() > 1e-5


def test_the_soil_needs_the_root():
    with pytest.raises(InputError, match="planted clamp"):
        Clamp([1], planted=True)


def test_a_tip_that_turns_a_lump_converges_with_the_second_order():
    def found(edges: int) -> np.ndarray:
        tip = np.arange(edges + 1) == edges
        return lowest(cantilever(edges, lumped_mass=5e-3 * tip, lumped_inertia=2e-5 * tip), 5)

    assert planted_order(found) == pytest.approx(2, abs=0.25)


def test_a_lump_along_a_rod_converges_with_the_second_order():
    def found(edges: int) -> np.ndarray:
        return lowest(cantilever(edges, lumped_inertia=2e-5 * (np.arange(edges + 1) == edges // 2)), 5)

    assert planted_order(found) == pytest.approx(2, abs=0.25)


def three_arms(edges: int, at_fork: bool) -> np.ndarray:
    """Frequencies of three unlike arms that meet, one held at its end, rooted where they meet or at that end."""
    ways = 0.1 * np.array([[0, 0, -1], [0.6, 0, 0.8], [-0.6, 0.48, 0.64]])
    out = np.arange(1, edges + 1)[:, None] / edges
    first = out * ways[0] if at_fork else ways[0] - out * ways[0]
    nodes = np.concatenate([[0 * ways[0] if at_fork else ways[0]], first, out * ways[1], out * ways[2]])
    parent = np.arange(3 * edges + 1) - 1
    parent[[edges + 1, 2 * edges + 1]] = 0 if at_fork else edges
    radius = np.append(1e-3, np.repeat([1e-3, 1.2e-3, 1e-3], edges))
    held = Clamp([edges - 1, edges] if at_fork else [0, 1])
    return natural_frequencies(Rods(nodes, parent, radius, 1e9, 1000.0), held, 6, gravity=NO_GRAVITY).frequencies


def test_a_fork_at_the_root_converges_with_the_second_order():
    errors = [np.abs(three_arms(n, at_fork=True) / three_arms(n, at_fork=False) - 1).max() for n in (10, 20, 40)]
    assert errors[0] < 0.02
    assert np.log2(errors[0] / errors[2]) / 2 == pytest.approx(2, abs=0.25)


def test_arms_that_fork_from_the_soil_swing_each_alone():
    nodes = np.zeros((61, 3))
    nodes[1:31, 2] = nodes[31:, 0] = 0.3 * np.arange(1, 31) / 30
    rods = Rods(nodes, [-1, *range(30), 0, *range(31, 60)], 3e-3, 2e8, 1100.0)
    np.testing.assert_allclose(lowest(rods, 4), lowest(cantilever(30), 1)[0], rtol=1e-6)


@pytest.mark.parametrize("gravity", [0.0, -9.81])
def test_thousands_of_nodes_in_line_have_their_modes(gravity):
    long, short = cantilever(4000, youngs=2e9), cantilever(200, youngs=2e9)
    found = [natural_frequencies(r, Clamp.root(r), 6, gravity=(0, 0, gravity)).frequencies for r in (long, short)]
    np.testing.assert_allclose(found[0], found[1], rtol=1e-4)


@pytest.mark.parametrize(("radius", "edges"), [(1e-5, 50), (1e-5, 400), (1e-6, 50)])
def test_a_wire_thinner_than_a_hair_has_its_modes(radius, edges):
    wire = cantilever(edges, youngs=2e11, edge_radius=radius)
    first = natural_frequencies(wire, Clamp.root(wire), 1).frequencies[0]
    assert 0.8 < first < 1.4  # it hangs down nearly like a chain: 2.4048 / (4 pi) sqrt(g / L) is 1.09 Hz


@pytest.mark.parametrize("planted", [False, True])
def test_the_stiffness_by_edges_is_that_by_nodes(planted):
    rods, n = random_tree(3, 12), 12
    model, frames = build_model(rods, NO_GRAVITY, planted)
    x = rods.nodes + 1e-3 * np.random.default_rng(0).normal(size=(n, 3))
    by_node, by_edge = new_blocks(n), new_blocks(n)
    assemble(model, x, x, frames, np.zeros((n, 4)), 0.0, by_node)
    assemble_edges(model, x, x, frames, np.zeros((n, 4)), 0.0, by_edge)
    moves = np.eye(4 * n).reshape(-1, n, 4)
    for move in moves:
        sum_along(rods.parent, move, True)
    change = moves.reshape(-1, 4 * n)
    wanted, found = change @ dense(model, by_node) @ change.T, dense(by_edges(model), by_edge)
    np.testing.assert_allclose(found[4:, 4:], wanted[4:, 4:], atol=1e-12 * np.abs(found).max())
    np.testing.assert_allclose((change @ by_node.gradient.ravel())[4:], by_edge.gradient.ravel()[4:], atol=1e-10)


def test_free_motion_without_gravity_is_not_refused_for_its_rounding():
    clamp, rods = Clamp([0, 1]), cantilever(60)
    bent = with_gravity_equilibrium(rods, clamp)
    run = simulate(bent, clamp, None, 4.0, 0.02, gravity=NO_GRAVITY, start="scanned")
    np.testing.assert_allclose(run.energy, run.energy[0], rtol=1e-3)


def test_energy_from_nothing_is_refused():
    rods = cantilever(3)
    model, _ = build_model(rods, NO_GRAVITY)
    still = simulate(rods, Clamp.root(rods), None, 2e-3, 1e-3, gravity=NO_GRAVITY)
    growing = replace(still, energy=np.array([1.0, 1.9, 2.1]))
    _refuse_free_energy(growing, model, 1.2)
    with pytest.raises(StageFailure, match=r"from t = 0\.002 s on the energy grows"):
        _refuse_free_energy(growing, model, 1.0)


@pytest.mark.parametrize("tip_mass", [0.0, 1.5])
def test_a_shaken_base_does_to_a_tip_what_beam_theory_says(tip_mass: float):
    """Euler-Bernoulli with w(0) = 1, w'(0) = 0, no moment at the tip, and there the shear of its mass."""
    length, radius, youngs, density = 0.3, 2e-3, 2e9, 1200.0
    line, hertz = density * np.pi * radius**2, np.array([2.0, 10.0, 30.0])
    expected = []
    for b in (line * (2 * np.pi * hertz) ** 2 / (youngs * np.pi / 4 * radius**4)) ** 0.25 * length:
        c, s, ch, sh, m = np.cos(b), np.sin(b), np.cosh(b), np.sinh(b), tip_mass * b
        ends = [[1, 0, 1, 0], [0, 1, 0, 1], [-c, -s, ch, sh], [s + m * c, m * s - c, sh + m * ch, ch + m * sh]]
        expected.append(np.linalg.solve(ends, [1, 0, 0, 0]) @ [c, s, ch, sh])

    def error(edges: int) -> np.ndarray:
        nodes = np.linspace(0, length, edges + 1)[:, None] * [1, 0, 0]
        lump = tip_mass * line * length * (np.arange(edges + 1) == edges)
        rods = Rods(
            nodes, np.arange(edges + 1) - 1, edge_radius=radius, youngs=youngs, density=density, lumped_mass=lump
        )
        moved = base_response(rods, Clamp.root(rods), (0, 0, 1), hertz, gravity=NO_GRAVITY)[:, -1, 2]
        return np.abs(moved / expected - 1)

    assert error(40).max() < 6e-3
    assert np.log2(error(20).max() / error(40).max()) == pytest.approx(2, abs=0.3)


def test_a_shaken_base_leaves_the_air_where_it_is():
    """A lump on a massless rod in still air: u = k / (k - w^2 m + i w c) of a base that moves by 1."""
    youngs, length, radius, mass, drag, hertz = 2e9, 0.3, 2e-3, 0.02, 0.3, 3.0
    tip, omega = np.arange(41) == 40, 2 * np.pi * hertz
    nodes = np.linspace(0, length, 41)[:, None] * [1, 0, 0]
    rods = Rods(nodes, np.arange(41) - 1, radius, youngs, 1e-3, lumped_mass=mass * tip, node_drag=drag * tip)
    spring = 3 * youngs * np.pi / 4 * radius**4 / length**3
    expected = spring / (spring - omega**2 * mass + 1j * omega * drag)
    moved = base_response(rods, Clamp.root(rods), (0, 0, 1), [hertz], gravity=NO_GRAVITY)[0, -1, 2]
    assert moved == pytest.approx(expected, rel=1e-3)


def test_a_base_that_holds_nothing_is_refused():
    with pytest.raises(InputError, match="clamp"):
        base_response(cantilever(5), Clamp([]), (1, 0, 0), [1.0])


def test_pads_hold_more_than_one_node():
    rods = cantilever(20)
    both = frequency_response(rods, Clamp.root(rods), [9, 10], (1, 0, 0), [5.0])[0]
    np.testing.assert_allclose(both[9], both[10], atol=1e-9)
    one = frequency_response(rods, Clamp.root(rods), 9, (1, 0, 0), [5.0])[0]
    assert np.abs(one[10] - one[9]).max() > 1e-4
