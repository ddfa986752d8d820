"""What is known of a watched shake, once camera and arm have measured it or its parts.

F flowers, K tones, M members, P points, S vectors.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.core.geometry import Array
from anther.core.oscillation import peak
from anther.plant.limits import PEDICEL_STRAIN
from anther.pollination import decision
from anther.pollination.decision import COSTS, expected
from anther.pollination.escalation._foresight import (
    FLOWER_SPREAD,
    SIGNIFICANCE,
    Foresight,
    evidence,
    misfit,
    narrowed,
    repeated,
    stand,
)
from anther.pollination.response.points import Swings
from anther.pollination.shake.observables import ComplexArray, semi_major
from anther.pollination.shake.params import FAST
from anther.robot.devices import ArmSample

MISTAKEN = 4.0
"""A flower is not measured when it seems to swing exp(4 `FLOWER_SPREAD`), 13, times as far as the members say of it
while the others do not: something else was followed."""

PROOF = 3.0
"""ln of the odds, 20 to 1, from which on a look is taken for one at the plant (`evidence`). Of 36 looks at 4 simulated
plants 34 had more, 7 to 290; the others were probes of 0.1 mm. Had nothing moved, with the tracker's noise or without,
or a tenth, all would have had less than -5."""

JUMP = 4.0
"""Nor when it seems to swing, per metre, more than so many times as far as it could have, unseen or seen, by the look
before: of 1045 pairs of looks at one shake four did so, by 5 to 12 times, and none of these flowers had. Probes count
too: two flowers that jumped after them turned a shake back from 0.12 to 0.04 mm."""

DAMPING = 0.03
"""Damping ratio by which a swing that still grows goes on growing: branching alone dissipates 0.028 (facts: pollination
2); the more lightly damped a plant is, the longer it grows."""
MOST_GROWTH = 3.0
"""A swing settles at no more than so many times what was seen."""

DEEP = 0.001
"""Above `FAST` flowers swing by tenths of a millimetre, and depth is read to 0.1 to 0.3 mm: it counts from here on [m],
several times that. A judgement."""

LATE = np.arange(-0.005, 0.0451, 0.0025)
"""By how much a camera's clock may be late on the robot's [s]; what fits best is taken."""


class Known(NamedTuple):
    """Of one shake, per metre of the commanded amplitude.

    Attributes:
        flowers: (F,) peak acceleration, median of what is expected [1/s2].
        seen: (F,) whether the camera measured it.
        most: (F,) acceleration above which the camera would have measured it [1/s2]; NaN where it was not followed.
        loads: kind of load -> the largest, as expected.
        answer: what members say that it does; of flowers that are seen, what the camera measured, and of others that it
            followed, no more than it would have measured.
        picture: (F, 3) phasors of the flowers as `Swings` has them, on the camera's clock [m/m].
        observed: whether a camera taught anything of it.
    """

    flowers: Array
    seen: NDArray[np.bool_]
    most: Array
    loads: Mapping[str, float]
    answer: decision.Answer
    picture: ComplexArray
    observed: bool = True

    @property
    def measured(self) -> NDArray[np.bool_] | None:
        """(F,) whether the camera measured a flower; None: nothing was observed (`decision.worth`)."""
        return self.seen if self.observed else None


class Look(NamedTuple):
    """One look at a shake of K tones along one line; phasors are on the robot's clock.

    Attributes:
        tones: (K,) numbers of them.
        direction: (3,) unit, of the line.
        commanded: (K,) phasors along it [m].
        gripper: (K, 3) phasors of what the gripper did, world [m]: an arm that is soft goes less far than it is told
            to, and aside.
        doubt: (K,) standard deviation of that, relative to what was commanded.
        swings: of flowers and points.
        number: of the shake's looks.
    """

    tones: NDArray[np.int64]
    direction: Array
    commanded: ComplexArray
    gripper: ComplexArray
    doubt: Array
    swings: Swings
    number: int = 0

    @property
    def followed(self) -> int:
        """Points and flowers that were followed."""
        return int(np.isfinite(self.swings.std[:, 0]).sum())


class Answer(NamedTuple):
    """What a plant is known to answer to one shake, per metre commanded.

    Attributes:
        members: (M, S, 3) as narrowed by what was seen.
        flowers: (F, 3) motion that the camera measured, along `axes`; NaN where it did not.
        std: (F, 3) its standard deviation.
        axes: (F, 3, 3) see `response.points.Sight`.
        peak: (F,) see `sharpened`.
        observed: whether a camera taught anything of it.
    """

    members: ComplexArray
    flowers: ComplexArray
    std: Array
    axes: Array
    peak: Array | float = 1.0
    observed: bool = True


def unsettled(swings: Swings, hertz: float) -> float:
    """Return by which share of itself a swing of a tone [Hz] will still grow, negative: die out.

    After a change of the shake a mode nears its new swing as exp(-`DAMPING` omega t): where it is, and how fast it
    changes, say where it ends.
    """
    return swings.growing / (2 * np.pi * hertz * DAMPING)


def settled(swings: Swings, hertz: float) -> Swings:
    """Return the swings of a tone [Hz] as they will be once they no longer grow; of what dies out, as they are."""
    times = float(np.clip(1 + unsettled(swings, hertz), 1.0, MOST_GROWTH))
    return swings._replace(phasors=times * swings.phasors, std=times * swings.std, overtones=times * swings.overtones)


def lateness(foresight: Foresight, look: Look) -> float:
    """Return by how much the camera's clock is late [s]: that of `LATE` which the members explain best."""
    members = [_members(foresight, look, i) for i in range(len(look.tones))]
    off = [
        sum(misfit(m, *_turned(foresight, look, i, late), look.swings.axes) for i, m in enumerate(members))
        for late in LATE
    ]
    return float(LATE[int(np.argmin(off))])


def proven(foresight: Foresight, look: Look, late: float, before: Sequence[Look] = ()) -> bool:
    """Return whether what was seen can only be a plant that the gripper moves, with the flowers that hang on it.

    Stem, branches and leaves alone give the `evidence`: flowers may move little. But not, in the middle of them, by
    `STAND_OUT` standard deviations less than the others, beside what the members say of both. Nor may what is seen be
    `repeated` from a look before at a gentler shake.
    """
    points, count = foresight.where["points"], foresight.where["flowers"].stop
    odds, stands = 0.0, False
    for i in range(len(look.tones)):
        members, (motion, std), axes = _members(foresight, look, i), _turned(foresight, look, i, late), look.swings.axes
        odds += evidence(members[:, points], motion[points], std[points], axes[points])
        stands |= stand(members, motion, std, axes, count)
    return odds > PROOF and not stands and not _repeats(foresight, look, late, before)


def _repeats(foresight: Foresight, look: Look, late: float, before: Sequence[Look]) -> bool:
    """Return whether a look shows the motion of one before it at the same tone and line that was gentler."""
    points = foresight.where["points"]

    def moved(one: Look, i: int) -> tuple[ComplexArray, Array]:
        motion, std = _turned(foresight, one, i, late)
        return motion[points] * abs(one.commanded[i]), std[points] * abs(one.commanded[i])

    for last in before:
        alike = np.argwhere(look.tones[:, None] == last.tones) if np.allclose(last.direction, look.direction) else ()
        for i, j in alike:
            hertz = float(foresight.tones[look.tones[i]])
            raised = float(np.linalg.norm(look.gripper[i]) / np.linalg.norm(last.gripper[j]))
            changing = float(np.hypot(unsettled(look.swings, hertz), unsettled(last.swings, hertz)))
            if repeated(moved(look, i), moved(last, j), raised, changing):
                return True
    return False


def answered(foresight: Foresight, look: Look, i: int, late: float, before: Known | None = None) -> Answer:
    """Return what is known of the look's tone number i.

    Args:
        foresight: of the members.
        look: what was seen.
        i: of its tones.
        late: see `lateness`.
        before: what was known of the same shake.
    """
    motion, std = _turned(foresight, look, i, late)
    own = slice(foresight.where["flowers"].stop - foresight.where["flowers"].start)
    members = _members(foresight, look, i)
    mistaken = ~_like_the_others(members[:, foresight.where["flowers"]], motion[own], std[own], look.swings.axes[own])
    if before is not None:
        across, omega = np.linalg.norm(motion[own][:, :2], axis=1), 2 * np.pi * foresight.tones[look.tones[i]]
        mistaken |= _measured(motion[own], std[own]) & (omega**2 * across > JUMP * before.most)
    motion[own][mistaken] = std[own][mistaken] = np.nan
    found = narrowed(members, motion, std, look.swings.axes, look.number)
    return Answer(found, motion[own], std[own], look.swings.axes[own], sharpened(look.swings, own))


def unproven(foresight: Foresight, look: Look, i: int) -> Answer:
    """Return what is believed of the look's tone number i where it proves nothing: only what the gripper did counts."""
    own = slice(foresight.where["flowers"].stop - foresight.where["flowers"].start)
    nothing = np.full((own.stop, 3), np.nan)
    members = _members(foresight, look, i)
    return Answer(members, nothing.astype(np.complex128), nothing, look.swings.axes[own], observed=False)


def summed(answers: Sequence[Answer], parts: Array) -> Answer:
    """Return what a plant answers to a shake that is the sum of others at the same frequency, so much of each."""
    used = [(part, one) for part, one in zip(parts, answers, strict=True) if abs(part) > 1e-9]
    return Answer(
        np.asarray(sum(part * one.members for part, one in used)),
        np.asarray(sum(part * one.flowers for part, one in used)),
        np.sqrt(sum((part * one.std) ** 2 for part, one in used)),
        answers[0].axes,
        observed=all(one.observed for _, one in used),
    )


def known(foresight: Foresight, hertz: float, one: Answer, late: float) -> Known:
    """Return what is known of a shake for which the plant's answer is.

    Args:
        foresight: of the members.
        hertz: frequency of the shake [Hz].
        one: the answer.
        late: see `lateness`.
    """
    own, omega = foresight.where["flowers"], 2 * np.pi * hertz
    moved = np.einsum("mfx,fxa->mfa", one.members[:, own], one.axes)
    least = SIGNIFICANCE * one.std
    shown, unsure = (np.sqrt(np.nansum(np.abs(part) ** 2, axis=1)) for part in (one.flowers, least))
    may = omega**2 * np.where(np.isfinite(one.std[:, 0]), np.hypot(shown, unsure), np.nan)
    seen = _measured(one.flowers, one.std)
    parts = moved.mean(axis=0)
    deep = np.abs(one.flowers[:, 2]) >= least[:, 2]
    away = np.where(deep, one.flowers[:, 2], _away(moved, one.flowers[:, :2]))
    parts[seen] = np.column_stack([one.flowers[:, :2], away])[seen]
    swing = one.peak * semi_major(np.einsum("fa,fax->fx", parts, np.linalg.inv(one.axes)))  # without overtones, as much
    answer = foresight.answer(one.members, hertz, one.peak)
    answer = answer._replace(flowers=np.where(seen, omega**2 * swing, np.fmin(answer.flowers, may)))
    known_of = seen.tolist() if one.observed else [None] * len(seen)
    flowers = np.array([expected("flowers", answer.flowers[:, f], hertz, at) for f, at in enumerate(known_of)])
    at_all = False if one.observed else None
    loads = {kind: float(expected(kind, getattr(answer, kind), hertz, at_all)) for kind in COSTS}
    loads["joint_strain"] = PEDICEL_STRAIN.median * float(flowers.max(initial=0.0))
    return Known(flowers, seen, may, loads, answer, np.exp(-1j * omega * late) * parts, one.observed)


def _measured(motion: ComplexArray, std: Array) -> NDArray[np.bool_]:
    """Return (F,) whether motion (F, 3) is more than its error; not where it is NaN."""
    return np.any(np.abs(motion) >= SIGNIFICANCE * std, axis=1)


def _like_the_others(members: ComplexArray, motion: ComplexArray, std: Array, axes: Array) -> NDArray[np.bool_]:
    """Return (F,) whether a flower swings about as much more than members (M, F, 3) say as others that are seen do."""
    used, seen = np.isfinite(std), _measured(motion, std)
    said = np.where(used, np.sqrt(np.mean(np.abs(np.einsum("mfx,fxa->mfa", members, axes)) ** 2, axis=0)), 0.0)
    shown = np.linalg.norm(np.where(used, motion, 0.0), axis=1)
    more = shown / np.maximum(np.linalg.norm(said, axis=1), 1e-12)
    others = [np.delete(more, k)[np.delete(seen, k)] for k in range(len(more))]
    usual = np.array([max(1.0, float(np.median(rest))) if len(rest) else 1.0 for rest in others])
    return ~seen | (more <= usual * np.exp(MISTAKEN * FLOWER_SPREAD))


def _away(members: ComplexArray, across: ComplexArray) -> ComplexArray:
    """Return (F,) motion away from the camera that it did not see.

    It has the phase of the members' mean and the size of their root mean square, since members that disagree do not
    say that nothing moves: no more than that, nor in a larger ratio to what was seen than theirs.

    Args:
        members: (M, F, 3) motion across, down and away, as they are narrowed.
        across: (F, 2) motion that was seen across and down.
    """
    across_size, down_size, away_size = np.sqrt(np.mean(np.abs(members) ** 2, axis=0)).T
    share = np.linalg.norm(across, axis=1) / np.maximum(np.hypot(across_size, down_size), 1e-12)
    return np.asarray(
        np.fmin(share, 1.0) * away_size * np.exp(1j * np.angle(members[..., 2].mean(axis=0))), dtype=np.complex128
    )


def _members(foresight: Foresight, look: Look, i: int) -> ComplexArray:
    """Return (M, S, 3) what the members say per metre commanded; each has its own error of the gripper's motion."""
    tone = int(look.tones[i])
    error = drawn_errors(len(foresight.vectors), look.direction, tone)
    return foresight.of(tone, look.gripper[i] / look.commanded[i] + look.doubt[i] * error)


def _turned(foresight: Foresight, look: Look, i: int, late: float) -> tuple[ComplexArray, Array]:
    """Return (F + P, 3) motion per metre commanded, as `Swings` has it, and its standard deviation.

    Above `FAST` without depths that swing by less than `DEEP`.
    """
    tone, moved = float(foresight.tones[look.tones[i]]), look.swings.phasors[:, i]
    shallow = (tone > FAST) & ~(np.abs(moved[:, 2]) >= DEEP)
    parts = np.where(shallow[:, None], [1.0, 1.0, np.nan], 1.0)
    turned = parts * np.exp(2j * np.pi * tone * late) / look.commanded[i]
    return np.asarray(moved * turned), look.swings.std * np.abs(turned)


def sharpened(swings: Swings, own: slice) -> Array:
    """Return (F,) the peak of each flower's acceleration over what it would be without overtones.

    Args:
        swings: of one tone.
        own: of its points, the flowers.
    """
    tone, over = np.nan_to_num(swings.phasors[own, 0]), np.nan_to_num(swings.overtones[own])
    if not over.size:
        return np.ones(len(tone))
    least = SIGNIFICANCE * np.sqrt(np.nansum(swings.std[own] ** 2, axis=1))
    over = np.where(np.linalg.norm(over, axis=2, keepdims=True) > least[:, None, None], over, 0.0)
    whole, sine = peak(np.concatenate([tone[:, None], over], axis=1)), peak(tone[:, None])
    return np.divide(whole, sine, out=np.ones(len(tone)), where=sine > 0)


ARM_MODE, ARM_ERROR = 28.0, 0.6
"""Links swing beyond their motors, which is what an arm reads, by 1 / (1 - (f / `ARM_MODE`)^2) [Hz], with an error of
`ARM_ERROR` (f / `FAST`)^3 times what was commanded. Measured on 24 simulated Sawyers
(evaluation/trials/arm_readings.py, wide truth, two lines each) that hold nothing: by 1.10 at 8.5, 1.19 at 11.3, 1.5 at
16.9 Hz; median and 75 % quantile of the error 3 and 12 % at 6.4, 8 and 33 % at 11.3, 20 and 104 % at 16.9 Hz."""
ARM_FOLLOWS, ARM_ASIDE = 0.9, 0.3
"""Whatever it reads an arm does about so much of what is commanded, at any phase (the same arms: 0.54 to 1.55 at 18.5
Hz), and so much of that along any other line."""


def gripper_motion(samples: Sequence[ArmSample], middle: Callable[[Array], Array], tones: Array) -> ComplexArray:
    """Return (K, 3) phasors of the gripper's motion by the arm's readings, world, on the robot's clock [m].

    Args:
        samples: of the arm while the tones were steady.
        middle: joints (R, J) -> (R, 3) place of the grip, world [m].
        tones: (K,) [Hz].
    """
    times = np.array([s.time for s in samples])
    places = middle(np.array([s.measured for s in samples]))
    phase = 2 * np.pi * times[:, None] * tones
    basis = np.column_stack([np.sin(phase), np.cos(phase), np.ones_like(times), times - times.mean()])
    parts = np.linalg.solve(basis.T @ basis + 1e-12 * np.eye(basis.shape[1]), basis.T @ places)
    return np.asarray(parts[: len(tones)] + 1j * parts[len(tones) : 2 * len(tones)], dtype=np.complex128)


def links(readings: ComplexArray, tones: Array) -> tuple[ComplexArray, Array]:
    """Return how the gripper swings, (K, 3) phasors [m], and `Look.doubt`, when an arm reads so.

    An arm reads its motors. Above the modes of its links that says less of its gripper than what it was told.

    Args:
        readings: (K, 3) phasors of the gripper, if links went as their motors do [m].
        tones: (K,) [Hz].
    """
    error = ARM_ERROR * (tones / FAST) ** 3
    weight = ARM_FOLLOWS**2 / (ARM_FOLLOWS**2 + error**2)
    beyond = 1 / (1 - np.minimum(tones / ARM_MODE, 0.7) ** 2)  # nearer to the mode readings count for little
    return readings * (weight * beyond)[:, None], error * np.sqrt(weight)


def drawn_errors(count: int, direction: Array, tone: int) -> ComplexArray:
    """Return (M, 3) what `count` members add to the gripper's motion, with a `Look.doubt` of 1.

    Each turns the `direction` (3,) that is commanded in its own way, the same in every look at a tone, so that lines
    still add up.
    """
    parts = np.random.default_rng([0, tone]).normal(size=(2, count, 10)) / np.sqrt(2)
    along, aside = np.split(parts[0] + 1j * parts[1], [1], axis=1)
    return np.asarray(along * direction + ARM_ASIDE * aside.reshape(-1, 3, 3) @ direction, dtype=np.complex128)
