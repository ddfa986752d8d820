"""Rows of the validation table."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

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
        """Whether it is about the order of a scheme (`order_row`)."""
        return "order" in self.case.split("_")

    def printed(self, value: float | None) -> str:
        """Return the error or the limit as the table prints it."""
        if value is None or math.isnan(value):
            return "–"
        return f"{100 * value:.2g} %" if self.unit == "%" else f"{value:.2g} {self.unit}".strip()


def order_row(case: str, what: str, steps: Array, errors: Array, order: int = 2) -> Row:
    """Return the row that holds a scheme to its order within 0.1.

    Args:
        case: of the row.
        what: shrinks with the step.
        steps: (K,) node distance over length [-], or time step [s].
        errors: (K,) relative [-] or absolute [m].
        order: what theory promises for the slope of log error over log step (least squares).
    """
    slope = float(np.polyfit(np.log(steps), np.log(errors), 1)[0])
    listed = ", ".join(f"{error:.2g}" for error in errors)
    return Row(case, what, abs(slope - order), 0.1, "", f"slope {slope:.3f}; errors {listed}")


Case = Callable[[bool], list[Row]]
"""Whether it is to be quick -> the rows of a group."""


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
