"""Which robot works which legs of rows in which order, and when it charges: a constraint programme for OR-Tools."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

from anther.core.errors import MissingExtra

CHARGE = -1
"""The step of a robot that is no leg."""


class Leg(NamedTuple):
    """A part of a row that one robot works in one go; it lasts `seconds` and must lie in one `free` span [s]."""

    number: int
    row: str
    stems: int
    seconds: int
    free: tuple[tuple[int, int], ...]


class RobotNow(NamedTuple):
    """A robot as it stands: free from `free` [s] on, `battery` of `full` [s] of work left; no `rows`: goes anywhere."""

    name: str
    free: int
    battery: int
    full: int
    charge: int
    rows: tuple[str, ...]
    leg: int | None


def assign_legs(legs: Sequence[Leg], robots: Sequence[RobotNow], chargers: int) -> dict[str, list[int]]:
    """Return each robot's steps: numbers of legs and `CHARGE`, in their order. A leg that fits nowhere is left out.

    As many stems as can be are visited, then as early as can be. One robot is in a row at a time.

    Raises:
        MissingExtra: OR-Tools is not installed.
    """
    try:
        from ortools.sat.python import cp_model  # noqa: PLC0415
    except ImportError as error:
        raise MissingExtra("shift: its plan needs OR-Tools. Install it with: pip install 'anther[row]'") from error
    model = cp_model.CpModel()
    horizon = max((end for leg in legs for _, end in leg.free), default=0)
    starts: dict[Leg, Any] = {}
    done: dict[Leg, Any] = {}
    spans_of_row: dict[str, list[Any]] = {}
    for leg in legs:
        fits = [[begin, end - leg.seconds] for begin, end in leg.free if end - begin >= leg.seconds]
        if fits:
            starts[leg] = model.new_int_var_from_domain(cp_model.Domain.from_intervals(fits), "")
            done[leg] = model.new_bool_var("")
            span = model.new_optional_fixed_size_interval_var(starts[leg], leg.seconds, done[leg], "")
            spans_of_row.setdefault(leg.row, []).append(span)
    for spans in spans_of_row.values():
        model.add_no_overlap(spans)
    choices: dict[Leg, list[Any]] = {leg: [] for leg in starts}
    charges = {robot: _add_robot(model, robot, starts, choices, horizon) for robot in robots}
    for leg, options in choices.items():
        model.add(sum(literal for _, _, literal in options) == done[leg])
    every = [span for of in charges.values() for _, _, span in of]
    model.add_cumulative(every, [1] * len(every), chargers)
    last = model.new_int_var(0, horizon, "")
    for leg, start in starts.items():
        model.add(start + leg.seconds <= last).only_enforce_if(done[leg])
    spent = sum(literal for of in charges.values() for _, literal, _ in of)
    model.maximize(sum(horizon * leg.stems * literal for leg, literal in done.items()) - last - 60 * spent)
    solver = cp_model.CpSolver()
    solver.parameters.max_deterministic_time, solver.parameters.num_workers = 2.0, 1
    solver.parameters.catch_sigint_signal = False  # else Ctrl-C would kill a visit afterwards, arm moving
    if solver.solve(model) not in (cp_model.OPTIMAL, cp_model.FEASIBLE):
        return {robot.name: [] for robot in robots}
    steps: dict[str, list[tuple[int, int]]] = {robot.name: [] for robot in robots}
    for leg, options in choices.items():
        for robot, _, literal in options:
            if solver.value(literal):
                steps[robot.name].append((solver.value(starts[leg]), leg.number))
    for robot, of in charges.items():
        steps[robot.name] += [(solver.value(start), CHARGE) for start, literal, _ in of if solver.value(literal)]
    return {name: [number for _, number in sorted(of)] for name, of in steps.items()}


def _add_robot(model: Any, robot: RobotNow, starts: Any, choices: Any, horizon: int) -> list[tuple[Any, Any, Any]]:
    """Add the trips of a robot, each on one battery; return its charges: (start, whether it is, interval)."""
    charges = []
    trips = 3  # battery charges of a robot in one shift: one lasts about 5 h (facts: rows, A1)
    for _ in range(trips - 1):
        start, literal = model.new_int_var(robot.free, max(horizon, robot.free), ""), model.new_bool_var("")
        charges.append((start, literal, model.new_optional_fixed_size_interval_var(start, robot.charge, literal, "")))
    for (before, _, _), (after, literal, _) in pairwise(charges):
        model.add_implication(literal, charges[0][1])
        model.add(after >= before + robot.charge).only_enforce_if(literal)
    spans, loads = [span for _, _, span in charges], [[] for _ in range(trips)]
    for leg, start in starts.items():
        if robot.rows and leg.row not in robot.rows:
            continue
        for trip in range(trips):
            literal = model.new_bool_var("")
            choices[leg].append((robot, trip, literal))
            loads[trip].append(leg.seconds * literal)
            spans.append(model.new_optional_fixed_size_interval_var(start, leg.seconds, literal, ""))
            model.add(start >= robot.free).only_enforce_if(literal)
            if trip > 0:
                model.add_implication(literal, charges[trip - 1][1])
                model.add(start >= charges[trip - 1][0] + robot.charge).only_enforce_if(literal)
            if trip < trips - 1:
                model.add(start + leg.seconds <= charges[trip][0]).only_enforce_if([literal, charges[trip][1]])
    model.add_no_overlap(spans)
    for trip, load in enumerate(loads):
        model.add(sum(load) <= (robot.battery if trip == 0 else robot.full))
    return charges
