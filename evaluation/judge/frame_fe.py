"""A 3-D frame of tapered Euler-Bernoulli beams that hangs in gravity and is held at one node: small harmonic motion.

Displacement-based: cubic bending, linear stretch and twist, consistent mass with rotary inertia, stiffness and mass
integrated over the taper. Gravity acts through the second variation of the potential about the given shape, which is
in equilibrium: with the internal force n and moment m that carry the weight beyond (known, since the frame is a tree),
the energy of displacement u and rotation theta is, along the unit tangent t,

    integral of  -n . (theta x u')  +  n . (theta x (theta x t)) / 2  -  m . (theta x theta') / 2  ds

(second-order part of the strains of a geometrically exact beam, J. C. Simo 1985), and that of a mass on an arm d is
m g (z . theta theta . d - d_z theta^2) / 2.

World frame [m], z up. N nodes with six degrees of freedom each (3 displacements, 3 rotations), E elements from node i
to node j, j farther from the foot; L lumps; G Gauss points of an element, M modes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import eigh
from scipy.sparse import csc_array, csr_array, diags_array
from scipy.sparse.linalg import eigsh, splu

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

STANDARD_GRAVITY = 9.81
_ROOTS, _WEIGHTS = np.polynomial.legendre.leggauss(4)
AT, WEIGHT = (_ROOTS + 1) / 2, _WEIGHTS / 2
"""Gauss points of an element and their weights, shares of its length."""
BEYOND = np.array(
    [[np.diff(np.polyval(np.polyint(np.polyfit(AT, one, 3)), [a, 1]))[0] for one in np.eye(4)] for a in AT]
)
"""(G, G) weights of the integral from each Gauss point to the element's end; exact for cubics."""


DENSE = 400
"""Up to so many degrees of freedom all modes are found at once."""


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """The elements; an element's end that is nearer to the foot comes first.

    Attributes:
        nodes: (N, 3) [m]; node 0 is the foot.
        ends: (E, 2) int, i and j; each node but the foot is the end j of one element, listed after that of its i.
        across: (E, 3) unit vector across the element, the first axis of its section.
        stretch: (E, G) EA at the Gauss points [N].
        bend: (E, G, 2) EI about the section's first and second axis [N m2].
        twist: (E, G) GJ [N m2].
        mass: (E, G) per length [kg/m].
        spin: (E, G, 2) moment of inertia per length about the section's first and second axis [kg m].
        damping_ratio: (E,) of the element's material.
    """

    nodes: Array
    ends: NDArray[np.int64]
    across: Array
    stretch: Array
    bend: Array
    twist: Array
    mass: Array
    spin: Array
    damping_ratio: Array

    @property
    def length(self) -> Array:
        """(E,) [m]."""
        return np.linalg.norm(self.nodes[self.ends[:, 1]] - self.nodes[self.ends[:, 0]], axis=1)

    @property
    def frames(self) -> Array:
        """(E, 3, 3) rows: the tangent, the section's first and second axis."""
        t = (self.nodes[self.ends[:, 1]] - self.nodes[self.ends[:, 0]]) / self.length[:, None]
        return np.stack([t, self.across, np.cross(t, self.across)], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class Lumps:
    """Rigid bodies fixed to nodes.

    Attributes:
        node: (L,) int.
        mass: (L,) [kg].
        arm: (L, 3) from the node to the centre of mass [m].
        inertia: (L, 3, 3) about the centre of mass [kg m2].
    """

    node: NDArray[np.int64]
    mass: Array
    arm: Array
    inertia: Array


NO_LUMPS = Lumps(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)))


class Shapes(NamedTuple):
    """How the fields along an element follow from its twelve local degrees of freedom; each (E, G, 3, 12).

    Attributes:
        place, turn: displacement and rotation vector.
        place_slope, turn_slope: their derivatives along the element: strain u'_x, curvatures.
    """

    place: Array
    turn: Array
    place_slope: Array
    turn_slope: Array


class Frame:
    """The assembled frame, its foot clamped.

    Attributes:
        beams, lumps: what it is made of.
        elastic: (6N, 6N) sparse stiffness of the material.
        stiffness: (6N, 6N) sparse, the same and gravity.
        mass: (6N, 6N) sparse.
    """

    def __init__(
        self,
        beams: Beams,
        lumps: Lumps = NO_LUMPS,
        ties: Mapping[int, float] = MappingProxyType({}),
        *,
        gravity: float = STANDARD_GRAVITY,
    ) -> None:
        """Assemble.

        Args:
            beams: the elements.
            lumps: what they carry.
            ties: stiffness of horizontal springs by node [N/m].
            gravity: [m/s2].
        """
        self.beams, self.lumps = beams, lumps
        shapes = _shapes(beams)
        self._element_stiffness = _elastic(beams, shapes)
        self.elastic = _assembled(beams, self._element_stiffness)
        self.stiffness = self.elastic
        if gravity:
            self.stiffness = self.elastic + _assembled(beams, _prestress(beams, lumps, shapes, gravity))
            self.stiffness += _at_nodes(beams, lumps.node, _lump_weight(lumps, gravity))
        spring = np.zeros(6 * len(beams.nodes))
        for node, stiffness in ties.items():
            spring[6 * node : 6 * node + 2] = stiffness
        self.stiffness = self.stiffness + diags_array(spring)
        self.mass = _assembled(beams, _inertia(beams, shapes)) + _at_nodes(beams, lumps.node, _lump_mass(lumps))

    def free(self, held: ArrayLike = ()) -> NDArray[np.int64]:
        """Return the degrees of freedom that are neither the foot's nor held."""
        return np.setdiff1d(np.arange(self.mass.shape[0]), np.concatenate([np.arange(6), np.asarray(held, dtype=int)]))

    def modes(self, below: float, held: ArrayLike = ()) -> tuple[Array, Array]:
        """Return natural angular frequencies (M,) [rad/s] and shapes (6N, M) of unit modal mass.

        Args:
            below: all modes up to this frequency are found [Hz].
            held: degrees of freedom that stand still.

        Raises:
            ValueError: the frame buckles under its weight.
        """
        free = self.free(held)
        K, M = (A[free][:, free].tocsc() for A in (self.stiffness, self.mass))
        values, shapes = _lowest(K, M, (2 * np.pi * below) ** 2)
        if values.min() <= 0:
            raise ValueError("the frame does not carry its own weight")
        order = np.argsort(values)
        out = np.zeros((self.mass.shape[0], len(values)))
        out[free] = shapes[:, order]
        return np.sqrt(values[order]), out

    def damping_of(self, modes: Array) -> Array:
        """Return (M,) the mean of the elements' damping ratios over the strain energy of each mode (6N, M)."""
        local = self._local(modes)
        energy = np.einsum("eam,eab,ebm->em", local, self._element_stiffness, local, optimize=True)
        return self.beams.damping_ratio @ energy / energy.sum(axis=0)

    def _local(self, motion: NDArray[Any]) -> NDArray[Any]:
        """Return (E, 12, M) the elements' degrees of freedom, in their own frames, in motions (6N, M)."""
        ends = motion.reshape(-1, 2, 3, motion.shape[1])[self.beams.ends]
        return np.einsum("eij,ekljm->eklim", self.beams.frames, ends).reshape(len(ends), 12, -1)

    def lossy(self) -> Any:
        """Return the imaginary stiffness (6N, 6N) of material whose loss factor is twice its damping ratio."""
        return _assembled(self.beams, 2 * self.beams.damping_ratio[:, None, None] * self._element_stiffness)


@dataclass(frozen=True, slots=True, eq=False)
class Shake:
    """A node whose displacement across and whose direction are prescribed; its height is free.

    Attributes:
        node: its number.
        direction: (3,) horizontal unit vector it moves along.
    """

    node: int
    direction: Array

    @property
    def held(self) -> NDArray[np.int64]:
        """(5,) its prescribed degrees of freedom."""
        return 6 * self.node + np.array([0, 1, 3, 4, 5])

    @property
    def value(self) -> Array:
        """(5,) what they are per metre of motion."""
        return np.concatenate([self.direction[:2], np.zeros(3)])


def hysteretic_response(frame: Frame, shake: Shake, frequencies: ArrayLike) -> ComplexArray:
    """Return (6N, Q) the steady motion per metre of grip when each element's modulus is E (1 + 2 i zeta)."""
    lossy = frame.lossy()
    return _columns(frame, shake, lambda omega: frame.stiffness + 1j * lossy - omega**2 * frame.mass, frequencies)


def modal_response(frame: Frame, shake: Shake, frequencies: ArrayLike, *, damped_below: float) -> ComplexArray:
    """Return (6N, Q) the steady motion per metre of grip when each mode of the held frame has a damping ratio.

    It is the mean of the elements' ratios over the mode's strain energy. The undamped motion is solved for directly, so
    that no mode is left out; the modes only say how damping changes it.

    Args:
        frame: what is shaken.
        shake: where and how it is held.
        frequencies: (Q,) [Hz].
        damped_below: modes faster than this are not damped [Hz].
    """
    motion = _columns(frame, shake, lambda omega: frame.stiffness - omega**2 * frame.mass, frequencies)
    omega_n, shapes = frame.modes(damped_below, shake.held)
    ratio, free = frame.damping_of(shapes), frame.free(shake.held)
    omega = 2 * np.pi * np.atleast_1d(np.asarray(frequencies, dtype=np.float64))
    undamped = omega_n[:, None] ** 2 - omega**2
    part = shapes[free].T @ (frame.mass[free][:, free] @ motion[free])
    return motion + shapes @ (part * (undamped / (undamped + 2j * (ratio * omega_n)[:, None] * omega) - 1))


def _columns(frame: Frame, shake: Shake, dynamic: Any, frequencies: ArrayLike) -> ComplexArray:
    free, columns = frame.free(shake.held), []
    for f in np.atleast_1d(np.asarray(frequencies, dtype=np.float64)):
        D = csc_array(dynamic(2 * np.pi * f), dtype=np.complex128)
        column = np.zeros(frame.mass.shape[0], dtype=np.complex128)
        column[shake.held] = shake.value
        column[free] = splu(D[free][:, free].tocsc()).solve(-(D[free][:, shake.held] @ shake.value.astype(complex)))
        columns.append(column)
    return np.array(columns).T


def _lowest(K: Any, M: Any, least: float) -> tuple[Array, Array]:
    """Return eigenvalues and vectors of K x = w M x: all up to `least`, and some more."""
    size, count = K.shape[0], 40
    if size <= DENSE:
        return eigh(K.toarray(), M.toarray())
    values, shapes = eigsh(K, count, M, sigma=0.0, v0=np.ones(size))
    while values.max() <= least and 2 * count < size:
        count *= 2
        values, shapes = eigsh(K, count, M, sigma=0.0, v0=np.ones(size))
    return values, shapes


def _shapes(beams: Beams) -> Shapes:
    """Evaluate Hermite's cubics; the local order is u_t, u_1, u_2, theta_t, theta_1, theta_2 at i and then at j."""
    s, h = AT, beams.length[:, None]
    one = np.ones_like(h)
    cubic = np.stack([one * (1 - 3 * s**2 + 2 * s**3), h * (s - 2 * s**2 + s**3), one * (3 * s**2 - 2 * s**3)], -1)
    cubic = np.concatenate([cubic, (h * (s**3 - s**2))[..., None]], -1)
    slope = np.stack(
        [6 * (s**2 - s) / h, one * (1 - 4 * s + 3 * s**2), 6 * (s - s**2) / h, one * (3 * s**2 - 2 * s)], -1
    )
    curve = np.stack([(12 * s - 6) / h**2, (6 * s - 4) / h, (6 - 12 * s) / h**2, (6 * s - 2) / h], -1)
    linear, rate = np.stack([one * (1 - s), one * s], -1), np.stack([-one / h, one / h], -1) * np.ones((1, len(s), 1))
    place, turn, place_slope, turn_slope = np.zeros((4, len(h), len(s), 3, 12))
    place[..., 0, [0, 6]], place_slope[..., 0, [0, 6]] = linear, rate
    turn[..., 0, [3, 9]], turn_slope[..., 0, [3, 9]] = linear, rate
    first, second = [1, 5, 7, 11], [2, 4, 8, 10]  # theta_2 = u_1', theta_1 = -u_2'
    flip = np.array([1, -1, 1, -1])
    place[..., 1, first], place_slope[..., 1, first] = cubic, slope
    turn[..., 2, first], turn_slope[..., 2, first] = slope, curve
    place[..., 2, second], place_slope[..., 2, second] = cubic * flip, slope * flip
    turn[..., 1, second], turn_slope[..., 1, second] = -slope * flip, -curve * flip
    return Shapes(place, turn, place_slope, turn_slope)


def _integrated(beams: Beams, left: Array, weight: Array, right: Array) -> Array:
    """Return (E, 12, 12) the integral of left^T weight right, weight (E, G, 3, 3)."""
    return np.einsum("e,g,egia,egij,egjb->eab", beams.length, WEIGHT, left, weight, right, optimize=True)


def _diagonal(*values: Array) -> Array:
    return np.stack(values, axis=-1)[..., None] * np.eye(3)


def _elastic(beams: Beams, shapes: Shapes) -> Array:
    nothing = np.zeros_like(beams.stretch)
    out = _integrated(beams, shapes.place_slope, _diagonal(beams.stretch, nothing, nothing), shapes.place_slope)
    section = _diagonal(beams.twist, beams.bend[..., 0], beams.bend[..., 1])
    return out + _integrated(beams, shapes.turn_slope, section, shapes.turn_slope)


def _inertia(beams: Beams, shapes: Shapes) -> Array:
    out = _integrated(beams, shapes.place, _diagonal(beams.mass, beams.mass, beams.mass), shapes.place)
    first, second = beams.spin[..., 0], beams.spin[..., 1]
    return out + _integrated(beams, shapes.turn, _diagonal(first + second, first, second), shapes.turn)


def _prestress(beams: Beams, lumps: Lumps, shapes: Shapes, gravity: float) -> Array:
    force, moment = carried(beams, lumps, gravity)
    frames = beams.frames
    n, m = (np.einsum("eij,egj->egi", frames, v) for v in (force, moment))
    t = np.eye(3)[0]
    turns = (n[..., :, None] * t + t[:, None] * n[..., None, :]) / 2 - n[..., 0, None, None] * np.eye(3)
    mixed = _integrated(beams, shapes.turn, cross_matrix(n), shapes.place_slope)
    mixed += _integrated(beams, shapes.turn, cross_matrix(m) / 2, shapes.turn_slope)
    return _integrated(beams, shapes.turn, turns, shapes.turn) + mixed + mixed.transpose(0, 2, 1)


def carried(beams: Beams, lumps: Lumps, gravity: float) -> tuple[Array, Array]:
    """Return the internal force [N] and moment [N m] (E, G, 3) with which the part beyond pulls at the part before."""
    i, j = beams.ends.T
    weight, moment = np.zeros(len(beams.nodes)), np.zeros_like(beams.nodes)  # beyond a node; moment = weight x place
    np.add.at(weight, lumps.node, lumps.mass * gravity)
    np.add.at(moment, lumps.node, (lumps.mass * gravity)[:, None] * (beams.nodes[lumps.node] + lumps.arm))
    line = gravity * beams.length[:, None] * beams.mass
    place = beams.nodes[i][:, None] + AT[:, None] * (beams.nodes[j] - beams.nodes[i])[:, None]
    own, own_moment = line @ WEIGHT, np.einsum("eg,g,egi->ei", line, WEIGHT, place)
    for e in range(len(i) - 1, -1, -1):
        weight[i[e]] += weight[j[e]] + own[e]
        moment[i[e]] += moment[j[e]] + own_moment[e]
    total = weight[j][:, None] + line @ BEYOND.T
    first = moment[j][:, None] + np.einsum("eg,hg,egi->ehi", line, BEYOND, place)
    down = np.array([0, 0, -1.0])
    return total[..., None] * down, np.cross(first - total[..., None] * place, down)


def _lump_mass(lumps: Lumps) -> Array:
    arm = -cross_matrix(lumps.arm)  # the centre moves by u + theta x d = u - d x theta
    reach = np.concatenate([np.tile(np.eye(3), (len(arm), 1, 1)), arm], axis=2)
    out = lumps.mass[:, None, None] * np.einsum("lia,lib->lab", reach, reach)
    out[:, 3:, 3:] += lumps.inertia
    return out


def _lump_weight(lumps: Lumps, gravity: float) -> Array:
    up, d = np.array([0, 0, 1.0]), lumps.arm
    out = np.zeros((len(d), 6, 6))
    out[:, 3:, 3:] = (up[:, None] * d[:, None, :] + d[:, :, None] * up) / 2 - d[:, 2, None, None] * np.eye(3)
    return gravity * lumps.mass[:, None, None] * out


def cross_matrix(v: Array) -> Array:
    """Return the matrices (..., 3, 3) of v x for v (..., 3)."""
    return np.cross(v[..., None, :], np.eye(3)).swapaxes(-1, -2)


def _assembled(beams: Beams, local: Array) -> Any:
    """Return (6N, 6N) sparse from matrices (E, 12, 12) in the elements' own frames."""
    turn = np.zeros((len(local), 12, 12))
    for block in range(0, 12, 3):
        turn[:, block : block + 3, block : block + 3] = beams.frames
    world = np.einsum("eia,eij,ejb->eab", turn, local, turn, optimize=True)
    dofs = (6 * beams.ends[:, :, None] + np.arange(6)).reshape(-1, 12)
    return scattered(world, dofs, 6 * len(beams.nodes))


def _at_nodes(beams: Beams, node: NDArray[np.int64], blocks: Array) -> Any:
    return scattered(blocks, 6 * node[:, None] + np.arange(6), 6 * len(beams.nodes))


def scattered(blocks: Array, dofs: NDArray[np.int64], size: int) -> Any:
    """Return (size, size) sparse, the sum of blocks (L, n, n) at the degrees of freedom (L, n)."""
    rows, columns = np.broadcast_arrays(dofs[:, :, None], dofs[:, None, :])
    return csr_array((blocks.ravel(), (rows.ravel(), columns.ravel())), (size, size))
