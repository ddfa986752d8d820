"""Rods: a branched network of slender elastic rods, one rooted tree of nodes. N nodes; edge j joins parent[j] to j."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anther.core.checks import check_array
from anther.core.choices import Discretisation as Discretisation  # noqa: PLC0414 - the door gives it
from anther.core.errors import bad_input
from anther.core.records import Range, Record, Shape
from anther.rods._supports import Support, check_supports

Array = NDArray[np.float64]

GRAVITY = (0.0, 0.0, -9.81)
"""Acceleration of free fall [m/s^2], rounded as in the paper's simulations."""


@dataclass(frozen=True, slots=True, eq=False)
class NaturalShape(Record):
    """The stress-free shape of every edge and joint. Entry j belongs to edge j and to its joint with its parent edge.

    Attributes:
        length: (N,) natural edge length [m]; entry 0 is unused.
        curvature: (N, 2) natural integrated curvatures kappa1, kappa2 [-] in the frames carried from the root.
        twist: (N,) natural integrated twist [rad].
        support_force: (S, 3) force [N] that each of `Rods.supports` exerts in the scanned shape; (0, 3): not found.
    """

    CALLED = "natural"
    length: Annotated[Array, Shape("N"), Range(unit="m")]
    curvature: Annotated[Array, Shape("N", 2)]
    twist: Annotated[Array, Shape("N"), Range(unit="rad")]
    support_force: Annotated[Array, Shape("S", 3), Range(unit="N")] = field(default_factory=lambda: np.zeros((0, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """Cross-sections that are not solid and round; each number once, or per edge as an (N,) array.

    The axes of edge j are d1, which is `axis` less its part along the edge, and d2 = t x d1 with the edge's tangent t.

    Attributes:
        area: A [m^2].
        bend_1, bend_2: second moments of area I1, I2 against bending towards d1 and towards d2 [m^4].
        torsion: torsion constant J [m^4]; of a round section I1 + I2.
        axis: (3,) or (N, 3) direction in the world, of any length, not along an edge.
    """

    area: Array | float
    bend_1: Array | float
    bend_2: Array | float
    torsion: Array | float
    axis: Array | tuple[float, float, float] = (1.0, 0.0, 0.0)

    @classmethod
    def tube(cls, radius: ArrayLike, wall: ArrayLike) -> Section:
        """Return round tubes of outer `radius` [m] with a `wall` [m]; a wall of the whole radius is solid."""
        outer, inner = np.asarray(radius), np.asarray(radius) - np.asarray(wall)
        if np.any(np.asarray(wall) <= 0) or np.any(inner < 0):
            raise bad_input("wall", given=f"{wall} m", allowed="0 < wall <= radius", do="Check the unit.")
        bend = np.pi / 4 * (outer**4 - inner**4)
        return cls(np.pi * (outer**2 - inner**2), bend, bend, 2 * bend)

    @classmethod
    def ellipse(cls, width: ArrayLike, height: ArrayLike, axis: Any = (1.0, 0.0, 0.0)) -> Section:
        """Return solid ellipses, `width` [m] along d1, `height` [m] along d2; J = pi a^3 b^3 / (a^2 + b^2)."""
        a, b = np.asarray(width) / 2, np.asarray(height) / 2
        return cls(np.pi * a * b, np.pi / 4 * a**3 * b, np.pi / 4 * a * b**3, np.pi * a**3 * b**3 / (a**2 + b**2), axis)

    @classmethod
    def rectangle(cls, width: ArrayLike, height: ArrayLike, axis: Any = (1.0, 0.0, 0.0)) -> Section:
        """Return solid rectangles, `width` [m] along d1, `height` [m] along d2; J by Saint-Venant's series."""
        b, h = np.asarray(width, dtype=np.float64), np.asarray(height, dtype=np.float64)
        long, short, n = np.maximum(b, h), np.minimum(b, h), np.arange(1, 20, 2)
        series = np.sum(np.tanh(np.multiply.outer(long / short, n * np.pi / 2)) / n**5, axis=-1)
        torsion = long * short**3 / 3 * (1 - 192 / np.pi**5 * short / long * series)
        return cls(b * h, b**3 * h / 12, b * h**3 / 12, torsion, axis)

    def per_edge(self, n: int) -> Section:
        """Return it with (N,) numbers and (N, 3) axes.

        Raises:
            InputError: another number of edges, or a number that is none of a section's.
        """
        moments = {
            name: _per_node(name, getattr(self, name), n, limits, unit) for name, limits, unit in _SECTION_LIMITS
        }
        axis = np.broadcast_to(np.asarray(self.axis, dtype=np.float64), (n, 3))
        return Section(**moments, axis=check_array("section axis", axis, (n, 3)))


@dataclass(frozen=True, slots=True, weakref_slot=True, eq=False)
class Rods:
    """A tree of elastic rods with stretch, bend and twist stiffness and lumped masses.

    Every scalar may be given once, or per node or edge as an (N,) array; afterwards each is an (N,) array.
    Bend and twist springs join each edge to its parent edge, so every joint is elastic whatever its degree. The
    children of the root are joined to the stiffest of them.

    Attributes:
        nodes: (N, 3) positions [m] of the scanned shape. It is stress-free unless `natural` says otherwise.
        parent: (N,) int; parent[0] = -1 and 0 <= parent[j] < j.
        edge_radius: (N,) radius of edge j [m]; entry 0 is unused.
        youngs: (N,) Young's modulus of edge j [Pa].
        density: (N,) density of edge j [kg/m^3].
        bend_over_twist: (N,) EI / GJ of edge j [-]. A round bar has 1 + Poisson's ratio: 1.5 at 0.5; dicot petioles
            have about 12; a huge value leaves twist free; 0 means that the rods cannot twist. With a `section`,
            GJ = E J / (2 bend_over_twist), which is the same for round ones.
        joint_compliance: (N,) how much softer the joint of edge j with its parent edge is than the rods themselves
            [rad/(N m)], in bend and twist: the abscission joint of a pedicel, the base of a petiole.
        lumped_mass: (N,) extra mass at node j [kg]: leaf, flower, fruit.
        lumped_inertia: (N,) moment of inertia of that mass about its centre [kg m^2]; it turns with edge j. A sphere
            has 0.4 m r^2.
        viscous_time: (N,) Kelvin-Voigt time of edge j [s]: stress = E (strain + viscous_time * strain rate). A mode
            of angular frequency w gets the damping ratio viscous_time * w / 2.
        mass_damping: (N,) drag per mass [1/s]; a mode gets the damping ratio mass_damping / (2 w).
        air_drag: (N,) drag per length of edge j [N s/m^2].
        node_drag: (N,) extra drag at node j [N s/m].
        supports: S springs between the ground and nodes: clips, strings, a floor.
        natural: the stress-free shape; None means the scanned shape itself.
        section: of the edges; None means solid and round, of `edge_radius`. Rotary inertia is that of (I1 + I2) / 2.
        discretisation: "consistent" converges with the second order in the edge length, also at forks and kinks;
            "paper" is P19 to the letter, with lumped masses, as its solver has it: first order at forks and kinks.
        lengths: (N,) scanned length of edge j [m], found from the nodes; entry 0 is 0.
    """

    nodes: Array
    parent: NDArray[Any]
    edge_radius: Array | float
    youngs: Array | float
    density: Array | float
    bend_over_twist: Array | float = 1.5
    joint_compliance: Array | float = 0.0
    lumped_mass: Array | float = 0.0
    lumped_inertia: Array | float = 0.0
    viscous_time: Array | float = 0.0
    mass_damping: Array | float = 0.0
    air_drag: Array | float = 0.0
    node_drag: Array | float = 0.0
    supports: tuple[Support, ...] = ()
    natural: NaturalShape | None = None
    section: Section | None = None
    discretisation: Discretisation = "consistent"
    lengths: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        n = len(self.nodes)
        if self.discretisation not in ("consistent", "paper"):
            given, allowed = self.discretisation, "consistent or paper"
            raise bad_input("discretisation", given=given, allowed=allowed, do="Check the spelling.")
        object.__setattr__(self, "nodes", check_array("rod nodes", self.nodes, (n, 3)))
        object.__setattr__(self, "parent", check_array("rod parent", self.parent, (n,), dtype="int64"))
        _check_tree(self.parent)
        for name, limits, unit in _LIMITS:
            object.__setattr__(self, name, _per_node(name, getattr(self, name), n, limits, unit))
        if self.section is not None:
            object.__setattr__(self, "section", self.section.per_edge(n))
        lengths = np.linalg.norm(self.nodes - self.nodes[self.parent], axis=1)
        lengths[0] = 0
        lengths.flags.writeable = False
        object.__setattr__(self, "lengths", lengths)
        if np.any(self.lengths[1:] < 1e-7):
            edge = 1 + int(np.argmin(self.lengths[1:]))
            raise bad_input(
                "rod nodes", given=f"edge {edge} of length 0", allowed="edges > 1e-7 m", do="Merge equal nodes."
            )
        object.__setattr__(self, "supports", tuple(self.supports))
        check_supports(self.supports, n)
        if self.natural is not None:
            of, borne = len(self.natural.length), len(self.natural.support_force)
            if of != n or borne not in (0, len(self.supports)):
                given, allowed = f"{of} nodes, {borne} supports", f"{n} nodes, {len(self.supports)} supports"
                raise bad_input("natural shape", given=given, allowed=allowed, do="Compute it anew.")

    @classmethod
    def of_stiffness(
        cls,
        nodes: Array,
        parent: NDArray[Any],
        bending: Array | float,
        line_mass: Array | float,
        *,
        bending_2: Array | float | None = None,
        twisting: Array | float | None = None,
        stretching: Array | float | None = None,
        edge_radius: Array | float = 1e-3,
        axis: Any = (1.0, 0.0, 0.0),
        **more: Any,
    ) -> Rods:
        """Return rods whose stiffness itself is known, once or per edge as (N,) arrays.

        Args:
            nodes, parent: as of `Rods`.
            bending: EI against bending towards the section's d1 [N m^2].
            line_mass: [kg/m].
            bending_2: EI against bending towards d2; None means `bending`.
            twisting: GJ [N m^2]; None means the mean EI over `bend_over_twist`.
            stretching: EA [N]; None means that of a solid round bar with `edge_radius` and the mean EI.
            edge_radius: [m]; only this default and pictures use it.
            axis: of `Section`.
            more: other attributes of `Rods`.
        """
        first, second = np.asarray(bending), np.asarray(bending if bending_2 is None else bending_2)
        mean, area = (first + second) / 2, np.pi * np.asarray(edge_radius) ** 2
        ratio = more.setdefault("bend_over_twist", 1.5)
        twist = mean / ratio if twisting is None else np.asarray(twisting)
        youngs = (4 * np.pi * mean / area if stretching is None else np.asarray(stretching)) / area
        section = Section(area, first / youngs, second / youngs, 2 * ratio * twist / youngs, axis)
        return cls(nodes, parent, edge_radius, youngs, line_mass / area, section=section, **more)

    @property
    def sections(self) -> Section:
        """What the cross-sections are, (N,) each."""
        if self.section is not None:
            return self.section
        area = np.pi * np.square(self.edge_radius)
        bend = area * np.square(self.edge_radius) / 4
        return Section(area, bend, bend, 2 * bend)

    @property
    def support_forces(self) -> Array:
        """(S, 3) force that each support exerts in the scanned shape [N]: the stated one, or that of `natural`."""
        found = np.zeros((len(self.supports), 3))
        if self.natural is not None and len(self.natural.support_force):
            found[:] = self.natural.support_force
        for k, support in enumerate(self.supports):
            if support.force is not None:
                found[k] = support.force
        return found

    @property
    def node_mass(self) -> Array:
        """(N,) mass lumped at node j [kg]: half of each edge that meets there, and the lumped mass."""
        return self._halves(np.asarray(self.density) * self.sections.area) + self.lumped_mass

    @property
    def node_total_drag(self) -> Array:
        """(N,) drag at node j [N s/m]: air drag of half of each edge that meets there, mass damping, node drag."""
        return self._halves(np.asarray(self.air_drag)) + np.asarray(self.mass_damping) * self.node_mass + self.node_drag

    def _halves(self, per_length: Array) -> Array:
        half = 0.5 * per_length * self.lengths
        total = half.copy()
        np.add.at(total, self.parent[1:], half[1:])
        return total


LEAST_YOUNGS, MOST_YOUNGS = 1.0, 1e17
"""Of rods [Pa]: what is softer or stiffer was given in another unit."""
_LIMITS = (
    ("edge_radius", (1e-6, 1.0), "m"),
    ("youngs", (LEAST_YOUNGS, MOST_YOUNGS), "Pa"),
    ("density", (1e-3, 1e5), "kg/m^3"),
    ("bend_over_twist", (0.0, 1e12), ""),
    ("joint_compliance", (0.0, 1e12), "rad/(N m)"),
    ("lumped_mass", (0.0, 1e3), "kg"),
    ("lumped_inertia", (0.0, 1e3), "kg m^2"),
    ("viscous_time", (0.0, 1e3), "s"),
    ("mass_damping", (0.0, 1e6), "1/s"),
    ("air_drag", (0.0, 1e6), "N s/m^2"),
    ("node_drag", (0.0, 1e6), "N s/m"),
)
_SECTION_LIMITS = (
    ("area", (1e-12, 10.0), "m^2"),
    ("bend_1", (1e-24, 1.0), "m^4"),
    ("bend_2", (1e-24, 1.0), "m^4"),
    ("torsion", (1e-24, 1.0), "m^4"),
)
_OF_EDGES = ("edge_radius", "youngs", "density", "bend_over_twist", *(name for name, *_ in _SECTION_LIMITS))
"""Of these entry 0, which stands for no edge, is not checked."""


def _check_tree(parent: NDArray[Any]) -> None:
    n = len(parent)
    ordered = n >= 2 and parent[0] == -1 and bool(np.all((parent[1:] >= 0) & (parent[1:] < np.arange(1, n))))
    if not ordered:
        raise bad_input(
            "rod parent",
            given=f"{n} nodes, parents {parent[:5]}...",
            allowed="at least 2 nodes, parent[0] = -1, 0 <= parent[j] < j",
            do="Order the nodes from the root outward.",
        )


def _per_node(name: str, value: Any, n: int, limits: tuple[float, float], unit: str) -> Array:
    lower, upper = limits
    array = np.asarray(value, dtype=np.float64)
    array = check_array(name, np.full(n, array) if array.ndim == 0 else array, (n,))
    used = array[1:] if name in _OF_EDGES else array
    wrong = used[(used < lower) | (used > upper)]
    if wrong.size:
        raise bad_input(
            name, given=f"{wrong[0]:g} {unit}", allowed=f"{lower:g} <= {name} <= {upper:g} {unit}", do="Check the unit."
        )
    return array
