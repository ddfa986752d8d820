"""Depth on thin parts: what a real stereo camera reads of a plant, and what the simulated one reads of the same scene.

One real frame (--data; D435, silk shrub at 0.5 m, background at 2-7 m) in which green is the plant. Its scene is
rebuilt from the mask and the readings, and seen by the simulated camera with a D435's baseline: as a nominal trial has
it, and as --draws wide trials draw it. Simulated plants beside it, as a nominal trial's wrist camera sees them. Widths
are those of the largest disc in the mask that covers a pixel. The bounds of `truth.WIDE` are judged by this table; one
frame fits no constant.

Keys of the --json file, for real, nominal, wide_low, wide_median, wide_high (5 %, 50 % and 95 % quantile of the draws,
each key by itself) and plants: <which>_thin_right, _thin_none, _thin_behind (shares of pixels in parts under
6.5 mm: the plant's depth, no reading, the background's), <which>_right, _none, _behind (of all the plant's pixels),
<which>_near_outside (share of the pixels up to 1.5 px outside that read the plant's depth); frame_s (seconds of
the simulated depth of one frame of 1280 x 720).
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from anther.core import Intrinsics
from anther.sim import NOMINAL, Organ
from anther.sim.capture import DepthNoise, camera_errors, noisy_depth
from anther.sim.render import d455
from anther.sim.truth import Truth, draw
from evaluation.harness import finish, options, progress
from evaluation.perception.simulated import take
from evaluation.tables import markdown, percent

FRAME = "stickbug"
COLOUR_FOCAL, FOCAL = 1361.9, 640.0
"""Of the colour camera to which depth was aligned, 1920 px wide, and of the stereo pair, 1280 px wide [px]: repeated
readings in blocks of 2.1 px, and steps of z^2 / (32 f B) with a D435's B of 50 mm."""
D435 = {"baseline": 0.050, "max_range": 60.0}
BETWEEN = 1.2
"""Nothing but the plant is nearer, no part of it farther [m]."""
THIN = 6.5
CLASSES = (0.0, 2.5, 4.0, THIN, 10.0, 15.0, 99.0)
"""Bounds of the classes of width [mm]."""
NAMES = ("right", "none", "behind")


@dataclass(frozen=True, eq=False)
class View:
    """A plant as one camera sees it.

    Attributes:
        mask: (H, W) the plant.
        exact: (H, W) depth [m].
        intrinsics: of the image.
    """

    mask: NDArray[np.bool_]
    exact: NDArray[np.float32]
    intrinsics: Intrinsics

    @property
    def width_mm(self) -> NDArray[np.float32]:
        """(H, W) width of the part that a pixel of the plant belongs to [mm]."""
        return disc_width(self.mask) * self.exact * np.float32(1e3 / self.intrinsics.fx)

    def fates(self, reading: NDArray[Any]) -> NDArray[np.float32]:
        """Return (H, W, 3) which pixels read the plant's depth, nothing, or what is behind."""
        right = (reading > 0) & (reading < self.exact + 0.1)
        return np.stack([right, reading == 0, ~right & (reading > 0)], axis=-1).astype(np.float32)


def disc_width(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return (H, W) the diameter of the largest disc within the mask that covers a pixel [px]; 0 outside."""

    def inside(pixels: NDArray[np.bool_]) -> NDArray[Any]:
        return cv2.distanceTransform(pixels.astype(np.uint8), cv2.DIST_L2, 5)

    width, deep = np.zeros(mask.shape, np.float32), inside(mask)
    for radius in np.arange(1.0, min(float(deep.max()), 30.0) + 0.5, 0.5):
        width[mask & (inside(deep < radius) < radius)] = 2 * radius - 1
    return width


def real_view(folder: Path) -> tuple[View, NDArray[np.float32]]:
    """Return the real frame's scene at the stereo pair's resolution, and what the real camera read (H, W) [m]."""
    depth = cv2.imread(str(folder / f"{FRAME}_depth_1920x1080.png"), cv2.IMREAD_UNCHANGED)
    colour = cv2.imread(str(folder / f"{FRAME}_rgb_1280x720.png"))
    assert depth is not None
    assert colour is not None
    size = tuple(int(side * FOCAL / COLOUR_FOCAL) for side in depth.shape[::-1])
    reading = cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST).astype(np.float32) / 1000
    mask = cv2.resize(_green(colour).astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5
    near = (reading > 0.2) & (reading < BETWEEN)
    plant = cv2.medianBlur(_spread(reading, near & mask), 5)
    exact = np.where(mask, plant, _spread(reading, (reading >= BETWEEN) & ~mask)).astype(np.float32)
    lens = Intrinsics(*size, FOCAL, FOCAL, (size[0] - 1) / 2, (size[1] - 1) / 2)
    return View(mask, exact, lens), reading


def _green(bgr: NDArray[Any]) -> NDArray[np.bool_]:
    """Return (H, W) the silk shrub's leaves and stems of the real frame, specks left out."""
    blue, green, red = np.moveaxis(bgr.astype(np.float32), -1, 0)
    hue, _, value = np.moveaxis(cv2.cvtColor(bgr, cv2.COLOR_BGR2HSV), -1, 0)
    excess = (2 * green - red - blue) / (red + green + blue + 1)
    mask = ((excess > 0.06) & (hue > 30) & (hue < 95) & (value < 200)).astype(np.uint8)
    _, label, stats, _ = cv2.connectedComponentsWithStats(cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((2, 2))))
    large = stats[:, cv2.CC_STAT_AREA] >= 150
    large[0] = False
    return large[label]


def _spread(values: NDArray[Any], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the nearest known value at every pixel."""
    at = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return values[tuple(np.asarray(at))]


def plant_views(count: int) -> list[tuple[View, NDArray[np.float32]]]:
    """Return (view, reading) of simulated plants as a nominal trial's wrist camera sees them."""
    out = []
    for k in range(count):
        _, capture, truth = take(("tomato", "pepper")[k % 2], 10 + k // 2, views=3)
        view = View(truth.organ[1] <= Organ.FLOWER, truth.depth[1], capture.intrinsics)
        out.append((view, capture.depth[1]))
    return out


def seen_by(truth: Truth, view: View, seed: int) -> NDArray[np.float32]:
    """Return what the simulated D435 of one trial reads of a scene (H, W) [m]."""
    sensor = replace(camera_errors(truth).depth, **D435)
    return noisy_depth(view.exact, view.intrinsics, np.random.default_rng(seed), sensor)


def shares(views: list[tuple[View, NDArray[np.float32]]]) -> dict[str, Any]:
    """Return the shares of all pixels, of thin parts, and by class of width (C, 3), all views pooled."""
    fates = np.concatenate([view.fates(reading)[view.mask] for view, reading in views])
    width = np.concatenate([view.width_mm[view.mask] for view, _ in views])
    outside = np.concatenate([near_outside(view, reading) for view, reading in views])
    classes = np.digitize(width, CLASSES) - 1
    each = np.array([fates[classes == k].mean(axis=0) for k in range(len(CLASSES) - 1)])
    parts = (("thin_", fates[width < THIN].mean(axis=0)), ("", fates.mean(axis=0)))
    found = {f"{part}{name}": float(v) for part, row in parts for name, v in zip(NAMES, row, strict=True)}
    return found | {"near_outside": float(outside.mean()), "classes": each}


def near_outside(view: View, reading: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return (n,) whether the pixels up to 1.5 px outside the plant read its depth."""
    beside = cv2.distanceTransform((~view.mask).astype(np.uint8), cv2.DIST_L2, 5)
    band, nearest = (beside > 0) & (beside <= 1.5), _spread(view.exact, view.mask)
    return (reading[band] > 0) & (reading[band] < nearest[band] + 0.1)


def quantiles(rows: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the 5 %, 50 % and 95 % quantile of every number of the wide draws."""
    return {
        f"wide_{name}": {key: np.quantile([row[key] for row in rows], q, axis=0) for key in rows[0]}
        for name, q in (("low", 0.05), ("median", 0.5), ("high", 0.95))
    }


def frame_seconds() -> float:
    """Return the seconds that the simulated depth of one frame takes, the best of five."""
    lens, times = d455(), []
    depth = np.full((lens.height, lens.width), 1.0, np.float32)
    depth[:, ::16] = 0.6
    for seed in range(5):
        begin = time.perf_counter()
        noisy_depth(depth, lens, np.random.default_rng(seed), DepthNoise())
        times.append(time.perf_counter() - begin)
    return min(times)


def main() -> None:
    """Run, print the table, write --json."""
    own = {"--draws": (60, "wide trials"), "--plants": (6, "simulated plants")}
    args = options(__doc__, quick="a quarter of draws and plants", data="captures/real_frames", own=own)
    if not (args.data / f"{FRAME}_depth_1920x1080.png").exists():
        sys.exit(f"no real frame: {args.data} is missing (set ANTHER_DATA)")
    draws, plants = (-(-n // 4) if args.quick else n for n in (args.draws, args.plants))
    view, reading = real_view(args.data)
    found = {"real": shares([(view, reading)]), "nominal": shares([(view, seen_by(NOMINAL, view, 0))])}
    wide = [shares([(view, seen_by(draw(seed), view, seed))]) for seed in progress(range(draws), "wide trials")]
    found |= quantiles(wide) | {"plants": shares(plant_views(plants))}
    heads = [name.replace("_", " ") for name in found]
    lines = [
        (f"{low:g}-{high:g} mm: {name}", *(percent(row["classes"][k][i]) for row in found.values()))
        for k, (low, high) in enumerate(zip(CLASSES, CLASSES[1:], strict=False))
        for i, name in enumerate(NAMES)
    ]
    keys = [key for key in found["real"] if key != "classes"]
    lines += [(key.replace("_", " "), *(percent(row[key]) for row in found.values())) for key in keys]
    metrics = {f"{name}_{key}": float(row[key]) for name, row in found.items() for key in keys}
    finish(args, metrics | {"frame_s": frame_seconds()}, markdown(("", *heads), lines))


if __name__ == "__main__":
    main()
