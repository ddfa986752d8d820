"""The public names of the room, and where they stand; `__init__.py` finds them when they are asked for."""

from .escalation import Foresight, foresee
from .execution import Step, Trial, execute
from .grasp import Grasp, load_grasps, plan_grasps, save_grasps
from .learning import ObservedShake, Refinement, measure_grip, refine
from .pipeline import Done, Params, Seen, model_plant, perceive, pollinate
from .response import Response, measure_response
from .row import visit_row_stem
from .shake import Actuator, Pads, ShakePlan, arm_shaker, plan_shake

__all__ = [
    "Actuator",
    "Done",
    "Foresight",
    "Grasp",
    "ObservedShake",
    "Pads",
    "Params",
    "Refinement",
    "Response",
    "Seen",
    "ShakePlan",
    "Step",
    "Trial",
    "arm_shaker",
    "execute",
    "foresee",
    "load_grasps",
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
