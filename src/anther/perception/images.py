"""Images from files, which may be damaged, truncated or far larger when decoded. H x W pixels."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core.errors import bad_input
from anther.core.files import LARGEST_TEXT, whole_file
from anther.core.libraries import MOST_PIXELS
from anther.core.opencv import cv2


def read_image(path: Path | str, flags: int, size: tuple[int, int] | None = None) -> NDArray[Any]:
    """Return an image as OpenCV reads it: (H, W), or (H, W, 3) as the flags say; as the camera took it, not turned.

    Args:
        path: a PNG, a JPEG or what else OpenCV reads, of no more pixels than `libraries.MOST_PIXELS`.
        flags: `cv2.IMREAD_COLOR_RGB` or another.
        size: (width, height) that it must have [px].

    Raises:
        InputError: missing, no image, damaged, truncated, or of another size.
    """
    data, flags = whole_file(path, LARGEST_TEXT).read_bytes(), flags | cv2.IMREAD_IGNORE_ORIENTATION
    stated = _stated_size(data)
    if size is not None and stated is not None and stated != size:  # before it is decoded: that may take gigabytes
        raise _other_size(path, stated, size)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if is_intact(data) else None
    except cv2.error as error:
        given, allowed = (
            " ".join(f"what OpenCV refuses ({error})".split()),
            f"at most {MOST_PIXELS / 1e6:.0f} million px",
        )
        raise bad_input(str(path), given=given, allowed=allowed, do="Is it the right file?") from error
    if image is None:
        raise bad_input(
            str(path),
            given=f"{len(data)} bytes that are not a whole image",
            allowed="PNG, JPEG or TIFF",
            do="It is truncated or damaged; copy it again.",
        )
    if size is not None and image.shape[1::-1] != size:
        raise _other_size(path, (image.shape[1], image.shape[0]), size)
    return image


def _other_size(path: Path | str, given: tuple[int, int], size: tuple[int, int]) -> Exception:
    return bad_input(
        str(path),
        given=f"{given[0]} x {given[1]} px",
        allowed=f"{size[0]} x {size[1]} px, the size stated for the camera (w, h)",
        do="Depth must be aligned to colour and have its size.",
    )


def _stated_size(data: bytes) -> tuple[int, int] | None:
    """Return (width, height) as a PNG's first chunk states them; None for others."""
    if data[12:16] != b"IHDR" or len(data) < 24:
        return None
    return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")


def is_intact(data: bytes) -> bool:
    """Return whether a PNG's chunks are whole (decoders fill a truncated image silently) or a JPEG has its end.

    Other images are checked by the decoder alone.
    """
    if data.startswith(b"\xff\xd8"):
        return b"\xff\xd9" in data[-65536:]
    if not data.startswith(b"\x89PNG\r\n\x1a\n"):
        return len(data) > 0
    at = 8
    while at + 12 <= len(data):
        end = at + 12 + int.from_bytes(data[at : at + 4], "big")
        if end > len(data) or zlib.crc32(data[at + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
            return False
        if data[at + 4 : at + 8] == b"IEND":
            return True
        at = end
    return False
