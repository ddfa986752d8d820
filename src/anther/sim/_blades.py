"""Leaf blades as things to bump into: thin boxes fitted to the leaves that the camera sees. L boxes, K segments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco as mujoco_module
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from anther.geometry import Array
from anther.sim._plant_mechanics import Pieces
from anther.sim.plant import Organ, SimPlant

mujoco: Any = mujoco_module  # its names come from C++ at run time; type checkers do not see them

PIECE = 0.03
"""Longest box along a blade [m]."""
THICKNESS = 0.002
"""Of a box [m]: a blade's 0.25 mm and its ripples. An estimate."""
GIVE = 0.2
"""Time constant of a blade's contact [s]. A blade is a membrane that bends away: a strip of it 40 mm long and wide,
0.25 mm thick, of 75 MPa, is a spring of 0.2 N/m at its end, its midrib (0.7 mm) one of 0.7 N/m (3 E I / L^3). With this
constant fingers that go through three grown plants press into blades with 0.5-2 N/m in the median (measured; with
0.03 s 8-16 N/m). What presses harder passes through, as between the pads. There is no friction: a leaf slides off."""


@dataclass(frozen=True, slots=True, eq=False)
class Blades:
    """Attributes: segment (L,) each box rides on; centre (L, 3) [m], axes (L, 3, 3) in columns, half (L, 3) [m]."""

    segment: NDArray[Any]
    centre: Array
    axes: Array
    half: Array


def blades_of(plant: SimPlant) -> Blades:
    """Return boxes around pieces of every leaf blade of the mesh, at most `PIECE` long."""
    faces = plant.faces[plant.face_organ == Organ.LEAF]
    of_leaf = np.unique(faces)
    if len(of_leaf) == 0:
        return Blades(np.zeros(0, dtype=int), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)))
    count = len(plant.vertices)
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    leaf = connected_components(coo_matrix((np.ones(len(edges)), edges.T), (count, count)), directed=False)[1]
    group = np.unique(np.stack([leaf[of_leaf], plant.vertex_segment[of_leaf]]), axis=1, return_inverse=True)[1]
    rows: list[tuple[int, Array, Array, Array]] = []
    for g in range(group.max() + 1):
        members = of_leaf[group == g]
        segment, points = int(plant.vertex_segment[members[0]]), plant.vertices[members]
        rows += [(segment, *_box(piece)) for piece in _pieces(points)]
    segments, centre, axes, half = zip(*rows, strict=True)
    return Blades(np.array(segments), np.array(centre), np.array(axes), np.array(half))


def add_blades(spec: Any, plant: SimPlant, pieces: Pieces, *, contype: int, conaffinity: int) -> None:
    """Add the blades as boxes `blade_<i>_<segment>` without mass to the bodies that `plant_mechanics.add_plant` made.

    Their mass is the segments' lumps. Contact with them is soft (`GIVE`), whatever touches.

    Args:
        spec: the world.
        plant: the truth.
        pieces: how it was cut.
        contype, conaffinity: MuJoCo's collision bits.
    """
    blades = blades_of(plant)
    for i, k in enumerate(blades.segment):
        b = pieces.body[k]
        spec.body(f"plant_{b}").add_geom(
            name=f"blade_{i}_{k}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=blades.centre[i] - plant.start[pieces.first[b]],
            quat=Rotation.from_matrix(blades.axes[i]).as_quat(scalar_first=True),
            size=blades.half[i],
            mass=0,
            contype=contype,
            conaffinity=conaffinity,
            condim=1,
            priority=2,
            solref=[GIVE, 1.0],
            solimp=[0.5, 0.9, 0.005, 0.5, 2],
            group=2,
        )


def _pieces(points: Array) -> list[Array]:
    """Cut points (n, 3) across their longest extent into runs of at most `PIECE`; runs of fewer than four are left."""
    centred = points - points.mean(axis=0)
    along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
    count = max(int(np.ceil(np.ptp(along) / PIECE)), 1)
    run = np.minimum(((along - along.min()) / max(np.ptp(along), 1e-9) * count).astype(int), count - 1)
    return [points[run == i] for i in range(count) if np.sum(run == i) >= 4]


def _box(points: Array) -> tuple[Array, Array, Array]:
    """Return centre (3,), axes (3, 3) in columns and half extents (3,) of the box about points (n, 3)."""
    mean = points.mean(axis=0)
    axes = np.linalg.svd(points - mean, full_matrices=False)[2].T
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    local = (points - mean) @ axes
    half = np.ptp(local, axis=0) / 2
    centre = mean + axes @ (local.min(axis=0) + half)
    return centre, axes, np.array([half[0], half[1], THICKNESS / 2])
