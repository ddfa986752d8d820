"""Choose the shake for a skeleton or a run, and explain it; or simulate one shake, or map all, of the same plant."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any, cast, get_args

from rich.console import Console
from rich.table import Table

from anther.cli.args.plan import Args
from anther.cli.output import room_for
from anther.cli.skeletonize import best_grasps
from anther.core.choices import Crop
from anther.core.errors import bad_input
from anther.core.files import read_object
from anther.core.geometry import Array
from anther.core.runs import FILES, kept
from anther.history.fruit_set import worth
from anther.perception.cloud import Cloud
from anther.perception.skeleton import Skeleton
from anther.perception.stem import Stem
from anther.plant.bench import read_material
from anther.plant.limits import like_breeze
from anther.plant.source import Properties, SourcePlant, read_plant
from anther.pollination.grasp import Grasp, load_grasps
from anther.pollination.shake import (
    VIBRATING_GRIPPER,
    Actuator,
    Params,
    ShakePlan,
    any_arm,
    arm_shaker,
    plan_shake,
    sawyer_limit,
    with_preset,
)
from anther.rods import with_gravity_equilibrium
from anther.show.pictures import save_figure
from anther.show.pictures.report import draw_plan
from anther.show.results import PARAMS

MATERIAL = ("youngs", "density", "bend_over_twist", "damping_ratio")
WRITTEN = ("shake_plan.json", "shake_plan.png")


def run(args: Args) -> None:
    """Plan the shake, print it, and write it to `out`; or simulate or map instead."""
    if args.simulate and args.map:
        raise bad_input("options", given="--simulate and --map", allowed="one of them", do="Leave one out.")
    if args.simulate or args.map:
        from anther.cli import plan_map, plan_simulation

        (plan_map if args.map else plan_simulation).run(args, plant_in_time(args))
        return
    if args.rods.bare:
        raise bad_input("bare", given="no --simulate or --map", allowed="one of them", do="Leave --bare out.")
    asked, crop = _asked(args), _crop(args)
    out = room_for(args, WRITTEN)
    source, skeleton, stem, cloud = read(args)
    assert source.model is not None
    grasps = _grasps(args, skeleton, stem, cloud)
    plan = plan_shake(source.model, grasps, _actuator(args, str(asked.get("arm") or "sawyer")), _params(args))
    if out is not None:
        plan.save(out / WRITTEN[0])
        save_figure(draw_plan(plan), out / WRITTEN[1])
    if args.json:
        print(json.dumps(summary(plan, crop) | {"stiffness": source.stiffness}, indent=2))
    else:
        _print(args, plan, crop, source)


def _asked(args: Args) -> dict[str, Any]:
    """Return what the run was asked for; nothing of a file."""
    return read_object(args.source / PARAMS) if (args.source / PARAMS).is_file() else {}


def _crop(args: Args) -> Crop:
    """Return what the run was of; of a skeleton file what was said."""
    was = _asked(args).get("plant")
    return cast(Crop, was) if was in get_args(Crop) else args.species


def read(args: Args) -> tuple[SourcePlant, Skeleton | None, Stem | None, Cloud | None]:
    """Return what `read_plant` does of what is asked."""
    given = {name: getattr(args.rods, name) for name in MATERIAL}
    changes = {name: value for name, value in given.items() if value is not None}
    measured = None if args.material is None else read_material(args.material)
    return read_plant(
        args.source,
        Properties(_crop(args), measured, changes, args.rods.radius, args.rods.least_radius),
        flowers=() if args.source.is_dir() and (args.simulate or args.map) else args.flower,
        units=args.units,
        up=args.up,
        root=args.root,
        stem_tip=args.stem_tip,
        bare=args.rods.bare,
        hanging=not _stress_free(args),
    )


def plant_in_time(args: Args) -> SourcePlant:
    """Return the plant with the discretisation and at the rest that are asked for."""
    plant = read(args)[0]
    if not _stress_free(args) and args.rods.discretisation == plant.rods.discretisation:
        return plant
    rods = replace(plant.rods, discretisation=args.rods.discretisation, natural=None)
    return replace(plant, rods=rods if _stress_free(args) else with_gravity_equilibrium(rods, plant.clamp))


def _stress_free(args: Args) -> bool:
    return args.simulate and args.simulation.rest == "stress-free"


def _grasps(args: Args, skeleton: Skeleton | None, stem: Stem | None, cloud: Cloud | None) -> list[Grasp]:
    """Return the grasps to choose from: a run's; without a cloud, clear of the skeleton's own nodes."""
    if (args.source / FILES["grasp"]).exists():
        return load_grasps(args.source / FILES["grasp"])
    if skeleton is None or stem is None:
        skeleton, stem = Skeleton.load(kept(args.source, "skeleton")), Stem.load(kept(args.source, "stem"))
    return best_grasps(stem, skeleton, cloud or Cloud(skeleton.nodes))[0]


def _actuator(args: Args, arm: str) -> Actuator:
    """Return what shakes: this arm, by the Sawyer's table where no arm was asked for the grasp."""
    if args.actuator == "gripper":
        return VIBRATING_GRIPPER

    def limit(grasp: Grasp, direction: Array, frequencies: Array) -> Array:
        if grasp.joints is None:
            return sawyer_limit(grasp, direction, frequencies)
        from anther.robot.arm.arms import find_arm  # needs the extra `cell`
        from anther.robot.arm.planner import shake_limit

        return shake_limit(find_arm(arm), grasp.joints, direction, frequencies)

    def delivers(grasp: Grasp, directions: Array, frequencies: Array) -> tuple[Array, Array]:
        if grasp.joints is None:
            return any_arm(grasp, directions, frequencies)
        from anther.robot.arm.arms import find_arm
        from anther.robot.arm.compliance import delivered

        return delivered(find_arm(arm), grasp.joints, directions, frequencies)

    return arm_shaker(limit, delivers)


def _params(args: Args) -> Params:
    given = {name: getattr(args, name) for name in ("lowest", "highest", "frequencies")}
    params = args.params or Params()
    params = params if args.shake is None else with_preset(args.shake, params)
    return replace(params, **{name: value for name, value in given.items() if value is not None})


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


def _print(args: Args, plan: ShakePlan, crop: Crop, source: SourcePlant) -> None:
    console = Console(markup=False, highlight=False)
    console.print(plan.reason)
    console.print(f"stiffness: {source.stiffness}")
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
    for note in dict.fromkeys((*source.notes, *plan.notes)):
        console.print(f"note: {note}")
    if args.actuator == "gripper":
        console.print("note: no such gripper is built: this is what one would change.")
    if args.out is not None:
        console.print(f"written: {args.out}")
