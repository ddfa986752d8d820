"""Energy, gradient and tree-structured Hessian of all springs, in walks over the edges.

Springs see edges: x_j = x_parent + d_j. The matrix is gathered in the unknowns (d_j, spin_j), where a joint couples an
edge with the near one alone; `on_nodes` turns it into that in node positions, which masses and drag want. By edges the
matrix of a line of N edges has the condition number of N^2, by nodes that of N^4: there doubles leave nothing of the
lowest modes of some thousand nodes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.rods import _springs
from anther.rods._model import Frames, Model, joint_ends
from anther.rods._rods import Array
from anther.rods._vectors import (
    LANES,
    apart,
    compiled,
    dot,
    filled,
    get,
    get3,
    halves,
    inlined,
    load,
    norm,
    put,
    put3,
    put6,
    six,
    store,
    subtract,
    twist_angle,
)


class Blocks(NamedTuple):
    """The tree-structured symmetric matrix and a right-hand side; of `diagonal` only the upper triangles are used."""

    diagonal: NDArray[Any]  # (N, 4, 4) block (j, j)
    near: NDArray[Any]  # (N, 4, 4) block (j, near[j])
    far: NDArray[Any]  # (N, 4, 4) block (j, far[j]), 0 by edges; no spring reaches the spin of the far edge
    gradient: NDArray[Any]  # (N, 4)
    lanes: Array  # scratch


def new_blocks(n: int, dtype: Any = np.float64) -> Blocks:
    """Return zeroed storage for N nodes."""
    diagonal, near, far = np.zeros((3, n, 4, 4), dtype)
    return Blocks(diagonal, near, far, np.zeros((n, 4), dtype), new_lanes())


def new_lanes() -> Array:
    """Return an empty buffer for the springs' lanes."""
    return np.zeros((_springs.MOMENT_F + 1) * LANES)  # the last row


@compiled
def move_frames(model: Model, x_old: Any, m1_old: Any, x: Any, turn: Any, m1: Any, buffer: Any) -> None:
    """Carry the directors m1_old from positions x_old to x, turn edge j by turn[j] (Cayley, `spin`), into m1."""
    parent = model.parent
    for first in range(1, len(x), LANES):
        count = filled(len(x), first)
        for i in range(count):
            j = first + i
            p = parent[j]
            put3(buffer, _springs.OLD_EDGE, i, apart(x_old, j, p))
            put3(buffer, _springs.NEW_EDGE, i, apart(x, j, p))
            put3(buffer, _springs.OLD_DIRECTOR, i, load(m1_old, j))
            put(buffer, _springs.TURN, i, turn[j])
        _springs.frame_lanes(buffer)
        for i in range(count):
            store(m1, first + i, get3(buffer, _springs.NEW_DIRECTOR, i))


@compiled
def elastic_energy(model: Model, x: Any, frames: Frames) -> float:
    """Return the stored elastic energy [J]."""
    total, m1 = 0.0, frames.m1
    for j in range(1, len(x)):
        strain = norm(apart(x, j, model.parent[j])) / model.length[j] - 1
        total += 0.5 * model.stretch[j] * model.length[j] * strain * strain
        if model.joint[j, 0] > 0:
            e, m1e, f = joint_ends(model, x, m1, j)
            k1, k2, tau = _springs.strains(_springs.bent(e, f), m1e, load(m1, j), frames.twist[j])
            k1, k2 = k1 - model.curvature[j, 0], k2 - model.curvature[j, 1]
            tau = tau - model.natural_twist[j]
            s1, s2, s3 = _springs.moments(six(model.joint, j), (k1, k2, tau))
            total += 0.5 * (s1 * k1 + s2 * k2 + s3 * tau)
    supports, turning = model.supports, model.turning
    for k in range(len(supports)):
        away = subtract(load(x, np.int64(supports[k, 0])), _three(supports, k, 1))
        if dot(_three(supports, k, 10), away) < supports[k, 13]:
            total += 0.5 * dot(away, _springs.moments(_six(supports, k, 4), away))
    for k in range(len(turning)):
        j = np.int64(turning[k, 0])
        f, W = apart(x, j, model.parent[j]), _six(turning, k, 7)
        turned = _springs.strains(_springs.bent(_three(turning, k, 1), f), _three(turning, k, 4), load(m1, j), 0.0)
        total += 0.5 * dot(turned, _springs.moments(W, turned))
    return total


def assemble(model: Model, x_start: Any, x: Any, frames: Frames, velocity: Any, rate: float, blocks: Blocks) -> None:
    """Fill blocks with the gradient (minus the force) and Hessian by nodes; arguments as of `assemble_edges`."""
    assemble_edges(model, x_start, x, frames, velocity, rate, blocks)
    on_nodes(model.order, model.parent, model.near, model.far, model.swapped, blocks)
    add_supports(model.supports, x, blocks)


@compiled
def add_supports(supports: Any, x: Any, blocks: Blocks) -> None:
    """Add the supports that draw nodes back to their places to gradient and matrix by nodes."""
    D, g = blocks.diagonal, blocks.gradient
    for k in range(len(supports)):
        j = np.int64(supports[k, 0])
        away, K = subtract(load(x, j), _three(supports, k, 1)), _six(supports, k, 4)
        if dot(_three(supports, k, 10), away) >= supports[k, 13]:  # one-sided, and open
            continue
        force = _springs.moments(K, away)
        for i in range(3):
            g[j, i] += force[i]
        D[j, 0, 0], D[j, 0, 1], D[j, 1, 1] = D[j, 0, 0] + K[0], D[j, 0, 1] + K[1], D[j, 1, 1] + K[2]
        D[j, 0, 2], D[j, 1, 2], D[j, 2, 2] = D[j, 0, 2] + K[3], D[j, 1, 2] + K[4], D[j, 2, 2] + K[5]


@inlined
def _three(rows: Any, k: Any, first: Any) -> Any:
    return rows[k, first], rows[k, first + 1], rows[k, first + 2]


@inlined
def _six(rows: Any, k: Any, first: Any) -> Any:
    return (
        rows[k, first],
        rows[k, first + 1],
        rows[k, first + 2],
        rows[k, first + 3],
        rows[k, first + 4],
        rows[k, first + 5],
    )


@inlined
def _add_turning_supports(model: Model, x: Any, m1: Any, blocks: Blocks) -> None:
    """Add the springs that hold the direction of edges to gradient and matrix by edges: each as a soil of its own."""
    turning, parent, b = model.turning, model.parent, blocks.lanes
    D, g, still = blocks.diagonal, blocks.gradient, (0.0, 0.0, 0.0)
    for first in range(0, len(turning), LANES):
        count = filled(len(turning), first)
        for i in range(count):
            k = first + i
            j = np.int64(turning[k, 0])
            edge = apart(x, j, parent[j])
            put3(b, _springs.EDGE_E, i, _three(turning, k, 1))
            put3(b, _springs.EDGE_F, i, edge)
            put3(b, _springs.DIRECTOR_E, i, _three(turning, k, 4))
            put3(b, _springs.DIRECTOR_F, i, load(m1, j))
            put3(b, _springs.SPEED_E, i, still)
            put3(b, _springs.SPEED_F, i, still)
            put3(b, _springs.SPIN_E, i, still)
            put6(b, _springs.JOINT, i, _six(turning, k, 7))
            put3(b, _springs.START_F, i, edge)
            put3(b, _springs.VISCOUS, i, still)
            put3(b, _springs.NATURAL_TWIST, i, (0.0, 0.0, 1.0))
        _springs.twist_lanes(b)
        for i in range(count):
            put(b, _springs.TWIST, i, twist_angle(get(b, _springs.SINE, i), get(b, _springs.COSINE, i), 0.0))
        _springs.spring_lanes(b, 0.0)
        for i in range(count):
            j = np.int64(turning[first + i, 0])
            low, high = get3(b, _springs.FF, i), get3(b, _springs.FF + 3, i)
            D[j, 0, 0], D[j, 0, 1], D[j, 1, 1] = D[j, 0, 0] + low[0], D[j, 0, 1] + low[1], D[j, 1, 1] + low[2]
            D[j, 0, 2], D[j, 1, 2], D[j, 2, 2] = D[j, 0, 2] + high[0], D[j, 1, 2] + high[1], D[j, 2, 2] + high[2]
            g[j, 3] += get(b, _springs.MOMENT_F, i)
            D[j, 3, 3] += get3(b, _springs.SPINS, i)[2]
            for r in range(3):
                g[j, r] += get(b, _springs.FORCE_F + r, i)
                D[j, r, 3] += get(b, _springs.SPIN_F_F + r, i)


@compiled
def assemble_edges(
    model: Model, x_start: Any, x: Any, frames: Frames, velocity: Any, rate: float, blocks: Blocks
) -> None:
    """Fill blocks with the elastic and viscous gradient (minus the force) and Hessian by edges.

    Args:
        model: constants.
        x_start: (N, 3) positions [m] at the start of a midpoint step; x itself otherwise. See `springs.stretched`.
        x: (N, 3) positions [m].
        frames: directors at x; each twist becomes that at x, on the branch nearest to the one given.
        velocity: (N, 4) node velocity [m/s] and edge spin rate [rad/s].
        rate: d velocity / d position of the time step [1/s]; 0 for statics.
        blocks: diagonal, near and gradient are filled anew.
    """
    order, near, far, swapped = model.order, model.near, model.far, model.swapped
    D, U, g, b = blocks.diagonal, blocks.near, blocks.gradient, blocks.lanes
    n = len(x)
    g[0] = 0
    _clear(D, 0)
    for first in range(1, n, LANES):
        count = filled(n, first)
        _gather_springs(model, x_start, x, frames, velocity, b, first, count)
        _springs.spring_lanes(b, rate)
        for i in range(count):
            j = order[n - 1 - first - i]
            _set_own(D, g, b, j, i)
            if far[j] >= 0:
                _add_near(D, U, g, b, j, near[j], -1.0 if swapped[j] else 1.0, i)
            else:
                _clear(U, j)
    _add_turning_supports(model, x, frames.m1, blocks)


@compiled
def on_nodes(order: Any, parent: Any, near: Any, far: Any, swapped: Any, blocks: Blocks) -> None:
    """Turn a gradient and a matrix by edges into those by nodes: d_j = x_j - x_parent."""
    D, U, V, g = blocks.diagonal, blocks.near, blocks.far, blocks.gradient
    for k in range(len(order) - 2, -1, -1):  # from the root outward: what is added to has been turned
        j = order[k]
        m, a, o = parent[j], near[j], far[j]
        for i in range(3):
            g[m, i] -= g[j, i]
            for c in range(i, 3):
                D[m, i, c] += D[j, i, c]
        between = U  # the block of edge j with the node m
        if o >= 0:
            _couple_nodes(D, U, V, j, m, a, swapped[j], near[a] == o)
            between = V if swapped[j] else U
        for i in range(4):
            for c in range(3):
                between[j, i, c] -= D[j, i, c] if i < c else D[j, c, i]


@inlined
def _couple_nodes(D: Any, U: Any, V: Any, j: Any, m: Any, a: Any, swapped: Any, consecutive: Any) -> None:
    """Turn the coupling of edge j with the near one into couplings of nodes; m is where they meet."""
    sign = 1.0 if swapped else -1.0
    for i in range(4):
        for c in range(3):
            V[j, i, c] = -U[j, i, c]
    for i in range(3):
        for c in range(i, 3):
            D[m, i, c] += sign * (U[j, i, c] + U[j, c, i])
    if swapped:  # node a is the hub, node m the root
        for i in range(3):
            U[a, 3, i] -= U[j, i, 3]
            for c in range(3):
                U[a, c, i] -= U[j, i, c]
        return
    beyond = U if consecutive else V  # of node m with the node before that of edge m
    for i in range(3):
        D[m, i, 3] -= U[j, i, 3]
        for c in range(3):
            beyond[m, i, c] += U[j, i, c]


@inlined
def _gather_springs(
    model: Model, x_start: Any, x: Any, frames: Frames, velocity: Any, b: Any, first: int, count: int
) -> None:
    """Write the input of `count` springs, counted from the root outward, into the lanes, and their present twist."""
    order, parent, near, far = model.order, model.parent, model.near, model.far  # unpacked: it is faster
    swapped, joint, viscous, stretch, length = model.swapped, model.joint, model.viscous, model.stretch, model.length
    curvature, natural_twist, soil = model.curvature, model.natural_twist, model.soil
    m1, twist, n = frames.m1, frames.twist, len(x)
    for i in range(count):
        j = order[n - 1 - first - i]  # from the root outward, so that a block is written before it is added to
        m, a, o = parent[j], near[j], far[j]
        start, end, edge, sign = o, m, a, 1.0
        if o < 0:  # joined to the soil, or, where there is none, to itself with stiffness 0
            start, end, edge = m, j, j
        elif swapped[j]:  # from the hub back to the root: the hub edge reversed
            start, end, sign = a, m, -1.0
        _gather(x, m1, velocity, b, j, m, start, end, edge, sign, i)
        if o < 0 and joint[j, 0] > 0:
            _gather_soil(soil, b, j, i)
        put6(b, _springs.JOINT, i, six(joint, j))
        put3(b, _springs.START_F, i, apart(x_start, j, m))
        put3(b, _springs.VISCOUS, i, (viscous[j], curvature[j, 0], curvature[j, 1]))
        put3(b, _springs.NATURAL_TWIST, i, (natural_twist[j], stretch[j], length[j]))
    _springs.twist_lanes(b)
    for i in range(count):
        j = order[n - 1 - first - i]
        twist[j] = twist_angle(get(b, _springs.SINE, i), get(b, _springs.COSINE, i), twist[j])
        put(b, _springs.TWIST, i, twist[j])


@inlined
def _gather(
    x: Any, m1: Any, velocity: Any, b: Any, j: Any, m: Any, start: Any, end: Any, edge: Any, sign: float, i: int
) -> None:
    """Write edge e (from node start to end, director and spin of the given edge) and edge f (m to j) into lane i."""
    put3(b, _springs.EDGE_E, i, apart(x, end, start))
    put3(b, _springs.EDGE_F, i, apart(x, j, m))
    put3(b, _springs.DIRECTOR_E, i, load(m1, edge))
    put3(b, _springs.DIRECTOR_F, i, load(m1, j))
    put3(b, _springs.SPEED_E, i, apart(velocity, end, start))
    put3(b, _springs.SPEED_F, i, apart(velocity, j, m))
    put(b, _springs.SPIN_E, i, sign * velocity[edge, 3])
    put(b, _springs.SPIN_F, i, velocity[j, 3])


@inlined
def _gather_soil(soil: Any, b: Any, j: Any, i: int) -> None:
    """Write the soil, which stands still or turns, as edge e into lane i."""
    edge, director = halves(soil, j)
    put3(b, _springs.EDGE_E, i, edge)
    put3(b, _springs.DIRECTOR_E, i, director)
    put3(b, _springs.SPEED_E, i, (soil[j, 6], soil[j, 7], soil[j, 8]))
    put(b, _springs.SPIN_E, i, soil[j, 9])


@inlined
def _clear(A: Any, j: Any) -> None:
    for r in range(4):
        for c in range(4):
            A[j, r, c] = 0


@inlined
def _set_own(D: Any, g: Any, b: Any, j: Any, i: int) -> None:
    """Begin row j with what its own spring gives."""
    f, turn, spins = get3(b, _springs.FORCE_F, i), get3(b, _springs.SPIN_F_F, i), get3(b, _springs.SPINS, i)
    g[j, 0], g[j, 1], g[j, 2], g[j, 3] = f[0], f[1], f[2], get(b, _springs.MOMENT_F, i)
    D[j, 0, 0], D[j, 0, 1], D[j, 1, 1] = get3(b, _springs.FF, i)
    D[j, 0, 2], D[j, 1, 2], D[j, 2, 2] = get3(b, _springs.FF + 3, i)
    D[j, 0, 3], D[j, 1, 3], D[j, 2, 3] = turn
    D[j, 3, 3] = spins[2]


@inlined
def _add_near(D: Any, U: Any, g: Any, b: Any, j: Any, a: Any, sign: float, i: int) -> None:
    """Add what the joint of edge j does to edge a, which runs towards it (sign 1) or, at the root, away (-1)."""
    spins = get3(b, _springs.SPINS, i)
    for r in range(3):
        g[a, r] += sign * get(b, _springs.FORCE_E + r, i)
        D[a, r, 3] += get(b, _springs.SPIN_E_E + r, i)
        U[j, r, 3] = sign * get(b, _springs.SPIN_E_F + r, i)
        U[j, 3, r] = sign * get(b, _springs.SPIN_F_E + r, i)
        for c in range(3):
            U[j, r, c] = sign * get(b, _springs.FE + 3 * r + c, i)
    e, f = get3(b, _springs.EE, i), get3(b, _springs.EE + 3, i)
    D[a, 0, 0] += e[0]
    D[a, 0, 1] += e[1]
    D[a, 1, 1] += e[2]
    D[a, 0, 2] += f[0]
    D[a, 1, 2] += f[1]
    D[a, 2, 2] += f[2]
    g[a, 3] += sign * get(b, _springs.MOMENT_E, i)
    D[a, 3, 3] += spins[0]
    U[j, 3, 3] = sign * spins[1]
