"""Shake a plant's skeleton with the elastic-rod model and print how its flower moves."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.signal import detrend, hilbert

from anther.cli.rod_plant import AXES, PlantOptions, RodPlant, hanging, held_nodes, read_plant, with_stem
from anther.core.checks import check_range
from anther.core.files import write_json
from anther.rods import Burst, Chirp, Clamp, Drive, Rods, Trajectory, natural_frequencies, simulate
from anther.show.pictures import save_figure
from anther.show.pictures.rods import draw_shake

Shake = Drive | Chirp | Burst


@dataclass(frozen=True, kw_only=True)
class Args(PlantOptions):
    """Attributes: what to shake, how, and what it is made of. Node numbers are those of the file."""

    grip: int | None = None
    """Node that the gripper moves; by default halfway up the main stem."""
    flower: int | None = None
    """Node whose motion is reported; by default a run's first flower, else the farthest end."""
    amplitude: float = 0.004
    """Shake amplitude [m]."""
    frequency: float = 1.3
    """Shake frequency [Hz]. The damping ratio holds here (Kelvin-Voigt: it grows with frequency); for a chirp, at the
    geometric mean of both its frequencies."""
    waveform: Literal["sine", "chirp", "burst"] = "sine"
    """A sine; a sweep from `frequency` to `end_frequency` over the whole duration; or bursts that swell and fade."""
    end_frequency: float = 30.0
    """Of a chirp [Hz]."""
    cycles: int = 10
    """Of each burst."""
    pause: float = 0.5
    """Between bursts [s]."""
    ramp: float = 0.0
    """Time over which the amplitude of a sine or chirp grows from 0 [s]; 0 starts at once, as the authors do."""
    axis: Literal["x", "y", "z"] = "x"
    """Shake direction, and the direction in which the flower is measured."""
    duration: float = 5.0
    """Simulated time [s]."""
    dt: float = 0.001
    """Time step [s]."""
    rest: Literal["hanging", "stress-free"] = "hanging"
    """The scanned shape hangs in equilibrium under gravity, or is stress-free and sags when gravity acts."""
    integrator: Literal["midpoint", "implicit_euler"] = "midpoint"
    """Second order without numerical damping, or first order with."""
    out: Path | None = None
    """Folder for trajectory.npz, shake.json and shake.png."""
    json: bool = False
    """Print the result as JSON."""


def run(args: Args) -> None:
    """Simulate the shake, print the flower's motion, and write the results to `out`."""
    check_range("amplitude", args.amplitude, 0, 1, "m")
    check_range("frequency", args.frequency, 1e-3, 1e4, "Hz")
    check_range("end_frequency", args.end_frequency, 1e-3, 1e4, "Hz")
    check_range("duration", args.duration, 10 * args.dt, 3600, "s")
    plant = read_plant(args) if args.grip is not None else with_stem(read_plant(args))
    grip, flower = _nodes(args, plant)
    plant = hanging(plant, args.skeleton) if args.rest == "hanging" else plant
    last = args.end_frequency if args.waveform == "chirp" else args.frequency
    rods, clamp = plant.damped(float(np.sqrt(args.frequency * last))), plant.clamp
    also = held_nodes(plant, grip, args.pads)[1:]
    drive = _drive(args, grip, also)
    trajectory = simulate(rods, clamp, drive, args.duration, args.dt, integrator=args.integrator)
    result = {"grip_node": int(plant.numbers[grip]), "flower_node": int(plant.numbers[flower])}
    result |= measure(rods, clamp, drive, trajectory, flower)
    if args.out is not None:
        trajectory.save(args.out / "trajectory.npz")
        write_json(args.out / "shake.json", result)
        figure = draw_shake(rods, grip, flower, drive.direction, trajectory, 1 / last)
        save_figure(figure, args.out / "shake.png")
    print(json.dumps(result, indent=2) if args.json else _text(args, result, plant.notes))


def _nodes(args: Args, plant: RodPlant) -> tuple[int, int]:
    """Return the nodes of grip and flower."""
    along = plant.distances()
    if args.flower is not None:
        flower = plant.node(args.flower)
    else:
        flower = int(plant.flower_nodes[0]) if len(plant.flower_nodes) else int(along.argmax())
    if args.grip is not None:
        return plant.node(args.grip), flower
    assert plant.stem_nodes is not None
    height = along[plant.stem_nodes]
    return int(plant.stem_nodes[np.abs(height - 0.5 * height[-1]).argmin()]), flower


def _drive(args: Args, grip: int, also: tuple[int, ...]) -> Shake:
    axis, amplitude, frequency = np.array(AXES[args.axis]), args.amplitude, args.frequency
    match args.waveform:
        case "chirp":
            return Chirp(grip, axis, amplitude, frequency, args.end_frequency, args.duration, args.ramp, also)
        case "burst":
            return Burst(grip, axis, amplitude, frequency, args.cycles, args.pause, also)
        case _:
            return Drive(grip, axis, amplitude, frequency, args.ramp, also)


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
    moment = f" and moment {told['grip_moment_peak_nm']:.3g} N m" if args.pads else ""
    lines = [
        f"flower node {told['flower_node']}: {1e3 * told['flower_amplitude_m']:.3f} mm along {args.axis} "
        f"(Hilbert envelope{ratio}), {told['flower_frequency_hz']:.3f} Hz, "
        f"at most {1e3 * told['flower_peak_m']:.3f} mm from rest",
        f"grip node {told['grip_node']}: {1e3 * told['grip_amplitude_m']:.3f} mm, "
        f"peak force {told['grip_force_peak_n']:.3g} N{moment}",
        f"first natural frequency, not gripped: {told['first_frequency_hz']:.3f} Hz",
        f"{told['newton_iterations']} Newton iterations, {told['split_steps']} split steps",
        *(f"note: {note}" for note in notes),
    ]
    return "\n".join(lines if args.out is None else [*lines, f"written: {args.out}"])
