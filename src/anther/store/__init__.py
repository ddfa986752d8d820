"""Trial history: every visit to a plant and what became of it, in a database that several programs may write at once.

`record_trial`, `record_outcome` write, `read_trials`, `read_outcomes` read, `export` makes tables for other programs,
and `starting_material` says what is believed of a plant before it is shaken: its own last belief, else what the crop
taught; `earlier_shake` with which shake to begin.
"""

from anther.store.beliefs import (
    Belief,
    crop_prior,
    earlier_shake,
    facts_prior,
    hierarchical_normal,
    starting_material,
)
from anther.store.database import DEFAULT, PATIENCE, shown
from anther.store.export import TABLES, export
from anther.store.records import GraspRecord, Outcome, ShakeRecord, TrialRecord, read_record
from anther.store.trials import (
    add_missing,
    find_plants,
    find_visit,
    read_outcomes,
    read_trials,
    record_outcome,
    record_trial,
)

__all__ = [
    "DEFAULT",
    "PATIENCE",
    "TABLES",
    "Belief",
    "GraspRecord",
    "Outcome",
    "ShakeRecord",
    "TrialRecord",
    "add_missing",
    "crop_prior",
    "earlier_shake",
    "export",
    "facts_prior",
    "find_plants",
    "find_visit",
    "hierarchical_normal",
    "read_outcomes",
    "read_record",
    "read_trials",
    "record_outcome",
    "record_trial",
    "shown",
    "starting_material",
]
