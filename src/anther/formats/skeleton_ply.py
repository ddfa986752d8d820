"""Skeletons as PLY: nodes as vertices with radii, and lines between them as edges. J nodes, E = J - 1, metres, z up.

Element and property names as in G. Turk's description (edge: vertex1, vertex2), which MeshLab, CloudCompare and Open3D
(as a LineSet) read. A program that knows no edges still shows the nodes as points.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from anther.errors import bad_input
from anther.files import replacing
from anther.formats.points import load_whole_ply
from anther.formats.skeleton_file import SkeletonFile, rooted
from anther.skeleton import Skeleton


def write_skeleton_ply(path: Path | str, skeleton: Skeleton, labels: Sequence[str] | None = None) -> None:
    """Write a skeleton as binary PLY.

    Vertices have double x, y, z, radius [m], int parent (-1 at the root) and, with labels, uchar organ, which indexes
    the names in the comment "organs ..."; edges have int vertex1 (parent), vertex2 (child).

    Args:
        path: file to write.
        skeleton: the tree.
        labels: an organ name a node, or None.
    """
    names = list(dict.fromkeys(labels or ()))
    kinds = {"x": "f8", "y": "f8", "z": "f8", "radius": "f8", "parent": "i4"} | ({"organ": "u1"} if names else {})
    nodes = np.zeros(len(skeleton.nodes), [(name, "<" + kind) for name, kind in kinds.items()])
    nodes["x"], nodes["y"], nodes["z"] = skeleton.nodes.T
    nodes["radius"], nodes["parent"] = skeleton.radius, skeleton.parent
    if labels is not None:
        nodes["organ"] = [names.index(label) for label in labels]
    words = {"f8": "double", "i4": "int", "u1": "uchar"}
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment anther skeleton, metres, z up",
        *([f"comment organs {' '.join(names)}"] if names else []),
        f"element vertex {len(nodes)}",
        *(f"property {words[kind]} {name}" for name, kind in kinds.items()),
        f"element edge {len(nodes) - 1}",
        "property int vertex1",
        "property int vertex2",
        "end_header",
        "",
    ]
    content = "\n".join(header).encode("ascii") + nodes.tobytes() + skeleton.edges.astype("<i4").tobytes()
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def read_skeleton_ply(path: Path | str) -> SkeletonFile:
    """Read a PLY with vertices x, y, z [m] and edges vertex1, vertex2; radius and parent are used where it has them.

    Raises:
        InputError: unreadable, no edges (a plain cloud), or not one tree.
    """
    path = Path(path)
    elements = load_whole_ply(path)["metadata"]["_ply_raw"]
    vertices = _element(path, elements, "vertex", ("x", "y", "z"))
    edges = _element(path, elements, "edge", ("vertex1", "vertex2"))
    nodes = np.column_stack([np.ravel(vertices[axis]) for axis in "xyz"]).astype(np.float64)
    pairs = np.column_stack([np.ravel(edges[end]) for end in ("vertex1", "vertex2")]).astype(np.int64)
    held = {key: np.ravel(vertices[key]) for key in ("radius", "parent", "organ") if _has(vertices, key)}
    tops = np.flatnonzero(held["parent"] < 0) if "parent" in held else np.zeros(0, np.int64)
    names = _organ_names(path)
    return rooted(
        nodes,
        pairs,
        radius=held["radius"].astype(np.float64) if "radius" in held else None,
        root=int(tops[0]) if len(tops) == 1 else None,
        labels=[names[int(k)] for k in held["organ"]] if "organ" in held and names else None,
    )


def _element(path: Path, elements: dict[str, Any], name: str, wanted: tuple[str, ...]) -> Any:
    data = elements.get(name, {}).get("data")
    if data is None or not all(_has(data, key) for key in wanted):
        raise bad_input(
            str(path),
            given=f"no element '{name}' with {', '.join(wanted)}",
            allowed="a skeleton: vertices x y z and edges vertex1 vertex2",
            do="A cloud is no skeleton yet: `anther skeletonize` makes one.",
        )
    return data


def _has(data: Any, key: str) -> bool:
    return key in data if isinstance(data, dict) else key in (data.dtype.names or ())


def _organ_names(path: Path) -> list[str]:
    head = path.read_bytes()[:64_000].partition(b"end_header")[0].decode("ascii", "replace")
    told = [line.split()[2:] for line in head.splitlines() if line.startswith("comment organs ")]
    return told[0] if told else []
