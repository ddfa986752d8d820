"""The shake: which grasp to hold, and in which direction, how fast and how far to shake it (P24).

F flowers, G grip heights, Q frequencies, D directions, M scenarios.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from anther.core.errors import StageFailure, bad_input
from anther.core.geometry import Array
from anther.plant.belief import EarlierShake
from anther.plant.model import PlantModel
from anther.pollination.grasp import Grasp
from anther.pollination.shake._actuators import VIBRATING_GRIPPER, Actuator, any_arm, arm_shaker, sawyer_limit
from anther.pollination.shake._plan import ResponseMap, RunnerUp, ShakePlan
from anther.pollination.shake.choice import (
    Place,
    Search,
    best,
    closest,
    find_candidates,
    find_grips,
    limit_rows,
    match_earlier,
    predicted_at,
    search,
    worth_curve_at,
)
from anther.pollination.shake.pads import PADS, Pads
from anther.pollination.shake.params import MOST_DURATION, Params, with_preset
from anther.pollination.shake.search import gains, scenarios
from anther.robot.pressing import PRESSING, Pressing

__all__ = [
    "PADS", "VIBRATING_GRIPPER", "Actuator", "Pads", "Params", "ResponseMap", "RunnerUp", "ShakePlan", "any_arm",
    "arm_shaker", "moved_plan", "plan_shake", "sawyer_limit", "with_preset",
]  # fmt: skip


SAWYER, DEFAULTS = arm_shaker(), Params()

DRAWS = 6
"""Scenarios drawn from the material's spread, beside the best guess: quasi-random ones, few of which cover it."""


def plan_shake(
    plant: PlantModel,
    grasps: Sequence[Grasp],
    actuator: Actuator = SAWYER,
    params: Params = DEFAULTS,
    pressing: Pressing = PRESSING,
    earlier: EarlierShake | None = None,
) -> ShakePlan:
    """Choose grasp, direction, frequency and amplitude, and predict what every flower will do.

    Linear theory (complex tree solves about the gravity equilibrium) gives the response of every flower and the load of
    every organ to a shake of one metre at every grip, direction and frequency, for the plant as believed and for
    `DRAWS` scenarios drawn from the spread of its material. Each shake is as large as it is worth most
    (`anther.pollination.decision`: the fruit it should add, less what it should cost). The prediction is the median of
    what is expected by the scenarios, the model's errors and what the actuator delivers, whose spread is the interval.

    Args:
        plant: from `build_plant`.
        grasps: ranked grasps.
        actuator: what shakes the grip.
        params: limits and search.
        pressing: what gripper and stem bear; a shake that needs more is made smaller.
        earlier: an earlier visit's shake of this plant; where it can be done again, a watched shake begins with its
            frequency alone, and larger.

    Raises:
        InputError: the frequencies asked for are outside the actuator's band.
        StageFailure: "no_flowers_found"; "no_grasp_found" when there is no grasp; "limits_exceeded" when no shake is
            worth its cost.
    """
    if not len(plant.flower_nodes):
        raise StageFailure("no_flowers_found", "no flower was found, so there is nothing to shake for.")
    if not grasps:
        raise StageFailure("no_grasp_found", "no grasp to choose from: the shake needs at least one.")
    grips = find_grips(plant, grasps, params, pressing, closing=actuator.closing)
    frequencies = _frequencies(actuator, params)
    response = gains(scenarios(plant, DRAWS, pads=params.pads), grips.nodes, grips.directions, frequencies)
    found = search(response, grips, grasps, frequencies, actuator, params)
    if not np.any(found.score >= 0):
        raise _nothing_allowed(found, len(grasps), actuator)
    again = None if earlier is None else match_earlier(found, earlier)
    found, earlier = (found, None) if again is None else (again, earlier)
    at, notes = best(found), plant.notes
    if earlier is not None:
        begins = f"{1e3 * earlier.amplitude:.2g} mm at {earlier.frequency:.3g} Hz"
        notes += (f"shake: begins as an earlier visit ended, {begins}.",)
    q, g, d = at
    frequency, (amplitude, spread) = float(frequencies[q]), predicted_at(found, at)
    duration, omega2 = params.lasts(frequency), (2 * np.pi * frequency) ** 2
    plan = ShakePlan(
        grasp_index=g,
        grasp=grasps[g],
        direction=grips.directions[g, d],
        amplitude=float(found.amplitude[at]),
        frequency=frequency,
        duration=duration,
        press=float(grips.press[g, 0]),
        predicted_amplitude=amplitude,
        predicted_amplitude_interval=amplitude[:, None] * spread,
        predicted_acceleration=omega2 * amplitude,
        predicted_acceleration_interval=omega2 * amplitude[:, None] * spread,
        score=float(found.score[at]),
        limits=(*limit_rows(found, at), ("duration [s]", duration, MOST_DURATION, duration / MOST_DURATION)),
        runner_up=_runner_up(found, at),
        regret=tuple((measure, float(values[at])) for measure, values in found.regret.items()),
        reason="",
        response_map=_map(found, len(grasps)),
        tones=find_candidates(found, at, actuator.tones, earlier),
        pads=params.pads,
        weighed=worth_curve_at(found, at, params),
        notes=notes,
    )
    return replace(plan, reason=_reason(plan, kept=params.keeps_limits))


_PREDICTED = (
    "predicted_amplitude",
    "predicted_amplitude_interval",
    "predicted_acceleration",
    "predicted_acceleration_interval",
)


def moved_plan(plan: ShakePlan, T: Array, grasps: Sequence[Grasp], actuator: Actuator) -> ShakePlan | None:
    """Return a plan made before its plant was moved by T (4, 4), at the same grasp; None: plan anew.

    A plant answers alike wherever it stands; what the actuator can do there is asked again. Reason, score and limits
    stay those of the plan as it was made.

    Args:
        plan: for the plant where it was.
        T: a turn about a vertical axis, or one too small for gravity to matter, and any shift.
        grasps: ranked, where the plant is; that of the plan is known by its height.
        actuator: what shakes the grip.
    """
    index = next((i for i, one in enumerate(grasps) if one.arc_length == plan.grasp.arc_length), None)
    if index is None:
        return None
    grasp, lines, tones = grasps[index], plan.tones.directions @ T[:3, :3].T, plan.tones
    able = np.stack([actuator.amplitude(grasp, line, tones.frequencies) for line in lines], axis=1)
    reach = np.minimum(tones.reach, able)
    amplitude, enough = min(plan.amplitude, float(reach[0, 0])), 0.8  # of what was planned: with less another is better
    if amplitude < enough * plan.amplitude:
        return None
    moved = {name: amplitude / plan.amplitude * getattr(plan, name) for name in _PREDICTED}
    tones = replace(tones, directions=lines, amplitudes=np.minimum(tones.amplitudes, reach), reach=reach)
    changed = {"grasp_index": index, "grasp": grasp, "direction": lines[0], "amplitude": amplitude, "tones": tones}
    return replace(plan, **changed, **moved)


def _frequencies(actuator: Actuator, params: Params) -> Array:
    lowest = max(actuator.lowest, params.lowest or 0)
    highest = min(actuator.highest, params.highest or np.inf)
    if lowest > highest:
        asked = f"{params.lowest or actuator.lowest:g} to {params.highest or actuator.highest:g} Hz"
        band = f"frequencies within {actuator.lowest:g} to {actuator.highest:g} Hz, the band of the {actuator.name}"
        raise bad_input("frequencies", given=asked, allowed=band, do="Change lowest or highest.")
    return np.geomspace(lowest, highest, params.frequencies if lowest < highest else 1)


def _nothing_allowed(found: Search, grasps: int, actuator: Actuator) -> StageFailure:
    """Say how far from allowed the nearest shake is, and by which limit."""
    size = found.amplitude[:, :grasps]
    q, g, d = np.unravel_index(int(np.argmax(size)), size.shape)
    at = (int(q), int(g), int(d))
    return StageFailure(
        "limits_exceeded",
        f"no shake of {1e3 * found.least:.2g} mm or more is worth its cost at any grasp, direction and frequency of the"
        f" {actuator.name}; the nearest is {1e3 * float(size[at]):.2g} mm at {found.frequencies[q]:.3g} Hz. "
        f"{closest(limit_rows(found, at))} Allow a smaller least_amplitude, or another grasp.",
    )


def _runner_up(found: Search, at: Place) -> RunnerUp | None:
    other = best(found, avoid=at)
    if found.score[other] <= 0 or other == at:
        return None
    q, g, _ = other
    return RunnerUp(g, float(found.frequencies[q]), float(found.amplitude[other]), float(found.score[other]))


def _reason(plan: ShakePlan, *, kept: bool) -> str:
    text = (
        f"Held {100 * plan.grasp.arc_length:.0f} cm up the stem with {plan.press:.2g} N and shaken"
        f" {1e3 * plan.amplitude:.2g} mm at {plan.frequency:.3g} Hz, the flowers should move"
        f" {1e3 * np.median(plan.predicted_amplitude):.2g} mm (median) with"
        f" {np.median(plan.predicted_acceleration):.3g} m/s². Of all grasps, directions"
        f" and frequencies compared this is worth most: {plan.score:.2g} of all flowers' pollen, less what may be lost,"
        f" over {DRAWS} further drawings of the plant's stiffness and damping. {closest(plan.limits[:-1], kept=kept)}"
    )
    least = 0.05  # so much more must another shake be worth for a measure of motion to be named
    for measure, regret in plan.regret:
        if regret > least:
            text += f" If {measure} alone frees pollen, another shake would be worth {regret:.2g} more."
    other = plan.runner_up
    if other is None:
        return text
    return text + (
        f" Runner-up: grasp {other.grasp_index + 1} at {other.frequency:.3g} Hz with"
        f" {1e3 * other.amplitude:.2g} mm ({other.score:.3g})."
    )


def _map(found: Search, grasps: int) -> ResponseMap:
    """Return the best direction's response at the map's heights."""
    rows = np.arange(grasps, len(found.grips.nodes))
    mean = found.flower.mean(axis=(0, -1))[:, rows]
    size = found.amplitude[:, rows]
    acceleration = np.where(size < found.least, 0, mean * size * (2 * np.pi * found.frequencies[:, None, None]) ** 2)
    at = acceleration.argmax(axis=2)[..., None]
    pick = [np.take_along_axis(values, at, axis=2)[..., 0].T for values in (acceleration, mean, size)]
    return ResponseMap(found.frequencies, found.grips.arc_length[rows], *pick)
