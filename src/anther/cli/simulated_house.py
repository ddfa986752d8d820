"""A simulated house: rows that are grown, a map's house and passes of them, and a robot's visits to their stems.

Each side of a path is the near line of a row of `anther.sim`. A pass is drawn, not photographed: hooks and what
stems look like, with the errors that it states.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from typing import Literal, cast

import numpy as np

from anther.core.checks import check_range
from anther.core.choices import SIDES, Crop
from anther.core.errors import bad_input
from anther.history import House, RowPass, Side
from anther.history import Row as MapRow
from anther.robot.cells.rows import RowOfFile
from anther.robot.cells.rows import Side as FileSide
from anther.sim import Row, SimPlant, grow_row
from anther.sim.row import FEWEST, MOST
from anther.sim.row_cell import HOOK_ERROR
from anther.sim.row_drive import BEYOND
from anther.sim.row_plants import STRINGS

LARGEST = -(-MOST * 3 // 5)
"""Plants that a side of a path can have: the near line of the largest row that is grown."""


@dataclass(frozen=True, slots=True)
class SimulatedSide:
    """One side of a path.

    Attributes:
        hooks: along the rails, in order [m].
        row: as it grew.
        stems: of each hook, the plant of the row's near line and which of that plant's strings hangs there.
    """

    hooks: tuple[float, ...]
    row: Row
    stems: tuple[tuple[int, int], ...]

    def asking(self, hook: int) -> Row:
        """Return the row with the stem of a hook asked for."""
        return self.row.asking(*self.stems[hook])

    @property
    def post(self) -> tuple[str, float]:
        """Tag of the fiducial on its post, and where along the rails it stands [m]."""
        return f"{self.row.crop} {self.row.seed}", self.hooks[0] - BEYOND


@dataclass(frozen=True, slots=True)
class SimulatedHouse:
    """A house as it truly is: (row, side) -> what grows there, None where nothing does."""

    name: str
    crop: Crop
    seed: int
    sides: dict[tuple[str, str], SimulatedSide | None]

    def built(self) -> House:
        """Return the house as its map takes it in: passes find the hooks."""
        rows = dict.fromkeys(row for row, _ in self.sides)
        sides = {key: None if side is None else Side(dict([side.post])) for key, side in self.sides.items()}
        return House(self.name, self.crop, tuple(MapRow(row, *(sides[row, s] for s in SIDES)) for row in rows))

    def passes(self, time: datetime) -> Iterator[RowPass]:
        """Yield what a camera sees on the way along each side, at one time."""
        error = 0.05  # of a number of a stem's looks, as a share of it (a guess)
        for k, ((row, name), side) in enumerate(self.sides.items()):
            if side is None:
                continue
            where = cast("Literal['left', 'right']", name)
            rng = np.random.default_rng([self.seed, 16, k, int(time.timestamp())])
            plants = [side.row.plants[plant].turned_to(string) for plant, string in side.stems]
            looks = np.array([_looks(plant) for plant in plants])
            at = np.sort(np.array(side.hooks) + rng.normal(0, HOOK_ERROR, len(plants)))
            at = at + 1e-6 * np.arange(len(at))
            yield RowPass(
                self.name, row, where, time, at, (side.post,), min(side.post[1], at[0]), at[-1] + BEYOND,
                looks * (1 + error * rng.normal(size=looks.shape)), error * looks,
                open_flowers=np.array([float(plant.on_first_string().sum()) for plant in plants]),
                fruit=np.full(len(plants), np.nan), position_std=HOOK_ERROR,
            )  # fmt: skip


def _looks(plant: SimPlant) -> tuple[float, float]:
    """Return what tells a stem from others: its mean radius and how high its flowers hang [m]."""
    stem = plant.stem_segments()
    flowers = plant.flower_position[plant.on_first_string()]
    return float(plant.radius_start[stem].mean()), float(np.median(flowers[:, 2]))


def drawn_rows(crop: Crop, plants: int, rows: int) -> list[RowOfFile]:
    """Return rows called "1", "2", ... whose plants hang on both sides of their paths; no hook has its place yet."""
    plants = int(check_range("plants", plants, 2, 2 * LARGEST))
    left, right = (
        FileSide([float(k) for k in range(STRINGS[crop] * count)]) for count in (plants - plants // 2, plants // 2)
    )
    return [RowOfFile(str(k + 1), left, right) for k in range(int(check_range("rows", rows, 1, 1000)))]


def grow_house(name: str, crop: Crop, seed: int, rows: list[RowOfFile], *, placed: bool) -> SimulatedHouse:
    """Grow a house.

    Args:
        name, crop, seed: of the house.
        rows: its rows.
        placed: whether their hooks have their places along the rails; else these are as they grew.

    Raises:
        InputError: a side has more hooks than `LARGEST` plants.
    """
    sides: dict[tuple[str, str], SimulatedSide | None] = {}
    for k, (row, side) in enumerate((row, side) for row in rows for side in SIDES):
        hooks = getattr(row, side).hooks
        most = STRINGS[crop] * LARGEST
        if len(hooks) > most:
            given, do = f"{len(hooks)} hooks", "Cut the row: its plants are simulated with all of their leaves."
            raise bad_input(f"row '{row.name}', {side}", given=given, allowed=f"up to {most}", do=do)
        if not hooks:
            sides[row.name, side] = None
            continue
        plants = -(-len(hooks) // STRINGS[crop])
        grown = grow_row(crop, 1000 * seed + k, min(max(5 * plants // 3, FEWEST), MOST))
        hung = [(twine.hook[1], p, q) for p in range(plants) for q, twine in enumerate(grown.plants[p].twines)]
        along, stems = zip(*[(y, (p, q)) for y, p, q in sorted(hung)[: len(hooks)]], strict=True)
        at = hooks if placed else [float(y - along[0] + BEYOND) for y in along]
        sides[row.name, side] = SimulatedSide(tuple(at), grown, stems)
    return SimulatedHouse(name, crop, seed, sides)
