"""Masks by colour or by words on photographs of tomatoes in greenhouses, against labels by hand of flowers and stems.

    python -m evaluation.perception.photographs --folder PHOTOS                  # by colour
    python -m evaluation.perception.photographs --folder PHOTOS --models MODELS  # by words, see docs/masks.md

The labels are in real/photographs.json; the images are not part of Anther. That file says by repository, commit, path
and sha256 where each comes from: put them into one folder (--folder or $ANTHER_PHOTOS), those of a source's subfolders
into subfolders. What is missing is named and left out. Each image is shrunk to at most 1280 px, as wide as the arm's
camera sees, and looked at alone: there is neither depth nor pose, so one image's colours or words are what is measured,
not the masks of thirty views.

A flower is found by a patch of at least 20 flower pixels whose middle is within one flower radius of the label's;
further patches on that flower (sepals part petals) and patches in an "ignore" box count neither way. A stem is found
where half of its centre line or more has a mask pixel within 2 px, the precision of the hand. It is *told* where its
pixels are said to be of a stem (photographs_looks.py). Precision of stems: about ten points an image, drawn at random
where the masks by colour told a stem, were looked at by hand; it is the share of stems and stalks among those of them
that are told. After a change of these masks, and for words, points need to be drawn anew.
Shares have Wilson's 95 % interval, as if independent; frames of one video are not.

Half of the images were looked at when rules were chosen; the others are held out.

Keys of --json, GROUP_... for all, each light, distance and source, and of the images held out for all, each light and
each distance: images, flowers, flowers_found, patches, patches_right, flower_recall, flower_precision, stems,
stems_found, stem_recall, stem_length_covered and stem_length_told (shares of all centre lines), told, told_right,
stem_precision, other, other_masked, other_masked_share (of the points without plant), each share with _low and _high.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from anther.core.files import read_json
from anther.perception.masks import FLOWER
from anther.perception.masks.by_words import NETWORKS
from evaluation.harness import finish, options, progress
from evaluation.perception.photographs_looks import Look, by_colour, by_words
from evaluation.statistics import interval
from evaluation.tables import by_part

LABELS = Path(__file__).parent / "real" / "photographs.json"
FOLDER = os.environ.get("ANTHER_PHOTOS")

LONGEST = 1280
"""Greatest side of an image as it is looked at [px]."""

HAND = 2
"""How far a hand's line may lie from the middle of a stem [px]."""

LEAST_PATCH = 20
"""Fewer flower pixels are no find."""

HALF = 0.5
"""A stem is found if this share of its centre line is masked."""

PICTURED = ("sample-0508", "sample-0346", "train/images/IMG_2949", "train/images/IMG_20093912")
"""Images shown in the report: those of them under CC BY 4.0 that show what fails, and the last what works."""

GROUPS = ("light", "distance", "source")


def photograph(path: Path) -> NDArray[Any]:
    """Return (H, W, 3) uint8 of an image file, shrunk to the size of the labels."""
    image = np.asarray(cv2.imread(str(path)))[..., ::-1]
    scale = min(1.0, LONGEST / max(image.shape[:2]))
    size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
    return np.ascontiguousarray(cv2.resize(np.ascontiguousarray(image), size, interpolation=cv2.INTER_AREA))


def seen(rgb: NDArray[Any], crop: Sequence[int] | None, look: Look) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return labels and stems (H, W) of one image, none outside the part that is photograph."""
    labels, stems = np.zeros(rgb.shape[:2], dtype=np.uint8), np.zeros(rgb.shape[:2], dtype=bool)
    left, top, right, bottom = crop or (0, 0, rgb.shape[1], rgb.shape[0])
    part = np.s_[top:bottom, left:right]
    labels[part], stems[part] = look(np.ascontiguousarray(rgb[part]))
    return labels, stems


def patches(flower: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the middles (n, 2) [px] of the patches of a mask (H, W), those of one flower's petals joined."""
    joined = cv2.morphologyEx(flower.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    count, numbered, _, _ = cv2.connectedComponentsWithStats(joined, connectivity=8)
    number = np.asarray(numbered)[flower]
    pixels = np.argwhere(flower)[:, ::-1]
    area = np.bincount(number, minlength=count)
    middle = np.stack([np.bincount(number, pixels[:, axis], minlength=count) for axis in (0, 1)], axis=1)
    large = area >= LEAST_PATCH
    return np.asarray(middle[large] / area[large, None], dtype=np.float64)


def centre_line(points: Sequence[Sequence[float]]) -> NDArray[np.int64]:
    """Return pixels (n, 2) about 2 px apart along a line."""
    corners = np.asarray(points, dtype=np.float64)
    steps = [
        a + (b - a) * np.linspace(0, 1, max(2, int(np.hypot(*(b - a)) / 2)))[:, None]
        for a, b in zip(corners, corners[1:], strict=False)
    ]
    return np.rint(np.concatenate(steps)).astype(np.int64)


def judged(row: dict[str, Any], rgb: NDArray[Any], labels: NDArray[np.uint8], stems: NDArray[np.bool_]) -> Judged:
    """Compare one image's masks with the hand's labels."""
    height, width = labels.shape
    found = patches(labels == FLOWER)
    right, found_flowers, on_flower = [], [], np.zeros(len(found), dtype=bool)
    for x, y, radius in row["flowers"]:
        near = np.hypot(found[:, 0] - x, found[:, 1] - y) <= radius
        free = [patch for patch in np.flatnonzero(near) if patch not in right]
        right += free[:1]
        found_flowers.append(bool(free))
        on_flower |= near
    unsure = [any(a <= x <= c and b <= y <= d for a, b, c, d in row["ignore"]) for x, y in found]
    wrong = [n for n in range(len(found)) if not on_flower[n] and not unsure[n]]
    window = np.ones((2 * HAND + 1, 2 * HAND + 1), np.uint8)
    lines = [np.clip(centre_line(points), 0, (width - 1, height - 1)).T for _, points in row["stems"]]
    covered, told = (
        [near[v, u] > 0 for u, v in lines]
        for near in (cv2.dilate(part.astype(np.uint8), window) for part in (labels > 0, stems))
    )
    return Judged(
        row=row,
        rgb=rgb,
        labels=labels,
        stems=stems,
        seen=found_flowers,
        right=found[right],
        wrong=found[wrong],
        covered=covered,
        told=told,
        told_right=[bool(right) for x, y, right in row.get("looked", ()) if stems[y, x]],
        other_masked=[bool(labels[y, x] > 0) for x, y in row["other"]],
    )


def metrics(group: Sequence[Judged]) -> dict[str, float]:
    """Return the numbers of one group of images."""
    seen = [found for one in group for found in one.seen]
    right, wrong = (
        sum(len(patch) for patch in part) for part in zip(*((o.right, o.wrong) for o in group), strict=True)
    )
    lines = [line for one in group for line in one.covered]
    stems = [bool(line.mean() >= HALF) for line in lines]
    other = [hit for one in group for hit in one.other_masked]
    told = [right for one in group for right in one.told_right]
    values: dict[str, float] = {
        "images": len(group),
        "flowers": len(seen),
        "flowers_found": sum(seen),
        "patches": right + wrong,
        "patches_right": right,
        "stems": len(stems),
        "stems_found": sum(stems),
        "stem_length_covered": float(np.concatenate(lines).mean()),
        "stem_length_told": float(np.concatenate([line for one in group for line in one.told]).mean()),
        "told": len(told),
        "told_right": sum(told),
        "other": len(other),
        "other_masked": sum(other),
    }
    shares = {
        "flower_recall": (sum(seen), len(seen)),
        "flower_precision": (right, right + wrong),
        "stem_recall": (sum(stems), len(stems)),
        "stem_precision": (sum(told), len(told)),
        "other_masked_share": (sum(other), len(other)),
    }
    for name, (part, whole) in shares.items():
        if whole:
            low, high = interval(part, whole)
            values |= {name: part / whole, f"{name}_low": low, f"{name}_high": high}
    return values


def groups(found: Sequence[Judged]) -> dict[str, list[Judged]]:
    """Return all images, those of each light, distance and source, and the same of those held out."""
    kept = [one for one in found if one.row["half"] == "report"]
    named: dict[str, list[Judged]] = {}
    for start, part, kinds in (("", found, GROUPS), ("held_out_", kept, GROUPS[:2])):
        if part:
            named[f"{start}all"] = list(part)
        for kind in kinds:
            for value in sorted({one.row[kind] for one in part}):
                named[f"{start}{kind}_{value}"] = [one for one in part if one.row[kind] == value]
    return named


def images(folder: Path) -> list[tuple[dict[str, Any], Path]]:
    """Return the labelled images that are there and are the ones that were labelled; say which are not."""
    labels = read_json(LABELS)
    have = []
    for row in labels["images"]:
        path, source = folder / row["file"], labels["sources"][row["source"]]
        if path.exists() and hashlib.sha256(path.read_bytes()).hexdigest() == row["sha256"]:
            have.append((row, path))
        else:
            state = "another file" if path.exists() else "missing"
            where = f"{source['repository']}@{source['commit'][:12]}:{source['folder']}/{row['file']}"
            print(f"{row['file']} is {state}; it is {where}")
    return have


def table(found: dict[str, float], names: Iterable[str]) -> Table:
    """Return the numbers of each group, a row a group."""

    def share(key: str) -> str:
        return f"*_{key}:.2f (*_{key}_low:.2f–*_{key}_high:.2f)"

    numbers = {
        "number": "*_images:.0f",
        "flowers": "*_flowers:.0f",
        "flowers' recall": share("flower_recall"),
        "flowers' precision": share("flower_precision"),
        "stems": "*_stems:.0f",
        "stems found": share("stem_recall"),
        "stems' length masked": "*_stem_length_covered:.2f",
        "their length told": "*_stem_length_told:.2f",
        "precision of what is told": share("stem_precision"),
        "no plant, but masked": share("other_masked_share"),
    }
    return by_part(found, "images of", {name: name.replace("_", " ") for name in names}, numbers)


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


def contact_sheet(path: Path, found: Sequence[Judged], height: int = 380) -> None:
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


def main() -> None:
    """Run, print the table, write --json and --pictures."""
    own = {
        "--folder": {"type": Path, "default": FOLDER, "help": "of the images; default: $ANTHER_PHOTOS"},
        "--pictures": (Path, "write photographs.jpg into this folder, of CC BY 4.0 images"),
        "--models": (Path, "look by words, with the networks in this folder"),
        "--method": ("grounded-sam2", "which networks", sorted(NETWORKS)),
    }
    args = options(__doc__, quick="every eighth image", own=own)
    have = images(args.folder)[:: 8 if args.quick else 1] if args.folder else []
    if not have:
        print("no photographs: give --folder or set ANTHER_PHOTOS (real/photographs.json says where they are)")
        return
    look, found = by_words(args.models, args.method) if args.models else by_colour, []
    for row, path in progress(have, "photographs"):
        rgb = photograph(path)
        found.append(judged(row, rgb, *seen(rgb, row.get("crop"), look)))
    values = {name: metrics(group) for name, group in groups(found).items()}
    flat = {f"{group}_{key}": value for group, row in values.items() for key, value in row.items()}
    finish(args, flat, table(flat, values))
    if args.pictures:
        shown = [one for one in found if one.row["file"].startswith(PICTURED)]
        contact_sheet(args.pictures / "photographs.jpg", shown)


if __name__ == "__main__":
    main()
