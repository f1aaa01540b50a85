"""One camera at work: what it sees becomes its clip and its true silhouettes."""

from __future__ import annotations

from collections import OrderedDict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.errors import MocapError
from mocap.portable import utf8_name
from mocap.synth.depth import DepthConfig, measured_depth
from mocap.synth.render import GAMMA, CameraView, PosedScene, make_sensor
from mocap.synth.views import Witness
from mocap.synth.world import World

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]


class Moments:
    """The bodies posed at the instants that the cameras of one process ask for, the latest few kept."""

    def __init__(self, world: World, *, with_light: bool, n_kept: int = 24) -> None:
        self._world = world
        self._with_light = with_light
        self._n_kept = n_kept
        self._kept: OrderedDict[float, PosedScene] = OrderedDict()

    def at(self, instant: float) -> PosedScene:
        """All bodies at an instant, in frames of the session."""
        key = round(float(instant), 6)
        if key not in self._kept:
            self._kept[key] = self._world.at(key, with_light=self._with_light)
            if len(self._kept) > self._n_kept:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]


class Recorder:
    """A camera of a world with its sensor, its faults and its files (a resource: close it)."""

    def __init__(self, world: World, name: str, folder: Path) -> None:
        scene = world.scene
        self.timeline = world.timelines[name]
        self._world = world
        self._name = name
        self._order = world.rig.names.index(name)
        self._folder = folder
        self._views: dict[tuple[int, int], CameraView] = {}
        self._masks: list[NDArray[np.uint8]] = []
        self._last: tuple[int, Image, Mask] | None = None
        self._witness = Witness(world)
        self._offsets, self._shares = shutter(
            scene.picture.exposure_ms / 1000 * scene.fps,
            scene.picture.readout_ms / 1000 * scene.fps,
            scene.picture.n_subframes,
            scene.rig.size_px[1],
        )
        self._clip: _Clip | None = None
        if scene.masks_only:
            return
        self._sensor = make_sensor(
            scene.n_frames,
            scene.rig.size_px,
            noise_levels=scene.picture.noise_levels,
            light_drift=scene.picture.light_drift,
            colour_cast=scene.picture.colour_cast,
            fps=scene.fps,
            rng=world.rng(7, self._order),
        )

    def record_background(self) -> None:
        """The clip of the empty room, as the camera is calibrated."""
        scene = self._world.scene
        clip = _Clip(self._folder / "background" / f"{self._name}.mp4", scene.fps, scene.rig.size_px)
        for frame in range(scene.n_background_frames):
            rng = self._world.rng(8, self._order, frame)
            clip.write(self._as_stored(self._sensor.expose(self._view(0, 0).empty, 0, rng=rng)))
        clip.close()

    def record(self, frame: int, moments: Moments) -> None:
        """Take picture `frame` of the clip."""
        shot = int(self.timeline.shot[frame])
        if self._last is None or self._last[0] != shot:
            image, mask = self.take(frame, moments)
            self._last = (shot, image, mask)
        _, image, mask = self._last
        self._masks.append(np.packbits(mask, axis=1))
        self._testify(frame, moments)
        depth = self._world.scene.depth
        if depth is not None and self._name in depth.cameras:
            _write_picture(
                self._folder / "depth" / self._name / f"{frame:06d}.png",
                self._measure_depth(frame, moments, depth),
            )
        if self._world.scene.masks_only:
            _write_picture(
                self._folder / "masks" / self._name / f"{frame:06d}.png", mask.astype(np.uint8) * 255
            )
            return
        if self._clip is None:
            self._clip = self._open_clip()
        self._clip.write(image)

    def close(self) -> None:
        """Finish the files."""
        if self._clip is not None:
            self._clip.close()
        if self._masks:
            path = self._folder / "truth" / "masks" / f"{self._name}.npz"
            path.parent.mkdir(parents=True, exist_ok=True)
            np.savez_compressed(path, masks=np.stack(self._masks))
            self._witness.save(
                self._folder / "truth" / "views" / f"{self._name}.npz", self._world.rig[self._name]
            )

    def take(self, frame: int, moments: Moments) -> tuple[Image, Mask]:
        """Picture (H, W, 3) and true silhouette (H, W) of one shot; the picture is empty for masks only."""
        width, height = self._world.scene.rig.size_px
        time = self.timeline
        view = self._view(int(time.pose[frame]), int(time.state[frame]))
        if time.is_off[frame]:
            return np.zeros((height, width, 3), np.uint8), np.zeros((height, width), dtype=bool)
        if self._world.scene.masks_only:
            mask = view.silhouette(moments.at(time.instant[frame]))
            return np.zeros((0, 0, 3), np.uint8), mask
        bodies, looks = self._world.things, self._world.looks
        if len(self._offsets) == 1:
            picture, mask = view.render(moments.at(time.instant[frame]), bodies, looks)
        else:
            middle = np.argmax(self._shares, axis=0)
            linear = np.zeros((height, width, 3), np.float32)
            mask = np.zeros((height, width), dtype=bool)
            for i, offset in enumerate(self._offsets):
                part, now = view.render(moments.at(time.instant[frame] + offset), bodies, looks)
                linear += self._shares[i][:, None, None] * np.power(part / np.float32(255), 1 / GAMMA)
                mask[middle == i] = now[middle == i]
            picture = np.float32(255) * np.power(linear, GAMMA)
        shot = int(time.shot[frame])
        rng = self._world.rng(9, self._order, shot)
        image = self._sensor.expose(picture, shot, light=float(time.gain[frame]), rng=rng)
        return self._as_stored(image), mask

    def _measure_depth(self, frame: int, moments: Moments, config: DepthConfig) -> NDArray[np.uint16]:
        """The depth map of one picture, measured in an instant; zeros while the camera is off."""
        time, world = self.timeline, self._world
        width, height = world.scene.rig.size_px
        if time.is_off[frame]:
            return np.zeros((height, width), np.uint16)
        view = self._view(int(time.pose[frame]), int(time.state[frame]))
        true = view.true_depth(moments.at(time.instant[frame]), world.things, world.looks)
        return measured_depth(true, config, rng=world.rng(13, self._order, int(time.shot[frame])))

    def _testify(self, frame: int, moments: Moments) -> None:
        """Note what the picture shows of every person."""
        time = self.timeline
        view = self._view(int(time.pose[frame]), int(time.state[frame]))
        instant = float(time.instant[frame])
        self._witness.look(view, moments.at(instant), instant, is_off=bool(time.is_off[frame]))

    def _view(self, pose: int, state: int) -> CameraView:
        if (pose, state) not in self._views:
            camera = self._world.cameras[self._name][pose]
            self._views[pose, state] = CameraView(camera, self._world.room_in(state))
        return self._views[pose, state]

    def _as_stored(self, image: Image) -> Image:
        if self._world.scene.picture.grey:
            image = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
        quality = self._world.scene.picture.jpeg_quality
        if quality is None or self._world.scene.picture.container == "jpg":
            return image
        _, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
        return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR))[..., ::-1]

    def _open_clip(self) -> _Clip:
        picture = self._world.scene.picture
        if picture.container == "mp4":
            path = self._folder / "videos" / f"{self._name}.mp4"
        else:
            path = self._folder / "images" / self._name
        quality = 90 if picture.jpeg_quality is None else picture.jpeg_quality
        return _Clip(path, self.timeline.fps, self._world.scene.rig.size_px, picture.container, quality)


class _Clip:
    """A video file, or a folder of pictures."""

    def __init__(
        self, path: Path, fps: float, size: tuple[int, int], container: str = "mp4", quality: int = 90
    ) -> None:
        self._path, self._container = path, container
        self._options = [cv2.IMWRITE_JPEG_QUALITY, quality] if container == "jpg" else []
        self._n = 0
        self._writer: Any = None
        if container != "mp4":
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        with utf8_name(path) as name:
            self._writer = cv2.VideoWriter(name, cv2.VideoWriter.fourcc(*"mp4v"), fps, size)
        if not self._writer.isOpened():
            raise MocapError(
                "this OpenCV cannot write mp4v video", path=path, remedy="reinstall opencv-python-headless"
            )

    def write(self, image: Image) -> None:
        """Append an RGB picture."""
        if self._writer is not None:
            self._writer.write(image[..., ::-1])
        else:
            _write_picture(self._path / f"{self._n:06d}.{self._container}", image[..., ::-1], self._options)
        self._n += 1

    def close(self) -> None:
        if self._writer is not None:
            self._writer.release()


def _write_picture(
    path: Path, picture: NDArray[np.uint8] | NDArray[np.uint16], options: list[int] | None = None
) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with utf8_name(path) as name:
        is_written = cv2.imwrite(name, picture, options or [])
    if not is_written:
        raise MocapError("the picture cannot be written", path=path, remedy="check that the disk has space")


def shutter(
    exposure_frames: float, readout_frames: float, n_subframes: int, height: int
) -> tuple[NDArray[np.floating], NDArray[np.float32]]:
    """Instants that one picture gathers, and how much each row takes of each.

    exposure_frames : time for which a row is exposed.  readout_frames : from the first row's exposure to the last's.
    Returns offsets (S,) in frames, symmetric about 0 (S = 1 for an instantaneous shutter), and shares (S, H) float32
    whose columns sum to 1.
    """
    total = exposure_frames + readout_frames
    if total <= 0:
        return np.zeros(1), np.ones((1, height), np.float32)
    spacing = total / n_subframes
    offsets = (np.arange(n_subframes) - (n_subframes - 1) / 2) * spacing
    row = readout_frames * (np.arange(height) / max(height - 1, 1) - 0.5)
    half = max(exposure_frames, spacing) / 2
    upper = np.minimum(offsets[:, None] + spacing / 2, row + half)
    lower = np.maximum(offsets[:, None] - spacing / 2, row - half)
    shares = np.maximum(upper - lower, 0.0)
    return offsets, (shares / shares.sum(axis=0)).astype(np.float32)
