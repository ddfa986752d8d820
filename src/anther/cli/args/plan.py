"""Choose the shake for a skeleton or a run, and explain it: limits, runner-up, what each flower should do, and why.

With --simulate one stated shake is carried out by the rod model in time. With --map small shakes of every grip height
and frequency are compared. All three take the same plant.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from anther.cli.args.shared import EXISTS, Given, Output, Source, Stage, stage
from anther.core.choices import ActuatorName, Crop, Discretisation, Preset


@dataclass(frozen=True)
class Rods:
    """What the plant is made of, other than the crop's prior or the run says; and what holds it."""

    radius: float | None = None
    """Radius of every edge [m]. By default the radii in the file; if it has none, as thick as the crop's stem is at its
    base, and thinner with what a node carries."""
    least_radius: float = 0.0
    """No edge is thinner than this [m]: a scan shows twigs and midribs thinner than they are."""
    youngs: float | None = None
    """Young's modulus [Pa]; pedicels keep their own. Without it a plant that would not stand is taken to be stiffer."""
    density: float | None = None
    """Density [kg/m^3]."""
    bend_over_twist: float | None = None
    """EI / GJ [-]: 1.5 for a round bar of constant volume, about 12 for dicot petioles; 0: no twist, as in the
    paper."""
    damping_ratio: float | None = None
    """Share of critical damping."""
    bare: bool = False
    """Of a skeleton file: its edges alone, with its own radii: no pedicels, no taper, no blades stiffened."""
    pads: float = 0.0
    """With --simulate and --map: length of stem between the gripper's pads [m], which hold its direction too; 0 moves
    one node, about which the stem may turn."""
    discretisation: Discretisation = "consistent"
    """With --simulate and --map: second order in the edge length, also at forks and kinks; or the paper's formula."""


@dataclass(frozen=True)
class Simulation:
    """The shake that --simulate carries out."""

    grip: int | None = None
    """Node that the gripper moves; by default halfway up the main stem."""
    frequency: float = 1.3
    """Shake frequency [Hz]. The damping ratio holds here (Kelvin-Voigt: it grows with frequency); for a chirp, at the
    geometric mean of both its frequencies."""
    waveform: Literal["sine", "chirp", "burst"] = "sine"
    """A sine; a sweep from `frequency` to `end_frequency` over the whole duration; or bursts that swell and fade."""
    end_frequency: float = 30.0
    """Of a chirp [Hz]."""
    cycles: int = 10
    """Of each burst."""
    pause: float = 0.5
    """Between bursts [s]."""
    ramp: float = 0.0
    """Time over which the amplitude of a sine or chirp grows from 0 [s]; 0 starts at once, as the authors do."""
    duration: float = 5.0
    """Simulated time [s]."""
    dt: float = 0.001
    """Time step [s]."""
    rest: Literal["hanging", "stress-free"] = "hanging"
    """The scanned shape hangs in equilibrium under gravity, or is stress-free and sags when gravity acts."""
    integrator: Literal["midpoint", "implicit_euler"] = "midpoint"
    """Second order without numerical damping, or first order with."""


@dataclass(frozen=True)
class Map:
    """The grips that --map compares."""

    grips: tuple[int, ...] = ()
    """Nodes where the plant is gripped. By default the main stem's."""
    heights: int = 40
    """At most so many of the main stem's nodes, evenly picked."""
    arm: bool = False
    """Shake as far as a Sawyer can at each frequency instead of --amplitude: neutral arm, away from its base."""


def _more(group: type) -> Any:
    return field(default_factory=group, metadata={"more": True})


@dataclass(frozen=True)
class Args(Output, Source):
    """Attributes: the plant, what shakes it, and what for. Node numbers are those of the file."""

    source: Given
    """Run folder, or skeleton file (.npz, .swc, .txt, .ply, .graphml, .mtg)."""
    simulate: bool = False
    """Shake one node as stated and print how a flower moves (elastic rods in time)."""
    map: bool = False
    """Map how the flowers answer small shakes, over grip height and frequency (linear response)."""
    flower: tuple[int, ...] = ()
    """Of a skeleton file: nodes that bear a flower. By default flowers are supposed at the ends of the branches."""
    species: Crop = "tomato"
    """Whose prior the material is, where neither the run nor --material tells it; whose stem a file without radii has;
    whose breeze the limits are likened to."""
    material: Annotated[Path | None, EXISTS] = None
    """What `anther identify` measured (material.json)."""
    actuator: ActuatorName = "arm"
    """The arm shakes the closed gripper, or the gripper vibrates by itself (10-40 Hz)."""
    shake: Preset | None = None
    """How boldly the plant may be loaded (docs/shake.md has the limits); by default what --params says. 'paper' is
    the paper's own shake, 12 mm at 1.9 Hz: no limit of the plant is kept and slip is not prevented."""
    lowest: float | None = None
    """Lowest frequency [Hz]; by default the actuator's."""
    highest: float | None = None
    """Highest frequency [Hz]; by default the actuator's."""
    frequencies: int | None = None
    """How many frequencies are tried; by default 80 for a map."""
    amplitude: float | None = None
    """Of the grip [m]: with --simulate, by default 0.004; with --map, by default 0.001."""
    axis: Literal["best", "x", "y", "z"] | None = None
    """Shake direction: with --simulate, by default x; with --map, by default the best of 12 horizontal ones."""
    out: Path | None = None
    """Folder for shake_plan.json and .png; shake.json, .png and trajectory.npz; response_map.json, .png and .csv."""
    rods: Annotated[Rods, tyro.conf.OmitArgPrefixes] = _more(Rods)
    """What the plant is made of."""
    simulation: Annotated[Simulation, tyro.conf.OmitArgPrefixes] = _more(Simulation)
    """With --simulate."""
    mapping: Annotated[Map, tyro.conf.OmitArgPrefixes] = _more(Map)
    """With --map."""
    params: Stage = stage("anther.pollination.shake")
    """Limits and search."""
