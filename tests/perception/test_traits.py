"""Traits: a plant drawn by hand gives its own numbers whichever way it is turned; the tables, and what is kept."""

from __future__ import annotations

import csv
from pathlib import Path
from shutil import copyfile

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anther.cli import traits as command
from anther.cli.main import main
from anther.cli.sample_data import SAMPLES, write_samples
from anther.core.errors import StageFailure
from anther.perception.cloud import Cloud
from anther.perception.skeleton import Skeleton
from anther.perception.stem import BRANCH, LEAF, STEM, TRUSS, Stem
from anther.perception.traits import LEVELS, measure, measure_cloud, organs_of

STEP, NODES = 0.01, 41
LIMBS = {10: (60.0, 30.0, LEAF), 20: (90.0, 200.0, TRUSS), 32: (45.0, 350.0, BRANCH)}
"""Node of the stem -> angle to it, azimuth [deg], organ; each of 12 steps."""


def turned(azimuth: float) -> np.ndarray:
    """Return the rotation about the vertical by an angle [deg]."""
    c, s = np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def plant(azimuth: float = 0.0, scale: float = 1.0, lean: float = 0.0) -> tuple[Skeleton, Stem]:
    """A straight stem that tapers from 5 to 1 mm, leaning towards x, with straight limbs in its own frame."""
    nodes = [np.array([0.0, 0.0, k * STEP]) for k in range(NODES)]
    parent, organ = [-1, *range(NODES - 1)], [STEM] * NODES
    for at, (angle, way, kind) in LIMBS.items():
        tilt, turn = np.radians([angle, way])
        out = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
        for k in range(12):
            parent.append(at if k == 0 else len(nodes) - 1)
            nodes.append(nodes[at] + (k + 1) * STEP * out)
            organ.append(kind)
    c, s = np.cos(np.radians(lean)), np.sin(np.radians(lean))
    leaning = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    places = scale * np.array(nodes) @ (turned(azimuth) @ leaning).T + [0.3, -0.2, 1.1]
    radius = np.full(len(nodes), 1e-3)
    radius[:NODES] = np.linspace(5e-3, 1e-3, NODES)
    stem = Stem(np.arange(NODES), scale * STEP * np.arange(NODES), np.array(list(LIMBS)), np.array(organ, np.uint8))
    return Skeleton(places, np.array(parent), scale * radius), stem


def test_a_plant_drawn_by_hand() -> None:
    found = measure(*plant())
    assert found.stem_length_m == pytest.approx(0.4)
    assert found.plant_height_m == pytest.approx(max(0.4, 0.32 + 0.12 * np.cos(np.radians(45))))
    assert found.stem_lean_deg == pytest.approx(0, abs=1e-6)
    assert found.radius_m == pytest.approx(5e-3 - 4e-3 * np.array(LEVELS) / 100, rel=0.05)
    assert found.internode_m == pytest.approx([0.10, 0.12])
    assert found.total_length_m == pytest.approx(0.4 + 3 * 0.12)
    assert [limb.organ for limb in found.limbs] == ["leaf", "truss", "branch"]
    assert [found.count(organ) for organ in ("leaf", "truss", "branch")] == [1, 1, 1]
    for limb, (at, (angle, azimuth, _)) in zip(found.limbs, LIMBS.items(), strict=True):
        assert limb.arc_length_m == pytest.approx(at * STEP)
        assert [limb.length_m, limb.total_length_m] == pytest.approx([0.12, 0.12])
        assert limb.angle_deg == pytest.approx(angle)
        assert limb.azimuth_deg == pytest.approx(azimuth)
        assert limb.radius_m == pytest.approx(1e-3)


@given(st.floats(0, 359), st.floats(0.3, 3))
def test_turning_moves_azimuths_alone_and_scale_lengths_alone(azimuth: float, scale: float) -> None:
    still, moved = measure(*plant()), measure(*plant(azimuth, scale))
    for a, b in zip(still.limbs, moved.limbs, strict=True):
        assert b.angle_deg == pytest.approx(a.angle_deg, abs=1e-6)
        assert (b.azimuth_deg - a.azimuth_deg - azimuth + 180) % 360 == pytest.approx(180, abs=1e-6)
        assert b.length_m == pytest.approx(scale * a.length_m)
    assert moved.stem_length_m == pytest.approx(scale * still.stem_length_m)
    assert moved.internode_m == pytest.approx(scale * still.internode_m)


@given(st.floats(1, 60))
def test_angles_are_to_the_stem_and_not_to_the_vertical(lean: float) -> None:
    found = measure(*plant(lean=lean))
    assert found.stem_lean_deg == pytest.approx(lean)
    assert [limb.angle_deg for limb in found.limbs] == pytest.approx([angle for angle, _, _ in LIMBS.values()])


def test_a_limb_that_bends_is_measured_where_it_leaves() -> None:
    skeleton, stem = plant()
    nodes = skeleton.nodes.copy()
    beyond = NODES + np.arange(int(0.03 / STEP), 12)  # of the first limb, which then hangs straight down
    nodes[beyond] = nodes[beyond[0] - 1] - np.outer(np.arange(1, len(beyond) + 1) * STEP, [0, 0, 1])
    found = measure(Skeleton(nodes, skeleton.parent, skeleton.radius), stem)
    assert found.limbs[0].angle_deg == pytest.approx(60)


def test_a_forked_limb_s_length_is_that_of_its_longest_way() -> None:
    skeleton, stem = plant()
    tip = NODES + 5
    nodes = np.vstack([skeleton.nodes, skeleton.nodes[tip] + [0, 0, 0.02]])
    parent, radius = np.append(skeleton.parent, tip), np.append(skeleton.radius, 1e-3)
    forked = Stem(stem.node_ids, stem.arc_length, stem.attachments, np.append(stem.organ, LEAF))
    limb = measure(Skeleton(nodes, parent, radius), forked).limbs[0]
    assert limb.length_m == pytest.approx(0.12)
    assert limb.total_length_m == pytest.approx(0.14)


def test_of_maize_every_limb_is_a_leaf() -> None:
    skeleton, stem = plant()
    for species in (None, "tomato", "pepper"):
        assert organs_of(stem, species) is stem
    found = measure(skeleton, organs_of(stem, "maize"))
    assert [limb.organ for limb in found.limbs] == ["leaf"] * 3
    assert found.stem_length_m == pytest.approx(0.4)


def test_limbs_end_in_tips_and_a_wavering_radius_is_told() -> None:
    skeleton, stem = plant()
    assert measure(skeleton, stem).tips == 4, "three limbs and the stem"
    rough = skeleton.radius.copy()
    rough[:NODES:2] *= 1.5
    spread = measure(Skeleton(skeleton.nodes, skeleton.parent, rough), stem).radius_spread_m
    assert np.all(spread > 2 * measure(skeleton, stem).radius_spread_m)


BOX = np.stack(np.meshgrid(*(np.arange(0, n + 1) * STEP for n in (10, 20, 30)), indexing="ij"), -1).reshape(-1, 3)


@given(st.floats(0.3, 3))
def test_hulls_of_a_box(scale: float) -> None:
    found = measure_cloud(Cloud(scale * BOX))
    assert found.hull_volume_m3 == pytest.approx(scale**3 * 0.1 * 0.2 * 0.3)
    assert found.hull_area_m2 == pytest.approx(scale**2 * 0.1 * 0.2)
    assert found.plant_width_m == pytest.approx(scale * np.hypot(0.1, 0.2))
    assert found.cell_m == pytest.approx(2 * scale * STEP)
    assert found.hull_area_m2 <= found.projected_area_m2 <= 1.4 * found.hull_area_m2
    assert found.green_leaf_index is found.hue_deg is None


@pytest.mark.parametrize(
    ("colour", "index", "hue"),
    [((0, 200, 0), 1.0, 120.0), ((200, 0, 0), -1.0, 0.0), ((0, 0, 90), -1.0, 240.0), ((100, 200, 0), 0.6, 90.0)],
)
def test_colours(colour: tuple[int, int, int], index: float, hue: float) -> None:
    found = measure_cloud(Cloud(BOX, colors=np.tile(np.array(colour, np.uint8), (len(BOX), 1))))
    assert (found.green_leaf_index, found.hue_deg) == pytest.approx((index, hue), abs=0.5)


def test_points_in_a_plane_are_no_plant() -> None:
    with pytest.raises(StageFailure, match="in a plane"):
        measure_cloud(Cloud(BOX[BOX[:, 0] == 0]))


@pytest.mark.parametrize(
    ("name", "plant_id", "day"),
    [
        ("p14_2026-05-03.ply", "p14", "2026-05-03"),
        ("20260503/p14.ply", "p14", "2026-05-03"),
        ("row 3/2026_05_03_p14.xyz", "row 3/p14", "2026-05-03"),
        ("p14-2026-13-03.ply", "p14-2026-13-03", ""),
        ("scan120260503.ply", "scan120260503", ""),
        ("2026-05-03.ply", "2026-05-03", "2026-05-03"),
        ("a.ply", "a", ""),
    ],
)
def test_a_name_tells_plant_and_day(name: str, plant_id: str, day: str) -> None:
    assert command.named(name) == (plant_id, day)


def test_growth_is_from_one_day_to_the_next() -> None:
    def row(plant_id: str, day: str, size: float, failure: str = "") -> dict[str, object]:
        return {"plant_id": plant_id, "date": day, "failure": failure} | dict.fromkeys(command.GROWING, size)

    days = [("a", "2026-05-05", 0.5), ("a", "2026-05-01", 0.1), ("a", "2026-05-03", 0.2), ("b", "2026-05-01", 9.0)]
    rows = [row(*day) for day in days] + [row("a", "2026-05-02", 7.0, "blurred"), row("c", "", 1.0)]
    rows[2]["leaf_area_m2"] = None
    found = list(command.growth(rows))
    assert ["leaf_area_m2_per_day" in row for row in found] == [False, False], "not measured on the day between"
    assert [(r["plant_id"], r["from"], r["days"]) for r in found] == [("a", "2026-05-01", 2), ("a", "2026-05-03", 2)]
    assert [r["plant_height_m_per_day"] for r in found] == pytest.approx([0.05, 0.15])


@pytest.fixture(scope="module")
def clouds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("clouds")
    assert "plant.ply" in SAMPLES
    write_samples(folder / "samples")
    for name in ("a", "b/c"):
        (folder / "clouds" / name).parent.mkdir(parents=True, exist_ok=True)
        copyfile(folder / "samples" / "plant.ply", folder / "clouds" / f"{name}.ply")
    (folder / "clouds" / "scrap.ply").write_text("no cloud")
    return folder / "clouds"


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_the_tables_of_a_folder(clouds: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "traits"
    words = ["traits", str(clouds), "--out", str(out)]
    assert main(words) == 1, "one of them is no cloud"
    rows = table(out / "plants.csv")
    assert [row["plant"] for row in rows] == ["a.ply", "b/c.ply", "scrap.ply"]
    assert "scrap.ply" in rows[2]["failure"]
    assert rows[0]["failure"] == ""
    named = {"plant", "plant_id"}
    assert {k: v for k, v in rows[0].items() if k not in named} == {k: v for k, v in rows[1].items() if k not in named}
    assert int(rows[0]["limbs"]) == sum(int(rows[0][f"{organ}_count"]) for organ in command.COUNTED)
    assert int(rows[0]["tips"]) >= int(rows[0]["limbs"])
    assert float(rows[0]["hull_volume_m3"]) > 0
    assert set(rows[0]) == set(command.COLUMNS)
    assert 0.05 < float(rows[0]["stem_length_m"]) < float(rows[0]["total_length_m"])
    limbs = [row for row in table(out / "limbs.csv") if row["plant"] == "a.ply"]
    assert len(limbs) == sum(int(rows[0][f"{organ}_count"]) for organ in command.COUNTED) > 0
    areas = [float(row["area_m2"]) for row in limbs if row["area_m2"]]
    assert float(rows[0]["leaf_area_m2"]) == pytest.approx(sum(areas))
    assert not any("nan" in row.values() for row in (*rows, *limbs))
    assert (out / "plants" / "b" / "c.ply" / "overview.png").stat().st_size > 1000

    def never(*_: object) -> None:
        raise AssertionError("measured again")

    before = (out / "plants.csv").read_bytes()
    monkeypatch.setattr(command, "skeletonize", never)
    assert main(words) == 1
    assert (out / "plants.csv").read_bytes() == before
    with pytest.raises(AssertionError, match="again"):
        main([*words, "--overwrite"])
    with pytest.raises(AssertionError, match="again"):
        main([*words, "--params.spacing", "0.01"])


def test_what_failed_is_tried_again(clouds: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = ["traits", str(clouds / "b"), "--out", str(tmp_path)]

    def fails(*_: object) -> None:
        raise StageFailure("no_plant_found", "nothing here")

    with monkeypatch.context() as patch:
        patch.setattr(command, "skeletonize", fails)
        assert main(words) == 1
    assert "nothing here" in table(tmp_path / "plants.csv")[0]["failure"]
    assert main(words) == 0
    assert table(tmp_path / "plants.csv")[0]["failure"] == ""


def test_its_own_results_are_no_clouds(clouds: Path, tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes((clouds / "a.ply").read_bytes())
    for _ in range(2):
        assert main(["traits", str(tmp_path), "--out", str(tmp_path / "traits")]) == 0
        assert [row["plant"] for row in table(tmp_path / "traits" / "plants.csv")] == ["a.ply"]


def test_no_cloud_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["traits", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert "allowed: a folder with clouds" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
