"""Stage products on disk: per-frame arrays of any length in a zarr directory, complete or not there at all.

A stage is one zarr group. Each named array is kept end to end over the frames (`NAME/data`) with the row where
each frame begins (`NAME/offsets`), so that frames may have different lengths. A writer works in a hidden folder
beside the stage and moves it into place at the end: whoever looks sees the old product, none, or the whole new
one, after a power cut too. A list of all files with their hashes tells a reader what is damaged before it is decoded.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mocap.errors import MocapError
from mocap.io._files import writing
from mocap.portable import sync_folder, sync_tree

if TYPE_CHECKING:
    import zarr

# Frames collected before they are written; memory stays constant and chunks stay worth compressing.
BUFFER_FRAMES = 32
_BUFFER_BYTES = 64_000_000
# A product that begins with empty frames must not end up with a chunk per row.
_MIN_CHUNK_BYTES = 262_144
_FORMAT = 2
_LIST = "files.json"
_ZSTD_LEVEL = 1


def pack_masks(masks: Sequence[NDArray[np.bool_]]) -> NDArray[np.uint8]:
    """Masks of one frame as bits: C masks (H, W) bool of one size -> (C, H, ceil(W / 8)) uint8."""
    return np.packbits(np.stack(masks), axis=2)


def unpack_masks(packed: NDArray[np.uint8], width: int) -> NDArray[np.bool_]:
    """The inverse: (C, H, ceil(W / 8)) uint8 -> (C, H, W) bool."""
    return np.unpackbits(packed, axis=2, count=width).view(np.bool_)


class StageStore:
    """A directory of stage products, found by stage name and valid for one key (hash of config and inputs)."""

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)

    def is_complete(self, stage: str, key: str) -> bool:
        """Whether the stage was written to its end under this very key."""
        about = self._about(stage)
        return about is not None and about.get("key") == key

    def writer(self, stage: str, key: str, attrs: dict[str, Any] | None = None) -> StageWriter:
        """Start a stage product; use as context manager, `append` every frame. Replaces an earlier product."""
        _check_stage(stage)
        return StageWriter(self.path, stage, key, attrs or {})

    def reader(self, stage: str) -> StageReader:
        """Open a complete stage product. Raises MocapError when there is none."""
        about = self._about(stage)
        if about is None:
            raise MocapError(
                f"the stage {stage!r} has no complete product",
                path=self.path / stage,
                remedy=f"run the stage {stage} first",
            )
        return StageReader(self.path / stage, stage, about)

    def remove(self, stage: str) -> None:
        """Delete a stage product, if there is one."""
        _check_stage(stage)
        with writing(self.path / stage):
            for folder in (self.path / stage, _partial(self.path, stage)):
                if folder.exists():
                    shutil.rmtree(folder)

    def remove_unfinished(self) -> None:
        """Delete what writers have left that were stopped before they could clean up."""
        for folder in self.path.glob(".*.partial"):
            _discard(folder)

    def _about(self, stage: str) -> dict[str, Any] | None:
        _check_stage(stage)
        try:
            text = (self.path / stage / "zarr.json").read_text(encoding="utf-8")
            about = json.loads(text)["attributes"]["mocap"]
        except (OSError, ValueError, KeyError, TypeError):
            return None
        is_ours = isinstance(about, dict) and about.get("format") == _FORMAT and about.get("complete") is True
        return about if is_ours else None


class StageWriter:
    """Collects the arrays of one stage; complete on a clean exit, without trace after an exception."""

    def __init__(self, root: Path, stage: str, key: str, attrs: dict[str, Any]) -> None:
        self._root, self._stage, self._key = root, stage, key
        self._attrs: dict[str, Any] = {}
        self.describe(attrs)
        self._is_discarded = False
        self._folder = _partial(root, stage)
        self._group: zarr.Group | None = None
        self._columns: dict[str, _ColumnWriter] = {}
        self._frames: list[int] = []
        self._n_buffered = self._n_buffered_bytes = 0

    def __enter__(self) -> StageWriter:
        import zarr

        with writing(self._root):
            self._root.mkdir(parents=True, exist_ok=True)
            if self._folder.exists():
                shutil.rmtree(self._folder)
            if not (self._root / "zarr.json").exists():
                zarr.create_group(self._root)
            self._group = zarr.create_group(self._folder)
        return self

    def append(self, frame: int, **arrays: NDArray[Any]) -> None:
        """Add one frame: the same names every time, any length along axis 0, dtype and trailing shape fixed.

        Raises ValueError for a frame that does not ascend or an array that changed its kind.
        """
        if self._group is None:
            raise RuntimeError("append outside of `with store.writer(...)`")
        if not self._frames:
            self._columns = {name: _ColumnWriter(name, np.asarray(a)) for name, a in arrays.items()}
        for name, array in self._checked(frame, arrays).items():
            self._columns[name].add(array)
            self._n_buffered_bytes += array.nbytes
        self._frames.append(int(frame))
        self._n_buffered += 1
        if self._n_buffered >= BUFFER_FRAMES or self._n_buffered_bytes > _BUFFER_BYTES:
            self._flush(is_last=False)

    def _checked(self, frame: int, arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        if self._frames and frame <= self._frames[-1]:
            raise ValueError(f"frame {frame} comes after frame {self._frames[-1]}; frames must ascend")
        if arrays.keys() != self._columns.keys():
            raise ValueError(f"frame {frame} has arrays {sorted(arrays)}, expected {sorted(self._columns)}")
        return {name: self._columns[name].check(np.asarray(a), frame) for name, a in arrays.items()}

    def describe(self, attrs: dict[str, Any]) -> None:
        """Add attributes, which may only be known at the end. Raises TypeError for what is no plain JSON."""
        try:
            json.dumps(attrs, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise TypeError(f"attrs of stage {self._stage} must be plain JSON: {error}") from error
        self._attrs = {**self._attrs, **attrs}

    def discard(self) -> None:
        """Leave no product behind; an earlier one stays as it is."""
        self._is_discarded = True

    def _flush(self, is_last: bool) -> None:
        assert self._group is not None
        with writing(self._root / self._stage):
            for column in self._columns.values():
                column.flush(self._group, is_last)
        self._n_buffered = self._n_buffered_bytes = 0

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None or self._is_discarded:
            _discard(self._folder)
            return
        assert self._group is not None
        final = self._root / self._stage
        try:
            self._flush(is_last=True)
            with writing(final):
                _put(self._group, "frames", np.array(self._frames, dtype=np.int64))
                for name, column in self._columns.items():
                    _put(self._group, f"{name}/offsets", np.array(column.offsets, dtype=np.int64))
                self._group.attrs.update(
                    {
                        "mocap": {
                            "format": _FORMAT,
                            "stage": self._stage,
                            "key": self._key,
                            "arrays": sorted(self._columns),
                            "attrs": self._attrs,
                            "complete": True,
                        }
                    }
                )
                _write_list(self._folder)
                sync_tree(self._folder)
                if final.exists():
                    shutil.rmtree(final)
                os.replace(self._folder, final)
                sync_folder(self._root)
        except MocapError:
            _discard(self._folder)
            raise


class _ColumnWriter:
    """Rows of one array over the frames, written in whole chunks."""

    def __init__(self, name: str, first: NDArray[Any]) -> None:
        if not name.isidentifier() or name == "frames":
            raise ValueError(f"{name!r} is no usable array name")
        if first.ndim == 0 or first.dtype.kind not in "biufc":
            raise ValueError(f"{name} must be an array of numbers with at least one axis, got {first.dtype}")
        self.name, self.dtype, self.trailing = name, first.dtype, first.shape[1:]
        self.offsets = [0]
        self._pending: list[NDArray[Any]] = []
        self._n_pending = 0
        self._n_written = 0
        self._chunk_rows = 0
        self._data: zarr.Array | None = None

    def check(self, array: NDArray[Any], frame: int) -> NDArray[Any]:
        if array.dtype != self.dtype or array.ndim == 0 or array.shape[1:] != self.trailing:
            raise ValueError(
                f"{self.name} of frame {frame} is {array.dtype} {array.shape}, "
                f"expected {self.dtype} (n, {', '.join(map(str, self.trailing))})"
            )
        return array

    def add(self, array: NDArray[Any]) -> None:
        # A copy: the caller may reuse its buffer for the next frame.
        self._pending.append(array.copy())
        self._n_pending += len(array)
        self.offsets.append(self.offsets[-1] + len(array))

    def flush(self, group: zarr.Group, is_last: bool) -> None:
        if self._data is None:
            row_bytes = max(1, self.dtype.itemsize * int(np.prod(self.trailing)))
            self._chunk_rows = max(1, self._n_pending, _MIN_CHUNK_BYTES // row_bytes)
            self._data = group.create_array(
                f"{self.name}/data",
                shape=(0, *self.trailing),
                chunks=(self._chunk_rows, *(max(1, n) for n in self.trailing)),
                dtype=self.dtype,
                compressors=_compressor(),
            )
        # Only whole chunks are written before the end: a chunk is never read back and compressed again.
        n = self._n_pending if is_last else self._n_pending // self._chunk_rows * self._chunk_rows
        if n == 0:
            return
        rows = np.concatenate(self._pending)
        self._data.resize((self._n_written + n, *self.trailing))
        if rows[:n].size:
            self._data[self._n_written :] = rows[:n]
        self._n_written += n
        self._pending = [rows[n:].copy()]
        self._n_pending -= n


class StageReader:
    """A complete stage product: frames (n,) int64 ascending, attrs as written, arrays by frame.

    Raises MocapError that names the stage to run again, now or when a damaged frame is read.
    """

    def __init__(self, path: Path, stage: str, about: dict[str, Any]) -> None:
        import zarr

        files = _Files(path, stage)
        files.check(name for name in files.names if "/data/c/" not in name)
        try:
            self.attrs: dict[str, Any] = about["attrs"]
            self.key: str = about["key"]
            self.names: tuple[str, ...] = tuple(about["arrays"])
            self._group: Any = zarr.open_group(path, mode="r")
            self.frames: NDArray[np.int64] = np.asarray(self._group["frames"][:], dtype=np.int64)
        except (OSError, KeyError, ValueError) as error:
            raise files.damaged(str(error)) from error
        self._files, self._columns = files, dict[str, _ColumnReader]()
        self._row = {int(f): i for i, f in enumerate(self.frames)}

    def __len__(self) -> int:
        return len(self.frames)

    def read(self, frame: int, names: Sequence[str] | None = None) -> dict[str, NDArray[Any]]:
        """The arrays of one frame, or those of some names. Raises KeyError when the frame was not written."""
        if frame not in self._row:
            raise KeyError(f"frame {frame} is not in the product, which has {len(self.frames)} frames")
        i = self._row[frame]
        return {name: self._column(name).read(i) for name in names or self.names}

    def rows(self, *names: str) -> Iterator[tuple[int, dict[str, NDArray[Any]]]]:
        """Frames in order with the arrays of some names; what is not named is neither decoded nor checked."""
        for frame in self.frames:
            yield int(frame), self.read(int(frame), names)

    def lengths(self, name: str) -> NDArray[np.int64]:
        """How many rows an array has in every frame, (n,)."""
        return self._column(name).lengths

    def __iter__(self) -> Iterator[tuple[int, dict[str, NDArray[Any]]]]:
        return self.rows()

    def _column(self, name: str) -> _ColumnReader:
        """Opened when it is asked for: that takes longer than all else here, and many want the attributes alone."""
        if name not in self._columns:
            try:
                column = _ColumnReader(self._group[name], name, self._files, len(self.frames))
            except (OSError, ValueError) as error:
                raise self._files.damaged(str(error)) from error
            self._columns[name] = column
        return self._columns[name]


class _Files:
    """The files of a product and the hashes that they were written with."""

    def __init__(self, path: Path, stage: str) -> None:
        self._path, self._stage = path, stage
        try:
            document = json.loads((path / _LIST).read_text(encoding="utf-8"))
            self.names: dict[str, str] = document["files"]
            if document["hash"] != _hash_of_list(self.names):
                raise ValueError("the list of files has changed")
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise self.damaged(f"{_LIST}: {error}") from error

    def check(self, names: Iterable[str]) -> None:
        """Raises MocapError for a file that is not as it was written, is gone, or was not there."""
        for name in names:
            try:
                found = _hash((self._path / name).read_bytes())
            except FileNotFoundError:
                found = None
            except OSError as error:
                raise self.damaged(f"{name}: {error.strerror or error}") from error
            if found != self.names.get(name):
                raise self.damaged(name)

    def damaged(self, what: str) -> MocapError:
        """The error to raise."""
        return MocapError(
            f"the product of the stage {self._stage} is damaged ({what})",
            path=self._path,
            remedy=f"delete this folder and run the stage {self._stage} again: `mocap run SESSION -o OUT --resume`",
        )


def _hash(content: bytes) -> str:
    return hashlib.blake2b(content, digest_size=16).hexdigest()


def _hash_of_list(names: dict[str, str]) -> str:
    return _hash(json.dumps(sorted(names.items())).encode())


def _write_list(folder: Path) -> None:
    """The list of all files in a product that is written to its end."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    names = {path.relative_to(folder).as_posix(): _hash(path.read_bytes()) for path in files}
    document = {"hash": _hash_of_list(names), "files": names}
    (folder / _LIST).write_text(json.dumps(document), encoding="utf-8")


class _Held(threading.local):
    """The chunk that a thread has decompressed last, by its number; -1 = none yet."""

    chunk: int = -1
    rows: NDArray[Any]


class _ColumnReader:
    """Rows by frame; the chunk decompressed last is kept, because frames are mostly read in order: by every thread its
    own, since two that go through a clip in two directions are in different ones."""

    def __init__(self, group: Any, name: str, files: _Files, n_frames: int) -> None:
        self._data = group["data"]
        self._files = files
        # Chunks divide the rows alone; where all rows of a chunk are zero there is no file.
        self._chunk_name = f"{name}/data/c/{{}}" + "/0" * (self._data.ndim - 1)
        self._offsets = np.asarray(group["offsets"][:])
        if (
            self._offsets.shape != (n_frames + 1,)
            or self._offsets[0] != 0
            or np.any(np.diff(self._offsets) < 0)
            or self._offsets[-1] != self._data.shape[0]
        ):
            raise ValueError(f"{name}: rows of frames do not follow each other")
        self._chunk_rows = int(self._data.chunks[0])
        self._held = _Held()

    @property
    def lengths(self) -> NDArray[np.int64]:
        return np.diff(self._offsets)

    def read(self, i: int) -> NDArray[Any]:
        start, stop = int(self._offsets[i]), int(self._offsets[i + 1])
        if start == stop:
            return np.empty((0, *self._data.shape[1:]), dtype=self._data.dtype)
        parts, held = [], self._held
        for chunk in range(start // self._chunk_rows, (stop - 1) // self._chunk_rows + 1):
            begin = chunk * self._chunk_rows
            if chunk != held.chunk:
                # Checked before it is decoded: a decoder may do anything with bytes that were never encoded.
                self._files.check([self._chunk_name.format(chunk)])
                held.rows = np.asarray(self._data[begin : begin + self._chunk_rows])
                held.chunk = chunk
            parts.append(held.rows[max(0, start - begin) : stop - begin])
        # Always a copy, so that nobody's changes reach the next reader of this frame.
        return np.concatenate(parts)


def _compressor() -> Any:
    from zarr.codecs import ZstdCodec

    return ZstdCodec(level=_ZSTD_LEVEL)


def _put(group: Any, name: str, array: NDArray[np.int64]) -> None:
    data = group.create_array(
        name, shape=array.shape, chunks=(max(1, len(array)),), dtype=array.dtype, compressors=_compressor()
    )
    if len(array):
        data[:] = array


def _check_stage(stage: str) -> None:
    if not stage or not all(c.isalnum() or c in "_-" for c in stage):
        raise ValueError(f"stage must be a word of letters, digits, _ and -, got {stage!r}")


def _discard(folder: Path) -> None:
    """Remove an unfinished product. zarr's own thread may still be writing into it, so once may not be enough."""
    for _ in range(20):
        shutil.rmtree(folder, ignore_errors=True)
        time.sleep(0.01)
        if not folder.exists():
            return


def _partial(root: Path, stage: str) -> Path:
    return root / f".{stage}.partial"
