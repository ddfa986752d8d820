"""One rooted tree as any skeleton file holds it, and how an undirected tree is given its root. J nodes, metres, z up.

Whatever a file numbers its nodes, they are re-ordered into one tree whose parents come first; `numbers` keeps the
file's own node numbers, so that a node is called the same outside and inside.

Skeletons as MTG text, the plant-architecture format of OpenAlea. J nodes, metres, z up.

Format: C. Godin and Y. Caraglio, "A multiscale model of plant topological structures", J. theor. Biol. 191 (1998), and
https://mtg.readthedocs.io (file format, FORM-A); the layout is the one openalea.mtg's `write_mtg` makes. Scale 1 is the
plant, scale 2 its nodes: class Stem, Branch, ... (or Node), numbered from 1, with XX, YY, ZZ and radius [m].
`<` continues an axis, `+` branches off. In the text a column is a branching order, `^` stands for the last entity in
the same column.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.checks import check_array
from anther.errors import bad_input
from anther.files import read_lines, write_text
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

    def rooted_at(self, number: int | None = None) -> SkeletonFile:
        """Return the same tree with another root: the node that the file calls `number`.

        None: where the plant stands. Scraps of soil hang together with the stem in many scans, and the lowest node is
        often the end of one; the root is then where the way to the highest node begins to rise.

        Raises:
            InputError: the file has no such node.
        """
        edges = np.stack([self.parent[1:], np.arange(1, len(self.nodes))], axis=1)
        labels = None if self.labels is None else list(self.labels)
        root = _base(self.nodes, edges) if number is None else self.node(number)
        return rooted(self.nodes, edges, radius=self.radius, numbers=self.numbers, root=root, labels=labels)

    def skeleton(self, radius: float | Array | None = None) -> Skeleton:
        """Return the `Skeleton`; `radius` [m], one or (J,), replaces the file's radii.

        Raises:
            InputError: neither the file nor the caller gives a radius.
        """
        if radius is None and self.radius is None:
            raise bad_input("radius", given="none", allowed="a radius [m]", do="This file has no radii: give one.")
        radii = self.radius if radius is None else np.broadcast_to(np.asarray(radius, dtype=float), len(self.nodes))
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


THINNEST = 0.5e-3
"""Radius below which nothing is supposed to be [m]: a pedicel's (facts: pollination 2)."""


def supposed_radius(source: SkeletonFile, base: float) -> Array:
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


LOW, FLAT, STEADY = 0.15, 0.2, 0.03
"""A scrap of soil lies within this share of the plant's height and rises by no more than this of its length; a stem
rises by half its length at least, all along this far [m]."""


def _base(nodes: Array, edges: NDArray[Any]) -> int:
    """Return where the way from the lowest node to the highest begins to rise; the lowest, where it does at once."""
    lowest, highest = int(np.argmin(nodes[:, 2])), int(np.argmax(nodes[:, 2]))
    _, parent = _walk(len(nodes), edges, highest)
    way = [lowest]
    while way[-1] != highest and parent[way[-1]] >= 0:
        way.append(int(parent[way[-1]]))
    path = nodes[way]
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    ceiling = path[0, 2] + LOW * np.ptp(nodes[:, 2])
    for k in np.flatnonzero(path[:, 2] <= ceiling):
        ahead = slice(k + 1, int(np.searchsorted(arc, arc[k] + STEADY)) + 1)
        if len(arc[ahead]) and np.all(path[ahead, 2] - path[k, 2] >= 0.5 * (arc[ahead] - arc[k])):
            return way[k] if path[k, 2] - path[0, 2] <= FLAT * arc[k] else lowest
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


FEATURES = ("XX", "YY", "ZZ", "radius")

_ENTITY = re.compile(r"(\^?)([/<+])([A-Za-z]+)(\d*)$")


def write_mtg(path: Path | str, skeleton: Skeleton, labels: Sequence[str] | None = None) -> None:
    """Write a skeleton as MTG.

    Where nodes have several children, the axis goes on through the child with the same label that carries most
    length, else through the one that carries most length; the others branch off.

    Args:
        path: file to write.
        skeleton: the tree.
        labels: an organ name a node (letters only), or None.
    """
    write_text(path, "\n".join([*_header(list(dict.fromkeys(labels or ("node",)))), *_code(skeleton, labels)]) + "\n")


def read_mtg(path: Path | str) -> SkeletonFile:
    """Read the vertices of an MTG that have XX, YY, ZZ [m], as one tree; radius [m] and classes where it has them.

    Vertices without coordinates (plant, axes) only say where the tree begins.

    Raises:
        InputError: no MTG, an entity that cannot be read, no coordinates, or not one tree.
    """
    lines = [line.split("#")[0].rstrip() for line in read_lines(path)]
    heads = [i for i, line in enumerate(lines) if line.startswith("ENTITY-CODE")]
    if not heads:
        raise bad_input(str(path), given="no line ENTITY-CODE", allowed="an MTG file", do="Is it truncated?")
    columns = lines[heads[0]].split("\t")
    if not {"XX", "YY", "ZZ"} <= set(columns):
        raise bad_input(
            str(path), given=f"features {columns[1:]}", allowed="XX, YY, ZZ", do="Export it with coordinates."
        )
    first = min(i for i, name in enumerate(columns) if i and name)
    return _parsed(str(path), [line for line in lines[heads[0] + 1 :] if line.strip()], columns, first)


def _header(classes: list[str]) -> Iterator[str]:
    symbols = [name.capitalize() for name in classes]
    yield from ("CODE :\tFORM-A", "", "CLASSES :", "SYMBOL\tSCALE\tDECOMPOSITION\tINDEXATION\tDEFINITION")
    yield "$\t0\tFREE\tFREE\tIMPLICIT"
    yield "Plant\t1\tFREE\tFREE\tEXPLICIT"
    yield from (f"{symbol}\t2\tFREE\tFREE\tEXPLICIT" for symbol in symbols)
    yield from ("", "DESCRIPTION :", "LEFT\tRIGHT\tRELTYPE\tMAX")
    yield from (f"{left}\t{','.join(symbols)}\t{relation}\t?" for left in symbols for relation in "<+")
    yield from ("", "FEATURES :", "NAME\tTYPE", *(f"{name}\tREAL" for name in FEATURES), "", "MTG :")


def _code(skeleton: Skeleton, labels: Sequence[str] | None) -> Iterator[str]:
    """Yield the entity lines, depth first: branches before the axis goes on, which is what `^` needs."""
    goes_on = successors(skeleton, labels)
    children: list[list[int]] = [[] for _ in skeleton.nodes]
    order = np.zeros(len(skeleton.nodes), dtype=np.int64)
    for j in range(1, len(skeleton.nodes)):
        children[skeleton.parent[j]].append(j)
        order[j] = order[skeleton.parent[j]] + (goes_on[skeleton.parent[j]] != j)
    width = int(order.max()) + 1
    yield "\t".join(["ENTITY-CODE", *[""] * (width - 1), *FEATURES])
    yield "\t".join(["/Plant1", *[""] * (width - 1 + len(FEATURES))])
    waiting = [0]
    while waiting:
        j = waiting.pop()
        relation = "^/" if j == 0 else "^<" if goes_on[skeleton.parent[j]] == j else "+"
        name = "Node" if labels is None else labels[j].capitalize()
        cells = [""] * width
        cells[order[j]] = f"{relation}{name}{j + 1}"
        yield "\t".join([*cells, *(f"{value:.10g}" for value in (*skeleton.nodes[j], skeleton.radius[j]))])
        waiting += sorted(children[j], key=lambda child, here=goes_on[j]: child != here)


def successors(skeleton: Skeleton, labels: Sequence[str] | None = None) -> list[int]:
    """Return for every node the child that continues its axis; -1 at a tip.

    Args:
        skeleton: the tree.
        labels: an organ name a node; an axis rather stays within one organ.
    """
    count = len(skeleton.nodes)
    beyond = np.zeros(count)
    best = [(False, -1.0, -1)] * count
    for j in range(count - 1, 0, -1):
        above = int(skeleton.parent[j])
        carried = float(beyond[j] + np.linalg.norm(skeleton.nodes[j] - skeleton.nodes[above]))
        beyond[above] += carried
        best[above] = max(best[above], (labels is not None and labels[j] == labels[above], carried, j))
    return [child for _, _, child in best]


def _parsed(path: str, lines: list[str], columns: list[str], first: int) -> SkeletonFile:
    last: dict[int, int | None] = {}  # column -> index of its last node; None for an entity without coordinates
    nodes: list[Array] = []
    above: list[int | None] = []
    names: list[tuple[str, str]] = []
    for line in lines:
        cells = line.split("\t")
        column = next(i for i, cell in enumerate(cells) if cell)
        found = _ENTITY.match(cells[column].strip())
        if found is None or column >= first:
            raise bad_input(
                path,
                given=f"entity '{cells[column]}'",
                allowed="[^] / < + Class number",
                do="One entity a line, please.",
            )
        values = dict(zip(columns[first:], cells[first:], strict=False))
        parent = last.get(column if found[1] else column - 1)
        last = {at: node for at, node in last.items() if at < column}
        last[column] = None
        told = [bool(values.get(axis)) for axis in FEATURES[:3]]
        if any(told) and not all(told):
            raise bad_input(path, given=f"only some of XX, YY, ZZ in '{line.strip()}'", allowed="all", do="Is it cut?")
        if all(told):
            last[column] = len(nodes)
            nodes.append(np.array([float(values.get(name) or "nan") for name in FEATURES]))
            above.append(parent)
            names.append((found[3].lower(), found[4]))
    if not nodes or above.count(None) != 1:
        raise bad_input(path, given=f"{above.count(None)} trees with coordinates", allowed="one", do="Keep one plant.")
    return _as_tree(np.array(nodes), above, names)


def _as_tree(table: Array, above: list[int | None], names: list[tuple[str, str]]) -> SkeletonFile:
    edges = np.array([(p, j) for j, p in enumerate(above) if p is not None], dtype=np.int64).reshape(-1, 2)
    numbers = [int(digits) if digits else -1 for _, digits in names]
    return rooted(
        table[:, :3],
        edges,
        radius=table[:, 3] if np.isfinite(table[:, 3]).all() else None,
        numbers=np.array(numbers) if len(set(numbers)) == len(numbers) else None,
        root=above.index(None),
        labels=None if {name for name, _ in names} == {"node"} else [name for name, _ in names],
    )
