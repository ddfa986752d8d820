"""`anther plan --simulate`: one stated shake of a plant by the elastic-rod model in time, and how a flower moves."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from scipy.signal import detrend, hilbert

from anther.cli.args.plan import Args
from anther.cli.output import room_for
from anther.cli.plan_map import AXES
from anther.core.checks import check_range
from anther.core.errors import bad_input
from anther.core.files import write_json
from anther.plant.source import SourcePlant, held_nodes
from anther.rods import Burst, Chirp, Clamp, Drive, Rods, Trajectory, natural_frequencies, simulate
from anther.show.pictures import save_figure
from anther.show.pictures.rods import draw_shake

Shake = Drive | Chirp | Burst
WRITTEN = ("trajectory.npz", "shake.json", "shake.png")


def run(args: Args, plant: SourcePlant) -> None:
    """Simulate the shake, print the flower's motion, and write the results to `out`."""
    asked = args.simulation
    check_range("amplitude", 0.0 if args.amplitude is None else args.amplitude, 0, 1, "m")
    check_range("frequency", asked.frequency, 1e-3, 1e4, "Hz")
    check_range("end_frequency", asked.end_frequency, 1e-3, 1e4, "Hz")
    check_range("duration", asked.duration, 10 * asked.dt, 3600, "s")
    if args.axis == "best":
        raise bad_input("axis", given="best", allowed="x, y or z, with --simulate", do="--map finds the best.")
    out = room_for(args, WRITTEN)
    grip, flower = _nodes(args, plant)
    last = asked.end_frequency if asked.waveform == "chirp" else asked.frequency
    rods, clamp = plant.damped(float(np.sqrt(asked.frequency * last))), plant.clamp
    drive = _drive(args, grip, held_nodes(plant, grip, args.rods.pads)[1:])
    trajectory = simulate(rods, clamp, drive, asked.duration, asked.dt, integrator=asked.integrator)
    result = {"grip_node": int(plant.numbers[grip]), "flower_node": int(plant.numbers[flower])}
    result |= measure(rods, clamp, drive, trajectory, flower) | {"stiffness": plant.stiffness}
    if out is not None:
        trajectory.save(out / WRITTEN[0])
        write_json(out / WRITTEN[1], result)
        save_figure(draw_shake(rods, grip, flower, drive.direction, trajectory, 1 / last), out / WRITTEN[2])
    print(json.dumps(result, indent=2) if args.json else _text(args, result, plant.notes))


def _nodes(args: Args, plant: SourcePlant) -> tuple[int, int]:
    """Return the nodes of grip and flower: those asked for, else halfway up the stem, and the first or farthest end."""
    along = plant.distances()
    flower = int(plant.flower_nodes[0]) if len(plant.flower_nodes) else int(along.argmax())
    flower = plant.flower(args.flower[0]) if args.flower else flower
    if args.simulation.grip is not None:
        return plant.node(args.simulation.grip), flower
    if not len(plant.stem_nodes):
        raise bad_input("grip", given="none, and no main stem is seen", allowed="--grip NODE", do="Name it.")
    height = along[plant.stem_nodes]
    return int(plant.stem_nodes[np.abs(height - 0.5 * height[-1]).argmin()]), flower


def _drive(args: Args, grip: int, also: tuple[int, ...]) -> Shake:
    asked, axis = args.simulation, AXES[args.axis or "x"]
    amplitude, frequency = 0.004 if args.amplitude is None else args.amplitude, asked.frequency
    match asked.waveform:
        case "chirp":
            return Chirp(grip, axis, amplitude, frequency, asked.end_frequency, asked.duration, asked.ramp, also)
        case "burst":
            return Burst(grip, axis, amplitude, frequency, asked.cycles, asked.pause, also)
        case _:
            return Drive(grip, axis, amplitude, frequency, asked.ramp, also)


def measure(rods: Rods, clamp: Clamp, drive: Shake, trajectory: Trajectory, flower: int) -> dict[str, Any]:
    """Return how the flower moves along the drive's direction, units in the names.

    The amplitude is the median of the Hilbert envelope of the detrended displacement and the frequency its FFT peak,
    the paper's own measures (R2).
    """
    along = trajectory.displacement(flower) @ drive.direction
    amplitude, frequency = vibration(along, float(trajectory.times[1]))
    grip = vibration(trajectory.displacement(drive.node) @ drive.direction, float(trajectory.times[1]))[0]
    return {
        "flower_amplitude_m": amplitude,
        "flower_peak_m": float(np.abs(along).max()),
        "flower_frequency_hz": frequency,
        "grip_amplitude_m": grip,
        "grip_force_peak_n": float(np.linalg.norm(trajectory.grip_force, axis=1).max()),
        "grip_moment_peak_nm": float(np.linalg.norm(trajectory.grip_moment, axis=1).max()),
        "amplitude_ratio": amplitude / drive.amplitude if drive.amplitude else None,
        "first_frequency_hz": float(natural_frequencies(rods, clamp, 1).frequencies[0]),
        "energy_start_j": float(trajectory.energy[0]),
        "newton_iterations": trajectory.newton_iterations,
        "split_steps": trajectory.split_steps,
    }


def vibration(displacement: Any, dt: float) -> tuple[float, float]:
    """Return the median Hilbert envelope [m] and the dominant frequency [Hz] of a (T,) displacement [m]."""
    flat = detrend(displacement)
    envelope = np.abs(np.asarray(hilbert(flat)))
    padded = 8 * len(flat)
    spectrum = np.abs(np.fft.rfft(flat * np.hanning(len(flat)), padded))
    return float(np.median(envelope)), float(np.fft.rfftfreq(padded, dt)[np.argmax(spectrum)])


def _text(args: Args, told: dict[str, Any], notes: tuple[str, ...]) -> str:
    ratio = "" if told["amplitude_ratio"] is None else f", {told['amplitude_ratio']:.3f} of the shake"
    moment = f" and moment {told['grip_moment_peak_nm']:.3g} N m" if args.rods.pads else ""
    lines = [
        f"flower at node {told['flower_node']}: {1e3 * told['flower_amplitude_m']:.3f} mm along {args.axis or 'x'} "
        f"(Hilbert envelope{ratio}), {told['flower_frequency_hz']:.3f} Hz, "
        f"at most {1e3 * told['flower_peak_m']:.3f} mm from rest",
        f"grip node {told['grip_node']}: {1e3 * told['grip_amplitude_m']:.3f} mm, "
        f"peak force {told['grip_force_peak_n']:.3g} N{moment}",
        f"first natural frequency, not gripped: {told['first_frequency_hz']:.3f} Hz",
        f"stiffness: {told['stiffness']}",
        f"{told['newton_iterations']} Newton iterations, {told['split_steps']} split steps",
        *(f"note: {note}" for note in notes),
    ]
    return "\n".join(lines if args.out is None else [*lines, f"written: {args.out}"])
