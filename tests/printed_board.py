"""A frontal picture of a printed board."""

import cv2
import numpy as np

from mocap.calibrate.board import Board

# Of a frontal picture without noise.
CORNER_TOLERANCE_PX = 0.25
PX_PER_M, MARGIN_M = 1500.0, 0.04


def frontal(board: Board) -> np.ndarray:
    return cv2.GaussianBlur(board.image(PX_PER_M, MARGIN_M), (0, 0), 0.8)
