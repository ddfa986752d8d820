"""What learning changes: successive plants of a crop, each shaken with and without what the plants before it taught.

    python tools/record.py experiments/learning.py --figure docs/pictures/learning.png --out runs/learning --jobs 2

Each plant is seen in rendered views (preset fast), modelled, and its shake planned (the Sawyer's table of amplitudes,
facts: sawyer 6); MuJoCo's plant is held at the grasp and shaken (`shaken_plant`). What the camera would measure is
drawn from the truth with the stated errors of `SEEN`. Arm "facts" begins every plant with the facts' prior. In the
other, plants are visited twice: "crop", begun with what the history says of the crop, and "plant", begun with what the
plant's first shake taught. The history is a real one, in SQLite. A crop is one task of a sweep in --out, as each of
its plants needs those before it; a crop that was done is not done again.

Keys of the --json file: <crop>_<arm>_error, the mean |ln(true / predicted amplitude)| of a flower; _bias, its signed
mean; _within, the share of flowers inside the predicted interval (0.9 is right); _freed, the share of pollen that
leaves the flowers by the true accelerations, the median over what is not known of the dose; _acceleration, their mean
[m/s2]; _strain, the largest share of the stem's strain limit used; the same with _late for the last half of the plants;
and the crop's last belief.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from grasping_trial import truth_of
from learning_figure import draw
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.optimize import linear_sum_assignment
from shaken_plant import ShakenPlant
from swept import swept

from anther import cloud, masks, skeleton, stem
from anther.commands.simulated_cell import (
    PRESETS,
    USUAL_DISTANCE,
    Species,
    grow,
    in_wind,
    layout,
    photograph,
    views_at,
)
from anther.errors import StageFailure
from anther.files import replacing, write_json
from anther.flowers import find_flowers, flower_centres
from anther.geometry import Array
from anther.grasp import Grasp, plan_grasps
from anther.history import ShakeRecord, TrialRecord, add_missing, facts_prior, starting_material
from anther.identification import Observed, refine
from anther.plant import Material, PlantModel, build_plant
from anther.shake import Params as ShakeParams
from anther.shake import ShakePlan, plan_shake
from anther.sim.judge import pollen_freed
from anther.sim.plant import SimPlant
from anther.sim.render import Scene as Rendered
from anther.sim.truth import NOMINAL, Truth

ARMS = ("facts", "crop", "plant")
CROPS: tuple[Species, ...] = ("tomato", "pepper")
SEEN = (0.6, 0.08, 0.15e-3)
"""How often a flower's amplitude can be measured; its error, relative and absolute [m] (docs/reports/response.md)."""
MISJUDGED = (0.5, 2.5)
"""Under a truth that is not nominal the camera errs by this times what it says; a guess."""
SAME = 0.02
"""A found flower is the true one nearest to it if that is no farther away [m]."""
BEGIN = datetime(2026, 5, 1, tzinfo=UTC)


@dataclass(frozen=True)
class Visit:
    """One shake of one plant; the flowers' lists are of those found that are true ones.

    Attributes:
        arm: of `ARMS`.
        why: how the belief came about, or why nothing was shaken.
        shake: (Hz, m), or None.
        predicted, low, high, true, measured: amplitudes [m]; measured is None where the camera could not.
        freed: share of the pollen that leaves the flowers, the median over what is not known of the dose.
        acceleration: mean peak acceleration of all flowers [m/s2].
        strain: largest bending strain of the stem over its limit.
        before, after: the belief, as plain values.
    """

    arm: str
    why: str
    shake: tuple[float, float] | None
    predicted: list[float]
    low: list[float]
    high: list[float]
    true: list[float]
    measured: list[float | None]
    freed: float
    acceleration: float
    strain: float
    before: dict[str, float]
    after: dict[str, float]


@dataclass(frozen=True, eq=False)
class Scene:
    """A plant as truth and as perception has it: flowers[k] is the true number of found flower k, or -1."""

    truth: SimPlant
    around: Truth
    model: Any
    grasps: list[Grasp]
    flowers: NDArray[Any]


def see(species: Species, seed: int, around: Truth = NOMINAL) -> Scene:
    """Photograph a plant, perceive it, and rank its grasps. `Scene.model` makes the plant model of a material."""
    truth, place = grow(species, seed, 0.0, USUAL_DISTANCE, around), layout(USUAL_DISTANCE)
    views = views_at(USUAL_DISTANCE, PRESETS["fast"])
    sight = in_wind(truth, Rendered.of_plant(truth), views, around)
    capture, _ = photograph(sight, views.joints, seed, truth=around)
    labels = masks.segment(capture, place.workspace)
    points = cloud.fuse(capture, labels, place.workspace)
    tree, centres = skeleton.skeletonize(points), flower_centres(points)
    main = stem.find_stem(tree, flowers_at=centres)
    found = find_flowers(points, tree, main, centres=centres)
    gap = np.linalg.norm(found.positions[:, None] - truth.flower_position, axis=2)
    same = np.full(len(found.positions), -1)
    for k, true in zip(*linear_sum_assignment(gap), strict=True):
        same[k] = true if gap[k, true] < SAME else -1
    return Scene(truth, around, partial(build_plant, tree, main, found, points), plan_grasps(main, tree, points), same)


def visit(scene: Scene, arm: str, belief: Material, why: str, rng: np.random.Generator) -> Visit:
    """Plan a shake with a belief, shake the true plant, measure it, and learn."""
    before = asdict(belief)
    try:
        model: PlantModel = scene.model(belief)
        plan = plan_shake(model, scene.grasps)
        true, freed, jolt, strain = shaken(scene, plan)
    except StageFailure as failure:
        return Visit(arm, str(failure), None, [], [], [], [], [], 0.0, 0.0, 0.0, before, before)
    known = scene.flowers >= 0
    answer = np.where(known, true[scene.flowers], np.nan)
    share, relative, absolute = SEEN
    error = np.hypot(relative * answer, absolute)
    misjudged = 1.0 if scene.around == NOMINAL else float(np.exp(rng.uniform(*np.log(MISJUDGED))))
    measured = np.abs(answer + misjudged * error * rng.normal(size=len(answer)))
    faint = measured < 3 * absolute
    measured[(rng.random(len(answer)) > share)] = np.nan
    bound = np.where(faint & np.isfinite(measured), 3 * absolute, np.nan)
    measured[faint] = np.nan
    learned = refine(model, [Observed(plan, measured, error, bound)])
    low, high = plan.predicted_amplitude_interval[known].T
    return Visit(
        arm=arm,
        why=why,
        shake=(plan.frequency, plan.amplitude),
        predicted=plan.predicted_amplitude[known].tolist(),
        low=low.tolist(),
        high=high.tolist(),
        true=answer[known].tolist(),
        measured=[float(m) if np.isfinite(m) else None for m in measured[known]],
        freed=freed,
        acceleration=jolt,
        strain=strain,
        before=asdict(model.material),
        after=asdict(learned.material),
    )


def shaken(scene: Scene, plan: ShakePlan) -> tuple[Array, float, float, float]:
    """Return of the true flowers amplitudes (F,) [m], pollen freed and mean acceleration [m/s2], and the strain."""
    limits = ShakeParams()
    truth = scene.truth
    plant = ShakenPlant(truth, plan.grasp.point, plan.direction, truth=scene.around)
    done = plant.steady(plan.amplitude, plan.frequency)
    jolt = (2 * np.pi * plan.frequency) ** 2 * done.amplitude
    on_stem = np.isin(plant.mechanics.pieces.first, truth.stem_segments())
    strain = np.max([plant.mechanics.strain(q)[on_stem].max() for q in done.qpos])
    return done.amplitude, pollen_freed(jolt)[1], float(jolt.mean()), float(strain / limits.plant.stem_strain)


def one_crop(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the visits of each of a crop's plants in turn, and what is believed of the next, for a sweep."""
    species, history = row["species"], folder / "history.sqlite"
    plants = [
        [asdict(v) for v in visits(species, seed, history, BEGIN + timedelta(days=number), row["truth"])]
        for number, seed in enumerate(range(row["first"], row["first"] + row["plants"]))
    ]
    return {"visits": plants, "learned": asdict(starting_material(species, "the next", history).material)}


def visits(species: Species, seed: int, history: Path, day: datetime, truth: str) -> list[Visit]:
    """Return one plant's visits in the order of `ARMS`."""
    rng = np.random.default_rng([seed, 7])
    try:
        scene = see(species, seed, truth_of(truth, seed))
    except StageFailure as failure:
        empty = asdict(facts_prior(species))
        return [Visit(arm, str(failure), None, [], [], [], [], [], 0.0, 0.0, 0.0, empty, empty) for arm in ARMS]
    crop = starting_material(species, f"{seed}", history)
    unlearned = visit(scene, "facts", facts_prior(species), "the facts", rng)
    first = visit(scene, "crop", crop.material, crop.reason, rng)
    record(species, seed, first, history, day)
    own = starting_material(species, f"{seed}", history)
    second = visit(scene, "plant", own.material, own.reason, rng)
    record(species, seed, second, history, day + timedelta(hours=1))
    return [unlearned, first, second]


def record(species: str, seed: int, done: Visit, history: Path, time: datetime) -> None:
    """Keep a visit in the history, once, as `anther trial` would."""
    if done.shake is None:
        return
    amplitude = tuple(float("nan") if m is None else m for m in done.measured)
    trial = TrialRecord(
        species,
        f"{seed}",
        success=True,
        shake=ShakeRecord(*done.shake),
        predicted_amplitude=tuple(done.predicted),
        measured_amplitude=amplitude,
        believed=Material(**done.before),
        material=Material(**done.after),
        time=time,
    )
    add_missing(trial, history)


def summary(rows: Sequence[Visit]) -> dict[str, float]:
    """Return the numbers that the module's docstring names, over one arm's visits; errors are means over plants."""
    shaken_ones = [v for v in rows if v.true]
    miss = [np.log(np.array(v.true) / np.array(v.predicted)) for v in shaken_ones]
    held = [np.mean((np.array(v.low) <= v.true) & (np.array(v.true) <= v.high)) for v in shaken_ones]
    return {
        "error": float(np.mean([np.abs(m).mean() for m in miss])),
        "bias": float(np.mean([m.mean() for m in miss])),
        "within": float(np.mean(held)),
        "freed": float(np.mean([v.freed for v in rows])),
        "acceleration": float(np.mean([v.acceleration for v in rows])),
        "strain": float(max(v.strain for v in rows)),
    }


def metrics(species: str, rows: list[list[Visit]], belief: Material) -> dict[str, float]:
    """Return the metrics of one crop."""
    out: dict[str, float] = {f"{species}_plants": len(rows)}
    for k, arm in enumerate(ARMS):
        mine = [row[k] for row in rows]
        out |= {f"{species}_{arm}_{name}": value for name, value in summary(mine).items()}
        out |= {f"{species}_{arm}_{name}_late": value for name, value in summary(mine[len(mine) // 2 :]).items()}
    names = ("youngs", "youngs_spread", "damping_ratio", "damping_spread", "bend_over_twist", "twist_spread")
    names += ("radius_scale", "radius_spread", "response_gain", "response_spread")
    return out | {f"{species}_learned_{name}": getattr(belief, name) for name in names}


def main() -> None:
    """Visit the plants, print a table, draw the figure, write --json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--quick", action="store_true", help="three tomatoes only")
    parser.add_argument("--seed", type=int, default=2200, help="of the first plant")
    parser.add_argument("--plants", type=int, default=20, help="of each crop")
    parser.add_argument("--crops", nargs="+", default=list(CROPS), choices=CROPS)
    parser.add_argument("--jobs", type=int, default=1, help="crops at a time")
    parser.add_argument("--out", type=Path, default=Path("runs/learning"), help="where each plant's visits are kept")
    parser.add_argument("--truth", default="nominal", help="or wide, or a group of anther.sim.truth.WIDE alone")
    parser.add_argument("--figure", type=Path)
    args = parser.parse_args()
    crops = args.crops[:1] if args.quick else args.crops
    plants = 3 if args.quick else args.plants
    cases = [{"species": crop, "first": args.seed, "plants": plants, "truth": args.truth} for crop in crops]
    rows = swept(one_crop, cases, args.out, args.jobs, lambda why: {"crashed": why})
    for row in (row for row in rows if "crashed" in row):
        raise SystemExit(f"{row['species']} crashed: {row['crashed']}")
    done = {row["species"]: [[Visit(**visit) for visit in plant] for plant in row["visits"]] for row in rows}
    found: dict[str, float] = {}
    for row in rows:
        found |= metrics(row["species"], done[row["species"]], Material(**row["learned"]))
    Console().print(_table(found, crops))
    if args.json:
        write_json(args.json, found)
    if args.figure:
        with replacing(args.figure) as temporary:
            draw(done).savefig(temporary, dpi=110)


def _table(found: dict[str, float], crops: Sequence[str]) -> Table:
    table = Table("crop", "begun with", "|ln(true/predicted)|", "bias", "in interval", "pollen freed", "flowers [m/s²]")
    for crop in crops:
        for arm in ARMS:
            value = {n: found[f"{crop}_{arm}_{n}"] for n in ("error", "bias", "within", "freed", "acceleration")}
            late = {n: found[f"{crop}_{arm}_{n}_late"] for n in ("error", "bias", "within")}
            table.add_row(
                crop,
                arm,
                f"{value['error']:.2f} (late {late['error']:.2f})",
                f"{value['bias']:+.2f} ({late['bias']:+.2f})",
                f"{value['within']:.0%} ({late['within']:.0%})",
                f"{value['freed']:.1%}",
                f"{value['acceleration']:.1f}",
            )
    return table


if __name__ == "__main__":
    main()
