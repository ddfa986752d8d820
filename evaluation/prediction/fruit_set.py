"""How many plants must be counted to learn the dose-response, and which shakes teach it? Counts drawn from the prior.

    python -m evaluation.prediction.fruit_set --truths 12 --figure docs/pictures/fruit_set.png

Truths are drawn from the tomato's prior, 12 flowers a plant are counted, and `anther.history.fruit_set.fit` sees only
the counts.
Three ways to shake, once each: `varied` (1 to 250 m/s2, every fourth plant left alone), `gentle` (5 to 20 m/s2,
what the limits of a stem shake allow, every fourth left alone), `no_control` (the same, none left alone).
"""

from __future__ import annotations

import numpy as np
from scipy.special import expit

from anther.core import Array
from anther.history.fruit_set import EXPONENTS, NAMES, PRIORS, Count, FruitSet, fit, pollen_dose
from anther.show.pictures.estimates import draw_fruit_set
from evaluation.harness import finish, options, progress, save
from evaluation.tables import markdown

WAYS = {"varied": (1.0, 250.0, 4), "gentle": (5.0, 20.0, 4), "no_control": (5.0, 20.0, 0)}
"""Name -> (weakest, strongest shake [m/s2], every how manieth plant is left alone)."""
WORDS = {
    "varied": "1–250 m/s², every fourth plant left alone",
    "gentle": "5–20 m/s², every fourth left alone",
    "no_control": "5–20 m/s², none left alone",
}
FLOWERS = 12


def drawn_truth(rng: np.random.Generator) -> Array:
    """Return (5,) one dose-response drawn from the prior, in the order of `NAMES`."""
    z = [rng.normal(*getattr(PRIORS["tomato"], name)) for name in NAMES[:4]]
    return np.array(
        [expit(z[0]), expit(z[1]), np.exp(z[2]), expit(z[3]), rng.uniform(EXPONENTS.min(), EXPONENTS.max())]
    )


def counts(rng: np.random.Generator, truth: Array, plants: int, way: str) -> list[Count]:
    """Return what a grower would count on plants visited once each."""
    (p0, gain, half, likeness, exponent), (weakest, strongest, control) = truth, WAYS[way]
    size, found = 1 / likeness - 1, []
    for k in range(plants):
        alone = control > 0 and k % control == 0
        middle = np.exp(rng.uniform(np.log(weakest), np.log(strongest)))
        shaken = middle * rng.uniform(0.5, 1.5, 5)
        p = p0 + (1 - p0) * gain * (0.0 if alone else float(pollen_dose(shaken, half, exponent).mean()))
        fruit = int(rng.binomial(FLOWERS, rng.beta(p * size, (1 - p) * size)))
        found.append(Count(FLOWERS, fruit, () if alone else (shaken,)))
    return found


def score(learned: FruitSet, truth: Array) -> dict[str, float]:
    """Return for each parameter whether its 90 % interval holds and how much it was narrowed; and what 20 m/s2 add."""
    row = {}
    for name, value in zip(NAMES[:3], truth, strict=False):
        _, low, high = learned.interval(name)
        row |= {f"{name}_holds": float(low <= value <= high), f"{name}_narrowed": learned.learned(name)}
    _, low, high = learned.added(20.0)
    added = (1 - truth[0]) * truth[1] * float(pollen_dose(20.0, truth[2], truth[4]))
    return row | {"added_holds": float(low <= added <= high), "added_width": high - low}


def main() -> None:
    """Fit, print a table, write metrics and the picture."""
    quick = "4 truths and 8 or 24 plants, not 72"
    own = {"--truths": (40, "drawn for each way to shake and number of plants")}
    args = options(__doc__, quick=quick, seed=(0, "of truths and counts"), figure="what forty plants teach", own=own)
    sizes, repeats = ((8, 24), 4) if args.quick else ((8, 24, 72), args.truths)
    metrics: dict[str, float] = {"truths": repeats}
    lines = []
    for way, plants in progress([(way, plants) for way in WAYS for plants in sizes], "counts"):
        rng = np.random.default_rng([args.seed, plants])
        truths = [drawn_truth(rng) for _ in range(repeats)]
        rows = [score(fit(counts(rng, truth, plants, way)), truth) for truth in truths]
        mean = {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
        metrics |= {f"{way}_{plants}_{name}": value for name, value in mean.items()}
        narrowed = (f"{mean[f'{n}_narrowed']:.0%}" for n in NAMES[:3])
        lines.append((WORDS[way], plants, *narrowed, f"{100 * mean['added_width']:.0f}"))
    _, low, high = fit([]).added(20.0)
    metrics["added_width_before"] = high - low
    holds = [value for name, value in metrics.items() if name.endswith("_holds")]
    metrics["intervals_hold"] = float(np.mean(holds))
    heads = ("shakes", "plants", "p0 narrowed", "g narrowed", "half narrowed", "20 m/s² add: width, points")
    words = (
        f"{repeats} truths in each row. Width before any count: {100 * (high - low):.0f} points. 90 % intervals hold "
        f"in {metrics['intervals_hold']:.0%} of {len(holds) * repeats} cases."
    )
    finish(args, metrics, markdown(heads, lines), words)
    if args.figure:
        rng, truth = np.random.default_rng(args.seed), np.array([0.45, 0.7, 25.0, 0.06, 1.5])
        learned = fit(counts(rng, truth, 40, "varied"))
        save(draw_fruit_set(learned, fit([]), "simulated tomato"), args.figure)


if __name__ == "__main__":
    main()
