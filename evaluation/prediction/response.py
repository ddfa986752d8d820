"""How well the side camera measures the flowers' motion, on rendered shakes whose truth is known.

    python -m evaluation.prediction.response --plants 1 --blind 1 --jobs 2

Simulated plants are held at the middle of their stem and shaken (`shaken_plant`) so that the median flower moves by
1 to 12 mm; the trial's side camera (480 x 480 px, noisy D455) renders 60 frames at the rate `oscillation.choose_rate`
gives. Flowers are told to the stage where they truly are, give or take `PLACED`, as perception would. A flower counts
as in sight if half of its petals' outline or more is seen from the camera at rest. `BLIND` are recordings in which a
frame rate hides the shake: the stage must refuse them. Shakes go through a sweep in --out: what is done is kept.

Keys: in_sight, flowers in the picture and not hidden; measured, how many of them; within, the share of those whose
amplitude is right within 10 % or 0.3 mm; sideways_within, the same of its part across the line of sight;
frequency_within, within 1 %; honest, within two stated deviations; the same by true amplitude (_1mm: below 1.5, _3mm:
to 5, _12mm: above), by frequency, and for flowers alone or overlapping others; blind_refused.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from anther.core import Array, InputError, inverse, transform_points
from anther.core.oscillation import choose_rate, fit_swing
from anther.perception import Flowers
from anther.pollination import measure_response
from anther.robot import Frame
from anther.sim import Scene, SimPlant, grow, layout
from anther.sim.robot import SIDE, SimCamera
from anther.sim.simulated_cell import USUAL_DISTANCE
from evaluation.harness import CROPS, finish, options, run_cases
from evaluation.prediction.known_plant import filmed
from evaluation.prediction.shaken_plant import Params as ShakenParams
from evaluation.prediction.shaken_plant import Shaken, ShakenPlant
from evaluation.tables import by_part

SHAKES = ((0.001, 10.0), (0.002, 6.0), (0.004, 3.0), (0.008, 6.0), (0.012, 1.5), (0.001, 30.0))
"""(median amplitude of the flowers [m], frequency [Hz])."""
BLIND = ((0.001, 30.0, 30.0), (0.001, 30.0, 60.0), (0.002, 15.0, 30.0))
"""(amplitude [m], frequency [Hz], frame rate [Hz]) that hides it."""
FRAMES = 60
PLACED = 0.0015
"""Standard deviation per axis with which perception places a flower [m]; 1.2 mm measured on ten plants."""
BANDS = {"1mm": (0.0, 1.5e-3), "3mm": (1.5e-3, 5e-3), "12mm": (5e-3, 1.0)}


@dataclass(frozen=True)
class Measured:
    """One flower of one shake; amplitudes [m], frequencies [Hz], phases [rad]; None where not measured."""

    true: float
    sideways: float
    in_sight: bool
    alone: bool
    amplitude: float | None
    seen_sideways: float | None
    deviation: float | None
    frequency: float | None
    asked: float
    rate: float


def film(plant: SimPlant, amplitude: float, frequency: float, rate: float, seed: int) -> tuple[list[Frame], Shaken]:
    """Return noisy frames of a shaken plant, and its true motion at their times."""
    points, _, arc = plant.stem_centreline()
    middle = points[int(np.argmin(np.abs(arc - 0.5 * arc[-1])))]
    held = ShakenPlant(plant, middle, [0.8, 0.6, 0.0], ShakenParams(measure=FRAMES / rate, samples=200))
    gain = np.linalg.norm(held.linear(frequency)[0], axis=1)
    done = held.steady(min(amplitude / float(np.median(gain)), 0.02), frequency)
    wanted = done.times[0] + np.arange(0, done.times[-1] - done.times[0], 1 / rate)[:FRAMES]
    samples = np.abs(done.times - wanted[:, None]).argmin(axis=1)
    shapes = [plant.posed_vertices(held.segment_poses(done.qpos[i])) for i in samples]
    frames = filmed(plant, shapes, done.times[samples], np.random.default_rng([seed, 11]))
    return frames, replace(done, times=done.times[samples], flowers=done.flowers[samples], qpos=done.qpos[samples])


def in_sight(plant: SimPlant) -> Array:
    """Return (F,) bool, whether half of a flower's petals or more are seen by the camera, plant at rest."""
    pose = layout(USUAL_DISTANCE).T_world_side_camera
    across = pose[:3, 0] * 0.004, pose[:3, 1] * 0.004
    offsets = [np.cos(a) * across[0] + np.sin(a) * across[1] for a in np.arange(8) * np.pi / 4]
    scene = Scene.of_plant(plant)
    seen = np.mean([scene.visible(plant.flower_position + o, pose[:3, 3], 0.02) for o in offsets], axis=0) >= 0.5
    pixels = SIDE.project(transform_points(inverse(pose), plant.flower_position))
    inside = np.all((pixels >= 8) & (pixels < [SIDE.width - 8, SIDE.height - 8]), axis=1)
    return seen & inside


def judge(plant: SimPlant, frames: Sequence[Frame], true: Shaken, frequency: float, rate: float) -> list[Measured]:
    """Measure the frames and compare with the true motion."""
    count, rng = len(true.amplitude), np.random.default_rng([plant.seed, 12])
    flowers = Flowers(plant.flower_position + rng.normal(0, PLACED, (count, 3)), np.zeros(count, dtype=int))
    found = measure_response(frames, SIDE, layout(USUAL_DISTANCE).T_world_side_camera, flowers, frequency)
    together = {int(k) - 1 for note in found.notes if "overlap" in note for k in re.findall(r"\d+", note)}
    return [
        Measured(
            true=float(true.amplitude[k]),
            sideways=_sideways(true.times, true.flowers[:, k], frequency),
            in_sight=bool(sight),
            alone=k not in together,
            amplitude=float(found.amplitude[k]) if found.visible[k] else None,
            seen_sideways=_sideways(found.times, found.tracks[:, k], frequency) if found.visible[k] else None,
            deviation=float(found.amplitude_std[k]) if found.visible[k] else None,
            frequency=float(found.frequency[k]) if found.visible[k] else None,
            asked=frequency,
            rate=rate,
        )
        for k, sight in enumerate(in_sight(plant))
    ]


def _sideways(times: Array, path: Array, frequency: float) -> float:
    """Return the amplitude of a path (N, 3) across the line of sight to it [m]; NaN where the rate hides it."""
    middle = np.nanmean(path, axis=0)
    sight = middle - layout(USUAL_DISTANCE).T_world_side_camera[:3, 3]
    sight /= np.linalg.norm(sight)
    across = (path - middle) @ (np.eye(3) - np.outer(sight, sight))
    try:
        return fit_swing(times, across, frequency).amplitude
    except InputError:
        return float("nan")


def one_shake(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the flowers of one shake (species, seed, amplitude, frequency, rate), for a sweep."""
    del folder
    plant = grow(row["species"], row["seed"], 0.0, USUAL_DISTANCE)
    frames, done = film(plant, row["amplitude"], row["frequency"], row["rate"], row["seed"])
    return {"flowers": [asdict(one) for one in judge(plant, frames, done, row["frequency"], row["rate"])]}


def summary(rows: Sequence[Measured]) -> dict[str, float]:
    """Return the shares that the module's docstring names."""
    sight = [r for r in rows if r.in_sight]
    got = [r for r in sight if r.amplitude is not None]
    miss = np.array([abs((r.amplitude or 0) - r.true) for r in got])
    true, deviation = np.array([r.true for r in got]), np.array([r.deviation or 0 for r in got])
    wide = np.array([r.sideways or 0 for r in got])
    aside = np.abs(np.array([r.seen_sideways or 0 for r in got]) - wide)
    hertz = np.array([abs((r.frequency or 0) / r.asked - 1) for r in got])
    return {
        "in_sight": len(sight),
        "measured": len(got) / max(len(sight), 1),
        "within": float(np.mean(miss <= np.maximum(0.1 * true, 3e-4))) if got else float("nan"),
        "sideways_within": float(np.mean(aside <= np.maximum(0.1 * wide, 3e-4))) if got else float("nan"),
        "frequency_within": float(np.mean(hertz <= 0.01)) if got else float("nan"),
        "honest": float(np.mean(miss <= 2 * deviation)) if got else float("nan"),
    }


def metrics(rows: Sequence[Measured], blind: Sequence[Measured]) -> dict[str, float]:
    """Return all of the numbers."""
    out = summary(rows) | {"hidden_but_measured": sum(r.amplitude is not None for r in rows if not r.in_sight)}
    groups = {name: [r for r in rows if low <= r.true < high] for name, (low, high) in BANDS.items()}
    groups |= {"alone": [r for r in rows if r.alone], "together": [r for r in rows if not r.alone]}
    groups |= {f"{f:g}hz": [r for r in rows if r.asked == f] for f in sorted({r.asked for r in rows})}
    for name, some in groups.items():
        out |= {f"{name}_{key}": value for key, value in summary(some).items()}
    return out | {"blind_flowers": len(blind), "blind_refused": sum(r.amplitude is None for r in blind)}


GROUPS = {
    "": "all",
    "1mm_": "swing below 1.5 mm",
    "3mm_": "swing 1.5–5 mm",
    "12mm_": "swing above 5 mm",
    "alone_": "alone",
    "together_": "overlapping others",
}
"""Groups of the metrics in words; those of frequencies speak for themselves."""


def _table(found: dict[str, float]) -> Table:
    names = [key.removesuffix("in_sight") for key in found if key.endswith("in_sight")]
    groups = {name: GROUPS.get(name, name.replace("hz_", " Hz")) for name in names}
    shares = {
        "in sight": "*in_sight:.0f",
        "measured": "*measured:.0%",
        "amplitude within 10 % or 0.3 mm": "*within:.0%",
        "sideways part": "*sideways_within:.0%",
        "frequency within 1 %": "*frequency_within:.0%",
        "within 2 stated deviations": "*honest:.0%",
    }
    return by_part(found, "flowers", groups, shares)


def main() -> None:
    """Render, measure, print a table, write --json."""
    own = {
        "--plants": (3, "of each crop"),
        "--blind": (len(BLIND), "recordings whose frame rate hides the shake"),
    }
    quick, seed = "one plant, two shakes", (2100, "of the first plant")
    args = options(__doc__, quick=quick, seed=seed, jobs="cases", out="runs/response", own=own)
    plants = [(crop, args.seed + k) for k in range(1 if args.quick else args.plants) for crop in CROPS]
    plants, shakes = (plants[:1], SHAKES[:2]) if args.quick else (plants, SHAKES)
    jobs = [(*p, a, f, choose_rate(f, SimCamera.rates)) for p in plants for a, f in shakes]
    hidden = [(*p, *b) for p in plants[:1] for b in BLIND[: args.blind]]
    names = ("species", "seed", "amplitude", "frequency", "rate")
    cases = [dict(zip(names, job, strict=True)) for job in jobs + hidden]
    done = run_cases(one_shake, cases, args.out, args.jobs, lambda _: {"flowers": []})
    rows, blind = (
        [Measured(**flower) for one in part for flower in one["flowers"]]
        for part in (done[: len(jobs)], done[len(jobs) :])
    )
    found = metrics(rows, blind)
    words = (
        f"Frame rates that hide the shake: refused for {found['blind_refused']:.0f} of {found['blind_flowers']:.0f} "
        f"flowers. Flowers that are not in sight but were measured: {found['hidden_but_measured']:.0f}."
    )
    finish(args, {name: value for name, value in found.items() if np.isfinite(value)}, _table(found), words)


if __name__ == "__main__":
    main()
