"""The MuJoCo cell against beam theory, and what it must not do: sag, drift, gain energy."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fake_robot import horizontal_grasp
from grown_plants import GROW, grown
from scipy.signal import find_peaks
from small_planner import solve
from straight_plant import BASE, chain, plant_of, straight_plant, with_blade

from anther.core.errors import StageFailure
from anther.core.geometry import transform_each
from anther.robot.arm.sawyer import SAWYER
from anther.robot.devices import JointTrajectory
from anther.sim import plant_mechanics
from anther.sim.cell import Cell, Params, mujoco
from anther.sim.growth import Growth
from anther.sim.plant import Organ, SimPlant
from anther.sim.plant_mechanics import leaf_boxes
from anther.sim.robot import SimArm

LENGTH, RADIUS, YOUNGS, DENSITY = 0.5, 0.004, 1e9, 1000.0


def cantilever(direction: tuple[float, float, float] = (0, 0, 1), *, damping_ratio: float = 0.02) -> SimPlant:
    points = BASE + np.linspace(0, LENGTH, 21)[:, None] * np.array(direction, dtype=float)
    return plant_of(chain(points, RADIUS, youngs=YOUNGS), damping_ratio=damping_ratio)


def idle(cell: Cell, seconds: float) -> None:
    n = round(seconds / cell.params.timestep)
    cell.run(np.tile(cell.arm_command, (n, 1)), np.zeros((n, 7)), np.full(n, cell.grip_command))


def tip(cell: Cell, qpos: np.ndarray | None = None) -> np.ndarray:
    return (cell.segment_poses(qpos)[-1] @ np.r_[cell.plant.end[-1], 1])[:3]


def test_first_frequency_of_a_cantilever_is_euler_bernoulli_within_half_a_percent() -> None:
    inertia, area = np.pi / 4 * RADIUS**4, np.pi * RADIUS**2
    theory = 1.8751**2 / (2 * np.pi) * np.sqrt(YOUNGS * inertia / (DENSITY * area * LENGTH**4))
    # sideways, so that weight neither stiffens nor softens the beam to first order
    assert Cell(cantilever((0, 1, 0))).mechanics.frequencies[0] == pytest.approx(theory, rel=5e-3)


def test_free_decay_has_the_frequency_and_damping_ratio_asked_for() -> None:
    cell = Cell(cantilever(damping_ratio=0.03))
    cell.data.qpos[cell.model.jnt_qposadr[cell.mechanics.joints[0]]] = 0.02
    idle(cell, 3.0)
    path = np.array([tip(cell, q) for q in cell.log().qpos])[100:]
    x = path[:, np.argmax(np.ptp(path, axis=0)[:2])]
    peaks = find_peaks(x - x.mean())[0]
    height = x[peaks] - x[-200:].mean()
    frequency = 1 / (np.diff(peaks).mean() * 2 * cell.params.timestep)
    ratio = np.log(height[0] / height[6]) / 6 / (2 * np.pi)
    assert frequency == pytest.approx(cell.mechanics.frequencies[0], rel=5e-3)
    assert ratio == pytest.approx(0.03, rel=0.1)


def test_a_tip_force_bends_a_cantilever_as_beam_theory_says() -> None:
    cell = Cell(cantilever((0, 1, 0), damping_ratio=0.3))
    force, body = 0.02, cell.mechanics.bodies[-1]
    start = tip(cell)
    cell.data.xfrc_applied[body, :3] = [force, 0, 0]
    lever = LENGTH - np.linalg.norm(cell.data.xipos[body] - start)
    idle(cell, 3.0)
    inertia = np.pi / 4 * RADIUS**4
    at_force = force * lever**3 / (3 * YOUNGS * inertia)
    theory = at_force + force * lever**2 / (2 * YOUNGS * inertia) * (LENGTH - lever)
    assert (tip(cell) - start)[0] == pytest.approx(theory, rel=0.01)


def test_a_cantilever_without_its_weight_springs_up_by_the_droop_of_beam_theory() -> None:
    """What hangs as generated rises by w L^4 / (8 E I) when gravity goes: weight and springs are in balance, truly."""
    cell = Cell(cantilever((0, 1, 0), damping_ratio=0.4))
    start = tip(cell)
    cell.model.opt.gravity[:] = 0
    idle(cell, 3.0)
    inertia, area = np.pi / 4 * RADIUS**4, np.pi * RADIUS**2
    droop = DENSITY * area * 9.81 * LENGTH**4 / (8 * YOUNGS * inertia)
    assert (tip(cell) - start)[2] == pytest.approx(droop, rel=0.01)


def test_a_plant_that_swings_against_a_still_arm_only_loses_energy() -> None:
    """The stem is bent aside and let go; it strikes the gripper several times. No stroke gives energy.

    Energy is compared while they are apart: touching, pads and servos store some and return it.
    """
    joints = solve(horizontal_grasp(np.add(BASE, [0, -0.035, 0.3]), np.zeros(7)).T_world_flange)
    cell = Cell(straight_plant(), joints)
    cell.model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    cell.data.qpos[cell.model.jnt_qposadr[cell.mechanics.joints[:2]]] += 0.05
    energy, apart = np.empty(600), np.empty(600, dtype=bool)
    for i in range(600):
        idle(cell, 0.002)
        energy[i], apart[i] = cell.data.energy.sum(), cell.data.ncon == 0
    strokes = np.count_nonzero(np.diff(apart.astype(int)) < 0)
    free = energy[apart]
    swing = free[0] - energy.min()
    assert strokes >= 3
    assert (free - np.minimum.accumulate(free)).max() < 0.002 * swing
    assert free[-1] < free[0] - 0.5 * swing


def test_the_generated_shape_neither_sags_nor_drifts() -> None:
    plant = straight_plant()
    cell = Cell(plant)
    idle(cell, 0.5)
    moved = transform_each(cell.segment_poses(), plant.end) - plant.end
    assert np.abs(moved).max() < 1e-6
    assert cell.joints == pytest.approx(SAWYER.neutral, abs=1e-6)


def test_a_plant_too_soft_to_stand_is_refused() -> None:
    plant = plant_of(chain(BASE + np.linspace(0, 1, 21)[:, None] * [0, 0, 1.0], 0.002, youngs=1e6))
    with pytest.raises(StageFailure, match="cannot carry its own weight"):
        Cell(plant)


def test_the_cut_keeps_mass_organs_and_order() -> None:
    plant = straight_plant()
    pieces = plant_mechanics.cut(plant, plant_mechanics.Params(piece=0.1))
    assert len(pieces.first) < len(plant.start) / 2
    assert np.all(pieces.parent < np.arange(len(pieces.parent)))
    for b in range(len(pieces.first)):
        assert len(set(plant.organ[pieces.body == b])) == 1
    cell = Cell(plant, params=Params(plant=plant_mechanics.Params(piece=0.1)))
    mass = cell.model.body_mass[cell.mechanics.bodies].sum()
    assert mass == pytest.approx(plant.mass.sum() + plant.lump_mass.sum(), rel=1e-9)


def test_a_bar_with_a_heavy_arm_twists_as_theory_says_and_bending_strain_does_not_count_it() -> None:
    """GJ = EI / 12; the arm's weights balance, so that twist does not bend the bar."""
    inertia, ratio, mass, arm = np.pi / 4 * RADIUS**4, 12.0, 0.02, 0.15
    arms = []
    for side in (arm, -arm):
        points = BASE + np.array([[0, 0, LENGTH], [side, 0, LENGTH]])
        arms.append(chain(points, 0.01, organ=Organ.LEAF, youngs=1e11, joins=19))
        arms[-1]["density"][:], arms[-1]["lump_mass"][:], arms[-1]["lump_centre"] = 1.0, mass, arms[-1]["end"]
    bar = chain(BASE + np.linspace(0, LENGTH, 21)[:, None] * [0, 0, 1.0], RADIUS, youngs=1e10)
    cell = Cell(plant_of(bar, *arms))
    theory = np.sqrt(1e10 * inertia / ratio / LENGTH / (2 * mass * arm**2)) / (2 * np.pi)
    found = cell.mechanics.frequencies
    assert np.abs(found[:6] / theory - 1).min() < 0.02
    m = cell.model
    qpos = cell.data.qpos.copy()
    up = [m.body_jntadr[b] + 2 for b in cell.mechanics.bodies if m.body_jntnum[b] == 3]
    assert len(up) == 20 // plant_mechanics.Params().twist_every
    qpos[m.jnt_qposadr[up]] = 0.3
    assert cell.mechanics.strain(qpos).max() == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("taper", [1.0, 0.4])
def test_a_rod_of_one_piece_bends_under_a_weight_at_its_end_as_beam_theory_says(taper: float) -> None:
    """Cut in one or in many, tapered or not, what hangs at the end swings alike."""
    frequencies = []
    for pieces in (1, 16):
        radius = RADIUS * np.linspace(1, taper, pieces + 1)
        rod = chain(BASE + np.linspace(0, 0.1, pieces + 1)[:, None] * [0, 1.0, 0], radius, organ=Organ.PETIOLE)
        rod["density"][:] = 1.0
        rod["lump_mass"][-1], rod["lump_centre"][-1] = 1e-3, rod["end"][-1]
        frequencies.append(Cell(plant_of(rod)).mechanics.frequencies[0])
    assert frequencies[0] == pytest.approx(frequencies[1], rel=0.01)


@pytest.mark.parametrize("species", ["tomato", "pepper"])
def test_a_grown_plant_is_fine_enough_and_swings_as_one_cut_finer(species: str, monkeypatch) -> None:
    coarse = grown(species, 11)
    monkeypatch.setattr(Growth, "longest", 0.015)
    fine = GROW[species](11)
    assert coarse.length.max() <= 0.05 + 1e-9
    assert fine.length.max() <= 0.015 + 1e-9
    assert fine.vertices == pytest.approx(coarse.vertices)
    assert fine.mass.sum() == pytest.approx(coarse.mass.sum())
    assert fine.lump_mass @ fine.lump_centre == pytest.approx(coarse.lump_mass @ coarse.lump_centre)
    assert fine.end[fine.flower_segment] == pytest.approx(coarse.end[coarse.flower_segment])
    fine = replace(fine, youngs=np.where(fine.organ == Organ.PEDICEL, fine.youngs, coarse.youngs[0]))
    cut = replace(Params().plant, piece=0.015)
    a, b = Cell(coarse).mechanics, Cell(fine, params=Params(plant=cut)).mechanics
    assert a.frequencies[:10] == pytest.approx(b.frequencies[:10], rel=0.06)


def test_flange_in_the_world_is_the_arm_models_flange() -> None:
    rng = np.random.default_rng(0)
    for q in rng.uniform(SAWYER.lower, SAWYER.upper, (3, 7)):
        cell = Cell(plant_of(chain(np.add(BASE, [[0, 0, 0], [0, 0, 0.1]]), 0.004)), q)
        body = cell.data.body("flange")
        assert body.xpos == pytest.approx(SAWYER.forward(q)[:3, 3], abs=1e-9)
        assert body.xmat.reshape(3, 3) == pytest.approx(SAWYER.forward(q)[:3, :3], abs=1e-9)


def test_leaf_blades_are_boxes_that_touch_and_midribs_are_not() -> None:
    leafy = plant_of(
        chain(BASE + np.linspace(0, 0.2, 5)[:, None] * [0, 0, 1.0], 0.004),
        chain(np.add(BASE, [[0, 0, 0.2], [0.1, 0, 0.2]]), 0.002, organ=Organ.LEAF, joins=3, first=4),
    )
    middle = np.add(BASE, [0.05, 0, 0.2])
    leafy = with_blade(leafy, middle, [0, 0, 1], segment=4)
    _, centre, _, half = (np.array(x) for x in zip(*leaf_boxes(leafy), strict=True))
    assert 4 * (half[:, 0] * half[:, 1]).sum() == pytest.approx(0.6 * 0.06**2, rel=0.4)
    assert centre.mean(axis=0) == pytest.approx(middle, abs=1e-3)
    model = Cell(leafy).model
    assert model.geom("segment_3").contype[0] == 1
    assert model.geom("segment_4").contype[0] == 0
    blades = [model.geom(i) for i in range(model.ngeom) if model.geom(i).name.startswith("blade_")]
    assert len(blades) == len(centre)
    assert all(g.contype[0] == 1 and g.name.endswith("_4") for g in blades)
    cell = Cell(leafy)
    at = np.array([cell.data.geom(g.name).xpos for g in blades])
    assert at == pytest.approx(centre, abs=1e-6)


@pytest.mark.parametrize("species", ["tomato", "pepper"])
def test_the_blades_of_a_grown_plant_cover_its_leaves(species: str) -> None:
    plant = grown(species, 10)
    half = np.array([half for *_, half in leaf_boxes(plant)])
    a, b, c = np.swapaxes(plant.vertices[plant.faces[plant.face_organ == Organ.LEAF]], 0, 1)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    assert 4 * (half[:, 0] * half[:, 1]).sum() == pytest.approx(area, rel=0.25)
    assert half.max() < 0.08


def test_a_pedicel_of_two_segments_swings_as_a_cantilever_with_a_tip_mass() -> None:
    length, radius, youngs, mass = 0.015, 0.0005, 80e6, 1e-4
    pedicel = chain(BASE + np.linspace(0, length, 3)[:, None] * [0, 1.0, 0], radius, organ=Organ.PEDICEL, youngs=youngs)
    pedicel["density"][:] = 50.0  # 0.6 % of the flower
    pedicel["lump_mass"][-1], pedicel["lump_centre"][-1] = mass, pedicel["end"][-1]
    theory = np.sqrt(3 * youngs * np.pi / 4 * radius**4 / (mass * length**3)) / (2 * np.pi)
    assert Cell(plant_of(pedicel)).mechanics.frequencies[0] == pytest.approx(theory, rel=1e-2)


def test_a_leaf_pushed_too_far_stops_short_of_a_right_angle() -> None:
    cell = Cell(grown("tomato", 10))
    heavy = [
        b for b in range(cell.model.nbody) if "plant_" in cell.model.body(b).name and cell.model.body_mass[b] > 2e-3
    ]
    cell.data.xfrc_applied[heavy[-1], 2] = -2.0  # N, on a part of a few grams
    idle(cell, 0.4)
    angles = cell.log().qpos[:, cell.model.jnt_qposadr[cell.mechanics.joints]]
    assert 1.0 < np.abs(angles).max() < np.pi / 2


@pytest.mark.parametrize("held", [False, True])
def test_a_plant_that_is_held_is_stepped_finely_and_is_damped_less_for_it(
    monkeypatch: pytest.MonkeyPatch, held: bool
) -> None:
    """The least damping of a hinge goes with the step: what swings fast swings too little in long ones."""
    cell = Cell(cantilever(damping_ratio=1e-4))
    monkeypatch.setattr(Cell, "held", property(lambda _: held))
    steps, damping, before = list[float](), list[float](), cell.time
    real = Cell._step

    def spied(self: Cell, *given: Any) -> None:
        steps.append(self.timestep)
        damping.append(self.model.dof_damping[self.mechanics.dofs].sum())
        real(self, *given)

    monkeypatch.setattr(Cell, "_step", spied)
    record = SimArm(cell).follow(JointTrajectory.standstill(cell.joints, 0.05))
    assert set(steps) == {cell.params.timestep / (cell.fine if held else 1)}
    assert len(record.times) == pytest.approx((cell.time - before) / cell.params.timestep), "a row for each outer step"
    whole = cell.model.dof_damping[cell.mechanics.dofs].sum()
    assert (damping[0] < 0.9 * whole) == held


def test_a_log_that_is_begun_anew_knows_nothing_of_before() -> None:
    cell = Cell(straight_plant())
    idle(cell, 0.1)
    cell.forget()
    begun = cell.time
    assert cell.log().times.tolist() == [begun]
    idle(cell, 0.05)
    log = cell.log()
    assert log.times[0] == begun
    assert log.times[-1] == pytest.approx(cell.time)
    assert np.all(log.contact_sample < len(log.times))
