"""Machines of the fault campaigns, and what the pads truly did in a simulated cell, by its log, which no guard sees.

A camera without a picture, an arm whose world outlives its process, a shake in pieces that is raised whatever is seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from anther.core import Array, Intrinsics
from anther.pollination import ShakePlan, Trial
from anther.pollination.execution import ShakeDirection, Step
from anther.robot import ArmRecord, ArmSample, Frame, JointTrajectory, SafetyLimits, Swing
from anther.robot.devices import More, Watch
from anther.sim.cell import Cell, CellLog, mujoco
from anther.sim.robot import SimArm, SimCamera


class ClockCamera:
    """A camera that sees nothing but light that changes, on the cell's clock: no response is measured here."""

    intrinsics = Intrinsics(8, 6, 10.0, 10.0, 3.5, 2.5)
    rates = SimCamera.rates

    def __init__(self, cell: Cell) -> None:
        self.cell, self.begun = cell, (0.0, 0.0)

    def read(self) -> Frame:
        """Return a frame of one colour."""
        return self._frame(self.cell.time)

    def start(self, rate: float) -> None:
        """Begin."""
        self.begun = (self.cell.time, rate)

    def recorded(self, since: float) -> list[Frame]:
        """Return the frames since then."""
        return [frame for frame in self.stop() if frame.time >= since]

    def stop(self) -> list[Frame]:
        """Return frames at the rate asked for."""
        start, rate = self.begun
        return [self._frame(t) for t in np.arange(start, self.cell.time, 1 / rate).tolist()] if rate else []

    def _frame(self, time: float) -> Frame:
        return Frame(time, np.full((6, 8, 3), round(1e3 * time) % 251, np.uint8), np.zeros((6, 8), np.float32))


class Kept(SimArm):
    """The simulated arm; its world's state is on disk at every reading, as the real world outlives a killed process."""

    def __init__(self, cell: Cell, path: Path) -> None:
        super().__init__(cell)
        mode = "r+" if path.exists() else "w+"
        self.state = np.memmap(path, np.float64, mode, shape=(len(_state(cell)),))

    def follow(self, trajectory: JointTrajectory, watch: Watch | None = None, more: More | None = None) -> ArmRecord:
        """Follow, and keep the state before anyone else may end the process."""

        def keep(sample: Any) -> None:
            self.state[:] = _state(self.cell)
            if watch:
                watch(sample)

        return super().follow(trajectory, keep, more)


class Pieces:
    """A shake in pieces that are the same whatever is seen; it satisfies `execution.WatchedShake`.

    All tones of the plan are probed, its own is shaken half as far as planned, then as planned, then comes to rest.
    """

    def __init__(self, plan: ShakePlan) -> None:
        own = np.arange(len(plan.tones.frequencies)) == 0
        probe = plan.amplitude / len(own)
        self.directions = (ShakeDirection(plan.direction, own | True, 1.01 * plan.amplitude),)
        self.steps: tuple[Step, ...] = ()
        self._tones, self._ramp = plan.tones.frequencies, 1 / float(plan.tones.frequencies.min())
        self._sizes = [probe + 0.0 * own, 0.5 * plan.amplitude * own, plan.amplitude * own, 0.0 * own]

    def frame_rate(self, rates: Sequence[float]) -> float:
        """Return the fastest."""
        return max(rates)

    def begin(self, frame: Frame) -> Swing:
        """Return the probe."""
        return Swing.first(self._tones, self._sizes[0], 1.0 + self._ramp, self._ramp)

    def steady_from(self, piece: Swing) -> float:
        """Return when the piece under way is steady [s]."""
        return piece.begin + piece.ramp

    def next_piece(self, piece: Swing, frames: Sequence[Frame], samples: Sequence[ArmSample]) -> Swing:
        """Return the next piece."""
        when = samples[0].time + self.steady_from(piece), samples[-1].time
        tones, sizes = tuple(self._tones.tolist()), tuple(piece.amplitudes.tolist())
        line = tuple(self.directions[0].direction.tolist())
        self.steps = (*self.steps, Step(*when, tones, sizes, line, (), {}, "Goes on.", 0.0))
        new = self._sizes[len(self.steps)]
        return piece.then(new, self._ramp + (1.0 if new.any() else 0.0), self._ramp)


def _state(cell: Cell) -> Array:
    return np.concatenate([[cell.time], cell.data.qpos, cell.data.qvel, cell.data.ctrl])


def left_behind(cell: Cell, path: Path) -> None:
    """Put a cell into the state that a killed process left; the servos hold their last command."""
    time, *rest = np.fromfile(path)
    n, v = cell.model.nq, cell.model.nv
    cell.data.time = time
    cell.data.qpos[:], cell.data.qvel[:], cell.data.ctrl[:] = rest[:n], rest[n : n + v], rest[n + v :]
    mujoco.mj_forward(cell.model, cell.data)


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
