"""A row whose tomatoes grew in Helios, a generator that shares nothing with Anther's own, for visits of whole rows.

Helios decides every node, radius, organ and triangle of a plant, how many trusses flower, and how large its fruit is.
What growers do to a plant is done to it: side shoots are taken out each week, fruit below the topmost 5 to 9 trusses of
it is picked, a plant without a flower gives way to another. Helios's stems stand free and lean; here each is shifted to
where its string holds it (its tip by 0.3 m in the median of 30 plants, by 0.9 m at most), and what grows on it is
shifted along, not turned. Crops are half a year old at most and 2.0 to 2.6 m tall: where the wire is high, a metre of
string hangs free above them. They weigh 1.3 to 4.4 kg, so strings pull with 13 to 47 N, less than the 40 to 60 N that
the robot believes.

What Helios does not know is drawn as for Anther's own rows (`anther.sim.row_plants`, `anther.sim.growth`): string and
clips, the stem that lies before the holder, the tissue's stiffness, mass per area of leaf and per volume of fruit, the
thickness of peduncles that bear fruit (Helios's are 1.5 mm thin), and the frequency of flowers on their stalks.

Helios's flowers are about twice as large as real ones, on stalks of 2 to 3 cm. Its peppers, trained to one stem, had no
flower within half a year (two plants), so there is no row of them. Needs pyhelios3d: pip install 'anther[evaluation]'.
"""

from __future__ import annotations

from itertools import count

import numpy as np

from anther.core.geometry import Array
from anther.sim.growth import AREAL_DENSITY, Growth
from anther.sim.mesh import unit
from anther.sim.plant import Organ, Pot, SimPlant
from anther.sim.row import Row, grow_row
from anther.sim.row_plants import FRUIT_DENSITY, HABIT, Place, axis_of, grow_flesh, grow_lying_stem, hanging_axis, hung
from anther.sim.tomato import SEPAL_GREEN
from evaluation.perception.helios import Limb, Surface, train_helios

SIDES = 7
"""Of a tube of Helios's."""
YOUNGEST = 0.01
"""Leaves and trusses whose stalks are shorter are left out: they are buds [m]; a guess."""
WOODY = 1e9
"""Young's modulus of what bears fruit [Pa]: as in `anther.sim.row_plants`, a guess."""


def grow_helios_row(seed: int, plants: int | None = None) -> Row:
    """Grow a row of Helios's tomatoes where `anther.sim.grow_row` has its own; all else that stands there is the same.

    Raises:
        MissingExtra: pyhelios3d is not installed.
    """
    return grow_row("tomato", seed, plants, hanging_helios)


def hanging_helios(seed: int, place: Place) -> SimPlant:
    """Return a tomato of Helios's on its string. Its head hangs where a row's own tomato has its topmost open truss."""
    rng = np.random.default_rng([seed, 18])
    habit = {name: spread.draw(rng) for name, spread in HABIT["tomato"].items()}
    length = float(place.hook[2] - place.foot[2]) - habit["hook_to_flower"]
    sown = (train_helios(seed + 1_000_000 * k, length) for k in count())
    grown = next(plant for plant in sown if any(limb.flowers for limb in plant.peduncles))
    growth, raw = Growth(rng), axis_of(grown.stem.nodes)
    axis = hanging_axis(place, rng, length=float(raw.arc[-1]), lifted=habit["lifted"])
    straight, colour = axis.at(raw.arc / raw.arc[-1] * axis.arc[-1]), grown.stem.colour
    stem = growth.chain(straight, grown.stem.radii, Organ.STEM, -1, colour, sides=SIDES)
    segments = np.arange(stem[-1] + 1)
    laden = sorted((limb for limb in grown.peduncles if limb.fruits), key=lambda limb: -limb.nodes[0, 2])
    trusses = [limb for limb in grown.peduncles if not limb.fruits] + laden[: int(habit["fruit_trusses"])]
    for grow, limbs in ((_grow_leaf, grown.petioles), (_grow_truss, trusses)):
        for limb in limbs:
            node = int(np.argmin(np.linalg.norm(grown.stem.nodes - limb.nodes[0], axis=1)))
            grow(growth, limb, stem[max(node - 1, 0)], straight[node] - grown.stem.nodes[node])
    grow_lying_stem(growth, place, float(grown.stem.radii[0]), habit)
    plant = growth.plant("tomato", seed, np.eye(4), Pot(place.foot, 0.0))
    return hung(plant, [(segments, place.hook)], habit, rng)


def _grow_leaf(growth: Growth, limb: Limb, parent: int, way: Array) -> None:
    """Grow a petiole with its leaflets, `way` (3,) from where Helios has it [m]."""
    nodes, radii, tube = limb.nodes + way, limb.radii, {"colour": limb.colour, "sides": SIDES}
    if np.linalg.norm(nodes[-1] - nodes[0]) < YOUNGEST:
        return
    petiole = growth.chain(nodes[:2], radii[:2], Organ.PETIOLE, parent, **tube, tip=False)
    pieces = petiole + growth.chain(nodes[1:], radii[1:], Organ.RACHIS, petiole[-1], **tube)
    line = axis_of(nodes)
    for leaflet in limb.leaflets:
        piece = pieces[min(int(np.searchsorted(line.arc[1:], leaflet.along)), len(pieces) - 1)]
        segment = growth.beside(piece, line.at(leaflet.along))
        vertices = leaflet.vertices + way
        growth.surface((vertices, leaflet.faces), Organ.LEAF, leaflet.colour, segment)
        growth.carry(segment, AREAL_DENSITY * leaflet.area, vertices.mean(axis=0))


def _grow_truss(growth: Growth, limb: Limb, parent: int, way: Array) -> None:
    """Grow a peduncle with its flowers and fruit, `way` (3,) from where Helios has it [m]."""
    line, borne = axis_of(limb.nodes + way), (*limb.flowers, *limb.fruits)
    if line.arc[-1] < YOUNGEST:
        return
    stops = np.unique(np.concatenate([line.arc[1:], [part.along for part in borne]]))
    stops = stops[np.diff(stops, prepend=0.0) > 0.002]
    radii = np.interp(np.concatenate([[0.0], stops]), line.arc, limb.radii)
    woody = None
    if limb.fruits:  # as in `sim.row_plants`: Helios has all peduncles 1.5 mm thin, too thin for fruit
        woody, radii = WOODY, np.maximum(radii, growth.rng.uniform(0.0022, 0.0030))
    points = line.at(np.concatenate([[0.0], stops]))
    peduncle = growth.chain(points, radii, Organ.PEDUNCLE, parent, limb.colour, sides=SIDES, youngs=woody)
    for part in borne:
        holder = peduncle[min(int(np.searchsorted(stops, part.along - 0.002)), len(peduncle) - 1)]
        out = part.middle + way - growth.end(holder)
        (_grow_flower if part in limb.flowers else _grow_fruit)(growth, part, holder, out, way)


def _grow_flower(growth: Growth, flower: Surface, holder: int, out: Array, way: Array) -> None:
    """Grow a flower whose petals are about `out` (3,) from its peduncle [m]; its stalk swings as others do."""
    far = float(np.linalg.norm(out))
    kind = {"length": (far - 0.003, far - 0.003), "mass": (0.05e-3, 0.15e-3), "nod": (0.0, 0.0)}  # as `sim.tomato`
    green = flower.colour[:, 0] < flower.colour[:, 1]
    stalk = flower.colour[green][0]
    pedicel, _, _ = growth.flower(holder, unit(out), stalk, **kind, parts=(0.55, 0.45), widths=(1.05, 1, 1))
    for organ, chosen in ((Organ.PEDICEL, green), (Organ.FLOWER, ~green)):
        faces = flower.faces[chosen[flower.faces[:, 0]]]
        used, renamed = np.unique(faces, return_inverse=True)
        mesh = flower.vertices[used] + way, renamed.reshape(-1, 3).astype(np.int32)
        growth.surface(mesh, organ, flower.colour[used], pedicel)


def _grow_fruit(growth: Growth, fruit: Surface, holder: int, out: Array, way: Array) -> None:
    """Grow a fruit whose middle is `out` (3,) from its peduncle [m]."""
    radius, along = (3 * fruit.volume / (4 * np.pi)) ** (1 / 3), unit(out)
    base, colour = growth.end(holder), fruit.colour[np.argmax(fruit.colour[:, 0] > fruit.colour[:, 1])]
    stalk = np.stack([base, base + out - radius * along])
    pedicel = growth.chain(stalk, [0.0022, 0.0018], Organ.PEDICEL, holder, SEPAL_GREEN, youngs=WOODY, sides=6)[-1]
    mass = FRUIT_DENSITY * fruit.volume
    segment = grow_flesh(growth, pedicel, 1.2 * radius * along, radius, mass, base + out, colour)
    growth.surface((fruit.vertices + way, fruit.faces), Organ.PEDUNCLE, fruit.colour, segment)
