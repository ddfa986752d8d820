"""Matroska files (.mkv): what their tracks are, and where each frame, attachment and tag stands.

Only headers are read, so that a recording may be larger than memory. Elements are walked one after the other: of a
master only its head is passed, which also reads masters whose size is not known because their writer was killed.
Format: RFC 8794 (EBML) and RFC 9559 (Matroska).
"""

from __future__ import annotations

import mmap
import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import Any, NamedTuple

from anther.core.errors import AntherError, bad_input
from anther.core.files import LARGEST_TEXT, existing, understood


class _Id(IntEnum):
    """Matroska's numbers of elements that hold others and mean something here."""

    EBML, SEGMENT, CLUSTER = 0x1A45DFA3, 0x18538067, 0x1F43B675
    TRACK, ATTACHMENT = 0xAE, 0x61A7
    COMPRESSION, ENCRYPTION = 0x5034, 0x5035


class _Packing(IntEnum):
    """Matroska's numbers of how frames are packed: zlib, and with a beginning that all share left out."""

    ZLIB, STRIPPED = 0, 3


class Place(NamedTuple):
    """Where bytes stand in the file."""

    start: int
    size: int


class Frame(NamedTuple):
    """Time since the recording's beginning [ticks], and where the frame's bytes are."""

    ticks: int
    place: Place


@dataclass(slots=True)
class Track:
    """One track: its name, codec with the codec's own header, size [px], how frames are packed (None: not)."""

    number: int = 0
    name: str = ""
    codec: str = ""
    header: bytes = b""
    width: int = 0
    height: int = 0
    packing: int | None = None
    shared: bytes = b""


@dataclass(slots=True)
class Matroska:
    """The index of a file.

    Attributes:
        path: of the file.
        tick: of the frames' times [s].
        tracks: in the file's order.
        frames: track number -> its frames.
        tags: name -> text.
        attachments: name -> its place.
        cut: the writer was killed: the file ends within an element, which is left out.
    """

    path: Path
    tick: float = 1e-3
    tracks: list[Track] = field(default_factory=list)
    frames: dict[int, list[Frame]] = field(default_factory=lambda: defaultdict(list))
    tags: dict[str, str] = field(default_factory=dict)
    attachments: dict[str, Place] = field(default_factory=dict)
    cut: bool = False

    def read(self, place: Place) -> bytes:
        """Return the bytes at a place."""
        with self.path.open("rb") as stream:
            stream.seek(place.start)
            return stream.read(place.size)

    def frame(self, track: Track, frame: Frame, most: int) -> bytes:
        """Return a frame's bytes, unpacked, at most so many and one."""
        data = self.read(frame.place)
        if track.packing == _Packing.ZLIB:
            return zlib.decompressobj().decompress(data, most + 1)
        return track.shared + data


def read_matroska(path: Path | str) -> Matroska:
    """Return the index of a Matroska file.

    Raises:
        InputError: missing, no Matroska file, damaged, or cut off.
    """
    path = existing(path)
    with understood(path, "a Matroska file", "Copy it again."), path.open("rb") as stream:
        if stream.read(4) != _Id.EBML.to_bytes(4, "big"):
            raise bad_input(str(path), given="no Matroska file", allowed="an .mkv", do="Is it the right file?")
        try:
            with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
                return _index(path, data)
        except AntherError:
            raise
        except OSError as error:
            raise ValueError(str(error)) from error


class _Element(NamedTuple):
    kind: int
    start: int
    end: int


class _CutOffError(Exception):
    """The file ends within an element of a segment whose size its writer never came to state."""


def _elements(path: Path, data: Any) -> Iterator[_Element]:
    """Yield each element's kind and where its content stands, masters before what is in them."""
    # besides: Info, Tracks, Video, ContentEncodings and one of them, BlockGroup, Attachments, Tags, Tag, SimpleTag
    masters = {*_Id, 0x1549A966, 0x1654AE6B, 0xE0, 0x6D80, 0x6240, 0xA0, 0x1941A469, 0x1254C367, 0x7373, 0x67C8}
    at, closed = 0, True
    while at < len(data):
        kind, at = _number(data, at, 4, marked=True)
        size, at = _number(data, at, 8)
        end = at + size if size >= 0 else len(data)
        if size < 0 and kind not in (_Id.SEGMENT, _Id.CLUSTER):
            raise ValueError(f"element {kind:X} of no size")
        if kind == _Id.SEGMENT:
            closed = size >= 0
        if end > len(data):
            if not closed:
                raise _CutOffError
            given, do = f"a file cut off at {len(data)} of {end} bytes or more", "Copy it again."
            raise bad_input(str(path), given=given, allowed="a whole recording", do=do)
        yield _Element(kind, at, end)
        at = at if kind in masters else end


def _number(data: Any, at: int, longest: int, *, marked: bool = False) -> tuple[int, int]:
    """Return (a number of variable length, where it ends): with its `marked` length, or -1 where it is all ones."""
    first = data[at] if at < len(data) else 0
    length = 9 - first.bit_length()
    if length > longest:
        raise ValueError(f"no element at byte {at}")
    raw = data[at : at + length]
    if len(raw) < length:
        raise _CutOffError
    value, ones = int.from_bytes(raw, "big"), (1 << 7 * length) - 1
    if not marked:
        value = -1 if value & ones == ones else value & ones
    return value, at + length


def _index(path: Path, data: Any) -> Matroska:
    """Return what the elements of a file tell."""
    held = Matroska(path)
    cluster, tag, attached = 0, "", {}
    try:
        for element in _elements(path, data):
            content = Place(element.start, element.end - element.start)
            match element.kind:
                case 0x2AD7B1:
                    held.tick = 1e-9 * _unsigned(data, content)
                case _Id.TRACK:
                    held.tracks.append(Track())
                case 0xE7:
                    cluster = _unsigned(data, content)
                case 0xA3 | 0xA1:
                    number, frame = _block(data, content, cluster)
                    held.frames[number].append(frame)
                case _Id.ATTACHMENT:
                    attached = {}
                case 0x466E | 0x465C as kind:  # its name and its content, in either order
                    attached[kind] = content
                    if len(attached) == 2:
                        held.attachments[_text(data, attached[0x466E])] = attached[0x465C]
                case 0x45A3:
                    tag = _text(data, content)
                case 0x4487:
                    held.tags[tag] = _text(data, content)
                case kind if held.tracks:
                    _describe(held.tracks[-1], kind, data, content)
    except _CutOffError:
        held.cut = True
    return held


def _describe(track: Track, kind: int, data: Any, content: Place) -> None:
    """Put what an element tells into the track that it is of."""
    match kind:
        case 0xD7:
            track.number = _unsigned(data, content)
        case 0x536E:
            track.name = _text(data, content)
        case 0x86:
            track.codec = _text(data, content)
        case 0x63A2:
            track.header = _bytes(data, content)
        case 0xB0:
            track.width = _unsigned(data, content)
        case 0xBA:
            track.height = _unsigned(data, content)
        case _Id.COMPRESSION:
            track.packing = _Packing.ZLIB  # where nothing else is said
        case 0x4254:
            track.packing = _unsigned(data, content)
            if track.packing not in (_Packing.ZLIB, _Packing.STRIPPED):
                raise ValueError(f"track {track.name} packed by method {track.packing}")
        case 0x4255:
            track.shared = _bytes(data, content)
        case _Id.ENCRYPTION:
            raise ValueError(f"track {track.name} is encrypted")


def _block(data: Any, content: Place, cluster: int) -> tuple[int, Frame]:
    """Return the number of a block's track, and its frame; of several laced in one (IMU) the first's time and all."""
    number, at = _number(data, content.start, 8)
    (ticks,) = struct.unpack(">h", data[at : at + 2])
    return number, Frame(cluster + ticks, Place(at + 3, content.start + content.size - at - 3))


def _bytes(data: Any, content: Place) -> bytes:
    if content.size > LARGEST_TEXT:
        raise ValueError(f"an entry of {content.size} bytes")
    return data[content.start : content.start + content.size]


def _unsigned(data: Any, content: Place) -> int:
    if content.size > 8:
        raise ValueError(f"a number of {content.size} bytes")
    return int.from_bytes(_bytes(data, content), "big")


def _text(data: Any, content: Place) -> str:
    return _bytes(data, content).split(b"\0")[0].decode("utf-8")
