"""A side of a row over weeks, and what a camera on a cart sees of it: drawn wide, by other rules than the map supposes.

Workers lower stems in stretches, each in their own way, forget hooks and turn some twice; stems die in clumps; heads
are added beside their mothers and look like them; appearance changes slowly along the row, and with light and season;
the odometry slips in jumps; errors have heavy tails, and the camera states them wrongly. Every number is drawn from a
range; all are guesses but those of facts: rows, D.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core import Array
from anther.history import RowPass

START = datetime(2026, 5, 1, 8, tzinfo=UTC)
BEYOND = 4.0
"""Hooks hang that far beyond both ends of the section, and slide into it [m]."""
NUMBERS = 3
"""A stem's appearance is so many numbers: thickness, truss spacing, colour."""


class SimulatedSide:
    """The truth of one side. N hooks in their order along the wire.

    Attributes:
        position: (N,) of the hooks [m].
        appearance: (N, NUMBERS) of their stems.
        identity: (N,) of the stems; a number is never used again.
        posts: tag -> position as somebody measured it, to a centimetre [m].
        week: how many have passed.
    """

    def __init__(self, rng: np.random.Generator, metres: tuple[float, float] = (20.0, 60.0)) -> None:
        u = rng.uniform
        self.rng, self.week, self.length = rng, 0, u(*metres)
        gaps = u(0.25, 0.5) * np.maximum(1 + u(0.05, 0.25) * rng.standard_t(4, 1000), 0.25)
        position = np.cumsum(gaps) - BEYOND
        self.position = position[position < self.length + BEYOND]
        n = len(self.position)
        self.identity = np.arange(n)
        along = np.sin(self.position[:, None] / u(3, 20, NUMBERS) + u(0, 6, NUMBERS)) * u(0, 0.7, NUMBERS)
        mixing = np.eye(NUMBERS) + 0.4 * rng.normal(size=(NUMBERS, NUMBERS))
        self.appearance = along + rng.gamma(4, 0.5, (n, NUMBERS)) @ mixing
        self._posts = {f"p{k}": at for k, at in enumerate(np.arange(0, self.length, u(4, 8)))}
        self.posts = {tag: float(at + rng.normal(0, 0.01)) for tag, at in self._posts.items()}
        self.slide, self.scatter, self.growth = u(0.1, 0.25) * rng.choice([-1, 1]), u(0.01, 0.04), u(0.1, 0.6)
        self.forgotten, self.removed, self.added, self.missed = u(0, 0.03), u(0, 0.02), u(0, 0.03), u(0, 0.05)
        self.noise, self.misstated, self.unmeasured = u(0.1, 0.6), u(0.7, 1.5), u(0, 0.2)
        self.walk = u(0.003, 0.02)

    def grow(self) -> None:
        """Let a week pass: growth, lowering, stems taken out, heads added."""
        rng, n, spread = self.rng, len(self.position), self.appearance.std(0)
        season = rng.normal(0, 1, NUMBERS)
        self.appearance = self.appearance + spread * (self.growth * rng.standard_t(4, (n, NUMBERS)) + season)
        worker = np.repeat(rng.uniform(0.7, 1.3, n // 15 + 1), 15)[:n]
        turns = rng.choice([0.0, 1.0, 2.0], n, p=[self.forgotten, 0.99 - self.forgotten, 0.01])
        at = self.position + turns * (self.slide * worker + rng.laplace(0, self.scatter, n))
        self.position = np.maximum.accumulate(at + 0.002 * np.arange(n)) - 0.002 * np.arange(n)  # none overtakes
        kept = np.ones(n, bool)
        for k in np.flatnonzero(rng.uniform(size=n) < self.removed / 2):
            kept[k : k + rng.integers(1, 4)] = False
        mothers = np.flatnonzero(rng.uniform(size=n) < self.added)
        heads = self.appearance[mothers] + 0.7 * spread * rng.normal(size=(len(mothers), NUMBERS))
        self.week += 1
        self._hang(
            np.concatenate([self.position[kept], self.position[mothers] + rng.uniform(0.05, 0.2, len(mothers))]),
            np.concatenate([self.identity[kept], 10_000 * self.week + np.arange(len(mothers))]),
            np.vstack([self.appearance[kept], heads]),
        )

    def _hang(self, position: NDArray[Any], identity: NDArray[Any], appearance: Array) -> None:
        order = np.argsort(position, kind="stable")
        self.position, self.identity, self.appearance = position[order], identity[order], appearance[order]

    def passed(self, house: str, row: str) -> tuple[RowPass, Array]:
        """Return what a pass sees, and (M,) whose hooks these are; -1: nobody's."""
        rng, u = self.rng, self.rng.uniform
        there = (self.position > 0.05) & (self.position < self.length - 0.05)
        for k in np.flatnonzero(u(size=len(there)) < self.missed / 1.5):
            there[k : k + rng.integers(1, 3)] = False
        clutter = u(0.1, self.length - 0.1, rng.poisson(0.003 * there.sum()))
        looks = self.appearance[there]
        strange = rng.normal(looks.mean(0), looks.std(0), (len(clutter), NUMBERS))
        looks, who = np.vstack([looks, strange]), np.concatenate([self.identity[there], np.full(len(clutter), -1)])
        error = self.noise * self.appearance.std(0) * np.exp(rng.normal(0, 0.3, looks.shape))
        looks = looks + error * np.where(u(size=looks.shape) < 0.04, 4.0, 1.0) * rng.normal(size=looks.shape)
        looks[u(size=looks.shape) < self.unmeasured] = np.nan
        x, read = self._odometry()
        at = np.concatenate([self.position[there], clutter])
        at = np.interp(at + 0.008 * rng.standard_t(3, len(at)), x, read)
        order = np.argsort(at)
        at = at[order] + 1e-6 * np.arange(len(at))
        posts = {tag: np.interp(post + rng.normal(0, 0.008), x, read) for tag, post in self._posts.items()}
        begin, end = np.interp([0, self.length], x, read)
        seen = RowPass(
            house, row, "left", START + timedelta(weeks=self.week), at,
            tuple((tag, float(post)) for tag, post in posts.items() if u() > 0.05),
            float(min(begin, at[0])), float(max(end, at[-1])),
            looks[order], (error / self.misstated)[order],
            open_flowers=rng.poisson(4, len(at)).astype(float), fruit=np.full(len(at), np.nan), drift=self.walk,
        )  # fmt: skip
        return seen, who[order]

    def _odometry(self) -> tuple[Array, Array]:
        """Return true positions and what the odometry reads there: a wrong scale, a walk, and jumps where it slips."""
        rng, x = self.rng, np.arange(-1, self.length + 1, 0.1)
        slips = (rng.uniform(size=len(x)) < 0.003) * rng.exponential(0.04, len(x)) * rng.choice([-1, 1], len(x))
        walk = rng.normal(0, self.walk * 0.1**0.5, len(x))
        return x, np.maximum.accumulate(x * (1 + rng.normal(0, 0.005)) + np.cumsum(walk + slips))
