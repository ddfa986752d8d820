"""One trial of `grasping.py`: noisy images to physical grasp and shake, then the paper's grasp in a fresh cell."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

from anther.core import Advance, Run, StageFailure
from anther.core.geometry import Array
from anther.perception import Cloud
from anther.plant import PRIORS, Crop, Material, Visit
from anther.pollination import Done, Params, Seen, ShakePlan, execute, model_plant, plan_shake, pollinate
from anther.pollination.execution import EARLY
from anther.pollination.shake import arm_shaker
from anther.robot import Cell, Planner
from anther.robot.arm.arms import simulated_arm
from anther.robot.cell import MotionPlanner
from anther.show import summarise
from anther.sim import NOMINAL, SimulatedCell, Truth, build, draw
from anther.sim.judge import judge
from anther.sim.simulated_cell import PRESETS
from evaluation.harness import failed
from evaluation.trials.grasping_pictures import portrait
from evaluation.trials.grasping_table import as_counted
from evaluation.trials.paper_grasp import paper_grasp

COMPUTE = (
    "masks", "cloud", "skeleton", "stem", "flowers", "planner", "grasp", "place", "plant model", "shake plan",
    "motions", "plan ahead", "prediction",
)  # fmt: skip
LISTED = (
    "grasp_pose7",
    "true_held_beside",
    "true_flower_acceleration_peak_ms2",
)  # of a visit; other lists, one number a flower, are left out
NAMED = ("species", "plant", "robot", "run", "time", "id", "flowers")  # of a visit; the case says them
LEAST_SHAKE = 1e-6  # m, of the paper's grasp: it is never refused because the plant bears no useful shake there


PICTURE = "picture.png"
"""In a trial's folder: what the camera saw, with the grasp."""


@dataclass(frozen=True)
class Case:
    """One plant, seen from one side by an arm (`anther.arm.arms.Name`), by one of the presets of `anther trial`.

    `truth` is "nominal", "wide", or the group of `sim.truth.WIDE` that alone is not nominal.
    """

    species: Crop
    seed: int
    viewpoint: int
    preset: str = "full"
    truth: str = "nominal"
    arm: str = "sawyer"

    @property
    def name(self) -> str:
        """The case in words that can name a file."""
        return f"{self.species}-{self.seed}-{self.viewpoint}"

    def build(self) -> SimulatedCell:
        """Return the case's cell."""
        truth, arm = truth_of(self.truth, self.seed), simulated_arm(self.arm)
        return build(self.species, self.seed, self.viewpoint, PRESETS[self.preset], truth=truth, arm=arm)


def truth_of(name: str, seed: int) -> Truth:
    """Return the truth of a plant: "nominal", "wide", or one group of `sim.truth.WIDE`."""
    return NOMINAL if name == "nominal" else draw(seed) if name == "wide" else draw(seed, name)


class Memory(Run):
    """A run that keeps results in memory, and adds up what a stage took when it is tried again.

    Attributes:
        simulating: processor time of the simulator's steps so far [s], which belongs to no stage.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, quiet=True)
        self.results: dict[str, Any] = {}
        self.total: dict[str, float] = {}
        self.first: dict[str, float] = {}
        self.cpu: dict[str, float] = {}
        self.tries: Counter[str] = Counter()
        self.simulating = 0.0

    def stage(self, name: str, load: Any, compute: Callable[[Advance], Any], save: Any = None) -> Any:
        """Compute a stage."""
        self.tries[name] += 1
        self.results[name] = self.timed(name, compute)
        return self.results[name]

    def keep(self, name: str, result: Any, save: Any = None) -> None:
        """Keep a stage's result."""
        self.results[name] = result

    def timed(self, name: str, compute: Callable[[Advance], Any]) -> Any:
        """Compute something and note wall and processor time [s]."""
        wall, cpu = time.perf_counter(), time.process_time() - self.simulating
        try:
            return super().timed(name, compute)
        finally:
            wall, cpu = time.perf_counter() - wall, time.process_time() - self.simulating - cpu
            self.first.setdefault(name, min(wall, cpu))
            self.total[name] = self.total.get(name, 0.0) + wall
            self.cpu[name] = self.cpu.get(name, 0.0) + cpu

    def took(self, name: str) -> float:
        """Return what a stage took [s]: of wall and processor time the lesser, as other programs share the machine."""
        return min(self.total.get(name, 0.0), self.cpu.get(name, 0.0))


def one_trial(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return what became of a case (`asked`), for a sweep; its picture is written into the folder."""
    case = {name: value for name, value in row.items() if name != "rule"}
    return both(Case(**case), folder / PICTURE, row["rule"])


def asked(cases: Iterable[Case], *, rule: bool) -> list[dict[str, Any]]:
    """Return the cases as a sweep has them.

    Args:
        cases: the trials.
        rule: also carry out the paper's own grasp, where a case has all views.
    """
    return [asdict(case) | {"rule": rule} for case in cases]


def crashed(reason: str) -> dict[str, Any]:
    """Return what stands for a trial whose program crashed."""
    return {"ours": failed(reason), "paper": None, "first": True}


_begun = count()


def is_first() -> bool:
    """Return whether this process has run no case yet: what the first one compiles or loads is not counted."""
    return next(_begun) == 0


def both(case: Case, picture: Path, rule: bool) -> dict[str, Any]:
    """Run Anther's trial and, with all views, the paper's grasp from the same perception; write the picture."""
    begin, first = time.process_time(), is_first()
    run = Memory(picture.parent)
    cell = case.build()
    material = PRIORS[case.species]
    ours, done = performed(cell, lambda: pollinate(watched(cell, run), material, run, Params()))
    row = {**asdict(case), "first": first, "ours": ours, "paper": None, "notes": notes(run)}
    row |= {"capture_s": cell.capture_seconds, "seconds": run.total, "cpu_seconds": run.cpu}
    row |= {"compute_s": sum(map(run.took, COMPUTE)), "attempts": run.tries["execution"]}
    row["overlap_s"] = overlap(ours.get("phases_s", {}), run)
    row["plan_s"] = run.total.get("grasp")
    row["plan_cpu_s"] = run.cpu.get("grasp")
    if rule and case.preset == "full":
        again = case.build()
        row["paper"] = (
            performed(again, lambda: by_the_paper(again, run, material))[0] if "flowers" in run.results else ours
        )
    row["trial_cpu_s"] = time.process_time() - begin
    if "capture" in run.results:
        grasp = done.shake.grasp if done else next(iter(run.results.get("grasp", [])), None)
        portrait(run.results["capture"], grasp, picture)
    return row


def overlap(phases: dict[str, float], run: Memory) -> float:
    """Return how long the arm was on its way to the first grasp while the shake was still being chosen [s]."""
    chosen = sum(run.first.get(name, 0.0) for name in ("plant model", "shake plan", "prediction"))
    return min(phases.get(EARLY, 0.0), chosen)


@dataclass(frozen=True)
class TimedPlanner:
    """A motion planner; planning what is executed is timed."""

    planner: MotionPlanner
    run: Memory

    def __getattr__(self, name: str) -> Any:
        """Return a method of the planner, one that plans a motion with the clock around it."""
        method = getattr(self.planner, name)
        if name == "moved":
            return lambda T: TimedPlanner(method(T), self.run)
        if name not in ("move", "line", "swing"):
            return method
        return lambda *args: self.run.timed("motions", lambda _: method(*args))


def timed(cell: SimulatedCell, run: Memory) -> Cell:
    """Return the robot's side of the cell; planning motions is timed, and the simulator's steps are counted apart."""
    side, step = cell.robot_side, cell.world.run

    def stepped(*args: Any, **more: Any) -> Array:
        begin = time.thread_time()
        try:
            return step(*args, **more)
        finally:
            run.simulating += time.thread_time() - begin

    cell.world.run = stepped

    def plan_around(cloud: Cloud) -> Any:
        return TimedPlanner(side.plan_around(cloud), run)

    return replace(side, plan_around=plan_around)


def watched(cell: SimulatedCell, run: Memory) -> Cell:
    """Return the robot's side of the cell without its side camera, which no grasp needs; planning motions is timed."""
    side = timed(cell, run)
    return replace(side, robot=replace(side.robot, side_camera=None, T_world_side_camera=None))


def performed(cell: SimulatedCell, perform: Callable[[], Done]) -> tuple[dict[str, Any], Done | None]:
    """Perform, judge, and return how it went, with the simulated time of its phases [s]."""
    done = verdict = failure = None
    try:
        done = perform()
        times = done.trial.shake_times
        shaken = (float(times[0]), float(times[-1])) if len(times) else None
        verdict = judge(cell.world, shaken, done.shake.frequency, done.trial.steady)
    except StageFailure as stopped:
        failure, shaken = stopped, None
    visit = summarise(Visit("simulated", "plant", held_unharmed=False), cell, done, verdict, failure)
    summary = {k: v for k, v in as_counted(visit.flat()).items() if k not in NAMED}
    row = {k: v for k, v in summary.items() if k in LISTED or not isinstance(v, dict | list)}
    if verdict is not None:
        harm = verdict.harm
        row |= {"true_pedicel_strains": harm.pedicels.tolist(), "true_peduncle_strains": harm.peduncles.tolist()}
    row["stem_held"] = shaken is not None and row.get("grasp_organ") == "stem"
    row["axis_held"] = shaken is not None and row.get("grasp_organ") in ("stem", "branch")
    if shaken is not None:
        end = cell.world.time
        assert done is not None
        spans = zip(done.trial.phases, done.trial.phase_times.tolist(), strict=True)
        row["phases_s"] = {name: after - before for name, (before, after) in spans}
        row |= {"reach_s": shaken[0], "shake_s": shaken[1] - shaken[0], "retreat_s": end - shaken[1]}
    return row, done


def by_the_paper(cell: SimulatedCell, run: Memory, material: Material) -> Done:
    """Take and shake the plant by the paper's rule (P12-P14), seen as in `run`; it has one try, as in the paper."""
    seen = Seen(*(run.results[name] for name in ("masks", "cloud", "skeleton", "stem", "flowers")))
    planner, shake, material = paper_plan(cell, seen, material)
    robot = replace(cell.robot_side.robot, side_camera=None, T_world_side_camera=None)
    return Done(shake, execute(planner, shake, robot, cell.robot_side.limits), None, material)


def paper_plan(cell: SimulatedCell, seen: Seen, material: Material) -> tuple[Planner, ShakePlan, Material]:
    """Return how the arm takes a plant by the paper's rule and shakes it as Anther would, and the model's material."""
    params = Params()
    planner = cell.robot_side.plan_around(seen.cloud)
    assert isinstance(planner, Planner)
    grasp = paper_grasp(seen.stem, seen.skeleton, params.grasp, planner.reach)
    rods = model_plant(seen, material, params)
    limit = lambda at, direction, frequencies: planner.shake_limit(at.joints, direction, frequencies)  # noqa: E731
    delivers = lambda at, directions, frequencies: planner.delivered(at.joints, directions, frequencies)  # noqa: E731
    shake = plan_shake(rods, [grasp], arm_shaker(limit, delivers), replace(params.shake, least_amplitude=LEAST_SHAKE))
    return planner, shake, rods.material


def notes(run: Memory) -> list[str]:
    """Return what perception warned of."""
    return [note for name in ("cloud", "skeleton", "stem") for note in getattr(run.results.get(name), "notes", ())]
