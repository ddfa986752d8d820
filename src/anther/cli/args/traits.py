"""A folder of point clouds -> tables of plants and limbs, a picture of every plant; goes on after a stop."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from anther.cli.args.shared import Given, Overwrite, Source, Stage, stage
from anther.core.choices import Species


@dataclass(frozen=True)
class Args(Overwrite, Source):
    """Attributes: the clouds, and where the tables go. What is there already is not measured again, but with
    --overwrite."""

    clouds: Given
    """Folder of point clouds (.ply, .pcd, .xyz, .txt, .csv, .asc, .npz), one plant each; its subfolders too."""
    out: Path
    """Folder for the tables and, by plant, picture and numbers."""
    species: Species | None = None
    """Whose clouds: of maize every limb is a leaf. By default, and of tomato and pepper, branch, truss and leaf are
    told apart by their shape."""
    parquet: bool = False
    """Write plants.parquet, limbs.parquet and growth.parquet instead of CSV."""
    params: Stage = stage("anther.perception.skeleton")
    """How a cloud becomes a skeleton."""
    stem: Stage = stage("anther.perception.stem")
    """How the main stem is found."""
