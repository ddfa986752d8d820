"""The models that predict what a shake does to the flowers: the paper's, and Anther's.

Each gives, by linear theory, every flower's amplitude per metre of grip motion. G grips, Q frequencies, F flowers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core import Array
from anther.perception import skeleton
from anther.plant import PRIORS, PlantModel
from anther.pollination import Seen
from anther.pollination.shake.observables import semi_major
from anther.rods import Clamp, Rods, least_stiffness, response_map, with_gravity_equilibrium
from anther.sim import SimPlant
from anther.sim.pieces import TWISTING
from evaluation.prediction.true_rods import Builder

PAPER_YOUNGS = {"tomato": 21.6e6, "pepper": 31.6e6}
"""[Pa], of the authors' scripts (facts: pollination 0)."""
PAPER_DENSITY = {"tomato": 1100.0, "pepper": 1500.0}
"""[kg/m3], likewise."""
PAPER_STEP = {"tomato": 1e-2, "pepper": 1e-3}
"""Of implicit Euler [s], likewise; above `PAPER_BAND`, where the paper has no result, 1 ms for both."""
PAPER_BAND = 2.0
"""[Hz]: the paper's shakes are slower."""
PAPER_VOXEL = 0.008
"""Pitch of the authors' skeletons [m]."""
SCRIPT_RADIUS, SCRIPT_DRAG = 0.03, 0.5
"""Radius [m] and damping of every node [N s/m] in the authors' final scripts."""
MARGIN = 1.5
"""A model of the paper that would buckle gets this times the Young's modulus at which it just stands."""


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """Rods to be shaken.

    Attributes:
        rods: undamped.
        stem: (S,) nodes where it can be held.
        flowers: (F,) nodes.
        damping_ratio: of motion at every frequency.
        step: of implicit Euler in the paper's band [s]; 0 is exact integration.
        pads: nodes that move alike in the grip: 1, which may turn in it, or 2.
    """

    rods: Rods
    stem: NDArray[Any]
    flowers: NDArray[Any]
    damping_ratio: float
    step: float = 0.0
    pads: int = 2

    def response(self, points: Array, direction: Array, frequencies: Array) -> Array:
        """Return (G, Q, F) flower amplitudes per metre at grips nearest to points (G, 3), frequencies (Q,) [Hz].

        Implicit Euler with the step h replaces i w by (1 - exp(-i w h)) / h, which to first order adds the mass damping
        w^2 h.
        """
        clamp = Clamp.root(self.rods)
        usable = np.flatnonzero(~np.isin(self.stem, clamp.nodes))[: 1 - self.pads or None]
        apart = np.linalg.norm(self.rods.nodes[self.stem[usable]][None] - points[:, None], axis=2)
        grips = self.stem[usable[apart.argmin(axis=1)][:, None] + np.arange(self.pads)]
        out = np.empty((len(points), len(frequencies), len(self.flowers)))
        for q, f in enumerate(frequencies):
            step = self.step if f < PAPER_BAND else min(self.step, 1e-3)
            rods = replace(self.rods, mass_damping=(2 * np.pi * f) ** 2 * step)
            seen: dict[str, Any] = {"observe": self.flowers, "loss_factor": 2 * self.damping_ratio}
            motion = response_map(rods, clamp, grips, direction[None], [f], **seen)
            out[:, q] = semi_major(motion[0, :, 0])
        return out


def anther_model(model: PlantModel) -> Model:
    """Return a plant model as it is, but for its response gain."""
    return Model(model.rods, model.stem_nodes, model.flower_nodes, model.material.damping_ratio)


def paper_model(seen: Seen, species: str, radius: float, *, as_scripted: bool = False) -> tuple[Model, float]:
    """Return the paper's model of a scanned plant, and how many times too soft the authors' E is to hold it up.

    Stair-steps of 8 mm, one radius, no twist, no leaves, no pedicels, a stress-free scan that sags, one gripped node.

    Args:
        seen: the scan; the skeleton is made anew by the paper's thinning.
        species: gives E, density and the time step.
        radius: of every edge [m].
        as_scripted: radius and damping as in the authors' final scripts.
    """
    steps = skeleton.Params(method="thinning", voxel=PAPER_VOXEL, spacing=PAPER_VOXEL, recentre=0)
    tree = skeleton.skeletonize(seen.cloud, steps)
    rods = Rods(
        tree.nodes,
        tree.parent,
        SCRIPT_RADIUS if as_scripted else radius,
        PAPER_YOUNGS[species],
        PAPER_DENSITY[species],
        bend_over_twist=0.0,
        node_drag=SCRIPT_DRAG if as_scripted else 0.0,
        discretisation="paper",
    )
    least = least_stiffness(rods, Clamp.root(rods))
    assert least is not None, "no stiffness holds this plant"
    stiff = PAPER_YOUNGS[species] * (MARGIN * least if least > 1 else 1.0)
    apart = np.linalg.norm(tree.nodes[None] - seen.flowers.positions[:, None], axis=2)
    damping = 0.0 if as_scripted else PRIORS[species].damping_ratio
    everywhere = np.arange(len(tree.nodes))
    model = Model(
        replace(rods, youngs=stiff), everywhere, apart.argmin(axis=1), damping, step=PAPER_STEP[species], pads=1
    )
    return model, least


def true_model(sim: SimPlant, bend_over_twist: float) -> Model:
    """Return rods with a simulated plant's own geometry, masses, E and damping; each flower on its pedicel.

    Only what twists in MuJoCo has `bend_over_twist` (EI/GJ).
    """
    built = Builder(sim)
    twists = np.zeros(len(built.nodes))
    for k in np.flatnonzero(np.isin(sim.organ, TWISTING)):
        twists[built.nodes_of[k]] = bend_over_twist
    rods = replace(built.rods(), bend_over_twist=twists)
    arms = [max(np.flatnonzero(rods.parent == built.last[k]), default=built.last[k]) for k in sim.flower_segment]
    stem_nodes = np.array([0, *(node for k in sim.stem_segments() for node in built.nodes_of[k])])
    hanging = with_gravity_equilibrium(rods, Clamp.root(rods))
    return Model(hanging, stem_nodes, np.array(arms), float(sim.damping_ratio[0]))
