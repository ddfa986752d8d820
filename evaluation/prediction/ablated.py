"""A plant's rods with one of their features taken away. N nodes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core import Array
from anther.rods import Clamp, Rods, least_stiffness, with_gravity_equilibrium
from evaluation.prediction.vibration_models import MARGIN, Model

VOXEL = 0.008
"""Pitch of the stair-steps [m], that of the authors' skeletons."""
PAPER_STEP = 0.01
"""Of implicit Euler below 2 Hz [s], as for the authors' tomatoes; `Model.response` takes 1 ms above."""

Change = Callable[[Model], Model]


def organs(rods: Rods, stem: NDArray[Any]) -> list[NDArray[Any]]:
    """Return chains of nodes, parents first, each without the node it leaves: at a fork the longest way goes on."""
    n, parent, reach = len(rods.nodes), rods.parent, np.zeros(len(rods.nodes))
    for j in range(n - 1, 0, -1):
        reach[parent[j]] = max(reach[parent[j]], reach[j] + rods.lengths[j])
    on_stem = np.isin(np.arange(n), stem)
    rank = reach + rods.lengths + 1e3 * on_stem
    chain_of = np.zeros(n, dtype=int)
    chains: list[list[int]] = []
    for j in range(1, n):
        p = int(parent[j])
        goes_on = p > 0 and on_stem[j] == on_stem[p] and rank[j] >= max(rank[k] for k in np.flatnonzero(parent == p))
        if goes_on:
            chain_of[j] = chain_of[p]
            chains[chain_of[j]].append(j)
        else:
            chain_of[j] = len(chains)
            chains.append([j])
    return [np.array(chain) for chain in chains]


def standing(model: Model, rods: Rods, *, stress_free: bool = False) -> Model:
    """Return the model with other rods: hanging still in their shape, or sagging from it; stiffer if they buckled."""
    bare, clamp = replace(rods, natural=None), Clamp.root(rods)
    least = least_stiffness(bare, clamp)
    assert least is not None, "no stiffness holds this plant"
    stiff = replace(bare, youngs=np.asarray(bare.youngs) * (MARGIN * least if least > 1 else 1.0))
    return replace(model, rods=stiff if stress_free else with_gravity_equilibrium(stiff, clamp))


def without_taper(model: Model) -> Model:
    """Give each organ its mean radius."""
    rods, radius = model.rods, np.array(model.rods.edge_radius)
    for chain in organs(rods, model.stem):
        radius[chain] = np.average(radius[chain], weights=rods.lengths[chain])
    return standing(model, replace(rods, edge_radius=radius))


def with_one_radius(model: Model) -> Model:
    """Give all edges the stem's mean radius."""
    rods, stem = model.rods, model.stem[1:]
    mean = np.average(np.asarray(rods.edge_radius)[stem], weights=rods.lengths[stem])
    return standing(model, replace(rods, edge_radius=float(mean)))


def with_twist(ratio: float) -> Change:
    """Give all edges one EI/GJ; 0: no twist."""
    return lambda model: standing(model, replace(model.rods, bend_over_twist=ratio))


def stress_free(model: Model) -> Model:
    """Take the scanned shape for the one without stress: it sags under its weight."""
    return standing(model, model.rods, stress_free=True)


def straightened(model: Model) -> Model:
    """Make each organ straight, between its ends."""
    rods, x = model.rods, model.rods.nodes.copy()
    for chain in organs(rods, model.stem):
        base = rods.parent[chain[0]]
        along = np.cumsum(rods.lengths[chain])
        x[chain] = x[base] + (along / along[-1])[:, None] * (rods.nodes[chain[-1]] - rods.nodes[base])
    return standing(model, replace(rods, nodes=x))


def in_steps(model: Model) -> Model:
    """Let all centrelines go from cube to cube of a grid, as those of a thinned skeleton do."""
    rods = model.rods
    cells, parent, edge, node_of = _steps(rods)
    per_edge = ("edge_radius", "youngs", "density", "bend_over_twist")
    at_node = ("lumped_mass", "lumped_inertia")
    values: dict[str, Any] = {name: np.asarray(getattr(rods, name))[edge] for name in per_edge}
    values |= {name: np.bincount(node_of, getattr(rods, name), len(cells)) for name in at_node}
    stepped = Rods(VOXEL * cells, parent, **values)
    stem = _way(parent, int(node_of[model.stem[-1]]))
    return standing(replace(model, stem=stem, flowers=node_of[model.flowers]), stepped)


def _steps(rods: Rods) -> tuple[Array, NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return cubes (M, 3) that follow the rods, the parent and the edge of each, and the cube of each node (N,)."""
    cells = [tuple(np.round(rods.nodes[0] / VOXEL))]
    parent, edge, node_of = [-1], [0], np.zeros(len(rods.nodes), dtype=int)
    for j in range(1, len(rods.nodes)):
        at = int(node_of[rods.parent[j]])
        start, end = rods.nodes[rods.parent[j]], rods.nodes[j]
        for share in np.linspace(0, 1, int(np.ceil(4 * rods.lengths[j] / VOXEL)) + 1)[1:]:
            cell = tuple(np.round((start + share * (end - start)) / VOXEL))
            if parent[at] >= 0 and cell == cells[parent[at]]:
                at = parent[at]  # back where it came from
            elif cell != cells[at]:
                cells.append(cell)
                parent.append(at)
                edge.append(j)
                at = len(cells) - 1
        node_of[j] = at
    return np.array(cells), np.array(parent), np.array(edge), node_of


def _way(parent: NDArray[Any], node: int) -> NDArray[Any]:
    """Return the nodes from the root to a node."""
    way = [node]
    while parent[way[-1]] >= 0:
        way.append(int(parent[way[-1]]))
    return np.array(way[::-1])


def without_leaves(model: Model) -> Model:
    """Take the leaves' mass away; the flowers keep theirs."""
    mass: Array = np.zeros(len(model.rods.nodes))
    mass[model.flowers] = np.asarray(model.rods.lumped_mass)[model.flowers]
    return standing(model, replace(model.rods, lumped_mass=mass))


def by_implicit_euler(model: Model) -> Model:
    """Integrate as the authors did."""
    return replace(model, step=PAPER_STEP)


def all_at_once(model: Model) -> Model:
    """Take away everything but what the paper's model has."""
    bare = in_steps(without_leaves(with_twist(0.0)(with_one_radius(model))))
    return by_implicit_euler(stress_free(bare))


def stiffer(model: Model) -> Model:
    """Take a material that is wrong by no more than one knows it."""
    return standing(model, replace(model.rods, youngs=1.2 * np.asarray(model.rods.youngs)))


CHANGES: dict[str, tuple[str, Change]] = {
    "no_taper": ("taper: mean radius of each organ", without_taper),
    "one_radius": ("radii: the stem's mean for all", with_one_radius),
    "no_twist": ("twist: none", with_twist(0.0)),
    "round_bar": ("twist: EI/GJ 1.5 instead of 12", with_twist(1.5)),
    "stress_free": ("rest shape: the scan without stress", stress_free),
    "straight": ("curvature: each organ straight", straightened),
    "stairs": ("smooth centreline: 8 mm stair-steps", in_steps),
    "no_leaves": ("leaf mass: none", without_leaves),
    "euler": ("integrator: implicit Euler, 10 ms (1 ms from 2 Hz)", by_implicit_euler),
    "all": ("all of these", all_at_once),
    "stiffer": ("for comparison: E 20 % higher", stiffer),
}
