"""Faults of cameras and light: the switches of `[[faults]]`, and what each picture shows because of them.

Three clocks: a *frame* counts the pictures in a camera's file, a *shot* the pictures that the camera has taken, and an
*instant* is the moment of the session that a shot shows, in frames of the session (it may be fractional). Without
faults the three are equal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from mocap.data import Camera
from mocap.synth.section import Section

Vector = tuple[float, float, float]


class _CameraFault(Section):
    camera: str
    """Name of the camera: cam_0, cam_1, ..., or as given in the rig."""


class DroppedFrames(_CameraFault):
    """The file lacks `n_frames` pictures from `frame` on: what follows comes too early."""

    kind: Literal["dropped"]
    frame: int = Field(ge=1)
    n_frames: int = Field(ge=1)
    refill: bool = False
    """Go on recording until the file is as long as the others."""


class FrozenPicture(_CameraFault):
    """The camera repeats picture `frame` - 1 for `n_frames`, or to the end."""

    kind: Literal["frozen"]
    frame: int = Field(ge=1)
    n_frames: int | None = Field(None, ge=1)


class MovedCamera(_CameraFault):
    """Somebody pushes the camera: from `frame` on it has another pose. The calibration keeps the old one."""

    kind: Literal["moved"]
    frame: int = Field(ge=1)
    rotate_deg: Vector = (0.0, 0.0, 0.0)
    """Rotation vector in the camera's own axes (x right, y down, z forward): tilt, pan, roll."""
    shift_m: Vector = (0.0, 0.0, 0.0)
    """Shift of the optical centre, world axes."""

    @model_validator(mode="after")
    def _moves(self) -> MovedCamera:
        if not any(self.rotate_deg) and not any(self.shift_m):
            raise ValueError("rotate_deg or shift_m must differ from zero")
        return self


class LaggingCamera(_CameraFault):
    """From `frame` on the pictures are `lag_frames` old (a fraction is allowed; negative: they come early)."""

    kind: Literal["lag"]
    frame: int = Field(0, ge=0)
    lag_frames: float = Field(ge=-100, le=100)


class ClockOffset(_CameraFault):
    """The camera's clock: every picture is taken `offset_s` late, and the clock drifts."""

    kind: Literal["offset"]
    offset_s: float = Field(0.0, ge=-1.0, le=1.0)
    drift_ms_per_s: float = Field(0.0, ge=-50.0, le=50.0)


class OtherRate(_CameraFault):
    """The camera records `fps` pictures per second instead of the session's rate, and its file says so."""

    kind: Literal["rate"]
    fps: float = Field(ge=1.0, le=240.0)
    refill: bool = False
    """Record as many pictures as the others, whatever time that takes."""


class CameraOff(_CameraFault):
    """Black pictures from `frame` on, for `n_frames` or to the end."""

    kind: Literal["off"]
    frame: int = Field(ge=0)
    n_frames: int | None = Field(None, ge=1)


class LightSwitch(Section):
    """The light changes at session frame `frame`, for `n_frames` or to the end, for all cameras."""

    kind: Literal["light"]
    frame: int = Field(ge=0)
    n_frames: int | None = Field(None, ge=1)
    gain: float = Field(ge=0.0, le=10.0)
    """Factor on the light, linear."""
    lamp: Literal[0, 1] | None = None
    """Only this ceiling lamp; the other one and the diffuse light stay."""


class Exposure(_CameraFault):
    """The camera's automatic exposure pumps: its gain swings by the relative `amplitude` with `period_s`."""

    kind: Literal["exposure"]
    frame: int = Field(0, ge=0)
    amplitude: float = Field(gt=0.0, le=0.9)
    period_s: float = Field(gt=0.05)


class NewObstacle(Section):
    """A box that was not in the empty room stands there from session frame `frame` on, or for `n_frames`."""

    kind: Literal["obstacle"]
    frame: int = Field(ge=0)
    n_frames: int | None = Field(None, ge=1)
    lower_m: Vector
    upper_m: Vector

    @model_validator(mode="after")
    def _not_empty(self) -> NewObstacle:
        if not all(a < b for a, b in zip(self.lower_m, self.upper_m, strict=True)):
            raise ValueError("lower_m must be below upper_m in every direction")
        return self


Fault: TypeAlias = Annotated[
    DroppedFrames
    | FrozenPicture
    | MovedCamera
    | LaggingCamera
    | ClockOffset
    | OtherRate
    | CameraOff
    | LightSwitch
    | Exposure
    | NewObstacle,
    Field(discriminator="kind"),
]

KINDS = ("dropped", "frozen", "moved", "lag", "offset", "rate", "off", "light", "exposure", "obstacle")


@dataclass(frozen=True, eq=False)
class Timeline:
    """What the pictures of one camera's file show, one row per frame of the file.

    shot : (F,) int, the camera's own count of the picture.  instant : (F,) session frame, fractional.
    pose : (F,) int, 0 = as calibrated, k = after the k-th move.  state : (F,) which of the room's changes hold, a bit
    each.
    gain : (F,) linear factor on the light.  is_off : (F,) bool.  fps : rate that the file states.
    """

    shot: NDArray[np.int64]
    instant: NDArray[np.float64]
    pose: NDArray[np.int64]
    state: NDArray[np.object_]
    gain: NDArray[np.float64]
    is_off: NDArray[np.bool_]
    fps: float

    def __len__(self) -> int:
        return len(self.shot)


def timeline(camera: str, faults: Sequence[Any], n_frames: int, fps: float) -> Timeline:
    """The pictures of one camera under the faults of a scene.

    Faults of one kind act in the order of the scene; files are cut and repeated last, as a recorder does it.
    """
    mine = [f for f in faults if getattr(f, "camera", camera) == camera]
    own_fps = next((f.fps for f in mine if f.kind == "rate"), fps)
    step = fps / own_fps
    n = _n_pictures(mine, n_frames, step)
    if n < 1:
        raise ValueError(f"camera {camera}: the faults leave no picture of {n_frames}")
    shot = _shots(mine, n)
    seconds = np.asarray(shot * step / fps, dtype=np.float64)
    instant = _instants(mine, shot, seconds, step, fps)
    return Timeline(
        shot,
        instant,
        pose=sum((shot >= f.frame for f in mine if f.kind == "moved"), np.zeros(n, dtype=np.int64)),
        state=_states(faults, instant),
        gain=_gains(mine, shot, instant, seconds, fps),
        is_off=sum((_between(shot, f) for f in mine if f.kind == "off"), np.zeros(n, dtype=bool)),
        fps=own_fps,
    )


def _n_pictures(mine: Sequence[Any], n_frames: int, step: float) -> int:
    """Length of the camera's file.  step : session frames from one of its pictures to the next."""
    is_cut = any(f.kind == "rate" and not f.refill for f in mine)
    n = int(np.floor((n_frames - 1) / step + 1e-9)) + 1 if is_cut else n_frames
    return n - sum(f.n_frames for f in mine if f.kind == "dropped" and not f.refill)


def _states(faults: Sequence[Any], instant: NDArray[np.float64]) -> NDArray[np.object_]:
    """Which of the room's changes hold at instants, as bit patterns: ints of any length."""
    state = np.zeros(len(instant), dtype=np.object_)
    for bit, fault in enumerate(room_faults(faults)):
        state += (1 << bit) * _between(instant, fault).astype(np.object_)
    return state


def _shots(mine: Sequence[Any], n: int) -> NDArray[np.int64]:
    """Which of its pictures the camera's file holds, (n,): some are lost, some repeated."""
    shot = np.arange(n, dtype=np.int64)
    for fault in mine:
        if fault.kind == "dropped":
            shot[fault.frame :] += fault.n_frames
    for fault in mine:
        if fault.kind == "frozen" and fault.frame < n:
            shot[fault.frame :][: fault.n_frames] = shot[fault.frame - 1]
    return shot


def _instants(
    mine: Sequence[Any], shot: NDArray[np.int64], seconds: NDArray[np.float64], step: float, fps: float
) -> NDArray[np.float64]:
    """The moments (n,) that shots show, session frames, by a clock that lags or drifts."""
    instant = np.asarray(shot * step, dtype=np.float64)
    for fault in mine:
        if fault.kind == "lag":
            instant -= np.where(shot >= fault.frame, fault.lag_frames, 0.0)
        elif fault.kind == "offset":
            instant += (fault.offset_s + seconds * fault.drift_ms_per_s / 1000) * fps
    return instant


def _gains(
    mine: Sequence[Any],
    shot: NDArray[np.int64],
    instant: NDArray[np.float64],
    seconds: NDArray[np.float64],
    fps: float,
) -> NDArray[np.float64]:
    """Linear factors (n,) on the light: of the camera's exposure, then of all lamps together."""
    gain = np.ones(len(shot))
    for fault in mine:
        if fault.kind == "exposure":
            swing = np.sin(2 * np.pi * (seconds - fault.frame / fps) / fault.period_s)
            gain *= np.where(shot >= fault.frame, 1 + fault.amplitude * swing, 1.0)
    for fault in mine:
        if fault.kind == "light" and fault.lamp is None:
            gain *= np.where(_between(instant, fault), fault.gain, 1.0)
    return gain


def _between(clock: NDArray, fault: Any) -> NDArray[np.bool_]:
    """Whether the fault holds: from its frame on, for its number of frames or to the end."""
    n = getattr(fault, "n_frames", None)
    return (clock >= fault.frame) & (clock < (np.inf if n is None else fault.frame + n))


def room_faults(faults: Sequence[Any]) -> list[Any]:
    """The faults that change the room itself; the states of a timeline are bit patterns over this list."""
    return [f for f in faults if f.kind == "obstacle" or (f.kind == "light" and f.lamp is not None)]


def moved_cameras(camera: Camera, faults: Sequence[Any]) -> tuple[Camera, ...]:
    """The camera as calibrated and after each of its moves, in the order of time."""
    moves = [f for f in faults if f.kind == "moved" and f.camera == camera.name]
    out = [camera]
    for fault in sorted(moves, key=lambda f: int(f.frame)):
        last = out[-1]
        R = Rotation.from_rotvec(np.deg2rad(fault.rotate_deg)).as_matrix().T @ last.R
        center = last.center + np.array(fault.shift_m)
        out.append(Camera(last.name, last.size, last.K, last.dist, R, -R @ center, last.is_fisheye))
    return tuple(out)


def find_mistakes(faults: Sequence[Any], names: Sequence[str], n_frames: int) -> list[str]:
    """What is wrong with the faults of a scene, each with its dotted path."""
    wrong = []
    for i, fault in enumerate(faults):
        camera = getattr(fault, "camera", None)
        if camera is not None and camera not in names:
            wrong.append(f"faults.{i}.camera: there is no camera {camera!r}; the rig has {', '.join(names)}")
        frame = getattr(fault, "frame", 0)
        if frame >= n_frames:
            wrong.append(f"faults.{i}.frame: {frame} is not within the scene's {n_frames} frames")
    for name in names:
        wrong += _mistakes_of_camera(
            name, [f for f in faults if getattr(f, "camera", None) == name], n_frames
        )
    return wrong


def _mistakes_of_camera(name: str, faults: Sequence[Any], n_frames: int) -> list[str]:
    """What does not go together among the faults of one camera."""
    wrong = []
    if sum(f.kind == "rate" for f in faults) > 1:
        wrong.append(f"faults: camera {name} has two rates")
    lost = sum(f.n_frames for f in faults if f.kind == "dropped")
    if lost >= n_frames:
        wrong.append(f"faults: camera {name} drops {lost} of {n_frames} frames")
    return wrong
