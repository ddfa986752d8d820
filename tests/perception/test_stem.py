"""Stem: the best rising path, ended where it leaves its growth axis."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from alike import check_kept
from made_plants import segment_distance, simple_plant
from scipy.spatial.transform import Rotation

from anther.core.errors import InputError, StageFailure
from anther.core.geometry import Array
from anther.perception.cloud import Cloud
from anther.perception.skeleton import Skeleton, skeletonize
from anther.perception.stem import BRANCH, LEAF, STEM, TRUSS, Stem, find_stem


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


def test_a_neighbours_leaf_beyond_a_limb_does_not_draw_the_stem_away() -> None:
    """What lies beyond a stem's end does not speak for it, however long and thick it is: limbs do."""
    stem = line([0, 0, 0], [0, 0, 0.6], 60)
    limbs = [line(stem[k], [0.2, 0, 0.02 + stem[k][2]]) for k in (15, 25, 35, 45)]
    beyond = line(limbs[0][-1], [1.0, 0.0, 0.2], 60)
    found = drawn(stem, *limbs, beyond, radius=[0.005, *4 * [0.004], 0.008])
    nodes = found.nodes[find_stem(found).node_ids]
    assert np.abs(nodes[:, 0]).max() < 1e-9
    assert nodes[-1, 2] > 0.5


@pytest.mark.parametrize("lean", [0, 20, 30])
def test_a_leaning_plants_stem_is_found_to_its_top_and_not_beyond(lean: int) -> None:
    turn = Rotation.from_euler("y", lean, degrees=True).as_matrix()
    skeleton = skeletonize(Cloud(simple_plant(lean) @ turn.T))
    nodes = skeleton.nodes[find_stem(skeleton).node_ids]
    assert segment_distance(nodes, [0, 0, 0], turn @ [0, 0, 0.5]).max() < 0.005
    assert np.linalg.norm(nodes[-1] - turn @ [0, 0, 0.5]) < 0.02


@pytest.mark.parametrize("bend", [0.8, -1.5])
def test_a_bent_plants_stem_is_found_to_its_top(bend: float) -> None:
    skeleton = skeletonize(Cloud(bent(simple_plant(3), bend)))
    nodes = skeleton.nodes[find_stem(skeleton).node_ids]
    axis = bent(np.array(line([0, 0, 0], [0, 0, 0.5], 500)), bend)
    assert np.linalg.norm(nodes[:, None] - axis, axis=2).min(axis=1).max() < 0.005
    assert np.linalg.norm(nodes[-1] - axis[-1]) < 0.02


def bent(points: Array, bend: float) -> Array:
    """Return the points moved sideways with the square of their height: at 0.5 m up by bend / 4 [m]."""
    return points + np.outer(bend * points[:, 2] ** 2, [1.0, 0, 0])


def test_petioles_are_branches_and_blades_are_leaves() -> None:
    skeleton = skeletonize(Cloud(simple_plant()))
    organ = find_stem(skeleton).organ
    petiole, blade = np.full((2, len(organ)), np.inf)
    for k in range(4):
        base, out = np.array([0, 0, 0.125 + 0.1 * k]), np.array([np.cos(2.4 * k), np.sin(2.4 * k), 0.7])
        petiole = np.minimum(petiole, segment_distance(skeleton.nodes, base + 0.01 * out, base + 0.07 * out))
        blade = np.minimum(blade, segment_distance(skeleton.nodes, base + 0.1 * out, base + 0.14 * out))
    assert np.mean(organ[petiole < 0.004] == BRANCH) > 0.9
    assert np.all(organ[blade < 0.008] == LEAF)


def test_nothing_grows_out_of_a_leaf() -> None:
    skeleton = skeletonize(Cloud(simple_plant(1)))
    organ = find_stem(skeleton).organ
    assert np.all(organ[1:][organ[skeleton.parent[1:]] == LEAF] == LEAF)


def test_a_limb_with_flowers_and_no_leaf_is_a_truss() -> None:
    stalk = line([0, 0, 0.2], [0.06, 0, 0.22])
    skeleton = drawn(
        line([0, 0, 0], [0, 0, 0.3], 30), stalk, line([0, 0, 0.1], [0.06, 0, 0.12]), radius=[0.004, 0.002, 0.002]
    )
    flowers_at = np.array([[0.06, 0, 0.21], [0.045, 0.01, 0.21]])
    on_truss = (skeleton.nodes[:, 0] > 0) & (skeleton.nodes[:, 2] > 0.15)
    assert np.array_equal(find_stem(skeleton, flowers_at=flowers_at).organ == TRUSS, on_truss)
    assert not np.any(find_stem(skeleton).organ == TRUSS)


def test_a_branch_with_a_flower_and_leaves_is_a_branch() -> None:
    limb, twig = line([0, 0, 0.2], [0.1, 0, 0.25]), line([0.1, 0, 0.25], [0.2, 0, 0.25])
    skeleton = leafy(line([0, 0, 0], [0, 0, 0.4]), limb, blade=twig)
    organ = find_stem(skeleton, flowers_at=np.array([[0.06, 0.015, 0.23]])).organ
    assert np.all(organ[(skeleton.nodes[:, 0] > 0) & (skeleton.nodes[:, 0] <= 0.1)] == BRANCH)
    assert np.all(organ[skeleton.nodes[:, 0] > 0.1] == LEAF)


def test_a_spur_is_neither_branch_nor_attachment() -> None:
    spur = [[0, 0, 0.15], [0.005, 0, 0.15], [0.01, 0, 0.15]]
    limb, twig = line([0, 0, 0.2], [0.1, 0, 0.25]), line([0.1, 0, 0.25], [0.2, 0, 0.25])
    skeleton = leafy(line([0, 0, 0], [0, 0, 0.4], 40), spur, limb, blade=twig)
    stem = find_stem(skeleton)
    assert np.all(stem.organ[np.isclose(skeleton.nodes[:, 2], 0.15) & (skeleton.nodes[:, 0] > 0)] == LEAF)
    assert skeleton.nodes[stem.node_ids[stem.attachments], 2] == pytest.approx([0.2])


def test_a_leafless_plant_has_branches() -> None:
    plain = drawn(line([0, 0, 0], [0, 0, 0.4], 40), line([0, 0, 0.2], [0.1, 0, 0.25]), radius=[0.004, 0.002])
    round_ = {"width": plain.radius, "flatness": 0 * plain.radius}
    skeleton = Skeleton(plain.nodes, plain.parent, plain.radius, **round_)
    assert np.all(find_stem(skeleton).organ[skeleton.nodes[:, 0] > 0] == BRANCH)


def leafy(*lines: list[list[float]], blade: list[list[float]]) -> Skeleton:
    """Return slender lines, 8 mm thick, and a blade of 30 mm that goes on from them."""
    plain = drawn(*lines, blade, radius=[0.004] * (len(lines) + 1))
    on_blade = np.arange(len(plain.nodes)) >= len(plain.nodes) - len(blade) + 1
    width = np.where(on_blade, 0.015, 0.004)
    return Skeleton(plain.nodes, plain.parent, plain.radius, width=width, flatness=on_blade.astype(float))


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


def test_two_lines_side_by_side_in_one_stem_fork_where_they_part() -> None:
    def twin(side: float) -> list[list[float]]:
        foot, parting, top = [0.002 * side, 0, 0.02], [0.002 * side, 0, 0.2], [0.1 * side, 0, 0.4]
        return [[0, 0, 0], *line(foot, parting), *line(parting, top)[1:]]

    skeleton = drawn(twin(-1), twin(1), radius=[0.004, 0.003])
    stem = find_stem(skeleton)
    assert stem.attachments.min() == 0
    assert skeleton.nodes[stem.node_ids[stem.fork], 2] == pytest.approx(0.2, abs=0.03)


def test_a_petiole_that_rises_a_third_as_high_is_no_fork() -> None:
    trunk = line([0, 0, 0], [0, 0, 0.4])
    petiole = line([0, 0, 0.1], [0.03, 0, 0.2])
    stem = find_stem(drawn(trunk, petiole, radius=[0.004, 0.004]))
    assert stem.fork == len(stem.node_ids) - 1


def test_a_limb_that_is_thin_at_its_foot_only_forks_the_stem() -> None:
    trunk = line([0, 0, 0], [0, 0, 0.2])
    one, other = (line([0, 0, 0.2], [x, 0, 0.4]) for x in (0.1, -0.1))
    skeleton = drawn(trunk, one, other[:6], other[5:], radius=[0.005, 0.004, 0.001, 0.0035])
    stem = find_stem(skeleton)
    assert skeleton.nodes[stem.node_ids[stem.fork], 2] == pytest.approx(0.2)


def seedling(
    *, limb_at: float = 0.2, reach: float = 0.25, beyond: float = 0.24, width: float = 0.015, flat: float = 0.9
) -> Skeleton:
    """Return a stem with two limbs that goes on to `beyond` and then, straight on, as a leaf; half widths in metres."""
    top = line([0, 0, beyond], [0, 0, 0.4], 16)
    limbs = [line([0, 0, z], [reach, 0, z + 0.05], 20) for z in (0.1, limb_at)]
    plain = drawn([*line([0, 0, 0], [0, 0, beyond], 24)[:-1], *top], *limbs, radius=[0.004, 0.003, 0.003])
    on_leaf = (plain.nodes[:, 0] == 0) & (plain.nodes[:, 2] > beyond + 0.005)
    widths = np.where(on_leaf, width, plain.radius)
    return Skeleton(plain.nodes, plain.parent, plain.radius, width=widths, flatness=np.where(on_leaf, flat, 0.0))


def stem_top(skeleton: Skeleton) -> float:
    return float(skeleton.nodes[find_stem(skeleton).node_ids[-1], 2])


@pytest.mark.parametrize("flat", [0.9, 0.3])  # unrolled, rolled
def test_the_petiole_of_the_leaf_above_the_last_limb_is_not_stem(flat: float) -> None:
    assert stem_top(seedling(flat=flat)) == pytest.approx(0.2)


@pytest.mark.parametrize(("limb_at", "top"), [(0.26, 0.4), (0.2, 0.2)])
def test_a_stem_that_ends_round_goes_on_above_its_last_limb_for_an_internode(limb_at: float, top: float) -> None:
    """Longer than any internode below it is only the youngest leaf of a grass, still rolled."""
    assert stem_top(seedling(limb_at=limb_at, width=0.003, flat=0)) == pytest.approx(top)


def test_a_top_that_is_longer_than_every_limb_may_have_lost_its_limbs() -> None:
    assert stem_top(seedling(limb_at=0.11, reach=0.1)) > 0.2


def test_a_leaflet_does_not_show_that_a_leaf_is_stem() -> None:
    leaf = seedling()
    leaflet = [[0.008 * k, 0, 0.24] for k in range(1, 3)]
    at = int(np.flatnonzero(np.isclose(leaf.nodes, [0, 0, 0.24]).all(axis=1))[0])
    count = len(leaf.nodes)
    assert leaf.width is not None
    assert leaf.flatness is not None
    with_leaflet = Skeleton(
        np.concatenate([leaf.nodes, leaflet]),
        np.concatenate([leaf.parent, [at, count]]),
        np.append(leaf.radius, [0.003] * 2),
        width=np.append(leaf.width, [0.003] * 2),
        flatness=np.append(leaf.flatness, [0.0] * 2),
    )
    assert stem_top(with_leaflet) == pytest.approx(0.2)


@pytest.mark.parametrize(("flat", "goes_on"), [(0.3, True), (0.9, False)])
def test_leaves_that_touch_the_stem_broaden_it_but_make_it_no_plane(flat: float, goes_on: bool) -> None:
    plain = drawn(line([0, 0, 0], [0, 0, 0.5], 50), line([0, 0, 0.45], [0.2, 0, 0.5], 20), radius=[0.004, 0.003])
    touched = (plain.nodes[:, 0] == 0) & (plain.nodes[:, 2] > 0.15) & (plain.nodes[:, 2] < 0.44)
    width, flatness = np.where(touched, 0.01, plain.radius), np.where(touched, flat, 0.0)
    assert (
        stem_top(Skeleton(plain.nodes, plain.parent, plain.radius, width=width, flatness=flatness)) > 0.4
    ) == goes_on


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
    check_kept(find_stem(drawn(line([0, 0, 0], [0, 0, 0.3]), radius=[0.004])), tmp_path / "stem.npz")


def test_a_file_that_does_not_say_where_the_stem_forks_is_refused(tmp_path: Path) -> None:
    """Without it places above a fork would be ranked as if they were on the stem."""
    path = tmp_path / "stem.npz"
    find_stem(drawn(line([0, 0, 0], [0, 0, 0.3]), radius=[0.004])).save(path)
    stored = dict(np.load(path))
    fields = json.loads(str(stored["fields"]))
    del fields["fork"]
    stored["fields"] = np.array(json.dumps(fields))
    np.savez(path, **stored)
    with pytest.raises(InputError):
        Stem.load(path)
