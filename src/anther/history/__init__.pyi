"""The public names of the room, and where they stand; `__init__.py` finds them when they are asked for."""

from ._beliefs import Belief, earlier_shake, starting_material
from ._database import hide_password, open_reader
from ._export import export
from ._merge import merge
from ._records import Outcome
from ._row_records import SURE, House, Row, RowPass, Side
from ._shift_records import Block, Climate, Order, Report, Robot, Shift, StemResult, Work
from ._trials import (
    add_missing,
    count_trials,
    each_trial,
    find_visit,
    read_outcomes,
    read_plants,
    read_trials,
    record_note,
    record_outcome,
    record_trial,
)
from .row_map import read_stems, record_house, record_pass
from .shift import begin_shift, find_unfinished_shift, read_shift, run_shift, stop_robot

__all__ = [
    "SURE",
    "Belief",
    "Block",
    "Climate",
    "House",
    "Order",
    "Outcome",
    "Report",
    "Robot",
    "Row",
    "RowPass",
    "Shift",
    "Side",
    "StemResult",
    "Work",
    "add_missing",
    "begin_shift",
    "count_trials",
    "each_trial",
    "earlier_shake",
    "export",
    "find_unfinished_shift",
    "find_visit",
    "hide_password",
    "merge",
    "open_reader",
    "read_outcomes",
    "read_plants",
    "read_shift",
    "read_stems",
    "read_trials",
    "record_house",
    "record_note",
    "record_outcome",
    "record_pass",
    "record_trial",
    "run_shift",
    "starting_material",
    "stop_robot",
]
