"""Observed: what one shake did to a plant and to the gripper, as `refine` takes it. F flowers, S points of the stem."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from anther.core.checks import check_array
from anther.core.errors import InputError, bad_input
from anther.core.geometry import Array
from anther.core.oscillation import fit_swing
from anther.pollination.execution import Trial
from anther.pollination.response import Response, StemMotion
from anther.pollination.shake import ShakePlan
from anther.pollination.shake.params import FAST


def _unknown() -> Array:
    return np.array(np.nan)


@dataclass(frozen=True, slots=True)
class Felt:
    """What the arm did and felt in a shake. What was not measured is NaN.

    Attributes:
        moved: amplitude of the gripper along the shake [m]; NaN: as planned.
        began: the gripper moves as sin(2 pi f (t - began)), on the robot's clock [s].
        force: of the grip at the shake's frequency [N]: sqrt |F . F| of its phasor F, without conjugation, which is its
            amplitude where it does not go round. An arm that tells the size of a force alone tells this.
        force_std: its standard deviation [N].
        force_phase: by which the force is ahead of the gripper's motion [rad], up to half a turn: arg(F . F) / 2.
    """

    moved: float = float("nan")
    began: float = float("nan")
    force: float = float("nan")
    force_std: float = float("nan")
    force_phase: float = float("nan")


NOTHING_FELT = Felt()


@dataclass(frozen=True, slots=True, eq=False)
class ObservedShake:
    """What one shake did. What was not measured is NaN, and so is what is not given.

    Attributes:
        shake: what was done.
        amplitude: (F,) of the flowers [m].
        uncertainty: (F,) standard errors [m]; read only where `amplitude` is finite.
        at_most: (F,) bounds of flowers that moved too little to be measured [m].
        phase: (F,) by which a flower's motion along `axis` is ahead of the grip's along the shake [rad].
        phase_std: (F,) its standard deviation [rad].
        axis: (F, 3) unit vectors, world.
        felt: what the arm did and felt.
        beside: what the stem did beside the pads; its phasors are relative to the gripper's sine.
    """

    shake: ShakePlan
    amplitude: Array
    uncertainty: Array
    at_most: Array = field(default_factory=_unknown)
    phase: Array = field(default_factory=_unknown)
    phase_std: Array = field(default_factory=_unknown)
    axis: Array = field(default_factory=_unknown)
    felt: Felt = NOTHING_FELT
    beside: StemMotion = field(default_factory=lambda: StemMotion.of([]))

    def __post_init__(self) -> None:
        count = np.size(self.amplitude)
        for name in ("amplitude", "uncertainty", "at_most", "phase", "phase_std", "axis"):
            shape = (count, 3) if name == "axis" else (count,)
            given = getattr(self, name)
            values = np.broadcast_to(given, shape) if np.ndim(given) == 0 else given
            values = check_array(name, values, shape, finite=False)
            object.__setattr__(self, name, values)
        seen, faint = self.seen, self.faint
        wrong = np.any(~(self.uncertainty[seen] > 0)) or np.any(self.amplitude[seen] < 0)
        if wrong or np.any(~(self.at_most[faint] > 0)):
            given = "a negative amplitude, or an uncertainty or bound <= 0"
            raise bad_input("response", given=given, allowed="> 0 m", do="Check.")

    @classmethod
    def of(cls, shake: ShakePlan, response: Response, felt: Felt = NOTHING_FELT) -> ObservedShake:
        """Return what camera and arm measured of a shake.

        Args:
            shake: what was done.
            response: what was seen.
            felt: what the arm did and felt. Where it is not known when the motion began, phases and the stem beside the
                pads are left out.
        """
        measured = response.amplitude, response.amplitude_std, response.at_most
        if not np.isfinite(felt.began):
            return cls(shake, *measured, felt=felt)
        ahead = response.phase + 2 * np.pi * shake.frequency * felt.began
        turned, stem = np.exp(2j * np.pi * shake.frequency * felt.began), response.stem
        beside = replace(stem, motion=stem.motion * turned)
        return cls(shake, *measured, ahead, response.phase_std, response.direction, felt, beside)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(F,) bool: the amplitude was measured."""
        return np.isfinite(self.amplitude)

    @property
    def faint(self) -> NDArray[np.bool_]:
        """(F,) bool: the flower was followed, and moved too little to be measured."""
        return np.isfinite(self.at_most) & ~self.seen

    @property
    def useless(self) -> str:
        """Why it teaches nothing; empty when it does."""
        if not np.any(self.seen | self.faint) and not np.isfinite(self.felt.force) and not len(self.beside.points):
            return "no flower's motion was measurable"
        return ""


STEADY = (0.3, 0.9)
"""Share of a shake between which it is steady: it has begun and its free vibrations have faded, and it goes on."""

LEAST = 16
"""Readings without which nothing is said."""

SIGNIFICANCE = 3.0
"""A force below so many standard deviations is not told."""


def feel(trial: Trial, shake: ShakePlan, forward: Callable[[Array], Array]) -> Felt:
    """Return what the arm did and felt; nothing above `FAST`, where its links do not go as its motors, which it reads
    (`escalation._knowledge.ARM_ERROR`), and where a motor in the gripper shakes.

    The gripper's motion follows from the measured joints. Of the force an arm tells the size alone, in which the stem's
    constant pull is mixed. But of its square, |F0 + Im(F exp(i w t))|^2, only the motion's force F has a part at twice
    the frequency, -Re(F . F exp(2 i w t)) / 2: from it F . F follows, whatever F0.

    Args:
        trial: that has shaken.
        shake: what it was to do.
        forward: joints (T, J) [rad] -> flange poses (T, 4, 4) in the world.
    """
    moving = _steady(trial.shake_times, trial)
    times, joints = trial.shake_times[moving], trial.measured[moving]
    if len(times) < LEAST or shake.frequency > FAST:
        return NOTHING_FELT
    try:
        swing = fit_swing(times, shake.grasp.carried(forward)(joints), shake.frequency)
    except InputError:
        return NOTHING_FELT
    omega = 2 * np.pi * shake.frequency
    cosine, sine = swing.coefficients[:2] @ shake.direction
    motion = (sine + 1j * cosine) * np.exp(-1j * omega * swing.span[0])
    moved, began = float(abs(motion)), float(-np.angle(motion) / omega)
    return Felt(moved, began, *_force(trial, omega, began))


def _steady(times: Array, trial: Trial) -> slice:
    begin, end = trial.steady
    shares = (0.0, 1.0) if trial.steps else STEADY
    return slice(*np.searchsorted(times, [begin + share * (end - begin) for share in shares]))


def _force(trial: Trial, omega: float, began: float) -> tuple[float, float, float]:
    """Return the force at the shake's frequency [N], its standard deviation, and by what it is ahead [rad]."""
    nothing = float("nan"), float("nan"), float("nan")
    rows = trial.felt[_steady(trial.felt[:, 0], trial)]
    if len(rows) < LEAST or not np.isfinite(rows).all():
        return nothing
    times, square = rows[:, 0] - began, rows[:, 1] ** 2
    angle, drift = omega * times, (times - times.mean()) / np.ptp(times)
    basis = np.column_stack([np.ones_like(times), drift, *(f(k * angle) for k in (1, 2) for f in (np.cos, np.sin))])
    gram = basis.T @ basis
    if np.linalg.cond(gram) > 1e4:  # a reading so often a period that its harmonics look alike
        return nothing
    parts = np.linalg.solve(gram, basis.T @ square)
    noise = np.sqrt(np.sum((square - basis @ parts) ** 2) / (len(times) - len(parts)) * np.linalg.inv(gram)[4, 4])
    twice = complex(-2 * parts[4], 2 * parts[5])  # F . F
    if abs(twice) <= SIGNIFICANCE * 2 * noise:
        return nothing
    size = float(np.sqrt(abs(twice)))
    return size, float(noise / size), float(np.angle(twice) / 2)
