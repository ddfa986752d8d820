"""From a scanned tree to beams and masses: radius of every edge, leaf mass, pedicels. J nodes, P pedicel nodes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.stats import theilslopes

from anther.cloud import Cloud
from anther.flowers import Flowers
from anther.geometry import Array
from anther.masks import FLOWER
from anther.skeleton import Skeleton
from anther.stem import Stem


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


def edge_radii(skeleton: Skeleton, stem: Stem, *, branch_share: float, least: float) -> Array:
    """Return the radius (J,) of edge j, which joins the parent of j to j [m]; entry 0 repeats entry 1.

    The stem's taper is a straight line, robust against single bad radii (Theil-Sen). On a branch the radius never
    grows towards the tip and starts at most at `branch_share` of the stem's, so that a leaf blade, which looks thick,
    does not become a thick beam; a branch's first edge uses the branch's radius, not the stem's. A tapered edge gets
    the radius of the uniform bar with the same bending compliance.

    Args:
        skeleton: gives the measured radii.
        stem: which nodes are main stem.
        branch_share: largest radius of a branch at its base, as a share of the stem's there [-].
        least: smallest radius [m].
    """
    node = np.maximum(_smooth(skeleton, stem), least)
    node[stem.node_ids] = _stem_taper(stem, skeleton.radius, least)
    edge = node.copy()
    on_stem = _on_main_stem(stem, len(node))
    for j in range(1, len(node)):
        p = int(skeleton.parent[j])
        if on_stem[j] and on_stem[p]:
            edge[j] = bar_radius(node[p], node[j])
        elif on_stem[p]:
            edge[j] = node[j] = max(min(node[j], branch_share * node[p]), least)
        else:
            node[j] = min(node[j], node[p])
            edge[j] = bar_radius(node[p], node[j])
    edge[0] = edge[1]
    return edge


def bar_radius(a: float, b: float) -> float:
    """Return the radius of the uniform bar as stiff in bending as a conical frustum of end radii a and b [m].

    The integral of 1/r^4 along the frustum is (a^2 + ab + b^2) / (3 a^3 b^3).
    """
    return float((3 * (a * b) ** 3 / (a * a + a * b + b * b)) ** 0.25)


def leaf_mass(
    skeleton: Skeleton, stem: Stem, cloud: Cloud, *, areal_density: float, voxel: float, thickness: float
) -> Array:
    """Return the leaf mass (J,) that hangs at each node [kg]: blade area seen in the cloud times areal density.

    Points beside the main stem are leaf; they weigh on their nearest branch node. The area is counted in cubes: a sheet
    of area A and apparent thickness t, turned at random, meets A (3/2 h + t) / h^3 cubes of side h (Crofton).

    Args:
        skeleton: carries the leaves.
        stem: which nodes are main stem.
        cloud: the plant's points; points labelled flower are left out.
        areal_density: of a blade [kg/m2].
        voxel: side h of the cubes [m]; larger where the cloud is sparser.
        thickness: apparent thickness t of a blade, from depth noise [m].
    """
    mass = np.zeros(len(skeleton.nodes))
    points = _leaf_points(skeleton, stem, cloud)
    branch = np.flatnonzero(~_on_main_stem(stem, len(mass)))
    if len(points) < 10 or not len(branch):
        return mass
    h = max(voxel, 2 * _spacing(points))
    cubes = np.unique(np.floor(points / h).astype(np.int64), axis=0)
    nearest = branch[KDTree(skeleton.nodes[branch]).query((cubes + 0.5) * h)[1]]
    area = len(cubes) * h**3 / (1.5 * h + thickness)
    np.add.at(mass, nearest, areal_density * area / len(cubes))
    return mass


def hang_flowers(
    skeleton: Skeleton, flowers: Flowers, *, length: float, radius: float, peduncle_radius: float, pieces: int
) -> Pedicels:
    """Return a pedicel of `length` [m] for every flower, ending at the flower's seen position.

    A flower seen nearer to its branch than that is moved out along its direction (a pedicel is as long as it is); one
    seen farther away hangs on a straight peduncle that bridges the rest.

    Args:
        skeleton: the branches.
        flowers: positions and the skeleton node that carries each.
        length, radius: of a pedicel [m].
        peduncle_radius: of the stalk that bridges a longer gap [m].
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
    return Pedicels(nodes, np.array(parent, int), np.where(is_pedicel, radius, peduncle_radius), is_pedicel, tips)


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


def _on_main_stem(stem: Stem, count: int) -> NDArray[np.bool_]:
    on_stem = np.zeros(count, dtype=bool)
    on_stem[stem.node_ids] = True
    return on_stem


def _smooth(skeleton: Skeleton, stem: Stem) -> Array:
    """Return the median radius of each node, its parent and its children of the same organ."""
    on_stem = _on_main_stem(stem, len(skeleton.nodes))
    near: list[list[float]] = [[r] for r in skeleton.radius.tolist()]
    for p, j in skeleton.edges.tolist():
        if on_stem[p] == on_stem[j]:
            near[p].append(float(skeleton.radius[j]))
            near[j].append(float(skeleton.radius[p]))
    return np.array([np.median(radii) for radii in near])


def _stem_taper(stem: Stem, radius: Array, least: float) -> Array:
    """Return the stem's radius (S,) as a line that does not grow upward and ends at a quarter of the base or more."""
    r, s = radius[stem.node_ids], stem.arc_length
    fit: Any = theilslopes(r, s)
    line = fit.intercept + fit.slope * s if fit.slope < 0 else np.full_like(s, np.median(r))
    return np.maximum(line, max(0.25 * line.max(), least))


def _leaf_points(skeleton: Skeleton, stem: Stem, cloud: Cloud) -> Array:
    points = cloud.points[cloud.labels != FLOWER] if cloud.labels is not None else cloud.points
    nodes, radius = skeleton.nodes[stem.node_ids], skeleton.radius[stem.node_ids]
    if not len(points):
        return points
    distance, nearest = KDTree(nodes).query(points)
    step = float(np.diff(stem.arc_length).max())
    return points[distance > np.hypot(1.5 * radius[nearest], step / 2) + 0.002]


def _spacing(points: Array) -> float:
    """Return the median distance to the nearest other point [m], from at most 2000 points."""
    some = points[:: max(1, len(points) // 2000)]
    return float(np.median(KDTree(points).query(some, k=2)[0][:, 1]))


def _outward(skeleton: Skeleton, node: int) -> Array:
    """Return a horizontal unit vector across the edge that ends at `node`."""
    along = skeleton.nodes[node] - skeleton.nodes[max(int(skeleton.parent[node]), 0)]
    side = np.cross(along, [0.0, 0.0, 1.0])
    if np.linalg.norm(side) < 1e-3 * max(float(np.linalg.norm(along)), 1e-9):
        return np.array([1.0, 0.0, 0.0])
    return side / np.linalg.norm(side)
