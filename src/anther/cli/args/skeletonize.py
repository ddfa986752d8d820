"""Point cloud of a plant -> one rooted tree, main stem, grasp, and a picture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from anther.cli.args.shared import Given, Output, Source, Stage, stage


@dataclass(frozen=True)
class Args(Output, Source):
    """Attributes: the cloud, and where the results go."""

    cloud: Given
    """Point cloud: .ply, .pcd, .las, .laz, .e57, .xyz, .txt, .csv, .asc, .pts or .npz."""
    plant: int | None = None
    """Which plant, from 0 on: of an .npz that holds several, or of those that stand in the cloud, along x (along y
    where they spread more along y). By default the one in the middle."""
    out: Path | None = None
    """Folder for skeleton.npz, skeleton.swc, stem.npz, grasp.json and overview.png."""
    params: Stage = stage("anther.perception.skeleton")
    """How the cloud becomes a skeleton."""
    stem: Stage = stage("anther.perception.stem")
    """How the main stem is found."""
    grasp: Stage = stage("anther.pollination.grasp")
    """Gripper and grasp."""
