"""`mocap eval` on files of any tool: the same motion scores the same in every format, and what was assumed is said."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_session import mocap

from mocap.compare import CompareOptions, compare, evaluate, write_page
from mocap.compare.hulls import LIMBS
from mocap.data import LANDMARKS, Camera, CameraRig, Motion, Tracks, VoxelGrid
from mocap.errors import MocapError
from mocap.io.calibration import write_calibration
from mocap.io.formats import write_c3d, write_trc
from mocap.io.poses import SideMap
from mocap.io.store import StageStore
from mocap.io.tables import write_landmarks_csv, write_tracks_csv

FPS = 25.0
T = 50
REST = {
    "pelvis": (0, 0, 0.95), "neck": (0, 0, 1.45), "head": (0, 0, 1.75),
    "left_shoulder": (0, 0.2, 1.42), "left_elbow": (0.05, 0.25, 1.15), "left_wrist": (0.2, 0.25, 0.95),
    "right_shoulder": (0, -0.2, 1.42), "right_elbow": (0.05, -0.25, 1.15), "right_wrist": (0.1, -0.25, 0.9),
    "left_hip": (0, 0.1, 0.95), "left_knee": (0.1, 0.1, 0.5), "left_ankle": (0.05, 0.1, 0.1),
    "right_hip": (0, -0.1, 0.95), "right_knee": (0.05, -0.1, 0.5), "right_ankle": (-0.1, -0.1, 0.1),
}  # fmt: skip


def walker(person: int = 1, *, fps: float = FPS, n: int = T, x: float = 0.0, noise: float = 0.0) -> Motion:
    """A body that walks along y at 1.2 m/s and turns; the same motion at every frame rate."""
    frames = np.arange(n)
    time_s = frames / fps
    rest = np.array([REST[name] for name in LANDMARKS], dtype=np.float64)
    turn = Rotation.from_rotvec(0.4 * time_s[:, None] * np.array([0, 0, 1])).as_matrix()
    landmarks = np.einsum("tij,mj->tmi", turn, rest) + 1.2 * time_s[:, None, None] * np.array([0, 1, 0])
    landmarks += np.random.default_rng(person).normal(0, noise, landmarks.shape) + np.array([x, 0, 0])
    return Motion(person, frames, time_s, landmarks)


def wide(path: Path, m: Motion, names: dict[str, str], factor: float = 1.0, first: int = 0) -> Path:
    """A wide CSV with some of the landmarks under other names."""
    lines = ["frame,time," + ",".join(f"{n}_{a}" for n in names for a in "xyz")]
    for i, frame in enumerate(m.frames):
        row = factor * m.landmarks[i][[LANDMARKS.index(n) for n in names.values()]].ravel()
        cells = [f"{v:.6f}" if np.isfinite(v) else "" for v in row]
        lines.append(",".join([str(frame + first), f"{m.time_s[i]:.6f}", *cells]))
    path.write_text("\n".join(lines) + "\n")
    return path


OPENPOSE = {
    f"{side[0].upper()}{limb.capitalize()}": f"{side}_{limb}"
    for side in ("left", "right")
    for limb in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
}


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    path = tmp_path / "truth.csv"
    write_landmarks_csv(path, [walker()])
    return path


def test_one_motion_scores_the_same_in_every_format(tmp_path: Path, truth: Path) -> None:
    pytest.importorskip("ezc3d")
    m = walker(noise=0.03)
    write_trc(tmp_path / "person_1.trc", m, FPS)
    write_c3d(tmp_path / "person_1.c3d", m, FPS)
    write_landmarks_csv(tmp_path / "own.csv", [m])
    table = wide(tmp_path / "wide.csv", m, {n: n for n in LANDMARKS}, 1000.0)
    scored = [
        compare(path, truth).scores
        for path in (tmp_path / "own.csv", tmp_path / "person_1.trc", tmp_path / "person_1.c3d", table)
    ]
    assert scored[0]["mean_error_mm"] > 40
    for s in scored[1:]:
        for key in ("mean_error_mm", "mmtp_mm", "mmta_percent", "angle_mean_deg", "mota_percent"):
            assert s[key] == pytest.approx(scored[0][key], rel=1e-4), key
    assert any("taken as mm by the size of the body" in n for n in scored[3]["notes"])
    assert [s["estimate"]["format"] for s in scored] == ["landmarks.csv", "TRC", "C3D", "wide CSV"]
    assert set(evaluate([], [], None, None)) <= set(scored[0])
    assert json.dumps(scored[0], allow_nan=False)


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1000.0), ("cm", 100.0)])
@pytest.mark.parametrize("side", ["estimate", "truth"])
def test_a_wrong_unit_is_named_with_the_option_that_helps(
    tmp_path: Path, truth: Path, side: str, unit: str, factor: float
) -> None:
    wrong = tmp_path / "wrong.csv"
    m = walker()
    write_landmarks_csv(wrong, [replace(m, landmarks=factor * m.landmarks)])
    paths = (wrong, truth) if side == "estimate" else (truth, wrong)
    s = compare(*paths).scores
    assert f"the {side} looks like {unit} read as m" in s["unit_warning"]
    assert f"Remedy: --{side}-unit {unit}" in s["unit_warning"]
    assert s["warnings"] == [s["unit_warning"]]
    assert s["mmta_percent"] == 0.0
    healed = compare(*paths, CompareOptions(**{side: SideMap(unit=unit)})).scores
    assert healed["unit_warning"] is None
    assert healed["mean_error_mm"] == pytest.approx(0.0, abs=1e-2)


def test_rates_meet_at_the_times_of_the_slower(tmp_path: Path, truth: Path) -> None:
    """Linear interpolation of a turning body at 100 frames/s is off by a twentieth of a millimetre."""
    for fps, n in ((100.0, 200), (12.5, 25), (60.0, 120)):
        write_landmarks_csv(tmp_path / "e.csv", [walker(fps=fps, n=n)])
        s = compare(tmp_path / "e.csv", truth).scores
        assert s["mean_error_mm"] < 0.5
        assert s["mmta_percent"] == 100.0
        faster = "estimate" if fps > FPS else "truth"
        assert any(f"the {faster} is interpolated" in note for note in s["notes"])
        assert s["frames"] == (T if fps > FPS else 25)
    told = compare(truth, truth, CompareOptions(estimate=SideMap(fps=50.0))).scores
    assert told["mean_error_mm"] > 100


def test_holes_of_the_faster_side_stay_holes(tmp_path: Path, truth: Path) -> None:
    m = walker(fps=100.0, n=200)
    keep = np.r_[0:40, 80:200]
    write_landmarks_csv(tmp_path / "e.csv", [Motion(1, m.frames[keep], m.time_s[keep], m.landmarks[keep])])
    s = compare(tmp_path / "e.csv", truth).scores
    assert s["mean_error_mm"] < 0.5
    assert s["landmarks_missing"] == 10 * 15 == 15 * (T - round(T * s["mmta_percent"] / 100))


@pytest.mark.parametrize("shift", [-4, 1, 9])
def test_files_that_count_differently_are_found_out(tmp_path: Path, truth: Path, shift: int) -> None:
    m = walker()
    m = Motion(1, m.frames + 10 + shift, m.time_s, m.landmarks)
    write_landmarks_csv(tmp_path / "e.csv", [m])
    write_landmarks_csv(truth, [replace(walker(), frames=walker().frames + 10)])
    s = compare(tmp_path / "e.csv", truth).scores
    (warning,) = s["warnings"]
    assert f"Remedy: if they do, --frame-offset {-shift}" in warning
    assert s["mean_error_mm"] > 20
    for options in (CompareOptions(frame_offset=-shift), CompareOptions(time_offset_s=-shift / FPS)):
        healed = compare(tmp_path / "e.csv", truth, options).scores
        assert healed["mean_error_mm"] == pytest.approx(0.0, abs=1e-6)
        assert healed["warnings"] == []
        assert f"{-shift:+d} frames added to the estimate's frame numbers" in healed["notes"]
        assert healed["frames"] == T


def test_no_common_frame_is_one_clear_error(tmp_path: Path, truth: Path) -> None:
    m = walker()
    write_landmarks_csv(tmp_path / "e.csv", [replace(m, frames=m.frames + 1000)])
    with pytest.raises(MocapError) as caught:
        compare(tmp_path / "e.csv", truth)
    assert "no frame in common: frames 1000 to 1049 of e.csv, 0 to 49 of truth.csv" in str(caught.value)
    assert "--frame-offset" in caught.value.remedy


def test_different_lengths_are_said_and_only_common_frames_count(tmp_path: Path, truth: Path) -> None:
    m = walker(n=30)
    write_landmarks_csv(tmp_path / "e.csv", [Motion(1, m.frames[8:], m.time_s[8:], m.landmarks[8:])])
    s = compare(tmp_path / "e.csv", truth).scores
    assert (s["frames"], s["mmta_percent"]) == (22, 100.0)
    assert "22 common frames are scored; the estimate has 22, the truth 50" in s["notes"]


def test_what_one_skeleton_lacks_is_left_out_and_said(tmp_path: Path, truth: Path) -> None:
    table = wide(tmp_path / "e.csv", walker(), OPENPOSE, 1000.0)
    s = compare(table, truth).scores
    assert s["estimate"]["skeleton"] == "OpenPose, Pose2Sim, Panoptic"
    # The neck falls back on the middle of the shoulders, 3 cm below it here.
    assert s["landmarks_left_out"] == ["head"]
    assert s["per_landmark_mm"]["head"] is None
    assert s["per_landmark_mm"]["neck"] == pytest.approx(30.0, abs=0.1)
    assert s["per_landmark_mm"]["left_knee"] == pytest.approx(0.0, abs=0.01)
    assert s["mmta_percent"] == 100.0
    assert "scored without head: one side does not have them" in s["notes"]


def test_holes_count_as_missed_in_the_estimate_and_not_at_all_in_the_truth(
    tmp_path: Path, truth: Path
) -> None:
    m = walker()
    landmarks = m.landmarks.copy()
    landmarks[10:20, 3] = np.nan
    write_landmarks_csv(tmp_path / "e.csv", [replace(m, landmarks=landmarks)])
    s = compare(tmp_path / "e.csv", truth).scores
    assert (s["landmarks_missing"], s["mean_error_mm"]) == (10, pytest.approx(0.0, abs=1e-9))
    other = compare(truth, tmp_path / "e.csv").scores
    assert (other["landmarks_missing"], other["landmarks_scored"]) == (0, 15 * T - 10)
    assert other["mmta_percent"] == 100.0


def test_no_common_landmark_is_one_clear_error(tmp_path: Path) -> None:
    legs = {n: s for n, s in OPENPOSE.items() if s.endswith(("hip", "knee", "ankle"))}
    arms = {n: s for n, s in OPENPOSE.items() if s.endswith(("elbow", "wrist"))}
    a = wide(tmp_path / "a.csv", walker(), legs)
    b = wide(tmp_path / "b.csv", walker(), arms)
    with pytest.raises(MocapError, match=r"no landmark in common: left_ankle.* against left_elbow"):
        compare(a, b)


def test_wrong_axes_and_another_world_are_warned_about(tmp_path: Path, truth: Path) -> None:
    write_trc(tmp_path / "person_1.trc", walker(), FPS)
    s = compare(tmp_path / "person_1.trc", truth, CompareOptions(estimate=SideMap(up="z"))).scores
    assert "the bodies of the estimate stand along y after reading z as up" in s["warnings"][0]
    assert "--estimate-up" in s["warnings"][0]
    m = walker()
    R = Rotation.from_euler("z", 1.0).as_matrix()
    write_landmarks_csv(tmp_path / "e.csv", [replace(m, landmarks=m.landmarks @ R.T + [2.0, 0.0, 0.0])])
    s = compare(tmp_path / "e.csv", truth).scores
    assert "different world frames" in s["warnings"][-1]
    assert s["aligned"]["rigid"]["mean_error_mm"] == pytest.approx(0.0, abs=1e-2)


def test_upside_down_is_seen_too(tmp_path: Path, truth: Path) -> None:
    s = compare(truth, truth, CompareOptions(truth=SideMap(up="-z"))).scores
    assert any("stand along -z" in w for w in s["warnings"])
    assert compare(truth, truth).scores["warnings"] == []


def test_a_session_before_its_run_is_warned_about(tmp_path: Path) -> None:
    session, run = tmp_path / "session", tmp_path / "run"
    for folder in (session / "truth", run):
        folder.mkdir(parents=True)
        write_landmarks_csv(folder / "landmarks.csv", [walker()])
    assert compare(session, session / "truth").scores["warnings"] == []  # one truth against another is meant
    (run / "run.json").write_text('{"frames": [0, 30]}')
    assert compare(run, session).scores["warnings"] == []
    (warning,) = compare(session, run).scores["warnings"]
    assert "Remedy: give the run first" in warning


def test_tracks_come_from_the_landmarks_where_there_is_no_table(tmp_path: Path) -> None:
    people = [walker(1), walker(2, x=2.0)]
    write_landmarks_csv(tmp_path / "t.csv", people)
    swapped = [
        Motion(p, m.frames, m.time_s, np.concatenate([m.landmarks[:20], o.landmarks[20:]]))
        for p, m, o in ((7, people[0], people[1]), (5, people[1], people[0]))
    ]
    write_landmarks_csv(tmp_path / "e.csv", swapped)
    s = compare(tmp_path / "e.csv", tmp_path / "t.csv").scores
    assert (s["misses"], s["false_positives"], s["mismatches"]) == (0, 0, 2)
    assert any(n.startswith("tracks are the mean of pelvis, neck") for n in s["notes"])
    same = compare(tmp_path / "t.csv", tmp_path / "t.csv").scores
    assert (same["mota_percent"], same["hota_percent"]) == (100.0, 100.0)


def test_folders_of_ours_keep_their_own_tracks_and_frames(tmp_path: Path) -> None:
    session, out = tmp_path / "session", tmp_path / "out"
    for folder in (session / "truth", out):
        folder.mkdir(parents=True)
    write_landmarks_csv(session / "truth" / "landmarks.csv", [walker()])
    m = walker()
    found = Motion(3, m.frames[5:20], m.time_s[5:20], m.landmarks[5:20], np.full((15, 15, 3), 0.02))
    write_landmarks_csv(out / "landmarks.csv", [found])
    (out / "run.json").write_text('{"frames": [0, 30]}')
    for folder in (session / "truth", out):
        rows = np.arange(T), np.ones(T, dtype=np.int64), np.arange(T) / FPS, np.zeros((T, 3))
        write_tracks_csv(folder / "tracks.csv", Tracks(*rows))
    s = compare(out, session).scores
    assert (s["frames"], s["mmta_percent"], s["mota_percent"]) == (30, 50.0, 100.0)
    assert s["coverage_90_percent"] == 100.0
    assert s["reliability"]["landmarks"] == 15 * 15
    back = compare(session, out).scores
    assert back["frames"] == 15
    shifted = compare(out, session, CompareOptions(frame_offset=20)).scores
    assert shifted["frames"] == 30
    assert shifted["mean_error_mm"] > 500


def test_actions_and_cameras(tmp_path: Path, truth: Path) -> None:
    K = np.array([[300.0, 0, 160], [0, 300.0, 120], [0, 0, 1]])
    R = np.array([[0.0, 1, 0], [0, 0, -1], [-1, 0, 0]])  # looks along -x
    rig = CameraRig(
        tuple(
            Camera(n, (320, 240), K, np.zeros(5), R, np.array([0, 1.0, z]))
            for n, z in (("a", 6.0), ("b", 9.0))
        )
    )
    write_calibration(tmp_path / "rig.toml", rig)
    m = walker()
    write_landmarks_csv(tmp_path / "e.csv", [replace(m, landmarks=m.landmarks + np.array([0.0, 0.0, 0.05]))])
    (tmp_path / "a.csv").write_text("first_frame,last_frame,action\n0,9,stand\n10,49,walk\n")
    options = CompareOptions(
        actions_path=tmp_path / "a.csv", cameras_path=tmp_path / "rig.toml", epsilon_px=2.0
    )
    s = compare(tmp_path / "e.csv", truth, options).scores
    assert {k: v["frames"] for k, v in s["per_action"].items()} == {"stand": 10, "walk": 40}
    image = s["image"]
    assert image["per_camera"]["a"]["mean_error_px"] > 1.3 * image["per_camera"]["b"]["mean_error_px"]
    # 300 px times 50 mm over 5.5 to 6.5 m, and over 8.5 to 9.5 m
    assert 300 * 0.05 / 6.6 < image["per_camera"]["a"]["mean_error_px"] < 300 * 0.05 / 5.4
    assert image["per_camera"]["b"]["mmta_percent"] == 100.0
    assert image["per_camera"]["a"]["mmta_percent"] == 0.0


def test_limbs_without_data_are_compared_with_what_the_run_said(tmp_path: Path) -> None:
    """The hull lacks the left forearm in frames 0 to 3 and the right shank in 4 and 5; the run says 0 to 2 and 6."""
    session, out = tmp_path / "session", tmp_path / "out"
    m = walker(n=8)
    for folder in (session / "truth", out):
        folder.mkdir(parents=True)
    write_landmarks_csv(session / "truth" / "landmarks.csv", [m])
    observed = np.ones((8, 15), dtype=np.bool_)
    observed[[0, 1, 2, 6], LANDMARKS.index("left_wrist")] = False
    write_landmarks_csv(out / "landmarks.csv", [replace(m, observed=observed)])
    lower = np.array([-2.0, -2.0, -0.5])
    grid = VoxelGrid(lower, (40, 50, 30), 0.1)
    ends = [[LANDMARKS.index(n) for n in limb] for limb in LIMBS]
    attrs = {"origin_m": lower.tolist(), "shape": [40, 50, 30], "voxel_size_m": 0.1}
    with StageStore(out / "store.zarr").writer("carve", "key", attrs) as writer:
        for frame in range(8):
            lost = {3: ("left_elbow", "left_wrist"), 5: ("right_knee", "right_ankle")}[3 if frame < 4 else 5]
            along = np.linspace(0.05, 0.95, 60)[:, None]
            points = [
                (1 - along) * m.landmarks[frame, a] + along * m.landmarks[frame, b]
                for limb, (a, b) in zip(LIMBS, ends, strict=True)
                if limb != lost or frame > 5
            ]
            voxels = np.unique(grid.voxels_of(np.concatenate(points)))
            if frame <= 5:  # neighbours must not fill what is lost
                hole = m.landmarks[frame, [LANDMARKS.index(n) for n in lost]]
                share = (hole[1] - hole[0]) * np.linspace(0.15, 1.0, 40)[:, None] + hole[0]
                voxels = np.setdiff1d(voxels, grid.voxels_of(share))
            writer.append(frame, voxels=voxels.astype(np.int32))
    found = compare(out, session).scores["lost_limbs"]
    assert (found["n_lost"], found["n_said"]) == (6, 4)
    assert (found["precision"], found["recall"]) == (3 / 4, 3 / 6)
    assert found["f1"] == pytest.approx(2 * 3 / (6 + 4))
    assert compare(out / "landmarks.csv", session).scores["lost_limbs"] is None


# ------------------------------------------------------------------------------------------------ the command, the page


def test_the_command_prints_a_table_json_and_a_page(tmp_path: Path, truth: Path) -> None:
    m = walker(noise=0.03)
    spread = replace(m, std=np.full_like(m.landmarks, 0.03))
    write_landmarks_csv(tmp_path / "e.csv", [spread])
    (tmp_path / "a.csv").write_text("first_frame,last_frame,action\n0,9,stand & wait\n")
    page = tmp_path / "page.html"
    said = mocap("eval", tmp_path / "e.csv", truth, "--html", page, "--actions", tmp_path / "a.csv")
    assert said.code == 0, said.err
    for words in (
        "MMTA",
        "PCK",
        "Procrustes",
        "Natural epsilon (Lilliefors)",
        "Mean angle error after IK",
        "stand & wait (10 frames)",
        "note:",
    ):
        assert words in said.out
    text = page.read_text(encoding="utf-8")
    assert "default-src 'none'" in text
    assert not re.search(r"(?:src|href)=\"(?!data:|#)", text)
    assert text.count("<figure") == text.count("data:image/png") == 6
    for words in (
        "Epsilon without a parameter",
        "Reliability diagram",
        "stand &amp; wait",
        "mocap eval",
        "prefers-color-scheme",
    ):
        assert words in text
    assert not re.search(r"\bnan\b", re.sub(r'"data:[^"]*"', "", text), re.I)
    as_json = mocap("eval", tmp_path / "e.csv", truth, "--json", "--epsilon", 40)
    assert json.loads(as_json.out)["epsilon_mm"] == 40.0


def test_a_page_of_nothing(tmp_path: Path) -> None:
    """A run that found nobody still gives a page."""
    for name, motions in (("session/truth", [walker()]), ("out", [])):
        (tmp_path / name).mkdir(parents=True)
        write_landmarks_csv(tmp_path / name / "landmarks.csv", motions)
    found = compare(tmp_path / "out", tmp_path / "session")
    assert found.scores["mean_error_mm"] is None
    write_page(tmp_path / "p.html", found)
    assert "Nobody of the truth was found" in (tmp_path / "p.html").read_text(encoding="utf-8")
    with pytest.raises(MocapError, match="page cannot be written"):
        write_page(tmp_path / "no" / "p.html", found)


def test_wrong_options_are_refused(tmp_path: Path, truth: Path) -> None:
    for arguments, words in (
        (("--estimate-unit", "parsec"), ("--estimate-unit is 'parsec'", "m, cm, mm")),
        (("--truth-up", "w"), ("--truth-up is 'w'", "-z")),
        (("--map", tmp_path / "none.toml"), ("none.toml", "cannot be read")),
        (("--actions", tmp_path / "none.csv"), ("none.csv", "cannot be read")),
        (("--cameras", tmp_path / "none.toml"), ("none.toml",)),
    ):
        said = mocap("eval", truth, truth, *arguments)
        assert said.code == 2, said
        assert all(w in said.err for w in words), said.err
        assert "Traceback" not in said.err
    table = wide(tmp_path / "e.csv", walker(), OPENPOSE)
    text = table.read_text().splitlines()
    table.write_text("\n".join(re.sub(r"^(\d+),[^,]*", r"\1,", line) for line in text) + "\n")
    assert compare(table, table).scores["acceleration_error_m_s2"] is None
    with pytest.raises(MocapError, match="a time offset needs a frame rate"):
        compare(table, table, CompareOptions(time_offset_s=0.1))
