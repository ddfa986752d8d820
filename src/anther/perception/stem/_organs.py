"""Which organ each skeleton node belongs to: main stem, branch or petiole, truss, or leaf. J nodes, F flowers.

Four observations distinguish organs, whatever the plant and its size:

- An axis (stem, branch, petiole, peduncle) is about as thick as broad, and not broader than the main stem that carries
  it; a blade is broader than the stem and many times broader than thick.
- An axis is some stem widths long; the lines of a blade may begin with a shorter piece that resembles one.
- Nothing grows out of a blade: the axes of a plant are a connected part of the tree that holds the root.
- A limb of a leafy plant ends in leaves or flowers. One that carries flowers and no leaf is a truss; one that carries
  neither is itself a narrow leaf, a stump or an error of the skeleton, and counts as leaf.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anther.core.geometry import Array
from anther.perception.skeleton import Skeleton
from anther.perception.skeleton.raw_tree import chains, edge_lengths, sum_below

STEM, BRANCH, TRUSS, LEAF = range(4)
ORGAN_NAMES = ("stem", "branch", "truss", "leaf")
"""A petiole is a branch; peduncle and pedicels are truss; blade, midrib and veins are leaf, a rachis either."""

PLANAR_BLADE = 0.68
"""Flatness at which a node is as likely on a blade as on an axis (read off the development plants)."""
SPUR = 2.5
"""Shorter limbs, relative to the stem's half width, are no axis; shorter leaves are not attached to the stem."""
PEDICEL = 0.015
"""Length of a pedicel [m]: 9 to 22 mm (facts: pollination 2)."""


def classify(skeleton: Skeleton, main: NDArray[Any], flowers_at: Array) -> NDArray[np.uint8]:
    """Return (J,) the organ of every node, with the main stem's nodes and the centres of flowers (F, 3) [m] given.

    A node bears flowers within two pedicels if it is at most four times as broad as the stem, as pedicels make a truss.
    A limb is a truss when it has less than 20 mm of leaf for each of its flowers.
    """
    breadth = skeleton.breadth / stem_breadth(skeleton, main)
    bears, near_flower = _flower_bearers(skeleton.nodes, flowers_at, breadth < 4, 2 * PEDICEL)
    axis = _axes(skeleton, main, breadth)
    organ = np.where(axis, BRANCH, LEAF).astype(np.uint8)
    organ[main] = STEM
    length = edge_lengths(skeleton.nodes, skeleton.parent)
    is_truss = sum_below(skeleton.parent, 0.02 * bears - length * ((organ == LEAF) & ~near_flower)) > 0
    is_truss &= sum_below(skeleton.parent, bears) > 0
    is_bare = (organ == BRANCH) & (sum_below(skeleton.parent, organ == LEAF) == 0)
    is_bare &= length[is_bare].sum() < length[organ == LEAF].sum()  # else the plant is leafless
    return _limbs_named(skeleton.parent, organ, is_truss, is_bare)


def stem_breadth(skeleton: Skeleton, main: NDArray[Any]) -> float:
    """Return the median half width of the main stem [m]."""
    return float(np.median(skeleton.breadth[main]))


def _flower_bearers(
    nodes: Array, flowers_at: Array, may_bear: NDArray[np.bool_], reach: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Return (J,) how many flowers each node bears, being the nearest within reach, and which are in reach of one."""
    bears, near_flower = np.zeros(len(nodes)), np.zeros(len(nodes), dtype=bool)
    if len(flowers_at):
        some = np.flatnonzero(may_bear)
        away, nearest = map(np.asarray, KDTree(nodes[some]).query(flowers_at))
        np.add.at(bears, some[nearest[away <= reach]], 1)
        near_flower[some] = KDTree(flowers_at).query(nodes[some])[0] <= reach
    return bears, near_flower


def _axes(skeleton: Skeleton, main: NDArray[Any], breadth: Array) -> NDArray[np.bool_]:
    """Return (J,) which nodes lie on an axis: the rooted part of the tree with the most evidence of being slender.

    Every edge gives its length times a number from -1 (blade) to 1 (axis), the sum of two: the logarithm of how much
    narrower it is than the stem, and how little its surroundings are a plane. The rooted part with the largest sum is
    found from the tips down, so a contact with a neighbouring leaf does not end a branch that goes on beyond it.
    """
    if skeleton.width is None or skeleton.flatness is None:  # of another program: its leaves are unknown
        return np.ones(len(breadth), dtype=bool)
    length = edge_lengths(skeleton.nodes, skeleton.parent)
    narrowest = 4.0  # times narrower than the main stem: certainly an axis
    narrow = -np.log(breadth) / np.log(narrowest)
    gain = length * np.clip(narrow + 4 * (PLANAR_BLADE - skeleton.flatness), -1, 1)
    axis = np.isin(np.arange(len(gain)), main)
    for j in range(len(gain) - 1, 0, -1):
        gain[skeleton.parent[j]] += max(gain[j], 0)
    for j in range(1, len(gain)):
        axis[j] |= axis[skeleton.parent[j]] and gain[j] > 0
    axis[_stubs(skeleton.parent, length, axis, SPUR * stem_breadth(skeleton, main))] = False
    axis[main] = True
    return axis


def _stubs(parent: NDArray[Any], length: Array, axis: NDArray[np.bool_], least: float) -> NDArray[Any]:
    """Return the nodes of the limbs whose axes are not as long as `least` [m].

    Lines of a blade that part at its base begin so, and so do lines that run into a stem from a blade that touches it.
    """
    limbs = (chain[1:] for chain in chains(parent, length * axis)[1:])
    return np.concatenate([np.zeros(0, dtype=np.int64), *(j for j in limbs if length[j][axis[j]].sum() < least)])


def _limbs_named(
    parent: NDArray[Any], organ: NDArray[np.uint8], is_truss: NDArray[np.bool_], is_bare: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    """Return the organs with limbs that are trusses, or bare and then leaf, named so from their first node on."""
    organ = organ.copy()
    side = np.bincount(parent[1:], weights=organ[1:] != STEM, minlength=len(parent))
    for j in range(1, len(parent)):
        below = organ[parent[j]]
        begins = below == STEM or (below == BRANCH and side[parent[j]] > 1)
        if organ[j] == STEM:
            continue
        if below in (TRUSS, LEAF):
            organ[j] = below
        elif begins and is_truss[j]:
            organ[j] = TRUSS
        elif begins and is_bare[j]:
            organ[j] = LEAF
    return organ
