"""For `protocol_faults.py`: Anther in a process of its own, as on a workstation.

It is forked from a process that has imported everything, which takes longer than a fault does.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import threading
import time
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from anther.core import AntherError, Run
from anther.perception import Capture
from anther.pollination import ShakePlan, Trial, execute
from anther.pollination.execution import EARLY, early_reach
from anther.robot import Robot, connect_cell, guard, plan_views, read_cell
from anther.robot.arm.views import Params as ViewParams
from anther.robot.cells import CellFile
from anther.robot.cells.hardware import capture_views, motion_params
from evaluation.robustness.fault_machines import Pieces
from evaluation.robustness.faults import planned

HERE = Path(__file__).parent
PATHS = str(HERE.parents[1]), str(HERE.parents[1] / "tests" / "support")
"""Where the process finds its modules and the made machines."""
LONGEST = 120.0  # s of a process


class Anther:
    """Anther's process of a case, which begins at once.

    Attributes:
        pid: number of the process.
        said: (time, phase), as the phases begin.
    """

    def __init__(self, folder: Path, base: Path, *, views: bool = False, again: bool = False) -> None:
        context = get_context("forkserver")
        context.set_forkserver_preload([__name__])
        ear, mouth = context.Pipe(duplex=False)
        handle, name = tempfile.mkstemp(dir=folder, prefix="errors-")
        os.close(handle)
        self._errors = Path(name)
        self._process = context.Process(target=_live, args=(mouth, self._errors, folder, base, views, again))
        self._process.start()
        mouth.close()
        self.pid = cast(int, self._process.pid)
        self.said = list[tuple[float, str]]()
        self._thread = threading.Thread(target=self._hear, args=(ear,), daemon=True)
        self._thread.start()

    @property
    def errors(self) -> str:
        """What it wrote of errors."""
        return self._errors.read_text()

    def waits_for(self, phase: str) -> bool:
        """Wait until a phase begins; return whether it did before the process ended."""
        until = time.monotonic() + LONGEST
        while all(name != phase for _, name in self.said):
            if not self._process.is_alive() or time.monotonic() > until:
                return False
            time.sleep(0.005)
        return True

    def arms_process(self) -> int:
        """Return the number of the process that has the arm: the first that was spawned."""
        kids = Path(f"/proc/{self.pid}/task/{self.pid}/children").read_text().split()
        spawned = [kid for kid in map(int, kids) if b"spawn_main" in Path(f"/proc/{kid}/cmdline").read_bytes()]
        return min(spawned)

    def end(self) -> int:
        """Wait for the end; return the exit status. What takes too long is killed."""
        self._process.join(LONGEST)
        if self._process.is_alive():
            os.killpg(self.pid, signal.SIGKILL)
        self._thread.join(5)
        self._process.join()
        return cast(int, self._process.exitcode)

    def _hear(self, ear: Connection) -> None:
        with suppress(EOFError):
            while True:
                self.said.append((time.monotonic(), ear.recv()))


def _live(mouth: Connection, errors: Path, folder: Path, base: Path, views: bool, again: bool) -> None:
    """Be that process."""
    os.setsid()
    sys.modules["__main__"] = ModuleType("__main__")  # the arm's own process shall not import the experiment
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background processes would ignore Ctrl-C
    os.dup2(os.open(errors, os.O_WRONLY | os.O_APPEND), 2)
    try:
        _pollinate(mouth, folder, base, views=views, again=again)
    except (AntherError, KeyboardInterrupt) as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from None


def _pollinate(mouth: Connection, folder: Path, base: Path, *, views: bool, again: bool) -> None:
    """Connect, look around where asked for, execute the stored plan; tell each phase as it begins."""
    file, (planner, plan, _) = read_cell(folder / "cell.toml"), planned(base)
    limits = file.safety_limits()
    with connect_cell(file) as bare:
        if again:
            _enable(bare)
        robot = guard(bare, limits)
        with Run(folder / "run", restart_from="shake plan" if again and not views else None, quiet=True) as run:
            if views:
                mouth.send("views")
                run.stage("capture", Capture.load, lambda advance: _seen(file, robot, advance))
            mouth.send(EARLY)
            with early_reach(planner, plan.grasp, robot, limits) as arrive:
                shake = run.stage("shake plan", ShakePlan.load, lambda _: plan)
                run.stage(
                    "execution",
                    Trial.load,
                    lambda _: execute(
                        planner,
                        shake,
                        robot,
                        limits,
                        progress=lambda done, count, name: mouth.send(name),
                        arrive=arrive,
                        watched=Pieces(shake),
                    ),
                )


def _seen(file: CellFile, robot: Robot, advance: Any) -> Capture:
    """Return a few views of nothing, driven to and taken as in a trial."""
    boxes, start = file.keep_out, robot.arm.joints()
    few = ViewParams(count=4)
    motion = motion_params(file.limits.speed_ratio)
    planned_views = plan_views(
        file.region, boxes, few, start=start, T_flange_cam=file.T_flange_cam, motion=motion, arm=file.model
    )
    return capture_views(robot, planned_views, file.T_flange_cam, advance, file.model)


def _enable(robot: Robot) -> None:
    """Enable a robot that was stopped, as `anther cell enable` does."""
    arm = cast(Any, robot.arm)
    if arm.call("cannot"):
        arm.call("enable")
