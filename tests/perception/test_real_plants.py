"""Real clouds: one tree, a stem that rises, a grasp on the stem system; and the command that does it all."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from anther.cli.main import main
from anther.perception.formats.clouds import read_cloud
from anther.perception.skeleton import Skeleton, skeletonize
from anther.perception.stem import find_stem
from anther.pollination.grasp import load_grasps


@pytest.mark.parametrize("plant", [0, 40, 80])
def test_seedlings_stem_lies_on_stem_points(data: Path, plant: int) -> None:
    path = data / "clouds" / "trackplant3d_tomato1a.npz"
    cloud = read_cloud(path, "mm", "y", plant=plant)
    with np.load(path) as stored:
        part = slice(*stored["offsets"][[plant, plant + 1]])
        is_stem = stored["labels"][part] == 0
    skeleton = skeletonize(cloud)
    stem = find_stem(skeleton)
    nodes = skeleton.nodes[stem.node_ids]
    away, _ = KDTree(cloud.points[is_stem]).query(nodes)
    assert np.mean(away <= 2 * skeleton.radius[stem.node_ids]) > 0.75
    assert np.linalg.norm(nodes[-1] - nodes[0]) > 0.4 * np.ptp(cloud.points[is_stem], axis=0).max()


@pytest.mark.parametrize("name", ["gavriel_maize_28.2.23_8", "pheno4d_tomato_03-05"])
def test_the_command_writes_everything(data: Path, tmp_path: Path, name: str, capsys) -> None:
    assert main(["skeletonize", str(data / "clouds" / f"{name}.npz"), "--out", str(tmp_path), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    skeleton = Skeleton.load(tmp_path / "skeleton.npz")
    assert printed["nodes"] == len(skeleton.nodes)
    assert load_grasps(tmp_path / "grasp.json")[0].arc_length == pytest.approx(printed["grasp"]["arc_length"])
    assert (tmp_path / "overview.png").stat().st_size > 10_000
    assert len((tmp_path / "skeleton.swc").read_text().splitlines()) > len(skeleton.nodes)
