"""Measurements of one stem (cut samples, plucks, tip masses) -> density, stiffness and damping with their errors."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from anther.cli.args.shared import EXISTS, Output, Stage, stage

Measured = Annotated[Path | None, EXISTS]


@dataclass(frozen=True)
class Args(Output):
    """Attributes: what was measured. Any part may be left out; docs/identification.md has the file formats."""

    samples: Measured = None
    """Cut samples, CSV: mass_g, radius_mm (or diameter_mm), length_mm."""
    density: float | None = None
    """Density [kg/m3], where no samples were cut."""
    density_error: float | None = None
    """Its standard error [kg/m3]; by default 5 %."""
    trace: Annotated[tuple[Path, ...], EXISTS] = ()
    """Free vibrations, CSV: time_s, displacement_mm. Several plucks of one stem are averaged."""
    start: float | None = None
    """Leave out what the traces hold before this time [s]: the release."""
    frequency: float | None = None
    """First natural frequency [Hz], where there is no trace."""
    frequency_error: float | None = None
    """Its standard error [Hz]; by default 1 %."""
    profile: Measured = None
    """The stem's radius from the clamp to the tip, CSV: distance_mm, radius_mm (or diameter_mm)."""
    length: float | None = None
    """Free length [m]; by default the last distance of the profile."""
    radius: float | None = None
    """Radius of a uniform stem [m], where there is no profile."""
    leaves: Measured = None
    """Leaves, flowers and fruits on the stem, CSV: distance_mm from the clamp, mass_g."""
    orientation: Literal["upright", "horizontal", "hanging"] | None = None
    """How the plucked stem was held, horizontal: plucked vertically. Without it gravity is left out."""
    deflection: Measured = None
    """Deflection test of the stem held horizontal, CSV: mass_g on the tip, deflection_mm below where it was without."""
    errors: Stage = stage("anther.plant.bench", "InstrumentErrors")
    """Standard errors of calliper, ruler and balance."""
    out: Path | None = None
    """Folder for identify.json, material.json and identify.png."""
