"""eval/keypoint_confidence.py: places stay as they are, confidences mean something else."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from eval.keypoint_confidence import MEANINGS, with_confidence


def test_confidences_alone_are_changed(tmp_path: Path) -> None:
    path = tmp_path / "cam.csv"
    path.write_text("frame,keypoint,u_px,v_px,confidence\n0,nose,1.5,2.5,0.9\n1,nose,3.5,4.5,0.3\n")
    rng = np.random.default_rng(0)
    text = with_confidence(path, lambda c: MEANINGS["a third"](c, rng))
    assert text.splitlines() == [
        "frame,keypoint,u_px,v_px,confidence",
        "0,nose,1.5,2.5,0.3000",
        "1,nose,3.5,4.5,0.1000",
    ]
    little, much = (MEANINGS["exchanged for doubt"](c, rng) for c in (0.9, 0.1))
    assert 0 < little < much <= 1
