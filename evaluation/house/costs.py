"""What a hectare and ten would take: robots, hours, electricity, storage, money, and what breaks first. No measurement.

    python -m evaluation.house.costs

An arithmetic: seconds of a visit and bytes of a record are read from runs (docs/results), everything else is from a
publication or a company, or is a guess, and says which. The visits that were timed were simulated, by an arm that stood
already: at one plant in a pot, and in a row.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from anther.history import Robot
from anther.show.fleet import Fleet, House, fleet_for
from evaluation.harness import finish, options
from evaluation.house.shift import STEMS_HA
from evaluation.numbers import RESULTS, metrics_of
from evaluation.tables import markdown, number

HOURS, DAYS, SEASON = 6.0, 2.0, 287.0
"""From 10 to 16 h, every second day (facts: pollination, 1d), on 41 weeks of a year (facts: pollination, 3)."""
POWER, CHARGING = 0.4, 0.85
"""An arm, its computer and its cart while they work [kW], and what of the socket's energy they get [-]: guesses."""
VIEW_BYTES = 1280 * 720 * (3 + 2)
"""Colour and depth of a view, not compressed [bytes]."""
STOPS, FETCH = 0.001, 0.5
"""How often a robot stops for good at a stem [-], and how long a person fetches it [h]: guesses of the shift's test."""
WAND, WAND_YEAR = (1.0, 1.7), 25_000
"""Seconds a stem by hand, blower and vibrator (facts: pollination, 5), and A$ a hectare and year (a company's)."""
POLLY = 3.5
"""Robots a hectare of an air-jet robot, and its aim is 1 (a company's; facts: pollination, 3)."""
BOXES = (5, 15)
"""Boxes of bumblebees a hectare: a hive on half an acre, a box on 667 m² (facts: pollination, 5)."""


class Way(NamedTuple):
    """A way to visit a stem: what it is, its views, its seconds without driving, and whether these were timed."""

    name: str
    views: int
    seconds: float
    timed: bool


def ways(results: Path = RESULTS) -> tuple[list[Way], float]:
    """Return the ways to visit a stem, and the seconds of driving and entering rows a stem."""
    grasping, shaking = metrics_of("long/grasping", results), metrics_of("long/shaking", results)
    parts = ("capture", "compute", "reach", "shake", "retreat")
    alone = {views: sum(grasping[f"{part}_{views}_s"] for part in parts) for views in ("30_views", "fast")}
    watched = shaking["robot_s_arm"] - shaking["robot_s_plan"]
    shift = metrics_of("shift", results)
    driving = shift["seconds_per_stem"] - shift["at_a_stem_s"]
    return [
        Way("30 views, watched", 30, alone["30_views"] + watched, True),
        Way("10 views, watched", 10, alone["fast"] + watched, True),
        Way("10 views, plan alone", 10, alone["fast"], True),
        Way("6 views in a row, watched", 6, metrics_of("rows", results)["cycle_s"], True),
        Way("asked for", 6, 12.0, False),
        Way("stretch", 6, 8.0, False),
    ], driving


def house(area: float, way: Way, driving: float) -> House:
    """Return the house of which the growers' page would compute the robots; charging is time of work."""
    robot = Robot("any")
    charging = 1 + robot.charge / robot.battery
    return House(
        area=area, plants=STEMS_HA, hours=HOURS, days=DAYS, season=SEASON, seconds=way.seconds * charging,
        move=driving * charging,
    )  # fmt: skip


PATH = 160.0
"""Length of a path [m] (a company's; facts: rows D)."""


def costs_of(area: float, way: Way, driving: float, record: float) -> dict[str, float]:
    """Return what a house takes, by name.

    Args:
        area: [ha].
        way: how its stems are visited.
        driving: from stem to stem [s].
        record: of a visit in the history [bytes].
    """
    fleet: Fleet = fleet_for(house(area, way, driving))
    worked = fleet.visits * (way.seconds + driving) / 3600
    return {
        "robots": fleet.robots,
        "robots_per_ha": fleet.robots / area,
        "robots_a_path": fleet.robots / (area * 10_000 / House().path / PATH),
        "visits_a_day": fleet.visits,
        "robot_hours_a_day": worked,
        "kwh_a_day": worked * POWER / CHARGING,
        "mwh_a_year": worked * POWER / CHARGING * SEASON / 1000,
        "history_gb_a_year": fleet.visits * SEASON * record / 1e9,
        "images_gb_a_day": fleet.visits * way.views * VIEW_BYTES / 1e9,
        "stops_a_day": fleet.visits * STOPS,
        "fetching_h_a_day": fleet.visits * STOPS * FETCH,
        "wand_h_a_day_low": fleet.visits * WAND[0] / 3600,
        "wand_h_a_day_high": fleet.visits * WAND[1] / 3600,
        "writes_a_second": fleet.visits / (HOURS * 3600),
        "invested": fleet.invested,
        "cost_per_ha": fleet.cost_per_area,
    }


ROWS = {
    "robots": "robots",
    "robots_a_path": "robots a path of 160 m",
    "robot_hours_a_day": "hours of work of all robots a day (h)",
    "kwh_a_day": "electricity a day (kWh)",
    "mwh_a_year": "electricity a year (MWh)",
    "history_gb_a_year": "history a year (GB)",
    "images_gb_a_day": "images a day, if all were kept, not compressed (GB)",
    "stops_a_day": "robots that stop for good a day",
    "fetching_h_a_day": "a person's hours to fetch them a day (h)",
    "writes_a_second": "visits recorded a second",
    "cost_per_ha": "robots a hectare and year, at guessed prices (€)",
}


def _key(name: str) -> str:
    return name.replace(",", "").replace(" ", "_")


def _beside(found: Mapping[tuple[float, str], Mapping[str, float]], choices: list[Way]) -> list[tuple[str, ...]]:
    """Return the lines of the table of other ways to pollinate a hectare."""
    timed, asked = (found[1.0, choices[k].name] for k in (1, 3))
    low, high, fetching = (
        timed[f"{key}_h_a_day{end}"] for key, end in (("wand", "_low"), ("wand", "_high"), ("fetching", ""))
    )
    fetched = f"{fetching:.1f} to fetch robots"
    ours = "this arithmetic"
    return [
        (f"Anther, {choices[1].name}", number(timed["robots"]), fetched, f"€ {timed['cost_per_ha']:,.0f}", ours),
        ("Anther, as asked for", number(asked["robots"]), fetched, f"€ {asked['cost_per_ha']:,.0f}", ours),
        ("air-jet robot (Arugga Polly)", f"{POLLY:g}, aim 1", "a supervisor for 17–20 robots", "not public", "company"),
        ("wand or blower", "0", f"{low:.1f}–{high:.1f}", f"A$ {WAND_YEAR:,}", "hours: a trial; price: company"),
        ("bumblebees", "0", "not known", f"{BOXES[0]}–{BOXES[1]} boxes at a time, no price known", "web"),
    ]


def main() -> None:
    """Read what was measured, compute, print."""
    args = options(__doc__, quick="the same: it takes a second")
    choices, driving = ways()
    fleet = metrics_of("long/fleet")
    record = fleet["megabytes"] * 1e6 / fleet["visits"]
    found = {(area, way.name): costs_of(area, way, driving, record) for area in (1.0, 10.0) for way in choices}
    heads = ["", *(way.name for way in choices)]
    tables = [
        markdown(
            [f"{area:g} ha", *heads[1:]],
            [
                [words, *(number(round(found[area, way.name][key], 3)) for way in choices)]
                for key, words in ROWS.items()
            ],
        )
        for area in (1.0, 10.0)
    ]
    rows = [
        ["seconds a stem", *(f"{way.seconds:.1f}" for way in choices)],
        ["timed", *("simulated" if way.timed else "no" for way in choices)],
        ["driving and entering rows (s)", *[f"{driving:.1f}"] * len(choices)],
    ]
    seconds = markdown(heads, rows)
    beside = markdown(("a hectare", "robots", "a person's hours a day", "a year", "source"), _beside(found, choices))
    metrics = {
        f"{key}_{area:g}ha_{_key(name)}": value for (area, name), costs in found.items() for key, value in costs.items()
    }
    metrics |= {"driving_s": driving, "record_bytes": record, "write_median_ms": fleet["write_median_ms"]}
    metrics |= {f"seconds_{_key(way.name)}": way.seconds for way in choices}
    small, large = tables
    finish(args, metrics, "A visit:", seconds, "One hectare:", small, "Ten hectares:", large, "Beside others:", beside)


if __name__ == "__main__":
    main()
