"""Traits of a plant for phenotyping: the main stem, its internodes, and what leaves it. All in SI units and degrees."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, KDTree, QhullError

from anther.core.choices import Species
from anther.core.errors import StageFailure
from anther.core.geometry import Array
from anther.perception.blades import Blade, measure_blades, together
from anther.perception.cloud import Cloud
from anther.perception.skeleton import Skeleton
from anther.perception.skeleton.raw_tree import edge_lengths, sum_above
from anther.perception.stem import LEAF, ORGAN_NAMES, STEM, Stem

LEVELS = (10, 25, 50, 75, 90)
"""Where the stem's radius is given [% of its length]."""


class Limb(NamedTuple):
    """What leaves the main stem.

    Attributes:
        organ: "branch", "truss" or "leaf": what most of its length is.
        arc_length_m: where on the stem.
        length_m: of its longest way, from the stem's axis to a tip.
        total_length_m: of all its axes.
        radius_m: median radius of its first 30 mm.
        angle_deg: between the stem's upward direction there and the limb's first 30 mm.
        azimuth_deg: of that piece about the vertical, from x to y, in [0, 360).
        width_m, area_m2, coverage: of its blades (`blades.Blade`); NaN without a blade, without a cloud, and where the
            points are too few.
    """

    organ: str
    arc_length_m: float
    length_m: float
    total_length_m: float
    radius_m: float
    angle_deg: float
    azimuth_deg: float
    width_m: float = np.nan
    area_m2: float = np.nan
    coverage: float = np.nan


class Traits(NamedTuple):
    """What is measured of one plant.

    Attributes:
        plant_height_m: from the root to the highest node.
        stem_length_m: along the main stem.
        stem_lean_deg: of the line from its root to its top, off the vertical.
        radius_m, radius_spread_m: (5,) median radius of the stem about each of `LEVELS`; half of the range that holds
            the middle 68 % of the radii there.
        internode_m: (I,) distances along the stem from one place where something leaves it to the next.
        limbs: what leaves it, root first.
        tips: ends of the skeleton, the stem's own too.
        total_length_m: of all axes of the skeleton.
        stem_confidence: see `Stem.confidence`; None if unknown.
        leaf_area_m2, leaf_coverage: of the limbs' blades; NaN without a cloud or where none can be measured; without
            blades the area is 0.
        notes: which of them could not be measured.
    """

    plant_height_m: float
    stem_length_m: float
    stem_lean_deg: float
    radius_m: Array
    radius_spread_m: Array
    internode_m: Array
    limbs: tuple[Limb, ...]
    tips: int
    total_length_m: float
    stem_confidence: float | None
    leaf_area_m2: float = np.nan
    leaf_coverage: float = np.nan
    notes: tuple[str, ...] = ()

    def count(self, organ: str) -> int:
        """Return how many limbs are "branch", "truss" or "leaf"."""
        return sum(limb.organ == organ for limb in self.limbs)


def measure(skeleton: Skeleton, stem: Stem, cloud: Cloud | None = None) -> Traits:
    """Return the traits of a plant; only what `Stem.attachments` names counts as a limb. Blades need its cloud."""
    length = edge_lengths(skeleton.nodes, skeleton.parent)
    line, arc = skeleton.nodes[stem.node_ids], stem.arc_length
    on_stem = np.zeros(len(length), dtype=bool)
    on_stem[stem.node_ids] = True
    origin = _origins(skeleton.parent, on_stem)
    way = sum_above(skeleton.parent, np.where(on_stem, 0, length))
    position = {int(node): k for k, node in enumerate(stem.node_ids)}
    wanted = {int(stem.node_ids[k]) for k in stem.attachments}
    found = {} if cloud is None else measure_blades(skeleton, stem, cloud)
    limbs, leaves = list[Limb](), list[Blade]()
    for base in np.flatnonzero(~on_stem & np.isin(skeleton.parent, list(wanted))):
        nodes = np.flatnonzero(origin == base)
        own = [found[j] for j in nodes.tolist() if j in found]
        limb = _limb(skeleton, stem, length, way, nodes, position[int(skeleton.parent[base])])
        limbs.append(limb._replace(**together(own)._asdict()))
        leaves += own
    whole, unseen = together(leaves), sum(bool(np.isnan(blade.area_m2)) for blade in leaves)
    rise = line[-1] - line[0]
    places = np.unique(arc[np.sort(stem.attachments)])
    about = np.array([_radius_about(skeleton.radius[stem.node_ids], arc, share / 100) for share in LEVELS])
    return Traits(
        plant_height_m=float(skeleton.nodes[:, 2].max() - line[0, 2]),
        stem_length_m=float(arc[-1] - arc[0]),
        stem_lean_deg=float(np.degrees(np.arctan2(np.linalg.norm(rise[:2]), rise[2]))),
        radius_m=about[:, 0],
        radius_spread_m=about[:, 1],
        internode_m=np.diff(places),
        limbs=tuple(sorted(limbs, key=lambda limb: limb.arc_length_m)),
        tips=int((skeleton.children_count == 0).sum()),
        total_length_m=float(length.sum()),
        stem_confidence=stem.confidence,
        leaf_area_m2=whole.area_m2 if leaves or cloud is None else 0.0,
        leaf_coverage=whole.coverage,
        notes=(f"blades too thinly seen to measure: {unseen} of {len(leaves)}",) if unseen else (),
    )


def _origins(parent: NDArray[np.int64], on_stem: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return (J,) for each node off the stem the first one of its limb, else -1."""
    origin = np.full(len(parent), -1)
    for j in np.flatnonzero(~on_stem):
        origin[j] = j if parent[j] < 0 or on_stem[parent[j]] else origin[parent[j]]
    return origin


def _limb(skeleton: Skeleton, stem: Stem, length: Array, way: Array, nodes: NDArray[np.int64], at: int) -> Limb:
    """Return the limb of these nodes, its first one first, that leaves the stem at its position `at`.

    `length` (J,) is of the edge above each node, `way` (J,) from the stem to it [m].
    """
    tip = int(nodes[way[nodes].argmax()])
    axis = np.intersect1d(skeleton.path_from_root(tip), nodes)
    reach = 0.03  # m of a limb's first stretch, whose angle is the insertion's
    first = axis[: max(np.count_nonzero(way[axis] <= reach), 1)]
    out = skeleton.nodes[first[-1]] - skeleton.nodes[stem.node_ids[at]]
    below, above = skeleton.nodes[stem.node_ids[[max(at - 2, 0), min(at + 2, len(stem.node_ids) - 1)]]]
    up = above - below
    share = np.bincount(stem.organ[nodes], weights=length[nodes], minlength=LEAF + 1)
    cosine = float(out @ up / max(np.linalg.norm(out) * np.linalg.norm(up), 1e-12))
    return Limb(
        ORGAN_NAMES[int(share.argmax())],
        float(stem.arc_length[at]),
        float(way[tip]),
        float(length[nodes].sum()),
        float(np.median(skeleton.radius[first])),
        float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))),
        float(np.degrees(np.arctan2(out[1], out[0])) % 360),
    )


def _radius_about(radius: Array, arc: Array, share: float) -> tuple[float, float]:
    """Return the median radius of the stem's tenth about a share of its length, and its spread [m]."""
    away = np.abs((arc - arc[0]) / (arc[-1] - arc[0]) - share)
    low, middle, high = np.quantile(radius[away <= max(0.05, float(away.min()))], [0.16, 0.5, 0.84])
    return float(middle), float(high - low) / 2


def organs_of(stem: Stem, species: Species | None) -> Stem:
    """Return the stem with the organs of a species: of maize every limb is a leaf; else by their shape."""
    if species != "maize":
        return stem
    return replace(stem, organ=np.where(stem.organ == STEM, STEM, LEAF).astype(np.uint8))


class CloudTraits(NamedTuple):
    """What is measured of a plant's points, without a skeleton.

    Attributes:
        plant_width_m: largest horizontal distance between two points.
        projected_area_m2: of the plant seen from above: cells of `cell_m` that hold a point.
        cell_m: twice the median distance from a point to the nearest one.
        hull_area_m2: of the convex hull seen from above.
        hull_volume_m3: of the convex hull.
        green_leaf_index: mean of (2 G - R - B) / (2 G + R + B) over the points, -1 to 1; None without colours.
        hue_deg: circular mean of the points' hue, weighted by their saturation; 120 is green; None without colours.
    """

    plant_width_m: float
    projected_area_m2: float
    cell_m: float
    hull_area_m2: float
    hull_volume_m3: float
    green_leaf_index: float | None
    hue_deg: float | None


def measure_cloud(cloud: Cloud) -> CloudTraits:
    """Return the traits of a plant's points (N, 3), z up.

    Raises:
        StageFailure: kind "no_plant_found": the points lie in a plane, so that they have no hull.
    """
    points = cloud.points
    try:
        flat, whole = ConvexHull(points[:, :2]), ConvexHull(points)
    except QhullError as error:
        raise StageFailure(
            "no_plant_found", "traits: all points lie in a plane. Is this a cloud of a plant?"
        ) from error
    rim = points[flat.vertices, :2]
    sample = points[:: max(len(points) // 2000, 1)]
    cell = 2 * float(np.median(KDTree(points).query(sample, k=2)[0][:, 1])) or 1e-4  # [m], where points repeat
    taken = np.unique(np.floor(points[:, :2] / cell).astype(np.int64), axis=0)
    colours = (None, None) if cloud.colors is None else _colour_indices(cloud.colors.astype(np.float64))
    width = float(np.linalg.norm(rim[:, None] - rim[None], axis=-1).max())
    return CloudTraits(width, len(taken) * cell**2, cell, float(flat.volume), float(whole.volume), *colours)


def _colour_indices(rgb: Array) -> tuple[float, float]:
    r, g, b = rgb.T
    index = (2 * g - r - b) / np.maximum(2 * g + r + b, 1.0)
    chroma = (r - 0.5 * (g + b)) + 1j * np.sqrt(0.75) * (g - b)  # length and angle: chroma and hue
    return float(index.mean()), float(np.degrees(np.angle(chroma.mean())) % 360)
