"""What is believed of a plant before it is shaken: its own last belief, else the facts (P24)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import exists, func, select
from sqlalchemy.orm import Session

from anther.core.checks import check_array
from anther.history._database import DEFAULT, open_reader
from anther.history._records import material_of
from anther.history._tables import GraspRow, Plant, ResponseRow, ShakeRow, VisitRow
from anther.plant.belief import EarlierShake
from anther.plant.model import PRIORS, TOMATO, Material


@dataclass(frozen=True, slots=True)
class Belief:
    """What is believed of one plant, and why.

    Attributes:
        material: the belief.
        source: "plant": its own last trial; "facts": it has taught nothing yet.
        reason: the same for people.
    """

    material: Material
    source: str
    reason: str


def starting_material(species: str, plant: str, where: Path | str = DEFAULT) -> Belief:
    """Return what to believe of a plant before its next shake.

    Only trials that succeeded teach: of a plant held by a leaf, say, the model that learned was wrong. A plant that was
    shaken, and whose flowers taught something, has its last belief, but for the gain, which is the facts': what a
    plant's flowers do beyond the model at one frequency says little a fifth away from it, and nothing two fifths away
    (correlations 0.35 and 0.05, docs/reports/response.md). Last is what the robots' clocks say is last. The
    belief is not widened with time: no rate at which stems stiffen was found (facts: pollination, "Not found"); the
    reason says how old it is. Another plant has the facts' prior, the tomato's for a crop without facts.
    """
    facts = next((prior for crop, prior in PRIORS.items() if crop == species), TOMATO)
    with open_reader(where) as session:
        own, count = (None, 0) if session is None else _own(session, species, plant)
    if own is None or own.material is None:
        known = species if species in PRIORS else f"{species}, taken as tomato's: nothing is known of it"
        return Belief(facts, "facts", f"the facts' prior of {known}; nothing was learned of this plant yet")
    reason = f"{plant}'s own, learned in {_count(count, 'trial')}, the last on {own.time:%Y-%m-%d %H:%M} UTC"
    last = material_of(own.material) or facts
    material = last.changed(response_gain=facts.response_gain, response_spread=facts.response_spread)
    return Belief(material, "plant", f"{reason} (visit {own.id})")


def earlier_shake(species: str, plant: str, where: Path | str = DEFAULT) -> EarlierShake | None:
    """Return the last shake of a plant that succeeded and was seen to move flowers; None if there is none."""
    query = _visits_of(select(GraspRow.arc_length, ShakeRow), species, plant)
    query = query.join(GraspRow, GraspRow.visit_id == VisitRow.id).join(ShakeRow, ShakeRow.visit_id == VisitRow.id)
    query = query.where(
        GraspRow.arc_length.is_not(None),
        ShakeRow.direction.is_not(None),
        ShakeRow.waveform == "sine",
        exists().where(ResponseRow.visit_id == VisitRow.id, ResponseRow.measured_acceleration > 0),
    )
    with open_reader(where) as session:
        found: Any = None if session is None else session.execute(query.limit(1)).first()
        if found is None:
            return None
        height, shake = found
        direction = check_array("shake direction", shake.direction, (3,))
        return EarlierShake(height, direction, shake.frequency, shake.amplitude)


def _visits_of(query: Any, species: str, plant: str) -> Any:
    """Ask a query of the visits that held a plant and did not harm it, the last one first."""
    number = select(Plant.id).where(Plant.species == species, Plant.label == plant).scalar_subquery()
    query = query.select_from(VisitRow).where(VisitRow.plant_id == number, VisitRow.held_unharmed)
    return query.order_by(VisitRow.time.desc(), VisitRow.id.desc())


def _own(session: Session, species: str, plant: str) -> tuple[Any, int]:
    """Return the last visit that taught something of the plant itself, or None, and how many did."""
    number = func.count().over()
    query = _visits_of(select(VisitRow.id, VisitRow.time, VisitRow.material, number), species, plant).where(
        VisitRow.taught
    )
    found: Any = session.execute(query.limit(1)).first()
    return (None, 0) if found is None else (found, found[3])


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
