"""What `mocap calibrate --refine` does to a calibration that is off: docs/pictures/refine.png.

python -m docs.make_refine_picture
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from eval.refine_rig import disturbed
from mocap.io.calibration import read_calibration, write_calibration
from mocap.pipeline.refine import refine_session, write_picture
from mocap.synth import synthesise
from mocap.synth.scene import load_scene

PICTURE = Path(__file__).parent / "pictures" / "refine.png"
SCENE, N_FRAMES = "walk", 150


def main() -> None:
    """Film, disturb, refine, draw."""
    with tempfile.TemporaryDirectory() as folder:
        session = synthesise(
            load_scene(SCENE).model_copy(update={"n_frames": N_FRAMES}), Path(folder) / "session"
        )
        truth = read_calibration(session / "calibration.toml").rig
        wrong = disturbed(truth, 2.0, 0.03, np.random.default_rng(0))
        write_calibration(session / "calibration.toml", wrong)
        write_picture(PICTURE, refine_session(session), wrong)


if __name__ == "__main__":
    main()
