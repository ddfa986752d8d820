"""A string that holds a stem up: where it hangs, how hard it pulls, and where it lets go of the stem. S stem nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from anther.core.choices import Crop
from anther.core.errors import bad_input
from anther.core.geometry import Array
from anther.core.records import Range, Record, Spread
from anther.perception.cloud import Cloud
from anther.perception.flowers import Flowers
from anther.perception.hanging import StringLine
from anther.perception.skeleton import Skeleton
from anther.perception.stem import Stem
from anther.plant.limits import Believed
from anther.rods import Support

TENSION = {"tomato": Believed.between(40.0, 60.0), "pepper": Believed.between(8.0, 25.0)}
"""Pull of a string at its hook [N] (facts: rows 0 and D, 4 to 6 kg hang on a tomato's); of a pepper's stem a guess."""


Place = tuple[float, float, float]
Ends = tuple[ArrayLike, ArrayLike | None]
"""Where a string hangs and where its stem rises, (3,) each [m]; None: plumb below."""


@dataclass(frozen=True, slots=True)
class HeldString(Record):
    """The string of the asked stem, as far as it is known before anything is seen.

    Attributes:
        hook: where it hangs, world [m]: by the map of the row.
        foot: where the stem rises, world [m]: by the map, where strings slant; None: plumb below the hook.
        tension: of it [N].
        tension_spread: of that [-].
        stretching: EA [N], of twine of 2 mm: a guess.
        others: hook and foot of each string beside it, on which other stems hang [m]; a foot may be None as well.
    """

    CALLED = "string"
    hook: Annotated[tuple[float, float, float], Range(-1e4, 1e4, "m")]
    foot: tuple[float, float, float] | None = None
    tension: Annotated[float, Range(0, 1e3, "N")] = TENSION["tomato"].median
    tension_spread: Spread = TENSION["tomato"].spread
    stretching: Annotated[float, Range(1, 1e6, "N")] = 1500.0
    others: tuple[tuple[Place, Place | None], ...] = ()

    def _check(self) -> None:
        for hook, foot in ((self.hook, self.foot), *self.others):
            if foot is not None and not foot[2] < hook[2]:
                given = f"a foot {foot[2]:g} m up, a hook {hook[2]:g} m up"
                raise bad_input("string", given=given, allowed="a foot below its hook", do="Look at the map.")

    @classmethod
    def of(cls, crop: Crop, hook: ArrayLike, foot: ArrayLike | None = None, others: Sequence[Ends] = ()) -> Self:
        """Return what is believed of the string of a crop's stem: hook and foot (3,) [m], and others', see there."""
        hook_, foot_ = _place(hook), None if foot is None else _place(foot)
        beside = tuple((_place(one), None if end is None else _place(end)) for one, end in others)
        return cls(hook_, foot_, TENSION[crop].median, TENSION[crop].spread, others=beside)

    @property
    def line(self) -> StringLine:
        """Where it runs, by the map."""
        return StringLine(self.hook, self.foot, tuple(StringLine(*ends) for ends in self.others))

    def support(self, node: int, nodes: Array, factor: float = 1.0) -> Support:
        """Return the pull on one of a stem's nodes (N, 3) [m], whose foot is the first, `factor` times as hard.

        It pulls along the stem, since nothing bends what hangs: a hook that the map has 2 cm off would bend it.
        """
        least_height = 0.05  # m of the hook above what its string holds, whatever the map says
        length = max(self.hook[2] - nodes[node, 2], least_height)
        along = nodes[node] - nodes[0]
        return Support.string(node, length / np.linalg.norm(along) * along, factor * self.tension, self.stretching)


def _place(values: ArrayLike) -> Place:
    x, y, z = np.asarray(values, dtype=np.float64).tolist()
    return x, y, z


def straightened(skeleton: Skeleton, stem: Stem, flowers: Flowers, hold: int) -> tuple[Skeleton, Flowers]:
    """Return the plant with its stem straight from the foot to the position `hold` along it; limbs go along.

    Nothing bends what hangs, so it is straight but for what hangs beside it, which a scan does not weigh. Taken as it
    is scanned, a few mm to and fro, a pull of 50 N would twist a model of the stem away. Where the scanned stem turns
    back, its nodes stay in their order, a tenth of their distance apart at least.
    """
    line = skeleton.nodes[stem.node_ids[: hold + 1]]
    length = float(np.linalg.norm(line[-1] - line[0]))
    along = (line[-1] - line[0]) / length
    least = np.append(0.0, np.cumsum(0.1 * np.linalg.norm(np.diff(line, axis=0), axis=1)))
    way = least + np.maximum.accumulate((line - line[0]) @ along - least)
    shift = np.zeros_like(skeleton.nodes)
    shift[stem.node_ids[: hold + 1]] = np.outer(length / way[-1] * way, along) + line[0] - line
    on_stem = np.isin(np.arange(len(shift)), stem.node_ids)
    for j in np.flatnonzero(~on_stem):
        shift[j] = shift[skeleton.parent[j]]
    positions = flowers.positions + shift[flowers.attachment]
    return replace(skeleton, nodes=skeleton.nodes + shift), replace(flowers, positions=positions)


def topmost_hold(nodes: Array, radius: Array, cloud: Cloud | None) -> int:
    """Return the position along a stem of (S, 3) nodes and (S,) radii [m] up to which its string is held by it.

    That is where the highest string that is seen leaves it; where none is seen, its top.
    """
    strings: Sequence[Array] = [] if cloud is None else [s.balls(0.005)[:, :3] for s in cloud.supports if s.soft]
    if not strings:
        return len(nodes) - 1
    beside = 0.01  # m from a stem's surface that a string holds it: a clip is as wide
    near = KDTree(np.vstack(strings)).query(nodes)[0] < radius + beside
    return int(np.flatnonzero(near).max()) if near.any() else len(nodes) - 1
