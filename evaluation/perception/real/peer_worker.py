"""The worker of a peer, run by the peer's Python; nothing of Anther is needed: python peer_worker.py NAME.

A line "IN.npz OUT.npz" (tab between) is a request: IN holds `index` (M, 3), the occupied voxels; OUT gets `nodes`
(J, 3) [voxels], `edges` (E, 2) and `seconds` (processor time), or `failure`. The worker says "ready" once, "done" to
each.
"""

import os
import sys
import time

import numpy as np

EXTENT = 1.6
"""The plant's largest extent as pc-skeletor's own `normalize_pcd` makes it: its constants depend on units.
It also deletes points near the origin, so the plant stands clear of it.
"""
HALF_NEIGHBOURS = [(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if (i, j, k) > (0, 0, 0)]


def pc_skeletor():
    """Laplacian-based contraction with default settings: the spanning tree before it is cut down to junctions."""
    import open3d as o3d  # noqa: PLC0415
    from pc_skeletor import LBC  # noqa: PLC0415

    def skeleton(index):
        scale, low = EXTENT / np.ptp(index, axis=0).max(), index.min(axis=0)
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector((index - low) * scale + EXTENT))
        contraction = LBC(point_cloud=cloud)
        contraction.extract_skeleton()
        contraction.extract_topology()
        graph = contraction.skeleton_graph
        rank = {node: k for k, node in enumerate(graph.nodes)}
        nodes = np.array([graph.nodes[node]["pos"] for node in graph.nodes])
        return (nodes - EXTENT) / scale + low, np.array([(rank[a], rank[b]) for a, b in graph.edges if a != b])

    return skeleton


def skeletor():
    """Wave fronts with default settings; it wants a closed mesh, so the voxels are thickened by one and filled."""
    import skeletor  # noqa: PLC0415
    import trimesh  # noqa: PLC0415
    from scipy.ndimage import binary_dilation, binary_fill_holes  # noqa: PLC0415
    from skimage.measure import marching_cubes  # noqa: PLC0415

    def skeleton(index):
        low = index.min(axis=0) - 3
        grid = np.zeros(index.max(axis=0) - low + 4, dtype=bool)
        grid[tuple((index - low).T)] = True
        grid = np.asarray(binary_fill_holes(binary_dilation(grid, np.ones((3, 3, 3)))))
        vertices, faces, _, _ = marching_cubes(grid.astype(np.float32), 0.5)
        mesh = trimesh.Trimesh(vertices, faces)
        found = skeletor.skeletonize.by_wavefront(mesh, waves=1, step_size=1, progress=False)
        return np.asarray(found.vertices) + low, np.asarray(found.edges)

    return skeleton


def pygel():
    """PyGEL3D's multi-scale local separators (Baerentzen et al. 2023) with default settings, on the graph of the voxels
    that touch by face, edge or corner."""
    from pygel3d import graph  # noqa: PLC0415

    def skeleton(index):
        voxels = graph.Graph()
        number = {tuple(at): voxels.add_node(np.array(at, dtype=np.float64)) for at in index.tolist()}
        for at, one in number.items():
            for step in HALF_NEIGHBOURS:
                other = number.get((at[0] + step[0], at[1] + step[1], at[2] + step[2]))
                if other is not None:
                    voxels.connect_nodes(one, other)
        found = graph.MSLS_skeleton(voxels)
        edges = [(a, b) for a in found.nodes() for b in found.neighbors(a) if a < b]
        return np.asarray(found.positions()), np.array(edges, dtype=np.int64)

    return skeleton


def answer(skeleton, index):
    """Return nodes, edges and processor time, or the failure: whatever goes wrong in the peer is its answer."""
    begin = time.process_time()
    try:
        nodes, edges = skeleton(index)
    except Exception as error:
        return {"failure": f"{type(error).__name__}: {error}".splitlines()[0]}
    return {"nodes": nodes, "edges": edges, "seconds": time.process_time() - begin}


if __name__ == "__main__":
    peer = {"pc_skeletor": pc_skeletor, "skeletor": skeletor, "pygel": pygel}[sys.argv[1]]()
    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what the peer prints, from compiled code too, is no reply
    print("ready", file=replies, flush=True)
    for line in sys.stdin:
        source, target = line.rstrip("\n").split("\t")
        np.savez(target, **answer(peer, np.load(source)["index"]))
        print("done", file=replies, flush=True)
