"""The content of a cloud's file, as stored, and the meaning of its column names. N points."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

from numpy.typing import NDArray

from anther.core.choices import Axis, Units
from anther.core.errors import bad_input
from anther.core.geometry import TO_Z_UP, Array

METRES: dict[str, float] = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "0.01mm": 1e-5, "um": 1e-6, "in": 0.0254, "ft": 0.3048}
_COMMON = ("m", "cm", "mm", "0.01mm")
"""Units that are advised: others are rare."""
MOST_POINTS = 20_000_000
"""Most points of a cloud that is read: with colours and copies some 2 GB. A guess."""
LIKELY = (0.03, 5.0)
"""From a seedling to a vine in a greenhouse [m]. Two units can both be likely: then the user must choose."""


def other_units(size: float, units: str) -> str:
    """Return which units would make a plant of what measures `size` [m] in these, as advice."""
    if units not in METRES:
        return "Wrong scale?"
    sizes = {other: size / METRES[units] * METRES[other] for other in _COMMON if other != units}
    likely = [f"--units {other} ({s:.2g} m)" for other, s in sizes.items() if LIKELY[0] <= s <= LIKELY[1]]
    none = f"In none of {', '.join(_COMMON)} is it one: are the units others?"
    return f"Wrong units? Try {' or '.join(likely)}." if likely else none


class RawPoints(NamedTuple):
    """What a file holds: points (N, 3), NaN allowed, colours (N, 3) uint8, the units and the up axis it states, and
    notes on what in it is not used."""

    points: Array
    colors: NDArray[Any] | None = None
    units: Units | None = None
    up: Axis | None = None
    notes: tuple[str, ...] = ()


_WORDS: dict[Units, str] = {
    "m": "m|met(?:re|er)s?", "cm": "cm|centimet(?:re|er)s?", "mm": "mm|millimet(?:re|er)s?",
    "um": "um|[µμ]m|microns?|micromet(?:re|er)s?", "in": "in|inch(?:es)?", "ft": "ft|foot|feet",
}  # fmt: skip
"""How files write their units."""
_UNIT = re.compile(rf"(.*?)[ _]*[\[(]? *({'|'.join(_WORDS.values())}) *[\])]?", re.IGNORECASE)
_TELLS = re.compile(
    r"unit|anther (?:skeleton|cloud)|\b(?:lengths?|coordinates?|positions?|points) (?:are )?in\b", re.IGNORECASE
)
"""A comment with one of these words and one unit states the file's units."""
_UP = re.compile(r"\b([xyz])[ -]?up\b|\bup(?:[ _-]?axis)?\W{1,3}\+?([xyz])\b", re.IGNORECASE)
_PLACE = re.compile(
    r"(?:points?|pos(?:ition)?|coord(?:inate)?s?|vertex|loc(?:ation)?|p)?[ _.:-]*([xyz])[ _.-]*"
    r"(?:coord(?:inate)?|pos(?:ition)?)?|(?:points?|pos(?:ition)?|coord(?:inate)?s?)[ _:]*([012])",
    re.IGNORECASE,
)


def places(names: Sequence[str]) -> tuple[list[int] | None, Units | None]:
    """Return which columns hold x, y and z by their names, None where that is not stated, and the units they state.

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
    units: set[Units | None] = {unit_of(unit) for _, _, unit in best}
    if len(units) > 1:
        given = f"columns {', '.join(names[column] for _, column, _ in best)}"
        raise bad_input("columns", given=given, allowed="x, y and z in one unit", do="Scale them alike, and name them.")
    return [column for _, column, _ in best], units.pop()


def unit_of(word: str) -> Units | None:
    """Return the unit that a word names, None if it is none."""
    return next((unit for unit, words in _WORDS.items() if re.fullmatch(words, word.strip(), re.IGNORECASE)), None)


def stated(comments: Sequence[str]) -> tuple[Units | None, Axis | None]:
    """Return the units and the axis up that comments of a file state, such as "units: mm" or "metres, z up"."""
    units: set[Units] = set()
    for line in filter(_TELLS.search, comments):
        words = re.findall(r"[^\W\d_]+", re.sub(r"\bin(?= \w)", "", line))
        found: set[Units] = {unit for unit in map(unit_of, words) if unit}
        units |= found if len(found) == 1 else set()
    axes = {(match[1] or match[2]).lower() for line in comments for match in _UP.finditer(line)}
    up: Axis | None = next((axis for axis in TO_Z_UP if axes == {axis}), None)
    return units.pop() if len(units) == 1 else None, up


def unused_note(names: Sequence[str]) -> tuple[str, ...]:
    """Return a note on columns of a file that are not used, if there are any."""
    return (f"not used of the file: {', '.join(names)}",) if names else ()
