"""A swing: how the pads are moved to and fro along one line, in pieces that join without a stop. K tones, T samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from anther.core.checks import check_range
from anther.core.errors import bad_input
from anther.core.geometry import Array
from anther.core.records import Range, Record, Shape


@dataclass(frozen=True, slots=True, eq=False)
class Swing(Record):
    """One piece: the displacement is sum_k a_k(t) sin(2 pi f_k t), t from the begin of the whole shake.

    Each a_k goes smoothly from what it was to what it shall be within `ramp` and stays there. Pieces made by `then`
    join with equal place, speed and acceleration.

    Attributes:
        frequencies: (K,) [Hz].
        amplitudes: (K,) in the end [m].
        seconds: how long the piece lasts, its ramp included [s].
        ramp: [s], at most `seconds`.
        before: (K,) amplitudes at its begin [m].
        begin: on the clock of the whole shake [s].
    """

    CALLED = "swing"
    frequencies: Annotated[Array, Shape("K"), Range(unit="Hz")]
    amplitudes: Annotated[Array, Shape("K"), Range(unit="m")]
    seconds: Annotated[float, Range(1e-3, 60, "s")]
    ramp: Annotated[float, Range(1e-4, 60, "s")]
    before: Annotated[Array, Shape("K"), Range(unit="m")]
    begin: Annotated[float, Range(0, 3600, "s")] = 0.0

    def _check(self) -> None:
        some = len(self.frequencies) > 0
        if not some or self.frequencies.min() <= 0 or min(self.amplitudes.min(), self.before.min()) < 0:
            given = f"{self.frequencies} Hz, {self.before} to {self.amplitudes} m"
            raise bad_input("swing", given=given, allowed="frequencies > 0, amplitudes >= 0", do="Check the signs.")
        check_range("ramp of a swing", self.ramp, 1e-4, self.seconds, "s")

    @classmethod
    def first(cls, frequencies: ArrayLike, amplitudes: ArrayLike, seconds: float, ramp: float) -> Swing:
        """Return the piece that begins at rest."""
        tones = np.atleast_1d(np.asarray(frequencies, dtype=np.float64))
        return cls(tones, np.broadcast_to(amplitudes, tones.shape), seconds, ramp, np.zeros(len(tones)))

    def then(self, amplitudes: ArrayLike, seconds: float, ramp: float) -> Swing:
        """Return the piece that follows: the same tones at other amplitudes (K,) [m]."""
        new = np.broadcast_to(np.asarray(amplitudes, dtype=np.float64), self.frequencies.shape)
        return replace(
            self, amplitudes=new, seconds=seconds, ramp=ramp, before=self.amplitudes, begin=self.begin + self.seconds
        )

    def only(self, tones: ArrayLike) -> Swing:
        """Return the part of it that some tones (K,) have, as if the others were silent."""
        amplitudes, before = (np.where(tones, size, 0.0) for size in (self.amplitudes, self.before))
        return replace(self, amplitudes=amplitudes, before=before)

    @property
    def stops(self) -> bool:
        """Whether the pads are at rest in the end."""
        return not self.amplitudes.any()

    @property
    def changes(self) -> bool:
        """Whether it does not simply go on with what was before."""
        return not np.array_equal(self.amplitudes, self.before)

    @property
    def reach(self) -> float:
        """No displacement of the piece is larger [m]."""
        return float(max(self.amplitudes.sum(), self.before.sum()))  # on the ramp all go from one to the other alike

    def motion(self, times: ArrayLike) -> tuple[Array, Array]:
        """Return displacement (T,) [m] and its rate (T,) [m/s] at (T,) times since the piece began [s]."""
        t = np.clip(np.asarray(times, dtype=np.float64), 0, self.seconds)[:, None]
        x = np.clip(t / self.ramp, 0, 1)
        change = self.amplitudes - self.before
        size = self.before + change * x**3 * (10 - 15 * x + 6 * x**2)
        growth = change * 30 * x**2 * (1 - x) ** 2 / self.ramp
        omega = 2 * np.pi * self.frequencies
        phase = omega * (self.begin + t)
        displacement, rate = size * np.sin(phase), growth * np.sin(phase) + size * omega * np.cos(phase)
        return displacement.sum(axis=1), rate.sum(axis=1)


def whole_shake(amplitude: float, frequency: float, duration: float) -> tuple[Swing, Swing]:
    """Return the two pieces of a shake that nobody watches: it rises and is steady, then falls to rest.

    Args:
        amplitude: half of peak to peak [m].
        frequency: [Hz].
        duration: of the whole motion, rise and fall included: two periods or more [s].

    Raises:
        InputError: a number out of range.
    """
    check_range("shake amplitude", amplitude, 1e-6, 0.2, "m")
    check_range("shake frequency", frequency, 0.1, 50, "Hz")
    check_range("shake duration", duration, 2 / frequency, 60, "s")
    periods = 3  # within which a whole shake rises and falls; our choice
    ramp = min(periods / frequency, duration / 2)
    rise = Swing.first(frequency, amplitude, duration - ramp, ramp)
    return rise, rise.then(0.0, ramp, ramp)


def motion(pieces: Sequence[Swing], times: ArrayLike) -> tuple[Array, Array]:
    """Return displacement (T,) [m] and its rate (T,) [m/s] of joined pieces, (T,) times after the first began [s]."""
    t = np.asarray(times, dtype=np.float64)
    begins = np.cumsum([0.0, *(piece.seconds for piece in pieces[:-1])])
    under_way = np.maximum(np.searchsorted(begins, t, side="right") - 1, 0)
    moved = [piece.motion(t - begin) for piece, begin in zip(pieces, begins, strict=True)]
    displacement, rate = np.take_along_axis(np.array(moved), under_way[None, None], axis=0)[0]
    return displacement, rate
