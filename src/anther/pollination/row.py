"""A visit of one stem of a row: it is known by the hook that its string hangs on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from numpy.typing import ArrayLike

from anther.core.choices import Crop
from anther.core.errors import InputError, StageFailure
from anther.core.runs import Run
from anther.plant.belief import EarlierShake
from anther.plant.model import PRIORS, Material
from anther.plant.string import Ends, HeldString
from anther.pollination.pipeline import Done, FindMasks, Params, pollinate
from anther.robot.cell import Cell

AHEAD = ("masks", "cloud", "skeleton", "stem", "flowers", "planner", "grasp", "plan ahead")
"""Stages of a visit that need no more than the views on the way."""


def visit_row_stem(
    cell: Cell,
    crop: Crop,
    hook: ArrayLike,
    run: Run,
    params: Params | None = None,
    *,
    foot: ArrayLike | None = None,
    others: Sequence[Ends] = (),
    material: Material | None = None,
    find_masks: FindMasks | None = None,
    earlier: EarlierShake | None = None,
) -> Done:
    """See, grasp and shake the stem that hangs on a hook, and measure how its flowers answer.

    Views that a cart's camera takes come in the order of its way, the last next to where it stands (`Cell.odometry`).
    Where they are taken before the cart drives up (`Cell.drive_up`), the stages of `AHEAD` are thought meanwhile: while
    the stem before is worked on.

    Args:
        cell: the robot, its cart before the stem.
        crop: whose material and tension are believed.
        hook: (3,) where the stem's string hangs, by the map of the row, in the frame of the cell [m].
        run: keeps what each stage makes.
        params: of the stages.
        foot: (3,) where the stem rises, by the map, in the frame of the cell [m]; None: plumb below its hook.
        others: hook and foot of the strings beside it, by the map: what hangs there is another stem.
        material: what is believed of this plant, if it was visited before.
        find_masks, earlier: see `pollinate`.

    Raises:
        StageFailure: a stage before the execution cannot go on; its kind says why.
    """
    params = params or Params()
    hung = replace(params, crop=crop, plant=replace(params.plant, string=HeldString.of(crop, hook, foot, others)))
    believed = material or PRIORS[crop]
    try:
        return pollinate(cell, believed, run, hung, find_masks, earlier)
    except InputError as error:  # what the views show is not to be worked with
        raise StageFailure("no_plant_found", str(error)) from error
