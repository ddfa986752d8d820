"""Skeleton: the plant as ONE rooted tree of centreline nodes with radii. J nodes, E = J - 1 edges."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from small_gicp import voxelgrid_sampling

from anther.core.checks import check_array, check_range
from anther.core.errors import StageFailure, bad_input
from anther.core.geometry import Array, transform_points
from anther.core.records import Range, Record, Shape, Share, Stored
from anther.perception.cloud import Cloud
from anther.perception.masks import FLOWER
from anther.perception.skeleton._centreline import centre_curves, extend_to_soil, resample, start_direction
from anther.perception.skeleton._paths import LevelSets, centre_on_blades, geodesic_tree, level_sets
from anther.perception.skeleton.plants import Plants, find_plants
from anther.perception.skeleton.raw_tree import (
    RawTree,
    remove_spurs,
    remove_veins,
    reroot,
    separate_branches,
    with_extents,
)
from anther.perception.skeleton.support import distance_to_soil, find_root, node_confidence, stem_gain
from anther.perception.skeleton.thinning import thinned_tree
from anther.perception.skeleton.voxel_solid import (
    Voxels,
    VoxelSolid,
    bridges,
    components,
    mark_fragments,
    nearest,
    neighbour_edges,
    point_spacing,
    solidify,
    surroundings,
)

__all__ = ["Params", "Plants", "Skeleton", "find_plants", "nearest_node", "skeletonize"]

FEWEST_POINTS = 50
"""A plant of fewer points has no skeleton."""
SMALLEST, LARGEST = 0.005, 20.0
"""Whatever is smaller or larger is no plant [m], but one in other units: a seedling in mm read as metres, a tree."""
ENOUGH_POINTS = 80_000
"""Points beyond these cost time and change no decision; a cloud of more is thinned."""
RESOLUTION = 350.0
"""Voxels along the plant's size by default; a cloud is thinned to twice as many points along it."""
_BRIDGE = 0.15  # gaps up to this share of the plant's size are bridged
_SPUR = 6.0  # side branches shorter than this are pruned [voxels]


@dataclass(frozen=True, slots=True)
class Params(Record):
    """How a cloud becomes a skeleton. Lengths without a unit are relative to the plant's size (its diagonal).

    Attributes:
        root: where the asked plant's stem leaves the soil [m], if known; None: it is found.
        plant: which plant, if several stand in view, in the order of `plants.Plants`; None: the one that `root` names,
            else the one in the middle.
        method: "geodesic" (shortest paths that prefer stems, default: measured better) or "thinning" (the paper's
            P7-P9).
        voxel: voxel edge [m]; None: plant size / `RESOLUTION`, but not below 1.3 point spacings.
        spacing: distance between nodes [m]; None: plant size / 110 (6 mm on a 0.65 m plant).
        recentre: rounds of sub-voxel centring; 0 keeps the coarse tree's steps, as the paper's skeleton does.
        fattening: how much thicker the sensor makes organs [m of radius], taken off the radii; None: half a pixel
            of the cloud's footprint, which the matching window of a depth camera spreads a surface to either side
            (facts: perception, "Depth sensors"); 0 for a cloud without one.
    """

    root: Annotated[tuple[float, float, float], Range(-1e9, 1e9, "m")] | None = None
    plant: Annotated[int, Range(0, 1e6)] | None = None
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
        root_confidence: probability that node 0 is the stem's base; None if unknown.
        neighbours: (M, 3) along the stems of other plants in view, coarsely [m].
    """

    KIND, SCHEMA, CALLED = "skeleton", 4, "skeleton"
    nodes: Annotated[Array, Shape("J", 3), Range(unit="m")]
    parent: Annotated[NDArray[np.int64], Shape("J")]
    radius: Annotated[Array, Shape("J"), Range(unit="m")]
    notes: tuple[str, ...] = ()
    width: Annotated[Array, Shape("J"), Range(unit="m")] | None = None
    confidence: Annotated[Array, Shape("J"), Range(0, 1)] | None = None
    flatness: Annotated[Array, Shape("J")] | None = None
    root_confidence: Share | None = None
    neighbours: Annotated[Array, Shape("M", 3), Range(unit="m")] = field(default_factory=lambda: np.zeros((0, 3)))

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

    def moved(self, T: Array) -> Skeleton:
        """Return it moved by T (4, 4)."""
        return replace(self, nodes=transform_points(T, self.nodes), neighbours=transform_points(T, self.neighbours))

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
        """(J,) half width of the organ [m]; the radius if unknown."""
        return self.radius if self.width is None else self.width

    @property
    def rooted(self) -> float:
        """Probability that node 0 is the stem's base; 1 if unknown."""
        return 1.0 if self.root_confidence is None else self.root_confidence

    def path_from_root(self, node: int) -> NDArray[Any]:
        """Return the node indices from the root to `node`."""
        path = [node]
        while self.parent[path[-1]] >= 0:
            path.append(int(self.parent[path[-1]]))
        return np.array(path[::-1])


def skeletonize(cloud: Cloud, params: Params | None = None, middle: ArrayLike | None = None) -> Skeleton:
    """Return the centrelines of the plant that is asked for as ONE rooted tree.

    Args:
        cloud: plant points, world frame, z up [m]; points labelled as flowers are left out. Where several plants
            stand in it, only what grows from the asked stem is looked at (`plants.find_plants`).
        params: one set for every plant; lengths scale with the plant.
        middle: of the workspace (3,) [m]: of several plants the one there is asked for, unless `params` names one.

    Raises:
        StageFailure: "no_plant_found" when there are too few points to make a tree.
        InputError: the plant's size is not that of a plant (wrong units?), `params.root` is on no stem or between two,
            or there is no such `params.plant`.
    """
    params = params or Params()
    points = _plant_points(cloud)
    size = _plant_size(points)
    points = points[np.abs(points - np.median(points, axis=0)).max(axis=1) <= LARGEST]  # strays no grid holds
    scene = _thinned(points, float(np.subtract(*np.quantile(points[:, 2], [0.995, 0.005]))))  # as fine as of one plant
    plants = find_plants(scene, params.root, params.plant, middle)
    if len(plants) > 1:
        points = scene[plants.owner == plants.asked]
        size, params = _plant_size(points), replace(params, root=tuple(plants.root.tolist()))
    points = _thinned(points, size)
    if params.voxel is not None:
        check_range("voxel", params.voxel, size / 1500, size / 10, "m")  # finer, filled hollows take gigabytes
    voxel = params.voxel or max(size / RESOLUTION, 1.3 * point_spacing(points))
    solid = solidify(points, voxel, close=2, fill=0.06 * size)  # the widest stem that is hollow in a scan
    voxels, notes = _connected(solid, size)
    coarse, sure, warnings = _coarse_tree(voxels, size, params)
    spacing = params.spacing or size / 110
    curves = resample(coarse, stem_gain(coarse), spacing)
    fattening = 0.5 * (cloud.footprint or 0) if params.fattening is None else params.fattening
    surface = points[:: -(-len(points) // ENOUGH_POINTS)]
    curves = centre_curves(curves, surface, rounds=params.recentre, fattening=fattening)
    hidden = distance_to_soil(curves.nodes[0], start_direction(curves), cloud.obstacles)
    if hidden > 0:
        curves = extend_to_soil(curves, hidden, spacing)
        if hidden > 5e-4:  # rounded to 1 mm or more
            notes += (f"the lowest {hidden * 1e3:.0f} mm of the stem were not seen: taken straight down to the soil",)
    flatness = coarse.flatness[nearest(curves.nodes, coarse.nodes)[1]]
    confidence = node_confidence(curves.nodes, curves.parent, curves.radius, flatness, points)
    confidence = confidence * (1 - cloud.seen_through)  # it was fitted on views that agree
    notes, sure = plants.notes + notes + warnings, sure * plants.certain
    neighbours = np.concatenate([np.zeros((0, 3)), *(way for k, way in enumerate(plants.stems) if k != plants.asked)])
    tree = curves.nodes, curves.parent, curves.radius
    return Skeleton(*tree, notes, curves.width, confidence, flatness, sure, neighbours)


def nearest_node(name: str, place: ArrayLike, nodes: Array) -> int:
    """Return which of the nodes (J, 3) [m] is nearest to a named place (3,) [m].

    Raises:
        InputError: it is farther from all of them than a tenth of the plant's size.
    """
    at = check_array(name, np.asarray(place, dtype=np.float64), (3,))
    gap = np.linalg.norm(nodes - at, axis=1)
    if gap.min() > 0.1 * np.linalg.norm(np.ptp(nodes, axis=0)):
        low, high = nodes.min(axis=0).round(3).tolist(), nodes.max(axis=0).round(3).tolist()
        given, do = f"{at.tolist()}, {gap.min():.3g} m from the plant", "Give it in metres, z up, as in the results."
        raise bad_input(name, given=given, allowed=f"on the plant, which is from {low} to {high} m", do=do)
    return int(gap.argmin())


def _plant_points(cloud: Cloud) -> Array:
    flower = cloud.labels == FLOWER
    points = cloud.points[~flower] if np.count_nonzero(~flower) >= FEWEST_POINTS else cloud.points
    if len(points) < FEWEST_POINTS:
        raise StageFailure(
            "no_plant_found",
            f"skeleton: got {len(points)} plant points; allowed: {FEWEST_POINTS} or more. "
            "Is the cloud empty or the mask wrong?",
        )
    return points


def _thinned(points: Array, size: float) -> Array:
    """Return the points, if they are more than enough no denser than a plant of this size [m] needs."""
    if len(points) <= ENOUGH_POINTS:
        return points
    return np.asarray(voxelgrid_sampling(points, max(size, SMALLEST) / (2 * RESOLUTION)).points())[:, :3]


def _plant_size(points: Array) -> float:
    """Return the diagonal of the bounding box of all but the outermost 1 % of the points [m]."""
    size = float(np.linalg.norm(np.subtract(*np.quantile(points, [0.995, 0.005], axis=0))))
    if not SMALLEST <= size <= LARGEST:
        allowed = f"{SMALLEST:g} <= size <= {LARGEST:g} m"
        raise bad_input("plant size", given=f"{size:g} m", allowed=allowed, do="Are the units right (m or mm)?")
    return size


def _coarse_tree(voxels: Voxels, size: float, params: Params) -> tuple[RawTree, float, tuple[str, ...]]:
    """Return the tree before centring, rooted where the stem leaves the soil, how sure that is, and notes."""
    known = params.root
    if params.method == "thinning":
        tree = _prune(_separate(_not_trivial(thinned_tree(voxels), size), voxels), voxels)
        root, sure, notes = (nearest_node("root", known, tree.nodes), 1.0, ()) if known is not None else _base(tree)
        return tree.taking(*reroot(tree.parent, root)), sure, notes
    source = nearest_node("root", known, voxels.points) if known is not None else int(np.argmin(voxels.points[:, 2]))
    paths, levels = _paths(voxels, source, size)
    separate, sure, notes = _separate(paths, voxels), 1.0, ()
    if known is None:
        root, sure, notes = _base(separate)
        if np.linalg.norm(separate.nodes[root] - voxels.points[source]) > 10 * voxels.voxel:
            source = int(np.argmin(np.linalg.norm(voxels.points - separate.nodes[root], axis=1)))
            paths, levels = _paths(voxels, source, size)
            separate = _separate(paths, voxels)
    pruned = _prune(separate, voxels)
    return centre_on_blades(pruned, stem_gain(pruned), voxels, levels), sure, notes


def _paths(voxels: Voxels, source: int, size: float) -> tuple[RawTree, LevelSets]:
    """Return the tree of shortest paths to a voxel, and its level sets."""
    levels = level_sets(voxels, source)
    return _not_trivial(geodesic_tree(voxels, source, levels, _SPUR * voxels.voxel), size), levels


def _base(tree: RawTree) -> tuple[int, float, tuple[str, ...]]:
    """Return the stem's base node, its probability and, if that is low, a note that names the second candidate."""
    node, sure, rival = find_root(tree)
    if sure >= 0.75:
        return node, sure, ()
    x, y, z = tree.nodes[rival]
    words = f"root: probability {sure:.0%}; the second candidate is {x:.3f},{y:.3f},{z:.3f}"
    return node, sure, (f"{words} (set it with --root)",)


def _separate(tree: RawTree, voxels: Voxels) -> RawTree:
    """Return the tree without parallel paths and the shortest spurs; longer ones may be the stem's foot."""
    tree = separate_branches(tree, stem_gain(tree))
    return remove_spurs(with_extents(tree.nodes, tree.parent, voxels), at_least=_SPUR * voxels.voxel)


def _prune(tree: RawTree, voxels: Voxels) -> RawTree:
    """Return a tree of separate branches without what is not an organ: spurs, veins."""
    tree = remove_spurs(tree, per_width=2.5)  # a line within the organ that it leaves is no limb
    return remove_veins(tree, 2.5 * voxels.voxel)


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
    kept = mark_fragments(points, label, 0.02 * size)
    label = np.where(kept, label, -1)
    links = bridges(points, label, _BRIDGE * size)
    joined = np.isin(label, np.concatenate([[0], label[links[:, 1]]]))
    rank = np.cumsum(joined) - 1
    edges = rank[np.concatenate([edges[joined[edges[:, 0]] & joined[edges[:, 1]]], links])]
    flat, off_middle = surroundings(solid.index[joined], reach=6)  # [voxels]; a guess that matters
    flat = np.minimum(2 * flat, 1)  # a planarity of one half is a blade; matters too
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
