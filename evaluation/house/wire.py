"""How far the neighbours of a shaken stem move through the wire that their strings hang on: rods, no simulator.

    python -m evaluation.house.wire --spans 40

One span of wire between two posts, tight and sagging under its plants; from it hang strings, each with a stem that
weighs what pulls the string. One stem is shaken where a robot holds it, across and along the row. Every number is drawn
from the ranges in `DRAWN`. Told is how far the stem of each other plant moves at the height of its open truss, as a
share of the gripper's motion: the largest of all neighbours, for each frequency. What a neighbour's flowers make of it
they make of the shaken stem's motion too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.core import Array
from anther.plant.string import TENSION
from anther.rods import GRAVITY, Clamp, Rods, Support, frequency_response, with_gravity_equilibrium
from evaluation.harness import finish, options, progress
from evaluation.tables import markdown

HERTZ = np.array([5.0, 8.0, 12.0, 17.0, 24.0, 34.0])
DRAWN = {
    "span": (3.0, 5.0),  # m between posts (facts: rows D; else a guess)
    "pull": (500.0, 3000.0),  # N of the wire: a guess
    "wire": (1.25e-3, 2e-3),  # m, its radius: a guess
    "pitch": (0.3, 0.5),  # m between hooks (facts: rows D)
    "string": (0.2, 1.0),  # m from the hook to the top of the stem (facts: rows D: the truss is 0.3-0.5 m below it)
    "stem": (1.5, 2.5),  # m that hang
    "radius": (5e-3, 7e-3),  # m of a stem (facts: rows 0)
    "youngs": (50e6, 200e6),  # Pa of it (facts: rows 0: 100 MPa)
}
STEEL, TWINE, DENSITY = 200e9, 0.5e9, 1000.0
"""Young's moduli [Pa]; of twine, such that one of 1 mm radius has the EA of `plant.string.HeldString`; kg/m3 of tissue
(and, as it hangs on plants of kilograms, of the wire)."""
TRUSS, GRIP, STEP, LOSS = 0.25, 0.35, 0.1, 0.1
"""Below a stem's top: the open truss, and the pads [m]; between nodes [m]; loss factor: guesses."""


class Span(NamedTuple):
    """Rods of a span, its clamp, the grip's node, and those of the other stems at their open trusses."""

    rods: Rods
    clamp: Clamp
    grip: int
    neighbours: list[int]


def draw(rng: np.random.Generator) -> dict[str, float]:
    """Draw the numbers of a span, with the weight of each of its plants [N]."""
    drawn = {name: float(rng.uniform(*bounds)) for name, bounds in DRAWN.items()}
    pull = TENSION["tomato"]
    return drawn | {"weight": pull.median * float(np.exp(pull.spread * rng.normal()))}


def span(drawn: dict[str, float]) -> Span:
    """Return a span of wire with its plants; the stem in the middle is held."""
    along, sag, upward, hooks = _tight(drawn)
    nodes, parent = [np.column_stack([0 * along, along, sag])], [np.arange(-1, len(along) - 1)]
    radius, youngs, mass = ([np.full(len(along), value)] for value in (drawn["wire"], STEEL, 0.0))
    string = np.arange(STEP, drawn["string"] + STEP / 2, STEP)
    down = np.concatenate([string, drawn["string"] + np.arange(STEP, drawn["stem"] + STEP / 2, STEP)])
    on_stem = np.arange(len(down)) >= len(string)
    own = DENSITY * np.pi * drawn["radius"] ** 2 * STEP  # kg of a stem's piece itself
    hung = drawn["weight"] / np.linalg.norm(GRAVITY) / on_stem.sum()
    truss, grip = (int(np.argmin(np.abs(down - drawn["string"] - below))) for below in (TRUSS, GRIP))
    first = len(along) + len(down) * np.arange(len(hooks))
    for number, hook in zip(first, hooks, strict=True):
        nodes.append(nodes[0][hook] - down[:, None] * [0.0, 0.0, 1.0])
        parent.append(np.concatenate([[hook], number + np.arange(len(down) - 1)]))
        radius.append(np.where(on_stem, drawn["radius"], 1e-3))
        youngs.append(np.where(on_stem, drawn["youngs"], TWINE))
        mass.append(np.where(on_stem, max(hung - own, 0.0), 0.0))
    stiff = 1e7  # N/m of a post, so that it does not give
    rods = Rods(
        np.concatenate(nodes),
        np.concatenate(parent),
        np.concatenate(radius),
        np.concatenate(youngs),
        DENSITY,
        lumped_mass=np.concatenate(mass),
        supports=(Support(len(along) - 1, stiff, force=(0.0, drawn["pull"], upward)),),
    )
    clamp, asked = Clamp(np.array([0, 1])), len(hooks) // 2
    others = np.delete(first, asked) + truss
    return Span(with_gravity_equilibrium(rods, clamp), clamp, int(first[asked] + grip), others.tolist())


def _tight(drawn: dict[str, float]) -> tuple[Array, Array, float, NDArray[np.int64]]:
    """Return places along a wire and its sag there [m], what its far end is held up with [N], and its hooks' nodes.

    It pulls alike all along, and so bends down at each hook, by the hook's load over its pull.
    """
    between = 8  # nodes from hook to hook
    count = int(drawn["span"] / drawn["pitch"])
    along, hooks = np.linspace(0, drawn["span"], between * count + 1), np.arange(between // 2, between * count, between)
    load = np.zeros(len(along))
    load[hooks] = drawn["weight"]
    far = float(load @ along / drawn["span"])
    upward = load.sum() - far - np.cumsum(load)[:-1]
    sag = np.concatenate([[0.0], np.cumsum(-upward * np.diff(along) / drawn["pull"])])
    return along, sag, far, hooks


def passed_on(here: Span, frequencies: Array = HERTZ) -> Array:
    """Return (2, Q) how far the neighbour that moves most goes for a metre of the grip, across and along the row."""
    shaken = [
        frequency_response(here.rods, here.clamp, here.grip, way, frequencies, loss_factor=LOSS)[:, here.neighbours]
        for way in np.eye(3)[:2]
    ]
    return np.linalg.norm(shaken, axis=-1).max(axis=-1)


def main() -> None:
    """Draw spans and print what their neighbours get."""
    own = {"--spans": (40, "of wire, drawn")}
    args = options(__doc__, quick="4 spans", seed=(0, "of the spans"), own=own)
    count = 4 if args.quick else args.spans
    rng = np.random.default_rng(args.seed)
    shares = np.array([passed_on(span(draw(rng))) for _ in progress(range(count), "spans")])
    ways = {"across": shares[:, 0], "along": shares[:, 1]}
    metrics = {"spans": float(count)} | {
        f"{name}_{way}_{hertz:g}_hz": float(value)
        for way, of in ways.items()
        for name, values in (("median", np.median(of, axis=0)), ("most", of.max(axis=0)))
        for hertz, value in zip(HERTZ, values, strict=True)
    }
    keys = [f"{name}_{way}" for way in ways for name in ("median", "most")]
    rows = [(f"{hertz:g}", *(f"{100 * metrics[f'{key}_{hertz:g}_hz']:.2g}" for key in keys)) for hertz in HERTZ]
    head = ("shake [Hz]", "across: median [%]", "most [%]", "along: median [%]", "most [%]")
    finish(args, metrics, markdown(head, rows))


if __name__ == "__main__":
    main()
