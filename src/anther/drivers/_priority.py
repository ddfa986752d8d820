"""Threads that must not wait: what streams to an arm, and what hears it."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

PRIORITY = 20
"""Of Linux' real-time classes, 1 to 99: before all ordinary work, behind the kernel's own."""
BESIDE = PRIORITY - 1
"""Of all that shares Python's lock with such a thread: what has the lock and is not served keeps it waiting."""


@contextmanager
def served_first(priority: int = PRIORITY, *, threads_too: bool = False) -> Iterator[None]:
    """Serve this thread before the machine's other work within the block, where the system allows it.

    Linux asks for a limit `rtprio` (docs/real_robot.md) or root.

    Args:
        priority: see `PRIORITY`.
        threads_too: threads that are begun within are served so as well; else they are ordinary ones.
    """
    if not hasattr(os, "sched_setscheduler"):
        yield
        return
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    with suppress(OSError):
        kind = os.SCHED_RR if threads_too else os.SCHED_RR | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, kind, os.sched_param(priority))
    try:
        yield
    finally:
        with suppress(OSError):
            os.sched_setscheduler(0, *before)


@contextmanager
def quick_turns() -> Iterator[None]:
    """Let Python's threads take turns every millisecond: commands do not wait for what thinks beside them."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-3)
    try:
        yield
    finally:
        sys.setswitchinterval(before)
