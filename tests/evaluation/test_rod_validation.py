"""The rod validation: its theory against published numbers, and a quick part of its table."""

# pyright: reportMissingImports=false
from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from evaluation.rods.beam_theory import cone_frequencies, elastica, rayleigh_roots, small_sag, uniform_roots
from evaluation.rods.motion import energy_cases, order_cases
from evaluation.rods.peer_references import reference_cases
from evaluation.rods.statics import static_cases
from evaluation.rods.supports import Spans, mujoco_row
from evaluation.rods.table import Row, metrics, order_row
from evaluation.rods.vibrations import frequency_cases


@pytest.mark.parametrize(("load", "x", "drop"), [(1, 0.94357, 0.30172), (5, 0.61237, 0.71379), (10, 0.44500, 0.81061)])
def test_elastica_agrees_with_the_published_table(load: float, x: float, drop: float) -> None:
    # Mattiasson 1981, Int. J. Numer. Methods Eng. 17, 145: cantilever with a transverse end load
    assert elastica(0, load) == pytest.approx((x, drop), abs=6e-6)


def test_elastica_of_small_loads_is_euler_bernoulli() -> None:
    assert elastica(1e-4, 2e-4)[1] == pytest.approx(small_sag(1e-4, 2e-4), rel=1e-6)


def test_cone_frequencies_agree_with_the_published_table() -> None:
    # Downs 1977, J. Appl. Mech. 44, 737, and the complete cone of Kirchhoff 1879
    np.testing.assert_allclose(cone_frequencies(0.5, 3), [4.62515, 19.5476, 48.5789], rtol=2e-6)
    np.testing.assert_allclose(cone_frequencies(1e-5, 2), [8.7192, 21.146], rtol=1e-4)


def test_roots_of_beams_with_a_tip_mass() -> None:
    np.testing.assert_allclose(uniform_roots(3), [1.8751041, 4.6940911, 7.8547574], rtol=1e-7)
    # a heavy tip: the stiffness 3 EI / L^3 swings the tip and 33 / 140 of the beam (Rayleigh)
    assert uniform_roots(1, 100.0)[0] == pytest.approx((3 / (100 + 33 / 140)) ** 0.25, rel=1e-5)


def test_rotary_inertia_lowers_the_frequencies() -> None:
    np.testing.assert_allclose(rayleigh_roots(3, 1e-5), uniform_roots(3), rtol=1e-9)
    thin = (rayleigh_roots(1, 0.02) / uniform_roots(1))[0] ** 2
    # Rayleigh's quotient: w^2 falls by s times the integral of w'^2 over that of w^2, 4.648 for the first mode
    assert thin == pytest.approx(1 - 0.02**2 / 4 * 4.648 / 2, abs=1e-6)


@pytest.mark.parametrize(
    ("springs", "clamped", "tension", "roots"),
    [
        ([], True, 0.0, uniform_roots(3)),
        ([(1.0, 5.0, 0.0)], True, 0.0, [2.3667781]),  # Blevins: b^3 (1 + cos cosh) = 5 (cos sinh - sin cosh)
        ([(1.0, 1e9, 0.0)], False, 20.0, [(n**4 * np.pi**4 + 20 * n**2 * np.pi**2) ** 0.25 for n in (1, 2)]),
        ([(0.5, 1e9, 0.0), (1.0, 1e9, 0.0)], False, 0.0, [2 * np.pi, 2 * 3.9266023]),
    ],
)
def test_spans_have_the_published_roots(springs, clamped, tension, roots) -> None:
    np.testing.assert_allclose(Spans(springs, clamped, tension).roots(len(roots)), roots, rtol=1e-6)


def test_spans_sag_as_the_textbook_says() -> None:
    assert Spans([], True).receptance(1, 1) == pytest.approx(1 / 3)
    assert Spans([(1.0, 1e9, 0)], False).receptance(0.25, 0.75) == pytest.approx(7 / 768)
    assert Spans([(1.0, 1e9, 0)], True).receptance(0.5, 0.5) == pytest.approx(7 / 768)
    assert Spans([], True, 9.0).receptance(1, 1) == pytest.approx((1 - np.tanh(3) / 3) / 9)


def test_a_string_pulls_as_mujocos_does() -> None:
    assert not mujoco_row().failed


def test_a_row_fails_above_its_limit_or_without_a_number() -> None:
    rows = [Row("a", "", 0.2, 0.1), Row("b", "", float("nan"), 0.1), Row("c", "", 0.05, 0.1), Row("d", "", 9.0, None)]
    assert [row.failed for row in rows] == [True, True, False, False]
    found = metrics(rows)
    assert found["rows_failed"] == 2
    assert found["rows"] == 3
    assert "d_limit" not in found


def test_the_slope_of_the_errors_is_their_order() -> None:
    steps = np.array([0.1, 0.05, 0.025])
    row = order_row("made_order", "", steps, 3 * steps**1.5)
    assert row.error == pytest.approx(0.5)
    assert row.failed


@pytest.mark.parametrize("cases", [static_cases, frequency_cases, energy_cases, order_cases])
def test_a_group_of_cases_computes_its_rows(cases) -> None:
    rows = cases(True)
    assert len({row.case for row in rows}) == len(rows)
    assert all(np.isfinite(row.error) and row.error >= 0 for row in rows)
    assert sum(row.failed for row in rows) < len(rows)


def test_static_rows_are_met() -> None:
    assert not [row.case for row in static_cases(True) if row.failed]


def test_peer_rows_are_met(data: Path) -> None:
    assert not [row.case for row in reference_cases(data / "rod_reference", True) if row.failed]
