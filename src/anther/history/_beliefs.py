"""What is believed of a plant before it is shaken: its own last belief, else what other plants taught (P24).

All beliefs are normal in the logarithm of a quantity: mean ln value, standard deviation its spread.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import exists, func, select
from sqlalchemy.orm import Session

from anther.checks import check_array, check_range
from anther.geometry import Array
from anther.history._database import DEFAULT, Grasp, Plant, Response, Shake, Visit, reading
from anther.history._records import Sums, TrialRecord, material_of, summed, told
from anther.plant import LEARNED, PEPPER, TOMATO, Material
from anther.shake import EarlierShake

CROPS = {"tomato": TOMATO, "pepper": PEPPER}
"""What is believed of a crop before any plant of it was measured; each says its sources."""

BETWEEN = 0.5
"""Share of the facts' variance that is taken to lie between plants of one crop, the rest being ignorance of the crop's
mean. An estimate of ours: no study of the spread between plants was found (facts: pollination, "Not found")."""

WORTH = 4.0
"""Plants that the facts' spread between plants is worth (degrees of freedom). An estimate of ours: few."""

MOST_PLANTS = 200
"""A crop's prior is learned from the plants that taught last, at most so many: with 200 the error of their mean adds
0.3 % to the spread of the next plant, and reading them takes milliseconds however long the history is."""


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
    (correlations 0.35 and 0.05, docs/reports/learning.md). Last is what the robots' clocks say is last. The belief is
    not widened with time: no rate at which stems stiffen was found (facts: pollination, "Not found"); the reason says
    how old it is. Another plant has the crop's prior, learned from the `MOST_PLANTS` plants that taught last
    (`crop_prior`), which is the facts' prior as long as nothing was learned.

    Raises:
        InputError: the history cannot be read.
    """
    facts = facts_prior(species)
    with reading(where) as session:
        own, count = (None, 0) if session is None else _own(session, species, plant)
        others = [] if session is None else _taught(session, species)
    crop = _prior(others, facts)
    if own is not None and own.material_after is not None:
        reason = f"{plant}'s own, learned in {_count(count, 'trial')}, the last on {own.time:%Y-%m-%d %H:%M} UTC"
        last = material_of(own.material_after) or facts
        material = last.changed(response_gain=crop.response_gain, response_spread=crop.response_spread)
        return Belief(material, "plant", 1, f"{reason} (visit {own.id})")
    if not others:
        known = species if species in CROPS else f"{species}, taken as tomato's: nothing is known of it"
        return Belief(facts, "facts", 0, f"the facts' prior of {known}; no plant has taught anything yet")
    return Belief(crop, "crop", len(others), f"learned from {_count(len(others), f'other {species} plant')}")


def earlier_shake(species: str, plant: str, where: Path | str = DEFAULT) -> EarlierShake | None:
    """Return the last shake of a plant that succeeded and whose flowers were measured; None if there is none.

    Raises:
        InputError: the history cannot be read.
    """
    query = _visits_of(select(Grasp.arc_length_m, Shake), species, plant)
    query = query.join(Grasp, Grasp.visit_id == Visit.id).join(Shake, Shake.visit_id == Visit.id)
    query = query.where(
        Grasp.arc_length_m.is_not(None),
        Shake.direction.is_not(None),
        Shake.waveform == "sine",
        exists().where(Response.visit_id == Visit.id, Response.measured_amplitude_m.is_not(None)),
    )
    with reading(where) as session:
        found: Any = None if session is None else session.execute(query.limit(1)).first()
        if found is None:
            return None
        height, shake = found
        direction = check_array("shake direction", shake.direction, (3,))
        return EarlierShake(height, direction, shake.frequency_hz, shake.amplitude_m)


def _visits_of(query: Any, species: str, plant: str) -> Any:
    """Ask a query of the successful visits to a plant, the last one first."""
    number = select(Plant.id).where(Plant.species == species, Plant.label == plant).scalar_subquery()
    query = query.select_from(Visit).where(Visit.plant_id == number, Visit.success)
    return query.order_by(Visit.time.desc(), Visit.id.desc())


def _own(session: Session, species: str, plant: str) -> tuple[Any, int]:
    """Return the last visit that taught something of the plant itself, or None, and how many did."""
    number = func.count().over()
    query = _visits_of(select(Visit.id, Visit.time, Visit.material_after, number), species, plant).where(Visit.taught)
    found: Any = session.execute(query.limit(1)).first()
    return (None, 0) if found is None else (found, found[3])


def _taught(session: Session, species: str) -> list[Sums]:
    """Return what each of the plants of the crop that taught last did teach."""
    query = select(Plant.learned).where(Plant.species == species, Plant.taught.is_not(None))
    return list(session.scalars(query.order_by(Plant.taught.desc()).limit(MOST_PLANTS)))


def crop_prior(trials: Sequence[TrialRecord], facts: Material) -> Material:
    """Return what to believe of a new plant of the crop, from the trials of others.

    Trials of one plant are combined (`evidence`), and the plants by `hierarchical_normal`. A trial whose belief before
    it was not kept is left out.

    Args:
        trials: of one crop, each with the material learned.
        facts: the crop's prior before any of them.
    """
    plants: dict[str, list[Sums]] = {}
    for trial in trials:
        if trial.material is not None and trial.believed is not None:
            plants.setdefault(trial.plant, []).append(told(trial.believed, trial.material))
    return _prior([summed(parts) for parts in plants.values()], facts)


def _prior(plants: Sequence[Sums], facts: Material) -> Material:
    learned = {}
    for value, spread in LEARNED.items():
        sums = np.array([plant[value] for plant in plants if value in plant])
        if len(sums):
            centre = float(np.log(getattr(facts, value)))
            precision, weighted = sums.T
            mean, deviation = hierarchical_normal(weighted / precision, precision**-0.5, centre, getattr(facts, spread))
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


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
