"""Swings: pieces join without a jump in place, speed or acceleration, and move as they say."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_planner import solve
from test_safety import HERE

from anther.core.errors import InputError, StageFailure
from anther.core.geometry import Array
from anther.robot.arm.planner import Planner
from anther.robot.arm.sawyer import SAWYER
from anther.robot.arm.shaking import swing_trajectory
from anther.robot.swing import Swing, motion, whole_shake

TONES = np.array([2.5, 4.1, 7.3])
SIZES = st.lists(st.floats(0, 0.01), min_size=3, max_size=3)


def pieces(*amplitudes: Any) -> list[Swing]:
    """Return joined pieces of the tones, of different lengths and ramps."""
    done = [Swing.first(TONES, amplitudes[0], 1.13, 0.4)]
    for i, new in enumerate(amplitudes[1:]):
        done.append(done[-1].then(new, 0.71 + 0.1 * i, 0.3 + 0.1 * i))
    return done


def acceleration(piece: Swing, time: float) -> float:
    """Return the change of the rate within the piece about `time`, by differences [m/s2]."""
    inside = np.clip([time - 1e-6, time + 1e-6], 0, piece.seconds)
    return float(np.diff(piece.motion(inside)[1])[0] / np.diff(inside)[0])


@given(SIZES, SIZES, SIZES)
def test_joined_pieces_have_equal_place_speed_and_acceleration(a: Any, b: Any, c: Any) -> None:
    done = pieces(a, b, c)
    for piece, following in zip(done, done[1:], strict=False):
        (end,), (speed,) = piece.motion([piece.seconds])
        (begin,), (start_speed,) = following.motion([0.0])
        assert following.begin == pytest.approx(piece.begin + piece.seconds)
        assert begin == pytest.approx(end, abs=1e-12)
        assert start_speed == pytest.approx(speed, abs=1e-10)
        assert acceleration(following, 0.0) == pytest.approx(acceleration(piece, piece.seconds), abs=2e-2)


@given(SIZES, SIZES)
def test_the_rate_is_the_derivative_of_the_motion(a: Any, b: Any) -> None:
    for piece in pieces(a, b):
        t, h = np.linspace(0.01, piece.seconds - 0.01, 97), 1e-5
        slope = (piece.motion(t + h)[0] - piece.motion(t - h)[0]) / (2 * h)
        assert piece.motion(t)[1] == pytest.approx(slope, abs=1e-5)


@given(SIZES, SIZES)
def test_no_displacement_is_beyond_reach(a: Any, b: Any) -> None:
    for piece in pieces(a, b):
        assert np.abs(piece.motion(np.linspace(0, piece.seconds, 999))[0]).max() <= piece.reach + 1e-12


def test_after_its_ramp_a_piece_is_the_tones_alone_on_the_clock_of_the_whole_shake() -> None:
    second = pieces([0.001, 0.002, 0.0], [0.0, 0.004, 0.003])[1]
    t = np.linspace(second.ramp, second.seconds, 50)
    phase = 2 * np.pi * (second.begin + t)[:, None] * TONES
    assert second.motion(t)[0] == pytest.approx(np.sin(phase) @ [0.0, 0.004, 0.003], abs=1e-12)


def test_the_first_piece_begins_at_rest_and_one_to_nothing_stops() -> None:
    first, second, last = pieces(0.002, [0.0, 0.004, 0.0], 0.0)
    assert np.abs(first.motion([0.0])).max() == 0
    assert acceleration(first, 0.0) == pytest.approx(0, abs=1e-2)
    assert (first.stops, second.stops, last.stops) == (False, False, True)
    assert np.abs(last.motion(np.linspace(last.ramp, last.seconds, 9))).max() < 1e-12
    assert np.abs(last.motion([last.seconds + 5])).max() < 1e-12
    assert np.abs(last.motion([0.02])[0]).max() > 0, "it is not at rest before it has stopped"
    (kept,), _ = second.motion([-1.0])
    assert kept == pytest.approx(second.motion([0.0])[0][0]), "before a piece nothing is known but its begin"


@given(st.floats(1e-3, 0.2), st.floats(1, 30), st.floats(2.5, 5))
def test_a_whole_shake_is_a_sine_between_two_smooth_ends(amplitude: float, frequency: float, duration: float) -> None:
    t = np.linspace(0, duration, 40001)
    both = whole_shake(amplitude, frequency, duration)
    d, rate = motion(both, t)
    omega, ramp = 2 * np.pi * frequency, min(3 / frequency, duration / 2)
    steady = (t > ramp) & (t < duration - ramp)
    np.testing.assert_allclose(d[steady], amplitude * np.sin(omega * t[steady]), rtol=0, atol=1e-9)
    assert np.abs(d).max() <= amplitude * (1 + 1e-9)
    assert np.abs([d[0], d[-1], rate[0] / omega, rate[-1] / omega]).max() < 1e-9 * amplitude
    assert both[-1].stops
    middle = 0.5 * (t[1:] + t[:-1])
    np.testing.assert_allclose(np.diff(d) / np.diff(t), motion(both, middle)[1], atol=2e-3 * omega * amplitude)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frequencies": [0.0, 1.0, 2.0]}, "frequencies > 0"),
        ({"frequencies": []}, "shape|frequencies"),
        ({"frequencies": [1.0, np.nan, 2.0]}, "finite|nan"),
        ({"amplitudes": [0.001, -0.001, 0.0]}, "amplitudes >= 0"),
        ({"before": [0.001, -0.001, 0.0]}, "amplitudes >= 0"),
        ({"before": [0.001, 0.001]}, "shape"),
        ({"seconds": 0.0}, "swing seconds"),
        ({"seconds": 100.0}, "swing seconds"),
        ({"ramp": 0.0}, "swing ramp"),
        ({"ramp": 1.01}, "ramp of a swing"),
        ({"begin": -0.1}, "swing begin"),
    ],
)
def test_bad_swings_are_refused(changes: dict[str, Any], message: str) -> None:
    good: dict[str, Any] = {
        "frequencies": TONES, "amplitudes": np.full(3, 0.001), "seconds": 1.0, "ramp": 0.3, "before": np.zeros(3)
    }  # fmt: skip
    Swing(**good)
    with pytest.raises(InputError, match=message):
        Swing(**(good | changes))


# On the arm.

REST = solve(np.vstack([np.c_[SAWYER.forward(SAWYER.neutral)[:3, :3], HERE], [0, 0, 0, 1]]))
ALONG = np.array([0.0, 0.6, 0.8])


def test_the_flange_moves_as_the_swing_says_and_motions_join() -> None:
    done = pieces([0.001, 0.001, 0.0005], [0.0, 0.004, 0.0], 0.0)
    paths = [swing_trajectory(SAWYER, REST, ALONG, [piece], 0.006) for piece in done]
    for piece, path in zip(done, paths, strict=True):
        T = SAWYER.forward(path.positions)
        away = T[:, :3, 3] - SAWYER.forward(REST)[:3, 3]
        assert away @ ALONG == pytest.approx(piece.motion(path.times)[0], abs=2e-6)
        assert np.linalg.norm(away - np.outer(away @ ALONG, ALONG), axis=1).max() < 1e-5
        assert np.abs(T[:, :3, :3] - T[0, :3, :3]).max() < 1e-4
        assert path.duration == pytest.approx(piece.seconds)
    for path, following in zip(paths, paths[1:], strict=False):
        assert following.positions[0] == pytest.approx(path.positions[-1], abs=1e-9)
        assert following.velocities[0] == pytest.approx(path.velocities[-1], abs=1e-9)
    assert paths[0].positions[0] == pytest.approx(REST, abs=1e-9)
    assert paths[-1].positions[-1] == pytest.approx(REST, abs=1e-9)
    assert np.abs(paths[-1].velocities[-1]).max() < 1e-9


def test_a_piece_beyond_the_reach_of_the_shake_is_refused() -> None:
    piece = Swing.first(TONES, [0.002, 0.002, 0.0], 1.0, 0.4)
    swing_trajectory(SAWYER, REST, ALONG, [piece], 0.004)
    with pytest.raises(InputError, match="displacement of a swing"):
        swing_trajectory(SAWYER, REST, ALONG, [piece], 0.0039)
    with pytest.raises(InputError, match="reach of a swing"):
        swing_trajectory(SAWYER, REST, ALONG, [piece], 0.3)


@pytest.mark.parametrize("side", [-1, 1])
def test_a_swing_is_free_only_if_both_its_ends_are(monkeypatch: pytest.MonkeyPatch, side: int) -> None:
    planner = Planner(np.zeros((0, 3)), np.zeros((0, 3)))
    rest = SAWYER.forward(REST)[:3, 3]
    piece = Swing.first([1.0], [0.02], 2.0, 1.0)

    def up_to_a_wall(way: Array, *_: Any) -> bool:
        return bool(np.all(side * (SAWYER.forward(way)[:, :3, 3] - rest) @ ALONG < 0.015))

    planner.swing(REST, ALONG, [piece], 0.02)
    monkeypatch.setattr(planner.world, "path_free", up_to_a_wall)
    with pytest.raises(StageFailure, match="hits something") as failure:
        planner.swing(REST, ALONG, [piece], 0.02)
    assert failure.value.kind == "collision"
