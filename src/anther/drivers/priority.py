"""Threads that must not wait: what streams to an arm, and what hears it."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

PRIORITY = 20
"""Of Linux' real-time classes, 1 to 99: before all ordinary work, behind the kernel's own."""


@contextmanager
def served_first() -> Iterator[None]:
    """Serve this thread before the machine's other work within the block, where the system allows it.

    Linux asks for a limit `rtprio` (docs/real_robot.md) or root. Threads that are begun within are ordinary ones.
    """
    scheduler = getattr(os, "sched_setscheduler", None)
    if scheduler is None:
        yield
        return
    with suppress(OSError):
        scheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITY))
    try:
        yield
    finally:
        with suppress(OSError):
            scheduler(0, os.SCHED_OTHER, os.sched_param(0))


@contextmanager
def quick_turns() -> Iterator[None]:
    """Let Python's threads take turns every millisecond: commands do not wait for what thinks beside them."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-3)
    try:
        yield
    finally:
        sys.setswitchinterval(before)
