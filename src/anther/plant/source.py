"""The plant that a run folder or a skeleton file holds, as rods: read once and alike, whatever is asked of it.

N rod nodes: the J nodes of the skeleton first, then the pedicels. S stem nodes, F flowers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.core.checks import check_range
from anther.core.choices import Axis, Crop, Units
from anther.core.errors import StageFailure, bad_input
from anther.core.geometry import Array
from anther.core.runs import FILES, kept
from anther.perception.cloud import Cloud
from anther.perception.flowers import Flowers
from anther.perception.formats.skeletons import SkeletonFile
from anther.perception.skeleton import Skeleton
from anther.perception.stem import PEDICEL, Stem
from anther.plant.imported import main_stem, node_named, read_source
from anther.plant.model import PRIORS, TOMATO, Material, PlantModel, plant_with_flowers
from anther.rods import Clamp, Rods, least_stiffness, standing


class Properties(NamedTuple):
    """What a plant is made of, as far as it is given.

    Attributes:
        species: whose prior holds where nothing was measured.
        material: measured (`anther identify`); None: of a run its own, else the prior.
        changes: youngs [Pa], density [kg/m^3], damping_ratio, bend_over_twist (0: rods do not twist), by name.
        radius: of every node, as if scanned [m]; None: as it was.
        least_radius: no node is thinner [m].
    """

    species: Crop = "tomato"
    material: Material | None = None
    changes: Mapping[str, float] = {}
    radius: float | None = None
    least_radius: float = 0.0

    def of(self, own: Material | None = None) -> tuple[Material, str]:
        """Return the material of a plant that has its own or none, and where its Young's modulus is from."""
        base = self.material or own or PRIORS[self.species]
        origin = "measured" if self.material else "of the run" if own else f"prior of {self.species}"
        changes = {name: value for name, value in self.changes.items() if value or name != "bend_over_twist"}
        return replace(base, **changes), "given" if "youngs" in changes else origin


PRIOR_ALONE = Properties()
"""Nothing is given."""


@dataclass(frozen=True, slots=True, eq=False)
class SourcePlant:
    """A plant as elastic rods at rest, of which the soil holds the root.

    Attributes:
        rods: without viscosity, in the scanned shape, in equilibrium under gravity.
        numbers: (N,) what the user calls each node; a pedicel has the number of the node that bears it.
        damping_ratio: share of critical damping [-].
        stem_nodes: (S,) main stem, root first; of bare edges it may be empty.
        flower_nodes: (F,) may be empty.
        stiffness: Young's modulus of stem and branches and where it is from, in words.
        model: the same plant with its limits; None of bare edges.
        merged: numbers of nodes of the file that repeat another's point -> the other's number.
        notes: what the user should know.
    """

    rods: Rods
    numbers: NDArray[Any]
    damping_ratio: float
    stem_nodes: NDArray[Any]
    flower_nodes: NDArray[Any]
    stiffness: str
    model: PlantModel | None
    merged: dict[int, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def clamp(self) -> Clamp:
        """The root, and the direction in which the stem leaves the soil."""
        return Clamp.root(self.rods)

    def node(self, number: int) -> int:
        """Return the index of the node that the user calls `number`."""
        return SkeletonFile(self.rods.nodes, self.rods.parent, None, self.numbers, merged=self.merged).node(number)

    def flower(self, number: int) -> int:
        """Return the flower that the node called `number` bears, or else the node itself."""
        borne = self.flower_nodes[self.numbers[self.flower_nodes] == self.numbers[self.node(number)]]
        return int(borne[0]) if len(borne) else self.node(number)

    def damped(self, frequency: float) -> Rods:
        """Return the rods with the damping ratio for motion at `frequency` [Hz] (`Rods.viscous_time`)."""
        return replace(self.rods, viscous_time=self.damping_ratio / (np.pi * frequency))

    def distances(self) -> Array:
        """Return (N,) distances from the root along the plant [m]."""
        along = self.rods.lengths.copy()
        for j in range(1, len(along)):
            along[j] += along[self.rods.parent[j]]
        return along


def read_plant(
    path: Path,
    properties: Properties = PRIOR_ALONE,
    *,
    flowers: Sequence[int] = (),
    units: Units | None = None,
    up: Axis | None = None,
    root: str | None = None,
    stem_tip: str | None = None,
    bare: bool = False,
    hanging: bool = True,
) -> tuple[SourcePlant, Skeleton | None, Stem | None, Cloud | None]:
    """Return (plant, skeleton, stem, cloud) of a run folder or a skeleton file; of a run's, what it keeps of them.

    Args:
        path: run folder or skeleton file.
        properties: what the plant is made of, as far as it is given.
        flowers: of a file: nodes that bear one, by the file's numbers; none: flowers are assumed at its ends.
        units, up, root, stem_tip: of a file, see `read_source` and `main_stem`.
        bare: of a file: its edges with its own radii alone; nothing is assumed, tapered or stiffened.
        hanging: of bare edges: in equilibrium under gravity; False: they have no natural shape yet.

    Raises:
        InputError: a bad file, node or value, or what only a file takes with a run folder.
        StageFailure: there is no main stem, or the plant would buckle under its own weight.
    """
    _check(properties)
    if path.is_dir():
        if flowers or bare or any(given is not None for given in (units, up, root, stem_tip)):
            names = "--flower, --units, --up, --root, --stem-tip or --bare"
            raise bad_input(names, given="with a run folder", allowed="skeleton files", do="Leave it out.")
        return _read_run(path, properties)
    source, skeleton = read_source(
        path,
        units=units,
        up=up,
        radius=properties.radius,
        least=properties.least_radius,
        root=root,
        crop=properties.species,
    )
    at = np.array([source.node(number) for number in flowers], dtype=np.int64)
    if np.any(at == 0):
        raise bad_input("flower", given="the root", allowed="a node of a branch or of the stem", do="Name another.")
    tip = None if stem_tip is None else source.node(node_named("--stem-tip", stem_tip, source))
    out = skeleton.nodes[at] - skeleton.nodes[skeleton.parent[at]]
    out *= PEDICEL / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9)
    hung = Flowers(skeleton.nodes[at] + out, at)
    try:
        stem = main_stem(skeleton, tip, hung.positions)
    except StageFailure:
        if not bare:  # whose grip may be named
            raise
        stem = None
    if bare or stem is None:
        plant = _bare(source, skeleton, stem, properties, at)
        return replace(plant, rods=_at_rest(plant.rods)) if hanging else plant, skeleton, stem, None
    plant = _model(skeleton, stem, hung, None, properties)
    notes = (*source.notes, *stem.notes, *plant.notes)
    named = replace(plant, numbers=source.numbers[plant.numbers], merged=source.merged, notes=notes)
    return named, skeleton, stem, None


def _check(properties: Properties) -> None:
    check_range("damping_ratio", properties.changes.get("damping_ratio", 0.0), 0, 10)
    check_range("bend_over_twist", properties.changes.get("bend_over_twist", 0.0), 0, 1000)
    check_range("least_radius", properties.least_radius, 0, 1, "m")
    if not 10 <= (density := properties.changes.get("density", 10.0)) <= 5000:
        raise bad_input("density", given=f"{density:g}", allowed="10 to 5000 kg/m3", do="1.05 g/cm3 are 1050 kg/m3.")


def _read_run(folder: Path, properties: Properties) -> tuple[SourcePlant, Skeleton | None, Stem | None, Cloud | None]:
    there = {stage: folder / name for stage, name in FILES.items() if (folder / name).exists()}
    as_scanned = properties.radius is None and not properties.least_radius
    if as_scanned and "plant model" in there:
        model = PlantModel.load(there["plant model"])
        plant = _remove_twist(_from_model(*_change_material(model, properties)), properties)
        skeleton = Skeleton.load(there["skeleton"]) if "skeleton" in there else None
        stem = Stem.load(there["stem"]) if "stem" in there else None
        return plant, skeleton, stem, Cloud.load(there["cloud"]) if "cloud" in there else None
    skeleton, stem = Skeleton.load(kept(folder, "skeleton")), Stem.load(kept(folder, "stem"))
    radius = skeleton.radius if properties.radius is None else np.full(len(skeleton.nodes), properties.radius)
    skeleton = replace(skeleton, radius=np.maximum(radius, properties.least_radius))
    cloud = Cloud.load(there["cloud"]) if "cloud" in there else None
    flowers = Flowers.load(there["flowers"]) if "flowers" in there else Flowers(np.zeros((0, 3)), np.zeros(0, np.int64))
    return _model(skeleton, stem, flowers, cloud, properties), skeleton, stem, cloud


def _change_material(model: PlantModel, properties: Properties) -> tuple[PlantModel, str]:
    material, origin = properties.of(model.material)
    return (model if material is model.material else model.with_material(material)), origin


def _model(
    skeleton: Skeleton, stem: Stem, flowers: Flowers, cloud: Cloud | None, properties: Properties
) -> SourcePlant:
    """Return the plant model; a Young's modulus that is not given is raised where the plant would not stand."""
    material, origin = properties.of()
    given = "youngs" in properties.changes
    model = plant_with_flowers(skeleton, stem, flowers, cloud, PRIORS[properties.species] if given else material)
    if given:
        return _remove_twist(_from_model(model.with_material(material), origin), properties)
    if model.material.youngs > material.youngs:
        origin = f"raised from {material.youngs / 1e6:.3g} MPa, {origin}: with less it would not stand"
    return _remove_twist(_from_model(model, origin), properties)


def _from_model(model: PlantModel, origin: str) -> SourcePlant:
    numbers = np.arange(len(model.rods.nodes))
    for j in np.flatnonzero(model.is_pedicel):
        numbers[j] = numbers[model.rods.parent[j]]
    return SourcePlant(
        model.rods,
        numbers,
        model.material.damping_ratio,
        model.stem_nodes,
        model.flower_nodes,
        f"E {model.material.youngs / 1e6:.3g} MPa ({origin})",
        model,
        notes=model.notes,
    )


def _remove_twist(plant: SourcePlant, properties: Properties) -> SourcePlant:
    """Return the plant without twist where that was asked for."""
    if properties.changes.get("bend_over_twist") != 0:
        return plant
    return replace(plant, rods=_at_rest(replace(plant.rods, bend_over_twist=0.0, natural=None)))


def _bare(
    source: SkeletonFile, skeleton: Skeleton, stem: Stem | None, properties: Properties, flowers: NDArray[Any]
) -> SourcePlant:
    material, origin = properties.of()
    rods = Rods(
        nodes=skeleton.nodes,
        parent=skeleton.parent,
        edge_radius=np.maximum(0.5 * (skeleton.radius + skeleton.radius[skeleton.parent]), properties.least_radius),
        youngs=material.youngs,
        density=material.density,
        bend_over_twist=properties.changes.get("bend_over_twist", material.bend_over_twist),
    )
    words = f"E {material.youngs / 1e6:.3g} MPa ({origin})"
    nodes, notes = (np.zeros(0, np.int64), ()) if stem is None else (stem.node_ids, stem.notes)
    notes = (*source.notes, *notes)
    zeta = properties.changes.get("damping_ratio", material.damping_ratio)
    return SourcePlant(rods, source.numbers, zeta, nodes, flowers, words, None, source.merged, notes)


def _at_rest(rods: Rods) -> Rods:
    """Return the rods with the natural shape for which the scanned shape hangs still under gravity.

    Raises:
        StageFailure: it would buckle under its own weight; the message states the stiffness that would hold it.
    """
    clamp = Clamp.root(rods)
    if (held := standing(rods, clamp)) is not None:
        return held
    youngs, usual = float(np.asarray(rods.youngs)[1]), TOMATO.youngs  # sought from there, however far off is given
    factor = least_stiffness(replace(rods, youngs=usual / youngs * np.asarray(rods.youngs)), clamp)
    enough = "no stiffness helps" if factor is None else f"it would stand from E = {factor * usual:.3g} Pa"
    why = f"with E = {youngs:g} Pa and these radii the plant buckles under its own weight"
    do = "Give --youngs (in Pa: 100 MPa is 100e6), --radius, --least-radius or --density other values."
    raise StageFailure("no_convergence", f"{why} ({1e3 * rods.node_mass.sum():.3g} g); {enough}. {do}")


def held_nodes(plant: SourcePlant, grip: int, pads: float) -> tuple[int, ...]:
    """Return the nodes that a grip moves alike: `grip`, then those within half the pads' length [m] along the stem.

    Pads of 0 hold the grip node alone; pads shorter than the node spacing still hold one neighbour, because two nodes
    are what holds a direction. Upward the stem is taken to be the child that carries most nodes.
    """
    check_range("pads", pads, 0, 1, "m")
    if pads == 0:
        return (grip,)
    parent, clamped, distance = plant.rods.parent, plant.clamp.nodes, plant.distances()
    carried = np.ones(len(parent), dtype=np.int64)
    for j in range(len(parent) - 1, 0, -1):
        carried[parent[j]] += carried[j]
    below, above, node = list[int](), list[int](), grip
    while (node := int(parent[node])) >= 0 and node not in clamped:
        below.append(node)
    node = grip
    while len(children := np.setdiff1d(np.flatnonzero(parent == node), clamped)):
        node = int(children[np.argmax(carried[children])])
        above.append(node)
    away = np.abs(distance - distance[grip])
    near = [node for node in (*below, *above) if away[node] <= pads / 2 * (1 + 1e-9)]
    return (grip, *(near or (above or below)[:1]))
