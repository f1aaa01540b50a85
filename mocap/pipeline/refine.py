"""Cameras of a session placed, or put right, by the people in it: what cannot be right is refused with the reason."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mocap.arrays import Array
from mocap.data import CameraRig
from mocap.errors import MocapError, did_you_mean
from mocap.io._files import atomic_text, writing
from mocap.io.calibration import write_calibration
from mocap.io.calibration.anipose import toml_value
from mocap.io.session import Session, open_session, read_session_settings
from mocap.io.session.settings import with_tables
from mocap.pipeline.empty_clips import fits_of
from mocap.pipeline.silhouettes import hulls_of
from mocap.progress import Progress, no_progress
from mocap.volume import choose_grid
from mocap.volume.rig_placement import Placement, PlacementSettings, place_rig
from mocap.volume.rig_refinement import (
    CameraMove,
    Refinement,
    RefinementSettings,
    refine_rig,
    scaled,
    standing_height_m,
)

# Places of people further apart in time say more than neighbours; so many frames are looked at, spread evenly.
N_FRAMES = 300
# Of what may be wrong, so much may be left of any camera: beyond it the motion says too little to call it refined.
_MOST_LEFT = 0.5
# Moves within so many standard deviations (root mean square over the axes) are chance: the calibration was right.
_CHANCE = 2.5
# Tangents of one camera with all others: somebody crossed its picture.
_LEAST_TANGENTS = 60
# Outlines of people fit to a few millimetres; beyond this they are of other people, other times or other lenses.
_MOST_APART_M = 0.03
# Of cameras placed from nothing: searches from most cameras must find the same, of somebody who walked about so far
# (root mean square), with lines of sight that meet (2 to 7 mm on the development sessions) and places that are certain.
_MOST_PLACED_APART_M = 0.015
_LEAST_WALKED_M = 0.5
_MOST_PLACED_STD_M, _MOST_PLACED_STD_DEG = 0.03, 1.0
# A camera that was pushed looks elsewhere by some degrees, and stands elsewhere by some centimetres. Chosen on the
# development sessions of `python -m eval.refine_rig --moved`: 30 cm leave 33 mm in `steps`, 5 cm 15. And a push of
# 20 cm is found all the same where somebody walks all over the room, and told within its deviation.
_PUSHED = replace(PlacementSettings().refinement, shift_m=0.05)
_ROOM_STEP_M = 0.02  # bounds of the room are written to whole steps
# A stated height that the people miss by more is not theirs, or they do not walk upright.
_MOST_SCALE = 0.15


@dataclass(frozen=True, eq=False)
class RefinedSession:
    """refinement : what was found.  rig : its cameras, scaled where a height was stated.  factor : of that scale.
    n_frames : that were looked at.  source : calibration it came from, of which cameras that are placed keep the lenses
    alone.  option : of `mocap calibrate`.  first_frame : of the session from which on it holds."""

    refinement: Refinement
    rig: CameraRig
    factor: float
    n_frames: int
    source: Path
    option: str = "--refine"
    first_frame: int = 0


def refine_session(
    session: Path | str,
    *,
    calibration: Path | str | None = None,
    height_m: float | None = None,
    n_frames: int = N_FRAMES,
    n_threads: int | None = None,
    progress: Progress = no_progress,
) -> RefinedSession:
    """Cameras of a session put right by the people who walk in it; lenses are kept.

    The world stays where it was: as a whole, the places of the cameras neither shift, turn nor grow.  height_m : of the
    tallest person, who walks upright; sets the scale.  n_threads : None = up to 2; the result does not depend on it.
    Raises MocapError for a session that cannot be opened, a camera that sees nobody, a motion that says too little, and
    when nothing is gained.
    """
    opened = open_session(session, calibration=calibration)
    hulls, stride = look_at(opened, n_frames=n_frames, n_threads=n_threads, progress=progress)
    return refine_from(opened, hulls, stride, height_m)


def refine_moved(
    session: Path | str,
    camera: str,
    from_frame: int,
    *,
    n_frames: int = N_FRAMES,
    n_threads: int | None = None,
    progress: Progress = no_progress,
) -> RefinedSession:
    """Where a camera stands that was pushed during the recording, told by people whom the others see too.

    from_frame : from which on it stands still again.  n_threads : None = up to 2; the result does not depend on it.
    The other cameras are held, and lenses are kept.
    Raises MocapError for a session that cannot be opened, a camera or frame that it has not, a camera that sees nobody
    whom others see, and when it cannot be told where it stands, or that it was moved.
    """
    opened = open_session(session, frames=(from_frame, None))
    if camera not in opened.rig.names:
        raise MocapError(
            f"the session has no camera {camera}{did_you_mean(camera, opened.rig.names)}",
            path=opened.root,
            remedy=f"use one of {', '.join(opened.rig.names)}",
        )
    # Its empty clip shows another place than it films now.
    backgrounds = {name: path for name, path in opened.background_sources.items() if name != camera}
    opened = replace(opened, background_sources=backgrounds)
    hulls, stride = look_at(opened, n_frames=n_frames, n_threads=n_threads, progress=progress)
    return moved_from(opened, camera, hulls, stride)


def moved_from(session: Session, camera: str, hulls: list[list[Array]], stride: int) -> RefinedSession:
    """Where a camera stands from the session's first frame on, or why that cannot be told, from what `look_at` saw.

    Raises MocapError as `refine_moved` does.
    """
    settings = replace(_PUSHED, alike=max(1.0, _PUSHED.alike / stride))
    found = refine_rig(session.rig, hulls, settings, moving=(camera,))
    _check_tangents(found, session)
    _check_apart(found, session)
    move = found.moves[camera]
    if _is_unsure(move):
        raise MocapError(
            f"the motion from frame {session.frames.start} on says too little: its place would be uncertain by "
            f"{1000 * move.shift_std_m:.0f} mm, its direction by {move.turn_std_deg:.1f} degrees",
            path=session.root,
            camera=camera,
            remedy="do without it from that frame on, as `mocap run` does by itself",
        )
    if not _is_moved(move):
        raise MocapError(
            f"from frame {session.frames.start} on it stands where its calibration says, as far as the people tell: "
            f"{words(move)}",
            path=session.root,
            camera=camera,
            remedy="keep the calibration",
        )
    return RefinedSession(
        found, found.rig, 1.0, len(hulls[0]), session.calibration_path, "--moved", session.frames.start
    )


def look_at(
    session: Session,
    *,
    n_frames: int = N_FRAMES,
    n_threads: int | None = None,
    progress: Progress = no_progress,
) -> tuple[list[list[Array]], int]:
    """Hulls of the silhouettes per camera and frame, and how many frames lie between two of them."""
    frames = session.stretches[0]  # what is seen later is of cameras that stand elsewhere
    stride = max(1, len(frames) // n_frames)
    n_threads = n_threads or min(2, os.cpu_count() or 1)
    fits = fits_of(session, n_threads)
    return hulls_of(session, frames[::stride], fits, n_threads=n_threads, progress=progress), stride


def refine_from(
    session: Session, hulls: list[list[Array]], stride: int, height_m: float | None
) -> RefinedSession:
    """The refinement, or why there is none, from what `look_at` saw. Raises MocapError as `refine_session` does."""
    settings = RefinementSettings()
    settings = replace(settings, alike=max(1.0, settings.alike / stride))
    found = refine_rig(session.rig, hulls, settings)
    _check(found, session)
    factor = 1.0 if height_m is None else _factor(found, height_m, session)
    return RefinedSession(found, scaled(found.rig, factor), factor, len(hulls[0]), session.calibration_path)


def place_session(
    session: Path | str,
    *,
    height_m: float,
    lenses: Path | str | None = None,
    n_frames: int = N_FRAMES,
    n_threads: int | None = None,
    progress: Progress = no_progress,
) -> RefinedSession:
    """Where the cameras of a session stand and look, from nothing but one person who walks in it.

    height_m : of that person, in shoes.  lenses : calibration whose lenses are used, None = the session's; where its
    cameras stand is not looked at.  The floor becomes z = 0, the origin lies under the middle of the way.
    Raises MocapError for a session that cannot be opened, a camera that sees nobody whole, a motion that says too
    little, and when there is no answer that most searches agree on.
    """
    opened = open_session(session, calibration=lenses)
    hulls, stride = look_at(opened, n_frames=n_frames, n_threads=n_threads, progress=progress)
    return placed_from(opened, hulls, stride, height_m)


def placed_from(session: Session, hulls: list[list[Array]], stride: int, height_m: float) -> RefinedSession:
    """The cameras placed, or why not, from what `look_at` saw. Raises MocapError as `place_session` does."""
    settings = PlacementSettings()
    alike = max(1.0, settings.refinement.alike / stride)
    found = place_rig(
        session.rig, hulls, height_m, replace(settings, refinement=replace(settings.refinement, alike=alike))
    )
    refinement = _check_placed(found, session)
    return RefinedSession(refinement, refinement.rig, 1.0, len(hulls[0]), session.calibration_path, "--place")


def check_new(path: Path) -> None:
    """Raise MocapError when there is something at the path."""
    if path.exists():
        raise MocapError(
            "there is a file already; a calibration is not written over",
            path=path,
            remedy="choose another name with -o, or take the file away",
        )


def write_refined(path: Path, refined: RefinedSession) -> None:
    """Write the new calibration, with what it came from and how well it fits; never over a file that is there."""
    check_new(path)
    found = refined.refinement
    metadata: dict[str, object] = {
        "source": f"mocap calibrate {refined.option}",
        "lenses_from" if refined.option == "--place" else "refined_from": refined.source.name,
        "frames_looked_at": refined.n_frames,
        "apart_after_mm": round(1000 * found.apart_after_m, 2),
    }
    if refined.option == "--refine":
        metadata |= {
            "apart_before_mm": round(1000 * found.apart_before_m, 2),
            "scaled_by": round(refined.factor, 5),
        }
    if refined.option == "--moved":
        metadata["note"] = "; ".join(f"camera {name} was {words(move)}" for name, move in found.moves.items())
    write_calibration(path, refined.rig, metadata=metadata)


def write_moved(path: Path, refined: RefinedSession, session: Path | str) -> Path:
    """Write the calibration after a camera was pushed, and into session.toml from which frame on it holds.

    The room is written too, where session.toml has none: it is not to change with a camera that sees another part.
    Gives session.toml. Raises MocapError for a file that is there, and a frame that has a calibration.
    """
    root, frame = Path(session), refined.first_frame
    place = root / "session.toml"
    settings = read_session_settings(place)
    dated = dict(settings.calibration_from or {})
    if frame in dated:
        raise MocapError(
            f"session.toml has a calibration from frame {frame} on: {dated[frame]}",
            path=place,
            remedy="take that line out, or choose another --from-frame",
        )
    bounds = None
    if settings.room_bounds_m is None:
        grid = choose_grid(open_session(root).rig, _ROOM_STEP_M)
        bounds = [np.round(side, 3).tolist() for side in (grid.origin, grid.upper)]
    write_refined(path, refined)
    inside = path.resolve().is_relative_to(root.resolve())
    dated[frame] = str(path.resolve().relative_to(root.resolve()) if inside else path.resolve())
    lines = ["[calibration_from]  # frame from which on another calibration holds: a camera was pushed"]
    lines += [f"{first} = {toml_value(name)}" for first, name in sorted(dated.items())]
    text = place.read_text(encoding="utf-8") if place.exists() else ""
    if bounds is not None:
        text = f"room_bounds_m = {toml_value(bounds)}  # the room of all calibrations\n{text}"
    atomic_text(place, with_tables(text, {"calibration_from": "\n".join(lines)}))
    read_session_settings(place)
    return place


def words(move: CameraMove) -> str:
    """What became of a camera."""
    return (
        f"turned by {move.turn_deg:.2f} degrees (± {move.turn_std_deg:.2f}), moved by {1000 * move.shift_m:.0f} mm "
        f"(± {1000 * move.shift_std_m:.0f})"
    )


def write_picture(path: Path, refined: RefinedSession, before: CameraRig) -> None:
    """Write a PNG: where the cameras were and are, seen from above, and how far lines of sight were and are apart."""
    from mocap.view.rig_moves import CameraShift, plot_moves

    shifts = [
        CameraShift(
            name,
            before[name].center[:2],
            refined.rig[name].center[:2],
            refined.rig[name].R[2, :2],
            (move.apart_before_m, move.apart_after_m),
        )
        for name, move in refined.refinement.moves.items()
    ]
    with writing(path):
        path.write_bytes(plot_moves(shifts))


def _check_tangents(found: Refinement, session: Session) -> None:
    """Refuse cameras that see too little of what others see."""
    for name, move in found.moves.items():
        if move.n_tangents < _LEAST_TANGENTS:
            raise MocapError(
                f"it shares {move.n_tangents} outlines of people with other cameras, needed are {_LEAST_TANGENTS}",
                path=session.root,
                camera=name,
                remedy="use a take in which somebody walks through its picture, whole from head to foot, or leave the "
                "camera out in session.toml: cameras = [...]",
            )


def _check_apart(found: Refinement, session: Session) -> None:
    """Refuse places at which lines of sight do not meet."""
    worst = max(found.moves, key=lambda name: found.moves[name].apart_after_m)
    if found.moves[worst].apart_after_m > _MOST_APART_M:
        raise MocapError(
            "no places of the cameras explain the outlines: its lines of sight miss those of others by "
            f"{1000 * found.moves[worst].apart_after_m:.0f} mm at best",
            path=session.root,
            camera=worst,
            remedy="run `mocap sync` first; then see whether clips are exchanged, the zoom was changed, or the masks "
            "bad (`mocap segment`). Errors of more than some 5 degrees or 10 cm need a new calibration",
        )


def _check(found: Refinement, session: Session) -> None:
    """Refuse what is no refinement."""
    _check_tangents(found, session)
    _check_apart(found, session)
    unsure = max(found.moves, key=lambda name: found.moves[name].share_left)
    move = found.moves[unsure]
    if move.share_left > _MOST_LEFT:
        raise MocapError(
            f"the motion says too little: its direction would be uncertain by {move.turn_std_deg:.1f} degrees, its "
            f"place by {1000 * move.shift_std_m:.0f} mm",
            path=session.root,
            camera=unsure,
            remedy="use a take in which somebody walks all over the room for five seconds or more, in view of at least "
            "three cameras; gestures on one spot do not do",
        )
    if not found.apart_after_m < found.apart_before_m or not any(map(_is_moved, found.moves.values())):
        raise MocapError(
            "nothing is gained: no camera would be moved by more than chance; lines of sight are "
            f"{1000 * found.apart_before_m:.1f} mm apart as calibrated, {1000 * found.apart_after_m:.1f} mm afterwards",
            path=session.root,
            remedy="keep the calibration: the people in this take agree with it",
        )


def _check_placed(found: Placement | None, session: Session) -> Refinement:
    """Refuse what is no answer."""
    walk = (
        "use a take in which one person alone walks all over the room for five seconds or more, upright and whole in "
        "view of every camera"
    )
    if found is None:
        raise MocapError(
            "no places of the cameras explain the silhouettes of a walking person",
            path=session.root,
            remedy=f"{walk}; see whether the clips are synchronised (`mocap sync` needs places) and the lenses theirs",
        )
    for name, move in found.refinement.moves.items():
        if move.n_tangents < _LEAST_TANGENTS:
            raise MocapError(
                f"it shares {move.n_tangents} outlines of the person with other cameras, needed are {_LEAST_TANGENTS}",
                path=session.root,
                camera=name,
                remedy=f"{walk}, or leave the camera out in session.toml: cameras = [...]",
            )
    moves = found.refinement.moves.values()
    shift, turn = max(m.shift_std_m for m in moves), max(m.turn_std_deg for m in moves)
    apart = found.refinement.apart_after_m
    reasons = (
        (
            2 * found.n_agree <= found.n_begun,
            f"{found.n_agree} of {found.n_begun} searches find these places",
        ),
        (found.walked_m < _LEAST_WALKED_M, f"the person stays within {found.walked_m:.1f} m"),
        (apart > _MOST_PLACED_APART_M, f"lines of sight miss each other by {1000 * apart:.0f} mm at best"),
        (
            any(map(_is_unsure, moves)),
            f"a camera would be uncertain by {1000 * shift:.0f} mm and {turn:.1f} degrees",
        ),
    )
    if why := [words for is_so, words in reasons if is_so]:
        raise MocapError(f"the cameras cannot be placed: {'; '.join(why)}", path=session.root, remedy=walk)
    return found.refinement


def _is_unsure(move: CameraMove) -> bool:
    """Whether it cannot be said where a camera stands that might stand anywhere."""
    return move.shift_std_m > _MOST_PLACED_STD_M or move.turn_std_deg > _MOST_PLACED_STD_DEG


def _is_moved(move: CameraMove) -> bool:
    """Whether a camera was moved by more than what is left uncertain of it."""
    limit = _CHANCE * np.sqrt(3)
    return bool(move.turn_deg > limit * move.turn_std_deg or move.shift_m > limit * move.shift_std_m)


def _factor(found: Refinement, height_m: float, session: Session) -> float:
    """By how much the rig has to grow so that the tallest person is as tall as stated."""
    measured = standing_height_m(found.points, found.frames)
    factor = height_m / measured
    if not abs(factor - 1) < _MOST_SCALE:
        raise MocapError(
            f"the people are {measured:.2f} m tall by this calibration, stated are {height_m:.2f} m",
            path=session.root,
            remedy="state the height of the tallest person in metres; he must walk upright, hands below the head. If "
            "the calibration is in another unit, say so in session.toml: calibration_units",
        )
    return factor
