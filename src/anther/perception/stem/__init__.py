"""Stem: the main stem within the skeleton, and which organ each skeleton node belongs to. S stem samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from anther.core.errors import StageFailure, bad_input
from anther.core.geometry import Array
from anther.core.records import Range, Record, Shape, Share, Stored
from anther.perception.skeleton import LARGEST, SMALLEST, Skeleton, nearest_node
from anther.perception.skeleton.raw_tree import edge_lengths, longest_way
from anther.perception.stem._main_axis import SHORTEST, fork_at, main_axis
from anther.perception.stem._organs import (
    BRANCH,
    LEAF,
    ORGAN_NAMES,
    PEDICEL,
    SPUR,
    STEM,
    TRUSS,
    classify,
    stem_breadth,
)
from anther.perception.stem.confidence import doubt, find_second_stem, rise_share, stem_confidence

__all__ = [
    "BRANCH", "LEAF", "ORGAN_NAMES", "PEDICEL", "STEM", "TRUSS", "Params", "Stem",
    "find_stem",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Params(Record):
    """What a user may know.

    Attributes:
        tip: where the main stem ends [m], if known; None: it is found.
    """

    tip: Annotated[tuple[float, float, float], Range(-1e9, 1e9, "m")] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Stem(Stored):
    """The main stem as an ordered path of skeleton nodes, root first.

    Attributes:
        node_ids: (S,) skeleton nodes from the root to the stem's top.
        arc_length: (S,) distance from the root along the stem [m].
        attachments: (A,) positions within node_ids where a branch, petiole, truss or leaf leaves the stem.
        organ: (J,) uint8 per skeleton node: STEM, BRANCH (also petioles), TRUSS or LEAF.
        fork: position within node_ids of the first fork, above which the stem is one of several (pepper); the last
            position when there is none.
        notes: what the stage wants the user to know.
        confidence: probability that at least 95 % of its length lies within 5 mm of the true main axis
            (docs/confidence.md); None if unknown.
    """

    KIND, SCHEMA, CALLED = "stem", 4, "stem"
    node_ids: Annotated[NDArray[np.int64], Shape("S")]
    arc_length: Annotated[Array, Shape("S"), Range(unit="m")]
    attachments: Annotated[NDArray[np.int64], Shape("A")]
    organ: Annotated[NDArray[np.uint8], Shape("J")]
    fork: int = -1
    notes: tuple[str, ...] = ()
    confidence: Share | None = None

    def _check(self) -> None:
        n = len(self.node_ids)
        if n < 2 or np.any(np.diff(self.arc_length) <= 0):
            raise bad_input("stem", given=f"{n} nodes", allowed="two or more, root first", do="Order the nodes.")
        if np.any(self.organ >= len(ORGAN_NAMES)):
            given, allowed = f"kind {int(self.organ.max())}", f"0 to {len(ORGAN_NAMES) - 1}: {', '.join(ORGAN_NAMES)}"
            raise bad_input("organ", given=given, allowed=allowed, do="Find the stem again.")
        if not 0 <= self.node_ids.min() <= self.node_ids.max() < len(self.organ):
            given, allowed = f"node {int(self.node_ids.max())}", f"one of the {len(self.organ)} with an organ"
            raise bad_input("stem nodes", given=given, allowed=allowed, do="Find the stem again.")
        if not -n <= self.fork < n:
            raise bad_input("stem fork", given=self.fork, allowed=f"a position in {n} nodes", do="Find the stem again.")
        object.__setattr__(self, "fork", int(self.fork) % n)

    def organ_names(self) -> list[str]:
        """Return "stem", "branch", "truss" or "leaf" for every skeleton node."""
        return [ORGAN_NAMES[kind] for kind in self.organ]


def find_stem(skeleton: Skeleton, params: Params | None = None, *, flowers_at: Array | None = None) -> Stem:
    """Return the main stem, the root-to-tip path with the best score S up to its last limb, and all organs.

    It ends where it leaves its growth axis. Where a plant forks (pepper), the better fork goes on as the main stem and
    the other is a branch.

    Args:
        skeleton: one rooted tree.
        params: see `Params`.
        flowers_at: (F, 3) centres of flowers (`flowers.flower_centres`) [m]; without them no node is TRUSS.

    Raises:
        StageFailure: "no_stem_found" when no path rises far enough to be a stem.
        InputError: `params.tip` is not on the plant.
    """
    params = params or Params()
    size = float(np.linalg.norm(np.ptp(skeleton.nodes, axis=0)))
    if params.tip is None:
        node_ids, path = main_axis(skeleton, size)
    else:
        node_ids = path = skeleton.path_from_root(nearest_node("the main stem's tip", params.tip, skeleton.nodes))
    nodes = skeleton.nodes[node_ids]
    arc_length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(nodes, axis=0), axis=1))])
    _plausible(nodes, arc_length, size)
    flowers_at = np.zeros((0, 3)) if flowers_at is None else flowers_at
    organ = classify(skeleton, node_ids, flowers_at)
    attachments = _attachments(skeleton, node_ids, organ)
    forked = [fork_at(skeleton, path, organ, int(i)) for i in attachments]
    fork = min([len(node_ids) - 1, *(i for i in forked if i is not None)])
    confidence = stem_confidence(skeleton, node_ids)
    notes = (*_low(skeleton, node_ids), *find_second_stem(skeleton, node_ids), *doubt(confidence))
    return Stem(node_ids, arc_length, attachments, organ, fork, notes, confidence)


LOW = 0.25
"""A main stem that rises by less than this share of the plant is doubted: a guess."""


def _low(skeleton: Skeleton, node_ids: NDArray[Any]) -> tuple[str, ...]:
    share, height = rise_share(skeleton, node_ids), 1e3 * (skeleton.nodes[:, 2].max() - skeleton.nodes[0, 2])
    if share >= LOW:
        return ()
    return (f"main stem: it rises only {share * height:.0f} mm of the plant's {height:.0f} mm; is the root right?",)


def _attachments(skeleton: Skeleton, node_ids: NDArray[Any], organ: NDArray[Any]) -> NDArray[Any]:
    """Return the positions within the stem where more than a spur leaves it."""
    way = longest_way(skeleton.parent, edge_lengths(skeleton.nodes, skeleton.parent))
    long = way > SPUR * stem_breadth(skeleton, node_ids)
    leaves = (organ[1:] != STEM) & (organ[skeleton.parent[1:]] == STEM) & ((organ[1:] != LEAF) | long[1:])
    return np.flatnonzero(np.isin(node_ids, skeleton.parent[1:][leaves]))


def _plausible(nodes: Array, arc_length: Array, size: float) -> None:
    rise = nodes[:, 2].max() - nodes[0, 2]
    if not SMALLEST <= size <= LARGEST:
        problem = f"the plant measures {size:g} m (allowed: {SMALLEST:g} to {LARGEST:g} m). Wrong units?"
    elif arc_length[-1] < SHORTEST * size:
        problem = (
            f"the best candidate is {arc_length[-1] * 1e3:.1f} mm long on a plant of {size * 1e3:.0f} mm "
            f"(allowed: {SHORTEST:g} of the plant or more). Is the stem in view?"
        )
    elif rise < 0.2 * arc_length[-1]:
        problem = (
            f"the best candidate of {arc_length[-1] * 1e3:.1f} mm rises only {rise * 1e3:.1f} mm "
            "(allowed: a fifth of its length or more). Is z up?"
        )
    else:
        return
    raise StageFailure("no_stem_found", f"main stem: {problem}")
