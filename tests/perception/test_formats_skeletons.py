"""Skeleton exports: what is written is read back as the same tree, radii and organs; bad files are refused in words."""

from __future__ import annotations

import contextlib
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from anther.cli.main import main
from anther.core.errors import InputError
from anther.core.runs import FILES
from anther.perception.formats import _gltf as gltf
from anther.perception.formats._mtg import successors
from anther.perception.formats.skeleton_file import assume_radii, rooted
from anther.perception.formats.skeletons import READS, WRITES, read_skeleton, write_skeleton
from anther.perception.skeleton import Skeleton
from anther.perception.stem import find_stem
from anther.plant.imported import main_stem, read_source

KEEP_RADII = sorted(set(READS) - {".txt"})
KEEP_LABELS = [".swc", ".ply", ".graphml", ".mtg"]


def random_tree(seed: int, count: int = 40) -> Skeleton:
    """A tree whose every order of branching, from a bare line to a star, may turn up; in a robot's frame, not at 0.

    It is 5 mm high or more, as every plant that is read must be.
    """
    rng = np.random.default_rng(seed)
    reach = int(rng.integers(1, 8))
    parent = np.array([-1, *(int(rng.integers(max(0, j - reach), j)) for j in range(1, count))])
    nodes = np.zeros((count, 3))
    nodes[0] = rng.uniform(-1, 1, 3)
    for j in range(1, count):
        nodes[j] = nodes[parent[j]] + rng.uniform([-0.01, -0.01, 0.005], [0.01, 0.01, 0.02])
    return Skeleton(nodes, parent, rng.uniform(1e-4, 5e-3, count))


def names_of(skeleton: Skeleton) -> list[str]:
    top = int(np.argmax(skeleton.nodes[:, 2]))
    on_stem = set(skeleton.path_from_root(top).tolist())
    return ["stem" if j in on_stem else "branch" for j in range(len(skeleton.nodes))]


def in_order(file, skeleton: Skeleton, suffix: str) -> np.ndarray:
    """Index of each of the skeleton's nodes in the file's tree, by the number it was written with."""
    return np.array([file.node(j + (suffix in {".swc", ".mtg"})) for j in range(len(skeleton.nodes))])


@pytest.mark.parametrize("suffix", sorted(READS))
@settings(max_examples=15)
@given(seed=st.integers(0, 10_000), count=st.integers(2, 60))
def test_the_same_tree_comes_back(tmp_path_factory, suffix: str, seed: int, count: int) -> None:
    skeleton = random_tree(seed, count)
    names = names_of(skeleton)
    path = tmp_path_factory.mktemp("tree") / f"tree{suffix}"
    write_skeleton(path, skeleton, names)
    file = read_skeleton(path)
    at = in_order(file, skeleton, suffix)
    np.testing.assert_allclose(file.nodes[at], skeleton.nodes, rtol=1e-6, atol=1e-9)
    if suffix in KEEP_RADII:
        np.testing.assert_allclose(file.skeleton().radius[at], skeleton.radius, rtol=1e-6)
    if suffix != ".txt" or skeleton.nodes[0, 2] == skeleton.nodes[:, 2].min():
        np.testing.assert_array_equal(file.parent[at[1:]], at[skeleton.parent[1:]])
    if suffix in KEEP_LABELS:
        assert file.labels is not None
        assert [file.labels[k] for k in at] == names


@pytest.mark.parametrize("suffix", KEEP_LABELS)
def test_without_labels_none_come_back(tmp_path: Path, suffix: str) -> None:
    write_skeleton(tmp_path / f"a{suffix}", random_tree(1))
    assert read_skeleton(tmp_path / f"a{suffix}").labels is None


def test_graphml_is_read_by_networkx(tmp_path: Path) -> None:
    skeleton = random_tree(2)
    write_skeleton(tmp_path / "a.graphml", skeleton, names_of(skeleton))
    graph = nx.read_graphml(tmp_path / "a.graphml")
    assert nx.is_arborescence(graph)
    for j, (x, y, z) in enumerate(skeleton.nodes):
        node = graph.nodes[f"n{j}"]
        assert (node["x"], node["y"], node["z"], node["radius"]) == (x, y, z, skeleton.radius[j])
    assert {(int(a[1:]), int(b[1:])) for a, b in graph.edges} == set(map(tuple, skeleton.edges.tolist()))


def test_graphml_of_networkx_is_read(tmp_path: Path) -> None:
    skeleton = random_tree(3)
    graph = nx.Graph()
    for j, (x, y, z) in enumerate(skeleton.nodes):
        graph.add_node(j, x=float(x), y=float(y), z=float(z), radius=float(skeleton.radius[j]))
    graph.add_edges_from(skeleton.edges.tolist())
    nx.write_graphml(graph, tmp_path / "a.graphml")
    file = read_skeleton(tmp_path / "a.graphml")
    at = in_order(file, skeleton, ".graphml")
    np.testing.assert_array_equal(file.nodes[at], skeleton.nodes)
    np.testing.assert_array_equal(file.parent[at[1:]], at[skeleton.parent[1:]])


def test_ply_nodes_are_seen_by_others_as_points(tmp_path: Path) -> None:
    skeleton = random_tree(4)
    write_skeleton(tmp_path / "a.ply", skeleton)
    np.testing.assert_array_equal(trimesh.load(tmp_path / "a.ply").vertices, skeleton.nodes)


MTG_BY_HAND = """CODE:\tFORM-A

CLASSES:
SYMBOL\tSCALE\tDECOMPOSITION\tINDEXATION\tDEFINITION
$\t0\tFREE\tFREE\tIMPLICIT
P\t1\tFREE\tFREE\tEXPLICIT
A\t2\tFREE\tFREE\tEXPLICIT
N\t3\tFREE\tFREE\tEXPLICIT

DESCRIPTION:
LEFT\tRIGHT\tRELTYPE\tMAX
N\tN\t<\t?
N\tN\t+\t?

FEATURES:
NAME\tTYPE
XX\tREAL
YY\tREAL
ZZ\tREAL

MTG:
ENTITY-CODE\t\t\tXX\tYY\tZZ
/P1\t\t\t\t\t
^/N1\t\t\t0\t0\t0
^<N2\t\t\t0\t0\t0.1
\t+N3\t\t0.1\t0\t0.1
\t^<N4\t\t0.2\t0\t0.1
\t\t+N5\t0.2\t0.1\t0.1
\t+N6\t\t-0.1\t0\t0.1
# a comment
^<N7\t\t\t0\t0\t0.2
"""


def test_mtg_as_openalea_lays_it_out(tmp_path: Path) -> None:
    (tmp_path / "a.mtg").write_text(MTG_BY_HAND)
    file = read_skeleton(tmp_path / "a.mtg")
    above = {int(n): int(file.numbers[p]) for n, p in zip(file.numbers, file.parent, strict=True) if p >= 0}
    assert above == {2: 1, 3: 2, 4: 3, 5: 4, 6: 2, 7: 2}
    assert file.radius is None
    np.testing.assert_allclose(file.nodes[file.node(5)], [0.2, 0.1, 0.1])


def test_mtg_numbers_have_no_plus_sign(tmp_path: Path) -> None:
    """OpenAlea's reader splits lines at + / < [ ], also within numbers: 1e+02 would tear a line."""
    skeleton = random_tree(5)
    write_skeleton(tmp_path / "a.mtg", skeleton, names_of(skeleton))
    code = (tmp_path / "a.mtg").read_text().partition("ENTITY-CODE")[2].splitlines()[2:]
    assert all(not set("+/<[]") & set("".join(line.split()[1:])) for line in code)


def test_an_axis_stays_within_its_organ() -> None:
    """A long, branched side shoot does not take over the stem."""
    nodes = np.array([[0, 0, 0], [0, 0, 0.1], [0, 0, 0.2], [0.1, 0, 0.1], [0.3, 0, 0.1], [0.6, 0, 0.1]])
    skeleton = Skeleton(nodes, np.array([-1, 0, 1, 1, 3, 4]), np.full(6, 1e-3))
    assert successors(skeleton)[1] == 3
    assert successors(skeleton, ["stem"] * 3 + ["branch"] * 3)[1] == 2


def rings(scene: trimesh.Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(centres, radii, whether no radius is uneven) of all rings of a scene's tubes, in Anther's frame."""
    centres, radii, even = [], [], []
    for mesh in scene.geometry.values():
        for tube in mesh.split(only_watertight=False):
            ends = np.flatnonzero(np.bincount(tube.faces.ravel(), minlength=len(tube.vertices)) == 12)
            body = np.delete(tube.vertices, ends[-2:], axis=0).reshape(-1, 12, 3)
            centres.append(body.mean(axis=1))
            spread = np.linalg.norm(body - centres[-1][:, None], axis=2)
            radii.append(spread.mean(axis=1))
            even.append(np.ptp(spread, axis=1) / radii[-1])
    return np.concatenate(centres), np.concatenate(radii), np.concatenate(even)


@pytest.mark.parametrize("labelled", [True, False])
def test_glb_has_a_ring_of_each_node_s_radius(tmp_path: Path, labelled: bool) -> None:
    skeleton = random_tree(6)
    names = names_of(skeleton) if labelled else None
    write_skeleton(tmp_path / "a.glb", skeleton, names)
    scene = trimesh.load_scene(tmp_path / "a.glb", process=False, merge_primitives=False)
    assert set(scene.geometry) == ({"stem", "branch"} if labelled else {"skeleton"})
    for mesh in scene.geometry.values():
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.volume > 0
    centres, radii, even = rings(scene)
    assert even.max() < 1e-3
    for node, radius in zip(skeleton.nodes, skeleton.radius, strict=True):
        here = np.linalg.norm(centres - node, axis=1) < 1e-6 * max(1, float(np.abs(node).max()))
        assert here.any()
        assert np.abs(radii[here] / radius - 1).min() < 1e-3


def test_glb_stands_upright_in_viewers(tmp_path: Path) -> None:
    """glTF's y is up: the loaded scene's y runs along our z, its z against our y."""
    skeleton = random_tree(7)
    write_skeleton(tmp_path / "a.glb", skeleton)
    lower, upper = trimesh.load_scene(tmp_path / "a.glb").bounds
    thick = skeleton.radius.max() * 1.01
    assert np.all(np.abs(lower - [*skeleton.nodes.min(0)[[0, 2]], -skeleton.nodes[:, 1].max()]) < thick)
    assert np.all(np.abs(upper - [*skeleton.nodes.max(0)[[0, 2]], -skeleton.nodes[:, 1].min()]) < thick)


def test_a_folded_or_coincident_polyline_still_gives_finite_tubes() -> None:
    nodes = np.array([[0, 0, 0], [0, 0, 0.1], [0, 0, 0.0], [0, 0, 0.0], [0, 0.1, 0.0]])
    skeleton = Skeleton(nodes, np.array([-1, 0, 1, 2, 3]), np.full(5, 1e-3))
    for mesh in gltf.tubes(skeleton).values():
        assert np.isfinite(mesh.vertices).all()


GRAPHML = '<graphml><key id="x" for="node" attr.name="x" attr.type="double"/>{}</graphml>'
BAD = {
    "cut.graphml": ("<graphml><graph>", "not XML"),
    "no graph.graphml": ("<graphml/>", "no graph"),
    "bare.graphml": (GRAPHML.format('<graph><node id="a"><data key="x">1</data></node></graph>'), "without x, y, z"),
    "lost.graphml": (GRAPHML.format('<graph><edge source="a" target="b"/></graph>'), "node 'a' without x, y, z"),
    "empty.mtg": ("", "ENTITY-CODE"),
    "no place.mtg": ("ENTITY-CODE\tlength\n/P1\t3\n", "XX, YY, ZZ"),
    "odd.mtg": (MTG_BY_HAND.replace("\t+N6", "\t*N6"), "One entity"),
    "two.mtg": (MTG_BY_HAND + "/P2\n^/N8\t\t\t0\t0\t0\n", "2 trees"),
    "half.mtg": (MTG_BY_HAND.replace("0.2\t0.1\t0.1", "0.2"), "only some of"),
    "word.mtg": (MTG_BY_HAND.replace("0.2\t0.1\t0.1", "0.2\tx\t0.1"), "unreadable"),
    "text.ply": ("hello", "unreadable"),
    "cloud.ply": (
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
        "end_header\n0 0 0\n",
        "edge",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_in_words(tmp_path: Path, name: str) -> None:
    text, message = BAD[name]
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=message) as refusal:
        read_skeleton(tmp_path / name)
    assert str(tmp_path / name) in str(refusal.value)
    assert "allowed" in str(refusal.value)


@pytest.mark.parametrize("number", [12, 2**30, -1])
def test_an_edge_of_a_node_that_is_not_there_is_refused_and_not_followed(tmp_path: Path, number: int) -> None:
    """A library that follows edges would be at it for hours."""
    path = tmp_path / "tree.ply"
    write_skeleton(path, random_tree(3, 12))
    content = path.read_bytes()
    path.write_bytes(content[:-4] + number.to_bytes(4, "little", signed=True))
    with pytest.raises(InputError, match="allowed"):
        read_skeleton(path)


@pytest.mark.parametrize("suffix", [".ply", ".graphml", ".mtg"])
@settings(max_examples=15)
@given(share=st.floats(0, 0.98))
def test_truncated_files_are_refused_or_no_other_tree(tmp_path_factory, suffix: str, share: float) -> None:
    """A text cut at a line's end may still be a tree, but a smaller one; never one with other nodes."""
    skeleton = random_tree(8)
    path = tmp_path_factory.mktemp("cut") / f"a{suffix}"
    write_skeleton(path, skeleton)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    if suffix != ".mtg":
        with pytest.raises(InputError, match="allowed"):
            read_skeleton(path)
        return
    with contextlib.suppress(InputError):
        assert len(read_skeleton(path).nodes) < len(skeleton.nodes)


def test_wrong_labels_are_refused(tmp_path: Path) -> None:
    for labels in (["stem"], ["two words"] * 40, [""] * 40):
        with pytest.raises(InputError, match="labels"):
            write_skeleton(tmp_path / "a.swc", random_tree(1), labels)


def straight_plant(folder: Path) -> Skeleton:
    z = np.linspace(0, 0.4, 21)
    nodes = np.concatenate([np.stack([0 * z, 0 * z, z], axis=1), [[0.05, 0, 0.2], [0.1, 0, 0.22]]])
    skeleton = Skeleton(nodes, np.array([*range(-1, 20), 10, 21]), np.array([5e-3] * 21 + [2e-3] * 2))
    skeleton.save(folder / FILES["skeleton"])
    find_stem(skeleton).save(folder / FILES["stem"])
    return skeleton


@pytest.mark.parametrize("suffix", sorted(WRITES))
def test_export_command(tmp_path: Path, capsys, suffix: str) -> None:
    skeleton = straight_plant(tmp_path)
    out = tmp_path / f"plant{suffix}"
    assert main(["view", str(tmp_path), "--to", str(out)]) == 0
    assert "23 nodes; 21 stem nodes" in capsys.readouterr().out
    if suffix in READS:
        assert len(read_skeleton(out).nodes) == len(skeleton.nodes)
    assert out.stat().st_size > 100


def test_export_from_file_to_file_keeps_the_organs(tmp_path: Path) -> None:
    straight_plant(tmp_path)
    for source, out in ((tmp_path, "a.mtg"), (tmp_path / "a.mtg", "b.graphml"), (tmp_path / "b.graphml", "c.ply")):
        assert main(["view", str(source), "--to", str(tmp_path / out)]) == 0
    labels = read_skeleton(tmp_path / "c.ply").labels
    assert labels is not None
    assert labels.count("stem") == 21


def test_export_finds_the_stem_when_asked(tmp_path: Path, capsys) -> None:
    straight_plant(tmp_path)
    (tmp_path / FILES["stem"]).unlink()
    for source in (str(tmp_path), str(tmp_path / FILES["skeleton"])):
        words = ["view", source, "--to", str(tmp_path / "a.swc"), "--overwrite"]
        assert main(words) == 0
        assert "organs not told apart" in capsys.readouterr().out
        assert main([*words, "--find-stem"]) == 0
        assert "21 stem nodes" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("source", "out", "message"),
    [
        ("nowhere", "a.ply", "no such file"),
        (".", "a.ply", "without 04_skeleton.npz"),
        (".", "a.obj", ".graphml"),
        ("bare.txt", "a.swc", "radius"),
    ],
)
def test_export_refuses(tmp_path: Path, capsys, source: str, out: str, message: str) -> None:
    (tmp_path / "bare.txt").write_text("*Nodes\n0, 0, 0\n0, 0, 1\n*Edges\n1, 2\n")
    assert main(["view", str(tmp_path / source), "--to", str(tmp_path / out)]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / out).exists()


def scrap_of_soil() -> tuple[np.ndarray, np.ndarray]:
    """A stem of 31 nodes, 0.3 m, with a branch; at its foot a scrap of soil, whose end is the lowest node."""
    stem = np.stack([np.zeros(31), np.zeros(31), 0.2 + 0.01 * np.arange(31)], axis=1)
    scrap = np.array([[0.01, 0.0, 0.199], [0.03, 0.0, 0.198], [0.05, 0.01, 0.197], [-0.02, 0.0, 0.2]])
    branch = np.array([[0.02, 0.0, 0.36], [0.05, 0.0, 0.38]])
    nodes = np.concatenate([stem, scrap, branch])
    edges = [(i, i + 1) for i in range(30)] + [(0, 31), (31, 32), (32, 33), (0, 34), (15, 35), (35, 36)]
    return nodes, np.array(edges)


def test_a_scrap_of_soil_is_not_the_root() -> None:
    nodes, edges = scrap_of_soil()
    lowest = rooted(nodes, edges)
    assert lowest.numbers[0] == 33
    assert lowest.rooted_at().nodes[0] == pytest.approx(nodes[0])
    assert rooted(nodes[:31], edges[:30]).rooted_at().numbers[0] == 0  # without a scrap: the lowest node


@given(turned=st.lists(st.booleans(), min_size=36, max_size=36))
def test_an_edge_has_no_direction(turned: list[bool]) -> None:
    """So a file may name the parent first or last: the root alone says which way is up the tree."""
    nodes, edges = scrap_of_soil()
    either = np.where(np.array(turned)[:, None], edges[:, ::-1], edges)
    for root in (0, 20, 36):
        one, other = rooted(nodes, edges, root=root), rooted(nodes, either, root=root)
        assert (one.numbers.tolist(), one.parent.tolist()) == (other.numbers.tolist(), other.parent.tolist())


def test_scraps_of_soil_at_the_root_are_left_out() -> None:
    nodes, edges = scrap_of_soil()
    bare = rooted(nodes, edges).rooted_at().without_scraps()
    assert set(bare.numbers) == {*range(31), 35, 36}
    for number in bare.numbers:
        assert bare.nodes[bare.node(number)] == pytest.approx(nodes[number])
    assert np.linalg.norm(bare.nodes[1:] - bare.nodes[bare.parent[1:]], axis=1).max() < 0.04, "edges as before"
    again = bare.without_scraps()
    assert len(again.nodes) == len(bare.nodes)
    two = np.concatenate([nodes, [[0.05, 0.0, 0.25], [0.06, 0.0, 0.3]]])
    both = rooted(two, np.concatenate([edges, [(0, 37), (37, 38)]])).rooted_at(0).without_scraps()
    assert {37, 38} <= set(both.numbers), "what goes up is a shoot"


def test_who_knows_better_names_the_root() -> None:
    nodes, edges = scrap_of_soil()
    found = rooted(nodes, edges).rooted_at(30)
    assert found.numbers[0] == 30
    assert sorted(found.numbers) == list(range(len(nodes)))
    assert np.all(found.parent[1:] < np.arange(1, len(nodes)))
    with pytest.raises(InputError, match="node number"):
        found.rooted_at(99)


def test_supposed_radii_add_up_as_pipes_do() -> None:
    found = rooted(*scrap_of_soil()).rooted_at()
    radius = assume_radii(found, 5e-3)
    assert radius[0] == pytest.approx(5e-3)
    assert np.all(radius[1:] <= radius[found.parent[1:]] + 1e-12)
    stem = found.skeleton(radius)
    assert stem.radius.min() == pytest.approx(0.5e-3)


@pytest.mark.parametrize("name", ["pepper0", "pepper4", "tomato1", "tomato2"])
def test_the_authors_plants_stand_where_their_stem_begins_or_it_is_said(data: Path, name: str) -> None:
    _, skeleton = read_source(data / "skeletons" / f"{name}.txt")
    stem = main_stem(skeleton)
    assert np.ptp(skeleton.nodes[stem.node_ids, 2]) > 0.6 * np.ptp(skeleton.nodes[:, 2])
    tangled = name == "tomato1"  # its lines wander from stem to leaves and back
    assert any("--stem-tip names its end" in note for note in stem.notes) == tangled
