"""What would a gripper that vibrates at up to 50 Hz change, against an arm that shakes?

    python experiments/actuators.py --figure docs/pictures/actuators.png

Simulated plants with their true rods (positions, radii, masses, stiffness), believed with the crop prior's spread;
five grasps on each stem, the Sawyer's table of amplitudes (facts: sawyer 6) or `VibratingGripper`, each with the
proposed limit of pedicel strain (0.5 %) and with 2 %, since no measured one exists (facts: pollination, "Not found").
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.console import Console
from rich.progress import track
from rich.table import Table
from twist_plants import Builder

from anther.elastic_rod import Clamp, least_stiffness, with_gravity_equilibrium
from anther.errors import StageFailure
from anther.files import replacing, write_json
from anther.grasp import Grasp
from anther.plant import TOMATO, PlantModel
from anther.sim.pepper import grow_pepper
from anther.sim.plant import Organ, SimPlant
from anther.sim.tomato import grow_tomato
from anther.vibration import WAVEFORMS, ArmShaker, Params, ShakePlan, VibratingGripper, plan_shake

ACTUATORS = {"arm": ArmShaker(), "vibrating gripper": VibratingGripper()}
STRAINS = (0.005, 0.02)
HEIGHTS = (0.2, 0.35, 0.5, 0.65, 0.8)
"""Grasps, in shares of the stem's length."""
COLOURS = {"arm": "#2f7d4f", "vibrating gripper": "#c2389a"}


def true_model(plant: SimPlant) -> PlantModel:
    """Return a simulated plant as the planner would know it at best."""
    built = Builder(plant)
    rods, n = built.rods(), len(built.nodes)
    stem = [int(k) for k in plant.stem_segments()]
    stem_nodes = np.array([0, *(node for k in stem for node in built.nodes_of[k])])
    of_pedicel = np.zeros(n, dtype=bool)
    for k in np.flatnonzero(plant.organ == Organ.PEDICEL):
        of_pedicel[built.nodes_of[k]] = True
    arms = np.flatnonzero(of_pedicel[rods.parent] & (np.arange(n) > 0))
    of_pedicel[arms] = True  # a flower's mass on its arm
    flowers = [max(np.flatnonzero(rods.parent == built.last[k]), default=built.last[k]) for k in plant.flower_segment]
    leaving = [k for k in range(len(plant.start)) if k not in stem and plant.parent[k] in stem]
    least = least_stiffness(rods, Clamp.root(rods))
    assert least is not None, "no stiffness holds this plant"
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(rods.nodes[stem_nodes], axis=0), axis=1))])
    youngs = float(np.asarray(rods.youngs)[1])
    rods = replace(rods, youngs=np.asarray(rods.youngs) * max(1.0, 1.5 * least))
    material = replace(
        TOMATO,
        youngs=youngs * max(1.0, 1.5 * least),
        density=float(np.asarray(rods.density)[1]),
        damping_ratio=float(plant.damping_ratio[0]),
        bend_over_twist=float(np.max(rods.bend_over_twist)),
    )
    return PlantModel(
        rods=with_gravity_equilibrium(rods, Clamp.root(rods)),
        stem_nodes=stem_nodes,
        arc_length=arc,
        flower_nodes=np.array(flowers),
        branch_bases=np.array([built.nodes_of[k][0] for k in leaving]),
        is_pedicel=of_pedicel,
        material=material,
        pedicel_spread=0.2,
        least_youngs=least * youngs,
    )


def grasps_on(plant: PlantModel) -> list[Grasp]:
    """Return horizontal grasps of the stem at `HEIGHTS`, from the arm's side."""
    pose = np.array([[0, 0, 1.0, 0], [0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    grasps = []
    for share in HEIGHTS:
        k = int(np.argmin(np.abs(plant.arc_length - share * plant.arc_length[-1])))
        point = plant.rods.nodes[plant.stem_nodes[k]]
        T = pose.copy()
        T[:3, 3] = point - [0.13, 0, 0]
        arc, way = float(plant.arc_length[k]), np.array([1.0, 0, 0])
        grasps.append(Grasp(T, point, np.array([0, 0, 1.0]), way, arc, 8e-3, 0.03, 1.0, "by height"))
    return grasps


def plans(plant: SimPlant, params: Params) -> dict[tuple[str, float], ShakePlan | str]:
    """Return the plan, or why there is none, for each actuator and limit of pedicel strain."""
    model, found = true_model(plant), dict[tuple[str, float], ShakePlan | str]()
    for name, actuator in ACTUATORS.items():
        for strain in STRAINS:
            try:
                plan = plan_shake(
                    model,
                    grasps_on(model),
                    actuator,
                    replace(params, plant=replace(params.plant, pedicel_strain=strain, base_strain=strain)),
                )
            except StageFailure as failure:
                found[name, strain] = str(failure)
            else:
                found[name, strain] = plan
    return found


def main() -> None:
    """Plan, print a table, write metrics and the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--quick", action="store_true", help="one plant of each crop, few frequencies, only sines")
    parser.add_argument("--seed", type=int, default=10, help="of the first plant")
    parser.add_argument("--figure", type=Path)
    args = parser.parse_args()
    count = 1 if args.quick else 4
    params = Params(frequencies=10, directions=2, heights=0, draws=1) if args.quick else Params(waveforms=WAVEFORMS)
    cases = [(grow, args.seed + k) for grow in (grow_tomato, grow_pepper) for k in range(count)]
    rows: list[tuple[str, float, str, ShakePlan | str, int]] = []
    for grow, seed in track(cases, "plants"):
        plant = grow(seed)
        label = f"{plant.species} {seed}"
        rows += [
            (name, strain, label, p, len(plant.flower_segment)) for (name, strain), p in plans(plant, params).items()
        ]
    Console().print(_table(rows, params))
    if args.json:
        write_json(args.json, metrics(rows, params))
    if args.figure:
        with replacing(args.figure) as temporary:
            draw(rows, params).savefig(temporary, dpi=110)


Rows = list[tuple[str, float, str, ShakePlan | str, int]]
"""(actuator, strain limit, plant, plan or why there is none, flowers) each."""


def metrics(rows: Rows, params: Params) -> dict[str, float]:
    """Return means over the plants for each actuator and strain limit; a plant without a shake gains nothing."""
    out: dict[str, float] = {"plants": len({label for _, _, label, _, _ in rows})}
    for name in ACTUATORS:
        for strain in STRAINS:
            mine = [(p, n) for a, s, _, p, n in rows if (a, s) == (name, strain)]
            planned = [(p, n) for p, n in mine if isinstance(p, ShakePlan)]
            key = f"{name.replace(' ', '_')}_{1000 * strain:g}_permille"
            out[f"{key}_planned"] = len(planned) / len(mine)
            out[f"{key}_added_share"] = float(np.mean([added(p, n, params) for p, n in mine]))
            if planned:
                out[f"{key}_acceleration"] = float(np.mean([np.median(p.predicted_acceleration) for p, _ in planned]))
                out[f"{key}_frequency"] = float(np.mean([p.frequency for p, _ in planned]))
                out[f"{key}_not_sine"] = float(np.mean([p.waveform.kind != "sine" for p, _ in planned]))
    return out


def added(plan: ShakePlan | str, flowers: int, params: Params) -> float:
    """Return the share of the flowers that sets because of the shake."""
    return plan.score / flowers - params.unshaken if isinstance(plan, ShakePlan) else 0.0


def _table(rows: Rows, params: Params) -> Table:
    table = Table("plant", "actuator", "pedicel limit", "shake", "flowers [m/s²]", "sets more", "limit that binds")
    for name, strain, label, plan, flowers in rows:
        if isinstance(plan, str):
            table.add_row(label, name, f"{strain:.1%}", "none", "", "", plan.split(". ")[-2])
            continue
        shape = "" if plan.waveform.kind == "sine" else f", {plan.waveform.kind}"
        binds = max(plan.limits, key=lambda row: row[3])[0].split(" [")[0]
        jolt, more = np.median(plan.predicted_acceleration), added(plan, flowers, params)
        shake = f"{1e3 * plan.amplitude:.2g} mm, {plan.frequency:.3g} Hz{shape}"
        table.add_row(label, name, f"{strain:.1%}", shake, f"{jolt:.1f}", f"{more:+.1%}", binds)
    return table


def draw(rows: Rows, params: Params) -> Figure:
    """Return a figure: the flowers' acceleration over frequency, and what it adds to fruit set."""
    figure = Figure(figsize=(10, 4), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    labels = []
    for place, (name, strain) in enumerate((name, strain) for strain in STRAINS for name in ACTUATORS):
        mine = [(p, n) for a, s, _, p, n in rows if (a, s) == (name, strain)]
        planned = [p for p, _ in mine if isinstance(p, ShakePlan)]
        label = f"{name}\npedicels ≤ {strain:.1%}"
        labels.append(label)
        marker = "o" if strain == STRAINS[0] else "^"
        jolts = [np.median(p.predicted_acceleration) for p in planned]
        left.plot([p.frequency for p in planned], jolts, marker, color=COLOURS[name], label=label.replace("\n", ", "))
        shares = [100 * added(p, n, params) for p, n in mine]
        right.bar(place, np.mean(shares), color=COLOURS[name], alpha=1 if strain == STRAINS[0] else 0.6)
        right.plot(np.full(len(shares), place), shares, ".", color="black", ms=4)
    left.set(xscale="log", yscale="log", xlabel="frequency [Hz]", ylabel="median flower acceleration [m/s²]")
    left.set_xticks([5, 10, 20, 50], ["5", "10", "20", "50"])
    left.minorticks_off()
    left.axhline(params.half_dose, color="grey", lw=0.8, ls="--")
    left.annotate("frees half of the pollen", (0.02, params.half_dose * 0.82), xycoords=("axes fraction", "data"))
    left.legend(frameon=False, fontsize=8)
    right.set_xticks(range(len(labels)), labels, fontsize=8)
    right.set_ylabel("flowers that set because of the shake [%]")
    return figure


if __name__ == "__main__":
    main()
