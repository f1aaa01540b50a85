"""Pictures and masks from videos, folders and archives: sequential, constant memory, checked at every frame."""

from __future__ import annotations

import os
import queue
import re
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, Protocol, TypeVar

# FFmpeg writes a line per damaged macroblock to the terminal; what matters of it becomes a MocapError.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import largest_channel
from mocap.data import Camera, CameraRig
from mocap.data.depth import DepthUnits
from mocap.errors import MocapError
from mocap.files import array_names, check_regular, load_arrays, read_head
from mocap.io._files import IMAGE_SUFFIXES, VIDEO_SUFFIXES, natural_key
from mocap.io._picture_header import has_its_chunks, size_in_header
from mocap.io.clip_frames import ClipFrames
from mocap.portable import utf8_name

# The same for OpenCV's own warnings about files that it cannot open.
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]
DepthMap = NDArray[np.float32]
Picture = TypeVar("Picture", bound=NDArray[Any])
Picture_co = TypeVar("Picture_co", bound=NDArray[Any], covariant=True)
Size = tuple[int, int]

# Frames decoded ahead of the consumer, per worker.
READ_AHEAD_FRAMES = 2
MASK_THRESHOLD = 127
SAME_RATE = 1e-3  # headers round: 29.97 and 29.98 are one rate
# Up to here a header that lies is answered by counting every frame (0.3 ms each at 640 x 480).
COUNT_BY_GRABBING_FRAMES = 20_000
# 134 million pixels, more than any camera that films; decoded they take 400 MB.
MOST_PIXELS = 2**27
# Read of a picture to learn its size; headers of all kinds but JPEG with previews lie within.
HEADER_BYTES = 2**16
PICTURE_LIMIT_BYTES = 2**30
_REMEDY_CUT = "leave the damaged part out with `--frames a:b`, or copy the file again"


@dataclass(frozen=True)
class ClipInfo:
    """What a source holds, without having decoded all of it.

    n_frames : frames that can be decoded.  header_frames : what the video header promises, None for folders.
    size : (width, height) px.  fps : of the video header, None when there is none.
    """

    path: Path
    n_frames: int
    size: Size
    fps: float | None
    header_frames: int | None = None


def clip_info(path: Path | str, *, camera: str = "", size: Size | None = None) -> ClipInfo:
    """Count and measure a video, folder of chapters or of pictures, single picture or mask archive, cheaply.

    size : (width, height) px that its first picture must have, checked before it is decoded; None = any.
    A video's header is believed only when its last frame can be decoded; otherwise the frames are counted.
    Raises MocapError when the file is missing, unreadable, or holds no frame.
    """
    path = Path(path)
    if path.suffix.lower() == ".npz":
        masks = _npz_masks(path, camera)
        return ClipInfo(path, masks.n_frames, masks.size, None)
    if chapters := list_chapters(path):
        return _info_of_chapters(path, chapters, camera)
    if path.is_dir() or path.suffix.lower() in IMAGE_SUFFIXES:
        files = list_pictures(path) if path.is_dir() else [path]
        if not files:
            raise _empty(path, camera)
        picture = _read_picture(files[0], camera, 0, size)
        return ClipInfo(path, len(files), (picture.shape[1], picture.shape[0]), None)
    return _video_info(path, camera, _stamp(path, camera))


def promised_size(path: Path, *, camera: str = "", frame: int | None = None) -> Size:
    """(width, height) px that the header of a picture promises, without decoding it.

    Raises MocapError for a file that cannot be read and for what is no picture.
    """
    data = _bytes_of_picture(path, camera, frame, HEADER_BYTES)
    size = size_in_header(data)
    if size is None and len(data) == HEADER_BYTES:
        # The header of a JPEG may lie behind previews and profiles of any length.
        size = size_in_header(_bytes_of_picture(path, camera, frame, PICTURE_LIMIT_BYTES))
    if size is None:
        raise _unreadable("picture", path, camera, frame)
    return size


def list_pictures(folder: Path) -> list[Path]:
    """Pictures of a folder in natural order (frame_2 before frame_10); hidden files are left out."""
    files = [p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith(".")]
    return sorted(files, key=lambda p: natural_key(p.name))


def list_chapters(path: Path) -> list[Path]:
    """The videos of a folder in natural order: chapters into which a camera has cut one recording. None of a file."""
    if not path.is_dir():
        return []
    files = [p for p in path.iterdir() if p.suffix.lower() in VIDEO_SUFFIXES and not p.name.startswith(".")]
    return sorted(files, key=lambda p: natural_key(p.name))


def _info_of_chapters(folder: Path, chapters: Sequence[Path], camera: str) -> ClipInfo:
    """What chapters hold together. Raises MocapError for those of another size or rate than the first."""
    infos = [clip_info(chapter, camera=camera) for chapter in chapters]
    first = infos[0]
    for info in infos[1:]:
        if info.size != first.size:
            raise size_error(info.size, first.size, info.path, camera)
        if abs((info.fps or 0.0) - (first.fps or 0.0)) > SAME_RATE * (first.fps or 1.0):
            raise MocapError(
                f"the chapter has {info.fps or 0:g} frames per second, {first.path.name} has {first.fps or 0:g}",
                path=info.path,
                camera=camera or None,
                remedy="keep only chapters of one recording in a folder",
            )
    headers = [info.header_frames for info in infos if info.header_frames is not None]
    header = sum(headers) if len(headers) == len(infos) else None
    return ClipInfo(folder, sum(info.n_frames for info in infos), first.size, first.fps, header)


def iter_clip(path: Path | str, *, size: Size | None = None, camera: str = "") -> Iterator[Image]:
    """RGB pictures (H, W, 3) uint8 of a video, folder of chapters or pictures, or one picture, from first to last.

    size : (width, height) px that every picture must have; None = whatever the first one has.
    Raises MocapError when nothing can be read or a size differs.
    """
    path = Path(path)
    clip = _open_images(path, camera, size)
    try:
        frame = 0
        while (image := clip.read(frame)) is not None:
            yield image
            frame += 1
        if frame == 0:
            raise _empty(path, camera)
    finally:
        clip.close()


def iter_camera(path: Path | str, camera: Camera) -> Iterator[Image]:
    """The pictures of a camera's clip as `iter_clip` gives them, in the camera's size."""
    for picture in iter_clip(path, size=camera.filmed_size or camera.size, camera=camera.name):
        yield in_size_of(camera, picture)


def in_size_of(camera: Camera, picture: Picture) -> Picture:
    """A picture (H, W, 3) uint8, or a mask (H, W) bool, as filmed, in the size of a camera: each of its pixels is the
    mean of a square, of a mask what most of it is."""
    if camera.filmed_size is None:
        return picture
    step = camera.filmed_size[0] // camera.size[0]
    width, height = camera.size
    whole = picture[: step * height, : step * width]
    if whole.dtype != np.bool_:
        return cv2.resize(whole, camera.size, interpolation=cv2.INTER_AREA)  # type: ignore[return-value]
    share = cv2.resize(whole.astype(np.float32), camera.size, interpolation=cv2.INTER_AREA)
    return share >= 0.5  # type: ignore[return-value]


def _check_order(sources: Mapping[str, Path], rig: CameraRig, frames: Sequence[int]) -> None:
    if missing := [n for n in rig.names if n not in sources]:
        raise ValueError(f"sources lacks cameras of the rig: {', '.join(missing)}")
    is_ascending = frames.step >= 1 if isinstance(frames, range) else all(a < b for a, b in pairwise(frames))
    if frames and (frames[0] < 0 or not is_ascending):
        raise ValueError(f"frames must be ascending from 0 on, got {frames}")


class _Reader(ABC, Generic[Picture]):
    """Synchronised reading of all cameras of a rig; the pictures of frame f come in the order of the rig."""

    def __init__(
        self,
        sources: Mapping[str, Path],
        rig: CameraRig,
        frames: Sequence[int],
        *,
        clip_frames: ClipFrames | None = None,
        n_workers: int | None = None,
    ) -> None:
        _check_order(sources, rig, frames)
        self.frames = frames
        self._clip_frames = [(clip_frames or {}).get(n) for n in rig.names]
        self._names = rig.names
        self._cameras = list(rig)
        self._sources = [Path(sources[n]) for n in rig.names]
        # Decoding releases the interpreter; more threads than cores only take memory.
        self._n_workers = min(len(rig), n_workers if n_workers is not None else min(4, os.cpu_count() or 1))
        self._workers: list[_Worker[Picture]] = []

    def __len__(self) -> int:
        return len(self.frames)

    def __enter__(self) -> _Reader[Picture]:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop reading ahead and close the files."""
        for worker in self._workers:
            worker.stop()
        self._workers = []

    def __iter__(self) -> Iterator[tuple[int, tuple[Picture, ...]]]:
        """(frame index, one picture per camera in rig order); every iteration starts from the first frame."""
        self.close()
        if not self.frames:
            return
        n = max(1, self._n_workers)
        groups = [range(k, len(self._names), n) for k in range(n)]
        self._workers = workers = [_Worker(self, group) for group in groups]
        try:
            for frame in self.frames:
                yield frame, _gathered(workers)
        finally:
            for worker in workers:
                worker.stop()

    def _filmed_size(self, camera: int) -> Size:
        """The size that the pictures of one camera must have in their files."""
        return self._cameras[camera].filmed_size or self._cameras[camera].size

    @abstractmethod
    def _open(self, camera: int) -> _Clip[Picture]:
        """The clip of one camera, by its place in the rig."""

    def _in_size(self, camera: int, picture: Picture) -> Picture:
        """A picture of one camera as filmed, in the camera's size."""
        return in_size_of(self._cameras[camera], picture)


class FrameReader(_Reader[Image]):
    """Reads the pictures of all cameras frame by frame: iterate for (frame, tuple of (H, W, 3) uint8 RGB).

    sources : camera name -> video, folder of chapters or of pictures, or single picture.  frames : of the session.
    clip_frames : camera name -> the picture of its source, from 0, that shows each frame; None = picture k shows
    frame k.  n_workers : decoding threads (the result does not depend on it).
    Raises MocapError with camera and frame for a picture that cannot be read or has another size than the
    calibration.
    """

    def __enter__(self) -> FrameReader:
        return self

    def _open(self, camera: int) -> _Clip[Image]:
        return _open_images(self._sources[camera], self._names[camera], self._filmed_size(camera))


class MaskReader(_Reader[Mask]):
    """Reads foreground masks like FrameReader: iterate for (frame, tuple of (H, W) bool).

    sources : camera name -> folder of pictures, video, or .npz with the camera's name or `masks` as key:
    (T, H, W), or packed along the last axis (T, H, ceil(W / 8)).  In PNG and the like every value but 0 is
    foreground; in videos and JPEG, whose zeros are noisy, every value above 127.
    """

    def __enter__(self) -> MaskReader:
        return self

    def _open(self, camera: int) -> _Clip[Mask]:
        path, name, size = self._sources[camera], self._names[camera], self._filmed_size(camera)
        if path.suffix.lower() == ".npz":
            return _NpzMasks(path, name, size)
        return _MaskClip(path, name, size)


class DepthReader(_Reader[DepthMap]):
    """Reads depth maps like FrameReader: iterate for (frame, tuple of (H, W) float32 m, 0 = no reading).

    sources : camera name -> folder of 16-bit grey PNG.  units : what their numbers and pixels are.
    Every pixel of a camera takes the reading at its middle: means would mix what lies one behind the other.
    Raises MocapError also for pictures that are no depth maps.
    """

    def __init__(
        self,
        sources: Mapping[str, Path],
        rig: CameraRig,
        frames: Sequence[int],
        units: DepthUnits,
        *,
        clip_frames: ClipFrames | None = None,
    ) -> None:
        super().__init__(sources, rig, frames, clip_frames=clip_frames)
        self._units = units

    def __enter__(self) -> DepthReader:
        return self

    def _open(self, camera: int) -> _Clip[DepthMap]:
        size = self._units.size_of(self._filmed_size(camera))
        return _DepthClip(self._sources[camera], self._names[camera], size, self._units.unit_mm)

    def _in_size(self, camera: int, picture: DepthMap) -> DepthMap:
        own = self._cameras[camera]
        width, height = own.size
        step = (own.filmed_size or own.size)[0] // width * self._units.scale
        # A map of half as many pixels may lack half a pixel at its ends.
        rows = np.minimum((np.arange(height) + 0.5) * step, picture.shape[0] - 1).astype(np.int64)
        columns = np.minimum((np.arange(width) + 0.5) * step, picture.shape[1] - 1).astype(np.int64)
        return np.asarray(picture[np.ix_(rows, columns)])


class _Failure:
    def __init__(self, camera: int, error: Exception) -> None:
        self.camera = camera
        self.error = error


class _Worker(Generic[Picture]):
    """A thread that reads some of the cameras ahead of the consumer, in order."""

    def __init__(self, reader: _Reader[Picture], group: range) -> None:
        self.group = group
        self._reader: _Reader[Picture] = reader
        self._answers: queue.Queue[list[Picture] | _Failure] = queue.Queue(READ_AHEAD_FRAMES)
        self._is_stopped = threading.Event()
        self._thread = threading.Thread(target=self._work, name="mocap-read", daemon=True)
        self._thread.start()

    def take(self) -> list[Picture] | _Failure:
        return self._answers.get()

    def stop(self) -> None:
        self._is_stopped.set()
        while self._thread.is_alive():
            # The thread may be waiting for room in the queue.
            while not self._answers.empty():
                self._answers.get_nowait()
            self._thread.join(0.01)

    def _put(self, answer: list[Picture] | _Failure) -> bool:
        while not self._is_stopped.is_set():
            try:
                self._answers.put(answer, timeout=0.05)
            except queue.Full:
                continue
            return True
        return False

    def _work(self) -> None:
        clips: list[_OnClock[Picture]] = []
        camera = self.group[0]
        try:
            for camera in self.group:
                clips.append(_OnClock(self._reader._open(camera), self._reader._clip_frames[camera]))
            for frame in self._reader.frames:
                pictures = []
                for camera, clip in zip(self.group, clips, strict=True):
                    picture = clip.read(frame)
                    if picture is None:
                        raise MocapError(
                            "the clip ends here although more frames were expected",
                            path=self._reader._sources[camera],
                            camera=self._reader._names[camera],
                            frame=clip.place(frame),
                            remedy=_REMEDY_CUT,
                        )
                    pictures.append(self._reader._in_size(camera, picture))
                if not self._put(pictures):
                    return
        except Exception as error:
            # Not swallowed: the consumer raises it in its own thread.
            self._put(_Failure(camera, error))
        finally:
            for clip in clips:
                clip.close()


def _gathered(workers: list[_Worker[Picture]]) -> tuple[Picture, ...]:
    """The next picture of every camera, in the order of the rig."""
    pictures: dict[int, Picture] = {}
    failures: list[_Failure] = []
    for worker in workers:
        answer = worker.take()
        if isinstance(answer, _Failure):
            failures.append(answer)
        else:
            pictures.update(zip(worker.group, answer, strict=True))
    if failures:
        # The same camera is reported whatever the number of threads.
        raise min(failures, key=lambda f: f.camera).error
    return tuple(pictures[camera] for camera in sorted(pictures))


class _Clip(Protocol[Picture_co]):
    """One source. read(frame) wants ascending frames and gives None beyond the end."""

    def read(self, frame: int) -> Picture_co | None: ...

    def close(self) -> None: ...


class _OnClock(Generic[Picture]):
    """A clip that is read by frames of the session; a picture may show several of them."""

    def __init__(self, clip: _Clip[Picture], clip_frames: NDArray[np.int64] | None) -> None:
        self._clip, self._clip_frames = clip, clip_frames
        self._at = -1
        self._picture: Picture | None = None

    def place(self, frame: int) -> int:
        """The picture of the clip that shows a frame."""
        return frame if self._clip_frames is None else int(self._clip_frames[frame])

    def read(self, frame: int) -> Picture | None:
        place = self.place(frame)
        if place != self._at:
            self._at, self._picture = place, self._clip.read(place)
        return self._picture

    def close(self) -> None:
        self._clip.close()


def _open_images(path: Path, camera: str, size: Size | None) -> _Clip[Image]:
    if chapters := list_chapters(path):
        return _Chapters(chapters, camera, size)
    if path.is_dir():
        return _PictureClip(list_pictures(path), camera, size)
    if path.suffix.lower() in IMAGE_SUFFIXES:
        return _PictureClip([path], camera, size)
    return _VideoClip(path, camera, size)


class _PictureClip:
    def __init__(self, files: list[Path], camera: str, size: Size | None) -> None:
        self._files, self._camera, self._size = files, camera, size

    def read(self, frame: int) -> Image | None:
        if frame >= len(self._files):
            return None
        image = _rgb(_read_picture(self._files[frame], self._camera, frame, self._size))
        self._size = (image.shape[1], image.shape[0])
        return image

    def close(self) -> None:
        self._files = []


class _VideoClip:
    def __init__(self, path: Path, camera: str, size: Size | None) -> None:
        self._path, self._camera, self._size = path, camera, size
        self._capture = _open_capture(path, camera)
        if min(promised := _size_of(self._capture)) > 0:
            _check_promise(promised, size, path, camera)
        self._next = 0

    def read(self, frame: int) -> Image | None:
        # Frames are skipped by decoding them: seeking is exact only for some codecs.
        while self._next < frame:
            if not self._capture.grab():
                return None
            self._next += 1
        ok, bgr = self._capture.read()
        if not ok or bgr is None:
            return None
        self._next += 1
        self._size = _check_size(bgr, self._size, self._path, self._camera, frame)
        return _rgb(bgr)

    def close(self) -> None:
        self._capture.release()


class _Chapters:
    """Videos that follow each other without a gap, as one clip."""

    def __init__(self, files: Sequence[Path], camera: str, size: Size | None) -> None:
        self._camera = camera
        self._size = clip_info(files[0], camera=camera).size if size is None else size
        self._left = [(file, clip_info(file, camera=camera).n_frames) for file in files]
        self._before = 0  # pictures of the chapters that are done
        self._clip = _VideoClip(files[0], camera, self._size)

    def read(self, frame: int) -> Image | None:
        while len(self._left) > 1 and frame >= self._before + self._left[0][1]:
            self._before += self._left.pop(0)[1]
            self._clip.close()
            self._clip = _VideoClip(self._left[0][0], self._camera, self._size)
        return self._clip.read(frame - self._before)

    def close(self) -> None:
        self._clip.close()


class _MaskClip:
    def __init__(self, path: Path, camera: str, size: Size | None) -> None:
        self._files: list[Path] | None = None
        self._video: _VideoClip | None = None
        self._camera, self._size = camera, size
        if path.is_dir() or path.suffix.lower() in IMAGE_SUFFIXES:
            self._files = list_pictures(path) if path.is_dir() else [path]
        else:
            self._video = _VideoClip(path, camera, size)

    def read(self, frame: int) -> Mask | None:
        if self._video is not None:
            image = self._video.read(frame)
            return None if image is None else np.asarray(largest_channel(image) > MASK_THRESHOLD)
        if self._files is None or frame >= len(self._files):
            return None
        file = self._files[frame]
        picture = _read_picture(file, self._camera, frame, self._size)
        level = MASK_THRESHOLD if file.suffix.lower() in {".jpg", ".jpeg"} else 0
        if picture.ndim == 3:
            # The alpha channel of an opaque picture is 255 everywhere and says nothing.
            picture = largest_channel(picture[:, :, :3])
        return np.asarray(picture > level)

    def close(self) -> None:
        if self._video is not None:
            self._video.close()


class _DepthClip:
    def __init__(self, path: Path, camera: str, size: Size, unit_mm: float) -> None:
        self._files = list_depth_maps(path, camera)
        self._camera, self._size, self._unit_m = camera, size, np.float32(unit_mm / 1000.0)

    def read(self, frame: int) -> DepthMap | None:
        if frame >= len(self._files):
            return None
        file = self._files[frame]
        picture = _read_picture(file, self._camera, frame, self._size)
        if picture.dtype != np.uint16 or picture.ndim != 2:
            raise MocapError(
                f"a depth map has 16 bits in one channel, this picture has {8 * picture.itemsize} in "
                f"{1 if picture.ndim == 2 else picture.shape[2]}: it was made to look at",
                path=file,
                camera=self._camera,
                frame=frame,
                remedy="export the measured numbers as 16-bit grey PNG, and say their unit in session.toml: "
                "[depth] unit_mm",
            )
        return picture.astype(np.float32) * self._unit_m

    def close(self) -> None:
        self._files = []


def list_depth_maps(folder: Path, camera: str) -> list[Path]:
    """The PNG files of a folder of depth maps in natural order.

    Raises MocapError when there are none, and when the numbers in their names leave one out.
    """
    files = [p for p in list_pictures(folder) if p.suffix.lower() == ".png"]
    if not files:
        raise MocapError(
            "the folder holds no depth map",
            path=folder,
            camera=camera,
            remedy="put 16-bit grey PNG files there, one for every frame (docs/depth.md)",
        )
    numbers = [int(found[-1]) if (found := re.findall(r"\d+", p.stem)) else None for p in files]
    for frame, (a, b) in enumerate(pairwise(numbers), start=1):
        if a is not None and b is not None and b > a + 1:
            raise MocapError(
                f"a depth map is missing: after {files[frame - 1].name} comes {files[frame].name}",
                path=folder,
                camera=camera,
                frame=frame,
                remedy="put a map of zeros where the camera has measured nothing, or number the files without gaps",
            )
    return files


class _NpzMasks:
    def __init__(self, path: Path, camera: str, size: Size | None) -> None:
        self._path, self._camera, self._size = path, camera, size
        self._data, packed_width = _load_masks(path, camera)
        self.n_frames, height, columns = self._data.shape
        self._is_packed = True
        if size is not None and columns == (size[0] + 7) // 8 != size[0]:
            width = size[0]
        elif packed_width is not None and columns == (packed_width + 7) // 8:
            width = packed_width
        else:
            width, self._is_packed = columns, False
        self.size = (width, height)

    def read(self, frame: int) -> Mask | None:
        if frame >= self.n_frames:
            return None
        row = self._data[frame]
        mask = np.unpackbits(row, axis=1, count=self.size[0]).astype(bool) if self._is_packed else row != 0
        _check_size(mask, self._size, self._path, self._camera, frame)
        return mask

    def close(self) -> None:
        self._data = self._data[:0]


def _load_masks(path: Path, camera: str) -> tuple[NDArray[Any], int | None]:
    """Masks (T, H, W or packed columns) of a camera in an archive, and the width that the archive says."""

    def wrong(message: str, remedy: str) -> MocapError:
        return MocapError(message, path=path, camera=camera or None, remedy=remedy)

    try:
        names = ", ".join(array_names(path, "the mask archive"))
        arrays = load_arrays(path, "the mask archive", wanted=(camera, "masks", "size"))
    except MocapError as error:
        raise wrong(error.message, error.remedy) from error
    masks = arrays.get(camera, arrays.get("masks"))
    if masks is None:
        raise wrong(
            f"the archive has neither the camera's name nor `masks` as key, but {names or 'nothing'}",
            "store (T, H, W) masks under the camera's name",
        )
    if masks.ndim != 3 or masks.dtype.kind not in "biuf":
        raise wrong(
            f"masks are {masks.dtype} of shape {masks.shape}, expected numbers (frames, height, width)",
            "store (T, H, W) masks",
        )
    size = arrays.get("size", np.zeros(0)).ravel()
    if not size.size or size.dtype.kind not in "iu":
        return masks, None
    return masks, int(size[0])


def _npz_masks(path: Path, camera: str) -> _NpzMasks:
    masks = _NpzMasks(path, camera, None)
    if masks.n_frames == 0:
        raise _empty(path, camera)
    return masks


def _read_picture(path: Path, camera: str, frame: int, size: Size | None) -> NDArray[Any]:
    """A picture as it is in the file, (H, W) or (H, W, channels), any depth.

    size : (width, height) px that it must have; what the header promises is looked at before anything is decoded.
    """
    data = _bytes_of_picture(path, camera, frame, PICTURE_LIMIT_BYTES)
    promised = size_in_header(data)
    if promised is None or not has_its_chunks(data):
        raise _unreadable("picture", path, camera, frame)
    _check_promise(promised, size, path, camera, frame)
    try:
        picture = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise _unreadable("picture", path, camera, frame) from error
    if picture is None:
        raise _unreadable("picture", path, camera, frame)
    _check_size(picture, size, path, camera, frame)
    return picture


def _bytes_of_picture(path: Path, camera: str, frame: int | None, limit: int) -> bytes:
    try:
        return read_head(path, limit, "the picture")
    except MocapError as error:
        raise MocapError(
            error.message, path=path, camera=camera or None, frame=frame, remedy=error.remedy
        ) from error


def _check_promise(
    promised: Size, expected: Size | None, path: Path, camera: str, frame: int | None = None
) -> None:
    """MocapError for a size in a header that is not the expected one, or that no camera has."""
    if expected is not None and promised != expected:
        raise size_error(promised, expected, path, camera, frame)
    if promised[0] * promised[1] > MOST_PIXELS:
        raise MocapError(
            f"the picture is {promised[0]} x {promised[1]}, larger than any camera makes them",
            path=path,
            camera=camera or None,
            frame=frame,
            remedy="check where the file comes from, or make it smaller",
        )


def _rgb(picture: NDArray[Any]) -> Image:
    """(H, W, 3) uint8 RGB of a BGR, BGRA or grey picture of 8 or 16 bits, or of floats in 0..1."""
    if picture.dtype == np.uint16:
        # 65535 / 255 = 257 exactly: white stays white.
        picture = ((picture.astype(np.uint32) + 128) // 257).astype(np.uint8)
    elif picture.dtype != np.uint8:
        picture = np.clip(np.nan_to_num(picture.astype(np.float64)) * 255 + 0.5, 0, 255).astype(np.uint8)
    channels = picture.shape[2] if picture.ndim == 3 else 1
    code = {1: cv2.COLOR_GRAY2RGB, 3: cv2.COLOR_BGR2RGB, 4: cv2.COLOR_BGRA2RGB}[channels]
    return np.asarray(cv2.cvtColor(picture, code), dtype=np.uint8)


def _check_size(picture: NDArray[Any], size: Size | None, path: Path, camera: str, frame: int | None) -> Size:
    found = (picture.shape[1], picture.shape[0])
    if size is not None and found != size:
        raise size_error(found, size, path, camera, frame)
    return found


def size_error(found: Size, expected: Size, path: Path, camera: str, frame: int | None = None) -> MocapError:
    """The error of a picture whose size is not that of the calibration; sizes are (width, height) px."""
    remedy = "use pictures of the size that was calibrated, or calibrate again at this size"
    if found == expected[::-1]:
        remedy = "the picture lies on its side: turn the video as it was when it was calibrated"
    elif found[0] * expected[1] == found[1] * expected[0]:
        remedy += f" (multiply focal lengths and principal point by {found[0] / expected[0]:g})"
    return MocapError(
        f"the picture is {found[0]} x {found[1]}, expected {expected[0]} x {expected[1]}",
        path=path,
        camera=camera or None,
        frame=frame,
        remedy=remedy,
    )


def _unreadable(what: str, path: Path, camera: str, frame: int | None = None) -> MocapError:
    return MocapError(
        f"the {what} cannot be read; it is empty, damaged, truncated or of an unknown kind",
        path=path,
        camera=camera or None,
        frame=frame,
        remedy="copy it again from the camera, or convert it (videos to mp4, pictures to png)",
    )


def _empty(path: Path, camera: str) -> MocapError:
    return MocapError(
        "the clip is empty: it holds no frame",
        path=path,
        camera=camera or None,
        remedy="record it again, or take the file away",
    )


def _open_capture(path: Path, camera: str) -> cv2.VideoCapture:
    if not path.exists():
        raise MocapError("no such video", path=path, camera=camera or None, remedy="check the session folder")
    if check_regular(path, "the video") == 0:
        raise _empty(path, camera)
    if path.suffix.lower() not in VIDEO_SUFFIXES:
        raise MocapError(
            f"{path.suffix or 'a file without suffix'} is no video that we know",
            path=path,
            camera=camera or None,
            remedy=f"convert it to one of {', '.join(sorted(VIDEO_SUFFIXES))}",
        )
    try:
        # One decoder thread per stream is enough as the streams are decoded side by side.
        with utf8_name(path) as name:
            capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
    except cv2.error as error:
        raise _unreadable("video", path, camera) from error
    if not capture.isOpened():
        raise _unreadable("video", path, camera)
    return capture


def _size_of(capture: cv2.VideoCapture) -> Size:
    return int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))


def _stamp(path: Path, camera: str) -> tuple[int, int]:
    if not path.exists():
        raise MocapError("no such video", path=path, camera=camera or None, remedy="check the session folder")
    check_regular(path, "the video")
    stat = path.stat()
    return stat.st_size, stat.st_mtime_ns


@lru_cache(maxsize=256)
def _video_info(path: Path, camera: str, stamp: tuple[int, int]) -> ClipInfo:
    capture = _open_capture(path, camera)
    try:
        header = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        size = _size_of(capture)
        _check_promise(size, None, path, camera)
        fps: float | None = float(capture.get(cv2.CAP_PROP_FPS))
        if fps is None or not 0.1 <= fps <= 10_000:
            fps = None
        n_frames = header if header > 0 and _can_decode(capture, header - 1) else 0
    finally:
        capture.release()
    if n_frames == 0:
        n_frames = _count(path, camera, header)
    if n_frames == 0:
        raise _empty(path, camera)
    return ClipInfo(path, n_frames, size, fps, header if header > 0 else None)


def times_in_container(path: Path) -> NDArray[np.float64] | None:
    """When the pictures of a video are to be shown, (n,) s from the first on, as its container says.

    None for anything but a video, and for containers without time stamps that ascend.
    """
    if path.is_dir() or path.suffix.lower() not in VIDEO_SUFFIXES:
        return None
    capture = _open_capture(path, "")
    stamps = []
    try:
        while capture.grab():
            stamps.append(capture.get(cv2.CAP_PROP_POS_MSEC) / 1000)
    finally:
        capture.release()
    times = np.array(stamps) - stamps[0] if stamps else np.zeros(0)
    return times if len(times) > 1 and bool(np.all(np.diff(times) > 0)) else None


def _can_decode(capture: cv2.VideoCapture, frame: int) -> bool:
    capture.set(cv2.CAP_PROP_POS_FRAMES, frame)
    return abs(capture.get(cv2.CAP_PROP_POS_FRAMES) - frame) < 0.5 and bool(capture.grab())


def _count(path: Path, camera: str, header: int) -> int:
    """Frames that can be decoded, when the header is wrong."""
    capture = _open_capture(path, camera)
    try:
        if header > COUNT_BY_GRABBING_FRAMES:
            # Many containers promise a frame or two too many; look there before counting for minutes.
            for n in range(header - 1, header - 9, -1):
                if _can_decode(capture, n - 1):
                    return n
            capture.set(cv2.CAP_PROP_POS_FRAMES, 0)
        n = 0
        while capture.grab():
            n += 1
        return n
    finally:
        capture.release()
