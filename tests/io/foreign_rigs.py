"""Cameras of other tools written from their numbers, and their projection formulas, apart from the package's own."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap.data import Camera, CameraRig

Array = NDArray[np.float64]
MM = 1000.0
SIZES = ((1280, 720), (640, 480), (1088, 1920))
# Of ordinary lenses; k4 to k6 are those of the denominator.
_NUMBERS = {
    "k1": -0.11,
    "k2": 0.05,
    "p1": 0.001,
    "p2": -0.0007,
    "k3": 0.01,
    "k4": 0.02,
    "k5": -0.01,
    "k6": 0.004,
}
_COLMAP_NUMBERS = {
    "SIMPLE_PINHOLE": 0,
    "PINHOLE": 1,
    "SIMPLE_RADIAL": 2,
    "RADIAL": 3,
    "OPENCV": 4,
    "OPENCV_FISHEYE": 5,
    "FULL_OPENCV": 6,
    "SIMPLE_RADIAL_FISHEYE": 8,
    "RADIAL_FISHEYE": 9,
}


@dataclass
class Lens:
    """One camera: world to camera in metres, z up."""

    size: tuple[int, int]
    K: Array
    dist: Array
    R: Array
    t: Array
    is_fisheye: bool

    @property
    def quaternion_xyzw(self) -> Array:
        return np.asarray(Rotation.from_matrix(self.R).as_quat())


def truth(words: str, *, square: bool = False) -> list[Lens]:
    """Three cameras around a room. words : numbers of the lens, `fisheye` before those of one; 0 for none."""
    names = words.split()
    is_fisheye = "fisheye" in names
    dist = np.array([_NUMBERS.get(name, 0.0) for name in names if name != "fisheye"])
    if is_fisheye:
        dist = 0.3 * dist
    lenses = []
    for k, size in enumerate(SIZES):
        angle = 2.1 * k + 0.4
        eye = np.array([3.1 * np.cos(angle), 2.7 * np.sin(angle), 1.4 + 0.3 * k])
        z = np.array([0.1, -0.05, 1.0]) - eye
        z /= np.linalg.norm(z)
        x = np.cross(z, [0.02 * k, 0.0, 1.0])
        x /= np.linalg.norm(x)
        R = np.stack([x, np.cross(z, x), z])
        fx = 0.9 * max(size)
        K = np.array(
            [[fx, 0, size[0] / 2 + 3.25], [0, fx if square else 1.01 * fx, size[1] / 2 - 4.5], [0, 0, 1]]
        )
        lenses.append(Lens(size, K, dist, R, -R @ eye, is_fisheye))
    return lenses


def project(lens: Lens, points: Array) -> Array:
    """Pixels (N, 2) of points (N, 3) m, by the formulas of the manuals."""
    x, y, z = (points @ lens.R.T + lens.t).T
    a, b = x / z, y / z
    d = np.concatenate([lens.dist, np.zeros(8)])
    if lens.is_fisheye:
        r = np.hypot(a, b)
        theta = np.arctan(r)
        scale = theta * (1 + d[0] * theta**2 + d[1] * theta**4 + d[2] * theta**6 + d[3] * theta**8) / r
        a, b = a * scale, b * scale
    else:
        r2 = a**2 + b**2
        radial = (1 + d[0] * r2 + d[1] * r2**2 + d[4] * r2**3) / (1 + d[5] * r2 + d[6] * r2**2 + d[7] * r2**3)
        a, b = (
            a * radial + 2 * d[2] * a * b + d[3] * (r2 + 2 * a**2),
            b * radial + d[2] * (r2 + 2 * b**2) + 2 * d[3] * a * b,
        )
    return np.column_stack([lens.K[0, 0] * a + lens.K[0, 2], lens.K[1, 1] * b + lens.K[1, 2]])


def rig_of(lenses: list[Lens]) -> CameraRig:
    return CameraRig(
        tuple(
            Camera(
                f"cam_{k}",
                lens.size,
                lens.K,
                lens.dist if len(lens.dist) else np.zeros(4),
                lens.R,
                lens.t,
                lens.is_fisheye,
            )
            for k, lens in enumerate(lenses)
        )
    )


def opencap_values(lens: Lens, from_board: Array) -> dict[str, Any]:
    """from_board : (3, 3) turns the board's axes into the world's."""
    height, width = lens.size[1], lens.size[0]
    return {
        "intrinsicMat": lens.K,
        "distortion": lens.dist[None],
        "imageSize": np.array([[height], [width]], dtype=np.int64),
        "rotation": lens.R @ from_board,
        "translation": MM * lens.t[:, None],
        "rotation_EulerAngles": np.zeros((3, 1)),
    }


def humaneva(lens: Lens) -> str:
    fx, fy, cx, cy = lens.K[0, 0], lens.K[1, 1], lens.K[0, 2], lens.K[1, 2]
    values = [fx, fy, cx, cy, 0.0, *lens.dist, *lens.R.ravel(), *(MM * lens.t)]
    return "".join(f"{float(v)!r}\n" for v in values)


def colmap_model(folder: Path, lenses: list[Lens], model: str, *, is_binary: bool) -> None:
    """cameras and images of a model; COLMAP counts pixels from the corner of the first."""
    cameras, images = [], []
    for k, lens in enumerate(lenses):
        f = [lens.K[0, 0]] if model.startswith(("SIMPLE", "RADIAL")) else [lens.K[0, 0], lens.K[1, 1]]
        values = [float(v) for v in (*f, lens.K[0, 2] + 0.5, lens.K[1, 2] + 0.5, *lens.dist)]
        cameras.append((k + 1, model, lens.size, values))
        x, y, z, w = lens.quaternion_xyzw.tolist()
        images.append((k + 1, [w, x, y, z, *lens.t.tolist()], k + 1, f"cam_{k}/000.png"))
    if is_binary:
        data = struct.pack("<Q", len(cameras))
        for number, name, size, values in cameras:
            data += struct.pack(f"<iiQQ{len(values)}d", number, _COLMAP_NUMBERS[name], *size, *values)
        (folder / "cameras.bin").write_bytes(data)
        data = struct.pack("<Q", len(images))
        for number, pose, camera, name in images:
            data += struct.pack("<i7di", number, *pose, camera) + name.encode() + b"\0"
            data += struct.pack("<Qddqddq", 2, 1.5, 2.5, -1, 3.5, 4.5, 7)
        (folder / "images.bin").write_bytes(data)
        return
    lines = ["# Camera list"]
    lines += [f"{n} {name} {size[0]} {size[1]} {' '.join(map(repr, v))}" for n, name, size, v in cameras]
    (folder / "cameras.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    lines = ["# Image list"]
    for number, pose, camera, name in images:
        lines += [
            f"{number} {' '.join(map(repr, pose))} {camera} {name}",
            "" if number == 2 else "1.5 2.5 -1",
        ]
    (folder / "images.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


def opensfm(lenses: list[Lens], kind: str) -> dict[str, Any]:
    """A reconstruction: lengths in the longer side of the picture, from its middle."""
    cameras: dict[str, Any] = {}
    shots: dict[str, Any] = {}
    for k, lens in enumerate(lenses):
        side = max(lens.size)
        names = ("k1", "k2", "p1", "p2", "k3") if kind == "brown" else ("k1", "k2", "k3", "k4")
        values = dict(zip(names, lens.dist.tolist(), strict=False))
        if kind in ("perspective", "fisheye"):
            values["focal"] = lens.K[0, 0] / side
        else:
            values |= {"focal_x": lens.K[0, 0] / side, "focal_y": lens.K[1, 1] / side}
            middle = (np.array(lens.size) - 1) / 2
            values |= dict(zip(("c_x", "c_y"), ((lens.K[:2, 2] - middle) / side).tolist(), strict=True))
        cameras[f"lens {k}"] = {
            "projection_type": kind,
            "width": lens.size[0],
            "height": lens.size[1],
            **values,
        }
        shots[f"cam_{k}.jpg"] = {
            "rotation": Rotation.from_matrix(lens.R).as_rotvec().tolist(),
            "translation": lens.t.tolist(),
            "camera": f"lens {k}",
        }
    return {"cameras": cameras, "shots": shots, "points": {}}
