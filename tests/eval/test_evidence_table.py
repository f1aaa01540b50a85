"""The table of evidence: how estimates and true persons are put together and scored, and what its page says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from docs import make_evidence
from eval.evidence import N_SEEDS, TABLES, scores
from eval.evidence_scenes import SCENES, scene_of
from eval.triangulation import landmarks_of_points
from mocap.data import LANDMARKS, Motion
from mocap.data.keypoints import KEYPOINTS, N_KEYPOINTS


def motion(person: int, x: float, n: int = 12) -> Motion:
    rng = np.random.default_rng(person)
    landmarks = rng.uniform(-0.4, 0.4, (1, len(LANDMARKS), 3)) + np.linspace(0, 1, n)[:, None, None]
    return Motion(person, np.arange(n), np.arange(n) / 30.0, landmarks + np.array([x, 0.0, 0.0]))


def test_the_truth_has_no_error_whatever_the_order() -> None:
    truth = [motion(1, 0.0), motion(2, 3.0)]
    row = scores(truth[::-1], truth, 12)
    assert (row["persons"], row["found"], row["mmta_percent"]) == (2, 2, 100.0)
    assert row["mean_error_mm"] == row["mean_error_after_offset_mm"] == 0.0


def test_who_is_not_found_is_no_error_but_is_missing() -> None:
    truth = [motion(1, 0.0), motion(2, 3.0)]
    row = scores(truth[:1], truth, 12)
    assert (row["found"], row["mean_error_mm"], row["mmta_percent"]) == (1, 0.0, 50.0)
    far = replace(truth[1], landmarks=truth[1].landmarks + 1.0)
    assert scores([truth[0], far], truth, 12)["found"] == 1


def test_a_shift_is_the_raw_error_and_a_landmark_without_an_estimate_is_missing() -> None:
    truth = motion(1, 0.0)
    landmarks = truth.landmarks + np.array([0.0, 0.0, 0.03])
    landmarks[:, 3] = np.nan
    row = scores([replace(truth, landmarks=landmarks)], [truth], 12)
    assert row["mean_error_mm"] == pytest.approx(30.0)
    assert row["mmta_percent"] == pytest.approx(100 * 14 / 15, abs=0.01)


def test_landmarks_that_no_tool_names_are_midpoints() -> None:
    points = np.arange(3.0 * N_KEYPOINTS).reshape(-1, 3)
    found = landmarks_of_points(points)
    hips = points[[KEYPOINTS.index("left_hip"), KEYPOINTS.index("right_hip")]]
    np.testing.assert_allclose(found[LANDMARKS.index("pelvis")], hips.mean(axis=0))
    np.testing.assert_allclose(found[LANDMARKS.index("left_knee")], points[KEYPOINTS.index("left_knee")])


def test_tables_have_every_scene_by_cameras_and_method() -> None:
    table = TABLES["evidence.csv"]
    assert len(set(table)) == len(table) == 5 * 4 * 5 * N_SEEDS
    assert {c.session for c in table if c.method == "fused_depth"} == set(SCENES)
    assert {c.cameras for c in TABLES["keypoints.csv"] if c.session == "room"} == {2, 3, 4, 5}
    assert not any(c.method == "fused_depth" for c in TABLES["keypoints_fused.csv"])


def test_another_seed_is_another_scene() -> None:
    """Seeds of scene and persons move apart, and none of two scenes meet."""
    seeds = [seed for name in SCENES for k in range(5) for seed in seeds_of(scene_of(name, k))]
    assert len(set(seeds)) == len(seeds)
    assert seeds_of(scene_of("clean", 0)) == seeds_of({"seed": 5101, "persons": [{"seed": 5111}]})


def seeds_of(scene: dict[str, Any]) -> list[int]:
    return [scene["seed"], *(person["seed"] for person in scene["persons"])]


@pytest.mark.parametrize("page", [make_evidence.PAGE, make_evidence.KEYPOINTS_PAGE])
def test_a_page_says_what_its_tables_say(page: Path) -> None:
    text, tables = page.read_text(encoding="utf-8"), make_evidence.tables_of(page)
    assert all(table in text for table in tables.values())
    assert make_evidence.written(text, tables) == text


def row(method: str, seed: int, raw: float | None, found: int = 1) -> dict[str, str]:
    errors = {
        f: "" if raw is None else str(raw * k)
        for f, k in ((make_evidence.RAW, 1), (make_evidence.AFTER, 0.5))
    }
    share = "0" if raw is None else "90"
    return {"session": "clean", "cameras": "2", "method": method, "seed": str(seed)} | errors | {
        "found": str(found), "mmta_percent": share
    }  # fmt: skip


def test_cells_are_means_over_seeds_with_their_range_and_say_who_was_not_found() -> None:
    found = [row("volumes", 0, 20.0), row("volumes", 1, 30.0), row("volumes", 2, None, 0)]
    found += [row("fused", seed, raw) for seed, raw in enumerate((10.0, 15.0, 99.0))]
    found += [row("keypoints", seed, None, 0) for seed in range(3)]
    cell = make_evidence.errors_table(found).splitlines()[-1].split(" | ")
    assert cell[3] == "nobody found"
    assert cell[4] == "25.0 (12.5), 20 to 30; 60 %, 1 of 3 not found"
    # Only of the seeds in which both find somebody: 25 becomes 12.5.
    gain = make_evidence.gains_table(found).splitlines()[-1].split(" | ")
    assert gain[4] == "-50 (-50) %"
    assert gain[3] == ""
