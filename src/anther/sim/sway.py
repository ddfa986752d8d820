"""A plant in the wind, alone: where its segments are whenever somebody looks. K segments, V views."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco as mujoco_module
import numpy as np
from numpy.typing import ArrayLike

from anther.checks import check_array
from anther.errors import StageFailure
from anther.geometry import Array
from anther.sim import plant_mechanics
from anther.sim.air import Air
from anther.sim.plant import GRAVITY, SimPlant
from anther.sim.plant_mechanics import PlantMechanics

mujoco: Any = mujoco_module  # its names come from C++ at run time; type checkers do not see them

TIMESTEP = 2e-3
CALM = 2.0
"""How long the wind has blown before the clock begins [s]."""


def gusts(plant: SimPlant, wind: float) -> Iterator[tuple[PlantMechanics, Any]]:
    """Yield (mechanics, MuJoCo's data) of a plant in gusts of `wind` [m/s] in the mean, every `TIMESTEP`, for ever.

    Args:
        plant: as it truly is; its `drag_area` feels the wind.
        wind: mean speed [m/s].

    Raises:
        StageFailure: "no_convergence": the wind blows the plant over.
    """
    params, spec = plant_mechanics.Params(), mujoco.MjSpec()
    spec.compiler.degree, spec.option.gravity, spec.option.timestep = False, [0, 0, -GRAVITY], TIMESTEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    pieces = plant_mechanics.add_plant(spec, plant, params, contype=0, conaffinity=0)
    model = spec.compile()
    mechanics, data, inertia = PlantMechanics(model, plant, pieces, params), mujoco.MjData(model), np.empty(model.nv)
    air = Air(mechanics, wind, plant.seed)
    mujoco.mj_forward(model, data)
    while not data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
        yield mechanics, data
        mujoco.mj_mulM(model, data, inertia, data.qvel)
        data.qfrc_applied[:] = -mechanics.mass_damping * inertia
        air.push(data, TIMESTEP)
        mujoco.mj_step(model, data)
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
    for i, time in enumerate(times + CALM):
        while data.time < time - TIMESTEP / 2:
            next(blown)
        out[i] = mechanics.segment_poses(data)
    return out
