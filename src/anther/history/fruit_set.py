"""Fruit set: what the counts of growers teach of how many flowers set for the shake they were given. O counts.

P(set) = p0 + (1 - p0) g R: p0 sets without a shake; of the rest, a share g sets when all pollen is freed; R is the
share that is freed, `pollen_dose`, each visit freeing its share of what the earlier ones left:
R = 1 - prod over visits (1 - mean over flowers of a^n / (a^n + half^n)). No curve of pollen over acceleration was ever
measured for a shaken tomato or pepper flower (facts: pollination 6), so half and n are believed in a range, and no
choice of a shake depends on them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from typing import TYPE_CHECKING, Annotated

import numpy as np
from scipy.special import expit, gammaln, logit

from anther.core.checks import check_array, check_range
from anther.core.geometry import Array
from anther.core.records import Range, Record

if TYPE_CHECKING:  # the database's library takes half a second
    from anther.history import Outcome
    from anther.plant.visit import Visit

NAMES = ("unshaken", "gain", "half_dose", "likeness", "exponent")
EXPONENTS = np.array([1.0, 1.5, 2.0])
"""n, each as likely before any count (facts: pollination 6: 1 to 2)."""


def pollen_dose(acceleration: Array | float, half: Array | float, exponent: Array | float) -> Array:
    """Return the share of its pollen that a flower frees in one shake, a^n / (a^n + half^n).

    A model of ours that follows what is known: bee buzzes of 200-490 m/s2 free it well (facts: pollination 1b); wind
    sets much of a field's fruit (facts: pollination 6, which judges that half lies at 20 m/s2, 5 to 80);
    more vibration helps less and less (rsif.2024.0526), one to two visits saturate (Morandin 2001), and from 1 to 5 s
    the duration hardly matters (Ilbi & Boztok 1994), so it is left out.

    Args:
        acceleration: peak of the flower [m/s2].
        half: acceleration that frees half [m/s2].
        exponent: n.
    """
    power = (np.asarray(acceleration) / half) ** exponent
    return power / (power + 1)


@dataclass(frozen=True, slots=True)
class Prior:
    """What is believed before any count: normal, (mean, standard deviation) each.

    Attributes:
        unshaken: logit of p0. Greenhouse tomatoes without bees or vibration set 30.2 % (Morandin 2001, no bruise)
            and 65.7 % (Al-Attal 2003); bagged habanero 25 % (facts: pollination 1c).
        gain: logit of g. (set - p0) / (1 - p0) was 0.73-1 with bumblebees and 0.32 with a vibrator on tomato, 0.72 for
            one visit on habanero (the same sources).
        half_dose: ln of the acceleration that frees half of the pollen [m/s2]: 20, with 5 and 80 m/s2 at
            5 and 95 % (facts: pollination 6).
        likeness: logit of the intraclass correlation of flowers counted together: they share weather, vigour and load,
            so that ten of one plant tell less than ten of ten plants. An estimate of ours; no source found.
    """

    unshaken: tuple[float, float] = (-0.1, 0.8)
    gain: tuple[float, float] = (1.1, 1.3)
    half_dose: tuple[float, float] = (float(np.log(20.0)), 0.84)
    likeness: tuple[float, float] = (float(logit(0.1)), 1.0)


PRIORS = {"tomato": Prior(), "pepper": Prior(unshaken=(-0.3, 1.0), gain=(0.0, 1.5))}
"""Pepper: shaken wires changed nothing on three C. annuum cultivars (Freitas 2015), a hand-held pollinator and bees did
(Zia-ul-Haq 2019, Shipp 1994), so its gain may be anything. Another crop begins with pepper's, the wider."""


@dataclass(frozen=True, slots=True)
class Count(Record):
    """One count of fruit set with the shakes that came before it.

    Attributes:
        flowers, fruit: counted.
        shakes: peak accelerations (F,) [m/s2] of the flowers in each visit; none for a control.
    """

    flowers: Annotated[int, Range(1, 100_000)]
    fruit: int
    shakes: tuple[Array, ...] = ()

    def _check(self) -> None:
        check_range("fruit", self.fruit, 0, self.flowers)
        checked = tuple(check_array("flower accelerations", a, (None,)) for a in self.shakes)
        for a in checked:
            check_range("smallest flower acceleration", float(a.min(initial=np.inf)), 0, 1e6, "m/s2")
        object.__setattr__(self, "shakes", checked)


@dataclass(frozen=True, slots=True, eq=False)
class FruitSet:
    """The dose-response as it is believed: K weighted points (p0, g, half dose, likeness, n) of a posterior.

    Attributes:
        points: (K, 5) [-, -, m/s2, -, -], in the order of `NAMES`.
        weights: (K,), sum 1.
        counts: what it was learned from.
        prior: what it began with.
    """

    points: Array
    weights: Array
    counts: tuple[Count, ...]
    prior: Prior

    def interval(self, name: str) -> tuple[float, float, float]:
        """Return median, 5 % and 95 % of one of `NAMES`."""
        return _quantiles(self.points[:, NAMES.index(name)], self.weights)

    def probability(self, acceleration: float | Array) -> tuple[float, float, float]:
        """Return median, 5 % and 95 % of P(set) after one visit.

        It is of an average plant; a single one varies by `likeness` more.

        Args:
            acceleration: peak, of all flowers or (F,) of each [m/s2]; of these the mean is returned.
        """
        return _quantiles(self.points[:, 0] + self._added(acceleration), self.weights)

    def added(self, acceleration: float | Array) -> tuple[float, float, float]:
        """Return median, 5 % and 95 % of what such a visit adds to P(set); see `probability`."""
        return _quantiles(self._added(acceleration), self.weights)

    def _added(self, acceleration: float | Array) -> Array:
        unshaken, gain, half, _, exponent = self.points.T
        freed = np.zeros(len(half))
        felt = np.atleast_1d(np.asarray(acceleration, dtype=float))
        for one in felt:
            freed += pollen_dose(check_range("acceleration", float(one), 0, 1e6, "m/s2"), half, exponent) / len(felt)
        return (1 - unshaken) * gain * freed

    def learned(self, name: str) -> float:
        """Return by which share the counts narrowed one of `NAMES[:4]`, on the scale of its prior: 0 is nothing."""
        column = NAMES.index(name)
        values = (np.log if name == "half_dose" else logit)(self.points[:, column])
        deviation = np.sqrt(self.weights @ (values - self.weights @ values) ** 2)
        return float(max(0.0, 1 - deviation / getattr(self.prior, name)[1]))

    def freed(self, count: Count) -> float:
        """Return the share of pollen that the visits before a count freed, as believed (mean)."""
        return float(self.weights @ _freed(count, self.points[:, 2], self.points[:, 4]))

    def caveats(self) -> tuple[str, ...]:
        """Return what this cannot know, in sentences for people."""
        if not self.counts:
            return ("No count was recorded: this is the prior, from the literature, and nothing of your plants.",)
        notes = []
        if not any(self.freed(c) < 0.02 for c in self.counts):
            notes.append(
                "No plant was counted that had no shake: what sets by itself and what the shake adds are told apart by"
                " the literature only. Leave some plants out and count them (anther history outcome LABEL --control)."
            )
        most = max(self.freed(c) for c in self.counts)
        if most < 0.5:
            notes.append(
                f"No plant's visits freed more than about {most:.0%} of the pollen: what stronger shakes would give is"
                " extrapolated."
            )
        dull = [name.replace("_", " ") for name in NAMES[:3] if self.learned(name) < 0.2]
        if dull:
            notes.append(f"Hardly anything was learned of: {', '.join(dull)}; there the prior speaks.")
        return tuple(notes)


def fit(counts: Sequence[Count], prior: Prior = PRIORS["tomato"], shape: Sequence[int] = (17, 17, 23, 13)) -> FruitSet:
    """Return the posterior of the dose-response.

    A count is beta-binomial with mean P(set) (module's docstring) and intraclass correlation `likeness`, so that many
    flowers of one plant are not taken for many plants. The posterior is summed over `EXPONENTS` and a grid of the other
    four on their priors' scales, after three rounds on a coarser one, each zooming to 4.5 standard deviations about the
    mean; no approximation by a normal, since few counts give skewed and ridged posteriors.

    Args:
        counts: of one crop.
        prior: of the crop.
        shape: points of that grid along each of the first of `NAMES`.
    """
    priors = np.array([getattr(prior, name) for name in NAMES[:4]])
    low, high = priors[:, 0] - 4 * priors[:, 1], priors[:, 0] + 4 * priors[:, 1]
    for _ in range(3):
        mean, deviation = _marginals(*_posterior(counts, priors, low, high, [n // 2 + 1 for n in shape]))
        low, high = np.maximum(low, mean - 4.5 * deviation), np.minimum(high, mean + 4.5 * deviation)
    axes, weights = _posterior(counts, priors, low, high, shape)
    grid = np.stack([g.ravel() for g in np.meshgrid(*axes, EXPONENTS, indexing="ij")], axis=1)
    flat = weights.ravel()
    kept = flat > 1e-7 * flat.max()
    cells = np.random.default_rng(0).uniform(-0.5, 0.5, (int(kept.sum()), len(axes)))  # a point stands for its cell
    points, exponent = grid[kept, :4] + cells * [axis[1] - axis[0] for axis in axes], grid[kept, 4]
    ways = (expit, expit, np.exp, expit)
    values = np.stack([*(way(column) for way, column in zip(ways, points.T, strict=True)), exponent], axis=1)
    return FruitSet(values, flat[kept] / flat[kept].sum(), tuple(counts), prior)


def worth(felt: Array, crop: str) -> str:
    """Return in a sentence what one visit is worth before any count: a wide range, since little is known.

    Args:
        felt: (F,) peak acceleration of each flower [m/s2]; NaN where it is not known, which counts as the others' mean.
        crop: of `PRIORS`; another is taken as pepper.
    """
    known = felt[np.isfinite(felt)]
    if not len(known):
        return ""
    belief = fit([], PRIORS.get(crop, PRIORS["pepper"]))
    alone, more = belief.interval("unshaken"), belief.added(known)
    of = [f"{len(felt) * m:.1f} ({len(felt) * low:.1f} to {len(felt) * high:.1f})" for m, low, high in (alone, more)]
    return (
        f"Of {len(felt)} flowers {of[0]} set without a shake, and this one adds {of[1]}: nine in ten, by all that is "
        "known of what a shake frees."
    )


def counts_of(trials: Sequence[Visit], outcomes: Sequence[Outcome]) -> tuple[list[Count], list[str]]:
    """Return the counts of one crop with the shakes before them, and what had to be left out, in sentences.

    A flower's acceleration is the measured one, else the predicted. A visit whose shake never began gave nothing; one
    that failed and was not measured may have given anything, and a count after it is left out.
    """
    counts, lost = [], 0
    for outcome in outcomes:
        shakes = [t.accelerations() for t in _visits_of(outcome, trials, outcomes) if t.shake is not None]
        known = [a for a in shakes if a is not None]
        if len(known) == len(shakes):
            counts.append(Count(outcome.flowers, outcome.fruit, tuple(known)))
        lost += len(known) < len(shakes)
    why = "left out, because the flowers' motion in a visit before them is not known"
    return counts, [f"{lost} of {len(outcomes)} counts {why}."] if lost else []


def _visits_of(outcome: Outcome, trials: Sequence[Visit], outcomes: Sequence[Outcome]) -> list[Visit]:
    if outcome.visit is not None:
        return [t for t in trials if t.id == outcome.visit]
    others = [o for o in outcomes if (o.species, o.plant, o.visit) == (outcome.species, outcome.plant, None)]
    previous = max((o.date for o in others if o.date < outcome.date), default=date.min)
    mine = [t for t in trials if (t.species, t.plant) == (outcome.species, outcome.plant)]
    return [t for t in mine if previous < t.time.date() <= outcome.date]


def _freed(count: Count, half: Array, exponent: Array) -> Array:
    """Return the share of pollen freed before a count, for each half dose and exponent."""
    half, exponent = np.broadcast_arrays(half, exponent)
    kept = np.ones(half.shape)
    for accelerations in count.shakes:
        kept *= 1 - np.mean([pollen_dose(a, half, exponent) for a in accelerations], axis=0)
    return 1 - kept


def _posterior(
    counts: Sequence[Count], priors: Array, low: Array, high: Array, sizes: Sequence[int]
) -> tuple[list[Array], Array]:
    """Return axes between low and high (4,), and the posterior's weights on their grid and `EXPONENTS`, sum 1."""
    axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, sizes, strict=True)]
    log_posterior = _log_prior(axes, priors) + _log_likelihood(counts, axes)
    weights = np.exp(log_posterior - log_posterior.max())
    return axes, weights / weights.sum()


def _log_prior(axes: Sequence[Array], priors: Array) -> Array:
    each = [-0.5 * ((axis - mean) / deviation) ** 2 for axis, (mean, deviation) in zip(axes, priors, strict=True)]
    return (each[0][:, None, None, None] + each[1][:, None, None] + each[2][:, None] + each[3])[..., None]


def _log_likelihood(counts: Sequence[Count], axes: Sequence[Array]) -> Array:
    """Return beta-binomial log-likelihoods over the grid of the axes and `EXPONENTS`, up to a constant."""
    unshaken, gain = expit(axes[0])[:, None, None, None, None], expit(axes[1])[:, None, None, None]
    size = (1 / expit(axes[3]) - 1)[:, None]  # alpha + beta
    total = np.zeros([len(axis) for axis in (*axes, EXPONENTS)])
    for count in counts:
        freed = _freed(count, np.exp(axes[2])[:, None], EXPONENTS)[:, None]
        p = np.clip(unshaken + (1 - unshaken) * gain * freed, 1e-12, 1 - 1e-12)
        a, b, n, m = p * size, (1 - p) * size, count.flowers, count.fruit
        total += gammaln(a + m) - gammaln(a) + gammaln(b + n - m) - gammaln(b) - gammaln(size + n) + gammaln(size)
    return total


def _marginals(axes: Sequence[Array], weights: Array) -> tuple[Array, Array]:
    """Return mean and standard deviation along each axis, the latter at least half a step."""
    means, deviations = [], []
    for k, axis in enumerate(axes):
        marginal = weights.sum(axis=tuple(i for i in range(weights.ndim) if i != k))
        means.append(marginal @ axis)
        deviations.append(max(np.sqrt(marginal @ (axis - means[-1]) ** 2), 0.5 * (axis[1] - axis[0])))
    return np.array(means), np.array(deviations)


def _quantiles(values: Array, weights: Array) -> tuple[float, float, float]:
    order = np.argsort(values)
    below = np.cumsum(weights[order]) - 0.5 * weights[order]
    median, low, high = np.interp([0.5, 0.05, 0.95], below, values[order])
    return float(median), float(low), float(high)
