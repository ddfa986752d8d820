"""A tapered, leafy stem of known material, and the files a careful person would make of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from anther.plant.bench import ClampedStem, first_frequency, tip_deflections
from anther.rods import Clamp, equilibrium, simulate, with_gravity_equilibrium


@dataclass(frozen=True)
class Truth:
    """What the stem is made of."""

    youngs: float = 90e6
    density: float = 1080.0
    damping_ratio: float = 0.04

    @property
    def stem(self) -> ClampedStem:
        place = np.array([0.08, 0.14, 0.2, 0.25, 0.28])
        return ClampedStem(
            np.array([0.0, 0.1, 0.2, 0.3]),
            np.array([5.0e-3, 4.4e-3, 3.6e-3, 2.6e-3]),
            0.3,
            place,
            np.array([2.0e-3, 2.0e-3, 1.5e-3, 1.0e-3, 0.5e-3]),
        )


def nonlinear_trace(truth: Truth, seconds: float = 6.0, dt: float = 2e-3) -> tuple[np.ndarray, np.ndarray]:
    """Return (T,) times [s] and tip displacement [m] of the upright stem, let go from a bent shape."""
    frequency = first_frequency(truth.stem, truth.youngs, truth.density, "upright")
    straight = truth.stem.rods(truth.youngs, truth.density, "upright")
    elastic = first_frequency(truth.stem, truth.youngs, truth.density, "weightless")  # viscosity resists that part only
    straight = replace(straight, viscous_time=truth.damping_ratio * frequency / (np.pi * elastic**2))
    clamp = Clamp.root(straight)
    sideways = (2.5, 0, -9.81)
    bent = equilibrium(straight, clamp, gravity=sideways)
    released = with_gravity_equilibrium(replace(straight, nodes=bent), clamp, gravity=sideways)
    run = simulate(released, clamp, None, seconds, dt, start="scanned", record_every=5)
    return run.times, run.positions[:, -1, 0]


def sine_trace(
    frequency: float, ratio: float, rng: np.random.Generator, *, noise: float = 3e-4, seconds: float = 6.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return a decaying oscillation of undamped `frequency` [Hz] with 10 mm amplitude and white noise [m]."""
    t = np.arange(0, seconds, 0.02)
    w = 2 * np.pi * frequency
    clean = 0.01 * np.exp(-ratio * w * t) * np.cos(w * np.sqrt(1 - ratio**2) * t)
    return t, clean + rng.normal(0, noise, len(t))


def write_csv(path: Path, **columns: np.ndarray) -> Path:
    rows = [",".join(f"{value:.6g}" for value in row) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join(["# made for a test", ",".join(columns), *rows]) + "\n", encoding="utf-8")
    return path


def write_files(folder: Path, truth: Truth, trace: tuple[np.ndarray, np.ndarray], seed: int = 0) -> dict[str, Path]:
    """Write samples, profile, leaves, a pluck and a deflection test, with small reading errors."""
    rng, stem = np.random.default_rng(seed), truth.stem
    radius, length = rng.uniform(2.5e-3, 5e-3, 12), rng.uniform(0.02, 0.05, 12)
    mass = rng.normal(truth.density, 30, 12) * np.pi * radius**2 * length
    load = np.array([2e-3, 5e-3, 10e-3, 15e-3])
    sunk = tip_deflections(stem, truth.youngs, truth.density, load) + rng.normal(0, 3e-4, 4)
    mm, g = 1e3, 1e3
    return {
        "samples": write_csv(folder / "samples.csv", mass_g=g * mass, radius_mm=mm * radius, length_mm=mm * length),
        "profile": write_csv(folder / "profile.csv", distance_mm=mm * stem.distance, radius_mm=mm * stem.radius),
        "leaves": write_csv(folder / "leaves.csv", distance_mm=mm * stem.leaf_distance, mass_g=g * stem.leaf_mass),
        "trace": write_csv(folder / "pluck.csv", time_s=trace[0], displacement_mm=mm * trace[1]),
        "deflection": write_csv(folder / "deflection.csv", mass_g=g * load, deflection_mm=mm * sunk),
    }
