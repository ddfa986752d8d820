"""A material test of one stem: density, stiffness and damping with uncertainty, and the material they make (P22).

Every source of error (radius, length, frequency, ...) has a standard error. An estimate keeps by how much its logarithm
changes for one standard error of each source, so that errors shared by two estimates cancel in their difference and do
not average out in their mean.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from anther.core.checks import check_array, check_range
from anther.core.errors import InputError, bad_input
from anther.core.files import read_json, write_json
from anther.core.geometry import Array
from anther.core.records import Range, Record
from anther.plant.bench._clamped_stem import (
    ClampedStem,
    Orientation,
    droop,
    youngs_from_deflection,
    youngs_from_first_mode,
)
from anther.plant.bench._free_vibration import FreeVibration, mean_vibration
from anther.plant.model import TOMATO, Material

SCHEMA = 1
DISAGREEMENT = 2.0
"""Estimates farther apart than so many standard errors of their difference disagree [-]."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """A positive quantity with its error.

    Attributes:
        name: what it rests on.
        value: in SI units.
        shares: change of ln value per standard error of each source of error [-], signed; sources are independent.
    """

    name: str
    value: float
    shares: Mapping[str, float]

    @property
    def relative_error(self) -> float:
        """Standard error of ln value [-]."""
        return float(np.sqrt(sum(share**2 for share in self.shares.values())))

    @property
    def standard_error(self) -> float:
        """Standard error, in the value's units."""
        return self.value * self.relative_error


def propagate(
    name: str, function: Callable[[Mapping[str, float]], float], errors: Mapping[str, float], **own: float
) -> Quantity:
    """Return the estimate function({}) with the errors of its inputs.

    Linearised in the logarithm by central differences one standard error wide (GUM, JCGM 100:2008, 5.1.3 and its note
    on numerical sensitivities), so that moderate curvature is averaged rather than missed.

    Args:
        name: of the estimate.
        function: value for given shifts of the sources; a source not named is not shifted.
        errors: standard error of each source, in the units in which `function` shifts it.
        own: relative standard errors that belong to this estimate alone.
    """
    shares = {}
    for source, error in errors.items():
        if error > 0:
            shares[source] = 0.5 * float(np.log(function({source: error}) / function({source: -error})))
    return Quantity(name, function({}), shares | {k.replace("_", " "): v for k, v in own.items() if v > 0})


def disagreement(a: Quantity, b: Quantity) -> float:
    """Return |ln a - ln b| in standard errors of that difference."""
    sources = a.shares.keys() | b.shares.keys()
    error = np.sqrt(sum((a.shares.get(s, 0.0) - b.shares.get(s, 0.0)) ** 2 for s in sources))
    return float(abs(np.log(a.value / b.value)) / max(error, 1e-12))


def combine(a: Quantity, b: Quantity) -> Quantity:
    """Return the geometric mean of two estimates that has the least variance.

    The weights allow for shared errors and stay within 0 and 1. Where the two disagree, one of them has an unstated
    error: the weights are then equal, and half the distance is added as an error of its own.
    """
    sources = a.shares.keys() | b.shares.keys()
    shared = sum(a.shares.get(s, 0.0) * b.shares.get(s, 0.0) for s in sources)
    spread = a.relative_error**2 + b.relative_error**2 - 2 * shared
    apart = disagreement(a, b) > DISAGREEMENT
    weight = 0.5 if apart or spread < 1e-24 else float(np.clip((b.relative_error**2 - shared) / spread, 0, 1))
    shares = {s: weight * a.shares.get(s, 0.0) + (1 - weight) * b.shares.get(s, 0.0) for s in sorted(sources)}
    if apart:
        shares["disagreement"] = 0.5 * float(abs(np.log(a.value / b.value)))
    value = float(np.exp(weight * np.log(a.value) + (1 - weight) * np.log(b.value)))
    return Quantity(f"{a.name} and {b.name}", value, shares)


@dataclass(frozen=True, slots=True)
class Density:
    """Density of stem samples [kg/m3]: mean, standard deviation between samples, standard error of the mean.

    The two last are NaN for a single sample.
    """

    mean: float
    sd: float
    standard_error: float


def density_from_samples(mass: ArrayLike, radius: ArrayLike, length: ArrayLike) -> Density:
    """Return the density of round stem pieces (P22).

    Args:
        mass: (n,) [kg].
        radius: (n,) [m].
        length: (n,) [m].

    Raises:
        InputError: no samples, different counts, or a value <= 0.
    """
    m = check_array("sample mass", mass, (None,))
    r = check_array("sample radius", radius, (len(m),))
    h = check_array("sample length", length, (len(m),))
    if not len(m) or min(m.min(), r.min(), h.min()) <= 0:
        raise bad_input("stem samples", given=f"{len(m)} samples", allowed="one or more, values > 0", do="Check units.")
    each = m / (np.pi * r**2 * h)
    sd = float(np.std(each, ddof=1)) if len(each) > 1 else float("nan")
    return Density(float(each.mean()), sd, sd / float(np.sqrt(len(each))))


@dataclass(frozen=True, slots=True)
class InstrumentErrors(Record):
    """Standard errors of what is read off instruments. Each is one error for all readings, the cautious assumption.

    Attributes:
        radius: of the calliper on soft tissue, samples and stem alike [m].
        length: of the stem's free length [m].
        leaf_mass: share of every leaf's mass [-].
        tip_mass: share of every tip mass [-].
        deflection: of one reading of the tip's height [m].
    """

    CALLED = "errors."
    radius: Annotated[float, Range(0, 0.01, "m")] = 1e-4
    length: Annotated[float, Range(0, 0.1, "m")] = 1e-3
    leaf_mass: Annotated[float, Range(0, 0.5)] = 0.05
    tip_mass: Annotated[float, Range(0, 0.5)] = 0.01
    deflection: Annotated[float, Range(1e-7, 0.1, "m")] = 5e-4


@dataclass(frozen=True, slots=True, eq=False)
class MaterialTest:
    """What was measured on one stem. n samples, m tip masses.

    Attributes:
        stem: shape and leaves; None where only density was measured.
        orientation: how it was held when plucked.
        sample_mass, sample_radius, sample_length: (n,) cut samples [kg, m, m]; empty where `density` is given.
        density: value and standard error [kg/m3], where no samples were cut.
        plucks: free vibrations of the stem; empty where none was recorded.
        tip_mass, deflection: (m,) deflection test of the stem held horizontal [kg, m]; empty where none was made.
        errors: of the instruments.
    """

    stem: ClampedStem | None
    orientation: Orientation = "weightless"
    sample_mass: Array = field(default_factory=lambda: np.zeros(0))
    sample_radius: Array = field(default_factory=lambda: np.zeros(0))
    sample_length: Array = field(default_factory=lambda: np.zeros(0))
    density: tuple[float, float] | None = None
    plucks: tuple[FreeVibration, ...] = ()
    tip_mass: Array = field(default_factory=lambda: np.zeros(0))
    deflection: Array = field(default_factory=lambda: np.zeros(0))
    errors: InstrumentErrors = InstrumentErrors()

    def density_at(self, shift: Mapping[str, float]) -> float:
        """Return the density [kg/m3] as it is if the sources of error were off by `shift`."""
        if self.density is not None:
            return max(self.density[0] + shift.get("density", 0.0), 10.0)
        radius = np.maximum(self.sample_radius + shift.get("radius", 0.0), 1e-5)
        return density_from_samples(self.sample_mass, radius, self.sample_length).mean + shift.get("density", 0.0)

    def stem_at(self, shift: Mapping[str, float]) -> ClampedStem:
        """Return the stem as it is if the sources of error were off by `shift`."""
        assert self.stem is not None
        return self.stem.changed(
            radius=shift.get("radius", 0.0), length=shift.get("length", 0.0), leaf_mass=shift.get("leaf mass", 0.0)
        )


@dataclass(frozen=True, slots=True, eq=False)
class Identification:
    """What a material test found.

    Attributes:
        samples: of the cut samples, or None.
        density: the density used, with every error [kg/m3].
        vibration: mean of the plucks, or None.
        estimates: of Young's modulus [Pa], one per method.
        youngs: their combination [Pa], or None where there is none.
        material: for `anther.plant.model.build_plant`; what was not measured keeps the prior.
        warnings: what the user should not overlook.
    """

    samples: Density | None
    density: Quantity
    vibration: FreeVibration | None
    estimates: tuple[Quantity, ...]
    youngs: Quantity | None
    material: Material
    warnings: tuple[str, ...]


def identify(test: MaterialTest, prior: Material = TOMATO) -> Identification:
    """Return density, damping and Young's modulus with standard errors, from whatever was measured.

    Errors are propagated linearly in the logarithm (`propagate`); one calliper error is shared by samples and stem, and
    by both estimates of E, so that the comparison of the two is fair. Estimates that differ by more than two standard
    errors of their difference are warned about; the result then lies halfway, its error widened.

    Raises:
        InputError: nothing that gives a density, or a stem and readings that cannot belong together.
    """
    samples, density = _density(test)
    vibration = mean_vibration(test.plucks) if test.plucks else None
    estimates = tuple(e for e in (_from_vibration(test, density, vibration), _from_deflection(test, density)) if e)
    youngs = combine(*estimates) if len(estimates) == 2 else next(iter(estimates), None)
    return Identification(
        samples,
        density,
        vibration,
        estimates,
        youngs,
        _material(prior, density, vibration, youngs),
        tuple(_warnings(test, density, vibration, estimates)),
    )


def _density(test: MaterialTest) -> tuple[Density | None, Quantity]:
    """Return the cut samples', and the density used; a single sample has the spread of the prior as its error."""
    if test.density is not None:
        check_range("density", test.density[0], 10, 5000, "kg/m3")
        return None, propagate("given", test.density_at, {"density": test.density[1]})
    if not len(test.sample_mass):
        raise InputError("density: not given. Give cut samples (mass, radius, length), or a density [kg/m3].")
    samples = density_from_samples(test.sample_mass, test.sample_radius, test.sample_length)
    scatter = samples.standard_error if len(test.sample_mass) > 1 else TOMATO.density_spread * samples.mean
    errors = {"density": scatter, "radius": test.errors.radius}
    return samples, propagate("cut samples", test.density_at, errors)


def _shape_errors(test: MaterialTest, density: Quantity) -> dict[str, float]:
    assert test.stem is not None
    scatter = abs(density.shares.get("density", 0.0)) * density.value
    errors = {"radius": test.errors.radius, "length": test.errors.length, "density": scatter}
    leaves = test.errors.leaf_mass if test.stem.leaf_mass.sum() > 0 else 0.0
    if errors["radius"] >= 0.5 * test.stem.radius.min():
        raise bad_input(
            "errors.radius",
            given=f"{errors['radius']:g} m",
            allowed=f"< {0.5 * test.stem.radius.min():g} m, half the thinnest radius",
            do="Measure the radius better.",
        )
    return errors | {"leaf mass": leaves}


def _from_vibration(test: MaterialTest, density: Quantity, vibration: FreeVibration | None) -> Quantity | None:
    if vibration is None or test.stem is None:
        return None

    def youngs(shift: Mapping[str, float]) -> float:
        frequency = vibration.natural_frequency + shift.get("frequency", 0.0)
        return youngs_from_first_mode(test.stem_at(shift), frequency, test.density_at(shift), test.orientation)

    errors = _shape_errors(test, density) | {"frequency": vibration.frequency_error}
    return propagate("vibration", youngs, errors)


def _from_deflection(test: MaterialTest, density: Quantity) -> Quantity | None:
    if not len(test.tip_mass) or test.stem is None:
        return None

    def youngs(shift: Mapping[str, float]) -> float:
        mass = test.tip_mass * (1 + shift.get("tip mass", 0.0))
        return youngs_from_deflection(test.stem_at(shift), mass, test.deflection, test.density_at(shift))[0]

    reading = youngs_from_deflection(
        test.stem, test.tip_mass, test.deflection, density.value, reading_error=test.errors.deflection
    )[1]
    errors = _shape_errors(test, density) | {"tip mass": test.errors.tip_mass}
    return propagate("deflection", youngs, errors, deflection=reading)


def _material(prior: Material, density: Quantity, vibration: FreeVibration | None, youngs: Quantity | None) -> Material:
    """Return the prior with what was measured in its place."""
    found = replace(prior, density=density.value, density_spread=min(density.relative_error, 3.0))
    if youngs is not None:
        found = replace(found, youngs=youngs.value, youngs_spread=min(youngs.relative_error, 3.0))
    if vibration is not None and 1e-4 <= vibration.damping_ratio <= 1:
        spread = min(vibration.damping_error / vibration.damping_ratio, 3.0)
        found = replace(found, damping_ratio=vibration.damping_ratio, damping_spread=spread)
    return found


def _warnings(
    test: MaterialTest, density: Quantity, vibration: FreeVibration | None, estimates: tuple[Quantity, ...]
) -> list[str]:
    warnings = []
    if len(estimates) == 2 and (apart := disagreement(*estimates)) > DISAGREEMENT:
        each = ", ".join(f"{e.value / 1e6:.3g} MPa from {e.name}" for e in estimates)
        warnings.append(
            f"the estimates of E disagree: {each}, {apart:.1f} standard errors apart. Leaves left out, the wrong "
            "orientation, a clamp that gives, or too few radii are the usual causes. The result lies halfway, half the "
            "distance being one more error."
        )
    if vibration is not None and vibration.explained < 0.7:
        warnings.append(
            f"the fit explains only {vibration.explained:.0%} of a trace: it is not one decaying oscillation. Cut off "
            "what lies before the release (--start), or pluck more gently."
        )
    if vibration is not None and vibration.damping_ratio < 1e-4 and np.isfinite(vibration.damping_error):
        warnings.append(f"damping ratio {vibration.damping_ratio:.2g}: no decay was seen; the prior's damping is kept.")
    if test.stem is not None and vibration is not None and test.orientation == "weightless":
        warnings.append(
            "gravity is left out, as beam formulas do; it slows an upright stem and hastens a hanging one. Say how the "
            "stem was held (--orientation)."
        )
    horizontal = test.orientation == "horizontal" or len(test.tip_mass) > 0
    if test.stem is not None and estimates and horizontal:
        sag = droop(test.stem, estimates[-1].value, density.value)
        if sag > 0.2:
            warnings.append(
                f"held horizontal, the stem's tip hangs {sag:.0%} of its length low; its shape without weight is taken "
                "as straight. Cut it shorter or take leaves off for a better test."
            )
    return warnings


def write_material(path: Path | str, material: Material) -> None:
    """Write a material as JSON (kind 'material')."""
    write_json(path, {"kind": "material", "schema": SCHEMA} | asdict(material))


def read_material(path: Path | str) -> Material:
    """Read what `write_material` wrote.

    Raises:
        InputError: missing, of another kind or schema, or with values out of range.
    """
    stored = read_json(path)
    if not isinstance(stored, dict) or (stored.get("kind"), stored.get("schema")) != ("material", SCHEMA):
        raise bad_input(str(path), given="something else", allowed=f"a material, schema {SCHEMA}", do="Run identify.")
    values: dict[str, float] = {}
    for name in Material.__dataclass_fields__:
        value = stored.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise bad_input(f"{path}: {name}", given=value, allowed="a number", do="Run anther identify again.")
        values[name] = float(value)
    return Material(**values)
