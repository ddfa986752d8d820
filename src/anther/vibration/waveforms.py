"""Shapes of a shake in time: sine, sweep and burst; one definition for the planner and for the arm. T samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from anther.checks import check_range
from anther.errors import bad_input
from anther.geometry import Array

RAMP_PERIODS = 3
"""A sine or sweep rises and falls smoothly within this many periods of its slowest part; our choice."""

LEVELS = 5
"""Steps in which the linear search sees the swell of a burst."""


@dataclass(frozen=True, slots=True)
class Waveform:
    """The shape of a shake, apart from its amplitude, frequency and duration.

    Attributes:
        kind: "sine"; "sweep": the frequency rises linearly over the whole shake, at one amplitude; "burst": groups of
            whole cycles that swell and fade (Hann window), one after another.
        ratio: last over first frequency of a sweep; 1 otherwise.
        cycles: of one burst; 0 otherwise.
    """

    kind: Literal["sine", "sweep", "burst"] = "sine"
    ratio: float = 1.0
    cycles: int = 0

    def __post_init__(self) -> None:
        if self.kind not in ("sine", "sweep", "burst"):
            raise bad_input("waveform", given=f"'{self.kind}'", allowed="sine, sweep or burst", do="Choose one.")
        sweeps, bursts = self.kind == "sweep", self.kind == "burst"
        check_range("ratio of a sweep", self.ratio, 1.01 if sweeps else 1, 10 if sweeps else 1)
        check_range("cycles of a burst", self.cycles, 2 if bursts else 0, 1000 if bursts else 0)

    def __str__(self) -> str:
        """Name it in words."""
        return {
            "sine": "sine",
            "sweep": f"sweep to {self.ratio:g} times the frequency",
            "burst": f"bursts of {self.cycles} cycles",
        }[self.kind]

    def motion(self, times: ArrayLike, amplitude: float, frequency: float, duration: float) -> tuple[Array, Array]:
        """Return displacement (T,) [m] and its rate (T,) [m/s] along the shake; at rest before 0 and after `duration`.

        Args:
            times: (T,) [s].
            amplitude: largest displacement, for a burst that of its middle [m].
            frequency: of a sweep the first [Hz].
            duration: of the whole motion [s]; bursts that would not be over by then are not begun.
        """
        t = np.clip(np.asarray(times, dtype=np.float64), 0, duration)
        rise = frequency * (self.ratio - 1) / duration
        phase, omega = 2 * np.pi * (frequency + 0.5 * rise * t) * t, 2 * np.pi * (frequency + rise * t)
        swell, slope = self._swell(t, frequency, duration)
        sine, cosine = np.sin(phase), np.cos(phase)
        rate = amplitude * (slope * sine + swell * omega * cosine)
        return (amplitude * swell * sine).astype(np.float64), rate.astype(np.float64)

    def _swell(self, t: Array, frequency: float, duration: float) -> tuple[Array, Array]:
        """Return the envelope (T,) [-] and its slope (T,) [1/s]."""
        if self.kind == "burst":
            length = min(self.cycles, int(duration * frequency + 1e-9)) / frequency
            going = t < int(duration / length + 1e-9) * length
            angle = 2 * np.pi * t / length
            return np.where(going, 0.5 - 0.5 * np.cos(angle), 0.0), np.where(going, np.pi / length * np.sin(angle), 0.0)
        ramp = min(RAMP_PERIODS / frequency, duration / 2)
        x = np.clip(np.minimum(t, duration - t) / ramp, 0, 1)
        side = np.where(t < duration / 2, 1, -1) / ramp
        return x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2 * side


SINE = Waveform()


class Mix(NamedTuple):
    """A shake as linear theory sees it: K pieces of time, each a mixture of steady shakes at Q frequencies.

    Attributes:
        weights: (K, Q) share of each frequency in the power of the motion, sum 1.
        levels: (K,) amplitude of the piece over that of the shake [-].
        seconds: (K,) [s].
    """

    weights: Array
    levels: Array
    seconds: Array

    def of(self, values: Array) -> Array:
        """Return (K, ...) the root of the mean square of steady values (Q, ...), times the levels."""
        used = self.weights.any(axis=0)
        square = np.tensordot(self.weights[:, used], np.square(values[used]), axes=1)
        return np.sqrt(square) * self.levels.reshape(-1, *[1] * (square.ndim - 1))


def mix(waveform: Waveform, frequencies: Array, q: int, duration: float) -> Mix | None:
    """Return the pieces of a shake at frequency number q, or None where it would leave the frequencies known.

    A sine is steady throughout. A sweep spends at each frequency its share of the time and answers there as if it had
    always been there: right while it crosses a resonance, 2 zeta f wide, in more than the 1 / (2 pi zeta f) seconds
    that this needs to build up, i.e. while the frequency rises by less than 4 pi (zeta f)^2 a second. A burst has the
    power spectrum of a Hann window about its frequency, and its response the root mean square of the steady responses
    weighted by it (Parseval: exact for the energy of one burst's response), swelling and fading with the burst.

    Args:
        waveform: its shape.
        frequencies: (Q,) rising, for which steady responses are known [Hz].
        q: of the shake; of a sweep the first.
        duration: [s].
    """
    edges = np.concatenate([frequencies[:1], np.sqrt(frequencies[1:] * frequencies[:-1]), frequencies[-1:]])
    steady, f = np.eye(len(frequencies)), frequencies[q]
    match waveform.kind:
        case "sine":
            return Mix(steady[[q]], np.ones(1), np.array([duration]))
        case "sweep":
            last = waveform.ratio * f
            if last > frequencies[-1] * (1 + 1e-9):
                return None
            shares = np.diff(np.clip(edges, f, last)) / (last - f)
            passed = np.flatnonzero(shares > 0)
            return Mix(steady[passed], np.ones(len(passed)), duration * shares[passed])
        case _:
            x = waveform.cycles * (frequencies / f - 1)
            if x[0] > -2 or x[-1] < 2:  # the main lobe
                return None
            near = np.where(np.abs(np.abs(x) - 1) < 1e-6, 1 + 1e-6, x)
            power = np.square(np.sinc(near) / (1 - near**2)) * np.diff(edges)
            swell = 0.5 - 0.5 * np.cos(np.pi * (np.arange(LEVELS) + 0.5) / LEVELS)
            return Mix(np.tile(power / power.sum(), (LEVELS, 1)), swell, np.full(LEVELS, duration / LEVELS))
