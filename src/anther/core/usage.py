"""What this process has used: seconds since it began, processor time, the most memory since a mark."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from pathlib import Path

_IMPORTED = time.time()
_PEAK = Path("/proc/self/clear_refs"), Path("/proc/self/status")


def process_seconds() -> float:
    """Return the seconds since this process began [s], what it imported first included; without /proc, since now."""
    with suppress(OSError, ValueError, IndexError):
        since_boot = float(Path("/proc/uptime").read_text().split()[0])
        ticks = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19])
        return since_boot - ticks / os.sysconf("SC_CLK_TCK")
    return time.time() - _IMPORTED


def cpu_seconds() -> float:
    """Return the processor time of this process and of those of its children that have ended [s]."""
    return sum(os.times()[:4])


def mark_memory() -> None:
    """Let `peak_memory` count from now on, where Linux allows it."""
    with suppress(OSError):
        _PEAK[0].write_text("5")


def peak_memory() -> float | None:
    """Return the most memory this process held since the last mark, or ever [MB]; None where nothing tells."""
    with suppress(OSError, StopIteration):
        lines = _PEAK[1].read_text().splitlines()
        return int(next(line.split()[1] for line in lines if line.startswith("VmHWM"))) / 1024
    return None
