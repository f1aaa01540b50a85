"""Board calibration on simulated boards: errors of known cameras, and whether the stated deviations hold them.

    python -m eval.board_calibration [--seeds 20] [--frames 25] [--noise-px 0.1]
    python -m eval.board_calibration --rendered [--seeds 3] [--frames 40]

The first draws corners with noise, those of a checkerboard numbered by chance; two minutes.  The second renders
pictures with blur, noise and uneven light, and finds the corners in them; some minutes.  Both write
eval/results/board_calibration*.csv, a line per kind of board.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from eval.whole import write_csv
from mocap.calibrate import Board, BoardViews, Calibrated, calibrate
from mocap.calibrate.detect import Sighting, find_corners
from mocap.calibrate.numbering import readings
from mocap.data import Camera, CameraRig
from mocap.geometry.rigid import matrix_from_rotation_vector

Array = NDArray[np.float64]
RESULTS = Path(__file__).parent / "results"

# Inner corners both odd, so that the ends of the checkerboard look alike.
BOARDS = (
    Board("checkerboard", 7, 5, 0.12),
    Board("charuco", 8, 6, 0.12),
    Board("aprilgrid", 6, 4, 0.12),
)
FLOOR_FRAME = 3
# Share of errors that a standard deviation in three directions must hold: chi of 3 degrees of freedom, 90 %.
_HOLDS_90 = 2.5
_FINE = 3  # rays per pixel and side of a rendered picture


def looking_rig(scale: float = 1.0) -> CameraRig:
    """Three cameras of different size and lens around the origin, 1.9 m high.  scale : of their pictures."""
    cameras = []
    for name, angle, size, focal, k1 in (
        ("left", -0.7, (400, 304), 420.0, -0.05),
        ("middle", 0.0, (360, 288), 370.0, 0.0),
        ("right", 0.8, (416, 320), 450.0, 0.04),
    ):
        w, h = (round(scale * side) for side in size)
        center = np.array([2.4 * np.cos(angle), 2.4 * np.sin(angle), 1.9])
        forward = (np.array([0.0, 0.0, 0.6]) - center) / np.linalg.norm([0.0, 0.0, 0.6] - center)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        R = np.stack([right, np.cross(forward, right), forward])
        K = np.array([[scale * focal, 0, w / 2 + 3], [0, scale * focal * 1.005, h / 2 - 4], [0, 0, 1]])
        cameras.append(Camera(name, (w, h), K, np.array([k1, 0, 0, 0, 0]), R, -R @ center))
    return CameraRig(tuple(cameras))


def positions(n: int, *, rng: np.random.Generator) -> list[tuple[Array, Array]]:
    """R and t of the board, frame by frame, towards the cameras; flat on the floor in FLOOR_FRAME."""
    found = []
    for frame in range(n):
        if frame == FLOOR_FRAME:
            found.append((np.diag([1.0, -1.0, -1.0]), np.zeros(3)))
            continue
        facing = np.column_stack([[0.0, 1.0, 0.0], [0.6, 0.0, -0.8], [-0.8, 0.0, -0.6]])
        turn = matrix_from_rotation_vector(rng.uniform(-0.6, 0.6, 3))
        found.append((turn @ facing, np.array([0.2, 0.0, 0.6]) + rng.uniform(-0.3, 0.3, 3)))
    return found


def drawn_views(
    rig: CameraRig, n: int, *, rng: np.random.Generator, noise_px: float, board: Board = BOARDS[0]
) -> BoardViews:
    """Corners as a detector gives them: noisy, those of a checkerboard numbered from either end by chance."""
    seen: dict[int, dict[str, Sighting]] = {}
    for frame, (R, t) in enumerate(positions(n, rng=rng)):
        seen[frame] = {}
        for camera in rig:
            uv = camera.project(board.points @ R.T + t)[0]
            inside = np.isfinite(uv).all(axis=1) & (uv > 2).all(axis=1)
            inside &= (uv < np.array(camera.size) - 3).all(axis=1)
            if inside.all() or (board.has_numbers and inside.sum() >= 6):
                noisy = uv[inside] + rng.normal(0, noise_px, (inside.sum(), 2))
                options = readings(board, Sighting(board.points[inside], noisy))
                seen[frame][camera.name] = options[rng.integers(len(options))]
    return BoardViews(board, {c.name: c.size for c in rig}, seen, n)


def picture(camera: Camera, board: Board, R: Array, t: Array) -> NDArray[np.uint8]:
    """The board as the camera sees it, grey (H, W): every pixel's ray is cut with the board's plane."""
    w, h = camera.size
    margin_m = 0.7 * board.side_m
    px_per_m = 60.0 / board.side_m
    printed = board.image(px_per_m, margin_m)
    u, v = np.meshgrid(np.arange(float(w)), np.arange(float(h)))
    rays = camera.rays(np.column_stack([u.ravel(), v.ravel()]))
    along = ((t - camera.center) @ R[:, 2]) / (rays @ R[:, 2])
    local = (camera.center + along[:, None] * rays - t) @ R[:, :2]
    at = (local + np.array(board.size_m) / 2 + margin_m) * px_per_m - 0.5
    # The place on the board changes smoothly, so that it may be interpolated between pixels.
    fine = cv2.resize(np.clip(at, -1e4, 1e4).astype(np.float32).reshape(h, w, 2), None, fx=_FINE, fy=_FINE)
    seen = cv2.remap(printed, fine, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=90)
    mean = seen.reshape(h, _FINE, w, _FINE).mean(axis=(1, 3))
    return np.asarray(np.rint(25 + 0.82 * mean), dtype=np.uint8)


def rendered_views(rig: CameraRig, board: Board, n: int, *, rng: np.random.Generator) -> BoardViews:
    """Corners as they are found in pictures with an unsharp lens, noise and light from one side."""
    seen: dict[int, dict[str, Sighting]] = {}
    for frame, (R, t) in enumerate(positions(n, rng=rng)):
        seen[frame] = {}
        for camera in rig:
            grey = cv2.GaussianBlur(picture(camera, board, R, t).astype(np.float64), (0, 0), 0.7)
            light = np.linspace(0.8, 1.0, camera.size[0])
            noisy = grey * light + rng.normal(0, 3.0, grey.shape)
            found = find_corners(board, np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
            if isinstance(found, Sighting):
                seen[frame][camera.name] = found
    return BoardViews(board, {c.name: c.size for c in rig}, seen, n)


def errors(found: CameraRig, truth: CameraRig) -> tuple[float, float]:
    """Largest relative error of a focal length, and largest distance of a camera from its place, m."""
    focal = max(abs(found[c.name].K[k, k] / c.K[k, k] - 1) for c in truth for k in (0, 1))
    return float(focal), float(_place_errors(found, truth).max())


def _place_errors(found: CameraRig, truth: CameraRig) -> Array:
    """(C,) m.  A checkerboard's ends look alike: the world may be turned by half a turn about z."""
    centers = np.array([c.center for c in truth])
    own = np.array([found[c.name].center for c in truth])
    ways = [np.linalg.norm(own * way - centers, axis=1) for way in ([1, 1, 1], [-1, -1, 1])]
    return min(ways, key=lambda way: float(way.sum()))


def score(found: Calibrated, truth: CameraRig) -> list[float]:
    """Focal error, place error m, share of places within their deviation's 90 %, px."""
    focal, place = errors(found.rig, truth)
    deviation = np.array([found.center_deviation_m[c.name] for c in truth])
    held = _place_errors(found.rig, truth) <= _HOLDS_90 * deviation
    return [focal, place, float(held.mean()), found.rms_px]


def main(argv: Sequence[str] | None = None) -> int:
    """Calibrate on simulated boards, print the errors and write them."""
    parser = argparse.ArgumentParser(prog="python -m eval.board_calibration", description=__doc__)
    parser.add_argument("--seeds", type=int)
    parser.add_argument("--frames", type=int)
    parser.add_argument("--noise-px", type=float, default=0.1)
    parser.add_argument("--rendered", action="store_true")
    options = parser.parse_args(argv)
    seeds = options.seeds or (3 if options.rendered else 20)
    frames = options.frames or (40 if options.rendered else 25)
    truth = looking_rig(2.0 if options.rendered else 1.0)
    rows = []
    for board in BOARDS:
        scores = []
        for seed in range(seeds):
            rng = np.random.default_rng(seed)
            views = (
                rendered_views(truth, board, frames, rng=rng)
                if options.rendered
                else drawn_views(truth, frames, rng=rng, noise_px=options.noise_px, board=board)
            )
            scores.append(score(calibrate(views, world=FLOOR_FRAME), truth))
        focal, place, held, rms = np.array(scores).T
        rows.append(
            {
                "board": str(board),
                "seeds": seeds,
                "frames": frames,
                "focal_median_percent": f"{100 * np.median(focal):.3f}",
                "focal_worst_percent": f"{100 * focal.max():.3f}",
                "place_median_mm": f"{1000 * np.median(place):.2f}",
                "place_worst_mm": f"{1000 * place.max():.2f}",
                "places_within_90_percent": f"{100 * held.mean():.0f}",
                "rms_px": f"{np.median(rms):.3f}",
            }
        )
        print(", ".join(f"{key} {value}" for key, value in rows[-1].items()), flush=True)
    name = f"board_calibration{'_rendered' if options.rendered else ''}.csv"
    write_csv(RESULTS / name, list(rows[0]), rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
