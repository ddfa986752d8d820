"""What a person waits for: the core's download, kernels compiled at a first use, and warm commands, start to end.

Every command is a process of its own, as a person starts it. First uses have an empty folder for compiled code.

Keys of the --json file: compile_s (processor time) and signatures of all kernels, compiled ahead; core_mb; of
skeletonize and plan first_<command>_s and <command>_warm_s (wall, the median), <command>_warm_cpu_s (processor time,
which other work on the machine changes less), first_<command>_compile_s, and the signatures of both.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from importlib.metadata import distribution
from pathlib import Path
from typing import NamedTuple

import numpy as np
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from anther.cli.sample_data import write_samples
from evaluation.harness import finish, options, progress
from evaluation.tables import markdown

RUN = """
import sys, time; from anther.cli.main import main; code = main(sys.argv[1:])
from anther.core.compiling import COMPILED
print("used", COMPILED.kernels, COMPILED.seconds, time.process_time()); sys.exit(code)
"""


class Used(NamedTuple):
    """What one command took: from start to end, its kernels, and their and its processor time [s]."""

    wall: float
    kernels: int
    compiling: float
    processor: float


def use(compiled: Path, *words: str | Path) -> Used:
    """Run `anther` with these words in a new process, its compiled code in a folder of its own.

    Raises:
        CalledProcessError: the command fails.
    """
    environment = os.environ | {"NUMBA_CACHE_DIR": str(compiled)}
    begin = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", RUN, *map(str, words)], env=environment, capture_output=True, text=True, check=True
    )
    wall = time.perf_counter() - begin
    kernels, *seconds = done.stdout.rpartition("used ")[2].split()
    return Used(wall, int(kernels), *map(float, seconds))


def required(name: str) -> set[str]:
    """Return the distributions that one installs without extras, itself among them."""
    found, wanted = set[tuple[str, str]](), [(name, "")]
    while wanted:
        this, extra = wanted.pop()
        if (this, extra) in found:
            continue
        found.add((this, extra))
        for need in map(Requirement, distribution(this).requires or ()):
            if need.marker is None or need.marker.evaluate({"extra": extra}):
                wanted += [(canonicalize_name(need.name), part) for part in ("", *need.extras)]
    return {this for this, _ in found}


def size(name: str) -> int:
    """Return the bytes of a distribution's files, without what Python compiles of them."""
    paths = (Path(str(file.locate())) for file in distribution(name).files or () if file.suffix != ".pyc")
    return sum(path.stat().st_size for path in paths if path.is_file())


def main() -> None:
    """Measure and print."""
    args = options(__doc__, quick="three warm repetitions instead of nine")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_samples(folder)
        commands = {
            "skeletonize": ("skeletonize", folder / "plant.ply", "--overwrite", "--out", folder / "tree"),
            "plan": ("plan", folder / "skeleton.swc", "--overwrite", "--out", folder / "plan"),
        }
        first = {
            which: use(folder / f"compiled_{which}", *words) for which, words in progress(commands.items(), "first")
        }
        ahead = use(folder / "compiled", "doctor", "--compile")
        repeats = range(3 if args.quick else 9)
        warm = {
            which: [use(folder / "compiled", *words) for _ in progress(repeats, f"warm {which}")]
            for which, words in commands.items()
        }
    core = sum(size(name) for name in required("anther")) / 1e6
    metrics: dict[str, float] = {"compile_s": ahead.compiling, "signatures": ahead.kernels, "core_mb": core}
    for which, used in first.items():
        metrics |= {f"first_{which}_s": used.wall, f"first_{which}_compile_s": used.compiling}
        metrics[f"first_{which}_signatures"] = used.kernels
    for which, several in warm.items():
        metrics[f"{which}_warm_s"] = float(np.median([used.wall for used in several]))
        metrics[f"{which}_warm_cpu_s"] = float(np.median([used.processor for used in several]))
        metrics[f"{which}_warm_signatures"] = max(used.kernels for used in several)
    finish(args, metrics, markdown(("what", "value"), [(name, f"{value:.4g}") for name, value in metrics.items()]))


if __name__ == "__main__":
    main()
