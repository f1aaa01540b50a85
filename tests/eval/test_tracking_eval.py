"""The tracking evaluation: methods on a hand-made clip, lines that add up and survive a stop, trees as plain data."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from eval import tracking_clear, tracking_page
from eval.tracking import blobs, hulls, runs
from eval.tracking.hulls import HullClip
from eval.tracking.methods import Method, observations, run_method
from eval.tracking.published import TABLE_4_3
from eval.tracking.trees import n_leaves, verdicts, write_tree
from mocap.data import Hull, Tracks, VoxelGrid
from mocap.tracking import Split
from mocap.tracking.features import components_of, read_person_tree
from mocap.volume import connected_components, surface_voxels

SIDE = 0.05
GRID = VoxelGrid.from_bounds(np.array([-2.0, -1.5, 0.0]), np.array([2.0, 1.5, 2.0]), SIDE)
COLOURS = ((200, 30, 30), (30, 30, 200))
N_FRAMES = 24


def body(x: float, y: float, half_depth: float = 0.25) -> np.ndarray:
    """Voxels of a block of 0.4 x 0.5 x 1.7 m."""
    centers = GRID.centers(np.arange(GRID.n_voxels, dtype=np.int32))
    inside = (abs(centers[:, 0] - x) < 0.2) & (abs(centers[:, 1] - y) < half_depth) & (centers[:, 2] < 1.7)
    return np.flatnonzero(inside).astype(np.int32)


@pytest.fixture(scope="module")
def clip() -> HullClip:
    """Two persons who walk past each other, 1 m apart; the second one leaves after 18 frames."""
    frames, table = [], []
    for f in range(N_FRAMES):
        places = [(-1.0 + 0.08 * f, -0.5)] + ([(1.0 - 0.08 * f, 0.5)] if f < 18 else [])
        parts = [body(*p) for p in places]
        voxels = np.concatenate(parts)
        rgb = np.concatenate(
            [np.tile(np.uint8(c), (len(p), 1)) for p, c in zip(parts, COLOURS, strict=False)]
        )
        order = np.argsort(voxels)
        voxels = voxels[order]
        surface = surface_voxels(voxels, GRID)
        frames.append(Hull(GRID, voxels, surface, surface.astype(np.uint8), rgb[order]))
        table += [(f, k + 1, *GRID.centers(p).mean(axis=0)) for k, p in enumerate(parts)]
    rows = np.array(table)
    frame = rows[:, 0].astype(np.int64)
    truth = Tracks(frame, rows[:, 1].astype(np.int64), frame / 10.0, rows[:, 2:])
    return HullClip("two", 10.0, np.arange(N_FRAMES), tuple(frames), truth, None)


@pytest.mark.parametrize("tracker", ["naive", "particle", "sparse"])
def test_every_method_finds_two_blocks(clip: HullClip, tracker: str) -> None:
    seen, _ = observations(clip)
    for method in (Method(tracker), Method(tracker, colour=True)):
        found = run_method(method, seen, clip)
        scores = runs.pooled([runs.scored(found, clip)])
        assert (scores["mota_percent"], scores["mismatches"]) == (100.0, 0.0)
        assert scores["motp_mm"] < 1000 * SIDE
        assert scores["hota_percent"] > 90.0
        assert len(found.infos) == N_FRAMES
        assert found.step_s > 0


def test_the_same_seed_gives_the_same_tracks(clip: HullClip) -> None:
    seen, _ = observations(clip)
    method = Method("sparse", 60, settings="published")
    a, b, c = (
        run_method(m, seen, clip) for m in (method, method, Method("sparse", 60, False, 1, "published"))
    )
    np.testing.assert_array_equal(a.tracks.xyz, b.tracks.xyz)
    assert a.tracks.xyz.shape != c.tracks.xyz.shape or not np.array_equal(a.tracks.xyz, c.tracks.xyz)


def test_runs_for_the_clock_change_no_track(clip: HullClip) -> None:
    seen, _ = observations(clip)
    one, three = (run_method(Method("particle"), seen, clip, n_runs=n) for n in (1, 3))
    np.testing.assert_array_equal(one.tracks.xyz, three.tracks.xyz)
    assert len(three.infos) == N_FRAMES
    assert 0 < three.step_s < np.inf


def test_lines_are_kept_and_not_computed_twice(
    clip: HullClip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loads = []

    def load(scene: str, cm: int, work: Path) -> HullClip:
        loads.append(scene)
        return clip

    monkeypatch.setattr(hulls, "load_hulls", load)
    store = tmp_path / "runs.csv"
    one, two = ("two", 5, Method("naive")), ("two", 5, Method("naive", tree="none"))
    first = runs.run_all([one], store=store, show=False)
    with store.open("a", encoding="utf-8") as file:
        file.write("cut,off")
    again = runs.run_all([one, two], store=store, show=False)
    assert again[0] == first[0]
    assert loads == ["two", "two"]
    monkeypatch.setattr(runs, "tracking_code", lambda: "other")
    runs.run_all([one], store=store, show=False)
    assert len(loads) == 3


def test_pooled_scores_weigh_scenes_by_their_size() -> None:
    empty = dict.fromkeys(runs.VALUES, "")
    a = empty | {
        "n_objects": "100",
        "n_matches": "90",
        "misses": "10",
        "distance_m": "9",
        "hota_percent": "50",
    }
    b = empty | {"n_objects": "300", "n_matches": "300", "false_positives": "6", "mismatches": "2"}
    b |= {"distance_m": "3", "hota_percent": "90", "step_s": "0.2"}
    p = runs.pooled([a, b])
    assert p["mota_percent"] == pytest.approx(100 * (1 - 18 / 400))
    assert p["motp_mm"] == pytest.approx(1000 * 12 / 390)
    assert p["misses_percent"] == pytest.approx(2.5)
    assert p["hota_percent"] == pytest.approx(80.0)
    assert p["step_ms"] == pytest.approx(0.5)
    assert np.isnan(runs.pooled([])["mota_percent"])


def test_labels_of_components() -> None:
    """A person, two persons in one component, a hand, and something that is nobody's."""
    parts = [body(-1.2, 0.0, 0.15), body(0.8, 0.0), body(1.15, 0.0)]
    box = GRID.voxels_of(np.array([[-0.2, 1.2, z] for z in (0.12, 0.17, 0.22)]))
    hand = GRID.voxels_of(np.array([[-1.225, 0.275, z] for z in (0.82, 0.87, 0.92)]))
    voxels = np.unique(np.concatenate([*parts, box, hand])).astype(np.int32)
    labels, n = connected_components(voxels, GRID)
    centers = GRID.centers(voxels)
    found = components_of(centers, labels, SIDE)
    truth = np.array([[-1.2, 0.0, 0.85], [0.8, 0.0, 0.85], [1.15, 0.0, 0.85]])
    assert sorted(blobs.label(found, centers, truth)) == ["ghost", "merged", "part", "person"]
    assert blobs.label(found, centers, truth[:0]) == ["ghost"] * n


def test_a_tree_survives_its_file(tmp_path: Path) -> None:
    tree = Split("weight_kg", 15.5, False, Split("top_m", 0.9, Split("height_m", 0.25, True, False), True))
    write_tree(tree, tmp_path / "tree.toml", "made by a test")
    assert read_person_tree(tmp_path / "tree.toml") == tree
    features = np.array(
        [[10, 1, 1, 1, 1, 1], [20, 1, 1, 1, 1, 1], [20, 0.3, 0.5, 0.5, 1, 1], [20, 0, 0.5, 0.1, 1, 1]]
    )
    assert verdicts(tree, features).tolist() == [False, True, False, True]
    assert n_leaves(tree) == 4


def test_the_tree_of_scikit_learn_says_the_same_as_ours() -> None:
    pytest.importorskip("sklearn")
    from eval.tracking.trees import as_split
    from eval.tracking_classifier import pruned_tree

    rng = np.random.default_rng(3)
    x = rng.uniform([0, 0, 0, 0, 0, 0], [200, 1.2, 2, 2, 1.5, 1], (400, 6))
    y = (x[:, 0] > 40) & (x[:, 2] > 1.0)
    group = np.array([f"scene_{k % 4}" for k in range(400)])
    tree, _, _ = pruned_tree(x, y, group)
    split = as_split(tree)
    np.testing.assert_array_equal(verdicts(split, x), tree.predict(x))
    assert 3 <= n_leaves(split) <= 6


def test_the_shipped_tree_is_well_formed() -> None:
    path = hulls.ROOT / "mocap" / "tracking" / "person_tree.toml"
    tree = read_person_tree(path)
    assert 2 <= n_leaves(tree) <= 40
    person = np.array([[100.0, 0.95, 1.78, 1.78, 0.6, 0.4]])
    speck = np.array([[0.05, 0.5, 0.52, 0.04, 0.04, 0.04]])
    assert verdicts(tree, np.concatenate([person, speck])).tolist() == [True, False]


def test_the_silhouette_of_a_box_is_that_of_its_surface() -> None:
    """Points of the box fall on the silhouette, points well beside it do not."""
    from mocap.data import Camera
    from mocap.synth.furniture import Box

    K = np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]])
    R = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    camera = Camera("c", (320, 240), K, np.zeros(5), R, -R @ np.array([0.0, -3.0, 0.8]))
    piece = Box(lower_m=(-0.3, -0.2, 0.2), upper_m=(0.3, 0.2, 1.0)).boxes()
    mask = blobs.silhouette([piece], camera)
    rng = np.random.default_rng(0)
    uv, _ = camera.project(rng.uniform([-0.29, -0.19, 0.21], [0.29, 0.19, 0.99], (200, 3)))
    u, v = np.round(uv).astype(int).T
    assert mask[v, u].all()
    outside, _ = camera.project(np.array([[0.6, 0.0, 0.6], [0.0, 0.0, 1.5], [-0.6, 0.0, 0.5]]))
    u, v = np.round(outside).astype(int).T
    assert not mask[v, u].any()


def test_cells_ask_for_every_setting_once() -> None:
    cells = tracking_clear.table_cells(["a", "b"], (0, 1))
    assert len(cells) == 4 * (1 + 2 * 3 + 2 * 3)
    assert all(len(own) == len(set(own)) for own in cells.values())
    assert len(cells["2", "Naive", "0"]) == 2
    assert len(cells["2", "SS-Color", "800"]) == 4
    known = [c for c in cells if (int(c[0]), c[1], int(c[2])) in TABLE_4_3]
    assert len(known) == len(cells)


def test_the_page_is_made_of_the_tables() -> None:
    assert tracking_page.PAGE.read_text(encoding="utf-8") == tracking_page.page()
