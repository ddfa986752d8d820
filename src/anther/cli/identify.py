"""Measurements of one stem (cut samples, plucks, tip masses) -> density, stiffness and damping with their errors."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from anther.cli.args.identify import Args
from anther.cli.output import room_for
from anther.core.checks import check_range
from anther.core.errors import InputError, bad_input
from anther.core.files import json_text, write_json
from anther.core.geometry import Array
from anther.plant.bench import (
    ClampedStem,
    FreeVibration,
    Identification,
    InstrumentErrors,
    MaterialTest,
    Orientation,
    Quantity,
    fit_free_vibration,
    identify,
    write_material,
)  # fmt: skip
from anther.plant.bench.measurements import DEFLECTION, LEAVES, PROFILE, SAMPLES, TRACE, read_measurements
from anther.show.pictures import save_figure
from anther.show.pictures.estimates import Pluck, draw_material_test

WRITTEN = ("identify.json", "material.json", "identify.png")


def run(args: Args) -> None:
    """Read the files, identify, print and write the results."""
    out = room_for(args, WRITTEN)
    plucks = [_pluck(path, args.start) for path in args.trace]
    test = _material_test(args, tuple(pluck.fit for pluck in plucks))
    found = identify(test)
    result = _numbers(test, found)
    if out is not None:
        write_json(out / WRITTEN[0], result)
        write_material(out / WRITTEN[1], found.material)
        save_figure(draw_material_test(test, found, plucks), out / WRITTEN[2])
    print(json_text(result).rstrip() if args.json else _text(args, test, found))


def _pluck(path: Path, start: float | None) -> Pluck:
    table = read_measurements(path, TRACE)
    keep = table["time"] >= (-np.inf if start is None else start)
    times, displacement = table["time"][keep], table["displacement"][keep]
    try:
        return Pluck(path.name, times, displacement, fit_free_vibration(times, displacement))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _material_test(args: Args, plucks: tuple[FreeVibration, ...]) -> MaterialTest:
    if not (args.samples or args.density or plucks or args.frequency or args.deflection):
        raise InputError(
            "nothing to identify: give --samples or --density, then --trace or --frequency, or --deflection, with "
            "--profile or --length and --radius. See docs/identification.md."
        )
    _refuse_contradictions(args)
    if args.frequency is not None:
        check_range("frequency", args.frequency, 1e-3, 1e4, "Hz")
        error = args.frequency_error if args.frequency_error is not None else 0.01 * args.frequency
        check_range("frequency_error", error, 0, args.frequency / 2, "Hz")
        plucks = (FreeVibration(args.frequency, 0.0, error, np.inf),)
    stem = _stem(args)
    if stem is None and (args.deflection or args.frequency is not None):
        raise InputError("the stem's shape is missing: give --profile, or --length and --radius.")
    measured: dict[str, Any] = {}
    if args.samples:
        measured |= {f"sample_{name}": values for name, values in read_measurements(args.samples, SAMPLES).items()}
    if args.deflection:
        tip = read_measurements(args.deflection, DEFLECTION)
        measured |= {"tip_mass": tip["mass"], "deflection": tip["deflection"]}
    orientation: Orientation = args.orientation or "weightless"
    density = None
    if args.density is not None:
        check_range("density", args.density, 10, 5000, "kg/m3")
        error = args.density_error if args.density_error is not None else 0.05 * args.density
        density = args.density, check_range("density_error", error, 0, args.density / 2, "kg/m3")
    return MaterialTest(
        stem, orientation, density=density, plucks=plucks, errors=args.errors or InstrumentErrors(), **measured
    )


def _refuse_contradictions(args: Args) -> None:
    """Refuse options that exclude each other, and those that would have no effect."""
    for one, other in (("trace", "frequency"), ("samples", "density"), ("profile", "radius")):
        if getattr(args, one) and getattr(args, other) is not None:
            raise InputError(f"--{one} and --{other}: give one of them; they say the same.")
    vibration = bool(args.trace) or args.frequency is not None
    useless = (
        ("density-error", args.density_error is not None, args.density is not None, "--density"),
        ("frequency-error", args.frequency_error is not None, args.frequency is not None, "--frequency"),
        ("start", args.start is not None, bool(args.trace), "--trace"),
        ("orientation", args.orientation is not None, vibration, "--trace or --frequency"),
    )
    for name, given, effective, needed in useless:
        if given and not effective:
            raise InputError(f"--{name} has no effect without {needed}. Add it, or leave --{name} out.")


def _stem(args: Args) -> ClampedStem | None:
    """Return the stem, or None where its shape is not given at all."""
    profile: dict[str, Array] = {}
    if args.profile is not None:
        profile = read_measurements(args.profile, PROFILE)
    elif args.radius is not None:
        profile = {"distance": np.zeros(1), "radius": np.array([check_range("radius", args.radius, 1e-5, 0.5, "m")])}
    length = args.length if args.length is not None else float(profile.get("distance", np.zeros(1))[-1])
    if not profile or length <= 0:
        if args.profile or args.length is not None or args.radius is not None or args.leaves:
            raise InputError("the stem's shape is incomplete: give --profile, or --length and --radius [m].")
        return None
    check_range("length", length, 1e-3, 20, "m")
    leaves = read_measurements(args.leaves, LEAVES) if args.leaves else {"distance": np.zeros(0), "mass": np.zeros(0)}
    if len(leaves["distance"]) and leaves["distance"].max() > length * (1 + 1e-9):
        given, allowed = f"{1e3 * leaves['distance'].max():g} mm", f"0 to {1e3 * length:g} mm, the length of the stem"
        do = "Check the distances, or give --length."
        raise bad_input(f"{args.leaves}: distance", given=given, allowed=allowed, do=do)
    return ClampedStem(profile["distance"], profile["radius"], length, leaves["distance"], leaves["mass"])


def _numbers(test: MaterialTest, found: Identification) -> dict[str, Any]:
    """Return the result as numbers in SI."""
    v = found.vibration
    natural = {} if v is None else {"natural_frequency": v.natural_frequency, "plucks": len(test.plucks)}
    return {
        "density": _estimate(found.density),
        "samples": None if found.samples is None else asdict(found.samples) | {"count": len(test.sample_mass)},
        "vibration": None if v is None else asdict(v) | natural,
        "orientation": test.orientation,
        "youngs": None if found.youngs is None else _estimate(found.youngs),
        "youngs_by_method": {estimate.name: _estimate(estimate) for estimate in found.estimates},
        "material": asdict(found.material),
        "warnings": list(found.warnings),
    }


def _estimate(estimate: Quantity) -> dict[str, Any]:
    error, shares = estimate.standard_error, dict(estimate.shares)
    return {"value": estimate.value, "standard_error": error, "relative_error_by_source": shares}


def _text(args: Args, test: MaterialTest, found: Identification) -> str:
    lines = [line for line in (_density_line(test, found), _vibration_line(test, found)) if line]
    lines += [f"E from {estimate.name:11} {_modulus(estimate)}" for estimate in found.estimates]
    if len(found.estimates) == 2 and found.youngs is not None:
        lines.append(f"E together         {_modulus(found.youngs)}")
    lines += [f"warning: {warning}" for warning in found.warnings]
    if found.youngs is not None:
        m = found.material
        flags = f"--youngs {m.youngs:.4g} --density {m.density:.4g} --damping-ratio {m.damping_ratio:.3g}"
        lines.append(f"to use it: anther plan SKELETON {flags}")
    return "\n".join(lines if args.out is None else [*lines, f"written: {args.out}"])


def _density_line(test: MaterialTest, found: Identification) -> str:
    how = "given"
    if found.samples is not None:
        s, count = found.samples, len(test.sample_mass)
        how = f"{count} samples, spread {s.sd:.3g}, standard error {s.standard_error:.2g} without the calliper's error"
    return f"density            {found.density.value:.4g} ± {found.density.standard_error:.2g} kg/m³ ({how})"


def _vibration_line(test: MaterialTest, found: Identification) -> str:
    v = found.vibration
    if v is None:
        return ""
    line = f"frequency          {v.frequency:.4g} ± {v.frequency_error:.2g} Hz"
    if np.isfinite(v.damping_error):
        count = f"{len(test.plucks)} pluck" + ("s" if len(test.plucks) > 1 else "")
        line += f", damping ratio {v.damping_ratio:.3g} ± {v.damping_error:.1g} ({count})"
    return line


def _modulus(estimate: Quantity) -> str:
    largest = sorted(estimate.shares.items(), key=lambda item: -abs(item[1]))
    sources = ", ".join(f"{name} {abs(share):.1%}" for name, share in largest if abs(share) >= 0.001)
    return f"{estimate.value / 1e6:.3g} ± {estimate.standard_error / 1e6:.2g} MPa ({sources})"
