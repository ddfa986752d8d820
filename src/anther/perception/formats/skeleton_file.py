"""One rooted tree as any skeleton file holds it, and how an undirected tree is given its root. J nodes, metres, z up.

Whatever a file numbers its nodes, they are re-ordered into one tree whose parents come first; `numbers` keeps the
file's own node numbers, so that a node is called the same outside and inside.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from anther.core.choices import Units
from anther.core.errors import bad_input
from anther.core.geometry import Array, arc_length
from anther.core.records import Range, Record, Shape
from anther.perception.formats._raw_points import LIKELY, METRES, other_units
from anther.perception.skeleton import LARGEST, SMALLEST, Skeleton


@dataclass(frozen=True, slots=True, eq=False)
class SkeletonFile(Record):
    """One rooted tree as read from a file.

    Attributes:
        nodes: (J, 3) positions [m]; node 0 is the root.
        parent: (J,) int; parent[0] = -1 and parent[j] < j.
        radius: (J,) [m], or None where the file has none.
        numbers: (J,) int, the number each node has in the file (zero-based for most, the id for SWC and MTG).
        labels: the J organ names ("stem", "branch", ...), or None where the file has none.
        units: of the file, where it states them.
        merged: numbers of nodes of the file that repeat another's point -> the other's number.
        notes: what the user should know.
    """

    CALLED = "skeleton"
    nodes: Annotated[Array, Shape("J", 3), Range(unit="m")]
    parent: Annotated[NDArray[np.int64], Shape("J")]
    radius: Annotated[Array, Shape("J"), Range(unit="m")] | None
    numbers: Annotated[NDArray[np.int64], Shape("J")]
    labels: tuple[str, ...] | None = None
    units: Units | None = None
    merged: dict[int, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def _check(self) -> None:
        n = len(self.nodes)
        if self.labels is not None and len(self.labels) != n:
            raise bad_input("skeleton labels", given=len(self.labels), allowed=f"{n}, one a node", do="Label all.")

    @property
    def _tips(self) -> NDArray[np.bool_]:
        return ~np.isin(np.arange(len(self.nodes)), self.parent)

    def in_metres(self, units: Units | None) -> SkeletonFile:
        """Return the same tree in metres: its numbers are in `units`, else in what the file states, else in metres.

        Raises:
            InputError: a size no plant has; or an unlikely one where the units are not stated.
        """
        stated = units or self.units
        metres = METRES[stated or "m"]
        size = float(np.linalg.norm(np.ptp(self.nodes, axis=0))) * metres
        lower, upper = SMALLEST, LARGEST if stated else LIKELY[1]
        if not lower <= size <= upper:
            given = f"a plant of {size:.3g} m (read in {stated or 'metres'})"
            allowed = f"{lower:g} <= size <= {upper:g} m"
            right = " If it is right: --units m." if LIKELY[1] < size <= LARGEST else ""
            do = other_units(size, stated or "m") + right
            raise bad_input("skeleton", given=given, allowed=allowed, do=do)
        if self.radius is not None and self.radius.min() < 0:
            number = int(self.numbers[np.argmin(self.radius)])
            given = f"radius {self.radius.min():g} at node {number}"
            raise bad_input("skeleton radius", given=given, allowed=">= 0", do="Correct the file.")
        other = bool(units and self.units and units != self.units)
        notes = (f"the file states {self.units} and is read in {units}",) if other else ()
        radius = None if self.radius is None else self.radius * metres
        pointed = 0 if radius is None or not np.any(radius > 0) else int(np.sum(self._tips & (radius <= 0)))
        notes += (f"{pointed} tips of radius 0 are taken for {1e3 * THINNEST:g} mm thin",) if pointed else ()
        return replace(self, nodes=self.nodes * metres, radius=radius, notes=(*self.notes, *notes))

    def node(self, number: int) -> int:
        """Return the index of the node that the file calls `number`.

        Raises:
            InputError: the file has no such node.
        """
        found = np.flatnonzero(self.numbers == self.merged.get(number, number))
        if not found.size:
            allowed = f"{self.numbers.min()} .. {self.numbers.max()}"
            raise bad_input("node number", given=number, allowed=allowed, do="Use the file's own node numbers.")
        return int(found[0])

    def rooted_at(self, number: int | None = None) -> SkeletonFile:
        """Return the same tree with another root: the node that the file calls `number`.

        None: the stem's base. Scraps of soil are connected to the stem in many scans, and the lowest node is
        often the end of one; the root is then where the way to the highest node begins to rise.

        Raises:
            InputError: the file has no such node.
        """
        edges = np.stack([self.parent[1:], np.arange(1, len(self.nodes))], axis=1)
        labels = None if self.labels is None else list(self.labels)
        root = _base(self.nodes, edges) if number is None else self.node(number)
        turned = rooted(self.nodes, edges, radius=self.radius, numbers=self.numbers, root=root, labels=labels)
        return replace(turned, units=self.units, merged=self.merged, notes=self.notes)

    def without_scraps(self) -> SkeletonFile:
        """Return the tree without what leaves the root and stays low: soil in the scan. What goes up stays."""
        ceiling = _ceiling(self.nodes[0], self.nodes)
        limb = np.arange(len(self.nodes))  # of each node, the child of the root that it hangs on
        for j in range(1, len(limb)):
            limb[j] = j if self.parent[j] == 0 else limb[self.parent[j]]
        tall = np.unique(limb[self.nodes[:, 2] > ceiling])
        kept = np.flatnonzero(np.isin(limb, tall) | (limb == 0))
        if not len(tall) or len(kept) == len(limb):
            return self
        parent = np.searchsorted(kept, self.parent[kept], side="right") - 1
        labels = None if self.labels is None else tuple(self.labels[j] for j in kept)
        radius = None if self.radius is None else self.radius[kept]
        return replace(
            self, nodes=self.nodes[kept], parent=parent, radius=radius, numbers=self.numbers[kept], labels=labels
        )

    def skeleton(self, radius: float | Array | None = None, least: float = 0.0) -> Skeleton:
        """Return the `Skeleton`; `radius` [m], one or (J,), replaces the file's radii. None is less than `least` [m].

        A tip that tapers to 0 is as thin as anything is supposed to be (`THINNEST`).

        Raises:
            InputError: neither the file nor the caller gives a radius, or some node's is not above 0.
        """
        if radius is None and self.radius is None:
            raise bad_input("radius", given="none", allowed="a radius [m]", do="This file has no radii: give one.")
        radii = self.radius if radius is None else np.broadcast_to(np.asarray(radius, dtype=float), len(self.nodes))
        radii = np.maximum(np.asarray(radii), least)
        hollow = radii <= 0
        tips = hollow & self._tips
        if np.any(hollow & ~tips):
            node, count = int(self.numbers[np.flatnonzero(hollow & ~tips)[0]]), int((hollow & ~tips).sum())
            given = f"radius 0 at node {node}" + (f" and {count - 1} more" if count > 1 else "")
            do = "Give --radius, one for all, or --least-radius, or correct the file."
            raise bad_input("skeleton radius", given=given, allowed="> 0 m, but for tips", do=do)
        size = float(np.linalg.norm(np.ptp(self.nodes, axis=0)))
        if radii.max() > size:
            given, do = (
                f"radius {radii.max():.3g} m on a plant of {size:.3g} m",
                "Other units? Give --radius, one for all.",
            )
            raise bad_input("skeleton radius", given=given, allowed="no more than its size", do=do)
        radii = np.where(tips, np.minimum(radii[self.parent], THINNEST), radii)
        return Skeleton(self.nodes, self.parent, radii)


def rooted(
    nodes: Array,
    edges: NDArray[Any],
    *,
    radius: Array | None = None,
    numbers: NDArray[Any] | None = None,
    root: int | None = None,
    labels: list[str] | None = None,
) -> SkeletonFile:
    """Order an undirected tree from its root outward, breadth first.

    Args:
        nodes: (J, 3) positions [m].
        edges: (J - 1, 2) pairs of node indices, in any order, either end first.
        radius: (J,) [m], or None.
        numbers: (J,) the file's own numbers; None: 0, 1, ...
        root: index of the root; None: the lowest node.
        labels: J organ names, or None.

    Raises:
        InputError: it is not one tree.
    """
    n = len(nodes)
    numbers = np.arange(n) if numbers is None else numbers
    if len(edges) == n - 1 and n > 2 and edges.min() >= 0 and edges.max() < n:
        same = np.linalg.norm(nodes[edges[:, 0]] - nodes[edges[:, 1]], axis=1) <= 1e-6 * np.ptp(nodes, axis=0).max()
        if same.any() and not same.all():
            return _merged(nodes, edges, same, radius, numbers, root, labels)
    if n < 2 or len(edges) != n - 1 or edges.min() < 0 or edges.max() >= n:
        allowed = "J >= 2 nodes and J - 1 edges between them: one tree"
        do = "Check for loops, loose parts and edge numbers outside the node list."
        raise bad_input("skeleton edges", given=f"{n} nodes and {len(edges)} edges", allowed=allowed, do=do)
    order, parent = _walk(n, edges, int(np.argmin(nodes[:, 2])) if root is None else root)
    if len(order) < n:
        given = f"{n - len(order)} nodes apart"
        raise bad_input("skeleton", given=given, allowed="one connected tree", do="Keep one part.")
    place = np.empty(n, dtype=np.int64)
    place[order] = np.arange(n)
    above = np.where(parent[order] < 0, -1, place[parent[order]])
    named = None if labels is None else tuple(labels[j] for j in order)
    return SkeletonFile(nodes[order], above, None if radius is None else radius[order], numbers[order], named)


def _merged(
    nodes: Array,
    edges: NDArray[Any],
    same: NDArray[np.bool_],
    radius: Array | None,
    numbers: NDArray[Any],
    root: int | None,
    labels: list[str] | None,
) -> SkeletonFile:
    """Return the tree whose edges without length, the `same`, are taken out: of such nodes the first stays.

    Programs begin a branch with a copy of the point it leaves.
    """
    first = np.arange(len(nodes))
    for a, b in edges[same]:
        low, high = sorted((int(first[a]), int(first[b])))
        first[first == high] = low
    kept = np.unique(first)
    place = np.searchsorted(kept, first)
    merged = {int(numbers[j]): int(numbers[first[j]]) for j in np.flatnonzero(first != np.arange(len(nodes)))}
    tree = rooted(
        nodes[kept],
        place[edges[~same]],
        radius=None if radius is None else radius[kept],
        numbers=numbers[kept],
        root=None if root is None else int(place[root]),
        labels=None if labels is None else [labels[j] for j in kept],
    )
    few = ", ".join(str(number) for number in list(merged)[:5]) + (" ..." if len(merged) > 5 else "")
    note = f"nodes that repeat the point of the one they hang on were left out: {few}"
    return replace(tree, merged=merged, notes=(note,))


THINNEST = 0.5e-3
"""Radius below which nothing is supposed to be [m]: a pedicel's (facts: pollination 2)."""


def assume_radii(source: SkeletonFile, base: float) -> Array:
    """Return (J,) radii [m] of a plant of which only the lines are known: sections that add up (pipes, Shinozaki 1964).

    A node's section is to that of the stem's base as the length of all that it carries is to the whole plant's.

    Args:
        source: the lines.
        base: radius of the stem at its root [m].
    """
    carried = np.zeros(len(source.nodes))
    for j in range(len(source.nodes) - 1, 0, -1):
        length = float(np.linalg.norm(source.nodes[j] - source.nodes[source.parent[j]]))
        carried[source.parent[j]] += carried[j] + length
    return np.maximum(base * np.sqrt(carried / carried[0]), THINNEST)


def _ceiling(base: Array, nodes: Array) -> float:
    """Return the height below which a scrap of soil lies [m]: a share of the plant's above its base (3,)."""
    share = 0.15
    return float(base[2] + share * np.ptp(nodes[:, 2]))


def _base(nodes: Array, edges: NDArray[Any]) -> int:
    """Return where the way from the lowest node to the highest begins to rise; the lowest, where it does at once.

    A stem rises by half its length at least, all along 30 mm; a scrap of soil by a fifth of its length at most.
    """
    lowest, highest = int(np.argmin(nodes[:, 2])), int(np.argmax(nodes[:, 2]))
    _, parent = _walk(len(nodes), edges, highest)
    way = [lowest]
    while way[-1] != highest and parent[way[-1]] >= 0:
        way.append(int(parent[way[-1]]))
    path = nodes[way]
    arc = arc_length(path)
    ceiling = _ceiling(path[0], nodes)
    for k in np.flatnonzero(path[:, 2] <= ceiling):
        ahead = slice(k + 1, int(np.searchsorted(arc, arc[k] + 0.03)) + 1)
        if len(arc[ahead]) and np.all(path[ahead, 2] - path[k, 2] >= 0.5 * (arc[ahead] - arc[k])):
            return way[k] if path[k, 2] - path[0, 2] <= 0.2 * arc[k] else lowest
    return lowest


def _walk(n: int, edges: NDArray[Any], root: int) -> tuple[list[int], NDArray[Any]]:
    neighbours: list[list[int]] = [[] for _ in range(n)]
    for a, b in edges:
        neighbours[a].append(int(b))
        neighbours[b].append(int(a))
    parent, seen = np.full(n, -1), {root}
    order, queue = [], deque([root])
    while queue:
        node = queue.popleft()
        order.append(node)
        for other in neighbours[node]:
            if other not in seen:
                seen.add(other)
                parent[other] = node
                queue.append(other)
    return order, parent
