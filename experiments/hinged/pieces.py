"""The plants in MuJoCo: rigid pieces on sprung hinges; their small-vibration response and their shaking in time.

A body is a node with the rigid halves of the edges that meet there; three crossed hinges stand in the middle of each
edge with the whole compliance of that edge, k = EI/l (twice) and GJ/l. Clamp and joints are then exact, and the error
is of second order in the edge length (a midpoint rule for the integral of moment / EI). The pieces cannot stretch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco as mujoco_module
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import eigh, null_space

from anther.elastic_rod import GRAVITY
from hinged.plants import (
    BEND_OVER_TWIST,
    DENSITY,
    MASS_DAMPING,
    VISCOUS_TIME,
    YOUNGS,
    Array,
    ComplexArray,
    Plant,
    Tree,
)

mujoco: Any = mujoco_module  # its names come from C++ at run time; type checkers do not see them

CARRIAGE_MASS = 1e6
"""[kg]: it does not feel the plant."""
EXTRA = 2
"""Degrees of freedom after the hinges: the carriage and the height of its follower."""


def pieces_of(plant: Plant, tree: Tree, dt: float, gravity: ArrayLike = GRAVITY) -> Any:
    """Return the compiled MuJoCo model, at rest in the generated shape, with a carriage tied to the grip node.

    The "discrete" integrator is linearly implicit in the springs, which adds k dt to the damping of a joint of
    stiffness k; the joints' own damping is lowered by as much. What remains is semi-implicit Euler.
    """
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.gravity = dt, gravity
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    bodies = [spec.worldbody]
    for j in range(1, len(tree.nodes)):
        bodies.append(_add_piece(bodies[tree.parent[j]], tree, j, VISCOUS_TIME - dt))
    _add_carriage(spec, plant, tree, dt)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    hinges = model.nv - EXTRA
    model.qpos_spring[:hinges] = data.qfrc_bias[:hinges] / model.jnt_stiffness[:hinges]
    return model


def _add_piece(holder: Any, tree: Tree, j: int, viscous_time: float) -> Any:
    """Add node j with its half of edge j to its parent node, which gets the other half."""
    p, radius = int(tree.parent[j]), tree.radius[j]
    edge = tree.nodes[j] - tree.nodes[p]
    length = np.linalg.norm(edge)
    along = edge / length
    across = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    across /= np.linalg.norm(across)
    body = holder.add_body(name=f"node_{j}", pos=edge + (tree.nodes[p] if p == 0 else 0))
    bend = YOUNGS * np.pi / 4 * radius**4 / length
    for axis, k in ((across, bend), (np.cross(along, across), bend), (along, bend / BEND_OVER_TWIST)):
        hinge = body.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis, pos=-edge / 2)
        hinge.stiffness, hinge.damping = [k, 0, 0], [viscous_time * k, 0, 0]
    cylinder = {"type": mujoco.mjtGeom.mjGEOM_CYLINDER, "size": [radius, 0, 0], "density": DENSITY}
    body.add_geom(fromto=[*(-edge / 2), 0, 0, 0], **cylinder)
    if p:
        holder.add_geom(fromto=[0, 0, 0, *(edge / 2)], **cylinder)
    return body


def _add_carriage(spec: Any, plant: Plant, tree: Tree, dt: float) -> None:
    slide = mujoco.mjtJoint.mjJNT_SLIDE
    carriage = spec.worldbody.add_body(name="carriage", pos=tree.nodes[tree.grip], gravcomp=1)
    carriage.add_joint(name="carriage", type=slide, axis=plant.axis)
    carriage.mass, carriage.explicitinertial, carriage.inertia = CARRIAGE_MASS, True, [CARRIAGE_MASS] * 3
    follower = carriage.add_body(name="follower", gravcomp=1)
    follower.add_joint(name="height", type=slide, axis=[0, 0, 1])
    follower.mass, follower.explicitinertial, follower.inertia = 1e-6, True, [1e-9] * 3
    tie = spec.add_equality(type=mujoco.mjtEq.mjEQ_CONNECT, objtype=mujoco.mjtObj.mjOBJ_BODY)
    tie.name1, tie.name2, tie.data[:3] = "follower", f"node_{tree.grip}", 0
    tie.solimp, tie.solref = [0.9999, 0.9999, 0.001, 0.5, 2], [2 * dt, 1]  # the stiffest that MuJoCo has


@dataclass(frozen=True, eq=False)
class Shaken:
    """The motion of the grip and the tips: times (S,) [s], positions (S, 1 + T, 3) [m]."""

    times: Array
    positions: Array


def shake(model: Any, tree: Tree, displacement: Array) -> Shaken:
    """Move the carriage through displacements (S,) [m], one a time step; the plant starts at rest."""
    data, dt = mujoco.MjData(model), model.opt.timestep
    speed = np.gradient(displacement, dt)
    push = CARRIAGE_MASS * np.gradient(speed, dt)
    seen = np.array([model.body(f"node_{j}").id for j in (tree.grip, *tree.tips)])
    momentum, positions = np.zeros(model.nv), np.zeros((len(displacement), len(seen), 3))
    for i in range(len(displacement)):
        data.qpos[-EXTRA], data.qvel[-EXTRA] = displacement[i], speed[i]
        mujoco.mj_mulM(model, data, momentum, data.qvel)
        data.qfrc_applied[:] = -MASS_DAMPING * momentum
        data.qfrc_applied[-EXTRA] = push[i]
        mujoco.mj_step(model, data)
        positions[i] = data.xpos[seen]  # of the start of the step
    return Shaken(np.arange(len(displacement)) * dt, positions)


@dataclass(frozen=True, eq=False)
class Linear:
    """MuJoCo's own mass, joint damping and stiffness matrices (D, D) at rest, and the Jacobians of grip and tips."""

    mass: Array
    damping: Array
    stiffness: Array
    grip: Array
    tips: Array

    def response(self, axis: Array, frequencies: ArrayLike, dt: float = 0.0) -> ComplexArray:
        """Return (Q, T, 3) tip motion per metre of grip motion along an axis (3,).

        With a time step dt [s] it is the response of the integrator, v' = v - dt M^-1 (K x + C v' + c M v), x' = x + dt
        v', to a sine: its error in time, of first order because the joints' damping is taken half a step late.
        """
        answers = []
        for omega in 2 * np.pi * np.asarray(frequencies, dtype=np.float64):
            late, early, square = 1j * omega, 1j * omega, omega**2
            if dt > 0:
                late, early = (np.exp(1j * omega * dt) - 1) / dt, (1 - np.exp(-1j * omega * dt)) / dt
                square = (2 - 2 * np.cos(omega * dt)) / dt**2
            dynamic = self.stiffness + late * self.damping + (MASS_DAMPING * early - square) * self.mass
            reached = np.linalg.solve(dynamic, self.grip.T.astype(np.complex128))
            force = np.linalg.pinv(self.grip @ reached, rcond=1e-9) @ axis  # the grip's height cannot move
            answers.append((self.tips @ reached @ force).reshape(-1, 3))
        return np.array(answers)

    def frequencies(self, *, held: bool) -> Array:
        """Return the natural frequencies [Hz], lowest first, with the grip held or without any grip."""
        ways = null_space(self.grip, rcond=1e-9) if held else np.eye(len(self.mass))
        squares = eigh(ways.T @ self.stiffness @ ways, ways.T @ self.mass @ ways, eigvals_only=True)
        return np.sqrt(squares) / (2 * np.pi)


def linearise(model: Any, tree: Tree) -> Linear:
    """Return the linear system about rest; the weight's share of the stiffness is its torques' central differences."""
    data, hinges = mujoco.MjData(model), model.nv - EXTRA
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    mass = mass[:hinges, :hinges]
    springs = model.jnt_stiffness[:hinges]
    places = [_jacobian(model, data, j)[:, :hinges] for j in (tree.grip, *tree.tips)]
    stiffness = np.diag(springs) + _weight_stiffness(model, data, hinges)
    return Linear(mass, np.diag(VISCOUS_TIME * springs), stiffness, places[0], np.concatenate(places[1:]))


def _jacobian(model: Any, data: Any, node: int) -> Array:
    jacobian, body = np.zeros((3, model.nv)), model.body(f"node_{node}").id
    mujoco.mj_jac(model, data, jacobian, None, data.xpos[body], body)
    return jacobian


def _weight_stiffness(model: Any, data: Any, hinges: int, step: float = 1e-5) -> NDArray[Any]:
    columns = []
    for i in range(hinges):
        pair = []
        for sign in (1, -1):
            data.qpos[i] = sign * step
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_comVel(model, data)
            bias = np.zeros(model.nv)
            mujoco.mj_rne(model, data, 0, bias)
            pair.append(bias[:hinges])
        data.qpos[i] = 0
        columns.append((pair[0] - pair[1]) / (2 * step))
    gradient = np.array(columns)
    return (gradient + gradient.T) / 2
