"""Calibration readers: every format gives the same cameras; every trap and every bad file is noticed."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap.data import Camera, CameraRig
from mocap.errors import MocapError
from mocap.geometry.rigid import matrix_from_rotation_vector, rotation_vector_from_matrix
from mocap.io.calibration import find_calibration, read_calibration, write_calibration

# Formats that keep a Rodrigues vector or printed digits lose the last bits of R.
SAME = 1e-9
SHARED = Path(__file__).resolve().parents[3] / "shared"


def assert_same_rig(a: CameraRig, b: CameraRig, tolerance: float) -> None:
    assert a.names == b.names
    for x, y in zip(a, b, strict=True):
        assert x.size == y.size
        assert x.is_fisheye == y.is_fisheye
        for key in ("K", "dist", "R", "t"):
            np.testing.assert_allclose(getattr(x, key), getattr(y, key), rtol=0, atol=tolerance, err_msg=key)


def toml_section(camera: Camera, *, scale: float = 1.0, extra: str = "", key: str | None = None) -> str:
    r = rotation_vector_from_matrix(camera.R)
    return (
        f'[{key or camera.name}]\nname = "{camera.name}"\nsize = {list(camera.size)}\n'
        f"matrix = {camera.K.tolist()}\ndistortions = {camera.dist.tolist()}\n"
        f"rotation = {r.tolist()}\ntranslation = {(camera.t * scale).tolist()}\n{extra}\n"
    )


def write_toml(
    path: Path, rig: CameraRig, *, scale: float = 1.0, extra: str = "", metadata: str = ""
) -> Path:
    text = "".join(toml_section(c, scale=scale, extra=extra, key=f"cam_{i}") for i, c in enumerate(rig))
    path.write_text(f"{text}\n[metadata]\n{metadata}\n")
    return path


def test_our_own_file_comes_back_bit_for_bit(tmp_path: Path, rig: CameraRig) -> None:
    write_calibration(tmp_path / "c.toml", rig, metadata={"rms_px": 0.25, "made by": 'a "test" \\ äöü'})
    found = read_calibration(tmp_path / "c.toml")
    assert_same_rig(found.rig, rig, 0.0)
    assert (found.format, found.units, found.rms_px, found.notes, found.warnings) == (
        "mocap",
        "m",
        0.25,
        (),
        (),
    )


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.floats(-3, 3), min_size=3, max_size=3),
    st.lists(st.floats(-5, 5), min_size=3, max_size=3),
    st.sampled_from([4, 5, 8, 14]),
)
def test_any_pose_round_trips(
    tmp_path_factory: pytest.TempPathFactory, vector: list[float], center: list[float], n_dist: int
) -> None:
    path = tmp_path_factory.mktemp("calibration") / "c.toml"
    R = matrix_from_rotation_vector(np.array(vector))
    K = np.array([[500.1, 0, 320.7], [0, 499.9, 240.3], [0, 0, 1]])
    camera = Camera("a", (640, 480), K, np.linspace(-0.1, 0.1, n_dist), R, -R @ np.array(center))
    write_calibration(path, CameraRig((camera,)))
    # A pose below the floor is fine for a file that is only converted, but then z may be found to point down.
    found = read_calibration(path, check_world=False, up="z")
    assert_same_rig(found.rig, CameraRig((camera,)), 0.0)


def test_edited_rotation_vector_wins_over_the_stored_matrix(tmp_path: Path, rig: CameraRig) -> None:
    write_calibration(tmp_path / "c.toml", rig)
    text = (tmp_path / "c.toml").read_text()
    lines = [
        line if not line.startswith("rotation =") else "rotation = [1.5, 0.1, 0.0]"
        for line in text.split("\n")
    ]
    (tmp_path / "c.toml").write_text("\n".join(lines))
    found = read_calibration(tmp_path / "c.toml", check_world=False)
    np.testing.assert_allclose(
        found.rig[0].R, matrix_from_rotation_vector(np.array([1.5, 0.1, 0.0])), atol=1e-12
    )


@pytest.mark.parametrize(
    ("metadata", "extra", "scale", "expected"),
    [
        ('units = "m"', "", 1.0, ("anipose", "m")),
        ('units = "millimetres"', "", 1000.0, ("anipose", "mm")),
        ("adjusted = false\nerror = 0.0", "fisheye = false", 1.0, ("pose2sim", "m")),
        ("adjusted = true\nerror = 0.7", "", 1.0, ("anipose", "m")),
        ("groundplane_calibration = true", "", 1000.0, ("freemocap", "mm")),
        ("", "world_position = [0.0, 0.0, 0.0]", 1000.0, ("freemocap", "mm")),
        ("[metadata.board]\nsquare_length_mm = 54.0", 'id = "0"\nindex = 0', 1000.0, ("freemocap", "mm")),
    ],
)
def test_toml_family_and_its_units(
    tmp_path: Path, rig: CameraRig, metadata: str, extra: str, scale: float, expected: tuple[str, str]
) -> None:
    path = write_toml(tmp_path / "c.toml", rig, scale=scale, extra=extra, metadata=metadata)
    found = read_calibration(path)
    assert (found.format, found.units) == expected
    assert_same_rig(found.rig, rig, SAME)
    assert found.rms_px == (0.7 if "0.7" in metadata else None)


def test_bare_file_in_millimetres_asks_for_the_unit(tmp_path: Path, rig: CameraRig) -> None:
    path = write_toml(tmp_path / "c.toml", rig, scale=1000.0)
    with pytest.raises(MocapError, match="taken as m") as caught:
        read_calibration(path)
    assert caught.value.path == path
    assert "mm (" in caught.value.remedy
    assert_same_rig(read_calibration(path, units="mm").rig, rig, SAME)
    with pytest.raises(ValueError, match="units must be"):
        read_calibration(path, units="inch")


def test_unit_argument_overrides_the_file_and_says_so(tmp_path: Path, rig: CameraRig) -> None:
    path = write_toml(tmp_path / "c.toml", rig, scale=100.0, metadata='units = "m"')
    found = read_calibration(path, units="cm")
    assert_same_rig(found.rig, rig, SAME)
    assert any("cm" in w and "m" in w for w in found.warnings)


def test_unknown_unit_is_refused(tmp_path: Path, rig: CameraRig) -> None:
    with pytest.raises(MocapError, match=r"metadata\.units is 'furlong'"):
        read_calibration(write_toml(tmp_path / "c.toml", rig, metadata='units = "furlong"'))


def test_caliscope(tmp_path: Path, rig: CameraRig) -> None:
    text = ""
    for i, camera in enumerate(rig):
        section = toml_section(
            camera, key=f"cameras.{i}", extra=f"cam_id = {i + 3}\nerror = 0.{i + 1}\nfisheye = false"
        )
        text += "\n".join(line for line in section.split("\n") if not line.startswith("name"))
        text += "\n"
    text += "[cameras.7]\ncam_id = 7\nsize = [64, 48]\nmatrix = [[60, 0, 32], [0, 60, 24], [0, 0, 1]]\n"
    text += "distortions = [0.0, 0.0, 0.0, 0.0, 0.0]\n"
    text += "[cameras.8]\nport = 8\nignore = true\nsize = [6, 4]\nrotation = [0, 0, 0]\n"
    (tmp_path / "camera_array.toml").write_text(text)
    found = read_calibration(tmp_path / "camera_array.toml")
    assert found.rig.names == ("cam_3", "cam_4", "cam_5")
    assert found.format == "caliscope"
    assert found.rms_px == pytest.approx(0.2)
    assert any("cam_7" in w for w in found.warnings)
    assert any("port_8" in n for n in found.notes)


def write_easymocap(folder: Path, rig: CameraRig, *, with_size: bool, digits: int | None = None) -> Path:
    inner = cv2.FileStorage(str(folder / "intri.yml"), cv2.FILE_STORAGE_WRITE)
    outer = cv2.FileStorage(str(folder / "extri.yml"), cv2.FILE_STORAGE_WRITE)
    for storage in (inner, outer):
        storage.startWriteStruct("names", cv2.FileNode_SEQ)
        for name in rig.names:
            storage.write("", name)
        storage.endWriteStruct()
    for camera in rig:
        R = camera.R if digits is None else np.round(camera.R, digits)
        inner.write(f"K_{camera.name}", camera.K)
        inner.write(f"dist_{camera.name}", camera.dist.reshape(1, -1))
        if with_size:
            inner.write(f"W_{camera.name}", camera.size[0])
            inner.write(f"H_{camera.name}", camera.size[1])
        outer.write(f"R_{camera.name}", rotation_vector_from_matrix(camera.R).reshape(3, 1))
        outer.write(f"Rot_{camera.name}", R)
        outer.write(f"T_{camera.name}", camera.t.reshape(3, 1))
    inner.release()
    outer.release()
    return folder / "extri.yml"


def test_easymocap_by_either_file_or_the_folder(tmp_path: Path, rig: CameraRig) -> None:
    extri = write_easymocap(tmp_path, rig, with_size=True)
    for path in (extri, tmp_path / "intri.yml", tmp_path):
        found = read_calibration(path)
        assert found.format == "easymocap"
        assert_same_rig(found.rig, rig, SAME)
        assert not found.guessed_sizes


def test_easymocap_without_sizes_guesses_and_says_so(tmp_path: Path, rig: CameraRig) -> None:
    found = read_calibration(write_easymocap(tmp_path, rig, with_size=False))
    assert found.guessed_sizes == set(rig.names)
    assert found.rig[0].size == (63, 48)  # twice the principal point (31.7, 24.2), not the true 64 x 48
    assert any("picture size" in w for w in found.warnings)


def test_rounded_rotation_is_made_orthonormal(tmp_path: Path, rig: CameraRig) -> None:
    found = read_calibration(write_easymocap(tmp_path, rig, with_size=True, digits=4))
    for camera in found.rig:
        np.testing.assert_allclose(camera.R @ camera.R.T, np.eye(3), atol=1e-14)
    assert sum("made orthonormal" in note for note in found.notes) == len(rig)
    assert_same_rig(found.rig, rig, 1e-4)


def test_easymocap_missing_node_and_missing_file(tmp_path: Path, rig: CameraRig) -> None:
    extri = write_easymocap(tmp_path, rig, with_size=True)
    extri.write_text(extri.read_text().replace("T_cam_2", "T_cam_3"))
    with pytest.raises(MocapError, match="node T_cam_2 is missing") as caught:
        read_calibration(extri)
    assert caught.value.camera == "cam_2"
    extri.unlink()
    with pytest.raises(MocapError, match="two files"):
        read_calibration(tmp_path / "intri.yml")


@pytest.mark.parametrize("suffix", [".yml", ".xml", ".json"])
@pytest.mark.parametrize("rotation", ["R", "rvec"])
def test_opencv_storage_one_file_per_camera(
    tmp_path: Path, rig: CameraRig, suffix: str, rotation: str
) -> None:
    for camera in rig:
        storage = cv2.FileStorage(str(tmp_path / f"{camera.name}{suffix}"), cv2.FILE_STORAGE_WRITE)
        storage.write("camera_matrix", camera.K)
        storage.write("distortion_coefficients", camera.dist.reshape(-1, 1))
        storage.write("image_width", camera.size[0])
        storage.write("image_height", camera.size[1])
        storage.write(rotation, camera.R if rotation == "R" else rotation_vector_from_matrix(camera.R))
        storage.write("T", camera.t.reshape(3, 1) * 100)
        storage.write("units", "cm")
        storage.release()
    found = read_calibration(tmp_path)
    assert (found.format, found.units) == ("opencv", "cm")
    assert_same_rig(found.rig, rig, SAME)


def test_opencv_storage_all_cameras_in_one_file(tmp_path: Path, rig: CameraRig) -> None:
    path = tmp_path / "calib.yml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for i, camera in enumerate(rig):
        storage.startWriteStruct(f"c{i}", cv2.FileNode_MAP)
        storage.write("name", camera.name)
        storage.write("camera_matrix", camera.K)
        storage.write("distortion_coefficients", camera.dist)
        storage.write("image_size", np.array(camera.size))
        storage.write("rvec", rotation_vector_from_matrix(camera.R))
        storage.write("tvec", camera.t)
        storage.endWriteStruct()
    storage.release()
    found = read_calibration(path)
    assert_same_rig(found.rig, rig, SAME)
    assert any("metres assumed" in n for n in found.notes)


@pytest.mark.parametrize(
    "names",
    [
        ("mtx", "dist", "rvec", "tvec"),
        ("Camera_Matrix", "Distortion_Coefficients", "Rot", "T"),
        ("CameraMatrix", "DistortionCoeffs", "RotationValues", "TranslationValues"),
        ("CameraIntrinsicMatrix", "DistortionCoeffs", "CameraRotationVecs", "CameraTranslationVecs"),
        ("K", "distCoeffs", "rotation_vector", "translation_vector"),
        ("intrinsic_matrix", "D", "r", "t"),
    ],
)
def test_opencv_storage_as_many_programs_name_its_nodes(
    tmp_path: Path, rig: CameraRig, names: tuple[str, ...]
) -> None:
    for camera in rig:
        storage = cv2.FileStorage(str(tmp_path / f"{camera.name}.xml"), cv2.FILE_STORAGE_WRITE)
        vector = rotation_vector_from_matrix(camera.R).reshape(3, 1)
        for name, value in zip(names, (camera.K, camera.dist, vector, camera.t.reshape(3, 1)), strict=True):
            storage.write(name, value)
        storage.write("imageSize", np.array(camera.size))
        storage.release()
    assert_same_rig(read_calibration(tmp_path).rig, rig, SAME)


def test_opencv_storage_without_a_camera_names_its_nodes(tmp_path: Path) -> None:
    storage = cv2.FileStorage(str(tmp_path / "a.yml"), cv2.FILE_STORAGE_WRITE)
    storage.write("lens", np.eye(3))
    storage.write("place", np.zeros(3))
    storage.release()
    with pytest.raises(MocapError, match="holds no camera; its nodes are lens, place") as caught:
        read_calibration(tmp_path / "a.yml")
    assert "camera_matrix" in str(caught.value.remedy)


def test_opencv_storage_without_extrinsics(tmp_path: Path, rig: CameraRig) -> None:
    storage = cv2.FileStorage(str(tmp_path / "a.yml"), cv2.FILE_STORAGE_WRITE)
    storage.write("camera_matrix", rig[0].K)
    storage.release()
    with pytest.raises(MocapError, match="no extrinsics") as caught:
        read_calibration(tmp_path / "a.yml")
    assert caught.value.camera == "a"


def test_panoptic_is_centimetres_with_y_down(tmp_path: Path, rig: CameraRig) -> None:
    # Ours x, y, z is theirs x, -z, y: X_theirs = A X_ours.
    A = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    cameras = [
        {
            "name": c.name,
            "type": "hd",
            "resolution": list(c.size),
            "K": c.K.tolist(),
            "distCoef": [*c.dist.tolist(), 0.0],
            "R": (c.R @ A.T).tolist(),
            "t": (c.t * 100).reshape(3, 1).tolist(),
        }
        for c in rig
    ]
    path = tmp_path / "calibration_171204.json"
    path.write_text(json.dumps({"cameras": cameras}))
    found = read_calibration(path)
    assert (found.format, found.units) == ("panoptic", "cm")
    for a, b in zip(found.rig, rig, strict=True):
        np.testing.assert_allclose(a.center, b.center, atol=SAME)
        np.testing.assert_allclose(a.R, b.R, atol=SAME)
        assert a.size == b.size
    assert any("-y" in n for n in found.notes)
    assert any("cm" in n for n in found.notes)
    del cameras[0]["resolution"]
    path.write_text(json.dumps({"cameras": cameras}))
    assert read_calibration(path).rig[0].size == (1920, 1080)


@pytest.mark.parametrize("up", ["x", "-x", "y", "-y", "-z"])
def test_world_turned_to_z_up_keeps_pictures_the_same(tmp_path: Path, rig: CameraRig, up: str) -> None:
    axis = "xyz".index(up[-1])
    sign = -1.0 if up[0] == "-" else 1.0
    A = np.roll(np.eye(3), axis + 1, axis=0)  # a rotation that carries our z to the file's axis
    if sign < 0:
        A = A @ np.diag([1.0, -1.0, -1.0])
    assert np.allclose(A @ [0, 0, 1], sign * np.eye(3)[axis])
    turned = CameraRig(tuple(Camera(c.name, c.size, c.K, c.dist, c.R @ A.T, c.t) for c in rig))
    write_calibration(tmp_path / "c.toml", turned)
    text = (tmp_path / "c.toml").read_text().replace('up = "z"', f'up = "{up}"')
    (tmp_path / "c.toml").write_text(text)
    found = read_calibration(tmp_path / "c.toml")
    heights = [c.center[2] for c in found.rig]
    np.testing.assert_allclose(heights, [c.center[2] for c in rig], atol=SAME)
    for camera in found.rig:
        assert np.linalg.det(camera.R) == pytest.approx(1.0)
    # The point that all cameras look at is still in the middle of every picture.
    for camera in found.rig:
        uv, _ = camera.project(np.array([0.0, 0.0, 1.0]))
        np.testing.assert_allclose(uv, camera.K[:2, 2], atol=1e-6)


def test_z_down_is_recognised(tmp_path: Path, rig: CameraRig) -> None:
    flip = np.diag([1.0, -1.0, -1.0])
    turned = CameraRig(tuple(Camera(c.name, c.size, c.K, c.dist, c.R @ flip, c.t) for c in rig))
    path = write_toml(tmp_path / "c.toml", turned, metadata='units = "m"')
    found = read_calibration(path)
    assert_same_rig(found.rig, rig, SAME)
    assert any("points down" in w for w in found.warnings)


def test_y_up_world_is_refused_with_the_axis_in_the_remedy(tmp_path: Path, rig: CameraRig) -> None:
    A = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    turned = CameraRig(tuple(Camera(c.name, c.size, c.K, c.dist, c.R @ A.T, c.t) for c in rig))
    path = write_toml(tmp_path / "c.toml", turned, metadata='units = "m"')
    with pytest.raises(MocapError, match="below the floor") as caught:
        read_calibration(path)
    assert 'calibration_up = "y"' in caught.value.remedy
    assert len(read_calibration(path, check_world=False).rig) == 3
    np.testing.assert_allclose(
        [c.center[2] for c in read_calibration(path, up="y").rig], [c.center[2] for c in rig], atol=SAME
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("matrix = [[60.0,", "matrix = [[nan,", "matrix holds a number that is not finite"),
        ("matrix = [[60.0,", "matrix = [[0.0,", "singular or has a focal length"),
        ("translation = [", "translation = [inf, ", "translation has 4 numbers"),
        ("translation = [", "translation = [", "not finite"),
        ("[0.0, 0.0, 1.0]]", "[0.0, 0.0, 1.0], [1.0, 1.0, 1.0]]", "matrix has 12 numbers"),
        ('name = "back"', 'name = "cam_2"', "used more than once"),
        ("size = [64, 48]", "size = [64, 0]", "is not two whole numbers"),
        ("distortions = [-0.1,", 'distortions = ["a",', "not a list of numbers"),
        ("distortions = [-0.1,", "distortions = [-0.1, 0, 0,", "6|7 distortion numbers"),
        ("rotation = [", "rotatoin = [", "has no rotation"),
    ],
)
def test_bad_numbers_name_file_and_camera(
    tmp_path: Path, rig: CameraRig, old: str, new: str, message: str
) -> None:
    path = write_toml(tmp_path / "c.toml", rig, metadata='units = "m"')
    text = path.read_text()
    if message == "not finite":
        first = text.index("translation = [") + len("translation = [")
        text = text[:first] + "nan" + text[text.index(",", first) :]
    else:
        assert old in text
        text = text.replace(old, new, 1)
    path.write_text(text)
    with pytest.raises(MocapError, match=message) as caught:
        read_calibration(path)
    assert caught.value.path == path
    assert caught.value.camera in {"back", "cam_2"}
    assert caught.value.remedy


def test_mirrored_and_skewed_rotations_are_refused(tmp_path: Path, rig: CameraRig) -> None:
    for R, message in ((rig[0].R * [1, 1, -1], "mirrored"), (rig[0].R * 1.2, "not a rotation")):
        cameras = [
            {"name": c.name, "K": c.K.tolist(), "R": c.R.tolist(), "t": (c.t * 100).tolist()} for c in rig
        ]
        cameras[0]["R"] = R.tolist()
        path = tmp_path / "calibration.json"
        path.write_text(json.dumps({"cameras": cameras}))
        with pytest.raises(MocapError, match=message) as caught:
            read_calibration(path)
        assert caught.value.camera == "back"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("c.toml", "[cam_0\nname", "not valid TOML"),
        ("c.toml", "", "holds no camera"),
        ("c.toml", '[cam_0]\nname = "a"\nsize = [2, 2]\n', "no matrix"),
        ("c.json", "{not json", "not valid JSON"),
        ("c.json", '{"cameras": []}', "holds no camera"),
        ("c.yml", "no: header\n", "FileStorage|no camera"),
        ("c.yml", "%YAML:1.0\n---\na: 1\n", "holds no camera"),
        ("c.qca", "", "is not known"),
    ],
)
def test_files_that_are_no_calibration(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(MocapError, match=message) as caught:
        read_calibration(tmp_path / name)
    assert caught.value.path == tmp_path / name


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(MocapError, match="no such calibration"):
        read_calibration(tmp_path / "nothing.toml")


def test_find_calibration(tmp_path: Path, rig: CameraRig) -> None:
    with pytest.raises(MocapError, match="no calibration"):
        find_calibration(tmp_path)
    write_calibration(tmp_path / "Calib_qualisys.toml", rig)
    (tmp_path / "session.toml").write_text("fps = 3\n")
    assert find_calibration(tmp_path).name == "Calib_qualisys.toml"
    write_easymocap(tmp_path, rig, with_size=True)
    with pytest.raises(MocapError, match="several calibrations") as caught:
        find_calibration(tmp_path)
    assert "extri.yml" in str(caught.value)
    write_calibration(tmp_path / "calibration.toml", rig)
    assert find_calibration(tmp_path).name == "calibration.toml"


def test_not_writable(tmp_path: Path, rig: CameraRig) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(MocapError, match="cannot write") as caught:
        write_calibration(tmp_path / "file" / "c.toml", rig)
    assert caught.value.remedy


@pytest.mark.shared
def test_shared_calibrations_are_read() -> None:
    if not SHARED.is_dir():
        pytest.skip("the reference material is not beside the checkout")
    for path in sorted(SHARED.glob("*/*/calib*.toml")):
        found = read_calibration(path)
        assert found.units == "m"
        assert all(c.center[2] > 0 for c in found.rig)
        assert any("points down" in w for w in found.warnings) == ("as_found" in path.name)
