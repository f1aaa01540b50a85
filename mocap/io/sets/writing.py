"""A recording of a public set as a session: cameras and truth in one world and on one clock, and what is doubtful."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.data import ALL_LANDMARKS, LANDMARKS, Camera, CameraRig, Motion
from mocap.data.motion import at_times
from mocap.errors import MocapError
from mocap.io.calibration import write_calibration
from mocap.io.calibration.frame import in_our_frame
from mocap.io.poses import SideMap, read_motions
from mocap.io.session.frames import check_clip_size
from mocap.io.session.layout import Layout, Placed, check_is_new, write_layout
from mocap.io.sets.recording import Clock, Recording
from mocap.io.tables import write_landmarks_csv
from mocap.io.units import Z_UP_FROM
from mocap.io.video import ClipInfo, clip_info

# Cameras that see less of the persons than this have another world than the truth, or look elsewhere.
_LEAST_SEEN = 0.5
# Ankle joints of somebody who stands lie 7 to 10 cm above the floor; calibrated floors are off by some.
_ANKLES_M = (-0.1, 0.35)
_N_LOOKED_AT = 200  # frames, spread over the recording: its doubts show in all of them


@dataclass(frozen=True, eq=False)
class Imported:
    """A recording in our world.

    clips, empty : by camera, in the order of the rig.  fps : frames of the session per second.  offset_s, clip_fps : of
    session.toml, for cameras that need them.  notes : conversions and definitions.  warnings : doubts.
    """

    rig: CameraRig
    clips: Mapping[str, ClipInfo]
    empty: Mapping[str, Path]
    truth: tuple[Motion, ...]
    fps: float
    offset_s: Mapping[str, float]
    clip_fps: Mapping[str, float]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def landmarks(self) -> tuple[str, ...]:
        """Landmarks that the truth knows of anybody."""
        known = np.zeros(len(ALL_LANDMARKS), dtype=np.bool_)
        for motion in self.truth:
            known[: motion.landmarks.shape[1]] |= np.isfinite(motion.landmarks).all(axis=2).any(axis=0)
        return tuple(name for name, is_known in zip(ALL_LANDMARKS, known, strict=True) if is_known)


def imported(recording: Recording, side: SideMap | None = None) -> Imported:
    """Cameras with a clip and the truth, in metres, z up, on the session's clock.

    side : what the user says of the truth; it counts more than what the set says.
    Raises MocapError for fewer than two cameras with a clip, a picture of another size than its camera, and a truth
    without landmarks or without frames that the clips show.
    """
    rig = recording.rig
    own = tuple(c for c in rig.cameras if c.name in recording.clips)
    if len(own) < 2:
        have, known = (
            ", ".join(names) or "none" for names in (recording.clips, [c.name for c in rig.cameras])
        )
        raise MocapError(
            f"fewer than two cameras have a clip: clips of {have}, calibrated are {known}",
            path=recording.rig_path,
            remedy="unpack the videos of the recording; see docs/public-sets.md for where they must lie",
        )
    clips = {c.name: clip_info(recording.clips[c.name], camera=c.name, size=c.size) for c in own}
    sized = replace(rig, cameras=tuple(replace(c, size=c.size or clips[c.name].size) for c in own))
    side = SideMap() if side is None else side
    # One axis for cameras and truth: they are turned together or not at all.
    up = side.up or rig.up or "z"
    found = in_our_frame(sized, recording.rig_path, None, up, True)
    for name, clip in clips.items():
        check_clip_size(clip, found.rig[name])
    motions, notes = _motions(recording, side, Z_UP_FROM[up])
    fps = _rate(recording, clips, side.fps)
    clocked = _on_session_clock(motions, recording.clock, fps, recording.truth.fps)
    if not any(len(motion) for motion in clocked):
        raise MocapError(
            "no frame of the truth is shown by the clips",
            path=recording.truth.path,
            remedy="unpack the set again",
        )
    offsets, rates = _clocks(recording.clock, fps)
    names = found.rig.names
    return Imported(
        rig=found.rig,
        clips=clips,
        empty={name: recording.empty[name] for name in names if name in recording.empty},
        truth=tuple(clocked),
        fps=fps,
        offset_s={name: offsets[name] for name in names if offsets.get(name)},
        clip_fps={name: rates[name] for name in names if name in rates},
        notes=(*found.notes, *notes, *recording.notes),
        warnings=(*found.warnings, *doubts(found.rig, clocked)),
    )


def _motions(
    recording: Recording, side: SideMap, turn: NDArray[np.float64]
) -> tuple[list[Motion], tuple[str, ...]]:
    """The truth in metres, turned (3, 3) as its cameras are, and how its points were understood."""
    truth = replace(recording.truth, world_from_file=turn)
    side = replace(side, landmarks=side.landmarks or recording.landmarks, up=None)
    reading = read_motions(truth, side)
    unit = reading.unit
    if unit is None:
        raise MocapError(
            "the truth does not say its unit",
            path=truth.path,
            remedy='say it with --map: [truth] unit = "mm"',
        )
    if not reading.motions:
        raise MocapError("the truth holds nobody", path=truth.path, remedy="unpack the set again")
    lacking = [name for name in LANDMARKS if name not in reading.landmarks]
    notes = [f"the truth has no {', '.join(lacking)}"] if lacking else []
    return list(reading.in_metres(unit).motions), (*reading.notes, *notes)


def _rate(recording: Recording, clips: Mapping[str, ClipInfo], fps_of_user: float | None) -> float:
    """Frames of the session per second: what the user says, the set, or the headers of the clips."""
    said_for_all = fps_of_user or recording.fps
    if said_for_all is not None:
        return said_for_all
    said = list(recording.clock.fps.values()) if recording.clock is not None else []
    rates = said or [clip.fps for clip in clips.values() if clip.fps]
    if not rates:
        raise MocapError(
            "neither the set nor the clips have a frame rate",
            path=recording.rig_path,
            remedy="say it with --map: [truth] fps = 50.0",
        )
    return float(np.median(rates))


def _clocks(clock: Clock | None, fps: float) -> tuple[dict[str, float], dict[str, float]]:
    """Seconds by which each clip begins after the first one, and rates of clips that do not run at `fps`."""
    if clock is None:
        return {}, {}
    zero = min(clock.begins_s.values())
    rates = {name: rate for name, rate in clock.fps.items() if abs(rate - fps) > 1e-6 * fps}
    return {name: begin - zero for name, begin in clock.begins_s.items()}, rates


def _on_session_clock(
    motions: Sequence[Motion], clock: Clock | None, fps: float, rate: float | None
) -> list[Motion]:
    """The truth at the frames of the session."""
    if clock is None:
        return [replace(m, time_s=m.frames / fps) for m in motions]
    assert rate is not None  # a clock counts its rows
    zero = min(clock.begins_s.values())
    last = max(float(m.time_s[-1]) for m in motions)
    frames = np.arange(max(0, int(np.floor((last - zero) * fps)) + 1), dtype=np.int64)
    shifted = [replace(m, time_s=m.time_s - zero) for m in motions]
    return [at_times(m, frames, frames / fps, rate) for m in shifted]


def doubts(rig: CameraRig, truth: Sequence[Motion]) -> list[str]:
    """What is wrong with a truth among cameras, as far as geometry tells: its up axis, its floor, its world."""
    parts = [m.landmarks[:, : len(LANDMARKS)][:: max(1, len(m) // _N_LOOKED_AT)] for m in truth]
    points = np.concatenate(parts)
    height = {name: points[:, LANDMARKS.index(name), 2] for name in LANDMARKS}
    ankles = np.concatenate([height["left_ankle"], height["right_ankle"]])
    upper = np.concatenate([height["left_shoulder"], height["right_shoulder"]])
    found = []
    if _median(upper) < _median(ankles):
        found.append("shoulders lie below the ankles most of the time: is the up axis right?")
    elif np.isfinite(ankles).any() and not _ANKLES_M[0] < np.nanpercentile(ankles, 10) < _ANKLES_M[1]:
        low = np.nanpercentile(ankles, 10)
        found.append(f"ankles come down to z = {low:.2f} m: the floor is not z = 0, or nobody stands on it")
    known = points[np.isfinite(points).all(axis=2)]
    blind = [camera.name for camera in rig if _share_seen(camera, known) < _LEAST_SEEN]
    if 2 * len(blind) > len(rig):
        found.append(
            f"most of the truth lies outside the pictures of {', '.join(blind)}: calibration and truth are not of one "
            "recording, or the persons are hardly ever in view"
        )
    return found


def _median(values: NDArray[np.float64]) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")


def _share_seen(camera: Camera, points: NDArray[np.float64]) -> float:
    """Share of points (N, 3) m, world, that fall into the camera's picture; 1 without any."""
    return float(camera.contains(camera.project(points)[0]).mean()) if len(points) else 1.0


def write_session(found: Imported, root: Path, title: str, *, copies: bool = False) -> None:
    """Make the session: links to the clips (copies : copies), calibration.toml, session.toml, truth/landmarks.csv.

    Raises MocapError for a folder that is not empty, and where it cannot be written.
    """
    check_is_new(root)
    placed = [_placed(root, "recording", name, clip.path) for name, clip in found.clips.items()]
    placed += [_placed(root, "background", name, path) for name, path in found.empty.items()]
    layout = Layout(root, tuple(placed), None, _text(found, title), ())
    write_layout(layout, copies=copies)
    write_calibration(root / "calibration.toml", found.rig, metadata={"source_format": title})
    write_landmarks_csv(root / "truth" / "landmarks.csv", found.truth, with_unknown=False)


def _placed(root: Path, role: str, name: str, source: Path) -> Placed:
    folder = "background" if role == "background" else "images" if source.is_dir() else "videos"
    ending = "" if source.is_dir() else source.suffix.lower()
    return Placed(name, role, source, root / folder / f"{name}{ending}")


def _text(found: Imported, title: str) -> str:
    """session.toml, with what is to be known of the truth as comments."""
    lines = [f"# Written by `mocap import`: {title}.", f"# The truth knows {', '.join(found.landmarks)}."]
    lines += [f"# {text}" for text in (*found.notes, *found.warnings)]
    lines += ["", f"fps = {found.fps!r}"]
    for table, values in (("offset_s", found.offset_s), ("clip_fps", found.clip_fps)):
        if values:
            lines += ["", f"[{table}]", *(f'"{name}" = {value!r}' for name, value in values.items())]
    return "\n".join(lines) + "\n"
