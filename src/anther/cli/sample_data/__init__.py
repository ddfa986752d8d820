"""Small inputs for every command, made from simulated plants, boards and stems (tools/make_samples.py)."""

from __future__ import annotations

import shutil
from importlib.resources import as_file, files
from pathlib import Path

from anther.core.errors import bad_input
from anther.core.files import made_folder, written

__all__ = ["SAMPLES", "write_samples"]

SAMPLES = {
    "capture": "six RGB-D views of a tomato, with poses",
    "plant.ply": "its point cloud",
    "skeleton.swc": "its skeleton",
    "views.mcap": "three of the views as a ROS 2 recorder leaves them",
    "turntable": "three depth frames of a Kinect turntable",
    "board": "pictures of a board, and the flange's pose at each",
    "stem": "bench measurements of one stem",
}
"""File or folder -> what it is."""


def write_samples(folder: Path | str) -> list[Path]:
    """Copy all samples into a folder, which is made if it is missing, and return their paths.

    Raises:
        InputError: something of a sample's name is there already, or the folder cannot be written.
    """
    folder = made_folder(folder)
    there = [name for name in SAMPLES if (folder / name).exists()]
    if there:
        given, do = f"a folder that has {', '.join(there)}", "Choose another folder, or remove them."
        raise bad_input(str(folder), given=given, allowed="one without them", do=do)
    with as_file(files(__name__)) as source, written(folder, "a folder that can be written"):
        for name in SAMPLES:
            if (source / name).is_dir():
                shutil.copytree(source / name, folder / name)
            else:
                shutil.copy(source / name, folder / name)
    return [folder / name for name in SAMPLES]
