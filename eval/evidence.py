"""Evidence: volumes, keypoints, both, and depth added, by number of cameras and by scene, with time per frame.

Synthetic scenes that nothing was chosen on, 40 frames each, seven cameras on a ring: keypoints are simulated with the
errors of a pose network (`eval.keypoint_errors`), and cam_0 measures depth. Writes eval/results/evidence.csv whole: the
scene without an empty clip, with two and four cameras. Other scenes and cameras are printed.

    python -m eval.evidence [--scenes no_empty_clip,clean,furnished,camouflage,two_persons] [--cameras 2,4]

A row that was measured once is kept in --work and read from there, so that a table may be made in several calls. Time
per frame is that of a whole run, start of the program and compiled kernels aside.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from eval.keypoints import FIELDS, Case, measure
from eval.whole import write_csv, write_text
from mocap.pipeline.warm_up import warm_up
from mocap.synth import synthesise
from mocap.synth.scene import scene_from_dict

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "eval" / "results" / "evidence.csv"
METHODS = ("volumes", "triangulation", "keypoints", "fused", "fused_depth")
IN_TABLE, CAMERAS = ("no_empty_clip",), (2, 4)
SEED = 0
_COMMON: dict[str, Any] = {
    "n_frames": 40,
    "rig": {"n_cameras": 7},
    "keypoints": {},
    "depth": {"cameras": ["cam_0"]},
    "truth_voxels": False,
}
SCENES: dict[str, dict[str, Any]] = {
    "clean": {
        "description": "A woman walks",
        "seed": 5101,
        "persons": [{"seed": 5111, "sex": "female", "motion": {"kind": "walk", "radii_m": [0.9, 0.8]}}],
    },
    "furnished": {
        "description": "A man walks between a table and a cabinet",
        "seed": 5102,
        "room": {
            "furniture": [
                {"kind": "table", "center_m": [0.0, 0.1], "size_m": [1.2, 0.7], "heading_deg": 65},
                {"lower_m": [1.3, -0.4, 0.0], "upper_m": [1.65, 0.4, 1.4]},
            ]
        },
        "persons": [
            {"seed": 5112, "sex": "male", "motion": {"kind": "walk", "radii_m": [1.0, 1.0], "start_deg": 300}}
        ],
    },
    "camouflage": {
        "description": "A man moves his arms in a shirt of the wall's colour, with skin of the floor's",
        "seed": 5103,
        "persons": [
            {
                "seed": 5113,
                "sex": "male",
                "colours": {"shirt": "wall", "skin": "floor"},
                "motion": {"kind": "gesture", "heading_deg": 40},
            }
        ],
    },
    "no_empty_clip": {
        "description": "A man walks; no clip of the empty room",
        "seed": 5104,
        "with_background": False,
        "persons": [
            {"seed": 5114, "sex": "male", "motion": {"kind": "walk", "radii_m": [1.0, 0.7], "start_deg": 90}}
        ],
    },
    "two_persons": {
        "description": "Two persons walk past each other",
        "seed": 5105,
        "persons": [
            {"seed": 5115, "sex": "female", "motion": {"kind": "walk", "radii_m": [0.5, 0.45]}},
            {"seed": 5125, "sex": "male", "motion": {"kind": "walk", "radii_m": [1.3, 1.2], "start_deg": 70}},
        ],
    },
}


def source(name: str, work: Path) -> Path:
    """The folder of a scene, which is made when it is not there."""
    folder = work / "scenes" / name
    if not folder.is_dir():
        synthesise(scene_from_dict({"name": name, **_COMMON, **SCENES[name]}), folder, workers=1)
    return folder


def row_of(case: Case, work: Path) -> dict[str, Any]:
    """A measured row, or the kept one."""
    kept = work / "rows" / f"{case.session}_{case.cameras}_{case.method}_{case.seed}.json"
    if not kept.exists():
        folder = source(case.session, work)
        row = measure(case, (folder, folder / "keypoints"), work, None)
        write_text(kept, json.dumps({field: row[field] for field in FIELDS}))
    row = json.loads(kept.read_text(encoding="utf-8"))
    print(", ".join(f"{k} {v}" for k, v in row.items()), flush=True)
    return dict(row)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the cases that are asked for, and write the table when they are its own."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", default=",".join(IN_TABLE))
    parser.add_argument("--cameras", default=",".join(map(str, CAMERAS)))
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "evidence")
    options = parser.parse_args(arguments)
    warm_up()
    asked = [
        Case(scene, int(n), method, SEED)
        for scene in options.scenes.split(",")
        for n in options.cameras.split(",")
        for method in METHODS
    ]
    rows = [row_of(case, options.work) for case in asked]
    if asked == [Case(s, n, m, SEED) for s in IN_TABLE for n in CAMERAS for m in METHODS]:
        write_csv(RESULTS, FIELDS, rows)


if __name__ == "__main__":
    main()
