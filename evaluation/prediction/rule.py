"""What is each part of the decision worth? The rule, and the rule without a part, on plants that it does not know.

    python -m evaluation.prediction.rule --plants 24 --jobs 2

Plants, grips, tones and observations are those of `evaluation.prediction.belief`. Each rule chooses tone and amplitude
of a shake at each grip, by the arm and the motor of `evaluation.trials.oracle`, which do here what they do at the
median. MuJoCo's linear equations say what it truly does, and `anther.sim.judge.net_fruit` what that was worth, its mean
over what the plant may bear and over the measures of motion that may free pollen. No pads slip.

Keys of --json, of each machine and rule: net_<machine>_<rule>, mean over plants; _low and _high, of its difference to
the whole rule, 95 % intervals (bootstrap over plants); flower_..., median over plants of the median flower [m/s2];
lost_..., share of flowers lost; priced_..., net where a lost flower counts as the default price has it; plants.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from rich.table import Table
from scipy.special import ndtri

from anther.core import Array, StageFailure
from anther.plant.limits import stalk_strain
from anther.pollination import decision
from anther.pollination.decision import Answer, worth
from anther.pollination.shake import Params
from anther.sim.judge import LEAF_BAND, lost_flowers, net_fruit
from anther.sim.truth import TOLERANCE
from evaluation.harness import by_turns, finish, options, run_cases
from evaluation.prediction.belief import DEVELOPMENT, TONES, Grip, grips_of
from evaluation.statistics import bootstrap
from evaluation.tables import by_part
from evaluation.trials.oracle import ACTUATORS, reach

FIRST = 9700
AMPLITUDES, LEAST = 40, 1e-3
"""So many of each tone, on a logarithmic scale from a share of the largest."""
PRESS = 8.0
"""Of each pad [N]."""
MACHINES = {"arm": ACTUATORS["oracle"], "motor": ACTUATORS["oracle_motor"]}
DRAWN = 64
"""Draws of what a plant bears."""


class Rule(NamedTuple):
    """A rule for a shake.

    Attributes:
        words: what it is, or what the whole rule lacks in it.
        observed: whether it has seen each shake.
        price: of a lost flower.
        middle: whether one plant in the middle of those drawn stands for all.
        changes: names of `anther.pollination.decision` -> what they are instead.
    """

    words: str
    observed: bool = True
    price: float = decision.PRICES["default"]
    middle: bool = False
    changes: Mapping[str, Any] = {}


def _errors(change: Callable[[Any], Any]) -> dict[str, Any]:
    """Return the tables of errors (intercepts, slopes, spreads), all changed."""
    return {name: {kind: change(rows) for kind, rows in getattr(decision, name).items()} for name in _TABLES}


_TABLES = ("ERRORS", "OBSERVED_ERRORS")
_AS_IT_IS = _errors(lambda rows: ((0.0,) * 4, (1.0,) * 4, rows[2]))
_EXACT = _errors(lambda _: ((0.0,) * 4, (1.0,) * 4, (0.01,) * 4))
RULES = {
    "whole": Rule("the whole rule"),
    "blind": Rule("no observation: the plan", observed=False),
    "one_plant": Rule("one plant in the middle, not the drawn ones", middle=True),
    "as_modelled": Rule("the model is taken as it is, its error about it", changes=_AS_IT_IS),
    "exact": Rule("the model has no error", changes=_EXACT),
    "acceleration": Rule("acceleration alone frees pollen", changes={"DOSE_MEASURES": {"acceleration": (0, 1.0)}}),
    "free": Rule("nothing costs anything", price=0.0),
    "flowers_only": Rule("only flowers are lost", changes={"COSTS": dict.fromkeys(decision.COSTS, 0.0)}),
}
LIMITED, ALIKE, KNOWN = "limits", "alike", "known"
WORDS = {name: rule.words for name, rule in RULES.items()} | {
    LIMITED: "as far as 19 of 20 organs bear, most flower motion",
    ALIKE: "one tone and amplitude for all, the best afterwards",
    KNOWN: "what every shake does is known, but not what a plant bears",
}


def one_plant(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return by machine and rule what the shakes of a plant (species, seed) did, for a sweep."""
    del folder
    try:
        grips = list(grips_of(row["species"], row["seed"]))
    except StageFailure:
        return {"shakes": []}
    return {"shakes": [shakes_of(grip) for grip in grips if grip.before[0].flowers.size and grip.true["flowers"].size]}


def shakes_of(grip: Grip) -> dict[str, dict[str, Any]]:
    """Return by machine and rule what the shake that it chooses does; of `ALIKE` a table of all."""
    found = dict[str, dict[str, Any]]()
    for machine, actuator in MACHINES.items():
        most = reach(actuator, grip.point, grip.direction[None], TONES)[:, 0]
        tones = [k for k, tone in enumerate(TONES.tolist()) if actuator.lowest <= tone <= actuator.highest]
        choices = {name: _chosen(grip, rule, tones, most) for name, rule in RULES.items()}
        choices[LIMITED] = _limited(grip, tones, most)
        found[machine] = {name: _outcome(grip.true, *choice) for name, choice in choices.items()}
        found[machine][ALIKE] = [
            [_outcome(grip.true, k, share * most[k]) for share in np.geomspace(0.02, 1, 12)] for k in tones
        ]
        found[machine][KNOWN] = max((one for tone in found[machine][ALIKE] for one in tone), key=lambda one: one[0])
    return found


def _chosen(grip: Grip, rule: Rule, tones: list[int], most: Array) -> tuple[int, float]:
    """Return the tone and the amplitude [m] that a rule chooses, up to `most` (Q,) [m]."""
    best = (-np.inf, tones[0], 0.0)
    with ExitStack() as stack:
        for name, value in rule.changes.items():
            stack.enter_context(patch.object(decision, name, value))
        for k in tones:
            prediction, tried = grip.after[k], np.geomspace(LEAST, 1.0, AMPLITUDES) * most[k]
            answer, seen = (prediction.answer, prediction.seen) if rule.observed else (grip.before[k], None)
            if rule.middle:
                answer = Answer(*(np.exp(np.log(np.maximum(x, 1e-12)).mean(axis=0, keepdims=True)) for x in answer))
            net = worth(answer, tried, TONES[k], Params().held(PRESS), rule.price, seen).net
            best = max(best, (float(net.max()), k, float(tried[net.argmax()])))
    return best[1:] if best[0] > 0 else (best[1], 0.0)


def _limited(grip: Grip, tones: list[int], most: Array) -> tuple[int, float]:
    """Return the tone and amplitude that move the median flower most within what 19 of 20 organs bear, as expected."""
    best = (-1.0, tones[0], 0.0)
    for k in tones:
        answer, hertz = grip.after[k].answer, float(TONES[k])
        loads = {kind: float(decision.expected(kind, getattr(answer, kind), hertz, False)) for kind in _BORNE}
        flowers = np.array([decision.expected("flowers", f, hertz, False) for f in answer.flowers.T])
        borne = min(_BORNE[kind].low / max(load, 1e-12) for kind, load in loads.items())
        amplitude = float(
            min(borne, decision.TOLERANCE["pedicel"].low / max(stalk_strain(hertz) * flowers.max(), 1e-12), most[k])
        )
        best = max(best, (float(np.median(flowers)) * amplitude, k, amplitude))
    return best[1:]


_BORNE = {kind: decision.TOLERANCE[organ] for kind, organ in (("base_strain", "base"), ("stem_strain", "stem"))}


@cache
def _drawn_limits() -> dict[str, Array]:
    """Return by kind of load (D,) what plants may bear, each kind drawn evenly and apart from the others."""
    middles, rng = ndtri((np.arange(DRAWN) + 0.5) / DRAWN), np.random.default_rng(0)
    return {kind: one.median * np.exp(one.sigma * rng.permutation(middles)) for kind, one in TOLERANCE.items()}


def _outcome(true: Mapping[str, Array], k: int, amplitude: float) -> list[float]:
    """Return what a shake was truly worth, the median flower's acceleration [m/s2], the share of flowers lost, and the
    worth where each of them counts as the default price has it."""
    felt, limits = amplitude * true["flowers"][k], _drawn_limits()
    stalks = (amplitude * true[kind][k] for kind in ("pedicels", "peduncles"))
    gone = lost_flowers(*stalks, {kind: one[:, None] for kind, one in limits.items()}).mean(axis=-1)
    bent = {kind: amplitude * true[f"{kind}_strain"][k] > limits[kind] for kind in ("stem", "base")}
    bent["leaf"] = (TONES[k] <= LEAF_BAND) & (amplitude * true["leaf_load"][k] > limits["leaf"])
    net = float(net_fruit(felt, TONES[k], gone, bent, measure=None).mean())
    lost = float(np.where(bent["stem"], 1.0, gone).mean())
    return [net, float(np.median(felt)), lost, net - (decision.PRICES["default"] - 1) * lost]


def metrics(plants: list[list[dict[str, dict[str, Any]]]]) -> dict[str, float]:
    """Return the table's numbers, of the shakes of each plant's grips."""
    plants = [grips for grips in plants if grips]
    table = {"plants": float(len(plants))}
    for machine in MACHINES:
        of = {
            name: np.array([np.mean([grip[machine][name] for grip in grips], axis=0) for grips in plants])
            for name in (*RULES, LIMITED, KNOWN)
        }
        every = np.array([np.mean([grip[machine][ALIKE] for grip in grips], axis=0) for grips in plants])
        best = np.unravel_index(every[..., 0].mean(axis=0).argmax(), every.shape[1:3])
        of[ALIKE] = every[:, *best]
        for name, values in of.items():
            key, less = f"{machine}_{name}", values[:, 0] - of["whole"][:, 0]
            low, high = bootstrap(less, np.mean)
            table |= {f"net_{key}": float(values[:, 0].mean()), f"net_{key}_low": low, f"net_{key}_high": high}
            table |= {f"flower_{key}": float(np.median(values[:, 1])), f"lost_{key}": float(values[:, 2].mean())}
            table |= {f"priced_{key}": float(values[:, 3].mean())}
    return table


def report(table: dict[str, float]) -> Iterator[Table]:
    """Yield a table for each machine."""
    numbers = {
        "net fruit": "net_*:.3f",
        "beside the whole rule (95 %)": "less_*:+.3f (net_*_low:+.3f to net_*_high:+.3f)",
        "median flower [m/s2]": "flower_*:.1f",
        "flowers lost": "lost_*:.1%",
        "at the price": "priced_*:.3f",
    }
    for machine in MACHINES:
        rules = {f"{machine}_{name}": words for name, words in WORDS.items()}
        less = {f"less_{key}": table[f"net_{key}"] - table[f"net_{machine}_whole"] for key in rules}
        yield by_part(table | less, machine, rules, numbers)


def main() -> None:
    """Run what is missing and print the tables."""
    own = {"--plants": (24, "tomatoes and peppers by turns"), "--development": (False, "on which errors were fitted")}
    seed = (0, "added to the seeds of all plants")
    args = options(__doc__, quick="two plants", seed=seed, jobs="plants", out="runs/rule", own=own)
    plants = by_turns(2 if args.quick else args.plants, (DEVELOPMENT[0] if args.development else FIRST) + args.seed)
    cases = [{"species": species, "seed": seed} for species, seed in plants]
    done = run_cases(one_plant, cases, args.out, args.jobs, lambda _: {"shakes": []})
    table = metrics([row["shakes"] for row in done])
    finish(args, table, f"{table['plants']:.0f} plants, four grips each.", *report(table))


if __name__ == "__main__":
    main()
