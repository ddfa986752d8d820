"""Kinect frames, COLMAP workspaces, RealSense and ROS bags, MCAP -> a capture folder; fused PLY -> a cloud."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from anther.cli.args.shared import Given, Overwrite, Stage, stage


@dataclass(frozen=True)
class Args(Overwrite):
    """Attributes: what to import, where to, and what the source does not tell."""

    source: Given
    """Folder of Kinect frames with a poses.json (docs/capture.md), COLMAP workspace or model folder, fused .ply, .bag,
    .mcap, .db3, Record3D's .r3d, Azure Kinect's .mkv, or ROS 2 bag folder."""
    out: Annotated[Path, tyro.conf.Positional]
    """Capture folder to write; a .ply for clouds (fused .ply, or a COLMAP model without depth maps)."""
    scale: float | None = None
    """COLMAP and .ply: metres per model unit."""
    up: str | None = None
    """COLMAP and .ply: direction that points up in the model: x, y, z, or (with =) --up=-y, --up=0.1,-0.9,0.3."""
    bag: Stage = stage("anther.perception.formats.bags", "BagOptions", flat=True)
    """Bags, .mkv and .r3d: how many views. Bags and .mkv: poses, tolerance. Bags: topics."""
