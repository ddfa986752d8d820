"""Draw the README's picture from a finished run: what the camera saw, the plant with the grasp, the flowers' motion.

python tools/draw_readme.py runs/demo docs/pictures/trial.png
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from anther.show import read_run
from anther.show.pictures import plant, report
from anther.show.scene import layers_of


def main(run: str, out: str) -> None:
    """Read the run and write the picture."""
    results = read_run(run)
    if results.capture is None or results.cloud is None or results.skeleton is None or results.stem is None:
        sys.exit(f"{run}: perception stopped too early to draw.")
    if results.shake is None or results.response is None or results.flowers is None:
        sys.exit(f"{run}: the plant was not shaken, so there is no motion to draw.")
    figure = Figure(figsize=(13, 4.6), layout="constrained")
    photo, tree, motion = figure.subplots(1, 3, width_ratios=[1.75, 0.95, 1.15])
    level = np.abs(results.capture.T_world_cam[:, 2, 2])
    photo.imshow(report.overlay(results.capture, results.masks, int(level.argmin())))
    photo.set_axis_off()
    photo.set_title(f"one of {results.capture.views} views: plant (green), flowers (magenta)")
    layers = {layer.name: layer for layer in layers_of(results)}
    names = ("cloud", "main stem", "branches", "trusses", "leaves", "flowers", "gripper", "grasp")
    plant.draw_side(tree, plant.facing(results.shake.grasp), [layers[name] for name in names if name in layers])
    tree.set(title="skeleton, main stem, flowers, gripper")
    report.draw_amplitudes(motion, results.executed or results.shake, results.response)
    done = results.executed or results.shake
    motion.set_xlabel(f"flower; shaken {1000 * done.amplitude:.2g} mm at {done.frequency:.1f} Hz")
    Path(out).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=110)


if __name__ == "__main__":
    main(*sys.argv[1:])
