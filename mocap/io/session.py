"""A session folder: which cameras it has, where their pictures lie, which frames are common to all."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from mocap.data import Camera, CameraRig
from mocap.errors import MocapError
from mocap.io._files import IMAGE_SUFFIXES, VIDEO_SUFFIXES, natural_key
from mocap.io.calibration import CalibrationFile, find_calibration, read_calibration
from mocap.io.units import AXES, METRES_PER_UNIT, unit_from_word
from mocap.io.video import ClipInfo, clip_info, size_error

Bounds = tuple[tuple[float, float, float], tuple[float, float, float]]
Polygon = tuple[tuple[float, float], ...]

DEFAULT_FPS = 30.0
# Headers of sound videos promise a few frames more than can be decoded; more than that means a damaged file.
MAX_HEADER_DIFFERENCE = 5
MAX_HEADER_DIFFERENCE_SHARE = 0.01

_COLOURS = {
    "white": (255, 255, 255),
    "red": (255, 0, 0),
    "green": (0, 255, 0),
    "blue": (0, 0, 255),
    "yellow": (255, 255, 0),
    "orange": (255, 128, 0),
    "cyan": (0, 255, 255),
    "magenta": (255, 0, 255),
}


@dataclass(frozen=True, eq=False)
class Session:
    """A checked session folder.

    rig : the cameras with a source, in the order of the calibration.  frames : the frames to work on.
    image_sources, mask_sources : camera name -> path; each is either empty or covers the whole rig.
    background_sources, detection_sources : camera name -> path; may cover the rig in part.
    clips : camera name -> what was counted and measured of its pictures (else masks).
    room_bounds_m : (lower, upper) corners, m, world.  checkerboard : inner corners (columns, rows).
    roi_sources, roi_px : camera name -> picture that is not 0, or polygon of (u, v), where persons can be; cameras with
    neither look everywhere.
    notes : conversions of the calibration reader.  warnings : what the user should know before trusting a run.
    """

    root: Path
    name: str
    rig: CameraRig
    fps: float
    frames: range
    image_sources: dict[str, Path]
    background_sources: dict[str, Path]
    mask_sources: dict[str, Path]
    detection_sources: dict[str, Path]
    room_bounds_m: Bounds | None
    person_height_m: float | None
    warnings: tuple[str, ...]
    truth_dir: Path | None
    calibration_path: Path
    calibration: CalibrationFile
    clips: dict[str, ClipInfo]
    notes: tuple[str, ...] = ()
    marker_colour: tuple[int, int, int] | None = None
    checkerboard: tuple[int, int] | None = None
    checkerboard_square_m: float | None = None
    roi_sources: dict[str, Path] = field(default_factory=dict)
    roi_px: dict[str, Polygon] = field(default_factory=dict)


@dataclass(frozen=True)
class Finding:
    """One line of `mocap check`."""

    severity: Literal["ok", "warning", "error"]
    message: str
    camera: str | None = None
    remedy: str = ""


@dataclass(frozen=True)
class SessionSettings:
    """session.toml, checked; every key may be missing."""

    fps: float | None = None
    frames: tuple[int | None, int | None] | None = None
    room_bounds_m: Bounds | None = None
    person_height_m: float | None = None
    marker_colour: tuple[int, int, int] | None = None
    cameras: tuple[str, ...] | None = None
    camera_map: Mapping[str, str] | None = None
    calibration_units: str | None = None
    calibration_up: str | None = None
    checkerboard: tuple[int, int] | None = None
    checkerboard_square_m: float | None = None
    roi_px: Mapping[str, Polygon] | None = None


def read_session_settings(path: Path | str) -> SessionSettings:
    """Read and check session.toml; a file that is not there gives the defaults.

    Keys: fps, frames = [start, stop], room_bounds_m = [[x, y, z], [x, y, z]], person_height_m, marker_colour =
    "red" | "#rrggbb" | [r, g, b], cameras = ["camera name", ...] (the others are left out), calibration_units,
    calibration_up, checkerboard = [columns, rows] (inner corners), checkerboard_square_m, and the tables
    [camera_map] file name = "camera name" and [roi_px] camera name = [[u, v], ...] (corners of a polygon).
    Raises MocapError naming the key for anything else.
    """
    path = Path(path)
    if not path.exists():
        return SessionSettings()
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise MocapError(
            f"session.toml cannot be read: {error}", path=path, remedy="correct the file"
        ) from error
    known = list(SessionSettings.__dataclass_fields__)
    for key in document:
        if key not in known:
            raise _bad_key(path, key, f"is not known; known keys are {', '.join(known)}")
    return SessionSettings(
        fps=_positive(path, document, "fps"),
        frames=_frame_pair(path, document),
        room_bounds_m=_bounds(path, document),
        person_height_m=_positive(path, document, "person_height_m", 0.3, 3.0),
        marker_colour=_colour(path, document),
        cameras=_cameras(path, document),
        camera_map=_camera_map(path, document),
        calibration_units=_units(path, document),
        calibration_up=_up(path, document),
        checkerboard=_board(path, document),
        checkerboard_square_m=_positive(path, document, "checkerboard_square_m"),
        roi_px=_polygons(path, document),
    )


def open_session(
    root: Path | str,
    *,
    calibration: Path | str | None = None,
    frames: tuple[int | None, int | None] | None = None,
) -> Session:
    """Open a session folder and check that its parts belong together.

    calibration : file to use instead of the session's own.  frames : (start, stop), stop excluded, None = from
    the first / to the last common frame; overrides session.toml.
    Raises MocapError with camera, file and remedy for no or bad calibration, no pictures and no masks, a source
    without calibration, a calibrated camera without source (unless session.toml names the `cameras` to use),
    fewer than two cameras, sizes differing from the calibration, clips of different length, unreadable,
    truncated or empty clips, a frame range outside the clips.
    """
    root = Path(root)
    if not root.is_dir():
        raise MocapError(
            "no such session folder", path=root, remedy="check the path, or make one: mocap synth"
        )
    settings = read_session_settings(root / "session.toml")
    calibration_path = Path(calibration) if calibration is not None else find_calibration(root)
    found = read_calibration(calibration_path, units=settings.calibration_units, up=settings.calibration_up)
    warnings = list(found.warnings)
    sources = _match_sources(root, settings, found.rig, calibration_path, warnings)
    if strangers := [n for n in settings.roi_px or {} if n not in found.rig.names]:
        raise _bad_key(
            root / "session.toml", f"roi_px.{strangers[0]}", "names a camera that is not calibrated"
        )
    wanted_rig = _wanted_cameras(root, found.rig, settings.cameras)
    rig, images, masks = _choose_cameras(root, wanted_rig, sources, warnings)
    backgrounds = {n: p for n, p in sources["background"].items() if n in rig.names}
    detections = {n: p for n, p in sources["detections"].items() if n in rig.names}
    if backgrounds and (lacking := [n for n in rig.names if n not in backgrounds]):
        warnings.append(f"no background/ for camera {', '.join(lacking)}")
    if detections and (lacking := [n for n in rig.names if n not in detections]):
        warnings.append(f"no detections/ for camera {', '.join(lacking)}")

    main = images or masks
    clips = {n: clip_info(p, camera=n) for n, p in main.items()}
    rig = _rig_with_true_sizes(rig, found, clips)
    for name, clip in clips.items():
        _check_clip_size(clip, rig[name])
    for name, path in backgrounds.items():
        _check_clip_size(clip_info(path, camera=name), rig[name])
    counted = dict(clips)
    if images and masks:
        for name, path in masks.items():
            clip = clip_info(path, camera=name)
            _check_clip_size(clip, rig[name])
            counted[f"{name} (masks)"] = clip
    wanted = frames if frames is not None else settings.frames
    chosen = _choose_frames(root, counted, detections, wanted)
    truth = root / "truth"
    return Session(
        root=root,
        name=root.resolve().name,
        rig=rig,
        fps=_choose_fps(settings, clips, warnings),
        frames=chosen,
        image_sources=images,
        background_sources=backgrounds,
        mask_sources=masks,
        detection_sources=detections,
        room_bounds_m=settings.room_bounds_m,
        person_height_m=settings.person_height_m,
        warnings=tuple(warnings),
        truth_dir=truth if truth.is_dir() else None,
        calibration_path=calibration_path,
        calibration=found,
        clips=clips,
        notes=found.notes,
        marker_colour=settings.marker_colour,
        checkerboard=settings.checkerboard,
        checkerboard_square_m=settings.checkerboard_square_m,
        roi_sources={n: p for n, p in sources["roi"].items() if n in rig.names},
        roi_px={n: p for n, p in (settings.roi_px or {}).items() if n in rig.names},
    )


def check_session(session: Session) -> list[Finding]:
    """What `mocap check` prints: cameras, common view, clips, background, masks, quality of the calibration."""
    from mocap.io.check import findings

    return findings(session)


# --- sources ------------------------------------------------------------------------------------------------


def sources_in(folder: Path, kinds: frozenset[str], *, with_folders: bool = True) -> dict[str, Path]:
    """Sources of a folder by name without suffix: files of the given suffixes and folders that hold pictures.

    Of several kinds under one name a video comes before a folder, and a folder before a single picture.
    Raises MocapError when two videos have one name.
    """
    if not folder.is_dir():
        return {}
    found: dict[str, tuple[int, Path]] = {}
    for path in sorted(folder.iterdir(), key=lambda p: natural_key(p.name)):
        if path.name.startswith("."):
            continue
        if path.is_dir():
            if not with_folders:
                continue
            name, rank = path.name, 1
        elif path.suffix.lower() in kinds:
            name, rank = path.stem, 2 if path.suffix.lower() in IMAGE_SUFFIXES else 0
        else:
            continue
        if name in found and found[name][0] == rank:
            raise MocapError(
                f"two sources for one camera: {found[name][1].name} and {path.name}",
                path=folder,
                camera=name,
                remedy="keep one of them",
            )
        if name not in found or rank < found[name][0]:
            found[name] = (rank, path)
    return {name: path for name, (_, path) in found.items()}


def _match_sources(
    root: Path, settings: SessionSettings, rig: CameraRig, calibration: Path, warnings: list[str]
) -> dict[str, dict[str, Path]]:
    """Sources by kind and calibrated camera name; an unknown name is an error, not a camera less."""
    kinds: dict[str, dict[str, Path]] = {
        "videos": sources_in(root / "videos", VIDEO_SUFFIXES, with_folders=False),
        "images": sources_in(root / "images", IMAGE_SUFFIXES),
        "background": sources_in(root / "background", VIDEO_SUFFIXES | IMAGE_SUFFIXES),
        "masks": sources_in(root / "masks", VIDEO_SUFFIXES | IMAGE_SUFFIXES | {".npz"}),
        "detections": sources_in(root / "detections", frozenset({".csv"}), with_folders=False),
        "roi": sources_in(root / "roi", IMAGE_SUFFIXES, with_folders=False),
    }
    camera_map = settings.camera_map or {}
    all_names = {name for sources in kinds.values() for name in sources}
    for file_name, camera in camera_map.items():
        if camera not in rig.names:
            raise _bad_key(
                root / "session.toml",
                f"camera_map.{file_name}",
                f"names camera {camera!r}, but the calibration has {_listed(rig.names)}",
            )
        if file_name not in all_names:
            raise _bad_key(
                root / "session.toml",
                f"camera_map.{file_name}",
                f"is no file of the session, which has {_listed(sorted(all_names, key=natural_key))}",
            )
    matched: dict[str, dict[str, Path]] = {}
    for kind, sources in kinds.items():
        named: dict[str, Path] = {}
        for name, path in sources.items():
            camera = camera_map.get(name, name)
            if camera in named:
                raise _bad_key(
                    root / "session.toml", "camera_map", f"gives camera {camera!r} two sources in {kind}/"
                )
            named[camera] = path
        if strangers := [n for n in named if n not in rig.names]:
            raise MocapError(
                f"{kind}/ has {_listed(strangers)}, which the calibration does not know: {kind}/ holds "
                f"{_listed(list(sources))}; {calibration.name} has {_listed(rig.names)}",
                path=named[strangers[0]],
                camera=strangers[0],
                remedy="give files and calibrated cameras the same names, or say which is which in "
                f'session.toml: [camera_map] "{named[strangers[0]].stem}" = "CAMERA NAME"',
            )
        matched[kind] = {n: named[n] for n in rig.names if n in named}
    if matched["videos"] and matched["images"]:
        both = sorted(matched["videos"].keys() & matched["images"].keys(), key=natural_key)
        if both:
            warnings.append(f"videos/ and images/ both have camera {_listed(both)}: the videos are used")
    matched["pictures"] = {**matched["images"], **matched["videos"]}
    return matched


def _wanted_cameras(root: Path, rig: CameraRig, cameras: tuple[str, ...] | None) -> CameraRig:
    """The cameras that session.toml asks for, in the order of the calibration; all when it does not say."""
    if cameras is None:
        return rig
    if strangers := [n for n in cameras if n not in rig.names]:
        raise _bad_key(
            root / "session.toml",
            "cameras",
            f"names {_listed(strangers)}, but the calibration has {_listed(rig.names)}",
        )
    return rig.subset([n for n in rig.names if n in cameras])


def _choose_cameras(
    root: Path, rig: CameraRig, sources: Mapping[str, Mapping[str, Path]], warnings: list[str]
) -> tuple[CameraRig, dict[str, Path], dict[str, Path]]:
    """The rig of cameras with a source, and image and mask sources that each cover it or are empty."""
    pictures, masks, detections = sources["pictures"], sources["masks"], sources["detections"]
    if not any(n in kind for kind in (pictures, masks, detections) for n in rig.names):
        raise MocapError(
            "the session has no pictures and no masks"
            + (f" of camera {_listed(rig.names)}" if pictures or masks or detections else ""),
            path=root,
            remedy="put videos/CAM.mp4 or images/CAM/*.png there (or masks/CAM/*.png), CAM as named in the "
            "calibration",
        )
    main = (pictures.keys() | masks.keys()) & set(rig.names) or detections.keys()
    present = [n for n in rig.names if n in main]
    absent = [n for n in rig.names if n not in main]
    if len(present) < 2:
        raise MocapError(
            f"only camera {present[0]} has pictures; at least two cameras are needed"
            + (f" (nothing for {_listed(absent)})" if absent else ""),
            path=root,
            camera=(absent or present)[0],
            remedy="add the videos of the other cameras, named as in the calibration",
        )
    if absent:
        kept = ", ".join(f'"{n}"' for n in present)
        raise MocapError(
            f"camera {_listed(absent)} {'is' if len(absent) == 1 else 'are'} calibrated but "
            f"{'has' if len(absent) == 1 else 'have'} no video, pictures or masks",
            path=root,
            camera=absent[0],
            remedy="add the missing clip, named as in the calibration, or leave the camera out in session.toml: "
            f"cameras = [{kept}]",
        )
    images = {n: pictures[n] for n in present if n in pictures}
    given = {n: masks[n] for n in present if n in masks}
    no_image = [n for n in present if n not in images]
    no_mask = [n for n in present if n not in given]
    if images and given and no_image and no_mask:
        raise MocapError(
            f"camera {_listed(no_image)} has masks but no pictures, camera {_listed(no_mask)} pictures but no masks",
            path=root,
            camera=no_image[0],
            remedy="give pictures for all cameras, or masks for all cameras",
        )
    if given and no_mask:
        warnings.append(
            f"masks/ lacks camera {_listed(no_mask)}: the masks are ignored, the pictures are used"
        )
        given = {}
    if images and no_image:
        warnings.append(f"no pictures of camera {_listed(no_image)}: only the masks are used")
        images = {}
    return rig.subset(present), images, given


def _rig_with_true_sizes(rig: CameraRig, found: CalibrationFile, clips: Mapping[str, ClipInfo]) -> CameraRig:
    """Where the calibration file gave no size, the pictures do."""
    if not found.guessed_sizes:
        return rig
    cameras = [
        Camera(c.name, clips[c.name].size, c.K, c.dist, c.R, c.t, c.is_fisheye)
        if c.name in found.guessed_sizes and c.name in clips
        else c
        for c in rig
    ]
    return CameraRig(tuple(cameras))


def _check_clip_size(clip: ClipInfo, camera: Camera) -> None:
    # An archive of packed masks does not always know its width; the reader checks it again.
    is_packed = clip.path.suffix.lower() == ".npz" and clip.size[0] == (camera.size[0] + 7) // 8
    if clip.size != camera.size and not (is_packed and clip.size[1] == camera.size[1]):
        raise size_error(clip.size, camera.size, clip.path, camera.name)


def _choose_frames(
    root: Path,
    clips: Mapping[str, ClipInfo],
    detections: Mapping[str, Path],
    wanted: tuple[int | None, int | None] | None,
) -> range:
    counts = {name: clip.n_frames for name, clip in clips.items()}
    if not counts:
        counts = {name: _detected_frames(path) for name, path in detections.items()}
        counts = dict.fromkeys(counts, max(counts.values()))
    shortest, longest = min(counts.values()), max(counts.values())
    start, stop = wanted if wanted is not None else (None, None)
    last = shortest if stop is None else stop
    if (start is not None and (start < 0 or start >= last)) or last < 1:
        raise _bad_range(root, start, stop, "is empty", shortest)
    if stop is not None and stop > shortest:
        short = min(counts, key=counts.__getitem__)
        where = f"ends after frame {shortest - 1} of camera {short}, which has {shortest} frames"
        raise _bad_range(root, start, stop, f"goes beyond the clips: the session {where}", shortest, short)
    if start is not None and start >= shortest:
        raise _bad_range(root, start, stop, "starts after the clips have ended", shortest)

    if stop is None:
        _check_cut_off(clips, shortest)
        if longest > shortest:
            # One lost frame shifts the rest of a clip: only the user can say which frames belong together.
            listed = ", ".join(f"{n}: {c}" for n, c in counts.items())
            raise MocapError(
                f"the clips have different numbers of frames ({listed}); were they started together?",
                path=root,
                camera=min(counts, key=counts.__getitem__),
                remedy=f"if they are synchronised from the first frame on, say so with `--frames 0:{shortest}`",
            )
    return range(start or 0, last)


def _check_cut_off(clips: Mapping[str, ClipInfo], shortest: int) -> None:
    """A header that promises far more than can be decoded means a damaged file."""
    for name, clip in clips.items():
        if clip.header_frames is None:
            continue
        promised = clip.header_frames
        if promised - clip.n_frames > max(MAX_HEADER_DIFFERENCE, MAX_HEADER_DIFFERENCE_SHARE * promised):
            raise MocapError(
                f"the video is truncated or damaged: {promised} frames are promised, {clip.n_frames} can be decoded",
                path=clip.path,
                camera=name,
                frame=clip.n_frames,
                remedy=f"copy the file again, or use what is there with `--frames 0:{shortest}`",
            )


def _bad_range(
    root: Path, start: int | None, stop: int | None, what: str, n: int, camera: str | None = None
) -> MocapError:
    text = f"{'' if start is None else start}:{'' if stop is None else stop}"
    return MocapError(
        f"the frame range {text} {what}",
        path=root,
        camera=camera,
        remedy=f"choose it within `--frames 0:{n}`",
    )


def _detected_frames(path: Path) -> int:
    from mocap.io.tables import read_detections_csv

    frame, _ = read_detections_csv(path)
    return int(frame[-1]) + 1 if len(frame) else 0


def _choose_fps(settings: SessionSettings, clips: Mapping[str, ClipInfo], warnings: list[str]) -> float:
    rates = {name: clip.fps for name, clip in clips.items() if clip.fps is not None}
    if settings.fps is not None:
        return settings.fps
    if not rates:
        if any(clip.n_frames > 1 for clip in clips.values()) or not clips:
            warnings.append(f"no frame rate is known: {DEFAULT_FPS:g} per second assumed (session.toml: fps)")
        return DEFAULT_FPS
    values = list(rates.values())
    # Among differing headers the most frequent rate is the best guess.
    fps = max(sorted(set(values)), key=values.count)
    if max(values) - min(values) > 1e-3 * fps:
        listed = ", ".join(f"{n}: {v:g}" for n, v in rates.items())
        warnings.append(
            f"the videos have different frame rates ({listed}): {fps:g} is used (session.toml: fps)"
        )
    return fps


def _listed(names: Any, limit: int = 10) -> str:
    names = list(names)
    more = f" and {len(names) - limit} more" if len(names) > limit else ""
    return (", ".join(str(n) for n in names[:limit]) or "nothing") + more


# --- session.toml -------------------------------------------------------------------------------------------


def _bad_key(path: Path, key: str, what: str) -> MocapError:
    return MocapError(f"session.toml: {key} {what}", path=path, remedy="correct session.toml")


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e12


def _positive(
    path: Path, document: dict[str, Any], key: str, low: float = 0.0, high: float = 1e9
) -> float | None:
    value = document.get(key)
    if value is None:
        return None
    if not _is_number(value) or not low < value < high:
        limits = f" between {low:g} and {high:g}" if low > 0 else " above 0"
        raise _bad_key(path, key, f"is {value!r}, expected a number{limits}")
    return float(value)


def _frame_pair(path: Path, document: dict[str, Any]) -> tuple[int | None, int | None] | None:
    value = document.get("frames")
    if value is None:
        return None
    is_pair = isinstance(value, list) and len(value) == 2 and all(type(v) is int for v in value)
    if not is_pair or not 0 <= value[0] < value[1]:
        raise _bad_key(path, "frames", f"is {value!r}, expected [start, stop] with 0 <= start < stop")
    return value[0], value[1]


def _bounds(path: Path, document: dict[str, Any]) -> Bounds | None:
    value = document.get("room_bounds_m")
    if value is None:
        return None
    is_table = (
        isinstance(value, list)
        and len(value) == 2
        and all(isinstance(row, list) and len(row) == 3 and all(map(_is_number, row)) for row in value)
    )
    if not is_table or not all(a < b for a, b in zip(*value, strict=True)):
        raise _bad_key(
            path,
            "room_bounds_m",
            f"is {value!r}, expected [[x0, y0, z0], [x1, y1, z1]] in metres, lower first",
        )
    lower, upper = ((float(x), float(y), float(z)) for x, y, z in value)
    return lower, upper


def _colour(path: Path, document: dict[str, Any]) -> tuple[int, int, int] | None:
    value = document.get("marker_colour")
    if value is None:
        return None
    if isinstance(value, str):
        if value.lower() in _COLOURS:
            return _COLOURS[value.lower()]
        if re.fullmatch(r"#[0-9a-fA-F]{6}", value):
            return int(value[1:3], 16), int(value[3:5], 16), int(value[5:7], 16)
    if isinstance(value, list) and len(value) == 3 and all(type(v) is int and 0 <= v <= 255 for v in value):
        return value[0], value[1], value[2]
    raise _bad_key(
        path,
        "marker_colour",
        f'is {value!r}, expected [r, g, b] in 0..255, "#rrggbb" or {", ".join(_COLOURS)}',
    )


def _cameras(path: Path, document: dict[str, Any]) -> tuple[str, ...] | None:
    value = document.get("cameras")
    if value is None:
        return None
    if not isinstance(value, list) or not value or not all(isinstance(v, str) for v in value):
        raise _bad_key(path, "cameras", f"is {value!r}, expected a list of names of calibrated cameras")
    return tuple(value)


def _camera_map(path: Path, document: dict[str, Any]) -> dict[str, str] | None:
    value = document.get("camera_map")
    if value is None:
        return None
    if not isinstance(value, dict):
        raise _bad_key(path, "camera_map", 'is no table, expected [camera_map] "file name" = "camera name"')
    for key, name in value.items():
        if not isinstance(name, str):
            raise _bad_key(
                path, f"camera_map.{key}", f"is {name!r}, expected the name of a calibrated camera"
            )
    if doubled := sorted({n for n in value.values() if list(value.values()).count(n) > 1}):
        raise _bad_key(path, "camera_map", f"gives camera {', '.join(doubled)} to more than one file")
    return dict(value)


def _polygons(path: Path, document: dict[str, Any]) -> dict[str, Polygon] | None:
    value = document.get("roi_px")
    if value is None:
        return None
    if not isinstance(value, dict):
        raise _bad_key(
            path, "roi_px", "is no table, expected [roi_px] camera = [[u, v], [u, v], [u, v], ...]"
        )
    polygons = {}
    for name, corners in value.items():
        is_polygon = isinstance(corners, list) and len(corners) >= 3
        if not is_polygon or not all(
            isinstance(c, list) and len(c) == 2 and all(map(_is_number, c)) for c in corners
        ):
            raise _bad_key(path, f"roi_px.{name}", f"is {corners!r}, expected at least three corners [u, v]")
        polygons[name] = tuple((float(u), float(v)) for u, v in corners)
    return polygons


def _units(path: Path, document: dict[str, Any]) -> str | None:
    value = document.get("calibration_units")
    if value is None:
        return None
    unit = unit_from_word(value) if isinstance(value, str) else None
    if unit is None:
        raise _bad_key(
            path, "calibration_units", f"is {value!r}, expected one of {', '.join(METRES_PER_UNIT)}"
        )
    return unit


def _up(path: Path, document: dict[str, Any]) -> str | None:
    value = document.get("calibration_up")
    if value is not None and value not in AXES:
        raise _bad_key(path, "calibration_up", f'is {value!r}, expected "z", "-y", ...')
    return value


def _board(path: Path, document: dict[str, Any]) -> tuple[int, int] | None:
    value = document.get("checkerboard")
    if value is None:
        return None
    if not (isinstance(value, list) and len(value) == 2 and all(type(v) is int and v >= 3 for v in value)):
        raise _bad_key(
            path, "checkerboard", f"is {value!r}, expected [columns, rows] of inner corners, each at least 3"
        )
    return value[0], value[1]
