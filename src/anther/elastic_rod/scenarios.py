"""Many simulations at once, on all cores: grips x frequencies x amplitudes x materials."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Literal

from numpy.typing import ArrayLike
from rich.progress import track

from anther.checks import check_range
from anther.elastic_rod.motion import Clamp, Motion
from anther.elastic_rod.rods import GRAVITY, Rods
from anther.elastic_rod.simulation import Trajectory, simulate
from anther.errors import StageFailure


@dataclass(frozen=True, slots=True, eq=False)
class Scenario:
    """One simulation to be done: the arguments of `simulate`."""

    rods: Rods
    clamp: Clamp
    drive: Motion | None
    duration: float
    dt: float
    gravity: ArrayLike = GRAVITY
    integrator: Literal["midpoint", "implicit_euler"] = "midpoint"
    start: Literal["equilibrium", "scanned"] = "equilibrium"
    tolerance: float = 1e-8
    record_every: int = 1


def simulate_many(
    scenarios: Sequence[Scenario], *, workers: int | None = None, progress: bool = False
) -> list[Trajectory | StageFailure]:
    """Simulate every scenario; bit for bit what `simulate` gives for each alone, in the order given.

    The compiled kernels release Python's lock, so threads suffice: nothing is copied between processes.

    Args:
        scenarios: what to simulate.
        workers: threads; None means one per core.
        progress: show a progress bar.

    Returns:
        A trajectory each, or the failure of one that could not be solved: it takes no other with it.

    Raises:
        InputError: arguments out of range in any scenario.
    """
    count = os.cpu_count() or 1 if workers is None else workers
    check_range("workers", count, 1, 4096)
    with ThreadPoolExecutor(count) as pool:
        runs = [pool.submit(_simulated, scenario) for scenario in scenarios]
        try:
            return [run.result() for run in track(runs, "scenarios", disable=not progress)]
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _simulated(scenario: Scenario) -> Trajectory | StageFailure:
    try:
        return simulate(**{name: getattr(scenario, name) for name in Scenario.__dataclass_fields__})
    except StageFailure as failure:
        return failure
