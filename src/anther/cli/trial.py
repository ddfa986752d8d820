"""See, grasp and shake one plant, simulated or real, measure how its flowers answer, and write a report."""

from __future__ import annotations

import platform
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from anther.cli.run_folder import TrialLog, finish, open_run, parameters, remember
from anther.core.checks import check_range
from anther.core.errors import StageFailure, bad_input
from anther.core.files import write_json
from anther.core.runs import WHERE_IT_STOPPED, stage_under_way
from anther.history import (
    Belief,
    GraspRecord,
    ShakeRecord,
    TrialRecord,
    earlier_shake,
    facts_prior,
    shown,
    starting_material,
)
from anther.plant.limits import Crop, Preset
from anther.pollination.pipeline import Done, MaskSource, Params, mask_finder, pollinate
from anther.pollination.shake import with_preset
from anther.robot.arm import ArmName
from anther.robot.cell import ActuatorName
from anther.robot.cells import read_cell
from anther.robot.devices import Tap, untapped
from anther.show.results import EXECUTED, FILM, SUMMARY, held_unharmed
from anther.show.summary import print_summary, summarise

if TYPE_CHECKING:
    from anther.robot.arm.views import Params as ViewParams
    from anther.robot.cells.hardware import HardwareCell
    from anther.sim.judge import Verdict
    from anther.sim.simulated_cell import SimulatedCell

SIMULATED = "simulated"
SAME = ("cell", "arm", "label", "plant", "seed", "viewpoint", "distance", "preset", "views", "truth")
"""Arguments that make the plant and how it is seen: a run cannot be gone on with as another's."""


@dataclass(frozen=True)
class Args:
    """Attributes: which plant, how it is seen, and where the run is kept."""

    plant: Crop = "tomato"
    """Species of the simulated plant."""
    cell: str = "simulated"
    """Which cell: 'simulated', or a cell file of a real one (docs/cell_file.md). Of a real one nobody knows the truth:
    seed, viewpoint, distance and truth say nothing, and the verdict is what the gripper felt."""
    label: str = ""
    """Name of a real plant, for its history."""
    seed: int = 0
    """Which plant; all noise comes from it too."""
    viewpoint: float = 0.0
    """Turn the plant about its pot's axis [degrees]."""
    arm: ArmName | None = None
    """Which arm, by default a Sawyer; a cell file names its own (docs/arm.md)."""
    distance: float | None = None
    """Of the pot in front of the arm [m]; by default what suits the arm: 0.72 for a Sawyer."""
    preset: Literal["full", "fast"] = "full"
    """Views all around, or few views along a short way (docs/reports/views.md says what that costs)."""
    views: int | None = None
    """How many RGB-D views the arm takes; by default what the preset says: 30, or 10 when fast."""
    masks: MaskSource = "colour"
    """What finds plant and flowers: colour and geometry, Grounding DINO and SAM 2, or SAM 3 (docs/masks.md)."""
    models: Path = Path("models")
    """Folder with the weights of the networks."""
    out: Path | None = None
    """Run folder; by default runs/PLANT-SEED-VIEWPOINT."""
    restart_from: str | None = None
    """Read the results of earlier stages from the run folder and go on from this stage, or 'where-it-stopped'."""
    overwrite: bool = False
    """Replace the results of an earlier run in the same folder."""
    history: str = "runs/history.sqlite"
    """Trial history to learn from and to add this trial to: a SQLite file, or postgresql://USER:PASSWORD@HOST/DATABASE."""
    robot: str = field(default_factory=platform.node)
    """Name of this robot in the history; by default the computer's."""
    truth: Literal["nominal", "wide"] = "nominal"
    """What is true of plant, air, pads, arm and camera: as usual, or drawn from the seed wider than any stage believes.
    It is for judging: no stage is told."""
    material: Literal["learned", "facts"] = "learned"
    """Begin with what the history teaches of this plant or its crop, and with the shake that its last visit ended with;
    or as if nothing had ever been measured."""
    shake: Preset | None = None
    """How boldly the plant may be loaded (docs/shake.md has the limits); by default what --params says. 'paper' is
    the paper's own shake, 12 mm at 1.9 Hz: no limit of the plant is kept, slip is not prevented, nothing is raised."""
    watch: bool = True
    """Raise the shake in steps by what the side camera sees, or carry out the plan alone."""
    actuator: ActuatorName | None = None
    """What shakes the plant: the arm, or a motor in the gripper (docs/gripper_motor.md), which is always watched."""
    log: bool = True
    """Write log.mcap, which Foxglove opens and `anther view --live` shows as it happens (docs/log.md)."""
    params: Params = field(default_factory=Params)
    """Parameters of the stages."""


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
    args = replace(_resolved(args), params=_params(args))
    find_masks = mask_finder(args.masks, args.models, args.params, cache=None)
    belief, began = _belief(args), datetime.now(UTC)
    earlier = None if args.material == "facts" else earlier_shake(args.plant, _label(args), args.history)
    history, args = args.history, replace(args, history=shown(args.history))  # parameters are kept: no password there
    cell = done = verdict = failure = None
    with ExitStack() as machines, open_run(out, args, SAME) as run:
        log = machines.enter_context(TrialLog(run, wanted=args.log))
        try:
            cell = run.timed("cell", lambda _: machines.enter_context(_cell(args, log.tap)))
            done = pollinate(cell.robot_side, belief.material, run, args.params, find_masks, earlier)
            done.shake.save(run.folder / EXECUTED)
            side, world = cell.robot_side.robot, cell.world
            frames = done.trial.frames if world is None else with_robot(done.trial.frames, done.trial, side, world.arm)
            save_film(run.folder / FILM, frames)
            verdict = None if cell.world is None else run.timed("judge", lambda _: _judge(cell, done))
        except StageFailure as stopped:
            failure = stopped
        summary = summarise(cell, done, verdict, failure)
        summary |= {"seconds": dict(run.seconds), "parameters": parameters(args), **log.close(failure, verdict)}
        summary |= {"material_source": belief.source, "material_reason": belief.reason}
        write_json(run.folder / SUMMARY, summary)
        lost = remember(_record(args, out, began, summary, done), out, history)
    print_summary(finish(run))
    print(f"material to begin with: {belief.reason}")
    for said in (lost, failure):
        if said is not None:
            print(f"anther trial: {said}", file=sys.stderr)
    if failure is not None or lost is not None:
        return 2
    return int(not held_unharmed(summary))


def _resolved(args: Args) -> Args:
    """Return the arguments with the arm, and in the simulated cell the distance, that they leave open."""
    if args.cell == SIMULATED:
        from anther.robot.arm.arms import in_simulated_cell
        from anther.sim.simulated_cell import usual_distance

        name = args.arm or "sawyer"
        distance = usual_distance(in_simulated_cell(name)) if args.distance is None else args.distance
        check_range("distance", distance, 0.3, 3.0, "m")
        return replace(args, arm=name, distance=distance)
    if args.arm is not None:
        raise bad_input("arm", given=f"{args.arm} and a cell file", allowed="one of the two", do="Name it in the file.")
    return replace(args, arm=read_cell(args.cell).model.name)


def _params(args: Args) -> Params:
    """Return the stages' parameters: those asked for, with what the shake's preset and --no-watch change."""
    bounds = args.params.shake if args.shake is None else with_preset(args.shake, args.params.shake)
    watch, actuator = args.watch and args.params.escalate, args.actuator or args.params.actuator
    if actuator == "gripper" and not (watch and bounds.keeps_limits):
        given = "gripper with --no-watch or --shake paper"
        raise bad_input("actuator", given=given, allowed="arm", do="A motor is always watched.")
    return replace(args.params, shake=bounds, escalate=watch and bounds.keeps_limits, actuator=actuator)


def _folder(args: Args) -> str:
    if args.cell == SIMULATED:
        return f"{args.plant}-{args.seed}-{args.viewpoint:g}"
    return f"{args.label or args.plant}-{datetime.now(UTC):%Y%m%d-%H%M%S}".replace("/", "-")


@contextmanager
def _cell(args: Args, tap: Tap) -> Iterator[SimulatedCell | HardwareCell]:
    """Give the simulated cell, or a real one whose machines are connected for the block."""
    if args.cell == SIMULATED:
        yield _build(args, tap)
        return
    from anther.robot.cells.hardware import hardware_cell

    with hardware_cell(read_cell(args.cell), _views(args), tap) as cell:
        yield cell


def _views(args: Args) -> ViewParams:
    from anther.sim.simulated_cell import PRESETS

    views = PRESETS[args.preset]
    return views if args.views is None else replace(views, count=args.views)


def _build(args: Args, tap: Tap = untapped) -> SimulatedCell:
    from anther.robot.arm.arms import in_simulated_cell
    from anther.sim.simulated_cell import build
    from anther.sim.truth import NOMINAL, draw

    return build(
        args.plant,
        args.seed,
        args.viewpoint,
        _views(args),
        distance=args.distance,
        truth=draw(args.seed) if args.truth == "wide" else NOMINAL,
        actuator=args.params.actuator,
        tap=tap,
        arm=in_simulated_cell(args.arm or "sawyer"),
    )


def _judge(cell: SimulatedCell, done: Done) -> Verdict:
    from anther.sim.judge import judge

    times = done.trial.shake_times
    return judge(cell.world, (times[0], times[-1]) if len(times) else None, done.shake.frequency, done.trial.steady)


def _belief(args: Args) -> Belief:
    """Return what is believed of the plant. A history that cannot be read stops the trial before anything moves."""
    if args.material == "facts":
        return Belief(facts_prior(args.plant), "facts", f"the facts' prior of {args.plant}, as asked for")
    return starting_material(args.plant, _label(args), args.history)


def _label(args: Args) -> str:
    if args.cell != SIMULATED:
        return args.label or Path(args.cell).stem
    return f"simulated {args.seed}" + (", wide truth" if args.truth == "wide" else "")  # not the same plant


def _record(args: Args, out: Path, began: datetime, summary: dict[str, Any], done: Done | None) -> TrialRecord:
    """Return what the history keeps of the trial: what was held and not harmed teaches.

    That the flowers hardly moved is no failure there: what they felt is kept, and doses are reckoned from that. A shake
    that was planned but never begun is not recorded: it gave the flowers nothing.
    """
    held, failure, moved = held_unharmed(summary), summary["failure"], summary["flowers_moved"]
    crop, label, robot = args.plant, _label(args), args.robot
    record = TrialRecord(crop, label, held, failure, flowers_moved=moved, run=str(out), robot=robot, time=began)
    if done is None:
        return record
    plan, answer, times, grasp = done.shake, done.response, done.trial.shake_times, done.shake.grasp
    shake = ShakeRecord(
        frequency=plan.frequency,
        amplitude=plan.amplitude,
        duration=float(times[-1] - times[0]) if len(times) else 0.0,
        waveform="sine",
        direction=tuple(plan.direction.tolist()),
    )
    organ, pose = summary["organ_grasped"], tuple(grasp.pose7)
    return replace(
        record,
        grasp=GraspRecord(grasp.arc_length, grasp.stem_diameter, grasp.confidence, organ, pose),
        shake=shake if len(times) else None,
        predicted_amplitude=tuple(plan.predicted_amplitude.tolist()),
        predicted_acceleration=tuple(plan.predicted_acceleration.tolist()),
        measured_amplitude=() if answer is None else tuple(answer.amplitude.tolist()),
        measured_amplitude_std=() if answer is None else tuple(answer.amplitude_std.tolist()),
        measured_acceleration=() if answer is None else tuple(answer.acceleration_peak.tolist()),
        believed=done.believed,
        material=done.material,
    )
