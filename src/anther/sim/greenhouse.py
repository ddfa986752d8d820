"""What stands around the plant: a grey bench under the pot, a concrete floor, hazy pale walls some metres off."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.geometry import Array
from anther.sim.mesh import Mesh, box, grid_faces, join
from anther.sim.plant import Organ, Pot

BENCH_SIZE = (0.5, 0.8, 0.04)
"""Of the bench's top [m], centred under the pot."""
FLOOR_Z = -1.25
WALL_DISTANCE = 3.5
WALL_TOP = 2.2
BENCH_GREY, FLOOR_GREY = (150, 152, 154), (176, 172, 165)
HAZE_LOW, HAZE_HIGH = (170, 180, 166), (244, 248, 250)


def surroundings(pot: Pot) -> tuple[Array, NDArray[Any], NDArray[np.uint8], NDArray[np.uint8]]:
    """Return vertices [m], faces, the `Organ` of each face and sRGB vertex colours of bench, floor and walls."""
    rng = np.random.default_rng(7)
    x, y = pot.centre[:2]
    half = np.array(BENCH_SIZE) / 2
    bench = box([x - half[0], y - half[1], pot.bench_z - BENCH_SIZE[2]], [x + half[0], y + half[1], pot.bench_z])
    floor, walls = _floor(x, y), _walls(x, y)
    height = np.clip((walls[0][:, 2:] - FLOOR_Z) / (WALL_TOP - FLOOR_Z) * 1.6 - 0.25, 0, 1)
    haze = (1 - height) * HAZE_LOW + height * HAZE_HIGH + rng.normal(0, 3, (len(walls[0]), 1))
    colours = [np.tile(BENCH_GREY, (len(bench[0]), 1)), FLOOR_GREY + rng.normal(0, 6, (len(floor[0]), 1)), haze]
    vertices, faces = join([bench, floor, walls])
    organ = np.full(len(faces), Organ.SURROUNDINGS, dtype=np.uint8)
    organ[: len(bench[1])] = Organ.BENCH
    return vertices, faces, organ, np.clip(np.vstack(colours), 0, 255).astype(np.uint8)


def _floor(x: float, y: float) -> Mesh:
    u, v = np.meshgrid(np.linspace(-WALL_DISTANCE, WALL_DISTANCE, 29), np.linspace(-WALL_DISTANCE, WALL_DISTANCE, 29))
    vertices = np.stack([x + u, y + v, np.full_like(u, FLOOR_Z)], axis=-1).reshape(-1, 3)
    return vertices, grid_faces(29, 29, closed=False)


def _walls(x: float, y: float) -> Mesh:
    """A round wall of 48 panels: no corner catches the eye, and every view ends in it."""
    angle, z = np.meshgrid(np.arange(48) * 2 * np.pi / 48, np.linspace(FLOOR_Z, WALL_TOP, 9))
    ring = [x + WALL_DISTANCE * np.cos(angle), y + WALL_DISTANCE * np.sin(angle), z]
    return np.stack(ring, axis=-1).reshape(-1, 3), grid_faces(9, 48, closed=True)
