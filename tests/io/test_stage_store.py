"""The stage store gives back what was written, byte for byte, or says that nothing complete is there."""

from __future__ import annotations

import errno
import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap.errors import MocapError
from mocap.io import store as store_module
from mocap.io.store import BUFFER_FRAMES, StageStore, pack_masks, unpack_masks


def product(n: int, *, first_empty: int = 0) -> list[tuple[int, dict[str, np.ndarray]]]:
    """Frames 5, 7, 9 ... with arrays of all shapes, some of them empty."""
    rng = np.random.default_rng(11)
    frames = []
    for i in range(n):
        rows = 0 if i < first_empty or i % 7 == 3 else int(rng.integers(1, 400))
        frames.append(
            (
                5 + 2 * i,
                {
                    "voxels": np.sort(rng.integers(0, 10**6, rows)).astype(np.int32),
                    "masks": rng.integers(0, 255, (3, 6, 5), dtype=np.uint8),
                    "points": rng.normal(size=(rows // 3, 2)),
                    "flags": rng.random(rows) < 0.5,
                },
            )
        )
    return frames


def write(store: StageStore, frames: list[tuple[int, dict[str, np.ndarray]]], key: str = "k") -> None:
    with store.writer("carve", key, {"voxel_size_m": 0.02, "cameras": ["a", "b"]}) as writer:
        for frame, arrays in frames:
            writer.append(frame, **arrays)


def assert_same(read: dict[str, Any], written: dict[str, np.ndarray]) -> None:
    assert read.keys() == written.keys()
    for name, array in written.items():
        assert read[name].dtype == array.dtype
        np.testing.assert_array_equal(read[name], array)


@pytest.mark.parametrize("n", [0, 1, BUFFER_FRAMES, 2 * BUFFER_FRAMES + 5])
@pytest.mark.parametrize("first_empty", [0, BUFFER_FRAMES + 2])
def test_comes_back_in_order_and_by_frame(tmp_path: Path, n: int, first_empty: int) -> None:
    frames = product(n, first_empty=first_empty)
    store = StageStore(tmp_path / "store.zarr")
    write(store, frames)
    reader = store.reader("carve")
    assert reader.attrs == {"voxel_size_m": 0.02, "cameras": ["a", "b"]}
    assert reader.frames.dtype == np.int64
    assert reader.frames.tolist() == [f for f, _ in frames]
    for (frame, read), (expected, arrays) in zip(reader, frames, strict=True):
        assert frame == expected
        assert_same(read, arrays)
    for frame, arrays in reversed(frames):
        assert_same(reader.read(frame), arrays)
    with pytest.raises(KeyError, match="frame 6"):
        reader.read(6)


def test_only_arrays_that_are_asked_for_are_opened_and_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []
    real = store_module._ColumnReader

    def column(group: Any, name: str, *rest: Any) -> Any:
        opened.append(name)
        return real(group, name, *rest)

    frames = [(k, {name: np.full((k, 2), k) for name in "abc"}) for k in range(3)]
    store = StageStore(tmp_path)
    write(store, frames)
    monkeypatch.setattr(store_module, "_ColumnReader", column)
    reader = store.reader("carve")
    assert (reader.names, len(reader), opened) == (("a", "b", "c"), 3, [])
    assert reader.read(2, ["b"])["b"].tolist() == [[2, 2], [2, 2]]
    assert reader.lengths("b").tolist() == [0, 1, 2]
    assert opened == ["b"]
    list(reader)
    assert opened == ["b", "a", "c"]
    with pytest.raises(KeyError, match="d"):
        reader.read(2, ["d"])


def test_many_small_frames_do_not_make_many_files(tmp_path: Path) -> None:
    store = StageStore(tmp_path / "store.zarr")
    with store.writer("track", "k") as writer:
        for frame in range(300):
            writer.append(frame, xyz=np.zeros((0 if frame < 40 else 1, 3)))
    assert sum(p.is_file() for p in (tmp_path / "store.zarr").rglob("*")) < 15


def test_readers_own_their_arrays(tmp_path: Path) -> None:
    store = StageStore(tmp_path / "s")
    write(store, product(3))
    reader = store.reader("carve")
    reader.read(5)["masks"][:] = 0
    assert_same(reader.read(5), product(3)[0][1])


def test_buffers_of_the_caller_may_be_reused(tmp_path: Path) -> None:
    buffer = np.zeros(4, dtype=np.int32)
    store = StageStore(tmp_path / "s")
    with store.writer("a", "k") as writer:
        for frame in range(3):
            buffer[:] = frame
            writer.append(frame, x=buffer)
    assert [d["x"][0] for _, d in store.reader("a")] == [0, 1, 2]


def test_complete_only_for_its_key(tmp_path: Path) -> None:
    store = StageStore(tmp_path / "store.zarr")
    assert not store.is_complete("carve", "k")
    write(store, product(4))
    assert store.is_complete("carve", "k")
    assert not store.is_complete("carve", "other")
    assert not store.is_complete("segment", "k")
    store.remove("carve")
    assert not store.is_complete("carve", "k")


def test_interrupted_writer_leaves_the_earlier_product(tmp_path: Path) -> None:
    store = StageStore(tmp_path / "store.zarr")
    frames = product(50)
    write(store, frames, "old")
    with pytest.raises(KeyboardInterrupt), store.writer("carve", "new") as writer:  # noqa: PT012
        for frame, arrays in frames[:40]:
            writer.append(frame, **arrays)
        raise KeyboardInterrupt
    assert store.is_complete("carve", "old")
    assert not store.is_complete("carve", "new")
    assert_same(store.reader("carve").read(5), frames[0][1])
    assert sorted(p.name for p in (tmp_path / "store.zarr").iterdir()) == ["carve", "zarr.json"]


def test_killed_writer_is_overwritten(tmp_path: Path) -> None:
    store = StageStore(tmp_path / "store.zarr")
    writer = store.writer("carve", "k")
    writer.__enter__()
    for frame, arrays in product(40):
        writer.append(frame, **arrays)
    del writer  # as if the process had died: __exit__ never ran
    assert not store.is_complete("carve", "k")
    with pytest.raises(MocapError, match="no complete product") as caught:
        store.reader("carve")
    assert "run the stage carve" in caught.value.remedy
    write(store, product(5))
    assert len(store.reader("carve")) == 5


def test_same_input_gives_the_same_bytes(tmp_path: Path) -> None:
    digests = []
    for name in ("a", "b"):
        write(StageStore(tmp_path / name), product(70))
        digest = hashlib.sha256()
        for path in sorted((tmp_path / name).rglob("*")):
            digest.update(str(path.relative_to(tmp_path / name)).encode())
            digest.update(path.read_bytes() if path.is_file() else b"")
        digests.append(digest.hexdigest())
    assert digests[0] == digests[1]


def test_callers_mistakes(tmp_path: Path) -> None:
    store = StageStore(tmp_path / "s")
    with pytest.raises(ValueError, match="stage must be"):
        store.writer("../x", "k")
    with pytest.raises(TypeError, match="plain JSON"):
        store.writer("x", "k", {"a": np.zeros(2)})
    with store.writer("x", "k") as writer:
        writer.append(0, a=np.zeros((2, 3)))
        with pytest.raises(ValueError, match="ascend"):
            writer.append(0, a=np.zeros((2, 3)))
        with pytest.raises(ValueError, match="expected float64"):
            writer.append(1, a=np.zeros((2, 4)))
        with pytest.raises(ValueError, match="expected float64"):
            writer.append(1, a=np.zeros((2, 3), np.float32))
        with pytest.raises(ValueError, match="has arrays"):
            writer.append(1, b=np.zeros((2, 3)))
    assert store.reader("x").frames.tolist() == [0]


def test_not_writable(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(MocapError, match="cannot write") as caught,
        StageStore(tmp_path / "file" / "store.zarr").writer("a", "k") as writer,
    ):
        writer.append(0, x=np.zeros(2))
    assert caught.value.path == tmp_path / "file" / "store.zarr"


@pytest.mark.parametrize("when", ["during", "at the end"])
def test_disk_full_keeps_the_earlier_product(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, when: str
) -> None:
    store = StageStore(tmp_path / "store.zarr")
    frames = product(40)
    write(store, frames[:3], "old")

    def full(*_args: object, **_kwargs: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    n = 40 if when == "during" else 5
    with (  # noqa: PT012  the writer raises when it flushes or when it ends
        pytest.raises(MocapError, match="disk is full") as caught,
        store.writer("carve", "new") as writer,
        monkeypatch.context() as patch,
    ):
        if when == "during":
            patch.setattr("zarr.storage._local._put", full)
        for frame, arrays in frames[:n]:
            writer.append(frame, **arrays)
        if when == "at the end":
            patch.undo()
            monkeypatch.setattr("zarr.storage._local._put", full)
    assert caught.value.remedy
    monkeypatch.undo()
    assert store.is_complete("carve", "old")
    assert_same(store.reader("carve").read(5), frames[0][1])
    assert not list((tmp_path / "store.zarr").glob(".*"))


def test_masks_pack_and_unpack() -> None:
    masks = np.random.default_rng(5).random((3, 11, 21)) < 0.4
    packed = pack_masks(list(masks))
    assert packed.shape == (3, 11, 3)
    assert packed.dtype == np.uint8
    np.testing.assert_array_equal(unpack_masks(packed, 21), masks)
    assert unpack_masks(packed, 21).dtype == np.bool_
