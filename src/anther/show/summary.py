"""trial.json, and the table that ends a trial: what was grasped, planned, predicted, measured, and the time it took."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.table import Table

from anther.core.geometry import Array
from anther.core.usage import process_seconds
from anther.plant.limits import MOVED, moved
from anther.pollination.execution import Step, Trial, lost_grip
from anther.robot.devices import GripperState
from anther.robot.safety import stem_stress
from anther.show.results import watched_words

if TYPE_CHECKING:
    from anther.core.errors import StageFailure
    from anther.pollination.pipeline import Done
    from anther.robot.cells.hardware import HardwareCell
    from anther.show.results import RunResults
    from anther.sim.judge import Verdict
    from anther.sim.simulated_cell import SimulatedCell


def summarise(
    cell: SimulatedCell | HardwareCell | None,
    done: Done | None,
    verdict: Verdict | None,
    failure: StageFailure | None,
) -> dict[str, Any]:
    """Return trial.json: flat but for the steps, units in the names, null for what was not reached or measured.

    The verdict has three parts, all by the simulator's truth: held, unharmed, flowers_moved; success is all three. Of a
    real plant nobody knows whether it was harmed; held is what the gripper felt before and after the shake,
    flowers_moved what the side camera measured, null if nothing, and success that neither failed.
    """
    answer = None if done is None else done.response
    return {
        **_verdict(done, verdict, failure),
        **_planned(done),
        **_watched(done),
        **({} if answer is None else _flowers("measured", answer.amplitude, answer.acceleration_peak)),
        **_held(cell, done),
        **_true(verdict),
        "simulated_capture_seconds": None if cell is None else cell.capture_seconds,
        "simulated_execution_seconds": None if cell is None or cell.world is None else cell.world.time,
    }


NOTHING_SEEN = "Nothing is in sight"
"""How a watched shake begins to say that the plan alone is carried out."""
STOPPED = ("device_fault", "interrupted", "limits_exceeded")
"""Ends of an execution that say more than what the judge then found between the pads."""
LOADS = {"stem": "stem_strain", "pedicel": "pedicel_strain", "base": "base_strain", "leaf": "leaf_acceleration_ms2"}
"""Kind of load -> its name in trial.json, after "true_"; after "borne_": what this plant bears of it."""


def _verdict(done: Done | None, verdict: Verdict | None, failure: StageFailure | None) -> dict[str, Any]:
    told: dict[str, Any] = {"success": False, "held": False, "unharmed": None, "flowers_moved": None}
    told |= {"failure": None, "message": None, "organ_grasped": None}
    if failure is not None:
        return told | {"failure": failure.kind, "message": str(failure)}
    if done is None:
        return told
    trial = done.trial
    if verdict is None:  # a real plant
        slipped, felt = _slipped(trial), _felt(done)
        held = trial.finished and not slipped
        why = ("slipped", slipped) if trial.finished and slipped else (trial.failure, trial.stop_reason)
        told |= {"success": held and moved(felt) is not False, "held": held, "flowers_moved": moved(felt)}
        told |= {"felt_flowers": len(felt), "felt_flower_acceleration_median_ms2": _median(felt)}
        return told | {"failure": why[0], "message": why[1]}
    stopped = trial.failure in STOPPED
    return {
        "success": verdict.success and not stopped,
        "held": verdict.held and not stopped,
        "unharmed": verdict.unharmed,
        "flowers_moved": verdict.flowers_moved,
        "failure": trial.failure if stopped else verdict.failure,
        "message": trial.stop_reason if stopped else verdict.reason,
        "organ_grasped": verdict.organ_grasped or None,
    }


def _slipped(trial: Trial) -> str:
    """Return how the gripper felt that it lost what it held, or never had it; empty if it did not."""
    states = [GripperState(opening, force, bool(holds)) for opening, force, holds in trial.gripper[:2].tolist()]
    return lost_grip(*states) if len(states) == 2 and states[0].is_gripping else "nothing was gripped"


def _felt(done: Done) -> Array:
    """Return what the side camera measured of the flowers that it saw [m/s2]."""
    if done.response is None:
        return np.zeros(0)
    felt = done.response.felt(done.trial.steps)
    return felt[np.isfinite(felt)]


def _planned(done: Done | None) -> dict[str, Any]:
    if done is None:
        return {}
    shake, grasp = done.shake, done.shake.grasp
    return {
        "grasp_pose7": grasp.pose7,
        "grasp_arc_length_m": grasp.arc_length,
        "grasp_stem_diameter_m": grasp.stem_diameter,
        "grasp_confidence": grasp.confidence,
        "shake_amplitude_m": shake.amplitude,
        "shake_frequency_hz": shake.frequency,
        "shake_direction": shake.direction,
        "shake_duration_s": shake.duration,
        **_flowers("predicted", shake.predicted_amplitude, shake.predicted_acceleration),
        "execution": done.trial.stop_reason,
        "learned_youngs_pa": done.material.youngs,
        "learned_damping_ratio": done.material.damping_ratio,
        "learned_pad_stiffness_n_m": None if done.pads is None else done.pads.stiffness,
        "learned_pad_turning_nm_rad": None if done.pads is None else done.pads.turning,
    }


def _flowers(how: str, amplitude: Array, acceleration: Array) -> dict[str, Any]:
    return {
        f"{how}_flower_amplitude_m": amplitude,
        f"{how}_flower_amplitude_median_m": _median(amplitude),
        f"{how}_flower_acceleration_ms2": acceleration,
        f"{how}_flower_acceleration_median_ms2": _median(acceleration),
    }


def _watched(done: Done | None) -> dict[str, Any]:
    """How the shake was raised, step by step, and what ended it; or why the plan alone was carried out."""
    if done is None or not len(done.trial.shake_times):
        return {}
    times, steps, alone = done.trial.shake_times, done.trial.steps, done.alone
    if not steps:
        alone = alone or "it ended before anything was seen"
    elif steps[0].decided.startswith(NOTHING_SEEN):
        alone = "nothing was in the side camera's sight"
    told = {
        "shaking_seconds": float(times[-1] - times[0]),
        "shake_steps": len(steps),
        "plan_alone_because": alone,
        "steps": [_step(step, float(times[0])) for step in steps],
    }
    if not steps:
        return told
    return told | {
        "step_flower_acceleration_median_ms2": steps[-1].median,
        "step_share_of_limit": steps[-1].used,
        "step_closest_limit": steps[-1].binds,
        "shake_ended_by": " ".join(step.decided for step in steps[-2:]),
    }


def _step(step: Step, start: float) -> dict[str, Any]:
    """Return a step with units in its names; times since the shake's begin."""
    felt = [a for a in step.flowers if np.isfinite(a)]
    return {
        "begin_s": step.begin - start,
        "end_s": step.end - start,
        "frequencies_hz": step.frequencies,
        "amplitudes_m": step.amplitudes,
        "flower_acceleration_ms2": step.flowers,
        "flower_acceleration_median_ms2": step.median,
        "flower_acceleration_most_ms2": max(felt, default=None),
        "share_of_limits": step.loads,
        "decided": step.decided,
        "deciding_seconds": step.seconds,
    }


def _held(cell: SimulatedCell | HardwareCell | None, done: Done | None) -> dict[str, Any]:
    """What the gripper felt after closing."""
    if cell is None or done is None or len(done.trial.gripper) == 0:
        return {}
    opening, force, held = done.trial.gripper[0].tolist()
    stress = stem_stress(GripperState(opening, force, bool(held)), cell.robot_side.limits)
    return {"grip_opening_m": opening, "grip_force_n": force, "grip_stem_stress_pa": stress}


def _true(verdict: Verdict | None) -> dict[str, Any]:
    """The judge's own figures, by the simulator's truth."""
    if verdict is None:
        return {}
    from anther.sim.judge import MUCH, pollen_freed  # noqa: PLC0415 - the simulator is an extra

    felt = verdict.flower_acceleration_peak[np.isfinite(verdict.flower_acceleration_peak)]
    low, middle, high = pollen_freed(felt)
    loads, limits = verdict.harm.loads, verdict.harm.limits
    return {
        "harm_probability": verdict.harm.probability,
        "harmed": ", ".join(verdict.harm.passed),
        "true_flower_acceleration_peak_ms2": verdict.flower_acceleration_peak,
        "true_flower_acceleration_median_ms2": _median(felt),
        "true_flower_acceleration_least_ms2": float(felt.min()) if len(felt) else None,
        "share_above_5_ms2": float(np.mean(felt > MOVED)) if len(felt) else None,
        "share_above_10_ms2": float(np.mean(felt > MUCH)) if len(felt) else None,
        "pollen_freed_low": low,
        "pollen_freed_median": middle,
        "pollen_freed_high": high,
        "true_flower_amplitude_median_m": _median(verdict.flower_amplitude),
        "true_slip_m": verdict.slip,
        "true_push_before_closing_n": verdict.push,
        **{f"true_{name}": loads[kind] for kind, name in LOADS.items()},
        **{f"borne_{name}": limits[kind] for kind, name in LOADS.items()},
        "true_effort_share": verdict.effort,
        "true_held_beside": ", ".join(verdict.held_beside),
    }


def _median(values: Array) -> float | None:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if len(finite) else None


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
    table.add_row("report", str(results.folder / "10_report.html"))
    Console(markup=False).print(table)


def _rows(results: RunResults) -> Iterator[tuple[str, str]]:
    s = results.summary or {}
    yield "verdict", results.headline
    yield "", s["message"] or ""
    for answer in results.answers():
        yield answer.question, f"{answer.said}; {answer.why}".removesuffix("; ")
    if "grasp_pose7" not in s:
        return
    organ = s["organ_grasped"] or ("" if s["unharmed"] is None else "nothing")
    confidence = s.get("grasp_confidence")
    sure = "" if confidence is None else f"; the main stem with a probability of {confidence:.0%}"
    height, diameter = 100 * s["grasp_arc_length_m"], 1000 * s["grasp_stem_diameter_m"]
    where = f"{height:.1f} cm above the root, {diameter:.1f} mm thick as measured{sure}"
    yield "grasped", f"{organ}, {where}".removeprefix(", ")
    along = " ".join(f"{x:+.2f}" for x in s["shake_direction"])
    amplitude, frequency = 1000 * s["shake_amplitude_m"], s["shake_frequency_hz"]
    seconds = s.get("shaking_seconds", s["shake_duration_s"])
    yield "shake", f"{amplitude:.2f} mm at {frequency:.1f} Hz along ({along}), {seconds:.1f} s in all"
    if s.get("shake_steps") is not None:
        yield "watched", watched_words(s)
    yield "flowers, predicted", _motion(s, "predicted")
    yield "flowers, measured", _motion(s, "measured")
    true = s.get("true_flower_amplitude_median_m")
    if true is not None:
        acceleration = s["true_flower_acceleration_median_ms2"]
        yield "flowers, simulated", f"median {1000 * true:.2f} mm, {acceleration:.1f} m/s²"


def _motion(s: dict[str, Any], kind: str) -> str:
    names = (f"{kind}_flower_amplitude_median_m", f"{kind}_flower_acceleration_median_ms2")
    amplitude, acceleration = (s.get(name) for name in names)
    if amplitude is None or acceleration is None:
        return "not measurable"
    seen = np.isfinite(np.array(s[f"{kind}_flower_amplitude_m"], dtype=float))
    text = f"median {1000 * amplitude:.2f} mm, {acceleration:.1f} m/s² over {seen.sum()} flowers"
    if kind == "measured":
        predicted = np.array(s["predicted_flower_amplitude_m"], dtype=float)
        text += f", for which {1000 * np.median(predicted[seen]):.2f} mm was predicted"
    return text
