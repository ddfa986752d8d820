"""Shaken plants in two codes: discrete elastic rods against rigid pieces on sprung hinges in MuJoCo.

Plants (experiments/hinged/plants.py): a straight stem; a Y whose members differ in length and radius; the five
branches in 3-D on which the peers were measured. Both codes get the same radius, E, GJ, density, weight and damping
(Kelvin-Voigt, and drag per mass), hang in equilibrium in the same shape, are clamped at the soil, and are gripped
inside the stem: the grip node's place is prescribed, its direction free. 2 mm at 2, 10 and 30 Hz.

Drive. In MuJoCo a heavy carriage follows the sine exactly (place, speed and force are imposed each step). The grip node
is tied to it by a constraint that leaves the height free: a stem that cannot stretch dips when it bends. MuJoCo's
constraints are soft, so the grip's path is measured, and the rods are driven along that very path. Whatever the
constraint does, both codes then see the same boundary condition. Responses are per metre of grip motion.

Judgement. A tip's phasor is the projection of its motion on sine and cosine over the last second (whole periods), a
complex 3-vector. Amplitude is its length; phase is the argument of the product of both codes' vectors.
amplitude_error compares equal meshes. converged_amplitude_error first corrects each code's phasor by the
discretisation error of that code's own small-vibration response on that mesh (converged value: hinges, Richardson's
second-order extrapolation from 40 and 80 edges per 0.5 m; rods, a + b h + c h^2 through 80, 160 and 320). The hinges'
phasors are corrected for MuJoCo's time step as well, by the same means (pieces.py, Linear.response).

Keys of the --json file: <case>_<f>hz_amplitude_error and _phase_error_deg (converged, worst tip), the same with _<n>
for equal meshes of n edges per 0.5 m, _resonance_hz (natural frequency nearest to the shake, grip held),
_unsteadiness; worst_amplitude_error, worst_phase_error_deg (converged) and rows_failed.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from hinged.figure import draw, worst_error
from hinged.pieces import linearise, pieces_of, shake
from hinged.plants import (
    BEND_OVER_TWIST,
    DENSITY,
    MASS_DAMPING,
    PLANTS,
    VISCOUS_TIME,
    YOUNGS,
    Array,
    ComplexArray,
    Plant,
    Tree,
    cut,
)
from numpy.typing import ArrayLike
from rich.console import Console
from rich.progress import track
from rich.table import Table

from anther.elastic_rod import (
    GRAVITY,
    Clamp,
    Rods,
    SampledDrive,
    frequency_response,
    simulate,
    with_gravity_equilibrium,
)
from anther.files import write_json

FREQUENCIES = (2.0, 10.0, 30.0)
DURATION = {2.0: 10.0, 10.0: 6.0, 30.0: 5.0}
"""Simulated time [s]; transients die with exp(-1.1 t) or faster."""
RAMP, WINDOW = 2.0, 1.0
"""The shake grows over the first, and is measured over the last, so many seconds."""
AMPLITUDE = 2e-3
"""[m], as in the peers' 30 Hz reference run."""
STEP = {2.0: 4e-4, 10.0: 4e-4, 30.0: 2e-4}
"""Time step of both codes [s]."""
PIECE_MESHES, ROD_MESHES = (40, 80), (80, 160, 320)
"""Meshes for the converged small-vibration response, edges per 0.5 m."""
SOIL = Clamp(np.array([0, 1]))
MESHES, QUICK_MESH = (10, 20, 40), {2.0: 20, 10.0: 20, 30.0: 40}
"""Meshes that are stepped through time."""
AMPLITUDE_LIMIT, PHASE_LIMIT = 0.03, 5.0


@dataclass(frozen=True)
class Comparison:
    """One plant at one frequency, rods against hinges; errors are those of the worst tip.

    Attributes:
        case: name of the plant.
        frequency_hz: of the shake.
        segments: edges per 0.5 m in both codes.
        amplitude_error: rods / hinges - 1 on that mesh.
        phase_error_deg: phase of the rods minus that of the hinges on that mesh.
        converged_amplitude_error: the same without either code's discretisation error.
        converged_phase_error_deg: likewise.
        worst_tip: the tip of the largest converged amplitude error: a member's number.
        tip_over_grip: that tip's amplitude per grip amplitude, hinges.
        resonance_hz: the natural frequency, grip held, that lies nearest.
        unsteadiness: largest relative change of a tip's amplitude from the second before, hinges.
    """

    case: str
    frequency_hz: float
    segments: int
    amplitude_error: float
    phase_error_deg: float
    converged_amplitude_error: float
    converged_phase_error_deg: float
    worst_tip: int
    tip_over_grip: float
    resonance_hz: float
    unsteadiness: float


@dataclass(frozen=True, eq=False)
class Small:
    """Small-vibration responses (Q, T, 3) of one plant: by mesh (`stepped`: of MuJoCo's time steps), and converged.

    `modes` are the natural frequencies with the grip held [Hz].
    """

    pieces: dict[int, ComplexArray]
    stepped: dict[int, ComplexArray]
    rods: dict[int, ComplexArray]
    converged_pieces: ComplexArray
    converged_rods: ComplexArray
    modes: Array


def rods_of(tree: Tree, gravity: ArrayLike = GRAVITY) -> Rods:
    """Return the rods; node j of the tree is node j + 1.

    Node 0 lies one edge below the soil. That edge is clamped and as good as rigid, so that the spring at the soil is
    2 EI/l and the stem is clamped at the soil, not half an edge above it.
    """
    youngs = np.full(len(tree.nodes) + 1, YOUNGS)
    youngs[1] *= 1e6
    rods = Rods(
        np.vstack([2 * tree.nodes[0] - tree.nodes[1], tree.nodes]),
        np.concatenate([[-1], tree.parent + 1]),
        np.concatenate([tree.radius[:1], tree.radius]),
        youngs,
        DENSITY,
        bend_over_twist=BEND_OVER_TWIST,
        viscous_time=VISCOUS_TIME,
        mass_damping=MASS_DAMPING,
    )
    return with_gravity_equilibrium(rods, SOIL, gravity)


def small_vibrations(plant: Plant, meshes: tuple[int, ...]) -> Small:
    """Return both codes' small-vibration responses at FREQUENCIES, on the meshes and converged."""
    pieces: dict[int, ComplexArray] = {}
    stepped: dict[int, ComplexArray] = {}
    modes = np.zeros(0)
    for n in sorted({*meshes, *PIECE_MESHES}):
        tree = cut(plant, n)
        linear = linearise(pieces_of(plant, tree, min(STEP.values())), tree)
        pieces[n], modes = linear.response(plant.axis, FREQUENCIES), linear.frequencies(held=True)
        stepped[n] = np.concatenate([linear.response(plant.axis, [f], STEP[f]) for f in FREQUENCIES])
    rods: dict[int, ComplexArray] = {}
    for n in sorted({*meshes, *PIECE_MESHES, *ROD_MESHES}):
        tree = cut(plant, n)
        answer = frequency_response(rods_of(tree), SOIL, tree.grip + 1, plant.direction, FREQUENCIES)
        rods[n] = answer[:, tree.tips + 1]
    coarse, fine = (pieces[n] for n in PIECE_MESHES)
    far, middle, near = (rods[n] for n in ROD_MESHES)
    return Small(pieces, stepped, rods, (4 * fine - coarse) / 3, (8 * near - 6 * middle + far) / 3, modes)


def phasors(times: Array, positions: Array, frequency: float, *, before: float = 0.0) -> ComplexArray:
    """Return the complex amplitudes (P, 3) of positions (S, P, 3) in the last WINDOW, or in the one `before` [s] it."""
    dt = times[1] - times[0]
    end = len(times) - round(before / dt)
    part = slice(end - round(WINDOW / dt), end)
    turning = np.exp(-2j * np.pi * frequency * times[part])
    return 2j * np.tensordot(turning, positions[part] - positions[0], 1) / len(turning)


def displacement(frequency: float) -> Array:
    """Return the carriage's displacements (S,) [m], one each time step."""
    t = np.arange(round(DURATION[frequency] / STEP[frequency])) * STEP[frequency]
    rise = 0.5 - 0.5 * np.cos(np.pi * np.clip(t / RAMP, 0, 1))
    return AMPLITUDE * rise * np.sin(2 * np.pi * frequency * t)


def rods_phasors(tree: Tree, frequency: float, times: Array, path: Array) -> ComplexArray:
    """Simulate the rods with their grip on a path (S, 3) [m]; return the phasors (1 + T, 3) of grip and tips."""
    drive = SampledDrive(tree.grip + 1, times, path)
    run = simulate(rods_of(tree), SOIL, drive, float(times[-1]), float(times[1]))
    seen = np.concatenate([[tree.grip], tree.tips]) + 1
    return phasors(run.times, run.positions[:, seen], frequency)


def compare_one(plant: Plant, frequency: float, segments: int, small: Small) -> Comparison:
    """Shake one plant in both codes."""
    tree = cut(plant, segments)
    shaken = shake(pieces_of(plant, tree, STEP[frequency]), tree, displacement(frequency))
    truth, earlier = (phasors(shaken.times, shaken.positions, frequency, before=b) for b in (0.0, WINDOW))
    found = rods_phasors(tree, frequency, shaken.times, shaken.positions[:, 0] - shaken.positions[0, 0])
    q = FREQUENCIES.index(frequency)
    pieces, rods = (p[1:] / (p[0] @ plant.axis) for p in (truth, found))
    pieces += small.pieces[segments][q] - small.stepped[segments][q]
    amplitude, phase = _errors(rods, pieces)
    converged_pieces = pieces + small.converged_pieces[q] - small.pieces[segments][q]
    converged, converged_phase = _errors(rods + small.converged_rods[q] - small.rods[segments][q], converged_pieces)
    worst = int(np.argmax(np.abs(converged)))
    sizes = np.linalg.norm(truth[1:], axis=1), np.linalg.norm(earlier[1:], axis=1)
    return Comparison(
        plant.name,
        frequency,
        segments,
        _largest(amplitude),
        _largest(phase),
        float(converged[worst]),
        _largest(converged_phase),
        worst,
        float(np.linalg.norm(converged_pieces[worst])),
        float(small.modes[np.argmin(np.abs(np.log(small.modes / frequency)))]),
        float(np.max(np.abs(sizes[0] / sizes[1] - 1))),
    )


def _errors(rods: ComplexArray, pieces: ComplexArray) -> tuple[Array, Array]:
    """Return relative amplitude errors (T,) and phase errors (T,) [deg] of responses (T, 3)."""
    amplitude = np.linalg.norm(rods, axis=1) / np.linalg.norm(pieces, axis=1) - 1
    return amplitude, np.degrees(np.angle(np.sum(np.conj(pieces) * rods, axis=1)))


def _largest(values: Array) -> float:
    return float(values[np.argmax(np.abs(values))])


def compare(quick: bool, console: Console | None = None) -> list[Comparison]:
    """Return the comparisons of all plants and frequencies, on one mesh each where quick, on three where not."""
    return _study(quick, console or Console())[0]


def _study(quick: bool, console: Console) -> tuple[list[Comparison], dict[str, Small]]:
    plants = [make() for make in PLANTS]
    small = {p.name: small_vibrations(p, MESHES) for p in track(plants, "small vibrations", console=console)}
    jobs = [(p, f, n) for p in plants for f in FREQUENCIES for n in ((QUICK_MESH[f],) if quick else MESHES)]
    rows = [compare_one(p, f, n, small[p.name]) for p, f, n in track(jobs, "hinged plants", console=console)]
    return rows, small


def fails(row: Comparison) -> bool:
    """Whether a row misses a limit of the issue: 3 % in amplitude, 5 degrees in phase."""
    return abs(row.converged_amplitude_error) > AMPLITUDE_LIMIT or abs(row.converged_phase_error_deg) > PHASE_LIMIT


def finest(rows: list[Comparison]) -> list[Comparison]:
    """Return the rows of the finest mesh of each plant and frequency."""
    best: dict[tuple[str, float], Comparison] = {}
    for row in sorted(rows, key=lambda row: row.segments):
        best[row.case, row.frequency_hz] = row
    return list(best.values())


def metrics(rows: list[Comparison]) -> dict[str, float]:
    """Return the keys that the module's docstring names; the converged ones from the finest mesh."""
    out: dict[str, float] = {}
    best = finest(rows)
    for row in rows:
        name = f"{row.case}_{row.frequency_hz:g}hz"
        out[f"{name}_amplitude_error_{row.segments}"] = row.amplitude_error
        out[f"{name}_phase_error_deg_{row.segments}"] = row.phase_error_deg
    for row in best:
        name = f"{row.case}_{row.frequency_hz:g}hz"
        out[f"{name}_amplitude_error"] = row.converged_amplitude_error
        out[f"{name}_phase_error_deg"] = row.converged_phase_error_deg
        out[f"{name}_resonance_hz"] = row.resonance_hz
        out[f"{name}_unsteadiness"] = row.unsteadiness
    out["worst_amplitude_error"] = max(abs(row.converged_amplitude_error) for row in best)
    out["worst_phase_error_deg"] = max(abs(row.converged_phase_error_deg) for row in best)
    out["rows_failed"] = sum(fails(row) for row in best)
    return out


def main() -> None:
    """Run, print a table, draw the figure, write --json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="write the metrics here")
    parser.add_argument("--quick", action="store_true", help="time stepping on one mesh only")
    parser.add_argument("--seed", type=int, default=0, help="for uniformity; nothing here is random")
    parser.add_argument("--figure", type=Path, default=Path("docs/pictures/hinged_plant.png"))
    args = parser.parse_args()
    console = Console()
    rows, small = _study(args.quick, console)
    console.print(_table(rows))
    draw(args.figure, [make() for make in PLANTS], {name: _convergence(s) for name, s in small.items()}, FREQUENCIES)
    if args.json:
        write_json(args.json, metrics(rows))


def _convergence(small: Small) -> dict[str, dict[int, Array]]:
    """Return both codes' errors against the converged hinges, by mesh."""
    truth = small.converged_pieces
    codes = {"rods": small.rods, "hinges": small.pieces}
    return {code: {n: worst_error(r, truth) for n, r in by_mesh.items()} for code, by_mesh in codes.items()}


def _table(rows: list[Comparison]) -> Table:
    table = Table("plant", "Hz", "edges / 0.5 m", "equal meshes", "converged", "worst tip", "nearest mode", "unsteady")
    for row in rows:
        table.add_row(
            row.case,
            f"{row.frequency_hz:g}",
            str(row.segments),
            f"{row.amplitude_error:+.2%} {row.phase_error_deg:+.2f} deg",
            f"{row.converged_amplitude_error:+.2%} {row.converged_phase_error_deg:+.2f} deg",
            f"{row.worst_tip}: {row.tip_over_grip:.2f} x grip",
            f"{row.resonance_hz:.2f} Hz",
            f"{row.unsteadiness:.1e}",
            style="red" if fails(row) else None,
        )
    return table


if __name__ == "__main__":
    main()
