"""Opening a session: a list of rules, each of which finds something out, says what it found, or refuses.

`open_session` walks OPENING; `mocap check` goes on with CHECKING on the session that came out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mocap.data import CameraRig
from mocap.errors import MocapError, did_you_mean
from mocap.io.calibration import CalibrationFile, find_calibration, read_calibration
from mocap.io.session import check, check_depth
from mocap.io.session.frames import (
    SLOWEST_FPS,
    check_clip_size,
    check_durations,
    choose_fps,
    choose_frames,
    frame_counts,
    frames_of_timeline,
    rig_with_true_sizes,
)
from mocap.io.session.record import Finding, Session, stands_alike
from mocap.io.session.settings import SessionSettings, bad_key, read_session_settings
from mocap.io.session.sources import (
    Sources,
    cameras_with_sources,
    images_and_masks,
    match_sources,
    wanted_cameras,
)
from mocap.io.session.timeline import TIMESTAMPS_FILE, clip_times, differing_rates, timeline
from mocap.io.video import ClipInfo, Size, clip_info

Frames = tuple[int | None, int | None]
Value = TypeVar("Value")


@dataclass
class Opening:
    """A session folder while it is opened: the question, and what the rules have found out so far."""

    root: Path
    wanted_calibration: Path | None = None
    wanted_frames: Frames | None = None
    unplaced: tuple[str, ...] = ()
    settings: SessionSettings = field(init=False)
    calibration: CalibrationFile = field(init=False)
    # Calibrations of later frames, and cameras that were pushed before the first.
    later: dict[int, CalibrationFile] = field(default_factory=dict)
    pushed: frozenset[str] = frozenset()
    sources: Sources = field(init=False)
    rig: CameraRig = field(init=False)
    images: dict[str, Path] = field(init=False)
    masks: dict[str, Path] = field(init=False)
    # By camera what was counted of its pictures (else masks), and all that was counted, also beside the pictures.
    clips: dict[str, ClipInfo] = field(init=False)
    counted: dict[str, ClipInfo] = field(init=False)
    frames: range = field(init=False)
    clip_frames: dict[str, NDArray[np.int64]] = field(default_factory=dict)
    fps: float = field(init=False)


def _folder(o: Opening) -> list[Finding]:
    """The folder is there."""
    if not o.root.is_dir():
        near = did_you_mean(o.root.name, _folders_beside(o.root))
        raise MocapError(
            f"no such session folder{near}", path=o.root, remedy="check the path, or make one: mocap synth"
        )
    return []


def _folders_beside(path: Path) -> list[str]:
    """Names of the folders where one was looked for; none where that cannot be listed."""
    try:
        return sorted(entry.name for entry in path.parent.iterdir() if entry.is_dir())
    except OSError:
        return []


def _settings(o: Opening) -> list[Finding]:
    """session.toml says only what is known."""
    o.settings = read_session_settings(o.root / "session.toml")
    return []


def _calibration(o: Opening) -> list[Finding]:
    """There is one calibration, and it can be."""
    dated = {} if o.wanted_calibration is not None else o.settings.calibration_from or {}
    begin = (o.wanted_frames or o.settings.frames or (None, None))[0] or 0
    path = o.wanted_calibration if o.wanted_calibration is not None else find_calibration(o.root)
    first = read_calibration(path, units=o.settings.calibration_units, up=o.settings.calibration_up)
    # Later ones were written for this session, and say themselves what they are in.
    later = {frame: read_calibration(o.root / name) for frame, name in dated.items()}
    o.calibration = next((found for frame, found in reversed(later.items()) if frame <= begin), first)
    o.later = {frame: found for frame, found in later.items() if frame > begin}
    for frame, found in later.items():
        if lacking := [name for name in first.rig.names if name not in found.rig.names]:
            raise bad_key(
                o.root / "session.toml", f"calibration_from.{frame}", f"lacks camera {', '.join(lacking)}"
            )
    o.pushed = frozenset(c.name for c in first.rig if not stands_alike(c, o.calibration.rig[c.name]))
    return [Finding("warning", text) for text in o.calibration.warnings]


def _later_calibrations(o: Opening) -> list[Finding]:
    """What holds from a later frame of the session on is said."""
    o.later = {frame: found for frame, found in o.later.items() if o.frames.start < frame < o.frames.stop}
    said = []
    for frame, found in o.later.items():
        notes = f": {'; '.join(found.notes)}" if found.notes else ""
        said.append(
            Finding("warning", f"from frame {frame} on the cameras stand as in {found.path.name}{notes}")
        )
    return said


def _sources(o: Opening) -> list[Finding]:
    """Every file belongs to a calibrated camera."""
    o.sources, warnings = match_sources(o.root, o.settings, o.calibration.rig, o.calibration.path)
    # The empty clip of a camera that was pushed shows where it stood before.
    background = {name: path for name, path in o.sources.background.items() if name not in o.pushed}
    o.sources = replace(o.sources, background=background)
    names = o.calibration.rig.names
    if strangers := [n for n in o.settings.roi_px or {} if n not in names]:
        raise bad_key(
            o.root / "session.toml", f"roi_px.{strangers[0]}", "names a camera that is not calibrated"
        )
    return [Finding("warning", text) for text in warnings]


def _cameras(o: Opening) -> list[Finding]:
    """Every camera that is wanted has pictures or masks."""
    wanted = wanted_cameras(o.root, o.calibration.rig, o.settings.cameras)
    o.rig = cameras_with_sources(o.root, wanted, o.sources)
    o.images, o.masks, warnings = images_and_masks(o.root, o.rig, o.sources)
    return [Finding("warning", text) for text in warnings]


def _additions(o: Opening) -> list[Finding]:
    """Backgrounds, detections and keypoints are there for all cameras or for none."""
    found = []
    kinds = {
        "background": o.sources.background,
        "detections": o.sources.detections,
        "keypoints": o.sources.keypoints,
    }
    for word, sources in kinds.items():
        lacking = [n for n in o.rig.names if n not in sources]
        if 0 < len(lacking) < len(o.rig):
            found.append(Finding("warning", f"no {word}/ for camera {', '.join(lacking)}"))
    return found


def _sizes(o: Opening) -> list[Finding]:
    """Pictures are as large as the calibration says."""
    sizes = {c.name: c.size for c in o.rig if c.name not in o.calibration.guessed_sizes}
    o.clips = {n: clip_info(p, camera=n, size=sizes.get(n)) for n, p in (o.images or o.masks).items()}
    o.rig = rig_with_true_sizes(o.rig, o.calibration, o.clips)
    o.later = {f: replace(c, rig=rig_with_true_sizes(c.rig, c, o.clips)) for f, c in o.later.items()}
    for name, clip in o.clips.items():
        check_clip_size(clip, o.rig[name])
    for name in o.rig.names:
        if name in o.sources.background:
            check_clip_size(
                clip_info(o.sources.background[name], camera=name, size=o.rig[name].size), o.rig[name]
            )
    o.counted = dict(o.clips)
    if o.images:
        for name, path in o.masks.items():
            clip = clip_info(path, camera=name, size=o.rig[name].size)
            check_clip_size(clip, o.rig[name])
            o.counted[f"{name} (masks)"] = clip
    for name, folder in _of(o.rig, o.sources.depth).items():
        size = o.settings.depth.size_of(o.rig[name].size)
        o.counted[f"{name} (depth)"] = check_depth.depth_info(folder, name, size)
    padded = [c for c in o.rig if c.size != sizes.get(c.name, c.size)]
    return [Finding("warning", _padding(c.name, sizes[c.name], c.size)) for c in padded]


def _padding(camera: str, stated: Size, found: Size) -> str:
    return (
        f"camera {camera}: the pictures are {found[0]} x {found[1]}, the calibration is of {stated[0]} x {stated[1]}, "
        "to which codecs pad them: they are taken for its upper left part. Remedy: if `mocap check` finds lines of "
        "sight apart, calibrate with pictures of the same size"
    )


def _frame_rate(o: Opening) -> list[Finding]:
    """One frame rate holds for the session."""
    o.fps, warnings = choose_fps(o.settings.fps, o.clips)
    if o.fps < SLOWEST_FPS and any(clip.n_frames > 1 for clip in o.clips.values()):
        warnings.append(
            f"pictures are {1 / o.fps:.2g} s apart: of several people it is not sure who is who from one to the next. "
            "Remedy: film ten a second or more, or run instants by themselves (--frames 3:4)"
        )
    return [Finding("warning", text) for text in warnings]


def _frames(o: Opening) -> list[Finding]:
    """All clips have the frames that are wanted, each at its time."""
    wanted = o.wanted_frames if o.wanted_frames is not None else o.settings.frames
    found = {**_of(o.rig, o.sources.detections), **_of(o.rig, o.sources.keypoints)}
    counts = frame_counts(o.clips, found)
    times = clip_times(o.root, o.settings, counts, differing_rates(o.settings, o.clips), o.fps)
    if times is None:
        o.frames = choose_frames(o.root, o.counted, found, wanted)
        return []
    if o.settings.offset_s is None and not (o.root / TIMESTAMPS_FILE).exists():
        check_durations(o.root, o.clips, times)
    clocks = timeline(o.root, times, o.fps)
    o.frames = frames_of_timeline(o.root, clocks, wanted)
    o.clip_frames = {name: places[: o.frames.stop] for name, places in clocks.clip_frames.items()}
    return []


def _depth(o: Opening) -> list[Finding]:
    """The numbers of depth maps have the unit that is said."""
    for name, folder in _of(o.rig, o.sources.depth).items():
        if name in o.unplaced:
            continue
        places = o.clip_frames.get(name)
        first = o.frames.start if places is None else int(places[o.frames.start])
        check_depth.check_unit(folder, o.rig[name], o.settings.depth, first)
    return []


OPENING: tuple[Callable[[Opening], list[Finding]], ...] = (
    _folder,
    _settings,
    _calibration,
    _sources,
    _cameras,
    _additions,
    _sizes,
    _frame_rate,
    _frames,
    _later_calibrations,
    _depth,
)
CHECKING: tuple[Callable[[Session], list[Finding]], ...] = (
    check.calibration,
    check.warnings,
    check.geometry,
    check.clips,
    check.every_picture,
    check.keypoints,
    check_depth.depth,
    check.background,
    check.calibration_quality,
)


def open_session(
    root: Path | str,
    *,
    calibration: Path | str | None = None,
    frames: Frames | None = None,
    unplaced: Sequence[str] = (),
) -> Session:
    """Open a session folder and check that its parts belong together.

    calibration : file to use instead of the session's own.  frames : (start, stop), stop excluded, None = from
    the first / to the last common frame; overrides session.toml.  unplaced : cameras of which nobody says that
    the calibration has their place: the unit of their depth is not checked on the floor.
    Raises MocapError with camera, file and remedy for no or bad calibration, no pictures and no masks, a source
    without calibration, a calibrated camera without source (unless session.toml names the `cameras` to use),
    fewer than two cameras, sizes differing from the calibration, clips of different length, unreadable,
    truncated or empty clips, a frame range outside the clips.
    """
    o = Opening(Path(root), None if calibration is None else Path(calibration), frames, tuple(unplaced))
    findings = [finding for rule in OPENING for finding in rule(o)]
    truth = o.root / "truth"
    return Session(
        root=o.root,
        name=o.root.resolve().name,
        rig=o.rig,
        fps=o.fps,
        frames=o.frames,
        image_sources=o.images,
        background_sources=_of(o.rig, o.sources.background),
        mask_sources=o.masks,
        detection_sources=_of(o.rig, o.sources.detections),
        room_bounds_m=o.settings.room_bounds_m,
        person_height_m=o.settings.person_height_m,
        warnings=tuple(f.message for f in findings),
        truth_dir=truth if truth.is_dir() else None,
        calibration_path=o.calibration.path,
        calibration=o.calibration,
        clips=o.clips,
        notes=o.calibration.notes,
        marker_colour=o.settings.marker_colour,
        checkerboard=o.settings.checkerboard,
        checkerboard_square_m=o.settings.checkerboard_square_m,
        keypoint_sources=_of(o.rig, o.sources.keypoints),
        depth_sources=_of(o.rig, o.sources.depth),
        depth=o.settings.depth,
        roi_sources=_of(o.rig, o.sources.roi),
        roi_px=_of(o.rig, o.settings.roi_px or {}),
        clip_frames=o.clip_frames,
        later_calibrations=o.later,
    )


@dataclass(frozen=True, eq=False)
class OpenedClips:
    """A session folder before anything is said of its clocks: clips may differ in length and rate.

    clips : camera -> what was counted of its pictures (else masks).  fps : of the session.
    """

    root: Path
    rig: CameraRig
    settings: SessionSettings
    clips: dict[str, ClipInfo]
    images: dict[str, Path]
    masks: dict[str, Path]
    background: dict[str, Path]
    fps: float


def open_clips(root: Path | str, *, calibration: Path | str | None = None) -> OpenedClips:
    """Open a session folder up to the question which of its pictures belong together.

    Raises MocapError as `open_session` does, but for what concerns frames.
    """
    o = Opening(Path(root), None if calibration is None else Path(calibration))
    for rule in OPENING[: OPENING.index(_frames)]:
        rule(o)
    background = _of(o.rig, o.sources.background)
    return OpenedClips(o.root, o.rig, o.settings, o.clips, o.images, o.masks, background, o.fps)


def check_session(session: Session) -> list[Finding]:
    """What `mocap check` prints: cameras, common view, clips, background, masks, quality of the calibration."""
    return [finding for rule in CHECKING for finding in rule(session)]


def _of(rig: CameraRig, values: Mapping[str, Value]) -> dict[str, Value]:
    """The values of the cameras of a rig."""
    return {n: value for n, value in values.items() if n in rig.names}
