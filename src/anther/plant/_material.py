"""Material: what a plant is made of, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

from anther.core.choices import Crop
from anther.core.records import Range, Record, Spread


@dataclass(frozen=True, slots=True)
class Material(Record):
    """What a plant is made of: best guess and spread. A spread is the standard deviation of the natural logarithm.

    The spread of E holds at the estimated radius: it is that of the bending stiffness E r^4. The spread of the radius
    holds at that stiffness, so another radius comes with E / scale^4 and changes mass and strain alone. Motion
    determines E r^4 and hardly r, so what is learned of the two is independent only in this form.

    Attributes:
        youngs: Young's modulus of stem and branches [Pa].
        density: of their tissue [kg/m3].
        damping_ratio: share of critical damping of a mode, the same at every frequency (hysteretic), leaves included.
        bend_over_twist: EI / GJ [-]; 1.5 for a round isotropic bar that keeps its volume, larger is softer in twist.
        youngs_spread, density_spread, damping_spread, twist_spread: their spreads [-].
        radius_scale: true over scanned radius of stem and branches [-].
        radius_spread: its spread [-]: by how much the skeleton's radii are off, 4-5 % (docs/reports/skeletons.md).
        response_gain: true over modelled motion of the flowers relative to the pads, for the plant as a whole: what the
            model gets wrong whatever the material [-]. Far below resonance nothing moves relative to the pads.
        response_spread: its spread [-]; measured by us on 16 simulated plants that were scanned: ln(true/modelled) at
            3-10 Hz has 0.3-0.7 between plants, of which the spreads above explain 0.4-0.5.
    """

    youngs: Annotated[float, Range(1e4, 1e12, "Pa")] = 100e6
    density: Annotated[float, Range(10, 5000, "kg/m3")] = 1050.0
    damping_ratio: Annotated[float, Range(1e-4, 1)] = 0.05
    bend_over_twist: Annotated[float, Range(0.1, 1000)] = 12.0
    youngs_spread: Spread = 0.66
    density_spread: Spread = 0.05
    damping_spread: Spread = 0.35
    twist_spread: Spread = 0.5
    radius_scale: Annotated[float, Range(0.2, 5)] = 1.0
    radius_spread: Spread = 0.05
    response_gain: Annotated[float, Range(1e-3, 1e3)] = 1.0
    response_spread: Spread = 0.3

    @property
    def scanned_youngs(self) -> float:
        """Young's modulus that gives the scanned radius the same bending stiffness [Pa]."""
        return self.youngs * self.radius_scale**4

    def changed(self, *, scanned_youngs: float | None = None, **values: float) -> Material:
        """Return the material with other values; its bending stiffness stays unless `scanned_youngs` [Pa] is given."""
        other = replace(self, **values)
        stiff = self.scanned_youngs if scanned_youngs is None else scanned_youngs
        return replace(other, youngs=stiff / other.radius_scale**4)


LEARNED = {
    "scanned_youngs": "youngs_spread",
    "damping_ratio": "damping_spread",
    "bend_over_twist": "twist_spread",
    "radius_scale": "radius_spread",
    "response_gain": "response_spread",
}
"""What a shake teaches of a `Material` -> its spread; `Material.changed` takes both."""

TOMATO = Material()
"""Tomato before anything was measured (facts: pollination 0 and 2).

E: log-uniform 30-300 MPa, centre 100: the authors' 21.6 MPa is a bare-beam value that rises to 71-218 MPa with 5-20 g
of leaves, and standing up alone asks for 96-113 MPa; the spread is that of a log-uniform decade, ln 10 / sqrt 12.
Density: 90 % water, and 1100 kg/m3 in the authors' test. Damping: internal < 0.05, leaves add. EI/GJ: 11.5-13.3
measured on dicot petioles; a stem may be stiffer, hence the spread.
"""

PEPPER = Material(density=1100.0, density_spread=0.15)
"""Pepper before anything was measured: no test of a pepper stem was found (facts: pollination, "Not found").

The tomato's values with a wider density, because the authors used 1500 kg/m3 for pepper (facts: pollination 0).
"""
PRIORS: dict[Crop, Material] = {"tomato": TOMATO, "pepper": PEPPER}
"""What is believed of a crop before anything was measured."""
