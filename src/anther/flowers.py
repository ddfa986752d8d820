"""Flowers: where they are and which skeleton node carries each. F flowers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from anther.checks import check_array
from anther.geometry import Array


@dataclass(frozen=True, slots=True, eq=False)
class Flowers:
    """The detected flowers; there may be none (F = 0).

    Attributes:
        positions: (F, 3) flower centres, world frame [m].
        attachment: (F,) skeleton node each flower's pedicel hangs on.
        notes: what the stage wants the user to know.
    """

    positions: Array
    attachment: NDArray[Any]
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.positions)
        object.__setattr__(self, "positions", check_array("flower positions", self.positions, (n, 3)))
        object.__setattr__(self, "attachment", check_array("flower attachment", self.attachment, (n,), dtype="int64"))
