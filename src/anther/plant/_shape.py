"""From a scanned tree to beams and masses: radius of every edge, leaf mass, pedicels. J nodes, P pedicel nodes.

Stability: the least stiffness at which the plant does not buckle, and branches stiff enough for their leaves.
"""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any, NamedTuple

import numpy as np
import scipy  # loads `scipy.stats`, which takes long, where it is used
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anther.core.geometry import Array, occupied_cells
from anther.perception.cloud import Cloud
from anther.perception.flowers import Flowers
from anther.perception.formats.skeleton_file import THINNEST
from anther.perception.masks import FLOWER
from anther.perception.skeleton import Skeleton
from anther.perception.skeleton.raw_tree import BLADE
from anther.perception.stem import Stem
from anther.rods import Clamp, Rods, least_stiffness, stands

LEAST_RADIUS = THINNEST
"""Of any stem or branch edge [m]: a pedicel's."""
PEDUNCLE_RADIUS = 1.25e-3
"""Of the stalk between a branch and a flower farther away than a pedicel is long [m] (facts [R])."""


class Pedicels(NamedTuple):
    """The modelled stalks of the flowers, to be appended to the skeleton's nodes.

    Attributes:
        nodes: (P, 3) [m].
        parent: (P,) node each hangs on: below J a skeleton node, from J on a pedicel node.
        radius: (P,) of the edge to the parent [m].
        is_pedicel: (P,) whether that edge is pedicel (True) or the unseen peduncle that carries it (False).
        tips: (F,) node of each flower.
    """

    nodes: Array
    parent: NDArray[Any]
    radius: Array
    is_pedicel: NDArray[np.bool_]
    tips: NDArray[Any]


def edge_radii(skeleton: Skeleton, stem: Stem) -> Array:
    """Return the radius (J,) of edge j, which joins the parent of j to j [m]; entry 0 repeats entry 1.

    The stem's taper is a straight line, robust against single bad radii (Theil-Sen). On a branch the radius never
    grows towards the tip and starts at most at 0.7 of what it stands on; its first edge uses the branch's
    radius, not the stem's. In a leaf blade the scan shows the blade, not the rib in it: there the radius falls in a
    straight line to nothing at the tip, never below `LEAST_RADIUS`. A tapered edge gets the radius of the uniform bar
    with the same bending compliance.

    Args:
        skeleton: gives the measured radii, and by its flatness where it runs in a blade.
        stem: which nodes are main stem.
    """
    node = np.maximum(_smooth(skeleton, stem), LEAST_RADIUS)
    node[stem.node_ids] = _stem_taper(stem, skeleton.radius)
    edge, beyond = node.copy(), _way_to_tip(skeleton)
    rib, heir, on_stem = _ribs(skeleton, stem, beyond), _heirs(skeleton, beyond), _on_main_stem(stem, len(node))
    most = 0.7  # petiole bases measure 4-6 mm on stems of 8-12 mm (facts: pollination 2 [R])
    for j in range(1, len(node)):
        p = int(skeleton.parent[j])
        if on_stem[j] and on_stem[p]:
            edge[j] = bar_radius(node[p], node[j])
            continue
        begins = on_stem[p] or heir[p] != j
        largest = (most if begins else 1.0) * node[p] * rib[j]
        node[j] = max(min(node[j], largest), LEAST_RADIUS)
        edge[j] = node[j] if begins else bar_radius(node[p], node[j])
    edge[0] = edge[1]
    return edge


def bar_radius(a: float, b: float) -> float:
    """Return the radius of the uniform bar as stiff in bending as a conical frustum of end radii a and b [m].

    The integral of 1/r^4 along the frustum is (a^2 + ab + b^2) / (3 a^3 b^3).
    """
    return float((3 * (a * b) ** 3 / (a * a + a * b + b * b)) ** 0.25)


def leaf_mass(skeleton: Skeleton, stem: Stem, cloud: Cloud, *, areal_density: float) -> Array:
    """Return the leaf mass (J,) that hangs at each node [kg]: blade area seen in the cloud times areal density.

    Points near the main stem are leaf; they weigh on their nearest branch node. The area is counted in cubes: a sheet
    of area A and apparent thickness t, turned at random, meets A (3/2 h + t) / h^3 cubes of side h (Crofton).

    Args:
        skeleton: carries the leaves.
        stem: which nodes are main stem.
        cloud: the plant's points; points labelled flower are left out.
        areal_density: of a blade [kg/m2].
    """
    mass = np.zeros(len(skeleton.nodes))
    points = _leaf_points(skeleton, stem, cloud)
    branch = np.flatnonzero(~_on_main_stem(stem, len(mass)))
    if len(points) < 10 or not len(branch):
        return mass
    h = max(0.006, 2 * _spacing(points))  # [m]; a sheet that fills its cubes
    cubes = occupied_cells(points, h)
    nearest = branch[KDTree(skeleton.nodes[branch]).query((cubes + 0.5) * h)[1]]
    area = len(cubes) * h**3 / (1.5 * h + _thickness(points))
    np.add.at(mass, nearest, areal_density * area / len(cubes))
    return mass


def hang_flowers(skeleton: Skeleton, flowers: Flowers, *, length: float, radius: float, pieces: int) -> Pedicels:
    """Return a pedicel of `length` [m] for every flower, ending at the flower's seen position.

    A flower seen nearer to its branch than that is moved out along its direction (a pedicel is as long as it is); one
    seen farther away hangs on a straight peduncle that bridges the rest.

    Args:
        skeleton: the branches.
        flowers: positions and the skeleton node that carries each.
        length, radius: of a pedicel [m].
        pieces: edges of a pedicel.
    """
    count = len(skeleton.nodes)
    stalks = [
        _stalk(skeleton, p, int(a), length, pieces) for p, a in zip(flowers.positions, flowers.attachment, strict=True)
    ]
    parent: list[int] = []
    for base, stalk in zip(flowers.attachment.tolist(), stalks, strict=True):
        first = count + len(parent)
        parent += [base, *range(first, first + len(stalk) - 1)]
    sizes = np.array([len(stalk) for stalk in stalks], dtype=int)
    from_tip = np.concatenate([np.arange(n)[::-1] for n in sizes]) if len(sizes) else np.zeros(0, dtype=int)
    is_pedicel = from_tip < pieces
    nodes = np.concatenate(stalks) if stalks else np.zeros((0, 3))
    tips = count + np.cumsum(sizes) - 1
    return Pedicels(nodes, np.array(parent, int), np.where(is_pedicel, radius, PEDUNCLE_RADIUS), is_pedicel, tips)


def _stalk(skeleton: Skeleton, position: Array, base: int, length: float, pieces: int) -> Array:
    """Return the nodes of one flower's stalk without its base: peduncle in steps of 10 mm or less, then pedicel."""
    start = skeleton.nodes[base]
    distance = float(np.linalg.norm(position - start))
    unit = (position - start) / distance if distance > 1e-3 else _outward(skeleton, base)
    back = start - skeleton.nodes[skeleton.parent[base]] if base else np.zeros(3)
    if unit @ back < -0.9 * np.linalg.norm(back):  # a stalk must not fold back onto its branch
        unit = unit + _outward(skeleton, base)
        unit /= np.linalg.norm(unit)
    gap = distance - length if distance - length > 1e-3 else 0.0
    bridge = np.linspace(0, gap, int(np.ceil(gap / 0.01)) + 1)[1:] if gap else np.zeros(0)
    pedicel = gap + length * np.arange(1, pieces + 1) / pieces
    return start + np.concatenate([bridge, pedicel])[:, None] * unit


def _heirs(skeleton: Skeleton, beyond: Array) -> NDArray[Any]:
    """Return (J,) the child of each node that carries the longest way to a tip; -1 at a tip."""
    heir = np.full(len(skeleton.nodes), -1)
    for p, j in skeleton.edges.tolist():
        if heir[p] < 0 or beyond[j] + _length(skeleton, j) > beyond[heir[p]] + _length(skeleton, int(heir[p])):
            heir[p] = j
    return heir


def in_blade(skeleton: Skeleton, stem: Stem) -> NDArray[np.bool_]:
    """Return (J,) which nodes are branch in a leaf blade: where it is flat, and all beyond; none if unknown."""
    blade = np.zeros(len(skeleton.nodes), dtype=bool)
    if skeleton.flatness is not None:
        blade = (skeleton.flatness > BLADE) & ~_on_main_stem(stem, len(blade))
        for p, j in skeleton.edges.tolist():
            blade[j] |= blade[p]
    return blade


def _ribs(skeleton: Skeleton, stem: Stem, beyond: Array) -> Array:
    """Return (J,) the largest share of its parent's radius a node may have: 1, and less and less in a blade."""
    share = np.ones(len(skeleton.nodes))
    for j in np.flatnonzero(in_blade(skeleton, stem)).tolist():
        share[j] = beyond[j] / (beyond[j] + _length(skeleton, j))
    return share


def _way_to_tip(skeleton: Skeleton) -> Array:
    """Return (J,) the longest way from each node along the tree to a tip [m]."""
    beyond = np.zeros(len(skeleton.nodes))
    for p, j in skeleton.edges[::-1].tolist():
        beyond[p] = max(beyond[p], beyond[j] + _length(skeleton, j))
    return beyond


def _length(skeleton: Skeleton, j: int) -> float:
    return float(np.linalg.norm(skeleton.nodes[j] - skeleton.nodes[skeleton.parent[j]]))


def _on_main_stem(stem: Stem, count: int) -> NDArray[np.bool_]:
    return np.isin(np.arange(count), stem.node_ids)


def _smooth(skeleton: Skeleton, stem: Stem) -> Array:
    """Return the median radius of each node, its parent and its children of the same organ."""
    on_stem = _on_main_stem(stem, len(skeleton.nodes))
    near: list[list[float]] = [[r] for r in skeleton.radius.tolist()]
    for p, j in skeleton.edges.tolist():
        if on_stem[p] == on_stem[j]:
            near[p].append(float(skeleton.radius[j]))
            near[j].append(float(skeleton.radius[p]))
    return np.array([np.median(radii) for radii in near])


def _stem_taper(stem: Stem, radius: Array) -> Array:
    """Return the stem's radius (S,) as a line that does not grow upward and ends at a quarter of the base or more."""
    r, s = radius[stem.node_ids], stem.arc_length
    fit: Any = scipy.stats.theilslopes(r, s)
    line = fit.intercept + fit.slope * s if fit.slope < 0 else np.full_like(s, np.median(r))
    return np.maximum(line, max(0.25 * line.max(), LEAST_RADIUS))


def _leaf_points(skeleton: Skeleton, stem: Stem, cloud: Cloud) -> Array:
    """Return the points that are neither flower nor near wood: main stem, and branches outside blades."""
    points = cloud.points[cloud.labels != FLOWER] if cloud.labels is not None else cloud.points
    wood = _on_main_stem(stem, len(skeleton.nodes))
    if skeleton.flatness is not None:
        wood |= skeleton.flatness <= BLADE
    nodes, radius = skeleton.nodes[wood], skeleton.radius[wood]
    if not len(points):
        return points
    distance, nearest = KDTree(nodes).query(points)
    step = float(np.diff(stem.arc_length).max())
    return points[distance > np.hypot(1.5 * radius[nearest], step / 2) + 0.002]


def _spacing(points: Array) -> float:
    """Return the median distance to the nearest other point [m], from at most 2000 points."""
    some = points[:: max(1, len(points) // 2000)]
    return float(np.median(KDTree(points).query(some, k=2)[0][:, 1]))


def _thickness(points: Array) -> float:
    """Return how thick blades look [m]: 3.5 times the rms distance of points to the plane through what is within 8 mm.

    The factor is the cubes' own, counted on noisy sheets.
    """
    some = points[:: max(1, len(points) // 500)]
    near = [points[q] for q in KDTree(points).query_ball_point(some, 0.008) if len(q) >= 10]
    off = [np.sqrt(max(np.linalg.eigvalsh(np.cov(p.T))[0], 0.0)) for p in near]
    return 3.5 * float(np.median(off)) if off else 0.0


def _outward(skeleton: Skeleton, node: int) -> Array:
    """Return a horizontal unit vector across the edge that ends at `node`."""
    along = skeleton.nodes[node] - skeleton.nodes[max(int(skeleton.parent[node]), 0)]
    side = np.cross(along, [0.0, 0.0, 1.0])
    if np.linalg.norm(side) < 1e-3 * max(float(np.linalg.norm(along)), 1e-9):
        return np.array([1.0, 0.0, 0.0])
    return side / np.linalg.norm(side)


def least_youngs(rods: Rods, clamp: Clamp, fixed: NDArray[np.bool_], stiffening: Array) -> float | None:
    """Return Young's modulus of the main stem at which the rods just stand [Pa], within 2 %; None if none helps.

    Args:
        rods: the rods; their natural shape is found anew for every value.
        clamp: what is held.
        fixed: (N,) edges that keep their own Young's modulus.
        stiffening: (N,) Young's modulus of the others over the main stem's [-].
    """

    unit = replace(rods, youngs=np.where(fixed, rods.youngs, stiffening))
    return least_stiffness(unit, clamp, fixed=fixed, between=(1e4, 1e12), within=0.02)


def branch_stiffening(
    rods: Rods,
    stem: NDArray[np.bool_],
    pedicel: NDArray[np.bool_],
    blade: NDArray[np.bool_],
    least: float,
    needs: float | None = None,
) -> Array:
    """Return (N,) factors on Young's modulus with which no leaf and no branch buckles before the main stem does.

    A scan shows a leaf's ribs too thin or not at all, yet leaves hold themselves up: what a leaf lacks is not taken for
    a stiffer plant. Leaf blades come first, then what stands on the main stem, each clamped at its base.

    Args:
        rods: tissue, leaves and flowers, of one Young's modulus but for the pedicels.
        stem, pedicel, blade: (N,) which edges are main stem, pedicel, and branch in a leaf blade.
        least: factor of every edge in a blade [-].
        needs: Young's modulus of the main stem with which its limbs are to stand [Pa]; None: the least with which it
            stands itself, which says nothing where a string holds it.
    """
    factor, rigid = np.where(blade, least, 1.0), 1e3  # takes a part out of the question whether the rest stands
    most = 10 * rigid  # a piece of a scan, in a leaf on a branch, that none of their factors holds up
    stem_needs = needs or least_youngs(rods, Clamp.root(rods), pedicel, np.where(stem, 1.0, rigid))
    if stem_needs is None:
        return factor
    youngs = np.where(pedicel, rigid * np.asarray(rods.youngs), stem_needs)
    for organ in (blade & ~blade[rods.parent], ~stem & ~pedicel & stem[rods.parent]):
        for base in np.flatnonzero(organ[1:]) + 1:
            beyond = _beyond(rods, int(base))
            if len(beyond) > 2:
                factor[beyond[1:]] *= _until_it_stands(_part(replace(rods, youngs=youngs * factor), beyond))
    return np.where(pedicel, 1.0, np.minimum(factor, most))


def _until_it_stands(branch: Rods) -> float:
    """Return a factor on Young's modulus, 1 or in steps of a fifth, with which the branch stands; 1 if none helps."""
    for factor in 1.2 ** np.arange(40):
        if stands(replace(branch, youngs=factor * np.asarray(branch.youngs)), Clamp.root(branch)):
            return float(factor)
    return 1.0


def _beyond(rods: Rods, base: int) -> NDArray[np.intp]:
    """Return the nodes of the branch that begins at `base`, after the node it stands on."""
    inside = np.zeros(len(rods.nodes), dtype=bool)
    inside[base] = True
    for j in range(base + 1, len(inside)):
        inside[j] = inside[rods.parent[j]]
    return np.concatenate([[rods.parent[base]], np.flatnonzero(inside)])


def _part(rods: Rods, nodes: NDArray[np.intp]) -> Rods:
    """Return the rods of some nodes; the first becomes the root."""
    parent = np.searchsorted(nodes, rods.parent[nodes])
    parent[0] = -1
    given = {f.name: getattr(rods, f.name) for f in fields(rods) if f.init}
    values = {name: value[nodes] for name, value in given.items() if isinstance(value, np.ndarray)}
    number = {int(node): k for k, node in enumerate(nodes)}
    supports = [replace(s, node=number[s.node]) for s in rods.supports if number.get(s.node, 0) > 0]
    return replace(rods, **values | {"parent": parent, "supports": tuple(supports)}, natural=None)
