"""From a coarse tree to smooth, evenly spaced centrelines in the middle of the organs, with radii. J nodes.

A tree of voxels or bands keeps the steps of its grid, and a rod model fed with it bends at each step (paper P7,
beyond). Here each chain is resampled, every node is moved to the centre of the cloud's cross-section around it
(a circle where the section is round, the mean where it is a blade), and what remains is smoothed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, median_filter

from anther.core.compiling import compiled, inlined
from anther.core.geometry import Array, arc_length, interpolate
from anther.perception.skeleton.raw_tree import RawTree, chains
from anther.perception.skeleton.voxel_solid import nearest


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """Evenly spaced chains of a tree. Every chain but the first starts on a node of an earlier one.

    Attributes:
        nodes: (J, 3) [m].
        chains: node numbers of each chain; the first number of a side chain is the node it leaves.
        radius: (J,) [m].
        width: (J,) half width of the cross-section [m]; about the radius where it is round.
    """

    nodes: Array
    chains: list[NDArray[Any]]
    radius: Array
    width: Array

    @property
    def own(self) -> list[NDArray[Any]]:
        """The chains without the nodes they leave."""
        return [self.chains[0], *(chain[1:] for chain in self.chains[1:])]

    @property
    def parent(self) -> NDArray[Any]:
        """(J,) parent of each node; parent[0] = -1, parent[j] < j."""
        parent = np.full(len(self.nodes), -1)
        for chain in self.chains:
            parent[chain[1:]] = chain[:-1]
        return parent


def resample(tree: RawTree, gain: Array, spacing: float) -> Curves:
    """Return the tree's chains, smoothed and evenly spaced [m], side chains attached where their direction points.

    The path gain (J,) decides which child goes on with its parent's chain; side chains of less than half a step drop.
    """
    first, *others = chains(tree.parent, gain)
    nodes, radius = _even(_smooth(tree.nodes[first]), tree.thickness[first], spacing, fewest=1)
    made = [np.arange(len(nodes))]
    home = np.zeros(len(tree.nodes), dtype=np.int64)
    forks: set[int] = set()
    for chain in others:
        host = made[home[chain[0]]]
        at = host[_shared(_attachment(tree.nodes[chain], nodes[host]), host, forks)]
        rest = chain[1 + _BENT :] if len(chain) > 3 + _BENT else chain[1:]
        line = np.concatenate([nodes[at][None], tree.nodes[rest]])
        new, thick = _even(_smooth(line), tree.thickness[[rest[0], *rest]], spacing)
        home[chain[1:]] = len(made) if len(new) else home[chain[0]]
        if len(new):
            forks.add(int(at))
            made.append(np.concatenate([[at], np.arange(len(nodes), len(nodes) + len(new) - 1)]))
            nodes, radius = np.concatenate([nodes, new[1:]]), np.concatenate([radius, thick[1:]])
    return Curves(nodes, made, radius, radius)


def centre_curves(curves: Curves, points: Array, *, rounds: int, fattening: float) -> Curves:
    """Return the curves moved to the middle of the cloud's (N, 3) cross-sections, with radii from the cloud.

    Each of the `rounds` sees sections cut across better centrelines; `fattening` is how much thicker the sensor makes
    organs [m of radius].
    """
    for _ in range(rounds):
        curves = _smooth_curves(_recentre(curves, points))
    curves = _extend_ends(_straighten_start(curves), points)
    return _radii(curves, points, fattening)


def extend_to_soil(curves: Curves, length: float, spacing: float) -> Curves:
    """Return the curves with the first chain begun `length` [m] earlier, straight on from how it begins."""
    upward, count = start_direction(curves), max(round(length / spacing), 1)
    new = curves.nodes[curves.chains[0][0]] - upward * length * np.linspace(1, 0, count, endpoint=False)[:, None]
    first, *others = [chain + count for chain in curves.chains]
    return Curves(
        np.concatenate([new, curves.nodes]),
        [np.concatenate([np.arange(count), first]), *others],
        np.concatenate([np.full(count, curves.radius[0]), curves.radius]),
        np.concatenate([np.full(count, curves.width[0]), curves.width]),
    )


def start_direction(curves: Curves) -> Array:
    """Return the direction (3,) in which the first chain begins, over its first nodes."""
    first = curves.chains[0]
    rise = curves.nodes[first[min(5, len(first) - 1)]] - curves.nodes[first[0]]
    return rise / max(float(np.linalg.norm(rise)), 1e-12)


_BENT = 2
"""The first nodes of a side branch bend towards the quick way down the stem; the next ones point to where it leaves."""


def _attachment(line: Array, host: Array) -> int:
    """Return which node of a host (H, 3) a side chain (M, 3) leaves: where the line of its beginning meets the host."""
    offset = host - line[min(1, len(line) - 1)]
    away = np.linalg.norm(offset, axis=1)
    straight = line[1 + _BENT : 11 + _BENT]
    if len(straight) < 3:
        return int(np.argmin(away))
    middle = straight.mean(axis=0)
    direction = np.linalg.svd(straight - middle)[2][0]
    direction *= np.sign(direction @ (straight[-1] - straight[0])) or 1
    along = (host - middle) @ direction
    aside = np.linalg.norm(host - middle - along[:, None] * direction, axis=1)
    allowed = (away <= 2.5 * away.min()) & (along <= 0)
    return int(np.argmin(np.where(allowed, aside, np.inf))) if allowed.any() else int(np.argmin(away))


def _shared(at: int, host: NDArray[Any], forks: set[int]) -> int:
    """Return a position on the host one node from `at` at most, where another side branch leaves it; else `at`.

    Opposite and whorled leaves leave at one node.
    """
    near = range(max(at - 1, 0), min(at + 2, len(host)))
    there = [i for i in near if int(host[i]) in forks]
    return min(there, key=lambda i: abs(i - at)) if there else at


def _even(line: Array, values: Array, spacing: float, fewest: int = 0) -> tuple[Array, Array]:
    """Return the line and the values on it at even steps close to `spacing`; nothing if it is too short."""
    arc = arc_length(line)
    count = max(round(arc[-1] / spacing), fewest)
    if count < 1:
        return line[:0], values[:0]
    at = np.linspace(0, arc[-1], count + 1)
    return interpolate(at, arc, line), np.interp(at, arc, values)


def _smooth(line: Array, sigma: float = 1.0) -> Array:
    """Return the line smoothed by a Gaussian of `sigma` nodes; both ends stay where they are."""
    if len(line) < 3:
        return line.copy()
    pad = min(len(line) - 1, int(4 * sigma) + 1)
    padded = np.pad(line, ((pad, pad), (0, 0)), mode="reflect", reflect_type="odd")
    smooth = gaussian_filter1d(padded, sigma, axis=0)[pad:-pad]
    smooth[0], smooth[-1] = line[0], line[-1]
    return smooth


def _smooth_curves(curves: Curves, sigma: float = 1.0) -> Curves:
    nodes = curves.nodes.copy()
    for chain in curves.chains:
        nodes[chain] = _smooth(nodes[chain], sigma)
    return replace(curves, nodes=nodes)


def _sections(curves: Curves, points: Array) -> CrossSections:
    before, after = np.full((2, len(curves.nodes)), -1)
    for own in curves.own:  # not the node a side chain leaves: that lies in its carrier
        before[own[1:]], after[own[:-1]] = own[:-1], own[1:]
    here, parent = np.arange(len(curves.nodes)), curves.parent
    ahead, behind = np.where(after < 0, here, after), np.where(parent < 0, here, parent)
    tangent = curves.nodes[ahead] - curves.nodes[behind]
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1), 1e-12)[:, None]
    return cross_sections(points, curves.nodes, tangent, np.stack([before, here, after], axis=1))


def _recentre(curves: Curves, points: Array) -> Curves:
    """Return the curves with nodes at the centres of the fitted circles, where the sections are round.

    A section is round when half its points lie within a quarter of the radius from the circle.
    """
    at = _sections(curves, points)
    trusted = (at.count >= _FEWEST) & (at.residual <= 0.25 * at.circle) & (at.circle <= 3 * curves.radius)
    length = np.linalg.norm(at.centre, axis=1)
    shell = _shells(curves, at)
    most = np.where(shell, at.circle, 1.5 * curves.radius)
    step = at.centre * np.minimum(1, most / np.maximum(length, 1e-12))[:, None]
    return replace(curves, nodes=curves.nodes + np.where((trusted | shell)[:, None], step, 0))


_FEWEST = 8
"""Least number of points of a cross-section."""


def _shells(curves: Curves, at: CrossSections) -> NDArray[np.bool_]:
    """Return (J,) where the first chain runs in the wall of a stem seen from one side: a third of a round or more.

    Half the points of such an arc lie within 8 % of the radius from the circle. Most of the stem below must look so
    too, but for its cut foot: a blade rolled up above a solid stem has such sections as well.
    """
    arc = (at.count >= _FEWEST) & (at.residual <= 0.08 * at.circle) & (at.wide >= 0.6 * at.circle)
    shells, own = np.zeros(len(curves.nodes), dtype=bool), curves.chains[0]
    shells[own] = arc[own] & (np.cumsum(arc[own]) + 1 >= 0.5 * np.arange(1, len(own) + 1))
    return shells


def _straighten_start(curves: Curves) -> Curves:
    """Put the first two nodes on the line of the next ones: sections at the soil are cut off aslant."""
    nodes, first = curves.nodes.copy(), curves.chains[0]
    if len(first) >= 6:
        step = (nodes[first[5]] - nodes[first[2]]) / 3
        nodes[first[1]], nodes[first[0]] = nodes[first[2]] - step, nodes[first[2]] - 2 * step
    return replace(curves, nodes=nodes)


def _extend_ends(curves: Curves, points: Array) -> Curves:
    """Move the tips and the root out to where the cloud ends."""
    nodes, first = curves.nodes.copy(), curves.chains[0]
    _, owner = nearest(points, nodes)
    order = np.argsort(owner, kind="stable")
    for end, inside in [(first[0], first[1]), *((chain[-1], chain[-2]) for chain in curves.chains)]:
        outward = nodes[end] - nodes[inside]
        step = np.linalg.norm(outward)
        owned = order[slice(*np.searchsorted(owner[order], [end, end + 1]))]
        if len(owned) >= _FEWEST and step > 0:
            reach = np.quantile((points[owned] - nodes[end]) @ (outward / step), 0.9)
            nodes[end] += outward / step * np.clip(reach, 0, 2 * step)
    return replace(curves, nodes=nodes)


def _radii(curves: Curves, points: Array, fattening: float) -> Curves:
    """Return the curves with radii (half thickness where the section is flat) and half widths, from the cloud.

    The radius of a round section is the median distance of the surface from the centreline, less what the sensor adds.
    Of a flat section, 2.2 times as broad as thick, it is not much more than the inscribed radius of the solid: a curled
    blade encloses air. No organ is more than 1.3 times as thick as what carries it, the stem as its lower part.
    """
    at = _sections(curves, points)
    known, flat = at.count >= _FEWEST, at.wide > 2.2 * at.thin
    radius = np.where(flat, np.minimum(at.thin, 1.5 * curves.radius), at.surface - fattening)
    radius = np.where(_shells(curves, at) & flat, at.circle - fattening, radius)
    radius, width = np.where(known, radius, curves.radius), np.where(known, at.wide - fattening, curves.width)
    for number, (chain, own) in enumerate(zip(curves.chains, curves.own, strict=True)):
        for values in (radius, width):
            values[own] = median_filter(values[own], size=min(5, len(own)), mode="nearest")
        carrier = radius[chain[0]] if number else float(np.median(radius[own[: max(len(own) // 4, 3)]]))
        radius[own] = np.minimum(radius[own], 1.3 * carrier)
    radius = np.maximum(radius, 1e-4)  # [m], finer than any sensor
    return replace(curves, radius=radius, width=np.maximum(width, radius))


@dataclass(frozen=True, slots=True, eq=False)
class CrossSections:
    """The points around each node, projected along its tangent.

    Attributes:
        count: (J,) points looked at.
        centre: (J, 3) step from the node to the centre of the fitted circle [m].
        circle: (J,) radius of the circle [m].
        residual: (J,) median distance of the points from the circle [m].
        surface: (J,) median distance of the points from the node [m].
        thin, wide: (J,) half extents along the minor and the major axis [m]; of a circle both are its radius.
    """

    count: NDArray[Any]
    centre: Array
    circle: Array
    residual: Array
    surface: Array
    thin: Array
    wide: Array


def cross_sections(points: Array, nodes: Array, tangent: Array, around: NDArray[Any]) -> CrossSections:
    """Return the cross-section of the points (N, 3) nearest to each node, or to its neighbours along the chain.

    Tangents (J, 3) are unit vectors; `around` (J, 3) are the node before each on the same chain, itself and the node
    after; -1 at the chain's ends.
    """
    _, owner = nearest(points, nodes)
    order = np.argsort(owner, kind="stable")
    start = np.searchsorted(owner[order], np.arange(len(nodes) + 1))
    count, table = np.zeros(len(nodes), np.int64), np.zeros((len(nodes), 8))
    enough = 200  # points of a section beyond these are thinned: more cost time alone
    scratch = np.empty((2 * enough, 2)), *np.empty((2, 2 * enough))
    _measured(points[order], start, nodes, tangent, around, count, table, *scratch)
    return CrossSections(count, table[:, :3], *table[:, 3:].T)


@compiled
def _measured(points, start, nodes, tangent, around, counts, out, flat, away, some):
    """Fill (J,) counts and (J, 8) rows of `CrossSections`; node j owns the points start[j] to start[j + 1].

    The others are scratch, for twice as many points as are enough: NumPy's own functions would take seconds to compile.
    """
    enough = len(flat) // 2
    for j in range(len(nodes)):
        total = 0
        for k in around[j]:
            total += start[k + 1] - start[k] if k >= 0 else 0
        step, seen, count = -(-total // enough) if total else 1, 0, 0
        (u, v, w), (a, b, c) = _across(tangent[j, 0], tangent[j, 1], tangent[j, 2])
        for k in around[j]:
            if k < 0:
                continue
            for m in range(start[k], start[k + 1]):
                if seen % step == 0:
                    x, y, z = points[m, 0] - nodes[j, 0], points[m, 1] - nodes[j, 1], points[m, 2] - nodes[j, 2]
                    flat[count, 0], flat[count, 1] = x * u + y * v + z * w, x * a + y * b + z * c
                    count += 1
                seen += 1
        counts[j] = count
        count = counts[j]  # for numba an int64, no longer what may be the literal 0
        if count >= 3:
            x, y, out[j, 3], out[j, 4] = _circle(flat, away, some, count)
            out[j, 0], out[j, 1], out[j, 2] = x * u + y * a, x * v + y * b, x * w + y * c
            out[j, 5], out[j, 6], out[j, 7] = _extents(flat, away, some, count)


@inlined
def _across(x, y, z):
    """Return two unit vectors across a unit tangent: across it and the axis that it is the farthest from."""
    if abs(x) <= abs(y) and abs(x) <= abs(z):
        one = (0.0, z, -y)
    elif abs(y) <= abs(z):
        one = (-z, 0.0, x)
    else:
        one = (y, -x, 0.0)
    size = math.sqrt(one[0] * one[0] + one[1] * one[1] + one[2] * one[2] + 1e-24)
    a, b, c = one[0] / size, one[1] / size, one[2] / size
    return (a, b, c), (y * c - z * b, z * a - x * c, x * b - y * a)


@inlined
def _circle(flat, away, some, count):
    """Return (x, y, radius, median residual) of the circle through `count` points (Kasa 1976), trimmed once.

    The normal equations of 2 x X + 2 y Y + c = X^2 + Y^2 are solved by L D L^T.
    """
    limit, x, y, r, residual = math.inf, 0.0, 0.0, 0.0, 0.0
    for _ in range(2):
        xx = xy = yy = sx = sy = n = right_x = right_y = right = 0.0
        for m in range(count):
            if limit == math.inf or away[m] <= limit:
                a, b = 2 * flat[m, 0], 2 * flat[m, 1]
                square = 0.25 * (a * a + b * b)
                xx, xy, yy, sx, sy, n = xx + a * a, xy + a * b, yy + b * b, sx + a, sy + b, n + 1
                right_x, right_y, right = right_x + a * square, right_y + b * square, right + square
        size = xx + yy
        xx, yy = xx + 1e-9 * size + 1e-30, yy + 1e-9 * size + 1e-30
        p, q = xy / xx, sx / xx
        yy, sy, right_y = yy - p * xy, sy - p * sx, right_y - p * right_x
        t = sy / yy
        c = (right - q * right_x - t * right_y) / (n - q * sx - t * sy)
        y = (right_y - sy * c) / yy
        x = (right_x - xy * y - sx * c) / xx
        square = c + x * x + y * y
        r = math.sqrt(square) if square > 0 else 0.0
        for m in range(count):
            away[m] = abs(math.sqrt((flat[m, 0] - x) ** 2 + (flat[m, 1] - y) ** 2) - r)
        residual = _median(away, some, count)
        limit = 2.5 * residual
    return x, y, r, residual


@inlined
def _median(values, some, count):
    """Return the median of the first `count` values (`some` is scratch): NumPy's takes seconds to compile."""
    middle, low, high = count // 2, 0, count - 1
    for k in range(count):
        some[k] = values[k]
    while low < high:  # quickselect
        pivot, i, j = some[(low + high) // 2], low, high
        while i <= j:
            while some[i] < pivot:
                i += 1
            while some[j] > pivot:
                j -= 1
            if i <= j:
                some[i], some[j] = some[j], some[i]
                i, j = i + 1, j - 1
        if j < middle < i:
            break
        low, high = (low, j) if middle <= j else (i, high)
    below = some[middle]
    if count % 2 == 0:
        below = some[0]
        for k in range(1, middle):
            below = some[k] if some[k] > below else below
    return 0.5 * (below + some[middle])


@inlined
def _extents(flat, away, some, n):
    """Return (surface, thin, wide) of n points about the node; on a circle, median |x| is r / sqrt(2)."""
    for m in range(n):
        away[m] = math.sqrt(flat[m, 0] ** 2 + flat[m, 1] ** 2)
    surface = _median(away, some, n)
    xx = xy = yy = 0.0
    for m in range(n):
        if away[m] <= 2.5 * surface:
            xx, xy, yy = xx + flat[m, 0] ** 2, xy + flat[m, 0] * flat[m, 1], yy + flat[m, 1] ** 2
    turn = 0.5 * math.atan2(2 * xy, xx - yy)
    c, s = math.cos(turn), math.sin(turn)
    for m in range(n):
        away[m] = abs(c * flat[m, 0] + s * flat[m, 1])
    one = _median(away, some, n)
    for m in range(n):
        away[m] = abs(c * flat[m, 1] - s * flat[m, 0])
    two = _median(away, some, n)
    if one > two:
        one, two = two, one
    return surface, math.sqrt(2.0) * one, math.sqrt(2.0) * two
