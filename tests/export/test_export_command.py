"""`mocap export` on a finished run: one file per frame or person, and refusals that say what there is."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
from small_session import PLAIN, mocap, set_options, small_session

from mocap.data import VoxelGrid
from mocap.io.store import StageStore
from mocap.pipeline.config import load_config
from mocap.pipeline.export import _about
from mocap.pose.method import Method

GRID = VoxelGrid(np.array([-0.5, 0.0, 0.0]), (5, 6, 8), 0.1)
FRAMES = (7, 8, 10)


@pytest.fixture
def result(tmp_path: Path) -> Path:
    """A run folder with three hulls of 3, 4 and 0 voxels."""
    out = tmp_path / "result"
    attrs = {"origin_m": GRID.origin.tolist(), "shape": list(GRID.shape), "voxel_size_m": GRID.voxel_size_m}
    with StageStore(out / "store.zarr").writer("carve", "key", attrs) as writer:
        for frame, n in zip(FRAMES, (3, 4, 0), strict=True):
            writer.append(
                frame,
                voxels=np.arange(10, 10 + n, dtype=np.int32),
                is_surface=np.ones(n, dtype=bool),
                n_views=np.ones(n, dtype=np.uint8),
                rgb=np.full((n, 3), 80, dtype=np.uint8),
            )
    (out / "run.json").write_text(json.dumps({"fps": 10, "product_keys": {"carve": "key"}}))
    return out


@pytest.mark.parametrize("format", ["ply", "npz", "glb"])
def test_a_file_per_frame_of_the_range(result: Path, tmp_path: Path, format: str) -> None:
    said = mocap("export", result, "-o", tmp_path / "x", "--format", format, "--frames", "8:")
    assert said.code == 0, said.err
    assert said.out.startswith("2 files: ")
    names = sorted(p.name for p in (tmp_path / "x").iterdir())
    assert names == [f"voxels_{f:06d}.{format}" for f in (8, 10)]
    if format == "npz":
        with np.load(tmp_path / "x" / names[0], allow_pickle=False) as found:
            np.testing.assert_array_equal(found["voxels"], [10, 11, 12, 13])


@pytest.mark.parametrize("format", ["ply", "glb"])
def test_a_mesh_per_frame(result: Path, tmp_path: Path, format: str) -> None:
    pytest.importorskip("skimage", reason="scikit-image: the extra `export`")
    said = mocap("export", result, "-o", tmp_path / "x", "--what", "mesh", "--format", format)
    assert said.code == 0, said.err
    names = sorted(p.name for p in (tmp_path / "x").iterdir())
    assert names == [f"mesh_{f:06d}.{format}" for f in FRAMES]


def test_cubes(result: Path, tmp_path: Path) -> None:
    assert mocap("export", result, "-o", tmp_path, "--cubes", "--frames", "7:8").code == 0
    assert b"element face" in (tmp_path / "voxels_000007.ply").read_bytes()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--what", "nothing"), ("nothing", "voxels, mesh, motion")),
        (("--format", "bvh"), ("bvh", "ply, npz, glb")),
        (("--frames", "20:30"), ("no frame", "7:11")),
        (("--what", "motion"), ("pose", "run")),
    ],
)
def test_what_is_not_there_is_said(
    result: Path, tmp_path: Path, options: tuple[str, ...], words: tuple[str, ...]
) -> None:
    said = mocap("export", result, "-o", tmp_path / "x", *options)
    assert said.code == 2
    assert all(word in said.err for word in words), said.err


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    said = mocap("export", tmp_path, "-o", tmp_path / "x")
    assert said.code == 2
    assert "no result of a run" in said.err


@pytest.mark.slow
def test_all_formats_hold_what_landmarks_csv_holds(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """One run, and every format of all persons from the command line, against the table of the run."""
    from scipy.io import netcdf_file

    from mocap.io.tables import read_landmarks_csv

    session = small_session(tmp_path_factory.getbasetemp())
    out, folder = tmp_path / "out", tmp_path / "x"
    assert mocap("run", session, "-o", out, *set_options(PLAIN)).code == 0
    (truth,) = read_landmarks_csv(out / "landmarks.csv")
    for format in ("nc", "bids", *(("usd",) if importlib.util.find_spec("pxr") else ())):
        options = ("--task", "walk") if format == "bids" else ()
        said = mocap("export", out, "-o", folder, "--what", "motion", "--format", format, *options)
        assert said.code == 0, said.err
    with netcdf_file(folder / "motion.nc", "r", mmap=False) as file:
        places = file.variables["position"][:, :, :, 0].transpose(0, 2, 1)
        time_s = file.variables["time"][:].copy()
    np.testing.assert_allclose(time_s, truth.time_s, atol=1e-6)
    np.testing.assert_allclose(places, truth.landmarks, atol=1e-6)  # six decimals in the table
    table = np.loadtxt(folder / "sub-01/motion/sub-01_task-walk_tracksys-mocap_motion.tsv")
    np.testing.assert_allclose(table[:, 1:].reshape(-1, 15, 3), truth.landmarks, atol=2e-6)
    if importlib.util.find_spec("pxr"):
        assert (folder / "person_1.usd").stat().st_size > 10_000


@pytest.mark.slow
def test_motion_of_a_run_is_what_the_run_wrote(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    session = small_session(tmp_path_factory.getbasetemp())
    out = tmp_path / "out"
    assert mocap("run", session, "-o", out, *set_options(PLAIN)).code == 0
    for format in ("bvh", "trc"):
        said = mocap("export", out, "-o", tmp_path / "x", "--what", "motion", "--format", format)
        assert said.code == 0, said.err
        (written,) = (tmp_path / "x").glob(f"*.{format}")
        assert written.read_bytes() == (out / written.name).read_bytes()


def test_a_motion_is_exported_with_the_settings_of_its_run(tmp_path: Path) -> None:
    about = {"fps": 25.0, "session": "here"}
    config = load_config("default", ("method.contact.low_quantile=0.3", "method.angles.spine_std_deg=5.0"))
    write = (tmp_path / "run.json").write_text
    write(json.dumps({**about, "config": config.model_dump(mode="json")}))
    fps, session, method = _about(tmp_path)
    assert (fps, session) == (25.0, "here")
    assert (method.contact.low_quantile, method.angles.spine_std_deg) == (0.3, 5.0)
    write(json.dumps({**about, "config": {"of": "another version"}}))
    assert _about(tmp_path)[2] == Method()
