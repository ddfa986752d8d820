"""Which feature of the plant model matters how much for the predicted amplitude of the flowers?

    python -m evaluation.prediction.ablation --plants 3 --scanned 0 --jobs 2

Plants of the simulated greenhouse as rods: with their own geometry, masses, stiffness and damping ("true"), and, of
the first `--scanned` of each crop, as the pipeline reconstructs them from 30 noisy views with the crop's prior
("scanned"). One feature at a time is taken away (ablated.py), all else stays. Shaken sideways at three heights of the
stem at the paper's frequencies and at 3, 5, 10 and 30 Hz; linear theory, so the amplitude of the shake does not count.

Beside it the error against MuJoCo, where the same plants are rigid pieces of 25 mm or less on sprung hinges that bend
and twist (EI/GJ 12; evaluation/prediction/shaken_plant.py), with and without each feature.

Keys of the --json file: <true|scanned>_<feature>_<band>_change_median, _change_p90 (of |without / with - 1|),
_change_signed (median of without / with - 1), _error_median, _error_p90 (of |predicted / MuJoCo - 1|); the feature
"full" has errors alone. <true|scanned>_plants, _flowers, and <feature>_stiffened: share of plants that would buckle
without the feature and got a higher E. Plants go through a sweep in --out: what is done is not run again.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from anther.core import Array
from anther.pollination.shake.observables import semi_major
from anther.sim import grow
from anther.sim.simulated_cell import USUAL_DISTANCE
from evaluation.harness import CROPS, finish, options, run_cases
from evaluation.prediction.ablated import CHANGES
from evaluation.prediction.known_plant import known, stem_points
from evaluation.prediction.shaken_plant import ShakenPlant
from evaluation.prediction.vibration_models import Model, anther_model, true_model
from evaluation.prediction.vibration_plant import DIRECTION, FAST_FREQUENCIES, PAPER_FREQUENCIES, TWIST
from evaluation.tables import by_part

KINDS = ("true", "scanned")
HEIGHTS = (0.35, 0.6, 0.85)
"""Grips, in shares of the main stem's length."""
FREQUENCIES = np.array(PAPER_FREQUENCIES + FAST_FREQUENCIES)
BANDS = {"slow": FREQUENCIES < 2} | {f"{f:g}hz": f == FREQUENCIES for f in FAST_FREQUENCIES}
BAND_WORDS = {"slow": "0.7–1.9 Hz"} | {f"{f:g}hz": f"{f:g} Hz" for f in FAST_FREQUENCIES}


def one_plant(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return every model's gains (G, Q, F) and MuJoCo's of a plant (species, seed, scan), for a sweep."""
    del folder
    plant = grow(row["species"], row["seed"], 0, USUAL_DISTANCE)
    judges = [ShakenPlant(plant, point, DIRECTION) for point in stem_points(plant, HEIGHTS)]
    points = np.array([judge.point for judge in judges])
    truth = np.array([semi_major(judge.linear(FREQUENCIES)) for judge in judges])
    models = {"true": (true_model(plant, TWIST), np.arange(truth.shape[2]), truth)}
    if row["scan"]:
        it = known(row["species"], row["seed"])
        models["scanned"] = (anther_model(it.model), it.i, truth[:, :, it.j])
    found: dict[str, Any] = {}
    for name, (model, flowers, judged) in models.items():
        found[name] = {"truth": judged, "full": model.response(points, DIRECTION, FREQUENCIES)[:, :, flowers]}
        found[name]["stiffened"] = {}
        for feature, (_, change) in CHANGES.items():
            without = change(model)
            found[name][feature] = without.response(points, DIRECTION, FREQUENCIES)[:, :, flowers]
            found[name]["stiffened"][feature] = _stiffer(without, model)
    return found


def _stiffer(without: Model, model: Model) -> bool:
    """Whether the stem's E was raised (by more than where it is raised for comparison)."""
    return bool(np.asarray(without.rods.youngs)[1] > 1.21 * np.asarray(model.rods.youngs)[1])


def metrics(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Return what the module's docstring names."""
    out: dict[str, float] = {}
    for name in KINDS:
        mine = [row[name] for row in rows if name in row and np.size(row[name]["full"])]
        if not mine:
            continue
        out[f"{name}_plants"] = len(mine)
        out[f"{name}_flowers"] = sum(np.shape(row["full"])[2] for row in mine)
        for feature in ("full", *CHANGES):
            if feature != "full":
                out[f"{name}_{feature}_stiffened"] = float(np.mean([row["stiffened"][feature] for row in mine]))
            for band, among in BANDS.items():
                gain, full, truth = (_pooled(mine, key, among) for key in (feature, "full", "truth"))
                key = f"{name}_{feature}_{band}"
                if feature != "full":
                    change = gain / full - 1
                    out[f"{key}_change_median"] = float(np.median(np.abs(change)))
                    out[f"{key}_change_p90"] = float(np.quantile(np.abs(change), 0.9))
                    out[f"{key}_change_signed"] = float(np.median(change))
                error = np.abs(gain / truth - 1)
                out[f"{key}_error_median"] = float(np.median(error))
                out[f"{key}_error_p90"] = float(np.quantile(error, 0.9))
    return out


def _pooled(rows: list[dict[str, Any]], key: str, among: Any) -> Array:
    """Return all plants' values of one band, (n,)."""
    return np.concatenate([np.asarray(row[key])[:, among].ravel() for row in rows])


def tables(found: dict[str, float]) -> list[str | Table]:
    """Return a table of changes and one of errors for each kind of model, each after a line that says what it shows."""
    change = {
        words: f"*_{band}_change_median:.0% (*_{band}_change_p90:.0%) *_{band}_change_signed:+.0%"
        for band, words in BAND_WORDS.items()
    }
    error = {words: f"*_{band}_error_median:.0% (*_{band}_error_p90:.0%)" for band, words in BAND_WORDS.items()}
    out: list[str | Table] = []
    for name in KINDS:
        if f"{name}_plants" not in found:
            continue
        count = f"{found[f'{name}_plants']:.0f} {name} plants, {found[f'{name}_flowers']:.0f} flowers"
        features = {f"{name}_{feature}": words for feature, (words, _) in CHANGES.items()}
        if name == "true":
            said = "change of a flower's amplitude, median (90th percentile) and median with its sign:"
            changed = change | {"stiffened": "*_stiffened:.0%"}
            out += [f"{count}: {said}", by_part(found, "taken away", features, changed)]
        out.append(f"{count}: error against MuJoCo, median (90th percentile):")
        out.append(by_part(found, "taken away", {f"{name}_full": "nothing"} | features, error))
    return out


def main() -> None:
    """Run, print the tables, write --json."""
    quick, seed = "one plant of each crop, not scanned", (1000, "of the first plant of each crop")
    own = {"--plants": (5, "of each crop"), "--scanned": (2, "of each crop that are reconstructed too")}
    args = options(__doc__, quick=quick, seed=seed, jobs="plants", out="runs/ablation", own=own)
    plants, scans = (1, 0) if args.quick else (args.plants, args.scanned)
    cases = [{"species": s, "seed": args.seed + k, "scan": k < scans} for s in CROPS for k in range(plants)]
    found = metrics(run_cases(one_plant, cases, args.out, args.jobs, lambda _: {}))
    finish(args, found, *tables(found))


if __name__ == "__main__":
    main()
