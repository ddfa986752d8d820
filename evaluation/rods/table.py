"""Rows of the validation table, and what the figures show."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        case: key of the row: `<case>_error` and `<case>_limit` in the --json file.
        what: what is compared with what, in words.
        error: the measured error, in `unit`.
        limit: what the error must not exceed; None where the row only informs.
        unit: "%" (error and limit are fractions, printed in percent), "deg", "m" or "".
        detail: the measured numbers behind the error.
    """

    case: str
    what: str
    error: float
    limit: float | None
    unit: str = "%"
    detail: str = ""

    @property
    def failed(self) -> bool:
        """Whether the error exceeds the limit or is not a number."""
        return self.limit is not None and not self.error <= self.limit

    @property
    def is_order(self) -> bool:
        """Whether it is about the order of a scheme (`Convergence.row`)."""
        return "order" in self.case.split("_")

    def printed(self, value: float | None) -> str:
        """Return the error or the limit as the table prints it."""
        if value is None or math.isnan(value):
            return "–"
        return f"{100 * value:.2g} %" if self.unit == "%" else f"{value:.2g} {self.unit}".strip()


@dataclass(frozen=True)
class Convergence:
    """Errors against step sizes.

    Attributes:
        name: for the legend.
        steps: (K,) node distance over length [-], or time step [s].
        errors: (K,) relative [-] or absolute [m].
        order: the order that theory promises.
    """

    name: str
    steps: Array
    errors: Array
    order: int

    @property
    def slope(self) -> float:
        """Slope of log error over log step (least squares)."""
        return float(np.polyfit(np.log(self.steps), np.log(self.errors), 1)[0])

    def row(self, case: str, what: str) -> Row:
        """Return the row that holds the slope to its order within 0.1."""
        pairs = ", ".join(f"{error:.2g}" for error in self.errors)
        return Row(case, what, abs(self.slope - self.order), 0.1, "", f"slope {self.slope:.3f}; errors {pairs}")


@dataclass(frozen=True)
class Findings:
    """What a group of cases found: rows of the table, and curves for the figures."""

    rows: Sequence[Row]
    in_space: Sequence[Convergence] = ()
    in_time: Sequence[Convergence] = ()
    energy: dict[str, tuple[Array, Array]] = field(default_factory=dict)


Case = Callable[[bool], Findings]


def metrics(rows: Sequence[Row]) -> dict[str, float]:
    """Return the flat numbers of the results contract."""
    out: dict[str, float] = {}
    for row in rows:
        out[f"{row.case}_error"] = row.error
        if row.limit is not None:
            out[f"{row.case}_limit"] = row.limit
    out["rows"] = sum(row.limit is not None for row in rows)
    out["rows_failed"] = sum(row.failed for row in rows)
    return out
