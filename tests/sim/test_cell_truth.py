"""What a truth changes in the simulated cell: pads and joints give way as it says, and nothing that it leaves out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fake_robot import horizontal_grasp
from small_planner import SmallPlanner, solve
from straight_plant import BASE, chain, plant_of, straight_plant

from anther.core.geometry import Array, inverse, small_transform
from anther.pollination.shake.pads import friction_force
from anther.robot.arm.sawyer import SAWYER, TOOL
from anther.robot.swing import whole_shake
from anther.sim.cell import Cell, mujoco
from anther.sim.judge import judge
from anther.sim.robot import SimArm
from anther.sim.truth import NOMINAL, Truth, draw

GRASP = TOOL.T_flange_grasp
Q = solve(horizontal_grasp(np.add(BASE, [0, 0, 0.22]), np.zeros(7)).T_world_flange)
BESIDE = solve(horizontal_grasp(np.add(BASE, [-0.15, 0, 0.2]), np.zeros(7)).T_world_flange)
ROD = plant_of(chain(BASE + np.linspace(0, 0.3, 13)[:, None] * [0, 0, 1.0], 0.004, youngs=1e11), damping_ratio=0.3)
PADS = replace(NOMINAL, pad_stiffness=6e3, pad_rotation=0.4)


def go(cell: Cell, q: Array, opening: float, steps: int = 300, rest: int = 100) -> None:
    share = np.r_[np.linspace(0, 1, steps), np.ones(rest)]
    start, was = cell.arm_command, cell.grip_command
    cell.run(start + share[:, None] * (q - start), np.zeros((len(share), 7)), was + share * (opening - was))


def push(truth: Truth, turn: float, move: Array) -> tuple[Array, Array, Array, Array]:
    """Close on a stiff rod, move the flange about the pads' centre; return the load on the pads and how they moved.

    Force (3,) [N], moment (3,) [N m], T_pads (4, 4) of the pads and T_rod of the rod, in the frame of the pads' centre.
    """
    cell = Cell(ROD, Q, truth=truth)
    go(cell, Q, 0.0)
    T_flange_rod = inverse(cell.flange_pose()) @ cell.segment_poses()[8]
    moved = SAWYER.forward(Q) @ GRASP @ small_transform([0, turn, 0], move) @ inverse(GRASP)
    go(cell, solve(moved, Q), 0.0, 60, 40)  # soon: friction creeps
    centre, force, moment, wrench = cell.flange_pose() @ GRASP, np.zeros(3), np.zeros(3), np.zeros(6)
    for i in range(cell.data.ncon):
        contact = cell.data.contact[i]
        mujoco.mj_contactForce(cell.model, cell.data, i, wrench)
        sign = 1 if cell.model.geom(contact.geom[0]).name.startswith("segment_") else -1
        one, about = sign * (wrench.reshape(2, 3) @ contact.frame.reshape(3, 3))
        force, moment = force + one, moment + about + np.cross(contact.pos - centre[:3, 3], one)
    T_pads = inverse(cell.flange_pose()) @ cell.pads_pose()
    T_rod = inverse(cell.flange_pose()) @ cell.segment_poses()[8] @ inverse(T_flange_rod)
    R = centre[:3, :3].T
    return R @ force, R @ moment, inverse(GRASP) @ T_pads @ GRASP, inverse(GRASP) @ T_rod @ GRASP


def test_a_nominal_cell_has_no_springs_in_arm_and_pads() -> None:
    plain, soft = Cell(ROD), Cell(ROD, truth=replace(PADS, joint_stiffness=1.0))
    assert plain.model.nq == 7 + 2 + len(plain.mechanics.dofs)
    assert soft.model.nq == plain.model.nq + 7 + 6
    assert np.array_equal(plain.pads_pose(), plain.flange_pose())
    assert plain.model.body("flange").subtreemass == pytest.approx(soft.model.body("flange").subtreemass)


@pytest.mark.parametrize("axis", [0, 2])
def test_a_held_rod_gives_way_across_the_closing_axis_as_the_pads_stiffness_says(axis: int) -> None:
    way = 0.0015 * np.eye(3)[axis]
    force, _, pads, rod = push(PADS, 0.0, way)
    assert abs(force[axis]) > 2.0
    assert pads[axis, 3] == pytest.approx(force[axis] / PADS.pad_stiffness, rel=0.1)
    assert rod[axis, 3] == pytest.approx(pads[axis, 3], rel=0.15)
    assert abs(pads[1, 3]) < 1e-9


def test_a_held_rod_turns_about_the_closing_axis_as_the_pads_rotation_says() -> None:
    _, moment, pads, rod = push(PADS, 0.08, np.zeros(3))
    turn = np.arctan2(pads[0, 2], pads[0, 0])
    assert abs(turn) > 0.05
    assert turn == pytest.approx(moment[1] / PADS.pad_rotation, rel=0.1)
    assert np.arctan2(rod[0, 2], rod[0, 0]) == pytest.approx(turn, rel=0.15)


@pytest.mark.parametrize(
    ("turn", "far", "slides"),
    [(0.0, 0.0012, False), (0.08, 0.0, False), (0.05, 0.001, False), (0.5, 0.0, True), (0.15, 0.006, True)],
)
def test_a_held_rod_slides_where_the_planner_says(turn: float, far: float, slides: bool) -> None:
    """Pushed across and turned about the closing axis: it stays below what pads of 10 N bear, and slides above."""
    force, moment, pads, rod = push(replace(PADS, pad_friction=0.5), turn, np.array([0.0, 0.0, far]))
    pull, pivot = np.hypot(force[0], force[2]), abs(moment[1])
    asked = friction_force(pull, pivot, np.array(0.0), radius=0.004, width=0.016)
    T = inverse(pads) @ rod
    away = np.linalg.norm(T[:3, 3]) + 0.008 * abs(np.arctan2(T[0, 2], T[0, 0]))
    assert (asked > 0.95 * 2 * 0.5 * 10.0) == slides
    assert (away > 0.001) == slides


def test_a_worn_pad_has_less_friction_and_only_one_is_worn() -> None:
    model = Cell(ROD, truth=replace(NOMINAL, pad_friction=0.8, pad_wear=0.25)).model
    friction = [model.geom(f"{side}_pad").friction[0] for side in ("left", "right")]
    assert sorted(friction) == pytest.approx([0.6, 0.8])


def test_a_soft_grip_is_still_a_grip() -> None:
    """Pads on springs are known as pads, hold with the gripper's force, and stand as far apart as the rod is thick."""
    cell = Cell(ROD, Q, truth=PADS)
    go(cell, Q, 0.0)
    log = cell.log()
    last = log.contact_sample == len(log.times) - 1
    assert set(log.contact_pad[last]) == {0, 1}
    assert cell.grip_force == pytest.approx(10.0, rel=0.01)
    assert cell.opening == pytest.approx(0.008, abs=0.0008)


def test_pads_that_give_way_do_not_slip() -> None:
    cell = Cell(ROD, Q, truth=PADS)
    go(cell, Q, 0.0)
    start, point = cell.time, (cell.flange_pose() @ GRASP)[:, 3]
    go(cell, solve(SAWYER.forward(Q) @ small_transform([0, 0, 0], [0, 0, 0.0015]), Q), 0.0, 60, 40)
    log, verdict = cell.log(), judge(cell, (start, cell.time), 5.0)
    seen = inverse(cell.flange_pose(log.qpos[log.times >= start])) @ point  # the rod is too stiff to follow
    assert np.ptp(seen[:, 2]) > 0.0006
    assert verdict.slip < 0.0002


def test_a_joint_gives_way_by_torque_over_stiffness_and_its_encoder_does_not_see_it() -> None:
    truth = replace(NOMINAL, joint_stiffness=2.0)
    cell, force = Cell(ROD, BESIDE, truth=truth), np.array([3.0, 4.0, -5.0])
    m, d = cell.model, cell.data
    flange = m.body("flange").id
    go(cell, BESIDE, cell.opening)
    assert cell.flange_pose() == pytest.approx(SAWYER.forward(BESIDE), abs=1e-6)  # its own weight is carried
    for share in np.linspace(0, 1, 20):
        d.xfrc_applied[flange, :3] = share * force
        go(cell, BESIDE, cell.opening, 50)
    go(cell, BESIDE, cell.opening, 3000)
    flex = [m.joint(f"{name}_flex") for name in SAWYER.joints]
    angle = np.array([d.qpos[joint.qposadr[0]] for joint in flex])
    place, axis = (np.array([x[joint.id] for joint in flex]) for x in (d.xanchor, d.xaxis))
    torque = np.einsum("ji,ji->j", axis, np.cross(d.xipos[flange] - place, force))
    assert np.abs(torque).max() > 1.0
    assert angle == pytest.approx(torque / (2.0 * SAWYER.stiffness), rel=0.05, abs=1e-6)
    assert cell.flange_pose() == pytest.approx(SAWYER.forward(cell.joints + angle), abs=1e-12)
    assert d.body("flange").xpos == pytest.approx(cell.flange_pose()[:3, 3], abs=1e-5)


def shaken(truth: Truth, seed: int = 0, rest: int = 500) -> tuple[float, float, float]:
    """Shake 1 mm at 5 Hz beside the plant; return the amplitudes of motors and flange, and what is left in the end [m].

    The first two in the direction asked for, the last the largest swing.
    """
    cell = Cell(replace(straight_plant(), seed=seed), BESIDE, truth=truth)
    SimArm(cell).follow(SmallPlanner().swing(BESIDE, (0, 1.0, 0), whole_shake(0.001, 5.0, 2.4), 0.001))
    go(cell, BESIDE, cell.opening, 2, rest)
    log = cell.log()
    steady, after = (log.times > 0.6) & (log.times <= 1.6), log.times > log.times[-1] - 0.5
    wave = np.exp(-10j * np.pi * log.times[steady])
    said, true = SAWYER.forward(log.joints)[:, :3, 3], cell.flange_pose(log.qpos)[:, :3, 3]
    a, b = (2 * abs((y[steady, 1] * wave).mean()) for y in (said, true))
    return a, b, float(np.ptp(true[after], axis=0).max())


@pytest.mark.slow
def test_stiffer_and_stiffer_joints_are_rigid_ones() -> None:
    rigid = shaken(NOMINAL)
    assert rigid[1] == pytest.approx(0.001, rel=0.01)
    errors = [abs(shaken(replace(NOMINAL, joint_stiffness=k))[1] - rigid[1]) for k in (20.0, 100.0, 500.0)]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.01 * rigid[1]


@pytest.mark.slow
def test_five_drawn_arms_follow_a_shake_and_come_to_rest() -> None:
    """Servos and loads that the arm does not know cost 10 %; what joints as soft as Baxter's add, no encoder sees.

    At 5 Hz they are above their resonance, or near it: the flange swings by up to four times what was asked for.
    """
    for seed in range(5):
        truth = draw(seed, "arm")
        rigid, elastic = shaken(replace(truth, joint_stiffness=np.inf), seed), shaken(truth, seed, 3500)
        assert rigid[1] == pytest.approx(0.001, rel=0.1)
        assert rigid[0] == pytest.approx(rigid[1], rel=1e-3)
        assert elastic[0] < 0.0015
        assert elastic[1] < 0.004
        assert elastic[2] < 0.05 * elastic[1]


def test_errors_of_the_expected_torque_come_from_the_plant_s_seed() -> None:
    unsure = replace(NOMINAL, feedforward_error=0.25)
    first, again, other = shaken(unsure, 1), shaken(unsure, 1), shaken(unsure, 2)
    assert first == again
    assert abs(first[0] - other[0]) > 1e-5


@pytest.mark.parametrize("stiffness", [2e3, 3e4])
@pytest.mark.parametrize("rotation", [0.1, 2.0])
def test_a_stem_between_drawn_pads_comes_to_rest(stiffness: float, rotation: float) -> None:
    """Softest and stiffest pads on the stiffest joints: after a shake with a stem held, all speeds fall."""
    truth = replace(NOMINAL, pad_stiffness=stiffness, pad_rotation=rotation, joint_stiffness=5.0, pad_wear=0.3)
    cell = Cell(straight_plant(), Q, truth=truth)
    go(cell, Q, 0.0)
    SimArm(cell).follow(SmallPlanner().swing(Q, (0, 1.0, 0), whole_shake(0.001, 8.0, 1.0), 0.001))
    shaken = np.abs(cell.data.qvel).max()
    go(cell, Q, 0.0, 3000)
    assert np.abs(cell.data.qvel).max() < 0.02 * shaken
    assert cell.grip_force == pytest.approx(10.0, rel=0.01)
