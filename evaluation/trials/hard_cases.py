"""Hard cases, each as whole trials: from noisy images to a physical grasp and shake, judged as in `grasping.py`.

    python -m evaluation.trials.hard_cases --quick --jobs 2

| case | what is hard |
|---|---|
| plain | nothing: the same plants as they grow, to compare with |
| leaning | the whole plant leans by 20 degrees |
| two stems | another plant, three quarters of its size, stands in the same pot, 5 cm beside; the root is named |
| dense | every leaf twice |
| edge of reach | the pot stands 0.90 m in front of the arm, instead of 0.72 m |
| pot shifted | the pot stands 5 cm to the side and 4 cm further than the cell's layout says |
| wind | the plant sways while the images are taken: every view finds it elsewhere |
| hand-eye | the camera is 5 mm from where the calibration says |
| view lost | one of the 30 views is missing |

Plants are of seeds that no other experiment uses. Finished trials are kept in --out and not run again. Keys of the
--json file: trials_CASE, success_CASE (held and unharmed), stem_held_CASE, what `grasping_table.effects` says of harm
and flowers, with _CASE behind it, sway_mm (the widest of the wind), and CASE_KIND, how many failed of which kind.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import RenderableType

from anther.core import Advance, Array
from anther.core.geometry import interpolate
from anther.perception import Capture
from anther.perception.capture import Keep
from anther.perception.skeleton import Params as SkeletonParams
from anther.plant import PRIORS, Crop
from anther.pollination import Params, pollinate
from anther.robot import guard
from anther.robot.arm.sawyer import SAWYER, TOOL
from anther.sim import Scene, SimPlant, SimulatedCell, build, grow, grow_pepper, grow_tomato, photograph
from anther.sim import cell as world
from anther.sim.capture import capture_views, perturbed_hand_eye
from anther.sim.robot import robot_of
from anther.sim.simulated_cell import PRESETS, USUAL_DISTANCE
from evaluation.harness import CROPS, failed, finish, options, run_cases
from evaluation.tables import by_part, markdown
from evaluation.trials.grasping_table import effects, told_effects
from evaluation.trials.grasping_trial import Memory, notes, performed, watched
from evaluation.trials.hard_plants import denser, leaning, sway, swaying, two_stems

CASES = (
    "plain", "leaning", "two stems", "dense", "edge of reach", "pot shifted", "wind", "hand-eye", "view lost",
)  # fmt: skip
FAR, SHIFT, HAND_EYE = 0.90, (0.04, 0.05), 0.005  # m
TakeViews = Callable[[Advance, Keep], Capture]


@dataclass(frozen=True)
class Case:
    """One plant in one kind of trouble."""

    kind: str
    species: Crop
    seed: int


def plant_of(case: Case, plant: SimPlant, rng: np.random.Generator) -> SimPlant:
    """Return the plant as the case has it."""
    match case.kind:
        case "leaning":
            return leaning(plant, rng)
        case "dense":
            return denser(plant, rng)
        case "two stems":
            return two_stems(plant, grow(case.species, case.seed + 500, 0.0, USUAL_DISTANCE), rng)
        case "pot shifted":
            x, y = plant.pot.centre[:2] + SHIFT
            return (grow_tomato if case.species == "tomato" else grow_pepper)(case.seed, axis=(float(x), float(y)))
    return plant


def views_of(case: Case, plant: SimPlant, joints: Array, rng: np.random.Generator) -> tuple[TakeViews, float]:
    """Return how the case takes its views, and how far the plant sways meanwhile [m]."""
    scene = Scene.of_plant(plant)
    match case.kind:
        case "wind":
            poses = swaying(plant, len(joints), rng)
            return lambda *_: swayed_views(plant, scene, joints, poses, case.seed), sway(plant, poses)
        case "hand-eye":
            off = perturbed_hand_eye(TOOL.T_flange_cam, rng, translation=HAND_EYE)
            shot = partial(capture_views, scene, joints, SAWYER.forward, off, TOOL.T_flange_cam, rng=rng)
            return lambda advance, _: shot(progress=advance)[0], 0.0
        case "view lost":
            left = np.delete(np.arange(len(joints)), rng.integers(len(joints)))
            return lambda advance, _: photograph(scene, joints, case.seed, progress=advance)[0].select(left), 0.0
    return lambda advance, _: photograph(scene, joints, case.seed, progress=advance)[0], 0.0


def swayed_views(plant: SimPlant, scene: Scene, joints: Array, poses: list[Array], seed: int) -> Capture:
    """Return views of a plant that stands elsewhere in each; the hand-eye error is the same in all."""
    off = perturbed_hand_eye(TOOL.T_flange_cam, np.random.default_rng([seed, 1]))
    shots = []
    for i, (q, T) in enumerate(zip(joints, poses, strict=True)):
        moved, rng = scene.moved(plant.posed_vertices(T)), np.random.default_rng([seed, 2, i])
        shots.append(capture_views(moved, q[None], SAWYER.forward, off, TOOL.T_flange_cam, rng=rng)[0])
    depth, pose = (np.concatenate([getattr(shot, name) for shot in shots]) for name in ("depth", "T_world_cam"))
    rgb = np.concatenate([shot.rgb for shot in shots if shot.rgb is not None])
    return Capture(depth, shots[0].intrinsics, pose, rgb)


def cell_of(case: Case) -> tuple[SimulatedCell, float]:
    """Return the case's cell, and how far its plant sways while the views are taken [m]."""
    distance = FAR if case.kind == "edge of reach" else USUAL_DISTANCE
    usual = build(case.species, case.seed, 0.0, PRESETS["full"], distance=distance)
    rng = np.random.default_rng([case.seed, CASES.index(case.kind), 3])
    plant = plant_of(case, usual.plant, rng)
    take_views, swayed = views_of(case, plant, usual.views.joints, rng)
    mujoco = world.Cell(plant, usual.world.joints)
    robot = guard(robot_of(mujoco), usual.robot_side.limits)
    return replace(
        usual, plant=plant, world=mujoco, robot_side=replace(usual.robot_side, take_views=take_views, robot=robot)
    ), swayed


def params_of(case: Case, plant: SimPlant) -> Params:
    """Return the stages' parameters: of two stems in one pot the foot of the asked one is named."""
    if case.kind != "two stems":
        return Params()
    x, y, z = plant.start[0].tolist()
    return Params(skeleton=SkeletonParams(root=(x, y, z)))


def one_trial(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return what became of a case, for a sweep."""
    case, run = Case(**row), Memory(folder)
    cell, swayed = cell_of(case)
    material = PRIORS[case.species]
    told, done = performed(cell, lambda: pollinate(watched(cell, run), material, run, params_of(case, cell.plant)))
    told |= {"sway_m": swayed, "attempts": run.tries["execution"], "notes": notes(run)}
    told["beside_stem_m"] = None if done is None else beside_stem(cell.plant, done.shake.grasp.point)
    return asdict(case) | told


def beside_stem(plant: SimPlant, point: Array) -> float:
    """Return the distance of a point (3,) from the main stem's true centreline [m]."""
    line, _, along = plant.stem_centreline()
    dense = interpolate(np.linspace(0, along[-1], 1000), along, line)
    return float(np.linalg.norm(dense - point, axis=1).min())


def metrics(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Return the flat table."""
    out: dict[str, float] = {"sway_mm": 1000 * max(row.get("sway_m", 0.0) for row in rows)}
    for kind in CASES:
        some = [row for row in rows if row["kind"] == kind]
        if some:
            name = kind.replace(" ", "_")
            out |= {f"trials_{name}": len(some), f"success_{name}": sum(row["success"] for row in some) / len(some)}
            out[f"stem_held_{name}"] = sum(row.get("stem_held", False) for row in some) / len(some)
            out |= {f"{key}_{name}": value for key, value in effects(some).items()}
            failures = Counter(row["failure"] for row in some if not row["success"])
            out |= {f"{name}_{failure}": count for failure, count in failures.items()}
    return out


def report(rows: list[dict[str, Any]], found: dict[str, float]) -> list[RenderableType]:
    """Return how each case went, and every failure."""
    numbers = {
        "trials": "trials_*:.0f",
        "held and unharmed": "success_*:.0%",
        "main stem held": "stem_held_*:.0%",
        **told_effects("{}_*"),
    }
    kinds = {kind.replace(" ", "_"): kind for kind in CASES}
    failed = [
        (f"{row['kind']}, {row['species']} {row['seed']}", row["failure"], f"{row['message']}{_aim(row)}")
        for row in rows
        if not row["success"]
    ]
    said = "What became of the trials; of flowers and pollen the medians over trials."
    parts = [said, by_part(found, "case", kinds, numbers)]
    if not failed:
        return [*parts, "No trial failed."]
    return [*parts, "Trials that failed.", markdown(("trial", "kind", "what happened"), failed)]


def _aim(row: dict[str, Any]) -> str:
    off = row.get("beside_stem_m")
    return "" if off is None else f"; aimed {1000 * off:.0f} mm beside the main stem's axis"


def main() -> None:
    """Run what is not there yet, print the table, write --json."""
    quick = "one plant of each species instead of three"
    own = {"--cases": (CASES, "these alone", CASES), "--plants": (3, "of each species")}
    args = options(__doc__, quick=quick, seed=(3000, "first seed"), jobs="trials", out="runs/hard_cases", own=own)
    seeds = range(args.seed, args.seed + (1 if args.quick else args.plants))
    cases = [asdict(Case(kind, crop, seed)) for kind in args.cases for crop in CROPS for seed in seeds]
    rows = run_cases(one_trial, cases, args.out, args.jobs, failed)
    found = metrics(rows)
    finish(args, found, *report(rows, found))


if __name__ == "__main__":
    main()
