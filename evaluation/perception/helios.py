"""Plants of Helios (Bailey 2019; pip install 'anther[evaluation]'), a generator that shares nothing with Anther's own.

Triangles with exact organ labels, and the stem's own nodes and radii. For tests and evaluation; no constant is set by it.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from anther.core.errors import MissingExtra
from evaluation.perception.scene_plants import OTHER, STEM, Grown

Model = Literal["tomato", "cherrytomato", "capsicum"]
AGE: dict[Model, tuple[float, float]] = {"tomato": (30.0, 50.0), "cherrytomato": (35.0, 60.0), "capsicum": (45.0, 70.0)}
"""Days between which a plant is drawn: 0.3-0.9 m tall, as those that a robot shakes."""
ORGANS = ("Internode", "Petiole", "Leaf", "Peduncle", "Flower", "Fruit")


def grow_helios(model: Model, seed: int, age: float | None = None) -> Grown:
    """Return a plant whose stem leaves the soil at the origin, z up.

    Args:
        model: of Helios's library.
        seed: of everything that is drawn.
        age: [days]; None: drawn.

    Raises:
        MissingExtra: pyhelios3d is not installed.
    """
    try:
        from pyhelios import Context, PlantArchitecture  # noqa: PLC0415
        from pyhelios.types import vec3  # noqa: PLC0415
    except ImportError as error:
        raise MissingExtra(
            "this needs pyhelios3d, which is not installed. Run: pip install 'anther[evaluation]'"
        ) from error
    days = float(np.random.default_rng(seed).uniform(*AGE[model])) if age is None else age
    with Context() as context:
        context.seedRandomGenerator(seed)
        with PlantArchitecture(context) as plants:
            plants.disableMessages()
            plants.loadPlantModelFromLibrary(model)
            plant = plants.buildPlantInstanceFromLibrary(vec3(0, 0, 0), days)
            shoots = plants.getAllShootIDs(plant)
            main = next(shoot for shoot in shoots if plants.getShootRank(plant, shoot) == 0)
            stem = np.array([tuple(node) for node in plants.getShootInternodeVertices(plant, main)])
            radius = np.array(plants.getShootInternodeRadii(plant, main))
            parts = [_triangles(context, getattr(plants, f"getPlant{organ}ObjectIDs")(plant)) for organ in ORGANS]
    corners = np.concatenate([part[0] for part in parts])
    colour = np.concatenate([part[1] for part in parts])
    organ = np.repeat([STEM] + [OTHER] * (len(ORGANS) - 1), [len(part[0]) for part in parts])
    side = (organ == STEM) & ~_along(corners.mean(axis=1), stem, radius)  # side shoots are no main stem
    return Grown(f"{model}-{seed}", corners, np.where(side, OTHER, organ), colour, stem, radius)


def _triangles(context: Any, objects: list[int]) -> tuple[NDArray[Any], NDArray[np.uint8]]:
    """Return the triangles (F, 3, 3) of some objects, four-cornered patches as two, and their colours (F, 3)."""
    uuids = context.getObjectPrimitiveUUIDs(objects) if objects else []
    if not uuids:
        return np.zeros((0, 3, 3)), np.zeros((0, 3), np.uint8)
    flat, offsets = context.getPrimitiveVertices(list(uuids))
    vertices, first = np.asarray(flat, dtype=float).reshape(-1, 3), np.asarray(offsets, dtype=int)
    first = first // 3 if first[-1] == len(flat) else first
    corners = np.diff(first)
    start, square = first[:-1], first[:-1][corners == 4]
    faces = np.vstack([start[:, None] + [0, 1, 2], square[:, None] + [0, 2, 3]])
    return vertices[faces], np.tile(np.array([70, 120, 50], np.uint8), (len(faces), 1))


def _along(points: NDArray[Any], stem: NDArray[Any], radius: NDArray[Any]) -> NDArray[np.bool_]:
    """Return (N,) which points lie within one and a half radii of a stem's nodes (S, 3) and the lines between them."""
    a, b = stem[:-1], stem[1:]
    along = np.einsum("nsx,sx->ns", points[:, None] - a, b - a) / np.maximum(np.sum((b - a) ** 2, axis=1), 1e-12)
    at = a + np.clip(along, 0, 1)[..., None] * (b - a)
    return (np.linalg.norm(points[:, None] - at, axis=2) <= 1.5 * radius[:-1] + 1e-4).any(axis=1)
