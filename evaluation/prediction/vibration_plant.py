"""One plant of vibration.py: shaken in MuJoCo, scanned, modelled, probed once, and every model's prediction beside it.

R shakes, F flowers that were seen and are there, G grips.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from anther.core import Array, StageFailure
from anther.plant import Crop, Material, PlantModel
from anther.pollination import Grasp, ObservedShake, Refinement, refine
from anther.pollination.learning import GripMeasurement
from anther.pollination.shake import sawyer_limit
from anther.pollination.shake.observables import semi_major
from anther.pollination.shake.pads import Pads, grip_rows, pad_nodes
from anther.rods import Drive
from evaluation.prediction.expectation import amplitude_at
from evaluation.prediction.known_plant import DIRECTION, Known, filmed, known, observed, shake_of, stem_points
from evaluation.prediction.shaken_plant import Params as ShakenParams
from evaluation.prediction.shaken_plant import ShakenPlant
from evaluation.prediction.steady import steadily_shaken
from evaluation.prediction.vibration_models import Model, anther_model, paper_model, true_model

HEIGHTS = (0.3, 0.45, 0.6, 0.75, 0.9)
"""Grips, in shares of the main stem's length."""
MIDDLE = 1
"""Of `HEIGHTS`: held there, the plant is shaken by every amplitude."""
PAPER_FREQUENCIES = (0.7, 1.0, 1.3, 1.6, 1.9)
"""[Hz], the authors' (facts: pollination 0)."""
FAST_FREQUENCIES = (3.0, 5.0, 10.0, 30.0)
AMPLITUDES = (4e-3, 6e-3, 8e-3, 10e-3, 12e-3)
"""[m], the authors'; smaller where the arm cannot."""
ARM_SHARE = 0.8
"""Of what the arm can do."""
PROBE_HEIGHT, PROBE_AMPLITUDE = 1, 4e-3
PROBE_FREQUENCIES = (1.15, 1.45, 1.75)
"""One probe: bursts one after the other in one hold [Hz]. A phase, or more than one frequency, tells on which side of a
resonance a flower is."""
STEP = ShakenParams(timestep=1e-3)
"""What is stepped through time is within 1.5 % of the amplitudes with this step [s], in half the time of 0.5 ms."""
CAMERA_RATE = 15.0
"""Of the side camera, slow for a D455 and enough for a slow probe [Hz]."""
CAMERA_ERROR = 3e-4
"""With which a perfect camera, that sees every flower, would measure an amplitude [m] (docs/reports/response.md)."""
HELD = Pads(stiffness=1e9, turning=1e6, stiffness_spread=1e-3, turning_spread=1e-3)
"""What models believe of the pads: they do not give, as MuJoCo's grip here does not."""
TWIST = 12.0
"""EI/GJ of rods that are to be like MuJoCo's plants."""

Predictor = Callable[[Array, Array, Array], Array]
"""Gives (G, Q, F) flower amplitudes per metre at grips (G, 3), along a direction (3,), at frequencies (Q,) [Hz]."""


@dataclass(frozen=True, slots=True)
class Case:
    """One plant, and how thoroughly it is shaken.

    Attributes:
        species, seed: of the plant.
        frequencies: [Hz].
        amplitudes: [m].
        stepped_below: slower shakes at the middle grip are stepped through time; all others follow from MuJoCo's linear
            equations [Hz].
    """

    species: Crop
    seed: int
    frequencies: tuple[float, ...] = PAPER_FREQUENCIES + FAST_FREQUENCIES
    amplitudes: tuple[float, ...] = AMPLITUDES
    stepped_below: float = 2.0

    @property
    def name(self) -> str:
        """Return "tomato-0"."""
        return f"{self.species}-{self.seed}"


def one_plant(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return what is found for one plant (a `Case`), or why it was lost, for a sweep."""
    del folder
    case = Case(**row)
    try:
        return judged(case, known(case.species, case.seed))
    except StageFailure as failure:
        return {"lost": f"{case.name}: {failure}"}


def judged(case: Case, it: Known) -> dict[str, Any]:
    """Shake and compare one plant that was scanned and modelled.

    Returns:
        what vibration.json keeps of a plant: see `evaluation/prediction/vibration.py`.
    """
    plant, model, i, j = it.plant, it.model, it.i, it.j
    grips = [ShakenPlant(plant, point, DIRECTION) for point in stem_points(plant, HEIGHTS)]
    points = np.array([grip.point for grip in grips])
    beliefs, probe = probed(it, grips[PROBE_HEIGHT], case.seed)
    shakes = plan(case)
    stepped = ShakenPlant(plant, points[MIDDLE], DIRECTION, STEP) if case.stepped_below > 0 else None
    truth = [_shaken(grips[g], stepped if f < case.stepped_below and g == MIDDLE else None, a, f) for g, a, f in shakes]
    models, soft, notes = predictors(case, it, beliefs)
    frequencies = np.array(case.frequencies)
    predicted: dict[str, Any] = {}
    for name, (predictor, flowers) in models.items():
        try:
            gain = predictor(points, DIRECTION, frequencies)[:, :, j if flowers == "true" else i]
        except StageFailure as failure:
            notes.append(f"{name}: {failure}")
            continue
        predicted[name] = [a * gain[g, case.frequencies.index(f)] for g, a, f in shakes]
    small = np.array([semi_major(grip.linear(frequencies))[:, j] for grip in grips])
    middle = len(case.amplitudes) // 2
    first = [n for n, (g, _, _) in enumerate(shakes) if g == MIDDLE][:: len(case.amplitudes)]
    checked = [n + middle for n in first] if case.stepped_below else []
    return {
        "species": case.species,
        "seed": case.seed,
        "flowers": it.flowers,
        "youngs_mpa": {"true": plant.youngs[0] / 1e6}
        | {name: belief.material.youngs / 1e6 for name, belief in beliefs.items()},
        "damping_ratio": {"true": plant.damping_ratio[0], "probe": beliefs["probe"].material.damping_ratio},
        "mass_g": {"true": 1e3 * (plant.mass + plant.lump_mass).sum(), "model": 1e3 * model.rods.node_mass.sum()},
        "paper_soft": soft,
        "probe": probe,
        "notes": notes,
        "shakes": [{"height": HEIGHTS[g], "amplitude_m": a, "frequency_hz": f} for g, a, f in shakes],
        "unsteadiness": [unsteady for _, unsteady in truth],
        "true_m": [amplitude[j] for amplitude, _ in truth],
        "linear_m": [a * small[g, case.frequencies.index(f)] for g, a, f in shakes],
        "nonlinear_m": {
            str(k): _nonlinear(model, beliefs["probe"].material, points[MIDDLE], *shakes[k][1:])[i] for k in checked
        },
        "predicted_m": predicted,
    }


def _nonlinear(model: PlantModel, material: Material, point: Array, amplitude: float, frequency: float) -> Array:
    """Return what the nonlinear solver says of every flower's amplitude (F,) [m]; NaN where it finds no solution."""
    node, *also = (int(n) for n in pad_nodes(model, grip_rows(model, point[None]))[0])
    drive = Drive(node, DIRECTION, amplitude, frequency, 0, tuple(also))
    try:
        return steadily_shaken(model.with_material(material), drive, HELD.springs).amplitude
    except StageFailure:
        return np.full(len(model.flower_nodes), np.nan)


def plan(case: Case) -> list[tuple[int, float, float]]:
    """Return (number of the grip, amplitude [m], frequency [Hz]) of every shake."""
    shakes = []
    for f in case.frequencies:
        scale = min(1.0, arm_amplitude(f) / AMPLITUDES[-1])
        sizes = [scale * a for a in case.amplitudes]
        shakes += [(MIDDLE, a, f) for a in sizes]
        shakes += [(g, sizes[len(sizes) // 2], f) for g in range(len(HEIGHTS)) if g != MIDDLE]
    return shakes


def arm_amplitude(frequency: float) -> float:
    """Return what the Sawyer can shake along `DIRECTION` at a frequency [Hz], with a margin [m]."""
    from_the_front = cast(Grasp, SimpleNamespace(approach=np.array([1.0, 0.0, 0.0])))
    return ARM_SHARE * float(sawyer_limit(from_the_front, DIRECTION, np.array([frequency]))[0])


def _shaken(grip: ShakenPlant, stepped: ShakenPlant | None, amplitude: float, frequency: float) -> tuple[Array, float]:
    """Return every flower's true amplitude (F,) [m], and the unsteadiness of the record if it was stepped."""
    if stepped is None:
        return amplitude * semi_major(grip.linear([frequency])[0]), 0.0
    done = stepped.steady(amplitude, frequency)
    return done.amplitude, done.unsteadiness


def probed(it: Known, grip: ShakenPlant, seed: int) -> tuple[dict[str, Refinement], dict[str, Any]]:
    """Shake in bursts; return what is believed before and after, and after with perfect sight, and the numbers."""
    by_camera, by_truth, bursts = [], [], []
    rng, model = np.random.default_rng(seed), it.model
    for f in PROBE_FREQUENCIES:
        camera = replace(STEP, samples=round(CAMERA_RATE / f), measure=1.5)
        shaken = ShakenPlant(grip.plant, grip.point, DIRECTION, camera)
        done = shaken.steady(PROBE_AMPLITUDE, f)
        shapes = [shaken.plant.posed_vertices(shaken.segment_poses(qpos)) for qpos in done.qpos]
        frames = filmed(it.plant, shapes, done.times, np.random.default_rng(seed))
        expected = anther_model(model).response(grip.point[None], DIRECTION, np.array([f]))[0, 0]
        shake = shake_of(grip.point, f, PROBE_AMPLITUDE, PROBE_AMPLITUDE * expected, HELD)
        seen, answer = observed(shake, frames, it.seen, GripMeasurement(start=0.0))
        true = np.full(len(expected), np.nan)
        true[it.i] = np.abs(done.amplitude[it.j] + rng.normal(0, CAMERA_ERROR, len(it.j)))
        by_camera.append(seen)
        by_truth.append(ObservedShake(shake, true, np.full(len(expected), CAMERA_ERROR)))
        numbers = answer.amplitude[it.i], answer.amplitude_std[it.i], done.amplitude[it.j]
        bursts.append(dict(zip(("measured_m", "std_m", "true_m"), numbers, strict=True)))
    beliefs = {"prior": refine(model, [], pads=HELD), "probe": refine(model, by_camera, pads=HELD)}
    beliefs["probe, every flower seen"] = refine(model, by_truth, pads=HELD)
    whole = {name: np.concatenate([burst[name] for burst in bursts]) for name in bursts[0]}
    return beliefs, {**whole, "notes": list(beliefs["probe"].notes)}


def predictors(
    case: Case, it: Known, beliefs: dict[str, Refinement]
) -> tuple[dict[str, tuple[Predictor, str]], float, list[str]]:
    """Return the models by name, each with whose flowers it has ("seen" or "true").

    Then how many times too soft the authors' E is for the paper's model to stand, and which models there are not.
    """
    plant, model, notes = it.plant, it.model, []
    radius = float(np.mean(plant.stem_centreline()[1]))
    paper, soft = paper_model(it.seen, case.species, radius)
    scripts, _ = paper_model(it.seen, case.species, radius, as_scripted=True)
    out: dict[str, tuple[Predictor, str]] = {
        name: (partial(amplitude_at, belief), "seen") for name, belief in beliefs.items()
    }
    out |= {"paper": (paper.response, "seen"), "paper as scripted": (scripts.response, "seen")}
    stiff = {"youngs": float(plant.youngs[0]), "damping_ratio": float(plant.damping_ratio[0])}
    made: dict[str, tuple[Callable[[], Model], str]] = {
        "probe, mean": (lambda: anther_model(model.with_material(beliefs["probe"].material)), "seen"),
        "true material": (lambda: anther_model(model.with_material(replace(model.material, **stiff))), "seen"),
        "true plant": (lambda: true_model(plant, TWIST), "true"),
    }
    for name, (make, flowers) in made.items():
        try:
            out[name] = make().response, flowers
        except StageFailure as failure:
            notes.append(f"{name}: {failure}")
    return out, soft, notes
