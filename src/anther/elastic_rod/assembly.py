"""Energy, gradient and tree-structured Hessian of all springs, in one walk over the edges.

Stretch E = EA/2 eps^2 l (P18), bend and twist E = K/2 (strain - natural strain)^2 (P19, Bergou et al. 2010).
Kelvin-Voigt damping adds K * viscous_time * strain rate to each stress; strain rate = gradient . velocity.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.elastic_rod import springs
from anther.elastic_rod.model import Frames, Model, spring_edges
from anther.elastic_rod.rods import Array
from anther.elastic_rod.vectors import compiled, dot, load, norm, scale, spin, store, subtract, transport


class Blocks(NamedTuple):
    """The tree-structured symmetric matrix and a right-hand side; of `diagonal` only the lower triangles are used."""

    diagonal: NDArray[Any]  # (N, 4, 4) block (j, j)
    near: NDArray[Any]  # (N, 4, 4) block (j, near[j])
    far: NDArray[Any]  # (N, 4, 3) block (j, far[j]); no spring reaches the spin of the far edge
    gradient: NDArray[Any]  # (N, 4)
    local: Array  # (8, 8) scratch
    slopes: Array  # (3, 8) scratch


def new_blocks(n: int, dtype: Any = np.float64) -> Blocks:
    """Return zeroed storage for N nodes."""
    return Blocks(
        np.zeros((n, 4, 4), dtype),
        np.zeros((n, 4, 4), dtype),
        np.zeros((n, 4, 3), dtype),
        np.zeros((n, 4), dtype),
        np.zeros((8, 8)),
        np.zeros((3, 8)),
    )


@compiled
def move_frames(model: Model, x_old: Any, m1_old: Any, twist_old: Any, x: Any, turn: Any, m1: Any, twist: Any) -> None:
    """Carry the frames (m1_old, twist_old) from positions x_old to x, turn edge j by turn[j], into m1 and twist."""
    for j in range(1, len(x)):
        p = model.parent[j]
        old, new = subtract(load(x_old, j), load(x_old, p)), subtract(load(x, j), load(x, p))
        t_old, t_new = scale(1 / norm(old), old), scale(1 / norm(new), new)
        store(m1, j, spin(transport(load(m1_old, j), t_old, t_new), t_new, turn[j]))
    for j in range(1, len(x)):
        if model.far[j] >= 0:
            e, f = spring_edges(x, model.parent, model.near, model.far, model.swapped, j)
            m1e = load(m1, model.near[j])
            twist[j] = springs.strains(e, f, m1e, load(m1, j), twist_old[j])[2]


@compiled
def elastic_energy(model: Model, x: Any, m1: Any, twist: Any) -> float:
    """Return the stored elastic energy [J]."""
    total = 0.0
    for j in range(1, len(x)):
        f = subtract(load(x, j), load(x, model.parent[j]))
        strain = norm(f) / model.length[j] - 1
        total += 0.5 * model.stretch[j] * model.length[j] * strain * strain
        if model.far[j] >= 0:
            e, f = spring_edges(x, model.parent, model.near, model.far, model.swapped, j)
            k1, k2, tau = springs.strains(e, f, load(m1, model.near[j]), load(m1, j), twist[j])
            k1, k2 = k1 - model.curvature[j, 0], k2 - model.curvature[j, 1]
            tau -= model.natural_twist[j]
            total += 0.5 * model.bend[j] * (k1 * k1 + k2 * k2) + 0.5 * model.twist[j] * tau * tau
    return total


@compiled
def assemble(model: Model, x: Any, frames: Frames, velocity: Any, rate: float, blocks: Blocks) -> None:
    """Fill blocks with the elastic and viscous gradient (minus the force) and Hessian.

    Args:
        model: constants.
        x: (N, 3) positions [m].
        frames: material frames at x.
        velocity: (N, 4) node velocity [m/s] and edge spin rate [rad/s].
        rate: d velocity / d position of the time step [1/s]; 0 for statics.
        blocks: filled anew.
    """
    parent, near, far, swapped = model.parent, model.near, model.far, model.swapped  # unpacked once: it is faster
    EA, K, T, viscous = model.stretch, model.bend, model.twist, model.viscous
    length, curvature, natural_twist = model.length, model.curvature, model.natural_twist
    m1, twist = frames.m1, frames.twist
    D, U, V, g, H, G = blocks.diagonal, blocks.near, blocks.far, blocks.gradient, blocks.local, blocks.slopes
    D[:], U[:], V[:], g[:] = 0, 0, 0, 0
    for j in range(1, len(x)):
        p, a, b = parent[j], near[j], far[j]
        f = subtract(load(x, j), load(x, p))
        speed = dot(f, subtract(load(velocity, j), load(velocity, p))) / norm(f)
        _add_stretch(D, U, V, g, j, p, p == a, f, EA[j], length[j], speed, viscous[j], rate)
        if b < 0:
            continue
        e, f = spring_edges(x, parent, near, far, swapped, j)
        k1, k2, tau = springs.gradients(e, f, load(m1, a), load(m1, j), twist[j], G)
        s1, s2, s3 = k1 - curvature[j, 0], k2 - curvature[j, 1], tau - natural_twist[j]
        if viscous[j] > 0:
            r1, r2, r3 = strain_rates(velocity, parent[j], a, b, swapped[j], G, j)
            s1, s2, s3 = s1 + viscous[j] * r1, s2 + viscous[j] * r2, s3 + viscous[j] * r3
        stress, stiffer = (K[j] * s1, K[j] * s2, T[j] * s3), 1 + viscous[j] * rate
        springs.stiffness(G, (K[j] * stiffer, K[j] * stiffer, T[j] * stiffer), H)
        springs.add_geometric(e, f, load(m1, a), load(m1, j), stress, H)
        for i in range(8):
            G[0, i] = stress[0] * G[0, i] + stress[1] * G[1, i] + stress[2] * G[2, i]
            for k in range(i):
                H[k, i] = H[i, k]
        _scatter(D, U, V, g, G, H, j, a, b, near[a] == b, swapped[j])


@compiled
def _add_stretch(
    D: Any,
    U: Any,
    V: Any,
    g: Any,
    j: int,
    p: int,
    p_is_near: bool,
    f: Any,
    EA: float,
    natural: float,
    speed: float,
    viscous: float,
    rate: float,
) -> None:
    length = norm(f)
    t = scale(1 / length, f)
    tension = EA * (length / natural - 1 + viscous * speed / natural)
    along = EA * (1 + viscous * rate) / natural
    across = tension / length
    for i in range(3):
        g[j, i] += tension * t[i]
        g[p, i] -= tension * t[i]
        for k in range(3):
            value = (along - across) * t[i] * t[k] + (across if i == k else 0.0)
            D[j, i, k] += value
            D[p, i, k] += value
            if p_is_near:
                U[j, i, k] -= value
            else:
                V[j, i, k] -= value


@compiled
def strain_rates(velocity: Any, p: int, a: int, b: int, swapped: bool, G: Any, j: int) -> Any:
    """Return the rates of the strains of spring j, given their local gradients G and the velocities (N, 4)."""
    sign = -1.0 if swapped else 1.0
    r1 = r2 = r3 = 0.0
    for i in range(3):
        ve = sign * (velocity[a, i] - velocity[b, i])
        vf = velocity[j, i] - velocity[p, i]
        r1 += G[0, i] * ve + G[0, 3 + i] * vf
        r2 += G[1, i] * ve + G[1, 3 + i] * vf
        r3 += G[2, i] * ve + G[2, 3 + i] * vf
    we, wf = sign * velocity[a, 3], velocity[j, 3]
    return (
        r1 + G[0, 6] * we + G[0, 7] * wf,
        r2 + G[1, 6] * we + G[1, 7] * wf,
        r3 + G[2, 6] * we + G[2, 7] * wf,
    )


@compiled
def _scatter(
    D: Any, U: Any, V: Any, g: Any, G: Any, H: Any, j: int, a: int, b: int, b_is_near: bool, swapped: bool
) -> None:
    """Add a local gradient G[0] and Hessian H in (e, f, spin e, spin f) to the blocks of j, a = near and b = far.

    e = sign (x_a - x_b), spin e = sign spin_a, f = x_j - x_a, or x_j - x_b where swapped.
    """
    sign = -1.0 if swapped else 1.0
    fa, fb = (0.0, 1.0) if swapped else (1.0, 0.0)
    for i in range(3):
        g[j, i] += G[0, 3 + i]
        g[a, i] += sign * G[0, i] - fa * G[0, 3 + i]
        g[b, i] += -sign * G[0, i] - fb * G[0, 3 + i]
        for k in range(3):
            ee, ef, fe, ff = H[i, k], H[i, 3 + k], H[3 + i, k], H[3 + i, 3 + k]
            D[j, i, k] += ff
            D[a, i, k] += ee + fa * (ff - sign * (ef + fe))
            D[b, i, k] += ee + fb * (ff + sign * (ef + fe))
            U[j, i, k] += sign * fe - fa * ff
            V[j, i, k] += -sign * fe - fb * ff
            crossed = -ee - sign * fb * ef + sign * fa * fe  # fa fb = 0
            if b_is_near:
                U[a, i, k] += crossed
            else:
                V[a, i, k] += crossed
        U[j, i, 3] += sign * H[3 + i, 6]
        U[j, 3, i] += sign * H[7, i] - fa * H[7, 3 + i]
        V[j, 3, i] += -sign * H[7, i] - fb * H[7, 3 + i]
        D[j, 3, i] += H[7, 3 + i]
        D[a, 3, i] += H[6, i] - sign * fa * H[6, 3 + i]
        turn = -H[6, i] - sign * fb * H[6, 3 + i]
        if b_is_near:
            U[a, 3, i] += turn
        else:
            V[a, 3, i] += turn
    g[a, 3] += sign * G[0, 6]
    g[j, 3] += G[0, 7]
    U[j, 3, 3] += sign * H[7, 6]
    D[j, 3, 3] += H[7, 7]
    D[a, 3, 3] += H[6, 6]
