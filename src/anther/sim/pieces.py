"""A simulated plant cut into rigid tapered pieces: how stiff the hinges between them are, what each weighs.

An unbranched run of segments becomes a chain of pieces. K segments, B bodies.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core.geometry import Array
from anther.sim.plant import Organ, SimPlant

CONTINUES = {(Organ.STEM, Organ.BRANCH), (Organ.PETIOLE, Organ.RACHIS), (Organ.PETIOLE, Organ.LEAF)}
"""Organs that run on into another without a clamp between them."""


TWISTING = (Organ.STEM, Organ.BRANCH, Organ.PEDUNCLE, Organ.PETIOLE)
"""Organs that twist. Dicot petioles do (facts: pollination 2), and stems, branches and peduncles are taken to be like
them, for which there is no source. Rachises and midribs, which blades stiffen, do not: with EI/GJ 12 some leaves would
not hold themselves up (measured). Nor do pedicels: their flowers' measured frequency is that of bending alone (facts:
pollination 1a)."""


@dataclass(frozen=True, slots=True)
class Params:
    """How finely the plant is cut and how it is damped.

    Attributes:
        piece: longest rigid piece of several segments [m]; a cantilever of 20 has its first frequency within 0.5 %.
        stiffest: hinges carry so much rotor inertia that none swings faster than this [Hz]; a mode at f is slowed by
            f^2 / (2 stiffest^2), 0.5 % at 30 Hz.
        foliage: the same for petioles, rachises and midribs [Hz], 0.5 % at 10 Hz: their pieces are light, and with 300
            Hz a leaf that was jammed in the gripper became unstable.
        twisting: organs that twist.
        twist_every: of so many pieces of a run the middle one has a hinge for twist, as soft as all of theirs together.
        fine_above: what begins lower is cut into pieces of up to `coarse` [m].
        coarse: a twelfth of the waves that a shake of 3 Hz sends along a pulled stem [m] (facts: rows 0, 3 to 4 m/s).
    """

    piece: float = 0.03
    stiffest: float = 300.0
    foliage: float = 100.0
    twisting: tuple[Organ, ...] = TWISTING
    twist_every: int = 2
    fine_above: float = -np.inf
    coarse: float = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """The cut: which segments form each rigid body, in an order where parents come first.

    Attributes:
        body: (K,) body of each segment.
        first: (B,) the body's first segment, whose start carries the hinges.
        parent: (B,) parent body or -1.
        stiffness: (B,) bending stiffness of the body's hinges [N m/rad].
        twist: (B,) stiffness of its hinge along itself [N m/rad], 0 where there is none.
    """

    body: NDArray[Any]
    first: NDArray[Any]
    parent: NDArray[Any]
    stiffness: Array
    twist: Array


def by_kind(plant: SimPlant, pieces: Pieces, strain: Array) -> dict[str, Array]:
    """Return kind of `sim.truth.TOLERANCE` -> those of the pieces' strains (..., B) that count against its limit.

    Keys: "stem" with branches, "pedicel", and "base" for all the rest, which is bent most where it begins.
    """
    organ = plant.organ[pieces.first]
    trunk, stalk = np.isin(organ, (Organ.STEM, Organ.BRANCH)), organ == Organ.PEDICEL
    return {"stem": strain[..., trunk], "pedicel": strain[..., stalk], "base": strain[..., ~trunk & ~stalk]}


def of_flower_stalks(plant: SimPlant, pieces: Pieces, strain: Array) -> tuple[Array, Array]:
    """Return (..., F) the largest of the strains (..., B) of the pieces that are each flower's pedicel.

    Then that of the pieces that carry the pedicel, up to stem or branch: 0 where it hangs on one of those.
    """
    organ, found = plant.organ[pieces.first], np.zeros((2, *strain.shape[:-1], len(plant.flower_segment)))
    for f, segment in enumerate(plant.flower_segment):
        piece = int(pieces.body[segment])
        while piece >= 0 and organ[piece] not in (Organ.STEM, Organ.BRANCH):
            of = found[int(organ[piece] != Organ.PEDICEL), ..., f]
            of[...] = np.maximum(of, strain[..., piece])
            piece = int(pieces.parent[piece])
    return found[0], found[1]


def cut(plant: SimPlant, params: Params) -> Pieces:
    """Cut the plant into rigid pieces and find the stiffness between them."""
    heir, body = _heirs(plant), np.full(len(plant.start), -1)
    chain = _chains(plant, heir)
    limit = np.minimum(params.piece, np.bincount(chain, plant.length) / 4)[chain]  # four pieces a run, if it has them
    limit = np.where(plant.start[:, 2] < params.fine_above, params.coarse, limit)
    first: list[int] = []
    parent: list[int] = []
    size: list[float] = []
    for k, p in enumerate(plant.parent):
        follows = p >= 0 and heir[p] == k and plant.organ[k] == plant.organ[p]
        fits = follows and size[body[p]] + plant.length[k] <= limit[k] and plant.joint_compliance[k] == 0
        if fits and _turn(plant, first[body[p]], k) < 0.5:  # rad; a piece is nearly straight
            body[k] = body[p]
            size[body[p]] += plant.length[k]
        else:
            body[k] = len(first)
            first.append(k)
            parent.append(int(body[p]) if p >= 0 else -1)
            size.append(plant.length[k])
    pieces = np.array(first)
    softness = _softness(plant)
    twisting = np.isin(plant.organ[pieces], params.twisting)
    whole: Array = np.bincount(body, softness.sum(axis=0)).astype(np.float64)
    twist = _twist(plant.bend_over_twist * whole, np.where(twisting, chain[pieces], -1), params)
    bending = 1 / _stiffness(plant, heir, body, pieces, softness) + plant.joint_compliance[pieces]
    bending[0] += 1 / plant.foot
    return Pieces(body, pieces, np.array(parent), 1 / bending, twist)


def _gauss_points() -> tuple[Array, Array]:
    """Return (6, 1) where along a segment integrals are evaluated, and with what weight: shares of its length."""
    at, weight = np.polynomial.legendre.leggauss(6)
    return at[:, None] / 2 + 0.5, weight[:, None] / 2


def _softness(plant: SimPlant) -> Array:
    """Return (6, K) the shares of each segment's integral of ds / (E I) at Gauss's points [rad/(N m)]."""
    at, weight = _gauss_points()
    radius = plant.radius_start + at * (plant.radius_end - plant.radius_start)
    return weight * plant.length / (plant.youngs * np.pi / 4 * radius**4)


def _twist(softness: Array, run: NDArray[Any], params: Params) -> Array:
    """Return (B,) stiffnesses of the hinges for twist: one for every few pieces of a run; those in run -1 do not."""
    out = np.zeros(len(softness))
    for number in np.unique(run[run >= 0]):
        pieces = np.flatnonzero(run == number)
        for group in np.array_split(pieces, -(-len(pieces) // params.twist_every)):
            out[group[len(group) // 2]] = 1 / softness[group].sum()
    return out


def _stiffness(plant: SimPlant, heir: NDArray[Any], body: NDArray[Any], first: NDArray[Any], softness: Array) -> Array:
    """Return (B,) stiffnesses of the hinges that bend.

    A hinge does the work of the pieces beside it when their load is what they carry: the bending moment falls in
    proportion to the distance from the carried mass's centre, and is shared between the hinges by the lever rule. Where
    no piece follows, at tips and forks, the last hinge takes all. So a massless rod with a weight at its end is exact
    with one piece (3 E I / l), and a long chain with many (2 E I / l at the root, facts: libraries).
    """
    before = plant.parent[first]
    continues = np.flatnonzero((before >= 0) & (heir[before] == first))
    mother = body[before[continues]]
    after = np.full(len(first), -1)
    after[mother] = continues
    size = np.bincount(body, plant.length)
    lever = np.maximum(_levers(plant, first), size)
    gone = np.cumsum(plant.length) - plant.length  # segments of a piece follow each other
    at, whole = gone - gone[first][body] + _gauss_points()[0] * plant.length, size[body]
    last = (after < 0)[body]
    near = np.where(last, 1, 1 - at / whole) * (1 - at / lever[body]) ** 2
    far = np.where(last, 0, at / whole) * (1 + (whole - at) / lever[after][body]) ** 2
    total = np.bincount(body, (softness * near).sum(axis=0))
    total[continues] += np.bincount(body, (softness * far).sum(axis=0))[mother]
    return 1 / total


def _levers(plant: SimPlant, first: NDArray[Any]) -> Array:
    """Return (B,) how far ahead of each piece's start the centre lies of all mass from there on [m]."""
    mass = plant.carried(plant.mass + plant.lump_mass)
    moment = plant.carried((plant.mass * (plant.start + plant.end).T / 2 + plant.lump_mass * plant.lump_centre.T).T)
    along = (plant.end - plant.start)[first] / plant.length[first, None]
    return np.einsum("bi,bi->b", moment[first] / mass[first, None] - plant.start[first], along)


def _chains(plant: SimPlant, heir: NDArray[Any]) -> NDArray[Any]:
    """Return (K,) the number of the unbranched run each segment belongs to."""
    chain, count = np.empty(len(heir), dtype=int), 0
    for k, p in enumerate(plant.parent):
        follows = p >= 0 and heir[p] == k
        chain[k] = chain[p] if follows else count
        count += not follows
    return chain


def _heirs(plant: SimPlant) -> NDArray[Any]:
    """Return for each segment the child that continues it: of the same organ or its natural next, the straightest.

    -1 at tips and at forks.
    """
    heir, best = np.full(len(plant.start), -1), np.full(len(plant.start), -np.inf)
    branches = np.bincount(plant.parent[plant.organ <= Organ.BRANCH] + 1, minlength=len(heir) + 1)[1:]
    for k, p in enumerate(plant.parent):
        same = p >= 0 and plant.organ[k] == plant.organ[p]
        if p < 0 or branches[p] > 1 or not (same or (plant.organ[p], plant.organ[k]) in CONTINUES):
            continue
        straight = -_turn(plant, int(p), k)
        if straight > best[p]:
            heir[p], best[p] = k, straight
    return heir


def _turn(plant: SimPlant, a: int, b: int) -> float:
    u, v = plant.end[a] - plant.start[a], plant.end[b] - plant.start[b]
    return float(np.arccos(np.clip(u @ v / np.linalg.norm(u) / np.linalg.norm(v), -1, 1)))


def mass_properties(plant: SimPlant, piece: NDArray[Any]) -> tuple[Array, Array, Array]:
    """Return mass (B,), centre (B, 3) and MuJoCo's full inertia (B, 6) of the bodies: tapered rods and what they carry.

    Args:
        plant: the truth.
        piece: (K,) the body of each segment.
    """
    rod, length = plant.mass, plant.length
    r2 = rod / (plant.density * np.pi * length)
    u = (plant.end - plant.start) / length[:, None]
    across = np.eye(3) - u[:, :, None] * u[:, None, :]
    centre, spread = _along(plant.radius_start, plant.radius_end)
    own = rod[:, None, None] * ((length**2 * spread + r2 / 4)[:, None, None] * across)
    own += (rod * r2 / 2)[:, None, None] * (np.eye(3) - across)
    masses = np.concatenate([rod, plant.lump_mass])
    centres = np.concatenate([plant.start + (centre * length)[:, None] * u, plant.lump_centre])
    body = np.tile(piece, 2)
    mass: Array = np.bincount(body, masses).astype(np.float64)
    com = np.stack([np.bincount(body, masses * c) for c in centres.T], axis=1) / mass[:, None]
    d = centres - com[body]
    steiner = masses[:, None, None] * ((d**2).sum(1)[:, None, None] * np.eye(3) - d[:, :, None] * d[:, None, :])
    steiner[: len(rod)] += own
    steiner[len(rod) :] += _spread(plant)
    inertia = np.zeros((len(mass), 3, 3))
    np.add.at(inertia, body, steiner)
    i, j = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
    return mass, com, inertia[:, i, j]


def _along(a: Array, b: Array) -> tuple[Array, Array]:
    """Return (K,) where the mass centre of frusta lies, and the variance of their mass along them; of length 1.

    Their area grows from a^2 to b^2 as the square of a radius that is linear.
    """
    whole = a**2 + a * b + b**2
    centre = (a**2 + 2 * a * b + 3 * b**2) / (4 * whole)
    return centre, (a**2 + 3 * a * b + 6 * b**2) / (10 * whole) - centre**2


def _spread(plant: SimPlant) -> Array:
    """Return (K, 3, 3) the inertia of what each segment carries about its own centre: it spreads as its mesh does.

    Without it a leaf had hardly any about its midrib, and spun when its margin was touched.
    """
    seen = np.unique(plant.faces[np.isin(plant.face_organ, (Organ.LEAF, Organ.FLOWER))])
    k, count = plant.vertex_segment[seen], len(plant.start)
    share = 1 / np.maximum(np.bincount(k, minlength=count), 1)
    mean = np.stack([np.bincount(k, x, count) for x in plant.vertices[seen].T], axis=1) * share[:, None]
    d, second = plant.vertices[seen] - mean[k], np.zeros((count, 3, 3))
    np.add.at(second, k, d[:, :, None] * d[:, None, :])
    second *= (plant.lump_mass * share)[:, None, None]
    return np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second
