"""Numba, which says so where it compiles: the first use of a kernel on a machine takes seconds, and is kept.

Kernels take `njit` or `numba` from here, so that programs that use Anther hear of it as well as the command line.
"""

from __future__ import annotations

import gc
import sys
import time
from typing import Any

import numba
import numpy as np
from numba import njit
from numba.core import event
from numpy.typing import ArrayLike, NDArray

__all__ = ["COMPILED", "OPTIONS", "compiled", "inlined", "njit", "numba", "read_only"]


class _Compiled(event.Listener):
    """What this process has compiled; numba compiles in one thread at a time.

    Attributes:
        kernels: how many signatures, numba's own included.
        seconds: processor time.
        patience: of compiling, before it is told [s]; a kernel or two are not worth a line.
    """

    patience = 2.0

    def __init__(self) -> None:
        self.kernels, self.seconds, self._depth, self._begin, self._told, self._collects = 0, 0.0, 0, 0.0, False, False

    def on_start(self, event: Any) -> None:
        """Count, and tell where it takes long. Garbage waits: to look for it is a sixth of the time."""
        if self._depth == 0:
            self._begin, self._collects = time.thread_time(), gc.isenabled()
            gc.disable()
        self._depth, self.kernels = self._depth + 1, self.kernels + 1
        spent = self.seconds + time.thread_time() - self._begin
        if spent < self.patience:
            return
        if sys.stderr.isatty():
            line = f"\rcompiling for this machine, once: {self.kernels} kernels, {spent:.0f} s "
            print(line, end="", file=sys.stderr, flush=True)
        elif not self._told:
            print("compiling for this machine, once (ahead: anther doctor --compile) ...", file=sys.stderr)
        self._told = True

    def on_end(self, event: Any) -> None:
        """Wipe the line off the terminal when the kernel, with all it calls, is done."""
        self._depth -= 1
        if self._depth == 0:
            self.seconds += time.thread_time() - self._begin
            if self._collects:
                gc.enable()
            if self._told and sys.stderr.isatty():
                print("\r\033[K", end="", file=sys.stderr)


COMPILED = _Compiled()
event.register("numba:compile", COMPILED)

OPTIONS: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "_nrt": False,
    "no_cfunc_wrapper": True,
}
"""How kernels are compiled that allocate nothing: kept on disk, a division by 0 gives infinity or NaN as in NumPy.

To be ready to allocate, to raise, or to be a callback of C takes a third of the time of compiling. So Python makes the
arrays that kernels fill. `np.zeros`, `np.round` or `int` in a kernel are kernels more to compile.
"""

compiled: Any = njit(**OPTIONS)
"""For a kernel that is called from Python; the types of its arguments must not vary, each combination is compiled."""

inlined: Any = njit(inline="always")
"""For a part of a kernel: it is only ever compiled within it, with the kernel's own options."""


def read_only(array: ArrayLike) -> NDArray[Any]:
    """Return numbers as kernels take what they only read: in C order, not writable.

    To numba another order, or the right to write, is another type, for which it compiles the kernel once more.
    """
    view = np.ascontiguousarray(array).view()
    view.flags.writeable = False
    return view
