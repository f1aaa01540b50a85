"""Make the contact sheets of the scene families in docs/synthetic.md.

    python -m docs.make_scene_pictures               # all, into docs/pictures
    python -m docs.make_scene_pictures meeting       # some

No session is written: only the pictures shown are rendered.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.synth import load_scene
from mocap.synth.markers import Sight, simulate_detector
from mocap.synth.preview import render_moments
from mocap.synth.render import CameraView
from mocap.synth.views import Witness
from mocap.synth.world import build_world

Image = NDArray[np.uint8]

OUT = Path(__file__).resolve().parent / "pictures"
WIDTH = 130  # of a tile, px
MAX_BYTES = 60_000
_FAULTS = {
    "fault_moved": ("cam_3", (48, 49, 50, 51)),
    "fault_frozen": ("cam_1", (40, 47, 60, 89)),
    "fault_off": ("cam_0", (30, 41, 42, 50)),
    "fault_light": ("cam_2", (40, 44, 45, 50)),
    "fault_lamp": ("cam_2", (40, 44, 45, 50)),
    "fault_obstacle": ("cam_4", (30, 39, 40, 60)),
}
_LENSES = {"motion_blur": 40, "rolling_shutter": 40, "compressed": 30, "strong_lens": 30, "fisheye": 30}


def tile(picture: Image, words: str, width: int = WIDTH) -> Image:
    """A small picture, 4 : 3, with words on it."""
    height = width * 3 // 4
    small = np.ascontiguousarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA))
    (width_px, height_px), below = cv2.getTextSize(words, cv2.FONT_HERSHEY_SIMPLEX, 0.36, 1)
    small[: height_px + below + 2, : width_px + 4] = 0
    cv2.putText(
        small, words, (2, height_px + 2), cv2.FONT_HERSHEY_SIMPLEX, 0.36, (255, 255, 0), 1, cv2.LINE_AA
    )
    return small


def zoom(picture: Image, box: NDArray[np.floating]) -> Image:
    """The person of a picture, cut out with the shape of a tile; box : u0, v0, u1, v1."""
    height, width = picture.shape[:2]
    half_v = min(0.6 * (box[3] - box[1]), height / 2 - 1)
    half_u = half_v * 4 / 3
    u = float(np.clip((box[0] + box[2]) / 2, half_u, width - 1 - half_u))
    v = float(np.clip((box[1] + box[3]) / 2, half_v, height - 1 - half_v))
    return picture[int(v - half_v) : int(v + half_v), int(u - half_u) : int(u + half_u)]


def faults() -> Image:
    """A row per fault: before and after."""
    rows = []
    for name, (camera, frames) in _FAULTS.items():
        pictures = render_moments(load_scene(name), frames, [camera])[0][camera]
        words = [f"{name[6:]} {camera} {frames[0]}", *(str(f) for f in frames[1:])]
        rows.append(np.hstack([tile(p, w) for p, w in zip(pictures, words, strict=True)]))
    return np.vstack(rows)


def lenses() -> Image:
    """One picture each of the scenes about shutters, compression and lenses."""
    tiles = []
    for name, frame in _LENSES.items():
        scene = load_scene(name)
        (picture,) = render_moments(scene, [frame], ["cam_1"])[0]["cam_1"]
        if name not in ("strong_lens", "fisheye"):
            box, _, _ = _witness(name, "cam_1", frame)
            picture = zoom(picture, box)
        tiles.append(tile(picture, name, 140))
    return np.hstack(tiles)


def markers() -> Image:
    """Markers seen and hidden, detections of one picture, and the yellow balls."""
    tiles = []
    box, uv, state = _witness("walk_markers", "cam_3", 40)
    (picture,) = render_moments(load_scene("walk_markers"), [40], ["cam_3"])[0]["cam_3"]
    shown = picture.copy()
    for (u, v), s in zip(uv, state, strict=True):
        colour = (0, 230, 0) if s == Sight.VISIBLE else (230, 0, 0)
        cv2.circle(shown, (round(float(u)), round(float(v))), 3, colour, -1, cv2.LINE_AA)
    tiles.append(tile(zoom(shown, box), "seen, hidden", 200))
    scene = load_scene("walk_markers")
    assert scene.markers is not None
    _, found = simulate_detector(
        uv[None, None],
        (state == Sight.VISIBLE)[None, None],
        box[None, None],
        (picture.shape[1], picture.shape[0]),
        detection_rate=scene.markers.detection_rate,
        false_positives=scene.markers.false_positives,
        noise_variance_px2=scene.markers.noise_variance_px2,
        rng=np.random.default_rng(0),
    )
    shown = picture.copy()
    for u, v in found:
        cv2.circle(shown, (round(float(u)), round(float(v))), 3, (255, 255, 0), 1, cv2.LINE_AA)
    tiles.append(tile(zoom(shown, box), "detections", 200))
    box, _, _ = _witness("walk_balls", "cam_3", 30)
    (picture,) = render_moments(load_scene("walk_balls"), [30], ["cam_3"])[0]["cam_3"]
    tiles.append(tile(zoom(picture, box), "walk_balls", 200))
    return np.hstack(tiles)


def meeting() -> Image:
    """All five cameras of a meeting at four moments."""
    rows, frames = render_moments(load_scene("meeting_03"), (60, 180, 299), [f"cam_{i}" for i in range(5)])
    return np.vstack(
        [
            np.hstack(
                [
                    tile(p, f"{n} {f}" if k == 0 else str(f))
                    for k, (p, f) in enumerate(zip(row, frames, strict=True))
                ]
            )
            for n, row in rows.items()
        ]
    )


def crossing() -> Image:
    """One camera while two persons pass each other."""
    rows, frames = render_moments(load_scene("crossing_01"), (20, 28, 34, 40), ["cam_0"])
    return np.hstack([tile(p, f"cam_0 {f}", 140) for p, f in zip(rows["cam_0"], frames, strict=True)])


def _witness(name: str, camera: str, frame: int) -> tuple[NDArray, NDArray, NDArray]:
    """Tight box (4,), markers (M, 2) and their states (M,) of the first person in one picture."""
    world = build_world(load_scene(name))
    witness = Witness(world)
    posed = world.at(frame, with_light=False)
    witness.look(CameraView(world.rig[camera], world.room), posed, frame, is_off=False)
    return witness.boxes[0][0], witness.marker_uvs[0][0], witness.marker_states[0][0]


SHEETS: dict[str, Callable[[], Image]] = {
    "faults": faults,
    "lenses": lenses,
    "markers": markers,
    "meeting": meeting,
    "crossing": crossing,
}


def main(argv: list[str] | None = None) -> int:
    """Command line entry."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sheets", nargs="*", help="which, default all")
    parser.add_argument("--out", type=Path, default=OUT)
    arguments = parser.parse_args(argv)
    for name in arguments.sheets or SHEETS:
        path = arguments.out / f"scene_{name}.jpg"
        cv2.imwrite(str(path), SHEETS[name]()[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 78])
        if path.stat().st_size > MAX_BYTES:
            raise ValueError(f"{path.name} is larger than {MAX_BYTES} bytes")
        print(f"{path.name}: {path.stat().st_size // 1000} kB")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
