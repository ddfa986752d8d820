"""Escalation: a shake that begins gently and is raised as far as the camera sees that the plant bears it.

F flowers, K tones, P points that the camera may see, R readings of the arm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.checks import check_range
from anther.devices import LEAD, ArmSample, Frame
from anther.escalation.foresight import Foresight, foresee
from anther.escalation.known import Known, Look, gripper_motion, known, lateness, limits_of
from anther.execution import Step
from anther.geometry import Array, Intrinsics
from anther.plant import PlantModel
from anther.response.points import sight, swings
from anther.swing import Swing
from anther.vibration import Params as Limits
from anther.vibration import ShakePlan
from anther.vibration.params import FLOWER_SPREAD

__all__ = ["Escalation", "Foresight", "Params", "foresee", "watch_points"]


@dataclass(frozen=True, slots=True)
class Params:
    """How a watched shake is raised.

    Attributes:
        target: median acceleration of the flowers at which it is enough [m/s2]: half of their pollen is free at about
            20, between 5 and 80 (facts: pollination 6).
        most: no flower that is seen shall feel more [m/s2]; pedicels were bent by 0.5 % at 23 to 55 (the same).
        probe: how long all tones are watched at once, at most [s].
        look: how long a step is watched at least [s], or two periods.
        raised: a step is at most so many times the one before.
        hold: how long the last step goes on [s]; a flower approaches what it can free within 0.6 s.
        most_seconds: of the whole shake [s].
        points: of the plant that are watched beside the flowers.
    """

    target: float = 30.0
    most: float = 60.0
    probe: float = 1.4
    look: float = 0.4
    raised: float = 2.0
    hold: float = 1.2
    most_seconds: float = 12.0
    points: int = 60

    def __post_init__(self) -> None:
        check_range("target", self.target, 0.1, 1000, "m/s2")
        check_range("most", self.most, self.target, 10_000, "m/s2")
        check_range("probe", self.probe, 0.5, 10, "s")
        check_range("look", self.look, 0.2, 10, "s")
        check_range("raised", self.raised, 1.05, 4)
        check_range("hold", self.hold, 0.5, 10, "s")
        check_range("most_seconds", self.most_seconds, 4, 60, "s")
        check_range("points", self.points, 0, 1000)


RAMP = 0.3
"""In which the amplitude changes [s], or half a period of the slowest tone if that is longer."""
PERIODS = 2.0
"""A step is watched for so many of its periods at least."""
PROBE_PERIODS, SHORTEST_PROBE = 8.0, 0.5
"""The probe is watched for so many periods of its slowest tone, at least so long [s]."""
WORDS = {
    "stem_strain": "the bending of the stem",
    "joint_strain": "the bending of pedicels",
    "base_strain": "the bending of branch bases",
    "leaf_load": "the load at leaf bases",
    "grip_force": "slip",
}
"""The kinds of load, for people."""
SAMPLES, FRAMES = 2.2, 11
"""Frames a period at least, little more than two where frequencies are known; and in a look, of which six are fitted to
each path."""
PROBED = 0.7
"""Of the probe: the rms of its loads over that of the plan's shake; its peaks are about 1.3 times those."""
OUT_OF_SIGHT, NO_TIME = "flowers were lost from sight", "time"
LASTING = (OUT_OF_SIGHT, NO_TIME)
"""What ends a raise at once; of anything else a second look is taken, since a swing that dies out can feign it."""
BETTER = 1.3
"""Another tone is turned to when it promises so many times the flowers' motion."""
ENOUGH = 1.05
"""A raise by less is not worth its time."""
LOST = 0.5
"""A shake is ended when fewer than this share of the points followed in the probe still are, and raised no more when
fewer than this share of the flowers measured at its tone are."""


class Allowed(NamedTuple):
    """How far a tone may be raised: amplitude [m], the flowers' median there [m/s2], and what ends it."""

    amplitude: float
    flowers: float
    binds: str


class Escalation:
    """One watched shake at the grip and along the direction of a plan; it satisfies `execution.Watched`.

    A gentle mixture of tones is watched first: what it does to flowers, stem and leaves corrects what the model says of
    each tone at this grip (`foresight.narrowed`). The tone is taken at which the flowers can be moved most, and raised
    in steps, each watched, until they feel `Params.target` or a limit is near. Where the camera sees nothing, the plan
    is done as it is.

    Attributes:
        plan, params: as given.
        steps: what was done so far.

    Args:
        plan: where, and by the model how far at most.
        foresight: of the plan's grip, direction and tones.
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
        params: Params = Params(),
    ) -> None:
        self.plan, self.params = plan, params
        self.steps: tuple[Step, ...] = ()
        self._foresight, self._places, self._camera, self._middle = foresight, (flowers, points), camera, middle
        self._limits, self._risk = limits_of(limits, plan.press), limits.risk
        self._may: dict[int, Allowed] = {}
        self._picture: dict[int, NDArray[np.complex128]] = {}
        self._worth: dict[int, float] = {}
        self._tried: dict[int, tuple[float, float]] = {}
        self._late, self._in_sight, self._most_seen, self._last = 0.0, 0, 0, False
        self._doubted = False

    @property
    def reach(self) -> float:
        """The pads never move further [m]."""
        return float(self.plan.tones.reach.max())

    @property
    def frame_rate(self) -> float:
        """Frames a second that it needs: of a period of the fastest tone, and of the shortest look."""
        fastest = int(self._foresight.tones.argmax())
        return max(SAMPLES * float(self._foresight.tones[fastest]), FRAMES / self._watch(fastest))

    def begin(self, frame: Frame) -> Swing:
        """Return the probe: all tones at once, with the mean square of `PROBED` times what the model allows of one."""
        intrinsics, T_world_cam = self._camera
        self._sight = sight(frame, intrinsics, T_world_cam, *self._places)
        tones = self.plan.tones
        size = PROBED * np.minimum(tones.amplitudes, tones.reach) / np.sqrt(len(tones.frequencies))
        size *= min(1.0, self.reach / size.sum())
        ramp = self._ramp(int(tones.frequencies.argmin()))
        self._piece = Swing.first(tones.frequencies, size, ramp + self._probe + LEAD, ramp)
        return self._piece

    def since(self) -> float:
        """Return from when on the piece under way is steady [s], counted from the shake's begin."""
        piece = self._piece
        steady = self._probe if not self.steps else self._watch(int(piece.amplitudes.argmax()))
        return piece.begin + max(piece.ramp, piece.seconds - LEAD - steady)

    def go_on(self, frames: Sequence[Frame], samples: Sequence[ArmSample]) -> Swing:
        """Return what follows what was seen; the last piece ends at rest."""
        started, steady = perf_counter(), [s for s in samples if s.time >= samples[0].time + self.since()]
        look = self._looked(frames, steady, samples[0].time)
        if not self.steps:
            self._in_sight = look.followed
            self._late = lateness(self._foresight, look, self._T) if look.followed else 0.0
        told = [known(self._foresight, look, i, self._T, self._late, self._risk) for i in range(len(look.tones))]
        self._may |= {int(t): self._allowed(int(t), one) for t, one in zip(look.tones, told, strict=True)}
        self._worth |= {int(t): float(np.median(one.flowers)) for t, one in zip(look.tones, told, strict=True)}
        tone, amplitude, seconds, words = self._decided(look, int(told[0].seen.sum()))
        self._picture |= {int(t): one.picture for t, one in zip(look.tones, told, strict=True)}
        self._note(look, told, (steady[0].time, steady[-1].time), words, perf_counter() - started)
        ramp = self._ramp(tone)
        new = np.where(np.arange(len(self._foresight.tones)) == tone, amplitude, 0.0)
        self._piece = self._piece.then(new, ramp + (seconds + LEAD if amplitude else 0.0), ramp)
        return self._piece

    def executed(self, steps: Sequence[Step]) -> ShakePlan:
        """Return the plan as it was carried out: the last step, and what the plant as believed would do in it."""
        if not steps:
            return self.plan
        last, tones = steps[-1], self._foresight.tones
        tone, amplitude = int(np.abs(tones - last.frequencies[0]).argmin()), last.amplitudes[0]
        size = amplitude * self._foresight.sizes("flowers")[:, tone]
        spread = np.quantile(np.log(np.maximum(size, 1e-12)), [0.05, 0.95], axis=0).T
        logs = np.log(np.maximum(size[0], 1e-12))[:, None]
        wide = np.exp(logs + [-1, 1] * np.hypot(spread - logs, 1.645 * FLOWER_SPREAD))
        omega2 = (2 * np.pi * tones[tone]) ** 2
        return replace(
            self.plan,
            frequency=float(tones[tone]),
            amplitude=amplitude,
            duration=last.end - last.begin,
            predicted_amplitude=size[0],
            predicted_amplitude_interval=wide,
            predicted_acceleration=omega2 * size[0],
            predicted_acceleration_interval=omega2 * wide,
            reason=f"{self.plan.reason} Watched on the way: {' '.join(step.decided for step in steps)}",
        )

    @property
    def _probe(self) -> float:
        slowest = float(self._foresight.tones.min())
        return min(self.params.probe, max(PROBE_PERIODS / slowest, SHORTEST_PROBE))

    @property
    def _T(self) -> Array:
        return self._camera[1][:3, :3]

    def _looked(self, frames: Sequence[Frame], steady: Sequence[ArmSample], begin: float) -> Look:
        piece, active = self._piece, np.flatnonzero(self._piece.amplitudes)
        if self._middle is None:
            turned = np.exp(-2j * np.pi * piece.frequencies[active] * begin)
            gripper = np.asarray(piece.amplitudes[active] * turned, dtype=np.complex128)
        else:
            gripper = gripper_motion(steady, self._middle, self.plan.direction, piece.frequencies[active])
        expected = None
        if all(int(tone) in self._picture for tone in active):
            expected = np.stack([piece.amplitudes[tone] * self._picture[int(tone)] for tone in active], axis=1)
        seen = swings(self._sight, frames, piece.frequencies[active], expected)
        return Look(active, piece.amplitudes[active], gripper, seen)

    def _allowed(self, tone: int, one: Known) -> Allowed:
        """Return how far a tone may be raised."""
        median, largest = float(np.median(one.flowers)), float(one.flowers[one.seen].max(initial=0.0))
        caps = {kind: limit / max(one.loads[kind], 1e-12) for kind, limit in self._limits.items()}
        caps["what the actuator can do"] = float(self.plan.tones.reach[tone])
        caps["the target"] = self.params.target / max(median, 1e-12)
        caps["the most a flower may feel"] = self.params.most / max(largest, 1e-12)
        binds = min(caps, key=lambda name: caps[name])
        return Allowed(caps[binds], median * caps[binds], WORDS.get(binds, binds))

    def _decided(self, look: Look, seen: int) -> tuple[int, float, float, str]:
        """Return the next tone, its amplitude [m], for how long [s], and why."""
        if not self.steps and not look.followed:
            self._last = True
            return 0, self.plan.amplitude, self.plan.duration, "Nothing is in sight: the plan alone is carried out."
        tone, now = int(look.tones[0]), float(look.amplitudes[0])
        if self._last:
            return tone, 0.0, 0.0, "Held long enough."
        if look.followed < LOST * self._in_sight:
            return tone, 0.0, 0.0, f"Only {look.followed} of {self._in_sight} points are still followed: ended."
        best = max(self._may, key=lambda k: (min(self._may[k].flowers, self.params.target), self._may[k].flowers))
        if self._may[best].flowers <= BETTER * self._may[tone].flowers:
            best = tone  # of the probe, the plan's own
        if len(look.tones) > 1 or (best != tone and self._fits(best)):
            return self._turned_to(best, look)
        self._tried[tone] = max(self._tried.get(tone, (0.0, 0.0)), (now * self._worth[tone], now))
        return self._raised(tone, now, seen)

    def _turned_to(self, tone: int, look: Look) -> tuple[int, float, float, str]:
        most, done = self._may[tone], dict(zip(look.tones.tolist(), look.amplitudes.tolist(), strict=True))
        self._most_seen, self._doubted = 0, False
        begin = max(float(self.plan.tones.amplitudes[tone]), self.params.raised * done.get(tone, 0.0))
        words = (
            f"At {self._foresight.tones[tone]:.3g} Hz flowers may reach {most.flowers:.3g} m/s2 with "
            f"{1e3 * most.amplitude:.2g} mm, more than at other tones; {most.binds} ends it there."
        )
        return tone, min(begin, most.amplitude), self._watch(tone), words

    def _raised(self, tone: int, now: float, seen: int) -> tuple[int, float, float, str]:
        may, self._most_seen = self._may[tone], max(self._most_seen, seen)
        higher, why = min(may.amplitude, self.params.raised * now), may.binds
        if seen < LOST * self._most_seen or not seen:
            higher, why = min(now, higher), OUT_OF_SIGHT
        elif not self._fits(tone):
            higher, why = min(now, higher), NO_TIME
        if higher > ENOUGH * now:
            self._doubted = False
            return tone, higher, self._watch(tone), f"Raised to {1e3 * higher:.2g} mm."
        if not self._doubted and why not in LASTING:
            self._doubted = True
            return tone, higher, self._watch(tone), f"Watched again at {1e3 * higher:.2g} mm: {why}."
        self._last = True
        best = max(self._tried, key=lambda k: self._tried[k])
        if best != tone and self._tried[best] > (BETTER * now * self._worth[tone], 0.0):
            tone, higher, why = (
                best,
                self._tried[best][1],
                f"{why}; more was seen at {self._foresight.tones[best]:.3g} Hz",
            )
        else:
            higher = min(now, higher)
        return tone, higher, self.params.hold, f"Held at {1e3 * higher:.2g} mm: {why}."

    def _fits(self, tone: int) -> bool:
        """Return whether there is time for one more step, the hold after it, and coming to rest."""
        ramp, ends = self._ramp(tone), self._piece.begin + self._piece.seconds
        return ends + 3 * ramp + self._watch(tone) + self.params.hold + 2 * LEAD <= self.params.most_seconds

    def _ramp(self, tone: int) -> float:
        return max(RAMP, 0.5 / float(self._foresight.tones[tone]))

    def _watch(self, tone: int) -> float:
        return max(self.params.look, PERIODS / float(self._foresight.tones[tone]))

    def _note(self, look: Look, told: Sequence[Known], when: tuple[float, float], words: str, seconds: float) -> None:
        felt = np.sqrt(sum((a * one.flowers) ** 2 for a, one in zip(look.amplitudes, told, strict=True)))
        flowers = np.where(told[0].seen, felt, np.nan)
        loads = {k: sum(a * one.loads[k] for a, one in zip(look.amplitudes, told, strict=True)) for k in self._limits}
        shares = {WORDS[k]: float(loads[k] / limit) for k, limit in self._limits.items()}
        tones = tuple(self._foresight.tones[look.tones].tolist())
        step = Step(*when, tones, tuple(look.amplitudes.tolist()), tuple(flowers.tolist()), shares, words, seconds)
        self.steps = (*self.steps, step)


def watch_points(plant: PlantModel, most: int) -> NDArray[np.int64]:
    """Return up to `most` nodes of stem, branches and leaves that lie far from each other: farthest first."""
    stalks = plant.is_pedicel | np.isin(np.arange(len(plant.is_pedicel)), plant.flower_nodes)
    nodes = np.flatnonzero(~stalks)
    places = plant.rods.nodes[nodes]
    chosen, gap = [0], np.linalg.norm(places - places[0], axis=1)
    while len(chosen) < min(most, len(nodes)):
        chosen.append(int(gap.argmax()))
        gap = np.minimum(gap, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return nodes[chosen]
