"""The two figures of a calibration's page, on simulated boards: docs/pictures/calibration.jpg.

python -m docs.make_calibration_picture
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from eval.board_calibration import BOARDS, FLOOR_FRAME, drawn_views, looking_rig
from mocap.calibrate import calibrate
from mocap.calibrate.page import coverage_figure, room_figure
from mocap.calibrate.uncertainty import uncertainty_map

PICTURE = Path(__file__).parent / "pictures" / "calibration.jpg"
_WIDTH_PX = 720


def main() -> None:
    """Draw and write."""
    views = drawn_views(looking_rig(), 25, rng=np.random.default_rng(0), noise_px=0.1, board=BOARDS[1])
    found = calibrate(views, world=FLOOR_FRAME)
    figures = (room_figure(found, uncertainty_map(found.adjusted, step_m=0.1)), coverage_figure(found))
    tiles = []
    for figure in figures:
        image = cv2.imdecode(np.frombuffer(figure.image, dtype=np.uint8), cv2.IMREAD_COLOR)
        h, w = image.shape[:2]
        tiles.append(cv2.resize(image, (_WIDTH_PX, h * _WIDTH_PX // w), interpolation=cv2.INTER_AREA))
    cv2.imwrite(str(PICTURE), np.vstack(tiles), [cv2.IMWRITE_JPEG_QUALITY, 80])


if __name__ == "__main__":
    main()
