"""Records of the map of a house: what is built, what a pass has seen, and which stem is where."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from anther.core import Array
from anther.core.errors import bad_input
from anther.core.records import Range, Record, Shape, Stored

SURE = 0.95
"""A stem is recognised, or new, with this probability; else it is unsure. To confuse two costs 19 times what doubt does
(a judgement)."""
Metres = Annotated[float, Range(-1e5, 1e5, "m")]


@dataclass(frozen=True, slots=True)
class Side(Record):
    """One side of a row, as it was built.

    Attributes:
        posts: tag of the fiducial on a post -> its position along the rail [m]; {} where there are none, and the
            cart's odometry alone is used.
        hooks: positions of hooks that hang there already [m], increasing; () where a pass is to find them.
    """

    CALLED = "side."
    posts: dict[str, float]
    hooks: tuple[float, ...] = ()

    def _check(self) -> None:
        check_increasing("hooks", self.hooks, "List them as they hang, from the row's begin.")
        if not np.isfinite([*self.posts.values(), *self.hooks]).all():
            raise bad_input("row", given="a position that is no number", allowed="metres", do="Correct it.")


@dataclass(frozen=True, slots=True)
class Row(Record):
    """A row: what one rail gives access to, on its left and right as a cart drives in; None where nothing grows."""

    name: str
    left: Side | None
    right: Side | None


@dataclass(frozen=True, slots=True)
class House(Stored):
    """A house as it was built, a JSON file: its rows, each with both sides.

    Attributes:
        name: of the house.
        species: of all its plants.
        rows: in the order in which they lie.
    """

    KIND, SCHEMA = "house", 1
    name: str
    species: str
    rows: tuple[Row, ...]

    def _check(self) -> None:
        names = [row.name for row in self.rows]
        if double := sorted({name for name in names if names.count(name) > 1}):
            raise bad_input(
                "house", given=f"two rows '{double[0]}'", allowed="one row a name", do="Rename one of them."
            )
        if not all(names) or not self.name:
            raise bad_input(
                "house", given="an empty name", allowed="a name for the house and each row", do="Name them."
            )


@dataclass(frozen=True, slots=True, eq=False)
class RowPass(Stored):
    """What was seen on one way along one side of a row. M hooks, K numbers of an appearance.

    Attributes:
        house, row, side: where.
        time: when it ended.
        position: (M,) of each hook by the cart's odometry, increasing [m].
        posts: (tag, position by the odometry [m]) of each fiducial that was seen, in their order.
        begin, end: the section that was looked at, by the odometry [m].
        appearance: (M, K) numbers that describe a stem, e.g. thickness, truss spacing, colour; NaN where not measured.
        appearance_std: (M, K) their errors.
        open_flowers, fruit: (M,) counts; NaN where not counted.
        position_std: error of one hook beside its neighbours [m].
        drift: of the odometry: standard deviation after a metre, grows with the root of the way [m].
    """

    KIND, SCHEMA = "row_pass", 1
    house: str
    row: str
    side: Literal["left", "right"]
    time: datetime
    position: Annotated[Array, Shape("M"), Range(-1e5, 1e5, "m")]
    posts: tuple[tuple[str, float], ...]
    begin: Metres
    end: Metres
    appearance: Annotated[Array, Shape("M", "K", missing=True)]
    appearance_std: Annotated[Array, Shape("M", "K", missing=True), Range(0)]
    open_flowers: Annotated[Array, Shape("M", missing=True), Range(0, 1e4)]
    fruit: Annotated[Array, Shape("M", missing=True), Range(0, 1e4)]
    position_std: Annotated[float, Range(1e-4, 1, "m")] = 0.01
    drift: Annotated[float, Range(1e-5, 1, "m")] = 0.01

    def _check(self) -> None:
        check_increasing("hooks of a pass", self.position, "Sort them along the rail, or drive the section again.")
        check_increasing("posts of a pass", [at for _, at in self.posts], "Sort them along the rail.")
        if not len(self.position) or not self.begin <= self.position[0] <= self.position[-1] <= self.end:
            given = f"{len(self.position)} hooks in {self.begin:g} to {self.end:g} m"
            raise bad_input(
                "pass", given=given, allowed="a hook or more, all in the section", do="Check begin and end."
            )
        if self.time.tzinfo is None:
            raise bad_input("time of a pass", given="a time without zone", allowed="a time with zone", do="Use UTC.")
        if not (self.appearance_std > 0)[np.isfinite(self.appearance)].all():
            raise bad_input("appearance_std", given="0 or none", allowed="the error of each number", do="State it.")


def check_increasing(what: str, values: Any, do: str) -> None:
    for k, (a, b) in enumerate(zip(values, values[1:], strict=False)):
        if not b > a:
            raise bad_input(
                what, given=f"number {k + 2} at {b:g} m after {a:g} m", allowed="increasing positions", do=do
            )


@dataclass(frozen=True, slots=True)
class Stem:
    """A stem of the map.

    Attributes:
        number: in the history.
        plant, species: its label, which visits and counts have too.
        house, row, side: where.
        hook: its place in the order along the wire, from 0.
        position, position_std: of the hook along the rail, at the last pass [m].
        certainty: probability that it is the same stem as before the last pass.
        gone: probability that it has been taken out.
        open_flowers, fruit: at the last pass; None where not counted.
        last_dose: when a visit last moved its flowers, None if never.
        last_seen: by a pass.
    """

    number: int
    plant: str
    species: str
    house: str
    row: str
    side: str
    hook: int
    position: float
    position_std: float
    certainty: float
    gone: float
    open_flowers: int | None
    fruit: int | None
    last_dose: datetime | None
    last_seen: datetime


class Recognition(NamedTuple):
    """What a pass has told. M hooks.

    Attributes:
        plants: (M,) label of each hook's stem; a new one where no stem of the map is more probable than not.
        probability: (M,) that it is this stem, or that it is new.
        new: (M,) whether it was added to the map.
        missing: labels of stems that should have been seen and were not.
        removed: labels of those that are no longer in the map.
    """

    plants: tuple[str, ...]
    probability: tuple[float, ...]
    new: tuple[bool, ...]
    missing: tuple[str, ...] = ()
    removed: tuple[str, ...] = ()

    @property
    def unsure(self) -> tuple[int, ...]:
        """Hooks of the pass of whose stem one is not sure."""
        return tuple(k for k, p in enumerate(self.probability) if p < SURE)
