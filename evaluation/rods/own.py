"""Loads, sections, supports, tension and grips of one's own, against Euler and Bernoulli's beam and the string."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from anther.plant.bench import fit_free_vibration
from anther.rods import (
    Clamp,
    Loads,
    NaturalShape,
    Rods,
    Section,
    Support,
    equilibrium,
    frequency_response,
    natural_frequencies,
    simulate,
)
from evaluation.rods.beam_theory import uniform_roots
from evaluation.rods.beams import NO_GRAVITY, Beam
from evaluation.rods.ends import planted
from evaluation.rods.table import Array, Row, order_row

BEAM = Beam()
EDGES, LIMIT = 50, 3e-3
PULL = 1e-3


def own_cases(quick: bool) -> list[Row]:
    """Return the rows of what users bring to the rods."""
    meshes = (16, 32, 64) if quick else (16, 32, 64, 128)
    return [*_loads(), *_sections(), _pluck(6 if quick else 12), _tension(), _support(), _grip(meshes)]


def _beam(**changes: object) -> Rods:
    return replace(planted(EDGES), edge_radius=BEAM.radius, **changes)  # pyright: ignore[reportArgumentType]


def _tip(rods: Rods, loads: Loads) -> Array:
    return (equilibrium(rods, Clamp.root(rods), gravity=NO_GRAVITY, loads=loads) - rods.nodes)[-1]


def _row(case: str, what: str, found: Array, expected: Array) -> Row:
    detail = f"found {np.array2string(found, precision=5)}, theory {np.array2string(expected, precision=5)}"
    return Row(case, what, float(np.abs(found / expected - 1).max()), LIMIT, "%", detail)


def _loads() -> list[Row]:
    rods, L, EI = _beam(), BEAM.length, BEAM.bending_stiffness
    cases = (
        ("own_force", "tip under a force on it", Loads.at(rods, EDGES, force=(0, 0, PULL)), PULL * L**3 / 3),
        ("own_torque", "tip under a torque on it", Loads.at(rods, EDGES, torque=(0, -PULL * L, 0)), PULL * L**3 / 2),
        ("own_wind", "tip under a force per length", Loads.along(rods, (0, 0, PULL / L)), PULL * L**3 / 8),
    )
    return [
        _row(case, f"{what} (Euler–Bernoulli)", _tip(rods, loads)[2:], np.array([moment / EI]))
        for case, what, loads, moment in cases
    ]


def _sections() -> list[Row]:
    rows = []
    for name, section in (
        ("rectangle", Section.rectangle(6e-3, 3e-3, (0, 1, 0))),
        ("ellipse", Section.ellipse(6e-3, 3e-3, (0, 1, 0))),
        ("tube", Section.tube(3e-3, 1e-3)),
    ):
        rods = _beam(section=section)
        found = natural_frequencies(rods, Clamp.root(rods), 2, gravity=NO_GRAVITY).frequencies
        bends = np.sort(np.array([section.bend_1, section.bend_2]))
        speed = np.sqrt(BEAM.youngs * bends / (BEAM.density * section.area))
        expected = uniform_roots(1)[0] ** 2 * speed / (2 * np.pi * BEAM.length**2)
        rows.append(_row(f"own_{name}", f"frequencies in the two planes, {name} (analytic)", found, expected))
    solid, hollow = _beam(), _beam(section=Section.tube(3e-3, 1e-3))
    load = Loads.at(solid, EDGES, force=(0, 0, PULL))
    ratio = _tip(hollow, load)[2:] / _tip(solid, load)[2:]
    rows.append(_row("own_tube_softer", "sag of a tube over that of the solid rod", ratio, 1 / np.array([1 - 16 / 81])))
    return rows


def _pluck(periods: int) -> Row:
    first, ratio = uniform_roots(1)[0] ** 2 * BEAM.rate, 0.03
    rods = replace(planted(16), edge_radius=BEAM.radius, viscous_time=2 * ratio / first)
    period = 2 * np.pi / first
    pull = Loads.at(rods, 16, force=(0, 0, PULL))
    run = simulate(
        rods, Clamp.root(rods), None, periods * period, period / 200, gravity=NO_GRAVITY, start="plucked", loads=pull
    )
    late = run.times > 2 * period
    found = fit_free_vibration(run.times[late], run.positions[late, -1, 2]).damping_ratio
    return Row("own_pluck", "pluck: damping ratio of the free vibration, 3 %", abs(found / ratio - 1), 0.02, "%")


def _tension() -> Row:
    rods, tension, n = planted(60), 0.05, np.array([1, 2, 3])
    EA, EI = BEAM.youngs * np.pi * 9e-8, BEAM.youngs * np.pi * 3e-4**4 / 4
    natural = NaturalShape(rods.lengths / (1 + tension / EA), np.zeros((61, 2)), np.zeros(61))
    pulled = replace(rods, natural=natural)
    found = natural_frequencies(pulled, Clamp(np.array([0, 60])), 6, gravity=NO_GRAVITY).frequencies[::2]
    stiff = 1 + n**2 * np.pi**2 * EI / (tension * BEAM.length**2)
    expected = n / (2 * BEAM.length) * np.sqrt(tension * stiff / (BEAM.density * np.pi * 9e-8))
    return _row(
        "own_string", "first three frequencies of a pulled, pinned string with stiffness (analytic)", found, expected
    )


def _support() -> Row:
    spring = 5 * BEAM.bending_stiffness / BEAM.length**3
    rods = _beam(supports=(Support(EDGES, translation=spring),))
    hertz = natural_frequencies(rods, Clamp.root(rods), 1, gravity=NO_GRAVITY).frequencies
    expected = 2.3667781**2 * BEAM.rate / (2 * np.pi)  # b^3 (1 + cos b cosh b) = 5 (cos b sinh b - sin b cosh b)
    return _row(
        "own_support", "first frequency with a spring of 5 EI / L^3 at the tip (Blevins)", hertz, np.array([expected])
    )


def _grip(meshes: tuple[int, ...]) -> Row:
    """A quarter of the beam held rigidly in its middle and shaken, against the finest mesh's Richardson limit."""

    def tip(edges: int) -> complex:
        rods, middle, reach = planted(edges), edges // 2, edges // 8
        held = [middle, *(middle + k for k in range(-reach, reach + 1) if k)]
        moved = frequency_response(rods, Clamp.root(rods), held, (0, 0, 1), [1.0], gravity=NO_GRAVITY, loss_factor=0.1)
        return complex(moved[0, -1, 2])

    fine, finer = tip(2 * meshes[-1]), tip(4 * meshes[-1])
    exact = finer + (finer - fine) / 3
    errors = np.array([abs(tip(edges) / exact - 1) for edges in meshes])
    what = "tip of a beam shaken by rigid pads a quarter of its length wide: order in the node distance"
    return order_row("grip_order", what, 1 / np.array(meshes), errors)
