"""Confidence of the main stem, and evidence for it from the whole plant. J nodes, S stem samples."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core.geometry import Array
from anther.perception.skeleton import Skeleton
from anther.perception.skeleton.raw_tree import BLADE
from anther.perception.skeleton.support import logit, probability

DOUBTFUL = 0.75
"""Below this confidence of stem or grasp the summaries warn."""


def stem_confidence(skeleton: Skeleton, node_ids: NDArray[Any]) -> float | None:
    """Return the probability that at least 95 % of the stem's length lies within 5 mm of the true main axis, that it
    begins where the plant stands included.

    Above a fork (pepper) any of the stems counts as the main axis. None when the skeleton's own confidence is unknown.
    """
    if skeleton.confidence is None:
        return None
    # constant and weights of the evidence in the log-odds: `python -m evaluation.perception.confidence --fit`
    fitted = (-1.20, 1.48, 5.43)
    return skeleton.rooted * float(probability(fitted, stem_evidence(skeleton, node_ids)))


def stem_evidence(skeleton: Skeleton, node_ids: NDArray[Any]) -> Array:
    """Return (2,), larger is better: the log-odds of the stem's mean confidence, and how straight its top is.

    Straightness is 0 less the mean turn from one node to the next [rad] over the stem's upper eighth: most wrong stems
    are right up to their top, where they run on into a leaf or a truss.
    """
    assert skeleton.confidence is not None
    top = skeleton.nodes[node_ids[-max(int(0.12 * len(node_ids)), 2) - 2 :]]
    steps = np.diff(top, axis=0)
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    bend = np.linalg.norm(np.diff(steps, axis=0), axis=1).mean() if len(steps) > 1 else 0.0
    return np.array([logit(skeleton.confidence[node_ids].mean()), -bend])


def plant_evidence(skeleton: Skeleton, node_ids: NDArray[Any]) -> Array:
    """Return (3,), larger is better: evidence for the main stem from the whole plant.

    The log-odds that it begins at the base; the logarithm of the share of the plant's height that it rises
    by (a drooping leaf's tip is low and short); and of how thick its sections are for their breadth (a blade is thin).
    """
    rise = max(rise_share(skeleton, node_ids), 0.02)
    thick = float(np.median(skeleton.radius[node_ids] / skeleton.breadth[node_ids]))
    return np.array([logit(skeleton.rooted), np.log(rise), np.log(thick)])


def rise_share(skeleton: Skeleton, node_ids: NDArray[Any]) -> float:
    """Return by how much a stem (S,) rises above the root, as a share of what the plant does."""
    z = skeleton.nodes[:, 2] - skeleton.nodes[0, 2]
    return float(z[node_ids].max() / max(z.max(), 1e-12))


def doubt(confidence: float | None, what: str = "main stem") -> tuple[str, ...]:
    """Return a warning when the confidence of stem or grasp is below DOUBTFUL."""
    if confidence is None or confidence >= DOUBTFUL:
        return ()
    return (f"{what}: confidence {confidence:.2f} is below {DOUBTFUL:g}; check it before use",)


def find_second_stem(skeleton: Skeleton, node_ids: NDArray[Any]) -> tuple[str, ...]:
    """Return a warning when the tree comes down to the soil a second time: two plants have grown into each other.

    What comes down stands a tenth of the plant's size aside. Its last piece is upright within 35 degrees, at least half
    as thick as the stem's foot, no blade, and does not taper downwards: drooping leaves are thinner, or do.
    """
    nodes, root = skeleton.nodes, skeleton.nodes[0]
    size = float(np.linalg.norm(np.ptp(nodes, axis=0)))
    piece = 0.06 * size
    from_root = np.linalg.norm(nodes[node_ids] - root, axis=1)
    thick = float(np.median(skeleton.radius[node_ids[from_root <= 2 * piece]]))
    low = nodes[:, 2] <= root[2] + piece
    aside = np.linalg.norm(nodes[:, :2] - root[:2], axis=1) >= 0.1 * size
    for tip in np.flatnonzero((skeleton.children_count == 0) & low & aside):
        path = skeleton.path_from_root(int(tip))
        away = np.linalg.norm(nodes[path] - nodes[tip], axis=1)
        down, above = path[away <= piece], path[(away > piece) & (away <= 2 * piece)]
        rise = nodes[down[0]] - nodes[tip]
        upright = rise[2] >= np.cos(np.radians(35)) * max(0.8 * piece, np.linalg.norm(rise))
        foot, higher = (np.median(skeleton.radius[part]) if len(part) else 0.0 for part in (down, above))
        blade = skeleton.flatness is not None and np.median(skeleton.flatness[down]) >= BLADE
        if upright and not blade and foot >= 0.55 * thick and foot >= 0.85 * higher:
            x, y = nodes[tip, :2]
            return (f"main stem: a second stem seems to stand at x, y = {x:.2f}, {y:.2f} m: two plants in one?",)
    return ()
