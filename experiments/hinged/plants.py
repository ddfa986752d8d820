"""The three plants, their material, and their cutting into edges; shared by both codes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

YOUNGS, DENSITY, BEND_OVER_TWIST = 2e8, 1000.0, 1.5
"""[Pa], [kg/m^3], EI/GJ: those of the peers' reference network (data: rod_reference)."""
MASS_DAMPING, VISCOUS_TIME = 2.0, 5e-4
"""Rayleigh damping [1/s], [s]: a ratio of 0.08 at 2 Hz, 0.03 at 10 Hz, 0.05 at 30 Hz."""
HALF_METRE = 0.5


@dataclass(frozen=True)
class Member:
    """A straight member: start and end [m], radius [m]."""

    start: tuple[float, float, float]
    end: tuple[float, float, float]
    radius: float


@dataclass(frozen=True)
class Plant:
    """Straight members, the first rooted at the origin, the grip point [m] and the shake direction."""

    name: str
    members: tuple[Member, ...]
    grip: tuple[float, float, float]
    direction: tuple[float, float, float]

    @property
    def axis(self) -> Array:
        """(3,) the shake direction, of length 1."""
        way = np.array(self.direction, dtype=np.float64)
        return way / np.linalg.norm(way)


@dataclass(frozen=True, eq=False)
class Tree:
    """A mesh of N nodes.

    Attributes:
        nodes: (N, 3) [m].
        parent: (N,) -1 at the root.
        radius: (N,) of edge j, from parent[j] to j [m].
        grip: the grip's node.
        tips: (T,) the members' last nodes.
    """

    nodes: Array
    parent: NDArray[Any]
    radius: Array
    grip: int
    tips: NDArray[Any]


def straight() -> Plant:
    """Return a stem of 0.5 m, held at 0.2 m."""
    return Plant("straight", (Member((0, 0, 0), (0, 0, 0.5), 3e-3),), (0, 0, 0.2), (1, 0, 0))


def y_shape() -> Plant:
    """Return a Y whose members differ in length and radius; shaken at 45 degrees to its plane, so its stem twists."""
    s, fork = float(np.sqrt(0.5)), (0.0, 0.0, 0.3)
    right = Member(fork, (0.2 * s, 0, 0.3 + 0.2 * s), 2.5e-3)
    left = Member(fork, (-0.15 * s, 0, 0.3 + 0.15 * s), 2e-3)
    return Plant("y", (Member((0, 0, 0), fork, 3e-3), right, left), (0, 0, 0.15), (1, 1, 0))


def five_branches() -> Plant:
    """Return the peers' 3-D network: a stem of 0.5 m with five branches of 70 mm in a spiral of 137.5 degrees."""
    members = [Member((0, 0, 0), (0, 0, 0.5), 3e-3)]
    for k, z in enumerate((0.15, 0.2, 0.28, 0.35, 0.42)):
        turn = np.radians(137.5) * k
        x, y, up = 0.07 * np.sqrt(0.5) * np.array([np.cos(turn), np.sin(turn), 1])
        members.append(Member((0, 0, z), (x, y, z + up), 3e-3))
    return Plant("five_branches", tuple(members), (0, 0, 0.2), (1, 0, 0))


PLANTS = (straight, y_shape, five_branches)


def cut(plant: Plant, segments: int) -> Tree:
    """Cut the members into edges of about 0.5 m / segments, with nodes at the joints and at the grip."""
    nodes, parent, radius, tips = [np.zeros(3)], [-1], [plant.members[0].radius], []
    grip = np.array(plant.grip, dtype=np.float64)
    joints = [np.array(m.start, dtype=np.float64) for m in plant.members] + [grip]
    for member in plant.members:
        start, end = np.array(member.start, dtype=np.float64), np.array(member.end, dtype=np.float64)
        last = _nearest(nodes, start)
        for stop in _stops(start, end, joints):
            begin = nodes[last]
            count = max(1, round(float(np.linalg.norm(stop - begin)) * segments / HALF_METRE))
            for i in range(1, count + 1):
                nodes.append(begin + (stop - begin) * i / count)
                parent.append(last)
                radius.append(member.radius)
                last = len(nodes) - 1
        tips.append(last)
    return Tree(np.array(nodes), np.array(parent), np.array(radius), _nearest(nodes, grip), np.array(tips))


def _stops(start: Array, end: Array, joints: list[Array]) -> list[Array]:
    """Return the joints that lie inside a member, nearest first, and its end."""
    along = end - start
    inside: dict[float, Array] = {}
    for point in joints:
        share = float((point - start) @ along / (along @ along))
        if 1e-9 < share < 1 - 1e-9 and np.linalg.norm(start + share * along - point) < 1e-9:
            inside[round(share, 9)] = point
    return [inside[share] for share in sorted(inside)] + [end]


def _nearest(nodes: list[Array], point: Array) -> int:
    return int(np.argmin(np.linalg.norm(np.array(nodes) - point, axis=1)))
