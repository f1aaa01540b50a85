"""Cameras that lie: faults put into healthy sessions; found, named rightly, and what they cost, one table.

    python -m eval.fault_table                 # development scenes
    python -m eval.fault_table --test          # other scenes, other cameras and other sizes of the faults
    python -m eval.fault_table --healthy       # false alarms on healthy sessions at three picture sizes

Synthesises what is not in --work yet (ten seconds a scene) and runs every session with the cameras ignored and with
what is found left out. Writes eval/results/fault_table_{development,test}.csv and healthy_cameras.csv. Thresholds were
set on the development scenes and on realistic sessions of another make. A command that was stopped goes on where it
was.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from eval.whole import write_csv, write_text
from mocap.data import CameraRig
from mocap.io.calibration import read_calibration, write_calibration
from mocap.io.session import open_session
from mocap.io.store import StageStore
from mocap.io.tables import read_landmarks_csv
from mocap.pipeline.config import load_config
from mocap.pipeline.run import run_session
from mocap.products.hulls import stored_faults
from mocap.synth.faults import MovedCamera, moved_cameras

Image = NDArray[np.uint8]
Clip = list[Image]
Row = dict[str, Any]

RESULTS = Path(__file__).with_name("results")
N_FRAMES, SIZE = 40, (320, 240)
DEVELOPMENT, TEST = ("walk",), ("walk_test",)
HEALTHY = (
    "walk_test", "gesture_test", "box_test", "dance_test", "jog_test",
    "throw_test", "fall_test", "sit_test", "loose_clothes_test", "furnished_test",
)  # fmt: skip
# Picture size -> seeds; other seeds are other persons. Large pictures take their time.
HEALTHY_SIZES = {(160, 120): (None, 901), (320, 240): (None, 901), (640, 480): (None,)}


@dataclass(frozen=True)
class Fault:
    """Something wrong with some cameras of a rig of seven.

    cameras : indices.  change : their pictures from frame to frame.  turn_deg, shift_m : how they really stand, beside
    the calibration, for the first and, reversed, for the second.  exchanges : their clips, backgrounds and all.
    """

    name: str
    cameras: tuple[int, ...]
    change: Callable[[Clip], Clip] | None = None
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    exchanges: bool = False
    also_background: bool = False


def flicker(clip: Clip, share: float = 0.3) -> Clip:
    """Every second picture is darker."""
    return [np.asarray(p * (1 - share), np.uint8) if f % 2 else p for f, p in enumerate(clip)]


def exposed(clip: Clip, gain: float = 3.0) -> Clip:
    """Too much light."""
    return [np.asarray(np.clip(p * gain, 0, 255), np.uint8) for p in clip]


def black(clip: Clip) -> Clip:
    """Nothing, but for the noise of the sensor."""
    rng = np.random.default_rng(1)
    return [rng.integers(0, 4, p.shape, dtype=np.uint8) for p in clip]


def noise(clip: Clip) -> Clip:
    """Nothing but noise."""
    rng = np.random.default_rng(2)
    return [rng.integers(0, 256, p.shape, dtype=np.uint8) for p in clip]


def upside_down(clip: Clip) -> Clip:
    """A camera that hangs from the ceiling."""
    return [np.ascontiguousarray(p[::-1, ::-1]) for p in clip]


def repeats(clip: Clip, share: float = 0.3) -> Clip:
    """Pictures replaced by the one before, here and there."""
    is_lost = np.random.default_rng(3).random(len(clip)) < share
    out = [clip[0]]
    for f in range(1, len(clip)):
        out.append(out[-1] if is_lost[f] else clip[f])
    return out


def frozen(clip: Clip) -> Clip:
    """One picture from the second third on."""
    n = len(clip) // 3
    return clip[:n] + [clip[n - 1]] * (len(clip) - n)


def late(n_frames: int) -> Callable[[Clip], Clip]:
    """Pictures of some frames ago."""
    return lambda clip: [clip[max(f - n_frames, 0)] for f in range(len(clip))]


def faults(is_test: bool) -> tuple[Fault, ...]:
    """The faults of the table; those of the test are of other cameras, directions and sizes."""
    a, b = (4, 0) if is_test else (2, 5)
    lag = 4 if is_test else 3
    pan, tilt = ((0.0, 0.0, 1.0), (0.71, -0.71, 0.0)) if is_test else ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    turn = tilt if is_test else pan
    third = tuple(x / 3 for x in turn)
    three = tuple(3 * x for x in turn)
    shift = (0.0, 0.014, 0.014) if is_test else (0.02, 0.0, 0.0)
    return (
        Fault("flicker of 30 %", (a,), flicker),
        Fault("black", (b,), black),
        Fault("noise", (a,), noise),
        Fault("over-exposed", (b,), exposed),
        Fault("upside down", (a,), upside_down, also_background=True),
        Fault("two swapped", (a, b), exchanges=True),
        Fault("frozen", (b,), frozen),
        Fault("30 % repeated", (a,), repeats),
        Fault(f"{lag} frames late", (b,), late(lag)),
        Fault(f"two {lag} frames late", (a, b), late(lag)),
        Fault("turned by 1/3 deg", (a,), turn_deg=(third[0], third[1], third[2])),
        Fault("turned by 1 deg", (b,), turn_deg=turn),
        Fault("turned by 3 deg", (a,), turn_deg=(three[0], three[1], three[2])),
        Fault("two turned by 1 deg", (a, b), turn_deg=turn),
        Fault("two turned by 3 deg", (a, b), turn_deg=(three[0], three[1], three[2])),
        Fault("shifted by 2 cm", (b,), shift_m=shift),
        Fault("three turned by 1 deg", (a, b, 3), turn_deg=turn),
    )


def with_fault(session: Path, fault: Fault, out: Path) -> Path:
    """A copy of a session in which some cameras lie."""
    if out.exists():
        shutil.rmtree(out)
    shutil.copytree(session, out)
    found = read_calibration(out / "calibration.toml")
    names = [found.rig.names[c] for c in fault.cameras]
    if fault.change is not None:
        for name in names:
            for folder in ("videos", "background") if fault.also_background else ("videos",):
                path = out / folder / f"{name}.mp4"
                write_clip(path, fault.change(read_clip(path)))
    if fault.exchanges:
        for folder in ("videos", "background"):
            first, second = (out / folder / f"{name}.mp4" for name in names)
            kept = first.read_bytes()
            first.write_bytes(second.read_bytes())
            second.write_bytes(kept)
    if any(fault.turn_deg) or any(fault.shift_m):
        write_calibration(out / "calibration.toml", _misplaced(found.rig, fault))
    return out


def _misplaced(rig: CameraRig, fault: Fault) -> CameraRig:
    """The rig as a wrong calibration has it."""
    cameras = list(rig)
    for sign, c in zip((1, -1, 1), fault.cameras, strict=False):
        (rx, ry, rz), (x, y, z) = sign * np.array(fault.turn_deg), sign * np.array(fault.shift_m)
        move = MovedCamera(
            kind="moved", camera=cameras[c].name, frame=1, rotate_deg=(rx, ry, rz), shift_m=(x, y, z)
        )
        cameras[c] = moved_cameras(cameras[c], [move])[-1]
    return CameraRig(tuple(cameras))


def read_clip(path: Path) -> Clip:
    """All pictures of a video, BGR."""
    capture = cv2.VideoCapture(str(path))
    pictures = []
    while (got := capture.read())[0]:
        pictures.append(np.asarray(got[1], np.uint8))
    capture.release()
    return pictures


def write_clip(path: Path, pictures: Clip, fps: float = 30.0) -> None:
    """A video of BGR pictures."""
    height, width = pictures[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps, (width, height))
    for picture in pictures:
        writer.write(picture)
    writer.release()


def prepared(
    name: str, work: Path, size: tuple[int, int], seed: int | None = None, n_frames: int = N_FRAMES
) -> Path:
    """A healthy session of some frames, synthesised when it is not there yet."""
    root = work / f"{name}{'' if seed is None else f'_{seed}'}_{size[0]}"
    if not (root / "truth" / "truth.json").exists():
        from mocap.synth import synthesise
        from mocap.synth.scene import load_scene, scene_from_dict

        scene = load_scene(name).model_dump(mode="json")
        rig = {**scene["rig"], "size_px": list(size)}
        scene = {**scene, "n_frames": n_frames, "truth_voxels": False, "rig": rig}
        synthesise(scene_from_dict(scene), root, seed=seed, workers=1)
    return root


def strays(session: Path, fault: Fault) -> Row:
    """How far a wrong calibration moves the pictures of people, px, and lines of sight at them, mm: means over the
    landmarks, of the camera that is off least."""
    rig = read_calibration(session / "calibration.toml").rig
    wrong = _misplaced(rig, fault)
    people = read_landmarks_csv(session / "truth" / "landmarks.csv")
    points = np.concatenate([motion.landmarks.reshape(-1, 3) for motion in people])
    moved = []
    for c in fault.cameras:
        (there, depth), (here, _) = rig[c].project(points), wrong[c].project(points)
        px = np.linalg.norm(here - there, axis=1)
        focal_px = 0.5 * (rig[c].K[0, 0] + rig[c].K[1, 1])
        moved.append((float(np.nanmean(px)), 1000 * float(np.nanmean(px * depth)) / focal_px))
    px, mm = min(moved)
    return {"moves_px": round(px, 2), "misses_mm": round(mm, 1)}


def scores_of(session: Path, out: Path, how: str) -> Row:
    """Scores of a run, and what it says of cameras.  how : of volume.on_bad_camera."""
    config = load_config("default", ("output.formats=[]", f"volume.on_bad_camera={how}"))
    result = run_session(session, out, config=config, n_threads=1)
    scores = result.scores or {}
    keys = ("mean_error_mm", "coverage_90_percent", "silent_error_percent")
    return {key: None if scores.get(key) is None else round(scores[key], 1) for key in keys}


def kept(path: Path, make: Callable[[], Row]) -> Row:
    """A row that is made once, so that the command can be stopped and started again."""
    if not path.exists():
        write_text(path, json.dumps(make()))
    row: Row = json.loads(path.read_text(encoding="utf-8"))
    print(", ".join(f"{k} {v}" for k, v in row.items()), flush=True)
    return row


def evaluate(session: Path, fault: Fault, work: Path, healthy_mm: float | None) -> Row:
    """One row of the table."""
    faulty = with_fault(session, fault, work / f"{session.name}_faulty")
    out = work / f"{session.name}_out"
    handled = scores_of(faulty, out, "exclude")
    found = stored_faults(StageStore(out / "store.zarr"))
    # What a wrong calibration costs is told here, other faults by `python -m eval.camera_faults`.
    is_calibration = any(fault.kind in ("calibration", "rig") for fault in found)
    ignored = scores_of(faulty, out, "ignore") if is_calibration else dict.fromkeys(handled)
    names = {open_session(faulty).rig.names[c] for c in fault.cameras}
    named = {f.camera for f in found if f.camera}
    is_misplaced = any(fault.turn_deg) or any(fault.shift_m)
    moved = strays(session, fault) if is_misplaced else {"moves_px": None, "misses_mm": None}
    return {
        "session": session.name,
        "fault": fault.name,
        "cameras": " ".join(sorted(names)),
        **moved,
        "is_found": int(bool(found)),
        "is_right": int(named == names),
        "false_alarms": len(named - names),
        "healthy_mm": healthy_mm,
        "ignored_mm": ignored["mean_error_mm"],
        "handled_mm": handled["mean_error_mm"],
        "ignored_coverage_90_percent": ignored["coverage_90_percent"],
        "handled_coverage_90_percent": handled["coverage_90_percent"],
        "handled_silent_error_percent": handled["silent_error_percent"],
        "said": "; ".join(f.message for f in found),
    }


def look_at_healthy(name: str, seed: int | None, size: tuple[int, int], work: Path) -> Row:
    """What is said of a session in which every camera is well."""
    session = prepared(name, work, size, seed)
    out = work / f"{session.name}_out"
    run_session(session, out, config=load_config("default"), until="carve", n_threads=1)
    found = stored_faults(StageStore(out / "store.zarr"))
    shutil.rmtree(out)
    return {
        "session": session.name,
        "false_alarms": len(found),
        "said": "; ".join(f.message for f in found),
    }


def healthy(work: Path) -> Iterator[Row]:
    """False alarms on sessions in which every camera is well; all sizes of a scene together, other casts last."""
    for k in range(max(map(len, HEALTHY_SIZES.values()))):
        for name in HEALTHY:
            for size, seeds in HEALTHY_SIZES.items():
                if k < len(seeds):
                    place = work / "rows" / f"healthy_{name}_{seeds[k]}_{size[0]}.json"
                    yield kept(place, partial(look_at_healthy, name, seeds[k], size, work))


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m eval.fault_table", description=__doc__)
    parser.add_argument(
        "--work", type=Path, default=Path("out/fault_table"), help="folder for sessions and runs"
    )
    parser.add_argument(
        "--test", action="store_true", help="the scenes and faults kept for the final judgement"
    )
    parser.add_argument("--healthy", action="store_true", help="false alarms instead")
    options = parser.parse_args(argv)
    if options.healthy:
        rows = list(healthy(options.work))
        write_csv(RESULTS / "healthy_cameras.csv", list(rows[0]), rows)
        return 0
    rows = []
    for name in TEST if options.test else DEVELOPMENT:
        session = prepared(name, options.work, SIZE)
        plain = kept(
            options.work / "rows" / f"{name}.json",
            partial(scores_of, session, options.work / f"{session.name}_out", "exclude"),
        )
        for fault in faults(options.test):
            place = options.work / "rows" / f"{name}_{fault.name.replace('/', '_')}.json"
            rows.append(kept(place, partial(evaluate, session, fault, options.work, plain["mean_error_mm"])))
    write_csv(RESULTS / f"fault_table_{'test' if options.test else 'development'}.csv", list(rows[0]), rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
