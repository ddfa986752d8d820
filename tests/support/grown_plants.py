"""Simulated plants, each grown once in a process: growing takes half a second. Nobody may change their arrays."""

from __future__ import annotations

from functools import cache
from typing import Any

from anther.sim.pepper import grow_pepper
from anther.sim.plant import SimPlant
from anther.sim.tomato import grow_tomato

GROW = {"tomato": grow_tomato, "pepper": grow_pepper}


@cache
def grown(species: str, seed: int, **where: Any) -> SimPlant:
    """Return the plant of a species and seed, placed as `where` says."""
    return GROW[species](seed, **where)
