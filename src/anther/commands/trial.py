"""See, grasp and shake one plant in the simulated cell, measure how its flowers answer, and write a report."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from anther.commands.mask_source import MaskSource
from anther.pipeline import Params

if TYPE_CHECKING:
    from anther.commands.simulated_cell import SimulatedCell
    from anther.pipeline import Done
    from anther.plant import Material
    from anther.sim.judge import Verdict


@dataclass(frozen=True)
class Args:
    """Attributes: which plant, how it is seen, and where the run is kept."""

    plant: Literal["tomato", "pepper"] = "tomato"
    """Species of the simulated plant."""
    seed: int = 0
    """Which plant; all noise comes from it too."""
    viewpoint: float = 0.0
    """Turn the plant about its pot's axis [degrees]."""
    distance: float = 0.72
    """Of the pot in front of the arm [m]."""
    preset: Literal["full", "fast"] = "full"
    """Views all around, or few views along a short way (docs/views.md says what that costs)."""
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
    history: Path = Path("runs/history.sqlite")
    """Trial history to add this trial to."""
    params: Params = field(default_factory=Params)
    """Parameters of the stages."""


def run(args: Args) -> int:
    """Run one trial; return 0 when the main stem was shaken without harm, 1 when not, 2 when it never came to that."""
    from anther.checks import check_range
    from anther.commands.mask_source import mask_finder
    from anther.commands.run_folder import finish, open_run, parameters
    from anther.commands.trial_summary import print_summary, summarise
    from anther.errors import StageFailure, bad_input
    from anther.files import write_json
    from anther.pipeline import pollinate
    from anther.runs import WHERE_IT_STOPPED, stage_under_way

    check_range("seed", args.seed, 0, 2**31 - 1)
    check_range("viewpoint", args.viewpoint, -360, 360, "degrees")
    check_range("views", 3 if args.views is None else args.views, 3, 200)
    check_range("distance", args.distance, 0.3, 3.0, "m")
    out = args.out or Path("runs") / f"{args.plant}-{args.seed}-{args.viewpoint:g}"
    if args.restart_from == WHERE_IT_STOPPED and stage_under_way(out) in ("response", "report"):
        args = replace(args, restart_from="execution")
    if args.restart_from in ("response", "report"):
        raise bad_input(
            "restart-from",
            given=f"'{args.restart_from}'",
            allowed="a stage up to 'execution'",
            do="The simulated world and its video are not kept: restart from execution.",
        )
    find_masks = mask_finder(args.masks, args.models, args.params, cache=None)
    cell = done = verdict = failure = None
    with open_run(out, args, restart_from=args.restart_from, overwrite=args.overwrite) as run:
        try:
            cell = run.timed("cell", lambda _: _build(args))
            done = pollinate(cell.robot_side, _material(args.plant), run, args.params, find_masks)
            verdict = run.timed("judge", lambda _: _judge(cell, done))
        except StageFailure as stopped:
            failure = stopped
        summary = summarise(cell, done, verdict, failure)
        summary |= {"seconds": dict(run.seconds), "parameters": parameters(args)}
        write_json(run.folder / "trial.json", summary)
        _remember(args, out, done, summary)
    results = finish(run)
    print_summary(results)
    if failure is not None:
        print(f"anther trial: {failure}", file=sys.stderr)
        return 2
    return 0 if summary["success"] else 1


def _build(args: Args) -> SimulatedCell:
    from anther.commands.simulated_cell import PRESETS, build

    views = PRESETS[args.preset]
    views = views if args.views is None else replace(views, count=args.views)
    return build(args.plant, args.seed, args.viewpoint, views, distance=args.distance)


def _material(species: str) -> Material:
    from anther.plant import PEPPER, TOMATO

    return PEPPER if species == "pepper" else TOMATO


def _judge(cell: SimulatedCell, done: Done) -> Verdict:
    from anther.sim.judge import judge

    times = done.trial.shake_times
    return judge(cell.world, (times[0], times[-1]) if len(times) else None, done.shake.frequency)


def _remember(args: Args, out: Path, done: Done | None, summary: dict[str, Any]) -> None:
    """Add the trial to the history."""
    from anther.store import TrialRecord, record_trial

    grasp = {name: summary.get(f"grasp_{name}") for name in ("pose7", "arc_length_m")}
    shake = {name: summary.get(f"shake_{name}") for name in ("amplitude_m", "frequency_hz", "direction")}
    record_trial(
        TrialRecord(
            species=args.plant,
            plant=f"simulated {args.seed}",
            success=summary["success"],
            failure=summary["failure"],
            grasp={name: _listed(value) for name, value in grasp.items()},
            shake={name: _listed(value) for name, value in shake.items()},
            predicted_amplitude=tuple(summary.get("predicted_flower_amplitude_m", ())),
            measured_amplitude=tuple(summary.get("measured_flower_amplitude_m", ())),
            material=None if done is None else done.material,
            run=str(out),
        ),
        args.history,
    )


def _listed(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else value
