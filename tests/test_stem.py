"""Stem: the best rising path, ended where it leaves its growth axis."""

from __future__ import annotations

import numpy as np
import pytest
from made_plants import simple_plant

from anther.cloud import Cloud
from anther.errors import StageFailure
from anther.skeleton import Skeleton, skeletonize
from anther.stem import BRANCH, STEM, Stem, find_stem


def drawn(*lines: list[list[float]], radius: list[float]) -> Skeleton:
    """Return a skeleton of polylines; every line but the first starts on a node of an earlier one."""
    nodes, parent, radii = [], [], []
    for line, r in zip(lines, radius, strict=True):
        last = -1
        for point in line:
            same = [k for k, node in enumerate(nodes) if np.allclose(node, point)]
            if same:
                last = same[0]
                continue
            nodes.append(point)
            parent.append(last)
            radii.append(r)
            last = len(nodes) - 1
    return Skeleton(np.array(nodes), np.array(parent), np.array(radii))


def line(start: list[float], end: list[float], count: int = 20) -> list[list[float]]:
    return np.linspace(start, end, count + 1).tolist()


def test_stem_of_a_made_plant_runs_up_the_axis() -> None:
    skeleton = skeletonize(Cloud(simple_plant()))
    stem = find_stem(skeleton)
    nodes = skeleton.nodes[stem.node_ids]
    assert np.linalg.norm(nodes[:, :2], axis=1).max() < 0.006
    assert nodes[-1, 2] > 0.4
    assert len(stem.attachments) == 4
    assert stem.arc_length[0] == 0
    assert np.all(stem.organ[stem.node_ids] == STEM)
    assert np.count_nonzero(stem.organ == BRANCH) == len(skeleton.nodes) - len(stem.node_ids)


def test_a_long_horizontal_leaf_is_cut_off() -> None:
    skeleton = drawn(line([0, 0, 0], [0, 0, 0.3]) + line([0, 0, 0.3], [0.5, 0, 0.3])[1:], radius=[0.004])
    stem = find_stem(skeleton)
    assert skeleton.nodes[stem.node_ids[-1], 0] < 0.04


def test_a_leaning_stem_is_followed_to_its_top() -> None:
    skeleton = drawn(line([0, 0, 0], [0.3, 0, 0.35]), line([0.15, 0, 0.175], [0.05, 0, 0.25]), radius=[0.004, 0.002])
    assert np.allclose(skeleton.nodes[find_stem(skeleton).node_ids[-1]], [0.3, 0, 0.35])


def test_a_slowly_bending_stem_is_followed() -> None:
    angle = np.linspace(0, 1.2, 40)
    bend = np.stack([0.4 * (1 - np.cos(angle)), 0 * angle, 0.4 * np.sin(angle)], axis=1)
    assert len(find_stem(drawn(bend.tolist(), radius=[0.004])).node_ids) == 40


def test_the_thicker_fork_goes_on() -> None:
    trunk = line([0, 0, 0], [0, 0, 0.2])
    skeleton = drawn(
        trunk,
        line([0, 0, 0.2], [0.1, 0, 0.4]),
        line([0, 0, 0.2], [-0.1, 0, 0.4]),
        radius=[0.005, 0.004, 0.003],
    )
    stem = find_stem(skeleton)
    assert skeleton.nodes[stem.node_ids[-1], 0] > 0.05
    assert list(skeleton.nodes[stem.node_ids[stem.attachments]][:, 2]) == pytest.approx([0.2])


def test_a_thin_continuation_is_not_stem() -> None:
    skeleton = drawn(line([0, 0, 0], [0, 0, 0.3]), line([0, 0, 0.3], [0, 0, 0.5]), radius=[0.005, 0.001])
    assert skeleton.nodes[find_stem(skeleton).node_ids[-1], 2] < 0.33


@pytest.mark.parametrize(
    ("skeleton", "hint"),
    [
        (drawn(line([0, 0, 0], [0.5, 0, 0.01]), radius=[0.003]), "z up"),
        (drawn(line([0, 0, 0], [0, 0, 600]), radius=[5]), "units"),
    ],
)
def test_no_stem_is_said_clearly(skeleton: Skeleton, hint: str) -> None:
    with pytest.raises(StageFailure, match=hint) as failure:
        find_stem(skeleton)
    assert failure.value.kind == "no_stem_found"


def test_save_and_load(tmp_path) -> None:
    stem = find_stem(drawn(line([0, 0, 0], [0, 0, 0.3]), radius=[0.004]))
    stem.save(tmp_path / "stem.npz")
    again = Stem.load(tmp_path / "stem.npz")
    for name in ("node_ids", "arc_length", "attachments", "organ"):
        assert np.array_equal(getattr(again, name), getattr(stem, name))
