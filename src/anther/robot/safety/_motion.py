"""What a motion of arm or motor may do: all that is known is checked before, and every reading while it lasts."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from anther.core.errors import InputError, StageFailure
from anther.core.geometry import Array
from anther.robot.devices import ArmSample, DeviceError, JointTrajectory, SafetyLimits, Watch
from anther.robot.swing import Swing

AT_REST = 0.05
"""A trajectory begins and ends no faster than this [rad/s]."""
LONGEST = 120.0
"""No trajectory lasts longer [s]."""
SWING_STEP = 2.5e-4
"""A piece is checked so often [s]: 80 times a period of 50 Hz."""
JUMP = 1e-3
"""Motions that follow each other without a stop join to this [rad/s], and [rad] of the joints."""


def check_trajectory(
    trajectory: JointTrajectory,
    present: Array,
    limits: SafetyLimits,
    *,
    joined: bool = False,
    goes_on: bool = False,
) -> None:
    """Check all that is known of a motion before it begins.

    What is checked is the curve that the arm follows, cubic between the samples: at every sample and every
    5 ms, 7.5 mm of the flange at its top speed. Start at the present joints, rest at both ends, joint range less the
    margin, joint speed and acceleration; of the flange workspace and speed; of all of arm and tool the keep-out boxes.

    Args:
        trajectory: about to be commanded.
        present: (J,) measured joints [rad].
        limits: what is allowed.
        joined: whether it follows another without a stop; then it need not begin at rest, but where that ends.
        goes_on: whether another may follow; then it need not end at rest.

    Raises:
        StageFailure: limits_exceeded, with the value, what is allowed and what to do.
    """
    joints, arm = trajectory.positions.shape[1], len(limits.joint_lower)
    if joints != arm:
        raise StageFailure(
            "limits_exceeded", f"path: got {joints} joints; allowed: the arm's {arm}. Plan for this arm."
        )
    demand("length of the motion", trajectory.duration, LONGEST, "s", "Plan shorter motions.")
    gap = float(np.abs(trajectory.positions[0] - present).max())
    allowed = JUMP if joined else limits.start_tolerance
    demand("start of the path", gap, allowed, "rad from the present joints", "Plan from there.")
    resting = trajectory.velocities[[end for end, moves in ((0, joined), (-1, goes_on)) if not moves]]
    ends = float(np.abs(resting).max(initial=0.0))
    demand("speed at the ends", ends, AT_REST, "rad/s", "Begin and end at rest.")
    times = np.union1d(trajectory.times, np.arange(0, trajectory.duration, 0.005))
    q, rates = _check_joints(trajectory, times, limits)
    position = limits.forward(q)[:, :3, 3]
    outside = float(np.maximum(limits.workspace.lower - position, position - limits.workspace.upper).max())
    demand("flange", outside, 0.0, "m outside the workspace box", "Stay inside, or set the box larger.")
    instant = 1e-4  # the flange's speed is the way it goes in this time [s]
    soon = limits.forward(q + instant * rates)[:, :3, 3]
    speed = float(np.linalg.norm(soon - position, axis=1).max()) / instant
    demand("flange speed", speed, limits.flange_speed, "m/s", "Slow the path down.")
    _check_keep_out(q, limits)


def _check_joints(trajectory: JointTrajectory, times: Array, limits: SafetyLimits) -> tuple[Array, Array]:
    """Check range, speed and acceleration; return joints and rates, both (T, J), at (T,) times."""
    curve = CubicHermiteSpline(trajectory.times, trajectory.positions, trajectory.velocities)
    q, rates, m = curve(times), curve(times, 1), limits.joint_margin
    beyond = np.maximum(limits.joint_lower + m - q, q - (limits.joint_upper - m)).max(axis=0)
    worst = int(np.argmax(beyond))
    demand(f"joint {worst}", float(beyond[worst]), 0.0, "rad beyond its range less the margin", "Plan another branch.")
    # between two samples the acceleration of a cubic is linear: its extremes are at the ends, seen from inside
    ends = np.concatenate([curve(trajectory.times[:-1], 2), curve(np.nextafter(trajectory.times[1:], 0), 2)])
    shares = {"speed": np.abs(rates) / limits.joint_speed, "acceleration": np.abs(ends) / limits.joint_acceleration}
    for name, share in shares.items():
        worst = int(np.argmax(share.max(axis=0)))
        demand(f"{name} of joint {worst}", float(share[:, worst].max()), 1.0, "of its limit", "Slow the path down.")
    return q, rates


def _check_keep_out(q: Array, limits: SafetyLimits) -> None:
    if not limits.keep_out:
        return
    # to 1 mrad, 1.3 mm of an arm stretched out: few of a shake, whose next piece waits
    distinct = q[np.unique(np.round(q / 1e-3), axis=0, return_index=True)[1]]
    for some in np.array_split(distinct, len(distinct) // 1000 + 1):
        balls = limits.outline(some)
        least, most = ((balls[..., :3] + sign * balls[..., 3:]) for sign in (-1, 1))
        least, most = least.min(axis=0), most.max(axis=0)
        for box in limits.keep_out:
            near = balls[:, np.all((least <= box.upper) & (most >= box.lower), axis=1)]  # else never in reach of it
            gap = np.maximum(np.maximum(box.lower - near[..., :3], near[..., :3] - box.upper), 0)
            if np.any(np.linalg.norm(gap, axis=-1) <= near[..., 3]):
                where = f"{box.lower} .. {box.upper} m"
                raise StageFailure(
                    "limits_exceeded", f"arm or tool would enter the keep-out box {where}. Plan around it."
                )


def check_shake(amplitude: float, frequency: float, duration: float, limits: SafetyLimits) -> None:
    """Check a steady shake's amplitude [m], frequency [Hz] and duration [s]. Of several tones: `check_pieces`.

    Raises:
        StageFailure: limits_exceeded.
    """
    numbers = {"amplitude": amplitude, "frequency": frequency, "duration": duration}
    for name, value in numbers.items():
        if not (np.isfinite(value) and value > 0):
            raise StageFailure("limits_exceeded", f"shake {name}: got {value}; allowed: a number > 0. Plan again.")
    omega = 2 * np.pi * frequency
    demand("shake amplitude x 2 pi frequency", amplitude * omega, limits.shake_speed, "m/s", "Shake less or slower.")
    acceleration = amplitude * omega**2
    limit = limits.shake_acceleration
    demand("shake amplitude x (2 pi frequency)^2", acceleration, limit, "m/s^2", "Shake less or slower.")
    demand("shake duration", duration, limits.shake_duration, "s", "Shake shorter.")


def shake_amplitude(frequencies: Array, limits: SafetyLimits) -> Array:
    """Return the largest amplitudes (Q,) [m] of shakes of one tone each (Q,) [Hz] that pass, with their ramps.

    A mixture passes if its shares of these amount to no more than 1. A steady shake may have 92 % of the acceleration:
    to rise and fall takes up to 1.1 % more, to turn from one mixture to another within half a second up to 8.7 % (1 to
    40 Hz, up to 20 mm).
    """
    omega = 2 * np.pi * np.asarray(frequencies, dtype=np.float64)
    return np.minimum(limits.shake_speed / omega, 0.92 * limits.shake_acceleration / omega**2)


def check_pieces(parts: Sequence[tuple[Array, Swing]], limits: SafetyLimits) -> None:
    """Check what moves the pads at one time, each part a unit direction (3,) and its piece: the path is their sum.

    Raises:
        StageFailure: limits_exceeded.
    """
    begin, seconds = parts[0][1].begin, parts[0][1].seconds
    demand("shake duration", begin + seconds, limits.shake_duration, "s", "Shake shorter.")
    rates = sum(piece.motion(_moments(seconds))[1][:, None] * direction for direction, piece in parts)
    _check_rates("shake", np.asarray(rates), limits.shake_speed, limits.shake_acceleration)


def _moments(seconds: float) -> Array:
    return np.append(np.arange(0, seconds, SWING_STEP), seconds)


def _check_rates(what: str, rates: Array, speed: float, acceleration: float) -> None:
    """Check velocities (T, D) [m/s] at `_moments` and their differences against limits [m/s], [m/s^2]."""
    fastest = float(np.linalg.norm(rates, axis=1).max())
    demand(f"speed of the {what}", fastest, speed, "m/s", "Shake less or slower.")
    hardest = float(np.linalg.norm(np.diff(rates, axis=0), axis=1).max()) / SWING_STEP
    demand(f"acceleration of the {what}", hardest, acceleration, "m/s^2", "Shake less or slower.")


def demand(what: str, value: float, limit: float, unit: str, do: str) -> None:
    """Raise a StageFailure, limits_exceeded, unless value <= limit."""
    if not value <= limit + 1e-9:
        raise StageFailure("limits_exceeded", f"{what}: got {value:.4g} {unit}; allowed: <= {limit:.4g}. {do}")


STILL = 2e-3
"""A command that travels further than this [rad] must show in the readings: more than noise and friction hide."""
SHOWS = 0.1
"""Share of the commanded travel that healthy readings show at least, however softly the arm follows; a guess."""


class ForceCheck:
    """Whether the force that an arm tells can be a measured one; it remembers all motions of the arm.

    An arm whose readings never had a force cannot tell it. One that told it once must go on, else its sensor is lost.
    """

    def __init__(self) -> None:
        self._had_force = False
        self._last: ArmSample | None = None
        self._same = 0.0

    def __call__(self, sample: ArmSample) -> None:
        """Raise a DeviceError where the force is lost, negative, or stuck."""
        last, self._last = self._last, sample
        if np.isnan(sample.force):
            if self._had_force:
                raise DeviceError("arm force: got none after it was told before. Check the sensor, then start anew.")
            return
        self._had_force = True
        if sample.force < 0:
            raise DeviceError(f"arm force: got {sample.force:.3g} N; allowed: >= 0, a size. Check the sensor.")
        if last is None or sample.force != last.force:
            self._same = 0.0
        elif not np.array_equal(sample.commanded, last.commanded):
            self._same += min(sample.time - last.time, 0.1)  # longer between two motions
        if self._same > 1:  # [s]: a measured force has noise
            given = f"arm force: got {sample.force:.3g} N, the same to the last bit for {self._same:.1f} s of motion"
            raise DeviceError(f"{given}; allowed: 1 s. The sensor is stuck: check it, then start anew.")


def _is_fast(swing: Array) -> NDArray[np.bool_]:
    """Return (J,) which joints cross zero four times or more, by their path (T, J) without its line [rad]."""
    return np.asarray(np.count_nonzero(np.diff(np.sign(swing), axis=0), axis=0) >= 4)


def find_hidden_swings(
    times: Array, commanded: Array, measured: Array, travel: Array, fast: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return (J,) which joints show nothing of a fast swing that is commanded.

    The measured joints are fitted by the command and its rate, each also growing with time, so that size and phase are
    free and may change: a soft arm is late and swings less, and settles after a change. A joint shows nothing where the
    fitted swing is no more than three standard errors, as of a reading that stands, and with three more still below
    `SHOWS` of the command; all without the straight line that fits the motion best. One joint alone may be stilled by
    the others, at its antiresonance: a swing within `STILL` is hidden only where its reading stands to the bit, or
    where no joint that swings shows anything.

    Args:
        times: (T,) of the last readings [s].
        commanded, measured: (T, J) joints then [rad].
        travel: (J,) of the command, the least within the lag that is healthy [rad].
        fast: (J,) which of them swing fast.
    """
    swing, rate, found = (_detrend(times, x) for x in (commanded, np.gradient(commanded, times, axis=0), measured))
    size = np.minimum(np.ptp(swing, axis=0), travel)
    # From 1e-4 rad on, which 16 bits show, and of joints that travel half as far as the furthest or more than `STILL`.
    swings = fast & (size >= max(1e-4, min(STILL, 0.5 * float(size.max()))))
    hidden = swings.copy()
    growing = (times - times.mean())[:, None]
    for j in np.flatnonzero(swings):
        both = np.stack([swing[:, j], rate[:, j]], axis=1)
        basis = np.linalg.qr(_detrend(times, np.concatenate([both, growing * both], axis=1)))[0]
        part, count = basis.T @ found[:, j], basis.shape[1]
        rest = np.linalg.norm(found[:, j] - basis @ part) / np.sqrt(max(len(times) - count - 2, 1))
        shown, noise = np.linalg.norm(part), 3 * np.sqrt(count) * rest + 1e-9  # [rad]: rounding
        hidden[j] = shown <= noise and 2 * np.sqrt(2 / len(times)) * (shown + noise) < SHOWS * size[j]
    all_hidden = np.array_equal(hidden, swings)
    return hidden if all_hidden else hidden & ((size > STILL) | (np.ptp(measured, axis=0) == 0))


def _detrend(times: Array, path: Array) -> Array:
    """Return (T, J) less the straight line over times (T,) that fits it best."""
    line = np.linalg.qr(np.stack([np.ones(len(times)), times - times[0]], axis=1))[0]
    return np.asarray(path - line @ (line.T @ path))


class Watchdog:
    """Holds every reading of a moving arm against the limits, then shows it to whoever else watches.

    Attributes:
        lost: why the arm's readings are not to be believed; empty while they are.
    """

    def __init__(self, limits: SafetyLimits, watch: Watch | None, force: ForceCheck) -> None:
        self.lost = ""
        self._limits, self._watch, self._force = limits, watch, force
        self._past = deque[ArmSample]()
        self._next = -np.inf  # time of the reading at which swings are looked at again

    def __call__(self, sample: ArmSample) -> None:
        self._check_fresh(sample)
        limits = self._limits
        gap = float(np.abs(sample.measured - sample.commanded).max())
        if not gap <= limits.tracking:
            raise DeviceError(f"the arm does not follow: {gap:.3g} rad behind; allowed: <= {limits.tracking:g}.")
        self._force(sample)
        if sample.force > limits.contact_force:
            given = f"contact force: got {sample.force:.3g} N; allowed: <= {limits.contact_force:g}"
            raise StageFailure("collision", f"{given}. The arm presses on something: look what it is.")
        if self._watch:
            self._watch(sample)

    def _check_fresh(self, sample: ArmSample) -> None:
        """Raise where the clock stands, or a joint does not travel although its command did, however it lags.

        With `stale_after` = 0.1 s: a joint that freezes, to the bit or with noise below `SHOWS` of its travel, is
        noticed within 0.2 s where its command goes faster than 0.04 rad/s all the while, else within 0.35 s where it
        travels 2 mrad, and 1 % of what the furthest does, in any 0.2 s of them: a swing of 3 mrad at 2 Hz, of 1.3 mrad
        at 4 Hz. From 6 Hz on a swing of 0.1 mrad is enough (`find_hidden_swings`); not where one joint of several
        freezes with noise and swings by less than `STILL`. What lags by up to 0.15 s is not.
        """
        past, after = self._past, self._limits.stale_after
        if past and not sample.time > past[-1].time:
            self._distrust(f"the clock of the readings stands at {sample.time:.3f} s")
        past.append(sample)
        # Travel is compared over so many times `stale_after`: fast motion is judged soon, slow or little motion later
        spans = (0.5, 2.0)
        most_lag = 1.5  # healthy readings are behind the command by up to so many times `stale_after`
        while len(past) > 1 and past[1].time <= sample.time - (most_lag + spans[-1]) * after:
            past.popleft()
        times, commanded, measured = (
            np.array(x) for x in zip(*((p.time, p.commanded, p.measured) for p in past), strict=True)
        )
        for span in (share * after for share in spans):
            begin = int(np.searchsorted(times, sample.time - span, side="right")) - 1
            if begin < 0:
                return
            swings = span == spans[-1] * after and sample.time >= self._next
            shown, doubted = np.ptp(measured[begin:], axis=0), np.ptp(commanded, axis=0)
            for lag in np.linspace(0, most_lag * after, num=7):
                if not (swings or np.any((doubted > STILL) & (shown < SHOWS * doubted))):
                    break
                inside = (times >= sample.time - lag - span) & (times <= sample.time - lag)
                doubted = np.minimum(doubted, np.ptp(commanded[inside], axis=0) if inside.any() else 0.0)
            else:
                turned = 0.01  # of the furthest joint's travel: what its acceleration may turn another by
                hidden = (doubted > STILL + turned * doubted.max()) & (shown < SHOWS * doubted)
                fast = _is_fast(_detrend(times, commanded)) if swings or hidden.any() else hidden
                hidden &= ~fast  # judged by their own rule
                if swings:
                    self._next = sample.time + after / 2  # it takes a quarter of a millisecond
                    hidden |= find_hidden_swings(times[begin:], commanded[begin:], measured[begin:], doubted, fast)
                if hidden.any():
                    self._distrust(f"joint {np.flatnonzero(hidden)[0]} reads the same for {span:.2f} s of motion")

    def _distrust(self, why: str) -> None:
        self.lost = f"joint readings are stale: {why}. The arm holds; check its connection and start anew."
        raise DeviceError(self.lost)


def check_swing(piece: Swing, before: Swing | None, limits: SafetyLimits) -> Swing:
    """Check all that is known of a piece before it begins; return a copy that nobody else can change.

    The place and its differences at every `SWING_STEP` against stroke, speed and acceleration; the end of the whole
    against the duration; and that it begins at rest, or as the piece before it ends.

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
    place, rate = piece.motion(_moments(piece.seconds))
    demand("swing of the motor", float(np.abs(place).max()), limits.motor_stroke, "m", "Swing less.")
    _check_rates("motor", rate[:, None], limits.shake_speed, limits.motor_acceleration)
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
