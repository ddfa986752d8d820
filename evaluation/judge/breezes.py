"""What a breeze does to the plants that shakes are judged on: the loads that such a plant stands every day.

MuJoCo's plant, true and not linear, in gusts (turbulence 35 %, gusts of a second: `anther.sim.sway`) with a drag that
grows with the square of the speed: 0.31 of the leaves' area (Sase 2012, facts: pollination 6), 1 of a flower's.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from rich.table import Table

from anther.core import Array, StageFailure
from anther.core.geometry import transform_each
from anther.sim import NOMINAL, Organ, SimPlant
from anther.sim.judge import usual_peak
from anther.sim.sway import TIMESTEP, gusts
from anther.sim.true_plant import as_true
from evaluation.harness import CROPS
from evaluation.tables import by_part

WINDS = (2.0, 4.0, 6.0)
"""Mean speeds at the plant [m/s]."""
SECONDS, GUST = 20.0, 1.0
"""How long it blows; of each gust's length the largest counts [s]."""
EVERY = 5
"""Steps between two samples: 100 a second."""


def blown(plant: SimPlant, wind: float, seconds: float = SECONDS) -> dict[str, float]:
    """Return what a wind does to a plant; NaN if it is blown over.

    flower: the median flower's usual peak acceleration in a gust [m/s2]. pedicel, pedicel_worst: the median pedicel's
    usual and the worst one's largest bending strain that the wind adds; stem, base: the largest of main stem and
    branches, of petioles' and peduncles' bases. leaf: the largest torque that it adds at a leaf's base, over that
    leaf's sum of mass times distance [m/s2].
    """
    names = ("flower", "pedicel", "pedicel_worst", "stem", "base", "leaf")
    try:
        strain, places, load, organ = _watched(as_true(plant, replace(NOMINAL, wind=wind)), wind, seconds)
    except StageFailure:
        return dict.fromkeys(names, float("nan"))
    stalk, trunk = organ == Organ.PEDICEL, np.isin(organ, (Organ.STEM, Organ.BRANCH))
    jolts = np.linalg.norm(np.diff(places, 2, axis=0), axis=2) / (EVERY * TIMESTEP) ** 2
    gust = GUST / (EVERY * TIMESTEP)
    values = (
        float(np.median(usual_peak(jolts, gust))),
        float(np.median(usual_peak(strain[:, stalk], gust))),
        *(float(strain[:, part].max(initial=0.0)) for part in (stalk, trunk, ~stalk & ~trunk)),
        float(load.max(initial=0.0)),
    )
    return dict(zip(names, values, strict=True))


def _watched(plant: SimPlant, wind: float, seconds: float) -> tuple[Array, Array, Array, Any]:
    """Return strains (T, B), flowers (T, F, 3), leaves' loads (T, L) and the bodies' organs (B,)."""
    strains, places, loads = [], [], []
    wanted = round(seconds / TIMESTEP)
    for step, (mechanics, data) in enumerate(gusts(plant, wind)):
        if step == 0:
            first = mechanics.pieces.first
            organ = plant.organ[first]
            base, moment = _leaves(plant)
            body = np.array([int(np.flatnonzero(first == b)[0]) for b in base], dtype=np.int64)
            radius = plant.radius_start[first]
            modulus = plant.youngs[first] * np.pi / 4 * radius**3  # torque = E I / r times the strain
        if step % EVERY == 0:
            T = mechanics.segment_poses(data)[plant.flower_segment]
            places.append(transform_each(T, plant.flower_position))
            strains.append(mechanics.strain(data.qpos))
            loads.append(strains[-1][body] * modulus[body] / moment)
        if step == wanted:
            break
    return np.array(strains), np.array(places), np.array(loads), organ


def _leaves(plant: SimPlant) -> tuple[Any, Array]:
    """Return (L,) the segments at which leaves begin, and each one's sum of mass times distance [kg m]."""
    owner, base, mass = plant.leaf_of(), plant.leaf_bases(), plant.mass + plant.lump_mass
    arm = np.linalg.norm(plant.mass_centres() - plant.start[owner], axis=1)
    moment = np.array([np.sum((mass * arm)[owner == b]) for b in base])
    heavy = np.array([plant.lump_mass[owner == b].sum() for b in base]) > 1e-4  # lighter ones are no load
    return base[heavy], moment[heavy]


def breeze_metrics(found: dict[tuple[str, float], list[dict[str, float]]]) -> dict[str, float]:
    """Return breeze_<what>_<crop>_<wind>ms, medians over plants; breeze_pedicel_4ms: of both crops' worst pedicels."""
    out = {
        f"breeze_{what}_{crop}_{wind:g}ms": float(np.nanmedian([row[what] for row in rows]))
        for (crop, wind), rows in found.items()
        for what in rows[0]
    }
    worst = [row["pedicel_worst"] for (_, wind), rows in found.items() if wind == 4.0 for row in rows]
    return out | {"breeze_pedicel_4ms": float(np.nanmedian(worst))}


def breeze_table(found: dict[str, float]) -> Table:
    """Return medians over plants, from `breeze_metrics`."""
    winds = {f"{crop}_{wind:g}ms": f"{crop}, {wind:g} m/s" for crop in CROPS for wind in WINDS}
    numbers = {
        "flower, m/s²": "breeze_flower_*:.1f",
        "pedicel strain": "breeze_pedicel_*:.2%",
        "worst pedicel of a plant": "breeze_pedicel_worst_*:.2%",
        "stem strain": "breeze_stem_*:.2%",
        "base strain": "breeze_base_*:.2%",
        "leaf base, m/s²": "breeze_leaf_*:.1f",
    }
    return by_part(found, "crop, wind", winds, numbers)
