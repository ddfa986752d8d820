"""Rods: a branched network of slender elastic rods, one rooted tree of nodes. N nodes; edge j joins parent[j] to j."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from anther.core.checks import check_array
from anther.core.choices import Discretisation as Discretisation  # noqa: PLC0414 - the door gives it
from anther.core.errors import bad_input
from anther.core.records import Range, Record, Shape

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
    """

    CALLED = "natural"
    length: Annotated[Array, Shape("N"), Range(unit="m")]
    curvature: Annotated[Array, Shape("N", 2)]
    twist: Annotated[Array, Shape("N"), Range(unit="rad")]


@dataclass(frozen=True, slots=True, eq=False)
class Rods:
    """A tree of elastic rods with stretch, bend and twist stiffness, round solid cross-sections and lumped masses.

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
            have about 12; a huge value leaves twist free; 0 means that the rods cannot twist.
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
        natural: the stress-free shape; None means the scanned shape itself.
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
    natural: NaturalShape | None = None
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
        lengths = np.linalg.norm(self.nodes - self.nodes[self.parent], axis=1)
        lengths[0] = 0
        lengths.flags.writeable = False
        object.__setattr__(self, "lengths", lengths)
        if np.any(self.lengths[1:] < 1e-7):
            edge = 1 + int(np.argmin(self.lengths[1:]))
            raise bad_input(
                "rod nodes", given=f"edge {edge} of length 0", allowed="edges > 1e-7 m", do="Merge equal nodes."
            )
        if self.natural is not None and len(self.natural.length) != n:
            raise bad_input(
                "natural shape", given=f"{len(self.natural.length)} nodes", allowed=f"{n} nodes", do="Compute it anew."
            )

    @property
    def node_mass(self) -> Array:
        """(N,) mass lumped at node j [kg]: half of each edge that meets there, and the lumped mass."""
        return self._halves(np.asarray(self.density) * np.pi * np.asarray(self.edge_radius) ** 2) + self.lumped_mass

    @property
    def node_total_drag(self) -> Array:
        """(N,) drag at node j [N s/m]: air drag of half of each edge that meets there, mass damping, node drag."""
        return self._halves(np.asarray(self.air_drag)) + np.asarray(self.mass_damping) * self.node_mass + self.node_drag

    def _halves(self, per_length: Array) -> Array:
        half = 0.5 * per_length * self.lengths
        total = half.copy()
        np.add.at(total, self.parent[1:], half[1:])
        return total


LEAST_YOUNGS = 1.0
"""Of rods [Pa]: what is softer was given in another unit."""
_LIMITS = (
    ("edge_radius", (1e-6, 1.0), "m"),
    ("youngs", (LEAST_YOUNGS, 1e17), "Pa"),
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
    used = array[1:] if name in ("edge_radius", "youngs", "density", "bend_over_twist") else array
    wrong = used[(used < lower) | (used > upper)]
    if wrong.size:
        raise bad_input(
            name, given=f"{wrong[0]:g} {unit}", allowed=f"{lower:g} <= {name} <= {upper:g} {unit}", do="Check the unit."
        )
    return array
