"""A contact sheet of photographs: masks, flowers found, missed and wrong, stems missed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

FOUND, MISSED, WRONG, MASK, STEM = (60, 220, 60), (255, 40, 40), (255, 0, 255), (0, 110, 255), (255, 255, 0)

_WIDTH = 4200  # greatest, of a row of pictures [px]


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """One image's masks beside the hand's labels.

    Attributes:
        row: the labels, as in real/photographs.json.
        rgb, labels: (H, W, 3) and (H, W) uint8.
        stems: (H, W) bool, what is told to be a stem.
        seen: of each labelled flower, whether it was found.
        right, wrong: (n, 2) middles of flower patches that are a flower, and that are none [px].
        covered: of each labelled stem, whether each pixel of its centre line is masked.
        told: the same, whether each pixel is told to be a stem.
        told_right: of each point that was looked at and is told to be a stem, whether it is one.
        other_masked: of each point that shows no plant, whether it is masked.
    """

    row: dict[str, Any]
    rgb: NDArray[Any]
    labels: NDArray[np.uint8]
    stems: NDArray[np.bool_]
    seen: list[bool]
    right: NDArray[np.float64]
    wrong: NDArray[np.float64]
    covered: list[NDArray[np.bool_]]
    told: list[NDArray[np.bool_]]
    told_right: list[bool]
    other_masked: list[bool]


def contact_sheet(path: Path, found: Sequence[Judged], height: int = 700) -> None:
    """Write all images side by side, each `height` px high.

    The mask's outline is blue, that of what is told to be a stem yellow; flowers are green (found) or red (missed),
    wrong patches magenta; stems are drawn red where the mask misses some of them, else green; points without plant that
    are masked are magenta crosses.
    """
    rows: list[list[NDArray[Any]]] = [[]]
    for one in found:
        tile = cv2.copyMakeBorder(_tile(one, height), 0, 6, 0, 6, cv2.BORDER_CONSTANT)
        if sum(other.shape[1] for other in rows[-1]) + tile.shape[1] > _WIDTH:
            rows.append([])
        rows[-1].append(tile)
    lines = [np.hstack(row) for row in rows]
    width = max(line.shape[1] for line in lines)
    lines = [cv2.copyMakeBorder(line, 0, 0, 0, width - line.shape[1], cv2.BORDER_CONSTANT) for line in lines]
    cv2.imwrite(str(path), np.vstack(lines)[..., ::-1])


def _tile(one: Judged, height: int) -> NDArray[Any]:
    image = one.rgb.copy()
    for part, colour in ((one.labels > 0, MASK), (one.stems, STEM)):
        outlines, _ = cv2.findContours(part.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(image, outlines, -1, colour, 1)
    for (_, points), covered in zip(one.row["stems"], one.covered, strict=True):
        missed = covered.mean() < 1
        cv2.polylines(
            image, [np.array(points, np.int32)], isClosed=False, color=MISSED if missed else FOUND, thickness=2
        )
    for (x, y, radius), seen in zip(one.row["flowers"], one.seen, strict=True):
        cv2.circle(image, (int(x), int(y)), int(radius) + 3, FOUND if seen else MISSED, 2)
    for x, y in one.wrong:
        cv2.circle(image, (int(x), int(y)), 9, WRONG, 3)
    for (x, y), hit in zip(one.row["other"], one.other_masked, strict=True):
        if hit:
            cv2.drawMarker(image, (int(x), int(y)), WRONG, cv2.MARKER_CROSS, 16, 3)
    scale = height / image.shape[0]
    return cv2.resize(image, (round(image.shape[1] * scale), height), interpolation=cv2.INTER_AREA)
