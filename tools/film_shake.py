"""Write the README's film: a simulated trial's watched shake from the side camera's place, at half the speed.

python tools/film_shake.py docs/pictures/shake.webp [tomato|pepper] [SEED]
"""

import sys
from pathlib import Path
from typing import Any, cast

import numpy as np

from anther.core import Run
from anther.plant import PRIORS, Crop
from anther.pollination import Params, pollinate
from anther.robot.devices import Frame
from anther.show.film import save_film, with_robot
from anther.sim import Scene, build
from anther.sim.robot import SIDE
from anther.sim.simulated_cell import PRESETS

RATE, PERIODS = 40, 6
"""Pictures a second, and periods of the shake: whole ones, so that the film goes on as it began."""


class Quiet(Run):
    """A run that keeps nothing."""

    def stage(self, name: str, load: Any, compute: Any, save: Any = None) -> Any:
        """Compute a stage."""
        return compute(lambda *_: None)


def main(out: str, species: str = "tomato", seed: str = "2") -> None:
    """Run the trial and write the film of its last, held shake."""
    cell = build(cast(Crop, species), int(seed), 0.0, PRESETS["fast"])
    done = pollinate(cell.robot_side, PRIORS[species], Quiet(Path(), quiet=True), Params())
    log, side, period = cell.world.log(), cell.robot_side.robot, 1 / done.shake.frequency
    end, scene = done.trial.steady[1], Scene.of_plant(cell.plant)
    frames, poses = [], []
    for time in np.linspace(end - PERIODS * period, end, round(PERIODS * period * RATE), endpoint=False):
        poses.append(cell.world.segment_poses(log.qpos[int(np.searchsorted(log.times, time))]))
        seen = scene.moved(cell.plant.posed_vertices(poses[-1])).render(SIDE, side.T_world_side_camera)
        frames.append(Frame(float(time), seen.rgb, seen.depth))
    Path(out).parent.mkdir(parents=True, exist_ok=True)
    save_film(Path(out), with_robot(frames, done.trial, side, cell.world.arm), seconds=np.inf)
    print(f"{out}: {len(frames)} pictures, {Path(out).stat().st_size / 1e6:.1f} MB, {done.shake.reason}")
    print(f"a segment turns by up to {np.degrees(widest_turn(np.array(poses))):.0f} degrees")


def widest_turn(poses: Any) -> float:
    """Return the largest angle [rad] between poses (T, K, 4, 4) of one segment at two times of a period."""
    first, turned = poses[:1, :, :3, :3], poses[:, :, :3, :3]
    relative = np.einsum("tkij,tkil->tkjl", np.broadcast_to(first, turned.shape), turned)
    angle = np.arccos(np.clip((np.trace(relative, axis1=2, axis2=3) - 1) / 2, -1, 1))
    return float(np.ptp(angle, axis=0).max())


if __name__ == "__main__":
    main(*sys.argv[1:])
