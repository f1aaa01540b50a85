"""Board calibration on 40 simulated boards, corners with noise, numbered by chance: errors of known cameras.

    python -m eval.board_calibration [--seeds 40] [--frames 25] [--noise-px 0.1]

About a minute. Prints the largest errors of focal lengths and places over all cameras and seeds.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, CameraRig
from mocap.geometry.rigid import matrix_from_rotation_vector
from mocap.io.board_calibration import BoardViews, calibrate_on_board
from mocap.io.checkerboard import numberings

Array = NDArray[np.float64]

SQUARE_M = 0.12
SIZE = (7, 5)  # inner corners; both odd, so that the ends of the board look alike
FLOOR_FRAME = 3


def looking_rig() -> CameraRig:
    """Three cameras of different size and lens around the origin, 1.9 m high."""
    cameras = []
    for name, angle, size, focal, k1 in (
        ("left", -0.7, (400, 304), 420.0, -0.05),
        ("middle", 0.0, (360, 288), 370.0, 0.0),
        ("right", 0.8, (416, 320), 450.0, 0.04),
    ):
        center = np.array([2.4 * np.cos(angle), 2.4 * np.sin(angle), 1.9])
        forward = (np.array([0.0, 0.0, 0.6]) - center) / np.linalg.norm([0.0, 0.0, 0.6] - center)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        R = np.stack([right, np.cross(forward, right), forward])
        K = np.array([[focal, 0, size[0] / 2 + 3], [0, focal * 1.005, size[1] / 2 - 4], [0, 0, 1]])
        cameras.append(Camera(name, size, K, np.array([k1, 0, 0, 0, 0]), R, -R @ center))
    return CameraRig(tuple(cameras))


def positions(n: int, *, rng: np.random.Generator) -> list[tuple[Array, Array]]:
    """R and t of the board, frame by frame, towards the cameras; flat on the floor in FLOOR_FRAME."""
    found = []
    for frame in range(n):
        if frame == FLOOR_FRAME:
            found.append((np.eye(3), np.zeros(3)))
            continue
        facing = np.column_stack([[0.0, 1.0, 0.0], [-0.6, 0.0, 0.8], [0.8, 0.0, 0.6]])
        turn = matrix_from_rotation_vector(rng.uniform(-0.6, 0.6, 3))
        found.append((turn @ facing, np.array([0.2, 0.0, 0.6]) + rng.uniform(-0.3, 0.3, 3)))
    return found


def board_points() -> Array:
    columns, rows = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    points = np.column_stack([columns.ravel(), rows.ravel(), np.zeros(columns.size)]) * SQUARE_M
    return np.asarray(points - points.mean(axis=0))


def drawn_views(rig: CameraRig, n: int, *, rng: np.random.Generator, noise_px: float) -> BoardViews:
    """Corners as a detector gives them: noisy, and numbered from either end by chance."""
    corners: dict[int, dict[str, Array]] = {}
    for frame, (R, t) in enumerate(positions(n, rng=rng)):
        corners[frame] = {}
        for camera in rig:
            uv = camera.project(board_points() @ R.T + t)[0]
            if np.isfinite(uv).all() and (uv > 2).all() and (uv < np.array(camera.size) - 3).all():
                options = numberings(uv + rng.normal(0, noise_px, uv.shape), SIZE)
                corners[frame][camera.name] = options[rng.integers(len(options))]
    return BoardViews(SIZE, {c.name: c.size for c in rig}, corners, n)


def errors(found: CameraRig, truth: CameraRig) -> tuple[float, float]:
    """Largest relative error of a focal length, and largest distance of a camera from its place, m."""
    focal, place = 0.0, 0.0
    for camera in truth:
        own = found[camera.name]
        focal = max(focal, *(abs(own.K[k, k] / camera.K[k, k] - 1) for k in (0, 1)))
        # The board's ends look alike: the world may be turned by half a turn about z.
        ends = (own.center, own.center * [-1, -1, 1])
        place = max(place, min(float(np.linalg.norm(end - camera.center)) for end in ends))
    return focal, place


def main(argv: Sequence[str] | None = None) -> int:
    """Calibrate on simulated boards and print the errors."""
    parser = argparse.ArgumentParser(prog="python -m eval.board_calibration", description=__doc__)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--frames", type=int, default=25)
    parser.add_argument("--noise-px", type=float, default=0.1)
    options = parser.parse_args(argv)
    truth = looking_rig()
    found = []
    for seed in range(options.seeds):
        rng = np.random.default_rng(seed)
        views = drawn_views(truth, options.frames, rng=rng, noise_px=options.noise_px)
        result = calibrate_on_board(views, square_m=SQUARE_M, floor_frame=FLOOR_FRAME)
        found.append((*errors(result.rig, truth), result.rms_px))
    focal, place, rms = np.array(found).T
    print(f"{options.seeds} boards of {options.frames} frames, corners off by {options.noise_px} px:")
    print(f"focal length  median {100 * np.median(focal):.2f} %, worst {100 * focal.max():.2f} %")
    print(f"place         median {1000 * np.median(place):.0f} mm, worst {1000 * place.max():.0f} mm")
    print(f"reprojection  {rms.min():.3f} to {rms.max():.3f} px")
    return 0


if __name__ == "__main__":
    sys.exit(main())
