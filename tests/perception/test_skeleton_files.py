"""Skeleton files: the authors' text, SWC and npz become the same rooted tree, and bad files are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from anther.core.errors import InputError
from anther.perception.formats.skeletons import read_skeleton, write_skeleton
from anther.perception.skeleton import Skeleton

LOOP = "*Nodes\n0, 0, 0\n0, 0, 1\n0, 1, 1\n*Edges\n1, 2\n2, 3\n3, 1\n"
APART = "*Nodes\n0,0,0\n0,0,1\n0,1,1\n1,1,1\n*Edges\n1,2\n2,1\n3,4\n"


def tree() -> Skeleton:
    nodes = np.array([[0, 0, 0], [0, 0, 0.1], [0.1, 0, 0.2], [-0.1, 0, 0.2], [0.2, 0, 0.3]])
    return Skeleton(nodes, np.array([-1, 0, 1, 1, 2]), np.array([5, 4, 3, 2, 1]) * 1e-3)


@pytest.mark.parametrize("suffix", [".npz", ".swc", ".txt"])
def test_round_trip(tmp_path: Path, suffix: str):
    write_skeleton(tmp_path / f"tree{suffix}", tree())
    read = read_skeleton(tmp_path / f"tree{suffix}")
    np.testing.assert_allclose(read.nodes, tree().nodes, atol=1e-9)
    np.testing.assert_array_equal(read.parent, tree().parent)
    np.testing.assert_array_equal(read.numbers, np.arange(5) + (suffix == ".swc"))
    if suffix == ".txt":
        assert read.radius is None
        with pytest.raises(InputError, match="radius"):
            read.skeleton()
    else:
        np.testing.assert_allclose(read.skeleton().radius, tree().radius)
    assert read.skeleton(2e-3).radius.tolist() == [2e-3] * 5


def test_text_is_rooted_at_its_lowest_node_and_keeps_its_numbers(tmp_path: Path):
    file = tmp_path / "plant.txt"
    file.write_text("*Nodes\n0, 0, 0.5\n0.1, 0, 0.6\n0, 0, 0.1\n0, 0, 0.3\n*Edges\n1, 2\n4, 3\n1, 4\n")
    read = read_skeleton(file)
    assert read.numbers.tolist() == [2, 3, 0, 1]
    assert read.parent.tolist() == [-1, 0, 1, 2]
    assert read.node(1) == 3
    with pytest.raises(InputError, match="node number"):
        read.node(4)


@pytest.mark.parametrize("name", ["tomato2", "pepper0"])
def test_the_papers_plants_are_trees(data: Path, name: str):
    lines = (data / "skeletons" / f"{name}.txt").read_text().splitlines()
    cut = lines.index("*Edges")
    nodes = np.array([line.split(",") for line in lines[1:cut]], dtype=float)
    edges = {frozenset(int(k) - 1 for k in line.split(",")) for line in lines[cut + 1 :] if line.strip()}
    read = read_skeleton(data / "skeletons" / f"{name}.txt")
    np.testing.assert_array_equal(read.nodes, nodes[read.numbers])
    found = {frozenset(read.numbers[[p, j]].tolist()) for j, p in enumerate(read.parent) if j}
    assert found == edges
    assert np.all(read.parent[1:] < np.arange(1, len(nodes)))


@given(st.integers(0, 10_000))
@settings(max_examples=20)
def test_any_edge_order_gives_the_same_tree(tmp_path_factory, seed: int):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 20))
    parent = [int(rng.integers(0, j)) for j in range(1, n)]
    nodes = rng.uniform(0.1, 1, (n, 3))
    nodes[0, 2] = 0
    pairs = [rng.permutation([p, j + 1]) + 1 for j, p in enumerate(parent)]
    shuffled = [pairs[k] for k in rng.permutation(n - 1)]
    file = tmp_path_factory.mktemp("order") / "tree.txt"
    rows = ["*Nodes", *(f"{x}, {y}, {z}" for x, y, z in nodes), "*Edges", *(f"{a}, {b}" for a, b in shuffled)]
    file.write_text("\n".join(rows))
    read = read_skeleton(file)
    for j in range(1, n):
        above = read.numbers[read.parent[read.node(j)]]
        assert above == parent[j - 1]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "sections"),
        ("*Nodes\n0, 0\n*Edges\n", "3 numbers"),
        ("*Nodes\n0, 0, 0\n0, 0, x\n*Edges\n1, 2\n", "unreadable"),
        ("*Nodes\n0, 0, 0\n0, 0, nan\n*Edges\n1, 2\n", "NaN"),
        ("*Nodes\n0, 0, 0\n0, 0, 1\n*Edges\n1, 3\n", "edges"),
        ("*Nodes\n0, 0, 0\n0, 0, 540\n*Edges\n1, 2\n", "metres"),
        (LOOP, "loops"),
        (APART, "apart"),
        ("1 0 0 0 0 1 -1\n2 0 0 0 1 1 7\n", "unknown parent"),
        ("1 0 0 0 0 1 -1\n1 0 0 0 1 1 1\n", "twice"),
        ("1 0 0 0 0 1 -1\n2 0 0 0 1 1 -1\n", "2 roots"),
        ("1 0 0 0 0 1\n", "7 numbers"),
        ("1 0 0 0 0 1 2\n2 0 0 0 1 1 1\n", "0 roots"),
    ],
)
def test_bad_text_and_swc_are_refused(tmp_path: Path, text: str, message: str):
    file = tmp_path / ("bad.swc" if text.startswith("1 ") else "bad.txt")
    file.write_text(text)
    with pytest.raises(InputError, match=message):
        read_skeleton(file)


def test_other_files_are_refused(tmp_path: Path):
    with pytest.raises(InputError, match="no such file"):
        read_skeleton(tmp_path / "nothing.txt")
    (tmp_path / "plant.obj").write_text("v 0 0 0")
    with pytest.raises(InputError, match=r"\.obj"):
        read_skeleton(tmp_path / "plant.obj")
    with pytest.raises(InputError, match="Choose one"):
        write_skeleton(tmp_path / "plant.obj", tree())
    (tmp_path / "cut.npz").write_bytes(b"PK\x03\x04 cut")
    with pytest.raises(InputError, match=r"cut\.npz"):
        read_skeleton(tmp_path / "cut.npz")
