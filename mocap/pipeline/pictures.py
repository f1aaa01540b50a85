"""Pictures of a run for all that shows them: the clips are read once, and kept as small as they are shown."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera
from mocap.io.session.reading import pictures_of
from mocap.pipeline.config import OutputConfig
from mocap.pipeline.record import Found
from mocap.pipeline.scene_frames import body_parts, rows_at, shown_frames
from mocap.threads import in_parallel
from mocap.view.overlay import BodyPart, draw_limbs
from mocap.view.replay import webp
from mocap.view.scene import CodedPictures, ScenePictures

Image = NDArray[np.uint8]
Frames = NDArray[np.int64]

# Of the pictures in the page, as base64: what is left of 5 MB for ten seconds after scene, curves and plots.
PICTURE_BYTES = 3_200_000
# (width px, quality) of a camera's picture in a sheet; the first whose pictures of all frames fit is taken, and of the
# last one as many frames as fit.
_SIZES = ((160, 40), (144, 35), (128, 30), (112, 25))
_BASE64 = 4.0 / 3.0
# By how much pictures may be heavier than the first one is, before sheets of half of the frames are taken out again.
_HEAVIER = 1.15


@dataclass(frozen=True, eq=False)
class Sheets:
    """The small pictures of all cameras side by side, a file per frame.

    frames : (N,).  files : N of them, WebP.  tiles : per camera (left, top, width, height) px in a sheet.
    """

    frames: Frames = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    files: tuple[bytes, ...] = ()
    tiles: tuple[tuple[int, int, int, int], ...] = ()


@dataclass(frozen=True, eq=False)
class RunPictures:
    """What is shown of the clips.

    whole : frame -> camera -> picture as filmed, of the few frames that the report shows large.  sheets : for its
    replay.  scene : for the 3D scene, by frame.
    """

    whole: Mapping[int, Mapping[str, Image]] = field(default_factory=dict)
    sheets: Sheets = field(default_factory=Sheets)
    scene: tuple[CodedPictures, ...] = ()


def read_pictures(
    found: Found,
    *,
    report: OutputConfig | None = None,
    scene: Sequence[str] | None = (),
    sheet_bytes: int = PICTURE_BYTES,
    n_threads: int = 1,
) -> RunPictures:
    """Read the clips of a run once, for its report, its 3D scene or both.

    report : settings of the report that is to be made; None = of none.  scene : cameras whose pictures the scene
    shows, None = all.  sheet_bytes : what the sheets may take in the page.  n_threads : the result does not depend on
    it. A session without pictures has grey ones in the report, and none else.
    """
    session = found.session
    frames = np.array(shown_frames(session.frames), dtype=np.int64)
    whole = set(whole_frames(found, report)) if report is not None else set()
    in_scene = tuple(name for name in session.rig.names if scene is None or name in scene)
    names = session.rig.names if report is not None else in_scene
    if not session.image_sources or not names or not len(frames):
        return RunPictures({frame: _grey(found) for frame in whole})
    ((_, first),) = _read(found, frames[:1].tolist(), names)
    sheets = _Sheets(found, frames, first, sheet_bytes) if report is not None else None
    shown = _Scene(found, frames, in_scene, first) if in_scene else None
    viewers: list[_Sheets | _Scene] = [viewer for viewer in (sheets, shown) if viewer is not None]
    wanted = sorted(whole.union(*(viewer.frames.tolist() for viewer in viewers)))
    kept = {}
    for frame, pictures in _read(found, wanted, names):
        if frame in whole:
            kept[frame] = pictures
        turns = [partial(viewer.see, frame, pictures) for viewer in viewers if frame in viewer.frames]
        in_parallel(lambda see: see(), turns, n_threads)
    return RunPictures(
        kept,
        Sheets() if sheets is None else sheets.fitting(sheet_bytes),
        () if shown is None else tuple(shown.coded),
    )


def _read(
    found: Found, frames: Sequence[int], names: Sequence[str]
) -> Iterator[tuple[int, dict[str, Image]]]:
    """Ascending frames with the pictures of some cameras."""
    with pictures_of(found.session, frames, names) as reader:
        for frame, images in reader:
            yield frame, dict(zip(names, images, strict=True))


def _grey(found: Found) -> dict[str, Image]:
    """What is drawn on where the session has only masks."""
    return {c.name: np.full((c.size[1], c.size[0], 3), 90, dtype=np.uint8) for c in found.session.rig}


def whole_frames(found: Found, settings: OutputConfig) -> list[int]:
    """The frames that the report shows large: some in which somebody was found, and the first."""
    frames = found.session.frames
    return sorted({*chosen_frames(found, settings.report_frames), *frames[:1]})


def chosen_frames(found: Found, n: int) -> list[int]:
    """Frames evenly spread over those in which somebody was found, or over the clip."""
    seen = sorted({int(f) for p in found.poses for f in p.frames})
    pool = seen or list(found.session.frames)
    return [pool[i] for i in np.unique(np.linspace(0, len(pool) - 1, n).round().astype(int))]


class _Layout:
    """Small pictures of all cameras side by side in one file."""

    def __init__(self, cameras: Sequence[Camera], width: int, quality: int) -> None:
        self._quality = quality
        self._cameras = tuple(_scaled(camera, width) for camera in cameras)
        n_columns = int(np.ceil(np.sqrt(len(cameras))))
        height = max(camera.size[1] for camera in self._cameras)
        self.tiles = tuple(
            ((i % n_columns) * width, (i // n_columns) * height, *camera.size)
            for i, camera in enumerate(self._cameras)
        )
        self._size = (n_columns * width, -(-len(cameras) // n_columns) * height)

    def drawn(self, pictures: Mapping[str, Image], parts: Sequence[BodyPart]) -> bytes:
        """The file of one frame.  pictures : by camera, as filmed.  parts : of all persons."""
        sheet = np.zeros((self._size[1], self._size[0], 3), dtype=np.uint8)
        for camera, (x, y, w, h) in zip(self._cameras, self.tiles, strict=True):
            small = cv2.resize(pictures[camera.name], (w, h), interpolation=cv2.INTER_AREA)
            sheet[y : y + h, x : x + w] = draw_limbs(np.asarray(small, dtype=np.uint8), camera, parts)
        return webp(sheet, self._quality)


def _scaled(camera: Camera, width: int) -> Camera:
    """The camera of a picture that was scaled to a width."""
    w, h = camera.size
    size = (width, max(1, round(h * width / w)))
    K = camera.K.copy()
    for axis, (new, old) in enumerate(zip(size, (w, h), strict=True)):
        K[axis] *= new / old
        K[axis, 2] += 0.5 * new / old - 0.5
    return replace(camera, K=K, size=size)


class _Scene:
    """Codes the pictures that the 3D scene shows."""

    def __init__(
        self, found: Found, frames: Frames, names: Sequence[str], first: Mapping[str, Image]
    ) -> None:
        bodies = np.concatenate([np.zeros(0, dtype=np.int64), *(p.frames for p in found.poses)])
        present = np.isin(bodies, frames)
        others = int(present.sum()) - len(np.unique(bodies[present]))
        self._names, self._fps = tuple(names), found.session.fps
        self._coder = ScenePictures(found.session.rig.subset(names), len(frames), n_others=others)
        self.frames = frames[:: self._coder.stride(self._of(first))]
        self.coded: list[CodedPictures] = []

    def _of(self, pictures: Mapping[str, Image]) -> dict[str, Image]:
        return {name: pictures[name] for name in self._names}

    def see(self, frame: int, pictures: Mapping[str, Image]) -> None:
        files = self._coder.fitting(self._of(pictures))
        if files is not None:
            self.coded.append(CodedPictures(frame, frame / self._fps, files))


class _Sheets:
    """Draws sheets, with the bodies in them, as large as they may be for all frames to fit."""

    def __init__(self, found: Found, frames: Frames, first: Mapping[str, Image], limit: int) -> None:
        self._found = found
        self._files: list[bytes] = []
        for width, quality in _SIZES:
            self._layout = _Layout(found.session.rig.cameras, width, quality)
            each = _BASE64 * _HEAVIER * len(self._sheet(int(frames[0]), first))
            if each * len(frames) <= limit:
                break
        self.frames = frames[:: max(1, int(np.ceil(each * len(frames) / limit)))]

    def _sheet(self, frame: int, pictures: Mapping[str, Image]) -> bytes:
        parts = [
            part for p, i in rows_at(self._found.poses, frame) for part in body_parts(p.body, p.states[i])
        ]
        return self._layout.drawn(pictures, parts)

    def see(self, frame: int, pictures: Mapping[str, Image]) -> None:
        self._files.append(self._sheet(frame, pictures))

    def fitting(self, limit: int) -> Sheets:
        """The sheets of all frames, or of as many as fit when later ones are heavier than the first."""
        frames, files = self.frames, self._files
        while len(files) > 1 and _BASE64 * sum(len(file) for file in files) > limit:
            frames, files = frames[::2], files[::2]
        return Sheets(frames, tuple(files), self._layout.tiles)
