"""RGB-D views of a plant -> cloud, skeleton, main stem, flowers, grasp, and a report."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from anther.cli.args.shared import Given, Overwrite, Place, Stage, stage
from anther.core.choices import MaskSource


@dataclass(frozen=True)
class Args(Overwrite, Place):
    """Attributes: what to reconstruct and where to write it."""

    capture: Given
    """Capture folder with a transforms.json (docs/capture.md says what it holds)."""
    out: Path | None = None
    """Run folder; by default runs/ and the capture's name."""
    workspace: tuple[float, float, float, float, float, float] | None = None
    """Box the plant stands in: x0 y0 z0 x1 y1 z1 [m]. By default it is found from where the cameras look."""
    plant: int | None = None
    """Which of several plants in view, from 0 on, along x (along y where they spread more along y). By default the one
    in the middle of the workspace."""
    masks: MaskSource = "colour"
    """What finds plant and flowers: colour and geometry, Grounding DINO and SAM 2, or SAM 3 (docs/masks.md)."""
    models: Path = Path("models")
    """Folder with the weights of the networks."""
    restart_from: str | None = None
    """Read the results of earlier stages from the run folder and go on from this stage."""
    params: Stage = stage("anther.pollination.pipeline")
    """Parameters of the stages."""
