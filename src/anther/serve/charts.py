"""Small charts over days, as the numbers of an SVG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date, timedelta

from anther.store.overview import Tally

WIDTH, HEIGHT = 600.0, 100.0
"""Of the SVG's view box; the page stretches it."""


@dataclass(frozen=True, slots=True)
class Bar:
    """One day: its box in the view box, and what it says."""

    x: float
    y: float
    width: float
    height: float
    says: str


@dataclass(frozen=True, slots=True)
class Chart:
    """A chart over days.

    Attributes:
        title: what it shows.
        top: what the top of the chart stands for.
        last: the last known value.
        first_day, last_day: under its corners.
        bars: one a day that has a value.
    """

    title: str
    top: str
    last: str
    first_day: date
    last_day: date
    bars: tuple[Bar, ...]


def charts(days: Sequence[Tally], since: date, until: date) -> list[Chart]:
    """Return visits a day, the share held and unharmed, and what the flowers felt.

    Args:
        days: tallies by day.
        since, until: first and last day of the charts.
    """
    by_day = {day.name: day for day in days}
    visits = {day: float(t.visits) for day, t in by_day.items()}
    shares = {day: 100 * t.good / t.visits for day, t in by_day.items()}
    felt = {day: t.acceleration for day, t in by_day.items() if t.acceleration is not None}
    return [
        _chart("Visits a day", visits, "{:.0f}", since, until),
        _chart("Held and unharmed", shares, "{:.1f} %", since, until, top=100.0),
        _chart("Flowers felt, daily mean", felt, "{:.1f} m/s²", since, until),
    ]


def _chart(title: str, values: dict[date, float], form: str, since: date, until: date, top: float = 0.0) -> Chart:
    count = (until - since).days + 1
    top = top or max(values.values(), default=0.0) or 1.0
    step = WIDTH / count
    bars = [
        Bar(step * k, HEIGHT * (1 - values[day] / top), 0.8 * step, HEIGHT * values[day] / top, f"{day}: {said}")
        for k in range(count)
        if (day := since + timedelta(days=k)) in values and (said := form.format(values[day]))
    ]
    last = form.format(values[max(values)]) if values else "nothing yet"
    return Chart(title, form.format(top), last, since, until, tuple(bars))
