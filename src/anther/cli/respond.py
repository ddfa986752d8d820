"""Map how a plant's flowers answer small shakes, over grip height and frequency (linear response), as CSV and PNG."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table

from anther.cli.rod_plant import AXES, PlantOptions, RodPlant, hanging, held_nodes, read_plant, with_stem
from anther.core.checks import check_range
from anther.core.errors import bad_input
from anther.core.files import write_json, write_text
from anther.core.geometry import Array
from anther.pollination.shake import Params as ShakeParams
from anther.pollination.shake.choice import FLOWER_ACCELERATION, MOST_SPEED
from anther.pollination.shake.observables import semi_major
from anther.robot.arm.sawyer import SAWYER
from anther.robot.arm.shaking import amplitude_limit
from anther.rods import natural_frequencies, response_map
from anther.show.pictures import save_figure
from anther.show.pictures.rods import GripResponse, draw_grip_response

TURNS = np.pi * np.arange(12) / 12
"""Horizontal directions that are tried for the best one [rad]."""
MODES, LISTED = 4, 12
BASE = 0.05
"""Length of main stem above the root that is left out [m], at most a quarter of it: next to the soil a small shake is a
long lever, which no stem bears."""


@dataclass(frozen=True, kw_only=True)
class Args(PlantOptions):
    """Attributes: which plant, where it is gripped, what is observed. Node numbers are those of the file."""

    flower: tuple[int, ...] = ()
    """Nodes whose motion counts. By default the flowers of a run, else every tip."""
    grips: tuple[int, ...] = ()
    """Nodes where the plant is gripped. By default the main stem's."""
    heights: int = 40
    """At most so many of the main stem's nodes, evenly picked."""
    axis: Literal["best", "x", "y", "z"] = "best"
    """Shake direction; by default, for each cell of the map, the best of 12 horizontal ones."""
    lowest: float = 1.0
    """Lowest frequency [Hz]."""
    highest: float = 35.0
    """Highest frequency [Hz]."""
    frequencies: int = 80
    """How many, evenly on a logarithmic scale."""
    amplitude: float = 0.001
    """Grip amplitude [m]. The answer is linear: accelerations are proportional to it."""
    arm: bool = False
    """Shake as far as a Sawyer can at each frequency instead: neutral arm, away from its base; 30 mm at most."""
    out: Path | None = None
    """Folder for response_map.csv, respond.json and response_map.png."""
    json: bool = False
    """Print the result as JSON."""


def run(args: Args) -> None:
    """Compute the map, print its best cell and the natural frequencies, and write the results to `out`."""
    check_range("amplitude", args.amplitude, 1e-9, 1, "m")
    check_range("lowest", args.lowest, 1e-3, 1e4, "Hz")
    check_range("highest", args.highest, args.lowest, 1e4, "Hz")
    check_range("frequencies", args.frequencies, 1, 10_000)
    check_range("heights", args.heights, 1, 10_000)
    plant = hanging(with_stem(read_plant(args)), args.skeleton)
    flowers, grips = _flowers(args, plant), _grips(args, plant)
    response = respond(args, plant, grips, flowers)
    result = summary(plant, response, flowers)
    if args.out is not None:
        write_json(args.out / "respond.json", result)
        write_csv(args.out / "response_map.csv", plant, response)
        figure = draw_grip_response(plant.rods, flowers, response, _title(args))
        save_figure(figure, args.out / "response_map.png")
    if args.json:
        print(json.dumps(result, indent=2))
    else:
        _print(args, result)


def _flowers(args: Args, plant: RodPlant) -> NDArray[Any]:
    """Return the nodes whose motion counts: those asked for, else the run's flowers, else every free tip."""
    if args.flower:
        return np.array([plant.node(number) for number in args.flower])
    if len(plant.flower_nodes):
        return plant.flower_nodes
    tips = np.setdiff1d(np.arange(1, len(plant.rods.parent)), plant.rods.parent)
    return np.setdiff1d(tips, plant.clamp.nodes)


def _grips(args: Args, plant: RodPlant) -> NDArray[Any]:
    """Return the grip nodes by their distance from the root: those asked for, else free nodes of the main stem."""
    distance = plant.distances()
    if args.grips:
        nodes = np.unique([plant.node(number) for number in args.grips])
    else:
        stem = plant.stem_nodes
        assert stem is not None
        low = min(BASE, 0.25 * float(distance[stem].max()))
        free = np.setdiff1d(stem[distance[stem] >= low], plant.clamp.nodes)
        if not len(free):
            raise bad_input("grips", given="none", allowed="a main stem that is not clamped", do="Name --grips.")
        nodes = free[np.unique(np.linspace(0, len(free) - 1, args.heights).round().astype(int))]
    return nodes[np.argsort(distance[nodes], kind="stable")]


def respond(args: Args, plant: RodPlant, grips: NDArray[Any], flowers: NDArray[Any]) -> GripResponse:
    """Return how the flowers (F,) of a plant at rest answer at every grip (G,) and frequency (Q,).

    Tissue is hysteretic: one damping ratio for all.
    """
    hertz = np.geomspace(args.lowest, args.highest, args.frequencies)
    held = [held_nodes(plant, int(grip), args.pads) for grip in grips]
    moves = np.zeros((len(hertz), len(grips), 3, len(flowers), 3), np.complex128)
    sizes, loss = np.array([len(nodes) for nodes in held]), 2 * plant.damping_ratio
    for size in np.unique(sizes):
        same = np.flatnonzero(sizes == size)
        pads, ways = np.array([held[g] for g in same]), np.eye(3)
        moves[:, same] = response_map(plant.rods, plant.clamp, pads, ways, hertz, observe=flowers, loss_factor=loss)
    ways = [AXES[args.axis]] if args.axis != "best" else [(np.cos(a), np.sin(a), 0.0) for a in TURNS]
    ratio, direction = _best_direction(moves, np.array(ways))
    amplitude = arm_amplitude(hertz) if args.arm else np.full(len(hertz), args.amplitude)
    resonances = []
    for nodes in track(held, "grips", console=Console(stderr=True), transient=True):
        clamp = replace(plant.clamp, nodes=np.concatenate([plant.clamp.nodes, nodes]))
        resonances.append(natural_frequencies(plant.rods, clamp, MODES).frequencies)
    distance = plant.distances()[grips]
    return GripResponse(hertz, grips, distance, amplitude, direction, ratio, np.array(resonances))


def _best_direction(moves: Any, ways: Array) -> tuple[Array, Array]:
    """Return the flowers' amplitude ratios (Q, G, F) in the direction of largest mean, and that direction (Q, G, 3)."""
    ratio = np.full(moves.shape[:2] + moves.shape[3:4], -1.0)
    direction = np.zeros((*moves.shape[:2], 3))
    for way in ways:
        there = semi_major(np.einsum("qgdfi,d->qgfi", moves, way))
        better = there.mean(axis=-1) > ratio.mean(axis=-1)
        ratio[better], direction[better] = there[better], way
    return ratio, direction


def arm_amplitude(frequencies: Array) -> Array:
    """Return the amplitude (Q,) [m] a Sawyer manages, neutral, away from its base; at most what the planner gives."""
    limit = amplitude_limit(SAWYER, SAWYER.neutral, (1.0, 0.0, 0.0), frequencies)
    return np.minimum(limit, ShakeParams().most_amplitude)


def summary(plant: RodPlant, response: GripResponse, flowers: NDArray[Any]) -> dict[str, Any]:
    """Return the best cell and the natural frequencies, units in the names."""
    q, g = response.best
    there = response.acceleration[q, g]
    hertz, ratios = natural_modes(plant)
    return {
        "best_grip_node": int(plant.numbers[response.grips[g]]),
        "best_grip_distance_m": float(response.distance[g]),
        "best_frequency_hz": float(response.frequencies[q]),
        "best_direction": response.direction[q, g].tolist(),
        "grip_amplitude_m": float(response.amplitude[q]),
        "flower_acceleration_mean_m_s2": float(there.mean()),
        "flower_acceleration_least_m_s2": float(there.min()),
        "flower_acceleration_most_m_s2": float(there.max()),
        "flower_amplitude_ratio_mean": float(response.ratio[q, g].mean()),
        "limits_passed": limits_passed(response),
        "notes": list(plant.notes),
        "natural_frequencies_hz": hertz.tolist(),
        "damping_ratios": ratios.tolist(),
        "flower_nodes": plant.numbers[flowers].tolist(),
        "grips": len(response.grips),
        "nodes": len(plant.rods.nodes),
    }


def limits_passed(response: GripResponse) -> list[str]:
    """Return which of the limits that `anther plan` keeps the best cell passes; what the plant bears is not asked."""
    q, g = response.best
    hertz, amplitude = response.frequencies[q], response.amplitude[q]
    values = (
        ("a flower's acceleration", float(response.acceleration[q, g].max()), FLOWER_ACCELERATION, "m/s²"),
        ("speed of the grip", float(2 * np.pi * hertz * amplitude), MOST_SPEED, "m/s"),
        ("amplitude of the grip", float(amplitude), ShakeParams().most_amplitude, "m"),
    )
    return [f"{name} {v:.3g} {unit}, more than {most:g}" for name, v, most, unit in values if v > most * (1 + 1e-9)]


def natural_modes(plant: RodPlant) -> tuple[Array, Array]:
    """Return the lowest natural frequencies (K,) [Hz] of the plant that nobody holds, and their damping ratios.

    Weight lowers a mode's stiffness and not its damping: near buckling, ratios are larger than the tissue's own.
    """
    hertz, _, drag = natural_frequencies(plant.rods, plant.clamp, MODES)
    at_1_hz = natural_frequencies(plant.damped(1.0), plant.clamp, MODES).damping_ratios
    return hertz, drag + (at_1_hz - drag) / hertz


def write_csv(path: Path, plant: RodPlant, response: GripResponse) -> None:
    """Write one row per grip and frequency; mean, least and most are over the flowers."""
    acceleration, nodes = response.acceleration, plant.rods.nodes
    rows = []
    for g, grip in enumerate(response.grips):
        for q, frequency in enumerate(response.frequencies):
            there, ratio = acceleration[q, g], response.ratio[q, g]
            row = [response.distance[g], nodes[grip, 2], frequency, *response.direction[q, g]]
            row += [response.amplitude[q], ratio.mean(), there.mean(), there.min(), there.max()]
            rows.append([str(plant.numbers[grip]), *(f"{value:.6g}" for value in row)])
    write_text(path, "".join(",".join(row) + "\r\n" for row in (COLUMNS, *rows)))


COLUMNS = (
    "grip_node", "grip_distance_m", "grip_z_m", "frequency_hz", "direction_x", "direction_y", "direction_z",
    "grip_amplitude_m", "amplitude_ratio_mean", "acceleration_mean_m_s2", "acceleration_least_m_s2",
    "acceleration_most_m_s2",
)  # fmt: skip


def _title(args: Args) -> str:
    shake = "the Sawyer's largest grip amplitude" if args.arm else f"{1e3 * args.amplitude:g} mm grip amplitude"
    way = "best horizontal direction" if args.axis == "best" else f"along {args.axis}"
    return f"mean flower acceleration at {shake}, {way}"


def _print(args: Args, result: dict[str, Any]) -> None:
    way = ", ".join(f"{x:+.2f}" for x in result["best_direction"])
    shake = f"{1000 * result['grip_amplitude_m']:.3g} mm at {result['best_frequency_hz']:.3g} Hz along ({way})"
    names = (f"flower_acceleration_{which}_m_s2" for which in ("mean", "least", "most"))
    mean, least, most = (f"{result[name]:.3g}" for name in names)
    nodes, height = result["flower_nodes"], 100 * result["best_grip_distance_m"]
    print(f"{args.skeleton}: {_title(args)}")
    table = Table(show_header=False, pad_edge=False)
    table.add_row("best grip", f"node {result['best_grip_node']}, {height:.1f} cm above the root along the plant")
    table.add_row("best shake", shake)
    table.add_row("acceleration", f"mean {mean} m/s² ({least} to {most}) over {len(nodes)} nodes")
    if len(nodes) <= LISTED:
        table.add_row("nodes observed", " ".join(str(node) for node in nodes))
    table.add_row("natural frequencies", ", ".join(f"{f:.3g}" for f in result["natural_frequencies_hz"]) + " Hz")
    table.add_row("their damping ratios", ", ".join(f"{ratio:.3f}" for ratio in result["damping_ratios"]))
    if args.out is not None:
        table.add_row("written", str(args.out))
    Console(markup=False).print(table)
    print("This is linear theory: whether stem and leaves bear the shake is not asked here. anther plan asks.")
    for limit in result["limits_passed"]:
        print(f"warning: beyond a limit that Anther keeps: {limit}")
    for note in result["notes"]:
        print(f"note: {note}")
