"""`anther plan`: it explains its choice for a skeleton file and for a run, and says what is wrong in one line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sample_plants import branched, grasps_on

from anther.cli import main as cli
from anther.cli.args.plan import Args
from anther.cli.plan import run
from anther.core.runs import FILES
from anther.perception.formats.skeletons import write_skeleton
from anther.plant.model import TOMATO, build_plant
from anther.pollination.grasp import save_grasps
from anther.pollination.shake import Params, ShakePlan

FAST = Params()
WORDS = ["--frequencies", "4"]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    write_skeleton(tmp_path / "plant.swc", branched()[0])
    return tmp_path / "plant.swc"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    skeleton, stem, flowers = branched()
    skeleton.save(tmp_path / FILES["skeleton"])
    stem.save(tmp_path / FILES["stem"])
    flowers.save(tmp_path / FILES["flowers"])
    save_grasps(tmp_path / FILES["grasp"], grasps_on(skeleton, stem, [8, 14]))
    return tmp_path


def test_a_runs_plan_is_written_and_printed(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(Args(folder, frequencies=6, out=folder / "o", json=True, params=FAST))
    printed = json.loads(capsys.readouterr().out)
    plan = ShakePlan.load(folder / "o" / "shake_plan.json")
    assert (printed["frequency"], printed["amplitude"]) == (plan.frequency, plan.amplitude)
    assert [row["name"] for row in printed["limits"]] == [row[0] for row in plan.limits]
    assert len(printed["flowers"]) == 3
    assert (folder / "o" / "shake_plan.png").stat().st_size > 10_000
    run(Args(folder, frequencies=6, params=FAST))
    words = capsys.readouterr().out
    for part in ("Runner-up", "force of the pads", "9 of 10 scenarios", "branch-base strain"):
        assert part in words


def test_the_model_a_run_has_is_used(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    skeleton, stem, flowers = branched()
    build_plant(skeleton, stem, flowers, None, TOMATO).save(folder / FILES["plant model"])
    run(Args(folder, actuator="gripper", frequencies=6, json=True, params=FAST))
    assert json.loads(capsys.readouterr().out)["limits"][0]["name"].startswith("vibrating gripper")


def test_a_skeletons_flowers_are_named_or_supposed(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tips = np.setdiff1d(np.arange(len(branched()[0].nodes)), branched()[0].parent) + 1  # .swc counts from 1
    run(Args(file, flower=(int(tips[1]),), frequencies=4, json=True, params=FAST))
    named = json.loads(capsys.readouterr().out)
    run(Args(file, frequencies=4, json=True, params=FAST))
    supposed = json.loads(capsys.readouterr().out)
    assert len(named["flowers"]) == 1
    assert any("no flower was detected" in note for note in supposed["notes"])
    assert not any("no flower was detected" in note for note in named["notes"])


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--flower", "1"], "flower: got the root"),
        (["--flower", "999"], "node number: got 999"),
        (["--highest", "0.5"], "band of the arm"),
        (["--params.pad-friction", "0.00001"], "no shake of 0.3 mm or more is worth its cost"),
        (["--material", "nowhere.json"], "nowhere.json"),
    ],
)
def test_what_cannot_be_planned_is_said_in_one_line(
    file: Path, options: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["plan", str(file), *WORDS, *options]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1


def test_a_plant_that_buckles_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    skeleton, stem, flowers = branched()
    build_plant(skeleton, stem, flowers, None, TOMATO).save(folder / FILES["plant model"])
    soft = {"kind": "material", "schema": 1} | {name: getattr(TOMATO, name) for name in TOMATO.__dataclass_fields__}
    (folder / "material.json").write_text(json.dumps(soft | {"youngs": 2e4}))
    assert cli.main(["plan", str(folder), *WORDS, "--material", str(folder / "material.json")]) == 2
    error = capsys.readouterr().err
    assert "buckle" in error
    assert error.count("\n") == 1


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["plan", str(tmp_path)]) == 2
    assert "a run folder with 04_skeleton.npz" in capsys.readouterr().err


def test_the_papers_shake_keeps_no_limit_and_says_so(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(Args(file, shake="paper", json=True, params=FAST))
    plan = json.loads(capsys.readouterr().out)
    assert (plan["frequency"], plan["amplitude"]) == pytest.approx((1.9, 0.012))
    assert "No limit of the plant is kept" in plan["reason"]
    assert cli.main(["plan", str(file), *WORDS, "--shake", "paper", "--actuator", "gripper"]) == 2
    assert "band of the vibrating gripper" in capsys.readouterr().err


def test_limits_are_likened_to_the_breeze_of_the_runs_crop(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = []
    for plant in ("tomato", "pepper"):
        (folder / "00_params.json").write_text(json.dumps({"plant": plant}))
        run(Args(folder, frequencies=4, json=True, params=FAST))
        limits = json.loads(capsys.readouterr().out)["limits"]
        said.append({row["name"]: row["as_in_a_breeze_of"] for row in limits}["pedicel bending strain [-]"])
    assert said == ["3.5 m/s", "4.5 m/s"]
    run(Args(folder, frequencies=4, params=FAST))
    assert "4.5 m/s" in capsys.readouterr().out


def test_a_bolder_shake_is_worth_more(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    worth, params = [], replace(FAST, least_amplitude=1e-6)
    for boldness in ("gentle", "default", "bold"):
        run(Args(file, shake=boldness, lowest=6, highest=6, json=True, params=params))
        worth.append(json.loads(capsys.readouterr().out)["score"])
    assert worth[0] < worth[1] < worth[2]
