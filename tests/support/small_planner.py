"""A planner without obstacles for tests of the cell and of execution: straight joint moves, straight lines, shakes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from anther.core.geometry import Array
from anther.robot.arm.model import ArmModel
from anther.robot.arm.sawyer import SAWYER
from anther.robot.arm.shaking import swing_trajectory
from anther.robot.devices import JointTrajectory
from anther.robot.swing import Swing

RATE = 50  # samples per second


class SmallPlanner:
    """Plans in joint space; `line` follows a Cartesian line by damped least squares. Only `move` knows other arms."""

    def __init__(self, arm: ArmModel = SAWYER) -> None:
        self.arm = arm

    def move(self, q_from: Any, q_to: Any) -> JointTrajectory:
        q_from, q_to = np.asarray(q_from, dtype=float), np.asarray(q_to, dtype=float)
        way = np.abs(q_to - q_from)
        slow, gentle = 1.875 * way / (0.4 * self.arm.velocity), np.sqrt(5.8 * way / (0.4 * self.arm.acceleration))
        duration = max(float(slow.max()), float(gentle.max()), 0.1)
        t = np.linspace(0, duration, int(duration * RATE) + 2)
        s = t / duration
        shape, rate = 10 * s**3 - 15 * s**4 + 6 * s**5, (30 * s**2 - 60 * s**3 + 30 * s**4) / duration
        return JointTrajectory(t, q_from + shape[:, None] * (q_to - q_from), rate[:, None] * (q_to - q_from))

    def line(self, q_from: Any, T_world_to: Any, speed: float) -> JointTrajectory:
        return _line(np.asarray(q_from, dtype=float).tobytes(), np.asarray(T_world_to).tobytes(), speed)

    def swing(self, q: Any, direction: Any, pieces: Sequence[Swing], reach: float) -> JointTrajectory:
        return swing_trajectory(SAWYER, q, direction, pieces, reach)


@lru_cache(maxsize=200)
def _line(q: bytes, T_world: bytes, speed: float) -> JointTrajectory:
    """Return the straight motion of the flange from joints (7,) to a pose (4, 4); many trials go the same way."""
    q_from, end = np.frombuffer(q), np.frombuffer(T_world).reshape(4, 4)[:3, 3]
    T = SAWYER.forward(q_from)
    distance = np.linalg.norm(end - T[:3, 3])
    duration = max(1.875 * float(distance) / speed, 0.1)
    t = np.linspace(0, duration, int(duration * RATE) + 2)
    s = t / duration
    path = (10 * s**3 - 15 * s**4 + 6 * s**5)[:, None] * (end - T[:3, 3]) + T[:3, 3]
    return _timed(t, follow(q_from, T[:3, :3], path))


def follow(q: Any, rotation: Array, path: Array) -> Array:
    """Return joints (N, 7) that keep the flange's orientation along (N, 3) positions."""
    q, out = np.array(q, dtype=float), []
    for p in path:
        for _ in range(2):
            T = SAWYER.forward(q)
            error = np.r_[p - T[:3, 3], Rotation.from_matrix(rotation @ T[:3, :3].T).as_rotvec()]
            if np.abs(error).max() < 1e-7:
                break
            J = SAWYER.jacobian(q)
            q = q + J.T @ np.linalg.solve(J @ J.T + 1e-8 * np.eye(6), error)
        out.append(q)
    return np.array(out)


def solve(T: Array, seed: Any = SAWYER.neutral) -> Array:
    """Return joints (7,) whose flange pose is `T`, from random restarts.

    Raises:
        AssertionError: none found.
    """
    rng = np.random.default_rng(0)
    q, error = np.array(seed, dtype=float), np.full(6, np.inf)
    for _ in range(50):
        for _ in range(200):
            now = SAWYER.forward(q)
            error = np.r_[T[:3, 3] - now[:3, 3], Rotation.from_matrix(T[:3, :3] @ now[:3, :3].T).as_rotvec()]
            J = SAWYER.jacobian(q)
            step = J.T @ np.linalg.solve(J @ J.T + 1e-4 * np.eye(6), error)
            q = q + np.clip(step, -0.2, 0.2)
        inside = np.all((q > SAWYER.lower + 0.1) & (q < SAWYER.upper - 0.1))
        if np.linalg.norm(error) < 1e-6 and inside:
            return q
        q = rng.uniform(SAWYER.lower / 2, SAWYER.upper / 2)
    raise AssertionError(f"no joints found for {T}")


def _timed(t: Array, q: Array) -> JointTrajectory:
    return JointTrajectory(t, q, np.gradient(q, t, axis=0))
