"""Public sets: each read from files in its layout into one world, one clock and our landmarks; and bad files."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import public_sets as write
import pytest
from foreign_rigs import Lens
from numpy.typing import NDArray

from mocap.data import LANDMARKS, Motion
from mocap.errors import MissingExtra, MocapError
from mocap.io import open_session
from mocap.io.calibration import read_calibration
from mocap.io.poses import SideMap
from mocap.io.sets import SETS, Imported, human36m, imported, takes_of, write_session
from mocap.io.sets.humaneva import clock_of
from mocap.io.tables import read_landmarks_csv

Array = NDArray[np.float64]

AT = LANDMARKS.index
NEAR_M, NEAR_PX = 1e-5, 1e-3  # files have some ten digits
_HAS_CDFLIB = importlib.util.find_spec("cdflib") is not None


def only_take(name: str, root: Path, side: SideMap | None = None) -> Imported:
    (path,) = takes_of(name, root).values()
    return imported(SETS[name].read(root, path), side)


def assert_same_pictures(found: Imported, rig: list[Lens], places: Array) -> None:
    """Cameras of the session show places (N, 3) m where those that were written show them."""
    assert len(found.rig) == len(rig)
    for camera, lens in zip(found.rig, rig, strict=True):
        assert camera.size == lens.size
        seen, depth = camera.project(places)
        own = places @ lens.R.T + lens.t
        np.testing.assert_allclose(depth, own[:, 2], atol=NEAR_M)
        assert np.isfinite(seen).all()
        x, y = (own[:, :2] / own[:, 2:]).T
        k1, k2, p1, p2, k3 = np.concatenate([lens.dist, np.zeros(5)])[:5]
        r2 = x**2 + y**2
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        u = radial * x + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
        v = radial * y + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
        expected = np.stack([u, v], axis=1) * np.diag(lens.K)[:2] + lens.K[:2, 2]
        np.testing.assert_allclose(seen, expected, atol=NEAR_PX)


def place_of(motion: Motion, landmark: str) -> Array:
    return motion.landmarks[:, AT(landmark)]


def assert_joints(motion: Motion, places: Array, joints: dict[str, list[int]]) -> None:
    """Each landmark is the mean of these joints, and all others are unknown."""
    for landmark in LANDMARKS:
        if landmark in joints:
            np.testing.assert_allclose(
                place_of(motion, landmark), places[:, joints[landmark]].mean(axis=1), atol=NEAR_M
            )
        else:
            assert np.isnan(place_of(motion, landmark)).all()


def limbs(names: tuple[str, ...], left: str, right: str, words: tuple[str, ...]) -> dict[str, list[int]]:
    """Landmark of each limb -> place of its joint among the names."""
    kinds = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    return {
        f"{side}_{kind}": [names.index(word.replace("{s}", prefix))]
        for side, prefix in (("left", left), ("right", right))
        for kind, word in zip(kinds, words, strict=True)
    }


# ----------------------------------------------------------------------------------------------------- one by one


def test_totalcapture(tmp_path: Path) -> None:
    rig, places, names = write.totalcapture(tmp_path / "set")
    found = only_take("totalcapture", tmp_path / "set")
    assert list(takes_of("totalcapture", tmp_path / "set")) == ["s1/acting1"]
    assert found.rig.names == ("cam1", "cam2", "cam3")
    assert_same_pictures(found, rig, places.reshape(-1, 3))
    (motion,) = found.truth
    words = ("{s}Arm", "{s}ForeArm", "{s}Hand", "{s}UpLeg", "{s}Leg", "{s}Foot")
    joints = limbs(names, "Left", "Right", words)
    joints |= {"neck": [names.index("Neck")], "pelvis": joints["left_hip"] + joints["right_hip"]}
    assert_joints(motion, places, joints)
    np.testing.assert_array_equal(motion.frames, np.arange(write.N_PICTURES))
    assert found.fps == 60.0
    assert found.warnings == ()
    assert "the truth has no head" in found.notes


def test_mpi_inf_3dhp(tmp_path: Path) -> None:
    rig, places, names = write.mpi_inf_3dhp(tmp_path / "set")
    found = only_take("mpi-inf-3dhp", tmp_path / "set")
    assert_same_pictures(found, rig, places.reshape(-1, 3))
    (motion,) = found.truth
    words = tuple(f"{{s}}_{kind}" for kind in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle"))
    joints = limbs(names, "left", "right", words)
    joints |= {"neck": [names.index("neck")], "head": [names.index("head_top")]}
    joints["pelvis"] = joints["left_hip"] + joints["right_hip"]
    assert_joints(motion, places, joints)
    assert found.fps == pytest.approx(25.0)  # of the clips: annotations have no clock
    assert found.warnings == ()


HUMAN36M_JOINTS = {
    "pelvis": [1, 6], "neck": [13], "head": [15],
    "left_shoulder": [17], "left_elbow": [18], "left_wrist": [19],
    "right_shoulder": [25], "right_elbow": [26], "right_wrist": [27],
    "left_hip": [6], "left_knee": [7], "left_ankle": [8], "right_hip": [1], "right_knee": [2], "right_ankle": [3],
}  # fmt: skip


def write_cdf(path: Path, pose: Array) -> None:
    from cdflib.cdfwrite import CDF

    file = CDF(path, cdf_spec={"Compressed": 6})
    file.write_var(
        {
            "Variable": "Pose",
            "Data_Type": CDF.CDF_DOUBLE,
            "Num_Elements": 1,
            "Rec_Vary": True,
            "Dim_Sizes": list(pose.shape[1:]),
        },
        var_data=pose,
    )
    file.close()


def assert_human36m(root: Path, rig: list[Lens], places: Array) -> None:
    found = only_take("human36m", root)
    assert list(takes_of("human36m", root)) == ["S9/Walking 1"]
    assert found.rig.names == ("54138969", "55011271", "58860488")  # the fourth has no clip
    assert_same_pictures(found, rig, places.reshape(-1, 3))
    assert_joints(found.truth[0], places, HUMAN36M_JOINTS)
    assert found.fps == 50.0
    assert found.warnings == ()


def test_human36m(tmp_path: Path) -> None:
    pytest.importorskip("cdflib")
    rig, places = write.human36m(tmp_path / "set", write_cdf)
    assert_human36m(tmp_path / "set", rig, places)


def test_human36m_but_for_its_file_format(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    poses: dict[Path, Array] = {}

    def keep(path: Path, pose: Array) -> None:
        path.touch()
        poses[path] = pose

    rig, places = write.human36m(tmp_path / "set", keep)
    monkeypatch.setattr(human36m, "read_in_child", lambda kind, path, *_, **__: (kind, {"Pose": poses[path]}))
    assert_human36m(tmp_path / "set", rig, places)


@pytest.mark.skipif(_HAS_CDFLIB, reason="cdflib is installed")
def test_human36m_without_cdflib(tmp_path: Path) -> None:
    write.human36m(tmp_path / "set", lambda path, _: path.write_bytes(b"cdf"))
    with pytest.raises(MissingExtra, match="needs the package cdflib"):
        only_take("human36m", tmp_path / "set")


def test_panoptic(tmp_path: Path) -> None:
    rig, places = write.panoptic(tmp_path / "set")
    found = only_take("panoptic", tmp_path / "set")
    assert found.rig.names == ("00_00", "00_01", "00_02")  # no VGA
    assert_same_pictures(found, rig, places.reshape(-1, 3))
    first, second = found.truth
    limbs_of = {
        "left_shoulder": [3], "left_elbow": [4], "left_wrist": [5],
        "left_hip": [6], "left_knee": [7], "left_ankle": [8],
        "right_shoulder": [9], "right_elbow": [10], "right_wrist": [11],
        "right_hip": [12], "right_knee": [13], "right_ankle": [14],
    }  # fmt: skip
    joints = {"neck": [0], "pelvis": [6, 12], **limbs_of}
    assert_joints(first, places[0], joints)
    assert_joints(second, places[1, 5:], joints)
    np.testing.assert_array_equal(second.frames, np.arange(5, write.N_PICTURES))
    assert found.fps == 29.97


def test_panoptic_bodies_are_turned_as_their_cameras(tmp_path: Path) -> None:
    """`mocap eval OUT SEQUENCE` scores a run on a Panoptic calibration against the sequence as it is."""
    from mocap.io.formats import read_poses
    from mocap.io.poses import read_motions

    _, places = write.panoptic(tmp_path / "set")
    sequence = tmp_path / "set" / "171204_pose1"
    first, _ = read_motions(read_poses(sequence)).in_metres("cm").motions
    np.testing.assert_allclose(place_of(first, "neck"), places[0, :, 0], atol=NEAR_M)


def test_humaneva(tmp_path: Path) -> None:
    pytest.importorskip("ezc3d")
    rig, places = write.humaneva(tmp_path / "set")
    found = only_take("humaneva", tmp_path / "set")
    names = {camera.name: lens for camera, lens in zip(found.rig, rig, strict=True)}
    assert set(names) == {"C1", "C2", "BW1"}
    rig_of = dict(zip(("C1", "C2", "BW1"), rig, strict=True))
    assert_same_pictures(found, [rig_of[camera.name] for camera in found.rig], places.reshape(-1, 3))
    # Frame 0 is the first picture of C2, two pictures before the first row; a frame is two rows.
    (motion,) = found.truth
    np.testing.assert_array_equal(motion.frames, 2 + np.arange(write.N_PICTURES))
    at = write.PLUG_IN_GAIT.index
    rows = places[::2]
    np.testing.assert_allclose(place_of(motion, "left_elbow"), rows[:, at("LELB")], atol=1e-4)
    wrist = rows[:, [at("RWRA"), at("RWRB")]].mean(axis=1)
    np.testing.assert_allclose(place_of(motion, "right_wrist"), wrist, atol=1e-4)
    assert np.isnan(place_of(motion, "left_hip")).all()
    assert found.fps == pytest.approx(60.0)
    assert found.offset_s == pytest.approx({"C1": 2 / 60, "BW1": 4 / 60})
    assert set(found.empty) == {"C1", "C2", "BW1"}


def test_humaneva_pictures_of_a_session_frame_were_taken_together(tmp_path: Path) -> None:
    pytest.importorskip("ezc3d")
    write.humaneva(tmp_path / "set")
    write_session(only_take("humaneva", tmp_path / "set"), tmp_path / "session", "HumanEva, S1/Walking_1")
    session = open_session(tmp_path / "session")
    first = session.frames.start
    assert first == 4  # BW1 is the last to begin
    shown = {name: int(frames[first]) for name, frames in session.clip_frames.items()}
    assert shown == {"C1": 2, "C2": 4, "BW1": 0}


def test_biocv(tmp_path: Path) -> None:
    pytest.importorskip("ezc3d")
    rig, places = write.biocv(tmp_path / "set")
    found = only_take("biocv", tmp_path / "set")
    assert_same_pictures(found, rig, places.reshape(-1, 3))
    (motion,) = found.truth
    np.testing.assert_array_equal(motion.frames, np.arange(write.N_PICTURES))
    neck = places[:, [write.PLUG_IN_GAIT.index("C7"), write.PLUG_IN_GAIT.index("CLAV")]].mean(axis=1)
    np.testing.assert_allclose(place_of(motion, "neck"), neck, atol=1e-4)
    assert found.fps == 200.0


# --------------------------------------------------------------------------------------------------- the session


def test_session_opens_and_holds_what_is_known_alone(tmp_path: Path) -> None:
    _, places, names = write.totalcapture(tmp_path / "set")
    found = only_take("totalcapture", tmp_path / "set")
    write_session(found, tmp_path / "session", "TotalCapture, s1/acting1")
    session = open_session(tmp_path / "session")
    assert session.fps == 60.0
    assert list(session.frames) == list(range(write.N_PICTURES))
    assert session.rig.names == ("cam1", "cam2", "cam3")
    text = (tmp_path / "session" / "truth" / "landmarks.csv").read_text()
    assert "nan" not in text
    assert ",head," not in text
    (motion,) = read_landmarks_csv(tmp_path / "session" / "truth" / "landmarks.csv")
    np.testing.assert_allclose(place_of(motion, "neck"), places[:, names.index("Neck")], atol=1e-5)
    assert "the truth has no head" in (tmp_path / "session" / "session.toml").read_text()
    assert (tmp_path / "session" / "videos" / "cam1.mp4").is_symlink()


def test_truth_scores_itself(tmp_path: Path) -> None:
    from mocap.compare.comparison import compare

    write.totalcapture(tmp_path / "set")
    write_session(only_take("totalcapture", tmp_path / "set"), tmp_path / "session", "TotalCapture")
    scores = compare(tmp_path / "session" / "truth", tmp_path / "session").scores
    assert scores["mean_error_mm"] == 0.0
    assert scores["landmarks_left_out"] == ["head"]
    assert scores["frames"] == write.N_PICTURES


def test_map_of_the_user_counts_more(tmp_path: Path) -> None:
    _, places, names = write.totalcapture(tmp_path / "set")
    side = SideMap({"head": ("Head",), "neck": ("Spine3", "Neck")}, fps=30.0)
    found = only_take("totalcapture", tmp_path / "set", side)
    assert found.fps == 30.0
    assert_joints(
        found.truth[0],
        places,
        {"head": [names.index("Head")], "neck": [names.index("Spine3"), names.index("Neck")]},
    )


def test_an_axis_of_the_user_turns_cameras_and_truth_together(tmp_path: Path) -> None:
    write.totalcapture(tmp_path / "set")
    usual = only_take("totalcapture", tmp_path / "set")
    with pytest.raises(MocapError, match="below the floor"):  # y down: cameras hang from below
        only_take("totalcapture", tmp_path / "set", SideMap(up="-y"))
    uv = [c.project(place_of(usual.truth[0], "neck"))[0] for c in usual.rig]
    assert all(c.contains(p).all() for c, p in zip(usual.rig, uv, strict=True))


# ------------------------------------------------------------------------------------------------- calibrations alone


def test_calibrations_of_sets_convert(tmp_path: Path) -> None:
    rig, *_ = write.totalcapture(tmp_path / "tc")
    other, *_ = write.mpi_inf_3dhp(tmp_path / "3dhp")
    for path, lenses, form in (
        (tmp_path / "tc" / "calibration.cal", rig, "totalcapture"),
        (tmp_path / "3dhp" / "S2" / "Seq1" / "camera.calibration", other, "skeletool"),
    ):
        found = read_calibration(path)
        assert found.format == form
        for camera, lens in zip(found.rig, lenses, strict=True):
            np.testing.assert_allclose(camera.center, -lens.R.T @ lens.t, atol=NEAR_M)


# ----------------------------------------------------------------------------------------------------- bad input


def damaged(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_truth_of_another_rig_is_doubted(tmp_path: Path) -> None:
    write.totalcapture(tmp_path / "set")
    path = tmp_path / "set" / "s1" / "acting1" / "gt_skel_gbl_pos.txt"
    head, *rows = path.read_text().splitlines()
    moved = np.array([row.split() for row in rows], dtype=float) + np.tile([400.0, 0.0, 0.0], 21)  # inches
    path.write_text("\n".join([head, *(" ".join(map(str, row)) for row in moved)]))
    (warning,) = only_take("totalcapture", tmp_path / "set").warnings
    assert "outside the pictures" in warning


def test_truth_upside_down_is_doubted(tmp_path: Path) -> None:
    write.totalcapture(tmp_path / "set")
    path = tmp_path / "set" / "s1" / "acting1" / "gt_skel_gbl_pos.txt"
    head, *rows = path.read_text().splitlines()
    turned = np.array([row.split() for row in rows], dtype=float) * np.tile([1.0, -1.0, -1.0], 21)
    path.write_text("\n".join([head, *(" ".join(map(str, row)) for row in turned)]))
    assert any("up axis" in warning for warning in only_take("totalcapture", tmp_path / "set").warnings)


def test_truth_above_the_floor_is_doubted(tmp_path: Path) -> None:
    write.totalcapture(tmp_path / "set")
    path = tmp_path / "set" / "s1" / "acting1" / "gt_skel_gbl_pos.txt"
    head, *rows = path.read_text().splitlines()
    raised = np.array([row.split() for row in rows], dtype=float) + np.tile([0.0, 20.0, 0.0], 21)
    path.write_text("\n".join([head, *(" ".join(map(str, row)) for row in raised)]))
    assert any(
        "floor is not z = 0" in warning for warning in only_take("totalcapture", tmp_path / "set").warnings
    )


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("calibration.cal", "3 1\n", "8 1\n", "expected the count of cameras"),
        ("calibration.cal", "0 71 0 127", "0 71 0", "the picture has 3 numbers"),
        ("s1/acting1/gt_skel_gbl_pos.txt", "Hips\t", "", "expected 3 for each of 20 joints"),
    ],
)
def test_damaged_totalcapture(tmp_path: Path, file: str, old: str, new: str, message: str) -> None:
    write.totalcapture(tmp_path / "set")
    damaged(tmp_path / "set" / file, old, new)
    with pytest.raises(MocapError, match=message) as error:
        only_take("totalcapture", tmp_path / "set")
    assert error.value.remedy
    assert error.value.path == tmp_path / "set" / file


def test_annotations_of_another_calibration_are_refused(tmp_path: Path) -> None:
    write.mpi_inf_3dhp(tmp_path / "set")
    path = tmp_path / "set" / "S2" / "Seq1" / "camera.calibration"
    first, second, _ = (line for line in path.read_text().splitlines() if "extrinsic" in line)
    path.write_text(path.read_text().replace(first, "@").replace(second, first).replace("@", second))
    with pytest.raises(MocapError, match="mm apart"):
        only_take("mpi-inf-3dhp", tmp_path / "set")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("Skeletool", "Other", "does not begin with"),
        ("  intrinsic ", "  inner ", "intrinsic is missing"),
        ("name          0", "  sensor  1", "before the first `name`"),
        ("  extrinsic   ", "  extrinsic   1 ", "extrinsic has 17 numbers"),
    ],
)
def test_damaged_skeletool(tmp_path: Path, old: str, new: str, message: str) -> None:
    write.mpi_inf_3dhp(tmp_path / "set")
    damaged(tmp_path / "set" / "S2" / "Seq1" / "camera.calibration", old, new)
    with pytest.raises(MocapError, match=message):
        only_take("mpi-inf-3dhp", tmp_path / "set")


def test_mat_files_that_are_none(tmp_path: Path) -> None:
    write.mpi_inf_3dhp(tmp_path / "set")
    path = tmp_path / "set" / "S2" / "Seq1" / "annot.mat"
    whole = path.read_bytes()
    for content in (b"", b"no MATLAB file", whole[: len(whole) // 2]):
        path.write_bytes(content)
        with pytest.raises(MocapError, match="annotations"):
            only_take("mpi-inf-3dhp", tmp_path / "set")


def test_human36m_metadata_must_be_whole(tmp_path: Path) -> None:
    write.human36m(tmp_path / "set", lambda path, _: path.touch())
    (tmp_path / "set" / "metadata.xml").write_text("<metadata><w0>[1 2 3]</w0></metadata>")
    with pytest.raises(MocapError, match="w0 has 3 numbers, expected 300"):
        only_take("human36m", tmp_path / "set")


def test_clips_that_are_missing(tmp_path: Path) -> None:
    write.totalcapture(tmp_path / "set")
    for k in (2, 3):
        (tmp_path / "set" / "s1" / "acting1" / f"TC_S1_acting1_cam{k}.mp4").unlink()
    with pytest.raises(MocapError, match="clips of cam1, calibrated are cam1, cam2, cam3"):
        only_take("totalcapture", tmp_path / "set")


def test_clip_of_another_size(tmp_path: Path) -> None:
    write.totalcapture(tmp_path / "set")
    damaged(tmp_path / "set" / "calibration.cal", "0 71 0 127", "0 35 0 63")
    with pytest.raises(MocapError, match="128 x 72"):
        only_take("totalcapture", tmp_path / "set")


@pytest.mark.parametrize("text", ["", "1 2", "1 2 three", "1 2 0", "1 nan 2", "1 1 2 4"])
def test_ofs_files_that_are_none(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.ofs").write_text(text)
    with pytest.raises(MocapError, match="three numbers"):
        clock_of(tmp_path / "a.ofs", 120.0)


def test_folders_without_a_recording(tmp_path: Path) -> None:
    for name in SETS:
        with pytest.raises(MocapError, match="holds no recording"):
            takes_of(name, tmp_path)
        with pytest.raises(MocapError, match="no such folder"):
            takes_of(name, tmp_path / "none")


def test_a_filled_folder_is_left_alone(tmp_path: Path) -> None:
    write.totalcapture(tmp_path / "set")
    found = only_take("totalcapture", tmp_path / "set")
    (tmp_path / "session").mkdir()
    (tmp_path / "session" / "mine.txt").write_text("mine")
    with pytest.raises(MocapError, match="not empty"):
        write_session(found, tmp_path / "session", "TotalCapture")
    assert [p.name for p in (tmp_path / "session").iterdir()] == ["mine.txt"]
