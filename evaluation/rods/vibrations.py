"""Small vibrations: natural frequencies, the decay of free vibration, frequency response against simulation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.plant.bench import fit_free_vibration
from anther.rods import Clamp, Drive, Rods, frequency_response, natural_frequencies, simulate
from evaluation.rods.beam_theory import cone_frequencies, rayleigh_roots, uniform_roots
from evaluation.rods.beams import CLAMPED, NO_GRAVITY, SLENDER, X_AXIS, Beam, network
from evaluation.rods.table import Array, Row, order_row

NODES = 50
BEAM = Beam()
THICK = Beam(radius=7.5e-3)
"""Radius over length 1/40: rotary inertia lowers the third frequency by 0.6 %; the first mode of stretch is higher."""


def frequency_cases(quick: bool) -> list[Row]:
    """Return the rows of the first three natural frequencies, each held to its worst mode."""
    del quick  # it takes a second
    rows, three = [], "first three natural frequencies"
    for case, what, exact, material in _spectra():
        ratios = first_modes(SLENDER.rods(NODES, **material)) / exact
        detail = "engine over theory " + ", ".join(f"{r:.5f}" for r in ratios)
        worst = float(np.abs(ratios - 1).max())
        rows.append(Row(f"frequencies_{case}", f"{three}, {what}, {NODES} nodes", worst, 3e-3, "%", detail))
    rows.append(_rotary_inertia())
    _, what, exact, material = _spectra()[1]
    meshes = (13, 25, 50, 100)
    errors = np.array([np.abs(first_modes(SLENDER.rods(n, **material)) / exact - 1).max() for n in meshes])
    steps = np.array([SLENDER.spacing(n) for n in meshes])
    rows.append(order_row("frequencies_order", f"{three}, {what}: order in the node distance", steps, errors))
    return rows


def _spectra() -> list[tuple[str, str, Array, dict[str, Any]]]:
    """Case, words, exact frequencies [rad/s] and what makes the rods differ from a uniform beam."""
    beam_mass, rate = SLENDER.line_mass * SLENDER.length, SLENDER.rate
    found: list[Any] = [("uniform", "uniform cantilever (analytic)", uniform_roots(3) ** 2 * rate, {})]
    for end in (0.5, 0.2):
        words, taper = (
            f"cone, tip {end:g} of the base's radius (Bessel functions)",
            lambda s, end=end: 1 - (1 - end) * s,
        )
        found.append((f"cone_{round(100 * end)}", words, cone_frequencies(end, 3) * rate, {"taper": taper}))
    for share in (0.5, 2.0):
        words, more = f"uniform with a tip mass of {share:g} of its own (analytic)", {"tip_mass": share * beam_mass}
        found.append((f"tip_mass_{round(100 * share)}", words, uniform_roots(3, share) ** 2 * rate, more))
    return found


def _rotary_inertia() -> Row:
    rods = THICK.rods(NODES, bend_over_twist=0.0)  # so that no mode of twist comes in between
    ratios = first_modes(rods) / (rayleigh_roots(3, THICK.radius / THICK.length) ** 2 * THICK.rate)
    plain = (uniform_roots(3) / rayleigh_roots(3, THICK.radius / THICK.length)) ** 2
    detail = "engine over theory " + ", ".join(f"{r:.5f}" for r in ratios)
    detail += "; without rotary inertia " + ", ".join(f"{r:.5f}" for r in plain)
    what = f"first three natural frequencies, uniform cantilever of radius L / 40 (Rayleigh's beam), {NODES} nodes"
    return Row("frequencies_rotary_inertia", what, float(np.abs(ratios - 1).max()), 3e-3, "%", detail)


def first_modes(rods: Rods) -> Array:
    """Return the first three natural frequencies [rad/s]; each appears twice, for bending in y and in z."""
    return 2 * np.pi * natural_frequencies(rods, CLAMPED, 6, gravity=NO_GRAVITY).frequencies[::2]


def decay_cases(quick: bool) -> list[Row]:
    """Return the rows of free decay: the damping ratio fitted to the tip against the one that was asked for."""
    cases = [
        (f"decay_{round(100 * ratio)}", ratio, "viscous_time", f"Kelvin–Voigt damping of {100 * ratio:g} %")
        for ratio in (0.01, 0.03, 0.1)
    ]
    cases.append(("decay_3_mass_damping", 0.03, "mass_damping", "mass damping of 3 %"))
    rows = []
    for case, ratio, kind, what in cases:
        fitted, stated = decay_of(ratio, kind, periods=8 if quick else 15)
        detail = f"fitted {fitted:.5f}, stated by natural_frequencies {stated:.5f}"
        error = max(abs(fitted / ratio - 1), abs(stated / ratio - 1))
        rows.append(Row(case, f"free decay, {what} in the first mode", error, 0.02, "%", detail))
    return rows


def decay_of(ratio: float, kind: str, *, periods: float) -> tuple[float, float]:
    """Return the damping ratio fitted to the free vibration of a released cantilever, and the one the modes state.

    Midpoint rule, T/200 a step. The first two periods are left out: until then the higher modes have died away.
    """
    rods = BEAM.rods(21)
    first = first_modes(rods)[0]
    period = 2 * np.pi / first
    damped = replace(rods, **{kind: 2 * ratio * first if kind == "mass_damping" else 2 * ratio / first})
    slight = (0, 0, -0.02 * 9.81)
    duration = (periods + 2) * period
    run = simulate(damped, CLAMPED, None, duration, period / 200, gravity=slight, start="scanned")
    late = run.times >= 2 * period
    stated = natural_frequencies(damped, CLAMPED, 1, gravity=NO_GRAVITY).damping_ratios[0]
    return fit_free_vibration(run.times[late], run.positions[late, -1, 2]).damping_ratio, float(stated)


def response_cases(quick: bool) -> list[Row]:
    """Return the rows of the frequency response against a simulation of small amplitude, on the 3-D network."""
    rods, clamp, grip = network(viscous_time=4e-3, mass_damping=2.0), Clamp(np.array([0, 1])), 20
    sizes, phases = {}, {}
    for frequency in (10.0,) if quick else (2.0, 10.0, 30.0):
        expected = frequency_response(rods, clamp, grip, (1, 0, 0), [frequency])[0]
        ratio = steady_response(rods, clamp, grip, frequency)[_moving(expected)] / expected[_moving(expected)]
        sizes[frequency] = float(np.abs(np.abs(ratio) - 1).max())
        phases[frequency] = float(np.abs(np.degrees(np.angle(ratio))).max())
    what = "frequency response against simulation (0.01 mm at node 20, 3-D network), worst node and direction"
    size, phase = max(sizes.values()), max(phases.values())
    amplitude = Row("response_amplitude", f"{what}: amplitude", size, 0.01, "%", _each(sizes, 100, "%"))
    return [amplitude, Row("response_phase", f"{what}: phase", phase, 2.0, "deg", _each(phases, 1, "°"))]


def _each(errors: dict[float, float], scale: float, unit: str) -> str:
    return ", ".join(f"{scale * error:.2g} {unit} at {frequency:g} Hz" for frequency, error in errors.items())


def _moving(response: NDArray[np.complex128]) -> NDArray[np.bool_]:
    """Nodes and directions with a tenth of the largest amplitude or more: elsewhere a phase means little."""
    return np.abs(response) >= 0.1 * np.abs(response).max()


def steady_response(rods: Rods, clamp: Clamp, grip: int, frequency: float) -> NDArray[np.complex128]:
    """Return (N, 3): the complex amplitude per metre of grip amplitude, from the last periods of a simulation.

    The drive grows over 2 s and holds for 6 s, in which the slowest mode decays to 4e-4.
    """
    amplitude, grow, hold = 1e-5, 2.0, 6.0
    dt = 1 / frequency / 200
    periods = max(2, round(0.2 * frequency))
    duration = round((grow + hold) * frequency) / frequency
    drive = Drive(grip, X_AXIS, amplitude, frequency, ramp=grow)
    run = simulate(rods, clamp, drive, duration, dt)
    last = slice(-200 * periods, None)
    wave = np.exp(-2j * np.pi * frequency * run.times[last])
    moves = (run.positions[last] - run.positions[0]) / amplitude
    return 2j * np.tensordot(wave, moves, 1) / len(wave)
