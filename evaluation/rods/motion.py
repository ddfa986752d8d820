"""Time stepping: energy, order of the integrators, a violent shake."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from anther.core import StageFailure
from anther.rods import Clamp, Drive, natural_frequencies, simulate
from evaluation.rods.beams import CLAMPED, NO_GRAVITY, X_AXIS, Beam, network
from evaluation.rods.table import Array, Row, order_row

BEAM = Beam()


def energy_cases(quick: bool) -> list[Row]:
    """Return the row of the energy that an undamped, widely swinging cantilever keeps."""
    rods = BEAM.rods(21)
    period = 1 / natural_frequencies(rods, CLAMPED, 1, gravity=NO_GRAVITY).frequencies[0]
    periods = 20 if quick else 100
    run = simulate(rods, CLAMPED, None, periods * period, 1e-3, start="scanned")
    at_rest = simulate(rods, CLAMPED, None, 2e-3, 1e-3).energy[0]
    change = (run.energy - run.energy[0]) / (run.energy[0] - at_rest)
    each = round(period / 1e-3)
    early, late = (np.ptp(run.positions[part, -1, 2]) for part in (slice(0, 3 * each), slice(-3 * each, None)))
    detail = f"tip swings {1e3 * early:.1f} mm in the first three periods, {1e3 * late:.1f} mm in the last three"
    what = (
        f"energy of an undamped cantilever released from the horizontal, {periods} periods of {period:.3f} s at dt 1 ms"
    )
    return [Row("energy_100_periods", what, float(np.abs(change).max()), 1e-3, "%", detail)]


def order_cases(quick: bool) -> list[Row]:
    """Return the rows of the order of both integrators."""
    best = end_state(1.25e-4 if quick else 6.25e-5, "midpoint")
    rows = []
    schemes = (("midpoint", 2, "order_midpoint", 4e-3), ("implicit_euler", 1, "order_implicit_euler", 1e-3))
    for integrator, order, case, longest in schemes:
        steps = longest / np.array([1, 2, 4, 8])
        errors = np.array([np.abs(end_state(dt, integrator) - best).max() for dt in steps])
        what = f"{integrator.replace('_', ' ')}: order in the time step (shaken cantilever)"
        row = order_row(case, what, steps, errors, order)
        rows.append(row if order == 2 else replace(row, limit=None))
    return rows


def end_state(dt: float, integrator: str) -> Array:
    """Return the positions [m] after 0.4 s of a shake that grows smoothly to 5 mm at 5 Hz, lightly damped."""
    rods = BEAM.rods(9, viscous_time=2e-3)
    drive = Drive(5, np.array([0.0, 1.0, 1.0]), 5e-3, 5, ramp=0.4)
    run = simulate(rods, CLAMPED, drive, 0.4, dt, integrator=integrator, tolerance=1e-10)  # pyright: ignore[reportArgumentType]
    return run.positions[-1]


def violent_cases(quick: bool) -> list[Row]:
    """Return the row of 5 mm at 30 Hz on the undamped 3-D network, where the peer's Newton diverges."""
    what = (
        "5 mm at 30 Hz on the undamped 3-D network, dt 1 ms: energy gained minus the work of the drive, over that work"
    )
    duration = 0.2 if quick else 1.0
    try:
        error, detail = energy_balance(1e-3, duration)
        finer = [energy_balance(dt, duration)[1] for dt in ([] if quick else [2.5e-4, 1.25e-4])]
        if finer:
            finer.append("for the energy taken in, undamped, use dt 0.25 ms or less")
    except StageFailure as failure:
        return [Row("violent_shake", what, np.nan, 0.02, "%", str(failure))]
    return [Row("violent_shake", what, error, 0.02, "%", "; ".join([detail, *finer]))]


def energy_balance(dt: float, duration: float) -> tuple[float, str]:
    """Return the largest difference of energy gained and work of the drive, over that work, and both in words.

    The balance starts after the first millisecond: the grip jumps from rest to its full speed, as in the peers' runs.
    """
    clamp, drive = Clamp(np.array([0, 1])), Drive(20, X_AXIS, 5e-3, 30)
    run = simulate(network(), clamp, drive, duration, dt, start="scanned", record_every=round(1e-3 / dt))
    gained, work = run.energy[1:] - run.energy[1], run.work[1:] - run.work[1]
    error = float(np.abs((gained - work) / np.ptp(work)).max())
    words = f"dt {1e3 * dt:g} ms: {100 * error:.2g} %, work of the drive up to {np.ptp(work):.3f} J"
    return error, f"{words}, {run.split_steps} steps done again"
