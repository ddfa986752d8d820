"""The shake: which grasp to hold, and in which direction, how fast and how far to shake it (P24).

F flowers, G grip heights, Q frequencies, D directions, M scenarios.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from anther.elastic_rod import Drive
from anther.errors import StageFailure, bad_input
from anther.geometry import Array
from anther.grasp import Grasp
from anther.plant import PlantModel
from anther.pressing import PRESSING, Pressing
from anther.shake._actuators import Actuator, ActuatorName, ArmShaker, VibratingGripper
from anther.shake._breeze import Crop, like_breeze
from anther.shake._limits import sawyer_limit
from anther.shake._plan import EarlierShake, LimitRow, ResponseMap, RunnerUp, ShakePlan
from anther.shake._verification import Shaken, verified
from anther.shake.choice import (
    Grips,
    Place,
    Search,
    as_earlier,
    best,
    checked_limits,
    closest,
    grips_of,
    limit_rows,
    press,
    search,
    tones_at,
)
from anther.shake.pads import PADS, Pads
from anther.shake.params import FLOWER_SPREAD, MOST_DURATION, Objective, Params, Preset, with_preset
from anther.shake.plant_limits import PRESETS, PlantLimits
from anther.shake.search import Gains, gains, scenarios

__all__ = [
    "PADS", "PRESETS", "Actuator", "ActuatorName", "ArmShaker", "Crop", "EarlierShake", "Objective", "Pads", "Params",
    "PlantLimits", "Preset", "ResponseMap", "RunnerUp", "ShakePlan", "VibratingGripper", "like_breeze", "plan_shake",
    "sawyer_limit", "with_preset",
]  # fmt: skip


SAWYER, DEFAULTS = ArmShaker(), Params()

CHECKED, NEAR = 4, 0.1
"""So many shakes are simulated until the best holds the limits; those within 10 % of a cut one's frequency count as
cut."""


def plan_shake(
    plant: PlantModel,
    grasps: Sequence[Grasp],
    actuator: Actuator = SAWYER,
    params: Params = DEFAULTS,
    pressing: Pressing = PRESSING,
    earlier: EarlierShake | None = None,
) -> ShakePlan:
    """Choose grasp, direction, frequency and amplitude, and predict what every flower will do.

    Linear theory (complex tree solves about the gravity equilibrium) gives the response of every flower to a shake of
    one metre at every grip, direction and frequency, for the plant as believed and for `Params.draws` scenarios drawn
    from the spread of its material. Each shake is as large as actuator and plant allow, with the one margin that
    `Params.risk` states; it is ranked by what three flowers of four feel in them. The winner is checked by the
    nonlinear solver, whose amplitudes are the prediction, and made smaller where that says a limit is passed; the
    interval is that of the scenarios, widened by how far one flower differs from its plant.

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
            allowed; "no_convergence" when the plant cannot be simulated.
    """
    if not len(plant.flower_nodes):
        raise StageFailure("no_flowers_found", "no flower was found, so there is nothing to shake for.")
    if not grasps:
        raise StageFailure("no_grasp_found", "no grasp to choose from: the shake needs at least one.")
    grips, frequencies = grips_of(plant, grasps, params, pressing, actuator.axis), _frequencies(actuator, params)
    versions = scenarios(plant, params.draws, pads=params.pads)
    response = gains(versions, grips.nodes, grips.directions, frequencies)
    least = actuator.least_amplitude if params.least_amplitude is None else params.least_amplitude
    found = search(response, grips, grasps, frequencies, actuator=actuator, least=least, params=params)
    if not np.any(found.score[:, : len(grasps)] >= 0):
        raise _nothing_allowed(found, len(grasps), least, actuator)
    again = None if earlier is None else as_earlier(found, grips, len(grasps), earlier)
    found, earlier = (found, None) if again is None else (again, earlier)
    found, at, done = _best_that_holds(plant, grips, response, found, len(grasps), least, params)
    other = _runner_up(found, at, len(grasps))
    q, g, d = at
    score = float(found.score[at])
    return ShakePlan(
        grasp_index=g,
        grasp=grasps[g],
        direction=grips.directions[g, d],
        amplitude=done.shake.amplitude,
        frequency=done.shake.frequency,
        duration=float(found.duration[q]),
        press=press(done.limits, params.least_press),
        predicted_amplitude=done.amplitude,
        predicted_amplitude_interval=done.amplitude[:, None] * done.spread,
        predicted_acceleration=done.acceleration,
        predicted_acceleration_interval=done.acceleration[:, None] * done.spread,
        score=score,
        limits=done.limits,
        runner_up=other,
        reason=_reason(done, other, float(grips.arc_length[g]), score, params),
        response_map=_map(grips, response, found, len(grasps), least),
        tones=tones_at(found, grips, response, at, least, actuator.tones, earlier),
        pads=params.pads,
        notes=plant.notes + done.notes + _remembered(earlier),
    )


def _remembered(earlier: EarlierShake | None) -> tuple[str, ...]:
    if earlier is None:
        return ()
    return (
        f"shake: begins as an earlier visit ended, {1e3 * earlier.amplitude:.2g} mm at {earlier.frequency:.3g} Hz.",
    )


def _frequencies(actuator: Actuator, params: Params) -> Array:
    lowest = max(actuator.lowest, params.lowest or 0)
    highest = min(actuator.highest, params.highest or np.inf)
    if lowest > highest:
        asked = f"{params.lowest or actuator.lowest:g} to {params.highest or actuator.highest:g} Hz"
        band = f"frequencies within {actuator.lowest:g} to {actuator.highest:g} Hz, the band of the {actuator.name}"
        raise bad_input("frequencies", given=asked, allowed=band, do="Change lowest or highest.")
    return np.geomspace(lowest, highest, params.frequencies if lowest < highest else 1)


def _nothing_allowed(found: Search, grasps: int, least: float, actuator: Actuator) -> StageFailure:
    """Say how far from allowed the nearest shake is, and by which limit."""
    size = found.amplitude[:, :grasps]
    q, g, d = np.unravel_index(int(np.argmax(size)), size.shape)
    at = (int(q), int(g), int(d))
    return StageFailure(
        "limits_exceeded",
        f"no shake of {1e3 * least:.2g} mm or more is allowed at any grasp, direction and frequency of the"
        f" {actuator.name}; the largest is {1e3 * float(size[at]):.2g} mm at {found.frequencies[q]:.3g} Hz. "
        f"{closest(limit_rows(found, at))} Allow a smaller least_amplitude, or another grasp.",
    )


class _Checked(NamedTuple):
    """A shake after the nonlinear solver has seen it."""

    shake: Drive
    amplitude: Array  # (F,) [m]
    acceleration: Array  # (F,) [m/s2]
    spread: Array  # (F, 2) over the scenarios, relative
    limits: list[LimitRow]
    notes: tuple[str, ...]


def _best_that_holds(
    plant: PlantModel, grips: Grips, response: Gains, found: Search, grasps: int, least: float, params: Params
) -> tuple[Search, Place, _Checked]:
    """Return the best shake as the nonlinear solver leaves it, and the search with the scores of those it cut.

    What is cut loses its score in proportion, and so do its neighbours in frequency, which would be cut alike.
    """
    linear, refused = found.score, ""
    found = found._replace(score=linear.copy())
    checked: dict[Place, tuple[float, _Checked]] = {}
    for _ in range(CHECKED):
        at = best(found, np.arange(grasps))
        if found.score[at] < 0 or at in checked:
            break
        done = _check(plant, grips, response, found, at, least, params)
        kept = done.shake.amplitude / found.amplitude[at]
        near = np.abs(np.log(found.frequencies / found.frequencies[at[0]])) < NEAR
        if done.shake.amplitude < least:
            refused, kept = closest(done.limits), -np.inf
        else:
            checked[at] = float(linear[at] * kept), done
        alike = (near, at[1])
        found.score[alike] = np.minimum(found.score[alike], np.maximum(linear[alike] * kept, -1))
        for place, (score, _) in checked.items():
            found.score[place] = score
    if checked:
        at = max(checked, key=lambda place: checked[place][0])
        return found, at, checked[at][1]
    raise StageFailure(
        "limits_exceeded",
        f"the best shakes pass a limit in the nonlinear solver unless they are below {1e3 * least:.2g} mm. {refused} "
        "Allow a smaller least_amplitude, or another grasp.",
    )


def _check(
    plant: PlantModel, grips: Grips, response: Gains, found: Search, at: Place, least: float, params: Params
) -> _Checked:
    """Simulate one shake of the search, and put together what linear theory and the simulation say of it."""
    q, g, d = at
    held, *also = (int(node) for node in grips.nodes[g])
    size, frequency = float(found.amplitude[at]), float(found.frequencies[q])
    asked = Drive(held, grips.directions[g, d], size, frequency, 0, tuple(also))
    gain = response.flower[:, q, g, d]  # (M, F)
    linear = Shaken(size * gain[0], size * (2 * np.pi * frequency) ** 2 * gain[0], {})
    shake, done, notes = _verified(plant, asked, linear, least, checked_limits(found, at, params), params)
    span = np.quantile(gain, [0.05, 0.95], axis=0) / np.maximum(gain[0], 1e-12)
    spread = np.stack([np.minimum(span[0], 1), np.maximum(span[1], 1)], axis=1)
    spread = np.exp([-1, 1] * np.hypot(np.log(np.maximum(spread, 1e-6)), 1.645 * FLOWER_SPREAD))
    return _Checked(shake, done.amplitude, done.acceleration, spread, _limits(found, at, shake, done), notes)


def _verified(
    plant: PlantModel, asked: Drive, linear: Shaken, least: float, limits: dict[str, float], params: Params
) -> tuple[Drive, Shaken, tuple[str, ...]]:
    """Return the shake and what it does by the nonlinear solver, and what the user should know about it."""
    try:
        shake, done, notes = verified(plant, asked, limits, least, springs=params.pads.springs)
    except StageFailure as failure:
        return asked, linear, (f"shake: not verified by the nonlinear solver, prediction is linear ({failure})",)
    expected = linear.amplitude * shake.amplitude / asked.amplitude
    largest = float(np.max(np.abs(done.amplitude - expected) / np.maximum(expected, 1e-9)))
    if largest > 0.25:
        notes += (f"shake: a flower's nonlinear amplitude differs from the linear one by {100 * largest:.0f} %.",)
    return shake, done, notes


def _limits(found: Search, at: Place, shake: Drive, done: Shaken) -> list[LimitRow]:
    """Return the table of limits: of the plant, what its loads pass with the probability `Params.risk`.

    Where the nonlinear solver says more than linear theory of the plant as believed, it is more by that.
    """
    scale = shake.amplitude / found.amplitude[at]
    rows: list[LimitRow] = []
    for name, value, limit, _ in limit_rows(found, at):
        believed = float(found.amplitude[at] * found.believed[name][at]) * scale
        more = max(done.peaks.get(name, 0.0) / believed, 1.0) if believed > 0 else 1.0
        rows.append((name, value * scale * more, limit, value * scale * more / limit))
    duration = float(found.duration[at[0]])
    return [*rows, ("duration [s]", duration, MOST_DURATION, duration / MOST_DURATION)]


def _runner_up(found: Search, at: Place, grasps: int) -> RunnerUp | None:
    other = best(found, np.arange(grasps), avoid=at)
    if found.score[other] <= 0 or other == at:
        return None
    q, g, _ = other
    return RunnerUp(g, float(found.frequencies[q]), float(found.amplitude[other]), float(found.score[other]))


def _reason(done: _Checked, other: RunnerUp | None, arc_length: float, score: float, params: Params) -> str:
    shake = done.shake
    if params.objective == "amplitude":
        goal = f"the highest mean flower amplitude ({1e3 * score:.3g} mm)"
    else:
        goal = f"the most that three flowers of four should feel ({score:.3g} m/s2)"
    text = (
        f"Held {100 * arc_length:.0f} cm up the stem with {press(done.limits, params.least_press):.2g} N and shaken"
        f" {1e3 * shake.amplitude:.2g} mm at {shake.frequency:.3g} Hz, the flowers should move"
        f" {1e3 * np.median(done.amplitude):.2g} mm (median)"
        f" with {np.median(done.acceleration):.3g} m/s2. Of all grasps, directions and frequencies compared"
        f" this gives {goal}, over {params.draws} further drawings of the plant's stiffness and damping."
        f" {closest(done.limits[:-1], kept=params.keeps_limits)}"
    )
    if other is None:
        return text
    return text + (
        f" Runner-up: grasp {other.grasp_index + 1} at {other.frequency:.3g} Hz with"
        f" {1e3 * other.amplitude:.2g} mm ({other.score:.3g})."
    )


def _map(grips: Grips, response: Gains, found: Search, grasps: int, least: float) -> ResponseMap:
    """Return the best direction's response at the map's heights, else at the grasps."""
    rows = np.arange(grasps, len(grips.nodes)) if len(grips.nodes) > grasps else np.arange(grasps)
    rows = rows[np.argsort(grips.arc_length[rows], kind="stable")]
    mean = response.flower.mean(axis=(0, -1))[:, rows]
    size = found.amplitude[:, rows]
    acceleration = np.where(size < least, 0, mean * size * (2 * np.pi * found.frequencies[:, None, None]) ** 2)
    at = acceleration.argmax(axis=2)[..., None]
    pick = [np.take_along_axis(values, at, axis=2)[..., 0].T for values in (acceleration, mean, size)]
    return ResponseMap(found.frequencies, grips.arc_length[rows], *pick)
