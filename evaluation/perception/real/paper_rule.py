"""The paper's main stem and grasp (P9-P12) from any skeleton graph, as written. J nodes, E edges."""

from __future__ import annotations

from itertools import groupby, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, connected_components

from anther.core import Array
from anther.core.geometry import arc_length, interpolate
from evaluation.perception.real.answers import NoAnswer

ALPHA, V_BIAS = 2.0, 1.0
"""The paper gives no values of its hyperparameters; these are Anther's defaults."""
LEAN = 45.0
"""A segment farther from the vertical leaves the growth axis [degrees]; the paper gives no value."""

Path = NDArray[Any]


def core_stem(nodes: Array, edges: NDArray[Any], radius: Array) -> tuple[NDArray[Any], Array]:
    """Return (edges of the core stem (T, 2), grasp point (3,)).

    Of a forest the largest tree is used, rooted at its lowest node. Where the paper leaves a choice open, the kinder
    one is taken: segments between junctions keep the skeleton's shape instead of becoming chords, and of what is left
    after removing segments that leave the vertical the core stem is the longest unbroken run. (All that is left does
    worse on stem and grasp; what comes before the first such segment is often nothing.)

    Args:
        nodes: (J, 3) [m].
        edges: (E, 2), without cycles.
        radius: (J,) [m].

    Raises:
        NoAnswer: no segment is within 45 degrees of the vertical.
    """
    segments = _best_path(nodes, _segments(*_rooted(nodes, edges)), radius)
    runs = [list(run) for upright, run in groupby(segments, lambda s: _lean(nodes, s) <= LEAN) if upright]
    if not runs:
        raise NoAnswer("no stem: every segment of the best path leaves the vertical")
    core = max(runs, key=lambda run: sum(_length(nodes, s) for s in run))
    links = [pair for segment in core for pair in pairwise(segment)]
    return np.array(links), _midpoint(nodes[max(core, key=lambda s: _length(nodes, s))])


def _rooted(nodes: Array, edges: NDArray[Any]) -> tuple[Path, Path]:
    """Return (order, parent) of the largest tree, from its lowest node outward."""
    graph = sparse.coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), (len(nodes),) * 2).tocsr()
    label = connected_components(graph, directed=False)[1]
    inside = label == np.bincount(label).argmax()
    root = np.flatnonzero(inside)[nodes[inside, 2].argmin()]
    order, parent = breadth_first_order(graph, root, directed=False)
    return order, parent


def _segments(order: Path, parent: Path) -> list[Path]:
    """Return the chains between root, junctions and endpoints, each from its upper end to its lower, root first."""
    children = np.bincount(parent[order[1:]], minlength=len(parent))
    ends = {int(order[0])} | {int(node) for node in order if children[node] != 1}
    segments = []
    for node in order[1:]:
        if int(node) in ends:
            chain = [int(node)]
            while len(chain) == 1 or chain[-1] not in ends:
                chain.append(int(parent[chain[-1]]))
            segments.append(np.array(chain[::-1]))
    return segments


def _best_path(nodes: Array, segments: list[Path], radius: Array) -> list[Path]:
    """Return the segments of the root-to-leaf path with the largest score S (P10)."""
    if not segments:
        raise NoAnswer("no stem: the skeleton is one point")
    score, above = {int(segments[0][0]): 0.0}, {}
    for segment in segments:
        start, end = int(segment[0]), int(segment[-1])
        length = _length(nodes, segment)
        upright = 1 + V_BIAS * abs(nodes[end, 2] - nodes[start, 2]) / length
        score[end] = score[start] + length * float(radius[segment].mean() / radius.max()) ** ALPHA * upright
        above[end] = segment
    node, path = max(score, key=score.__getitem__), []
    while node in above:
        path.append(above[node])
        node = int(above[node][0])
    return path[::-1]


def _lean(nodes: Array, segment: Path) -> float:
    along = nodes[segment[-1]] - nodes[segment[0]]
    return float(np.degrees(np.arccos(abs(along[2]) / max(float(np.linalg.norm(along)), 1e-12))))


def _length(nodes: Array, segment: Path) -> float:
    return float(np.linalg.norm(np.diff(nodes[segment], axis=0), axis=1).sum())


def _midpoint(line: Array) -> Array:
    """Return the point half way along a polyline (P12)."""
    arc = arc_length(line)
    return interpolate(arc[-1] / 2, arc, line)
