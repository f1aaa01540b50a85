"""From camera folder to files: every output is there and readable, and the same input gives the same bytes."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_session import CAMERAS, FPS, N_FRAMES, PLAIN, SETTINGS, copy_session, digests, mocap, set_options

import mocap as library
from mocap.data import ALL_LANDMARKS, LANDMARKS
from mocap.errors import MocapError
from mocap.io.store import StageStore
from mocap.io.tables import read_landmarks_csv, read_tracks_csv
from mocap.pipeline.chains import CHAINS
from mocap.pipeline.config import Config, load_config
from mocap.pipeline.figures import errors_by_person
from mocap.pipeline.keys import stage_keys
from mocap.pipeline.record import RunResult
from mocap.pipeline.run import run_session
from mocap.products.masks import read_masks

SEED = 3
# Files that hold no clock times: the same seed must give the same bytes.
SAME_BYTES = ("tracks.csv", "landmarks.csv", "person_1.bvh", "person_1.trc")
EVAL_KEYS = {
    *("mean_error_mm", "std_error_mm", "mmtp_mm", "mmta_percent", "epsilon_mm", "epsilon_opt_mm"),
    *(
        "angle_mean_deg",
        "angle_std_deg",
        "motp_mm",
        "mota_percent",
        "misses",
        "false_positives",
        "mismatches",
    ),
    *("volume_iou", "coverage_90_percent", "frames"),
}


def plain_config() -> Config:
    return load_config("default", PLAIN)


def files_of(out: Path, names: tuple[str, ...] = SAME_BYTES) -> dict[str, bytes]:
    return {name: (out / name).read_bytes() for name in names}


@pytest.fixture(scope="module")
def full(session: Path, tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    """A run with every output."""
    out = tmp_path_factory.mktemp("full") / "out"
    return run_session(session, out, config=load_config("default", SETTINGS), seed=SEED, command="mocap run")


@pytest.fixture(scope="module")
def masks_session(session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return copy_session(session, tmp_path_factory.mktemp("masks") / "session", masks=True)


@pytest.fixture(scope="module")
def plain(masks_session: Path, tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    """A run on masks with few outputs, which the variants below are compared with."""
    out = tmp_path_factory.mktemp("plain") / "out"
    return run_session(masks_session, out, config=plain_config(), seed=SEED, n_threads=1)


# --- outputs ---


def test_every_output_is_there(full: RunResult) -> None:
    names = {p.name for p in full.out.iterdir()}
    exports = {f"person_1.{suffix}" for suffix in ("bvh", "trc", "c3d", "glb", "mot")}
    assert names == {
        *("run.json", "tracks.csv", "landmarks.csv", "pose.npz", "scene.rrd", "report.html", "store.zarr"),
        *("angles.csv", "contacts.csv", "steps.csv", "cycles.csv", "moves.csv", "body.toml"),
        *exports,
    }
    assert full.status == "complete"
    assert full.tracks is not None
    assert full.tracks.persons == (1,)
    assert len(full.motions) == 1


def test_tables(full: RunResult) -> None:
    with (full.out / "tracks.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows[0] == [
        *("frame", "time_s", "person", "x_m", "y_m", "z_m"),
        *("std_x_m", "std_y_m", "std_z_m", "status"),
    ]
    assert [(int(r[0]), float(r[1]), int(r[2])) for r in rows[1:]] == [
        (f, f / FPS, 1) for f in range(N_FRAMES)
    ]
    assert all(0 < float(std) < 0.2 for r in rows[1:] for std in r[6:9])
    assert {r[9] for r in rows[1:]} <= {"confirmed", "coasting"}
    with (full.out / "landmarks.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows[0] == [
        *("frame", "time_s", "person", "landmark", "x_m", "y_m", "z_m"),
        *("std_x_m", "std_y_m", "std_z_m", "observed"),
    ]
    assert [(int(r[0]), r[3]) for r in rows[1:]] == [
        (f, name) for f in range(N_FRAMES) for name in ALL_LANDMARKS
    ]
    values = np.array([[float(v) for v in r[4:10]] for r in rows[1:]])
    assert np.isfinite(values).all()
    assert (values[:, 3:] > 0).all()
    assert {r[10] for r in rows[1:]} <= {"0", "1"}


def test_the_walker_is_found(full: RunResult, session: Path) -> None:
    """Coarse voxels and few particles still put the body where it is; a broken axis or unit would not."""
    truth = read_landmarks_csv(session / "truth" / "landmarks.csv")[0]
    estimate = full.motions[0]
    pelvis = LANDMARKS.index("pelvis")
    error = np.linalg.norm(estimate.landmarks[:, pelvis] - truth.landmarks[:, pelvis], axis=1)
    assert np.median(error) < 0.1
    head = estimate.landmarks[:, LANDMARKS.index("head"), 2]
    assert np.abs(np.median(head) - np.median(truth.landmarks[:, LANDMARKS.index("head"), 2])) < 0.15


def test_run_json(full: RunResult) -> None:
    about = json.loads((full.out / "run.json").read_text())
    assert about["status"] == "complete"
    assert about["cameras"] == list(CAMERAS)
    assert (about["seed"], about["n_frames"], about["frames"], about["fps"]) == (
        SEED,
        N_FRAMES,
        [0, N_FRAMES],
        FPS,
    )
    assert about["config"]["volume"]["voxel_size_m"] == 0.04
    assert set(about["stages"]) == {"segment", "occluders", "carve", "track", "pose", "report"}
    assert all(s["wall_s"] > 0 and s["frames_per_s"] > 0 for s in about["stages"].values())
    assert set(about["stage_keys"]) == {"segment", "occluders", "carve", "track", "pose"}
    for key in ("config_hash", "code_hash", "warnings", "versions", "peak_memory_mb", "total_s", "scores"):
        assert about[key] is not None, key
    assert about["versions"]["numpy"] == np.__version__
    assert about["peak_memory_mb"] < 2000


def test_pose_npz_needs_no_pickle(full: RunResult) -> None:
    with np.load(full.out / "pose.npz", allow_pickle=False) as data:
        arrays = {name: data[name] for name in data.files}
    columns = len(arrays["columns"])
    assert arrays["persons"].tolist() == [1]
    assert arrays["person_1_frames"].tolist() == list(range(N_FRAMES))
    assert arrays["person_1_state"].shape == (N_FRAMES, columns)
    assert arrays["person_1_landmarks_m"].shape == (N_FRAMES, len(ALL_LANDMARKS), 3)
    covariance = arrays["person_1_landmark_covariance_m2"]
    assert covariance.shape == (N_FRAMES, len(ALL_LANDMARKS), 3, 3)
    assert (np.linalg.eigvalsh(covariance) > 0).all()
    landmarks = read_landmarks_csv(full.out / "landmarks.csv")[0].landmarks
    np.testing.assert_allclose(arrays["person_1_landmarks_m"], landmarks, atol=1e-6)


def test_exports_hold_the_motion(full: RunResult) -> None:
    landmarks = full.motions[0].landmarks
    lines = (full.out / "person_1.trc").read_text().splitlines()
    cells = [float(x) for x in lines[-1].split("\t")]
    y_up = np.array(cells[2:]).reshape(-1, 3)
    np.testing.assert_allclose(y_up[:, [2, 0, 1]], landmarks[-1], atol=1e-5)

    bvh = (full.out / "person_1.bvh").read_text()
    assert bvh.startswith("HIERARCHY")
    assert f"Frames: {N_FRAMES}" in bvh
    time = re.search(r"Frame Time: ([\d.]+)", bvh)
    assert time is not None
    assert float(time.group(1)) == pytest.approx(1 / FPS)
    n_channels = sum(int(n) for n in re.findall(r"CHANNELS (\d+)", bvh))
    frames = bvh.split("Frame Time:")[1].splitlines()[1:]
    assert [len(line.split()) for line in frames] == [n_channels] * N_FRAMES

    import trimesh

    assert (full.out / "person_1.glb").read_bytes()[:4] == b"glTF"
    assert len(trimesh.load(full.out / "person_1.glb", force="scene").geometry) > 0


def test_c3d_holds_the_motion(full: RunResult) -> None:
    ezc3d = pytest.importorskip("ezc3d", reason="C3D needs the extra export")
    c3d = ezc3d.c3d(str(full.out / "person_1.c3d"))
    assert c3d["parameters"]["POINT"]["UNITS"]["value"] == ["mm"]
    points = c3d["data"]["points"][:3].transpose(2, 1, 0)
    np.testing.assert_allclose(points / 1000.0, full.motions[0].landmarks, atol=1e-5)


def test_report_is_self_contained(full: RunResult) -> None:
    text = (full.out / "report.html").read_text()
    assert not re.findall(r'src\s*=\s*["\'](?!data:)', text)
    # Links lead into the page, or to the files beside it.
    links = set(re.findall(r'href\s*=\s*["\'](?!#)([^"\']*)', text))
    assert links <= {path.name for path in full.out.iterdir()}
    assert {"landmarks.csv", "angles.csv", "person_1.bvh", "person_1.mot"} <= links
    assert "http://" not in re.sub(r'xmlns[:\w]*="[^"]*"', "", text).replace("http://www.w3.org", "")
    assert "<script src" not in text
    assert text.count("data:image/") >= 10  # five views in two cameras, and plots
    for word in ("silhouette", "hull", "fitted body", "Error over time", "tracks.csv", "person_1.bvh"):
        assert word in text
    assert (full.out / "report.html").stat().st_size < 5_000_000


def test_scores(full: RunResult, session: Path) -> None:
    assert full.scores is not None
    assert full.scores["frames"] == N_FRAMES
    assert full.scores["mota_percent"] == 100.0
    said = mocap("eval", full.out, session, "--json")
    assert said.code == 0, said.err
    scores = json.loads(said.out)
    assert set(scores) >= EVAL_KEYS
    assert scores["epsilon_mm"] == 100.0
    # The tables are rounded to micrometres.
    assert scores["mean_error_mm"] == pytest.approx(full.scores["mean_error_mm"], abs=1e-2)
    finer = json.loads(mocap("eval", full.out, session, "--json", "--epsilon", 30).out)
    assert finer["epsilon_mm"] == 30.0
    assert finer["mmta_percent"] <= scores["mmta_percent"]
    assert "MMTA" in mocap("eval", full.out, session).out


def test_error_plot_shows_the_scored_errors(full: RunResult, session: Path) -> None:
    """Millimetres, as the scores: the plot once showed a thousand times as much."""
    errors = errors_by_person(full.found)
    assert full.scores is not None
    mean = np.mean([np.nanmean(mm) for _, mm in errors.values()])
    assert mean == pytest.approx(full.scores["mean_error_mm"], rel=1e-6)


def test_volume_is_scored_at_the_voxel_size_of_the_truth(session: Path, tmp_path: Path) -> None:
    """The hull from true silhouettes holds the body: precision is low, recall is not."""
    masks = copy_session(session, tmp_path / "session", masks=True, n_frames=2)
    config = load_config("default", (*PLAIN, "volume.voxel_size_m=0.02"))
    result = run_session(masks, tmp_path / "out", config=config, seed=SEED)
    assert result.scores is not None
    assert 0.3 < result.scores["volume_iou"] < 1.0


def test_store_holds_every_stage(full: RunResult) -> None:
    store = StageStore(full.out / "store.zarr")
    keys = json.loads((full.out / "run.json").read_text())["stage_keys"]
    for stage, key in keys.items():
        assert store.is_complete(stage, key)
        if stage != "occluders":  # a row per camera
            assert store.reader(stage).frames.tolist() == list(range(N_FRAMES))
    masks = [m for _, m in read_masks(store, full.session)]
    truth = np.load(full.session.root / "truth" / "masks" / "cam_0.npz")["masks"]
    size = full.session.rig["cam_0"].size
    true = np.unpackbits(truth, axis=2, count=size[0]).astype(bool)
    overlap = np.mean([(m[0] & t).sum() / (m[0] | t).sum() for m, t in zip(masks, true, strict=True)])
    assert overlap > 0.7


# --- the same answer, however it is asked for ---


def test_same_seed_same_bytes(plain: RunResult, masks_session: Path, tmp_path: Path) -> None:
    """Other folder, other process state, two threads: not a byte changes; another seed changes the pose only."""
    again = run_session(masks_session, tmp_path / "b", config=plain_config(), seed=SEED, n_threads=2)
    assert files_of(again.out) == files_of(plain.out)
    other = run_session(masks_session, tmp_path / "c", config=plain_config(), seed=SEED + 1)
    assert files_of(other.out, ("tracks.csv",)) == files_of(plain.out, ("tracks.csv",))
    assert files_of(other.out, ("landmarks.csv",)) != files_of(plain.out, ("landmarks.csv",))


def test_threads_do_not_change_segmentation(session: Path, tmp_path: Path) -> None:
    products = []
    for n in (1, 2, 4):
        out = tmp_path / str(n)
        run_session(session, out, config=plain_config(), until="carve", n_threads=n)
        store = StageStore(out / "store.zarr")
        products.append(
            [{k: v.tobytes() for k, v in a.items()} for s in ("segment", "carve") for _, a in store.reader(s)]
        )
    assert products[0] == products[1] == products[2]


def test_same_bytes_in_a_fresh_process(plain: RunResult, masks_session: Path, tmp_path: Path) -> None:
    """Through the command, with one thread per library and another hash seed."""
    command = [
        sys.executable,
        "-m",
        "mocap",
        "run",
        masks_session,
        "-o",
        tmp_path / "out",
        "--seed",
        str(SEED),
    ]
    environment = {
        **os.environ,
        "PYTHONHASHSEED": "77",
        "OMP_NUM_THREADS": "1",
        "PYTHONPATH": str(Path(library.__file__).parents[1]),
    }
    done = subprocess.run(
        [*map(str, command), *set_options(PLAIN)],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert files_of(tmp_path / "out") == files_of(plain.out)


def test_resume_reuses_what_has_not_changed(plain: RunResult, masks_session: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(plain.out, out)
    before = files_of(out)
    again = run_session(masks_session, out, config=plain_config(), seed=SEED, resume=True)
    assert again.reused == ("segment", "occluders", "carve", "track", "pose")
    assert set(again.timings_s) == {"report"}
    assert files_of(out) == before

    other_seed = run_session(masks_session, out, config=plain_config(), seed=SEED + 1, resume=True)
    assert other_seed.reused == ("segment", "occluders", "carve", "track")
    coarser = load_config("default", (*PLAIN, "volume.voxel_size_m=0.05"))
    assert run_session(masks_session, out, config=coarser, until="track", resume=True).reused == ("segment",)
    anew = run_session(masks_session, out, config=plain_config(), until="segment")
    assert anew.reused == ()


def test_resume_notices_changed_input(plain: RunResult, masks_session: Path, tmp_path: Path) -> None:
    changed = tmp_path / "session"
    shutil.copytree(masks_session, changed)
    shutil.copytree(plain.out, tmp_path / "out")
    mask = changed / "masks" / "cam_1" / "0003.png"
    shutil.copy(changed / "masks" / "cam_1" / "0004.png", mask)
    result = run_session(changed, tmp_path / "out", config=plain_config(), until="carve", resume=True)
    assert result.reused == ()


class Killed(Exception):
    """Stands for a killed process."""


@pytest.mark.parametrize("stage", ["segment", "occluders", "carve", "track", "pose", "report"])
def test_killed_in_a_stage(
    stage: str, plain: RunResult, masks_session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Outputs of an earlier run stay as they are, and resuming gives the bytes of an uninterrupted run."""
    out = tmp_path / "out"
    shutil.copytree(plain.out, out)
    before = {k: v for k, v in digests(out).items() if "store.zarr" not in k}

    def interrupt(name: str, done: int, total: int) -> None:
        if name == stage and done >= min(5, total):
            raise Killed

    with pytest.raises(Killed):
        run_session(masks_session, out, config=plain_config(), seed=SEED + 1, progress=interrupt)
    assert {k: v for k, v in digests(out).items() if "store.zarr" not in k} == before
    store = StageStore(out / "store.zarr")
    keys = stage_keys(library.open_session(masks_session), plain_config(), SEED + 1)
    order = ["segment", "occluders", "carve", "track", "pose", "report"]
    n_done = order.index(stage)
    assert [store.is_complete(s, keys[s]) for s in order[:5]] == [
        # Products before the pose do not depend on the seed: those of the earlier run serve as well.
        s != "pose" or n_done == 5
        for s in order[:5]
    ]
    resumed = run_session(masks_session, out, config=plain_config(), seed=SEED + 1, resume=True)
    assert set(order[:n_done]) <= set(resumed.reused)
    whole = run_session(masks_session, tmp_path / "whole", config=plain_config(), seed=SEED + 1)
    assert files_of(resumed.out) == files_of(whole.out)


@pytest.mark.parametrize(
    ("stage", "kept"), [("carve", ()), ("pose", ("segment", "occluders", "carve", "track"))]
)
def test_killed_in_a_fresh_folder(
    plain: RunResult, masks_session: Path, tmp_path: Path, stage: str, kept: tuple[str, ...]
) -> None:
    """Stages that walk together are kept together."""
    out = tmp_path / "out"

    def interrupt(name: str, done: int, total: int) -> None:
        if name == stage and done == 5:
            raise Killed

    with pytest.raises(Killed):
        run_session(masks_session, out, config=plain_config(), seed=SEED, progress=interrupt)
    assert [p.name for p in out.iterdir()] == ["store.zarr"]
    products = {product for s in CHAINS["voxels"] if s.name in kept for product in s.products}
    assert {p.name for p in (out / "store.zarr").iterdir() if p.is_dir()} == products
    resumed = run_session(masks_session, out, config=plain_config(), seed=SEED, resume=True)
    assert resumed.reused == kept
    assert files_of(out) == files_of(plain.out)


def test_stage_commands_equal_the_full_run(plain: RunResult, masks_session: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    options = ["-o", out, "--seed", SEED, *set_options(PLAIN)]
    for stage in ("segment", "carve", "track", "pose"):
        said = mocap(stage, masks_session, *options)
        assert said.code == 0, said.err
        assert json.loads((out / "run.json").read_text())["status"] == f"complete until {stage}"
    assert "reused" in said.out
    names = ("tracks.csv", "landmarks.csv")
    assert files_of(out, names) == files_of(plain.out, names)
    assert not (out / "report.html").exists()
    assert mocap("run", masks_session, *options, "--resume").code == 0
    assert files_of(out) == files_of(plain.out)


def test_frame_range(plain: RunResult, masks_session: Path, tmp_path: Path) -> None:
    """Frames keep their numbers and times; hulls of the same frames are the same."""
    result = run_session(masks_session, tmp_path / "out", config=plain_config(), frames=(4, 9))
    assert result.motions[0].frames.tolist() == [4, 5, 6, 7, 8]
    tracks = read_tracks_csv(tmp_path / "out" / "tracks.csv")
    np.testing.assert_allclose(tracks.time_s, np.arange(4, 9) / FPS)
    ours, whole = (StageStore(o / "store.zarr").reader("carve") for o in (result.out, plain.out))
    for frame in range(4, 9):
        np.testing.assert_array_equal(ours.read(frame)["voxels"], whole.read(frame)["voxels"])
    assert result.scores is not None
    assert result.scores["frames"] == 5


# --- other kinds of sessions ---


def test_masks_are_taken_as_given(plain: RunResult) -> None:
    assert plain.session.image_sources == {}
    for _, masks in read_masks(StageStore(plain.out / "store.zarr"), plain.session):
        for camera, mask in zip(CAMERAS, masks, strict=True):
            assert 0 < mask.mean() < 0.5, camera
    assert plain.scores is not None
    assert plain.scores["mmta_percent"] > 60


def test_report_on_masks_alone(masks_session: Path, tmp_path: Path) -> None:
    config = load_config("default", (*SETTINGS, 'output.formats=["rrd", "report"]'))
    result = run_session(masks_session, tmp_path / "out", config=config, frames=(0, 3))
    assert {"scene.rrd", "report.html"} <= {p.name for p in result.out.iterdir()}


def test_a_single_instant(masks_session: Path, tmp_path: Path) -> None:
    """One frame with masks: a body without a track, every output with one frame."""
    result = run_session(
        masks_session, tmp_path / "out", config=load_config("default", SETTINGS), frames=(6, 7)
    )
    assert result.motions[0].frames.tolist() == [6]
    assert {"person_1.bvh", "person_1.c3d", "person_1.glb", "report.html"} <= {
        p.name for p in result.out.iterdir()
    }
    truth = read_landmarks_csv(masks_session / "truth" / "landmarks.csv")[0]
    assert np.linalg.norm(result.motions[0].landmarks[0, 0] - truth.landmarks[6, 0]) < 0.15


def test_without_background_says_so(session: Path, tmp_path: Path) -> None:
    bare = copy_session(session, tmp_path / "session")
    shutil.rmtree(bare / "background")
    result = run_session(bare, tmp_path / "out", config=plain_config(), until="segment")
    assert any("learnt from the recording itself" in w and "background/" in w for w in result.warnings)
    with pytest.raises(MocapError, match="no background to learn from") as caught:
        run_session(bare, tmp_path / "one", config=plain_config(), frames=(0, 1))
    assert "masks/" in caught.value.remedy
    first = load_config("default", (*PLAIN, "segmentation.background=first", "segmentation.first_frames=2"))
    run_session(bare, tmp_path / "first", config=first, until="segment")
    clip = load_config("default", (*PLAIN, "segmentation.background=clip"))
    with pytest.raises(MocapError, match="no clip of the empty scene"):
        run_session(bare, tmp_path / "clip", config=clip)


def test_background_that_does_not_fit(session: Path, tmp_path: Path) -> None:
    """A background of another camera shows another place; the run says which camera, learns anew and goes on."""
    wrong = copy_session(session, tmp_path / "session")
    shutil.copy(wrong / "background" / "cam_0.mp4", wrong / "background" / "cam_2.mp4")
    result = run_session(wrong, tmp_path / "out", config=plain_config(), until="carve")
    assert any("camera cam_2" in w and "shows another place" in w for w in result.warnings)


def test_image_folders_equal_videos(session: Path, tmp_path: Path) -> None:
    import cv2
    from small_session import read_clip

    folder = copy_session(session, tmp_path / "session")
    for video in sorted((folder / "videos").iterdir()):
        pictures = folder / "images" / video.stem
        pictures.mkdir(parents=True)
        for i, picture in enumerate(read_clip(video)):
            cv2.imwrite(str(pictures / f"frame_{i}.png"), picture)
    shutil.rmtree(folder / "videos")
    outs = []
    for name, root in (("videos", session), ("images", folder)):
        run_session(root, tmp_path / name, config=plain_config(), until="track")
        outs.append(files_of(tmp_path / name, ("tracks.csv",)))
    assert outs[0] == outs[1]


# --- memory ---


def peak_mb(session: Path, out: Path, until: str) -> float:
    command: list[Any] = [sys.executable, "-m", "mocap", "run", session, "-o", out, "--until", until]
    environment = {**os.environ, "PYTHONPATH": str(Path(library.__file__).parents[1])}
    done = subprocess.run(
        [*map(str, command), *set_options(PLAIN)], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return float(json.loads((out / "run.json").read_text())["peak_memory_mb"])


@pytest.mark.slow
def test_memory_does_not_grow_with_length(masks_session: Path, tmp_path: Path) -> None:
    """Thirty times the frames: the products grow on disk, not in memory."""
    short, long = tmp_path / "short", tmp_path / "long"
    for root, repeats in ((short, 10), (long, 300)):
        copy_session(masks_session, root)
        for folder in (root / "masks").iterdir():
            files = sorted(folder.iterdir())
            for r in range(1, repeats):
                for i, file in enumerate(files):
                    os.link(file, folder / f"{r * N_FRAMES + i:04d}.png")
    # The first run also fills the caches of the compiled kernels.
    peak_mb(short, tmp_path / "warm", "track")
    few, many = (peak_mb(root, tmp_path / f"out_{root.name}", "track") for root in (short, long))
    assert many < few + 60.0


def test_session_object_is_accepted(masks_session: Path, tmp_path: Path) -> None:
    opened = library.open_session(masks_session, frames=(0, 4))
    result = run_session(replace(opened, name="mine"), tmp_path / "out", config=plain_config(), until="track")
    assert result.session.name == "mine"
    assert json.loads((tmp_path / "out" / "run.json").read_text())["session"] == "mine"
    with pytest.raises(ValueError, match="until must be one of"):
        run_session(opened, tmp_path / "out", until="lunch")
