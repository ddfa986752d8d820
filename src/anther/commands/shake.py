"""Shake a plant's skeleton with the elastic-rod model and print how its flower moves."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.signal import detrend, hilbert

from anther.checks import check_range
from anther.commands.rod_plant import PlantOptions, hanging, held_nodes, read_plant
from anther.elastic_rod import Clamp, Drive, Rods, Trajectory, natural_frequencies, simulate
from anther.files import replacing, write_json

AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True, kw_only=True)
class Args(PlantOptions):
    """Attributes: what to shake, how, and what it is made of. Node numbers are those of the file."""

    grip: int
    """Node that the gripper moves."""
    flower: int
    """Node whose motion is reported."""
    amplitude: float = 0.004
    """Shake amplitude [m]."""
    frequency: float = 1.3
    """Shake frequency [Hz]. The damping ratio holds here (Kelvin-Voigt: it grows with frequency)."""
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


@dataclass(frozen=True)
class Motion:
    """How the flower answers the shake."""

    flower_amplitude_m: float
    flower_frequency_hz: float
    grip_amplitude_m: float
    grip_force_peak_n: float
    amplitude_ratio: float | None
    first_frequency_hz: float
    energy_start_j: float
    newton_iterations: int
    split_steps: int


def run(args: Args) -> None:
    """Simulate the shake, print the flower's motion, and write the results to `out`.

    Raises:
        InputError: a bad file or option.
        StageFailure: the rods cannot stand, or the motion cannot be solved.
    """
    check_range("amplitude", args.amplitude, 0, 1, "m")
    check_range("frequency", args.frequency, 1e-3, 1e4, "Hz")
    check_range("duration", args.duration, 10 * args.dt, 3600, "s")
    plant = read_plant(args)
    grip, flower = plant.node(args.grip), plant.node(args.flower)
    plant = hanging(plant, args.skeleton) if args.rest == "hanging" else plant
    rods, clamp = plant.damped(args.frequency), plant.clamp
    also = held_nodes(plant, grip, args.pads)[1:]
    drive = Drive(grip, np.array(AXES[args.axis]), args.amplitude, args.frequency, also=also)
    trajectory = simulate(rods, clamp, drive, args.duration, args.dt, integrator=args.integrator)
    motion = measure(rods, clamp, drive, trajectory, flower)
    if args.out is not None:
        trajectory.save(args.out / "trajectory.npz")
        write_json(args.out / "shake.json", asdict(motion))
        draw(args.out / "shake.png", rods, drive, flower, trajectory)
    print(json.dumps(asdict(motion), indent=2) if args.json else _text(args, motion))


def measure(rods: Rods, clamp: Clamp, drive: Drive, trajectory: Trajectory, flower: int) -> Motion:
    """Return how the flower moves along the drive's direction.

    The amplitude is the median of the Hilbert envelope of the detrended displacement and the frequency its FFT peak,
    the paper's own measures (R2).
    """
    along = trajectory.displacement(flower) @ drive.direction
    amplitude, frequency = vibration(along, float(trajectory.times[1]))
    grip = vibration(trajectory.displacement(drive.node) @ drive.direction, float(trajectory.times[1]))[0]
    return Motion(
        flower_amplitude_m=amplitude,
        flower_frequency_hz=frequency,
        grip_amplitude_m=grip,
        grip_force_peak_n=float(np.linalg.norm(trajectory.grip_force, axis=1).max()),
        amplitude_ratio=amplitude / drive.amplitude if drive.amplitude else None,
        first_frequency_hz=float(natural_frequencies(rods, clamp, 1)[0][0]),
        energy_start_j=float(trajectory.energy[0]),
        newton_iterations=trajectory.newton_iterations,
        split_steps=trajectory.split_steps,
    )


def vibration(displacement: Any, dt: float) -> tuple[float, float]:
    """Return the median Hilbert envelope [m] and the dominant frequency [Hz] of a (T,) displacement [m]."""
    flat = detrend(displacement)
    envelope = np.abs(np.asarray(hilbert(flat)))
    padded = 8 * len(flat)
    spectrum = np.abs(np.fft.rfft(flat * np.hanning(len(flat)), padded))
    return float(np.median(envelope)), float(np.fft.rfftfreq(padded, dt)[np.argmax(spectrum)])


def _text(args: Args, motion: Motion) -> str:
    ratio = "" if motion.amplitude_ratio is None else f", {motion.amplitude_ratio:.3f} of the shake"
    lines = [
        f"flower node {args.flower}: {motion.flower_amplitude_m * 1e3:.3f} mm along {args.axis} (Hilbert envelope"
        f"{ratio}), {motion.flower_frequency_hz:.3f} Hz",
        f"grip node {args.grip}: {motion.grip_amplitude_m * 1e3:.3f} mm, peak force {motion.grip_force_peak_n:.3g} N",
        f"first natural frequency, not gripped: {motion.first_frequency_hz:.3f} Hz",
        f"{motion.newton_iterations} Newton iterations, {motion.split_steps} split steps",
    ]
    return "\n".join(lines if args.out is None else [*lines, f"written: {args.out}"])


def draw(path: Path, rods: Rods, drive: Drive, flower: int, trajectory: Trajectory) -> None:
    """Draw the plant at rest and at the flower's two extremes, and the motion over time and frequency."""
    figure = Figure(figsize=(11, 6), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 2, width_ratios=(1, 1.4))
    _draw_plant(figure.add_subplot(grid[:, 0]), rods, drive, flower, trajectory)
    moves = {"grip": trajectory.displacement(drive.node), "flower": trajectory.displacement(flower)}
    time, spectrum = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
    for (name, move), colour in zip(moves.items(), ("tab:blue", "tab:red"), strict=True):
        along = move @ drive.direction * 1e3
        time.plot(trajectory.times, along, color=colour, label=name, lw=1)
        window = np.hanning(len(along))
        height = 2 * np.abs(np.fft.rfft((along - along.mean()) * window)) / window.sum()
        spectrum.semilogy(np.fft.rfftfreq(len(along), trajectory.times[1]), height, color=colour, label=name, lw=1)
    time.set(xlabel="time [s]", ylabel="displacement along the shake [mm]")
    spectrum.set(xlabel="frequency [Hz]", ylabel="amplitude [mm]", xlim=(0, max(10, 5 * drive.frequency)))
    spectrum.set_ylim(bottom=1e-4 * max(1e-9, spectrum.dataLim.y1))
    for axes in (time, spectrum):
        axes.legend(loc="upper right")
        axes.grid(alpha=0.3)
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=120)


def _draw_plant(axes: Any, rods: Rods, drive: Drive, flower: int, trajectory: Trajectory) -> None:
    side = int(np.argmax(np.abs(drive.direction[:2])))
    along = trajectory.displacement(flower) @ drive.direction
    start = trajectory.positions[0]
    largest = np.abs(trajectory.positions - start).max()
    gain = 1.0 if largest == 0 else max(1.0, float(f"{0.1 * np.ptp(start, axis=0).max() / largest:.1g}"))
    for frame, style in ((int(np.argmin(along)), "tab:orange"), (int(np.argmax(along)), "tab:red"), (0, "tab:green")):
        x = start + gain * (trajectory.positions[frame] - start)
        edges = np.stack([x[rods.parent[1:]], x[1:]], axis=1)[:, :, [side, 2]]
        gaps = np.insert(edges, 2, np.nan, axis=1).reshape(-1, 2)
        axes.plot(*gaps.T, color=style, lw=2 if frame == 0 else 1)
    for node, colour, name in ((drive.node, "tab:blue", "grip"), (flower, "magenta", "flower")):
        axes.plot(*start[node, [side, 2]], "o", color=colour, label=name)
    axes.set(
        xlabel=f"{'xy'[side]} [m]", ylabel="z [m]", title=f"green: at rest; orange, red: extremes, drawn x{gain:g}"
    )
    axes.set_aspect("equal")
    axes.legend(loc="best")
