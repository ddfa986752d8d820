"""pc-skeletor's Laplacian-based contraction, run by the Python that has it installed (nothing of Anther is needed).

Reads a line "IN.npz OUT.npz" at a time from standard input. IN holds `points` (N, 3); OUT gets `nodes`, `edges` and
`seconds` (processor time), or `failure`. Says "ready" once and "done" after each line.
"""

import contextlib
import sys
import time
from typing import Any

import numpy as np
import open3d as o3d
from pc_skeletor import LBC


def skeleton(points):
    """Return (nodes, edges) of the spanning tree pc-skeletor draws through its contracted points, default settings."""
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    contraction = LBC(point_cloud=cloud)
    contraction.extract_skeleton()
    contraction.extract_topology()
    graph = contraction.skeleton_graph
    rank = {node: k for k, node in enumerate(graph.nodes)}
    nodes = np.array([graph.nodes[node]["pos"] for node in graph.nodes])
    return nodes, np.array([(rank[a], rank[b]) for a, b in graph.edges if a != b])


def answer(points) -> dict[str, Any]:
    """Return what OUT gets."""
    begin = time.process_time()
    try:
        nodes, edges = skeleton(points)
    except Exception as error:  # whatever goes wrong in the peer is its answer
        return {"failure": f"{type(error).__name__}: {error}"}
    return {"nodes": nodes, "edges": edges, "seconds": time.process_time() - begin}


print("ready", flush=True)
for line in sys.stdin:
    source, target = line.rstrip("\n").split("\t")
    with contextlib.redirect_stdout(sys.stderr):
        found = answer(np.load(source)["points"])
    np.savez(target, **found)
    print("done", flush=True)
