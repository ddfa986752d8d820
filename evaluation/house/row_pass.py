"""Does a camera at a cart's side find the hooks and the posts of a row? Simulated rows that nobody looked at before.

    python -m evaluation.house.row_pass --rows 20

A cart passes each row at 0.2 to 0.5 m/s; camera and rocking are drawn wide (`anther.sim.draw`), the odometry has a
wrong scale and drifts. A hook is found if one is seen within 5 cm of it and none nearer to another; what else is seen
is spurious. Its place along the rails is told by the odometry from where the drive began, and by the posts that were
read. A pepper has two strings, so two hooks.
"""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import numpy as np

from anther.core import Array
from anther.perception import SeenRow, find_hooks
from anther.plant import Crop
from anther.sim import draw, drive_past, grow_row
from evaluation.harness import CROPS, by_turns, finish, options, progress
from evaluation.tables import markdown, percent

WITHIN = 0.05
"""How far from its true place a hook is still that hook [m]: a third of the least between those of a pepper."""


class Judged(NamedTuple):
    """What was seen of one row. H hooks of its near line, of which F were found.

    Attributes:
        crop, frames, seconds: of the row, of the drive, and of processor time to see it.
        hooks, spurious: how many.
        by_odometry, by_posts: (F,) errors of places along the rails [m]; none by posts where none was read.
        posts, read: how many stand in the section, and were read.
        head: (F, 3) error of a head's height, the error that is stated, and the true height below the wire [m].
    """

    crop: Crop
    frames: int
    seconds: float
    hooks: int
    spurious: int
    by_odometry: Array
    by_posts: Array
    posts: int
    read: int
    head: Array


def judged_row(crop: Crop, seed: int) -> Judged:
    """Grow a row, pass it, and judge what was seen."""
    row, rng = grow_row(crop, seed), np.random.default_rng([seed, 19])
    drive = drive_past(row, seed, speed=rng.uniform(0.2, 0.5), truth=draw(seed))
    images, m = list(drive.frames()), row.measures
    begin = time.process_time()
    seen = find_hooks(images, drive.intrinsics, drive.T_cart_cam, line=m.near, wire=m.wire)
    seconds = time.process_time() - begin
    stems = [(plant, twine) for plant in row.plants[: row.near] for twine in plant.twines]
    true = np.array([twine.hook[1] for _, twine in stems])
    tips = np.array([plant.end[plant.organ == plant.organ[t.segment], 2].max() for plant, t in stems]) - m.wire
    posts = {tag.number: float(tag.box.lower[1] + tag.box.upper[1]) / 2 for tag in row.tags}
    posts = {tag: at for tag, at in posts.items() if drive.place[0] <= at <= drive.place[-1]}
    of, hook = pairs(np.interp(seen.position, drive.odometry, drive.place), true).T
    places = by_posts(seen, posts)
    heads = np.column_stack([seen.appearance[of, 0] - m.wire - tips[hook], seen.appearance_std[of, 0], tips[hook]])
    return Judged(
        crop, len(images), seconds, len(true), len(seen.position) - len(of),
        seen.position[of] - drive.odometry[0] + drive.place[0] - true[hook],
        np.zeros(0) if places is None else places[of] - true[hook],
        len(posts), sum(tag in posts for tag, _ in seen.posts), heads,
    )  # fmt: skip


def pairs(seen: Array, true: Array) -> Any:
    """Return (F, 2) numbers of what was seen and of the hook that it is, the nearest first."""
    away, found = np.abs(seen[:, None] - true), list[tuple[int, int]]()
    for k in np.argsort(away, axis=None):
        i, j = divmod(int(k), len(true))
        if away[i, j] <= WITHIN and all(i != a and j != b for a, b in found):
            found.append((i, j))
    return np.array(sorted(found), dtype=int).reshape(-1, 2)


def by_posts(seen: SeenRow, posts: dict[int, float]) -> Array | None:
    """Return places (M,) along the rails, stretched from post to post; None where none was read."""
    read = [(at, posts[tag]) for tag, at in seen.posts if tag in posts]
    if not read:
        return None
    odometry, built = np.array(read).T
    x = seen.position
    return np.interp(x, odometry, built) + np.minimum(x - odometry[0], 0) + np.maximum(x - odometry[-1], 0)


def metrics_of(rows: list[Judged]) -> dict[str, float]:
    """Return shares and errors of the rows of one crop."""
    odometry, posts, head = (np.concatenate([getattr(r, n) for r in rows]) for n in ("by_odometry", "by_posts", "head"))
    hooks, head = sum(r.hooks for r in rows), head[np.isfinite(head[:, 0])]
    error = head[:, 0] - np.median(head[:, 0]) if len(head) else np.zeros(0)
    return {
        "rows": len(rows),
        "hooks": hooks,
        "found": len(odometry) / hooks,
        "spurious_per_hook": sum(r.spurious for r in rows) / hooks,
        "place_rms_odometry_mm": 1e3 * float(np.sqrt(np.mean(odometry**2))),
        "place_rms_posts_mm": 1e3 * float(np.sqrt(np.mean(posts**2))),
        "place_p95_posts_mm": 1e3 * float(np.quantile(np.abs(posts), 0.95)),
        "posts": sum(r.posts for r in rows),
        "posts_read": sum(r.read for r in rows) / max(sum(r.posts for r in rows), 1),
        "head_seen": len(head) / max(len(odometry), 1),
        "head_error_mm": 1e3 * float(error.std()),
        "head_spread_mm": 1e3 * float(head[:, 2].std()),
        "head_error_over_stated": float(np.sqrt(np.mean((error / head[:, 1]) ** 2))),
        "seconds_a_frame": sum(r.seconds for r in rows) / sum(r.frames for r in rows),
    }


WORDS = {
    "hooks": "hooks of the near line",
    "found": "found",
    "spurious_per_hook": "spurious, of as many hooks",
    "place_rms_odometry_mm": "place along the rails by odometry, rms (mm)",
    "place_rms_posts_mm": "by posts, rms (mm)",
    "place_p95_posts_mm": "by posts, 95 % within (mm)",
    "posts": "posts",
    "posts_read": "their tags read",
    "head_seen": "heads seen",
    "head_error_mm": "height of a head, error (mm)",
    "head_spread_mm": "true heights, spread (mm)",
    "head_error_over_stated": "error of heads over the stated one",
    "seconds_a_frame": "processor time of a frame (s)",
}


def main() -> None:
    """Pass rows, judge, print a table, write metrics."""
    own = {"--rows": (20, "by turns of tomato and pepper")}
    args = options(__doc__, quick="4 rows", seed=(7000, "of the first two rows"), own=own)
    cases = by_turns(4 if args.quick else args.rows, args.seed)
    rows = [judged_row(*cases[k]) for k in progress(range(len(cases)), "rows")]
    found = {crop: metrics_of([row for row in rows if row.crop == crop]) for crop in CROPS}
    shares = ("found", "spurious_per_hook", "posts_read", "head_seen")
    lines = [
        (words, *(percent(of[key], 1) if key in shares else f"{of[key]:.3g}" for of in found.values()))
        for key, words in WORDS.items()
    ]
    metrics = {f"{key}_{crop}": value for crop, of in found.items() for key, value in of.items()}
    finish(args, metrics, markdown(("", *CROPS), lines))


if __name__ == "__main__":
    main()
