"""Intervals, tests and scores that several evaluations use."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import binomtest

from anther.core import Array

DRAWS = 2000
"""Bootstrap samples behind an interval."""


def interval(successes: int, trials: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share of independent trials."""
    found = binomtest(successes, trials).proportion_ci(0.95, method="wilson")
    return float(found.low), float(found.high)


def bootstrap(values: Array, statistic: Callable[..., Any] = np.median) -> tuple[float, float]:
    """Return the 95 % interval of a statistic over plants (percentile bootstrap)."""
    if not len(values):
        return float("nan"), float("nan")
    draws = np.random.default_rng(0).integers(0, len(values), (DRAWS, len(values)))
    low, high = np.quantile(statistic(values[draws], axis=1), [0.025, 0.975])
    return float(low), float(high)


def mcnemar(ours: Sequence[bool], theirs: Sequence[bool]) -> tuple[int, int, float]:
    """Return how many pairs only the first won, how many only the second, and the exact two-sided p-value of both.

    Of the pairs that differ each side wins half if there is no difference (McNemar 1947, the binomial form).
    """
    first = sum(a and not b for a, b in zip(ours, theirs, strict=True))
    second = sum(b and not a for a, b in zip(ours, theirs, strict=True))
    both = first + second
    return first, second, float(binomtest(first, both, 0.5).pvalue) if both else 1.0


def correlation(a: Array, b: Array) -> float:
    """Return Pearson's r; 0 where one of both does not vary."""
    if min(np.ptp(a), np.ptp(b)) <= 1e-12:
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])


def auc(claimed: Array, right: NDArray[np.bool_]) -> float:
    """Return the chance that a right case is claimed with more confidence than a wrong one (Mann-Whitney)."""
    if right.all() or not right.any():
        return np.nan
    order = np.sort(claimed[~right])
    below, upto = (np.searchsorted(order, claimed[right], side=side) for side in ("left", "right"))
    return float((below + upto).mean() / 2 / len(order))


def reliability(claimed: Array, right: NDArray[np.bool_]) -> Array:
    """Return per tenth of the confidence that occurs: (mean confidence, share right, count), (b, 3)."""
    tenth = np.minimum((claimed * 10).astype(int), 9)
    rows = [(claimed[tenth == b].mean(), right[tenth == b].mean(), (tenth == b).sum()) for b in np.unique(tenth)]
    return np.array(rows, dtype=np.float64)


def logistic(evidence: Array, right: NDArray[np.bool_], ridge: float = 1.0) -> Array:
    """Return constant and weights of the logistic regression of `right` (n,) on `evidence` (n, k).

    The weights of the standardised evidence are not negative, since larger is better for each, and have a penalty of
    `ridge` observations: a few wrong stems do not make a certainty.
    """
    mean, spread = evidence.mean(axis=0), evidence.std(axis=0) + 1e-9
    design = np.column_stack([np.ones(len(evidence)), (evidence - mean) / spread])
    sign = np.where(right, 1.0, -1.0)

    def loss(weights: Array) -> float:
        penalty = 0.5 * ridge * float(weights[1:] @ weights[1:])
        return float(np.logaddexp(0, -sign * (design @ weights)).sum() + penalty) / len(evidence)

    bounds = [(None, None), *[(0, None)] * evidence.shape[1]]
    weights = minimize(loss, np.zeros(len(bounds)), method="L-BFGS-B", bounds=bounds).x
    slopes = weights[1:] / spread
    return np.concatenate([[weights[0] - mean @ slopes], slopes])


def mean(values: Iterable[Any]) -> float:
    """Return the mean of what is known; NaN of nothing."""
    found = np.fromiter((np.nan if value is None else value for value in values), dtype=float)
    return float(np.nanmean(found)) if np.isfinite(found).any() else np.nan


def median(values: Iterable[Any]) -> float:
    """Return the median of what is known; NaN of nothing."""
    found = np.fromiter((np.nan if value is None else value for value in values), dtype=float)
    return float(np.nanmedian(found)) if np.isfinite(found).any() else np.nan
