"""A simulated plant whose long segments are divided, so that it bends and twists in more places. K segments."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core import Array
from anther.sim import SimPlant


def divided(plant: SimPlant, longest: float) -> tuple[SimPlant, NDArray[Any]]:
    """Return the same plant with no segment longer than `longest` [m], and (K,) the part that carries each segment.

    What a segment carries, and the vertices that ride on it, stay together on the part beside their centre: leaves keep
    their inertia.
    """
    count = np.maximum(1, np.ceil(plant.length / longest - 1e-9)).astype(int)
    last = np.cumsum(count) - 1
    first, of = last - count + 1, np.repeat(np.arange(len(count)), count)
    part = np.arange(len(of)) - first[of]
    begins, ends = part / count[of], (part + 1) / count[of]
    above = np.where(plant.parent[of] >= 0, last[plant.parent[of]], -1)

    def along(start: Array, end: Array, share: Array) -> Array:
        return start[of] + (share * (end - start)[of].T).T

    start, end = (along(plant.start, plant.end, share) for share in (begins, ends))
    unit = (plant.end - plant.start) / plant.length[:, None]
    ahead = np.einsum("kj,kj->k", plant.lump_centre - plant.start, unit) / plant.length
    carries = first + np.clip(ahead * count, 0, count - 1).astype(int)
    mass, drag, centre = np.zeros(len(of)), np.zeros(len(of)), (start + end) / 2
    mass[carries], drag[carries] = plant.lump_mass, plant.drag_area
    loaded = plant.lump_mass > 0
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
    return finer, carries
