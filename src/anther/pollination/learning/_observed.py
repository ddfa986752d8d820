"""Observed shakes: measured motion of flowers, stem and grip, input of `refine`. F flowers, S points of the stem."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from anther.core.checks import check_array
from anther.core.errors import InputError, bad_input
from anther.core.geometry import Array
from anther.core.oscillation import fit_swing
from anther.pollination.escalation import JointBelief
from anther.pollination.execution import Trial
from anther.pollination.response import Response, StemMotion
from anther.pollination.shake import ShakePlan


def _unknown() -> Array:
    return np.array(np.nan)


@dataclass(frozen=True, slots=True)
class GripMeasurement:
    """Measurement of the grip by the arm during a shake. NaN: not measured.

    Attributes:
        amplitude: of the gripper along the shake [m]; NaN: as planned.
        start: the gripper moves as sin(2 pi f (t - start)), on the robot's clock [s].
        force: of the grip at the shake's frequency [N]: sqrt |F . F| of its phasor F, without conjugation, which is its
            amplitude for a force along one line; the magnitude of a force suffices to measure it.
        force_std: its standard deviation [N].
        force_phase: lead of the force over the gripper's motion [rad], up to half a turn: arg(F . F) / 2.
    """

    amplitude: float = float("nan")
    start: float = float("nan")
    force: float = float("nan")
    force_std: float = float("nan")
    force_phase: float = float("nan")


NOT_MEASURED = GripMeasurement()


@dataclass(frozen=True, slots=True, eq=False)
class ObservedShake:
    """Measured response to one shake. NaN: not measured or not given.

    Attributes:
        shake: as executed.
        amplitude: (F,) of the flowers [m].
        uncertainty: (F,) standard errors [m]; read only where `amplitude` is finite.
        at_most: (F,) upper bounds for flowers below the detection limit [m].
        phase: (F,) lead of a flower's motion along `axis` over the grip's along the shake [rad].
        phase_std: (F,) its standard deviation [rad].
        axis: (F, 3) unit vectors, world.
        grip: measurement by the arm.
        stem: motion of the stem near the grasp; phasors relative to the gripper's sine.
    """

    shake: ShakePlan
    amplitude: Array
    uncertainty: Array
    at_most: Array = field(default_factory=_unknown)
    phase: Array = field(default_factory=_unknown)
    phase_std: Array = field(default_factory=_unknown)
    axis: Array = field(default_factory=_unknown)
    grip: GripMeasurement = NOT_MEASURED
    stem: StemMotion = field(default_factory=lambda: StemMotion.of([]))

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
    def of(cls, shake: ShakePlan, response: Response, grip: GripMeasurement = NOT_MEASURED) -> ObservedShake:
        """Return the measurements of a shake by camera and arm.

        Args:
            shake: as executed.
            response: measured by the camera.
            grip: measured by the arm. Without its `start`, phases and the stem motion are left out.
        """
        measured = response.amplitude, response.amplitude_std, response.at_most
        if not np.isfinite(grip.start):
            return cls(shake, *measured, grip=grip)
        ahead = response.phase + 2 * np.pi * shake.frequency * grip.start
        turned, stem = np.exp(2j * np.pi * shake.frequency * grip.start), response.stem
        stem = replace(stem, motion=stem.motion * turned)
        return cls(shake, *measured, ahead, response.phase_std, response.direction, grip, stem)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(F,) bool: the amplitude was measured."""
        return np.isfinite(self.amplitude)

    @property
    def faint(self) -> NDArray[np.bool_]:
        """(F,) bool: the flower was tracked, and moved less than the detection limit."""
        return np.isfinite(self.at_most) & ~self.seen

    @property
    def useless(self) -> str:
        """Reason why the shake holds no information; empty if it does."""
        if not np.any(self.seen | self.faint) and not np.isfinite(self.grip.force) and not len(self.stem.points):
            return "no flower's motion was measurable"
        return ""


LEAST_READINGS = 16
"""Least number of readings for a fit."""


def measure_grip(trial: Trial, shake: ShakePlan, joints: JointBelief) -> GripMeasurement:
    """Measure the motion and the force of a grip that an arm shakes.

    The gripper's motion follows from what the motors read and from how stiff the joints are believed to be; where that
    leaves the phase open, the amplitude alone is told. The arm reports the magnitude of a force, which contains the
    stem's constant pull F0. In its square, |F0 + Im(F exp(i w t))|^2, only the motion's force F has a component at
    twice the frequency, -Re(F . F exp(2 i w t)) / 2, which gives F . F for any F0.

    Args:
        trial: record of the shake.
        shake: as planned.
        joints: what is believed of the arm's.
    """
    moving = _select_steady(trial.shake_times, trial)
    times, readings = trial.shake_times[moving], trial.measured[moving]
    if len(times) < LEAST_READINGS:
        return NOT_MEASURED
    try:
        swing = fit_swing(times, readings, shake.frequency)
    except InputError:
        return NOT_MEASURED
    omega = 2 * np.pi * shake.frequency
    cosine, sine = swing.coefficients[:2]
    motors = (sine + 1j * cosine) * np.exp(-1j * omega * swing.span[0])
    drawn = 64
    motions = joints.sample(motors[None], np.array([shake.frequency]), drawn)[:, 0] @ shake.direction
    amplitude, ahead = float(np.median(np.abs(motions))), float(np.angle(motions.mean()))
    unsure = 0.3  # rad, of the phase: as much as learning takes a flower's to be off
    if np.std(np.angle(motions * np.exp(-1j * ahead))) > unsure:
        return GripMeasurement(amplitude)
    start = -ahead / omega
    return GripMeasurement(amplitude, start, *_fit_force(trial, omega, start))


def _select_steady(times: Array, trial: Trial) -> slice:
    begin, end = trial.steady
    steady = (0.3, 0.9)  # shares of a shake's length between which free vibrations have decayed
    shares = (0.0, 1.0) if trial.steps else steady
    return slice(*np.searchsorted(times, [begin + share * (end - begin) for share in shares]))


def _fit_force(trial: Trial, omega: float, start: float) -> tuple[float, float, float]:
    """Return the force at the shake's frequency [N], its standard deviation [N], and its phase lead [rad]."""
    nothing = float("nan"), float("nan"), float("nan")
    rows = trial.felt[_select_steady(trial.felt[:, 0], trial)]
    if len(rows) < LEAST_READINGS or not np.isfinite(rows).all():
        return nothing
    times, square = rows[:, 0] - start, rows[:, 1] ** 2
    angle, drift = omega * times, (times - times.mean()) / np.ptp(times)
    basis = np.column_stack([np.ones_like(times), drift, *(f(k * angle) for k in (1, 2) for f in (np.cos, np.sin))])
    gram = basis.T @ basis
    if np.linalg.cond(gram) > 1e4:  # the sampling rate does not separate the harmonics
        return nothing
    parts = np.linalg.solve(gram, basis.T @ square)
    noise = np.sqrt(np.sum((square - basis @ parts) ** 2) / (len(times) - len(parts)) * np.linalg.inv(gram)[4, 4])
    twice = complex(-2 * parts[4], 2 * parts[5])  # F . F
    significance = 3.0  # standard deviations, the detection limit of a force
    if abs(twice) <= significance * 2 * noise:
        return nothing
    size = float(np.sqrt(abs(twice)))
    return size, float(noise / size), float(np.angle(twice) / 2)
