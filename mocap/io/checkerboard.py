"""Checkerboard measurements: how good a calibration is, from a board that several cameras saw at the same time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, CameraRig
from mocap.geometry.rigid import matrix_from_rotation_vector, rotation_vector_from_matrix
from mocap.io.video import clip_info, iter_clip

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]
Views = list[dict[str, Array]]

# Inner corners (columns, rows) of the boards that people print, tried in this order.
COMMON_BOARDS: tuple[tuple[int, int], ...] = ((8, 6), (9, 6), (7, 5), (6, 4), (7, 6), (8, 5), (10, 7), (5, 4))
_RECTIFIED_PX = 40  # pixels per square of a rectified board
_MAX_QUADRANGLES = 4


@dataclass(frozen=True, eq=False)
class BoardMeasure:
    """A flat regular board fitted into the pictures of all cameras at once, with the calibration to be judged.

    rms_px : over all corners, cameras and frames, the size of the squares left free.  rms_px_of : by camera.
    n_views : pictures used.  square_m : the side of the squares that fits best.
    rms_true_size_px : the same with the squares held at their true size, None where that is not known.
    """

    size: tuple[int, int]
    rms_px: float
    rms_px_of: dict[str, float]
    n_views: int
    square_m: float
    rms_true_size_px: float | None = None


def find_board(grey: Grey, size: tuple[int, int]) -> Array | None:
    """Inner corners of a checkerboard in one picture, (columns * rows, 2) px, row by row; None if not found.

    A board that is small or seen at a flat angle is first rectified through its white border, because the
    detectors want squares of more than ten pixels.
    """
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH
    found, corners = cv2.findChessboardCorners(grey, size, None, flags | cv2.CALIB_CB_FAST_CHECK)
    if found:
        return _refined(grey, corners.reshape(-1, 2).astype(np.float64))
    for quadrangle in quadrangles(grey):
        for turn in (0, 1):
            corners = _find_rectified(grey, np.roll(quadrangle, turn, axis=0), size)
            if corners is not None:
                return _refined(grey, corners)
    return None


def find_boards(
    sources: Mapping[str, Path], size: tuple[int, int] | None = None, *, n_frames: int = 4
) -> tuple[tuple[int, int], Views] | None:
    """Look for the board in a few frames of all clips; gives its size and the corners by frame and camera.

    sources : camera name -> clip, synchronised.  size : inner corners, None = try the common ones.
    Returns None when no frame shows the board to two cameras.
    """
    n = min(clip_info(path, camera=name).n_frames for name, path in sources.items())
    wanted = np.unique(np.linspace(0, n - 1, n_frames).round().astype(int)).tolist()
    pictures = {name: list(_pick(path, name, wanted)) for name, path in sources.items()}
    for candidate in (size,) if size is not None else COMMON_BOARDS:
        views = [view for view in _views(pictures, candidate, is_guess=size is None) if len(view) >= 2]
        if views:
            return candidate, views
    return None


def _views(pictures: Mapping[str, Sequence[Grey]], size: tuple[int, int], *, is_guess: bool) -> Views:
    """Corners of a board of this size by frame and camera.  is_guess : give up when nobody sees it in the first."""
    views: Views = []
    for k in range(len(next(iter(pictures.values())))):
        seen = {name: find_board(frames[k], size) for name, frames in pictures.items()}
        views.append({name: corners for name, corners in seen.items() if corners is not None})
        if is_guess and not views[0]:
            break
    return views


def measure_board(
    rig: CameraRig, size: tuple[int, int], views: Views, *, square_m: float | None = None
) -> BoardMeasure | None:
    """Lay a flat regular board into the corners of every view and compare with the pictures.

    square_m : true side of the squares; then the fit is repeated with it, which shows a wrong scale in pixels.
    Detectors may number a board from either end; the numbering that fits the first camera best is taken.
    None without a frame in which two cameras of the rig saw the board.
    """
    errors: dict[str, list[Array]] = {}
    at_true_size: list[Array] = []
    sides: list[float] = []
    for view in views:
        names = [n for n in view if n in rig.names]
        cameras = [rig[n] for n in names]
        if len(names) < 2:
            continue
        pixels = _numbered_alike(cameras, [view[n] for n in names], size)
        residual, side = _fit_board(cameras, pixels, size, None)
        sides.append(side)
        for name, error in zip(names, residual, strict=True):
            errors.setdefault(name, []).append(error)
        if square_m is not None:
            at_true_size += list(_fit_board(cameras, pixels, size, square_m)[0])
    if not sides:
        return None
    return _measure(size, errors, float(np.mean(sides)), at_true_size)


def _measure(
    size: tuple[int, int], errors: Mapping[str, Sequence[Array]], side_m: float, at_true_size: Sequence[Array]
) -> BoardMeasure:
    """errors : camera -> distances, px, one array per view.  at_true_size : the same with squares of the true size."""
    of_camera = {name: np.concatenate(group) for name, group in errors.items()}
    return BoardMeasure(
        size,
        _rms(np.concatenate(list(of_camera.values()))),
        {name: _rms(group) for name, group in of_camera.items()},
        sum(map(len, errors.values())),
        side_m,
        _rms(np.concatenate(at_true_size)) if at_true_size else None,
    )


def _numbered_alike(
    cameras: Sequence[Camera], corners: Sequence[Array], size: tuple[int, int]
) -> list[Array]:
    """Corners of every camera numbered as those of the first, by what can be triangulated best."""
    pixels = [numberings(corners[0], size)[0]]
    for camera, own in zip(cameras[1:], corners[1:], strict=True):
        options = numberings(own, size)
        residuals = [
            float(np.mean(_residual_px([cameras[0], camera], [pixels[0], option]))) for option in options
        ]
        pixels.append(options[int(np.argmin(residuals))])
    return pixels


def _fit_board(
    cameras: Sequence[Camera], pixels: Sequence[Array], size: tuple[int, int], square_m: float | None
) -> tuple[Array, float]:
    """Distances (C, N) px of a flat regular board fitted to all pictures, and the side of its squares, m."""
    from scipy.optimize import least_squares

    columns, rows = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    board = np.column_stack([columns.ravel(), rows.ravel(), np.zeros(columns.size)])
    board -= board.mean(axis=0)
    points = triangulate(cameras, pixels)
    center = points.mean(axis=0)
    U, singular, Vt = np.linalg.svd((points - center).T @ board)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    side = float(singular.sum() / np.sum(board**2))
    start = np.concatenate([rotation_vector_from_matrix(R), center, [np.log(max(side, 1e-6))]])
    if square_m is not None:
        start = start[:6]

    def residual(x: Array) -> Array:
        scale = np.exp(x[6]) if square_m is None else square_m
        world = np.asarray(scale * board @ matrix_from_rotation_vector(x[:3]).T + x[3:6], dtype=np.float64)
        return np.concatenate(
            [_offsets_px(c, world, uv).ravel() for c, uv in zip(cameras, pixels, strict=True)]
        )

    solution = least_squares(residual, start, x_scale="jac")
    distances = np.linalg.norm(solution.fun.reshape(len(cameras), -1, 2), axis=2)
    return distances, float(np.exp(solution.x[6])) if square_m is None else square_m


def triangulate(cameras: Sequence[Camera], pixels: Sequence[Array]) -> Array:
    """Points (N, 3) m nearest to the rays through pixels, one (N, 2) px array per camera, in least squares."""
    A = np.zeros((len(pixels[0]), 3, 3))
    b = np.zeros((len(pixels[0]), 3))
    for camera, uv in zip(cameras, pixels, strict=True):
        d = camera.rays(uv)
        across = np.eye(3) - d[:, :, None] * d[:, None, :]
        A += across
        b += across @ camera.center
    return np.asarray(np.linalg.solve(A, b[..., None])[..., 0], dtype=np.float64)


def _residual_px(cameras: Sequence[Camera], pixels: Sequence[Array]) -> Array:
    """Distances (C, N) px between the corners and the projections of the points triangulated from them."""
    points = triangulate(cameras, pixels)
    offsets = [_offsets_px(c, points, uv) for c, uv in zip(cameras, pixels, strict=True)]
    return np.linalg.norm(np.stack(offsets), axis=2)


def _offsets_px(camera: Camera, points: Array, uv: Array) -> Array:
    """Projections minus corners (N, 2) px; a point behind the camera is as wrong as the picture is wide."""
    offsets = camera.project(points)[0] - uv
    return np.where(np.isfinite(offsets), offsets, float(camera.size[0]))


def _rms(errors: Array) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def numberings(corners: Array, size: tuple[int, int]) -> list[Array]:
    """The ways to number the corners so that rows turn clockwise into columns.

    All cameras see the printed side, so a mirrored numbering is never right; it must not be tried either,
    because with two cameras it can fit well.
    """
    grid = corners.reshape(size[1], size[0], 2)
    along, down = grid[:, -1].sum(axis=0) - grid[:, 0].sum(axis=0), grid[-1].sum(axis=0) - grid[0].sum(axis=0)
    if along[0] * down[1] - along[1] * down[0] < 0:
        grid = grid[::-1]
    grids = [np.rot90(grid, k) for k in ((0, 1, 2, 3) if size[0] == size[1] else (0, 2))]
    return [g.reshape(-1, 2) for g in grids]


def _pick(path: Path, camera: str, wanted: Sequence[int]) -> Iterator[Grey]:
    for frame, image in enumerate(iter_clip(path, camera=camera)):
        if frame in wanted:
            yield cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        if frame >= wanted[-1]:
            return


def _refined(grey: Grey, corners: Array) -> Array:
    """Corners to sub-pixels; the window stays inside the neighbouring squares."""
    steps = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    return refined_corners(grey, corners, float(np.quantile(steps, 0.1)) * 0.3)


def refined_corners(grey: Grey, corners: Array, reach_px: float) -> Array:
    """Corners (N, 2) px between four squares to sub-pixels, from windows that reach so far, 8 px at the most."""
    half = int(np.clip(reach_px, 1, 8))
    points = corners.astype(np.float32).reshape(-1, 1, 2)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 1e-3)
    refined = cv2.cornerSubPix(grey, points, (half, half), (-1, -1), criteria).reshape(-1, 2)
    moved = np.linalg.norm(refined - corners, axis=1)
    # A corner that ran away was better before.
    return np.where((moved < half + 1)[:, None], refined, corners).astype(np.float64)


def quadrangles(grey: Grey) -> list[Array]:
    """Bright four-sided regions with dark spots inside, (4, 2) px in turning order, most spotted first."""
    found: list[tuple[float, Array]] = []
    smallest = grey.size * 5e-4
    for level in range(90, 240, 20):
        contours, _ = cv2.findContours(
            (grey > level).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE
        )
        spotted = (_spotted(grey, contour) for contour in contours if cv2.contourArea(contour) >= smallest)
        found += [one for one in spotted if one is not None]
    found.sort(key=lambda f: -f[0])
    kept: list[Array] = []
    for _, polygon in found:
        # Neighbouring levels give the same region again.
        is_new = all(np.linalg.norm(polygon.mean(axis=0) - k.mean(axis=0)) > 5 for k in kept)
        if is_new and len(kept) < _MAX_QUADRANGLES:
            kept.append(polygon)
    return kept


def _spotted(grey: Grey, contour: NDArray[Any]) -> tuple[float, Array] | None:
    """How spotted a four-sided region is, times its area, and its corners (4, 2) px.

    None for other shapes and for plain regions.
    """
    polygon = cv2.approxPolyDP(contour, 0.03 * cv2.arcLength(contour, True), True).reshape(-1, 2)
    if len(polygon) != 4 or not cv2.isContourConvex(polygon):
        return None
    inside = np.zeros_like(grey)
    cv2.fillConvexPoly(inside, polygon, 1)
    spread = float(grey[inside > 0].std())
    return (spread * cv2.contourArea(contour), polygon.astype(np.float64)) if spread > 25 else None


def _find_rectified(grey: Grey, quadrangle: Array, size: tuple[int, int]) -> Array | None:
    """Find the board in a frontal view of the quadrangle and carry the corners back to the picture."""
    # One more square than inner corners each way, plus a border of about half a square.
    w, h = ((n + 2) * _RECTIFIED_PX for n in size)
    target = np.array([[0, 0], [w, 0], [w, h], [0, h]], dtype=np.float32)
    H = cv2.getPerspectiveTransform(quadrangle.astype(np.float32), target)
    frontal = cv2.warpPerspective(grey, H, (w, h), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, corners = cv2.findChessboardCorners(frontal, size, None, flags | cv2.CALIB_CB_FAST_CHECK)
    if not found:
        found, corners = cv2.findChessboardCornersSB(frontal, size, cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not found:
        return None
    back = cv2.perspectiveTransform(corners.reshape(-1, 1, 2).astype(np.float64), np.linalg.inv(H))
    return back.reshape(-1, 2)
