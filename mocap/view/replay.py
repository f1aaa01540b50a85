"""The replay of a report: a scene that can be turned and the pictures of every camera, frame by frame, in one page."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, CameraRig, bones_between, landmark_names
from mocap.view.html import escaped
from mocap.view.overlay import SIDE_COLOURS, person_colour, side_of_landmark
from mocap.view.plotting import hex_colour

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

# Half thickness of limbs in the scene, m, by the landmark at their end; others are as thin as an arm.
_HALF_M = {"neck": 0.09, "head": 0.07, "hip": 0.08, "knee": 0.06, "ankle": 0.04, "shoulder": 0.06}
_ARM_M = 0.03
_CAMERA_M = 0.25  # a camera's pyramid


@dataclass(frozen=True, eq=False)
class ReplayPerson:
    """One person.  landmarks : (T, M, 3) m, world, of the replay's frames; NaN = unknown."""

    person: int
    landmarks: Array


@dataclass(frozen=True, eq=False)
class Replay:
    """What a replay shows.

    frames : (T,) frames of the scene, evenly spaced.  bounds_m : lower and upper corner of the room.
    picture_frames : (N,) frames of the pictures.  sheets : N files of one sheet each, all cameras side by side.
    tiles : per camera (left, top, width, height) px in a sheet; empty without pictures.
    """

    rig: CameraRig
    fps: float
    frames: NDArray[np.int64]
    persons: tuple[ReplayPerson, ...]
    bounds_m: tuple[Sequence[float], Sequence[float]]
    picture_frames: NDArray[np.int64]
    sheets: tuple[bytes, ...]
    tiles: tuple[tuple[int, int, int, int], ...]
    mime: str = "image/webp"


def webp(image: Image, quality: int) -> bytes:
    """A picture (H, W, 3) uint8 RGB as a WebP file."""
    from PIL import Image as Picture

    buffer = io.BytesIO()
    # Method 2 takes a third of the time of the default, and a tenth more bytes.
    Picture.fromarray(image).save(buffer, "WEBP", quality=quality, method=2)
    return buffer.getvalue()


def replay_html(replay: Replay) -> str:
    """The player: scene, slider, a picture per camera, its data and its script."""
    tiles = "".join(
        f'<figure><canvas class="tile" width="{w}" height="{h}" role="img" aria-label="{escaped(c.name)}"></canvas>'
        f"<figcaption>{escaped(c.name)}</figcaption></figure>"
        for c, (_, _, w, h) in zip(replay.rig, replay.tiles, strict=False)
    )
    pictures = f'<div class="tiles">{tiles}</div>' if replay.sheets else ""
    script = (resources.files("mocap.view") / "replay.js").read_text("utf-8")
    # A closing tag inside the data would end the element.
    content = json.dumps(_content(replay), separators=(",", ":")).replace("</", "<\\/")
    return (
        '<p class="legend"><span>drag to turn, wheel or two fingers to zoom, double-click to begin again</span>'
        "<span>space bar: play and pause</span></p>"
        '<div id="replay-player" hidden><div class="stage">'
        '<canvas class="scene" role="img" aria-label="The persons in space, turned with the mouse"></canvas>'
        f'{pictures}</div><div class="transport"><button type="button" class="play" aria-pressed="false">Play</button>'
        '<button type="button" data-step="-1" aria-label="One frame back">&#9664;</button>'
        '<input type="range" min="0" value="0" aria-label="Frame">'
        '<button type="button" data-step="1" aria-label="One frame on">&#9654;</button><output></output></div></div>'
        '<noscript><p class="faint">The replay needs a browser that runs scripts.</p></noscript>'
        f'<script type="application/json" id="replay-data">{content}</script><script>{script}</script>'
    )


def _content(replay: Replay) -> dict[str, Any]:
    """What the script needs, as JSON: places in millimetres."""
    lower, upper = replay.bounds_m
    step = int(replay.frames[1] - replay.frames[0]) if len(replay.frames) > 1 else 1
    return {
        "fps": replay.fps,
        "step": step,
        "frames": replay.frames.tolist(),
        "lower": [round(float(v), 2) for v in lower],
        "upper": [round(float(v), 2) for v in upper],
        "colours": {side: hex_colour(tint) for side, tint in SIDE_COLOURS.items()},
        "cameras": [_camera(camera) for camera in replay.rig],
        "persons": [_person(person) for person in replay.persons],
        "picture_frames": replay.picture_frames.tolist(),
        "tiles": replay.tiles,
        "mime": replay.mime,
        "pictures": [base64.b64encode(sheet).decode("ascii") for sheet in replay.sheets],
    }


def _camera(camera: Camera) -> dict[str, Any]:
    """A camera as a small pyramid: its centre and the corners of its picture."""
    w, h = camera.size
    K = np.linalg.inv(camera.K)
    corners = np.array([[0, 0, 1], [w, 0, 1], [w, h, 1], [0, h, 1]], dtype=np.float64) @ K.T
    corners *= _CAMERA_M / np.maximum(np.linalg.norm(corners, axis=1, keepdims=True), 1e-9)
    places = corners @ camera.R + camera.center
    return {
        "name": camera.name,
        "centre": np.round(camera.center, 3).tolist(),
        "corners": np.round(places, 3).tolist(),
    }


def _person(person: ReplayPerson) -> dict[str, Any]:
    names = landmark_names(person.landmarks.shape[1])
    rows: list[list[int | None] | None] = []
    for places in person.landmarks:
        if not np.isfinite(places).any():
            rows.append(None)
            continue
        rows.append([None if not np.isfinite(v) else round(1000 * float(v)) for v in places.ravel()])
    return {
        "name": f"person {person.person}",
        "colour": hex_colour(person_colour(person.person)),
        "head": names.index("head") if "head" in names else None,
        "bones": [
            (a, b, side_of_landmark(names[b]), _HALF_M.get(names[b].rpartition("_")[2], _ARM_M))
            for a, b in bones_between(len(names))
        ],
        "points": rows,
    }
