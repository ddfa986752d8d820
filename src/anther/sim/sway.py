"""A plant in the wind, alone: where its segments are whenever somebody looks. K segments, V views.

The air around a simulated plant: drag that grows with the square of the speed, and gusty wind. B bodies.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from anther.core.checks import check_array
from anther.core.compiling import njit
from anther.core.errors import StageFailure
from anther.core.geometry import Array
from anther.sim.pieces import Params
from anther.sim.plant import SimPlant
from anther.sim.plant_mechanics import PlantMechanics, alone, mujoco


@njit(cache=True, error_model="numpy")
def _blow(wind: Any, factor: Any, bodies: Any, roots: Any, twists: Any, places: Any, middles: Any, force: Any) -> None:
    """Write the drag of each body in a wind into its row of `force`.

    MuJoCo's twists are about the centre of mass of the body's tree, in `middles`; the drag is at its own, in `places`.
    """
    against = np.empty(3)
    for i in range(len(bodies)):
        b, root = bodies[i], roots[i]
        for j in range(3):
            k, n = (j + 1) % 3, (j + 2) % 3
            turned = twists[b, k] * (places[b, n] - middles[root, n]) - twists[b, n] * (places[b, k] - middles[root, k])
            against[j] = wind[j] - twists[b, 3 + j] - turned
        size = math.sqrt(against[0] ** 2 + against[1] ** 2 + against[2] ** 2)
        for j in range(3):
            force[b, j] = factor[i] * size * against[j]


class Air:
    """Drag on the bodies of a plant, at their centres of mass, relative to a wind that is the same everywhere.

    The mean wind blows horizontally from a random side; the speed about it is a first-order Markov process. Its
    standard deviation is 35 % of the mean along the wind (facts: pollination 6), and half of that across it, as in free
    streams: a guess. A gust lasts 1 s, as eddies of a plant's size do at 0.5 to 1 m/s: a guess.
    """

    def __init__(self, mechanics: PlantMechanics, wind: float, seed: int) -> None:
        """Let the air move at `wind` [m/s] in the mean; `seed` gives its side and its gusts."""
        plant, pieces = mechanics.plant, mechanics.pieces
        self._bodies = np.asarray(mechanics.bodies, dtype=np.int64)
        self._roots = mechanics.model.body_rootid[self._bodies].astype(np.int64)
        area = np.bincount(pieces.body, plant.drag_area, len(pieces.first))
        self._factor = 0.5 * 1.2 * area  # of air, kg/m3
        self._rng = np.random.default_rng([seed, 9])
        side = self._rng.uniform(0, 2 * np.pi)
        along = np.array([np.cos(side), np.sin(side), 0.0])
        self._mean = wind * along
        self._gust_size = 0.35 * wind * (0.5 + 0.5 * np.abs(along))
        self._gust = self._gust_size * self._rng.normal(size=3)
        self.still = not area.any()

    def push(self, data: Any, dt: float) -> None:
        """Set the forces of the air for the step of `dt` [s] that begins now."""
        if self.still:
            return
        keep = np.exp(-dt / 1.0)
        self._gust = keep * self._gust + np.sqrt(1 - keep**2) * self._gust_size * self._rng.normal(size=3)
        motion = data.cvel, data.xipos, data.subtree_com
        _blow(self._mean + self._gust, self._factor, self._bodies, self._roots, *motion, data.xfrc_applied)

    def linear(self, speed: Array) -> Array:
        """Return (B,) the damping [N s/m] that does the work of the drag when bodies swing with `speed` (B,) [m/s].

        8 / (3 pi) of the drag at that amplitude of the speed, as the mean of |sin|^3 over that of sin^2 says.
        """
        return 8 / (3 * np.pi) * self._factor * speed


TIMESTEP = 2e-3


def calm_time(plant: SimPlant) -> float:
    """Return how long wind blows before the clock begins [s]; on a string two swings of the stem (facts: rows 0)."""
    return 4.0 if plant.twines else 2.0


def gusts(plant: SimPlant, wind: float) -> Iterator[tuple[PlantMechanics, Any]]:
    """Yield (mechanics, MuJoCo's data) of a plant in gusts of `wind` [m/s] in the mean, every `TIMESTEP`, for ever.

    The wind has blown for `calm_time` at the first, where `data.time` is 0.

    Args:
        plant: as it truly is; its `drag_area` feels the wind.
        wind: mean speed [m/s].

    Raises:
        StageFailure: "no_convergence": the wind blows the plant over.
    """
    mechanics, parts = alone(plant, Params(), TIMESTEP), 1
    model = mechanics.model
    if mechanics.frequencies.max() > Params().stiffest:  # with a string, which is stiff too
        parts = 2
        model.opt.timestep = TIMESTEP / parts
        mechanics.damp(model.opt.timestep)
    data = mujoco.MjData(model)
    air = Air(mechanics, wind, plant.seed)
    data.time = -calm_time(plant)
    mujoco.mj_forward(model, data)
    while not data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
        if data.time > -TIMESTEP / 2:
            yield mechanics, data
        for _ in range(parts):
            mujoco.mj_step1(model, data)  # drag with an inertia one step old blew stems on strings apart
            data.qfrc_applied[mechanics.dofs] = mechanics.drag(data)
            air.push(data, model.opt.timestep)
            mujoco.mj_step2(model, data)
    raise StageFailure("no_convergence", f"the plant was blown over by {wind:g} m/s.")


def swaying(plant: SimPlant, wind: float, times: ArrayLike) -> Array:
    """Return T_world_rest (V, K, 4, 4) of a plant in gusts of `wind` [m/s] in the mean.

    Args:
        plant, wind: see `gusts`.
        times: (V,) rising [s].

    Raises:
        StageFailure: see `gusts`.
    """
    times, blown = check_array("times", times, (None,)), gusts(plant, wind)
    mechanics, data = next(blown)
    out = np.empty((len(times), len(plant.start), 4, 4))
    for i, time in enumerate(times):
        while data.time < time - TIMESTEP / 2:
            next(blown)
        out[i] = mechanics.segment_poses(data)
    return out
