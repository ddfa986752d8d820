"""Which shake of all: the largest that every limit allows, for each waveform, frequency, grip and direction.

F flowers, G grips, D directions, Q frequencies, M scenarios, W waveforms.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.geometry import Array
from anther.grasp import Grasp
from anther.plant import PlantModel
from anther.vibration.actuators import Actuator
from anther.vibration.dose import freed_share, set_probability
from anther.vibration.pads import grip_rows, pad_nodes
from anther.vibration.params import RESONANT, Params
from anther.vibration.search import Gains
from anther.vibration.verification import PEAKS
from anther.vibration.waveforms import Mix, mix

Place = tuple[int, int, int, int]
"""(w, q, g, d): one shake of the search."""


class Grips(NamedTuple):
    """Where the stem may be held: the grasps' nodes first, then others for the map."""

    nodes: list[NDArray[Any]]  # G lists of rod nodes between the pads, the middle one first
    arc_length: Array  # (G,) [m]
    grasp: NDArray[Any]  # (G,) index of the grasp itself or, for the map, of the nearest one
    directions: Array  # (G, D, 3)


class Search(NamedTuple):
    """The search space, all (W, Q, G, D) but `bounds` and `duration`."""

    frequencies: Array  # (Q,) [Hz]
    duration: Array  # (Q,) [s]
    amplitude: Array  # largest allowed [m]; 0 where the waveform would leave the frequencies
    score: Array  # of the objective; -1 where less than the least amplitude is allowed
    bounds: dict[str, tuple[Array, float]]  # name -> (value per metre of amplitude (W, Q, G, D), its limit)


def grips_of(plant: PlantModel, grasps: Sequence[Grasp], params: Params) -> Grips:
    """Return the grasps' places on the stem, and others for the map, with the directions across the stem."""
    held = grip_rows(plant, np.array([g.point for g in grasps]))
    usable = np.flatnonzero(~np.isin(plant.stem_nodes, plant.clamp.nodes))
    others = usable[np.unique(np.linspace(0, len(usable) - 1, params.heights).round().astype(int))]
    rows = np.concatenate([held, others])
    nodes, arc = pad_nodes(plant, rows, params.pads.width), plant.arc_length[rows]
    nearest = np.abs(arc[len(held) :, None] - arc[: len(held)]).argmin(axis=1)
    near = np.concatenate([np.arange(len(held)), nearest])
    return Grips(nodes, arc, near, _directions(plant, plant.stem_nodes[rows], params.directions))


def _directions(plant: PlantModel, nodes: NDArray[Any], count: int) -> Array:
    """Return (G, D, 3) unit vectors across the stem, above `count` directions of the horizontal half circle."""
    angle = np.arange(count) * np.pi / count
    flat = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    tangent = plant.rods.nodes[nodes] - plant.rods.nodes[plant.rods.parent[nodes]]
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    across = flat - np.einsum("dk,gk->gd", flat, tangent)[..., None] * tangent[:, None]
    size = np.linalg.norm(across, axis=2, keepdims=True)
    return np.where(size > 0.3, across / np.maximum(size, 1e-9), flat)  # along a lying stem: leave it horizontal


def plant_limits(params: Params) -> dict[str, float]:
    """Return what `PEAKS` may reach: the share of the plant's limits that is used."""
    values = (params.stem_strain, params.joint_strain, params.joint_strain, params.leaf_load)
    return {name: params.plant_share * value for name, value in zip(PEAKS, values, strict=True)}


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
    """Return every shake at the largest amplitude that all limits allow, and its worth.

    The plant's limits must hold for the plant as believed, at which the nonlinear solver will look, and in the
    `caution` quantile of the scenarios; a scenario in which one is passed gains nothing: its flowers set as if they had
    not been shaken. Pedicels must bear a resonance besides that no scenario has: `Params.resonant_strain`.
    """
    omega = 2 * np.pi * frequencies[:, None, None]
    near = [[actuator.amplitude(grasp, d, frequencies) for d in ds] for grasp, ds in zip(grasps, grips.directions)]  # noqa: B905
    most = np.moveaxis(np.asarray(near, dtype=float), 2, 0)[:, grips.grasp]  # the map: as at the nearest grasp
    per_metre = {  # (M or 1, Q, G, D)
        f"{actuator.name} amplitude [share of its limit]": (1 / np.maximum(most, 1e-12)[None], params.arm_share),
        "grip amplitude [m]": (np.ones_like(most)[None], params.most_amplitude),
        "grip speed [m/s]": (np.ones_like(most)[None] * omega, params.most_speed),
        "pedicel strain in a resonance [-]": (np.ones_like(most)[None] * _resonant(omega, params), params.joint_strain),
    }
    strains = (response.stem_strain, response.joint_strain, response.base_strain, response.leaf_load)
    for (name, limit), values in zip(plant_limits(params).items(), strains, strict=True):
        per_metre[name] = (values, limit)
    hold = 2 * params.pad_friction * params.grip_force
    per_metre["force in the grip, against slip [N]"] = (response.grip_force, params.plant_share * hold)
    acceleration = response.flower * omega[..., None] ** 2
    per_metre["flower acceleration [m/s2]"] = (acceleration.max(axis=-1), params.flower_acceleration)

    duration = np.clip(5 / frequencies, params.duration, params.most_duration)
    shape = (len(params.waveforms), *most.shape)
    amplitude, score = np.zeros(shape), np.full(shape, -1.0)
    bounds = {name: (np.zeros(shape), limit) for name, (_, limit) in per_metre.items()}
    for w, waveform in enumerate(params.waveforms):
        for q in range(len(frequencies)):
            pieces = mix(waveform, frequencies, q, float(duration[q]))
            if pieces is None:
                continue
            amplitude[w, q], worth = _one(pieces, per_metre, response.flower, acceleration, bounds, (w, q), params)
            score[w, q] = np.where(amplitude[w, q] < least, -1.0, worth)
    return Search(frequencies, duration, amplitude, score, bounds)


def _resonant(omega: Array, params: Params) -> Array:
    """Return the strain of a pedicel in a resonance per metre of grip amplitude [1/m], see `Params.resonant_strain`."""
    return params.resonant_strain * omega * np.minimum(omega, 2 * np.pi * RESONANT)


def _one(
    pieces: Mix,
    per_metre: dict[str, tuple[Array, float]],
    flower: Array,
    acceleration: Array,
    bounds: dict[str, tuple[Array, float]],
    at: tuple[int, int],
    params: Params,
) -> tuple[Array, Array]:
    """Fill `bounds` for one waveform and frequency; return the largest amplitude (G, D) and the worth there (G, D)."""

    def over_time(values: Array) -> Array:
        """Return (K, M, G, D, ...) of values (M, Q, G, D, ...)."""
        return pieces.of(np.swapaxes(values, 0, 1))

    amplitude = np.full(flower.shape[2:4], np.inf)
    worst = {name: over_time(values).max(axis=0) for name, (values, _) in per_metre.items()}  # (M or 1, G, D)
    for name, (into, limit) in bounds.items():
        into[at] = np.maximum(worst[name][0], np.quantile(worst[name], params.caution, axis=0))
        amplitude = np.minimum(amplitude, limit / np.maximum(into[at], 1e-12))
    kept = np.all([amplitude * v <= per_metre[name][1] * (1 + 1e-9) for name, v in worst.items() if len(v) > 1], axis=0)
    if params.objective == "amplitude":
        return amplitude, (amplitude[..., None] * over_time(flower).max(axis=0) * kept[..., None]).mean(axis=(0, -1))
    a = amplitude[..., None] * over_time(acceleration)
    freed = freed_share(a, pieces.seconds, params.half_dose, params.release_time) * kept[..., None]
    return amplitude, set_probability(freed, params.unshaken, params.gain).sum(axis=-1).mean(axis=0)


def best(found: Search, rows: NDArray[Any], *, avoid: Place | None = None) -> Place:
    """Return (w, q, g, d) of the highest score among the grips `rows`.

    With `avoid`, only shakes at another grip or a fifth or more away in frequency count.
    """
    score = found.score[:, :, rows].copy()
    if avoid is not None:
        ratio = found.frequencies / found.frequencies[avoid[1]]
        same = np.flatnonzero((ratio > 0.8) & (ratio < 1.25))
        score[:, same, list(rows).index(avoid[2])] = -1
    w, q, g, d = np.unravel_index(int(np.argmax(score)), score.shape)
    return int(w), int(q), int(rows[g]), int(d)


def limit_rows(found: Search, at: Place) -> list[tuple[str, float, float, float]]:
    """Return (name, value, limit, share used) of every limit at one shake."""
    size = float(found.amplitude[at])
    values = {name: (size * float(value[at]), limit) for name, (value, limit) in found.bounds.items()}
    return [(name, value, limit, value / limit) for name, (value, limit) in values.items()]


def closest(rows: Sequence[tuple[str, float, float, float]]) -> str:
    """Say which limit is the closest."""
    name, value, limit, _ = max(rows, key=lambda row: row[3])
    return f"The limit that binds is {name}: {value:.3g} of {limit:.3g}."
