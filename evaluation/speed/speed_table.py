"""The table of a benchmark: best, median, worst, limit, floor."""

from __future__ import annotations

import os
from dataclasses import dataclass, field

import numpy as np

from evaluation.speed.roofline import Roofline

COLUMNS = ("case", "unit", "best", "median", "worst", "limit", "floor", "best over floor")


@dataclass(frozen=True)
class Row:
    """One line of the table: samples in `unit`, floor and limit, if there are any; `more` goes to --json.

    Without samples the line only says what the case says: that something failed, for instance.
    """

    key: str
    case: str
    unit: str
    samples: tuple[float, ...]
    floor: float | None = None
    limit: float | None = None
    more: dict[str, float] = field(default_factory=dict)

    @property
    def metrics(self) -> dict[str, float]:
        """The row in the flat form of the --json file."""
        if not self.samples:
            return self.more
        out = {self.key: min(self.samples)} | self.more
        if len(self.samples) > 1:
            out |= {f"{self.key}_median": float(np.median(self.samples)), f"{self.key}_max": max(self.samples)}
        return out if self.floor is None else out | {f"{self.key}_floor": self.floor}

    @property
    def cells(self) -> tuple[str, ...]:
        """The row as text, one for each of COLUMNS. A single sample leaves median and worst empty."""
        if not self.samples:
            return (self.case, *("",) * (len(COLUMNS) - 1))
        best, spread = min(self.samples), ("", "")
        if len(self.samples) > 1:
            spread = (f"{np.median(self.samples):.3g}", f"{max(self.samples):.3g}")
        limit = "" if self.limit is None else f"{self.limit:g}"
        floor = ("", "") if self.floor is None else (f"{self.floor:.2g}", f"{best / self.floor:.1f}")
        return (self.case, self.unit, f"{best:.3g}", *spread, limit, *floor)


def describe(ceilings: Roofline) -> str:
    """Return what one core could do in this run, in words."""
    return (
        f"One core in this run: {ceilings.vector / 1e9:.0f} Gflop/s with SIMD (this gives the floor), "
        f"{ceilings.scalar / 1e9:.0f} one number at a time; {ceilings.small / 1e9:.0f} GB/s in the second-level cache, "
        f"{ceilings.large / 1e9:.0f} with 24 MB. Load of the machine at the end: {os.getloadavg()[0]:.1f} on "
        f"{os.cpu_count()} cores."
    )


def missed(rows: list[Row]) -> str:
    """Return which limits the best samples miss, in words."""
    over = [row for row in rows if row.samples and row.limit is not None and min(row.samples) > row.limit]
    words = "; ".join(f"{row.case} ({min(row.samples):.3g} against {row.limit:g} {row.unit})" for row in over)
    return f"Limits missed: {words or 'none'}."
