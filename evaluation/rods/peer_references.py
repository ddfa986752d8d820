"""Trajectories stored from the peer solver dismech-python, and the planar network converged in the time step."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from anther.rods import Clamp, Drive, Rods, equilibrium, simulate
from evaluation.rods.beams import X_AXIS
from evaluation.rods.table import Array, Row

LIMIT = 1e-6
STATIC = ("cantilever_static_small", "cantilever_static_large")
MOVING = (
    "cantilever_free_dt0.001",
    "cantilever_free_dt0.0001",
    "branched_planar_x_2Hz",
    "branched_planar_x_10Hz",
    "branched_planar_x_10Hz_damped",
    "branched_planar_x_30Hz",
)
PEER_AMPLITUDE, PYELASTICA_AMPLITUDE = 15.6e-3, 16.2e-3
"""Stem-top amplitude [m] of the planar network at 10 Hz: the peer at dt 5e-5 s, and PyElastica (data README)."""
WINDOW = (0.2, 0.5)
"""Over these times [s] half the peak-to-peak of x reproduces both figures that the data's README states for the peer:
15.6 mm at dt 5e-5 s, and 24 % less at 1 ms."""


def reference(folder: Path, name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the arrays and the parameters of a stored reference."""
    with np.load(folder / f"{name}.npz") as stored:
        arrays = {key: stored[key] for key in stored.files if key != "params"}
        return arrays, json.loads(str(stored["params"]))


def reference_rods(arrays: dict[str, Any], setup: dict[str, Any], discretisation: Any = "paper") -> Rods:
    """Return the reference's rods; every edge of these cases runs from the parent to the child."""
    parent = np.full(len(arrays["nodes0"]), -1)
    parent[arrays["edges"][:, 1]] = arrays["edges"][:, 0]
    drag = setup.get("damping_per_node_Ns_per_m") or 0.0
    return Rods(
        arrays["nodes0"], parent, setup["r"], setup["E"], setup["rho"], node_drag=drag, discretisation=discretisation
    )


def reference_cases(folder: Path, quick: bool) -> list[Row]:
    """Return one row per stored file: the largest distance of any node at any time."""
    rows = []
    for name in STATIC:
        arrays, setup = reference(folder, name)
        settled = equilibrium(reference_rods(arrays, setup), Clamp(np.array([0, 1])))
        error = float(np.abs(settled - arrays["traj"][-1]).max())
        rows.append(Row(f"peer_{name}", f"peer, {name}, all nodes", error, LIMIT, "m"))
    for name in MOVING:
        if quick and name.endswith("dt0.0001"):
            continue
        arrays, setup = reference(folder, name)
        mine, steps = replay(arrays, setup, 300 if quick else len(arrays["traj"]) - 1)
        error = float(np.abs(mine - arrays["traj"][: len(mine)]).max())
        what = f"peer, {name} (implicit Euler, dt {setup['dt']:g} s, {steps} steps), all nodes and times"
        rows.append(Row(f"peer_{name}", what, error, LIMIT, "m"))
    return rows


def replay(arrays: dict[str, Any], setup: dict[str, Any], frames: int) -> tuple[Array, int]:
    """Return (frames + 1, N, 3) positions with the peer's own settings, and the number of steps."""
    grip = setup.get("drive_node")
    drive = None if grip is None else Drive(grip, X_AXIS, setup["amp"], setup["freq"])
    clamp = Clamp(np.array([n for n in arrays["fixed_nodes"] if n != grip]))
    every = round((arrays["t"][1] - arrays["t"][0]) / setup["dt"])
    steps = frames * every
    run = simulate(
        reference_rods(arrays, setup),
        clamp,
        drive,
        steps * setup["dt"],
        setup["dt"],
        integrator="implicit_euler",
        start="scanned",
        tolerance=1e-10,
        record_every=every,
    )
    return run.positions, steps


def planar_cases(folder: Path, quick: bool) -> list[Row]:
    """Return the rows of the planar network at 10 Hz as the time step goes to zero."""
    steps = np.array([1e-3, 5e-4, 2.5e-4] if quick else [1e-3, 5e-4, 2.5e-4, 1.25e-4])
    arrays, setup = reference(folder, "branched_planar_x_10Hz")
    rods = reference_rods(arrays, setup)
    midpoint = np.array([stem_top(rods, setup, dt, "midpoint") for dt in steps])
    converged = midpoint[-1] + (midpoint[-1] - midpoint[-2]) / 3
    outside = max(0.0, PEER_AMPLITUDE / converged - 1, converged / PYELASTICA_AMPLITUDE - 1)
    detail = f"midpoint {_list(midpoint)} mm at dt {_list(steps)} ms, extrapolated {1e3 * converged:.2f} mm"
    for dt in [1e-3] if quick else [1e-3, 5e-5]:
        detail += f"; implicit Euler {1e3 * stem_top(rods, setup, dt, 'implicit_euler'):.2f} mm at dt {dt:g} s"
    sound = stem_top(reference_rods(arrays, setup, "consistent"), setup, float(steps[-1]), "midpoint")
    detail += f"; second order at forks and kinks instead of P19: {1e3 * sound:.2f} mm at dt {1e3 * steps[-1]:g} ms"
    what = (
        "branched planar, 10 Hz, dt to 0, P19: stem top's half peak-to-peak x over "
        f"{WINDOW[0]:g}–{WINDOW[1]:g} s lies between the peer's 15.6 mm and PyElastica's 16.2 mm (how far outside)"
    )
    return [Row("planar_10Hz_converged", what, outside, 0.02, "%", detail)]


def stem_top(rods: Rods, setup: dict[str, Any], dt: float, integrator: Any) -> float:
    """Return the stem top's amplitude [m] as `WINDOW` defines it."""
    run = simulate(
        rods,
        Clamp(np.array([0, 1])),
        Drive(setup["drive_node"], X_AXIS, setup["amp"], setup["freq"]),
        WINDOW[1],
        dt,
        integrator=integrator,
        start="scanned",
        tolerance=1e-10,
        record_every=round(1e-3 / dt),
    )
    return float(np.ptp(run.positions[run.times >= WINDOW[0] - 1e-9, 50, 0]) / 2)


def _list(values: Array) -> str:
    return ", ".join(f"{1e3 * v:.4g}" for v in values)
