"""The report of a run: what report.html says, out of the record and of what was found."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from mocap.pipeline.edits.model import EDITS_FILE
from mocap.pipeline.figures import run_charts, run_figures, silhouette_numbers
from mocap.pipeline.panels import frame_panels
from mocap.pipeline.pictures import RunPictures, read_pictures
from mocap.pipeline.record import OUTPUTS, Found, RunRecord, RunResult, printable
from mocap.pipeline.replay import charts_of, person_summary, replay_of
from mocap.pose.doubt import doubts_of_all
from mocap.view import REPORT_SCORES, PersonPage, Place, ReportData, write_report

OUTPUT_WORDS = {
    "run.json": "configuration, versions, seed, timings and warnings of this run",
    "edits.toml": "what was edited by hand; applied whenever the result is made again",
    "tracks.csv": "where every person is in every frame, how certain that is, and whether he was seen",
    "landmarks.csv": "landmarks per person and frame, with standard deviations, metres",
    "angles.csv": "anatomical angles per person and frame, with standard deviations, degrees",
    "contacts.csv": "how probable it is that heels and toes rest on the floor, per frame",
    "steps.csv": "foot contacts and steps of every person",
    "cycles.csv": "angles over the gait cycle, means and deviations, degrees",
    "moves.csv": "jumps and squats: when, how high and how deep",
    "pose.npz": "joint angles, root, landmark covariances",
    "body.toml": "the person's body as sized: --set body.model=FILE uses it again",
    "scene.rrd": "cameras, images, voxels and bodies on a time line, for the Rerun viewer",
    "store.zarr": "what every stage found in every frame; lets a run be resumed and edited",
    ".bvh": "animated skeleton for animation tools (y up, centimetres)",
    ".trc": "landmark trajectories for biomechanics tools (y up, metres)",
    ".c3d": "landmark trajectories for biomechanics tools (z up, millimetres)",
    ".mot": "joint angles for OpenSim (degrees, metres)",
    ".osim": "the person as a model for OpenSim; `_ik.xml` beside it runs its inverse kinematics",
    ".glb": "animated person with armature and skin (y up, metres)",
}


def write_run_report(result: RunResult, path: Path, gathered: ReportData | None = None) -> None:
    """report.html: what was found, pictures to judge it by, errors where truth exists, timing, settings.

    gathered : what `gather_report` gave earlier, None = gather it now.
    """
    data = gathered or gather_report(result, read_pictures(result.found, report=result.record.config.output))
    names = {"run.json", result.found.store.path.name, *(p.name for p in path.parent.iterdir())}
    names |= {EDITS_FILE} if result.record.config.edits else set()
    write_report(path, replace(data, warnings=result.record.warnings, outputs=tuple(_output_words(names))))


def gather_report(result: RunResult, pictures: RunPictures) -> ReportData:
    """All that the report shows but what is known last: the warnings, and which files there are."""
    record, found = result.record, result.found
    session = found.session
    n = len(session.frames)
    scores = record.scores or {}
    return ReportData(
        title=f"Motion capture: {record.session}",
        session=record.session,
        status="complete",
        n_persons=len(found.poses),
        n_frames=n,
        n_cameras=len(session.rig),
        fps=session.fps,
        summary=tuple(_summary(record, found)),
        scores={k: scores[k] for k in REPORT_SCORES if k in scores} or None,
        per_landmark_mm=scores.get("per_landmark_mm"),
        timings={
            stage: (seconds, 1000.0 * seconds / n)
            for stage, seconds in record.timings_s.items()
            if stage != OUTPUTS
        },
        figures=tuple(run_figures(found, pictures.whole[session.frames.start])),
        charts=tuple(run_charts(record, found)),
        frames=tuple(frame_panels(found, record.config.output, pictures.whole)),
        command=record.command
        or printable(f"mocap run {session.name} -o {result.out.name} --seed {record.seed}"),
        config_text=json.dumps(record.config.model_dump(mode="json"), indent=1),
        versions=dict(record.versions),
        silhouettes=silhouette_numbers(record, found),
        replay=replay_of(found, pictures.sheets) if n else None,
        people=tuple(_people(found)),
        places=tuple(_places(found)),
    )


def _people(found: Found) -> Iterator[PersonPage]:
    """Curves and numbers of every person."""
    for person in found.people:
        told = person.poses, person.angles, person.gait, person.fps
        yield PersonPage(f"person {person.poses.person}", tuple(charts_of(*told)), person_summary(*told))


def _places(found: Found) -> Iterator[Place]:
    """What is worth looking at."""
    for doubt in doubts_of_all(found.poses, found.session.fps, found.method.doubt):
        name, why = f"person {doubt.person}", "; ".join(doubt.reasons)
        yield Place(name, doubt.frames, doubt.worst, doubt.value, why)


def _output_words(names: Iterable[str]) -> Iterator[tuple[str, str]]:
    """What lies in the folder, with what it is."""
    for name in sorted(names):
        words = OUTPUT_WORDS.get(name) or OUTPUT_WORDS.get(Path(name).suffix)
        if words and not name.startswith("."):
            yield name, words


def _summary(record: RunRecord, found: Found) -> list[tuple[str, str]]:
    """The first table of the report."""
    height = ", ".join(f"person {p.person}: {p.body.height_m:.2f} m" for p in found.poses)
    return [
        ("Body height", height or "no person"),
        *_motion_words(record, _DONE),
        ("Cameras", ", ".join(record.cameras)),
        ("Frames", f"{record.frames.start} to {record.frames.stop - 1} at {record.fps:g} frames/s"),
        *_observation_words(record),
        *_motion_words(record, _QUALITY),
        ("Pose filter", _filter_words(record)),
        ("Seed", str(record.seed)),
    ]


# What a coach reads first; and what the poses say of themselves. (name, number that must be there, words)
_DONE = (
    (
        "Steps",
        "cadence_per_min",
        "{steps:.0f} at {cadence_per_min:.0f} per minute, {step_length_m:.2f} m long, {step_width_m:.2f} m wide, "
        "{speed_m_s:.2f} m/s",
    ),
    ("Jumps", "jumps", "{jumps:.0f}, the highest {highest_jump_m:.2f} m"),
    ("Squats", "squats", "{squats:.0f}, the deepest {deepest_squat_m:.2f} m"),
)
_QUALITY = (
    ("Landmarks observed", "observed_percent", "{observed_percent:.1f} %"),
    ("Jitter of landmarks", "jitter_m_s3", "{jitter_m_s3:.0f} m/s^3"),
)


def _motion_words(record: RunRecord, told: tuple[tuple[str, str, str], ...]) -> list[tuple[str, str]]:
    """What the motion of the persons is, in numbers."""
    persons = record.numbers.get("pose", {}).get("persons", {})
    rows = []
    for name, key, words in told:
        of = [f"person {p}: {words.format(**n)}" for p, n in persons.items() if n.get(key) is not None]
        if of:
            rows.append((name, ", ".join(of)))
    return rows


def _observation_words(record: RunRecord) -> list[tuple[str, str]]:
    """What the poses were found from."""
    detect, volume = record.numbers.get("detect"), record.numbers.get("carve", {})
    if record.kind == "keypoints":
        found = record.numbers["keypoints"]
        return [
            ("Persons of the keypoints", str(found["n_persons"])),
            ("Keypoints of persons", f"{found['figures_per_picture']} persons per picture"),
        ]
    if detect is not None:
        source = {"detections": "detections/", "colour": "their colour in the pictures"}[detect["source"]]
        return [
            ("Markers found by", source),
            ("Marker detections", f"{detect['mean_detections_per_picture']} per picture"),
        ]
    return [
        ("Mean volume of the hull", f"{volume.get('mean_volume_litres', 0)} litres"),
        ("Cameras that may be wrong about a voxel", str(volume.get("n_faulty_views", 0))),
    ]


def _filter_words(record: RunRecord) -> str:
    pose = record.config.pose
    text = f"{pose.filter}, {pose.n_layers} layers of {pose.n_particles} particles"
    what = {
        "markers": "the detections",
        "keypoints": "the keypoints",
        "fused": "hull and keypoints",
    }.get(record.kind, "the hull's surface")
    if pose.refine:
        text += f", refined on {what}"
    return text
