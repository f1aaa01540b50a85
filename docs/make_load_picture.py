"""Somebody with a rucksack, followed without and with what is worn: docs/pictures/load.jpg.

python -m docs.make_load_picture [--work out/load]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from mocap.arrays import Image
from mocap.io.session import open_session
from mocap.io.session.reading import pictures_of
from mocap.io.store import StageStore
from mocap.pipeline.config import load_config
from mocap.pipeline.run import run_session
from mocap.products.poses import stored_poses
from mocap.synth import synthesise
from mocap.view import crop, draw_skeleton, person_window

PICTURE = Path(__file__).parent / "pictures" / "load.jpg"
SCENE, FRAME, CAMERA = "rucksack", 48, "cam_3"
WAYS = {"without": ("method.load.unexplained_share=1",), "with": ()}
HEIGHT_PX, ASPECT, QUALITY = 270, 0.6, 70


def main() -> None:
    """Film, run twice, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--work", type=Path, default=Path("out/load"), help="session and runs go there")
    work = parser.parse_args().work
    if not (work / "session").exists():
        synthesise(SCENE, work / "session")
    session = open_session(work / "session")
    camera = session.rig[CAMERA]
    with pictures_of(session, [FRAME]) as reader:
        ((_, pictures),) = reader
    picture = pictures[session.rig.names.index(CAMERA)]
    panels: list[Image] = []
    for name, settings in WAYS.items():
        config = load_config("default", settings)
        run_session(work / "session", work / name, config=config, seed=0, resume=True, until="pose")
        (poses,) = stored_poses(StageStore(work / name / "store.zarr"))
        landmarks = poses.landmarks[poses.frames == FRAME][0]
        window = person_window(camera, landmarks, margin=0.15, aspect=ASPECT)
        panel = crop(draw_skeleton(picture, camera, landmarks), window)
        width = round(panel.shape[1] * HEIGHT_PX / panel.shape[0])
        panels.append(cv2.resize(panel, (width, HEIGHT_PX), interpolation=cv2.INTER_CUBIC))
    sheet = np.hstack(panels)
    cv2.imwrite(str(PICTURE), sheet[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])


if __name__ == "__main__":
    main()
