"""The polygon world: exact truth, speeds as configured, pictures that show the polygons, the same bytes again."""

import csv
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from mocap.polygons.likelihood import colour_bins
from mocap.polygons.tree import part_frames
from mocap.synth.polygons import (
    PALETTE,
    SMALL,
    PolygonSceneSettings,
    draw_outline,
    main,
    make_polygon_scene,
)

SETTINGS = PolygonSceneSettings(
    n_arms=3, n_levels=4, width=330, height=290, n_frames=40, strong_frames=((10, 19),)
)


def test_the_same_seed_gives_the_same_scene_and_another_seed_another() -> None:
    one, again, other = (make_polygon_scene(SETTINGS, rng=np.random.default_rng(s)) for s in (3, 3, 4))
    np.testing.assert_array_equal(one.states, again.states)
    np.testing.assert_array_equal(one.frame(7), again.frame(7))
    assert np.abs(one.states - other.states).max() > 1.0


def test_clutter_changes_the_picture_and_not_the_motion() -> None:
    plain = make_polygon_scene(SETTINGS, rng=np.random.default_rng(3))
    cluttered = make_polygon_scene(
        PolygonSceneSettings(**{**vars(SETTINGS), "n_clutter": 25}), rng=np.random.default_rng(3)
    )
    np.testing.assert_array_equal(plain.states, cluttered.states)
    assert np.count_nonzero(plain.background) == 0
    assert np.count_nonzero(cluttered.background) > 25 * 50
    assert set(np.unique(cluttered.background)) <= set(range(len(PALETTE)))


def test_speeds_are_as_configured_and_double_in_strong_intervals() -> None:
    """Standard deviation of steps; 3 %: over 60 scenes of 200 frames and 11 columns it varies by 1 %."""
    weak, strong = [], []
    for seed in range(60):
        scene = make_polygon_scene(
            PolygonSceneSettings(n_arms=4, n_levels=3, n_frames=400, strong_frames=((200, 399),)),
            rng=np.random.default_rng(seed),
        )
        step = np.diff(scene.states, axis=0) / np.where(scene.tree.layout.is_circular, 0.0125, 0.5)
        weak.append(step[:199] ** 2)
        strong.append(step[199:] ** 2)
    rms = np.sqrt([np.mean(weak), np.mean(strong)])
    np.testing.assert_allclose(rms, [1.0, 2.0], rtol=0.03)


def test_the_middle_of_every_part_has_its_colour_unless_another_part_covers_it() -> None:
    scene = make_polygon_scene(SETTINGS, rng=np.random.default_rng(5))
    seen = 0
    for t in (0, 15, 39):
        labels = scene.labels(t)
        origin, angle = part_frames(scene.tree, scene.states[t][None])
        for p in range(scene.tree.layout.n_parts):
            c = scene.tree.corners_of(p).mean(axis=0)
            turn = np.array(
                [[np.cos(angle[0, p]), -np.sin(angle[0, p])], [np.sin(angle[0, p]), np.cos(angle[0, p])]]
            )
            u, v = np.rint(origin[0, p] + turn @ c).astype(int)
            seen += labels[v, u] == scene.part_label[p]
    assert seen >= 0.95 * 3 * scene.tree.layout.n_parts


def test_the_truth_scores_best() -> None:
    scene = make_polygon_scene(SETTINGS, rng=np.random.default_rng(6))
    problem = scene.problem(20)
    rng = np.random.default_rng(0)
    near = problem.propagate(
        np.repeat(scene.states[20:21], 200, axis=0), np.full(problem.layout.n_columns, 0.05), rng=rng
    )
    truth = problem.log_likelihood(scene.states[20:21]).sum()
    assert np.mean(problem.log_likelihood(near).sum(axis=1) < truth) > 0.97


@pytest.mark.parametrize("is_clutter_known", [True, False])
def test_bins_are_those_of_the_picture(is_clutter_known: bool) -> None:
    """Whoever does not know the clutter takes it for foreground."""
    changed = {"n_clutter": 12, "is_clutter_known": is_clutter_known}
    scene = make_polygon_scene(
        PolygonSceneSettings(**{**vars(SETTINGS), **changed}), rng=np.random.default_rng(7)
    )
    frame = scene.frame(9)
    empty = PALETTE[scene.background] if is_clutter_known else PALETTE[0]
    foreground = np.any(frame != empty, axis=2)
    np.testing.assert_array_equal(scene.bins(9), colour_bins(frame, foreground))
    assert 0 < np.count_nonzero(foreground) < 0.3 * foreground.size


def test_objects_stay_in_their_columns_of_the_picture() -> None:
    settings = PolygonSceneSettings(n_arms=4, n_levels=3, n_objects=3)
    scene = make_polygon_scene(settings, rng=np.random.default_rng(8))
    x = scene.states[:, [scene.tree.layout.names.index(f"object{m}_x") for m in range(3)]]
    assert np.all(np.abs(x - np.array([1, 3, 5]) * 800 / 6) < 100)


def test_the_formats_of_the_sources() -> None:
    default = PolygonSceneSettings(n_arms=4, n_levels=4)
    assert (default.width, default.height, default.n_frames) == (800, 640, 300)
    assert (SMALL.width, SMALL.height, SMALL.n_frames) == (640, 480, 200)


def test_files_hold_what_memory_holds(tmp_path: Path) -> None:
    main([str(tmp_path / "s"), "--arms", "2", "--levels", "3", "--frames", "4", "--small", "--seed", "9"])
    settings = PolygonSceneSettings(**{**vars(SMALL), "n_arms": 2, "n_levels": 3, "n_frames": 4})
    scene = make_polygon_scene(settings, rng=np.random.default_rng(9))
    picture = cv2.imread(str(tmp_path / "s" / "frames" / "000003.png"))
    np.testing.assert_array_equal(picture[..., ::-1], scene.frame(3))
    with (tmp_path / "s" / "states.csv").open() as stream:
        rows = list(csv.reader(stream))
    assert tuple(rows[0][1:]) == scene.tree.layout.names
    np.testing.assert_allclose(np.array(rows[1:], dtype=float)[:, 1:], scene.states, atol=1e-6)
    with (tmp_path / "s" / "corners.csv").open() as stream:
        corners = list(csv.DictReader(stream))
    assert len(corners) == 4 * scene.tree.n_corners
    assert float(corners[-1]["v_px"]) == pytest.approx(scene.corners[3, -1, 1], abs=1e-3)


def test_a_video_can_be_written(tmp_path: Path) -> None:
    main([str(tmp_path), "--arms", "2", "--levels", "2", "--frames", "3", "--small", "--video"])
    video = cv2.VideoCapture(str(tmp_path / "frames.mp4"))
    found, picture = video.read()
    video.release()
    assert found
    assert picture.shape == (480, 640, 3)


def test_an_outline_is_drawn_on_a_copy() -> None:
    scene = make_polygon_scene(SETTINGS, rng=np.random.default_rng(10))
    before = scene.frame(0)
    after = draw_outline(before, scene.tree, scene.states[0])
    np.testing.assert_array_equal(before, scene.frame(0))
    assert np.count_nonzero(np.any(after != before, axis=2)) > 200


@pytest.mark.parametrize(
    "change", [{"width": 0}, {"n_frames": 0}, {"strong_factor": -1.0}, {"n_clutter": -1}]
)
def test_senseless_settings_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(change))):
        PolygonSceneSettings(**{**vars(SETTINGS), **change})


def test_the_example_of_the_page_runs(capsys: pytest.CaptureFixture[str]) -> None:
    page = Path(__file__).resolve().parents[2] / "docs" / "polygons.md"
    (example,) = re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S)
    exec(compile(example, page.name, "exec"), {"__name__": "docs"})
    said = re.match(r"9 parts, error (\d+) px over 36 corners", capsys.readouterr().out)
    assert said is not None
    assert int(said[1]) < 100  # 3 px per corner
