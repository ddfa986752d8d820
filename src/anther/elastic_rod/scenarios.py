"""Many simulations at once, on all cores: grips x frequencies x amplitudes x materials."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, Literal

from numba.core import config
from numpy.typing import ArrayLike
from rich.progress import track

from anther.checks import check_range
from anther.elastic_rod.motion import Clamp, Motion
from anther.elastic_rod.rods import GRAVITY, Rods
from anther.elastic_rod.simulation import Trajectory, simulate
from anther.errors import StageFailure, bad_input


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
    scenarios: Sequence[Scenario],
    *,
    device: Literal["cpu", "cuda"] = "cpu",
    workers: int | None = None,
    memory: float = 8e9,
    progress: bool = False,
) -> list[Trajectory | StageFailure]:
    """Simulate every scenario; on the CPU bit for bit what `simulate` gives for each alone, in the order given.

    The compiled kernels release Python's lock, so threads suffice: nothing is copied between processes.

    Args:
        scenarios: what to simulate.
        device: "cuda" steps thousands of scenarios at once on an NVIDIA GPU (docs/reports/elastic_rod_cuda.md); those
            in which a step does not converge there are done on the CPU.
        workers: threads; None means one per core.
        memory: on the GPU, the most that the scenarios of a batch may take [bytes].
        progress: show a progress bar.

    Returns:
        A trajectory each, or the failure of one that could not be solved: it takes no other with it.

    Raises:
        InputError: arguments out of range in any scenario, or no GPU.
    """
    if device not in ("cpu", "cuda"):
        raise bad_input("device", given=device, allowed="cpu or cuda", do="Check the spelling.")
    count = os.cpu_count() or 1 if workers is None else workers
    check_range("workers", count, 1, 4096)
    check_range("memory", memory, 1e6, 1e13, "bytes")
    results: list[Any] = [None] * len(scenarios)
    if device == "cuda":
        refuse_without_gpu()
        from anther.elastic_rod.gpu import simulate_on_device  # noqa: PLC0415 - needs numba-cuda

        results = simulate_on_device(scenarios, memory, progress)
    with ThreadPoolExecutor(count) as pool:
        left = [i for i, result in enumerate(results) if result is None]
        runs = [pool.submit(_simulated, scenarios[i]) for i in left]
        try:
            for i, run in zip(left, track(runs, "scenarios", disable=not progress), strict=True):
                results[i] = run.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return results


def refuse_without_gpu() -> None:
    """Raise unless numba can reach an NVIDIA GPU, or simulates one (NUMBA_ENABLE_CUDASIM=1).

    Raises:
        InputError: numba-cuda is not installed, or there is no GPU with a driver.
    """
    if getattr(config, "ENABLE_CUDASIM", False):
        return
    lacking = "without numba-cuda"
    if find_spec("numba_cuda") is not None:
        from numba import cuda  # noqa: PLC0415 - slow to import

        if cuda.is_available():
            return
        lacking = "without an NVIDIA GPU and its driver"
    raise bad_input(
        "device",
        given=f"'cuda' {lacking}",
        allowed="cpu, or cuda on a machine with an NVIDIA GPU",
        do="Install the driver and run: pip install 'anther[cuda]'",
    )


def _simulated(scenario: Scenario) -> Trajectory | StageFailure:
    try:
        return simulate(**{name: getattr(scenario, name) for name in Scenario.__dataclass_fields__})
    except StageFailure as failure:
        return failure
