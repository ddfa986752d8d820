"""A simulated plant whose long segments are divided, so that it bends and twists in more places. K segments."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.geometry import Array
from anther.sim.plant import SimPlant

NEAR = 0.1
"""What is attached nearer to a segment's end than this share of it is as good as at that end."""


def divided(plant: SimPlant, longest: float) -> tuple[SimPlant, NDArray[Any], NDArray[np.bool_]]:
    """Return the same plant with no segment longer than `longest` [m], and (K,) the part that carries each segment.

    Then for each part whether it begins a segment, and so is to be joined with the part before to one rigid piece.

    Where something is attached, at a segment's end or at the centre of what it carries, lies the middle of a rigid
    piece, once these are joined: a rigid piece turns as the stem does at its middle. What a segment carries, and the vertices that ride on it, stay together: leaves keep their inertia.
    """
    unit = (plant.end - plant.start) / plant.length[:, None]
    ahead = np.einsum("kj,kj->k", plant.lump_centre - plant.start, unit) / plant.length
    loaded = plant.lump_mass > 0
    cuts = [_cuts(a if on else 1.0, size / longest) for a, on, size in zip(ahead, loaded, plant.length, strict=True)]
    count = np.array([len(c) - 1 for c in cuts])
    last = np.cumsum(count) - 1
    first, of = last - count + 1, np.repeat(np.arange(len(count)), count)
    part = np.arange(len(of)) - first[of]
    begins, ends = np.concatenate([c[:-1] for c in cuts]), np.concatenate([c[1:] for c in cuts])
    above = np.where(plant.parent[of] >= 0, last[plant.parent[of]], -1)

    def along(start: Array, end: Array, share: Array) -> Array:
        return start[of] + (share * (end - start)[of].T).T

    start, end = (along(plant.start, plant.end, share) for share in (begins, ends))
    carries = first + np.array([np.searchsorted(c[1:-1], a) for c, a in zip(cuts, ahead, strict=True)])
    mass, drag, centre = np.zeros(len(of)), np.zeros(len(of)), (start + end) / 2
    mass[carries], drag[carries] = plant.lump_mass, plant.drag_area
    centre[carries[loaded]] = plant.lump_centre[loaded]
    rides = plant.vertex_segment
    finer = replace(
        plant,
        start=start,
        end=end,
        radius_start=along(plant.radius_start, plant.radius_end, begins),
        radius_end=along(plant.radius_start, plant.radius_end, ends),
        parent=np.where(part > 0, np.arange(len(of)) - 1, above),
        **{name: getattr(plant, name)[of] for name in ("organ", "youngs", "density", "damping_ratio", "oval")},
        joint_compliance=np.where(part == 0, plant.joint_compliance[of], 0.0),
        drag_area=drag,
        tie=None if plant.tie is None else (int(last[plant.tie[0]]), plant.tie[1]),
        lump_mass=mass,
        lump_centre=centre,
        flower_segment=carries[plant.flower_segment],
        vertex_segment=np.where(rides >= 0, carries[rides], -1).astype(np.int32),
    )
    return finer, carries, part == 0


def _cuts(attached: float, least: float) -> Array:
    """Return rising shares from 0 to 1, midway between nodes at both ends and at `attached`, at least `least` a unit."""
    nodes = np.array([0.0, attached, 1.0] if NEAR < attached < 1 - NEAR else [0.0, 1.0])
    counts = np.maximum(1, np.ceil(np.diff(nodes) * least - 1e-9)).astype(int)
    parts = [a + (b - a) * (np.arange(n) + 0.5) / n for a, b, n in zip(nodes[:-1], nodes[1:], counts, strict=True)]
    return np.concatenate([[0.0], *parts, [1.0]])
