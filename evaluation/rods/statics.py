"""Cantilevers at rest: small deflection, the elastica, masses on the tip, and the order in the node distance."""

from __future__ import annotations

import numpy as np

from anther.rods import equilibrium
from evaluation.rods.beam_theory import elastica, small_sag
from evaluation.rods.beams import CLAMPED, SLENDER, Beam
from evaluation.rods.table import Array, Row, order_row

NODES = 50
LIMIT = 1e-3


def static_cases(quick: bool) -> list[Row]:
    """Return the static rows."""
    meshes = (7, 13, 25, NODES) if quick else (7, 13, 25, NODES, 100)
    cases = [
        ("static_small", "small deflection under its own weight, Euler–Bernoulli", 8e-3, 0.0, True),
        ("static_tip_mass", "small deflection with a tip mass, Euler–Bernoulli", 1e-3, 3e-3, True),
        ("static_elastica", "large deflection under its own weight, elastica", 6.0, 0.0, False),
        ("static_elastica_tip_mass", "large deflection with a tip mass, elastica", 2.0, 5.0, False),
    ]
    rows, steps = [], np.array([SLENDER.spacing(n) for n in meshes])
    for case, what, own_weight, tip_load, small in cases:
        exact = np.array([np.nan, small_sag(own_weight, tip_load)] if small else elastica(own_weight, tip_load))
        tips = [tip_of(nodes, own_weight, tip_load) for nodes in meshes]
        errors = np.array([_error(tip, exact) for tip in tips])
        at = meshes.index(NODES)
        detail = f"tip drop {tips[at][1]:.6f} L, exact {exact[1]:.6f} L" + ("" if small else f"; x {tips[at][0]:.6f} L")
        rows.append(Row(case, f"{what}, {NODES} nodes", float(errors[at]), LIMIT, "%", detail))
        rows.append(order_row(f"{case}_order", f"{what}: order in the node distance", steps, errors))
    return rows


def tip_of(nodes: int, own_weight: float, tip_load: float) -> Array:
    """Return the tip (x, drop) over L of a cantilever with q = own_weight and P = tip_load (see `beam_theory`)."""
    beam, gravity = SLENDER, 9.81
    youngs = beam.line_mass * gravity * beam.length**3 / own_weight / (np.pi * beam.radius**4 / 4)
    beam = Beam(beam.length, beam.radius, youngs, beam.density)
    mass = tip_load * beam.bending_stiffness / beam.length**2 / gravity
    rods = beam.rods(nodes, tip_mass=mass)
    tip = equilibrium(rods, CLAMPED, gravity=(0, 0, -gravity))[-1]
    x_of_clamp = 0.5 * beam.length * beam.spacing(nodes)
    return np.array([tip[0] - x_of_clamp, -tip[2]]) / beam.length


def _error(tip: Array, exact: Array) -> float:
    """Return the distance from the exact tip over the exact tip's displacement; of the drop alone if x is NaN."""
    if np.isnan(exact[0]):
        return float(abs(tip[1] / exact[1] - 1))
    return float(np.linalg.norm(tip - exact) / np.linalg.norm(exact - [1, 0]))
