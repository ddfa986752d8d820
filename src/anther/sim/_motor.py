"""The simulated motor in the gripper: it satisfies `anther.robot.devices.Motor` and advances the cell's time."""

from __future__ import annotations

from collections import deque

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from anther.core.errors import bad_input
from anther.core.geometry import Array
from anther.robot.devices import LEAD, ArmRecord, ArmSample, DeviceError, MoreSwing, Watch
from anther.robot.swing import Swing
from anther.sim import arm_model
from anther.sim.cell import Cell
from anther.sim.plant_mechanics import mujoco

CYCLE = 0.01
"""s between the readings that a watcher sees: joint_states' default rate (facts: sawyer 5)."""


def sensed_force(cell: Cell) -> Array:
    """Return (3,) the contact force as a sensor at the wrist reads it, world [N]; the same at the same time.

    Its noise is 1 mN, so that it never reads the same to the last bit for long; real ones are worse by far.
    """
    return contact_vector(cell) + 1e-3 * np.random.default_rng(round(1e6 * cell.time)).normal(size=3)


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


class SimMotor:
    """The voice coil in the gripper. `swing` advances the cell; arm and gripper keep their commands meanwhile.

    The force of its readings is the mean of ten, over 0.1 s: what the motor does to and fro is no pressing on anything.

    Args:
        cell: built with a motor (`cell.Params`).
    """

    def __init__(self, cell: Cell) -> None:
        if not cell.params.coil_force:
            raise bad_input("motor", given="a cell without", allowed="params with a motor", do="Build it with one.")
        self.cell = cell
        self._felt: deque[Array] = deque(maxlen=10)

    def swing(self, first: Swing, watch: Watch | None = None, more: MoreSwing | None = None) -> ArmRecord:
        """Move the pads as `anther.robot.devices.Motor` says; return when they have settled for 0.1 s.

        Raises:
            DeviceError: a piece needs more than the motor's stroke or force, or the coil does not follow; it stops.
        """
        start, measured = self.cell.time, list[Array]()
        with self.cell.finer(self.cell.fine):
            try:
                self._pieces(first, watch, more, measured)
            except BaseException:
                self.stop()
                raise
            measured.append(self._rest(watch))
            dt = self.cell.timestep
        q = np.concatenate(measured)
        return ArmRecord(start + dt * np.arange(1.0, len(q) + 1), np.tile(self.cell.arm_command, (len(q), 1)), q)

    def stop(self) -> None:
        """Bring the pads to rest in 20 ms, and hold."""
        seconds, dt, (place, speed) = 0.02, self.cell.timestep, self.cell.motor_command
        curve = CubicHermiteSpline([0, seconds], [place, 0], [speed, 0])
        t = dt * np.arange(1, round(seconds / dt) + 1)
        self._run(np.column_stack([curve(t), curve(t, 1), curve(t, 2)]), None)
        self._rest(None)

    def amplitude(self) -> float:
        """Return half of what the pads moved, peak to peak, in the last 0.1 s [m], as the motor's own sensor reads."""
        return float(np.ptp(self.cell.carriage_path(0.1))) / 2

    def _pieces(self, first: Swing, watch: Watch | None, more: MoreSwing | None, measured: list[Array]) -> None:
        piece: Swing | None = first
        cycle, lead = round(CYCLE / self.cell.timestep), round(LEAD / self.cell.timestep)
        while piece is not None:
            after, rows = None, self._rows(piece)
            ask = max(len(rows) - lead, 0) if more else len(rows)
            for k in range(0, len(rows), cycle):
                measured.append(self._cycle(rows[k : k + cycle], watch))
                if more and k + cycle > ask:
                    ask, after = len(rows) + cycle, more()
            piece = after

    def _rows(self, piece: Swing) -> Array:
        """Return (N, 3) a place at the begin of each step; speed and acceleration as differences, as the integrator's.

        Raises:
            DeviceError: beyond what the motor has.
        """
        dt = self.cell.timestep
        first, end = (int(np.ceil(t / dt - 1e-6)) for t in (piece.begin, piece.begin + piece.seconds))
        times = dt * np.arange(first, end + 1) - piece.begin
        place, rate = piece.motion(times)
        place += rate * np.maximum(times - piece.seconds, 0)  # on into the piece that follows
        speed = np.diff(place) / dt
        acceleration = np.diff(speed, prepend=self.cell.motor_command[1]) / dt
        force = arm_model.motor_load(place[:-1], speed, acceleration)
        for what, value, most, unit in (
            ("place", np.abs(place).max(), arm_model.COIL.stop, "m"),
            ("force without a stem", np.abs(force).max(), self.cell.params.coil_force, "N"),
        ):
            if value > most:
                raise DeviceError(f"motor {what}: got {value:.3g} {unit}; it has {most:.3g}. Swing less or slower.")
        return np.column_stack([place[:-1], speed, acceleration])

    def _rest(self, watch: Watch | None) -> Array:
        """Hold the pads still for 0.1 s, until the steps outside are in time again; return the arm's joints (N, J)."""
        dt = self.cell.timestep
        late = -round(self.cell.time / dt) % round(self.cell.params.timestep / dt)
        return self._run(np.zeros((round(0.1 / dt) + late, 3)), watch)

    def _run(self, rows: Array, watch: Watch | None) -> Array:
        """Follow (N, 3) references with arm and gripper still; return the arm's measured joints (N, J)."""
        cycle = round(CYCLE / self.cell.timestep)
        return np.concatenate([self._cycle(rows[k : k + cycle], watch) for k in range(0, len(rows), cycle)])

    def _cycle(self, rows: Array, watch: Watch | None) -> Array:
        """Do the same until the next reading."""
        cell = self.cell
        q = np.tile(cell.arm_command, (len(rows), 1))
        measured = cell.run(q, np.zeros_like(q), np.full(len(q), cell.grip_command), motor=rows)
        behind = abs(float(cell.carriage_at()) - rows[-1, 0])
        if watch:
            if behind > 0.5e-3:
                raise DeviceError(f"the motor does not follow: {1e3 * behind:.2g} mm behind. Is the stem too stiff?")
            self._felt.append(sensed_force(cell))
            force = float(np.linalg.norm(np.mean(self._felt, axis=0)))
            watch(ArmSample(cell.time, q[-1], measured[-1], force))
        return measured
