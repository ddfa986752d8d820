"""Ensemble prediction of shakes at one grip, and its Kalman update from camera observations.

M members, K frequencies, S vectors.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.core.geometry import Array, ComplexArray, Intrinsics
from anther.plant.model import PlantModel
from anther.pollination.decision import Answer
from anther.pollination.response.points import NEAR, pictured
from anther.pollination.shake.observables import semi_major
from anther.pollination.shake.pads import PADS, Pads, friction_force, grip_rows, pad_nodes
from anther.pollination.shake.search import held_radius, motions, scenarios

MISFIT = 0.2
"""Relative model error of a tracked point: a model node is not exactly the tracked patch, and motion along a stem is
invisible; measured on simulated plants."""
SIGNIFICANCE = 3.0
"""Detection limit of a motion, in standard deviations; a weaker one only updates the ensemble."""
FLOWER_SPREAD = 0.65
"""Standard deviation of ln(true over modelled amplitude) of a flower about its plant's mean, measured by us on 16
simulated plants at 5 and 10 Hz (docs/reports/response.md)."""


class Foresight(NamedTuple):
    """Response of an ensemble to one metre of gripper motion along each world axis, as phasors.

    Attributes:
        frequencies: (K,) [Hz].
        vectors: (M, K, 3, S, 3), by axis of the gripper's motion; the first member is the plant as believed.
        where: kind -> rows of S, see `search.motions`: flowers first, then points, then loads.
        radius: of the stem between the pads [m].
        pad_width: along the stem [m].
    """

    frequencies: Array
    vectors: ComplexArray
    where: Mapping[str, slice]
    radius: float
    pad_width: float

    def of(self, tone: int, motion: Array | ComplexArray) -> ComplexArray:
        """Return the response (M, S, 3) at a frequency index to gripper motion (3,), world, or (M, 3) by member."""
        motions = np.broadcast_to(motion, (len(self.vectors), 3))
        return np.asarray(np.einsum("masx,ma->msx", self.vectors[:, tone], motions))

    def load(self, kind: str, vectors: ComplexArray) -> Array:
        """Return (M,) the largest load of a kind in responses (M, S, 3) to one shake."""
        sizes = semi_major(vectors[:, self.where[kind]])
        if kind == "grip_force":
            return friction_force(*sizes.T, radius=self.radius, width=self.pad_width)
        return sizes.max(axis=1, initial=0.0)

    def answer(self, vectors: ComplexArray, hertz: float, peak: Array | float = 1.0) -> Answer:
        """Return the input of a decision from responses (M, S, 3) to one shake.

        `peak`: (F,) ratio of each flower's peak acceleration to that without overtones.
        """
        flowers = peak * semi_major(vectors[:, self.where["flowers"]])
        loads = (self.load(kind, vectors) for kind in ("base_strain", "stem_strain", "leaf_load", "grip_force"))
        return Answer((2 * np.pi * hertz) ** 2 * flowers, *loads)


def foresee(
    plant: PlantModel,
    point: Array,
    frequencies: Array,
    seen: NDArray[np.int64],
    *,
    pads: Pads = PADS,
) -> Foresight:
    """Return the responses to shakes at one grip, for plants and pads drawn from the prior.

    Args:
        plant: prior model.
        point: (3,) of the grip [m].
        frequencies: (K,) [Hz].
        seen: (P,) rod nodes that a camera may see.
        pads: prior of the pads.
    """
    grip = pad_nodes(plant, grip_rows(plant, point[None]), pads.width)
    count = 32  # a larger ensemble changes the updated loads by less than the camera's errors do
    branch_spread = 0.5  # standard deviation of ln of a branch's stiffness, as in `learning.Params`
    members = scenarios(plant, count, pads=pads, branch_spread=branch_spread)
    found = [motions(member, grip, frequencies, like=plant, points=seen)[0] for member in members]
    ends = np.cumsum([0, *(part.shape[2] for part in found[0].values())])
    where = {kind: slice(int(a), int(b)) for kind, a, b in zip(found[0], ends[:-1], ends[1:], strict=True)}
    vectors = np.array(
        [np.moveaxis(np.concatenate([part[:, 0] for part in one.values()], axis=1), -1, 1) for one in found]
    )
    return Foresight(frequencies, vectors, where, float(held_radius(plant, grip)[0]), pads.width)


def watch_points(
    plant: PlantModel, most: int = 60, *, camera: tuple[Intrinsics, Array] | None = None, surface: Array | None = None
) -> NDArray[np.int64]:
    """Return up to so many nodes that lie far from each other: a third of the main stem, then of branches and leaves.

    What leaves the stem at its foot is left out: it is held there, or hangs on another string.

    Args:
        plant: its model.
        most: how many.
        camera: intrinsics and T_world_cam (4, 4) of the one that watches: nodes that it sees; None: any nodes. Where it
            sees fewer than it takes to judge a shake, any as well.
        surface: (N, 3) of what may hide nodes from it, world [m].
    """
    stalks = plant.is_pedicel | np.isin(np.arange(len(plant.is_pedicel)), plant.flower_nodes)
    nodes = np.flatnonzero(~stalks & (_leaves_stem_at(plant) != plant.stem_nodes[0]))
    places, few = plant.rods.nodes[nodes], 12
    if camera is not None:
        seen = _in_sight(places, places[:0] if surface is None else surface, *camera)
        if seen.sum() >= few:
            nodes, places = nodes[seen], places[seen]
    chosen, gap = list[int](), np.full(len(nodes), np.inf)
    for some, share in ((np.isin(nodes, plant.stem_nodes), 1 / 3), (np.ones(len(nodes), dtype=bool), 1.0)):
        while len(chosen) < min(share * most, np.count_nonzero(some)):
            chosen.append(int(np.where(some, gap, -1.0).argmax()))
            gap = np.minimum(gap, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return nodes[chosen]


def _leaves_stem_at(plant: PlantModel) -> NDArray[np.int64]:
    """Return (N,) the node of the main stem at which what bears each node leaves it; of the stem itself the node."""
    found = np.full(len(plant.rods.nodes), -1)
    found[plant.stem_nodes] = plant.stem_nodes
    for node in np.flatnonzero(found < 0):
        found[node] = found[plant.rods.parent[node]]
    return found


def _in_sight(points: Array, surface: Array, intrinsics: Intrinsics, T_world_cam: Array) -> NDArray[np.bool_]:
    """Return which points (N, 3) are in a camera's picture, and behind none of a surface's points (M, 3) [m]."""
    cell = 4  # px: a cloud's points are nearer to each other
    shape = (intrinsics.height // cell + 1, intrinsics.width // cell + 1)

    def shown(places: Array) -> tuple[NDArray[np.intp], Array, NDArray[np.bool_]]:
        own, pixels, inside = pictured(places, intrinsics, T_world_cam)
        column, row = np.where(inside[:, None], pixels // cell, 0).astype(np.intp).T
        return row * shape[1] + column, own[:, 2], inside

    nearest = np.full(shape[0] * shape[1], np.inf)
    at, depth, inside = shown(surface)
    np.minimum.at(nearest, at[inside], depth[inside])
    at, depth, inside = shown(points)
    return inside & (depth < nearest[at] + NEAR)


def update_members(
    members: ComplexArray, motion: ComplexArray, std: Array, axes: Array, number: int = 0
) -> ComplexArray:
    """Return the members' responses (M, S, 3), updated by observed point motions.

    Stochastic ensemble Kalman update (Evensen 2003). Loads and occluded flowers follow through the members' own
    covariances, so no resonance has to be known at an observed frequency and grip. The observation is perturbed for
    each member. An ensemble smaller than the observation becomes too narrow; `decision.OBSERVED_ERRORS` holds the
    measured remaining error of the loads.

    Args:
        members: (M, S, 3) predicted responses, `Foresight.of`, per metre commanded.
        motion: (P, 3) observed motion of the first P of S per metre commanded, along `axes`; any where `std` is NaN.
        std: (P, 3) standard deviation of real and imaginary part; NaN where not observed.
        axes: (P, 3, 3) see `response.points.Sight`.
        number: of the observation, seeds its perturbations.
    """
    miss, spread, gram, _ = _innovations(members, motion, std, axes)
    off = (members - members.mean(axis=0)).reshape(len(members), -1) / np.sqrt(len(members) - 1)
    drawn = np.random.default_rng(number).normal(size=(2, *miss.shape)) / np.sqrt(2)
    drawn -= drawn.mean(axis=1, keepdims=True)
    misses = miss + drawn[0] + 1j * drawn[1]
    weights = np.linalg.solve(gram, spread.conj() @ misses.T).T
    return members + (weights @ off).reshape(members.shape)


def misfit(
    members: ComplexArray, motion: ComplexArray, std: Array, axes: Array, turns: ComplexArray | None = None
) -> Array:
    """Return (L,) -ln likelihood of the observation of one shake, up to a constant; arguments as of `update_members`.

    `turns`: (L,) of absolute value 1, that the observed motion is times; by default the one is 1.
    """
    misses, spread, gram, noise = _innovations(members, motion, std, axes)
    shown = motion[np.isfinite(std)] / noise
    turned = shown[None] if turns is None else turns[:, None] * shown
    miss = turned - (shown - misses.mean(axis=0))
    explained = np.linalg.solve(gram, spread.conj() @ miss.T).T @ spread
    fit = np.sum(miss.conj() * (miss - explained), axis=1).real
    return np.asarray(fit + np.linalg.slogdet(gram)[1] + 2 * np.sum(np.log(noise)))


def moves_or_stands(members: ComplexArray, motion: ComplexArray, std: Array, axes: Array) -> Array:
    """Return (2,) ln likelihoods, up to a constant: the plant moves as predicted, or a tenth as far.

    The first is the lower one if tracked points stand still, move at another phase than the pads, or are too few.
    Arguments as of `update_members`.
    """
    still = 0.1  # share of the predicted motion that a still plant is taken to show; a judgement
    return -np.concatenate([misfit(share * members, motion, std, axes) for share in (1.0, still)])


STILL = 2.0
"""Deviations of `stillness` from which all tracked flowers are taken for background; those of simulated plants had 1.4
at most."""


def stillness(members: ComplexArray, motion: ComplexArray, std: Array, axes: Array, count: int) -> tuple[Array, float]:
    """Return by how many deviations the first `count` of F + P points, the flowers, move less than the others do.

    Compares ln of observed motion, with its detection limit, over predicted motion of flowers and of other points.
    NaN where no flower is followed, or no other point is.

    Returns:
        (count,) of each flower, and of all together.
    """
    used = np.isfinite(std)
    flowers, points = used[:count, 0], used[count:, 0]
    if not flowers.any() or not points.any():
        return np.full(count, np.nan), float("nan")
    predicted = np.where(used, np.abs(np.einsum("mpx,pxa->mpa", members[:, : len(motion)], axes)), 0.0)
    predicted = np.log(np.maximum(np.linalg.norm(predicted, axis=2), 1e-12))
    upper = np.where(used, np.hypot(np.abs(motion), SIGNIFICANCE * std), 0.0)
    more = np.log(np.maximum(np.linalg.norm(upper, axis=1), 1e-12)) - predicted.mean(axis=0)
    less = np.where(flowers, np.median(more[count:][points]) - more[:count], np.nan)
    alike = float(predicted[:, :count][:, flowers].mean(axis=1).std())  # flowers of one plant may all be off alike
    return less / FLOWER_SPREAD, float(np.nanmedian(less) / np.hypot(FLOWER_SPREAD, alike))


def repeats_motion(
    now: tuple[ComplexArray, Array], before: tuple[ComplexArray, Array], raised: float, changing: float
) -> bool:
    """Return whether an observation after a raise repeats the motion of an earlier one, as a frozen camera would.

    A plant is nearly linear, so all points should scale with the gripper. One gain is fitted to all points; the motion
    is repeated if ln gain is nearer to 0 than to ln `raised`, unless its error leaves that open.

    Args:
        now: (P, 3) motion [m], in the phase of its shake, and its standard deviation; NaN where not observed.
        before: the same of the earlier observation.
        raised: gripper amplitude over the earlier one.
        changing: relative growth or decay of the swings still to come in both observations.
    """
    (moved, std), (last, last_std) = now, before
    used = np.isfinite(std) & np.isfinite(last_std)
    sizes = [np.linalg.norm(np.where(used, one, 0.0), axis=1, keepdims=True) for one in (moved, raised * last)]
    noise = std**2 + (raised * last_std) ** 2 + MISFIT**2 * (sizes[0] ** 2 + sizes[1] ** 2)
    weight, moved, last, last_std = 1 / noise[used], moved[used], last[used], last_std[used]
    added = 2 * float(np.sum(weight * last_std**2))  # by the noise of the earlier observation
    reference = float(np.sum(weight * np.abs(last) ** 2)) - added
    if raised <= 1 or reference <= 0:
        return False
    gain = abs(np.vdot(last, weight * moved)) / reference
    error = np.linalg.norm([changing, added / reference, 1 / (raised * np.sqrt(reference))])
    return bool(np.log(raised) > SIGNIFICANCE * error and gain < np.sqrt(raised))


def _innovations(
    members: ComplexArray, motion: ComplexArray, std: Array, axes: Array
) -> tuple[ComplexArray, ComplexArray, ComplexArray, Array]:
    """Return the innovations (M, V) in standard deviations of the V observed complex numbers, the members' deviations
    from their mean over sqrt(M - 1) (M, V), their gram matrix plus the identity (M, M), and the deviations (V,)."""
    predicted, used = np.einsum("mpx,pxa->mpa", members[:, : len(motion)], axes), np.isfinite(std)
    sizes = [np.linalg.norm(np.where(used, one, 0.0), axis=1) for one in (motion, predicted.mean(axis=0))]
    noise = np.hypot(np.sqrt(2) * std, MISFIT * np.max(sizes, axis=0)[:, None])[used]
    miss, off = (motion - predicted)[:, used] / noise, (predicted - predicted.mean(axis=0))[:, used] / noise
    spread = off / np.sqrt(len(members) - 1)
    return miss, spread, np.eye(len(members)) + spread.conj() @ spread.T, noise
