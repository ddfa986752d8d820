"""The paper's own grasp (P12-P14), for comparison with Anther's ranking."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core import Array, StageFailure, transform
from anther.core.geometry import interpolate
from anther.perception import Skeleton, Stem
from anther.pollination import Grasp
from anther.pollination.grasp import STAND_OFF, Params, Reach

BESIDE = 0.03
"""How far along a branch its direction is taken [m]; branches within twice this of the edge count."""


def paper_grasp(stem: Stem, skeleton: Skeleton, params: Params | None = None, reach: Reach | None = None) -> Grasp:
    """Return the paper's grasp: the midpoint of the core stem's longest edge (P12), approached along n* (P13).

    The pose has its z axis along n* and its x axis along the edge (P14). The paper leaves open the sign of n* and the
    roll by half a turn about it, so the arm is asked for all four, and the first that it reaches counts. Nothing else
    is looked at: neither what the gripper meets on its way in nor flowers, thickness or confidence.

    Args:
        stem, skeleton: the plant.
        params: the gripper's geometry.
        reach: the arm; None takes the first of the four poses.

    Raises:
        StageFailure: "unreachable" when the arm reaches none of the four.
    """
    params = params or Params()
    start, end = paper_edge(stem)
    middle = (start + end) / 2
    nodes = skeleton.nodes[stem.node_ids]
    low, point, high = (interpolate(arc, stem.arc_length, nodes) for arc in (start, middle, end))
    tangent = (high - low) / np.linalg.norm(high - low)
    branch_arc, branches = branch_directions(stem, skeleton, BESIDE)
    n = paper_approach(tangent, branches[_beside(branch_arc, start, end, margin=2 * BESIDE)])
    back = transform(np.eye(3), [0, 0, -STAND_OFF])
    for approach, up in ((n, tangent), (n, -tangent), (-n, tangent), (-n, -tangent)):
        turn = np.column_stack([up, np.cross(approach, up), approach])
        pose = transform(turn, point - params.gripper.depth * approach)
        joints = None if reach is None else reach(pose @ back, pose)
        if reach is None or joints is not None:
            return Grasp(
                T_world_flange=pose,
                point=point,
                tangent=tangent,
                approach=approach,
                arc_length=middle,
                stem_diameter=2 * float(np.interp(middle, stem.arc_length, skeleton.radius[stem.node_ids])),
                clearance=np.nan,
                score=0.0,
                reason=f"the paper's rule: the middle of the longest edge, {100 * (end - start):.0f} cm",
                joints=joints,
            )
    raise StageFailure("unreachable", f"the arm reaches {point.round(3)} m neither along n* = {n.round(2)} nor -n*.")


def _beside(arcs: Array, start: float, end: float, *, margin: float) -> NDArray[np.bool_]:
    """Return which branches (B,) leave the stem from `margin` [m] below the edge to as much above it."""
    return (arcs >= start - margin) & (arcs <= end + margin)


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
        level = np.cross(tangent, [0.0, 0.0, 1.0])
        level = np.cross([0.0, 1.0, 0.0], tangent) if np.linalg.norm(level) < 0.1 else level
        return level / np.linalg.norm(level)
    candidates /= np.linalg.norm(candidates, axis=1, keepdims=True)
    best = candidates[np.argmin(np.abs(candidates @ across.T).max(axis=1))]
    return -best if best @ across.mean(axis=0) > 0 else best


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
