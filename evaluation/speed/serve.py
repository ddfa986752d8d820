"""How long a page of the served history takes when it has a million visits, and whether a robot waits for it.

    python -m evaluation.speed.serve [--quick]

The history is that of evaluation/speed/fleet.py, on SQLite, or on PostgreSQL with --postgresql. The server is a process
of its own (`anther history serve`); four browsers ask for pages one after another, each page once with different
days, plants and visits, while a robot records a visit every second.

Keys of the --json file: visits, pages, page_p95_s_1e6 (of all pages together), page_median_s, slowest_s (95 % of the
slowest kind of page) and slowest (which), alone_p95_s (one browser), alone_cpu_p95_s (processor time of the server for
such a page, which a busy machine does not stretch), write_p95_s (of the robot), write_alone_p95_s.
"""

from __future__ import annotations

import os
import random
import subprocess
import sys
import threading
import time
import urllib.request
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from anther.history import record_trial
from evaluation.speed.fleet import NOW, SEASON, fill, history_in, record

sys.path.append(str(Path(__file__).parents[2] / "tests" / "support"))
from postgresql_server import start

from evaluation.harness import finish, options
from evaluation.tables import measured

BROWSERS = 4
WORDS = {
    "visits": "visits of the history",
    "pages": "pages that four browsers ask for at once",
    "page_median_s": "a page, median (s)",
    "page_p95_s_1e6": "95 % of the pages, within (s)",
    "slowest_s": "95 % of the slowest kind, within (s)",
    "slowest": "the slowest kind",
    "alone_p95_s": "one browser alone: 95 % of the pages, within (s)",
    "alone_cpu_p95_s": "the same, processor time of the server (s)",
    "write_p95_s": "a robot records a visit meanwhile: 95 %, within (s)",
    "write_alone_p95_s": "the same without browsers (s)",
}


def addresses(visits: int, plants: int, count: int) -> list[tuple[str, str]]:
    """Return (kind, address) of pages in a random order, `count` of each kind."""
    rng = random.Random(3)

    def day() -> str:
        return f"{(NOW - timedelta(days=rng.randrange(SEASON - 15))).date()}"

    kinds = {
        "day": lambda: f"/?day={day()}",
        "failures": lambda: f"/?day={day()}&result=failed",
        "trends": lambda: f"/trends?days={rng.choice([7, 30, 90])}",
        "robots": lambda: "/robots",
        "plants": lambda: f"/plants?q={rng.randrange(plants)}",
        "plant": lambda: f"/plants/{10 + rng.randrange(plants)}",
        "visit": lambda: f"/visits/{10 + rng.randrange(visits)}",
        "exports": lambda: "/exports",
    }
    pages = [(kind, make()) for kind, make in kinds.items() for _ in range(count)]
    rng.shuffle(pages)
    return pages


def cpu_seconds(process: int) -> float:
    """Return the processor time of a process so far [s]."""
    fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def ask(base: str, pages: list[tuple[str, str]], waited: list[tuple[str, float]]) -> None:
    """Fetch pages one after another; note how long each took [s]."""
    for kind, address in pages:
        begin = time.perf_counter()
        with urllib.request.urlopen(base + address) as reply:
            reply.read()
        waited.append((kind, time.perf_counter() - begin))


def write_on(where: str, stop: threading.Event, waited: list[float]) -> None:
    """Record a visit every second; note how long each took [s]."""
    while not stop.is_set():
        begin = time.perf_counter()
        record_trial(record("row 0, 1", "benchmark", len(waited), datetime.now(UTC)), where)
        waited.append(time.perf_counter() - begin)
        stop.wait(1.0)


def measure(where: str, visits: int, plants: int, count: int) -> dict[str, float | str]:
    """Return the table for a history that is filled."""
    command = [sys.executable, "-m", "anther.cli", "history", "serve", where, "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ) as process:
        assert process.stdout is not None
        base = process.stdout.readline().split(" at ")[1].split("/ ")[0]
        try:
            alone, worked, apart, waited, written = [], [], [], [], []
            stop = threading.Event()
            robot = threading.Thread(target=write_on, args=(where, stop, apart))
            robot.start()
            time.sleep(10)
            stop.set()
            robot.join()
            pages = addresses(visits, plants, count)
            ask(base, sorted(dict(pages).items()), [])  # a new server loads its libraries
            for one in pages[: len(pages) // 4]:
                before = cpu_seconds(process.pid)
                ask(base, [one], alone)
                worked.append(cpu_seconds(process.pid) - before)
            stop = threading.Event()
            shares = [pages[k::BROWSERS] for k in range(BROWSERS)]
            browsers = [threading.Thread(target=ask, args=(base, share, waited)) for share in shares]
            robot = threading.Thread(target=write_on, args=(where, stop, written))
            for thread in (robot, *browsers):
                thread.start()
            for thread in browsers:
                thread.join()
            stop.set()
            robot.join()
        finally:
            process.terminate()
    by_kind = {kind: float(np.percentile([s for k, s in waited if k == kind], 95)) for kind in {k for k, _ in waited}}
    slowest = max(by_kind, key=lambda kind: by_kind[kind])
    return {
        "visits": visits,
        "pages": len(waited),
        "page_p95_s_1e6": float(np.percentile([s for _, s in waited], 95)),
        "page_median_s": float(np.median([s for _, s in waited])),
        "slowest_s": by_kind[slowest],
        "slowest": slowest,
        "alone_p95_s": float(np.percentile([s for _, s in alone], 95)),
        "alone_cpu_p95_s": float(np.percentile(worked, 95)),
        "write_p95_s": float(np.percentile(written, 95)),
        "write_alone_p95_s": float(np.percentile(apart, 95)),
    }


def main() -> None:
    """Fill a history, serve it, ask; print, and write --json."""
    own = {
        "--visits": (1_000_000, "of the history"),
        "--postgresql": (False, "on a PostgreSQL server of its own"),
    }
    args = options(__doc__, quick="10,000 visits, few pages", own=own)
    visits, count = (10_000, 4) if args.quick else (args.visits, 50)
    plants = max(visits // 40, 100)
    server = start() if args.postgresql else None
    if isinstance(server, str):
        raise SystemExit(server)
    with history_in(server) as where:
        fill(where, visits, plants)
        table = measure(where, visits, plants, count)
    finish(args, table, measured(table, WORDS))


if __name__ == "__main__":
    main()
