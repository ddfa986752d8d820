"""Make a copy of a capture that can be given away: no names, places or texts, faces masked, calibration kept.

Nothing of the original's files is copied: images and poses are read, and written anew. So whatever else lies there,
metadata of the images, other keys, file names, is left behind.
"""

from __future__ import annotations

import re
import tempfile
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from anther.cli.args.share import Args
from anther.cli.output import free
from anther.core.errors import MissingExtra, bad_input
from anther.core.files import existing, replacing, write_json
from anther.core.opencv import cv2
from anther.perception.capture import Capture, in_threads

SHARE = "share.json"
"""What was masked, what grows there, and what others may do with it."""
FRONT, SIDE = "haarcascade_frontalface_alt2.xml", "haarcascade_profileface.xml"
Box = tuple[int, int, int, int, int]
"""View, and x, y, width, height of its part [px]."""


def run(args: Args) -> None:
    """Read, mask, write, and say what to look at."""
    capture = Capture.load(existing(args.capture))
    if args.out.resolve() == args.capture.resolve():
        raise bad_input("out", given="the capture itself", allowed="a new place", do="The original is kept.")
    boxes = [box for word in args.mask for box in read_boxes(word, capture)]
    free(args.out, overwrite=args.overwrite)
    found: list[Box] = []
    if args.faces and capture.rgb is not None:
        images = capture.rgb
        seen = in_threads(lambda view: find_faces(images[view]), range(capture.views))
        found = [(view, *box) for view, of_view in enumerate(seen) for box in of_view]
    shared = masked(capture, [*found, *boxes])
    about = {
        "kind": "shared_capture", "schema": 1, "crop": args.crop, "licence": args.licence, "views": capture.views,
        "masked": [dict(zip(("view", "x", "y", "width", "height"), box, strict=True)) for box in (*found, *boxes)],
    }  # fmt: skip
    if args.out.suffix.lower() == ".zip":
        with tempfile.TemporaryDirectory(prefix="anther-share-") as folder:
            _write(shared, about, Path(folder) / "capture")
            _archive(Path(folder) / "capture", args.out)
    else:
        _write(shared, about, args.out)
    print(f"{args.out}: {capture.views} views, {len(found)} faces and {len(boxes)} boxes masked")
    for view, x, y, width, height in found:
        print(f"  view {view}: a face at {x},{y}, {width} x {height} px")
    if capture.rgb is None:
        print("note: depth only; faces were not looked for")
    if args.licence is None:
        print("note: no licence: nobody may use it until you name one with --licence")
    print(
        "Look at every image before you give it away: faces from the side, far, covered or dark are often missed, and"
    )
    print(
        "names on clothes, labels and boards are not looked for. Mask what you find with --mask VIEW:X,Y,WIDTH,HEIGHT."
    )


def find_faces(image: Any) -> list[tuple[int, int, int, int]]:
    """Return x, y, width, height [px] of faces in an image (H, W, 3), widened: from the front, and from both sides.

    OpenCV's Haar cascades, which come with its package. They take leaves for faces now and then, which costs a box.

    Raises:
        MissingExtra: the installed OpenCV came without them.
    """
    grey = cv2.equalizeHist(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))
    width = grey.shape[1]
    found = [tuple(box) for name in (FRONT, SIDE) for box in _cascade(name).detectMultiScale(grey, 1.1, 5)]
    mirrored = _cascade(SIDE).detectMultiScale(cv2.flip(grey, 1), 1.1, 5)
    found += [(width - x - w, y, w, h) for x, y, w, h in mirrored]
    return [_widened(box, grey.shape) for box in found]


def _cascade(name: str) -> Any:
    """Return a detector of its own: one is not for several threads."""
    folder = getattr(getattr(cv2, "data", None), "haarcascades", None)
    found = cv2.CascadeClassifier(f"{folder}{name}") if folder else None
    if found is None or found.empty():
        missing = f"OpenCV came without {name}, which finds faces."
        raise MissingExtra(f"{missing} Install it with: pip install opencv-python-headless, or say --no-faces")
    return found


def _widened(box: tuple[int, ...], shape: tuple[int, ...]) -> tuple[int, int, int, int]:
    x, y, w, h = (int(value) for value in box)
    margin = 0.25  # on each side, of a box round a face: hair and ears tell who it is too (a guess)
    x0, y0 = max(int(x - margin * w), 0), max(int(y - margin * h), 0)
    x1, y1 = min(int(x + (1 + margin) * w), shape[1]), min(int(y + (1 + margin) * h), shape[0])
    return x0, y0, x1 - x0, y1 - y0


def read_boxes(word: str, capture: Capture) -> Iterator[Box]:
    """Yield the boxes that VIEW:X,Y,WIDTH,HEIGHT names.

    Raises:
        InputError: it is none, or does not lie in the image.
    """
    form = re.fullmatch(r"(all|\d+):(\d+),(\d+),(\d+),(\d+)", word)
    view, x, y, width, height = form.groups() if form else ("", "0", "0", "0", "0")
    box = int(x), int(y), int(width), int(height)
    inside = box[0] + box[2] <= capture.intrinsics.width and box[1] + box[3] <= capture.intrinsics.height
    if not (form and inside and min(box[2:]) > 0 and (view == "all" or int(view) < capture.views)):
        size = f"{capture.intrinsics.width} x {capture.intrinsics.height} px"
        allowed = f"VIEW:X,Y,WIDTH,HEIGHT within {size}, VIEW from 0 to {capture.views - 1} or 'all'"
        raise bad_input("mask", given=f"'{word}'", allowed=allowed, do="Read the box off the image.")
    for number in range(capture.views) if view == "all" else (int(view),):
        yield (number, *box)


def masked(capture: Capture, boxes: list[Box]) -> Capture:
    """Return a capture that is grey and without depth in some boxes."""
    depth, rgb = capture.depth.copy(), None if capture.rgb is None else capture.rgb.copy()
    for view, x, y, width, height in boxes:
        part = view, slice(y, y + height), slice(x, x + width)
        depth[part] = 0
        if rgb is not None:
            rgb[part] = 128
    return replace(capture, depth=depth, rgb=rgb)


def _write(capture: Capture, about: dict[str, Any], folder: Path) -> None:
    capture.save(folder)
    write_json(folder / SHARE, about)


def _archive(folder: Path, out: Path) -> None:
    """Write a .zip whose files tell neither when nor by whom they were made."""
    with replacing(out) as path, zipfile.ZipFile(path, "w") as archive:
        epoch = (1980, 1, 1, 0, 0, 0)  # time of every file in an archive: the earliest that a .zip can say
        for file in sorted(file for file in folder.rglob("*") if file.is_file()):
            entry = zipfile.ZipInfo(str(Path("capture") / file.relative_to(folder)), epoch)
            archive.writestr(entry, file.read_bytes())  # images are compressed as they are
