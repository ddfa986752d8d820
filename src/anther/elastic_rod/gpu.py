"""Many scenarios at once on an NVIDIA graphics processor: one scenario a thread, in double precision.

The kernels are those of the CPU, compiled once more for the device. The scenario is the last axis of every array there,
so that neighbouring threads read neighbouring numbers. Only `simulate_many` imports this module: it needs numba-cuda.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from functools import cache
from importlib import import_module
from types import FunctionType, ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import numba
import numpy as np
from numba.core.registry import CPUDispatcher
from rich.progress import Progress

from anther.elastic_rod import stepping
from anther.elastic_rod.assembly import Blocks
from anther.elastic_rod.lanes import ROWS
from anther.elastic_rod.model import Frames, Model
from anther.elastic_rod.newton import State, Work
from anther.elastic_rod.simulation import Run, Trajectory, new_output, prepare
from anther.elastic_rod.stepping import Grip, Output
from anther.errors import StageFailure

if TYPE_CHECKING:
    from anther.elastic_rod.scenarios import Scenario

cuda: Any = import_module("numba.cuda")
device_function: Any = cuda.jit(device=True)
device_kernel: Any = cuda.jit(cache=True)

BLOCK = 32
"""Threads of a block: one warp, so that few scenarios spread over all multiprocessors."""

LAUNCH = 100
"""Steps of one launch of the kernel: a display that shares the device gets its turn between launches."""


class Scratch(NamedTuple):
    """Arrays of `newton.Work` with the scenario as last axis."""

    diagonal: Any
    near: Any
    far: Any
    gradient: Any
    turn: Any
    correction: Any
    energy: Any


@cache
def _device_copy(kernel: CPUDispatcher) -> Any:
    """Return a kernel of the CPU, and all that it calls, as functions of the device.

    Numba would do this by itself, but with a compiler flag under which NaN and infinity lose their meaning, and with
    eight springs side by side, for which a thread has no registers. Here the flag is off and LANES is 1.
    """
    code, names = kernel.py_func.__code__, kernel.py_func.__globals__
    scope = {name: _for_device(names[name], name, code.co_names) for name in code.co_names if name in names}
    return device_function(FunctionType(code, scope, kernel.py_func.__name__))


def _for_device(value: Any, name: str, used: Sequence[str]) -> Any:
    if name == "LANES":
        return 1
    if isinstance(value, CPUDispatcher):
        return _device_copy(value)
    if isinstance(value, ModuleType) and value.__name__.startswith("anther."):
        module = ModuleType(value.__name__)
        vars(module).update({name: _for_device(vars(value)[name], name, used) for name in used if name in vars(value)})
        return module
    return value


_advance: Any = _device_copy(stepping.advance)


@device_function
def _model_of(m: Any, k: Any) -> Any:
    return Model(
        m.parent[:, k],
        m.order[:, k],
        m.near[:, k],
        m.far[:, k],
        m.swapped[:, k],
        m.mass[:, k],
        m.spin_inertia[:, k],
        m.rotary[:, k],
        m.drag[:, k],
        m.weight[:, :, k],
        m.stretch[:, k],
        m.joint[:, :, k],
        m.viscous[:, k],
        m.length[:, k],
        m.curvature[:, :, k],
        m.natural_twist[:, k],
        m.soil[:, :, k],
    )


@device_function
def _state_of(s: Any, i: Any, k: Any) -> Any:
    return State(s.x[:, :, i, k], s.v[:, :, i, k], Frames(s.frames.m1[:, :, i, k], s.frames.twist[:, i, k]))


@device_function
def _clear(blocks: Any) -> None:
    for j in range(len(blocks.gradient)):
        for i in range(4):
            for c in range(4):
                blocks.near[j, i, c] = 0.0
                blocks.far[j, i, c] = 0.0


@device_kernel
def step_kernel(
    m: Any, free: Any, g: Any, s: Any, w: Any, settings: Any, o: Any, first: Any, last: Any, every: Any, done: Any
) -> None:
    """Take the steps first .. last - 1 of every scenario that has come as far as `first`.

    Args:
        m, free, g, settings, o: as of `stepping.advance`, with the scenario as last axis of every array.
        s: three states likewise, on the axis before the last: the present one, and two to work with.
        w: arrays to work with.
        first, last, every: as of `stepping.advance`.
        done: (2, K) the step each scenario got to, Newton iterations so far.
    """
    k = cuda.grid(1)
    if k >= done.shape[1] or done[0, k] != first:
        return
    lanes = cuda.local.array(ROWS, numba.float64)
    blocks = Blocks(w.diagonal[:, :, :, k], w.near[:, :, :, k], w.far[:, :, :, k], w.gradient[:, :, k], lanes)
    if first == 0:
        _clear(blocks)
    state, mid, end = _state_of(s, 0, k), _state_of(s, 1, k), _state_of(s, 2, k)
    work = Work(mid, end, w.turn[:, k], w.correction[:, :, k], blocks, w.energy[:, k])
    grip = Grip(g.nodes[:, k], g.edges[:, k], g.x[:, :, :, k], g.director[:, :, :, k], g.guess[:, k])
    x, director = o.x[:, :, :, k], o.director[:, :, :, k]
    out = Output(x, director, o.energy[:, k], o.force[:, :, k], o.moment[:, :, k], o.work[:, k])
    got, used, _ = _advance(_model_of(m, k), free[:, :, k], grip, state, work, settings, out, first, last, every)
    done[0, k] = got
    done[1, k] += used


def simulate_on_device(scenarios: Sequence[Scenario], memory: float, progress: bool) -> list[Trajectory | None]:
    """Simulate scenarios on the device, in batches of those alike in nodes, steps, gripped nodes and settings.

    Args:
        scenarios: K of any kind.
        memory: the most a batch may take on the device [bytes]; one scenario alone may take more.
        progress: show a progress bar.

    Returns:
        K trajectories; None where there is no equilibrium, a step did not converge or energy grew: the CPU must try.

    Raises:
        InputError: arguments out of range in any scenario.
    """
    results: list[Trajectory | None] = [None] * len(scenarios)
    waiting: dict[Any, list[tuple[int, Run]]] = {}
    with Progress(disable=not progress) as bar:
        task = bar.add_task("scenarios on the GPU", total=len(scenarios))

        def finish(batch: list[tuple[int, Run]]) -> None:
            for (i, _), result in zip(batch, _stepped([run for _, run in batch]), strict=True):
                results[i] = result
            bar.advance(task, len(batch))
            batch.clear()

        for i, scenario in enumerate(scenarios):
            run = _prepared(scenario)
            if run is not None:
                batch = waiting.setdefault(_kind(run), [])
                batch.append((i, run))
                if (len(batch) + 1) * device_bytes(run) > memory:
                    finish(batch)
        for batch in filter(None, waiting.values()):
            finish(batch)
    return results


def _prepared(scenario: Scenario) -> Run | None:
    try:
        return prepare(**{field.name: getattr(scenario, field.name) for field in fields(scenario)})
    except StageFailure:
        return None


def _kind(run: Run) -> Any:
    """Return what runs of one batch have in common."""
    return run.settings, run.steps, run.every, len(run.state.x), len(run.nodes), len(run.edges)


def device_bytes(run: Run) -> int:
    """Return what one scenario takes on the device [bytes]: constants, state, the path of the grip, records."""
    n, rows = len(run.state.x), run.steps // run.every
    path = 3 * (run.steps + 1) * (len(run.nodes) + len(run.edges))
    return _nbytes((run.model, run.free, run.state, run.work)) + 8 * (path + rows * (6 * n + 8))


def _nbytes(value: Any) -> int:
    return sum(map(_nbytes, value)) if isinstance(value, tuple) else value.nbytes


def _stepped(runs: Sequence[Run]) -> list[Trajectory | None]:
    """Take all steps of one batch."""
    first, count = runs[0], len(runs)
    times = first.step_times()
    arguments = zip(*((r.model, r.free, r.grip(times), _thrice(r.state), r.work.energy) for r in runs), strict=True)
    model, free, grip, states, energy = (_stacked(parts) for parts in arguments)
    blocks, work = first.work.blocks, first.work
    empty = (blocks.diagonal, blocks.near, blocks.far, blocks.gradient, work.turn, work.correction)
    scratch = Scratch(*[_empty(array, count) for array in empty], energy=energy)
    out: Any = Output(*(_empty(array, count) for array in new_output(first.steps // first.every, len(first.state.x))))
    done = cuda.to_device(np.zeros((2, count), np.int64))
    for begin in range(0, first.steps, LAUNCH):
        end = min(begin + LAUNCH, first.steps)
        step_kernel[-(-count // BLOCK), BLOCK](
            model, free, grip, states, scratch, first.settings, out, begin, end, first.every, done
        )
        cuda.synchronize()
    rows = [array.copy_to_host() for array in out]
    got, spent = done.copy_to_host()
    return [
        _recorded(run, Output(*(array[..., k] for array in rows)), int(spent[k])) if got[k] == run.steps else None
        for k, run in enumerate(runs)
    ]


def _recorded(run: Run, out: Output, iterations: int) -> Trajectory | None:
    run.iterations = iterations
    try:
        return run.recorded(out)
    except StageFailure:
        return None


def _thrice(value: Any) -> Any:
    """Return a nest of arrays with a last axis over three copies."""
    return type(value)(*map(_thrice, value)) if isinstance(value, tuple) else np.stack([value] * 3, axis=-1)


def _stacked(parts: Sequence[Any]) -> Any:
    """Return equal nests of arrays as one nest on the device, with a last axis over them; integers in 4 bytes."""
    if isinstance(parts[0], tuple):
        return type(parts[0])(*map(_stacked, zip(*parts, strict=True)))
    array = np.ascontiguousarray(np.stack(parts, axis=-1))
    return cuda.to_device(array.astype(np.int32) if array.dtype == np.int64 else array)


def _empty(like: Any, count: int) -> Any:
    """Return an array on the device like the one given, with a last axis of length `count`."""
    return cuda.device_array((*like.shape, count), like.dtype)
