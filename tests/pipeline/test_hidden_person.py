"""Nobody is seen for a while: it is named, and the rest of the clip is as good as without."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path

import cv2
import numpy as np
import pytest
from small_session import CAMERAS, FPS, N_FRAMES, PLAIN, copy_session, small_session

from mocap import load_config, run_session
from mocap.data import LANDMARKS
from mocap.io.tables import read_landmarks_csv
from mocap.pipeline.stages.carve import _gap_warnings

HIDDEN = range(4, 9)


def test_gaps_are_named_where_somebody_is_before_and_after() -> None:
    frames = np.arange(100, 130)
    is_empty = np.zeros(30, dtype=np.bool_)
    is_empty[[0, 1, 2, 3, 4, 5, 29]] = True  # nobody has come yet, and somebody has left
    assert _gap_warnings(frames, is_empty, 10.0) == []
    is_empty[12:16] = True  # too short
    assert _gap_warnings(frames, is_empty, 10.0) == []
    is_empty[20:26] = True
    (warning,) = _gap_warnings(frames, is_empty, 10.0)
    assert "frames 120 to 125 (0.6 s), but" in warning
    assert "Remedy" in warning
    many = np.tile([False, True], 20)
    (warning,) = _gap_warnings(np.arange(40), many, 2.0)
    assert "1 to 1 (0.5 s), 3 to 3 (0.5 s), 5 to 5 (0.5 s) and 16 more" in warning


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Output of a run on the whole clip, and of one in which all cameras are covered for half a second."""
    base = tmp_path_factory.mktemp("hidden")
    source = small_session(tmp_path_factory.getbasetemp())
    covered = dict.fromkeys(CAMERAS, HIDDEN)
    return _run(source, base / "whole", {}), _run(source, base / "covered", covered)


def _run(source: Path, session: Path, covered: Mapping[str, Iterable[int]]) -> Path:
    """A run on a copy of a session in which cameras see nobody in some frames; its output."""
    copy_session(source, session, masks=True)
    for camera, frames in covered.items():
        for frame in frames:
            path = session / "masks" / camera / f"{frame:04d}.png"
            cv2.imwrite(str(path), np.zeros_like(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)))
    out = session.with_name(f"{session.name}_out")
    run_session(session, out, config=load_config("default", (*PLAIN, "output.formats=[]")))
    return out


def test_half_a_second_behind_a_curtain_is_named_and_harms_nothing_else(runs: tuple[Path, Path]) -> None:
    warnings = json.loads((runs[1] / "run.json").read_text("utf-8"))["warnings"]
    assert any(f"frames 4 to 8 ({len(HIDDEN) / FPS:.1f} s)" in warning for warning in warnings)
    whole, covered = (read_landmarks_csv(out / "landmarks.csv") for out in runs)
    assert len(whole) == len(covered) == 1
    hidden = np.isin(covered[0].frames, HIDDEN)
    assert covered[0].observed is not None
    assert not covered[0].observed[hidden].any()
    rest = covered[0].frames[~hidden]
    np.testing.assert_array_equal(rest, [frame for frame in range(N_FRAMES) if frame not in HIDDEN])
    apart = np.linalg.norm(covered[0].landmarks[~hidden] - whole[0].landmarks[rest], axis=2)
    # Two runs of few particles differ by centimetres. The man goes half a metre while nobody sees him.
    assert np.median(apart) < 0.05
    assert apart[:, [LANDMARKS.index("pelvis"), LANDMARKS.index("neck")]].max() < 0.1


def test_a_camera_that_sees_only_furniture_is_named_and_asked_nothing(
    runs: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory
) -> None:
    source = small_session(tmp_path_factory.getbasetemp())
    out = _run(source, tmp_path_factory.mktemp("furniture") / "session", {CAMERAS[1]: range(N_FRAMES)})
    record = json.loads((out / "run.json").read_text("utf-8"))
    assert any(f"camera {CAMERAS[1]}: nobody is in its silhouettes" in w for w in record["warnings"])
    assert record["numbers"]["occluders"]["picture_share"][CAMERAS[1]] > 0
    # Asked, it would vote everything away.
    assert record["numbers"]["carve"]["mean_volume_litres"] > 30
    whole, blind = (read_landmarks_csv(folder / "landmarks.csv") for folder in (runs[0], out))
    assert len(blind) == 1
    both = np.isin(whole[0].frames, blind[0].frames)
    assert both.sum() >= N_FRAMES - 2
    apart = np.linalg.norm(blind[0].landmarks - whole[0].landmarks[both], axis=2)
    # Three cameras instead of four: a hull half as large again.
    assert np.median(apart) < 0.1
