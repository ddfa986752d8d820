"""Whose stem is it: scenes of 2-5 plants 0.1-0.5 m apart, with and without strings, stakes and poles.

Plants in turn are Anther's own, Helios's (left out where pyhelios3d is not installed) and real labelled seedlings
enlarged to 0.45 m (left out without --data), turned and merged; `scene_plants.py` builds complete surfaces
with 0.3 mm of noise. Of each scene perception is asked for the first plant by its foot (`root`), for the plant that
stands in the middle (nothing named), and for the first plant alone, which gives its time. Scenes go through a sweep in
--out: what is done is not run again.

Keys of the --json file: asked_named, asked_unnamed (share of scenes in which most of the main stem lies on the asked
plant; unnamed any plant will do whose foot is at most 1.25 times as far from the middle as the nearest), traced_share
(share of the asked stem's height along which the named main stem runs within two stem radii, mean, 0 where another stem
was found), organs_own (share of the named tree's nodes on the asked plant, mean, supports left out), support_as_stem
(questions whose main stem is a support, and within no stem, over more than a twentieth of its nodes), support_in_pads
(share of the grasps that close on a support, of scenes with supports; a string wound round a stem counts as the stem),
two_stems_48 (of 48 pairs of own plants with their feet 0.04-0.12 m apart, those whose grasp is on the asked stem;
clouds, not whole trials), flagged_wrong (share of the wrong answers, another plant's stem or a grasp off the asked
one's, that are refused, or have a confidence of the root or the grasp below 0.75, a note of a second stem or of a low
one, or a gripper that does not fit), false_flags (share of right answers that have, where one plant alone was meant),
alike_flagged (share of questions that have where several would do), any_flagged_wrong, any_false_flags (the same where
the main stem's confidence counts as well: that is about its whole course, not about what is held), course_wrong (share
of the right answers whose main stem leaves the true one over more than a twentieth of its length below its first fork,
or is cut short by a tenth), course_flagged_wrong, course_false_flags (share of these and of the other right answers
with a main stem's confidence below 0.75), scene_over_one (processor time of a scene of five over that of one of them,
compiled code being loaded, median; of all scenes where there are none of five), scenes; and own_, helios_, real_ for
parts.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import RenderableType
from scipy.spatial import KDTree

from anther.cli.skeletonize import best_grasps
from anther.core import AntherError
from anther.core.geometry import Array, transform_points
from anther.perception import Skeleton, Stem, find_stem, find_supports, flower_centres, skeletonize
from anther.perception.skeleton import Params
from anther.perception.stem.confidence import doubt
from anther.pollination import Grasp
from anther.robot.arm.sawyer import SAWYER
from anther.robot.pressing import Pressing
from anther.sim import grow
from evaluation.harness import CROPS, Row, finish, lost, options, run_cases
from evaluation.perception.helios import AGE, grow_helios
from evaluation.perception.real.plants import TRACKPLANT, Labelled, labelled_plants
from evaluation.perception.scene_plants import (
    STEM,
    SUPPORTS,
    Points,
    Scene,
    build,
    of_scan,
    of_sim,
    sampled,
    thinned,
)
from evaluation.statistics import mean, median
from evaluation.tables import markdown, percent

KINDS = ("own", "helios", "real")
POT = (0.04, 0.12)
"""Between the feet of two stems in one pot [m]."""
SURE = 0.75
"""An answer of less confidence is flagged: below it, users are told to name the root."""
MOST_POINTS = 15_000
"""Of a real plant."""
PAD_REACH = 0.0185
"""Of a pad along the approach to either side of its middle [m]: basic soft tips are 37 mm long (facts: sawyer 3)."""
SLICES = 50


@dataclass(frozen=True, eq=False)
class Answer:
    """What perception says to one question, and the processor time it took [s]; a refusal has only its words."""

    seconds: float
    skeleton: Skeleton | None = None
    stem: Stem | None = None
    grasp: Grasp | None = None
    refused: str = ""
    unfit: bool = False
    """Whether the gripper was said not to fit; a robot's visit ends there."""

    @property
    def flagged(self) -> bool:
        """Whether a user is warned that something else than the asked stem may be held."""
        if self.stem is None or self.skeleton is None or self.grasp is None or self.unfit:
            return True
        notes = set(self.stem.notes) - set(doubt(self.stem.confidence))
        return bool(notes) or _low(self.skeleton.root_confidence) or _low(self.grasp.confidence)

    @property
    def course_flagged(self) -> bool:
        """Whether a user is warned that the main stem may run into something else, or end early."""
        return self.stem is not None and _low(self.stem.confidence)


def _low(confidence: float | None) -> bool:
    return confidence is not None and confidence < SURE


def ask(scene: Scene, root: Array | None = None) -> Answer:
    """Ask perception for a main stem and a grasp in a scene, perhaps with the root named."""
    begin = time.process_time()
    try:
        cloud = find_supports(scene.cloud())
        x, y, z = (0.0, 0.0, 0.0) if root is None else map(float, root)
        skeleton = skeletonize(cloud, None if root is None else Params(root=(x, y, z)))
        stem = find_stem(skeleton, flowers_at=flower_centres(cloud))
        seconds = time.process_time() - begin
        grasps, unfit = best_grasps(stem, skeleton, cloud)
    except AntherError as error:
        return Answer(time.process_time() - begin, refused=str(error))
    return Answer(seconds, skeleton, stem, grasps[0], unfit=bool(unfit))


class Judge:
    """Says what an answer lies on. A string that is wound round a stem counts as the stem: it cannot be taken away."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.tree, self.owners = scene, KDTree(scene.points), scene.owner.copy()
        for k, name in enumerate(scene.supports):
            if name == "wound string":
                self.owners[scene.owner == len(scene.plants) + k] = k % len(scene.plants)

    def owner(self, places: Array) -> NDArray[Any]:
        """Return (M,) whose the nearest point of the scene is: a plant, or P and more of supports."""
        return self.owners[np.asarray(self.tree.query(places)[1])]

    def of(self, answer: Answer, asked: Sequence[int]) -> Row:
        """Return an answer's row; `asked` are the plants that will do."""
        row: Row = {"flagged": answer.flagged, "seconds": answer.seconds, "refused": answer.refused}
        row["course_flagged"] = answer.course_flagged
        row |= {"unfit": answer.unfit, "answers": len(asked)}
        if answer.skeleton is None or answer.stem is None or answer.grasp is None:
            return row | {"found": None, "right": False, "grasp_right": False, "traced": 0.0}
        count, nodes = len(self.scene.plants), answer.skeleton.nodes
        on = self.owner(nodes[answer.stem.node_ids])
        for k, plant in enumerate(self.scene.plants):  # within a true stem, whatever leans on it there
            on[self._within_stem(plant, nodes[answer.stem.node_ids])] = k
        share = np.bincount(on, minlength=len(self.scene.supports) + count) / len(on)
        found = int(share.argmax())
        right = bool(found in asked and share[found] > 0.5)
        all_on = self.owner(nodes)
        held, gap = self._held(answer.grasp)
        support = self._support_in_pads(answer.grasp) and not answer.unfit
        traced = self._traced(found, nodes[answer.stem.node_ids]) if right else 0.0
        below = answer.stem.node_ids[: answer.stem.fork + 1]
        course = right and traced >= 0.9 and float(self.on_stem(found, nodes[below]).mean()) >= 0.95
        return row | {
            "found": found,
            "right": right,
            "grasp_right": right and held == found and gap,
            "traced": traced,
            "course_right": course,
            "own": float((all_on == found).sum() / max(1, (all_on < count).sum())) if right else 0.0,
            "support_share": float(share[count:].sum()),
            "support_in_pads": support,
            "confidence": answer.stem.confidence,
            "notes": [*answer.skeleton.notes, *answer.stem.notes],
        }

    def _held(self, grasp: Grasp) -> tuple[int, bool]:
        """Return whose point is nearest to the grasp, and whether the plant's stem is within two of its radii."""
        plant = int(self.owner(grasp.point[None])[0])
        if plant >= len(self.scene.plants):
            return plant, False
        return plant, bool(self.on_stem(plant, grasp.point[None])[0])

    def _traced(self, plant: int, line: Array) -> float:
        """Return the share of a stem's height along which a line (n, 3) runs within two of its radii."""
        stem = self.scene.plants[plant].stem
        dense = np.concatenate([np.linspace(a, b, 10) for a, b in zip(line, line[1:], strict=False)])
        close = dense[self.on_stem(plant, dense)]
        low, high = np.quantile(stem[:, 2], [0.005, 0.995])
        slices = np.floor((close[:, 2] - low) / (high - low) * SLICES).astype(int)
        return len(set(slices[(slices >= 0) & (slices < SLICES)].tolist())) / SLICES

    def on_stem(self, plant: int, places: Array) -> NDArray[np.bool_]:
        """Return which places (M, 3) [m] are within two radii of a plant's stem or its surface."""
        own = (self.scene.owner == plant) & (self.scene.organ == STEM)
        stem = np.vstack([self.scene.plants[plant].stem, self.scene.points[own]])
        return np.asarray(KDTree(stem).query(places)[0]) <= 2 * self.scene.plants[plant].radius + 0.002

    @staticmethod
    def _within_stem(plant: Points, places: Array) -> NDArray[np.bool_]:
        """Return which places (M, 3) [m] are within a radius of the middle of a plant's stem."""
        line = np.concatenate([np.linspace(a, b, 20) for a, b in zip(plant.stem, plant.stem[1:], strict=False)])
        return np.asarray(KDTree(line).query(places)[0]) <= plant.radius

    def _support_in_pads(self, grasp: Grasp) -> bool:
        """Return whether a point of a support lies where the pads close."""
        points = self.scene.points[self.owners >= len(self.scene.plants)]
        T_world_pads = grasp.T_world_flange @ SAWYER.tool.T_flange_grasp
        x, y, z = np.abs(transform_points(np.linalg.inv(T_world_pads), points)).T
        return bool(np.any((x <= Pressing().pad_width / 2) & (y <= grasp.opening / 2) & (z <= PAD_REACH)))


def plants_of(kind: str, count: int, rng: np.random.Generator, data: Path) -> list[Points]:
    """Return plants of one kind, drawn."""
    seeds = rng.integers(0, 10_000, count)
    if kind == "own":
        grown = [of_sim(grow(CROPS[int(k % 2)], 2000 + int(k), 0.0, 0.7)) for k in seeds]
    elif kind == "helios":
        grown = [grow_helios(list(AGE)[int(k % len(AGE))], int(k)) for k in seeds]
    else:
        scans = seedlings(data)
        chosen = [scans[k] for k in rng.choice(len(scans), count, replace=False)]
        found = [of_scan(scan.name, scan.cloud.points, scan.is_stem, 0.45) for scan in chosen]
        return [thinned(plant, MOST_POINTS, rng) for plant in found]
    return [sampled(plant, rng) for plant in grown]


@cache
def seedlings(data: Path) -> list[Labelled]:
    """Return every third labelled seedling; they are read once a process."""
    return [scan for scan in labelled_plants(data, 3, ()) if scan.leaves]


def scene_of(row: Row) -> Scene:
    """Return the scene of a case: its kind, its seed, whether there are supports, whether it is one pot."""
    rng = np.random.default_rng([row["seed"], KINDS.index(row["kind"]), row["supports"], row["pot"]])
    plants = plants_of(row["kind"], 2 if row["pot"] else int(rng.integers(2, 6)), rng, Path(row["data"]))
    names = rng.choice(SUPPORTS, len(plants)).tolist() if row["supports"] else []
    return build(plants, rng, names, *([POT] if row["pot"] else []))


def middle(scene: Scene) -> list[int]:
    """Return the plants that may be meant where none is named: those that stand nearest to the middle of all."""
    centre = (scene.points.min(axis=0) + scene.points.max(axis=0))[:2] / 2
    away = np.linalg.norm(scene.feet[:, :2] - centre, axis=1)
    return np.flatnonzero(away <= 1.25 * away.min()).tolist()


def one_scene(row: Row, _: Path) -> Row:
    """Return what perception says to the questions of one scene."""
    scene = scene_of(row)
    judge, alone = Judge(scene), scene.only(0)
    if not row["pot"]:
        ask(alone)  # loads what is compiled: processor time is of what is warm
    named = judge.of(ask(scene, root=scene.feet[0]), [0])
    found = {"plants": len(scene.plants), "names": [p.name for p in scene.plants], "of": list(scene.supports)}
    if row["pot"]:
        return found | {"named": named}
    return found | {
        "named": named,
        "unnamed": judge.of(ask(scene), middle(scene)),
        "alone": Judge(alone).of(ask(alone), [0]),
    }


def metrics(rows: list[Row]) -> dict[str, float]:
    """Return the numbers of the results contract, of all scenes and of their kinds."""
    whole = [row for row in rows if "lost" not in row]
    pots, scenes = [r for r in whole if r["pot"]], [r for r in whole if not r["pot"]]
    found = _numbers(scenes) | {"lost": float(len(rows) - len(whole))}
    for kind in KINDS:
        part = _numbers([row for row in scenes if row["kind"] == kind])
        found |= {f"{kind}_{key}": value for key, value in part.items() if part["scenes"]}
    return found | {"two_stems_48": float(sum(row["named"]["grasp_right"] for row in pots)), "pots": float(len(pots))}


def _numbers(scenes: list[Row]) -> dict[str, float]:
    named, unnamed = [row["named"] for row in scenes], [row["unnamed"] for row in scenes]
    asked, supported = [*named, *unnamed], [row for row in scenes if row["supports"]]
    beside = [row[how] for row in supported for how in ("named", "unnamed")]
    most = [row for row in scenes if row["plants"] == 5] or scenes
    right, wrong = [row for row in asked if row["grasp_right"]], [row for row in asked if not row["grasp_right"]]
    clear = [row for row in right if row["answers"] == 1]
    off, straight = [row for row in right if not row["course_right"]], [row for row in right if row["course_right"]]
    return {
        "scenes": float(len(scenes)),
        "asked_named": mean(row["right"] for row in named),
        "asked_unnamed": mean(row["right"] for row in unnamed),
        "traced_share": mean(row["traced"] for row in named),
        "organs_own": mean(row.get("own", 0.0) for row in named),
        "support_as_stem": float(sum(row.get("support_share", 0.0) > 0.05 for row in beside)),
        "support_in_pads": mean(row.get("support_in_pads") for row in beside),
        "flagged_wrong": mean(row["flagged"] for row in wrong),
        "false_flags": mean(row["flagged"] for row in clear),
        "alike_flagged": mean(row["flagged"] for row in asked if row["answers"] > 1),
        "any_flagged_wrong": mean(row["flagged"] or row["course_flagged"] for row in wrong),
        "any_false_flags": mean(row["flagged"] or row["course_flagged"] for row in clear),
        "course_wrong": mean(not row["course_right"] for row in right),
        "course_flagged_wrong": mean(row["course_flagged"] for row in off),
        "course_false_flags": mean(row["course_flagged"] for row in straight),
        "scene_over_one": median(row["named"]["seconds"] / row["alone"]["seconds"] for row in most),
        "alone_right": mean(row["alone"]["grasp_right"] for row in scenes),
        "alone_traced": mean(row["alone"]["traced"] for row in scenes),
    }


def report(table: dict[str, float], rows: list[Row]) -> list[RenderableType]:
    """Return the table, and the scenes whose answers are wrong."""
    kinds = ["", *(f"{kind}_" for kind in KINDS if f"{kind}_scenes" in table)]
    keys = [key for key in _numbers([]) if key in table]
    counts = ("scenes", "support_as_stem", "scene_over_one")
    lines = [
        (key.replace("_", " "), *(f"{table[k + key]:.3g}" if key in counts else percent(table[k + key]) for k in kinds))
        for key in keys
    ]
    wrong = []
    for row in (row for row in rows if "lost" not in row):
        for how in (how for how in ("named", "unnamed") if how in row and not row[how]["grasp_right"]):
            said = row[how]
            words = said["refused"] or f"found {said['found']}, traced {said['traced']:.0%}"
            flag = "" if said["flagged"] else ", NOT FLAGGED"
            wrong.append(f"{row['kind']} {row['seed']}, {row['plants']} plants, {how}: {words}{flag}")
    pots = f"Two stems in one pot: the grasp is on the asked one in {table['two_stems_48']:.0f} of {table['pots']:.0f}."
    return [markdown(("", *((k or "all").strip("_") for k in kinds)), lines), pots, *wrong]


def main() -> None:
    """Run what is not there yet, print the table, write --json."""
    own: dict[str, Any] = {
        "--scenes": (200, "how many, kinds and supports by turns"),
        "--pots": (48, "pairs of own plants in one pot"),
        "--kinds": (KINDS, "only these", KINDS),
    }
    seed = (0, "of the first scene")
    args = options(
        __doc__, quick="24 scenes, no pots", seed=seed, jobs="scenes", out="runs/scenes", data="clouds", own=own
    )
    there = {
        "own": True,
        "helios": importlib.util.find_spec("pyhelios") is not None,
        "real": (args.data / f"{TRACKPLANT}.npz").exists(),
    }
    kinds = [kind for kind in args.kinds if there[kind]]
    count, pots = (24, 0) if args.quick else (args.scenes, args.pots)
    common = {"data": str(args.data.resolve())}
    cases = [
        common
        | {"kind": kinds[k % len(kinds)], "seed": args.seed + k, "supports": k // len(kinds) % 2 == 1, "pot": False}
        for k in range(count)
    ]
    cases += [common | {"kind": "own", "seed": args.seed + k, "supports": False, "pot": True} for k in range(pots)]
    rows = run_cases(one_scene, cases, args.out, args.jobs, lost)
    table = metrics(rows)
    missing = [f"No {kind} plants: not installed, or --data is missing." for kind in args.kinds if not there[kind]]
    finish(args, table, *report(table, rows), *missing)


if __name__ == "__main__":
    main()
