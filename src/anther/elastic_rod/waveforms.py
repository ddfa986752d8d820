"""Shakes that are no plain sine: a frequency sweep, and bursts. Both satisfy `Motion`, as `Drive` does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from anther.checks import check_range
from anther.elastic_rod.motion import Straight, smooth_rise, unit_direction
from anther.elastic_rod.rods import Array


@dataclass(frozen=True, slots=True, eq=False)
class Chirp(Straight):
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
class Burst(Straight):
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
