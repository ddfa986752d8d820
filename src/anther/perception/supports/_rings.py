"""Rings: where the points about a line lie on one, and how it goes on from section to section. K sections, N points."""

from __future__ import annotations

import numpy as np

from anther.core.compiling import compiled, inlined


@compiled
def clearest_ring(xy, rings, pixel):
    """Return (score, x, y, radius) of the ring that points (2, N) around a line show best [m].

    The line runs on the ring or inside it. Of all such rings of up to `rings` pixels [m] that one is taken on which
    points are, and beside which none are: a matched filter, whose noise grows with the root of the ring's length.
    Columns side by side in memory let the compiler use vector instructions.
    """
    best = (0.0, 0.0, 0.0, pixel)
    for j in range(1, rings + 1):
        radius = j * pixel
        on_low, on_high = _squares(radius, pixel)
        low, high = _squares(radius, 3 * pixel)
        for share in (0.0, 0.5, 1.0):
            turns = np.int64(np.pi * share * j)
            turns = turns if turns > 1 else 1
            for k in range(turns):
                x, y = share * radius * np.cos(2 * np.pi * k / turns), share * radius * np.sin(2 * np.pi * k / turns)
                on = within = 0
                for p in range(xy.shape[1]):
                    square = (xy[0, p] - x) ** 2 + (xy[1, p] - y) ** 2
                    on += (square > on_low) & (square < on_high)
                    within += (square > low) & (square < high)
                score = (1.5 * on - 0.5 * within) / np.sqrt(radius + pixel)
                if score > best[0]:
                    best = (score, x, y, radius)
    return best


@inlined
def _squares(radius, off):
    """Return between which squares of a distance it differs by less than `off` from a radius."""
    low = radius - off
    return low * abs(low), (radius + off) ** 2


@compiled
def follow(xy, first, start, ring, cell, gap, place, path, size, many, others):
    """Follow a ring from section `start` up and down, until it was hidden for `gap` sections.

    Args:
        xy: (N, 2) points across the line, by section [m].
        first: (K + 1,) where each section begins among them.
        start: the section to begin with.
        ring: (3,) x, y and radius there [m].
        cell: of the grid [m].
        gap: sections.
        place, path, size, many, others: filled: (K, 2) centres as measured, and smoothed [m], (K,) radii [m], how many
            points lie on the ring (0: it is not seen), and how many within two cells outside it.
    """
    count = len(first) - 1
    for way in (1, -1):
        x, y, radius = ring[0], ring[1], ring[2]
        dx, dy, usual, hidden = 0.0, 0.0, 0.0, 0
        k = start
        while 0 <= k < count and hidden <= gap:
            points = xy[first[k] : first[k + 1]]
            fx, fy, fr, on, beside = _fitted_ring(points, x + dx, y + dy, radius, cell)
            if on >= 3 and on >= 0.3 * usual:
                if usual == 0.0:  # a rod stays as thick as it is where it begins
                    usual, radius = on, fr
                hidden = 0
                place[k, 0], place[k, 1], size[k], many[k], others[k] = fx, fy, fr, on, beside
                ax, ay = fx - x - dx, fy - y - dy
                x, y = x + dx + 0.5 * ax, y + dy + 0.5 * ay  # alpha-beta filter
                dx, dy = dx + 0.2 * ax, dy + 0.2 * ay
            else:
                hidden += 1
                x, y = x + dx, y + dy
                many[k] = 0.0
            path[k, 0], path[k, 1] = x, y
            k += way


@inlined
def _fitted_ring(xy, x, y, radius, cell):
    """Return x, y and radius of the ring through points (N, 2) near a guess, how many are on it, and just outside."""
    on, beside = 0.0, 0.0
    r = radius
    for _ in range(6):
        a00, a01, a02, a11, a12, a22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        b0, b1, b2 = 0.0, 0.0, 0.0
        on, beside = 0.0, 0.0
        for p in range(len(xy)):
            ux, uy = xy[p, 0] - x, xy[p, 1] - y
            off = np.sqrt(ux * ux + uy * uy)
            off = off if off > 1e-9 else 1e-9
            e = off - r
            if abs(e) > 0.7 * cell:
                if 0.0 < e < 2.7 * cell:
                    beside += 1.0
                continue
            on += 1.0
            ux, uy = ux / off, uy / off
            w = 1 / (1 + (e / (0.3 * cell)) ** 2)  # Cauchy
            a00 += w * ux * ux
            a01 += w * ux * uy
            a02 += w * ux
            a11 += w * uy * uy
            a12 += w * uy
            a22 += w
            b0 += w * e * ux
            b1 += w * e * uy
            b2 += w * e
        if on < 3:
            break
        tie = 0.2 * a22
        a00, a11, a22 = a00 + tie, a11 + tie, a22 + tie
        c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
        c11, c12, c22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
        det = a00 * c00 + a01 * c01 + a02 * c02
        x += (c00 * b0 + c01 * b1 + c02 * b2) / det
        y += (c01 * b0 + c11 * b1 + c12 * b2) / det
        r += (c02 * b0 + c12 * b1 + c22 * b2) / det
        r = r if r > 0.1 * cell else 0.1 * cell
    return x, y, r, on, beside
