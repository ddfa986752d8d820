"""How likely a straight line is a rigid rod rather than a piece of plant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What speaks for a support, of one straight line's sections.

    Attributes:
        length: from the first to the last section that shows the rod alone [m].
        bow: rms distance from the line of a cubic through these sections' centres [m].
        noise: what of it the centres' scatter about the cubic causes [m].
        taper: log of the upper third's radius over the lower third's.
        ripple: scatter of the log of the radius about its taper.
        ripple_noise: what of it differs from each section to the next.
        slenderness: its length over its radius.
        filled: points on the rod's surface, over those that would cover it, one a cell.
        alone: share of its sections beside which nothing is.
        orphans: pieces of the plant that come loose when the rod is taken away.
        beyond: whether its upper end (of a level one, either) is beyond the rest of the plant.
        greenness: of the rod and, median and spread, of the rest; None without colour.
    """

    length: float
    bow: float
    noise: float
    taper: float
    ripple: float
    ripple_noise: float
    slenderness: float
    filled: float
    alone: float
    orphans: int
    beyond: bool
    greenness: tuple[float, float, float] | None = None


def log_odds(e: Evidence) -> float:
    """Return the log-odds of a rigid rod against a piece of plant.

    Each term is the log-ratio of the probabilities of what is seen; the distributions are guesses.
    """
    # rms over the length: of strings and tubes, of bamboo (guesses), and of 23 straight lines along seedlings' stems
    taut, bent, wander = (e.noise**2 + (share * e.length) ** 2 for share in (0.0005, 0.003, 0.006))
    made = np.logaddexp(_bowed(e.bow, taut), _bowed(e.bow, bent)) - np.log(2)
    straight = made - _bowed(e.bow, wander)
    bumpy = e.ripple_noise**2 + np.square([0.01, 0.06])  # of what is made, and of what grew (guesses)
    round_ = max(np.log(bumpy[1] / bumpy[0]) - e.ripple**2 * (1 / bumpy[0] - 1 / bumpy[1]), -4.0)
    grown = np.logaddexp(_normal(e.taper, -0.4, 0.35), _normal(e.taper, 0, 1.0)) - np.log(2)
    even = _normal(e.taper, 0, float(np.hypot(0.05, e.ripple_noise))) - grown
    filled = np.log(max(e.filled, 1e-3))
    surface, foliage = (
        _normal(filled, np.log(0.8), 0.4),
        _normal(filled, np.log(0.3), 0.5),
    )  # guesses; stems have one
    solid = max(surface - np.logaddexp(surface, foliage) + np.log(2), -4.0)
    clear, leafy = 2 * np.log(max(e.alone, 0.05)) + np.log(3), np.log(2 * max(1 - e.alone, 0.05))  # beta (guesses)
    lone = max(clear - np.logaddexp(clear, leafy) + np.log(2), -4.0)  # a stem may be bare as well
    bare = max(np.log(0.8 / 0.3) + e.orphans * np.log(0.2 / 0.7), -4.0)  # geometric, 0.25 and 2.3 in the mean
    free = np.log(0.4 / 0.05) if e.beyond else np.log(0.6 / 0.95)
    slender = np.log(max(e.slenderness, 1.0))
    thin = min(_normal(slender, np.log(100), 0.9) - _normal(slender, np.log(25), 0.7), 3.0)
    colour = 0.0
    if e.greenness is not None:
        own, middle, spread = e.greenness
        colour = float(np.clip(_normal(own, 0, 0.2) - _normal(own, middle, max(spread, 0.1)), -1.5, 1.5))
    prior = -3.0  # one in twenty (a guess)
    return float(prior + straight + round_ + even + solid + thin + lone + bare + free + colour)


def _normal(x: float, mean: float, sigma: float) -> float:
    return float(-0.5 * ((x - mean) / sigma) ** 2 - np.log(sigma))


def _bowed(bow: float, variance: float) -> float:
    """Return the log-density, but for a constant, of a bow of four coefficients with a variance [m2] in all."""
    return float(-2 * np.log(variance) - 2 * bow**2 / variance)
