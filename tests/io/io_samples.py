"""Cameras, pictures and clips that the tests of mocap.io are made of."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from mocap.data import Camera


def look_at(name: str, center: np.ndarray, size: tuple[int, int], focal: float = 60.0) -> Camera:
    """A camera at `center` that looks at (0, 0, 1) with z up."""
    forward = np.array([0.0, 0.0, 1.0]) - center
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    K = np.array([[focal, 0, size[0] / 2 - 0.3], [0, focal * 1.01, size[1] / 2 + 0.2], [0, 0, 1]])
    return Camera(name, size, K, np.array([-0.1, 0.02, 0.001, -0.002]), R, -R @ center)


def frame_picture(size: tuple[int, int], frame: int, camera: int) -> np.ndarray:
    """A flat RGB picture whose colour tells frame and camera, also after lossy coding."""
    w, h = size
    return np.full((h, w, 3), (40 + 16 * (frame % 12), 60 * camera + 40, 100), dtype=np.uint8)


def write_video(path: Path, pictures: list[np.ndarray], fps: float = 25.0) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    h, w = pictures[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), fps, (w, h))
    assert writer.isOpened()
    for picture in pictures:
        writer.write(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    writer.release()


def write_picture(path: Path, picture: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), picture)
