"""Bend and twist of one spring, between two edges e and f that meet at a node: strains, gradients, Hessian.

Discrete elastic rods (Bergou et al. 2008, 2010; curvatures as in the paper's row P19). The eight local variables
are the edge vectors e and f [m] and the spins of their material frames about their tangents [rad], in that order.
Derivatives are taken at the point where the frames are (a spin-free change of an edge carries its frame by
parallel transport), so that the Hessian is the symmetric one of an energy (as in Panetta et al. 2019, X-shells).
A material frame is its first director m1; the second is m2 = t x m1.
"""

from __future__ import annotations

from typing import Any

from anther.elastic_rod.vectors import Vector, add, combine, compiled, cross, dot, norm, scale, twist_angle


@compiled
def strains(e: Vector, f: Vector, m1e: Vector, m1f: Vector, twist: float) -> Vector:
    """Return (kappa1, kappa2, twist): integrated curvatures [-] and twist [rad], twist nearest to the given one."""
    te, tf = scale(1 / norm(e), e), scale(1 / norm(f), f)
    kb = scale(2 / (1 + dot(te, tf)), cross(te, tf))
    kappa1 = 0.5 * dot(add(cross(te, m1e), cross(tf, m1f)), kb)
    kappa2 = -0.5 * dot(add(m1e, m1f), kb)
    return kappa1, kappa2, twist_angle(m1e, m1f, te, tf, twist)


@compiled
def _put(row: Any, e_part: Vector, f_part: Vector, e_spin: float, f_spin: float) -> None:
    for i in range(3):
        row[i] = e_part[i]
        row[3 + i] = f_part[i]
    row[6] = e_spin
    row[7] = f_spin


@compiled
def gradients(e: Vector, f: Vector, m1e: Vector, m1f: Vector, twist: float, G: Any) -> Vector:
    """Fill G (3, 8) with the gradients of kappa1, kappa2 and twist; return the three strains."""
    le, lf = norm(e), norm(f)
    te, tf = scale(1 / le, e), scale(1 / lf, f)
    chi = 1 + dot(te, tf)
    kb = scale(2 / chi, cross(te, tf))
    tt = scale(1 / chi, add(te, tf))
    m2e, m2f = cross(te, m1e), cross(tf, m1f)
    m1, m2 = scale(1 / chi, add(m1e, m1f)), scale(1 / chi, add(m2e, m2f))
    kappa1, kappa2 = 0.5 * chi * dot(m2, kb), -0.5 * chi * dot(m1, kb)
    _put(
        G[0],
        combine(-kappa1 / le, tt, 1 / le, cross(tf, m2)),
        combine(-kappa1 / lf, tt, -1 / lf, cross(te, m2)),
        -0.5 * dot(kb, m1e),
        -0.5 * dot(kb, m1f),
    )
    _put(
        G[1],
        combine(-kappa2 / le, tt, -1 / le, cross(tf, m1)),
        combine(-kappa2 / lf, tt, 1 / lf, cross(te, m1)),
        -0.5 * dot(kb, m2e),
        -0.5 * dot(kb, m2f),
    )
    _put(G[2], scale(0.5 / le, kb), scale(0.5 / lf, kb), -1.0, 1.0)
    return kappa1, kappa2, twist_angle(m1e, m1f, te, tf, twist)


@compiled
def stiffness(G: Any, coefficients: Vector, H: Any) -> None:
    """Fill the lower triangle of H (8, 8) with sum_k c_k G_k G_k^T, the material part of the Hessian."""
    for i in range(8):
        a, b, c = coefficients[0] * G[0, i], coefficients[1] * G[1, i], coefficients[2] * G[2, i]
        for j in range(i + 1):
            H[i, j] = a * G[0, j] + b * G[1, j] + c * G[2, j]


@compiled
def add_geometric(e: Vector, f: Vector, m1e: Vector, m1f: Vector, stress: Vector, H: Any) -> None:
    """Add sum_k stress_k * Hessian(strain_k) to the lower triangle of H (8, 8).

    Both curvatures are handled at once: stress1 kappa1 + stress2 kappa2 = kb . (we + wf) / 2
    with w = stress1 m2 - stress2 m1.
    """
    s1, s2, s3 = stress
    le, lf = norm(e), norm(f)
    te, tf = scale(1 / le, e), scale(1 / lf, f)
    chi = 1 + dot(te, tf)
    kb = scale(2 / chi, cross(te, tf))
    tt = scale(1 / chi, add(te, tf))
    m2e, m2f = cross(te, m1e), cross(tf, m1f)
    we, wf = combine(s1, m2e, -s2, m1e), combine(s1, m2f, -s2, m1f)
    wt = scale(1 / chi, add(we, wf))
    k = 0.5 * chi * dot(kb, wt)
    _add_edge_block(H, 0, 1 / (le * le), te, kb, tt, scale(-1.0, cross(tf, wt)), we, k, chi, s3)
    _add_edge_block(H, 3, 1 / (lf * lf), tf, kb, tt, cross(te, wt), wf, k, chi, s3)
    _add_mixed_block(H, 1 / (le * lf), te, tf, kb, tt, wt, k, chi, s3)
    H[6, 6] -= 0.5 * dot(kb, we)
    H[7, 7] -= 0.5 * dot(kb, wf)
    we, wf = combine(-s1, m1e, -s2, m2e), combine(-s1, m1f, -s2, m2f)
    for row, w in ((6, we), (7, wf)):
        half = -0.5 * dot(kb, w)
        on_e, on_f = cross(tf, w), cross(te, w)
        for i in range(3):
            H[row, i] += (half * tt[i] + on_e[i] / chi) / le
            H[row, 3 + i] += (half * tt[i] - on_f[i] / chi) / lf


@compiled
def _add_edge_block(
    H: Any,
    at: int,
    factor: float,
    t: Vector,
    kb: Vector,
    tt: Vector,
    arm: Vector,
    w: Vector,
    k: float,
    chi: float,
    s3: float,
) -> None:
    side = combine(0.25, w, -0.25 * s3, add(t, tt))
    for i in range(3):
        H[at + i, at + i] -= factor * k / chi
        for j in range(i + 1):
            value = 2 * k * tt[i] * tt[j] + arm[i] * tt[j] + tt[i] * arm[j] + k / chi * t[i] * t[j]
            H[at + i, at + j] += factor * (value + kb[i] * side[j] + side[i] * kb[j])


@compiled
def _add_mixed_block(
    H: Any,
    factor: float,
    te: Vector,
    tf: Vector,
    kb: Vector,
    tt: Vector,
    wt: Vector,
    k: float,
    chi: float,
    s3: float,
) -> None:
    on_e, on_f = cross(tf, wt), cross(te, wt)
    axial = combine(-1.0, wt, s3 / chi, te)  # the antisymmetric parts: -[wt]x and s3 / chi [te]x
    row_f = ((0.0, axial[2], -axial[1]), (-axial[2], 0.0, axial[0]), (axial[1], -axial[0], 0.0))
    for i in range(3):
        for j in range(3):  # H[f_i, e_j] = d2/(de_j df_i)
            value = 2 * k * tt[j] * tt[i] - on_e[j] * tt[i] + tt[j] * on_f[i] - k / chi * te[j] * tf[i]
            value += row_f[i][j] - 0.5 * s3 * kb[j] * tt[i]
            H[3 + i, j] += factor * value
        H[3 + i, i] -= factor * k / chi
