"""Picture of masks for docs/reports/masks.md: one view per light."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from anther.perception.masks import FLOWER, PLANT

GREEN, MAGENTA = (60, 220, 60), (230, 40, 230)


def overlaid(rgb: NDArray[Any], labels: NDArray[Any]) -> NDArray[Any]:
    """Return an image (H, W, 3) beside itself darkened, with plant in green and flowers in magenta."""
    out = rgb // 2
    for label, colour in ((PLANT, GREEN), (FLOWER, MAGENTA)):
        out[labels == label] = (0.4 * rgb[labels == label] + 0.6 * np.array(colour)).astype(np.uint8)
    return np.hstack([rgb, out])


def light_sheet(path: Path, shown: dict[Any, NDArray[Any]]) -> None:
    """Draw the pictures of each (species, light), all of a species in one row."""
    tiles = []
    for (species, light), pair in shown.items():
        left, right = np.hsplit(pair, 2)
        tile = cv2.resize(np.hstack([left[:, 240:1040], right[:, 240:1040]]), (340, 153), interpolation=cv2.INTER_AREA)
        cv2.putText(tile, f"{species}, {light}".replace("_", " "), (6, 14), 0, 0.42, (255, 255, 255), 1, cv2.LINE_AA)
        tiles.append(tile)
    columns = -(-len(tiles) // len({species for species, _ in shown}))  # a row for each species
    rows = [np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)]
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet = np.vstack(rows) // 16 * 16  # fewer colours, small enough for the documentation
    cv2.imwrite(str(path), sheet[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
