"""Masks: which pixels show the plant and its flowers. Dimensions: V views, H x W pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from anther.checks import check_array

BACKGROUND, PLANT, FLOWER = 0, 1, 2


@dataclass(frozen=True, slots=True, eq=False)
class Masks:
    """A label per pixel: BACKGROUND (pot, soil, bench and all else), PLANT or FLOWER.

    Attributes:
        labels: (V, H, W) uint8.
        source: what made them, for the report ("colour and geometry", "geometry", ...).
    """

    labels: NDArray[Any]
    source: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "labels", check_array("labels", self.labels, (None, None, None), dtype="uint8"))
