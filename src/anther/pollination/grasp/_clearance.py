"""How far an open gripper stays from what surrounds the stem. P poses, M balls, G boxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anther.core.compiling import compiled, inlined
from anther.core.geometry import Array
from anther.perception.cloud import Cloud, Support
from anther.perception.masks import FLOWER
from anther.perception.skeleton import Skeleton
from anther.perception.stem import LEAF as ORGAN_LEAF
from anther.perception.stem import TRUSS, Stem

LEAF, FLOWER_POINT, BRANCH, STEM, OBSTACLE, RIGID, STRING = range(7)
FAR = 0.03  # m, distances beyond are not told apart


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """Everything near the stem as balls.

    Attributes:
        centers: (M, 3) [m].
        radius: (M,) [m]; 0 for a surface point.
        kind: (M,) LEAF (any plant surface off the stem), FLOWER_POINT (of flowers, and of trusses, which carry flowers
            or fruit), BRANCH (the piece of it near the stem), STEM, OBSTACLE (pot, soil, bench), RIGID (a stake, pole
            or wire, or another plant's stem) or STRING.
        stiffness: (M,) force that pushing it aside by a metre takes, over Young's modulus [m]; 0 but of branches.
    """

    centers: Array
    radius: Array
    kind: NDArray[Any]
    stiffness: Array


@dataclass(frozen=True, slots=True, eq=False)
class Clearance:
    """What a gripper at each pose meets on its straight way in.

    Attributes:
        distance: (P, 7) to the nearest ball of each kind [m], negative inside, at most `FAR`.
        touched: (P, 7) how many balls of each kind the way in touches.
        enclosed: (P, 7) how many balls of each kind lie between the open pads, of RIGID ones between the fingers.
        spread: (P, 7) how far the outermost of these reaches from the plane on which the pads meet [m]; 0 without any.
        push: (P,) force with which the branch that is pushed aside most pushes back, over Young's modulus [m2].
    """

    distance: Array
    touched: NDArray[Any]
    enclosed: NDArray[Any]
    spread: Array
    push: Array

    @classmethod
    def of(cls, parts: Sequence[Clearance]) -> Clearance:
        """Return what these meet, one after the other."""
        return cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))

    def squeezed(self, radius: Array) -> Array:
        """Return (P,) how far what the pads fold, and push a stem of radius (P,) aside with, reaches beyond it [m]."""
        return np.maximum(self.spread[:, BRANCH] - radius, 0)


def surroundings_of(stem: Stem, skeleton: Skeleton, cloud: Cloud) -> Surroundings:
    """Return stem, petioles, leaves, flowers, obstacles and supports as balls.

    The stem is taken from the skeleton, not from its surface points, which a depth camera makes too thick; points on
    it are left out. A branch is stiff for its first 10 cm, a leaf for 6 cm; everywhere the surface
    points count as leaf, merged in cubes of 6 mm.

    Args:
        stem, skeleton, cloud: the plant, pot and bench.
    """
    outward = _distance_from_stem(stem, skeleton)
    stem_balls = _balls_along(skeleton, stem.node_ids[1:], 0.003, outward)
    stalk = 0.06  # m, of what looks like leaf from its base on: it has a stalk all the same; our judgement
    stiff_length = 0.1  # m of a branch next to the stem that push back
    stiff = (outward > 0) & (outward < np.where(stem.organ == ORGAN_LEAF, stalk, stiff_length))
    branch_balls = _balls_along(skeleton, np.flatnonzero(stiff), 0.003, outward)
    line = KDTree(stem_balls[:, :3])
    free = lambda points, margin: points[_outside(points, line, stem_balls[:, 3], margin)]  # noqa: E731
    is_flower = np.asarray(cloud.labels) == FLOWER
    supports = {
        kind: _support_balls([s for s in cloud.supports if s.soft == (kind == STRING)]) for kind in (RIGID, STRING)
    }
    others = np.full(len(skeleton.neighbours), np.median(skeleton.radius[stem.node_ids]))  # stems as thick as this one
    supports[RIGID] = np.concatenate([supports[RIGID], np.column_stack([skeleton.neighbours, others])])
    fuzz = 0.004  # m: points this near the stem's surface are its own
    piece = 0.006  # m: leaves and trusses are counted as pieces of this size
    hanging = _balls_along(skeleton, np.flatnonzero((stem.organ == TRUSS) & (outward >= stiff_length)), piece, outward)
    flowers = thin_out(cloud.points[is_flower], piece)
    parts = [
        (LEAF, free(thin_out(np.concatenate([cloud.points[~is_flower], cloud.loose]), piece), fuzz)),
        (FLOWER_POINT, np.concatenate([flowers, hanging[:, :3]])),
        (BRANCH, branch_balls[:, :3]),
        (STEM, stem_balls[:, :3]),
        (OBSTACLE, thin_out(cloud.obstacles, piece)),
        *((kind, balls[:, :3]) for kind, balls in supports.items()),
    ]
    radius = {BRANCH: np.minimum(branch_balls[:, 3], 0.005), STEM: stem_balls[:, 3]}
    radius[FLOWER_POINT] = np.append(np.zeros(len(flowers)), hanging[:, 3])
    radius |= {kind: balls[:, 3] for kind, balls in supports.items()}
    petiole = 0.002  # m, its radius: depth cameras make thin ones too thick; our estimate, for peppers
    least_lever = 0.015  # m: nearer to the stem a petiole is no stiffer, it swells and turns with its node
    stiffness = {BRANCH: 0.75 * np.pi * petiole**4 / np.maximum(branch_balls[:, 4], least_lever) ** 3}  # 3 I/s^3
    of = lambda values: np.concatenate([values.get(k, np.zeros(len(points))) for k, points in parts])  # noqa: E731
    centers = np.concatenate([points for _, points in parts])
    kind = np.concatenate([np.full(len(points), k) for k, points in parts])
    return Surroundings(centers, of(radius), kind, of(stiffness))


def _support_balls(supports: Sequence[Support]) -> Array:
    """Return (M, 4) centres and radii of balls along the axes of supports, at most 3 mm apart."""
    return np.concatenate([np.zeros((0, 4)), *(support.balls(0.003) for support in supports)])


def _outside(points: Array, line: KDTree, radius: Array, margin: float) -> NDArray[np.bool_]:
    distance, nearest = line.query(points)
    return distance > radius[nearest] + margin


def _distance_from_stem(stem: Stem, skeleton: Skeleton) -> Array:
    """Return (J,) how far along its branch each node is from the stem [m]; 0 on the stem."""
    distance = np.zeros(len(skeleton.nodes))
    on_stem = np.zeros(len(skeleton.nodes), dtype=bool)
    on_stem[stem.node_ids] = True
    for j in np.flatnonzero(~on_stem):
        if j > 0:
            p = skeleton.parent[j]
            distance[j] = distance[p] + np.linalg.norm(skeleton.nodes[j] - skeleton.nodes[p])
    return distance


def _balls_along(skeleton: Skeleton, ends: NDArray[Any], step: float, outward: Array) -> Array:
    """Return (M, 5) centres, radii and distances from the stem of balls along the edges that end at nodes `ends`.

    They are at most `step` [m] apart. An edge that leaves the stem has the radius of its end: a petiole is not as thick
    as the stem. `outward` (J,) are the nodes' distances from the stem [m].
    """
    starts = skeleton.parent[ends]
    leaves = (outward[starts] == 0) & (outward[ends] > 0)
    a = np.column_stack([skeleton.nodes[starts], skeleton.radius[np.where(leaves, ends, starts)], outward[starts]])
    b = np.column_stack([skeleton.nodes[ends], skeleton.radius[ends], outward[ends]])
    count = np.maximum(np.ceil(np.linalg.norm((b - a)[:, :3], axis=1) / step).astype(int), 1)
    edge = np.repeat(np.arange(len(ends)), count)
    t = (np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count) + 1) / count[edge]
    return a[edge] + t[:, None] * (b - a)[edge]


def thin_out(points: Array, size: float) -> Array:
    """Return one point per cube of edge `size` [m]: the mean of those inside."""
    if len(points) == 0:
        return points
    cells = np.floor((points - points.min(axis=0)) / size).astype(np.int64)
    extent = cells.max(axis=0) + 1
    keys = (cells[:, 0] * extent[1] + cells[:, 1]) * extent[2] + cells[:, 2]
    _, inverse, count = np.unique(keys, return_inverse=True, return_counts=True)
    return np.stack([np.bincount(inverse, weights=points[:, i]) for i in range(3)], axis=1) / count[:, None]


def clearance(poses: Array, surroundings: Surroundings, boxes: Array, closing: Array) -> Clearance:
    """Return what a gripper made of boxes meets at each pose.

    Args:
        poses: (P, 4, 4) T_world_flange.
        surroundings: the balls.
        boxes: (G, 6) lower and upper corners in the flange frame [m]; swept boxes make it the whole way in.
        closing: (2, 6) lower and upper corners of the space between the open pads, and between the fingers: what is
            rigid must not be there either.
    """
    shape = (len(poses), 7)  # kinds of ball
    distance = np.full(shape, FAR)
    touched, enclosed = (np.zeros(shape, dtype=np.int64) for _ in range(2))
    spread, push = np.zeros(shape), np.zeros(len(poses))
    if len(surroundings.centers):
        order, start, cells = _cells(surroundings)
        s = surroundings
        balls = (s.centers[order], s.radius[order], s.kind[order], s.stiffness[order])
        both = np.vstack([boxes, closing])
        lower, upper = both[:, :3].min(axis=0), both[:, 3:].max(axis=0)
        found = distance, touched, enclosed, spread, push
        touch = 0.002  # m: a piece nearer than this to the way in counts as touched
        _meet(poses, *balls, start, cells, boxes, closing, touch, *found, lower, upper, np.empty(3))
    return Clearance(distance, touched, enclosed, spread, push)


def _cells(s: Surroundings) -> tuple[NDArray[Any], NDArray[Any], Array]:
    """Return the balls' order by cubes of 3 cm, where each cube begins in it, and balls (L, 4) about the cubes' own.

    A gripper is near few cubes, so that most balls need not be looked at.
    """
    edge = 0.03  # m, of the cubes in which balls are looked up; only speed depends on it
    cells, cell, count = np.unique(np.floor(s.centers / edge), axis=0, return_inverse=True, return_counts=True)
    middle = edge * (cells + 0.5)
    far = np.zeros(len(cells))
    np.maximum.at(far, cell, np.linalg.norm(s.centers - middle[cell], axis=1) + s.radius)
    start = np.concatenate([[0], np.cumsum(count)])
    return np.argsort(cell, kind="stable"), start, np.column_stack([middle, far])


@compiled
def _meet(
    poses,
    centers,
    radius,
    kind,
    stiffness,
    start,
    cells,
    boxes,
    closing,
    touch,
    distance,
    touched,
    enclosed,
    spread,
    push,
    lower,
    upper,
    local,
):
    for i in range(len(poses)):
        for c in range(len(cells)):
            if not _near(poses[i], cells[c], cells[c, 3] + FAR, lower, upper, local):
                continue
            for m in range(start[c], start[c + 1]):
                k = kind[m]
                gap = _more(distance[i, k], touch)  # beyond, it changes nothing
                if not _near(poses[i], centers[m], radius[m] + gap, lower, upper, local):
                    continue
                for g in range(len(boxes)):
                    gap = _less(gap, _box_distance(local, boxes[g], gap + radius[m]) - radius[m])
                distance[i, k] = _less(distance[i, k], gap)
                touched[i, k] += gap < touch
                push[i] = _more(push[i], (touch - gap) * stiffness[m])
                if _box_distance(local, closing[1 if k == RIGID else 0], radius[m]) < radius[m]:
                    enclosed[i, k] += 1
                    spread[i, k] = _more(spread[i, k], abs(local[1]) + radius[m])


@inlined
def _near(pose, point, margin, lower, upper, local):
    """Put a point into the pose's frame, and return whether it is within `margin` of the box there."""
    for a in (1, 0, 2):
        local[a] = 0.0
        for b in range(3):
            local[a] += pose[b, a] * (point[b] - pose[b, 3])
        if local[a] < lower[a] - margin or local[a] > upper[a] + margin:
            return False
    return True


@inlined
def _less(a, b):
    return b if b < a else a


@inlined
def _more(a, b):
    return b if b > a else a


@inlined
def _box_distance(p, box, most):
    """Return the signed distance of a point from a box, negative inside; `most` or more when it is at least that."""
    outside, inside = 0.0, -np.inf
    for a in range(3):
        d = _more(box[a] - p[a], p[a] - box[a + 3])
        if d >= most:
            return d
        inside = _more(inside, d)
        if d > 0.0:
            outside += d * d
    return inside if outside == 0.0 else np.sqrt(outside)
