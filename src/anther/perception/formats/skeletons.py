"""Skeleton files: one function that reads any of them, one that writes any of them. J nodes, metres, z up.

Here are the node-and-edge .txt of the paper's authors and SWC; Anther's own .npz is `Skeleton.save`, and PLY, GraphML,
MTG and glTF have modules of their own (docs/formats.md).
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from anther.core.checks import check_array
from anther.core.choices import Units
from anther.core.errors import bad_input
from anther.core.files import LARGEST_TEXT, read_lines, replacing, understood, whole_file, write_text
from anther.core.geometry import Array
from anther.perception.cloud.ply import read_elements
from anther.perception.formats._mtg import read_mtg, write_mtg
from anther.perception.formats._raw_points import places, stated
from anther.perception.formats.skeleton_file import SkeletonFile, rooted
from anther.perception.skeleton import Skeleton


def write_skeleton_ply(path: Path | str, skeleton: Skeleton, labels: Sequence[str] | None = None) -> None:
    """Write a skeleton as binary PLY.

    Vertices have double x, y, z, radius [m], int parent (-1 at the root) and, with labels, uchar organ, which indexes
    the names in the comment "organs ..."; edges have int vertex1 (parent), vertex2 (child).
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
    """Read a PLY with vertices x, y, z [m] and edges vertex1, vertex2; radius and parent are used where it has them."""
    path = Path(path)
    elements = read_elements(path)
    vertices = _element(path, elements, "vertex", ("x", "y", "z"))
    edges = _element(path, elements, "edge", ("vertex1", "vertex2"))
    nodes = np.column_stack([vertices[axis] for axis in "xyz"]).astype(np.float64)
    pairs = np.column_stack([edges[end] for end in ("vertex1", "vertex2")]).astype(np.int64)
    held = {key: vertices[key] for key in ("radius", "parent", "organ") if key in vertices.dtype.names}
    tops = np.flatnonzero(held["parent"] < 0) if "parent" in held else np.zeros(0, np.int64)
    comments = _ply_comments(path)
    names = next((line.split()[2:] for line in comments if line.startswith("comment organs ")), [])
    tree = rooted(
        nodes,
        pairs,
        radius=held["radius"].astype(np.float64) if "radius" in held else None,
        root=int(tops[0]) if len(tops) == 1 else None,
        labels=[names[int(k)] for k in held["organ"]] if "organ" in held and names else None,
    )
    return _with_stated(tree, comments)


def _element(path: Path, elements: dict[str, Any], name: str, wanted: tuple[str, ...]) -> Any:
    data = elements.get(name)
    if data is None or not set(wanted) <= set(data.dtype.names or ()):
        given, allowed = f"no element '{name}' with {', '.join(wanted)}", "vertices x y z and edges vertex1 vertex2"
        do = "A cloud is no skeleton yet: `anther skeletonize` makes one."
        raise bad_input(str(path), given=given, allowed=f"a skeleton: {allowed}", do=do)
    return data


def _ply_comments(path: Path) -> list[str]:
    head = path.read_bytes()[:64_000].partition(b"end_header")[0].decode("ascii", "replace")
    return [line for line in head.splitlines() if line.startswith("comment ")]


def write_graphml(path: Path | str, skeleton: Skeleton, labels: Sequence[str] | None = None) -> None:
    """Write a skeleton as GraphML: nodes n0 (the root), n1, ... with x, y, z, radius [m] and organ."""
    import networkx as nx  # noqa: PLC0415  # a fifth of a second

    graph = nx.DiGraph()
    for j, values in enumerate(np.column_stack([skeleton.nodes, skeleton.radius]).tolist()):
        organ = {} if labels is None else {"organ": labels[j]}
        graph.add_node(f"n{j}", **dict(zip(("x", "y", "z", "radius"), values, strict=True)), **organ)
    graph.add_edges_from((f"n{a}", f"n{b}") for a, b in skeleton.edges)
    with replacing(path) as temporary:
        nx.write_graphml(graph, temporary)


def read_graphml(path: Path | str) -> SkeletonFile:
    """Read a tree whose nodes have attributes x, y, z [m] and, optionally, radius [m] and organ.

    The root of a directed graph is its node without incoming edge; an undirected one is rooted at its lowest node. A
    node without coordinates, or that only an edge names, is refused.
    """
    import networkx as nx  # noqa: PLC0415  # a fifth of a second

    try:
        with warnings.catch_warnings(action="ignore"):  # a key without a type
            graph = nx.read_graphml(path, force_multigraph=True)
    except (ET.ParseError, nx.NetworkXError) as error:
        fault = f"not XML ({error})" if isinstance(error, ET.ParseError) else f"no graph ({error})"
        raise bad_input(str(path), given=fault, allowed="GraphML", do="Is it truncated?") from error
    values = dict(graph.nodes(data=True))
    bare = [name for name, stated in values.items() if not {"x", "y", "z"} <= set(stated)]
    if bare:
        given, allowed = f"node '{bare[0]}' without x, y, z", "nodes with x, y, z, edges between them"
        raise bad_input(str(path), given=given, allowed=allowed, do="Export it again.")
    index = {name: j for j, name in enumerate(values)}
    nodes = np.array([[float(node[axis]) for axis in "xyz"] for node in values.values()]).reshape(-1, 3)
    edges = np.array([[index[a], index[b]] for a, b in graph.edges()], dtype=np.int64).reshape(-1, 2)
    has = {name: bool(values) and all(name in node for node in values.values()) for name in ("radius", "organ")}
    tops = np.setdiff1d(np.arange(len(nodes)), edges[:, 1])
    digits = [name.lstrip("n") for name in values]
    return rooted(
        nodes,
        edges,
        radius=np.array([float(node["radius"]) for node in values.values()]) if has["radius"] else None,
        numbers=np.array([int(d) for d in digits]) if all(d.isdecimal() for d in digits) else None,
        root=int(tops[0]) if graph.is_directed() and len(tops) == 1 else None,
        labels=[str(node["organ"]) for node in values.values()] if has["organ"] else None,
    )


__all__ = ["READS", "WRITES", "SkeletonFile", "Units", "read_skeleton", "write_skeleton"]


def read_skeleton(path: Path | str, units: Units | None = None) -> SkeletonFile:
    """Read a skeleton: .npz (Anther), .swc, .ply (with edges), .graphml, .mtg or the paper's authors' .txt; in metres.

    A .txt (`*Nodes` x, y, z, then `*Edges`, 1-based pairs) and a .ply are rooted at their lowest node unless they
    state a parent, the others at the file's own root.

    Args:
        path: the file.
        units: of its lengths; None: those that it states, else metres if that makes a plant.

    Raises:
        InputError: missing, unreadable, not one tree, not finite, or in units that make no plant.
    """
    path = whole_file(path, LARGEST_TEXT)
    suffix = path.suffix.lower()
    if suffix not in READS:
        raise bad_input(str(path), given=f"a {suffix} file", allowed=" ".join(READS), do="Convert it.")
    with understood(path, f"a {suffix} skeleton file", "See docs/formats.md."):
        found = READS[suffix](path).in_metres(units)
        if found.radius is not None and not np.any(found.radius > 0):
            found = replace(found, radius=None, notes=(*found.notes, "the file's radii are all 0: they are not known"))
        return found


def write_skeleton(path: Path | str, skeleton: Skeleton, labels: Sequence[str] | None = None) -> None:
    """Write a skeleton in the format of the suffix: .npz .swc .txt .ply .graphml .mtg .glb.

    Args:
        path: the file; .txt keeps no radii, .npz and .txt no labels, .glb only the surface.
        skeleton: the tree.
        labels: an organ name for every node (letters only), e.g. "stem" or "branch"; None: no labels.

    Raises:
        InputError: another suffix, or as many labels as not nodes.
    """
    path = Path(path)
    if path.suffix.lower() not in WRITES:
        raise bad_input(str(path), given=f"a {path.suffix} file", allowed=" ".join(WRITES), do="Choose one.")
    if labels is not None and (len(labels) != len(skeleton.nodes) or not all(name.isalpha() for name in labels)):
        given, allowed = f"{len(labels)} labels", f"{len(skeleton.nodes)} words"
        raise bad_input("skeleton labels", given=given, allowed=allowed, do="Name each node.")
    WRITES[path.suffix.lower()](path, skeleton, labels)


def _write_glb(path: Path, skeleton: Skeleton, labels: Sequence[str] | None) -> None:
    from anther.perception.formats._gltf import write_glb  # noqa: PLC0415  # trimesh takes half a second

    write_glb(path, skeleton, labels)


def _write_npz(path: Path, skeleton: Skeleton, labels: Sequence[str] | None) -> None:
    skeleton.save(path)


def _write_swc(path: Path, skeleton: Skeleton, labels: Sequence[str] | None) -> None:
    own = 7  # SWC leaves types from here on to the user
    kinds = {name: own + i for i, name in enumerate(dict.fromkeys(labels or ()))}
    lines = ["# anther skeleton; metres; id type x y z radius parent"]
    if kinds:
        lines.append("# types: " + " ".join(f"{kind}={name}" for name, kind in kinds.items()))
    for j, (x, y, z) in enumerate(skeleton.nodes):
        above = skeleton.parent[j] + 1 if j else -1
        kind = kinds[labels[j]] if labels is not None else 0
        lines.append(f"{j + 1} {kind} {x:.9g} {y:.9g} {z:.9g} {skeleton.radius[j]:.9g} {above}")
    write_text(path, "\n".join([*lines, ""]))


def _write_txt(path: Path, skeleton: Skeleton, labels: Sequence[str] | None) -> None:
    nodes = (f"{x:.9g}, {y:.9g}, {z:.9g}" for x, y, z in skeleton.nodes)
    edges = (f"{a + 1}, {b + 1}" for a, b in skeleton.edges)
    write_text(path, "\n".join(["*Nodes", *nodes, "*Edges", *edges, ""]))


def _read_npz(path: Path) -> SkeletonFile:
    stored = Skeleton.load(path)
    return SkeletonFile(stored.nodes, stored.parent, stored.radius, np.arange(len(stored.nodes)), units="m")


def _read_txt(path: Path) -> SkeletonFile:
    lines = read_lines(path)
    heads = [i for i, line in enumerate(lines) if line.lstrip().startswith("*")]
    names = [lines[i].strip().lower() for i in heads]
    if names != ["*nodes", "*edges"]:
        raise bad_input("skeleton text", given=f"sections {names}", allowed="*Nodes, then *Edges", do="See docs.")
    nodes = _table(lines[heads[0] + 1 : heads[1]], 3)
    edges = _table(lines[heads[1] + 1 :], 2)
    return _with_stated(rooted(nodes, edges.astype(np.int64) - 1), lines)


def _with_stated(tree: SkeletonFile, lines: Sequence[str]) -> SkeletonFile:
    """Return the tree with the units that comments state; an axis up that is not z is noted."""
    comments = [line for line in lines if line.lstrip().startswith(("#", "comment"))]
    units, up = stated(comments)
    names = [line.lstrip("# \t").split() for line in comments]
    units = units or next((found for line in names if len(line) == 7 and (found := places(line)[1])), None)
    notes = (f"the file states that {up} is up and is read with z up",) if up not in (None, "z") else ()
    return replace(tree, units=units, notes=(*tree.notes, *notes))


def _read_swc(path: Path) -> SkeletonFile:
    lines = read_lines(path)
    table = _table(lines, 7)  # id, type, x, y, z, radius, parent
    numbers, above = (_whole(table[:, column]) for column in (0, 6))
    if len(set(numbers.tolist())) < len(numbers):
        raise bad_input("SWC", given="an id twice", allowed="distinct ids", do="Number the samples again.")
    root = (above == -1) | (above == numbers) | ((above == 0) & (0 not in numbers))  # as different programs mark it
    kept = ~_of_soma(table[:, 1], numbers, above)
    notes = (f"{np.sum(~kept)} points that only draw the soma are left out",) if not kept.all() else ()
    table, numbers, above, root = table[kept], numbers[kept], above[kept], root[kept]
    index = {int(number): i for i, number in enumerate(numbers)}
    lost = [int(p) for p in above[~root] if int(p) not in index]
    if lost:
        raise bad_input("SWC", given=f"unknown parent {lost[0]}", allowed="an id of the file, or -1", do="Repair it.")
    roots = np.flatnonzero(root)
    if len(roots) != 1:
        raise bad_input("SWC", given=f"{len(roots)} roots", allowed="one parent -1 (or 0)", do="Keep one tree.")
    edges = np.array([(index[int(p)], i) for i, p in enumerate(above) if not root[i]]).reshape(-1, 2)
    labels = _swc_labels(lines, table[:, 1].astype(np.int64).tolist())
    radius, more = _swc_radius(table[:, 5], [line for line in lines if line.lstrip().startswith("#")])
    tree = rooted(table[:, 2:5], edges, radius=radius, numbers=numbers, root=int(roots[0]), labels=labels)
    return _with_stated(replace(tree, notes=(*tree.notes, *notes, *more)), lines)


def _whole(column: Array) -> NDArray[np.int64]:
    if not np.array_equal(column, np.round(column)):
        odd = column[column != np.round(column)][0]
        raise bad_input(
            "SWC", given=f"an id {odd:g}", allowed="whole numbers", do="Are the columns id type x y z r parent?"
        )
    return column.astype(np.int64)


def _of_soma(kinds: Array, numbers: NDArray[np.int64], above: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which samples only draw a cell's body: tips of its type (1) that hang on another of it."""
    soma = set(numbers[kinds == 1].tolist())
    return (kinds == 1) & np.isin(above, [*soma]) & ~np.isin(numbers, above) & (above != numbers)


def _swc_radius(values: Array, comments: list[str]) -> tuple[Array, tuple[str, ...]]:
    """Return the radii and notes: a comment may name the column a diameter, or state a scale, which is not applied."""
    words = [re.findall(r"[a-z]+", line.lower()) for line in comments]
    named = any(
        word.startswith("d") and word in ("d", "diam", "diameter") for line in words if "x" in line for word in line
    )
    scales = [m[1].split() for line in comments if (m := re.match(r"#\s*SCALE\s+([-+.\deE\s]+)$", line.strip()))]
    notes = [f"its SCALE {' '.join(scale)} is not applied" for scale in scales if any(float(n) != 1 for n in scale)]
    notes += ["column 6 is a diameter, as the file states: it is halved"] if named else []
    return values / 2 if named else values, tuple(notes)


def _swc_labels(lines: list[str], kinds: list[int]) -> list[str] | None:
    """Return the names of the types where a comment lists them ("# types: 7=stem 8=branch")."""
    listed = [line.split(":", 1)[1].split() for line in lines if line.startswith("# types:")]
    names = {int(kind): name for kind, _, name in (word.partition("=") for word in (listed[0] if listed else ()))}
    return [names[kind] for kind in kinds] if set(kinds) <= set(names) else None


def _table(lines: list[str], columns: int) -> Array:
    bare = (line.split("#")[0].replace(",", " ").split() for line in lines)
    rows = [row for row in bare if row]
    wrong = [row for row in rows if len(row) != columns]
    if wrong:
        allowed, do = f"{columns} numbers", "Is the file truncated?"
        raise bad_input("skeleton line", given=" ".join(wrong[0]), allowed=allowed, do=do)
    return check_array("skeleton numbers", np.array(rows, dtype=np.float64).reshape(-1, columns), (None, columns))


READS: dict[str, Callable[[Path], SkeletonFile]] = {
    ".npz": _read_npz,
    ".swc": _read_swc,
    ".txt": _read_txt,
    ".ply": read_skeleton_ply,
    ".graphml": read_graphml,
    ".mtg": read_mtg,
}
"""Suffix -> reader."""

WRITES: dict[str, Callable[[Path, Skeleton, Sequence[str] | None], None]] = {
    ".npz": _write_npz,
    ".swc": _write_swc,
    ".txt": _write_txt,
    ".ply": write_skeleton_ply,
    ".graphml": write_graphml,
    ".mtg": write_mtg,
    ".glb": _write_glb,
}
"""Suffix -> writer."""
