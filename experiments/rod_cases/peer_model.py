"""The conventions of the peer solver, as the README of the reference data describes them, with its defects to choose.

Written from that description to find out what each defect does to the authors' plants; it is no part of the engine.
Edges have a first director that is carried along in time by parallel transport and, in the peer, never turns about its
edge.
N nodes, M edges, S bend springs.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.linalg import spsolve

from anther.elastic_rod import GRAVITY
from rod_cases.table import Array

ITERATIONS = 60


class Springs(NamedTuple):
    """Bend springs from edge e to edge f, both turned so that they run n0 -> n1 -> n2."""

    edges: NDArray[Any]  # (S, 2)
    signs: Array  # (S, 2) +-1
    nodes: NDArray[Any]  # (S, 3)


@dataclass(frozen=True)
class Shake:
    """x of the grip node follows amplitude * sin(2 pi frequency t)."""

    grip: int
    amplitude: float
    frequency: float


class PeerModel:
    """Rods of one radius as the peer sees them.

    Args:
        nodes: (N, 3) rest positions [m].
        edges: (M, 2) node numbers.
        setup: keys r [m], E [Pa], rho [kg/m^3], damping_per_node_Ns_per_m.
        directors: "edge number": the first director of an edge is carried over from the edge with the number before
            (the peer). "connectivity": from the edge it is joined to, breadth first from edge 0.
        siblings: whether edges that leave a joint side by side have a spring too (the peer: yes).
        turning: whether edges turn about themselves, against twist springs of GJ = EI / 1.5 (the peer: no).
    """

    def __init__(
        self,
        nodes: Array,
        edges: NDArray[Any],
        setup: dict[str, Any],
        *,
        directors: Literal["edge number", "connectivity"] = "edge number",
        siblings: bool = True,
        turning: bool = False,
    ) -> None:
        self.turning = turning
        area = np.pi * setup["r"] ** 2
        self.rest, self.edges = nodes, edges
        self.length = np.linalg.norm(nodes[edges[:, 1]] - nodes[edges[:, 0]], axis=1)
        self.springs = _springs(edges, siblings)
        self.m1 = _rest_directors(self.tangents(nodes), edges, self.springs, directors)
        self.mass = setup["rho"] * area * 0.5 * np.bincount(edges.ravel(), np.repeat(self.length, 2), len(nodes))
        self.drag = setup["damping_per_node_Ns_per_m"]
        self.stretch = setup["E"] * area / self.length
        spans = self.length[self.springs.edges].mean(axis=1)
        self.bend = setup["E"] * area * setup["r"] ** 2 / 4 / spans
        self.twist = self.bend / 1.5 if turning else 0 * self.bend
        self.natural = self._strains(nodes, self.m1)[0]

    def tangents(self, x: Array) -> Array:
        """Return (M, 3) unit tangents at positions x (N, 3)."""
        along = x[self.edges[:, 1]] - x[self.edges[:, 0]]
        return along / np.linalg.norm(along, axis=1, keepdims=True)

    def carried(self, m1: Array, old: Array, x: Array, turn: Array | float = 0.0) -> Array:
        """Return the directors m1 (M, 3) carried from positions `old` to x, and turned by turn (M,) [rad]."""
        t, angle = self.tangents(x), np.broadcast_to(turn, len(m1))[:, None]
        moved = transport(m1, self.tangents(old), t)
        moved = np.cos(angle) * moved + np.sin(angle) * np.cross(t, moved)
        moved -= np.sum(moved * t, axis=1, keepdims=True) * t
        return moved / np.linalg.norm(moved, axis=1, keepdims=True)

    def bend_energy(self, x: Array, m1: Array) -> float:
        """Return the energy of bending [J]."""
        strains = (self._strains(x, m1)[0] - self.natural)[:2]
        return float(0.5 * np.sum(self.bend * strains**2))

    def stiffness_lost(self) -> Array:
        """Return (S,) the factor, 0..1, on the stiffness of each spring against bending in its softest plane.

        The mean of the two edges' directors is shorter than they are by cos(phi / 2), phi the angle between them.
        """
        e, f = self.springs.edges.T
        t, (se, sf) = self.tangents(self.rest), self.springs.signs.T
        here = transport(self.m1[e], se[:, None] * t[e], sf[:, None] * t[f])
        cosine = np.sum(here * self.m1[f], axis=1)
        return (1 + cosine) / 2

    def _strains(self, x: Array, m1: Array) -> tuple[Array, Array]:
        """Return kappa1, kappa2 and twist (3, S), and their gradients (3, S, 2, 4): edge e, f; position, spin."""
        (e, f), (n0, n1, n2), signs = self.springs.edges.T, self.springs.nodes.T, self.springs.signs
        le, lf = (np.linalg.norm(v, axis=1)[:, None] for v in (x[n1] - x[n0], x[n2] - x[n1]))
        te, tf = (x[n1] - x[n0]) / le, (x[n2] - x[n1]) / lf
        ms = (m1[e], m1[f]), (np.cross(te, m1[e]), np.cross(tf, m1[f]))
        d1, d2 = ms[0][0] + ms[0][1], ms[1][0] + ms[1][1]
        chi = 1 + np.sum(te * tf, axis=1, keepdims=True)
        kb, t = 2 * np.cross(te, tf) / chi, (te + tf) / chi
        strains, slopes = np.empty((3, len(e))), np.empty((3, len(e), 2, 4))
        for k, (d, sign, other) in enumerate(((d2, 1, 0), (d1, -1, 1))):
            strains[k] = 0.5 * sign * np.sum(kb * d, axis=1)
            slopes[k, :, 0, :3] = (-strains[k, :, None] * t + sign * np.cross(tf, d / chi)) / le
            slopes[k, :, 1, :3] = (-strains[k, :, None] * t - sign * np.cross(te, d / chi)) / lf
            for side in range(2):
                slopes[k, :, side, 3] = -0.5 * signs[:, side] * np.sum(kb * ms[other][side], axis=1)
        here = transport(m1[e], te, tf)
        strains[2] = np.arctan2(np.sum(np.cross(here, m1[f]) * tf, axis=1), np.sum(here * m1[f], axis=1))
        slopes[2, :, 0, :3], slopes[2, :, 1, :3] = kb / (2 * le), kb / (2 * lf)
        slopes[2, :, :, 3] = signs * [-1, 1]
        return strains, slopes

    def _strain_matrix(self, x: Array, slopes: Array) -> csr_array:
        """Return (M + 3S, 3N + M): how stretch, curvatures and twist change with positions and spins."""
        m, s, at = len(self.edges), len(self.springs.edges), 3 * np.arange(len(x))[:, None] + np.arange(3)
        n0, n1, n2 = self.springs.nodes.T
        spins = 3 * len(x) + self.springs.edges
        t, r = self.tangents(x), np.arange(m)
        entries = [(r, at[self.edges[:, 1]], t), (r, at[self.edges[:, 0]], -t)]
        for k in range(3):
            r, (e, f) = m + s * k + np.arange(s), (slopes[k, :, 0, :3], slopes[k, :, 1, :3])
            entries += [(r, at[n0], -e), (r, at[n1], e - f), (r, at[n2], f), (r, spins, slopes[k, :, :, 3])]
        rows = np.concatenate([np.repeat(r, c.shape[1]) for r, c, _ in entries])
        columns, values = (np.concatenate([entry[i].ravel() for entry in entries]) for i in (1, 2))
        return coo_array((values, (rows, columns)), shape=(m + 3 * s, 3 * len(x) + m)).tocsr()

    def _forces(self, x: Array, m1: Array) -> tuple[Array, csr_array]:
        """Return the elastic gradient (3N + M,) and the stiffness without its small stress part."""
        strains, slopes = self._strains(x, m1)
        stretched = np.linalg.norm(x[self.edges[:, 1]] - x[self.edges[:, 0]], axis=1) - self.length
        change = strains - self.natural
        change[2] -= 2 * np.pi * np.round(change[2] / (2 * np.pi))
        weight = np.concatenate([self.stretch, self.bend, self.bend, self.twist])
        B = self._strain_matrix(x, slopes)
        return B.T @ (weight * np.concatenate([stretched, *change])), B.T @ (diags_array(weight) @ B)

    def _free(self, held: NDArray[Any]) -> NDArray[np.bool_]:
        """Return (3N + M,): positions of nodes that are not held, spins (if edges turn) but those at the root."""
        loose = ~np.isin(np.arange(len(self.rest)), held)
        spins = loose[self.edges].any(axis=1) & (self.edges != 0).all(axis=1)
        return np.concatenate([np.repeat(loose, 3), spins & self.turning])

    def simulate(
        self, fixed: NDArray[Any], shake: Shake, duration: float, dt: float, *, tolerance: float = 1e-5
    ) -> Array:
        """Return (T, N, 3) positions [m] by implicit Euler, the grip moved before each step as the peer does.

        Raises:
            ArithmeticError: a step's residual stays above the tolerance [N].
        """
        n, free = 3 * len(self.rest), self._free(np.array([*fixed, shake.grip]))
        mass = np.concatenate([np.repeat(self.mass, 3), np.zeros(len(self.edges))])
        drag, weight = self.drag * (mass > 0), np.zeros(len(mass))
        weight[:n] = np.outer(self.mass, GRAVITY).ravel()
        x, v, m1, out = self.rest.copy(), np.zeros(len(mass)), self.m1, [self.rest]
        for step in range(1, round(duration / dt) + 1):
            old, moved = x.copy(), np.zeros(len(mass))
            phase = 2 * np.pi * shake.frequency * step * dt
            old[shake.grip, 0] = self.rest[shake.grip, 0] + shake.amplitude * np.sin(phase)
            for _ in range(ITERATIONS):
                new = old + moved[:n].reshape(-1, 3)
                carried = self.carried(m1, old, new, moved[n:])
                gradient, stiffness = self._forces(new, carried)
                residual = (mass * (moved / dt - v) / dt + gradient - weight + drag * moved / dt)[free]
                if np.linalg.norm(residual) < tolerance:
                    break
                matrix = stiffness + diags_array(mass / dt**2 + drag / dt)
                moved[free] -= spsolve(matrix[free][:, free].tocsc(), residual)
            else:
                raise ArithmeticError(f"step {step}: Newton's method does not converge")
            x, v, m1 = new, moved / dt, carried
            out.append(x)
        return np.array(out)


def transport(m: Array, start: Array, end: Array) -> Array:
    """Return vectors m (K, 3) turned by the smallest rotations that take the unit tangents `start` to `end`."""
    axis, cosine = np.cross(start, end), np.sum(start * end, axis=1, keepdims=True)
    return cosine * m + np.cross(axis, m) + np.sum(axis * m, axis=1, keepdims=True) / (1 + cosine) * axis


def _springs(edges: NDArray[Any], siblings: bool) -> Springs:
    """Join all pairs of edges at each node; without siblings only those with the edge that leads to node 0."""
    pairs, signs, nodes = [], [], []
    rootward = _rootward_edges(edges)
    for node in range(int(edges.max()) + 1):
        for e, f in combinations(np.flatnonzero((edges == node).any(axis=1)), 2):
            if not siblings and node > 0 and rootward[node] not in (e, f):
                continue
            a, b = (f, e) if edges[f, 1] == node != edges[e, 1] else (e, f)
            sa, sb = 1.0 if edges[a, 1] == node else -1.0, -1.0 if edges[b, 1] == node else 1.0
            pairs.append((a, b))
            signs.append((sa, sb))
            nodes.append((edges[a].sum() - node, node, edges[b].sum() - node))
    return Springs(np.array(pairs), np.array(signs), np.array(nodes))


def _rootward_edges(edges: NDArray[Any]) -> dict[int, int]:
    """Return for every node but 0 the edge that leads to node 0."""
    out, queue = {}, deque([0])
    while queue:
        node = queue.popleft()
        for k in np.flatnonzero((edges == node).any(axis=1)):
            other = int(edges[k].sum() - node)
            if other != 0 and other not in out:
                out[other] = int(k)
                queue.append(other)
    return out


def _rest_directors(t: Array, edges: NDArray[Any], springs: Springs, directors: str) -> Array:
    m1 = np.zeros_like(t)
    side = np.cross(t[0], [0, 1, 0])
    side = side if np.linalg.norm(side) > 1e-9 else np.cross(t[0], [0, 0, -1])
    m1[0] = side / np.linalg.norm(side)
    ways = [(k - 1, k, 1.0, 1.0) for k in range(1, len(t))] if directors == "edge number" else _outward(edges, springs)
    for a, b, sa, sb in ways:
        m1[b] = transport(m1[a][None], sa * t[a][None], sb * t[b][None])[0]
    return m1


def _outward(edges: NDArray[Any], springs: Springs) -> list[tuple[int, int, float, float]]:
    """Return (from edge, to edge, their signs) breadth first from edge 0."""
    seen, queue, ways = {0}, deque([0]), []
    while queue:
        here = queue.popleft()
        for (e, f), (se, sf) in zip(springs.edges, springs.signs, strict=True):
            for a, b, sa, sb in ((e, f, se, sf), (f, e, -sf, -se)):
                if a == here and b not in seen:
                    seen.add(b)
                    queue.append(b)
                    ways.append((int(a), int(b), float(sa), float(sb)))
    return ways
