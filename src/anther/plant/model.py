"""Plant model: the scanned tree as elastic rods that carry leaves and flowers, in equilibrium under gravity (P16-P23).

N rod nodes: the J skeleton nodes first, under their own numbers, then the pedicels.
F flowers, S stem nodes, B branches.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from anther.core.checks import check_range
from anther.core.errors import StageFailure, bad_input
from anther.core.geometry import Array
from anther.core.records import Range, Record, Shape, Stored
from anther.perception.cloud import Cloud
from anther.perception.flowers import Flowers, assume_flowers
from anther.perception.skeleton import Skeleton
from anther.perception.stem import PEDICEL, Stem
from anther.plant._material import LEARNED, PEPPER, PRIORS, TOMATO, Material
from anther.plant._shape import branch_stiffening, edge_radii, hang_flowers, in_blade, leaf_mass, least_youngs
from anther.plant.string import HeldString, straightened, topmost_hold
from anther.rods import Clamp, Rods, Support, standing, with_gravity_equilibrium

__all__ = [
    "LEARNED", "PEPPER", "PRIORS", "TOMATO", "Material", "Params", "PlantModel", "build_plant", "plant_with_flowers",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Params(Record):
    """What the scan does not show.

    Attributes:
        areal_density: of a leaf blade [kg/m2]. A prior of ours; no source found.
        flower_mass: [kg] (facts: pollination 2 [R]: 0.05-0.15 g).
        pedicel_length, pedicel_radius: [m] (facts: 9-22 mm long, about 1 mm thick).
        pedicel_youngs: [Pa] (facts: 50-100 MPa gives the 23-33 Hz at which tomato flowers answer stem shaking best).
        stiffen: raise Young's modulus, with a note, until the plant carries itself, as it must; False refuses.
        string: that holds its main stem up; None: it stands alone.
    """

    areal_density: Annotated[float, Range(0, 5, "kg/m2")] = 0.25
    flower_mass: Annotated[float, Range(1e-6, 0.1, "kg")] = 1e-4
    pedicel_length: Annotated[float, Range(1e-3, 0.2, "m")] = PEDICEL
    pedicel_radius: Annotated[float, Range(1e-5, 0.02, "m")] = 0.5e-3
    pedicel_youngs: Annotated[float, Range(1e5, 1e11, "Pa")] = 70e6
    stiffen: bool = True
    string: HeldString | None = None

    def _check(self) -> None:
        if not isinstance(self.string, HeldString | None):
            raise bad_input(
                "string", given=repr(self.string)[:40], allowed="a HeldString or None", do="Use HeldString.of."
            )


@dataclass(frozen=True, slots=True, eq=False)
class PlantModel(Stored):
    """A plant ready to be shaken in simulation: in equilibrium under gravity in the scanned shape.

    Attributes:
        rods: the N rods without damping; `rods_at` gives them the material's damping.
        stem_nodes: (S,) rod nodes of the main stem, root first.
        arc_length: (S,) distance from the root along the stem [m].
        flower_nodes: (F,) rod node of each flower.
        branch_bases: (B,) first node of every branch or petiole that leaves the main stem.
        is_pedicel: (N,) whether the edge to the parent is modelled pedicel; its stiffness is not the stem's.
        material: what the rods were made of.
        pedicel_spread: spread of the pedicels' stiffness, standard deviation of ln [-].
        least_youngs: Young's modulus at which the plant buckles under its own weight [Pa].
        string: that holds the main stem up, the only support of the rods; None: it stands alone.
        notes: what the stage wants the user to know.
    """

    KIND, SCHEMA = "plant model", 5
    rods: Rods
    stem_nodes: Annotated[NDArray[np.int64], Shape("S")]
    arc_length: Annotated[Array, Shape("S"), Range(unit="m")]
    flower_nodes: Annotated[NDArray[np.int64], Shape("F")]
    branch_bases: Annotated[NDArray[np.int64], Shape("B")]
    is_pedicel: Annotated[NDArray[np.bool_], Shape("N")]
    material: Material
    pedicel_spread: float
    least_youngs: Annotated[float, Range(unit="Pa")]
    string: HeldString | None = None
    notes: tuple[str, ...] = ()

    def _check(self) -> None:
        n = len(self.rods.nodes)
        if self.rods.natural is None:
            raise bad_input("rods", given="no natural shape", allowed="rods at rest", do="Use build_plant.")
        if len(self.is_pedicel) != n:
            given = f"shape {self.is_pedicel.shape}"
            raise bad_input("is_pedicel", given=given, allowed=f"shape ({n},)", do="Check the array's axes.")
        for name in ("stem_nodes", "flower_nodes", "branch_bases"):
            nodes = getattr(self, name)
            if np.any((nodes < 0) | (nodes >= n)):
                raise bad_input(name, given=f"{nodes}", allowed=f"0 <= node < {n}", do="Use rod node numbers.")

    @property
    def clamp(self) -> Clamp:
        """The root and the direction in which the stem leaves the soil are held."""
        return Clamp.root(self.rods)

    def rods_at(self, frequency: float) -> Rods:
        """Return the rods with the material's damping ratio for motion at `frequency` [Hz].

        Plant tissue is taken as hysteretic, with the loss factor 2 zeta at every frequency. A Kelvin-Voigt time of
        zeta / (pi f) is that at f; slower motion is then damped less, faster motion more.
        """
        check_range("frequency", frequency, 1e-3, 1e4, "Hz")
        return replace(self.rods, viscous_time=self.material.damping_ratio / (np.pi * frequency))

    def with_material(
        self,
        material: Material,
        *,
        edge_factor: Array | float = 1.0,
        pedicel_factor: float = 1.0,
        tension_factor: float = 1.0,
    ) -> PlantModel:
        """Return the same plant of another material, again at rest in the scanned shape.

        Args:
            material: its youngs and radius scale replace those of stem and branches.
            edge_factor: (N,) multiplies Young's modulus of every edge [-].
            pedicel_factor: multiplies that of the pedicels [-].
            tension_factor: multiplies the tension of the string [-].

        Raises:
            StageFailure: kind "no_convergence": the plant would buckle.
        """
        stiffer = np.where(self.is_pedicel, pedicel_factor, material.youngs / self.material.youngs)
        heavier = material.density / self.material.density
        thicker = material.radius_scale / self.material.radius_scale
        rods = replace(
            self.rods,
            edge_radius=np.asarray(self.rods.edge_radius) * np.where(self.is_pedicel, 1.0, thicker),
            youngs=np.asarray(self.rods.youngs) * edge_factor * stiffer,
            density=np.asarray(self.rods.density) * heavier,
            bend_over_twist=material.bend_over_twist,
            natural=None,
            supports=self._pulled(tension_factor),
        )
        at_rest = standing(rods, self.clamp)
        if at_rest is None:
            raise _buckles(material.youngs, self.least_youngs / thicker**4)
        return replace(
            self,
            rods=at_rest,
            material=material,
            least_youngs=self.least_youngs / thicker**4,
        )

    def _pulled(self, factor: float) -> tuple[Support, ...]:
        """Return the rods' supports with the string `factor` times as tense."""
        if self.string is None:
            return self.rods.supports
        (held,) = self.rods.supports
        return (self.string.support(held.node, self.rods.nodes, factor),)


def build_plant(
    skeleton: Skeleton,
    stem: Stem,
    flowers: Flowers,
    cloud: Cloud | None = None,
    material: Material = TOMATO,
    *,
    params: Params = Params(),
) -> PlantModel:
    """Turn a scanned plant into rods in equilibrium under gravity.

    Args:
        skeleton: the tree with radii.
        stem: which of its nodes are main stem.
        flowers: each gets a modelled pedicel, which no sensor resolves.
        cloud: gives the leaf area, hence the leaf mass; None means bare branches.
        material: prior (`TOMATO`, `PEPPER`) or refined.
        params: what the scan does not show.

    Raises:
        InputError: a plant of impossible size, or a flower on a node that does not exist.
        StageFailure: kind "no_convergence": it cannot stand (see `Params.stiffen`).
    """
    _check(skeleton, stem, flowers)
    hold = len(stem.node_ids) - 1
    if params.string is not None:
        hold = topmost_hold(skeleton.nodes[stem.node_ids], skeleton.radius[stem.node_ids], cloud)
        skeleton, flowers = straightened(skeleton, stem, flowers, hold)
    rods, is_pedicel, tips, leaves = _rods(skeleton, stem, flowers, cloud, material, params=params)
    if params.string is not None:
        rods = replace(rods, supports=(params.string.support(int(stem.node_ids[hold]), rods.nodes),))
    edge = np.arange(len(rods.nodes))
    on_stem, blade = (np.isin(edge, ids) for ids in (stem.node_ids, np.flatnonzero(in_blade(skeleton, stem))))
    rib = 10.0  # stiffness of a folded blade over that of its rib alone, an estimate: 10 to 70
    softest = None if params.string is None else material.youngs * float(np.exp(-2 * material.youngs_spread))
    stiffening = branch_stiffening(rods, on_stem, is_pedicel, blade, rib, softest)
    least = least_youngs(rods, Clamp.root(rods), is_pedicel, stiffening)
    if least is None:
        raise StageFailure(
            "no_convergence",
            "plant model: no stiffness of the stem holds the plant up, so a modelled pedicel is too soft for its "
            "flower. Raise pedicel_youngs or pedicel_radius.",
        )
    chosen, note = _youngs_that_holds(material, least, params)
    rods = replace(rods, youngs=np.where(is_pedicel, rods.youngs, chosen.youngs * stiffening))
    return PlantModel(
        rods=with_gravity_equilibrium(rods, Clamp.root(rods)),
        stem_nodes=stem.node_ids,
        arc_length=stem.arc_length,
        flower_nodes=tips,
        branch_bases=_branch_bases(skeleton, stem),
        is_pedicel=is_pedicel,
        material=chosen,
        pedicel_spread=float(np.log(2) / np.sqrt(12)),  # log-uniform over the facts' range of pedicel_youngs
        least_youngs=least,
        string=params.string,
        notes=(_mass_note(rods, leaves, cloud), *note),
    )


def plant_with_flowers(
    skeleton: Skeleton,
    stem: Stem,
    found: Flowers,
    cloud: Cloud | None,
    material: Material,
    *,
    params: Params = Params(),
) -> PlantModel:
    """Return the plant as rods with the flowers found or, where none was, with assumed ones; a note says so.

    Arguments and errors are those of `build_plant`.
    """
    if len(found.positions):
        return build_plant(skeleton, stem, found, cloud, material, params=params)
    hung = assume_flowers(skeleton, stem)
    plant = build_plant(skeleton, stem, hung, cloud, material, params=params)
    return replace(plant, notes=(*hung.notes, *plant.notes))


def _rods(
    skeleton: Skeleton, stem: Stem, flowers: Flowers, cloud: Cloud | None, material: Material, *, params: Params
) -> tuple[Rods, NDArray[np.bool_], NDArray[Any], float]:
    """Return the rods in the scanned shape, which edges are pedicel, the flowers' nodes, and the leaf mass [kg]."""
    radius = material.radius_scale * edge_radii(skeleton, stem)
    pieces = 3  # edges per pedicel
    stalks = hang_flowers(skeleton, flowers, length=params.pedicel_length, radius=params.pedicel_radius, pieces=pieces)
    new = len(stalks.nodes)
    mass = np.zeros(len(radius) + new)
    if cloud is not None:
        mass[: len(radius)] = leaf_mass(skeleton, stem, cloud, areal_density=params.areal_density)
    leaves, inertia = float(mass.sum()), 0 * mass
    mass[stalks.tips] += params.flower_mass
    ball = 5e-3  # m, radius of a flower's mass for its moment of inertia (facts: pollination 2, corolla 10 mm)
    inertia[stalks.tips] = 0.4 * params.flower_mass * ball**2
    is_pedicel = np.concatenate([np.zeros(len(radius), dtype=bool), stalks.is_pedicel])
    rods = Rods(
        nodes=np.concatenate([skeleton.nodes, stalks.nodes]),
        parent=np.concatenate([skeleton.parent, stalks.parent]),
        edge_radius=np.concatenate([radius, stalks.radius]),
        youngs=np.where(is_pedicel, params.pedicel_youngs, material.youngs),
        density=material.density,
        bend_over_twist=material.bend_over_twist,
        lumped_mass=mass,
        lumped_inertia=inertia,
    )
    return rods, is_pedicel, stalks.tips, leaves


def _youngs_that_holds(material: Material, least: float, params: Params) -> tuple[Material, tuple[str, ...]]:
    """Return the material, stiffened where the plant would not stand with it, and a note that says so.

    Raises:
        StageFailure: it would not stand and may not be stiffened.
    """
    margin = 1.5  # least ratio of Young's modulus to the value at which the plant buckles [-]
    if material.youngs >= margin * least:
        return material, ()
    if not params.stiffen:
        raise _buckles(material.youngs, least)
    held = margin * least
    note = (
        f"Young's modulus raised from {material.youngs / 1e6:.3g} to {held / 1e6:.3g} MPa: below {least / 1e6:.3g} MPa "
        "the plant would buckle under its own weight, and it stands."
    )
    return replace(material, youngs=held), (note,)


def _buckles(youngs: float, least: float) -> StageFailure:
    return StageFailure(
        "no_convergence",
        f"plant model: with a Young's modulus of {youngs / 1e6:.3g} MPa the plant buckles under its own weight; "
        f"about {least / 1e6:.3g} MPa would just hold it. Raise youngs, or check radii, units and leaf mass.",
    )


def _branch_bases(skeleton: Skeleton, stem: Stem) -> NDArray[Any]:
    on_stem = np.isin(np.arange(len(skeleton.nodes)), stem.node_ids)
    return 1 + np.flatnonzero(on_stem[skeleton.parent[1:]] & ~on_stem[1:])


def _mass_note(rods: Rods, leaves: float, cloud: Cloud | None) -> str:
    total = f"plant model: {1e3 * rods.node_mass.sum():.3g} g above the soil"
    if cloud is None:
        return f"{total}, no leaves: without a cloud their mass is unknown, and frequencies come out too high."
    return f"{total}, {1e3 * leaves:.3g} g of it leaves."


def _check(skeleton: Skeleton, stem: Stem, flowers: Flowers) -> None:
    size = float(np.ptp(skeleton.nodes, axis=0).max())
    check_range("plant size", size, 0.02, 20, "m")
    count = len(skeleton.nodes)
    for name, nodes in (("stem nodes", stem.node_ids), ("flower attachment", flowers.attachment)):
        if len(nodes) and not (nodes.min() >= 0 and nodes.max() < count):
            raise bad_input(name, given=f"node {nodes.max()}", allowed=f"0 <= node < {count}", do="Same skeleton?")
