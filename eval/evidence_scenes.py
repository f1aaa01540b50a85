"""The scenes of the table of evidence: something in each is hard for silhouettes.

Nothing was chosen on them. Keypoints are simulated with the errors of a pose network (`eval.keypoint_errors`), cam_0
measures depth, seven cameras stand on a ring.
"""

from __future__ import annotations

from copy import deepcopy
from pathlib import Path
from typing import Any

from mocap.synth import synthesise
from mocap.synth.scene import scene_from_dict

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


def scene_of(name: str, seed: int) -> dict[str, Any]:
    """A scene as `mocap synth` reads it; another seed has other people, another room and other errors."""
    scene = deepcopy({"name": name, **_COMMON, **SCENES[name]})
    for what in (scene, *scene["persons"]):
        what["seed"] += 1000 * seed
    return scene


def scene_folder(name: str, seed: int, work: Path) -> Path:
    """The folder of a scene, one of these or of `mocap synth`, which is made when it is not there."""
    folder = work / "scenes" / f"{name}_{seed}"
    if not folder.is_dir():
        scene = scene_from_dict(scene_of(name, seed)) if name in SCENES else name
        synthesise(scene, folder, workers=1)
    return folder
