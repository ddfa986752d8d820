"""What a shake does for the person with the plant: ways to shake the same unseen plants, judged by MuJoCo.

    python -m evaluation.trials.shaking --plants 6 --ways paper plan escalated motor --seed 460 --jobs 2

Every plant's truth is drawn wide (`anther.sim.truth.WIDE`): pads, damping, limits that no stage knows. Each way begins
anew from the same views of the same plant, but for the second visit:

paper      the paper's shake, 12 mm at 1.9 Hz for 5 s, at its grasp (longest edge of the stem), whatever the limits
plan       Anther's plan alone: what the model allows
escalated  the plan raised by what the side camera sees
again      a second visit, with other errors of arm and cameras, that begins with what the first ended with
motor      the same with a motor in the gripper
oracle     the best within the reach of an arm, on a plant that is known (`oracle.py`); oracle_motor: of a motor

Every trial ends in one JSON in --out and is not run again; those of the campaign, which takes more than a day's hours,
are in docs/results/long/done/shaking.jsonl (--done). Keys of --json: those of `shaking_table.metrics`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from anther.core import Advance
from anther.perception.capture import no_keep
from anther.plant import PRIORS, Crop, Material
from anther.plant.belief import EarlierShake
from anther.pollination import Done, Params, Seen, ShakePlan, execute, perceive, pollinate
from anther.pollination.escalation import Escalation
from anther.robot import GuardedArm
from anther.robot.arm.compliance import STIFFNESS, STIFFNESS_SPREAD
from anther.sim import WIDE, SimulatedCell, build
from anther.sim.simulated_cell import PRESETS
from evaluation.harness import by_turns, failed, finish, options, run_cases
from evaluation.prediction.known_plant import matched
from evaluation.trials import oracle, shaking_table
from evaluation.trials.grasping_trial import Memory, paper_plan, performed, truth_of

FIRST, DEVELOPMENT = 9500, 7700
"""Plants from the first seed on are in no other table; on those from the second on constants may be set."""
PAPER_SHAKE = {"amplitude": 0.012, "frequency": 1.9, "duration": 5.0}
"""Of the paper's largest and fastest shakes (docs/paper.md)."""
PAPER_FORCE = 150.0
"""The paper's shakes pull with 15 to 141 N (facts: pollination 6); a guard's 10 N would stop most."""
WAYS = ("paper", "plan", "escalated", "again", "motor", *oracle.ACTUATORS)


@dataclass(frozen=True, slots=True)
class Case:
    """One plant, one way to shake it, under one truth: "wide", "nominal", or a group of `sim.truth.WIDE` alone."""

    species: Crop
    seed: int
    way: str
    truth: str = "wide"


class Brief(Memory):
    """A run in memory that measures no response after the shake: nothing is learned from it here.

    Attributes:
        watched: the shake as it was watched last, if it was.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.watched: Escalation | None = None
        self.told = self._hear

    def _hear(self, name: str, value: Any) -> None:
        self.watched = value if name == "watched" else self.watched

    def stage(self, name: str, load: Any, compute: Callable[[Advance], Any], save: Any = None) -> Any:
        """Compute a stage, but the response."""
        return None if name == "response" else super().stage(name, load, compute, save)


def one(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return what became of a case (`asked`), for a sweep."""
    case = Case(**{name: value for name, value in row.items() if name != "earlier"})
    before = row["earlier"]
    earlier = None if before is None else EarlierShake(**before | {"direction": np.array(before["direction"])})
    return shaken(case, folder, earlier)


def rows_of(cases: Sequence[Case], out: Path, jobs: int, before: Path | None = None) -> list[dict[str, Any]]:
    """Return the rows of the cases: the second visits last, since they begin as the first ones ended."""
    first = [asdict(case) | {"earlier": None} for case in cases if case.way != "again"]
    rows = run_cases(one, first, out, jobs, failed, before)
    ended = {(row["species"], row["seed"], row["truth"]): ended_with(row) for row in rows if row["way"] == "escalated"}
    second = [
        asdict(case) | {"earlier": ended.get((case.species, case.seed, case.truth))}
        for case in cases
        if case.way == "again"
    ]
    return rows + (run_cases(one, second, out, jobs, failed, before) if second else [])


def ended_with(row: dict[str, Any]) -> dict[str, Any] | None:
    """Return what a visit ended with (`EarlierShake`); None where no flower was measured or it failed."""
    if not row["success"] or row.get("step_flower_acceleration_median_ms2") is None:
        return None
    return {
        "arc_length": row["grasp_arc_length_m"],
        "direction": row["direction"],
        "frequency": row["shake_frequency_hz"],
        "amplitude": row["shake_amplitude_m"],
    }


def shaken(case: Case, folder: Path, earlier: EarlierShake | None = None) -> dict[str, Any]:
    """Run one trial and return what became of it."""
    viewpoint, truth = 90.0 * (case.seed % 4), truth_of(case.truth, case.seed)
    if case.way in oracle.ACTUATORS:
        return asdict(case) | oracle.foreseen(case.species, case.seed, viewpoint, truth, case.way)
    cell = build(
        case.species,
        case.seed,
        viewpoint,
        PRESETS["fast"],
        truth=truth,
        actuator="gripper" if case.way == "motor" else "arm",
        visit=int(case.way == "again"),
    )
    run, material = Brief(folder), PRIORS[case.species]
    params = replace(Params(), escalate=case.way != "plan", actuator="gripper" if case.way == "motor" else "arm")
    ways: dict[str, Callable[[], Done]] = {"paper": lambda: by_the_paper(cell, run, material)}
    row, done = performed(
        cell, ways.get(case.way, lambda: pollinate(cell.robot_side, material, run, params, None, earlier))
    )
    row = {**asdict(case), **row}
    if done is not None:
        row["direction"] = done.shake.direction
        row["steps"] = [asdict(step) for step in done.trial.steps]
        row["shaking_s"] = float(np.ptp(done.trial.shake_times)) if len(done.trial.shake_times) else 0.0
        row["flowers"] = seen_and_true(cell, run, done, case)
        joints = run.watched.joints if run.watched is not None else None
        if joints is not None and np.isfinite(truth.joint_stiffness):
            true = np.log(truth.joint_stiffness / STIFFNESS) / STIFFNESS_SPREAD
            row |= {"joints_found": joints.stiffness, "joints_true": float(true)}
    return row


def by_the_paper(cell: SimulatedCell, run: Memory, material: Material) -> Done:
    """Take the plant by the paper's rule (P12-P14) and shake it as the paper's most vigorous runs."""
    side = cell.robot_side
    capture = run.stage("capture", None, lambda advance: side.take_views(advance, no_keep))
    seen: Seen = perceive(capture, side.workspace, run, Params())
    planner, plan, material = paper_plan(cell, seen, material)
    press = float(side.limits.pressing.most(plan.grasp.stem_diameter))
    shake: ShakePlan = replace(plan, press=press, **PAPER_SHAKE)
    limits = replace(side.limits, contact_force=PAPER_FORCE)
    arm = GuardedArm(side.robot.arm._arm, limits)  # the cell's own guard would stop it
    robot = replace(side.robot, arm=arm, side_camera=None, T_world_side_camera=None)
    return Done(shake, execute(planner, shake, robot, limits), None, material)


def seen_and_true(cell: SimulatedCell, run: Memory, done: Done, case: Case) -> dict[str, Any]:
    """Return what the last step measured of each flower that is there, and what that flower truly felt [m/s2]."""
    flowers = run.results["flowers"].positions if "flowers" in run.results else np.zeros((0, 3))
    i, j = matched(flowers, cell.plant.flower_position)
    measured = np.array(done.trial.steps[-1].flowers)[i] if done.trial.steps else np.full(len(i), np.nan)
    return {"there": len(cell.plant.flower_position), "seen": len(flowers), "of": j, "measured": measured}


def main() -> None:
    """Run what is missing and print the tables."""
    own = {
        "--plants": (40, "half tomatoes, half peppers"),
        "--ways": (WAYS, "of shaking", WAYS),
        "--first": {"nargs": "*", "default": [], "metavar": "WAY=N", "help": "only the first N of the plants this way"},
        "--truth": ("wide", "or one group alone", ("wide", "nominal", *WIDE)),
        "--development": (False, "the plants on which constants may be set"),
    }
    seed = (0, "added to the seeds of all plants")
    args = options(__doc__, quick="two plants", seed=seed, jobs="trials", out="runs/shaking", done=True, own=own)
    plants = by_turns(2 if args.quick else args.plants, (DEVELOPMENT if args.development else FIRST) + args.seed)
    fewer = {way: int(count) for way, count in (text.split("=") for text in args.first)}
    cases = [
        Case(*plant, way, args.truth)
        for k, plant in enumerate(plants)
        for way in args.ways
        if k < fewer.get(way, len(plants))
    ]
    rows = rows_of(cases, args.out, args.jobs, args.done)
    found = shaking_table.metrics(rows)
    finish(args, found, *shaking_table.report(rows, found))


if __name__ == "__main__":
    main()
