"""A simulated plant as a frame of beams: its truth, read without the code of the simulation that it checks.

K segments, E elements, F flowers, L segments that carry a lump.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anther.sim import Organ, SimPlant
from evaluation.judge.frame_fe import AT, Array, Beams, ComplexArray, Frame, Lumps, Shake, cross_matrix

RIGID = 1e3
"""GJ over EI of what does not twist."""
STUB = 2e-4
"""Length at a segment's start over which a compliant joint, or the foot's, is spread [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """The elements' places on the segments.

    Attributes:
        nodes: (N, 3) [m]; the foot first.
        ends: (E, 2) int.
        segment: (E,) int that an element is part of.
        share: (E, 2) where it begins and ends, shares of the segment's length.
        first: (K,) int, the node at each segment's start.
    """

    nodes: Array
    ends: NDArray[np.int64]
    segment: NDArray[np.int64]
    share: Array
    first: NDArray[np.int64]

    def node_beside(self, segment: int, share: float) -> int:
        """Return the node of a segment that is nearest to a share of its length."""
        of = np.flatnonzero(self.segment == segment)
        shares = np.concatenate([[0.0], self.share[of, 1]])
        nodes = np.concatenate([self.first[[segment]], self.ends[of, 1]])
        return int(nodes[np.argmin(np.abs(shares - share))])


class FramedPlant:
    """A plant as a frame, with a node where it is held.

    Attributes:
        plant: ground truth.
        mesh: its elements.
        frame: their mechanics.
        shake: where it is held and how it is moved.
    """

    def __init__(
        self, plant: SimPlant, point: Array, direction: Array, *, size: float, twisting: Sequence[Organ]
    ) -> None:
        """Mesh a plant.

        Args:
            plant: ground truth.
            point: (3,) on the main stem's axis; held [m].
            direction: (3,) horizontal, along which it is moved.
            size: longest element [m].
            twisting: organs that twist.
        """
        held = held_at(plant, point)
        carried = np.array([_share(plant, k, plant.lump_centre[k]) for k in range(len(plant.start))])
        joint = plant.joint_compliance + np.where(plant.parent < 0, 1 / plant.foot, 0.0)
        wanted = [(k, s) for k, s in enumerate(carried) if plant.lump_mass[k] > 0]
        wanted += [(int(k), STUB / plant.length[k]) for k in np.flatnonzero(joint)]
        mesh = meshed(plant, size, [*wanted, held])
        soft = np.isin(plant.organ, twisting)
        beams = beams_of(plant, mesh, np.where(soft, 1 / plant.bend_over_twist, RIGID), joint)
        carriers = np.array([mesh.node_beside(k, s) for k, s in enumerate(carried)])
        self._assemble(plant, mesh, carriers, beams, mesh.node_beside(*held), direction)

    def _assemble(
        self, plant: SimPlant, mesh: Mesh, carriers: NDArray[np.int64], beams: Beams, held: int, direction: Array
    ) -> None:
        """Put the frame together; `carriers` (K,) are the nodes that bear what a segment carries, `held` is one too."""
        self.plant, self.mesh, self._carriers = plant, mesh, carriers
        ties = {} if plant.tie is None else {mesh.node_beside(plant.tie[0], 1.0): plant.tie[1]}
        self.frame = Frame(beams, self._lumps(), ties)
        direction = np.asarray(direction, dtype=np.float64) / np.linalg.norm(direction)
        self.shake = Shake(held, direction)

    def flowers(self, motion: ComplexArray) -> ComplexArray:
        """Return (Q, F, 3) the flowers' displacements in motions (6N, Q) of the nodes."""
        node = self._carriers[self.plant.flower_segment]
        arm = self.plant.flower_position - self.mesh.nodes[node]
        moved = motion.reshape(-1, 2, 3, motion.shape[1])[node]
        turned = np.einsum("fij,fjq->fiq", -cross_matrix(arm), moved[:, 1])
        return (moved[:, 0] + turned).transpose(2, 0, 1)

    def _lumps(self) -> Lumps:
        k = np.flatnonzero(self.plant.lump_mass > 0)
        node = self._carriers[k]
        arm = self.plant.lump_centre[k] - self.mesh.nodes[node]
        return Lumps(node, self.plant.lump_mass[k], arm, np.array([_blade_inertia(self.plant, int(i)) for i in k]))


def meshed(plant: SimPlant, size: float, nodes_at: Sequence[tuple[int, float]]) -> Mesh:
    """Divide every segment into elements no longer than `size` [m], with nodes at (segment, share of its length)."""
    wanted: dict[int, list[float]] = {}
    for k, share in nodes_at:
        wanted.setdefault(k, []).append(min(max(share, 0.0), 1.0))
    nodes, ends, segment, shares = [plant.start[0]], [], [], []
    first, last = np.zeros(len(plant.start), dtype=np.int64), np.zeros(len(plant.start), dtype=np.int64)
    for k, parent in enumerate(plant.parent):
        cuts = _cuts(wanted.get(k, []), plant.length[k] / size)
        node = first[k] = last[parent] if parent >= 0 else 0
        for a, b in zip(cuts[:-1], cuts[1:], strict=True):
            ends.append((node, len(nodes)))
            node = len(nodes)
            nodes.append(plant.start[k] + b * (plant.end[k] - plant.start[k]))
            segment.append(k)
            shares.append((a, b))
        last[k] = node
    return Mesh(np.array(nodes), np.array(ends), np.array(segment), np.array(shares), first)


def _cuts(wanted: Sequence[float], least: float) -> Array:
    """Return rising shares from 0 to 1 with the wanted ones, at least `least` a unit."""
    ends = np.unique(np.round([0.0, *wanted, 1.0], 6))
    counts = np.maximum(1, np.ceil(np.diff(ends) * least - 1e-6)).astype(int)
    parts = [a + (b - a) * np.arange(n) / n for a, b, n in zip(ends[:-1], ends[1:], counts, strict=True)]
    return np.concatenate([*parts, [1.0]])


def beams_of(plant: SimPlant, mesh: Mesh, twist_over_bend: Array, joint: Array) -> Beams:
    """Return the elements.

    Args:
        plant: ground truth.
        mesh: its elements.
        twist_over_bend: (K,) GJ/EI of the round section.
        joint: (K,) compliance in bending at a segment's start [rad/(N m)], spread over its first element.
    """
    k = mesh.segment
    at = mesh.share[:, :1] + AT * np.diff(mesh.share, axis=1)
    radius = plant.radius_start[k, None] + at * (plant.radius_end - plant.radius_start)[k, None]
    area, second = np.pi * radius**2, np.pi / 4 * radius**4
    youngs, density = plant.youngs[k, None], plant.density[k, None]
    length = np.diff(mesh.share, axis=1) * plant.length[k, None]
    softer = np.where(mesh.share[:, :1] == 0, joint[k, None] / length, 0.0)
    bend = 1 / (1 / (youngs * second) + softer)
    wide = np.linalg.norm(plant.oval[k], axis=1)
    tangent = (plant.end - plant.start)[k] / plant.length[k, None]
    any_axis = np.eye(3)[np.argmin(np.abs(tangent), axis=1)]
    across = np.cross(tangent, np.where(wide[:, None] > 0, plant.oval[k], any_axis))
    return Beams(
        nodes=mesh.nodes,
        ends=mesh.ends,
        across=across / np.linalg.norm(across, axis=1)[:, None],
        stretch=youngs * area,
        bend=bend[..., None] * np.exp(np.stack([wide, -wide], axis=1) / 2)[:, None],
        twist=youngs * second * twist_over_bend[k, None],
        mass=density * area,
        spin=np.stack(2 * [density * second], axis=-1),
        damping_ratio=plant.damping_ratio[k],
    )


def _blade_inertia(plant: SimPlant, k: int) -> Array:
    """Return (3, 3) the inertia about its own centre of what a segment carries, spread over its mesh vertices."""
    of_blades = np.zeros(len(plant.vertices), dtype=bool)
    of_blades[plant.faces[(plant.face_organ == Organ.LEAF) | (plant.face_organ == Organ.FLOWER)]] = True
    places = plant.vertices[of_blades & (plant.vertex_segment == k)]
    if len(places) < 2:
        return np.zeros((3, 3))
    spread = plant.lump_mass[k] * np.cov(places.T, bias=True)
    return np.trace(spread) * np.eye(3) - spread


def held_at(plant: SimPlant, point: Array) -> tuple[int, float]:
    """Return the segment of the main stem that is nearest to a point (3,) [m], and where along it, as a share."""
    stem = plant.stem_segments()
    shares = np.clip([_share(plant, int(k), point) for k in stem], 0, 1)
    nearest = int(np.argmin(np.linalg.norm(_on(plant, stem, shares) - point, axis=1)))
    return int(stem[nearest]), float(shares[nearest])


def _on(plant: SimPlant, k: NDArray[np.int64], share: Array) -> Array:
    return plant.start[k] + share[:, None] * (plant.end - plant.start)[k]


def _share(plant: SimPlant, k: int, place: Array) -> float:
    """Return where a place lies along a segment, as a share of its length, below 0 or above 1 beyond its ends."""
    axis = plant.end[k] - plant.start[k]
    return float((place - plant.start[k]) @ axis / (axis @ axis))
