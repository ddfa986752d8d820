"""The renderer's inner loops over pixels: where a ray hit, what light falls there, what colour the camera sees.

A simple model that is meant to look right, not to be radiometric: one sun with hard shadows, a bright sky, light from
the ground; leaves and petals let light through. Dimensions: P rays, Nv vertices, Nf faces.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from anther.geometry import Array

SKY_LIGHT = 0.72
"""Light from the whole sky on a level surface; the sun adds SUN_LIGHT. 1 would turn white into full white."""
SUN_LIGHT = 0.72
GROUND_LIGHT = 0.3
"""Light from below, as a share of the sky's."""
TRANSMITTED = 0.45
"""Share of the light on the far side of a leaf or petal that passes through it (an estimate: green leaves transmit
less than they reflect, but with a strong yellow-green tint)."""
SUN = np.array([-0.42, -0.36, 0.83]) / np.linalg.norm([-0.42, -0.36, 0.83])
"""Direction towards the sun in the world: from behind the arm's shoulder."""
OPAQUE, THIN, SUNLESS = 0, 1, 2
"""How a face takes light: from one side, through it as well, or no sun at all (what is far off)."""
_STEPS = 4096
_ENCODED = (np.linspace(0, 1, _STEPS) ** (1 / 2.2) * 255).astype(np.uint8)


def linear(colour: NDArray[Any]) -> NDArray[np.float32]:
    """Return uint8 sRGB as linear light 0-1 (gamma 2.2)."""
    return ((np.asarray(colour, dtype=np.float32) / 255) ** 2.2).astype(np.float32)


def vertex_normals(vertices: NDArray[Any], faces: NDArray[Any]) -> NDArray[np.float32]:
    """Return (Nv, 3) unit normals, the mean of the faces around each vertex weighted by their area."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    face = np.cross(b - a, c - a)
    normal = np.zeros((len(vertices), 3))
    for axis in range(3):
        for corner in range(3):
            normal[:, axis] += np.bincount(faces[:, corner], face[:, axis], len(vertices))
    return (normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-20)).astype(np.float32)


@numba.njit(cache=True, nogil=True, fastmath=True)
def camera_rays(width: int, height: int, pinhole: Array, R: Array, out: NDArray[Any]) -> None:
    """Fill out (height * width, 3) with world directions whose length along the optical axis is 1.

    `pinhole` is fx, fy, cx, cy; `R` the rotation of T_world_cam.
    """
    fx, fy, cx, cy = pinhole
    for row in range(height):
        y = (row - cy) / fy
        for column in range(width):
            x = (column - cx) / fx
            i = row * width + column
            for axis in range(3):
                out[i, axis] = R[axis, 0] * x + R[axis, 1] * y + R[axis, 2]


@numba.njit(cache=True, nogil=True, fastmath=True)
def shadow_origins(
    eye: Array, rays: NDArray[Any], hit: tuple[NDArray[Any], NDArray[Any], NDArray[Any]], kind: NDArray[Any]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return pixel numbers (Q,) that could be in the sun and points (Q, 3) just off their surface.

    `hit` is depth (P,), face (P,) and the face's normal (P, 3) of any length and sign; `kind` (Nf,) is OPAQUE, THIN or
    SUNLESS.
    """
    depth, face, normal = hit
    pixels = np.empty(len(depth), np.int32)
    origins = np.empty((len(depth), 3), np.float32)
    count = 0
    for i in range(len(depth)):
        if face[i] < 0 or kind[face[i]] == SUNLESS:
            continue
        n = normal[i]
        size = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        to_sun = n[0] * SUN[0] + n[1] * SUN[1] + n[2] * SUN[2]
        to_eye = -(n[0] * rays[i, 0] + n[1] * rays[i, 1] + n[2] * rays[i, 2])
        if to_sun * to_eye <= 0 and kind[face[i]] == OPAQUE:
            continue
        off = 2e-4 / size if to_sun > 0 else -2e-4 / size
        for axis in range(3):
            origins[count, axis] = eye[axis] + rays[i, axis] * depth[i] + off * n[axis]
        pixels[count] = i
        count += 1
    return pixels[:count], origins[:count]


@numba.njit(cache=True, nogil=True, fastmath=True)
def shade(
    rays: NDArray[Any],
    hit: tuple[NDArray[Any], NDArray[Any], NDArray[Any]],
    sunlit: NDArray[Any],
    mesh: tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]],
    mix: Array,
    out: NDArray[Any],
) -> None:
    """Fill out (P, 3) uint8 sRGB.

    Args:
        rays: (P, 3) directions.
        hit: face (P,) that was hit, -1 = none, and the barycentric coordinates (P,) of its second and third corner.
        sunlit: (P,) whether the sun reaches the point.
        mesh: faces (Nf, 3), colour (Nv, 3) linear, normal (Nv, 3), ambient (Nv, 2) light on the normal's side and on
            the other, kind (Nf,).
        mix: (3, 3) maps linear red, green, blue to what the camera's channels take in.
        out: result.
    """
    faces, colour, normal, ambient, kind = mesh
    face, second, third = hit
    level = np.empty(3)
    for i in range(len(face)):
        f = face[i]
        if f < 0:
            _sky(rays[i], level)
            _expose(level, mix, out[i])
            continue
        a, b, c = faces[f]
        v, w = second[i], third[i]
        u = 1 - v - w
        n = u * normal[a] + v * normal[b] + w * normal[c]
        near = u * ambient[a, 0] + v * ambient[b, 0] + w * ambient[c, 0]
        far = u * ambient[a, 1] + v * ambient[b, 1] + w * ambient[c, 1]
        to_sun = (n[0] * SUN[0] + n[1] * SUN[1] + n[2] * SUN[2]) / np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2 + 1e-12)
        if n[0] * rays[i, 0] + n[1] * rays[i, 1] + n[2] * rays[i, 2] > 0:
            near, far, to_sun = far, near, -to_sun
        direct = SUN_LIGHT * abs(to_sun) if sunlit[i] else 0.0
        light = near + direct if to_sun > 0 else near
        through = 0.0
        if kind[f] == THIN:
            through = TRANSMITTED * (far + direct if to_sun < 0 else far)
        for channel in range(3):
            albedo = u * colour[a, channel] + v * colour[b, channel] + w * colour[c, channel]
            tint = 1.25 if channel == 1 else (1.0 if channel == 0 else 0.5)
            level[channel] = albedo * (light + tint * through)
        _expose(level, mix, out[i])


@numba.njit(cache=True, nogil=True, fastmath=True)
def _sky(ray: NDArray[Any], level: Array) -> None:
    up = ray[2] / np.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
    level[2] = 0.72 + 0.2 * up
    level[0], level[1] = 0.93 * level[2], 0.97 * level[2]


@numba.njit(cache=True, nogil=True, fastmath=True)
def _expose(level: Array, mix: Array, out: NDArray[Any]) -> None:
    for channel in range(3):
        light = mix[channel, 0] * level[0] + mix[channel, 1] * level[1] + mix[channel, 2] * level[2]
        out[channel] = _ENCODED[int(min(light, 1.0) * (_STEPS - 1))]
