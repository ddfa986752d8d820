"""See, grasp and shake one plant, simulated or real, measure how its flowers answer, and write a report."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from anther.cli.args.trial import Args
from anther.cli.run_folder import TrialLog, finish, judge_done, open_run, parameters, remember
from anther.core.checks import check_range
from anther.core.errors import StageFailure, bad_input
from anther.core.runs import WHERE_IT_STOPPED, stage_under_way
from anther.history import Belief, earlier_shake, hide_password, starting_material
from anther.plant.imported import with_known_places
from anther.plant.model import PRIORS
from anther.plant.visit import Visit
from anther.pollination.pipeline import Params, mask_finder, pollinate
from anther.pollination.shake import with_preset
from anther.robot.arm.gripper_shape import GripperShape
from anther.robot.arm.saved import SavedArm
from anther.robot.cells import read_cell
from anther.robot.devices import Tap, no_tap
from anther.show.results import ARM, EXECUTED, FILM
from anther.show.summary import print_summary, summarise

if TYPE_CHECKING:
    from anther.robot.arm.views import Params as ViewParams
    from anther.robot.cells import CellFile
    from anther.robot.cells.hardware import HardwareCell
    from anther.sim.simulated_cell import SimulatedCell
    from anther.sim.truth import Truth

SIMULATED = "simulated"
SAME = ("cell", "simulate", "arm", "label", "plant", "seed", "viewpoint", "distance", "preset", "views", "truth")
"""Arguments that make the plant and how it is seen: a run cannot be gone on with as another's."""


def run(args: Args) -> int:
    """Run one trial; return how it ended.

    Returns:
        0 if the main stem was held through the shake and the plant was not harmed, however little its flowers moved;
        1 if not; 2 if it never came to that. The verdict in words, trial.json and the history tell pollinated from
        held.
    """
    from anther.show.film import save_film, with_robot  # the simulator and trimesh take a second

    check_range("seed", args.seed, 0, 2**31 - 1)
    check_range("viewpoint", args.viewpoint, -360, 360, "degrees")
    check_range("views", 3 if args.views is None else args.views, 3, 200)
    out = args.out or Path("runs") / _folder(args)
    if args.restart_from == WHERE_IT_STOPPED and stage_under_way(out) in ("response", "report"):
        args = replace(args, restart_from="execution")
    if args.restart_from in ("response", "report"):
        do = "The simulated world and its video are not kept: restart from execution."
        given, allowed = f"'{args.restart_from}'", "a stage up to 'execution'"
        raise bad_input("restart-from", given=given, allowed=allowed, do=do)
    file = _file(args)
    args = replace(_resolve(args, file), params=_params(args, file))
    find_masks = mask_finder(args.masks, args.models, args.params, cache=None)
    belief, began = _belief(args), datetime.now(UTC)
    earlier = None if args.material == "facts" else earlier_shake(args.plant, _label(args), args.history)
    history, args = (
        args.history,
        replace(args, history=hide_password(args.history)),
    )  # parameters are kept: no password there
    cell, done, verdict, failure, notes = None, None, None, None, ()
    with ExitStack() as machines, open_run(out, args, SAME) as run:
        log = machines.enter_context(TrialLog(run, wanted=args.log))
        try:
            if file is not None:
                SavedArm(file.model, file.keep_out).save(run.folder / ARM)
            cell = run.timed("cell", lambda _: machines.enter_context(_cell(args, file, log.tap)))
            notes = cell.notes
            print(*notes, sep="\n", end="\n" * bool(notes), flush=True)
            done = pollinate(cell.robot_side, belief.material, run, args.params, find_masks, earlier)
            done.shake.save(run.folder / EXECUTED)
            side, world = cell.robot_side.robot, cell.world
            frames = done.trial.frames if world is None else with_robot(done.trial.frames, done.trial, side, world.arm)
            save_film(run.folder / FILM, frames)
            verdict = None if cell.world is None else run.timed("judge", lambda _: judge_done(cell, done))
        except StageFailure as stopped:
            failure = stopped
        begun = Visit(args.plant, _label(args), held_unharmed=False, run=str(out), robot=args.robot, time=began)
        visit = replace(
            summarise(begun, cell, done, verdict, failure),
            material_source=belief.source,
            material_reason=belief.reason,
            simulated_as=notes,
            seconds=dict(run.seconds),
            parameters=parameters(args),
            **log.close(failure, verdict),
        )
        lost = remember(visit, out, history)
    print_summary(finish(run))
    print(f"material to begin with: {belief.reason}")
    for said in (lost, failure):
        if said is not None:
            print(f"anther trial: {said}", file=sys.stderr)
    if failure is not None or lost is not None:
        return 2
    return int(not visit.held_unharmed)


def _file(args: Args) -> CellFile | None:
    """Return the cell file, read; None in the simulated cell."""
    if args.cell == SIMULATED:
        if args.simulate:
            given, do = "no cell file", "Name it with --cell, or leave --simulate out."
            raise bad_input("simulate", given=given, allowed="with a cell file", do=do)
        return None
    if args.arm is not None:
        raise bad_input("arm", given=f"{args.arm} and a cell file", allowed="one of the two", do="Name it in the file.")
    if not args.simulate:
        return read_cell(args.cell)
    from anther.sim.cell_file import read_simulated

    if args.distance is not None:
        do = "Write where the plant stands as foot under [simulation]."
        raise bad_input("distance", given=f"{args.distance:g} and a cell file", allowed="one of the two", do=do)
    return read_simulated(args.cell)


def _resolve(args: Args, file: CellFile | None) -> Args:
    """Return the arguments with the arm, and in the simulated cell the distance, that they leave open."""
    if file is None:
        from anther.robot.arm.arms import simulated_arm
        from anther.sim.simulated_cell import usual_distance

        name = args.arm or "sawyer"
        distance = usual_distance(simulated_arm(name)) if args.distance is None else args.distance
        check_range("distance", distance, 0.3, 3.0, "m")
        return replace(args, arm=name, distance=distance)
    return replace(args, arm=file.model.name)


def _params(args: Args, file: CellFile | None) -> Params:
    """Return the stages' parameters: those asked for, with what the cell file, preset and --no-watch change."""
    params = args.params or Params()
    known, _ = with_known_places(args.root, None, params.skeleton, params.stem, args.stem)
    bounds = params.shake if args.shake is None else with_preset(args.shake, params.shake)
    watch, actuator = args.watch and params.escalate, args.actuator or params.actuator
    if actuator == "gripper" and not (watch and bounds.keeps_limits):
        given = "gripper with --no-watch or --shake paper"
        raise bad_input("actuator", given=given, allowed="arm", do="A motor is always watched.")
    grasp = params.grasp
    if file is not None:
        if grasp.gripper != GripperShape():
            allowed = "the cell file's gripper"
            do = "Write it under [gripper.shape] of the cell file."
            raise bad_input("params.grasp.gripper", given="a gripper and a cell file", allowed=allowed, do=do)
        grasp = replace(grasp, gripper=GripperShape.of(file.model.tool))
    escalate = watch and bounds.keeps_limits
    return replace(params, skeleton=known, grasp=grasp, shake=bounds, escalate=escalate, actuator=actuator)


def _folder(args: Args) -> str:
    if args.cell == SIMULATED:
        return f"{args.plant}-{args.seed}-{args.viewpoint:g}"
    if args.simulate:
        return f"{Path(args.cell).stem}-{args.plant}-{args.seed}-{args.viewpoint:g}"
    return f"{args.label or args.plant}-{datetime.now(UTC):%Y%m%d-%H%M%S}".replace("/", "-")


@contextmanager
def _cell(args: Args, file: CellFile | None, tap: Tap) -> Iterator[SimulatedCell | HardwareCell]:
    """Give the simulated cell, a simulation of a cell file's, or that one with its machines connected for the block."""
    if file is None:
        yield _build(args, tap)
        return
    if args.simulate:
        from anther.sim.cell_file import simulate

        how: dict[str, Any] = {"truth": _truth(args), "actuator": args.params.actuator, "tap": tap}
        yield simulate(file, args.plant, args.seed, args.viewpoint, _views(args), **how)
        return
    from anther.robot.cells.hardware import hardware_cell

    with hardware_cell(file, _views(args), tap) as cell:
        yield cell


def _truth(args: Args) -> Truth:
    from anther.sim.truth import NOMINAL, draw

    return draw(args.seed) if args.truth == "wide" else NOMINAL


def _views(args: Args) -> ViewParams:
    from anther.sim.simulated_cell import PRESETS

    views = PRESETS[args.preset]
    return views if args.views is None else replace(views, count=args.views)


def _build(args: Args, tap: Tap = no_tap) -> SimulatedCell:
    from anther.robot.arm.arms import simulated_arm
    from anther.sim.simulated_cell import build

    return build(
        args.plant,
        args.seed,
        args.viewpoint,
        _views(args),
        distance=args.distance,
        truth=_truth(args),
        actuator=args.params.actuator,
        tap=tap,
        arm=simulated_arm(args.arm or "sawyer"),
    )


def _belief(args: Args) -> Belief:
    """Return what is believed of the plant. A history that cannot be read stops the trial before anything moves."""
    if args.material == "facts":
        return Belief(PRIORS[args.plant], "facts", f"the facts' prior of {args.plant}, as asked for")
    return starting_material(args.plant, _label(args), args.history)


def _label(args: Args) -> str:
    if args.cell != SIMULATED and not args.simulate:
        return args.label or Path(args.cell).stem
    where = f" in {Path(args.cell).stem}" if args.simulate else ""
    return f"simulated {args.seed}{where}" + (", wide truth" if args.truth == "wide" else "")  # not the same plant
