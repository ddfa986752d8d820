"""Stem: the main stem within the skeleton, and which organ each skeleton node belongs to. S stem samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.checks import check_array
from anther.errors import bad_input
from anther.geometry import Array

STEM, BRANCH = 0, 1


@dataclass(frozen=True, slots=True, eq=False)
class Stem:
    """The main stem as an ordered path of skeleton nodes, root first.

    Attributes:
        node_ids: (S,) skeleton nodes from the root to the stem's top.
        arc_length: (S,) distance from the root along the stem [m].
        attachments: (A,) positions within node_ids where a branch or petiole leaves the stem.
        organ: (J,) uint8 per skeleton node: STEM or BRANCH.
        notes: what the stage wants the user to know.
    """

    node_ids: NDArray[Any]
    arc_length: Array
    attachments: NDArray[Any]
    organ: NDArray[Any]
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.node_ids)
        object.__setattr__(self, "node_ids", check_array("stem nodes", self.node_ids, (n,), dtype="int64"))
        object.__setattr__(self, "arc_length", check_array("stem arc length", self.arc_length, (n,)))
        object.__setattr__(self, "attachments", check_array("attachments", self.attachments, (None,), dtype="int64"))
        object.__setattr__(self, "organ", check_array("organ", self.organ, (None,), dtype="uint8"))
        if n < 2 or np.any(np.diff(self.arc_length) <= 0):
            raise bad_input("stem", given=f"{n} nodes", allowed="two or more, root first", do="Order the nodes.")
