"""Other rod solvers, and our own of another commit, run beside ours on the same case, each in a process of its own.

The case travels as a file: nodes (N, 3), edges (M, 2), fixed (C,) and the settings as JSON. Every driver prints
processor seconds without start-up and without compilation, and where the observed node ended.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.rods import Rods
from evaluation.harness import ONE_THREAD

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Case:
    """One shake, as all solvers are told it: at rest and unstressed at t = 0, gravity on, nodes 0 and 1 held."""

    rods: Rods
    grip: int = 20
    amplitude: float = 2e-3
    hertz: float = 30.0
    dt: float = 1e-3
    steps: int = 100
    tolerance: float = 1e-9
    twist: bool = False
    observe: int = 50

    @property
    def seconds(self) -> float:
        """Simulated time [s]."""
        return self.steps * self.dt

    def write(self, path: Path) -> None:
        """Write the case for a driver."""
        rods, settings = self.rods, {k: v for k, v in asdict(self).items() if k != "rods"}
        settings |= {"radius": rods.edge_radius[1], "density": rods.density[1], "youngs": rods.youngs[1]}  # type: ignore[index]
        edges = np.stack([rods.parent[1:], np.arange(1, len(rods.parent))], axis=1)
        np.savez(path, nodes=rods.nodes, edges=edges, fixed=np.array([0, 1]), settings=json.dumps(settings))


def run_dismech(checkout: Path, case: Case) -> dict[str, Any]:
    """Run PyDiSMech from its checkout: seconds, iterations, x, y, z; or `failed`, in its own words."""
    return _run([sys.executable, HERE / "run_dismech.py", checkout], case)


def run_pyelastica(python: Path, case: Case) -> dict[str, Any]:
    """Run PyElastica with the Python that has it: seconds, dt, x, y, z; or `failed`."""
    return _run([python, HERE / "run_pyelastica.py"], case)


def run_batch(source: Path, room: str, rods: Rods, seen: NDArray[np.int64], plants: int) -> float:
    """Return the processor seconds that the engine in a source folder takes for a batch (see run_batch.py).

    Raises:
        SystemExit: it fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "batch.npz"
        np.savez(path, nodes=rods.nodes, parent=rods.parent, seen=seen, plants=plants)
        done = _in_new_process([sys.executable, HERE / "run_batch.py", room, path], {"PYTHONPATH": str(source)})
    if done.returncode != 0:
        raise SystemExit(done.stderr)
    return float(done.stdout)


def _run(command: list[Any], case: Case) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "case.npz"
        case.write(path)
        done = _in_new_process([*command, path], {"PYTHONWARNINGS": "ignore"})
    if done.returncode != 0:
        return {"failed": (done.stderr.strip().splitlines() or ["no output"])[-1]}
    return json.loads(done.stdout.strip().splitlines()[-1])


def _in_new_process(command: list[Any], more: dict[str, str]) -> subprocess.CompletedProcess[str]:
    environment = os.environ | ONE_THREAD | more
    return subprocess.run(list(map(str, command)), env=environment, capture_output=True, text=True, check=False)
