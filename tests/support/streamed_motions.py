"""Motions and watchers that the tests of streamed arms share; times go by `slow_clock`."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from slow_clock import SLOWER, sleep

from anther.robot.devices import ArmSample, JointTrajectory, Watch


def three_pieces(start: np.ndarray) -> tuple[JointTrajectory, JointTrajectory, JointTrajectory]:
    """Return motions of all joints from `start` that join at 0.3 rad/s; the last one ends at rest."""
    t, along = np.linspace(0, 0.6, 60)[:, None], np.ones(len(start))
    begin = JointTrajectory(t[:, 0], start + 0.25 * t**2 * along, 0.5 * t * along)
    middle = JointTrajectory(t[:, 0], begin.positions[-1] + 0.3 * t * along, np.tile(0.3 * along, (60, 1)))
    end = JointTrajectory(t[:, 0], middle.positions[-1] + (0.3 * t - 0.25 * t**2) * along, (0.3 - 0.5 * t) * along)
    return begin, middle, end


def thought_about(*pieces: JointTrajectory) -> Callable[[], JointTrajectory | None]:
    """Return what gives one piece after the other, each after some thought, and then None."""
    left: Iterator[JointTrajectory | None] = iter([*pieces, None])

    def more() -> JointTrajectory | None:
        sleep(0.1)
        return next(left)

    return more


def check_kept_up(heard: Sequence[float]) -> None:
    """Fail where the machine held the driver up, so that the test is made again (`AGAIN_IF_HELD_UP`).

    heard: times of commands [s].
    """
    late = float(np.diff(heard).max())
    assert late < 0.03, f"a command came {1e3 * late:.0f} ms after the one before"


def raising_beyond(start: np.ndarray, error: BaseException) -> Watch:
    """Return a watcher that raises where a joint is more than 0.1 rad from `start`."""

    def watch(sample: ArmSample) -> None:
        if np.abs(sample.measured - start).max() > 0.1:
            raise error

    return watch


def halfway(path: JointTrajectory, do: Callable[[], Any]) -> None:
    threading.Timer(SLOWER * path.duration / 2, do).start()
