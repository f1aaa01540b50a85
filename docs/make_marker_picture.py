"""Write docs/pictures/markers.jpg: yellow balls, what the colour detector finds, and the pose from it.

python -m docs.make_marker_picture SESSION OUT      # a session with balls, and the run on it with --observation markers
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from mocap.io.session import open_session
from mocap.io.store import StageStore
from mocap.io.video import FrameReader
from mocap.pipeline.scene_frames import body_parts
from mocap.products.detections import detections_at
from mocap.products.poses import stored_poses
from mocap.view import crop, draw_body, draw_skeleton, person_window
from mocap.view.detections import draw_detections

PICTURE = Path(__file__).with_name("pictures") / "markers.jpg"
FRAME, CAMERAS, HEIGHT_PX = 40, (0, 3), 270


def main(argv: list[str]) -> int:
    """Draw one frame of a run."""
    session, store = open_session(argv[0]), StageStore(Path(argv[1]) / "store.zarr")
    (poses,) = stored_poses(store)
    i = int(np.searchsorted(poses.frames, FRAME))
    found = detections_at(store, session, FRAME)
    with FrameReader(session.image_sources, session.rig, range(FRAME, FRAME + 1)) as reader:
        _, images = next(iter(reader))
    tiles = []
    for c in CAMERAS:
        camera, image = session.rig[c], images[c]
        window = person_window(camera, poses.landmarks[i])
        rings = draw_detections(image, camera, found[c])
        skeleton = draw_skeleton(rings, camera, poses.landmarks[i], poses.observed[i])
        for picture in (
            image,
            rings,
            skeleton,
            draw_body(image, camera, body_parts(poses.body, poses.states[i])),
        ):
            tile = crop(picture, window, scale=HEIGHT_PX / (window[3] - window[1]))
            tiles.append(cv2.resize(tile, (round(tile.shape[1] * HEIGHT_PX / tile.shape[0]), HEIGHT_PX)))
    sheet = np.concatenate(tiles, axis=1)
    cv2.imwrite(str(PICTURE), sheet[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 76])
    print(f"{PICTURE.name}: {PICTURE.stat().st_size} bytes, {sheet.shape[1]} x {sheet.shape[0]}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
