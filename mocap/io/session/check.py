"""Checks of an opened session before it is run: the second half of `mocap check`, one function per check."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.data import CameraRig
from mocap.errors import MocapError
from mocap.io._files import VIDEO_SUFFIXES
from mocap.io.calibration import calibration_candidates, read_calibration
from mocap.io.checkerboard import BoardMeasure, Views, find_boards, measure_board
from mocap.io.session.reading import keypoints_of
from mocap.io.session.record import Finding, Session
from mocap.io.session.sources import sources_in
from mocap.io.video import clip_info, list_pictures, promised_size, size_error

Array = NDArray[np.float64]

GOOD_RMS_PX, POOR_RMS_PX = 1.0, 2.0
MAX_SCALE_ERROR = 0.03
# Grid on which the common view is measured.
_STEP_M = 0.1
_HEIGHT_M = 2.0
_MIN_COMMON_M3 = 1.0
_AHEAD_M = 4.0
_MIN_BACKGROUND_FRAMES = 5
# Two cameras that stand further apart than this see nearly the same outline (docs/few-cameras.md), unless one of them
# looks down: the sine of its height over the middle.
_SAME_SIDE_DEG, _OPPOSITE_DEG, _STEEP_SINE = 30.0, 140.0, 0.7
# A camera that shows nobody in most frames adds little, or its files are of another clip.
_FEW_FIGURES = 0.6
# Wrong pictures of one folder that are listed one by one.
_SHOWN = 3


def calibration(session: Session) -> list[Finding]:
    """The calibration in use, and what its reader converted."""
    used = session.calibration
    text = f"calibration {session.calibration_path.name}: {used.format}, {len(used.rig)} cameras, unit {used.units}"
    if used.rms_px is not None:
        text += f", its own reprojection error {used.rms_px:.2f} px"
    return [Finding("ok", text), *(Finding("ok", f"calibration: {note}") for note in session.notes)]


def warnings(session: Session) -> list[Finding]:
    """What was found while the session was opened."""
    return [Finding("warning", text) for text in session.warnings]


def geometry(session: Session) -> list[Finding]:
    """Where the cameras stand, and what they see together."""
    rig = session.rig
    centers = np.array([c.center for c in rig])
    baselines = np.linalg.norm(centers[:, None] - centers[None], axis=-1)[np.triu_indices(len(rig), 1)]
    out = [
        Finding(
            "ok",
            f"{len(rig)} cameras {', '.join(rig.names)}; heights {centers[:, 2].min():.2f} to "
            f"{centers[:, 2].max():.2f} m, baselines {baselines.min():.2f} to {baselines.max():.2f} m",
        )
    ]
    if baselines.min() < 0.1:
        i, j = (int(k[np.argmin(baselines)]) for k in np.triu_indices(len(rig), 1))
        out.append(
            Finding(
                "warning",
                f"cameras {rig[i].name} and {rig[j].name} are {baselines.min() * 1000:.0f} mm apart: the second adds "
                "hardly anything",
                rig[j].name,
                "check that the two are not the same camera",
            )
        )
    if len(rig) < 4 and (session.image_sources or session.mask_sources):
        beside = ", and keypoints beside them (--observation fused)" if session.keypoint_sources else ""
        out.append(
            Finding(
                "warning",
                f"with {len(rig)} cameras the volumes are coarse",
                remedy=f"use four or more cameras{beside}",
            )
        )
    return out + _common_view(session, rig, centers)


def _common_view(session: Session, rig: CameraRig, centers: Array) -> list[Finding]:
    points, n_seeing, sees = _visibility(session, rig, centers)
    cell = _STEP_M**3
    enough = max(2, len(rig) - 1)
    common, most, some = n_seeing == len(rig), n_seeing >= enough, n_seeing >= 2
    out = []
    if not most.any():
        counts = {name: int((sees[i] & some).sum()) for i, name in enumerate(rig.names)}
        worst = min(counts, key=counts.__getitem__)
        return [
            Finding(
                "error",
                f"no place up to {_HEIGHT_M:g} m above the floor is seen by {enough} of the {len(rig)} cameras",
                worst,
                f"check pose and direction of camera {worst}, or leave it out of the calibration",
            )
        ]
    where = points[common] if common.any() else points[most]
    low, high = where.min(axis=0), where.max(axis=0)
    middle = where.mean(axis=0)
    distances = np.linalg.norm(centers - middle, axis=1)
    who = "all cameras" if common.any() else f"{enough} of {len(rig)} cameras"
    out.append(
        Finding(
            "ok",
            f"seen by {who}: {len(where) * cell:.1f} m3 below {_HEIGHT_M:g} m, x {low[0]:.1f} to {high[0]:.1f}, "
            f"y {low[1]:.1f} to {high[1]:.1f}, z {low[2]:.1f} to {high[2]:.1f} m; by two or more "
            f"{some.sum() * cell:.1f} m3; {distances.min():.1f} to {distances.max():.1f} m from the cameras",
        )
    )
    if most.sum() * cell < _MIN_COMMON_M3:
        out.append(
            Finding(
                "warning",
                f"only {most.sum() * cell:.2f} m3 are seen by {enough} or more cameras",
                remedy="turn the cameras to one place, or check the calibration",
            )
        )
    out += _sides((centers - middle) / np.maximum(distances, 1e-9)[:, None])
    for i, name in enumerate(rig.names):
        if not (sees[i] & some).any():
            out.append(
                Finding(
                    "warning",
                    "the camera sees nothing that another camera sees",
                    name,
                    "check its pose and direction in the calibration",
                )
            )
    return out


def _sides(directions: Array) -> list[Finding]:
    """What is wrong with the sides that cameras look from.  directions : (C, 3) unit, from the middle to each."""
    cosines = directions @ directions.T
    angle = float(np.degrees(np.arccos(np.clip(np.abs(cosines).min(), 0.0, 1.0))))
    if angle < _SAME_SIDE_DEG and cosines.min() > 0:
        return [
            Finding(
                "warning",
                f"all cameras look from nearly the same side (widest angle {angle:.0f} degrees): depth is uncertain",
                remedy="place cameras around the person",
            )
        ]
    azimuths = np.degrees(np.arctan2(directions[:, 1], directions[:, 0]))
    apart = float(np.abs((azimuths[:, None] - azimuths + 180.0) % 360.0 - 180.0).max())
    is_pair = len(directions) == 2 and np.abs(directions[:, 2]).max() < _STEEP_SINE
    if angle < _SAME_SIDE_DEG or (is_pair and apart > _OPPOSITE_DEG):
        who = "the two cameras stand" if len(directions) == 2 else "all cameras stand in one line, up to"
        return [
            Finding(
                "warning",
                f"{who} {apart:.0f} degrees apart, opposite each other or nearly so: they see the same outline, "
                "mirrored, so that arms, and front and back, can be exchanged, and errors be several times what is "
                "foreseen",
                remedy="place two cameras 60 to 135 degrees apart, or add one at the side",
            )
        ]
    return []


def _visibility(
    session: Session, rig: CameraRig, centers: Array
) -> tuple[Array, NDArray[np.int64], NDArray[np.bool_]]:
    """Points (P, 3) m of a coarse room, how many cameras see each (P,), and which (C, P)."""
    if session.room_bounds_m is not None:
        lower, upper = (np.array(corner) for corner in session.room_bounds_m)
    else:
        # Cameras at one side enclose nothing: people are before them.
        ahead = centers + _AHEAD_M * np.array([c.R[2] for c in rig])
        corners = np.concatenate([centers[:, :2], ahead[:, :2]])
        lower = np.append(corners.min(axis=0) - 1.0, 0.0)
        upper = np.append(corners.max(axis=0) + 1.0, _HEIGHT_M)
    # At most about 200,000 points whatever the size of the room.
    n = np.minimum(np.ceil((upper - lower) / _STEP_M).astype(int) + 1, [100, 100, 21])
    axes = [np.linspace(a, b, k) for a, b, k in zip(lower, upper, n, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    sees = np.stack([camera.contains(camera.project(points)[0]) for camera in rig])
    return points, sees.sum(axis=0), sees


def clips(session: Session) -> list[Finding]:
    """What there is of each camera, and which frames of it are used."""
    what = []
    if session.image_sources:
        what.append("pictures")
    if session.mask_sources:
        what.append("masks")
    if session.detection_sources:
        what.append("detections")
    if session.keypoint_sources:
        what.append("keypoints")
    if session.depth_sources:
        what.append(f"depth of {', '.join(session.depth_sources)}")
    counts = sorted({clip.n_frames for clip in session.clips.values()})
    spread = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}" if counts else ""
    frames = session.frames
    used = f"{spread} frames per camera, {len(frames)} used" if counts else f"{len(frames)} frames used"
    out = [
        Finding(
            "ok",
            f"{' and '.join(what)}: {used} ({frames.start}:{frames.stop}), {session.fps:g} per second, "
            f"{len(frames) / session.fps:.1f} s",
        )
    ]
    return out


def every_picture(session: Session) -> list[Finding]:
    """Whether all pictures of folders are as large as the calibration says, by their headers."""
    out = []
    for sources in (session.image_sources, session.mask_sources, session.background_sources):
        for name, folder in sources.items():
            wrong = _wrong_pictures(folder, name, session.rig[name].size) if folder.is_dir() else []
            out += [Finding("error", error.message, name, error.remedy) for error in wrong[:_SHOWN]]
            if len(wrong) > _SHOWN:
                more = f"{len(wrong) - _SHOWN} more pictures of {folder.name}/ are wrong"
                out.append(Finding("error", more, name, "look at all of them"))
    return out


def _wrong_pictures(folder: Path, camera: str, size: tuple[int, int]) -> list[MocapError]:
    wrong = []
    for frame, path in enumerate(list_pictures(folder)):
        try:
            found = promised_size(path, camera=camera, frame=frame)
            if found != size:
                raise size_error(found, size, path, camera, frame)
        except MocapError as error:
            wrong.append(MocapError(f"frame {frame}, {path.name}: {error.message}", remedy=error.remedy))
    return wrong


def keypoints(session: Session) -> list[Finding]:
    """Whether the keypoints can be read, and in how many frames every camera shows somebody."""
    if not session.keypoint_sources:
        return []
    try:
        figures = keypoints_of(session)
    except MocapError as error:
        of = "" if error.path is None else f" (file {error.path})"
        return [Finding("error", f"{error.message}{of}", error.camera, error.remedy)]
    counts = np.zeros((len(session.frames), len(session.rig)), dtype=np.int64)
    for i, frame in enumerate(session.frames):
        np.add.at(counts[i], figures[frame].camera, 1)
    out = [
        Finding(
            "ok",
            f"keypoints of {len(session.keypoint_sources)} cameras: {counts.mean():.1f} persons per picture, at most "
            f"{counts.max()}",
        )
    ]
    share = (counts > 0).mean(axis=0)
    seldom = [
        (name, float(own))
        for name, own in zip(session.rig.names, share, strict=True)
        if name in session.keypoint_sources and own < _FEW_FIGURES
    ]
    if seldom:
        names = ", ".join(f"{name} {100 * own:.0f} %" for name, own in seldom)
        out.append(
            Finding(
                "warning",
                f"keypoints/ has somebody in few of the frames only: {names}",
                seldom[0][0] if len(seldom) == 1 else None,
                "check that the files are of this clip, at its frame rate and from its first frame on",
            )
        )
    return out


def background(session: Session) -> list[Finding]:
    """Whether the empty scene is known."""
    if session.mask_sources:
        return [Finding("ok", "masks are given: segmentation is skipped")]
    if not session.image_sources:
        return []
    if not session.background_sources:
        return [
            Finding(
                "warning",
                "no background/: the empty scene must be learnt from the clips themselves, which works only when "
                "the person moves about",
                remedy="film the empty room for a second and put it into background/CAM.mp4 (or CAM.png)",
            )
        ]
    counts = {n: clip_info(p, camera=n).n_frames for n, p in session.background_sources.items()}
    out = [Finding("ok", f"background: {min(counts.values())} to {max(counts.values())} frames per camera")]
    if few := [n for n, c in counts.items() if c < _MIN_BACKGROUND_FRAMES]:
        out.append(
            Finding(
                "warning",
                f"fewer than {_MIN_BACKGROUND_FRAMES} background frames of camera {', '.join(few)}: the noise of its "
                "pixels must be guessed",
                few[0],
                "give a clip of the empty scene instead of a picture",
            )
        )
    return out


def calibration_quality(session: Session) -> list[Finding]:
    """How well the calibration, and others in the folder, fit a checkerboard that was filmed."""
    folder = session.root / "checkerboard"
    sources = {n: p for n, p in sources_in(folder, VIDEO_SUFFIXES).items() if n in session.rig.names}
    if len(sources) < 2:
        return []
    try:
        found = find_boards(sources, session.checkerboard)
    except MocapError as error:
        return [Finding("warning", f"checkerboard/: {error.message}", error.camera, error.remedy)]
    if found is None:
        return [
            Finding(
                "warning",
                "no checkerboard was found in checkerboard/",
                remedy="say its inner corners in session.toml: checkerboard = [columns, rows]",
            )
        ]
    size, views = found
    measure = measure_board(session.rig, size, views, square_m=session.checkerboard_square_m)
    if measure is None:
        return []
    out = [_judged(session, measure)]
    return out + _other_calibrations(session, size, views, measure)


def _error_px(measure: BoardMeasure) -> float:
    return measure.rms_px if measure.rms_true_size_px is None else measure.rms_true_size_px


def _described(measure: BoardMeasure) -> str:
    text = f"{measure.rms_px:.2f} px rms, squares of {measure.square_m * 1000:.1f} mm"
    if measure.rms_true_size_px is not None:
        text += f", {measure.rms_true_size_px:.2f} px with squares of the true size"
    return text


def _judged(session: Session, measure: BoardMeasure) -> Finding:
    worst = max(measure.rms_px_of, key=measure.rms_px_of.__getitem__)
    text = (
        f"{session.calibration_path.name} on the {measure.size[0]} x {measure.size[1]} checkerboard: "
        f"{_described(measure)} (worst camera {worst} {measure.rms_px_of[worst]:.2f} px)"
    )
    true = session.checkerboard_square_m
    if true is not None and abs(measure.square_m / true - 1) > MAX_SCALE_ERROR:
        return Finding(
            "warning",
            f"{text}; the scale is wrong by {100 * (measure.square_m / true - 1):+.1f} %",
            remedy=f"calibrate again, or divide the translations by {measure.square_m / true:.4f}",
        )
    if _error_px(measure) > POOR_RMS_PX:
        return Finding("warning", f"{text}: poor", worst, "calibrate again with `mocap calibrate`")
    if _error_px(measure) > GOOD_RMS_PX:
        return Finding("warning", f"{text}: not good", worst, "calibrate again for better than 1 px")
    return Finding("ok", text)


def _other_calibrations(
    session: Session, size: tuple[int, int], views: Views, own: BoardMeasure
) -> list[Finding]:
    out = []
    used = session.calibration_path.resolve()
    candidates = {p.resolve(): p for p in calibration_candidates(session.root)}
    if (plain := session.root / "calibration.toml").is_file():
        candidates.setdefault(plain.resolve(), plain)
    for resolved, path in sorted(candidates.items()):
        if resolved == used:
            continue
        measure = _measured(path, size, views, session.checkerboard_square_m)
        if measure is None:
            continue
        is_better = _error_px(measure) < _error_px(own)
        text = f"{path.name} on the same checkerboard: {_described(measure)}"
        if is_better:
            out.append(
                Finding(
                    "warning",
                    f"{text}: better than {session.calibration_path.name}",
                    remedy=f"use it with --calibration {path}",
                )
            )
        else:
            out.append(Finding("ok", f"{text}: worse than {session.calibration_path.name}"))
    return out


def _measured(path: Path, size: tuple[int, int], views: Views, square_m: float | None) -> BoardMeasure | None:
    try:
        rig = read_calibration(path, check_world=False).rig
    except MocapError:
        # The file is not the one in use; that it cannot be read is no finding about this session.
        return None
    return measure_board(rig, size, views, square_m=square_m)
