"""Joint registration of all views with a kinematic prior.

View by view to those before, ICP drifts on plants (facts: perception, 2.4-5.4 mm against 3.6 mm for the arm's own
poses). Here every view may move a little: all views' corrections are found together on robust distances between
neighbouring points of different views, held back by what is known of the arm and the hand-eye calibration. Views that
the others contradict are relocated or left out (`_wrong_views.py`).
Dimensions: V views, N points, P pairs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anther.core.compiling import compiled, read_only
from anther.core.geometry import Array, inverse, small_transform
from anther.core.records import Range, Record
from anther.perception.capture import in_threads
from anther.perception.cloud._wrong_views import (
    Estimate,
    Sample,
    agreement,
    correct_views,
    follow_way,
    match,
    plane_distances,
)

MATCHED = (0.012, 0.009, 0.007, 0.006, 0.005)
"""Greatest distance of a match in each round [m], from three times the arm's error down; a third scales the weights."""


@dataclass(frozen=True, slots=True)
class Params(Record):
    """How far the views may move.

    Attributes:
        rotation_sigma, translation_sigma: standard deviation of one view's pose error, per axis [rad], [m]
            (facts: perception, 0.2 deg and 1.5 mm).
        walk: of a camera whose place on its way is told by odometry, standard deviation per axis after a metre [m]; it
            grows with the root of the way, backwards from the last view. 0: an arm carries it.
    """

    CALLED = "registration"
    rotation_sigma: Annotated[float, Range(1e-6, 1, "rad")] = float(np.deg2rad(0.2))
    translation_sigma: Annotated[float, Range(1e-6, 1, "m")] = 0.0015
    walk: Annotated[float, Range(0, 0.1, "m")] = 0.0

    def walked(self, T_world_cam: Array) -> Array:
        """Return (V, V) the covariance of the odometry's errors at poses (V, 4, 4) in the order of the way [m2]."""
        steps = np.linalg.norm(np.diff(T_world_cam[:, :3, 3], axis=0), axis=1)
        left = np.append(np.cumsum(steps[::-1])[::-1], 0.0)
        return self.walk**2 * np.minimum.outer(left, left)


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """The registered poses and how they were judged.

    Attributes:
        T_world_cam: (V, 4, 4) camera poses; the given ones where registration declined.
        accepted: whether the poses changed.
        distance_before, distance_after: median distance of held-out points to other views' surfaces [m].
        reach: of the camera's matching window, see `_wrong_views.Estimate` [rad].
        agreement: (V,) share of a view's points that lie on a surface seen by others, of those near any; NaN where
            the view has too few points.
        used: (V,) whether a view's pose can be trusted; the others should be left out.
        notes: what the user should know.
    """

    T_world_cam: Array
    accepted: bool
    distance_before: float
    distance_after: float
    reach: float
    agreement: Array
    used: NDArray[np.bool_]
    notes: tuple[str, ...] = ()


def register(points_cam: list[Array], T_world_cam: Array, params: Params | None = None) -> Registration:
    """Return camera poses under which the views agree best, given how far the arm can be wrong.

    Args:
        points_cam: per view (N_v, 3) plant points in its camera frame [m].
        T_world_cam: (V, 4, 4) poses from the arm.
        params: see `Params`.
    """
    params = params or Params()
    given = np.array(T_world_cam)
    sample = Sample.of(points_cam, voxel=0.004, most=1500)  # thirty views then take seconds
    if len(np.unique(sample.view)) < 2:
        return _declined(given, "fewer than two views show the plant")
    draw = np.random.default_rng(0).random(len(sample.view))
    held_out, source = draw < 0.2, draw > 0.6  # what judges the result takes no part in it
    found = _aligned(sample, given, source, params)
    if found is None:
        return _declined(given, "the views share no surface")
    found, agrees, used, notes = _without_contradictions(sample, given, found, source, params)
    judges = held_out & used[sample.view]
    before, after = (_disagreement(sample, Estimate(T, found.reach), judges) for T in (given, found.poses))
    accepted, poses = after < 0.98 * before, found.poses  # else the arm's own poses are as good
    if not accepted:
        poses, agrees = given, agreement(sample, Estimate(given, found.reach), range(len(given)))
        note = (
            f"registration declined: held-out points disagree by {1e3 * after:.2f} mm after it, {1e3 * before:.2f} mm "
            "before; the arm's own poses are used"
        )
        notes = (note, *notes)
    return Registration(poses, accepted, before, after, found.reach, agrees, used, notes)


def _without_contradictions(
    sample: Sample, given: Array, found: Estimate, source: NDArray[np.bool_], params: Params
) -> tuple[Estimate, Array, NDArray[np.bool_], tuple[str, ...]]:
    """Return the estimate with contradicted views relocated, (V,) how far views agree, (V,) which are usable, notes.

    Where a view turns out far from its given pose, that pose is no prior: the prior is then its new one.
    """
    poses, wrong, used, agrees = correct_views(sample, given, found)
    placed = Estimate(poses, found.reach)
    moved = _moved(sample, given, placed)
    expected = _expected(sample, given, params)
    far = used & (moved > 1.75 * np.maximum(expected, float(np.median(moved))))  # else chance
    anew = wrong | far
    if anew.any():
        start, kept = np.where(anew[:, None, None], poses, given), used[sample.view]
        found = (
            _jointly(sample.only(kept), placed, start, source[kept], MATCHED[-2:], params, reach_fixed=True) or placed
        )
        found.poses[~used] = given[~used]
    if wrong.any():
        agrees = agreement(sample, found, range(len(given)))
    return found, agrees, used, _notes(agrees, used, _moved(sample, given, found), far)


def _moved(sample: Sample, given: Array, found: Estimate) -> Array:
    """Return how far (V,) [m] the middle of each view's points moved."""
    count = np.maximum(np.bincount(sample.view, minlength=len(given)), 1)
    sums = [np.bincount(sample.view, weights=column, minlength=len(given)) for column in sample.points.T]
    centres = np.append(np.stack(sums, axis=1) / count[:, None], np.ones((len(given), 1)), axis=1)
    return np.linalg.norm(np.einsum("vij,vj->vi", found.poses - given, centres), axis=1)


def _expected(sample: Sample, given: Array, params: Params) -> Array:
    """Return (V,) the RMS displacement [m] of the plant that the errors of the given poses (V, 4, 4) explain."""
    turned = params.rotation_sigma * float(np.median(sample.points[:, 2]))
    shifted = params.translation_sigma**2 + np.diag(params.walked(given))
    return np.asarray(np.sqrt(3 * shifted + 2 * turned**2))


def _notes(agrees: Array, used: NDArray[np.bool_], moved: Array, far: NDArray[np.bool_]) -> tuple[str, ...]:
    corrected = [
        f"view {v}: its pose was off by {1e3 * moved[v]:.0f} mm at the plant and has been corrected"
        for v in np.flatnonzero(far)
    ]
    dropped = [
        f"view {v} is left out: its pose is wrong, only {agrees[v]:.0%} of its points lie on what other views see"
        for v in np.flatnonzero(~used)
    ]
    return (*corrected, *dropped)


def _aligned(sample: Sample, given: Array, source: NDArray[np.bool_], params: Params) -> Estimate | None:
    """Return the estimate, or None where views share no surface."""
    start = follow_way(sample, given) if params.walk else given
    at = _jointly(sample, Estimate(start), given, source, MATCHED[:3], params, reach_fixed=False)
    if at is None:
        return None
    attenuation = 1 / 3  # noise in the normals draws the estimated reach to zero (errors in variables)
    at = Estimate(at.poses, max(0.0, at.reach) / attenuation)
    return _jointly(sample, at, given, source, MATCHED[3:], params, reach_fixed=True)


def _jointly(
    sample: Sample,
    at: Estimate,
    given: Array,
    source: NDArray[np.bool_],
    distances: tuple[float, ...],
    params: Params,
    *,
    reach_fixed: bool,
) -> Estimate | None:
    """Return the estimate after one round for each distance [m]: match, then two Gauss-Newton steps."""
    information = _prior_information(given, params)
    for distance in distances:
        pairs = match(sample, at, source, distance)
        if len(pairs) == 0:
            return None
        for _ in range(2):
            at = _step(sample, pairs, at, given, information, distance / 3, reach_fixed=reach_fixed)
    return at


def _declined(given: Array, why: str) -> Registration:
    views = len(given)
    used = np.ones(views, dtype=bool)
    return Registration(given, False, np.nan, np.nan, 0.0, np.full(views, np.nan), used, (f"registration: {why}",))


def _disagreement(sample: Sample, at: Estimate, held_out: NDArray[np.bool_]) -> float:
    """Return the median distance [m] of held-out points to the surfaces of other views."""
    pairs = match(sample, at, held_out, MATCHED[0])
    return float(np.median(plane_distances(sample, at, pairs))) if len(pairs) else np.inf


def _prior_information(given: Array, params: Params) -> Array:
    """Return the (6V + 1, 6V + 1) inverse covariance of poses (V, 4, 4) and of the reach of the camera's window.

    Each pose has an error of its own, one that all share, the hand-eye calibration's, and the odometry's up to it.
    """
    views = len(given)

    def variances(rotation: float, translation: float) -> Array:
        return np.diag(np.repeat(np.square([rotation, translation]), 3))

    own = variances(params.rotation_sigma, params.translation_sigma)
    shared = variances(float(np.deg2rad(0.2)), 0.001)  # per axis [rad], [m]; as careful calibrations leave
    covariance = np.kron(np.eye(views), own) + np.kron(np.ones((views, views)), shared)
    turned = given[:, :3, :3]  # the way is the world's, corrections each camera's
    covariance.reshape(views, 6, views, 6)[:, 3:, :, 3:] += np.einsum(
        "ab,aik,bil->akbl", params.walked(given), turned, turned
    )
    information = np.zeros((6 * views + 1, 6 * views + 1))
    information[:-1, :-1] = np.linalg.inv(covariance)
    information[-1, -1] = 0.003**-2  # 2 px of a D455 [rad]
    return information


def _step(
    sample: Sample,
    pairs: NDArray[np.int64],
    at: Estimate,
    given: Array,
    information: Array,
    scale: float,
    *,
    reach_fixed: bool,
) -> Estimate:
    """Return the estimate after one Gauss-Newton step; with `reach_fixed` only the poses change.

    The prior of `information` is about the `given` poses (V, 4, 4); `scale` is that of the Welsch weights [m].
    """
    world, normals = sample.world(at)
    points, along = sample.unbiased(at.reach), sample.points * sample.slant[:, None]
    surface, views = (points, along, sample.view, world, normals), len(given)
    sums, block, row = np.zeros((2, 6 * views + 2, 6 * views + 2)), np.zeros((2, 13, 14)), np.empty((2, 14))

    def accumulate(half: int) -> None:
        part = pairs[half * len(pairs) // 2 : (half + 1) * len(pairs) // 2]
        _accumulate(read_only(part), *surface, at.poses, scale, sums[half], block[half], row[half])

    in_threads(accumulate, range(2))
    system = sums.sum(axis=0)
    hessian, gradient = system[:-1, :-1], system[:-1, -1]
    error = inverse(given) @ at.poses
    turned = Rotation.from_matrix(error[:, :3, :3].copy()).as_rotvec()
    moved = np.append(np.concatenate([turned, error[:, :3, 3]], axis=1).ravel(), at.reach)
    free, weight = (
        slice(-1 if reach_fixed else None),
        1 / (8 * 0.0015**2),
    )  # a D455's noise [m]; eight neighbours count as one
    change = np.zeros(len(information))
    change[free] = np.linalg.solve(
        (weight * hessian + information)[free, free], -(weight * gradient + information @ moved)[free]
    )
    turn, shift = np.split(change[:-1].reshape(-1, 6), 2, axis=1)
    return Estimate(at.poses @ small_transform(turn, shift), at.reach + change[-1])


@compiled
def _accumulate(pairs, points, along, view, world, normals, poses, scale, sums, block, row):
    """Add the Hessian of the pairs' squared distances to `sums` (6V + 2, 6V + 2), in the last column their gradient.

    They are weighted by exp(-(r / scale)^2), Welsch (Holland 1977). The pairs of two views follow each other: what they
    add is gathered in `block` (13, 14), zeros; `row` (14,) holds a pair's derivatives and its distance.
    """
    for p in range(pairs.shape[0]):
        a, b = pairs[p, 0], pairs[p, 1]
        n0, n1, n2 = normals[a, 0] + normals[b, 0], normals[a, 1] + normals[b, 1], normals[a, 2] + normals[b, 2]
        length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        n0, n1, n2 = n0 / length, n1 / length, n2 / length
        r = n0 * (world[a, 0] - world[b, 0]) + n1 * (world[a, 1] - world[b, 1]) + n2 * (world[a, 2] - world[b, 2])
        w = np.exp(-(r * r) / (scale * scale))
        row[12], row[13] = 0.0, r
        for side in range(2):
            i = pairs[p, side]
            sign, T = 1.0 - 2.0 * side, poses[view[i]]
            m0 = sign * (T[0, 0] * n0 + T[1, 0] * n1 + T[2, 0] * n2)
            m1 = sign * (T[0, 1] * n0 + T[1, 1] * n1 + T[2, 1] * n2)
            m2 = sign * (T[0, 2] * n0 + T[1, 2] * n1 + T[2, 2] * n2)
            base = 6 * side
            row[base] = points[i, 1] * m2 - points[i, 2] * m1
            row[base + 1] = points[i, 2] * m0 - points[i, 0] * m2
            row[base + 2] = points[i, 0] * m1 - points[i, 1] * m0
            row[base + 3], row[base + 4], row[base + 5] = m0, m1, m2
            row[12] += along[i, 0] * m0 + along[i, 1] * m1 + along[i, 2] * m2
        for k in range(13):
            weighted = w * row[k]
            for q in range(14):
                block[k, q] += weighted * row[q]
        last = p + 1 == pairs.shape[0]
        if last or view[pairs[p + 1, 0]] != view[a] or view[pairs[p + 1, 1]] != view[b]:
            for k in range(13):
                to = 6 * (view[a] if k < 6 else view[b]) + k % 6 if k < 12 else 6 * len(poses)
                for q in range(14):
                    at = 6 * (view[a] if q < 6 else view[b]) + q % 6 if q < 12 else 6 * len(poses) + q - 12
                    sums[to, at] += block[k, q]
                    block[k, q] = 0.0
