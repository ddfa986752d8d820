"""One rooted tree as any skeleton file holds it, and how an undirected tree is given its root. J nodes, metres, z up.

Whatever a file numbers its nodes, they are re-ordered into one tree whose parents come first; `numbers` keeps the
file's own node numbers, so that a node is called the same outside and inside.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.checks import check_array
from anther.errors import bad_input
from anther.geometry import Array
from anther.skeleton import Skeleton

LARGEST_PLANT = 20.0  # [m], a tall tree; a larger number is most likely in millimetres


@dataclass(frozen=True, slots=True, eq=False)
class SkeletonFile:
    """One rooted tree as read from a file.

    Attributes:
        nodes: (J, 3) positions [m]; node 0 is the root.
        parent: (J,) int; parent[0] = -1 and parent[j] < j.
        radius: (J,) [m], or None where the file has none.
        numbers: (J,) int, the number each node has in the file (zero-based for most, the id for SWC and MTG).
        labels: the J organ names ("stem", "branch", ...), or None where the file has none.
    """

    nodes: Array
    parent: NDArray[Any]
    radius: Array | None
    numbers: NDArray[Any]
    labels: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        n = len(self.nodes)
        object.__setattr__(self, "nodes", check_array("skeleton nodes", self.nodes, (n, 3)))
        object.__setattr__(self, "parent", check_array("skeleton parent", self.parent, (n,), dtype="int64"))
        object.__setattr__(self, "numbers", check_array("node numbers", self.numbers, (n,), dtype="int64"))
        if self.radius is not None:
            object.__setattr__(self, "radius", check_array("skeleton radius", self.radius, (n,)))
        if self.labels is not None and len(self.labels) != n:
            raise bad_input("skeleton labels", given=len(self.labels), allowed=f"{n}, one a node", do="Label all.")
        extent = float(np.ptp(self.nodes, axis=0).max(initial=0))
        if extent > LARGEST_PLANT:
            raise bad_input(
                "skeleton", given=f"{extent:g} m across", allowed=f"<= {LARGEST_PLANT:g} m", do="Give metres, not mm."
            )

    def node(self, number: int) -> int:
        """Return the index of the node that the file calls `number`.

        Raises:
            InputError: the file has no such node.
        """
        found = np.flatnonzero(self.numbers == number)
        if not found.size:
            allowed = f"{self.numbers.min()} .. {self.numbers.max()}"
            raise bad_input("node number", given=number, allowed=allowed, do="Use the file's own node numbers.")
        return int(found[0])

    def skeleton(self, radius: float | None = None) -> Skeleton:
        """Return the `Skeleton`; `radius` [m] replaces the file's radii.

        Raises:
            InputError: neither the file nor the caller gives a radius.
        """
        if radius is None and self.radius is None:
            raise bad_input("radius", given="none", allowed="a radius [m]", do="This file has no radii: give one.")
        radii = self.radius if radius is None else np.full(len(self.nodes), radius)
        return Skeleton(self.nodes, self.parent, np.asarray(radii))


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
        edges: (J - 1, 2) pairs of node indices, in any order.
        radius: (J,) [m], or None.
        numbers: (J,) the file's own numbers; None: 0, 1, ...
        root: index of the root; None: the lowest node.
        labels: J organ names, or None.

    Raises:
        InputError: it is not one tree.
    """
    n = len(nodes)
    numbers = np.arange(n) if numbers is None else numbers
    if n < 2 or len(edges) != n - 1 or edges.min() < 0 or edges.max() >= n:
        raise bad_input(
            "skeleton edges",
            given=f"{n} nodes and {len(edges)} edges",
            allowed="J >= 2 nodes and J - 1 edges between them: one tree",
            do="Check for loops, loose parts and edge numbers outside the node list.",
        )
    order, parent = _walk(n, edges, int(np.argmin(nodes[:, 2])) if root is None else root)
    if len(order) < n:
        raise bad_input(
            "skeleton", given=f"{n - len(order)} nodes apart", allowed="one connected tree", do="Keep one part."
        )
    place = np.empty(n, dtype=np.int64)
    place[order] = np.arange(n)
    above = np.where(parent[order] < 0, -1, place[parent[order]])
    named = None if labels is None else tuple(labels[j] for j in order)
    return SkeletonFile(nodes[order], above, None if radius is None else radius[order], numbers[order], named)


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
