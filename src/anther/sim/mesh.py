"""Triangle meshes of plant organs, pots and benches: plain functions that return vertices and faces. Lengths in m."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from trimesh.util import append_faces

from anther.core.geometry import Array

Mesh = tuple[Array, NDArray[np.int32]]


def unit(v: ArrayLike) -> Array:
    """Return v scaled to length 1 along its last axis."""
    a = np.asarray(v, dtype=np.float64)
    return a / np.linalg.norm(a, axis=-1, keepdims=True)


def grid_faces(rows: int, columns: int, *, closed: bool) -> NDArray[np.int32]:
    """Return the faces of a rows x columns grid of vertices, row by row; closed joins last and first column."""
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns if closed else columns - 1), indexing="ij")
    a, b = i * columns + j, i * columns + (j + 1) % columns
    c, d = a + columns, b + columns
    lower = np.stack([a, b, d], axis=-1).reshape(-1, 3)
    upper = np.stack([a, d, c], axis=-1).reshape(-1, 3)
    return np.vstack([lower, upper]).astype(np.int32)


def tangents(points: Array) -> Array:
    """Return (n, 3) unit tangents of a polyline (n, 3): the bisector at inner points."""
    steps = unit(np.diff(points, axis=0))
    return unit(np.vstack([steps[:1], steps[:-1] + steps[1:], steps[-1:]]))


def transport(points: Array, first: ArrayLike) -> Array:
    """Return (n, 3) unit normals along a polyline, `first` carried on without twist (parallel transport)."""
    t = tangents(points)
    normals = [unit(first - t[0] * np.dot(first, t[0]))]
    for axis in t[1:]:
        carried = normals[-1] - axis * np.dot(normals[-1], axis)
        normals.append(unit(carried))
    return np.array(normals)


def tube(points: Array, radii: ArrayLike, *, sides: int = 8, tip: bool = True) -> Mesh:
    """Return a tube along a polyline (n, 3) with one ring of `sides` vertices per point, and a closing tip vertex."""
    t = tangents(points)
    first = unit(points[1] - points[0])
    n1 = transport(points, unit(np.cross(first, [0, 0, 1.0] if abs(first[2]) < 0.9 else [1.0, 0, 0])))
    n2 = np.cross(t, n1)
    angle = np.arange(sides) * 2 * np.pi / sides
    around = np.cos(angle)[:, None] * n1[:, None] + np.sin(angle)[:, None] * n2[:, None]
    rings = points[:, None] + np.asarray(radii, dtype=np.float64)[:, None, None] * around
    vertices, faces = rings.reshape(-1, 3), grid_faces(len(points), sides, closed=True)
    if not tip:
        return vertices, faces
    last, k = (len(points) - 1) * sides, np.arange(sides)
    cap = np.stack([last + k, last + (k + 1) % sides, np.full(sides, len(vertices))], axis=1)
    return np.vstack([vertices, points[-1:]]), np.vstack([faces, cap]).astype(np.int32)


def blade(midrib: Array, side: Array, half_width: ArrayLike, *, fold: float, ripple: Array | None = None) -> Mesh:
    """Return a leaf blade without thickness: 2h+1 vertices across at each of n points of the midrib.

    Args:
        midrib: (n, 3) points from base to tip.
        side: (n, 3) unit vectors across the blade.
        half_width: (n,) half widths.
        fold: angle by which each half rises from flat [rad]; negative droops.
        ripple: (n, 2h+1) offsets along the blade's normal; its width sets h (default 2, flat).
    """
    ripple = np.zeros((len(midrib), 5)) if ripple is None else ripple
    half = ripple.shape[1] // 2
    normal = unit(np.cross(side, tangents(midrib)))
    across = np.linspace(-1, 1, 2 * half + 1)
    w = np.asarray(half_width, dtype=np.float64)[:, None, None]
    sideways = w * np.cos(fold) * across[None, :, None] * side[:, None]
    rise = (w[..., 0] * np.sin(fold) * np.abs(across)[None] + ripple)[..., None] * normal[:, None]
    vertices = midrib[:, None] + sideways + rise
    return vertices.reshape(-1, 3), grid_faces(len(midrib), 2 * half + 1, closed=False)


def revolve(profile: ArrayLike, *, sides: int = 40) -> Mesh:
    """Return the surface of revolution about z of a profile (n, 2) of radius and height."""
    r, z = np.asarray(profile, dtype=np.float64).T
    a = np.arange(sides) * 2 * np.pi / sides
    ring = np.stack([np.cos(a), np.sin(a), np.zeros(sides)], axis=1)
    vertices = r[:, None, None] * ring + z[:, None, None] * np.array([0, 0, 1.0])
    return vertices.reshape(-1, 3), grid_faces(len(r), sides, closed=True)


def box(lower: ArrayLike, upper: ArrayLike) -> Mesh:
    """Return an axis-aligned box; every side has its own vertices, so its edges stay sharp."""
    lo, hi = np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)
    vertices, faces = [], []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for end in (0.0, 1.0):
            corners = np.zeros((4, 3))
            corners[:, axis], corners[:, u], corners[:, v] = end, [0, 1, 1, 0], [0, 0, 1, 1]
            faces.append(np.array([[0, 1, 2], [0, 2, 3]]) + 4 * len(vertices))
            vertices.append(lo + corners * (hi - lo))
    return np.vstack(vertices), np.vstack(faces).astype(np.int32)


def join(meshes: list[Mesh]) -> Mesh:
    """Return several meshes as one."""
    vertices, faces = append_faces(*zip(*meshes, strict=True))
    return np.asarray(vertices, dtype=np.float64), faces.astype(np.int32)


def star(
    centre: Array, axis: Array, petals: int, radius: float, *, reflex: float, spin: float, slim: float = 1.0
) -> Mesh:
    """Return the mesh of `petals` pointed petals around an axis (the way the flower faces).

    Args:
        centre, axis: (3,) [m], unit.
        petals: how many.
        radius: length of a petal [m].
        reflex: angle by which they bend back towards the stalk: 0 = a flat star, negative = closed [rad].
        spin: angle of the first [rad].
        slim: width factor.
    """
    first = unit(np.cross(axis, [0.3, 0.5, 0.81]))
    second = np.cross(axis, first)
    u = np.linspace(0, 1, 6)
    out = []
    for a in spin + np.arange(petals) * 2 * np.pi / petals:
        radial = np.cos(a) * first + np.sin(a) * second
        across: Array = -np.sin(a) * first + np.cos(a) * second
        angle = reflex * u
        steps = np.cos(angle)[:, None] * radial - np.sin(angle)[:, None] * axis
        midrib = centre + np.vstack([np.zeros(3), np.cumsum(steps[1:] * radius / 5, axis=0)])
        width = slim * radius * 0.36 * np.maximum(np.sin(np.pi * (0.12 + 0.88 * u)), 0.02)
        out.append(blade(midrib, np.tile(across, (len(u), 1)), width, fold=-0.15))
    return join(out)
