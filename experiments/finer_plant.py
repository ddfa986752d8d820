"""A simulated plant whose long segments are divided, so that MuJoCo can bend them in more than one place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from anther.geometry import Array
from anther.sim.plant import SimPlant


def divided(plant: SimPlant, longest: float) -> SimPlant:
    """Return the same plant with no segment longer than `longest` [m].

    `sim.plant_mechanics` puts hinges between segments, and a petiole or midrib has two to four of them, 45 to 70 mm
    long: its lowest modes come out 7 to 15 % slow. Looks ride on the last part of a segment.
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
    mass, centre = np.zeros(len(of)), (start + end) / 2
    mass[carries] = plant.lump_mass
    centre[carries[plant.lump_mass > 0]] = plant.lump_centre[plant.lump_mass > 0]
    rides = plant.vertex_segment
    return replace(
        plant,
        start=start,
        end=end,
        radius_start=along(plant.radius_start, plant.radius_end, begins),
        radius_end=along(plant.radius_start, plant.radius_end, ends),
        parent=np.where(part > 0, np.arange(len(of)) - 1, above),
        **{name: getattr(plant, name)[of] for name in ("organ", "youngs", "density", "damping_ratio")},
        lump_mass=mass,
        lump_centre=centre,
        flower_segment=last[plant.flower_segment],
        vertex_segment=np.where(rides >= 0, last[rides], -1).astype(np.int32),
    )
