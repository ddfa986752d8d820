"""Ray-cast RGB-D images of a simulated plant with Embree. Dimensions: H x W pixels, Nv vertices, Nf faces.

Sun with shadows, sky light with occlusion (baked per vertex when the scene is built), light through leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import ArrayLike, NDArray

from anther.core.checks import check_array, check_transform
from anther.core.compiling import OPTIONS, compiled, inlined, numba
from anther.core.geometry import Array, Intrinsics, inverse, transform_points
from anther.sim.greenhouse import Setting, repainted, surroundings
from anther.sim.plant import Organ, SimPlant

LIGHT = 0.72
"""Of the whole sky on a level surface, and of the sun besides: 1 would turn white into full white."""
SUN = np.array([-0.42, -0.36, 0.83]) / np.linalg.norm([-0.42, -0.36, 0.83])
"""Direction towards the sun in the world: from behind the arm's shoulder."""
OPAQUE, THIN, SUNLESS = range(3)
"""How a face takes light: from one side, through it as well, or no sun at all (what is far off)."""
_ENCODED = (np.linspace(0, 1, 4096) ** (1 / 2.2) * 255).astype(np.uint8)


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


@numba.njit(**OPTIONS, fastmath=True)
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


@numba.njit(**OPTIONS, fastmath=True)
def shadow_origins(
    eye: Array,
    rays: NDArray[Any],
    hit: tuple[NDArray[Any], NDArray[Any], NDArray[Any]],
    kind: NDArray[Any],
    pixels: NDArray[Any],
    origins: NDArray[Any],
) -> int:
    """Fill the first Q of pixel numbers (P,) that could be in the sun and points (P, 3) just off their surface.

    Returns Q. `hit` is depth (P,), face (P,) and the face's normal (P, 3) of any length and sign; `kind` (Nf,) is
    OPAQUE, THIN or SUNLESS.
    """
    depth, face, normal = hit
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
    return count


@numba.njit(**OPTIONS, fastmath=True)
def shade(
    rays: NDArray[Any],
    hit: tuple[NDArray[Any], NDArray[Any], NDArray[Any]],
    sunlit: NDArray[Any],
    mesh: tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]],
    mix: Array,
    level: Array,
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
        level: (3,) scratch.
        out: result.
    """
    faces, colour, normal, ambient, kind = mesh
    face, second, third = hit
    for i in range(len(face)):
        f = face[i]
        if f < 0:
            _sky(rays[i], level)
            _expose(level, mix, out[i])
            continue
        a, b, c = faces[f]
        v, w = second[i], third[i]
        u = 1 - v - w
        nx = u * normal[a, 0] + v * normal[b, 0] + w * normal[c, 0]
        ny = u * normal[a, 1] + v * normal[b, 1] + w * normal[c, 1]
        nz = u * normal[a, 2] + v * normal[b, 2] + w * normal[c, 2]
        near = u * ambient[a, 0] + v * ambient[b, 0] + w * ambient[c, 0]
        far = u * ambient[a, 1] + v * ambient[b, 1] + w * ambient[c, 1]
        to_sun = (nx * SUN[0] + ny * SUN[1] + nz * SUN[2]) / np.sqrt(nx * nx + ny * ny + nz * nz + 1e-12)
        if nx * rays[i, 0] + ny * rays[i, 1] + nz * rays[i, 2] > 0:
            near, far, to_sun = far, near, -to_sun
        direct = LIGHT * abs(to_sun) if sunlit[i] else 0.0
        light = near + direct if to_sun > 0 else near
        through = 0.0
        if kind[f] == THIN:
            through = 0.45 * (
                far + direct if to_sun < 0 else far
            )  # leaves transmit less than they reflect: an estimate
        for channel in range(3):
            albedo = u * colour[a, channel] + v * colour[b, channel] + w * colour[c, channel]
            tint = 1.25 if channel == 1 else (1.0 if channel == 0 else 0.5)
            level[channel] = albedo * (light + tint * through)
        _expose(level, mix, out[i])


@inlined
def _sky(ray: NDArray[Any], level: Array) -> None:
    up = ray[2] / np.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
    level[2] = 0.72 + 0.2 * up
    level[0], level[1] = 0.93 * level[2], 0.97 * level[2]


@inlined
def _expose(level: Array, mix: Array, out: NDArray[Any]) -> None:
    for channel in range(3):
        light = mix[channel, 0] * level[0] + mix[channel, 1] * level[1] + mix[channel, 2] * level[2]
        out[channel] = _ENCODED[np.int64((light if light < 1.0 else 1.0) * (len(_ENCODED) - 1))]


def d455(width: int = 1280, height: int = 720) -> Intrinsics:
    """Return the intrinsics of a RealSense D455: f = 640 px at 1280 wide (facts: perception, depth sensors)."""
    f = 640.0 * width / 1280
    return Intrinsics(width, height, f, f, (width - 1) / 2, (height - 1) / 2)


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """What an ideal camera sees.

    Attributes:
        rgb: (H, W, 3) uint8.
        depth: (H, W) float32, exact z-depth [m]; 0 where no surface is hit.
        organ: (H, W) uint8, the `Organ` that is seen; NOTHING = none.
    """

    rgb: NDArray[Any]
    depth: NDArray[Any]
    organ: NDArray[Any]


class Still(NamedTuple):
    """An image by which others of the same camera are made faster: what does not move stays as it is, shadows too.

    Attributes:
        image: of the scene as it was.
        faces: (K, 3) vertices of the faces that may move.
        flower: (K,) whether the face is a flower's.
        shown: (2, H, W) where what moves is seen in the image, and where a flower that does.
    """

    image: Image
    faces: NDArray[Any]
    flower: NDArray[np.bool_]
    shown: NDArray[np.bool_]

    def changing(self, intrinsics: Intrinsics, T_world_cam: Array, shapes: Sequence[Array]) -> NDArray[np.bool_]:
        """Return (2, H, W) where another image may differ: all, and flowers.

        Args:
            intrinsics, T_world_cam: of the camera.
            shapes: vertices (n, 3) [m] that the other image may show of what moves: `Scene.shape`.
        """
        changing = self.shown.copy()
        for shape in shapes:
            seen = transform_points(inverse(T_world_cam), shape)
            seen[:, 2] = np.maximum(seen[:, 2], 1e-3)
            frame_faces(intrinsics.project(seen), self.faces, self.flower, changing)
        return changing


@compiled
def frame_faces(pixels: Array, faces: NDArray[Any], flower: NDArray[Any], marked: NDArray[Any]) -> None:
    """Mark (2, H, W), all and flowers, the rectangles around faces (K, 3), a pixel wider, of vertices at `pixels`."""
    height, width = marked.shape[1:]
    for k in range(len(faces)):
        left, top, right, bottom = width, height, -1, -1
        for corner in faces[k]:
            column, row = np.int64(pixels[corner, 0]), np.int64(pixels[corner, 1])
            left, right = column if column < left else left, column if column > right else right
            top, bottom = row if row < top else top, row if row > bottom else bottom
        for v in range(top - 1 if top > 0 else 0, bottom + 3 if bottom + 3 < height else height):
            for u in range(left - 1 if left > 0 else 0, right + 3 if right + 3 < width else width):
                marked[0, v, u] = True
                marked[1, v, u] |= flower[k]


def _ray_caster(vertices: Array, faces: NDArray[np.int32]) -> Any:
    scene = EmbreeScene()
    TriangleMesh(scene, vertices.astype(np.float32), faces)
    return scene


class Scene:
    """Meshes ready for ray casting. Build once, `render` often; `moved` gives the scene with the plant elsewhere."""

    def __init__(
        self,
        vertices: ArrayLike,
        faces: NDArray[Any],
        face_organ: NDArray[Any],
        vertex_color: NDArray[Any],
        *,
        ambient: NDArray[Any] | None = None,
        setting: Setting | None = None,
        moving: int | None = None,
    ) -> None:
        """Build the scene.

        Args:
            vertices: (Nv, 3) [m] world.
            faces: (Nf, 3) vertex numbers.
            face_organ: (Nf,) an `Organ` each.
            vertex_color: (Nv, 3) uint8 sRGB.
            ambient: (Nv, 2) sky light on both sides of each vertex; None computes it.
            setting: whose light falls on it; None is daylight.
            moving: how many of the vertices may ever move, the first ones, with their faces the first; None: all.
        """
        self.setting = setting or Setting()
        self.vertices = check_array("scene vertices", vertices, (None, 3))
        self.faces = np.ascontiguousarray(faces, dtype=np.int32)
        self.face_organ = np.asarray(face_organ, dtype=np.uint8)
        self._moving = len(self.vertices) if moving is None else moving  # how many vertices, and faces, the first ones
        self.vertex_color = np.asarray(vertex_color, dtype=np.uint8)
        self._moves = int(np.count_nonzero(self.faces[:, 0] < self._moving))
        self._parts = [_ray_caster(self.vertices, self.faces[: self._moves])]
        if self._moves < len(self.faces):
            self._parts.append(_ray_caster(self.vertices, self.faces[self._moves :]))
        self._normals = vertex_normals(self.vertices, self.faces)
        self._ambient = self._baked_ambient() if ambient is None else np.asarray(ambient, np.float32)
        kind = np.full(256, OPAQUE, dtype=np.uint8)
        kind[[Organ.LEAF, Organ.FLOWER]], kind[Organ.SURROUNDINGS] = THIN, SUNLESS
        colour = linear(self.vertex_color)
        self._mix = np.array(self.setting.light, dtype=np.float64)
        self._mesh = (self.faces, colour, self._normals, self._ambient, kind[self.face_organ])

    @classmethod
    def of_plant(cls, plant: SimPlant, setting: Setting | None = None) -> Scene:
        """Return the scene of a plant in its pot on a bench in a greenhouse; `setting` varies its looks and light."""
        setting = setting or Setting()
        vertices, faces, organ, colour = surroundings(plant.pot, setting)
        painted = repainted(plant.face_organ, plant.faces, plant.vertex_color, setting)
        return cls(
            np.vstack([plant.vertices, vertices]),
            np.vstack([plant.faces, faces + len(plant.vertices)]),
            np.concatenate([plant.face_organ, organ]),
            np.vstack([painted, colour]),
            setting=setting,
            moving=len(plant.vertices),
        )

    @property
    def shape(self) -> Array:
        """(n, 3) the vertices that may move [m]: the first ones."""
        return self.vertices[: self._moving]

    def moved(self, vertices: ArrayLike) -> Scene:
        """Return the scene with its first n vertices at `vertices` (n, 3) [m]: the plant's, from `posed_vertices`."""
        new, n = copy(self), self._moving
        new.vertices = self.vertices.copy()
        new.vertices[: len(np.asarray(vertices))] = vertices
        own = new.vertices[:n], self.faces[: self._moves]
        new._parts = [_ray_caster(*own), *self._parts[1:]]
        new._normals = np.vstack([vertex_normals(*own), self._normals[n:]])
        new._mesh = (*self._mesh[:2], new._normals, *self._mesh[3:])
        return new

    def render(
        self,
        intrinsics: Intrinsics,
        T_world_cam: ArrayLike,
        base: Image | None = None,
        only: NDArray[np.bool_] | None = None,
    ) -> Image:
        """Return the image of a camera at T_world_cam, or a `base` image of which the pixels `only` (H, W) are new."""
        if base is None:
            return self._look(intrinsics, T_world_cam)[0]
        seen, _ = self._look(intrinsics, T_world_cam, only)
        whole = [part.copy() for part in (base.rgb, base.depth, base.organ)]
        for part, new in zip(whole, (seen.rgb, seen.depth, seen.organ), strict=True):
            part[only] = new
        return Image(*whole)

    def still(self, intrinsics: Intrinsics, T_world_cam: ArrayLike) -> Still:
        """Return an image by which those of the scene with the plant elsewhere are made faster."""
        image, face = self._look(intrinsics, T_world_cam)
        moves = (face >= 0) & (face < self._moves) & (image.organ < Organ.POT)
        organ, shown = self.face_organ[: self._moves], np.stack([moves, moves & (image.organ == Organ.FLOWER)])
        of_plant = organ < Organ.POT
        return Still(image, self.faces[: self._moves][of_plant], organ[of_plant] == Organ.FLOWER, shown)

    def _look(
        self, intrinsics: Intrinsics, T_world_cam: ArrayLike, only: NDArray[np.bool_] | None = None
    ) -> tuple[Image, NDArray[Any]]:
        """Return the image and the face (H, W) in each pixel, -1 where there is none; or both of `only` these (P,)."""
        T = check_transform("T_world_cam", T_world_cam)
        size = (intrinsics.height, intrinsics.width) if only is None else (-1,)
        rays = self._rays(intrinsics, T)
        if only is not None:
            rays = rays[only.ravel()]
        eye = np.ascontiguousarray(np.broadcast_to(T[:3, 3].astype(np.float32), rays.shape))
        hit = self._first_hit(eye, rays)
        face = hit["primID"]
        depth = np.where(face >= 0, hit["tfar"], np.float32(0))
        rgb = np.empty((len(face), 3), dtype=np.uint8)
        sunlit = self._sunlit(T[:3, 3], rays, depth, hit)
        shade(rays, (face, hit["u"], hit["v"]), sunlit, self._mesh, self._mix, np.empty(3), rgb)
        organ = np.append(self.face_organ, np.uint8(Organ.NOTHING))[face]
        return Image(rgb.reshape(*size, 3), depth.reshape(size), organ.reshape(size)), face.reshape(size)

    def visible(self, points: ArrayLike, eye: ArrayLike, tolerance: float = 0.004) -> NDArray[np.bool_]:
        """Return (N,) whether nothing stands between `eye` (3,) and each of (N, 3) points, up to `tolerance` [m]."""
        points, eye = np.asarray(points, dtype=np.float64), np.asarray(eye, dtype=np.float64)
        rays = points - eye
        distance = np.linalg.norm(rays, axis=1)
        start = np.tile(eye.astype(np.float32), (len(points), 1))
        share = np.min([part.run(start, rays.astype(np.float32), query="DISTANCE") for part in self._parts], axis=0)
        return share * distance >= distance - tolerance

    def _first_hit(self, origins: NDArray[Any], rays: NDArray[Any]) -> dict[str, Any]:
        """Return what rays (P, 3) hit first: Embree's face, barycentric coordinates, distance and normal, (P,) each."""
        hit, *others = (part.run(origins, rays, output=1) for part in self._parts)
        for other in others:
            other["primID"][other["primID"] >= 0] += self._moves
            nearer = (other["primID"] >= 0) & ((hit["primID"] < 0) | (other["tfar"] < hit["tfar"]))
            for name, values in hit.items():
                values[nearer] = other[name][nearer]
        return hit

    def _free(self, origins: NDArray[Any], rays: NDArray[Any], reach: NDArray[Any]) -> NDArray[np.bool_]:
        """Return (P,) which rays meet nothing within their reach."""
        return np.all([part.run(origins, rays, reach, query="OCCLUDED") < 0 for part in self._parts], axis=0)

    def _rays(self, intrinsics: Intrinsics, T_world_cam: Array) -> NDArray[np.float32]:
        rays = np.empty((intrinsics.height * intrinsics.width, 3), dtype=np.float32)
        camera_rays(intrinsics.width, intrinsics.height, intrinsics.pinhole, T_world_cam[:3, :3].copy(), rays)
        return rays

    def _sunlit(self, eye: Array, rays: NDArray[Any], depth: NDArray[Any], hit: dict[str, Any]) -> NDArray[np.bool_]:
        pixels, origins = np.empty(len(rays), np.int32), np.empty(rays.shape, np.float32)
        count = shadow_origins(eye.copy(), rays, (depth, hit["primID"], hit["Ng"]), self._mesh[4], pixels, origins)
        pixels, origins = pixels[:count], origins[:count]
        to_sun = np.tile(SUN.astype(np.float32), (len(origins), 1))
        if not self.setting.sun:
            return np.zeros(len(rays), dtype=np.bool_)
        free = self._free(origins, to_sun, np.full(len(origins), 1.5, np.float32))
        sunlit = np.zeros(len(rays), dtype=np.bool_)
        sunlit[pixels[free]] = True
        return sunlit

    def _baked_ambient(self, rays: int = 16, farthest: float = 0.8) -> NDArray[np.float32]:
        """Return (Nv, 2) the light of sky and ground on both sides of each vertex, from `rays` a side.

        What is farther away than `farthest` [m] darkens nothing: plant, pot and bench do, the walls do not.
        """
        rng = np.random.default_rng(0)
        n = np.stack([self._normals, -self._normals], axis=1)[:, :, None]
        v = rng.normal(size=(rays, 3))
        ways = n + v / np.linalg.norm(v, axis=1, keepdims=True)
        start = (self.vertices[:, None, None] + 5e-4 * n + 1e-6 * ways).reshape(-1, 3).astype(np.float32)
        reach = np.full(len(start), farthest, dtype=np.float32)
        flat = np.ascontiguousarray(ways.reshape(-1, 3), dtype=np.float32)
        free = self._free(start, flat, reach).reshape(ways.shape[:3])
        sky = np.where(ways[..., 2] > 0, 1.0, 0.3)  # light from below is a share of the sky's
        light = np.where(free, sky, 0.12)
        return (LIGHT * light.mean(axis=2)).astype(np.float32)
