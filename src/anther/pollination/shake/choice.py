"""Which shake of all: the largest that every limit allows, for each frequency, grip and direction.

F flowers, G grips, D directions, Q frequencies, M scenarios.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.core.geometry import Array
from anther.plant.belief import EarlierShake
from anther.plant.limits import DOSE_MEASURES, GUSTS, LOADED, PEAKS, stalk_strain
from anther.plant.model import PlantModel
from anther.pollination.decision import Answer, WorthCurve, believed, expected, interval, weighed, worth
from anther.pollination.grasp import Grasp
from anther.pollination.shake._actuators import Actuator
from anther.pollination.shake._plan import CandidateShakes, LimitRow
from anther.pollination.shake.pads import grip_rows, pad_nodes
from anther.pollination.shake.params import Params
from anther.pollination.shake.search import Gains
from anther.robot.pressing import Pressing

Place = tuple[int, int, int]
"""(q, g, d): one shake of the search."""

DIRECTIONS = 8
"""Over half a turn of the horizontal plane: the best of eight is at most 11 degrees off."""
PRESS = "force of the pads, against slip [N]"
"""The limit of what holds the stem: pads press as hard as it bears and the gripper can."""
MOST_SPEED = 0.3
"""Of the grip [m/s]."""


class Grips(NamedTuple):
    """Where the stem may be held: the grasps' nodes first, then others for the map."""

    nodes: list[NDArray[Any]]  # G lists of rod nodes between the pads, the middle one first
    arc_length: Array  # (G,) [m]
    grasp: NDArray[Any]  # (G,) index of the grasp itself or, for the map, of the nearest one
    directions: Array  # (G, D, 3)
    press: Array  # (G, 1) the most that pads may press the stem with there [N]


class Bound(NamedTuple):
    """Something that grows with the amplitude, and how large it may be, or what bears it."""

    value: Array  # (Q, G, D) per metre of amplitude, as expected
    limit: Array  # of a shape that goes with it


class Search(NamedTuple):
    """The search space, and how far and how well each of its shakes (Q, G, D) goes."""

    grips: Grips
    flower: Array  # (M, Q, G, D, F), see `Gains`
    answer: Answer  # of (Q, G, D)
    frequencies: Array  # (Q,) [Hz]
    amplitude: Array  # (Q, G, D) that is worth most, or the largest where limits are not kept [m]
    score: Array  # (Q, G, D) what it is worth (`decision.Worth.net`); -1 where it is nothing, or for the map alone
    regret: dict[str, Array]  # (Q, G, D) how much more the best is worth if that measure of motion frees pollen
    bounds: dict[str, Bound]  # by name; in the first three, of the machine, the plant has no part
    delivered: tuple[Array, Array]  # (Q, G, D) each, see `Actuator.delivers`
    least: float  # a shake of less amplitude is none [m]


def find_grips(
    plant: PlantModel, grasps: Sequence[Grasp], params: Params, pressing: Pressing, *, closing: bool
) -> Grips:
    """Return the grasps' places on the stem, and others for the map, with the directions across the stem.

    `closing`: the only one is that of the gripper's closing axis, the flange's y.
    """
    held = grip_rows(plant, np.array([g.point for g in grasps]))
    usable = np.flatnonzero(~np.isin(plant.stem_nodes, plant.clamp.nodes))
    heights = 8  # beside the grasps
    others = usable[np.unique(np.linspace(0, len(usable) - 1, heights).round().astype(int))]
    rows = np.concatenate([held, others])
    nodes, arc = pad_nodes(plant, rows, params.pads.width), plant.arc_length[rows]
    nearest = np.abs(arc[len(held) :, None] - arc[: len(held)]).argmin(axis=1)
    near = np.concatenate([np.arange(len(held)), nearest])
    if closing:
        directions = np.array([grasp.T_world_flange[:3, 1] for grasp in grasps])[near, None]
    else:
        directions = _directions(plant, plant.stem_nodes[rows])
    diameter = 2 * np.asarray(plant.rods.edge_radius)[plant.stem_nodes[rows], None]
    return Grips(nodes, arc, near, directions, pressing.most(diameter))


def _directions(plant: PlantModel, nodes: NDArray[Any]) -> Array:
    """Return (G, D, 3) unit vectors across the stem, above `DIRECTIONS` of the horizontal half circle."""
    angle = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
    flat = np.stack([np.cos(angle), np.sin(angle), np.zeros(DIRECTIONS)], axis=1)
    tangent = plant.rods.nodes[nodes] - plant.rods.nodes[plant.rods.parent[nodes]]
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    across = flat - np.einsum("dk,gk->gd", flat, tangent)[..., None] * tangent[:, None]
    size = np.linalg.norm(across, axis=2, keepdims=True)
    return np.where(size > 0.3, across / np.maximum(size, 1e-9), flat)  # along a lying stem: leave it horizontal


def search(
    response: Gains, grips: Grips, grasps: Sequence[Grasp], frequencies: Array, actuator: Actuator, params: Params
) -> Search:
    """Return every shake at the amplitude that is worth most (`decision`); see `Params.keeps_limits`.

    The table of limits says what organs are expected to bear, beside what nineteen of twenty of them do.
    """
    hertz = frequencies[:, None, None]
    omega = 2 * np.pi * hertz
    at = list(zip(grasps, grips.directions))  # noqa: B905
    near = [[actuator.amplitude(grasp, d, frequencies) for d in ds] for grasp, ds in at]
    most = np.moveaxis(np.asarray(near, dtype=float), 2, 0)[:, grips.grasp]  # the map: as at the nearest grasp
    moved = np.array([actuator.delivers(grasp, ds, frequencies) for grasp, ds in at])
    shift, wrong = np.moveaxis(moved, 0, 2)[:, :, grips.grasp]
    delivered = shift, wrong

    def load(values: Array, limit: float | Array, kind: str) -> Bound:
        """Return the bound of a load of which members have values (M, Q, G, D): the median of what is expected."""
        return Bound(np.exp(delivered[0]) * expected(kind, values, hertz), np.atleast_2d(limit))

    bounds = {
        f"{actuator.name} amplitude [share of its limit]": _sure(1 / np.maximum(most, 1e-12), 1.0),
        "grip amplitude [m]": _sure(np.ones_like(most), params.most_amplitude),
        "grip speed [m/s]": _sure(np.ones_like(most) * omega, MOST_SPEED),
        PRESS: load(response.grip_force / params.held(1.0), grips.press, "grip_force"),
    }
    answer = response.answer(frequencies)
    felt = load(answer.flowers.max(axis=-1), LOADED["joint_strain"].low, "flowers")
    for kind, name in PEAKS.items():
        limit = np.where((kind == "leaf_load") & (hertz > GUSTS), np.inf, LOADED[kind].low)
        if kind == "joint_strain":
            bounds[name] = felt._replace(value=stalk_strain(hertz) * felt.value)
        else:
            bounds[name] = load(getattr(response, kind), limit, kind)
    reach = _reach(bounds)
    least = actuator.least_amplitude if params.least_amplitude is None else params.least_amplitude
    price = params.price if params.keeps_limits else 0.0
    sizes = 14  # weighed of each shake, evenly on a logarithmic scale: worth changes little from one to the next
    steps = (np.linspace(0, 1, sizes) if params.keeps_limits else np.ones(1))[:, None, None, None]
    tried = least * np.maximum(reach / least, 1.0) ** steps
    held = params.held(1.0) * grips.press
    found = worth(answer, tried, hertz, held, price, delivered=delivered)
    best = found.net.argmax(axis=0)[None]
    amplitude, score = (np.take_along_axis(values, best, axis=0)[0] for values in (tried, found.net))
    amplitude = np.minimum(amplitude, reach)
    own, regret = (slice(None), slice(None), slice(len(grasps))), dict[str, Array]()
    for measure in DOSE_MEASURES:
        net = np.where(tried <= 1.001 * reach, found.by(measure), -1.0)
        regret[measure] = net[own].max() - np.take_along_axis(net, best, axis=0)[0]
    score = np.where((amplitude < least) | (score <= 0), -1.0, score)
    score[:, len(grasps) :] = -1.0
    return Search(grips, response.flower, answer, frequencies, amplitude, score, regret, bounds, delivered, least)


def _sure(value: Array, limit: float) -> Bound:
    return Bound(value, np.atleast_2d(limit))


def best(found: Search, *, avoid: Place | None = None) -> Place:
    """Return (q, g, d) of the highest score; with `avoid`, at another grip or a fifth or more away in frequency."""
    score = found.score.copy()
    if avoid is not None:
        ratio = found.frequencies / found.frequencies[avoid[0]]
        score[(ratio > 0.8) & (ratio < 1.25), avoid[1]] = -1
    q, g, d = np.unravel_index(int(np.argmax(score)), score.shape)
    return int(q), int(g), int(d)


APART = 1.15
"""Frequencies worth trying are this factor from each other: responses lose their likeness within 40 %."""


def find_candidates(found: Search, at: Place, most: int, earlier: EarlierShake | None) -> CandidateShakes:
    """Return up to `most` frequencies at which a sine is worth most by the model, along any line across a grip.

    Of an earlier visit it is that visit's alone, as large as it was there. Where the actuator has no room along one of
    the lines, the shake's own is the only one.
    """
    q, g, d = at
    reach = _reach(found.bounds)[:, g]
    least = 1e-5  # m that the actuator can move along a line
    lines = np.roll(np.arange(reach.shape[1]), -d) if reach.min() >= least else np.array([d])
    reach = reach[:, lines]
    directions, size = found.grips.directions[g, lines], found.amplitude[:, g, lines]
    if earlier is not None:
        own = reach[[q], :1]
        return CandidateShakes(found.frequencies[[q]], directions[:1], np.minimum(earlier.amplitude, own), own)
    promise = found.score[:, g, lines].max(axis=1)
    chosen = [q]
    slowest = 2.0  # Hz beside the plan's own: watching a slower one takes two seconds and more
    for k in np.argsort(-promise, kind="stable"):
        far = np.abs(np.log(found.frequencies[chosen] / found.frequencies[k])).min() >= np.log(APART)
        if far and found.frequencies[k] >= slowest and promise[k] > 0 and len(chosen) < most:
            chosen.append(int(k))
    return CandidateShakes(found.frequencies[chosen], directions, size[chosen], reach[chosen])


def predicted_at(found: Search, at: Place) -> tuple[Array, Array]:
    """Return each flower's amplitude at a shake (F,), the median of what is expected [m], and (F, 2) of which 5 % lie
    below and above, over that: by the scenarios, the model's errors, and what the actuator delivers."""
    q, g, d = at
    hertz, (shift, wrong) = float(found.frequencies[q]), (float(part[at]) for part in found.delivered)
    omega2 = (2 * np.pi * hertz) ** 2
    logs, doubt = believed("flowers", omega2 * found.flower[:, q, g, d], hertz)
    middle = float(found.amplitude[at]) * np.exp(shift + logs.mean(axis=0)) / omega2
    return middle, interval(logs, np.hypot(doubt, wrong))


def worth_curve_at(found: Search, at: Place, params: Params) -> WorthCurve:
    """Return what a shake is worth by its amplitude, up to what the machine manages."""
    q, g, _ = at
    reach = float(_reach(found.bounds)[at])
    shown = 40
    tried = np.geomspace(found.least, max(reach, 1.01 * found.least), shown)
    alone = Answer(*(part[(slice(None), *at)] for part in found.answer))
    held, delivered = (
        params.held(float(found.grips.press[g, 0])),
        (found.delivered[0][at], found.delivered[1][at]),
    )
    return weighed(alone, tried, found.frequencies[q], held, params.price, delivered=delivered)


def match_earlier(found: Search, earlier: EarlierShake) -> Search | None:
    """Return the search with no other shakes than an earlier visit's, or None where none of them is allowed."""
    ratio = np.abs(np.log(found.frequencies / earlier.frequency))
    score, q = np.full_like(found.score, -1.0), int(ratio.argmin())
    if ratio[q] > 0.5 * np.log(APART):
        return None
    same_place = 0.02  # m along the stem: the pads are 16 mm wide
    for g in np.flatnonzero(np.abs(found.grips.arc_length - earlier.arc_length) <= same_place):
        d = int(np.abs(found.grips.directions[g] @ earlier.direction).argmax())
        score[q, g, d] = found.score[q, g, d]
    return found._replace(score=score) if np.any(score >= 0) else None


def _reach(bounds: dict[str, Bound]) -> Array:
    """Return the largest amplitude that the machine manages of every shake (Q, G, D) [m]."""
    machine = list(bounds.values())[:3]  # in them the plant has no part
    return np.asarray(np.min([one.limit / np.maximum(one.value, 1e-12) for one in machine], axis=0))


def limit_rows(found: Search, at: Place) -> list[LimitRow]:
    """Return (name, value, limit, share used) of every limit that there is at one shake."""
    size, rows = float(found.amplitude[at]), list[LimitRow]()
    for name, one in found.bounds.items():
        value, limit = size * float(one.value[at]), float(np.broadcast_to(one.limit, one.value.shape)[at])
        if np.isfinite(limit):
            rows.append((name, value, limit, value / limit))
    return rows


def closest(rows: Sequence[LimitRow], *, kept: bool = True) -> str:
    """Say which limit is the closest, or, of limits that are not kept, which is passed the furthest."""
    name, value, limit, share = max(rows, key=lambda row: row[3])
    name = name.removesuffix(" [-]")
    if not kept:
        how = f"passed most is {name}" if share > 1 else f"nevertheless none is passed; the closest is {name}"
        return f"No limit of the plant is kept and slip is not prevented; {how}: {value:.3g} of {limit:.3g}."
    return f"The closest limit is {name}: {value:.3g} of {limit:.3g}."
