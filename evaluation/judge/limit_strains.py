"""Strains of the same shaken rods in two codes: what Anther reports, and what the hinges of MuJoCo carry.

The rods are cut where MuJoCo's rigid pieces are, and held by the same piece of the stem, whose height is free. Q
frequencies, B strains that are observed.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from anther.core import Array
from anther.pollination.shake.observables import Observables, observables, semi_major
from anther.rods import observed_response
from anther.sim import Organ, SimPlant, plant_mechanics
from evaluation.judge.limit_rods import TrueRods, bare, true_rods
from evaluation.prediction.shaken_plant import Params, ShakenPlant
from evaluation.tables import by_part

FREQUENCIES = np.array([1.0, 2.0, 5.0, 10.0, 30.0])
HELD_AT = 0.5
"""Where the stem is held, in shares of its length."""
DIRECTION = np.array([1.0, 0.5, 0.0])
ROTOR = 3000.0
"""Frequency [Hz] that bounds the hinges' rotor inertia, which only time stepping needs: 0.005 % at 30 Hz."""
COUNTS = 0.2
"""An organ is compared if it bears this share of what the most strained one of its kind bears."""


class StrainRow(NamedTuple):
    """Strains of one kind in one plant at one frequency.

    Attributes:
        plant, kind, frequency: what and where.
        error: of the largest, Anther's over MuJoCo's less 1, with the same hysteretic damping in both codes, and the
            same radius: that in the middle of an edge.
        places: (n,) the same of single places (a stem's piece, a pedicel's, a base), as far as they count.
    """

    plant: str
    kind: str
    frequency: float
    error: float
    places: Array


@dataclass(frozen=True, slots=True, eq=False)
class Shaken:
    """One plant in both codes.

    Attributes:
        rods: of Anther.
        seen: what is observed of them.
        reported: (Q, B) strains by Anther per metre of grip motion [1/m].
        hinges: the plant in MuJoCo.
        piece: (N,) MuJoCo's piece that an edge begins with, -1 for other edges.
    """

    rods: TrueRods
    seen: Observables
    reported: Array
    hinges: ShakenPlant
    piece: NDArray[Any]


def shaken(plant: SimPlant, piece: float) -> Shaken:
    """Return a plant shaken in both codes, cut into pieces of at most `piece` [m]."""
    cut = plant_mechanics.Params(piece=piece, twist_every=1, stiffest=ROTOR, foliage=ROTOR)
    points, _, arc = plant.stem_centreline()
    point = points[np.argmin(np.abs(arc - HELD_AT * arc[-1]))]
    hinges = ShakenPlant(bare(plant), point, DIRECTION, Params(plant=cut))
    finer, pieces = hinges.mechanics.plant, hinges.mechanics.pieces
    rods = true_rods(finer)
    model, seen = rods.model, observables(rods.model)
    response = observed_response(
        model.rods,
        model.clamp,
        [_held_nodes(rods, hinges)],
        seen.operator,
        FREQUENCIES,
        loss_factor=2 * model.material.damping_ratio,
    )
    force = response.force[:, 0, 2]
    way = np.tile(hinges.direction.astype(np.complex128), (len(FREQUENCIES), 1))
    way[:, 2] = -(force[:, :2] @ hinges.direction[:2]) / force[:, 2]  # no force upwards: the height is free
    strains = np.einsum("qkia,qa->qki", response.vectors[:, 0, seen.strains], way)
    begins = np.full(len(model.rods.nodes), -1)
    begins[rods.first[pieces.first]] = np.arange(len(pieces.first))
    return Shaken(rods, seen, semi_major(strains), hinges, begins)


def _held_nodes(rods: TrueRods, hinges: ShakenPlant) -> NDArray[Any]:
    """Return the nodes of the piece that MuJoCo holds."""
    finer, pieces = hinges.mechanics.plant, hinges.mechanics.pieces
    last = np.append(pieces.first[1:], len(finer.start)) - 1
    middles = (finer.start[pieces.first] + finer.end[last]) / 2
    held = int(np.argmin(np.linalg.norm(middles - hinges.point, axis=1)))
    segments = np.flatnonzero(pieces.body == held)
    first, last = int(rods.first[segments[0]]), int(rods.last[segments[-1]])
    return np.arange(int(rods.model.rods.parent[first]), last + 1)


def strain_rows(plant: SimPlant, piece: float) -> list[StrainRow]:
    """Return the comparison for one plant."""
    both = shaken(plant, piece)
    finer, pieces = both.hinges.mechanics.plant, both.hinges.mechanics.pieces
    loss = 2 * both.rods.model.material.damping_ratio
    hinged = semi_major(both.hinges.bending(FREQUENCIES, loss_factor=loss))
    rows = []
    for kind, observed in _kinds(both, finer).items():
        edges = both.seen.edges[observed]
        starts = np.unique(edges[both.piece[edges] >= 0], return_index=True)[1]
        first = observed[both.piece[edges] >= 0][starts]  # an edge's start comes before its end
        there = both.piece[both.seen.edges[first]]
        radius = np.asarray(both.rods.model.rods.edge_radius)[both.seen.edges[first]]
        section = (finer.radius_start[pieces.first[there]] / radius) ** 3
        for q, frequency in enumerate(FREQUENCIES):
            single, mine = both.reported[q, first], hinged[q, there] * section
            error, counts = float(single.max()) / float(mine.max()) - 1, mine >= COUNTS * mine.max()
            name = f"{plant.species} {plant.seed}"
            rows.append(StrainRow(name, kind, float(frequency), error, (single / mine - 1)[counts]))
    return rows


def _kinds(both: Shaken, finer: SimPlant) -> dict[str, NDArray[Any]]:
    """Return for each kind of limit which of the B strains belong to it; flowers' arms are no pedicels."""
    seen, begin = both.seen, int(both.seen.strains[0])
    tissue = np.asarray(both.rods.model.rods.density)[seen.edges] > 1
    organ = np.full(len(both.rods.model.rods.nodes), -1)
    organ[both.rods.first], organ[both.rods.last] = finer.organ, finer.organ
    kinds = {"stem": seen.stem_strain - begin, "pedicel": seen.joint_strain - begin}
    for name, which in (("petiole base", Organ.PETIOLE), ("peduncle base", Organ.PEDUNCLE), ("fork", Organ.BRANCH)):
        base = seen.base_strain - begin
        kinds[name] = base[organ[seen.edges[base]] == which]
    kinds = {name: observed[tissue[observed]] for name, observed in kinds.items()}
    return {name: observed for name, observed in kinds.items() if len(observed)}


KINDS = ("stem", "pedicel", "petiole base", "peduncle base", "fork")


def strain_metrics(rows: list[StrainRow]) -> dict[str, float]:
    """Return the errors over all plants, over frequencies up to 5 Hz, and of each kind and frequency."""
    parts = {"": rows, "_to_5hz": [row for row in rows if row.frequency <= 5]}
    for kind, frequency in product(KINDS, FREQUENCIES.tolist()):
        mine = [row for row in rows if (row.kind, row.frequency) == (kind, frequency)]
        parts |= {f"_{kind.replace(' ', '_')}_{frequency:g}hz": mine} if mine else {}
    out: dict[str, float] = {}
    for part, mine in parts.items():
        largest, places = np.abs([row.error for row in mine]), np.abs(np.concatenate([row.places for row in mine]))
        found = {
            "error_median": np.median(largest),
            "error_p90": np.quantile(largest, 0.9),
            "error_max": largest.max(),
            "places_error_median": np.median(places),
            "places_error_p90": np.quantile(places, 0.9),
        }
        out |= {f"strain_{name}{part}": float(value) for name, value in found.items()}
    return out


def strain_table(found: dict[str, float]) -> Table:
    """Return the errors by kind and frequency, from `strain_metrics`."""
    parts = {f"{kind.replace(' ', '_')}_{hz:g}hz": f"{kind}, {hz:g} Hz" for kind, hz in product(KINDS, FREQUENCIES)}
    numbers = {
        "largest: median": "strain_error_median_*:.1%",
        "worst": "strain_error_max_*:.1%",
        "places: median": "strain_places_error_median_*:.1%",
        "places: 90 %": "strain_places_error_p90_*:.1%",
    }
    return by_part(found, "strain of", parts, numbers)
