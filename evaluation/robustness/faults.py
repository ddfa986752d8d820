"""Random faults of arm, gripper and camera, Ctrl-C and kill -9: does each end safely, on record, and can it go on?

    python -m evaluation.robustness.faults --seed 1 --jobs 2

The plan is made once (tomato 10, from views to shake plan, in OUT/base) and read back for every fault. A fault then
hits the early reach or the execution in a MuJoCo cell, where the shake is one of three pieces that are streamed to the
arm as a watched one is (`fault_machines.Pieces`), or, one in twenty, the camera while the views are taken; one in
fifty kills the process with SIGKILL. A process that is paused is left to `protocol_faults.py`: here time stands still
meanwhile. Nine in ten cells hold the plant's main stem alone, which takes an eighth of the
time, the others the whole plant.

Faults go through a sweep in OUT/faults, each in a process of its own: what is done is not done again. Table and metrics
count all that is there, so that kinds which are added (--kinds, --each) join a campaign that ran before them.
docs/reports/robustness.md says what a safe end is; `unsafe` below checks it on the cell's own log, which the guard
never sees.
"""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np

from anther.core import InputError, Run, StageFailure
from anther.core.files import read_json, write_json
from anther.perception import Capture, Cloud
from anther.plant import TOMATO
from anther.pollination import ShakePlan, Trial, execute, pipeline
from anther.pollination.execution import early_reach
from anther.pollination.grasp import STAND_OFF
from anther.robot import Arm, DeviceError, Planner, Robot, SafetyLimits
from anther.robot.arm.sawyer import SAWYER
from anther.robot.safety import GuardedCamera
from anther.sim import Organ, SimPlant, build, grow, layout
from anther.sim.cell import BENCH, POT, Cell
from anther.sim.plant import OF_SEGMENTS
from anther.sim.robot import SimArm, SimGripper
from anther.sim.simulated_cell import PRESETS, safety_limits
from evaluation.harness import HIDDEN, Row, finish, kept, run_cases
from evaluation.perception.replay_camera import ReplayCamera
from evaluation.robustness.campaign import asked, counted, crashed, numbers
from evaluation.robustness.fault_machines import ClockCamera, Kept, Pieces, left_behind, peak, true_grip, true_stress
from evaluation.robustness.faulty_machines import STALE, Fault, FaultyCamera, Kind, with_faults

SPECIES, SEED, DISTANCE = "tomato", 10, 0.72
FEWEST_VIEWS = 3
MOTIONS = (0, 1, 2, 3, 4)  # of a trial: early reach, approach, settle, shake, retreat
SHAKE, PIECES = 3, 3  # the shake is streamed in so many pieces before it comes to rest: probe, step, hold
EXPECTED = {"pushed": "collision", "ctrl-c": "interrupted", "kill -9": "interrupted"}  # others: device_fault
LIES = ("gripper force stuck", "gripper force missing", "gripper holds nothing")  # of pads that move as they should
STRIKES: dict[str, tuple[int, ...]] = {
    **dict.fromkeys(("frames lost", "frozen picture"), (0,)),
    **dict.fromkeys(STALE, (0, 1, 3, 4)),
    **dict.fromkeys(("gripper jam", *LIES), (0, 2, 3)),
}
"""In which commands a kind strikes that does not in all `MOTIONS`: an arm that stands still cannot be stale; a gripper
is told to open, open, close in steps, release."""
STRUCK = tuple(kind for kind in get_args(Kind) if kind != "kill -9")
"""Kinds that can be chosen."""
FIRST: tuple[Kind, ...] = (
    *("command rejected", "arm stops", "stale joints", "pushed", "gripper jam", "frames lost", "ctrl-c"),
)
"""Kinds that are drawn without --kinds, beside `kill -9`. One more makes another fault of every number: choose it."""
HELD = 0.4  # of the force asked for: pads that truly press so hard hold a stem, whatever is told of it


WORD = re.compile(r"[\W_]")


@dataclass(frozen=True)
class Case:
    """One fault, and where it strikes: `views` while they are taken, else the execution."""

    number: int
    fault: Fault
    views: bool = False
    whole_plant: bool = False


def draw(number: int, seed: int, chosen: Kind | None = None) -> Case:
    """Return case `number` of a seed: of the `FIRST` kinds, or of the chosen one."""
    rng = np.random.default_rng([seed, number])
    lasting, share = bool(rng.random() < 0.3), float(rng.uniform(0, 0.8))
    if chosen is None and number % 50 == 7:
        at = int(rng.choice(MOTIONS))
        return Case(number, Fault("kill -9", at, share, piece=int(rng.integers(PIECES)) if at == SHAKE else 0))
    if chosen is None and number % 20 == 13:
        return Case(number, Fault("frames lost", int(rng.integers(0, 30)), share, lasting), views=True)
    drawn = FIRST[rng.integers(len(FIRST))]
    kind = chosen or drawn
    lasting |= kind in LIES or kind == "arm force lost"  # a sensor that is lost stays so
    fault = Fault(kind, int(rng.choice(STRIKES.get(kind, MOTIONS))), share, lasting)
    if fault.at == SHAKE or kind in ("frames lost", "frozen picture"):
        fault = replace(fault, piece=int(rng.integers(PIECES)))
    return Case(number, fault, whole_plant=number % 10 == 3)


def prepare(base: Path) -> None:
    """Make the stored results of a run up to the shake plan: a whole trial whose arm rejects every command."""
    if (base / "09_trial.npz").exists():
        return
    cell = build(SPECIES, SEED, 0.0, PRESETS["full"], distance=DISTANCE).robot_side
    dead = with_faults(cell.robot, Fault("command rejected", lasting=True))
    with Run(base) as run:
        pipeline.pollinate(replace(cell, robot=dead), TOMATO, run, pipeline.Params())


@cache
def planned(base: Path) -> tuple[Planner, ShakePlan, SafetyLimits]:
    """Return what every execution needs, read back from the base run."""
    cloud = Cloud.load(base / "03_cloud.ply")
    planner = Planner(cloud.points, cloud.obstacles, layout(DISTANCE).solids)
    return planner, ShakePlan.load(base / "08_shake_plan.json"), safety_limits(layout(DISTANCE))


@cache
def plant(whole: bool) -> SimPlant:
    """Return the plant, or its main stem alone."""
    grown = grow(SPECIES, SEED, 0.0, DISTANCE)
    if whole:
        return grown
    stem = grown.organ == Organ.STEM
    arrays = {k: v[stem] for k, v in vars_of(grown).items() if len(v) == len(stem)}
    arrays["parent"] = np.where(arrays["parent"] < 0, -1, (np.cumsum(stem) - 1)[arrays["parent"]])
    arrays |= {"faces": grown.faces[:0], "face_organ": grown.face_organ[:0]}  # no leaf blades, which can be touched
    bare = {"flower_segment": np.zeros(0, int), "flower_position": np.zeros((0, 3))}
    return replace(grown, **arrays, **bare, vertex_segment=np.full(len(grown.vertices), -1))


def vars_of(grown: SimPlant) -> dict[str, Any]:
    """Return the per-segment arrays by name."""
    return {name: getattr(grown, name) for name in OF_SEGMENTS}


def machines(cell: Cell, arm: Arm | None = None) -> Robot:
    """Return the bare machines of a cell."""
    return Robot(arm or SimArm(cell), SimGripper(cell), ClockCamera(cell), ClockCamera(cell), np.eye(4))


def run_once(base: Path, folder: Path, robot: Robot, *, restart_from: str | None = None) -> Trial:
    """Execute the plan as a run does, early reach first: the plan and the trial end up in the folder."""
    planner, plan, limits = planned(base)
    with (
        Run(folder, restart_from=restart_from, quiet=True) as run,
        early_reach(planner, plan.grasp, robot, limits) as arrive,
    ):
        shake = run.stage("shake plan", ShakePlan.load, lambda _: plan)
        return run.stage(
            "execution",
            Trial.load,
            lambda _: execute(planner, shake, robot, limits, arrive=arrive, watched=Pieces(shake)),
        )


def unsafe(cell: Cell, limits: SafetyLimits, plan: ShakePlan, case: Case) -> str:
    """Return what is not safe about how a cell was left, by its own log; "" if nothing is.

    Whole log: joints within range and speed, flange within the workspace, pot and bench untouched, no part of the robot
    but the pads pressing on the plant beyond the contact force, the pads never beyond the grip force and what the
    thinnest organ between them bears. End: left alone for half a second the arm stands still; the pads are open and,
    where the arm can still move and had gone in, it is back at the stand-off; or the pads are closed and the arm is
    where it took the stem, so nothing was torn.
    """
    log = cell.log()
    speed = np.abs(np.diff(log.joints, axis=0)) / np.diff(log.times)[:, None]
    flange = SAWYER.forward(log.joints)[:, :3, 3]
    pads = log.contact_pad <= 1
    end = np.tile(cell.arm_command, (500, 1))
    drift = np.abs(np.diff(cell.run(end, 0 * end, np.full(500, cell.grip_command))[-100::99], axis=0)).max()
    away = float(np.linalg.norm(cell.flange_pose()[:3, 3] - plan.grasp.T_world_flange[:3, 3]))
    went_in = float(np.linalg.norm(flange - plan.grasp.T_world_flange[:3, 3], axis=1).min()) < 0.1
    is_open = cell.opening > 0.04
    arm_obeys = case.fault.kind not in {"kill -9", *STALE} and (not case.fault.lasting or case.fault.kind in LIES)
    jammed = case.fault.kind == "gripper jam" and case.fault.lasting
    found = {
        "joint range": bool(np.any((log.joints < limits.joint_lower) | (log.joints > limits.joint_upper))),
        "joint speed": bool(np.any(speed > 1.02 * limits.joint_speed)),
        "workspace": not bool(limits.workspace.contains(flange).all()),
        "pot or bench": bool(np.isin(log.contact_other, (POT, BENCH)).any()),
        "contact force": peak(log.contact_sample[~pads], log.contact_force[~pads]) > limits.contact_force,
        "grip force": peak(log.contact_sample[pads], log.contact_force[pads]) > 2 * limits.grip_force,
        "stem stress": true_stress(log, cell, limits) > limits.pressing.stem_stress,
        "arm moves": bool(drift > 1e-3),
        "torn": not is_open and went_in and away > 0.03,
        "not open": not is_open and not (jammed or case.fault.kind == "kill -9"),
        "not back": is_open and went_in and arm_obeys and away < STAND_OFF - 0.01,
    }
    return ", ".join(name for name, bad in found.items() if bad)


def bad_record(folder: Path, case: Case, holds: Callable[[Trial], bool]) -> str:
    """Return what is wrong with the record of a fault, read back from disk; "" if it names the failure.

    A force that is lost late, or told of a stem that is truly held (`holds`), may go unnoticed.
    """
    wanted = EXPECTED.get(case.fault.kind, "device_fault")
    try:
        if case.fault.kind == "kill -9":
            noted = read_json(folder / "progress.json")
            good = noted["stage"] == "execution" and noted["failure"] == wanted and noted["message"]
            return "" if good else f"progress.json says {noted}"
        trial = Trial.load(folder / "09_trial.npz")
    except (InputError, KeyError) as error:
        return str(error)
    # a jam at first finds the pads open, one after the first step of closing is over at the next
    no_effect = case.fault.kind == "gripper jam" and case.fault.at != 2 and not case.fault.lasting
    no_effect |= case.fault.kind in (*LIES, "arm force lost") and trial.finished and holds(trial)
    partial = case.fault.kind == "frames lost" and len(trial.frame_times) > 0
    if trial.finished:
        return "" if no_effect or partial else "the trial says that it finished"
    blind = case.fault.kind in LIES and trial.failure == "nothing_grasped"  # a force of 0 is that of nothing
    return "" if blind or trial.failure == wanted else f"{trial.failure}: {trial.stop_reason}"


def in_execution(case: Case, base: Path, folder: Path) -> Row:
    """Let a fault strike an execution; then clear it and go on in the same world."""
    limits, plan = planned(base)[2], planned(base)[1]
    cell, killed = Cell(plant(case.whole_plant), SAWYER.ready), case.fault.kind == "kill -9"
    if killed:
        words = ["--worker", str(case.number), "--kill-at", json.dumps(asdict(case.fault)), "--out", str(folder)]
        command = [sys.executable, "-m", "evaluation.robustness.faults", *words, "--base", str(base)]
        done = subprocess.run(command, capture_output=True, check=False)
        if done.returncode != -signal.SIGKILL:
            return outcome(record=f"exit {done.returncode}: {done.stderr.decode()[-300:]}")
        left_behind(cell, folder / "world.bin")
    else:
        run_once(base, folder, with_faults(machines(cell), case.fault))
    log = cell.log()
    others = log.contact_pad == 2
    force = peak(log.contact_sample[others], log.contact_force[others])
    record = bad_record(folder, case, lambda trial: true_grip(log, trial) >= HELD * plan.press)
    why = unsafe(cell, limits, plan, case)
    again = run_once(base, folder, machines(cell), restart_from="where-it-stopped" if killed else "execution")
    after = unsafe(cell, limits, plan, replace(case, fault=replace(case.fault, lasting=False, kind="ctrl-c")))
    return outcome(why, record, after if again.finished else again.stop_reason, force)


def outcome(unsafe: str = "", record: str = "", continued: str = "", force: float = 0.0) -> Row:
    """Return what came of a case: why it was not safe, what is wrong with the record, why it could not go on; "" is
    good. And the largest force with which something but the pads pressed on the plant [N]."""
    return {"unsafe": unsafe, "record": record, "continued": continued, "force": force}


def worker(fault: Fault, base: Path, folder: Path) -> None:
    """Execute with a fault that kills this process."""
    folder.mkdir(parents=True, exist_ok=True)
    cell = Cell(plant(False), SAWYER.ready)
    run_once(base, folder, with_faults(machines(cell, Kept(cell, folder / "world.bin")), fault))


def while_seeing(case: Case, base: Path, folder: Path) -> Row:
    """Let the wrist camera lose frames while the views are taken; then take them again with a whole camera.

    The arm is not moved before the grasp is planned, so what is checked is the record and that the run goes on.
    """
    stored = Capture.load(base / "01_capture")
    record = continued = ""
    try:
        see(stored, case.fault, folder)
        lost = read_json(folder / "lost.json")
        if case.fault.lasting != bool(lost):
            record = f"{len(lost)} frames noted as lost"
    except StageFailure as failure:
        noted = read_json(folder / "progress.json")
        record = "" if noted["failure"] == failure.kind else f"progress.json says {noted}"
    try:
        see(stored, None, folder)
    except StageFailure as failure:
        continued = str(failure)
    return outcome(record=record, continued=continued)


def see(stored: Capture, fault: Fault | None, folder: Path) -> None:
    """Read all views from a camera, with a fault if one is given, and perceive the plant if any were lost."""
    replay = ReplayCamera(stored)
    camera = GuardedCamera(FaultyCamera(replay, fault) if fault else replay)

    def take(_: Any) -> Capture:
        frames, lost = {}, []
        for view in range(stored.views):
            try:
                frames[view] = camera.read()
            except DeviceError as error:
                lost.append(f"view {view}: {error}")
        write_json(folder / "lost.json", lost)
        if len(frames) < FEWEST_VIEWS:
            raise DeviceError(f"{len(lost)} of {stored.views} views were lost; allowed: all but {FEWEST_VIEWS}.")
        return subset(stored, list(frames))

    with Run(folder, quiet=True) as run:
        capture = run.stage("capture", Capture.load, take)
        if fault and capture.views < stored.views:
            pipeline.perceive(capture, layout(DISTANCE).workspace, run, pipeline.Params())


def subset(capture: Capture, views: list[int]) -> Capture:
    """Return some views of a capture."""
    pick: Callable[[Any], Any] = lambda a: None if a is None else a[views]  # noqa: E731
    names = ("depth", "T_world_cam", "rgb", "joints")
    return replace(capture, **{name: pick(getattr(capture, name)) for name in names})


def one(row: Row, folder: Path) -> Row:
    """Run one case in a process of its own, which Ctrl-C may strike, and return what came of it, for a sweep."""
    words = ["--alone", str(row["number"]), "--seed", str(row["seed"]), "--base", row["base"], "--out", str(folder)]
    words += ["--kinds", row["kind"]] if "kind" in row else []
    command = [sys.executable, "-m", "evaluation.robustness.faults", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"exit {done.returncode}: {done.stderr[-400:]}")
    return cast(Row, read_json(folder / "outcome.json"))


def stopped(why: str) -> Row:
    """Return what stands for a case whose program crashed."""
    return crashed(why) | {"force": 0.0}


def main() -> None:
    """Draw the faults, let them strike, and write a flat table of metrics of all that struck."""
    own = {"--worker": (int, HIDDEN), "--kill-at": (str, HIDDEN)}
    args = asked(__doc__, quick="20 faults instead of 1000", out="runs/faults", kinds=STRUCK, own=own)
    base = args.base or args.out / "base"
    if args.worker is not None:
        return worker(Fault(**json.loads(args.kill_at)), base, args.out)
    if args.alone is not None:
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background processes would ignore Ctrl-C
        case = draw(args.alone, args.seed, *args.kinds)
        found = (while_seeing if case.views else in_execution)(case, base, args.out)
        return write_json(args.out / "outcome.json", found)
    prepare(base)
    cases: list[Row] = [
        {"number": number, "seed": args.seed, "base": str(base.resolve()), **kind}
        for kind in [{"kind": kind} for kind in args.kinds] or [{}]
        for number in numbers(args, quick=20)
    ]
    run_cases(one, cases, args.out / "faults", args.jobs, stopped)
    rows = []
    for row in kept(args.out / "faults", stopped):
        case = draw(row["number"], row["seed"], row.get("kind"))
        rows.append(row | {"case": case, "kind": case.fault.kind + (" (views)" if case.views else "")})
    table, bad, metrics = counted(
        rows, sorted({row["kind"] for row in rows}), lambda kind: WORD.sub("_", kind).strip("_")
    )
    metrics["whole_plant_faults"] = sum(row["case"].whole_plant for row in rows)
    metrics["largest_contact_force_n"] = max(row["force"] for row in rows)
    return finish(args, metrics, table, *bad)


if __name__ == "__main__":
    main()
