"""The plant as MuJoCo bodies: rigid tapered pieces on sprung hinges. Its numbers come from plant truth alone.

An unbranched run of segments becomes a chain of rigid pieces. Between two pieces stand two crossed hinges whose
stiffness is that of half of either piece, 1/k = l1/(2 E I1) + l2/(2 E I2); where a chain is clamped only its own half
bends, k = 2EI/l (facts: libraries, the root joint must be 2EI/l). Twist is left out unless `Params.twist` asks for it.
K segments, B bodies, D degrees of freedom.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco as mujoco_module
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from anther.errors import StageFailure
from anther.geometry import Array
from anther.sim.plant import Organ, SimPlant

mujoco: Any = mujoco_module  # its names come from C++ at run time; type checkers do not see them

CONTINUES = {int(Organ.STEM): int(Organ.BRANCH), int(Organ.PETIOLE): int(Organ.RACHIS)}
"""Organs that run on into another without a clamp between them."""


FOLDED = 1.2
"""Angle at which a hinge stops [rad]: far beyond what tissue bears, and short of a right angle, where two crossed
hinges lose a direction and a plant pushed aside would spin without bound."""


@dataclass(frozen=True, slots=True)
class Params:
    """How finely the plant is cut and how it is damped.

    Attributes:
        piece: longest rigid piece [m]; a cantilever of 20 pieces has its first frequency within 0.3 %.
        bend: a piece ends where the plant turns by more than this [rad].
        flutter: frequency [Hz] at which, beside the plant's first mode, damping equals `damping_ratio` (Rayleigh).
        stiffest: hinges carry so much rotor inertia that none swings faster than this [Hz]; a mode at f is slowed by
            f^2 / (2 stiffest^2), 0.5 % at 30 Hz.
        least: pieces in an unbranched run at least, where it has that many segments.
        twist: EI/GJ of the stems, 12 for dicot petioles (facts: pollination 2), or None to leave twist out.
    """

    piece: float = 0.03
    bend: float = 0.5
    stiffest: float = 300.0
    least: int = 4
    flutter: float = 30.0
    twist: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """The cut: which segments form each rigid body, in an order where parents come first.

    Attributes:
        body: (K,) body of each segment.
        first: (B,) the body's first segment, whose start carries the hinges.
        parent: (B,) parent body or -1.
        stiffness: (B,) bending stiffness of the body's hinges [N m/rad].
    """

    body: NDArray[Any]
    first: NDArray[Any]
    parent: NDArray[Any]
    stiffness: Array


def cut(plant: SimPlant, params: Params) -> Pieces:
    """Cut the plant into rigid pieces and find the stiffness between them."""
    heir, body = _heirs(plant), np.full(len(plant.start), -1)
    chain = _chains(plant, heir)
    limit = np.minimum(params.piece, np.bincount(chain, plant.length) / params.least)
    first: list[int] = []
    parent: list[int] = []
    size: list[float] = []
    for k, p in enumerate(plant.parent):
        follows = p >= 0 and heir[p] == k and plant.organ[k] == plant.organ[p]
        fits = follows and size[body[p]] + plant.length[k] <= limit[chain[k]]
        if fits and _turn(plant, first[body[p]], k) < params.bend:
            body[k] = body[p]
            size[body[p]] += plant.length[k]
        else:
            body[k] = len(first)
            first.append(k)
            parent.append(int(body[p]) if p >= 0 else -1)
            size.append(plant.length[k])
    pieces = np.array(first)
    return Pieces(body, pieces, np.array(parent), _stiffness(plant, heir, chain[pieces], body, pieces))


def _stiffness(
    plant: SimPlant, heir: NDArray[Any], chain: NDArray[Any], body: NDArray[Any], first: NDArray[Any]
) -> Array:
    """Return (B,) hinge stiffnesses.

    Half-piece sums overstate a cantilever's deflection by 1 + 1/(2 n^2) for n equal pieces (the trapezoid rule's error
    on the integral of (L - s)^2), which is taken out: it matters for a pedicel of two pieces.
    """
    softness = np.bincount(body, _bending_compliance(plant))
    before = plant.parent[first]
    continues = (before >= 0) & (heir[before] == first)
    softness += np.where(continues, softness[body[before]], 0.0)
    return 2 / softness * (1 + 0.5 / np.bincount(chain)[chain] ** 2)


def _chains(plant: SimPlant, heir: NDArray[Any]) -> NDArray[Any]:
    """Return (K,) the number of the unbranched run each segment belongs to."""
    chain, count = np.empty(len(heir), dtype=int), 0
    for k, p in enumerate(plant.parent):
        follows = p >= 0 and heir[p] == k
        chain[k] = chain[p] if follows else count
        count += not follows
    return chain


def _bending_compliance(plant: SimPlant) -> Array:
    """Return (K,) integral of ds / (E I) along each segment whose radius goes linearly from a to b [rad/(N m)]."""
    a, b = plant.radius_start, plant.radius_end
    return plant.length * (a * a + a * b + b * b) / (3 * (a * b) ** 3) / (plant.youngs * np.pi / 4)


def _heirs(plant: SimPlant) -> NDArray[Any]:
    """Return for each segment the child that continues it (same organ or its natural next, the straightest), or -1."""
    heir, best = np.full(len(plant.start), -1), np.full(len(plant.start), -np.inf)
    for k, p in enumerate(plant.parent):
        if p < 0 or int(plant.organ[k]) not in (int(plant.organ[p]), CONTINUES.get(int(plant.organ[p]))):
            continue
        straight = -_turn(plant, int(p), k)
        if straight > best[p]:
            heir[p], best[p] = k, straight
    return heir


def _turn(plant: SimPlant, a: int, b: int) -> float:
    u, v = plant.end[a] - plant.start[a], plant.end[b] - plant.start[b]
    return float(np.arccos(np.clip(u @ v / np.linalg.norm(u) / np.linalg.norm(v), -1, 1)))


def add_plant(spec: Any, plant: SimPlant, params: Params, *, contype: int, conaffinity: int) -> Pieces:
    """Add the plant's bodies `plant_<b>`, hinges and contact capsules `segment_<k>` to a world.

    Stems, branches, petioles, rachises, peduncles and pedicels touch; petals do not: they are masses only, and leaf
    blades, with their midribs, are left to `blades.add_blades`.

    Args:
        spec: the world; its timestep sets the least damping.
        contype, conaffinity: MuJoCo's collision bits of the capsules.
    """
    pieces = cut(plant, params)
    mass, com, inertia = _mass_properties(plant, pieces)
    bodies: list[Any] = []
    for b, k in enumerate(pieces.first):
        p = pieces.parent[b]
        origin = plant.start[k]
        holder = spec.worldbody if p < 0 else bodies[p]
        offset = origin if p < 0 else origin - plant.start[pieces.first[p]]
        body = holder.add_body(name=f"plant_{b}", pos=offset, explicitinertial=True)
        body.mass, body.ipos, body.fullinertia = mass[b], com[b] - origin, inertia[b]
        _add_hinges(body, plant, int(k), pieces.stiffness[b], params, dt=spec.option.timestep)
        bodies.append(body)
    radius = (plant.radius_start + plant.radius_end) / 2
    for k, b in enumerate(pieces.body):
        touches = plant.organ[k] != Organ.LEAF
        ends = np.concatenate([plant.start[k], plant.end[k]]) - np.tile(plant.start[pieces.first[b]], 2)
        bodies[b].add_geom(
            name=f"segment_{k}",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=ends,
            size=[radius[k], 0, 0],
            contype=contype * touches,
            conaffinity=conaffinity * touches,
            friction=[1.0, 0.005, 0.0001],
            group=2,
        )
    return pieces


def _add_hinges(body: Any, plant: SimPlant, k: int, stiffness: float, params: Params, *, dt: float) -> None:
    along = plant.end[k] - plant.start[k]
    along = along / np.linalg.norm(along)
    across = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    across /= np.linalg.norm(across)
    axes = [(across, 1.0), (np.cross(along, across), 1.0)]
    axes += [(along, 1 / params.twist)] if params.twist else []
    # implicitfast takes springs explicitly and dampers implicitly: damping/stiffness >= 0.7 dt keeps it stable
    beta = max(plant.damping_ratio[k] / (np.pi * params.flutter), 0.7 * dt)
    for axis, share in axes:
        joint = body.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
        joint.stiffness = [stiffness * share, 0, 0]
        joint.damping = [beta * stiffness * share, 0, 0]
        # no hinge is faster than `stiffest`: contact forces stay steady, and 30 Hz moves by 30^2 / (2 stiffest^2) only
        joint.armature = stiffness * share / (2 * np.pi * params.stiffest) ** 2
        joint.range, joint.limited, joint.solref_limit = [-FOLDED, FOLDED], 1, [4 * dt, 1]


def _mass_properties(plant: SimPlant, pieces: Pieces) -> tuple[Array, Array, Array]:
    """Return mass (B,), centre (B, 3) and MuJoCo's full inertia (B, 6) of the bodies: cylinders plus point lumps."""
    rod, length = plant.mass, plant.length
    r2 = rod / (plant.density * np.pi * length)
    u = (plant.end - plant.start) / length[:, None]
    across = np.eye(3) - u[:, :, None] * u[:, None, :]
    own = rod[:, None, None] * ((length**2 / 12 + r2 / 4)[:, None, None] * across)
    own += (rod * r2 / 2)[:, None, None] * (np.eye(3) - across)
    masses = np.concatenate([rod, plant.lump_mass])
    centres = np.concatenate([(plant.start + plant.end) / 2, plant.lump_centre])
    body = np.tile(pieces.body, 2)
    mass: Array = np.bincount(body, masses).astype(np.float64)
    com = np.stack([np.bincount(body, masses * c) for c in centres.T], axis=1) / mass[:, None]
    d = centres - com[body]
    steiner = masses[:, None, None] * ((d**2).sum(1)[:, None, None] * np.eye(3) - d[:, :, None] * d[:, None, :])
    steiner[: len(rod)] += own
    inertia = np.zeros((len(mass), 3, 3))
    np.add.at(inertia, body, steiner)
    i, j = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
    return mass, com, inertia[:, i, j]


class PlantMechanics:
    """The compiled plant: hangs in equilibrium, is damped, and tells where its segments are.

    Attributes:
        dofs: (D,) its degrees of freedom in the model.
        frequencies: (D,) natural frequencies about the rest shape [Hz], lowest first.
        mass_damping: the Rayleigh coefficient alpha [1/s].
    """

    def __init__(self, model: Any, plant: SimPlant, pieces: Pieces, params: Params) -> None:
        self.model, self.plant, self.pieces = model, plant, pieces
        self.bodies = np.array([model.body(f"plant_{b}").id for b in range(len(pieces.first))])
        self.joints = np.concatenate(
            [np.arange(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b]) for b in self.bodies]
        )
        self.dofs = model.jnt_dofadr[self.joints]
        data = mujoco.MjData(model)
        self._hang(data)
        self.frequencies, shapes = self._modes(data)
        self.mass_damping = self._air_damping(shapes[:, 0])
        self._rest_origin = plant.start[pieces.first]

    def _hang(self, data: Any) -> None:
        """Set the springs' references so that the generated shape carries its own weight (inverse statics)."""
        m = self.model
        mujoco.mj_forward(m, data)
        m.qpos_spring[m.jnt_qposadr[self.joints]] = data.qfrc_bias[self.dofs] / m.jnt_stiffness[self.joints]

    def _modes(self, data: Any) -> tuple[Array, Array]:
        m, d = self.model, self.dofs
        mass = np.zeros((m.nv, m.nv))
        mujoco.mj_fullM(m, data, mass)
        values, shapes = eigh(self.stiffness(data), mass[np.ix_(d, d)])
        if values[0] <= 0:
            raise StageFailure(
                "no_convergence", "the simulated plant cannot carry its own weight (it buckles): its stem is too soft."
            )
        return np.sqrt(values) / (2 * np.pi), shapes

    def stiffness(self, data: Any, step: float = 1e-5) -> Array:
        """Return (D, D) the springs and the change of the gravity torques with the hinge angles, at `data`'s place.

        The latter by central differences.
        """
        m, columns = self.model, []
        for address in m.jnt_qposadr[self.joints]:
            pair = []
            for sign in (1, -1):
                data.qpos[address] += sign * step
                mujoco.mj_kinematics(m, data)
                mujoco.mj_comPos(m, data)
                mujoco.mj_comVel(m, data)
                bias = np.zeros(m.nv)
                mujoco.mj_rne(m, data, 0, bias)
                data.qpos[address] -= sign * step
                pair.append(bias[self.dofs])
            columns.append((pair[0] - pair[1]) / (2 * step))
        K = np.array(columns)
        mujoco.mj_forward(m, data)
        return np.diag(m.jnt_stiffness[self.joints]) + (K + K.T) / 2

    def _air_damping(self, shape: Array) -> float:
        """Return alpha so that the first mode's ratio is the strain-energy mean of the segments' ratios."""
        m = self.model
        energy = m.jnt_stiffness[self.joints] * shape**2
        ratio = self.plant.damping_ratio[self.pieces.first][self._piece_of_joint()]
        wanted = float(energy @ ratio / energy.sum())
        omega = 2 * np.pi * self.frequencies[0]
        hinge = float(m.dof_damping[self.dofs] @ shape**2)
        return max(2 * omega * wanted - hinge, 0.0)

    def _piece_of_joint(self) -> NDArray[Any]:
        return np.repeat(np.arange(len(self.bodies)), self.model.body_jntnum[self.bodies])

    def air_force(self, data: Any) -> Array:
        """Return (D,) the mass-proportional part of Rayleigh damping, -alpha M v [N m]: the drag of air on leaves."""
        momentum = np.empty(self.model.nv)
        mujoco.mj_mulM(self.model, data, momentum, data.qvel)
        return -self.mass_damping * momentum[self.dofs]

    def segment_poses(self, data: Any) -> Array:
        """Return T_world_rest (K, 4, 4): maps a segment's generated position to the present one."""
        R = data.xmat[self.bodies].reshape(-1, 3, 3)
        T = np.tile(np.eye(4), (len(R), 1, 1))
        T[:, :3, :3] = R
        T[:, :3, 3] = data.xpos[self.bodies] - np.einsum("bij,bj->bi", R, self._rest_origin)
        return T[self.pieces.body]

    def strain(self, qpos: Array) -> Array:
        """Return (B,) the bending strain added at each body's root: hinge angle x radius / spacing.

        The spacing is EI/k, the length over which the hinge gathers the bending.
        """
        angle = qpos[self.model.jnt_qposadr[self.joints]]
        square = np.bincount(self._piece_of_joint(), angle**2)
        k = self.pieces.first
        radius = self.plant.radius_start[k]
        stiff = self.plant.youngs[k] * np.pi / 4 * radius**4
        return np.sqrt(square) * radius * self.pieces.stiffness / stiff
