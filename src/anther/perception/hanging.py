"""The axis of a stem that hangs on a string: close to its line below the hook, straight on behind what hides it.

K slices of height, C cells of a square about that line.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter1d, maximum_filter, uniform_filter
from scipy.spatial import KDTree

from anther.core.errors import StageFailure
from anther.core.geometry import Array, interpolate
from anther.perception.cloud import Cloud
from anther.perception.masks import FLOWER, PLANT

__all__ = ["HangingStem", "StringLine", "find_hanging_stem"]


@dataclass(frozen=True, slots=True, eq=False)
class StringLine:
    """The line of a taut string, by the map: stems follow it.

    Attributes:
        hook: (3,) where it hangs [m].
        foot: (3,) where the stem rises, below the hook but not plumb where strings slant [m]; None: plumb.
        others: the lines of strings beside it, on which other stems hang.
    """

    hook: ArrayLike
    foot: ArrayLike | None = None
    others: tuple[StringLine, ...] = ()

    def at(self, height: Array) -> Array:
        """Return where the string passes heights (N,) [m]: (N, 2) [m]."""
        hook = np.asarray(self.hook, dtype=np.float64)
        down = np.array([0.0, 0.0, -1.0]) if self.foot is None else np.asarray(self.foot, dtype=np.float64) - hook
        return hook[:2] + np.multiply.outer((height - hook[2]) / down[2], down[:2])

    def stray(self, height: Array | float) -> Array:
        """Return how far beside that line a stem may be at a height [m]: a guess.

        Maps err by 0.02 m and views by as much; a wind of 1.4 m/s pushes a stem aside by 0.09 of what parts it from
        the nearer end that holds it (simulated rows).
        """
        ends = [end for end in (self.hook, self.foot) if end is not None]
        apart = np.min([np.abs(np.asarray(end)[2] - np.asarray(height)) for end in ends], axis=0)
        return np.asarray(0.06 + 0.1 * apart)

    def is_nearest(self, points: Array) -> NDArray[np.bool_]:
        """Return which points (N, 3) [m] are not nearer to another string than to this one.

        Where two strings are closer than a map can tell them apart, which is so at the foot that two stems share, they
        may be either's.
        """
        apart = 0.06  # m: three times what a map errs by
        height, mine = points[:, 2], self.at(points[:, 2])
        off, own = np.linalg.norm(points[:, :2] - mine, axis=1), np.ones(len(points), dtype=bool)
        for line in self.others:
            other = line.at(height)
            own &= (off <= np.linalg.norm(points[:, :2] - other, axis=1)) | (
                np.linalg.norm(mine - other, axis=1) < apart
            )
        return own

    def is_of_another(self, points: Array, away: Array) -> NDArray[np.bool_]:
        """Return which points (N, 3) [m] are nearer to another string than to the stem that was found on this one.

        Args:
            points: to be told apart.
            away: (N,) of each, from that stem [m].
        """
        unsure = 0.03  # m: by which a stem is off the line that a map gives its string, a guess
        found = np.zeros(len(points), dtype=bool)
        for line in self.others:
            found |= np.linalg.norm(points[:, :2] - line.at(points[:, 2]), axis=1) + unsure < away
        return found


@dataclass(frozen=True, slots=True, eq=False)
class HangingStem:
    """Where a hanging stem is.

    Attributes:
        axis: (K, 3) from below up [m].
        seen: (K,) whether anything of it is seen there.
    """

    axis: Array
    seen: NDArray[np.bool_]

    def completed(self, cloud: Cloud, *, whole: bool = False) -> Cloud:
        """Return the cloud with the stem's surface where it is hidden, or everywhere if `whole`.

        That is for its skeleton, not for what is in the way.
        """
        fine = np.arange(0, len(self.axis) - 1, 0.15)
        line = interpolate(fine, np.arange(len(self.axis)), self.axis)
        line = line[whole | ~self.seen[np.round(fine).astype(int)]]
        turn = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        radius = 0.004  # m, where the stem is hidden: a guess; the skeleton's own radii there come from it
        ring = radius * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
        new = (line[:, None] + ring).reshape(-1, 3)
        labels = np.concatenate([cloud.labels, np.full(len(new), PLANT, np.uint8)])  # type: ignore[list-item]
        return replace(cloud, points=np.vstack([cloud.points, new]), labels=labels, normals=None, colors=None)

    def is_followed(self, nodes: Array, parent: NDArray[np.int64]) -> bool:
        """Return whether a tree of nodes (J, 3) [m] with parents (J,) leads up the stem, and not round through leaves.

        Where a seen stem is thin, a tree may be open: it then gets to what is above by another way.
        """
        on, off = 0.012, 0.03  # m from the axis: of a stem as thick as they come, and of no stem
        away = KDTree(self.axis).query(nodes)[0]
        j = int(np.where(away < on, nodes[:, 2], -np.inf).argmax())
        while j >= 0 and away[j] < off:
            j = int(parent[j])
        return j < 0


def find_hanging_stem(cloud: Cloud, string: StringLine) -> HangingStem:
    """Return the axis of the stem that hangs on a string.

    Of all ways up near the line of its string it is the one along which most upright surface is seen, less what its
    distance from that line and its steps aside cost (dynamic programming over slices of height); the axis is the middle
    of what is seen there.

    Raises:
        StageFailure: "no_stem_found" where nothing hangs there.
    """
    x, y, z = np.asarray(string.hook, dtype=np.float64)
    stray = float(string.stray(cloud.points[:, 2].min(initial=z)))
    beside = cloud.points[:, :2] - string.at(cloud.points[:, 2])
    near = (cloud.labels != FLOWER) & (np.abs(beside) < stray).all(axis=1)
    near[near] = string.is_nearest(cloud.points[near])
    points, beside = cloud.points[near], beside[near]
    upright = np.ones(len(points)) if cloud.normals is None else 1 - np.abs(cloud.normals[near, 2])
    enough = 10.0  # points in 3 x 3 cells: a fifth of what one side of a stem of 10 mm shows in voxels of 1.5 mm
    if upright.sum() < enough:
        raise _nothing(x, y)
    edge = 0.004  # m, of a cell: a stem's radius
    low, side = points[:, 2].min(), int(2 * stray / edge)
    cell = np.minimum(((beside + stray) / edge).astype(int), side - 1)
    slice_ = 0.01  # m, height of a slice: a stem's diameter
    level = ((points[:, 2] - low) / slice_).astype(int)
    count = np.zeros((level.max() + 1, side, side))
    np.add.at(count, (level, cell[:, 0], cell[:, 1]), upright)
    evidence = np.minimum(9 * uniform_filter(count, 3, axes=(1, 2), mode="constant") / enough, 1)
    middles = (np.arange(side) + 0.5) * edge - stray
    away = (
        np.hypot(*np.meshgrid(middles, middles))
        / string.stray(low + (np.arange(len(count)) + 0.5) * slice_)[:, None, None]
    )
    way, found = _best_way(evidence - away**2), evidence > 0.99
    seen = found[np.arange(len(way)), way[:, 0], way[:, 1]]
    ends = np.flatnonzero(seen)
    if len(ends) < 2:
        raise _nothing(x, y)
    kept, number = slice(ends[0], ends[-1] + 1), np.arange(len(way))
    own = np.linalg.norm(beside - ((way[level] + 0.5) * edge - stray), axis=1) < 2.5 * edge
    weight = np.bincount(level[own], upright[own], len(way))
    middle = [np.bincount(level[own], upright[own] * p, len(way))[seen] / weight[seen] for p in points[own, :2].T]
    across = [gaussian_filter1d(np.interp(number[kept], ends, line), 2.0) for line in middle]
    return HangingStem(np.column_stack([*across, low + (number[kept] + 0.5) * slice_]), seen[kept])


def _nothing(x: float, y: float) -> StageFailure:
    return StageFailure("no_stem_found", f"no stem hangs below the hook at {x:.2f}, {y:.2f} m. Is the map right?")


def _best_way(evidence: Array) -> NDArray[np.int64]:
    """Return (K, 2) the cells of the best way up through evidence (K, C, C), a cell aside a slice at most."""
    total, cheapest = evidence[0], [evidence[0]]
    beside = np.ones((3, 3), dtype=bool)
    step = 0.3  # aside by a cell, in slices in which the stem is seen: a stem at 20 degrees is still followed
    for here in evidence[1:]:
        total = here + np.maximum(total, maximum_filter(total, footprint=beside, mode="nearest") - step)
        cheapest.append(total)
    place = np.array(np.unravel_index(np.argmax(total), total.shape))
    way = [place]
    for before in cheapest[-2::-1]:
        low, high = np.maximum(place - 1, 0), place + 2
        around = before[low[0] : high[0], low[1] : high[1]] - step
        around[tuple(place - low)] += step
        place = low + np.array(np.unravel_index(np.argmax(around), around.shape))
        way.append(place)
    return np.array(way[::-1])
