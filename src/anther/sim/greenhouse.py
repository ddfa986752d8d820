"""What stands around the plant: a grey bench under the pot, a concrete floor, hazy pale walls some metres off.

A `Setting` changes the looks of it, adds a stake or other plants behind, and says what light falls on everything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core.geometry import Array
from anther.sim.mesh import Mesh, box, grid_faces, join, tube, unit
from anther.sim.plant import Organ, Pot

RGB = tuple[int, int, int]
Painted = tuple[Mesh, Organ, NDArray[Any]]
"""A mesh, the `Organ` of its faces, and its sRGB colour (3,) or those of its vertices (n, 3)."""
Matrix = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]

WALL_DISTANCE = 3.5
"""Where the walls are [m]."""


@dataclass(frozen=True, slots=True)
class Setting:
    """How the greenhouse looks; the default is daylight and nothing added.

    Attributes:
        light: (3, 3) maps linear light as the renderer has it (red, green, blue) to what the camera's channels take in:
            all below 1 is dim; more red and less blue is a lamp to a camera balanced for daylight.
        sun: whether the sun shines, with its shadows.
        pot, soil, bench: sRGB; None keeps the plant's own pot and soil, and grey for the bench.
        stake: whether a bamboo stake stands beside the stem, with a white string up from the pot.
        greenery: whether other plants stand behind, just out of the workspace.
    """

    light: Matrix = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    sun: bool = True
    pot: RGB | None = None
    soil: RGB | None = None
    bench: RGB = (150, 152, 154)
    stake: bool = False
    greenery: bool = False


def surroundings(
    pot: Pot, setting: Setting | None = None
) -> tuple[Array, NDArray[Any], NDArray[np.uint8], NDArray[np.uint8]]:
    """Return vertices [m], faces, the `Organ` of each face and sRGB vertex colours of all that is not plant or pot."""
    setting = setting or Setting()
    rng = np.random.default_rng(7)
    x, y = pot.centre[:2]
    bench = box([x - 0.25, y - 0.4, pot.bench_z - 0.04], [x + 0.25, y + 0.4, pot.bench_z])
    floor_z = -1.25  # m
    parts = [(bench, Organ.BENCH, np.array(setting.bench)), *shell(np.array([x, y, floor_z]), rng)]
    if setting.stake:
        parts.append((_rod(pot, (0.02, 0.015), 0.004, 0.55), Organ.BENCH, np.array((196, 164, 110))))
        parts.append((_rod(pot, (-0.03, 0.03), 0.0012, 0.8), Organ.BENCH, np.array((228, 226, 214))))
    if setting.greenery:
        mesh, green = _neighbours(x, y)
        parts.append((mesh, Organ.SURROUNDINGS, green))
    return joined(parts)


def joined(parts: Sequence[Painted]) -> tuple[Array, NDArray[Any], NDArray[np.uint8], NDArray[np.uint8]]:
    """Return vertices [m], faces, the `Organ` of each face and sRGB vertex colours of several meshes as one."""
    vertices, faces = join([mesh for mesh, _, _ in parts])
    organ = np.concatenate([np.full(len(mesh[1]), organ, dtype=np.uint8) for mesh, organ, _ in parts])
    colours = [np.broadcast_to(colour, mesh[0].shape) for mesh, _, colour in parts]
    return vertices, faces, organ, np.clip(np.vstack(colours), 0, 255).astype(np.uint8)


def shell(middle: Array, rng: np.random.Generator, height: float = 3.45) -> list[Painted]:
    """Return the floor and the hazy walls around a point (3,) on the floor, up to `height` [m] above it."""
    x, y, z = middle
    floor, walls = _floor(x, y, z), _walls(x, y, z, height)
    up = np.clip((walls[0][:, 2:] - z) / height * 1.6 - 0.25, 0, 1)
    haze = (1 - up) * (170, 180, 166) + up * (244, 248, 250) + rng.normal(0, 3, (len(walls[0]), 1))
    return [
        (floor, Organ.SURROUNDINGS, np.array((176, 172, 165)) + rng.normal(0, 6, (len(floor[0]), 1))),
        (walls, Organ.SURROUNDINGS, haze),
    ]


def repainted(face_organ: NDArray[Any], faces: NDArray[Any], colour: NDArray[Any], setting: Setting) -> NDArray[Any]:
    """Return sRGB vertex colours (Nv, 3) with pot and soil as the setting wants them; soil keeps its grain."""
    colour = np.array(colour)
    if setting.pot is not None:
        colour[faces[face_organ == Organ.POT]] = setting.pot
    if setting.soil is not None:
        soil = np.unique(faces[face_organ == Organ.SOIL])
        grain = colour[soil].mean(axis=1, keepdims=True) / max(float(colour[soil].mean()), 1.0)
        colour[soil] = np.clip(np.array(setting.soil) * (0.9 + 0.1 * grain), 0, 255)
    return colour


def _rod(pot: Pot, beside: tuple[float, float], radius: float, height: float) -> Mesh:
    """A straight rod out of the soil, leaning a little, `beside` the pot's axis [m]."""
    foot = pot.centre + np.array([*beside, -0.03])
    rise = np.linspace(0, height + 0.03, 12)[:, None]
    return tube(foot + rise * unit([0.02, -0.03, 1.0]), np.full(12, radius), sides=8)


def _neighbours(x: float, y: float) -> tuple[Mesh, NDArray[Any]]:
    """Leaves of other plants on an arc behind (x, y), as seen from the arm, and their sRGB vertex colours."""
    rng = np.random.default_rng(11)
    count = 2500
    angle, away = rng.uniform(-1.75, 1.75, count), rng.uniform(0.75, 1.3, count)
    centre = np.stack([x + away * np.cos(angle), y + away * np.sin(angle), rng.uniform(-0.55, 0.5, count)], axis=1)
    return leaves_at(centre, rng)


def leaves_at(centre: Array, rng: np.random.Generator) -> tuple[Mesh, NDArray[Any]]:
    """Return a simple leaf about each of (n, 3) points [m], turned at random, and sRGB vertex colours: a backdrop."""
    count = len(centre)
    along = unit(rng.normal(size=(count, 3)))
    across = unit(np.cross(along, rng.normal(size=(count, 3))))
    length, width = rng.uniform(0.03, 0.06, (2, count, 1)) * np.array([[[1.0]], [[0.6]]])
    corners = [centre - length * along, centre + width * across, centre + length * along, centre - width * across]
    vertices = np.stack(corners, axis=1).reshape(-1, 3)
    faces = (4 * np.arange(count)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3).astype(np.int32)
    green = np.array([62, 108, 44]) * rng.uniform(0.7, 1.3, (count, 1))
    return (vertices, faces), np.repeat(green, 4, axis=0)


def _floor(x: float, y: float, z: float) -> Mesh:
    u, v = np.meshgrid(np.linspace(-WALL_DISTANCE, WALL_DISTANCE, 29), np.linspace(-WALL_DISTANCE, WALL_DISTANCE, 29))
    vertices = np.stack([x + u, y + v, np.full_like(u, z)], axis=-1).reshape(-1, 3)
    return vertices, grid_faces(29, 29, closed=False)


def _walls(x: float, y: float, bottom: float, height: float) -> Mesh:
    """A round wall of 48 panels: no corner catches the eye, and every view ends in it."""
    angle, z = np.meshgrid(np.arange(48) * 2 * np.pi / 48, np.linspace(bottom, bottom + height, 9))
    ring = [x + WALL_DISTANCE * np.cos(angle), y + WALL_DISTANCE * np.sin(angle), z]
    return np.stack(ring, axis=-1).reshape(-1, 3), grid_faces(9, 48, closed=True)
