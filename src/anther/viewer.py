"""The 3-D viewer: a run as a viser scene, live in the browser or as one HTML file."""

from __future__ import annotations

import io
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from anther.files import write_text
from anther.geometry import Array
from anther.results import RunResults
from anther.stem import BRANCH, LEAF, STEM, TRUSS

POINT_SIZE = 0.0015
"""[m]"""


def build_scene(server: viser.ViserServer, results: RunResults) -> None:
    """Add what a run holds to a viser scene: cloud, obstacles, cameras, skeleton, stem, flowers, grasps, motion."""
    scene = server.scene
    scene.set_up_direction("+z")
    scene.add_frame("/world", axes_length=0.1, axes_radius=0.002)
    _add_cloud(scene, results)
    _add_cameras(scene, results)
    _add_skeleton(scene, results)
    _add_grasps(scene, results)
    _add_motion(scene, results)
    if results.cloud is not None:
        middle = results.cloud.points.mean(axis=0)
        server.initial_camera.look_at = tuple(middle)
        server.initial_camera.position = tuple(middle + np.array([-0.7, -0.7, 0.3]))


def write_html(path: Path, results: RunResults) -> None:
    """Write the scene of a run to one HTML file that opens without a server."""
    with redirect_stdout(io.StringIO()):  # viser announces its address even when nobody is to visit it
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        try:
            build_scene(server, results)
            write_text(path, server.scene.as_html())
        finally:
            server.stop()


def serve(results: RunResults, port: int) -> None:
    """Show a run in the browser until interrupted.

    Args:
        results: what the run folder holds.
        port: TCP port on this machine.
    """
    server = viser.ViserServer(host="127.0.0.1", port=port)
    build_scene(server, results)
    server.sleep_forever()


def _add_cloud(scene: Any, results: RunResults) -> None:
    cloud = results.cloud
    if cloud is None:
        return
    colours = cloud.colors if cloud.colors is not None else np.tile([90, 150, 90], (len(cloud.points), 1))
    scene.add_point_cloud(
        "/plant",
        cloud.points.astype(np.float32),
        colours.astype(np.uint8),
        point_size=POINT_SIZE,
        point_shape="circle",
        precision="float32",
    )
    if len(cloud.obstacles):
        grey = np.full((len(cloud.obstacles), 3), 120, np.uint8)
        scene.add_point_cloud("/pot and bench", cloud.obstacles.astype(np.float32), grey, point_size=0.005)


def _add_cameras(scene: Any, results: RunResults) -> None:
    if results.capture is None:
        return
    k = results.capture.intrinsics
    for i, T in enumerate(results.capture.T_world_cam):
        position, wxyz = _placed(T)
        scene.add_camera_frustum(
            f"/cameras/{i:02d}",
            fov=2 * np.arctan(k.height / (2 * k.fy)),
            aspect=k.width / k.height,
            scale=0.03,
            thickness=0.001,
            position=position,
            wxyz=wxyz,
            color=(90, 110, 170),
        )


def _add_skeleton(scene: Any, results: RunResults) -> None:
    skeleton, stem = results.skeleton, results.stem
    if skeleton is None:
        return
    segments = skeleton.nodes[skeleton.edges]
    organ = stem.organ[1:] if stem is not None else np.full(len(segments), BRANCH)  # edge j - 1 ends at node j
    for kind, name, colour, width in (
        (STEM, "main stem", (210, 40, 40), 0.004),
        (BRANCH, "branches", (230, 140, 40), 0.0015),
        (TRUSS, "trusses", (200, 60, 200), 0.0015),
        (LEAF, "leaves", (60, 150, 60), 0.001),
    ):
        chosen = organ == kind
        if chosen.any():
            scene.add_line_segments(f"/skeleton/{name}", segments[chosen].astype(np.float32), colour, thickness=width)
    if results.flowers is not None:
        for i, p in enumerate(results.flowers.positions):
            scene.add_icosphere(f"/flowers/{i + 1}", radius=0.008, color=(240, 60, 200), position=tuple(p), opacity=0.6)


def _add_grasps(scene: Any, results: RunResults) -> None:
    chosen = results.shake.grasp_index if results.shake is not None else 0
    for rank, grasp in enumerate(results.grasps):
        position, wxyz = _placed(grasp.T_world_flange)
        size = 0.08 if rank == chosen else 0.03
        name = f"/grasps/{rank + 1}{' (chosen)' if rank == chosen else ''}"
        scene.add_frame(name, position=position, wxyz=wxyz, axes_length=size, axes_radius=size / 25)


def _add_motion(scene: Any, results: RunResults) -> None:
    """The measured path of each flower during the shake."""
    if results.response is None:
        return
    for i in range(results.response.tracks.shape[1]):
        track = results.response.tracks[:, i]
        track = track[np.isfinite(track).all(axis=1)]
        if len(track) > 1:
            path = np.stack([track[:-1], track[1:]], axis=1)
            scene.add_line_segments(f"/flower motion/{i + 1}", path.astype(np.float32), (60, 60, 220), thickness=0.001)


def _placed(T: Array) -> tuple[Any, Any]:
    """Position and viser's w, x, y, z quaternion of a transform."""
    return T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)
