"""Plants in view: where every stem stands, and which points grow from it. N points, V voxels, C candidates, K plants.

The cloud becomes coarse voxels, a graph. What hangs down or stands is a basin of height in it: its lowest voxel is a
local minimum, and the basin lasts until it meets a lower one (the merge tree of height, Carr et al. 2003). Which minima
are feet of stems is a logistic model of how the way up from them looks. All feet at once are the sources of shortest
paths that prefer stems and pay for turns: every voxel goes to the foot from which it is reached at the least cost, so
plants exclude each other, leaves that touch pass on little, and organs that cross go straight on.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.sparse.csgraph import dijkstra, minimum_spanning_tree

from anther.core.errors import bad_input
from anther.core.geometry import Array
from anther.perception.skeleton.raw_tree import BLADE
from anther.perception.skeleton.support import probability
from anther.perception.skeleton.voxel_solid import (
    bridges,
    components,
    mark_fragments,
    nearest,
    neighbour_edges,
    point_spacing,
    solidify,
    surroundings,
)

__all__ = ["Plants", "find_plants"]

_FINEST = 100
"""Voxels along the scene's height: stems a thirtieth of it apart keep apart."""
_BRIDGE = 0.15
"""Gaps up to this share of the scene's height are bridged, as within one plant."""
_ACROSS_GAP = 7.0
"""A way across a gap costs as much as one across the middle of a blade, times its length."""
_NEAR = 0.08
"""How far from the nearest point a named root may be, of the scene's height: the foot may be hidden."""

_TIE = 0.03
"""How exactly the middle and a foot are known, of the scene's height: 2 to 3 cm of a plant (a guess)."""


@dataclass(frozen=True, slots=True, eq=False)
class Plants:
    """The plants of one cloud, in order: along x, or along y where they spread more along y.

    Attributes:
        roots: (K, 3) where the stems stand: the lowest seen point of each [m].
        sure: (K,) probability that a stem stands there.
        owner: (N,) plant of each point of the cloud; -1: of none.
        asked: which one is asked for.
        root: (3,) where its tree begins [m].
        certain: probability that a stem stands there and is the one that is meant.
        notes: what the user should know.
        stems: K times (M, 3), the way up each stem, coarsely [m]; blades are left out.
    """

    roots: Array
    sure: Array
    owner: NDArray[np.int64]
    asked: int
    root: Array
    certain: float = 1.0
    notes: tuple[str, ...] = ()
    stems: tuple[Array, ...] = ()

    def __len__(self) -> int:
        return len(self.roots)


def find_plants(
    points: Array, root: ArrayLike | None = None, plant: int | None = None, middle: ArrayLike | None = None
) -> Plants:
    """Return the plants that stand in points (N, 3), z up [m]; one is asked for.

    Args:
        points: of all plants.
        root: where the asked one stands [m]; a stem that was not recognised there counts as one.
        plant: its number, in the order of `Plants`.
        middle: without both, the one that stands nearest to this place is asked for, of those about as near the
            largest; None: to the middle of the points.

    Raises:
        InputError: `root` is in empty air or between two stems, or there is no such `plant`.
    """
    graph = _graph(points)
    minima = _minima(graph)
    # constant and weights of the evidence in the log-odds that a stem stands there: `evaluation.perception.fit_feet`
    fitted = (-12.54, 4.62, 2.72, 6.19, 4.22)
    chance = probability(fitted, _evidence(graph, minima))
    named = None if root is None else _named(graph, np.asarray(root, dtype=np.float64), minima, chance)
    if named is not None and named not in minima:
        minima, chance = np.append(minima, named), np.append(chance, 0.0)
    chance = np.where(minima == named, 1.0, chance)  # who names it knows
    feet = minima[chance >= 0.5]
    if len(feet) < 2:
        foot = graph.points[feet if len(feet) else minima[:1]]
        _check_number(plant, foot)
        return Plants(foot, np.ones(1), np.zeros(len(points), dtype=np.int64), 0, foot[0])
    spread = np.ptp(graph.points[feet], axis=0)
    feet = feet[np.argsort(graph.points[feet, int(spread[1] > spread[0])], kind="stable")]
    grown = _grown_from(graph, feet)
    roots, owner = graph.points[feet], _owners(graph, grown, points)
    _check_number(plant, roots)
    sure = np.array([chance[minima == foot][0] for foot in feet])
    if named is not None:
        number = int(np.flatnonzero(feet == named)[0])
        asked = _Asked(number, sure[number], "--root names it")
    elif plant is not None:
        asked = _Asked(plant, sure[plant], "--plant names it")
    else:
        low, high = np.quantile(points, [0.005, 0.995], axis=0)
        centre = (low + high) / 2 if middle is None else np.asarray(middle, dtype=np.float64)
        size, other = np.bincount(owner[owner >= 0], minlength=len(feet)), chance < 0.5
        others = _Others(graph.points[minima[other]], chance[other])
        asked = _middle_one(roots, sure, size, others, centre, _TIE * graph.height)
    notes = _notes(roots, asked, owner)
    on_it = named is not None and np.linalg.norm(roots[asked.number] - root) > _NEAR * graph.height
    start = np.asarray(root, dtype=np.float64) if on_it else roots[asked.number]
    stems = tuple(_ways_up(graph, feet, grown))
    return Plants(roots, sure, owner, asked.number, start, float(asked.certain), notes, stems)


class _Asked(NamedTuple):
    """The number of the plant that is asked for, the probability that its stem is the one that is meant, why it is
    taken, and the second candidate's place (3,) [m], if there is any."""

    number: int
    certain: float
    why: str
    second: Array | None = None


class _Others(NamedTuple):
    """Minima (M, 3) [m] that count as no feet, and the probability (M,) that a stem stands there after all."""

    places: Array
    chance: Array


def _check_number(plant: int | None, roots: Array) -> None:
    if plant is not None and not 0 <= plant < len(roots):
        given, do = f"{plant}; {len(roots)} stems in view: {_listed(roots)}", "Take one of them, or name --root x,y,z."
        raise bad_input("plant", given=given, allowed=f"0 to {len(roots) - 1}", do=do)


def _listed(roots: Array) -> str:
    return ", ".join(f"{k} at x, y = {x:.3f}, {y:.3f}" for k, (x, y, _) in enumerate(roots))


def _notes(roots: Array, asked: _Asked, owner: NDArray[np.int64]) -> tuple[str, ...]:
    words = f"{len(roots)} stems in view: {_listed(roots)} m; plant {asked.number} is taken ({asked.why})"
    notes = (f"{words}; name another with --plant or --root",)
    if (lost := float(np.mean(owner < 0))) > 0.02:
        notes += (f"{lost:.0%} of the points belong to no stem in view",)
    if asked.second is not None:
        x, y, z = asked.second
        words = f"root: probability {asked.certain:.0%}; the second candidate is {x:.3f},{y:.3f},{z:.3f}"
        notes += (f"{words} (set it with --root)",)
    return notes


def _middle_one(roots: Array, sure: Array, size: NDArray[Any], others: _Others, centre: Array, tie: float) -> _Asked:
    """Return the plant that stands nearest to the centre (3,) [m], the largest of those about as near.

    It is the one that is meant if its stem stands there, if no stem stands where one is less likely, as near to the
    centre, and if the second largest of those about as near is not meant.

    Args:
        roots, sure, size: (K, 3) [m] of the plants, (K,) probabilities that they stand there, (K,) points.
        others: where a stem may stand.
        centre: where the one that is meant stands.
        tie: how much farther [m] is about as near.
    """
    away = np.linalg.norm((roots - centre)[:, :2], axis=1)
    alike = np.flatnonzero(away <= away.min() + tie)
    alike = alike[np.argsort(-size[alike], kind="stable")]
    number, why = int(alike[0]), "the one in the middle"
    near = np.linalg.norm((others.places - centre)[:, :2], axis=1) <= away[number] + tie
    places, chance = others.places[near], others.chance[near]
    certain, second = sure[number] * np.prod(1 - chance), None
    if len(alike) > 1:
        certain *= size[number] / (size[number] + size[alike[1]])
        second, why = roots[alike[1]], "the largest of those about as near the middle"
    elif certain < 0.75 and len(places):  # a user is warned, and told of what
        second = places[chance.argmax()]
    return _Asked(number, float(certain), why, second)


def _named(graph: _Graph, root: Array, minima: NDArray[Any], chance: Array) -> int | None:
    """Return the foot that a place (3,) [m] names; None where it is no foot, but on the only plant.

    A minimum that is not likely enough to be a foot of its own counts as one where somebody names it, and so does any
    place of the plant below which none is: what hangs may be seen from there up alone.

    Raises:
        InputError: nothing is near it, two stems are as near, or it is on no stem though several are in view.
    """
    feet = minima[chance >= 0.5]
    roots = graph.points[feet if len(feet) else minima[:1]]
    away = np.linalg.norm(graph.points - root, axis=1)
    aside = np.linalg.norm(roots[:, :2] - root[:2], axis=1)
    voxel, order = int(away.argmin()), np.argsort(aside)
    near = away[voxel] <= _NEAR * graph.height
    between = len(roots) > 1 and aside[order[0]] > 0.5 * aside[order[1]]  # twice as near is clear: a guess
    on_it = away[voxel] <= 2 * graph.height / _FINEST
    if near and (on_it or not between):
        if not len(feet):
            return None
        below = _below(graph, voxel)
        if below[feet[order[0]]]:
            return int(feet[order[0]])
        lowest = np.flatnonzero(below[minima])[:1]
        odds = 20.0  # a named place is likelier a foot than one that nobody names: a guess
        if len(lowest) and (chance[lowest[0]] >= 1 / (1 + odds) or (on_it and len(feet) > 1)):
            return int(minima[lowest[0]])
        if aside[order[0]] <= _NEAR * graph.height and not between:
            return int(feet[order[0]])
        if len(feet) == 1:
            return None
        if on_it:
            return voxel
    where = f"{root.round(3).tolist()}, {away[voxel]:.3g} m from the plant{', between two stems' if between else ''}"
    listed = "; ".join(", ".join(f"{value:.3f}" for value in place) for place in roots[order[:2]])
    raise bad_input("root", given=where, allowed=f"on a stem; the nearest stand at {listed} m", do="Name one of them.")


def _below(graph: _Graph, voxel: int) -> NDArray[np.bool_]:
    """Return which voxels (V,) are reached from one without going higher than it."""
    within = graph.points[:, 2] <= graph.points[voxel, 2]
    links = graph.links[within[graph.links].all(axis=1)]
    label = components(len(graph.points), links)
    return label == label[voxel]


def _owners(graph: _Graph, grown: NDArray[np.int64], points: Array) -> NDArray[np.int64]:
    """Return the number (N,) of the foot that each point belongs to, as its voxel (V,) does, -1: to none."""
    away, voxel = nearest(points, graph.points)
    return np.where(away <= _BRIDGE * graph.height, grown[voxel], -1)


def _ways_up(graph: _Graph, feet: NDArray[Any], grown: NDArray[np.int64]) -> Iterator[Array]:
    """Yield (M, 3) the cheapest way from each foot to the top of what grows from it [m], without what is planar."""
    before, number = graph.ways(feet)
    for k, foot in enumerate(feet):
        own = np.flatnonzero((number == k) & (grown == k))
        way = _way_to(before, int(own[graph.points[own, 2].argmax()] if len(own) else foot))
        yield graph.points[[voxel for voxel in way if graph.flatness[voxel] < BLADE]]


def _way_to(before: NDArray[Any], voxel: int) -> list[int]:
    """Return the voxels on the way to one, which goes first, from the foot that is before itself."""
    way = [voxel]
    while before[way[-1]] != way[-1]:
        way.append(before[way[-1]])
    return way


def _grown_from(graph: _Graph, feet: NDArray[Any]) -> NDArray[np.int64]:
    """Return the number (V,) of the foot that each voxel is reached from at the least cost, turns included; -1: none.

    What the next step costs depends on the one before, so ways go from step to step: S steps over two cells, of 2 x 2
    x 2 voxels. Between neighbouring cells a straight way would zigzag, and pay for that as for turns.
    """
    cell, near, far = _steps(graph)
    foot = np.full(int(cell.max()) + 1, -1, dtype=np.int64)
    foot[cell[feet]] = np.arange(len(feet))
    begun = np.where(foot < 0, _neighbours(near, foot), foot)  # no step from a foot ends beside it
    one, other, turn = _onward(far)
    right_angle = 6.0  # what it costs on the way, of the scene's height
    cost = far.cost[other] + right_angle * graph.height * np.maximum(turn, 0)
    links = sparse.coo_matrix((cost, (one, other)), (len(far.tail), len(far.tail))).tocsr()
    begin = np.flatnonzero(begun[far.tail] >= 0)
    cost, _, source = dijkstra(links, indices=begin, return_predecessors=True, min_only=True)
    reached = np.flatnonzero(np.isfinite(cost))
    reached = reached[np.argsort(-cost[reached], kind="stable")]
    grown = np.full(len(foot), -1, dtype=np.int64)
    grown[far.head[reached]] = begun[far.tail[source[reached]]]  # the cheapest comes last, and stays
    grown = np.where(begun < 0, grown, begun)
    return np.where(grown < 0, _neighbours(near, grown), grown)[cell]


class _Steps(NamedTuple):
    """Steps (S,) from cell `tail` to cell `head`, in order of their tails: cost [m] and unit direction (S, 3)."""

    tail: NDArray[Any]
    head: NDArray[Any]
    cost: Array
    along: Array


def _neighbours(near: _Steps, number: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number of a neighbour of each cell (its largest), -1 where none has one."""
    found = np.full(len(number), -1, dtype=np.int64)
    np.maximum.at(found, near.head, number[near.tail])
    return found


def _onward(steps: _Steps, most: float = 1.0) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return pairs of steps of which one begins where the other ends, and how much the way turns there, 1 for a right
    angle; those that turn by more than `most` are left out."""
    begin, end = np.searchsorted(steps.tail, [steps.head, steps.head + 1])
    count = end - begin
    other = np.arange(count.sum()) + np.repeat(begin - np.cumsum(count) + count, count)
    along = np.ascontiguousarray(steps.along.T, dtype=np.float32)  # a column at a time, in half the time
    turn = np.asarray(1 - sum(np.repeat(column, count) * column[other] for column in along))
    kept = np.flatnonzero(turn <= most)
    return np.repeat(np.arange(len(count)), count)[kept], other[kept], turn[kept]


def _steps(graph: _Graph) -> tuple[NDArray[Any], _Steps, _Steps]:
    """Return the cell of each voxel (V,), the steps between cells some of whose voxels are linked, and those over two
    such steps that do not turn by more than 60 degrees, to cells that no single step leads to."""
    index = np.rint((graph.points - graph.points.min(axis=0)) / graph.voxel).astype(np.int64) // 2
    cell = np.unique(index, axis=0, return_inverse=True)[1]
    held = np.bincount(cell)
    centre = np.stack([np.bincount(cell, weights=column) / held for column in graph.points.T], axis=1)
    length = np.linalg.norm(np.diff(graph.points[graph.links], axis=1)[:, 0], axis=1)
    ends = cell[graph.links]
    apart = ends[:, 0] != ends[:, 1]
    ends, factor = ends[apart], (graph.cost / length)[apart]
    pair, of = np.unique(np.sort(ends, axis=1) @ [len(held), 1], return_inverse=True)
    factor = np.bincount(of, weights=factor) / np.bincount(of)
    low, high = pair // len(held), pair % len(held)
    near = _between(np.append(low, high), np.append(high, low), np.tile(factor, 2), centre)
    one, other, _ = _onward(near, 0.5)
    long = np.linalg.norm(centre[near.head] - centre[near.tail], axis=1)
    factor = (near.cost[one] + near.cost[other]) / (long[one] + long[other])
    pair = near.tail[one] * len(held) + near.head[other]
    order = np.lexsort((factor, pair))
    pair, first = np.unique(pair[order], return_index=True)
    new = ~np.isin(pair, near.tail * len(held) + near.head)
    pair, factor = pair[new], factor[order[first[new]]]
    return cell, near, _between(pair // len(held), pair % len(held), factor, centre)


def _between(tail: NDArray[Any], head: NDArray[Any], factor: Array, centre: Array) -> _Steps:
    """Return the steps between cells (C, 3) [m], each of `factor` (S,) times its length."""
    order = np.argsort(tail, kind="stable")
    tail, head = tail[order], head[order]
    way = centre[head] - centre[tail]
    long = np.linalg.norm(way, axis=1)
    return _Steps(tail, head, long * factor[order], way / long[:, None])


@dataclass(frozen=True, slots=True, eq=False)
class _Graph:
    """Occupied voxels (V, 3) [m] and their edge [m], links (E, 2) with their costs [m], and how planar the surroundings
    are (V,)."""

    points: Array
    voxel: float
    links: NDArray[Any]
    cost: Array
    flatness: Array
    height: float

    def ways(self, feet: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return (V,) the voxel before each on the cheapest way from the soil, a foot's being itself, and (V,) the
        number of the foot (C,) that it goes through; -1: unreached.

        What lies below a foot is a gap, down to the scene's lowest point: leaves that hang grow from no soil.
        """
        n, count = len(self.points), len(feet)
        below = n + np.arange(count)
        gap = _ACROSS_GAP * (self.points[feet, 2] - self.points[:, 2].min()) + 1e-9  # not 0: that would be no link
        ends = np.concatenate([self.links, np.stack([below, feet], axis=1)]).T
        graph = sparse.coo_matrix((np.append(self.cost, gap), ends), (n + count, n + count)).tocsr()
        _, before, source = dijkstra(graph, directed=False, indices=below, return_predecessors=True, min_only=True)
        before, number = before[:n], np.where(before[:n] < 0, -1, source[:n] - n)
        return np.where((before < 0) | (before >= n), np.arange(n), before), number


def _graph(points: Array) -> _Graph:
    spread = np.subtract(*np.quantile(points, [0.998, 0.002], axis=0))
    height = float(max(spread[2], spread.max() / _FINEST))  # of what lies flat a voxel's, else voxels have no bound
    voxel = max(height / _FINEST, 1.3 * point_spacing(points))
    solid = solidify(points, voxel, close=1, fill=0.0)
    label = components(len(solid.index), neighbour_edges(solid.index))
    kept = mark_fragments(solid.points, label, 0.05 * height)
    centres, index = solid.points[kept], solid.index[kept]
    edges = neighbour_edges(index)
    links = _links(centres, components(len(centres), edges), _BRIDGE * height)
    flat, off_middle = surroundings(index, reach=4)
    flat = np.minimum(2 * flat, 1)
    dear = 1 + 3 * (flat + np.minimum(off_middle / 0.4, 1) ** 2)
    factor = np.concatenate([dear[edges].mean(axis=1), np.full(len(links), _ACROSS_GAP)])
    both = np.concatenate([edges, links])
    length = np.linalg.norm(centres[both[:, 0]] - centres[both[:, 1]], axis=1)
    return _Graph(centres, voxel, both, length * factor, flat, height)


def _links(points: Array, label: NDArray[Any], longest: float) -> NDArray[Any]:
    """Return (B, 2) links that join every fragment to a neighbour within `longest` [m], whatever stands alone."""
    found = []
    while True:
        links = bridges(points, label, longest)
        found.append(links)
        done = np.isin(label, np.concatenate([[0], label[links[:, 1]]])) | (label < 0)
        if done.all():
            return np.concatenate(found)
        label = np.where(done, -1, label)
        label[~done] = np.unique(label[~done], return_inverse=True)[1]  # the largest that is left is 0 next


def _minima(graph: _Graph) -> NDArray[Any]:
    """Return the voxels (C,) that are minima of height, of basins deep enough, lowest first.

    On the spanning tree whose links meet as low as they can, basins meet as they do in the graph.
    """
    z, n = graph.points[:, 2], len(graph.points)
    meet, below = z[graph.links].max(axis=1), float(z.min()) - 1.0
    forest = minimum_spanning_tree(
        sparse.coo_matrix((meet - below, (graph.links[:, 0], graph.links[:, 1])), (n, n)).tocsr()
    ).tocoo()
    order = np.argsort(forest.data, kind="stable")
    lowest, depth, heights = list(range(n)), np.full(n, np.inf), z.tolist()

    def basin(voxel: int) -> int:
        while lowest[voxel] != voxel:
            lowest[voxel] = lowest[lowest[voxel]]
            voxel = lowest[voxel]
        return voxel

    links = zip(forest.row[order].tolist(), forest.col[order].tolist(), forest.data[order].tolist(), strict=True)
    for one, two, height in links:
        low, high = sorted((basin(one), basin(two)), key=lambda voxel: (heights[voxel], voxel))
        depth[high] = height + below - heights[high]
        lowest[high] = low
    least_rise = 0.04  # of the scene's height: less is roughness of a cut stem or of a blade
    found = np.flatnonzero(depth >= least_rise * graph.height)
    return found[np.argsort(z[found], kind="stable")]


def _evidence(graph: _Graph, feet: NDArray[Any]) -> Array:
    """Return the evidence (C, 4), each 0 .. 1, larger is better, that a stem stands at each of the voxels `feet` (C,).

    Columns, of what these feet leave to one another: how steeply the ways to all that it carries leave its
    neighbourhood, the sine in the mean, 0 for what ends within; how little the surroundings of the way to its top are a
    plane there; how far the plant rises, of the scene's height; how low the foot is.
    """
    before, number = graph.ways(feet)
    z, rows = graph.points[:, 2], []
    offset = graph.points - graph.points[feet[number]]
    away = np.linalg.norm(offset, axis=1)
    within = away <= 0.15 * graph.height
    rising = np.where(within, 0, np.maximum(offset[:, 2], 0) / np.maximum(away, 1e-12))[_leaving(before, within)]
    for k, foot in enumerate(feet):
        own = np.flatnonzero(number == k)
        if not len(own):
            rows.append(np.zeros(4))  # cheaper reached from another
            continue
        top = own[z[own].argmax()]
        start = [v for v in _way_to(before, top) if within[v]]
        rise, low = (z[top] - z[foot]) / graph.height, 1 - (z[foot] - z.min()) / graph.height
        rows.append([rising[own].mean(), 1 - graph.flatness[start].mean(), rise, low])
    return np.clip(np.array(rows).reshape(-1, 4), 0, 1)


def _leaving(before: NDArray[Any], within: NDArray[np.bool_]) -> NDArray[Any]:
    """Return (V,) the first voxel on the way to each that is not `within` (V,), itself where all are."""
    step = np.where(within | within[before], np.arange(len(before)), before)
    while np.any(step != step[step]):
        step = step[step]
    return step
