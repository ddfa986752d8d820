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
from scipy.special import ndtr

from anther.core.choices import Preset
from anther.core.geometry import Array
from anther.core.records import Range, Record, Shape
from anther.plant.limits import GUSTS, HALF_DOSE, LOST_AT, TOLERANCE, Believed

PRICES: dict[Preset, float] = {"gentle": 15.0, "default": 5.0, "bold": 2.0}
"""By preset: so many fruit a person would forgo rather than lose one flower. A judgement; the dial is theirs."""
COSTS = {"base_strain": 1.0, "stem_strain": 3.0, "leaf_load": 0.1, "grip_force": 1.0}
"""What it costs, in flowers lost for each flower of the plant, if the organ that is loaded most stays bent, or the grip
slips. A judgement: a stem's bend costs the plant and its next trusses, a petiole's a leaf, a slip this visit."""
EXPONENT = 1.5
"""n of the share of pollen freed, a^n / (a^n + half^n): between 1 and 2 (facts: pollination 6)."""
PROBIT = 1.702
"""A logistic curve is this much steeper than the normal distribution that is nearest to it (Camilli 1994)."""
GRIP = Believed(1.0, 0.25)
"""Of the friction that pads have over that which a planner counts with: median and spread of ln, a guess."""

BANDS = np.array([6.0, 17.0, 28.0, 70.0])
"""Middles of 1-14, 14-20, 20-40 and 40-120 Hz, between which errors go as the logarithm of the frequency does [Hz]."""
Errors = Mapping[str, tuple[tuple[float, ...], tuple[float, ...]]]
ERRORS: Errors = {
    "flowers": ((-0.06, -0.28, -0.57, -0.44), (0.45, 0.59, 0.70, 0.77)),
    "base_strain": ((-0.13, 0.45, 0.52, -0.41), (0.54, 0.38, 0.32, 0.39)),
    "stem_strain": ((-0.05, -0.01, -0.16, -0.53), (0.54, 0.43, 0.29, 0.29)),
    "leaf_load": ((0.09, 0.27, 0.48, -0.20), (0.42, 0.44, 0.60, 0.84)),
    "grip_force": ((-0.69,) * 4, (0.55,) * 4),
}
"""ln of true over modelled, beside what members explain: mean and standard deviation in each of the `BANDS`.

Fitted by likelihood to 20 simulated plants whose truth no stage believes, four grips each, and checked on plants that
were kept back: `python -m evaluation.prediction.belief`. Of the grip's force: 20 plants, 1-15 Hz."""
OBSERVED_ERRORS: Errors = {
    "flowers": ((0.14, -0.04, -0.11, -0.29), (0.42, 0.76, 0.57, 0.76)),
    "base_strain": ((0.01, 0.79, 0.75, -0.22), (0.78, 0.49, 0.46, 0.49)),
    "stem_strain": ((0.02, 0.09, -0.02, -0.42), (0.50, 0.44, 0.35, 0.32)),
    "leaf_load": ((0.39, 0.72, 0.87, -0.08), (0.42, 0.54, 0.71, 0.86)),
    "grip_force": ((-0.69,) * 4, (0.55,) * 4),
}
"""The same once a camera has seen this shake at a small amplitude, of all that was not measured itself."""
MEASURED_ERROR = ((0.25, 0.35, -0.3, -0.5), (0.5, 0.5, 0.7, 0.8))
"""The same of a flower whose swing was measured: 32 flowers of nine trials in the simulated cell, films and all;
checked on others by `evaluation.trials.shaking`."""


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
        lost: expected share of flowers whose pedicels stay bent (`LOST_AT`).
        bent: kind of `COSTS` -> probability that the organ that is loaded most stays bent; of the grip, that it slips.
        net: what the shake is worth.
    """

    gain: Array
    lost: Array
    bent: Mapping[str, Array]
    net: Array

    @property
    def others(self) -> Array:
        """What organs that stay bent and slip cost, in flowers lost for each flower."""
        return np.sum([cost * self.bent[kind] for kind, cost in COSTS.items()], axis=0)


@dataclass(frozen=True, slots=True, eq=False)
class Weighed(Record):
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


def error(kind: str, hertz: ArrayLike, measured: bool | None = None) -> tuple[Array, Array]:
    """Return mean and standard deviation of ln of true over modelled, of the shape of the frequencies [Hz].

    Args:
        kind: of `Answer`.
        hertz: frequencies.
        measured: whether a camera that observed this shake measured this flower; of other kinds either will do. None:
            nothing was observed.
    """
    table = (ERRORS if measured is None else OBSERVED_ERRORS)[kind]
    rows = MEASURED_ERROR if measured and kind == "flowers" else table
    at = np.log(np.asarray(hertz, dtype=np.float64))
    mean, spread = (np.interp(at, np.log(BANDS), row) for row in rows)
    return np.asarray(mean), np.asarray(spread)


def expected(kind: str, values: Array, hertz: ArrayLike, measured: bool | None = None) -> Array:
    """Return the median (...) of what is expected of a load of which members have values (M, ...); see `error`."""
    return np.exp(np.log(np.maximum(values, 1e-12)).mean(axis=0) + error(kind, hertz, measured)[0])


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

    def off(kind: str, known: bool | None) -> tuple[Array, Array]:
        mean, spread = error(kind, hertz, known)
        return mean + delivered[0], np.hypot(spread, delivered[1])

    gain, lost = np.zeros(size.shape), np.zeros(size.shape)
    count, observed = answer.flowers.shape[-1], None if measured is None else False
    for f in range(count):
        wrong = off("flowers", None if measured is None else bool(measured[f]))
        gain += _mean(answer.flowers[..., f], size, wrong, _freed) / count
        lost += _mean(answer.flowers[..., f], size, wrong, _passed(LOST_AT)) / count
    bent = {
        kind: _mean(getattr(answer, kind), size, off(kind, observed), _passed(TOLERANCE[organ]))
        for kind, organ in (("base_strain", "base"), ("stem_strain", "stem"), ("leaf_load", "leaf"))
    }
    bent["leaf_load"] = np.where(hertz > GUSTS, 0.0, bent["leaf_load"])
    share = answer.grip_force / np.asarray(held)
    bent["grip_force"] = _mean(share, size, off("grip_force", observed), _passed(GRIP))
    costs = lost + sum(cost * bent[kind] for kind, cost in COSTS.items())
    return Worth(gain, lost, bent, (1 - bent["grip_force"]) * gain - price * costs)


def _mean(values: Array, size: Array, wrong: tuple[Array, Array], curve: Curve) -> Array:
    """Return (A, ...) the mean over members of a curve of ln of value times amplitude, and of its spread."""
    mean, spread = wrong
    total = np.zeros(size.shape)
    for member in values:
        total += curve(np.log(np.maximum(member, 1e-12)) + size + mean, spread)
    return total / len(values)


def _freed(logs: Array, spread: Array) -> Array:
    """Return the share of pollen that is freed at accelerations of which ln has this mean and spread."""
    width = np.sqrt((PROBIT / EXPONENT) ** 2 + HALF_DOSE.spread**2 + spread**2)
    return ndtr((logs - np.log(HALF_DOSE.median)) / width)


def _passed(borne: Believed) -> Curve:
    """Return the curve of the probability that a load passes what is borne."""
    return lambda logs, spread: ndtr((logs - np.log(borne.median)) / np.hypot(borne.spread, spread))


def weighed(answer: Answer, amplitude: Array, *how: Any, **more: Any) -> Weighed:
    """Return what one shake is worth at amplitudes (S,); arguments as of `worth`."""
    found = worth(answer, amplitude, *how, **more)
    alone = [
        worth(Answer(*(part[m : m + 1] for part in answer)), amplitude, *how, **more).net
        for m in range(len(answer.flowers))
    ]
    return Weighed(
        amplitude, found.gain, found.lost, found.others, found.net, np.quantile(alone, [0.05, 0.95], axis=0).T
    )
