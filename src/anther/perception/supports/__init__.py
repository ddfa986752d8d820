"""Supports: strings, wires, stakes, poles and pipes among a plant's points, set apart. N points, L lines, K sections.

A support is straight over its length, equally thick at both ends, carries no organs and is not green; a stem wanders,
tapers, and falls apart into loose leaves when it is taken away. Along long straight lines through occupied cells the
ring of a rod is followed, and weighed: the log-odds of a rigid rod against a piece of plant decide (`log_odds`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
import small_gicp
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anther.core.geometry import Array, interpolate
from anther.perception.cloud import Cloud, Support
from anther.perception.cloud._fusion import voxel_means
from anther.perception.hanging import StringLine
from anther.perception.skeleton import Skeleton
from anther.perception.skeleton.voxel_solid import components, neighbour_edges
from anther.perception.stem import Stem
from anther.perception.supports._evidence import Evidence, log_odds
from anther.perception.supports._lines import straight_lines
from anther.perception.supports._rings import clearest_ring, follow

__all__ = ["Evidence", "find_supports", "log_odds", "notes_beside"]

_PRICE = 3.0
"""Log-odds that a support must have, ln of 20: to cut a stem away is so much worse than to keep one (a judgement)."""
_STRING, _LARGEST = 0.003, 0.03
"""Radii [m] of the thickest string (twine is 1 to 3 mm thick, and a depth camera adds as much: a guess) and of the
thickest support: the pipes of a greenhouse's rails measure 51 mm."""


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
        owner[(owner < 0) & rod.holds(cloud.points, scene.cell)] = k
        supports.append(Support(kind, rod.axis, rod.radius, cloud.points[owner == k]))
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
        axis = rod.axis
        off = np.linalg.norm(axis[:, :2] - string.at(axis[:, 2]), axis=1) / string.stray(axis[:, 2])
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
    near = float(np.linalg.norm(plant - low, axis=1).min()) < support.radius + 3 * cell
    above = low[2] - plant[:, 2].min() > 0.1 * np.ptp(plant[:, 2])
    if support.soft and near and above:
        text += "; it ends at the plant: below it may be wound round the stem, and counts as stem there"
    return text


def _kind(rod: _Rod, cell: float) -> Literal["string", "wire", "stake", "pole"]:
    """Return what a rod is; one that the cloud shows too coarsely to be sure is no string."""
    if rod.radius + 0.2 * cell <= _STRING:
        return "string" if abs(rod.along[2]) > 0.7 else "wire"
    return "stake" if rod.radius <= 0.01 else "pole"


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """A cloud thinned to one point a cell.

    Attributes:
        points: (N, 3) [m].
        greenness: (N,) 2 g - r - b over r + g + b, or None without colour.
        cell: edge of a cell [m].
        size: its height, or the middle one of the three extents if that is less; at least a fifth of the largest [m].
    """

    points: Array
    greenness: Array | None
    cell: float
    size: float

    @property
    def gap(self) -> float:
        """Over how much of its length a line may be hidden [m]."""
        return 0.15 * self.size

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
        return cls(thin, greenness, cell, float(max(min(np.median(extent), extent[2]), 0.2 * extent.max())))

    def without(self, rod: _Rod) -> _Scene:
        """Return it without a rod's points."""
        keep = ~rod.holds(self.points, self.cell)
        greenness = None if self.greenness is None else self.greenness[keep]
        return replace(self, points=self.points[keep], greenness=greenness)


@dataclass(frozen=True, slots=True, eq=False)
class _Rod:
    """A long cylinder in K equal sections, straight or slightly bent.

    Attributes:
        start: (3,) the line's begin [m].
        along: (3,) unit vector of the line.
        across: (2, 3) unit vectors across it.
        step: length of a section [m].
        aside: (K + 1, 2) where the axis is beside the line, at the sections' ends [m].
        radius: [m].
        alone: (K,) whether nothing but the rod is there.
    """

    start: Array
    along: Array
    across: Array
    step: float
    aside: Array
    radius: float
    alone: NDArray[np.bool_]

    @property
    def axis(self) -> Array:
        """(K + 1, 3) along its middle, from end to end [m]."""
        return self.start + self.step * np.arange(len(self.aside))[:, None] * self.along + self.aside @ self.across

    def cylinder(self, points: Array) -> tuple[Array, Array]:
        """Return how far along the line points (N, 3) are, in sections, and how far from the axis [m]."""
        t, x, y = self._placed(points)
        return t, self._off(t, x, y)

    def _placed(self, points: Array) -> tuple[Array, Array, Array]:
        """Return how far along the line points (N, 3) are, in sections, and where across it [m]."""
        frame = np.stack([self.along / self.step, *self.across])
        t, x, y = frame @ points.T - (frame @ self.start)[:, None]
        return t, x, y

    def _off(self, t: Array, x: Array, y: Array) -> Array:
        at = interpolate(t, np.arange(len(self.aside)), self.aside)
        return np.hypot(x - at[:, 0], y - at[:, 1])

    def holds(self, points: Array, cell: float) -> NDArray[np.bool_]:
        """Return which points (N, 3) are its own: within a cell of its surface, half of one where others touch it."""
        t, x, y = self._placed(points)
        end, most = cell / self.step, float(np.abs(self.aside).max()) + self.radius + cell
        near = (t > -end) & (t < len(self.alone) + end) & (np.abs(x) < most) & (np.abs(y) < most)
        maybe = np.flatnonzero(near)
        t, off = t[maybe], self._off(t[maybe], x[maybe], y[maybe])
        margin = np.where(self.alone[np.clip(t.astype(int), 0, len(self.alone) - 1)], cell, 0.5 * cell)
        near[maybe] = off < self.radius + margin
        return near

    def near(self, lines: Array, cell: float) -> NDArray[np.bool_]:
        """Return which lines (L, 2, 3) run within the rod or along its surface."""
        off = np.stack([self.cylinder(some)[1] for some in _inner(lines)])
        return np.all(off < self.radius + 2 * cell, axis=0)


def _rods(scene: _Scene) -> Iterator[_Rod]:
    """Yield the rods that are likely enough supports, the longest lines first."""
    shortest = max(0.4 * scene.size, 0.1)  # m: a shorter straight thing is a petiole, or a seedling's stem (guesses)
    lines, plant = straight_lines(scene.points, scene.cell, shortest, scene.gap), list[_Rod]()
    most, looked = 64, 0  # lines looked at; more are never needed by a row of five
    while len(lines) and looked < most:
        line = _Line.of(scene, lines[0])
        lines = lines[~line.near(lines, scene.cell)]
        if line.occupied(scene.cell) < 0.7:  # the rest was a rod that is found
            continue
        looked += 1
        found = list[tuple[_Rod, Evidence]]()
        for largest in (_STRING, _LARGEST):  # a string's few points lie on many a wider ring as well
            at, ring = _clearest_ring(line, scene.cell, largest)
            begin = line.start + at * line.along + ring[:2] @ line.across
            if not any(rod.cylinder(begin[None])[1] + abs(rod.radius - ring[2]) < 2 * scene.cell for rod in plant):
                found += _followed(scene, line, at, ring)
        if not found:
            continue
        rod, evidence = max(found, key=lambda pair: log_odds(pair[1]))
        if log_odds(evidence) > _PRICE:
            yield rod
            scene, lines = scene.without(rod), lines[~rod.near(lines, scene.cell)]
        else:
            plant += [rod for rod, _ in found]


@dataclass(frozen=True, slots=True, eq=False)
class _Line:
    """A straight line and the N points around it, in their order along it.

    Attributes:
        start: (3,) its begin [m].
        along, across: (3,) and (2, 3) unit vectors.
        length: [m].
        t, xy: (N,) along and (N, 2) across it [m].
    """

    start: Array
    along: Array
    across: Array
    length: float
    t: Array
    xy: Array

    @classmethod
    def of(cls, scene: _Scene, ends: Array) -> _Line:
        """Return the line between two ends (2, 3), with what is near it and its continuation."""
        length = float(np.linalg.norm(ends[1] - ends[0]))
        along = (ends[1] - ends[0]) / length
        across = np.linalg.svd(along[None])[2][1:]
        x, y = across @ scene.points.T - (across @ ends[0])[:, None]
        near = np.flatnonzero((np.abs(x) < 4 * _LARGEST) & (np.abs(y) < 4 * _LARGEST))  # a rod that bends stays there
        t = (scene.points[near] - ends[0]) @ along
        order = np.argsort(t)
        return cls(ends[0], along, across, length, t[order], np.stack([x[near[order]], y[near[order]]], axis=1))

    def occupied(self, cell: float) -> float:
        """Return the share of the line beside which points are, at most two cells off."""
        x, y = np.abs(self.xy.T)
        beside = (x < 2 * cell) & (y < 2 * cell) & (self.t > 0) & (self.t < self.length)
        return len(np.unique((self.t[beside] / (2 * cell)).astype(int))) * 2 * cell / self.length

    def near(self, lines: Array, cell: float) -> NDArray[np.bool_]:
        """Return which lines (L, 2, 3) are the same but for two cells."""
        rel = (_inner(lines) - self.start) @ self.across.T
        return np.all(np.linalg.norm(rel, axis=2) < 2 * cell, axis=0)


def _inner(lines: Array) -> Array:
    """Return (2, L, 3) points near the ends of lines (L, 2, 3)."""
    return np.stack([0.85 * lines[:, 0] + 0.15 * lines[:, 1], 0.15 * lines[:, 0] + 0.85 * lines[:, 1]])


def _clearest_ring(line: _Line, cell: float, largest: float) -> tuple[float, Array]:
    """Return where along a line a ring of such a radius at most is clearest [m], and that ring: x, y and radius [m]."""
    most = 200  # points that vote
    half, best, at, ring = max(line.length / 8, 8 * cell), -1.0, 0.0, np.zeros(3)
    for middle in np.array([0.25, 0.5, 0.75]) * line.length:
        low, high = np.searchsorted(line.t, [middle - half, middle + half])
        some = line.xy[low:high]
        some = some[np.linalg.norm(some, axis=1) < 2 * largest + 2 * cell]
        fewer = np.ascontiguousarray(some[:: max(1, len(some) // most)].T)
        score, *found = clearest_ring(fewer, max(int(largest / (0.5 * cell)), 1), 0.5 * cell)
        score *= max(1, len(some) // most)
        if score > best:
            best, at, ring = score, float(middle), np.array(found)
    return at, ring


def _followed(scene: _Scene, line: _Line, at: float, ring: Array) -> list[tuple[_Rod, Evidence]]:
    """Return the rod of which a ring is seen at a place [m] along a line, and its evidence; nothing if it is short."""
    step, cell = 4 * scene.cell, scene.cell
    count = int((line.t[-1] - line.t[0]) / step) + 1
    first = np.append(np.searchsorted(line.t, line.t[0] + step * np.arange(count)), len(line.t))
    place, path = np.zeros((2, count, 2))
    size, many, others = np.zeros((3, count))
    start = min(int((at - line.t[0]) / step), count - 1)
    follow(line.xy, first, start, ring, cell, int(scene.gap / step), place, path, size, many, others)
    seen = np.flatnonzero(many)
    least = 6  # sections that show a rod
    if len(seen) < least:
        return []
    t = line.t[0] + step * (np.arange(count) + 0.5)
    alone = (many > 0) & (others < 0.25 * many)
    clean = np.flatnonzero(alone) if np.count_nonzero(alone) >= least else seen
    radius = float(np.median(size[clean]))
    alike = np.abs(size - radius) < 0.4 * radius + 0.3 * cell  # else it goes on as something else: a stem as a string
    seen, clean = seen[alike[seen]], clean[alike[clean]]
    if len(clean) < least:
        return []
    offset, slope, off = _straight_fit(t[seen], place[seen])
    good = seen[off < 4 * max(float(np.median(off)), 0.3 * cell)]
    thickness = _thickness(t[clean], size[clean])
    bow, noise = _bow(t[good], place[good])
    low, high = int(seen[0]), int(seen[-1]) + 1
    ends = line.t[0] + step * np.arange(low, high + 1)
    if radius + 0.2 * cell <= _STRING:  # taut
        aside = offset + ends[:, None] * slope
    else:
        aside = interpolate(ends, t[low:high], path[low:high])
    rod = _Rod(line.start + ends[0] * line.along, line.along, line.across, step, aside, radius, alone[low:high])
    own = rod.holds(scene.points, 1.5 * cell)
    evidence = Evidence(
        length=float(np.ptp(t[good])),
        bow=bow,
        noise=max(noise, 0.05 * cell),
        taper=(np.sign(line.along[2]) or 1.0) * thickness.taper,
        ripple=thickness.ripple,
        ripple_noise=thickness.noise,
        slenderness=float(np.ptp(t[good])) / radius,
        filled=float(np.median(many[good] * cell**2 / (np.maximum(2 * np.pi * size[good], cell) * step))),
        alone=float(alone[low:high].mean()),
        orphans=0,
        beyond=_beyond(scene, rod, own),
        greenness=_greenness(scene, own),
    )
    if log_odds(evidence) > _PRICE:  # else nothing that comes loose would matter
        evidence = replace(evidence, orphans=_orphans(scene, rod))
    return [(rod, evidence)]


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


def _orphans(scene: _Scene, rod: _Rod) -> int:
    """Return how many pieces of the plant, of half a percent of its points or more, come loose without the rod.

    The plant is what hangs together with the rod: others in view are no pieces of it, nor do they make its own small.
    """
    t, off = rod.cylinder(scene.points)
    own = (off < 1.3 * rod.radius + 1.5 * scene.cell) & (t > 0) & (t < len(rod.alone))
    coarse = np.floor((scene.points - scene.points.min(axis=0)) / (2 * scene.cell)).astype(np.int64)
    shape = coarse.max(axis=0) + 1
    number = np.ravel_multi_index(tuple(coarse.T), shape)
    held, cell = np.unique(number, return_inverse=True)
    edges = neighbour_edges(np.stack(np.unravel_index(held, shape), axis=1))
    of_rod = np.bincount(cell, weights=own) == np.bincount(cell)
    before = components(len(held), edges)
    after = components(len(held), edges[~of_rod[edges].any(axis=1)])
    hung = np.isin(before, before[cell[own]]) & ~of_rod
    pieces = np.bincount(after[cell[hung[cell]]])
    return max(int(np.count_nonzero(pieces > 0.005 * pieces.sum())) - 1, 0)  # the largest is the plant that stays


def _beyond(scene: _Scene, rod: _Rod, own: NDArray[np.bool_]) -> bool:
    if own.all():
        return True
    up = rod.along * (np.sign(rod.along[2]) or 1.0)
    ends, rest = np.sort(rod.axis[[0, -1]] @ up), scene.points[~own] @ up
    further = 0.03 * scene.size
    return bool(ends[1] > rest.max() + further or (up[2] < 0.5 and ends[0] < rest.min() - further))


def _greenness(scene: _Scene, own: NDArray[np.bool_]) -> tuple[float, float, float] | None:
    if scene.greenness is None:
        return None
    rest = scene.greenness[~own] if not own.all() else scene.greenness
    return float(np.median(scene.greenness[own])), float(np.median(rest)), float(np.std(rest))
