"""What is held and what is moved: clamped nodes, and the prescribed motion of the grip node (P21)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anther.core.checks import check_array, check_range
from anther.core.errors import bad_input
from anther.core.geometry import ComplexArray, interpolate
from anther.rods._rods import Array, Rods


@dataclass(frozen=True, slots=True, eq=False)
class Clamp:
    """What never moves: nodes, and what the soil holds.

    One clamped node alone is a pin: the rods may swing about it, but an edge next to a pinned root cannot spin. An edge
    with both ends clamped is rigid and holds the slope in its middle.

    Attributes:
        nodes: (C,) int node numbers.
        planted: whether the soil also holds the direction in which every edge leaves the root. The rods bend from the
            root on: half of such an edge, and its `joint_compliance`, is the spring between it and the soil.
    """

    nodes: NDArray[Any]
    planted: bool = False

    def __post_init__(self) -> None:
        nodes = np.unique(np.asarray(self.nodes, dtype=np.int64).ravel())
        nodes.flags.writeable = False
        object.__setattr__(self, "nodes", nodes)
        if self.planted and 0 not in nodes:
            raise bad_input("planted clamp", given=f"nodes {nodes}", allowed="nodes with 0, the root", do="Add node 0.")

    @classmethod
    def root(cls, rods: Rods) -> Clamp:
        """Plant the root: the stem leaves the soil in a fixed place and direction."""
        return cls(np.array([0]), planted=True)

    @classmethod
    def below(cls, rods: Rods, height: float) -> Clamp:
        """Plant the root, and clamp every other node with z < height [m]."""
        return cls(np.append(np.flatnonzero(rods.nodes[:, 2] < height), 0), planted=True)

    def free(self, rods: Rods, driven: Sequence[int] = ()) -> NDArray[np.bool_]:
        """Return (N, 4) which unknowns (x, y, z, spin) are free, with the driven nodes held as well.

        Raises:
            InputError: a node number outside 0..N-1, or everything clamped.
        """
        n = len(rods.nodes)
        for node in self.nodes:
            check_node("clamped node", int(node), n)
        held = np.isin(np.arange(n), self.nodes)
        free = np.ones((n, 4), dtype=np.bool_)
        free[held, :3] = False
        free[0, 3] = False
        free[1:, 3] = ~held[rods.parent[1:]] | (~held[1:] & (self.planted | (rods.parent[1:] != 0)))
        for node in driven:
            check_node("grip node", node, n)
            if held[node]:
                raise bad_input("grip node", given=node, allowed="a node that is not clamped", do="Grip higher up.")
            free[node, :3] = False
        free[gripped_edges(rods.parent, driven), 3] = False
        if not free[:, :3].any():
            raise bad_input("clamp", given="every node", allowed="at least one free node", do="Clamp fewer nodes.")
        return free


class Motion(ABC):
    """A prescribed motion of a grip that holds `node` and the nodes of `also`."""

    __slots__ = ()
    node: int
    also: tuple[int, ...]

    @property
    def nodes(self) -> tuple[int, ...]:
        """The driven nodes, the grip node first; they move as one body, and edges between them cannot twist in it."""
        return (self.node, *self.also)

    @abstractmethod
    def displacement(self, times: ArrayLike) -> Array:
        """Return (T, 3) displacements [m] from the start position at (T,) times [s]."""

    def rotation(self, times: ArrayLike) -> Array:
        """Return (T, 3) rotation vectors [rad] of the grip about its first node, from the start; here 0."""
        return np.zeros((*np.shape(times), 3))


@dataclass(frozen=True, slots=True, eq=False)
class Drive(Motion):
    """A sinusoidal shake of the grip: amplitude * sin(2 pi frequency t) along a direction.

    Attributes:
        node: the grip node.
        direction: (3,) any length > 0; only its direction counts.
        amplitude: [m].
        frequency: [Hz].
        ramp: time [s] over which the amplitude grows smoothly from 0; 0 starts at once.
        also: further nodes between the pads, which move alike. One node alone may turn in the grip; with a neighbour
            the stem's direction is held too.
    """

    node: int
    direction: Array
    amplitude: float
    frequency: float
    ramp: float = 0.0
    also: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "direction", unit_direction(self.direction))
        check_range("shake amplitude", self.amplitude, 0, 10, "m")
        check_range("shake frequency", self.frequency, 0, 1e5, "Hz")
        check_range("shake ramp", self.ramp, 0, 1e4, "s")

    def displacement(self, times: ArrayLike) -> Array:
        """Return (T, 3) displacements [m] at (T,) times [s]."""
        t = np.asarray(times, dtype=np.float64)
        rise = smooth_rise(t, self.ramp)
        return (rise * self.amplitude * np.sin(2 * np.pi * self.frequency * t))[..., None] * self.direction


@dataclass(frozen=True, slots=True, eq=False)
class SampledDrive(Motion):
    """Any motion of the grip, given by samples and interpolated linearly, for instance a recorded one.

    Attributes:
        node: the grip node.
        times: (S,) increasing [s]; outside, the first or last sample holds.
        displacements: (S, 3) from the start position [m].
        also: further nodes between the pads, which move with the first as one body.
        rotations: (S, 3) rotation vectors [rad] about the grip node, from the start orientation; None means none.
    """

    node: int
    times: Array
    displacements: Array
    also: tuple[int, ...] = ()
    rotations: Array | None = None

    def __post_init__(self) -> None:
        times = check_array("drive times", self.times, (None,))
        if len(times) < 2 or np.any(np.diff(times) <= 0):
            raise bad_input("drive times", given=f"{len(times)} times", allowed=">= 2, increasing", do="Sort them.")
        object.__setattr__(self, "times", times)
        moves = check_array("drive displacements", self.displacements, (len(times), 3))
        object.__setattr__(self, "displacements", moves)
        turns = np.zeros_like(moves) if self.rotations is None else self.rotations
        object.__setattr__(self, "rotations", check_array("drive rotations", turns, (len(times), 3)))

    def displacement(self, times: ArrayLike) -> Array:
        """Return (T, 3) displacements [m] at (T,) times [s]."""
        return interpolate(times, self.times, self.displacements)

    def rotation(self, times: ArrayLike) -> Array:
        """Return (T, 3) rotation vectors [rad] at (T,) times [s]."""
        assert self.rotations is not None
        return interpolate(times, self.times, self.rotations)


@dataclass(frozen=True, slots=True, eq=False)
class FunctionDrive(Motion):
    """Any motion, given as a function of the time.

    Attributes:
        node: the grip node, or of a base a clamped one, see `simulate`.
        move: from (T,) times [s] to (T, 3) displacements [m] from the start; 0 at time 0.
        turn: from (T,) times [s] to (T, 3) rotation vectors [rad] about the node, from the start; None means none.
        also: further nodes between the pads, which move with the first as one body.
    """

    node: int
    move: Callable[[Array], Array]
    turn: Callable[[Array], Array] | None = None
    also: tuple[int, ...] = ()

    def displacement(self, times: ArrayLike) -> Array:
        """Return (T, 3) displacements [m] at (T,) times [s]."""
        t = np.asarray(times, dtype=np.float64)
        return check_array("drive move", self.move(t), (*t.shape, 3)).copy()

    def rotation(self, times: ArrayLike) -> Array:
        """Return (T, 3) rotation vectors [rad] at (T,) times [s]."""
        t = np.asarray(times, dtype=np.float64)
        turns = np.zeros((*t.shape, 3)) if self.turn is None else self.turn(t)
        return check_array("drive turn", turns, (*t.shape, 3)).copy()


def smooth_rise(times: Array, ramp: float) -> Array:
    """Return (T,) a share that grows from 0 to 1 over `ramp` [s] as a half cosine; 1 throughout if ramp is 0."""
    if ramp == 0:
        return np.ones_like(times)
    return 0.5 - 0.5 * np.cos(np.pi * np.clip(times / ramp, 0, 1))


def gripped_edges(parent: NDArray[Any], nodes: Sequence[int]) -> NDArray[Any]:
    """Return the edges that have both ends among the nodes, in the order of the nodes."""
    return np.array([n for n in nodes if n > 0 and parent[n] in nodes], dtype=np.int64)


def unit_direction(direction: ArrayLike) -> Array:
    """Return a (3,) direction scaled to length 1.

    Raises:
        InputError: not three finite numbers, or of length 0.
    """
    vector = check_array("direction", direction, (3,))
    length = float(np.linalg.norm(vector))
    if length < 1e-12:
        raise bad_input("direction", given=f"{vector}", allowed="a vector longer than 0", do="Give an axis.")
    return check_array("direction", vector / length, (3,))


def check_node(name: str, node: int, count: int) -> None:
    """Refuse a node number outside 0 .. count - 1."""
    if not 0 <= node < count:
        raise bad_input(name, given=node, allowed=f"0 <= {name} <= {count - 1}", do="Check the node number.")


@dataclass(frozen=True, slots=True, eq=False)
class Chirp(Motion):
    """A sweep: amplitude * sin of a phase whose frequency rises or falls linearly, then rest.

    Attributes:
        node: the grip node.
        direction: (3,) any length > 0; only its direction counts.
        amplitude: [m].
        start_frequency, end_frequency: [Hz].
        sweep_time: [s].
        ramp: time [s] over which the amplitude grows at the start and shrinks at the end, smoothly.
        also: further nodes between the pads, which move alike.
    """

    node: int
    direction: Array
    amplitude: float
    start_frequency: float
    end_frequency: float
    sweep_time: float
    ramp: float = 0.0
    also: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "direction", unit_direction(self.direction))
        check_range("shake amplitude", self.amplitude, 0, 10, "m")
        check_range("start frequency", self.start_frequency, 0, 1e5, "Hz")
        check_range("end frequency", self.end_frequency, 0, 1e5, "Hz")
        check_range("sweep time", self.sweep_time, 1e-6, 1e5, "s")
        check_range("shake ramp", self.ramp, 0, self.sweep_time / 2, "s")

    def displacement(self, times: ArrayLike) -> Array:
        """Return (T, 3) displacements [m] at (T,) times [s]."""
        t = np.clip(np.asarray(times, dtype=np.float64), 0, self.sweep_time)
        rise = (self.end_frequency - self.start_frequency) / self.sweep_time
        wave = np.sin(2 * np.pi * (self.start_frequency + 0.5 * rise * t) * t)
        swell = smooth_rise(np.minimum(t, self.sweep_time - t), self.ramp)
        return (self.amplitude * swell * wave)[..., None] * self.direction


@dataclass(frozen=True, slots=True, eq=False)
class Burst(Motion):
    """Repeated bursts of whole cycles that swell and fade (Hann window), with rests between them.

    Attributes:
        node: the grip node.
        direction: (3,) any length > 0; only its direction counts.
        amplitude: largest displacement of a long burst [m].
        frequency: [Hz].
        cycles: of one burst.
        rest: between bursts [s].
        also: further nodes between the pads, which move alike.
    """

    node: int
    direction: Array
    amplitude: float
    frequency: float
    cycles: int
    rest: float = 0.0
    also: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "direction", unit_direction(self.direction))
        check_range("shake amplitude", self.amplitude, 0, 10, "m")
        check_range("shake frequency", self.frequency, 1e-6, 1e5, "Hz")
        check_range("cycles", self.cycles, 1, 1e9)
        check_range("rest", self.rest, 0, 1e5, "s")

    def displacement(self, times: ArrayLike) -> Array:
        """Return (T, 3) displacements [m] at (T,) times [s]."""
        length = self.cycles / self.frequency
        t = np.minimum(np.mod(np.asarray(times, dtype=np.float64), length + self.rest), length)
        wave = (0.5 - 0.5 * np.cos(2 * np.pi * t / length)) * np.sin(2 * np.pi * self.frequency * t)
        return (self.amplitude * wave)[..., None] * self.direction


@dataclass(frozen=True, slots=True, eq=False)
class Rocking(Motion):
    """Pads that swing and turn at one frequency: x(t) = Im(phasor exp(i w t)) less what it is at the start.

    Attributes:
        node: the grip node, about which the pads turn.
        also: further nodes between the pads.
        displacement_phasor: (3,) of the first node [m].
        rotation_phasor: (3,) [rad]; small, since rotation vectors are added.
        frequency: [Hz].
    """

    node: int
    also: tuple[int, ...]
    displacement_phasor: ComplexArray
    rotation_phasor: ComplexArray
    frequency: float

    def displacement(self, times: ArrayLike) -> Array:
        """Return (T, 3) displacements [m] from the start position at (T,) times [s]."""
        return self._swung(times, self.displacement_phasor)

    def rotation(self, times: ArrayLike) -> Array:
        """Return (T, 3) rotation vectors [rad] about the first node, from the start, at (T,) times [s]."""
        return self._swung(times, self.rotation_phasor)

    def _swung(self, times: ArrayLike, phasor: ComplexArray) -> Array:
        turned = np.exp(2j * np.pi * self.frequency * np.asarray(times, dtype=np.float64)) - 1
        moved: Array = np.imag(turned[..., None] * phasor)
        return moved


@dataclass(frozen=True, slots=True)
class Springs:
    """Between gripper and pads, alike in all directions, about the grip's first node; infinite: nothing gives.

    Attributes:
        translation: [N/m].
        rotation: [N m/rad]; towards 0 the grip becomes a pin.
    """

    translation: float = np.inf
    rotation: float = np.inf

    def __post_init__(self) -> None:
        for name, unit in (("translation", "N/m"), ("rotation", "N m/rad")):
            if getattr(self, name) != np.inf:
                check_range(f"stiffness in {name}", getattr(self, name), 1e-9, 1e15, unit)

    @property
    def compliance(self) -> Array:
        """(6,) displacement per force [m/N], rotation per moment [rad/(N m)]."""
        return np.repeat([1 / self.translation, 1 / self.rotation], 3)


RIGID = Springs()
