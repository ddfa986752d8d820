"""A greenhouse row: plants on strings side by side, their leaves among each other, and what stands between them.

`grow_row` draws one; `Row.at` puts it before an arm; `row_scene` is what cameras see of it. One plant is worked at and
moves, the rest stands still: it is seen, and can be touched. Which plant is asked for, its stem and its hook are ground
truth: they are for the judge.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from anther.core.checks import check_range
from anther.core.choices import Crop
from anther.core.geometry import Array
from anther.sim.greenhouse import Painted, Setting, joined, leaves_at, shell
from anther.sim.plant import Organ, SimPlant
from anther.sim.render import Scene
from anther.sim.row_house import CUBE, SLAB, TAGS, Measures, Part, Rod, Tag, draw_measures, installation, painted
from anther.sim.row_plants import STRINGS, Place, high_wire_tomato, string_pepper

FEWEST, MOST = 3, 12
"""Plants in a row that is grown."""


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """A row as it truly is. P plants.

    Attributes:
        crop, seed: it grew from.
        measures: of the row.
        plants: P, those of the near line first, each line in order along y.
        near: how many of them are of the near line, on this side of the row.
        asked: the plant that is worked at, of the near line.
        parts: what else stands there.
        origin: (3,) the row frame's in the world [m]: on the floor, in the middle of the path.
    """

    crop: Crop
    seed: int
    measures: Measures
    plants: tuple[SimPlant, ...]
    near: int
    asked: int
    parts: tuple[Part, ...]
    origin: Array

    @property
    def hooks(self) -> Array:
        """(P, 3) where the strings hang [m]; of a plant on two strings that of its main stem."""
        return np.array([plant.twines[0].hook for plant in self.plants])

    @property
    def worked(self) -> SimPlant:
        """The plant that is asked for."""
        return self.plants[self.asked]

    @property
    def neighbours(self) -> tuple[SimPlant, ...]:
        """All other plants."""
        return self.plants[: self.asked] + self.plants[self.asked + 1 :]

    @property
    def flowers(self) -> Array:
        """(3,) the middle of the open flowers of the stem that is asked for [m]."""
        return np.median(self.worked.flower_position[self.worked.on_first_string()], axis=0)

    @property
    def tags(self) -> tuple[Tag, ...]:
        """Those of its posts, in order along y."""
        return tuple(part for part in self.parts if isinstance(part, Tag))

    def asking(self, plant: int, string: int = 0) -> Row:
        """Return the row with another stem asked for: that of a string of a plant of the near line."""
        turned = self.plants[plant].turned_to(string)
        return replace(self, plants=(*self.plants[:plant], turned, *self.plants[plant + 1 :]), asked=plant)

    def at(self, way: ArrayLike) -> Row:
        """Return the row elsewhere, `way` (3,) from here [m]: where an arm has its base at -`way` in it."""
        way = np.asarray(way, dtype=np.float64)
        plants = tuple(plant.moved(way) for plant in self.plants)
        parts = tuple(part.moved(way) for part in self.parts)
        return replace(self, plants=plants, parts=parts, origin=self.origin + way)

    def obstacles(self) -> list[Part]:
        """Return what an arm can strike: parts, neighbours' stems, trusses and stalks, and the strings above them.

        Leaves are none: they give way; nor is the string of the stem that is asked for, which goes where that goes.
        """
        found: list[Part] = list(self.parts)
        for plant in self.neighbours:
            solid = np.flatnonzero(~np.isin(plant.organ, (Organ.LEAF, Organ.RACHIS, Organ.PETIOLE)))
            radius = (plant.radius_start + plant.radius_end) / 2
            found += [Rod("neighbour", plant.start[k], plant.end[k], float(radius[k])) for k in solid]
            found += [Rod("string", plant.end[t.segment], t.hook, 0.001) for t in plant.twines]
        return found


def grow_row(
    crop: Crop, seed: int, count: int | None = None, grown: Callable[[int, Place], SimPlant] | None = None
) -> Row:
    """Grow a row of plants on both lines of its strings. The row frame is the world's; see `Row.at`.

    Args:
        crop: of the row.
        seed: of everything that is drawn.
        count: of plants; 3 to 12 by the seed if not told.
        grown: what grows a plant from a seed and its place, if not the crop's own function of `row_plants`.
    """
    rng = np.random.default_rng([seed, 13])
    drawn = int(rng.integers(FEWEST, MOST + 1))
    count = int(check_range("plants of a row", drawn if count is None else count, FEWEST, MOST))
    measures = draw_measures(rng)
    near = -(-count * 3 // 5)
    grown = grown or {"tomato": high_wire_tomato, "pepper": string_pepper}[crop]
    places = [*_line(measures, crop, near, 0, rng), *_line(measures, crop, count - near, 1, rng)]
    plants = tuple(grown(100 * seed + i, place) for i, place in enumerate(places))
    hooks = np.array([twine.hook for plant in plants for twine in plant.twines])
    feet = np.array([plant.pot.centre for plant in plants])
    heads = max(float(plant.end[:, 2].max()) for plant in plants)
    parts = tuple(installation(measures, hooks, feet, rng, heads=heads, first_tag=7 * seed % TAGS))
    return Row(crop, seed, measures, plants, near, near // 2, parts, np.zeros(3))


def _line(m: Measures, crop: Crop, count: int, line: int, rng: np.random.Generator) -> list[Place]:
    """Return the places of the plants of a line of strings, 0 on the side of the path, in order along y."""
    pitch = m.pitch * STRINGS[crop]
    y = pitch * (np.arange(count) - (count - 1) / 2 + 0.5 * line)
    uneven = 0.03  # m, standard deviation of plants' places along the row: a guess
    y = y + np.clip(rng.normal(0, uneven, count), -pitch / 4, pitch / 4)
    inward = 1.0 - 2.0 * line
    x, on = m.near + line * m.lines, m.near + m.lines / 2 - 0.03 * inward
    foot_z = m.gutter + SLAB[2] + CUBE[1]
    rise, drift = (0.0, 0.0) if crop == "pepper" else (rng.uniform(0.05, 0.2), m.drift)
    # stems of high-wire tomatoes rise from holders below their strings; those of peppers grow out of their cubes
    foot_x = on if crop == "pepper" else x + 0.06 * inward
    feet = [np.array([foot_x, place - drift + rng.normal(0, uneven), foot_z + rise]) for place in y]
    return [
        Place(foot, np.array([x, place, m.wire]), -inward * np.eye(3)[0]) for foot, place in zip(feet, y, strict=True)
    ]


def row_scene(row: Row, worked: SimPlant | None = None, setting: Setting | None = None) -> Scene:
    """Return what cameras see of a row; the worked plant's vertices come first, for `Scene.moved`.

    Behind the row hang the leaves of the next.

    Args:
        row: where it stands.
        worked: the plant that is asked for, where it is not as it grew.
        setting: light.
    """
    rng = np.random.default_rng([row.seed, 14])
    first = worked or row.worked
    parts = [_painted(plant) for plant in row.neighbours]
    parts = [part for plant in parts for part in plant] + painted(row.parts)
    leaves, green = leaves_at(_backdrop(row, rng), rng)
    parts.append((leaves, Organ.SURROUNDINGS, green))
    parts += shell(row.origin, rng, height=row.measures.wire + 1.5)
    vertices, faces, organ, colour = joined(parts)
    return Scene(
        np.vstack([first.vertices, vertices]),
        np.vstack([first.faces, faces + len(first.vertices)]),
        np.concatenate([first.face_organ, organ]),
        np.vstack([first.vertex_color, colour]),
        setting=setting,
        moving=len(first.vertices),
    )


def _backdrop(row: Row, rng: np.random.Generator) -> Array:
    """Return (n, 3) where leaves of the next row are: 1.3 m down from its heads, 0.8 m deep [m]; guesses."""
    m = row.measures
    span = float(np.ptp(row.hooks[:, 1])) / 2 + 1.5
    x = m.near + m.path + rng.uniform(-0.2, 0.6, 4000)
    heads = float(np.mean([plant.end[:, 2].max() for plant in row.plants])) - row.origin[2]
    z = heads - 1.3 * rng.beta(1.5, 1.2, 4000)
    y = row.hooks[:, 1].mean() - row.origin[1] + rng.uniform(-span, span, 4000)
    return row.origin + np.stack([x, y, z], axis=1)


def _painted(plant: SimPlant) -> list[Painted]:
    """Return a plant's mesh, organ by organ."""
    found: list[Painted] = []
    for organ in np.unique(plant.face_organ):
        used, faces = np.unique(plant.faces[plant.face_organ == organ], return_inverse=True)
        mesh = plant.vertices[used], faces.reshape(-1, 3).astype(np.int32)
        found.append((mesh, Organ(organ), plant.vertex_color[used]))
    return found
