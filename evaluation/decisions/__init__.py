"""What each stage decides, on fixed inputs, and whether a moved constant changes it.

A suite is a module of this package, named after its room:

    prepare(folder, data, quick)    writes the suite's inputs into a folder, with the source as it is
    decide(folder, module)          returns {case: {decision: value}}; begins at the stage that holds the module

A value says how it is compared, and how far it may differ before the decision counts as changed:

    {"line": (N, 3), "within": m}          5 % of either line's points farther than that from the other line
    {"places": (N, 3), "within": m}        5 % of either's points farther than that from the other's points
    {"points": (N, 3), "within": m}        another number, or a point without its partner
    {"ratio": number, "within": share}     a change of more than this share
    {"share": number, "within": number}    a change of more than this
    {"words": text}                        other words, numbers aside

To add a room's suite, write its module and name it in `SUITES`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

if TYPE_CHECKING:  # a constant is moved before Anther is imported
    from anther.core import Array

SUITES = ("perception",)
"""Rooms that have a suite."""

Decisions = Mapping[str, Mapping[str, Any]]
"""Case -> decision -> value."""


def suite(room: str) -> ModuleType:
    """Return a room's suite."""
    return import_module(f"evaluation.decisions.{room}")


def changed(before: Decisions, after: Decisions) -> dict[str, list[str]]:
    """Return decision -> the cases in which it differs; "result" where one of both has none."""
    found: dict[str, list[str]] = {}
    for case, known in before.items():
        now = after.get(case, {})
        different = (
            {"result"} if set(known) != set(now) else {name for name in known if differs(known[name], now[name])}
        )
        for name in different:
            found.setdefault(name, []).append(case)
    return found


def differs(before: Mapping[str, Any], after: Mapping[str, Any]) -> bool:
    """Return whether two values of a decision differ by more than the first one's tolerance."""
    kind = next(name for name in before if name != "within")
    one, other, within = before[kind], after[kind], before.get("within", 0.0)
    if kind in ("line", "places"):
        lines = [np.asarray(points, dtype=float) for points in (one, other)]
        samples = [_sampled(line) if kind == "line" else line for line in lines]
        return max(_apart(lines[0], samples[1], within), _apart(lines[1], samples[0], within)) > 0.05
    if kind == "points":
        return _unmatched(one, other, within)
    if kind == "words":
        return re.sub(r"[-\d.]+", "", one) != re.sub(r"[-\d.]+", "", other)
    allowed = within * abs(one) if kind == "ratio" else within
    return bool(abs(other - one) > allowed)


def _apart(points: Array, others: Array, within: float) -> float:
    """Return the share of points (N, 3) that are farther than `within` from others (M, 3)."""
    return float(np.mean(np.asarray(KDTree(others).query(points)[0]) > within))


def _sampled(line: Array) -> Array:
    """Return the points (N, 3) of a line, and four between each two."""
    return np.concatenate([line[:-1] + t * np.diff(line, axis=0) for t in np.linspace(0, 1, 6)])


def _unmatched(one: Any, other: Any, within: float) -> bool:
    if len(one) != len(other):
        return True
    if not len(one):
        return False
    gap = cdist(one, other)
    return bool(gap[linear_sum_assignment(np.minimum(gap, 2 * within))].max() > within)
