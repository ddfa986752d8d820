"""What is believed of a plant before it is shaken: its own last belief, else what other plants taught (P24).

All beliefs are normal in the logarithm of a quantity: mean ln value, standard deviation its spread.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from anther.checks import check_array, check_range
from anther.geometry import Array
from anther.plant import LEARNED, PEPPER, TOMATO, Material
from anther.store.database import DEFAULT
from anther.store.records import TrialRecord
from anther.store.trials import read_trials
from anther.vibration import SINE, EarlierShake

CROPS = {"tomato": TOMATO, "pepper": PEPPER}
"""What is believed of a crop before any plant of it was measured; each says its sources."""

BETWEEN = 0.5
"""Share of the facts' variance that is taken to lie between plants of one crop, the rest being ignorance of the crop's
mean. An estimate of ours: no study of the spread between plants was found (facts: pollination, "Not found")."""

WORTH = 4.0
"""Plants that the facts' spread between plants is worth (degrees of freedom). An estimate of ours: few."""

LEAST = 0.05
"""A trial teaches a quantity if it adds this share of the precision there was; less is noise of the ensemble [-]."""


@dataclass(frozen=True, slots=True)
class Belief:
    """What is believed of one plant, and why.

    Attributes:
        material: the belief.
        source: "plant": its own last trial; "crop": learned from others; "facts": nothing was learned yet.
        plants: plants that it was learned from.
        reason: the same for people.
    """

    material: Material
    source: str
    plants: int
    reason: str


def facts_prior(species: str) -> Material:
    """Return what the facts say of a crop; the tomato's for a crop without facts."""
    return CROPS.get(species, TOMATO)


def starting_material(species: str, plant: str, where: Path | str = DEFAULT) -> Belief:
    """Return what to believe of a plant before its next shake.

    Only trials that succeeded teach: of a plant held by a leaf, say, the model that learned was wrong. A plant that was
    shaken, and whose flowers taught something, has its last belief, but for the gain, which is the crop's: what a
    plant's flowers do beyond the model at one frequency says little a fifth away from it, and nothing two fifths away
    (correlations 0.35 and 0.05, docs/learning.md). The belief is not widened with time: no rate at which stems stiffen
    was found (facts: pollination, "Not found"); the reason says how old it is. Another plant has the crop's prior,
    learned from all plants of the crop in the history (`crop_prior`), which is the facts' prior as long as nothing was
    learned.

    Raises:
        InputError: the history cannot be read.
    """
    trials = [t for t in read_trials(where, species=species, result="success") if t.taught]
    own = [t for t in trials if t.plant == plant]
    facts, trials = facts_prior(species), [t for t in trials if t.believed is not None]
    crop, count = crop_prior(trials, facts), len({t.plant for t in trials})
    if own and own[-1].material is not None:
        last = own[-1]
        reason = f"{plant}'s own, learned in {_count(len(own), 'trial')}, the last on {last.time:%Y-%m-%d %H:%M} UTC"
        material = own[-1].material.changed(response_gain=crop.response_gain, response_spread=crop.response_spread)
        return Belief(material, "plant", 1, f"{reason} (visit {last.id})")
    if not count:
        known = species if species in CROPS else f"{species}, taken as tomato's: nothing is known of it"
        return Belief(facts, "facts", 0, f"the facts' prior of {known}; no plant has taught anything yet")
    return Belief(crop, "crop", count, f"learned from {_count(count, f'other {species} plant')}")


def earlier_shake(species: str, plant: str, where: Path | str = DEFAULT) -> EarlierShake | None:
    """Return the last shake of a plant that succeeded and whose flowers were measured; None if there is none.

    Raises:
        InputError: the history cannot be read.
    """
    for trial in reversed(read_trials(where, species=species, plant=plant, result="success")):
        grasp, shake = trial.grasp, trial.shake
        if not trial.measured or grasp is None or shake is None:
            continue
        if grasp.arc_length is not None and shake.direction is not None and shake.waveform == str(SINE):
            return EarlierShake(grasp.arc_length, np.array(shake.direction), shake.frequency, shake.amplitude)
    return None


def crop_prior(trials: Sequence[TrialRecord], facts: Material) -> Material:
    """Return what to believe of a new plant of the crop, from the trials of others.

    What one trial says of a quantity, apart from what was believed before it, is the quotient of the normal belief
    after and the one before: precision d = 1/s_after^2 - 1/s_before^2 and mean y = (m_after/s_after^2 -
    m_before/s_before^2)/d. Without this division the prior would be counted once a plant. Trials of one plant are
    combined (precisions add), and the plants by `hierarchical_normal`. A trial whose belief before it was not kept
    (histories of version 0) is left out.

    Args:
        trials: of one crop, each with the material learned.
        facts: the crop's prior before any of them.
    """
    learned = {}
    for value, spread in LEARNED.items():
        plants: dict[str, list[tuple[float, float]]] = {}
        for trial in trials:
            if trial.material is not None and trial.believed is not None:
                told = _evidence(trial.believed, trial.material, value, spread)
                plants.setdefault(trial.plant, []).extend([] if told is None else [told])
        pooled = np.array([_pooled(told) for told in plants.values() if told])
        if len(pooled):
            centre = float(np.log(getattr(facts, value)))
            mean, deviation = hierarchical_normal(pooled[:, 0], pooled[:, 1], centre, getattr(facts, spread))
            learned |= {value: float(np.exp(mean)), spread: deviation}
    return facts.changed(**learned)


def hierarchical_normal(measured: Array, error: Array, centre: float, spread: float) -> tuple[float, float]:
    """Return mean and standard deviation of the next plant's quantity, given what others' measurements say.

    The hierarchical normal model of Gelman et al., Bayesian Data Analysis, 3rd ed., section 5.4:
    y_i ~ N(theta_i, v_i^2), theta_i ~ N(mu, tau^2), for plants i. The facts' prior N(centre, spread^2) of any one plant
    is shared out: mu ~ N(centre, (1 - b) spread^2), and tau^2 ~ scaled inverse chi^2 with `WORTH` degrees of freedom
    and mean b spread^2, b = `BETWEEN`. tau is summed over a grid, weighted by the marginal likelihood
    prod N(y_i | mu, v_i^2 + tau^2) integrated over mu (their equation 5.21, with a proper prior of mu); for each tau,
    mu is normal (5.20). The next plant's mean is that of mu and its variance the mean of Var(mu) + tau^2 plus the
    variance of the means. With no plants this is the facts' prior; with many, mean and spread of the plants.

    Args:
        measured: (P,) y, one a plant.
        error: (P,) v > 0.
        centre, spread: the facts' prior.

    Raises:
        InputError: other than one positive error a plant.
    """
    y = check_array("measured", measured, (None,))
    v = check_array("error", error, (len(y),))
    check_range("smallest error", float(v.min(initial=1.0)), 1e-9, 1e9)
    if not len(y) or spread == 0:
        return centre, spread
    prior_mu, prior_tau = (1 - BETWEEN) * spread**2, BETWEEN * spread**2
    tau2 = np.geomspace(1e-3, 1e2, 400) * prior_tau
    scale = prior_tau * (WORTH - 2) / WORTH
    log_weight = -0.5 * WORTH * np.log(tau2) - 0.5 * WORTH * scale / tau2  # density in ln tau2, as the grid is
    total = v**2 + tau2[:, None]
    precision = 1 / prior_mu + np.sum(1 / total, axis=1)
    mu = (centre / prior_mu + np.sum(y / total, axis=1)) / precision
    log_weight += -0.5 * np.sum(np.log(total) + (y - mu[:, None]) ** 2 / total, axis=1)
    log_weight += -0.5 * np.log(precision) - 0.5 * (mu - centre) ** 2 / prior_mu
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    mean = float(weight @ mu)
    return mean, float(np.sqrt(weight @ (1 / precision + tau2 + (mu - mean) ** 2)))


def _evidence(before: Material, after: Material, value: str, spread: str) -> tuple[float, float] | None:
    """Return (mean, precision) of what the trial itself says of ln value; None where it says nothing."""
    old, new = getattr(before, spread), getattr(after, spread)
    if new <= 0 or old <= 0 or 1 / new**2 < (1 + LEAST) / old**2:
        return None
    precision = 1 / new**2 - 1 / old**2
    mean = (np.log(getattr(after, value)) / new**2 - np.log(getattr(before, value)) / old**2) / precision
    return float(mean), float(precision)


def _pooled(told: list[tuple[float, float]]) -> tuple[float, float]:
    """Return (mean, standard deviation) of one plant's trials together."""
    precision = sum(p for _, p in told)
    return sum(mean * p for mean, p in told) / precision, precision**-0.5


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
