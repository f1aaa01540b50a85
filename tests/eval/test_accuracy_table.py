"""Aims and what is reached: measures of known errors, the filter beside it, and that pages say what tables say."""

from __future__ import annotations

import csv
import re

import numpy as np
import pytest

from eval import accuracy, body_size, inner_evidence, person_surface, pose_ablation
from eval.whole import with_table
from mocap.body import landmarks_of, load_body_model, neutral_state, scale_body
from mocap.body.stretch import segment_kinds
from mocap.data import LANDMARKS, Motion

FPS = 30.0


def motion(n: int = 60) -> Motion:
    t = np.arange(n)[:, None, None] / FPS
    still = np.random.default_rng(0).uniform(-0.4, 0.4, (1, len(LANDMARKS), 3)) + np.array([0.0, 0.0, 1.0])
    return Motion(1, np.arange(n), np.arange(n) / FPS, still + np.array([0.8, 0.0, 0.0]) * t)


def moved(truth: Motion, name: str, by: np.ndarray | float, frames: slice = slice(None)) -> Motion:
    landmarks = truth.landmarks.copy()
    landmarks[frames, LANDMARKS.index(name)] += by
    return Motion(truth.person, truth.frames, truth.time_s, landmarks)


def test_measures_of_known_errors() -> None:
    truth = motion()
    there = accuracy.measures(truth, truth, FPS)
    assert (there["raw"], there["after_offset"], there["mmta_percent"]) == (0.0, 0.0, 100.0)
    shoulder = accuracy.measures(moved(truth, "left_shoulder", np.array([0.0, 0.0, 0.06])), truth, FPS)
    assert shoulder["shoulder"] == pytest.approx(30.0)
    assert shoulder["raw"] == pytest.approx(60.0 / 15)
    assert shoulder["after_offset"] < shoulder["raw"]
    wrist = accuracy.measures(moved(truth, "right_wrist", 0.3, slice(30, 45)), truth, FPS)
    assert wrist["lost_wrist_percent"] == pytest.approx(25.0)
    assert wrist["mmta_percent"] == pytest.approx(100.0 - 100.0 * 15 / (60 * 15))


def test_a_wrist_without_a_place_is_lost_and_misses() -> None:
    truth = motion()
    row = accuracy.measures(moved(truth, "left_wrist", np.nan, slice(0, 6)), truth, FPS)
    assert row["lost_wrist_percent"] == pytest.approx(10.0)
    assert row["mmta_percent"] < 100.0
    assert row["raw"] == 0.0


def test_the_filter_takes_trembling_away_and_leaves_motion() -> None:
    truth = motion()
    trembling = 0.01 * (-1.0) ** np.arange(60)[:, None]
    noisy = moved(truth, "neck", trembling)
    smooth = accuracy.filtered(noisy, FPS)
    at = LANDMARKS.index("neck")
    middle = slice(10, 50)
    assert np.abs(smooth.landmarks[middle, at] - truth.landmarks[middle, at]).max() < 0.001
    gap = Motion(1, noisy.frames[np.arange(60) != 20], noisy.time_s[1:], noisy.landmarks[np.arange(60) != 20])
    again = accuracy.filtered(gap, FPS)
    np.testing.assert_array_equal(again.frames, np.arange(60))
    assert np.isnan(again.landmarks[20]).all()
    assert np.isfinite(np.delete(again.landmarks, 20, axis=0)).all()


def test_the_page_says_what_the_table_says() -> None:
    with accuracy.RESULTS.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    page = accuracy.PAGE.read_text(encoding="utf-8")
    assert {row["method"] for row in rows} == set(accuracy.METHODS)
    assert with_table(page, "accuracy", accuracy.table(rows)) == page


def test_the_page_of_bodies_says_what_the_table_of_sizes_says() -> None:
    with body_size.RESULTS.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    own = [[row for row in rows if row["way"] == way] for way in body_size.WAYS]
    told = [(row["session"], f"{float(row['true_height_m']):.3f}") for row in own[0]]
    errors = zip(*([f"{float(row['error_mm']):+.0f}" for row in way] for way in own), strict=True)
    page = (accuracy.ROOT / "docs" / "bodies.md").read_text(encoding="utf-8")
    found = re.findall(
        r"^\| ([\w:]+)(?:, person \d)? \| (\d\.\d{3}) \| ([+-]\d+) \| ([+-]\d+) \|$", page, re.M
    )
    assert found == [(*about, *both) for about, both in zip(told, errors, strict=True)]


def test_girths_and_lengths_change_what_they_are_called() -> None:
    body = scale_body(load_body_model("whole"), 1.75)
    groups = segment_kinds(body)
    n = int(groups.max()) + 1
    elbow = int(groups[body.joints.index("left_elbow")])
    thicker = person_surface.with_girths(body, np.log(1.1) * (np.arange(n) == elbow))
    is_own = person_surface.girth_groups(body) == elbow
    np.testing.assert_allclose(thicker.cones.radii[is_own], 1.1 * body.cones.radii[is_own])
    np.testing.assert_array_equal(thicker.cones.radii[~is_own], body.cones.radii[~is_own])
    longer = person_surface.with_lengths(body, np.log(1.1) * (np.arange(n) == elbow))
    np.testing.assert_array_equal(longer.cones.radii, body.cones.radii)
    state = neutral_state(body)[None]

    def forearm(one: object) -> float:
        places = landmarks_of(one, state)[0]  # type: ignore[arg-type]
        return float(
            np.linalg.norm(places[LANDMARKS.index("left_wrist")] - places[LANDMARKS.index("left_elbow")])
        )

    assert forearm(longer) == pytest.approx(1.1 * forearm(body), rel=1e-6)
    assert groups[body.joints.index("right_forearm")] == elbow, "flesh and wrist of a forearm go together"
    assert elbow in person_surface.length_groups(body)


def test_the_decision_on_girths_says_what_its_table_says() -> None:
    with person_surface.RESULTS.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    note = accuracy.ROOT / "docs" / "decisions" / "0078-no-girths-and-lengths-of-ones-own.md"
    told = re.findall(
        r"^\| the (?:run|truth) \|[^|]*\| (\S+) \| (\S+) \| (\S+) \| (\S+) \|$", note.read_text(), re.M
    )
    expected = []
    for kind in dict.fromkeys((row["start"], row["body"]) for row in rows):
        own = [row for row in rows if (row["start"], row["body"]) == kind]
        expected.append(
            tuple(f"{np.mean([float(row[f]) for row in own]):.1f}" for f in person_surface.FIELDS[5:])
        )
    assert told == expected


def test_the_decision_on_texture_says_what_the_table_of_inner_evidence_says() -> None:
    with inner_evidence.RESULTS.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    note = (accuracy.ROOT / "docs" / "decisions" / "0071-texture-over-a-clip.md").read_text(encoding="utf-8")
    cells: dict[tuple[str, str], list[str]] = {}
    for kind in dict.fromkeys((row["session"], row["cameras"], row["variant"]) for row in rows):
        own = [row for row in rows if (row["session"], row["cameras"], row["variant"]) == kind]
        raw, after, arms = (np.array([float(row[f]) for row in own]) for f in inner_evidence.SCORES[:3])
        text = f"{raw.mean():.1f} / {after.mean():.1f} ± {after.std(ddof=1):.1f} / {arms.mean():.1f}"
        cells.setdefault(kind[:2], []).append(text)
    assert {len(own) for own in cells.values()} == {len(inner_evidence.VARIANTS)}
    for (session, cameras), own in cells.items():
        assert f"| `{session}` | {cameras} | {' | '.join(own)} |" in note


def test_the_table_of_parts_says_what_the_runs_say() -> None:
    rows = pose_ablation.read_rows()
    page = pose_ablation.PAGE.read_text(encoding="utf-8")
    assert with_table(page, "parts", pose_ablation.table(rows)) == page


def test_a_seed_that_a_variant_lacks_is_left_out_of_the_table_of_parts() -> None:
    rows = pose_ablation.read_rows()
    # The last seed of all but one run, with errors that would show.
    last = max(r["seed"] for r in rows)
    more = [{**r, "seed": str(int(last) + 1), "mean_error_mm": "1000"} for r in rows if r["seed"] == last]
    assert pose_ablation.table([*rows, *more[1:]]) == pose_ablation.table(rows)
    assert f"{int(last) + 2} seeds" in pose_ablation.table([*rows, *more])
