"""Growing a simulated plant piece by piece: chains of segments with their tubes, surfaces that ride on a segment.

It is as stiff as it has to be: it holds itself up, and its flowers swing on their pedicels as measured.
Local frame while growing: the soil surface at the pot's axis is the origin, z up. `Growth.finish` places the plant.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import eigh

from anther.core.geometry import Array, transform, transform_points, unit_vectors
from anther.sim.mesh import Mesh, revolve, tube, unit
from anther.sim.plant import GRAVITY, SOIL_Z, Organ, Pot, SimPlant, Twine

SELF_SUPPORT = 2.0
"""How many times stiffer a plant is than one that just does not buckle under its own weight; 2 is a height margin of
2^(1/3) = 1.26 over Greenhill's limit (height ~ E^(1/3)). An estimate: plants in pots stand without a stake."""
AREAL_DENSITY = 0.25
"""Mass of a fresh blade per area [kg/m2]: 0.25 mm of tissue that is mostly water (an estimate)."""
GOLDEN_ANGLE = np.radians(137.5)


def arc(base: Array, azimuth: float, length: float, elevation: tuple[float, float], count: int) -> Array:
    """Return points (count + 1, 3) of an arc of `length` [m].

    Args:
        base: (3,) where it starts.
        azimuth: of the vertical plane it lies in [rad].
        length: [m].
        elevation: of its first and last piece above the horizon [rad].
        count: pieces.
    """
    steps = unit_vectors(azimuth, np.linspace(*elevation, count))
    return np.vstack([base, base + np.cumsum(steps * length / count, axis=0)])


def ripple(rng: np.random.Generator, rows: int, size: float) -> Array:
    """Return (rows, 7) smooth waves over a blade along its normal, growing to `size` [m] at its margins."""
    across, along = np.linspace(-1, 1, 7), np.linspace(0, 1, rows)[:, None]
    left, right = (size * np.sin(2 * np.pi * (rng.uniform(1.5, 3) * along + rng.uniform())) for _ in range(2))
    return np.where(across < 0, left, right) * across**2


def blade_colours(rng: np.random.Generator, colour: ArrayLike, rows: int) -> NDArray[np.uint8]:
    """Return (rows * 7, 3) sRGB colours of a blade: a lighter midrib, patches, a shade of its own."""
    shade = rng.normal(0, 7) + rng.normal(0, 3, (rows, 7))
    warm = max(0.0, rng.normal(0, 9))
    midrib = np.array([0, 0, 6, 22, 6, 0, 0.0])
    level = shade + midrib
    tinted = np.stack([level + warm, level, 0.6 * level], axis=-1) + np.asarray(colour)
    return np.clip(tinted, 0, 255).astype(np.uint8).reshape(-1, 3)


def varied(colour: ArrayLike, count: int, rng: np.random.Generator, spread: float = 5.0) -> NDArray[np.uint8]:
    """Return (count, 3) sRGB colours around `colour`, with one common shift in lightness and small noise."""
    shift = rng.normal(0, spread)
    noise = rng.normal(0, spread / 2.5, (count, 1)) * np.array([1.0, 1.0, 0.7])
    return np.clip(np.asarray(colour) + shift + noise, 0, 255).astype(np.uint8)


@dataclass
class Growth:
    """The pieces of a plant that is still growing.

    Attributes:
        rng: source of everything random.
        youngs: of the tissue [Pa]; a chain may have its own. 0: drawn, log-uniform over
            30 to 300 MPa (facts: pollination 0).
        longest: length of a segment [m]: `sim.plant_mechanics` bends a plant between its segments only.
    """

    longest: ClassVar[float] = 0.05
    rng: np.random.Generator
    youngs: float = 0.0
    _segments: list[dict[str, Any]] = field(default_factory=list)
    _flowers: list[tuple[int, Array]] = field(default_factory=list)
    _meshes: list[dict[str, Any]] = field(default_factory=list)
    _vertices: int = 0

    def __post_init__(self) -> None:
        self.youngs = self.youngs or float(np.exp(self.rng.uniform(*np.log((30e6, 300e6)))))

    def chain(
        self,
        points: Array,
        radii: ArrayLike,
        organ: Organ,
        parent: int,
        colour: ArrayLike,
        *,
        youngs: float | None = None,
        sides: int = 8,
        tip: bool = True,
    ) -> list[int]:
        """Add tapered segments, none over `longest`, along a polyline (n, 3) from the parent's end, and their tube.

        Args:
            points: (n, 3) [m].
            radii: (n,) [m].
            organ: of every segment.
            parent: segment it grows from, -1 for the soil.
            colour: sRGB.
            youngs: Young's modulus [Pa] if not the plant's.
            sides: of the tube.
            tip: whether the tube's end is closed.

        Returns:
            the n - 1 numbers of the segments that end at points[1:].
        """
        radii = np.asarray(radii, dtype=np.float64)
        tissue = {"organ": organ, "youngs": youngs or self.youngs, "density": 1000.0}  # an estimate
        first, last = len(self._segments), []
        for i, step in enumerate(np.diff(points, axis=0)):
            count = int(np.ceil(np.linalg.norm(step) / self.longest))
            places, widths = (np.linspace(x[i], x[i + 1], count + 1) for x in (points, radii))
            for j in range(count):
                ends = {"start": places[j], "end": places[j + 1]}
                ends |= {"radius_start": widths[j], "radius_end": widths[j + 1]}
                carried = {"lump_mass": 0.0, "lump_moment": np.zeros(3)}
                self._segments.append({"parent": parent, **ends, **tissue, **carried})
                parent = len(self._segments) - 1
            last.append(parent)
        ring = np.repeat([first, *last], sides)
        rides = np.concatenate([ring, last[-1:]]) if tip else ring
        self.surface(tube(points, radii, sides=sides, tip=tip), organ, colour, rides)
        return last

    def beside(self, segment: int, point: Array) -> int:
        """Return which segment lies beside a point (3,) [m]: this one, or one before it in the same organ."""
        here = self._segments[segment]
        above = here["parent"]
        before = (point - here["start"]) @ (here["end"] - here["start"]) < 0
        if before and above >= 0 and self._segments[above]["organ"] == here["organ"]:
            return self.beside(above, point)
        return segment

    def surface(self, mesh: Mesh, organ: Organ, colour: ArrayLike, segment: int | NDArray[Any]) -> None:
        """Add a mesh. `colour` is one sRGB colour, varied a little, or (n, 3); `segment` one or (n,)."""
        vertices, faces = mesh
        n = len(vertices)
        colours = np.asarray(colour)
        colours = varied(colours, n, self.rng) if colours.ndim == 1 else colours.astype(np.uint8)
        piece = {"vertices": vertices, "faces": faces + self._vertices, "vertex_color": colours}
        labels = {"face_organ": np.full(len(faces), organ), "vertex_segment": np.broadcast_to(segment, n)}
        self._meshes.append(piece | labels)
        self._vertices += n

    def carry(self, segment: int, mass: float, centre: ArrayLike) -> None:
        """Add a mass [kg] that segment carries at `centre` (3,) [m]."""
        self._segments[segment]["lump_mass"] += mass
        self._segments[segment]["lump_moment"] = self._segments[segment]["lump_moment"] + mass * np.asarray(centre)

    def flower(
        self,
        parent: int,
        out: Array,
        colour: ArrayLike,
        *,
        length: tuple[float, float],
        mass: tuple[float, float],
        nod: tuple[float, float],
        parts: tuple[float, float],
        widths: tuple[float, float, float],
    ) -> tuple[int, Array, Array]:
        """Add a pedicel with a knee, and the flower's mass that it carries 3 mm beyond its end.

        Args:
            parent: segment it grows from the end of.
            out: (3,) unit vector of its first part.
            colour: sRGB.
            length: range of its length [m].
            mass: range of the flower's mass [kg].
            nod: range of how far down it turns at the knee [-].
            parts: shares of the length before and after the knee.
            widths: radii at base, knee and end, over that with which it resonates at 20-35 Hz.

        Returns:
            its last segment, its end (3,) [m], and the unit vector (3,) in which it ends.
        """
        rng = self.rng
        long, heavy, youngs = rng.uniform(*length), rng.uniform(*mass), rng.uniform(50e6, 100e6)
        radius = pedicel_radius(long + 0.003, heavy, youngs, rng.uniform(20.0, 35.0))  # facts: pollination 1a
        base, end = self.end(parent), unit(out + np.array([0, 0, -rng.uniform(*nod)]))
        points = np.stack([base, base + parts[0] * long * out, base + long * (parts[0] * out + parts[1] * end)])
        radii = radius * np.array(widths)
        segment = self.chain(points, radii, Organ.PEDICEL, parent, colour, youngs=youngs, sides=6)[-1]
        self.carry(segment, heavy, points[-1] + 0.003 * end)
        self._flowers.append((segment, points[-1] + 0.003 * end))
        return segment, points[-1], end

    def end(self, segment: int) -> Array:
        """Return where a segment ends (3,) [m]."""
        return self._segments[segment]["end"]

    @property
    def mass(self) -> float:
        """Of all that has grown so far [kg]."""
        a, b, start, end, density, lump = (
            np.array([s[name] for s in self._segments])
            for name in ("radius_start", "radius_end", "start", "end", "density", "lump_mass")
        )
        volume = np.pi * np.linalg.norm(end - start, axis=1) * (a * a + a * b + b * b) / 3
        return float((density * volume + lump).sum())

    def _pot(self, radius: float) -> None:
        """Add a pot with soil under the origin."""
        paints = ((178, 98, 66), (42, 42, 45), (160, 88, 60))  # terracotta, black plastic, darker terracotta
        colour = paints[self.rng.integers(len(paints))]
        r, h = radius, Pot.height
        outside = [
            (0, -h),
            (0.74 * r, -h),
            (0.95 * r, -0.2 * h),
            (r, -0.2 * h),
            (r, 0),
            (r - 0.005, 0),
            (r - 0.01, -0.03),
        ]
        self.surface(revolve(np.repeat(outside, 2, axis=0)), Organ.POT, colour, -1)
        rings = np.linspace(0, r - 0.006, 18)
        soil, faces = revolve(np.stack([rings, -0.012 * (rings / r) ** 2], axis=1), sides=56)
        crumbs = slice(56, -56)
        soil[crumbs] += self.rng.normal(0, 0.0014, soil[crumbs].shape)
        colours = np.clip(np.array((58, 43, 33)) * self.rng.uniform(0.6, 1.35, (len(soil), 1)), 0, 255)
        self.surface((soil, faces), Organ.SOIL, colours, -1)

    def finish(self, species: str, seed: int, *, axis: tuple[float, float], viewpoint: float) -> SimPlant:
        """Return the plant in a pot, turned by `viewpoint` [deg] about its axis and placed at (axis, SOIL_Z) [m]."""
        pot_radius = float(self.rng.uniform(0.085, 0.1))
        self._pot(pot_radius)
        c, s = np.cos(np.radians(viewpoint)), np.sin(np.radians(viewpoint))
        T = transform([[c, -s, 0], [s, c, 0], [0, 0, 1]], [*axis, SOIL_Z])
        return supported_youngs(self.plant(species, seed, T, Pot(T[:3, 3], pot_radius)))

    def plant(self, species: str, seed: int, T: Array, pot: Pot, twines: tuple[Twine, ...] = ()) -> SimPlant:
        """Return the plant at T (4, 4) as it grew, whether or not it holds itself up; pot and twines are placed."""
        part: dict[str, Any] = {name: np.array([s[name] for s in self._segments]) for name in self._segments[0]}
        mesh: dict[str, Any] = {name: np.concatenate([m[name] for m in self._meshes]) for name in self._meshes[0]}
        lump_mass, moment = part["lump_mass"], part.pop("lump_moment")
        middle = (part["start"] + part["end"]) / 2
        centre = np.where(lump_mass[:, None] > 0, moment / np.maximum(lump_mass, 1e-12)[:, None], middle)
        places = {"start": part.pop("start"), "end": part.pop("end"), "lump_centre": centre}
        places |= {"flower_position": np.array([p for _, p in self._flowers]), "vertices": mesh.pop("vertices")}
        placed: dict[str, Any] = {name: transform_points(T, value) for name, value in places.items()}
        return SimPlant(
            species=species,
            seed=seed,
            damping_ratio=np.full(len(self._segments), self.rng.uniform(0.03, 0.08)),
            flower_segment=np.array([k for k, _ in self._flowers]),
            pot=pot,
            twines=twines,
            **part,
            **mesh,
            **placed,
        )


def pedicel_radius(length: float, flower_mass: float, youngs: float, resonance: float) -> float:
    """Return the radius [m] with which a pedicel and its flower resonate at `resonance` [Hz].

    A massless cantilever with a tip mass: (2 pi f)^2 = 3 E I / (m L^3), I = pi r^4 / 4.
    """
    stiffness = (2 * np.pi * resonance) ** 2 * flower_mass
    return float((4 * stiffness * length**3 / (3 * np.pi * youngs)) ** 0.25)


def buckling_factor(plant: SimPlant) -> float:
    """Return the factor by which all Young's moduli could fall before the plant buckles under its own weight.

    Segments are rigid, with a bending spring E I / L at each joint (L between the middles of the two segments). A small
    tilt theta of segment k about a horizontal axis releases m_k g dz_k theta^2 / 2, where m_k is all mass it carries
    and dz_k its rise. Buckling is where the spring energy no longer exceeds that: the largest eigenvalue of G x = l K x
    is 1 / factor. For one tapered pole this converges to Greenhill's limit.
    """
    springs, weight = _spring_matrix(plant), _weight_moments(plant)
    return float(1 / max(eigh(np.diag(weight), springs, eigvals_only=True)[-1], 1e-12))


def _spring_matrix(plant: SimPlant) -> Array:
    half, parent, child = plant.length / 2, plant.parent[1:], np.arange(1, len(plant.parent))
    span = half + np.concatenate([[0.0], half[parent]])
    softness = span / (plant.youngs * (np.pi / 4 * plant.radius_start**4))
    softness[0] += 1 / plant.foot
    stiffness = 1 / softness
    K = np.diag(stiffness)
    np.add.at(K, (parent, parent), stiffness[1:])
    K[child, parent] = K[parent, child] = -stiffness[1:]
    return K


def _weight_moments(plant: SimPlant) -> Array:
    """(K,) second derivative of the weight's energy that each segment's tilt releases [N m]."""
    own = plant.mass + plant.lump_mass
    rise = (plant.end - plant.start)[:, 2]
    own_rise = plant.mass * rise / 2 + plant.lump_mass * (plant.lump_centre - plant.start)[:, 2]
    return GRAVITY * ((plant.carried(own) - own) * rise + own_rise)


def supported_youngs(plant: SimPlant) -> SimPlant:
    """Return the plant, all but its pedicels stiffened if it could not hold itself up with the margin SELF_SUPPORT."""
    raise_by = SELF_SUPPORT / buckling_factor(plant)
    if raise_by <= 1:
        return plant
    green = plant.organ != Organ.PEDICEL
    return replace(plant, youngs=np.where(green, plant.youngs * raise_by, plant.youngs))
