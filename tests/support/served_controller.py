"""What the controllers of a served cell's arms have in common: they go from command to command, smoothly."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Protocol

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from anther.robot.arm.model import ArmModel

FOLLOWS = 100.0  # rad/s: how fast the arm's controller follows what it is told; a guess
CATCHES_UP = 0.15  # of the arm's accelerations, with which it comes back to its way: planned motions leave 0.3; a guess

Aim = tuple[float, np.ndarray, np.ndarray]
"""When [s], joints and rates (J,)."""


class Controlled(Protocol):
    """An arm at joints `q` and rates `v` (J,), as its controller believes."""

    q: np.ndarray
    v: np.ndarray

    def push(self, when: float, dt: float) -> np.ndarray:
        """Return the accelerations (J,) [rad/s^2] for the step of `dt` that ends at a time [s]."""
        ...


class Timed(Protocol):
    """A world with an arm, at a time [s], in steps of `timestep` [s]."""

    @property
    def time(self) -> float: ...
    @property
    def timestep(self) -> float: ...
    @property
    def arm(self) -> ArmModel: ...


def references(arm: Controlled, world: Timed, steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return joints, rates and accelerations (steps, J) of the next steps of the world; the arm is led along them."""
    dt, now, most, rows = world.timestep, world.time, world.arm.acceleration, []
    for step in range(1, steps + 1):
        push = np.clip(arm.push(now + step * dt, dt), -most, most)
        arm.v = arm.v + push * dt
        arm.q = arm.q + arm.v * dt
        rows.append((arm.q, arm.v, push))
    q, v, a = (np.array(part) for part in zip(*rows, strict=True))
    return q, v, a


def along(arm: Controlled, aims: Sequence[Aim], when: float, most: np.ndarray) -> np.ndarray:
    """Return accelerations (J,) that lead an arm along its aims, and back to them with a share of `most` (J,)."""
    q, rate, push = between(aims, when)
    return push + catching_up(q - arm.q, rate - arm.v, CATCHES_UP * most)


def between(aims: Sequence[Aim], when: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return joints, rates, accelerations (J,) at a time [s] among aims: cubic in between, and on after as it went."""
    for (t0, q0, v0), (t1, q1, v1) in pairwise(aims):
        if t0 <= when < t1:
            curve = CubicHermiteSpline([t0, t1], [q0, q1], [v0, v1])
            return curve(when), curve(when, 1), curve(when, 2)
    (t0, q0, v0), (t1, q1, v1) = aims[0], aims[-1]
    if when < t0:
        return q0 + v0 * (when - t0), v0, np.zeros_like(v0)
    push, after = (v1 - aims[-2][2]) / (t1 - aims[-2][0]) if len(aims) > 1 else np.zeros_like(v1), when - t1
    return q1 + v1 * after + push * after**2 / 2, v1 + push * after, push


def catching_up(
    off: np.ndarray, rate_off: np.ndarray, most: np.ndarray, fastest: np.ndarray | float = np.inf
) -> np.ndarray:
    """Return accelerations (J,) of at most `most` with which an arm comes to where it should be, `off` (J,) [rad] from
    it and `rate_off` (J,) [rad/s] slower, no faster than `fastest`, and stops there."""
    rate = np.sign(off) * np.minimum(np.minimum(FOLLOWS * np.abs(off), np.sqrt(most * np.abs(off))), fastest)
    return np.clip(FOLLOWS * (rate + rate_off), -most, most)
