"""Escalation: a shake that begins gently and is raised as far as the camera sees that the plant bears it.

F flowers, P points that the camera may see, R readings of the arm, N shakes: a frequency along a line each.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.core.geometry import Array, Intrinsics
from anther.pollination.decision import Weighed, believed, interval
from anther.pollination.escalation._foresight import Foresight, foresee, watch_points
from anther.pollination.escalation._knowledge import (
    Answer,
    Known,
    Look,
    answered,
    gripper_motion,
    known,
    lateness,
    links,
    proven,
    settled,
    summed,
    unproven,
)
from anther.pollination.escalation._option import SHORTEST, WORDS, Option, Params, limits_of
from anther.pollination.execution import Line, Step
from anther.pollination.response.points import likeness, sight, swings
from anther.pollination.response.thresholds import overtones
from anther.pollination.shake import Params as Limits
from anther.pollination.shake import ShakePlan
from anther.robot.devices import LEAD, ArmSample, Frame
from anther.robot.swing import Swing

__all__ = ["SHORTEST", "WORDS", "Escalation", "Foresight", "Params", "foresee", "watch_points"]


DEFAULTS = Params()
RAMP = 0.5
"""In which the amplitude changes [s], or half a period of the slowest tone if that is longer."""
PERIODS, LOOK = 2.0, 0.6
"""A step is watched for so many of its periods, and so long [s], at least."""
PROBE_PERIODS, SHORTEST_PROBE, LONGEST_PROBE = 8.0, 0.5, 1.4
"""All frequencies are watched at once for so many periods of the slowest, along each of two lines; at least and at most
so long [s]."""
WORSE = 1.5
"""A frame rate will do if tones look no more than so many times as much alike as at the fastest."""
PROBED = 0.3
"""Of the probe: the rms of its loads over that of the plan's shake. With 0.55 a probe bent the pedicels of one plant of
24 by 2.3 %. Between 0.22 and 0.55 what 53 plants (MuJoCo's linear equations) feel in the end is the same within 3 %."""
OUT_OF_SIGHT, NO_TIME = "no flower is in sight", "no time is left"
UNPROVEN = "what was seen does not move as the gripper does"
RAISED, HOLD = 2.0, 1.2
"""A step is at most so many times the one before; the last one goes on so long [s]: a flower approaches what it can
free within 0.6 s."""
BETTER = 1.25
"""Another tone or line is turned to when it is worth so many times as much: turning takes seconds, and of many promises
the largest is too large."""
ENOUGH = 1.05
"""A raise by less is not worth its time, nor is going back to what was worth more."""
LOST = 0.5  # a shake is ended when fewer than this share of the points followed in the probe still are


class Next(NamedTuple):
    """What follows: amplitudes (N,) [m], for how long [s] after a ramp, and why."""

    amplitudes: Array
    seconds: float
    words: str


class Escalation:
    """One watched shake at the grip of a plan; it satisfies `execution.Watched`.

    A gentle mixture of tones is watched first, along the plan's line and then across it: what it does to flowers, stem
    and leaves corrects what the model says of each tone at this grip (`_foresight.narrowed`), and along any other line
    the plant does the sum of both. The tone and line are taken with which the flowers can be moved most, and raised in
    steps, each watched, until more would cost more than it adds. Where the camera sees nothing, the plan is
    done as it is.

    Attributes:
        plan, params: as given.
        steps: what was done so far.

    Args:
        plan: where, and by the model how far at most.
        foresight: of the plan's grip and tones.
        flowers: (F, 3) at rest, world [m].
        points: (P, 3) the plant's other points, those of `foresee`.
        camera: intrinsics and T_world_cam (4, 4) of the side camera.
        middle: joints (R, J) -> (R, 3) place of the grip by the arm's own readings, world [m]; None: a motor moves the
            pads, and as it was told.
        limits: of plant and grip.
        params: see `Params`.
    """

    def __init__(
        self,
        plan: ShakePlan,
        foresight: Foresight,
        flowers: Array,
        points: Array,
        *,
        camera: tuple[Intrinsics, Array],
        middle: Callable[[Array], Array] | None,
        limits: Limits,
        params: Params = DEFAULTS,
    ) -> None:
        self.plan, self.params = plan, params
        self.steps: tuple[Step, ...] = ()
        self._foresight, self._places, self._camera, self._middle = foresight, (flowers, points), camera, middle
        tones = plan.tones
        self._tone, self._line = (part.ravel() for part in np.indices(tones.reach.shape))
        self._hertz = tones.frequencies[self._tone]
        self._limits = [limits_of(limits, plan.press, hertz) for hertz in self._hertz.tolist()]
        self._held, self._price = limits.held(plan.press), limits.price
        self._answers: list[list[Answer]] = []
        self._options: list[Option] = []
        self._late, self._in_sight, self._last = 0.0, 0, False
        self._proofs: list[bool] = []  # by step, whether only the plant can have been seen
        self._proven: list[Look] = []  # the looks of those steps
        self._sure = 0.0
        self._doubted = False

    @property
    def lines(self) -> tuple[Line, ...]:
        """The lines along which pieces move the pads."""
        tones = self.plan.tones
        return tuple(
            Line(direction, self._line == d, float(tones.reach[:, d].max()))
            for d, direction in enumerate(tones.directions)
        )

    def frame_rate(self, rates: Sequence[float]) -> float:
        """Return the slowest of a camera's rates [1/s] that tells the tones apart about as well as the fastest does."""
        looks = [(self._watch(n), hertz * np.arange(1, 2 + overtones(hertz))) for n, hertz in enumerate(self._hertz)]
        looks.append((self._probe, np.unique(self._hertz)))
        best = [likeness(max(rates), *look) for look in looks]
        return min(r for r in rates if all(likeness(r, *a) <= WORSE * b for a, b in zip(looks, best, strict=True)))

    def begin(self, frame: Frame) -> Swing:
        """Return the probe along the plan's line: all its tones, each `PROBED` times what the model allows of one over
        the root of their number."""
        intrinsics, T_world_cam = self._camera
        self._sight = sight(frame, intrinsics, T_world_cam, *self._places)
        probe = self._probe_along(0)
        ramp = self._ramp(np.flatnonzero(probe.amplitudes))
        return Swing.first(self._hertz, probe.amplitudes, ramp + probe.seconds + LEAD, ramp)

    def since(self, piece: Swing) -> float:
        """Return from when on the piece under way is steady [s], counted from the shake's begin."""
        steady = self._probe if self._probing else self._watch(int(piece.amplitudes.argmax()))
        return piece.begin + max(piece.ramp, piece.seconds - LEAD - steady)

    def go_on(self, piece: Swing, frames: Sequence[Frame], samples: Sequence[ArmSample]) -> Swing:
        """Return what follows what was seen; the last piece ends at rest."""
        started, steady = perf_counter(), [s for s in samples if s.time >= samples[0].time + self.since(piece)]
        self._piece = piece
        look = self._looked(frames, steady, samples[0].time)
        if not self.steps:
            self._in_sight = look.followed
        if not any(self._proofs) and look.followed:
            self._late = lateness(self._foresight, look)
        self._proofs.append(proven(self._foresight, look, self._late, self._proven))
        if self._proofs[-1]:
            self._proven.append(look)
        active = np.flatnonzero(piece.amplitudes).tolist()
        before = [self._options[n].told for n in active] if self._options else [None] * len(active)
        if self._probing and not self._proofs[-1]:
            answers = [unproven(self._foresight, look, i) for i in range(len(active))]
        else:
            answers = [answered(self._foresight, look, i, self._late, last) for i, last in enumerate(before)]
        told = [self._known(n, one) for n, one in zip(active, answers, strict=True)]
        shaken = list(zip(piece.amplitudes[active].tolist(), active, told, strict=True))
        shares = {k: sum(a * one.loads[k] / self._limits[n][k] for a, n, one in shaken) for k in WORDS}
        if self._last:
            follows = Next(np.zeros(len(self._hertz)), 0.0, "Held long enough.")
        elif look.followed < LOST * self._in_sight:
            words = f"Only {look.followed} of {self._in_sight} points are still followed: ended."
            follows = Next(np.zeros(len(self._hertz)), 0.0, words)
        elif self._probing:
            self._answers.append(answers)
            follows = self._after_probe(max(shares.values()))
        else:
            self._options[active[0]].looked_at(told[0])
            follows = self._decided(active[0])
        measured = [a * one.answer.flowers[0] for a, _, one in shaken]  # of a flower that was, all members say the same
        felt = np.sqrt(np.sum(np.square(measured), axis=0))
        step = Step(
            steady[0].time,
            steady[-1].time,
            tuple(self._hertz[active].tolist()),
            tuple(piece.amplitudes[active].tolist()),
            tuple(look.direction.tolist()),
            tuple(np.where(told[0].seen, felt, np.nan).tolist()),
            {WORDS[kind]: share for kind, share in shares.items()},
            follows.words,
            perf_counter() - started,
        )
        self.steps = (*self.steps, step)
        ramp = self._ramp(np.flatnonzero(piece.amplitudes + follows.amplitudes))
        moving = follows.seconds + LEAD if follows.amplitudes.any() else 0.0
        return piece.then(follows.amplitudes, ramp + moving, ramp)

    def executed(self, steps: Sequence[Step]) -> ShakePlan:
        """Return the plan as it was carried out: the last step, and what the plant as believed would do in it."""
        if not steps:
            return self.plan
        last, tones = steps[-1], self._foresight.tones
        tone, amplitude = int(np.abs(tones - last.frequencies[0]).argmin()), last.amplitudes[0]
        direction = np.array(last.direction)
        hertz = float(tones[tone])
        logs, doubt = believed(
            "flowers", self._foresight.answer(self._foresight.of(tone, direction), hertz).flowers, hertz
        )
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
            weighed=self._weighed(tone, direction),
            reason=f"{self.plan.reason} Watched on the way: {' '.join(step.decided for step in steps)}",
        )

    def _weighed(self, tone: int, direction: Array) -> Weighed | None:
        """Return what the shake that was ended with was worth by its amplitude, as far as it was looked at."""
        lines = np.abs(self.plan.tones.directions @ direction)
        number = np.flatnonzero((self._tone == tone) & (self._line == int(lines.argmax())))
        return self._options[int(number[0])].weighed if self._options else self.plan.weighed

    @property
    def _probe(self) -> float:
        return min(LONGEST_PROBE, max(PROBE_PERIODS / float(self._hertz.min()), SHORTEST_PROBE))

    @property
    def _probing(self) -> bool:
        """Whether the piece under way is a probe."""
        return not self._last and len(self.steps) < len(self.plan.tones.probed)

    def _probe_along(self, line: int, gentler: float = 1.0) -> Next:
        tones = self.plan.tones
        alone = np.minimum(tones.amplitudes[:, line], tones.reach[:, line])
        size = PROBED / gentler * alone / np.sqrt(len(alone))
        size /= max(1.0, float(np.sum(size / tones.reach[:, line])))  # peaks add up
        amplitudes = np.where(self._line == line, size[self._tone], 0.0)
        return Next(amplitudes, self._probe, "Probed across that line as well.")

    def _looked(self, frames: Sequence[Frame], steady: Sequence[ArmSample], begin: float) -> Look:
        piece, active = self._piece, np.flatnonzero(self._piece.amplitudes)
        direction, tones = self.plan.tones.directions[self._line[active[0]]], piece.frequencies[active]
        commanded = np.asarray(piece.amplitudes[active] * np.exp(-2j * np.pi * tones * begin), dtype=np.complex128)
        if self._middle is None:
            gripper, doubt = np.asarray(commanded[:, None] * direction, dtype=np.complex128), np.zeros(len(tones))
        else:
            gripper, doubt = links(gripper_motion(steady, self._middle, tones), tones)
        expected = None
        if self._options:
            expected = np.stack([c * self._options[n].told.picture for c, n in zip(commanded, active)], axis=1)  # noqa: B905
        seen = settled(swings(self._sight, frames, tones, expected), float(tones[0]))
        return Look(self._tone[active], direction, commanded, gripper, doubt, seen, len(self.steps))

    def _known(self, shake: int, answer: Answer) -> Known:
        return known(self._foresight, float(self._hertz[shake]), answer, self._late)

    def _after_probe(self, borne: float) -> Next:
        """Return what follows a probe: the next one, or the shake with which flowers can be moved most.

        `borne`: the largest of the probe's loads, over what may be borne. The next probe is as much gentler.
        """
        tones = self.plan.tones
        if not self._in_sight:
            self._last = True
            words = "Nothing is in sight: the plan alone is carried out."
            return self._only(0, self.plan.amplitude, self.plan.duration, words)
        if len(self._answers) < len(tones.probed):
            return self._probe_along(tones.probed[len(self._answers)], gentler=max(borne, 1.0))
        planned, reach = tones.amplitudes.ravel().tolist(), tones.reach.ravel().tolist()
        for shake, (tone, line) in enumerate(zip(self._tone, self._line, strict=True)):
            answer = summed([along[tone] for along in self._answers], tones.parts(int(line)))
            known_of, hertz = self._known(shake, answer), float(self._hertz[shake])
            option = Option(hertz, self._held, self._price, planned[shake], reach[shake], known_of)
            self._options.append(option)
        return self._decided(0) if len(self._hertz) == 1 else self._turned_to(self._best())

    def _best(self) -> int:
        """Return the shake that is worth most."""
        return max(range(len(self._options)), key=lambda n: self._options[n].promised)

    def _decided(self, now: int) -> Next:
        """Return what follows a shake that was looked at."""
        amplitude, option = float(self._piece.amplitudes[now]), self._options[now]
        why = "" if np.isfinite(option.told.most).any() else OUT_OF_SIGHT
        why = why if self._proofs[-1] else UNPROVEN
        if not why:
            self._sure = amplitude
            option.tried = max(option.tried, amplitude)
            best = self._best()
            if self._options[best].promised > BETTER * option.promised and self._fits(best):
                return self._turned_to(best)
        return self._raised(now, amplitude, why)

    def _only(self, shake: int, amplitude: float, seconds: float, words: str) -> Next:
        return Next(amplitude * (np.arange(len(self._hertz)) == shake), seconds, words)

    def _again(self, shake: int, amplitude: float, why: str) -> Next:
        self._doubted = True
        return self._only(shake, amplitude, self._watch(shake), f"Watched again at {1e3 * amplitude:.2g} mm: {why}.")

    def _turned_to(self, shake: int) -> Next:
        option, lines = self._options[shake], self.plan.tones.directions
        most, seen = option.may, bool(option.told.seen.any()) and all(self._proofs[: len(self.plan.tones.probed)])
        self._sure, self._doubted = option.planned, False
        begin = min(most.amplitude, option.planned * (RAISED if seen else 1.0))
        turned = np.degrees(np.arccos(min(abs(float(lines[self._line[shake]] @ lines[0])), 1.0)))
        words = (
            f"At {self._hertz[shake]:.3g} Hz, {turned:.0f}° from the plan's line, flowers may reach {most.flowers:.3g}"
            f" m/s² with {1e3 * most.amplitude:.2g} mm, more than otherwise; {most.binds} ends it there."
        )
        return self._only(shake, begin, self._watch(shake), words)

    def _raised(self, shake: int, now: float, doubt: str) -> Next:
        """Return a larger shake, or the last one.

        Where `doubt` says why what was seen proves nothing, no larger than what was proven before or the model allows.
        """
        option, may = self._options[shake], self._options[shake].may
        higher, why = min(may.amplitude, RAISED * now), may.binds
        if doubt:
            higher, why = min(max(self._sure, option.planned), higher), doubt
        if not self._fits(shake):
            higher, why = min(now, higher), NO_TIME
        if higher > ENOUGH * now:
            return self._only(shake, higher, self._watch(shake), f"Raised to {1e3 * higher:.2g} mm.")
        if doubt and not self._doubted and why != NO_TIME:
            return self._again(shake, higher, why)
        self._last = True
        done = [one.worth_at(one.borne) for one in self._options]
        best = int(np.argmax(done))
        if best != shake and done[best] > ENOUGH * option.worth_at(now):
            why = f"{why}; {self._hertz[best]:.3g} Hz was worth more"
            shake, higher = best, self._options[best].borne
        else:
            higher = min(now, higher)
        return self._only(shake, higher, HOLD, f"Held at {1e3 * higher:.2g} mm: {why}.")

    def _fits(self, shake: int) -> bool:
        """Return whether there is time for one more step, the hold after it, and coming to rest."""
        ends = self._piece.begin + self._piece.seconds
        return ends + 3 * self._ramp([shake]) + self._watch(shake) + HOLD + 2 * LEAD <= self.params.most_seconds

    def _ramp(self, shakes: Sequence[int] | NDArray[np.int64]) -> float:
        """Return how long changes of some shakes take [s]."""
        return float(np.max(0.5 / self._hertz[shakes], initial=RAMP))

    def _watch(self, shake: int) -> float:
        return max(LOOK, PERIODS / float(self._hertz[shake]))
