"""Rods at their ends: planted in soil, with a lump at the tip, forking from the root; and very many nodes in line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from anther.core import StageFailure
from anther.rods import Clamp, Rods, equilibrium, natural_frequencies, simulate, with_gravity_equilibrium
from evaluation.rods.beam_theory import rayleigh_roots, roots, small_sag, uniform_roots
from evaluation.rods.beams import NO_GRAVITY, SLENDER
from evaluation.rods.table import Array, Row, order_row


def planted(edges: int, **changes: object) -> Rods:
    """Return the beam with edges of equal length; its whole length is free."""
    nodes = np.zeros((edges + 1, 3))
    nodes[:, 0] = np.linspace(0, SLENDER.length, edges + 1)
    material = {"edge_radius": SLENDER.radius, "youngs": SLENDER.youngs, "density": SLENDER.density} | changes
    return Rods(nodes, np.arange(edges + 1) - 1, **material)  # pyright: ignore[reportArgumentType]


def end_cases(quick: bool) -> list[Row]:
    """Return the rows of the ends, and of energy and length where nothing drives or shortens them."""
    meshes = (16, 32, 64, 128)
    steps = 1 / np.array(meshes)
    rows = []
    for case, what, errors_of in (
        ("planted_static", "planted cantilever, small sag under its own weight (analytic, full length)", _sag_error),
        ("planted_frequencies", "planted cantilever, first three frequencies (analytic, full length)", _mode_error),
        ("tip_inertia", "planted cantilever with a lump and its moment of inertia at the tip (analytic)", _lump_error),
        ("root_fork", "three arms with one held at its end: rooted where they fork, against rooted there", _fork_error),
        ("planted_fork", "two arms that fork from a planted root (analytic)", _arms_error),
    ):
        errors = np.array([errors_of(edges) for edges in meshes])
        rows.append(order_row(f"{case}_order", f"{what}: order in the node distance", steps, errors))
    return [*rows, _free_motion(), _long_chain(2_000 if quick else 20_000)]


def _sag_error(edges: int) -> float:
    own_weight, gravity = 8e-3, 9.81
    youngs = SLENDER.line_mass * gravity * SLENDER.length**3 / own_weight / (np.pi * SLENDER.radius**4 / 4)
    rods = planted(edges, youngs=youngs)
    tip = equilibrium(rods, Clamp.root(rods), gravity=(0, 0, -gravity))[-1]
    return abs(-tip[2] / SLENDER.length / small_sag(own_weight, 0) - 1)


def _mode_error(edges: int) -> float:
    rods = planted(edges)
    found = natural_frequencies(rods, Clamp.root(rods), 6, gravity=NO_GRAVITY).frequencies[::2]
    return float(np.abs(2 * np.pi * found / (uniform_roots(3) ** 2 * SLENDER.rate) - 1).max())


def lump_roots(mass: float, inertia: float, count: int) -> Array:
    """Return the frequency parameters b (see `uniform_roots`) of a cantilever that carries a lump at its tip.

    Args:
        mass: of the lump over that of the beam.
        inertia: of the lump over the mass of the beam and its length squared.
        count: how many.

    The tip has w'' = inertia b^4 w' and w''' = -mass b^4 w (Blevins 1979).
    """

    def equation(b: float) -> float:
        c, s, ch, sh = np.cos(b), np.sin(b), np.cosh(b), np.sinh(b)
        shape = np.array([[ch - c, sh - s], [sh + s, ch - c], [ch + c, sh + s], [sh - s, ch + c]])  # w and derivatives
        moment = shape[2] - inertia * b**3 * shape[1]
        shear = shape[3] + mass * b * shape[0]
        return float((moment[0] * shear[1] - moment[1] * shear[0]) / ch)

    return roots(equation, 0.2, 0.02, count)


def _lump_error(edges: int) -> float:
    mass, inertia = 0.5, 0.1
    whole, tip = SLENDER.line_mass * SLENDER.length, np.arange(edges + 1) == edges
    lumps = {"lumped_mass": mass * whole * tip, "lumped_inertia": inertia * whole * SLENDER.length**2 * tip}
    rods = planted(edges, bend_over_twist=0.0, **lumps)  # so that no mode of twist comes in between
    found = natural_frequencies(rods, Clamp.root(rods), 4, gravity=NO_GRAVITY).frequencies[::2]
    return float(np.abs(2 * np.pi * found / (lump_roots(mass, inertia, 2) ** 2 * SLENDER.rate) - 1).max())


def _fork_error(edges: int) -> float:
    """The same three arms twice: rooted at the fork, and at the end of the arm whose last edge is held."""
    return float(np.abs(_arms_frequencies(edges, at_fork=True) / _arms_frequencies(edges, at_fork=False) - 1).max())


def _arms_frequencies(edges: int, *, at_fork: bool) -> Array:
    ways = np.array([[0, 0, -1], [1, 0, 1], [-0.5, 0.5, 1]])
    ways = 0.1 * ways / np.linalg.norm(ways, axis=1)[:, None]
    shares = np.arange(1, edges + 1)[:, None] / edges
    stem, others = shares * ways[0], np.concatenate([shares * way for way in ways[1:]])
    parents = np.concatenate([np.arange(k * edges, (k + 1) * edges) for k in range(3)])
    parents[[edges, 2 * edges]] = 0 if at_fork else edges
    if not at_fork:
        stem = np.concatenate([stem[-2::-1], [[0, 0, 0]]])
    nodes = np.concatenate([[[0, 0, 0]] if at_fork else [ways[0]], stem, others])
    rods = Rods(nodes, np.append(-1, parents), np.append(1e-3, np.repeat([1e-3, 1.2e-3, 1e-3], edges)), 1e9, 1000.0)
    held = [edges - 1, edges] if at_fork else [0, 1]
    return natural_frequencies(rods, Clamp(np.array(held)), 6, gravity=NO_GRAVITY).frequencies


def _arms_error(edges: int) -> float:
    nodes = np.zeros((2 * edges + 1, 3))
    nodes[1 : edges + 1, 2] = nodes[edges + 1 :, 0] = SLENDER.length * np.arange(1, edges + 1) / edges
    parent = np.concatenate([[-1], np.arange(edges), [0], np.arange(edges + 1, 2 * edges)])
    rods = Rods(nodes, parent, SLENDER.radius, SLENDER.youngs, SLENDER.density)
    found = natural_frequencies(rods, Clamp.root(rods), 8, gravity=NO_GRAVITY).frequencies
    return float(np.abs(2 * np.pi * found / np.repeat(uniform_roots(2) ** 2 * SLENDER.rate, 4) - 1).max())


def _free_motion() -> Row:
    """Undamped, without gravity and drive, at a step so long that the midpoint rule makes the energy waver."""
    clamp, thick = Clamp(np.array([0, 1])), replace(planted(60), edge_radius=3e-3)
    bent = with_gravity_equilibrium(thick, clamp)
    what = "undamped, released without gravity or drive, 200 steps of 20 ms: change of energy"
    try:
        energy = simulate(bent, clamp, None, 4.0, 0.02, gravity=NO_GRAVITY, start="scanned").energy
    except StageFailure as failure:
        return Row("free_motion", what, np.nan, 1e-3, "%", str(failure))
    return Row("free_motion", what, float(np.abs(energy / energy[0] - 1).max()), 1e-3, "%")


def _long_chain(edges: int) -> Row:
    rods = planted(edges, edge_radius=3e-3)
    exact = rayleigh_roots(3, 3e-3 / SLENDER.length) ** 2 * replace(SLENDER, radius=3e-3).rate
    what = f"first three natural frequencies, planted cantilever of {edges} edges (Rayleigh's beam)"
    try:
        found = natural_frequencies(rods, Clamp.root(rods), 6, gravity=NO_GRAVITY).frequencies
    except StageFailure as failure:
        return Row("long_chain", what, np.nan, 1e-6, "%", str(failure))
    ratios = 2 * np.pi * found[::2] / exact
    return Row("long_chain", what, float(np.abs(ratios - 1).max()), 1e-6, "%", ", ".join(f"{r:.9f}" for r in ratios))
