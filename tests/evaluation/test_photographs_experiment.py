"""evaluation/perception/photographs.py: what counts as found, what is told to be a stem, the way by words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from anther.core.errors import InputError
from anther.perception.masks import FLOWER, PLANT
from anther.perception.masks.by_words import Params
from evaluation.perception import photographs
from evaluation.perception import photographs_looks as looks

NOTHING: dict[str, Any] = {"flowers": [], "ignore": [], "stems": [], "other": []}
EMPTY = np.zeros((200, 300), dtype=np.uint8)


def score(row: dict[str, Any], labels: np.ndarray, stems: np.ndarray | None = None) -> dict[str, float]:
    no_stems = np.zeros(labels.shape, dtype=bool)
    row = NOTHING | {"stems": [[4, [[5, 5], [9, 5]]]]} | row
    one = photographs.judged(row, np.zeros((*labels.shape, 3), np.uint8), labels, no_stems if stems is None else stems)
    return photographs.metrics([one])


def flowers_at(*places: tuple[int, int]) -> np.ndarray:
    labels = EMPTY.copy()
    for place in places:
        cv2.circle(labels, place, 4, FLOWER, -1)
    return labels


@pytest.mark.parametrize(
    ("patches", "found", "right", "counted"),
    [
        ([(100, 50)], 1, 1, 1),
        ([(92, 50), (108, 50)], 1, 1, 1),  # sepals part a flower
        ([(130, 50)], 0, 0, 1),  # beside it
        ([(100, 50), (200, 150)], 1, 1, 1),  # the second is in a box where nobody is sure
        ([], 0, 0, 0),
    ],
)
def test_patches_are_counted_once_a_flower(
    patches: list[tuple[int, int]], found: int, right: int, counted: int
) -> None:
    values = score({"flowers": [[100, 50, 20]], "ignore": [[190, 140, 210, 160]]}, flowers_at(*patches))
    assert (values["flowers_found"], values["patches_right"], values["patches"]) == (found, right, counted)


def test_one_patch_finds_one_flower() -> None:
    values = score({"flowers": [[100, 50, 20], [110, 50, 20]]}, flowers_at((105, 50)))
    assert (values["flowers_found"], values["patches"]) == (1, 1)


def test_a_stem_is_found_if_half_is_masked_and_its_precision_is_of_the_points_that_are_told() -> None:
    row = {"stems": [[4, [[20, 100], [120, 100]]], [4, [[20, 150], [120, 150]]]]}
    labels, told = EMPTY.copy(), np.zeros(EMPTY.shape, dtype=bool)
    labels[98:103, 20:90] = labels[148:153, 20:60] = PLANT
    told[100, 20:70] = True
    looked = [[30, 100, 1], [40, 100, 1], [50, 100, 0], [200, 100, 1]]  # the last is no longer told
    values = score(row | {"looked": looked}, labels, told)
    assert values["stems_found"] == 1
    assert values["stem_length_covered"] == pytest.approx(0.55, abs=0.03)
    assert values["stem_length_told"] == pytest.approx(0.26, abs=0.03)
    assert values["stem_precision"] == pytest.approx(2 / 3)


def test_slender_parts_are_narrow_and_long() -> None:
    plant = np.zeros((600, 800), dtype=np.uint8)  # a stem here is narrower than 24 px and longer than 75
    cv2.line(plant, (50, 50), (250, 300), 1, 9)  # stem
    cv2.line(plant, (400, 50), (400, 90), 1, 9)  # too short
    cv2.circle(plant, (600, 300), 90, 1, -1)  # leaf
    told = looks.slender(plant > 0)
    assert told[175, 150]
    assert not told[:, 350:].any()


class KnownNetworks:
    """Finds a leaf everywhere, a stem in the left column, a flower in one corner."""

    device = None

    def find(self, images: np.ndarray, words: Any) -> Any:
        found = np.zeros((3, *images.shape[1:3]), dtype=bool)
        found[0], found[1, :, :2], found[2, :2, :2] = True, True, True
        return [(found, np.array([words.index(word) for word in ("leaves.", "stem.", "flower.")]))]


def test_by_words_stems_are_what_that_word_found() -> None:
    labels, stems = looks.named(KnownNetworks(), Params(), np.zeros((6, 8, 3), dtype=np.uint8))
    assert (labels[:2, :2] == FLOWER).all()
    assert (labels == FLOWER).sum() == 4
    assert (labels > 0).all()
    assert stems[:, :2].all()
    assert not stems[:, 2:].any()


def test_only_the_part_that_is_photograph_is_looked_at() -> None:
    rgb = np.zeros((40, 60, 3), dtype=np.uint8)
    seen: list[tuple[int, ...]] = []

    def look(part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        seen.append(part.shape)
        return np.full(part.shape[:2], PLANT, np.uint8), np.ones(part.shape[:2], bool)

    labels, stems = photographs.seen(rgb, (10, 5, 30, 25), look)
    assert seen == [(20, 20, 3)]
    assert (labels > 0).sum() == stems.sum() == 400
    assert stems[5:25, 10:30].all()


def test_weights_that_are_missing_are_named(tmp_path: Path) -> None:
    """With weights, tiny ones too, the networks' own tests go the whole way."""
    with pytest.raises(InputError, match="lacks the weights"):
        looks.by_words(tmp_path, "grounded-sam2")
