"""One order of a shift in a simulated row: see the stem, grasp and shake it, judge it, report."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import timedelta
from pathlib import Path

from anther.cli.run_folder import finish, judge_done, note_parameters, note_times
from anther.core.errors import StageFailure
from anther.core.files import made_folder
from anther.core.runs import Run
from anther.history import Order, Report, earlier_shake, starting_material
from anther.plant.visit import Visit
from anther.pollination import visit_row_stem
from anther.pollination.row import AHEAD
from anther.show.results import EXECUTED, SUMMARY
from anther.show.summary import summarise
from anther.sim import STEM_TO_STEM, Row, build_row, mapped_others, mapped_string


@dataclass(frozen=True, slots=True)
class Asked:
    """What a visit's folder says was asked for: crop, where its stem hangs, and the seed that the row grew from."""

    plant: str
    label: str
    seed: int


BY_THE_SIMULATOR = {"cell", "capture", "execution", "judge"}
"""Stages whose time is the simulator's, not this computer's."""


def visit_stem(row: Row, order: Order, history: str, folder: Path, *, quiet: bool = False) -> Report:
    """Visit the plant of a row that is asked for, in its own run folder; its stages are shown, unless it is `quiet`.

    The robot knows what its cell holds, and the place of the stem's hook as a map has it.
    The report's time is the simulator's for motions, and this computer's for what is computed while the cart stands: of
    wall and processor time the lesser, as other programs share it. It learns while it goes on to the next stem.
    """
    belief = starting_material(order.species, order.plant, history)
    earlier = earlier_shake(order.species, order.plant, history)
    visit = Visit(order.species, order.plant, held_unharmed=False, run=str(folder), robot=order.robot, time=order.begin)
    cell, done, verdict, failure = None, None, None, None
    with Run(made_folder(folder), quiet=quiet) as run:
        note_parameters(run, Asked(order.species, f"row {order.row} {order.side}, hook {order.hook + 1}", row.seed))
        try:
            cell = run.timed("cell", lambda _: build_row(row, visit=int(order.begin.timestamp()) % 2**20))
            hook, foot = mapped_string(row)
            done = visit_row_stem(
                cell.robot_side,
                row.crop,
                hook,
                run,
                foot=foot,
                others=mapped_others(row),
                material=belief.material,
                earlier=earlier,
            )
            done.shake.save(folder / EXECUTED)
            verdict = run.timed("judge", lambda _: judge_done(cell, done))
        except StageFailure as stopped:
            failure = stopped
    visit = replace(
        summarise(visit, cell, done, verdict, failure),
        material_source=belief.source, material_reason=belief.reason, seconds=dict(run.seconds),
    )  # fmt: skip
    visit.save(folder / SUMMARY)
    note_times(run)
    finish(run)
    stages = run.seconds.keys() - BY_THE_SIMULATOR
    took = {stage: min(run.seconds[stage], run.cpu_seconds[stage]) for stage in stages}
    meanwhile = sum(took.pop(stage, 0.0) for stage in (*AHEAD, "learning"))
    moved = (visit.simulated_capture_seconds or 0.0) + (visit.simulated_execution_seconds or 0.0)
    entry = 120.0  # s to enter a row (a guess)
    travel = entry if order.enters else STEM_TO_STEM
    waits = max(0.0, meanwhile - travel - moved)  # where that takes longer than the visits before and after
    return Report(visit, order.begin + timedelta(seconds=travel + waits + moved + sum(took.values())))
