"""Plants of Helios (Bailey 2019; pip install 'anther[evaluation]'), a generator that shares nothing with Anther's own.

`grow_helios`: triangles with exact organ labels, and the stem's own nodes and radii. `train_helios`: a tomato trained
to one stem, organ by organ. It sets no constant.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import KDTree

from anther.core.errors import MissingExtra
from anther.core.geometry import Array
from anther.sim.row_plants import axis_of
from evaluation.perception.scene_plants import OTHER, PETAL, STEM, Grown

Model = Literal["tomato", "cherrytomato", "capsicum"]
AGE: dict[Model, tuple[float, float]] = {"tomato": (30.0, 50.0), "cherrytomato": (35.0, 60.0), "capsicum": (45.0, 70.0)}
"""Days between which a plant is drawn: 0.3-0.9 m tall, as those that a robot shakes."""
SHOWN = 0.5
"""Blades are pictures with transparent corners; a triangle of which more than this share is there is a surface."""
ORGANS = {"Internode": STEM, "Petiole": OTHER, "Leaf": OTHER, "Peduncle": OTHER, "Flower": PETAL, "Fruit": OTHER}
"""What Helios calls the organs, and what a scene calls them."""


def grow_helios(model: Model, seed: int, age: float | None = None) -> Grown:
    """Return a plant whose stem leaves the soil at the origin, z up.

    Args:
        model: of Helios's library.
        seed: of everything that is drawn.
        age: [days]; None: drawn.

    Raises:
        MissingExtra: pyhelios3d is not installed.
    """
    days = float(np.random.default_rng(seed).uniform(*AGE[model])) if age is None else age
    with _sown(model, seed, days) as (context, plants, plant):
        stem, radius = _main_stem(plants, plant)
        parts = [_visible(context, getattr(plants, f"getPlant{organ}ObjectIDs")(plant)) for organ in ORGANS]
    corners, organ = np.concatenate(parts), np.repeat(list(ORGANS.values()), [len(part) for part in parts])
    side = (organ == STEM) & ~_along(corners.mean(axis=1), stem, radius)  # side shoots are no main stem
    return Grown(f"{model}-{seed}", corners, np.where(side, OTHER, organ), stem, radius)


@contextmanager
def _sown(model: Model, seed: int, days: float) -> Iterator[tuple[Any, Any, int]]:
    """Yield Helios's context, its plants, and the number of a plant of this age."""
    try:
        from pyhelios import Context, PlantArchitecture  # noqa: PLC0415
        from pyhelios.types import vec3  # noqa: PLC0415
    except ImportError as error:
        raise MissingExtra(
            "this needs pyhelios3d, which is not installed. Run: pip install 'anther[evaluation]'"
        ) from error
    with Context() as context:
        context.seedRandomGenerator(seed)
        with PlantArchitecture(context) as plants:
            plants.disableMessages()
            plants.loadPlantModelFromLibrary(model)
            yield context, plants, plants.buildPlantInstanceFromLibrary(vec3(0, 0, 0), days)


def _main_stem(plants: Any, plant: int) -> tuple[Array, Array]:
    """Return the main stem's nodes (S, 3) and radii (S,) [m]."""
    shoots = plants.getAllShootIDs(plant)
    main = next(shoot for shoot in shoots if plants.getShootRank(plant, shoot) == 0)
    stem = np.array([tuple(node) for node in plants.getShootInternodeVertices(plant, main)])
    return stem, np.array(plants.getShootInternodeRadii(plant, main))


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A leaflet, a flower or a fruit with its stalk.

    Attributes:
        vertices: (n, 3) [m].
        faces: (m, 3) of them.
        colour: (n, 3) sRGB.
        area: of leaf blade [m2]; Helios cuts blades out of pictures, and what is cut away does not count.
        volume: of a fruit's flesh [m3].
        along: its limb it is borne [m] from the base.
    """

    vertices: Array
    faces: NDArray[np.int32]
    colour: NDArray[np.uint8]
    area: float
    volume: float = 0.0
    along: float = 0.0

    @property
    def middle(self) -> Array:
        """(3,) of what is not green: petals, flesh [m]; Helios's fruit are never green."""
        return self.vertices[self.colour[:, 0] > self.colour[:, 1]].mean(axis=0)


@dataclass(frozen=True, slots=True, eq=False)
class Limb:
    """A stem, petiole or peduncle, a round tube, and what it bears.

    Attributes:
        nodes: (n, 3) of its axis from its base [m].
        radii: (n,) [m].
        colour: (3,) sRGB.
        leaflets, flowers, fruits: each on the limb that it touches.
    """

    nodes: Array
    radii: Array
    colour: Array
    leaflets: tuple[Surface, ...] = ()
    flowers: tuple[Surface, ...] = ()
    fruits: tuple[Surface, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Trained:
    """A tomato of one stem, from the soil at the origin, z up."""

    stem: Limb
    petioles: tuple[Limb, ...]
    peduncles: tuple[Limb, ...]


def train_helios(seed: int, length: float) -> Trained:
    """Return a tomato of Helios (cherrytomato, the one that goes on growing), trained to one stem.

    Its side shoots are taken out each week, as growers do, until the stem is as long as asked and a truss flowers, or
    the plant half a year old: then Helios lets it rest.

    Args:
        seed: of everything that is drawn.
        length: of the stem [m].

    Raises:
        MissingExtra: pyhelios3d is not installed.
    """
    with _sown("cherrytomato", seed, 7.0) as (context, plants, plant):
        for _ in range(25):
            plants.removeShootVegetativeBuds(plant, 0)
            plants.advanceTime(7.0)
            if plants.getPlantStemHeight(plant) > length and plants.getPlantFlowerObjectIDs(plant):
                break
        objects = {organ: list(getattr(plants, f"getPlant{organ}ObjectIDs")(plant)) for organ in ORGANS}
        nodes, radii = _main_stem(plants, plant)
        stem = Limb(nodes, radii, _colours(context, objects["Internode"][0])[0])
        petioles, peduncles = ([_limb(context, k) for k in objects[organ]] for organ in ("Petiole", "Peduncle"))
        leaflets, flowers, fruits = ([_surface(context, k) for k in objects[o]] for o in ("Leaf", "Flower", "Fruit"))
        volumes = [context.getPolymeshObjectVolume(k) for k in objects["Fruit"]]
    fruits = [replace(fruit, volume=volume) for fruit, volume in zip(fruits, volumes, strict=True)]
    fruitful = _bearing(_bearing(peduncles, "flowers", flowers), "fruits", fruits)
    return Trained(stem, tuple(_bearing(petioles, "leaflets", leaflets)), tuple(fruitful))


def _bearing(limbs: Sequence[Limb], kind: str, surfaces: Sequence[Surface]) -> list[Limb]:
    """Return the limbs with surfaces of one kind, each borne where it touches one of them."""
    axes = [axis_of(limb.nodes) for limb in limbs]
    arcs = [np.linspace(0, axis.arc[-1], 100) for axis in axes]
    tree = KDTree(np.concatenate([axis.at(arc) for axis, arc in zip(axes, arcs, strict=True)]))
    found: list[list[Surface]] = [[] for _ in limbs]
    for surface in surfaces:
        gap, point = map(np.asarray, tree.query(surface.vertices))
        limb, place = divmod(int(point[np.argmin(gap)]), 100)
        found[limb].append(replace(surface, along=float(arcs[limb][place])))
    return [replace(limb, **{kind: tuple(borne)}) for limb, borne in zip(limbs, found, strict=True)]


def _visible(context: Any, objects: list[int]) -> NDArray[Any]:
    """Return the triangles (F, 3, 3) [m] of some objects that their pictures do not leave transparent."""
    uuids = np.array(context.getObjectPrimitiveUUIDs(objects) if objects else [], dtype=int)
    solid = np.asarray(context.getPrimitiveSolidFraction(uuids.tolist())) if len(uuids) else np.zeros(0)
    return _triangles(context, uuids[solid > SHOWN].tolist())


def _triangles(context: Any, uuids: list[int]) -> NDArray[Any]:
    """Return the triangles (F, 3, 3) [m] of some primitives, four-cornered patches as two."""
    if not uuids:
        return np.zeros((0, 3, 3))
    flat, offsets = context.getPrimitiveVertices(uuids)
    vertices, first = np.asarray(flat, dtype=float).reshape(-1, 3), np.asarray(offsets, dtype=int)
    first = first // 3  # offsets count numbers, not corners
    start, square = first[:-1], first[:-1][np.diff(first) == 4]
    faces = np.vstack([start[:, None] + [0, 1, 2], square[:, None] + [0, 2, 3]])
    return vertices[faces]


def _limb(context: Any, tube: int) -> Limb:
    nodes = np.array([(node.x, node.y, node.z) for node in context.getTubeObjectNodes(tube)])
    return Limb(nodes, np.array(context.getTubeObjectNodeRadii(tube)), _colours(context, tube)[0])


def _colours(context: Any, part: int) -> NDArray[np.uint8]:
    """Return the colours of an object's triangles (F, 3), sRGB."""
    uuids = list(context.getObjectPrimitiveUUIDs([part]))
    return np.round(255 * np.asarray(context.getPrimitiveColor(uuids))).astype(np.uint8)


def _surface(context: Any, part: int) -> Surface:
    """Return an object's triangles, with the colours of its pictures, without what they leave transparent."""
    uuids = list(context.getObjectPrimitiveUUIDs([part]))
    corners = _triangles(context, uuids)
    colour = np.repeat(_colours(context, part)[:, None], 3, axis=1)
    solid = np.asarray(context.getPrimitiveSolidFraction(uuids))
    files = np.array(context.getPrimitiveTextureFile(uuids))
    pictured = np.flatnonzero(files != "")
    if len(pictured):
        flat, _ = context.getPrimitiveTextureUV([uuids[k] for k in pictured])
        colour[pictured] = _looked_up(str(files[pictured[0]]), np.asarray(flat).reshape(-1, 3, 2))
    area = np.linalg.norm(np.cross(*np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 0)), axis=1) / 2
    shown = solid > SHOWN
    each: Array = np.hstack([corners[shown].reshape(-1, 3), colour[shown].reshape(-1, 3)]).astype(np.float64)
    unique, faces = np.unique(each, axis=0, return_inverse=True)
    return Surface(
        unique[:, :3],
        faces.reshape(-1, 3).astype(np.int32),
        unique[:, 3:].astype(np.uint8),
        float((area * solid)[pictured].sum()),
    )


@cache
def _picture(path: str) -> NDArray[np.uint8]:
    """Return a picture's colours (h, w, 3); what is transparent has the mean colour of the rest."""
    picture = np.array(Image.open(path).convert("RGBA"))
    clear = picture[..., 3] < 128
    picture[clear, :3] = picture[~clear, :3].mean(axis=0)
    return picture[..., :3]


def _looked_up(path: str, uv: Array) -> NDArray[np.uint8]:
    """Return the colours (..., 3) of a picture at places (..., 2), from its lower left corner [-]."""
    picture = _picture(path)
    size = np.array([picture.shape[1], picture.shape[0]]) - 1
    x, y = np.moveaxis(np.round(np.clip([0, 1] + uv * [1, -1], 0, 1) * size).astype(int), -1, 0)
    return picture[y, x]


def _along(points: NDArray[Any], stem: NDArray[Any], radius: NDArray[Any]) -> NDArray[np.bool_]:
    """Return (N,) which points lie within one and a half radii of a stem's nodes (S, 3) and the lines between them."""
    a, b = stem[:-1], stem[1:]
    along = np.einsum("nsx,sx->ns", points[:, None] - a, b - a) / np.maximum(np.sum((b - a) ** 2, axis=1), 1e-12)
    at = a + np.clip(along, 0, 1)[..., None] * (b - a)
    return (np.linalg.norm(points[:, None] - at, axis=2) <= 1.5 * radius[:-1] + 1e-4).any(axis=1)
