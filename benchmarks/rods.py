"""Speed of the rod engine: the 86-node branched network, shaken, and a response map of a 200-node plant.

    python benchmarks/rods.py --json docs/results/rods.json

Keys: us_per_newton_86_twist [us], s_per_sim_s_86_twist [s], response_map_s [s] (50 grips x 200 frequencies x 3
directions, 5 observed nodes; --quick takes a tenth of the frequencies). Processor time, best of the repeats, after
compilation.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import track

from anther.elastic_rod import Clamp, Drive, Rods, response_map, simulate, with_gravity_equilibrium
from anther.files import write_json


def network(stem: int, branches: int, edges: int, *, youngs: float, step: float = 0.01) -> Rods:
    """A vertical stem of `stem` nodes; its `branches` of `edges` edges leave at 45 degrees, turned by 137.5 degrees."""
    nodes = [np.array([0, 0, step * k]) for k in range(stem)]
    parent = list(range(-1, stem - 1))
    for b in range(branches):
        turn = np.radians(137.5 * b)
        outward = np.array([np.cos(turn), np.sin(turn), 1]) / np.sqrt(2)
        at = 15 + b * (stem - 20) // max(branches, 1)
        for k in range(1, edges + 1):
            parent.append(at if k == 1 else len(nodes) - 1)
            nodes.append(nodes[at] + step * k * outward)
    return Rods(np.array(nodes), np.array(parent), edge_radius=3e-3, youngs=youngs, density=1000.0, viscous_time=1e-4)


def best_of(repeats: int, work: Callable[[], Any], name: str) -> tuple[float, Any]:
    """Shortest processor time [s] of several runs, and the last result."""
    times, result = [], None
    for _ in track(range(repeats), name):
        start = time.process_time()
        result = work()
        times.append(time.process_time() - start)
    return min(times), result


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--seed", type=int, default=0, help="unused: nothing is random here")
    args = parser.parse_args()
    rods = network(51, 5, 7, youngs=2e8)
    clamp, seconds = Clamp.root(rods), 0.2 if args.quick else 1.0
    rods = with_gravity_equilibrium(rods, clamp)
    drive = Drive(20, np.array([1.0, 0, 0]), 5e-3, 10.0)
    simulate(rods, clamp, drive, duration=0.01, dt=1e-3)
    taken, run = best_of(3, lambda: simulate(rods, clamp, drive, duration=seconds, dt=1e-3), "shake")
    plant = network(130, 10, 7, youngs=5e9)  # 1.3 m tall: stiff enough to stand
    plant = with_gravity_equilibrium(plant, Clamp.root(plant))
    frequencies = np.geomspace(1, 35, 20 if args.quick else 200)
    grips, observed = np.arange(20, 120, 2), np.arange(len(plant.nodes) - 35, len(plant.nodes), 7)

    def full_map() -> Any:
        return response_map(plant, Clamp.root(plant), grips, np.eye(3), frequencies, observe=observed)

    full_map()
    mapped, _ = best_of(3, full_map, "response map")
    metrics = {
        "us_per_newton_86_twist": 1e6 * taken / int(np.sum(run.newton_iterations)),
        "s_per_sim_s_86_twist": taken / seconds,
        "response_map_s": mapped,
        "response_map_frequencies": len(frequencies),
    }
    print(json.dumps(metrics, indent=2))
    if args.json:
        write_json(args.json, metrics)


if __name__ == "__main__":
    main()
