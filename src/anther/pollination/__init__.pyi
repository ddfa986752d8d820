"""The public names of the room, and where they stand; `__init__.py` finds them when they are asked for."""

from .escalation import foresee
from .execution import Trial, execute
from .grasp import Grasp, plan_grasps, save_grasps
from .learning import ObservedShake, Refinement, measure_grip, refine
from .pipeline import Done, Params, Seen, model_plant, perceive, pollinate
from .response import Response, measure_response
from .row import visit_row_stem
from .shake import ShakePlan, plan_shake

__all__ = [
    "Done",
    "Grasp",
    "ObservedShake",
    "Params",
    "Refinement",
    "Response",
    "Seen",
    "ShakePlan",
    "Trial",
    "execute",
    "foresee",
    "measure_grip",
    "measure_response",
    "model_plant",
    "perceive",
    "plan_grasps",
    "plan_shake",
    "pollinate",
    "refine",
    "save_grasps",
    "visit_row_stem",
]
