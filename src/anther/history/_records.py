"""What the history keeps beside visits: an outcome that the grower counted; and how stored values are read."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from datetime import UTC, date, datetime
from typing import Annotated, Any

from anther.core.checks import check_range
from anther.core.records import Range, Record
from anther.plant.model import Material
from anther.plant.visit import check_labels


@dataclass(frozen=True, slots=True)
class Outcome(Record):
    """Fruit set, counted later by the grower.

    Attributes:
        species, plant: as in the trials.
        flowers: flowers that were open when the plant was visited, and could have set.
        fruit: how many of them did.
        date: of the count.
        visit: the one visit it belongs to; None: all visits of the plant since its previous count.
        note: anything.
        recorded: when it was entered; of two counts of the same plant, visit and day, the later entered holds.
        id: given by the history.
    """

    species: str
    plant: str
    flowers: Annotated[int, Range(1, 100_000)]
    fruit: int
    date: date
    visit: int | None = None
    note: str = ""
    recorded: datetime = field(default_factory=lambda: datetime.now(UTC))
    id: int | None = None

    def _check(self) -> None:
        check_labels(self.species, self.plant)
        check_range("fruit", self.fruit, 0, self.flowers)


def material_of(values: dict[str, Any] | None) -> Material | None:
    """Return a stored material; what this version does not know of is left out."""
    known = {f.name for f in fields(Material)}
    return None if values is None else Material(**{name: v for name, v in values.items() if name in known})


def numbers(values: Any) -> tuple[float, ...]:
    """Return stored numbers; NaN where there is none."""
    return tuple(float("nan") if v is None else float(v) for v in values)
