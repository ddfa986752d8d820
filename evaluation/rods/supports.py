"""Rods on supports and under tension: beams with springs in their span, strings, a floor, and MuJoCo's chain of links.

The exact solutions owe nothing to the rod engine: transfer matrices of Euler and Bernoulli's beam under tension.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from scipy.linalg import expm
from scipy.special import j0, jn_zeros, y0

from anther.rods import (
    Clamp,
    Loads,
    Rods,
    Support,
    equilibrium,
    frequency_response,
    natural_frequencies,
    with_gravity_equilibrium,
)
from evaluation.rods.beam_theory import roots
from evaluation.rods.beams import NO_GRAVITY, SLENDER
from evaluation.rods.ends import planted
from evaluation.rods.table import Array, Row, order_row

EDGES, LIMIT = 200, 1e-3
PIN = 1e6
"""Springs that stand for rigid supports, in EI / L^3 and EI / L."""

Spring = tuple[float, float, float]
"""Place over L, stiffness in translation over EI / L^3, in rotation over EI / L."""


def support_cases(quick: bool) -> list[Row]:
    """Return the rows of supports and tension."""
    del quick  # it takes ten seconds
    meshes = np.array([32, 64, 128])
    static = np.array([max(_static_error(n, s) for s in _sweep()) for n in meshes])
    modes = np.array([max(_mode_error(n, s, True) for s in _sweep()) for n in meshes])
    of_springs = "of a beam on springs, worst of a sweep: order in the node distance"
    return [
        *_beam_rows(),
        _chain(),
        _held_chain(),
        _pulled_string(),
        _decay(),
        _response(),
        _lifted(),
        mujoco_row(),
        order_row("support_static_order", f"tip force {of_springs}", 1 / meshes, static),
        order_row("support_modes_order", f"three frequencies {of_springs}", 1 / meshes, modes),
    ]


def _sweep() -> list[list[Spring]]:
    """Return springs at the middle and the tip, from next to nothing to rigid, in translation, rotation and both."""
    sizes = (0.1, 1.0, 30.0, 1e3, PIN)
    ways = ((1, 0), (0, 1), (1, 1))
    return [[(at, s * move, s * turn)] for at in (0.5, 1.0) for s in sizes for move, turn in ways]


class Spans:
    """A beam of unit length, EI and line mass from s = 0 to 1, on springs, under a tension in EI / L^2."""

    def __init__(self, springs: Sequence[Spring], clamped: bool, tension: float = 0.0) -> None:
        self.springs, self.tension = sorted(springs), tension
        self.starts = np.eye(4)[:, [2, 3] if clamped else [1, 3]]

    def _carry(self, state: Array, b: float, start: float, end: float) -> Array:
        """Carry (w, w', w'', w''' - tension w') over a free span: w'''' - tension w'' = b^4 w."""
        slope = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [0, self.tension, 0, 1], [b**4, 0, 0, 0]])
        return np.asarray(expm((end - start) * slope)) @ state

    def _through(self, state: Array, b: float, start: float, end: float) -> Array:
        for at, move, turn in self.springs:
            if start < at <= end:
                state = self._carry(state, b, start, at)
                jump = np.eye(4)
                jump[2, 1], jump[3, 0] = turn, -move
                state, start = jump @ state, at
        return self._carry(state, b, start, end)

    def receptance(self, load_at: float, look_at: float, b: float = 0.0) -> float:
        """Return the displacement at one place per unit force at another, which vibrates with the parameter b."""
        ends = self._through(self.starts, b, 0.0, 1.0)[2:]
        pushed = self._through(np.array([0, 0, 0, 1.0]), b, load_at, 1.0)[2:]  # w''' jumps by the force
        start = self.starts @ np.linalg.solve(ends, -pushed)
        seen = self._through(start, b, 0.0, look_at)
        if look_at > load_at:
            seen = seen + self._through(np.array([0, 0, 0, 1.0]), b, load_at, look_at)
        return float(seen[0])

    def roots(self, count: int) -> Array:
        """Return the parameters b of the lowest modes, w = b^2 sqrt(EI / (rho A L^4))."""

        def determinant(b: float) -> float:
            return float(np.linalg.det(self._through(self.starts, b, 0.0, 1.0)[2:])) / np.cosh(b) ** 2

        return roots(determinant, 0.3, 0.1, count)


def _supports(edges: int, springs: Sequence[Spring]) -> tuple[Support, ...]:
    """Return the springs across a beam along x, alike in both planes."""
    across, EI, L = np.array([0, 1, 1]), SLENDER.bending_stiffness, SLENDER.length
    return tuple(
        Support(round(at * edges), move * EI / L**3 * across, turn * EI / L * across) for at, move, turn in springs
    )


def _held(edges: int, springs: Sequence[Spring], clamped: bool) -> tuple[Rods, Clamp]:
    rods = planted(edges, supports=_supports(edges, springs))
    return rods, Clamp.root(rods) if clamped else Clamp(np.array([0]))


def _static_error(edges: int, springs: Sequence[Spring], clamped: bool = True, at: float = 1.0) -> float:
    """Return the error of the sag under a small force, over that of the sag without supports if these are rigid."""
    rods, clamp = _held(edges, springs, clamped)
    exact = Spans(springs, clamped).receptance(at, at)
    free = Spans([], True).receptance(at, at)
    node, per_force = round(at * edges), SLENDER.length**3 / SLENDER.bending_stiffness
    size = 1e-4 * SLENDER.length / per_force
    moved = equilibrium(rods, clamp, gravity=NO_GRAVITY, loads=Loads.at(rods, node, force=(0, 0, size)))
    found = float(moved[node, 2] - rods.nodes[node, 2]) / size / per_force
    return abs(found - exact) / max(exact, 1e-3 * free)


def _mode_error(edges: int, springs: Sequence[Spring], clamped: bool, count: int = 3) -> float:
    """Return the worst error of the lowest frequencies, each of which occurs in both planes."""
    rods, clamp = _held(edges, springs, clamped)
    found = 2 * np.pi * natural_frequencies(rods, clamp, 2 * count, gravity=NO_GRAVITY).frequencies[::2]
    return float(np.abs(found / (Spans(springs, clamped).roots(count) ** 2 * SLENDER.rate) - 1).max())


def _beam_rows() -> list[Row]:
    cases: tuple[tuple[str, str, list[Spring], bool], ...] = (
        ("simple", "simply supported beam", [(1.0, PIN, 0.0)], False),
        ("propped", "propped cantilever", [(1.0, PIN, 0.0)], True),
        ("fixed", "beam fixed at both ends", [(1.0, PIN, PIN)], True),
        ("two_spans", "cantilever on a second support in its middle", [(0.5, PIN, 0.0)], True),
        ("elastic", "cantilever on 30 EI / L^3 and 3 EI / L in its middle and at its tip",
         [(0.5, 30.0, 3.0), (1.0, 30.0, 3.0)], True),
    )  # fmt: skip
    rows = []
    for case, what, springs, clamped in cases:
        sag, tones = _static_error(EDGES, springs, clamped, 0.25), _mode_error(EDGES, springs, clamped)
        rows.append(Row(f"support_{case}_sag", f"{what}: sag under a force (analytic), {EDGES} edges", sag, LIMIT))
        rows.append(Row(f"support_{case}_modes", f"{what}: three frequencies (analytic), {EDGES} edges", tones, LIMIT))
    return rows


LIMP = {"bending": 1e-12, "line_mass": 0.2, "stretching": 2e3}
"""A chain [N m^2, kg/m, N]: bending dies out within a thousandth of its length."""


def _hanging(edges: int, length: float, **more: Any) -> Rods:
    nodes = np.zeros((edges + 1, 3))
    nodes[:, 2] = -np.linspace(0, length, edges + 1)
    return Rods.of_stiffness(nodes, np.arange(edges + 1) - 1, **LIMP, **more)


def _tones(rods: Rods, clamp: Clamp, count: int, gravity: Any = (0, 0, -9.81)) -> Array:
    """Return the lowest frequencies of rods that stand or hang; each occurs twice, and counts once [Hz]."""
    hung = with_gravity_equilibrium(rods, clamp, gravity)
    return natural_frequencies(hung, clamp, 2 * count, gravity=gravity).frequencies[::2]


def _row(case: str, what: str, found: Array, expected: Array, limit: float = LIMIT) -> Row:
    detail = f"found {np.array2string(found, precision=5)}, theory {np.array2string(expected, precision=5)}"
    return Row(case, what, float(np.abs(found / expected - 1).max()), limit, "%", detail)


def _chain() -> Row:
    length = 2.5
    rods = _hanging(EDGES, length)
    exact = jn_zeros(0, 3) / (4 * np.pi) * np.sqrt(9.81 / length)
    return _row("chain", "hanging chain: three frequencies (Bernoulli 1732)", _tones(rods, Clamp.root(rods), 3), exact)


def _held_chain() -> Row:
    """A chain that a support holds at its lower end and pulls by a third of the weight."""
    length, weight = 2.5, LIMP["line_mass"] * 9.81 * 2.5
    pull = weight / 3
    held = (Support(EDGES, translation=(1e7, 1e7, 0)), Support(EDGES, force=(0, 0, -pull)))
    rods = _hanging(EDGES, length, supports=held)
    low, high = np.sqrt(np.array([pull, pull + weight]) / (LIMP["line_mass"] * 9.81))

    def equation(a: float) -> float:
        return float(j0(a * low) * y0(a * high) - j0(a * high) * y0(a * low))

    exact = roots(equation, 0.2, 0.05, 3) / (4 * np.pi) * np.sqrt(9.81)
    what = "chain held and pulled at its lower end: three frequencies (Bessel functions)"
    return _row("held_chain", what, _tones(rods, Clamp.root(rods), 3), exact)


def _pulled_string() -> Row:
    """A pinned beam whose far support pulls: its string and its bending both count."""
    EI, L, n = SLENDER.bending_stiffness, SLENDER.length, np.array([1, 2, 3])
    tension = 30 * EI / L**2
    far = (Support(EDGES, translation=(0, PIN * EI / L**3, PIN * EI / L**3)), Support(EDGES, force=(tension, 0, 0)))
    rods = planted(EDGES, supports=far)
    exact = n / (2 * L) * np.sqrt(tension / SLENDER.line_mass * (1 + n**2 * np.pi**2 * EI / (tension * L**2)))
    found = _tones(rods, Clamp(np.array([0])), 3, NO_GRAVITY)
    return _row("support_tension", "pinned beam that a support pulls: three frequencies (analytic)", found, exact)


def _decay() -> Row:
    """Beyond a support that holds place and direction, the slope of a pulled stem dies out within sqrt(EI / T)."""
    EI, L = SLENDER.bending_stiffness, SLENDER.length
    tension, edges = 400 * EI / L**2, EDGES
    grip = Support(edges // 4, translation=PIN * EI / L**3, rotation=PIN * EI / L)
    rods = planted(edges, supports=(grip, Support(edges, force=(tension, 0, 0))))
    clamp = Clamp.root(rods)
    rods = with_gravity_equilibrium(rods, clamp, NO_GRAVITY)
    side = Loads.at(rods, edges, force=(0, 0, 1e-5 * tension))
    x = equilibrium(rods, clamp, gravity=NO_GRAVITY, loads=side)
    middle, slope = (x[1:, 0] + x[:-1, 0]) / 2, np.diff(x[:, 2]) / np.diff(x[:, 0])
    near = (middle > L / 4) & (middle < L / 4 + 3 * L / 20)
    rate = -np.polyfit(middle[near], np.log(1 - slope[near] / 1e-5), 1)[0]
    what = "pulled stem: length within which its bending dies out beyond a grip, sqrt(EI / T)"
    return _row("support_decay", what, np.array([1 / rate]), np.array([np.sqrt(EI / tension)]))


def _response() -> Row:
    """The tip of a beam on springs that is shaken in its middle."""
    springs = [(0.75, 30.0, 3.0), (1.0, 5.0, 0.0)]
    rods, clamp = _held(EDGES, springs, True)
    spans, b = Spans(springs, True), 2.5
    hertz = b**2 * SLENDER.rate / (2 * np.pi)
    found = frequency_response(rods, clamp, EDGES // 2, (0, 0, 1), [hertz], gravity=NO_GRAVITY)[0, -1, 2].real
    exact = spans.receptance(0.5, 1.0, b) / spans.receptance(0.5, 0.5, b)
    what = "frequency response of a shaken beam on springs: tip over grip (analytic)"
    return _row("support_response", what, np.array([found]), np.array([exact]))


def _lifted() -> Row:
    """A heavy beam on a rigid floor, lifted at its end by F: it rises 2 F^4 / (3 q^3 EI) there."""
    EI, L = SLENDER.bending_stiffness, SLENDER.length
    q = 30 * EI / L**3
    rods = planted(EDGES, supports=Support.floor(planted(EDGES).nodes, PIN * EI / L**3))
    F = 0.3 * q * L  # 0.6 of the beam leaves the floor
    clamp, gravity = Clamp.root(rods), np.array([0, 0, -q / SLENDER.line_mass])
    lying = equilibrium(rods, clamp, gravity=gravity)
    scale = 1e-3  # of all loads: the law is of small slopes
    lift = Loads.at(rods, EDGES, force=(0, 0, scale * F))
    moved = equilibrium(rods, clamp, gravity=scale * gravity, loads=lift)
    found, exact = moved[-1, 2] - scale * lying[-1, 2], scale * 2 * F**4 / (3 * q**3 * EI)
    what = "heavy beam lifted off a floor at its end: its height there (analytic)"
    return _row("support_floor", what, np.array([found]), np.array([exact]))


def mujoco_row(edges: int = 30) -> Row:
    """A horizontal cantilever whose tip hangs on an inclined string: rigid links, springs and a tendon in MuJoCo."""
    EI, L, h = SLENDER.bending_stiffness, SLENDER.length, SLENDER.length / edges
    tension, stretching, way = 20 * EI / L**2, 4e3 * EI / L**2, 0.5 * L * np.array([0.98, 0.0, 0.2])
    rods = planted(edges, supports=(Support.string(edges, way, tension, stretching),), bend_over_twist=0.0)
    clamp = Clamp.root(rods)
    held = with_gravity_equilibrium(rods, clamp, NO_GRAVITY)
    modes = natural_frequencies(held, clamp, 6, gravity=NO_GRAVITY).frequencies
    exact = _link_frequencies(edges, h, tension, stretching, way)[:6]
    what = "cantilever whose tip hangs on an inclined string: six frequencies, MuJoCo's links and tendon"
    return _row("support_mujoco", what, modes, exact, 0.03)


def _link_frequencies(edges: int, h: float, tension: float, stretching: float, way: Array) -> Array:
    """Return the frequencies [Hz] of straight links whose joints bear the string's pull with their springs.

    The first joint is half a link's spring away from the clamp: twice as stiff.
    """
    EI, tip = SLENDER.bending_stiffness, np.array([edges * h, 0, 0])
    moment = np.cross(tip - np.outer(np.arange(edges) * h, [1, 0, 0]), tension * way / np.linalg.norm(way))
    text, closing = "", ""
    for j in range(edges):
        stiffness = EI / h * (2 if j == 0 else 1)
        place = 0.0 if j == 0 else h
        joints = "".join(
            f'<joint type="hinge" axis="{axis}" stiffness="{stiffness}" springref="{-moment[j, i] / stiffness}"/>'
            for i, axis in ((1, "0 1 0"), (2, "0 0 1"))
        )
        mass = SLENDER.line_mass * h
        text += f'<body pos="{place} 0 0">{joints}<inertial pos="{h / 2} 0 0" mass="{mass}" '
        text += f'diaginertia="{1e-4 * mass * h**2} {mass * h**2 / 12} {mass * h**2 / 12}"/>'
        closing += "</body>"
    hook, length = tip + way, float(np.linalg.norm(way))
    rest = length - tension * length / stretching
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian" boundmass="0" boundinertia="0"/><option gravity="0 0 0"/><worldbody>'
        f'<site name="hook" pos="{hook[0]} {hook[1]} {hook[2]}"/>{text}<site name="tip" pos="{h} 0 0"/>{closing}'
        f'</worldbody><tendon><spatial stiffness="{stretching / length}" springlength="{rest}">'
        f'<site site="hook"/><site site="tip"/></spatial></tendon></mujoco>'
    )
    data, step = mujoco.MjData(model), 1e-6
    mujoco.mj_forward(model, data)
    assert np.abs(data.qfrc_passive).max() < 1e-9 * tension * edges * h, "the links are not at rest"
    mass, stiffness = np.zeros((2, model.nv, model.nv))
    for i, unit in enumerate(np.eye(model.nv)):
        mujoco.mj_mulM(model, data, mass[i], unit)
    for i in range(model.nv):
        forces = []
        for sign in (1, -1):
            data.qpos[:] = 0
            data.qpos[i] = sign * step
            mujoco.mj_forward(model, data)
            forces.append(data.qfrc_passive.copy())
        stiffness[i] = (forces[1] - forces[0]) / (2 * step)
    squares = np.linalg.eigvals(np.linalg.solve(mass, (stiffness + stiffness.T) / 2)).real
    return np.sqrt(np.sort(squares)) / (2 * np.pi)
