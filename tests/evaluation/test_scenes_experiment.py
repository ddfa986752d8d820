"""Scenes of several plants and supports, as evaluation/perception/scenes.py asks about them."""

from __future__ import annotations

import numpy as np
import pytest
from made_plants import simple_plant

from anther.core.errors import StageFailure
from anther.perception import Cloud
from evaluation.perception import scenes
from evaluation.perception.scene_plants import OTHER, Points, build


def test_a_scene_is_asked_with_its_supports_set_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    points = simple_plant()
    plant = Points("made", points, np.full(len(points), OTHER), np.linspace([0, 0, 0], [0, 0, 0.5], 20), 0.005)
    seen: list[Cloud] = []

    def stop(cloud: Cloud, _: object) -> None:
        seen.append(cloud)
        raise StageFailure("no_plant_found", "enough was seen")

    monkeypatch.setattr(scenes, "skeletonize", stop)
    scene = build([plant], np.random.default_rng(0), ["stake"])
    assert scenes.ask(scene).refused
    assert [support.kind for support in seen[0].supports] == ["stake"]
    assert len(seen[0].points) < len(points) + 0.01 * np.sum(scene.owner == 1)  # a few points of the stake are left
