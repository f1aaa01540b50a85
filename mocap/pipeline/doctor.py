"""What this machine and installation can do: versions, threads, codecs, extras, folders, kernels and a self-test."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

import numpy as np

from mocap.data import Camera, VoxelGrid
from mocap.errors import DISTRIBUTION, MocapError, install_command
from mocap.forks import begun
from mocap.io.store import StageStore
from mocap.likelihood.voxels.device import device_name
from mocap.pipeline.record import versions
from mocap.pipeline.warm_up import small_rig
from mocap.portable import kernel_cache_dir, total_memory_bytes

Verdict = Literal["ok", "missing", "wrong"]

_PACKAGE = Path(__file__).resolve().parents[1]
# What an extra brings, and what cannot be done without it.
_EXTRAS = {
    "synth": ("embreex", "synthetic sessions and `mocap demo`"),
    "export": ("ezc3d", "C3D files and meshes of hulls"),
    "usd": ("pxr", "USD files"),
    "sets": ("cdflib", "poses of Human3.6M"),
    "sound": ("av", "`mocap sync --by sound`"),
    "view": ("rerun", "scene.rrd, `mocap view` and `mocap live --view`"),
    "lsl": ("pylsl", "`mocap live --lsl`"),
    "gpu": ("numba_cuda", "`mocap run --device cuda`"),
    "open3d": ("open3d", "`mocap depth --what room` and `mocap calibrate --register`"),
    "cluster": ("distributed", "`mocap sweep` and `mocap batch` with several workers"),
}
_CODECS = (("mp4v", ".mp4"), ("MJPG", ".avi"))
_PICTURES = (".png", ".jpg", ".tif")
_CLIP_SIZE, _CLIP_FRAMES = (64, 48), 4
_BALL_M = 0.4
# Silhouettes hold a ball and a little more; pixels and voxels make a few percent.
_BALL_EXCESS = (0.95, 1.25)


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.  verdict : `missing` costs some abilities, `wrong` is to be mended."""

    what: str
    verdict: Verdict
    text: str


def examine() -> Iterator[Finding]:
    """Everything, one by one, quick things first."""
    yield from _versions()
    yield _threads()
    yield from _extras()
    yield _device()
    yield from _folders()
    yield _kernels()
    yield from _codecs()
    yield _store()
    yield _self_test()


def _versions() -> Iterator[Finding]:
    found = versions()
    yield Finding("versions", "ok", ", ".join(f"{name} {number}" for name, number in found.items()))
    for line in _requirements():
        name, _, least = line.partition(">=")
        try:
            have = version(name)
        except PackageNotFoundError:
            yield Finding(name, "wrong", f"is not installed. Remedy: {install_command()}")
            continue
        if least and _numbers(have) < _numbers(least):
            yield Finding(
                name, "wrong", f"is {have}, at least {least} is needed. Remedy: {install_command()}"
            )


def _requirements() -> list[str]:
    """`name>=version` of what the package cannot do without; nothing in a checkout that is not installed."""
    try:
        return [line for line in requires(DISTRIBUTION) or [] if ";" not in line]
    except PackageNotFoundError:
        return []


def _numbers(text: str) -> tuple[int, ...]:
    """The leading numbers of a version."""
    numbers = []
    for part in text.split("."):
        digits = part.strip()
        if not digits.isdigit():
            break
        numbers.append(int(digits))
    return tuple(numbers)


def _threads() -> Finding:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    memory = total_memory_bytes()
    limits = {
        name: os.environ[name] for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS") if name in os.environ
    }
    text = f"{cores} cores for this process"
    text += "" if memory is None else f", {memory / 1e9:.1f} GB of memory"
    return Finding("machine", "ok", text + "".join(f", {name}={value}" for name, value in limits.items()))


def _extras() -> Iterator[Finding]:
    for extra, (module, use) in _EXTRAS.items():
        if find_spec(module) is None:
            yield Finding(f"extra {extra}", "missing", f"{use} need it. Remedy: {install_command(extra)}")
        else:
            yield Finding(f"extra {extra}", "ok", use)


def _device() -> Finding:
    with begun(device_name, 2) as name:
        found = name()
    if found is None:
        return Finding("CUDA device", "missing", "none answers: the processor scores all particles")
    return Finding("CUDA device", "ok", f"{found}, for `mocap run --device cuda`")


def _folders() -> Iterator[Finding]:
    for what, folder in (("temporary files", Path(tempfile.gettempdir())), ("working folder", Path.cwd())):
        if os.access(folder, os.W_OK):
            yield Finding(what, "ok", f"{folder} may be written")
        else:
            verdict: Verdict = "wrong" if what == "temporary files" else "missing"
            yield Finding(
                what, verdict, f"{folder} may not be written. Remedy: set TMPDIR, or give -o elsewhere"
            )
    encoding = sys.getfilesystemencoding()
    is_wide = encoding.lower().replace("-", "") == "utf8"
    yield Finding("names of files", "ok" if is_wide else "missing", f"are written as {encoding}")


def _kernels() -> Finding:
    """Compiled kernels are kept from run to run, and how many are there already."""
    place = kernel_cache_dir()
    if place is None:
        text = "compiled kernels cannot be kept: every command compiles for a minute or more. "
        return Finding(
            "kernels", "missing", text + "Remedy: set NUMBA_CACHE_DIR to a folder that may be written"
        )
    sources = sorted(_PACKAGE.glob("*/**/_*kernels.py")) + sorted(_PACKAGE.glob("*/_*kernels.py"))
    indexes = list(place.rglob("_*kernels.*.nbi"))
    compiled = {path.name.split(".")[0] for path in indexes}
    n_ready = len({path for path in sources if path.stem in compiled})
    text = f"{n_ready} of {len(set(sources))} files of kernels have been compiled, in {place}"
    return Finding("kernels", "ok", text if n_ready else text + ". Remedy: mocap warm-up")


def _codecs() -> Iterator[Finding]:
    import cv2

    picture = np.full((_CLIP_SIZE[1], _CLIP_SIZE[0], 3), 128, dtype=np.uint8)
    with tempfile.TemporaryDirectory() as folder:
        for name, ending in _CODECS:
            path = str(Path(folder) / f"clip{ending}")
            writer = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*name), 30.0, _CLIP_SIZE)
            for _ in range(_CLIP_FRAMES):
                writer.write(picture)
            writer.release()
            capture, n_read = cv2.VideoCapture(path), 0
            while capture.read()[0]:
                n_read += 1
            capture.release()
            is_fine = n_read == _CLIP_FRAMES
            yield Finding(
                f"video {ending}",
                "ok" if is_fine else "wrong",
                f"{n_read} of {_CLIP_FRAMES} pictures came back",
            )
        for ending in _PICTURES:
            is_fine, coded = cv2.imencode(ending, picture)
            is_fine = bool(is_fine) and cv2.imdecode(coded, cv2.IMREAD_COLOR) is not None
            yield Finding(f"pictures {ending}", "ok" if is_fine else "wrong", "written and read")


def _store() -> Finding:
    """A product is written, damaged, and must say so."""
    with tempfile.TemporaryDirectory() as folder:
        store = StageStore(Path(folder) / "store.zarr")
        with store.writer("test", "key") as out:
            out.append(0, x=np.arange(1000))
        same = np.array_equal(store.reader("test").read(0)["x"], np.arange(1000))
        chunk = next(p for p in (store.path / "test" / "x" / "data" / "c").rglob("*") if p.is_file())
        content = bytearray(chunk.read_bytes())
        content[len(content) // 2] ^= 1
        chunk.write_bytes(content)
        try:
            store.reader("test").read(0)
        except MocapError:
            return Finding("store", "ok" if same else "wrong", "products come back, and damage is noticed")
    return Finding("store", "wrong", "a damaged product was read without a word. Remedy: report this")


def _self_test() -> Finding:
    """The volume of a ball from six silhouettes."""
    from mocap.volume import Carver

    started = time.perf_counter()
    rig = small_rig()
    grid = VoxelGrid(np.array([-0.6, -0.6, 0.4]), (40, 40, 40), 0.03)
    center = np.array([0.0, 0.0, 1.0])
    carver = Carver(rig, grid)
    voxels = carver.carve([_ball_mask(camera, center) for camera in rig], n_faulty_views=0)
    ratio = len(voxels) * grid.voxel_size_m**3 / (4 / 3 * np.pi * _BALL_M**3)
    seconds = time.perf_counter() - started
    is_right = _BALL_EXCESS[0] <= ratio <= _BALL_EXCESS[1]
    text = f"a ball carved from six silhouettes is {ratio:.2f} of its volume, in {seconds:.1f} s"
    return Finding("self-test", "ok" if is_right else "wrong", text)


def _ball_mask(camera: Camera, center: np.ndarray) -> np.ndarray:
    """Pixels whose line of sight meets the ball."""
    v, u = np.mgrid[: camera.size[1], : camera.size[0]]
    rays = camera.rays(np.stack([u, v], axis=-1).astype(np.float64))
    away = center - camera.center
    distance = np.linalg.norm(np.cross(rays, away), axis=-1)
    return np.asarray(distance <= _BALL_M)
