"""pc-skeletor (Meyer et al. 2023; Laplacian-based contraction of Cao et al. 2010) as a method, in its own environment.

It gives a graph; main stem and grasp come from it by the paper's rules, as for plain thinning.
"""

from __future__ import annotations

import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anther.cloud import Cloud
from anther.errors import bad_input
from anther.geometry import Array
from real.answers import Answer, NoAnswer
from real.paper_rule import core_stem
from real.plain_thinning import FINE, depth, largest_cluster, occupancy
from real.plants import plant_size

WORKER = Path(__file__).with_name("contraction_worker.py")
EXTENT = 1.6
"""Its documented scale of a plant: its constants depend on units, and near the origin it deletes points."""


class PcSkeletor:
    """A running pc-skeletor; call it with a cloud. Ends with `close`.

    Args:
        python: the Python that has pc-skeletor.

    Raises:
        InputError: pc-skeletor does not start there.
    """

    def __init__(self, python: Path) -> None:
        self._python = python
        self._worker = self._started()

    def __call__(self, cloud: Cloud) -> Answer:
        """Return its answer on the voxels of the largest cluster (as peers were compared before).

        Raises:
            NoAnswer: it stops with an error, dies, or no stem is found.
        """
        voxel = plant_size(cloud.points) / FINE
        index = largest_cluster(cloud.points, voxel)
        scale = EXTENT / np.ptp(index, axis=0).max()
        low = index.min(axis=0)
        found = self._asked((index - low) * scale + EXTENT)
        begin = time.process_time()
        nodes = ((found["nodes"] - EXTENT) / scale + low) * voxel
        radius = _radius(index, nodes / voxel) * voxel
        stem, grasp = core_stem(nodes, found["edges"], radius)
        return Answer(nodes, found["edges"], stem, grasp, float(found["seconds"]) + time.process_time() - begin)

    def close(self) -> None:
        """End it."""
        self._worker.kill()
        self._worker.wait()

    def _started(self) -> subprocess.Popen[str]:
        command, pipe = [str(self._python), str(WORKER)], subprocess.PIPE
        worker = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True)
        if worker.stdout is None or worker.stdout.readline() != "ready\n":
            raise bad_input(
                "--pc-skeletor",
                given=str(self._python),
                allowed="a Python in which 'import pc_skeletor' works",
                do="docs/real_plants.md says how to install it.",
            )
        return worker

    def _asked(self, points: Array) -> dict[str, Array]:
        assert self._worker.stdin is not None
        assert self._worker.stdout is not None
        with tempfile.TemporaryDirectory() as folder:
            source, target = Path(folder) / "in.npz", Path(folder) / "out.npz"
            np.savez(source, points=points)
            print(source, target, sep="\t", file=self._worker.stdin, flush=True)
            if self._worker.stdout.readline() != "done\n":
                self.close()
                self._worker = self._started()
                raise NoAnswer("pc-skeletor died")
            with np.load(target) as stored:
                found = dict(stored)
        if "failure" in found:
            raise NoAnswer(f"pc-skeletor: {found['failure']}")
        return found


def _radius(index: NDArray[Any], nodes: Array) -> Array:
    """Return (J,) the depth of the occupied voxel nearest to each node [voxels]."""
    solid, low = occupancy(index)
    return depth(solid)[tuple((index - low).T)][KDTree(index).query(nodes)[1]]
