"""Skeleton: the plant as ONE rooted tree of centreline nodes with radii. J nodes, E = J - 1 edges."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from small_gicp import voxelgrid_sampling

from anther.core.checks import check_array, check_range
from anther.core.errors import StageFailure, bad_input
from anther.core.geometry import Array
from anther.core.records import Range, Record, Shape, Share, Stored
from anther.perception.cloud import Cloud
from anther.perception.masks import FLOWER
from anther.perception.skeleton._centreline import beginning, centred, extended, resample
from anther.perception.skeleton._paths import LevelSets, geodesic_tree, level_sets, middled
from anther.perception.skeleton.raw_tree import RawTree, parted, rerooted, with_extents, without_spurs, without_veins
from anther.perception.skeleton.support import distance_to_soil, find_root, node_confidence, stem_gain
from anther.perception.skeleton.thinning import thinned_tree
from anther.perception.skeleton.voxel_solid import (
    Voxels,
    VoxelSolid,
    bridges,
    components,
    nearest,
    neighbour_edges,
    point_spacing,
    solidify,
    surroundings,
    without_specks,
)

__all__ = ["Params", "Skeleton", "nearest_node", "skeletonize"]

_FEWEST_POINTS = 50
_MANY_POINTS = 80_000
_ENOUGH_POINTS = 80_000  # cross-sections of more are not better (measured on ten simulated captures)
_FINEST = 700  # a cloud of many points is thinned to one per cube of plant size / _FINEST
_MOST_VOXELS = 1500  # along the plant: with more, filled hollows take gigabytes
_REACH, _FLAT = 6.0, 0.5  # surroundings looked at [voxels], and the planarity that counts as a blade
RESOLUTION = 350.0
"""Voxels along the plant's size, where nobody gives the voxels' edge."""
CLOSE = 2
"""Gaps of up to so many voxels are closed."""
HOLLOW = 0.06
"""Stems hollow in the scan are filled up to this diameter, relative to the plant's size."""
_SURE = 0.75  # a root that is less likely is said
_BRIDGE = 0.15  # gaps up to this share of the plant's size are bridged
_SPECK = 0.02  # fragments shorter than this share of the plant's size are dropped
_SPUR_PER_WIDTH, _SPUR = 2.5, 6.0
"""Side branches shorter than the first times the half width of the organ they leave, or than the second [voxels], are
pruned."""
_VEIN = 2.5  # side branches that leave on a blade go if they hold less stem or petiole than this [voxels]
_SAME_PLACE = 10.0  # a root this close to where the paths began leaves them as they are [voxels]
_FATTENING = 0.5
"""How much farther than the radius the surface of a round organ lies from its axis in a fused cloud [pixels]: what the
matching window of a depth camera spreads it to either side (facts: perception, "Depth sensors") and fusing leaves of
that. Measured on six simulated captures (pixels of 1 mm): 0.45 for radii from 2.2 to 6 mm, 0.5 to 0.8 down to 1.3."""


@dataclass(frozen=True, slots=True)
class Params(Record):
    """How a cloud becomes a skeleton. Lengths without a unit are relative to the plant's size (its diagonal).

    Attributes:
        root: where the stem leaves the soil [m], by who knows better; None: it is found.
        method: "geodesic" (shortest paths that prefer stems, default: measured better) or "thinning" (the paper's
            P7-P9).
        voxel: voxel edge [m]; None: plant size / `RESOLUTION`, but not below 1.3 point spacings.
        spacing: distance between nodes [m]; None: plant size / 110 (6 mm on a 0.65 m plant).
        recentre: rounds of sub-voxel centring; 0 keeps the coarse tree's steps, as the paper's skeleton does.
        fattening: how much thicker the sensor makes organs [m of radius], taken off the radii; None: half a pixel
            of the cloud's footprint, 0 for a cloud without one.
    """

    root: Annotated[tuple[float, float, float], Range(-1e9, 1e9, "m")] | None = None
    method: Literal["geodesic", "thinning"] = "geodesic"
    voxel: Annotated[float, Range(1e-5, 1, "m")] | None = None
    spacing: Annotated[float, Range(1e-4, 1, "m")] | None = None
    recentre: Annotated[int, Range(0, 20)] = 2
    fattening: Annotated[float, Range(0, 0.1, "m")] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Skeleton(Stored):
    """One connected, acyclic, rooted tree. Node 0 is the root (where the stem leaves the soil).

    Every node comes after its parent, so a plain loop over the arrays walks from the root to the tips.

    Attributes:
        nodes: (J, 3) centreline positions, world frame [m].
        parent: (J,) int, index of the parent node; parent[0] = -1 and parent[j] < j.
        radius: (J,) radius at the node [m]; half the thickness where the organ is flat.
        notes: what the stage wants the user to know.
        width: (J,) half width of the organ [m]: about the radius of a stem, more of a blade; None if unknown.
        confidence: (J,) probability that the axis of a stem, branch, petiole, rachis or truss lies within 5 mm of the
            node (docs/confidence.md); None if unknown.
        flatness: (J,) 0 where the plant is round or a line around the node, 1 where it is a plane: a blade; None if
            unknown.
        root_confidence: probability that the plant stands at node 0; None if unknown.
    """

    KIND, SCHEMA, CALLED = "skeleton", 3, "skeleton"
    nodes: Annotated[Array, Shape("J", 3), Range(unit="m")]
    parent: Annotated[NDArray[np.int64], Shape("J")]
    radius: Annotated[Array, Shape("J"), Range(unit="m")]
    notes: tuple[str, ...] = ()
    width: Annotated[Array, Shape("J"), Range(unit="m")] | None = None
    confidence: Annotated[Array, Shape("J"), Range(0, 1)] | None = None
    flatness: Annotated[Array, Shape("J")] | None = None
    root_confidence: Share | None = None

    def _check(self) -> None:
        n, parent = len(self.nodes), self.parent
        ordered = n >= 2 and parent[0] == -1 and bool(np.all((parent[1:] >= 0) & (parent[1:] < np.arange(1, n))))
        if not ordered:
            raise bad_input(
                "skeleton parent",
                given=f"{n} nodes, parents {parent[:5]}...",
                allowed="at least 2 nodes, parent[0] = -1, 0 <= parent[j] < j",
                do="Order the nodes from the root outward.",
            )
        if np.any(self.radius <= 0):
            raise bad_input("skeleton radius", given="a radius <= 0", allowed="> 0 m", do="Check the radii.")

    @property
    def edges(self) -> NDArray[Any]:
        """(E, 2) node pairs (parent, child)."""
        return np.stack([self.parent[1:], np.arange(1, len(self.nodes))], axis=1)

    @property
    def children_count(self) -> NDArray[Any]:
        """(J,) number of children of each node; 0 at a tip."""
        return np.bincount(self.parent[1:], minlength=len(self.nodes))

    @property
    def breadth(self) -> Array:
        """(J,) half width of the organ [m]; the radius where nobody knows."""
        return self.radius if self.width is None else self.width

    @property
    def rooted(self) -> float:
        """Probability that the plant stands at node 0; 1 where nobody knows."""
        return 1.0 if self.root_confidence is None else self.root_confidence

    def path_from_root(self, node: int) -> NDArray[Any]:
        """Return the node indices from the root to `node`."""
        path = [node]
        while self.parent[path[-1]] >= 0:
            path.append(int(self.parent[path[-1]]))
        return np.array(path[::-1])


def skeletonize(cloud: Cloud, params: Params | None = None) -> Skeleton:
    """Return the plant's centrelines as ONE rooted tree.

    Args:
        cloud: plant points, world frame, z up [m]; points labelled as flowers are left out.
        params: one set for every plant; lengths scale with the plant.

    Raises:
        StageFailure: "no_plant_found" when there are too few points to make a tree.
        InputError: the plant's size is not that of a plant (wrong units?), or `params.root` is not on it.
    """
    params = params or Params()
    points = _plant_points(cloud)
    size = _plant_size(points)
    if len(points) > _MANY_POINTS:
        points = np.asarray(voxelgrid_sampling(points, size / _FINEST).points())[:, :3]
    if params.voxel is not None:
        check_range("voxel", params.voxel, size / _MOST_VOXELS, size / 10, "m")  # finer, hollows fill with millions
    voxel = params.voxel or max(size / RESOLUTION, 1.3 * point_spacing(points))
    solid = solidify(points, voxel, close=CLOSE, fill=HOLLOW * size)
    voxels, notes = _connected(solid, size)
    coarse, sure, doubts = _coarse_tree(voxels, size, params)
    spacing = params.spacing or size / 110
    curves = resample(coarse, stem_gain(coarse), spacing)
    fattening = _FATTENING * (cloud.footprint or 0) if params.fattening is None else params.fattening
    surface = points[:: -(-len(points) // _ENOUGH_POINTS)]
    curves = centred(curves, surface, rounds=params.recentre, fattening=fattening)
    hidden = distance_to_soil(curves.nodes[0], beginning(curves), cloud.obstacles)
    if hidden > 0:
        curves = extended(curves, hidden, spacing)
        if hidden > 5e-4:  # rounded to 1 mm or more
            notes += (f"the lowest {hidden * 1e3:.0f} mm of the stem were not seen: taken straight down to the soil",)
    flatness = coarse.flatness[nearest(curves.nodes, coarse.nodes)[1]]
    confidence = node_confidence(curves.nodes, curves.parent, curves.radius, flatness, points)
    confidence = confidence * (1 - cloud.seen_through)  # it was fitted on views that agree
    return Skeleton(
        curves.nodes, curves.parent, curves.radius, notes + doubts, curves.width, confidence, flatness, sure
    )


AWAY = 0.1
"""A place that somebody names is on the plant if it is no farther from it than this, relative to the plant's size."""


def nearest_node(name: str, place: ArrayLike, nodes: Array) -> int:
    """Return which of the nodes (J, 3) [m] is nearest to a named place (3,) [m].

    Raises:
        InputError: it is too far from all of them to be meant.
    """
    at = check_array(name, np.asarray(place, dtype=np.float64), (3,))
    gap = np.linalg.norm(nodes - at, axis=1)
    if gap.min() > AWAY * np.linalg.norm(np.ptp(nodes, axis=0)):
        low, high = nodes.min(axis=0).round(3).tolist(), nodes.max(axis=0).round(3).tolist()
        given, do = f"{at.tolist()}, {gap.min():.3g} m from the plant", "Give it in metres, z up, as in the results."
        raise bad_input(name, given=given, allowed=f"on the plant, which is from {low} to {high} m", do=do)
    return int(gap.argmin())


def _plant_points(cloud: Cloud) -> Array:
    flower = cloud.labels == FLOWER
    points = cloud.points[~flower] if np.count_nonzero(~flower) >= _FEWEST_POINTS else cloud.points
    if len(points) < _FEWEST_POINTS:
        raise StageFailure(
            "no_plant_found",
            f"skeleton: got {len(points)} plant points; allowed: {_FEWEST_POINTS} or more. "
            "Is the cloud empty or the mask wrong?",
        )
    return points


def _plant_size(points: Array) -> float:
    """Return the diagonal of the bounding box of all but the outermost 1 % of the points [m]."""
    size = float(np.linalg.norm(np.subtract(*np.quantile(points, [0.995, 0.005], axis=0))))
    if not 0.005 <= size <= 20:
        raise bad_input(
            "plant size", given=f"{size:g} m", allowed="0.005 <= size <= 20 m", do="Are the units right (m or mm)?"
        )
    return size


def _coarse_tree(voxels: Voxels, size: float, params: Params) -> tuple[RawTree, float, tuple[str, ...]]:
    """Return the tree before centring, rooted where the stem leaves the soil, how sure that is, and notes."""
    known = params.root
    if params.method == "thinning":
        tree = _pruned(_not_trivial(thinned_tree(voxels), size), voxels)
        root, sure, notes = (nearest_node("root", known, tree.nodes), 1.0, ()) if known is not None else _base(tree)
        return tree.taking(*rerooted(tree.parent, root)), sure, notes
    source = nearest_node("root", known, voxels.points) if known is not None else int(np.argmin(voxels.points[:, 2]))
    paths, levels = _paths(voxels, source, size)
    sure, notes = 1.0, ()
    if known is None:
        tree = _parted(paths, voxels)
        root, sure, notes = _base(tree)
        if np.linalg.norm(tree.nodes[root] - voxels.points[source]) > _SAME_PLACE * voxels.voxel:
            source = int(np.argmin(np.linalg.norm(voxels.points - tree.nodes[root], axis=1)))
            paths, levels = _paths(voxels, source, size)
    pruned = _pruned(paths, voxels)
    return middled(pruned, stem_gain(pruned), voxels, levels), sure, notes


def _paths(voxels: Voxels, source: int, size: float) -> tuple[RawTree, LevelSets]:
    """Return the tree of shortest paths to a voxel, and its level sets."""
    levels = level_sets(voxels, source)
    return _not_trivial(geodesic_tree(voxels, source, levels, _SPUR * voxels.voxel), size), levels


def _base(tree: RawTree) -> tuple[int, float, tuple[str, ...]]:
    """Return the node where the plant stands, how sure that is; where it is doubtful, a note that names its rival."""
    node, sure, rival = find_root(tree)
    if sure >= _SURE:
        return node, sure, ()
    x, y, z = tree.nodes[rival]
    words = f"root: with a probability of {sure:.0%}; else the plant may stand at {x:.3f},{y:.3f},{z:.3f}"
    return node, sure, (f"{words} (--root names it)",)


def _parted(tree: RawTree, voxels: Voxels) -> RawTree:
    """Return the tree without paths side by side and the shortest spurs; a stem's foot may look like a longer one."""
    tree = parted(tree, stem_gain(tree))
    return without_spurs(with_extents(tree.nodes, tree.parent, voxels), at_least=_SPUR * voxels.voxel)


def _pruned(tree: RawTree, voxels: Voxels) -> RawTree:
    """Return the tree without what is not an organ: paths side by side, spurs, veins."""
    tree = without_spurs(_parted(tree, voxels), per_width=_SPUR_PER_WIDTH)
    return without_veins(tree, _VEIN * voxels.voxel)


def _not_trivial(tree: RawTree, size: float) -> RawTree:
    if len(tree.nodes) < 2:
        raise StageFailure(
            "no_plant_found",
            f"skeleton: got specks in a space of {size:g} m; allowed: a plant in pieces not more than "
            f"{_BRIDGE * size:g} m apart. Use a denser cloud.",
        )
    return tree


def _connected(solid: VoxelSolid, size: float) -> tuple[Voxels, tuple[str, ...]]:
    """Return the voxels that can be joined into one piece, and notes."""
    points, edges = solid.points, neighbour_edges(solid.index)
    label = components(len(points), edges)
    kept = without_specks(points, label, _SPECK * size)
    label = np.where(kept, label, -1)
    links = bridges(points, label, _BRIDGE * size)
    joined = np.isin(label, np.concatenate([[0], label[links[:, 1]]]))
    rank = np.cumsum(joined) - 1
    edges = rank[np.concatenate([edges[joined[edges].all(axis=1)], links])]
    flat, off_middle = surroundings(solid.index[joined], _REACH)
    flat = np.minimum(flat / _FLAT, 1)
    voxels = Voxels(points[joined], edges, solid.voxel, solid.thickness[joined], flat, off_middle)
    return voxels, _gap_notes(points, links, joined)


def _gap_notes(points: Array, links: NDArray[Any], joined: NDArray[np.bool_]) -> tuple[str, ...]:
    notes = []
    if len(links):
        gap = np.linalg.norm(points[links[:, 0]] - points[links[:, 1]], axis=1).max()
        notes.append(f"{len(links)} gaps bridged, the widest {gap * 1e3:.1f} mm")
    lost = 1 - joined.mean()
    if lost > 0.02:
        notes.append(f"{lost:.0%} of the plant's voxels lay too far from the rest and were left out")
    return tuple(notes)
