"""The map of a house: stems keep their identity through weeks of a row, or are unsure; what cannot be is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from alike import check_kept
from scipy.stats import t as student

from anther.core.errors import InputError
from anther.history import (
    SURE,
    House,
    Row,
    RowPass,
    Side,
    read_stems,
    record_house,
    record_pass,
    record_trial,
)
from anther.history import _row_match as match
from anther.plant import Visit

MONDAY = datetime(2026, 5, 4, 9, tzinfo=UTC)
POSTS = {"17": 0.0, "18": 5.0, "19": 10.0}


def house(**more: Any) -> House:
    rows = (Row("1", Side(POSTS), None), Row("2", Side({"27": 0.0, "28": 5.0, "29": 10.0}), None))
    return House("north", "tomato", more.pop("rows", rows))


class Stems:
    """Irregular stems of one side; every change of a week is made by name."""

    def __init__(self, seed: int = 0, count: int = 26) -> None:
        self.rng = np.random.default_rng(seed)
        self.at = 0.3 + np.cumsum(self.rng.uniform(0.28, 0.45, count)) - 0.35
        self.looks = self.rng.normal(size=(count, 3))

    def seen(self, week: float, skip: tuple[int, ...] = (), *, drift: float = 0.0, **more: Any) -> RowPass:
        kept = np.delete(np.arange(len(self.at)), skip)
        kept = kept[(self.at[kept] > 0) & (self.at[kept] < 10)]
        looks = self.looks[kept] + self.rng.normal(0, 0.2, (len(kept), 3))
        posts = tuple((tag, at * (1 + drift)) for tag, at in POSTS.items())
        given = {
            "house": "north", "row": "1", "side": "left", "time": MONDAY + timedelta(weeks=week),
            "position": self.at[kept] * (1 + drift), "posts": posts, "begin": 0.0, "end": 10 * (1 + drift),
            "appearance": looks, "appearance_std": np.full(looks.shape, 0.2),
            "open_flowers": np.full(len(kept), 3.0), "fruit": np.full(len(kept), np.nan),
        }  # fmt: skip
        return RowPass(**{**given, **more})

    def slide(self, by: float) -> None:
        self.at = self.at + by + self.rng.normal(0, 0.02, len(self.at))


def begun(where: str, stems: Stems) -> list[str]:
    record_house(house(), where)
    return list(record_pass(stems.seen(0), where).plants)


def test_stems_are_found_again_after_lowering_a_removal_an_addition_and_a_miss(where: str) -> None:
    """Lowered by half a pitch: the nearest hook along the rail is often the wrong one."""
    stems = Stems()
    labels = begun(where, stems)
    stems.slide(0.22)
    stems.at, stems.looks = np.delete(stems.at, 7), np.delete(stems.looks, 7, 0)
    new = (stems.at[14] + stems.at[15]) / 2
    stems.at, stems.looks = np.insert(stems.at, 15, new), np.insert(stems.looks, 15, [3.0, -3.0, 3.0], 0)
    found = record_pass(stems.seen(1, skip=(20,), drift=0.02), where)
    truth = [*labels[:7], *labels[8:16], None, *labels[16:]]
    truth = truth[:20] + truth[21:]
    count = len(found.plants)
    assert [None if new else plant for plant, new in zip(found.plants, found.new, strict=True)] == truth[:count]
    assert min(found.probability) > 0.8
    assert {labels[7], labels[20]} <= set(found.missing)
    assert not found.removed
    read = read_stems("north", where)
    assert [s.hook for s in read] == list(range(len(read)))
    assert [s.position for s in read] == sorted(s.position for s in read)
    assert {s.plant for s in read} >= set(labels)
    assert all(s.open_flowers == 3 and s.fruit is None for s in read)


def test_hooks_that_slid_far_and_unevenly_are_still_their_row_s(where: str) -> None:
    """What tells another row is how its stems look: that its hooks hang where they might tells nothing."""
    stems = Stems()
    labels = begun(where, stems)
    stems.at = np.sort(stems.at + 0.45 + stems.rng.normal(0, 0.16, len(stems.at)))
    stems.looks = stems.looks + stems.rng.normal(0, 1, stems.looks.shape)
    found = record_pass(stems.seen(2), where)
    right = [plant == label for plant, label in zip(found.plants, labels, strict=False)]
    assert np.mean(right) > 0.8


def test_a_stem_that_stays_away_is_removed_and_its_visits_stay(where: str) -> None:
    stems = Stems()
    labels = begun(where, stems)
    record_trial(Visit("tomato", labels[5], True, flowers_moved=True, time=MONDAY), where)
    dosed = {s.plant: s.last_dose for s in read_stems("north", where, row="1", side="left")}
    assert {plant for plant, time in dosed.items() if time} == {labels[5]}
    gone = []
    for week in range(1, 5):
        found = record_pass(stems.seen(week, skip=(5,)), where)
        gone += found.removed
        if week == 1:
            assert found.missing == (labels[5],)
    assert gone == [labels[5]]
    assert labels[5] not in {s.plant for s in read_stems("north", where)}


def test_two_stems_that_changed_so_much_that_nobody_can_tell_are_unsure(where: str) -> None:
    """One of two that look alike is taken out, and the other hangs midway between their hooks."""
    stems = Stems()
    stems.looks[10] = stems.looks[11]
    begun(where, stems)
    stems.at[11] = (stems.at[10] + stems.at[11]) / 2
    stems.at, stems.looks = np.delete(stems.at, 10), np.delete(stems.looks, 10, 0)
    found = record_pass(stems.seen(1), where)
    assert set(found.unsure) <= {9, 10, 11}
    assert 10 in found.unsure
    stem = next(s for s in read_stems("north", where) if s.plant == found.plants[10])
    assert stem.certainty == pytest.approx(found.probability[10])
    assert stem.certainty < SURE


def test_a_part_of_a_row_leaves_the_rest_as_it_was(where: str) -> None:
    stems = Stems()
    labels = begun(where, stems)
    whole = stems.seen(1)
    half = whole.position < 5.0
    per_hook = {
        name: getattr(whole, name)[half]
        for name in ("position", "appearance", "appearance_std", "open_flowers", "fruit")
    }
    found = record_pass(replace(whole, **per_hook, end=5.0, posts=whole.posts[:2]), where)
    assert list(found.plants) == labels[: half.sum()]
    assert len(found.missing) <= 1
    assert not found.removed
    assert [s.plant for s in read_stems("north", where)] == labels


def test_what_cannot_be_is_refused_and_nothing_changes(where: str) -> None:
    stems, other = Stems(), Stems(seed=5)
    begun(where, stems)
    before = read_stems("north", where)
    good = stems.seen(1)
    wrong = {
        "a side of a recorded house": replace(good, house="south"),
        "post '27'": replace(good, posts=(("27", 0.0), ("28", 5.0))),
        "got none": replace(good, posts=()),
        "a time after the last pass": replace(good, time=MONDAY),
        "times worse than others would": replace(other.seen(1)),
        "posts of a pass along the rail": replace(good, posts=(("18", 0.0), ("17", 5.0))),
    }
    for message, seen in wrong.items():
        with pytest.raises(InputError, match=message):
            record_pass(seen, where)
    assert read_stems("north", where) == before
    with pytest.raises(InputError, match=r"number 2 at .* after"):
        replace(good, position=good.position[::-1])
    with pytest.raises(InputError, match="the error of each number"):
        replace(good, appearance_std=np.zeros_like(good.appearance))


def test_a_row_file_is_read_or_refused_with_what_is_wrong(tmp_path: Path) -> None:
    path = tmp_path / "house.json"
    whole = house(rows=(Row("1", Side(POSTS, (0.3, 0.7)), None),))
    whole.save(path)
    assert House.load(path) == whole
    tree = json.loads(path.read_text())
    row = tree["rows"][0]
    broken = {
        "no 'right'": [{k: v for k, v in row.items() if k != "right"}],
        "two rows '1'": [row, row],
        "number 2 at 0.3 m after 0.7 m": [{**row, "left": {**row["left"], "hooks": [0.7, 0.3]}}],
    }
    for message, rows in broken.items():
        path.write_text(json.dumps({**tree, "rows": rows}))
        with pytest.raises(InputError, match=message):
            House.load(path)


def test_hooks_of_a_house_file_are_recognised_by_their_spacing_alone(where: str) -> None:
    stems = Stems()
    inside = stems.at[(stems.at > 0) & (stems.at < 10)]
    record_house(house(rows=(Row("1", Side(POSTS, tuple(inside)), None),)), where)
    record_house(house(), where)  # again, with another row: the stems stay
    planned = [s.plant for s in read_stems("north", where)]
    found = record_pass(stems.seen(0.1, time=datetime.now(UTC) + timedelta(hours=1)), where)
    assert list(found.plants) == planned
    assert not any(found.new)


def test_the_posterior_is_the_sum_over_all_alignments() -> None:
    """By brute force: all monotone alignments of three hooks to three, over all slides."""
    rng, bins = np.random.default_rng(3), 96
    slides, tails = np.linspace(-0.4, 0.4, bins), 4.0
    kernel = match._kernel(slides, 0.02, 0.1)
    moved, scale = rng.normal(0, 0.1, (3, 3)), rng.uniform(0.03, 0.06, (3, 3))
    weight, skip, add = rng.uniform(0.2, 3, (3, 3)), rng.uniform(0.01, 0.2, 3), rng.uniform(0.05, 0.5, 3)
    low, high = np.zeros(4, int), np.full(4, 3)
    given = (low, high, slides, kernel, tails)
    forward = match._forward(moved, scale, weight, skip, add, *given)
    flipped = [np.ascontiguousarray(table[::-1, ::-1]) for table in (moved, scale, weight)]
    backward = match._forward(*flipped, skip[::-1].copy(), add[::-1].copy(), *given)
    shares = match._combined(moved, scale, weight, low, *forward, low, *backward, slides, tails)
    total, expected = 0.0, np.zeros((3, 3))
    for size in range(4):
        for rows, columns in product(combinations(range(3), size), combinations(range(3), size)):
            slide = np.full(bins, 1 / bins)
            for i, j in zip(rows, columns, strict=True):
                density = student.pdf((moved[i, j] - slides) / scale[i, j], tails) / scale[i, j]
                slide = (slide @ kernel) * weight[i, j] * density
            p = slide.sum() * np.prod(np.delete(skip, rows)) * np.prod(np.delete(add, columns))
            total += p
            for i, j in zip(rows, columns, strict=True):
                expected[i, j] += p
    assert forward[2] == pytest.approx(np.log(total))
    assert backward[2] == pytest.approx(np.log(total))
    np.testing.assert_allclose(shares, expected / total, rtol=1e-9)


def test_a_pass_is_a_file(tmp_path: Path) -> None:
    check_kept(Stems().seen(0), tmp_path / "pass.npz")
