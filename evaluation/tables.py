"""Tables that print as Markdown, most of them of flat metrics.

A number is written into a text as `metric:format`, such as "error_median:.0% (error_p90:.0%)". Where metrics of
several parts have names that differ in one word, such as tomato_error and pepper_error, it stands as * in the text.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

from rich.box import MARKDOWN
from rich.console import Console, RenderableType
from rich.table import Table

METRIC = r"(?P<metric>[\w.-]+):(?P<format>[+.,\d]*[a-z%])"
"""A number in a text."""
MISSING = "–"


def markdown(heads: Iterable[str], rows: Iterable[Sequence[object]] = ()) -> Table:
    """Return a table, for `say`."""
    table = Table(*heads, box=MARKDOWN)
    for row in rows:
        table.add_row(*(str(cell).replace("\n", " ") for cell in row))
    return table


def by_part(found: Mapping[str, float], corner: str, parts: Mapping[str, str], numbers: Mapping[str, str]) -> Table:
    """Return a table of metrics with a row for each part of which anything is known.

    Args:
        found: name -> number.
        corner: heads the words of the parts.
        parts: what * stands for -> words.
        numbers: head -> text of a cell.
    """
    heads, *columns = _columns(found, corner, parts, numbers)
    return markdown(heads, columns)


def by_number(found: Mapping[str, float], corner: str, parts: Mapping[str, str], numbers: Mapping[str, str]) -> Table:
    """Return a table of metrics with a row for each number, and a column for each part of which anything is known."""
    heads, *rows = zip(*_columns(found, corner, parts, numbers), strict=True)
    return markdown(heads, rows)


def _columns(found: Mapping[str, float], corner: str, parts: Mapping[str, str], numbers: Mapping[str, str]) -> list:
    """Return the heads of the numbers, then each part's words and cells."""
    cells = {part: [written(text.replace("*", part), found) for text in numbers.values()] for part in parts}
    known = [(words, *cells[part]) for part, words in parts.items() if set(cells[part]) != {MISSING}]
    return [(corner, *numbers), *known]


def written(text: str, found: Mapping[str, float | None]) -> str:
    """Return a text with its numbers: a dash for one that there is not, or for the text where there is none of them."""
    values = {name: found.get(name) for name, _ in re.findall(METRIC, text)}
    known = {name: value for name, value in values.items() if value is not None and value == value}  # noqa: PLR0124  NaN
    if not known:
        return MISSING
    return re.sub(METRIC, lambda at: format(known[at[1]], at[2]) if at[1] in known else MISSING, text)


def measured(values: Mapping[str, object], words: Mapping[str, str]) -> Table:
    """Return a table of single numbers: what each is, and the number; those that there are not are left out."""
    return markdown(("what", "measured"), [(words[key], number(values[key])) for key in words if key in values])


def number(value: object) -> str:
    """Return a count with its thousands, another number with three digits, a text as it is."""
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"
    return f"{value:,}" if isinstance(value, int) else str(value)


def percent(value: float | None, digits: int = 0) -> str:
    """Return a share in per cent, a dash where there is none."""
    return written(f"share:.{digits}%", {"share": value})


def say(parts: Iterable[RenderableType]) -> None:
    """Print lines and tables as they are: what stands in brackets is a unit, not a style."""
    console = Console(markup=False, highlight=False, emoji=False)
    for part in parts:
        console.print(part)
