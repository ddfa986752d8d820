"""PyGEL3D's multi-scale local separators (Baerentzen et al. 2023) with default settings, on the graph of the voxels."""

import numpy as np
from pygel3d import graph
from worker import serve

HALF_NEIGHBOURS = [(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if (i, j, k) > (0, 0, 0)]


def skeleton(index):
    """Return PyGEL3D's nodes and edges; voxels that touch by face, edge or corner are joined."""
    voxels, number = graph.Graph(), {}
    for at in index.tolist():
        number[tuple(at)] = voxels.add_node(np.array(at, dtype=np.float64))
    for at, one in number.items():
        for step in HALF_NEIGHBOURS:
            other = number.get((at[0] + step[0], at[1] + step[1], at[2] + step[2]))
            if other is not None:
                voxels.connect_nodes(one, other)
    found = graph.MSLS_skeleton(voxels)
    edges = [(a, b) for a in found.nodes() for b in found.neighbors(a) if a < b]
    return np.asarray(found.positions()), np.array(edges, dtype=np.int64)


serve(skeleton)
