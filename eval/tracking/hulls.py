"""Hulls of whole scenes on disk, one file per scene and voxel size, and the truth that belongs to them."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.data import Hull, Tracks, VoxelGrid

ROOT = Path(__file__).resolve().parents[2]
WORK = ROOT / "out" / "tracking"
SHARED = ROOT.parent / "shared" / "dev_sessions"
VOXEL_CM = (15, 10, 5, 2)

DEVELOPMENT = ("meeting_01", "meeting_02", "meeting_03", "meeting_04", "crossing_01")
TEST = ("meeting_test_01", "meeting_test_02", "meeting_test_03", "meeting_test_04", "crossing_test_01")
LONG_DEVELOPMENT = ("meeting_long_01",)
LONG_TEST = ("meeting_long_test_01", "meeting_long_test_02")
SMALL_DEVELOPMENT = ("sit", "child")
SMALL_TEST = ("sit_test", "child_test")
LOW_DEVELOPMENT = ("fall", "pick_up")  # persons who lie or crouch: only for the classifier, silhouettes only
LOW_TEST = ("fall_test",)
OTHERS = ("room", "cross")
_THREE = "_three"
THREE_DEVELOPMENT = tuple(s + _THREE for s in DEVELOPMENT if s.startswith("meeting"))
THREE_TEST = tuple(s + _THREE for s in TEST if s.startswith("meeting"))


@dataclass(frozen=True, eq=False)
class HullClip:
    """The hulls of a scene.

    frames : (T,) ascending.  hulls : one per frame.  truth : centroids of the persons inside the room.
    heads : middles of their heads, None where the truth has none.
    """

    name: str
    fps: float
    frames: NDArray[np.int64]
    hulls: tuple[Hull, ...]
    truth: Tracks
    heads: Tracks | None

    @property
    def voxel_size_m(self) -> float:
        return self.hulls[0].grid.voxel_size_m

    def __iter__(self) -> Iterator[tuple[int, Hull]]:
        return zip(self.frames.tolist(), self.hulls, strict=True)


def hull_path(scene: str, voxel_cm: int, work: Path = WORK) -> Path:
    """Where the hulls of a scene lie."""
    return work / "hulls" / f"{scene}_{voxel_cm}cm.npz"


def is_made(scene: str, sizes: Sequence[int] = VOXEL_CM, work: Path = WORK) -> bool:
    """Whether the scene has been rendered, segmented and carved at all these voxel sizes."""
    return all(hull_path(scene, cm, work).exists() for cm in sizes)


def make_hulls(scene: str, sizes: Sequence[int] = VOXEL_CM, work: Path = WORK) -> None:
    """Render a scene, segment its pictures and carve it at every voxel size; what is there already is kept."""
    from mocap.pipeline.config import load_config
    from mocap.pipeline.run import run_session
    from mocap.synth.scene import load_scene
    from mocap.synth.session import synthesise

    if is_made(scene, sizes, work):
        return
    folder = SHARED / scene if scene in OTHERS else work / "sessions" / scene
    if scene.endswith(_THREE):
        make_hulls(scene.removesuffix(_THREE), sizes, work)
        _with_three_cameras(work / "sessions" / scene.removesuffix(_THREE), folder)
    if not folder.exists():
        lean = {"truth_voxels": False} | ({"masks_only": True} if scene in LOW_DEVELOPMENT + LOW_TEST else {})
        synthesise(load_scene(scene).model_copy(update=lean), folder, workers=1)
    out = work / "runs" / scene
    for cm in sorted(sizes, reverse=True):
        if hull_path(scene, cm, work).exists():
            continue
        config = load_config("default", ("output.formats=[]", f"volume.voxel_size_m={cm / 100}"))
        run = run_session(folder, out, config=config, until="carve", resume=True, n_threads=1)
        _save(out, hull_path(scene, cm, work), run.session.fps)
    truth = work / "truth" / scene
    truth.mkdir(parents=True, exist_ok=True)
    for file in ("tracks.csv", "heads.csv", "truth.json", "landmarks.csv"):
        if (folder / "truth" / file).exists():
            shutil.copy(folder / "truth" / file, truth / file)
    shutil.rmtree(out)


def _with_three_cameras(full: Path, folder: Path) -> None:
    """A session with two corner cameras side by side and the one on the ceiling of a full one, by links."""
    from mocap.io.calibration import read_calibration, write_calibration

    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    rig = read_calibration(full / "calibration.toml").rig
    names = [rig.names[i] for i in (0, 1, len(rig) - 1)]
    write_calibration(folder / "calibration.toml", rig.subset(names))
    shutil.copy(full / "session.toml", folder)
    (folder / "truth").symlink_to(full / "truth")
    for kind in ("videos", "background"):
        (folder / kind).mkdir()
        for name in names:
            for file in (full / kind).glob(f"{name}.*"):
                (folder / kind / file.name).symlink_to(file)


def load_hulls(scene: str, voxel_cm: int, work: Path = WORK) -> HullClip:
    """The hulls of a scene that `python -m eval.tracking_scenes` has made.

    Raises FileNotFoundError when it has not.
    """
    from mocap.io.tables import read_tracks_csv

    path = hull_path(scene, voxel_cm, work)
    if not path.exists():
        raise FileNotFoundError(f"{path} is missing; run `python -m eval.tracking_scenes {scene}` first")
    with np.load(path, allow_pickle=False) as archive:
        grid = VoxelGrid(
            archive["origin_m"], tuple(archive["shape"].tolist()), float(archive["voxel_size_m"])
        )
        ends = np.cumsum(archive["count"])[:-1]
        arrays = [np.split(archive[k], ends) for k in ("voxels", "is_surface", "n_views", "rgb")]
        hulls = tuple(Hull(grid, *of_frame) for of_frame in zip(*arrays, strict=True))
        frames, fps = archive["frames"].astype(np.int64), float(archive["fps"])
    truth = work / "truth" / scene
    heads = truth / "heads.csv"
    return HullClip(
        name=scene,
        fps=fps,
        frames=frames,
        hulls=hulls,
        truth=read_tracks_csv(truth / "tracks.csv"),
        heads=read_tracks_csv(heads) if heads.exists() else None,
    )


def furniture_of(scene: str, work: Path = WORK) -> list[list[list[float]]]:
    """Boxes (lower, upper) in m of the furniture."""
    about = json.loads((work / "truth" / scene / "truth.json").read_text("utf-8"))
    return about.get("furniture_m", [])


def _save(run: Path, path: Path, fps: float) -> None:
    """The hulls of a finished run as one file."""
    from mocap.io.store import StageStore
    from mocap.products.hulls import stored_grid

    store = StageStore(run / "store.zarr")
    grid = stored_grid(store)
    frames, columns = [], []
    for frame, arrays in store.reader("carve"):
        frames.append(frame)
        columns.append([arrays[k] for k in ("voxels", "is_surface", "n_views", "rgb")])
    voxels, surface, views, rgb = (np.concatenate(c) for c in zip(*columns, strict=True))
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial.npz")
    np.savez_compressed(
        partial,
        origin_m=grid.origin,
        shape=np.array(grid.shape, dtype=np.int64),
        voxel_size_m=np.float64(grid.voxel_size_m),
        fps=np.float64(fps),
        frames=np.array(frames, dtype=np.int64),
        count=np.array([len(c[0]) for c in columns], dtype=np.int64),
        voxels=voxels.astype(np.int32),
        is_surface=surface.astype(np.bool_),
        n_views=views.astype(np.uint8),
        rgb=rgb.astype(np.uint8),
    )
    os.replace(partial, path)
