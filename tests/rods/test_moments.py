"""Strain from the rods' own moments: nothing for a rigid motion, statics at kinks, forks and zigzags, one measure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from sample_plants import branched
from scipy.spatial.transform import Rotation

from anther.core.geometry import Array
from anther.plant.model import TOMATO, PlantModel, build_plant
from anther.pollination.shake.observables import observables
from anther.pollination.shake.pads import Pads
from anther.pollination.shake.search import Version, gains
from anther.rods import Clamp, Drive, Rods, joints, simulate, strain_changes, with_gravity_equilibrium
from anther.rods._equilibrium import static_state
from anther.rods._linear import dense, linearise
from anther.rods._model import build_model
from evaluation.prediction.steady import steadily_shaken

WEIGHTLESS = (0.0, 0.0, 0.0)
FIRM = Pads(stiffness=1e9, turning=1e6, stiffness_spread=0, turning_spread=0)


def kinked_tree(kind: str) -> Rods:
    """A rod of 0.4 m: zigzag, a helix (which twists as it bends), one sharp kink, or forked twice off the plane."""
    t = np.linspace(0, 1, 21)
    line = np.stack([0 * t, 0 * t, 0.4 * t], axis=1)
    if kind == "zigzag":
        line[:, 0] += 0.006 * (-1.0) ** np.arange(21)
    if kind == "helix":
        line[:, :2] += 0.03 * np.stack([np.cos(9 * t), np.sin(9 * t)], axis=1)
    if kind == "kink":
        line[11:] = line[10] + np.outer(np.arange(1, 11), [0.0141, 0.0, 0.0141])
    parent = np.arange(-1, 20)
    if kind == "fork":
        side = line[8] + np.outer(np.arange(1, 7), [0.012, 0.01, 0.006])
        other = side[2] + np.outer(np.arange(1, 4), [-0.004, 0.013, 0.0])
        line = np.concatenate([line, side, other])
        parent = np.concatenate([parent, [8, *range(21, 26)], [23, 27, 28]])
    radius = 3e-3 - 1e-3 * np.linalg.norm(line - line[0], axis=1) / 0.5
    return Rods(line, parent, radius, 1e8, 900.0, bend_over_twist=4.0)


def outboard(rods: Rods, edge: int) -> NDArray[np.bool_]:
    """(N,) which nodes an edge carries."""
    carried = np.arange(len(rods.nodes)) == edge
    for j in range(edge + 1, len(carried)):
        carried[j] = carried[rods.parent[j]]
    return carried


def moved_by(rods: Rods, forces: Array) -> Array:
    """Return (N, 4) the small displacements and spins under forces (N, 3) [N], without weight."""
    system = linearise(rods, Clamp.root(rods), WEIGHTLESS)
    loads = np.where(system.free, np.pad(forces, ((0, 0), (0, 1))), 0)
    return np.linalg.solve(dense(system.model, system.stiffness), loads.ravel()).reshape(-1, 4)


def levers_moment(rods: Rods, forces: Array, edge: int) -> Array:
    """Return the moment that an edge's joint must bear by statics alone."""
    carried = outboard(rods, edge)
    return np.cross(rods.nodes[carried] - rods.nodes[rods.parent[edge]], forces[carried]).sum(axis=0)


@pytest.mark.parametrize("kind", ["zigzag", "helix", "kink", "fork"])
def test_every_joint_bears_what_statics_says(kind: str) -> None:
    rods = kinked_tree(kind)
    forces = np.random.default_rng(4).normal(size=rods.nodes.shape)
    found = joints(rods)
    strains = (found.strains @ moved_by(rods, forces).ravel()).reshape(-1, 3)
    moments = np.einsum("nij,nj->ni", found.moments, strains)
    for j in np.flatnonzero(rods.parent > 0):
        expected = levers_moment(rods, forces, int(j))
        np.testing.assert_allclose(moments[j], expected, atol=1e-7 * (1 + np.linalg.norm(expected)))


@pytest.mark.parametrize("kind", ["zigzag", "helix", "kink", "fork"])
def test_a_rigid_motion_strains_nothing(kind: str) -> None:
    rods = kinked_tree(kind)
    turn = np.array([0.3, -0.5, 0.8])
    along = rods.nodes - rods.nodes[rods.parent]
    along[0] = [0, 0, 1]
    along /= np.linalg.norm(along, axis=1)[:, None]
    small = np.concatenate([np.cross(turn, rods.nodes) + 1.0, (along @ turn)[:, None]], axis=1)
    assert np.abs(joints(rods).strains @ small.ravel()).max() < 1e-12
    R = Rotation.from_rotvec(2 * turn).as_matrix()
    m1 = build_model(rods, WEIGHTLESS)[1].m1
    assert np.abs(strain_changes(rods, (rods.nodes @ R.T + 1.0)[None], (m1 @ R.T)[None])).max() < 1e-12


@pytest.fixture(scope="module")
def zigzag() -> PlantModel:
    """A plant whose stem zigzags by 20 degrees at each node, with kinked pedicels on trusses."""
    skeleton, stem, flowers = branched()
    nodes = skeleton.nodes.copy()
    nodes[stem.node_ids[1::2], 1] += 3e-3
    flowers = replace(flowers, positions=flowers.positions + np.array([0.0, 0.01, -0.004]))
    return build_plant(replace(skeleton, nodes=nodes), stem, flowers, None, TOMATO)


def test_a_plants_strains_are_moment_over_section_modulus_of_the_edge(zigzag: PlantModel) -> None:
    rods = replace(zigzag.rods, natural=None)
    forces = 1e-3 * np.random.default_rng(1).normal(size=rods.nodes.shape)
    seen = observables(zigzag)
    vectors = (seen.operator @ moved_by(rods, forces).ravel()).reshape(-1, 3)[seen.strains]
    edge = rods.nodes - rods.nodes[rods.parent]
    section = np.asarray(rods.youngs) * np.pi * np.asarray(rods.edge_radius) ** 3 / 4
    starts, at_end = set(), set()
    for vector, j in zip(vectors, seen.edges, strict=True):
        t = edge[j] / np.linalg.norm(edge[j])
        after = np.flatnonzero(rods.parent == j)
        ends = [sum(levers_moment(rods, forces, int(k)) for k in after)] if len(after) else []
        strains = [(m - (m @ t) * t) / section[j] for m in (levers_moment(rods, forces, int(j)), *ends)]
        assert any(np.allclose(vector, s, rtol=1e-5, atol=1e-9) for s in strains)
        (starts if np.allclose(vector, strains[0], rtol=1e-5, atol=1e-9) else at_end).add(int(j))
    stem = zigzag.stem_nodes[zigzag.stem_nodes > 0]
    limited = {*stem, *np.flatnonzero(zigzag.is_pedicel), *zigzag.branch_bases}
    assert starts == limited
    assert at_end >= set(rods.parent[zigzag.branch_bases].tolist())  # below a fork the stem bears more than above it


def test_a_rigid_motion_of_a_plant_strains_no_kink(zigzag: PlantModel) -> None:
    rods, seen = zigzag.rods, observables(zigzag)
    above_soil = seen.strains[rods.parent[seen.edges] > 0]
    along = rods.nodes - rods.nodes[rods.parent]
    along[0] = [0, 0, 1]
    along /= np.linalg.norm(along, axis=1)[:, None]
    for turn in np.eye(3):
        moved = np.concatenate([np.cross(turn, rods.nodes - rods.nodes[0]), (along @ turn)[:, None]], axis=1)
        vectors = (seen.operator @ moved.ravel()).reshape(-1, 3)
        assert np.abs(vectors[above_soil]).max() < 1e-9
        assert np.abs(vectors[seen.flowers]).max() > 0.05


def test_the_bend_of_a_heavy_deflection_is_that_of_the_deflected_levers() -> None:
    """A rod that its tip's weight bends by 40 degrees, sideways to start with."""
    n = 61
    nodes = np.stack([np.linspace(0, 0.3, n), np.zeros(n), np.zeros(n)], axis=1)
    mass = np.zeros(n)
    mass[-1] = 0.012
    rods = Rods(nodes, np.arange(-1, n - 1), 2e-3, 1.5e8, 1e-3, lumped_mass=mass)
    model, frames = build_model(rods, (0, 0, -9.81), planted=True)
    state = static_state(model, frames, rods.nodes, Clamp.root(rods).free(rods))
    assert state.x[-1, 2] < -0.12
    strains = strain_changes(rods, state.x[None], state.frames.m1[None], planted=True)[0]
    moments = np.linalg.norm(np.einsum("nij,nj->ni", joints(rods, planted=True).moments, strains), axis=1)[1:]
    assert moments == pytest.approx(0.012 * 9.81 * (state.x[-1, 0] - state.x[:-1, 0]), rel=2e-3)


def test_the_check_and_the_plan_measure_alike(zigzag: PlantModel) -> None:
    node, also = (int(n) for n in zigzag.stem_nodes[[12, 13]])
    way, f, size = np.array([1.0, 0.0, 0.0]), 6.0, 1e-5
    linear = gains([Version(zigzag, FIRM)], [np.array([node, also])], way[None, None], np.array([f]))
    peaks = steadily_shaken(zigzag, Drive(node, way, size, f, 0, (also,))).peaks
    for name, expected in (
        ("stem bending strain [-]", linear.stem_strain),
        ("pedicel bending strain [-]", linear.joint_strain),
        ("branch-base strain [-]", linear.base_strain),
    ):
        assert peaks[name] == pytest.approx(size * float(expected.max()), rel=0.03), name


def twice_differentiated(path: Array, dt: float) -> Array:
    """Return second differences of a path (T, ...); the first and last are left 0."""
    out = np.zeros_like(path)
    out[1:-1] = np.diff(path, 2, axis=0) / dt**2
    return out


def test_what_hangs_on_a_pedicel_bends_it_by_its_inertia(zigzag: PlantModel) -> None:
    """The rods' moment in a fast simulation is d'Alembert's, of points, as the edge sees it that turns meanwhile."""
    rods = with_gravity_equilibrium(replace(zigzag.rods, lumped_inertia=0.0, natural=None), zigzag.clamp)
    base = int(np.flatnonzero(zigzag.is_pedicel & ~zigzag.is_pedicel[zigzag.rods.parent])[0])
    drive, dt = Drive(int(zigzag.stem_nodes[12]), np.array([1.0, 0, 0]), 1e-5, 5.0, 0.4), 1e-3
    path = simulate(rods, zigzag.clamp, drive, 0.8, dt, start="scanned", tolerance=1e-10)
    found, carried = joints(rods), outboard(rods, base)
    bent = strain_changes(rods, path.positions, path.directors)[:, base] @ found.moments[base].T
    lever = path.positions[:, carried] - path.positions[:, rods.parent[base], None]
    jolt = twice_differentiated(path.positions[:, carried], dt)
    torque = np.cross(lever, rods.node_mass[carried, None] * ([0, 0, -9.81] - jolt)).sum(axis=1)
    along = path.positions[:, base] - path.positions[:, rods.parent[base]]
    along /= np.linalg.norm(along, axis=1)[:, None]
    first = path.directors[:, base]
    frame = np.stack([first, np.cross(along, first), along], axis=1)
    felt = np.einsum("tij,tj->ti", frame, torque)
    late = slice(450, 780)
    difference = np.linalg.norm(bent @ frame[0].T - (felt - felt[0]), axis=1)[late].max()
    assert difference < 0.01 * np.linalg.norm(felt - felt[0], axis=1)[late].max()
