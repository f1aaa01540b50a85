"""Calibrations of laboratories and of structure from motion, and files for other tools, against other formulas.

Every sample is written from a camera's own numbers as its tool documents them, and every point must fall on the pixel
that the tool's own formula gives, to a millionth of a pixel.
"""

from __future__ import annotations

import io
import json
import pickle
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from foreign_rigs import (
    MM,
    SIZES,
    Lens,
    colmap_model,
    humaneva,
    opencap_values,
    opensfm,
    project,
    rig_of,
    truth,
)
from numpy.typing import NDArray
from small_session import mocap

from mocap.data import CameraRig
from mocap.errors import MocapError
from mocap.io.calibration import FORMATS, find_calibration, read_calibration, write_rig

Array = NDArray[np.float64]
PX = 1e-6
POINTS = np.random.default_rng(5).uniform((-0.8, -0.8, 0.1), (0.8, 0.8, 1.9), (40, 3))


def assert_projects(
    rig: CameraRig, lenses: list[Lens], points: Array = POINTS, moved: Array | None = None
) -> None:
    """moved : the same points in the world of the file, where it is another."""
    assert len(rig) == len(lenses)
    for camera, lens in zip(rig, lenses, strict=True):
        expected = project(lens, points if moved is None else moved)
        np.testing.assert_allclose(camera.project(points)[0], expected, rtol=0, atol=PX, err_msg=camera.name)


def test_opencap_pickles_of_a_session(tmp_path: Path) -> None:
    # The board hangs on the wall: its x points to the right, its y down, its z into the wall.
    from_board = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    lenses = truth("k1 k2 p1 p2 k3")
    for k, lens in enumerate(lenses):
        folder = tmp_path / "Videos" / f"Cam{k}"
        folder.mkdir(parents=True)
        values = opencap_values(lens, from_board)
        (folder / "cameraIntrinsicsExtrinsics.pickle").write_bytes(pickle.dumps(values, protocol=2 + k))
    found = read_calibration(tmp_path)
    assert (found.format, found.units) == ("opencap", "mm")
    assert found.rig.names == ("Cam0", "Cam1", "Cam2")
    assert any("-y points up" in note for note in found.notes)
    assert_projects(found.rig, lenses)


class Evil:
    """What a pickle can do."""

    def __reduce__(self) -> tuple[object, ...]:
        return (exec, ("raise SystemExit(3)",))


@pytest.mark.parametrize(
    "value",
    [
        Evil(),
        {"intrinsicMat": Evil()},
        {"intrinsicMat": np.array([Evil()], dtype=object)},
        {"rotation": np.zeros(20_000)},
        {"rotation": 1 + 2j},
        [1, 2],
        {"intrinsicMat": np.eye(3)},
        {"intrinsicMat": "x", "distortion": [], "imageSize": [1, 2], "rotation": 0, "translation": None},
    ],
)
@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
def test_pickles_of_anything_else_are_refused_and_not_run(
    value: object, protocol: int, tmp_path: Path
) -> None:
    path = tmp_path / "cam.pickle"
    path.write_bytes(pickle.dumps(value, protocol=protocol))
    with pytest.raises(MocapError):
        read_calibration(path)


def test_a_pickle_of_the_oldest_protocol_with_a_wrong_escape(tmp_path: Path) -> None:
    (tmp_path / "cam.pickle").write_bytes(b"(dp0\nS'\\\x8b'\np1\ns.")
    with pytest.raises(MocapError):
        read_calibration(tmp_path / "cam.pickle")


def test_a_pickle_that_grows_without_end_is_refused(tmp_path: Path) -> None:
    grown: list[object] = [0]
    for _ in range(60):
        grown = [grown, grown]
    (tmp_path / "cam.pickle").write_bytes(pickle.dumps(grown))
    with pytest.raises(MocapError, match="without end"):
        read_calibration(tmp_path / "cam.pickle")


def test_humaneva(tmp_path: Path) -> None:
    lenses = truth("k1 k2 p1 p2 k3")
    for lens, name in zip(lenses, ("BW1", "C1", "C2"), strict=True):
        (tmp_path / f"{name}.cal").write_text(humaneva(lens), encoding="utf-8")
    found = read_calibration(tmp_path)
    assert found.rig.names == ("BW1", "C1", "C2")
    assert found.guessed_sizes == set(found.rig.names)
    assert_projects(found.rig, lenses)


def test_biocv(tmp_path: Path) -> None:
    lenses = truth("k1 k2 p1 p2 k3")
    for lens, name in zip(lenses, ("00", "01", "02"), strict=True):
        rows = [str(lens.size[0]), str(lens.size[1]), *(" ".join(map(repr, r)) for r in lens.K.tolist()), ""]
        pose = np.column_stack([lens.R, MM * lens.t])
        rows += [*(" ".join(map(repr, r)) for r in pose.tolist()), "0 0 0 1", ""]
        rows.append(" ".join(map(repr, lens.dist.tolist())))
        (tmp_path / f"{name}.mp4.calib").write_text("\n".join(rows) + "\n", encoding="utf-8")
    found = read_calibration(tmp_path)
    assert [c.size for c in found.rig] == list(SIZES)
    assert_projects(found.rig, lenses)


def test_qualisys_leaves_out_cameras_for_markers(tmp_path: Path) -> None:
    lenses = truth("k1 k2 p1 p2")
    left, top = 8, 4
    cameras = ['<camera serial="9" model="Miqus M3"/>']
    for k, lens in enumerate(lenses):
        # Axes of the camera with y and z the other way round, by rows, and its place.
        own = np.diag([1.0, -1, -1]) @ lens.R
        turn = " ".join(f'r{i + 1}{j + 1}="{float(own[i, j])!r}"' for i in range(3) for j in range(3))
        x, y, z = (MM * -lens.R.T @ lens.t).tolist()
        right, bottom = left + lens.size[0] - 1, top + lens.size[1] - 1
        shifted = lens.K + np.array([[0, 0, left], [0, 0, top], [0, 0, 0]])
        fx, cx, fy, cy = (64 * shifted[[0, 0, 1, 1], [0, 2, 1, 2]]).tolist()
        k1, k2, p1, p2 = lens.dist.tolist()
        cameras.append(
            f'<camera serial="cam{k}" model="Miqus Video" viewrotation="0">'
            f'<fov_video left="{left}" top="{top}" right="{right}" bottom="{bottom}"/>'
            f'<transform x="{x!r}" y="{y!r}" z="{z!r}" {turn}/>'
            f'<intrinsic focalLengthU="{fx!r}" focalLengthV="{fy!r}" centerPointU="{cx!r}" centerPointV="{cy!r}" '
            f'radialDistortion1="{k1!r}" radialDistortion2="{k2!r}" tangentalDistortion1="{p1!r}" '
            f'tangentalDistortion2="{p2!r}"/></camera>'
        )
    text = f"<?xml version='1.0' encoding='ASCII'?>\n<calibration><cameras>{''.join(cameras)}</cameras></calibration>"
    (tmp_path / "Calib.qca.txt").write_text(
        text.replace("np.float64(", "").replace(")", ""), encoding="utf-8"
    )
    found = read_calibration(find_calibration(tmp_path))
    assert found.rig.names == ("cam0", "cam1", "cam2")
    assert any("9 films no video" in note for note in found.notes)
    assert_projects(found.rig, lenses)


def test_vicon(tmp_path: Path) -> None:
    lenses = truth("k1 k2 0 0 k3")
    cameras = ['<Camera DEVICEID="1" TYPE="Marker"/>']
    for k, lens in enumerate(lenses):
        lens.K[1, 1] = lens.K[0, 0] / 1.01
        quaternion = " ".join(repr(float(v)) for v in lens.quaternion_xyzw)
        place = " ".join(repr(float(v)) for v in MM * -lens.R.T @ lens.t)
        k1, k2, _, _, k3 = lens.dist.tolist()
        focal, cx, cy = lens.K[[0, 0, 1], [0, 2, 2]].tolist()
        cameras.append(
            f'<Camera DEVICEID="{100 + k}" TYPE="VIDEO:Vue" PIXEL_ASPECT_RATIO="1.01" '
            f'SENSOR_SIZE="{lens.size[0]} {lens.size[1]}"><KeyFrames><KeyFrame FOCAL_LENGTH="{focal!r}" '
            f'PRINCIPAL_POINT="{cx!r} {cy!r}" ORIENTATION="{quaternion}" POSITION="{place}" '
            f'VICON_RADIAL2="ViconRadial2 1 2 {k1!r} {k2!r} {k3!r}"/></KeyFrames></Camera>'
        )
    text = f"<Cameras>{''.join(cameras)}</Cameras>"
    (tmp_path / "take.xcp").write_text(text, encoding="utf-8")
    found = read_calibration(find_calibration(tmp_path))
    assert found.rig.names == ("100", "101", "102")
    assert_projects(found.rig, lenses)


@pytest.mark.parametrize("form", ["text", "binary"])
@pytest.mark.parametrize(
    ("model", "words"),
    [
        ("SIMPLE_PINHOLE", ""),
        ("PINHOLE", ""),
        ("SIMPLE_RADIAL", "k1"),
        ("RADIAL", "k1 k2"),
        ("OPENCV", "k1 k2 p1 p2"),
        ("FULL_OPENCV", "k1 k2 p1 p2 k3 k4 k5 k6"),
        ("OPENCV_FISHEYE", "fisheye k1 k2 k3 k4"),
        ("RADIAL_FISHEYE", "fisheye k1 k2"),
        ("SIMPLE_RADIAL_FISHEYE", "fisheye k1"),
    ],
)
def test_colmap(model: str, words: str, form: str, tmp_path: Path) -> None:
    lenses = truth(words, square=not model.startswith(("PIN", "OPEN", "FULL")))
    colmap_model(tmp_path, lenses, model, is_binary=form == "binary")
    found = read_calibration(tmp_path)
    assert found.rig.names == ("cam_0", "cam_1", "cam_2")
    assert "neither scale nor floor" in found.warnings[0]
    assert_projects(found.rig, lenses)


@pytest.mark.parametrize("kind", ["perspective", "brown", "fisheye", "fisheye_opencv"])
def test_opensfm(kind: str, tmp_path: Path) -> None:
    words = {"perspective": "k1 k2", "brown": "k1 k2 p1 p2 k3", "fisheye": "fisheye k1 k2"}
    lenses = truth(words.get(kind, "fisheye k1 k2 k3 k4"), square=kind in ("perspective", "fisheye"))
    if kind in ("perspective", "fisheye"):
        for lens in lenses:
            lens.K[:2, 2] = (np.array(lens.size) - 1) / 2
    small = {"cameras": {}, "shots": {}}
    (tmp_path / "reconstruction.json").write_text(
        json.dumps([small, opensfm(lenses, kind)]), encoding="utf-8"
    )
    found = read_calibration(find_calibration(tmp_path))
    assert found.rig.names == ("cam_0", "cam_1", "cam_2")
    assert_projects(found.rig, lenses)


@pytest.mark.parametrize("form", FORMATS)
def test_what_is_written_for_others_comes_back(form: str, tmp_path: Path) -> None:
    lenses = truth("k1 k2 p1 p2")
    rig = rig_of(lenses)
    path = tmp_path / ("rig" if form == "easymocap" else "rig.toml")
    if form in ("opencv", "panoptic"):
        path = path.with_suffix(".yml" if form == "opencv" else ".json")
    written = write_rig(path, rig, form)
    assert all(file.is_file() for file in written)
    found = read_calibration(written[0])
    assert found.format in (form, "anipose")
    assert found.rig.names == rig.names
    assert [c.size for c in found.rig] == [c.size for c in rig]
    assert_projects(found.rig, lenses)


def test_lenses_that_a_format_has_no_words_for(tmp_path: Path) -> None:
    fisheye, many = (rig_of(truth(words)) for words in ("fisheye k1 k2 k3 k4", "k1 k2 p1 p2 k3"))
    for form in ("pose2sim", "easymocap", "panoptic"):
        with pytest.raises(MocapError, match="no words for a fisheye lens"):
            write_rig(tmp_path / "a.toml", fisheye, form)
    with pytest.raises(MocapError, match="more than 4 distortion numbers"):
        write_rig(tmp_path / "a.toml", many, "pose2sim")
    for form in ("anipose", "caliscope", "opencv"):
        path = tmp_path / f"{form}.{'yml' if form == 'opencv' else 'toml'}"
        write_rig(path, fisheye, form)
        assert all(camera.is_fisheye for camera in read_calibration(path).rig)


def test_the_command_converts_both_ways(tmp_path: Path) -> None:
    lenses = truth("k1 k2 p1 p2")
    write_rig(tmp_path / "own.toml", rig_of(lenses), "mocap")
    done = mocap("convert-calibration", tmp_path / "own.toml", "-o", tmp_path / "p.json", "--to", "panoptic")
    assert done.code == 0, done.err
    back = mocap("convert-calibration", tmp_path / "p.json", "-o", tmp_path / "back.toml")
    assert back.code == 0, back.err
    assert_projects(read_calibration(tmp_path / "back.toml").rig, lenses)
    wrong = mocap("convert-calibration", tmp_path / "own.toml", "-o", tmp_path / "x", "--to", "panoptik")
    assert wrong.code == 2
    assert "panoptic" in wrong.err


Change = Callable[[Path], object]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: (p / "images.txt").write_text("1 1 0 0 0 0 0 1 9 a.png\n\n"), "is not in cameras.txt"),
        (lambda p: (p / "images.txt").write_text("1 0 0 0 0 0 0 1 1 a.png\n\n"), "no quaternion"),
        (lambda p: (p / "images.txt").write_text("1 1 0 0\n\n"), "cannot read the line"),
        (lambda p: (p / "cameras.txt").write_text("1 FOV 64 48 30 32 24 0.1\n"), "no like in OpenCV"),
        (lambda p: (p / "cameras.txt").write_text("1 OPENCV 64 48 30\n"), "numbers, expected 8"),
        (lambda p: (p / "cameras.txt").write_text("1 OPENCV 64 x 30\n"), "no number"),
        (lambda p: (p / "cameras.txt").unlink(), "No such file"),
    ],
)
def test_models_of_colmap_that_make_no_sense(change: Change, words: str, tmp_path: Path) -> None:
    colmap_model(tmp_path, truth("k1 k2 p1 p2"), "OPENCV", is_binary=False)
    change(tmp_path)
    with pytest.raises(MocapError, match=words):
        read_calibration(tmp_path)


def test_binary_models_that_were_cut_off(tmp_path: Path) -> None:
    colmap_model(tmp_path, truth("k1 k2 p1 p2"), "OPENCV", is_binary=True)
    whole = (tmp_path / "images.bin").read_bytes()
    for data in (whole[:-9], whole[:8], b"", struct.pack("<Q", 2**60)):
        (tmp_path / "images.bin").write_bytes(data)
        with pytest.raises(MocapError, match="too early"):
            read_calibration(tmp_path)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.xcp", '<!DOCTYPE x [<!ENTITY a "b">]><Cameras/>', "entities"),
        ("a.xcp", "<Cameras>", "no XML"),
        ("a.xcp", "<Cameras/>", "no camera"),
        (
            "a.xcp",
            '<Cameras><Camera DEVICEID="1"><KeyFrames><KeyFrame/></KeyFrames></Camera></Cameras>',
            "FOCAL_LENGTH",
        ),
        ("a.qca.txt", "<calibration><cameras><camera/></cameras></calibration>", "fov_video is missing"),
        ("a.cal", "1 2 3", "3 numbers, expected 22"),
        ("a.cal", "1 2 x", "no number"),
        ("a.calib", "640\n480\n", "expected width, height"),
        ("reconstruction.json", '[{"shots": {"a": 3}, "cameras": {}}]', "no camera of the file"),
        ("reconstruction.json", '[{"shots": []}]', "no cameras"),
        ("a.pickle", "not a pickle", "pickle"),
    ],
)
def test_files_that_make_no_sense(name: str, text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(MocapError, match=words):
        read_calibration(tmp_path / name)


def test_scalars_and_orders_of_bytes_in_pickles(tmp_path: Path) -> None:
    lens = truth("k1 k2 p1 p2 k3")[0]
    values = opencap_values(lens, np.eye(3))
    values["rotation"] = np.asfortranarray(values["rotation"]).astype(">f8")
    values["imageSize"] = [np.int64(lens.size[1]), np.float32(lens.size[0])]
    buffer = io.BytesIO()
    pickle.Pickler(buffer, protocol=3).dump(values)
    (tmp_path / "cam.pkl").write_bytes(buffer.getvalue())
    camera = read_calibration(tmp_path / "cam.pkl", up="z").rig[0]
    np.testing.assert_allclose(camera.R, lens.R, atol=1e-12)
    assert camera.size == lens.size
