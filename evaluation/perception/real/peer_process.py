"""Peers that live in an environment of their own: a worker answers, main stem and grasp follow by the paper's rules.

pc-skeletor (Meyer et al. 2023): Laplacian-based contraction (Cao et al. 2010). skeletor (Schlegel et al.): wave fronts
on a mesh. PyGEL3D (Baerentzen et al.): local separators. All get the voxels of the largest cluster, 200 to the
diagonal, as peers were compared before (facts: skeleton peers).

To install them (pc-skeletor's own requirements do not install: mistree is Fortran, and needs numpy to be built):

    python3.11 -m venv pcs
    pcs/bin/pip install "numpy==1.23.5" "scipy==1.10.1" "setuptools<60" "scikit-learn<1.5" "matplotlib<3.9" \\
        open3d-cpu==0.20.0 robust-laplacian networkx tqdm imageio wget
    pcs/bin/pip install --no-build-isolation mistree==1.2.0
    pcs/bin/pip install --no-deps pc-skeletor==1.0.0
    python3.11 -m venv navis && navis/bin/pip install skeletor==1.7.1 scikit-image
    python3.11 -m venv gel && gel/bin/pip install PyGEL3D==0.8.2
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

from anther.core import Array
from anther.core.errors import bad_input
from anther.perception import Cloud
from evaluation.perception.real.answers import Answer, NoAnswer
from evaluation.perception.real.paper_rule import core_stem
from evaluation.perception.real.plain_thinning import FINE, depth, largest_cluster, occupancy
from evaluation.perception.real.plants import plant_size

WORKERS = ("pc_skeletor", "skeletor", "pygel")


class Peer:
    """A running peer; call it with a cloud. Ends with `close`.

    Args:
        name: one of WORKERS.
        python: the Python that has it.

    Raises:
        InputError: the peer does not start there.
    """

    def __init__(self, name: str, python: Path) -> None:
        self._name, self._python = name, python
        self._worker = self._started()

    def __call__(self, cloud: Cloud) -> Answer:
        """Return its answer on a plant.

        Raises:
            NoAnswer: it stops with an error, dies, gives nodes that are nowhere, or no stem is found.
        """
        voxel = plant_size(cloud.points) / FINE
        index = largest_cluster(cloud.points, voxel)
        found = self._asked(index)
        if not np.isfinite(found["nodes"]).all():
            raise NoAnswer("the peer's nodes are not finite")
        begin = time.process_time()
        nodes, edges = found["nodes"] * voxel, found["edges"]
        stem, grasp = core_stem(nodes, edges, _depth_at(index, found["nodes"]) * voxel)
        return Answer(nodes, edges, stem, grasp, float(found["seconds"]) + time.process_time() - begin)

    def close(self) -> None:
        """End it."""
        self._worker.kill()
        self._worker.wait()

    def _started(self) -> subprocess.Popen[str]:
        worker, pipe = str(Path(__file__).with_name("peer_worker.py")), subprocess.PIPE
        command = [str(self._python), worker, self._name]
        worker = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True)
        if worker.stdout is None or worker.stdout.readline() != "ready\n":
            raise bad_input(
                f"Python with {self._name}",
                given=str(self._python),
                allowed="one in which the peer can be imported",
                do="evaluation/perception/real/peer_process.py says how to install it.",
            )
        return worker

    def _asked(self, index: NDArray[Any]) -> dict[str, Array]:
        assert self._worker.stdin is not None
        assert self._worker.stdout is not None
        with tempfile.TemporaryDirectory() as folder:
            source, target = Path(folder) / "in.npz", Path(folder) / "out.npz"
            np.savez(source, index=index)
            print(source, target, sep="\t", file=self._worker.stdin, flush=True)
            if self._worker.stdout.readline() != "done\n":
                self.close()
                self._worker = self._started()
                raise NoAnswer("the peer died")
            with np.load(target) as stored:
                found = dict(stored)
        if "failure" in found:
            raise NoAnswer(str(found["failure"]))
        return found


def _depth_at(index: NDArray[Any], nodes: Array) -> Array:
    """Return (J,) the depth of the occupied voxel nearest to each node [voxels]: the radius of the paper's score."""
    solid, low = occupancy(index)
    return depth(solid)[tuple((index - low).T)][KDTree(index).query(nodes)[1]]
