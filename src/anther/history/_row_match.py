"""Which hook of a pass is which stem of the map: a monotone alignment, summed over all alignments, not only the best.

Hooks on one wire cannot overtake each other. So the hooks of a pass are aligned to the stored ones in their order,
each of either list matched or left out, and a score is the logarithm of a density: how far a hook moved compared
with its neighbour, how alike the two stems look, how probably a hook is missed, removed or added. What a week does to
a row has been measured nowhere: it is drawn from `WEEK`, and draws count by how well they explain the pass.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import lgamma, log, log1p, pi
from typing import Any

import numpy as np
from scipy.special import logsumexp, ndtr
from scipy.stats import qmc

from anther.core import Array
from anther.core.compiling import njit

WEEK = {
    "slide": (-0.3, 0.3),  # of all hooks in a week [m]: lowering moves a stem by half a plant (facts: rows, D)
    "sway": (0.02, 0.3),  # standard deviation, in a week, of the slide along the row [m]
    "reach": (3.0, 100.0),  # hooks over which the slide stays alike
    "scatter": (0.005, 0.08),  # of one hook, in a week [m]
    "missed": (0.003, 0.08),  # probability that a hook is overlooked
    "removed": (0.001, 0.03),  # that a stem is taken out in a week
    "added": (0.003, 0.08),  # that a hook of the pass is not in the map
    "growth": (0.05, 1.0),  # change of a stem's appearance in a week, in standard deviations between stems
    "tails": (3.0, 10.0),  # degrees of freedom of Student's t, of moves and appearances
}
"""What a week does: least and most, drawn evenly, those of one sign in their logarithm. Guesses but for the slide."""
DRAWS = 32
"""A power of two, as Sobol's points want; more change the third digit of a probability."""
FARTHEST = 0.5
"""Moves beyond this and six standard deviations are not looked at [m]: a pitch and more."""
GAP = 6
"""Hooks that may be left out in a row on either side; a longer gap is no row that was passed."""


@dataclass(frozen=True, slots=True, eq=False)
class Hooks:
    """An ordered list of hooks along the wire. N hooks, K numbers of an appearance.

    Attributes:
        position: (N,) increasing [m].
        variance: (N,) of each one's own error [m2].
        drift: (N,) variance of the error that neighbours share [m2].
        appearance: (N, K) of the stems; NaN where unknown.
        appearance_variance: (N, K).
        weeks: (N,) since each stem was seen.
        gone: (N,) probability that the stem has been taken out already.
        begin, end: the section in which hooks were looked for [m].
    """

    position: Array
    variance: Array
    drift: Array
    appearance: Array
    appearance_variance: Array
    weeks: Array
    gone: Array
    begin: float
    end: float


def align(stored: Hooks, seen: Hooks, weeks: float) -> tuple[Array, float]:
    """Return (M, N) the probability that hook m of a pass is stem n of the map, and the evidence for this row.

    What a hook's probabilities lack to 1 is that of a stem that is not in the map. The evidence is the logarithm of
    how much better the map explains the pass than a row of unknown stems does.

    Args:
        stored: of the map, N hooks.
        seen: of the pass, M hooks.
        weeks: between them.
    """
    moved = seen.position[None, :] - stored.position[:, None]
    pitch = (seen.end - seen.begin) / len(seen.position)
    evidence, shares = np.empty(DRAWS), np.empty((DRAWS, *moved.shape))
    for k, week in enumerate(_weeks(weeks)):
        likeness = _likeness(stored, seen, week)
        skip, add = _left_out(stored, seen, week, pitch)
        common = (week["sway"] ** 2, np.exp(-1 / week["reach"]), week["tails"])
        own = stored.variance, seen.variance + week["scatter"] ** 2, stored.drift, seen.drift
        shares[k], evidence[k] = _posterior(moved - week["slide"], *own, likeness, np.log(skip), np.log(add), *common)
        shares[k] = np.minimum(shares[k], 1.0)
    weight = np.exp(evidence - logsumexp(evidence))
    strange = len(seen.position) * log(1 / pitch)
    return np.tensordot(weight, shares, 1).T, float(logsumexp(evidence) - log(DRAWS) - strange)


def _weeks(weeks: float) -> list[dict[str, float]]:
    """Return draws of what the time between two passes does: moves and changes grow with it, misses do not."""
    z = qmc.Sobol(len(WEEK), seed=0).random(DRAWS)
    drawn = []
    for row in z:
        values = {}
        for u, (name, (least, most)) in zip(row, WEEK.items(), strict=True):
            values[name] = (
                least + u * (most - least) if least < 0 else float(np.exp(log(least) + u * log(most / least)))
            )
        for name in ("slide", "removed"):
            values[name] *= weeks
        for name in ("sway", "scatter"):  # as a random walk
            values[name] *= np.sqrt(weeks)
        values["removed"] = min(values["removed"], 0.9)
        drawn.append(values)
    return drawn


def _likeness(stored: Hooks, seen: Hooks, week: dict[str, float]) -> Array:
    """Return (N, M) by how much more probable an appearance is as the stem's than as any stem's, as logarithm.

    Appearances are compared after their medians are taken off: light and season change them all alike.
    """
    if not stored.appearance.size or not seen.appearance.size:
        return np.zeros((len(stored.position), len(seen.position)))
    known, tails = np.isfinite(stored.appearance).any(0) & np.isfinite(seen.appearance).any(0), week["tails"]
    one, other = stored.appearance[:, known], seen.appearance[:, known]
    one, other = one - np.nanmedian(one, 0), other - np.nanmedian(other, 0)
    spread = np.nanvar(np.vstack([one, other]), 0)
    error = seen.appearance_variance[:, known]
    variance = stored.appearance_variance[:, known] + week["growth"] ** 2 * stored.weeks[:, None] * spread
    same = _log_t(other - one[:, None], variance[:, None] + error, tails)
    return np.nan_to_num(same - _log_t(other, spread + error, tails)).sum(-1)


def _log_t(z: Array, variance: Array, tails: float) -> Array:
    constant = lgamma((tails + 1) / 2) - lgamma(tails / 2) - 0.5 * log(tails * pi)
    return constant - 0.5 * np.log(variance) - (tails + 1) / 2 * np.log1p(z**2 / (tails * variance))


def _left_out(stored: Hooks, seen: Hooks, week: dict[str, float], pitch: float) -> tuple[Array, Array]:
    """Return (N,) the probability that a stored hook is not seen, and (M,) the density of hooks that are not stored.

    Near the ends of a section hooks slide out of it and into it.
    """
    spread = float(np.hypot(week["sway"], week["scatter"])) + 1e-3
    inside = _inside(stored.position + week["slide"], spread, seen)
    there = (1 - stored.gone) * (1 - week["removed"]) * (1 - week["missed"])
    known = _inside(seen.position - week["slide"], spread, stored)
    return np.clip(1 - inside * there, 0, 1 - 1e-9), (1 - known * (1 - week["added"])) / pitch


def _inside(position: Array, spread: float, section: Hooks) -> Array:
    return ndtr((position - section.begin) / spread) * ndtr((section.end - position) / spread)


def _posterior(
    moved: Array, one: Array, other: Array, drift: Array, own_drift: Array, likeness: Array, skip: Array, add: Array,
    sway: float, along: float, tails: float,
) -> tuple[Array, float]:  # fmt: skip
    """Return (N, M) the probability of each match, and the logarithm of the sum over all alignments."""
    variance = sway + drift[:, None] + own_drift + one[:, None] + other
    shared = np.sqrt(sway + drift[:, None] + own_drift)
    match = likeness + np.log1p(-np.exp(skip))[:, None]
    start = _log_t(moved, variance, tails)
    given: tuple[Any, ...] = (moved, variance, shared, match, start)
    forward = _forward(*given, skip, add, along, tails)
    # the same sums from the other end: the density of two moves is the same both ways
    backward = _forward(*(table[::-1, ::-1] for table in given), skip[::-1], add[::-1], along, tails)[::-1, ::-1]
    after = skip.sum() - np.cumsum(skip)
    last = forward + after[:, None] + add.sum() - np.cumsum(add)
    total = float(np.logaddexp(logsumexp(last), skip.sum() + add.sum()))
    return np.exp(forward + backward - match - start - total), total


@njit(cache=True)
def _forward(moved, variance, shared, match, start, skip, add, along, tails):  # type: ignore[no-untyped-def]
    """Return (N, M) the logarithm of the sum over all alignments that end with each match.

    The moves of two matches that follow each other have a bivariate Student's t; `along` is the correlation of what
    they share from hook to hook.
    """
    n, m = moved.shape
    skipped, added = np.zeros(n + 1), np.zeros(m + 1)
    skipped[1:], added[1:] = np.cumsum(skip), np.cumsum(add)
    both = lgamma((tails + 2) / 2) - lgamma(tails / 2) - log(tails * pi)
    total, terms = np.full((n, m), -np.inf), np.empty(GAP * GAP + 1)
    for i in range(n):
        for j in range(m):
            if abs(moved[i, j]) > FARTHEST + 6 * np.sqrt(variance[i, j]):
                continue
            terms[0], count = skipped[i] + added[j] + start[i, j], 1
            for a in range(max(0, i - GAP), i):
                for b in range(max(0, j - GAP), j):
                    if total[a, b] == -np.inf:
                        continue
                    c = along ** (i - a) * shared[i, j] * shared[a, b]
                    u, v, z, y = variance[i, j], variance[a, b], moved[i, j], moved[a, b]
                    det = u * v - c * c
                    square = (v * z * z - 2 * c * z * y + u * y * y) / det
                    pair = both - 0.5 * log(det) - (tails + 2) / 2 * log1p(square / tails)
                    left = skipped[i] - skipped[a + 1] + added[j] - added[b + 1]
                    terms[count] = total[a, b] + left + pair - start[a, b]
                    count += 1
            most = terms[:count].max()
            if most > -np.inf:
                total[i, j] = match[i, j] + most + log(np.exp(terms[:count] - most).sum())
    return total
