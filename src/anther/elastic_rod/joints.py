"""The stiffness of a joint between two edges: moments of the two curvatures and the twist per strain, a 3x3 matrix."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.elastic_rod.rods import Array, Rods

SOFTER = 1.2
"""A last edge may be this much softer than the one before it for the latter's joint to stay well above 0."""

NO_TWIST = 1e-2
"""EI / GJ of rods that cannot twist: their twist is this share of what it would be at EI = GJ."""


def joint_matrix(rods: Rods, curvature: Array, near: NDArray[Any], far: NDArray[Any], jointed: NDArray[Any]) -> Array:
    """Return (N, 6) entries 11, 12, 22, 13, 23, 33 of the stiffness on (kappa1, kappa2, twist) [N m]; 0 without joint.

    A straight joint has K = 1 / (sum of the bend compliances of its shares of both edges, and of the joint itself),
    which is EI over the Voronoi length (P19) where both are half and alike, and GJ likewise.

    At a kink of angle phi the two edges do not share their axes: bending of the one in part twists the other. With
    h = phi/2, the binormal b, the mean tangent t and n = b x t, a rotation (w_b, w_n, w_t) of edge j against its parent
    gives the strains w_b / cos^2 h, w_n / cos h, w_t / cos h, and the shares' compliances, a of the parent and b of
    edge j, add up to

        C_bb = a_EI + b_EI,   C_nn = (a_EI + b_EI) cos^2 h + (a_GJ + b_GJ) sin^2 h,
        C_tt = (a_EI + b_EI) sin^2 h + (a_GJ + b_GJ) cos^2 h,   C_nt = sin h cos h (a_EI - a_GJ - b_EI + b_GJ).

    Without that, kinks and forks converge with the first order only. `discretisation="paper"` takes every joint as
    straight and halves every edge.

    Args:
        rods: the rods.
        curvature: (N, 2) curvatures of the scanned shape, |curvature| = 2 tan h.
        near, far: of `Model`.
        jointed: (N,) which edges have a joint at their inner end.
    """
    shares = _shares(rods, near, jointed)
    bend, twist = _compliances(rods)
    e, soft = np.where(far >= 0, near, 0), np.asarray(rods.joint_compliance)
    a_EI, a_GJ = shares[0] * bend[e], shares[0] * twist[e]
    b_EI, b_GJ = shares[1] * bend, shares[1] * twist
    straight = rods.discretisation == "paper"
    k, cosine, sine = _kink(0 * curvature if straight else curvature)
    C_bb = a_EI + b_EI + soft
    C_nn = (a_EI + b_EI) * cosine**2 + (a_GJ + b_GJ) * sine**2 + soft
    C_tt = (a_EI + b_EI) * sine**2 + (a_GJ + b_GJ) * cosine**2 + soft
    C_nt = sine * cosine * (a_EI - a_GJ - b_EI + b_GJ)
    factor = cosine**2 / (C_nn * C_tt - C_nt**2)
    W_bb, W_nn, W_nt, W_tt = cosine**4 / C_bb, factor * C_tt, -factor * C_nt, factor * C_nn
    k1, k2 = k.T  # along kappa in the plane of the two curvatures; n is (k2, -k1) there
    entries = np.stack(
        [
            W_bb * k1**2 + W_nn * k2**2,
            (W_bb - W_nn) * k1 * k2,
            W_bb * k2**2 + W_nn * k1**2,
            W_nt * k2,
            -W_nt * k1,
            W_tt,
        ],
        axis=1,
    )
    return np.where(jointed[:, None], entries, 0)


def _compliances(rods: Rods) -> tuple[Array, Array]:
    """Return (N,) length / EI and length / GJ of every edge [rad/(N m)]; of the unused edge 0 those of edge 1."""
    EI = np.asarray(rods.youngs) * np.pi * np.asarray(rods.edge_radius) ** 4 / 4
    bend = np.concatenate([[1.0], rods.lengths[1:] / EI[1:]])
    return bend, bend * np.maximum(rods.bend_over_twist, NO_TWIST)


def line_on(rods: Rods) -> NDArray[Any]:
    """Return (N,) the only child of node j where that is joined to edge j without an extra compliance; else -1."""
    n, parent = len(rods.parent), rods.parent
    children = np.bincount(parent[1:], minlength=n)
    on = np.full(n, -1)
    plain = 1 + np.flatnonzero((children[parent[1:]] == 1) & (np.asarray(rods.joint_compliance)[1:] == 0))
    on[parent[plain]] = plain
    return on


def turned_alone(rods: Rods) -> NDArray[Any]:
    """Return (N,) whether edge j alone turns a lump at its end: unless that is one of several lumps in line."""
    lumps, on = np.asarray(rods.lumped_inertia) > 0, line_on(rods)
    in_line = (on >= 0) & (lumps[on] | lumps[rods.parent])
    in_line[0] = False
    return lumps & ~in_line


def _shares(rods: Rods, near: NDArray[Any], jointed: NDArray[Any]) -> tuple[Array, Array]:
    """Return which shares of the parent edge and of edge j bend in the joint of edge j.

    Half an edge each. But an edge that ends in a fork turns the fork's joints together, which none of them can do
    alone: its own joint takes the whole of it, theirs none. Likewise an edge that alone turns a lump at its end; at a
    tip the last half edge, which is nearer to the lump than any joint is, counts 7/4 in the last joint and -3/4 in the
    one before: so bend both angle and place of the lump as far as they should. An edge that leaves the root has a joint
    of its own only in the soil; without soil the hub's is that of its one sibling, and where it has several siblings,
    which then fork from it at the root, that of its one child.
    """
    n, parent = len(near), rods.parent
    of_near, own = np.where(near > 0, 0.5, 0.0), np.full(n, 0.5)
    if rods.discretisation == "paper":
        return of_near, own
    children, on = np.bincount(parent[1:], minlength=n), line_on(rods)
    lumps = np.asarray(rods.lumped_inertia) > 0
    whole = (children > 1) | turned_alone(rods)
    whole[0] = False
    own[whole & jointed] = 1
    of_near[1:][(whole & jointed)[near[1:]]] = 0
    tips = np.flatnonzero(lumps & (children == 0) & jointed)
    before, bend = parent[tips], _compliances(rods)[0]
    share = bend[tips] / bend[before]
    plain = (on[before] == tips) & (before > 0) & jointed[before] & (share < SOFTER)
    own[tips[plain]] += 3 / 8
    own[before[plain]] -= 3 / 8 * share[plain]
    siblings = near != parent
    if siblings.any():
        hub = near[siblings][0]
        beyond = (near == hub) & ~siblings
        if whole[hub] and siblings.sum() == 1:
            of_near[siblings], of_near[beyond] = 1, 0
        elif siblings.sum() > 1 and beyond.sum() == 1:
            of_near[siblings], of_near[beyond] = 0, 1
    return of_near, own


def _kink(curvature: Array) -> tuple[Array, Array, Array]:
    """Return the direction of each kink among the curvatures (N, 2), and cosine and sine of half its angle."""
    size = np.linalg.norm(curvature, axis=1)
    direction = np.where(size[:, None] > 0, curvature / np.maximum(size, 1e-300)[:, None], [1.0, 0.0])
    cosine = 1 / np.sqrt(1 + size**2 / 4)
    return direction, cosine, 0.5 * size * cosine
