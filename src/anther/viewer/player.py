"""A shake shown at one of its times: arm, plant and flowers put where they were."""

from __future__ import annotations

from typing import Any

import numpy as np

from anther.results import RunResults
from anther.viewer.motion import Motion
from anther.viewer.robot import Robot
from anther.viewer.scene import FLOWER_RADIUS, Handles

MEASURED, PREDICTED = (40, 90, 235), (240, 60, 200)


class Player:
    """Shows a motion in a scene.

    Args:
        server: viser's.
        results: of the run.
        motion: of its shake.
        handles: of what stands still in the scene, some of which it moves.
    """

    def __init__(self, server: Any, results: RunResults, motion: Motion, handles: Handles) -> None:
        assert results.plant is not None
        self.motion, self._handles, self._plant = motion, handles, results.plant
        self.robot = Robot(server.scene, motion.arm, motion.opening)
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
