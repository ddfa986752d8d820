"""What a sweep costs a task, what two workers gain over one, and what is lost when everything is killed.

    python -m evaluation.speed.sweep [--quick]

overhead   tasks that do nothing, on two workers: wall time of one
speedup    the same trials (`anther trial --preset fast --no-watch`; with --quick shaken rods) on one worker and on two
           of this machine, as a sweep starts them: each keeps to a core
kills      shaken rods of a quarter of a second under scheduler, workers and client that are processes of their own: a
           worker is killed (SIGKILL) every few seconds, scheduler and client once each, and both started again

Keys of --json: overhead_ms_task and overhead_cpu_ms_task (processor time of client, scheduler and workers together),
speedup_2 (wall, the workers' start included), lost_after_kills, doubles (rows whose function ran to its end more than
once), wrong (results that another computation does not give), kills, poison, and load (of the machine by others, at the
start: wall times mean little if it is not near 0).
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from distributed import Client, LocalCluster

from anther.cli import sweep as sweep_command
from anther.history import sweep
from evaluation.harness import HIDDEN, ONE_THREAD, finish, options
from evaluation.tables import measured

Rows = list[dict[str, Any]]
WORDS = {
    "load": "load of the machine by others, at the start",
    "overhead_tasks": "tasks that do nothing",
    "overhead_ms_task": "each, by the clock (ms)",
    "overhead_cpu_ms_task": "each, processor time of client, scheduler and workers together (ms)",
    "wall_1_worker_s": "the same tasks on one worker (s)",
    "wall_2_workers_s": "and on two (s)",
    "speedup_2": "one worker's time over two workers'",
    "tasks": "tasks of a sweep whose processes are killed",
    "kills": "processes killed",
    "begun_more_than_once": "tasks begun more than once",
    "lost_after_kills": "tasks lost",
    "doubles": "tasks done twice",
    "wrong": "of ten of their results, not what another computation gives",
    "poison": "tasks given up",
}


def nothing(row: dict[str, Any], folder: Path) -> None:
    """Do nothing."""


def shaken(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Shake a leafless stem of the row's stiffness and return how far its tip moved; the end is noted in a ledger."""
    from anther.rods import Clamp, Drive, Rods, simulate  # noqa: PLC0415

    nodes = np.zeros((31, 3))
    nodes[:, 2] = np.linspace(0, 0.4, 31)
    stem = Rods(nodes, np.arange(31) - 1, edge_radius=3e-3, youngs=row["youngs"], density=1050.0, viscous_time=2e-3)
    shake = Drive(10, np.array([1.0, 0.0, 0.0]), 2e-3, 5.0, ramp=0.2)
    run = simulate(stem, Clamp.root(stem), shake, duration=row["seconds"], dt=1e-3)
    np.savez(folder / "tip.npz", tip=run.displacement(30))
    moved = {"tip_mm": 1e3 * float(np.ptp(run.displacement(30)[:, 0]))}
    with Path(row["ledger"]).open("a") as ledger:
        ledger.write(f"{row['youngs']}\n")
    return moved


def rods(count: int, ledger: Path, seconds: float) -> Rows:
    """Return rows for `shaken`."""
    return [{"youngs": 1e8 + 1e5 * k, "seconds": seconds, "ledger": str(ledger)} for k in range(count)]


@contextmanager
def cluster(workers: int) -> Iterator[str]:
    """Yield the address of a local cluster whose workers have started."""
    made_of: dict[str, Any] = {"processes": True, "threads_per_worker": 1, "dashboard_address": None}
    with LocalCluster(n_workers=workers, silence_logs=50, env=ONE_THREAD, **made_of) as made, Client(made) as client:
        client.wait_for_workers(workers)
        yield made.scheduler_address


def _processor_time() -> float:
    me = psutil.Process()
    times = [process.cpu_times() for process in (me, *me.children(recursive=True))]
    return sum(t.user + t.system for t in times)


def overhead(tasks: int, folder: Path) -> dict[str, float]:
    """Return what a task that does nothing takes."""
    with cluster(2) as scheduler:
        start, cpu = time.perf_counter(), _processor_time()
        jobs = sweep.run(nothing, [{"n": n} for n in range(tasks)], folder, scheduler=scheduler)
        wall, cpu = time.perf_counter() - start, _processor_time() - cpu
    assert all(job.state == "done" for job in jobs)
    return {"overhead_ms_task": 1e3 * wall / tasks, "overhead_cpu_ms_task": 1e3 * cpu / tasks, "overhead_tasks": tasks}


def speedup(folder: Path, *, quick: bool) -> dict[str, float]:
    """Return what two workers gain over one, with the same rows."""
    function, rows = shaken, rods(40, folder / "ledger", 20.0)
    if not quick:
        function = sweep_command.trial
        rows = [{"plant": "tomato", "seed": seed, "preset": "fast", "watch": False} for seed in range(8)]
    folder.mkdir(exist_ok=True)
    took = {}
    for workers in (1, 2):
        start = time.perf_counter()
        jobs = sweep.run(function, rows, folder / str(workers), workers=workers)
        took[workers] = time.perf_counter() - start
        assert all(job.state == "done" for job in jobs)
    return {"speedup_2": took[1] / took[2], "wall_1_worker_s": took[1], "wall_2_workers_s": took[2]}


class Killable:
    """Scheduler, workers and client as processes that can be killed and are started again."""

    def __init__(self, folder: Path, tasks: int) -> None:
        self.folder, self.tasks, self.kills = folder, tasks, 0
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.log = (folder / "log").open("a")
        self.scheduler, self.workers, self.client = self.start_scheduler(), self.start_workers(), self.start_client()

    def _start(self, *words: str) -> subprocess.Popen[bytes]:
        environment = os.environ | ONE_THREAD
        return subprocess.Popen([sys.executable, *words], stdout=self.log, stderr=self.log, env=environment)

    def start_scheduler(self) -> subprocess.Popen[bytes]:
        """Start a scheduler at the port."""
        words = ("--host", "127.0.0.1", "--port", str(self.port), "--no-dashboard")
        return self._start("-m", "distributed.cli.dask_scheduler", *words)

    def start_workers(self) -> subprocess.Popen[bytes]:
        """Start two workers under their nannies."""
        words = ("--nworkers", "2", "--nthreads", "1", "--no-dashboard", "--local-directory", str(self.folder))
        return self._start("-m", "distributed.cli.dask_worker", self.address, *words)

    def start_client(self) -> subprocess.Popen[bytes]:
        """Start the sweep, or go on with it."""
        return self._start("-m", "evaluation.speed.sweep", "--client", str(self.folder), self.address, str(self.tasks))

    def done(self) -> float:
        """Return the share of tasks that are finished."""
        tasks = self.folder / "sweep" / "tasks"
        return len(list(tasks.iterdir())) / self.tasks if tasks.is_dir() else 0.0

    def kill_worker(self, turn: int) -> None:
        """Kill one of the workers; its nanny starts another."""
        nannied = psutil.Process(self.workers.pid).children(recursive=True)
        alive = [child for child in nannied if any("spawn_main" in word for word in child.cmdline())]
        if alive:
            alive[turn % len(alive)].kill()
            self.kills += 1

    def kill_scheduler(self) -> None:
        """Kill the scheduler; workers end with it, and whoever runs the cluster starts all again."""
        self.scheduler.kill()
        self.scheduler.wait()
        self.workers.terminate()
        self.workers.wait()
        self.scheduler, self.workers = self.start_scheduler(), self.start_workers()

    def kill_client(self) -> None:
        """Kill the client and start it again."""
        self.client.kill()
        self.client.wait()
        self.client = self.start_client()

    def end(self) -> None:
        """Stop all."""
        for process in (self.client, self.workers, self.scheduler):
            process.send_signal(signal.SIGTERM)
            process.wait()
        self.log.close()


def kills(folder: Path, tasks: int, every: float) -> dict[str, float]:
    """Return what is left of a sweep whose processes are killed: a worker every so many seconds, the others once."""
    folder.mkdir(parents=True, exist_ok=True)
    running = Killable(folder, tasks)
    once = [(0.66, running.kill_client), (0.33, running.kill_scheduler)]
    try:
        turn, last = 0, time.monotonic()
        while running.client.poll() is None:
            time.sleep(0.2)
            if once and running.done() > once[-1][0]:
                once.pop()[1]()
            elif running.done() > 0 and time.monotonic() - last > every:
                running.kill_worker(turn)
                turn, last = turn + 1, time.monotonic()
        assert not once, f"the sweep ended before all was killed, see {folder / 'log'}"
    finally:
        running.end()
    return left(folder, tasks) | {"kills": running.kills + 2}


def left(folder: Path, tasks: int) -> dict[str, float]:
    """Return what the sweep's jobs, folders and ledger say."""
    jobs = sweep.read(folder / "sweep")
    done = [job for job in jobs if job.state == "done" and (folder / "sweep" / "tasks" / job.key / "tip.npz").is_file()]
    ended = Counter((folder / "ledger").read_text().split())
    sample = done[:: max(1, len(done) // 10)]
    with tempfile.TemporaryDirectory() as elsewhere:
        aside = {"ledger": f"{elsewhere}/ledger"}
        wrong = sum(job.result != shaken(job.row | aside, Path(elsewhere)) for job in sample)
    return {
        "tasks": tasks,
        "lost_after_kills": tasks - len(done),
        "doubles": sum(count > 1 for count in ended.values()) + len(jobs) - len({job.key for job in jobs}),
        "wrong": wrong,
        "poison": sum(job.state == "poison" for job in jobs),
        "begun_more_than_once": sum(job.tries > 1 for job in jobs),
    }


def main() -> None:
    """Measure, print a table, write --json."""
    own = {
        "--part": (("overhead", "speedup", "kills"), "what is measured", ("overhead", "speedup", "kills")),
        "--tasks": (100_000, "that do nothing"),
        "--killed": (300, "tasks of the sweep that is killed"),
        "--every": (6.0, "seconds between killed workers"),
        "--folder": (Path, "keep all in this folder instead of a temporary one"),
        "--client": {"nargs": 3, "help": HIDDEN},
    }
    args = options(__doc__, quick="500 tasks of nothing, rods instead of trials, 60 tasks", own=own)
    if args.client:
        folder, scheduler, tasks = args.client
        rows = rods(int(tasks), Path(folder) / "ledger", 8.0)
        sweep.run(shaken, rows, Path(folder) / "sweep", scheduler=scheduler, deaths=20)
        return
    metrics = {"load": os.getloadavg()[0]}
    with tempfile.TemporaryDirectory(prefix="anther-sweep-") as temporary:
        folder = args.folder or Path(temporary)
        if "overhead" in args.part:
            metrics |= overhead(500 if args.quick else args.tasks, folder / "overhead")
        if "speedup" in args.part:
            metrics |= speedup(folder / "speedup", quick=args.quick)
        if "kills" in args.part:
            metrics |= kills(folder / "kills", 60 if args.quick else args.killed, args.every)
    finish(args, metrics, measured(metrics, WORDS))


if __name__ == "__main__":
    main()
