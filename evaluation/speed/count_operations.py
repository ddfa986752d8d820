"""Count the floating-point operations of one Newton iteration, kernel by kernel.

    python -m evaluation.speed.count_operations

The kernels run uncompiled on numbers that count, on the 86-node network with twist. Every operation as written counts
as one (a multiply-add is two; square root, sine, arctangent are one), also those of the lanes that only fill up a group
of eight springs, and those that a compiler may find to be the same. `rods.py` states the sum as its floor.
"""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Callable
from typing import Any

os.environ["NUMBA_DISABLE_JIT"] = "1"

import numpy as np

from anther.rods import GRAVITY, Clamp, _assembly, _model, _stepping, _tree_solver, _vectors
from evaluation.harness import finish, options
from evaluation.speed.networks import reference_network
from evaluation.tables import markdown

COUNT: Counter[str] = Counter()


class Number:
    """A float that counts what is done with it."""

    __slots__ = ("value",)

    def __init__(self, value: Any) -> None:
        self.value = float(value)

    def __float__(self) -> float:
        return self.value

    def __neg__(self) -> Number:
        return Number(-self.value)

    def __abs__(self) -> Number:
        return Number(abs(self.value))

    def __lt__(self, other: Any) -> bool:
        return self.value < float(other)

    def __gt__(self, other: Any) -> bool:
        return self.value > float(other)

    @property
    def real(self) -> Number:
        """Itself."""
        return self


class CountingMath:
    """Stands in for the module math."""

    pi, inf = math.pi, math.inf

    def __getattr__(self, name: str) -> Callable[..., Any]:
        def counted(*values: Any) -> Any:
            COUNT[name] += 1
            result = getattr(math, name)(*(float(value) for value in values))
            return Number(result) if isinstance(result, float) else result

        return counted


def _counting(name: str) -> Callable[[Number, Any], Number]:
    def operate(self: Number, other: Any) -> Number:
        COUNT[name.removeprefix("r")] += 1
        return Number(getattr(self.value, f"__{name}__")(float(other)))

    return operate


for operation in ("add", "sub", "mul", "truediv", "radd", "rsub", "rmul", "rtruediv"):
    setattr(Number, f"__{operation}__", _counting(operation))


def numbers(thing: Any) -> Any:
    """Return the same nest of named tuples and arrays with every float replaced by a counting number."""
    if hasattr(thing, "_fields"):
        return type(thing)(*(numbers(part) for part in thing))
    return np.vectorize(Number, otypes=[object])(thing) if thing.dtype.kind == "f" else thing


def count() -> dict[str, float]:
    """Return operations per node of each kernel."""
    _vectors.math = _stepping.math = CountingMath()  # type: ignore[assignment]
    rods = reference_network()
    constants, frames = _model.build_model(rods, GRAVITY)
    free = Clamp(np.array([0, 1])).free(rods, [20])
    shape = _stepping.new_state(rods.nodes, frames)
    n, rng = len(rods.nodes), np.random.default_rng(0)
    shape.x[2:] += 1e-5 * rng.standard_normal((n - 2, 3))
    constants, old, new = numbers(constants), numbers(_stepping.new_state(rods.nodes, frames)), numbers(shape)
    blocks, turn, move = numbers(_assembly.new_blocks(n)), numbers(np.zeros(n)), numbers(np.zeros((n, 4)))
    rate, tree = Number(1000), (constants.order, constants.near, constants.far)
    steps: dict[str, Callable[[], Any]] = {
        "evaluate": lambda: _stepping._evaluate(constants, old, new, new.x, turn, rate, blocks),
        "residual": lambda: _stepping._residual(free, blocks.gradient, constants.length),
        "constrain": lambda: _tree_solver.constrain(*tree[1:], free, blocks),
        "factor": lambda: _tree_solver.factor(*tree, blocks),
        "solve": lambda: _tree_solver.solve(*tree, blocks, blocks.gradient),
        "limit": lambda: _stepping._largest_turn(constants.parent, new.x, move),
        "move": lambda: _stepping._move(new.x, turn, move, Number(1)),
    }
    result: dict[str, float] = {}
    for name, step in steps.items():
        COUNT.clear()
        step()
        result[name] = sum(COUNT.values()) / n
    return result | {"total": sum(result.values())}


def main() -> None:
    """Count and print."""
    args = options(__doc__, quick="for uniformity; it takes two seconds")
    counts = {f"operations_per_node_{name}": value for name, value in count().items()}
    lines = [(name, f"{value:.0f}") for name, value in counts.items()]
    finish(args, counts, markdown(("kernel", "operations"), lines))


if __name__ == "__main__":
    main()
