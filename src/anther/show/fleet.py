"""How many robots a greenhouse needs, for how many hours, at what cost: the arithmetic of the growers' page.

`docs/for_growers.md` computes the same in the reader's browser; a test holds its formulas and defaults to these.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from anther.core.records import Range, Record


@dataclass(frozen=True, slots=True)
class House(Record):
    """A greenhouse and what a robot does in it. Defaults answer for today, with two hectares of tomatoes.

    Attributes:
        area: [ha].
        plants: stems per hectare; 20 000 to 35 000 (facts: pollination 5, rows D).
        path: distance of the paths from each other [m] (facts: rows D, remembered).
        hours: that robots work a day [h]; flowers are open and dry from 11 to 15 or 16 h.
        days: from one visit of a stem to the next; every second day at least (extension services).
        seconds: that a robot takes for a stem, from looking to drawing back [s]: the simulated arm's of ten views and
            a watched shake (`evaluation.house.costs.ways`).
        move: from one stem to the next [s]; a carriage was never measured.
        price: of a robot [€]; a guess.
        years: that it serves; a guess.
        season: days of a year on which robots work; 41 weeks (facts: pollination, manual wand).
        upkeep: per robot and year, as a share of its price; a guess.
    """

    area: Annotated[float, Range(0.01, 1000.0, "ha")] = 2.0
    plants: Annotated[float, Range(100.0, 1e6, "per ha")] = 30000.0
    path: Annotated[float, Range(0.3, 10.0, "m")] = 1.6
    hours: Annotated[float, Range(0.1, 24.0, "h")] = 5.0
    days: Annotated[float, Range(0.1, 60.0, "days")] = 2.0
    seconds: Annotated[float, Range(0.1, 3600.0, "s")] = 27.6
    move: Annotated[float, Range(0.0, 3600.0, "s")] = 0.0
    price: Annotated[float, Range(0.0, 1e7, "€")] = 40000.0
    years: Annotated[float, Range(0.5, 50.0, "years")] = 8.0
    season: Annotated[float, Range(1.0, 366.0, "days")] = 287.0
    upkeep: Annotated[float, Range(0.0, 10.0)] = 0.1


@dataclass(frozen=True, slots=True)
class Fleet:
    """What a house needs.

    Attributes:
        visits: stems visited a day.
        robots: whole robots.
        robot_hours: worked a day by all of them [h].
        path_each: length of path that each robot serves [m].
        fast_enough: how quick a robot would have to be for one per hectare [s a stem], with the time to move on.
        invested: [€].
        cost_per_area: per hectare and year [€].
        cost_per_visit: [€].
    """

    visits: float
    robots: int
    robot_hours: float
    path_each: float
    fast_enough: float
    invested: float
    cost_per_area: float
    cost_per_visit: float


def fleet_for(house: House) -> Fleet:
    """Return the robots, hours and costs that keep every stem of a house visited as often as asked."""
    visits = house.area * house.plants / house.days
    robot_hours = visits * (house.seconds + house.move) / 3600
    robots = math.ceil(robot_hours / house.hours - 1e-9)
    invested = robots * house.price
    yearly = invested * (1 / house.years + house.upkeep)
    return Fleet(
        visits=visits,
        robots=robots,
        robot_hours=robot_hours,
        path_each=house.area * 10000 / house.path / robots,
        fast_enough=3600 * house.hours * house.area / visits,
        invested=invested,
        cost_per_area=yearly / house.area,
        cost_per_visit=yearly / (visits * house.season),
    )
