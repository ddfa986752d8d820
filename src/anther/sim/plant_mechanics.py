"""The plant as MuJoCo bodies: rigid tapered pieces on sprung hinges. Its numbers come from plant truth alone.

Between two pieces stand two crossed hinges, which share the softness of the pieces beside them; every few pieces a
third one, along the piece, lets the run twist. Leaf blades are thin boxes, to bump into.
K segments, B bodies, D degrees of freedom.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import mujoco as mujoco_module
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cholesky, eigh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from anther.core.errors import StageFailure
from anther.core.geometry import Array
from anther.sim.pieces import Params, Pieces, cut, mass_properties
from anther.sim.plant import GRAVITY, Organ, SimPlant, Twine

mujoco: Any = mujoco_module  # its names come from C++ at run time; type checkers do not see them


def add_plant(spec: Any, plant: SimPlant, params: Params, *, contype: int = 0) -> Pieces:
    """Add the plant's bodies `plant_<b>`, hinges, and what touches: capsules `segment_<k>`, boxes `blade_<i>_<k>`.

    Petals do not touch: they are masses only; and midribs leave it to their blades.

    Args:
        spec: the world; its timestep sets the least damping.
        plant: the truth.
        params: how it is cut and damped.
        contype: MuJoCo's collision bits of what touches; 0: nothing does.
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
    for i, twine in enumerate(plant.twines):
        _add_twine(spec, plant, twine, i, bodies[pieces.body[twine.segment]], pieces)
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
            conaffinity=0,
            friction=[1.0, 0.005, 0.0001],
            group=2,
        )
    if contype:
        _add_blades(spec, plant, pieces, contype)
    return pieces


def leaf_boxes(plant: SimPlant) -> list[tuple[int, Array, Array, Array]]:
    """Return boxes around pieces of every leaf blade of the mesh, at most 3 cm long.

    Each is the segment it rides on, its centre (3,) [m], its axes (3, 3) in columns, its half extents (3,) [m].
    """
    faces = plant.faces[plant.face_organ == Organ.LEAF]
    if len(faces) == 0:
        return []
    of_leaf, count = np.unique(faces), len(plant.vertices)
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    leaf = connected_components(coo_matrix((np.ones(len(edges)), edges.T), (count, count)), directed=False)[1]
    group = np.unique(np.stack([leaf[of_leaf], plant.vertex_segment[of_leaf]]), axis=1, return_inverse=True)[1]
    members = [of_leaf[group == g] for g in range(group.max() + 1)]
    runs = [(int(plant.vertex_segment[of[0]]), run) for of in members for run in _runs(plant.vertices[of])]
    return [(segment, *_box(run)) for segment, run in runs]


def _add_blades(spec: Any, plant: SimPlant, pieces: Pieces, contype: int) -> None:
    """Add the blades as boxes `blade_<i>_<segment>`: soft, and without mass: the segments have it."""
    # time constant of a blade's contact [s]. A blade is a membrane that bends away: a strip of it 40 mm long and
    # wide, 0.25 mm thick, of 75 MPa, is a spring of 0.2 N/m at its end, its midrib (0.7 mm) one of 0.7 N/m (3 E I /
    # L^3). With this constant fingers that go through three grown plants press into blades with 0.5-2 N/m in the
    # median (measured; with 0.03 s 8-16 N/m). What presses harder passes through, as between the pads. There is no
    # friction: a leaf slides off
    blade_time = 0.2
    for i, (k, centre, axes, half) in enumerate(leaf_boxes(plant)):
        b = pieces.body[k]
        spec.body(f"plant_{b}").add_geom(
            name=f"blade_{i}_{k}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=centre - plant.start[pieces.first[b]],
            quat=Rotation.from_matrix(axes).as_quat(scalar_first=True),
            size=half,
            mass=0,
            contype=contype,
            conaffinity=0,
            condim=1,
            priority=2,
            solref=[blade_time, 1.0],
            solimp=[0.5, 0.9, 0.005, 0.5, 2],
            group=2,
        )


def _runs(points: Array, longest: float = 0.03) -> list[Array]:
    """Cut points (n, 3) across their longest extent into runs of at most `longest` [m], without those of under four."""
    centred = points - points.mean(axis=0)
    along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
    count = max(int(np.ceil(np.ptp(along) / longest)), 1)
    run = np.minimum(((along - along.min()) / max(np.ptp(along), 1e-9) * count).astype(int), count - 1)
    return [points[run == i] for i in range(count) if np.sum(run == i) >= 4]


def _box(points: Array) -> tuple[Array, Array, Array]:
    """Return centre (3,), axes (3, 3) in columns and half extents (3,) of the box about points (n, 3)."""
    mean = points.mean(axis=0)
    axes = np.linalg.svd(points - mean, full_matrices=False)[2].T
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    local = (points - mean) @ axes
    half = np.ptp(local, axis=0) / 2
    centre = mean + axes @ (local.min(axis=0) + half)
    return centre, axes, np.array([half[0], half[1], 0.001])  # a blade's 0.25 mm and its ripples: an estimate


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


def _add_twine(spec: Any, plant: SimPlant, twine: Twine, number: int, body: Any, pieces: Pieces) -> None:
    """Hang a body on a string: a spring from the hook, longer than at ease by tension / stiffness; slack, it pulls not.

    It is damped as polymers are, by a loss factor of about 0.1 at 10 Hz (a guess).
    """
    at = plant.end[twine.segment]
    body.add_site(name=f"held_{number}", pos=at - plant.start[pieces.first[pieces.body[twine.segment]]])
    spec.worldbody.add_site(name=f"hook_{number}", pos=twine.hook)
    string = spec.add_tendon(name=f"twine_{number}")
    string.wrap_site(f"hook_{number}")
    string.wrap_site(f"held_{number}")
    ease = float(np.linalg.norm(twine.hook - at)) - twine.tension / twine.stiffness
    string.springlength = [0.0, ease]
    string.stiffness = [twine.stiffness, 0, 0]
    string.damping = [0.1 * twine.stiffness / (2 * np.pi * 10.0), 0, 0]


def _add_hinges(body: Any, plant: SimPlant, k: int, bending: float, twist: float, params: Params, *, dt: float) -> None:
    along = plant.end[k] - plant.start[k]
    along = along / np.linalg.norm(along)
    across = np.cross(along, plant.oval[k] if plant.oval[k].any() else np.eye(3)[np.argmin(np.abs(along))])
    across /= np.linalg.norm(across)
    oval = float(np.exp(np.linalg.norm(plant.oval[k]) / 2))
    beta = float(_beta(plant.damping_ratio[k], dt))
    fastest = params.foliage if plant.organ[k] in (Organ.PETIOLE, Organ.RACHIS, Organ.LEAF) else params.stiffest
    for axis, stiffness in ((across, bending * oval), (np.cross(along, across), bending / oval), (along, twist)):
        if stiffness == 0:
            continue
        joint = body.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
        joint.stiffness = [stiffness, 0, 0]
        joint.damping = [beta * stiffness, 0, 0]
        joint.armature = stiffness / (2 * np.pi * fastest) ** 2
        # far beyond what tissue bears, and short of a right angle, where two crossed hinges lose a direction
        joint.range, joint.limited, joint.solref_limit = [-1.2, 1.2], 1, [4 * dt, 1]


def _beta(ratio: Any, dt: float) -> Any:
    """Return damping over stiffness [s] of hinges that alone give `ratio` at 30 Hz, and less below."""
    # implicitfast takes springs explicitly and dampers implicitly: damping/stiffness >= 0.7 dt keeps it stable
    return np.maximum(ratio / (np.pi * 30.0), 0.7 * dt)


def alone(plant: SimPlant, params: Params, timestep: float = 2e-3) -> PlantMechanics:
    """Return a plant in its pot in a world of its own, to be stepped by `timestep` [s].

    Raises:
        StageFailure: "no_convergence": it cannot carry its own weight.
    """
    spec = mujoco.MjSpec()
    spec.compiler.degree, spec.option.gravity, spec.option.timestep = False, [0, 0, -GRAVITY], timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    pieces = add_plant(spec, plant, params)
    return PlantMechanics(spec.compile(), plant, pieces)


class PlantMechanics:
    """The compiled plant: hangs in equilibrium, is damped, and tells where its segments are.

    Attributes:
        dofs: (D,) its degrees of freedom in the model.
    """

    def __init__(self, model: Any, plant: SimPlant, pieces: Pieces) -> None:
        self.model, self.plant, self.pieces = model, plant, pieces
        self.bodies = np.array([model.body(f"plant_{b}").id for b in range(len(pieces.first))])
        self.joints = np.concatenate(
            [np.arange(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b]) for b in self.bodies]
        )
        self.dofs = model.jnt_dofadr[self.joints]
        self._bends = np.concatenate([np.arange(n) < 2 for n in model.body_jntnum[self.bodies]])
        self._ratio = np.repeat(plant.damping_ratio[pieces.first], model.body_jntnum[self.bodies])
        self._rest_origin = plant.start[pieces.first]
        data = mujoco.MjData(model)
        self._hang(data)
        try:
            cholesky(self.stiffness(data))
        except LinAlgError as error:
            why = "the simulated plant cannot carry its own weight (it buckles): its stem is too soft."
            raise StageFailure("no_convergence", why) from error

    @cached_property
    def frequencies(self) -> Array:
        """(D,) natural frequencies about the rest shape [Hz], lowest first."""
        return np.sqrt(self._modes[0]) / (2 * np.pi)

    def _hang(self, data: Any) -> None:
        """Set the springs' references so that the generated shape carries its own weight (inverse statics).

        What strings pull is carried already.
        """
        m = self.model
        mujoco.mj_forward(m, data)
        load = data.qfrc_bias[self.dofs] - data.qfrc_spring[self.dofs]
        m.qpos_spring[m.jnt_qposadr[self.joints]] += load / m.jnt_stiffness[self.joints]

    def damp(self, timestep: float) -> None:
        """Damp hinges and plant anew as a finer `timestep` [s] allows: by what is true of more of them."""
        self.model.dof_damping[self.dofs] = _beta(self._ratio, timestep) * self.model.jnt_stiffness[self.joints]
        self.__dict__.pop("_undamped", None)

    @cached_property
    def _undamped(self) -> tuple[Array, Array]:
        return self.underdamped(*self._modes)

    def underdamped(self, values: Array, modes: Array) -> tuple[Array, Array]:
        """Return the modes (D, K) that the hinges damp too little, and the rates that they lack: 2 z w - c [1/s].

        A mode is to have the damping ratio of its segments, the mean by the energy in their springs. Modes faster than
        about 30 Hz are damped enough by the hinges.

        Args:
            values: (M,) squared natural frequencies [1/s2].
            modes: (D, M) of unit modal mass.
        """
        energy = self.model.jnt_stiffness[self.joints][:, None] * modes**2
        ratio = self._ratio @ energy / energy.sum(axis=0)
        lacking = 2 * ratio * np.sqrt(values) - self.model.dof_damping[self.dofs] @ modes**2
        return modes[:, lacking > 0], lacking[lacking > 0]

    def drag(self, data: Any) -> Array:
        """Return (D,) the torques that damp what the hinges do not, with the inertia of the plant as it is now bent.

        Where bending makes a mode so heavy that a step would turn it back, they only bring it to rest: a stem on its
        string, which twists with hardly any inertia while it is straight, shook itself apart.
        """
        modes, lacking = self._undamped
        moving, momentum = np.zeros(self.model.nv), np.empty(self.model.nv)
        moving[self.dofs] = data.qvel[self.dofs]
        mujoco.mj_mulM(self.model, data, momentum, moving)
        speed = momentum[self.dofs] @ modes
        moving[self.dofs] = modes @ (lacking * speed)
        mujoco.mj_mulM(self.model, data, momentum, moving)
        turned = float(self.model.opt.timestep * (moving @ momentum))
        share = min(1.0, float(lacking @ speed**2) / turned) if turned > 0 else 1.0
        return -share * momentum[self.dofs]

    @cached_property
    def _modes(self) -> tuple[Array, Array]:
        """Squared frequencies and modes of the plant in its pot, as `underdamped` takes them."""
        data, mass, d = mujoco.MjData(self.model), np.zeros((self.model.nv, self.model.nv)), self.dofs
        mujoco.mj_forward(self.model, data)
        mujoco.mj_fullM(self.model, data, mass)
        values, modes = eigh(self.stiffness(data), mass[np.ix_(d, d)])
        return values, modes

    def stiffness(self, data: Any) -> Array:
        """Return (D, D) the second derivatives of the energy of springs, weight and strings at `data`'s place."""
        m, bodies = self.model, self.model.dof_bodyid[self.dofs]
        weight = np.zeros((len(bodies), 3))
        weight[:, 2] = m.opt.gravity[2] * m.body_subtreemass[bodies]
        K = np.diag(m.jnt_stiffness[self.joints]) + self._turned(data, data.subtree_com[bodies], weight)
        for i, twine in enumerate(self.plant.twines):
            site, place = m.site(f"held_{i}").id, np.zeros((3, m.nv))
            way = twine.hook - data.site_xpos[site]
            length = float(np.linalg.norm(way))
            pull = max(twine.stiffness * (length - m.tendon_lengthspring[m.tendon(f"twine_{i}").id, 1]), 0.0)
            mujoco.mj_jacSite(m, data, place, None, site)
            own, along = place[:, self.dofs], np.outer(way, way) / length**2
            stretch = twine.stiffness * (pull > 0) * along + pull / length * (np.eye(3) - along)
            holds = np.any(own != 0, axis=0)[:, None]
            K += own.T @ stretch @ own + self._turned(data, data.site_xpos[site], holds * pull * way / length)
        return K + self._tie(data)

    def _turned(self, data: Any, place: Array, force: Array) -> Array:
        """Return (D, D) by how much less torque a hinge gets from forces (D, 3) beyond others as those turn.

        The forces [N] keep their direction; they act at `place` (3,) or (D, 3) on what each hinge carries. Of two
        hinges the inner one turns axis and lever of the outer: its axis times (axis x lever) x force of that.
        """
        axis = data.xaxis[self.joints]
        moment = np.cross(np.cross(axis, place - data.xanchor[self.joints]), force)
        inner = np.where(self._inner, -axis @ moment.T, 0.0)
        return inner + inner.T - np.diag(np.diag(inner))

    @cached_property
    def _inner(self) -> NDArray[np.bool_]:
        """(D, D) whether the first hinge is the second, or carries it."""
        number = np.full(self.model.nv, -1)
        number[self.dofs] = np.arange(len(self.dofs))
        out = np.eye(len(self.dofs), dtype=bool)
        for j, dof in enumerate(self.dofs):  # hinges are numbered from the root out
            if (before := self.model.dof_parentid[dof]) >= 0:
                out[:, j] |= out[:, number[before]]
        return out

    def _tie(self, data: Any) -> Array:
        """Return (D, D) what the tie to a stake adds."""
        if self.plant.tie is None:
            return np.zeros((len(self.dofs), len(self.dofs)))
        place = np.zeros((3, self.model.nv))
        mujoco.mj_jacSite(self.model, data, place, None, self.model.site("tied").id)
        sideways = place[:2, self.dofs]
        return self.plant.tie[1] * sideways.T @ sideways

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
