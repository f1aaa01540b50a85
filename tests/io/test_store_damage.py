"""A damaged store says so: bits that turn, files that are cut or gone, a power cut while a product is written."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap.errors import MocapError
from mocap.io import store as store_module
from mocap.io.store import StageStore

Product = list[tuple[int, dict[str, np.ndarray]]]
N_FLIPS = 600
N_FLIPS_SLOW = 10_000


def frames(n: int = 6) -> Product:
    rng = np.random.default_rng(3)
    found: Product = []
    for i in range(n):
        rows = int(rng.integers(0, 40))
        arrays = {
            "voxels": np.sort(rng.integers(0, 10**6, rows)).astype(np.int32),
            "masks": rng.integers(0, 255, (3, 6, 5), dtype=np.uint8),
            "zeros": np.zeros((2, 3)),
        }
        found.append((2 * i, arrays))
    return found


def write(root: Path, product: Product, key: str = "k") -> Path:
    with StageStore(root).writer("carve", key, {"voxel_size_m": 0.02, "cameras": ["a", "b"]}) as out:
        for frame, arrays in product:
            out.append(frame, **arrays)
    return root / "carve"


def read(root: Path) -> tuple[dict[str, Any], Product]:
    reader = StageStore(root).reader("carve")
    return reader.attrs, list(reader)


def is_same(found: tuple[dict[str, Any], Product], product: Product) -> bool:
    attrs, rows = found
    return (
        attrs == {"voxel_size_m": 0.02, "cameras": ["a", "b"]}
        and [f for f, _ in rows] == [f for f, _ in product]
        and all(
            a.keys() == b.keys() and all(np.array_equal(a[n], b[n]) and a[n].dtype == b[n].dtype for n in a)
            for (_, a), (_, b) in zip(rows, product, strict=True)
        )
    )


def outcome(root: Path, product: Product) -> str:
    """`same`, `said` (an error that names the stage to run again), or `silent`."""
    try:
        found = read(root)
    except MocapError as error:
        return "said" if "run the stage carve" in error.remedy else "said something else"
    return "same" if is_same(found, product) else "silent"


def flips(root: Path, n: int, seed: int) -> dict[str, int]:
    product = frames()
    folder = write(root, product)
    assert outcome(root, product) == "same"
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    rng = np.random.default_rng(seed)
    counts = {"same": 0, "said": 0, "silent": 0}
    for _ in range(n):
        path = files[rng.integers(len(files))]
        content = path.read_bytes()
        bit = int(rng.integers(8 * len(content)))
        turned = bytearray(content)
        turned[bit // 8] ^= 1 << bit % 8
        path.write_bytes(turned)
        counts[outcome(root, product)] += 1
        path.write_bytes(content)
    assert outcome(root, product) == "same"
    return counts


def test_a_bit_that_turns_is_never_silent(tmp_path: Path) -> None:
    counts = flips(tmp_path / "store.zarr", N_FLIPS, seed=1)
    assert counts == {"same": 0, "said": N_FLIPS, "silent": 0}


@pytest.mark.slow
def test_ten_thousand_bits(tmp_path: Path) -> None:
    counts = flips(tmp_path / "store.zarr", N_FLIPS_SLOW, seed=2)
    assert counts == {"same": 0, "said": N_FLIPS_SLOW, "silent": 0}


def every_file(change: Callable[[Path], None], root: Path) -> None:
    product = frames()
    folder = write(root, product)
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        content = path.read_bytes()
        change(path)
        assert outcome(root, product) == "said", path
        path.write_bytes(content)
    assert outcome(root, product) == "same"


def test_a_file_that_is_cut_or_gone_or_empty_or_a_folder_is_never_silent(tmp_path: Path) -> None:
    every_file(lambda path: path.write_bytes(path.read_bytes()[:-1]), tmp_path / "a")
    every_file(lambda path: path.write_bytes(b""), tmp_path / "b")
    every_file(Path.unlink, tmp_path / "c")


def test_a_chunk_that_was_not_written_is_not_taken(tmp_path: Path) -> None:
    """Rows of zeros have no file; one that turns up is not ours."""
    product = frames()
    folder = write(tmp_path / "s", product)
    chunk = next(p for p in (folder / "masks" / "data" / "c").rglob("*") if p.is_file())
    target = folder / "zeros" / "data" / "c" / "0"
    assert not target.exists()
    target.mkdir(parents=True)
    shutil.copy(chunk, target / "0")
    assert outcome(tmp_path / "s", product) == "said"


def test_files_of_another_product_are_not_mixed(tmp_path: Path) -> None:
    """A list that is whole in itself, with the chunks of another run."""
    product = frames()
    write(tmp_path / "a", product)
    write(tmp_path / "b", frames(5))
    shutil.copy(tmp_path / "b" / "carve" / "files.json", tmp_path / "a" / "carve" / "files.json")
    assert outcome(tmp_path / "a", product) == "said"


@pytest.mark.parametrize("offsets", [[1, 2], [0, 3, 2], [0, 5, 3], [0, 1], [0, 1, 10**9]])
def test_rows_that_do_not_follow_each_other_are_refused(
    tmp_path: Path, offsets: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a faulty writer could leave them, with hashes that agree."""
    real = store_module._put

    def put(group: Any, name: str, array: np.ndarray) -> None:
        real(group, name, np.array(offsets) if name.endswith("offsets") else array)

    monkeypatch.setattr(store_module, "_put", put)
    with StageStore(tmp_path).writer("carve", "k") as out:
        out.append(0, x=np.ones(1))
        out.append(1, x=np.ones(2))
    reader = StageStore(tmp_path).reader("carve")
    for _ in range(2):
        with pytest.raises(MocapError, match="do not follow each other"):
            reader.read(0)


# --- power cuts ---


class Disk:
    """What a disk holds after a power cut: content and names as they were when they were last brought to it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.synced: dict[int, bytes] = {}
        self.folders: dict[int, set[str]] = {}
        self.moves: list[tuple[Path, bool]] = []
        real_sync, real_replace = os.fsync, os.replace

        def fsync(handle: int) -> None:
            place = Path(os.readlink(f"/proc/self/fd/{handle}"))
            if place.is_dir():
                self.folders[place.stat().st_ino] = {p.name for p in place.iterdir()}
            else:
                self.synced[place.stat().st_ino] = place.read_bytes()
            real_sync(handle)

        def replace(source: Any, target: Any) -> None:
            self.moves.append((Path(target), self.holds(Path(source))))
            real_replace(source, target)

        monkeypatch.setattr(os, "fsync", fsync)
        monkeypatch.setattr(os, "replace", replace)

    def holds(self, path: Path) -> bool:
        """Whether all of a file or folder is on the disk as it is."""
        if path.is_file():
            return self.synced.get(path.stat().st_ino) == path.read_bytes()
        names = {p.name for p in path.iterdir()}
        return self.folders.get(path.stat().st_ino) == names and all(self.holds(p) for p in path.iterdir())


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="looks at files by their handles")
def test_a_product_is_on_the_disk_before_it_takes_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = tmp_path / "store.zarr"
    write(root, frames(3))
    disk = Disk(monkeypatch)
    product = frames()
    folder = write(root, product, "new")
    ours = [is_whole for target, is_whole in disk.moves if target == folder]
    assert ours == [True]
    assert disk.holds(folder)
    assert "carve" in disk.folders[root.stat().st_ino]
    assert outcome(root, product) == "same"


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="looks at files by their handles")
def test_outputs_are_on_the_disk_before_they_take_their_places(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mocap.pipeline.publish import published

    disk = Disk(monkeypatch)
    with published(tmp_path) as folder:
        for name in ("run.json", "tracks.csv"):
            (folder / name).write_text(name)
    assert disk.moves == [(tmp_path / "tracks.csv", True), (tmp_path / "run.json", True)]
    assert {"run.json", "tracks.csv"} <= disk.folders[tmp_path.stat().st_ino]


@pytest.mark.parametrize("lost", range(12))
def test_a_cut_that_loses_a_file_of_a_product_is_never_silent(tmp_path: Path, lost: int) -> None:
    """Where a disk lies about what it holds: files of the new product are empty."""
    product = frames()
    folder = write(tmp_path / "s", product)
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    files[lost % len(files)].write_bytes(b"")
    assert outcome(tmp_path / "s", product) == "said"
