"""Plants as a row grows them: a tomato lowered along a high wire, a pepper with two stems on two strings.

Leaves, flowers and trusses are those of the plants in pots. Row frame [m]: x from the path towards the row, y along it,
z up from the floor. A stem leaves its holder, turns up, and hangs on its string. `HABIT` says what is drawn, from which
range and by what source.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from anther.core.choices import Crop
from anther.core.errors import StageFailure
from anther.core.geometry import Array, arc_length, interpolate
from anther.sim._settling import settle
from anther.sim.growth import GOLDEN_ANGLE, SELF_SUPPORT, Growth, arc, buckling_factor, varied
from anther.sim.mesh import Mesh, join, revolve, transport, tube, unit
from anther.sim.pepper import BRANCH_GREEN, grow_flower
from anther.sim.pepper import grow_leaf as grow_pepper_leaf
from anther.sim.pieces import Params
from anther.sim.plant import Organ, Pot, SimPlant, Twine
from anther.sim.plant_mechanics import alone
from anther.sim.tomato import SEPAL_GREEN, STEM_GREEN, grow_leaf, grow_truss
from anther.sim.truth import Spread, uniform

RGB = tuple[int, int, int]
FRUIT_DENSITY = 1000.0
"""Mostly water [kg/m3]."""
HEAVIEST = {"tomato": 0.25, "pepper": 0.25}
"""Fruit [kg]: beef tomatoes and blocky peppers; an estimate."""
HEAD = np.array([0.33, 0.33, 0.25, 0.17, 0.1])
"""Internodes above the topmost open truss, over the pitch of trusses: they still grow. A guess."""


BOTH: dict[str, Spread] = {
    # share of a string's tension that lifts stem which lies on its holder: a guess
    "lifted": uniform(0.06, 0.15),
    # above the topmost clip or turn of the string the head stands free [m]: it is tied once a week; a guess
    "free_head": uniform(0.10, 0.20),
    # from turn to turn of a wound string [m]: about one to three leaves; a guess
    "turn": uniform(0.08, 0.25),
    # from clip to clip [m] (facts: rows D, NCSU: about 0.3)
    "clips": uniform(0.25, 0.35),
    # stiffness times length of string, polypropylene or jute of 1-2 mm2 and 0.5-2 GPa [N]: a guess
    "twine": Spread(500.0, 4000.0),
}
HABIT: dict[str, dict[str, Spread]] = {
    "tomato": BOTH
    | {
        # what hangs on one string [kg] (facts: rows D, WUR), and so 40-60 N
        "hung_mass": uniform(4.0, 6.0),
        # from the hook down to the topmost open truss [m] (facts: rows D, remembered)
        "hook_to_flower": uniform(0.3, 0.5),
        # of trusses along the stem [m], three leaves from one to the next (facts: rows D, remembered)
        "truss_pitch": uniform(0.20, 0.25),
        # length [m] (facts: rows D; pollination 2: 0.40)
        "leaf": uniform(0.34, 0.46),
        # that are left; the two or three lowest are cut each week (facts: rows D). A guess
        "leaves": uniform(13, 19),
        # of the stem at its foot [m] (facts: rows 0)
        "radius": uniform(0.005, 0.007),
        # a truss a week flowers and is ripe seven weeks later (facts: rows D; the seven a guess)
        "open_trusses": uniform(1, 3),
        "fruit_trusses": uniform(5, 9),
        "fruits": uniform(4, 7),
        # radius in which the stem rises from its holder, and length that lies before it in sight [m]: guesses
        "bend": uniform(0.10, 0.22),
        "lying": uniform(0.3, 1.2),
    },
    "pepper": BOTH
    | {
        # what hangs on one of two strings [kg]: less than of a tomato, a guess
        "hung_mass": uniform(0.8, 2.5),
        # nodes along a stem [m], with a leaf and a flower or fruit each: a guess
        "node_pitch": uniform(0.06, 0.10),
        "leaf": uniform(0.10, 0.17),
        # of the heads above the gutter [m]: stems are not lowered and grow all season; a guess
        "height": uniform(1.3, 2.4),
        "radius": uniform(0.004, 0.0065),
        # nodes that flower, below a head of four that do not yet: a guess
        "open_nodes": uniform(2, 5),
        # share of the nodes below the flowers that bear a fruit: a guess
        "fruit_share": uniform(0.15, 0.45),
        # fork above the holder [m]: a guess
        "fork": uniform(0.15, 0.30),
        # of the two strings of a plant at the wire, along the row [m]: about half a plant's pitch
        "apart": uniform(0.15, 0.25),
    },
}
"""What is drawn of each plant."""


STRINGS: dict[Crop, int] = {"tomato": 1, "pepper": 2}
"""Strings of a plant, each with its own hook and stem."""


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where a plant stands in its row.

    Attributes:
        foot: (3,) on the holder, where the stem leaves it [m].
        hook: (3,) of its string on the wire; of a plant with two strings between them [m].
        lean: (3,) way in which a head that grew past the wire falls, unit, level.
    """

    foot: Array
    hook: Array
    lean: Array


@dataclass(frozen=True, slots=True, eq=False)
class Axis:
    """A stem's axis from its foot to its tip, and the segments that were grown along it.

    Attributes:
        points: (n, 3) close to each other [m].
        arc: (n,) lengths from the foot [m].
        ends: (m,) lengths at which segments end [m].
        segments: (m,) their numbers.
        radii: (m,) at their ends [m].
    """

    points: Array
    arc: Array
    ends: Array = field(default_factory=lambda: np.zeros(0))
    segments: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    radii: Array = field(default_factory=lambda: np.zeros(0))

    def at(self, arc: float | Array) -> Array:
        """Return the points (..., 3) at these lengths [m]."""
        return interpolate(arc, self.arc, self.points)

    def segment(self, arc: float | Array) -> NDArray[np.intp]:
        """Return the segments (...) at these lengths [m]; of one that ends there, that."""
        return self.segments[np.clip(np.searchsorted(self.ends, np.asarray(arc) - 1e-6), 0, len(self.segments) - 1)]

    def radius(self, arc: float | Array) -> Array:
        """Return the radii (...) there [m]."""
        return np.asarray(np.interp(arc, self.ends, self.radii))


def axis_of(points: Array) -> Axis:
    """Return the axis through points (n, 3) [m]."""
    return Axis(points, arc_length(points))


def hanging_axis(place: Place, rng: np.random.Generator, *, length: float, lifted: float) -> Axis:
    """Return the axis of a stem that follows the pull of its string from its foot up to the wire, and over it.

    With a weight that is spread evenly over the height, the level force of a slanting string is the same everywhere,
    and the slope is that force over what the section carries: steep near the hook, slanting near the foot. `settle`
    makes it exact once it is known what grew where.

    Args:
        place: of the plant.
        rng: of small waves.
        length: of the axis above the foot [m], measured as if it were upright.
        lifted: share of the tension that is left at the foot [-].
    """
    rise = place.hook[2] - place.foot[2]
    z = np.linspace(0, 1, int(rise / 0.01))
    way = np.log1p(z * (1 - lifted) / lifted) / np.log1p((1 - lifted) / lifted)
    straight = place.foot + np.outer(way, place.hook - place.foot)
    straight[:, 2] = place.foot[2] + rise * z
    wave = 0.004 * np.sin(2 * np.pi * (rise * z[:, None] / rng.uniform(0.25, 0.6, 2) + rng.uniform(0, 1, 2)))  # a guess
    straight[:, :2] += wave * np.clip(z[:, None] * (1 - z[:, None]) * 10, 0, 1)
    top = place.foot[2] + length
    points = straight[straight[:, 2] <= min(top, place.hook[2] - 0.02)]
    if (rest := top - float(points[-1, 2])) > 0.03:
        points = np.vstack([points, _over_the_wire(points[-1], place.lean, rest, rng)])
    return axis_of(points)


def grow_lying_stem(growth: Growth, place: Place, radius: float, habit: Mapping[str, float]) -> None:
    """Grow what lies on the holder before the stem rises, and the bend between: it is woody, and stays where it is."""
    bend, way = habit["bend"], growth.rng.choice([-1.0, 1.0])
    angle = np.linspace(0, np.pi / 2, 16)
    turn = np.stack([0 * angle, way * bend * (np.sin(angle) - 1), -bend * np.cos(angle)], axis=1)
    along = np.linspace(habit["lying"], 0.02, 25)
    wave = 0.01 * np.sin(2 * np.pi * (along / 0.4 + growth.rng.uniform()))
    lying = np.stack([wave * np.clip(along, 0, 1), -way * (bend + along), -bend + 0 * along], axis=1)
    points = place.foot + np.vstack([lying, turn])
    mesh = tube(points, np.full(len(points), 1.05 * radius), sides=10, tip=False)
    colour = (134, 136, 92)
    growth.surface(mesh, Organ.STEM, colour, -1)


def _over_the_wire(top: Array, lean: Array, rest: float, rng: np.random.Generator) -> Array:
    """Return the points of a head that grew past the wire by `rest` [m], and fell over."""
    side = float(np.arctan2(lean[1], lean[0]) + rng.normal(0, 0.4))
    down = np.radians(70 - min(450 * rest, 140))
    return arc(top, side, rest, (np.radians(70), down), max(int(rest / 0.02), 3))[1:]


def grow_axis(growth: Growth, axis: Axis, stops: Array, radii: Array, organ: Organ, parent: int, colour: RGB) -> Axis:
    """Grow segments along an axis that end at `stops` (m,) [m] with `radii` (m + 1,) [m]; return the axis with them."""
    points = axis.at(np.concatenate([[0.0], stops]))
    segments = growth.chain(points, radii, organ, parent, colour, sides=10)
    return replace(axis, ends=stops, segments=np.array(segments), radii=radii[1:])


def _stops(axis: Axis, nodes: Array) -> Array:
    """Return where segments end [m]: at nodes, half way between, and every 4 cm of what is bare."""
    between = (nodes[1:] + nodes[:-1]) / 2
    found = np.sort(np.concatenate([nodes, between, [axis.arc[-1]]]))
    bare = np.linspace(0, found[0], int(np.ceil(found[0] / 0.04)) + 1)[1:-1]
    found = np.concatenate([bare, found])
    return found[np.diff(found, prepend=0.0) > 0.004]


def high_wire_tomato(seed: int, place: Place) -> SimPlant:
    """Return a tomato on a high wire: a bare foot, trusses of fruit, one or two in flower, a head of young leaves."""
    rng = np.random.default_rng([seed, 11])
    habit = {name: spread.draw(rng) for name, spread in HABIT["tomato"].items()}
    growth, pitch = Growth(rng), habit["truss_pitch"]
    over_share = 0.15  # of heads grew past the wire and hang over it: a guess
    over = rng.uniform(0.25, 0.45) if rng.uniform() < over_share else 0.0  # m
    length = place.hook[2] - place.foot[2] - habit["hook_to_flower"] + over + pitch * HEAD.sum()
    axis = hanging_axis(place, rng, length=length, lifted=habit["lifted"])
    nodes = axis.arc[-1] - np.concatenate([[0.004], np.cumsum(pitch * HEAD[::-1])])
    lower = np.arange(nodes[-1] - pitch / 3, 0.35, -pitch / 3)
    nodes = np.concatenate([nodes, lower])
    stops = _stops(axis, nodes[::-1])
    young = np.clip((axis.arc[-1] - np.concatenate([[0.0], stops])) / 0.5, 0, 1)  # grown 0.5 m from the tip: a guess
    radii = habit["radius"] * (0.4 + 0.6 * young)
    axis = grow_axis(growth, axis, stops, radii, Organ.STEM, -1, STEM_GREEN)
    grow_lying_stem(growth, place, habit["radius"], habit)
    azimuth = _grow_tomato_leaves(growth, axis, nodes, habit)
    _grow_trusses(growth, axis, nodes, habit, azimuth)
    plant = growth.plant("tomato", seed, np.eye(4), Pot(place.foot, 0.0))
    return hung(plant, [(axis.segments, place.hook)], habit, rng)


def _grow_tomato_leaves(growth: Growth, axis: Axis, nodes: Array, habit: Mapping[str, float]) -> float:
    """Grow the leaves that were not cut, and side shoots; return the azimuth [rad] where the lowest sits."""
    rng = growth.rng
    azimuth, head = rng.uniform(0, 2 * np.pi), len(HEAD)
    shoot_share = 0.12  # of the leaves below the head have a shoot in their axil: a guess
    for number, arc_ in enumerate(nodes[: int(habit["leaves"])]):
        azimuth -= GOLDEN_ANGLE + rng.normal(0, np.radians(8))
        grown = min((number + 1) / (head + 2), 1.0) ** 0.8
        size = float(np.clip(habit["leaf"] * grown * rng.uniform(0.9, 1.1), 0.05, 0.5))
        segment = int(axis.segment(arc_))
        grow_leaf(growth, segment, azimuth, size, float(np.clip(1 - number / 18, 0.1, 1)))
        if head < number and rng.uniform() < shoot_share:
            _grow_side_shoot(growth, segment, azimuth + 0.3)
    return azimuth


def _grow_side_shoot(growth: Growth, parent: int, azimuth: float) -> None:
    """A shoot in a leaf's axil, 4 to 12 cm long, with three small leaves."""
    rng = growth.rng
    line = arc(growth.end(parent), azimuth, rng.uniform(0.04, 0.12), (0.7, 1.3), 3)
    shoot = growth.chain(line, np.linspace(0.002, 0.0012, 4), Organ.BRANCH, parent, SEPAL_GREEN)
    for k, segment in enumerate(shoot):
        grow_leaf(growth, segment, azimuth + k * GOLDEN_ANGLE, rng.uniform(0.05, 0.09), 1.0)


def _grow_trusses(growth: Growth, axis: Axis, nodes: Array, habit: Mapping[str, float], azimuth: float) -> None:
    """Grow a truss of buds in the head, the open ones, and below them fruit that weighs what is missing on the string.

    Trusses sit half way between two leaves, every third internode.
    """
    rng, head, count = growth.rng, len(HEAD), int(habit["open_trusses"])
    places = [(nodes[n] + nodes[n + 1]) / 2 for n in range(head, len(nodes) - 1, 3)]
    bud = (nodes[head - 3] + nodes[head - 2]) / 2
    for order, place in [(3, bud), *enumerate(places[:count])]:
        turn = rng.uniform(0, 2 * np.pi) if order == 3 else azimuth + np.pi + order * GOLDEN_ANGLE
        grow_truss(growth, int(axis.segment(place)), turn, order)
    laden = places[count : count + int(habit["fruit_trusses"])]
    fruits = [int(habit["fruits"]) + int(rng.integers(-1, 2)) for _ in laden]
    age = (np.arange(len(laden)) + 1) / max(len(laden), 1)
    size = np.clip(age * 1.3, 0, 1) ** 1.5
    missing = habit["hung_mass"] * (1 - habit["lifted"]) - growth.mass
    full = min(max(missing, 0.2) / float(np.dot(size, fruits)), HEAVIEST["tomato"])
    for k, place in enumerate(laden):
        turn = azimuth + np.pi + (count + k) * GOLDEN_ANGLE
        _grow_fruit_truss(growth, int(axis.segment(place)), turn, fruits[k], full * size[k], float(age[k]))


def _grow_fruit_truss(growth: Growth, parent: int, azimuth: float, count: int, mass: float, age: float) -> None:
    """A peduncle that its fruit pulled down, with `count` fruits of about `mass` [kg], ripe where age is 1."""
    rng = growth.rng
    radius = (3 * mass / (4 * np.pi * FRUIT_DENSITY)) ** (1 / 3)
    at = np.concatenate([[0, 0.2, 0.4], 0.4 + 0.6 * (np.arange(1, count) / (count - 1))]) if count > 1 else [0, 0.5, 1]
    length = 0.06 + 0.55 * radius * count
    knee = arc(growth.end(parent), azimuth, 0.06, (np.radians(20), np.radians(-85)), 12)
    fine = axis_of(np.vstack([knee, knee[-1] - [0, 0, length]]))
    points = fine.at(np.array(at) * fine.arc[-1])
    width = rng.uniform(0.0022, 0.0030) * (1 - 0.4 * np.array(at))
    # what bore fruit is woody (a guess), and bent where it had to
    peduncle = growth.chain(points, width, Organ.PEDUNCLE, parent, STEM_GREEN, sides=7, youngs=1e9)
    for i in range(count):
        k = min(1 + i, len(peduncle) - 1)
        forward = unit(points[k + 1] - points[k])
        side = (-1.0) ** i * np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        out = unit(side + 0.3 * forward + np.array([np.cos(azimuth), np.sin(azimuth), 0]) * rng.uniform(-0.2, 0.5))
        ripe = np.clip(6 * (age - 0.85) + rng.normal(0, 0.25) - 0.1 * i, 0, 1)
        colour = (1 - ripe) * np.array((126, 158, 78)) + ripe * np.array((196, 44, 26))
        grow_fruit(growth, peduncle[k], out, mass * rng.uniform(0.85, 1.1), colour, stretch=0.92)


def grow_fruit(growth: Growth, parent: int, out: Array, mass: float, colour: Array, *, stretch: float) -> None:
    """A fruit on its pedicel that hangs from it: a segment as thick as it, and a mass at its centre.

    Args:
        growth: the plant.
        parent: segment it grows from the end of.
        out: (3,) unit vector of the pedicel.
        mass: [kg].
        colour: (3,) sRGB.
        stretch: its length over its width.
    """
    base, radius = growth.end(parent), (3 * mass / (4 * np.pi * FRUIT_DENSITY * stretch)) ** (1 / 3)
    stalk = np.stack([base, base + growth.rng.uniform(0.012, 0.02) * out])
    pedicel = growth.chain(stalk, [0.0022, 0.0018], Organ.PEDICEL, parent, SEPAL_GREEN, sides=6, tip=False)[-1]
    down = unit(out + np.array([0, 0, -1.4]))
    centre = stalk[1] + 0.93 * radius * stretch * down
    segment = grow_flesh(growth, pedicel, 1.2 * radius * stretch * down, radius, mass, centre, colour)
    vertices, faces = _berry(radius, stretch)
    first, second, axis = _frame(down)
    vertices = centre + vertices[:, :1] * first + vertices[:, 1:2] * second + vertices[:, 2:] * axis
    growth.surface((vertices, faces), Organ.PEDUNCLE, np.asarray(colour), segment)


def grow_flesh(
    growth: Growth, pedicel: int, way: Array, radius: float, mass: float, centre: Array, colour: Array
) -> int:
    """Grow a segment nearly as thick as a fruit at the end of its pedicel, `way` (3,) long [m]; return it.

    It carries what it lacks of `mass` [kg] at `centre` (3,) [m].
    """
    line, widths = growth.end(pedicel) + np.outer([0.0, 1.0], way), radius * np.array([0.4, 0.85])
    flesh = {"youngs": 1e7, "sides": 5}  # stiffer than all that holds it
    segment = growth.chain(line, widths, Organ.PEDICEL, pedicel, colour, **flesh)[-1]  # type: ignore[arg-type]
    core = FRUIT_DENSITY * np.pi * float(np.linalg.norm(way)) * float(widths @ widths + widths.prod()) / 3
    growth.carry(segment, max(mass - core, 0.1 * mass), centre)
    return segment


def _berry(radius: float, stretch: float) -> Mesh:
    """Return the mesh of a fruit about the origin, its stalk at -z, with a dent there [m]."""
    angle = np.linspace(0, np.pi, 11)
    width = radius * np.sin(angle)
    height = -radius * stretch * np.cos(angle) * (1 - 0.18 * np.exp(-((angle / 0.35) ** 2)))
    return revolve(np.stack([np.maximum(width, 1e-5), height], axis=1), sides=14)


def _frame(axis: Array) -> tuple[Array, Array, Array]:
    """Return three unit vectors at right angles, the last along `axis`."""
    first = unit(np.cross(axis, [0.31, 0.52, 0.2]))
    return first, np.cross(axis, first), axis


def string_pepper(seed: int, place: Place) -> SimPlant:
    """Return a pepper of two stems, each on a string of its own; its main stem is the first of them."""
    rng = np.random.default_rng([seed, 12])
    habit = {name: spread.draw(rng) for name, spread in HABIT["pepper"].items()}
    growth = Growth(rng)
    trunk = axis_of(place.foot + np.linspace(0, habit["fork"], 6)[:, None] * [0, 0, 1.0])
    thick = np.full(len(trunk.arc), 1.35 * habit["radius"])
    trunk = grow_axis(growth, trunk, trunk.arc[1:], thick, Organ.STEM, -1, (104, 132, 66))
    first = rng.choice([-1.0, 1.0])
    stems, places = [], list[int]()
    for organ, side in ((Organ.STEM, first), (Organ.BRANCH, -first)):
        hook = place.hook + np.array([0, side * habit["apart"] / 2, 0])
        fork = Place(trunk.points[-1], hook, place.lean)
        top = habit["height"] * rng.uniform(0.92, 1.0) - habit["fork"]
        axis, nodes = _grow_pepper_stem(growth, fork, habit, organ, int(trunk.segments[-1]), top)
        stems.append((axis.segments, hook))
        below = nodes[5 + int(habit["open_nodes"]) :]
        places += [int(axis.segment(arc_)) for arc_ in below if rng.uniform() < habit["fruit_share"]]
    _grow_pepper_fruit(growth, habit, places)
    plant = growth.plant("pepper", seed, np.eye(4), Pot(place.foot, 0.0))
    return hung(plant, stems, habit, rng)


def _grow_pepper_stem(
    growth: Growth, fork: Place, habit: Mapping[str, float], organ: Organ, parent: int, length: float
) -> tuple[Axis, Array]:
    """Grow a stem from the fork with its leaves and flowers; return its axis and its nodes (n,) from the tip [m]."""
    rng = growth.rng
    length = min(length, float(fork.hook[2] - fork.foot[2]) - 0.05)
    axis = hanging_axis(fork, rng, length=length, lifted=habit["lifted"])
    pitch = habit["node_pitch"]
    steps = pitch * np.concatenate([[0.15, 0.25, 0.5, 0.8], np.ones(int(axis.arc[-1] / pitch) + 1)])
    nodes = axis.arc[-1] - 0.003 - np.concatenate([[0.0], np.cumsum(steps)])
    nodes = nodes[nodes > 0.05]
    stops = _stops(axis, nodes[::-1])
    young = np.clip((axis.arc[-1] - np.concatenate([[0.0], stops])) / 0.4, 0, 1)
    axis = grow_axis(growth, axis, stops, habit["radius"] * (0.4 + 0.6 * young), organ, parent, BRANCH_GREEN)
    azimuth = rng.uniform(0, 2 * np.pi)
    for number, arc_ in enumerate(nodes):
        azimuth += GOLDEN_ANGLE + rng.normal(0, np.radians(10))
        grown, segment = min((number + 2) / 7, 1.0), int(axis.segment(arc_))
        bare = 1 - 0.6 * max(1 - arc_ / 0.5, 0)  # few leaves are left near the foot: a guess
        if rng.uniform() < bare:
            size = max(habit["leaf"] * grown * rng.uniform(0.85, 1.15), 0.02)
            grow_pepper_leaf(growth, segment, azimuth, size, young=1 - grown)
            if number > 4:  # of the side shoot, which was stopped after its first leaf
                grow_pepper_leaf(growth, segment, azimuth + rng.uniform(0.4, 0.9), 0.8 * size, young=0.2)
        if 3 <= number < 3 + int(habit["open_nodes"]):
            grow_flower(growth, segment, unit([np.cos(azimuth + 2.4), np.sin(azimuth + 2.4), 0.2]))
    return axis, nodes


def _grow_pepper_fruit(growth: Growth, habit: Mapping[str, float], places: Sequence[int]) -> None:
    """Grow fruit from the ends of these segments; it weighs what is missing on the strings."""
    rng = growth.rng
    missing = 2 * habit["hung_mass"] * (1 - habit["lifted"]) - growth.mass
    full = min(max(missing, 0.1) / max(len(places), 1), HEAVIEST["pepper"])
    for segment in places:
        turn, ripe = rng.uniform(0, 2 * np.pi), float(rng.uniform() < 0.3)
        colour = (1 - ripe) * np.array((62, 112, 44)) + ripe * np.array((204, 48, 24))
        out = unit([np.cos(turn), np.sin(turn), -0.3])
        grow_fruit(growth, segment, out, full * rng.uniform(0.6, 1.0), colour, stretch=1.35)


def _twine_mesh(
    line: Axis, top: float, hook: Array, habit: Mapping[str, float], rng: np.random.Generator
) -> list[tuple[Mesh, RGB, NDArray[np.intp]]]:
    """Return the meshes of a string up to its hook and of its clips, with colour and segments (n,) they ride on."""
    clipped_share = 0.5  # of strings; the others are wound about. Growers do either (facts: rows D)
    clipped = rng.uniform() < clipped_share
    along = np.arange(min(0.15, 0.3 * top), top, 0.012)
    turn = rng.uniform(0, 2 * np.pi) + (0 * along if clipped else 2 * np.pi * along / habit["turn"])
    points = line.at(along)
    first = transport(points, [0.8, 0.6, 0.1])
    second = np.cross(unit(np.gradient(points, axis=0)), first)
    around = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    twine = 0.001  # m, its radius: an estimate, as `evaluation.perception.scene_plants` has it
    beside = points + (line.radius(along) + 1.2 * twine)[:, None] * around
    string = np.vstack([beside, np.linspace(beside[-1], hook, 12)[1:]])
    rides = np.repeat(np.concatenate([line.segment(along), np.full(11, -1)]), 5)
    twine_white, clip_white = (232, 230, 222), (198, 208, 210)
    found: list[tuple[Mesh, RGB, NDArray[np.intp]]] = [
        (tube(string, np.full(len(string), twine), sides=5, tip=False), twine_white, rides)
    ]
    for arc_ in np.arange(top - 0.006, 0.3, -habit["clips"]) if clipped else ():
        width = float(line.radius(arc_)) + 2.5 * twine
        ring = tube(line.at(arc_ + np.array([-0.006, 0.006])), [width, width], sides=10, tip=False)
        found.append((ring, clip_white, np.full(20, line.segment(arc_))))
    return found


def hung(
    plant: SimPlant,
    stems: Sequence[tuple[NDArray[np.intp], Array]],
    habit: Mapping[str, float],
    rng: np.random.Generator,
) -> SimPlant:
    """Return a plant hung on its strings: each stem settles where its string holds it, and the strings are drawn.

    Args:
        plant: as it grew.
        stems: segments (m,) of each stem from its foot to its tip, and where its hook is wanted (3,) [m].
        habit: what was drawn of it.
        rng: how the string is laid.
    """
    meshes, twines = [], []
    for segments, wanted in stems:
        heights = plant.end[segments, 2]
        from_tip = np.cumsum(plant.length[segments][::-1])[::-1] - plant.length[segments]
        top = int(np.flatnonzero((from_tip >= habit["free_head"]) & (heights < wanted[2] - 0.12)).max())
        plant, tension, hook = settle(plant, segments, top, wanted, habit["lifted"])
        points = np.vstack([plant.start[segments[:1]], plant.end[segments]])
        line = axis_of(points)
        line = replace(line, ends=line.arc[1:], segments=segments, radii=plant.radius_end[segments])
        meshes += _twine_mesh(line, float(line.ends[top]), hook, habit, rng)
        length = float(np.linalg.norm(hook - points[top + 1]))
        twines.append(Twine(hook, int(segments[top]), tension, habit["twine"] / length))
    bend_over_twist = 4.0  # EI/GJ: between a round bar's 1.5 and a petiole's 12 (facts: pollination 2); a guess
    return replace(with_meshes(plant, meshes, rng), twines=tuple(twines), bend_over_twist=bend_over_twist)


def with_meshes(
    plant: SimPlant, meshes: Sequence[tuple[Mesh, RGB, NDArray[np.intp]]], rng: np.random.Generator
) -> SimPlant:
    """Return the plant with meshes of strings added, each with a colour and the segments (n,) its vertices ride on."""
    vertices, faces = join([mesh for mesh, _, _ in meshes])
    return replace(
        plant,
        vertices=np.vstack([plant.vertices, vertices]),
        faces=np.vstack([plant.faces, faces + len(plant.vertices)]),
        face_organ=np.concatenate([plant.face_organ, np.full(len(faces), Organ.BENCH)]),
        vertex_color=np.vstack([plant.vertex_color, *(varied(c, len(mesh[0]), rng) for mesh, c, _ in meshes)]),
        vertex_segment=np.concatenate([plant.vertex_segment, *(rides for _, _, rides in meshes)]),
    )


def held_by_string(plant: SimPlant, cut: Params | None = None) -> SimPlant:
    """Return the plant, as stiff as it has to be to hang on its strings as it grew.

    What branches off its stems holds itself up by `SELF_SUPPORT`; and where what it carries would twist it, all of it
    is stiffened. `cut`: pieces into which it is cut besides, see `anther.sim.pieces`.

    Raises:
        StageFailure: "no_convergence": it does not hang as it grew, however stiff it is.
    """
    trunk, pedicel = np.isin(plant.organ, (Organ.STEM, Organ.BRANCH)), plant.organ == Organ.PEDICEL
    rigid = replace(plant, youngs=np.where(trunk, 1e15, plant.youngs), foot=np.inf)  # strings hold the stems
    factor = max(SELF_SUPPORT / buckling_factor(rigid), 1.0)
    plant = replace(plant, youngs=np.where(trunk | pedicel, plant.youngs, factor * plant.youngs))
    for _ in range(24):  # 1.25^24 is 212
        try:
            for pieces in {Params(), cut or Params()}:
                alone(plant, pieces)
        except StageFailure:
            plant = replace(plant, youngs=np.where(pedicel, plant.youngs, 1.25 * plant.youngs))
        else:
            return plant
    raise StageFailure("no_convergence", f"{plant.species} {plant.seed} does not hang on its string as it grew.")
