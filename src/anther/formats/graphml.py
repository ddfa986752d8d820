"""Skeletons as GraphML, which networkx, igraph, Gephi and Cytoscape read. J nodes, metres, z up.

Format: http://graphml.graphdrawing.org/primer/graphml-primer.html. Nodes carry x, y, z and radius (double) and organ
(string); edges are directed from parent to child.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from anther.errors import bad_input
from anther.files import replacing
from anther.formats.skeleton_file import SkeletonFile, rooted
from anther.skeleton import Skeleton

_NAMESPACE = "http://graphml.graphdrawing.org/xmlns"
_NUMBERS = ("x", "y", "z", "radius")


def write_graphml(path: Path | str, skeleton: Skeleton, labels: Sequence[str] | None = None) -> None:
    """Write a skeleton as GraphML: nodes n0 (the root), n1, ... with x, y, z, radius [m] and organ.

    Args:
        path: file to write.
        skeleton: the tree.
        labels: an organ name a node, or None.
    """
    graphml = ET.Element("graphml", xmlns=_NAMESPACE)
    for name in _NUMBERS if labels is None else (*_NUMBERS, "organ"):
        kind = "string" if name == "organ" else "double"
        ET.SubElement(graphml, "key", {"id": name, "for": "node", "attr.name": name, "attr.type": kind})
    graph = ET.SubElement(graphml, "graph", id="skeleton", edgedefault="directed")
    for j, values in enumerate(np.column_stack([skeleton.nodes, skeleton.radius])):
        node = ET.SubElement(graph, "node", id=f"n{j}")
        for name, value in zip(_NUMBERS, values, strict=True):
            ET.SubElement(node, "data", key=name).text = repr(float(value))
        if labels is not None:
            ET.SubElement(node, "data", key="organ").text = labels[j]
    for a, b in skeleton.edges:
        ET.SubElement(graph, "edge", source=f"n{a}", target=f"n{b}")
    ET.indent(graphml)
    with replacing(path) as temporary:
        ET.ElementTree(graphml).write(temporary, encoding="utf-8", xml_declaration=True)


def read_graphml(path: Path | str) -> SkeletonFile:
    """Read a tree whose nodes have attributes x, y, z [m] and, optionally, radius [m] and organ.

    The root of a directed graph is its node without incoming edge; an undirected one is rooted at its lowest node.

    Raises:
        InputError: not XML, no graph, a node without coordinates, an edge to an unknown node, or not one tree.
    """
    try:
        tree = ET.parse(path).getroot()
    except ET.ParseError as error:
        raise bad_input(str(path), given=f"not XML ({error})", allowed="GraphML", do="Is it truncated?") from error
    space = {"g": tree.tag[1:].partition("}")[0]} if tree.tag.startswith("{") else {"g": ""}
    names = {str(key.get("id")): str(key.get("attr.name", key.get("id"))) for key in tree.iterfind("g:key", space)}
    graph = tree.find("g:graph", space)
    if graph is None:
        raise bad_input(str(path), given=f"<{tree.tag}> without <graph>", allowed="GraphML", do="Export it again.")
    given = {
        str(node.get("id")): {
            names.get(str(data.get("key")), ""): data.text or "" for data in node.iterfind("g:data", space)
        }
        for node in graph.iterfind("g:node", space)
    }
    ends = [(str(edge.get("source")), str(edge.get("target"))) for edge in graph.iterfind("g:edge", space)]
    return _tree(path, given, ends, directed=graph.get("edgedefault") != "undirected")


def _tree(
    path: Path | str, given: dict[str, dict[str, str]], ends: list[tuple[str, str]], *, directed: bool
) -> SkeletonFile:
    index = {name: j for j, name in enumerate(given)}
    lost = [name for pair in ends for name in pair if name not in index]
    bare = [name for name, values in given.items() if not {"x", "y", "z"} <= set(values)]
    if lost or bare:
        fault = f"an edge to unknown node '{lost[0]}'" if lost else f"node '{bare[0]}' without x, y, z"
        raise bad_input(str(path), given=fault, allowed="nodes with x, y, z, edges between them", do="Export it again.")
    nodes = np.array([[float(values[axis]) for axis in "xyz"] for values in given.values()]).reshape(-1, 3)
    edges = np.array([[index[a], index[b]] for a, b in ends], dtype=np.int64).reshape(-1, 2)
    has = {name: bool(given) and all(name in values for values in given.values()) for name in ("radius", "organ")}
    tops = np.setdiff1d(np.arange(len(nodes)), edges[:, 1])
    digits = [name.lstrip("n") for name in given]
    return rooted(
        nodes,
        edges,
        radius=np.array([float(values["radius"]) for values in given.values()]) if has["radius"] else None,
        numbers=np.array([int(d) for d in digits]) if all(d.isdecimal() for d in digits) else None,
        root=int(tops[0]) if directed and len(tops) == 1 else None,
        labels=[values["organ"] for values in given.values()] if has["organ"] else None,
    )
