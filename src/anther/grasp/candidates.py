"""Where along the stem and from which side a gripper could come. B branches.

Holds the two rules of the paper (P12, P13) and the candidates that Anther's own ranking searches.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.geometry import Array
from anther.skeleton import Skeleton
from anther.stem import Stem


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Stations times directions times the two rolls about the approach (camera towards tip or root). C candidates.

    Attributes:
        station: (C,) index of the station along the stem.
        arc_length: (C,) distance from the root along the stem [m].
        points: (C, 3) on the centreline [m].
        tangents: (C, 3) unit stem direction, root to tip.
        approach: (C, 3) unit approach direction.
        T_world_flange: (C, 4, 4).
        radius: (C,) stem radius [m].
        bend: (C,) rms distance of the centreline from its straight fit [m].
        attachment_distance: (C,) along the stem to the nearest attachment [m]; infinite without any.
        opening: (C,) between the pads on the way in [m].
    """

    station: NDArray[Any]
    arc_length: Array
    points: Array
    tangents: Array
    approach: Array
    T_world_flange: Array
    radius: Array
    bend: Array
    attachment_distance: Array
    opening: Array

    def outward(self) -> Array:
        """Return (C,) the cosine between approach and the horizontal direction from the base, the world's origin."""
        away = self.points[:, :2] / np.maximum(np.linalg.norm(self.points[:, :2], axis=1, keepdims=True), 1e-9)
        return np.sum(self.approach[:, :2] * away, axis=1)

    def opened(self, openings: tuple[float, ...]) -> Candidates:
        """Return them all with the first opening [m], then all with the second, and so on."""
        every = self.only(np.tile(np.arange(len(self.station)), len(openings)))
        return replace(every, opening=np.repeat(openings, len(self.station)))

    def only(self, which: NDArray[Any]) -> Candidates:
        """Return those candidates of these (C,), or of these numbers."""
        return Candidates(*(getattr(self, f.name)[which] for f in fields(self)))


def candidates_along(
    stem: Stem,
    skeleton: Skeleton,
    *,
    directions: int,
    spacing: float,
    window: float,
    ends: tuple[float, float],
    depth: float,
) -> Candidates:
    """Return every grasp to be considered.

    Args:
        stem, skeleton: the plant.
        directions: evenly around the stem.
        spacing: of stations along the stem [m].
        window: half length of the stem piece fitted [m].
        ends: lengths left out at root and tip [m].
        depth: from the flange to the middle of the pads [m].
    """
    arcs = np.arange(ends[0], stem.arc_length[-1] - ends[1] + 1e-9, spacing)
    free = np.abs(np.append(stem.arc_length[stem.attachments], np.inf) - arcs[:, None]).min(axis=1)
    fits = zip(*_fits(stem, skeleton, arcs, window), strict=True)
    points, tangents, radius, bend = (np.array(column) for column in fits)
    around = np.stack([directions_across(tangent, directions) for tangent in tangents])
    rolls = np.stack([tangents, -tangents], axis=1)
    station, direction, roll = (i.ravel() for i in np.indices((len(arcs), directions, 2)))
    n, up = around[station, direction], rolls[station, roll]
    pose = flange_pose(points[station], up, n, depth)
    return Candidates(
        station,
        arcs[station],
        points[station],
        tangents[station],
        n,
        pose,
        radius[station],
        bend[station],
        free[station],
        np.full(len(station), np.nan),
    )


def _fits(stem: Stem, skeleton: Skeleton, arcs: Array, window: float) -> list[tuple[Array, Array, float, float]]:
    """Return point, tangent, radius and bend of a straight fit to the stem around each arc length.

    No place of a stem is much thinner than the stem about it: one that seems to be is half hidden.
    """
    s, nodes = stem.arc_length, skeleton.nodes[stem.node_ids]
    dense = np.linspace(s[0], s[-1], max(int(10 * (s[-1] - s[0]) / window), 20))
    line = np.stack([np.interp(dense, s, nodes[:, i]) for i in range(3)], axis=1)
    radius = np.interp(dense, s, skeleton.radius[stem.node_ids])
    fits = []
    for arc in arcs:
        near, about = np.abs(dense - arc) <= window, np.abs(dense - arc) <= 4 * window
        point, tangent, bend = _straight_fit(dense[near] - arc, line[near])
        fits.append((point, tangent, float(max(np.median(radius[near]), np.median(radius[about]))), bend))
    return fits


def _straight_fit(t: Array, points: Array) -> tuple[Array, Array, float]:
    """Return value and unit slope at t = 0 and rms residual [m] of the least-squares line through points (N, 3)."""
    slope, offset = np.polyfit(t, points, 1)
    residual = points - np.outer(t, slope) - offset
    return offset, slope / np.linalg.norm(slope), float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))


def paper_edge(stem: Stem) -> tuple[float, float]:
    """Return the arc lengths [m] at which the core stem's longest edge begins and ends (P12).

    The paper's skeleton is simplified to junctions and endpoints (P9), so an edge is the stem between two of them.
    """
    joints = np.unique(stem.arc_length[[0, *stem.attachments, -1]])
    longest = int(np.argmax(np.diff(joints)))
    return float(joints[longest]), float(joints[longest + 1])


def paper_approach(tangent: Array, branches: Array) -> Array:
    """Return the paper's approach direction n* = argmin over unit n perpendicular to v of max_j |n . b_j| (P13).

    In the plane across the stem each branch contributes |n . p_j| with p_j its projection. The largest of these is
    smallest either where one vanishes, n perpendicular to p_j, or where two are equal, n perpendicular to p_i +- p_j:
    a finite set, tried in full. The sign of n is free; the one returned points away from the branches' mean.

    Args:
        tangent: (3,) unit stem direction v.
        branches: (B, 3) unit directions of nearby branches; none gives a direction in the horizontal plane if possible.
    """
    across = np.asarray(branches).reshape(-1, 3)
    across = across - np.outer(across @ tangent, tangent)
    normals = [*across, *(a + b for a, b in combinations(across, 2)), *(a - b for a, b in combinations(across, 2))]
    candidates = np.array([np.cross(tangent, p) for p in normals if np.linalg.norm(p) > 1e-9]).reshape(-1, 3)
    if len(candidates) == 0:
        return directions_across(tangent, 1)[0]
    candidates /= np.linalg.norm(candidates, axis=1, keepdims=True)
    best = candidates[np.argmin(np.abs(candidates @ across.T).max(axis=1))]
    return -best if best @ across.mean(axis=0) > 0 else best


def directions_across(tangent: Array, count: int) -> Array:
    """Return (count, 3) unit directions evenly around the stem, perpendicular to its `tangent` (3,)."""
    first = np.cross(tangent, [0.0, 0.0, 1.0])
    if np.linalg.norm(first) < 0.1:
        first = np.cross([0.0, 1.0, 0.0], tangent)
    first /= np.linalg.norm(first)
    angles = 2 * np.pi * np.arange(count) / count
    return np.outer(np.cos(angles), first) + np.outer(np.sin(angles), np.cross(tangent, first))


def flange_pose(point: Array, tangent: Array, approach: Array, depth: float) -> Array:
    """Return T_world_flange (..., 4, 4): `point` (..., 3) is `depth` [m] along +z = `approach`, +x = `tangent`."""
    T = np.zeros((*np.shape(point)[:-1], 4, 4))
    T[..., 3, 3] = 1
    T[..., :3, :3] = np.stack([tangent, np.cross(approach, tangent), approach], axis=-1)
    T[..., :3, 3] = point - depth * approach
    return T


def branch_directions(stem: Stem, skeleton: Skeleton, length: float) -> tuple[Array, Array]:
    """Return the arc length (B,) [m] at which each branch leaves the stem and its unit direction there (B, 3).

    Args:
        stem, skeleton: the plant.
        length: how far along the branch its direction is taken [m].
    """
    position = {int(node): i for i, node in enumerate(stem.node_ids)}
    on_stem = np.zeros(len(skeleton.nodes), dtype=bool)
    on_stem[stem.node_ids] = True
    starts = [j for j in range(1, len(skeleton.nodes)) if not on_stem[j] and on_stem[skeleton.parent[j]]]
    ends = _walk_out(skeleton, starts, length)
    arcs = [stem.arc_length[position[int(skeleton.parent[j])]] for j in starts]
    rays = skeleton.nodes[ends] - skeleton.nodes[skeleton.parent[starts]] if starts else np.zeros((0, 3))
    sizes = np.linalg.norm(rays, axis=1)
    keep = sizes > 1e-9
    return np.array(arcs)[keep] if starts else np.zeros(0), rays[keep] / sizes[keep, None]


def _walk_out(skeleton: Skeleton, starts: list[int], length: float) -> NDArray[Any]:
    """Return for each start node the first node at least `length` [m] out along the branch's deepest path."""
    step = np.linalg.norm(skeleton.nodes[1:] - skeleton.nodes[skeleton.parent[1:]], axis=1)
    beyond, next_node = np.zeros(len(skeleton.nodes)), np.full(len(skeleton.nodes), -1)
    for j in range(len(skeleton.nodes) - 1, 0, -1):
        parent, reach = skeleton.parent[j], beyond[j] + step[j - 1]
        if reach > beyond[parent]:
            beyond[parent], next_node[parent] = reach, j
    ends = []
    for start in starts:
        node, walked = start, step[start - 1]
        while walked < length and next_node[node] >= 0:
            node = int(next_node[node])
            walked += step[node - 1]
        ends.append(node)
    return np.array(ends, dtype=np.int64)
