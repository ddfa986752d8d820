"""Scenes of several plants and supports, as evaluation/perception/scenes.py asks about them."""

from __future__ import annotations

import numpy as np
import pytest
from made_plants import simple_plant

from anther.core.errors import StageFailure
from anther.perception import Cloud
from anther.perception.skeleton import Skeleton
from anther.perception.stem import Stem
from anther.perception.stem.confidence import doubt
from anther.pollination import Grasp
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


def answer(root: float = 1.0, stem: float = 1.0, grasp: float = 1.0, *notes: str, unfit: bool = False) -> scenes.Answer:
    """What would be said of a bare stem of two nodes with these confidences."""
    nodes = np.array([[0.0, 0, 0], [0, 0, 0.4]])
    tree = Skeleton(nodes, np.array([-1, 0]), np.full(2, 0.005), root_confidence=root)
    said = (*notes, *doubt(stem))
    line = Stem(np.arange(2), np.array([0, 0.4]), np.zeros(0, np.int64), np.zeros(2, np.uint8), 1, said, stem)
    held = Grasp(np.eye(4), nodes[1] / 2, np.eye(3)[2], np.eye(3)[0], 0.2, 0.01, 0.0, 0.0, "here", confidence=grasp)
    return scenes.Answer(1.0, tree, line, held, unfit=unfit)


def test_what_may_be_held_is_flagged_and_the_stems_course_apart() -> None:
    assert not answer().flagged
    assert answer(root=0.7).flagged, "another plant may be meant"
    assert answer(grasp=0.7).flagged, "what is held may be no stem"
    assert answer(1.0, 1.0, 1.0, "main stem: a second stem seems to stand at x, y = 0.20, 0.00 m").flagged
    assert answer(unfit=True).flagged
    assert scenes.Answer(1.0, refused="two stems are as near").flagged
    cut = answer(stem=0.7)
    assert (cut.flagged, cut.course_flagged) == (False, True)
    assert not answer(root=0.7).course_flagged
