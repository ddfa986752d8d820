"""Escalation: a shake starts gently and is raised stepwise while the camera measures the plant.

F flowers, P visible plant points, N candidate shakes (one frequency along one direction each).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.core.geometry import Array, ComplexArray, Intrinsics
from anther.pollination.decision import WorthCurve, believed, interval
from anther.pollination.escalation._foresight import Foresight, foresee, watch_points
from anther.pollination.escalation._knowledge import (
    DELAYS,
    STIFFNESS_DEVIATES,
    Answer,
    JointBelief,
    Observation,
    Prediction,
    extrapolate_growth,
    fit_motors,
    log_likelihood,
    predict,
    prior_answer,
    sample_motion,
    shows_plant,
    sum_answers,
    update_answer,
    update_directions,
)
from anther.pollination.escalation._option import SHORTEST, WORDS, Option, Params, limits_of
from anther.pollination.execution import ShakeDirection, Step
from anther.pollination.response.points import likeness, sight, swings
from anther.pollination.response.thresholds import overtones
from anther.pollination.shake import Params as Limits
from anther.pollination.shake import ShakePlan
from anther.robot.cell import GripMotion
from anther.robot.devices import LEAD, ArmSample, DeviceError, Frame, ImuReadings
from anther.robot.imu import measure_motion
from anther.robot.swing import Swing

__all__ = [
    "SHORTEST",
    "WORDS",
    "Escalation",
    "Foresight",
    "JointBelief",
    "Params",
    "foresee",
    "limits_of",
    "watch_points",
]


DEFAULTS = Params()
OUT_OF_SIGHT, NO_TIME = "no flower is in sight", "no time is left"
UNPROVEN = "what was seen does not move as the gripper does"
ENOUGH = "Held long enough."
RAISED, HOLD = 2.0, 1.2
"""Largest ratio of successive step amplitudes; how long the shake is what it was to become at least [s], twice
the time constant of pollen release."""
BETTER = 1.25
"""Least ratio of predicted worths that justifies another shake: a change takes seconds, and the largest of many
predictions is biased upwards."""


class NextPiece(NamedTuple):
    """The next piece of a shake: amplitudes (N,) [m], steady time after the ramp [s], and the reason."""

    amplitudes: Array
    seconds: float
    words: str


class Escalation:
    """One observed shake at the grip of a plan; it satisfies `execution.WatchedShake`.

    Two gentle probes excite all frequencies at once, along the planned direction and across it. The observations
    update the ensemble prediction of every frequency at this grip (`_foresight.update_members`); a shake along another
    direction is the sum of the two. The shake of largest predicted worth is then raised in observed steps until more
    amplitude would cost more than it adds. If the camera sees nothing, the plan is executed unchanged.

    Attributes:
        plan, params: as given.
        steps: executed so far.
        least_ramp: shortest time of an amplitude change [s]; half a period of the slowest frequency if that is longer.
        least_look: least observation of a step [s].

    Args:
        plan: gives the grip, the candidate shakes and their modelled limits.
        foresight: prior responses at the plan's grip and frequencies.
        flowers: (F, 3) at rest, world [m].
        points: (P, 3) other plant points at rest, those of `foresee`, world [m].
        camera: intrinsics and T_world_cam (4, 4) of the side camera.
        grip: what the arm's motors do to the grip; None: a motor moves the pads exactly as commanded.
        T_world_imu: (4, 4) of the hand's inertial sensor at the grasp; None: there is none.
        limits: parameters of the shake plan.
        params: see `Params`.
    """

    least_ramp, least_look = 0.5, 0.6

    def __init__(
        self,
        plan: ShakePlan,
        foresight: Foresight,
        flowers: Array,
        points: Array,
        *,
        camera: tuple[Intrinsics, Array],
        grip: GripMotion | None,
        T_world_imu: Array | None = None,
        limits: Limits,
        params: Params = DEFAULTS,
    ) -> None:
        self.plan, self.params = plan, params
        self.steps: tuple[Step, ...] = ()
        self._foresight, self._rest_points, self._camera = foresight, (flowers, points), camera
        self._joints, self._T_world_imu = None if grip is None else JointBelief(grip), T_world_imu
        tones = plan.tones
        self._frequency_index, self._direction_index = (part.ravel() for part in np.indices(tones.reach.shape))
        self._frequencies = tones.frequencies[self._frequency_index]
        self._limits = [limits_of(limits, plan.press, hertz) for hertz in self._frequencies.tolist()]
        self._friction_limit, self._price = limits.held(plan.press), limits.price
        self._probe_answers: list[list[Answer]] = []
        self._options: list[Option] = []
        self._watched: dict[int, tuple[Observation, Prediction] | None] = {}  # see `_update_other_directions`
        self._camera_delay, self._visible_count, self._holding = 0.0, 0, False
        self._same_since = 0.0  # of the present amplitudes, on the clock of the shake [s]
        self._proofs: list[bool] = []  # by step, whether the observation can only show the plant
        self._observations: list[Observation] = []  # by step
        self._proven_amplitude = 0.0
        self._repeated = False

    @property
    def directions(self) -> tuple[ShakeDirection, ...]:
        """The directions along which pieces move the pads."""
        tones = self.plan.tones
        return tuple(
            ShakeDirection(direction, self._direction_index == d, float(tones.reach[:, d].max()))
            for d, direction in enumerate(tones.directions)
        )

    @property
    def joints(self) -> JointBelief | None:
        """What was observed of the arm's joints; None if nothing was, and of a motor."""
        told = any(self._proofs) or any(one.measured for one in self._observations)
        return self._joints if told else None

    def frame_rate(self, rates: Sequence[float]) -> float:
        """Return the slowest camera rate [1/s] that separates the frequencies about as well as the fastest one."""
        looks = [
            (self._watch_seconds(n), hertz * np.arange(1, 2 + overtones(hertz)))
            for n, hertz in enumerate(self._frequencies)
        ]
        looks.append((self._probe_seconds, np.unique(self._frequencies)))
        best = [likeness(max(rates), *observation) for observation in looks]
        worse = 1.5  # times the fastest rate's loss of frequency separation, that a slower rate may cost
        return min(r for r in rates if all(likeness(r, *a) <= worse * b for a, b in zip(looks, best, strict=True)))

    def begin(self, frame: Frame) -> Swing:
        """Return the probe along the planned direction: all K frequencies, each at 0.3 / sqrt(K) times its
        modelled amplitude."""
        intrinsics, T_world_cam = self._camera
        self._sight = sight(frame, intrinsics, T_world_cam, *self._rest_points)
        probe = self._probe_along(0)
        ramp = self._ramp_seconds(np.flatnonzero(probe.amplitudes))
        return Swing.first(self._frequencies, probe.amplitudes, ramp + probe.seconds + LEAD, ramp)

    def steady_from(self, piece: Swing) -> float:
        """Return the time from which the current piece is steady [s], from the start of the shake."""
        steady = self._probe_seconds if self._probing else self._watch_seconds(int(piece.amplitudes.argmax()))
        return piece.begin + max(piece.ramp if piece.changes else 0.0, piece.seconds - LEAD - steady)

    def next_piece(
        self,
        piece: Swing,
        frames: Sequence[Frame],
        samples: Sequence[ArmSample],
        readings: ImuReadings | None = None,
    ) -> Swing:
        """Return the next piece, chosen from the observation of the current one; the last piece ends at rest."""
        started, steady = perf_counter(), [s for s in samples if s.time >= samples[0].time + self.steady_from(piece)]
        self._piece = piece
        if piece.changes:
            self._same_since = piece.begin + piece.ramp
        observation = self._observe(frames, steady, samples[0].time, readings)
        fitted, joints = observation, self._joints
        if not self.steps:
            self._visible_count = observation.followed
        if observation.followed and (self._probing or not any(self._proofs)):
            fitted, joints = self._fit_clock_and_joints(observation)
        self._proofs.append(self._shows_plant(fitted))
        if self._proofs[-1]:  # what proves nothing teaches nothing of the joints either
            observation, self._joints = fitted, joints
        self._observations.append(observation)
        active = np.flatnonzero(piece.amplitudes).tolist()
        answers = self._answers(observation, active)
        predictions = [self._predict(n, one) for n, one in zip(active, answers, strict=True)]
        shaken = list(zip(piece.amplitudes[active].tolist(), active, predictions, strict=True))
        shares = {k: sum(a * one.loads[k] / self._limits[n][k] for a, n, one in shaken) for k in WORDS}
        lost = 0.5  # the shake ends when a smaller share of the points tracked in the probe is still tracked
        if self._holding:
            follows = self._end(ENOUGH)
        elif observation.followed < lost * self._visible_count:
            follows = self._end(
                f"Only {observation.followed} of {self._visible_count} points are still followed: ended."
            )
        elif self._probing:
            self._probe_answers.append(answers)
            follows = self._after_probe(max(shares.values()))
        else:
            self._learn(active[0], observation, predictions[0])
            follows = self._decide(active[0])
        measured = [a * one.answer.flowers[0] for a, _, one in shaken]  # all members agree on a measured flower
        acceleration = np.sqrt(np.sum(np.square(measured), axis=0))
        step = Step(
            steady[0].time,
            steady[-1].time,
            tuple(self._frequencies[active].tolist()),
            tuple(piece.amplitudes[active].tolist()),
            tuple(observation.direction.tolist()),
            tuple(np.where(predictions[0].seen, acceleration, np.nan).tolist()),
            {WORDS[kind]: share for kind, share in shares.items()},
            f"{follows.words}{self._remark()}",
            perf_counter() - started,
        )
        self.steps = (*self.steps, step)
        ramp = self._ramp_seconds(np.flatnonzero(piece.amplitudes + follows.amplitudes))
        moving = follows.seconds + LEAD if follows.amplitudes.any() else 0.0
        return piece.then(follows.amplitudes, ramp + moving, ramp)

    def _answers(self, observation: Observation, active: Sequence[int]) -> list[Answer]:
        """Return the plant's responses at the frequencies of an observation, of which a probe that proves nothing tells
        the gripper's motion alone.

        `active`: numbers of the shakes.
        """
        if self._probing and not self._proofs[-1]:
            return [prior_answer(self._foresight, observation, i) for i in range(len(active))]
        before = [self._options[n].prediction for n in active] if self._options else [None] * len(active)
        return [
            update_answer(self._foresight, observation, i, self._camera_delay, last) for i, last in enumerate(before)
        ]

    def executed_plan(self, steps: Sequence[Step]) -> ShakePlan:
        """Return the plan as executed: its last step, with the prior prediction for how the grip moved in it."""
        if not steps:
            return self.plan
        last, observation = steps[-1], self._observations[len(steps) - 1]
        tone, amplitude = int(observation.frequency_indices[0]), last.amplitudes[0]
        direction, hertz = observation.direction, float(self._foresight.frequencies[tone])
        prior = prior_answer(self._foresight, observation, 0).members
        logs, doubt = believed("flowers", self._foresight.answer(prior, hertz).flowers, hertz)
        middle = amplitude * np.exp(logs.mean(axis=0))
        wide = middle[:, None] * interval(logs, doubt)
        omega2 = (2 * np.pi * hertz) ** 2
        return replace(
            self.plan,
            direction=direction,
            frequency=hertz,
            amplitude=amplitude,
            duration=last.end - last.begin,
            predicted_amplitude=middle / omega2,
            predicted_amplitude_interval=wide / omega2,
            predicted_acceleration=middle,
            predicted_acceleration_interval=wide,
            weighed=self._worth_curve(tone, direction),
            reason=f"{self.plan.reason} Watched on the way: {' '.join(step.decided for step in steps)}",
        )

    def _worth_curve(self, tone: int, direction: Array) -> WorthCurve | None:
        """Return the worth by amplitude of the final shake; that of the plan if nothing was observed."""
        alignment = np.abs(self.plan.tones.directions @ direction)
        number = np.flatnonzero((self._frequency_index == tone) & (self._direction_index == int(alignment.argmax())))
        return self._options[int(number[0])].weighed if self._options else self.plan.weighed

    @property
    def _probe_seconds(self) -> float:
        periods, shortest, longest = 8.0, 0.5, 1.4  # of its slowest frequency, and s
        return min(longest, max(periods / float(self._frequencies.min()), shortest))

    @property
    def _probing(self) -> bool:
        """Whether the current piece is a probe."""
        return not self._holding and len(self.steps) < len(self.plan.tones.probed)

    def _probe_along(self, line: int, gentler: float = 1.0) -> NextPiece:
        tones = self.plan.tones
        alone = np.minimum(tones.amplitudes[:, line], tones.reach[:, line])
        share = 0.3  # rms of a probe's loads over those of the planned shake; 0.22 to 0.55 decide the same
        size = share / gentler * alone / np.sqrt(len(alone))
        size /= max(1.0, float(np.sum(size / tones.reach[:, line])))  # peaks add up
        amplitudes = np.where(self._direction_index == line, size[self._frequency_index], 0.0)
        return NextPiece(amplitudes, self._probe_seconds, "Probed across that line as well.")

    def _observe(
        self, frames: Sequence[Frame], steady: Sequence[ArmSample], begin: float, readings: ImuReadings | None
    ) -> Observation:
        piece, active = self._piece, np.flatnonzero(self._piece.amplitudes)
        direction, tones = self.plan.tones.directions[self._direction_index[active[0]]], piece.frequencies[active]
        commanded = np.asarray(piece.amplitudes[active] * np.exp(-2j * np.pi * tones * begin), dtype=np.complex128)
        gripper, motors = np.asarray(commanded[None, :, None] * direction, dtype=np.complex128), None
        measured, fault = False, ""
        if self._joints is not None:
            motors, count = fit_motors(steady, tones), len(self._foresight.vectors)
            gripper = self._joints.sample(motors, tones, count)
            if self._T_world_imu is not None and readings is not None:
                span, point = (steady[0].time, steady[-1].time), self.plan.grasp.point
                try:
                    moved, std = measure_motion(readings, span, self._T_world_imu, point, tones)
                    self._joints = self._joints.update(moved, motors, tones)
                    gripper, measured = sample_motion(moved, std, count), True
                except DeviceError as error:
                    fault = str(error)
        expected = None
        if self._options:
            expected = np.stack([c * self._options[n].prediction.phasors for c, n in zip(commanded, active)], axis=1)  # noqa: B905
        seen = extrapolate_growth(swings(self._sight, frames, tones, expected), float(tones[0]))
        shake = self._frequency_index[active], direction, commanded, gripper, seen
        return Observation(*shake, len(self.steps), motors, measured, fault)

    def _fit_clock_and_joints(self, observation: Observation) -> tuple[Observation, JointBelief | None]:
        """Fit the camera's delay, if nothing has shown the plant yet, and the arm's joints to an observation."""
        delays = np.array([self._camera_delay]) if any(self._proofs) else DELAYS
        grips, motors = self._possible_grips(observation), observation.motors
        found = log_likelihood(self._foresight, observation, grips, delays)
        if self._joints is None or motors is None or observation.measured:
            self._camera_delay = float(delays[found[0].argmax()])
            return observation, self._joints
        found += self._joints.log_posterior[:, None]
        best = int(np.logaddexp.reduce(found, axis=0).argmax())
        self._camera_delay, joints = float(delays[best]), self._joints._replace(log_posterior=found[:, best])
        tones = self._foresight.frequencies[observation.frequency_indices]
        return observation._replace(gripper=joints.sample(motors, tones, len(self._foresight.vectors))), joints

    def _possible_grips(self, observation: Observation) -> ComplexArray:
        """Return (A, K, 3) what the gripper did, for each stiffness that the arm's joints may have [m]."""
        if self._joints is None or observation.motors is None:
            return observation.gripper
        if observation.measured:
            return np.asarray(observation.gripper.mean(axis=0, keepdims=True))
        tones = self._foresight.frequencies[observation.frequency_indices]
        return self._joints.grip(observation.motors, tones, STIFFNESS_DEVIATES)

    def _shows_plant(self, observation: Observation) -> bool:
        """Return whether an observation can only show the plant, by what was believed of the arm's joints before."""
        grips = self._possible_grips(observation)
        log_prior = np.zeros(1) if self._joints is None or len(grips) == 1 else np.log(self._joints.probabilities)
        before = [one for one, proven in zip(self._observations, self._proofs, strict=True) if proven]
        return shows_plant(self._foresight, observation, grips, log_prior, self._camera_delay, before)

    def _remark(self) -> str:
        """Return, the first time, why the gripper's motion is not measured."""
        *before, why = (one.fault for one in self._observations)
        return f" What the gripper does is believed, not measured: {why}" if why and not any(before) else ""

    def _predict(self, shake: int, answer: Answer) -> Prediction:
        return predict(self._foresight, float(self._frequencies[shake]), answer, self._camera_delay)

    def _after_probe(self, largest_load: float) -> NextPiece:
        """Return the piece after a probe: the next probe, or the shake of largest predicted worth. Where no probe can
        only show the plant, that must be `BETTER` than the plan's own.

        `largest_load`: the largest of the probe's loads, over what may be borne. The next probe is as much gentler.
        """
        tones = self.plan.tones
        if not self._visible_count:
            self._holding = True
            words = "Nothing is in sight: the plan alone is carried out."
            return self._excite(0, self.plan.amplitude, self.plan.duration, words)
        if len(self._probe_answers) < len(tones.probed):
            return self._probe_along(tones.probed[len(self._probe_answers)], gentler=max(largest_load, 1.0))
        self._options = [self._make_option(n, self._probed(i)) for n, i in enumerate(self._frequency_index.tolist())]
        if len(self._frequencies) == 1:
            return self._decide(0)
        best = self._best()
        return self._switch_to(best if any(self._proofs) or self._is_better(best, than=0) else 0)

    def _probed(self, tone: int) -> list[Answer]:
        """Return the responses along the probed directions at a frequency index."""
        return [answers[tone] for answers in self._probe_answers]

    def _make_option(self, shake: int, along: Sequence[Answer]) -> Option:
        """Return a shake that was not watched alone: its response is the sum of those `along` the probed directions."""
        tones, at = self.plan.tones, (self._frequency_index[shake], self._direction_index[shake])
        answer = sum_answers(along, tones.parts(int(at[1])))
        planned, reach = float(tones.amplitudes[at]), float(tones.reach[at])
        hertz = float(self._frequencies[shake])
        return Option(hertz, self._friction_limit, self._price, planned, reach, self._predict(shake, answer))

    def _learn(self, now: int, observation: Observation, prediction: Prediction) -> None:
        """Update what is believed of an observed shake, and of others at its frequency: what proves nothing teaches
        nothing, but that more may move than was thought."""
        if self._proofs[-1]:
            self._watched[now] = observation, self._options[now].prediction
            self._options[now].update(prediction)
        else:
            self._watched.setdefault(now, None)
            self._options[now].heed(prediction)
        self._update_other_directions(int(self._frequency_index[now]))

    def _update_other_directions(self, tone: int) -> None:
        """Update what is believed of shakes at a frequency along directions that were not watched alone.

        Of each shake that was, the newest observation that can only show the plant counts, with its prediction before:
        what errs in one errs in the next too, so that all of them would make the members agree too well.
        """
        others = set(np.flatnonzero(self._frequency_index == tone).tolist()) - set(self._watched)
        looks = [(n, look) for n, look in self._watched.items() if look and self._frequency_index[n] == tone]
        if not others or not looks:
            return
        along = self._probed(tone)
        for n, (observation, before) in looks:
            parts = self.plan.tones.parts(int(self._direction_index[n]))
            along = update_directions(self._foresight, observation, self._camera_delay, along, parts, before)
        for n in others:
            self._options[n] = self._make_option(n, along)

    def _best(self) -> int:
        """Return the index of the shake of largest predicted worth."""
        return max(range(len(self._options)), key=lambda n: self._options[n].predicted_worth)

    def _is_better(self, shake: int, than: int) -> bool:
        """Return whether a shake is so much better than another by what is predicted that it justifies a change."""
        return self._options[shake].predicted_worth > BETTER * self._options[than].predicted_worth

    def _decide(self, now: int) -> NextPiece:
        """Return the piece after an observed shake: another shake, or this one at another amplitude."""
        amplitude, option = float(self._piece.amplitudes[now]), self._options[now]
        why = "" if np.isfinite(option.prediction.detectable).any() else OUT_OF_SIGHT
        why = why if self._proofs[-1] else UNPROVEN
        if not why:
            self._proven_amplitude = amplitude
            option.raised_to = max(option.raised_to, amplitude)
            best = self._best()
            if self._is_better(best, than=now) and self._has_time(best):
                return self._switch_to(best)
        return self._raise(now, amplitude, why)

    def _excite(self, shake: int, amplitude: float, seconds: float, words: str) -> NextPiece:
        return NextPiece(amplitude * (np.arange(len(self._frequencies)) == shake), seconds, words)

    def _end(self, words: str) -> NextPiece:
        return NextPiece(np.zeros(len(self._frequencies)), 0.0, words)

    def _repeat(self, shake: int, amplitude: float, why: str) -> NextPiece:
        self._repeated = True
        return self._excite(
            shake, amplitude, self._watch_seconds(shake), f"Watched again at {1e3 * amplitude:.2g} mm: {why}."
        )

    def _switch_to(self, shake: int) -> NextPiece:
        """Return the first piece of another shake."""
        option, directions = self._options[shake], self.plan.tones.directions
        most = option.allowed
        self._proven_amplitude, self._repeated = option.planned, False
        begin = min(most.amplitude, option.planned)
        turned = np.degrees(np.arccos(min(abs(float(directions[self._direction_index[shake]] @ directions[0])), 1.0)))
        words = (
            f"At {self._frequencies[shake]:.3g} Hz, {turned:.0f}° from the plan's line, flowers may reach"
            f" {most.flowers:.3g} m/s² with {1e3 * most.amplitude:.2g} mm, more than otherwise; {most.binds} ends it"
            " there."
        )
        return self._excite(shake, begin, self._watch_seconds(shake), words)

    def _raise(self, shake: int, now: float, doubt: str) -> NextPiece:
        """Return a larger amplitude, or the last piece.

        `doubt`: why the observation proves nothing; the amplitude is then at most the last proven or the planned one.
        """
        option, allowed = self._options[shake], self._options[shake].allowed
        higher, why = min(allowed.amplitude, RAISED * now), allowed.binds
        if doubt:
            higher, why = min(max(self._proven_amplitude, option.planned), higher), doubt
        if not self._has_time(shake):
            higher, why = min(now, higher), NO_TIME
        enough = 1.05  # least ratio of amplitudes or worths that justifies another step
        if higher > enough * now:
            return self._excite(shake, higher, self._watch_seconds(shake), f"Raised to {1e3 * higher:.2g} mm.")
        higher = now if higher > now / enough else higher
        if doubt and not self._repeated and why != NO_TIME:
            return self._repeat(shake, higher, why)
        self._holding = True
        done = [one.worth_at(one.tolerated) for one in self._options]
        best = int(np.argmax(done))
        if best != shake and done[best] > enough * option.worth_at(now):
            why = f"{why}; {self._frequencies[best]:.3g} Hz was worth more"
            return self._hold(best, self._options[best].tolerated, why)
        return self._hold(shake, higher, why, already=higher == now)

    def _hold(self, shake: int, amplitude: float, why: str, already: bool = False) -> NextPiece:
        """Return the last piece, for what is left of `HOLD` where the shake is `already` what it was to become."""
        words, left = f"Held at {1e3 * amplitude:.2g} mm: {why}.", HOLD
        if already:
            left -= self._piece.begin + self._piece.seconds - self._same_since
            if left <= 0:
                return self._end(f"{words} {ENOUGH}")
            left = max(left - self._ramp_seconds([shake]) - LEAD, 0.0)  # nothing changes on that ramp
        return self._excite(shake, amplitude, left, words)

    def _has_time(self, shake: int) -> bool:
        """Return whether there is time for another step, the last one, and the ramp to rest."""
        ends = self._piece.begin + self._piece.seconds
        return (
            ends + 3 * self._ramp_seconds([shake]) + self._watch_seconds(shake) + HOLD + 2 * LEAD
            <= self.params.most_seconds
        )

    def _ramp_seconds(self, shakes: Sequence[int] | NDArray[np.int64]) -> float:
        """Return the time of an amplitude change of some shakes [s]."""
        return float(np.max(0.5 / self._frequencies[shakes], initial=self.least_ramp))

    def _watch_seconds(self, shake: int) -> float:
        periods = 2.0  # of a step that are observed at least
        return max(self.least_look, periods / float(self._frequencies[shake]))
