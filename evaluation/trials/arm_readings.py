"""What an arm's grip does beside what its motors read and what it is told, where it holds plants: joints are springs.

Simulated Sawyers whose truth is drawn wide (`anther.sim.truth.WIDE`) stand where they would grasp drawn plants, hold
nothing, and move their grip along a line at all of `TONES` at once, with 0.3 m/s2 each. Checked are the equations of
`anther.robot.arm.compliance`, with the joints' true stiffness and as it is believed, against MuJoCo's.

Keys of --json, each for a tone <hz>: rigid_<hz>, median error of what the readings say of the grip if joints are rigid,
over what was commanded; springs_<hz>, known_<hz>, the same through springs as stiff as is believed, and as they truly
are; delivers_<hz>, spread_<hz>, mean and standard deviation of ln of what the grip does along the line over what was
commanded; believed_<hz>, the standard deviation that is believed of one arm; outside_<hz>, the share of arms outside of
what is believed of nine in ten; arms.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from anther.core import Array
from anther.core.geometry import ComplexArray
from anther.perception.capture import no_keep
from anther.plant import Crop
from anther.pollination import Params, pipeline
from anther.pollination.escalation._knowledge import fit_motors
from anther.robot import ArmSample
from anther.robot.arm import compliance
from anther.robot.arm.sawyer import SAWYER
from anther.sim import Truth, build, grow
from anther.sim import cell as world
from anther.sim.simulated_cell import PRESETS
from evaluation.harness import by_turns, finish, options, progress
from evaluation.tables import markdown
from evaluation.trials.grasping_trial import Memory, truth_of

TONES = np.array([2.7, 4.3, 6.4, 8.5, 11.3, 14.1, 16.9, 20.5, 24.0, 30.0])
FIRST = 7700
SIZE = 0.3
"""Of each tone [m/s2]: with all of them no motor comes near to what it can."""
RAMP, SECONDS = 0.5, 2.5
FAR = 5.0  # m: the plant that a cell must have


def holding(species: Crop, seed: int, truth: Truth) -> Array:
    """Return the joints (J,) at the best grasp of a plant [rad]."""
    cell = build(species, seed, 90.0 * (seed % 4), PRESETS["fast"], truth=truth)
    side, run, params = cell.robot_side, Memory(Path()), Params()
    seen = pipeline.perceive(side.take_views(lambda *_: None, no_keep), side.workspace, run, params)
    best = pipeline.rank_grasps(seen, side.plan_around(seen.cloud).reach, run, params)[0]
    assert best.joints is not None
    return best.joints


def swings(truth: Truth, joints: Array, along: Array, seed: int = FIRST) -> tuple[ComplexArray, ComplexArray]:
    """Return phasors over what is commanded: of the motors (Q, J) [rad/m], and of the grip (Q, 3) as it truly moves.

    Args:
        truth: of the arm.
        joints: (J,) about which it moves [rad].
        along: (3,) unit.
        seed: of what of the arm its truth leaves open.
    """
    cell = world.Cell(grow("pepper", seed, 0, FAR), joints, truth=truth, arm=SAWYER)
    sizes = SIZE / (2 * np.pi * TONES) ** 2
    times = cell.timestep * np.arange(round(SECONDS / cell.timestep))
    move = np.clip(times / RAMP, 0, 1) * (sizes @ np.sin(2 * np.pi * TONES[:, None] * times))
    way = np.linalg.pinv(SAWYER.jacobian(joints))[:, :3] @ along
    begin = cell.time
    cell.run(
        joints + move[:, None] * way,
        np.gradient(move, cell.timestep)[:, None] * way,
        np.full(len(times), cell.grip_command),
    )
    log = cell.log()
    steady = log.times > begin + 2 * RAMP
    held = np.r_[SAWYER.tool.T_flange_grasp[:3, 3], 1]
    grip = (cell.flange_pose(log.qpos[steady]) @ held)[:, :3]

    def phasors(values: Array) -> ComplexArray:
        samples = [ArmSample(t, q, q) for t, q in zip(log.times[steady] - begin, values, strict=True)]
        return fit_motors(samples, TONES) / sizes[:, None]

    return phasors(log.joints[steady]), phasors(grip)


def one_arm(species: Crop, seed: int) -> dict[str, Array]:
    """Return by key of the table (Q,) what one arm does; `off`: from what is believed, in standard deviations."""
    truth = truth_of("wide", seed)
    joints, angle = holding(species, seed, truth), np.random.default_rng(seed).uniform(0, np.pi)
    along = np.array([np.cos(angle), np.sin(angle), 0.0])
    motors, grip = swings(truth, joints, along, seed)
    stiffer = np.log(truth.joint_stiffness / compliance.STIFFNESS) / compliance.STIFFNESS_SPREAD
    rigid = 20.0  # standard deviations: no spring yields
    said = compliance.grip_motion(SAWYER, joints, motors, TONES, np.array([rigid, 0.0, stiffer]))
    errors = dict(zip(("rigid", "springs", "known"), np.linalg.norm(said - grip, axis=2), strict=True))
    mean, spread = (part[:, 0] for part in compliance.delivered(SAWYER, joints, along[None], TONES))
    delivers = np.log(np.abs(grip @ along))
    return errors | {"delivers": delivers, "believed": spread, "off": (delivers - mean) / spread}


def main() -> None:
    """Measure, print a table, write --json."""
    args = options(
        __doc__, quick="three arms", seed=(FIRST, "of the first plant"), own={"--arms": (24, "simulated Sawyers")}
    )
    arms = 3 if args.quick else args.arms
    rows = [one_arm(*plant) for plant in progress(by_turns(arms, args.seed), "arms")]
    found = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    table = {name: np.median(found[name], axis=0) for name in ("rigid", "springs", "known")}
    table |= {"delivers": found["delivers"].mean(axis=0), "spread": found["delivers"].std(axis=0)}
    table |= {
        "believed": np.median(found["believed"], axis=0),
        "outside": np.mean(np.abs(found["off"]) > 1.645, axis=0),
    }
    heads = (
        *("frequency, Hz", "readings' error: rigid joints", "springs as believed", "springs as they are"),
        *("ln(grip / command): mean", "spread", "believed of one arm", "outside of nine in ten"),
    )
    lines = [(f"{hz:g}", *(f"{part[k]:.2f}" for part in table.values())) for k, hz in enumerate(TONES)]
    values = {f"{name}_{hz:g}": float(v) for name, part in table.items() for hz, v in zip(TONES, part, strict=True)}
    words = f"{arms} arms. Errors are shares of what was commanded, medians."
    finish(args, {"arms": float(arms), **values}, words, markdown(heads, lines))


if __name__ == "__main__":
    main()
