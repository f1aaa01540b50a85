"""The 3D scene of a run for Rerun: cameras, images, coloured voxels and bodies on a time line.

rerun-sdk is an optional extra (`view`) and is imported when the first scene is written. `write_rrd` writes a file: no
viewer opens and nothing is sent anywhere; `mocap.view.viewer` shows the same to a viewer.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import length_hint
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, CameraRig, Hull, Tracks, bones_between, landmark_names
from mocap.errors import MissingExtra, MocapError
from mocap.view.overlay import SIDE_COLOURS, BodyPart, person_colour, side_of_landmark

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

MAX_BYTES = 28_000_000
IMAGE_WIDTH = 480
TIMELINE = "frame"

_JPEG_QUALITY = 75
_BYTES_PER_VOXEL = 17  # position and colour as stored, with a little overhead
_BYTES_PER_PERSON = 6_000  # skeleton, capsules and labels of one frame
_IMAGE_SHARE = 0.6  # of what is left after the persons; the rest is for voxels
_MIN_VOXELS = 400
_MAX_VOXELS = 20_000
_DEFAULT_FRAMES = 300
_IMAGE_PLANE_M = 0.45
_FIRST_LAYER, _LAST_LAYER = (70, 120, 230), (240, 120, 30)
_PARTICLE_M = 0.006


@dataclass(frozen=True, eq=False)
class SceneFrame:
    """What is shown of one frame, but for its pictures.

    hull : world frame, or None.  persons : person -> landmarks (M, 3) m, world, NaN = unknown.
    parts : person -> fitted body parts.
    layers : person -> points (K, 3) m of the particles of every layer of the filter, first to last.
    """

    frame: int
    time_s: float
    hull: Hull | None = None
    persons: Mapping[int, Array] = field(default_factory=dict)
    parts: Mapping[int, Sequence[BodyPart]] = field(default_factory=dict)
    layers: Mapping[int, Sequence[Array]] = field(default_factory=dict)


@dataclass(frozen=True)
class CodedPictures:
    """The pictures of one frame.  files : camera name -> JPEG file, as `ScenePictures` codes it."""

    frame: int
    time_s: float
    files: Mapping[str, bytes]


def write_rrd(
    path: Path,
    rig: CameraRig,
    frames: Iterable[SceneFrame],
    *,
    pictures: Callable[[], Iterable[CodedPictures]] = tuple,
    tracks: Tracks | None = None,
    bounds_m: Sequence[Sequence[float]] | None = None,
    n_frames: int | None = None,
    max_bytes: int = MAX_BYTES,
) -> None:
    """Write a recording (.rrd) that the Rerun viewer opens; frames are taken one at a time.

    frames : ascending; none at all give the cameras alone.  pictures : gives those that are shown, once all else is
    written: they may still be in the making.  tracks : paths of the persons.  bounds_m : room.  n_frames : how many
    frames will come, if known: voxels are thinned so that the file stays below max_bytes, as `ScenePictures` does it
    with pictures.
    Raises MocapError when rerun-sdk is not installed or the file cannot be written.
    """
    rr = import_rerun(path=path)
    target = Path(path)
    part = target.with_name(target.name + ".part")
    count = n_frames or length_hint(frames, 0) or _DEFAULT_FRAMES
    # At most max_bytes are collected in memory and written by us: rerun's own file sink waits for ever when the disk
    # is full.
    stream = rr.RecordingStream("mocap", recording_id=target.stem, send_properties=False)
    sink = stream.binary_stream()
    try:
        part.write_bytes(b"")  # an unwritable folder is noticed before the work
        try:
            log = SceneLog(stream, rig, _HullBudget(max_bytes, count), tracks=tracks, bounds_m=bounds_m)
            for item in frames:
                log.put(item)
            for coded in pictures():
                log.put_pictures(coded)
            part.write_bytes(sink.read() or b"")
        finally:
            stream.disconnect()
        os.replace(part, target)
    except OSError as error:
        raise MocapError(
            f"the 3D scene cannot be written: {error.strerror or error}",
            remedy="choose an output folder that exists, is writable and has space left",
            path=target,
        ) from error
    finally:
        if part.exists():
            part.unlink()


class SceneLog:
    """A scene that goes into a stream of rerun frame by frame, cameras and room at once.

    budget : of the voxels; None = all are shown.
    """

    def __init__(
        self,
        stream: Any,
        rig: CameraRig,
        budget: _HullBudget | None = None,
        *,
        tracks: Tracks | None = None,
        bounds_m: Sequence[Sequence[float]] | None = None,
    ) -> None:
        self._rr, self._stream, self._rig = import_rerun(), stream, rig
        self._budget = budget or _HullBudget(math.inf, 1)
        self._shown: set[int] = set()
        self._has_layers = False
        stream.send_blueprint(_blueprint(rig), make_active=True, make_default=True)
        _log_static(self._rr, stream, rig, tracks, bounds_m)

    def put(self, item: SceneFrame) -> None:
        """One more frame."""
        rr, stream = self._rr, self._stream
        _set_time(stream, item)
        _log_persons(rr, stream, item, self._shown)
        self._has_layers = _log_layers(rr, stream, item, self._has_layers)
        _log_hull(rr, stream, item.hull, self._budget)

    def put_pictures(self, coded: CodedPictures) -> None:
        """The pictures of a frame."""
        _set_time(self._stream, coded)
        _log_pictures(self._rr, self._stream, self._rig, coded)


def _set_time(stream: Any, item: SceneFrame | CodedPictures) -> None:
    stream.set_time(TIMELINE, sequence=int(item.frame))
    stream.set_time("time", duration=float(item.time_s))


def _rest(max_bytes: float, n_frames: int) -> float:
    """Bytes that bodies leave for pictures and voxels; bodies are always written."""
    return max(0.15 * max_bytes, max_bytes - 1.5 * _BYTES_PER_PERSON * n_frames)


class _HullBudget:
    """How many bytes the voxels may still take, so that a long session does not make a huge file."""

    def __init__(self, max_bytes: float, n_frames: int) -> None:
        self._left = (1 - _IMAGE_SHARE) * _rest(max_bytes, n_frames)
        voxels = self._left / n_frames / _BYTES_PER_VOXEL
        self.voxels_per_frame = int(np.clip(voxels, _MIN_VOXELS, _MAX_VOXELS))

    def takes(self, n_voxels: int) -> bool:
        cost = n_voxels * _BYTES_PER_VOXEL
        if cost > self._left:
            return False
        self._left -= cost
        return True


class ScenePictures:
    """Codes pictures as the scene shows them, no more than fit: small, and undistorted, because the viewer's camera
    model is the pinhole; those of fisheye cameras keep what a pinhole of the same matrix can show.

    n_frames : of the scene.  n_others : persons beyond the first, of all frames together; they take their bytes from
    the pictures.
    """

    def __init__(
        self, rig: CameraRig, n_frames: int, *, n_others: int = 0, max_bytes: float = MAX_BYTES
    ) -> None:
        self._lenses = {camera.name: _Lens.of(camera, IMAGE_WIDTH) for camera in rig}
        self._n_frames = n_frames
        self._left = _IMAGE_SHARE * _rest(max_bytes, n_frames) - n_others * _BYTES_PER_PERSON

    def stride(self, pictures: Mapping[str, Image]) -> int:
        """How many frames one with pictures stands for, by what those of one frame take."""
        cost = sum(len(file) for file in self._coded(pictures).values())
        return max(1, int(np.ceil(cost * self._n_frames / max(self._left, 1.0))))

    def fitting(self, pictures: Mapping[str, Image]) -> dict[str, bytes] | None:
        """The files of one frame, or None when there is no more room for them.

        pictures : camera name -> (H, W, 3) uint8 RGB as filmed.
        """
        files = self._coded(pictures)
        cost = sum(len(file) for file in files.values())
        if cost > self._left:
            return None
        self._left -= cost
        return files

    def _coded(self, pictures: Mapping[str, Image]) -> dict[str, bytes]:
        return {name: _jpeg(self._lenses[name].apply(image), name) for name, image in pictures.items()}


def _jpeg(image: Image, name: str) -> bytes:
    quality = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    ok, data = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), quality)
    if not ok:
        raise ValueError(f"the image of {name!r} cannot be coded as JPEG")
    return bytes(data.tobytes())


@dataclass(frozen=True, eq=False)
class _Pinhole:
    """The camera of a small undistorted picture, (width, height) px and matrix."""

    size: tuple[int, int]
    K: Array

    @classmethod
    def of(cls, camera: Camera, width: int) -> _Pinhole:
        w, h = camera.size
        scale = min(1.0, width / w)
        size = (max(1, round(w * scale)), max(1, round(h * scale)))
        # pixel centres are whole numbers, hence the half pixel around the scaling
        zoom = np.diag([size[0] / w, size[1] / h, 1.0])
        half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])
        return cls(size, np.linalg.inv(half) @ zoom @ half @ camera.K)


@dataclass(frozen=True, eq=False)
class _Lens:
    """Maps a camera's picture to the small undistorted one that is shown."""

    map_uv: NDArray[np.int16]  # fixed point takes two thirds of the time of floats
    map_share: NDArray[np.uint16]

    @classmethod
    def of(cls, camera: Camera, width: int) -> _Lens:
        shown = _Pinhole.of(camera, width)
        if camera.is_fisheye:
            dist = np.zeros(4)
            dist[: min(4, len(camera.dist))] = camera.dist[:4]
            maps = cv2.fisheye.initUndistortRectifyMap(
                camera.K, dist, np.eye(3), shown.K, shown.size, cv2.CV_32FC1
            )
        else:
            maps = cv2.initUndistortRectifyMap(
                camera.K, camera.dist, np.eye(3), shown.K, shown.size, cv2.CV_32FC1
            )
        return cls(*cv2.convertMaps(*maps, cv2.CV_16SC2))  # type: ignore[arg-type]

    def apply(self, image: Image) -> Image:
        return np.asarray(cv2.remap(image, self.map_uv, self.map_share, cv2.INTER_LINEAR), dtype=np.uint8)


def import_rerun(otherwise: str = "leave the scene out", *, path: Path | None = None) -> Any:
    """The package rerun. Raises MissingExtra with what can be done without it, and the path that was to be written."""
    try:
        import rerun
    except ImportError as error:
        raise MissingExtra(
            "the 3D scene needs rerun-sdk, which is not installed",
            "view",
            otherwise=otherwise,
            path=path,
        ) from error
    return rerun


def _blueprint(rig: CameraRig) -> Any:
    import rerun.blueprint as rrb

    # Persons are drawn over every picture: the viewer projects them through its camera.
    pictures = [
        rrb.Spatial2DView(origin=_camera_path(c), name=c.name, contents=["$origin/**", "/world/persons/**"])
        for c in rig
    ]
    half = (len(pictures) + 1) // 2
    scene = rrb.Spatial3DView(origin="world", name="scene")
    columns = [rrb.Vertical(*pictures[:half]), scene, rrb.Vertical(*pictures[half:])]
    return rrb.Blueprint(
        rrb.Horizontal(*columns, column_shares=[1, 3, 1]),
        rrb.TimePanel(state="collapsed"),
        collapse_panels=True,
    )


def _camera_path(camera: Camera) -> str:
    return f"world/cameras/{camera.name}"


def _log_static(
    rr: Any,
    stream: Any,
    rig: CameraRig,
    tracks: Tracks | None,
    bounds_m: Sequence[Sequence[float]] | None,
) -> None:
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    note = (
        "# mocap\n\nMetres, z up, floor z = 0. Images are undistorted to the pinhole model of their camera."
    )
    stream.log("about", rr.TextDocument(note, media_type="text/markdown"), static=True)
    for camera in rig:
        _log_camera(rr, stream, camera)
    if bounds_m is not None:
        lower, upper = (np.asarray(b, dtype=np.float64) for b in bounds_m)
        box = rr.Boxes3D(mins=[lower], sizes=[upper - lower], colors=[[140, 148, 158]], radii=[0.004])
        stream.log("world/room", box, static=True)
        stream.log("world/floor", _floor(rr, lower, upper), static=True)
    if tracks is not None and len(tracks):
        _log_tracks(rr, stream, tracks)


def _log_camera(rr: Any, stream: Any, camera: Camera) -> None:
    shown = _Pinhole.of(camera, IMAGE_WIDTH)
    centred = shown.K.copy()
    centred[:2, 2] += 0.5  # the viewer counts from the corner of the first pixel
    stream.log(
        _camera_path(camera),
        rr.Transform3D(translation=camera.center, mat3x3=camera.R.T),
        rr.Pinhole(image_from_camera=centred, resolution=shown.size, image_plane_distance=_IMAGE_PLANE_M),
        static=True,
    )


def _log_tracks(rr: Any, stream: Any, tracks: Tracks) -> None:
    """The whole path of every person, in pieces where somebody was away."""
    for person in tracks.persons:
        known = [piece.xyz[np.isfinite(piece.xyz).all(axis=1)] for piece in tracks.paths(person)]
        pieces = [path for path in known if len(path) > 1]
        if pieces:
            line = rr.LineStrips3D(pieces, colors=[person_colour(person)] * len(pieces), radii=[0.008])
            stream.log(f"world/tracks/person_{person}", line, static=True)


def _floor(rr: Any, lower: Array, upper: Array) -> Any:
    xs = np.arange(np.ceil(lower[0]), np.floor(upper[0]) + 1)
    ys = np.arange(np.ceil(lower[1]), np.floor(upper[1]) + 1)
    lines = [[[x, lower[1], 0.0], [x, upper[1], 0.0]] for x in xs]
    lines += [[[lower[0], y, 0.0], [upper[0], y, 0.0]] for y in ys]
    return rr.LineStrips3D(lines, colors=[[110, 118, 128]], radii=[0.003])


def _log_persons(rr: Any, stream: Any, item: SceneFrame, shown: set[int]) -> None:
    for gone in shown - set(item.persons) - set(item.parts):
        stream.log(f"world/persons/{gone}", rr.Clear(recursive=True))
    shown.intersection_update({*item.persons, *item.parts})
    for person, landmarks in item.persons.items():
        shown.add(person)
        _log_landmarks(rr, stream, person, np.asarray(landmarks, dtype=np.float64))
    for person, parts in item.parts.items():
        shown.add(person)
        stream.log(f"world/persons/{person}/body", _capsules(rr, parts))


def _log_landmarks(rr: Any, stream: Any, person: int, points: Array) -> None:
    """Bones, joints and number of a person.  points : (M, 3) m, NaN = unknown."""
    base = f"world/persons/{person}"
    known = np.asarray(np.isfinite(points).all(axis=1))
    names = landmark_names(len(points))
    bones = [ab for ab in bones_between(len(points)) if known[list(ab)].all()]
    sides = [side_of_landmark(names[b]) for _, b in bones]
    strips = [points[list(ab)] for ab in bones]
    line = rr.LineStrips3D(strips, colors=[SIDE_COLOURS[s] for s in sides], radii=[0.012])
    stream.log(f"{base}/skeleton", line)
    joints = rr.Points3D(points[known], colors=[person_colour(person)], radii=[0.022])
    stream.log(f"{base}/joints", joints)
    if known.any():
        top = points[known][np.argmax(points[known, 2])] + (0.0, 0.0, 0.15)
        label = rr.Points3D([top], labels=[f"person {person}"], colors=[person_colour(person)], radii=[0.01])
        stream.log(f"{base}/label", label)


def _log_layers(rr: Any, stream: Any, item: SceneFrame, has_layers: bool) -> bool:
    """The particles of every layer as points of their own, the later the warmer; gives whether there are any."""
    if has_layers:
        stream.log("world/particles", rr.Clear(recursive=True))
    for person, layers in item.layers.items():
        for k, points in enumerate(layers):
            share = k / max(len(layers) - 1, 1)
            colour = np.round((1 - share) * np.array(_FIRST_LAYER) + share * np.array(_LAST_LAYER)).astype(
                int
            )
            cloud = rr.Points3D(points, colors=[colour.tolist()], radii=[_PARTICLE_M])
            stream.log(f"world/particles/person_{person}/layer_{k + 1:02d}", cloud)
    return bool(item.layers)


def _capsules(rr: Any, parts: Sequence[BodyPart]) -> Any:
    """Truncated cones as capsules of their mean radius: the viewer knows no cones."""
    starts, lengths, radii, turns, colours = [], [], [], [], []
    for part in parts:
        for p0, p1, r0, r1 in part.cones:
            axis = np.asarray(p1, dtype=np.float64) - np.asarray(p0, dtype=np.float64)
            length = float(np.linalg.norm(axis))
            if not np.isfinite(length + r0 + r1) or not np.isfinite(p0).all():
                continue
            starts.append(np.asarray(p0, dtype=np.float64))
            lengths.append(length)
            radii.append(0.5 * (r0 + r1))
            turns.append(_turn_from_z(axis / length) if length > 1e-9 else (0.0, 0.0, 0.0, 1.0))
            colours.append((*SIDE_COLOURS[part.side], 150))
    return rr.Capsules3D(translations=starts, lengths=lengths, radii=radii, quaternions=turns, colors=colours)


def _turn_from_z(direction: Array) -> tuple[float, float, float, float]:
    """Quaternion (x, y, z, w) of the shortest rotation from +z to a unit direction (3,)."""
    w = 1.0 + float(direction[2])
    if w < 1e-9:
        return (1.0, 0.0, 0.0, 0.0)
    q = np.array([-direction[1], direction[0], 0.0, w])
    q /= np.linalg.norm(q)
    return (float(q[0]), float(q[1]), float(q[2]), float(q[3]))


def _log_hull(rr: Any, stream: Any, hull: Hull | None, budget: _HullBudget) -> None:
    """Surface voxels in their colour; evenly thinned, and then larger, when there are too many."""
    surface = None if hull is None else hull.select(hull.is_surface)
    if surface is None or len(surface) == 0:
        stream.log("world/hull", rr.Clear(recursive=False))
        return
    step = max(1, int(np.ceil(len(surface) / budget.voxels_per_frame)))
    chosen = np.arange(0, len(surface), step)
    if not budget.takes(len(chosen)):
        stream.log("world/hull", rr.Clear(recursive=False))
        return
    rgb = np.where((surface.n_views > 0)[:, None], surface.rgb, np.uint8(150))[chosen]
    radius = 0.55 * surface.grid.voxel_size_m * np.sqrt(step)
    stream.log("world/hull", rr.Points3D(surface.centers[chosen], colors=rgb, radii=[radius]))


def _log_pictures(rr: Any, stream: Any, rig: CameraRig, coded: CodedPictures) -> None:
    for name, content in coded.files.items():
        if name not in rig.names:
            raise ValueError(f"frame {coded.frame} has an image of {name!r}, which is not in the rig")
        stream.log(f"world/cameras/{name}", rr.EncodedImage(contents=content, media_type="image/jpeg"))
