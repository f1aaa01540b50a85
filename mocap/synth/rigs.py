"""Camera rigs: a ring round the room, the corners and the ceiling of a meeting room, or cameras one by one."""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator
from scipy.spatial.transform import Rotation

from mocap.data import Camera, CameraRig
from mocap.synth.rooms import Room
from mocap.synth.section import Section

Array = NDArray[np.float64]
Range = tuple[float, float]
Vector = tuple[float, float, float]


class _Rig(Section):
    size_px: tuple[int, int] = (640, 480)
    distortion: bool = True
    lens: Literal["normal", "strong", "fisheye"] = "normal"
    """With `distortion`: a good lens, a cheap wide one, or OpenCV's fisheye model."""

    @model_validator(mode="after")
    def _whole_blocks(self) -> Any:
        if self.size_px[0] % 8 or self.size_px[1] % 8 or min(self.size_px) < 64:
            raise ValueError("size_px: width and height must be multiples of 8, at least 64")
        return self


class RingRig(_Rig):
    """Cameras on a ring that look at the middle of the room."""

    kind: Literal["ring"] = "ring"
    n_cameras: int = Field(7, ge=1, le=32)
    radius_m: Range = (3.2, 3.9)
    height_m: Range = (1.1, 2.4)
    focal_px: float = Field(500.0, ge=100.0)
    """Focal length for a picture 640 pixels wide."""

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"cam_{i}" for i in range(self.n_cameras))


class CornersRig(_Rig):
    """A camera in each upper corner of the room and one under the ceiling. Source: CF 4.4, CLEAR meeting rooms."""

    kind: Literal["corners_ceiling"]
    height_m: Range = (2.2, 2.5)
    focal_px: float = Field(340.0, ge=100.0)
    """Focal length for a picture 640 pixels wide, corner cameras."""
    ceiling_focal_px: float = Field(260.0, ge=100.0)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"cam_{i}" for i in range(5))


class GivenCamera(Section):
    """One camera, exactly."""

    name: str = Field(pattern=r"^[A-Za-z0-9_-]+$")
    position_m: Vector
    target_m: Vector
    """A point on the optical axis."""
    focal_px: float = Field(500.0, ge=100.0)
    """Focal length for a picture 640 pixels wide."""
    roll_deg: float = 0.0
    dist: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, or k1 .. k4 with the lens "fisheye"."""

    @model_validator(mode="after")
    def _looks_somewhere(self) -> GivenCamera:
        if np.allclose(self.position_m, self.target_m):
            raise ValueError("target_m must differ from position_m")
        return self


class GivenRig(_Rig):
    """Cameras one by one. Only their names, poses and lenses count; nothing is drawn at random."""

    kind: Literal["given"]
    cameras: tuple[GivenCamera, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _unique(self) -> GivenRig:
        if len(set(self.names)) < len(self.names):
            raise ValueError("cameras: two cameras have one name")
        return self

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(c.name for c in self.cameras)


def _ring_by_default(value: Any) -> Any:
    return {"kind": "ring", **value} if isinstance(value, dict) else value


RigConfig: TypeAlias = Annotated[
    Annotated[RingRig | CornersRig | GivenRig, Field(discriminator="kind")], BeforeValidator(_ring_by_default)
]

KINDS = ("ring", "corners_ceiling", "given")


def make_rig(config: RingRig | CornersRig | GivenRig, room: Room, *, rng: np.random.Generator) -> CameraRig:
    """The cameras of a scene."""
    if isinstance(config, RingRig):
        return make_ring(config, room, rng=rng)
    if isinstance(config, CornersRig):
        return make_corners(config, room, rng=rng)
    return make_given(config)


def make_ring(config: RingRig, room: Room, *, rng: np.random.Generator) -> CameraRig:
    """Cameras on a ring that look at the middle of the room; poses, focal lengths and k1, k2 vary by the seed."""
    cameras = []
    start = rng.uniform(0, 2 * np.pi)
    for i, name in enumerate(config.names):
        angle = start + 2 * np.pi * (i + rng.uniform(-0.18, 0.18)) / config.n_cameras
        radius = rng.uniform(*config.radius_m)
        eye = np.array([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(*config.height_m)])
        eye = np.clip(eye, room.lower + 0.15, room.upper - 0.15)
        target = np.array([0.0, 0.0, 0.92]) + rng.uniform(-1, 1, 3) * np.array([0.12, 0.12, 0.05])
        R = _look_at(eye, target, roll=rng.normal(0, np.deg2rad(0.8)))
        cameras.append(_drawn_camera(name, config, config.focal_px, R, eye, rng=rng))
    return CameraRig(tuple(cameras))


def make_corners(config: CornersRig, room: Room, *, rng: np.random.Generator) -> CameraRig:
    """cam_0 .. cam_3 in the corners, counter-clockwise, cam_4 under the ceiling; poses and lenses vary by the seed."""
    cameras = []
    middle = (room.lower + room.upper) / 2
    for i, name in enumerate(config.names):
        if i < 4:
            corner = np.array([(1, -1, -1, 1)[i], (1, 1, -1, -1)[i]]) * (room.upper[:2] - middle[:2] - 0.18)
            eye = np.array([*(middle[:2] + corner), min(rng.uniform(*config.height_m), room.upper[2] - 0.15)])
            target = np.array([*middle[:2], 0.85]) + rng.uniform(-1, 1, 3) * np.array([0.25, 0.25, 0.08])
            focal = config.focal_px
        else:
            eye = np.array([*(middle[:2] + rng.uniform(-0.15, 0.15, 2)), room.upper[2] - 0.12])
            target = eye + np.array([*rng.uniform(-0.04, 0.04, 2), -1.0])
            focal = config.ceiling_focal_px
        R = _look_at(eye, target, roll=rng.normal(0, np.deg2rad(0.8)))
        cameras.append(_drawn_camera(name, config, focal, R, eye, rng=rng))
    return CameraRig(tuple(cameras))


def make_given(config: GivenRig) -> CameraRig:
    """The cameras of a list, exactly."""
    cameras = []
    width, height = config.size_px
    for c in config.cameras:
        eye = np.array(c.position_m)
        R = _look_at(eye, np.array(c.target_m), roll=np.deg2rad(c.roll_deg))
        f = c.focal_px * width / 640
        K = np.array([[f, 0, width / 2 - 0.5], [0, f, height / 2 - 0.5], [0, 0, 1]])
        dist = np.array(c.dist) if config.distortion else np.zeros(4)
        cameras.append(Camera(c.name, config.size_px, K, dist, R, -R @ eye, config.lens == "fisheye"))
    return CameraRig(tuple(cameras))


def _drawn_camera(
    name: str,
    config: RingRig | CornersRig,
    focal_px: float,
    R: Array,
    eye: Array,
    *,
    rng: np.random.Generator,
) -> Camera:
    """A camera at a pose with a lens that varies a little."""
    width, height = config.size_px
    f = focal_px * width / 640 * rng.uniform(0.97, 1.03)
    K = np.array(
        [
            [f, 0, width / 2 - 0.5 + rng.normal(0, 4)],
            [0, f * rng.uniform(0.998, 1.002), height / 2 - 0.5 + rng.normal(0, 4)],
            [0, 0, 1],
        ]
    )
    dist = _lens(config.lens, rng=rng) if config.distortion else np.zeros(4)
    is_fisheye = config.distortion and config.lens == "fisheye"
    return Camera(name, config.size_px, K, dist, R, -R @ eye, is_fisheye)


def _lens(kind: str, *, rng: np.random.Generator) -> Array:
    """Distortion coefficients (4,) of a lens: "normal", "strong" (never folds back) or "fisheye"."""
    low, high = _DISTORTION[kind]
    return np.array([rng.uniform(a, b) if a < b else a for a, b in zip(low, high, strict=True)])


_DISTORTION = {
    "normal": ((-0.17, 0.03, 0.0, 0.0), (-0.09, 0.05, 0.0, 0.0)),
    "strong": ((-0.34, 0.10, -0.002, -0.002), (-0.28, 0.13, 0.002, 0.002)),
    "fisheye": ((-0.03, -0.01, 0.0, 0.0), (0.03, 0.01, 0.0, 0.0)),
}


def _look_at(eye: Array, target: Array, *, roll: float) -> Array:
    """World to camera, (3, 3): z towards the target, x level; straight down, the picture's top is +y."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0.0, 1.0, 0.0] if abs(z[2]) > 0.999 else [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    return Rotation.from_rotvec([0, 0, roll]).as_matrix() @ R
