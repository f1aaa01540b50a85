"""Files from strangers: only regular files are opened, no more than a limit is read, and nothing too deep is parsed.

Every reader of a file that a user names goes through here, so that a pipe, a device, a file of 20 GB or a list nested
100,000 deep ends in one clear message.
"""

from __future__ import annotations

import io
import json
import os
import stat
import tomllib
import zipfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.errors import MocapError

MB = 2**20
# A settings file of 1 MB has some 30,000 lines; tomllib takes 2 s for as many keys.
SETTINGS_LIMIT_BYTES = 1 * MB
# Calibrations of 500 cameras, one frame of a crowd, the record of a run: below 2 MB each.
DOCUMENT_LIMIT_BYTES = 16 * MB
# Motion as text: an hour of 60 markers at 120 Hz in TRC has 700 MB, which no tool hands out as one file.
TEXT_LIMIT_BYTES = 512 * MB
# Arrays of one archive, unpacked: two hours of packed masks of one camera of 1920 x 1080 at 5 Hz.
ARRAYS_LIMIT_BYTES = 8192 * MB
# numpy parses headers of arrays as Python, whose syntax trees of all threads have one count of depth in CPython 3.11
# (its issue 106905): two archives read at once fail now and then with SystemError. Worst found: 1 reading in 400,
# with the collector of garbage at work at every 20th object.
_READ_TRIES = 5
# Our own files nest 5 deep.
MAX_DEPTH = 32
# TOML and JSON know no bound for whole numbers; nothing here counts further than 64 bits.
MAX_WHOLE = 2**63

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def check_regular(path: Path | str, what: str = "the file", *, remedy: str = "check the path") -> int:
    """Size in bytes of a regular file; MocapError when it is not there, or is a folder, a pipe or a device."""
    path = Path(path)
    try:
        found = path.stat()
    except (OSError, ValueError) as error:
        raise _unreadable(path, what, error, remedy) from error
    if not stat.S_ISREG(found.st_mode):
        kind = next((word for is_kind, word in _KINDS if is_kind(found.st_mode)), "something else")
        raise MocapError(f"{what} cannot be read: it is {kind}, not a regular file", path=path, remedy=remedy)
    return found.st_size


def read_head(path: Path | str, n_bytes: int, what: str = "the file") -> bytes:
    """The first bytes of a regular file, fewer when it is shorter; MocapError when it cannot be read."""
    path = Path(path)
    check_regular(path, what)
    try:
        with path.open("rb") as stream:
            return stream.read(n_bytes)
    except OSError as error:
        raise _unreadable(path, what, error, "check the path") from error


def read_bytes(
    path: Path | str,
    what: str = "the file",
    *,
    limit: int = TEXT_LIMIT_BYTES,
    remedy: str = "check the path",
) -> bytes:
    """The content of a regular file; MocapError when it cannot be read or has more than `limit` bytes."""
    path = Path(path)
    size = check_regular(path, what, remedy=remedy)
    try:
        # Files of /proc say 0 and go on for ever: the limit holds for what comes, not for what is promised.
        with path.open("rb") as stream:
            content = stream.read(limit + 1) if size <= limit else b""
    except OSError as error:
        raise _unreadable(path, what, error, remedy) from error
    if max(size, len(content)) > limit:
        raise MocapError(
            f"{what} has {max(size, len(content)) / MB:.0f} MB; no more than {limit / MB:.0f} MB are read",
            path=path,
            remedy="check that this is the right file, or split it",
        )
    return content


def read_text(
    path: Path | str,
    what: str = "the file",
    *,
    limit: int = TEXT_LIMIT_BYTES,
    remedy: str = "check that its ending names its format, and write text as UTF-8",
) -> str:
    """The text of a regular file in UTF-8, a byte order mark left out; line ends become newlines.

    Raises MocapError as `read_bytes` does, and for what is no text.
    """
    content = read_bytes(path, what, limit=limit, remedy=remedy)
    try:
        return io.TextIOWrapper(io.BytesIO(content), encoding="utf-8-sig").read()
    except UnicodeDecodeError as error:
        raise MocapError(
            f"{what} cannot be read: it is not text ({error.reason} at byte {error.start})",
            path=path,
            remedy=remedy,
        ) from error


def load_toml(
    path: Path | str, what: str = "the file", *, remedy: str = "correct the file"
) -> dict[str, Any]:
    """The content of a TOML file; MocapError when it cannot be read, is no TOML, or is out of bounds."""
    text = read_text(path, what, limit=SETTINGS_LIMIT_BYTES, remedy=remedy)
    try:
        return parse_toml(text)
    except ValueError as error:
        raise MocapError(
            f"{what} cannot be read: not valid TOML: {error}", path=path, remedy=remedy
        ) from error


def load_json(path: Path | str, what: str = "the file", *, remedy: str = "write the file again") -> Any:
    """The content of a JSON file; MocapError when it cannot be read, is no JSON, or is out of bounds."""
    text = read_text(path, what, limit=DOCUMENT_LIMIT_BYTES, remedy=remedy)
    try:
        return parse_json(text)
    except ValueError as error:
        raise MocapError(
            f"{what} cannot be read: not valid JSON: {error}", path=path, remedy=remedy
        ) from error


def parse_toml(text: str) -> dict[str, Any]:
    """TOML as values; ValueError for bad syntax, too deep nesting, too long numbers and what is no Unicode."""
    try:
        document = tomllib.loads(text)
    except RecursionError as error:
        raise ValueError(f"nested more than {MAX_DEPTH} deep") from error
    _check_bounds(document)
    return document


def parse_json(text: str) -> Any:
    """JSON as values; ValueError for bad syntax, too deep nesting, too long numbers and what is no Unicode."""
    try:
        document = json.loads(text)
    except RecursionError as error:
        raise ValueError(f"nested more than {MAX_DEPTH} deep") from error
    _check_bounds(document)
    return document


def _check_bounds(document: Any) -> None:
    """ValueError for a document that is nested too deep or holds a number or a text that nothing can work with."""
    level: list[Any] = [document]
    for _ in range(MAX_DEPTH):
        level = [value for parent in level for value in _children(parent)]
        if not level:
            return
    raise ValueError(f"nested more than {MAX_DEPTH} deep")


def _children(parent: Any) -> Iterable[Any]:
    """Lists and tables inside of one, the other values checked; nothing inside of other values."""
    if isinstance(parent, dict):
        values: Iterable[Any] = [*parent.keys(), *parent.values()]
    else:
        values = parent if isinstance(parent, list) else [parent]
    for value in values:
        if isinstance(value, int) and not -MAX_WHOLE <= value < MAX_WHOLE:
            raise ValueError("a whole number has more than 64 bits")
        if isinstance(value, str) and not is_unicode(value):
            raise ValueError("a text holds half a character (a lone surrogate)")
    return [value for value in values if isinstance(value, dict | list)]


def is_unicode(text: str) -> bool:
    """Whether a text can be written as UTF-8: it has no lone surrogates, which escapes in JSON can bring in."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def array_names(path: Path | str, what: str = "the archive") -> tuple[str, ...]:
    """Names of the arrays in an .npz; MocapError as `load_arrays`."""
    check_regular(path, what)
    try:
        with zipfile.ZipFile(path) as archive:
            return tuple(name.removesuffix(".npy") for name in archive.namelist())
    except Exception as error:
        raise _bad_archive(Path(path), what, error) from error


def load_arrays(
    path: Path | str,
    what: str = "the archive",
    *,
    wanted: Sequence[str] | None = None,
    limit: int = ARRAYS_LIMIT_BYTES,
) -> dict[str, NDArray[Any]]:
    """The arrays of an .npz, or those of them that are wanted; a wanted one that is not there is left out.

    Raises MocapError for what is no .npz, is damaged, holds Python objects, or has more than `limit` bytes unpacked.
    """
    path = Path(path)
    check_regular(path, what)
    try:
        with zipfile.ZipFile(path) as archive:
            sizes = {info.filename.removesuffix(".npy"): info.file_size for info in archive.infolist()}
        names = [name for name in sizes if wanted is None or name in wanted]
        unpacked = sum(sizes[name] for name in names)
        if unpacked > limit:
            raise MocapError(
                f"{what} holds {unpacked / MB:.0f} MB unpacked; no more than {limit / MB:.0f} MB are read",
                path=path,
                remedy="split it, or pack masks to bits",
            )
        return _arrays_of(path, names)
    except MocapError:
        raise
    except Exception as error:
        raise _bad_archive(path, what, error) from error


def _arrays_of(path: Path, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    n_left = _READ_TRIES
    while True:
        n_left -= 1
        try:
            with np.load(path, allow_pickle=False) as arrays:
                return {name: _whole(arrays[name]) for name in names}
        except SystemError:
            if not n_left:
                raise


def _bad_archive(path: Path, what: str, error: Exception) -> MocapError:
    # zipfile, zlib and numpy's header parser fail in a dozen ways on damaged bytes, SyntaxError among them.
    return MocapError(
        f"{what} cannot be read: it is empty, damaged or no .npz ({error})",
        path=path,
        remedy="write it with numpy.savez_compressed",
    )


def _whole(value: Any) -> NDArray[Any]:
    # A member that is no .npy comes as bytes.
    if not isinstance(value, np.ndarray):
        raise ValueError("it holds what is no array")
    return value


def _unreadable(path: Path, what: str, error: Exception, remedy: str) -> MocapError:
    reason = os.strerror(error.errno) if isinstance(error, OSError) and error.errno else str(error)
    return MocapError(f"{what} cannot be read: {reason}", path=path, remedy=remedy)
