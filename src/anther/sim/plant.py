"""The simulated plant: one ground truth that both the renderer and the contact simulation are built from.

A plant is a tree of K tapered straight segments (its mechanics) and a triangle mesh whose vertices ride on them (its
looks). World frame [m], z up. The shape given is the rest shape: the plant as it hangs under its own weight.
Dimensions: K segments, Nv vertices, Nf faces, F flowers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anther.core.checks import check_array
from anther.core.errors import bad_input
from anther.core.geometry import Array, transform_each
from anther.plant.limits import GRAVITY as GRAVITY  # noqa: PLC0414 - its own modules take it from here

SOIL_Z = -0.30
"""Height of the soil surface in the cell [m]; the arm's base is at 0."""
POT_AXIS = (0.72, 0.0)
"""Where the pot stands by default: x, y in front of the arm's base [m]."""


OF_SEGMENTS = (
    "start", "end", "radius_start", "radius_end", "parent", "organ", "youngs", "density", "damping_ratio", "lump_mass",
    "lump_centre", "oval", "joint_compliance", "drag_area",
)  # fmt: skip
"""The arrays of a `SimPlant` that have one row a segment."""
OF_FLOWERS = ("flower_segment", "flower_position")
OF_THREE = ("start", "end", "lump_centre", "oval", "flower_position", "vertices", "faces", "vertex_color")
"""Those whose rows have three columns; the others have one."""
WHOLE = dict.fromkeys(("parent", "organ", "flower_segment"), "int64") | {
    "faces": "int32", "face_organ": "uint8", "vertex_color": "uint8", "vertex_segment": "int32",
}  # fmt: skip
"""Those of whole numbers; the others are float64."""


class Organ(IntEnum):
    """What a segment or a face belongs to. NOTHING is only found in images: a pixel that sees no surface."""

    STEM = 0
    BRANCH = 1
    PETIOLE = 2
    RACHIS = 3
    LEAF = 4
    PEDUNCLE = 5
    PEDICEL = 6
    FLOWER = 7
    POT = 8
    SOIL = 9
    BENCH = 10
    SURROUNDINGS = 11
    NOTHING = 255


@dataclass(frozen=True, slots=True, eq=False)
class Pot:
    """A pot that stands upright, or only where a stem leaves its holder.

    Attributes:
        centre: (3,) on the axis at the height of the soil surface [m].
        radius: outer, at its rim [m], which is level with the soil surface and `height` above the bench; 0: there is
            neither pot nor bench.
        height: of every pot [m].
    """

    height: ClassVar[float] = 0.18
    centre: Array
    radius: float

    @property
    def soil_z(self) -> float:
        """Height of the soil surface, where the plant's base is clamped [m]."""
        return float(self.centre[2])

    @property
    def bench_z(self) -> float:
        """Height of the bench the pot stands on [m]."""
        return self.soil_z - self.height


@dataclass(frozen=True, slots=True, eq=False)
class Twine:
    """A string that pulls a stem towards a hook: its second, elastic support.

    Attributes:
        hook: (3,) on the wire, world [m].
        segment: the stem's, whose end is the topmost place that the string holds.
        tension: while the plant is at rest [N].
        stiffness: of the string from there to the hook [N/m].
    """

    hook: Array
    segment: int
    tension: float
    stiffness: float


@dataclass(frozen=True, slots=True, eq=False)
class SimPlant:
    """A parametric plant with complete ground truth, placed in the world.

    Segments are in an order in which a parent comes before its children; a segment starts where its parent ends.

    Attributes:
        species: "tomato" or "pepper".
        seed: the seed it grew from.
        start, end: (K, 3) ends of each segment's axis, base first [m].
        radius_start, radius_end: (K,) radii there [m].
        parent: (K,) int, parent[k] < k, -1 at the base (the one segment that leaves the soil).
        organ: (K,) int, an `Organ` from STEM to PEDICEL.
        youngs: (K,) Young's modulus [Pa].
        density: (K,) of the segment's own tissue [kg/m3].
        damping_ratio: (K,) of each segment's tissue and leaves [-].
        lump_mass: (K,) mass the segment carries besides its own: leaf blades, flowers [kg].
        lump_centre: (K, 3) centre of that mass [m]; the segment's middle where it is zero.
        flower_segment: (F,) int, the pedicel segment that carries the flower.
        flower_position: (F, 3) centre of the flower [m].
        vertices: (Nv, 3) [m].
        faces: (Nf, 3) int32 vertex numbers.
        face_organ: (Nf,) uint8, an `Organ`.
        vertex_color: (Nv, 3) uint8 sRGB.
        vertex_segment: (Nv,) int32, the segment a vertex rides on; -1 = still (pot, soil).
        pot: where it stands.
        oval: (K, 3) along the wider axis of each segment's section, as long as ln of the bending stiffness in the plane
            of that axis over that across it; 0 where the section is round. Their geometric mean is that of a round one.
        joint_compliance: (K,) how much softer the joint at a segment's start is than its tissue [rad/(N m)].
        drag_area: (K,) drag coefficient times area of what a segment carries [m2].
        bend_over_twist: EI/GJ of what twists [-], 11.5-13.3 in dicot petioles (facts: pollination 2).
        foot: stiffness with which root, soil and pot hold the stem's direction [N m/rad].
        tie: segment whose end is tied to a stake, and the tie's stiffness sideways [N/m]; None: it stands by itself.
        twines: strings that it hangs on.
    """

    species: str
    seed: int
    start: Array
    end: Array
    radius_start: Array
    radius_end: Array
    parent: NDArray[Any]
    organ: NDArray[Any]
    youngs: Array
    density: Array
    damping_ratio: Array
    lump_mass: Array
    lump_centre: Array
    flower_segment: NDArray[Any]
    flower_position: Array
    vertices: Array
    faces: NDArray[Any]
    face_organ: NDArray[Any]
    vertex_color: NDArray[Any]
    vertex_segment: NDArray[Any]
    pot: Pot
    oval: Any = None
    joint_compliance: Any = None
    drag_area: Any = None
    bend_over_twist: float = 12.0
    foot: float = np.inf
    tie: tuple[int, float] | None = None
    twines: tuple[Twine, ...] = ()

    def __post_init__(self) -> None:
        rows = dict.fromkeys(OF_SEGMENTS, len(self.start)) | dict.fromkeys(OF_FLOWERS, len(self.flower_segment))
        rows |= {"vertices": len(self.vertices), "vertex_color": len(self.vertices)}
        rows |= {"vertex_segment": len(self.vertices), "faces": len(self.faces), "face_organ": len(self.faces)}
        for name, count in rows.items():
            shape = (count, 3) if name in OF_THREE else (count,)
            value = np.zeros(shape) if getattr(self, name) is None else getattr(self, name)
            value = check_array(f"plant {name}", value, shape, dtype=WHOLE.get(name, "float64"))
            object.__setattr__(self, name, value)
        k = np.arange(len(self.parent))
        if len(k) == 0 or self.parent[0] != -1 or np.any(self.parent[1:] < 0) or np.any(self.parent >= k):
            raise bad_input("plant parent", given="no tree", allowed="-1 first, then 0 <= parent[k] < k", do="Reorder.")
        if min(self.radius_start.min(), self.radius_end.min(), self.youngs.min(), self.density.min()) <= 0:
            raise bad_input("plant", given="a value <= 0", allowed="radii, youngs, density > 0", do="Check units.")

    @property
    def length(self) -> Array:
        """(K,) length of each segment [m]."""
        return np.linalg.norm(self.end - self.start, axis=1)

    @property
    def mass(self) -> Array:
        """(K,) mass of each segment's own tissue, a conical frustum [kg]."""
        a, b = self.radius_start, self.radius_end
        return self.density * np.pi * self.length * (a * a + a * b + b * b) / 3

    def moved(self, way: ArrayLike) -> SimPlant:
        """Return the plant and its pot elsewhere, `way` (3,) from here [m]."""
        names = ("start", "end", "lump_centre", "flower_position", "vertices")
        places: dict[str, Any] = {name: getattr(self, name) + np.asarray(way) for name in names}
        twines = tuple(replace(twine, hook=twine.hook + np.asarray(way)) for twine in self.twines)
        return replace(self, **places, pot=replace(self.pot, centre=self.pot.centre + np.asarray(way)), twines=twines)

    def carried(self, values: Array) -> Array:
        """Return values (K, ...) summed over each segment and all that grows on it."""
        out = np.array(values)
        for k in range(len(out) - 1, 0, -1):
            out[self.parent[k]] += out[k]
        return out

    def on_first_string(self) -> NDArray[np.bool_]:
        """Return (F,) whether a flower grows on the stem of the first string; all do where there is no second."""
        return self._string_of()[self.flower_segment] <= 0

    def turned_to(self, string: int) -> SimPlant:
        """Return the plant with the stem of another of its strings as its main stem, and that string as its first.

        What was its main stem is a branch then, above where the two part.
        """
        if string == 0:
            return self
        of, swap = self._string_of(), {Organ.STEM: Organ.BRANCH, Organ.BRANCH: Organ.STEM}
        organ, face_organ = self.organ.copy(), self.face_organ.copy()
        segment = self.vertex_segment[self.faces[:, 0]]
        face_of = np.where(segment >= 0, of[segment], -1)
        for k, old in ((0, Organ.STEM), (string, Organ.BRANCH)):
            organ[(of == k) & (self.organ == old)] = swap[old]
            face_organ[(face_of == k) & (self.face_organ == old)] = swap[old]
        others = tuple(twine for k, twine in enumerate(self.twines) if k != string)
        return replace(self, organ=organ, face_organ=face_organ, twines=(self.twines[string], *others))

    def _string_of(self) -> NDArray[np.int64]:
        """Return (K,) which string's stem a segment grows on; -1 where it is on all of them, or on none."""
        ways = [self._way_down(twine.segment) for twine in self.twines]
        of = np.full(len(self.parent), -1)
        for k, way in enumerate(ways):
            own = way - set().union(*ways[:k], *ways[k + 1 :])
            of[list(own)] = k
        return self._passed_on(of)

    def _passed_on(self, of: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return (K,) numbers where segments that have none, -1, take that of what they grow on."""
        for k, parent in enumerate(self.parent):
            if of[k] < 0 <= parent:
                of[k] = of[parent]
        return of

    def _way_down(self, segment: int) -> set[int]:
        """Return the segments from one down to the base."""
        way = set[int]()
        while segment >= 0:
            way.add(segment)
            segment = int(self.parent[segment])
        return way

    def leaf_bases(self) -> NDArray[np.int64]:
        """Return (L,) the segments at which leaves begin."""
        return np.flatnonzero((self.organ == Organ.PETIOLE) & (self.organ[self.parent] != Organ.PETIOLE))

    def leaf_of(self) -> NDArray[np.int64]:
        """Return (K,) the segment at which the leaf begins that each is part of; -1 of those that are of none."""
        bases, of = self.leaf_bases(), np.full(len(self.parent), -1)
        of[bases] = bases
        return self._passed_on(of)

    def mass_centres(self) -> Array:
        """Return (K, 3) where each segment has its mass: the centre of what it carries, else its own [m]."""
        return np.where(self.lump_mass[:, None] > 0, self.lump_centre, (self.start + self.end) / 2)

    def stem_segments(self) -> NDArray[np.int64]:
        """Return the segments of the main stem, from the soil to the head (pepper: to the first fork)."""
        return np.flatnonzero(self.organ == Organ.STEM)

    def stem_centreline(self) -> tuple[Array, Array, Array]:
        """Return the main stem's points (S, 3) [m], radii (S,) [m] and arc length from the soil (S,) [m]."""
        k = self.stem_segments()
        points = np.vstack([self.start[k[:1]], self.end[k]])
        radii = np.concatenate([self.radius_start[k[:1]], self.radius_end[k]])
        return points, radii, np.concatenate([[0.0], np.cumsum(self.length[k])])

    def posed_vertices(self, T_world_rest: ArrayLike) -> Array:
        """Return the mesh vertices (Nv, 3) [m] when each segment has moved rigidly from rest.

        Args:
            T_world_rest: (K, 4, 4) maps a point of segment k at rest to where it is now; identity = at rest.
        """
        T = check_array("T_world_rest", T_world_rest, (len(self.start), 4, 4))
        out = self.vertices.copy()
        rides = self.vertex_segment >= 0
        out[rides] = transform_each(T[self.vertex_segment[rides]], out[rides])
        return out
