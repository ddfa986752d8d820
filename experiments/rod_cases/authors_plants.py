"""The authors' two real plants with the authors' settings: which defect of the peer explains which difference."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from scipy.signal import detrend, hilbert
from scipy.spatial.transform import Rotation

from anther.elastic_rod import (
    Clamp,
    Drive,
    Rods,
    frequency_response,
    least_stiffness,
    natural_frequencies,
    simulate,
    with_gravity_equilibrium,
)
from anther.errors import AntherError
from anther.formats.skeletons import read_skeleton
from rod_cases.beams import X_AXIS
from rod_cases.peer_model import PeerModel, Shake
from rod_cases.peer_references import reference
from rod_cases.table import Array

PLANTS = {"tomato2": "authors_tomato2_f1.3", "pepper0": "authors_pepper0_f1.6"}
RADII = (3e-3, 4.5e-3, 6e-3)
MODULI = (71e6, 120e6, 218e6, 500e6, 1e9, 2e9)
"""Young's modulus [Pa]: the first three are the authors' stem with 5, 10, 20 g of leaves (issue 3, P22)."""
THICK_TOLERANCE = 1e-5
"""Residual force [N] accepted at r = 30 mm, the peer's: rounding alone leaves 1e-6 N where EA is 61 kN."""
DAMPING_RATIO = 0.05
"""Of a mode at the frequency of the drive; the plant model's prior."""


@dataclass(frozen=True)
class Stage:
    """The flower's amplitude [m] after one more change; NaN with the reason where there is none."""

    name: str
    amplitude: float
    note: str = ""


@dataclass(frozen=True)
class Thin:
    """A plant as thin as it is: radius [m], the least Young's modulus [Pa] that stands, and amplitudes [m].

    Attributes:
        simulated: (E [Pa], first natural frequency [Hz], amplitude [m]) of nonlinear simulations.
        moduli: (K,) [Pa] of the frequency response.
        linear: (K,) amplitude [m] of the frequency response.
    """

    radius: float
    least_youngs: float
    simulated: list[tuple[float, float, float]]
    moduli: Array
    linear: Array


@dataclass(frozen=True)
class AuthorsPlant:
    """Everything about one plant.

    Attributes:
        name: of the skeleton file.
        setup: the authors' parameters.
        stages: amplitudes from the peer's to ours, one change after the other.
        rotation_energy: bending energy [J] that a rigid rotation by 0.0139 rad about y stores: in the peer, without
            either defect 2 or sibling springs, and in our engine.
        weak_springs: share of the peer's springs with less than 0.9 of their stiffness in some plane.
        rigid: the flower's amplitude [m] if the plant turned rigidly about its root; NaN where it is not pinned.
        dragged: amplitudes [m] of a thin plant (`DRAGGED`), and of the same with the authors' damping of every node.
        thin: uniform radii of 3-6 mm.
    """

    name: str
    setup: dict[str, Any]
    stages: list[Stage]
    rotation_energy: tuple[float, float]
    weak_springs: float
    rigid: float
    dragged: tuple[float, float]
    thin: list[Thin]

    def metrics(self) -> dict[str, float]:
        """Return flat numbers for --json."""
        sizes = {stage.name: 1e3 * stage.amplitude for stage in self.stages}
        out = {f"{self.name}_{key}_mm": sizes[name] for key, name in _KEYS.items() if name in sizes}
        for thin in self.thin:
            out[f"{self.name}_needs_MPa_at_{1e3 * thin.radius:g}mm"] = thin.least_youngs / 1e6
        return out

    def stage(self, name: str) -> Stage:
        """Return the stage of that name."""
        return next(stage for stage in self.stages if stage.name == name)


STORED = "peer solver, stored trajectory"
AGAIN = "its conventions, written anew"
CONNECTED = "… directors follow connectivity (defect 2 off)"
TURNING = "… edges may turn about themselves (defect 1 off)"
BOTH = "… both off, and no springs between siblings"
OURS = "our engine, the same settings"
UNTWISTED = "our engine, rods that cannot twist (not kept below)"
CLAMPED_ROOT = "… root clamped, not pinned"
DRAGGED = (3e-3, 1e9)
"""Radius [m] and Young's modulus [Pa] at which the authors' per-node damping is tried on a thin plant."""
_KEYS = {"peer": STORED, "peer_defect_2_off": CONNECTED, "peer_defect_1_off": TURNING, "ours": OURS}


@dataclass(frozen=True)
class _Plant:
    """A plant for our engine, with the authors' drive."""

    rods: Rods
    clamp: Clamp
    pin: Clamp
    grip: int
    flower: int
    amplitude: float
    frequency: float
    duration: float

    def shaken(self, rods: Rods, clamp: Clamp, dt: float, integrator: Any, tolerance: float = 1e-8) -> float:
        """Return the flower's amplitude [m]; the tolerance is on the residual force [N]."""
        drive = Drive(self.grip, X_AXIS, self.amplitude, self.frequency)
        scheme: dict[str, Any] = {"integrator": integrator, "tolerance": tolerance, "start": "scanned"}
        run = simulate(rods, clamp, drive, self.duration, dt, **scheme)
        return envelope(run.positions[:, self.flower, 0])


def study(data: Path, quick: bool, console: Console) -> list[AuthorsPlant]:
    """Return both plants, the tomato alone if quick, none where their data is missing."""
    names = [name for name in PLANTS if (data / "skeletons" / f"{name}.txt").exists()]
    names = [name for name in names if (data / "rod_reference" / f"{PLANTS[name]}.npz").exists()]
    return [_study(data, name, quick, console) for name in names[: 1 if quick else None]]


def envelope(x: Array) -> float:
    """Return the paper's metric: the median Hilbert envelope of the detrended displacement along the shake [m]."""
    analytic: Any = hilbert(detrend(x))
    return float(np.median(np.abs(analytic)))


def _study(data: Path, name: str, quick: bool, console: Console) -> AuthorsPlant:
    arrays, setup = reference(data / "rod_reference", PLANTS[name])
    duration = 1.0 if quick else float(arrays["t"][-1])
    plant = _plant(data, name, arrays, setup, duration)
    peers = _peer_models(arrays, setup, quick)
    stages = [Stage(STORED, envelope(arrays["traj"][:, setup["flower_node"], 0]))]
    for title, model in track(peers.items(), f"{name}: the peer's conventions", console=console):
        stages.append(_peer_stage(title, model, arrays, setup, duration))
    stages += list(track(_our_stages(plant, setup, quick), f"{name}: our engine", total=7, console=console))
    thin = [
        _thin(plant, radius, (500e6,) if quick else MODULI)
        for radius in track(RADII, f"{name}: thin rods", console=console)
    ]
    nodes, root = arrays["nodes0"], arrays["nodes0"][0]
    heights = nodes[[setup["flower_node"], setup["drive_node"]], 2] - root[2]
    return AuthorsPlant(
        name,
        setup,
        stages,
        (
            _rotation_energy(peers[AGAIN]),
            _rotation_energy(PeerModel(nodes, arrays["edges"], setup, directors="connectivity", siblings=False)),
        ),
        float(np.mean(peers[AGAIN].stiffness_lost() < 0.9)),
        float(setup["amp"] * heights[0] / heights[1]) if len(plant.pin.nodes) == 1 else float("nan"),
        _dragged(plant),
        thin,
    )


def _peer_models(arrays: dict[str, Any], setup: dict[str, Any], quick: bool) -> dict[str, PeerModel]:
    nodes, edges = arrays["nodes0"], arrays["edges"]
    models = {AGAIN: PeerModel(nodes, edges, setup), TURNING: PeerModel(nodes, edges, setup, turning=True)}
    if quick:
        return models
    return {
        AGAIN: models[AGAIN],
        CONNECTED: PeerModel(nodes, edges, setup, directors="connectivity"),
        TURNING: models[TURNING],
        BOTH: PeerModel(nodes, edges, setup, directors="connectivity", siblings=False, turning=True),
    }


def _peer_stage(title: str, model: PeerModel, arrays: dict[str, Any], setup: dict[str, Any], duration: float) -> Stage:
    fixed = np.array([n for n in arrays["fixed_nodes"] if n != setup["drive_node"]])
    shake = Shake(setup["drive_node"], setup["amp"], setup["freq"])
    path = model.simulate(fixed, shake, duration, setup["dt"])
    apart = np.abs(path - arrays["traj"][: len(path)]).max()
    note = f"within {apart:.1g} m of the stored trajectory" if title == AGAIN else ""
    return Stage(title, envelope(path[:, setup["flower_node"], 0]), note)


def _plant(data: Path, name: str, arrays: dict[str, Any], setup: dict[str, Any], duration: float) -> _Plant:
    skeleton = read_skeleton(data / "skeletons" / f"{name}.txt")
    drag = setup["damping_per_node_Ns_per_m"]
    nodes, parent = skeleton.nodes, skeleton.parent
    rods = Rods(nodes, parent, setup["r"], setup["E"], setup["rho"], node_drag=drag, discretisation="paper")
    fixed = np.array([skeleton.node(int(n)) for n in arrays["fixed_nodes"] if n != setup["drive_node"]])
    return _Plant(
        rods,
        Clamp(np.concatenate([[0], np.flatnonzero(parent == 0), fixed])),
        Clamp(fixed),
        skeleton.node(setup["drive_node"]),
        skeleton.node(setup["flower_node"]),
        setup["amp"],
        setup["freq"],
        duration,
    )


def _our_stages(plant: _Plant, setup: dict[str, Any], quick: bool) -> Iterator[Stage]:
    """Yield the stages of our engine, from the authors' settings to sound ones, r = 30 mm throughout."""
    rods, dt, fine = plant.rods, setup["dt"], 4e-3 if quick else 1e-3
    yield _stage(OURS, plant, rods, plant.pin, dt, "implicit_euler")
    unable = replace(rods, bend_over_twist=0.0)
    yield _stage(UNTWISTED, plant, unable, plant.pin, dt, "implicit_euler")
    yield _stage(CLAMPED_ROOT, plant, rods, plant.clamp, dt, "implicit_euler")
    rods = replace(rods, discretisation="consistent")
    yield _stage("… second order at forks and kinks", plant, rods, plant.clamp, dt, "implicit_euler")
    hanging = with_gravity_equilibrium(rods, plant.clamp)
    yield _stage("… rest shape in equilibrium under gravity", plant, hanging, plant.clamp, dt, "implicit_euler")
    yield _stage(f"… midpoint rule, dt {1e3 * fine:g} ms", plant, hanging, plant.clamp, fine, "midpoint")
    rate = 4 * np.pi * DAMPING_RATIO * setup["freq"]
    damped = replace(hanging, node_drag=0.0, mass_damping=rate)
    name = f"… damping ratio {100 * DAMPING_RATIO:g} % instead of 0.5 N s/m a node"
    yield _stage(name, plant, damped, plant.clamp, fine, "midpoint")


def _stage(name: str, plant: _Plant, rods: Rods, clamp: Clamp, dt: float, integrator: str) -> Stage:
    try:
        return Stage(name, plant.shaken(rods, clamp, dt, integrator, THICK_TOLERANCE))
    except AntherError as error:
        return Stage(name, float("nan"), str(error).split(". ")[0])


def _dragged(plant: _Plant) -> tuple[float, float]:
    radius, youngs = DRAGGED
    damping = DAMPING_RATIO / (np.pi * plant.frequency)
    bare = replace(plant.rods, edge_radius=radius, node_drag=0.0, viscous_time=damping, discretisation="consistent")
    rods = _hanging(bare, youngs, plant.clamp)
    drag = plant.rods.node_drag
    sound, dragged = (plant.shaken(r, plant.clamp, 2e-3, "midpoint") for r in (rods, replace(rods, node_drag=drag)))
    return sound, dragged


def _thin(plant: _Plant, radius: float, moduli: tuple[float, ...]) -> Thin:
    """Return what the plant does at a sound thickness: clamped, in equilibrium, damped."""
    damping = DAMPING_RATIO / (np.pi * plant.frequency)
    thin = replace(plant.rods, edge_radius=radius, node_drag=0.0, viscous_time=damping, discretisation="consistent")
    least = (least_stiffness(thin, plant.clamp) or np.nan) * float(np.asarray(plant.rods.youngs)[1])
    grid = np.geomspace(1.03 * least, 3e9, 25)
    linear = [_linear_amplitude(plant, _hanging(thin, youngs, plant.clamp)) for youngs in grid]
    simulated = []
    for youngs in moduli:
        if youngs > least:
            rods = _hanging(thin, youngs, plant.clamp)
            first = float(natural_frequencies(rods, plant.clamp, 1).frequencies[0])
            simulated.append((youngs, first, plant.shaken(rods, plant.clamp, 2e-3, "midpoint")))
    return Thin(radius, least, simulated, grid, np.array(linear))


def _hanging(rods: Rods, youngs: float, clamp: Clamp) -> Rods:
    return with_gravity_equilibrium(replace(rods, youngs=youngs), clamp)


def _linear_amplitude(plant: _Plant, rods: Rods) -> float:
    answer = frequency_response(rods, plant.clamp, plant.grip, (1, 0, 0), [plant.frequency])
    return float(plant.amplitude * np.abs(answer[0, plant.flower, 0]))


def _rotation_energy(model: PeerModel) -> float:
    """Return the bending energy [J] after a rotation by 0.0139 rad about y through node 0 (4 mm at tomato2's grip)."""
    rest = model.rest
    matrix: NDArray[Any] = Rotation.from_rotvec([0, 0.0139, 0]).as_matrix()
    x = rest[0] + (rest - rest[0]) @ matrix.T
    return model.bend_energy(x, model.carried(model.m1, rest, x))
