"""`anther plan --simulate`: the flower's motion from a skeleton file, and its refusals."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anther.cli import plan, plan_simulation
from anther.cli.args.plan import Args, Rods, Simulation
from anther.core.errors import InputError, StageFailure
from anther.perception.formats.skeletons import write_skeleton
from anther.perception.skeleton import Skeleton
from anther.rods import Trajectory


@pytest.fixture
def file(tmp_path: Path) -> Path:
    nodes = np.zeros((14, 3))
    nodes[:10, 2] = np.linspace(0, 0.27, 10)
    nodes[10:] = nodes[6] + np.outer(np.arange(1, 5), [0.015, 0.005, 0.015])
    parent = np.array([-1, *range(9), 6, 10, 11, 12])
    write_skeleton(tmp_path / "plant.swc", Skeleton(nodes, parent, np.linspace(4e-3, 2e-3, 14)))
    return tmp_path / "plant.swc"


def shake(file: Path, **change: Any) -> None:
    """Simulate a shake of the edges alone, with the options of all groups in one."""
    change = {"youngs": 1e8, "bare": True, "bend_over_twist": 1.5, "density": 1100.0} | change
    groups = {name: kind(**{f.name: change.pop(f.name) for f in fields(kind) if f.name in change})
              for name, kind in (("rods", Rods), ("simulation", Simulation))}  # fmt: skip
    plan.run(Args(file, simulate=True, **groups, **change))


def test_vibration_measures_a_sine():
    t = np.arange(0, 5, 0.001)
    amplitude, frequency = plan_simulation.vibration(3e-3 * np.sin(2 * np.pi * 1.3 * t) + 0.1 * t + 2, 0.001)
    assert amplitude == pytest.approx(3e-3, rel=0.05)
    assert frequency == pytest.approx(1.3, rel=0.02)


def test_shake_prints_and_writes(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    args: dict[str, Any] = {"grip": 5, "flower": (14,), "amplitude": 2e-3, "frequency": 4.0, "duration": 1.5}
    shake(file, **args, out=tmp_path / "o", json=True)
    motion = json.loads(capsys.readouterr().out)
    assert motion["flower_frequency_hz"] == pytest.approx(4.0, rel=0.05)
    assert motion["grip_amplitude_m"] == pytest.approx(2e-3, rel=0.1)
    assert motion["amplitude_ratio"] == pytest.approx(motion["flower_amplitude_m"] / 2e-3)
    assert {f.name for f in (tmp_path / "o").iterdir()} == {"trajectory.npz", "shake.json", "shake.png"}
    run = Trajectory.load(tmp_path / "o" / "trajectory.npz")
    assert run.positions.shape == (1501, 14, 3)
    assert np.ptp(run.positions[:, 4, 0]) == pytest.approx(4e-3, rel=0.01)
    shake(file, **args)
    assert "flower at node 14" in capsys.readouterr().out


def shaken(file: Path, capsys: pytest.CaptureFixture[str], **change) -> dict[str, float]:
    shake(file, grip=5, flower=(14,), duration=1.5, dt=0.002, json=True, **change)
    return json.loads(capsys.readouterr().out)


def test_a_chirp_sweeps_through_what_a_sine_asks_one_by_one(file: Path, tmp_path: Path, capsys):
    both = {"frequency": 2.0, "end_frequency": 14.0, "amplitude": 1e-3, "out": tmp_path}
    shaken(file, capsys, waveform="chirp", **both)
    run = Trajectory.load(tmp_path / "trajectory.npz")
    grip = run.displacement(4)[:, 0]
    crossings = np.flatnonzero(np.diff(np.sign(grip[1:])) != 0)
    assert len(crossings) == pytest.approx(2 * (2 + 14) / 2 * 1.5, abs=2)
    assert run.times[crossings[0]] == pytest.approx((np.sqrt(12) - 2) / 8, abs=0.004), "half a period at 2 + 8 t Hz"
    assert np.diff(run.times[crossings[-3:]]).mean() == pytest.approx(1 / 28, rel=0.05), "half a period at 14 Hz"
    assert np.abs(grip).max() == pytest.approx(1e-3, rel=0.02)


def test_bursts_leave_the_grip_at_rest_between_them(file: Path, tmp_path: Path, capsys):
    shaken(file, capsys, waveform="burst", frequency=10.0, cycles=4, pause=0.3, out=tmp_path)
    run = Trajectory.load(tmp_path / "trajectory.npz")
    grip = np.abs(run.displacement(4)[:, 0])
    phase = run.times % 0.7
    assert grip[(phase > 0.41) & (phase < 0.69)].max() < 1e-9
    assert grip[phase < 0.4].max() > 3e-3


def test_pads_hold_the_direction_and_take_a_moment(file: Path, capsys):
    free = shaken(file, capsys, frequency=4.0)
    held = shaken(file, capsys, frequency=4.0, pads=0.03)
    assert free["grip_moment_peak_nm"] == 0
    assert held["grip_moment_peak_nm"] > 1e-4
    assert held["flower_amplitude_m"] != pytest.approx(free["flower_amplitude_m"], rel=0.05)


def test_twist_can_be_left_out(file: Path, capsys):
    """The branch leaves the stem sideways, so that its weight twists the stem where that is soft."""
    off = shaken(file, capsys, frequency=8.0, axis="y", bend_over_twist=0.0)
    on = shaken(file, capsys, frequency=8.0, axis="y", bend_over_twist=12.0)
    assert off["first_frequency_hz"] >= on["first_frequency_hz"]
    assert off["flower_amplitude_m"] != pytest.approx(on["flower_amplitude_m"], rel=0.02)


def test_the_papers_tomato_buckles_with_the_papers_numbers(data: Path):
    with pytest.raises(StageFailure, match="would stand from E"):
        shake(data / "skeletons" / "tomato2.txt", grip=27, flower=(73,), radius=3e-3, youngs=21.6e6)


def test_the_papers_tomato_shakes_when_it_can_stand(data: Path, capsys: pytest.CaptureFixture[str]):
    file = data / "skeletons" / "tomato2.txt"
    shake(file, grip=27, flower=(73,), radius=5e-3, youngs=300e6, duration=2.0, dt=0.005, json=True)
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
        ({"waveform": "chirp", "end_frequency": 0.0}, "end_frequency"),
        ({"waveform": "burst", "cycles": 0}, "cycles"),
        ({"ramp": -1.0}, "ramp"),
        ({"bend_over_twist": -1.0}, "bend_over_twist"),
        ({"damping_ratio": -0.1}, "damping_ratio"),
    ],
)
def test_bad_options_are_refused(file: Path, change: dict, message: str):
    with pytest.raises(InputError, match=message):
        shake(file, **({"grip": 5, "flower": (14,)} | change))
