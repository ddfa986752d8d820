"""A plant as the simulation cuts it, rigid pieces on sprung hinges, in the frame's code: what is the pieces' doing?

Only the cut and the hinges' stiffnesses are those of the simulation; masses, gravity, damping and the solution are the
frame's. B pieces.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from anther.sim import SimPlant, plant_mechanics
from evaluation.judge.finer_plant import divided
from evaluation.judge.frame_fe import STANDARD_GRAVITY, Array, carried, scattered
from evaluation.judge.frame_plant import FramedPlant, beams_of, held_at, meshed

RIGID, RIGID_PER_VOLUME = 1e4, 3e12
"""How much stiffer a piece is than the rod it was cut from; at most, and per cubed length [1/m3] of short ones, beyond
which rounding would blur the plant's slow motion."""
HINGE = 2e-5
"""Length of the element that is a hinge [m]."""


class HingedPlant(FramedPlant):
    """A plant of rigid pieces, held where a frame would be. Attributes as of `FramedPlant`; its plant is the finer."""

    def __init__(
        self, plant: SimPlant, point: Array, direction: Array, params: plant_mechanics.Params, *, ordered: bool = True
    ) -> None:
        """Cut a plant.

        Args:
            plant: ground truth.
            point: (3,) on the main stem's axis; the piece there is held [m].
            direction: (3,) horizontal, along which it is moved.
            params: how the simulation cuts; rotor inertia is left out.
            ordered: two crossed hinges turn one after the other, as in the simulation; else at once.
        """
        finer, _ = divided(plant, params.piece)
        pieces = plant_mechanics.cut(finer, params)
        held = held_at(finer, point)
        starts = {int(k): b for b, k in enumerate(pieces.first)}
        mesh = meshed(finer, np.inf, [*((k, HINGE / finer.length[k]) for k in starts), held])
        beams = beams_of(finer, mesh, np.ones(len(finer.start)), np.zeros(len(finer.start)))
        hinges = np.flatnonzero((mesh.share[:, 0] == 0) & np.isin(mesh.segment, pieces.first))
        piece = np.array([starts[int(k)] for k in mesh.segment[hinges]])
        length = beams.length[hinges]
        oval = beams.bend[hinges] / np.sqrt(beams.bend[hinges].prod(axis=2, keepdims=True))
        rigid = min(RIGID, RIGID_PER_VOLUME * params.piece**3)
        bend, twist = rigid * beams.bend, rigid * beams.twist
        bend[hinges] = (length * pieces.stiffness[piece])[:, None, None] * oval
        turns = pieces.twist[piece] > 0
        twist[hinges[turns]] = (length * pieces.twist[piece])[turns, None]
        beams = replace(beams, bend=bend, twist=twist, stretch=100 * beams.stretch)
        ends = np.array([mesh.node_beside(k, 1.0) for k in range(len(finer.start))])
        self._assemble(finer, mesh, ends, beams, mesh.node_beside(held[0], max(held[1], 0.1)), direction)
        if ordered:
            self._order(hinges)

    def _order(self, hinges: NDArray[np.int64]) -> None:
        """Let the hinges (B,) of a piece turn one after the other, about the axes that the ones before have turned.

        Their angles q make the rotation sum q_i e_i + sum_(i<j) q_i q_j e_i x e_j / 2 (Baker, Campbell and Hausdorff).
        The moment m that a hinge carries works on it, in the frame on the rotation itself: the hinges' energy is less
        by sum_(i<j) q_i q_j m . (e_i x e_j) / 2. Without m, or with hinges ever closer, it is nothing.
        """
        beams = self.frame.beams
        moment = carried(beams, self.frame.lumps, STANDARD_GRAVITY)[1][hinges].mean(axis=1)
        axes = beams.frames[hinges][:, [1, 2, 0]]
        energy = np.zeros((len(hinges), 3, 3))
        for i, j in ((0, 1), (0, 2), (1, 2)):
            work = np.einsum("ei,ei->e", moment, np.cross(axes[:, i], axes[:, j]))
            energy[:, i, j] = energy[:, j, i] = -work / 2
        world = np.einsum("eia,eij,ejb->eab", axes, energy, axes)
        blocks = np.concatenate([np.concatenate([world, -world], 2), np.concatenate([-world, world], 2)], 1)
        dofs = (6 * beams.ends[hinges][:, :, None] + np.arange(3, 6)).reshape(-1, 6)
        self.frame.stiffness = self.frame.stiffness + scattered(blocks, dofs, 6 * len(beams.nodes))
