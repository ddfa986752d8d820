"""`anther shake`: the flower's motion from a skeleton file, and its refusals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from anther.commands import shake
from anther.elastic_rod import Trajectory
from anther.errors import InputError, StageFailure
from anther.formats.skeletons import write_skeleton
from anther.skeleton import Skeleton


@pytest.fixture
def file(tmp_path: Path) -> Path:
    nodes = np.zeros((14, 3))
    nodes[:10, 2] = np.linspace(0, 0.27, 10)
    nodes[10:] = nodes[6] + np.outer(np.arange(1, 5), [0.015, 0.005, 0.015])
    parent = np.array([-1, *range(9), 6, 10, 11, 12])
    write_skeleton(tmp_path / "plant.swc", Skeleton(nodes, parent, np.linspace(4e-3, 2e-3, 14)))
    return tmp_path / "plant.swc"


def test_vibration_measures_a_sine():
    t = np.arange(0, 5, 0.001)
    amplitude, frequency = shake.vibration(3e-3 * np.sin(2 * np.pi * 1.3 * t) + 0.1 * t + 2, 0.001)
    assert amplitude == pytest.approx(3e-3, rel=0.05)
    assert frequency == pytest.approx(1.3, rel=0.02)


def test_shake_prints_and_writes(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    args = shake.Args(
        file, grip=5, flower=14, amplitude=2e-3, frequency=4.0, duration=1.5, out=tmp_path / "o", json=True
    )
    shake.run(args)
    motion = json.loads(capsys.readouterr().out)
    assert motion["flower_frequency_hz"] == pytest.approx(4.0, rel=0.05)
    assert motion["grip_amplitude_m"] == pytest.approx(2e-3, rel=0.1)
    assert motion["amplitude_ratio"] == pytest.approx(motion["flower_amplitude_m"] / 2e-3)
    assert {f.name for f in (tmp_path / "o").iterdir()} == {"trajectory.npz", "shake.json", "shake.png"}
    run = Trajectory.load(tmp_path / "o" / "trajectory.npz")
    assert run.positions.shape == (1501, 14, 3)
    assert np.ptp(run.positions[:, 4, 0]) == pytest.approx(4e-3, rel=0.01)
    shake.run(replace(args, json=False, out=None))
    assert "flower node 14" in capsys.readouterr().out


def test_the_papers_tomato_buckles_with_the_papers_numbers(data: Path):
    args = shake.Args(data / "skeletons" / "tomato2.txt", grip=27, flower=73, radius=3e-3, youngs=21.6e6)
    with pytest.raises(StageFailure, match="would stand from E"):
        shake.run(args)


def test_the_papers_tomato_shakes_when_it_can_stand(data: Path, capsys: pytest.CaptureFixture[str]):
    file = data / "skeletons" / "tomato2.txt"
    shake.run(shake.Args(file, grip=27, flower=73, radius=5e-3, youngs=300e6, duration=2.0, dt=0.005, json=True))
    motion = json.loads(capsys.readouterr().out)
    assert motion["flower_frequency_hz"] == pytest.approx(1.3, abs=0.15)
    assert 1e-3 < motion["flower_amplitude_m"] < 2e-2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"grip": 99}, "node number"),
        ({"grip": 1}, "not clamped"),
        ({"radius": -1.0}, "radius"),
        ({"youngs": float("nan")}, "youngs"),
        ({"density": 0.0}, "density"),
        ({"frequency": 0.0}, "frequency"),
        ({"dt": 0.0}, "time step"),
        ({"damping_ratio": -0.1}, "damping_ratio"),
    ],
)
def test_bad_options_are_refused(file: Path, change: dict, message: str):
    with pytest.raises(InputError, match=message):
        shake.run(replace(shake.Args(file, grip=5, flower=14), **change))
