"""A simulated plant as an experiment knows it: grown, scanned, modelled, and observed while it is shaken.

F flowers, G grips, T samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from anther.core import Array, Box
from anther.core.geometry import interpolate
from anther.perception import Capture
from anther.plant import PRIORS, Crop, PlantModel, build_plant
from anther.pollination import ObservedShake, Response, Seen, ShakePlan, measure_response, pipeline
from anther.pollination.learning import GripMeasurement
from anther.pollination.shake.pads import Pads
from anther.robot import Frame
from anther.sim import NOMINAL, Scene, SimPlant, Truth, grow, layout, photograph, views_at
from anther.sim.capture import CameraErrors, sensed
from anther.sim.robot import SIDE
from anther.sim.simulated_cell import PRESETS, USUAL_DISTANCE, in_wind
from evaluation.trials.grasping_trial import Memory

DIRECTION = np.array([1.0, 0.0, 0.0])
"""Along x, as the authors: towards the plant and back. The side camera looks across it."""
NEAR = 0.02
"""A flower seen this close to a true one is that one [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """A plant, what perception made of it, and Anther's model; flower i of what was seen is flower j of the plant."""

    plant: SimPlant
    seen: Seen
    model: PlantModel
    i: NDArray[Any]
    j: NDArray[Any]

    @property
    def flowers(self) -> dict[str, int]:
        """How many flowers there are, were seen, and are both."""
        counts = len(self.plant.flower_position), len(self.seen.flowers.positions), len(self.i)
        return dict(zip(("true", "seen", "matched"), counts, strict=True))


def known(species: Crop, seed: int, truth: Truth = NOMINAL, preset: str = "full", looks: Truth | None = None) -> Known:
    """Grow a plant of a truth, scan it as by a preset of `anther trial`, and model it with the crop's prior.

    Args:
        species, seed: of the plant.
        truth: of the plant.
        preset: of the views.
        looks: the truth as far as it changes what is seen, so that scans are shared; by default the truth.
    """
    plant = grow(species, seed, 0, USUAL_DISTANCE, truth)
    seen = scan(species, seed, looks or truth, preset)
    model = build_plant(seen.skeleton, seen.stem, seen.flowers, seen.cloud, PRIORS[species])
    return Known(plant, seen, model, *matched(seen.flowers.positions, plant.flower_position))


@lru_cache(maxsize=4)
def scan(species: Crop, seed: int, truth: Truth, preset: str) -> Seen:
    """Return what perception makes of a plant of this truth."""
    views = views_at(USUAL_DISTANCE, PRESETS[preset])
    plant = grow(species, seed, 0, USUAL_DISTANCE, truth)
    sight = in_wind(plant, Scene.of_plant(plant), views, truth)
    return perceive(photograph(sight, views.joints, seed, truth=truth)[0], layout(USUAL_DISTANCE).workspace)


def perceive(capture: Capture, workspace: Box) -> Seen:
    """Return what the pipeline sees."""
    return pipeline.perceive(capture, workspace, Memory(Path()), pipeline.Params())


def matched(seen: Array, true: Array) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return which seen flowers are which true ones."""
    apart = np.linalg.norm(seen[:, None] - true[None], axis=2).reshape(len(seen), len(true))
    i, j = linear_sum_assignment(apart)
    near = apart[i, j] < NEAR
    return i[near], j[near]


def stem_points(plant: SimPlant, shares: Sequence[float]) -> Array:
    """Return (G, 3) points on the main stem at shares of its length."""
    points, _, arc = plant.stem_centreline()
    return interpolate(np.multiply(shares, arc[-1]), arc, points)


def filmed(
    plant: SimPlant,
    shapes: Sequence[Array],
    times: Array,
    rng: np.random.Generator,
    errors: CameraErrors | None = None,
) -> list[Frame]:
    """Return what the trial's side camera sees of a plant in these shapes (Nv, 3) [m] at times (T,) [s]."""
    scene, pose = Scene.of_plant(plant), layout(USUAL_DISTANCE).T_world_side_camera
    return [
        sensed(scene.moved(shape).render(SIDE, pose), float(time), SIDE, stream, errors or CameraErrors())
        for shape, time, stream in zip(shapes, times, rng.spawn(len(times)), strict=True)
    ]


def shake_of(point: Array, frequency: float, amplitude: float, predicted: Array, pads: Pads) -> ShakePlan:
    """Return the plan of a shake along `DIRECTION`, as far as learning looks at it."""
    facts = {"direction": DIRECTION, "amplitude": amplitude, "frequency": frequency, "pads": pads}
    return cast(ShakePlan, SimpleNamespace(grasp=SimpleNamespace(point=point), predicted_amplitude=predicted, **facts))


def observed(
    shake: ShakePlan, frames: Sequence[Frame], seen: Seen, grip: GripMeasurement, **more: Any
) -> tuple[ObservedShake, Response]:
    """Return what the side camera and the arm measured of a shake; `more` is for `measure_response`."""
    pose = layout(USUAL_DISTANCE).T_world_side_camera
    answer = measure_response(frames, SIDE, pose, seen.flowers, shake.frequency, **more)
    return ObservedShake.of(shake, answer, grip), answer
