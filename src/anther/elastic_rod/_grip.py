"""A grip that gives: pads hold a piece of a rod as one body, and springs join that body to the gripper.

H unknowns of the rods that a grip holds, Q frequencies, D directions of a shake, P nodes between the pads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anther.checks import check_range
from anther.elastic_rod._motion import gripped_edges
from anther.elastic_rod._rods import Array

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class Springs:
    """Between gripper and pads, alike in all directions, about the grip's first node; infinite: nothing gives.

    Attributes:
        translation: [N/m].
        rotation: [N m/rad]; towards 0 the grip becomes a pin.
    """

    translation: float = np.inf
    rotation: float = np.inf

    def __post_init__(self) -> None:
        for name, unit in (("translation", "N/m"), ("rotation", "N m/rad")):
            if getattr(self, name) != np.inf:
                check_range(f"stiffness in {name}", getattr(self, name), 1e-9, 1e15, unit)

    @property
    def compliance(self) -> Array:
        """(6,) displacement per force [m/N], rotation per moment [rad/(N m)]."""
        return np.repeat([1 / self.translation, 1 / self.rotation], 3)


RIGID = Springs()


class Grasped(NamedTuple):
    """What a shake of one metre does to a grip, for each direction.

    Attributes:
        forces: (Q, H, D) on each of the held unknowns.
        wrench: (Q, 6, D) of the grip on the rods: force [N/m], then moment about the first node [N m/m].
        pads: (Q, 6, D) motion of the pads: displacement of the first node [m/m], then rotation [rad/m].
    """

    forces: ComplexArray
    wrench: ComplexArray
    pads: ComplexArray


def held_unknowns(parent: NDArray[Any], pad: NDArray[Any]) -> NDArray[Any]:
    """Return the unknowns 4 node + component that a grip holds: positions, then spins of the edges between the pads."""
    edges = gripped_edges(parent, tuple(pad.tolist()))
    return np.concatenate([(4 * pad[:, None] + np.arange(3)).ravel(), 4 * edges + 3])


def rigid_motion(parent: NDArray[Any], positions: Array, pad: NDArray[Any]) -> Array:
    """Return (H, 6) what the held unknowns do when the pads move and turn about the first node of `pad` (P,)."""
    edges = gripped_edges(parent, tuple(pad.tolist()))
    lever = positions[pad] - positions[pad[0]]
    along = positions[edges] - positions[parent[edges]]
    turns = np.swapaxes(np.cross(np.eye(3), lever[:, None]), 1, 2)
    moves = np.concatenate([np.tile(np.eye(3), (len(pad), 1, 1)), turns], axis=2)
    spins = np.concatenate([0 * along, along / np.linalg.norm(along, axis=1, keepdims=True)], axis=1)
    return np.concatenate([moves.reshape(-1, 6), spins])


def grasped(receptance: ComplexArray, body: Array, directions: Array, springs: Springs) -> Grasped:
    """Return what a gripper does that moves by one metre without turning.

    The held unknowns x = G F follow the pads, x = B p, and the pads are in balance, p = u - C B^T F; so
    (G + B C B^T) F = B u. Without compliance C this is the rigid grip, G F = B u.

    Args:
        receptance: (Q, H, H) G: held unknowns per unit load on them, of the rods that nobody holds.
        body: (H, 6) B, see `rigid_motion`.
        directions: (D, 3) unit vectors.
        springs: C is their compliance.
    """
    asked = np.concatenate([directions.T, np.zeros((3, len(directions)))])
    forces: ComplexArray = np.linalg.solve(receptance + (body * springs.compliance) @ body.T, body @ asked).astype(
        np.complex128
    )
    wrench = body.T @ forces
    return Grasped(forces, wrench, asked - springs.compliance[:, None] * wrench)


@dataclass(frozen=True, slots=True, eq=False)
class Rocking:
    """Pads that swing and turn at one frequency: x(t) = Im(phasor exp(i w t)) less what it is at the start.

    Attributes:
        nodes: between the pads; they turn about the first.
        displacement_phasor: (3,) of the first node [m].
        rotation_phasor: (3,) [rad]; small, since rotation vectors are added.
        frequency: [Hz].
    """

    nodes: tuple[int, ...]
    displacement_phasor: ComplexArray
    rotation_phasor: ComplexArray
    frequency: float

    def displacement(self, times: ArrayLike) -> Array:
        """Return (T, 3) displacements [m] from the start position at (T,) times [s]."""
        return self._swung(times, self.displacement_phasor)

    def rotation(self, times: ArrayLike) -> Array:
        """Return (T, 3) rotation vectors [rad] about the first node, from the start, at (T,) times [s]."""
        return self._swung(times, self.rotation_phasor)

    def _swung(self, times: ArrayLike, phasor: ComplexArray) -> Array:
        turned = np.exp(2j * np.pi * self.frequency * np.asarray(times, dtype=np.float64)) - 1
        moved: Array = np.imag(turned[..., None] * phasor)
        return moved
