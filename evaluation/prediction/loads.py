r"""What the margins of the plant's loads promise: how many pass them, by the model alone and after a camera's look.

    python -m evaluation.prediction.loads --plants 8 --jobs 2

Simulated plants whose truth is drawn wide (`anther.sim.truth.WIDE`) are scanned in ten views, modelled, held at two
places and shaken a little at fourteen tones. The truth is MuJoCo's linear equations. The camera sees the nodes that
are in sight at rest, each with an error of 12 % and 0.03 px. `shake.params.load_error` and
`escalation._knowledge.seen_error` were set on the plants of --development; others check them: 5 % of the loads should
pass a margin of 5 %.

Keys of --json: `past_model_<load>`, `past_seen_<load>` (shares), `factor_...` (median of the margin over what is said),
`spread_...` (of ln true over said), `rank_...` (Spearman), all also with `_ringing` and `_fast` for the tones of
`BANDS`; `plants`.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table
from scipy.spatial import KDTree
from scipy.stats import spearmanr

from anther.core import Array, StageFailure
from anther.plant import Crop
from anther.pollination import Foresight, foresee
from anther.pollination.escalation import watch_points
from anther.pollination.escalation._foresight import narrowed
from anther.pollination.escalation._knowledge import Answer, known, seen_error
from anther.pollination.response.points import Sight, sight
from anther.pollination.shake.choice import margined
from anther.pollination.shake.observables import ComplexArray, semi_major
from anther.pollination.shake.params import FAST, RINGING, load_error
from anther.robot import Frame
from anther.sim import Organ, Scene, SimPlant, layout
from anther.sim.robot import SIDE
from anther.sim.simulated_cell import USUAL_DISTANCE
from evaluation.harness import by_turns, finish, options, run_cases
from evaluation.prediction import known_plant
from evaluation.prediction.known_plant import stem_points
from evaluation.prediction.shaken_plant import ShakenPlant
from evaluation.prediction.wide_plant import KINDS, loads_of, looks
from evaluation.tables import markdown
from evaluation.trials.grasping_trial import truth_of

TONES = np.array([2.0, 2.7, 3.6, 4.8, 6.4, 8.5, 11.3, 14.1, 15.4, 16.9, 18.5, 20.3, 24.0, 34.0])
SHAKEN = np.clip(TONES / 3, 1.0, 5.0)
"""Of the grip, when it is looked at [m/s2]: about what an arm and a motor begin with."""
BANDS = {"": (0.0, FAST), "_ringing": (FAST, RINGING), "_fast": (RINGING, np.inf)}
HEIGHTS = (0.45, 0.65)
FIRST, DEVELOPMENT = 9600, 500
RISK = 0.05
SEEN_WITH = 0.12
"""Error of what a camera sees of a node's motion: relative (films of eight plants)."""
NEAR = 0.015
"""A node is where a true segment is that is no further [m]."""
LEAFY = 1e-4
"""Leaves lighter than this are no load [kg], as the planner has it."""
LOADS = (*KINDS, "leaf_load")
WORDS = {
    "stem_strain": "stem strain",
    "joint_strain": "pedicel strain",
    "base_strain": "branch base strain",
    "leaf_load": "leaf load",
}


def one_plant(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return what `one` says of a plant (species, seed), for a sweep."""
    del folder
    return {"loads": one(row["species"], row["seed"])}


def one(species: Crop, seed: int) -> list[dict[str, Any]]:
    """Return a row for each grip and tone of one plant: true loads, and what is said of them."""
    truth = truth_of("wide", seed)
    try:
        it = known_plant.known(species, seed, truth, "fast", looks(truth))
    except StageFailure:
        return []
    plant, seen, model = it.plant, it.seen, it.model
    pose = layout(USUAL_DISTANCE).T_world_side_camera
    image = Scene.of_plant(plant).render(SIDE, pose)
    points = watch_points(model)
    at = sight(Frame(0.0, image.rgb, image.depth), SIDE, pose, seen.flowers.positions, model.rods.nodes[points])
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, np.pi)
    direction, rows = np.array([np.cos(angle), np.sin(angle), 0.0]), []
    places = np.concatenate([seen.flowers.positions.reshape(-1, 3), model.rods.nodes[points]])
    for height in HEIGHTS:
        grip = ShakenPlant(plant, stem_points(plant, (height,))[0], direction, truth=truth)
        foresight = foresee(model, grip.point, TONES, points)
        middles, motion = segment_motion(grip)
        gap, nearest = KDTree(middles).query(places)
        used = at.shown & (gap < NEAR)
        true = loads_of(grip, TONES) | {"leaf_load": leaf_load(plant, middles, motion)}
        for k, tone in enumerate(TONES):
            shown, std = (np.full((len(used), 3), np.nan, kind) for kind in (complex, float))
            shown[used] = np.einsum("px,pxa->pa", motion[k, nearest[used]], at.axes[used])
            size = np.linalg.norm(shown[used, :2], axis=1, keepdims=True)
            noise = rng.normal(size=(2, used.sum(), 3)) / np.sqrt(2)
            shown[used] += SEEN_WITH * size * (noise[0] + 1j * noise[1])
            std[used] = 0.03 * at.per_pixel[used, None] * (2 * np.pi * tone) ** 2 / SHAKEN[k] * [1, 1, np.nan]
            members = foresight.of(k, direction)
            after = after_a_look(foresight, float(tone), narrowed(members, shown, std, at.axes), at, shown, std)
            row: dict[str, Any] = {"species": species, "seed": seed, "height": height, "tone": tone}
            for kind in LOADS:
                if foresight.where[kind].stop > foresight.where[kind].start:
                    before = said(foresight.load(kind, members), load_error(kind, tone))
                    row[kind] = [true[kind][k], *before, *after[kind]]
            rows.append(row)
    return rows


def said(members: Array, error: tuple[Array, Array]) -> tuple[float, float]:
    """Return what is expected of a load of which members have (M,), and what it passes in 5 % of shakes."""
    return float(np.exp(np.log(np.maximum(members, 1e-12)).mean())), float(margined(members, error, RISK))


def after_a_look(
    foresight: Foresight, tone: float, found: ComplexArray, at: Sight, shown: ComplexArray, std: Array
) -> dict[str, tuple[float, float]]:
    """Return by kind what `said` does of a load, once members were narrowed (`found`) and flowers seen to move."""
    flowers = len(at.flowers)
    answer = Answer(found, shown[:flowers], std[:flowers], at.axes[:flowers])
    middle, most = (known(foresight, tone, answer, 0.0, risk).loads for risk in (0.5, RISK))
    return {kind: (middle[kind] / seen_error(tone)[kind][0], most[kind]) for kind in LOADS}


def segment_motion(grip: ShakenPlant) -> tuple[Array, ComplexArray]:
    """Return where the plant's segments (K, 3) have their mass, and how a metre of the grip moves that (Q, K, 3)."""
    plant, tiny = grip.plant, 1e-4
    middle = np.where(plant.lump_mass[:, None] > 0, plant.lump_centre, (plant.start + plant.end) / 2)
    motion = []
    for tone in TONES:
        times = np.arange(8) / (8 * tone)
        poses = np.array([grip.segment_poses(q) for q in grip.swing(tiny, tone, times)])
        path = np.einsum("tkij,kj->tki", poses[..., :3, :3], middle) + poses[..., :3, 3]
        turned = 2j / 8 * np.exp(-2j * np.pi * tone * times)
        motion.append(np.einsum("tki,t->ki", path - path.mean(axis=0), turned) / tiny)
    return path.mean(axis=0), np.array(motion)


def leaf_load(plant: SimPlant, middles: Array, motion: ComplexArray) -> Array:
    """Return (Q,) the largest inertia torque about a leaf's base over its sum of mass times distance [1/s2]."""
    petiole = plant.organ == Organ.PETIOLE
    base = np.flatnonzero(petiole & (plant.organ[plant.parent] != Organ.PETIOLE))
    owner = np.full(len(plant.parent), -1)
    owner[base] = base
    for k in range(len(owner)):
        if owner[k] < 0 <= plant.parent[k]:
            owner[k] = owner[plant.parent[k]]
    mass, largest = plant.mass + plant.lump_mass, np.zeros(len(TONES))
    for b in base:
        own = np.flatnonzero(owner == b)
        if plant.lump_mass[own].sum() < LEAFY:
            continue
        lever = middles[own] - plant.start[b]
        torque = np.einsum("k,qki->qi", mass[own], np.cross(lever, motion[:, own]))
        moment = np.sum(mass[own] * np.linalg.norm(lever, axis=1))
        largest = np.maximum(largest, (2 * np.pi * TONES) ** 2 * semi_major(torque) / moment)
    return largest


def metrics(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Return the table's numbers."""
    table = {"plants": float(len({(row["species"], row["seed"]) for row in rows}))}
    for kind, (band, (low, high)) in product(LOADS, BANDS.items()):
        used = [row[kind] for row in rows if kind in row and low < row["tone"] <= high]
        true, model, bound, narrow, narrow_bound = np.array(used).T
        for name, mean, most in (("model", model, bound), ("seen", narrow, narrow_bound)):
            of = f"{name}_{kind}{band}"
            table[f"past_{of}"] = float(np.mean(true > most))
            table[f"factor_{of}"] = float(np.median(most / mean))
            table[f"spread_{of}"] = float(np.std(np.log(true / mean)))
            table[f"rank_{of}"] = float(spearmanr(true, mean).statistic)
    return table


def report(table: dict[str, float]) -> Table:
    """Return the table, both ways of knowing side by side."""
    heads = ("spread of ln(true/said)", "rank correlation", "margin over said", "past the margin")
    text = markdown(["load", "tones, Hz", *(f"{head}: model / look" for head in heads)])
    for (band, (low, high)), kind in product(BANDS.items(), LOADS):
        one, other = (
            [table[f"{what}_{name}_{kind}{band}"] for what in ("spread", "rank", "factor", "past")]
            for name in ("model", "seen")
        )
        cells = [f"{a:.2f} / {b:.2f}" for a, b in zip(one[:3], other[:3], strict=True)]
        tones = [tone for tone in TONES if low < tone <= high]
        where = f"{tones[0]:g}–{tones[-1]:g}"
        text.add_row(WORDS[kind], where, *cells, f"{one[3]:.1%} / {other[3]:.1%}")
    return text


def main() -> None:
    """Run what is missing and print the table."""
    own = {
        "--plants": (24, "tomatoes and peppers by turns"),
        "--development": (False, "the plants on which the errors were set"),
    }
    seed = (0, "added to the seeds of all plants")
    args = options(__doc__, quick="two plants", seed=seed, jobs="plants", out="runs/loads", own=own)
    first, count = DEVELOPMENT if args.development else FIRST, 2 if args.quick else args.plants
    cases = [{"species": species, "seed": seed} for species, seed in by_turns(count, first + args.seed)]
    done = run_cases(one_plant, cases, args.out, args.jobs, lambda _: {"loads": []})
    table = metrics([row for part in done for row in part["loads"]])
    words = f"{table['plants']:.0f} plants, two grips, fourteen tones each. Asked: 5 % past the margin."
    finish(args, table, words, report(table))


if __name__ == "__main__":
    main()
