"""The axis of a stem on a string: which stem, how far off, and straight on behind a leaf."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from anther.core.errors import StageFailure
from anther.core.geometry import Array
from anther.perception import skeleton
from anther.perception.cloud import Cloud
from anther.perception.hanging import StringLine, find_hanging_stem
from anther.perception.skeleton import Skeleton, skeletonize
from anther.plant.string import HeldString
from anther.pollination.pipeline import Params, _hung, _topped, _tree

RADIUS = 0.005


def leaning(z: Array) -> Array:
    """(n, 3) the axis of a stem that leans by 1 cm and sways by 5 mm over half a metre."""
    return np.stack([0.7 + 0.02 * z, 0.005 * np.sin(6 * z), z], axis=1)


def stem_seen(low: float = 0.0, high: float = 0.5) -> tuple[Array, Array]:
    """Points and normals of the side of that stem that a camera at the origin sees."""
    z, turn = np.meshgrid(np.arange(low, high, 0.0015), np.linspace(0.5, 1.5, 11) * np.pi)
    out = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=-1).reshape(-1, 3)
    return leaning(z.ravel()) + RADIUS * out, out


def blade(z: float) -> tuple[Array, Array]:
    """Points and normals of a level leaf in front of the stem."""
    x, y = np.meshgrid(np.arange(0.6, 0.7, 0.0015), np.arange(-0.05, 0.05, 0.0015))
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1), np.tile([0, 0, 1.0], (x.size, 1))


def cloud_of(*parts: tuple[Array, Array]) -> Cloud:
    points, normals = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return Cloud(points, normals=normals)


def off(axis: Array) -> float:
    """The largest distance of an axis from the true one at its height [m]."""
    return float(np.linalg.norm(axis - leaning(axis[:, 2]), axis=1).max())


@pytest.mark.parametrize("error", [(0.0, 0.0), (0.02, -0.02), (-0.02, 0.02)])
def test_a_stem_is_followed_below_a_hook_that_the_map_has_off_by_centimetres(error: tuple[float, float]) -> None:
    found = find_hanging_stem(
        cloud_of(stem_seen(), blade(0.2), blade(0.35)), StringLine((0.705 + error[0], error[1], 1.2))
    )
    assert found.seen.mean() > 0.9
    assert off(found.axis) < RADIUS + 0.004, "one side is seen: the axis lies in the surface"
    np.testing.assert_allclose(found.axis[[0, -1], 2], [0, 0.5], atol=0.02)


def test_a_stem_goes_on_behind_a_leaf() -> None:
    """Its skeleton is one stem and no way round through the leaf."""
    hidden = cloud_of(stem_seen(0, 0.2), stem_seen(0.28), blade(0.2), blade(0.28))
    found = find_hanging_stem(hidden, StringLine((0.71, 0.01, 1.2)))
    gap = found.axis[~found.seen, 2]
    assert gap.min() == pytest.approx(0.2, abs=0.025)
    assert gap.max() == pytest.approx(0.28, abs=0.025)
    assert off(found.axis) < RADIUS + 0.004
    tree = skeletonize(found.completed(hidden))
    top = int(np.argmax(tree.nodes[:, 2]))
    assert off(tree.nodes[tree.path_from_root(top)]) < 0.01
    assert len(hidden.points) < len(found.completed(hidden).points)


def test_a_tree_that_gets_to_the_top_round_through_leaves_is_made_again_along_the_stem(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cloud, string = cloud_of(stem_seen(), blade(0.2)), HeldString.of("tomato", (0.705, 0, 1.2))
    hung, params = _hung(cloud, replace(Params(), plant=replace(Params().plant, string=string)))
    assert hung is not None
    z = np.linspace(0, 0.5, 51)
    straight, parent = leaning(z), np.arange(51) - 1
    round_about = straight + np.outer(0.06 * np.sin(np.pi * np.clip((z - 0.2) / 0.1, 0, 1)), [0, 1, 0])
    assert hung.is_followed(straight, parent)
    assert not hung.is_followed(round_about, parent)
    leaf = np.concatenate([straight, straight[20] + np.outer(np.linspace(0.01, 0.1, 10), [0, 1.0, 0])])
    assert hung.is_followed(leaf, np.append(parent, [20, *range(51, 60)])), "a leaf may go where it likes"
    given = list[Cloud]()

    def skeletonized(shown: Cloud, *_: object) -> Skeleton:
        given.append(shown)
        nodes = round_about if len(given) == 1 else straight
        return Skeleton(nodes, parent, np.full(51, RADIUS))

    monkeypatch.setattr(skeleton, "skeletonize", skeletonized)
    np.testing.assert_allclose(_tree(cloud, hung, params, None).nodes, straight)
    assert len(given[1].points) > len(given[0].points) >= len(cloud.points)


def test_of_two_stems_the_asked_one_is_that_below_the_hook() -> None:
    own, (points, normals) = stem_seen(), stem_seen(-0.1)
    both = cloud_of(own, (points + np.array([0, 0.12, 0]), normals))
    assert abs(find_hanging_stem(both, StringLine((0.7, 0.02, 1.2))).axis[:, 1]).max() < 0.02
    assert abs(find_hanging_stem(both, StringLine((0.7, 0.1, 1.2))).axis[:, 1] - 0.12).max() < 0.02


def test_a_stem_on_a_slanting_string_is_found_between_its_hook_and_its_foot() -> None:
    points, normals = stem_seen()
    slant = 0.2
    slanting = cloud_of((points + slant * points[:, 2:] * [1.0, 0.0, 0.0], normals))
    hook, foot = (0.705 + slant * 1.2, 0.0, 1.2), (0.705 - slant * 0.2, 0.0, -0.2)
    found = find_hanging_stem(slanting, StringLine(hook, foot))
    assert off(found.axis - slant * found.axis[:, 2:] * [1.0, 0.0, 0.0]) < RADIUS + 0.004
    with pytest.raises(StageFailure, match="no stem hangs below the hook"):
        find_hanging_stem(slanting, StringLine(hook))


def test_of_two_stems_that_share_a_foot_the_asked_one_is_that_on_the_side_of_its_hook() -> None:
    """Both bow out from the line of the asked one's string, the other less: without its own line it would be taken."""
    (points, normals), bow = stem_seen(), np.array([0.0, 1.0, 0.0])
    aside = np.minimum(4 * (points[:, 2:] + 0.1), 1.0)
    both = cloud_of((points + 0.06 * aside * bow, normals), (points - 0.05 * aside * bow, normals))
    foot, own, other = (0.705, 0.0, -0.6), (0.705, 0.0, 1.2), (0.705, -0.16, 1.2)
    top = [
        find_hanging_stem(both, StringLine(own, foot, beside)).axis[-10:, 1]
        for beside in ((), (StringLine(other, foot),))
    ]
    np.testing.assert_allclose(top, np.repeat([[-0.05], [0.06]], 10, axis=1), atol=0.01)


def test_no_stem_below_the_hook_is_said() -> None:
    with pytest.raises(StageFailure, match=r"hook at 0\.70, 0\.40") as failure:
        find_hanging_stem(cloud_of(stem_seen()), StringLine((0.7, 0.4, 1.2)))
    assert failure.value.kind == "no_stem_found"


def test_the_pipeline_takes_the_hook_unless_the_stem_is_named() -> None:
    cloud, params = cloud_of(stem_seen()), Params()
    assert _hung(cloud, params) == (None, params)
    hung = replace(params, plant=replace(params.plant, string=HeldString.of("tomato", (0.7, 0.0, 1.2))))
    _, named = _hung(cloud, hung)
    assert named.skeleton.root is not None
    assert named.stem.tip is not None
    assert named.stem.tip[2] > named.skeleton.root[2] + 0.4
    rooted = replace(hung, skeleton=replace(params.skeleton, root=(0.7, 0.0, 0.1)))
    assert _hung(cloud, rooted) == (None, rooted)


def test_a_hanging_stem_ends_where_its_tree_does_though_more_of_it_is_seen() -> None:
    z = np.linspace(0.0, 0.3, 31)
    stem = np.stack([0.7 + 0 * z, 0 * z, z], axis=1)
    leaf = np.array([[0.8, 0.0, 0.45]])  # higher, and beside the string's line
    tree = Skeleton(np.vstack([stem, leaf]), np.arange(-1, 31), np.full(32, 0.005))
    hung = replace(Params(), plant=replace(Params().plant, string=HeldString.of("tomato", (0.7, 0.0, 1.2))))

    def tip(height: float) -> tuple[float, float, float] | None:
        return _topped(tree, replace(hung, stem=replace(hung.stem, tip=(0.7, 0.0, height)))).stem.tip

    assert tip(0.5) == pytest.approx((0.7, 0.0, 0.3))
    assert tip(0.32) == (0.7, 0.0, 0.32)
    assert _topped(tree, Params()) == Params()
