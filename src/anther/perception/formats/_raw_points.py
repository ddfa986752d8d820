"""What a cloud's file holds, as it stands there, and what the names of its columns say. N points."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

from numpy.typing import NDArray

from anther.core.choices import Axis, Units
from anther.core.geometry import Array

METRES: dict[str, float] = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "0.01mm": 1e-5}
SMALLEST, LARGEST = 0.005, 20.0
"""What is smaller or larger is no plant [m]: a 0.6 m plant in mm, read as metres, measures 600 m."""
LIKELY = (0.03, 5.0)
"""From a seedling to a vine in a greenhouse [m]. Two units can both be likely: then it is for the person to say."""


def other_units(size: float, units: str) -> str:
    """Return which units would make a plant of what measures `size` [m] in these, as advice."""
    if units not in METRES:
        return "Wrong scale?"
    sizes = {other: size / METRES[units] * metres for other, metres in METRES.items() if other != units}
    likely = [f"--units {other} ({s:.2g} m)" for other, s in sizes.items() if LIKELY[0] <= s <= LIKELY[1]]
    none = f"In none of {', '.join(METRES)} is it one: are the units others?"
    return f"Wrong units? Try {' or '.join(likely)}." if likely else none


class RawPoints(NamedTuple):
    """What a file holds: points (N, 3), NaN allowed, colours (N, 3) uint8, the units and the up axis it states, and
    notes on what in it is not used."""

    points: Array
    colors: NDArray[Any] | None = None
    units: Units | None = None
    up: Axis | None = None
    notes: tuple[str, ...] = ()


_UNIT = re.compile(r"(.*?)[ _]*[\[(]? *(m|cm|mm|metres?|meters?) *[\])]?", re.IGNORECASE)
_PLACE = re.compile(
    r"(?:points?|pos(?:ition)?|coord(?:inate)?s?|vertex|loc(?:ation)?|p)?[ _.:-]*([xyz])[ _.-]*"
    r"(?:coord(?:inate)?|pos(?:ition)?)?|(?:points?|pos(?:ition)?|coord(?:inate)?s?)[ _:]*([012])",
    re.IGNORECASE,
)


def places(names: Sequence[str]) -> tuple[list[int] | None, Units | None]:
    """Return which columns hold x, y and z by their names, None where that is not said, and the units they state.

    They are called x, "X (mm)", x_mm, pos_x, Points:0 ...
    """
    found: dict[int, list[tuple[int, int, str]]] = {0: [], 1: [], 2: []}
    for column, name in enumerate(names):
        with_unit = _UNIT.fullmatch(name.strip())
        options = [(name.strip(), ""), *([(with_unit[1], with_unit[2].lower())] if with_unit else [])]
        for bare, unit in options:
            match = _PLACE.fullmatch(bare)
            if match:
                axis = "xyz".index(match[1].lower()) if match[1] else int(match[2])
                found[axis].append((len(name), column, unit))
                break
    if not all(found.values()):
        return None, None
    best = [min(some) for some in found.values()]
    units = {unit[:1] if unit.startswith("met") else unit for _, _, unit in best}
    told = units.pop() if len(units) == 1 else ""
    return [column for _, column, _ in best], next((unit for unit in ("m", "cm", "mm") if unit == told), None)


def unused_note(names: Sequence[str]) -> tuple[str, ...]:
    """Return a note on columns of a file that are not used, if there are any."""
    return (f"not used of the file: {', '.join(names)}",) if names else ()
