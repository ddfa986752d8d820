"""Seconds of processor the simulated cell takes for a second of the world, phase by phase, on one core.

    python -m evaluation.speed.cell [--quick]

The arm takes the stem of a grown plant a third of its height above the soil (by the plant's truth: nothing is seen or
planned around), shakes it, lets go and draws back. Above 1 the world runs faster than the clock on the wall.
mj_step_share is how much of it MuJoCo's own steps take, which stepping many copies of a cell together could not save.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from unittest.mock import patch

import mujoco
import numpy as np

from anther.core import Array, StageFailure, transform
from anther.plant import Crop
from anther.robot import JointTrajectory, Planner
from anther.robot.arm import sawyer
from anther.robot.swing import whole_shake
from anther.sim import grow
from anther.sim.cell import Cell
from anther.sim.judge import judge
from anther.sim.robot import SimArm, SimGripper
from anther.sim.simulated_cell import USUAL_DISTANCE
from evaluation.harness import CROPS, finish, options, progress
from evaluation.tables import markdown

WORDS = {
    "degrees_of_freedom": "degrees of freedom",
    "shapes": "shapes",
    "build_s": "building the cell (s of processor)",
    **{
        f"{phase}_x_real_time": f"{phase} (s of the world for one of processor)"
        for phase in ("reach", "approach", "close", "shake", "release", "retreat")
    },
    "x_real_time": "all phases (s of the world for one of processor)",
    "mj_step_share": "share of it in MuJoCo's own steps",
    "judge_s": "judging (s of processor)",
}
NOTHING = np.zeros((0, 3))
BACK, HERTZ, AMPLITUDE = 0.12, 8.0, 1e-3


def grasp_pose(cell: Cell) -> Array:
    """Return the flange's pose around the main stem, a third of it above the soil, approached from the arm's side."""
    points, _, along = cell.plant.stem_centreline()
    at = np.array([np.interp(along[-1] / 3, along, x) for x in points.T])
    turn = np.array([[0, 0, 1.0], [0, -1, 0], [1, 0, 0]])
    return transform(turn, at) @ np.linalg.inv(sawyer.T_FLANGE_GRASP)


def motions(cell: Cell) -> tuple[JointTrajectory, JointTrajectory, JointTrajectory]:
    """Return the way to where the approach begins, the way out of the plant, and the shake.

    Raises:
        StageFailure: unreachable.
    """
    planner, goal = Planner(NOTHING, NOTHING), grasp_pose(cell)
    before = goal @ transform(np.eye(3), [0, 0, -BACK])
    q = planner.reach(before, goal)
    if q is None:
        raise StageFailure("unreachable", "the arm cannot take the stem a third of its height up. Take another seed.")
    out = planner.line(q, before)
    shake = planner.swing(q, [0, 1, 0], whole_shake(AMPLITUDE, HERTZ, 2.0), AMPLITUDE)
    return planner.move(sawyer.READY, out.positions[-1]), out, shake


def phases(cell: Cell) -> dict[str, Callable[[], object]]:
    """Return what the robot does, by name and in order."""
    arm, gripper = SimArm(cell), SimGripper(cell)
    reach, out, shake = motions(cell)
    return {
        "reach": lambda: arm.follow(reach),
        "approach": lambda: arm.follow(out.backwards()),
        "close": lambda: gripper.move(0.006),
        "shake": lambda: arm.follow(shake),
        "release": lambda: gripper.move(0.0416),
        "retreat": lambda: arm.follow(out),
    }


def measure(species: Crop, seed: int) -> dict[str, float]:
    """Return seconds of the world per second of processor, of building, each phase and all of them."""
    begun = time.process_time()
    cell = Cell(grow(species, seed, 0.0, USUAL_DISTANCE), sawyer.READY)
    rows = {"build_s": time.process_time() - begun, "degrees_of_freedom": cell.model.nv, "shapes": cell.model.ngeom}
    world = spent = 0.0
    steps = [0.0]

    def timed(step: Callable[..., None]) -> Callable[..., None]:
        def run(*given: object) -> None:
            begun = time.thread_time()
            step(*given)
            steps[0] += time.thread_time() - begun

        return run

    with patch.multiple(mujoco, mj_step1=timed(mujoco.mj_step1), mj_step2=timed(mujoco.mj_step2)):
        for name, act in phases(cell).items():
            start, begun = cell.time, time.process_time()
            act()
            simulated, took = cell.time - start, time.process_time() - begun
            rows[f"{name}_x_real_time"] = simulated / took
            world, spent = world + simulated, spent + took
    rows["mj_step_share"] = steps[0] / spent
    begun = time.process_time()
    verdict = judge(cell, None, HERTZ)
    held = {"judge_s": time.process_time() - begun, "simulated_s": world, "push_n": verdict.push}
    return rows | held | {"x_real_time": world / spent}


def main() -> None:
    """Measure, print a table, write --json."""
    args = options(__doc__, quick="one plant of each species instead of three", seed=(10, "first seed"))
    todo = [(crop, args.seed + k) for crop in CROPS for k in range(1 if args.quick else 3)]
    rows = {f"{s}_{n}": measure(s, n) for s, n in progress(todo, "cells")}
    lines = [(words, *(f"{row[what]:.3g}" for row in rows.values())) for what, words in WORDS.items()]
    metrics = {f"{plant}_{what}": value for plant, row in rows.items() for what, value in row.items()}
    metrics["x_real_time_slowest"] = min(row["x_real_time"] for row in rows.values())
    finish(args, metrics, markdown(("what", *(plant.replace("_", " ") for plant in rows)), lines))


if __name__ == "__main__":
    main()
