"""Clocks before and after `mocap sync`: docs/pictures/sync.png.

python -m docs.make_sync_picture
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2

from mocap.pipeline.sync import find_clocks, write_picture
from mocap.synth import synthesise
from mocap.synth.scene import load_scene

PICTURE = Path(__file__).parent / "pictures" / "sync.png"
SCENE = "walk"
OFFSETS_S = {"cam_1": 0.19, "cam_2": -0.197, "cam_4": -0.137}


def main() -> None:
    """Film, find, draw."""
    scene = load_scene(SCENE)
    faults = [{"kind": "offset", "camera": name, "offset_s": s} for name, s in OFFSETS_S.items()]
    document = {**scene.model_dump(exclude_unset=True), "n_frames": 150, "faults": faults}
    with tempfile.TemporaryDirectory() as folder:
        session = synthesise(type(scene).model_validate(document), Path(folder) / "session")
        write_picture(PICTURE, find_clocks(session))
    image = cv2.imread(str(PICTURE))
    cv2.imwrite(str(PICTURE), image, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main()
