"""Plain triangulation of keypoints, what they are mostly used for today: every frame and every point by itself.

Of every point the largest set of views that agree, no smoothing, no body; head, neck and pelvis are the midpoints of
ears, shoulders and hips.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mocap.arrays import Array
from mocap.data import LANDMARKS, Motion
from mocap.data.keypoints import KEYPOINTS
from mocap.io.keypoints import read_keypoints
from mocap.io.session import open_session
from mocap.likelihood.markers import marker_views
from mocap.pipeline.stages.keypoints import figure_views, undistorted
from mocap.tracking.figures import FigureSettings, persons_of_figures

_MIDDLES = {"head": "ear", "neck": "shoulder", "pelvis": "hip"}


def triangulated(folder: Path, frames: tuple[int, int] | None = None) -> tuple[list[Motion], int]:
    """Landmarks of the points on which views agree, of every person of a session, and how many frames it has."""
    session = open_session(folder, frames=frames)
    read = read_keypoints(session.keypoint_sources, session.rig, session.frames)
    figures = {f: undistorted(read[f], session.rig) for f in session.frames}
    views = figure_views(marker_views(session.rig))
    motions = []
    for p in persons_of_figures(figures, views, session.fps, FigureSettings()):
        at = np.array(p.frames, dtype=np.int64)
        landmarks = np.array([landmarks_of_points(p.points[f]) for f in p.frames])
        motions.append(Motion(p.number, at, at / session.fps, landmarks))
    return motions, len(session.frames)


def landmarks_of_points(points: Array) -> Array:
    """The 15 landmarks (15, 3) m that points (K, 3) m stand for, NaN where one is missing."""
    out = np.full((len(LANDMARKS), 3), np.nan)
    for i, name in enumerate(LANDMARKS):
        pair = [f"{side}_{_MIDDLES[name]}" for side in ("left", "right")] if name in _MIDDLES else [name]
        out[i] = np.mean([points[KEYPOINTS.index(k)] for k in pair], axis=0)
    return out
