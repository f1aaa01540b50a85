"""The files of a run: tables and poses, and exports for other tools."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mocap.body import body_skin, skeleton_of
from mocap.data.motion import ALL_LANDMARKS
from mocap.errors import MissingExtra, MocapError
from mocap.io._files import atomic_text, writing
from mocap.io.angle_table import write_angles_csv
from mocap.io.formats import (
    BoneNames,
    Event,
    MarkerNames,
    marker_names,
    renamed,
    write_bvh,
    write_c3d,
    write_glb,
    write_mot,
    write_trc,
    write_usd,
)
from mocap.io.formats.opensim import write_ik_setup, write_marker_set, write_osim, write_scale_setup
from mocap.io.tables import write_landmarks_csv, write_tracks_csv
from mocap.pipeline.config import OutputConfig
from mocap.pipeline.record import Found
from mocap.pipeline.scene_frames import write_scene
from mocap.pipeline.tracking import every_frame
from mocap.pose.contacts import SOLE_POINTS
from mocap.pose.cycles import PERCENT
from mocap.pose.kinematics import Kinematics
from mocap.pose.opensim import opensim_bodies
from mocap.pose.result import PersonPoses
from mocap.products.poses import body_files
from mocap.progress import Progress
from mocap.view.scene import CodedPictures

CONTACT_COLUMNS = ("frame", "time_s", "person", "point", "probability", "observed")
STEP_COLUMNS = (
    *("person", "foot", "strike_frame", "strike_std_frames", "off_frame", "off_std_frames", "x_m", "y_m"),
    *("length_m", "width_m", "time_s", "stance_s", "swing_s", "speed_m_s", "observed"),
)
CYCLE_COLUMNS = (
    *(
        "person",
        "foot",
        "cycles",
        "off_percent",
        "angle",
        "percent",
        "mean_deg",
        "std_deg",
        "measured_std_deg",
        "observed_percent",
    ),
)
MOVE_COLUMNS = (
    *("person", "move", "begin_frame", "extreme_frame", "end_frame", "height_m"),
    *("flight_s", "flight_height_m", "knee_flexion_deg"),
)


@dataclass(frozen=True)
class MotionStyle:
    """How motion is written: names of bones and markers, whether gaps of a TRC are filled, the task in BIDS
    (None: the name of the session)."""

    bone_names: BoneNames = "mocap"
    marker_names: MarkerNames = "mocap"
    is_filled: bool = False
    task: str | None = None


def write_tables(found: Found, folder: Path, *, has_poses: bool) -> None:
    """Write into `folder` the tables of what was found, empty where nobody was, and the persons' body files.

    has_poses : the run came as far as the poses.
    """
    if found.tracks is not None:
        write_tracks_csv(folder / "tracks.csv", found.tracks)
    if not has_poses:
        return
    write_landmarks_csv(folder / "landmarks.csv", found.motions)
    write_angles_csv(folder / "angles.csv", [person.angles for person in found.people])
    write_contacts_csv(folder / "contacts.csv", found.people)
    write_steps_csv(folder / "steps.csv", found.people)
    write_cycles_csv(folder / "cycles.csv", found.people)
    write_moves_csv(folder / "moves.csv", found.people)
    write_pose_npz(folder / "pose.npz", found.poses)
    for name, text in body_files(found.store, found.poses).items():
        atomic_text(folder / name, text)


def write_contacts_csv(path: Path, people: Sequence[Kinematics]) -> None:
    """How probable it is that a heel or toe rests on the floor, one row per person, frame and point; none of a person
    whose contacts are not told."""
    lines = [",".join(CONTACT_COLUMNS)]
    for person in people:
        contacts, poses = person.gait.contacts, person.poses
        if contacts is None:
            continue
        names = [ALL_LANDMARKS[k] for k in SOLE_POINTS]
        seen = poses.observed[:, list(SOLE_POINTS)].astype(int).tolist()
        for frame, of_frame, observed in zip(
            poses.frames.tolist(), contacts.probability.tolist(), seen, strict=True
        ):
            begin = f"{frame},{frame / person.fps:.6f},{poses.person}"
            rows = zip(names, of_frame, observed, strict=True)
            lines += [f"{begin},{name},{value:.4f},{own}" for name, value, own in rows]
    atomic_text(path, "\n".join(lines) + "\n")


def write_steps_csv(path: Path, people: Sequence[Kinematics]) -> None:
    """One row per stance, by person and time, with the step that it ends where there is one; unknown = empty."""
    lines = [",".join(STEP_COLUMNS)]
    for person in people:
        gait = person.gait
        steps = {step.stance: step for step in gait.steps}
        for stance in gait.stances:
            step = steps.get(stance)
            numbers = (
                None if stance.strike is None else person.frame_of(stance.strike),
                stance.strike_std,
                None if stance.off is None else person.frame_of(stance.off),
                stance.off_std,
                *stance.place,
                *(getattr(step, name, None) for name in STEP_COLUMNS[8:-1]),
                int(stance.is_observed),
            )
            cells = ["" if v is None else str(v) if isinstance(v, int) else f"{v:.4f}" for v in numbers]
            lines.append(",".join([str(gait.person), stance.side, *cells]))
    atomic_text(path, "\n".join(lines) + "\n")


def write_cycles_csv(path: Path, people: Sequence[Kinematics]) -> None:
    """The mean of every angle over the gait cycle, one row per person, foot, angle and percent; unknown = empty."""
    lines = [",".join(CYCLE_COLUMNS)]
    for person in people:
        for cycles in person.cycles:
            for name, seen in zip(cycles.names, cycles.observed.tolist(), strict=True):
                begin = f"{person.poses.person},{cycles.side},{len(cycles)},{cycles.off_percent.mean():.1f},{name}"
                columns = np.rad2deg(np.stack(cycles.mean(name), axis=1))
                for percent, numbers in zip(PERCENT.tolist(), columns.tolist(), strict=True):
                    cells = ["" if math.isnan(v) else f"{v:.2f}" for v in numbers]
                    lines.append(",".join([begin, f"{percent:.0f}", *cells, f"{100 * seen:.0f}"]))
    atomic_text(path, "\n".join(lines) + "\n")


def write_moves_csv(path: Path, people: Sequence[Kinematics]) -> None:
    """One row per jump and squat, by person and time; what a move does not have is empty."""
    lines = [",".join(MOVE_COLUMNS)]
    for person in people:
        for move in person.moves:
            begin, extreme, last = (person.frame_of(row) for row in (move.begin, move.extreme, move.end - 1))
            frames = [str(begin), str(extreme), str(last + 1)]
            knee = None if move.knee_flexion_rad is None else np.rad2deg(move.knee_flexion_rad)
            numbers = (move.height_m, move.flight_s, move.flight_height_m, knee)
            cells = ["" if v is None else f"{v:.4f}" for v in numbers]
            lines.append(",".join([str(person.poses.person), move.kind, *frames, *cells]))
    atomic_text(path, "\n".join(lines) + "\n")


def write_exports(
    found: Found,
    output: OutputConfig,
    folder: Path,
    *,
    pictures: Callable[[], Iterable[CodedPictures]],
    progress: Progress,
) -> list[str]:
    """Write into `folder` the exports of every person and the scene; gives what was left out, and why.

    pictures : gives those of the scene, which comes last.
    """
    style = MotionStyle(output.bone_names, output.marker_names, output.trc_gaps == "filled")
    steps: list[tuple[Path, Callable[[Path], None]]] = []
    for person in found.people:
        steps += [
            (folder / f"person_{person.poses.person}.{name}", write)
            for name, write in motion_writers(person, style).items()
            if name in output.formats
        ]
    if "rrd" in output.formats:
        steps.append((folder / "scene.rrd", partial(write_scene, found, pictures=pictures)))
    left_out = []
    for i, (path, write) in enumerate(steps):
        left_out += written_or_why(path, write)
        progress("report", i, len(steps))
    progress("report", len(steps), len(steps))
    return left_out


def motion_writers(person: Kinematics, style: MotionStyle) -> dict[str, Callable[[Path], None]]:
    """What writes one person into a file, by the file's suffix."""
    poses, motion, fps = person.poses, person.motion, person.fps
    skeleton = renamed(
        skeleton_of(poses.body, every_frame(poses.frames, poses.states), poses.person), style.bone_names
    )
    return {
        "bvh": partial(write_bvh, skeleton=skeleton, fps=fps),
        "glb": lambda path: write_glb(path, skeleton, fps, body_skin(poses.body)),
        "usd": lambda path: write_usd(path, skeleton, fps, body_skin(poses.body)),
        "trc": partial(
            write_trc, motion=motion, fps=fps, markers=style.marker_names, is_filled=style.is_filled
        ),
        "c3d": lambda path: write_c3d(path, motion, fps, foot_events(person)),
        "mot": lambda path: write_mot(path, motion.time_s, person.coordinates, person.unseen),
        "osim": lambda path: write_opensim(path, person, style),
    }


def foot_events(person: Kinematics) -> list[Event]:
    """Strikes and offs of both feet by time, as gait laboratories call them; none of a body without feet."""
    found = [
        Event(label, stance.side.title(), person.frame_of(row) / person.fps)
        for stance in person.gait.stances
        for label, row in (("Foot Strike", stance.strike), ("Foot Off", stance.off))
        if row is not None
    ]
    return sorted(found, key=lambda event: event.time_s)


# Coordinates that no marker shows, or none without this landmark, which not every set of names has: inverse kinematics
# draws them to ours, so weakly that markers outweigh it.
_HELD_WEIGHT = 0.01
_HELD = {
    "": ("lumbar_extension", "lumbar_bending", "lumbar_rotation"),
    "head": ("neck_extension", "neck_bending", "neck_rotation"),
    **{
        f"{side}_hand_tip": tuple(f"{name}_{side[0]}" for name in ("pro_sup", "wrist_flex", "wrist_dev"))
        for side in ("left", "right")
    },
}


def write_opensim(path: Path, person: Kinematics, style: MotionStyle) -> None:
    """A person for OpenSim: the scaled model `path`, and beside it markers without gaps, coordinates, a marker set and
    the set-up files of inverse kinematics and scaling, the path's stem with `_ik`, `_markers` and `_scale`."""
    poses, motion, fps = person.poses, person.motion, person.fps
    if not len(motion):
        raise MocapError(f"person {motion.person} has no frames", remedy="export another person", path=path)
    names = marker_names(motion.names, style.marker_names)
    bodies, stem = opensim_bodies(poses.body, names), path.stem
    if not bodies:
        raise MocapError(
            "the body has no joints that OpenSim's models have",
            remedy="name the joints of the body file as those of the bodies that come with this package",
            path=path,
        )
    beside = {
        word: path.with_name(f"{stem}_{word}") for word in ("ik.trc", "ik.mot", "ik.xml", "markers.xml")
    }
    write_osim(path, bodies)
    write_marker_set(beside["markers.xml"], bodies)
    write_trc(beside["ik.trc"], motion, fps, markers=style.marker_names, is_filled=True)
    write_mot(beside["ik.mot"], motion.time_s, person.coordinates, person.unseen)
    write_ik_setup(
        beside["ik.xml"],
        model=path.name,
        trc=beside["ik.trc"].name,
        coordinates=beside["ik.mot"].name,
        motion=f"{stem}_ik_result.mot",
        markers=list(names.values()),
        held={
            coordinate: _HELD_WEIGHT
            for landmark, coordinates in _HELD.items()
            for coordinate in coordinates
            if landmark not in names and coordinate in person.coordinates
        },
        time_s=motion.time_s,
    )
    write_scale_setup(
        path.with_name(f"{stem}_scale.xml"),
        markers=beside["markers.xml"].name,
        trc=beside["ik.trc"].name,
        scaled=f"{stem}_scaled.osim",
        names=names,
        height_m=poses.body.height_m,
        time_s=motion.time_s,
    )


def written_or_why(path: Path, write: Callable[[Path], None]) -> list[str]:
    """Write one file; a warning instead when that fails, for no file is worth the others."""
    try:
        write(path)
    except MissingExtra as error:
        return [f"{path.suffix[1:]} was left out: {error}"]
    except Exception as error:  # the formats' libraries raise what they like
        path.unlink(missing_ok=True)
        why = str(error) if isinstance(error, MocapError) else f"{type(error).__name__}: {error}"
        return [f"{path.name} was not written: {why}. The other outputs are whole"]
    return []


def write_pose_npz(path: Path, poses: Sequence[PersonPoses]) -> None:
    """Joint angles, root and landmark covariances of every person, SI units, z up."""
    arrays: dict[str, Any] = {
        "persons": np.array([p.person for p in poses], dtype=np.int64),
        "columns": np.array(poses[0].body.layout.names if poses else [], dtype=np.str_),
        "joints": np.array(poses[0].body.joints if poses else [], dtype=np.str_),
    }
    for p in poses:
        prefix = f"person_{p.person}_"
        arrays[prefix + "frames"] = p.frames
        arrays[prefix + "state"] = p.states
        arrays[prefix + "landmarks_m"] = p.landmarks
        arrays[prefix + "landmark_covariance_m2"] = p.landmark_covariance
        arrays[prefix + "observed"] = p.observed
        arrays[prefix + "log_likelihood"] = p.log_likelihood
        arrays[prefix + "height_m"] = np.array(p.body.height_m)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    with writing(path):
        path.write_bytes(buffer.getvalue())
