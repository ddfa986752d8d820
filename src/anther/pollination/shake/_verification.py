"""The chosen shake in the nonlinear solver: what every flower does, and whether a limit of the plant is passed.

F flowers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from anther.core.errors import StageFailure
from anther.plant.limits import PEAKS
from anther.plant.model import PlantModel
from anther.pollination.decision import believed, interval
from anther.pollination.shake._plan import LimitRow
from anther.pollination.shake.choice import Place, Search, best, closest, limit_rows
from anther.pollination.shake.observables import Observables, observables, semi_major
from anther.pollination.shake.params import MOST_DURATION, Params
from anther.rods import (
    RIGID,
    Array,
    Drive,
    Rocking,
    Springs,
    Trajectory,
    simulate,
    steady_motion,
    strain_changes,
)

CHECKED, NEAR = 4, 0.1
"""So many shakes are simulated until the best holds the limits; those within 10 % of a cut one's frequency count as
cut."""

TRIES = 3
"""How often a shake that passes a limit is made smaller and simulated again."""

STEPS, PERIODS = 24, 3
"""Steps a period of the simulation, and periods, of which the last counts."""

TOLERANCE = 1e-5
"""Accepted residual force [N], a hundredth of a flower's weight; 1e-9 changes no result by 1e-5 of itself."""


class Checked(NamedTuple):
    """A shake after the nonlinear solver has seen it."""

    shake: Drive
    amplitude: Array  # (F,) median of what is expected [m]
    nonlinear: Array  # (F,) amplitude by the nonlinear solver over that of linear theory
    spread: Array  # (F, 2) of which 5 % lie below and above, over that
    limits: list[LimitRow]
    notes: tuple[str, ...]


def best_that_holds(plant: PlantModel, found: Search, params: Params) -> tuple[Search, Place, Checked]:
    """Return the best shake as the nonlinear solver leaves it, and the search with the scores of those it cut.

    What is cut loses its score in proportion, and so do its neighbours in frequency, which would be cut alike.

    Raises:
        StageFailure: "limits_exceeded".
    """
    linear, refused = found.score, ""
    found = found._replace(score=linear.copy())
    checked: dict[Place, tuple[float, Checked]] = {}
    for _ in range(CHECKED):
        at = best(found)
        if found.score[at] < 0 or at in checked:
            break
        done = check(plant, found, at, params)
        alike = (np.abs(np.log(found.frequencies / found.frequencies[at[0]])) < NEAR, at[1])
        if done.shake.amplitude < found.least:
            refused, found.score[alike] = closest(done.limits), -1
        else:
            kept = done.shake.amplitude / found.amplitude[at]
            checked[at] = float(linear[at] * kept), done
            found.score[alike] = np.minimum(found.score[alike], linear[alike] * kept)
        for place, (score, _) in checked.items():
            found.score[place] = score
    if checked:
        at = max(checked, key=lambda place: checked[place][0])
        return found, at, checked[at][1]
    raise StageFailure(
        "limits_exceeded",
        f"the best shakes pass a limit in the nonlinear solver unless they are below {1e3 * found.least:.2g} mm. "
        f"{refused} Allow a smaller least_amplitude, or another grasp.",
    )


def check(plant: PlantModel, found: Search, at: Place, params: Params) -> Checked:
    """Simulate one shake of the search, and put together what linear theory and the simulation say of it."""
    q, g, d = at
    held, *also = (int(node) for node in found.grips.nodes[g])
    size = float(found.amplitude[at])
    shake = Drive(held, found.grips.directions[g, d], size, float(found.frequencies[q]), 0, tuple(also))
    gain = found.flower[:, q, g, d]  # (M, F)
    done = Shaken(size * gain[0], {})
    try:
        limits = checked_limits(found, at, params)
        shake, done, notes = verified(plant, shake, limits, found.least, springs=params.pads.springs)
    except StageFailure as failure:
        notes = (f"shake: not verified by the nonlinear solver, prediction is linear ({failure})",)
    expected = shake.amplitude * gain[0]
    largest = float(np.max(np.abs(done.amplitude - expected) / np.maximum(expected, 1e-9)))
    if largest > 0.25:
        notes += (f"shake: a flower's nonlinear amplitude differs from the linear one by {100 * largest:.0f} %.",)
    shift, wrong = (float(part[q, 0, 0]) for part in found.delivered)
    omega2 = (2 * np.pi * shake.frequency) ** 2
    logs, doubt = believed("flowers", omega2 * gain, shake.frequency)
    over = np.exp(shift + logs.mean(axis=0)) / np.maximum(omega2 * gain[0], 1e-12)
    spread = interval(logs, np.hypot(doubt, wrong))
    limits = _limits(found, at, shake, done, params.lasts(shake.frequency))
    nonlinear = done.amplitude / np.maximum(expected, 1e-12)
    return Checked(shake, over * done.amplitude, nonlinear, spread, limits, notes)


MORE = 1.1
"""Nonlinear loads up to so many times those of linear theory are as they were weighed."""


def checked_limits(found: Search, at: Place, params: Params) -> dict[str, float]:
    """Return by name what `PEAKS` may reach for the plant as believed: what they were weighed with, or may be."""
    if not params.keeps_limits:
        return dict.fromkeys(PEAKS.values(), np.inf)
    allowed = {}
    for name in PEAKS.values():
        one = found.bounds[name]
        limit = float(np.broadcast_to(one.limit, one.value.shape)[at]) / one.over(at)
        allowed[name] = max(limit, MORE * float(found.amplitude[at] * one.believed[at]))
    return allowed


def _limits(found: Search, at: Place, shake: Drive, done: Shaken, duration: float) -> list[LimitRow]:
    """Return the table of limits: of the plant, what is expected.

    Where the nonlinear solver says more than linear theory of the plant as believed, it is more by that.
    """
    scale = shake.amplitude / found.amplitude[at]
    rows: list[LimitRow] = []
    for name, value, limit, _ in limit_rows(found, at):
        reached = max(value * scale, done.peaks.get(name, 0.0) * found.bounds[name].over(at))
        rows.append((name, reached, limit, reached / limit))
    return [*rows, ("duration [s]", duration, MOST_DURATION, duration / MOST_DURATION)]


class Shaken(NamedTuple):
    """What the nonlinear solver says.

    Attributes:
        amplitude: (F,) of each flower, the semi-major axis in steady shaking [m].
        peaks: largest value of each limited quantity over the time, by the limits' names.
    """

    amplitude: Array
    peaks: dict[str, float]


def verified(
    plant: PlantModel, shake: Drive, limits: Mapping[str, float], least: float = 0.0, *, springs: Springs = RIGID
) -> tuple[Drive, Shaken, tuple[str, ...]]:
    """Return the shake, made smaller where the nonlinear solver says a limit is passed, what it does, and notes.

    Args:
        plant: as believed.
        shake: chosen by linear theory, without a ramp.
        limits: largest value allowed of each of `PEAKS`, by name.
        least: a shake that must be smaller than this is of no use and not simulated any more [m].
        springs: between gripper and pads.

    Raises:
        StageFailure: "no_convergence".
    """
    asked, binding = shake.amplitude, ""
    done = steadily_shaken(plant, shake, springs)
    for _ in range(TRIES):
        name, worst = max(((n, done.peaks[n] / limit) for n, limit in limits.items()), key=lambda row: row[1])
        if worst <= 1:
            break
        binding, shake = name, replace(shake, amplitude=0.98 * shake.amplitude / worst)
        if shake.amplitude < least:
            break
        done = steadily_shaken(plant, shake, springs)
    if not binding:
        return shake, done, ()
    less = f"{1e3 * asked:.3g} to {1e3 * shake.amplitude:.3g} mm"
    passed = binding.removesuffix(" [-]")
    return shake, done, (f"shake: made smaller, from {less}, because the nonlinear solver passes a limit ({passed}).",)


def steadily_shaken(plant: PlantModel, drive: Drive, springs: Springs = RIGID) -> Shaken:
    """Return what the plant does in steady sinusoidal shaking.

    The simulation begins in the steady state of linear theory, so that only what is not linear has to settle. Its last
    period counts: three harmonics and what still drifts are fitted to it. The midpoint rule at step h does at a
    frequency f what the rods do at tan(pi f h) / (pi h) (the bilinear transform); h is such that this is the drive's
    frequency, and 24 steps a period are enough. Against 24 periods of 120 steps, begun slowly, amplitudes and peaks of
    seven development plants agree within 2.2 %.
    """
    dt = float(np.tan(np.pi / STEPS) / (np.pi * drive.frequency))
    omega, rods = 2 * np.pi * drive.frequency, plant.rods_at(drive.frequency)
    linear = steady_motion(rods, plant.clamp, drive, springs=springs)
    rocking = Rocking(drive.node, drive.also, linear.pads[:3], linear.pads[3:], 1 / (STEPS * dt))
    path = simulate(
        rods,
        plant.clamp,
        rocking,
        PERIODS * STEPS * dt,
        dt,
        start="scanned",
        tolerance=TOLERANCE,
        moving=(linear.motion.imag, omega * linear.motion.real),
    )
    seen = observables(plant)
    turned = rocking.rotation(path.times) + linear.pads[3:].imag
    vectors = _vectors(plant, seen, path, drive.node, turned)[-STEPS - 1 :]
    angle, order = 2 * np.pi * (np.arange(STEPS + 1) / STEPS - 0.5), np.array([1, 2, 3])
    phase = order * angle[:, None]
    basis = np.concatenate([np.ones((STEPS + 1, 1)), angle[:, None], np.cos(phase), np.sin(phase)], axis=1)
    parts = np.linalg.lstsq(basis, vectors.reshape(STEPS + 1, -1), rcond=None)[0].reshape(-1, *vectors.shape[1:])
    jolts = np.tensordot(basis[:, 2:] * -np.tile((order * omega) ** 2, 2), parts[2:], axes=1)
    amplitude = semi_major(parts[2] - 1j * parts[5])[seen.flowers]
    return Shaken(amplitude, _peaks(seen, vectors, jolts))


def _vectors(plant: PlantModel, seen: Observables, path: Trajectory, held: int, turned: Array) -> Array:
    """Return (T, K, 3) the observed vectors over time; what flowers do relative to the pads has the material's gain.

    The pads have the place of the node `held`, and the rotation vectors `turned` (T, 3) from rest. Strains are those of
    the simulated state itself, frames and all, with the moments of the linear theory's measure.
    """
    moved = np.zeros((*path.positions.shape[:2], 4))
    moved[..., :3] = path.positions - plant.rods.nodes
    strains = strain_changes(plant.rods, path.positions, path.directors, plant.clamp.planted)
    vectors, bent = (
        (operator @ of.reshape(len(of), -1).T).T.reshape(len(of), -1, 3)
        for operator, of in ((seen.operator, moved), (seen.bending, strains))
    )
    vectors[:, seen.strains] = bent
    lever = plant.rods.nodes[plant.flower_nodes] - plant.rods.nodes[held]
    carried = moved[:, held, None, :3] + np.cross(turned[:, None], lever)
    vectors[:, seen.flowers] = carried + plant.material.response_gain * (vectors[:, seen.flowers] - carried)
    return vectors


def _peaks(seen: Observables, vectors: Array, jolts: Array) -> dict[str, float]:
    """Return the largest values over the time, of strains and, from second derivatives, of the load of leaf bases."""
    peaks = {}
    for kind, name in PEAKS.items():
        moved = jolts if kind == "leaf_load" else vectors
        peaks[name] = float(np.linalg.norm(moved[:, getattr(seen, kind)], axis=2).max(initial=0.0))
    return peaks
