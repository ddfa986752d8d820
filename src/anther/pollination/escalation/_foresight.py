"""What a shake at one grip should do by the model, and what is left of that once the camera has seen a small one.

M members, K tones, S vectors.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.core.geometry import Array
from anther.plant.model import PlantModel
from anther.pollination.decision import Answer
from anther.pollination.shake.observables import ComplexArray, semi_major
from anther.pollination.shake.pads import PADS, Pads, friction_force, grip_rows, pad_nodes
from anther.pollination.shake.search import held_radius, motions, scenarios

MEMBERS = 32
"""Plants that are drawn; more change the narrowed loads by less than the camera's errors do."""
BRANCH_SPREAD = 0.5
"""Of ln of a branch's stiffness, as in `identification.Params`."""
MISFIT = 0.2
"""Of a point's modelled or seen motion, relative: no model's node is the piece of plant that a camera sees, and a
stem's motion along itself cannot be seen. Measured on three simulated plants."""
STILL = 0.1
"""Share of the believed motion with which a plant as good as stands still. Where its stem and leaves move by a third,
neither this nor the whole is likelier; of 5 simulated plants the tracker showed 0.2 to 1.1."""
SIGNIFICANCE = 3.0
"""A flower's motion counts as measured from so many standard deviations on; below, it only narrows what is believed."""
FLOWER_SPREAD = 0.65
"""Standard deviation of ln(true over modelled amplitude) of a flower about its plant's mean, measured by us on 16
simulated plants at 5 and 10 Hz (docs/reports/response.md)."""
STAND_OUT = 2.0
"""Of flowers that swing less than stem and leaves do, for what the members say of both, in standard deviations: from
here on what is followed in their place stands still. The least in 47 looks at 5 simulated plants was -1.4."""
MOST_POINTS = 60
"""Of the plant that are watched beside the flowers."""


class Foresight(NamedTuple):
    """What one metre of gripper motion along each axis of the world does, as phasors.

    Attributes:
        tones: (K,) [Hz].
        vectors: (M, K, 3, S, 3), by axis of the gripper's motion; the first member is the plant as believed.
        where: kind -> rows of S, see `search.motions`: flowers first, then points, then loads.
        radius: of the stem between the pads [m].
        pad_width: along the stem [m].
    """

    tones: Array
    vectors: ComplexArray
    where: Mapping[str, slice]
    radius: float
    pad_width: float

    def of(self, tone: int, motion: Array | ComplexArray) -> ComplexArray:
        """Return (M, S, 3) what the gripper's motion does at a tone: (3,) world, phasors of it, or (M, 3) of each."""
        motions = np.broadcast_to(motion, (len(self.vectors), 3))
        return np.asarray(np.einsum("masx,ma->msx", self.vectors[:, tone], motions))

    def load(self, kind: str, vectors: ComplexArray) -> Array:
        """Return (M,) the largest load of a kind, of vectors (M, S, 3) of one shake."""
        sizes = semi_major(vectors[:, self.where[kind]])
        if kind == "grip_force":
            return friction_force(*sizes.T, radius=self.radius, width=self.pad_width)
        return sizes.max(axis=1, initial=0.0)

    def answer(self, vectors: ComplexArray, hertz: float, peak: Array | float = 1.0) -> Answer:
        """Return what a decision asks for of vectors (M, S, 3) of one shake.

        `peak`: (F,) of each flower's acceleration over what it would be without overtones.
        """
        flowers = peak * semi_major(vectors[:, self.where["flowers"]])
        loads = (self.load(kind, vectors) for kind in ("base_strain", "stem_strain", "leaf_load", "grip_force"))
        return Answer((2 * np.pi * hertz) ** 2 * flowers, *loads)


def foresee(
    plant: PlantModel,
    point: Array,
    tones: Array,
    seen: NDArray[np.int64],
    *,
    pads: Pads = PADS,
) -> Foresight:
    """Return what shakes of one grip should do, for plants and pads drawn from what is believed.

    Args:
        plant: as believed.
        point: (3,) where it is held [m].
        tones: (K,) [Hz].
        seen: (P,) rod nodes that a camera may see.
        pads: as believed.
    """
    grip = pad_nodes(plant, grip_rows(plant, point[None]), pads.width)
    members = scenarios(plant, MEMBERS, pads=pads, branch_spread=BRANCH_SPREAD)
    found = [motions(member, grip, tones, like=plant, points=seen)[0] for member in members]
    ends = np.cumsum([0, *(part.shape[2] for part in found[0].values())])
    where = {kind: slice(int(a), int(b)) for kind, a, b in zip(found[0], ends[:-1], ends[1:], strict=True)}
    vectors = np.array(
        [np.moveaxis(np.concatenate([part[:, 0] for part in one.values()], axis=1), -1, 1) for one in found]
    )
    return Foresight(tones, vectors, where, float(held_radius(plant, grip)[0]), pads.width)


def watch_points(plant: PlantModel) -> NDArray[np.int64]:
    """Return up to `MOST_POINTS` nodes of stem, branches and leaves that lie far from each other: farthest first."""
    stalks = plant.is_pedicel | np.isin(np.arange(len(plant.is_pedicel)), plant.flower_nodes)
    nodes = np.flatnonzero(~stalks)
    places = plant.rods.nodes[nodes]
    chosen, gap = [0], np.linalg.norm(places - places[0], axis=1)
    while len(chosen) < min(MOST_POINTS, len(nodes)):
        chosen.append(int(gap.argmax()))
        gap = np.minimum(gap, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return nodes[chosen]


def narrowed(members: ComplexArray, motion: ComplexArray, std: Array, axes: Array, number: int = 0) -> ComplexArray:
    """Return (M, S, 3) what a shake does, once points were seen to move in the camera's picture.

    The members' answers are regressed on what a camera sees of them (ensemble Kalman update, Evensen 2003): loads and
    hidden flowers follow as the members have them follow, so that at a tone and grip that were measured no resonance
    has to be known. What is seen is drawn anew for each member with its errors, so that they stay as different as what
    is not known has them. With fewer members than numbers seen they end too much alike: what is left of a load's error
    beside them is measured (`decision.OBSERVED_ERRORS`).

    Args:
        members: (M, S, 3) what they say of that shake, `Foresight.of`, per metre commanded.
        motion: (P, 3) of the first P of S per metre commanded, along `axes`; any where it was not seen.
        std: (P, 3) standard deviation of either part; NaN where it was not seen.
        axes: (P, 3, 3) see `response.points.Sight`.
        number: of the observation: the errors that are drawn of two have nothing in common.
    """
    miss, spread, gram, _ = _seen(members, motion, std, axes)
    off = (members - members.mean(axis=0)).reshape(len(members), -1) / np.sqrt(len(members) - 1)
    drawn = np.random.default_rng(number).normal(size=(2, *miss.shape)) / np.sqrt(2)
    drawn -= drawn.mean(axis=1, keepdims=True)
    misses = miss + drawn[0] + 1j * drawn[1]
    weights = np.linalg.solve(gram, spread.conj() @ misses.T).T
    return members + (weights @ off).reshape(members.shape)


def misfit(members: ComplexArray, motion: ComplexArray, std: Array, axes: Array) -> float:
    """Return -ln likelihood of what was seen of one shake, up to a constant; arguments as of `narrowed`."""
    misses, spread, gram, noise = _seen(members, motion, std, axes)
    miss = misses.mean(axis=0)
    explained = np.linalg.solve(gram, spread.conj() @ miss) @ spread
    fit = float(np.vdot(miss, miss - explained).real)
    return fit + float(np.linalg.slogdet(gram)[1]) + 2 * float(np.sum(np.log(noise)))


def evidence(members: ComplexArray, motion: ComplexArray, std: Array, axes: Array) -> float:
    """Return ln of how many times likelier what was seen is if the plant moves as the members say than `STILL` as far.

    It is low where nothing that was followed moves, where it moves at another phase than the pads do, and where too
    little was seen to tell. Arguments as of `narrowed`.
    """
    return misfit(STILL * members, motion, std, axes) - misfit(members, motion, std, axes)


def stand(members: ComplexArray, motion: ComplexArray, std: Array, axes: Array, count: int) -> bool:
    """Return whether what is taken for flowers, the first `count` of F + P points, stands still while the others move.

    By how much a point swings more than members (M, S, 3) say, ln, with what may be of it without being measured.
    """
    used = np.isfinite(std)
    flowers, points = used[:count, 0], used[count:, 0]
    if not flowers.any() or not points.any():
        return False
    said = np.where(used, np.abs(np.einsum("mpx,pxa->mpa", members[:, : len(motion)], axes)), 0.0)
    said = np.log(np.maximum(np.linalg.norm(said, axis=2), 1e-12))
    may = np.where(used, np.hypot(np.abs(motion), SIGNIFICANCE * std), 0.0)
    more = np.log(np.maximum(np.linalg.norm(may, axis=1), 1e-12)) - said.mean(axis=0)
    alike = float(said[:, :count][:, flowers].mean(axis=1).std())
    spread = np.hypot(FLOWER_SPREAD, alike)  # flowers of one plant may all be off alike
    return bool(np.median(more[:count][flowers]) - np.median(more[count:][points]) < -STAND_OUT * spread)


def repeated(
    now: tuple[ComplexArray, Array], before: tuple[ComplexArray, Array], raised: float, changing: float
) -> bool:
    """Return whether a look after a raise shows the motion of a look before it.

    A plant is about linear: all its points swing further by the raise. One gain is fitted to them all; where it is
    nearer to 1 than to the raise, in logarithm, they are shown as they were. Not where its error leaves that open.

    Args:
        now: (P, 3) motion [m], in the phase of its shake, and its standard deviation; NaN where it was not seen.
        before: the same of the earlier look.
        raised: amplitude of the gripper over the earlier one.
        changing: share by which the swings of both looks still grow or die out, which they may show instead.
    """
    (moved, std), (last, last_std) = now, before
    used = np.isfinite(std) & np.isfinite(last_std)
    sizes = [np.linalg.norm(np.where(used, one, 0.0), axis=1, keepdims=True) for one in (moved, raised * last)]
    noise = std**2 + (raised * last_std) ** 2 + MISFIT**2 * (sizes[0] ** 2 + sizes[1] ** 2)
    weight, moved, last, last_std = 1 / noise[used], moved[used], last[used], last_std[used]
    added = 2 * float(np.sum(weight * last_std**2))  # by the noise of the earlier look
    known = float(np.sum(weight * np.abs(last) ** 2)) - added
    if raised <= 1 or known <= 0:
        return False
    gain = abs(np.vdot(last, weight * moved)) / known
    error = np.linalg.norm([changing, added / known, 1 / (raised * np.sqrt(known))])
    return bool(np.log(raised) > SIGNIFICANCE * error and gain < np.sqrt(raised))


def _seen(
    members: ComplexArray, motion: ComplexArray, std: Array, axes: Array
) -> tuple[ComplexArray, ComplexArray, ComplexArray, Array]:
    """Return what was seen less what each member says (M, V), in standard deviations of those V complex numbers; the
    members' spread about their mean over the root of M - 1 (M, V); its gram (M, M), and 1; and the deviations (V,)."""
    said, used = np.einsum("mpx,pxa->mpa", members[:, : len(motion)], axes), np.isfinite(std)
    sizes = [np.linalg.norm(np.where(used, one, 0.0), axis=1) for one in (motion, said.mean(axis=0))]
    noise = np.hypot(np.sqrt(2) * std, MISFIT * np.max(sizes, axis=0)[:, None])[used]
    miss, off = (motion - said)[:, used] / noise, (said - said.mean(axis=0))[:, used] / noise
    spread = off / np.sqrt(len(members) - 1)
    return miss, spread, np.eye(len(members)) + spread.conj() @ spread.T, noise
