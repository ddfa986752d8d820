"""The history as flat tables for other programs: CSV, or Parquet through pyarrow. Units are in the columns' names."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict
from datetime import date, datetime
from pathlib import Path
from typing import Any

import numpy as np

from anther.core.errors import bad_input
from anther.core.geometry import Array
from anther.core.tables import write_table
from anther.history._records import MOTIONS, Outcome, TrialRecord

Column = tuple[type, Callable[[Any], Any]]
"""Its type, and what it holds of a line's source."""

_OF_TRIAL: dict[str, Column] = {
    "visit": (int, lambda t: t.id),
    "time": (datetime, lambda t: t.time),
    "species": (str, lambda t: t.species),
    "plant": (str, lambda t: t.plant),
}
_VISITS: dict[str, Column] = {
    **_OF_TRIAL,
    "result": (str, lambda t: t.result),
    "held_unharmed": (bool, lambda t: t.held_unharmed),
    "flowers_moved": (bool, lambda t: t.flowers_moved),
    "failure": (str, lambda t: t.failure),
    "run": (str, lambda t: t.run),
    "robot": (str, lambda t: t.robot),
    "acceleration_mean_ms2": (float, lambda t: _mean(t.accelerations())),
    "grasp_arc_length_m": (float, lambda t: t.grasp and t.grasp.arc_length),
    "grasp_stem_diameter_m": (float, lambda t: t.grasp and t.grasp.stem_diameter),
    "grasp_confidence": (float, lambda t: t.grasp and t.grasp.confidence),
    "organ_grasped": (str, lambda t: t.grasp and t.grasp.organ),
    "shake_frequency_hz": (float, lambda t: t.shake and t.shake.frequency),
    "shake_amplitude_m": (float, lambda t: t.shake and t.shake.amplitude),
    "shake_duration_s": (float, lambda t: t.shake and t.shake.duration),
    "flowers": (int, lambda t: t.flowers),
    "flowers_measured": (int, lambda t: int(np.isfinite(t.measured_amplitude).sum())),
    "predicted_amplitude_median_m": (float, lambda t: _median(t.predicted_amplitude)),
    "measured_amplitude_median_m": (float, lambda t: _median(t.measured_amplitude)),
    "youngs_before_pa": (float, lambda t: t.believed and t.believed.youngs),
    "youngs_after_pa": (float, lambda t: t.material and t.material.youngs),
    "youngs_spread_after": (float, lambda t: t.material and t.material.youngs_spread),
    "damping_ratio_after": (float, lambda t: t.material and t.material.damping_ratio),
    "damping_spread_after": (float, lambda t: t.material and t.material.damping_spread),
}
_FLOWERS: dict[str, type] = {
    **{name: kind for name, (kind, _) in _OF_TRIAL.items()},
    "flower": int,
    **dict.fromkeys(MOTIONS.values(), float),
}
_OUTCOMES: dict[str, type] = {
    "outcome": int,
    "date": date,
    "species": str,
    "plant": str,
    "visit": int,
    "flowers": int,
    "fruit": int,
    "note": str,
}
TABLES: dict[str, dict[str, type]] = {
    "visits": {name: kind for name, (kind, _) in _VISITS.items()},
    "flowers": _FLOWERS,
    "outcomes": _OUTCOMES,
}
"""Table -> column -> type. "visits": one line a visit; "flowers": one a flower and visit; "outcomes": one a count."""


def export(path: Path, table: str, trials: Iterable[TrialRecord], outcomes: Iterable[Outcome]) -> int:
    """Write one of `TABLES` to a .csv or .parquet, whole or not at all, and return how many lines it has.

    The trials are taken one after another, so that an iterator of more than the memory holds is written as well.

    Raises:
        InputError: unknown table or suffix.
        MissingExtra: Parquet without pyarrow.
    """
    if table not in TABLES:
        raise bad_input("table", given=f"'{table}'", allowed=", ".join(TABLES), do="Choose one.")
    if table == "outcomes":
        lines: Iterator[dict[str, Any]] = ({**asdict(o), "outcome": o.id} for o in outcomes)
    elif table == "flowers":
        lines = (line for trial in trials for line in _flowers(trial))
    else:
        lines = (_line(trial, _VISITS) for trial in trials)
    columns = TABLES[table]
    count = itertools.count()
    lines = ({name: _plain(line.get(name)) for name in columns} for line, _ in zip(lines, count, strict=False))
    write_table(path, columns, lines)
    return next(count)


def _line(trial: TrialRecord, columns: dict[str, Column]) -> dict[str, Any]:
    return {name: value(trial) for name, (_, value) in columns.items()}


def _flowers(trial: TrialRecord) -> Iterator[dict[str, Any]]:
    visit, motions = _line(trial, _OF_TRIAL), trial.motions()
    for k in range(trial.flowers):
        yield {**visit, "flower": k, **{MOTIONS[name]: values[k] for name, values in motions.items()}}


def _mean(values: Array | None) -> float | None:
    return None if values is None else float(values.mean())


def _median(values: Sequence[float]) -> float | None:
    finite = np.array(values)[np.isfinite(values)]
    return float(np.median(finite)) if len(finite) else None


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not np.isfinite(value) else value
