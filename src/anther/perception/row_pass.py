"""Hooks and stems of a row, seen on the way along it by one camera at a cart's side.

A string is too thin for a depth camera. It is found by parallax: each image tells where thin upright lines are, lighter
or darker than what is on both sides; these votes are cast on planes along the rails at several distances, and a line is
where those of many frames meet. From each place on the wire the best way down through the votes is followed (dynamic
programming over slices of height); what it meets, against what lines among leaves are met by chance, is the evidence
for a hook there. Hooks are found without colour; the odometry's scale is left to posts.

The cart's frame is x towards the plants, y along the rails, z up, x = y = 0 where it stands. M hooks, X planes,
Z slices from above, Y cells along the rails.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import maximum_filter

from anther.core.checks import check_array, check_range, check_transform
from anther.core.errors import bad_input
from anther.core.geometry import Array, Intrinsics, inverse, transform_points
from anther.core.opencv import cv2
from anther.core.records import Range, Record, Shape
from anther.perception.masks import green_pixels

__all__ = ["SeenRow", "find_hooks"]

CELL, SLICE = 0.002, 0.015
"""Along the rails, as wide as a string, and in height [m]."""
ASIDE = 0.05
"""How far from the line of hooks what hangs on it is [m]: half of the least from there to what else hangs, a guess."""
APART = 0.03
"""Hooks on one wire are further apart [m]: a guess."""
Images = Iterable[tuple[float, NDArray[np.uint8]]]
"""What the cart's odometry reads [m], and the image (H, W, 3) that is taken there."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenRow(Record):
    """What was seen on the way along a side of a row, in the order of the way.

    Attributes:
        position: (M,) of each hook by the odometry [m].
        across: (M,) its distance x in the cart's frame [m].
        evidence: (M,) ln of how much better a line explains what was seen there than chance.
        posts: (number of the tag, its position by the odometry [m]).
        begin, end: the section that was looked at, by the odometry [m].
        appearance: (M, 1) the height of the stem's head, where the bare string begins [m]; NaN: not seen.
        appearance_std: (M, 1) its error [m].
    """

    CALLED = "seen row"
    position: Annotated[Array, Shape("M"), Range(unit="m")]
    across: Annotated[Array, Shape("M"), Range(unit="m")]
    evidence: Annotated[Array, Shape("M")]
    posts: tuple[tuple[int, float], ...]
    begin: float
    end: float
    appearance: Annotated[Array, Shape("M", 1, missing=True)]
    appearance_std: Annotated[Array, Shape("M", 1, missing=True)]


def find_hooks(
    frames: Images, intrinsics: Intrinsics, T_cart_cam: ArrayLike, *, line: float, wire: float, tag: float = 0.12
) -> SeenRow:
    """Return the hooks of the near line of a row, their stems, and the posts' tags (AprilTag 36h11).

    Args:
        frames: on the way, about 5 to 10 cm apart, of one section of up to 30 m.
        intrinsics: of the camera.
        T_cart_cam: (4, 4) where it is on the cart.
        line: distance of the line of hooks from the rails' middle, x, within 0.1 m [m].
        wire: height of the wire they hang on [m].
        tag: edge of the tags' black squares [m].

    Raises:
        InputError: no frames, frames of another size or not in the order of the way, or a camera that does not look
            at the line of hooks.
    """
    line, wire = (
        check_range("line of hooks", line, 0.05, 5.0, "m"),
        check_range("height of the wire", wire, 0.5, 10.0, "m"),
    )
    plane = _Plane.of(intrinsics, check_transform("T_cart_cam", T_cart_cam), line, wire)
    reader, tags = _TagReader(intrinsics, plane.T_cart_cam, tag), list[tuple[int, float]]()
    odometry, votes, green = list[float](), list[NDArray[np.float32]](), list[NDArray[np.float32]]()
    for at, taken in frames:
        rgb = check_array("frame", taken, (intrinsics.height, intrinsics.width, 3), dtype=np.uint8)
        odometry.append(float(at))
        image = plane.image(rgb)
        votes.append(_lines(image))
        green.append(green_pixels(image).astype(np.float32))
        tags += [(number, at + place[1]) for number, place in reader.read(rgb) if place[0] < line + 1.0]  # m, this row
    places = check_array("odometry", odometry, (None,))
    if len(places) < 3 or np.any(np.diff(places) <= 0) or np.ptp(places) > 30:
        given = f"{len(places)} frames in {np.ptp(places) if len(places) else 0:.1f} m"
        do = "Drive on without stops, one section after another; a cart that comes back counts from its end."
        raise bad_input("frames of a pass", given=given, allowed="3 or more in up to 30 m, each further on", do=do)
    sweep = _Sweep.of(plane, places, votes)
    measured = [_measured(plane, sweep, votes, hook) for hook in _hooks(sweep)]
    hooks = _of_line([hook for hook in measured if places[0] <= hook.position <= places[-1]], line)
    heads = np.array([_head(plane, sweep, green, hook) for hook in hooks]).reshape(-1, 2)
    seen = {number: float(np.median([at for n, at in tags if n == number])) for number in {n for n, _ in tags}}
    return SeenRow(
        np.array([hook.position for hook in hooks]), np.array([hook.across for hook in hooks]),
        np.array([hook.evidence for hook in hooks]), tuple(sorted(seen.items(), key=lambda post: post[1])),
        float(places[0]), float(places[-1]), heads[:, :1], heads[:, 1:],
    )  # fmt: skip


class _TagReader:
    """Finds tags in images, and where they are in the cart's frame (3,) [m]."""

    def __init__(self, intrinsics: Intrinsics, T_cart_cam: Array, edge: float) -> None:
        family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        how = cv2.aruco.DetectorParameters()
        how.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        self._detector = cv2.aruco.ArucoDetector(family, how)
        self._matrix, self._T_cart_cam = intrinsics.matrix, T_cart_cam
        half = check_range("edge of a tag", edge, 0.01, 1.0, "m") / 2
        self._square = half * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0.0]])

    def read(self, rgb: NDArray[np.uint8]) -> list[tuple[int, Array]]:
        corners, numbers, _ = self._detector.detectMarkers(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY))
        found = []
        for number, corner in zip([] if numbers is None else numbers.ravel(), corners, strict=True):
            ok, _, at = cv2.solvePnP(self._square, corner[0], self._matrix, np.zeros(4), flags=cv2.SOLVEPNP_IPPE_SQUARE)
            if ok:
                found.append((int(number), transform_points(self._T_cart_cam, at.reshape(1, 3))[0]))
        return found


@dataclass(frozen=True, slots=True, eq=False)
class _Plane:
    """The upright plane along the rails through the line of hooks, as far as the camera sees it. Z x W pixels.

    Upright lines are columns in it, whatever their distance. Seen on another plane it is larger or smaller about the
    camera's own place.

    Attributes:
        T_cart_cam: of the camera.
        line: x of the plane [m].
        top: height of its uppermost slice [m].
        to_pixel: (3, 3) homography from (column, row, 1), at half a slice a row, to the camera's pixels.
        valid: (Z, W) 1 where the camera sees it, else 0.
    """

    T_cart_cam: Array
    line: float
    top: float
    to_pixel: Array
    valid: NDArray[np.float32]

    @classmethod
    def of(cls, camera: Intrinsics, T_cart_cam: Array, line: float, wire: float) -> _Plane:
        T_cam_cart, height = inverse(T_cart_cam), np.arange(wire, 0, -SLICE / 2)
        middle = np.column_stack([np.full(len(height), line), np.full(len(height), T_cart_cam[1, 3]), height])
        pixel = camera.project(transform_points(T_cam_cart, middle))
        seen = np.flatnonzero(((pixel > 4) & (pixel < [camera.width - 5, camera.height - 5])).all(axis=1))
        if len(seen) < 20 or line <= T_cart_cam[0, 3]:
            given, do = f"{len(seen) * SLICE / 2:.2f} m of it in view", "Check T_cart_cam, line and wire."
            raise bad_input("plane of the hooks below the wire", given=given, allowed="0.15 m or more", do=do)
        away = line - T_cart_cam[0, 3]
        half = int(1.2 * away * max(camera.width / camera.fx, camera.height / camera.fy) / 2 / CELL)
        half = min(half, int(0.65 * away / CELL))  # what is seen at more than 33 degrees is hidden by more leaves
        rows, wide, top = 2 * (len(seen) // 2), 2 * half + 1, float(height[seen[0]])
        corner = np.array([[0, 0, line], [CELL, 0, T_cart_cam[1, 3] - CELL * half], [0, -SLICE / 2, top]])
        to_pixel = camera.matrix @ (T_cam_cart[:3, :3] @ corner + np.outer(T_cam_cart[:3, 3], [0, 0, 1]))
        plane = cls(T_cart_cam, line, top, to_pixel, np.ones((rows // 2, wide), np.float32))
        full = plane.image(np.full((camera.height, camera.width), 255, np.uint8)) == 255
        valid = np.asarray(cv2.erode(full.astype(np.float32), np.ones((1, 15))), np.float32)
        return cls(T_cart_cam, line, top, to_pixel, valid)

    def image(self, seen: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return (Z, W, ...) what the camera sees on it, a mean over two slices of height."""
        (rows, wide), how = self.valid.shape, cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(
            cv2.blur(cv2.warpPerspective(seen, self.to_pixel, (wide, 2 * rows), flags=how), (1, 4))[::2], np.uint8
        )

    def scale(self, x: float) -> float:
        """Return how much larger it is on the plane at x."""
        return (x - self.T_cart_cam[0, 3]) / (self.line - self.T_cart_cam[0, 3])

    def onto(self, x: float, at: float) -> NDArray[np.float32]:
        """Return (2, 3) where its columns and rows lie on the plane at x: in cells from place 0, in slices from `top`.

        Args:
            x: of the other plane [m].
            at: where the cart is [m].
        """
        k, (_, y, z) = self.scale(x), self.T_cart_cam[:3, 3]
        along = (at + y) / CELL - k * (self.valid.shape[1] // 2)
        return np.array([[k, 0, along], [0, k, (1 - k) * (self.top - z) / SLICE]], np.float32)


def _lines(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return (Z, W), 0 to 1, how surely a thin line stands in an image (Z, W, 3), lighter or darker than both sides."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    found = np.zeros(grey.shape, np.float32)
    near = cv2.blur(grey, (3, 1))
    for half in (0, 1, 2):  # cells: strings of 2 mm, stems of 6 and 10 mm
        middle, gap = cv2.blur(grey, (2 * half + 1, 1)), half + 3
        wide = np.pad(near, ((0, 0), (gap, gap)), mode="edge")
        left, right = middle - wide[:, : -2 * gap], middle - wide[:, 2 * gap :]
        found = np.maximum(found, np.maximum(np.minimum(left, right), -np.maximum(left, right)))
    sure = 8.0  # grey levels: ten times the noise of a mean over two slices; 4 let leaves hide tomatoes
    best = found >= cv2.dilate(found, np.ones((1, 5)))  # a bright line is no wider than a faint one
    return np.where(best, np.minimum(found / np.float32(sure), 1), np.float32(0))


class _Sweep(NamedTuple):
    """Where votes of many frames meet.

    Attributes:
        x: (X,) distances of the planes [m].
        low: where the first cell lies along the rails [m].
        top: height of the first slice [m].
        places: (V,) of the cart [m].
        gain: (X, Z, Y) ln of how much more likely what was seen is with a line there than without.
    """

    x: Array
    low: float
    top: float
    places: Array
    gain: NDArray[np.float32]

    @classmethod
    def of(cls, plane: _Plane, places: Array, votes: Sequence[NDArray[np.float32]]) -> _Sweep:
        x = plane.line + np.arange(-0.15, 0.151, 0.01)  # m: hooks are within 0.1, and what is behind them stands out
        slices, wide = plane.valid.shape
        reach = plane.scale(x[-1]) * wide * CELL / 2
        low = float(places[0]) + plane.T_cart_cam[1, 3] - reach
        votes = [cv2.dilate(vote, np.ones((1, 5))) * plane.valid for vote in votes]  # a cart rocks by some mm
        cells = int((np.ptp(places) + 2 * reach) / CELL) + 2
        votes_for, looks = np.zeros((2, len(x), slices, cells), np.float32)
        for k, distance in enumerate(x):
            for at, vote in zip(places, votes, strict=True):
                onto = plane.onto(distance, at - low)
                first = int(onto[0, 2])
                onto[0, 2] -= first
                size = min(int(plane.scale(distance) * wide) + 2, cells - first), slices
                votes_for[k, :, first : first + size[0]] += cv2.warpAffine(vote, onto, size)
                looks[k, :, first : first + size[0]] += cv2.warpAffine(plane.valid, onto, size)
        return cls(x, low, plane.top, places, _gain(votes_for, looks))


def _gain(votes: NDArray[np.float32], looks: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return (X, Z, Y) ln of the odds that a line stands there, by the share of looks that saw one.

    By chance the share is that of all places of the same height: among leaves a vote says little. Frames look at the
    same leaves, so that all of them count as one look.
    """
    enough = looks > 2.5
    share = votes / np.maximum(looks, 1)
    count = np.maximum(enough.sum(axis=(0, 2)), 1)
    chance = np.clip((share * enough).sum(axis=(0, 2)) / count, 0.02, 0.9)[None, :, None].astype(np.float32)
    own = 0.3  # of looks at a line that see it, chance apart: strings are faint, leaves hide them (a guess)
    seen = 1 - (1 - own) * (1 - chance)
    gain = np.log(1 - own) + share * (np.log(seen / chance) - np.log(1 - own))
    return np.where(enough, gain, np.minimum(gain, -0.1))


class _Hook(NamedTuple):
    """A hook: position by the odometry and x [m], evidence, and (n, 2) plane and cell in each slice below."""

    position: float
    across: float
    evidence: float
    way: NDArray[np.intp]


LEAST = 4.0
"""Evidence of a hook, ln of odds: one hangs in about one of fifty places, each 1 cm wide."""
ALONG, ACROSS = 0.15, 0.3
"""What a step aside costs from slice to slice, by a cell along the rails or a plane across: strings are all but plumb.
Guesses: a string that slants by 5 % has one in three slices."""


def _hooks(sweep: _Sweep) -> list[_Hook]:
    """Return what hangs, on whichever line, the surest first."""
    best, below = np.zeros(sweep.gain[:, 0].shape, np.float32), []
    for gain in sweep.gain.transpose(1, 0, 2)[::-1]:
        below.append(best)
        aside = np.maximum(best, maximum_filter(best, (1, 3)) - ALONG)
        best = np.maximum(0, gain + np.maximum(aside, maximum_filter(aside, (3, 1)) - ACROSS))
    apart = 2 * int(APART / CELL) + 1
    plane, cell = np.nonzero((best == maximum_filter(best, (len(sweep.x), apart))) & (best > LEAST))
    found, taken = list[_Hook](), np.zeros(sweep.gain.shape[1:], bool)
    for k in np.argsort(-best[plane, cell]):
        hook = _followed(sweep, below[::-1], int(plane[k]), int(cell[k]), taken)
        if hook.evidence > LEAST:
            found.append(hook)
            for z, (_, y) in enumerate(hook.way):
                taken[z, max(y - apart // 2, 0) : y + apart // 2] = True
    return found


def _of_line(hooks: Sequence[_Hook], line: float) -> list[_Hook]:
    """Return those hooks that hang on one line about where it is known to be, in order along it.

    What else hangs in a row is farther away, and there is less of it.
    """
    x, known = line + np.arange(-0.1, 0.1005, 0.005), 0.05  # m, how well the line is known: a guess
    across = np.array([hook.across for hook in hooks])
    near = np.exp(-0.5 * ((across[:, None] - x) / (ASIDE / 2)) ** 2)
    best = x[
        np.argmax(LEAST * near.sum(axis=0) - 0.5 * ((x - line) / known) ** 2)
    ]  # hangers count no more than strings
    kept = list[_Hook]()
    for hook in hooks:  # the surest first; of two that the same rays moved to one place it is the one
        if abs(hook.across - best) < ASIDE and all(abs(hook.position - other.position) > APART for other in kept):
            kept.append(hook)
    return sorted(kept, key=lambda hook: hook.position)


def _measured(plane: _Plane, sweep: _Sweep, votes: Sequence[NDArray[np.float32]], hook: _Hook) -> _Hook:
    """Return a hook where the rays of all frames meet: position and distance by robust least squares.

    A frame whose line passes beside the hook by d at its distance x, at the slope t along the rails, says that it is
    d - t dx further on, dx farther away.
    """
    way, number = hook.way[: int(0.45 / SLICE)], np.arange(min(len(hook.way), int(0.45 / SLICE)))
    x, wide = sweep.x[way[:, 0]], 9  # cells to both sides
    scale, beside, seen = np.array([plane.scale(d) for d in x]), np.arange(-wide, wide + 1), list[tuple[float, float]]()
    for at, vote in zip(sweep.places, votes, strict=True):
        onto = np.array([plane.onto(d, at - sweep.low)[:, 2] for d in x])
        column, row = ((np.column_stack([way[:, 1], number]) - onto) / scale[:, None]).T
        columns = (column[:, None] + beside / scale[:, None]).astype(np.float32)
        rows = np.repeat(row[:, None], len(beside), axis=1).astype(np.float32)
        there = cv2.remap(vote * plane.valid, columns, rows, cv2.INTER_LINEAR).mean(axis=0)
        there = np.convolve(there, [0.25, 0.5, 0.25], "same")
        peak = int(np.argmax(there))
        if there[peak] > 0.1:
            slope = (hook.position - at - plane.T_cart_cam[1, 3]) / (hook.across - plane.T_cart_cam[0, 3])
            seen.append((CELL * beside[peak], slope))
    if len(seen) < 4:
        return hook
    off, slope = np.array(seen).T
    rays, weight = np.column_stack([np.ones(len(off)), -slope]), np.ones(len(off))
    moved = np.zeros(2)
    for _ in range(10):
        moved = np.linalg.lstsq(rays * weight[:, None], off * weight, rcond=None)[0]
        weight = 1 / np.sqrt(
            1 + ((off - rays @ moved) / 0.005) ** 2
        )  # m, how far a cart rocks (a guess): Cauchy's loss
    return hook._replace(position=hook.position + float(moved[0]), across=hook.across + float(moved[1]))


def _followed(sweep: _Sweep, below: Sequence[Any], plane: int, cell: int, taken: NDArray[np.bool_]) -> _Hook:
    """Return the hook above the best way down from a cell of the uppermost slice; what is `taken` is not its own."""
    cost = np.add.outer(ACROSS * np.array([1, 0, 1]), ALONG * np.array([1, 0, 1]))
    way = [(plane, cell)]
    for best in below[:-1]:
        around = np.pad(best, 1, constant_values=-1)[plane : plane + 3, cell : cell + 3] - cost
        if around.max() <= 0:
            break
        step = np.unravel_index(np.argmax(around), (3, 3))
        plane, cell = plane + int(step[0]) - 1, cell + int(step[1]) - 1
        way.append((plane, cell))
    along, number = np.array(way), np.arange(len(way))
    gain = np.where(taken[number, along[:, 1]], 0, sweep.gain[along[:, 0], number, along[:, 1]])
    upper = slice(int(0.3 / SLICE))  # m of it tell where it begins: what hangs lower swings
    weight, y = np.maximum(gain, 0.02)[upper], sweep.low + CELL * along[upper, 1]
    slope = len(y) > 5
    position = np.polyfit(number[upper], y, int(slope), w=weight)[-1]
    return _Hook(float(position), float(np.average(sweep.x[along[upper, 0]], weights=weight)), float(gain.sum()), along)


def _head(plane: _Plane, sweep: _Sweep, green: Sequence[NDArray[np.float32]], hook: _Hook) -> tuple[float, float]:
    """Return the height where the stem below a hook ends and its bare string begins, and its error [m].

    NaN where that is not in view: below it the line is green in most frames, above it in few.
    """
    number, x = np.arange(len(hook.way)), sweep.x[hook.way[:, 0]]
    scale, shares = np.array([plane.scale(distance) for distance in x]), []
    for at, image in zip(sweep.places, green, strict=True):
        onto = np.array([plane.onto(distance, at - sweep.low)[:, 2] for distance in x])
        pixel = ((np.column_stack([hook.way[:, 1], number]) - onto) / scale[:, None]).astype(np.float32)
        share = cv2.remap(image, pixel[:, :1], pixel[:, 1:], cv2.INTER_LINEAR, borderValue=-1)[:, 0]
        shares.append(np.where(share < 0, np.nan, share))
    seen = np.isfinite(shares)
    share = np.where(seen, shares, 0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    counts, sums = np.arange(1, len(share)), np.cumsum(share)
    above, below = sums[:-1] / counts, (sums[-1] - sums[:-1]) / (len(share) - counts)
    explained = counts * (len(share) - counts) / len(share) * (below - above) ** 2
    noise, alike = 0.25, 3  # of a share, and how many slices have the same leaf before them: guesses
    chance = np.exp((explained - explained.max()) / (2 * alike * noise**2))
    best, step = int(np.argmax(explained)), sweep.top - SLICE * (counts - 0.5)
    if len(share) < 6 or below[best] - above[best] < 0.25:
        return float("nan"), float("nan")
    middle = float(np.average(step, weights=chance))
    return middle, float(np.hypot(SLICE, np.sqrt(np.average((step - middle) ** 2, weights=chance))))
