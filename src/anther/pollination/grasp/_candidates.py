"""Where along the stem and from which side a gripper could come, and how sure it is that the main stem stands there.

C candidates, K places along the stem.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anther.core.geometry import Array, interpolate
from anther.perception.skeleton import Skeleton
from anther.perception.skeleton.support import probability
from anther.perception.stem import Stem
from anther.perception.stem.confidence import plant_evidence, rise_share


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
    line = interpolate(dense, s, nodes)
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


def hidden_share(c: Candidates, surface: Array) -> Array:
    """Return (C,) the share of the stem about each place of which none of the surface points (N, 3) [m] shows anything.

    What holds on to a stem there is not seen either.
    """
    _, first, back = np.unique(c.station, return_index=True, return_inverse=True)
    along = np.linspace(-0.012, 0.012, 7)[:, None]  # m, what the pads hold and a petiole beside
    line = c.points[first, None] + along * c.tangents[first, None]
    reach = c.radius[first, None] + 0.005  # m from the surface that the skeleton has, and how far the axis may be off
    ends, most = line.reshape(-1, 3), reach.max()
    about = np.all((surface > ends.min(axis=0) - most) & (surface < ends.max(axis=0) + most), axis=1)
    found = KDTree(surface[about]).query(line, distance_upper_bound=most)[0] < reach
    return 1 - found.mean(axis=1)[back]


def place_confidence(stem: Stem, skeleton: Skeleton, arcs: Array) -> Array | None:
    """Return (K,) the probability that what stands at these arc lengths [m] is the main stem.

    That is: the true main stem (pepper: below its first fork) passes within 5 mm of the place on the centreline. It
    does if the plant's stem was found, and if the centreline still follows it there. None when the skeleton's own
    confidence is unknown.
    """
    if skeleton.confidence is None:
        return None
    # constant and weights of the evidence in the log-odds: `python -m evaluation.perception.fit_confidence`
    fitted = (-6.67, 8.66, 1.13, 1.26, 3.08)
    sure = probability(fitted, place_evidence(stem, skeleton, arcs))
    # constant and weights of the evidence in the log-odds: `python -m evaluation.perception.fit_course`
    of_course = (8.32, 16.61, 4.22)
    sure = sure * probability(of_course, course_evidence(stem, skeleton, arcs))
    little = 0.1  # of the plant's height: a leaf's tip, or too short to be held for sure
    most = 0.4  # so many such grasps on the development plants were right
    return np.minimum(sure, most) if rise_share(skeleton, stem.node_ids) < little else sure


def place_evidence(stem: Stem, skeleton: Skeleton, arcs: Array) -> Array:
    """Return (K, 4), larger is better: below a fork or not, and what the plant says of its stem (`plant_evidence`).

    The nodes' confidence and the best rival path add nothing to that (measured).
    """
    below = arcs <= stem.arc_length[stem.fork] + 1e-9
    return np.column_stack([below, np.tile(plant_evidence(skeleton, stem.node_ids), (len(arcs), 1))])


def course_evidence(stem: Stem, skeleton: Skeleton, arcs: Array) -> Array:
    """Return (K, 2), larger is better: whether the centreline still follows the stem at these arc lengths [m].

    A limb that was taken for the stem above a fork that was missed, or a leaf, turns from the way up and is thinner.
    Columns: 0 less the angle between the centreline there and the way there from the root [rad]; the logarithm of the
    radius there over that of the stem's lower quarter, at most 0: a stem that seems thicker is one beside a leaf.
    """
    nodes, radius = skeleton.nodes[stem.node_ids], skeleton.radius[stem.node_ids]
    place, around = np.arange(len(nodes)), 3  # nodes to either side, 2 cm of a plant of 0.7 m: the skeleton's noise
    low, high = np.maximum(place - around, 0), np.minimum(place + around, len(nodes) - 1)
    along, way = nodes[high] - nodes[low], nodes - nodes[0]
    length = np.linalg.norm(along, axis=1) * np.linalg.norm(way, axis=1)
    turn = np.arccos(np.clip(np.sum(along * way, axis=1)[1:] / length[1:], -1, 1))
    foot = np.median(radius[: max(len(nodes) // 4, around)])
    here = np.array([np.median(radius[a : b + 1]) for a, b in zip(low, high, strict=True)])
    columns = -np.concatenate([turn[:1], turn]), np.minimum(np.log(here / foot), 0)
    return np.stack([np.interp(arcs, stem.arc_length, column) for column in columns], axis=1)
