"""Loads, sections and shaken bases of one's own, against Euler and Bernoulli's beam and the string."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from made_rods import NO_GRAVITY, cantilever, random_tree

from anther.core.errors import InputError
from anther.plant.bench import fit_free_vibration
from anther.rods import (
    Clamp,
    FunctionDrive,
    Loads,
    NaturalShape,
    Rods,
    SampledDrive,
    Section,
    base_response,
    equilibrium,
    natural_frequencies,
    simulate,
    with_gravity_equilibrium,
)
from anther.rods._model import build_model
from anther.rods._strains import _strains

L, EI, LINE = 0.3, 2e8 * np.pi * 3e-3**4 / 4, 1100 * np.pi * 3e-3**2
FIRST = 1.87510407


def first_hertz(bending: float, line_mass: float = LINE) -> float:
    return FIRST**2 / (2 * np.pi * L**2) * np.sqrt(bending / line_mass)


def sunk(rods: Rods, loads: Loads) -> np.ndarray:
    return (equilibrium(rods, Clamp.root(rods), gravity=NO_GRAVITY, loads=loads) - rods.nodes)[-1]


@pytest.mark.parametrize(
    ("load", "expected"),
    [
        (lambda r: Loads.at(r, 40, force=(0, 0, 1e-3)), (0, 0, 1e-3 * L**3 / 3 / EI)),
        (lambda r: Loads.at(r, 20, force=(0, 2e-3, 0)), (0, 2e-3 * (L / 2) ** 2 * (L - L / 6) / 2 / EI, 0)),
        (lambda r: Loads.at(r, 40, torque=(0, -1e-4, 0)), (0, 0, 1e-4 * L**2 / 2 / EI)),
        (lambda r: Loads.along(r, (0, 3e-3, 4e-3)), (0, 3e-3 * L**4 / 8 / EI, 4e-3 * L**4 / 8 / EI)),
        (lambda r: Loads.at(r, 40, torque=(0, -1e-4, 0)) * 2 + Loads.along(r, (0, 0, 1e-3)), (0, 0, 0.0027)),
    ],
)
def test_a_cantilever_bends_under_loads_as_euler_and_bernoulli_say(load, expected):
    rods = cantilever(40)
    if expected == (0, 0, 0.0027):  # superposition
        expected = (0, 0, (2e-4 / 2 + 1e-3 * L**2 / 8) * L**2 / EI)
    np.testing.assert_allclose(sunk(rods, load(rods))[1:], expected[1:], rtol=1.5e-3, atol=1e-9)


def test_a_torque_follows_the_edge_and_twists_it():
    rods = cantilever(40)
    torque = EI / L  # bends to an arc of one radian
    moved = sunk(rods, Loads.at(rods, 40, torque=(0, -torque, 0)))
    np.testing.assert_allclose(moved, [L * (np.sin(1) - 1), 0, L * (1 - np.cos(1))], atol=2e-4 * L)
    about = 0.2 * EI / 1.5 / L
    run = simulate(rods, Clamp.root(rods), None, 1e-3, 1e-3, gravity=NO_GRAVITY,
                   loads=Loads.at(rods, 40, torque=(about, 0, 0)))  # fmt: skip
    m1 = run.directors[0, [1, 40]]
    assert np.arccos(m1[0] @ m1[1]) == pytest.approx(0.2 * 39 / 40, rel=1e-6)


def test_loads_that_fit_no_edge_are_refused():
    rods = cantilever(4)
    with pytest.raises(InputError, match="load node"):
        Loads.at(rods, 9)
    with pytest.raises(InputError, match="torque"):
        Loads.at(rods, 0, torque=(1, 0, 0))
    with pytest.raises(InputError, match="5 nodes"):
        equilibrium(cantilever(5), Clamp(np.array([0, 1])), loads=Loads.at(rods, 4))


def test_a_force_that_comes_at_once_swings_twice_as_far_and_does_the_work_of_the_energy():
    rods = cantilever(16)
    pull, half = Loads.at(rods, 16, force=(0, 0, 1e-3)), 0.5 / first_hertz(EI)
    for loads in (lambda t: pull if t > 0 else None, pull):
        start = "equilibrium" if callable(loads) else "scanned"
        run = simulate(rods, Clamp.root(rods), None, 2 * half, half / 100, gravity=NO_GRAVITY, start=start, loads=loads)
        swing = run.displacement(16)[:, 2]
        assert swing.max() == pytest.approx(2 * 1e-3 * L**3 / 3 / EI, rel=0.03)
        assert run.times[swing.argmax()] == pytest.approx(half, rel=0.1)
        np.testing.assert_allclose(run.work, 1e-3 * swing, atol=1e-12)
        np.testing.assert_allclose(run.energy - run.energy[0], run.work, atol=1e-3 * run.work.max())


def test_a_plucked_stem_swings_at_its_frequency_and_decays_by_its_damping():
    rods = replace(cantilever(16), viscous_time=2 * 0.03 / (2 * np.pi * first_hertz(EI)))
    pull, period = Loads.at(rods, 16, force=(0, 0, 5e-3)), 1 / first_hertz(EI)
    run = simulate(rods, Clamp.root(rods), None, 10 * period, period / 100, gravity=NO_GRAVITY, start="plucked",
                   loads=pull)  # fmt: skip
    assert run.displacement(16)[0, 2] == 0
    assert run.positions[0, 16, 2] == pytest.approx(5e-3 * L**3 / 3 / EI, rel=0.01)
    late = run.times > 2 * period
    found = fit_free_vibration(run.times[late], run.positions[late, 16, 2])
    assert found.damping_ratio == pytest.approx(0.03, rel=0.02)
    assert found.natural_frequency == pytest.approx(first_hertz(EI), rel=3e-3)
    tops = run.positions[:, 16, 2][[0, *(round(100 * k) for k in (4, 5, 6, 7))]]
    assert np.log(tops[1] / tops[4]) / 3 == pytest.approx(2 * np.pi * 0.03, rel=0.05)  # logarithmic decrement


SECTIONS = {
    "rectangle": (Section.rectangle(8e-3, 4e-3, (0, 1, 0)), 8e-3**3 * 4e-3 / 12, 8e-3 * 4e-3**3 / 12, 32e-6),
    "ellipse": (
        Section.ellipse(8e-3, 4e-3, (0, 1, 0)), np.pi / 64 * 8e-3**3 * 4e-3, np.pi / 64 * 8e-3 * 4e-3**3,
        np.pi / 4 * 32e-6,
    ),
    "tube": (Section.tube(3e-3, 1e-3), np.pi / 4 * (81e-12 - 16e-12), np.pi / 4 * 65e-12, np.pi * 5e-6),
}  # fmt: skip


@pytest.mark.parametrize("name", SECTIONS)
def test_a_section_bends_and_swings_in_two_planes(name):
    section, along_1, along_2, area = SECTIONS[name]
    rods = replace(cantilever(40), section=section)
    moved = sunk(rods, Loads.at(rods, 40, force=(0, 1e-3, 1e-3)))
    np.testing.assert_allclose(moved[1:] * 3 * 2e8 / (1e-3 * L**3), [1 / along_1, 1 / along_2], rtol=2e-3)
    found = natural_frequencies(rods, Clamp.root(rods), 2, gravity=NO_GRAVITY).frequencies
    expected = [first_hertz(2e8 * moment, 1100 * area) for moment in sorted((along_1, along_2))]
    np.testing.assert_allclose(found, expected, rtol=2e-3)


def test_torsion_constants_are_the_textbooks():
    # Timoshenko and Goodier, Theory of Elasticity, table of c2: J = c2 long short^3
    for ratio, c2 in ((1, 0.1406), (2, 0.229), (10, 0.312)):
        assert Section.rectangle(2e-3, ratio * 2e-3).torsion == pytest.approx(c2 * ratio * 2e-3**4, rel=2e-3)
    round_one = Section.ellipse(6e-3, 6e-3)
    assert round_one.torsion == pytest.approx(round_one.bend_1 + round_one.bend_2)
    assert Section.tube(3e-3, 3e-3).bend_1 == pytest.approx(np.pi * 3e-3**4 / 4)


def test_a_round_section_is_the_round_rod_also_at_kinks_and_forks():
    rods = random_tree(4)
    radius = np.asarray(rods.edge_radius)
    same = replace(rods, section=Section.ellipse(2 * radius, 2 * radius, (0.3, 0.5, -0.1)))
    ours, theirs = build_model(same, NO_GRAVITY)[0], build_model(rods, NO_GRAVITY)[0]
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12 * np.abs(b).max(initial=0))


def test_an_axis_turns_with_the_beam_wherever_it_points():
    flat, expected = Section.rectangle(8e-3, 3e-3, (0, 1, 0)), None
    for turn in (0.0, 0.7, 2.0):
        c, s = np.cos(turn), np.sin(turn)
        rotation = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ [[1, 0, 0], [0, c, -s], [0, s, c]]
        rods = cantilever(12)
        kinked = rods.nodes + np.array([0, 0.02, 0.05]) * np.maximum(np.arange(13) - 6, 0)[:, None] / 6
        rods = replace(rods, nodes=kinked @ rotation.T, section=replace(flat, axis=rotation @ [0, 1, 0]))
        found = natural_frequencies(rods, Clamp.root(rods), 4, gravity=NO_GRAVITY).frequencies
        expected = found if expected is None else expected
        np.testing.assert_allclose(found, expected, rtol=1e-8)
    with pytest.raises(InputError, match="section axis"):
        natural_frequencies(replace(cantilever(3), section=Section.rectangle(1e-3, 2e-3)), Clamp(np.array([0, 1])), 1)


def test_stiffness_may_be_given_itself():
    rods, nodes = cantilever(20), cantilever(20).nodes
    same = Rods.of_stiffness(nodes, rods.parent, EI, LINE, edge_radius=3e-3)
    for a, b in zip(build_model(same, (0, 0, -9.81))[0], build_model(rods, (0, 0, -9.81))[0], strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-14)
    petiole = Rods.of_stiffness(nodes, rods.parent, EI, LINE, bending_2=4 * EI, twisting=EI / 12, axis=(0, 1, 0))
    moved = sunk(petiole, Loads.at(petiole, 20, force=(0, 1e-3, 4e-3)))
    np.testing.assert_allclose(moved[1:], 1e-3 * L**3 / 3 / EI, rtol=3e-3)
    run = simulate(petiole, Clamp.root(petiole), None, 1e-3, 1e-3, gravity=NO_GRAVITY,
                   loads=Loads.at(petiole, 20, torque=(0.1 * EI / 12 / L, 0, 0)))  # fmt: skip
    assert np.arccos(run.directors[0, 1] @ run.directors[0, 20]) == pytest.approx(0.1 * 19 / 20, rel=1e-5)


def test_a_pulled_string_rings_at_its_tension():
    rods, tension = cantilever(60, edge_radius=3e-4, youngs=2e9), 2.0
    bending, area = 2e9 * np.pi * 3e-4**4 / 4, np.pi * 3e-4**2
    natural = NaturalShape(rods.lengths / (1 + tension / (2e9 * area)), np.zeros((61, 2)), np.zeros(61))
    pinned = Clamp(np.array([0, 60]))
    found = natural_frequencies(replace(rods, natural=natural), pinned, 6, gravity=NO_GRAVITY).frequencies[::2]
    n, line = np.array([1, 2, 3]), 1100 * area
    expected = n / (2 * L) * np.sqrt(tension / line * (1 + n**2 * np.pi**2 * bending / (tension * L**2)))
    np.testing.assert_allclose(found, expected, rtol=2e-3)


def test_a_pull_along_the_beam_raises_its_frequency_and_a_push_lowers_it():
    rods = cantilever(40)
    euler = np.pi**2 * EI / (4 * L**2)
    for share in (-0.5, 0.5):
        pull = Loads.at(rods, 40, force=(share * euler, 0, 0))
        found = natural_frequencies(rods, Clamp.root(rods), 1, gravity=NO_GRAVITY, loads=pull).frequencies[0]
        # Galef 1968: w^2 of a beam under an end load is nearly linear in it, 0 at Euler's
        assert (found / first_hertz(EI)) ** 2 == pytest.approx(1 + share, abs=0.06)


@pytest.mark.parametrize("planted", [True, False])
def test_a_shaken_base_moves_the_stem_as_the_linear_response_says(planted):
    rods = replace(cantilever(12, axis=2), viscous_time=4e-3)
    clamp, hertz, size = (Clamp.root(rods) if planted else Clamp(np.array([0, 1]))), 8.0, 1e-5
    base = FunctionDrive(0, lambda t: np.outer((1 - np.exp(-4 * t)) * size * np.sin(2 * np.pi * hertz * t), [1, 0, 0]))
    run = simulate(rods, clamp, None, 2.5, 1 / hertz / 100, gravity=NO_GRAVITY, base=base, tolerance=1e-11)
    late = slice(-200, None)
    moved = 2j * np.mean(np.exp(-2j * np.pi * hertz * run.times[late]) * run.positions[late, -1, 0]) / size
    expected = base_response(rods, clamp, (1, 0, 0), [hertz], gravity=NO_GRAVITY)[0, -1, 0]
    assert abs(moved - expected) < 0.01 * abs(expected)


def test_a_turned_base_carries_the_stem_with_it():
    rods = replace(cantilever(10, axis=2), viscous_time=2e-2)
    times = np.linspace(0, 1.0, 101)
    turn = np.outer(0.5 - 0.5 * np.cos(np.pi * times), [0, 0.6, 0])
    base = SampledDrive(0, times, np.outer(times, [0.01, 0, 0]), rotations=turn)
    run = simulate(rods, Clamp.root(rods), None, 3.0, 5e-3, gravity=NO_GRAVITY, base=base)
    np.testing.assert_allclose(run.positions[-1, -1], [0.01 + L * np.sin(0.6), 0, L * np.cos(0.6)], atol=1e-5)
    undamped = replace(rods, viscous_time=0.0)
    run = simulate(undamped, Clamp.root(rods), None, 1.0, 1e-3, gravity=NO_GRAVITY, base=base)
    assert np.abs(run.energy - run.energy[0] - run.work).max() < 0.02 * run.energy.max()


def test_a_base_is_clamped_and_alone():
    rods = cantilever(4)
    base = SampledDrive(2, [0, 1], np.zeros((2, 3)))
    with pytest.raises(InputError, match="base node"):
        simulate(rods, Clamp.root(rods), None, 0.01, 1e-3, base=base)
    with pytest.raises(InputError, match="beside a base"):
        simulate(rods, Clamp.root(rods), base, 0.01, 1e-3, base=replace(base, node=0))


def joint_strains(model, x, frames):
    strains = np.zeros((1, len(x), 3))
    _strains(model, x[None], frames.m1[None], strains)
    return strains[0]


def test_a_strongly_twisted_joint_bends_too_easily_and_is_warned_of():
    rods = Rods(np.array([[0, 0, 0], [1, 0, 0], [2, 0.2, 0]], dtype=float), [-1, 0, 1], 0.1, 1e8, 1000.0)
    model, frames = build_model(rods, NO_GRAVITY)
    t = (rods.nodes[2] - rods.nodes[1]) / rods.lengths[2]
    size = [np.hypot(*joint_strains(model, rods.nodes, twisted(frames, t, angle))[2, :2]) for angle in (0.0, 0.45, 1.7)]
    np.testing.assert_allclose(np.array(size) ** 2 / size[0] ** 2, np.cos(np.array([0, 0.45, 1.7]) / 2) ** 2)
    beam = cantilever(4)
    for angle, warned in ((0.3, 0), (0.6, 1)):  # of each joint between edges
        torque = Loads.at(beam, 4, torque=(angle * EI / 1.5 / (L / 4), 0, 0))
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            equilibrium(beam, Clamp.root(beam), gravity=NO_GRAVITY, loads=torque)
        assert len(said) == warned


def twisted(frames, t, angle):
    m1 = frames.m1.copy()
    m1[2] = np.cos(angle) * m1[2] + np.sin(angle) * np.cross(t, m1[2])
    return frames._replace(m1=m1)


def kinked(edges: int, youngs: float = 1e8) -> Rods:
    along = np.minimum(np.arange(2 * edges + 1), edges) * 0.1 / edges
    beyond = np.maximum(np.arange(2 * edges + 1) - edges, 0) * 0.1 / edges
    nodes = np.stack([0.5 * beyond, 0 * along, along + np.sqrt(0.75) * beyond], axis=1)
    return Rods(nodes, np.arange(2 * edges + 1) - 1, 1e-3, youngs, 1000.0)


def test_a_kink_taken_from_the_scanned_instead_of_the_natural_shape_matters_to_second_order_only():
    apart = []
    for edges in (6, 12):
        made = kinked(edges)  # its scanned shape is the natural one; the other's hangs
        hanging = with_gravity_equilibrium(replace(made, nodes=equilibrium(made, Clamp.root(made))), Clamp.root(made))
        first, other = (natural_frequencies(r, Clamp.root(r), 3).frequencies for r in (made, hanging))
        apart.append(np.abs(other / first - 1).max())
    assert apart[0] < 2e-3
    assert apart[0] / apart[1] > 3.5
