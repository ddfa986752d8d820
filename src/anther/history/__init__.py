"""Trial history: every visit to a plant and what became of it, in a database that several programs may write at once.

`record_trial`, `record_outcome`, `record_note` write, `read_trials`, `read_outcomes` read, `merge` takes in another
history, `export` makes tables for other programs, and `starting_material` says what is believed of a plant before it is
shaken: its own last belief, else the facts; `earlier_shake` with which shake to begin. `overview` has what pages show.
All raise InputError where there is no history of Anther's, or where it cannot be read or written.
"""

from anther.history._beliefs import Belief, earlier_shake, facts_prior, starting_material
from anther.history._database import DEFAULT, PATIENCE, reading, shown
from anther.history._export import TABLES, export
from anther.history._jobs import Job, add_jobs, note_jobs, read_jobs
from anther.history._records import (
    GraspRecord,
    Outcome,
    Result,
    ShakeRecord,
    TrialRecord,
    read_record,
    result_of,
    result_words,
)
from anther.history._trials import (
    Merged,
    add_missing,
    count_trials,
    each_trial,
    find_plants,
    find_visit,
    merge,
    read_outcomes,
    read_trials,
    record_note,
    record_outcome,
    record_trial,
)

__all__ = [
    "DEFAULT",
    "PATIENCE",
    "TABLES",
    "Belief",
    "GraspRecord",
    "Job",
    "Merged",
    "Outcome",
    "Result",
    "ShakeRecord",
    "TrialRecord",
    "add_jobs",
    "add_missing",
    "count_trials",
    "each_trial",
    "earlier_shake",
    "export",
    "facts_prior",
    "find_plants",
    "find_visit",
    "merge",
    "note_jobs",
    "read_jobs",
    "read_outcomes",
    "read_record",
    "read_trials",
    "reading",
    "record_note",
    "record_outcome",
    "record_trial",
    "result_of",
    "result_words",
    "shown",
    "starting_material",
]
