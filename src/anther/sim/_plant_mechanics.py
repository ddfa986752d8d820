"""The plant as MuJoCo bodies: rigid tapered pieces on sprung hinges. Its numbers come from plant truth alone.

An unbranched run of segments becomes a chain of rigid pieces. Between two pieces stand two crossed hinges, which share
the softness of the pieces beside them; every few pieces a third one, along the piece, lets the run twist.
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
from anther.sim._inertia import mass_properties
from anther.sim.plant import Organ, SimPlant

mujoco: Any = mujoco_module  # its names come from C++ at run time; type checkers do not see them

CONTINUES = {(Organ.STEM, Organ.BRANCH), (Organ.PETIOLE, Organ.RACHIS), (Organ.PETIOLE, Organ.LEAF)}
"""Organs that run on into another without a clamp between them."""


TWISTING = (Organ.STEM, Organ.BRANCH, Organ.PEDUNCLE, Organ.PETIOLE)
"""Organs that twist. Dicot petioles do (facts: pollination 2), and stems, branches and peduncles are taken to be like
them, for which there is no source. Rachises and midribs, which blades stiffen, do not: with EI/GJ 12 some leaves would
not hold themselves up (measured). Nor do pedicels: their flowers' measured frequency is that of bending alone (facts:
pollination 1a)."""

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(6)
GAUSS_AT, GAUSS_WEIGHT = _NODES[:, None] / 2 + 0.5, _WEIGHTS[:, None] / 2
"""Where along a segment integrals are evaluated, and with what weight; shares of its length."""

LEAST = 4
"""Pieces in an unbranched run at least, where it has that many segments."""
FLUTTER = 30.0
"""Frequency at which the hinges alone give `damping_ratio`, and below which they give less [Hz]."""
FOLDED = 1.2
"""Angle at which a hinge stops [rad]: far beyond what tissue bears, and short of a right angle, where two crossed
hinges lose a direction and a plant pushed aside would spin without bound."""


@dataclass(frozen=True, slots=True)
class Params:
    """How finely the plant is cut and how it is damped.

    Attributes:
        piece: longest rigid piece of several segments [m]; a cantilever of 20 has its first frequency within 0.5 %.
        bend: a piece ends where the plant turns by more than this [rad].
        stiffest: hinges carry so much rotor inertia that none swings faster than this [Hz]; a mode at f is slowed by
            f^2 / (2 stiffest^2), 0.5 % at 30 Hz.
        foliage: the same for petioles, rachises and midribs [Hz], 0.5 % at 10 Hz: their pieces are light, and with 300
            Hz a leaf that was jammed in the gripper became unstable.
        twisting: organs that twist.
        twist_every: of so many pieces of a run the middle one has a hinge for twist, as soft as all of theirs together.
    """

    piece: float = 0.03
    bend: float = 0.5
    stiffest: float = 300.0
    foliage: float = 100.0
    twisting: tuple[Organ, ...] = TWISTING
    twist_every: int = 2


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """The cut: which segments form each rigid body, in an order where parents come first.

    Attributes:
        body: (K,) body of each segment.
        first: (B,) the body's first segment, whose start carries the hinges.
        parent: (B,) parent body or -1.
        stiffness: (B,) bending stiffness of the body's hinges [N m/rad].
        twist: (B,) stiffness of its hinge along itself [N m/rad], 0 where there is none.
    """

    body: NDArray[Any]
    first: NDArray[Any]
    parent: NDArray[Any]
    stiffness: Array
    twist: Array


def cut(plant: SimPlant, params: Params) -> Pieces:
    """Cut the plant into rigid pieces and find the stiffness between them."""
    heir, body = _heirs(plant), np.full(len(plant.start), -1)
    chain = _chains(plant, heir)
    limit = np.minimum(params.piece, np.bincount(chain, plant.length) / LEAST)
    first: list[int] = []
    parent: list[int] = []
    size: list[float] = []
    for k, p in enumerate(plant.parent):
        follows = p >= 0 and heir[p] == k and plant.organ[k] == plant.organ[p]
        fits = follows and size[body[p]] + plant.length[k] <= limit[chain[k]] and plant.joint_compliance[k] == 0
        if fits and _turn(plant, first[body[p]], k) < params.bend:
            body[k] = body[p]
            size[body[p]] += plant.length[k]
        else:
            body[k] = len(first)
            first.append(k)
            parent.append(int(body[p]) if p >= 0 else -1)
            size.append(plant.length[k])
    pieces = np.array(first)
    softness = _softness(plant)
    twisting = np.isin(plant.organ[pieces], params.twisting)
    whole: Array = np.bincount(body, softness.sum(axis=0)).astype(np.float64)
    twist = _twist(plant.bend_over_twist * whole, np.where(twisting, chain[pieces], -1), params)
    bending = 1 / _stiffness(plant, heir, body, pieces, softness) + plant.joint_compliance[pieces]
    bending[0] += 1 / plant.foot
    return Pieces(body, pieces, np.array(parent), 1 / bending, twist)


def _softness(plant: SimPlant) -> Array:
    """Return (6, K) the shares of each segment's integral of ds / (E I) at Gauss's points [rad/(N m)]."""
    radius = plant.radius_start + GAUSS_AT * (plant.radius_end - plant.radius_start)
    return GAUSS_WEIGHT * plant.length / (plant.youngs * np.pi / 4 * radius**4)


def _twist(softness: Array, run: NDArray[Any], params: Params) -> Array:
    """Return (B,) stiffnesses of the hinges for twist: one for every few pieces of a run; those in run -1 do not."""
    out = np.zeros(len(softness))
    for number in np.unique(run[run >= 0]):
        pieces = np.flatnonzero(run == number)
        for group in np.array_split(pieces, -(-len(pieces) // params.twist_every)):
            out[group[len(group) // 2]] = 1 / softness[group].sum()
    return out


def _stiffness(plant: SimPlant, heir: NDArray[Any], body: NDArray[Any], first: NDArray[Any], softness: Array) -> Array:
    """Return (B,) stiffnesses of the hinges that bend.

    A hinge does the work of the pieces beside it when their load is what they carry: the bending moment falls in
    proportion to the distance from the carried mass's centre, and is shared between the hinges by the lever rule. Where
    no piece follows, at tips and forks, the last hinge takes all. So a massless rod with a weight at its end is exact
    with one piece (3 E I / l), and a long chain with many (2 E I / l at the root, facts: libraries).
    """
    before = plant.parent[first]
    continues = np.flatnonzero((before >= 0) & (heir[before] == first))
    mother = body[before[continues]]
    after = np.full(len(first), -1)
    after[mother] = continues
    size = np.bincount(body, plant.length)
    lever = np.maximum(_levers(plant, first), size)
    gone = np.cumsum(plant.length) - plant.length  # segments of a piece follow each other
    at, whole = gone - gone[first][body] + GAUSS_AT * plant.length, size[body]
    last = (after < 0)[body]
    near = np.where(last, 1, 1 - at / whole) * (1 - at / lever[body]) ** 2
    far = np.where(last, 0, at / whole) * (1 + (whole - at) / lever[after][body]) ** 2
    total = np.bincount(body, (softness * near).sum(axis=0))
    total[continues] += np.bincount(body, (softness * far).sum(axis=0))[mother]
    return 1 / total


def _levers(plant: SimPlant, first: NDArray[Any]) -> Array:
    """Return (B,) how far ahead of each piece's start the centre lies of all mass from there on [m]."""
    mass = plant.mass + plant.lump_mass
    moment = (plant.mass * (plant.start + plant.end).T / 2 + plant.lump_mass * plant.lump_centre.T).T
    for k in range(len(mass) - 1, 0, -1):
        mass[plant.parent[k]] += mass[k]
        moment[plant.parent[k]] += moment[k]
    along = (plant.end - plant.start)[first] / plant.length[first, None]
    return np.einsum("bi,bi->b", moment[first] / mass[first, None] - plant.start[first], along)


def _chains(plant: SimPlant, heir: NDArray[Any]) -> NDArray[Any]:
    """Return (K,) the number of the unbranched run each segment belongs to."""
    chain, count = np.empty(len(heir), dtype=int), 0
    for k, p in enumerate(plant.parent):
        follows = p >= 0 and heir[p] == k
        chain[k] = chain[p] if follows else count
        count += not follows
    return chain


def _heirs(plant: SimPlant) -> NDArray[Any]:
    """Return for each segment the child that continues it: of the same organ or its natural next, the straightest.

    -1 at tips and at forks.
    """
    heir, best = np.full(len(plant.start), -1), np.full(len(plant.start), -np.inf)
    branches = np.bincount(plant.parent[plant.organ <= Organ.BRANCH] + 1, minlength=len(heir) + 1)[1:]
    for k, p in enumerate(plant.parent):
        same = p >= 0 and plant.organ[k] == plant.organ[p]
        if p < 0 or branches[p] > 1 or not (same or (plant.organ[p], plant.organ[k]) in CONTINUES):
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
    mass, com, inertia = mass_properties(plant, pieces.body)
    bodies: list[Any] = []
    for b, k in enumerate(pieces.first):
        p = pieces.parent[b]
        origin = plant.start[k]
        holder = spec.worldbody if p < 0 else bodies[p]
        offset = origin if p < 0 else origin - plant.start[pieces.first[p]]
        body = holder.add_body(name=f"plant_{b}", pos=offset, explicitinertial=True)
        body.mass, body.ipos, body.fullinertia = mass[b], com[b] - origin, inertia[b]
        _add_hinges(body, plant, int(k), pieces.stiffness[b], pieces.twist[b], params, dt=spec.option.timestep)
        bodies.append(body)
    if plant.tie is not None:
        _add_tie(spec, plant, bodies[pieces.body[plant.tie[0]]], pieces)
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


def _add_tie(spec: Any, plant: SimPlant, body: Any, pieces: Pieces) -> None:
    """Tie a body sideways, by two long springs at right angles."""
    assert plant.tie is not None
    k, stiffness = plant.tie
    at = plant.end[k] - plant.start[pieces.first[pieces.body[k]]]
    body.add_site(name="tied", pos=at)
    for i, axis in enumerate(np.eye(3)[:2]):
        spec.worldbody.add_site(name=f"stake_{i}", pos=plant.end[k] + axis)
        string = spec.add_tendon(name=f"tie_{i}")
        string.wrap_site(f"stake_{i}")
        string.wrap_site("tied")
        string.stiffness = [stiffness, 0, 0]


def _add_hinges(body: Any, plant: SimPlant, k: int, bending: float, twist: float, params: Params, *, dt: float) -> None:
    along = plant.end[k] - plant.start[k]
    along = along / np.linalg.norm(along)
    across = np.cross(along, plant.oval[k] if plant.oval[k].any() else np.eye(3)[np.argmin(np.abs(along))])
    across /= np.linalg.norm(across)
    oval = float(np.exp(np.linalg.norm(plant.oval[k]) / 2))
    beta = float(_beta(plant.damping_ratio[k], FLUTTER, dt))
    fastest = params.foliage if plant.organ[k] in (Organ.PETIOLE, Organ.RACHIS, Organ.LEAF) else params.stiffest
    for axis, stiffness in ((across, bending * oval), (np.cross(along, across), bending / oval), (along, twist)):
        if stiffness == 0:
            continue
        joint = body.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
        joint.stiffness = [stiffness, 0, 0]
        joint.damping = [beta * stiffness, 0, 0]
        joint.armature = stiffness / (2 * np.pi * fastest) ** 2
        joint.range, joint.limited, joint.solref_limit = [-FOLDED, FOLDED], 1, [4 * dt, 1]


def _beta(ratio: Any, flutter: float, dt: float) -> Any:
    # implicitfast takes springs explicitly and dampers implicitly: damping/stiffness >= 0.7 dt keeps it stable
    return np.maximum(ratio / (np.pi * flutter), 0.7 * dt)


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
        self._bends = np.concatenate([np.arange(n) < 2 for n in model.body_jntnum[self.bodies]])
        data = mujoco.MjData(model)
        self._hang(data)
        self.frequencies, self._first = self._modes(data)
        self.mass_damping = self._air_damping(*self._first)
        self._rest_origin = plant.start[pieces.first]

    def _hang(self, data: Any) -> None:
        """Set the springs' references so that the generated shape carries its own weight (inverse statics)."""
        m = self.model
        mujoco.mj_forward(m, data)
        m.qpos_spring[m.jnt_qposadr[self.joints]] = data.qfrc_bias[self.dofs] / m.jnt_stiffness[self.joints]

    def damp(self, timestep: float) -> None:
        """Damp hinges and plant anew as a finer `timestep` [s] allows: by what is true of more of them."""
        ratio = self.plant.damping_ratio[self.pieces.first][self._piece_of_joint()]
        self.model.dof_damping[self.dofs] = _beta(ratio, FLUTTER, timestep) * self.model.jnt_stiffness[self.joints]
        self.mass_damping = self._air_damping(*self._first)

    def _modes(self, data: Any) -> tuple[Array, tuple[float, Array]]:
        """Return all natural frequencies [Hz], and the first mode in bending: [rad/s] and shape."""
        m, d = self.model, self.dofs
        mass = np.zeros((m.nv, m.nv))
        mujoco.mj_fullM(m, data, mass)
        mass, stiffness, bends = mass[np.ix_(d, d)], self.stiffness(data), np.ix_(self._bends, self._bends)
        values = eigh(stiffness, mass, eigvals_only=True)
        if values[0] <= 0:
            raise StageFailure(
                "no_convergence", "the simulated plant cannot carry its own weight (it buckles): its stem is too soft."
            )
        first, shape = eigh(stiffness[bends], mass[bends], subset_by_index=[0, 0])
        return np.sqrt(values) / (2 * np.pi), (float(np.sqrt(first[0])), shape[:, 0])

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
        return np.diag(m.jnt_stiffness[self.joints]) + (K + K.T) / 2 + self._tie(data)

    def _tie(self, data: Any) -> Array:
        """Return (D, D) what the tie to a stake adds."""
        if self.plant.tie is None:
            return np.zeros((len(self.dofs), len(self.dofs)))
        place = np.zeros((3, self.model.nv))
        mujoco.mj_jacSite(self.model, data, place, None, self.model.site("tied").id)
        sideways = place[:2, self.dofs]
        return self.plant.tie[1] * sideways.T @ sideways

    def _air_damping(self, omega: float, shape: Array) -> float:
        """Return alpha so that a bending mode's ratio is the strain-energy mean of the segments' ratios."""
        m = self.model
        energy = m.jnt_stiffness[self.joints[self._bends]] * shape**2
        ratio = self.plant.damping_ratio[self.pieces.first][self._piece_of_joint()[self._bends]]
        wanted = float(energy @ ratio / energy.sum())
        hinge = float(m.dof_damping[self.dofs[self._bends]] @ shape**2)
        return max(2 * omega * wanted - hinge, 0.0)

    def _piece_of_joint(self) -> NDArray[Any]:
        return np.repeat(np.arange(len(self.bodies)), self.model.body_jntnum[self.bodies])

    def segment_poses(self, data: Any) -> Array:
        """Return T_world_rest (K, 4, 4): maps a segment's generated position to the present one."""
        R = data.xmat[self.bodies].reshape(-1, 3, 3)
        T = np.tile(np.eye(4), (len(R), 1, 1))
        T[:, :3, :3] = R
        T[:, :3, 3] = data.xpos[self.bodies] - np.einsum("bij,bj->bi", R, self._rest_origin)
        return T[self.pieces.body]

    def strain(self, qpos: Array) -> Array:
        """Return (B,) the bending strain added at each body's root, in the configuration qpos (nq,): see `bending`."""
        return np.linalg.norm(self.bending(qpos[self.model.jnt_qposadr[self.joints]]), axis=1)

    def bending(self, angles: NDArray[Any]) -> NDArray[Any]:
        """Return (B, 2) the bending strain at each body's root for the hinges' angles (D,): angle x radius / spacing.

        The spacing is EI/k, the length over which the hinge gathers the bending. Twist does not count: the limits on
        strain are those of bending. Real angles or phasors.
        """
        k = self.pieces.first
        radius = self.plant.radius_start[k]
        stiff = self.plant.youngs[k] * np.pi / 4 * radius**4
        return angles[self._bends].reshape(-1, 2) * (radius * self.pieces.stiffness / stiff)[:, None]
