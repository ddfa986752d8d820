"""RGB-D views of a plant -> cloud, skeleton, main stem, flowers, grasp, and a report."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from anther.cli.args.reconstruct import Args
from anther.cli.run_folder import finish, open_run
from anther.core.geometry import Box
from anther.perception.capture import Capture
from anther.plant.imported import with_known_places
from anther.pollination.pipeline import Params, cause_named, mask_finder, perceive, rank_grasps


def run(args: Args) -> None:
    """Reconstruct one plant and print what was found."""
    params = args.params or Params()
    skeleton, stem = with_known_places(args.root, args.stem_tip, params.skeleton, params.stem, args.plant)
    args = replace(args, params=replace(params, skeleton=skeleton, stem=stem))
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
