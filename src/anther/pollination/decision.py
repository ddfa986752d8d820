"""What a shake is worth: fruit that it should add, less what it should cost. One rule for a plan and every step.

All is per flower of the plant. A shake's worth is linear in its probabilities, so that what members of a belief have in
common does not matter, and every expectation has a closed form: what a flower feels and what an organ bears are
lognormal, a dose-response is nearly a probit.

M members of a belief, each as likely; A amplitudes; F flowers; (...) any shakes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anther.core.choices import Preset
from anther.core.geometry import Array
from anther.core.records import Range, Record, Shape
from anther.plant.limits import (
    DOSE_MEASURES,
    GUSTS,
    HALF_DOSE,
    STALK_SPREAD,
    TOLERANCE,
    Believed,
    stalk_strain,
)

PRICES: dict[Preset, float] = {"gentle": 10.0, "default": 3.0, "bold": 1.0}
"""By preset: so many fruit a person would forgo rather than lose one flower, which is one fruit at most. The dial is
theirs. At 3 an arm's shakes of 40 plants lose 1.7 % of the flowers, on average over what plants bear."""
COSTS = {"base_strain": 0.1, "stem_strain": 3.0, "leaf_load": 0.1, "grip_force": 0.1}
"""What it costs, in flowers lost for each flower of the plant, if the organ that is loaded most stays bent, or the grip
slips. A judgement: a stem's bend costs this truss and the next two; a leaf is one of ten that feed the fruit, and the
base that is bent most is a leaf's (97 % of 1,440 shakes of the plants of `stalk_strain`; flowers on a bent peduncle are
counted as lost); a slip costs bark, besides this visit's fruit, which `worth` takes off."""

Errors = Mapping[str, tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]]
ERRORS: Errors = {
    "flowers": ((0.06, 0.13, -0.20, -0.75), (0.81, 0.48, 0.46, 0.75), (0.56, 0.75, 0.78, 0.89)),
    "base_strain": ((-2.92, -4.70, -3.72, -0.06), (0.59, 0.40, 0.55, 1.03), (0.54, 0.47, 0.44, 0.44)),
    "stem_strain": ((-0.11, -1.38, -1.93, -1.78), (0.98, 0.85, 0.81, 0.88), (0.50, 0.37, 0.31, 0.31)),
    "leaf_load": ((0.14, 0.82, 0.66, -0.81), (0.95, 0.33, 0.33, 0.44), (0.44, 0.52, 0.54, 0.85)),
    "grip_force": ((-0.69,) * 4, (1.0,) * 4, (0.55,) * 4),
}
"""ln(true / omega^2) = intercept + slope ln(modelled / omega^2), per metre of the grip, with a standard deviation
beside what members explain: the three in each of the bands of `believed`. Where a model errs by as much as plants
differ, what it says to be large is less so, and what it says to be small is more: the slope is below 1. Of the grip's
force without omega.

Fitted by likelihood to 80 simulated plants whose truth no stage believes, four grips each (`python -m
evaluation.prediction.belief --development --plants 80`); without that option it checks them on others. Of the grip's
force: 20 plants, 1-15 Hz."""
OBSERVED_ERRORS: Errors = {
    "flowers": ((0.06, -0.10, -0.25, -0.57), (1.06, 0.98, 0.73, 0.82), (0.45, 0.63, 0.63, 0.90)),
    "base_strain": ((-2.92, -3.83, -3.22, 1.32), (0.57, 0.49, 0.58, 1.15), (0.58, 0.47, 0.47, 0.48)),
    "stem_strain": ((-0.12, -1.40, -1.81, -0.70), (0.97, 0.84, 0.82, 0.97), (0.48, 0.40, 0.35, 0.34)),
    "leaf_load": ((0.34, 0.90, 0.78, -0.78), (1.01, 0.43, 0.36, 0.42), (0.42, 0.50, 0.54, 0.89)),
    "grip_force": ((-0.69,) * 4, (1.0,) * 4, (0.55,) * 4),
    "measured_flowers": ((0.25, 0.35, -0.3, -0.5), (1.0,) * 4, (0.4, 0.4, 0.6, 0.8)),
}
"""The same once a camera has seen this shake at a small amplitude, of all that was not measured itself; and of flowers
whose swing was measured: 32 flowers of nine trials in the simulated cell, films and all; checked on others by
`evaluation.trials.shaking`."""


Curve = Callable[[Array, Array], Array]
"""(mean, spread) of ln of a value -> expected value of something that depends on it."""


class Answer(NamedTuple):
    """What a shake does by a belief, per metre of the grip's amplitude.

    Attributes:
        flowers: (M, ..., F) peak acceleration [1/s2].
        base_strain, stem_strain, leaf_load, grip_force: (M, ...) the largest [1/m, 1/m, 1/s2, N/m].
    """

    flowers: Array
    base_strain: Array
    stem_strain: Array
    leaf_load: Array
    grip_force: Array


class Worth(NamedTuple):
    """Of shakes (...), per flower.

    Attributes:
        gain: expected share of pollen freed.
        freed: measure of motion (`DOSE_MEASURES`) -> the same if that is what frees pollen.
        lost: expected share of flowers of which a stalk stays bent (`stalk_strain`).
        bent: kind of `COSTS` -> probability that the organ that is loaded most stays bent; of the grip, that it slips.
        others: what organs that stay bent and slip cost, in flowers lost for each flower.
        net: what the shake is worth.
    """

    gain: Array
    freed: Mapping[str, Array]
    lost: Array
    bent: Mapping[str, Array]
    others: Array
    net: Array

    def by(self, measure: str) -> Array:
        """Return what the shake is worth if that measure of motion is what frees pollen."""
        return self.net + (1 - self.bent["grip_force"]) * (self.freed[measure] - self.gain)


@dataclass(frozen=True, slots=True, eq=False)
class WorthCurve(Record):
    """What one way to shake is worth by its amplitude. S amplitudes, rising.

    Attributes:
        amplitude: (S,) of the grip [m].
        gain: (S,) expected share of pollen freed.
        lost: (S,) expected share of flowers lost.
        others: (S,) expected cost of bent organs and slip, in flowers lost for each flower.
        net: (S,) worth.
        interval: (S, 2) between which lies what nine in ten members of the belief say of it.
    """

    amplitude: Annotated[Array, Shape("S"), Range(unit="m")]
    gain: Annotated[Array, Shape("S")]
    lost: Annotated[Array, Shape("S")]
    others: Annotated[Array, Shape("S")]
    net: Annotated[Array, Shape("S")]
    interval: Annotated[Array, Shape("S", 2)]


def believed(kind: str, values: Array, hertz: ArrayLike, measured: bool | None = None) -> tuple[Array, Array]:
    """Return ln of what each member makes of a load (M, ...), and what remains uncertain of that, likewise.

    Args:
        kind: of `Answer`.
        values: (M, ...) what the members say, per metre.
        hertz: frequencies of a shape that goes with (...).
        measured: whether a camera that observed this shake measured this flower; of other kinds either will do. None:
            nothing was observed.
    """
    row_of = "measured_flowers" if measured and kind == "flowers" else kind
    at = np.log(np.asarray(hertz, dtype=np.float64))
    # Hz: middles of 1-14, 14-20, 20-40 and 40-120 Hz, between which errors go as the logarithm of the frequency does
    bands = np.log([6.0, 17.0, 28.0, 70.0])
    rows = (ERRORS if measured is None else OBSERVED_ERRORS)[row_of]
    intercept, slope, spread = (np.interp(at, bands, row) for row in rows)
    inertia = 0.0 if kind == "grip_force" else 2 * (at + np.log(2 * np.pi))
    none = 1e-12  # a load per metre that is not more is none: there is no such organ
    logs = np.log(np.maximum(values, none))
    regressed = intercept + inertia + slope * (logs - inertia)
    return np.where(values > none, regressed, logs), np.asarray(spread)


def expected(kind: str, values: Array, hertz: ArrayLike, measured: bool | None = None) -> Array:
    """Return the median (...) of what is expected of a load; arguments as of `believed`."""
    return np.asarray(np.exp(believed(kind, values, hertz, measured)[0].mean(axis=0)))


def interval(logs: Array, doubt: ArrayLike) -> Array:
    """Return (..., 2) what 5 % lie below and above, over the median, of what is `believed`."""
    return np.exp(1.645 * np.sqrt(logs.var(axis=0) + np.square(doubt))[..., None] * [-1, 1])


def worth(
    answer: Answer,
    amplitude: Array,
    hertz: ArrayLike,
    held: ArrayLike,
    price: float,
    measured: NDArray[np.bool_] | None = None,
    delivered: tuple[Array | float, Array | float] = (0.0, 0.0),
) -> Worth:
    """Return what shakes are worth.

    Args:
        answer: of the shakes (...).
        amplitude: (A, ...) of the grip [m].
        hertz: of a shape that goes with (...) [Hz].
        held: the pull that the pads hold, likewise [N].
        price: of a flower that is lost, see `PRICES`.
        measured: (F,) which flowers a camera measured in this shake; None: nothing was observed.
        delivered: mean and standard deviation of ln of what the actuator does over what it is commanded, of a shape
            that goes with (...); after an observation it has no part, since that is per metre commanded.
    """
    hertz, size = np.asarray(hertz, dtype=np.float64), np.log(np.maximum(amplitude, 1e-12))
    observed = None if measured is None else False

    def means(values: Array, kind: str, *curves: Curve, known: bool | None = observed) -> list[Array]:
        """Return (A, ...) each, means over members of curves of ln of a load at the amplitudes and its spread."""
        logs, spread = believed(kind, values, hertz, known)
        spread, together = np.hypot(spread, delivered[1]), max(1, 2**13 // size.size)  # that the cache holds
        sums = [np.zeros(size.shape) for _ in curves]
        for first in range(0, len(logs), together):
            sizes = logs[first : first + together, None] + size + delivered[0]
            for k, curve in enumerate(curves):
                sums[k] += curve(sizes, spread).sum(axis=0)
        return [total / len(logs) for total in sums]

    curves = [_dose_curve(hertz, power) for power, _ in DOSE_MEASURES.values()]
    parts, count = np.zeros((len(curves) + 1, *size.shape)), answer.flowers.shape[-1]
    for f in range(count):
        known = None if measured is None else bool(measured[f])
        parts += np.array(means(answer.flowers[..., f], "flowers", *curves, _lost_curve(hertz), known=known)) / count
    freed = {measure: np.asarray(part) for measure, part in zip(DOSE_MEASURES, parts, strict=False)}
    lost = parts[-1]
    gain = np.sum([share * freed[measure] for measure, (_, share) in DOSE_MEASURES.items()], axis=0)
    bent = {
        kind: means(getattr(answer, kind), kind, _failure_curve(TOLERANCE[organ]))[0]
        for kind, organ in (("base_strain", "base"), ("stem_strain", "stem"), ("leaf_load", "leaf"))
    }
    bent["leaf_load"] = np.where(hertz > GUSTS, 0.0, bent["leaf_load"])
    # of the friction that pads have over that which a planner counts with: median and spread of ln, a guess
    grip = Believed(1.0, 0.25)
    (bent["grip_force"],) = means(answer.grip_force / np.asarray(held), "grip_force", _failure_curve(grip))
    others = np.sum([cost * bent[kind] for kind, cost in COSTS.items()], axis=0)
    return Worth(gain, freed, lost, bent, others, (1 - bent["grip_force"]) * gain - price * (lost + others))


def _normal_share(deviates: Array) -> Array:
    """Return the standard normal distribution function at deviates (...), within 2e-4.

    Page (1977), Applied Statistics 26: 75; a fifth of the time of the exact one, of which a plan asks 10^7.
    """
    return 0.5 + 0.5 * np.tanh(np.sqrt(2 / np.pi) * deviates * (1 + 0.044715 * np.square(deviates)))


def _dose_curve(hertz: Array, power: int) -> Curve:
    """Return the curve of the share of pollen freed by a measure of motion, see `DOSE_MEASURES`."""

    def freed(logs: Array, spread: Array) -> Array:
        exponent = 1.5  # n of the share freed, a^n / (a^n + half^n): between 1 and 2 (facts: pollination 6)
        probit = 1.702  # a logistic curve is so much steeper than the nearest normal distribution (Camilli 1994)
        width = np.sqrt((probit / exponent) ** 2 + HALF_DOSE.spread**2 + spread**2)
        same = 10.0  # Hz where all measures free as much, in the middle of what arms and motors do: a judgement
        return _normal_share((logs + power * np.log(hertz / same) - np.log(HALF_DOSE.median)) / width)

    return freed


def _failure_curve(tolerance: Believed) -> Curve:
    """Return the curve of the probability that a load passes what is borne."""
    return lambda logs, spread: _normal_share((logs - np.log(tolerance.median)) / np.hypot(tolerance.spread, spread))


def _lost_curve(hertz: Array) -> Curve:
    """Return the curve of the probability that a stalk of a flower stays bent, of the flower's acceleration."""
    bent, strain = _failure_curve(TOLERANCE["pedicel"]), np.log(stalk_strain(hertz))
    return lambda logs, spread: bent(logs + strain, np.hypot(spread, STALK_SPREAD))


def weighed(answer: Answer, amplitude: Array, *how: Any, **more: Any) -> WorthCurve:
    """Return what one shake is worth at amplitudes (S,); arguments as of `worth`."""
    found = worth(answer, amplitude, *how, **more)
    alone = [
        worth(Answer(*(part[m : m + 1] for part in answer)), amplitude, *how, **more).net
        for m in range(len(answer.flowers))
    ]
    return WorthCurve(
        amplitude, found.gain, found.lost, found.others, found.net, np.quantile(alone, [0.05, 0.95], axis=0).T
    )
