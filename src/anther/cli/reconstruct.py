"""RGB-D views of a plant -> cloud, skeleton, main stem, flowers, grasp, and a report."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from anther.cli.run_folder import finish, open_run
from anther.core.geometry import Box
from anther.perception.capture import Capture
from anther.plant.imported import known_better
from anther.pollination.pipeline import MaskSource, Params, cause_named, mask_finder, perceive, rank_grasps


@dataclass(frozen=True)
class Args:
    """Attributes: what to reconstruct and where to write it."""

    capture: Annotated[Path, tyro.conf.Positional]
    """Capture folder with a transforms.json (docs/capture.md says what it holds)."""
    out: Path | None = None
    """Run folder; by default runs/ and the capture's name."""
    workspace: tuple[float, float, float, float, float, float] | None = None
    """Box the plant stands in: x0 y0 z0 x1 y1 z1 [m]. By default it is found from where the cameras look."""
    root: str | None = None
    """Where the stem leaves the soil, if you know better: x,y,z [m], as `anther view` prints it on a click."""
    stem_tip: str | None = None
    """Where the main stem ends, if you know better: x,y,z [m]."""
    masks: MaskSource = "colour"
    """What finds plant and flowers: colour and geometry, Grounding DINO and SAM 2, or SAM 3 (docs/masks.md)."""
    models: Path = Path("models")
    """Folder with the weights of the networks."""
    restart_from: str | None = None
    """Read the results of earlier stages from the run folder and go on from this stage."""
    overwrite: bool = False
    """Replace the results of an earlier run in the same folder."""
    params: Params = field(default_factory=Params)
    """Parameters of the stages."""


def run(args: Args) -> None:
    """Reconstruct one plant and print what was found."""
    skeleton, stem = known_better(args.root, args.stem_tip, args.params.skeleton, args.params.stem)
    args = replace(args, params=replace(args.params, skeleton=skeleton, stem=stem))
    out = args.out or Path("runs") / args.capture.resolve().name
    workspace = None if args.workspace is None else Box(np.array(args.workspace[:3]), np.array(args.workspace[3:]))
    folder = args.capture if args.capture.is_dir() else args.capture.parent  # it may be given by its transforms.json
    find_masks = mask_finder(args.masks, args.models, args.params, cache=folder / "masks")
    capture = Capture.load(args.capture)
    with open_run(out, args, ("capture", "workspace")) as run:
        capture = run.stage("capture", Capture.load, lambda _: capture)
        seen = perceive(capture, workspace, run, args.params, find_masks)
        with cause_named(capture):
            grasps = rank_grasps(seen, None, run, args.params)
    results = finish(run)
    length, sure = seen.stem.arc_length[-1], seen.stem.confidence
    print(f"{len(seen.cloud.points):,} points, {len(seen.skeleton.nodes)} skeleton nodes, main stem {length:.3f} m")
    if sure is not None:
        print(f"confidence: main stem {sure:.2f}, grasp {grasps[0].confidence:.2f}")
    print(f"{len(seen.flowers.positions)} flowers; grasp at {grasps[0].arc_length:.3f} m: {grasps[0].reason}")
    for note in results.notes():
        print(f"note: {note}")
    print(f"report: {run.path('report')}")
