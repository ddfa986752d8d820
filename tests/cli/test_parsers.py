"""Whatever stands in a file, a parser gives a result or one InputError."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from anther.core.errors import InputError
from anther.core.geometry import Intrinsics, look_at
from anther.perception.capture import Capture
from anther.perception.cloud import Cloud
from anther.perception.formats._bag_messages import read_trajectory
from anther.perception.formats.clouds import read_cloud
from anther.perception.formats.skeletons import read_skeleton, write_skeleton
from anther.perception.skeleton import Skeleton
from anther.plant.bench import read_material
from anther.plant.bench.measurements import PROFILE, read_measurements
from anther.pollination.grasp import load_grasps
from anther.robot.calibration import read_poses

TREE = Skeleton(
    np.array([[0, 0, 0], [0, 0, 0.1], [0, 0.05, 0.2], [0.1, 0, 0.15]]), np.array([-1, 0, 1, 1]), np.full(4, 4e-3)
)
POINTS = np.random.default_rng(0).uniform(0, 0.4, (60, 3))
POSE = {"pose": [0, 0, 0, 0, 0, 0, 1]}


def _skeleton(path: Path) -> None:
    write_skeleton(path, TREE)


def _capture(path: Path) -> None:
    camera = Intrinsics(8, 6, 8.0, 8.0, 3.5, 2.5)
    Capture(np.full((1, 6, 8), 0.8), camera, look_at([0, 0, 0.5], [1, 0, 0.5])[None]).save(path.parent)


def _text(text: str) -> Callable[[Path], Any]:
    return lambda path: path.write_text(text)


NUMBERS = "0.1,0.2,0.3,0,0,0,1"
PARSERS: dict[str, tuple[Callable[[Path], Any], Callable[[Path], Any]]] = {
    "cloud.npz": (lambda path: np.savez(path, points=POINTS, units="m", up=[0, 0, 1]), read_cloud),
    "cloud.ply": (lambda path: Cloud(POINTS).save(path), read_cloud),
    "cloud.xyz": (lambda path: np.savetxt(path, POINTS), read_cloud),
    "tree.npz": (_skeleton, read_skeleton),
    "tree.swc": (_skeleton, read_skeleton),
    "tree.txt": (_skeleton, read_skeleton),
    "tree.ply": (_skeleton, read_skeleton),
    "tree.graphml": (_skeleton, read_skeleton),
    "tree.mtg": (_skeleton, read_skeleton),
    "c/transforms.json": (_capture, Capture.load),
    "grasps.json": (_text('{"kind": "grasps", "schema": 1, "grasps": []}'), load_grasps),
    "material.json": (_text('{"kind": "material", "schema": 1, "youngs": 1e8}'), read_material),
    "poses.csv": (_text(f"image,x,y,z,qx,qy,qz,qw\na.png,{NUMBERS}\n"), read_poses),
    "poses.json": (_text(json.dumps({"a.png": POSE["pose"]})), read_poses),
    "trajectory.txt": (_text(f"1.0 {NUMBERS.replace(',', ' ')}\n2.0 {NUMBERS.replace(',', ' ')}\n"), read_trajectory),
    "profile.csv": (_text("distance_mm,radius_mm\n0,5\n100,4\n"), lambda path: read_measurements(path, PROFILE)),
}
"""File -> what writes a good one, and what reads it."""

junk = st.one_of(
    st.binary(max_size=12),
    st.sampled_from(
        [b"nan", b"inf", b"-1", b"1e999", b"9" * 400, b"[", b"{", b"\x00", b"\xff\xfe", b"\r", "²".encode(), b",,"]
    ),
)


@pytest.mark.parametrize("name", PARSERS)
@given(data=st.data())
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_parser_gives_a_result_or_one_message(tmp_path: Path, name: str, data: st.DataObject) -> None:
    write, read = PARSERS[name]
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    if not path.exists():
        write(path)
        (tmp_path / "good").write_bytes(path.read_bytes())
    good = (tmp_path / "good").read_bytes()
    a, b = sorted((data.draw(st.integers(0, len(good))), data.draw(st.integers(0, len(good)))))
    path.write_bytes(good[:a] + data.draw(junk) + good[b if data.draw(st.booleans()) else a :])
    said = ""
    try:
        assert read(path) is not None
    except InputError as error:
        said = str(error).strip()
    assert "\n" not in said
    assert len(said) < 2000
