"""Energy, gradient and tree-structured Hessian of all springs, in walks over the edges."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.elastic_rod import _lanes as lanes
from anther.elastic_rod import _springs
from anther.elastic_rod._lanes import LANES, get, get3, new_lanes, put, put3, put6
from anther.elastic_rod._model import Frames, Model, spring_edges
from anther.elastic_rod._rods import Array
from anther.elastic_rod._vectors import compiled, halves, load, merged, norm, six, store, subtract, twist_angle


class Blocks(NamedTuple):
    """The tree-structured symmetric matrix and a right-hand side; of `diagonal` only the upper triangles are used."""

    diagonal: NDArray[Any]  # (N, 4, 4) block (j, j)
    near: NDArray[Any]  # (N, 4, 4) block (j, near[j])
    far: NDArray[Any]  # (N, 4, 4) block (j, far[j]); its last column is 0: no spring reaches the spin of the far edge
    gradient: NDArray[Any]  # (N, 4)
    lanes: Array  # scratch


def new_blocks(n: int, dtype: Any = np.float64) -> Blocks:
    """Return zeroed storage for N nodes."""
    diagonal, near, far = np.zeros((3, n, 4, 4), dtype)
    return Blocks(diagonal, near, far, np.zeros((n, 4), dtype), new_lanes())


@compiled
def move_frames(model: Model, x_old: Any, m1_old: Any, x: Any, turn: Any, m1: Any, buffer: Any) -> None:
    """Carry the directors m1_old from positions x_old to x, turn edge j by turn[j] (Cayley, `spin`), into m1."""
    parent = model.parent
    for first in range(1, len(x), LANES):
        count = min(LANES, len(x) - first)
        for i in range(count):
            j = first + i
            p = parent[j]
            put3(buffer, lanes.OLD_EDGE, i, subtract(load(x_old, j), load(x_old, p)))
            put3(buffer, lanes.NEW_EDGE, i, subtract(load(x, j), load(x, p)))
            put3(buffer, lanes.OLD_DIRECTOR, i, load(m1_old, j))
            put(buffer, lanes.TURN, i, turn[j])
        _springs.frame_lanes(buffer)
        for i in range(count):
            store(m1, first + i, get3(buffer, lanes.NEW_DIRECTOR, i))


@compiled
def elastic_energy(model: Model, x: Any, frames: Frames) -> float:
    """Return the stored elastic energy [J]."""
    total, m1 = 0.0, frames.m1
    for j in range(1, len(x)):
        f = subtract(load(x, j), load(x, model.parent[j]))
        strain = norm(f) / model.length[j] - 1
        total += 0.5 * model.stretch[j] * model.length[j] * strain * strain
        if model.joint[j, 0] > 0:
            if model.far[j] >= 0:
                e, f = spring_edges(x, model.parent, model.near, model.far, model.swapped, j)
                m1e = load(m1, model.near[j])
            else:
                e, m1e = halves(model.soil, j)
            b, m1f = _springs.bent(e, f), load(m1, j)
            k1, k2 = _springs.curvatures(b, m1e, m1f)
            sine, cosine = _springs.twist_parts(b, m1e, m1f)
            k1, k2 = k1 - model.curvature[j, 0], k2 - model.curvature[j, 1]
            tau = twist_angle(sine, cosine, frames.twist[j]) - model.natural_twist[j]
            s1, s2, s3 = _springs.moments(six(model.joint, j), (k1, k2, tau))
            total += 0.5 * (s1 * k1 + s2 * k2 + s3 * tau)
    return total


@compiled
def assemble(model: Model, x_start: Any, x: Any, frames: Frames, velocity: Any, rate: float, blocks: Blocks) -> None:
    """Fill blocks with the elastic and viscous gradient (minus the force) and Hessian.

    Args:
        model: constants.
        x_start: (N, 3) positions [m] at the start of a midpoint step; x itself otherwise. See `springs.stretched`.
        x: (N, 3) positions [m].
        frames: directors at x; each twist becomes that at x, on the branch nearest to the one given.
        velocity: (N, 4) node velocity [m/s] and edge spin rate [rad/s].
        rate: d velocity / d position of the time step [1/s]; 0 for statics.
        blocks: filled anew.
    """
    order, parent, near, far, swapped = model.order, model.parent, model.near, model.far, model.swapped
    D, U, V, g, b = blocks.diagonal, blocks.near, blocks.far, blocks.gradient, blocks.lanes
    n = len(x)
    _clear(D, g, 0)
    for first in range(1, n, LANES):
        count = min(LANES, n - first)
        gather_springs(model, x_start, x, frames, velocity, b, first, count)
        _springs.spring_lanes(b, rate)
        for i in range(count):
            j = order[n - 1 - first - i]
            m, a, o = parent[j], near[j], far[j]
            _set_own(D, g, b, j, i)
            _add_symmetric(D, m, b, lanes.MM, i)
            _add_vector(g, m, b, lanes.FORCE_M, i)
            if o >= 0 and swapped[j]:  # node o is the hub, node m the root; the hub's edge runs the other way
                _set_joint(U, V, b, j, lanes.JO, lanes.JM, lanes.TURN_J_O, lanes.TURN_J_M, -1.0, i)
                _add_outer(D, g, b, a, i)
                _add_turn(D, g, b, a, lanes.TURN_M_O, -1.0, i)
                _add_transposed(U, a, b, lanes.MO, i)
                _add_row(U, a, -1.0, b, lanes.TURN_M_M, i)
                continue
            _set_joint(U, V, b, j, lanes.JM, lanes.JO, lanes.TURN_J_M, lanes.TURN_J_O, 1.0, i)
            if o < 0:
                continue
            _add_outer(D, g, b, o, i)
            _add_turn(D, g, b, a, lanes.TURN_M_M, 1.0, i)
            if near[a] == o:
                _add_matrix(U, a, b, lanes.MO, i)
                _add_row(U, a, 1.0, b, lanes.TURN_M_O, i)
            else:
                _add_matrix(V, a, b, lanes.MO, i)
                _add_row(V, a, 1.0, b, lanes.TURN_M_O, i)


@merged
def gather_springs(
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
        if o < 0:  # joined to the soil, or, where there is none, to itself with stiffness 0
            _gather(x, m1, velocity, b, j, m, m, j, j, 1.0, i)
            if joint[j, 0] > 0:
                _gather_soil(soil, b, j, i)
        elif swapped[j]:  # from the hub back to the root: the hub edge reversed
            _gather(x, m1, velocity, b, j, m, a, m, a, -1.0, i)
        else:
            _gather(x, m1, velocity, b, j, m, o, m, a, 1.0, i)
        put6(b, lanes.JOINT, i, six(joint, j))
        put3(b, lanes.START_J, i, subtract(load(x_start, j), load(x_start, m)))
        put3(b, lanes.VISCOUS, i, (viscous[j], curvature[j, 0], curvature[j, 1]))
        put3(b, lanes.NATURAL_TWIST, i, (natural_twist[j], stretch[j], length[j]))
    _springs.twist_lanes(b)
    for i in range(count):
        j = order[n - 1 - first - i]
        twist[j] = twist_angle(get(b, lanes.SINE, i), get(b, lanes.COSINE, i), twist[j])
        put(b, lanes.TWIST, i, twist[j])


@merged
def _clear(D: Any, g: Any, j: Any) -> None:
    for i in range(4):
        g[j, i] = 0
        for k in range(4):
            D[j, i, k] = 0


@merged
def _gather(
    x: Any, m1: Any, velocity: Any, b: Any, j: Any, m: Any, start: Any, end: Any, edge: Any, sign: float, i: int
) -> None:
    """Write edge m (from node start to end, director and spin of the given edge) and edge j (m to j) into lane i."""
    put3(b, lanes.EDGE_M, i, subtract(load(x, end), load(x, start)))
    put3(b, lanes.EDGE_J, i, subtract(load(x, j), load(x, m)))
    put3(b, lanes.DIRECTOR_M, i, load(m1, edge))
    put3(b, lanes.DIRECTOR_J, i, load(m1, j))
    put3(b, lanes.SPEED_M, i, subtract(load(velocity, end), load(velocity, start)))
    put3(b, lanes.SPEED_J, i, subtract(load(velocity, j), load(velocity, m)))
    put(b, lanes.SPIN_M, i, sign * velocity[edge, 3])
    put(b, lanes.SPIN_J, i, velocity[j, 3])


@merged
def _gather_soil(soil: Any, b: Any, j: Any, i: int) -> None:
    """Write the soil, which neither moves nor turns, as edge m into lane i."""
    edge, director = halves(soil, j)
    put3(b, lanes.EDGE_M, i, edge)
    put3(b, lanes.DIRECTOR_M, i, director)
    put3(b, lanes.SPEED_M, i, (0.0, 0.0, 0.0))
    put(b, lanes.SPIN_M, i, 0.0)


@merged
def _set_own(D: Any, g: Any, b: Any, j: Any, i: int) -> None:
    """Begin row j with what its own spring gives."""
    f, turn = get3(b, lanes.FORCE_J, i), get3(b, lanes.TURN_J_J, i)
    g[j, 0], g[j, 1], g[j, 2], g[j, 3] = f[0], f[1], f[2], get(b, lanes.MOMENT_J, i)
    D[j, 0, 0], D[j, 0, 1], D[j, 1, 1] = get3(b, lanes.JJ, i)
    D[j, 0, 2], D[j, 1, 2], D[j, 2, 2] = get3(b, lanes.JJ + 3, i)
    D[j, 0, 3], D[j, 1, 3], D[j, 2, 3] = turn
    D[j, 3, 3] = get(b, lanes.TURN_JJ, i)


@merged
def _set_joint(
    U: Any, V: Any, b: Any, j: Any, near: int, far: int, turn_near: int, turn_far: int, sign: float, i: int
) -> None:
    """Write the couplings of row j with its near row, spin included, and its far row."""
    column = get3(b, lanes.TURN_M_J, i)
    U[j, 0, 0], U[j, 0, 1], U[j, 0, 2] = get3(b, near, i)
    U[j, 1, 0], U[j, 1, 1], U[j, 1, 2] = get3(b, near + 3, i)
    U[j, 2, 0], U[j, 2, 1], U[j, 2, 2] = get3(b, near + 6, i)
    U[j, 3, 0], U[j, 3, 1], U[j, 3, 2] = get3(b, turn_near, i)
    U[j, 0, 3], U[j, 1, 3], U[j, 2, 3] = sign * column[0], sign * column[1], sign * column[2]
    U[j, 3, 3] = sign * get(b, lanes.TURN_MJ, i)
    V[j, 0, 0], V[j, 0, 1], V[j, 0, 2] = get3(b, far, i)
    V[j, 1, 0], V[j, 1, 1], V[j, 1, 2] = get3(b, far + 3, i)
    V[j, 2, 0], V[j, 2, 1], V[j, 2, 2] = get3(b, far + 6, i)
    V[j, 3, 0], V[j, 3, 1], V[j, 3, 2] = get3(b, turn_far, i)


@merged
def _add_outer(D: Any, g: Any, b: Any, o: Any, i: int) -> None:
    """Add what the spring does to node o."""
    _add_vector(g, o, b, lanes.FORCE_O, i)
    _add_symmetric(D, o, b, lanes.OO, i)


@merged
def _add_turn(D: Any, g: Any, b: Any, a: Any, row: int, sign: float, i: int) -> None:
    """Add what the spring does to the spin of edge a, whose own node couples by `row`."""
    column = get3(b, row, i)
    g[a, 3] += sign * get(b, lanes.MOMENT_M, i)
    D[a, 0, 3] += sign * column[0]
    D[a, 1, 3] += sign * column[1]
    D[a, 2, 3] += sign * column[2]
    D[a, 3, 3] += get(b, lanes.TURN_MM, i)


@merged
def _add_vector(g: Any, j: Any, b: Any, row: int, i: int) -> None:
    v = get3(b, row, i)
    g[j, 0] += v[0]
    g[j, 1] += v[1]
    g[j, 2] += v[2]


@merged
def _add_symmetric(D: Any, j: Any, b: Any, row: int, i: int) -> None:
    D[j, 0, 0] += get(b, row, i)
    D[j, 0, 1] += get(b, row + 1, i)
    D[j, 1, 1] += get(b, row + 2, i)
    D[j, 0, 2] += get(b, row + 3, i)
    D[j, 1, 2] += get(b, row + 4, i)
    D[j, 2, 2] += get(b, row + 5, i)


@merged
def _add_matrix(A: Any, j: Any, b: Any, row: int, i: int) -> None:
    for r in range(3):
        for c in range(3):
            A[j, r, c] += get(b, row + 3 * r + c, i)


@merged
def _add_transposed(A: Any, j: Any, b: Any, row: int, i: int) -> None:
    for r in range(3):
        for c in range(3):
            A[j, c, r] += get(b, row + 3 * r + c, i)


@merged
def _add_row(A: Any, j: Any, sign: float, b: Any, row: int, i: int) -> None:
    """Add the coupling of spin j to the positions of another node."""
    for c in range(3):
        A[j, 3, c] += sign * get(b, row + c, i)
