"""Supports: strings, wires, stakes, poles and pipes among a plant's points, set apart. N points, L lines, K sections.

A support is straight over its length, equally thick at both ends, carries no organs and is not green; a stem wanders,
tapers, and falls apart into loose leaves when it is taken away. Long straight lines through occupied cells are cut into
sections, and each is weighed: the log-odds of a rigid rod against a piece of plant decide (`log_odds`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
import small_gicp
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from anther.core.geometry import Array
from anther.perception.cloud import Cloud, Support
from anther.perception.cloud._fusion import voxel_means
from anther.perception.hanging import StringLine
from anther.perception.skeleton import Skeleton
from anther.perception.stem import Stem
from anther.perception.supports._evidence import Evidence, log_odds

__all__ = ["Evidence", "find_supports", "log_odds", "notes_beside"]

_PRICE = 3.0
"""Log-odds that a support must have, ln of 20: to cut a stem away is so much worse than to keep one (a judgement)."""


def find_supports(cloud: Cloud, string: StringLine | None = None) -> Cloud:
    """Return the cloud with its supports set apart: out of the plant's points, into `Cloud.supports`.

    A string wound round a stem stays with the stem. A cloud that has supports already is returned as it is, and with a
    note one of nothing else: a bare stem looks like a stake.

    Args:
        cloud: plant points, world frame, z up [m].
        string: on which a stem hangs: the stake or pole nearest its line is that stem.
    """
    fewest = 200  # fewer points show no support beside a plant
    if cloud.supports or len(cloud.points) < fewest:
        return cloud
    scene = _Scene.of(cloud)
    rods = list(_rods(scene))
    if string is not None:
        rods = _without_hung(rods, string, scene.cell)
    if not rods:
        return cloud
    owner, supports = np.full(len(cloud.points), -1), list[Support]()
    for k, rod in enumerate(rods):
        kind = _kind(rod, scene.cell)
        axis = _traced(cloud.points, rod, scene.cell, straight=kind in ("string", "wire"))
        margin = np.where(rod.alone, 1.0, 0.5) * scene.cell  # where nothing else is near, noise belongs to it
        off, section = _along(axis, cloud.points)
        owner[(owner < 0) & (off < rod.radius + margin[section])] = k
        supports.append(Support(kind, axis, rod.radius, cloud.points[owner == k]))
    plant = owner < 0
    if np.count_nonzero(plant) < fewest:
        only = ", ".join(support.name for support in supports)
        note = f"supports: all that is in view looks like {only}; a bare stem does too, so it is taken for the plant"
        return replace(cloud, notes=(*cloud.notes, note))
    rest = {
        name: value[plant]
        for name in ("points", "normals", "colors", "labels")
        if (value := getattr(cloud, name)) is not None
    }
    notes = tuple(_note(support, rest["points"], scene.cell) for support in supports)
    return replace(cloud, **rest, supports=tuple(supports), notes=(*cloud.notes, *notes))


def _without_hung(rods: list[_Rod], string: StringLine, cell: float) -> list[_Rod]:
    """Return the rods but for that which follows a string's line best, if any does: that one is the stem on it."""
    aside = []
    for rod in rods:
        ends = np.linspace(rod.start, rod.end, 5)
        off = np.linalg.norm(ends[:, :2] - string.at(ends[:, 2]), axis=1) / string.stray(ends[:, 2])
        rigid = _kind(rod, cell) in ("stake", "pole")
        aside.append(float(off.max()) if rigid else np.inf)
    best = int(np.argmin(aside)) if aside else 0
    return [rod for k, rod in enumerate(rods) if k != best or aside[k] > 1]


def notes_beside(cloud: Cloud, skeleton: Skeleton, stem: Stem) -> tuple[str, ...]:
    """Return a note for each support: what it is, and how far its surface is from the main stem's."""
    line, radius = skeleton.nodes[stem.node_ids], skeleton.radius[stem.node_ids]
    notes = []
    for support in cloud.supports:
        balls = support.balls(0.003)
        free = float((KDTree(balls[:, :3]).query(line)[0] - support.radius - radius).min())
        where = "touches the main stem" if free < 1e-3 else f"{1e2 * free:.1f} cm beside the main stem"
        notes.append(f"{support.name}: {where}")
    return tuple(notes)


def _note(support: Support, plant: Array, cell: float) -> str:
    long = float(np.linalg.norm(support.axis[-1] - support.axis[0]))
    text = f"{support.name}, {long:.2f} m long, is no plant: kept as an obstacle"
    low = support.axis[np.argmin(support.axis[:, 2])]
    near = float(KDTree(plant).query(low)[0]) < support.radius + 3 * cell
    above = low[2] - plant[:, 2].min() > 0.1 * np.ptp(plant[:, 2])
    if support.soft and near and above:
        text += "; it ends at the plant: below it may be wound round the stem, and counts as stem there"
    return text


def _kind(rod: _Rod, cell: float) -> Literal["string", "wire", "stake", "pole"]:
    """Return what a rod is; one that the cloud shows too coarsely to be sure is no string."""
    string_radius = 0.003  # m: twine is 1 to 3 mm thick, and a depth camera adds as much (a guess)
    if rod.radius + 0.2 * cell <= string_radius:
        return "string" if abs(rod.along[2]) > 0.7 else "wire"
    return "stake" if rod.radius <= 0.01 else "pole"


def _along(axis: Array, points: Array) -> tuple[Array, NDArray[np.int64]]:
    """Return how far points (N, 3) are from an axis (K + 1, 3) [m], and which of its K pieces is nearest to each."""
    fine = np.linspace(0, len(axis) - 1, 20 * (len(axis) - 1) + 1)
    line = np.stack([np.interp(fine, np.arange(len(axis)), column) for column in axis.T], axis=1)
    off, nearest = KDTree(line).query(points)
    return off, np.minimum(fine[nearest].astype(np.int64), len(axis) - 2)


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """A cloud thinned to one point a cell.

    Attributes:
        points: (N, 3) [m].
        greenness: (N,) 2 g - r - b over r + g + b, or None without colour.
        cell: edge of a cell [m].
        lower: (3,) corner of the grid [m].
        grid: which cells hold points.
        size: the middle one of the three extents, of a row a plant's own; at least a fifth of the largest [m].
        coarse: whether the cells are larger than they need be.
    """

    points: Array
    greenness: Array | None
    cell: float
    lower: Array
    grid: NDArray[np.bool_]
    size: float
    coarse: bool = False

    def gap(self, step: float) -> int:
        """Return over how many steps [m] a line may be hidden."""
        share = 0.15  # of the plant's size
        return max(int(share * self.size / step), 1)

    @classmethod
    def of(cls, cloud: Cloud) -> _Scene:
        points = cloud.points
        extent = np.ptp(np.quantile(points, [0.002, 0.998], axis=0), axis=0)
        some = points[:: max(1, len(points) // 2000)]
        tree = small_gicp.KdTree(np.ascontiguousarray(points), num_threads=2)  # several times quicker than SciPy's
        spacing = float(np.median(np.sqrt(tree.batch_knn_search(some, 2, num_threads=2)[1][:, 1])))
        most_cells = 2e7  # of the grid: 20 MB
        cell = max(1.5 * spacing, float(np.prod(np.ptp(points, axis=0) + 1e-3) / most_cells) ** (1 / 3), 1e-6)
        thin = voxel_means(points - points.min(axis=0), cell) + points.min(axis=0)
        greenness = None
        if cloud.colors is not None:
            r, g, b = cloud.colors[tree.batch_knn_search(thin, 1, num_threads=2)[0][:, 0]].T.astype(np.float64)
            greenness = (2 * g - r - b) / (r + g + b + 1)
        lower = points.min(axis=0) - 2 * cell
        grid = np.zeros(np.ceil((points.max(axis=0) - lower) / cell).astype(int) + 3, dtype=bool)
        grid[tuple(np.floor((thin - lower) / cell).astype(int).T)] = True
        return cls(thin, greenness, cell, lower, grid, float(max(np.median(extent), 0.2 * extent.max())))

    def coarser(self) -> _Scene:
        """Return it in cells three times as large: there a pipe's ring has no gaps."""
        cell, low = 3 * self.cell, self.points.min(axis=0)
        points = voxel_means(self.points - low, cell) + low
        greenness = None if self.greenness is None else self.greenness[KDTree(self.points).query(points)[1]]
        return replace(self, points=points, greenness=greenness, cell=cell, coarse=True)

    def without(self, rod: _Rod) -> _Scene:
        """Return it without a rod's points."""
        keep = ~rod.holds(self.points, self.cell)
        greenness = None if self.greenness is None else self.greenness[keep]
        return replace(self, points=self.points[keep], greenness=greenness)


def _straight_lines(scene: _Scene) -> Array:
    """Return lines (L, 2, 3) through occupied cells, the longest first.

    Random pairs of points are joined; what is occupied along nine tenths of the way is followed beyond both ends.
    """
    rng = np.random.default_rng(0)
    pairs = 150_000  # of points drawn for lines: a string with 1 % of the points is hit fifteen times
    first, second = scene.points[rng.integers(0, len(scene.points), (2, pairs))]
    shortest = max(0.4 * scene.size, 0.1)  # m: a shorter straight thing is a petiole, or a seedling's stem (guesses)
    long = np.linalg.norm(second - first, axis=1) > shortest
    first, second = first[long], second[long]
    near = scene.grid.copy()  # what touches it by a face too: at the grid's border there is nothing
    for axis in range(3):
        for step in (-1, 1):
            near |= np.roll(scene.grid, step, axis)

    def occupied(at: Array) -> NDArray[np.bool_]:
        index = np.floor((at - scene.lower) / scene.cell).astype(np.int64)
        inside = np.all((index >= 0) & (index < near.shape), axis=-1)
        return inside & near[tuple(np.where(inside[..., None], index, 0).T)].T

    share = (np.arange(40) * 0.618) % 1  # evenly spread, whichever first few are taken
    for some in (share[:6], share[6:16], share[16:]):
        held = occupied(first[:, None] + some[:, None] * (second - first)[:, None]).mean(axis=1)
        first, second = first[held > 0.85], second[held > 0.85]
    first, second = first[:1500], second[:1500]
    if not len(first):
        return np.zeros((0, 2, 3))
    along = second - first
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    middle = (first + second) / 2
    reach = np.arange(-1.0, 1.0, scene.cell / np.linalg.norm(np.ptp(scene.points, axis=0)))
    reach *= np.linalg.norm(np.ptp(scene.points, axis=0))
    held = occupied(middle[:, None] + reach[:, None] * along[:, None])
    gap = scene.gap(scene.cell)
    closed = ndimage.binary_closing(np.pad(held, ((0, 0), (gap, gap))), np.ones((1, gap + 1)))[:, gap:-gap]
    centre = len(reach) // 2
    closed[:, centre] = True
    before = centre - np.argmin(closed[:, centre::-1], axis=1) + 1
    after = centre + np.argmin(np.column_stack([closed[:, centre:], np.zeros(len(closed), bool)]), axis=1) - 1
    before[closed[:, : centre + 1].all(axis=1)] = 0
    ends = np.stack([reach[before], reach[after]], axis=1)
    return (middle[:, None] + ends[..., None] * along[:, None])[np.argsort(ends[:, 0] - ends[:, 1])]


@dataclass(frozen=True, slots=True, eq=False)
class _Rod:
    """A straight cylinder: the ends of its axis (3,), its radius [m], and where along it the rod is seen alone.

    Attributes:
        alone: (K,) of equal sections from start to end, whether nothing but the rod is there.
    """

    start: Array
    end: Array
    radius: float
    alone: NDArray[np.bool_]

    @property
    def along(self) -> Array:
        return (self.end - self.start) / np.linalg.norm(self.end - self.start)

    def _cylinder(self, points: Array) -> tuple[Array, Array]:
        """Return how far along the axis points (N, 3) are from the start, and how far from the axis [m]."""
        rel = points - self.start
        t = rel @ self.along
        return t, np.linalg.norm(rel - t[:, None] * self.along, axis=1)

    def holds(self, points: Array, cell: float) -> NDArray[np.bool_]:
        """Return which points (N, 3) are its own: within a cell of its surface, half of one where others touch it."""
        t, off = self._cylinder(points)
        share = t / np.linalg.norm(self.end - self.start)
        section = np.clip((share * len(self.alone)).astype(int), 0, len(self.alone) - 1)
        margin = np.where(self.alone[section], cell, 0.5 * cell)
        return (off < self.radius + margin) & (t > -cell) & (t < np.linalg.norm(self.end - self.start) + cell)

    def near(self, lines: Array, cell: float) -> NDArray[np.bool_]:
        """Return which lines (L, 2, 3) run within the rod or along its surface."""
        inner = np.stack([0.85 * lines[:, 0] + 0.15 * lines[:, 1], 0.15 * lines[:, 0] + 0.85 * lines[:, 1]])
        off = np.stack([self._cylinder(some)[1] for some in inner])
        return np.all(off < self.radius + 3 * cell, axis=0)


def _rods(scene: _Scene) -> Iterator[_Rod]:
    """Yield the rods that are likely enough supports, the longest lines first."""
    lines, coarse, looked = _straight_lines(scene), scene.coarser(), 0
    most_lines = 16  # looked at; more are never needed by a row of five
    while len(lines) and looked < most_lines:
        looked += 1
        found = [pair for view in (scene, coarse) if (pair := _fitted(view, lines[0])) is not None]
        if not found:
            lines = lines[1:]
            continue
        rod, evidence = max(found, key=lambda pair: log_odds(pair[1]))
        lines = lines[1:][~rod.near(lines[1:], scene.cell)]
        if log_odds(evidence) > _PRICE:
            yield rod
            scene, coarse = scene.without(rod), coarse.without(rod)


@dataclass(frozen=True, slots=True, eq=False)
class _Sections:
    """What stands on a line, in K equal sections: the piece next to the line.

    Attributes:
        t: (K,) along the line [m].
        centre: (K, 2) mean of the piece's points, across the line [m].
        spread: (K,) rms distance from that [m]: the radius of a ring.
        near: (K,) distance of its nearest point from the line [m]; infinite where nothing is.
        across: (2, 3) unit vectors across the line.
    """

    t: Array
    centre: Array
    spread: Array
    near: Array
    across: Array


def _sections(scene: _Scene, start: Array, end: Array) -> _Sections:
    """Cut what is around a line into sections four cells long, and each into pieces."""
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    across = np.linalg.svd(along[None])[2][1:]
    width, cell = max(0.2 * scene.size, 8 * scene.cell), 1.5 * scene.cell
    rel = scene.points - start
    t, (x, y) = rel @ along, across @ rel.T
    inside = (t >= 0) & (t < length) & (np.abs(x) < width) & (np.abs(y) < width)
    t, x, y = t[inside], x[inside], y[inside]
    count, cells = max(int(length / (4 * scene.cell)), 1), int(2 * width / cell) + 1
    k = np.minimum((t / length * count).astype(int), count - 1)
    place = k, ((x + width) / cell).astype(int), ((y + width) / cell).astype(int)
    held = np.zeros((count, cells, cells), dtype=bool)
    held[place] = True
    flat = np.zeros((3, 3, 3), dtype=int)
    flat[1] = 1
    labels: Any = ndimage.label(held, flat)
    piece = labels[0][place]
    off = np.hypot(x, y)
    order = np.lexsort((off, k))
    there, first = np.unique(k[order], return_index=True)
    nearest, near = np.full(count, -1), np.full(count, np.inf)
    nearest[there], near[there] = piece[order[first]], off[order[first]]
    mine = piece == nearest[k]
    k, xy = k[mine], np.stack([x[mine], y[mine]], axis=1)
    many = np.maximum(np.bincount(k, minlength=count), 1)
    centre = np.stack([np.bincount(k, column, count) for column in xy.T], axis=1) / many[:, None]
    spread = np.sqrt(np.bincount(k, np.sum((xy - centre[k]) ** 2, axis=1), count) / many)
    spread = np.maximum(spread, 0.1 * scene.cell)  # not resolved
    return _Sections((np.arange(count) + 0.5) * length / count, centre, spread, near, across)


def _fitted(scene: _Scene, line: Array) -> tuple[_Rod, Evidence] | None:
    """Return the rod along a line (2, 3) and its evidence; None where too little of it stands alone."""
    start, end = line
    width, thickness = 3 * scene.cell, _Thickness(0.0, 0.0, 0.0)
    found, alone, typical, off = _sections(scene, start, end), np.zeros(0, dtype=bool), 0.0, np.zeros(0)
    alike, even = 0.4, 0.15  # ln of a section's spread over the usual one: what may be a rod, and surely is one
    least = 6  # sections that show a rod alone
    for again in (False, True):  # the line first runs on the rod's surface, then along its axis
        found = _sections(scene, start, end) if again else found
        there = found.near < width
        if np.count_nonzero(there) < least:
            return None
        typical = _mode(found.spread[there])  # what touches a rod makes sections wider, each by another amount
        off_typical = np.abs(np.log(found.spread / typical))
        alone = there & (off_typical < alike)
        if again and np.count_nonzero(alone) >= least:
            thickness = _thickness(found.t[alone], found.spread[alone])
            alone = there & (off_typical < np.clip(3 * thickness.noise, even, alike))
        if np.count_nonzero(alone) < least:
            return None
        offset, slope, off = _straight_fit(found.t[alone], found.centre[alone])
        length = np.linalg.norm(end - start)
        along = (end - start) / length
        start, end = start + offset @ found.across, start + length * along + (offset + length * slope) @ found.across
        width = 2 * typical + 3 * scene.cell
    usual = max(float(np.median(off)), 0.3 * scene.cell)
    good = np.flatnonzero(alone)[off < 4 * usual]
    t = found.t[good]
    if scene.coarse and typical < 1.5 * scene.cell:  # seen as well in fine cells
        return None
    if len(t) < least or len(t) < 0.2 * np.count_nonzero(found.near < np.inf):
        return None
    axis = _Rod(start, end, typical, np.isin(np.arange(len(found.t)), good))
    rod = _measured(scene, axis)
    bow, noise = _bow(t, found.centre[good])
    evidence = Evidence(
        length=float(t[-1] - t[0]),
        bow=bow,
        noise=max(noise, 0.05 * scene.cell),
        taper=(np.sign(rod.along[2]) or 1.0) * thickness.taper,
        ripple=thickness.ripple,
        ripple_noise=thickness.noise,
        slenderness=float(t[-1] - t[0]) / rod.radius,
        orphans=0,
        beyond=_beyond(scene, rod),
        greenness=_greenness(scene, rod),
    )
    if log_odds(evidence) > _PRICE:  # else nothing that comes loose would matter
        evidence = replace(evidence, orphans=_orphans(scene, rod))
    return rod, evidence


class _Thickness(NamedTuple):
    """Of ln of a line's radius: the upper third over the lower, its scatter about that, and what of the scatter differs
    from each section to the next."""

    taper: float
    ripple: float
    noise: float


def _thickness(t: Array, radius: Array) -> _Thickness:
    """Measure radii (K,) along a line, most of them: something touches it here and there."""
    logs, sigma = np.log(radius)[:, None], 1.483  # of a normal distribution over its median absolute deviation
    offset, slope, off = _straight_fit(t, logs)
    noise = sigma * float(np.median(np.abs(np.diff(logs[:, 0] - offset - t * slope)))) / np.sqrt(2)
    return _Thickness(float(2 / 3 * np.ptp(t) * slope[0]), sigma * float(np.median(off)), noise)


def _mode(values: Array) -> float:
    """Return where values lie densest in the logarithm: the half-sample mode (Robertson and Cryer 1974)."""
    some = np.sort(np.log(values))
    while len(some) > 2:
        half = (len(some) + 1) // 2
        first = int(np.argmin(some[half - 1 :] - some[: len(some) - half + 1]))
        some = some[first : first + half]
    return float(np.exp(some.mean()))


def _straight_fit(t: Array, places: Array) -> tuple[Array, Array, Array]:
    """Return offset (D,), slope (D,) and distances (K,) of the line along most of the places (K, D), mostly [m]."""
    weight, slope, offset, off = np.ones(len(t)), np.zeros(0), np.zeros(0), np.zeros(len(t))
    for _ in range(8):
        slope, offset = np.polyfit(t, places, 1, w=weight)
        off = np.linalg.norm(places - offset - t[:, None] * slope, axis=1)
        weight = 1 / (1 + (off / max(2 * float(np.median(off)), 1e-9)) ** 2)  # Cauchy
    return offset, slope, off


def _bow(t: Array, centre: Array) -> tuple[float, float]:
    """Return how far a cubic through centres (K, 2) departs from a line, and what of it their scatter causes [m]."""
    basis = np.linalg.qr(np.vander((t - t.mean()) / np.ptp(t), 4, increasing=True))[0]
    share = basis.T @ centre
    scatter = np.sum((centre - basis @ share) ** 2) / max(2 * (len(t) - 4), 1)
    return float(np.sqrt(np.sum(share[2:] ** 2) / len(t))), float(np.sqrt(4 * scatter / len(t)))


def _measured(scene: _Scene, axis: _Rod) -> _Rod:
    """Return the rod with its radius and its ends: as far as its surface goes on, over gaps where it is hidden."""
    t, off = axis._cylinder(scene.points)
    length, count = float(np.linalg.norm(axis.end - axis.start)), len(axis.alone)
    own = (off < 2 * axis.radius + scene.cell) & (t >= 0) & (t < length)
    own[own] &= axis.alone[np.minimum((t[own] / length * count).astype(int), count - 1)]
    if not own.any():
        return axis
    axis, radius = _round(axis, scene.points[own], scene.cell)
    t, off = axis._cylinder(scene.points)
    step = length / count
    section = np.floor(t / step).astype(int)
    surface = (np.abs(off - radius) < scene.cell) | (off < radius)
    first = int(section.min())
    many = np.bincount(section[surface] - first, minlength=int(section.max()) - first + 1)
    usual = np.median(many[np.flatnonzero(axis.alone) - first])
    seen = np.flatnonzero(many >= 0.3 * usual) + first
    core = np.flatnonzero(axis.alone)
    gap = scene.gap(step)
    low = _followed(core[0], seen[seen < core[0]][::-1], -gap)
    high = _followed(core[-1], seen[seen > core[-1]], gap)
    alone = np.zeros(high + 1 - low, dtype=bool)
    alone[core - low] = True
    start = axis.start + low * step * axis.along
    return _Rod(start, axis.start + (high + 1) * step * axis.along, radius, alone)


def _traced(points: Array, rod: _Rod, cell: float, *, straight: bool) -> Array:
    """Return the axis (K + 1, 3) of a rod: straight if it is taut, else along its surface, as a long stake bends."""
    count, across = len(rod.alone), np.linalg.svd(rod.along[None])[2][1:]
    step = float(np.linalg.norm(rod.end - rod.start)) / count
    line = rod.start + np.arange(count + 1)[:, None] * step * rod.along
    if straight:
        return line
    t, off = rod._cylinder(points)
    near = np.flatnonzero(off < rod.radius + 8 * cell)
    t, xy = t[near] / step, (points[near] - rod.start) @ across.T
    aside, first = np.zeros((count + 1, 2)), int(np.median(np.flatnonzero(rod.alone)))
    for order in (range(first, count + 1), range(first, -1, -1)):
        at, slope = np.zeros(2), np.zeros(2)
        for k in order:
            guess = at + slope
            step_aside = _ring_centre(xy[np.abs(t - k) < 1], guess, rod.radius, cell) - guess
            at, slope = guess + 0.5 * step_aside, slope + 0.2 * step_aside  # alpha-beta filter
            aside[k] = at
    return line + aside @ across


def _ring_centre(xy: Array, guess: Array, radius: float, cell: float) -> Array:
    """Return the centre of a ring of known radius through points (N, 2), near a guess (2,): this where they are few."""
    xy, centre = xy[np.linalg.norm(xy - guess, axis=1) < radius + 0.7 * cell], guess
    if len(xy) < 4:
        return guess
    for _ in range(5):
        ray = xy - centre
        off = np.linalg.norm(ray, axis=1)
        ray /= np.maximum(off, 1e-9)[:, None]
        weight = 1 / (1 + ((off - radius) / (0.3 * cell)) ** 2)
        ties = (ray * weight[:, None]).T @ ray + 0.2 * weight.sum() * np.eye(2)
        centre = centre + np.linalg.solve(ties, ray.T @ (weight * (off - radius)))
    return centre


def _round(axis: _Rod, points: Array, cell: float) -> tuple[_Rod, float]:
    """Return the axis moved into the middle of the surface points (N, 3) around it, and the radius [m].

    A surface seen from one side has its mean beside its axis: a circle is fitted (Kasa 1976) where it can be told from
    a spot.
    """
    across = np.linalg.svd(axis.along[None])[2][1:]
    xy = (points - axis.start) @ across.T
    equations = np.column_stack([2 * xy, np.ones(len(xy))])
    *middle, constant = np.linalg.lstsq(equations, np.sum(xy**2, axis=1), rcond=None)[0]
    radius = float(np.sqrt(max(constant + float(np.dot(middle, middle)), 0)))
    if not max(2 * cell, axis.radius) < radius < 2 * axis.radius:  # half a ring spreads by 0.8 r about its mean
        return axis, float(np.median(np.linalg.norm(xy, axis=1)))
    moved = np.array(middle) @ across
    return replace(axis, start=axis.start + moved, end=axis.end + moved), radius


def _followed(last: int, numbers: NDArray[np.int64], gap: int) -> int:
    """Return the last of the numbers, in order, that are not more than a gap apart from `last` on."""
    for number in numbers.tolist():
        if abs(number - last) > abs(gap):
            break
        last = number
    return int(last)


def _orphans(scene: _Scene, rod: _Rod) -> int:
    """Return how many pieces of the plant, of half a percent of its points or more, come loose without the rod."""
    t, off = rod._cylinder(scene.points)
    length = float(np.linalg.norm(rod.end - rod.start))
    own = (off < 1.3 * rod.radius + 1.5 * scene.cell) & (t > -scene.cell) & (t < length + scene.cell)
    coarse = np.floor((scene.points - scene.lower) / (2 * scene.cell)).astype(int)
    shape = coarse.max(axis=0) + 1

    def parts(keep: NDArray[np.bool_]) -> NDArray[np.int64]:
        held = np.zeros(shape, dtype=bool)
        held[tuple(coarse[keep].T)] = True
        labels: Any = ndimage.label(held, np.ones((3, 3, 3)))
        return np.asarray(labels[0][tuple(coarse[~own].T)], dtype=np.int64)

    if own.all():
        return 0
    before, after = parts(np.ones(len(own), dtype=bool)), parts(~own)
    home = np.bincount(after).argmax()  # the largest piece that is left
    joined = before == before[after == home][0]
    return int(np.count_nonzero(np.bincount(after[joined & (after != home)]) > 0.005 * len(after)))


def _beyond(scene: _Scene, rod: _Rod) -> bool:
    own = rod.holds(scene.points, 1.5 * scene.cell)
    if own.all():
        return True
    up = rod.along * (np.sign(rod.along[2]) or 1.0)
    ends, rest = np.sort([rod.start @ up, rod.end @ up]), scene.points[~own] @ up
    further = 0.03 * scene.size
    return bool(ends[1] > rest.max() + further or (up[2] < 0.5 and ends[0] < rest.min() - further))


def _greenness(scene: _Scene, rod: _Rod) -> tuple[float, float, float] | None:
    if scene.greenness is None:
        return None
    own = rod.holds(scene.points, scene.cell)
    rest = scene.greenness[~own] if not own.all() else scene.greenness
    return float(np.median(scene.greenness[own])), float(np.median(rest)), float(np.std(rest))
