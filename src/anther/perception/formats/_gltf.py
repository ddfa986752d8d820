"""Skeletons as binary glTF: one tapered tube an axis, coloured by organ. J nodes, metres.

glTF 2.0 (https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html) has y up: vertices keep Anther's coordinates (z up)
and the scene's node "z_up" turns them, so that viewers show the plant upright.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.util import append_faces
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from anther.core.files import replacing
from anther.core.geometry import Array
from anther.perception.formats._mtg import successors
from anther.perception.skeleton import Skeleton


def write_glb(path: Path | str, skeleton: Skeleton, labels: Sequence[str] | None = None) -> None:
    """Write a skeleton as .glb: one mesh an organ name, "skeleton" without labels."""
    scene = trimesh.Scene(base_frame="world")
    # (x, y, z) with z up -> (x, z, -y) with y up
    y_up = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    scene.graph.update(frame_to="z_up", frame_from="world", matrix=y_up)
    colors = {"stem": (92, 138, 58), "branch": (139, 186, 92), "truss": (214, 160, 40), "leaf": (52, 110, 60)}
    others = ((214, 160, 62), (70, 140, 150), (170, 95, 130), (120, 120, 120))
    for i, (name, mesh) in enumerate(tubes(skeleton, labels).items()):
        color = colors.get(name, others[i % len(others)] if labels is not None else colors["stem"])
        material = PBRMaterial(
            name=name, baseColorFactor=[*color, 255], metallicFactor=0.0, roughnessFactor=0.8, doubleSided=False
        )
        mesh.visual = TextureVisuals(material=material)
        scene.add_geometry(mesh, node_name=name, geom_name=name, parent_node_name="z_up")
    content: Any = scene.export(file_type="glb", include_normals=True)
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def tubes(skeleton: Skeleton, labels: Sequence[str] | None = None) -> dict[str, trimesh.Trimesh]:
    """Return a closed, tapered tube for every axis, joined to one mesh an organ name.

    An axis begins within the node it branches from, no thicker than that node, and continues by `successors`.
    """
    parts: dict[str, list[tuple[Array, NDArray[Any]]]] = {}
    for axis, own in _axes(skeleton, labels):
        radius = skeleton.radius[axis].copy()
        if not own:
            radius[0] = min(radius[0], radius[1])
        name = "skeleton" if labels is None else labels[int(axis[-1])]
        parts.setdefault(name, []).append(_tube(skeleton.nodes[axis], radius))
    joined = {name: append_faces(*zip(*pieces, strict=True)) for name, pieces in parts.items()}
    return {name: trimesh.Trimesh(*mesh, process=False) for name, mesh in joined.items()}


def _axes(skeleton: Skeleton, labels: Sequence[str] | None) -> Iterator[tuple[NDArray[Any], bool]]:
    """Yield (nodes, whether the first is the axis's own) of every axis; an axis also ends where the organ changes."""
    goes_on = successors(skeleton, labels)
    for j in range(len(skeleton.nodes)):
        above = int(skeleton.parent[j])
        follows = above >= 0 and goes_on[above] == j
        if follows and (labels is None or labels[above] == labels[j]):
            continue
        axis = [j] if above < 0 else [above, j]
        while (child := goes_on[axis[-1]]) >= 0 and (labels is None or labels[child] == labels[j]):
            axis.append(child)
        if len(axis) > 1:
            yield np.array(axis), above < 0


def _tube(centres: Array, radius: Array) -> tuple[Array, NDArray[Any]]:
    """Return (vertices, faces) of rings around a polyline, normal to the mean of the edges that meet there.

    Every node has one ring of its own radius, centred on it; ends are closed by a fan. The frame is carried along
    without twist: every ring's first axis is the last one's, made normal to the tangent.
    """
    steps = np.diff(centres, axis=0)
    steps /= np.maximum(np.linalg.norm(steps, axis=1, keepdims=True), 1e-12)
    tangents = np.concatenate([steps[:1], steps[:-1] + steps[1:], steps[-1:]])
    folded = np.linalg.norm(tangents, axis=1) < 1e-6  # the polyline turns back on itself: keep the way it came
    tangents[folded] = np.concatenate([steps[:1], steps])[folded]
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    across = np.eye(3)[np.argmin(np.abs(tangents[0]))]
    count = 12  # vertices of a ring
    angle = 2 * np.pi * np.arange(count) / count
    rings = []
    for centre, tangent, r in zip(centres, tangents, radius, strict=True):
        normal = across - (across @ tangent) * tangent
        if np.linalg.norm(normal) < 1e-6:
            normal = np.cross(tangent, np.eye(3)[np.argmin(np.abs(tangent))])
        across = normal / np.linalg.norm(normal)
        rings.append(
            centre + r * (np.outer(np.cos(angle), across) + np.outer(np.sin(angle), np.cross(tangent, across)))
        )
    return np.concatenate([*rings, centres[[0, -1]]]), _faces(len(centres), count)


def _faces(rings: int, count: int) -> NDArray[Any]:
    """Return the triangles between rings of `count` vertices and of both end fans, counter-clockwise from outside."""
    k = np.arange(count)
    turn = (k + 1) % count
    near = count * np.arange(rings - 1)[:, None]
    sides = [
        np.stack([near + k, near + turn, near + count + turn], axis=-1),
        np.stack([near + k, near + count + turn, near + count + k], axis=-1),
    ]
    first, last = count * rings, count * rings + 1
    end = count * (rings - 1)
    fans = [
        np.stack([np.full(count, first), turn, k], axis=-1),
        np.stack([np.full(count, last), end + k, end + turn], axis=-1),
    ]
    return np.concatenate([part.reshape(-1, 3) for part in (*sides, *fans)])
