"""Prediction of a watched shake from the observations of camera and arm.

F flowers, K frequencies, M members, P points, S vectors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.core.geometry import Array, ComplexArray
from anther.core.oscillation import peak
from anther.plant.limits import stalk_strain
from anther.pollination import decision
from anther.pollination.decision import COSTS, expected
from anther.pollination.escalation._foresight import (
    FLOWER_SPREAD,
    SIGNIFICANCE,
    STILL,
    Foresight,
    misfit,
    moves_or_stands,
    repeats_motion,
    stillness,
    update_members,
)
from anther.pollination.response.points import Swings
from anther.pollination.shake.observables import semi_major
from anther.robot.cell import JOINT_SCATTER, GripMotion
from anther.robot.devices import ArmSample, DeviceError

DEPTH_BAND = 14.0
"""Up to here depth tells swings as they are [Hz]: a faster one moves less than depth errs, which feigns it."""


class Prediction(NamedTuple):
    """Prediction of one shake, per metre of commanded amplitude.

    Attributes:
        flowers: (F,) median of the predicted peak acceleration [1/s2].
        seen: (F,) whether the camera measured the flower.
        detectable: (F,) detection limit of the acceleration [1/s2]; NaN where the flower was not tracked.
        loads: kind of load -> expected value of the largest.
        answer: of the members; a measured flower has its measurement, and a tracked one at most its detection limit.
        phasors: (F, 3) of the flowers as `Swings` has them, on the camera's clock [m/m].
        observed: whether a valid observation supports the prediction.
    """

    flowers: Array
    seen: NDArray[np.bool_]
    detectable: Array
    loads: Mapping[str, float]
    answer: decision.Answer
    phasors: ComplexArray
    observed: bool = True

    @property
    def measured(self) -> NDArray[np.bool_] | None:
        """(F,) whether the camera measured a flower; None without an observation (`decision.worth`)."""
        return self.seen if self.observed else None


class Observation(NamedTuple):
    """One observation of a shake at K frequencies along one direction; phasors are on the robot's clock.

    Attributes:
        frequency_indices: (K,) into `Foresight.frequencies`.
        direction: (3,) unit, world.
        commanded: (K,) phasors along the direction [m].
        gripper: (M, K, 3) phasors of the gripper's motion, world [m], by member, or the same for all (1, K, 3).
        swings: of flowers and points.
        number: of the observation within the shake.
        motors: (K, J) phasors of what the arm's motors did, as they read [rad]; None of a motor in the gripper.
        measured: whether a sensor on the hand told what the gripper did.
        fault: why a sensor on the hand did not; empty if it did, or if there is none.
    """

    frequency_indices: NDArray[np.int64]
    direction: Array
    commanded: ComplexArray
    gripper: ComplexArray
    swings: Swings
    number: int = 0
    motors: ComplexArray | None = None
    measured: bool = False
    fault: str = ""

    @property
    def followed(self) -> int:
        """Number of points and flowers tracked."""
        return int(np.isfinite(self.swings.std[:, 0]).sum())


class Answer(NamedTuple):
    """Posterior response of a plant to one shake, per metre commanded.

    Attributes:
        members: (M, S, 3) after the Kalman update.
        flowers: (F, 3) measured motion along `axes`; NaN where not measured.
        std: (F, 3) its standard deviation.
        axes: (F, 3, 3) see `response.points.Sight`.
        peak: (F,) see `measure_sharpness`.
        observed: whether a valid observation supports it.
    """

    members: ComplexArray
    flowers: ComplexArray
    std: Array
    axes: Array
    peak: Array | float = 1.0
    observed: bool = True


def predict_growth(swings: Swings, hertz: float) -> float:
    """Return the relative growth still to come of a swing at a frequency [Hz]; negative: decay.

    After a change of the shake a mode approaches its steady swing as exp(-0.03 omega t).
    """
    # branching alone dissipates 0.028 (facts: pollination 2); lighter damping lets a swing grow for longer
    damping = 0.03
    return swings.growing / (2 * np.pi * hertz * damping)


def extrapolate_growth(swings: Swings, hertz: float) -> Swings:
    """Return the steady swings at a frequency [Hz] that growing swings approach; decaying swings are unchanged."""
    most = 3.0  # times the observed swing; a guess
    times = float(np.clip(1 + predict_growth(swings, hertz), 1.0, most))
    return swings._replace(phasors=times * swings.phasors, std=times * swings.std, overtones=times * swings.overtones)


DELAYS = np.arange(-0.005, 0.0451, 0.0025)
"""Of the camera's clock against the robot's [s], that are compared."""


def log_likelihood(foresight: Foresight, observation: Observation, grips: ComplexArray, delays: Array) -> Array:
    """Return ln of how likely an observation is (A, L), up to a constant.

    Args:
        foresight: prior responses of the members.
        observation: of flowers and points.
        grips: (A, K, 3) what the gripper may have done [m], in place of what the observation says.
        delays: (L,) of the camera's clock [s].
    """
    found = np.zeros((len(grips), len(delays)))
    for i, k in enumerate(observation.frequency_indices.tolist()):
        motion, std = _align_phase(foresight, observation, i, 0.0)
        watched = foresight.vectors[:, k, :, : len(motion)]
        turns = np.exp(2j * np.pi * foresight.frequencies[k] * delays)
        for a, moved in enumerate(grips[:, i] / observation.commanded[i]):
            members = np.asarray(np.einsum("mapx,a->mpx", watched, moved))
            found[a] -= misfit(members, motion, std, observation.swings.axes, turns)
    return found


def shows_plant(
    foresight: Foresight,
    observation: Observation,
    grips: ComplexArray,
    log_prior: Array,
    delay: float,
    before: Sequence[Observation] = (),
) -> bool:
    """Return whether an observation can only show a plant that the gripper moves.

    Stem, branches and leaves must move as predicted rather than a tenth as far (`moves_or_stands`), whatever the arm's
    joints let the gripper do; flowers may move little, but may not stand still (`stillness`); and the motion
    must not repeat that of a gentler shake (`repeats_motion`).

    Args:
        foresight: prior responses of the members.
        observation: of flowers and points.
        grips: (A, K, 3) what the gripper may have done [m].
        log_prior: (A,) ln of how likely each is, up to a constant.
        delay: of the camera's clock [s].
        before: observations that showed the plant.
    """
    points, count, axes = foresight.where["points"], foresight.where["flowers"].stop, observation.swings.axes
    found, stands = np.tile(log_prior, (2, 1)), False
    for i, k in enumerate(observation.frequency_indices.tolist()):
        motion, std = _align_phase(foresight, observation, i, delay)
        watched = foresight.vectors[:, k, :, points]
        for a, moved in enumerate(grips[:, i] / observation.commanded[i]):
            members = np.asarray(np.einsum("mapx,a->mpx", watched, moved))
            found[:, a] += moves_or_stands(members, motion[points], std[points], axes[points])
        stands |= stillness(_predict_members(foresight, observation, i), motion, std, axes, count)[1] > STILL
    moves, still = np.logaddexp.reduce(found, axis=1)
    least = 3.0  # ln of 20 to 1
    return bool(moves - still > least) and not stands and not _repeats_earlier(foresight, observation, delay, before)


def _repeats_earlier(
    foresight: Foresight, observation: Observation, delay: float, before: Sequence[Observation]
) -> bool:
    """Return whether an observation repeats an earlier one at the same frequency and direction."""
    points = foresight.where["points"]

    def moved(one: Observation, i: int) -> tuple[ComplexArray, Array]:
        motion, std = _align_phase(foresight, one, i, delay)
        return motion[points] * abs(one.commanded[i]), std[points] * abs(one.commanded[i])

    for last in before:
        alike = (
            np.argwhere(observation.frequency_indices[:, None] == last.frequency_indices)
            if np.allclose(last.direction, observation.direction)
            else ()
        )
        for i, j in alike:
            hertz = float(foresight.frequencies[observation.frequency_indices[i]])
            raised = float(np.abs(observation.commanded[i]) / np.abs(last.commanded[j]))
            changing = float(np.hypot(predict_growth(observation.swings, hertz), predict_growth(last.swings, hertz)))
            if repeats_motion(moved(observation, i), moved(last, j), raised, changing):
                return True
    return False


def update_answer(
    foresight: Foresight, observation: Observation, i: int, delay: float, before: Prediction | None = None
) -> Answer:
    """Return the posterior response at frequency number i of an observation.

    Args:
        foresight: prior responses of the members.
        observation: of flowers and points.
        i: into the observation's frequencies.
        delay: of the camera's clock [s], see `log_likelihood`.
        before: previous prediction of the same shake.
    """
    members = _predict_members(foresight, observation, i)
    motion, std = _credible_motion(foresight, observation, i, delay, members, before)
    axes, own = observation.swings.axes, foresight.where["flowers"]
    found = update_members(members, motion, std, axes, observation.number)
    return Answer(found, motion[own], std[own], axes[own], measure_sharpness(observation.swings, own))


def update_directions(
    foresight: Foresight,
    observation: Observation,
    delay: float,
    answers: Sequence[Answer],
    parts: Array,
    before: Prediction,
) -> list[Answer]:
    """Return the responses along probed directions after a shake at the same frequency along a sum of them.

    Members agree on how the plant answers along one direction more than on how it answers at all, so that what moves
    less than predicted along one is predicted to move less along others too.

    Args:
        foresight: prior responses of the members.
        observation: of the shake, at one frequency.
        delay: of the camera's clock [s].
        answers: along each probed direction.
        parts: weights with which they add up to the shake.
        before: previous prediction of the shake.
    """
    shaken = sum_answers(answers, parts).members
    motion, std = _credible_motion(foresight, observation, 0, delay, shaken, before)
    state = np.concatenate([shaken, *(one.members for one in answers)], axis=1)
    found = update_members(state, motion, std, observation.swings.axes, observation.number)
    along = np.split(found, len(answers) + 1, axis=1)[1:]
    return [one._replace(members=members) for one, members in zip(answers, along, strict=True)]


def _credible_motion(
    foresight: Foresight,
    observation: Observation,
    i: int,
    delay: float,
    members: ComplexArray,
    before: Prediction | None,
) -> tuple[ComplexArray, Array]:
    """Return motion and standard deviation as `_align_phase` does; NaN for flowers that were mistaken for another, or
    for what stands still behind them."""
    (motion, std), axes = _align_phase(foresight, observation, i, delay), observation.swings.axes
    own = foresight.where["flowers"]
    mistaken = ~_agrees_with_others(members[:, own], motion[own], std[own], axes[own])
    mistaken |= stillness(members, motion, std, axes, own.stop)[0] > SIGNIFICANCE
    if before is not None:
        omega = 2 * np.pi * foresight.frequencies[observation.frequency_indices[i]]
        across = np.linalg.norm(motion[own][:, :2], axis=1)
        largest = 4.0  # times the detection limit of the previous observation; only wrong tracks did, by 5 to 12
        mistaken |= _measured(motion[own], std[own]) & (omega**2 * across > largest * before.detectable)
    motion[own][mistaken] = std[own][mistaken] = np.nan
    return motion, std


def prior_answer(foresight: Foresight, observation: Observation, i: int) -> Answer:
    """Return the prior response at frequency number i of an observation, of which only the gripper's motion is used."""
    own = slice(foresight.where["flowers"].stop - foresight.where["flowers"].start)
    nothing = np.full((own.stop, 3), np.nan)
    members = _predict_members(foresight, observation, i)
    return Answer(members, nothing.astype(np.complex128), nothing, observation.swings.axes[own], observed=False)


def sum_answers(answers: Sequence[Answer], parts: Array) -> Answer:
    """Return the response to a shake that is a sum of others at the same frequency, with weights `parts`."""
    used = [(part, one) for part, one in zip(parts, answers, strict=True) if abs(part) > 1e-9]
    return Answer(
        np.asarray(sum(part * one.members for part, one in used)),
        np.asarray(sum(part * one.flowers for part, one in used)),
        np.sqrt(sum((part * one.std) ** 2 for part, one in used)),
        answers[0].axes,
        observed=all(one.observed for _, one in used),
    )


def predict(foresight: Foresight, hertz: float, one: Answer, delay: float) -> Prediction:
    """Return the prediction of a shake from the plant's response.

    Args:
        foresight: prior responses of the members.
        hertz: frequency of the shake [Hz].
        one: response of the plant.
        delay: of the camera's clock [s], see `log_likelihood`.
    """
    own, omega = foresight.where["flowers"], 2 * np.pi * hertz
    moved = np.einsum("mfx,fxa->mfa", one.members[:, own], one.axes)
    least = SIGNIFICANCE * one.std
    shown, unsure = (np.sqrt(np.nansum(np.abs(part) ** 2, axis=1)) for part in (one.flowers, least))
    upper = omega**2 * np.where(np.isfinite(one.std[:, 0]), np.hypot(shown, unsure), np.nan)
    seen = _measured(one.flowers, one.std)
    parts = moved.mean(axis=0)
    deep = np.abs(one.flowers[:, 2]) >= least[:, 2]
    away = np.where(deep, one.flowers[:, 2], _infer_depth_motion(moved, one.flowers[:, :2]))
    parts[seen] = np.column_stack([one.flowers[:, :2], away])[seen]
    swing = one.peak * semi_major(np.einsum("fa,fax->fx", parts, np.linalg.inv(one.axes)))  # with its overtones
    answer = foresight.answer(one.members, hertz, one.peak)
    answer = answer._replace(flowers=np.where(seen, omega**2 * swing, np.fmin(answer.flowers, upper)))
    measured = seen.tolist() if one.observed else [None] * len(seen)
    flowers = np.array([expected("flowers", answer.flowers[:, f], hertz, at) for f, at in enumerate(measured)])
    at_all = False if one.observed else None
    loads = {kind: float(expected(kind, getattr(answer, kind), hertz, at_all)) for kind in COSTS}
    loads["joint_strain"] = float(stalk_strain(hertz) * flowers.max(initial=0.0))
    return Prediction(flowers, seen, upper, loads, answer, np.exp(-1j * omega * delay) * parts, one.observed)


def _measured(motion: ComplexArray, std: Array) -> NDArray[np.bool_]:
    """Return (F,) whether motion (F, 3) exceeds its detection limit; False where NaN."""
    return np.any(np.abs(motion) >= SIGNIFICANCE * std, axis=1)


def _agrees_with_others(members: ComplexArray, motion: ComplexArray, std: Array, axes: Array) -> NDArray[np.bool_]:
    """Return (F,) whether a flower's ratio of observed to predicted motion agrees with that of the other flowers."""
    used, seen = np.isfinite(std), _measured(motion, std)
    predicted = np.where(used, np.sqrt(np.mean(np.abs(np.einsum("mfx,fxa->mfa", members, axes)) ** 2, axis=0)), 0.0)
    shown = np.linalg.norm(np.where(used, motion, 0.0), axis=1)
    more = shown / np.maximum(np.linalg.norm(predicted, axis=1), 1e-12)
    others = [np.delete(more, k)[np.delete(seen, k)] for k in range(len(more))]
    usual = np.array([max(1.0, float(np.median(rest))) if len(rest) else 1.0 for rest in others])
    largest = 4.0  # of `FLOWER_SPREAD`: beyond a factor of 13 a flower is an outlier
    return ~seen | (more <= usual * np.exp(largest * FLOWER_SPREAD))


def _infer_depth_motion(members: ComplexArray, across: ComplexArray) -> ComplexArray:
    """Return (F,) unobserved motion away from the camera.

    The phase is that of the members' mean and the size their root mean square, because members that disagree in phase
    still move. The size is scaled by observed over predicted motion across the line of sight, at most by 1.

    Args:
        members: (M, F, 3) posterior motion across, down and away.
        across: (F, 2) observed motion across and down.
    """
    across_size, down_size, away_size = np.sqrt(np.mean(np.abs(members) ** 2, axis=0)).T
    share = np.linalg.norm(across, axis=1) / np.maximum(np.hypot(across_size, down_size), 1e-12)
    return np.asarray(
        np.fmin(share, 1.0) * away_size * np.exp(1j * np.angle(members[..., 2].mean(axis=0))), dtype=np.complex128
    )


def _predict_members(foresight: Foresight, observation: Observation, i: int) -> ComplexArray:
    """Return (M, S, 3) predicted responses per metre commanded; each member has its own gripper motion."""
    tone = int(observation.frequency_indices[i])
    return foresight.of(tone, observation.gripper[:, i] / observation.commanded[i])


def _align_phase(foresight: Foresight, observation: Observation, i: int, delay: float) -> tuple[ComplexArray, Array]:
    """Return (F + P, 3) motion per metre commanded, in the phase of the shake, and its standard deviation.

    Above `DEPTH_BAND`, little depth motion is NaN.
    """
    tone, moved = float(foresight.frequencies[observation.frequency_indices[i]]), observation.swings.phasors[:, i]
    least = 0.001  # m of depth motion, several times the depth error of 0.1 to 0.3 mm; a judgement
    shallow = (tone > DEPTH_BAND) & ~(np.abs(moved[:, 2]) >= least)
    parts = np.where(shallow[:, None], [1.0, 1.0, np.nan], 1.0)
    turned = parts * np.exp(2j * np.pi * tone * delay) / observation.commanded[i]
    return np.asarray(moved * turned), observation.swings.std * np.abs(turned)


def measure_sharpness(swings: Swings, own: slice) -> Array:
    """Return (F,) the ratio of each flower's peak acceleration to that without overtones.

    Args:
        swings: at one frequency.
        own: rows of the flowers.
    """
    tone, over = np.nan_to_num(swings.phasors[own, 0]), np.nan_to_num(swings.overtones[own])
    if not over.size:
        return np.ones(len(tone))
    least = SIGNIFICANCE * np.sqrt(np.nansum(swings.std[own] ** 2, axis=1))
    over = np.where(np.linalg.norm(over, axis=2, keepdims=True) > least[:, None, None], over, 0.0)
    whole, sine = peak(np.concatenate([tone[:, None], over], axis=1)), peak(tone[:, None])
    return np.divide(whole, sine, out=np.ones(len(tone)), where=sine > 0)


STIFFNESS_DEVIATES = np.linspace(-2.5, 2.5, 21)
"""How stiff an arm's joints may be (`GripMotion`): the values that are compared."""


class JointBelief(NamedTuple):
    """What is believed of how stiff an arm's joints are.

    Attributes:
        grip: what its motors do to the grip.
        log_posterior: (A,) ln of how likely each of `STIFFNESS_DEVIATES` is, up to a constant.
    """

    grip: GripMotion
    log_posterior: Array = -(STIFFNESS_DEVIATES**2) / 2

    @property
    def probabilities(self) -> Array:
        """(A,) probability of each of `STIFFNESS_DEVIATES`."""
        error = 0.3  # of the stiffness that fits best, in arms whose joints each differ by 30 % (measured on seven)
        kernel = np.exp(-(((STIFFNESS_DEVIATES[:, None] - STIFFNESS_DEVIATES) / error) ** 2) / 2)
        share = kernel / kernel.sum(axis=0) @ np.exp(self.log_posterior - self.log_posterior.max())
        return np.asarray(share / share.sum())

    @property
    def stiffness(self) -> tuple[float, float]:
        """Mean and standard deviation, in deviates."""
        mean = float(self.probabilities @ STIFFNESS_DEVIATES)
        return mean, float(np.sqrt(self.probabilities @ (STIFFNESS_DEVIATES - mean) ** 2))

    def sample(self, motors: ComplexArray, frequencies: Array, count: int) -> ComplexArray:
        """Return (count, K, 3) phasors of the grip for joints that are as likely as is believed."""
        below = np.append(0.0, np.cumsum(self.probabilities))
        half = (STIFFNESS_DEVIATES[1] - STIFFNESS_DEVIATES[0]) / 2
        edges = np.append(STIFFNESS_DEVIATES - half, STIFFNESS_DEVIATES[-1] + half)
        common, rng = np.interp((np.arange(count) + 0.5) / count, below, edges), np.random.default_rng(0)
        own = JOINT_SCATTER * rng.normal(size=(count, motors.shape[1]))
        return self.grip(motors, frequencies, rng.permutation(common)[:, None] + own)

    def update(self, moved: ComplexArray, motors: ComplexArray, frequencies: Array) -> JointBelief:
        """Return what is believed after a sensor on the hand told what the grip did (K, 3) [m].

        Sizes count, not phases: the sensor has a clock of its own.

        Args:
            moved: phasors of the grip.
            motors: (K, J) those of the motors [rad].
            frequencies: (K,) [Hz].

        Raises:
            DeviceError: these motors cannot move a grip so, however stiff the joints are: the sensor is not where it is
                thought to be, or not of this arm.
        """
        grips, size = self.grip(motors, frequencies, STIFFNESS_DEVIATES), np.linalg.norm(moved, axis=1)
        sizes = np.maximum(np.linalg.norm(grips, axis=2), 1e-12)
        along = np.sum(np.abs(np.einsum("akx,kx->ak", grips.conj(), moved)), axis=1)
        alike = along / np.maximum(np.sum(sizes * size, axis=1), 1e-30)
        ratio = np.linalg.norm(size) / np.linalg.norm(sizes, axis=1)
        most, least = 3.0, 0.5  # times; cosine of the angle between the lines: guesses
        if not np.any((alike >= least) & (ratio >= 1 / most) & (ratio <= most)):
            best = int(alike.argmax())
            given = f"{ratio[best]:.2g} times what the arm's motors may make of it"
            turned = f"{np.degrees(np.arccos(min(float(alike[best]), 1.0))):.0f} degrees off their line"
            allowed = f"{1 / most:.2g} to {most:g} times, {np.degrees(np.arccos(least)):.0f} degrees"
            raise DeviceError(f"inertial sensor: got {given}, {turned}; allowed: {allowed}. Check where it is mounted.")
        error = 0.35  # of ln of a motion, where each joint's own stiffness differs; a guess
        off = (np.log(size) - np.log(sizes)) / error
        return self._replace(log_posterior=self.log_posterior - np.sum(off**2, axis=1) / 2)


def sample_motion(moved: ComplexArray, std: Array, count: int) -> ComplexArray:
    """Return (count, K, 3) what a grip may have done whose motion (K, 3) was measured, with errors `std` (K,) [m]."""
    drawn = np.random.default_rng(0).normal(size=(2, count, *moved.shape))
    return np.asarray(moved + std[:, None] * (drawn[0] + 1j * drawn[1]), dtype=np.complex128)


def fit_motors(samples: Sequence[ArmSample], frequencies: Array) -> ComplexArray:
    """Fit the motors' swings to the arm's readings: (K, J) phasors on the robot's clock [rad].

    Args:
        samples: of the arm during the steady shake.
        frequencies: (K,) [Hz].
    """
    times = np.array([s.time for s in samples])
    places = np.array([s.measured for s in samples])
    phase = 2 * np.pi * times[:, None] * frequencies
    basis = np.column_stack([np.sin(phase), np.cos(phase), np.ones_like(times), times - times.mean()])
    parts = np.linalg.solve(basis.T @ basis + 1e-12 * np.eye(basis.shape[1]), basis.T @ places)
    return np.asarray(
        parts[: len(frequencies)] + 1j * parts[len(frequencies) : 2 * len(frequencies)], dtype=np.complex128
    )
