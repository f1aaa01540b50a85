"""Picture headers: the size of a picture from its first bytes: PNG, JPEG, BMP, TIFF, WebP, PGM, PPM; and whether the
chunks of a PNG lie inside it."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable

Size = tuple[int, int]

# Markers of JPEG that stand alone, and those of a frame header, which holds the size.
_JPEG_ALONE = frozenset({0x01, *range(0xD0, 0xDA)})
_JPEG_FRAME = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
# Tags of TIFF for width and height, and the formats of whole numbers by their type.
_TIFF_WIDTH, _TIFF_HEIGHT = 256, 257
_TIFF_NUMBERS = {1: "B", 3: "H", 4: "I"}
_TIFF_MOST_TAGS = 4096
_PNG_BEGIN = b"\x89PNG\r\n\x1a\n"
_PNG_AROUND_CHUNK = 12  # bytes of length, name and checksum


def size_in_header(data: bytes) -> Size | None:
    """(width, height) px that the first bytes of a picture promise; None for what is none of the known kinds.

    data : the whole file, or as much of it as holds the header.
    """
    for begin, reader in _READERS:
        if data.startswith(begin):
            try:
                return reader(data)
            except (struct.error, IndexError, ValueError):
                return None
    return None


def has_its_chunks(data: bytes) -> bool:
    """Whether all chunks of a PNG lie inside the file, as their lengths say; True for other kinds.

    OpenCV makes room for a chunk before it looks whether it is there: a wrong length costs 4 GB and 20 s.
    data : the whole file.
    """
    at = len(_PNG_BEGIN) if data.startswith(_PNG_BEGIN) else len(data)
    while at < len(data):
        if at + _PNG_AROUND_CHUNK > len(data):
            return False
        (length,) = struct.unpack_from(">I", data, at)
        is_last = data[at + 4 : at + 8] == b"IEND"
        at += _PNG_AROUND_CHUNK + length
        if is_last:  # what comes behind is not looked at
            break
    return at <= len(data)


def _png(data: bytes) -> Size | None:
    if data[12:16] != b"IHDR":
        return None
    w, h = struct.unpack_from(">II", data, 16)
    return w, h


def _jpeg(data: bytes) -> Size | None:
    at = 2
    while at < len(data):
        if data[at] != 0xFF:
            return None
        marker = data[at + 1]
        if marker == 0xFF or marker in _JPEG_ALONE:
            at += 1 if marker == 0xFF else 2
            continue
        (length,) = struct.unpack_from(">H", data, at + 2)
        if marker in _JPEG_FRAME:
            h, w = struct.unpack_from(">HH", data, at + 5)
            return w, h
        at += 2 + length
    return None


def _bmp(data: bytes) -> Size | None:
    (header_bytes,) = struct.unpack_from("<I", data, 14)
    w, h = struct.unpack_from("<HH" if header_bytes == 12 else "<ii", data, 18)
    # A negative height means that the rows begin at the top.
    return w, abs(h)


def _tiff(data: bytes) -> Size | None:
    order = "<" if data[:2] == b"II" else ">"
    (at,) = struct.unpack_from(f"{order}I", data, 4)
    (n_tags,) = struct.unpack_from(f"{order}H", data, at)
    found: dict[int, int] = {}
    for k in range(min(n_tags, _TIFF_MOST_TAGS)):
        tag, kind, _ = struct.unpack_from(f"{order}HHI", data, at + 2 + 12 * k)
        if tag in (_TIFF_WIDTH, _TIFF_HEIGHT) and kind in _TIFF_NUMBERS:
            (found[tag],) = struct.unpack_from(order + _TIFF_NUMBERS[kind], data, at + 10 + 12 * k)
    return found.get(_TIFF_WIDTH, 0), found.get(_TIFF_HEIGHT, 0)


def _webp(data: bytes) -> Size | None:
    kind = data[12:16]
    if data[8:12] != b"WEBP":
        return None
    if kind == b"VP8X":
        w, h = (int.from_bytes(data[i : i + 3], "little") + 1 for i in (24, 27))
        return w, h
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b"VP8 ":
        w, h = struct.unpack_from("<HH", data, 26)
        return w & 0x3FFF, h & 0x3FFF
    return None


def _pnm(data: bytes) -> Size | None:
    # Comments run from # to the end of the line.
    words = re.sub(rb"#[^\n]*", b"", data[:4096]).split()
    w, h = (int(word) for word in words[1:3] if len(word) < 10)
    return w, h


_READERS: tuple[tuple[bytes, Callable[[bytes], Size | None]], ...] = (
    (_PNG_BEGIN, _png),
    (b"\xff\xd8\xff", _jpeg),
    (b"BM", _bmp),
    (b"II*\0", _tiff),
    (b"MM\0*", _tiff),
    (b"RIFF", _webp),
    *((b"P%d" % kind, _pnm) for kind in range(1, 7)),
)
