"""Which hook of a pass is which stem of the map: a monotone alignment, summed over all alignments, not only the best.

Hooks on one wire cannot overtake each other. So the hooks of a pass are aligned to the stored ones in their order,
each of either list matched or left out, by a hidden Markov model: its state is how far along either list one is, and
how far hooks slid there since the last pass. Scores are probabilities: how far a hook lies from where the slide of its
neighbours puts it, how alike the two stems look, how probably a hook is missed, removed or added. What a week does to a
row has been measured nowhere: it is drawn from `WEEK`, and draws count by how well they explain the pass.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, lgamma, log, pi, sqrt
from typing import Any, cast

import numpy as np
from scipy.special import ndtr
from scipy.stats import qmc

from anther.core import Array
from anther.core.compiling import njit

WEEK = {
    "step": (0.002, 0.02),  # change of the slide from hook to hook, in a week, standard deviation [m]
    "jump": (0.003, 0.1),  # probability that the slide is another one from a hook on: another worker, another day
    "scatter": (0.005, 0.08),  # of one hook about the slide, in a week, scale of Student's t [m]
    "missed": (0.003, 0.08),  # probability that a hook is overlooked
    "removed": (0.001, 0.03),  # that a stem is taken out in a week
    "added": (0.003, 0.08),  # that a hook of the pass is not in the map
    "growth": (0.05, 1.0),  # change of a stem's appearance in a week, in standard deviations between stems
    "tails": (2.0, 10.0),  # degrees of freedom of Student's t, of positions and appearances
}
"""What a week does: least and most, drawn evenly in the logarithm. All are guesses."""


@dataclass(frozen=True, slots=True, eq=False)
class Hooks:
    """An ordered list of hooks along the wire. N hooks, K numbers of an appearance.

    Attributes:
        position: (N,) increasing [m].
        variance: (N,) of each one's own error [m2].
        drift: (N,) variance of the error that neighbours share [m2].
        walk: by which it grows: standard deviation after a metre [m].
        appearance: (N, K) of the stems; NaN where unknown.
        appearance_variance: (N, K).
        weeks: (N,) since each stem was seen.
        gone: (N,) probability that the stem has been taken out already.
        begin, end: the section in which hooks were looked for [m].
    """

    position: Array
    variance: Array
    drift: Array
    walk: float
    appearance: Array
    appearance_variance: Array
    weeks: Array
    gone: Array
    begin: float
    end: float


def align(stored: Hooks, seen: Hooks, weeks: float) -> tuple[Array, float]:
    """Return (M, N) the probability that hook m of a pass is stem n of the map, and the evidence for this row.

    What a hook's probabilities lack to 1 is that of a stem that is not in the map. The evidence is the logarithm of
    how much better the stems of the map explain the pass than others on the same hooks would: those of another row hang
    as far apart, but look like any.

    Args:
        stored: of the map, N hooks.
        seen: of the pass, M hooks.
        weeks: between them.
    """
    moved = seen.position[None, :] - stored.position[:, None]
    pitch = (seen.end - seen.begin) / len(seen.position)
    slide = 0.35  # m in a week that hooks slide at most: lowering moves a stem by half a plant (facts: rows D)
    most = slide * weeks + 0.05 + 3 * float(np.sqrt(2 * seen.drift.max()))
    bins = 96  # slides that are told apart
    slides = np.linspace(-most, most, bins)
    low, high = _band(stored.position, seen.position, most + pitch)
    draws = 32  # a power of two, as Sobol's points want
    evidence, of_others, shares = np.empty(draws), np.empty(draws), np.empty((draws, *moved.shape))
    sweep, combine = cast(Any, _forward), cast(Any, _combined)
    for k, week in enumerate(_weeks(weeks, draws)):
        skip, add = _left_out(stored, seen, week, slide * weeks / 2, pitch)
        there = np.repeat(1 - skip[:, None], len(seen.position), axis=1)
        weight = np.exp(_likeness(stored, seen, week)) * there
        own = stored.variance[:, None] + seen.variance + week["scatter"] ** 2 + np.diff(slides)[0] ** 2 / 12
        kernel = _kernel(slides, np.sqrt(week["step"] ** 2 + 2 * seen.walk**2 * pitch), week["jump"])
        tables = moved, np.sqrt(own), weight
        given = slides, kernel, week["tails"]
        forward = sweep(*tables, skip, add, low, high, *given)
        flipped = (np.ascontiguousarray(table[::-1, ::-1]) for table in tables)
        ends = len(seen.position) - high[::-1], len(seen.position) - low[::-1]
        backward = sweep(*flipped, skip[::-1].copy(), add[::-1].copy(), *ends, *given)
        shares[k] = combine(*tables, low, *forward, ends[0], *backward, slides, week["tails"])
        evidence[k] = forward[2]
        of_others[k] = sweep(moved, tables[1], there, skip, add, low, high, *given)[2]
    if not np.isfinite(evidence).any():
        return np.zeros_like(shares[0].T), -np.inf
    total = float(np.logaddexp.reduce(evidence))
    shared = np.tensordot(np.exp(evidence - total), shares, 1)
    return shared.T, total - float(np.logaddexp.reduce(of_others))


def _band(stored: Array, seen: Array, most: float) -> tuple[Array, Array]:
    """Return (N + 1,) how many hooks of the pass may lie before each stored one, least and most."""
    low, high = np.searchsorted(seen, stored - most), np.searchsorted(seen, stored + most)
    return np.append(np.append(0, low[1:]), low[-1] if len(low) else 0), np.append(high, len(seen))


def _weeks(weeks: float, draws: int) -> list[dict[str, float]]:
    """Return draws of what the time between two passes does: moves and changes grow with it, misses do not."""
    z, drawn = qmc.Sobol(len(WEEK), rng=0).random(draws), []
    for row in z:
        of_week = {name: float(a * (b / a) ** u) for u, (name, (a, b)) in zip(row, WEEK.items(), strict=True)}
        walk = {name: of_week[name] * weeks**0.5 for name in ("step", "scatter")}
        drawn.append(of_week | walk | {"removed": 1 - (1 - of_week["removed"]) ** weeks})
    return drawn


def _kernel(slides: Array, step: float, jump: float) -> Array:
    """Return (S, S) the probability of each of S slides after each, the same both ways."""
    bins = len(slides)
    apart = np.arange(2 * bins - 1) - (bins - 1)
    near = np.exp(-0.5 * (apart * np.diff(slides)[0] / step) ** 2)
    near /= near.sum()
    table = near[bins - 1 + np.arange(bins)[:, None] - np.arange(bins)]
    table += np.diag(1 - table.sum(1))  # what would leave the range stays
    return (1 - jump) * table + jump / bins


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


def _left_out(stored: Hooks, seen: Hooks, week: dict[str, float], spread: float, pitch: float) -> tuple[Array, Array]:
    """Return (N,) the probability that a stored hook is not seen, and (M,) the density of hooks that are not stored.

    Near the ends of a section hooks slide out of it and into it, by `spread`.
    """
    there = (1 - stored.gone) * (1 - week["removed"]) * (1 - week["missed"])
    missed = 1 - _inside(stored.position, spread, seen) * there
    known = _inside(seen.position, spread, stored) * (1 - week["added"])
    return np.clip(missed, 0, 1 - 1e-9), (1 - known) / pitch


def _inside(position: Array, spread: float, section: Hooks) -> Array:
    return ndtr((position - section.begin) / spread) * ndtr((section.end - position) / spread)


@njit(cache=True)
def _density(z, scale, slides, tails):  # type: ignore[no-untyped-def]
    """Return (S,) Student's t of a move about each slide."""
    constant = exp(lgamma((tails + 1) / 2) - lgamma(tails / 2)) / (sqrt(tails * pi) * scale)
    return constant * (1 + ((z - slides) / scale) ** 2 / tails) ** (-(tails + 1) / 2)


@njit(cache=True)
def _forward(moved, scale, weight, skip, add, low, high, slides, kernel, tails):  # type: ignore[no-untyped-def]
    """Return sums over all alignments of the first hooks, (N + 1, W, S), their scales, and the logarithm of all.

    A cell (i, j - low[i]) has i stored hooks and j of the pass behind it, its slide moved on to the next match. Between
    two matches stored hooks are left out before those of the pass: each alignment counts once.
    """
    n, m, bins = len(skip), len(add), len(slides)
    sums, logs = np.zeros((n + 1, (high - low).max() + 1, bins)), np.full(n + 1, -np.inf)
    matched = np.zeros(sums.shape[1:])
    matched[0], logs[0], total = 1 / bins, 0.0, -np.inf
    for i in range(n + 1):
        both = matched.copy()
        for c in range(high[i] - low[i]):
            both[c + 1] += both[c] * add[low[i] + c]
        if i == n:
            last = both[m - low[n]].sum()
            return sums, logs, np.log(last) + logs[n] if last > 0 else -np.inf
        sums[i] = both @ kernel
        further = np.zeros_like(matched)
        for c in range(high[i] - low[i] + 1):
            j = low[i] + c
            if low[i + 1] <= j <= high[i + 1]:
                further[j - low[i + 1]] += matched[c] * skip[i]
            if j < m and low[i + 1] <= j + 1 <= high[i + 1]:
                near = _density(moved[i, j], scale[i, j], slides, tails)
                further[j + 1 - low[i + 1]] += sums[i, c] * weight[i, j] * near
        most = further.max()
        if most == 0:
            return sums, logs, total
        matched, logs[i + 1] = further / most, logs[i] + np.log(most)
    return sums, logs, total


@njit(cache=True)
def _combined(  # type: ignore[no-untyped-def]
    moved, scale, weight, low, sums, logs, total, low_back, back, logs_back, total_back, slides, tails
):
    """Return (N, M) the probability of each match, from the sums of both ends."""
    n, m = moved.shape
    shares = np.zeros((n, m))
    if total == -np.inf or total_back == -np.inf:
        return shares
    for i in range(n):
        for c in range(sums.shape[1]):
            j = low[i] + c
            d = m - 1 - j - low_back[n - 1 - i]
            if j < m and 0 <= d < back.shape[1]:
                near = _density(moved[i, j], scale[i, j], slides, tails)
                both = (sums[i, c] * back[n - 1 - i, d] * near).sum() * weight[i, j] * len(slides)
                if both > 0:
                    shares[i, j] = exp(min(log(both) + logs[i] + logs_back[n - 1 - i] - total, 0.0))
    return shares
