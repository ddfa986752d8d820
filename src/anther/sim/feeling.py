"""What an arm in the simulated cell feels, and how often it tells."""

from __future__ import annotations

from typing import Any

import mujoco as mujoco_module
import numpy as np

from anther.geometry import Array
from anther.sim.cell import Cell

mujoco: Any = mujoco_module  # its names come from C++ at run time; type checkers do not see them

CYCLE = 0.01
"""s between the readings that a watcher sees: joint_states' default rate (facts: sawyer 5)."""


def contact_force(cell: Cell) -> float:
    """Return the size of the force that plant, pot and bench exert on arm and gripper now [N]."""
    return float(np.linalg.norm(contact_vector(cell)))


def contact_vector(cell: Cell) -> Array:
    """Return (3,) the force that plant, pot and bench exert on arm and gripper now, world [N].

    It is the sum over all contacts as vectors: what the two pads do to a stem between them cancels, as it would in a
    sensor at the wrist.
    """
    total, force = np.zeros(3), np.zeros(6)
    for i in range(cell.data.ncon):
        contact = cell.data.contact[i]
        mujoco.mj_contactForce(cell.model, cell.data, i, force)
        scenery_first = cell.model.geom(contact.geom[0]).name.startswith(("segment_", "blade_", "pot", "bench"))
        total += (1 if scenery_first else -1) * contact.frame.reshape(3, 3).T @ force[:3]
    return total
