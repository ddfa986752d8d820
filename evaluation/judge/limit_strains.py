"""Strains of the same shaken rods in two codes: what Anther reports, and what the hinges of MuJoCo carry.

The rods are cut where MuJoCo's rigid pieces are, and held by the same piece of the stem, whose height is free. Q
frequencies, B strains that are observed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from anther.core import Array
from anther.pollination.shake.observables import Observables, observables, semi_major
from anther.pollination.shake.pads import Pads, grip_rows, pad_nodes
from anther.pollination.shake.search import Version, gains
from anther.rods import observed_response
from anther.sim import Organ, SimPlant, plant_mechanics
from evaluation.judge.finer_plant import divided
from evaluation.judge.limit_rods import TrueRods, bare, true_rods
from evaluation.prediction.shaken_plant import Params, ShakenPlant
from evaluation.tables import markdown

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
        reported: the largest that Anther reports per metre of grip motion [1/m].
        error: of the largest, Anther's over MuJoCo's less 1, with the same hysteretic damping in both codes, and the
            same radius: that in the middle of an edge.
        error_section: of what Anther reports, where MuJoCo's sections have the radius of the very place.
        error_own_damping: the first with MuJoCo's own damping, a ratio for each mode.
        places: (n,) the first of single places (a stem's piece, a pedicel's, a base), as far as they count.
    """

    plant: str
    kind: str
    frequency: float
    reported: float
    error: float
    error_section: float
    error_own_damping: float
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
    same, own = (semi_major(both.hinges.bending(FREQUENCIES, loss_factor=damped)) for damped in (loss, None))
    rows = []
    for kind, observed in _kinds(both, finer).items():
        edges = both.seen.edges[observed]
        starts = np.unique(edges[both.piece[edges] >= 0], return_index=True)[1]
        first = observed[both.piece[edges] >= 0][starts]  # an edge's start comes before its end
        there = both.piece[both.seen.edges[first]]
        radius = np.asarray(both.rods.model.rods.edge_radius)[both.seen.edges[first]]
        section = (finer.radius_start[pieces.first[there]] / radius) ** 3
        for q, frequency in enumerate(FREQUENCIES):
            single, mine, damped = both.reported[q, first], same[q, there] * section, own[q, there] * section
            reported, counts = float(both.reported[q, observed].max()), mine >= COUNTS * mine.max()
            largest, tapered = float(single.max()), float(same[q, there].max())
            rows.append(
                StrainRow(
                    f"{plant.species} {plant.seed}",
                    kind,
                    float(frequency),
                    reported,
                    largest / float(mine.max()) - 1,
                    reported / tapered - 1,
                    largest / float(damped.max()) - 1,
                    (single / mine - 1)[counts],
                )
            )
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


def strain_table(rows: list[StrainRow]) -> Table:
    """Return the errors by kind and frequency, over the plants."""
    heads = ("largest: median", "worst", "tapered sections, worst", "MuJoCo's own damping, worst")
    table = markdown(["strain of", "Hz", "plants", *heads, "places: median", "places: 90 %"])
    for kind in dict.fromkeys(row.kind for row in rows):
        for frequency in FREQUENCIES:
            mine = [row for row in rows if (row.kind, row.frequency) == (kind, frequency)]
            shown = list(_errors(mine).values())
            table.add_row(kind, f"{frequency:g}", str(len(mine)), *(f"{100 * value:.1f} %" for value in shown))
    return table


def _errors(rows: list[StrainRow]) -> dict[str, float]:
    largest, section, own = (
        np.abs([getattr(row, name) for row in rows]) for name in ("error", "error_section", "error_own_damping")
    )
    places = np.abs(np.concatenate([row.places for row in rows]))
    return {
        "error_median": float(np.median(largest)),
        "error_max": float(largest.max()),
        "error_section_max": float(section.max()),
        "error_own_damping_max": float(own.max()),
        "places_error_median": float(np.median(places)),
        "places_error_p90": float(np.quantile(places, 0.9)),
    }


def strain_metrics(rows: list[StrainRow]) -> dict[str, float]:
    """Return the errors over all plants, kinds and frequencies, and over those up to 5 Hz."""
    out: dict[str, float] = {}
    for band, highest in (("", np.inf), ("_to_5hz", 5.0)):
        mine = [row for row in rows if row.frequency <= highest]
        largest = np.abs([row.error for row in mine])
        out |= {f"strain_{name}{band}": value for name, value in _errors(mine).items()}
        out[f"strain_error_p90{band}"] = float(np.quantile(largest, 0.9))
        out[f"strain_within_5{band}"] = float(np.mean(largest <= 0.05))
    return out


SPREAD_AT = np.geomspace(1, 35, 40)
HEIGHTS = np.linspace(0.2, 0.8, 7)
FIRM = Pads(width=0.01, stiffness=1e9, turning=1e6, stiffness_spread=0, turning_spread=0)


def strain_per_acceleration(plant: SimPlant, piece: float) -> Array:
    """Return (Q, G, D) the largest pedicel strain per acceleration of the grip [s2/m], beyond 10 Hz as at 10 Hz.

    At `SPREAD_AT`, for seven heights and eight directions; the pads hold 10 mm of the stem, in every direction.
    """
    model = true_rods(divided(plant, piece)[0]).model
    rows = np.searchsorted(model.arc_length, HEIGHTS * model.arc_length[-1])
    pads = pad_nodes(model, grip_rows(model, model.rods.nodes[model.stem_nodes[rows]]), FIRM.width)
    angle = np.arange(8) * np.pi / 8
    ways = np.tile(np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1), (len(pads), 1, 1))
    omega = 2 * np.pi * SPREAD_AT[:, None, None]
    strain = gains([Version(model, FIRM)], pads, ways, SPREAD_AT).joint_strain[0]
    return strain / (omega * np.minimum(omega, 20 * np.pi))
