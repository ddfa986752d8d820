"""Prediction for one plant whose truth is drawn: scanned, probed by a camera, and what it then does to every shake.

F flowers that were seen and are there, G grips, Q frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core import Array, StageFailure
from anther.plant import Crop, PlantModel
from anther.pollination import ObservedShake, Refinement, Seen, refine
from anther.pollination.learning import GripMeasurement
from anther.pollination.response import stem_near
from anther.pollination.shake.observables import semi_major
from anther.pollination.shake.pads import PADS, grip_rows, pad_nodes
from anther.pollination.shake.search import Version, answer
from anther.robot import Frame
from anther.sim import NOMINAL, Organ, Truth
from anther.sim.capture import camera_errors
from anther.sim.sway import swaying
from evaluation.prediction.expectation import amplitude_at, expect, flowers_at, loads_at
from evaluation.prediction.known_plant import DIRECTION, filmed, known, observed, shake_of, stem_points
from evaluation.prediction.shaken_plant import ShakenPlant
from evaluation.trials.grasping_trial import truth_of

HEIGHTS = (0.3, 0.45, 0.65)
"""Grips, in shares of the main stem's length."""
HELD = 1
"""Of `HEIGHTS`: where it is probed."""
SLOW, FAST = (0.7, 1.0, 1.3, 1.6, 1.9), (4.0, 7.0)
"""Frequencies that are predicted [Hz]: the paper's, and those at which an arm moves flowers."""
TONES = (0.8, 1.1, 1.4, 1.8, 4.0)
"""Of the probe, one after the other in one hold [Hz]: a plant is felt where it is to be shaken."""
RAISED = 1.5
"""By how much a shake at a tone of the probe is then raised."""
FORCE_ERROR = (0.15, 0.3)
"""Of the force that the arm feels: relative, and absolute [N]; a guess."""
RATES = (15.0, 30.0)
"""Frames a second, up to 2.5 Hz and beyond: enough for the tones, and quick to render."""
FIRM = 500.0
"""Pads that hold a plant in the wind are no firmer [N/m]: it presses with 0.1 N, and steps of 2 ms stay stable."""
FILM = (2.0, 0.8)
"""How long each tone is filmed at least [s], up to 2.5 Hz and beyond, and two periods."""
KINDS = ("stem_strain", "joint_strain", "base_strain")


@dataclass(frozen=True, slots=True)
class Case:
    """One plant under one truth: "nominal", "wide", or a group of `sim.truth.WIDE` alone."""

    species: Crop
    seed: int
    truth: str = "wide"


def one_plant(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return what is found for one plant (a `Case`), or why it was lost, for a sweep."""
    del folder
    try:
        return predicted(Case(**row))
    except StageFailure as failure:
        return {"species": row["species"], "seed": row["seed"], "lost": str(failure)}


def looks(truth: Truth) -> Truth:
    """Return the truth as far as it changes what is seen: without wind, mechanics do not."""
    if truth.wind > 0:
        return truth
    names = ("pedicel_length", "pose_error", "hand_eye_error", "exposure_spread")
    return replace(NOMINAL, **{name: getattr(truth, name) for name in names})


def predicted(case: Case) -> dict[str, Any]:
    """Scan, model, probe and predict one plant, and return it beside the truth."""
    truth = truth_of(case.truth, case.seed)
    it = known(case.species, case.seed, truth, "fast", looks(truth))
    plant, model, i, j = it.plant, it.model, it.i, it.j
    grips = [ShakenPlant(plant, point, DIRECTION, truth=truth) for point in stem_points(plant, HEIGHTS)]
    points = np.array([grip.point for grip in grips])
    swayed, before = _swayed(grips[HELD], truth), refine(model, [])
    sizes = tone_amplitudes(before, points[HELD])
    probes = [_probe(model, grips[HELD], it.seen, *tone, truth) for tone in zip(TONES, sizes, swayed, strict=True)]
    after = refine(model, probes)
    frequencies = np.array(SLOW + FAST)
    true = np.array([semi_major(grip.linear(frequencies)) for grip in grips])
    loads = {k: np.array([loads_of(grip, frequencies)[k] for grip in grips]) for k in KINDS}
    row: dict[str, Any] = {"species": case.species, "seed": case.seed, "true": true[:, :, j]}
    row["loads"] = loads
    for name, belief in (("before", before), ("after", after)):
        row[name] = flowers_at(belief, points, DIRECTION, frequencies)[:, :, i]
    said = loads_at(after, points, DIRECTION, frequencies)
    row["loads after"] = {k: said[k] for k in KINDS}
    row["held"] = [_raised(after, probes, grips[HELD], *tone, i, j) for tone in zip(TONES, sizes, strict=True)]
    row["pads"] = {
        "found": [after.pads.stiffness, after.pads.turning],
        "true": [truth.pad_stiffness, truth.pad_rotation],
    }
    row["youngs"] = {"found": after.material.youngs, "true": float(plant.youngs[0])}
    return row | {"flowers": it.flowers}


def tone_amplitudes(belief: Refinement, point: Array) -> Array:
    """Return (Q,) how far the gripper moves in each tone of the probe [m].

    So far that the middle flower, if one is known, should move 8 mm, which a camera can follow; not beyond 4 mm nor
    2 m/s2.
    """
    gains = amplitude_at(belief, point[None], DIRECTION, np.array(TONES))[0]
    most = np.minimum(4e-3, 2.0 / (2 * np.pi * np.array(TONES)) ** 2)
    return np.minimum(most, 8e-3 / np.median(gains, axis=1)) if gains.size else most


def _probe(
    model: PlantModel, grip: ShakenPlant, seen: Seen, frequency: float, amplitude: float, swayed: Array, truth: Truth
) -> ObservedShake:
    """Shake at one tone, in the wind; return what camera and arm measured of it."""
    frames = _filmed(grip, amplitude, frequency, truth, swayed)
    ids = seen.stem.node_ids
    nodes, arc = seen.skeleton.nodes[ids], seen.stem.arc_length
    held = float(arc[np.argmin(np.linalg.norm(nodes - grip.point, axis=1))])
    beside = stem_near(nodes, arc, seen.skeleton.radius[ids], held)
    where = pad_nodes(model, grip_rows(model, grip.point[None]))
    linear = semi_major(answer(Version(model), where, DIRECTION, np.array([frequency])).flowers[0, 0])
    shake = shake_of(grip.point, frequency, amplitude, amplitude * linear, PADS)
    return observed(shake, frames, seen, _felt(grip, amplitude, frequency, grip.plant.seed), stem=beside)[0]


def _times(frequency: float) -> Array:
    """Return (T,) when the frames of a tone are taken [s]."""
    rate, least = RATES[int(frequency > 2.5)], FILM[int(frequency > 2.5)]
    return np.arange(int(rate * max(2 / frequency, least))) / rate


def _swayed(grip: ShakenPlant, truth: Truth) -> list[Array]:
    """Return for each tone (T, Nv, 3) by how far the wind has moved the plant, tied where it is held, in each frame."""
    plant, times = grip.plant, [_times(f) for f in TONES]
    if truth.wind == 0:
        return [np.zeros((len(t), *plant.vertices.shape)) for t in times]
    stem = plant.stem_segments()
    held = int(stem[np.argmin(np.linalg.norm(plant.end[stem] - grip.point, axis=1))])
    begins = np.cumsum([0.0, *(t[-1] + 0.1 for t in times[:-1])])
    tied = replace(plant, tie=(held, min(truth.pad_stiffness, FIRM)))
    poses = swaying(tied, truth.wind, np.concatenate([t + begin for t, begin in zip(times, begins, strict=True)]))
    moved = np.array([plant.posed_vertices(T) for T in poses]) - plant.vertices
    return np.split(moved, np.cumsum([len(t) for t in times])[:-1])


def _filmed(grip: ShakenPlant, amplitude: float, frequency: float, truth: Truth, swayed: Array) -> list[Frame]:
    """Return what the side camera sees of a shake, its clock late; nothing is blurred.

    The swing is that of MuJoCo's linear equations with the drag at its amplitude, and the wind's motion besides.
    """
    plant, times = grip.plant, _times(frequency)
    shapes = [plant.posed_vertices(grip.segment_poses(q)) for q in grip.swing(amplitude, frequency, times)]
    shapes = [shape + sway for shape, sway in zip(shapes, swayed, strict=True)]
    rng = np.random.default_rng(plant.seed)
    return filmed(plant, shapes, times + truth.clock_offset, rng, camera_errors(truth))


def _felt(grip: ShakenPlant, amplitude: float, frequency: float, seed: int) -> GripMeasurement:
    """Return what the arm feels of a shake, with its errors; a force that drowns in them is not felt."""
    true = amplitude * grip.force(frequency)
    square = complex(np.sum(true**2))
    size, rng = abs(square) ** 0.5, np.random.default_rng([seed, 11])
    error = float(np.hypot(FORCE_ERROR[0] * size, FORCE_ERROR[1]))
    if size < 3 * error:
        return GripMeasurement(amplitude=amplitude, start=0.0)
    felt = abs(size + error * rng.normal())
    return GripMeasurement(amplitude, 0.0, felt, error, float(np.angle(square) / 2 + error / size * rng.normal()))


def loads_of(grip: ShakenPlant, frequencies: Array) -> dict[str, Array]:
    """Return, by kind, (Q,) the largest strain of small shakes, per metre of grip motion."""
    strain = semi_major(grip.bending(frequencies))
    pieces = grip.mechanics.pieces
    organ = grip.mechanics.plant.organ[pieces.first]
    above = np.where(pieces.parent >= 0, organ[pieces.parent], Organ.STEM)
    places = (organ == Organ.STEM, organ == Organ.PEDICEL, (organ != Organ.STEM) & (above == Organ.STEM))
    return {kind: strain[:, where].max(axis=1, initial=0.0) for kind, where in zip(KINDS, places, strict=True)}


def _raised(
    belief: Refinement,
    probes: list[ObservedShake],
    grip: ShakenPlant,
    f: float,
    size: float,
    i: NDArray[Any],
    j: NDArray[Any],
) -> dict[str, Array]:
    """Return what a shake at a tone of the probe, raised, does and is expected to do."""
    amplitude = RAISED * size
    told = expect(belief, probes, grip.point, DIRECTION, f, amplitude)
    true = amplitude * semi_major(grip.linear([f], amplitude)[0])
    return {"true": true[j], "said": told.amplitude[i], "interval": told.interval[i], "measured": told.measured[i]}
