"""A shake shown at one of its times: arm, plant and flowers put where they were."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import trimesh

from anther.arm.model import ArmModel, Capsule, Solid
from anther.geometry import Array
from anther.results import RunResults
from anther.viewer._motion import Replay
from anther.viewer._scene import FLOWER_RADIUS, Handles, placed

GREY, DARK = (165, 168, 175), (70, 72, 80)


class DrawnRobot:
    """An arm with its gripper, neutral until it is moved.

    Args:
        scene: viser's.
        arm: its description.
        opening: between the pads [m].
    """

    def __init__(self, scene: Any, arm: ArmModel, opening: float) -> None:
        self._arm = arm
        base = [_capsule(c) for c in arm.base_capsules] + [_box(s) for s in arm.base_solids]
        _add(scene, "/robot/base", base, GREY)
        self._frames = []
        parts = [([_capsule(c) for c in link.capsules], GREY) for link in arm.links]
        for i, (shapes, colour) in enumerate([*parts, ([_box(s) for s in arm.tool.solids(opening)], DARK)]):
            self._frames.append(scene.add_frame(f"/robot/{i}", show_axes=False))
            _add(scene, f"/robot/{i}/shape", shapes, colour)
        self.move(arm.neutral)

    def move(self, joints: Array) -> None:
        """Show the arm at joints (J,) [rad]."""
        for frame, T in zip(self._frames, self._arm.link_poses(joints), strict=True):
            frame.position, frame.wxyz = placed(T)


def _add(scene: Any, name: str, shapes: Sequence[Any], colour: tuple[int, int, int]) -> None:
    whole: Any = trimesh.util.concatenate(list(shapes))
    scene.add_mesh_simple(
        name, np.asarray(whole.vertices, np.float32), np.asarray(whole.faces, np.uint32), color=colour
    )


def _capsule(capsule: Capsule) -> Any:
    start, end = np.array(capsule.start), np.array(capsule.end)
    along = end - start
    height = float(np.linalg.norm(along))
    mesh = trimesh.creation.capsule(height=height, radius=capsule.radius, count=(12, 12))
    mesh.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], along / height))
    low = mesh.bounds.mean(axis=0)
    mesh.apply_translation((start + end) / 2 - low)
    return mesh


def _box(solid: Solid) -> Any:
    mesh = trimesh.creation.box(2 * np.array(solid.half))
    mesh.apply_translation(solid.center)
    return mesh


MEASURED, PREDICTED = (40, 90, 235), (240, 60, 200)


class Player:
    """Shows a motion in a scene.

    Args:
        server: viser's.
        results: of the run.
        motion: of its shake.
        handles: of what stands still in the scene, some of which it moves.
    """

    def __init__(self, server: Any, results: RunResults, motion: Replay, handles: Handles) -> None:
        assert results.plant is not None
        self.motion, self._handles, self._plant = motion, handles, results.plant
        self.robot = DrawnRobot(server.scene, motion.arm, motion.opening)
        for rest in handles.layers.pop("flowers at rest", []):
            rest.remove()
        add = server.scene.add_icosphere
        self._said = [
            add(f"/predicted/{f + 1}", radius=0.6 * FLOWER_RADIUS, color=PREDICTED, subdivisions=1)
            for f in range(len(self._plant.flower_nodes))
        ]
        self._seen = [
            add(f"/measured/{f + 1}", radius=0.6 * FLOWER_RADIUS, color=MEASURED, subdivisions=1)
            for f in range(motion.flowers.shape[1])
        ]
        tracked = motion.flowers.shape[1]
        self._rest = np.array([_middle(motion.flowers[:, f]) for f in range(tracked)]).reshape(tracked, 3)

    def show(self, i: int, exaggeration: float) -> None:
        """Show the picture number i, motions so many times larger."""
        motion, count = self.motion, self._handles.nodes
        self.robot.move(motion.joints[0] + exaggeration * (motion.joints[i] - motion.joints[0]))
        moved = exaggeration * motion.nodes[i]
        self._handles.bend(moved[:count])
        tips = self._plant.rods.nodes[self._plant.flower_nodes] + moved[self._plant.flower_nodes]
        for ball, place in zip(self._said, tips, strict=True):
            ball.position = place
        for ball, place, rest in zip(self._seen, motion.flowers[i], self._rest, strict=True):
            known = bool(np.isfinite(place).all())
            ball.visible = known
            if known:
                ball.position = rest + exaggeration * (place - rest)


def _middle(track: Any) -> Any:
    seen = track[np.isfinite(track).all(axis=1)]
    return np.median(seen, axis=0) if len(seen) else np.zeros(3)


SPEEDS = {"real time": 1.0, "half": 0.5, "a tenth": 0.1}


class Controls:
    """The live viewer's panel.

    Args:
        server: viser's.
        player: of the shake; None where nothing moved.
        exaggeration: to begin with.
    """

    def __init__(self, server: Any, player: Player | None, exaggeration: float) -> None:
        self._player, self._at = player, 0.0
        if player is None:
            server.gui.add_markdown("Nothing was shaken in this run.")
            return
        times = player.motion.times
        with server.gui.add_folder("The shake"):
            self._play = server.gui.add_checkbox("play", True)
            self._time = server.gui.add_slider("time [s]", 0.0, float(times[-1]), float(times[1] - times[0]), 0.0)
            self._speed = server.gui.add_dropdown("speed", list(SPEEDS), initial_value="a tenth")
            self._larger = server.gui.add_slider("motions larger", 1.0, 20.0, 0.5, exaggeration)
            server.gui.add_markdown("Blue: flowers as filmed. Pink: as the model follows the grip.")
        self._time.on_update(lambda _: self._show())
        self._larger.on_update(lambda _: self._show())
        self._show()

    def tick(self, seconds: float) -> None:
        """Let so much time pass [s]."""
        if self._player is None or not self._play.value:
            return
        last = float(self._player.motion.times[-1])
        self._time.value = (self._time.value + SPEEDS[self._speed.value] * seconds) % last

    def _show(self) -> None:
        assert self._player is not None
        times = self._player.motion.times
        at = min(int(self._time.value / (times[1] - times[0])), len(times) - 1)
        self._player.show(at, self._larger.value)


def add_controls(
    server: Any, results: RunResults, handles: Handles, player: Player | None, exaggeration: float
) -> Controls:
    """Add the panel: what the trial's answers are, what to show, the shake in time."""
    answers = [f"**{a.question}** {a.said}" for a in results.answers()]
    if answers:
        server.gui.add_markdown("  \n".join(answers))
    with server.gui.add_folder("Show"):
        for name, parts in handles.layers.items():
            box = server.gui.add_checkbox(name, all(part.visible for part in parts))
            box.on_update(lambda event, parts=parts: _set_visible(parts, event.target.value))
        server.gui.add_markdown(handles.legend)
        picked = server.gui.add_markdown("Click on the skeleton to see what is there.")
    if handles.joints is not None:
        handles.joints.on_click(lambda event: _tell(picked, handles, event.instance_index))
    return Controls(server, player, exaggeration)


def _set_visible(parts: list[Any], value: bool) -> None:
    for part in parts:
        part.visible = value


def _tell(picked: Any, handles: Handles, node: int | None) -> None:
    if node is not None:
        picked.content = handles.said[node]
