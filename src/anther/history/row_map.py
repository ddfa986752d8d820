"""The map of a house: rows, their sides, hooks on the wire, and which stem hangs from which, over weeks.

Weekly lowering slides every stem along the row, so metres along the rail are no address. A stem's address is its hook,
and a hook is known by its place in the order of hooks, by posts with fiducials beside the row, and by what its stem
looks like. `record_house` takes in what is built, `record_pass` what a camera saw on the way along one side,
`read_stems` returns the map. A stem is a plant of the history: it has the visits and counts of its label, wherever it
hangs.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import func, select
from sqlalchemy.orm import Session, selectinload

from anther.core import Array
from anther.core.choices import SIDES
from anther.core.errors import bad_input
from anther.history._database import DEFAULT, open_reader, open_writer
from anther.history._row_match import WEEK, Hooks, align
from anther.history._row_records import House, Recognition, RowPass, Side, Stem, check_increasing
from anther.history._tables import RowSide, StemRow, VisitRow, pollinated
from anther.history._trials import plant_of
from anther.plant.visit import check_labels

MISSED, REMOVED, GROWTH, SCATTER = (
    float(np.sqrt(np.prod(WEEK[n]))) for n in ("missed", "removed", "growth", "scatter")
)
"""Middles of what a week is believed to do."""
WEEKS = timedelta(weeks=1)


def record_house(
    house: House, where: Path | str = DEFAULT, *, passes: Sequence[RowPass] = ()
) -> tuple[Recognition, ...]:
    """Take in a house. Sides that are known keep their stems and get the posts as they are now.

    Args:
        house: as it is now; it may have grown by rows.
        where: the history.
        passes: along its sides, taken in as by `record_pass` in the same transaction: all or nothing.

    Returns:
        Who is who in each pass.

    Raises:
        InputError: the history has sides that this house has not, another species, or none of its posts on a side: it
            is another house; what `record_pass` raises; or the history cannot be written. Nothing is changed then.
    """
    with open_writer(where) as session:
        _check_same_house(session, house)
        for row, name in ((row, name) for row in house.rows for name in SIDES):
            built: Side | None = getattr(row, name)
            if built is None:
                continue
            side = _find_side(session, house.name, row.name, name)
            if side is None:
                side = RowSide(house=house.name, row=row.name, side=name, species=house.species, labels=0)
                side.posts = built.posts
                session.add(side)
                session.flush()
                now = datetime.now(UTC)
                for k, at in enumerate(built.hooks):
                    _add_stem(session, side, now, order=k, position=at, position_std=0.05, certainty=1.0)
                if built.hooks:
                    side.begin, side.end = built.hooks[0] - 0.1, built.hooks[-1] + 0.1
            side.posts = built.posts
        session.flush()
        return tuple(_recognise(session, seen) for seen in passes)


def _check_same_house(session: Session, house: House) -> None:
    """Raise InputError where the history has another house of this name."""
    built = {(row.name, name): side for row in house.rows for name in SIDES if (side := getattr(row, name))}
    for side in session.scalars(select(RowSide).where(RowSide.house == house.name).order_by(RowSide.id)):
        do = "Give this house a name of its own; nothing was changed."
        if (side.row, side.side) not in built:
            given, allowed = f"no row '{side.row}', {side.side}", "all sides that its map has, or a new house"
            raise bad_input(f"house '{house.name}'", given=given, allowed=allowed, do=do)
        if side.species != house.species:
            allowed = f"{side.species}, as its map has"
            raise bad_input(f"house '{house.name}'", given=house.species, allowed=allowed, do=do)
        posts = built[side.row, side.side].posts
        if posts and side.posts and not posts.keys() & side.posts.keys():
            given, allowed = (
                f"no post that row '{side.row}', {side.side}, had",
                f"one or more of {', '.join(side.posts)}",
            )
            raise bad_input(f"house '{house.name}'", given=given, allowed=allowed, do=do)


def read_stems(
    house: str, where: Path | str = DEFAULT, *, row: str | None = None, side: str | None = None
) -> list[Stem]:
    """Return the stems of a house, or of one row or side, by row, side and hook; none when there is no such house."""
    with open_reader(where) as session:
        return [] if session is None else stems_of(session, house, row, side)


def stems_of(session: Session, house: str, row: str | None = None, side: str | None = None) -> list[Stem]:
    """Return what `read_stems` does, within a transaction."""
    dose = select(VisitRow.plant_id, func.max(VisitRow.time).label("time")).where(pollinated())
    dose = dose.group_by(VisitRow.plant_id).subquery()
    query = select(StemRow, RowSide, dose.c.time).join(RowSide, RowSide.id == StemRow.row_side_id)
    query = query.outerjoin(dose, dose.c.plant_id == StemRow.plant_id)
    query = query.where(RowSide.house == house, StemRow.removed.is_(None))
    query = query.where(*(column == name for column, name in ((RowSide.row, row), (RowSide.side, side)) if name))
    return [
        Stem(
            s.id, s.plant.label, s.plant.species, of.house, of.row, of.side, s.order, s.position, s.position_std,
            s.certainty, s.gone, s.open_flowers, s.fruit, dosed, s.last_seen,
        )
        for s, of, dosed in session.execute(query.order_by(RowSide.id, StemRow.order))
    ]  # fmt: skip


def record_pass(seen: RowPass, where: Path | str = DEFAULT) -> Recognition:
    """Recognise the stems of a pass, bring the map up to it in one transaction, and return who is who.

    The first pass along a side makes its map.

    Raises:
        InputError: no such side; a post that does not stand there, or none seen of those that do; a pass not later
            than the last one; or stems that are not this side's. Nothing is changed then.
    """
    with open_writer(where) as session:
        return _recognise(session, seen)


def _recognise(session: Session, seen: RowPass) -> Recognition:
    """Do what `record_pass` does, within a transaction."""
    side = _find_side(session, seen.house, seen.row, seen.side)
    if side is None:
        do = "Check the names, or record the house first."
        raise bad_input("pass", given=_name(seen), allowed="a side of a recorded house", do=do)
    if side.passed is not None and seen.time <= side.passed:
        allowed = f"a time after the last pass, {side.passed:%Y-%m-%d %H:%M:%S} UTC"
        given = f"{seen.time:%Y-%m-%d %H:%M:%S %Z}"
        raise bad_input("pass", given=given, allowed=allowed, do="Was it recorded before?")
    now = _hooks_of_pass(seen, side.posts)
    stems = list(side.stems)
    weeks = max((seen.time - (side.passed or seen.time)) / WEEKS, 0.02)
    shares = np.zeros((len(now.position), 0))
    if stems:
        before = _hooks_of_map(side, stems, seen, now)
        shares, evidence = align(before, now, weeks)
        other_row = 1e-3  # prior odds that another row was driven than the one that is named (a guess)
        if evidence < np.log(other_row):
            given = f"stems that explain the pass e^{-evidence:.0f} times worse than others would"
            do = "Check which row was driven; nothing was changed."
            raise bad_input("pass", given=given, allowed=f"the stems of {_name(seen)}", do=do)
    result = _update_map(session, side, stems, seen, now, shares)
    side.begin = now.begin if side.begin is None else min(side.begin, now.begin)
    side.end = now.end if side.end is None else max(side.end, now.end)
    side.passed = seen.time
    return result


def _find_side(session: Session, house: str, row: str, side: str) -> RowSide | None:
    query = select(RowSide).where(RowSide.house == house, RowSide.row == row, RowSide.side == side)
    return session.scalar(query.options(selectinload(RowSide.stems)).with_for_update())


def _name(seen: RowPass) -> str:
    return f"house '{seen.house}', row '{seen.row}', {seen.side}"


def _hooks_of_pass(seen: RowPass, posts: dict[str, float]) -> Hooks:
    """Return the hooks with their positions along the rail: the odometry, stretched from post to post."""
    if posts and not seen.posts:
        do = "Check the camera and which row was driven; nothing was changed."
        raise bad_input("posts of a pass", given="none", allowed=f"one or more of {', '.join(posts)}", do=do)
    if posts and (foreign := [tag for tag, _ in seen.posts if tag not in posts]):
        given, do = f"post '{foreign[0]}'", "Check which row was driven; nothing was changed."
        raise bad_input("posts of a pass", given=given, allowed=f"those of {_name(seen)}: {', '.join(posts)}", do=do)
    odometry = np.array([at for _, at in seen.posts if posts])
    built = np.array([posts[tag] for tag, _ in seen.posts if posts])
    check_increasing("posts of a pass along the rail", built, "Check the posts of the house.")
    if not len(built):
        odometry, built = np.array([seen.begin]), np.array([seen.begin])
    along = _along_rail(np.concatenate([seen.position, [seen.begin, seen.end]]), odometry, built)
    before = np.searchsorted(odometry, seen.position)
    gap = np.inf * np.ones((2, len(before)))
    gap[0, before > 0] = (seen.position - odometry[before - 1])[before > 0]
    gap[1, before < len(odometry)] = (odometry[np.minimum(before, len(odometry) - 1)] - seen.position)[
        before < len(odometry)
    ]
    drift = seen.drift**2 / (1 / np.maximum(gap, 1e-6)).sum(0)  # a Brownian bridge between two posts
    own = np.full(len(before), seen.position_std**2)
    none = np.zeros(len(before))
    return Hooks(
        along[:-2], own, drift, seen.drift, seen.appearance, seen.appearance_std**2, none, none, along[-2], along[-1]
    )


def _along_rail(x: Array, odometry: Array, built: Array) -> Array:
    inner = np.interp(x, odometry, built)
    return inner + np.minimum(x - odometry[0], 0) + np.maximum(x - odometry[-1], 0)


def _hooks_of_map(side: RowSide, stems: list[StemRow], seen: RowPass, now: Hooks) -> Hooks:
    count = seen.appearance.shape[1]
    position = np.array([s.position for s in stems])
    variance = np.array([s.position_std**2 for s in stems])
    drift = np.minimum(np.interp(position, now.position, now.drift), variance)  # the pass before had the same posts
    weeks = np.array([max((seen.time - s.last_seen) / WEEKS, 0.0) for s in stems])
    appearance, std = (_rows([getattr(s, name) for s in stems], count) for name in ("appearance", "appearance_std"))
    gone = np.array([s.gone for s in stems])
    ends = side.begin if side.begin is not None else position[0], side.end if side.end is not None else position[-1]
    return Hooks(position, variance - drift + 1e-6, drift, seen.drift, appearance, std**2, weeks, gone, *ends)


def _update_map(
    session: Session, side: RowSide, stems: list[StemRow], seen: RowPass, now: Hooks, shares: Array
) -> Recognition:
    """Bring the map up to a pass: who was recognised, who is new, missing or removed."""
    best = shares.argmax(1) if stems else np.zeros(len(shares), int)
    match = {j: int(i) for j, i in enumerate(best) if stems and shares[j, i] > 0.5}
    there = _update_lost(stems, match, seen, now, shares)
    missing, removed = (tuple(s.plant.label for s in there if bool(s.removed) is gone) for gone in (False, True))
    appearance = now.appearance - np.nanmedian(now.appearance, 0) if now.appearance.size else now.appearance
    spread = np.nanvar(appearance, 0) if appearance.size else np.zeros(0)
    probability = [float(shares[j, match[j]]) if j in match else 1 - float(shares[j].sum()) for j in range(len(shares))]
    seen_stems = []
    for j, certainty in enumerate(probability):
        stem = stems[match[j]] if j in match else _add_stem(session, side, seen.time, order=j)
        _update_appearance(stem, appearance[j], now.appearance_variance[j], spread, seen.time)
        stem.position, stem.position_std = float(now.position[j]), float(np.sqrt(now.variance[j] + now.drift[j]))
        stem.certainty, stem.gone, stem.last_seen = certainty, 0.0, seen.time
        for name in ("open_flowers", "fruit"):
            if np.isfinite(count := getattr(seen, name)[j]):
                setattr(stem, name, int(count))
        seen_stems.append(stem)
    left = [s for i, s in enumerate(stems) if i not in match.values() and s.removed is None]
    for k, stem in enumerate(sorted([*seen_stems, *left], key=lambda s: s.position)):
        stem.order = k
    new = tuple(j not in match for j in range(len(shares)))
    return Recognition(tuple(s.plant.label for s in seen_stems), tuple(probability), new, missing, removed)


def _update_lost(
    stems: list[StemRow], match: dict[int, int], seen: RowPass, now: Hooks, shares: Array
) -> list[StemRow]:
    """Move the stems that were not recognised with their neighbours; return those that should have been seen."""
    if not match:
        return []
    old, missing = np.array([s.position for s in stems]), []
    moved = _along_rail(old, old[list(match.values())], now.position[list(match)])
    sure = 0.95  # after about three passes without it
    for i, stem in enumerate(stems):
        if i in match.values():
            continue
        weeks = (seen.time - stem.last_seen) / WEEKS
        stem.position = float(moved[i])
        stem.position_std = float(np.hypot(stem.position_std, SCATTER * np.sqrt(weeks)))
        if now.begin <= stem.position <= now.end:
            gone = stem.gone + (1 - stem.gone) * min(REMOVED * weeks, 0.5)
            stem.gone = (1 - min(float(shares[:, i].sum()), 1.0)) * gone / (gone + (1 - gone) * MISSED)
            stem.removed = seen.time if stem.gone >= sure else None
            missing.append(stem)
    return missing


def _add_stem(session: Session, side: RowSide, time: datetime, **values: Any) -> StemRow:
    """Add a stem with a label of its own."""
    side.labels += 1
    label = f"{side.house} {side.row} {side.side} {side.labels}"
    check_labels(side.species, label)
    plant = plant_of(session, side.species, label)
    first = {"position": 0.0, "position_std": 0.0, "certainty": 1.0, "gone": 0.0}
    stem = StemRow(row_side_id=side.id, plant=plant, first_seen=time, last_seen=time, **{**first, **values})
    session.add(stem)
    return stem


def _update_appearance(stem: StemRow, x: Array, variance: Array, spread: Array, time: datetime) -> None:
    """Weigh what was known of a stem, less sure by what it grew since, and what was seen now."""
    (before,), (std,) = (_rows([values], len(x)) for values in (stem.appearance, stem.appearance_std))
    known = std**2 + GROWTH**2 * spread * ((time - stem.last_seen) / WEEKS)
    gain = np.where(np.isfinite(x), np.where(np.isfinite(before), known / (known + variance), 1.0), 0.0)
    mean = np.where(gain == 1, x, np.where(gain == 0, before, before + gain * (x - before)))
    error = np.sqrt(np.where(gain == 1, variance, (1 - gain) * known))
    numbers = ([float(v) if np.isfinite(v) else None for v in values] for values in (mean, error))
    stem.appearance, stem.appearance_std = numbers


def _rows(values: list[Any], count: int) -> Array:
    """Return stored numbers (N, K); NaN where there are none or other ones."""
    nothing = [None] * count
    kept = [v if v is not None and len(v) == count else nothing for v in values]
    return np.array(kept, dtype=float).reshape(-1, count)
