"""A simulated plant without an arm: held at one piece of its stem and moved to and fro, until every flower is steady.

The grip holds the piece's direction and its place sideways; its height is free, because a stem that cannot stretch dips
when it bends. A heavy carriage follows the sine exactly; the piece is welded to it, or held by soft pads. The
simulation starts in the steady state of MuJoCo's own linear equations, so that only what is not linear has to settle.
Every mode of the held plant up to 30 Hz has the damping ratio that the plant's truth states; the air's drag comes
besides.

The weld holds the grip to 0.03 % up to 10 Hz, 0.2 % at 30 Hz (measured, pepper 15 held at 0.45 of its stem); `linear`
holds it exactly.
D degrees of freedom of the plant, F flowers, T samples, Q frequencies, B pieces.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import mujoco as mujoco_module
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import eigh

from anther.core import Array, StageFailure
from anther.core.checks import check_range
from anther.core.geometry import transform_each
from anther.core.oscillation import fit_swing
from anther.pollination.shake.observables import semi_major
from anther.sim import NOMINAL, Organ, SimPlant, Truth, plant_mechanics
from anther.sim.pieces import by_kind, of_flower_stalks
from anther.sim.plant_mechanics import PlantMechanics
from anther.sim.sway import Air
from evaluation.judge.finer_plant import divided

mujoco: Any = mujoco_module  # its names come from C++ at run time; type checkers do not see them

CARRIAGE_MASS = 1e6
"""[kg]: it does not feel the plant."""
PAD_LOSS = 1e-3
"""Viscous time of soft pads [s]: a loss factor of 0.06 at 10 Hz and 0.19 at 30 Hz, as of soft silicone; a guess."""
PAD_RESONANCE = 200.0
"""Of the soft pads' inner faces, without a plant [Hz]: they weigh little."""
SOFTENINGS = 3
"""How often the drag at the swing that it allows is found again: it changes a flower's amplitude by a few per cent."""


@dataclass(frozen=True, slots=True)
class Params:
    """How the plant is shaken.

    Attributes:
        timestep: of the integrator [s]; also bounds the damping of pedicels from below, see `sim.cell.Params`. With
            0.5 ms small shakes below 5 Hz are within 0.4 % of `linear`, with 1 ms within 1.5 % (measured).
        settle: before the motion is measured: one period, and at least this [s].
        measure: over which it is measured: two periods, and at least this [s].
        samples: recorded per period.
        plant: how the plant is cut. Finer than in the robot's cell: no segment is longer than a piece, and each piece
            that twists has a hinge for it; foliage, which nothing touches here, swings as freely as stems. The first
            sixteen frequencies of four development plants are within 0.2-0.4 % of those with pieces of 8 mm (root mean
            square; with pieces of 30 mm, of which every second twists, within 2-4.5 %; measured).
    """

    timestep: float = 5e-4
    settle: float = 1.0
    measure: float = 1.0
    samples: int = 40
    plant: plant_mechanics.Params = field(
        default_factory=lambda: plant_mechanics.Params(piece=0.025, twist_every=1, foliage=300.0)
    )


@dataclass(frozen=True, slots=True, eq=False)
class Shaken:
    """A steady shake.

    Attributes:
        times: (T,) [s].
        flowers: (T, F, 3) [m].
        qpos: (T, nq) configurations of the world, for `ShakenPlant.segment_poses`.
        amplitude: (F,) semi-major axis of each flower's swing at the shake's frequency [m].
        grip_amplitude: of the held piece along the shake [m].
        unsteadiness: largest difference of a flower's amplitude between both halves of the record, over the mean one.
    """

    times: Array
    flowers: Array
    qpos: Array
    amplitude: Array
    grip_amplitude: float
    unsteadiness: float


class Across(NamedTuple):
    """What small shakes along world x and y do, per metre of grip motion; L leaves.

    Attributes:
        flowers: (Q, 2, F, 3) their motion [-].
        leaves: (Q, 2, L, 3) the motion of the petioles' bases [-].
        bending: (Q, 2, B, 2) strain at each piece's root [1/m].
        load: (Q, 2, 5) of the pads, two forces across [N/m] and three moments [N].
    """

    flowers: NDArray[np.complex128]
    leaves: NDArray[np.complex128]
    bending: NDArray[np.complex128]
    load: NDArray[np.complex128]


class ShakenPlant:
    """A plant held at one place.

    Attributes:
        plant: ground truth.
        point: (3,) the middle of the held piece [m].
        direction: (3,) unit vector along which the grip moves.
        mechanics: of the plant.
    """

    def __init__(
        self, plant: SimPlant, point: ArrayLike, direction: ArrayLike, params: Params = Params(), truth: Truth = NOMINAL
    ) -> None:
        """Hold the piece of the main stem whose middle is nearest to `point` (3,) [m]; shake along `direction` (3,).

        Args:
            plant: as it truly is.
            point: where it is held.
            direction: of the shake.
            params: how finely it is cut and stepped.
            truth: of pads and wind; the plant has its own already.

        Raises:
            StageFailure: "no_convergence": the plant cannot carry its own weight.
        """
        self.plant, self.params = plant, params
        self.direction = np.asarray(direction, dtype=np.float64) / np.linalg.norm(direction)
        self._pads = np.repeat([truth.pad_stiffness, truth.pad_rotation], [2, 3])
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        spec.option.timestep, spec.option.gravity = params.timestep, [0, 0, -9.81]
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        finer, self._part = divided(plant, params.plant.piece)
        pieces = plant_mechanics.add_plant(spec, finer, params.plant)
        held, self.point = _nearest_piece(finer, pieces, np.asarray(point, dtype=np.float64))
        _add_carriage(spec, self.point, self.direction, f"plant_{held}", self._pads, params.timestep)
        self.model: Any = spec.compile()
        self.mechanics = PlantMechanics(self.model, finer, pieces)
        self.air = Air(self.mechanics, truth.wind, plant.seed)
        self._held = int(self.mechanics.bodies[held])
        self._carriage = int(self.model.joint("carriage").dofadr[0])
        self._linear, self._drag = self._linearised()

    def steady(self, amplitude: float, frequency: float) -> Shaken:
        """Shake by `amplitude` [m] at `frequency` [Hz] and return the steady motion.

        Raises:
            StageFailure: "no_convergence": the simulation became unstable.
        """
        check_range("shake amplitude", amplitude, 0, 1, "m")
        m, p, omega = self.model, self.params, 2 * np.pi * frequency
        data, dt, dofs = mujoco.MjData(m), self.params.timestep, self.mechanics.dofs
        motion = amplitude * self._phasor(frequency, amplitude)
        data.qpos[m.jnt_qposadr[self.mechanics.joints]] = motion.imag
        data.qvel[dofs] = (omega * motion).real
        self._start_pads(data, motion, omega, amplitude)
        settled = max(1 / frequency, p.settle)
        steps = round((settled + max(2, np.ceil(p.measure * frequency)) / frequency) / dt)
        every = max(1, int(1 / (p.samples * frequency * dt)))
        place = amplitude * np.sin(omega * dt * np.arange(-1, steps + 1))
        speed = np.diff(place) / dt  # differences, as the integrator takes them: then its steps follow the sine exactly
        push = CARRIAGE_MASS * np.diff(speed) / dt
        rows: list[tuple[float, Array]] = []
        for i in range(steps):
            data.qpos[self._carriage], data.qvel[self._carriage] = place[i + 1], speed[i]
            data.qfrc_applied[dofs] = -self._drag @ (self._drag.T @ data.qvel[dofs])
            data.qfrc_applied[self._carriage] = push[i]
            self.air.push(data, dt)
            if i * dt >= settled and i % every == 0:
                rows.append((i * dt, data.qpos.copy()))
            mujoco.mj_step(m, data)
        if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
            raise StageFailure("no_convergence", f"the shaken plant became unstable ({frequency:g} Hz).")
        return self._measured(np.array([t for t, _ in rows]), np.array([q for _, q in rows]), frequency)

    def swing(self, amplitude: float, frequency: float, times: Array) -> Array:
        """Return (T, nq) the configurations in the steady swing of the linear equations, for `segment_poses`.

        Args:
            amplitude: of the grip [m].
            frequency: [Hz].
            times: (T,) [s]; the grip moves as sin(2 pi f t).
        """
        motion = amplitude * self._phasor(frequency, amplitude)
        out = np.zeros((len(times), self.model.nq))
        turned = np.exp(2j * np.pi * frequency * np.asarray(times))[:, None] * motion
        out[:, self.model.jnt_qposadr[self.mechanics.joints]] = turned.imag
        return out

    def segment_poses(self, qpos: Array) -> Array:
        """Return T_world_rest (K, 4, 4) of the plant's segments at one configuration (nq,)."""
        data = mujoco.MjData(self.model)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, data)
        return self.mechanics.segment_poses(data)[self._part]

    def linear(
        self, frequencies: ArrayLike, amplitude: float = 0.0, *, loss_factor: float | None = None
    ) -> NDArray[np.complex128]:
        """Return (Q, F, 3) what shakes do to the flowers, per metre of grip motion.

        Args:
            frequencies: (Q,) [Hz].
            amplitude: of the grip [m], at which the air's drag is taken; 0 is a shake too small to feel it.
            loss_factor: of hysteretic damping instead of the plant's own: springs times 1 + i loss_factor.
        """
        bodies = self.mechanics.bodies[self.mechanics.pieces.body[self._part[self.plant.flower_segment]]]
        flowers = self._jacobians(bodies, self.plant.flower_position)
        phasors = self._phasors(frequencies, amplitude, loss_factor)
        return np.array([np.tensordot(flowers, phasor, 1) for phasor in phasors])

    def bending(
        self, frequencies: ArrayLike, amplitude: float = 0.0, *, loss_factor: float | None = None
    ) -> NDArray[np.complex128]:
        """Return (Q, B, 2) the bending strain that shakes cause at each piece's root, per metre of grip motion [1/m].

        Arguments as of `linear`.
        """
        return np.array([self.mechanics.bending(p) for p in self._phasors(frequencies, amplitude, loss_factor)])

    def across(self, frequencies: ArrayLike) -> Across:
        """Return what small shakes (Q,) [Hz] along world x and y do, whatever the plant's own direction.

        Any shake across is a sum of both.
        """
        (mass, damping, stiffness, _), pieces = self._linear, self.mechanics.pieces
        plant, bodies = self.mechanics.plant, self.mechanics.bodies
        base = plant.leaf_bases()
        flowers = self._jacobians(bodies[pieces.body[plant.flower_segment]], plant.flower_position)
        leaves = self._jacobians(bodies[pieces.body[base]], plant.start[base])
        rows = []
        for omega in 2 * np.pi * np.atleast_1d(np.asarray(frequencies, dtype=np.float64)):
            dynamic = stiffness + 1j * omega * damping - omega**2 * mass
            motion, load = self._held_motion(dynamic, omega, np.eye(5, 2))
            bent = np.stack([self.mechanics.bending(one) for one in motion.T])
            rows.append((*(np.moveaxis(jacobian @ motion, 2, 0) for jacobian in (flowers, leaves)), bent, load.T))
        return Across(*map(np.array, zip(*rows, strict=True)))

    def by_kind(self, strain: Array) -> dict[str, Array]:
        """Return kind of `sim.truth.TOLERANCE` -> those of the pieces' strains (..., B) that count for it."""
        return by_kind(self.mechanics.plant, self.mechanics.pieces, strain)

    def flower_stalks(self, strain: Array) -> tuple[Array, Array]:
        """Return (..., F) the largest of the pieces' strains (..., B) in each flower's pedicel, and in its peduncle."""
        return of_flower_stalks(self.mechanics.plant, self.mechanics.pieces, strain)

    def force(self, frequency: float) -> NDArray[np.complex128]:
        """Return (3,) the force of a small shake between pads and plant, across, per metre of grip motion [N/m]."""
        mass, damping, stiffness, _ = self._linear
        omega = 2 * np.pi * frequency
        _, load = self._held_motion(stiffness + 1j * omega * damping - omega**2 * mass, omega)
        return np.append(load[:2], 0.0)

    def _start_pads(self, data: Any, motion: NDArray[np.complex128], omega: float, amplitude: float) -> None:
        """Put soft pads where the steady motion of the hinges (D,) has them."""
        if not np.isfinite(self._pads).all():
            return
        held, first = self._linear[3] @ motion, int(self.model.joint("pads_0").dofadr[0])
        data.qpos[first : first + 5] = held.imag
        data.qvel[first : first + 5] = omega * held.real
        data.qvel[first : first + 2] -= omega * amplitude * self.direction[:2]

    def _measured(self, times: Array, qpos: Array, frequency: float) -> Shaken:
        data, k = mujoco.MjData(self.model), self.plant.flower_segment
        flowers, grip = np.empty((len(times), len(k), 3)), np.empty((len(times), 3))
        for i, q in enumerate(qpos):
            data.qpos[:] = q
            mujoco.mj_kinematics(self.model, data)
            T = self.mechanics.segment_poses(data)[self._part[k]]
            flowers[i] = transform_each(T, self.plant.flower_position)
            grip[i] = data.xpos[self._held]
        half = len(times) // 2
        early, late, whole = (
            np.array([fit_swing(times[part], flowers[part, f], frequency).amplitude for f in range(len(k))])
            for part in (slice(None, half), slice(half, None), slice(None))
        )
        moved = fit_swing(times, np.outer(grip @ self.direction, self.direction), frequency).amplitude
        return Shaken(
            times,
            flowers,
            qpos,
            whole,
            moved,
            float(np.max(np.abs(late - early), initial=0.0) / max(whole.mean(), 1e-12)),
        )

    def _linearised(self) -> tuple[tuple[Array, Array, Array, Array], Array]:
        """Return mass, damping and stiffness (D, D) about rest, and the held piece's Jacobian (5, D), height free.

        Then the factor (D, K) of that part of the damping which the hinges do not have, see `underdamped`.
        """
        m, d = self.model, self.mechanics.dofs
        data = mujoco.MjData(m)
        mujoco.mj_forward(m, data)
        mass = np.zeros((m.nv, m.nv))
        mujoco.mj_fullM(m, data, mass)
        mass, stiffness = mass[np.ix_(d, d)], self.mechanics.stiffness(data)
        place, turn = np.zeros((3, m.nv)), np.zeros((3, m.nv))
        mujoco.mj_jac(m, data, place, turn, self.point, self._held)
        grip = np.concatenate([place[:2], turn])[:, d]
        free = np.linalg.qr(grip.T, mode="complete")[0][:, len(grip) :]
        values, modes = eigh(free.T @ stiffness @ free, free.T @ mass @ free)
        slow, lacking = self.mechanics.underdamped(values, free @ modes)
        drag = mass @ slow * np.sqrt(lacking)
        return (mass, np.diag(m.dof_damping[d]) + drag @ drag.T, stiffness, grip), drag

    def _phasors(
        self, frequencies: ArrayLike, amplitude: float, loss_factor: float | None
    ) -> list[NDArray[np.complex128]]:
        return [self._phasor(float(f), amplitude, loss_factor) for f in np.atleast_1d(frequencies)]

    def _phasor(
        self, frequency: float, amplitude: float = 0.0, loss_factor: float | None = None
    ) -> NDArray[np.complex128]:
        """Return (D,) the steady linear motion of the hinges per metre of grip motion, x(t) = Im(x exp(i w t))."""
        mass, damping, stiffness, _ = self._linear
        omega = 2 * np.pi * frequency
        springs = self.model.jnt_stiffness[self.mechanics.joints]
        loss = omega * damping if loss_factor is None else np.diag(loss_factor * springs)
        undragged = stiffness + 1j * loss - omega**2 * mass
        motion, _ = self._held_motion(undragged, omega)
        for _ in range(SOFTENINGS if amplitude > 0 and not self.air.still else 0):
            velocity = omega * amplitude * np.tensordot(self._centres, motion, 1)
            drag = self.air.linear(semi_major(velocity))[self._blown]
            rows = self._centres[self._blown].reshape(-1, len(motion))
            motion, _ = self._held_motion(undragged + 1j * omega * (rows.T * np.repeat(drag, 3)) @ rows, omega)
        return motion

    def _held_motion(
        self, dynamic: NDArray[np.complex128], omega: float, wanted: Array | None = None
    ) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Return (D,) what the dynamic stiffness (D, D) answers to a metre of grip motion, and the pads' load (5,).

        `wanted`: (5, n) other motions of the grip, two across and three turns; then (D, n) and (5, n).
        """
        grip = self._linear[3]
        reached = np.linalg.solve(dynamic, grip.T.astype(np.complex128))
        give = np.diag(1 / self._pads / (1 + 1j * omega * PAD_LOSS))
        wanted = np.concatenate([self.direction[:2], np.zeros(3)]) if wanted is None else wanted
        load = np.linalg.pinv(grip @ reached + give, rcond=1e-9) @ wanted
        return reached @ load, load

    @cached_property
    def _centres(self) -> Array:
        """(B, 3, D) Jacobians of the pieces' centres of mass at rest."""
        m, data = self.model, mujoco.MjData(self.model)
        mujoco.mj_forward(m, data)
        out = np.zeros((len(self.mechanics.bodies), 3, m.nv))
        for row, body in zip(out, self.mechanics.bodies, strict=True):
            mujoco.mj_jacBodyCom(m, data, row, None, int(body))
        return out[:, :, self.mechanics.dofs]

    @cached_property
    def _blown(self) -> NDArray[Any]:
        """Pieces on which there is drag."""
        return np.flatnonzero(self.air.linear(np.ones(len(self.mechanics.bodies))))

    def _jacobians(self, bodies: NDArray[Any], places: Array) -> Array:
        """Return (n, 3, D) of places (n, 3) on bodies (n,) at rest."""
        m, data = self.model, mujoco.MjData(self.model)
        mujoco.mj_forward(m, data)
        out = np.zeros((len(bodies), 3, m.nv))
        for row, body, place in zip(out, bodies, places, strict=True):
            mujoco.mj_jac(m, data, row, None, place, int(body))
        return out[:, :, self.mechanics.dofs]


def _nearest_piece(plant: SimPlant, pieces: plant_mechanics.Pieces, point: Array) -> tuple[int, Array]:
    """Return the stem piece whose middle is nearest to a point, and that middle.

    The lowest is left out: clamped at its foot it cannot move without turning.
    """
    stem = [b for b in range(1, len(pieces.first)) if plant.organ[pieces.first[b]] == Organ.STEM]
    middles = []
    for b in stem:
        k = np.flatnonzero(pieces.body == b)
        middles.append((plant.start[k[0]] + plant.end[k[-1]]) / 2)
    nearest = int(np.argmin(np.linalg.norm(np.array(middles) - point, axis=1)))
    return stem[nearest], middles[nearest]


def _add_carriage(spec: Any, point: Array, direction: Array, held: str, pads: Array, dt: float) -> None:
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    carriage = spec.worldbody.add_body(name="carriage", pos=point, gravcomp=1)
    carriage.add_joint(name="carriage", type=slide, axis=direction)
    carriage.mass, carriage.explicitinertial, carriage.inertia = CARRIAGE_MASS, True, [CARRIAGE_MASS] * 3
    follower = carriage.add_body(name="follower", gravcomp=1)
    follower.add_joint(name="height", type=slide, axis=[0, 0, 1])
    firm = np.where(np.isfinite(pads), pads, 2e4 * np.repeat([1, 1e-4], [2, 3])) / (2 * np.pi * PAD_RESONANCE) ** 2
    follower.mass, follower.explicitinertial, follower.inertia = firm[0], True, [firm[2]] * 3
    for i, stiffness in enumerate(pads if np.isfinite(pads).all() else ()):
        spring = follower.add_joint(name=f"pads_{i}", type=slide if i < 2 else hinge)
        spring.axis = np.eye(3)[i if i < 2 else i - 2]
        spring.stiffness, spring.damping = [stiffness, 0, 0], [PAD_LOSS * stiffness, 0, 0]
    tie = spec.add_equality(type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY)
    tie.name1, tie.name2 = "follower", held
    tie.data[:3] = 0.0  # the anchor lies in the piece; that of a new weld lies 1 m beside it
    tie.solimp, tie.solref = [0.9999, 0.9999, 0.001, 0.5, 2], [2 * dt, 1]  # the stiffest that MuJoCo has
