"""`anther plan --map`: how a plant's flowers answer small shakes, over grip height and frequency, as CSV and PNG."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from anther.cli.args.plan import Args
from anther.cli.output import room_for
from anther.core.checks import check_range
from anther.core.errors import bad_input
from anther.core.files import write_json, write_text
from anther.plant.source import SourcePlant
from anther.pollination.grip_map import COLUMNS, GripMap, map_grips, natural_modes, neutral_amplitude
from anther.pollination.shake import VIBRATING_GRIPPER, arm_shaker
from anther.show.pictures import save_figure
from anther.show.pictures.rods import draw_grip_response

AXES = dict(zip("xyz", np.eye(3), strict=True))
WRITTEN = ("response_map.json", "response_map.csv", "response_map.png")


def run(args: Args, plant: SourcePlant) -> None:
    """Compute the map, print its best cell and the natural frequencies, and write the results to `out`."""
    size = 0.001 if args.amplitude is None else check_range("amplitude", args.amplitude, 1e-9, 1, "m")
    lowest = check_range("lowest", 1.0 if args.lowest is None else args.lowest, 1e-3, 1e4, "Hz")
    highest = check_range("highest", 35.0 if args.highest is None else args.highest, lowest, 1e4, "Hz")
    count = check_range("frequencies", 80 if args.frequencies is None else args.frequencies, 1, 10_000)
    check_range("heights", args.mapping.heights, 1, 10_000)
    out = room_for(args, WRITTEN)
    hertz = np.geomspace(lowest, highest, int(count))
    amplitude = neutral_amplitude(hertz) if args.mapping.arm else np.full(len(hertz), size)
    flowers = _flowers(args, plant)
    found = map_grips(
        plant,
        _grips(args, plant).tolist(),
        flowers,
        hertz,
        amplitude,
        directions=None if args.axis in (None, "best") else AXES[args.axis][None],
        pads=args.rods.pads,
        actuator=VIBRATING_GRIPPER if args.actuator == "gripper" else arm_shaker(),
    )
    result = summary(plant, found, flowers)
    if out is not None:
        write_json(out / WRITTEN[0], result)
        rows = (COLUMNS, *found.rows(plant))
        write_text(out / WRITTEN[1], "".join(",".join(row) + "\r\n" for row in rows))
        save_figure(draw_grip_response(plant.rods, flowers, found, _title(args, size)), out / WRITTEN[2])
    if args.json:
        print(json.dumps(result, indent=2))
    else:
        _print(args, result, _title(args, size))


def _flowers(args: Args, plant: SourcePlant) -> NDArray[Any]:
    """Return the nodes whose motion counts: those asked for, else the plant's flowers, else every free tip."""
    if args.flower:
        return np.array([plant.flower(number) for number in args.flower])
    if len(plant.flower_nodes):
        return plant.flower_nodes
    tips = np.setdiff1d(np.arange(1, len(plant.rods.parent)), plant.rods.parent)
    return np.setdiff1d(tips, plant.clamp.nodes)


def _grips(args: Args, plant: SourcePlant) -> NDArray[Any]:
    """Return the grip nodes by their distance from the root: those asked for, else free nodes of the main stem."""
    distance = plant.distances()
    if args.mapping.grips:
        nodes = np.unique([plant.node(number) for number in args.mapping.grips])
    else:
        stem = plant.stem_nodes
        # next to the soil a small shake is a long lever, which no stem bears
        low = min(0.05, 0.25 * float(distance[stem].max(initial=0.0)))
        free = np.setdiff1d(stem[distance[stem] >= low], plant.clamp.nodes)
        if not len(free):
            raise bad_input("grips", given="none", allowed="a stem that is seen and free", do="Name --grips.")
        nodes = free[np.unique(np.linspace(0, len(free) - 1, args.mapping.heights).round().astype(int))]
    return nodes[np.argsort(distance[nodes], kind="stable")]


def summary(plant: SourcePlant, found: GripMap, flowers: NDArray[Any]) -> dict[str, Any]:
    """Return the best cell that is allowed, null where none is, and the natural frequencies; units in the names."""
    hertz, ratios = natural_modes(plant)
    best: dict[str, Any] = dict.fromkeys(
        ("best_grip_node", "best_grip_distance_m", "best_frequency_hz", "best_direction", "grip_amplitude_m")
    )
    if found.best is not None:
        q, g = found.best
        there = found.acceleration[q, g]
        best = {
            "best_grip_node": int(plant.numbers[found.grips[g]]),
            "best_grip_distance_m": float(found.distance[g]),
            "best_frequency_hz": float(found.frequencies[q]),
            "best_direction": found.direction[q, g].tolist(),
            "grip_amplitude_m": float(found.amplitude[q]),
            "flower_acceleration_mean_m_s2": float(there.mean()),
            "flower_acceleration_least_m_s2": float(there.min()),
            "flower_acceleration_most_m_s2": float(there.max()),
            "flower_amplitude_ratio_mean": float(found.ratio[q, g].mean()),
        }
    return best | {
        "beyond_limits_share": float(1 - found.allowed.mean()),
        "stiffness": plant.stiffness,
        "notes": list(plant.notes),
        "natural_frequencies_hz": hertz.tolist(),
        "damping_ratios": ratios.tolist(),
        "flower_nodes": plant.numbers[flowers].tolist(),
        "grips": len(found.grips),
        "nodes": len(plant.rods.nodes),
    }


def _title(args: Args, size: float) -> str:
    shake = "the Sawyer's largest grip amplitude" if args.mapping.arm else f"{1e3 * size:g} mm grip amplitude"
    way = "best horizontal direction" if args.axis in (None, "best") else f"along {args.axis}"
    return f"mean flower acceleration at {shake}, {way}"


def _print(args: Args, result: dict[str, Any], title: str) -> None:
    print(f"{args.source}: {title}")
    table = Table(show_header=False, pad_edge=False)
    nodes = result["flower_nodes"]
    if result["best_grip_node"] is None:
        table.add_row("best shake", "none: all that was asked for is beyond a limit")
    else:
        way = ", ".join(f"{x:+.2f}" for x in result["best_direction"])
        size, hertz = 1e3 * result["grip_amplitude_m"], result["best_frequency_hz"]
        height = 100 * result["best_grip_distance_m"]
        mean, least, most = (result[f"flower_acceleration_{which}_m_s2"] for which in ("mean", "least", "most"))
        table.add_row("best grip", f"node {result['best_grip_node']}, {height:.1f} cm above the root along the plant")
        table.add_row("best shake", f"{size:.3g} mm at {hertz:.3g} Hz along ({way})")
        table.add_row("acceleration", f"mean {mean:.3g} m/s² ({least:.3g} to {most:.3g}) over {len(nodes)} flowers")
    if result["beyond_limits_share"]:
        table.add_row("not allowed", f"{result['beyond_limits_share']:.0%} of the map: beyond what `anther plan` keeps")
    if len(nodes) <= 12:
        table.add_row("flowers at nodes", " ".join(str(node) for node in nodes))
    table.add_row("natural frequencies", ", ".join(f"{f:.3g}" for f in result["natural_frequencies_hz"]) + " Hz")
    table.add_row("their damping ratios", ", ".join(f"{ratio:.3f}" for ratio in result["damping_ratios"]))
    table.add_row("stiffness", result["stiffness"])
    if args.out is not None:
        table.add_row("written", str(args.out))
    Console(markup=False).print(table)
    print("This is linear theory: whether stem and leaves bear the shake is not asked here. anther plan asks.")
    for note in result["notes"]:
        print(f"note: {note}")
