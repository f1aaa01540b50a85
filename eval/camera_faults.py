"""Are bad cameras found, and named with their frame? The fault scenes and clean scenes, one table.

    python -m eval.camera_faults                      # development scenes
    python -m eval.camera_faults --test               # the scenes kept for the final judgement
    python -m eval.camera_faults --masks truth        # silhouettes of the renderer instead of segmented ones

Synthesises what is not in --work yet (two minutes a scene), segments it and looks for faults as `mocap carve` does.
Writes eval/results/camera_faults_{development,test}.csv. Thresholds were set on the development scenes alone.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from eval.whole import write_csv
from mocap.io.session import Session, open_session
from mocap.io.video import FrameReader
from mocap.pipeline.config import load_config
from mocap.volume import ConsistencyMonitor, choose_grid, find_faults

RESULTS = Path(__file__).with_name("results")
FRAMES_OFF = 5
DEVELOPMENT = (
    "fault_moved", "fault_lag", "fault_lag_constant", "fault_frozen", "fault_dropped", "fault_off",
    "fault_offset", "fault_light", "fault_lamp", "fault_exposure", "fault_obstacle",
    "demo", "walk", "gesture", "stand", "two_persons", "four_cameras", "box",
)  # fmt: skip
TEST = (
    "fault_moved_test", "fault_lag_test", "fault_frozen_test", "fault_dropped_test",
    "walk_test", "gesture_test", "box_test",
)  # fmt: skip
# What the scenes call a fault -> the kinds that name it rightly. Light, exposure, obstacles and clocks that differ by
# less than a frame are no camera faults: naming a camera is a false alarm there.
RIGHT = {"moved": ("moved",), "lag": ("lag",), "dropped": ("lag",), "frozen": ("frozen",), "off": ("black",)}
Row = dict[str, str | int]


def evaluate(root: Path, source: str) -> list[Row]:
    """Rows of one scene: one per true fault, or one for a scene without any."""
    truth = json.loads((root / "truth" / "truth.json").read_text(encoding="utf-8"))
    true_faults = [f for f in truth.get("faults", []) if f["kind"] in RIGHT]
    lost = sum(f["n_frames"] for f in true_faults if f["kind"] == "dropped")
    session = open_session(root, frames=(0, truth["frames"] - lost) if lost else None)
    found = find_faults(watch(session, source))
    rows: list[Row] = []
    for fault in true_faults:
        named = [f for f in found if f.camera == fault["camera"]]
        right = [f for f in named if f.kind in RIGHT[fault["kind"]]]
        best = next(iter(right or named), None)
        off = "" if best is None else best.first_frame - fault["frame"]
        rows.append(
            {
                "scene": root.name,
                "masks": source,
                "camera": fault["camera"],
                "fault": _words(fault),
                "true_frame": fault["frame"],
                "named_frame": "" if best is None else best.first_frame,
                "frames_off": off,
                "named": "" if best is None else best.message,
                "is_right": int(bool(right) and abs(int(off)) <= FRAMES_OFF),
                "false_alarms": len([f for f in found if f is not best]),
            }
        )
    if not rows:
        blank = dict.fromkeys(("camera", "fault", "true_frame", "named_frame", "frames_off"), "")
        alarms = [f for f in found if f.camera]
        rows = [
            {
                "scene": root.name,
                "masks": source,
                **blank,
                "named": "; ".join(f.message for f in found),
                "is_right": int(not alarms),
                "false_alarms": len(alarms),
            }
        ]
    return rows


def watch(session: Session, source: str) -> ConsistencyMonitor:
    """All frames of a session, with the renderer's silhouettes (`truth`) or segmented ones (`images`)."""
    monitor = ConsistencyMonitor(session.rig, choose_grid(session.rig, 0.02, bounds_m=session.room_bounds_m))
    with FrameReader(session.image_sources, session.rig, session.frames) as reader:
        masks_of = _true_masks(session) if source == "truth" else None
        segmenters = None if masks_of is not None else _segmenters(session)
        for frame, images in reader:
            if masks_of is not None:
                masks = [own[frame] for own in masks_of]
            else:
                assert segmenters is not None
                masks = [s.segment(i).mask for s, i in zip(segmenters, images, strict=True)]
            monitor.add(frame, masks, monitor.glimpse(images))
    return monitor


def _segmenters(session: Session) -> list:
    from mocap.foreground import ForegroundSettings, Segmenter
    from mocap.pipeline.stages.segment import learn_backgrounds

    config = load_config().segmentation
    settings = ForegroundSettings(method=config.method)
    return [Segmenter(b, settings) for b in learn_backgrounds(session, config, [])]


def _true_masks(session: Session) -> list[NDArray[np.bool_]]:
    assert session.truth_dir is not None
    masks = []
    for camera in session.rig:
        with np.load(session.truth_dir / "masks" / f"{camera.name}.npz", allow_pickle=False) as archive:
            masks.append(np.unpackbits(archive["masks"], axis=2, count=camera.size[0]).view(np.bool_))
    return masks


def _words(fault: dict) -> str:
    number = fault.get("lag_frames", fault.get("n_frames", ""))
    return f"{fault['kind']} {number}".strip()


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m eval.camera_faults", description=__doc__)
    parser.add_argument(
        "--work", type=Path, default=Path("out/camera_faults"), help="folder for the sessions"
    )
    parser.add_argument("--masks", choices=("images", "truth"), default="images")
    parser.add_argument("--test", action="store_true", help="the scenes kept for the final judgement")
    parser.add_argument("--scenes", nargs="*", help="only these")
    options = parser.parse_args(argv)
    rows: list[Row] = []
    for name in options.scenes or (TEST if options.test else DEVELOPMENT):
        root = options.work / name
        if not (root / "truth" / "truth.json").exists():
            from mocap.synth import synthesise

            synthesise(name, root)
        rows += evaluate(root, options.masks)
        for row in rows[-1:]:
            print(_line(row), flush=True)
    _write(RESULTS / f"camera_faults_{'test' if options.test else 'development'}.csv", rows)
    bad = sum(not r["is_right"] for r in rows)
    print(f"{len(rows) - bad} of {len(rows)} right, {sum(int(r['false_alarms']) for r in rows)} false alarms")
    return 0


def _line(row: Row) -> str:
    return (
        f"{row['scene']:20} {row['fault'] or 'no fault':10} {row['true_frame']!s:>5} {row['frames_off']!s:>4} "
        f"{'right' if row['is_right'] else 'WRONG':6} {row['named']}"
    )


def _write(path: Path, rows: list[Row]) -> None:
    """Rows of other masks or scenes that an earlier call wrote are kept."""
    kept: Iterator[Row] = iter(())
    if path.exists():
        with path.open(encoding="utf-8", newline="") as file:
            kept = iter([dict(r) for r in csv.DictReader(file)])
    fresh = {(r["scene"], r["masks"], r["camera"]) for r in rows}
    every = [r for r in kept if (r["scene"], r["masks"], r["camera"]) not in fresh] + rows
    write_csv(
        path, list(rows[0]), sorted(every, key=lambda r: (str(r["masks"]), str(r["scene"]), str(r["camera"])))
    )


if __name__ == "__main__":
    sys.exit(main())
