"""How far an arm's gripper goes beside what its joints read: links hang on springs, and an arm reads its motors.

Simulated Sawyers whose truth is drawn wide (`anther.sim.truth.WIDE`) hold nothing and move their grip along a line, at
all of `TONES` at once, with 1 m/s2 each. On these were set `ARM_MODE`, `ARM_ERROR`, `ARM_FOLLOWS` and `ARM_ASIDE` of
`anther.pollination.escalation._knowledge`.

Keys of --json, each for a tone <hz>: error_<hz>, error_75_<hz> and error_90_<hz>, quantiles of what is wrong in the
readings over what was commanded; beyond_<hz>, what the gripper does over what is read, median; follows_<hz> and
aside_<hz>, what it does, and aside of the line, over what was commanded, medians; arms.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.box import MARKDOWN
from rich.console import Console
from rich.progress import track
from rich.table import Table

from anther.core import Array
from anther.core.files import write_json
from anther.pollination.escalation._knowledge import ARM_ERROR, ARM_MODE, gripper_motion
from anther.pollination.shake.observables import ComplexArray
from anther.pollination.shake.params import FAST
from anther.robot import ArmSample
from anther.robot.arm.sawyer import READY, SAWYER
from anther.sim import cell as world
from anther.sim import grow
from evaluation.trials.grasping_trial import truth_of

TONES = np.array([2.7, 4.3, 6.4, 8.5, 11.3, 14.1, 16.9, 18.5, 20.5])
FIRST, LINES = 7700, 2
RAMP, SECONDS = 0.5, 2.5
FAR = 5.0  # m: the plant that a cell must have


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
        return gripper_motion(samples, lambda q: (flanges(q) @ held)[:, :3], tones) / sizes[:, None]

    return phasors(log.joints, SAWYER.forward), phasors(log.qpos, cell.flange_pose)


def main() -> None:
    """Measure, print a table, write --json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--arms", type=int, default=24)
    args = parser.parse_args()
    console = Console()
    cases = [(FIRST + k, line) for k in range(args.arms) for line in range(LINES)]
    along, read, true = map(
        np.array, zip(*(swings(*case) for case in track(cases, "arms", console=console)), strict=True)
    )
    error, size = np.linalg.norm(true - read, axis=2), np.linalg.norm(true, axis=2)
    straight = np.einsum("nqx,nx->nq", true, along)
    aside = np.linalg.norm(true - straight[..., None] * along[:, None], axis=2)
    told: dict[str, float] = {"arms": float(args.arms)}
    console.print(f"{args.arms} arms, {LINES} lines each. Errors and motions are shares of what was commanded.")
    heads = ("readings' error, median", "75 %", "90 %", "`ARM_ERROR` takes")
    moves = ("grip moves / is read, median", "`ARM_MODE` takes", "grip moves / was told, median", "aside, median")
    table = Table("frequency, Hz", *heads, *moves, box=MARKDOWN)
    for k, hertz in enumerate(TONES):
        own = {
            "error": float(np.median(error[:, k])),
            "error_75": float(np.quantile(error[:, k], 0.75)),
            "error_90": float(np.quantile(error[:, k], 0.9)),
            "beyond": float(np.median(size[:, k] / np.linalg.norm(read[:, k], axis=1))),
            "follows": float(np.median(size[:, k])),
            "aside": float(np.median(aside[:, k])),
        }
        told |= {f"{name}_{hertz:g}": value for name, value in own.items()}
        taken = [ARM_ERROR * (hertz / FAST) ** 3, 1 / (1 - (hertz / ARM_MODE) ** 2)]
        cells = [*list(own.values())[:3], taken[0], own["beyond"], taken[1], own["follows"], own["aside"]]
        table.add_row(f"{hertz:g}", *(f"{cell:.2f}" for cell in cells))
    console.print(table)
    if args.json:
        write_json(args.json, told)


if __name__ == "__main__":
    main()
