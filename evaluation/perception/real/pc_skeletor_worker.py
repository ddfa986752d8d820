"""pc-skeletor's Laplacian-based contraction with its default settings."""

import numpy as np
import open3d as o3d
from pc_skeletor import LBC
from worker import serve

EXTENT = 1.6
"""The plant's largest extent as pc-skeletor's own `normalize_pcd` makes it: its constants depend on units.
It also deletes points near the origin, so the plant stands clear of it.
"""


def skeleton(index):
    """Return the spanning tree pc-skeletor draws through its contracted points, before it is cut down to junctions."""
    scale, low = EXTENT / np.ptp(index, axis=0).max(), index.min(axis=0)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector((index - low) * scale + EXTENT))
    contraction = LBC(point_cloud=cloud)
    contraction.extract_skeleton()
    contraction.extract_topology()
    graph = contraction.skeleton_graph
    rank = {node: k for k, node in enumerate(graph.nodes)}
    nodes = np.array([graph.nodes[node]["pos"] for node in graph.nodes])
    return (nodes - EXTENT) / scale + low, np.array([(rank[a], rank[b]) for a, b in graph.edges if a != b])


serve(skeleton)
