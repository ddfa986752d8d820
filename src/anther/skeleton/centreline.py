"""From a coarse tree to smooth, evenly spaced centrelines in the middle of the organs, with radii. J nodes.

A tree of voxels or bands keeps the steps of its grid, and a rod model fed with it bends at each step (paper P7,
beyond). Here each chain is resampled, every node is moved to the centre of the cloud's cross-section around it
(a circle where the section is round, the mean where it is a blade), and what remains is smoothed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, median_filter
from scipy.spatial import KDTree

from anther.geometry import Array
from anther.skeleton.raw_tree import RawTree, chains


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
    def parent(self) -> NDArray[Any]:
        """(J,) parent of each node; parent[0] = -1, parent[j] < j."""
        parent = np.full(len(self.nodes), -1)
        for chain in self.chains:
            parent[chain[1:]] = chain[:-1]
        return parent


def resample(tree: RawTree, gain: Array, spacing: float) -> Curves:
    """Return the tree's chains, smoothed and evenly spaced, side chains attached where their direction points.

    Args:
        tree: the coarse tree.
        gain: (J,) path gain that decides which child goes on with its parent's chain.
        spacing: wanted distance between nodes [m]; a side chain shorter than half of it is dropped.
    """
    first, *others = chains(tree.parent, gain)
    nodes, radius = _even(_smooth(tree.nodes[first]), tree.thickness[first], spacing, fewest=1)
    made = [np.arange(len(nodes))]
    home = np.zeros(len(tree.nodes), dtype=np.int64)
    for chain in others:
        host = made[home[chain[0]]]
        at = host[_attachment(tree.nodes[chain], nodes[host])]
        line = np.concatenate([nodes[at][None], tree.nodes[chain[1:]]])
        new, thick = _even(_smooth(line), tree.thickness[chain], spacing)
        home[chain[1:]] = len(made) if len(new) else home[chain[0]]
        if len(new):
            made.append(np.concatenate([[at], np.arange(len(nodes), len(nodes) + len(new) - 1)]))
            nodes, radius = np.concatenate([nodes, new[1:]]), np.concatenate([radius, thick[1:]])
    return Curves(nodes, made, radius, radius)


def centred(curves: Curves, points: Array, *, rounds: int, smallest: float) -> Curves:
    """Return the curves moved to the middle of the cloud's cross-sections, with radii from the cloud.

    Args:
        curves: evenly spaced chains.
        points: (N, 3) the cloud [m].
        rounds: how often to repeat: each round sees sections cut across better centrelines.
        smallest: no radius is smaller [m].
    """
    for _ in range(rounds):
        curves = _smoothed(_recentred(curves, points))
    curves = _reaching_ends(_straight_start(curves), points)
    return _radii(curves, points, smallest)


def _attachment(line: Array, host: Array) -> int:
    """Return which host node a side chain leaves: where the line through its first nodes meets the host.

    The first separate band of an acute petiole lies above the axil, by up to the distance it then has from the
    stem; farther than twice that distance is not believed.
    """
    near = np.linalg.norm(host - line[0], axis=1)
    if len(line) < 4:
        return int(np.argmin(near))
    begin = line[1]
    direction = line[min(5, len(line) - 1)] - begin
    direction /= max(np.linalg.norm(direction), 1e-12)
    offset = host - begin
    along = offset @ direction
    aside = np.linalg.norm(offset - along[:, None] * direction, axis=1)
    reach = 2 * np.linalg.norm(offset, axis=1).min() + near.min()
    allowed = (near <= max(reach, near.min())) & (along <= 0)
    return int(np.argmin(np.where(allowed, aside, np.inf))) if allowed.any() else int(np.argmin(near))


def _even(line: Array, values: Array, spacing: float, fewest: int = 0) -> tuple[Array, Array]:
    """Return the line and the values on it at even steps close to `spacing`; nothing if it is too short."""
    step = np.linalg.norm(np.diff(line, axis=0), axis=1)
    arc = np.concatenate([[0], np.cumsum(step)])
    count = max(round(arc[-1] / spacing), fewest)
    if count < 1:
        return line[:0], values[:0]
    at = np.linspace(0, arc[-1], count + 1)
    return np.stack([np.interp(at, arc, column) for column in line.T], axis=1), np.interp(at, arc, values)


def _smooth(line: Array, sigma: float = 1.0) -> Array:
    """Return the line smoothed by a Gaussian of `sigma` nodes; both ends stay where they are."""
    if len(line) < 3:
        return line.copy()
    pad = min(len(line) - 1, int(4 * sigma) + 1)
    before, after = 2 * line[0] - line[pad:0:-1], 2 * line[-1] - line[-2 : -pad - 2 : -1]
    smooth = gaussian_filter1d(np.concatenate([before, line, after]), sigma, axis=0)[pad:-pad]
    smooth[0], smooth[-1] = line[0], line[-1]
    return smooth


def _smoothed(curves: Curves, sigma: float = 1.0) -> Curves:
    nodes = curves.nodes.copy()
    for chain in curves.chains:
        nodes[chain] = _smooth(nodes[chain], sigma)
    return replace(curves, nodes=nodes)


def _tangents(curves: Curves) -> Array:
    tangent = np.zeros_like(curves.nodes)
    for number, chain in enumerate(curves.chains):
        along = np.gradient(curves.nodes[chain], axis=0)
        own = chain if number == 0 else chain[1:]
        tangent[own] = along[-len(own) :]
    return tangent / np.maximum(np.linalg.norm(tangent, axis=1), 1e-12)[:, None]


def _owners(curves: Curves, points: Array) -> list[NDArray[Any]]:
    """Return for each node the points nearer to it than to any other node."""
    nearest = np.asarray(KDTree(curves.nodes).query(points)[1])
    order = np.argsort(nearest, kind="stable")
    return np.split(order, np.searchsorted(nearest[order], np.arange(1, len(curves.nodes))))


def _around(points: Array, owned: list[NDArray[Any]], chain: NDArray[Any], i: int) -> Array:
    """Return the cloud around the chain's i-th node: its own points and its neighbours', thinned evenly."""
    mine = np.concatenate([owned[k] for k in chain[max(i - 1, 0) : i + 2]])
    return points[mine[:: -(-len(mine) // _ENOUGH) or 1]]


def _recentred(curves: Curves, points: Array) -> Curves:
    nodes, tangent, owned = curves.nodes.copy(), _tangents(curves), _owners(curves, points)
    for number, chain in enumerate(curves.chains):
        for i in range(0 if number == 0 else 1, len(chain)):
            node = chain[i]
            section = _around(points, owned, chain, i)
            if len(section) >= _FEWEST:
                nodes[node] += _to_centre(section - curves.nodes[node], tangent[node], float(curves.radius[node]))
    return replace(curves, nodes=nodes)


_FEWEST = 8
"""Points needed to say anything about a cross-section."""

_ENOUGH = 200
"""More points than this do not make a cross-section better."""

_THICKER = 1.3
"""No organ is thicker than this times what carries it, the stem than its lower part: a curled leaf may look so."""

_FLAT = 2.2
"""A section is flat when it is broader than thick by more than this."""

_ROUND = 0.25
"""A section is round when half its points lie within this share of the radius from the fitted circle."""


def _to_centre(offset: Array, tangent: Array, radius: float) -> Array:
    """Return the step (3,) from a node to the centre of its cross-section."""
    frame = _across(tangent)
    flat = offset @ frame.T
    centre, r, residual = _circle(flat)
    if residual > _ROUND * r or r > 3 * radius:
        return np.zeros(3)
    return (centre * min(1.0, 1.5 * radius / max(float(np.linalg.norm(centre)), 1e-12))) @ frame


def _circle(flat: Array) -> tuple[Array, float, float]:
    """Return (centre, radius, median absolute residual) of a circle through (M, 2) points (Kasa), trimmed once."""
    use = np.ones(len(flat), dtype=bool)
    centre, r, residual = np.zeros(2), 0.0, np.zeros(len(flat))
    for _ in range(2):
        design = np.column_stack([2 * flat[use], np.ones(use.sum())])
        solution, *_ = np.linalg.lstsq(design, (flat[use] ** 2).sum(axis=1), rcond=None)
        centre, r = solution[:2], float(np.sqrt(max(solution[2] + solution[:2] @ solution[:2], 0)))
        residual = np.abs(np.linalg.norm(flat - centre, axis=1) - r)
        use = residual <= 2.5 * np.median(residual)
    return centre, r, float(np.median(residual))


def _across(tangent: Array) -> Array:
    """Return two unit vectors (2, 3) across a unit tangent."""
    helper = np.eye(3)[np.argmin(np.abs(tangent))]
    one = np.cross(tangent, helper)
    one = one / max(float(np.linalg.norm(one)), 1e-12)
    return np.array([one, np.cross(tangent, one)], dtype=np.float64)


def _straight_start(curves: Curves) -> Curves:
    """Put the first two nodes on the line of the next ones: sections at the soil are cut off aslant."""
    nodes, first = curves.nodes.copy(), curves.chains[0]
    if len(first) >= 6:
        step = (nodes[first[5]] - nodes[first[2]]) / 3
        nodes[first[1]], nodes[first[0]] = nodes[first[2]] - step, nodes[first[2]] - 2 * step
    return replace(curves, nodes=nodes)


def _reaching_ends(curves: Curves, points: Array) -> Curves:
    """Move the tips and the root out to where the cloud ends: a band's centre lies half a band inside."""
    nodes, owned = curves.nodes.copy(), _owners(curves, points)
    first = curves.chains[0]
    for end, inner in [(first[0], first[1]), *((chain[-1], chain[-2]) for chain in curves.chains)]:
        outward = nodes[end] - nodes[inner]
        step = np.linalg.norm(outward)
        if len(owned[end]) >= _FEWEST and step > 0:
            reach = np.quantile((points[owned[end]] - nodes[end]) @ (outward / step), 0.9)
            nodes[end] += outward / step * np.clip(reach, 0, 2 * step)
    return replace(curves, nodes=nodes)


def _radii(curves: Curves, points: Array, smallest: float) -> Curves:
    """Return the curves with radii (half thickness where the section is flat) and half widths, from the cloud."""
    radius, width = curves.radius.copy(), curves.width.copy()
    tangent, owned = _tangents(curves), _owners(curves, points)
    for number, chain in enumerate(curves.chains):
        own = chain if number == 0 else chain[1:]
        for i, node in enumerate(own, start=len(chain) - len(own)):
            section = _around(points, owned, chain, i)
            if len(section) >= _FEWEST:
                radius[node], width[node] = _section(section - curves.nodes[node], tangent[node], float(radius[node]))
        for values in (radius, width):
            values[own] = median_filter(values[own], size=min(5, len(own)), mode="nearest")
        carrier = radius[chain[0]] if number else float(np.median(radius[own[: max(len(own) // 4, 3)]]))
        radius[own] = np.minimum(radius[own], _THICKER * carrier)
    radius = np.maximum(radius, smallest)
    return replace(curves, radius=radius, width=np.maximum(width, radius))


def _section(offset: Array, tangent: Array, inscribed: float) -> tuple[float, float]:
    """Return (radius, half width) of a cross-section.

    The radius is the median distance of the surface from the centreline, but not more than the half thickness across
    the narrower axis: depth cameras fatten stems, most along the line of sight (measured on simulated D455 captures:
    the median distance alone is 31 to 38 % too large, this -9 to +10 %). Of a flat section it is not much more than
    the inscribed radius of the solid, since a curled blade encloses air.
    """
    flat = offset @ _across(tangent).T
    distance = np.linalg.norm(flat, axis=1)
    surface = float(np.median(distance))
    own = flat[distance <= 2.5 * surface]
    axes = np.linalg.eigh(own.T @ own)[1]
    thin, wide = np.sqrt(2) * np.median(np.abs(flat @ axes), axis=0)  # on a circle, median |x| is r / sqrt(2)
    radius = min(surface, float(thin))
    if wide > _FLAT * thin:
        radius = min(radius, 1.5 * inscribed)
    return radius, float(wide)
