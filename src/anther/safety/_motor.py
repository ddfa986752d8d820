"""The guard of a motor in the gripper: every piece of a swing passes here first, and every reading of arm and motor."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from anther.devices import ArmRecord, ArmSample, DeviceError, MoreSwing, Motor, SafetyLimits, Watch
from anther.errors import InputError, StageFailure
from anther.safety._motion import Watchdog, demand
from anther.swing import Swing

STEP = 2.5e-4
"""A piece is checked so often [s]: 80 times a period of 50 Hz."""
TOO_FAR = 1.3
"""The pads may move so much more than they were asked to: what a motor that is 15 % off does, and as much again."""
LEAST = 0.1e-3
"""What a motor at rest may read [m]."""


class GuardedMotor:
    """A motor that refuses what exceeds the limits, and is stopped whatever goes wrong. It is itself a `Motor`.

    Args:
        motor: the machine.
        limits: what no piece and no reading may exceed.
    """

    def __init__(self, motor: Motor, limits: SafetyLimits) -> None:
        self._motor, self._limits = motor, limits

    def swing(self, first: Swing, watch: Watch | None = None, more: MoreSwing | None = None) -> ArmRecord:
        """Swing within the limits; return, at rest, what the arm's joints did meanwhile.

        What was checked is a copy, and the copy is what is commanded.

        Raises:
            StageFailure: limits_exceeded: a piece exceeds a limit, does not join the one before, or nothing follows one
                that does not end at rest; collision: the arm presses on something. The motor was stopped.
            DeviceError: the motor refused or stopped, the pads move further than asked, the arm does not stand still or
                does not tell where it is. The motor was stopped.
        """
        pieces: list[Swing] = []

        def following() -> Swing | None:
            piece = more() if more else None
            if piece is not None:
                pieces.append(check_swing(piece, pieces[-1], self._limits))
            elif not pieces[-1].stops:
                raise StageFailure("limits_exceeded", "the swing would end in motion. End it with amplitudes of 0.")
            return None if piece is None else pieces[-1]

        def within(sample: ArmSample) -> None:
            asked = max(piece.reach for piece in pieces)
            if not (amplitude := self._motor.amplitude()) <= TOO_FAR * asked + LEAST:
                told = f"the motor moves the pads by {1e3 * amplitude:.2g} mm; asked were {1e3 * asked:.2g} mm."
                raise DeviceError(f"{told} Check its sensor.")
            if watch:
                watch(sample)

        still = replace(self._limits, tracking=self._limits.start_tolerance)
        try:
            pieces.append(check_swing(first, None, self._limits))
            record = self._motor.swing(pieces[0], Watchdog(still, within), following)
            if not (left := self._motor.amplitude()) <= LEAST:
                raise DeviceError(f"the motor does not come to rest: it still moves by {1e3 * left:.2g} mm.")
            if not pieces[-1].stops:
                raise DeviceError("the motor ended before the swing did.")
        except BaseException:
            self.stop()
            raise
        return record

    def stop(self) -> None:
        """Stop the motor; what keeps it from stopping is not raised, so that what went wrong before is not hidden."""
        with suppress(Exception):
            self._motor.stop()

    def amplitude(self) -> float:
        """Return what the motor's own sensor reads, see `Motor` [m]."""
        return self._motor.amplitude()


def check_swing(piece: Swing, before: Swing | None, limits: SafetyLimits) -> Swing:
    """Check all that is known of a piece before it begins; return a copy that nobody else can change.

    The place and its differences at every `STEP` against stroke, speed and acceleration; the end of the whole against
    the duration; and that it begins at rest, or as the piece before it ends.

    Args:
        piece: about to be commanded.
        before: the piece that it follows; None: it is the first.
        limits: what is allowed.

    Raises:
        StageFailure: limits_exceeded, with the value, what is allowed and what to do.
    """
    try:
        tones, goal, start = (np.array(x, dtype=float) for x in (piece.frequencies, piece.amplitudes, piece.before))
        piece = Swing(tones, goal, piece.seconds, piece.ramp, start, piece.begin)
    except InputError as error:
        raise StageFailure("limits_exceeded", str(error)) from error
    _check_join(piece, before)
    demand("duration of the swing", piece.begin + piece.seconds, limits.shake_duration, "s", "Swing shorter.")
    place, rate = piece.motion(np.append(np.arange(0, piece.seconds, STEP), piece.seconds))
    demand("swing of the motor", float(np.abs(place).max()), limits.motor_stroke, "m", "Swing less.")
    demand("speed of the motor", float(np.abs(rate).max()), limits.shake_speed, "m/s", "Swing less or slower.")
    acceleration = float(np.abs(np.diff(rate)).max()) / STEP
    demand("acceleration of the motor", acceleration, limits.motor_acceleration, "m/s^2", "Swing less or slower.")
    return piece


def _check_join(piece: Swing, before: Swing | None) -> None:
    if before is None:
        demand("amplitude at the begin of the swing", float(piece.before.sum()), 0.0, "m", "Begin at rest.")
        demand("begin of the swing", piece.begin, 0.0, "s", "Begin at 0.")
        return
    same = piece.frequencies.shape == before.frequencies.shape and bool(np.all(piece.frequencies == before.frequencies))
    joined = same and np.allclose(piece.before, before.amplitudes, rtol=0, atol=1e-9)
    if not joined or abs(piece.begin - before.begin - before.seconds) > 1e-9:
        raise StageFailure("limits_exceeded", "a piece of the swing does not join the one before. Use Swing.then.")
