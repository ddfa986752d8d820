"""Skeletons as MTG text, the plant-architecture format of OpenAlea. J nodes, metres, z up.

Format: C. Godin and Y. Caraglio, "A multiscale model of plant topological structures", J. theor. Biol. 191 (1998), and
https://mtg.readthedocs.io (file format, FORM-A); the layout is the one openalea.mtg's `write_mtg` makes. Scale 1 is the
plant, scale 2 its nodes: class Stem, Branch, ... (or Node), numbered from 1, with XX, YY, ZZ and radius [m].
`<` continues an axis, `+` branches off. In the text a column is a branching order, `^` is the last entity in
the same column.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from anther.core.errors import bad_input
from anther.core.files import read_lines, write_text
from anther.core.geometry import Array
from anther.perception.formats.skeleton_file import SkeletonFile, rooted
from anther.perception.skeleton import Skeleton

FEATURES = ("XX", "YY", "ZZ", "radius")

_ENTITY = re.compile(r"(\^?)([/<+])([A-Za-z]+)(\d*)$")


def write_mtg(path: Path | str, skeleton: Skeleton, labels: Sequence[str] | None = None) -> None:
    """Write a skeleton as MTG.

    Where nodes have several children, the axis goes on through the child with the same label that carries most
    length, else through the one that carries most length; the others branch off.
    """
    write_text(path, "\n".join([*_header(list(dict.fromkeys(labels or ("node",)))), *_code(skeleton, labels)]) + "\n")


def read_mtg(path: Path | str) -> SkeletonFile:
    """Read the vertices of an MTG that have XX, YY, ZZ [m], as one tree; radius [m] and classes where it has them.

    Vertices without coordinates (plant, axes) only state where the tree begins.
    """
    lines = [line.split("#")[0].rstrip() for line in read_lines(path)]
    heads = [i for i, line in enumerate(lines) if line.startswith("ENTITY-CODE")]
    if not heads:
        raise bad_input(str(path), given="no line ENTITY-CODE", allowed="an MTG file", do="Is it truncated?")
    columns = lines[heads[0]].split("\t")
    if not {"XX", "YY", "ZZ"} <= set(columns):
        do = "Export it with coordinates."
        raise bad_input(str(path), given=f"features {columns[1:]}", allowed="XX, YY, ZZ", do=do)
    first = min(i for i, name in enumerate(columns) if i and name)
    return _parsed(str(path), [line for line in lines[heads[0] + 1 :] if line.strip()], columns, first)


def _header(classes: list[str]) -> Iterator[str]:
    symbols = [name.capitalize() for name in classes]
    yield from ("CODE :\tFORM-A", "", "CLASSES :", "SYMBOL\tSCALE\tDECOMPOSITION\tINDEXATION\tDEFINITION")
    yield "$\t0\tFREE\tFREE\tIMPLICIT"
    yield "Plant\t1\tFREE\tFREE\tEXPLICIT"
    yield from (f"{symbol}\t2\tFREE\tFREE\tEXPLICIT" for symbol in symbols)
    yield from ("", "DESCRIPTION :", "LEFT\tRIGHT\tRELTYPE\tMAX")
    yield from (f"{left}\t{','.join(symbols)}\t{relation}\t?" for left in symbols for relation in "<+")
    yield from ("", "FEATURES :", "NAME\tTYPE", *(f"{name}\tREAL" for name in FEATURES), "", "MTG :")


def _code(skeleton: Skeleton, labels: Sequence[str] | None) -> Iterator[str]:
    """Yield the entity lines, depth first: branches before the axis goes on, which is what `^` needs."""
    goes_on = successors(skeleton, labels)
    children: list[list[int]] = [[] for _ in skeleton.nodes]
    order = np.zeros(len(skeleton.nodes), dtype=np.int64)
    for j in range(1, len(skeleton.nodes)):
        children[skeleton.parent[j]].append(j)
        order[j] = order[skeleton.parent[j]] + (goes_on[skeleton.parent[j]] != j)
    width = int(order.max()) + 1
    yield "\t".join(["ENTITY-CODE", *[""] * (width - 1), *FEATURES])
    yield "\t".join(["/Plant1", *[""] * (width - 1 + len(FEATURES))])
    waiting = [0]
    while waiting:
        j = waiting.pop()
        relation = "^/" if j == 0 else "^<" if goes_on[skeleton.parent[j]] == j else "+"
        name = "Node" if labels is None else labels[j].capitalize()
        cells = [""] * width
        cells[order[j]] = f"{relation}{name}{j + 1}"
        yield "\t".join([*cells, *(f"{value:.10g}" for value in (*skeleton.nodes[j], skeleton.radius[j]))])
        waiting += sorted(children[j], key=lambda child, here=goes_on[j]: child != here)


def successors(skeleton: Skeleton, labels: Sequence[str] | None = None) -> list[int]:
    """Return for every node the child that continues its axis, rather within one organ; -1 at a tip."""
    count = len(skeleton.nodes)
    beyond = np.zeros(count)
    best = [(False, -1.0, -1)] * count
    for j in range(count - 1, 0, -1):
        above = int(skeleton.parent[j])
        carried = float(beyond[j] + np.linalg.norm(skeleton.nodes[j] - skeleton.nodes[above]))
        beyond[above] += carried
        best[above] = max(best[above], (labels is not None and labels[j] == labels[above], carried, j))
    return [child for _, _, child in best]


def _parsed(path: str, lines: list[str], columns: list[str], first: int) -> SkeletonFile:
    last: dict[int, int | None] = {}  # column -> index of its last node; None for an entity without coordinates
    nodes: list[Array] = []
    above: list[int | None] = []
    names: list[tuple[str, str]] = []
    for line in lines:
        cells = line.split("\t")
        column = next(i for i, cell in enumerate(cells) if cell)
        found = _ENTITY.match(cells[column].strip())
        if found is None or column >= first:
            given, allowed = f"entity '{cells[column]}'", "[^] / < + Class number"
            raise bad_input(path, given=given, allowed=allowed, do="One entity a line, please.")
        values = dict(zip(columns[first:], cells[first:], strict=False))
        parent = last.get(column if found[1] else column - 1)
        last = {at: node for at, node in last.items() if at < column}
        last[column] = None
        given = [bool(values.get(axis)) for axis in FEATURES[:3]]
        if any(given) and not all(given):
            raise bad_input(path, given=f"only some of XX, YY, ZZ in '{line.strip()}'", allowed="all", do="Is it cut?")
        if all(given):
            last[column] = len(nodes)
            nodes.append(np.array([float(values.get(name) or "nan") for name in FEATURES]))
            above.append(parent)
            names.append((found[3].lower(), found[4]))
    if not nodes or above.count(None) != 1:
        raise bad_input(path, given=f"{above.count(None)} trees with coordinates", allowed="one", do="Keep one plant.")
    return _as_tree(np.array(nodes), above, names)


def _as_tree(table: Array, above: list[int | None], names: list[tuple[str, str]]) -> SkeletonFile:
    edges = np.array([(p, j) for j, p in enumerate(above) if p is not None], dtype=np.int64).reshape(-1, 2)
    numbers = [int(digits) if digits else -1 for _, digits in names]
    return rooted(
        table[:, :3],
        edges,
        radius=table[:, 3] if np.isfinite(table[:, 3]).all() else None,
        numbers=np.array(numbers) if len(set(numbers)) == len(numbers) else None,
        root=above.index(None),
        labels=None if {name for name, _ in names} == {"node"} else [name for name, _ in names],
    )
