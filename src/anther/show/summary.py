"""A visit in numbers, and the table that ends a trial: what was grasped, planned, predicted, measured, and the time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.table import Table

from anther.core.geometry import Array
from anther.core.runs import FILES
from anther.core.usage import process_seconds
from anther.plant.limits import MOVED, moved
from anther.plant.visit import GraspRecord, GripRecord, ShakeRecord, StepRecord, TruthRecord, Visit, median
from anther.pollination.execution import Trial, lost_grip
from anther.robot.devices import GripperState
from anther.robot.safety import stem_stress
from anther.show.results import watched_words

if TYPE_CHECKING:
    from anther.core.errors import StageFailure
    from anther.pollination.pipeline import Done
    from anther.pollination.shake import ShakePlan
    from anther.robot.cells.hardware import HardwareCell
    from anther.show.results import RunResults
    from anther.sim.judge import Verdict
    from anther.sim.simulated_cell import SimulatedCell


def summarise(
    begun: Visit,
    cell: SimulatedCell | HardwareCell | None,
    done: Done | None,
    verdict: Verdict | None,
    failure: StageFailure | None,
) -> Visit:
    """Return a visit that has begun with what was done and what came of it.

    The verdict has three parts, all by the simulator's truth: held, unharmed, flowers_moved. Of a real plant nobody
    knows whether it was harmed; held is what the gripper felt before and after the shake, flowers_moved what the side
    camera measured, None if nothing.
    """
    visit = replace(
        begun, **_done(done), **_verdict(done, verdict, failure), grip=_grip(cell, done), truth=_truth(verdict)
    )
    if verdict is not None:
        visit = replace(visit, grasp=replace(visit.grasp or GraspRecord(), organ=verdict.organ_grasped or None))
    if cell is None:
        return visit
    execution = None if cell.world is None else cell.world.time
    return replace(visit, simulated_capture_seconds=cell.capture_seconds, simulated_execution_seconds=execution)


NOTHING_SEEN = "Nothing is in sight"
"""How a watched shake begins to say that the plan alone is carried out."""
STOPPED = ("device_fault", "interrupted", "limits_exceeded")
"""Ends of an execution that say more than what the judge then found between the pads."""
LOADS = {"stem": "stem_strain", "pedicel": "pedicel_strain", "base": "base_strain", "leaf": "leaf_acceleration"}
"""Kind of load -> its name in a `TruthRecord`, after "true_"; after "borne_": what this plant bears of it."""


def _verdict(done: Done | None, verdict: Verdict | None, failure: StageFailure | None) -> dict[str, Any]:
    if failure is not None or done is None:
        why = {} if failure is None else {"failure": failure.kind, "message": str(failure)}
        return {"held": False, "held_unharmed": False, **why}
    trial = done.trial
    if verdict is None:  # a real plant
        slipped, felt = _slip_words(trial), _felt(done)
        held = trial.finished and not slipped
        why = ("slipped", slipped) if trial.finished and slipped else (trial.failure, trial.stop_reason)
        told = {
            "felt_flowers": len(felt),
            "felt_flower_acceleration_median": median(felt),
            "flowers_moved": moved(felt),
        }
        return told | {"held": held, "held_unharmed": held, "failure": why[0], "message": why[1]}
    stopped = trial.failure in STOPPED
    held = verdict.held and not stopped
    return {
        "held": held,
        "unharmed": verdict.unharmed,
        "held_unharmed": held and verdict.unharmed,
        "flowers_moved": verdict.flowers_moved,
        "failure": trial.failure if stopped else verdict.failure,
        "message": trial.stop_reason if stopped else verdict.reason,
    }


def _slip_words(trial: Trial) -> str:
    """Return how the gripper felt that it lost what it held, or never had it; empty if it did not."""
    states = [GripperState(opening, force, bool(holds)) for opening, force, holds in trial.gripper[:2].tolist()]
    return lost_grip(*states) if len(states) == 2 and states[0].is_gripping else "nothing was gripped"


def _felt(done: Done) -> Array:
    """Return what the side camera measured of the flowers that it saw [m/s2]."""
    if done.response is None:
        return np.zeros(0)
    felt = done.response.flower_acceleration(done.trial.steps)
    return felt[np.isfinite(felt)]


def _done(done: Done | None) -> dict[str, Any]:
    """What was held, shaken, predicted, measured and learned."""
    if done is None:
        return {}
    plan, answer, times, grasp = done.shake, done.response, done.trial.shake_times, done.shake.grasp
    motions = (
        {}
        if answer is None
        else {
            "measured_amplitude": tuple(answer.amplitude.tolist()),
            "measured_amplitude_std": tuple(answer.amplitude_std.tolist()),
            "measured_acceleration": tuple(answer.flower_acceleration(done.trial.steps).tolist()),
        }
    )
    return (
        motions
        | _camera_results(done)
        | {
            "grasp": GraspRecord(
                grasp.arc_length, grasp.stem_diameter, grasp.confidence, None, tuple(grasp.pose7.tolist())
            ),
            "shake": _shake(plan, float(times[-1] - times[0]) if len(times) else 0.0),
            "planned": None if done.planned is None else _shake(done.planned, done.planned.duration),
            "predicted_amplitude": tuple(plan.predicted_amplitude.tolist()),
            "predicted_acceleration": tuple(plan.predicted_acceleration.tolist()),
            "execution": done.trial.stop_reason,
            "believed": done.believed,
            "material": done.material,
            "pad_stiffness": None if done.pads is None else done.pads.stiffness,
            "pad_turning": None if done.pads is None else done.pads.turning,
        }
    )


def _shake(plan: ShakePlan, duration: float) -> ShakeRecord:
    return ShakeRecord(plan.frequency, plan.amplitude, duration, "sine", tuple(plan.direction.tolist()))


def _camera_results(done: Done) -> dict[str, Any]:
    """How the shake was raised, step by step; or why the plan alone was carried out."""
    if not len(done.trial.shake_times):
        return {}
    start, steps, alone = float(done.trial.shake_times[0]), done.trial.steps, done.alone
    if not steps:
        alone = alone or "it ended before anything was seen"
    elif steps[0].decided.startswith(NOTHING_SEEN):
        alone = "nothing was in the side camera's sight"
    records = [
        StepRecord(
            s.begin - start, s.end - start, s.frequencies, s.amplitudes, s.flowers, s.loads, s.decided, s.seconds
        )
        for s in steps
    ]
    return {"plan_alone_because": alone, "steps": tuple(records)}


def _grip(cell: SimulatedCell | HardwareCell | None, done: Done | None) -> GripRecord | None:
    """What the gripper felt after closing."""
    if cell is None or done is None or len(done.trial.gripper) == 0:
        return None
    opening, force, held = done.trial.gripper[0].tolist()
    return GripRecord(opening, force, stem_stress(GripperState(opening, force, bool(held)), cell.robot_side.limits))


def _truth(verdict: Verdict | None) -> TruthRecord | None:
    """The judge's own figures, by the simulator's truth."""
    if verdict is None:
        return None
    from anther.sim.judge import pollen_freed  # noqa: PLC0415 - the simulator is an extra

    felt = verdict.flower_acceleration_peak[np.isfinite(verdict.flower_acceleration_peak)]
    low, middle, high = pollen_freed(felt)
    loads, limits = verdict.harm.loads, verdict.harm.limits
    return TruthRecord(
        harm_probability=verdict.harm.probability,
        harmed=", ".join(verdict.harm.passed),
        true_flower_acceleration_peak=tuple(verdict.flower_acceleration_peak.tolist()),
        true_flower_acceleration_median=median(felt),
        true_flower_acceleration_least=float(felt.min()) if len(felt) else None,
        share_above_5_ms2=float(np.mean(felt > MOVED)) if len(felt) else None,
        share_above_10_ms2=float(np.mean(felt > 10)) if len(felt) else None,  # about the middle of what `MOVED` names
        pollen_freed_low=low,
        pollen_freed_median=middle,
        pollen_freed_high=high,
        true_flower_amplitude_median=median(verdict.flower_amplitude),
        true_slip=verdict.slip,
        true_push_before_closing=verdict.push,
        **{f"true_{name}": loads[kind] for kind, name in LOADS.items()},
        **{f"borne_{name}": limits[kind] for kind, name in LOADS.items()},
        true_effort_share=verdict.effort,
        true_held_beside=", ".join(verdict.held_beside),
        flowers_lost=verdict.harm.flowers_lost,
    )


def print_summary(results: RunResults) -> None:
    """Print the short table that ends a trial."""
    table = Table(title=results.title, show_header=False, title_justify="left", pad_edge=False)
    for name, value in _rows(results):
        table.add_row(name, value)
    for note in results.doubts():
        table.add_row("warning", note)
    slowest = sorted(results.seconds.items(), key=lambda item: -item[1])
    times = ", ".join(f"{name} {seconds:.1f}" for name, seconds in slowest if seconds >= 0.05)
    table.add_row("time per stage [s]", f"{times}; in all, with imports, {process_seconds():.1f}")
    table.add_row("report", str(results.folder / FILES["report"]))
    Console(markup=False).print(table)


def _rows(results: RunResults) -> Iterator[tuple[str, str]]:
    v = results.visit
    if v is None:
        return
    yield "verdict", results.headline
    yield "", v.message or ""
    for answer in results.answers():
        yield answer.question, f"{answer.said}; {answer.why}".removesuffix("; ")
    grasp, shake = v.grasp, v.shake
    if grasp is None or shake is None or grasp.arc_length is None or grasp.stem_diameter is None:
        return
    organ = grasp.organ or ("" if v.truth is None else "nothing")
    sure = "" if grasp.confidence is None else f"; the main stem with a probability of {grasp.confidence:.0%}"
    where = (
        f"{100 * grasp.arc_length:.1f} cm above the root, {1000 * grasp.stem_diameter:.1f} mm thick as measured{sure}"
    )
    yield "grasped", f"{organ}, {where}".removeprefix(", ")
    along = " ".join(f"{x:+.2f}" for x in shake.direction or ())
    seconds = f"{shake.duration or 0.0:.1f} s in all"
    yield "shake", f"{1000 * shake.amplitude:.2f} mm at {shake.frequency:.1f} Hz along ({along}), {seconds}"
    if v.shaken:
        yield "watched", watched_words(v)
    yield "flowers, predicted", _motion(v, "predicted")
    yield "flowers, measured", _motion(v, "measured")
    true = v.truth and v.truth.true_flower_amplitude_median
    if v.truth and true is not None:
        yield "flowers, simulated", f"median {1000 * true:.2f} mm, {v.truth.true_flower_acceleration_median:.1f} m/s²"


def _motion(v: Visit, kind: str) -> str:
    motions = {name: np.array(values) for name, values in v.motions().items()}
    amplitude, acceleration = median(motions[f"{kind}_amplitude"]), median(motions[f"{kind}_acceleration"])
    if amplitude is None or acceleration is None:
        return "not measurable"
    seen = np.isfinite(motions[f"{kind}_amplitude"])
    text = f"median {1000 * amplitude:.2f} mm, {acceleration:.1f} m/s² over {seen.sum()} flowers"
    if kind == "measured":
        text += f", for which {1000 * np.median(motions['predicted_amplitude'][seen]):.2f} mm was predicted"
    return text
