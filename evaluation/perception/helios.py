"""Plants of Helios (Bailey 2019; pip install 'anther[evaluation]'), a generator that shares nothing with Anther's own.

Triangles with exact organ labels, and the stem's own nodes and radii. It sets no constant.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from anther.core.errors import MissingExtra
from evaluation.perception.scene_plants import OTHER, PETAL, STEM, Grown

Model = Literal["tomato", "cherrytomato", "capsicum"]
AGE: dict[Model, tuple[float, float]] = {"tomato": (30.0, 50.0), "cherrytomato": (35.0, 60.0), "capsicum": (45.0, 70.0)}
"""Days between which a plant is drawn: 0.3-0.9 m tall, as those that a robot shakes."""
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
    corners, organ = np.concatenate(parts), np.repeat(list(ORGANS.values()), [len(part) for part in parts])
    side = (organ == STEM) & ~_along(corners.mean(axis=1), stem, radius)  # side shoots are no main stem
    return Grown(f"{model}-{seed}", corners, np.where(side, OTHER, organ), stem, radius)


def _triangles(context: Any, objects: list[int]) -> NDArray[Any]:
    """Return the triangles (F, 3, 3) [m] of some objects, four-cornered patches as two."""
    uuids = context.getObjectPrimitiveUUIDs(objects) if objects else []
    if not uuids:
        return np.zeros((0, 3, 3))
    flat, offsets = context.getPrimitiveVertices(list(uuids))
    vertices, first = np.asarray(flat, dtype=float).reshape(-1, 3), np.asarray(offsets, dtype=int)
    first = first // 3  # offsets count numbers, not corners
    start, square = first[:-1], first[:-1][np.diff(first) == 4]
    faces = np.vstack([start[:, None] + [0, 1, 2], square[:, None] + [0, 2, 3]])
    return vertices[faces]


def _along(points: NDArray[Any], stem: NDArray[Any], radius: NDArray[Any]) -> NDArray[np.bool_]:
    """Return (N,) which points lie within one and a half radii of a stem's nodes (S, 3) and the lines between them."""
    a, b = stem[:-1], stem[1:]
    along = np.einsum("nsx,sx->ns", points[:, None] - a, b - a) / np.maximum(np.sum((b - a) ** 2, axis=1), 1e-12)
    at = a + np.clip(along, 0, 1)[..., None] * (b - a)
    return (np.linalg.norm(points[:, None] - at, axis=2) <= 1.5 * radius[:-1] + 1e-4).any(axis=1)
