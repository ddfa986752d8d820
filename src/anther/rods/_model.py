"""Rods turned into the flat arrays that the compiled kernels loop over."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anther.core.checks import check_array
from anther.core.errors import bad_input
from anther.rods import _springs
from anther.rods._rods import Array, NaturalShape, Rods
from anther.rods._supports import full, hold_joint, springs_of, upper
from anther.rods._vectors import (
    apart,
    compiled,
    cross,
    halves,
    inlined,
    load,
    norm,
    scale,
    spin,
    store,
    transport,
)


class Edges(NamedTuple):
    """Which edges meet in the joint of edge j, and how: the first fields of `Model`, and the kinks."""

    near: NDArray[Any]  # (N,)
    far: NDArray[Any]  # (N,)
    swapped: NDArray[Any]  # (N,)
    order: NDArray[Any]  # (N,)
    frames: Frames
    curvature: Array  # (N, 2) of the scanned shape, |curvature| = 2 tan h
    jointed: NDArray[Any]  # (N,) which edges have a joint at their inner end


def edges_of(rods: Rods, planted: bool) -> Edges:
    """Return how the edges of `rods` are joined.

    Raises:
        InputError: an edge folds back onto its parent edge.
    """
    near, far, swapped, order = _couplings(rods)
    frames, curvature = _rest_frames(rods.nodes, rods.parent, near, far, swapped)
    if planted:
        near, far, swapped = _planted(rods.parent, far)
        curvature[rods.parent == 0] = 0
    return Edges(near, far, swapped, order, frames, curvature, _jointed(rods.parent, far, planted))


class JointCompliance(NamedTuple):
    """Compliance [rad/(N m)] between the end of the parent edge and edge j, in the axes b, n, t of the kink there.

    The sum of those of the shares of both edges and of the joint itself, so that a straight joint of round edges has
    K = EI over the Voronoi length (P19), and GJ likewise. An edge's compliance is a tensor with the axes of its
    section; at a kink of angle phi each is turned by h = phi / 2 about the binormal b into the axes b, n = b x t and
    the mean tangent t, since the two edges do not share their axes: bending of the one in part twists the other.
    Without that, kinks and forks converge with the first order only.

    The kink is that of the scanned shape: about it small motions are right, and there `joint_compliance` holds. With
    the edge length, its difference from the natural kink vanishes.

    `discretisation="paper"` takes every joint as straight and halves every edge.
    """

    near: Array  # (N, 3, 3) between the parent edge and the node
    own: Array  # (N, 3, 3) between the node and edge j
    kink: tuple[Array, Array, Array]  # see `_kink`
    own_share: Array  # (N,) of edge j that bends in its own joint
    tensors: Array  # (N, 4), see `_edge_tensors`


def joint_compliance(rods: Rods, edges: Edges) -> JointCompliance:
    """Return the compliances of all joints; the entries of edges without one mean nothing."""
    of_near, own_share = _shares(rods, edges.near, edges.jointed)
    e = np.where(edges.far >= 0, edges.near, 0)
    straight = rods.discretisation == "paper"
    kink = _kink(0 * edges.curvature if straight else edges.curvature)
    k, cosine, sine = kink
    tensors = _edge_tensors(rods, edges.frames.m1)
    skew = np.where(edges.swapped, -1.0, 1.0)  # a reversed edge has its second axis reversed
    near = _turned(tensors[e] * np.stack([skew**2, skew, skew**2, skew**2], axis=1), k, cosine, sine)
    own = own_share[:, None, None] * _turned(tensors, k, cosine, -sine)
    own += np.asarray(rods.joint_compliance)[:, None, None] * np.eye(3)
    return JointCompliance(of_near[:, None, None] * near, own, kink, own_share, tensors)


def joint_matrix(compliance: Array, kink: tuple[Array, Array, Array], jointed: NDArray[Any]) -> Array:
    """Return (N, 3, 3) stiffness on (kappa1, kappa2, twist) [N m]; 0 without joint.

    A rotation (w_b, w_n, w_t) of edge j against its parent gives the strains w_b / cos^2 h, w_n / cos h, w_t / cos h.

    Args:
        compliance: (N, 3, 3) of the joints, in the axes of the kinks.
        kink: see `_kink`.
        jointed: (N,) which edges have a joint.
    """
    k, cosine, _ = kink
    per_strain = np.stack([cosine**2, cosine, cosine], axis=1)
    C = np.where(jointed[:, None, None], compliance, np.eye(3))
    W = np.linalg.inv(C) * per_strain[:, :, None] * per_strain[:, None]
    V = np.zeros((len(k), 3, 3))  # b, n and t among (kappa1, kappa2, twist)
    V[:, :2, 0], V[:, 0, 1], V[:, 1, 1], V[:, 2, 2] = k, k[:, 1], -k[:, 0], 1
    return np.where(jointed[:, None, None], V @ W @ V.transpose(0, 2, 1), 0)


class Held(NamedTuple):
    """What rotation springs at nodes make of the joints there."""

    compliance: Array  # (N, 3, 3) of the joints, in the axes of the kinks
    turning: Array  # the rows `Model.turning`
    changed: NDArray[Any]  # which joints are softer by it


def _hold_turning(rods: Rods, edges: Edges, joints: JointCompliance) -> Held:
    """Hold the nodes with a rotation spring: by springs on the edges that meet there, see `hold_joint`.

    The edge that ends in a fork turns with the node; that at a tip is half an edge away from it.
    """
    n, parent, m1 = len(rods.nodes), rods.parent, edges.frames.m1
    stiffness, ground = np.zeros((2, n, 3, 3))
    for support in rods.supports:
        stiffness[support.node] += support.stiffness("rotation")
    compliance, changed = joints.near + joints.own, []
    t = (rods.nodes - rods.nodes[parent]) / np.maximum(rods.lengths, 1e-300)[:, None]
    of_edge = np.stack([np.cross(t, m1), -m1, t], axis=2)  # the axes of kappa1, kappa2 and twist, as columns
    for j in np.flatnonzero(stiffness.any(axis=(1, 2))):
        children = np.flatnonzero(parent == j)
        if len(children) == 1:
            c = children[0]
            (k1, k2), cosine, sine = (part[c] for part in joints.kink)
            b = k1 * of_edge[c, :, 0] + k2 * of_edge[c, :, 1]
            mean = cosine * t[c] - sine * np.cross(b, t[c])
            R = np.stack([b, np.cross(b, mean), mean], axis=1)
            compliance[c], *springs = hold_joint(joints.near[c], joints.own[c], R.T @ stiffness[j] @ R)
            for edge, spring in zip((j, c), springs, strict=True):
                ground[edge] += R @ spring @ R.T
            changed.append(c)
        else:
            D11, D12, D22, twist = joints.tensors[j] * (0.0 if joints.own_share[j] >= 1 else 0.5)
            beyond = of_edge[j] @ [[D11, D12, 0], [D12, D22, 0], [0, 0, twist]] @ of_edge[j].T
            ground[j] += np.linalg.solve(np.eye(3) + stiffness[j] @ beyond, stiffness[j])
    held = np.flatnonzero(ground.any(axis=(1, 2)))
    on_strains = of_edge.transpose(0, 2, 1) @ ground @ of_edge
    turning = np.hstack([held[:, None].astype(np.float64), t[held], m1[held], upper(on_strains[held])])
    return Held(compliance, turning, np.array(changed, dtype=np.int64))


def _natural_strains(rods: Rods, built: _Built) -> NaturalShape:
    """Return the natural shape, of joints that a support softens such that they bear the same in the scanned shape."""
    edges, changed = built.edges, built.changed
    natural = rods.natural or NaturalShape(rods.lengths, edges.curvature, np.zeros(len(rods.parent)))
    if rods.natural is None or not len(changed):
        return natural
    scanned = np.hstack([edges.curvature, np.zeros((len(rods.parent), 1))])[changed]
    strain = scanned - np.hstack([natural.curvature, natural.twist[:, None]])[changed]
    moment = built.plain[changed] @ strain[..., None]
    strains = scanned - np.linalg.solve(full(built.model.joint[changed]), moment)[..., 0]
    curvature, twist = natural.curvature.copy(), natural.twist.copy()
    curvature[changed], twist[changed] = strains[:, :2], strains[:, 2]
    return NaturalShape(natural.length, curvature, twist)


def _turned(tensors: Array, k: Array, cosine: Array, sine: Array) -> Array:
    """Return (N, 3, 3) compliances in the axes b, n, t of a kink, of edges that lie at half its angle from t."""
    D11, D12, D22, twist = tensors.T
    k1, k2 = k.T  # (k1, k2) among the directors is n, the direction in which a turn about b bends; b is (-k2, k1)
    bb = D11 * k1**2 + 2 * D12 * k1 * k2 + D22 * k2**2
    nn = D11 * k2**2 - 2 * D12 * k1 * k2 + D22 * k1**2
    bn = (D11 - D22) * k1 * k2 - D12 * (k1**2 - k2**2)
    C = np.empty((len(bb), 3, 3))
    C[:, 0, 0], C[:, 1, 1], C[:, 2, 2] = bb, nn * cosine**2 + twist * sine**2, nn * sine**2 + twist * cosine**2
    C[:, 0, 1] = C[:, 1, 0] = bn * cosine
    C[:, 0, 2] = C[:, 2, 0] = bn * sine
    C[:, 1, 2] = C[:, 2, 1] = sine * cosine * (nn - twist)
    return C


def _edge_tensors(rods: Rods, m1: Array) -> Array:
    """Return (N, 4) compliances 11, 12, 22 against bending towards the two directors and of twist [rad/(N m)].

    Raises:
        InputError: the axis of a section lies along its edge.
    """
    of_1, of_2, twist = _compliances(rods)
    if rods.section is None or np.array_equal(of_1, of_2):
        return np.stack([of_1, 0 * of_1, of_2, twist], axis=1)
    along = rods.nodes - rods.nodes[rods.parent]
    axis = np.asarray(rods.section.axis)
    first = np.sum(axis * m1, axis=1)
    second = np.sum(axis * np.cross(along, m1), axis=1) / np.maximum(rods.lengths, 1e-300)
    wrong = np.flatnonzero(np.hypot(first, second)[1:] < 1e-3 * np.linalg.norm(axis, axis=1)[1:])
    if wrong.size:
        given = f"{axis[1 + wrong[0]]} along edge {1 + wrong[0]}"
        raise bad_input("section axis", given=given, allowed="a direction across every edge", do="Give one per edge.")
    angle = np.arctan2(second, first)
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([of_1 * c**2 + of_2 * s**2, (of_1 - of_2) * s * c, of_1 * s**2 + of_2 * c**2, twist], axis=1)


def _compliances(rods: Rods) -> tuple[Array, Array, Array]:
    """Return (N,) length / EI1, length / EI2, length / GJ of every edge [rad/(N m)]; of the unused edge 0 of edge 1."""
    section = rods.sections
    E, G = np.asarray(rods.youngs), np.asarray(rods.youngs) / (2 * np.maximum(rods.bend_over_twist, 1e-2))
    stiff = np.stack([E * section.bend_1, E * section.bend_2, G * section.torsion])
    compliances = np.concatenate([np.ones((3, 1)), rods.lengths[1:] / stiff[:, 1:]], axis=1)
    first, second, twist = compliances
    return first, second, twist


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
    before, bend = parent[tips], np.mean(_compliances(rods)[:2], axis=0)
    share = bend[tips] / bend[before]
    # a last edge much softer than the one before it would leave the latter's joint no compliance
    plain = (on[before] == tips) & (before > 0) & jointed[before] & (share < 1.2)
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


class Model(NamedTuple):
    """Constants of a tree of rods. Block j holds the four unknowns x_j (3) and the spin of edge j about its tangent.

    Block j couples to at most two blocks nearer to the root, `near` and `far`; these are coupled to each other, so
    elimination from the tips inward creates no new coupling. Normally near is the parent and far the grandparent.
    Another child of the root than the hub (the stiffest child) has near = hub and far = root: its spring joins it to
    the reversed hub edge. In planted rods every child of the root has near = root, no far, and a spring to the soil.
    """

    parent: NDArray[Any]  # (N,)
    order: NDArray[Any]  # (N,) elimination order, tips first
    near: NDArray[Any]  # (N,) -1 at the root
    far: NDArray[Any]  # (N,) -1 where edge j has no spring to a parent edge
    swapped: NDArray[Any]  # (N,) whether the spring of edge j uses the reversed hub edge
    mass: Array  # (N,) on the velocity of node j [kg]
    spin_inertia: Array  # (N,) [kg m^2]
    rotary: Array  # (N,) mass on the velocity of node j relative to its parent [kg]
    drag: Array  # (N,) [N s/m]
    weight: Array  # (N, 4) on node j [N], and the moment that spins edge j [N m], of gravity, loads, stated supports
    stretch: Array  # (N,) EA [N]
    joint: Array  # (N, 6) stiffness of the joint with the parent edge, see `joint_matrix` [N m]
    viscous: Array  # (N,) [s]
    length: Array  # (N,) natural length [m]
    curvature: Array  # (N, 2) natural curvature [-]
    natural_twist: Array  # (N,) [rad]
    soil: Array  # (N, 10) of an edge that leaves the root: the soil's direction, director; its rate [1/s], spin [rad/s]
    supports: Array  # (S, 14) node; place; stiffness (6) [N/m]; direction: acts where that . (x - place) < the last [m]
    turning: Array  # (R, 13) edge; its scanned direction and first director; stiffness (6) on its strains [N m]


class Frames(NamedTuple):
    """First material director of every edge, (N, 3), and the present twist of every spring, (N,) [rad]."""

    m1: Array
    twist: Array


def build_model(rods: Rods, gravity: ArrayLike, planted: bool = False) -> tuple[Model, Frames]:
    """Return the constants of `rods` under `gravity` (3,) [m/s^2], and the frames of the scanned shape.

    Of planted rods every edge that leaves the root is joined to the soil, which keeps its scanned direction; the rods
    bend from the root on.

    Masses are those of linear finite elements (m/3 of an edge at each end, m/6 between them), written as m/2 at each
    end and -m/6 on their relative velocity: with them the bending frequencies converge with the fourth order. The
    moment of inertia of the cross-section (Rayleigh's beam: m r^2/4) and of a lump resists the turning of the edge; its
    part along the edge is kept, so that the mass matrix is constant, and does nothing where edges hardly change their
    length.

    Raises:
        InputError: an edge folds back onto its parent edge.
    """
    built = _built(rods, planted)
    natural, forces = _natural_strains(rods, built), rods.support_forces
    model = built.model._replace(
        weight=_weight(rods, built.model.mass, gravity, forces),
        length=natural.length,
        curvature=natural.curvature,
        natural_twist=natural.twist,
        supports=springs_of(rods.supports, rods.nodes, forces),
    )
    return Model(*(np.array(a, order="C") for a in model)), Frames(*map(np.array, built.edges.frames))


class _Built(NamedTuple):
    """What of a model neither the natural shape nor gravity changes."""

    model: Model  # of the rods without weight, at rest in the scanned shape
    edges: Edges
    plain: Array  # (N, 3, 3) stiffness of the joints without supports
    changed: NDArray[Any]  # which joints are softer by supports


_BUILT: WeakKeyDictionary[Rods, dict[bool, _Built]] = WeakKeyDictionary()
"""By whether they are planted: a prediction asks three times for every plant that it draws."""


def with_natural(rods: Rods, natural: NaturalShape) -> Rods:
    """Return the rods with this natural shape; what is built of them serves both."""
    shaped = replace(rods, natural=natural)
    _BUILT[shaped] = _BUILT.setdefault(rods, {})
    return shaped


def _built(rods: Rods, planted: bool) -> _Built:
    known = _BUILT.setdefault(rods, {})
    if planted not in known:
        known[planted] = _build(rods, planted)
    return known[planted]


def _build(rods: Rods, planted: bool) -> _Built:
    edges = edges_of(rods, planted)
    joints = joint_compliance(rods, edges)
    joint = plain = joint_matrix(joints.near + joints.own, joints.kink, edges.jointed)
    held, changed, still = np.zeros((0, 13)), np.zeros(0, dtype=np.int64), np.zeros(len(rods.nodes))
    if turning_held(rods):
        compliance, held, changed = _hold_turning(rods, edges, joints)
        joint = joint_matrix(compliance, joints.kink, edges.jointed)
    section, paper = rods.sections, rods.discretisation == "paper"
    area, bends = np.asarray(section.area), np.asarray(section.bend_1) + np.asarray(section.bend_2)
    edge_mass = np.asarray(rods.density) * area * rods.lengths
    polar = np.divide(edge_mass * bends, area, out=np.zeros(len(area)), where=area > 0)
    lump = np.asarray(rods.lumped_inertia) if paper else _turning_lumps(rods)
    turning = lump if paper else lump + polar / 2
    rotary = np.divide(turning, rods.lengths**2, out=np.zeros(len(lump)), where=rods.lengths > 0)
    model = Model(
        parent=rods.parent,
        order=edges.order,
        near=edges.near,
        far=edges.far,
        swapped=edges.swapped,
        mass=rods.node_mass,
        spin_inertia=polar + lump,
        rotary=rotary if paper else rotary - edge_mass / 6,
        drag=rods.node_total_drag,
        weight=np.zeros((len(still), 4)),
        stretch=area * np.asarray(rods.youngs),
        joint=upper(joint),
        viscous=np.asarray(rods.viscous_time),
        length=rods.lengths,
        curvature=edges.curvature,
        natural_twist=still,
        soil=_soil(rods, edges.frames),
        supports=np.zeros((0, 14)),
        turning=held,
    )
    return _Built(model, edges, plain, changed)


def turning_held(rods: Rods) -> bool:
    """Return whether a support holds the rotation of a node."""
    return any(np.any(support.rotation) for support in rods.supports)


def _planted(parent: NDArray[Any], far: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return near, far and swapped of rods whose root edges are joined to the soil instead of each other."""
    return parent, np.where(parent > 0, far, -1), np.zeros(len(parent), dtype=np.bool_)


def _jointed(parent: NDArray[Any], far: NDArray[Any], planted: bool) -> NDArray[Any]:
    return (far >= 0) | (planted & (parent == 0))


def _soil(rods: Rods, frames: Frames) -> Array:
    edges = rods.nodes - rods.nodes[0]
    directions = edges / np.maximum(np.linalg.norm(edges, axis=1), 1e-300)[:, None]
    still = np.zeros((len(edges), 4))
    return np.where((rods.parent == 0)[:, None], np.hstack([directions, frames.m1, still]), 0.0)


def _weight(rods: Rods, mass: Array, gravity: ArrayLike, forces: Array) -> Array:
    """Return (N, 4) the weight and what supports exert in the scanned shape, but for the springs of one-sided ones."""
    weight = np.zeros((len(rods.nodes), 4))
    weight[:, :3] = mass[:, None] * check_array("gravity", gravity, (3,))
    for support, force in zip(rods.supports, forces, strict=True):
        if not support.one_sided:
            weight[support.node, :3] += force
    return weight


def _turning_lumps(rods: Rods) -> Array:
    """Return (N,) the moment of inertia of lumps that turns with edge j [kg m^2].

    Several lumps in line turn at the mean of the angles of the edges beside them: half of each with either.
    """
    lump, on = np.asarray(rods.lumped_inertia), line_on(rods)
    inner = np.flatnonzero((on >= 0) & (rods.parent >= 0) & ~turned_alone(rods))
    turning = lump.copy()
    turning[inner] -= lump[inner] / 2
    turning[on[inner]] += lump[inner] / 2
    return turning


def _couplings(rods: Rods) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]:
    parent, n = rods.parent, len(rods.parent)
    near = parent.copy()
    far = np.where(parent > 0, parent[parent], -1)
    swapped = np.zeros(n, dtype=np.bool_)
    children = np.flatnonzero(parent == 0)
    hub = _hub(rods, children)
    others = children[children != hub]
    near[others], far[others], swapped[others] = hub, 0, True
    order = np.array([j for j in range(n - 1, 0, -1) if j != hub] + [hub, 0])
    return near, far, swapped, order


def _hub(rods: Rods, children: NDArray[Any]) -> int:
    """Return the stiffest child of the root; where several siblings fork from it, preferably one with one child."""
    radius, youngs = np.asarray(rods.edge_radius), np.asarray(rods.youngs)
    if len(children) > 2 and rods.discretisation == "consistent":
        single = children[np.bincount(rods.parent[1:], minlength=len(radius))[children] == 1]
        children = single if len(single) else children
    return int(children[np.argmax(youngs[children] * radius[children] ** 4)])


def _rest_frames(
    nodes: Array, parent: NDArray[Any], near: NDArray[Any], far: NDArray[Any], swapped: NDArray[Any]
) -> tuple[Frames, Array]:
    edges = nodes - nodes[parent]
    edges[0] = 1
    unit = edges / np.linalg.norm(edges, axis=1, keepdims=True)
    folded = (far >= 0) & (np.einsum("ij,ij->i", unit, unit[near]) * np.where(swapped, -1, 1) < -0.9999)
    if np.any(folded):
        j = int(np.flatnonzero(folded)[0])
        raise bad_input(
            "rod nodes", given=f"edge {j} folds back onto edge {near[j]}", allowed="turns < 179 deg", do="Smooth it."
        )
    m1, curvature = np.zeros((len(nodes), 3)), np.zeros((len(nodes), 2))
    hub = int(np.flatnonzero((near == 0) & (far < 0))[0])
    _carry_frames(np.array(nodes), np.array(parent), near, far, swapped, hub, m1, curvature)
    return Frames(m1, np.zeros(len(nodes))), curvature


@compiled
def _carry_frames(
    nodes: Any, parent: Any, near: Any, far: Any, swapped: Any, hub: int, m1: Any, curvature: Any
) -> None:
    """Carry the directors from the hub edge outward, along the connectivity, and note the curvatures."""
    e = apart(nodes, hub, 0)
    side = cross(e, (0.0, 1.0, 0.0))
    if norm(side) < 1e-3 * norm(e):
        side = cross(e, (0.0, 0.0, -1.0))
    store(m1, hub, scale(1 / norm(side), side))
    for j in range(1, len(nodes)):
        if far[j] < 0:
            continue
        e, f = spring_edges(nodes, parent, near, far, swapped, j)
        te, tf = scale(1 / norm(e), e), scale(1 / norm(f), f)
        m1e = load(m1, near[j])
        m1f = spin(transport(m1e, te, tf), tf, 0.0)
        store(m1, j, m1f)
        kappa = _springs.curvatures(_springs.bent(e, f), m1e, m1f)
        curvature[j, 0], curvature[j, 1] = kappa


@inlined
def spring_edges(x: Any, parent: Any, near: Any, far: Any, swapped: Any, j: int) -> Any:
    """Return the edge vectors e (the parent edge, running towards edge j) and f (edge j) of spring j [m]."""
    e = apart(x, near[j], far[j])
    if swapped[j]:
        e = scale(-1.0, e)
    return e, apart(x, j, parent[j])


@inlined
def joint_ends(model: Model, x: Any, m1: Any, j: int) -> Any:
    """Return the edge before joint j with its director, which of a planted root are the soil's, and edge j."""
    if model.far[j] < 0:
        e, m1e = halves(model.soil, j)
        return e, m1e, apart(x, j, model.parent[j])
    e, f = spring_edges(x, model.parent, model.near, model.far, model.swapped, j)
    return e, load(m1, model.near[j]), f
