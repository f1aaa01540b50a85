"""Calibrate cameras on a board that they film: lenses, places, the floor, and how far the result can be trusted."""

from mocap.calibrate.board import Board, board_from_text
from mocap.calibrate.lens import Lens, LensModel
from mocap.calibrate.solve import Calibrated, WorldPoints, calibrate, resect
from mocap.calibrate.views import BoardViews, find_board_views, find_clips

__all__ = [
    "Board",
    "BoardViews",
    "Calibrated",
    "Lens",
    "LensModel",
    "WorldPoints",
    "board_from_text",
    "calibrate",
    "find_board_views",
    "find_clips",
    "resect",
]
