"""Suite of the room `plant`: scanned plants as rods, whether they stand, how they swing, and what loads them.

Inputs: those of the perception suite, with stem and flowers found.
"""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np

from anther.core import AntherError
from anther.perception import find_flowers, find_stem, flower_centres
from anther.plant import PEPPER, TOMATO, ClampedStem, build_plant, moved
from anther.plant.bench import youngs_from_deflection, youngs_from_first_mode
from anther.plant.limits import breeze
from anther.rods import natural_frequencies
from evaluation.decisions import perception


def prepare(folder: Path, data: Path, quick: bool) -> None:
    """Write the cases, as the source has them."""
    perception.prepare(folder, data, quick)
    for path in folder.glob("*.case"):
        case = pickle.loads(path.read_bytes())
        stem = find_stem(case.skeleton, flowers_at=flower_centres(case.cloud))
        seen = case.skeleton, stem, find_flowers(case.cloud, case.skeleton, stem), case.cloud
        path.write_bytes(pickle.dumps(seen))


def decide(folder: Path, module: str) -> dict[str, dict[str, Any]]:
    """Return what is decided in each case."""
    found = {"bench": _bench(), "breezes": _breezes()}
    for path in sorted(folder.glob("*.case")):
        skeleton, stem, flowers, cloud = pickle.loads(path.read_bytes())
        if not 0.1 <= np.ptp(skeleton.nodes, axis=0).max() <= 2:
            continue
        try:
            plant = build_plant(skeleton, stem, flowers, cloud, PEPPER if "pepper" in path.name else TOMATO)
        except AntherError as error:
            found[path.stem] = {"failure": {"words": str(error)}}
            continue
        tones = natural_frequencies(plant.rods, plant.clamp, 3)[0]
        found[path.stem] = {
            "mass": {"ratio": float(plant.rods.node_mass.sum()), "within": 0.05},
            "least stiffness": {"ratio": plant.least_youngs, "within": 0.05},
            "stiffness": {"ratio": plant.material.youngs, "within": 0.05},
            "notes": {"words": " ".join(plant.notes)},
        } | {f"mode {k + 1}": {"ratio": float(hertz), "within": 0.03} for k, hertz in enumerate(tones)}
    return found


def _bench() -> dict[str, Any]:
    """Return the stiffness that bench tests of a stem of 0.3 m and 4 mm give."""
    stem = ClampedStem.uniform(0.3, 4e-3)
    swung = youngs_from_first_mode(stem, 12.0, 1050.0, "upright")
    bent, error = youngs_from_deflection(stem, [0.01, 0.02], [0.01, 0.02], 1050.0)
    values = {"swung": swung, "bent": bent, "error": error}
    return {name: {"ratio": float(value), "within": 0.01} for name, value in values.items()}


def _breezes() -> dict[str, Any]:
    """Return whether flowers moved, and which wind loads a plant as much as some loads do."""
    answers = [str(moved(np.full(3, value))) for value in (2.0, 4.0, 6.0, 9.0)]
    winds = [breeze("pedicel bending strain [-]", load, "tomato") for load in (0.005, 0.01, 0.02)]
    return {"moved": {"words": " ".join(answers)}} | {
        f"wind {k}": {"ratio": float(wind or 0), "within": 0.05} for k, wind in enumerate(winds)
    }
