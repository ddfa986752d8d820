"""The history as flat tables for other programs: CSV, or Parquet through pyarrow. Units are in the columns' names."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from datetime import date, datetime
from pathlib import Path
from typing import Any

import numpy as np

from anther.errors import bad_input
from anther.formats.tables import write_table
from anther.history._records import Outcome, TrialRecord

_VISIT = {"visit": int, "time": datetime, "species": str, "plant": str}
TABLES: dict[str, dict[str, type]] = {
    "visits": {
        **_VISIT,
        "held_unharmed": bool,
        "failure": str,
        "run": str,
        "robot": str,
        "acceleration_mean_ms2": float,
        "grasp_arc_length_m": float,
        "grasp_stem_diameter_m": float,
        "grasp_confidence": float,
        "organ_grasped": str,
        "shake_frequency_hz": float,
        "shake_amplitude_m": float,
        "shake_duration_s": float,
        "flowers": int,
        "flowers_measured": int,
        "predicted_amplitude_median_m": float,
        "measured_amplitude_median_m": float,
        "youngs_before_pa": float,
        "youngs_after_pa": float,
        "youngs_spread_after": float,
        "damping_ratio_after": float,
        "damping_spread_after": float,
    },
    "flowers": {
        **_VISIT,
        "flower": int,
        "predicted_amplitude_m": float,
        "measured_amplitude_m": float,
        "measured_amplitude_std_m": float,
        "predicted_acceleration_ms2": float,
        "measured_acceleration_ms2": float,
    },
    "outcomes": {
        "outcome": int,
        "date": date,
        "species": str,
        "plant": str,
        "visit": int,
        "flowers": int,
        "fruit": int,
        "note": str,
    },
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
        lines = (_visit(trial) for trial in trials)
    columns = TABLES[table]
    count = itertools.count()
    lines = ({name: _plain(line.get(name)) for name in columns} for line, _ in zip(lines, count, strict=False))
    write_table(path, columns, lines)
    return next(count)


def _visit(trial: TrialRecord) -> dict[str, Any]:
    grasp, shake, before, after = trial.grasp, trial.shake, trial.believed, trial.material
    line = _of(trial) | {
        "held_unharmed": trial.held_unharmed,
        "failure": trial.failure,
        "run": trial.run,
        "robot": trial.robot,
    }
    felt = trial.accelerations()
    line["acceleration_mean_ms2"] = None if felt is None else float(felt.mean())
    if grasp is not None:
        line |= {f"grasp_{name}_m": getattr(grasp, name) for name in ("arc_length", "stem_diameter")}
        line |= {"grasp_confidence": grasp.confidence, "organ_grasped": grasp.organ}
    if shake is not None:
        line |= {"shake_frequency_hz": shake.frequency, "shake_amplitude_m": shake.amplitude}
        line["shake_duration_s"] = shake.duration
    if after is not None:
        line |= {f"{name}_after": getattr(after, name) for name in ("youngs_spread", "damping_ratio", "damping_spread")}
        line["youngs_after_pa"] = after.youngs
    return line | {
        "flowers": trial.flowers,
        "flowers_measured": int(np.isfinite(trial.measured_amplitude).sum()),
        "predicted_amplitude_median_m": _median(trial.predicted_amplitude),
        "measured_amplitude_median_m": _median(trial.measured_amplitude),
        "youngs_before_pa": None if before is None else before.youngs,
    }


def _flowers(trial: TrialRecord) -> list[dict[str, Any]]:
    motions = trial.motions()
    unit = {name: "ms2" if name.endswith("acceleration") else "m" for name in motions}
    return [
        {**_of(trial), "flower": k, **{f"{name}_{unit[name]}": values[k] for name, values in motions.items()}}
        for k in range(trial.flowers)
    ]


def _of(trial: TrialRecord) -> dict[str, Any]:
    return {"visit": trial.id, "time": trial.time, "species": trial.species, "plant": trial.plant}


def _median(values: Sequence[float]) -> float | None:
    finite = np.array(values)[np.isfinite(values)]
    return float(np.median(finite)) if len(finite) else None


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not np.isfinite(value) else value
