"""`anther plan --map`: the response map of a skeleton file or a run, what it writes, and its refusals."""

from __future__ import annotations

import csv
import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anther.cli import plan as command
from anther.cli.args.plan import Args, Map, Rods, Simulation
from anther.core.errors import InputError, StageFailure
from anther.core.runs import FILES
from anther.perception.flowers import Flowers
from anther.perception.formats.skeletons import write_skeleton
from anther.perception.skeleton import Skeleton
from anther.perception.stem import find_stem
from anther.plant.model import TOMATO, build_plant
from anther.plant.source import Properties, held_nodes, read_plant
from anther.rods import frequency_response


def asked(file: Path, **change: Any) -> Args:
    """Arguments with the options of all groups in one."""
    groups = {name: kind(**{f.name: change.pop(f.name) for f in fields(kind) if f.name in change})
              for name, kind in (("rods", Rods), ("mapping", Map))}  # fmt: skip
    return Args(change.pop("source", file), map=True, **groups, **change)


def respond(file: Path, **change: Any) -> None:
    command.run(asked(file, **change))


def plant() -> Skeleton:
    """A vertical stem of 12 nodes, 0.33 m, with a branch of four nodes from node 6."""
    nodes = np.zeros((16, 3))
    nodes[:12, 2] = np.linspace(0, 0.33, 12)
    nodes[12:] = nodes[6] + np.outer(np.arange(1, 5), [0.015, 0.005, 0.015])
    return Skeleton(nodes, np.array([-1, *range(11), 6, 12, 13, 14]), np.linspace(4e-3, 2e-3, 16))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    write_skeleton(tmp_path / "plant.swc", plant())
    return tmp_path / "plant.swc"


def table(path: Path) -> list[dict[str, float]]:
    with path.open() as stream:
        return [{name: float(value) for name, value in row.items()} for row in csv.DictReader(stream)]


def test_the_map_is_the_frequency_response(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    args: dict[str, Any] = {"flower": (16,), "grips": (5, 9), "axis": "x", "frequencies": 5, "amplitude": 2e-3}
    respond(file, **args, out=tmp_path / "o", json=True)
    best = json.loads(capsys.readouterr().out)
    rows = table(tmp_path / "o" / "response_map.csv")
    assert {f.name for f in (tmp_path / "o").iterdir()} == {"response_map.csv", "response_map.png", "response_map.json"}
    assert [row["grip_node"] for row in rows] == [5] * 5 + [9] * 5
    source = read_plant(file, flowers=(16,))[0]
    for row in rows:
        grip, flower, hertz = source.node(int(row["grip_node"])), source.flower(16), [row["frequency_hz"]]
        moved = frequency_response(source.rods, source.clamp, grip, (1, 0, 0), hertz, loss_factor=0.1)[0, flower]
        turns = np.exp(1j * np.linspace(0, np.pi, 721))
        reach = np.linalg.norm((turns[:, None] * moved).real, axis=1).max()
        assert row["amplitude_ratio_mean"] == pytest.approx(reach, rel=1e-4)
        expected = 2e-3 * reach * (2 * np.pi * row["frequency_hz"]) ** 2
        assert row["acceleration_mean_m_s2"] == pytest.approx(expected, rel=1e-4)
    top = max((row for row in rows if row["allowed"]), key=lambda row: row["acceleration_mean_m_s2"])
    assert best["best_grip_node"] == top["grip_node"]
    assert best["flower_acceleration_mean_m_s2"] == pytest.approx(top["acceleration_mean_m_s2"], rel=1e-4)
    assert best == json.loads((tmp_path / "o" / "response_map.json").read_text())


def test_the_best_direction_is_no_worse_than_any_axis(file: Path, tmp_path: Path):
    found = {}
    for axis in ("best", "x", "y"):
        respond(file, axis=axis, frequencies=6, heights=3, out=tmp_path / axis, json=True)
        found[axis] = [row["acceleration_mean_m_s2"] for row in table(tmp_path / axis / "response_map.csv")]
    assert np.all(np.array(found["best"]) >= np.maximum(found["x"], found["y"]) * (1 - 1e-5))


def test_the_map_is_linear_and_the_arm_falls_with_frequency(file: Path, tmp_path: Path):
    rows = {}
    for name, change in {"one": {}, "two": {"amplitude": 2e-3}, "arm": {"arm": True}}.items():
        respond(file, **{"frequencies": 8, "heights": 2, "out": tmp_path / name, "json": True, **change})
        rows[name] = table(tmp_path / name / "response_map.csv")
    one, two, arm = (np.array([row["acceleration_mean_m_s2"] for row in rows[name]]) for name in ("one", "two", "arm"))
    np.testing.assert_allclose(two, 2 * one, rtol=1e-4)
    amplitude = np.array([row["grip_amplitude_m"] for row in rows["arm"]])
    np.testing.assert_allclose(arm, one * amplitude / 1e-3, rtol=1e-4)
    assert np.all(np.diff(amplitude[:8]) <= 0)
    assert amplitude[0] <= 0.03
    assert amplitude[7] < 2e-4


def test_a_run_brings_its_flowers_and_its_stem(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    tree = plant()
    flowers = Flowers(tree.nodes[[15, 11]] + [0.0, 0.01, -0.01], np.array([15, 11]))
    model = build_plant(tree, find_stem(tree), flowers)
    model.save(tmp_path / FILES["plant model"])
    respond(tmp_path, frequencies=4, heights=3, json=True)
    found = json.loads(capsys.readouterr().out)
    assert found["flower_nodes"] == [15, 11], "the nodes that bear them"
    assert found["best_grip_node"] in model.stem_nodes
    assert found["nodes"] == len(model.rods.nodes)
    respond(tmp_path, frequencies=4, heights=3, youngs=4 * model.material.youngs, json=True)
    stiffer = json.loads(capsys.readouterr().out)
    assert stiffer["natural_frequencies_hz"][0] > 1.2 * found["natural_frequencies_hz"][0]


def test_the_table_names_the_best_grip(file: Path, capsys: pytest.CaptureFixture[str]):
    respond(file, frequencies=4, heights=3)
    said = capsys.readouterr().out
    assert "at 1 mm grip amplitude, best horizontal direction" in said
    assert "best grip" in said
    assert "natural frequencies" in said


def test_pads_hold_neighbours_along_the_stem(file: Path):
    source = read_plant(file, Properties(changes={"youngs": 1e8}), bare=True)[0]

    def held(number: int, pads: float) -> set[int]:
        nodes = held_nodes(source, source.node(number), pads)
        return {int(source.numbers[node]) for node in nodes}

    assert held(7, 0.0) == {7}
    assert held(7, 0.061) == {6, 7, 8}
    assert held(7, 0.002) == {7, 8}
    assert held(16, 0.01) == {15, 16}
    assert held(3, 0.3) == {2, 3, 4, 5, 6, 7, 8}


def test_the_papers_tomato(data: Path, capsys: pytest.CaptureFixture[str]):
    file = data / "skeletons" / "tomato2.txt"
    respond(file, radius=5e-3, youngs=200e6, bend_over_twist=1.5, bare=True, frequencies=10, heights=8, json=True)
    found = json.loads(capsys.readouterr().out)
    assert 0.05 <= found["best_grip_distance_m"] <= 0.53
    assert 0.2 < found["natural_frequencies_hz"][0] < 2
    assert min(found["damping_ratios"]) == pytest.approx(0.05, rel=0.05)
    assert found["damping_ratios"][0] > 0.1, "weight lowers the stiffness of the sway, not its damping"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"flower": (99,)}, "node number"),
        ({"grips": (99,)}, "node number"),
        ({"grips": (1,)}, "not clamped"),
        ({"lowest": 0.0}, "lowest"),
        ({"lowest": 50.0}, "highest"),
        ({"frequencies": 0}, "frequencies"),
        ({"heights": 0}, "heights"),
        ({"amplitude": float("nan")}, "amplitude"),
        ({"pads": -1.0}, "pads"),
        ({"damping_ratio": 11.0}, "damping_ratio"),
        ({"radius": 0.0}, "radius"),
        ({"source": Path("nowhere.swc")}, "nowhere.swc: no such file"),
    ],
)
def test_bad_options_are_refused(file: Path, change: dict, message: str):
    with pytest.raises(InputError, match=message):
        respond(file, **({"heights": 3, "frequencies": 3} | change))


def test_the_best_is_the_best_of_what_anther_allows(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    respond(file, frequencies=12, heights=4, amplitude=2e-3, highest=60.0, out=tmp_path, json=True)
    best, rows = json.loads(capsys.readouterr().out), table(tmp_path / "response_map.csv")
    speed = [2 * np.pi * row["frequency_hz"] * row["grip_amplitude_m"] for row in rows]
    for row, v in zip(rows, speed, strict=True):
        within = v <= 0.3 and row["frequency_hz"] <= 35 and row["acceleration_mean_m_s2"] <= 200
        assert row["allowed"] == within
    allowed = [row for row in rows if row["allowed"]]
    assert 0 < len(allowed) < len(rows)
    most = max(row["acceleration_mean_m_s2"] for row in allowed)
    assert best["flower_acceleration_mean_m_s2"] == pytest.approx(most, rel=1e-4)
    assert best["beyond_limits_share"] == pytest.approx(1 - len(allowed) / len(rows))
    assert most < max(row["acceleration_mean_m_s2"] for row in rows), "a greater one is beyond a limit"


def test_where_nothing_is_allowed_nothing_is_best(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    respond(file, frequencies=4, heights=2, amplitude=0.05, out=tmp_path)
    said = capsys.readouterr().out
    assert "none: all that was asked for is beyond a limit" in said
    assert "100% of the map" in said
    assert json.loads((tmp_path / "response_map.json").read_text())["best_grip_node"] is None


def test_one_skeleton_has_one_stiffness(file: Path, capsys: pytest.CaptureFixture[str]):
    """Of a plant that must be taken to be stiffer, and of one that somebody said."""
    for made in ({}, {"density": 3000.0, "radius": 0.001}, {"youngs": 4e8}):
        said = []
        for mode in ({}, {"map": True}, {"simulate": True}):
            args = Args(file, rods=Rods(**made), frequencies=3, json=True, **mode)
            command.run(replace(args, mapping=Map(heights=2), simulation=Simulation(duration=0.02, frequency=20.0)))
            said.append(json.loads(capsys.readouterr().out)["stiffness"])
        assert len(set(said)) == 1, said
        assert ("raised from 100 MPa" in said[0]) == ("radius" in made)
        assert ("E 400 MPa (given)" in said[0]) == ("youngs" in made)


def test_rods_in_time_are_those_of_the_plan(file: Path):
    plan, mapped = command.read(Args(file))[0], command.plant_in_time(asked(file))
    np.testing.assert_array_equal(np.asarray(plan.rods.youngs), np.asarray(mapped.rods.youngs))
    assert plan.model is not None
    assert plan.model.material.youngs == float(np.asarray(mapped.rods.youngs)[1])


def test_a_stiffness_that_somebody_gave_is_not_raised(file: Path):
    soft = Properties(changes={"density": 5000.0, "youngs": TOMATO.youngs}, radius=0.001)
    with pytest.raises(StageFailure, match="buckles"):
        read_plant(file, soft)
    assert "raised from 100 MPa" in read_plant(file, Properties(changes={"density": 5000.0}, radius=0.001))[0].stiffness


def test_a_named_node_means_the_flower_that_it_bears(file: Path):
    plant = read_plant(file, flowers=(16,))[0]
    assert plant.flower(16) == plant.flower_nodes[0] != plant.node(16)
    assert plant.numbers[plant.flower(16)] == 16
    assert plant.flower(10) == plant.node(10)


def test_up_turns_a_skeleton(file: Path, tmp_path: Path):
    tree = plant()
    lying = Skeleton(tree.nodes[:, [2, 0, 1]], tree.parent, tree.radius)  # its z becomes the file's x
    write_skeleton(tmp_path / "lying.swc", lying)
    stood = read_plant(tmp_path / "lying.swc", up="x")[0]
    np.testing.assert_allclose(stood.rods.nodes, read_plant(file)[0].rods.nodes, atol=1e-6)
