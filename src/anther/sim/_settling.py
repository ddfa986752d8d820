"""Where a stem that its string holds up lies: where nothing bends it. K segments, of which m are the stem's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from anther.core.geometry import Array
from anther.sim.plant import GRAVITY, SimPlant


def settle(
    plant: SimPlant, segments: NDArray[np.intp], top: int, wanted: Array, lifted: float
) -> tuple[SimPlant, float, Array]:
    """Return the plant with one stem where the pull of its string puts it, the tension [N], and the hook (3,).

    Below the string's topmost hold nothing bends the stem: each of its points lies where the sum of the pull and of all
    weight above has no moment. What the stem carries moves along with it.

    Args:
        plant: its shape is nearly that.
        segments: (m,) of the stem, from its foot to its tip.
        top: which of them ends at the topmost hold.
        wanted: (3,) the hook's height is kept, the rest follows from the pull [m].
        lifted: share of the tension that is left at the foot.
    """
    station = _stations(plant, segments)
    on = station >= 0
    own = plant.mass + plant.lump_mass
    centre = plant.mass[:, None] * (plant.start + plant.end) / 2 + plant.lump_mass[:, None] * plant.lump_centre
    weight: Array = np.asarray(GRAVITY * np.bincount(station[on], own[on], len(segments)), dtype=np.float64)
    lever = centre - own[:, None] * plant.end[segments[np.maximum(station, 0)]]
    sums = [np.bincount(station[on], lever[on, i], len(segments)) for i in range(2)]
    moment: Array = np.asarray(GRAVITY * np.stack(sums, axis=1), dtype=np.float64)
    pull = float(weight.sum()) / (1 - lifted)
    ends, held = plant.end[segments], plant.end[segments[top]]
    foot = plant.start[segments[0]]
    still, slanting = (_thrust_line(ends, weight, moment, top, pull, level) for level in (0.0, 1.0))
    level = (foot[:2] - still[0]) / (slanting[0] - still[0])
    path = still[1:] + (slanting - still)[1:] * level
    along = np.cumsum(plant.length[segments])
    shift = _smooth(path - ends[:, :2], along) * np.clip(along / 0.1, 0, 1)[:, None]
    shift[top:] = shift[top]
    moved = np.hstack([shift, np.zeros((len(shift), 1))])
    hook = held + moved[top] + np.append(level / pull, 1.0) * (wanted[2] - held[2])
    return _shifted(plant, segments, station, moved), float(pull * np.hypot(1, np.hypot(*level) / pull)), hook


def _stations(plant: SimPlant, segments: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return (K,) the place in `segments` (m,) of that which each segment is or grows on; -1 for others."""
    station = np.full(len(plant.parent), -1)
    station[segments] = np.arange(len(segments))
    first, last = segments[0], segments[-1]
    for k in range(first, len(station)):
        parent = plant.parent[k]
        if station[k] < 0 and parent >= first and (parent <= last or k > last):
            station[k] = station[parent]
    return station


def _thrust_line(ends: Array, weight: Array, moment: Array, top: int, pull: float, level: float) -> Array:
    """Return (m + 1, 2) where foot and ends (m, 3) of a stem's segments lie so that nothing bends it below `top`.

    Args:
        ends: of segments, from the foot up [m].
        weight: (m,) of each and what grows on it [N].
        moment: (m, 2) of that about its end [N m].
        top: the one whose end the string holds.
        pull: upward force of the string [N].
        level: its force along x and y [N].
    """
    place, above = ends[:, :2].copy(), slice(top, None)
    lifted = pull * ends[top, :2] - (weight[above, None] * place[above] + moment[above]).sum(axis=0)
    force = pull - weight[above].sum()
    out = np.vstack([place[:1], place])
    for j in range(top - 1, -2, -1):
        height = ends[j, 2] if j >= 0 else ends[0, 2]
        out[j + 1] = (lifted - level * (ends[top, 2] - height)) / force
        if j >= 0:
            lifted = lifted - weight[j] * out[j + 1] - moment[j]
            force -= weight[j]
    return out


def _smooth(values: Array, along: Array, width: float = 0.06) -> Array:
    """Return values (m, 2) along a stem (m,) [m] smoothed over `width`: in so far a stem's stiffness rounds corners."""
    kernel = np.exp(-(((along[:, None] - along) / width) ** 2) / 2)
    return kernel @ values / kernel.sum(axis=1, keepdims=True)


def _shifted(plant: SimPlant, segments: NDArray[np.intp], station: NDArray[np.intp], shift: Array) -> SimPlant:
    """Return the plant with the ends of a stem's segments shifted (m, 3) [m]; what grows there goes along."""
    before = np.vstack([np.zeros(3), shift])
    own, on = np.zeros(len(station), dtype=bool), station >= 0
    own[segments] = True
    end = np.where(on[:, None], shift[station], 0.0)
    start = np.where(own[:, None], before[np.maximum(station, 0)], end)
    share = np.zeros(len(plant.vertices))
    rides = np.maximum(plant.vertex_segment, 0)
    along, length = (plant.end - plant.start)[rides], plant.length[rides]
    share = np.clip(np.einsum("ni,ni->n", plant.vertices - plant.start[rides], along) / length**2, 0, 1)
    way = start[rides] + share[:, None] * (end - start)[rides]
    way[plant.vertex_segment < 0] = 0
    return replace(
        plant,
        start=plant.start + start,
        end=plant.end + end,
        lump_centre=plant.lump_centre + (start + end) / 2,
        vertices=plant.vertices + way,
        flower_position=plant.flower_position + end[plant.flower_segment],
    )
