"""In which order, and with which joints, the arm visits views so that the motion is short. V views, C choices.

The generalised travelling salesman: of each view one of several joint vectors is visited.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core.compiling import njit
from anther.core.geometry import Array
from anther.robot.arm.model import ArmModel

DETOUR = 2.0  # s that a motion is taken to last longer when the straight joint line is not free: measured, 1 to 4 s

Tour = list[tuple[int, Array]]
"""(view, joints (J,)) in the order of the visits."""


def shortest_tour(arm: ArmModel, free: Callable[[Array], bool], start: Array, choices: Sequence[Array]) -> Tour:
    """Return the shortest tour found, a straight joint line that is not free taken to last `DETOUR` longer.

    Lines are checked only when a tour uses them, and the tour is improved with what that taught (Bohlin and Kavraki
    2000, lazy collision checking).

    Args:
        arm: its description.
        free: whether the straight line between two rows of joints (2, J) is free.
        start: (J,) joints the arm comes from.
        choices: per view the joints (C, J) to choose from.
    """
    stops = np.concatenate([start[None], *choices])
    ends = np.cumsum([1, *map(len, choices)])
    layers = [slice(a, b) for a, b in zip(ends, ends[1:], strict=False)]
    cost, rng = least_times(arm, stops, stops), np.random.default_rng(0)
    order, found, checked = list(range(len(choices))), list[tuple[list[int], NDArray[Any]]](), set[tuple[int, int]]()
    for turn in range(30):
        trials, hot = (400, 0.05) if turn else (3000, 0.3)  # the first tour is sought, later ones are mended
        order = shorter(order, cost, layers, trials, hot, rng)
        picks = best_choices(order, cost, layers)
        found.append((order, picks))
        lines = {(int(a), int(b)) for a, b in zip([0, *picks], picks, strict=False)} - checked
        checked |= lines
        blocked = [line for line in sorted(lines) if not free(stops[list(line)])]
        if not blocked:
            break
        for a, b in blocked:
            cost[a, b] += DETOUR
            cost[b, a] += DETOUR
    order, picks = min(found, key=lambda tour: cost[[0, *tour[1][:-1]], tour[1]].sum())
    return [(view, stops[pick]) for view, pick in zip(order, picks, strict=True)]


def least_times(arm: ArmModel, a: Array, b: Array) -> Array:
    """Return (A, B) the times [s] from rest to rest between joints (A, J) and (B, J), each joint at its limits."""
    times = np.zeros((len(a), len(b)))
    for joint in range(arm.count):
        far = np.abs(a[:, None, joint] - b[None, :, joint])
        v, acc = arm.velocity[joint], arm.acceleration[joint]
        np.maximum(times, np.where(far > v**2 / acc, far / v + v / acc, 2 * np.sqrt(far / acc)), out=times)
    return times


def shorter(
    order: list[int], cost: Array, layers: Sequence[slice], trials: int, hot: float, rng: np.random.Generator
) -> list[int]:
    """Return an order of the views on which the arm needs less time, or the same, by simulated annealing.

    A trial reverses a piece of the order or puts up to three views elsewhere; each is judged by its best choices.
    """
    start, stop = (np.array([getattr(layer, end) for layer in layers]) for end in ("start", "stop"))
    now = best = order, _length(np.array(order), cost, start, stop)
    for k in range(trials):
        tried = _perturb(now[0], rng)
        length = _length(np.array(tried), cost, start, stop)
        worse = length - now[1]
        if worse < 0 or rng.random() < np.exp(-worse / (hot * (1 - k / trials) ** 2)):
            now = tried, length
        best = min(best, now, key=lambda one: one[1])
    return best[0]


def best_choices(order: list[int], cost: Array, layers: Sequence[slice]) -> NDArray[Any]:
    """Return (V,) rows of `cost`: the shortest way from row 0 through one row of each view's layer, in this order."""
    total, came, before = np.zeros(1), [], slice(0, 1)
    for view in order:
        reach = total[:, None] + cost[before, layers[view]]
        came.append(reach.argmin(axis=0))
        total, before = reach.min(axis=0), layers[view]
    pick, picks = int(total.argmin()), []
    for view, back in zip(reversed(order), reversed(came), strict=True):
        picks.append(layers[view].start + pick)
        pick = int(back[pick])
    return np.array(picks[::-1])


@njit(cache=True)
def _length(order, cost, start, stop):
    """Return the cost of the best choices in this order; view v may be visited at the rows start[v] to stop[v]."""
    total, first, last = np.zeros(1), 0, 1
    for view in order:
        reach = np.full(stop[view] - start[view], np.inf)
        for i in range(first, last):
            row, so_far = cost[i, start[view] : stop[view]], total[i - first]
            for j in range(len(reach)):  # along a row, without a call: the compiler takes several at a time
                reach[j] = so_far + row[j] if so_far + row[j] < reach[j] else reach[j]
        total, first, last = reach, start[view], stop[view]
    return total.min()


def _perturb(order: list[int], rng: np.random.Generator) -> list[int]:
    a, b = sorted(rng.integers(0, len(order) + 1, 2).tolist())
    if rng.random() < 0.5:
        return order[:a] + order[a:b][::-1] + order[b:]
    piece, rest = order[a : a + 3], order[:a] + order[a + 3 :]
    at = int(rng.integers(0, len(rest) + 1))
    return rest[:at] + (piece if rng.random() < 0.5 else piece[::-1]) + rest[at:]
