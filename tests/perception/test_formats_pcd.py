"""PCD in its three encodings, with every kind of field; and LZF, which the compressed one uses."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from anther.core.errors import InputError
from anther.perception.formats.clouds import lzf_decompress, read_cloud

RNG = np.random.default_rng(0)
TABLE = np.zeros(300, [("x", "<f4"), ("rgb", "<u4"), ("y", "<f4"), ("n", "<f4", (2,)), ("z", "<f8"), ("i", "<i2")])
for axis in "xyz":
    TABLE[axis] = np.round(RNG.uniform(0, 0.4, 300), 2)  # repeats, so that there is something to compress
COLORS = RNG.integers(0, 256, (300, 3)).astype(np.uint8)
TABLE["rgb"] = (COLORS.astype(np.uint32) << np.array([16, 8, 0], np.uint32)).sum(axis=1)
TABLE["i"] = -5


def lzf(data: bytes) -> bytes:
    """A plain LZF packer: the longest match within 8 kB, else literals."""
    out, at, literals = bytearray(), 0, bytearray()

    def flush() -> None:
        for k in range(0, len(literals), 32):
            out.extend([len(literals[k : k + 32]) - 1, *literals[k : k + 32]])
        literals.clear()

    while at < len(data):
        found = data.rfind(data[at : at + 3], max(0, at - 8191), at + 2) if at + 3 <= len(data) else -1
        if found < 0 or found >= at:
            literals.append(data[at])
            at += 1
            continue
        length = 3
        while at + length < len(data) and length < 264 and data[found + length] == data[at + length]:
            length += 1
        flush()
        back = at - found - 1
        short = min(length - 2, 7)
        out.extend([short << 5 | back >> 8, *([length - 9] if short == 7 else []), back & 255])
        at += length
    flush()
    return bytes(out)


def write_pcd(path: Path, encoding: str) -> None:
    dtype = TABLE.dtype
    names = dtype.names or ()
    kinds = [dtype[name].base for name in names]
    header = [
        "# .PCD v0.7",
        "VERSION 0.7",
        f"FIELDS {' '.join(names)}",
        f"SIZE {' '.join(str(k.itemsize) for k in kinds)}",
        f"TYPE {' '.join({'f': 'F', 'u': 'U', 'i': 'I'}[k.kind] for k in kinds)}",
        f"COUNT {' '.join(str(int(np.prod(dtype[name].shape, dtype=int))) for name in names)}",
        "WIDTH 300\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 300",
        f"DATA {encoding}\n",
    ]
    if encoding == "ascii":
        rows = (" ".join(repr(v) for name in names for v in np.ravel(row[name]).tolist()) for row in TABLE)
        body = ("\n".join(rows) + "\n").encode()
    elif encoding == "binary":
        body = TABLE.tobytes()
    else:
        columns = b"".join(np.ascontiguousarray(TABLE[name]).tobytes() for name in names)
        packed = lzf(columns)
        assert len(packed) < len(columns)
        body = np.array([len(packed), len(columns)], "<u4").tobytes() + packed
    path.write_bytes("\n".join(header).encode() + body)


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_every_encoding_gives_the_same_cloud(tmp_path: Path, encoding: str) -> None:
    write_pcd(tmp_path / "a.pcd", encoding)
    cloud = read_cloud(tmp_path / "a.pcd")
    np.testing.assert_array_equal(cloud.points, np.stack([TABLE[axis] for axis in "xyz"], axis=1).astype(np.float64))
    assert cloud.colors is not None
    np.testing.assert_array_equal(cloud.colors, COLORS)


@given(st.lists(st.sampled_from([b"a", b"ab", b"plant", b"\0" * 40, bytes(range(256))]), max_size=40))
def test_lzf_round_trip(words: list[bytes]) -> None:
    data = b"".join(words)
    assert lzf_decompress(lzf(data), len(data)) == data


@given(st.binary(max_size=60), st.integers(0, 200))
def test_damaged_lzf_is_a_value_error(data: bytes, size: int) -> None:
    with contextlib.suppress(ValueError, IndexError):
        assert len(lzf_decompress(data, size)) == size


@settings(max_examples=20)
@given(share=st.floats(0.7, 0.999), byte=st.integers(1, 255))
def test_damaged_compressed_pcd_is_refused_or_read(tmp_path_factory, share: float, byte: int) -> None:
    path = tmp_path_factory.mktemp("pcd") / "a.pcd"
    write_pcd(path, "binary_compressed")
    data = bytearray(path.read_bytes())
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError, match="allowed"):
        read_cloud(path)
    data[int(share * len(data))] ^= byte
    path.write_bytes(data)
    with contextlib.suppress(InputError), np.errstate(all="ignore"):
        read_cloud(path)


def test_unknown_encoding_is_refused(tmp_path: Path) -> None:
    write_pcd(tmp_path / "a.pcd", "ascii")
    (tmp_path / "a.pcd").write_text((tmp_path / "a.pcd").read_text().replace("DATA ascii", "DATA zip"))
    with pytest.raises(InputError, match="DATA zip; allowed: ascii, binary, binary_compressed"):
        read_cloud(tmp_path / "a.pcd")
