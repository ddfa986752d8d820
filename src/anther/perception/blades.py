"""Blades of leaves: width across the midrib and one-sided area, in the blade's own surface, from the points near it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anther.core.geometry import Array, arc_length
from anther.perception.cloud import Cloud
from anther.perception.masks import FLOWER
from anther.perception.skeleton import Skeleton
from anther.perception.skeleton.raw_tree import edge_lengths, sum_above
from anther.perception.skeleton.voxel_solid import point_spacing
from anther.perception.stem import LEAF, Stem


class Blade(NamedTuple):
    """One blade, NaN where too thinly seen.

    Attributes:
        width_m: greatest width across the midrib, along the surface.
        area_m2: one-sided: sum of the slices' widths times their lengths along the midrib.
        coverage: share of the area where points are; what one side of the midrib has more than the other counts as
            not seen on that other side, and in `area_m2` not at all.
    """

    width_m: float
    area_m2: float
    coverage: float


UNSEEN = Blade(np.nan, np.nan, np.nan)


def first_of_blade(skeleton: Skeleton, stem: Stem) -> NDArray[np.int64]:
    """Return (J,) for each leaf node the first one of its blade, else -1; veins that part in a blade are of it."""
    first = np.where(stem.organ == LEAF, np.arange(len(stem.organ)), -1)
    for j in np.flatnonzero(first > 0):
        first[j] = first[skeleton.parent[j]] if first[skeleton.parent[j]] >= 0 else j
    return first


def measure_blades(skeleton: Skeleton, stem: Stem, cloud: Cloud) -> dict[int, Blade]:
    """Return the blades by their first node. A point is of the blade whose node is nearest, and not of wood near it."""
    first, length = first_of_blade(skeleton, stem), edge_lengths(skeleton.nodes, skeleton.parent)
    points = cloud.points if cloud.labels is None else cloud.points[cloud.labels != FLOWER]
    wood = np.flatnonzero(first < 0)
    away, near = KDTree(skeleton.nodes[wood]).query(points)
    points = points[away > np.hypot(1.5 * skeleton.radius[wood[near]], np.median(length[1:]) / 2)]
    owner = first[KDTree(skeleton.nodes).query(points)[1]] if len(points) else np.zeros(0, dtype=np.int64)
    way, found = sum_above(skeleton.parent, length), dict[int, Blade]()
    for base in np.unique(first[first >= 0]):
        nodes = np.flatnonzero(first == base)
        path = skeleton.path_from_root(int(nodes[way[nodes].argmax()]))
        midrib = skeleton.nodes[path[max(int(np.flatnonzero(path == base)[0]) - 1, 0) :]]
        found[int(base)] = measure_blade(points[owner == base], midrib)
    return found


def together(blades: list[Blade]) -> Blade:
    """Return the greatest width, the whole area, and the coverage of it, of those blades that are seen."""
    seen = [blade for blade in blades if np.isfinite(blade.area_m2)]
    if not seen:
        return UNSEEN
    width, area, coverage = np.array(seen).T
    return Blade(float(width.max()), float(area.sum()), float(np.average(coverage, weights=area)))


def measure_blade(points: Array, midrib: Array) -> Blade:
    """Return what a blade's points (N, 3) say of it, cut along its midrib (M, 3), M >= 2, base first."""
    points = np.unique(points, axis=0)
    fewest, most = 5, 24  # slices: an ellipse in 5 is 3 % too large, in 24 less than 1 %
    points_each = 40  # on average in a slice: one point beyond either end of its middle
    count = min(len(points) // points_each, most)
    if count < fewest:
        return UNSEEN
    line, arc, tangent = _smooth(midrib)
    near = KDTree(line).query(points)[1]
    along = arc[near] + np.einsum("ij,ij->i", points - line[near], tangent[near])
    low, high = np.quantile(along, [0.005, 0.995])
    edges, spacing = np.linspace(low, high, count + 1), point_spacing(points)
    if high - low < fewest * spacing:
        return UNSEEN
    which, cell = np.searchsorted(edges, along) - 1, 2.5 * spacing  # five points: hardly ever empty
    sides, filled, side = np.full((count, 2), np.nan), np.zeros(count), None
    for k in range(count):
        inside = which == k
        if np.count_nonzero(inside) < points_each // 4:
            continue
        at = int(np.searchsorted(arc, (edges[k] + edges[k + 1]) / 2).clip(0, len(arc) - 1))
        across, side = _unrolled(points[inside] - line[at], tangent[at], side)
        sides[k] = _middle(across, spacing)
        if np.ptp(sides[k]) < spacing:  # a line has no width
            sides[k] = np.nan
            continue
        filled[k] = _filled(along[inside] - edges[k], across - sides[k, 0], edges[1] - edges[0], np.ptp(sides[k]), cell)
    seen = np.isfinite(sides[:, 0])
    if np.count_nonzero(seen) < fewest:
        return UNSEEN
    left, right = (np.interp(np.arange(count), np.flatnonzero(seen), edge[seen]) for edge in sides.T)
    width, reach = right - left, max(abs(left.sum()), abs(right.sum()))
    wide = np.convolve(np.pad(width, 1, mode="edge"), [0.25, 0.5, 0.25], mode="valid")  # else the luckiest slice wins
    share = np.average(filled, weights=width) * min(width.sum() / (2 * reach), 1.0)
    return Blade(float(wide.max()), float(width.sum() * (edges[1] - edges[0]) / 0.99), float(share))


def _smooth(midrib: Array) -> tuple[Array, Array, Array]:
    """Return a smooth midrib with straight ends (L, 3), its arc length (L,) from the base, and tangents (L, 3)."""
    way = arc_length(midrib)
    fit = polynomial.polyfit(way / way[-1], midrib, min(4, len(midrib) - 1))  # bends twice, and does not waver
    line = polynomial.polyval(np.linspace(0, 1, 200), fit).T
    out = np.arange(1, 101)[:, None]  # half of its length beyond either end
    line = np.concatenate([line[0] + out[::-1] * (line[0] - line[1]), line, line[-1] + out * (line[-1] - line[-2])])
    arc = arc_length(line)
    tangent = np.gradient(line, arc, axis=0)
    return line, arc - arc[100], tangent / np.linalg.norm(tangent, axis=1)[:, None]


def _unrolled(offset: Array, tangent: Array, before: Array | None) -> tuple[Array, Array]:
    """Return how far points are across the midrib (N,), along a parabola through them [m], and the direction across.

    Args:
        offset: (N, 3) from the midrib [m].
        tangent: (3,) of the midrib.
        before: (3,) the direction of the slice below, whose sense is kept.
    """
    offset = offset - np.outer(offset @ tangent, tangent)
    axes = np.linalg.svd(offset - offset.mean(axis=0), full_matrices=False)[2][:2]
    if before is not None and axes[0] @ before < 0:
        axes = -axes
    across, up = axes @ offset.T
    _, slope, curve = polynomial.polyfit(across, up, 2)
    grid = np.linspace(min(across.min(), 0), max(across.max(), 0), 64)
    steps = np.hypot(1, slope + 2 * curve * (grid[1:] + grid[:-1]) / 2) * np.diff(grid)
    length = np.concatenate([[0], np.cumsum(steps)])
    return np.interp(across, grid, length) - np.interp(0, grid, length), axes[0]


def _middle(values: Array, spacing: float) -> tuple[float, float]:
    """Return the ends of what N values fill, from the middle 95 % of them: as if evenly, but not beyond all of them."""
    share = 0.95
    low, high = np.quantile(values, [(1 - share) / 2, (1 + share) / 2])
    more = (high - low) / 2 * ((len(values) + 1) / (len(values) - 1) / share - 1)
    return max(low - more, values.min() - spacing / 2), min(high + more, values.max() + spacing / 2)


def _filled(along: Array, across: Array, length: float, width: float, cell: float) -> float:
    """Return the share of the cells of a slice that hold a point."""
    rows, columns = max(int(length / cell), 1), max(int(width / cell), 1)
    row, column = np.floor(along / length * rows), np.floor(across / width * columns)
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    return len(np.unique(row[inside] * columns + column[inside])) / (rows * columns)
