"""Who knows better says where the plant stands and where its main stem ends; what cannot be meant is refused."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from made_plants import simple_plant
from sample_plants import branched

from anther.cli.main import main
from anther.core.choices import Crop
from anther.core.errors import InputError
from anther.perception.cloud import Cloud
from anther.perception.formats.skeletons import write_skeleton
from anther.perception.skeleton import Params, Skeleton, skeletonize
from anther.perception.stem import Params as StemParams
from anther.perception.stem import find_stem
from anther.plant.imported import main_stem, place, read_source
from anther.plant.source import Properties, read_plant


@pytest.fixture(scope="module")
def cloud() -> Cloud:
    return Cloud(simple_plant())


def farthest_leaf(skeleton: Skeleton) -> np.ndarray:
    """Return the place of the tip that is farthest from the stem's line."""
    return skeleton.nodes[np.linalg.norm(skeleton.nodes[:, :2], axis=1).argmax()]


@pytest.mark.parametrize("method", ["geodesic", "thinning"])
def test_the_plant_stands_where_somebody_says(cloud: Cloud, method: Literal["geodesic", "thinning"]) -> None:
    found = skeletonize(cloud, Params(method=method))
    leaf = farthest_leaf(found)
    assert np.linalg.norm(found.nodes[0] - leaf) > 0.05
    rooted = skeletonize(cloud, Params(method=method, root=tuple(leaf)))
    assert np.linalg.norm(rooted.nodes[0] - leaf) < 0.01


def test_the_main_stem_ends_where_somebody_says(cloud: Cloud) -> None:
    skeleton = skeletonize(cloud)
    leaf = farthest_leaf(skeleton)
    stem = find_stem(skeleton, StemParams(tip=tuple(leaf)))
    assert skeleton.nodes[stem.node_ids[-1]] == pytest.approx(leaf)
    assert stem.node_ids[0] == 0
    assert find_stem(skeleton).node_ids[-1] != stem.node_ids[-1]


def test_a_place_that_is_not_on_the_plant_is_refused(cloud: Cloud) -> None:
    with pytest.raises(InputError, match=r"root: got \[0.0, 0.0, 9.0\], 8.5 m from the plant"):
        skeletonize(cloud, Params(root=(0.0, 0.0, 9.0)))
    with pytest.raises(InputError, match=r"tip: got \[1.0, 0.0, 0.0\]"):
        find_stem(skeletonize(cloud), StemParams(tip=(1.0, 0.0, 0.0)))


@pytest.mark.parametrize("text", ["", "1,2", "a,b,c", "1,2,3,4", "0.1 0.2 0.3"])
def test_what_names_no_place_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="x,y,z in metres"):
        place("--root", text)
    assert place("--root", "0.1,-2,3e-2") == (0.1, -2.0, 0.03)


def test_the_command_takes_both(cloud: Cloud, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    np.savetxt(tmp_path / "plant.xyz", cloud.points)
    leaf = farthest_leaf(skeletonize(cloud))
    words = [str(tmp_path / "plant.xyz"), "--units", "m", "--up", "z"]
    named = ",".join(f"{x:.4f}" for x in leaf)
    assert main(["skeletonize", *words, f"--stem-tip={named}", "--out", str(tmp_path / "o")]) == 0
    (length,) = re.findall(r"main stem ([\d.]+) m", capfd.readouterr().out)
    assert float(length) > np.linalg.norm(leaf - skeletonize(cloud).nodes[0]), "along stem and leaf"
    assert main(["skeletonize", *words, f"--root={named}9,", "--out", str(tmp_path / "p")]) == 2
    assert "--root" in capfd.readouterr().err


CROPS: tuple[Crop, ...] = ("tomato", "pepper")


def bare(folder: Path) -> Path:
    """Write a skeleton without radii."""
    write_skeleton(folder / "plant.txt", branched()[0])
    return folder / "plant.txt"


def test_a_file_without_radii_is_as_thick_as_its_crop(tmp_path: Path) -> None:
    tomato, pepper = (read_plant(bare(tmp_path), Properties(species=crop), bare=True)[0].rods for crop in CROPS)
    for rods, stem in ((tomato, 5e-3), (pepper, 6e-3)):
        radius = np.asarray(rods.edge_radius)
        assert radius.max() == pytest.approx(stem, rel=0.05)
        tips = np.setdiff1d(np.arange(1, len(radius)), rods.parent)
        assert radius[tips].max() < 0.5 * radius.max(), "thinner with what it carries"
    given = read_plant(bare(tmp_path), Properties(radius=3e-3), bare=True)[0].rods
    assert np.asarray(given.edge_radius) == pytest.approx(3e-3)


def test_a_stub_is_no_main_stem(tmp_path: Path) -> None:
    """Where only the lowest tenth looks like a stem, the way to the top is taken, and said."""
    low = np.stack([np.zeros(6), np.zeros(6), 0.01 * np.arange(6)], axis=1)
    aside = np.stack([0.01 * np.arange(1, 16), np.zeros(15), np.full(15, 0.05)], axis=1)
    thin = np.stack([np.full(30, 0.15), np.zeros(30), 0.06 + 0.01 * np.arange(30)], axis=1)
    nodes = np.concatenate([low, aside, thin])
    radius = np.repeat([5e-3, 3e-3, 1e-3], [len(low), len(aside), len(thin)])
    crooked = Skeleton(nodes, np.arange(-1, len(nodes) - 1), radius)
    assert len(find_stem(crooked).node_ids) < 20
    stem = main_stem(crooked)
    assert stem.node_ids[-1] == len(nodes) - 1
    assert any("--stem-tip names its end" in note for note in stem.notes)
    straight = branched()[0]
    assert main_stem(straight).node_ids.tolist() == find_stem(straight).node_ids.tolist()
    assert main_stem(straight, tip=4).node_ids[-1] == 4


def test_a_shake_without_nodes_is_of_the_stem_and_says_which(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    words = ["--duration", "0.02", "--frequency", "20", "--youngs", "5e8"]
    assert main(["plan", str(bare(tmp_path)), "--simulate", *words]) == 0
    said = capfd.readouterr().out
    grip, flower = (int(found) for found in re.findall(r"(?:grip|flower at) node (\d+)", said)[::-1])
    source, skeleton = read_source(bare(tmp_path))
    stem = main_stem(skeleton)
    along = stem.arc_length[stem.node_ids.tolist().index(source.node(grip))]
    assert along == pytest.approx(stem.arc_length[-1] / 2, abs=0.02)
    assert source.node(flower) not in skeleton.parent


def test_a_node_of_a_file_is_its_root_or_ends_its_stem(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file, skeleton, stiff = bare(tmp_path), branched()[0], Properties(changes={"youngs": 1e11})
    top = int(skeleton.nodes[:, 2].argmax())
    at = ",".join(f"{x:.4f}" for x in skeleton.nodes[top])
    assert read_plant(file, stiff, root=at, bare=True)[0].numbers[0] == top
    turned = read_plant(file, stiff, root=str(top), bare=True)[0]
    assert turned.rods.nodes[0] == pytest.approx(skeleton.nodes[top], abs=1e-6)
    assert turned.numbers[0] == top
    half = len(skeleton.path_from_root(top)) // 2
    node = int(skeleton.path_from_root(top)[half])
    shorter = read_plant(file, stiff, stem_tip=str(node))[0]
    assert shorter.rods.nodes[shorter.stem_nodes[-1]] == pytest.approx(skeleton.nodes[node], abs=1e-6)
    for option in ("--root", "--stem-tip"):
        for wrong, said in (("9999", "got 9999"), ("top", "got top"), ("0,0,9", "from the plant"), ("1,2", "x,y,z")):
            assert main(["plan", str(file), "--map", option, wrong]) == 2
            assert said in capfd.readouterr().err
        (tmp_path / "run").mkdir(exist_ok=True)
        assert main(["plan", str(tmp_path / "run"), "--map", option, "3"]) == 2
        assert "with a run folder" in capfd.readouterr().err
