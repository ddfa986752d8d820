"""Which shake of all: the largest that every limit allows, for each frequency, grip and direction.

F flowers, G grips, D directions, Q frequencies, M scenarios.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import norm

from anther.geometry import Array
from anther.grasp import Grasp
from anther.plant import PlantModel
from anther.pressing import PRESSING, Pressing
from anther.shake._actuators import Actuator
from anther.shake._breeze import FLOWERS
from anther.shake._plan import EarlierShake, Tones
from anther.shake._verification import PEAKS
from anther.shake.pads import grip_rows, pad_nodes
from anther.shake.params import LOAD_ERROR, MOST_DURATION, Params, load_error
from anther.shake.search import Gains

Place = tuple[int, int, int]
"""(q, g, d): one shake of the search."""


PRESS = "force of the pads, against slip [N]"
"""The limit that says how hard they must press."""
MOST_SPEED = 0.3
"""Of the grip [m/s]."""
FLOWER_ACCELERATION = 200.0
"""Of the flowers on average; more than this is not useful [m/s2]."""


class Grips(NamedTuple):
    """Where the stem may be held: the grasps' nodes first, then others for the map."""

    nodes: list[NDArray[Any]]  # G lists of rod nodes between the pads, the middle one first
    arc_length: Array  # (G,) [m]
    grasp: NDArray[Any]  # (G,) index of the grasp itself or, for the map, of the nearest one
    directions: Array  # (G, D, 3)
    press: Array  # (G, 1) the most that pads may press the stem with there [N]


class Search(NamedTuple):
    """The search space, all (Q, G, D) but `bounds` and `duration`."""

    frequencies: Array  # (Q,) [Hz]
    duration: Array  # (Q,) [s]
    amplitude: Array  # largest allowed [m]
    score: Array  # of the objective; -1 where less than the least amplitude is allowed
    bounds: dict[str, tuple[Array, Array]]  # name -> (value per metre of amplitude (Q, G, D), its limit (G or 1, 1))
    believed: dict[str, Array]  # the same of the plant as believed: what its values are without the margin


def grips_of(
    plant: PlantModel,
    grasps: Sequence[Grasp],
    params: Params,
    pressing: Pressing = PRESSING,
    axis: Callable[[Grasp], Array | None] = lambda _: None,
) -> Grips:
    """Return the grasps' places on the stem, and others for the map, with the directions across the stem."""
    held = grip_rows(plant, np.array([g.point for g in grasps]))
    usable = np.flatnonzero(~np.isin(plant.stem_nodes, plant.clamp.nodes))
    others = usable[np.unique(np.linspace(0, len(usable) - 1, params.heights).round().astype(int))]
    rows = np.concatenate([held, others])
    nodes, arc = pad_nodes(plant, rows, params.pads.width), plant.arc_length[rows]
    nearest = np.abs(arc[len(held) :, None] - arc[: len(held)]).argmin(axis=1)
    near = np.concatenate([np.arange(len(held)), nearest])
    axes = [axis(grasp) for grasp in grasps]
    directions = _directions(plant, plant.stem_nodes[rows], params.directions)
    if all(line is not None for line in axes):
        directions = np.array(axes, dtype=float)[near, None]
    diameter = 2 * np.asarray(plant.rods.edge_radius)[plant.stem_nodes[rows], None]
    return Grips(nodes, arc, near, directions, pressing.most(diameter))


def _directions(plant: PlantModel, nodes: NDArray[Any], count: int) -> Array:
    """Return (G, D, 3) unit vectors across the stem, above `count` directions of the horizontal half circle."""
    angle = np.arange(count) * np.pi / count
    flat = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    tangent = plant.rods.nodes[nodes] - plant.rods.nodes[plant.rods.parent[nodes]]
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    across = flat - np.einsum("dk,gk->gd", flat, tangent)[..., None] * tangent[:, None]
    size = np.linalg.norm(across, axis=2, keepdims=True)
    return np.where(size > 0.3, across / np.maximum(size, 1e-9), flat)  # along a lying stem: leave it horizontal


class Bound(NamedTuple):
    """Something that grows with the amplitude, and how large it may be."""

    values: Array  # (M or 1, Q, G, D) per metre of amplitude
    limit: float | Array  # (G, 1) or (Q, 1, 1) where it is not the same for all
    error: tuple[Array, Array] | None = None  # see `load_error`; None: it is known


def plant_limits(params: Params, frequencies: ArrayLike) -> dict[str, float | Array]:
    """Return what `PEAKS` may reach at frequencies [Hz]; what depends on them has their shape."""
    may = params.plant
    values = (may.stem_strain, may.pedicel_strain, may.base_strain, may.leaf_load_at(frequencies))
    return dict(zip(PEAKS, values, strict=True))


def checked_limits(found: Search, at: Place, params: Params) -> dict[str, float]:
    """Return what `PEAKS` may reach for the plant as believed, so that the margin of the search is kept."""
    if not params.keeps_limits:
        return dict.fromkeys(PEAKS, np.inf)
    believed = {name: float(found.believed[name][at]) for name in PEAKS}
    return {
        name: float(limit) * (believed[name] / float(found.bounds[name][0][at]) if believed[name] > 0 else 1.0)
        for name, limit in plant_limits(params, found.frequencies[at[0]]).items()
    }


def search(
    response: Gains,
    grips: Grips,
    grasps: Sequence[Grasp],
    frequencies: Array,
    *,
    actuator: Actuator,
    least: float,
    params: Params,
) -> Search:
    """Return every shake at the largest amplitude that all limits allow, and its worth; see `Params.keeps_limits`.

    The plant's loads are lognormal, where and as wide as scenarios and `LOAD_ERROR` say. A limit must hold but for a
    share `Params.risk` of that.
    """
    hertz = frequencies[:, None, None]
    omega = 2 * np.pi * hertz
    near = [[actuator.amplitude(grasp, d, frequencies) for d in ds] for grasp, ds in zip(grasps, grips.directions)]  # noqa: B905
    most = np.moveaxis(np.asarray(near, dtype=float), 2, 0)[:, grips.grasp]  # the map: as at the nearest grasp
    acceleration = response.flower * omega[..., None] ** 2
    per_metre = {
        f"{actuator.name} amplitude [share of its limit]": Bound(1 / np.maximum(most, 1e-12)[None], 1.0),
        "grip amplitude [m]": Bound(np.ones_like(most)[None], params.most_amplitude),
        "grip speed [m/s]": Bound(np.ones_like(most)[None] * omega, MOST_SPEED),
        PRESS: Bound(response.grip_force / params.held(1.0), grips.press, load_error("grip_force", hertz)),
        FLOWERS: Bound(acceleration.mean(axis=(0, -1))[None], FLOWER_ACCELERATION),
    }
    for (name, limit), kind in zip(plant_limits(params, hertz).items(), LOAD_ERROR, strict=False):
        per_metre[name] = Bound(getattr(response, kind), limit, load_error(kind, hertz))

    bounds = {
        name: (margined(bound.values, bound.error, params.risk), np.atleast_2d(bound.limit))
        for name, bound in per_metre.items()
    }
    kept = list(bounds.values())[: None if params.keeps_limits else OF_THE_MACHINE]
    amplitude = np.min([limit / np.maximum(value, 1e-12) for value, limit in kept], axis=0)
    score = np.where(amplitude < least, -1.0, _worth(response.flower, acceleration, amplitude, params))
    duration = np.clip(5 / frequencies, params.duration, MOST_DURATION)
    believed = {name: bound.values[0] for name, bound in per_metre.items()}
    return Search(frequencies, duration, amplitude, score, bounds, believed)


def margined(values: Array, error: tuple[float | Array, float | Array] | None, risk: float) -> Array:
    """Return (...) what a lognormal load of which scenarios have values (M, ...) passes with probability `risk`."""
    if error is None:
        return values.mean(axis=0)
    median, spread = error
    logs = np.log(np.maximum(values, 1e-12))
    return median * np.exp(logs.mean(axis=0) + norm.isf(risk) * np.hypot(logs.std(axis=0), spread))


ROBUST = 0.25
"""A shake is ranked by the acceleration that all but this share of the flowers reach, over all scenarios of the plant.
What pollen or fruit that is worth is not well enough known to choose by (`anther.fruit_set`)."""


def _worth(flower: Array, acceleration: Array, amplitude: Array, params: Params) -> Array:
    """Return (Q, G, D) what the objective is worth at amplitudes (Q, G, D): [m/s2] or [m].

    Motion and acceleration of the flowers are those per metre of amplitude, (M, Q, G, D, F).
    """
    if params.objective == "amplitude":
        return amplitude * flower.mean(axis=(0, -1))
    return amplitude * np.quantile(acceleration, ROBUST, axis=(0, -1))


def best(found: Search, rows: NDArray[Any], *, avoid: Place | None = None) -> Place:
    """Return (q, g, d) of the highest score among the grips `rows`.

    With `avoid`, only shakes at another grip or a fifth or more away in frequency count.
    """
    score = found.score[:, rows].copy()
    if avoid is not None:
        ratio = found.frequencies / found.frequencies[avoid[0]]
        same = np.flatnonzero((ratio > 0.8) & (ratio < 1.25))
        score[same, list(rows).index(avoid[1])] = -1
    q, g, d = np.unravel_index(int(np.argmax(score)), score.shape)
    return int(q), int(rows[g]), int(d)


OF_THE_MACHINE = 3
"""The first bounds of a search: the plant has no part in them."""
QUICK = 2.0
"""Slower frequencies are not tried beside the plan's own [Hz]: watching one takes two seconds and more."""
ROOM = 1e-5
"""A line along which the actuator can move less than this [m] is none."""
APART = 1.15
"""Frequencies worth trying are this factor from each other: responses lose their likeness within 40 %."""


def tones_at(
    found: Search, grips: Grips, response: Gains, at: Place, least: float, most: int, earlier: EarlierShake | None
) -> Tones:
    """Return up to `most` frequencies at which a sine moves flowers most by the model, along any line across a grip.

    Of an earlier visit it is that visit's alone, as large as it was there. Where the actuator has no room along one of
    the lines, the shake's own is the only one.
    """
    q, g, d = at
    bounds = list(found.bounds.values())[:OF_THE_MACHINE]
    reach = np.min([(limit / np.maximum(value, 1e-12))[:, g] for value, limit in bounds], axis=0)
    lines = np.roll(np.arange(reach.shape[1]), -d) if reach.min() >= ROOM else np.array([d])
    reach = reach[:, lines]
    directions, size = grips.directions[g, lines], found.amplitude[:, g, lines]
    if earlier is not None:
        own = reach[[q], :1]
        return Tones(found.frequencies[[q]], directions[:1], np.minimum(earlier.amplitude, own), own)
    moved = (2 * np.pi * found.frequencies[:, None]) ** 2 * size * response.flower[:, :, g, lines].mean(axis=(0, -1))
    worth = np.where(size >= least, moved, 0.0).max(axis=1)
    chosen = [q]
    for k in np.argsort(-worth, kind="stable"):
        far = np.abs(np.log(found.frequencies[chosen] / found.frequencies[k])).min() >= np.log(APART)
        if far and found.frequencies[k] >= QUICK and worth[k] > 0 and len(chosen) < most:
            chosen.append(int(k))
    return Tones(found.frequencies[chosen], directions, size[chosen], reach[chosen])


SAME_PLACE = 0.02
"""A grip is the one of an earlier visit up to this along the stem [m]: the pads are 16 mm wide."""


def as_earlier(found: Search, grips: Grips, grasps: int, earlier: EarlierShake) -> Search | None:
    """Return the search with no other shakes than an earlier visit's, or None where none of them is allowed."""
    ratio = np.abs(np.log(found.frequencies / earlier.frequency))
    rows = np.flatnonzero(np.abs(grips.arc_length[:grasps] - earlier.arc_length) <= SAME_PLACE)
    score, q = np.full_like(found.score, -1.0), int(ratio.argmin())
    if ratio[q] > 0.5 * np.log(APART):
        return None
    for g in rows:
        d = int(np.abs(grips.directions[g] @ earlier.direction).argmax())
        score[q, g, d] = found.score[q, g, d]
    return found._replace(score=score) if np.any(score >= 0) else None


def limit_rows(found: Search, at: Place) -> list[tuple[str, float, float, float]]:
    """Return (name, value, limit, share used) of every limit that there is at one shake."""
    size = float(found.amplitude[at])
    values = {
        name: (size * float(value[at]), float(np.broadcast_to(limit, value.shape)[at]))
        for name, (value, limit) in found.bounds.items()
    }
    return [(name, value, limit, value / limit) for name, (value, limit) in values.items() if np.isfinite(limit)]


def press(limits: Sequence[tuple[str, float, float, float]], least: float) -> float:
    """Return how hard the pads are to press [N]: as the shake needs, at least `least`, at most what is allowed."""
    needed, most = next((value, limit) for name, value, limit, _ in limits if name == PRESS)
    return min(max(needed, least), most)


def closest(rows: Sequence[tuple[str, float, float, float]], *, kept: bool = True) -> str:
    """Say which limit is the closest, or, of limits that are not kept, which is passed the furthest."""
    name, value, limit, share = max(rows, key=lambda row: row[3])
    if not kept:
        how = f"passed most is {name}" if share > 1 else f"nevertheless none is passed; the closest is {name}"
        return f"No limit of the plant is kept and slip is not prevented; {how}: {value:.3g} of {limit:.3g}."
    return f"The limit that binds is {name}: {value:.3g} of {limit:.3g}."
