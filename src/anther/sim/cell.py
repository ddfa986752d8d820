"""The simulated cell: arm, gripper, plant, pot and bench in one MuJoCo world, and a log of all that happens in it.

The world runs only while somebody commands it (`run`). Ground truth stays here: stages see devices, not this module.
T log samples, C contacts, K plant segments.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from enum import IntEnum
from itertools import takewhile
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from anther.core.errors import StageFailure
from anther.core.geometry import Array, Box, transform
from anther.robot.arm.model import ArmModel
from anther.robot.arm.sawyer import SAWYER
from anther.sim import arm_model
from anther.sim.pieces import Params as Cut
from anther.sim.plant import GRAVITY, Organ, SimPlant
from anther.sim.plant_mechanics import PlantMechanics, add_plant, mujoco
from anther.sim.row_house import Block, Part
from anther.sim.sway import Air
from anther.sim.truth import NOMINAL, Truth

POT, BENCH, NEIGHBOUR = range(-1, -4, -1)
"""What a contact's `other` says when it is not a plant segment."""


class _Bit(IntEnum):
    """Of MuJoCo's contact masks: what a geometry is."""

    PLANT, ROBOT, SCENERY = 1, 2, 4


@dataclass(frozen=True, slots=True)
class Params:
    """The world's numerics. Petioles do not twist here: leaves that an arm crushed made the integrator unstable.

    Attributes:
        timestep: of the integrator [s]. With implicitfast every hinge needs damping/stiffness >= 0.7 dt, so the
            timestep bounds the damping of pedicels from below: 3.3 % at 30 Hz with 0.5 ms, 6.6 % with 1 ms.
        plant: how it is cut and damped.
        grip_force: what the gripper holds with at most, both fingers alike [N].
        coil_force: of the motor that shakes the fingers, at most [N]; 0: there is none.
    """

    timestep: float = 1e-3
    plant: Cut = field(default_factory=lambda: Cut(twisting=(Organ.STEM, Organ.BRANCH, Organ.PEDUNCLE)))
    grip_force: float = arm_model.GRIP_FORCE
    coil_force: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class CellLog:
    """Everything that happened, sampled.

    Attributes:
        times: (T,) [s].
        qpos: (T, nq) generalised positions of the whole world.
        joints: (T, J) of the arm's motors [rad].
        torques: (T, J) of its motors [N m].
        grip_command, opening: (T,) commanded and true distance between the pads [m].
        contact_sample: (C,) log sample of each contact of the robot with plant, pot or bench.
        contact_pad: (C,) 0 left pad, 1 right pad, 2 any other part of the robot.
        contact_other: (C,) plant segment, or POT or BENCH, or NEIGHBOUR: another plant or its string.
        contact_blade: (C,) bool, whether it is the leaf blade that rides on that segment.
        contact_force: (C,) normal force [N].
        contact_point: (C, 3) world [m].
    """

    times: Array
    qpos: Array
    joints: Array
    torques: Array
    grip_command: Array
    opening: Array
    contact_sample: NDArray[Any]
    contact_pad: NDArray[Any]
    contact_other: NDArray[Any]
    contact_blade: NDArray[Any]
    contact_force: Array
    contact_point: Array


class Cell:
    """One plant in front of one arm.

    Attributes:
        plant: ground truth.
        truth: of air, pads, arm and side camera.
        arm: its description.
        model, data: MuJoCo's.
        mechanics: the plant's part of the model.
    """

    fine = 4
    """Steps in one of the cell while a plant is held: in steps of 1, 0.5, 0.25 ms flowers swing 34, 12 and 3 % less at
    27 Hz than in steps of 0.125 ms, since hinges' least damping goes with the step (tomato 10)."""

    def __init__(
        self,
        plant: SimPlant,
        joints: ArrayLike | None = None,
        params: Params | None = None,
        truth: Truth = NOMINAL,
        arm: ArmModel = SAWYER,
        solids: Sequence[Box] = (),
        obstacles: Sequence[Part] = (),
    ) -> None:
        """Build the world, plant at rest under gravity, arm at `joints` (J,) [rad] or neutral, gripper open.

        `solids` and `obstacles` stand there besides pot and bench, and count as bench; but for a row's neighbours.
        """
        self.plant, self.params, self.truth, self.arm = plant, params or Params(), truth, arm
        spec = _world(self.params.timestep, plant, solids, obstacles)
        pieces = add_plant(spec, plant, self.params.plant, contype=_Bit.PLANT)
        forces = {"grip_force": self.params.grip_force, "coil_force": self.params.coil_force}
        scatter = truth.joint_scatter * np.random.default_rng([plant.seed, 9]).normal(size=arm.count)
        sprung = replace(arm, stiffness=arm.stiffness * np.exp(scatter))
        arm_model.add_arm(spec, sprung, truth, **forces, contype=_Bit.ROBOT, conaffinity=_Bit.PLANT)
        stems = np.flatnonzero(np.isin(plant.organ, (Organ.STEM, Organ.BRANCH, Organ.PEDUNCLE)))
        arm_model.add_grips(spec, [f"segment_{k}" for k in stems])
        self.model: Any = spec.compile()
        self.data: Any = mujoco.MjData(self.model)
        self._arm = np.array([self.model.joint(name).qposadr[0] for name in arm.joints])
        self._arm_dofs = np.array([self.model.joint(name).dofadr[0] for name in arm.joints])
        self._fingers = [self.model.joint(f"{side}_finger").qposadr[0] for side in ("left", "right")]
        self._flex = _addresses(self.model, [arm_model.flex_name(name) for name in arm.joints])
        self._motor = _addresses(self.model, ["motor"])
        self._give = [_addresses(self.model, [f"left_pad_{way}", f"right_pad_{way}"]) for way in arm_model.PAD_WAYS]
        errors = np.random.default_rng([plant.seed, 8]).normal(size=arm.count)
        self._expected = 1 + truth.feedforward_error * errors
        self._grip = 3 * arm.count  # after the joints' positions, velocities and torques
        joints = arm.neutral if joints is None else joints
        self.data.qpos[self._arm], self.data.qpos[self._fingers] = joints, arm.tool.stroke / 2
        self.data.ctrl[: arm.count], self.data.ctrl[self._grip] = joints, arm.tool.stroke / 2
        arm_model.tune_servos(self.model, sprung, truth)
        self.mechanics = PlantMechanics(self.model, plant, pieces)
        self._air = Air(self.mechanics, truth.wind, plant.seed)
        self._codes = _contact_codes(self.model)
        self._samples: list[tuple[Any, ...]] = []
        self._contacts: list[tuple[Any, ...]] = []
        self._scratch, self._parts = mujoco.MjData(self.model), 1
        mujoco.mj_forward(self.model, self.data)
        self._note()

    @property
    def time(self) -> float:
        """Simulated time since the cell was built [s]."""
        return float(self.data.time)

    @property
    def timestep(self) -> float:
        """Of the integrator at present [s]."""
        return float(self.model.opt.timestep)

    @contextmanager
    def finer(self, parts: int) -> Iterator[None]:
        """Step `parts` times as finely meanwhile, with the plant damped as that allows; the log stays as dense."""
        m, plant = self.model, self.mechanics
        before = m.opt.timestep
        m.opt.timestep, self._parts = before / parts, parts
        plant.damp(m.opt.timestep)
        try:
            yield
        finally:
            m.opt.timestep, self._parts = before, 1
            plant.damp(before)

    @property
    def joints(self) -> Array:
        """(J,) true angles of the arm's motors, which its encoders read [rad]."""
        return self.data.qpos[self._arm].copy()

    @property
    def opening(self) -> float:
        """Distance between the pads [m]."""
        return float(self.data.qpos[self._fingers].sum())

    @property
    def held(self) -> bool:
        """Whether something keeps the pads apart."""
        return self.opening > self.grip_command + 2e-4

    @property
    def grip_command(self) -> float:
        """Commanded distance between the pads [m]."""
        return 2 * float(self.data.ctrl[self._grip])

    @property
    def arm_command(self) -> Array:
        """(J,) last commanded joint angles [rad]."""
        return self.data.ctrl[: self.arm.count].copy()

    @property
    def motor_command(self) -> tuple[float, float]:
        """Last commanded place [m] and speed [m/s] of the gripper's motor, which the truth's gain does not change."""
        place, speed = self.data.ctrl[self._grip + 1 : self._grip + 3] / self.truth.motor_gain
        return float(place), float(speed)

    @property
    def grip_force(self) -> float:
        """Force of either finger on what is between them [N]."""
        return float(abs(self.data.actuator_force[self._grip]) / 2)

    def carriage_at(self, qpos: Array | None = None) -> Array:
        """Return where the motor has the fingers now, or at logged `qpos` (..., nq), along the flange's y [m].

        (), or (...); 0 without a motor.
        """
        at: Array = self.data.qpos if qpos is None else qpos
        return at[..., self._motor].sum(axis=-1)

    def carriage_path(self, seconds: float) -> Array:
        """Return (T,) where the carriage was in the last `seconds` of the log [m]."""
        last = takewhile(lambda sample: sample[0] > self.time - seconds, reversed(self._samples))
        return np.array([float(self.carriage_at(sample[1])) for sample in last])[::-1]

    def run(
        self,
        joints: Array,
        velocities: Array,
        openings: Array,
        accelerations: Array | None = None,
        motor: Array | None = None,
    ) -> Array:
        """Advance one timestep per row of joint references; return the measured joints.

        Args:
            joints, velocities: (N, J) references [rad], [rad/s].
            openings: (N,) commanded distance between the pads [m].
            accelerations: (N, J) references [rad/s^2]; None takes the differences of the velocities.
            motor: (N, 3) references of the gripper's motor: place [m], speed [m/s], acceleration [m/s^2]; None: still.

        Returns:
            (N, J) measured joints after each step [rad].
        """
        if accelerations is None:
            accelerations = np.diff(velocities, axis=0, append=velocities[-1:]) / self.timestep
        measured = np.empty_like(joints)
        motor = np.zeros((len(joints), 3)) if motor is None else motor
        for i, row in enumerate(zip(joints, velocities, accelerations, openings, motor, strict=True)):
            self._step(*row)
            measured[i] = self.data.qpos[self._arm]
        return measured

    def _step(self, q: Array, v: Array, a: Array, opening: float, motor: Array) -> None:
        m, d = self.model, self.data
        plant, inertia = self.mechanics.dofs, np.empty(m.nv)
        motion = np.zeros(m.nv)
        motion[self._arm_dofs] = a
        mujoco.mj_step1(m, d)
        mujoco.mj_mulM(m, d, inertia, motion)
        n, grip = self.arm.count, self._grip
        d.ctrl[:n], d.ctrl[n : 2 * n], d.ctrl[grip] = q, v, opening / 2
        d.ctrl[2 * n : grip] = self._expected * inertia[self._arm_dofs]
        if len(self._motor):
            d.ctrl[grip + 1 :] = self._coil(motor)
        d.qfrc_applied[plant] = self.mechanics.drag(d)
        self._air.push(d, m.opt.timestep)
        mujoco.mj_step2(m, d)
        if d.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
            raise StageFailure("no_convergence", f"the simulated cell became unstable at {d.time:.3f} s.")
        every = 2  # one sample is logged in so many steps
        if round(d.time / m.opt.timestep) % (self._parts * every) == 0:
            self._note()

    def _coil(self, motor: Array) -> Array:
        """Return the voice coil's controls (3,): place, speed, and the force that mass and flexures ask for."""
        place, speed, acceleration = self.truth.motor_gain * motor
        return np.array([place, speed, arm_model.motor_load(place, speed, acceleration)])

    def _note(self) -> None:
        d, sample = self.data, len(self._samples)
        self._samples.append((d.time, d.qpos.copy(), d.qfrc_actuator[self._arm_dofs].copy(), self.grip_command))
        if not d.ncon:
            return
        pair = self._codes[d.contact.geom]
        robot_first = pair[:, :1, 0] >= 0
        robot, other = np.where(robot_first, pair[:, 0], pair[:, 1]), np.where(robot_first, pair[:, 1], pair[:, 0])
        row = d.contact.efc_address  # of the normal force, with elliptic cones; -1 without one
        force = np.where(row >= 0, d.efc_force[row], 0.0)
        here = np.full(d.ncon, sample)
        self._contacts.append((here, robot[:, 0], other[:, 1], other[:, 2], force, d.contact.pos.copy()))

    def forget(self) -> None:
        """Begin clock and log anew: what was before is nobody's doing."""
        self.data.time = 0.0
        self._samples, self._contacts = [], []
        self._note()

    def log(self) -> CellLog:
        """Return all samples so far."""
        times, qpos, torques, command = (np.array(x) for x in zip(*self._samples, strict=True))
        columns = [np.concatenate(x) for x in zip(*self._contacts, strict=True)] or [np.zeros(0)] * 6
        sample, pad, other, blade, force, point = columns
        return CellLog(
            times=times,
            qpos=qpos,
            joints=qpos[:, self._arm],
            torques=torques,
            grip_command=command,
            opening=qpos[:, self._fingers].sum(axis=1),
            contact_sample=sample.astype(int),
            contact_pad=pad.astype(int),
            contact_other=other.astype(int),
            contact_blade=blade.astype(bool),
            contact_force=force.astype(float),
            contact_point=point.reshape(-1, 3).astype(float),
        )

    def segment_poses(self, qpos: Array | None = None) -> Array:
        """Return T_world_rest (K, 4, 4) of the plant's segments now, or at a logged `qpos` (nq,)."""
        return self.mechanics.segment_poses(self._at(qpos))

    def flange_pose(self, qpos: Array | None = None) -> Array:
        """Return T_world_flange (..., 4, 4) now, or at logged `qpos` (..., nq): where the links truly are."""
        at: Array = self.data.qpos if qpos is None else qpos
        links = at[..., self._arm]
        return self.arm.forward(links + at[..., self._flex] if len(self._flex) else links)

    def pads_pose(self, qpos: Array | None = None) -> Array:
        """Return T_world_pads (4, 4) now, or at a logged `qpos` (nq,): the flange's frame, carried along by the pads.

        It moves on the flange as the motor has the fingers, and by the mean of what both pads give way.
        """
        at: Array = self.data.qpos if qpos is None else qpos
        y = float(self.carriage_at(at))
        x, z, turn = (float(at[ways].mean()) if len(ways) else 0.0 for ways in self._give)
        centre = self.arm.tool.T_flange_grasp[:3, 3]
        R = Rotation.from_rotvec([0, turn, 0]).as_matrix()
        return self.flange_pose(at) @ transform(R, centre - R @ centre + np.array([x, y, z]))

    def _at(self, qpos: Array | None) -> Any:
        if qpos is None:
            return self.data
        self._scratch.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self._scratch)
        return self._scratch


def _addresses(model: Any, joints: list[str]) -> NDArray[Any]:
    """Return where in qpos these joints are, all of them or none."""
    there = [joint for joint in joints if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint) >= 0]
    return np.array([model.joint(joint).qposadr[0] for joint in there], dtype=int)


def _world(timestep: float, plant: SimPlant, solids: Sequence[Box], obstacles: Sequence[Part]) -> Any:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    option = spec.option
    option.timestep, option.gravity = timestep, [0, 0, -GRAVITY]
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    option.cone, option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 10
    bits: dict[str, int] = {"contype": _Bit.SCENERY, "conaffinity": _Bit.ROBOT}
    if plant.pot.radius:
        _add_pot(spec.worldbody, plant, bits)
    for i, box in enumerate(solids):
        middle, half = (box.lower + box.upper) / 2, (box.upper - box.lower) / 2
        spec.worldbody.add_geom(name=f"bench_{i}", type=mujoco.mjtGeom.mjGEOM_BOX, pos=middle, size=half, **bits)
    for i, part in enumerate(obstacles):
        _add_obstacle(spec.worldbody, i, part, bits)
    return spec


def _add_pot(world: Any, plant: SimPlant, bits: dict[str, int]) -> None:
    pot = plant.pot
    world.add_geom(
        name="pot",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        pos=pot.centre - [0, 0, pot.height / 2],
        size=[pot.radius, pot.height / 2, 0],
        **bits,
    )
    world.add_geom(
        name="bench",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[pot.centre[0] + 0.1, pot.centre[1], pot.bench_z - 0.02],
        size=(0.35, 0.5, 0.02),
        **bits,
    )


def _add_obstacle(world: Any, number: int, part: Part, bits: dict[str, int]) -> None:
    kind = "neighbour" if part.name in ("neighbour", "string") else "bench"
    name = f"{kind}_{part.name}_{number}"
    if isinstance(part, Block):
        middle, half = (part.box.lower + part.box.upper) / 2, (part.box.upper - part.box.lower) / 2
        world.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_BOX, pos=middle, size=half, **bits)
        return
    ends, size = [*part.start, *part.end], [part.radius, 0, 0]
    world.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=ends, size=size, **bits)


def _contact_codes(model: Any) -> NDArray[Any]:
    """Return (geoms, 3): part of the robot (0, 1 pads, 2 rest, -9 none); what it touches; whether that is a blade.

    It touches a segment, POT, BENCH or NEIGHBOUR.
    """
    named = {"left_pad": (0, -9, 0), "right_pad": (1, -9, 0), "pot": (-9, POT, 0)}
    codes = np.full((model.ngeom, 3), -9)
    for i in range(model.ngeom):
        name = model.geom(i).name
        if name.startswith(("segment_", "blade_")):
            codes[i] = (-9, int(name.rpartition("_")[2]), name.startswith("blade_"))
        elif name.startswith("bench"):
            codes[i] = (-9, BENCH, 0)
        elif name.startswith("neighbour"):
            codes[i] = (-9, NEIGHBOUR, 0)
        else:
            codes[i] = named.get(name, (2, -9, 0))
    return codes
