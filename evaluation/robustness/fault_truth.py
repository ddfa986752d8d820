"""What the pads truly did in a simulated cell, by its log, which no guard sees."""

from __future__ import annotations

import numpy as np

from anther.core import Array
from anther.pollination import Trial
from anther.robot import SafetyLimits
from anther.sim.cell import Cell, CellLog


def true_stress(log: CellLog, cell: Cell, limits: SafetyLimits) -> float:
    """Return the greatest pressure of all of a pad's force on the thinnest segment that it touches [Pa]."""
    pads = (log.contact_pad <= 1) & (log.contact_other >= 0) & ~log.contact_blade
    when = 2 * log.contact_sample[pads] + log.contact_pad[pads]
    force, thick = np.bincount(when, log.contact_force[pads]), np.full(when.max(initial=0) + 1, np.inf)
    np.minimum.at(thick, when, 2 * np.minimum(cell.plant.radius_start, cell.plant.radius_end)[log.contact_other[pads]])
    return float(limits.pressing.stress(force, thick[: len(force)]).max(initial=0.0))


def true_grip(log: CellLog, trial: Trial) -> float:
    """Return with what force a pad truly pressed, in the median, while the plant was shaken [N]."""
    shaken = (log.times >= trial.shake_times[0]) & (log.times <= trial.shake_times[-1])
    pads = log.contact_pad <= 1
    force = np.bincount(log.contact_sample[pads], log.contact_force[pads], minlength=len(log.times))
    return float(np.median(force[shaken])) / 2


def peak(samples: Array, forces: Array) -> float:
    """Return the largest sum of forces in any one sample [N]."""
    return float(np.bincount(samples, forces).max()) if len(samples) else 0.0
