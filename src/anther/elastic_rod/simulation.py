"""Nonlinear time stepping of shaken rods: `simulate` and its `Trajectory`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from anther.checks import check_array, check_range
from anther.elastic_rod.assembly import new_blocks
from anther.elastic_rod.equilibrium import static_state
from anther.elastic_rod.model import Model, build_model
from anther.elastic_rod.motion import Clamp, Motion
from anther.elastic_rod.rods import GRAVITY, Array, Rods
from anther.elastic_rod.stepping import State, advance, new_state, total_energy
from anther.errors import StageFailure, bad_input
from anther.files import read_npz, write_npz

HALVINGS = 8
"""A step that Newton cannot solve is split in two, and its parts again, this many times."""


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Motion of every node.

    Attributes:
        times: (T,) [s], from 0.
        positions: (T, N, 3) [m].
        energy: (T,) elastic + kinetic + gravitational energy [J].
        grip_force: (T, 3) force the gripper exerts on the driven nodes [N]; for the midpoint rule its mean over the
            step that ends there. Zero without a drive and at the start.
        work: (T,) work done by the drive since the start [J].
        newton_iterations: Newton iterations spent.
        split_steps: steps that had to be split to converge.
    """

    times: Array
    positions: Array
    energy: Array
    grip_force: Array
    work: Array
    newton_iterations: int
    split_steps: int

    def __post_init__(self) -> None:
        t = len(self.times)
        object.__setattr__(self, "times", check_array("trajectory times", self.times, (t,)))
        object.__setattr__(self, "positions", check_array("trajectory positions", self.positions, (t, None, 3)))
        object.__setattr__(self, "energy", check_array("trajectory energy", self.energy, (t,)))
        object.__setattr__(self, "grip_force", check_array("grip force", self.grip_force, (t, 3)))
        object.__setattr__(self, "work", check_array("work", self.work, (t,)))

    def displacement(self, node: int) -> Array:
        """Return (T, 3) displacement of a node from its start [m]."""
        return self.positions[:, node] - self.positions[0, node]

    def save(self, path: Path | str) -> None:
        """Write an .npz (kind 'rod trajectory', schema 1)."""
        counts = np.array([self.newton_iterations, self.split_steps])
        write_npz(
            path,
            "rod trajectory",
            1,
            times=self.times,
            positions=self.positions,
            energy=self.energy,
            grip_force=self.grip_force,
            work=self.work,
            counts=counts,
        )

    @classmethod
    def load(cls, path: Path | str) -> Trajectory:
        """Read what `save` wrote."""
        stored = read_npz(path, "rod trajectory", 1)
        counts = stored.pop("counts")
        return cls(**stored, newton_iterations=int(counts[0]), split_steps=int(counts[1]))


def simulate(
    rods: Rods,
    clamp: Clamp,
    drive: Motion | None,
    duration: float,
    dt: float,
    *,
    gravity: ArrayLike = GRAVITY,
    integrator: Literal["midpoint", "implicit_euler"] = "midpoint",
    start: Literal["equilibrium", "scanned"] = "equilibrium",
    tolerance: float = 1e-8,
    record_every: int = 1,
    newton_limit: int = 30,
) -> Trajectory:
    """Step the rods through time.

    Args:
        rods: the rods, N nodes.
        clamp: what never moves.
        drive: prescribed motion of the grip, relative to where it starts; None lets it be free.
        duration: simulated time [s], rounded to whole steps.
        dt: step [s].
        gravity: (3,) [m/s^2].
        integrator: "midpoint" is second order and does not damp; "implicit_euler" is first order and damps a mode of
            frequency f by about pi f dt of critical.
        start: at rest in static equilibrium under gravity, or at rest in the scanned shape, released at t = 0.
        tolerance: accepted norm of the residual force [N]; a step is also accepted when Newton's correction has
            fallen to rounding noise (1e-12 m).
        record_every: keep every k-th step.
        newton_limit: Newton iterations per step before it is split.

    Raises:
        InputError: arguments out of range.
        StageFailure: kind "no_convergence", with the time and the residual, when a step cannot be solved even after
            splitting, or when no stable equilibrium exists.
    """
    steps = _check_steps(duration, dt, record_every)
    if integrator not in ("midpoint", "implicit_euler"):
        raise bad_input("integrator", given=integrator, allowed="midpoint or implicit_euler", do="Check the spelling.")
    model, frames = build_model(rods, gravity)
    free = clamp.free(rods, () if drive is None else drive.nodes)
    if start == "equilibrium":
        state = static_state(model, frames, rods.nodes, clamp.free(rods))
    else:
        state = new_state(rods.nodes, frames)
    run = _Run(model, free, state, drive, _Settings(integrator == "midpoint", tolerance, newton_limit))
    return run.trajectory(steps, dt, record_every)


def _check_steps(duration: float, dt: float, record_every: int) -> int:
    check_range("time step", dt, 1e-9, 10, "s")
    check_range("duration", duration, dt, 1e7 * dt, "s")
    steps = round(duration / dt)
    check_range("record_every", record_every, 1, steps)
    return steps // record_every * record_every


@dataclass(frozen=True, slots=True)
class _Settings:
    midpoint: bool
    tolerance: float
    newton_limit: int


class _Output(NamedTuple):
    x: Array
    energy: Array
    force: Array
    work: Array


class _Run:
    """One simulation: the constants, the moving state, and the splitting of steps that do not converge."""

    def __init__(self, model: Model, free: Any, state: State, drive: Motion | None, settings: _Settings) -> None:
        n = len(state.x)
        self.model, self.free, self.state, self.drive, self.settings = model, free, state, drive, settings
        self.scratch, self.turn, self.blocks = new_state(state.x, state.frames), np.zeros(n), new_blocks(n)
        self.driven = np.array(() if drive is None else drive.nodes, dtype=np.int64)
        self.home = state.x[self.driven].copy()
        self.work = np.zeros(1)
        self.iterations = self.splits = 0

    def trajectory(self, steps: int, dt: float, every: int) -> Trajectory:
        rows = steps // every
        out = _Output(np.zeros((rows, len(self.state.x), 3)), np.zeros(rows), np.zeros((rows, 3)), np.zeros(rows))
        first_x, first_energy = self.state.x.copy(), total_energy(self.model, self.state)
        targets = self._targets(np.arange(steps + 1, dtype=np.float64) * dt)
        done, residual = self._advance(targets, dt, 0, every, out)
        while done < steps:
            self._split(done * dt, dt, residual, HALVINGS)
            done += 1
            if done % every == 0:
                self._record(out, done // every - 1)
            done, residual = self._advance(targets, dt, done, every, out)
        trajectory = Trajectory(
            times=np.arange(rows + 1, dtype=np.float64) * every * dt,
            positions=np.concatenate([first_x[None], out.x]),
            energy=np.concatenate([[first_energy], out.energy]),
            grip_force=np.concatenate([np.zeros((1, 3)), out.force]),
            work=np.concatenate([[0.0], out.work]),
            newton_iterations=self.iterations,
            split_steps=self.splits,
        )
        _refuse_free_energy(trajectory, self.model)
        return trajectory

    def _split(self, t0: float, dt: float, residual: float, halvings: int) -> None:
        """Take one step of length dt as two halves, splitting these again where needed."""
        self.splits += 1
        if halvings == 0:
            raise StageFailure(
                "no_convergence",
                f"rods: Newton's method failed at t = {t0:.6g} s with a residual of {residual:.3g} N, also with the "
                f"step split down to {dt:.2g} s. Use a smaller time step, a smaller amplitude, or stiffer rods.",
            )
        for start in (t0, t0 + dt / 2):
            targets = self._targets(np.array([start, start + dt / 2]))
            done, residual = self._advance(targets, dt / 2, 0, 0, _NOTHING)
            if done == 0:
                self._split(start, dt / 2, residual, halvings - 1)

    def _record(self, out: _Output, row: int) -> None:
        out.x[row], out.energy[row] = self.state.x, total_energy(self.model, self.state)
        out.work[row] = self.work[0]
        out.force[row] = self.blocks.gradient[self.driven, :3].sum(axis=0)

    def _targets(self, times: Array) -> Array:
        if self.drive is None:
            return np.zeros((len(times), 3))
        return self.drive.displacement(times)

    def _advance(self, targets: Array, dt: float, first: int, every: int, out: _Output) -> tuple[int, float]:
        done, spent, residual = advance(
            self.model,
            self.free,
            self.driven,
            self.home,
            targets,
            self.state,
            self.scratch,
            self.turn,
            self.blocks,
            dt,
            self.settings.midpoint,
            self.settings.tolerance,
            self.settings.newton_limit,
            *out,
            self.work,
            first,
            every,
        )
        self.iterations += spent
        return done, residual


_NOTHING = _Output(np.zeros((0, 0, 3)), np.zeros(0), np.zeros((0, 3)), np.zeros(0))


def _refuse_free_energy(run: Trajectory, model: Model) -> None:
    """Refuse a trajectory that gained far more energy than the drive and the weight can have given it.

    Midpoint steps that are much too long for undamped, stiff stretching modes can gain energy without end.
    """
    gained = run.energy - run.energy[0] - run.work
    given = np.abs(run.work).max() + np.abs(model.weight).sum() * np.ptp(run.positions, axis=0).max()
    if gained.max() > given + 1e-9:
        start = run.times[np.argmax(gained > given + 1e-9)]
        raise StageFailure(
            "no_convergence",
            f"rods: from t = {start:.6g} s on the energy grows by itself ({gained.max():.3g} J): the time step is too "
            "long for these undamped rods. Use a smaller time step or some viscous_time (1e-4 s is 1 % at 30 Hz).",
        )
