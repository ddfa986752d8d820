"""Bend and twist of one spring, between edge e and edge f, which goes on where e ends: energy and derivatives.

Discrete elastic rods (Bergou et al. 2008, 2010; curvatures as in the paper's row P19). Derivatives are taken at the
point where the frames are (a spin-free change of an edge carries its frame by parallel transport), so that the Hessian
is the symmetric one of an energy (as in Panetta et al. 2019, X-shells). A material frame is its first director m1; the
second is m2 = t x m1. Stretch E = EA/2 eps^2 l (P18) of edge f is added to its spring.

Names: e and f are the vectors of the edges, t their unit tangents, kb the curvature binormal, chi = 1 + te . tf.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from anther.rods._vectors import (
    LANES,
    Vector,
    add,
    combine,
    cross,
    dot,
    get,
    get3,
    get6,
    inlined,
    inner,
    merged,
    mix,
    norm,
    put,
    put3,
    put6,
    scale,
    spin,
    transport,
    twist_angle,
)

EDGE_E, EDGE_F, DIRECTOR_E, DIRECTOR_F, SPEED_E, SPEED_F, START_F = range(0, 21, 3)
SPIN_E, SPIN_F, TWIST, VISCOUS, CURVATURE_1, CURVATURE_2, NATURAL_TWIST, STRETCH, LENGTH = range(21, 30)
JOINT, EE, FF, FE = range(30, 54, 6)
FORCE_E, FORCE_F, SPIN_E_E, SPIN_E_F, SPIN_F_E, SPIN_F_F, SPINS = range(57, 78, 3)
MOMENT_E, MOMENT_F = range(78, 80)
"""Rows of the lanes, of a spring between edges e and f.

Up to JOINT what is put in, from EE on gradient and Hessian by the vectors and the spins of both edges. JOINT, EE and FF
are symmetric: 00, 01, 11, 02, 12, 22; FE has rows of f, columns of e. SPIN_E_F is the spin of e against the vector of
f; SPINS are e with e, e with f, f with f.
"""

SINE, COSINE = range(36, 38)
"""Output rows for the twist: its sine and cosine."""

OLD_EDGE, NEW_EDGE, OLD_DIRECTOR, NEW_DIRECTOR, TURN = range(0, 15, 3)
"""Rows for moving the frame of an edge; NEW_DIRECTOR is the output."""


class Bent(NamedTuple):
    """A pair of edges: unit tangents, inverse lengths, chi, curvature binormal, their mean tangent over chi / 2."""

    te: Vector
    tf: Vector
    per_e: float
    per_f: float
    chi: float
    kb: Vector
    tt: Vector


class Slopes(NamedTuple):
    """Gradient of one strain by the edge vectors e and f [1/m] and by the spins of their frames [-]."""

    e: Vector
    f: Vector
    spin_e: float
    spin_f: float


@inlined
def bent(e: Vector, f: Vector) -> Bent:
    """Return the geometry of two edges that meet."""
    per_e, per_f = 1 / norm(e), 1 / norm(f)
    te, tf = scale(per_e, e), scale(per_f, f)
    chi = 1 + dot(te, tf)
    return Bent(te, tf, per_e, per_f, chi, scale(2 / chi, cross(te, tf)), combine(1 / chi, te, 1 / chi, tf))


@inlined
def curvatures(b: Bent, m1e: Vector, m1f: Vector) -> Any:
    """Return (kappa1, kappa2), the integrated curvatures [-]."""
    kappa1 = dot(combine(0.5, cross(b.te, m1e), 0.5, cross(b.tf, m1f)), b.kb)
    kappa2 = dot(combine(-0.5, m1e, -0.5, m1f), b.kb)
    return kappa1, kappa2


@inlined
def twist_parts(b: Bent, m1e: Vector, m1f: Vector) -> tuple[float, float]:
    """Return sine and cosine of the twist from edge e to edge f."""
    carried = transport(m1e, b.te, b.tf)
    return dot(cross(carried, m1f), b.tf), dot(carried, m1f)


@inlined
def strains(b: Bent, m1e: Vector, m1f: Vector, twist: float) -> Vector:
    """Return (kappa1, kappa2, twist [rad]), the twist on the branch nearest to the given one."""
    k1, k2 = curvatures(b, m1e, m1f)
    sine, cosine = twist_parts(b, m1e, m1f)
    return k1, k2, twist_angle(sine, cosine, twist)


@inlined
def twist_lanes(buffer: Any) -> None:
    """Fill the rows SINE and COSINE of all lanes."""
    for i in range(LANES):
        b = bent(get3(buffer, EDGE_E, i), get3(buffer, EDGE_F, i))
        sine, cosine = twist_parts(b, get3(buffer, DIRECTOR_E, i), get3(buffer, DIRECTOR_F, i))
        put(buffer, SINE, i, sine)
        put(buffer, COSINE, i, cosine)


@inlined
def frame_lanes(b: Any) -> None:
    """Carry the directors of all lanes from their old edges to the new ones and spin them."""
    for i in range(LANES):
        old, new = get3(b, OLD_EDGE, i), get3(b, NEW_EDGE, i)
        t_old, t_new = scale(1 / norm(old), old), scale(1 / norm(new), new)
        carried = transport(get3(b, OLD_DIRECTOR, i), t_old, t_new)
        put3(b, NEW_DIRECTOR, i, spin(carried, t_new, get(b, TURN, i)))


@inlined
def gradients(b: Bent, m1e: Vector, m1f: Vector) -> tuple[Slopes, Slopes, Slopes]:
    """Return the gradients of kappa1, kappa2 and twist."""
    m2e, m2f = cross(b.te, m1e), cross(b.tf, m1f)
    k1, k2 = curvatures(b, m1e, m1f)
    per = 1 / b.chi
    m1, m2 = combine(per, m1e, per, m1f), combine(per, m2e, per, m2f)
    first = Slopes(
        combine(-k1 * b.per_e, b.tt, b.per_e, cross(b.tf, m2)),
        combine(-k1 * b.per_f, b.tt, -b.per_f, cross(b.te, m2)),
        -0.5 * dot(b.kb, m1e),
        -0.5 * dot(b.kb, m1f),
    )
    second = Slopes(
        combine(-k2 * b.per_e, b.tt, -b.per_e, cross(b.tf, m1)),
        combine(-k2 * b.per_f, b.tt, b.per_f, cross(b.te, m1)),
        -0.5 * dot(b.kb, m2e),
        -0.5 * dot(b.kb, m2f),
    )
    return first, second, Slopes(scale(0.5 * b.per_e, b.kb), scale(0.5 * b.per_f, b.kb), -1.0, 1.0)


@inlined
def rate_of(g: Slopes, ve: Vector, vf: Vector, we: float, wf: float) -> float:
    """Return the rate of a strain, given the velocities of the edge vectors and the spin rates."""
    return dot(g.e, ve) + dot(g.f, vf) + g.spin_e * we + g.spin_f * wf


@merged
def _plus_both(s: Any, a: Vector, b: Vector) -> Any:
    """Return s + a b^T + b a^T; of symmetric matrices the upper triangle, column by column."""
    return (
        s[0] + 2 * a[0] * b[0],
        s[1] + a[0] * b[1] + b[0] * a[1],
        s[2] + 2 * a[1] * b[1],
        s[3] + a[0] * b[2] + b[0] * a[2],
        s[4] + a[1] * b[2] + b[1] * a[2],
        s[5] + 2 * a[2] * b[2],
    )


@inlined
def moments(W: Any, strain: Vector) -> Vector:
    """Return the symmetric matrix W = (11, 12, 22, 13, 23, 33) times (kappa1, kappa2, twist)."""
    k1, k2, tau = strain
    return (
        W[0] * k1 + W[1] * k2 + W[3] * tau,
        W[1] * k1 + W[2] * k2 + W[4] * tau,
        W[3] * k1 + W[4] * k2 + W[5] * tau,
    )


@inlined
def _plus_stiffness(s: Any, W: Any, g1: Vector, g2: Vector, g3: Vector) -> Any:
    """Return s and the material part of a symmetric block: sum of W_ij gradient_i gradient_j^T."""
    s = _plus_both(s, g1, mix((0.5 * W[0], W[1], W[3]), g1, g2, g3))
    s = _plus_both(s, g2, combine(0.5 * W[2], g2, W[4], g3))
    return _plus_both(s, g3, scale(0.5 * W[5], g3))


@inlined
def _turning(b: Bent, t: Vector, arm: Vector, w: Vector, k: float, s3: float, per2: float) -> Any:
    """Return the geometric part of the Hessian in one edge vector of tangent t."""
    d = -k / b.chi
    a = _plus_both((d, 0.0, d, 0.0, 0.0, d), b.tt, combine(k, b.tt, 1.0, arm))
    a = _plus_both(a, t, scale(-0.5 * d, t))
    a = _plus_both(a, b.kb, mix((0.25, -0.25 * s3, -0.25 * s3), w, t, b.tt))
    return (per2 * a[0], per2 * a[1], per2 * a[2], per2 * a[3], per2 * a[4], per2 * a[5])


@inlined
def _crossed(b: Bent, on_e: Vector, on_f: Vector, wt: Vector, k: float, s3: float) -> Any:
    """Return the geometric part of d2 / df de, rows of f, times both lengths."""
    axial = combine(-1.0, wt, s3 / b.chi, b.te)  # the antisymmetric parts: -[wt]x and s3 / chi [te]x
    along, d = mix((2 * k, -1.0, -0.5 * s3), b.tt, on_e, b.kb), -k / b.chi
    return (
        add(mix((b.tt[0], on_f[0], d * b.tf[0]), along, b.tt, b.te), (d, axial[2], -axial[1])),
        add(mix((b.tt[1], on_f[1], d * b.tf[1]), along, b.tt, b.te), (-axial[2], d, axial[0])),
        add(mix((b.tt[2], on_f[2], d * b.tf[2]), along, b.tt, b.te), (axial[1], -axial[0], d)),
    )


@inlined
def _put_edge_blocks(
    buffer: Any, i: int, b: Bent, G: Any, stress: Vector, W: Any, we: Vector, wf: Vector, stretch: Any
) -> None:
    """Write the Hessian in the edge vectors. Bending is both curvatures at once.

    stress1 kappa1 + stress2 kappa2 = kb . (we + wf) / 2 with w = stress1 m2 - stress2 m1.
    """
    g1, g2, g3 = G
    s3 = stress[2]
    wt = combine(1 / b.chi, we, 1 / b.chi, wf)
    k = 0.5 * b.chi * dot(b.kb, wt)
    on_e, on_f = cross(b.tf, wt), cross(b.te, wt)
    per_e, per_f = b.per_e, b.per_f
    ee = _turning(b, b.te, scale(-1.0, on_e), we, k, s3, per_e * per_e)
    put6(buffer, EE, i, _plus_stiffness(ee, W, g1.e, g2.e, g3.e))
    ff = _plus_stiffness(stretch, W, g1.f, g2.f, g3.f)
    turned = _turning(b, b.tf, on_f, wf, k, s3, per_f * per_f)
    put3(buffer, FF, i, add((ff[0], ff[1], ff[2]), (turned[0], turned[1], turned[2])))
    put3(buffer, FF + 3, i, add((ff[3], ff[4], ff[5]), (turned[3], turned[4], turned[5])))
    h1, h2 = mix((W[0], W[1], W[3]), g1.e, g2.e, g3.e), mix((W[1], W[2], W[4]), g1.e, g2.e, g3.e)
    h3 = mix((W[3], W[4], W[5]), g1.e, g2.e, g3.e)
    rows, per = _crossed(b, on_e, on_f, wt, k, s3), per_e * per_f
    put3(buffer, FE, i, combine(1.0, mix((g1.f[0], g2.f[0], g3.f[0]), h1, h2, h3), per, rows[0]))
    put3(buffer, FE + 3, i, combine(1.0, mix((g1.f[1], g2.f[1], g3.f[1]), h1, h2, h3), per, rows[1]))
    put3(buffer, FE + 6, i, combine(1.0, mix((g1.f[2], g2.f[2], g3.f[2]), h1, h2, h3), per, rows[2]))


@inlined
def _turned(b: Bent, w: Vector) -> Any:
    """Return the geometric part of the Hessian between a spin (w turned by a right angle) and the edge vectors."""
    half = -0.5 * dot(b.kb, w)
    by_e = scale(b.per_e, combine(half, b.tt, 1 / b.chi, cross(b.tf, w)))
    by_f = scale(b.per_f, combine(half, b.tt, -1 / b.chi, cross(b.te, w)))
    return by_e, by_f


@inlined
def _along(G: Any, u: Vector) -> Any:
    """Return the mixtures u of the three gradients by e and by f."""
    g1, g2, g3 = G
    return mix(u, g1.e, g2.e, g3.e), mix(u, g1.f, g2.f, g3.f)


@inlined
def _put_spin_blocks(buffer: Any, i: int, b: Bent, G: Any, stress: Vector, W: Any, m1: Any, w: Any) -> None:
    """Write the Hessian in the spins of both edges, against each other and against the edge vectors."""
    s1, s2, _ = stress
    (m1e, m1f), (we, wf) = m1, w
    spin_e = (G[0].spin_e, G[1].spin_e, G[2].spin_e)
    spin_f = (G[0].spin_f, G[1].spin_f, G[2].spin_f)
    moment_e, moment_f = moments(W, spin_e), moments(W, spin_f)
    by_e, by_f = _along(G, moment_e)
    on_e, on_f = _turned(b, combine(-s1, m1e, -s2, cross(b.te, m1e)))
    put3(buffer, SPIN_E_E, i, add(by_e, on_e))
    put3(buffer, SPIN_E_F, i, add(by_f, on_f))
    by_e, by_f = _along(G, moment_f)
    on_e, on_f = _turned(b, combine(-s1, m1f, -s2, cross(b.tf, m1f)))
    put3(buffer, SPIN_F_E, i, add(by_e, on_e))
    put3(buffer, SPIN_F_F, i, add(by_f, on_f))
    ee, ff = dot(moment_e, spin_e) - 0.5 * dot(b.kb, we), dot(moment_f, spin_f) - 0.5 * dot(b.kb, wf)
    put3(buffer, SPINS, i, (ee, dot(moment_e, spin_f), ff))


@inlined
def _put_forces(buffer: Any, i: int, G: Any, stress: Vector, tension: Vector) -> None:
    g1, g2, _ = G
    s1, s2, s3 = stress
    by_e, by_f = _along(G, stress)
    put3(buffer, FORCE_E, i, by_e)
    put3(buffer, FORCE_F, i, add(by_f, tension))
    put(buffer, MOMENT_E, i, s1 * g1.spin_e + s2 * g2.spin_e - s3)
    put(buffer, MOMENT_F, i, s1 * g1.spin_f + s2 * g2.spin_f + s3)


@inlined
def _stress(buffer: Any, i: int, k: Any, G: Any, ve: Vector, vf: Vector) -> Vector:
    """Return the moments of bend and twist [N m]: stiffness times (strain + viscous time times strain rate)."""
    spin_e, spin_f, lag = (
        get(buffer, SPIN_E, i),
        get(buffer, SPIN_F, i),
        get(buffer, VISCOUS, i),
    )
    s1 = k[0] - get(buffer, CURVATURE_1, i) + lag * rate_of(G[0], ve, vf, spin_e, spin_f)
    s2 = k[1] - get(buffer, CURVATURE_2, i) + lag * rate_of(G[1], ve, vf, spin_e, spin_f)
    s3 = get(buffer, TWIST, i) - get(buffer, NATURAL_TWIST, i)
    s3 += lag * rate_of(G[2], ve, vf, spin_e, spin_f)
    return moments(get6(buffer, JOINT, i), (s1, s2, s3))


@inlined
def stretched(buffer: Any, i: int, rate: float, b: Bent, f: Vector, vf: Vector) -> Any:
    """Return the tension of edge f as a vector [N], and its Hessian.

    The elastic force is EA (1/l - 1/r) f with r the length of f. In a midpoint step, f is the edge at its middle and r
    the mean of the lengths at its start and end: then the force does exactly the work by which the stretch energy
    changes (a discrete gradient: Simo & Tarnow 1992, Gonzalez 1996). Without that, stretching waves too fast for the
    step gain energy. Of the Hessian, EA / r^2 f (f_end / |f_end|)^T is taken along f only, which keeps it symmetric;
    what is left out lets an error across the edge cause one along it, but not the reverse, so Newton hardly notices.
    """
    EA, natural, lag = (
        get(buffer, STRETCH, i),
        get(buffer, LENGTH, i),
        get(buffer, VISCOUS, i),
    )
    start = get3(buffer, START_F, i)
    end = combine(2.0, f, -1.0, start)
    per_end = 1 / norm(end)
    per_r = 2 / (norm(start) + 1 / per_end)
    viscous = EA * lag * dot(b.tf, vf) / natural
    force = combine(EA * (1 / natural - per_r), f, viscous, b.tf)
    across = EA * (1 / natural - per_r) + viscous * b.per_f
    along = EA * lag * rate / natural - viscous * b.per_f
    along += EA * per_r * per_r * per_end * dot(f, end)
    return force, _plus_both((across, 0.0, across, 0.0, 0.0, across), b.tf, scale(0.5 * along, b.tf))


@inner
def spring_lanes(buffer: Any, rate: float) -> None:
    """Fill the output rows of all lanes from their input rows; `rate` is d velocity / d position [1/s].

    The Hessian of the Kelvin-Voigt part leaves out the change of the gradient with position, which is unsymmetric.
    """
    for i in range(LANES):
        m1e, m1f = get3(buffer, DIRECTOR_E, i), get3(buffer, DIRECTOR_F, i)
        ve, vf = get3(buffer, SPEED_E, i), get3(buffer, SPEED_F, i)
        f = get3(buffer, EDGE_F, i)
        b = bent(get3(buffer, EDGE_E, i), f)
        G = gradients(b, m1e, m1f)
        stress = _stress(buffer, i, curvatures(b, m1e, m1f), G, ve, vf)
        tension, stretch = stretched(buffer, i, rate, b, f, vf)
        _put_forces(buffer, i, G, stress, tension)
        stiffer = 1 + get(buffer, VISCOUS, i) * rate
        a, c = get3(buffer, JOINT, i), get3(buffer, JOINT + 3, i)
        a, c = scale(stiffer, a), scale(stiffer, c)
        W = (a[0], a[1], a[2], c[0], c[1], c[2])
        s1, s2, _ = stress
        we = combine(s1, cross(b.te, m1e), -s2, m1e)
        wf = combine(s1, cross(b.tf, m1f), -s2, m1f)
        _put_edge_blocks(buffer, i, b, G, stress, W, we, wf, stretch)
        _put_spin_blocks(buffer, i, b, G, stress, W, (m1e, m1f), (we, wf))
