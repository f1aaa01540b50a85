"""Contact sheets: every camera at a few moments, of a session or of a scene that is not rendered yet."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.errors import MocapError
from mocap.io.session import open_session
from mocap.io.video import clip_info, iter_clip
from mocap.portable import utf8_name
from mocap.synth.scene import Scene, load_scene

Image = NDArray[np.uint8]

_HEADER_PX = 18
_YELLOW = (255, 255, 0)


def preview_sheet(session: Path | str, path: Path | str, *, n_moments: int = 6, width_px: int = 240) -> Path:
    """Write a PNG with one row per camera and one column per moment, the empty room first; returns its path.

    Works on any session with videos, pictures or masks; of clips of different length the common frames are shown.
    Raises MocapError when the picture cannot be written.
    """
    root = Path(session)
    found = open_session(root, frames=(0, _shortest(root)))
    sources = found.image_sources or found.mask_sources
    moments = _spread(len(found.frames), n_moments)
    has_empty = bool(found.background_sources)
    rows: dict[str, list[Any]] = {}
    for camera in found.rig:
        tiles: list[Any] = []
        if camera.name in found.background_sources:
            tiles.append(next(iter(iter_clip(found.background_sources[camera.name], camera=camera.name))))
        elif has_empty:
            tiles.append(np.zeros((*camera.size[::-1], 3), np.uint8))
        for frame, picture in enumerate(iter_clip(sources[camera.name], camera=camera.name)):
            if frame in moments:
                tiles.append(picture)
            if frame >= moments[-1]:
                break
        rows[camera.name] = tiles
    words = ["empty"] * has_empty + [f"frame {m}" for m in moments]
    return _write_sheet(rows, words, Path(path), width_px)


def scene_sheet(
    scene: Scene | str | Path,
    path: Path | str,
    *,
    moments: Sequence[int] | int = 6,
    cameras: Sequence[str] | None = None,
    width_px: int = 240,
) -> Path:
    """The same of a scene, of which only the pictures shown are rendered; returns the path.

    moments : frames of the clips, or how many.  cameras : names; not given: all.
    Raises MocapError for an unknown scene and when the picture cannot be written.
    """
    checked = scene if isinstance(scene, Scene) else load_scene(scene)
    names = checked.rig.names if cameras is None else tuple(cameras)
    frames = moments if isinstance(moments, int) else list(moments)
    rows, shown = render_moments(checked, frames, names)
    return _write_sheet(rows, [f"frame {m}" for m in shown], Path(path), width_px)


def render_moments(
    scene: Scene, moments: Sequence[int] | int, cameras: Sequence[str]
) -> tuple[dict[str, list[Image]], list[int]]:
    """Pictures (H, W, 3) RGB of some cameras of a scene at some frames, without writing a session; and the frames.

    moments : frames of the clips, or how many, evenly spread.  Masks are black and white.
    """
    from mocap.synth.recorder import Moments, Recorder
    from mocap.synth.world import build_world

    world = build_world(scene)
    posed = Moments(world, with_light=not scene.masks_only)
    n = min(len(world.timelines[name]) for name in cameras)
    frames = _spread(n, moments) if isinstance(moments, int) else list(moments)
    rows: dict[str, list[Image]] = {name: [] for name in cameras}
    for name in cameras:
        recorder = Recorder(world, name, Path())
        for frame in frames:
            image, mask = recorder.take(frame, posed)
            black_white = np.repeat(mask[..., None], 3, axis=2).astype(np.uint8) * np.uint8(255)
            rows[name].append(image if image.size else black_white)
    return rows, frames


def _spread(n_frames: int, n_moments: int) -> list[int]:
    return sorted({int(k) for k in np.linspace(0, n_frames - 1, min(n_moments, n_frames))})


def _shortest(root: Path) -> int | None:
    """Number of frames that all clips have; None when the folder cannot say (opening it tells why)."""
    for kind in ("videos", "images", "masks"):
        clips = [p for p in sorted((root / kind).glob("*")) if not p.name.startswith(".")]
        if clips:
            return min(clip_info(p, camera=p.stem).n_frames for p in clips)
    return None


def _write_sheet(rows: dict[str, list[Any]], words: list[str], path: Path, width_px: int) -> Path:
    strips = [_header(words, width_px)]
    for name, tiles in rows.items():
        height = round(width_px * tiles[0].shape[0] / tiles[0].shape[1])
        strip = np.hstack([cv2.resize(t, (width_px, height), interpolation=cv2.INTER_AREA) for t in tiles])
        _write(strip, name, (5, 14))
        strips.append(strip)
    check_picture_name(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet = np.vstack(strips)
    with utf8_name(path) as name:
        is_written = cv2.imwrite(name, sheet[..., ::-1])
    if not is_written:
        raise MocapError("the picture cannot be written", path=path, remedy="check that the disk has space")
    return path


def check_picture_name(path: Path) -> None:
    """Raises MocapError for a name that is no PNG or JPEG, before an hour is spent on what it should show."""
    if path.suffix.lower() not in (".png", ".jpg"):
        raise MocapError("the picture cannot be written", path=path, remedy="give a name that ends in .png")


def _header(words: list[str], width_px: int) -> Image:
    strip = np.zeros((_HEADER_PX, width_px * len(words), 3), np.uint8)
    for i, word in enumerate(words):
        _write(strip, word, (i * width_px + 5, 13))
    return strip


def _write(picture: Image, words: str, at: tuple[int, int]) -> None:
    cv2.putText(picture, words, at, cv2.FONT_HERSHEY_SIMPLEX, 0.45, _YELLOW, 1, cv2.LINE_AA)
