"""Which points are near: cubic blocks for compiled loops, and the nearest of many. N points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anther.geometry import Array


@dataclass(frozen=True, slots=True, eq=False)
class PointGrid:
    """Points sorted into cubic blocks, so that all within one edge of a point are in 9 runs of 3 blocks.

    Attributes:
        order: (N,) the points in the order of their blocks.
        key: (N,) the number of each sorted point's block; blocks side by side along z have successive numbers.
        held: (B,) the numbers of the blocks that hold points, rising.
        start: (B + 1,) block held[b] holds the sorted points start[b] to start[b + 1].
        stride: (2,) how much the number grows per block along x and along y.
    """

    order: NDArray[Any]
    key: NDArray[Any]
    held: NDArray[Any]
    start: NDArray[Any]
    stride: NDArray[Any]


def blocks(points: Array, edge: float) -> PointGrid:
    """Return the points (N, 3) sorted into blocks of `edge`, in the points' unit."""
    block = ((points - points.min(axis=0)) // edge).astype(np.int64) + 1
    _, columns, rows = block.max(axis=0) + 2
    stride = np.array([columns * rows, rows])
    key = block @ np.append(stride, 1)
    order = np.argsort(key, kind="stable")
    held, start = np.unique(key[order], return_index=True)
    return PointGrid(order, key[order], held, np.append(start, len(points)), stride)


def nearest(points: Array, nodes: Array) -> tuple[Array, NDArray[Any]]:
    """Return (N,) distance from each point to its nearest node, and (N,) which node that is; on all cores."""
    distance, node = KDTree(nodes).query(points, workers=-1)
    return np.asarray(distance), np.asarray(node)
