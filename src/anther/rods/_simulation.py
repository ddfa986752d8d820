"""Nonlinear time stepping of shaken rods: `simulate` and its `Trajectory`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from anther.core.checks import check_range, check_room
from anther.core.errors import StageFailure, bad_input
from anther.core.records import Range, Shape, Stored
from anther.rods._assembly import elastic_energy, move_frames, new_blocks, new_lanes
from anther.rods._equilibrium import loaded_state, warn_of_twist
from anther.rods._loads import History, Loads
from anther.rods._model import Model, build_model
from anther.rods._motion import Clamp, Motion, gripped_edges
from anther.rods._response import FINE
from anther.rods._rods import GRAVITY, Array, Rods
from anther.rods._stepping import (
    Grip,
    Output,
    Settings,
    State,
    Work,
    advance,
    energies,
    new_state,
    record,
)

PREDICTORS = ("inertia", "guess displacement", "none")

NEWTON_LIMIT = 30
"""Newton iterations of a step before it is split."""


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory(Stored):
    """Motion of every node.

    Attributes:
        times: (T,) [s], from 0.
        positions: (T, N, 3) [m].
        directors: (T, N, 3) first material director of every edge, a unit vector across it that turns with the edge.
        energy: (T,) elastic + kinetic + gravitational energy [J].
        grip_force: (T, 3) force the gripper exerts on the driven nodes [N]; for the midpoint rule its mean over the
            step that ends there. Zero without a drive and at the start.
        grip_moment: (T, 3) moment it exerts about the grip node [N m], in the same sense; zero for a single node,
            which may turn in the grip.
        work: (T,) work done by the drive since the start [J].
        newton_iterations: Newton iterations spent.
        split_steps: steps that had to be split to converge.
    """

    KIND, SCHEMA, CALLED = "rod trajectory", 4, "trajectory"
    times: Annotated[Array, Shape("T"), Range(unit="s")]
    positions: Annotated[Array, Shape("T", "N", 3), Range(unit="m")]
    directors: Annotated[Array, Shape("T", "N", 3)]
    energy: Annotated[Array, Shape("T"), Range(unit="J")]
    grip_force: Annotated[Array, Shape("T", 3), Range(unit="N")]
    grip_moment: Annotated[Array, Shape("T", 3), Range(unit="N m")]
    work: Annotated[Array, Shape("T"), Range(unit="J")]
    newton_iterations: int
    split_steps: int

    def displacement(self, node: int) -> Array:
        """Return (T, 3) displacement of a node from its start [m]."""
        return self.positions[:, node] - self.positions[0, node]


def simulate(
    rods: Rods,
    clamp: Clamp,
    drive: Motion | None,
    duration: float,
    dt: float,
    *,
    gravity: ArrayLike = GRAVITY,
    integrator: Literal["midpoint", "implicit_euler"] = "midpoint",
    start: Literal["equilibrium", "scanned", "plucked"] = "equilibrium",
    loads: Loads | History | None = None,
    base: Motion | None = None,
    tolerance: float = 1e-8,
    record_every: int = 1,
    predictor: Literal["inertia", "guess displacement", "none"] = "inertia",
    moving: tuple[Array, Array] | None = None,
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
        start: at rest in static equilibrium under gravity and loads; or at rest in the scanned shape, released at
            t = 0; or plucked: in equilibrium under gravity and loads, which let go at t = 0.
        loads: forces and torques of one's own, steady, or as a function of the time [s] (at 0: of the start), which is
            asked in the middle of each step. They count in `work`, not in `energy`.
        base: prescribed motion of a clamped node, as of a shaking table: all that is clamped, and the soil, move and
            turn with it as one body. There is no other drive then, and the grip's force, moment and work are those of
            the base, but for the moment and the viscous work of turning soil.
        tolerance: accepted norm of the residual force [N]; a step is also accepted when Newton's correction has
            fallen to rounding noise (1e-12 m).
        record_every: keep every k-th step.
        predictor: where Newton starts: each node goes on with its velocity; or the four nodes on either side of the
            grip go along with it, less the farther away (the paper's guess displacement, P21); or only the grip moves.
            The result does not depend on it beyond the tolerance.
        moving: displacements [m] and spins [rad] (N, 4) from `start`, and their rates (N, 4), with which to begin
            instead of at rest, for instance those of `steady_motion`; the drive must begin likewise.

    Raises:
        InputError: arguments out of range.
        StageFailure: kind "no_convergence", with the time and the residual, when a step cannot be solved even after
            splitting, or when no stable equilibrium exists.
    """
    steps = _check_steps(duration, dt, record_every)
    if integrator not in ("midpoint", "implicit_euler"):
        raise bad_input("integrator", given=integrator, allowed="midpoint or implicit_euler", do="Check the spelling.")
    if start not in ("equilibrium", "scanned", "plucked"):
        raise bad_input("start", given=start, allowed="equilibrium, scanned or plucked", do="Check the spelling.")
    if predictor not in PREDICTORS:
        raise bad_input("predictor", given=predictor, allowed=", ".join(PREDICTORS), do="Check the spelling.")
    nodes = () if drive is None else drive.nodes
    if base is not None:
        if drive is not None:
            raise bad_input("drive", given="one beside a base", allowed="either", do="Shake the grip or the base.")
        drive, nodes = base, _with_clamp(base, clamp)
    model, frames = build_model(rods, gravity, clamp.planted)
    free = clamp.free(rods, () if base else nodes)
    if start == "scanned":
        state = new_state(rods.nodes, frames)
    else:
        state = loaded_state(rods, model, frames, clamp.free(rods), loads(0.0) if callable(loads) else loads)[1]
    if moving is not None:
        state = _set_moving(model, state, *moving, nodes)
    around = _Surroundings(rods, model, None if start == "plucked" else loads, base if clamp.planted else None)
    settings = Settings(dt, integrator == "midpoint", tolerance, NEWTON_LIMIT, balance=around.balanced)
    guess = np.zeros(0 if predictor == "inertia" else len(free))
    if predictor == "guess displacement":
        guess = _guess_shares(rods.parent, nodes) * free[:, 0]
    return _Run(model, free, state, drive, nodes, settings, guess, around).trajectory(steps, record_every)


def _with_clamp(base: Motion, clamp: Clamp) -> tuple[int, ...]:
    """Return what is clamped, the base's node first.

    Raises:
        InputError: the base moves what is not clamped.
    """
    for node in base.nodes:
        if node not in clamp.nodes:
            raise bad_input("base node", given=node, allowed=f"clamped: {clamp.nodes}", do="Use `drive`.")
    return (base.node, *(int(node) for node in clamp.nodes if node != base.node))


class _Surroundings:
    """What changes from step to step beside the grip: loads of one's own, and soil that turns with the base."""

    def __init__(self, rods: Rods, model: Model, loads: Loads | History | None, base: Motion | None) -> None:
        self.rods, self.model, self.loads, self.base = rods, model, loads, base
        self.gravity, self.soil = model.weight.copy(), model.soil.copy()
        self.own, self.before_x, self.stored, self.turned = (
            np.zeros_like(model.weight),
            rods.nodes,
            0.0,
            (self.soil,) * 2,
        )

    @property
    def balanced(self) -> bool:
        """Whether the energy of a step can be told from grip and weight: what turns along does work besides."""
        steady = self.loads is None or (isinstance(self.loads, Loads) and not self.loads.turns)
        return steady and self.base is None

    @property
    def still(self) -> bool:
        """Whether there is none of it."""
        return self.loads is None and self.base is None

    def before(self, state: State, work: Work, start: float, end: float) -> None:
        """Set loads and soil for the step between two times [s]."""
        model, middle = self.model, 0.5 * (start + end)
        self.before_x = state.x.copy()
        if self.base is not None:
            self.turned = (self._soil_at(start), self._soil_at(end))
            model.soil[:] = self._soil_at(middle)
            turn = Rotation.from_rotvec(self.base.rotation([start, end]))
            rate = (turn[1] * turn[0].inv()).as_rotvec() / (end - start)
            model.soil[:, 6:9] = np.cross(rate, model.soil[:, :3])
            model.soil[:, 9] = model.soil[:, :3] @ rate
            self.stored = self._soil_energy(state)
        loads = self.loads(middle) if callable(self.loads) else self.loads
        if loads is not None or self.own.any():
            x = state.x + 0.5 * (end - start) * state.v[:, :3]
            self.own = np.zeros_like(self.gravity) if loads is None else loads.on(self.rods, x)
            model.weight[:] = self.gravity + self.own
        work.energy[1], work.energy[0] = energies(model, state)

    def after(self, state: State, work: Work, halves: float) -> None:
        """Add up the work that they did; `halves` is 2 if the solve was of half a step."""
        work.energy[2] += np.sum(self.own[:, :3] * (state.x - self.before_x))
        work.energy[2] += np.sum(self.own[:, 3] * halves * 2 * np.arctan(work.turn / 2))
        if self.base is not None:
            work.energy[2] += 0.5 * (self.stored + self._soil_energy(state))
            self.model.soil[:] = self.turned[1]
            work.energy[1], work.energy[0] = energies(self.model, state)

    def _soil_at(self, time: float) -> Array:
        assert self.base is not None
        turn = Rotation.from_rotvec(self.base.rotation([time])[0]).as_matrix()
        return np.hstack([self.soil[:, :3] @ turn.T, self.soil[:, 3:6] @ turn.T, np.zeros((len(self.soil), 4))])

    def _soil_energy(self, state: State) -> float:
        """Return by how much the turning soil alone raises the elastic energy of a state [J]."""
        first, last = (elastic_energy(self.model._replace(soil=s), state.x, state.frames) for s in self.turned)
        return float(last - first)


def _set_moving(model: Model, rest: State, displacement: Array, rate: Array, grip: tuple[int, ...]) -> State:
    """Return the state displaced from rest, and moving.

    Off the way from the root to the grip, edges are only turned: a displacement that is linear in the angle would
    stretch them, and stretching is what rods do fastest.
    """
    x, v = rest.x + displacement[:, :3], rate.copy()
    between = np.zeros(len(x), dtype=bool)
    way = list(grip)
    while way:
        between[node := way.pop()] = True
        way += [int(model.parent[node])] if node > 0 else []
    for j in np.flatnonzero(~between)[1:]:
        p = model.parent[j]
        edge = rest.x[j] + displacement[j, :3] - rest.x[p] - displacement[p, :3]
        unit, swing = edge / np.linalg.norm(edge), rate[j, :3] - rate[p, :3]
        x[j] = x[p] + np.linalg.norm(rest.x[j] - rest.x[p]) * unit
        v[j, :3] = v[p, :3] + swing - (swing @ unit) * unit
    state = new_state(x, rest.frames)
    turn = 2 * np.tan(displacement[:, 3] / 2)
    move_frames(model, rest.x, rest.frames.m1, state.x, turn, state.frames.m1, new_lanes())
    state.v[:] = v
    return state


def _guess_shares(parent: Any, grip: tuple[int, ...]) -> Array:
    """Return (N,) the share of the grip's move that Newton first gives each node: 1, then 0.8 .. 0.2, beyond it 0."""
    fifths, parents = np.zeros(len(parent), dtype=np.int64), parent[1:]
    fifths[list(grip)] = 5
    for _ in range(4):
        fifths[1:] = np.maximum(fifths[1:], fifths[parents] - 1)
        np.maximum.at(fifths, parents, fifths[1:] - 1)
    return fifths / 5


def _check_steps(duration: float, dt: float, record_every: int) -> int:
    check_range("time step", dt, 1e-9, 10, "s")
    check_range("duration", duration, dt, 1e7 * dt, "s")
    steps = round(duration / dt)
    check_range("record_every", record_every, 1, steps)
    return steps // record_every * record_every


class _Run:
    """One simulation: the constants, the moving state, and the splitting of steps that do not converge."""

    def __init__(
        self,
        model: Model,
        free: Any,
        state: State,
        drive: Motion | None,
        nodes: tuple[int, ...],
        settings: Settings,
        guess: Array,
        around: _Surroundings,
    ) -> None:
        n, frames = len(state.x), state.frames
        self.model, self.free, self.state, self.drive, self.settings = model, free, state, drive, settings
        self.guess, self.nodes, self.around = guess, np.array(nodes, dtype=np.int64), around
        self.edges = gripped_edges(model.parent, tuple(self.nodes.tolist()))
        self.home, self.director = state.x[self.nodes], frames.m1[self.edges]
        mid, end = new_state(state.x, frames), new_state(state.x, frames)
        self.work = Work(mid, end, np.zeros(n), np.zeros((n, 4)), new_blocks(n), np.zeros(3))
        self.work.energy[1], self.work.energy[0] = energies(model, state)
        self.iterations = self.splits = 0

    def trajectory(self, steps: int, every: int) -> Trajectory:
        """Take all steps.

        Raises:
            StageFailure: kind "no_convergence": a step cannot be taken, or the energy grows by itself.
        """
        dt, stored = self.settings.dt, self.work.energy[1]
        times = np.arange(steps + 1, dtype=np.float64) * dt
        out, grip = new_output(steps // every + 1, len(self.state.x)), self.grip(times)
        self._record(grip, out, 0)
        done, residual = self._advance(grip, self.settings, 0, steps, every, out, times)
        while done < steps:
            self._split(done * dt, dt, residual)
            done += 1
            if done % every == 0:
                self._record(grip, out, done // every)
            done, residual = self._advance(grip, self.settings, done, steps, every, out, times)
        trajectory = Trajectory(times[::every], *out, newton_iterations=self.iterations, split_steps=self.splits)
        _refuse_free_energy(trajectory, self.model, stored)
        warn_of_twist(self.model, self.state.frames.twist)
        return trajectory

    def _record(self, grip: Grip, out: Output, row: int) -> None:
        record(self.model, grip, self.state, self.work, out, row)
        out.energy[row] += np.sum(self.around.own[:, :3] * self.state.x)

    def _split(self, t0: float, dt: float, residual: float, halvings: int = 8) -> None:
        """Take one step of length dt as two halves, and these likewise where needed, up to `halvings` times.

        The smallest parts may create energy: a drive that starts with a jump puts some in, however small the step.
        """
        self.splits += 1
        if halvings == 0:
            raise StageFailure(
                "no_convergence",
                f"rods: Newton's method failed at t = {t0:.6g} s with a residual of {residual:.3g} N, also with the "
                f"step split down to {dt:.2g} s. Use a smaller time step, a smaller amplitude, or stiffer rods.",
            )
        half = self.settings._replace(dt=dt / 2, balance=halvings > 4)
        for start in (t0, t0 + dt / 2):
            ends = np.array([start, start + dt / 2])
            done, residual = self._advance(self.grip(ends), half, 0, 1, 0, new_output(0, 0), ends)
            if done == 0:
                self._split(start, dt / 2, residual, halvings - 1)

    def grip(self, times: Array) -> Grip:
        """Return what the gripper prescribes at (S + 1,) times [s]."""
        if self.drive is None:
            nothing = np.zeros((len(times), 0, 3))
            return Grip(self.nodes, self.edges, nothing, nothing, self.guess)
        turn = Rotation.from_rotvec(self.drive.rotation(times)).as_matrix()
        levers = np.einsum("tij,pj->tpi", turn, self.home - self.home[0])
        x = self.home[0] + self.drive.displacement(times)[:, None] + levers
        return Grip(self.nodes, self.edges, x, np.einsum("tij,qj->tqi", turn, self.director), self.guess)

    def _advance(
        self, grip: Grip, settings: Settings, first: int, steps: int, every: int, out: Output, times: Array
    ) -> tuple[int, float]:
        """Take the steps first .. steps - 1, as `advance` does; one by one where something beside the grip changes."""
        if self.around.still:
            return self._kernel(grip, settings, first, steps, every, out)
        for step in range(first, steps):
            self.around.before(self.state, self.work, times[step], times[step + 1])
            done, residual = self._kernel(grip, settings, step, step + 1, 0, out)
            if done == step:
                return step, residual
            self.around.after(self.state, self.work, 2.0 if settings.midpoint else 1.0)
            if every > 0 and (step + 1) % every == 0:
                self._record(grip, out, (step + 1) // every)
        return steps, 0.0

    def _kernel(
        self, grip: Grip, settings: Settings, first: int, steps: int, every: int, out: Output
    ) -> tuple[int, float]:
        done, spent, residual = advance(
            self.model, self.free, grip, self.state, self.work, settings, out, first, steps, every
        )
        self.iterations += spent
        return done, residual


def new_output(rows: int, n: int) -> Output:
    """Return empty rows for the records of N nodes.

    Raises:
        InputError: they do not fit into the memory.
    """
    check_room(f"a record of {rows} moments of {n} nodes", 48.0 * rows * n, f"Record fewer moments. {FINE}")
    x, director = np.zeros((2, rows, n, 3))
    return Output(x, director, np.zeros(rows), np.zeros((rows, 3)), np.zeros((rows, 3)), np.zeros(rows))


def _refuse_free_energy(run: Trajectory, model: Model, stored: float) -> None:
    """Refuse a trajectory that gained far more energy than it began with and the drive and the weight can have given.

    Midpoint steps that are much too long for undamped, stiff stretching modes can gain energy without end. `stored` is
    the elastic and kinetic energy at the start [J].
    """
    gained = run.energy - run.energy[0] - run.work
    given = stored + np.abs(run.work).max() + np.abs(model.weight).sum() * np.ptp(run.positions, axis=0).max()
    if gained.max() > given + 1e-9:
        start = run.times[np.argmax(gained > given + 1e-9)]
        raise StageFailure(
            "no_convergence",
            f"rods: from t = {start:.6g} s on the energy grows by itself ({gained.max():.3g} J): the time step is too "
            "long for these undamped rods. Use a smaller time step or some viscous_time (1e-4 s is 1 % at 30 Hz).",
        )
