"""Tables that print as Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from rich.box import MARKDOWN
from rich.console import Console, RenderableType
from rich.table import Table


def markdown(heads: Iterable[str], rows: Iterable[Sequence[object]] = ()) -> Table:
    """Return a table, for `say`."""
    table = Table(*heads, box=MARKDOWN)
    for row in rows:
        table.add_row(*(str(cell).replace("\n", " ") for cell in row))
    return table


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
    return "–" if value is None or value != value else f"{value:.{digits}%}"  # noqa: PLR0124  NaN is not itself


def say(parts: Iterable[RenderableType]) -> None:
    """Print lines and tables as they are: what stands in brackets is a unit, not a style."""
    console = Console(markup=False, highlight=False, emoji=False)
    for part in parts:
        console.print(part)
