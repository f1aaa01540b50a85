"""Rigs of structure from motion: COLMAP (text and binary) and OpenSfM, whose scale and floor are arbitrary."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from mocap.arrays import Array
from mocap.files import read_bytes, read_text
from mocap.io.calibration.record import (
    RawCamera,
    RawRig,
    bad,
    camera_name,
    distortion,
    numbers,
    picture_size,
    rotation,
)

# Model: number in binary files, its parameters in order. Those that OpenCV has no like of are refused.
_MODELS: dict[str, tuple[int, tuple[str, ...]]] = {
    "SIMPLE_PINHOLE": (0, ("f", "cx", "cy")),
    "PINHOLE": (1, ("fx", "fy", "cx", "cy")),
    "SIMPLE_RADIAL": (2, ("f", "cx", "cy", "k1")),
    "RADIAL": (3, ("f", "cx", "cy", "k1", "k2")),
    "OPENCV": (4, ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")),
    "OPENCV_FISHEYE": (5, ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")),
    "FULL_OPENCV": (6, ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    "SIMPLE_RADIAL_FISHEYE": (8, ("f", "cx", "cy", "k1")),
    "RADIAL_FISHEYE": (9, ("f", "cx", "cy", "k1", "k2")),
}
_BY_NUMBER = {number: name for name, (number, _) in _MODELS.items()}
_CENTRE = 0.5  # COLMAP counts from the corner of the first pixel
_MOST_IMAGES = 1000  # a rig; more is a film through a town
_LIMIT_BYTES = 200_000_000  # COLMAP keeps the points of every picture beside its pose

_Lens = tuple[tuple[int, int], Array, Array, bool]
_Pose = tuple[str, int, Array, Array]


def is_colmap(folder: Path) -> bool:
    """Whether a folder holds a model of COLMAP."""
    return any((folder / f"images{ending}").is_file() for ending in (".txt", ".bin"))


def read_colmap(folder: Path) -> RawRig:
    """A model of COLMAP: cameras and images, as .txt or as .bin; every image is a camera of the rig.

    Images in folders of their own (cam_0/0001.png) are called as the folder, others as the file.
    """
    ending = ".txt" if (folder / "images.txt").is_file() else ".bin"
    lens_path, pose_path = folder / f"cameras{ending}", folder / f"images{ending}"
    if ending == ".txt":
        lenses, poses = _text_lenses(lens_path), _text_poses(pose_path)
    else:
        lenses, poses = _binary_lenses(lens_path), _binary_poses(pose_path)
    if len(poses) > _MOST_IMAGES:
        raise bad(pose_path, f"{len(poses)} images are no rig", remedy="reconstruct one picture per camera")
    names = _names([file for file, *_ in poses])
    found = []
    for name, (_, lens, R, t) in zip(names, poses, strict=True):
        name = camera_name(pose_path, name)
        if lens not in lenses:
            raise bad(pose_path, f"its camera {lens} is not in {lens_path.name}", camera=name)
        size, K, dist, is_fisheye = lenses[lens]
        found.append(RawCamera(name, size, K, dist, R, t, is_fisheye))
    return _arbitrary(tuple(found), "colmap")


def _arbitrary(cameras: tuple[RawCamera, ...], word: str) -> RawRig:
    warning = (
        "structure from motion knows neither scale nor floor: compare the baselines that `mocap check` prints with the "
        "room, and correct the scale with `mocap calibrate --refine --height-m`"
    )
    return RawRig(cameras, word, units="m", is_unit_sure=False, warnings=(warning,))


def _names(files: list[str]) -> list[str]:
    """Folders where each has one image, else files without their ending."""
    parents = [PurePosixPath(file.replace("\\", "/")).parent.name for file in files]
    if all(parents) and len(set(parents)) == len(files):
        return parents
    return [PurePosixPath(file.replace("\\", "/")).stem for file in files]


def _lens(path: Path, number: int, model: str, size: tuple[float, float], values: list[float]) -> _Lens:
    """Size, K, distortion and whether it is a fisheye lens, from COLMAP's parameters."""
    label = str(number)
    if model not in _MODELS:
        raise bad(
            path,
            f"the lens model {model[:30]} has no like in OpenCV",
            camera=label,
            remedy="reconstruct with OPENCV or OPENCV_FISHEYE",
        )
    keys = _MODELS[model][1]
    p = dict(zip(keys, numbers(path, label, model, values, (len(keys),)).tolist(), strict=True))
    fx, fy = p.get("fx", p.get("f", 0.0)), p.get("fy", p.get("f", 0.0))
    K = np.array([[fx, 0, p["cx"] - _CENTRE], [0, fy, p["cy"] - _CENTRE], [0, 0, 1.0]])
    is_fisheye = model.endswith("FISHEYE")
    if is_fisheye:
        dist = [p.get(f"k{i}", 0.0) for i in (1, 2, 3, 4)]
    else:
        dist = [p.get(key, 0.0) for key in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")]
        dist = dist if model == "FULL_OPENCV" else dist[:4]
    return picture_size(path, label, size), K, distortion(path, label, dist, is_fisheye), is_fisheye


def _text_lenses(path: Path) -> dict[int, _Lens]:
    lenses = {}
    for line in _lines(path):
        words = line.split()
        if len(words) < 5:
            raise bad(path, f"cannot read the line {line[:40]!r}")
        number, *values = _floats(path, [words[0], *words[2:]])
        lenses[int(number)] = _lens(path, int(number), words[1], (values[0], values[1]), values[2:])
    return lenses


def _text_poses(path: Path) -> list[_Pose]:
    """Every image has a line with its pose and one with its points, which may be empty."""
    text = read_text(path, "the calibration", limit=_LIMIT_BYTES)
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    poses = []
    for line in lines[::2]:
        words = line.split(maxsplit=9)
        if not words:
            continue
        if len(words) != 10:
            raise bad(path, f"cannot read the line {line[:40]!r}")
        poses.append(_pose(path, words[9], _floats(path, words[1:9])))
    return poses


def _pose(path: Path, file: str, values: list[float]) -> _Pose:
    """Name, number of the camera, R and t of an image; values : quaternion w x y z, t, camera."""
    w, x, y, z, *t, lens = numbers(path, file, "pose", values, (8,)).tolist()
    if not np.linalg.norm([w, x, y, z]) > 0.5:
        raise bad(path, "its rotation is no quaternion", camera=file[:60])
    return file, int(lens), Rotation.from_quat([x, y, z, w]).as_matrix(), np.array(t)


class _Bytes:
    """A binary file that is read from its beginning."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._data, self._at = read_bytes(path, "the calibration", limit=_LIMIT_BYTES), 0

    def take(self, form: str) -> tuple[Any, ...]:
        """Numbers of a format of `struct`, little endian."""
        size = struct.calcsize("<" + form)
        if self._at + size > len(self._data):
            raise bad(self.path, "the file ends too early", remedy="copy it again")
        values = struct.unpack_from("<" + form, self._data, self._at)
        self._at += size
        return values

    def text(self) -> str:
        """Up to the next zero."""
        end = self._data.find(b"\0", self._at)
        if end < 0:
            raise bad(self.path, "the file ends too early", remedy="copy it again")
        found, self._at = self._data[self._at : end], end + 1
        return found.decode("utf-8", errors="replace")

    def skip(self, n: int) -> None:
        if n < 0 or self._at + n > len(self._data):
            raise bad(self.path, "the file ends too early", remedy="copy it again")
        self._at += n


def _binary_lenses(path: Path) -> dict[int, _Lens]:
    data = _Bytes(path)
    (count,) = data.take("Q")
    lenses = {}
    for _ in range(min(count, _MOST_IMAGES)):
        number, model, width, height = data.take("iiQQ")
        name = _BY_NUMBER.get(model, f"number {model}")
        n = len(_MODELS[name][1]) if name in _MODELS else 0
        values = list(data.take(f"{n}d"))
        lenses[number] = _lens(path, number, name, (width, height), values)
    return lenses


def _binary_poses(path: Path) -> list[_Pose]:
    data = _Bytes(path)
    (count,) = data.take("Q")
    poses = []
    for _ in range(min(count, _MOST_IMAGES + 1)):
        _, *values, lens = data.take("i7di")
        file = data.text()
        (n_points,) = data.take("Q")
        data.skip(24 * n_points)
        poses.append(_pose(path, file, [*values, float(lens)]))
    return poses


def _lines(path: Path) -> list[str]:
    text = read_text(path, "the calibration", limit=_LIMIT_BYTES)
    return [line for line in text.splitlines() if line.strip() and not line.startswith("#")]


def _floats(path: Path, words: list[str]) -> list[float]:
    try:
        return numbers(path, "", "a line", [float(word) for word in words], (len(words),)).tolist()
    except ValueError as error:
        raise bad(path, f"holds what is no number: {str(error)[-40:]}") from error


def is_opensfm(document: Any) -> bool:
    """Whether a JSON document is a reconstruction of OpenSfM."""
    return (
        isinstance(document, list)
        and bool(document)
        and isinstance(document[0], dict)
        and "shots" in document[0]
    )


def read_opensfm(path: Path, document: list[Any]) -> RawRig:
    """The largest reconstruction of a file: every shot is a camera of the rig.

    Pixels are counted in the longer side of the picture, from its middle.
    """
    parts = [part for part in document if isinstance(part, dict) and isinstance(part.get("shots"), dict)]
    largest: dict[str, Any] = max(parts, key=lambda part: len(part["shots"]), default={"shots": {}})
    lenses, shots = largest.get("cameras"), largest["shots"]
    if not isinstance(lenses, dict) or len(shots) > _MOST_IMAGES:
        raise bad(path, "the reconstruction has no cameras, or too many shots for a rig")
    names = _names(list(shots))
    found = []
    for name, shot in zip(names, shots.values(), strict=True):
        name = camera_name(path, name)
        lens = (
            lenses.get(shot.get("camera"))
            if isinstance(shot, dict) and isinstance(shot.get("camera"), str)
            else None
        )
        if not isinstance(lens, dict):
            raise bad(path, "its shot has no camera of the file", camera=name)
        size, K, dist, is_fisheye = _opensfm_lens(path, name, lens)
        R = rotation(path, name, shot.get("rotation"))
        found.append(
            RawCamera(
                name,
                size,
                K,
                dist,
                R,
                numbers(path, name, "translation", shot.get("translation"), (3,)),
                is_fisheye,
            )
        )
    return _arbitrary(tuple(found), "opensfm")


def _opensfm_lens(path: Path, name: str, lens: Mapping[str, Any]) -> _Lens:
    kind = str(lens.get("projection_type", "perspective"))
    width, height = picture_size(path, name, [lens.get("width"), lens.get("height")])

    def value(*keys: str) -> float:
        found = next((lens[key] for key in keys if key in lens), 0.0)
        return float(numbers(path, name, keys[0], found, (1,))[0])

    if kind not in ("perspective", "brown", "fisheye", "fisheye_opencv"):
        raise bad(path, f"the lens model {kind[:30]} has no like in OpenCV", camera=name)
    side = max(width, height)
    fx, fy = side * value("focal_x", "focal"), side * value("focal_y", "focal")
    cx, cy = side * value("c_x") + (width - 1) / 2, side * value("c_y") + (height - 1) / 2
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    is_fisheye = kind.startswith("fisheye")
    if is_fisheye:
        dist = [value("k1"), value("k2"), value("k3"), value("k4")]
    else:
        dist = [value("k1"), value("k2"), value("p1"), value("p2"), value("k3")]
    return (width, height), K, distortion(path, name, dist, is_fisheye), is_fisheye
