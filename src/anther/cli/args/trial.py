"""See, grasp and shake one plant, simulated or real, measure how its flowers answer, and write a report."""

from __future__ import annotations

import platform
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from anther.cli.args.shared import HISTORY, Overwrite, Stage, stage
from anther.core.choices import ActuatorName, ArmName, Crop, MaskSource, Preset


@dataclass(frozen=True)
class Args(Overwrite):
    """Attributes: which plant, how it is seen, and where the run is kept."""

    plant: Crop = "tomato"
    """Species of the simulated plant."""
    cell: str = "simulated"
    """Which cell: 'simulated', or a cell file of a real one (docs/cell_file.md). Of a real one nobody knows the truth:
    seed, viewpoint, distance and truth say nothing, and the verdict is what the gripper felt."""
    simulate: bool = False
    """Simulate the cell of the cell file, its arm, gripper, cameras and boxes, around a plant; no machine is contacted.
    What the file lacks is supposed, and a line says so (docs/sim_cell.md)."""
    label: str = ""
    """Name of a real plant, for its history."""
    seed: int = 0
    """Which plant; all noise comes from it too."""
    stem: int | None = None
    """Which of several stems in view, from 0 on, along x (along y where they spread more along y). By default the one
    in the middle of the workspace."""
    root: str | None = None
    """Where the stem leaves the soil, if you know better: x,y,z [m], in the arm's frame."""
    viewpoint: float = 0.0
    """Turn the plant about its pot's axis [degrees]."""
    arm: ArmName | None = None
    """Which arm, by default a Sawyer; a cell file names its own (docs/arm.md)."""
    distance: float | None = None
    """Of the pot in front of the arm [m]; by default what suits the arm: 0.72 for a Sawyer."""
    preset: Literal["fast", "full"] = "fast"
    """Few views along a short way, or views all around, which take three times as long and find a few more flowers."""
    views: int | None = None
    """How many RGB-D views the arm takes; by default what the preset says: 10, or 30 when full."""
    masks: MaskSource = "colour"
    """What finds plant and flowers: colour and geometry, Grounding DINO and SAM 2, or SAM 3 (docs/masks.md)."""
    models: Path = Path("models")
    """Folder with the weights of the networks."""
    out: Path | None = None
    """Run folder; by default runs/PLANT-SEED-VIEWPOINT."""
    restart_from: str | None = None
    """Read the results of earlier stages from the run folder and go on from this stage, or 'where-it-stopped'."""
    history: str = HISTORY
    """Trial history to learn from and to add this trial to: a SQLite file, or postgresql://USER:PASSWORD@HOST/DATABASE."""
    robot: str = field(default_factory=platform.node)
    """Name of this robot in the history; by default the computer's."""
    truth: Literal["nominal", "wide"] = "nominal"
    """What is true of plant, air, pads, arm and camera: as usual, or drawn from the seed wider than any stage believes.
    It is for judging: no stage is told."""
    material: Literal["learned", "facts"] = "learned"
    """Begin with what the history teaches of this plant or its crop, and with the shake that its last visit ended with;
    or as if nothing had ever been measured."""
    shake: Preset | None = None
    """How boldly the plant may be loaded (docs/shake.md has the limits); by default what --params says. 'paper' is
    the paper's own shake, 12 mm at 1.9 Hz: no limit of the plant is kept, slip is not prevented, nothing is raised."""
    watch: bool = True
    """Raise the shake in steps by what the side camera sees, or carry out the plan alone."""
    actuator: ActuatorName | None = None
    """What shakes the plant: the arm, or a motor in the gripper (docs/gripper_motor.md), which is always watched."""
    log: bool = True
    """Write log.mcap, which Foxglove opens and `anther view --live` shows as it happens (docs/log.md)."""
    params: Stage = stage("anther.pollination.pipeline")
    """Parameters of the stages."""
