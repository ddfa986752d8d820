"""Skeleton files: the node-and-edge .txt of the paper's authors, SWC, and Anther's own .npz. J nodes, metres, z up.

Whatever a file numbers its nodes, they are re-ordered into one tree whose parents come first; `numbers` keeps the
file's own node numbers, so that a node is called the same outside and inside.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.checks import check_array
from anther.errors import InputError, bad_input
from anther.files import existing, write_text
from anther.geometry import Array
from anther.skeleton import Skeleton

SUFFIXES = (".npz", ".swc", ".txt")
LARGEST_PLANT = 20.0  # [m], a tall tree; a larger number is most likely in millimetres


@dataclass(frozen=True, slots=True, eq=False)
class SkeletonFile:
    """One rooted tree as read from a file.

    Attributes:
        nodes: (J, 3) positions [m]; node 0 is the root.
        parent: (J,) int; parent[0] = -1 and parent[j] < j.
        radius: (J,) [m], or None where the file has none.
        numbers: (J,) int, the number each node has in the file (zero-based for .txt and .npz, the id for SWC).
    """

    nodes: Array
    parent: NDArray[Any]
    radius: Array | None
    numbers: NDArray[Any]

    def __post_init__(self) -> None:
        n = len(self.nodes)
        object.__setattr__(self, "nodes", check_array("skeleton nodes", self.nodes, (n, 3)))
        object.__setattr__(self, "parent", check_array("skeleton parent", self.parent, (n,), dtype="int64"))
        object.__setattr__(self, "numbers", check_array("node numbers", self.numbers, (n,), dtype="int64"))
        if self.radius is not None:
            object.__setattr__(self, "radius", check_array("skeleton radius", self.radius, (n,)))
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


def read_skeleton(path: Path | str) -> SkeletonFile:
    """Read a skeleton file: .npz (Anther), .swc, or .txt (`*Nodes` x, y, z [m], then `*Edges`, 1-based pairs).

    The tree is rooted at the lowest node of a .txt, and at the file's own root otherwise.

    Raises:
        InputError: missing, unreadable, not one tree, not finite, or not in metres.
    """
    path = existing(path)
    suffix = path.suffix.lower()
    try:
        if suffix == ".npz":
            stored = Skeleton.load(path)
            return SkeletonFile(stored.nodes, stored.parent, stored.radius, np.arange(len(stored.nodes)))
        if suffix in (".swc", ".txt"):
            lines = path.read_text(encoding="utf-8").splitlines()
            return _read_swc(lines) if suffix == ".swc" else _read_txt(lines)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (UnicodeDecodeError, ValueError, IndexError, OSError) as error:
        raise bad_input(str(path), given=f"unreadable ({error})", allowed="a skeleton file", do="See docs.") from error
    raise bad_input(str(path), given=f"a {suffix} file", allowed=" ".join(SUFFIXES), do="Convert it.")


def write_skeleton(path: Path | str, skeleton: Skeleton) -> None:
    """Write .npz, .swc (type 0 everywhere, metres) or the authors' .txt, which keeps no radii.

    Raises:
        InputError: another suffix.
    """
    path = Path(path)
    match path.suffix.lower():
        case ".npz":
            skeleton.save(path)
        case ".swc":
            write_text(path, "\n".join(_swc_lines(skeleton)) + "\n")
        case ".txt":
            write_text(path, "\n".join(_txt_lines(skeleton)) + "\n")
        case suffix:
            raise bad_input(str(path), given=f"a {suffix} file", allowed=" ".join(SUFFIXES), do="Choose one.")


def _swc_lines(skeleton: Skeleton) -> Iterator[str]:
    yield "# anther skeleton; metres; id type x y z radius parent"
    for j, (x, y, z) in enumerate(skeleton.nodes):
        above = skeleton.parent[j] + 1 if j else -1
        yield f"{j + 1} 0 {x:.9g} {y:.9g} {z:.9g} {skeleton.radius[j]:.9g} {above}"


def _txt_lines(skeleton: Skeleton) -> Iterator[str]:
    yield "*Nodes"
    yield from (f"{x:.9g}, {y:.9g}, {z:.9g}" for x, y, z in skeleton.nodes)
    yield "*Edges"
    yield from (f"{a + 1}, {b + 1}" for a, b in skeleton.edges)


def _read_txt(lines: list[str]) -> SkeletonFile:
    heads = [i for i, line in enumerate(lines) if line.lstrip().startswith("*")]
    names = [lines[i].strip().lower() for i in heads]
    if names != ["*nodes", "*edges"]:
        raise bad_input("skeleton text", given=f"sections {names}", allowed="*Nodes, then *Edges", do="See docs.")
    nodes = _table(lines[heads[0] + 1 : heads[1]], 3)
    edges = _table(lines[heads[1] + 1 :], 2)
    return _rooted(nodes, edges.astype(np.int64) - 1, None, np.arange(len(nodes)), None)


def _read_swc(lines: list[str]) -> SkeletonFile:
    table = _table([line for line in lines if not line.lstrip().startswith("#")], 7)
    numbers = table[:, 0].astype(np.int64)
    index = {int(number): i for i, number in enumerate(numbers)}
    if len(index) < len(numbers):
        raise bad_input("SWC", given="an id twice", allowed="distinct ids", do="Number the samples anew.")
    above = table[:, 6].astype(np.int64)
    lost = [int(p) for p in above if p != -1 and int(p) not in index]
    if lost:
        raise bad_input("SWC", given=f"unknown parent {lost[0]}", allowed="an id of the file, or -1", do="Repair it.")
    roots = np.flatnonzero(above == -1)
    if len(roots) != 1:
        raise bad_input("SWC", given=f"{len(roots)} roots", allowed="one parent -1", do="Keep one tree.")
    edges = np.array([(index[int(p)], i) for i, p in enumerate(above) if p != -1]).reshape(-1, 2)
    return _rooted(table[:, 2:5], edges, table[:, 5], numbers, int(roots[0]))


def _table(lines: list[str], columns: int) -> Array:
    rows = [line.replace(",", " ").split() for line in lines if line.strip()]
    wrong = [row for row in rows if len(row) != columns]
    if wrong:
        raise bad_input(
            "skeleton line", given=" ".join(wrong[0]), allowed=f"{columns} numbers", do="Is the file truncated?"
        )
    return check_array("skeleton numbers", np.array(rows, dtype=np.float64).reshape(-1, columns), (None, columns))


def _rooted(
    nodes: Array, edges: NDArray[Any], radius: Array | None, numbers: NDArray[Any], root: int | None
) -> SkeletonFile:
    """Order an undirected tree from its root (None: the lowest node) outward, breadth first."""
    n = len(nodes)
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
    return SkeletonFile(nodes[order], above, None if radius is None else radius[order], numbers[order])


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
