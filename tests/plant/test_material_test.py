"""Material tests: stiffness from frequency and deflection, orientation, leaves, taper, and honest uncertainty."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_stem import Truth, sine_trace

from anther.core.errors import InputError
from anther.plant.bench import (
    ClampedStem,
    FreeVibration,
    Identification,
    InstrumentErrors,
    MaterialTest,
    Orientation,
    Quantity,
    combine,
    disagreement,
    first_frequency,
    fit_free_vibration,
    fitted_motion,
    identify,
    mean_vibration,
    propagate,
    read_material,
    tip_deflections,
    write_material,
    youngs_from_deflection,
    youngs_from_first_mode,
)
from anther.plant.bench._clamped_stem import tip_compliance
from anther.plant.model import TOMATO

NONE = np.zeros(0)
EXACT = InstrumentErrors(radius=0, length=0, leaf_mass=0, tip_mass=0, deflection=1e-6)


def of_stem(stem: ClampedStem, **changes) -> MaterialTest:
    return MaterialTest(stem, **({"orientation": "upright", "density": (1080.0, 10.0)} | changes))


def pluck(frequency: float, error: float = 0.005) -> FreeVibration:
    return FreeVibration(frequency, 0.0, error, np.inf)


# -- the stem ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("tip_mass", "root"), [(0.0, 1.8751041), (5e-3, 1.3966975), (20e-3, 1.0531618)])
def test_without_gravity_a_uniform_stem_obeys_the_closed_formula(tip_mass: float, root: float) -> None:
    """1 + cos b cosh b + M / (rho A L) b (cos b sinh b - sin b cosh b) = 0, E = w^2 rho A L^4 / (b^4 I)."""
    length, radius, density, hertz = 0.292, 3e-3, 1100.0, 1.38
    line = density * np.pi * radius**2
    loaded = tip_mass / (line * length) * (np.cos(root) * np.sinh(root) - np.sin(root) * np.cosh(root))
    assert 1 + np.cos(root) * np.cosh(root) + root * loaded == pytest.approx(0, abs=2e-3)
    youngs = (2 * np.pi * hertz) ** 2 * line * length**4 / (root**4 * np.pi * radius**4 / 4)
    found = youngs_from_first_mode(ClampedStem.uniform(length, radius, tip_mass), hertz, density, "weightless")
    assert found == pytest.approx(youngs, rel=2e-3)


def test_an_upright_stem_that_hardly_swings_is_at_greenhills_limit() -> None:
    """Greenhill 1881: a uniform column of its own weight buckles at rho A g L^3 = 7.8373 E I."""
    length, radius, density = 0.3, 3e-3, 1100
    found = youngs_from_first_mode(ClampedStem.uniform(length, radius), 0.03, density, "upright")
    assert found == pytest.approx(density * 9.81 * length**3 * 4 / (7.8373 * radius**2), rel=5e-3)


def test_a_hanging_stem_without_stiffness_swings_like_a_chain() -> None:
    """Daniel Bernoulli: f = 2.4048 / (4 pi) sqrt(g / L); nothing that hangs can swing slower."""
    length = 0.3
    chain = 2.4048 / (4 * np.pi) * np.sqrt(9.81 / length)
    stem = ClampedStem.uniform(length, 3e-4)
    assert first_frequency(stem, 1e6, 1100, "hanging") == pytest.approx(chain, rel=0.015)
    with pytest.raises(InputError, match="gravity alone swings this stem, hanging"):
        youngs_from_first_mode(stem, 0.98 * chain, 1100, "hanging")


@settings(max_examples=6)
@given(st.floats(40e6, 1e9), st.floats(0, 3e-3), st.sampled_from(["upright", "horizontal", "hanging"]))
def test_stiffness_comes_back_from_the_frequency(youngs: float, tip_mass: float, held) -> None:
    stem = ClampedStem.uniform(0.25, 3e-3, tip_mass)
    frequency = first_frequency(stem, youngs, 1050, held)
    assert youngs_from_first_mode(stem, frequency, 1050, held) == pytest.approx(youngs, rel=1e-5)


def test_gravity_slows_an_upright_stem_and_hastens_a_hanging_one() -> None:
    held = ("hanging", "weightless", "upright")
    stems = [ClampedStem.uniform(0.292, 3e-3, mass) for mass in (0, 5e-3, 10e-3)]
    found = [[youngs_from_first_mode(stem, 1.38, 1100, how) for how in held] for stem in stems]
    assert np.all(np.diff(found, axis=0) > 0)
    assert np.all(np.diff(found, axis=1) > 0)


def test_the_usual_number_of_edges_is_enough() -> None:
    stem = Truth().stem
    coarse, fine = (first_frequency(replace(stem, edges=n), 9e7, 1080, "upright") for n in (stem.edges, 400))
    assert coarse == pytest.approx(fine, rel=1e-3)


def test_a_tapered_leafy_stem_is_found_from_its_frequency() -> None:
    truth = Truth()
    frequency = first_frequency(truth.stem, truth.youngs, truth.density, "upright")
    found = identify(of_stem(truth.stem, plucks=(pluck(frequency),)))
    assert found.estimates[0].value == pytest.approx(truth.youngs, rel=1e-4)


@given(st.floats(1.0, 4.0), st.floats(0.05, 1.0))
def test_small_deflection_of_a_cone_is_the_handbooks(taper: float, length: float) -> None:
    """A tip force on a round cantilever of radius r0 to r1: 4 F L^3 / (3 pi E r0^3 r1)."""
    thin = 2e-3
    stem = ClampedStem(np.array([0, length]), np.array([taper * thin, thin]), length, NONE, NONE)
    assert tip_compliance(stem) == pytest.approx(4 * length**3 / (3 * np.pi * (taper * thin) ** 3 * thin), rel=1e-4)


def test_small_deflections_are_euler_bernoullis_and_large_ones_are_not() -> None:
    stem, youngs = Truth().stem, 2e9
    small, large = (tip_deflections(stem, youngs, 1080, [m]) for m in (1e-3, 1.5))
    by_theory = 9.81 * tip_compliance(stem)
    assert by_theory * 1e-3 / small[0] == pytest.approx(youngs, rel=3e-3)
    assert by_theory * 1.5 / large[0] > 1.3 * youngs
    assert youngs_from_deflection(stem, [1.5], large, 1080)[0] == pytest.approx(youngs, rel=1e-5)


def test_impossible_deflections_are_refused() -> None:
    stem = Truth().stem
    for mass, sunk in (([], []), ([0.01], [-0.01]), ([0.01], [0.4]), ([0.01, 0.02], [0.01])):
        with pytest.raises(InputError):
            youngs_from_deflection(stem, mass, sunk, 1080)
    with pytest.raises(InputError, match="own weight"):
        youngs_from_deflection(ClampedStem.uniform(0.2, 0.03), [0.015], [0.045], 1080)


# -- free vibrations --------------------------------------------------------------------------------------------------


def test_noise_near_the_frequency_widens_the_errors_as_it_should() -> None:
    rng, fits = np.random.default_rng(5), []
    for _ in range(30):
        t, clean = sine_trace(1.4, 0.04, rng, noise=0.0, seconds=8)
        white = np.fft.rfft(rng.normal(0, 1.0, len(t)))
        white[np.abs(np.fft.rfftfreq(len(t), 0.02) - 1.4) > 0.6] = 0  # only noise that looks like the mode
        fits.append(fit_free_vibration(t, clean + 1.5e-3 * np.fft.irfft(white, len(t))))
    for value, error in (("frequency", "frequency_error"), ("damping_ratio", "damping_error")):
        scatter = np.std([getattr(fit, value) for fit in fits])
        assert 0.6 < np.mean([getattr(fit, error) for fit in fits]) / scatter < 2.5


def test_the_fit_is_the_motion_and_says_what_it_explains() -> None:
    t, x = sine_trace(1.4, 0.03, np.random.default_rng(0), noise=1e-4)
    fit = fit_free_vibration(t, x)
    assert fit.explained > 0.99
    assert np.std(fitted_motion(fit, t, x) - x) < 1.2e-4
    assert fit.natural_frequency == pytest.approx(1.4, abs=4 * fit.frequency_error)
    noisy = fit_free_vibration(t, np.random.default_rng(1).normal(0, 1, len(t)))
    assert noisy.explained < 0.5


def test_plucks_that_scatter_more_than_they_promise_have_a_wider_error() -> None:
    one = FreeVibration(1.40, 0.040, 1e-3, 1e-3)
    same = mean_vibration([one] * 4)
    assert same.frequency == pytest.approx(1.40)
    assert same.frequency_error == pytest.approx(1e-3 / 2)
    apart = mean_vibration([one, replace(one, frequency=1.42)])
    assert apart.frequency == pytest.approx(1.41)
    assert apart.frequency_error == pytest.approx(0.01)  # sd of the two over root 2
    assert mean_vibration([one]) == one


# -- uncertainty ------------------------------------------------------------------------------------------------------


@given(st.floats(-4, 4), st.floats(0.001, 0.05))
def test_a_power_law_propagates_exactly(power: float, error: float) -> None:
    found = propagate("law", lambda s: (1 + s.get("x", 0.0)) ** power, {"x": error, "unused": 0.0}, own_part=0.03)
    expected = np.hypot(power * np.arctanh(error), 0.03)
    assert found.relative_error == pytest.approx(expected)
    assert found.standard_error == pytest.approx(expected * found.value)


shares = st.floats(-0.3, 0.3)


@given(st.floats(0.5, 2), shares, shares, shares, shares)
def test_combining_never_extrapolates_and_never_loses(
    ratio: float, r1: float, r2: float, own1: float, own2: float
) -> None:
    a = Quantity("a", 1e8, {"radius": r1, "one": own1})
    b = Quantity("b", ratio * 1e8, {"radius": r2, "two": own2})
    both, swapped = combine(a, b), combine(b, a)
    assert min(a.value, b.value) * (1 - 1e-9) <= both.value <= max(a.value, b.value) * (1 + 1e-9)
    assert both.value == pytest.approx(swapped.value, rel=1e-6)
    if disagreement(a, b) <= 2:
        assert both.relative_error <= min(a.relative_error, b.relative_error) * (1 + 1e-9) + 1e-12
    else:
        assert both.relative_error >= abs(np.log(ratio)) / 2 * (1 - 1e-9)


def test_a_shared_error_neither_averages_out_nor_excuses_a_difference() -> None:
    a = Quantity("a", 1.0e8, {"radius": 0.2, "frequency": 0.01})
    b = Quantity("b", 1.1e8, {"radius": 0.2, "deflection": 0.01})
    assert disagreement(a, b) == pytest.approx(np.log(1.1) / np.hypot(0.01, 0.01))
    assert combine(a, replace(b, value=1.01e8)).relative_error > 0.2


@pytest.mark.parametrize(("held", "draws"), [("weightless", 150), pytest.param("upright", 150, marks=pytest.mark.slow)])
def test_linearised_errors_are_those_of_monte_carlo(held, draws: int) -> None:
    stem = replace(Truth().stem, edges=8)
    errors = InstrumentErrors(radius=2e-4, length=3e-3, leaf_mass=0.1)
    frequency = first_frequency(stem, 9e7, 1080, held)
    test = of_stem(stem, orientation=held, plucks=(pluck(frequency, 0.05),), density=(1080, 40), errors=errors)
    found = identify(test).estimates[0]
    drawn = []
    for z in np.random.default_rng(0).normal(size=(draws, 5)):
        wrong = stem.changed(radius=2e-4 * z[0], length=3e-3 * z[1], leaf_mass=0.1 * z[2])
        drawn.append(np.log(youngs_from_first_mode(wrong, frequency + 0.05 * z[3], 1080 + 40 * z[4], held)))
    assert found.relative_error == pytest.approx(np.std(drawn), rel=0.15)
    assert np.log(found.value) == pytest.approx(np.mean(drawn), abs=0.25 * found.relative_error)


def simulated_test(rng: np.random.Generator, held: Orientation, *, deflection: bool) -> MaterialTest:
    """A test with instruments that are wrong by as much as they are said to be."""
    truth, errors = Truth(), InstrumentErrors()
    stem = replace(truth.stem, edges=10)
    frequency = first_frequency(stem, truth.youngs, truth.density, held)
    t, x = sine_trace(frequency, truth.damping_ratio, rng, noise=1e-3)
    load = np.array([4e-3, 8e-3, 12e-3]) if deflection else NONE
    sunk = tip_deflections(stem, truth.youngs, truth.density, load) + rng.normal(0, errors.deflection, len(load))
    slip, lead, balance, weights = rng.normal(size=4)
    radius, length = rng.uniform(3e-3, 5e-3, 8), rng.uniform(0.02, 0.05, 8)
    return MaterialTest(
        stem=stem.changed(
            radius=errors.radius * slip, length=errors.length * lead, leaf_mass=errors.leaf_mass * balance
        ),
        orientation=held,
        sample_mass=rng.normal(truth.density, 30, 8) * np.pi * radius**2 * length,
        sample_radius=radius + errors.radius * slip,
        sample_length=length,
        density=None,
        plucks=(fit_free_vibration(t, x),),
        tip_mass=load * (1 + errors.tip_mass * weights),
        deflection=sunk,
    )


def misses(found: Identification) -> list[float]:
    """How many standard errors density, damping and every E are off."""
    truth = Truth()
    assert found.youngs is not None
    assert found.vibration is not None
    return [
        np.log(found.density.value / truth.density) / found.density.relative_error,
        (found.vibration.damping_ratio - truth.damping_ratio) / found.vibration.damping_error,
        *(np.log(e.value / truth.youngs) / e.relative_error for e in (*found.estimates, found.youngs)),
    ]


@pytest.mark.slow
@pytest.mark.long
def test_the_truth_lies_within_the_stated_errors_as_often_as_it_should() -> None:
    """40 simulated tests: misses in standard errors have about unit spread, and few exceed two."""
    rng = np.random.default_rng(0)
    found = [identify(simulated_test(rng, "weightless", deflection=False)) for _ in range(40)]
    off = np.array([misses(one) for one in found])
    spread = np.sqrt(np.mean(off**2, axis=0))
    assert np.all((spread > 0.7) & (spread < 1.3)), spread  # 2.7 sigma of the spread of 40
    assert np.mean(np.abs(off) < 2) > 0.88


@pytest.mark.slow
@pytest.mark.long
def test_both_estimates_cover_the_truth_and_agree() -> None:
    rng = np.random.default_rng(1)
    found = [identify(simulated_test(rng, "upright", deflection=True)) for _ in range(50)]
    off = np.array([misses(one) for one in found])
    spread = np.sqrt(np.mean(off**2, axis=0))
    assert np.all((spread > 0.75) & (spread < 1.25)), spread  # 2.5 sigma of the spread of 50
    assert np.all(np.mean(np.abs(off) < 1, axis=0) > 0.54)
    assert np.all(np.mean(np.abs(off) < 2, axis=0) > 0.88)
    assert np.mean([bool(one.warnings) for one in found]) < 0.12


# -- the verdict ------------------------------------------------------------------------------------------------------


def test_forgotten_leaves_are_noticed() -> None:
    truth = Truth()
    bare = replace(truth.stem, leaf_distance=NONE, leaf_mass=NONE)
    frequency = first_frequency(truth.stem, truth.youngs, truth.density, "upright")
    load = np.array([5e-3, 10e-3])
    sunk = tip_deflections(truth.stem, truth.youngs, truth.density, load)
    stated = identify(of_stem(truth.stem, plucks=(pluck(frequency),), tip_mass=load, deflection=sunk))
    forgot = identify(of_stem(bare, plucks=(pluck(frequency),), tip_mass=load, deflection=sunk))
    assert not stated.warnings
    assert "disagree" in forgot.warnings[0]
    assert forgot.material.youngs_spread > 2 * stated.material.youngs_spread
    assert abs(np.log(forgot.material.youngs / truth.youngs)) < 2 * forgot.material.youngs_spread


def test_the_material_holds_what_was_measured_and_the_prior_elsewhere(tmp_path) -> None:
    truth = Truth()
    frequency = first_frequency(truth.stem, truth.youngs, truth.density, "hanging")
    only_frequency = identify(of_stem(truth.stem, orientation="hanging", plucks=(pluck(frequency),), errors=EXACT))
    m = only_frequency.material
    assert m.youngs == pytest.approx(truth.youngs, rel=1e-4)
    assert (m.density, m.density_spread) == (1080.0, pytest.approx(10 / 1080, rel=1e-3))
    assert (m.damping_ratio, m.bend_over_twist) == (TOMATO.damping_ratio, TOMATO.bend_over_twist)
    damped = FreeVibration(frequency, 0.06, 0.01, 0.006)
    m = identify(of_stem(truth.stem, orientation="hanging", plucks=(damped,))).material
    assert (m.damping_ratio, m.damping_spread) == (0.06, pytest.approx(0.1))
    write_material(tmp_path / "material.json", m)
    assert read_material(tmp_path / "material.json") == m
    alone = identify(MaterialTest(None, density=(1000.0, 20.0)))
    assert (alone.youngs, alone.material.youngs, alone.material.density) == (None, TOMATO.youngs, 1000.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [("{}", "allowed: a material"), ("[1]", "allowed: a material"), ("{", "not JSON")],
)
def test_files_that_hold_no_material_are_refused(tmp_path, text: str, message: str) -> None:
    path = tmp_path / "material.json"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_material(path)
    write_material(path, TOMATO)
    path.write_text(path.read_text().replace("100000000.0", '"soft"'))
    with pytest.raises(InputError, match="youngs: got soft"):
        read_material(path)


def test_what_cannot_be_is_refused() -> None:
    truth = Truth()
    with pytest.raises(InputError, match="density: not given"):
        identify(of_stem(truth.stem, density=None, plucks=(pluck(4.0),)))
    with pytest.raises(InputError, match=r"errors.radius"):
        identify(of_stem(truth.stem, plucks=(pluck(4.0),), errors=InstrumentErrors(radius=2e-3)))
    with pytest.raises(InputError, match=r"errors.leaf_mass"):
        InstrumentErrors(leaf_mass=-1)
    for wrong in ({"length": 0.0}, {"radius": np.array([3e-3, np.nan, 1e-3, 1e-3])}, {"leaf_mass": np.full(5, -1.0)}):
        with pytest.raises(InputError):
            replace(truth.stem, **wrong)
    with pytest.raises(InputError, match="increasing"):
        replace(truth.stem, distance=np.zeros(4))
