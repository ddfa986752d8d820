"""Plants of sprung hinged pieces in MuJoCo (experiments/hinged_plant.py) against the rods."""

from __future__ import annotations

import numpy as np
from hinged.plants import PLANTS
from hinged_plant import (
    AMPLITUDE_LIMIT,
    FREQUENCIES,
    MESHES,
    PHASE_LIMIT,
    QUICK_MESH,
    Comparison,
    compare,
    compare_one,
    finest,
    small_vibrations,
)
from rich.console import Console

from rod_cases.table import Findings, Row


def hinged_cases(quick: bool) -> Findings:
    """Return two rows per plant, amplitude and phase at the worst of 2, 10 and 30 Hz; quick: one plant at 10 Hz."""
    found = [_one_comparison()] if quick else finest(compare(False, Console(quiet=True)))
    rows: list[Row] = []
    for case in dict.fromkeys(comparison.case for comparison in found):
        rows += _rows(case, [comparison for comparison in found if comparison.case == case])
    return Findings(rows)


def _one_comparison() -> Comparison:
    plant, frequency = PLANTS[0](), FREQUENCIES[1]
    return compare_one(plant, frequency, QUICK_MESH[frequency], small_vibrations(plant, MESHES))


def _rows(case: str, found: list[Comparison]) -> list[Row]:
    hertz = ", ".join(f"{c.frequency_hz:g}" for c in found)
    what = f"hinged pieces in MuJoCo, {case.replace('_', ' ')}, at {hertz} Hz, both codes converged, worst tip"
    sizes, phases = ([abs(value) for value in values] for values in zip(*(_errors(c) for c in found), strict=True))
    meshes = ", ".join(f"{c.amplitude_error:+.1%} and {c.phase_error_deg:+.1f}° on {c.segments} edges" for c in found)
    amplitudes = ", ".join(f"{c.converged_amplitude_error:+.2%}" for c in found)
    angles = ", ".join(f"{c.converged_phase_error_deg:+.2f}°" for c in found)
    return [
        Row(f"mujoco_{case}_amplitude", f"{what}: amplitude", float(np.max(sizes)), AMPLITUDE_LIMIT, "%", amplitudes),
        Row(
            f"mujoco_{case}_phase",
            f"{what}: phase",
            float(np.max(phases)),
            PHASE_LIMIT,
            "deg",
            f"{angles}; equal meshes, each code with its own discretisation error: {meshes}",
        ),
    ]


def _errors(comparison: Comparison) -> tuple[float, float]:
    return comparison.converged_amplitude_error, comparison.converged_phase_error_deg
