"""The paper's own grasp (P12-P14), for comparison with Anther's ranking."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anther.errors import StageFailure
from anther.geometry import Array, transform
from anther.grasp import Grasp, Params, Reach
from anther.grasp.candidates import branch_directions, flange_pose, paper_approach, paper_edge
from anther.skeleton import Skeleton
from anther.stem import Stem


def paper_grasp(stem: Stem, skeleton: Skeleton, params: Params | None = None, reach: Reach | None = None) -> Grasp:
    """Return the paper's grasp: the midpoint of the core stem's longest edge (P12), approached along n* (P13).

    The pose has its z axis along n* and its x axis along the edge (P14). The paper leaves open the sign of n* and the
    roll by half a turn about it, so the arm is asked for all four, and the first that it reaches counts. Nothing else
    is looked at: neither what the gripper meets on its way in nor flowers, thickness or confidence.

    Args:
        stem, skeleton: the plant.
        params: the gripper's geometry, and how near a branch must be to count.
        reach: the arm; None takes the first of the four poses.

    Raises:
        StageFailure: "unreachable" when the arm reaches none of the four.
    """
    params = params or Params()
    start, end = paper_edge(stem)
    middle = (start + end) / 2
    nodes = skeleton.nodes[stem.node_ids]
    low, point, high = (_at(arc, stem.arc_length, nodes) for arc in (start, middle, end))
    tangent = (high - low) / np.linalg.norm(high - low)
    branch_arc, branches = branch_directions(stem, skeleton, params.window)
    n = paper_approach(tangent, branches[_beside(branch_arc, start, end, margin=2 * params.window)])
    back = transform(np.eye(3), [0, 0, -params.pregrasp_distance])
    for approach, up in ((n, tangent), (n, -tangent), (-n, tangent), (-n, -tangent)):
        pose = flange_pose(point, up, approach, params.gripper.depth)
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


def _at(arc: float, arcs: Array, nodes: Array) -> Array:
    return np.array([np.interp(arc, arcs, nodes[:, axis]) for axis in range(3)])


def _beside(arcs: Array, start: float, end: float, *, margin: float) -> NDArray[np.bool_]:
    """Return which branches (B,) leave the stem from `margin` [m] below the edge to as much above it."""
    return (arcs >= start - margin) & (arcs <= end + margin)
