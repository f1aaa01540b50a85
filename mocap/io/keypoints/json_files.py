"""JSON keypoints: OpenPose's folders with one file per picture (Pose2Sim too), and lists of COCO results."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mocap.files import load_json
from mocap.io._files import natural_key
from mocap.io.keypoints.clip import CameraKeypoints, bad, finite_or_none, new_figure, placed
from mocap.io.keypoints.names import ORDERS, rows_of_order
from mocap.io.tables import MOST_WHOLE

_OPENPOSE = "pose_keypoints_2d"


def json_pictures(folder: Path) -> list[Path]:
    """The files of a folder with one JSON file per picture, in order."""
    files = [p for p in folder.iterdir() if p.suffix.lower() == ".json" and not p.name.startswith(".")]
    return sorted(files, key=lambda p: natural_key(p.name))


def frames_of(files: Sequence[Path]) -> list[int]:
    """Frame of each file: the last number in its name, or its place in the order where names have no numbers."""
    numbers = [re.findall(r"\d+", p.stem.removesuffix("_keypoints")) for p in files]
    if not all(numbers):
        return list(range(len(files)))
    frames = [int(n[-1]) for n in numbers]
    return frames if len(set(frames)) == len(frames) else list(range(len(files)))


def read_openpose_folder(folder: Path) -> CameraKeypoints:
    """{"people": [{"pose_keypoints_2d": [u, v, confidence, ...]}, ...]} of every picture."""
    clip = CameraKeypoints(folder)
    files = json_pictures(folder)
    for path, frame in zip(files, frames_of(files), strict=True):
        if frame >= MOST_WHOLE:
            raise bad(path, "the number in the file's name is no frame")
        clip.of_frame.setdefault(frame, [])
        document = load_json(path, "the keypoints")
        people = document.get("people") if isinstance(document, dict) else None
        if not isinstance(people, list):
            raise bad(path, 'it has no list "people"', frame)
        for person in people:
            if person == {}:  # Pose2Sim's for somebody whom this camera does not show
                continue
            values = person.get(_OPENPOSE) if isinstance(person, dict) else None
            if not isinstance(values, list):
                raise bad(path, f'a person has no list "{_OPENPOSE}"', frame)
            if values:
                clip.add(frame, _figure(values, path, frame))
    return clip


def read_coco_results(path: Path) -> CameraKeypoints:
    """[{"image_id": 0, "keypoints": [u, v, confidence, ...]}, ...]: one entry per person and picture."""
    document = load_json(path, "the keypoints")
    if not isinstance(document, list):
        raise bad(path, "it is no list of results (image_id, keypoints)")
    clip = CameraKeypoints(path)
    for entry in document:
        values = entry.get("keypoints") if isinstance(entry, dict) else None
        if not isinstance(values, list):
            raise bad(path, 'a result has no list "keypoints"')
        frame = _image_number(entry.get("image_id"), path)
        clip.add(frame, _figure(values, path, frame))
    return clip


def _image_number(image: object, path: Path) -> int:
    """The frame that an image_id names: a whole number, or a name with one, such as "000012.jpg"."""
    if isinstance(image, str) and (found := re.findall(r"\d+", Path(image).stem)):
        image = int(found[-1])
    if isinstance(image, bool) or not isinstance(image, int) or not 0 <= image < MOST_WHOLE:
        raise bad(path, f"image_id {image!r} is no frame")
    return image


def _figure(values: list[Any], path: Path, frame: int) -> Any:
    n_points, rest = divmod(len(values), 3)
    rows = rows_of_order(n_points)
    if rest or rows is None:
        known = ", ".join(f"{n} ({name})" for n, (name, _) in ORDERS.items())
        raise bad(
            path, f"{len(values)} numbers of a person; 3 for each point are read, of {known} points", frame
        )
    figure = new_figure()
    for k, row in enumerate(rows):
        if row is not None:
            u, v, c = (finite_or_none(value, path, frame) for value in values[3 * k : 3 * k + 3])
            placed(figure, row, u, v, c)
    return figure
