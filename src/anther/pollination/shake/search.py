"""The linear search behind a shake plan: response of every scenario at every grip, direction and frequency.

M scenarios, Q frequencies, G grip nodes, D directions, F flowers, N rod nodes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy  # loads `scipy.stats`, which takes long, where it is used
from numpy.typing import NDArray
from scipy.sparse import vstack

from anther.core.compiling import compiled, read_only
from anther.core.errors import StageFailure
from anther.core.geometry import Array, ComplexArray
from anther.plant.limits import PEAKS
from anther.plant.model import Material, PlantModel
from anther.pollination.decision import Answer
from anther.pollination.shake.observables import branch_of, observables
from anther.pollination.shake.pads import PADS, Pads, friction_force
from anther.rods import Observed, displacements, observed_response


class Gains(NamedTuple):
    """What one metre of grip amplitude does, within linear theory. Leading axes (M, Q, G, D).

    Attributes:
        flower: (M, Q, G, D, F) amplitude of each flower, the semi-major axis of its path, with the material's gain of
            what it moves relative to the grip [m/m].
        stem_strain, joint_strain, base_strain: (M, Q, G, D) largest bending strain of main stem, pedicels and branch
            bases [1/m].
        leaf_load: (M, Q, G, D) largest equivalent acceleration at a branch base [1/s2].
        grip_force: (M, Q, G, D) largest force that friction between pads and stem must bear, what turns and twists the
            stem between them counted in, see `friction_force` [N/m].
    """

    flower: Array
    stem_strain: Array
    joint_strain: Array
    base_strain: Array
    leaf_load: Array
    grip_force: Array

    def answer(self, frequencies: Array) -> Answer:
        """Return what a decision asks for, at frequencies (Q,) [Hz]."""
        omega2 = (2 * np.pi * frequencies[:, None, None, None]) ** 2
        loads = (self.base_strain, self.stem_strain, self.leaf_load, self.grip_force)
        return Answer(omega2 * self.flower, *loads)


class Version(NamedTuple):
    """A plant as it may be, between pads as they may be."""

    plant: PlantModel
    pads: Pads = PADS


def scenarios(
    plant: PlantModel, count: int, seed: int = 0, *, pads: Pads = PADS, branch_spread: float = 0.0
) -> list[Version]:
    """Return plant and pads as believed, and `count` versions of them drawn from the spreads of what is believed.

    Stiffness, damping, EI/GJ, the pedicels' stiffness, the radius (at the same bending stiffness), the gain of the
    response and the pads' two stiffnesses are lognormal and independent, drawn by a scrambled Halton sequence so that
    few draws cover the range evenly. A draw in which the plant would buckle is stiffened until it stands, because it
    stands; one that still cannot (its pedicels are too soft) is left out.

    Args:
        plant: as believed.
        count: of the draws.
        seed: of the draws.
        pads: that hold it.
        branch_spread: standard deviation of ln of what the stiffness of each branch is drawn off besides, one by one.
    """
    versions = (draw_version(plant, pads, z, branch_spread) for z in draw_deviates(plant, count, seed))
    return [Version(plant, pads), *(version for version in versions if version is not None)]


def draw_deviates(plant: PlantModel, count: int, seed: int = 0) -> Array:
    """Return (count, 8 + B) standard normal deviates for `draw_version`, B branches; one more where a string pulls."""
    generator = np.random.default_rng(seed)
    engine = scipy.stats.qmc.MultivariateNormalQMC(
        np.zeros(8), engine=scipy.stats.qmc.Halton(8, rng=generator), rng=generator
    )
    shared = engine.random(count)
    own = len(plant.branch_bases) + (plant.string is not None)
    return np.concatenate([shared, generator.normal(size=(count, own))], axis=1)


def draw_version(plant: PlantModel, pads: Pads, z: Array, branch_spread: float) -> Version | None:
    """Return plant and pads at deviates z (8 + B,), see `draw_deviates`; None if the plant cannot stand.

    They are of `draw_material` (6,), the pads (2,), ln of each branch's stiffness (B,), and ln of the string's tension.
    """
    material, factor = draw_material(plant.material, z[:6], plant.least_youngs), 1.0
    branches = z[8 : 8 + len(plant.branch_bases)]
    tension = 1.0 if plant.string is None else float(np.exp(plant.string.tension_spread * z[8 + len(branches)]))
    if branch_spread:
        own = np.exp(np.append(branch_spread * branches, 0.0))[branch_of(plant)]
        factor = np.where(plant.is_pedicel, 1.0, own)
    for stiffer in 1.25 ** np.arange(8):
        tried = replace(material, youngs=material.youngs * float(stiffer))
        try:
            pedicels = float(np.exp(plant.pedicel_spread * z[3]))
            stands = plant.with_material(tried, edge_factor=factor, pedicel_factor=pedicels, tension_factor=tension)
        except StageFailure:
            continue
        return Version(stands, pads.drawn(z[6:8]))
    return None


def draw_material(material: Material, z: Sequence[float] | Array, least_youngs: float) -> Material:
    """Return the material at standard normal deviates z (6,), stiff enough to stand.

    They are of ln E, ln damping, ln EI/GJ, (the pedicels',) ln radius at the same bending stiffness, and ln gain.
    """
    drawn = replace(
        material,
        youngs=float(np.clip(material.youngs * np.exp(material.youngs_spread * z[0]), 1.1 * least_youngs, 1e11)),
        damping_ratio=float(np.clip(material.damping_ratio * np.exp(material.damping_spread * z[1]), 1e-3, 0.9)),
        bend_over_twist=float(np.clip(material.bend_over_twist * np.exp(material.twist_spread * z[2]), 0.2, 500)),
    )
    return drawn.changed(
        radius_scale=material.radius_scale * float(np.exp(material.radius_spread * z[4])),
        response_gain=material.response_gain * float(np.exp(material.response_spread * z[5])),
    )


def gains(versions: Sequence[Version], grips: Sequence[NDArray[Any]], directions: Array, frequencies: Array) -> Gains:
    """Return the linear response of every scenario.

    Args:
        versions: M scenarios of one plant and its pads.
        grips: G lists of the rod nodes between the pads, see `pad_nodes`.
        directions: (G, D, 3) unit shake directions at each grip.
        frequencies: (Q,) [Hz].
    """
    parts = [_gains_of(version, grips, directions, frequencies) for version in versions]
    return Gains(*(np.stack(a) for a in zip(*parts, strict=True)))


def _gains_of(
    version: Version, grips: Sequence[NDArray[Any]], directions: Array, frequencies: Array
) -> tuple[Array, ...]:
    """Return the gains of one scenario."""
    plant = version.plant
    moved, pads = motions(version, grips, frequencies)
    flowers = _sizes(_flower_motion(plant, grips, moved["flowers"], pads), directions)
    sizes = {kind: _sizes(moved[kind], directions) for kind in PEAKS}
    largest = (size.max(axis=-1, initial=0.0) for size in sizes.values())
    wrench = np.moveaxis(_sizes(moved["grip_force"], directions), -1, 0)
    borne = friction_force(*wrench, radius=held_radius(plant, grips)[:, None], width=version.pads.width)
    return flowers, *largest, borne


def motions(
    version: Version,
    grips: Sequence[NDArray[Any]],
    frequencies: Array,
    like: PlantModel | None = None,
    points: Sequence[int] | NDArray[np.int64] = (),
) -> tuple[dict[str, ComplexArray], ComplexArray]:
    """Return what one metre of gripper motion along each axis does, (Q, G, K, 3, 3) by kind, and to the pads.

    Without the material's gain. "flowers" and "points" [m/m]; of `PEAKS` what their length is the load of [1/m,
    leaves 1/s2], of the grip its force, pivoting moment and twist, as `friction_force` takes them [N/m, N].

    Args:
        version: one scenario.
        grips: G lists of the rod nodes between the pads, see `pad_nodes`.
        frequencies: (Q,) [Hz].
        like: see `observables`.
        points: (P,) rod nodes that are observed too.
    """
    rods, seen = version.plant.rods, observables(version.plant, like)
    operator = vstack([seen.operator, displacements(np.asarray(points, dtype=np.int64), len(rods.nodes))], format="csr")
    response = _solve_response(version, grips, operator, frequencies)
    moved, held = response.vectors, np.array([grip[0] for grip in grips])
    stem = rods.nodes[held] - rods.nodes[rods.parent[held]]
    stem /= np.linalg.norm(stem, axis=1, keepdims=True)
    twist = stem[:, :, None] * stem[:, None] @ response.moment
    parts = {"flowers": moved[:, :, seen.flowers], "points": moved[:, :, moved.shape[2] - len(points) :]}
    parts |= {kind: moved[:, :, getattr(seen, kind)] for kind in PEAKS}
    parts["leaf_load"] = (2 * np.pi * frequencies[:, None, None, None, None]) ** 2 * parts["leaf_load"]
    parts["grip_force"] = np.stack([response.force, response.moment - twist, twist], axis=2)
    return parts, response.pads


def held_radius(plant: PlantModel, grips: Sequence[NDArray[Any]]) -> Array:
    """Return (G,) the stem's radius between the pads [m]."""
    return np.asarray(plant.rods.edge_radius)[[grip[0] for grip in grips]]


class Phasors(NamedTuple):
    """What one metre of gripper motion along one direction does, as phasors. S points of the main stem.

    Attributes:
        flowers: (Q, G, F, 3) [m/m], with the material's gain.
        stem: (Q, G, S, 3) [m/m].
        force: (Q, G, 3) of the grip on the stem [N/m].
    """

    flowers: ComplexArray
    stem: ComplexArray
    force: ComplexArray


def answer(
    version: Version,
    grips: Sequence[NDArray[Any]],
    direction: Array,
    frequencies: Array,
    stem: Sequence[int] | NDArray[Any] = (),
) -> Phasors:
    """Return the linear answer of one scenario.

    Args:
        version: one scenario.
        grips: G lists of the rod nodes between the pads, see `pad_nodes`.
        direction: (3,) of the shake.
        frequencies: (Q,) [Hz].
        stem: (S,) rod nodes that are observed beside the flowers.
    """
    plant = version.plant
    nodes, count = np.concatenate([plant.flower_nodes, np.asarray(stem, dtype=np.int64)]), len(plant.flower_nodes)
    response = _solve_response(version, grips, displacements(nodes, len(plant.rods.nodes)), frequencies)
    flowers = _flower_motion(plant, grips, response.vectors[:, :, :count], response.pads)
    return Phasors(flowers @ direction, response.vectors[:, :, count:] @ direction, response.force @ direction)


def _solve_response(version: Version, grips: Sequence[NDArray[Any]], operator: Any, frequencies: Array) -> Observed:
    """Return what an operator sees of one scenario. The damping ratio is the same at every frequency (hysteretic)."""
    plant, loss = version.plant, 2 * version.plant.material.damping_ratio
    springs = version.pads.springs
    return observed_response(plant.rods, plant.clamp, grips, operator, frequencies, loss_factor=loss, springs=springs)


def _flower_motion(plant: PlantModel, grips: Sequence[NDArray[Any]], vectors: ComplexArray, pads: ComplexArray) -> Any:
    """Return flowers' motion (Q, G, F, 3, 3) per axis of the shake, with the gain of what they do relative to the pads.

    Far below resonance a plant is carried along by the pads (Q, G, 6, 3) as one body, turned with them.
    """
    nodes = plant.rods.nodes
    lever = nodes[plant.flower_nodes] - nodes[[grip[0] for grip in grips]][:, None]
    turned = np.cross(pads[:, :, None, 3:], lever[None, ..., None], axisa=3, axisb=3, axisc=3)
    carried = pads[:, :, None, :3] + turned
    return carried + plant.material.response_gain * (vectors - carried)


def _sizes(vectors: ComplexArray, directions: Array) -> Array:
    """Return (Q, G, D, K) the `semi_major` of V d for V (Q, G, K, 3, 3) and directions d (G, D, 3)."""
    sizes = np.empty((*vectors.shape[:3], directions.shape[1]))
    _fill_sizes(read_only(vectors), read_only(np.swapaxes(directions, 1, 2)), sizes)
    return np.swapaxes(sizes, 2, 3)


@compiled
def _fill_sizes(vectors: Any, directions: Any, sizes: Any) -> None:
    """Fill (Q, G, K, D) for directions (G, 3, D): side by side, which the vector units take at once."""
    for q in range(len(sizes)):
        for g in range(sizes.shape[1]):
            x, y, z = directions[g, 0], directions[g, 1], directions[g, 2]
            for k in range(sizes.shape[2]):
                v, out = vectors[q, g, k], sizes[q, g, k]
                for d in range(sizes.shape[3]):
                    a = v[0, 0] * x[d] + v[0, 1] * y[d] + v[0, 2] * z[d]
                    b = v[1, 0] * x[d] + v[1, 1] * y[d] + v[1, 2] * z[d]
                    c = v[2, 0] * x[d] + v[2, 1] * y[d] + v[2, 2] * z[d]
                    square = a.real * a.real + b.real * b.real + c.real * c.real
                    square += a.imag * a.imag + b.imag * b.imag + c.imag * c.imag
                    product = a * a + b * b + c * c
                    size = math.sqrt(product.real * product.real + product.imag * product.imag)
                    out[d] = math.sqrt(0.5 * (square + size))
