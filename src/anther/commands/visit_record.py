"""What a trial leaves in the history, and beside it in the run folder, should the history not take it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from anther.errors import AntherError, bad_input
from anther.files import existing, write_json
from anther.store import GraspRecord, ShakeRecord, TrialRecord, add_missing, read_record, record_trial, shown

if TYPE_CHECKING:
    from anther.pipeline import Done

FILE = "visit.json"


def with_what_was_done(record: TrialRecord, done: Done, organ: str | None) -> TrialRecord:
    """Return the record with grasp, shake, the flowers' motion and what was believed before and after.

    A shake that was planned but never begun is not recorded: it gave the flowers nothing.
    """
    plan, answer, shaken = done.shake, done.response, done.trial.shake_times
    grasp = plan.grasp
    measured: dict[str, Any] = {}
    if answer is not None:
        measured = {
            "measured_amplitude": tuple(answer.amplitude.tolist()),
            "measured_amplitude_std": tuple(answer.amplitude_std.tolist()),
            "measured_acceleration": tuple(answer.acceleration_peak.tolist()),
        }
    shake = ShakeRecord(
        frequency=plan.frequency,
        amplitude=plan.amplitude,
        duration=float(shaken[-1] - shaken[0]) if len(shaken) else 0.0,
        waveform="sine",
        direction=tuple(plan.direction.tolist()),
    )
    return replace(
        record,
        grasp=GraspRecord(grasp.arc_length, grasp.stem_diameter, grasp.confidence, organ, tuple(grasp.pose7)),
        shake=shake if len(shaken) else None,
        predicted_amplitude=tuple(plan.predicted_amplitude.tolist()),
        predicted_acceleration=tuple(plan.predicted_acceleration.tolist()),
        believed=done.believed,
        material=done.material,
        **measured,
    )


def remember(record: TrialRecord, folder: Path, history: str) -> str | None:
    """Keep the record in the run folder, then in the history; return None, or why the history did not take it.

    The trial is done by then, so that a history out of reach ends nothing: the message says how to add it later.
    """
    write_json(folder / FILE, record.plain())
    try:
        record_trial(record, history)
    except AntherError as error:
        how = f"anther history {shown(history)} --add {folder}"
        return f"the trial is not in the history yet. {error} It is kept in {folder / FILE}; add it with: {how}"
    return None


def add_run(folder: Path, history: str) -> int | None:
    """Add a run's trial to the history; None if it is there already.

    Raises:
        InputError: no run with a trial, or the history cannot be written.
    """
    if not (existing(folder) / FILE).exists():
        raise bad_input(
            str(folder),
            given=f"a folder without {FILE}",
            allowed="a run folder of `anther trial`",
            do="Trials of earlier versions are in their history already.",
        )
    return add_missing(read_record(folder / FILE), history)
