"""Choose the shake for a skeleton or a run, and explain it: limits, runner-up, what each flower should do, and why."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, get_args

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from anther.cli.skeletonize import best_grasps
from anther.core.errors import bad_input
from anther.core.files import read_object
from anther.core.geometry import Array
from anther.core.runs import FILES, kept
from anther.history.fruit_set import worth
from anther.perception.cloud import Cloud
from anther.perception.flowers import Flowers
from anther.perception.formats.skeletons import Units
from anther.perception.skeleton import Skeleton
from anther.perception.stem import Stem
from anther.plant.bench import read_material
from anther.plant.imported import main_stem, node_named, read_source
from anther.plant.limits import Crop, Preset, like_breeze  # fmt: skip
from anther.plant.model import PEPPER, TOMATO, Material, PlantModel, plant_with_flowers
from anther.pollination.grasp import Grasp, load_grasps
from anther.pollination.shake import (
    VIBRATING_GRIPPER,
    Actuator,
    Params,
    ShakePlan,
    arm_shaker,
    plan_shake,
    sawyer_limit,
    with_preset,
)
from anther.robot.cell import ActuatorName
from anther.show.pictures import save_figure
from anther.show.pictures.report import draw_plan
from anther.show.results import PARAMS

PEDICEL = 0.015
"""A flower named as a node of a skeleton hangs this far beyond it [m]: a pedicel (facts: pollination 2)."""


@dataclass(frozen=True)
class Args:
    """Attributes: the plant, what shakes it, and what for."""

    source: Annotated[Path, tyro.conf.Positional]
    """Run folder, or skeleton file (.npz, .swc, .txt, .ply, .graphml, .mtg)."""
    flower: tuple[int, ...] = ()
    """Of a skeleton file: nodes that bear a flower, numbered as in the file. By default flowers are supposed at the
    ends of the branches."""
    radius: float | None = None
    """Of a skeleton file without radii: of every node [m]; by default as thick as the crop's stem is at its base, and
    thinner with what a node carries."""
    units: Units | None = None
    """Of a skeleton file: of its lengths; by default what it states, else metres if that makes a plant."""
    root: str | None = None
    """Of a skeleton file: where the plant stands, a node's number or x,y,z [m]; by default the file's own root, or
    where it begins to rise."""
    stem_tip: str | None = None
    """Of a skeleton file: where the main stem ends, named likewise; by default it is found."""
    crop: Crop = "tomato"
    """Whose prior the material is, where neither the run nor --material tells it, and whose breeze the limits are
    likened to."""
    material: Path | None = None
    """What `anther identify` measured (material.json)."""
    actuator: ActuatorName = "arm"
    """The arm shakes the closed gripper, or the gripper vibrates by itself (10-40 Hz)."""
    shake: Preset | None = None
    """How boldly the plant may be loaded (docs/shake.md has the limits); by default what --params says. 'paper' is
    the paper's own shake, 12 mm at 1.9 Hz: no limit of the plant is kept and slip is not prevented."""
    lowest: float | None = None
    """Lowest frequency [Hz]; by default the actuator's."""
    highest: float | None = None
    """Highest frequency [Hz]; by default the actuator's."""
    frequencies: int | None = None
    """How many frequencies are tried."""
    out: Path | None = None
    """Folder for shake_plan.json and shake_plan.png."""
    json: bool = False
    """Print the plan as JSON."""
    params: Params = field(default_factory=Params)
    """Limits and search."""


def run(args: Args) -> None:
    """Plan the shake, print it, and write it to `out`."""
    plant, grasps = read_plant(args)
    run_params = args.source / PARAMS
    asked = read_object(run_params) if run_params.is_file() else {}
    crop: Crop = asked["plant"] if asked.get("plant") in get_args(Crop) else args.crop
    plan = plan_shake(plant, grasps, _actuator(args, str(asked.get("arm") or "sawyer")), _params(args))
    if args.out is not None:
        plan.save(args.out / "shake_plan.json")
        save_figure(draw_plan(plan), args.out / "shake_plan.png")
    if args.json:
        print(json.dumps(summary(plan, crop), indent=2))
    else:
        _print(args, plan, crop)


def _actuator(args: Args, arm: str) -> Actuator:
    """Return what shakes: this arm, by the Sawyer's table where no arm was asked for the grasp."""
    if args.actuator == "gripper":
        return VIBRATING_GRIPPER

    def limit(grasp: Grasp, direction: Array, frequencies: Array) -> Array:
        if grasp.joints is None:
            return sawyer_limit(grasp, direction, frequencies)
        from anther.robot.arm.arms import named  # needs the extra `cell`
        from anther.robot.arm.planner import shake_limit

        return shake_limit(named(arm), grasp.joints, direction, frequencies)

    return arm_shaker(limit)


def _params(args: Args) -> Params:
    given = {name: getattr(args, name) for name in ("lowest", "highest", "frequencies")}
    params = args.params if args.shake is None else with_preset(args.shake, args.params)
    return replace(params, **{name: value for name, value in given.items() if value is not None})


def read_plant(args: Args) -> tuple[PlantModel, list[Grasp]]:
    """Return the plant as rods, and the grasps to choose from."""
    measured = None if args.material is None else read_material(args.material)
    material = measured or {"tomato": TOMATO, "pepper": PEPPER}[args.crop]
    if not args.source.is_dir():
        return _of_skeleton(args, material)
    if args.flower or any(given is not None for given in (args.units, args.radius, args.root, args.stem_tip)):
        names = "--flower, --units, --radius, --root or --stem-tip"
        raise bad_input(names, given="with a run folder", allowed="skeleton files", do="Leave it out.")
    skeleton, stem = Skeleton.load(kept(args.source, "skeleton")), Stem.load(kept(args.source, "stem"))
    there = {stage: args.source / name for stage, name in FILES.items() if (args.source / name).exists()}
    cloud = Cloud.load(there["cloud"]) if "cloud" in there else None
    if "plant model" in there:
        plant = PlantModel.load(there["plant model"])
        plant = plant if measured is None else plant.with_material(measured)
    else:
        flowers = Flowers.load(there["flowers"]) if "flowers" in there else Flowers(np.zeros((0, 3)), np.zeros(0))
        plant = plant_with_flowers(skeleton, stem, flowers, cloud, material)
    return plant, load_grasps(there["grasp"]) if "grasp" in there else _grasps(stem, skeleton, cloud)


def _of_skeleton(args: Args, material: Material) -> tuple[PlantModel, list[Grasp]]:
    source, skeleton = read_source(args.source, units=args.units, radius=args.radius, root=args.root, crop=args.crop)
    at = np.array([source.node(number) for number in args.flower], dtype=np.int64)
    if np.any(at == 0):
        raise bad_input("flower", given="the root", allowed="a node of a branch or of the stem", do="Name another.")
    out = skeleton.nodes[at] - skeleton.nodes[skeleton.parent[at]]
    out *= PEDICEL / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9)
    flowers = Flowers(skeleton.nodes[at] + out, at)
    tip = None if args.stem_tip is None else source.node(node_named("--stem-tip", args.stem_tip, source))
    stem = main_stem(skeleton, tip, flowers.positions)
    plant = plant_with_flowers(skeleton, stem, flowers, None, material)
    return replace(plant, notes=(*stem.notes, *plant.notes)), _grasps(stem, skeleton, None)


def _grasps(stem: Stem, skeleton: Skeleton, cloud: Cloud | None) -> list[Grasp]:
    """Return grasps of the stem; without a cloud, clear of the skeleton's own nodes."""
    return best_grasps(stem, skeleton, cloud or Cloud(skeleton.nodes))[0]


def summary(plan: ShakePlan, crop: Crop) -> dict[str, Any]:
    """Return the plan as numbers with names [SI units]."""
    grasp, other = plan.grasp, plan.runner_up
    names = ("name", "value", "limit", "as_in_a_breeze_of", "share")
    flowers = zip(plan.predicted_amplitude, plan.predicted_amplitude_interval, plan.predicted_acceleration, strict=True)
    return {
        "grasp": plan.grasp_index + 1,
        "grasp_point": grasp.point.tolist(),
        "grasp_arc_length": grasp.arc_length,
        "direction": plan.direction.tolist(),
        "amplitude": plan.amplitude,
        "frequency": plan.frequency,
        "duration": plan.duration,
        "score": plan.score,
        "flowers": [{"amplitude": a, "interval": i.tolist(), "acceleration": s} for a, i, s in flowers],
        "limits": [
            dict(zip(names, (name, value, limit, like_breeze(name, limit, crop), share), strict=True))
            for name, value, limit, share in plan.limits
        ],
        "runner_up": None if other is None else {n: getattr(other, n) for n in ("frequency", "amplitude", "score")},
        "worth": worth(plan.predicted_acceleration, crop),
        "reason": plan.reason,
        "notes": list(plan.notes),
    }


def _print(args: Args, plan: ShakePlan, crop: Crop) -> None:
    console = Console(width=100, markup=False, highlight=False)
    console.print(plan.reason)
    limits = Table("limit", "planned", "allowed", "as in a breeze of", "used", title="How close each limit is")
    for name, value, limit, share in plan.limits:
        style, wind = "bold" if share > 0.9 else None, like_breeze(name, limit, crop)
        limits.add_row(name, f"{value:.3g}", f"{limit:.3g}", wind, f"{share:.0%}", style=style)
    console.print(limits)
    flowers = Table("flower", "mm", "9 of 10 scenarios", "m/s2", title="What each flower should do")
    rows = zip(plan.predicted_amplitude, plan.predicted_amplitude_interval, plan.predicted_acceleration, strict=True)
    for k, (amplitude, (low, high), jolt) in enumerate(rows):
        between = f"{1e3 * low:.2f} to {1e3 * high:.2f}"
        flowers.add_row(str(k + 1), f"{1e3 * amplitude:.2f}", between, f"{jolt:.1f}")
    console.print(flowers)
    console.print(worth(plan.predicted_acceleration, crop))
    for note in plan.notes:
        console.print(f"note: {note}")
    if args.actuator == "gripper":
        console.print("note: no such gripper is built: this is what one would change.")
    if args.out is not None:
        console.print(f"written: {args.out}")
