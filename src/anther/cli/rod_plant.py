"""The plant that `shake` and `respond` move: their common options, and rods that stand still under gravity."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from numpy.typing import NDArray

from anther.core.checks import check_range
from anther.core.errors import StageFailure, bad_input
from anther.core.geometry import Array
from anther.core.runs import kept
from anther.perception.formats.skeletons import SkeletonFile, Units
from anther.perception.skeleton import Skeleton
from anther.plant.bench import read_material
from anther.plant.imported import main_stem, node_named, read_source
from anther.plant.limits import Crop
from anther.plant.model import MARGIN, PlantModel
from anther.rods import Clamp, Discretisation, Rods, least_stiffness, stands, with_gravity_equilibrium

AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
USUAL = {"youngs": 100e6, "density": 1100.0, "bend_over_twist": 1.5, "damping_ratio": 0.05}
"""Of a bare skeleton: E of a tomato stem [Pa], the authors' density [kg/m^3], a round bar [-], and zeta [-]."""


DENSITY = (10.0, 5000.0)
"""Allowed [kg/m^3], as in `Material`."""


@dataclass(frozen=True)
class PlantOptions:
    """Attributes: the plant, what it is made of, and what holds it."""

    skeleton: Annotated[Path, tyro.conf.Positional]
    """Skeleton file: the authors' .txt (nodes count from 0), .swc (ids), or Anther's .npz (nodes count from 0); or a
    run folder, whose plant model also has the leaves' mass, pedicels and flowers."""
    _: KW_ONLY
    units: Units | None = None
    """Of a skeleton file: of its lengths; by default what it states, else metres if that makes a plant."""
    radius: float | None = None
    """Radius of every edge [m]. By default the radii in the file; if it has none, as thick as the crop's stem is at its
    base, and thinner with what a node carries."""
    root: str | None = None
    """Of a skeleton file: where the plant stands, a node's number or x,y,z [m]; by default the file's own root, or
    where it begins to rise."""
    stem_tip: str | None = None
    """Of a skeleton file: where the main stem ends, named likewise; by default it is found where it is needed."""
    crop: Crop = "tomato"
    """Whose stem, of a file without radii."""
    least_radius: float = 0.0
    """No edge is thinner than this [m]: a scan shows twigs and midribs thinner than they are."""
    material: Path | None = None
    """What `anther identify` measured (material.json): its values stand in for options that are not given."""
    youngs: float | None = None
    """Young's modulus [Pa]. By default 100e6, or that of the run; pedicels of a run keep their own."""
    density: float | None = None
    """Density [kg/m^3]. By default 1100, or that of the run."""
    bend_over_twist: float | None = None
    """EI / GJ [-]: 1.5 for a round bar of constant volume (the default, unless a run has its own), about 12 for dicot
    petioles; 0: no twist, as in the paper."""
    damping_ratio: float | None = None
    """Share of critical damping. By default 0.05, or that of the run."""
    pads: float = 0.0
    """Length of stem between the gripper's pads [m], which hold its direction too; 0 moves one node, about which the
    stem may turn."""
    discretisation: Discretisation = "consistent"
    """Second order in the edge length, also at forks and kinks; or the paper's formula to the letter."""


@dataclass(frozen=True, slots=True, eq=False)
class RodPlant:
    """A plant as elastic rods without viscosity, of which the soil holds the root. N nodes, S stem nodes, F flowers.

    Attributes:
        numbers: (N,) what the user calls each node.
        damping_ratio: share of critical damping [-].
        stem_nodes: (S,) main stem, root first; None where it is still to be found.
        flower_nodes: (F,) may be empty.
        merged: numbers of nodes of the file that repeat another's point -> the other's number.
        youngs_given: whether anybody said how stiff it is; if not, a plant that buckles is taken to be stiffer.
        notes: what the user should know.
    """

    rods: Rods
    clamp: Clamp
    numbers: NDArray[Any]
    damping_ratio: float
    stem_nodes: NDArray[Any] | None
    flower_nodes: NDArray[Any]
    youngs_given: bool = True
    merged: dict[int, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def node(self, number: int) -> int:
        """Return the index of the node that the user calls `number`."""
        return SkeletonFile(self.rods.nodes, self.rods.parent, None, self.numbers, merged=self.merged).node(number)

    def damped(self, frequency: float) -> Rods:
        """Return the rods with the damping ratio for motion at `frequency` [Hz] (`Rods.viscous_time`)."""
        return replace(self.rods, viscous_time=self.damping_ratio / (np.pi * frequency))

    def distances(self) -> Array:
        """Return (N,) distances from the root along the plant [m]."""
        along = self.rods.lengths.copy()
        for j in range(1, len(along)):
            along[j] += along[self.rods.parent[j]]
        return along


def read_plant(options: PlantOptions) -> RodPlant:
    """Return the plant of a skeleton file or a run folder, in its scanned shape, not yet in equilibrium."""
    check_range("damping_ratio", options.damping_ratio or 0.0, 0, 10)
    check_range("least_radius", options.least_radius, 0, 1, "m")
    check_range("pads", options.pads, 0, 1, "m")
    if options.density is not None and not DENSITY[0] <= options.density <= DENSITY[1]:
        allowed, do = f"{DENSITY[0]:g} to {DENSITY[1]:g} kg/m3", "1.05 g/cm3 are 1050 kg/m3."
        raise bad_input("density", given=f"{options.density:g}", allowed=allowed, do=do)
    if options.youngs is not None:
        check_range("youngs", options.youngs, 1, 1e12, "Pa")
    material = None if options.material is None else read_material(options.material)
    stated = {name: getattr(options, name) for name in USUAL}
    given = {} if material is None else {name: getattr(material, name) for name in USUAL}
    given |= {name: value for name, value in stated.items() if value is not None}
    plant = _of_run(options, given) if options.skeleton.is_dir() else _of_skeleton(options, given)
    rods = replace(plant.rods, discretisation=options.discretisation)
    return replace(plant, rods=rods, clamp=Clamp.root(rods))


def with_stem(plant: RodPlant) -> RodPlant:
    """Return the plant with its main stem, found where nobody named its end."""
    if plant.stem_nodes is not None:
        return plant
    rods = plant.rods
    stem = main_stem(Skeleton(rods.nodes, rods.parent, np.asarray(rods.edge_radius)))
    return replace(plant, stem_nodes=stem.node_ids, notes=(*plant.notes, *stem.notes))


def _of_skeleton(options: PlantOptions, given: dict[str, float]) -> RodPlant:
    source, skeleton = read_source(
        options.skeleton,
        units=options.units,
        radius=options.radius,
        least=options.least_radius,
        root=options.root,
        crop=options.crop,
    )
    tip = None if options.stem_tip is None else source.node(node_named("--stem-tip", options.stem_tip, source))
    stem = None if tip is None else skeleton.path_from_root(tip)
    made, radius = USUAL | given, 0.5 * (skeleton.radius + skeleton.radius[skeleton.parent])
    rods = Rods(
        nodes=skeleton.nodes,
        parent=skeleton.parent,
        edge_radius=np.maximum(radius, options.least_radius),
        youngs=made["youngs"],
        density=made["density"],
        bend_over_twist=made["bend_over_twist"],
    )
    nowhere = np.zeros(0, np.int64)
    return RodPlant(
        rods,
        Clamp.root(rods),
        source.numbers,
        made["damping_ratio"],
        stem,
        nowhere,
        youngs_given="youngs" in given,
        merged=source.merged,
        notes=source.notes,
    )


def _of_run(options: PlantOptions, given: dict[str, float]) -> RodPlant:
    """Return the plant model of a run; its pedicels keep their own radius and stiffness."""
    if any(given is not None for given in (options.root, options.stem_tip, options.units)):
        raise bad_input(
            "--root, --stem-tip or --units", given="with a run folder", allowed="skeleton files", do="Leave it out."
        )
    model = PlantModel.load(kept(options.skeleton, "plant model"))
    made, rods, stalk = model.material, model.rods, model.is_pedicel
    radius = np.maximum(rods.edge_radius if options.radius is None else options.radius, options.least_radius)
    rods = replace(
        rods,
        edge_radius=np.where(stalk, rods.edge_radius, radius),
        youngs=np.where(stalk, rods.youngs, given.get("youngs", rods.youngs)),
        density=given.get("density", rods.density),
        bend_over_twist=given.get("bend_over_twist", made.bend_over_twist),
        natural=None,
    )
    zeta = given.get("damping_ratio", made.damping_ratio)
    return RodPlant(rods, model.clamp, np.arange(len(rods.nodes)), zeta, model.stem_nodes, model.flower_nodes)


def hanging(plant: RodPlant, name: object) -> RodPlant:
    """Return the plant with the natural shape for which its scanned shape hangs still under gravity.

    A real plant stands: where nobody gave Young's modulus and the usual one is too small, it is raised as
    `build_plant` does, and a note says so.

    Raises:
        StageFailure: it would buckle under its own weight; the message tells the stiffness that would hold it.
    """
    rods, clamp, notes = plant.rods, plant.clamp, plant.notes
    if not stands(rods, clamp):
        youngs, grams = float(np.asarray(rods.youngs)[1]), 1e3 * rods.node_mass.sum()
        usual = USUAL["youngs"] / youngs  # sought from there, however far off the given one is
        factor = least_stiffness(replace(rods, youngs=usual * np.asarray(rods.youngs)), clamp)
        factor = None if factor is None else usual * factor
        if factor is None or plant.youngs_given:
            enough = "no stiffness helps" if factor is None else f"it would stand from E = {factor * youngs:.3g} Pa"
            why = f"with E = {youngs:g} Pa and these radii the plant buckles under its own weight ({grams:.3g} g)"
            do = "Give --youngs (in Pa: 100 MPa is 100e6), --radius, --least-radius or --density other values."
            raise StageFailure("no_convergence", f"{name}: {why}; {enough}. {do}")
        before, least, after = (f"{share * youngs / 1e6:.3g}" for share in (1, factor, MARGIN * factor))
        rods = replace(rods, youngs=MARGIN * factor * np.asarray(rods.youngs))
        notes += (
            f"Young's modulus was not given; raised from {before} to {after} MPa: below {least} MPa the plant would "
            "buckle under its own weight. That much is often a sign of radii too small: see --least-radius, --youngs.",
        )
    return replace(plant, rods=with_gravity_equilibrium(rods, clamp), notes=notes)


def held_nodes(plant: RodPlant, grip: int, pads: float) -> tuple[int, ...]:
    """Return the nodes that a grip moves alike: `grip`, then those within half the pads' length [m] along the stem.

    Pads of 0 hold the grip node alone; pads shorter than the node spacing still hold one neighbour, because two nodes
    are what holds a direction. Upward the stem is taken to be the child that carries most nodes.
    """
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
