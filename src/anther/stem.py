"""Stem: the main stem within the skeleton, and which organ each skeleton node belongs to. S stem samples."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.checks import check_array
from anther.errors import StageFailure, bad_input
from anther.files import read_npz, write_npz
from anther.geometry import Array
from anther.skeleton import Skeleton
from anther.skeleton.raw_tree import chains, path_gain

STEM, BRANCH = 0, 1

_KIND, _SCHEMA = "stem", 2
_FORK_NODES = 6  # nodes after a fork whose median radius is compared
_ROUND = 1.5  # sections up to this much broader than thick count as round: noise and one-sided views do that


@dataclass(frozen=True, slots=True)
class Params:
    """What makes a path the main stem (paper P10, P11).

    Attributes:
        alpha: exponent of the mean radius in the path score S.
        v_bias: weight of verticality in S.
        turn: a step that turns from the growth axis by more than this is not stem-like [degrees].
        window: length over which a step is judged (share of the plant's size).
        flattest: nor is a blade: a step broader than thick by more than this factor,
        broadest: and broader, and flatter, than the median so far by more than this factor.
        thinnest: nor one thinner than this share of the median radius so far.
        doubt: how much a length that is not stem-like counts against one that is.
        shortest: a shorter stem is not believed (share of the plant's size).
        fork_share: a branch forks the stem when it is at least this share as thick as the stem beyond it and rises at
            least this share as high,
        fork_angle: and on the whole leans from the vertical by less than this [degrees].
    """

    alpha: float = 2.0
    v_bias: float = 1.0
    turn: float = 45.0
    window: float = 0.06
    flattest: float = 1.6
    broadest: float = 1.4
    thinnest: float = 0.35
    doubt: float = 2.0
    shortest: float = 0.05
    fork_share: float = 0.5
    fork_angle: float = 50.0


@dataclass(frozen=True, slots=True, eq=False)
class Stem:
    """The main stem as an ordered path of skeleton nodes, root first.

    Attributes:
        node_ids: (S,) skeleton nodes from the root to the stem's top.
        arc_length: (S,) distance from the root along the stem [m].
        attachments: (A,) positions within node_ids where a branch or petiole leaves the stem.
        organ: (J,) uint8 per skeleton node: STEM or BRANCH.
        fork: position within node_ids of the first fork, above which the stem is one of several (pepper); the last
            position when there is none.
        notes: what the stage wants the user to know.
    """

    node_ids: NDArray[Any]
    arc_length: Array
    attachments: NDArray[Any]
    organ: NDArray[Any]
    fork: int = -1
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.node_ids)
        object.__setattr__(self, "node_ids", check_array("stem nodes", self.node_ids, (n,), dtype="int64"))
        object.__setattr__(self, "arc_length", check_array("stem arc length", self.arc_length, (n,)))
        object.__setattr__(self, "attachments", check_array("attachments", self.attachments, (None,), dtype="int64"))
        object.__setattr__(self, "organ", check_array("organ", self.organ, (None,), dtype="uint8"))
        if n < 2 or np.any(np.diff(self.arc_length) <= 0):
            raise bad_input("stem", given=f"{n} nodes", allowed="two or more, root first", do="Order the nodes.")
        if not -n <= self.fork < n:
            raise bad_input("stem fork", given=self.fork, allowed=f"a position in {n} nodes", do="Find the stem again.")
        object.__setattr__(self, "fork", int(self.fork) % n)

    def save(self, path: Path | str) -> None:
        """Write an .npz (schema 2)."""
        write_npz(
            path,
            _KIND,
            _SCHEMA,
            node_ids=self.node_ids,
            arc_length=self.arc_length,
            attachments=self.attachments,
            organ=self.organ,
            fork=self.fork,
            notes=np.array(self.notes, dtype=np.str_),
        )

    @classmethod
    def load(cls, path: Path | str) -> Stem:
        """Read what `save` wrote.

        Raises:
            InputError: missing, truncated, or of another kind or schema.
        """
        a = read_npz(path, _KIND, _SCHEMA)
        notes = tuple(str(note) for note in a["notes"])
        return cls(a["node_ids"], a["arc_length"], a["attachments"], a["organ"], int(a["fork"]), notes)


def find_stem(skeleton: Skeleton, params: Params | None = None) -> Stem:
    """Return the main stem: the best root-to-tip path by score S, ended where it leaves its growth axis.

    Where a plant forks (pepper), the better fork goes on as the main stem and the other is a branch.

    Args:
        skeleton: one rooted tree.
        params: one set for every plant.

    Raises:
        StageFailure: "no_stem_found" when no path rises far enough to be a stem.
    """
    params = params or Params()
    size = float(np.linalg.norm(np.ptp(skeleton.nodes, axis=0)))
    path = chains(skeleton.parent, _gain(skeleton, params))[0]
    end = _growth_end(skeleton, path, size, params)
    node_ids = path[:end]
    nodes = skeleton.nodes[node_ids]
    arc_length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(nodes, axis=0), axis=1))])
    _plausible(nodes, arc_length, size, params)
    organ = np.full(len(skeleton.nodes), BRANCH, dtype=np.uint8)
    organ[node_ids] = STEM
    branches = np.flatnonzero((organ[1:] == BRANCH) & (organ[skeleton.parent[1:]] == STEM)) + 1
    attachments = np.flatnonzero(np.isin(node_ids, skeleton.parent[branches]))
    forks = [i for i in attachments if _forks(skeleton, path, organ, int(i), params)]
    return Stem(node_ids, arc_length, attachments, organ, int(min(forks, default=len(node_ids) - 1)))


def _forks(skeleton: Skeleton, path: NDArray[Any], organ: NDArray[Any], at: int, params: Params) -> bool:
    """Whether a branch that leaves the stem at position `at` of the path is as much a stem as what goes on."""
    base = skeleton.nodes[path[at]]
    beyond = path[at + 1 :]
    if not len(beyond):
        return False
    rise = float(skeleton.nodes[beyond, 2].max() - base[2])
    thick = float(np.median(skeleton.radius[beyond[:_FORK_NODES]]))
    for child in np.flatnonzero((skeleton.parent == path[at]) & (organ == BRANCH)):
        limb = _highest_path(skeleton, int(child))
        lean = _angle(skeleton.nodes[limb[-1]] - base, np.array([0.0, 0.0, 1.0]))
        higher = skeleton.nodes[limb[-1], 2] - base[2] >= params.fork_share * rise
        thicker = np.median(skeleton.radius[limb[:_FORK_NODES]]) >= params.fork_share * thick
        if higher and thicker and lean < params.fork_angle:
            return True
    return False


def _highest_path(skeleton: Skeleton, start: int) -> NDArray[Any]:
    """Return the nodes from `start` to the highest node of its subtree."""
    inside = np.zeros(len(skeleton.nodes), dtype=bool)
    inside[start] = True
    for j in range(start + 1, len(skeleton.nodes)):
        inside[j] = inside[skeleton.parent[j]]
    top = int(np.argmax(np.where(inside, skeleton.nodes[:, 2], -np.inf)))
    whole = skeleton.path_from_root(top)
    return whole[np.flatnonzero(whole == start)[0] :]


def _gain(skeleton: Skeleton, params: Params) -> Array:
    """Return what each edge adds to the path score (P10); less on a blade, by how much broader than thick it is."""
    gain = path_gain(skeleton.nodes, skeleton.parent, skeleton.radius, alpha=params.alpha, v_bias=params.v_bias)
    if skeleton.width is None:
        return gain
    return gain * np.minimum(_ROUND * skeleton.radius / skeleton.width, 1)


def _growth_end(skeleton: Skeleton, path: NDArray[Any], size: float, params: Params) -> int:
    """Return how many nodes of the path belong to the stem (P11).

    Every step is stem-like or not: whether it turns from the growth axis (root to here), thins, or broadens to a blade.
    The stem ends where the length that is stem-like, less `doubt` times the length that is not, is largest, so that
    a leaf that touches the stem does not end it, but the blade after which nothing stem-like comes does.
    """
    nodes = skeleton.nodes[path]
    length = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
    arc = np.concatenate([[0], np.cumsum(length)])
    like = _stem_like(skeleton, path, arc, params.window * size, params)
    gain = np.cumsum(length * np.where(like, 1.0, -params.doubt))
    return int(np.argmax(gain)) + 2


def _stem_like(skeleton: Skeleton, path: NDArray[Any], arc: Array, window: float, params: Params) -> NDArray[np.bool_]:
    """Return (S - 1,) whether each step of the path looks like stem, over the window ahead of it."""
    nodes, radius = skeleton.nodes[path], skeleton.radius[path]
    width = radius if skeleton.width is None else skeleton.width[path]
    flatness = width / radius
    ahead = np.minimum(np.searchsorted(arc, arc + window), len(path) - 1)
    like = np.ones(len(path) - 1, dtype=bool)
    for i in np.flatnonzero(arc[:-1] >= window):
        coming = slice(i, max(ahead[i], i + 1) + 1)
        turned = _angle(nodes[i] - nodes[0], nodes[coming][-1] - nodes[i]) > params.turn
        thin = np.median(radius[coming]) < params.thinnest * np.median(radius[: i + 1])
        usual = params.broadest * np.median(flatness[: i + 1])  # noise and one-sided views flatten stems as well
        flat = np.median(flatness[coming]) > max(params.flattest, usual)
        flat = flat and np.median(width[coming]) > params.broadest * np.median(width[: i + 1])
        like[i] = not (turned or thin or flat)
    return like


def _angle(one: Array, other: Array) -> float:
    """Return the angle between two vectors [degrees]."""
    cosine = one @ other / max(float(np.linalg.norm(one) * np.linalg.norm(other)), 1e-12)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def _plausible(nodes: Array, arc_length: Array, size: float, params: Params) -> None:
    rise = nodes[:, 2].max() - nodes[0, 2]
    if not 0.005 <= size <= 20:
        problem = f"the plant measures {size:g} m (allowed: 0.005 to 20 m). Wrong units?"
    elif arc_length[-1] < params.shortest * size:
        problem = (
            f"the best candidate is {arc_length[-1] * 1e3:.1f} mm long on a plant of {size * 1e3:.0f} mm "
            f"(allowed: {params.shortest:g} of the plant or more). Is the stem in view?"
        )
    elif rise < 0.2 * arc_length[-1]:
        problem = (
            f"the best candidate of {arc_length[-1] * 1e3:.1f} mm rises only {rise * 1e3:.1f} mm "
            "(allowed: a fifth of its length or more). Is z up?"
        )
    else:
        return
    raise StageFailure("no_stem_found", f"main stem: {problem}")
