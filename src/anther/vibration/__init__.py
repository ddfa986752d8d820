"""Vibration: which grasp to hold, and in which direction, how fast and how far to shake it (P24).

F flowers, G grip heights, Q frequencies, D directions, M scenarios.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.checks import check_range
from anther.elastic_rod.motion import Drive
from anther.elastic_rod.simulation import simulate
from anther.errors import StageFailure, bad_input
from anther.geometry import Array
from anther.grasp import Grasp
from anther.plant import PlantModel
from anther.vibration.limits import ArmLimit, pollen_dose, sawyer_limit
from anther.vibration.observables import semi_major
from anther.vibration.search import Gains, gains, grip_rows, pad_nodes, scenarios
from anther.vibration.shake_plan import ResponseMap, RunnerUp, ShakePlan

__all__ = ["Params", "ResponseMap", "RunnerUp", "ShakePlan", "plan_shake", "sawyer_limit"]


@dataclass(frozen=True, slots=True)
class Params:
    """What to look for and what must not be passed.

    The plant's limits are proposals, to be tuned (facts: pollination 1d); no measured abscission acceleration exists.

    Attributes:
        objective: "dose": mean pollen dose of the flowers (`pollen_dose`); "amplitude": mean flower amplitude, as in
            the paper.
        half_dose: acceleration that frees half of a flower's pollen [m/s2].
        lowest, highest: frequencies searched [Hz].
        frequencies: how many, evenly on a logarithmic scale.
        directions: how many, over half a turn of the horizontal plane.
        heights: grip heights of the response map, beside the grasps.
        draws: scenarios drawn from the material's spread, beside the best guess.
        caution: quantile over the scenarios at which the plant's limits must hold [-].
        seed: of the draws.
        arm_share: share of the arm's limit that is used [-].
        plant_share: share of the plant's limits that is used [-]: the best models of shaken plants err by some tens of
            per cent (facts: pollination 4), and passing a limit is worse than staying below it. At 0.7 two of twelve
            simulated plants passed theirs, by 10 and 14 %.
        least_amplitude, most_amplitude: of the grip [m]. A smaller shake is not planned: the arm places itself to
            0.1 mm (facts: sawyer 1), and soft pads swallow as much.
        most_speed: of the grip [m/s].
        stem_strain, joint_strain: largest bending strain of main stem and pedicels [-].
        leaf_load: largest torque at a leaf's base that the shake adds, in units of what 1 m/s2 gives [m/s2]: 0.7 g.
        flower_acceleration: more than this is not useful [m/s2].
        duration: of the shake [s]; longer at low frequency, to have five cycles.
        most_duration: of a visit [s].
        ramp: time in which the amplitude rises [s].
    """

    objective: Literal["dose", "amplitude"] = "dose"
    half_dose: float = 45.0
    lowest: float = 1.0
    highest: float = 35.0
    frequencies: int = 40
    directions: int = 8
    heights: int = 8
    draws: int = 6
    caution: float = 0.8
    seed: int = 0
    arm_share: float = 0.8
    plant_share: float = 0.6
    least_amplitude: float = 0.3e-3
    most_amplitude: float = 0.03
    most_speed: float = 0.3
    stem_strain: float = 0.01
    joint_strain: float = 0.005
    leaf_load: float = 0.7 * 9.81
    flower_acceleration: float = 200.0
    duration: float = 3.0
    most_duration: float = 5.0
    ramp: float = 0.3

    def __post_init__(self) -> None:
        if self.objective not in ("dose", "amplitude"):
            raise bad_input("objective", given=f"'{self.objective}'", allowed="dose or amplitude", do="Choose one.")
        check_range("lowest frequency", self.lowest, 0.05, 500, "Hz")
        check_range("highest frequency", self.highest, self.lowest, 500, "Hz")
        check_range("number of frequencies", self.frequencies, 1, 2000)
        check_range("number of directions", self.directions, 1, 360)
        check_range("number of heights", self.heights, 0, 500)
        check_range("number of draws", self.draws, 0, 1000)
        check_range("caution", self.caution, 0, 1)
        check_range("arm_share", self.arm_share, 0.01, 1)
        check_range("plant_share", self.plant_share, 0.01, 1)
        check_range("least_amplitude", self.least_amplitude, 1e-7, self.most_amplitude, "m")
        for name in ("half_dose", "most_speed", "stem_strain", "joint_strain", "leaf_load"):
            check_range(name, getattr(self, name), 1e-9, 1e6)
        check_range("most_duration", self.most_duration, 0.1, 60, "s")
        check_range("duration", self.duration, 0.1, self.most_duration, "s")
        check_range("ramp", self.ramp, 0, self.duration / 2, "s")


class _Grips(NamedTuple):
    """Where the stem may be held: the grasps' nodes first, then others for the map."""

    nodes: NDArray[Any]  # (G, 2) rod nodes between the pads
    arc_length: Array  # (G,) [m]
    grasp: NDArray[Any]  # (G,) index of the grasp itself or, for the map, of the nearest one
    directions: Array  # (G, D, 3)


class _Search(NamedTuple):
    """The search space, all (Q, G, D) but `bounds`."""

    frequencies: Array  # (Q,) [Hz]
    amplitude: Array  # largest allowed [m]
    score: Array
    bounds: dict[str, tuple[Array, float]]  # name -> (value per metre of amplitude, its limit)


def plan_shake(
    plant: PlantModel, grasps: Sequence[Grasp], arm_limit: ArmLimit = sawyer_limit, params: Params = Params()
) -> ShakePlan:
    """Choose grasp, direction, frequency and amplitude, and predict what every flower will do.

    Linear theory (complex tree solves about the gravity equilibrium) gives the response of every flower to a shake of
    one metre at every grip, direction and frequency, for the plant as believed and for `Params.draws` scenarios drawn
    from the spread of its material. Each shake is as large as arm and plant allow; its worth is averaged over flowers
    and scenarios, and a scenario in which it would pass a limit of the plant counts nothing, so that a resonance that
    would only help if the stiffness were exactly right is not trusted. The
    winner is checked by the nonlinear solver, whose amplitudes are the prediction; the interval is that of the
    scenarios.

    Args:
        plant: from `build_plant`.
        grasps: ranked grasps.
        arm_limit: what the arm manages at a grasp.
        params: limits and search.

    Raises:
        StageFailure: "no_flowers_found"; "no_grasp_found" when there is no grasp; "limits_exceeded" when no shake is
            allowed; "no_convergence" when the plant cannot be simulated.
    """
    if not len(plant.flower_nodes):
        raise StageFailure("no_flowers_found", "no flower was found, so there is nothing to shake for.")
    if not grasps:
        raise StageFailure("no_grasp_found", "no grasp to choose from: the shake needs at least one.")
    grips = _grips(plant, grasps, params)
    versions = scenarios(plant, params.draws, params.seed)
    frequencies = np.geomspace(params.lowest, params.highest, params.frequencies)
    response = gains(versions, grips.nodes, grips.directions, frequencies)
    search = _search(response, grips, grasps, frequencies, arm_limit=arm_limit, params=params)
    best = _best(search, np.arange(len(grasps)))
    return _plan(plant, grips, response, search, best, grasps=grasps, params=params)


def _grips(plant: PlantModel, grasps: Sequence[Grasp], params: Params) -> _Grips:
    held = grip_rows(plant, np.array([g.point for g in grasps]))
    usable = np.flatnonzero(~np.isin(plant.stem_nodes, plant.clamp.nodes))
    others = usable[np.unique(np.linspace(0, len(usable) - 1, params.heights).round().astype(int))]
    rows = np.concatenate([held, others])
    nodes, arc = pad_nodes(plant, rows), plant.arc_length[rows]
    nearest = np.abs(arc[len(held) :, None] - arc[: len(held)]).argmin(axis=1)
    near = np.concatenate([np.arange(len(held)), nearest])
    return _Grips(nodes, arc, near, _directions(plant, nodes[:, 0], params.directions))


def _directions(plant: PlantModel, nodes: NDArray[Any], count: int) -> Array:
    """Return (G, D, 3) unit vectors across the stem, above `count` directions of the horizontal half circle."""
    angle = np.arange(count) * np.pi / count
    flat = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    tangent = plant.rods.nodes[nodes] - plant.rods.nodes[plant.rods.parent[nodes]]
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    across = flat - np.einsum("dk,gk->gd", flat, tangent)[..., None] * tangent[:, None]
    size = np.linalg.norm(across, axis=2, keepdims=True)
    return np.where(size > 0.3, across / np.maximum(size, 1e-9), flat)  # along a lying stem: leave it horizontal


def _search(
    response: Gains, grips: _Grips, grasps: Sequence[Grasp], frequencies: Array, *, arm_limit: ArmLimit, params: Params
) -> _Search:
    omega = 2 * np.pi * frequencies[:, None, None]
    asked = [[arm_limit(grasp, d, frequencies) for d in ds] for grasp, ds in zip(grasps, grips.directions)]  # noqa: B905
    arm = np.moveaxis(np.asarray(asked, dtype=float), 2, 0)[:, grips.grasp]  # the map: as at the nearest grasp
    one = np.ones_like(arm)

    flower = response.flower.max(axis=-1) * omega**2
    plant_bounds = {
        "stem bending strain [-]": (response.stem_strain, params.plant_share * params.stem_strain),
        "pedicel bending strain [-]": (response.joint_strain, params.plant_share * params.joint_strain),
        "leaf-base load [m/s2]": (response.leaf_load, params.plant_share * params.leaf_load),
        "flower acceleration [m/s2]": (flower, params.flower_acceleration),
    }
    bounds = {
        "arm amplitude [share of its limit]": (1 / np.maximum(arm, 1e-12), params.arm_share),
        "grip amplitude [m]": (one, params.most_amplitude),
        "grip speed [m/s]": (one * omega, params.most_speed),
        **{name: (np.quantile(v, params.caution, axis=0), limit) for name, (v, limit) in plant_bounds.items()},
    }
    amplitude = np.min([limit / np.maximum(value, 1e-12) for value, limit in bounds.values()], axis=0)
    motion = amplitude[..., None] * response.flower
    worth = motion if params.objective == "amplitude" else pollen_dose(motion * omega[..., None] ** 2, params.half_dose)
    harmless = np.all([amplitude * value <= limit * (1 + 1e-9) for value, limit in plant_bounds.values()], axis=0)
    score = np.where(amplitude < params.least_amplitude, -1.0, (worth.mean(axis=-1) * harmless).mean(axis=0))
    return _Search(frequencies, amplitude, score, bounds)


def _best(search: _Search, rows: NDArray[Any], *, avoid: tuple[int, ...] | None = None) -> tuple[int, int, int]:
    """Return (q, g, d) of the highest score among the grips `rows`.

    With `avoid`, only shakes at another grip or a fifth or more away in frequency count.
    """
    score = search.score[:, rows].copy()
    if avoid is not None:
        ratio = search.frequencies / search.frequencies[avoid[0]]
        same = np.flatnonzero((ratio > 0.8) & (ratio < 1.25))
        score[same, list(rows).index(avoid[1])] = -1
    q, g, d = np.unravel_index(int(np.argmax(score)), score.shape)
    return int(q), int(rows[g]), int(d)


def _plan(
    plant: PlantModel,
    grips: _Grips,
    response: Gains,
    search: _Search,
    best: tuple[int, int, int],
    *,
    grasps: Sequence[Grasp],
    params: Params,
) -> ShakePlan:
    q, g, d = best
    frequency, amplitude = float(search.frequencies[q]), float(search.amplitude[q, g, d])
    if amplitude < params.least_amplitude:
        least = 1e3 * params.least_amplitude
        raise StageFailure(
            "limits_exceeded",
            f"no shake of {least:.2g} mm or more is allowed at any grasp, direction and frequency. "
            f"{_closest(search, best)} Allow a smaller least_amplitude, or another grasp.",
        )
    duration = float(np.clip(5 / frequency, params.duration, params.most_duration))
    held, also = (int(node) for node in grips.nodes[g])
    drive = Drive(held, grips.directions[g, d], amplitude, frequency, also=(also,))
    gain = response.flower[:, q, g, d]
    motion, notes = _verified(plant, drive, amplitude * gain[0])
    span = np.quantile(gain, [0.05, 0.95], axis=0) / np.maximum(gain[0], 1e-12)
    interval = motion[:, None] * np.stack([np.minimum(span[0], 1), np.maximum(span[1], 1)], axis=1)
    omega2 = (2 * np.pi * frequency) ** 2
    other = _runner_up(search, best, len(grasps))
    return ShakePlan(
        grasp_index=g,
        grasp=grasps[g],
        direction=drive.direction,
        amplitude=amplitude,
        frequency=frequency,
        duration=duration,
        waveform="sine",
        ramp=params.ramp,
        predicted_amplitude=motion,
        predicted_amplitude_interval=interval,
        predicted_acceleration=omega2 * motion,
        predicted_acceleration_interval=omega2 * interval,
        score=float(search.score[best]),
        limits=[
            *_limit_rows(search, best),
            ("duration [s]", duration, params.most_duration, duration / params.most_duration),
        ],
        runner_up=other,
        reason=_reason(search, best, grips, motion, other, params=params),
        response_map=_map(grips, response, search, len(grasps), params.least_amplitude),
        notes=plant.notes + notes,
    )


def _verified(plant: PlantModel, drive: Drive, linear: Array) -> tuple[Array, tuple[str, ...]]:
    """Return each flower's amplitude (F,) [m] by the nonlinear solver, and what the user should know about it."""
    try:
        motion = shaken_amplitude(plant, drive)
    except StageFailure as failure:
        return linear, (f"shake: not verified by the nonlinear solver, prediction is linear ({failure})",)
    largest = float(np.max(np.abs(motion - linear) / np.maximum(linear, 1e-9)))
    if largest > 0.25:
        return motion, (f"shake: a flower's nonlinear amplitude differs from the linear one by {100 * largest:.0f} %.",)
    return motion, ()


def shaken_amplitude(plant: PlantModel, drive: Drive) -> Array:
    """Return each flower's amplitude (F,) [m] in steady shaking, by the nonlinear solver.

    The shake grows slowly, so that few transients arise, and the last quarter of the simulated time is fitted by sine
    and cosine at the drive's frequency (least squares); the amplitude is the semi-major axis of that path. 30 steps a
    period, and at most 4 ms, keep the midpoint rule's phase error small.
    """
    dt = min(1 / (30 * drive.frequency), 0.004)
    time = float(np.clip(20 / drive.frequency, 1.5, 8.0))
    slow = replace(drive, ramp=0.4 * time)
    path = simulate(plant.rods_at(drive.frequency), plant.clamp, slow, time, dt, start="scanned", tolerance=1e-7)
    late = path.times >= time - max(np.floor(time / 4 * drive.frequency), 1) / drive.frequency
    t, x = path.times[late], path.positions[late][:, plant.flower_nodes]
    angle = 2 * np.pi * drive.frequency * t
    basis = np.stack([np.cos(angle), -np.sin(angle), np.ones_like(t), t - t.mean()], axis=1)
    parts = np.linalg.lstsq(basis, x.reshape(len(t), -1), rcond=None)[0].reshape(4, -1, 3)
    return semi_major(parts[0] + 1j * parts[1])


def _limit_rows(search: _Search, at: tuple[int, int, int]) -> list[tuple[str, float, float, float]]:
    size = float(search.amplitude[at])
    values = {name: (size * float(value[at]), limit) for name, (value, limit) in search.bounds.items()}
    return [(name, value, limit, value / limit) for name, (value, limit) in values.items()]


def _closest(search: _Search, at: tuple[int, int, int]) -> str:
    name, value, limit, _ = max(_limit_rows(search, at), key=lambda row: row[3])
    return f"The limit that binds is {name}: {value:.3g} of {limit:.3g}."


def _runner_up(search: _Search, best: tuple[int, int, int], grasps: int) -> RunnerUp | None:
    at = _best(search, np.arange(grasps), avoid=best)
    if search.score[at] <= 0 or at == best:
        return None
    return RunnerUp(at[1], float(search.frequencies[at[0]]), float(search.amplitude[at]), float(search.score[at]))


def _reason(
    search: _Search, best: tuple[int, int, int], grips: _Grips, motion: Array, other: RunnerUp | None, *, params: Params
) -> str:
    q, g, _ = best
    f, size = search.frequencies[q], search.amplitude[best]
    goal = "pollen dose" if params.objective == "dose" else "flower amplitude"
    acceleration = (2 * np.pi * f) ** 2 * motion
    text = (
        f"Held {100 * grips.arc_length[g]:.0f} cm up the stem and shaken {1e3 * size:.2g} mm at {f:.3g} Hz, the flowers"
        f" should move {1e3 * np.median(motion):.2g} mm (median) with {np.median(acceleration):.3g} m/s2. Of all"
        f" grasps, directions and frequencies this gives the highest mean {goal} ({search.score[best]:.3g}), averaged"
        f" over the flowers and over {params.draws} further drawings of the plant's stiffness and damping."
        f" {_closest(search, best)}"
    )
    if other is None:
        return text
    return text + (
        f" Runner-up: grasp {other.grasp_index + 1} at {other.frequency:.3g} Hz with {1e3 * other.amplitude:.2g} mm "
        f"({other.score:.3g})."
    )


def _map(grips: _Grips, response: Gains, search: _Search, grasps: int, least: float) -> ResponseMap:
    """Return the best direction's response at the map's heights, or at the grasps when there are no others."""
    rows = np.arange(grasps, len(grips.nodes)) if len(grips.nodes) > grasps else np.arange(grasps)
    rows = rows[np.argsort(grips.arc_length[rows], kind="stable")]
    mean = response.flower.mean(axis=(0, -1))[:, rows]
    size = search.amplitude[:, rows]
    acceleration = np.where(size < least, 0, mean * size * (2 * np.pi * search.frequencies[:, None, None]) ** 2)
    at = acceleration.argmax(axis=2)[..., None]
    pick = [np.take_along_axis(values, at, axis=2)[..., 0].T for values in (acceleration, mean, size)]
    return ResponseMap(search.frequencies, grips.arc_length[rows], *pick)
