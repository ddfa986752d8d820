"""What moved while a plant was shaken: the arm as it read itself, the plant by its model, the flowers as filmed.

T times, N rod nodes, F flowers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anther.core.geometry import Array, ComplexArray, interpolate
from anther.plant.model import PlantModel
from anther.pollination.execution import Trial
from anther.pollination.shake import ShakePlan
from anther.pollination.shake.pads import grip_rows, pad_nodes
from anther.robot.arm.model import ArmModel
from anther.rods import Drive, steady_motion
from anther.show.results import RunResults
from anther.show.run_scene import arm_of

RATE = 30.0
"""Pictures a second of play."""


@dataclass(frozen=True, slots=True, eq=False)
class Replay:
    """A shake in time.

    Attributes:
        arm: that shook.
        times: (T,) from its begin [s].
        joints: (T, J) as the arm read them [rad].
        opening: of the gripper [m].
        nodes: (T, N, 3) displacement of the plant model's nodes that follows from how the grip moved [m].
        flowers: (T, F, 3) where the camera found the flowers, world [m]; NaN where it did not.
    """

    arm: ArmModel
    times: Array
    joints: Array
    opening: float
    nodes: Array
    flowers: Array


def motion_of(results: RunResults) -> Replay | None:
    """Return what moved in a run's shake; None where nothing was shaken, or the plant's or the arm's model is gone."""
    trial, plant, shake = results.trial, results.plant, results.shaken
    if trial is None or plant is None or shake is None or len(trial.shake_times) < 10:
        return None
    arm = arm_of(results)
    if arm is None:
        return None
    begin, end = float(trial.shake_times[0]), float(trial.shake_times[-1])
    frequency = trial.steps[-1].frequencies[0] if trial.steps else shake.frequency
    times = np.arange(begin, end, 1 / max(RATE, 10 * frequency))  # a faster shake plays slower
    joints = interpolate(times, trial.shake_times, trial.measured)
    opening = float(trial.gripper[0, 0]) if len(trial.gripper) else 0.0
    return Replay(
        arm,
        times - begin,
        joints,
        opening,
        _predict_sway(arm, plant, shake, trial, times),
        _read_tracks(results, times),
    )


def _predict_sway(arm: ArmModel, plant: PlantModel, shake: ShakePlan, trial: Trial, times: Array) -> Array:
    """Return (T, N, 3) what the rods do as linear theory says, to the grip's own swing at each step's frequencies."""
    flange = arm.forward(trial.measured)
    along = (flange[:, :3, :3] @ arm.tool.T_flange_grasp[:3, 3]) @ shake.direction
    along += flange[:, :3, 3] @ shake.direction
    grip = pad_nodes(plant, grip_rows(plant, shake.grasp.point[None]), shake.pads.width)[0]
    moved = np.zeros((len(times), len(plant.rods.nodes), 3))
    ends = [step.end for step in trial.steps[:-1]] + [np.inf]
    tones = [step.frequencies for step in trial.steps] or [(shake.frequency,)]
    first = -np.inf
    for frequencies, last in zip(tones, ends, strict=True):
        now = (times >= first) & (times < last)
        swings = _swing(trial.shake_times, along, np.array(frequencies), times[now], (first, last))
        for frequency, swing in zip(frequencies, swings.T, strict=True):
            drive = Drive(int(grip[0]), shake.direction, 1.0, frequency, also=tuple(int(k) for k in grip[1:]))
            answer = steady_motion(plant.rods_at(frequency), plant.clamp, drive, springs=shake.pads.springs)
            turned = swing * np.exp(2j * np.pi * frequency * times[now])
            moved[now] += np.imag(turned[:, None, None] * answer.motion[:, :3])
        first = last
    return moved


def _swing(read: Array, along: Array, frequencies: Array, times: Array, within: tuple[float, float]) -> ComplexArray:
    """Return (T, K) phasors of the grip's motion: of one tone about each time, of several over the whole step."""

    def phasors(near: NDArray[np.bool_]) -> ComplexArray:
        phase = 2 * np.pi * read[near, None] * frequencies
        basis = np.column_stack([np.sin(phase), np.cos(phase), np.ones(near.sum())])
        parts = np.linalg.lstsq(basis, along[near], rcond=None)[0]
        return parts[: len(frequencies)] + 1j * parts[len(frequencies) : -1]

    if len(frequencies) > 1:
        return np.tile(phasors((read >= within[0]) & (read < within[1])), (len(times), 1))
    return np.array([phasors(np.abs(read - time) <= 1 / frequencies[0]) for time in times]).reshape(-1, 1)


def _read_tracks(results: RunResults, times: Array) -> Array:
    """Return (T, F, 3) the flowers' tracks at the times; NaN where they were lost, for longer than 0.12 s."""
    longest = 0.12
    response = results.response
    if response is None or not len(response.times):
        return np.full((len(times), 0, 3), np.nan)
    out = np.full((len(times), response.tracks.shape[1], 3), np.nan)
    for f in range(out.shape[1]):
        seen = np.isfinite(response.tracks[:, f]).all(axis=1)
        if seen.sum() < 2:
            continue
        when, where = response.times[seen], response.tracks[seen, f]
        after = np.clip(np.searchsorted(when, times), 1, len(when) - 1)
        near = (times >= when[0]) & (times <= when[-1]) & (when[after] - when[after - 1] <= longest)
        out[near, f] = interpolate(times[near], when, where)
    return out
