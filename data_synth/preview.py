"""A contact sheet of a session: every camera at a few moments."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from mocap.errors import MocapError
from mocap.io.session import open_session
from mocap.io.video import iter_clip


def preview_sheet(session: Path | str, path: Path | str, *, n_moments: int = 6, width_px: int = 240) -> Path:
    """Write a PNG with one row per camera and one column per moment, the empty room first; returns its path.

    Works on any session with videos, pictures or masks. Raises MocapError when the PNG cannot be written.
    """
    found = open_session(Path(session))
    sources = found.image_sources or found.mask_sources
    n = len(found.frames)
    moments = {found.frames[int(k)] for k in np.linspace(0, n - 1, min(n_moments, n))}
    rows = []
    for camera in found.rig:
        tiles = []
        if camera.name in found.background_sources:
            tiles.append(next(iter(iter_clip(found.background_sources[camera.name], camera=camera.name))))
        for frame, picture in enumerate(iter_clip(sources[camera.name], camera=camera.name)):
            if frame in moments:
                tiles.append(picture)
            if frame >= max(moments):
                break
        height = round(width_px * camera.size[1] / camera.size[0])
        small = [cv2.resize(t, (width_px, height), interpolation=cv2.INTER_AREA) for t in tiles]
        row = np.hstack(small)
        cv2.putText(row, camera.name, (5, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 0), 1, cv2.LINE_AA)
        rows.append(row)
    width = max(r.shape[1] for r in rows)
    sheet = np.vstack([np.pad(r, ((0, 0), (0, width - r.shape[1]), (0, 0))) for r in rows])
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), sheet[..., ::-1]):
        raise MocapError("the picture cannot be written", path=path, remedy="give a name that ends in .png")
    return path
