"""How far an arm's gripper goes beside what its joints read: links hang on springs, and an arm reads its motors.

Simulated Sawyers whose truth is drawn wide (`anther.sim.truth.WIDE`) hold nothing and move their grip along a line, at
all of `TONES` at once, with 1 m/s2 each. On these were set, in
`anther.pollination.escalation._knowledge`, `ARM_MODE`, `ARM_ERROR`, and how far an arm follows and goes aside.

Keys of --json, each for a tone <hz>: error_<hz>, error_75_<hz> and error_90_<hz>, quantiles of what is wrong in the
readings over what was commanded; beyond_<hz>, what the gripper does over what is read, median; follows_<hz> and
aside_<hz>, what it does, and aside of the line, over what was commanded, medians; arms.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from anther.core import Array
from anther.pollination.escalation._knowledge import ARM_ERROR, ARM_MODE, fit_gripper_motion
from anther.pollination.shake.observables import ComplexArray
from anther.pollination.shake.params import FAST
from anther.robot import ArmSample
from anther.robot.arm.sawyer import READY, SAWYER
from anther.sim import cell as world
from anther.sim import grow
from evaluation.harness import finish, options, progress
from evaluation.tables import markdown
from evaluation.trials.grasping_trial import truth_of

TONES = np.array([2.7, 4.3, 6.4, 8.5, 11.3, 14.1, 16.9, 18.5, 20.5])
FIRST, LINES = 7700, 2
RAMP, SECONDS = 0.5, 2.5
FAR = 5.0  # m: the plant that a cell must have


HEADS = (
    *("frequency, Hz", "readings' error, median", "75 %", "90 %", "`ARM_ERROR` takes", "grip moves / is read, median"),
    *("`ARM_MODE` takes", "grip moves / was told, median", "aside, median"),
)


def swings(seed: int, line: int) -> tuple[Array, ComplexArray, ComplexArray]:
    """Return the line (3,), and (Q, 3) phasors of the grip as it is read and as it is, over what was commanded."""
    angle = np.random.default_rng(seed + 100 * line).uniform(0, np.pi)
    along = np.array([np.cos(angle), np.sin(angle), 0.0])
    return along, *read_and_true(seed, READY, along, TONES)


def read_and_true(seed: int, joints: Array, along: Array, tones: Array) -> tuple[ComplexArray, ComplexArray]:
    """Return (Q, 3) phasors of an empty grip as it is read and as it is, over what was commanded.

    Args:
        seed: of the truth.
        joints: (J,) about which the arm moves [rad].
        along: (3,) unit, of the line.
        tones: (Q,) [Hz], all at once, with 1 m/s2 each.
    """
    cell = world.Cell(grow("pepper", FIRST, 0, FAR), joints, truth=truth_of("wide", seed), arm=SAWYER)
    sizes = 1 / (2 * np.pi * tones) ** 2
    times = cell.timestep * np.arange(round(SECONDS / cell.timestep))
    move = np.clip(times / RAMP, 0, 1) * (sizes @ np.sin(2 * np.pi * tones[:, None] * times))
    way = np.linalg.pinv(SAWYER.jacobian(joints)) @ np.r_[along, 0, 0, 0]
    begin = cell.time
    cell.run(
        joints + move[:, None] * way,
        np.gradient(move, cell.timestep)[:, None] * way,
        np.full(len(times), cell.grip_command),
        np.zeros((len(times), SAWYER.count)),
    )
    log = cell.log()
    steady = log.times > begin + 2 * RAMP

    def phasors(places: Array, flanges: Callable[[Array], Array]) -> ComplexArray:
        samples = [ArmSample(t, q, q) for t, q in zip(log.times[steady] - begin, places[steady], strict=True)]
        held = np.r_[SAWYER.tool.T_flange_grasp[:3, 3], 1]
        return fit_gripper_motion(samples, lambda q: (flanges(q) @ held)[:, :3], tones) / sizes[:, None]

    return phasors(log.joints, SAWYER.forward), phasors(log.qpos, cell.flange_pose)


def main() -> None:
    """Measure, print a table, write --json."""
    args = options(
        __doc__, quick="three arms", seed=(FIRST, "of the first truth"), own={"--arms": (24, "simulated Sawyers")}
    )
    arms = 3 if args.quick else args.arms
    cases = [(args.seed + k, line) for k in range(arms) for line in range(LINES)]
    along, read, true = map(np.array, zip(*(swings(*case) for case in progress(cases, "arms")), strict=True))
    error, size = np.linalg.norm(true - read, axis=2), np.linalg.norm(true, axis=2)
    straight = np.einsum("nqx,nx->nq", true, along)
    aside = np.linalg.norm(true - straight[..., None] * along[:, None], axis=2)
    columns = {
        "error": np.median(error, axis=0),
        "error_75": np.quantile(error, 0.75, axis=0),
        "error_90": np.quantile(error, 0.9, axis=0),
        "beyond": np.median(size / np.linalg.norm(read, axis=2), axis=0),
        "follows": np.median(size, axis=0),
        "aside": np.median(aside, axis=0),
    }
    taken = [ARM_ERROR * (TONES / FAST) ** 3, 1 / (1 - (TONES / ARM_MODE) ** 2)]
    first, beyond, rest = list(columns.values())[:3], columns["beyond"], [columns["follows"], columns["aside"]]
    rows = zip(*first, taken[0], beyond, taken[1], *rest, strict=True)
    lines = [(f"{hz:g}", *(f"{cell:.2f}" for cell in row)) for hz, row in zip(TONES, rows, strict=True)]
    values = {f"{name}_{hz:g}": v for name, column in columns.items() for hz, v in zip(TONES, column, strict=True)}
    words = f"{arms} arms, {LINES} lines each. Errors and motions are shares of what was commanded."
    finish(args, {"arms": float(arms), **values}, words, markdown(HEADS, lines))


if __name__ == "__main__":
    main()
