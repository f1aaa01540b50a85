"""Make the moving picture of the README from a run of the demo.

    mocap demo                          # session in out/demo/session, result in out/demo/result
    python -m docs.make_demo_picture    # docs/pictures/demo.webp

What a camera filmed, the hull of all silhouettes, and the fitted body with its landmarks, side by side.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from docs.make_pictures import MAX_BYTES
from mocap.io.session import open_session
from mocap.io.store import StageStore
from mocap.io.video import FrameReader
from mocap.pipeline.scene_frames import body_parts
from mocap.products.hulls import hull_from_arrays, stored_grid
from mocap.products.poses import stored_poses
from mocap.view import crop, draw_body, draw_hull, draw_label, draw_skeleton, person_window

CAMERA = "cam_3"
EVERY = 2  # frames; half of the pictures are smooth enough, and half as many bytes
HEIGHT_PX = 200
QUALITIES = (30, 20)  # of WebP; the best that stays below MAX_BYTES is taken


def pictures(root: Path) -> tuple[list[np.ndarray], float]:
    """The pictures of one turn, (H, W, 3) uint8 each, and how many a second."""
    session = open_session(root / "session")
    store = StageStore(root / "result" / "store.zarr")
    grid, hulls, (poses, *_) = stored_grid(store), store.reader("carve"), stored_poses(store)
    camera = session.rig[session.rig.names.index(CAMERA)]
    window = person_window(camera, poses.landmarks.reshape(-1, 3), margin=0.1, aspect=0.9)
    shown = []
    with FrameReader(session.image_sources, session.rig, session.frames) as reader:
        for frame, images in reader:
            rows = np.flatnonzero(poses.frames == frame)
            if frame % EVERY or not len(rows):
                continue
            image = images[session.rig.names.index(CAMERA)]
            row = int(rows[0])
            body = draw_body(image, camera, body_parts(poses.body, poses.states[row]))
            tiles = (
                (image, "filmed"),
                (draw_hull(image, camera, hull_from_arrays(grid, hulls.read(frame))), "volume"),
                (draw_skeleton(body, camera, poses.landmarks[row], poses.observed[row]), "pose"),
            )
            shown.append(np.hstack([_tile(tile, window, words) for tile, words in tiles]))
    return shown, session.fps / EVERY


def _tile(image: np.ndarray, window: tuple[int, int, int, int], words: str) -> np.ndarray:
    part = crop(image, window)
    width = round(HEIGHT_PX * part.shape[1] / part.shape[0])
    return draw_label(cv2.resize(part, (width, HEIGHT_PX), interpolation=cv2.INTER_AREA), words, (4.0, 0.0))


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--demo", type=Path, default=Path("out/demo"))
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "pictures" / "demo.webp")
    options = parser.parse_args(argv)
    if not (options.demo / "result" / "run.json").is_file():
        print(f"no finished demo in {options.demo}; run: mocap demo", file=sys.stderr)
        return 2
    shown, fps = pictures(options.demo)
    first, *rest = (Image.fromarray(picture) for picture in shown)
    for quality in QUALITIES:
        first.save(
            options.out,
            save_all=True,
            append_images=rest,
            duration=round(1000 / fps),
            loop=0,
            quality=quality,
            method=6,
        )
        if options.out.stat().st_size < MAX_BYTES:
            break
    print(
        f"{options.out}: {options.out.stat().st_size / 1000:.0f} kB, {len(shown)} pictures, quality {quality}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
