"""Calibrate cameras on a checkerboard that they film together: lenses, places, and the floor.

Corners are numbered from either end of a board by the detector. The numbering that all frames agree on is found first,
by the relative pose of every pair of cameras; then OpenCV's multi-view calibration solves for everything at once.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, CameraRig
from mocap.errors import MocapError
from mocap.io._files import IMAGE_SUFFIXES, VIDEO_SUFFIXES
from mocap.io.checkerboard import find_board, numberings, triangulate
from mocap.io.session.sources import sources_in
from mocap.io.video import clip_info, iter_clip
from mocap.progress import Progress, no_progress

Array = NDArray[np.float64]
Size = tuple[int, int]

MIN_VIEWS = 6  # of each camera; fewer leave the lens undetermined
_MIN_COMMON = 3  # frames that must agree on how two cameras stand to each other
_MAX_TURN_RAD = 0.15  # by which such frames may differ
_MAX_SHIFT = 0.08  # the same, as a share of the distance to the board
_WARN_RMS_PX = 1.0
_BAD_VIEW = 2.5  # views that are off by so many times the median are left out
# Third radial term and tangential terms take up noise on boards that fill part of the picture.
_LENS = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
# (frame, camera) -> for each numbering of the corners these, (N, 2) px, and the pose of the board, (4, 4).
_Options = Mapping[tuple[int, str], list[tuple[Array, Array]]]


@dataclass(frozen=True, eq=False)
class BoardViews:
    """Where a board was seen.  size : inner corners (columns, rows).  picture_size : camera -> (width, height) px.
    corners : frame -> camera -> (columns * rows, 2) px, as detected.  n_frames : of the shortest clip."""

    size: Size
    picture_size: dict[str, Size]
    corners: dict[int, dict[str, Array]]
    n_frames: int


@dataclass(frozen=True, eq=False)
class BoardCalibration:
    """rig : world of the floor board, m, z up.  rms_px_of, n_views_of : by camera.  warnings : what to look at."""

    rig: CameraRig
    rms_px: float
    rms_px_of: dict[str, float]
    n_views_of: dict[str, int]
    warnings: tuple[str, ...]


def board_clips(folder: Path) -> dict[str, Path]:
    """Camera -> clip of a folder: videos or picture folders in it, or in its videos/ or images/.

    Raises MocapError when there are fewer than two.
    """
    kinds = VIDEO_SUFFIXES | IMAGE_SUFFIXES
    for place in (folder / "videos", folder / "images", folder):
        found = sources_in(place, kinds) if place.is_dir() else {}
        if len(found) >= 2:
            return found
    raise MocapError(
        "no clips of two or more cameras were found",
        path=folder,
        remedy="put one video (or folder of pictures) per camera there, named as the cameras",
    )


def find_board_views(
    clips: Mapping[str, Path],
    size: Size,
    *,
    floor_frame: int,
    n_frames: int = 60,
    progress: Progress = no_progress,
) -> BoardViews:
    """Look for the board in frames spread evenly over synchronised clips, and in the floor frame.

    Raises MocapError for a floor frame that is not in the clips.
    """
    infos = {name: clip_info(path, camera=name) for name, path in clips.items()}
    n = min(info.n_frames for info in infos.values())
    if not 0 <= floor_frame < n:
        raise MocapError(
            f"the floor frame {floor_frame} is not in the clips, which have frames 0 to {n - 1}",
            remedy="give a frame in which the board lies on the floor as --floor-frame",
        )
    wanted = sorted({*np.linspace(0, n - 1, min(n, n_frames)).round().astype(int).tolist(), floor_frame})
    corners: dict[int, dict[str, Array]] = {frame: {} for frame in wanted}
    total, done = len(wanted) * len(clips), 0
    for name, path in clips.items():
        for frame, image in _pictures(path, name, wanted):
            found = find_board(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), size)
            if found is not None:
                corners[frame][name] = found
            done += 1
            progress("board", done, total)
    return BoardViews(size, {name: info.size for name, info in infos.items()}, corners, n)


def _pictures(path: Path, camera: str, wanted: Sequence[int]) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """The wanted frames (ascending) of a clip; nothing behind the last of them is decoded."""
    for frame, image in enumerate(iter_clip(path, camera=camera)):
        if frame in wanted:
            yield frame, image
        if frame >= wanted[-1]:
            return


def calibrate_on_board(views: BoardViews, *, square_m: float, floor_frame: int) -> BoardCalibration:
    """Lenses and places of all cameras from one board; the world's floor is the board in `floor_frame`.

    World: origin at the board's centre, z up (towards the cameras), x along its rows, y to the left of x.
    Raises ValueError for a square size that is not positive; MocapError for a camera that saw the board in fewer than
    MIN_VIEWS frames or has no frames in common with the others, and for a floor board that nobody saw.
    """
    if not square_m > 0:
        raise ValueError(f"square_m must be positive, got {square_m}")
    names = list(views.picture_size)
    _check_views(views, floor_frame)
    board = _board_points(views.size, square_m)
    lenses = {name: _lens(views, name, board) for name in names}
    numbered = _agree(views, lenses, board)
    rig = _solve(views, numbered, names, board)
    sharp = _without_bad_views(rig, numbered, board)
    if sharp != numbered:
        rig, numbered = _solve(views, sharp, names, board), sharp
    rig = _on_floor(rig, numbered[floor_frame], board)
    errors = _errors(rig, numbered, board)
    rms_of = {name: _rms([e for (_, seen_by), e in errors.items() if seen_by == name]) for name in names}
    return BoardCalibration(
        rig,
        _rms(list(errors.values())),
        rms_of,
        _n_views(numbered, names),
        tuple(_warnings(rig, rms_of)),
    )


def _n_views(corners: Mapping[int, Mapping[str, Array]], names: Sequence[str]) -> dict[str, int]:
    """Frames in which each camera saw the board."""
    return {name: sum(name in seen for seen in corners.values()) for name in names}


def _check_views(views: BoardViews, floor_frame: int) -> None:
    for name, count in _n_views(views.corners, list(views.picture_size)).items():
        if count < MIN_VIEWS:
            raise MocapError(
                f"the board of {views.size[0]} x {views.size[1]} inner corners was found in {count} frames, needed are "
                f"{MIN_VIEWS}",
                camera=name,
                remedy="check --board (inner corners, not squares), show the board longer, nearer and tilted, or look "
                "at more frames with --frames",
            )
    if not views.corners.get(floor_frame):
        raise MocapError(
            "no camera sees the board in the floor frame",
            frame=floor_frame,
            remedy="give a frame in which the board lies on the floor, in view of two cameras, as --floor-frame",
        )


def _board_points(size: Size, square_m: float) -> Array:
    """Corners (N, 3) m of a board about its centre, rows one after the other, z = 0."""
    columns, rows = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    board = np.column_stack([columns.ravel(), rows.ravel(), np.zeros(columns.size)]) * square_m
    return np.asarray(board - board.mean(axis=0), dtype=np.float64)


def _lens(views: BoardViews, name: str, board: Array) -> tuple[Array, Array]:
    """Matrix and distortion of one camera alone; how its corners are numbered does not matter."""
    pixels = [numberings(seen[name], views.size)[0] for seen in views.corners.values() if name in seen]
    _, K, dist, _, _ = cv2.calibrateCamera(
        [board.astype(np.float32)] * len(pixels),
        [p.astype(np.float32) for p in pixels],
        views.picture_size[name],
        None,
        None,
        flags=_LENS,
    )
    return np.asarray(K, dtype=np.float64), np.asarray(dist, dtype=np.float64).ravel()


def _board_pose(uv: Array, lens: tuple[Array, Array], board: Array) -> Array:
    """Board to camera, (4, 4)."""
    _, rotation, translation = cv2.solvePnP(board, uv, lens[0], lens[1], flags=cv2.SOLVEPNP_IPPE)
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(rotation)[0]
    T[:3, 3] = translation.ravel()
    return T


def _agree(
    views: BoardViews, lenses: Mapping[str, tuple[Array, Array]], board: Array
) -> dict[int, dict[str, Array]]:
    """Corners of every frame numbered alike by all cameras; views that fit no numbering are left out."""
    names = list(lenses)
    options = {
        (frame, name): [(uv, _board_pose(uv, lenses[name], board)) for uv in numberings(corners, views.size)]
        for frame, seen in views.corners.items()
        for name, corners in seen.items()
    }
    relative = _relative_poses(views, names, options)
    return {
        frame: _numbered_alike([name for name in names if name in seen], frame, options, relative)
        for frame, seen in views.corners.items()
        if seen
    }


def _numbered_alike(
    names: Sequence[str], frame: int, options: _Options, relative: Mapping[str, Array]
) -> dict[str, Array]:
    """Corners of one frame by the numbering that fits the first camera best; views that fit none are left out."""
    first = names[0]
    uv, T_first = options[frame, first][0]
    kept = {first: uv}
    for name in names[1:]:
        T_first_name = _inverse(relative[first]) @ relative[name]
        distance = float(np.linalg.norm(T_first[:3, 3]))
        fits = [_difference(T_first, T_first_name @ T, distance) for _, T in options[frame, name]]
        best = int(np.argmin([turn + shift for turn, shift in fits]))
        if fits[best][0] < 2 * _MAX_TURN_RAD and fits[best][1] < 2 * _MAX_SHIFT:
            kept[name] = options[frame, name][best][0]
    return kept


def _relative_poses(views: BoardViews, names: Sequence[str], options: _Options) -> dict[str, Array]:
    """Camera -> its pose in the frame of the first camera (T_first_name), along the pairs that most frames agree on."""
    edges = _edges(views, names, options)
    placed = {names[0]: np.eye(4)}
    while len(placed) < len(names):
        reach = [(edge, n) for edge, (n, _) in edges.items() if edge[0] in placed and edge[1] not in placed]
        if not reach:
            lost = next(name for name in names if name not in placed)
            raise MocapError(
                "the camera has too few views of the board at the same time as the others",
                camera=lost,
                remedy="show the board to two cameras at once, moving and turning it; clips must be synchronised",
            )
        (a, b), _ = max(reach, key=lambda found: found[1])
        placed[b] = placed[a] @ edges[a, b][1]
    return placed


def _edges(
    views: BoardViews, names: Sequence[str], options: _Options
) -> dict[tuple[str, str], tuple[int, Array]]:
    """(a, b) -> how many frames agree on the pose of b in a's frame, and that pose."""
    edges: dict[tuple[str, str], tuple[int, Array]] = {}
    for a, b in combinations(names, 2):
        common = [frame for frame, seen in views.corners.items() if a in seen and b in seen]
        found = _pair([_candidate(options[frame, a], options[frame, b]) for frame in common])
        if found is not None:
            edges[a, b] = found
            edges[b, a] = found[0], _inverse(found[1])
    return edges


def _candidate(of_a: list[tuple[Array, Array]], of_b: list[tuple[Array, Array]]) -> tuple[float, list[Array]]:
    """Distance of camera a to the board, m, and the pose of b in a's frame for each numbering of b."""
    T_a = of_a[0][1]
    return float(np.linalg.norm(T_a[:3, 3])), [T_a @ _inverse(T) for _, T in of_b]


def _pair(candidates: Sequence[tuple[float, Sequence[Array]]]) -> tuple[int, Array] | None:
    """The relative pose that most frames agree on, and how many do; None if too few.

    candidates : of every frame the distance to the board, m, and the relative pose for each numbering.
    """
    best: tuple[int, float, Array] | None = None
    for T in (T for _, own in candidates for T in own):
        n, spread = _agreement(T, candidates)
        if best is None or (n, -spread) > (best[0], -best[1]):
            best = n, spread, T
    if best is None or best[0] < _MIN_COMMON or best[0] <= len(candidates) / 2:
        return None
    return best[0], best[2]


def _agreement(T: Array, candidates: Sequence[tuple[float, Sequence[Array]]]) -> tuple[int, float]:
    """How many frames agree with a relative pose, and by how much these differ from it in all."""
    n, spread = 0, 0.0
    for distance, others in candidates:
        turn, shift = min((_difference(T, other, distance) for other in others), key=sum)
        if turn < _MAX_TURN_RAD and shift < _MAX_SHIFT:
            n, spread = n + 1, spread + turn + shift
    return n, spread


def _inverse(T: Array) -> Array:
    return np.asarray(np.linalg.inv(T), dtype=np.float64)


def _difference(A: Array, B: Array, distance: float) -> tuple[float, float]:
    """Angle between two poses, rad, and how far they are apart as a share of a distance."""
    cosine = (np.trace(A[:3, :3].T @ B[:3, :3]) - 1) / 2
    shift = np.linalg.norm(A[:3, 3] - B[:3, 3]) / distance
    return float(np.arccos(np.clip(cosine, -1, 1))), float(shift)


def _solve(
    views: BoardViews, numbered: Mapping[int, Mapping[str, Array]], names: Sequence[str], board: Array
) -> CameraRig:
    """Lenses and places of all cameras at once; the world is the first camera's frame."""
    frames = [seen for seen in numbered.values() if seen]
    nothing = np.zeros((0, 2))
    pixels = [[seen.get(name, nothing).astype(np.float32) for seen in frames] for name in names]
    sizes = [views.picture_size[name] for name in names]
    mask = np.array([[name in seen for seen in frames] for name in names], dtype=np.uint8)
    try:
        _, Ks, dists, Rs, ts = cv2.calibrateMultiview(
            [board.astype(np.float32)] * len(frames),
            pixels,
            sizes,
            mask,
            np.full(len(names), cv2.CALIB_MODEL_PINHOLE, dtype=np.uint8),
            [],
            [],
            [],
            [],
            flagsForIntrinsics=np.full(len(names), _LENS, dtype=np.int32),
        )
    except cv2.error as error:
        raise MocapError(
            f"the calibration has no solution: {error.err}",
            remedy="show the board in more places and at more angles, to two cameras at once",
        ) from error
    solved = zip(names, sizes, Ks, dists, Rs, ts, strict=True)
    return CameraRig(
        tuple(
            Camera(name, size, K, np.ravel(dist), cv2.Rodrigues(np.asarray(R))[0], np.ravel(t))
            for name, size, K, dist, R, t in solved
        )
    )


def _place_board(rig: CameraRig, seen: Mapping[str, Array], board: Array) -> tuple[Array, Array]:
    """R and t of the board in the world of the rig, fitted to the corners that were seen."""
    cameras = [rig[name] for name in seen]
    if len(cameras) == 1:
        camera = cameras[0]
        T = _board_pose(seen[camera.name], (camera.K, camera.dist), board)
        return camera.R.T @ T[:3, :3], camera.R.T @ (T[:3, 3] - camera.t)
    points = triangulate(cameras, list(seen.values()))
    center = points.mean(axis=0)
    U, _, Vt = np.linalg.svd((points - center).T @ board)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return R, center


def _on_floor(rig: CameraRig, seen: Mapping[str, Array], board: Array) -> CameraRig:
    """The rig in the world whose floor is the board: origin at its centre, z up."""
    R_board, center = _place_board(rig, seen, board)
    up = R_board[:, 2]
    if np.mean([up @ (camera.center - center) for camera in rig]) < 0:
        up = -up  # cameras stand above the floor
    x = R_board[:, 0]
    R_rig_world = np.column_stack([x, np.cross(up, x), up])
    return CameraRig(
        tuple(
            Camera(
                c.name, c.size, c.K, c.dist, c.R @ R_rig_world, c.R @ center + c.t, is_fisheye=c.is_fisheye
            )
            for c in rig
        )
    )


def _errors(
    rig: CameraRig, numbered: Mapping[int, Mapping[str, Array]], board: Array
) -> dict[tuple[int, str], Array]:
    """Distances (N,) px between corners and the board laid into them, by frame and camera."""
    errors = {}
    for frame, seen in numbered.items():
        if not seen:
            continue
        R, t = _place_board(rig, seen, board)
        for name, uv in seen.items():
            errors[frame, name] = np.linalg.norm(rig[name].project(board @ R.T + t)[0] - uv, axis=1)
    return errors


def _without_bad_views(
    rig: CameraRig, numbered: dict[int, dict[str, Array]], board: Array
) -> dict[int, dict[str, Array]]:
    """Views without those that are off much more than most, such as boards seen at a grazing angle.

    A camera keeps MIN_VIEWS, and a frame one view.
    """
    rms = {view: _rms([e]) for view, e in _errors(rig, numbered, board).items()}
    limit = _BAD_VIEW * float(np.median(list(rms.values())))
    left = {name: sum(name in seen for seen in numbered.values()) for name in rig.names}
    kept = {frame: dict(seen) for frame, seen in numbered.items()}
    for (frame, name), error in sorted(rms.items(), key=lambda found: -found[1]):
        if error > limit and left[name] > MIN_VIEWS and len(kept[frame]) > 1:
            del kept[frame][name]
            left[name] -= 1
    return kept


def _rms(errors: Sequence[Array]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def _warnings(rig: CameraRig, rms_of: Mapping[str, float]) -> list[str]:
    found = []
    for camera in rig:
        fx, fy = camera.K[0, 0], camera.K[1, 1]
        if rms_of[camera.name] > _WARN_RMS_PX:
            found.append(
                f"camera {camera.name}: corners are off by {rms_of[camera.name]:.1f} px; clips may not be "
                "synchronised, the board not flat, or the pictures blurred"
            )
        if abs(fx / fy - 1) > 0.03:
            found.append(
                f"camera {camera.name}: focal lengths {fx:.0f} and {fy:.0f} px differ; show the board tilted both ways"
            )
        off = abs(camera.K[:2, 2] / np.array(camera.size) - 0.5)
        if off.max() > 0.15:
            found.append(
                f"camera {camera.name}: its centre is far from the middle of the picture; show the board near the "
                "edges too"
            )
        if camera.center[2] < 0.1:
            found.append(f"camera {camera.name} lies at {camera.center[2]:.2f} m; is the floor frame right?")
    return found
