"""Which axis of a cloud is up, as far as its stem tells: right, it begins thick, round and upright, and rises far."""

from __future__ import annotations

import numpy as np
from small_gicp import voxelgrid_sampling

from anther.cloud import Cloud
from anther.errors import AntherError
from anther.formats.points import Axis
from anther.geometry import Array
from anther.skeleton import skeletonize
from anther.stem import find_stem

TO_Z_UP: dict[Axis, list[int]] = {"x": [1, 2, 0], "y": [2, 0, 1], "z": [0, 1, 2]}
"""Axis that is up -> in which order a file's axes are x, y, z with z up."""
DOUBT = 2.0
"""An axis whose stem is not so many times worse than the best may be up (docs/formats.md)."""
_COARSE = 120
_BASE, _SURE = 0.25, 0.5
"""The cloud is thinned to one point per cube of plant size / 120; a base is the lowest quarter, likelier a stem
than not."""


def axis_notes(points: Array) -> tuple[str, ...]:
    """Return a note where another axis than z is as likely up.

    Args:
        points: (N, 3) as they stand in the file, in any unit that makes a plant of them [m].
    """
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    thin = np.asarray(voxelgrid_sampling(points, size / _COARSE).points())[:, :3]
    worth = {axis: stem_worth(thin[:, order]) for axis, order in TO_Z_UP.items()}
    likely = [axis for axis, value in worth.items() if DOUBT * value >= max(worth.values())]
    if len(likely) > 1:
        return (f"which axis is up is hard to tell ({' or '.join(likely)}): look, and say --up",)
    return () if likely == ["z"] else (f"it looks as if {likely[0]} were up: try --up {likely[0]}",)


def stem_worth(points: Array) -> float:
    """Return how good a stem the points (N, 3) have if z is up; 0 without one, or if its base is likelier none.

    It is the product of how thick the stem's base is over the plant's size, how sure its axis there, how upright the
    stem, and what share of the plant's height it rises.
    """
    try:
        tree = skeletonize(Cloud(np.ascontiguousarray(points)))
        stem = find_stem(tree)
    except AntherError:
        return 0.0
    line, length = tree.nodes[stem.node_ids], float(stem.arc_length[-1])
    base = stem.node_ids[stem.arc_length <= max(_BASE * length, stem.arc_length[1])]
    extent = np.ptp(tree.nodes, axis=0)
    rise = max(float(line[-1, 2] - line[0, 2]), 0.0)
    sure = 0.0 if tree.confidence is None else float(tree.confidence[base].mean())
    if sure < _SURE:
        return 0.0
    thick = float(np.median(tree.radius[base])) / float(np.linalg.norm(extent))
    return thick * sure * rise / length * rise / float(extent[2])
