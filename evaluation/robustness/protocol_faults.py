"""Faults through the machines' own protocols: does each end safely, on record, and can the trial go on?

    python -m evaluation.robustness.protocol_faults --seed 1 --jobs 2

A Sawyer behind a ROS 1 master, a Robotiq over Modbus TCP and two cameras of the RealSense SDK stand for the machines
(`protocol_machines.py`). Anther runs in a process of its own, as on a workstation: from a cell file it connects, takes
a few views, and executes the stored plan of `faults.py` (faults/base beside OUT, made when missing), where the shake
comes in pieces.
On the way a fault strikes, each kind in every phase, at a moment drawn by its number. Then everything is put right, a
robot that was stopped is enabled, and another process goes on with the run.

What came of a fault is kept in OUT/protocol and is not done again (no sweep: its workers may have no children). Table
and metrics count all that is there, so that kinds which are added (--kinds, --each) join a campaign that ran before
them. It is
real protocol on one machine's loopback, by the wall's clock: where the machine itself is too slow for the arm
(`HELD_UP`), a case is begun again, TRIES times at most, and counted.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from anther.core import AntherError, Array, InputError
from anther.core.files import read_json, write_json
from anther.pollination import ShakePlan, Trial
from anther.pollination.execution import EARLY
from anther.pollination.grasp import STAND_OFF
from anther.robot.arm.sawyer import SAWYER
from evaluation.harness import finish, progress
from evaluation.robustness.campaign import asked, counted, crashed, numbers
from evaluation.robustness.faults import planned, prepare
from evaluation.robustness.protocol_anther import PATHS, Anther
from evaluation.robustness.protocol_machines import Machines

PHASES = {"views": 6.0, EARLY: 2.5, "approach": 1.5, "close": 1.5, "shake": 3.5, "retreat": 1.0}
"""Where faults strike, and how long each lasts about [s]."""
EXPECTED: dict[str, str] = {
    "the robot's node dies": r"nobody listens|ms old",
    "the master dies": "",
    "readings 200 ms late": "ms old",
    "5 % of messages lost": "",
    "the robot's clock jumps": "ms old",
    "joints not a number": "nan",
    "joints renamed": r"missing|ms old",
    "a joint missing": "right_j6 missing",
    "joints in another order": "",
    "joints silent": "ms old",
    "stale with noise": "readings are stale|does not follow",
    "one joint stale": "readings are stale|does not follow",
    "paused": "Let nothing else run|Look at what else runs here|ms old|no frame",
    "gripper silent": "gripper: no answer",
    "gripper jams": r"gripper: its motion does not end|nothing was|holds nothing|stand",
    "gripper reports a fault": "gripper: its inner processor failed",
    "gripper says that it holds": "gripper force",
    "gripper feels nothing": "jammed|holds? nothing",
    "side camera unplugged": "unplugged|camera",
    "wrist camera unplugged": "unplugged|camera",
    "side camera frozen": "same picture|picture of the recording",
    "stop button": "stop button|it is stopped",
    "cuff held": "cuff is held",
    "robot feels a collision": "felt a collision",
    "robot reports an error": "reports an error",
    "robot switched off": "not enabled",
    "pushed": "contact force",
    "arm force stuck": "arm force",
    "arm force not a number": "arm force|ms old, or no number",
    "arm force silent": "arm force|ms old, or no number",
    "Ctrl-C": "",
    "kill -9": "",
    "the arm's process killed": "own process is gone",
    "a second process": "",
}
"""What the record must say of each; "" where it may finish, or is told otherwise."""
FIRST = (
    *("the robot's node dies", "the master dies", "readings 200 ms late", "5 % of messages lost"),
    *("the robot's clock jumps", "joints not a number", "joints renamed", "a joint missing", "joints in another order"),
    *("joints silent", "gripper silent", "gripper jams", "gripper reports a fault", "side camera unplugged"),
    *("wrist camera unplugged", "stop button", "cuff held", "robot feels a collision", "robot reports an error"),
    *("robot switched off", "pushed", "Ctrl-C", "kill -9", "the arm's process killed", "a second process"),
)
"""Kinds that strike in turn without --kinds. One more would make another fault of every number: choose it."""
STALE_KINDS = ("stale with noise", "one joint stale")
GOES_ON = ("the master dies", "5 % of messages lost", "joints in another order", "a second process")
LIES = ("gripper says that it holds", "gripper feels nothing")
"""Of a gripper that obeys."""
PAUSE = 0.5
"""Anther's processes stand still for so long [s]: beyond every time-out of an arm."""
BRAKES = (
    *("readings 200 ms late", "the robot's clock jumps", "joints not a number", "joints renamed", "a joint missing"),
    *(
        "arm force not a number",
        "arm force silent",
        "joints silent",
        *STALE_KINDS,
        "stop button",
        "robot feels a collision",
        "robot reports an error",
    ),
    *("kill -9", "paused", "the arm's process killed"),
)
"""After these the arm stops at once, and the time until it stands is measured."""
HELD_UP = ("Let nothing else run", "Look at what else runs here", "ms old")
TRIES = 4
OUTCOME, CRASHED, JUMPED = "outcome.json", "crashed", "jumped"


WORD = re.compile(r"[^a-z0-9]+")
STILL, RESTS = 0.01, 0.1
"""An arm that is slower than this [rad/s] for so long [s] stands: in a shake it turns about in no time."""
JUMP = 3e-3
"""An arm that is further than this from where it goes on within its acceleration has jumped [rad]; a guess: a command
that comes late is within 1 mrad."""
LATE_WAY, STOOD, AROUND = 1e-3, 0.013, 0.04
"""A command that is older than the first when the fake robot takes it was late on its way: of 16,000 on a quiet machine
1 % were. A robot that logs each 10 ms, and did not for the second, stood still. Either shows within the third [s]."""
UNEVEN = 10
"""Speeds are of so many readings: a command that comes a millisecond late is a step of what a fake follows at once."""


@dataclass(frozen=True)
class Case:
    """One fault: what befalls whom, in which phase, and how far into it (0 to 1)."""

    number: int
    kind: str
    phase: str
    share: float


def draw(number: int, seed: int, chosen: str = "") -> Case:
    """Return case `number` of a seed, every kind in every phase in turn: of the `FIRST` kinds, or of the chosen one."""
    kinds, phases = (chosen,) if chosen else FIRST, list(PHASES)
    share = float(np.random.default_rng([seed, number]).uniform())
    return Case(number, kinds[number % len(kinds)], phases[number // len(kinds) % len(phases)], share)


def struck(case: Case, base: Path, folder: Path) -> dict[str, Any]:
    """Let a fault strike, put everything right, go on; return what came of it."""
    plan = planned(base)[1]
    machines = Machines(folder, SAWYER.ready)
    try:
        run, views = folder / "run", case.phase == "views"
        anthers = Anther(folder, base, views=views)
        began = anthers.waits_for(case.phase)
        at, moving, other = time.monotonic(), 0.0, ""
        if began:
            time.sleep(case.share * PHASES[case.phase])
            at = time.monotonic()
            moving = speed_at(machines, at)
            other = strike(case, machines, anthers, partial(Anther, folder, base))
        code = anthers.end()
        time.sleep(0.6)
        row: dict[str, Any] = {"moving": moving, "code": code}
        row["stop_s"] = stop_time(machines, at) if case.kind in BRAKES and moving > STILL else None
        row["unsafe"] = unsafe(machines, plan, case, at)
        row["record"] = bad_record(run, case, anthers, began, moving > STILL) or other
        machines.repair()
        time.sleep(0.3)
        again = Anther(folder, base, views=views and not (run / "01_capture").exists(), again=True)
        again.end()
        row["continued"] = "" if finished(run) else said_in(run) or again.errors[-300:]
        before = row["record"] + said_in(run)
        uneven = row["unsafe"] in (JUMPED, f"joint speed, {JUMPED}")
        slow = (uneven and robot_held_up(machines, at)) or held_up(case, began, before, row["continued"])
        return row | {"held_up": slow, "said": said_in(run)}
    finally:
        machines.close()


def strike(case: Case, machines: Machines, anthers: Anther, another: Callable[[], Anther]) -> str:
    """Let the fault befall whom it befalls; return what went wrong when `another` process was begun, or ""."""
    match case.kind:
        case "Ctrl-C":
            os.kill(anthers.pid, signal.SIGINT)
        case "kill -9":
            os.kill(anthers.pid, signal.SIGKILL)
        case "the arm's process killed":
            os.kill(anthers.arms_process(), signal.SIGKILL)
        case "paused":
            for sign in (signal.SIGSTOP, signal.SIGCONT):
                for process in (anthers.arms_process(), anthers.pid):
                    os.kill(process, sign)
                time.sleep(PAUSE)
        case "a second process":
            second = another()
            return "" if second.end() and "commanded by another process" in second.errors else "was let in"
        case kind:
            machines.strike(kind)
    return ""


def held_up(case: Case, began: bool, before: str, after: str) -> bool:
    """Whether the machine itself was too slow, by what was told of the fault and, all put right, of going on: joints
    came late though nobody had made them, as before the phase of the fault `began`."""
    wanted = EXPECTED[case.kind].split("|") if began else []
    return any(why in after or (why in before and why not in wanted) for why in HELD_UP)


def speed_at(machines: Machines, when: float) -> float:
    """Return the greatest speed of any joint just before a moment [rad/s]."""
    times, joints = machines.log()
    last = joints[times > when - 0.05]
    return float(np.abs(np.diff(last, axis=0)).max() / 0.01) if len(last) > 1 else 0.0


def stop_time(machines: Machines, at: float) -> float:
    """Return how long after the fault the arm moved on before it stood for `RESTS` [s]; infinite if it never stood."""
    times, joints = machines.log()
    speed = np.abs(np.diff(joints, axis=0)).max(axis=1) / np.diff(times)
    moved = np.concatenate([[at], times[1:][(times[1:] > at) & (speed > STILL)]])
    stood = np.flatnonzero(np.diff(moved, append=times[-1]) > RESTS)
    return float(moved[stood[0]] - at) if len(stood) else float("inf")


def unsafe(machines: Machines, plan: ShakePlan, case: Case, at: float) -> str:
    """Return what is not safe about how the machines were left, by the robot's own log; "" if nothing is.

    Whole log: joints within range and speed; nor does an arm jump when a pause is over, or its readings are not to be
    believed. End: the arm stands; the pads are open, or, where nothing could open them,
    closed with the arm where it took the stem. A robot whose node died tells nothing after the fault.

    Args:
        machines: as they are now.
        plan: of the shake.
        case: what befell them.
        at: when it did [s].
    """
    times, joints = machines.log()
    speed = np.abs(joints[UNEVEN:] - joints[:-UNEVEN]) / (times[UNEVEN:] - times[:-UNEVEN])[:, None]
    flange = SAWYER.forward(joints[:: max(len(joints) // 2000, 1)])[:, :3, 3]
    away = np.linalg.norm(flange - plan.grasp.T_world_flange[:3, 3], axis=1)
    is_open, gripper_obeys = machines.opening > 0.03, case.kind in LIES or not case.kind.startswith("gripper")
    anther_lives = case.kind not in ("kill -9",)
    last = times > (np.inf if case.kind == "the robot's node dies" else max(at, times[-1] - 0.3))
    found = {
        "joint range": bool(np.any((joints < SAWYER.lower) | (joints > SAWYER.upper))),
        "joint speed": bool(np.any(speed > 1.05 * SAWYER.velocity)),
        JUMPED: case.kind in ("paused", *STALE_KINDS) and jump(times[times > at], joints[times > at])[0] > JUMP,
        "arm moves": bool(np.abs(np.diff(joints[last], axis=0)).max(initial=0.0) > 1e-3),
        "torn": not is_open and float(away.min()) < 0.1 and float(away[-1]) > 0.03,
        "not open": not is_open and gripper_obeys and anther_lives,
        "not back": is_open and case.kind in GOES_ON and float(away[-1]) < STAND_OFF - 0.01,
    }
    return ", ".join(name for name, bad in found.items() if bad)


def jump(times: Array, joints: Array) -> tuple[float, float]:
    """Return how far joints (T, 7) were at most from where they went on within their acceleration [rad], and when."""
    seconds = np.diff(times)[:, None]
    rate = np.diff(joints, axis=0) / seconds
    beyond = np.abs(np.diff(rate, axis=0)) - SAWYER.acceleration * (seconds[1:] + seconds[:-1]) / 2
    far = np.append((beyond * seconds[1:]).max(axis=1), 0.0)
    return float(far.max()), float(times[far.argmax()])


def robot_held_up(machines: Machines, at: float) -> bool:
    """Whether what the arm did furthest from its motion since a fault [s] is the fake robot's own doing, whose threads
    share this machine: it took a command late that was sent in time, or stood still itself. A command that is as old as
    the pause was sent late."""
    times, joints = machines.log()
    when = jump(times[times > at], joints[times > at])[1]
    ways = [age for taken, age in machines.robot.ways if abs(taken - when) < AROUND]
    still = np.diff(times[np.abs(times - when) < AROUND]).max(initial=0.0)
    return LATE_WAY < max(ways, default=0.0) < PAUSE / 2 or STOOD < still < PAUSE / 2


def bad_record(run: Path, case: Case, anthers: Anther, began: bool, moving: bool) -> str:
    """Return what is wrong with the record of a fault, read back from disk; "" if it names what happened.

    A pause while the arm was not `moving` may go unnoticed.
    """
    if not began:
        return f"{case.phase} never began: {said_in(run) or anthers.errors[-300:]}"
    try:
        noted = read_json(run / "progress.json")
        trial = Trial.load(run / "09_trial.npz") if noted["stage"] == "execution" and not noted["failure"] else None
    except (AntherError, KeyError, OSError) as error:
        return str(error)
    said, failure = (noted["message"], noted["failure"]) if trial is None else (trial.stop_reason, trial.failure)
    if trial is not None and trial.finished:
        good = no_effect(case) or (case.kind == "paused" and not moving)
    elif case.kind in ("Ctrl-C", "kill -9"):
        good = failure == "interrupted"
    elif case.kind in GOES_ON:
        good = False
    else:
        good = re.search(EXPECTED[case.kind], said + anthers.errors[-500:]) is not None
    return "" if good else f"{failure}: {said}"


def no_effect(case: Case) -> bool:
    """Whether a trial may finish though it was struck: nobody needs any more what failed, or it may fail unnoticed."""
    late = case.phase == "retreat"
    wrist = case.kind == "wrist camera unplugged"
    gripper = case.kind.startswith("gripper") and (late or case.phase in ("close", "shake"))
    return case.kind in GOES_ON or late or wrist or gripper


def finished(run: Path) -> bool:
    """Whether the run's trial finished."""
    with suppress(InputError, OSError):
        return Trial.load(run / "09_trial.npz").finished
    return False


def said_in(run: Path) -> str:
    """Return why the run's trial ended."""
    with suppress(InputError, OSError):
        return Trial.load(run / "09_trial.npz").stop_reason
    return ""


def one(case: Case, *, seed: int, base: Path, out: Path) -> dict[str, Any]:
    """Return a case and what came of it; one for which the machine was too slow begins again. Keep it."""
    folder = out / f"{seed}-{case.number:04d} {case.kind}, {case.phase}"
    kept = folder / OUTCOME
    if kept.exists():
        return read_json(kept)
    found: dict[str, Any] = {}
    for begun_again in range(TRIES):
        shutil.rmtree(folder, ignore_errors=True)
        try:
            found = struck(case, base, folder) | {"begun_again": begun_again}
        except Exception as error:  # of the experiment: one case's must not end a run of hours
            return {**asdict(case), **crashed(repr(error)), "stop_s": None, "begun_again": 0}
        if not found["held_up"]:
            break
    write_json(kept, {**asdict(case), **found})
    return {**asdict(case), **found}


def main() -> None:
    """Draw the faults, let them strike, and write a flat table of metrics of all that struck."""
    quick = "one fault of every other kind, the phases in turn, instead of 1000"
    args = asked(__doc__, quick=quick, out="runs/protocol_faults", kinds=EXPECTED)
    base = (args.base or args.out.parent / "faults" / "base").resolve()
    prepare(base)
    if args.quick and not args.kinds:
        cases = [draw(place % len(PHASES), args.seed, kind) for place, kind in enumerate(list(EXPECTED)[::2])]
    else:
        cases = [draw(number, args.seed, kind) for kind in args.kinds or [""] for number in numbers(args)]
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [*PATHS, os.environ.get("PYTHONPATH")]))
    kept = args.out.resolve() / "protocol"
    with ProcessPoolExecutor(args.jobs, mp_context=get_context("spawn")) as pool:
        ran = pool.map(partial(one, seed=args.seed, base=base, out=kept), cases)
        again = [row for row in progress(ran, "faults", len(cases)) if row["record"] == CRASHED]
    rows = [*(read_json(path) for path in sorted(kept.glob(f"*/{OUTCOME}"))), *again]
    rows = [row | {"case": Case(**{name: row[name] for name in Case.__annotations__})} for row in rows]
    table, bad, metrics = counted(rows, EXPECTED, lambda kind: WORD.sub("_", kind.lower()).strip("_"), stops=True)
    metrics["begun_again"] = sum(row["begun_again"] for row in rows)
    words = f"Begun again, since the computer was too slow for the arm: {metrics['begun_again']:.0f}."
    finish(args, metrics, table, *bad, words)


if __name__ == "__main__":
    main()
