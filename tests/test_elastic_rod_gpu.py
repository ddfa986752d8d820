"""The CUDA path of `simulate_many`: on a GPU where there is one, in numba's simulator of one, and as far as PTX."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numba
import numpy as np
import pytest
from made_rods import cantilever, random_tree
from test_elastic_rod_motion import three_d_network

from anther.elastic_rod import Clamp, Drive, SampledDrive, Scenario, Trajectory, simulate_many
from anther.errors import InputError, StageFailure

TARGET = find_spec("numba.cuda") is not None or find_spec("numba_cuda") is not None
needs_target = pytest.mark.skipif(not TARGET, reason="numba has no CUDA target here: pip install 'anther[cuda]'")
SERIES = ("times", "positions", "energy", "grip_force", "grip_moment", "work")
NUMBER = 3
"""Scenarios of `alike`."""


def gpu_here() -> bool:
    if find_spec("numba_cuda") is None:
        return False
    from numba import cuda  # noqa: PLC0415

    return cuda.is_available() and os.environ.get("NUMBA_ENABLE_CUDASIM") != "1"


def alike() -> list[Scenario]:
    """Scenarios that can go together: other materials, grips, amplitudes, frequencies, and another tree."""
    rods, other = (random_tree(seed, 7, viscous_time=1e-4) for seed in (3, 4))
    common = {"duration": 3e-3, "dt": 1e-3}
    return [
        Scenario(rods, Clamp.root(rods), Drive(5, (1, 0, 0), 1e-3, 20.0), **common),
        Scenario(replace(rods, bend_over_twist=12.0), Clamp.root(rods), Drive(4, (0, 1, 0), 2e-3, 9.0), **common),
        Scenario(other, Clamp.root(other), Drive(6, (0, 1, 1), 1e-3, 30.0), **common),
    ]


def mixed() -> list[Scenario]:
    """Scenarios that cannot go with `alike`: held between pads and turned, let go, and one step too long for Newton."""
    rods = random_tree(3, 7, viscous_time=1e-4)
    turned = SampledDrive(
        1, np.array([0.0, 1.0]), np.array([[0.0, 0, 0], [0.2, 0, 0]]), (4,), np.array([[0.0, 0, 0], [0, 3.0, 0]])
    )
    beam = cantilever(5)
    euler = {"integrator": "implicit_euler", "start": "scanned"}
    return [
        Scenario(rods, Clamp(np.array([0])), turned, 2e-3, 1e-3, record_every=2),
        Scenario(beam, Clamp.root(beam), None, 2e-3, 1e-3, **euler),
        Scenario(beam, Clamp.root(beam), Drive(3, (0, 0, 1), 0.1, 25.0), 5e-3, 5e-3, **euler),
    ]


def differences(cpu: list[Trajectory | StageFailure], gpu: list[Trajectory | StageFailure]) -> list[dict[str, float]]:
    return [
        {name: float(np.abs(getattr(a, name) - getattr(b, name)).max()) for name in SERIES}
        | {"iterations": b.newton_iterations - a.newton_iterations, "splits": b.split_steps - a.split_steps}
        for a, b in zip(cpu, gpu, strict=True)
        if isinstance(a, Trajectory) and isinstance(b, Trajectory)
    ]


def check(rows: list[dict[str, float]], expected: int) -> None:
    assert len(rows) == expected
    for row in rows:
        assert row["times"] == row["splits"] == 0
        assert row["positions"] < 1e-9  # [m]
        assert row["energy"] < 1e-9  # [J]
        assert row["work"] < 1e-9  # [J]
        assert row["grip_force"] < 1e-8  # [N], the tolerance of Newton's residual
        assert row["grip_moment"] < 1e-9  # [N m]


@pytest.mark.skipif(gpu_here(), reason="there is a GPU here")
def test_without_a_gpu_the_error_says_what_to_install() -> None:
    with pytest.raises(InputError, match=r"device: got 'cuda' without .* pip install 'anther\[cuda\]'"):
        simulate_many(alike(), device="cuda")


def test_other_devices_are_refused() -> None:
    with pytest.raises(InputError, match="device: got gpu; allowed: cpu or cuda"):
        simulate_many(alike(), device="gpu")  # type: ignore[arg-type]


@pytest.mark.skipif(not gpu_here(), reason="needs an NVIDIA GPU and anther[cuda]")
def test_gpu_agrees_with_the_cpu() -> None:
    scenarios = (alike() + mixed()) * 20
    check(differences(simulate_many(scenarios), simulate_many(scenarios, device="cuda")), len(scenarios))


def in_simulator() -> None:
    """Run in a process with NUMBA_ENABLE_CUDASIM=1: print what differs, and the sizes of the launches."""
    from anther.elastic_rod import gpu  # noqa: PLC0415

    launches, kernel = [], gpu.step_kernel

    class Counted:
        def __getitem__(self, shape):
            def launch(*arguments):
                launches.append([arguments[7], arguments[8], arguments[-1].shape[1]])
                kernel[shape](*arguments)

            return launch

    gpu.step_kernel, gpu.LAUNCH, gpu.BLOCK = Counted(), 2, 2
    scenarios = alike() + mixed()
    alone, many = simulate_many(scenarios), simulate_many(scenarios, device="cuda")
    assert isinstance(alone[-1], Trajectory)
    memory = 2.5 * gpu.device_bytes(gpu._prepared(scenarios[0]))
    whole, launches[:] = list(launches), []
    gpu.simulate_on_device(alike()[:1] * 3, memory, False)
    told = {"rows": differences(alone, many), "split": alone[-1].split_steps, "whole": whole, "small": launches}
    print(json.dumps(told))


@needs_target
def test_simulated_gpu_agrees_with_the_cpu() -> None:
    environment = os.environ | {"NUMBA_ENABLE_CUDASIM": "1"}
    command = [sys.executable, "-c", "from test_elastic_rod_gpu import in_simulator; in_simulator()"]
    run = subprocess.run(
        command, cwd=Path(__file__).parent, env=environment, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    said = json.loads(run.stdout)
    check(said["rows"], 6)
    assert said["split"] > 0, "the last scenario must be one that the device hands back to the CPU"
    assert all(row["iterations"] == 0 for row in said["rows"])
    assert [0, 2, NUMBER] in said["whole"], "scenarios that are alike go together"
    assert [2, 3, NUMBER] in said["whole"], "a later launch goes on where the one before ended"
    assert [count for first, _, count in said["small"] if first == 0] == [2, 1], "batches fit the memory"


class Counted:
    """An array that counts the bytes read from it and written to it."""

    def __init__(self, array: np.ndarray, count: dict[str, int]) -> None:
        self.array, self.count = array, count
        self.size = min(array.itemsize, 4) if array.dtype.kind in "ib" else array.itemsize

    def __len__(self) -> int:
        return len(self.array)

    def __getitem__(self, index):
        self.count["read"] += self.size
        return self.array[index]

    def __setitem__(self, index, value) -> None:
        self.count["written"] += self.size
        self.array[index] = value


@needs_target
def test_bytes_moved_are_those_that_the_page_states(monkeypatch: pytest.MonkeyPatch) -> None:
    from anther.elastic_rod import gpu, stepping  # noqa: PLC0415

    monkeypatch.setattr(gpu, "device_function", lambda function: function)
    gpu._device_copy.cache_clear()
    rods, count = random_tree(3, 30, viscous_time=1e-4), {"read": 0, "written": 0}
    scenario = Scenario(rods, Clamp.root(rods), Drive(5, (1, 0, 0), 1e-3, 20.0), 2e-3, 1e-3, start="scanned")
    run = gpu._prepared(scenario)
    assert run is not None

    def counted(value):
        return type(value)(*map(counted, value)) if isinstance(value, tuple) else Counted(value, count)

    blocks = run.work.blocks
    work = counted(run.work)._replace(blocks=counted(blocks)._replace(lanes=blocks.lanes))
    out, grip = gpu.new_output(2, 30), run.grip(run.step_times())
    state = [counted(value) for value in (run.model, run.free, grip, run.state)]
    got, iterations, _ = gpu._device_copy(stepping.advance)(*state, work, run.settings, out, 0, 2, 1)
    gpu._device_copy.cache_clear()
    assert got == 2
    page = (Path(__file__).parents[1] / "docs" / "reports" / "elastic_rod_cuda.md").read_text()
    for way in ("read", "written"):
        stated = float(re.search(rf"([\d.]+) kB {way}", page)[1])  # type: ignore[index]
        assert count[way] / 1000 / (30 * iterations) == pytest.approx(stated, abs=0.06)


@pytest.mark.slow
@needs_target
def test_device_functions_compiled_for_the_cpu_agree_on_a_network_of_86_nodes(monkeypatch: pytest.MonkeyPatch) -> None:
    """One spring at a time and sums in the order written, as on a GPU, against the kernels of the CPU."""
    from anther.elastic_rod import gpu, simulation, stepping  # noqa: PLC0415

    monkeypatch.setattr(gpu, "device_function", numba.njit(error_model="numpy"))
    gpu._device_copy.cache_clear()
    network = replace(three_d_network(), viscous_time=1e-4)
    scenario = Scenario(network, Clamp(np.array([0, 1])), Drive(20, (1, 0, 0), 2e-3, 30.0), 0.5, 1e-3, start="scanned")
    alone = simulate_many([scenario])
    monkeypatch.setattr(simulation, "advance", gpu._device_copy(stepping.advance))
    gpu._device_copy.cache_clear()
    check(differences(alone, simulate_many([scenario])), 1)


@pytest.mark.slow
@pytest.mark.skipif(find_spec("numba_cuda") is None, reason="needs numba-cuda and its compiler: anther[cuda]")
@pytest.mark.parametrize("architecture", [(8, 0), (9, 0)])
def test_kernel_compiles_without_a_gpu(monkeypatch: pytest.MonkeyPatch, architecture: tuple[int, int]) -> None:
    from numba import cuda, typeof  # noqa: PLC0415

    from anther.elastic_rod import gpu  # noqa: PLC0415

    kernel, arguments = gpu.step_kernel, []

    class Stopped(Exception):
        pass

    class Catcher:
        def __getitem__(self, shape):
            def catch(*given):
                arguments.extend(given)
                raise Stopped

            return catch

    fake = SimpleNamespace(to_device=lambda array: array, device_array=np.empty)
    monkeypatch.setattr(gpu, "cuda", fake)
    monkeypatch.setattr(gpu, "step_kernel", Catcher())
    with pytest.raises(Stopped):
        gpu.simulate_on_device(alike(), 1e9, False)
    monkeypatch.undo()
    device = SimpleNamespace(compute_capability=architecture)
    monkeypatch.setattr("numba.cuda.dispatcher.get_current_device", lambda: device)
    text, _ = cuda.compile_ptx(kernel.py_func, tuple(map(typeof, arguments)), cc=architecture)
    assert f".target sm_{architecture[0]}{architecture[1]}" in text
    assert "div.rn.f64" in text, "double precision, rounded as on the CPU"
    assert "div.approx" not in text
    assert parameter_bytes(text) <= 4096, "what drivers before CUDA 12.1 can pass to a kernel"


def parameter_bytes(text: str) -> int:
    """Return the size of the parameters of the kernel in a PTX text."""
    head = text[text.index(".visible .entry") :]
    sizes = {"8": 1, "16": 2, "32": 4, "64": 8}
    return sum(sizes[bits] for bits in re.findall(r"\.param \.[bfsu](\d+) ", head[: head.index(")\n")]))
