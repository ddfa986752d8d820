"""What stands in a greenhouse row besides its plants: gutters, slabs, hooks on wires, rails, pipes and posts.

Each part is a rod or a box, of which both the picture and the collisions are made. Row frame [m]: x from the middle of
the path towards the row, y along it, z up from the floor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike

from anther.core.geometry import Array, Box
from anther.core.opencv import cv2
from anther.sim.greenhouse import RGB, Painted
from anther.sim.mesh import box, grid_faces, tube
from anther.sim.plant import Organ
from anther.sim.truth import uniform

STEEL = (150, 154, 156)
SLAB = (0.20, 1.0, 0.075)
"""Of a slab of substrate: width, length, height [m], as rock wool is sold; remembered."""
CUBE = (0.10, 0.065)
"""Of the cube that a plant was raised in: side and height [m]; remembered."""


@dataclass(frozen=True, slots=True)
class Measures:
    """The measures of a row [m].

    Attributes:
        wire: height of the wire that hooks hang on.
        gutter: height of the gutter's upper side.
        corridor: width of the path that leaves leave free.
        foliage: from the leaves' edge to the stems.
        pitch: of stems along one side of the path.
        lines: from the near line of stems to the far one of the same row.
        path: from the middle of a path to that of the next.
        gauge: of the two rails, middle to middle.
        rail: height of the rails' middle.
        drift: along the row, from a stem's foot to its hook.
        posts: from post to post.
    """

    wire: float
    gutter: float
    corridor: float
    foliage: float
    pitch: float
    lines: float
    path: float
    gauge: float
    rail: float
    drift: float
    posts: float

    @property
    def near(self) -> float:
        """x of the near line of stems."""
        return self.corridor / 2 + self.foliage


RANGES = {
    # >= 3 m (facts: rows D, NCSU), 3.5-4.5 m remembered
    "wire": uniform(3.0, 4.5),
    # facts: rows D, remembered
    "gutter": uniform(0.4, 0.8),
    "corridor": uniform(0.5, 0.8),
    # a guess: leaves of 0.4 m droop, and those that reach further are broken by carts
    "foliage": uniform(0.15, 0.25),
    # 2.5-3.6 stems/m2 (facts: rows D, remembered) on paths 1.6 m apart are 2.0-2.9 on a metre of each side
    "pitch": uniform(0.34, 0.50),
    # a guess: strings of one row go to two wires
    "lines": uniform(0.40, 0.60),
    # facts: rows D, remembered 1.6
    "path": uniform(1.5, 1.8),
    # facts: rows D, remembered
    "gauge": uniform(0.42, 0.60),
    # a guess
    "rail": uniform(0.06, 0.14),
    # a week's or two weeks' lowering (facts: rows D, 0.2-0.25 m a week); either way, a guess
    "drift": uniform(-0.3, 0.3),
    # bays of greenhouses, a guess
    "posts": uniform(4.0, 5.0),
}
"""What `Measures` are drawn from."""


def draw_measures(rng: np.random.Generator) -> Measures:
    """Return the measures of a row."""
    return Measures(**{part.name: RANGES[part.name].draw(rng) for part in fields(Measures)})


@dataclass(frozen=True, slots=True, eq=False)
class Rod:
    """A round rod.

    Attributes:
        name: what it is.
        start, end: (3,) of its axis [m].
        radius: [m].
        colour: sRGB.
    """

    name: str
    start: Array
    end: Array
    radius: float
    colour: RGB = STEEL

    @property
    def box(self) -> Box:
        """The box around it [m]."""
        ends = np.stack([self.start, self.end])
        return Box(ends.min(axis=0) - self.radius, ends.max(axis=0) + self.radius)

    def moved(self, way: ArrayLike) -> Rod:
        """Return the rod elsewhere, `way` (3,) from here [m]."""
        return replace(self, start=self.start + np.asarray(way), end=self.end + np.asarray(way))

    def painted(self) -> Painted:
        """Return its mesh."""
        line = np.linspace(self.start, self.end, max(int(np.linalg.norm(self.end - self.start) / 0.25), 1) + 1)
        sides = 6 if self.radius < 0.004 else 16
        return tube(line, np.full(len(line), self.radius), sides=sides), Organ.BENCH, np.array(self.colour)


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """A box along the axes.

    Attributes:
        name: what it is.
        box: where [m].
        colour: sRGB.
    """

    name: str
    box: Box
    colour: RGB = (232, 234, 232)

    def moved(self, way: ArrayLike) -> Block:
        """Return the box elsewhere, `way` (3,) from here [m]."""
        way = np.asarray(way)
        return replace(self, box=Box(self.box.lower + way, self.box.upper + way))

    def painted(self) -> Painted:
        """Return its mesh."""
        return box(self.box.lower, self.box.upper), Organ.BENCH, np.array(self.colour)


TAG = 0.12
"""Edge of a tag's black square [m]: of 10 to 16 cm that one prints, a guess."""
TAGS = 587
"""How many there are of the family 36h11."""


@dataclass(frozen=True, slots=True, eq=False)
class Tag(Block):
    """A thin plate with an AprilTag (36h11) that faces the path.

    Attributes:
        number: which of the family.
    """

    number: int = 0

    def painted(self) -> Painted:
        """Return its mesh: the tag's 8 x 8 cells and a white margin, a square each, on the plate's front."""
        family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        cells = cv2.aruco.generateImageMarker(family, self.number, 8)
        grey = np.pad(np.where(cells > 0, 235, 25), 1, constant_values=235)  # printed on matt paper: a guess
        (x, y, _), (_, left, top) = self.box.lower, self.box.upper
        step = (left - y) / len(grey)
        row, column = np.meshgrid(np.arange(10), np.arange(10), indexing="ij")
        corners = [(0, 0), (0, 1), (1, 0), (1, 1)]  # down, to the right of who faces it: against y
        front = [
            np.stack([x - 1e-4 + 0.0 * row, left - step * (column + r), top - step * (row + d)], -1) for d, r in corners
        ]
        vertices = np.stack(front, axis=2).reshape(-1, 3)
        faces = (4 * np.arange(100)[:, None, None] + grid_faces(2, 2, closed=False)).reshape(-1, 3)
        back, sides = box(self.box.lower, self.box.upper)
        mesh = np.vstack([vertices, back]), np.vstack([faces, sides + len(vertices)]).astype(np.int32)
        colour = np.concatenate([np.repeat(grey.ravel(), 4), np.full(len(back), 235)])
        return mesh, Organ.BENCH, np.repeat(colour[:, None], 3, axis=1)


Part = Rod | Block


def installation(
    m: Measures, hooks: Array, feet: Array, rng: np.random.Generator, *, heads: float, first_tag: int
) -> list[Part]:
    """Return what stands in the row and in its path.

    Args:
        m: of the row.
        hooks: (P, 3) on the wires [m].
        feet: (P, 3) where stems leave their holders [m].
        rng: where slabs and posts begin.
        heads: height of the plants [m]; tags hang above it.
        first_tag: number of the first post's tag; others follow.
    """
    low, high = float(min(hooks[:, 1].min(), feet[:, 1].min())) - 0.8, float(max(hooks[:, 1].max(), feet[:, 1].max()))
    high += 0.8

    def along(name: str, x: float, z: float, radius: float, colour: RGB = STEEL) -> Rod:
        return Rod(name, np.array([x, low, z]), np.array([x, high, z]), radius, colour)

    grey = (214, 216, 214)
    pipe_radius = 0.0255  # m (facts: rows D, 51 mm, remembered)
    rails = [along("rail", sign * m.gauge / 2, m.rail, pipe_radius, grey) for sign in (-1, 1)]
    middle = m.near + m.lines / 2
    wires = [along("wire", x, m.wire + 0.012, 0.0015) for x in (m.near, m.near + m.lines)]
    pipe = along("pipe", middle, m.gutter + rng.uniform(0.5, 1.2), pipe_radius, grey)
    first = low + rng.uniform(0, m.posts)
    posts: list[Part] = []
    for k, y in enumerate(np.arange(first, high, m.posts)):
        post = Box(np.array([middle - 0.03, y, 0.0]), np.array([middle + 0.03, y + 0.06, m.wire + 0.3]))
        posts += [Block("post", post, STEEL), _tag(post, heads, (first_tag + k) % TAGS)]
    return [*rails, *wires, pipe, *posts, *_gutters(m, low, high, rng), *_cubes(m, feet), *_hooks(hooks)]


def _tag(post: Box, heads: float, number: int) -> Tag:
    """Return the tag on a post's side towards the path: above the heads, as far as the post is tall enough."""
    half = TAG * 10 / 8 / 2  # with its margin
    front = np.array(
        [post.lower[0], (post.lower[1] + post.upper[1]) / 2, min(heads + 0.1, post.upper[2] - 2 * half) + half]
    )
    across = np.array([0.0, half, half])
    return Tag("tag", Box(front - across - [0.003, 0, 0], front + across), number=number)


def _gutters(m: Measures, low: float, high: float, rng: np.random.Generator) -> list[Part]:
    """Return the gutter of the row, which hangs on wires, and its slabs."""
    x, (wide, long, tall) = m.near + m.lines / 2, SLAB
    gutter = Block("gutter", Box(np.array([x - 0.13, low, m.gutter - 0.06]), np.array([x + 0.13, high, m.gutter])))
    slabs: list[Part] = []
    for y in np.arange(low + rng.uniform(0, 0.4), high - long, long + 0.05):
        corner = np.array([x - wide / 2, y, m.gutter])
        slabs.append(Block("slab", Box(corner, corner + np.array([wide, long, tall]))))
    hangers: list[Part] = [
        Rod("hanger", np.array([x + side, y, m.gutter]), np.array([x + side, y, m.wire + 0.3]), 0.002)
        for y in np.arange(low + 0.5, high, 2.4)
        for side in (-0.13, 0.13)
    ]
    return [gutter, *slabs, *hangers]


def _cubes(m: Measures, feet: Array) -> list[Part]:
    """Return the cubes of the plants, on the slabs."""
    x, (side, tall), top = m.near + m.lines / 2, CUBE, m.gutter + SLAB[2]
    found: list[Part] = []
    for i, foot in enumerate(feet):
        corner = np.array([x - side / 2 + (-1) ** i * 0.03, foot[1] - side / 2, top])
        found.append(Block("cube", Box(corner, corner + np.array([side, side, tall])), (206, 200, 184)))
    return found


def _hooks(hooks: Array) -> list[Part]:
    """Return the hooks, each with the spool of string that is unwound from week to week."""
    found: list[Part] = []
    _, y, z = np.eye(3)
    yellow = (226, 206, 70)
    for hook in hooks:
        found.append(Rod("hook", hook + 0.02 * z, hook - 0.03 * z, 0.002, STEEL))
        found.append(Rod("spool", hook + 0.012 * y, hook + 0.11 * y, 0.016, yellow))
    return found


def painted(parts: Sequence[Part]) -> list[Painted]:
    """Return the meshes of parts."""
    return [part.painted() for part in parts]
