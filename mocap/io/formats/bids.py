"""BIDS-Motion, the folder that neuroimaging keeps motion in: https://bids-specification.readthedocs.io, "Motion"."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mocap.data import Motion
from mocap.errors import MocapError
from mocap.io._files import atomic_text
from mocap.io.formats._together import Together, together
from mocap.io.formats._writing import check_fps

BIDS_VERSION = "1.11.1"
CHANNEL_COLUMNS = ("name", "component", "type", "tracked_point", "units", "placement", "reference_frame")
_README = """# Motion of people

Landmarks of people, found in videos of several calibrated cameras by the program mocap, in metres, z up. A participant
is a person of the recording; all have the same rows in time, `n/a` where a person was not followed. The channel
`latency` is the time from the recording's beginning.
"""


def write_bids_motion(folder: Path, motions: Sequence[Motion], fps: float, task: str) -> list[Path]:
    """Write the landmarks of all persons as a BIDS dataset with one motion recording per person; returns the files.

    folder : made when it is not there.  task : what the recording is called; only its letters and digits are kept.
    Person 1 is `sub-01`; the tracking system is called `mocap`. Positions are channels `NAME_x`, `NAME_y`, `NAME_z` of
    type POS in metres, and `latency` is one of type LATENCY in seconds.
    Raises ValueError for fps <= 0, MocapError without persons, for a task without a letter or digit, or when a file
    cannot be written.
    """
    check_fps(fps)
    motions = [m for m in motions if len(m)]
    if not motions:
        raise MocapError("no person has frames to write", remedy="export another frame range", path=folder)
    label = re.sub(r"[^a-zA-Z0-9]", "", task)
    if not label:
        raise MocapError(
            f"{task!r} is no name of a task: BIDS wants letters and digits", remedy="write --task walking"
        )
    all_of_them = together(motions, fps)
    subjects = [f"sub-{m.person:02d}" for m in motions]
    texts = {
        "README.md": _README,
        "dataset_description.json": _json(
            {
                "Name": task,
                "BIDSVersion": BIDS_VERSION,
                "DatasetType": "raw",
                "GeneratedBy": [{"Name": "mocap"}],
            }
        ),
        "participants.tsv": _tsv([("participant_id", "species"), *((s, "homo sapiens") for s in subjects)]),
        "participants.json": _json({"species": {"Description": "Latin name of the species"}}),
    }
    for p, subject in enumerate(subjects):
        stem = f"{subject}/motion/{subject}_task-{label}_tracksys-mocap"
        texts[f"{stem}_motion.tsv"] = _samples(all_of_them, p)
        texts[f"{stem}_motion.json"] = _json(_metadata(all_of_them, fps, task))
        texts[f"{stem}_channels.tsv"] = _tsv([CHANNEL_COLUMNS, *_channels(all_of_them)])
        texts[f"{stem}_channels.json"] = _json(_REFERENCE_FRAME)
    written = []
    for name, text in texts.items():
        atomic_text(folder / name, text)
        written.append(folder / name)
    return written


_REFERENCE_FRAME = {
    "reference_frame": {
        "Description": "Frame of reference of positions",
        "Levels": {
            "world": {
                "SpatialAxes": "ALS",
                "RotationOrder": "n/a",
                "RotationRule": "right-hand",
                "Description": "The calibrated world: metres, z up, the floor at z = 0",
            }
        },
    }
}


def _metadata(recording: Together, fps: float, task: str) -> dict[str, Any]:
    n = 3 * len(recording.names)
    return {
        "TaskName": task,
        "SamplingFrequency": float(fps),
        "SamplingFrequencyEffective": float(fps),
        "TrackingSystemName": "mocap",
        "Manufacturer": "mocap",
        "MissingValues": "n/a",
        "TrackedPointsCount": len(recording.names),
        "MotionChannelCount": n + 1,
        "POSChannelCount": n,
        "LATENCYChannelCount": 1,
    }


def _channels(recording: Together) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [("latency", "n/a", "LATENCY", "n/a", "s", "n/a", "n/a")]
    return rows + [
        (f"{name}_{axis}", axis, "POS", name, "m", name, "world")
        for name in recording.names
        for axis in "xyz"
    ]


def _samples(recording: Together, person: int) -> str:
    """The table of one person without a header, as BIDS wants it."""
    rows = recording.places[person].reshape(len(recording.frames), -1)
    return _tsv(
        [
            (f"{time:.6f}", *(f"{v:.6f}" if np.isfinite(v) else "n/a" for v in row))
            for time, row in zip(recording.time_s, rows, strict=True)
        ]
    )


def _tsv(rows: Sequence[Sequence[str]]) -> str:
    return "".join("\t".join(row) + "\n" for row in rows)


def _json(what: dict[str, Any]) -> str:
    return json.dumps(what, indent=2) + "\n"
